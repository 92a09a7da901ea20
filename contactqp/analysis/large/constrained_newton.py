"""Newton's method with inequality constraints, globalised by the energy: one contact problem an iteration (SQP)."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactqp.analysis.large.active_kkt import positive_semidefinite
from contactqp.analysis.large.deformation import Forces, Imbalance, Instant, LoadedBody, NewtonIteration
from contactqp.analysis.large.newton_step import NewtonSettings, NewtonStep, Target, newton_step, stationary_step
from contactqp.errors import InvalidProblem, NotConverged
from contactqp.model.arrays import EPS, Vector, refuse_late

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
# What is left of the forces and no longer falls may be rounding of the internal force where it is this part of them.
UNRESOLVED = 1e-6
# Fractions of a step, each half of the one before, along which a force that is not rounding follows a line somewhere.
FRACTIONS = 12
# Rounding of an energy, over the sizes that add up to it.
MERIT_ROUNDING = 1e-13
# Displacements beyond so many times that of the start and of the first step are those of a body that nothing holds: of
# a bar that has torn.
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
    unresolved: float = 0.0  # what rounding of the internal force leaves out of balance, over the path's largest force

    @property
    def shifted(self) -> bool:
        """Say whether the iterations met tangents without a descent direction."""
        return any(iteration.shift for iteration in self.iterations)


@np.errstate(over="ignore", invalid="ignore")  # what is not a number is stepped back from, or said
def find_balance(
    loaded: LoadedBody, start: Vector, forces: Forces, target: Target, settings: NewtonSettings
) -> Balance:
    """Find the equilibrium under a load that lies down the energy from a start, by one contact problem an iteration.

    The merit is energy - f'u + w (sum of overlaps + sum of |A u - b|), w above the largest force; steps are halved
    until it falls. Approximate methods and friction have no such merit and take full steps.

    Raises NotConverged: too many iterations, no way down, a body turned inside out, a lost contact pair; Unsupported:
    an indefinite tangent, and a method or friction that cannot have it.

    Parameters
    ----------
    loaded : the body with its contacts and ties
    start : (n,) array, the displacement from which the iterations start
    forces : the forces there
    target : loads, tie values and slip origins
    settings : method, options and tolerance
    """
    started = time.perf_counter()
    try:
        now = loaded.at(start)
    except InvalidProblem as error:
        raise NotConverged(f"at the start: {error}") from error
    iterations: list[NewtonIteration] = []
    step, weight, reason, reach, first = None, 0.0, "", float(np.max(abs(start), initial=0.0)), None
    for _ in range(settings.max_iter):
        refuse_late("the next step of Newton's method")
        K = loaded.hessian(now, forces)
        first = first if iterations else K
        start_error = _imbalance_before(loaded, now, K, forces, target, settings)
        if not iterations and start_error.nothing and target.anchor is not None:
            resting = now if _sticks(loaded, now, forces, target, settings) else _at_rest(now, forces, target)
            if resting is not None:
                step = stationary_step(loaded, resting, K, target, np.zeros(loaded.dimension), forces)
                unmoved = NewtonIteration(start_error.force, start_error.length, 1.0, 0.0, changed=False)
                return Balance(resting, forces, resting, step, (unmoved,), time.perf_counter() - started)
        step = newton_step(loaded, now, K, target, settings, step, forces)
        weight = max(weight, _weight(loaded, now, K, target, step))
        fraction, new, reason = _searched(loaded, now, K, target, settings, step, weight, start_error)
        size = float(np.max(abs(new.displacement), initial=0.0))
        reach = reach if iterations else max(reach, size)
        if size / RUN_AWAY > reach:
            raise NotConverged("Newton's method: the displacements grow without bound, nothing balances the load")
        residual = _imbalance_after(loaded, now, new, K, target, settings, step)
        changed = not np.array_equal(forces.normal > 0, step.forces.normal > 0)
        iterations.append(NewtonIteration(residual.force, residual.length, fraction, step.shift, changed))
        if _comes_to_rest(start, new, target):
            rest = loaded.at(np.zeros_like(start))
            K = loaded.hessian(rest, step.forces)
            at_rest = _imbalance_before(loaded, rest, K, step.forces, target, settings)
            if at_rest.nothing:
                still = stationary_step(loaded, rest, K, target, np.zeros_like(start), step.forces)
                spent = time.perf_counter() - started
                return Balance(rest, step.forces, rest, still, tuple(iterations), spent)
        unresolved = 0.0
        stays = residual.force >= CONTRACTION * start_error.force and residual.lengths_are_met and not changed
        if stays and fraction == 1 and not residual.nothing:
            unresolved = _rounding(loaded, now, K, target, step, residual)
        if fraction == 1 and (residual.nothing or unresolved):
            if step.shift:  # a saddle of the energy, from which nothing drives the body
                step = stationary_step(loaded, now, K, target, step.increment, step.forces)
            spent = time.perf_counter() - started
            return Balance(new, step.forces, now, step, tuple(iterations), spent, unresolved)
        now, forces = new, step.forces
    raise _not_converged(iterations, reason, positive_semidefinite(first))


def _comes_to_rest(start: Vector, new: Instant, target: Target) -> bool:
    """Return whether, without load and friction, the displacement has come down to rounding of its rounding.

    Forces relative to those that remain do not vanish on the way to rest, until they leave the range of doubles.
    """
    if target.load.any() or target.anchor is not None or not start.any():
        return False
    return bool(np.max(abs(new.displacement)) <= EPS**2 * np.max(abs(start)))


def _not_converged(iterations: list[NewtonIteration], reason: str, convex: bool) -> NotConverged:
    """Return the error of iterations that have not come to an end, with what may be the cause.

    Where the first tangent was `convex`, with no negative energy, it was shifted because its load met no stiffness.
    """
    words = f"; full steps fail: {reason}" if reason else ""
    if all(iteration.shift for iteration in iterations):
        words += "; no tangent on the way held the body: its load may drive a motion that nothing holds"
    elif iterations[0].shift and convex:
        words += (
            "; at the start the load drives a mechanism, such as a bar without tension across itself: stretch it "
            "first, by a leg of loads that stays, or begin where it would hang (start=)"
        )
    last = iterations[-1]
    return NotConverged(
        f"Newton's method: {len(iterations)} iterations leave {last.force_error:.3g} of the forces and "
        f"{last.length_error:.3g} of the displacement{words}"
    )


def _rounding(loaded: LoadedBody, now: Instant, K: Any, target: Target, step: NewtonStep, left: Imbalance) -> float:
    """Return what is out of balance over the largest force of the path if it is rounding of the internal force, which
    no step brings down, and 0 if it is not.

    A body may form small forces from lengths that nearly cancel, and only it knows how these are rounded. The step is
    then so short that f_int(u + t du) - f_int(u) follows t K du at no fraction t, nor any other line.
    """
    moves = target.largest_tie_value * float(np.max(abs(K.diagonal()), initial=0.0))
    largest = max(left.largest_force, target.largest_load, moves)
    if step.shift or not 0 < left.residual <= UNRESOLVED * largest:
        return 0.0
    predicted, last = K @ step.increment, None
    for part in 0.5 ** np.arange(FRACTIONS):
        try:
            found = np.asarray(loaded.body.internal_force(now.displacement + part * step.increment)) - now.internal
        except InvalidProblem:
            return 0.0
        for line in (part * predicted, last):
            if line is not None and np.linalg.norm(found - line) <= CONTRACTION * np.linalg.norm(line) > 0:
                return 0.0
        last = found / 2
    return left.residual / largest


def _sticks(loaded: LoadedBody, now: Instant, forces: Forces, target: Target, settings: NewtonSettings) -> bool:
    """Say whether contacts with friction keep a body where it is, without slip and within their bounds.

    A step that changes nothing leaves slips of rounding and forces at their bounds, from which no method can tell stick
    from slip.
    """
    if target.anchor is None or loaded.contact is None or loaded.friction is None or forces.friction is None:
        return False
    slip, reach = loaded.contact.slip_since(now.displacement, target.anchor), now.contact.rounding
    bound = loaded.friction * forces.normal * (1 + 1e-12)
    closed = forces.normal > 0
    still = np.all(np.linalg.norm(slip[closed], axis=1) <= reach[closed])
    negligible = settings.tolerance * float(np.max(abs(now.displacement), initial=0.0))
    touches = np.all(abs(now.contact.gap[closed]) <= np.maximum(reach, negligible)[closed])
    return bool(still and touches and np.all(np.linalg.norm(forces.friction, axis=1) <= bound))


def _at_rest(now: Instant, forces: Forces, target: Target) -> Instant | None:
    """Return a body that no force acts on, with its overlaps, which are rounding, taken as 0; None if any force does.

    To close such an overlap would leave internal forces of the size of its rounding, which may drive a mechanism, as a
    cable is, along contacts whose friction is nothing without a force.
    """
    if any(np.any(force) for force in (target.load, now.internal, forces.normal, forces.tie)):
        return None
    return replace(now, contact=replace(now.contact, gap=np.maximum(now.contact.gap, 0.0)))


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
    """Return the imbalance after a step: forces with the rows of its end, and how far gaps and slips are from their
    linear prediction.

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
    """Return the fraction of the step that is taken, the body there, and why it is not the whole step.

    Where the merit falls along no part of the step because all that is out of balance is rounding, it is the whole.
    """
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
                residual = _imbalance_after(loaded, now, new, K, target, settings, step)
                falls = residual.nothing or residual.size <= CONTRACTION * before.size
                if falls or _rounding(loaded, now, K, target, step, before):
                    return fraction, new, reason
            reason = "the energy does not fall"
        fraction /= 2
    if _rounding(loaded, now, K, target, step, before):
        return 1.0, loaded.at(now.displacement + step.increment), ""
    raise NotConverged(f"Newton's method: no part of the step can be taken: {reason or 'the energy is not a number'}")


