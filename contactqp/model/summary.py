"""Tables of answers for people to read: what moves, what presses, whether it is certified; as text and as HTML."""

from __future__ import annotations

import html
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, Vector, own_floating_point
from contactqp.model.unknown_names import plain_name

# Rows of a table, at most; of more the largest are shown.
MOST = 10
MOST_INSTANTS = 12
# Gaps below this part of the lengths that meet are the rounding of zero.
ROUNDING = 1e-14
# Forces below this part of the largest of a history are the rounding of zero.
ROUNDING_OF_FORCES = 1e-12
# Characters of a line of text.
WIDTH = 80


@dataclass(frozen=True)
class Table:
    """A title, the names of columns and their entries as text."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self) -> str:
        """Return the table in columns of equal width, the first one to the left."""
        widths = [max(len(row[i]) for row in (self.columns, *self.rows)) for i in range(len(self.columns))]

        def line(row: tuple[str, ...]) -> str:
            first, *others = (cell.ljust(width) if i == 0 else cell.rjust(width)
                              for i, (cell, width) in enumerate(zip(row, widths, strict=True)))  # fmt: skip
            return "  " + "  ".join([first, *others]).rstrip()

        return "\n".join([self.title, *map(line, (self.columns, *self.rows))])

    def html(self) -> str:
        """Return the table as HTML."""

        def cells(row: tuple[str, ...], tag: str) -> str:
            return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) + "</tr>"

        body = "".join(cells(row, "td") for row in self.rows)
        return f"<p>{html.escape(self.title)}</p><table>{cells(self.columns, 'th')}{body}</table>"


class Printed:
    """What a notebook shows as `print` does."""

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"


@own_floating_point
def summary_of(solution: Any) -> str:
    """Return what a solution says in at most some forty lines of 80 columns: verdict, contacts, displacements."""
    return "\n".join([*headline(solution), *(table.text() for table in tables_of(solution))])


@own_floating_point
def html_of(solution: Any) -> str:
    """Return the same as HTML, for notebooks."""
    lines = "<br>".join(html.escape(line) for line in headline(solution))
    return f"<p>{lines}</p>" + "".join(table.html() for table in tables_of(solution))


def headline(solution: Any) -> list[str]:
    """Return the method with its verdict, and what the certificate says if it refuses the answer or notes something."""
    certificate = solution.certificate
    energy = f"energy {number(solution.energy)}{_energy_unit(solution)}"
    first = f"{solution.method}: {verdict_of(certificate)}; {energy}; {1e3 * solution.seconds:.3g} ms"
    said = [*certificate.failures, *(f"note: {note}" for note in certificate.notes)]
    said += [f"free to move: {motion}" for motion in solution.free_motions]
    return [first, *(line for text in said for line in wrapped(text))]


def verdict_of(certificate: Any) -> str:
    """Return a certificate's verdict in a word or two: ``"passed, proven"``."""
    if not certificate.passed:
        return "REFUSED"
    if not certificate.proven:
        return "passed"
    return "passed, proven of the equilibrium nearby" if certificate.scope == "local" else "passed, proven"


def tables_of(solution: Any) -> list[Table]:
    """Return the tables of contacts, displacements and ties; of long ones the rows with the largest numbers."""
    problem, length, force = solution.problem, solution.problem.units.length, solution.problem.units.force
    found = []
    if problem.contacts:
        found.append(_contacts(solution, _named("force", force), _named("gap", length), _named("slip", length)))
    u = solution.displacement
    shown = _largest(abs(u) * np.sqrt(np.where(problem.diagonal > 0, problem.diagonal, 1.0)))
    rows = tuple((problem.dof_name(j), number(u[j])) for j in shown)
    found.append(Table(_counted("unknown", len(u), len(shown)), ("", _named("displacement", length)), rows))
    if problem.ties:
        shown = _largest(abs(solution.tie_force))
        rows = tuple((problem.tie_name(i), number(solution.tie_force[i])) for i in shown)
        found.append(Table(_counted("tie", problem.ties, len(shown)), ("", _named("force", force)), rows))
    return found


def _contacts(solution: Any, force: str, gap: str, slip: str) -> Table:
    problem = solution.problem
    gaps = _without_rounding(solution.gap, problem, solution.displacement)
    shown = _largest(solution.normal_force, -np.where(np.isfinite(gaps), gaps, np.inf))
    columns, parts = ["", "status", force, gap], [solution.normal_force, gaps]
    if problem.frictional and solution.friction_force is not None and solution.slip is not None:
        columns[3:3] = [force.replace("force", "friction")]
        columns.append(slip)
        parts = [parts[0], _along_one_axis(solution.friction_force), gaps, _along_one_axis(solution.slip)]
    closed = int(np.sum(np.isin(solution.contact_status, ("closed", "stick", "slip"))))
    rows = tuple(
        (problem.contact_name(i), str(solution.contact_status[i]), *(number(part[i]) for part in parts)) for i in shown
    )
    title = f"{_counted('contact', problem.contacts, len(shown))}; {closed} closed"
    return Table(title, tuple(columns), rows)


def _along_one_axis(vectors: Any) -> Vector:
    """Return the components of vectors (m, d-1) along a single axis with their signs, else their lengths."""
    return np.asarray(vectors[:, 0] if vectors.shape[1] == 1 else np.linalg.norm(vectors, axis=1))


def _without_rounding(gap: Vector, problem: Any, displacement: Vector) -> Vector:
    meeting = abs(problem.normal) @ abs(displacement) + np.where(np.isfinite(problem.gap), abs(problem.gap), 0.0)
    return np.asarray(np.where(abs(gap) <= ROUNDING * meeting, 0.0, gap))


