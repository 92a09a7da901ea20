"""Contacts and ties as bounds on single unknowns, by a change of unknowns u = T w.

A row E_i that has an unknown p of its own, one that no other row touches, limits w_p = E_i u / E_ip alone:

    u_p = w_p - sum over j != p of (E_ij / E_ip) w_j,    u_j = w_j elsewhere,

so that 1/2 u'Ku - f'u over E_N u <= g, A u = b becomes 1/2 w'(T'KT)w - (T'f)'w over bounds on w, those of a tie equal.
Rows along one direction share their unknown. What is left of r = f - K u is the rows' force: (T'r)_p = r_p = E_ip l_i.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.formats import held_in_rows
from contactqp.distributed.iteration import stacked
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.rows import Rows
from contactqp.distributed.worst import said_of_first
from contactqp.errors import NoEquilibrium, Unsupported
from contactqp.model.arrays import Vector

Places = NDArray[np.intp]
NONE = -1


@dataclass(frozen=True, eq=False)
class BoundUnknowns:
    """The unknowns w of one problem. Everything is collective.

    Attributes
    ----------
    rows : Rows
        Contacts, then ties.
    pivot : (a,) array of int
        The column of each row's unknown p; NONE of rows that touch nothing.
    """

    problem: DistributedProblem
    rows: Rows
    pivot: Places

    @cached_property
    def _acting(self) -> Places:
        return np.flatnonzero(self.pivot != NONE)

    @cached_property
    def _entry(self) -> Vector:
        """(a,) E_ip; 1 of rows that touch nothing."""
        found, rows = np.ones(len(self.pivot)), self._acting
        found[rows] = np.asarray(self.rows.entries[rows, self.pivot[rows]]).ravel()
        return found

    @cached_property
    def _tightest(self) -> tuple[Places, Places]:
        """The row that limits each column from above, and the one that does from below; NONE where none does."""
        limit = np.concatenate([self.problem.gap, self.problem.tie_value]) / self._entry
        tie = np.arange(len(limit)) >= self.problem.contacts
        sides = []
        for sign in (1.0, -1.0):
            rows = self._acting[(tie | (sign * self._entry > 0))[self._acting]]
            last = np.lexsort((tie[rows], -sign * limit[rows]))  # of rows that write to one column the last one stays
            found = np.full(len(self.rows.touched), NONE)
            found[self.pivot[rows][last]] = rows[last]
            sides.append(found)
        return sides[0], sides[1]

    @cached_property
    def limits(self) -> tuple[Vector, Vector]:
        """Lower and upper bounds (n_here,) [length], infinite where nothing limits.

        Raises
        ------
        NoEquilibrium
            A lower bound is above its upper one.
        """
        limit = np.concatenate([self.problem.gap, self.problem.tie_value]) / self._entry
        upper, lower = (self._everywhere(row, limit[row]) for row in self._tightest)
        upper, lower = np.where(np.isnan(upper), np.inf, upper), np.where(np.isnan(lower), -np.inf, lower)
        with self.problem.ranks.together():
            if np.any(lower > upper):
                name = self.problem.dof_name(int(np.argmax(lower > upper)))
                raise NoEquilibrium(f"the constraints conflict at {name}")
        return lower, upper

    def _everywhere(self, row: Places, values: Vector) -> Vector:
        """Values (t,) of the columns that have a row, as a vector of all unknowns; NaN elsewhere."""
        there = row != NONE
        found = self.rows.spread(np.where(there, values, 0.0))
        return np.where(self.rows.spread(there.astype(float)) > 0, found, np.nan)

    @cached_property
    def change(self) -> Any:
        """T (n, n) as a PETSc.Mat; None where every row touches one unknown."""
        entries, ranks = self.rows.entries, self.problem.ranks
        length = np.diff(entries.indptr)
        first = [row for side in self._tightest for row in side[side != NONE] if length[row] > 1]
        if not ranks.any(len(first) > 0):
            return None
        PETSc, K = petsc(), self.problem.stiffness
        most = int(ranks.max(int(np.max(length, initial=1))))
        T = PETSc.Mat().createAIJ(size=K.getSizes(), nnz=(most, most), comm=K.comm)
        T.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        begin, end = K.getOwnershipRange()
        own = np.arange(begin, end, dtype=PETSc.IntType)
        T.setValuesCSR(np.arange(len(own) + 1, dtype=PETSc.IntType), own, np.ones(len(own)))
        T.assemble()
        for row in first:
            part = slice(entries.indptr[row], entries.indptr[row + 1])
            column, value = entries.indices[part], -entries.data[part] / self._entry[row]
            other = column != self.pivot[row]
            T.setValues(self.rows.touched[self.pivot[row]], self.rows.touched[column[other]], value[other])
        T.assemble()
        return T

    def stiffness(self) -> Any:
        """T'KT, a PETSc.Mat of its own."""
        K = held_in_rows(self.problem.stiffness)
        return K if self.change is None else K.PtAP(self.change)

    def force(self, force: Vector) -> Vector:
        """T'f."""
        return force if self.change is None else self._product(self.change.multTranspose, force)

    def displacement(self, w: Vector) -> Vector:
        """u = T w."""
        return w if self.change is None else self._product(self.change.mult, w)

    def _product(self, product: Any, values: Vector) -> Vector:
        at, into = self.problem.stiffness.createVecs()
        at.array[:] = values
        product(at, into)
        return np.array(into.array)

    def unknowns(self, displacement: Vector) -> Vector:
        """w = T^-1 u: at each p the length of its row, over E_ip."""
        length = self.rows.lengths(displacement) / self._entry
        above, below = self._tightest
        row = np.where(above != NONE, above, below)
        found = self._everywhere(row, length[row])
        return np.where(np.isnan(found), displacement, found)

    def forces(self, w: Vector, residual: Vector, diagonal: Vector) -> tuple[Vector, Vector]:
        """l (m_here,) and nu (k_here,) from T'(f - K u), with the diagonal of T'KT.

        A row presses where its force and its gap say so together, r + K_pp (w - bound) > 0 from above; of rows that
        share an unknown the tightest does.
        """
        force, at = np.zeros(len(self.pivot)), self.rows.near(residual)
        stretch = self.rows.near(diagonal) * self.rows.near(w)
        stiffness, limit = self.rows.near(diagonal), np.concatenate([self.problem.gap, self.problem.tie_value])
        for sign, row in zip((1.0, -1.0), self._tightest, strict=True):
            there = np.flatnonzero(row != NONE)
            rows, r = row[there], at[there]
            excess = r + stretch[there] - stiffness[there] * limit[rows] / self._entry[rows]
            presses = (sign * r > 0) & (sign * excess > 0)
            force[rows[presses]] = r[presses] / self._entry[rows[presses]]
        return force[: self.problem.contacts], force[self.problem.contacts :]