def _stretched(
    loaded: LoadedBody, now: Instant, target: Target, step: NewtonStep, weight: float, merit: float, new: Instant
) -> tuple[float, Instant]:
    """Lengthen a shifted step, which is too short, most of all off a saddle: double it as long as that is further
    down.
    """
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
    """Return a weight large enough for the step to lead down the merit, also where K has negative energy across the
    constraints (Nocedal and Wright 2006, 18.36).
    """
    du, violation = step.increment, _violation(loaded, now, target)
    rise = -float((target.load - now.internal) @ du) + max(float(du @ (K @ du)), 0.0) / 2
    return max(WEIGHT * step.forces.largest, WEIGHT * rise / violation if violation > 0 else 0.0)


def _violation(loaded: LoadedBody, now: Instant, target: Target) -> float:
    overlap = np.sum(np.maximum(-now.contact.gap, 0.0))
    return float(overlap + np.sum(abs(loaded.tie @ now.displacement - target.tie_value)))


def _merit(loaded: LoadedBody, now: Instant, target: Target, weight: float) -> tuple[float, float]:
    """Return energy - f'u + weight * violation, and how much of it rounding may change."""
    elastic, work = loaded.body.energy(now.displacement), float(target.load @ now.displacement)
    penalty = weight * _violation(loaded, now, target)
    size = abs(elastic) + float(abs(target.load) @ abs(now.displacement)) + penalty
    return elastic - work + penalty, MERIT_ROUNDING * size
