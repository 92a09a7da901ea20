"""The rows of contacts and ties as figures of answers need them, laid out once for a stiffness and its rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem


@dataclass(frozen=True, eq=False)
class RowSizes:
    """What rows E are apart from their signs."""

    size: Any  # |E|
    transposed: Any  # |E|'
    compliance: Vector  # |E_i D|^2, D = 1/sqrt(K_jj) [length / force]


def row_sizes(problem: ContactProblem, rows: Any) -> RowSizes:
    """Those of rows with as many columns as the problem has unknowns; its own are laid out once."""
    for name in ("normal", "tangent", "tie"):
        if rows is getattr(problem, name):
            key = f"sizes_of_{name}"
            if key not in problem._shared:
                problem._shared[key] = sizes_of(rows, problem.diagonal)
            made: RowSizes = problem._shared[key]
            return made
    return sizes_of(rows, problem.diagonal)


def sizes_of(rows: Any, diagonal: Vector) -> RowSizes:
    """Those of rows over unknowns with these entries K_jj."""
    compliance = np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0)
    size = abs(rows)
    squares = size.copy()
    squares.data **= 2
    return RowSizes(size, size.T, np.asarray(squares @ compliance))


@dataclass(frozen=True, eq=False)
class ContactEntries:
    """The entries of the w rows of every contact, at every unknown that one of them touches."""

    contact: NDArray[np.intp]  # (z,)
    unknown: NDArray[np.intp]  # (z,)
    values: NDArray[np.float64]  # (w, z)
    contacts: int

    def over(self, meeting: Vector) -> NDArray[np.float64]:
        """E_ij / F_j (w, z); where no force meets, and so none acts, as much as the contact's largest."""
        F = meeting[self.unknown]
        scaled = np.divide(self.values, F, out=np.zeros_like(self.values), where=F > 0)
        if not np.all(F > 0):
            largest = self.largest(scaled)
            idle = np.where(largest > 0, largest, 1.0)[self.contact] * np.sign(self.values)
            scaled = np.where(F > 0, scaled, idle)
        return scaled

    def largest(self, values: NDArray[np.float64]) -> Vector:
        """The largest size (m,) of values (w, z), contact by contact."""
        found = np.zeros(self.contacts)
        np.maximum.at(found, self.contact, np.max(abs(values), axis=0))
        return found

    def sums(self, values: NDArray[np.float64]) -> Vector:
        """Sums (m,) of (z,) values, contact by contact."""
        return np.asarray(np.bincount(self.contact, weights=values, minlength=self.contacts), dtype=float)

    def forces(self, force: NDArray[np.float64]) -> NDArray[np.float64]:
        """E_i'v (z,) of one vector v (m, w) a contact."""
        return np.asarray(np.sum(self.values * force.T[:, self.contact], axis=0))


def contact_entries(problem: ContactProblem, name: str) -> ContactEntries:
    """Those of `normal` or `tangent`, laid out once for the rows."""
    key = f"entries_of_{name}"
    if key not in problem._shared:
        problem._shared[key] = entries_of(getattr(problem, name), problem.contacts)
    entries: ContactEntries = problem._shared[key]
    return entries


def entries_of(rows: Any, contacts: int) -> ContactEntries:
    """Those of rows in CSR, as many for each of the contacts."""
    width = rows.shape[0] // contacts if contacts else 1
    row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
    places, at = np.unique(row // width * rows.shape[1] + rows.indices, return_inverse=True)
    values = np.zeros((width, len(places)))
    values[row % width, at] = rows.data
    return ContactEntries(places // rows.shape[1], places % rows.shape[1], values, contacts)
