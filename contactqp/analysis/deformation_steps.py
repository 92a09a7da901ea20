"""From a balance that Newton's method found to a solution of the history."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.active_kkt import negative_on, positive_semidefinite
from contactqp.analysis.constrained_newton import Balance
from contactqp.analysis.deformation import LargeSolution
from contactqp.analysis.loaded_body import LoadedBody
from contactqp.analysis.newton_step import Target
from contactqp.solution import Solution


def large_solution(loaded: LoadedBody, balance: Balance, target: Target, load_factor: float) -> LargeSolution:
    """The equilibrium, its displacement in place of the last increment, and whether it is stable."""
    now, step = balance.now, balance.step
    slip, position = None, None
    if loaded.contact is not None:
        position = loaded.contact.positions(now.displacement)
        if target.anchor is not None:
            slip = loaded.contact.slip_since(now.displacement, target.anchor)
    values: dict[str, Any] = {f.name: getattr(step.solution, f.name) for f in fields(Solution)}
    values.update(
        displacement=now.displacement,
        work=replace(step.solution.work, iterations=len(balance.iterations)),
        history=tuple(iteration.error for iteration in balance.iterations),
    )
    return LargeSolution(
        **values,
        load_factor=load_factor,
        load=target.load,
        tie_value=target.tie_value,
        increment=step.increment,
        current_gap=now.contact.gap,
        current_slip=slip,
        position=position,
        elastic=loaded.body.energy(now.displacement),
        negative=negative_motions(loaded, balance),
        iterations=balance.iterations,
    )


def negative_motions(loaded: LoadedBody, balance: Balance) -> int:
    """How many motions that keep ties and pushing contacts as they are lower the energy."""
    K = loaded.hessian(balance.now, balance.forces)
    if positive_semidefinite(K):
        return 0
    pushing = np.flatnonzero(balance.forces.normal > 0)
    return negative_on(K, sp.vstack([balance.now.contact.normal[pushing], loaded.tie], format="csr"))
