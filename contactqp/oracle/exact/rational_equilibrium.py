"""Solve, correct and prove the contact states (open, closed, stick, slip) proposed in floating point.

Without friction, of several equilibria (which differ by unresisted motions without drive) the one of least norm within
the gaps is returned, and of its forces, if contacts are redundant, those of least norm.

With friction, slip goes one way or the other in the plane. In space its direction has to be rational; t = (1 - q^2, 2
q) / (1 + q^2) gives all rational directions, and the one nearest to the floating-point slip is tried.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat

from contactqp.errors import Unsupported
from contactqp.linalg.rational import (
    NoSolution,
    beside,
    column,
    fraction,
    fractions_of,
    from_fraction,
    least_change,
    null_space,
    row_basis,
    solve_any,
    stack,
    take,
    take_columns,
    zeros,
)
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.oracle.exact.rational_problem import (
    Family,
    Range,
    RationalAnswer,
    RationalProblem,
    block_of,
    blocks,
    reduce_problem,
    wrong,
)
from contactqp.solving.friction.exact_enumeration import (
    MOST_CONTACTS,
    MOST_UNKNOWNS,
    ExactEquilibrium,
    exact_equilibria,
)

# The linear system of one combination of open, closed, stick and slip, in rational numbers.
#
#     [ K    A'   P'   T_b' ] [ u   ]   [ f ]
#     [ A                   ] [ nu  ] = [ b ]       c: closed contacts, b: those of them that stick,
#     [ E_c                 ] [ l_N ]   [ g ]       P = E_c, with mu t'E_T added where a contact slips along t
#     [ T_b                 ] [ l_T ]   [ o ]
#
# Without friction P = E_c: the system of a closed set.

Direction = tuple[fmpq, ...]  # (d-1,) of unit length


@dataclass(frozen=True)
class Combination:
    """The closed contacts, those of them that stick, and the slip directions of the others."""

    closed: tuple[int, ...]
    stuck: tuple[int, ...] = ()
    directions: Mapping[int, Direction] = field(default_factory=dict)

    @property
    def key(self) -> Any:
        return self.closed, self.stuck, tuple(sorted((i, tuple(map(str, t))) for i, t in self.directions.items()))


@dataclass(frozen=True, eq=False)
class System:
    """The linear system of a combination: rows that constrain displacements, and rows along which forces act."""

    data: RationalProblem
    combination: Combination
    held: fmpq_mat  # (k + c + b, n) A, E_c, T_b
    limit: fmpq_mat  # (k + c + b, 1)
    pushed: fmpq_mat  # (k + c + b, n) A, P, T_b

    @property
    def matrix(self) -> fmpq_mat:
        """Return the matrix [[K, P'], [H, 0]] of displacements and forces, with constraints H and force directions
        P.
        """
        rows = self.held.nrows()
        return stack(beside(self.data.K, self.pushed.transpose()), beside(self.held, zeros(rows, rows)))

    def solve(self) -> tuple[fmpq_mat, fmpq_mat, bool] | None:
        """Return u, the forces (k + c + b, 1) and whether both are unique, None if it is proven that none exist."""
        n, rows = self.data.unknowns, self.held.nrows()
        found = solve_any(self.matrix, stack(self.data.f, self.limit))
        if found is None:
            return None
        x, only = found
        return take(x, range(n)), take(x, range(n, n + rows)), only

    def answer(self, u: fmpq_mat, forces: fmpq_mat) -> RationalAnswer:
        """Return u with the forces sorted by contact."""
        data, chosen, values = self.data, self.combination, forces.entries()
        push, drag = zeros(data.contacts, 1), zeros(data.T.nrows(), 1)
        k, w = data.ties, data.width
        for at, i in enumerate(chosen.closed):
            push[i, 0] = values[k + at]
            for axis, t in enumerate(chosen.directions.get(i, ())):
                drag[w * i + axis, 0] = data.friction[i] * t * values[k + at]
        for at, i in enumerate(chosen.stuck):
            for axis in range(w):
                drag[w * i + axis, 0] = values[k + len(chosen.closed) + w * at + axis]
        return RationalAnswer(u, push, drag, take(forces, range(k)))


def system_of(data: RationalProblem, combination: Combination) -> System:
    """Return the linear system of one combination of open, stick and slip."""
    closed, w = combination.closed, data.width
    normal = take(data.E, closed)
    sticking = [w * i + axis for i in combination.stuck for axis in range(w)]
    stuck, origin = take(data.T, sticking), take(data.slip_origin, sticking)
    pushes = normal
    if combination.directions:
        drag = zeros(len(closed), data.unknowns)
        table = data.T.tolist()
        for at, i in enumerate(closed):
            for axis, t in enumerate(combination.directions.get(i, ())):
                for j, x in enumerate(table[w * i + axis]):
                    if x != 0:
                        drag[at, j] = drag[at, j] + data.friction[i] * t * x
        pushes = normal + drag
    return System(
        data,
        combination,
        held=stack(data.A, normal, stuck),
        limit=stack(data.b, take(data.g, closed), origin),
        pushed=stack(data.A, pushes, stuck),
    )


NO_RANGE: Range = (fraction(fmpq(0)), fraction(fmpq(0)))


@dataclass(frozen=True, eq=False)
class Balance:
    """The contact and tie forces of a displacement: those of least norm (k + c + b, 1), contact forces before ties'.

    A displacement determines the states of contacts: those without gap have forces, with friction along their slip, or
    within the cone if they do not slip. The remaining conditions are linear,

        P'l = f - K u,    l_N >= 0,    mu l_N - |l_T| >= 0 where it sticks,

    with P the rows along which forces act.
    """

    system: System
    forces: fmpq_mat
    only: bool  # whether the contact and tie forces are unique
    ranges: tuple[Range, ...]  # (m,) of the normal forces


def states(data: RationalProblem, u: fmpq_mat) -> Combination:
    """Return the contact states of a displacement: closed contacts, sticking ones, and slip directions of the
    others.
    """
    closed = tuple(i for i, x in enumerate(data.gap(u).entries()) if x == 0)
    frictional = [i for i in closed if data.friction[i] > 0]
    if not frictional:
        return Combination(closed)
    slip, w = data.slip(u).entries(), data.width
    stuck, directions = list[int](), dict[int, Direction]()
    for i in frictional:
        moved = slip[w * i : w * (i + 1)]
        if any(moved):
            directions[i] = unit(moved)
        else:
            stuck.append(i)
    return Combination(closed, tuple(stuck), directions)


def unit(vector: list[fmpq]) -> Direction:
    """Return the rational unit vector v / |v|.

    Raises
    ------
    Unsupported
        |v| is irrational.
    """
    square = sum((x * x for x in vector), fmpq(0))
    p, q = int(square.p), int(square.q)
    root = fmpq(math.isqrt(p), math.isqrt(q))
    if root * root != square:
        raise Unsupported("exact: a contact slips along a direction whose length is irrational")
    return tuple(x / root for x in vector)


def balance(data: RationalProblem, u: fmpq_mat, solved: tuple[System, fmpq_mat] | None = None) -> Balance | None:
    """Return the forces of a displacement, None if it is proven that there are none; `solved` are the unique ones of
    their system.
    """
    chosen = states(data, u)
    if solved is not None and solved[0].combination.key == chosen.key:
        system, start = solved
        directions = zeros(start.nrows(), 0)
    else:
        system = system_of(data, chosen)
        across = system.pushed.transpose()
        found = solve_any(across, data.f - data.K * u)
        if found is None:
            return None
        start, directions = found[0], zeros(across.ncols(), 0) if found[1] else null_space(across)
    conditions = stack(*_conditions(system)) if chosen.closed else zeros(0, start.nrows())
    if not directions.ncols():
        push = start.entries()[data.ties :]
        if any(x < 0 for x in (conditions * start).entries()):
            return None
        return Balance(system, start, True, _laid_out(data, chosen, [(fraction(x), fraction(x)) for x in push]))
    if chosen.stuck and data.width > 1:
        raise Unsupported("exact: contact forces are not unique, and the cones of friction in space are not linear")
    return _least(system, start, directions, conditions)


def _conditions(system: System) -> Iterator[fmpq_mat]:
    """Yield the rows whose products with the forces must not be negative: l_N, and for sticking contacts mu l_N -+
    l_T.
    """
    data, chosen = system.data, system.combination
    size, k = system.pushed.nrows(), data.ties
    for at, i in enumerate(chosen.closed):
        row = zeros(1, size)
        row[0, k + at] = fmpq(1)
        yield row
        if i in chosen.stuck and data.width == 1:
            drag = k + len(chosen.closed) + chosen.stuck.index(i)
            for sign in (-1, 1):
                row = zeros(1, size)
                row[0, k + at], row[0, drag] = data.friction[i], fmpq(sign)
                yield row


def _least(system: System, start: fmpq_mat, directions: fmpq_mat, conditions: fmpq_mat) -> Balance | None:
    data, chosen = system.data, system.combination
    k, contacts = data.ties, range(data.ties, start.nrows())
    moved = take(directions, contacts)
    # Directions that change no contact force, if only ties are redundant.
    idle = directions * null_space(moved)
    shifts = take_columns(directions, row_basis(moved.transpose()))
    family = Family(take(start, contacts), take(shifts, contacts), conditions * start, conditions * shifts)
    if not shifts.ncols() and any(x < 0 for x in family.room.entries()):
        return None
    if shifts.ncols():
        try:
            start = start + shifts * family.least()
        except NoSolution:
            return None
    start = least_change(idle, start)
    ranges: list[Range] = [(fraction(x), fraction(x)) for x in start.entries()[k:]]
    for columns in blocks(family.directions, family.slope):
        part = block_of(family, columns)
        entries = [place for place, row in enumerate(part.directions.tolist()) if any(x != 0 for x in row)]
        for place, ends in zip(entries, part.ranges(entries), strict=True):
            ranges[place] = ends
    only = not idle.ncols() and all(low == high and low is not None for low, high in ranges)
    return Balance(system, start, only, _laid_out(data, chosen, ranges))


def _laid_out(data: RationalProblem, chosen: Combination, ranges: list[Range]) -> tuple[Range, ...]:
    known = dict(zip(chosen.closed, ranges, strict=False))
    return tuple(known.get(i, NO_RANGE) for i in range(data.contacts))


# The most corrections of a proposed set before Lemke's method is used.
MOST_CORRECTIONS = 20


@dataclass(frozen=True, eq=False)
class Settled:
    """A proven equilibrium."""

    answer: RationalAnswer
    unique_forces: bool
    ranges: tuple[Range, ...]  # (m,) of the normal forces
    motions: fmpq_mat  # (n, r) unresisted motions without drive
    way: str  # how it was found


def settle(data: RationalProblem, guesses: Iterable[tuple[int, ...]], max_pivots: int) -> Settled:
    """Return the equilibrium from the first guess that leads to one, or by Lemke's method.

    Raises NoSolution: proven: the constraints conflict, or the load drives a motion that nothing resists; Undecided:
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
    data: RationalProblem, u: fmpq_mat, solved: tuple[System, fmpq_mat] | None = None, way: str = ""
) -> Settled | None:
    """Return the proven equilibrium at a displacement or shifted by free motions, None if there is none.

    Parameters
    ----------
    data : RationalProblem
    u : (n, 1) fmpq_mat, the displacement
    solved : System and (r, 1) fmpq_mat, optional
        A combination and its forces that balance the displacement, where they are known.
    way : how the displacement was found; the result keeps it
    """
    found = balance(data, u, solved)
    if found is None:
        return None
    motions = zeros(data.unknowns, 0)
    if solved is None or any(low == 0 for low, _ in (found.ranges[i] for i in found.system.combination.closed)):
        motions = _free_motions(data, found)
    if motions.ncols():
        try:
            u = _rested(data, u, motions)
        except NoSolution:  # contacts without force overlap wherever the bodies drift
            return None
        motions = _left_by_gaps(data, u, motions)
        # With friction, contacts that slip or are open elsewhere may stick here, and share forces.
        if data.frictional and (found := balance(data, u)) is None:
            return None
    answer = found.system.answer(u, found.forces)
    if next(wrong(data, answer), None) is not None:
        return None
    return Settled(answer, found.only, found.ranges, motions, way)


def _free_motions(data: RationalProblem, found: Balance) -> fmpq_mat:
    """Return the motions (n, r) not resisted by K, ties or contacts that may have a force."""
    pushing = [i for i, (_, high) in enumerate(found.ranges) if high is None or high > 0]
    w = data.width
    frictional = [w * i + axis for i in pushing if data.friction[i] > 0 for axis in range(w)]
    return null_space(stack(data.K, data.A, take(data.E, pushing), take(data.T, frictional)))


def _rested(data: RationalProblem, u: fmpq_mat, motions: fmpq_mat) -> fmpq_mat:
    """Return the displacement of least norm that differs by unresisted motions and satisfies the gaps."""
    rows = data.E * motions
    felt = [i for i, row in enumerate(rows.tolist()) if any(x != 0 for x in row)]
    family = Family(u, motions, take(data.gap(u), felt), -1 * take(rows, felt))
    return u + motions * family.least()


def _left_by_gaps(data: RationalProblem, u: fmpq_mat, motions: fmpq_mat) -> fmpq_mat:
    """Return the motions (n, r) that remain if contacts that touch at u block motions from both sides.

    The gap of such a contact is zero at every admissible displacement reached by the motions.
    """
    rows, gap = data.E * motions, data.gap(u)
    touching = [i for i, row in enumerate(rows.tolist()) if gap[i, 0] == 0 and any(x != 0 for x in row)]
    slope = -1 * take(rows, touching)
    nothing = zeros(len(touching), 1)
    reached = Family(nothing, slope, nothing, slope).ranges(range(len(touching))) if len(touching) > 1 else []
    blocking = [i for i, (_, most) in zip(touching, reached, strict=False) if most == 0]
    return motions * null_space(take(rows, blocking)) if blocking else motions


# All 4^3 combinations take some ten milliseconds; for more contacts they are tried only if the proposal fails.
LISTED = 3
# The largest denominator of q, as directions in input files have small numbers.
DENOMINATOR = 10**5


@dataclass(frozen=True, eq=False)
class Proposal:
    """The floating-point answer of a problem with friction, None if it failed."""

    problem: ContactProblem
    solution: Solution | None


@dataclass(frozen=True, eq=False)
class SettledWithFriction:
    """A proven equilibrium, and the number of equilibria (None: not counted)."""

    settled: Settled
    equilibria: int | None
    continuum: bool = False


def settle_with_friction(data: RationalProblem, proposal: Proposal) -> SettledWithFriction | None:
    """Return a proven equilibrium, None if it is proven that no combination of open, stick and slip is one.

    Raises
    ------
    Unsupported
        In space, irrational slip directions; or the proposal fails and there are too many combinations.
    """
    way = "the proposed combination of open, stick and slip"
    found = next((one for u in _proposed(data, proposal.solution) if (one := balanced(data, u, way=way))), None)
    countable = data.width == 1 and data.contacts <= MOST_CONTACTS and data.unknowns <= MOST_UNKNOWNS
    if found is not None and not (countable and data.contacts <= LISTED):
        return SettledWithFriction(found, None)
    if not countable:
        where = "the slip directions of floats are not rational" if data.width > 1 else "its signs fail exactly"
        raise Unsupported(f"exact: the combination of open, stick and slip that floats propose is not proven: {where}")
    states = exact_equilibria(proposal.problem, **_numbers(data))
    if not states:
        return None
    count, continuum = len(states), any(one.continuum for one in states)
    if found is not None:
        return SettledWithFriction(found, count, continuum)
    for state in sorted(states, key=lambda state: _distance(state, proposal.solution)):
        way = "all combinations of open, stick and slip"
        if (found := balanced(data, column(state.displacement), way=way)) is not None:
            return SettledWithFriction(found, count, continuum)
    raise ArithmeticError("a listed equilibrium fails the exact proof")


def _distance(state: ExactEquilibrium, solution: Solution | None) -> float:
    if solution is None:
        return 0.0
    return float(np.linalg.norm(state.displacement.astype(float) - solution.displacement))


def _proposed(data: RationalProblem, solution: Solution | None) -> Iterator[fmpq_mat]:
    """Yield the displacements of the floating-point combination, and of that with grazing contacts closed."""
    if solution is None:
        return
    states = solution.contact_status
    for touching in (False, True):
        closed = tuple(i for i, word in enumerate(states) if word != "open" and (touching or word != "grazing"))
        stuck = tuple(i for i in closed if data.friction[i] > 0 and states[i] != "slip")
        directions = {i: d for i in closed if states[i] == "slip" and (d := _direction(solution, i))}
        solved = system_of(data, Combination(closed, stuck, directions)).solve()
        if solved is not None:
            yield solved[0]
        if "grazing" not in states:
            return


def _direction(solution: Solution, contact: int) -> Direction | None:
    if solution.friction_force is None:
        return None
    force = np.asarray(solution.friction_force[contact])
    size = float(np.linalg.norm(force))
    if size == 0:
        return None
    if len(force) == 1:
        return (fmpq(1 if force[0] > 0 else -1),)
    x, y = (force / size).tolist()
    if x <= -1 + 1e-12:
        return fmpq(-1), fmpq(0)
    q = from_fraction(Fraction(y / (1 + x)).limit_denominator(DENOMINATOR))
    return (1 - q * q) / (1 + q * q), 2 * q / (1 + q * q)


def _numbers(data: RationalProblem) -> dict[str, Any]:
    """Return the data as arrays of Fractions, by the names of `exact_equilibria`."""
    parts = dict(stiffness=data.K, load=data.f, normal=data.E, gap=data.g, tangent=data.T, tie=data.A)
    parts.update(tie_value=data.b, slip_origin=data.slip_origin)
    numbers: dict[str, Any] = {name: fractions_of(part) for name, part in parts.items()}
    return numbers | {"friction": [fraction(mu) for mu in data.friction]}
