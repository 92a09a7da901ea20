"""Coulomb friction in the plane by Newton's method on the combination of states.

The linear system of a combination of open, stick and slip either way is solved; the projections

    closed where l_N + r_N (N x - g) > 0,   sliding where |l_T + r_T (T x - o)| > mu (l_N + r_N (N x - g))

suggest the next one, until its signs hold: the semismooth Newton method of Alart and Curnier (1991), which in the plane
is a primal-dual active set (Hueeber, Stadler and Wohlmuth 2008). From the combination of the previous load it takes a
step or two. If combinations recur, one contact at a time is changed, the one with the largest violation.

With many contacts (`solve_sparse_newton`) the systems are those of `contactqp.linalg.sparse_states`, which contain
every unknown of the bodies. The start is then the contacts that close without friction, all of them stuck, which the
active set on a hierarchy finds, or the combination of a known answer. Bodies that float may be held by friction alone:
the combinations of Tresca's problems, which an interior point solves, are tried one after another.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.certificate import holds
from contactqp.errors import BackendFailed, BackendMissing, NotConverged
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.convexity import refuse_indefinite
from contactqp.linalg.dense import OPERATOR_ROUNDING, unknown_scale
from contactqp.linalg.equilibration import equilibrated
from contactqp.linalg.friction_states import MAX_SWEEPS, RefinedState, answer_in, without_noise
from contactqp.linalg.iteration import condense_anyway, held_by_hierarchy, iteration
from contactqp.linalg.measures import lengths_that_meet, own_compliance, ratio
from contactqp.linalg.sparse_states import SparseFrictionalRows, frictional_rows, refined_sparse
from contactqp.model.arrays import Indices, Mask, Vector, all_finite, refuse_late, stated_limit, time_is_up
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.friction.force_system import CombinationAnswer, ForceSystem, Lengths
from contactqp.solving.methods import Settings, find
from contactqp.solving.methods.inexact_active_set import identified_by_iteration

# Signs that fail by this part of the largest length or force, both in sqrt(energy), fail by rounding.
ROUNDING_OF_SIGNS = 1e-13
# A looser limit if combinations recur, since refinement then judges each contact in its own measure.
DOUBTFUL = 1e-11
# Violations above this part of the answer itself are not rounding. For weakly supported bodies the displacement without
# contact forces, to which ROUNDING_OF_SIGNS refers, may exceed the answer by many orders of magnitude.
DROWNED = 1e-6
# The most steps of the projections, and of changes of single contacts for each contact.
MAX_STEPS = 60
CHANGES_A_CONTACT = 4


@dataclass(frozen=True, eq=False)
class NewtonAnswer:
    """Coulomb's answer to the last digits, and the combinations it took."""

    answer: Answer
    status: Status
    steps: int


def solve_newton(
    problem: ContactProblem,
    condensation: Condensation,
    start: Candidate | None,
    max_iter: int | None = None,
) -> NewtonAnswer:
    """Find Coulomb's answer from the combination of `start`, or from all touching contacts stuck.

    Raises NotConverged: the combinations come back, or the time is up; `solution` is then the answer of the combination
    that violates the signs least.

    Parameters
    ----------
    problem, condensation
        The frictional problem and its condensation.
    start : Candidate or None, an answer whose combination is tried first
    max_iter : the largest number of combinations
    """
    system = ForceSystem(problem, condensation)
    lengths = system.lengths(problem, condensation.reduce_load(problem.load)[0])
    status = _touching(system, lengths) if start is None else combination_of(problem, start.answer)
    found: CombinationAnswer | None = None
    try:
        found, steps = search(system, lengths, status, max_iter=max_iter)
        answer = refined(problem, condensation, system, lengths, found)
    except NotConverged as error:
        found = found or error.solution
        if found is None or not time_is_up():
            raise
        late = f"newton: stopped at the time limit of {stated_limit(None)}"
        raise NotConverged(late, (), _in_doubles(problem, condensation, system, lengths, found)) from error
    if not holds(problem, answer):
        raise NotConverged("newton: the signs of its combination do not hold to the last digits")
    return NewtonAnswer(answer, found.status, steps)


