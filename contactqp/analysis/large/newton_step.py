"""Compute one step of Newton's method with inequality constraints, a contact problem in the increment (SQP).

The step is the minimum of a convex contact problem if possible; otherwise the tangent is shifted, or the closed set is
found by signs (`active_kkt`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
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
from contactqp.analysis.large.deformation import Forces, Instant, LoadedBody
from contactqp.certificate.number_range import near_one
from contactqp.errors import BackendFailed, NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.linalg.iteration import Systems, systems_of
from contactqp.model.arrays import POLISH, Array, Vector, one_blas_thread, stage
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate, FreeMotion, Solution, Work
from contactqp.solving.methods import find
from contactqp.solving.solve import begin, solve

# The shift of an indefinite tangent relative to its lowest eigenvalue, and of a singular one relative to its largest
# diagonal entry.
BEYOND = 1.2
SINGULAR_SHIFT = 1e-3
# Stiffnesses along ties to be tried, relative to the largest diagonal entry of the tangent.
ALONG_TIES = (1.0, 1e2)
# By condensation the step of least norm is returned along unresisted motions, for instance of a straight cable.
LEAST_STEP = {"condense": True}
# Options with which `solve` runs a method and refines its answer.
REFINED = {"condense", "tolerance", "polish"}


@dataclass(frozen=True, eq=False)
class Target:
    """The loads, tie values and slip origins of an equilibrium."""

    load: Vector  # (n,)
    tie_value: Vector  # (k,) A u
    anchor: Array | None = None  # (m, d) slip origins of the step, with friction
    largest_load: float = 0.0  # the largest force of the whole path
    largest_tie_value: float = 0.0


@dataclass(frozen=True, eq=False)
class NewtonSettings:
    """Options of the solution of steps, and stopping criteria."""

    method: str = "active-set"
    exact: bool = True  # whether the method enforces contact exactly
    options: dict[str, Any] = field(default_factory=dict)
    tolerance: float = 1e-12
    max_iter: int = 50


@dataclass(frozen=True, eq=False)
class Found:
    """The data of a method's answer to a step for the start of the next step and for the final solution."""

    start: Candidate
    free_motions: tuple[FreeMotion, ...]
    method: str
    work: Work
    solution: Solution | None = None  # if the answer was certified


