"""Newton's method with inequality constraints, globalised by the energy: one contact problem an iteration (SQP).

The step is the minimum of a convex contact problem where the tangent allows that; elsewhere the tangent is shifted, or
the closed set is found by signs (`active_kkt`).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.large.active_kkt import (
    by_signs,
    coulomb_by_signs,
    lowest_eigenvalue,
    negative_on,
    positive_semidefinite,
)
from contactqp.analysis.large.deformation import Forces, Imbalance, Instant, LoadedBody, NewtonIteration
from contactqp.errors import InvalidProblem, NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.solving.solve import solve

# How far beyond its lowest eigenvalue an indefinite tangent is shifted, and a singular one, of its largest diagonal.
BEYOND = 1.2
SINGULAR_SHIFT = 1e-3
# Stiffnesses along ties that are tried, over the largest diagonal of the tangent.
ALONG_TIES = (1.0, 1e2)
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
# Condensed, the step that is returned is the least where nothing holds: where a cable hangs straight, say.
LEAST_STEP = {"condense": True}


@dataclass(frozen=True, eq=False)
class Target:
    """The loads, tie values and slip origins that are to be brought into balance."""

    load: Vector  # (n,)
    tie_value: Vector  # (k,) A u
    anchor: Array | None = None  # (m, d) where the slips of the step are counted from, with friction


@dataclass(frozen=True, eq=False)
class NewtonSettings:
    """How the steps are solved, and when they end."""

    method: str = "active-set"
    exact: bool = True  # whether the method enforces contact, not approximates it
    options: dict[str, Any] = field(default_factory=dict)
    tolerance: float = 1e-12
    max_iter: int = 50


@dataclass(frozen=True, eq=False)
class NewtonStep:
    """An increment, with the forces after it and the problem that both solve."""

    problem: ContactProblem  # in the increment
    increment: Vector  # (n,) du
    forces: Forces
    shift: float = 0.0  # that a tangent without a way down was given [force / length]
    springs: float = 0.0  # that an indefinite tangent was given in `problem`, relaxed at du [force / length]
    solution: Solution | None = None  # where a method of `solve` found it


def newton_step(
    loaded: LoadedBody,
    now: Instant,
    K: Any,
    target: Target,
    settings: NewtonSettings,
    before: NewtonStep | None,
    forces: Forces,
) -> NewtonStep:
    """Return the minimum of 1/2 du'K du - r'du over E_N du <= gap and A du = b - A u, with friction if there is any.

    Where K is indefinite across the ties alone, stiffness along them makes the problem convex and is no other problem.
    Where K is indefinite but has positive energy on the motions that keep the closed contacts closed, that is a local
    minimum: its closed set is found by signs. Where it has not, no step leads to a minimum; K is then shifted,
    K + shift 1, which leads down and leaves every equilibrium where it is. The step says so.

    Parameters
    ----------
    loaded : LoadedBody
        The body with its contacts and ties.
    now : Instant
        The body at the displacement of the iteration.
    K : (n, n) matrix
        Its tangent, with the curvature of the contacts.
    target : Target
        Loads, tie values and slip origins.
    settings : NewtonSettings
        Method, options and tolerance.
    before : NewtonStep or None
        The step before, whose solution starts this one.
    forces : Forces
        The forces of the iteration.

    Raises
    ------
    Unsupported
        An indefinite tangent and a method that is convex, or friction in space.
    NotConverged
        The step has no answer.
    """
    stiff, load = K, target.load
    if not positive_semidefinite(K):
        along = _stiffness_along_ties(loaded, K)
        if along is None:
            return _indefinite(loaded, now, K, target, settings, forces)
        # A u = b is known: springs along the ties that are relaxed there change neither the answer nor its forces.
        stiff = sp.csc_array(K + along * (loaded.tie.T @ loaded.tie))
        load = load + along * (loaded.tie.T @ (target.tie_value - loaded.tie @ now.displacement))
    problem = loaded.step_problem(now, stiff, load, target.tie_value, slipped(loaded, now, target))
    try:
        return _solved(problem, now, settings, before)
    except NoEquilibrium as error:
        if settings.method != "active-set" or problem.frictional:
            raise NotConverged(f"a step of Newton's method has no answer: {error}") from error
    # A mechanism without stiffness, which its load drives: it gains stiffness as it moves.
    return _shifted(loaded, now, K, target, settings, SINGULAR_SHIFT * float(np.max(abs(K.diagonal()))))


def _stiffness_along_ties(loaded: LoadedBody, K: Any) -> float | None:
    """Return c so that K + c A'A is positive semidefinite, or None if no stiffness along the ties achieves that."""
    square = sp.csc_array(loaded.tie.T @ loaded.tie)
    if not square.nnz:
        return None
    unit = float(np.max(abs(K.diagonal())) / np.max(square.diagonal()))
    for size in ALONG_TIES:
        if positive_semidefinite(sp.csc_array(K + size * unit * square)):
            return size * unit
    return None