def refined(
    problem: ContactProblem,
    condensation: Condensation,
    system: ForceSystem,
    lengths: Lengths,
    found: CombinationAnswer,
) -> Answer:
    """Return the answer of a combination to the last digits, without checking its signs.

    Parameters
    ----------
    problem : ContactProblem
    condensation : the Condensation of the problem
    system : ForceSystem
    lengths : the right-hand sides that belong to the problem's load
    found : the answer in scaled forces, before refinement
    """
    start = _in_doubles(problem, condensation, system, lengths, found)
    answer = answer_in(problem, condensation, system.rows, found.status, start)
    return without_idle_friction(system, answer)


def _in_doubles(
    problem: ContactProblem,
    condensation: Condensation,
    system: ForceSystem,
    lengths: Lengths,
    found: CombinationAnswer,
) -> Answer:
    _, inner = condensation.reduce_load(problem.load)
    expanded = condensation.expand(system.displacement(found, lengths) * system.rows.scale, inner)
    return system.unscaled(found, expanded)


def without_idle_friction(system: ForceSystem, answer: Answer) -> Answer:
    """Return the answer without friction at contacts that cannot slide: their tangential rows are zero."""
    if answer.friction_force is None or np.all(system.rows.slides):
        return answer
    return replace(answer, friction_force=np.where(system.rows.slides[:, None], answer.friction_force, 0.0))


def search(
    system: ForceSystem,
    lengths: Lengths,
    start: Status,
    held_open: Mask | None = None,
    max_iter: int | None = None,
) -> tuple[CombinationAnswer, int]:
    """Return the combination whose signs hold and the number of those solved; contacts `held_open` (m,) may overlap.

    Raises NotConverged: the combinations come back, or the time is up; `solution` is then the nearest of them so far.

    Parameters
    ----------
    system : the linear systems of all combinations
    lengths : gaps, slips and ties that the load leaves
    start : (m,) array, the first combination of open, stick and slip
    held_open : (m,) array of bool, optional
        Contacts that stay open although they may overlap.
    max_iter : the largest number of combinations
    """
    status = system.plain(start)
    if held_open is not None:
        status = np.where(held_open, OPEN, status).astype(np.int8)
    seen: set[bytes] = set()
    best: tuple[float, CombinationAnswer] | None = None
    single, left = False, MAX_STEPS if max_iter is None else max_iter
    steps = 0
    while left > 0:
        if time_is_up():
            late = f"newton: stopped at the time limit of {stated_limit(None)}"
            raise NotConverged(late, (), None if best is None else best[1])
        seen.add(status.tobytes())
        found = system.solve(status, lengths)
        steps, left = steps + 1, left - 1
        wrong = found.worst(system.coefficient)
        if held_open is not None:
            wrong = np.where(held_open, -np.inf, wrong)
        size = max(lengths.felt(status), float(np.max(found.normal, initial=0.0)))
        # A combination without a solution may be an intermediate step but not the answer.
        worst = max(float(np.max(wrong, initial=0.0)), found.residual if found.residual > DOUBTFUL * size else 0.0)
        if worst <= ROUNDING_OF_SIGNS * size:
            return _not_drowned(system, lengths, found, held_open), steps
        if best is None or worst / size < best[0]:
            best = worst / size, found
        following = np.where(wrong > 0, suggested(system, found), status).astype(np.int8)
        if not single and following.tobytes() in seen:
            if best[0] <= DOUBTFUL:
                return _not_drowned(system, lengths, best[1], held_open), steps
            single, seen = True, set()
            left = CHANGES_A_CONTACT * system.contacts if max_iter is None else left
            status = best[1].status
            continue
        if single:
            following = one_changed(status, following, wrong)
            if following.tobytes() in seen:
                break
        status = following
    if best is not None and best[0] <= DOUBTFUL:
        return _not_drowned(system, lengths, best[1], held_open), steps
    raise NotConverged(f"newton: no combination of open, stick and slip whose signs hold ({steps} tried)")


def _not_drowned(
    system: ForceSystem, lengths: Lengths, found: CombinationAnswer, held_open: Mask | None
) -> CombinationAnswer:
    """Return an answer whose signs fail by rounding only; raise NotConverged if rounding is as large as the answer."""
    wrong = np.where(False if held_open is None else held_open, 0.0, found.worst(system.coefficient))
    fails = max(float(np.max(wrong, initial=0.0)), found.residual)
    parts = (lengths.target, found.normal, found.friction, found.gap, found.slip)
    if fails > DROWNED * max(float(np.max(abs(part), initial=0.0)) for part in parts):
        raise NotConverged("newton: beside the displacement without contact forces nothing is left of the answer")
    return found


