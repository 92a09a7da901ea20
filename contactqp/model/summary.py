"""Summarise answers in tables of displacements, contact forces and verdicts, as text and as HTML."""

from __future__ import annotations

import csv
import html
import io
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, Generic, TypeVar, overload

import numpy as np

from contactqp.errors import InvalidProblem, counted, shown
from contactqp.model.arrays import Array, Vector, own_floating_point
from contactqp.model.names import plain_name
from contactqp.model.problem_data import is_whole

# The most rows of a table, which shows the largest ones.
MOST = 10
MOST_INSTANTS = 12
# The most events listed one by one; more are grouped by kind and time, and this is the most groups.
FEW_EVENTS, MOST_EVENTS = 8, 16
# Gaps, slips and forces below this part of the terms of their sums are rounding errors of zero.
ROUNDING_OF_ZERO = 1e-14
# A force that is so many times its proven bound is there, whatever K u has lost beside it.
FAR_ABOVE = 10.0
# Forces below this part of the largest of a history are rounding errors of zero.
ROUNDING_OF_FORCES = 1e-12
# The length of a line of text, and a space at which lines are not broken.
WIDTH, UNBROKEN = 80, "\xa0"


@dataclass(frozen=True)
class Table:
    """A title, the names of columns and their entries as text."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""  # a line below the rows

    def text(self) -> str:
        """Return the table in columns of equal width, the first one to the left."""
        lines = [*aligned((self.columns, *self.rows), "<>"), *filter(None, [self.note])]
        return "\n".join([self.title, *(f"  {line}" for line in lines)])

    def html(self) -> str:
        """Return the table as HTML."""

        def cells(row: tuple[str, ...], tag: str) -> str:
            return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row) + "</tr>"

        body = "".join(cells(row, "td") for row in self.rows)
        note = f"<p>{html.escape(self.note)}</p>" if self.note else ""
        return f"<p>{html.escape(self.title)}</p><table>{cells(self.columns, 'th')}{body}</table>{note}"


def aligned(rows: Sequence[Sequence[str]], sides: str = "<<") -> list[str]:
    """Return rows of cells as lines of text in columns, to the left (<) or right (>): the first one, and the others.

    >>> aligned([("contact", "force"), ("tip", "2")], "<>")
    ['contact  force', 'tip          2']
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    shapes = [f"{{:{sides[min(place, 1)]}{width}}}" for place, width in enumerate(widths)]
    return ["  ".join(shape.format(cell) for shape, cell in zip(shapes, row, strict=True)).rstrip() for row in rows]


def finite(value: Any) -> Any:
    """Return a number, or an array as lists, with None in place of what is not finite, which JSON cannot write.

    >>> finite(2), finite(np.inf), finite(np.array([1.0, np.nan])), finite(None)
    (2.0, None, [1.0, None], None)
    """
    if value is None:
        return None
    if np.ndim(value):
        return [finite(one) for one in value]
    return float(value) if np.isfinite(value) else None


class Printed:
    """A class whose HTML in a notebook is the same table as printed text."""

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"


R = TypeVar("R")


class RowsOf(Sequence[R], Generic[R]):
    """A sequence of rows that is printed as a table."""

    rows: tuple[R, ...]

    @overload
    def __getitem__(self, place: int) -> R: ...

    @overload
    def __getitem__(self, place: slice) -> tuple[R, ...]: ...

    def __getitem__(self, place: int | slice) -> R | tuple[R, ...]:
        return self.rows[place]

    def __len__(self) -> int:
        return len(self.rows)


@own_floating_point
def summary_of(solution: Any) -> str:
    """Return the verdict, contacts and displacements of a solution in about forty lines of 80 columns."""
    return "\n".join([*headline(solution), *(table.text() for table in tables_of(solution))])


@own_floating_point
def html_of(solution: Any) -> str:
    """Return the summary as HTML, for notebooks."""
    lines = "<br>".join(html.escape(line) for line in headline(solution))
    return f"<p>{lines}</p>" + "".join(table.html() for table in tables_of(solution))


