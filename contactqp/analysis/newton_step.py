"""One Newton step of a body in contact: a convex contact problem where the tangent allows, and what to do where not."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.active_kkt import by_signs, lowest_eigenvalue, negative_on, positive_semidefinite
from contactqp.analysis.loaded_body import Array, Forces, Instant, LoadedBody
from contactqp.certificate import certify, contact_status
from contactqp.elements.deformable import Vector
from contactqp.errors import NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.problem import ContactProblem
from contactqp.solution import Solution, Work
from contactqp.solving import solve

# How far beyond its lowest eigenvalue an indefinite tangent is shifted, and a singular one, of its largest diagonal.
BEYOND = 1.5
SINGULAR_SHIFT = 1e-3


@dataclass(frozen=True, eq=False)
class Target:
    """What is to be brought into balance."""

    load: Vector  # (n,)
    tie_value: Vector  # (k,) A u
    anchor: Array | None = None  # (m, d) where the slips of the step are counted from, with friction


@dataclass(frozen=True, eq=False)
class NewtonSettings:
    """How the steps are solved and when they end."""

    method: str = "active-set"
    exact: bool = True  # whether the method enforces contact, not approximates it
    options: dict[str, Any] = field(default_factory=dict)
    tolerance: float = 1e-12
    max_iter: int = 50


@dataclass(frozen=True, eq=False)
class NewtonStep:
    """An increment, with the forces after it and the problem that it solves."""

    solution: Solution  # of the step's problem, in the increment
    forces: Forces
    shift: float  # that a tangent without a way down was given [force / length]
    refused: NotCertified | None = None  # where the certificate refuses it

    @property
    def increment(self) -> Vector:
        """du."""
        return self.solution.displacement


def newton_step(
    loaded: LoadedBody,
    now: Instant,
    K: Any,
    target: Target,
    settings: NewtonSettings,
    before: NewtonStep | None,
    forces: Forces,
) -> NewtonStep:
    """The minimum of 1/2 du'K du - r'du over E_N du <= gap and A du = b - A u, with friction if there is any.

    Where K is indefinite but has positive energy on the motions that keep the closed contacts closed, that is a local
    minimum: its closed set is found by signs. Where it has not, no step leads to a minimum; K is then shifted,
    K + shift 1, which leads down and leaves every equilibrium where it is. The step says so.

    Raises
    ------
    Unsupported
        An indefinite tangent and a method that is convex, or friction.
    NotConverged
        The step has no answer.
    """
    if not positive_semidefinite(K):
        return _indefinite(loaded, now, K, target, settings, forces)
    slipped = None if target.anchor is None or loaded.contact is None else _slipped(loaded, now, target)
    problem = loaded.step_problem(now, K, target.load, target.tie_value, slipped)
    try:
        return _solved(problem, settings, before)
    except NoEquilibrium as error:
        if settings.method != "active-set" or problem.frictional:
            raise NotConverged(f"a step of Newton's method has no answer: {error}") from error
    # A mechanism without stiffness, which its load drives: it gains stiffness as it moves.
    shift = SINGULAR_SHIFT * float(np.max(abs(K.diagonal())))
    return _shifted(loaded, now, K, target, settings, shift)


def _slipped(loaded: LoadedBody, now: Instant, target: Target) -> Array:
    if loaded.contact is None or target.anchor is None:
        raise ValueError("slips of a body without contacts")
    return loaded.contact.slip_since(now.displacement, target.anchor)


def _solved(problem: ContactProblem, settings: NewtonSettings, before: NewtonStep | None) -> NewtonStep:
    start = None if before is None or not settings.exact else before.solution
    refused = None
    try:
        found = solve(problem, settings.method, warm_start=start, **settings.options)
    except NotCertified as error:
        if not isinstance(error.solution, Solution):
            raise
        found, refused = error.solution, error
    friction = found.friction_force if problem.frictional else None
    return NewtonStep(found, Forces(found.normal_force, found.tie_force, friction), 0.0, refused)


def _indefinite(
    loaded: LoadedBody, now: Instant, K: Any, target: Target, settings: NewtonSettings, forces: Forces
) -> NewtonStep:
    if settings.method != "active-set":
        raise Unsupported(
            f"{settings.method}: the tangent is indefinite (lowest eigenvalue {lowest_eigenvalue(K):.3g}) and the "
            "method is convex; expected method='active-set'"
        )
    if target.anchor is not None:
        raise Unsupported(
            f"friction where the tangent is indefinite (lowest eigenvalue {lowest_eigenvalue(K):.3g}): Coulomb's law "
            "is solved for convex bodies alone"
        )
    contact = now.contact
    value = target.tie_value - loaded.tie @ now.displacement
    closed = forces.normal > 0
    try:
        r = target.load - now.internal
        du, normal, tie, closed = by_signs(K, r, contact.normal, contact.gap, loaded.tie, value, closed)
    except NotConverged:
        pass
    else:
        if not negative_on(K, sp.vstack([contact.normal[np.flatnonzero(closed)], loaded.tie], format="csr")):
            return stationary_step(loaded, now, K, target, du, Forces(normal, tie))
    return _shifted(loaded, now, K, target, settings, BEYOND * -min(lowest_eigenvalue(K), 0.0))


def _shifted(
    loaded: LoadedBody, now: Instant, K: Any, target: Target, settings: NewtonSettings, shift: float
) -> NewtonStep:
    stiff = sp.csc_array(K + shift * sp.eye_array(K.shape[0]))
    problem = loaded.step_problem(now, stiff, target.load, target.tie_value)
    try:
        step = _solved(problem, settings, None)
    except NoEquilibrium as error:
        raise NotConverged(f"a step of Newton's method has no answer: {error}") from error
    return NewtonStep(step.solution, step.forces, shift, step.refused)


def stationary_step(loaded: LoadedBody, now: Instant, K: Any, target: Target, du: Vector, forces: Forces) -> NewtonStep:
    """An increment and forces that balance, K semidefinite or not, as the solution of a contact problem.

    Where K is not, the problem is that of the body on springs that are relaxed at the increment, K + s 1 with the load
    r + s du: it has the same balance and the same signs, and says nothing about stability; its certificate notes that.
    """
    shift = 0.0 if positive_semidefinite(K) else BEYOND * -lowest_eigenvalue(K)
    stiff = sp.csc_array(K + shift * sp.eye_array(K.shape[0])) if shift else K
    problem = loaded.step_problem(now, stiff, target.load + shift * du, target.tie_value)
    certificate = certify(problem, du, forces.normal, tie_force=forces.tie)
    if shift:
        note = (
            f"the tangent is indefinite: certified on springs of {shift:.3g} that are relaxed at the answer; balance "
            "and contact are those of the body, its stability is not asked"
        )
        certificate = replace(certificate, notes=(*certificate.notes, note))
    solution = Solution(
        problem=problem,
        displacement=du,
        normal_force=forces.normal,
        friction_force=None,
        tie_force=forces.tie,
        contact_status=contact_status(problem, certificate),
        free_motions=(),
        certificate=certificate,
        method="active-set",
        seconds=0.0,
        certify_seconds=0.0,
        work=Work(iterations=1),
    )
    failures = "; ".join(certificate.failures)
    refused = None if certificate.passed else NotCertified(f"the certificate refuses the step: {failures}", solution)
    return NewtonStep(solution, forces, 0.0, refused)
