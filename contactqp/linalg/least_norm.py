"""Minimum-norm displacements along free motions, redundant forces of least sum, and active sets of single changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.condensation import Condensation, free_motions
from contactqp.linalg.convexity import motions_of_dense
from contactqp.linalg.dense import orthonormal, saddle_point, unknown_scale
from contactqp.linalg.equilibration import entries_of, rows_alone, worst_of_neighbours
from contactqp.linalg.extended import ExtendedAnswer, extend, extended_rows, residuals_of
from contactqp.linalg.factorization import connected_parts, null_space_by_part
from contactqp.linalg.floating import UNRESISTED, blocked_either_way, free_of_bodies
from contactqp.linalg.measures import bodies, lengths_that_meet
from contactqp.linalg.nonnegative import CARRIES, LESS, by_strict_programs, highs, shift_within_gaps
from contactqp.linalg.sparse_saddle import (
    REGULARISATIONS,
    SIGNED,
    SOLVED,
    WASTED,
    ClosedState,
    Effort,
    by_pivots,
    kept_saddle,
    solved_on,
    with_right_signs,
)
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector, refuse_late
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# Rounding in double precision, relative to the lengths or forces that meet, or to the terms of a sum.
WITHIN_ROUNDING = 8 * EPS
SHIFT_CORRECTIONS = 3  # of a shift that penetrates contacts by rounding; each reduces this by eps
UNMOVED = 1e-12  # rows that a shift moves by this part of the lengths that meet resist it to rounding
SHIFTED = 1e-9  # a shift out of contacts goes further by this part
# Forces beyond this multiple of the acting ones are self-equilibrated.
PRESSED = 1e3
FEW_DIGITS = 1e-18  # forces below this part of the largest may be rounding errors of refinement
# The budgets of single changes from all starts, multiplied by unknowns and contacts, and by entries of K and the rows.
SINGLE_CHANGES, SINGLE_ENTRIES = 600_000, 4_000_000
DUAL_CHANGES = 1_500_000  # the budget of a dual active set for all its starts
# The most contacts that close without halving the largest penetration, as residuals may drive unbounded motions.
IN_VAIN = 50
# Contacts that close at last, and changes for each; penetrations of so many residuals of closed ones are not rounding.
LAST_CLOSINGS, STANDS_OUT = 10, 1e2
# Rates of forces below this, per unit force on the closing row, count as zero.
FALLS = 1e-9


def shift_to_least_norm(
    problem: ContactProblem, condensation: Condensation, answer: Answer, closed: Indices
) -> tuple[Vector, Array]:
    """Return the free motion that minimises the norm of an answer within the gaps.

    Parameters
    ----------
    problem : ContactProblem
    condensation : the Condensation of the problem
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
    scale = (D := condensation.unknown_scale)[:, None]
    return _shift_along(problem, (free, scale * orthonormal(free / scale)), D, answer)


# The most operations on free motions: the larger of unknowns and rows times the square of their number, or of rows and
# motions of bodies; and those for each and each entry of a dense K, whose null space is found in extended precision.
MOST_MOVED, MOST_OF_BODIES, OF_ENTRIES = 100_000_000, 600_000_000, 25


def sparse_shift_to_least_norm(problem: ContactProblem, answer: Answer, closed: Indices) -> tuple[Vector, Array]:
    """Return the shift and the free motions of `shift_to_least_norm` without condensing.

    Parameters are those of `shift_to_least_norm`. There are no motions where these would take longer than most answers,
    as with a thousand unknowns without stiffness, or a dense K of 400 with half as many motions without energy.
    """
    none, (n, rows) = np.zeros(problem.dimension), (problem.dimension, len(closed) + problem.ties)
    bare, dense = np.count_nonzero(problem.diagonal == 0), OF_ENTRIES * problem.stiffness_rows.nnz
    if max(n, rows) * bare**2 > MOST_MOVED or dense * motions_of_dense(problem) > MOST_MOVED:
        return none, none[:, None][:, :0]
    motions, scale = null_space_by_part(problem.stiffness_rows)[0], unknown_scale(problem)
    if not (r := motions.shape[1]) or max(r, rows) * r**2 > MOST_OF_BODIES:
        return none, none[:, None][:, :0]
    held = sp.vstack([problem.normal[closed], problem.tie], format="csr")
    return _shift_along(problem, free_of_bodies(motions, bodies(problem), held, scale), scale, answer)


