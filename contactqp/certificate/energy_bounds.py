"""Prove bounds on the distance of an answer from the solution where constraints are many or K is singular.

Let (U, L, N) be refined in extended precision from the answer until all conditions hold up to residuals r = f - K U -
E'L - A'N, gaps c of contacts with force, and ties t, all of rounding size, and no contact is penetrated. For any v with
E v <= g and A v = b

    J(v) = J(U) - r'(v - U) + L'(E U - E v) + N'(A U - A v) + 1/2 |v - U|^2
        >= J(U) - |L|'|c| - |N|'|t| - r'(v - U) + 1/2 |v - U|^2,

and in a connected part of K in all of whose rows K_jj exceeds the sum of the other |K_ji|, by d_j > 0, K - diag(d) is
semidefinite: there r_j (v - U)_j <= r_j^2 / d_j + 1/4 d_j (v - U)_j^2, and the last terms sum up to at most 1/4 |v -
U|^2. So, of all solutions within a distance R of U, unknown by unknown, J* and u* satisfy

    J(U) - w <= J* <= J(U) + w,    |u* - U|_K^2 <= 8 w,    w = |L|'|c| + |N|'|t| + sum_j min(|r_j| R_j, r_j^2 / d_j).

The upper bound takes N for the multipliers nu* of u* where ties are missed by t, |t|'|N - nu*| less than proven. R is
REACH times the size of the answer, or the room that contacts and ties of unknown j leave it along r_j; the residuals of
extended precision are so small that w is still far below any tolerance. An answer u is at most |u - U|_K + sqrt(8 w)
away from u* in the energy norm, and by what it takes to meet the rows (`_force_errors`), or less (`_apart`); and

    J(u) - J* <= 1/2 |u - U|^2 + L'(g - E u)+ + w

up to penetration and residuals of ties, by which an answer is judged if K does not determine the displacement, as in a
linear program. Forces are compared with L, by |l - L|_W over |L|_W, W that of the tied bodies and, where K is regular,
of the untied ones, and with L and N in equilibrated units. With dependent rows, these are the nearest of many.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.balance import imposed_work, work_that_meets
from contactqp.certificate.bounds import LEAST_PART, OUT_OF_TIME, REDUNDANT, Bounds, no_bounds, relative_error
from contactqp.certificate.figures import energy_norm
from contactqp.certificate.uniqueness import MOST_BY_MOTIONS, taken_by, unique_on
from contactqp.errors import NotConverged
from contactqp.linalg.convexity import (
    DECIDED,
    DEFINITE,
    REGULAR,
    StiffnessFactor,
    diagonal_dominance,
    stiffness_factor,
)
from contactqp.linalg.dense import RigidMotions
from contactqp.linalg.equilibration import (
    REACH,
    Scaling,
    equilibrated,
    in_range,
    least_length,
    mostly_bare,
    reach,
    rows_alone,
)
from contactqp.linalg.extended import ExtendedAnswer, extend, extended_rows
from contactqp.linalg.floating import SingleErrors, single_errors
from contactqp.linalg.interior_point import settled, solved_from, without_conflict
from contactqp.linalg.least_norm import WITHIN_ROUNDING, by_corrections, by_last_closings, without_needless_forces
from contactqp.linalg.measures import NOTHING_BY_DEFAULT, bodies, own_compliance, row_sizes
from contactqp.linalg.nonnegative import given_rows, highs
from contactqp.linalg.pardiso import Pardiso
from contactqp.linalg.sparse_saddle import BALANCED, MET_TOGETHER, SIGNED, SOLVED, WORTH_ANOTHER, ClosedState, Effort
from contactqp.linalg.sparse_states import TiedBodies
from contactqp.model.arrays import EPS, TINY, Mask, Vector, seconds_of_unfinished, within_time
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import BY_DISPLACEMENT, BY_ENERGY, Answer

NOTABLE = 1e-11  # a residual of equilibrium that costs more of the energy is bounded by nearby constraints
# Energies whose bounds are wider than this part are not enclosed well enough for the certificate, which asks for 1e-9.
DOUBTFUL = 1e-10
# Energies and forces due to this relative rounding of lengths count as zero, as do works of such forces within REACH.
NO_LENGTH = 1e-26
CAUTION = 4.0  # a safety factor on what balances a residual, and on what is found by random forces
# An answer ran away along a free motion if the work of forces on it is this many times the energy, and that on gaps.
AWAY = 1e6
CLOSE_BY = 1e-6  # an answer is accepted if it is this close to a solution up to such a conflict
NO_SOLUTION = "no solution was found near the answer"
NOT_APART = "the closed contacts and ties are too near to redundant for a bound of each force"
NEGATIVE = 1e-9  # with an elastic energy below minus this part of the energy's terms, a stationary point is no minimum
NO_MINIMUM = "the elastic energy of the solution near the answer is negative: no minimum, as rounding of K decides"
MOTIONS_OF_A_BODY = 6  # rigid ones, in space
Response = Callable[[Vector], tuple[float, float] | None]  # the energy norm of that to forces (n,), and its error


def energy_bounds(problem: ContactProblem, answer: Answer) -> Bounds:
    """Return the bounds of a frictionless answer from the nearest solution, without condensation.

    After a time limit was reached, bounds that take as long again are not computed.

    Raises InvalidProblem: K is indefinite.
    """
    try:
        with within_time(seconds_of_unfinished()):
            return _energy_bounds(problem, answer)
    except NotConverged:
        if seconds_of_unfinished() is None:
            raise
        return no_bounds(OUT_OF_TIME)


def _energy_bounds(problem: ContactProblem, answer: Answer) -> Bounds:
    twin, scaling = equilibrated(problem)
    factor = stiffness_factor(problem, factors=_factors_of_saddle(twin), least=DEFINITE)
    if not in_range(twin):
        return no_bounds("the numbers of the problem leave the range of doubles")
    start = scaling.scale(replace(answer, friction_force=None))
    finished = seconds_of_unfinished() is None
    moved = abs(start.displacement).max(initial=0.0) > least_length(twin)  # else by rounding, which opens no contact
    near = start if moved else replace(start, displacement=np.zeros(twin.dimension))
    state = settled(twin, near, Effort()) if finished else solved_from(twin, near, Effort(), claimed=False)
    if not state.holds:
        return replace(no_bounds(NO_SOLUTION), suspicious=NO_SOLUTION)
    state = without_needless_forces(narrowed(state, Effort()))
    soft = (bare := mostly_bare(twin)) or (factor is not None and factor.smallest_pivot < REGULAR)
    bodies = None if bare or not (twin.ties or factor is None) else TiedBodies(twin, scaling.unknowns)
    pressing = sp.vstack([twin.normal[np.flatnonzero(state.answer.normal_force.double() > 0)], twin.tie])
    response: Response | None = None if soft or bodies is None else partial(bodies.response, balancing=pressing)
    response = response if soft or factor is None else partial(_untied_norm, factor, scaling)
    found, untold, solution = _from_solution(twin, start, state, scaling, factor is not None, response)
    if bare or found.force_error is None or (factor is not None and found.by_energy):
        return found
    change = extend(start.normal_force) - solution.normal_force, extend(start.tie_force) - solution.tie_force
    forces = (solution.normal_force, solution.tie_force), change
    if factor is not None and not soft:
        found = _compared_without_ties(twin, scaling, found, forces, factor, untold)
    return found if bodies is None else _compared_with_ties(twin, found, forces, bodies, untold)


def _untied_norm(factor: StiffnessFactor, scaling: Scaling, force: Vector) -> tuple[float, float]:
    """Return |K^-1 f|_K of forces f (n,) in equilibrated units, and its error, as a `Response`."""
    norm, error = factor.response_norm(scaling.force / scaling.unknowns * force)
    unit = float(np.sqrt(scaling.length * scaling.force))
    return norm / unit, error / unit


def _compared_without_ties(
    twin: ContactProblem, scaling: Scaling, found: Bounds, forces: Any, factor: StiffnessFactor, untold: float
) -> Bounds:
    """Return bounds with forces compared by the response of the untied bodies to all, and to those of contacts alone.

    A nearly parallel tie may carry what a contact does, with the bounds of single forces.
    """
    rows, none, root = extended_rows(twin), extend(np.zeros(twin.ties)), float(np.sqrt(scaling.length * scaling.force))
    untied, carried = partial(_untied_norm, factor, scaling), untold
    if twin.ties and found.force_bound is not None:
        bound, own = np.nan_to_num(found.force_bound), np.sqrt(own_compliance(twin, twin.normal))
        bound = np.maximum(bound * scaling.contacts / scaling.force - abs(forces[1][0].double()), 0.0)  # of L
        carried = max(untold, float(own @ bound), sum(untied(twin.normal.T @ bound)))
    pushed, change = (untied(rows.contact_force(push, none).double()) for push, _ in forces)
    error, size = relative_error(sum(change) + carried, *pushed), pushed[0]
    if twin.ties:
        whole, change = (untied(rows.contact_force(*both).double()) for both in forces)
        error = max(error, relative_error(sum(change) + untold, *(whole if size > 0 else pushed)))
    alone = found.force_error or 0.0 if twin.ties else 0.0  # what nearly parallel ties share otherwise strains nothing
    ties = alone * (found.force_scale or 1.0), found.force_scale
    error = max(error, alone) if size > 0 else error * root
    return replace(found, force_error=error, force_scale=size * root, ties=ties)


def _compared_with_ties(twin: ContactProblem, found: Bounds, forces: Any, bodies: TiedBodies, untold: float) -> Bounds:
    """Return bounds with contact forces compared by the response of the tied bodies, too."""
    rows, none = extended_rows(twin), extend(np.zeros(twin.ties))
    pushed, change = (bodies.response(rows.contact_force(push, none).double()) for push, _ in forces)
    if pushed is None or change is None or pushed[0] <= 2 * pushed[1]:
        return found  # ties balance these forces but for rounding, or bodies are too soft
    return replace(found, force_error=max(found.force_error or 0.0, relative_error(sum(change) + untold, *pushed)))


def _factors_of_saddle(problem: ContactProblem) -> Pardiso | None:
    """Return the factors of the last saddle point of an equilibrated problem if they have the pattern of K."""
    return next((saddle.factors for saddle in problem._computed.sparse_saddle.values()), None)


def _from_solution(
    problem: ContactProblem,
    answer: Answer,
    held: ClosedState,
    scaling: Scaling,
    definite: bool,
    response: Response | None,
) -> tuple[Bounds, float, ExtendedAnswer]:
    """Return bounds in the problem's units from an answer and a solution of its twin, |U - u*|_K in those of the twin,
    and the solution with which forces were compared.

    If its closed contacts conflict by rounding, the solution is completed by a vertex; as zero forces of touching
    contacts there are due to rounding, forces are compared with those of all closed contacts, if these differ. A load
    that is rounding and drives a motion strains nothing, so that |U - u*|_K is then at most the answer's own distance.
    """
    unique, bare = unique_on(held), mostly_bare(problem)
    met = MET_TOGETHER if unique.forces or not bare else SOLVED
    state = without_conflict(held, Effort(), met)
    solution, root = state.answer.double(), float(np.sqrt(unit := scaling.length * scaling.force))
    wide, least = _width(state), NO_LENGTH * state.length
    distance = sum(energy_norm(problem, extend(answer.displacement) - state.answer.displacement))
    strain = max(float(np.subtract(*energy_norm(problem, state.answer.displacement))), 0.0)  # less its rounding
    energy, size, elastic = _energy(state)
    moved = abs(solution.displacement)
    rounding = NO_LENGTH * float(moved @ (problem.stiffness_sizes @ moved))  # rounding of rigid motions, of either sign
    if elastic < -NEGATIVE * size - rounding:
        return replace(no_bounds(NO_MINIMUM), suspicious=NO_MINIMUM), 0.0, held.answer
    if unique.forces and np.array_equal(state.closed, held.closed):
        held = state  # all rows of the same set are met together
    sees = unique.displacement and problem.diagonal.any() and not bare
    scale = strain if sees else max(strain, float(np.sqrt(2 * size)))
    scale = scale if scale > least else 0.0
    whole = float(np.linalg.norm(np.append(solution.normal_force, solution.tie_force)))
    largest = whole if whole > least else 0.0
    change, missed, (by_residual, by_strain, back), single = _missed_forces(problem, answer, held, unique.forces)
    gap = (extend(problem.gap) - problem.normal @ answer.displacement).double()
    above = 0.5 * distance * distance + float(solution.normal_force @ np.maximum(gap, 0.0)) + 2 * wide
    away = np.inf if unique.displacement else AWAY * imposed_work(problem, solution)  # along a free motion only
    rounded = max(EPS * min(work_that_meets(problem, solution), away), REACH * least * least)
    apart = _apart(state, wide, back if state is held and unique.forces else None, response)
    by_strain, untold = by_strain * max(apart, TINY) + _on_open_contacts(held, apart + back), apart + back
    bounded = unique.forces and bool(np.all(np.isfinite(by_residual)) and np.all(np.isfinite(by_strain)))
    missed, error = missed + (float(np.linalg.norm(by_residual)) if bounded else 0.0), distance + untold
    error = error if sees else max(error, float(np.sqrt(2 * above)))
    pushed = max(float(np.linalg.norm(solution.normal_force)), LEAST_PART * largest)
    own = change + by_residual[: problem.contacts]
    known, there = np.isfinite(own + by_strain), 0.0 if single is None else single.of_bare_contacts
    relative = np.where(known, np.maximum(own / (pushed or 1.0), there), 0.0)
    judged = bounded or (not unique.forces and bool(known.any()))
    found = Bounds(
        energy_error=_relative(error * root, (strained := strain if strain > least else scale) * root),
        force_error=_relative(missed * root, largest * root),
        # Rigid motions by rounding of balanced loads widen the bounds but do not make the answer wrong.
        force_bound=np.where(known, own + by_strain, np.nan) * scaling.force / scaling.contacts if judged else None,
        relative_force_bound=relative if judged and pushed > least else None,
        single=single and replace(single, felt=root * single.felt, largest=root * single.largest),
        energy_scale=scale * root,
        force_scale=largest * root,
        rounding=least * root,
        energy_bounds=((energy - wide) * unit, (energy - wide + above) * unit),
        energy_size=size * unit,
        energy_rounding=rounded * unit,
        by_energy=not sees,
        # A slender body responds like a free motion; its factors show that it has stiffness.
        apart=_relative(distance * root, strained * root) if definite and not sees else None,
        determined=BY_DISPLACEMENT if unique.displacement else BY_ENERGY,
        reasons=() if bounded else (f"force_bound: {NOT_APART if unique.forces else REDUNDANT}",),
    )
    # Forces of open contacts of a program are unknown: only rounding counts as no penetration.
    passed = -state.left.gap.double()[~state.closed] / state.length if bare else np.zeros(0)
    untold = untold if problem.ties or state.force_residual <= BALANCED else min(untold, distance)
    if state.length_residual <= met and not np.any(passed > SOLVED):
        return found, untold, held.answer
    near = _relative(distance, scale) <= CLOSE_BY and _relative(missed, largest) <= CLOSE_BY
    return _of_conflict(found, np.max(passed, initial=state.length_residual), near), untold, held.answer


def _missed_forces(
    problem: ContactProblem, answer: Answer, held: ClosedState, unique: bool
) -> tuple[Vector, float, tuple[Vector, Vector, float], SingleErrors | None]:
    """Return |l - L| (m,), the norm of what all forces differ by, `_force_errors`, and the errors one by one.

    Redundant rows may have other forces, with the same resultant, but not rows that do not depend on others.
    """
    pairs = (answer.normal_force, held.answer.normal_force), (answer.tie_force, held.answer.tie_force)
    change, turned = ((extend(one) - other).double() for one, other in pairs)
    missed = float(np.linalg.norm(apart := np.append(change, turned)))
    errors, single = _force_errors(problem, held, unique), None
    if not mostly_bare(problem) and (problem.ties or not problem.diagonal.all()):
        forces = np.append(*(other.double() for _, other in pairs))
        single = single_errors(problem, np.where(np.isfinite(errors[0]), abs(apart) + errors[0], 0.0), forces)
    if not unique:
        resultant = float(np.linalg.norm(problem.normal.T @ change + problem.tie.T @ turned))
        alone = abs(turned) + errors[0][problem.contacts :]
        missed = max(min(missed, resultant), float(np.linalg.norm(alone[np.isfinite(alone)])))
        errors = *errors[:2], 0.0
    return abs(change), missed, errors, single


def _force_errors(problem: ContactProblem, held: ClosedState, unique: bool) -> tuple[Vector, Vector, float]:
    """Bound the distance of all forces from the true ones [force], and that of U by rows it does not meet.

    Let v_i move row i by one and no other row that is closed or touches by rounding. Then U + s, s = sum c_j v_j, with
    c_j what U leaves of row j, or its penetration without a force, is admissible, and |U - u*|_K <= d + b with d that
    of the energy's bounds and b = 2 |s|_K. Equilibrium of the solution, to its residual r, and of the truth gives

        |L_i - L*_i| <= |r|'|v_i| + |v_i|_K |U - u*|_K

    Both are negligible relative to the largest forces and strain, but may not be on soft parts or where rows are nearly
    dependent. Returned are |r|'|v| + |v|_K b (m + k,), |v|_K (m,), CAUTION times both, and b. Where forces are not
    `unique`, only rows that do not depend on others have a v_i; that of others, and of all where these are many, is
    infinite.
    """
    (left, gap, tie), m = held.left.double(np.arange(problem.contacts)), problem.contacts
    found = np.zeros((m + problem.ties, 2))
    closed = np.flatnonzero(_touching(held))
    if not len(closed) + problem.ties:
        return found[:, 0], found[:m, 1], 0.0
    place = np.append(closed, np.arange(m, len(found)))
    rows = sp.csr_array(sp.vstack([problem.normal[closed], problem.tie]))
    missed = np.append(np.where(held.closed, gap, np.minimum(gap, 0.0))[closed], tie)
    residual, taken, moved = abs(left), np.zeros((rows.shape[0], 2)), np.zeros(problem.dimension)
    if not unique:
        found[place] = np.inf
        if len(place) > MOST_BY_MOTIONS:
            return found[:, 0], found[:m, 1], 0.0
    # Rows of one unknown balance the residual there, other rows that on the other unknowns.
    alone, unknown = rows_alone(rows) if unique else (place[:0], place[:0])
    others, free = np.delete(np.arange(rows.shape[0]), alone), np.delete(np.arange(problem.dimension), unknown)
    entries, beside = rows.data[rows.indptr[alone]], rows[others][:, unknown]
    moved[unknown] = missed[alone] / entries
    stiffness = sp.csr_array(problem.stiffness_rows)[free][:, free]
    together = rows[others][:, free], residual[free], stiffness, missed[others] - beside @ moved[unknown]
    taken[others], moved[free] = taken_by(*together, unique)
    here = np.column_stack([residual[unknown], np.sqrt(problem.diagonal[unknown])])
    taken[alone] = (here + abs(beside).T @ taken[others]) / abs(entries)[:, None]
    found[place] = CAUTION * taken
    back = 2 * sum(energy_norm(problem, moved))
    return found[:, 0] + (back * found[:, 1] if back > 0 else 0.0), found[:m, 1], back


def _touching(held: ClosedState) -> Mask:
    """Return the contacts (m,) that are closed or touch by rounding."""
    problem, moved = held.problem, abs(held.answer.displacement.double())
    length = row_sizes(problem, problem.normal).lengths(moved) + abs(problem.gap)
    return np.asarray(held.closed | (held.left.gap.double() <= WITHIN_ROUNDING * length))


def _on_open_contacts(held: ClosedState, apart: float) -> Vector:
    """Bound true forces (m,) of open contacts: l*'(g - E U) <= J(U) - J* <= |U - u*|^2 / 2; 0 for gaps by rounding."""
    opens = ~_touching(held) & ((gap := held.left.gap.double()) > SIGNED * held.length)
    return np.asarray(np.where(opens, apart * apart / np.where(opens, 2 * gap, 1.0), 0.0))


