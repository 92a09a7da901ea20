"""From a balance that Newton's method found to a certified solution of the history."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.large.active_kkt import negative_on, positive_semidefinite
from contactqp.analysis.large.constrained_newton import Balance
from contactqp.analysis.large.deformation import LargeSolution
from contactqp.analysis.large.loaded_body import LoadedBody
from contactqp.analysis.large.newton_step import NewtonSettings, Target, in_displacement, slipped
from contactqp.certificate.certificate import compute_certificate, contact_status
from contactqp.errors import NotCertified
from contactqp.model.solution import Work

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
