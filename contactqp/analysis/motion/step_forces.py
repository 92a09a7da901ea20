"""Contact forces of one time step without friction, from the Delassus operator of the step.

    gap = c + W l >= 0,  l >= 0,  l gap = 0:        min 1/2 l'Wl + c'l over l >= 0

c (m,) is the gap without contact forces. The active set of the step before is where the search starts; any other
method is given the same minimum as a problem of its own, whose multipliers are the gaps.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import NoEquilibrium, NotCertified, NotConverged
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.solving.solve import solve

# Changes of the active set; it settles in two or three, and what cycles is left to a method that cannot.
MAX_CHANGES = 30
# Forces and gaps of this part of the largest are rounding.
ROUNDING = 1e-13
# Compliance, as part of its own, that is given to contacts whose forces nothing else bounds.
SQUEEZED = 1e-13


def normal_forces(W: Array, c: Vector, start: NDArray[np.bool_], method: str, options: dict[str, Any]) -> Vector:
    """l (m,) [force] of frictionless contacts, started from a guess of those that push."""
    if method == "active-set" and not options:
        found = _by_active_set(W, c, start)
        if found is not None:
            return found
    dual = ContactProblem(stiffness=W, load=-c, normal=-np.eye(len(c)), gap=np.zeros(len(c)))
    try:
        return np.maximum(solve(dual, method, **options).displacement, 0.0)
    except (NoEquilibrium, NotCertified, NotConverged) as error:
        # Contacts that squeeze a body between them: a rounding of c decides whether the forces are bounded.
        found = _by_active_set(W + np.diag(SQUEEZED * W.diagonal()), c, start)
        if found is not None:
            return found
        if isinstance(error, NoEquilibrium):
            raise NotConverged(f"the contacts of the step leave no room: {error}") from error
        raise


def _by_active_set(W: Array, c: Vector, start: NDArray[np.bool_]) -> Vector | None:
    """The primal-dual active set (Hintermueller, Ito and Kunisch 2003); None where it cycles or W is singular."""
    pushes = start | (c < 0)
    force = np.zeros(len(c))
    for _ in range(MAX_CHANGES):
        force[:] = 0.0
        if len(c) == 1:
            if pushes[0]:
                force[0] = -c[0] / W[0, 0] if W[0, 0] > 0 else np.nan
        elif np.any(pushes):
            try:
                factor = np.linalg.cholesky(W[np.ix_(pushes, pushes)])
            except np.linalg.LinAlgError:
                return None
            force[pushes] = np.linalg.solve(factor.T, np.linalg.solve(factor, -c[pushes]))
        if not np.all(np.isfinite(force)):
            return None
        gap = c + W @ force
        size = abs(c) + abs(W) @ abs(force)
        wrong_force = pushes & (force < 0)
        wrong_gap = ~pushes & (gap < -ROUNDING * size)
        if not np.any(wrong_force) and not np.any(wrong_gap):
            return force
        pushes = (pushes & ~wrong_force) | wrong_gap
    return None