def slipped(loaded: LoadedBody, now: Instant, target: Target) -> Array | None:
    """Return the slip of the load step so far, (m, d-1) [length], or None without friction."""
    if loaded.contact is None or target.anchor is None:
        return None
    return loaded.contact.slip_since(now.displacement, target.anchor)


def in_displacement(problem: ContactProblem, displacement: Vector) -> ContactProblem:
    """Restate a problem in the increment as one in the displacement: K u = r + K u_0, E u <= g + E u_0 and so on.

    At the end of Newton's method increments are rounding; lengths and forces are to be measured against the whole.
    """
    changes: dict[str, Any] = {}
    if problem.tangent is not None and problem.slip_origin is not None:
        moved = np.asarray(problem.tangent @ displacement).reshape(problem.slip_origin.shape)
        changes["slip_origin"] = problem.slip_origin + moved
    return problem.replace(
        load=problem.load + problem.stiffness @ displacement,
        gap=problem.gap + problem.normal @ displacement,
        tie_value=problem.tie_value + problem.tie @ displacement,
        **changes,
    )


def _solved(problem: ContactProblem, now: Instant, settings: NewtonSettings, before: NewtonStep | None) -> NewtonStep:
    """Solve by a method of `solve`; an answer that its certificate refuses is judged again at the end, in the
    displacement.

    Without friction the unknown is the increment: what nothing holds stays where it is. With friction it is the
    displacement, against whose size a slip is told from rounding.
    """
    start = None if before is None or not settings.exact else before.solution
    asked = in_displacement(problem, now.displacement) if problem.frictional else problem
    try:
        found = solve(asked, settings.method, warm_start=start, **(LEAST_STEP | settings.options))
    except NotCertified as error:
        if not isinstance(error.solution, Solution):
            raise
        found = error.solution
    du = found.displacement - now.displacement if problem.frictional else found.displacement
    friction = found.friction_force if problem.frictional else None
    return NewtonStep(problem, du, Forces(found.normal_force, found.tie_force, friction), solution=found)


def _indefinite(
    loaded: LoadedBody, now: Instant, K: Any, target: Target, settings: NewtonSettings, forces: Forces
) -> NewtonStep:
    if settings.method != "active-set":
        raise Unsupported(
            f"{settings.method}: the tangent is indefinite (lowest eigenvalue {lowest_eigenvalue(K):.3g}) and the "
            "method is convex; expected method='active-set'"
        )
    if target.anchor is not None and loaded.contacts:
        return _indefinite_with_friction(loaded, now, K, target, forces)
    contact = now.contact
    value = target.tie_value - loaded.tie @ now.displacement
    try:
        r, closed = target.load - now.internal, forces.normal > 0
        du, normal, tie, closed = by_signs(K, r, contact.normal, contact.gap, loaded.tie, value, closed)
    except NotConverged:
        pass
    else:
        rows = sp.vstack([contact.normal[np.flatnonzero(closed)], loaded.tie], format="csr")
        # On the way to contacts that were open the energy may rise all the same.
        inside = np.all(contact.gap >= -contact.rounding) and not np.any(value)
        if not negative_on(K, rows) and (not inside or r @ du >= -float(contact.rounding @ normal)):
            return stationary_step(loaded, now, K, target, du, Forces(normal, tie))
    return _shifted(loaded, now, K, target, settings, BEYOND * -min(lowest_eigenvalue(K), 0.0))