def headline(solution: Any, energy: float | None = None) -> list[str]:
    """Return the method with its verdict, and the failures and notes of the certificate.

    `energy` is the energy that is printed, by default that of the solution.
    """
    certificate = solution.certificate
    size = number(solution.energy if energy is None else energy)
    energy_text = f"energy {size}{_energy_unit(solution)}".replace(" ", UNBROKEN)
    first = f"{solution.method}: {verdict_of(certificate)}; {energy_text}; {1e3 * solution.seconds:.3g} ms"
    sentences = [*certificate.failures, *(f"note: {note}" for note in certificate.notes)]
    sentences += [f"free to move: {motion}" for motion in solution.free_motions]
    return [*folded(first, "", "  "), *wrapped(*sentences)]


def folded(text: str, first: str, others: str) -> list[str]:
    """Return a text as lines of at most 80 columns with these indents.

    Numbers are not separated from their units or from names before them.
    """
    bound = re.sub(r"(?<=\d) (?=[^\W\d])|(?<=tolerance) (?=\d)", UNBROKEN, text)
    lines = textwrap.wrap(bound, WIDTH, initial_indent=first, subsequent_indent=others)
    return [line.replace(UNBROKEN, " ") for line in lines]


def verdict_of(certificate: Any) -> str:
    """Return a certificate's verdict in a word or two: ``"passed, proven"``."""
    if not certificate.passed:
        return "REFUSED"
    if not certificate.proven:
        return "passed"
    return "passed, proven of the equilibrium nearby" if certificate.scope == "local" else "passed, proven"


def tables_of(solution: Any) -> list[Table]:
    """Return the tables of contacts, displacements and ties, limited to the rows with the largest numbers."""
    problem, length, force = solution.problem, solution.problem.units.length, solution.problem.units.force
    found = []
    if problem.contacts:
        found.append(_contacts(solution, _named("force", force), _named("gap", length), _named("slip", length)))
    found.append(unknowns_table(solution, problem.dimension))
    if problem.ties:
        shown = largest(abs(solution.tie_force))
        rows = tuple((problem.tie_name(i), number(solution.tie_force[i])) for i in shown)
        found.append(Table(_counted("tie", problem.ties, len(shown)), ("", _named("force", force)), rows))
    return found


def unknowns_table(solution: Any, count: int) -> Table:
    """Return the table of the first `count` unknowns, of many those whose displacement has the largest energy."""
    problem, u = solution.problem, solution.displacement[:count]
    diagonal = problem.diagonal[:count]
    shown = largest(abs(u) * np.sqrt(np.where(diagonal > 0, diagonal, 1.0)))
    rows = tuple((problem.dof_name(j), number(u[j])) for j in shown)
    columns = ("", _named("displacement", problem.units.length))
    return Table(_counted("unknown", len(u), len(shown)), columns, rows)


def _contacts(solution: Any, force: str, gap: str, slip: str) -> Table:
    problem = solution.problem
    clean = without_rounding(solution)
    shown = _most_telling(solution.contact_status, clean.normal_force, clean.gap)
    columns, parts = ["", "status", force, gap], [clean.normal_force, clean.gap]
    if problem.frictional and clean.friction_force is not None and clean.slip is not None:
        columns[3:3] = [force.replace("force", "friction")]
        columns.append(slip)
        parts = [parts[0], _along_one_axis(clean.friction_force), clean.gap, _along_one_axis(clean.slip)]
    rows = tuple(
        (problem.contact_name(i), str(solution.contact_status[i]), *(number(part[i]) for part in parts)) for i in shown
    )
    title = _title_of_contacts(solution.contact_status, problem.frictional, len(shown))
    table = Table(title, tuple(columns), rows)
    points = problem._computed.contact_points
    if points is None or not len(points):
        return table
    placed = tuple((*row, _place(points[i])) for row, i in zip(rows, shown, strict=True))
    largest = int(np.argmax(clean.normal_force))
    where = f"{problem.contact_name(largest)} at {_place(points[largest])} {problem.units.length}".rstrip()
    note = f"largest force: {where}" if clean.normal_force[largest] > 0 else ""
    wide = Table(title, (*columns, _named("at", problem.units.length)), placed, note)
    fits = max(map(len, wide.text().splitlines())) <= WIDTH
    return wide if fits else replace(table, note=note)