@dataclass(frozen=True, eq=False)
class NewtonStep:
    """An increment with its forces and its problem."""

    problem: ContactProblem  # in the increment
    increment: Vector  # (n,) du
    forces: Forces
    shift: float = 0.0  # added to a tangent without a descent direction [force / length]
    springs: float = 0.0  # added to an indefinite tangent in `problem`, with springs relaxed at du [force / length]
    found: Found | None = None  # if it was found by a method of `solve`


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

    If K is indefinite only on motions that violate ties, additional stiffness along ties makes the problem convex
    without changing its solution. If K is indefinite but has positive energy on the motions with closed contacts, this
    is a local minimum, whose closed set is found by signs. Otherwise no step leads to a minimum, and K + shift 1 is
    used, which gives a descent direction and does not change equilibria; `shift` is stored in the step.

    Raises Unsupported: an indefinite tangent and a method that is convex, or friction in space; NotConverged: the step
    has no answer.

    Parameters
    ----------
    loaded : the body with its contacts and ties
    now : the body at the displacement of the iteration
    K : (n, n) matrix, its tangent, with the curvature of the contacts
    target : loads, tie values and slip origins
    settings : method, options and tolerance
    before : NewtonStep or None, the previous step, whose solution is the start
    forces : the forces of the iteration
    """
    stiff, load = K, target.load
    if not positive_semidefinite(K):
        along = _stiffness_along_ties(loaded, K)
        if along is None:
            return _indefinite(loaded, now, K, target, settings, forces)
        # Springs along ties, relaxed at A u = b, change neither the answer nor its forces.
        stiff = sp.csc_array(K + along * (loaded.tie.T @ loaded.tie))
        load = load + along * (loaded.tie.T @ (target.tie_value - loaded.tie @ now.displacement))
    problem = loaded.step_problem(now, stiff, load, target.tie_value, slipped(loaded, now, target))
    try:
        return _solved(problem, now, settings, before)
    except NoEquilibrium as error:
        if settings.method != "active-set" or problem.frictional:
            raise NotConverged(f"a step of Newton's method has no answer: {error}") from error
    # A mechanism without stiffness driven by its load, which gains stiffness as it moves.
    return _shifted(loaded, now, K, target, settings, SINGULAR_SHIFT * float(np.max(abs(K.diagonal()))))


def _stiffness_along_ties(loaded: LoadedBody, K: Any) -> float | None:
    """Return c such that K + c A'A is positive semidefinite, None if there is none."""
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
    """Return a problem in the increment as one in the displacement: K u = r + K u_0, E u <= g + E u_0 and so on.

    Near convergence increments are of rounding size, and lengths and forces must be measured relative to the whole.
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
    """Solve by a method of `solve`; an answer refused by its certificate is judged again at the end, in the
    displacement.

    Without friction the unknown is the increment, so that unresisted motions do not change. With friction it is the
    displacement, whose size determines the rounding of slips.
    """
    known = None if before is None or not settings.exact else before.found
    if (refined := _refined(problem, settings, None if known is None else known.start)) is not None:
        return refined
    asked = in_displacement(problem, now.displacement) if problem.frictional else problem
    start = None if known is None else known.solution
    try:
        solution = solve(asked, settings.method, warm_start=start, **(LEAST_STEP | settings.options))
    except NotCertified as error:
        if not isinstance(error.solution, Solution):
            raise
        solution = error.solution
    du = solution.displacement - now.displacement if problem.frictional else solution.displacement
    forces = Forces(solution.normal_force, solution.tie_force, solution.friction_force if problem.frictional else None)
    candidate = Candidate(replace(solution.answer, friction_force=None))
    found = Found(candidate, solution.free_motions, solution.method, solution.work, solution)
    return NewtonStep(problem, du, forces, found=found)


def _refined(problem: ContactProblem, settings: NewtonSettings, start: Candidate | None) -> NewtonStep | None:
    """Return the answer of a method without friction, refined on its set of closed contacts, if its signs agree.

    It is not certified, as the converged step will be. None if `solve` would do more than that.
    """
    options = LEAST_STEP | settings.options
    plain = settings.exact and find(settings.method).polish and set(options) <= REFINED and options.get("polish", True)
    if problem.frictional or not plain or problem.has_idle_rows or near_one(problem) is not None:
        return None
    if systems_of(problem) is not Systems.CONDENSED:
        return None
    try:
        run = begin(problem, settings.method, start, **options)
    except (NotConverged, BackendFailed):
        return None
    with problem._lock, one_blas_thread(problem), stage(POLISH), run.meter.running():
        final = run.final()
    if not final.polished:
        return None
    answer = final.answer
    forces = Forces(answer.normal_force, answer.tie_force, None)
    found = Found(Candidate(answer), final.free_motions, run.name, run.work(final.corrections))
    return NewtonStep(problem, answer.displacement, forces, found=found)


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
        # The energy may still rise until open contacts close.
        inside = np.all(contact.gap >= -contact.rounding) and not np.any(value)
        if not negative_on(K, rows) and (not inside or r @ du >= -float(contact.rounding @ normal)):
            return stationary_step(loaded, now, K, target, du, Forces(normal, tie))
    return _shifted(loaded, now, K, target, settings, BEYOND * -min(lowest_eigenvalue(K), 0.0))


def _indefinite_with_friction(loaded: LoadedBody, now: Instant, K: Any, target: Target, forces: Forces) -> NewtonStep:
    """Return the step with stick and slip found by signs; stability cannot be determined with friction."""
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
    return NewtonStep(problem, step.increment, step.forces, shift=shift, found=step.found)


def stationary_step(
    loaded: LoadedBody, now: Instant, K: Any, target: Target, du: Vector, forces: Forces, grazing: int | None = None
) -> NewtonStep:
    """Return an increment and forces in equilibrium, for any K, as the solution of a contact problem.

    If K is indefinite, springs relaxed at the increment are added, K + s 1 with the load r + s du, with the same
    equilibrium and signs but no information on stability. The gap of a grazing contact, with neither gap nor force, is
    increased by its rounding, as it would have a force otherwise.

    Parameters
    ----------
    loaded, now, K, target, forces
        As for `newton_step`.
    du : (n,) array, the increment
    grazing : a contact with no force at gap 0
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