def _of_conflict(found: Bounds, conflict: float, near: bool) -> Bounds:
    """Return the remaining bounds if closed contacts and ties conflict by rounding, to a part of the largest length."""
    by = f"by {conflict:.2g} of the largest length"
    said = f"closed contacts and ties conflict {by}: {DECIDED}"
    beside = f"energy_bounds: those of the problem whose gaps and tie values are moved {by}"
    none = no_bounds(said)
    return replace(
        none,
        suspicious=None if near else f"{said}, and the answer is not near",
        energy_bounds=found.energy_bounds,
        **{name: getattr(found, name) for name in ("energy_size", "energy_rounding", "by_energy", "determined")},
        reasons=(*none.reasons, beside),
    )


def narrow(state: ClosedState) -> bool:
    """Return whether the width w of the bounds of a solution's energy is negligible."""
    return state.holds and _width(state) <= NOTABLE * _energy(state)[1]


def doubtful(state: ClosedState) -> bool:
    """Return whether the bounds of a program's energy are so wide, or it ran so far, that its answer may be refused."""
    return mostly_bare(state.problem) and (ran_away(state) or not _width(state) <= DOUBTFUL * _energy(state)[1])


def ran_away(state: ClosedState) -> bool:
    """Return whether a solution lies so far along a free motion that doubles round its energy to few digits."""
    problem, answer = state.problem, state.answer.double()
    return work_that_meets(problem, answer) > AWAY * max(_energy(state)[1], imposed_work(problem, answer))


