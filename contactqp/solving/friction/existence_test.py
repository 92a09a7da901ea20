"""Whether Coulomb's law can hold at all: balance of forces in their cones, and the test of Acary and others (2011).

That test: if some velocity u = W y + V l + q lies inside all dual cones K* = {u_N >= mu |u_T|}, the map from shifts
to |u_T| has a fixed point, and there is a solution for any coefficient of friction. It is sufficient, not necessary.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed, NoEquilibrium
from contactqp.linalg.existence import around, unresisted
from contactqp.linalg.extended import SparseRows, extend
from contactqp.linalg.saddle import BALANCED
from contactqp.model.arrays import Array, Vector
from contactqp.solving.friction.conic import ConicProgram, diagonal_rows, solve_conic
from contactqp.solving.friction.local_form import LocalForm
from contactqp.solving.methods import Settings

SOLVER, SETTINGS = "clarabel", Settings(tolerance=1e-9)


def refuse_unbalanced(form: LocalForm) -> None:
    """Raise NoEquilibrium if the load of a local problem drives free joints in a way that no force of a cone resists.

    The proof is a motion g of joints without compliance with V g in K* at every contact and s'g > 0: all forces r of
    the cones have r'V g >= 0, but balance asks for r'V g = -s'g. It is looked for within polyhedra in K* and checked by
    sums in extended precision.
    """
    hard = np.flatnonzero(form.joint_signs < 0)
    V, s = form.V[:, hard], form.s[hard]
    if not np.any(s) or np.any(form.R[:, hard]):
        return
    rows = _resisting(V.reshape(form.m, form.d, len(hard)), form.mu)
    size = np.max(abs(rows), axis=1, keepdims=True)
    motion = unresisted(s, rows / np.where(size > 0, size, 1.0), np.zeros((0, len(hard))))
    if motion is None:
        return
    resisted = (SparseRows(sp.csr_matrix(rows)) @ extend(motion)).double()
    if np.any(resisted > BALANCED * (abs(rows) @ abs(motion))):
        return
    if extend(s).dot(extend(motion)) > BALANCED * float(abs(s) @ abs(motion)):
        raise NoEquilibrium("friction: the load drives a rigid motion that neither contacts nor friction hold")


def _resisting(V: Array, mu: Vector) -> Array:
    """Rows of which none is positive where V g (m, d) lies in all K*, (m, d, p) given."""
    parts = [
        -V[:, 0] + mu[:, None] * np.einsum("w,iwp->ip", direction, V[:, 1:]) for direction in around(V.shape[1] - 1)
    ]
    return np.vstack(parts)


def balancing_forces(form: LocalForm) -> Array | None:
    """Forces (m, d) in their cones that balance the load along free motions best, V'r = -s; None where there is none.

    Nothing is said of whether they balance it.
    """
    hard = np.flatnonzero(form.joint_signs < 0)
    V, s = form.V[:, hard], form.s[hard]
    if not np.any(s):
        return None
    size, p = form.m * form.d, len(hard)
    slope = np.ones((form.m, form.d))
    slope[:, 0] = form.mu
    normal = sp.csr_array((-np.ones(form.m), (np.arange(form.m), form.d * np.arange(form.m))), shape=(form.m, size))
    # min 1/2 |w|^2 over w = (V'r + s) / |s|: sparse, as 1/2 |V'r + s|^2 is not.
    load = float(np.linalg.norm(s))
    cones = sp.hstack([sp.vstack([normal, -diagonal_rows(slope)]), sp.csr_array((form.m + size, p))])
    program = ConicProgram(
        P=sp.csc_array(sp.diags(np.append(np.zeros(size), np.ones(p)))),
        c=np.zeros(size + p),
        A=sp.csc_array(sp.vstack([sp.hstack([sp.csr_array(V.T), -sp.identity(p)]), cones])),
        b=np.append(-s / load, np.zeros(form.m + size)),
        zeros=p,
        nonnegatives=form.m,
        cones=form.m,
        width=form.d,
    )
    try:
        r = load * solve_conic(program, SOLVER, SETTINGS)[0][:size]
    except BackendFailed:
        return None
    return r.reshape(form.m, form.d)


def interior_margin(form: LocalForm) -> float:
    """The largest x <= 1 with W y + V l + q - x e_N in K* for some y and l; positive: a solution exists.

    Scaled: contacts have a compliance of one and q has entries of size one.
    """
    soft, hard = np.flatnonzero(form.joint_signs > 0), np.flatnonzero(form.joint_signs < 0)
    size, p = form.m * form.d, form.joints
    order = np.concatenate([soft, hard])
    V, q = form.V[:, order], form.q.reshape(form.m, form.d)
    slope = np.ones((form.m, form.d))
    slope[:, 1:] = form.mu[:, None]
    scale = diagonal_rows(slope)
    towards = np.zeros((form.m, form.d))
    towards[:, 0] = -1.0
    reach = sp.hstack([sp.csr_array(form.W), sp.csr_array(V), sp.csr_array(towards.reshape(-1, 1))])
    balance = sp.hstack(
        [
            sp.csr_array(form.V[:, soft].T),
            sp.csr_array(form.R[np.ix_(soft, soft)]),
            sp.csr_array((len(soft), len(hard) + 1)),
        ]
    )
    limit = sp.csr_array(([1.0], ([0], [size + p])), shape=(1, size + p + 1))
    program = ConicProgram(
        P=sp.csc_array((size + p + 1, size + p + 1)),
        c=np.append(np.zeros(size + p), -1.0),
        A=sp.csc_array(sp.vstack([balance, limit, -scale @ reach])),
        b=np.concatenate([-form.s[soft], [1.0], (slope * q).ravel()]),
        zeros=len(soft),
        nonnegatives=1,
        cones=form.m,
        width=form.d,
    )
    x, _ = solve_conic(program, SOLVER, SETTINGS)
    return float(x[-1])