def suggested(system: ForceSystem, found: CombinationAnswer) -> Status:
    """Return the combination that the projections give for an answer."""
    m = system.contacts
    push = found.normal - system.resistance[:m] * found.gap
    trial = found.friction + system.resistance[m:] * found.slip
    sliding = np.where(trial > 0, SLIP_ON, SLIP_BACK)
    status = np.where(abs(trial) <= system.coefficient * push, STICK, sliding)
    return system.plain(np.where(push > 0, status, OPEN).astype(np.int8))


def combination_of(problem: ContactProblem, answer: Answer) -> Status:
    """Return the states of an answer: closed where a force acts, slipping where E_T u differs from the origin."""
    if problem.tangent is None or problem.slip_origin is None:
        raise ValueError("combination of a problem without friction")
    origin, u = problem.slip_origin.ravel(), answer.displacement
    slip = problem.tangent @ u - origin
    still = ratio(abs(slip), lengths_that_meet(problem, problem.tangent, origin, u)) <= OPERATOR_ROUNDING
    status = np.where(still, STICK, np.where(slip > 0, SLIP_ON, SLIP_BACK))
    return np.where(answer.normal_force > 0, status, OPEN).astype(np.int8)


def one_changed(status: Status, following: Status, wrong: Vector) -> Status:
    """Return the combination in which only the contact with the largest violation has changed its state."""
    changes = status != following
    if not np.any(changes):
        return status
    i = int(np.argmax(np.where(changes, wrong, -np.inf)))
    one = status.copy()
    one[i] = following[i]
    return one


def _touching(system: ForceSystem, lengths: Lengths) -> Status:
    """Return the combination in which contacts that overlap without forces stick; all contacts where bodies float."""
    m = system.contacts
    overlap = lengths.free[:m] >= lengths.target[:m]
    floats = len(lengths.drive) > 0
    return np.where(overlap | floats, STICK, OPEN).astype(np.int8)


# The most combinations, and the sweeps of refinement before signs are judged.
MAX_SPARSE_STEPS, LOOSE_SWEEPS = 40, 1
# Signs that fail by this part of the largest force, lengths and forces both in sqrt(energy), fail by rounding.
SPARSE_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class SparseNewtonAnswer:
    """Coulomb's answer to the last digits, the combinations it took, and how many of them were factorised."""

    answer: Answer
    steps: int
    factorisations: int
    back_substitutions: int
    late: str = ""  # why it is only that of the last combination, where the time is up


# The answer without friction must be accurate enough for its slips.
SLIPS_KNOWN = 1e-6
# Where bodies float: the tolerance of the interior point for Tresca's problems, the most of them, and the part of the
# largest bound of friction below which one is none.
ROUGH, MAX_TRESCA_STEPS, NO_BOUND = 1e-8, 12, 1e-9
# A contact is assumed to slip if it slips without friction by more than this multiple of the displacement of its
# unknowns alone by the friction bound, as the surface around it moves along. On strips with friction between 0.05 and 1
# this saves up to two of six combinations.
COMPLIANT = 30.0


def solve_sparse_newton(problem: ContactProblem, settings: Settings) -> SparseNewtonAnswer:
    """Find Coulomb's answer in the plane, from one combination or, where bodies float, from those of Tresca's problems.

    Raises NotConverged: the combinations come back, or one of them has a system without an inverse.
    """
    refuse_indefinite(problem)  # which contacts may hide
    last, tried = NotConverged("newton: no combination to start from was found"), set[bytes]()
    for start in _starts(problem, settings):
        if start.tobytes() not in tried:
            tried.add(start.tobytes())
            try:
                return _from_combination(problem, start, settings.now)
            except NotConverged as error:
                last = error
                refuse_late("newton: another combination began")
    condense_anyway(problem)  # other algorithms do, and the certificate then uses that
    raise last


