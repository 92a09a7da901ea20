"""Newton's method with inequality constraints, globalised by the energy: one contact problem an iteration (SQP)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.large.active_kkt import negative_on, positive_semidefinite
from contactqp.analysis.large.deformation import Forces, Imbalance, Instant, LargeSolution, LoadedBody, NewtonIteration
from contactqp.analysis.large.newton_step import (
    NewtonSettings,
    NewtonStep,
    Target,
    in_displacement,
    newton_step,
    slipped,
    stationary_step,
)
from contactqp.certificate.certificate import compute_certificate, contact_status
from contactqp.elements.deformable import ContactGeometry, ContactState
from contactqp.errors import InvalidProblem, NotCertified, NotConverged
from contactqp.model.arrays import Array, Vector
from contactqp.model.solution import Work

# Armijo's part of the slope, and the shortest fraction of a step that is tried.
SUFFICIENT = 1e-4
SHORTEST = 2.0**-30
# How far a shifted step is stretched.
LONGEST = 2.0**10
# The weight of what violates constraints in the merit, over the largest force: above 1 the merit is exact.
WEIGHT = 2.0
# A full step that leaves less than this part of the imbalance is taken although the merit rises: near the answer a
# curved constraint lets it (Maratos 1978).
CONTRACTION = 0.5
# Rounding of an energy, over the sizes that add up to it.
MERIT_ROUNDING = 1e-13
# Displacements beyond this, in any unit, are those of a body that nothing holds: of a bar that has torn.
RUN_AWAY = 1e50


@dataclass(frozen=True, eq=False)
class Balance:
    """An equilibrium that Newton's method has found."""

    now: Instant
    forces: Forces
    before: Instant  # where the last step set out
    step: NewtonStep  # the last one
    iterations: tuple[NewtonIteration, ...]
    seconds: float

    @property
    def shifted(self) -> bool:
        """Whether the way led through tangents that had no way down."""
        return any(iteration.shift for iteration in self.iterations)


@np.errstate(over="ignore", invalid="ignore")  # what is no number is stepped back from, or said
def find_balance(
    loaded: LoadedBody, start: Vector, forces: Forces, target: Target, settings: NewtonSettings
) -> Balance:
    """The equilibrium under a load that lies down the energy from a start, one contact problem an iteration.

    The merit is energy - f'u + w (sum of overlaps + sum of |A u - b|), w above the largest force; steps are halved
    until it falls. Approximate methods and friction have no such merit and take full steps.

    Raises
    ------
    NotConverged
        Too many iterations, no way down, a body turned inside out, a lost contact pair.
    Unsupported
        An indefinite tangent, and a method or friction that cannot have it.
    """
    started = time.perf_counter()
    try:
        now = loaded.at(start)
    except InvalidProblem as error:
        raise NotConverged(f"at the start: {error}") from error
    iterations: list[NewtonIteration] = []
    step, weight, reason = None, 0.0, ""
    for _ in range(settings.max_iter):
        K = loaded.hessian(now, forces)
        start_error = _imbalance_before(loaded, now, K, forces, target, settings)
        if not iterations and start_error.nothing and _sticks(loaded, now, forces, target, settings):
            step = stationary_step(loaded, now, K, target, np.zeros(loaded.dimension), forces)
            stayed = NewtonIteration(start_error.force, start_error.length, 1.0, 0.0, changed=False)
            return Balance(now, forces, now, step, (stayed,), time.perf_counter() - started)
        step = newton_step(loaded, now, K, target, settings, step, forces)
        weight = max(weight, _weight(loaded, now, K, target, step))
        fraction, new, reason = _searched(loaded, now, K, target, settings, step, weight, start_error)
        if np.max(abs(new.displacement), initial=0.0) > RUN_AWAY:
            raise NotConverged("Newton's method: the displacements grow without bound, nothing balances the load")
        left = _imbalance_after(loaded, now, new, K, target, settings, step)
        changed = not np.array_equal(forces.normal > 0, step.forces.normal > 0)
        iterations.append(NewtonIteration(left.force, left.length, fraction, step.shift, changed))
        if left.nothing and fraction == 1:
            if step.shift:  # a saddle of the energy, from which nothing drives the body
                step = stationary_step(loaded, now, K, target, step.increment, step.forces)
            return Balance(new, step.forces, now, step, tuple(iterations), time.perf_counter() - started)
        now, forces = new, step.forces
    words = f"; full steps fail: {reason}" if reason else ""
    if all(iteration.shift for iteration in iterations):
        words += "; no tangent on the way held the body: its load may drive a motion that nothing holds"
    raise NotConverged(
        f"Newton's method: {settings.max_iter} iterations leave {iterations[-1].force_error:.3g} of the forces and "
        f"{iterations[-1].length_error:.3g} of the displacement{words}"
    )


