"""Coulomb's law as a fixed point of convex problems, in the forces of a local problem.

Acary, Cadoux, Lemarechal and Malick (2011): r = argmin over the cones, normal velocities shifted by s = mu |u_T| of the
step before. The first step, s = 0, is the associated relaxation, and each subproblem has a solution where
`existence` says so. Tresca (Haslinger): r = argmin over discs of radius mu r_N of the step before.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb_cone import lengths, onto_discs
from contactqp.solving.friction.aitken import RELAXATION, aitken
from contactqp.solving.friction.convex_steps import ConvexSteps
from contactqp.solving.friction.iterate import Iterate
from contactqp.solving.friction.local_form import LocalForm


def cone_fixed_point(form: LocalForm, steps: ConvexSteps, start: Iterate) -> Iterator[Iterate]:
    """Iterates, one a convex problem, without end."""
    shift = _shift(form, start) if np.any(start.force) else np.zeros(form.m)
    count = 0
    while True:
        r, joint = steps.over_cones(shift)
        count += 1
        found = Iterate.at(form, r, joint, count)
        yield found
        shift = _shift(form, found)


def tresca_fixed_point(form: LocalForm, steps: ConvexSteps, start: Iterate) -> Iterator[Iterate]:
    """Iterates, one a convex problem, without end."""
    bound = form.mu * np.maximum(start.force[:, 0], 0.0)
    relaxation, count = RELAXATION[1], 0
    before: Vector | None = None
    while True:
        r, joint = steps.over_discs(bound)
        count += 1
        yield Iterate.at(form, _in_cone(r, form.mu), joint, count)
        missing = form.mu * np.maximum(r[:, 0], 0.0) - bound
        relaxation = aitken(relaxation, before, missing)
        bound, before = np.maximum(bound + relaxation * missing, 0.0), missing


def _shift(form: LocalForm, iterate: Iterate) -> Vector:
    velocity = form.velocity(iterate.force, iterate.joint_force)
    return np.asarray(form.mu * lengths(velocity[:, 1:]))


def _in_cone(r: Array, mu: Vector) -> Array:
    """Forces whose friction is cut off at their own bound."""
    normal = np.maximum(r[:, 0], 0.0)
    return np.column_stack([normal, onto_discs(r[:, 1:], mu * normal)])