def contradictory(state: ClosedState) -> bool:
    """Return whether the closed contacts and ties of a program conflict by rounding, which those of others may not."""
    return mostly_bare(state.problem) and state.length_residual > MET_TOGETHER


def nearer(state: ClosedState, before: ClosedState) -> bool:
    """Return whether a state has far smaller residuals; beside a doubtful one, no conflict or narrower bounds."""
    if not (doubtful(before) or contradictory(before)):
        return state.better_than(before, WORTH_ANOTHER)
    own, last = contradictory(state), contradictory(before)
    fewer = own < last and not doubtful(state)
    return fewer or (own <= last and (ran_away(state) < ran_away(before) or _width(state) < _width(before)))


def narrowed(state: ClosedState, effort: Effort) -> ClosedState:
    """Return the solution after last closings, or of corrections if these bound a program's energy more narrowly."""
    state = by_last_closings(state, effort)
    if not (state.holds and mostly_bare(state.problem)) or narrow(state):
        return state
    after = by_corrections(state, effort)
    return after if after.holds and nearer(after, state) else state


def _of_lengths(state: ClosedState) -> float:
    """Return |L|'|c| + |N|'|t|, the part of w by gaps and ties."""
    answer, left = state.answer.double(), state.left
    return float(abs(answer.normal_force) @ abs(left.gap.double()) + abs(answer.tie_force) @ abs(left.tie.double()))