def _sticks(loaded: LoadedBody, now: Instant, forces: Forces, target: Target, settings: NewtonSettings) -> bool:
    """Whether contacts with friction hold a body where it is, without slip and within their bounds.

    A step that changes nothing leaves slips of rounding and forces at their bounds, from which no method can tell stick
    from slip.
    """
    if target.anchor is None or loaded.contact is None or loaded.friction is None or forces.friction is None:
        return False
    slip, reach = loaded.contact.slip_since(now.displacement, target.anchor), now.contact.rounding
    bound = loaded.friction * forces.normal * (1 + 1e-12)
    closed = forces.normal > 0
    still = np.all(np.linalg.norm(slip[closed], axis=1) <= reach[closed])
    left = settings.tolerance * float(np.max(abs(now.displacement), initial=0.0))
    touches = np.all(abs(now.contact.gap[closed]) <= np.maximum(reach, left)[closed])
    return bool(still and touches and np.all(np.linalg.norm(forces.friction, axis=1) <= bound))


def _imbalance_before(
    loaded: LoadedBody, now: Instant, K: Any, forces: Forces, target: Target, settings: NewtonSettings
) -> Imbalance:
    overlap, tie = np.maximum(-now.contact.gap, 0.0), abs(loaded.tie @ now.displacement - target.tie_value)
    rounding = np.concatenate([now.contact.rounding, np.zeros(len(tie))])
    errors = np.concatenate([overlap, tie])
    return loaded.imbalance(now, K, target.load, forces, errors, rounding, settings.tolerance)


def _imbalance_after(
    loaded: LoadedBody,
    now: Instant,
    new: Instant,
    K: Any,
    target: Target,
    settings: NewtonSettings,
    step: NewtonStep,
) -> Imbalance:
    """What a step leaves: forces with the rows of its end, and how far gaps and slips are from what it took them for.

    Of contacts that neither push nor overlap no gap matters.
    """
    du, rounding = new.displacement - now.displacement, new.contact.rounding
    matters = (step.forces.normal > 0) | (new.contact.gap < -rounding)
    gap_error = np.where(matters, abs(new.contact.gap - (now.contact.gap - now.contact.normal @ du)), 0.0)
    errors, allowed = [gap_error], [rounding]
    if target.anchor is not None and loaded.contact is not None:
        turned = loaded.contact.slip_since(new.displacement, target.anchor)
        taken = loaded.contact.slip_since(now.displacement, target.anchor)
        slip_error = abs(turned - taken - (now.contact.tangent @ du).reshape(turned.shape))
        errors.append(np.where(matters[:, None], slip_error, 0.0).ravel())
        allowed.append(np.repeat(rounding, turned.shape[1]))
    tie = abs(loaded.tie @ new.displacement - target.tie_value)
    together = np.concatenate([*errors, tie]), np.concatenate([*allowed, np.zeros(len(tie))])
    return loaded.imbalance(new, K, target.load, step.forces, *together, settings.tolerance)


