"""An exact answer: rational numbers, or enclosures, of everything that a `Solution` has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly
from contactqp.model.solution import FreeMotion
from contactqp.oracle.exact.decimals import ROUNDING_UP, SHOWN_DIGITS, cut, decimal, nearest, ratio, widened

# Object arrays of Fractions.
Fractions = NDArray[Any]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Parts(ReadOnly):
    """Floats in the shapes of a `Solution`; `friction_force` and `slip` are None where nothing rubs."""

    displacement: Floats  # (n,)
    normal_force: Floats  # (m,)
    friction_force: Floats | None  # (m, d-1)
    tie_force: Floats  # (k,)
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
class ExactSolution(ReadOnly):
    """The equilibrium K u + E_N'l_N + E_T'l_T + A'nu = f in numbers that are proven; signs and shapes of `Solution`.

    Entries are Fractions: the exact values where `rational`, otherwise the midpoints of intervals mid +- radius, one an
    entry, that hold the exact values (`radius`). `doubles` has the nearest floats.
    """

    problem: ContactProblem = field(repr=False)
    # (n,) u [length]; where motions are free the one of least norm, or, enclosed, where floats have it (see the notes)
    displacement: Fractions
    normal_force: Fractions  # (m,) l_N [force], positive in compression
    friction_force: Fractions | None  # (m, d-1) l_T [force], what the body does to the obstacle
    tie_force: Fractions  # (k,) nu [force]
    gap: Fractions  # (m,) g - E_N u [length], positive when open
    slip: Fractions | None  # (m, d-1) E_T u - slip_origin [length]; at the end of a load path, since its start
    contact_status: tuple[str, ...]  # (m,) of "open" | "closed" | "grazing" | "stick" | "slip"
    rational: bool
    radius: Parts | None = field(repr=False)  # rounded up; None where rational: all zero
    unique_forces: bool  # no other contact forces hold this displacement
    # (m, 2) the least and the largest value of each normal force over all forces that hold the displacement, None where
    # unbounded. Where they are not unique `normal_force` is the set of least norm: least sum of squares of all contact
    # forces in the units given, none of them in tension; the ties' are then the least of those that fit. Enclosed
    # forces are unique: both ends are the midpoint.
    force_range: Fractions = field(repr=False)
    free_motions: tuple[FreeMotion, ...]
    energy: Fraction | None  # 1/2 u'Ku - f'u [force x length]; None where enclosed
    equilibria: int | None  # with friction, how many displacements are equilibria at this load; None: not counted
    uniqueness: tuple[str, ...]  # with friction, what is known of other equilibria, as in a certificate
    events: tuple[ExactEvent, ...]  # of a load path with friction
    data: str  # whose numbers are solved exactly
    way: str  # how the answer was found
    proof: tuple[str, ...]  # what was proven
    notes: tuple[str, ...]  # what else to know
    method: str  # that proposed the contact set
    seconds: float

    @property
    def doubles(self) -> Parts:
        """The nearest floats of the exact values, or of the midpoints."""
        return Parts(
            _floats(self.displacement),
            _floats(self.normal_force),
            None if self.friction_force is None else _floats(self.friction_force),
            _floats(self.tie_force),
            _floats(self.gap),
            None if self.slip is None else _floats(self.slip),
        )

    def __str__(self) -> str:
        return text(self)


def _floats(values: Fractions) -> Floats:
    return np.array([nearest(x) for x in values.ravel().tolist()], dtype=float).reshape(values.shape)


def text(answer: ExactSolution) -> str:
    """A few lines: what is exact, the contacts, and what was proven."""
    problem = answer.problem
    kind = "exact" if answer.rational else "enclosed"
    lines = [f"{kind}, of {answer.data}: {problem.dimension} unknowns, {problem.contacts} contacts"]
    for i, word in enumerate(answer.contact_status):
        if word != "open":
            shown = shown_at(answer, "normal_force", i)
            lines.append(f"  {problem.contact_name(i)}: {word}, normal force {shown} {problem.units.force}".rstrip())
    lines += [f"  proven: {line}" for line in answer.proof] + [f"  {line}" for line in remarks(answer)]
    return "\n".join(lines)


def remarks(answer: ExactSolution) -> Iterator[str]:
    """What else there is to say of it."""
    if not answer.unique_forces:
        yield "contact forces are not unique: those of least norm, with the range of each"
    if answer.equilibria is not None and answer.equilibria > 1:
        yield f"{answer.equilibria} equilibria at this load: one of them"
    elif answer.uniqueness:
        yield f"uniqueness: {'; '.join(answer.uniqueness)}"
    for motion in answer.free_motions:
        yield f"free motion, least displacement given: {motion}"
    yield from answer.notes


def shown_at(answer: ExactSolution, name: str, *place: int) -> str:
    """Return one number as tables show it: a fraction, or a midpoint with its radius."""
    x: Fraction = getattr(answer, name)[place]
    if answer.radius is None:
        return cut(ratio(x))
    off = widened(x, float(getattr(answer.radius, name)[place]), SHOWN_DIGITS)
    return f"{decimal(x, SHOWN_DIGITS)} +- {ROUNDING_UP * off:.1e}" if off else "0"
