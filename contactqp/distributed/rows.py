"""Rows E over the unknowns of all ranks: each stands on one rank, what it touches may stand on others."""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.model.arrays import Vector


class Rows:
    """The rows of one rank. Making them is collective, and so are `lengths` and `forces`.

    Parameters
    ----------
    entries : (a, t) sparse matrix
    touched : (t,) array of int
        The unknowns of all ranks that the columns stand for, in PETSc's numbering, each once.
    like : PETSc.Mat
        K: it says which rank has which unknowns.
    """

    def __init__(self, entries: Any, touched: NDArray[np.int64], like: Any) -> None:
        PETSc = petsc()
        self.entries = sp.csr_matrix(entries)
        self.touched = np.asarray(touched, dtype=PETSc.IntType)
        self.like = like
        self._everywhere = like.createVecRight()
        self._here = PETSc.Vec().createSeq(len(self.touched), comm=PETSc.COMM_SELF)
        there = PETSc.IS().createGeneral(self.touched, comm=PETSc.COMM_SELF)
        self._scatter = PETSc.Scatter().create(self._everywhere, there, self._here, None)

    @classmethod
    def over_touched(cls, rows: Any, like: Any) -> Rows:
        """Of CSR rows over the unknowns of all ranks. Collective."""
        touched, place = np.unique(rows.indices, return_inverse=True)
        shape = (len(rows.indptr) - 1, len(touched))
        return cls(sp.csr_matrix((rows.data, place.ravel(), rows.indptr), shape=shape), touched, like)

    def standing(self, entries: Any) -> Rows:
        """Other rows over the same unknowns; not collective."""
        other = copy(self)
        other.entries = sp.csr_matrix(entries)
        return other

    @property
    def count(self) -> int:
        """a."""
        return int(self.entries.shape[0])

    def near(self, x: Vector) -> Vector:
        """(t,) the values of x at what the rows of this rank touch."""
        self._everywhere.array[:] = x
        self._scatter.scatter(self._everywhere, self._here, addv=False, mode="forward")
        return np.array(self._here.array)

    def spread(self, values: Vector) -> Vector:
        """The sum over the ranks of values (t,) at what their rows touch, as a vector of all unknowns."""
        self._here.array[:] = values
        self._everywhere.set(0.0)
        self._scatter.scatter(self._here, self._everywhere, addv=True, mode="reverse")
        return np.array(self._everywhere.array)

    def lengths(self, x: Vector) -> Vector:
        """(a,) E x."""
        return np.asarray(self.entries @ self.near(x))

    def forces(self, force: Vector) -> Vector:
        """E'l."""
        return self.spread(self.entries.T @ force)

    def matrix(self, scale: Vector | None = None) -> Any:
        """E, its columns scaled by a vector over all unknowns, as PETSc.Mat. Collective."""
        PETSc = petsc()
        entries = self.entries if scale is None else sp.csr_matrix(self.entries.multiply(self.near(scale)[None, :]))
        n = self._everywhere.getSizes()
        indices = self.touched[entries.indices]
        csr = (entries.indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), entries.data)
        return PETSc.Mat().createAIJ(size=((self.count, None), n), csr=csr, comm=self._everywhere.comm)
