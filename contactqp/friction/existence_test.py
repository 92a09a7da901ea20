"""Whether Coulomb's law can hold at all: balance of forces in their cones, and the test of Acary and others (2011).

That test: if some velocity u = W y + V l + q lies inside all dual cones K* = {u_N >= mu |u_T|}, the map from shifts
to |u_T| has a fixed point, and there is a solution for any coefficient of friction. It is sufficient, not necessary.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from contactqp.coulomb_cone import lengths
from contactqp.errors import NoEquilibrium
from contactqp.factorization import Array
from contactqp.friction.conic import ConicProgram, diagonal_rows, solve_conic
from contactqp.friction.local_form import LocalForm
from contactqp.methods import Settings

# The direction of an unbalanced motion is believed where cones and load miss it by less than this part.
SURE = 1e-6
SOLVER, SETTINGS = "clarabel", Settings(tolerance=1e-9)
# It may give up early if too much is asked of it; where less is, only motions of this part of the load are believed.
PROOFS = ((SETTINGS, SURE), (Settings(tolerance=1e-5), 1e-4))


def refuse_unbalanced(form: LocalForm) -> Array | None:
    """Forces (m, d) in their cones that balance the load along free motions, V'r = -s; None where no load drives any.

    Where there are none it raises NoEquilibrium. The proof is a motion g along which no such force does negative work
    while the load does: V g in K*, g's > 0.
    """
    hard = np.flatnonzero(form.joint_signs < 0)
    V, s = form.V[:, hard], form.s[hard]
    if not np.any(s):
        return None
    size, p = form.m * form.d, len(hard)
    slope = np.ones((form.m, form.d))
    slope[:, 0] = form.mu
    normal = sp.csr_array((-np.ones(form.m), (np.arange(form.m), form.d * np.arange(form.m))), shape=(form.m, size))
    # min 1/2 |w|^2 over w = V'r + s: sparse, as 1/2 |V'r + s|^2 is not.
    cones = sp.hstack([sp.vstack([normal, -diagonal_rows(slope)]), sp.csr_array((form.m + size, p))])
    program = ConicProgram(
        P=sp.csc_array(sp.diags(np.append(np.zeros(size), np.ones(p)))),
        c=np.zeros(size + p),
        A=sp.csc_array(sp.vstack([sp.hstack([sp.csr_array(V.T), -sp.identity(p)]), cones])),
        b=np.append(-s, np.zeros(form.m + size)),
        zeros=p,
        nonnegatives=form.m,
        cones=form.m,
        width=form.d,
    )
    load = float(np.linalg.norm(s))
    for settings, seen in PROOFS:
        r = solve_conic(program, SOLVER, settings)[0][:size]
        motion = V.T @ r + s
        far = float(np.linalg.norm(motion))
        if far <= SURE * load:
            break
        moves = (V @ motion).reshape(form.m, form.d)
        into = form.mu * lengths(moves[:, 1:]) - moves[:, 0]
        reach = np.max(abs(V) @ abs(motion), initial=0.0)
        opposed = float(motion @ s) > SURE * far * load and np.max(into, initial=0.0) <= SURE * reach
        if opposed and far > seen * load:
            raise NoEquilibrium("friction: the load drives a rigid motion that neither contacts nor friction hold")
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
