"""Displacements and forces that rows E_A, held at g_A, allow: projections in the metric of D = diag K.

    closed      x + D^-1 E'(E D^-1 E')^-1 (g - E x)          meets E x = g
    admissible  z - D^-1 E'(E D^-1 E')^-1 E z                meets E z = 0
    forces      l = (E D^-1 E')^-1 E D^-1 r                  the forces on the rows that carry r best
    balanced    r - E' l                                     what they leave of it

The rows may share unknowns. Rows that depend on others are set aside: they carry no force.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.problem import Vector

# A row of which its neighbours leave less than this, squared, depends on them; rounding leaves about 1e-16 of it.
DEPENDENT = 1e-10


class HeldRows:
    """Rows over the unknowns `columns`, held at `limit`.

    Parameters
    ----------
    entries : (a, c) CSR matrix
    columns : (c,) array of int
        The unknowns.
    limit : (a,) array [length]
    compliance : (c,) array
        1/K_jj of these unknowns.
    """

    def __init__(self, entries: Any, columns: NDArray[np.intp], limit: Vector, compliance: Vector) -> None:
        self._count, self._columns, self._compliance = entries.shape[0], columns, compliance
        self._kept = np.arange(self._count)
        self._entries, self._limit = entries, limit
        while self._kept.size:
            scale = 1 / np.sqrt(self._entries.multiply(self._entries) @ compliance)
            unit = sp.diags(scale) @ self._entries @ sp.diags(np.sqrt(compliance))
            independent = self._factorise(sp.csc_matrix(unit @ unit.T))
            if np.all(independent):
                self._scale = scale
                break
            self._kept = self._kept[independent]
            self._entries, self._limit = entries[self._kept], limit[self._kept]

    def _factorise(self, gram: Any) -> NDArray[np.bool_]:
        """Factors of the rows' Gram matrix, its diagonal one; which of the rows do not depend on rows before them."""
        from scipy.sparse.linalg import splu

        # Exactly dependent rows would leave a zero pivot, which SuperLU refuses: they leave this.
        lifted = sp.csc_matrix(gram + np.finfo(float).eps * sp.identity(gram.shape[0]))
        options = dict(permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        self._factor = splu(lifted, **options)
        return np.asarray(self._factor.U.diagonal()[self._factor.perm_c] > DEPENDENT)

    def _solve(self, lengths: Vector) -> Vector:
        return np.asarray(self._scale * self._factor.solve(self._scale * lengths))

    def close(self, x: Vector) -> None:
        """Move x so that E x = g, in place."""
        if self._kept.size:
            missing = self._limit - self._entries @ x[self._columns]
            x[self._columns] += self._compliance * (self._entries.T @ self._solve(missing))

    def admit(self, z: Vector) -> None:
        """Take out of z what moves the rows, in place."""
        if self._kept.size:
            moved = self._solve(self._entries @ z[self._columns])
            z[self._columns] -= self._compliance * (self._entries.T @ moved)

    def forces(self, r: Vector) -> Vector:
        """(a,) l, zero on dependent rows."""
        force = np.zeros(self._count)
        if self._kept.size:
            force[self._kept] = self._solve(self._entries @ (self._compliance * r[self._columns]))
        return force

    def balanced(self, r: Vector) -> Vector:
        """What the forces on the rows leave of r."""
        left = r.copy()
        if self._kept.size:
            left[self._columns] -= self._entries.T @ self.forces(r)[self._kept]
        return left