def _place(point: Vector) -> str:
    """Return coordinates as text: ``(0.5, 0)``."""
    return "(" + ", ".join(f"{x + 0.0:.4g}" for x in point.tolist()) + ")"


def _most_telling(status: Any, force: Vector, gap: Vector | None = None) -> Sequence[int]:
    """Return the contacts to be shown, in ascending order: of many, slipping ones first, then those with the largest
    forces.
    """
    nearness = [] if gap is None else [-np.where(np.isfinite(gap), gap, np.inf)]
    return largest((np.asarray(status) == "slip").astype(float), force, *nearness)


def _title_of_contacts(status: Any, frictional: bool, shown: int) -> str:
    """Return a title with the number of contacts in each state and of those shown."""
    if not frictional:
        return f"{_counted('contact', len(status), shown)}; {count_closed(status)} closed"
    count = {name: int(np.sum(np.asarray(status) == name)) for name in ("slip", "stick", "open", "closed", "grazing")}
    told = [f"{n} {name}" for name, n in count.items() if n or name in ("slip", "stick", "open")]
    few = f"; {shown} shown, slip first" if shown < len(status) else ""
    return f"{counted('contact', len(status))}: {', '.join(told)}{few}"


def count_closed(status: Any) -> int:
    """Return the number of closed contacts, sticking and slipping ones included."""
    return int(np.sum(np.isin(status, ("closed", "stick", "slip"))))


def _along_one_axis(vectors: Any) -> Vector:
    """Return the components of vectors (m, d-1) along a single axis with their signs, else their lengths."""
    return np.asarray(vectors[:, 0] if vectors.shape[1] == 1 else np.linalg.norm(vectors, axis=1))


@dataclass(frozen=True, eq=False)
class Contacts:
    """Forces, gaps and slips of the contacts of a solution, zero where they are rounding."""

    normal_force: Vector  # (m,)
    friction_force: Array | None  # (m, d-1)
    gap: Vector  # (m,)
    slip: Array | None  # (m, d-1)


def without_rounding(solution: Any) -> Contacts:
    """Return the forces, gaps and slips of a solution, with zeros in place of rounding errors.

    A gap g - E_N u is measured by |g| + |E_N||u|, a slip E_T u - slip_origin likewise, and a force by
    |E_i|(|K||u| + |f| + |E_N|'|l_N|) / |E_i|^2: the forces that meet at the unknowns which the contact touches. A
    normal force far above its proven bound is measured without |K||u|.
    """
    problem, u = solution.problem, abs(solution.displacement)
    outer = abs(problem.load) + abs(problem.normal).T @ abs(solution.normal_force)
    meeting = problem.stiffness_sizes @ u + outer
    gap = np.where(np.isfinite(problem.gap), abs(problem.gap), 0.0) + abs(problem.normal) @ u
    friction, slip = solution.friction_force, solution.slip
    if friction is not None and problem.tangent is not None:
        friction = _nothing_below(_meeting_on(problem.tangent, meeting).reshape(friction.shape), friction)
    if slip is not None and problem.tangent is not None:
        slip = _nothing_below(abs(problem.slip_origin) + (abs(problem.tangent) @ u).reshape(slip.shape), slip)
    force, bound = solution.normal_force, solution.certificate.force_bound
    sizes = _meeting_on(problem.normal, meeting)
    if bound is not None and bound.shape == force.shape:  # not in a motion, which is certified step by step
        sizes = np.where(abs(force) > FAR_ABOVE * bound, _meeting_on(problem.normal, outer), sizes)
    return Contacts(
        _nothing_below(sizes, force),
        friction,
        _nothing_below(gap, solution.gap),
        slip,
    )


def _meeting_on(rows: Any, forces: Vector) -> Vector:
    """Return |E_i| F / |E_i|^2 for each row, the forces F (n,) at unknowns as forces on rows; 0 for a row of zeros."""
    squared = np.asarray(rows.multiply(rows).sum(axis=1)).ravel()
    return np.asarray(abs(rows) @ forces / np.where(squared > 0, squared, 1.0))


