"""The rigid motions of the bodies, and which rows of contacts and ties feel them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.condensation import condense, unknown_scale
from contactqp.linalg.factorization import null_space
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem

# Parts of a dependent row of unit length, and what such rows feel of unit motions, below this are rounding.
NEGLIGIBLE = 1e-10


@dataclass(frozen=True, eq=False)
class FloatingBodies:
    """The bodies of a problem, in unknowns where the stiffness has a unit diagonal."""

    problem: ContactProblem

    @cached_property
    def rigid(self) -> NDArray[np.float64]:
        """(n, r) orthonormal motions that the stiffness does not feel, in unknowns where it has a unit diagonal."""
        if not condense(self.problem).rigid.count:
            return np.zeros((self.problem.dimension, 0))
        return np.linalg.qr(null_space(self.problem.stiffness).motions / self.scale[:, None])[0]

    @cached_property
    def normal(self) -> NDArray[np.float64]:
        """(m, n) rows of the contacts, of unit length in these unknowns."""
        return self.unit(self.problem.normal)

    @cached_property
    def tie(self) -> NDArray[np.float64]:
        """(k, n) rows of the ties, likewise."""
        return self.unit(self.problem.tie)

    @cached_property
    def scale(self) -> Vector:
        """D (n,) of these unknowns x, u = D x."""
        return unknown_scale(self.problem)

    def unit(self, rows: Any) -> NDArray[np.float64]:
        """Rows of unit length in these unknowns; an empty row is left as it is."""
        dense = np.asarray((rows @ sp.diags(self.scale)).toarray())
        length = np.linalg.norm(dense, axis=1, keepdims=True)
        return np.asarray(dense / np.where(length > 0, length, 1.0))

    def held_by(self, unit_rows: NDArray[np.float64]) -> bool:
        """Whether rows of unit length feel every rigid motion: told from the motions, whatever rounding may hide."""
        r = self.rigid.shape[1]
        if not r:
            return True
        felt = np.linalg.svd(unit_rows @ self.rigid, compute_uv=False)
        return bool(np.count_nonzero(felt > NEGLIGIBLE) == r)

    def carried(self, rows: Any, forces: Vector) -> Vector:
        """What rounding of forces (n,) makes of the forces of rows: a floating body hands all to its contacts."""
        if not self.rigid.shape[1]:
            return np.zeros(rows.shape[0])
        felt = abs(self.unit(rows) @ self.rigid) > NEGLIGIBLE
        length = np.linalg.norm((rows @ sp.diags(self.scale)).toarray(), axis=1)
        noise = 16 * np.finfo(float).eps * (felt @ (abs(self.rigid).T @ (self.scale * forces)))
        return np.asarray(noise / np.where(length > 0, length, 1.0))
