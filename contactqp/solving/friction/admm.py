"""ADMM on the local form, De Saxce's shift taken from the dual (Carpentier, Montaut, Le Lidec 2024).

    r  = -(W + rho I)^-1 (q + s e_N - rho (z - y))     the bodies
    z  = P_K(r + y)                                    the cones
    y := y + r - z,    u = -rho y,    s = mu |u_T|

In exact arithmetic a fixed point has r = z and W r + q + s e_N = u + s e_N in K*, orthogonal to r: Coulomb's law. Only
for a fixed shift does theory promise convergence. The penalty rho follows the two residuals r - z and rho (z - z_old).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.coulomb_law import onto_cone
from contactqp.errors import NotConverged
from contactqp.linalg.measures import lengths
from contactqp.solving.friction.local_form import JOINT_REGULARISATION, BlockSystem, Iterate, LocalForm

# The residuals are compared after so many iterations, the penalty changes when they differ by this factor.
EVERY, UNBALANCED = 20, 5.0
# The most changes of the penalty, after which it is fixed so that theory promises convergence.
MOST_CHANGES = 40
# Iterates with larger scaled forces have diverged.
HOPELESS = 1e100
# Over-relaxation.
RELAXATION = 1.6


def admm(form: LocalForm, start: Iterate) -> Iterator[Iterate]:
    """Yield an iterate every few iterations, without end; its error says how far it is from a solution."""
    rho = _first_penalty(form)
    system = _factorised(form, rho)
    z, joint = start.force, start.joint_force
    y = -form.velocity(z, joint) / rho
    iterations = changes = 0
    while True:
        with np.errstate(over="ignore", invalid="ignore"):  # overflow is refused below
            for _ in range(EVERY):
                shift = form.q.reshape(form.m, form.d).copy()
                shift[:, 0] += form.mu * rho * lengths(y[:, 1:])
                held = JOINT_REGULARISATION * form.joint_signs * joint
                r, joint = system.solve((rho * (z - y) - shift).ravel(), held - form.s)
                relaxed = RELAXATION * r.reshape(form.m, form.d) + (1 - RELAXATION) * z
                before, z = z, onto_cone(relaxed + y, form.mu)
                y = y + relaxed - z
                iterations += 1
        if not np.max(abs(z), initial=0.0) < HOPELESS:
            raise NotConverged(f"admm: the forces have overflowed after {iterations} iterations")
        yield Iterate.at(form, z, joint, iterations)
        primal = float(np.linalg.norm(r.reshape(form.m, form.d) - z)) / max(float(np.linalg.norm(z)), 1e-300)
        dual = rho * float(np.linalg.norm(z - before))
        dual /= max(rho * float(np.linalg.norm(y)), 1e-300)
        if changes < MOST_CHANGES and max(primal, dual) > 0:
            ratio = primal / max(dual, 1e-300)
            if not 1 / UNBALANCED < ratio < UNBALANCED:
                factor = float(np.clip(np.sqrt(ratio), 0.1, 10.0))
                rho, y, changes = rho * factor, y / factor, changes + 1
                system = _factorised(form, rho)


def _first_penalty(form: LocalForm) -> float:
    """Return a first penalty, 0.1 sqrt(largest eigenvalue of W), with the eigenvalue bounded by row sums."""
    row_sums = np.asarray(abs(form.W).sum(axis=1)).ravel()
    largest = float(np.max(row_sums, initial=1.0))
    return float(np.sqrt(largest * 1e-2))


def _factorised(form: LocalForm, rho: float) -> BlockSystem:
    size = form.m * form.d
    identity = sp.identity(size, format="csr") if form.sparse else np.eye(size)
    try:
        return BlockSystem(form, form.W + rho * identity, form.V, form.V)
    except np.linalg.LinAlgError as error:
        raise NotConverged(f"admm: singular at the penalty {rho:.3g}") from error