def _from_combination(problem: ContactProblem, start: Status, settings: Settings) -> SparseNewtonAnswer:
    rows, spent = frictional_rows(problem), 0
    before = rows.factorisations
    here = Answer(np.zeros(problem.dimension), np.zeros(problem.contacts), None, np.zeros(problem.ties))
    status, seen = _plain(rows, start), set()
    for step in range(1, (settings.max_iter or MAX_SPARSE_STEPS) + 1):
        seen.add(status.tobytes())
        try:
            refuse_late(f"combination {step} of open, stick and slip was solved for")
            found = refined_sparse(problem, status, here, LOOSE_SWEEPS)
        except BackendFailed as error:
            raise NotConverged(f"newton: {error}") from error
        except NotConverged as error:
            if step == 1:
                raise
            return SparseNewtonAnswer(here, step - 1, rows.factorisations - before, spent, str(error))
        here = found.answer(1)
        solved = rows.system(problem, status).back_substitutions
        spent += solved
        if not (found.regular and all_finite(here)):
            raise NotConverged(f"newton: the system of combination {step} has no inverse")
        following = _suggested(problem, rows, found, status)
        if np.array_equal(following, status):
            last = refined_sparse(problem, status, here, MAX_SWEEPS).answer(1)
            spent += rows.system(problem, status).back_substitutions - solved
            clean = without_noise(problem, unknown_scale(problem), rows, last, here)
            return SparseNewtonAnswer(clean, step, rows.factorisations - before, spent)
        if following.tobytes() in seen:  # a few contacts cycle, so change one at a time
            one = _next_unseen(status, following, seen)
            if one is None:
                break
            following = one
        status = following
    raise NotConverged(f"newton: no combination of open, stick and slip whose signs hold ({len(seen)} tried)")


def _starts(problem: ContactProblem, settings: Settings) -> Iterator[Status]:
    """Yield the combination of a known answer; else that without friction or, where bodies float, Tresca's."""
    held = held_by_hierarchy(problem)
    if settings.warm_start is not None:
        yield combination_of(problem, settings.warm_start.answer)
    elif held:
        yield _without_friction(problem, settings)
    if not held:
        yield from _by_tresca(problem, settings)


def _without_friction(problem: ContactProblem, settings: Settings) -> Status:
    """Return the combination of the answer without friction, with slip where that slips far."""
    identified = identified_by_iteration(problem, iteration(problem), settings, SLIPS_KNOWN)
    if identified is None:
        raise NotConverged("newton: the contacts that close without friction were not found")
    found = identified.answer
    assert problem.tangent is not None
    assert problem.slip_origin is not None
    assert problem.friction is not None
    slip = problem.tangent @ found.displacement - problem.slip_origin.ravel()
    held = COMPLIANT * own_compliance(problem, problem.tangent) * problem.friction * found.normal_force
    closed = np.where(abs(slip) <= held, STICK, np.where(slip > 0, SLIP_ON, SLIP_BACK))
    return np.where(found.normal_force > 0, closed, OPEN).astype(np.int8)


def _by_tresca(problem: ContactProblem, settings: Settings) -> Iterator[Status]:
    """Yield the combinations of convex problems, in each of which friction is bounded by mu times the last forces.

    In the first one tangential springs, as stiff as the bodies at the contacts, act in place of friction.
    """
    assert problem.friction is not None
    bounds: Vector | None = None
    for _ in range(MAX_TRESCA_STEPS):
        bounded, posed = _with_springs(problem) if bounds is None else _with_bounds(problem, bounds)
        found = _roughly(posed, settings)
        if found is None:
            return
        yield _combination(problem, found, bounded, bounds)
        bounds = problem.friction * np.maximum(found.normal_force[: problem.contacts], 0.0)


def _with_springs(problem: ContactProblem) -> tuple[Indices, ContactProblem]:
    """Return no contacts, and the problem with springs along the tangents of contacts in place of friction."""
    assert problem.tangent is not None
    assert problem.slip_origin is not None
    assert problem.friction is not None
    compliance = own_compliance(problem, problem.tangent)
    has_friction = (compliance > 0) & (problem.friction > 0)
    springs = sp.diags(np.divide(1.0, compliance, out=np.zeros(len(compliance)), where=has_friction)) @ problem.tangent
    K, load = problem.tangent.T @ springs, springs.T @ problem.slip_origin.ravel()
    ties = {"tie": problem.tie, "tie_value": problem.tie_value}
    held = ContactProblem(problem.stiffness_rows + K, problem.load + load, problem.normal, problem.gap, **ties)
    return np.zeros(0, dtype=np.intp), held


