"""Coulomb friction in the plane with many contacts: Newton's method on combinations, in sparse systems.

The method of `contactqp.solving.friction.newton` with the systems of `contactqp.linalg.sparse_states`, which contain
every unknown of the bodies. It starts from the contacts that close without friction, all of them stuck, which the
active set on a hierarchy finds, or from the combination of a known answer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from contactqp.errors import BackendFailed, NotConverged
from contactqp.linalg.friction_states import MAX_SWEEPS, RefinedState, without_noise
from contactqp.linalg.iteration import iteration
from contactqp.linalg.measures import own_compliance
from contactqp.linalg.runtime import stated_limit
from contactqp.linalg.sparse_states import SparseFrictionalRows, frictional_rows, refined_sparse
from contactqp.model.arrays import Vector
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer
from contactqp.solving.friction.newton import combination_of
from contactqp.solving.methods import Settings
from contactqp.solving.methods.inexact_active_set import identified_by_iteration

# Combinations before it is given up, and the sweeps of refinement that tell their signs.
MAX_STEPS, LOOSE_SWEEPS = 40, 1
# Signs that fail by this part of the largest force, lengths and forces both in sqrt(energy), fail by rounding.
ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class SparseNewtonAnswer:
    """Coulomb's answer to the last digits, the combinations it took, and how many of them were factorised."""

    answer: Answer
    steps: int
    factorisations: int
    back_substitutions: int


# Slips on the set that closes without friction are wanted as well as the set.
SLIPS_KNOWN = 1e-6
# A contact that slips without friction by so many times what its bound would move its unknowns alone is taken to slip:
# the surface around it follows. On strips with friction between 0.05 and 1 this saves up to two combinations of six and
# costs none.
COMPLIANT = 30.0


def solve_sparse_newton(problem: ContactProblem, settings: Settings) -> SparseNewtonAnswer:
    """Find Coulomb's answer in the plane for bodies that are held.

    Raises
    ------
    NotConverged
        The combinations come back, or one of them has a system without an inverse.
    """
    rows, spent, began = frictional_rows(problem), 0, time.perf_counter()
    before = rows.factorisations
    here = Answer(np.zeros(problem.dimension), np.zeros(problem.contacts), None, np.zeros(problem.ties))
    status, seen = _plain(rows, _first(problem, settings)), set()
    for step in range(1, (settings.max_iter or MAX_STEPS) + 1):
        seen.add(status.tobytes())
        try:
            found = refined_sparse(problem, status, here, LOOSE_SWEEPS)
        except BackendFailed as error:
            raise NotConverged(f"newton: {error}") from error
        here = found.answer(1)
        solved = rows.system(problem, status).back_substitutions
        spent += solved
        if not (found.regular and here.finite()):
            raise NotConverged(f"newton: the system of combination {step} has no inverse")
        following = _suggested(problem, rows, found, status)
        if np.array_equal(following, status):
            last = refined_sparse(problem, status, here, MAX_SWEEPS).answer(1)
            spent += rows.system(problem, status).back_substitutions - solved
            clean = without_noise(problem, rows, last, here)
            return SparseNewtonAnswer(clean, step, rows.factorisations - before, spent)
        if following.tobytes() in seen:  # the signs of a few contacts chase each other: one at a time
            one = _next_unseen(status, following, seen)
            if one is None:
                break
            following = one
        if settings.time_limit is not None and time.perf_counter() > began + settings.time_limit:
            raise NotConverged(f"newton: stopped at the time limit of {stated_limit(settings.time_limit)}")
        status = following
    raise NotConverged(f"newton: no combination of open, stick and slip whose signs hold ({len(seen)} tried)")


def _first(problem: ContactProblem, settings: Settings) -> Status:
    """The combination of a known answer, else what closes without friction, slipping on where it slips far."""
    if settings.warm_start is not None:
        return combination_of(problem, settings.warm_start)
    found = identified_by_iteration(problem, iteration(problem), settings, SLIPS_KNOWN)
    if found is None:
        raise NotConverged("newton: the contacts that close without friction were not found")
    assert problem.tangent is not None
    assert problem.slip_origin is not None
    assert problem.friction is not None
    slip = problem.tangent @ found.displacement - problem.slip_origin.ravel()
    held = COMPLIANT * own_compliance(problem, problem.tangent) * problem.friction * found.normal_force
    closed = np.where(abs(slip) <= held, STICK, np.where(slip > 0, SLIP_ON, SLIP_BACK))
    return np.where(found.normal_force > 0, closed, OPEN).astype(np.int8)


def _plain(rows: SparseFrictionalRows, status: Status) -> Status:
    """Return a combination in which closed contacts without friction have one state, SLIP_ON."""
    return np.where((~rows.slides | (rows.coefficient <= 0)) & (status != OPEN), SLIP_ON, status).astype(np.int8)


def _suggested(problem: ContactProblem, rows: SparseFrictionalRows, found: RefinedState, status: Status) -> Status:
    """The combination that the projections of Alart and Curnier make of the answer of another."""
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
    rounding = ROUNDING * float(np.max(abs(normal), initial=0.0))
    sliding = np.where(trial > 0, SLIP_ON, SLIP_BACK)
    # What already holds by rounding stays: a gap of zero opens, a friction force at its bound slips, one time only.
    sticks = abs(trial) <= rows.coefficient * push + np.where(stuck, rounding, 0.0)
    slides = ~stuck & closed
    # What slides against its friction sticks before it slides the other way.
    sliding = np.where(slides, np.where(_way(status) * slip >= -rounding, status, STICK), sliding)
    following = np.where(sticks & ~slides, STICK, sliding)
    closes = np.where(closed, push > -rounding, push > rounding)
    return _plain(rows, np.where(closes, following, OPEN).astype(np.int8))


def _next_unseen(status: Status, following: Status, seen: set[bytes]) -> Status | None:
    """The combination with the first single change that leads to one which has not been tried."""
    for i in np.flatnonzero(status != following):
        one = status.copy()
        one[i] = following[i]
        if one.tobytes() not in seen:
            return one
    return None


def _way(status: Status) -> Vector:
    """(m,) the direction of slip, zero where a contact does not slip."""
    return np.where(abs(status) == 1, status, 0).astype(float)