def _apart(state: ClosedState, width: float, back: float | None, response: Response | None) -> float:
    """Bound |U - u*|_K less 2 |s|_K by w, or by the response y to the residual r if this balances on free motions.

    r'(v - U) <= |y|_K |v - U|_K and J* <= J(U) + w give 2 |y|_K + sqrt(8 w) with w without r, or, as U + s meets all
    rows, 2 |y|_K + |s|_K, where 2 |s|_K = `back` is known.
    """
    by_energy = float(np.sqrt(8 * width))
    if response is None or width == 0 or state.force_residual > BALANCED:
        return by_energy
    strained = response(state.left.force.double())
    unmet = float(np.sqrt(8 * _of_lengths(state))) if back is None else back / 2
    return by_energy if strained is None else min(by_energy, 2 * sum(strained) + unmet)


def _width(state: ClosedState) -> float:
    """Return w, the width of the bounds of the solution's energy by rounding."""
    left, dominance = state.left.force, diagonal_dominance(state.problem)
    unbalanced = _cost(state, left.double(), dominance)
    if unbalanced > NOTABLE * _energy(state)[1]:
        unbalanced = min(unbalanced, _taken_by_constraints(state, dominance))
    return _of_lengths(state) + float(unbalanced)


def _cost(state: ClosedState, residual: Vector, dominance: Vector) -> float:
    """Return the sum of min(|r_j| R_j, r_j^2 / d_j) for residuals r (n,) and d (n,)."""
    farthest, size = reach(state.problem, state.answer.displacement.double(), residual), abs(residual)
    resisted = np.divide(size, dominance, out=np.full(len(farthest), np.inf), where=dominance > 0)
    return float(size @ np.minimum(farthest, resisted))