def _shift_along(
    problem: ContactProblem, bases: tuple[Array, Array], scale: Vector, answer: Answer
) -> tuple[Vector, Array]:
    """Return `shift_to_least_norm` along what both bases (n, q) span, orthonormal and so over the `scale` of energy."""
    free, basis = bases
    if not free.shape[1]:
        return np.zeros(problem.dimension), free
    shift, rows = -(free.T @ answer.displacement), problem.normal @ free
    felt = np.sqrt(problem.normal.power(2) @ scale**2)
    stays = np.linalg.norm(problem.normal @ basis, axis=1) > UNRESISTED * felt
    if not stays.any():
        return free @ shift, free
    gap = problem.gap - problem.normal @ answer.displacement
    moved = free @ shift_within_gaps(rows[stays], gap[stays], shift)
    shift = _out_of_contacts(problem, answer.displacement, moved, basis, np.flatnonzero(stays))
    room = problem.gap - problem.normal @ (answer.displacement + shift)
    length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement + shift)
    blocked = blocked_either_way(problem.normal[stays & (room <= WITHIN_ROUNDING * length)] @ basis)
    return shift, orthonormal(basis @ blocked) if blocked is not None else free


def at_rest(
    problem: ContactProblem,
    condensation: Condensation | None,
    solved: tuple[ClosedState, Answer],
    pushing: Indices,
    unit: Vector,
) -> tuple[ClosedState, Array]:
    """Return a state of sparse systems without its part along free motions, and these (n, q), orthonormal.

    It stays, without free motions, where rounding in far units decides what is free, and rows that resist would move.

    Parameters
    ----------
    problem : ContactProblem
    condensation : the Condensation of the problem; None where it is not to be condensed
    solved : the state, of the equilibrated problem, and its answer in the units of the problem
    pushing : (q,) array of int, the contacts that resist
    unit : (n,) array, the displacements of the problem for one of the equilibrated problem
    """
    state, answer = solved
    if condensation is None:
        shift, free = sparse_shift_to_least_norm(problem, answer, pushing)
    else:
        shift, free = shift_to_least_norm(problem, condensation, answer, pushing)
    closed = state.closed & (problem.normal @ shift == 0)
    closed[pushing] = state.closed[pushing]
    reach = abs(answer.displacement) + abs(shift)
    for rows, limit in ((problem.normal[pushing], problem.gap[pushing]), (problem.tie, problem.tie_value)):
        if np.any(abs(rows @ shift) > UNMOVED * lengths_that_meet(problem, rows, limit, reach)):
            return state, free[:, :0]
    moved = replace(state.answer, displacement=state.answer.displacement + extend(shift / unit))
    return _out_of_rounding(ClosedState.of(state.problem, closed, moved), free / unit[:, None]), free


def _out_of_rounding(state: ClosedState, motions: Array) -> ClosedState:
    """Return a state shifted along free motions (n, q) out of contacts that are penetrated by rounding."""
    rows = state.problem.normal @ motions
    for _ in range(SHIFT_CORRECTIONS):
        if not state.penetrated.any():
            break
        gap = state.left.gap.double()
        met = np.flatnonzero((gap < WITHIN_ROUNDING * state.length) & np.any(rows != 0, axis=1))
        shift = shift_within_gaps(rows[met], gap[met] - SHIFTED * abs(gap[met]), np.zeros(motions.shape[1]))
        moved = replace(state.answer, displacement=state.answer.displacement + extend(motions @ shift))
        state = ClosedState.of(state.problem, state.closed, moved)
    return state


def _out_of_contacts(problem: ContactProblem, start: Vector, shift: Vector, basis: Array, felt: Indices) -> Vector:
    """Correct a shift along free motions that penetrates contacts by rounding.

    The norm of a displacement depends on units, and contacts at unknowns with little weight are satisfied to few
    digits. So the correction is found along a basis (n, q) that is orthonormal in the scale of energy.
    """
    rows = problem.normal[felt] @ basis
    for _ in range(SHIFT_CORRECTIONS):
        room = (problem.gap - problem.normal @ (start + shift))[felt]
        length = lengths_that_meet(problem, problem.normal, problem.gap, start + shift)[felt]
        if np.all(room >= -WITHIN_ROUNDING * length):
            break
        shift = shift + basis @ shift_within_gaps(rows, room, np.zeros(basis.shape[1]))
    return shift


