"""How long a contact lasts: half a period of the slowest vibration that an impact excites.

A rod of length L that hits a wall stays for 2 L / c, half the period of its slowest vibration with the touching end
held. On matrices: omega the lowest frequency with the closed contacts held that is not zero and that the velocities at
the impact excite, time pi / omega. It comes from Lanczos' method on the operator of a time step, which is factorised
already; only frequencies that a step is too long to resolve need be found, and these are far apart there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.analysis.motion.schemes.scheme import State
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem

# Enough to part the slowest vibration from others where the step is long.
LANCZOS_STEPS = 24
# Frequencies whose share of a step's operator is this near to one are rigid motions, or well resolved.
RESOLVED = 1e-9
# Shares below this are the rounding of motions that contacts hold: a step would last for a million contacts.
HELD = 1e-13
# A vector that this part is left of lies in the space that was spanned before.
SPANNED = 1e-12


def slowest_frequency(respond: Callable[[Vector], Vector], mass: Any, inertia: float, velocity: Vector) -> float | None:
    """omega [1 / time], or None where all motions are rigid.

    Parameters
    ----------
    respond : function
        x = (M s + K)^-1 y with the closed contacts held, s = `inertia`: its frequencies are those of s / (s + omega^2)
        as the eigenvalues of x = respond(s M x).
    mass : (n, n) matrix
    inertia : float
        s [1 / time^2].
    velocity : (n,) array
        What the impact excites: vibrations that have no part in it are not found.
    """
    basis: list[Vector] = []
    images: list[Vector] = []
    vector = respond(inertia * (mass @ velocity))
    for _ in range(LANCZOS_STEPS):
        for other in 2 * basis:
            vector = vector - (other @ (mass @ vector)) * other
        size = np.sqrt(max(float(vector @ (mass @ vector)), 0.0))
        reference = np.sqrt(float(images[-1] @ (mass @ images[-1]))) if images else size
        if not np.isfinite(size) or size <= SPANNED * reference or size == 0:
            break
        basis.append(vector / size)
        images.append(respond(inertia * (mass @ basis[-1])))
        vector = images[-1]
    if not basis:
        return None
    operator = np.array([[a @ (mass @ b) for b in images] for a in basis])
    shares = np.linalg.eigvalsh((operator + operator.T) / 2)
    slow = shares[(shares > HELD) & (shares < 1 - RESOLVED)]
    return float(np.sqrt(inertia * (1 / slow[-1] - 1))) if len(slow) else None


class ImpactsMinded:
    """Which contacts have closed by an impact so far: each is looked at when it does so first."""

    def __init__(self, problem: ContactProblem) -> None:
        self._normal, self._met = problem.normal, np.zeros(problem.contacts, dtype=bool)
        self.unminded = problem.contacts > 0

    def new(self, before: State, now: State) -> NDArray[np.intp]:
        """Contacts that begin to push in a step, approaching, for the first time."""
        closing = np.flatnonzero((now.normal_force > 0) & (before.normal_force <= 0) & ~self._met)
        if len(closing):
            closing = closing[self._normal[closing] @ before.velocity > 0]
            self._met[closing] = True
            self.unminded = not bool(np.all(self._met))
        return closing


def meeting(problem: ContactProblem, mass: Any, contacts: NDArray[np.intp]) -> NDArray[np.bool_]:
    """(n,) the unknowns of the bodies that contacts act on; ties make one body of two. Others are bystanders."""
    from scipy.sparse.csgraph import connected_components

    tied = abs(problem.tie).T @ abs(problem.tie)
    rows = abs(problem.normal[contacts])
    label = connected_components(abs(problem.stiffness_rows) + abs(mass) + tied, directed=False)[1]
    return np.isin(label, label[sp.csr_matrix(rows).indices])
