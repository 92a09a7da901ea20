"""The projections of `contactqp.linalg.krylov`, of rows that stand on many ranks.

Rows that share no unknown with others, nodes on rigid obstacles, are solved for one by one where they are. Where rows
share unknowns on one rank alone, as the normal and the tangents of such a node may, their Gram matrix E D^-1 E' is
factorised there. That of others is factorised on every rank, which needs what all held rows touch, a surface, on each.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.ranks import Ranks
from contactqp.distributed.rows import Rows
from contactqp.linalg.krylov import IndependentRows
from contactqp.model.arrays import Vector


class Gram(Protocol):
    """(E D^-1 E')^-1."""

    def solve(self, lengths: Vector) -> Vector:
        """The forces on the rows of this rank, (a,), that cause the lengths (a,)."""


class SeparateGram:
    """Of rows that share no unknowns."""

    def __init__(self, entries: sp.csr_matrix, compliance: Vector) -> None:
        own = entries.multiply(entries) @ compliance
        self._stiffness = np.divide(1.0, own, out=np.zeros_like(own), where=own > 0)

    def solve(self, lengths: Vector) -> Vector:
        """Row by row."""
        return np.asarray(self._stiffness * lengths)


class SharedGram:
    """Of any rows, on every rank. Making it and solving is collective."""

    def __init__(self, ranks: Ranks, entries: sp.csr_matrix, touched: NDArray[np.intp], compliance: Vector) -> None:
        self._ranks = ranks
        rows = entries.tocoo()
        self._mine = slice(first := ranks.first(entries.shape[0]), first + entries.shape[0])
        count = ranks.sum(entries.shape[0])
        unknown, place = np.unique(ranks.gathered(touched[rows.col]), return_inverse=True)
        row, value = ranks.gathered(rows.row + first), ranks.gathered(rows.data)
        diagonal = np.zeros(len(unknown))
        diagonal[place.ravel()] = ranks.gathered(compliance[rows.col])
        whole = sp.coo_matrix((value, (row, place.ravel())), shape=(count, len(unknown)))
        self._gram = IndependentRows(sp.csr_matrix(whole), diagonal)

    def solve(self, lengths: Vector) -> Vector:
        """From the lengths of all ranks."""
        return self._gram.solve(self._ranks.gathered(lengths))[self._mine]


def gram_of(ranks: Ranks, entries: sp.csr_matrix, touched: NDArray[np.intp], compliance: Vector, meeting: str) -> Gram:
    """What solves for the forces on rows that meet as `meets` says. Collective."""
    if meeting == SEPARATE:
        return SeparateGram(entries, compliance)
    if meeting == HERE:
        return IndependentRows(entries, compliance)
    return SharedGram(ranks, entries, touched, compliance)


def meets(ranks: Ranks, rows: Rows) -> str:
    """Whether rows share unknowns, and with whom. Collective."""
    often = np.bincount(rows.entries.indices, minlength=len(rows.touched)).astype(float)
    if not ranks.any(rows.spread(often) > 1):
        return SEPARATE
    return ACROSS if ranks.any(rows.spread((often > 0).astype(float)) > 1) else HERE


# Rows share no unknown, or only with rows of their own rank, or with those of others too.
SEPARATE, HERE, ACROSS = "separate", "here", "across"


class DistributedHeldRows:
    """Rows held at limits; everything here is collective.

    Parameters
    ----------
    rows : Rows
    entries : (a, t) CSR matrix
        Those of this rank that are held, over what `rows` touches.
    limit : (a,) array [length]
    compliance : (t,) array
        1/K_jj of what the rows touch.
    gram : Gram
        Of the held rows.
    """

    def __init__(self, rows: Rows, entries: sp.csr_matrix, limit: Vector, compliance: Vector, gram: Gram) -> None:
        self._rows, self._limit, self._compliance, self._gram = rows, limit, compliance, gram
        self._entries = entries

    def _moved(self, force: Vector) -> Vector:
        """D^-1 E'l."""
        return self._rows.spread(self._compliance * (self._entries.T @ force))

    def _lengths(self, x: Vector) -> Vector:
        return np.asarray(self._entries @ self._rows.near(x))

    def close(self, x: Vector) -> None:
        """Move x so that E x = g, in place."""
        x += self._moved(self._gram.solve(self._limit - self._lengths(x)))

    def admit(self, z: Vector) -> None:
        """Take out of z what moves the rows, in place."""
        z -= self._moved(self._gram.solve(self._lengths(z)))

    def forces(self, r: Vector) -> Vector:
        """(a,) l, zero on dependent rows."""
        return self._gram.solve(self._entries @ (self._compliance * self._rows.near(r)))

    def balanced(self, r: Vector) -> Vector:
        """What the forces on the rows leave of r."""
        return np.asarray(r - self._rows.spread(self._entries.T @ self.forces(r)))
