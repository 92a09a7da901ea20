"""The preconditioner z = M r, one symmetric V-cycle on a hierarchy of levels with constrained rows.

Constrained rows E (closed contacts, ties) are represented by springs C of the size of K,

    K + E'CE,    on the coarse levels    K_coarse + (E P)'C (E P),    and so on down:

a change of few entries, so that one hierarchy is used for every set of closed contacts. Where E u = 0 both stiffnesses
are the same. With K_ii of the unknowns without rows and K_bb of the constrained ones, and E'CE >= s K_bb there, the
Schur complement K_ii - K_ib (K_bb + E'CE)^-1 K_bi >= s/(1 + s) K_ii: the inverse of the second stiffness, restricted,
lies within a factor 1 + 1/s of the inverse of K_ii, on any mesh. Without C that factor grows as the mesh is refined.

M is symmetric positive definite, and the eigenvalues of M K lie in (0, 1], since the same polynomial smooths before and
after the coarse correction and its interval ends beyond the spectrum.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import copy
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.multigrid import (
    CoarsestLevel,
    HeldCoarsestLevel,
    Hierarchy,
    Level,
    block_size,
    largest_eigenvalue,
)
from contactqp.model.arrays import Array, Indices, Mask

# Terms of the Chebyshev polynomial on the finest level and on the coarser ones, which cost little, and the part of the
# spectrum of D^-1 K, from its end, that it damps.
FINE_TERMS, COARSE_TERMS, DAMPED = 2, 6, 1 / 10
# C over 1/(E D^-1 E'). On blocks of 100 000 to 350 000 unknowns 5, 10 and 20 were equal to one step of 18 to 20; 1 and
# 100 took a third more, 10000 and 0 twice as many.
HOLDING = 10.0


class HeldLevel(ABC):
    """One level with springs on the constrained rows: K + E'CE, its diagonal and largest eigenvalue."""

    diagonal: Array
    largest: float

    @abstractmethod
    def product(self, x: Array) -> Array:
        """Return the forces (K + E'CE) x of a displacement."""

    @abstractmethod
    def restricted(self, r: Array) -> Array:
        """Return P'r, a force on the next coarser level."""

    @abstractmethod
    def prolonged(self, z: Array) -> Array:
        """Return P z, a displacement of the next coarser level on this one."""

    def smooth(self, r: Array, terms: int) -> tuple[Array, Array, Array]:
        """Apply Chebyshev's polynomial from zero (Saad 2003, algorithm 12.1).

        Returns z, the last step, and the residual before it.
        """
        middle, half = (1 + DAMPED) / 2 * self.largest, (1 - DAMPED) / 2 * self.largest
        sigma = middle / half
        rho = 1 / sigma
        step = self.scaled(r)
        step /= middle
        z = step.copy()
        for _ in range(terms - 1):
            r = r - self.product(step)
            rho, before = 1 / (2 * sigma - rho), rho
            step *= rho * before
            step += (2 * rho / half) * self.scaled(r)
            z += step
        return z, step, r

    def scaled(self, r: Array) -> Array:
        """Return D^-1 r, D being the diagonal or blocks on it."""
        return np.asarray(r / self.diagonal)


class VCycle:
    """The preconditioner M of K + E'CE, from its levels, the finest first, and the inverse on the coarsest one."""

    def __init__(self, levels: Sequence[HeldLevel], coarsest: Callable[[Array], Array]) -> None:
        self._levels, self._coarsest = levels, coarsest

    def __call__(self, r: Array) -> Array:
        return self._cycle(0, r)

    def _cycle(self, depth: int, r: Array) -> Array:
        if depth == len(self._levels):
            return self._coarsest(r)
        here, terms = self._levels[depth], COARSE_TERMS if depth else FINE_TERMS
        z, step, left = here.smooth(r, terms)
        left = left - here.product(step)
        correction = here.prolonged(self._cycle(depth + 1, here.restricted(left)))
        z += correction
        left -= here.product(correction)
        more, _, _ = here.smooth(left, terms)
        z += more
        return z


class LevelRows(NamedTuple):
    """Rows on one level."""

    entries: Any  # (a, unknowns it touches) CSR
    columns: Indices  # which unknowns these are


class HeldHierarchy:
    """A hierarchy with all rows that may be constrained on every level: E, E P, E P P, ... of rows (a, n).

    The unknowns `afloat` (n,) are those of floating bodies, None if there are none.
    """

    def __init__(self, hierarchy: Hierarchy, rows: Any, afloat: Mask | None = None) -> None:
        self.levels, self.rows = hierarchy.levels, []
        E = sp.csr_matrix(rows)
        for level in self.levels:
            columns = np.unique(E.indices).astype(np.intp)
            self.rows.append(LevelRows(sp.csr_matrix(E[:, columns]), columns))
            if level.prolong is not None:
                E = self.rows[-1].entries @ sp.csr_matrix(sp.csr_matrix(level.prolong)[columns])
                if afloat is not None:
                    afloat = abs(level.restrict) @ afloat > 0
        self.coarsest = CoarsestLevel(self.levels[-1].matrix, self.rows[-1].columns, afloat)

    def of_rows(self, chosen: Indices) -> HeldHierarchy:
        """Return the hierarchy with some of the rows only."""
        other = copy(self)
        other.rows = [LevelRows(row.entries[chosen], row.columns) for row in self.rows]
        return other

    def cycle(self, held: Indices, sprung: sp.csr_matrix | None = None) -> VCycle:
        """Return the preconditioner M of K + E'CE, E being the rows `held` (h,).

        With `sprung` (s, a) the springs F'F are added to the stiffness, F being `sprung` times all rows.
        """
        E, columns = self.rows[0]
        strength = held_strength(E[held].multiply(E[held]) @ (1 / self.levels[0].diagonal[columns]))
        rows = [LevelRows(_springs(row.entries, held, strength, sprung), row.columns) for row in self.rows]
        levels = [_HeldLevel(*parts) for parts in zip(self.levels[:-1], rows[:-1], strict=True)]
        on_coarsest = rows[-1].entries
        return VCycle(levels, HeldCoarsestLevel(self.coarsest, (on_coarsest.T @ on_coarsest).toarray()).solve)


