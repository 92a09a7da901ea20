"""One combination of open, stick and slip over the ranks: a linear system, unsymmetric where something slides.

With H the rows that are held (closed contacts, ties, tangents that stick), G = H + mu t'E_T at the normals of contacts
that slide, and the turning of slip directions in space as a stiffness C of the tangents,

    (K + E_T'C E_T) u + G'l = f + E_T'C o,    H u = h.

GMRES goes along displacements M r that H admits and looks at what the forces on G leave of residuals,

    P_G (K + E_T'C E_T) P_H M y = P_G r,    u = u_0 + P_H M y,

P_H and P_G the projections of `contactqp.linalg.krylov`. Friction in proportion to l_N is in the system itself:
nothing has to be iterated on but the combination, and in space the directions.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from contactqp.distributed.friction_rows import FrictionRows
from contactqp.distributed.friction_states import Iterate, States
from contactqp.distributed.krylov import gmres
from contactqp.distributed.rows import Rows
from contactqp.model.arrays import Vector

# Steps of GMRES on one combination.
STEPS = 600


class CombinationSystem:
    """The system of one combination. Everything is collective."""

    def __init__(self, rows: FrictionRows, chosen: States) -> None:
        way = rows.way
        self._rows, self._way, self._chosen = rows, way, chosen
        self._active = rows.held(chosen)
        held, limit = way.rows.entries[self._active], rows.limit[self._active]
        floating = way.floating
        if floating.count:
            floating = rows.sticking(chosen.stick)[0].floating
        self._held, self._pushed = (
            floating.kept_from(way.holding(entries, limit), chosen.closed)
            for entries in (held, _below(held, rows.pushing(chosen)[chosen.closed]))
        )
        self._turning: Rows | None = None
        if way.any(chosen.turning > 0):
            turned, self._origin = rows.turning(chosen)
            self._turning = way.rows.standing(turned)
        self._scale = np.sqrt(way.diagonal)

    def closed(self, u: Vector) -> Vector:
        """A displacement moved onto the limits of the held rows."""
        x = u.copy()
        self._held.close(x)
        return x

    def residual(self, x: Vector) -> Vector:
        """f + E_T'C o - (K + E_T'C E_T) x."""
        left = self._rows.problem.load - self._way.product(x)
        if self._turning is not None:
            left -= self._turning.forces(self._turning.lengths(x) - self._origin)
        return np.asarray(left)

    def unbalanced(self, residual: Vector) -> Vector:
        """What the forces on the rows leave of a residual."""
        return self._pushed.balanced(residual)

    def error(self, unbalanced: Vector) -> float:
        """|r'P_H M r|, about the square of the error in energy."""
        return abs(self._way.dot(unbalanced, self._along(unbalanced)))

    def improved(self, x: Vector, unbalanced: Vector, reduction: float) -> Vector:
        """x with what is unbalanced at it reduced by this factor, as far as GMRES comes."""
        scale = self._scale

        def operator(y: Vector) -> Vector:
            return np.asarray(self._pushed.balanced(self._stiffness(self._along(scale * y))) / scale)

        found, steps = gmres(operator, unbalanced / scale, self._rows.problem.stiffness, reduction, STEPS)
        self._way.krylov_iterations += steps
        return np.asarray(x + self._along(scale * found))

    def iterate(self, x: Vector) -> Iterate:
        """The forces that go with a displacement. Friction across t is that of Newton's method."""
        rows, chosen = self._rows, self._chosen
        force = np.zeros(len(rows.limit))
        force[self._active] = self._pushed.forces(self.residual(x))
        normal, tie, rub = np.split(force, [rows.m, rows.plain])
        rub = rub.reshape(rows.m, rows.width)
        along = (rows.mu * np.maximum(normal, 0.0))[:, None] * chosen.direction
        return Iterate(x, normal, rub + along + rows.across(x, chosen), tie)

    def _along(self, r: Vector) -> Vector:
        z = self._way.smooth(r)
        self._held.admit(z)
        return z

    def _stiffness(self, x: Vector) -> Vector:
        force = self._way.product(x)
        if self._turning is not None:
            force += self._turning.forces(self._turning.lengths(x))
        return force


def _below(rows: sp.csr_matrix, added: sp.csr_matrix) -> sp.csr_matrix:
    """Rows with others added to the first of them."""
    nothing = sp.csr_matrix((rows.shape[0] - added.shape[0], rows.shape[1]))
    return sp.csr_matrix(rows + sp.vstack([added, nothing]))
