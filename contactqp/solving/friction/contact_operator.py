"""What the contacts of a problem feel of each other through the bodies, whatever the load, the gaps and the friction.

On the retained unknowns, scaled (`rows`), with H = [-N; T]' contact by contact, x = x0 + B y where A x0 = b, A B = 0,
and the rigid motions Z that the ties leave,

    W = H'B C B'H,    C = S_B^+,    V = H'B Z.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from contactqp.errors import NotConverged
from contactqp.linalg.condensation import UNRESISTED, Condensation
from contactqp.linalg.frictional_rows import FrictionalRows, compliance_of
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem

# Tie rows of unit length that leave more than this of their values open conflict.
CONFLICT = 1e-9
# A load that does this part of the work that its entries do, added up, drives a rigid motion by rounding only.
BALANCED = 1e-12


class ContactOperator:
    """W, V and what leads from forces at contacts to displacements.

    Attributes
    ----------
    H : (d m, p) array
        Rows of approach, reversed, and of slip, contact by contact.
    basis, motions : (p, y), (y, z) arrays
        B and Z, orthonormal.
    compliance : (y, y) array
        C.
    delassus, rigid : (d m, d m), (d m, z) arrays
        W and V.
    """

    def __init__(self, condensation: Condensation, rows: FrictionalRows) -> None:
        m, d = len(rows.normal), rows.width + 1
        tangent = rows.tangent.reshape(m, rows.width, -1)
        self.H = np.concatenate([-rows.normal[:, None, :], tangent], axis=1).reshape(m * d, -1)
        self._rows, self._tied = rows, np.zeros((0, 0))
        self.basis, S, HB = np.eye(len(rows.S)), rows.S, self.H
        if len(rows.tie):
            left, size, right = np.linalg.svd(rows.tie)
            rank = int(np.sum(size > UNRESISTED * size[0]))
            self._tied, self.basis = right[:rank].T @ (left[:, :rank] / size[:rank]).T, right[rank:].T
            S, HB = self.basis.T @ rows.S @ self.basis, self.H @ self.basis
        self.motions = _null_motions(rows, self.basis)
        self.compliance = compliance_of(S, self.motions)
        resisted = _resisted(HB, self.motions)
        W = resisted @ self.compliance @ resisted.T
        self.delassus, self.rigid, self._HB = (W + W.T) / 2, HB @ self.motions, HB
        self._whole, self._uncertain = _whole_motions(condensation, rows, self.basis @ self.motions)

    def start(self, value: Vector) -> Vector:
        """x0 (p,) of least norm.

        Raises
        ------
        NotConverged
            No displacement was found that gives the ties their values: whether they conflict is proven elsewhere.
        """
        if not self._tied.size:
            return np.zeros(len(self.basis))
        start = np.asarray(self._tied @ value)
        if np.max(abs(self._rows.tie @ start - value), initial=0.0) > CONFLICT * np.max(abs(value), initial=0.0):
            raise NotConverged("friction: the ties contradict each other, as far as floats can tell")
        return start

    def free(self, load: Vector, start: Vector) -> Vector:
        """H'x (d m,) under a load (y,) on the bodies without contacts, their rigid motions at rest."""
        return np.asarray(self._HB @ (self.compliance @ load) + self.H @ start)

    def drive(self, problem: ContactProblem) -> Vector:
        """z'f of every rigid motion; exactly nothing where it is rounding."""
        work, size = self._whole.T @ problem.load, abs(self._whole).T @ abs(problem.load)
        return np.asarray(np.where(abs(work) <= max(BALANCED, self._uncertain) * size, 0.0, work))


def contact_operator(problem: ContactProblem, condensation: Condensation, rows: FrictionalRows) -> ContactOperator:
    """That of a problem's stiffness and rows, made once for all loads."""
    shared: dict[str, Any] = problem._shared
    if "contact_operator" not in shared:
        shared["contact_operator"] = ContactOperator(condensation, rows)
    operator: ContactOperator = shared["contact_operator"]
    return operator


def _resisted(rows: Array, motions: Array) -> Array:
    """What of rows is no rigid motion; exactly nothing where it is rounding, so that its compliance is none."""
    left = rows - (rows @ motions) @ motions.T
    size = np.linalg.norm(rows, axis=1)
    return np.where((np.linalg.norm(left, axis=1) > UNRESISTED * size)[:, None], left, 0.0)


def _whole_motions(condensation: Condensation, rows: FrictionalRows, motions: Array) -> tuple[Array, float]:
    """Rigid motions (n, z) of the bodies whose retained unknowns are given, and how uncertain they are."""
    rigid = condensation.rigid
    if not motions.shape[1]:
        return np.zeros((len(rigid.motions), 0)), 0.0
    retained = rigid.motions[condensation.retained] / rows.scale[:, None]
    return rigid.motions @ np.linalg.lstsq(retained, motions, rcond=None)[0], rigid.uncertainty


def _null_motions(rows: FrictionalRows, basis: Array) -> Array:
    """An orthonormal basis of the rigid motions that the ties leave, in coordinates of `basis`."""
    motions = rows.motions
    if not motions.shape[1]:
        return np.zeros((basis.shape[1], 0))
    if len(rows.tie):
        _, size, right = np.linalg.svd(rows.tie @ motions)
        motions = motions @ right[int(np.sum(size > UNRESISTED)) :].T
    return np.asarray(basis.T @ motions)