def _springs(rows: Any, held: Indices, strength: Array, sprung: sp.csr_matrix | None) -> Any:
    """Return the constrained rows of (a, unknowns) times the roots of their stiffness, and `sprung` times all rows."""
    some = rows[held]
    entries = some.data * np.repeat(strength, np.diff(some.indptr))
    springs = sp.csr_matrix((entries, some.indices, some.indptr), some.shape)
    return springs if sprung is None else sp.vstack([springs, sprung @ rows], format="csr")


def held_strength(compliance: Array) -> Array:
    """Return sqrt(C) of rows with compliance E D^-1 E' (a,), zero for rows of zeros."""
    return np.sqrt(np.divide(HOLDING, compliance, out=np.zeros_like(compliance), where=compliance > 0))


class _HeldLevel(HeldLevel):
    """One level in one process. Where K comes in blocks, D has the springs in blocks of one node.

    A spring that is not along an axis then stiffens a node along itself only. On the diagonal it would stiffen the node
    in every direction, and strong springs, as of small slips that turn, would keep the smoother from moving it at all.
    """

    def __init__(self, level: Level, added: LevelRows) -> None:
        self._level, self._added, self._spread = level, added, added.entries.T  # transposed once, not in every product
        self.diagonal, self.largest = level.diagonal, level.largest
        self._springs: _NodalSprings | None = None
        if added.entries.nnz:
            self._springs = _NodalSprings(added, level.diagonal, block_size(level.matrix))
            self.diagonal = self._springs.diagonal
            # An upper bound, as no eigenvalue of a sum exceeds those of both parts relative to their blocks.
            self.largest = max(self.largest, self._springs.largest)

    def scaled(self, r: Array) -> Array:
        z = super().scaled(r)
        if self._springs is not None:
            self._springs.scale_skew(r, z)
        return z

    def product(self, x: Array) -> Array:
        y = self._level.product(x)
        entries, columns = self._added
        if entries.shape[0]:
            y[columns] += self._spread @ (entries @ x[columns])
        return y

    def restricted(self, r: Array) -> Array:
        return np.asarray(self._level.restrict @ r)

    def prolonged(self, z: Array) -> Array:
        return np.asarray(self._level.prolong @ z)


# Added to blocks of springs, which are singular, relative to the stiffest spring of their node.
REGULAR = 1e-8


class _NodalSprings:
    """The blocks of E'CE at the nodes that it touches, added to the diagonal of K there.

    Attributes
    ----------
    diagonal : (n,) array, that of the sum
    largest : a bound of the eigenvalues of E'CE relative to its blocks; one where every row touches one node
    """

    def __init__(self, added: LevelRows, diagonal: Array, size: int) -> None:
        nodes, place = np.unique(added.columns // size, return_inverse=True)
        rows = _by_node(added, size * place.ravel() + added.columns % size, len(nodes), size)
        e, blocks = rows.data[:, 0], np.zeros((len(nodes), size, size))
        for i, j in np.ndindex(size, size):
            blocks[:, i, j] = np.bincount(rows.indices, e[:, i] * e[:, j], len(nodes))
        own, at = np.diagonal(blocks, axis1=1, axis2=2), diagonal.reshape(-1, size)[nodes]
        unknowns = size * nodes[:, None] + np.arange(size)
        self.diagonal = diagonal.copy()
        self.diagonal[unknowns] += own
        self.largest = 1.0 if np.max(np.diff(rows.indptr), initial=0) <= 1 else _largest(rows, blocks, at)
        skew = np.count_nonzero(blocks, axis=(1, 2)) > np.count_nonzero(own, axis=1)
        self._unknowns = unknowns[skew].ravel()
        self._inverse = np.linalg.inv((blocks + at[:, :, None] * np.eye(size))[skew])

    def scale_skew(self, r: Array, z: Array) -> None:
        """Set D^-1 r at the nodes with springs that are not along an axis, in place of z there."""
        near = r[self._unknowns].reshape(self._inverse.shape[:2])[:, :, None]
        z[self._unknowns] = (self._inverse @ near).ravel()


def _by_node(added: LevelRows, column: Indices, count: int, size: int) -> Any:
    """Return rows as blocks (1, size), one for each node that a row touches."""
    E = added.entries
    return sp.csr_matrix((E.data, column[E.indices], E.indptr), (E.shape[0], size * count)).tobsr((1, size))


def _largest(rows: Any, blocks: Array, diagonal: Array) -> float:
    """Return the largest eigenvalue of E'CE relative to its blocks (count, size, size)."""
    size = blocks.shape[1]
    stiffest = np.max(np.diagonal(blocks, axis1=1, axis2=2) / diagonal, axis=1)
    lift = np.where(stiffest > 0, REGULAR * stiffest, 1.0)[:, None] * diagonal
    inverse, spread = np.linalg.inv(blocks + lift[:, :, None] * np.eye(size)), rows.T

    def product(v: Array) -> Array:
        return np.asarray(rows @ (inverse @ (spread @ v).reshape(-1, size, 1)).ravel())

    return largest_eigenvalue(product, np.ones(rows.shape[0]))