def _taken_by_constraints(state: ClosedState, dominance: Vector) -> float:
    """Bound r'(v - U) by the constraints that limit v - U; d (n,) is that of the module's formula.

    For any p >= 0 and q it is at most p'(g - E U) + q'(b - A U) + (r - E'p - A'q)'(v - U). They are the multipliers of
    the linear program that maximises r'(v - U) subject to the constraints.
    """
    problem, left, length = state.problem, state.left, state.length
    residual, gap = left.force.double(), left.gap.double()
    size = float(np.max(abs(residual)))
    near = np.flatnonzero(np.isfinite(gap))
    motion = highs(
        -residual / size,
        bounds=(-REACH, REACH),
        **given_rows("ub", problem.normal[near], np.maximum(gap[near] / length, 0.0)),
        **given_rows("eq", problem.tie, np.zeros(problem.ties)),
    )
    if motion is None:
        return np.inf
    force = np.zeros(problem.contacts)
    force[near] = np.maximum(-size * motion.ineqlin.marginals, 0.0) if len(near) else 0.0
    tie = -size * motion.eqlin.marginals if problem.ties else np.zeros(0)
    others = left.force - extended_rows(problem).contact_force(extend(force), extend(tie))
    taken = float(force[near] @ abs(gap[near]) + abs(tie) @ abs(left.tie.double()))
    return taken + _cost(state, others.double(), dominance)