def _nothing_below(sizes: Array, values: Array) -> Array:
    return np.asarray(np.where(abs(values) <= ROUNDING_OF_ZERO * sizes, 0.0, values))


def largest(*sizes: Vector) -> Sequence[int]:
    """Return the indices of the largest numbers, by the first array and then the others, ascending."""
    order = np.lexsort([-size for size in reversed(sizes)])[:MOST]
    return [int(i) for i in np.sort(order)]


def _counted(what: str, count: int, shown: int) -> str:
    return counted(what, count) + (f", the {shown} largest" if shown < count else "")


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


def wrapped(*texts: str) -> list[str]:
    """Return texts as lines of at most 80 columns, indented by two and then by four."""
    return [line for text in texts for line in folded(text, "  ", "    ")]


@own_floating_point
def history_table(
    times: Vector,
    solutions: Sequence[Any],
    normal_forces: Array,
    events: Sequence[Any],
    exact: bool = False,
    time_label: str = "time",
) -> str:
    """Return instants of a history with states, largest forces and smallest gaps of their contacts, and its events.

    Of many instants an even selection is shown, with that of the largest force. Events that are not `exact` are listed
    at the first instant after them.

    Parameters
    ----------
    times : (steps,) array
    solutions : sequence of Solution, of which only those that are shown are computed
    normal_forces : (steps, m) array
    events : sequence of Event
    exact : bool
    time_label : the heading of the column of times, with their unit
    """
    chosen = np.arange(len(times))
    if len(times) > MOST_INSTANTS:
        evenly = np.linspace(0, len(times) - 1, MOST_INSTANTS - 1).round().astype(int)
        hardest = int(np.argmax(np.max(normal_forces, axis=1, initial=0.0)))
        chosen = np.unique([*evenly, hardest])
    noise = ROUNDING_OF_FORCES * float(np.max(normal_forces, initial=0.0))
    problem = solutions[0].problem
    states = ("slip", "stick", "open") if problem.frictional else ("closed",)
    largest = "max force" if problem.frictional else "largest force"
    columns = [time_label, *states, _named(largest, problem.units.force), "at"]
    if problem.frictional:
        columns.append(_named("max friction", problem.units.force))
    rows = tuple((number(times[k]), *_instant(solutions[k], states, noise)) for k in chosen.tolist())
    table = Table("", tuple(columns), rows)
    if not problem.frictional and problem.contacts:
        gaps = [number(np.min(without_rounding(solutions[k]).gap)) for k in chosen.tolist()]
        wide = tuple((*row, gap) for row, gap in zip(rows, gaps, strict=True))
        wider = Table("", (*columns, _named("smallest gap", problem.units.length)), wide)
        table = wider if max(map(len, wider.text().splitlines())) <= WIDTH else table
    told = events_together(events, problem.contact_name)
    lines = [f"{names} {kind} at {number(time)}" for kind, names, time, _ in told[:MOST_EVENTS]]
    if len(told) > MOST_EVENTS:
        lines.append(f"and {counted('more event', sum(count for *_, count in told[MOST_EVENTS:]))}")
    shown = "" if len(chosen) == len(times) else f", {len(chosen)} shown, that of the largest force among them"
    title = f"{counted('instant', len(times))}{shown}; {counted('event', len(events))}"
    if events and not exact:
        lines.insert(0, "each event is listed at the first instant that shows it")
    return "\n".join([replace(table, title=title).text(), *(f"  {line}" for line in lines)])


def _instant(solution: Any, states: Sequence[str], noise: float) -> list[str]:
    """Return the number of contacts in each state, the largest normal force with its contact, and the largest
    friction.
    """
    status, force = np.asarray(solution.contact_status), solution.normal_force
    count = {name: int(np.sum(status == name)) for name in ("slip", "stick")}
    count["closed"] = count_closed(status)
    count["open"] = len(status) - count["closed"]
    at = int(np.argmax(force)) if len(force) else -1
    largest = float(np.max(force, initial=0.0))
    pushes = largest > noise
    cells = [*(str(count[name]) for name in states), number(largest if pushes else 0.0)]
    cells.append(solution.problem.contact_name(at) if pushes else "")
    if "slip" in states:
        friction = np.zeros((0, 1)) if solution.friction_force is None else solution.friction_force
        largest_friction = float(np.max(np.linalg.norm(friction, axis=1), initial=0.0))
        cells.append(number(largest_friction if largest_friction > noise else 0.0))
    return cells


