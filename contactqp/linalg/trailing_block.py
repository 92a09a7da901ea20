"""SciPy's SuperLU with the retained unknowns eliminated last: the end of its factors is the Schur complement.

With the interior unknowns i first, the retained c last, and springs T > 0 on c,

    [ K_ii  K_ic     ]   [ L_ii      ] [ U_ii  U_ic ]
    [ K_ci  K_cc + T ] = [ L_ci L_cc ] [       U_cc ],      S + T = L_cc U_cc,      S = K_cc - K_ci K_ii^-1 K_ic.

S is singular where bodies float, S + T never is. One solve with K + T reduces a load, another expands a displacement:

    (K + T) x = (f_i, 0),                    f_S = f_c - K_ci K_ii^-1 f_i = f_c + (S + T) x_c
    (K + T) d = (0, (S + T)(u_c - x_c)),     u = x + d

T is a good part of the diagonal of K_cc: S + T is then well conditioned, and S loses to T no more digits than the
difference K_cc - K_ci K_ii^-1 K_ic loses anyway.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.linalg.factorization import (
    DIAGONAL_PIVOTS,
    LIFT,
    fill_reducing_order,
    forget_triangles,
    refuse_negative,
    unit_diagonal_scale,
)
from contactqp.linalg.stages import count_half_substitutions
from contactqp.model.arrays import Array, Vector

# T where K has a diagonal of about one. Measured on blocks, plates, beams and lattices, floating or with a contrast of
# 1e12: S is as accurate as without springs, up to 30 times more than with T = 1; f_S is as accurate as with T = 1, up
# to 20 times more than with 2^-10.
SPRING = 2.0**-4
# Up to so many retained unknowns keep their columns of (K + T)^-1: a product then replaces the second solve of a load.
FEW = 16


class TrailingBlock:
    """S and solves with K + T, from one sparse factorisation; it needs at least one interior unknown.

    Raises
    ------
    InvalidProblem
        A pivot of K_ii is negative beyond rounding: the matrix is indefinite.
    """

    solver = "superlu"

    def __init__(self, stiffness: Any, retained: NDArray[np.intp]) -> None:
        self._retained = retained
        # Powers of two scale without rounding: the rigid motions of K stay what they are.
        self._scale = 2.0 ** np.round(np.log2(unit_diagonal_scale(stiffness)))
        self._springs = SPRING / self._scale[retained] ** 2
        self.half_substitutions = self._responses = 0
        scaled = sp.csr_matrix(sp.diags(self._scale) @ stiffness @ sp.diags(self._scale))
        interior = np.setdiff1d(np.arange(scaled.shape[0]), retained)
        interior = interior[fill_reducing_order(scaled[interior][:, interior])]
        self._order = np.concatenate([interior, retained])
        matrix = sp.csc_matrix(scaled[self._order][:, self._order])
        self._factor, lifted = _factorise(matrix, len(interior))
        pivots, held = _pivots_and_trailing_block(self._factor, len(interior))
        before = matrix.diagonal()[: len(interior)]
        smallest = float(np.min(pivots / np.where(before > 0, before, 1.0)))
        refuse_negative(smallest)
        self.smallest_pivot = min(smallest, 0.0) if lifted else smallest
        held[np.diag_indices_from(held)] -= SPRING
        self.schur: Array = (held + held.T) / 2 / np.outer(self._scale[retained], self._scale[retained])

    def reduce(self, load: Vector) -> tuple[Vector, Vector]:
        right = load.copy()
        right[self._retained] = 0.0
        x = self._solve(right)
        return load[self._retained] + self._force(x[self._retained]), x

    def expand(self, retained: Vector, state: Vector) -> Vector:
        force = self._force(retained - state[self._retained])
        u = state + self._response(force)
        u[self._retained] = retained
        return u

    def expand_motions(self, retained: Array) -> Array:
        nothing = np.zeros(len(self._order))
        return np.column_stack([self.expand(column, nothing) for column in retained.T])

    def _response(self, force: Vector) -> Vector:
        """(K + T)^-1 of a force (p,) on the retained unknowns: once a few have been asked for, by its columns."""
        if 0 < len(force) <= FEW and self._responses > len(force):
            return np.asarray(self._columns @ force)
        self._responses += 1
        right = np.zeros(len(self._order))
        right[self._retained] = force
        return self._solve(right)

    @cached_property
    def _columns(self) -> Array:
        """(n, p) (K + T)^-1 on the retained unknowns."""
        unit = np.zeros((len(self._order), len(self._retained)))
        unit[self._retained] = np.eye(len(self._retained))
        return np.column_stack([self._solve(column) for column in unit.T])

    def _force(self, displacement: Vector) -> Vector:
        """(S + T) u_c."""
        return np.asarray(self.schur @ displacement + self._springs * displacement)

    def _solve(self, right: Vector) -> Vector:
        """(K + T)^-1 right."""
        self.half_substitutions += 2
        count_half_substitutions(2)
        solution = np.empty_like(right)
        solution[self._order] = self._factor.solve((self._scale * right)[self._order])
        return solution * self._scale


def _factorise(matrix: Any, interior: int) -> tuple[Any, bool]:
    """Factors of K + T in the order that it comes in, and whether K_ii had to be lifted off an exactly zero pivot."""
    from scipy.sparse.linalg import splu

    for lift in (0.0, LIFT * matrix.shape[0]):
        added = np.where(np.arange(matrix.shape[0]) < interior, lift, SPRING)
        try:
            factor = splu(sp.csc_matrix(matrix + sp.diags(added)), permc_spec="NATURAL", **DIAGONAL_PIVOTS)
        except RuntimeError:  # SuperLU's word for a zero pivot with nothing but zeros beneath
            continue
        if np.array_equal(factor.perm_r, factor.perm_c):  # else it took another pivot in place of one that is zero
            return factor, lift > 0
    raise InvalidProblem("stiffness: expected positive semidefinite, got a pivot of zero that no lift takes away")


def _pivots_and_trailing_block(factor: Any, interior: int) -> tuple[Vector, Array]:
    """The pivots (q,) of K_ii, and L_cc U_cc."""
    first, last = factor.perm_c[:interior], factor.perm_c[interior:]
    lower, upper = (triangle[:, last][last].toarray() for triangle in (factor.L, factor.U))
    pivots = factor.U.diagonal()[first]
    forget_triangles(factor)
    return pivots, lower @ upper