def presses(state: ClosedState) -> bool:
    """Return whether contact and tie forces are so large that they may be self-equilibrated."""
    problem = state.problem
    acting = float(np.max(problem.stiffness_sizes @ abs(state.answer.displacement.double()), initial=0.0))
    return state.force > PRESSED * max(acting, float(np.max(problem.load_size, initial=0.0)))


def with_least_forces(state: ClosedState, effort: Effort) -> ClosedState:
    """Return a solution in which contacts and ties carry the load with the least sum of forces.

    Repeated rows may share a force arbitrarily, and an interior point may return large self-equilibrated forces. A
    linear program selects contacts that carry the load, and the answer is solved again with these.
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
    """Return a state with zero forces of contacts and ties where neither load nor strain requires any.

    As in a feasibility problem, forces are zero where rows connected by shared unknowns have no load and K u vanishes
    to the last digits of |K||u|. Rounding errors of refinement would otherwise be the only forces that meet there.
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
    """Return the state of a primal active set; `holds` tells whether it solves the problem.

    Where contacts share unknowns, as with rows of third differences, tension spreads over the neighbours of a contact
    that opens, so that changing all at once does not converge. Penetrated contacts close first, then those in tension
    open, each the worst of those with which it shares an unknown; on the way to the solution without them contacts
    close in the order in which they are reached. The energy decreases, so that no set recurs (Nocedal and Wright 2006,
    algorithm 16.3).
    """
    problem = state.problem
    most = min(SINGLE_CHANGES // (len(state.closed) + problem.dimension), SINGLE_ENTRIES // entries_of(problem))
    changes = iter(range(effort.changed, most))
    while state.solved and np.any(wrong := state.penetrated) and _goes_on(changes, effort):
        least = worst_of_neighbours(problem, np.where(wrong, -state.left.gap.double(), 0.0))
        state = solved_on(problem, state.closed | least, state.answer, effort)
    closings = openings = 0
    while state.solved and not (state.holds or state.penetrated.any()) and _goes_on(changes, effort):
        pull = np.where(state.pulled, -state.answer.normal_force.double(), 0.0)
        # If most of the opened contacts close again, only one is opened at a time.
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
    effort.changed = next(changes, most)
    return state


def _goes_on(changes: Iterator[int], effort: Effort) -> bool:
    refuse_late("contacts open and close one by one")
    return next(changes, None) is not None and not effort.exhausted()


def by_dual_steps(state: ClosedState, effort: Effort) -> ClosedState:
    """Return the state of a dual active set; `holds` tells whether it solves the problem.

    Where more contacts meet than there are independent rows, rounding of the data determines which close, and changing
    all at once cycles. Here contacts in tension open first, as long as the others balance the load. Then the most
    penetrated contact closes; contacts open whose forces reach zero first, and if its row depends on closed ones, one
    of these. No contact is in tension and the dual energy increases (Goldfarb and Idnani 1983).
    """
    most = DUAL_CHANGES // max(len(state.closed) + len(state.problem.load), 1)
    changes, effort.ranked, within = iter(range(effort.singles, most)), True, effort.most
    effort.most = np.inf  # counted separately
    state = state if state.solved else solved_on(state.problem, state.closed, state.answer, effort)
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
    """Return the state of the dual active set after a penetrated contact closes, None if there is none.

    Parameters
    ----------
    state : ClosedState, solved, in which no contact pulls
    contact : int, the one that is to close
    changes : the number of changes that are left
    effort : counts factorisations and back-substitutions
    """
    force, closed, answer = np.maximum(state.answer.normal_force.double(), 0.0), state.closed.copy(), state.answer
    closed[contact] = True
    while _goes_on(changes, effort):
        after = solved_on(state.problem, closed, answer, effort)
        if after.solved:
            answer, change = after.answer, after.answer.normal_force.double() - force
            falling = closed & (force + change < -SIGNED * after.force)
        else:  # the row depends on closed ones and contradicts them beyond rounding
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


def by_last_closings(state: ClosedState, effort: Effort) -> ClosedState:
    """Return a solution in which contacts are also closed that are penetrated by less than has a sign elsewhere.

    Forces on rows that nearly depend on each other move these by 1e-21 of the largest length and less.
    """
    for _ in range(LAST_CLOSINGS):
        gap, left = np.where(state.closed, 0.0, state.left.gap.double()), state.length_residual
        rounding, sign = max(SOLVED, left), max(SOLVED, STANDS_OUT * left) * state.length
        if not (state.holds and np.min(gap, initial=0.0) < -sign):
            break
        after = _closing(state, int(np.argmin(gap)), iter(range(LAST_CLOSINGS)), effort)
        after = by_pivots(after, effort) if after is not None and after.length_residual > rounding else after
        if after is None or not after.holds or after.length_residual > rounding:
            break
        state = after
    return state


def _pushed_by(problem: ContactProblem, closed: Mask, contact: int, effort: Effort) -> Vector:
    """Return the change of contact forces (m,) by a unit force on one contact with the others closed."""
    others, change = closed.copy(), np.zeros(problem.contacts)
    others[contact] = False
    held = np.flatnonzero(others)
    push = -problem.normal[[contact]].toarray().ravel()
    saddle = kept_saddle(problem, others, REGULARISATIONS[0], effort)
    change[held] = saddle.solve(push, np.zeros(len(held)), np.zeros(problem.ties))[1]
    effort.back_substitutions += 1
    change[contact] = 1.0
    return change


# Rounds in which an answer is corrected, and those that lead to nothing better than a solution.
ROUNDS, IN_VAIN_AT_BEST = 12, 2
# What is added to the diagonal at first, more by this factor where factors break, and the length of corrections then.
ADDED, MORE, LONGER = 1e-3, 10.0, 1e3
# Forces that balance to this part of the largest leave nothing to correct.
NONE_LEFT = 1e-20
# Contacts whose force is so many times what is unbalanced stay closed; where one of these pulls, so many times more.
STAYS, STAYS_MORE = 1e6, 1e9
# The least D and d: beneath, no signs are known.
LEAST_LENGTH, LEAST_FORCE = 1e-30, 1e-26
# Products that corrections and their first factors may take: some seconds; fewer while other backends may be asked.
PRODUCTS, AS_A_BACKEND = 1e10, 1e8


def by_corrections(state: ClosedState, effort: Effort) -> ClosedState:
    """Return the state that corrections of an answer lead to; `holds` says whether it solves the problem.

    In units D of a length and d of a force the change v of u, and forces l of contacts in place of l0, minimise

        1/2 v'(D/d K) v - (r + E'l0)'v / d    subject to    E v <= (g - E u) / D,    A v = (b - A u) / D

    where r is what l0 and the ties leave unbalanced. D and d are the errors of the answer, in extended precision, so
    that contacts are distinguished that close or open by rounding of the data alone (Gleixner, Steffy and Wolter 2016
    for linear programs, Weber, Sager and Gleixner 2019 for quadratic ones). Unknowns without stiffness get some, which
    acts from where the program before has led (Rockafellar 1976), so that a dual active set leads to the one solution
    (`StrictProgram`). From its set of contacts `by_dual_steps` goes on.

    Parameters
    ----------
    state : ClosedState, of the contacts and the answer to begin with
    effort : counts factorisations and back-substitutions
    """
    problem = state.problem
    n, q = problem.dimension, problem.contacts + problem.ties
    if (n + q) * n**2 > (PRODUCTS if effort.wasted >= WASTED else AS_A_BACKEND):
        effort.cut |= (n + q) * n**2 <= PRODUCTS
        return state
    steps = iter(range(effort.corrected, most := int(PRODUCTS / ((4 * n + q) * n))))
    _, gap, tie = state.left.double(np.flatnonzero(state.closed))
    length = float(np.max(abs(np.concatenate([gap, tie])), initial=0.0))
    best, since, answer, closed, added = state, 0, state.answer, state.closed, ADDED
    for _ in range(ROUNDS):
        found = _corrected(problem, (answer, closed), length, added, steps)
        if found is None:
            if next(steps, None) is None:
                break
            added, length = added * MORE, length * LONGER
            continue
        answer, closed, moved = found
        length, after = LESS * moved, solved_on(problem, closed, answer, effort)
        if after.solved and not after.holds:
            after = by_dual_steps(after, effort)
        better = after.holds and (not best.holds or after.better_than(best))
        best, since = (after, 0) if better else (best, since + best.holds)
        if since >= IN_VAIN_AT_BEST or (best.holds and best.force_residual <= NONE_LEFT):
            break
    effort.corrected = next(steps, most)
    return best


def _corrected(
    problem: ContactProblem,
    start: tuple[ExtendedAnswer, Mask],
    length: float,
    added: float,
    steps: Iterator[int],
    stay: float = STAYS,
) -> tuple[ExtendedAnswer, Mask, float] | None:
    """Return the answer that a correction leads to, its closed contacts, and how far its last program moved it.

    Contacts whose forces are far larger than d stay closed, and unknowns fixed by them are left out; where one of them
    pulls in the end, fewer stay. None where rounding of the factors leads to nothing.

    Parameters
    ----------
    problem : equilibrated
    start : an answer and its closed contacts
    length : the least D
    added : what is added to the diagonal of D/d K first
    steps : changes of the active set that are left
    stay : contacts whose forces are so many times d stay closed
    """
    (answer, closed), E, A = start, problem.normal, problem.tie
    answer = replace(answer, normal_force=answer.normal_force.times(closed.astype(float)).positive_part())
    residuals, carried = residuals_of(extended_rows(problem), problem, answer), answer.normal_force.double()
    force, gap, tie = residuals.force.double(), residuals.gap.double(), residuals.tie.double()
    missed = float(np.max(np.concatenate([-gap, abs(tie)]), initial=0.0))
    D, d = max(length, missed, LEAST_LENGTH), max(float(np.max(abs(force), initial=0.0)), LEAST_FORCE)
    stays, K = closed & (carried > stay * d), problem.stiffness_rows * (D / d)
    alone, fixed = rows_alone(E[np.flatnonzero(stays)])
    alone, v = np.flatnonzero(stays)[alone], np.zeros(problem.dimension)
    entry = E.data[E.indptr[alone]]
    v[fixed] = gap[alone] / D / entry
    free, others = np.delete(np.arange(len(v)), fixed), np.delete(np.arange(len(closed)), alone)
    rows = sp.vstack([E[others], A], format="csr")
    limit = np.concatenate([gap[others], tie]) / D - rows @ v
    changing = np.where(stays, 0.0, carried)
    load = (force + E.T @ changing) / d - K @ v
    tied, begins = (np.concatenate([mask[others], np.full(problem.ties, of_ties)]) for mask, of_ties in
                    ((stays, True), (closed & ~stays, False)))  # fmt: skip
    first = np.flatnonzero(begins)
    first = first[np.argsort(-changing[others[first]], kind="stable")]
    given = K[free][:, free], load[free], rows[:, free], limit
    program, x, moved = by_strict_programs(*given, tied, first, added, steps)
    if program is None:
        return None
    change, held, pushed, now = np.zeros(len(v)), np.zeros(len(limit)), np.zeros(len(closed)), stays.copy()
    change[free], held[program.active] = x, d * program.force
    closes = np.array([*program.active, *program.conflicting], dtype=np.intp)
    now[others[closes[closes < len(others)]]] = True
    pushed[others] = held[: len(others)]
    unbalanced = d * (load - K @ change) - E.T @ pushed - A.T @ held[len(others) :]
    pushed[alone] = unbalanced[fixed] / entry
    kept = np.where(stays, 1.0, 0.0)
    if np.any(stays & (carried + pushed < 0)):
        return _corrected(problem, start, length, added, steps, stay * STAYS_MORE)
    pushing = (answer.normal_force.times(kept) + extend(pushed)).positive_part()
    tie_force = answer.tie_force + extend(held[len(others) :])
    after = ExtendedAnswer(answer.displacement + extend(D * (v + change)), pushing, None, tie_force)
    return after, now, D * moved
