"""Elimination of the interior unknowns i, retained unknowns c: what condensation factorises.

    S = K_cc - K_ci K_ii^-1 K_ic,    f_S = f_c - K_ci K_ii^-1 f_i,    u_i = K_ii^-1 (f_i - K_ic u_c)

Three ways with one interface, two of which factorise K with the retained unknowns last and find S at the end of the
factors: MKL PARDISO (`pardiso`) and SciPy's SuperLU (`trailing_block`). The third factorises K_ii alone and solves once
for every retained unknown.
"""

from __future__ import annotations

import os
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, Unsupported
from contactqp.linalg.factorization import DENSE_SIZE, Factorization, factorise
from contactqp.linalg.pardiso import NotPositive, Pardiso, available
from contactqp.linalg.stages import count_half_substitutions
from contactqp.linalg.trailing_block import TrailingBlock
from contactqp.model.arrays import Array, Vector

# Right-hand sides of one block of back-substitutions: bounds the memory of K_ii^-1 K_ic.
BLOCK = 64
# Up to so many interior unknowns for each retained one S comes from back-substitutions. The dense block where SuperLU
# eliminates the retained unknowns cost 2.5 to 6 times as much at one to one, 0.7 to 2 times at three to one.
FEW = 4
# From here on a sparse factorisation with PARDISO pays for loading it.
LARGE = 2000
# The variable of the environment that chooses the sparse solver; the fastest by default. With
# "pyamg" nothing is eliminated (`iteration`), unless a caller asks for it.
CHOICE = "CONTACTQP_SPARSE_SOLVER"
SOLVERS = ("superlu", "pardiso")
CHOICES = (*SOLVERS, "pyamg")


class Elimination(Protocol):
    """Factors of K_ii and what they leave."""

    solver: str  # whose factors they are
    schur: Array  # (p, p) S
    smallest_pivot: float  # of K_ii with a diagonal of ones
    half_substitutions: int  # forward or backward, with one right-hand side

    def reduce(self, load: Vector) -> tuple[Vector, Vector]:
        """f_S (p,), and what `expand` needs of the load."""

    def expand(self, retained: Vector, state: Vector) -> Vector:
        """u (n,) from u_c and the load that was reduced."""

    def expand_motions(self, retained: Array) -> Array:
        """u (n, q) without a load from several u_c (p, q)."""


class BackSubstitution:
    """S from factors of K_ii alone, column by column: for an interior that is small or a few times what is retained."""

    solver = "superlu"

    def __init__(self, stiffness: Any, retained: NDArray[np.intp]) -> None:
        self._retained = retained
        self._interior = np.setdiff1d(np.arange(stiffness.shape[0]), retained)
        self._coupling = stiffness[self._interior][:, retained]
        self._factor: Factorization | None = None
        self.half_substitutions = 0
        if self._interior.size:
            self._factor = factorise(stiffness[self._interior][:, self._interior])
        self.smallest_pivot = 1.0 if self._factor is None else self._factor.smallest_pivot
        self.schur = self._schur_complement(stiffness)

    def _schur_complement(self, stiffness: Any) -> Array:
        S = stiffness[self._retained][:, self._retained].toarray()
        for start in range(0, len(self._retained), BLOCK):
            columns = slice(start, start + BLOCK)
            right = self._coupling[:, columns].toarray()
            S[:, columns] -= self._coupling.T @ self._solve(right)
        return np.asarray((S + S.T) / 2)

    def _solve(self, right: Array) -> Array:
        if self._factor is None:
            return np.zeros_like(right)
        count = 2 * (1 if right.ndim == 1 else right.shape[1])
        self.half_substitutions += count
        count_half_substitutions(count)
        return self._factor.solve(right)

    def reduce(self, load: Vector) -> tuple[Vector, Vector]:
        inner = self._solve(load[self._interior])
        return load[self._retained] - self._coupling.T @ inner, inner

    def expand(self, retained: Vector, state: Vector) -> Vector:
        u = np.empty(len(self._retained) + len(self._interior))
        u[self._retained] = retained
        u[self._interior] = state - self._solve(self._coupling @ retained)
        return u

    def expand_motions(self, retained: Array) -> Array:
        u = np.empty((len(self._retained) + len(self._interior), retained.shape[1]))
        u[self._retained] = retained
        u[self._interior] = -self._solve(self._coupling @ retained)
        return u


class LastBlock:
    """S as PARDISO leaves it; half a back-substitution reduces a load, the other half expands a displacement."""

    solver = "pardiso"

    def __init__(self, stiffness: Any, retained: NDArray[np.intp]) -> None:
        self._retained = retained
        self._factor = Pardiso(stiffness, retained)
        self.smallest_pivot = self._factor.smallest_pivot
        self.schur = self._factor.schur
        self.half_substitutions = 0

    def reduce(self, load: Vector) -> tuple[Vector, Vector]:
        self.half_substitutions += 1
        count_half_substitutions(1)
        eliminated = self._factor.forward(load)
        return eliminated[self._retained], eliminated

    def expand(self, retained: Vector, state: Vector) -> Vector:
        self.half_substitutions += 1
        count_half_substitutions(1)
        right = state.copy()
        right[self._retained] = retained
        return self._factor.backward(right)

    def expand_motions(self, retained: Array) -> Array:
        self.half_substitutions += retained.shape[1]
        count_half_substitutions(retained.shape[1])
        right = np.zeros((self._factor.size, retained.shape[1]))
        right[self._retained] = retained
        return self._factor.backward(right)


def eliminate(stiffness: Any, retained: NDArray[np.intp], singular: bool = True) -> Elimination:
    """The fastest way that there is for a stiffness (n, n) CSR and unknowns (p,) to retain.

    Raises
    ------
    NotPositive
        The interior is singular, as far as PARDISO can tell; only where `singular` is False: SuperLU has its pivots,
        and takes much longer.
    InvalidProblem
        The environment names a solver that is none.
    Unsupported
        S does not fit into memory.
    """
    try:
        return _eliminate(stiffness, retained, singular)
    except MemoryError:
        count = len(retained)
        size = f"{count**2 * np.dtype(float).itemsize / 2**30:.0f} GiB"
        raise Unsupported(
            f"{count} unknowns at contacts and ties that may act: their dense stiffness takes {size}, and memory is "
            "full"
        ) from None


def _eliminate(stiffness: Any, retained: NDArray[np.intp], singular: bool) -> Elimination:
    chosen = os.environ.get(CHOICE, "")
    if chosen and chosen not in CHOICES:
        raise InvalidProblem(f"{CHOICE}: expected one of {', '.join(CHOICES)}, got {chosen!r}")
    interior = np.ones(stiffness.shape[0], dtype=bool)
    interior[retained] = False
    count = np.count_nonzero(interior)
    wanted = count >= LARGE and available() if chosen in ("", "pyamg") else chosen == "pardiso" and count > 0
    if wanted and np.all(stiffness.diagonal()[interior] > 0):
        try:
            return LastBlock(stiffness, retained)
        except NotPositive:  # whether it is indefinite is for the pivots of the other way to tell
            if not singular:
                raise
    pays = count > max(DENSE_SIZE, FEW * len(retained))
    return (TrailingBlock if pays else BackSubstitution)(sp.csr_matrix(stiffness), retained)