def events_together(
    events: Sequence[Any], contact_name: Callable[[int], str], few: int = FEW_EVENTS
) -> list[tuple[str, str, float, int]]:
    """Return kind, contacts in words, time and number of the events of a history.

    Many events of one kind at one time are grouped: ``("closed", "foot 0 and 20 others", 1.0, 21)``.
    """
    named = [(event.kind, event.name or contact_name(event.contact), event.time) for event in events]
    if len(named) <= few:
        return [(kind, name, time, 1) for kind, name, time in named]
    found = []
    for _, at_once in groupby(named, key=lambda event: f"{event[2]:.12g}"):
        together: dict[str, list[tuple[str, float]]] = {}
        for kind, name, time in at_once:
            together.setdefault(kind, []).append((name, time))
        found += [
            (kind, _some_of([name for name, _ in same]), same[0][1], len(same)) for kind, same in together.items()
        ]
    return found


def _some_of(names: Sequence[str]) -> str:
    return f"{names[0]} and {len(names) - 1} others" if len(names) > 2 else " and ".join(names)


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return comma-separated values with a header; numbers have all their digits, None is empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(map(_cell, row) for row in rows)
    return text.getvalue()


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)


@own_floating_point
def local_summary(solution: Any) -> str:
    """Return verdict, forces and velocities of a local problem's contacts as a table of at most 80 columns."""
    certificate, (m, d) = solution.certificate, solution.force.shape
    verdict = "passed" if certificate.passed else "REFUSED"
    sentences = [*certificate.failures, *(f"note: {note}" for note in certificate.notes)]
    shown = _most_telling(solution.contact_status, solution.force[:, 0])
    axes = ("N", "T") if d == 2 else ("N", "T1", "T2")
    columns = ("", "status", *(f"r_{axis}" for axis in axes), *(f"u_{axis}" for axis in axes))
    meeting = abs(solution.problem.delassus) @ abs(solution.force.ravel()) + abs(solution.problem.offset)
    velocity = np.where(abs(solution.velocity.ravel()) <= ROUNDING_OF_ZERO * meeting, 0.0, solution.velocity.ravel())
    values = np.hstack([solution.force, velocity.reshape(m, d)])
    rows = tuple((f"contact {i}", str(solution.contact_status[i]), *map(number, values[i])) for i in shown)
    title = _title_of_contacts(solution.contact_status, True, len(shown))
    first = f"{solution.method}: {verdict}; {1e3 * solution.seconds:.3g} ms"
    lines = [*folded(first, "", "  "), *wrapped(*sentences)]
    return "\n".join([*lines, Table(title, columns, rows).text()])


def place_of(name: str | int, count: int, name_of: Callable[[int], str], what: str) -> int:
    """Return the index of a name, also in the spelling of other codes (``2.UX`` for ``2.x``).

    A number is the index itself; a negative one counts from the end.

    Raises InvalidProblem: there is none; the message gives the nearest names.

    Parameters
    ----------
    name : str or int, what is looked for
    count : how many there are
    name_of : function of int, returns the name of each, counted from 0
    what : "contact", "unknown" or "tie", for messages
    """
    from difflib import get_close_matches

    if is_whole(name) and -count <= name < count:
        return int(name) % count
    names = [name_of(i) for i in range(count)]
    if isinstance(name, str) and name in names:
        return names.index(name)
    meant = plain_name(name) if isinstance(name, str) else None
    same = [i for i, other in enumerate(names) if meant is not None and plain_name(other) == meant]
    if len(same) == 1:
        return same[0]
    near = get_close_matches(shown(name), names, n=3) or names[:3]
    raise InvalidProblem(f"no {what} is called {shown(name)}; nearest: {', '.join(near) or 'there is none'}")