def _indefinite_with_friction(loaded: LoadedBody, now: Instant, K: Any, target: Target, forces: Forces) -> NewtonStep:
    """Find the states of stick and slip by signs; friction has no energy that could tell whether the answer is
    stable.
    """
    step = stationary_step(loaded, now, K, target, np.zeros(loaded.dimension), forces)
    origin = step.problem.slip_origin
    if origin is not None and origin.shape[1] != 1:
        raise Unsupported(
            f"friction with {origin.shape[1]} tangents a contact where the tangent stiffness is indefinite (lowest "
            f"eigenvalue {lowest_eigenvalue(K):.3g}): states are found by signs in the plane alone"
        )
    du, found = coulomb_by_signs(K, step.problem, target.load - now.internal, forces)
    return stationary_step(loaded, now, K, target, du, found)


def _shifted(
    loaded: LoadedBody, now: Instant, K: Any, target: Target, settings: NewtonSettings, shift: float
) -> NewtonStep:
    stiff = sp.csc_array(K + shift * sp.identity(K.shape[0]))
    problem = loaded.step_problem(now, stiff, target.load, target.tie_value)
    try:
        step = _solved(problem, now, settings, None)
    except NoEquilibrium as error:
        raise NotConverged(f"a step of Newton's method has no answer: {error}") from error
    return NewtonStep(problem, step.increment, step.forces, shift=shift, solution=step.solution)


def stationary_step(
    loaded: LoadedBody, now: Instant, K: Any, target: Target, du: Vector, forces: Forces, grazing: int | None = None
) -> NewtonStep:
    """Return an increment and forces that balance, K semidefinite or not, as the solution of a contact problem.

    Where K is not, the problem is that of the body on springs that are relaxed at the increment, K + s 1 with the load
    r + s du: it has the same balance and the same signs, and says nothing about stability. A contact that grazes, with
    no force at gap 0, has a gap that is wider by its rounding: on the other side of zero it would have a force.

    Parameters
    ----------
    loaded, now, K, target, forces
        As for `newton_step`.
    du : (n,) array
        The increment.
    grazing : int, optional
        A contact with no force at gap 0.
    """
    springs = 0.0 if positive_semidefinite(K) else BEYOND * -lowest_eigenvalue(K)
    stiff = sp.csc_array(K + springs * sp.identity(K.shape[0])) if springs else K
    load = target.load + springs * du
    problem = loaded.step_problem(now, stiff, load, target.tie_value, slipped(loaded, now, target))
    if grazing is not None:
        gap = problem.gap.copy()
        gap[grazing] += now.contact.rounding[grazing]
        problem = problem.replace(gap=gap)
    return NewtonStep(problem, du, forces, springs=springs)


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
        """Say whether the iterations met tangents without a descent direction."""
        return any(iteration.shift for iteration in self.iterations)


@np.errstate(over="ignore", invalid="ignore")  # what is no number is stepped back from, or said
def find_balance(
    loaded: LoadedBody, start: Vector, forces: Forces, target: Target, settings: NewtonSettings
) -> Balance:
    """Find the equilibrium under a load that lies down the energy from a start, by one contact problem an iteration.

    The merit is energy - f'u + w (sum of overlaps + sum of |A u - b|), w above the largest force; steps are halved
    until it falls. Approximate methods and friction have no such merit and take full steps.

    Parameters
    ----------
    loaded : LoadedBody
        The body with its contacts and ties.
    start : (n,) array
        The displacement from which the iterations start.
    forces : Forces
        The forces there.
    target : Target
        Loads, tie values and slip origins.
    settings : NewtonSettings
        Method, options and tolerance.

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
        residual = _imbalance_after(loaded, now, new, K, target, settings, step)
        changed = not np.array_equal(forces.normal > 0, step.forces.normal > 0)
        iterations.append(NewtonIteration(residual.force, residual.length, fraction, step.shift, changed))
        if residual.nothing and fraction == 1:
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
    """Return the fraction of the step that is taken, the body there, and why it is not the whole step."""
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
                if residual.nothing or residual.size <= CONTRACTION * before.size:
                    return fraction, new, reason
            reason = "the energy does not fall"
        fraction /= 2
    raise NotConverged(f"Newton's method: no part of the step can be taken: {reason or 'the energy is no number'}")


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