def _searched(
    loaded: LoadedBody,
    now: Instant,
    K: Any,
    target: Target,
    settings: NewtonSettings,
    step: NewtonStep,
    weight: float,
    before: Imbalance,
) -> tuple[float, Instant, str]:
    """The fraction of the step that is taken, the body there, and why it is not the whole step."""
    by_merit = settings.exact and target.anchor is None
    start, rounding = _merit(loaded, now, target, weight)
    violation = _violation(loaded, now, target)
    slope = -float((target.load - now.internal) @ step.increment) - weight * violation
    fraction, reason = 1.0, ""
    while fraction >= SHORTEST:
        try:
            new = loaded.at(now.displacement + fraction * step.increment)
            merit, more = _merit(loaded, new, target, weight)
        except InvalidProblem as error:
            reason, merit, more = str(error), np.inf, 0.0
        if np.isfinite(merit):
            if not by_merit or merit <= start + SUFFICIENT * fraction * min(slope, 0.0) + max(rounding, more):
                if by_merit and step.shift and fraction == 1:
                    fraction, new = _stretched(loaded, now, target, step, weight, merit, new)
                return fraction, new, reason
            if fraction == 1 and not step.shift:
                left = _imbalance_after(loaded, now, new, K, target, settings, step)
                if left.nothing or left.size <= CONTRACTION * before.size:
                    return fraction, new, reason
            reason = "the energy does not fall"
        fraction /= 2
    raise NotConverged(f"Newton's method: no part of the step can be taken: {reason or 'the energy is no number'}")


def _stretched(
    loaded: LoadedBody, now: Instant, target: Target, step: NewtonStep, weight: float, merit: float, new: Instant
) -> tuple[float, Instant]:
    """A shifted step is too short, most of all off a saddle: twice as far as long as that is further down."""
    fraction = 1.0
    while fraction < LONGEST:
        try:
            further = loaded.at(now.displacement + 2 * fraction * step.increment)
            lower, rounding = _merit(loaded, further, target, weight)
        except InvalidProblem:
            break
        if not lower < merit - rounding:
            break
        fraction, new, merit = 2 * fraction, further, lower
    return fraction, new


def _weight(loaded: LoadedBody, now: Instant, K: Any, target: Target, step: NewtonStep) -> float:
    """Enough for the step to lead down the merit, also where K has negative energy across the constraints (Nocedal and
    Wright 2006, 18.36)."""
    du, violation = step.increment, _violation(loaded, now, target)
    rise = -float((target.load - now.internal) @ du) + max(float(du @ (K @ du)), 0.0) / 2
    return max(WEIGHT * step.forces.largest, WEIGHT * rise / violation if violation > 0 else 0.0)


def _violation(loaded: LoadedBody, now: Instant, target: Target) -> float:
    overlap = np.sum(np.maximum(-now.contact.gap, 0.0))
    return float(overlap + np.sum(abs(loaded.tie @ now.displacement - target.tie_value)))


def _merit(loaded: LoadedBody, now: Instant, target: Target, weight: float) -> tuple[float, float]:
    """energy - f'u + weight * violation, and what rounding may make of it."""
    elastic, work = loaded.body.energy(now.displacement), float(target.load @ now.displacement)
    penalty = weight * _violation(loaded, now, target)
    size = abs(elastic) + float(abs(target.load) @ abs(now.displacement)) + penalty
    return elastic - work + penalty, MERIT_ROUNDING * size


# Where the slips of a load step are counted from, when contacts slide far and close on the way.


@dataclass(frozen=True, eq=False)
class HeldOpen:
    """Contacts some of which are too far away to close."""

    geometry: ContactGeometry
    offset: Vector  # (m,) added to the gaps [length]

    @property
    def contacts(self) -> int:
        """m."""
        return self.geometry.contacts

    def state(self, displacement: Vector) -> ContactState:
        """With wider gaps."""
        state = self.geometry.state(displacement)
        return replace(state, gap=state.gap + self.offset)

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Return that of the underlying geometry."""
        return self.geometry.curvature(displacement, normal_force)

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Return that of the underlying geometry."""
        return self.geometry.slip_since(displacement, anchor)

    def positions(self, displacement: Vector) -> Vector:
        """Return that of the underlying geometry."""
        return self.geometry.positions(displacement)


