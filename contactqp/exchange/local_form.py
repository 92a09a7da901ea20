"""Eliminate the bodies and keep the contacts, the local form: W = H'M^-1 H, q = H'M^-1 f + w, and for joints V = H'M^-1
G, R = G'M^-1 G, s = G'M^-1 f + b (Acary, Bremond, Huber 2018).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem, Unsupported
from contactqp.model.arguments import checked
from contactqp.model.arrays import EPS, Array, Vector, own_floating_point
from contactqp.model.local_problem import GlobalProblem, LocalProblem
from contactqp.model.problem import ContactProblem

# Scaled to unit diagonal, a singular matrix has a reciprocal condition number of a few eps in floating point.
SINGULAR_STIFFNESS = 64 * EPS
# Columns of H that are solved for at a time: a dense block of them must fit into memory.
COLUMNS_AT_A_TIME = 256


class SingularMatrix(InvalidProblem):
    """M has no inverse, so there is no local form: bodies move without any force."""


def of_closing_contacts(problem: ContactProblem) -> ContactProblem:
    """Return the problem without contacts of infinite gaps, for which files of contact problems have no place."""
    may_close = problem.gap < np.inf
    return problem if np.all(may_close) else problem.with_contacts(np.flatnonzero(may_close))


@checked
@own_floating_point
def local_form_of(problem: ContactProblem | GlobalProblem | LocalProblem) -> LocalProblem:
    """Return the local form of a problem with bodies, each contact's components in the order (N, T1, T2).

    For a symmetric M the Delassus operator W is symmetrised, which removes rounding only; for an unsymmetric M it is
    left as computed, and `asymmetry` measures it. Contacts with infinite gaps, which never close, are left out.

    Parameters
    ----------
    problem : ContactProblem or GlobalProblem, both with tangential rows; a LocalProblem is returned as it is

    Raises
    ------
    InvalidProblem
        M is singular, as for bodies held by contact alone, or there are no tangential rows.
    Unsupported
        M is not symmetric and there are joints: the influence of joints on contacts is then not that of contacts on
        joints.

    Examples
    --------
    >>> import contactqp as cq
    >>> rows = dict(normal=[[-1.0, 0.0]], gap=[0.5], tangent=[[0.0, 1.0]], friction=0.3)
    >>> bodies = cq.ContactProblem(stiffness=[[2.0, 0.0], [0.0, 4.0]], load=[-3.0, 1.0], **rows)
    >>> local = local_form_of(bodies)
    >>> local.delassus.toarray(), local.offset
    (array([[0.5 , 0.  ],
           [0.  , 0.25]]), array([-1.  ,  0.25]))
    """
    if isinstance(problem, LocalProblem):
        return problem
    if isinstance(problem, ContactProblem):
        problem = of_closing_contacts(problem)
    names = problem.contact_names if isinstance(problem, ContactProblem) else None
    bodies = GlobalProblem.of(problem) if isinstance(problem, ContactProblem) else problem
    p = len(bodies.joint_offset)
    if p and not bodies.symmetric:
        raise Unsupported(
            f"local form: joints with an M that is not symmetric (by {bodies.asymmetry:.3g}) are not supported"
        )
    inverse = _Inverse(bodies.matrix)
    exact = bodies.asymmetry == 0
    W = _congruence(inverse, bodies.directions, bodies.directions)
    free = inverse.solve(bodies.load)
    joints: dict[str, Any] = {}
    if p:
        R = _congruence(inverse, bodies.joints, bodies.joints)
        joints = dict(
            bilateral=_congruence(inverse, bodies.directions, bodies.joints),
            bilateral_delassus=(R + R.T) / 2 if exact else R,
            bilateral_offset=bodies.joints.T @ free + bodies.joint_offset,
        )
    return LocalProblem(
        delassus=(W + W.T) / 2 if exact else W,
        offset=bodies.directions.T @ free + bodies.offset,
        friction=bodies.friction,
        dimension=bodies.dimension,
        contact_names=names,
        **joints,
    )


def body_motion(problem: GlobalProblem, force: Array, joint_force: Vector) -> Vector:
    """Return the velocities v = M^-1 (H r + f + G l) (n,) of the bodies.

    Raises InvalidProblem: M is singular.
    """
    acting = problem.directions @ force.ravel() + problem.load + problem.joints @ joint_force
    return _Inverse(problem.matrix).solve(acting)


class _Inverse:
    """M^-1 by a sparse factorisation of M scaled to unit diagonal, symmetric or not."""

    def __init__(self, M: Any) -> None:
        from scipy.sparse.linalg import splu

        self._size = M.shape[0]
        diagonal = abs(M.diagonal())
        rows = abs(M).max(axis=1).toarray().ravel() if self._size else np.zeros(0)
        largest = np.where(diagonal > 0, diagonal, rows)
        self._scale = 1 / np.sqrt(np.where(largest > 0, largest, 1.0))
        if not self._size:
            return
        scaled = sp.csc_matrix(sp.diags(self._scale) @ M @ sp.diags(self._scale))
        try:
            self._factor = splu(scaled)
        except RuntimeError:  # SuperLU's word for an exactly zero pivot
            raise self._singular(0.0) from None
        reciprocal = self._reciprocal_condition(scaled)
        if not reciprocal > SINGULAR_STIFFNESS:
            raise self._singular(reciprocal)

    def solve(self, right: Array) -> Array:
        """Return M^-1 right, (n,) or (n, q)."""
        if not self._size:
            return np.zeros_like(right)
        return np.asarray((self._factor.solve((right.T * self._scale).T).T * self._scale).T)

    def _reciprocal_condition(self, scaled: Any) -> float:
        """Estimate 1 / (|S|_1 |S^-1|_1) from above by a few solutions with random signs (Hager, Higham)."""
        signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(self._size, 4))
        inverse_size = 0.0
        for x in signs.T / self._size:
            for _ in range(3):
                y = self._factor.solve(x)
                inverse_size = max(inverse_size, float(np.sum(abs(y)) / np.sum(abs(x))))
                z = self._factor.solve(np.where(y >= 0, 1.0, -1.0), trans="T")
                x = np.zeros(self._size)
                x[int(np.argmax(abs(z)))] = 1.0
        size = float(np.max(np.asarray(abs(scaled).sum(axis=0))))
        return 1.0 / (size * inverse_size) if np.isfinite(inverse_size) and inverse_size > 0 else 0.0

    def _singular(self, reciprocal: float) -> SingularMatrix:
        return SingularMatrix(
            f"local form: M is singular (reciprocal condition number {reciprocal:.1g} after scaling its diagonal to "
            "one): bodies that nothing but contact holds have no local form"
        )


def _congruence(inverse: _Inverse, left: Any, right: Any) -> Any:
    """Return left' M^-1 right (CSR); bodies that are not connected leave exact zeros, which are not stored."""
    blocks = []
    columns = sp.csc_array(right)
    for first in range(0, columns.shape[1], COLUMNS_AT_A_TIME):
        solved = inverse.solve(columns[:, first : first + COLUMNS_AT_A_TIME].toarray())
        blocks.append(sp.csc_array(left.T @ solved))
    return sp.csr_array(sp.hstack(blocks)) if blocks else sp.csr_array((left.shape[1], 0))