def _energy(state: ClosedState) -> tuple[float, float, float]:
    """Return the energy J, the larger of its terms or, if both vanish, of the dual energy's, and 1/2 U'K U.

    K U is taken from the residual r = f - K U - E'L - A'N. The terms are used as the size, as their sum may cancel.
    """
    problem, answer = state.problem, state.answer
    u, doubles, load = answer.displacement, answer.double(), extend(problem.load)
    outer = load - extended_rows(problem).contact_force(answer.normal_force, answer.tie_force)
    elastic, work = 0.5 * u.dot(outer - state.left.force), u.dot(load)
    lifted = abs(doubles.normal_force @ problem.gap) + abs(doubles.tie_force @ problem.tie_value)
    imposed = float(abs(np.append(problem.gap[state.closed], problem.tie_value)).max(initial=0.0))
    least = max(least_length(problem, state.closed), NOTHING_BY_DEFAULT * imposed)
    least = max(least * np.max(problem.load_size, initial=0.0), NOTHING_BY_DEFAULT * work_that_meets(problem, doubles))
    return elastic - work, max(elastic, abs(work), least) or float(lifted), elastic


def _relative(error: float, scale: float) -> float:
    return error / scale if scale > 0 else error


def bounds_by_energy(problem: ContactProblem, answer: Answer, bounds: Bounds, rigid: RigidMotions) -> Bounds:
    """Return bounds from the nearest solution, if condensed systems prove nothing and no body floats.

    Parameters
    ----------
    problem, answer : ContactProblem, Answer
    bounds : what condensed systems gave, returned where no more is proven, unless there is no stiffness at all
    rigid : the null space of K
    """
    if problem.frictional or _floats(problem, rigid):
        return bounds
    found = energy_bounds(problem, answer)
    if not found.proven:
        return bounds if problem.diagonal.any() else found
    if bounds.force_error is None or found.force_error is None:
        return found
    error = max(found.force_error, bounds.force_error)  # each in its own norm
    return replace(found, force_error=error, determined=bounds.determined)


def _floats(problem: ContactProblem, rigid: RigidMotions) -> bool:
    """Return whether bodies float, so that rounding of K along rigid motions would enter the energy.

    Unknowns without stiffness, and parts with more free motions than a body has, are not bodies.
    """
    stiff = problem.diagonal > 0
    motions = int(np.sum(np.any(rigid.motions[stiff] != 0, axis=0)))
    return 0 < motions <= MOTIONS_OF_A_BODY * len(np.unique(bodies(problem)[stiff]))