def balance_with_anchors(
    loaded: LoadedBody,
    position: Array,
    gap: Vector,
    touching: Any,
    solve_with: Callable[[LoadedBody, Array], Balance],
) -> tuple[Balance, Array]:
    """The balance at the end of a step, and the anchors (m, d) of its slips.

    A contact that touched is anchored where it was. One that closes is anchored where it would have met the obstacle
    had it gone on without it: at the fraction of the step at which the gap of that motion vanishes.

    Parameters
    ----------
    position, gap, touching : (m, d), (m,), (m,)
        At the start of the step.
    solve_with : function
        The balance of a body whose slips start at anchors.
    """
    found = solve_with(loaded, position)
    closes = (found.forces.normal > 0) & ~touching
    if not np.any(closes) or loaded.contact is None:
        return found, position
    anchor = position.copy()
    far = np.where(closes, 1e3 * (abs(gap) + float(np.max(abs(gap)))), 0.0)
    free = LoadedBody(loaded.body, HeldOpen(loaded.contact, far), loaded.tie, loaded.friction)
    try:
        beyond = solve_with(free, position)
        end, reached = loaded.contact.positions(beyond.now.displacement), beyond.now.contact.gap - far
    except NotConverged:  # without the contact nothing holds the body: where it lands is all that is known
        end, reached = loaded.contact.positions(found.now.displacement), found.now.contact.gap
    fraction = np.clip(gap / np.maximum(gap - reached, np.finfo(float).tiny), 0.0, 1.0)
    anchor[closes] += (fraction[:, None] * (end - position))[closes]
    return solve_with(loaded, anchor), anchor


# From a balance that Newton's method found to a certified solution of the history.

# Friction within this part of its bound is at it.
STICKS = 1e-9


def large_solution(
    loaded: LoadedBody, balance: Balance, target: Target, load_factor: float, settings: NewtonSettings
) -> LargeSolution:
    """The equilibrium with the certificate of its last Newton step, and whether it is stable.

    Raises
    ------
    NotCertified
        The certificate refuses the answer of an exact method.
    """
    now, step, forces = balance.now, balance.step, balance.forces
    problem = in_displacement(step.problem, balance.before.displacement)
    started = time.perf_counter()
    friction = forces.friction
    if friction is None and problem.slip_origin is not None:
        friction = np.zeros_like(problem.slip_origin)
    certificate = compute_certificate(problem, now.displacement, forces.normal, friction, forces.tie)
    if step.springs:
        note = (
            f"the tangent is indefinite: certified on springs of {step.springs:.3g} that are relaxed at the answer; "
            "balance and contact are those of the body, its stability is another question"
        )
        certificate = replace(certificate, notes=(*certificate.notes, note))
    spent = time.perf_counter() - started
    found = step.solution
    solution = LargeSolution(
        problem=problem,
        displacement=now.displacement,
        normal_force=forces.normal,
        friction_force=friction,
        tie_force=forces.tie,
        contact_status=contact_status(problem, certificate),
        free_motions=() if found is None else found.free_motions,
        certificate=certificate,
        method=settings.method if found is None else found.method,
        seconds=balance.seconds + spent,
        certify_seconds=spent,
        work=replace(Work() if found is None else found.work, iterations=len(balance.iterations)),
        history=tuple(iteration.error for iteration in balance.iterations),
        load_factor=load_factor,
        load=target.load,
        tie_value=target.tie_value,
        increment=step.increment,
        current_gap=now.contact.gap,
        current_slip=slipped(loaded, now, target),
        position=None if loaded.contact is None else loaded.contact.positions(now.displacement),
        elastic=loaded.body.energy(now.displacement),
        negative=negative_motions(loaded, balance),
        iterations=balance.iterations,
    )
    if settings.exact and not certificate.passed:
        failures = "; ".join(certificate.failures)
        raise NotCertified(f"the certificate refuses the last step: {failures}", solution)
    return solution


def negative_motions(loaded: LoadedBody, balance: Balance) -> int:
    """How many motions that keep ties, pushing contacts and sticking ones as they are lower the energy."""
    K = loaded.hessian(balance.now, balance.forces)
    if positive_semidefinite(K):
        return 0
    contact, forces = balance.now.contact, balance.forces
    rows = [contact.normal[np.flatnonzero(forces.normal > 0)], loaded.tie]
    if forces.friction is not None and loaded.friction is not None and contact.tangent is not None:
        width = forces.friction.shape[1]
        sticks = np.linalg.norm(forces.friction, axis=1) < loaded.friction * forces.normal * (1 - STICKS)
        rows.append(contact.tangent[np.flatnonzero(np.repeat(sticks, width))])
    return negative_on(K, sp.vstack(rows, format="csr"))
