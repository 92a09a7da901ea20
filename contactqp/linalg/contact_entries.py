"""The rows of one contact taken together: what its force vectors do at every unknown, and whether that is felt."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.linalg.measures import beyond, ratio
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Nothing


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

    def meets(self, meeting: Vector) -> NDArray[np.bool_]:
        """(m,) whether any force meets at an unknown of a contact."""
        return self.sums((meeting[self.unknown] > 0).astype(float)) > 0

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
    """Return the entries of the rows `normal` or `tangent`, computed once."""
    rows, made = getattr(problem, name), problem._computed.contact_entries
    if id(rows) not in made:
        made[id(rows)] = entries_of(rows, problem.contacts)
    entries: ContactEntries = made[id(rows)]
    return entries


def entries_of(rows: Any, contacts: int) -> ContactEntries:
    """Return the entries of CSR rows, as many rows for each of the contacts."""
    width = rows.shape[0] // contacts if contacts else 1
    row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
    places, at = np.unique(row // width * rows.shape[1] + rows.indices, return_inverse=True)
    values = np.zeros((width, len(places)))
    values[row % width, at] = rows.data
    return ContactEntries(places // rows.shape[1], places % rows.shape[1], values, contacts)


# Tangential rows of which this part of the normal row's compliance is left are the rounding of zero.
WEAK = 1e-16


def hardly_felt(normal: Vector, tangent: Array) -> NDArray[np.bool_]:
    """Which contacts have a tangential row that is rounding beside their normal one, or zero, (m,).

    `normal` (m,) and `tangent` (m, d-1) are the compliances of the rows, sum E_ij^2 / K_jj [length / force]; nothing is
    told of unknowns without stiffness.
    """
    return np.asarray(np.any((tangent < WEAK * normal[:, None]) & np.isfinite(tangent), axis=1))


def slips_that_are_nothing(none: Nothing, normal: Vector, tangent: Array) -> Nothing:
    """What is nothing, with the length of its normal row for the slip of a contact that is `hardly_felt`."""
    lengths_ = none.tangent.reshape(tangent.shape)
    along = np.maximum(lengths_, none.normal[:, None])
    return replace(none, tangent=np.where(hardly_felt(normal, tangent)[:, None], along, lengths_).ravel())


def vector_measure(entries: ContactEntries, force: Array, meeting: Vector, none: Vector) -> Vector:
    """max_j |E_i'v|_j / F_j of one force vector v (m, w) a contact; what is no more than `none` (n,) does not count."""
    acting = beyond(abs(entries.forces(force)), none[entries.unknown])
    return entries.largest(ratio(acting, meeting[entries.unknown])[None])
