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

from contactqp.model.arrays import Vector

# A row of which its neighbours leave less than this, squared, depends on them; rounding leaves about 1e-16 of it.
DEPENDENT = 1e-10


class IndependentRows:
    """(E C E')^-1 of the rows of E that depend on no others.

    Parameters
    ----------
    entries : (a, c) CSR matrix
        E.
    compliance : (c,) array
        The diagonal of C.
    """

    def __init__(self, entries: Any, compliance: Vector) -> None:
        self._count = entries.shape[0]
        self.kept = np.arange(self._count)
        rows = entries
        while self.kept.size:
            scale = 1 / np.sqrt(rows.multiply(rows) @ compliance)
            unit = sp.diags(scale) @ rows @ sp.diags(np.sqrt(compliance))
            independent = self._factorise(sp.csc_matrix(unit @ unit.T))
            if np.all(independent):
                self._scale = scale
                break
            self.kept = self.kept[independent]
            rows = entries[self.kept]

    def _factorise(self, gram: Any) -> NDArray[np.bool_]:
        """Factors of the rows' Gram matrix, its diagonal one; which of the rows do not depend on rows before them."""
        from scipy.sparse.linalg import splu

        # Exactly dependent rows would leave a zero pivot, which SuperLU refuses: they leave this.
        lifted = sp.csc_matrix(gram + np.finfo(float).eps * sp.identity(gram.shape[0]))
        options = dict(permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        self._factor = splu(lifted, **options)
        return np.asarray(self._factor.U.diagonal()[self._factor.perm_c] > DEPENDENT)

    def solve(self, lengths: Vector) -> Vector:
        """(a,) forces that cause the lengths (a,), zero on rows that depend on others."""
        force = np.zeros(self._count)
        if self.kept.size:
            force[self.kept] = self._scale * self._factor.solve(self._scale * lengths[self.kept])
        return force


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
        self._entries, self._columns, self._compliance, self._limit = entries, columns, compliance, limit
        self._gram = IndependentRows(entries, compliance)

    def close(self, x: Vector) -> None:
        """Move x so that E x = g, in place."""
        missing = self._limit - self._entries @ x[self._columns]
        x[self._columns] += self._compliance * (self._entries.T @ self._gram.solve(missing))

    def admit(self, z: Vector) -> None:
        """Take out of z what moves the rows, in place."""
        moved = self._gram.solve(self._entries @ z[self._columns])
        z[self._columns] -= self._compliance * (self._entries.T @ moved)

    def forces(self, r: Vector) -> Vector:
        """(a,) l, zero on dependent rows."""
        return self._gram.solve(self._entries @ (self._compliance * r[self._columns]))

    def balanced(self, r: Vector) -> Vector:
        """What the forces on the rows leave of r."""
        left = r.copy()
        left[self._columns] -= self._entries.T @ self.forces(r)
        return left