def _largest(*sizes: Vector) -> Sequence[int]:
    """Return the places of the largest numbers, by the first sizes and then the others, in their own order."""
    order = np.lexsort([-size for size in reversed(sizes)])[:MOST]
    return [int(i) for i in np.sort(order)]


def _counted(what: str, count: int, shown: int) -> str:
    return f"{count} {what}{'s' * (count != 1)}{f', the {shown} largest' if shown < count else ''}"


def _named(what: str, unit: str) -> str:
    return f"{what} [{unit}]" if unit else what


def _energy_unit(solution: Any) -> str:
    units = solution.problem.units
    return f" {units.force} {units.length}" if units.force and units.length else ""


def number(value: float) -> str:
    """Return a number to six digits; minus zero is zero.

    >>> number(-0.0), number(1234567.0), number(-8.5e-4)
    ('0', '1.23457e+06', '-0.00085')
    """
    return f"{float(value) + 0.0:.6g}"


def wrapped(text: str) -> list[str]:
    """Return a text as lines of at most 80 columns, set in by two and then by four."""
    return textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent="    ")


@own_floating_point
def history_table(
    times: Vector, solutions: Sequence[Any], normal_forces: Array, events: Sequence[Any], exact: bool = False
) -> str:
    """Return instants of a history with their largest forces, and its events.

    Of many instants some are shown, evenly chosen, and that of the largest force. Where events are not `exact` they are
    told at the first instant that has them.
    """
    force = _named("largest force", solutions[0].problem.units.force)
    chosen = np.arange(len(times))
    if len(times) > MOST_INSTANTS:
        evenly = np.linspace(0, len(times) - 1, MOST_INSTANTS - 1).round().astype(int)
        largest = int(np.argmax(np.max(normal_forces, axis=1, initial=0.0)))
        chosen = np.unique([*evenly, largest])
    rows, noise = [], ROUNDING_OF_FORCES * float(np.max(normal_forces, initial=0.0))
    for k in chosen.tolist():
        status = solutions[k].contact_status
        pushed = solutions[k].normal_force
        at = int(np.argmax(pushed)) if len(pushed) else -1
        largest_force = float(np.max(pushed, initial=0.0))
        largest_force = largest_force if largest_force > noise else 0.0
        name = solutions[k].problem.contact_name(at) if largest_force > 0 else ""
        closed = int(np.sum(np.isin(status, ("closed", "stick", "slip"))))
        rows.append((number(times[k]), str(closed), number(largest_force), name))
    told = [f"{event.name or event.contact} {event.kind} at {number(event.time)}" for event in events[:MOST]]
    more = [f"and {len(events) - MOST} events more"] if len(events) > MOST else []
    shown = "" if len(chosen) == len(times) else f", {len(chosen)} shown, that of the largest force among them"
    title = f"{len(times)} instants{shown}; {len(events)} event{'' if len(events) == 1 else 's'}"
    if events and not exact:
        title += ", each told at the first instant that has it"
    table = Table(title, ("time", "closed", force, "at"), tuple(rows)).text()
    return "\n".join([table, *(f"  {text}" for text in (*told, *more))])


@own_floating_point
def local_summary(solution: Any) -> str:
    """Return verdict, forces and velocities of a local problem's contacts as a table of at most 80 columns."""
    certificate, (m, d) = solution.certificate, solution.force.shape
    verdict = "passed" if certificate.passed else "REFUSED"
    said = [*certificate.failures, *(f"note: {note}" for note in certificate.notes)]
    shown = _largest(solution.force[:, 0])
    axes = ("N", "T") if d == 2 else ("N", "T1", "T2")
    columns = ("", "status", *(f"r_{axis}" for axis in axes), *(f"u_{axis}" for axis in axes))
    meeting = abs(solution.problem.delassus) @ abs(solution.force.ravel()) + abs(solution.problem.offset)
    velocity = np.where(abs(solution.velocity.ravel()) <= ROUNDING * meeting, 0.0, solution.velocity.ravel())
    values = np.hstack([solution.force, velocity.reshape(m, d)])
    rows = tuple((f"contact {i}", str(solution.contact_status[i]), *map(number, values[i])) for i in shown)
    title = _counted("contact", m, len(shown))
    first = f"{solution.method}: {verdict}; {1e3 * solution.seconds:.3g} ms"
    return "\n".join([first, *(line for text in said for line in wrapped(text)), Table(title, columns, rows).text()])


def place_of(name: str | int, count: int, name_of: Callable[[int], str], what: str) -> int:
    """Return the place, among so many, of what has a name, also as other codes spell it (``2.UX`` for ``2.x``).

    A number is the place itself; one below zero counts from the end.

    Raises
    ------
    InvalidProblem
        There is none; the nearest names are given.
    """
    from difflib import get_close_matches

    if isinstance(name, int | np.integer) and -count <= name < count:
        return int(name) % count
    names = [name_of(i) for i in range(count)]
    if isinstance(name, str) and name in names:
        return names.index(name)
    meant = plain_name(name) if isinstance(name, str) else None
    same = [i for i, other in enumerate(names) if meant is not None and plain_name(other) == meant]
    if len(same) == 1:
        return same[0]
    near = get_close_matches(str(name), names, n=3) or names[:3]
    raise InvalidProblem(f"no {what} is called {name!r}; nearest: {', '.join(near) or 'there is none'}")