def bound_unknowns(problem: DistributedProblem, method: str) -> BoundUnknowns:
    """The unknowns that every contact and tie is a bound on. Collective.

    Raises
    ------
    Unsupported
        A contact or tie has no unknown of its own; the first one is named.
    """
    rows = stacked([problem.normal, problem.tie], problem.stiffness)
    rows.entries.eliminate_zeros()
    entries, ranks = rows.entries, problem.ranks
    leader = _leaders(entries)
    leads = leader == np.arange(len(leader))
    row = np.repeat(np.arange(len(leader)), np.diff(entries.indptr))
    often = np.bincount(entries.indices[leads[row]], minlength=len(rows.touched)).astype(float)
    private = (rows.near(rows.spread(often)) == 1)[entries.indices]
    size = np.where(private, abs(entries.data), 0.0)
    last = np.lexsort((-entries.indices, size))  # the largest, and of equals the first, is written last
    pivot = np.full(len(leader), NONE)
    pivot[row[last]] = np.where(private[last], entries.indices[last], NONE)
    lost = (pivot == NONE) & (np.diff(entries.indptr) > 0)
    pivot = pivot[leader]
    m = problem.contacts
    named = said_of_first(ranks, lost[:m], problem.contact_number, problem.contact_name) or said_of_first(
        ranks, lost[m:], problem.tie_number, problem.tie_name
    )
    if named is not None:
        raise Unsupported(
            f"{method} takes bounds on single unknowns; {named} limits several, and others limit each of them"
        )
    return BoundUnknowns(problem, rows, pivot)


def _leaders(entries: sp.csr_matrix) -> Places:
    """The first row along the direction of each row."""
    first: dict[bytes, int] = {}
    leader = np.arange(entries.shape[0])
    for i in leader:
        part = slice(entries.indptr[i], entries.indptr[i + 1])
        order = np.argsort(entries.indices[part])
        value = entries.data[part][order]
        # The row over its largest entry; of one and its opposite the quotients are equal to the last digit.
        scaled = value / value[np.argmax(abs(value))] if len(value) else value
        leader[i] = first.setdefault(entries.indices[part][order].tobytes() + scaled.tobytes(), i)
    return leader
