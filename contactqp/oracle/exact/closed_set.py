"""The exact equilibrium without friction: a proposed set of closed contacts, solved, corrected and proven.

Of the displacements that are equilibria (they differ by motions that nothing drives and nothing resists) the one of
least norm within the gaps is given, and of the forces that hold it, where contacts are redundant, those of least norm.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from flint import fmpq_mat

from contactqp.oracle.exact.affine_family import Family, Range
from contactqp.oracle.exact.balancing import Balance, balance
from contactqp.oracle.exact.combination import Combination, System, system_of
from contactqp.oracle.exact.complementarity import reduce_problem
from contactqp.oracle.exact.exact_problem import RationalProblem
from contactqp.oracle.exact.proof import RationalAnswer, wrong
from contactqp.oracle.exact.rational import null_space, stack, take, zeros

# Corrections of a proposed set before Lemke's method is asked.
MOST_CORRECTIONS = 20


@dataclass(frozen=True, eq=False)
class Settled:
    """A proven equilibrium."""

    answer: RationalAnswer
    unique_forces: bool
    ranges: tuple[Range, ...]  # (m,) of the normal forces
    motions: fmpq_mat  # (n, r) that nothing drives and nothing resists
    way: str  # how it was found


def settle(data: RationalProblem, guesses: Iterable[tuple[int, ...]], max_pivots: int) -> Settled:
    """The equilibrium, from the first guess that leads to it, or by Lemke's method.

    Raises
    ------
    NoSolution
        Proven: the constraints conflict, or the load drives a motion that nothing holds.
    Undecided
        Lemke's method did not end within `max_pivots`.
    """
    tried: set[tuple[int, ...]] = set()
    for guess in guesses:
        found = _corrected(data, tuple(sorted(guess)), tried)
        if found is not None:
            return found
    reduced = reduce_problem(data)
    force, motion, pivots = reduced.lemke(max_pivots)
    u = reduced.displaced(force, motion)
    found = balanced(data, u, way=f"Lemke's method, {pivots} pivots")
    if found is None:
        raise ArithmeticError("the complementary solution fails the exact proof")
    return found


def _corrected(data: RationalProblem, closed: tuple[int, ...], tried: set[tuple[int, ...]]) -> Settled | None:
    for count in range(MOST_CORRECTIONS):
        if closed in tried:
            return None
        tried.add(closed)
        system = system_of(data, Combination(closed))
        solved = system.solve()
        if solved is None:
            return None
        u, forces, only = solved
        overlap = {i for i, x in enumerate(data.gap(u).entries()) if x < 0}
        pulled = {i for i, x in zip(closed, forces.entries()[data.ties :], strict=True) if x < 0}
        if not overlap and (not pulled or not only):
            way = "the proposed set" if not count else f"the proposed set, corrected {count} times"
            found = balanced(data, u, (system, forces) if only else None, way)
            if found is not None:
                return found
        closed = tuple(sorted(({*closed} - pulled) | overlap))
    return None


def balanced(
    data: RationalProblem, u: fmpq_mat, known: tuple[System, fmpq_mat] | None = None, way: str = ""
) -> Settled | None:
    """The proven equilibrium at a displacement, or at its neighbours by free motions; None where there is none."""
    found = balance(data, u, known)
    if found is None:
        return None
    motions = zeros(data.unknowns, 0)
    if known is None or any(low == 0 for low, _ in (found.ranges[i] for i in found.system.combination.closed)):
        motions = _free_motions(data, found)
    if motions.ncols():
        u = _rested(data, u, motions)
    answer = found.system.answer(u, found.forces)
    if next(wrong(data, answer), None) is not None:
        return None
    return Settled(answer, found.only, found.ranges, motions, way)


def _free_motions(data: RationalProblem, found: Balance) -> fmpq_mat:
    """Motions (n, r) that neither K nor ties nor a contact that can carry a force resists."""
    pushing = [i for i, (_, high) in enumerate(found.ranges) if high is None or high > 0]
    w = data.width
    rubbing = [w * i + axis for i in pushing if data.friction[i] > 0 for axis in range(w)]
    return null_space(stack(data.K, data.A, take(data.E, pushing), take(data.T, rubbing)))


def _rested(data: RationalProblem, u: fmpq_mat, motions: fmpq_mat) -> fmpq_mat:
    """The displacement of least norm that differs by motions nothing resists and keeps the gaps."""
    rows = data.E * motions
    felt = [i for i, row in enumerate(rows.tolist()) if any(x != 0 for x in row)]
    family = Family(u, motions, take(data.gap(u), felt), -1 * take(rows, felt))
    return u + motions * family.least()
