"""Coulomb friction in the plane by Newton's method on the combination of states.

A combination of open, stick and slip either way is solved as the linear system that it is; the projections

    closed where l_N + r_N (N x - g) > 0,   sliding where |l_T + r_T (T x - o)| > mu (l_N + r_N (N x - g))

suggest the next one, until its signs hold: the semismooth Newton method of Alart and Curnier (1991), which in the plane
is a primal-dual active set (Hueeber, Stadler and Wohlmuth 2008). From the combination of the load before it takes a
step or two. Where combinations come back, one contact at a time is changed, the one whose signs fail most.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.figures import holds
from contactqp.errors import NotConverged
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.friction_states import answer_in
from contactqp.linalg.measures import lengths_that_meet, ratio
from contactqp.model.arrays import Vector
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate, Solution
from contactqp.solving.friction.force_system import CombinationAnswer, ForceSystem, Lengths

# Signs that fail by this part of the largest length or force, both in sqrt(energy), fail by rounding.
ROUNDING = 1e-13
# Where combinations come back: refinement, which judges each contact in its own measure, has the last word.
DOUBTFUL = 1e-11
# What fails by more than this part of the answer itself is no rounding of it: on bodies that next to nothing holds, the
# displacement without contact forces, in which ROUNDING is measured, may be larger than the answer by all its digits.
DROWNED = 1e-6
# A slip of this part of the lengths that meet is none.
STILL = 1e-12
# Suggestions in a row, and changes of one contact each for every contact, before it is given up.
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
    time_limit: float | None = None,
) -> NewtonAnswer:
    """Find Coulomb's answer from the combination of `start`, or from all touching contacts stuck.

    Raises
    ------
    NotConverged
        The combinations come back.
    """
    began = time.perf_counter()
    system = ForceSystem(problem, condensation)
    lengths = system.lengths(problem, condensation.reduce_load(problem.load)[0])
    status = _touching(system, lengths) if start is None else combination_of(problem, start)
    limit = None if time_limit is None else began + time_limit
    found, steps = search(system, lengths, status, max_iter=max_iter, until=limit)
    answer = refined(problem, condensation, system, lengths, found)
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
    """The answer of a combination to the last digits; nothing is said of whether its signs hold."""
    _, inner = condensation.reduce_load(problem.load)
    expanded = condensation.expand(system.displacement(found, lengths) * system.rows.scale, inner)
    answer = answer_in(problem, condensation, system.rows, found.status, system.unscaled(found, expanded))
    return without_idle_friction(system, answer)


def without_idle_friction(system: ForceSystem, answer: Answer) -> Answer:
    """A contact that cannot slide has no friction: its tangential row is zero, and any friction would do."""
    if answer.friction_force is None or np.all(system.rows.slides):
        return answer
    return replace(answer, friction_force=np.where(system.rows.slides[:, None], answer.friction_force, 0.0))


def search(
    system: ForceSystem,
    lengths: Lengths,
    start: Status,
    held_open: NDArray[np.bool_] | None = None,
    max_iter: int | None = None,
    until: float | None = None,
) -> tuple[CombinationAnswer, int]:
    """Return the combination whose signs hold and the number of those solved; contacts `held_open` (m,) may overlap.

    Raises
    ------
    NotConverged
        As `solve_newton`.
    """
    status = system.plain(start)
    if held_open is not None:
        status = np.where(held_open, OPEN, status).astype(np.int8)
    seen: set[bytes] = set()
    best: tuple[float, CombinationAnswer] | None = None
    single, left = False, MAX_STEPS if max_iter is None else max_iter
    steps = 0
    while left > 0 and (until is None or time.perf_counter() < until):
        seen.add(status.tobytes())
        found = system.solve(status, lengths)
        steps, left = steps + 1, left - 1
        wrong = found.worst(system.coefficient)
        if held_open is not None:
            wrong = np.where(held_open, -np.inf, wrong)
        size = max(lengths.felt(status), float(np.max(found.normal, initial=0.0)))
        # A combination that has no answer may be passed through, and is none.
        worst = max(float(np.max(wrong, initial=0.0)), found.left if found.left > DOUBTFUL * size else 0.0)
        if worst <= ROUNDING * size:
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
            following = _one_changed(status, following, wrong)
            if following.tobytes() in seen:
                break
        status = following
    if best is not None and best[0] <= DOUBTFUL:
        return _not_drowned(system, lengths, best[1], held_open), steps
    raise NotConverged(f"newton: no combination of open, stick and slip whose signs hold ({steps} tried)")


def _not_drowned(
    system: ForceSystem, lengths: Lengths, found: CombinationAnswer, held_open: NDArray[np.bool_] | None
) -> CombinationAnswer:
    """An answer whose signs fail by no more than rounding, unless that is as large as the answer."""
    wrong = np.where(False if held_open is None else held_open, 0.0, found.worst(system.coefficient))
    fails = max(float(np.max(wrong, initial=0.0)), found.left)
    parts = (lengths.target, found.normal, found.friction, found.gap, found.slip)
    if fails > DROWNED * max(float(np.max(abs(part), initial=0.0)) for part in parts):
        raise NotConverged("newton: beside the displacement without contact forces nothing is left of the answer")
    return found


def suggested(system: ForceSystem, found: CombinationAnswer) -> Status:
    """The combination that the projections make of an answer."""
    m = system.contacts
    push = found.normal - system.resistance[:m] * found.gap
    trial = found.friction + system.resistance[m:] * found.slip
    sliding = np.where(trial > 0, SLIP_ON, SLIP_BACK)
    status = np.where(abs(trial) <= system.coefficient * push, STICK, sliding)
    return system.plain(np.where(push > 0, status, OPEN).astype(np.int8))


def combination_of(problem: ContactProblem, candidate: Candidate | Solution) -> Status:
    """Return the states of an answer: closed where it pushes, slipping where E_T u has left the origin."""
    if problem.tangent is None or problem.slip_origin is None:
        raise ValueError("combination of a problem without friction")
    origin, u = problem.slip_origin.ravel(), candidate.displacement
    slip = problem.tangent @ u - origin
    still = ratio(abs(slip), lengths_that_meet(problem, problem.tangent, origin, u)) <= STILL
    status = np.where(still, STICK, np.where(slip > 0, SLIP_ON, SLIP_BACK))
    return np.where(candidate.normal_force > 0, status, OPEN).astype(np.int8)


def _one_changed(status: Status, following: Status, wrong: Vector) -> Status:
    """Only the contact whose signs fail most changes."""
    changes = status != following
    if not np.any(changes):
        return status
    i = int(np.argmax(np.where(changes, wrong, -np.inf)))
    one = status.copy()
    one[i] = following[i]
    return one


def _touching(system: ForceSystem, lengths: Lengths) -> Status:
    """All contacts that overlap without forces stuck; where bodies float, all contacts."""
    m = system.contacts
    overlap = lengths.free[:m] >= lengths.target[:m]
    floats = len(lengths.drive) > 0
    return np.where(overlap | floats, STICK, OPEN).astype(np.int8)
