"""The displacement of least norm among those that motions leave which nothing drives, and that of sparse equations.

Forces of redundant contacts with the least sum likewise, and sets of contacts that change one by one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.condensation import Condensation, free_motions
from contactqp.linalg.dense import orthonormal, saddle_point
from contactqp.linalg.equilibration import worst_of_neighbours
from contactqp.linalg.extended import ExtendedAnswer, SparseRows, extend, extended_rows, residuals_of
from contactqp.linalg.factorization import connected_parts, right_singular
from contactqp.linalg.floating import UNRESISTED
from contactqp.linalg.measures import lengths_that_meet
from contactqp.linalg.nonnegative import CARRIES, highs, shift_within_gaps
from contactqp.linalg.pardiso import INDEFINITE, EliminationOrder
from contactqp.linalg.schur import factorised
from contactqp.linalg.sparse_saddle import (
    REGULARISATIONS,
    SIGNED,
    SOLVED,
    ClosedState,
    Effort,
    kept_saddle,
    solved_on,
    with_right_signs,
)
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector, refuse_late
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# What double precision cannot tell from zero, relative to the lengths or forces that meet, or to the terms of a sum.
WITHIN_ROUNDING = 8 * EPS
# Corrections of a shift whose rounding leaves contacts penetrated: each leaves eps of the one before.
SHIFT_CORRECTIONS = 3
# Of a room that is 1 where there is any.
NO_ROOM = 0.5
# Forces that are so many times those that act press against each other.
PRESSED = 1e3
# Forces beneath this part of the largest may be what refinement has left.
FEW_DIGITS = 1e-18
# Changes of contacts one by one, times unknowns and contacts: where few are open at the end, some dozens lead there.
SINGLE_CHANGES = 600_000
# The same of a dual active set, for all answers from which it goes on.
DUAL_CHANGES = 1_500_000
# Contacts that close while the largest penetration does not halve, before it is given up: forces that rounding leaves
# unbalanced may drive motions without end.
IN_VAIN = 50
# Forces that fall by less than this for one on the row that is to close do not fall.
FALLS = 1e-9


def shift_to_least_norm(
    problem: ContactProblem, condensation: Condensation, answer: Answer, closed: Indices
) -> tuple[Vector, Array]:
    """Find the free motion that takes an answer to its least norm within the gaps.

    Parameters
    ----------
    problem : ContactProblem
    condensation : that of the problem
    answer : Answer
    closed : (q,) array of int, the contacts that resist

    Returns
    -------
    shift : (n,) array [length]
    free : (n, q) array
        An orthonormal basis of the free motions; those that contacts without a force block either way are none.
    """
    if not condensation.rigid.count:
        return np.zeros(problem.dimension), condensation.rigid.motions
    free = free_motions(condensation, saddle_point(condensation, closed))
    if not free.shape[1]:
        return np.zeros(problem.dimension), free
    shift = -(free.T @ answer.displacement)
    rows = problem.normal @ free
    # What a row feels of the motions is judged in the scale of the energy, in which units make no motion a small one.
    scale = condensation.unknown_scale
    basis = scale[:, None] * orthonormal(free / scale[:, None])
    felt = np.sqrt(problem.normal.power(2) @ scale**2)
    stays = np.linalg.norm(problem.normal @ basis, axis=1) > UNRESISTED * felt
    if not stays.any():
        return free @ shift, free
    gap = problem.gap - problem.normal @ answer.displacement
    moved = free @ shift_within_gaps(rows[stays], gap[stays], shift)
    shift = _out_of_contacts(problem, answer.displacement, moved, basis, np.flatnonzero(stays))
    room = problem.gap - problem.normal @ (answer.displacement + shift)
    length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement + shift)
    blocked = _blocked_either_way(problem.normal[stays & (room <= WITHIN_ROUNDING * length)] @ basis)
    return shift, orthonormal(basis @ blocked) if blocked is not None else free


def _blocked_either_way(rows: Array) -> Array | None:
    """Return the motions (q, r) that rows (p, q) of contacts that touch leave; None where they block none either way.

    Of all a with rows a <= 0 a row has rows_i a = 0 throughout where others oppose it, as two walls do that touch from
    both sides: those rows are the ones for which a linear program finds no room, max sum s, rows a + s <= 0, s <= 1.
    """
    count, dimension = rows.shape
    if count < 2:
        return None
    unit = rows / np.linalg.norm(rows, axis=1)[:, None]
    cost = np.concatenate([np.zeros(dimension), -np.ones(count)])
    bounds = [(None, None)] * dimension + [(0.0, 1.0)] * count
    found = highs(cost, A_ub=np.hstack([unit, np.eye(count)]), b_ub=np.zeros(count), bounds=bounds)
    if found is None or np.all(found.x[dimension:] > NO_ROOM):
        return None
    values, rotation = right_singular(unit[found.x[dimension:] <= NO_ROOM])
    return np.asarray(rotation[int(np.sum(values > UNRESISTED)) :].T)


def _out_of_contacts(problem: ContactProblem, start: Vector, shift: Vector, basis: Array, felt: Indices) -> Vector:
    """Correct a shift along free motions where its rounding leaves some contacts penetrated.

    The norm of a displacement is one of units: where these are far apart, contacts at unknowns that count little in it
    are met to few digits. What is missing is therefore found along a basis (n, q), orthonormal in the scale of the
    energy.
    """
    rows = problem.normal[felt] @ basis
    for _ in range(SHIFT_CORRECTIONS):
        room = (problem.gap - problem.normal @ (start + shift))[felt]
        length = lengths_that_meet(problem, problem.normal, problem.gap, start + shift)[felt]
        if np.all(room >= -WITHIN_ROUNDING * length):
            break
        shift = shift + basis @ shift_within_gaps(rows, room, np.zeros(basis.shape[1]))
    return shift


# Subtracted from the diagonal of the least solution's equations, beside rows of length one; refinement takes it back.
REGULARISATION, REFINEMENTS = 1e-12, 6


def least_solution(rows: Any, right: Vector) -> Vector:
    """Return the x (q,) of least norm with R x = b for a sparse R (p, q), whose rows may depend on each other.

    It is that of x + R' y = 0, R x - d y = b with a small d, refined until the rows are met as nearly as rounding
    permits. Where rows depend on each other its norm is the least one but for some 1e-4 of it.

    Raises BackendFailed: the factorisation ran out of memory, or met a pivot of zero.
    """
    lengths = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
    (p, q), unit = rows.shape, sp.csr_matrix(sp.diags(1.0 / lengths) @ rows)
    matrix = sp.bmat([[sp.identity(q), unit.T], [unit, -REGULARISATION * sp.identity(p)]], format="csc")
    solve = factorised(matrix, INDEFINITE, EliminationOrder(q), np.arange(q))
    found, last = np.zeros(q), np.inf
    for _ in range(REFINEMENTS):
        left = right / lengths - unit @ found
        size = float(np.max(abs(left), initial=0.0))
        if not 0 < size < last:
            break
        found, last = found + solve(np.concatenate([np.zeros(q), left]))[:q], size
    return np.asarray(found)


# Rows of which the weights that cancel best are found densely, and how often those of more rows are mended.
MOST_DENSE, CANCELLATIONS = 500, 2


def nearly_cancelling(rows: Any, scale: Vector, weights: Vector) -> Vector:
    """Return the weights (q,) for which the sum of unit rows is least; of many rows those near to given weights."""
    rows = sp.csr_matrix(rows @ sp.diags(scale))
    if rows.shape[0] <= MOST_DENSE:
        length = np.linalg.norm(rows.toarray(), axis=1)
        _, rotation = right_singular((rows.toarray() / length[:, None]).T)
        return np.asarray(rotation[-1] / length)
    across = SparseRows(rows.T.tocsr())
    for _ in range(CANCELLATIONS):
        part, left = sp.csr_matrix((sp.diags(abs(weights)) @ rows).T), (across @ extend(weights)).double()
        weights = weights * (1.0 - np.sign(weights) * least_solution(part, left))
    return weights


def presses(state: ClosedState) -> bool:
    """Return whether forces of contacts and ties are so large beside those that act that they may press in pairs."""
    problem = state.problem
    acting = float(np.max(problem.stiffness_sizes @ abs(state.answer.displacement.double()), initial=0.0))
    return state.force > PRESSED * max(acting, float(np.max(problem.load_size, initial=0.0)))


def with_least_forces(state: ClosedState, effort: Effort) -> ClosedState:
    """Return a state that holds, in which contacts and ties share what they carry with the least sum of forces.

    Repeated rows may share a force in ways without end, and an interior point may have pressed them against each other
    without bound. A linear program chooses contacts that carry it; the answer is solved anew on these.
    """
    problem, closed = state.problem, np.flatnonzero(state.closed)
    carried = carried_by_rows(problem, state.answer)
    size = float(np.max(abs(carried), initial=0.0)) or 1.0
    count, ties = len(closed), problem.ties
    found = highs(
        np.concatenate([np.ones(count), np.zeros(ties)]),
        A_eq=sp.hstack([problem.normal[closed].T, problem.tie.T], format="csr"),
        b_eq=carried / size,
        bounds=[(0, None)] * count + [(None, None)] * ties,
    )
    if found is None:
        return state
    force, kept = np.zeros(problem.contacts), state.closed.copy()
    force[closed] = size * found.x[:count]
    kept[closed] = found.x[:count] > CARRIES
    start = ExtendedAnswer(state.answer.displacement, extend(force), None, extend(size * found.x[count:]))
    least = with_right_signs(solved_on(problem, kept, start, effort), effort)
    return least if least.holds else state


def without_needless_forces(state: ClosedState) -> ClosedState:
    """Return a state without the forces of contacts and ties that nothing asks for.

    Where no load acts and displacements strain nothing, as where the problem is but to meet constraints, the forces are
    zero, and what refinement has left of them, however little, would be all that meets there. That is so for rows that
    hang together by the unknowns which they share if none of these has a load, and K u vanishes there to the last
    digits of the sum |K||u|.
    """
    problem, closed, answer = state.problem, np.flatnonzero(state.closed), state.answer.double()
    force = abs(np.concatenate([answer.normal_force[closed], answer.tie_force]))
    if not np.any((force > 0) & (force < FEW_DIGITS * state.force)):
        return state
    rows = sp.csr_array(sp.vstack([problem.normal[closed], problem.tie]))
    carried = state.left.force.double() + problem.normal.T @ answer.normal_force + problem.tie.T @ answer.tie_force
    strain = problem.stiffness_sizes @ abs(answer.displacement)
    asks = (problem.load_size > 0) | ((abs(carried) > SOLVED * strain) & (problem.diagonal > 0))
    part = connected_parts(sp.bmat([[None, rows], [rows.T, None]], format="csr"))[1]
    needed = np.isin(part[: len(force)], part[len(force) :][asks])
    if needed.all():
        return state
    kept = np.ones(problem.contacts)
    kept[closed] = needed[: len(closed)]
    normal = state.answer.normal_force.times(kept)
    tie = state.answer.tie_force.times(needed[len(closed) :].astype(float))
    return ClosedState.of(problem, state.closed, replace(state.answer, normal_force=normal, tie_force=tie))


def carried_by_rows(problem: ContactProblem, answer: ExtendedAnswer) -> Vector:
    """Return f - K u (n,), which the forces of contacts and ties balance [force]."""
    no_force, no_tie = extend(np.zeros(problem.contacts)), extend(np.zeros(problem.ties))
    resting = ExtendedAnswer(answer.displacement, no_force, None, no_tie)
    return residuals_of(extended_rows(problem), problem, resting).force.double()


def by_single_changes(state: ClosedState, effort: Effort) -> ClosedState:
    """Return the state that a primal active set leads to; `holds` says whether it solves the problem.

    Where contacts share unknowns, as rows of third differences do, tension spreads over all that lie beside one that
    opens, and no set is near to which all at once change. Penetrated contacts close first, then those in tension open,
    each the worst of those with which it shares an unknown; on the way to the solution without them contacts close in
    the order in which they are reached. The energy falls, so that no set comes twice (Nocedal and Wright 2006,
    algorithm 16.3).
    """
    problem, changes = state.problem, iter(range(SINGLE_CHANGES // max(len(state.closed) + len(state.problem.load), 1)))
    while state.solved and np.any(wrong := state.penetrated) and _goes_on(changes, effort):
        least = worst_of_neighbours(problem, np.where(wrong, -state.left.gap.double(), 0.0))
        state = solved_on(problem, state.closed | least, state.answer, effort)
    closings, openings = 0, 0
    while state.solved and not (state.holds or state.penetrated.any()) and _goes_on(changes, effort):
        pull = np.where(state.pulled, -state.answer.normal_force.double(), 0.0)
        # Where most that open close again, all but one are in vain.
        opened = worst_of_neighbours(problem, pull) if 2 * closings <= openings else pull == np.max(pull)
        closed, gap = state.closed & ~opened, np.where(state.closed, 0.0, np.maximum(state.left.gap.double(), 0.0))
        after, closings, openings = solved_on(problem, closed, state.answer, effort), 0, int(np.sum(opened))
        while after.solved and np.any(after.penetrated) and _goes_on(changes, effort):
            left, reached = after.left.gap.double(), np.flatnonzero(after.penetrated)
            part = gap[reached] / (gap[reached] - left[reached])
            gap = np.maximum(gap + np.min(part) * (left - gap), 0.0)
            closed = closed.copy()
            closed[reached[np.argmin(part)]] = True
            gap[closed], closings = 0.0, closings + 1
            after = solved_on(problem, closed, after.answer, effort)
        state = after
    return state


def _goes_on(changes: Iterator[int], effort: Effort) -> bool:
    refuse_late("contacts open and close one by one")
    return next(changes, None) is not None and not effort.exhausted()


def by_dual_steps(state: ClosedState, effort: Effort) -> ClosedState:
    """Return the state that a dual active set leads to; `holds` says whether it solves the problem.

    Where more contacts meet than unknowns can tell apart, rounding of the data decides which of them close, by forces
    and gaps far beneath those that act, and changes of all at once go round. Here contacts in tension open first, as
    long as the others balance the load. Then the contact that is penetrated most closes; on the way to the solution
    with it those open whose forces reach zero first, and where its row depends on closed ones, one of these in its
    place. No contact pulls on the way and the dual energy rises (Goldfarb and Idnani 1983).
    """
    most = DUAL_CHANGES // max(len(state.closed) + len(state.problem.load), 1)
    changes, effort.ranked, within = iter(range(effort.singles, most)), True, effort.most
    effort.most = np.inf  # these are counted by themselves
    if not state.solved:
        state = solved_on(state.problem, state.closed, state.answer, effort)
    least, since = np.inf, 0
    while state.solved and not state.holds and since < IN_VAIN and _goes_on(changes, effort):
        if np.any(pulled := state.pulled):
            state = solved_on(state.problem, state.closed & ~pulled, state.answer, effort)
            continue
        gap = np.where(state.penetrated, state.left.gap.double(), 0.0)
        least, since = (-np.min(gap), 0) if -np.min(gap) < least / 2 else (least, since + 1)
        after = _closing(state, int(np.argmin(gap)), changes, effort)
        if after is None:
            break
        state = after
    effort.ranked, effort.singles, effort.most = False, next(changes, most), within
    return state


def _closing(state: ClosedState, contact: int, changes: Iterator[int], effort: Effort) -> ClosedState | None:
    """Return the state that the dual active set leads to when a penetrated contact closes; None where it leads to none.

    Parameters
    ----------
    state : ClosedState, solved, in which no contact pulls
    contact : int, the one that is to close
    changes : those that are left
    effort : counts factorisations and back-substitutions
    """
    force, closed, answer = np.maximum(state.answer.normal_force.double(), 0.0), state.closed.copy(), state.answer
    closed[contact] = True
    while _goes_on(changes, effort):
        after = solved_on(state.problem, closed, answer, effort)
        if after.solved:
            answer, change = after.answer, after.answer.normal_force.double() - force
            falling = closed & (force + change < -SIGNED * after.force)
        else:  # the row depends on those of closed contacts, and contradicts them by more than rounding
            change = _pushed_by(state.problem, closed, contact, effort)
            falling = closed & (change < -FALLS)
        falling[contact] = False
        opening = np.flatnonzero(falling)
        if not opening.size:
            return after if after.solved else None
        part = force[opening] / -change[opening]
        force = np.where(closed, np.maximum(force + np.min(part) * change, 0.0), 0.0)
        first = opening[np.argmin(part)]
        closed[first], force[first] = False, 0.0
    return None


def _pushed_by(problem: ContactProblem, closed: Mask, contact: int, effort: Effort) -> Vector:
    """Return the change of contact forces (m,) when one contact pushes by one against the other closed ones."""
    others, change = closed.copy(), np.zeros(problem.contacts)
    others[contact] = False
    held = np.flatnonzero(others)
    push = -problem.normal[[contact]].toarray().ravel()
    saddle = kept_saddle(problem, others, REGULARISATIONS[0], effort)
    change[held] = saddle.solve(push, np.zeros(len(held)), np.zeros(problem.ties))[1]
    effort.back_substitutions += 1
    change[contact] = 1.0
    return change


def least_closing(rows: Array, ties: Array, excess: Vector) -> Vector:
    """Return the least w (p,) that meets rows w = -excess, ties w = 0 in the sense of least squares.

    Rows that are dependent to rounding count as dependent.
    """
    every = np.vstack([rows, ties])
    size = np.linalg.norm(every, axis=1)
    wanted = np.concatenate([-excess, np.zeros(len(ties))]) / size
    return np.asarray(np.linalg.lstsq(every / size[:, None], wanted, rcond=WITHIN_ROUNDING)[0])
