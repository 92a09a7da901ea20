"""Define exact answers: rational numbers, or intervals, for all quantities of a `Solution`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import counted
from contactqp.model.arrays import Array
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly
from contactqp.model.solution import AnswerOf, FreeMotion

if TYPE_CHECKING:
    from rich.console import Console

# Digits of a midpoint in data and in tables; radii include the rounding.
DIGITS, SHOWN_DIGITS = 50, 20

# Rational numbers as doubles and as decimals.

# The factor by which a radius is increased before rounding to two digits, to remain a bound.
ROUNDING_UP = 1.06

# Longer fractions are shortened in tables, not in data.
WIDEST = 44


def nearest(x: Fraction | float) -> float:
    """Return the nearest double, infinite on overflow (Python's division of integers is correctly rounded)."""
    if isinstance(x, float):  # the infinite gap of a contact that never closes
        return x
    try:
        return x.numerator / x.denominator
    except OverflowError:
        return math.inf if x > 0 else -math.inf


def rounded_up(x: Fraction) -> float:
    """Return the least double that is not smaller."""
    near = nearest(x)
    return near if near == math.inf or Fraction(near) >= x else float(np.nextafter(near, math.inf))


def ratio(x: Fraction | float) -> str:
    """Return a fraction as the text "p/q", of any length; Python refuses to print more than 4300 digits.

    >>> ratio(Fraction(-7, 3)), ratio(Fraction(4))
    ('-7/3', '4')
    """
    from contactqp.linalg.rational import from_fraction

    return str(x if isinstance(x, float) else from_fraction(x))


def decimal(x: Fraction, digits: int = DIGITS) -> str:
    """Return a number rounded to `digits` significant digits.

    >>> decimal(Fraction(2, 3), 5), decimal(Fraction(-1, 800), 5), decimal(Fraction(99999, 10000), 3)
    ('6.6667e-1', '-1.2500e-3', '1.00e1')
    """
    if not x:
        return "0"
    size = abs(x)
    exponent = round((size.numerator.bit_length() - size.denominator.bit_length()) * 0.30103)
    while size >= Fraction(10) ** (exponent + 1):
        exponent += 1
    while size < Fraction(10) ** exponent:
        exponent -= 1
    shown = str(round(size * Fraction(10) ** (digits - 1 - exponent)))
    if len(shown) > digits:
        exponent += 1
    return f"{'-' if x < 0 else ''}{shown[0]}.{shown[1:digits]}e{exponent}"


def widened(x: Fraction, radius: float, digits: int) -> float:
    """Return the radius around the printed number, rounded up."""
    exact = Fraction(radius) + abs(x) * Fraction(1, 10 ** (digits - 1))
    return rounded_up(exact)


def number_data(x: Fraction | float, radius: float | None) -> dict[str, Any]:
    """Return plain data of a number: "exact" and "double" of a rational one, "mid", "radius" and "double" of an
    interval.
    """
    double = nearest(x)
    known: dict[str, Any] = {"double": double if math.isfinite(double) else None}
    if radius is None or isinstance(x, float):
        return {"exact": ratio(x)} | known
    return {"mid": decimal(x), "radius": widened(x, radius, DIGITS)} | known


def cut(shown: str) -> str:
    """Return a fraction for tables, shortened if it is long."""
    return shown if len(shown) <= WIDEST else f"{shown[:12]}... ({len(shown)} digits)"


# Object arrays of Fractions.
Fractions = NDArray[Any]
Floats = Array


@dataclass(frozen=True, eq=False)
class Parts(AnswerOf[Floats, Floats | None], ReadOnly):
    """Floats in the shapes of a `Solution`; `friction_force` and `slip` are None without friction."""

    gap: Floats  # (m,)
    slip: Floats | None  # (m, d-1)


@dataclass(frozen=True)
class ExactEvent:
    """A change of a contact on a load path."""

    kind: str  # "closed", "opened", "stick", "slip"
    contact: int
    name: str
    time: Fraction  # pseudo-time of the path


@dataclass(frozen=True, eq=False)
class ExactDerivative:
    """Rates in Fractions along minus and plus a direction; `value` is both if they are equal, else None.

    A side without an answer, or without a unique rate, is None.

    `reach` are the steps (back, ahead) within which no contact changes its state, infinity if none ever does, None if
    the answer is not linear along the direction. If forces are not unique, these are the steps within which all
    touching contacts can exert the required force.
    """

    value: Any
    left: Any
    right: Any
    exists: bool
    reason: str = ""
    reach: tuple[Fraction | float, Fraction | float] | None = None


@dataclass(frozen=True, eq=False)
class ExactSolution(AnswerOf[Fractions, Fractions | None], ReadOnly):
    """The proven equilibrium K u + E_N'l_N + E_T'l_T + A'nu = f, with the signs and shapes of `Solution`.

    Entries are Fractions: the exact values if `rational`, otherwise the midpoints of intervals mid +- radius that
    contain the exact values. `doubles` has the nearest floats. With free motions the displacement is the one of least
    norm, or for intervals, the floating-point one (see the notes).
    """

    problem: ContactProblem = field(repr=False)
    gap: Fractions  # (m,) g - E_N u [length], positive when open; the float inf where a contact never closes
    slip: Fractions | None  # (m, d-1) E_T u - slip_origin [length]; at the end of a load path, from its start
    contact_status: tuple[str, ...]  # (m,) of "open" | "closed" | "grazing" | "stick" | "slip"
    rational: bool
    radius: Parts | None = field(repr=False)  # rounded up; None if rational
    unique_forces: bool  # whether the forces of contacts and ties are unique for this displacement
    # (m, 2) the least and the largest value of each normal force over all forces of this displacement, None if
    # unbounded. If they are not unique, `normal_force` has the least sum of squares of all contact forces in the given
    # units without tension, and tie forces are then the least possible ones. Enclosed forces are unique: both ends are
    # the midpoint.
    force_range: Fractions = field(repr=False)
    free_motions: tuple[FreeMotion, ...]
    energy: Fraction | None  # 1/2 u'Ku - f'u [force x length]; None if enclosed
    equilibria: int | None  # with friction, the number of equilibria at this load, None if not counted
    uniqueness: tuple[str, ...]  # with friction, findings on other equilibria, as in a certificate
    events: tuple[ExactEvent, ...]  # of a load path with friction
    data: str  # the origin of the exact data
    way: str  # how the answer was found
    proof: tuple[str, ...]  # what was proven
    notes: tuple[str, ...]  # further notes
    method: str  # the method that proposed the contact set
    seconds: float

    @property
    def doubles(self) -> Parts:
        """Return the doubles nearest to the exact values, or to the midpoints of intervals."""
        return Parts(
            _floats(self.displacement),
            _floats(self.normal_force),
            None if self.friction_force is None else _floats(self.friction_force),
            _floats(self.tie_force),
            _floats(self.gap),
            None if self.slip is None else _floats(self.slip),
        )

    def derivative(self, of: str, with_respect_to: str, direction: Any) -> Any:
        """Return exact one-sided rates in Fractions: `contactqp.oracle.exact.exact_rates.exact_derivative`."""
        found = import_module("contactqp.oracle.exact.exact_rates")
        return found.exact_derivative(self, of, with_respect_to, direction)

    def __repr__(self) -> str:
        kind = "rational" if self.rational else "enclosed"
        return f"ExactSolution({kind}, {_sizes(self.problem)})"

    def __str__(self) -> str:
        return text(self)


def _sizes(problem: ContactProblem) -> str:
    return f"{counted('unknown', problem.dimension)}, {counted('contact', problem.contacts)}"


def _floats(values: Fractions) -> Floats:
    return np.array([nearest(x) for x in values.ravel().tolist()], dtype=float).reshape(values.shape)


def text(answer: ExactSolution) -> str:
    """Return a summary of a few lines: kind of answer, contacts, and proofs."""
    problem = answer.problem
    kind = "exact" if answer.rational else "enclosed"
    lines = [f"{kind}, of {answer.data}: {_sizes(problem)}"]
    for i, word in enumerate(answer.contact_status):
        if word != "open":
            shown = shown_at(answer, "normal_force", i)
            lines.append(f"  {problem.contact_name(i)}: {word}, normal force {shown} {problem.units.force}".rstrip())
    lines += [f"  proven: {line}" for line in answer.proof] + [f"  {line}" for line in remarks(answer)]
    return "\n".join(lines)


def remarks(answer: ExactSolution) -> Iterator[str]:
    """Yield further remarks on the answer."""
    if any(low != high or low is None for low, high in answer.force_range):
        yield "contact forces are not unique: those of least norm, with the range of each"
    elif not answer.unique_forces:
        yield "forces are not unique, though the normal force of each contact is: those of least norm"
    if answer.equilibria is not None and answer.equilibria > 1:
        yield f"{answer.equilibria} equilibria at this load: one of them"
    elif answer.uniqueness:
        yield f"uniqueness: {'; '.join(answer.uniqueness)}"
    for motion in answer.free_motions:
        yield f"free motion, least displacement given: {motion}"
    yield from answer.notes


def shown_at(answer: ExactSolution, name: str, *place: int) -> str:
    """Return a number for tables: a fraction, or a midpoint with its radius."""
    x: Fraction = getattr(answer, name)[place]
    if answer.radius is None:
        return cut(ratio(x))
    off = widened(x, float(getattr(answer.radius, name)[place]), SHOWN_DIGITS)
    return f"{decimal(x, SHOWN_DIGITS)} +- {ROUNDING_UP * off:.1e}" if off else "0"


# Exact answers as tables, as text and as data for any language.

# The most unknowns in a table.
MOST_SHOWN = 200
SIGNS = (
    "K u + E_N'l_N + E_T'l_T + A'nu = f; normal_force l_N is positive in compression; gap = g - E_N u is positive when "
    "open; slip = E_T u - slip_origin, and friction_force l_T is what the body does to the obstacle, along its slip; "
    "tie_force is nu"
)


def answer_data(answer: ExactSolution, ties: Sequence[str], title: str = "") -> dict[str, Any]:
    """Return all data for JSON; exact numbers are text "p/q", with the nearest doubles."""
    problem, radius = answer.problem, answer.radius

    def entry(name: str, *place: int) -> dict[str, Any]:
        off = None if radius is None else float(getattr(radius, name)[place])
        return number_data(getattr(answer, name)[place], off)

    def entries(name: str, i: int) -> list[dict[str, Any]] | None:
        values: Fractions | None = getattr(answer, name)
        return None if values is None else [entry(name, i, axis) for axis in range(values.shape[1])]

    return {
        "format": "contactqp exact answer",
        "version": 1,
        "title": title,
        "rational": answer.rational,
        "signs": SIGNS,
        "units": {"length": problem.units.length, "force": problem.units.force},
        "unknowns": [
            {"name": problem.dof_name(j), "displacement": entry("displacement", j)} for j in range(problem.dimension)
        ],
        "contacts": [
            {
                "name": problem.contact_name(i),
                "status": answer.contact_status[i],
                "normal_force": entry("normal_force", i),
                "force_range": None if radius else [None if x is None else ratio(x) for x in answer.force_range[i]],
                "friction_force": entries("friction_force", i),
                "gap": entry("gap", i),
                "slip": entries("slip", i),
            }
            for i in range(problem.contacts)
        ],
        "ties": [{"name": name, "tie_force": entry("tie_force", k)} for k, name in enumerate(ties)],
        "unique_forces": answer.unique_forces,
        "energy": None if answer.energy is None else number_data(answer.energy, None),
        "equilibria": answer.equilibria,
        "uniqueness": list(answer.uniqueness),
        "free_motions": [str(motion) for motion in answer.free_motions],
        "events": [
            {"kind": event.kind, "contact": event.name, "time": number_data(event.time, None)}
            for event in answer.events
        ],
        "data": answer.data,
        "way": answer.way,
        "proof": list(answer.proof),
        "notes": list(answer.notes),
        "method": answer.method,
        "seconds": answer.seconds,
    }


def print_answer(console: Console, answer: ExactSolution, ties: Sequence[str], title: str) -> None:
    """Print the tables of unknowns, contacts, ties and events of an exact answer, and its proofs.

    Parameters
    ----------
    console : rich.console.Console
    answer : ExactSolution
    ties : sequence of str, names of the ties
    title : the beginning of the first line
    """
    from rich.table import Table

    problem, length, force = answer.problem, answer.problem.units.length, answer.problem.units.force
    console.print(f"{title}: {'exact' if answer.rational else 'enclosed'}, of {answer.data}", markup=False)

    def show(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        if rows:
            table = Table(*heads, box=None, pad_edge=True)
            for row in rows:
                table.add_row(*row)
            console.print(table, markup=False)

    number = "exact" if answer.rational else "mid +- radius"
    if problem.dimension <= MOST_SHOWN:
        show(
            ["unknown", f"displacement{_in(length)}", number],
            [[problem.dof_name(j), *_pair(answer, "displacement", j)] for j in range(problem.dimension)],
        )
    else:
        console.print(f"{problem.dimension} displacements are not shown; --json has them", markup=False)
    frictional = answer.friction_force is not None
    heads = ["contact", "status", f"normal force{_in(force)}", number, f"gap{_in(length)}"]
    heads += [f"friction force{_in(force)}"] if frictional else []
    heads += [] if answer.unique_forces else ["range"]
    rows = []
    for i, word in enumerate(answer.contact_status):
        row = [problem.contact_name(i), word, *_pair(answer, "normal_force", i), shown_at(answer, "gap", i)]
        if answer.friction_force is not None:
            row.append(
                ", ".join(shown_at(answer, "friction_force", i, w) for w in range(answer.friction_force.shape[1]))
            )
        if not answer.unique_forces:
            row.append(" to ".join("unbounded" if x is None else cut(ratio(x)) for x in answer.force_range[i]))
        rows.append(row)
    show(heads, rows)
    show(
        ["tie", f"force{_in(force)}", number],
        [[name, *_pair(answer, "tie_force", k)] for k, name in enumerate(ties)],
    )
    show(["event", "contact", "time"], [[event.kind, event.name, cut(ratio(event.time))] for event in answer.events])
    for line in answer.proof:
        console.print(f"proven: {line}", markup=False)
    for line in remarks(answer):
        console.print(line, markup=False)


def _in(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _pair(answer: ExactSolution, name: str, *place: int) -> tuple[str, str]:
    x: Fraction = getattr(answer, name)[place]
    return f"{nearest(x):.17g}", shown_at(answer, name, *place)
