"""The matrices of a problem for products in twice double precision, laid out once for a stiffness and its rows."""

from __future__ import annotations

from copy import copy

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.extended import ClearedRows, Extended, SparseRows, extend
from contactqp.model.arrays import Array, Vector
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem


class ExtendedRows:
    """The matrices of a problem, for products in extended precision."""

    stiffness: SparseRows | ClearedRows

    def __init__(self, problem: ContactProblem) -> None:
        self.stiffness = _stiffness_rows(problem)
        self.normal = SparseRows(problem.normal)
        self.tie = SparseRows(problem.tie)
        self.tangent = None if problem.tangent is None else SparseRows(problem.tangent)
        self._outward = SparseRows(sp.hstack([problem.normal.T, problem.tie.T]))
        self._tangent_transposed = None if problem.tangent is None else SparseRows(problem.tangent.T)

    def contact_force(self, normal_force: Extended, tie_force: Extended) -> Extended:
        """E_N' l_N + A' nu."""
        hi = np.concatenate([normal_force.hi, tie_force.hi])
        return self._outward @ Extended(hi, np.concatenate([normal_force.lo, tie_force.lo]))

    def friction_force(self, force: Extended | NDArray[np.float64] | None) -> Extended:
        """E_T' l_T of forces (m, d-1), or flat in extended precision."""
        if self._tangent_transposed is None or force is None:
            return Extended(np.zeros(self.stiffness.shape[0]))
        return self._tangent_transposed @ (force if isinstance(force, Extended) else Extended(force.ravel()))

    def cleared(self, motions: Array, inverse: Array) -> ExtendedRows:
        """The same with a stiffness that is zero along rigid motions Z (n, r); `inverse` (r, n): Y' with Y'Z = I."""
        twin = copy(self)
        assert isinstance(self.stiffness, SparseRows)
        twin.stiffness = ClearedRows(self.stiffness, motions, inverse)
        return twin

    def slip(self, displacement: Extended) -> Extended:
        """E_T u, flat."""
        return Extended(np.zeros(0)) if self.tangent is None else self.tangent @ displacement


def _stiffness_rows(problem: ContactProblem) -> SparseRows:
    shared = problem._shared
    if "extended_stiffness" not in shared:
        shared["extended_stiffness"] = SparseRows(problem.stiffness_rows)
    rows: SparseRows = shared["extended_stiffness"]
    return rows


def extended_rows(problem: ContactProblem) -> ExtendedRows:
    """Made once for a stiffness and its rows; shared by every problem that `replace` derives."""
    shared = problem._shared
    if "extended" not in shared:
        shared["extended"] = ExtendedRows(problem)
    rows: ExtendedRows = shared["extended"]
    return rows


def velocity_of(problem: LocalProblem, force: Array, joint_force: Vector | None = None) -> Array:
    """Return u = W r + q + V l (m, d) of a problem in local form at forces (m, d) and (p,), in twice double precision.

    Forces that redundant contacts press against each other may be so large that in doubles nothing is left of q.
    """
    u = SparseRows(problem.delassus) @ extend(np.asarray(force, dtype=float).ravel()) + extend(problem.offset)
    if joint_force is not None and problem.joints:
        u = u + SparseRows(problem.bilateral) @ extend(joint_force)
    return np.asarray(u.double().reshape(problem.contacts, problem.dimension))