def _with_bounds(problem: ContactProblem, bounds: Vector) -> tuple[Indices, ContactProblem]:
    """Return the contacts with a notable bound b of friction, and Tresca's problem, |T u - o| <= s costing b s."""
    assert problem.tangent is not None
    assert problem.slip_origin is not None
    bounded = np.flatnonzero(bounds > NO_BOUND * np.max(bounds, initial=0.0))
    count, along, origin = len(bounded), problem.tangent[bounded], problem.slip_origin.ravel()[bounded]
    one = sp.identity(count, format="csr")
    rows = sp.bmat([[problem.normal, None], [along, -one], [-along, -one]], format="csr")
    K = sp.block_diag([problem.stiffness_rows, sp.csr_matrix((count, count))], format="csr")
    gap = np.concatenate([problem.gap, origin, -origin])
    ties = {"tie": sp.hstack([problem.tie, sp.csr_matrix((problem.ties, count))]), "tie_value": problem.tie_value}
    return bounded, ContactProblem(K, np.append(problem.load, -bounds[bounded]), rows, gap, **ties)


def _combination(problem: ContactProblem, found: Answer, bounded: Indices, bounds: Vector | None) -> Status:
    """Return the combination of a rough answer: forces and gaps, room of friction and slips are compared as lengths."""
    assert problem.tangent is not None
    assert problem.slip_origin is not None
    m, u = problem.contacts, found.displacement[: problem.dimension]
    slip, status = problem.tangent @ u - problem.slip_origin.ravel(), np.full(m, STICK)
    if bounds is not None:
        room = bounds.copy()
        room[bounded] -= abs(np.subtract(*np.split(found.normal_force[m:], 2)))
        sticks = abs(slip) < own_compliance(problem, problem.tangent) * room
        status = np.where(sticks, STICK, np.where(slip > 0, SLIP_ON, SLIP_BACK))
    closed = own_compliance(problem, problem.normal) * found.normal_force[:m] > problem.gap - problem.normal @ u
    return np.where(closed, status, OPEN).astype(np.int8)


def _roughly(problem: ContactProblem, settings: Settings) -> Answer | None:
    """Return the answer of an interior point to a convex problem, None if it finds none."""
    twin, scaling = equilibrated(problem)
    with suppress(BackendFailed, BackendMissing):
        found = find("clarabel").solve(twin, Settings(ROUGH, None, settings.now.time_limit))
        return scaling.unscale(found).answer if found.claimed else None
    return None


def _plain(rows: SparseFrictionalRows, status: Status) -> Status:
    """Return a combination in which closed contacts without friction have one state, SLIP_ON."""
    return np.where((~rows.slides | (rows.coefficient <= 0)) & (status != OPEN), SLIP_ON, status).astype(np.int8)


def _suggested(problem: ContactProblem, rows: SparseFrictionalRows, found: RefinedState, status: Status) -> Status:
    """Return the combination that Alart's and Curnier's projections make of the answer of another combination."""
    answer = found.answer(1)
    assert problem.tangent is not None
    assert problem.slip_origin is not None
    assert answer.friction_force is not None
    u, normal = answer.displacement, answer.normal_force * rows.normal_length
    friction = answer.friction_force[:, 0] * rows.tangent_length
    gap = (problem.gap - problem.normal @ u) / rows.normal_length
    slip = (problem.tangent @ u - problem.slip_origin.ravel()) / rows.tangent_length
    closed, stuck = status != OPEN, status == STICK
    push = np.where(closed, normal, -gap)
    trial = np.where(stuck, friction, friction + slip)
    rounding = SPARSE_ROUNDING * float(np.max(abs(normal), initial=0.0))
    sliding = np.where(trial > 0, SLIP_ON, SLIP_BACK)
    # Conditions that hold within rounding do not change a state.
    sticks = abs(trial) <= rows.coefficient * push + np.where(stuck, rounding, 0.0)
    slides = ~stuck & closed
    # A contact that slides against its friction sticks before it slides the other way.
    sliding = np.where(slides, np.where(_slip_directions(status) * slip >= -rounding, status, STICK), sliding)
    following = np.where(sticks & ~slides, STICK, sliding)
    closes = np.where(closed, push > -rounding, push > rounding)
    return _plain(rows, np.where(closes, following, OPEN).astype(np.int8))


def _next_unseen(status: Status, following: Status, seen: set[bytes]) -> Status | None:
    """Return the first untried combination that differs by one of the changes, None where all have been tried."""
    for i in np.flatnonzero(status != following):
        one = status.copy()
        one[i] = following[i]
        if one.tobytes() not in seen:
            return one
    return None


def _slip_directions(status: Status) -> Vector:
    """Return the directions of slip (m,), +1 or -1, zero where a contact does not slip."""
    return np.where(abs(status) == 1, status, 0).astype(float)
