"""The protocols by which a large deformation knows a body and its contacts, and bodies with supports.

Any code can meet the protocols `Deformable` and `ContactGeometry`. A body some of whose unknowns are supported is again
a deformable body, of the free unknowns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.elements.scalars import real_array, real_number
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index, Vector, computes
from contactqp.model.problem_data import ReadOnly, is_whole, read_only


@runtime_checkable
class Deformable(Protocol):
    """A body with an energy: its force is the gradient and its tangent the Hessian of that energy.

    Where the body cannot be (an element turned inside out) `energy` is inf and the two others raise InvalidProblem,
    which names the place.
    """

    @property
    def dimension(self) -> int:
        """Return the number of unknowns n."""

    def energy(self, displacement: Vector) -> float:
        """Return the elastic energy [force * length], zero at rest."""

    def internal_force(self, displacement: Vector) -> Vector:
        """Return the gradient of the energy (n,) [force]: the loads that hold the body there."""

    def tangent(self, displacement: Vector) -> Any:
        """Return the Hessian of the energy (n, n), sparse or dense, symmetric [force / length]."""


@dataclass(frozen=True, eq=False)
class ContactState:
    """The contacts at one displacement; to first order E_N (u_new - u) <= gap and slip E_T (u_new - u).

    Attributes
    ----------
    gap : (m,) array
        The gaps now, positive when open [length].
    normal : (m, n) sparse array
        E_N = -d gap / d u, now.
    tangent : ((d-1) m, n) sparse array, or None
        E_T, contact-major, now.
    rounding : (m,) array
        What rounding may make of the gaps [length].
    """

    gap: Vector
    normal: Any
    tangent: Any
    rounding: Vector


@runtime_checkable
class ContactGeometry(Protocol):
    """The contacts of a body in its current configuration."""

    @property
    def contacts(self) -> int:
        """Return the number of contacts m."""

    def state(self, displacement: Vector) -> ContactState:
        """Return gaps and rows at a displacement; InvalidProblem where a contact has lost its pair."""

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Return minus the sum over the contacts of l_N times the Hessian of the gap, (n, n) [force / length], or
        None where it is not known.

        It is what the contact forces add to the tangent as their directions turn. Without it Newton's method converges
        linearly wherever the obstacle is curved.
        """

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Return how far each contact has moved from its anchor (m, d) along the current tangents, (m, d-1)
        [length].
        """

    def positions(self, displacement: Vector) -> Vector:
        """Return where the contacts are, (m, d) [length]: anchors of a slip."""


@computes
@dataclass(frozen=True, eq=False)
class Supported(ReadOnly):
    """A body with supports: unknown j is unknown free[j] of the body, the others keep their values.

    Parameters
    ----------
    body : Deformable
    held : array of int, or mapping of int to float
        Places in the u of the body that are held, at zero or at a given displacement [length].

    Raises
    ------
    InvalidProblem
        A place that is none, or everything held.

    Examples
    --------
    >>> from contactqp.elements.nonlinear_truss import NonlinearTruss
    >>> bar = Supported(NonlinearTruss([[0, 0], [1, 0]], [[0, 1]], 1.0, 1.0), held=[0, 1])
    >>> bar.dimension, bar.internal_force([0.2, 0.5]).round(15).tolist()
    (2, [0.414, 0.1725])
    """

    body: Deformable
    held: Any

    def __post_init__(self) -> None:
        values = dict(self.held) if isinstance(self.held, Mapping) else dict.fromkeys(np.ravel(self.held).tolist(), 0.0)
        n = self.body.dimension
        for place, value in values.items():
            if not is_whole(place) or not 0 <= place < n:
                raise InvalidProblem(f"held: expected places from 0 to {n - 1}, got {place!r}")
            real_number(f"held: displacement of place {place}", value)
        if len(values) == n:
            raise InvalidProblem("held: every unknown is; expected some that are free")
        object.__setattr__(self, "held", values)

    @cached_property
    def free(self) -> Index:
        """Return the place in the body's u of each free unknown, ascending."""
        return read_only(np.setdiff1d(np.arange(self.body.dimension), list(self.held)).astype(np.int64))

    @property
    def dimension(self) -> int:
        """Return the number of free unknowns."""
        return len(self.free)

    def expand(self, displacement: ArrayLike) -> Vector:
        """Return the u of the body from that of the free unknowns."""
        u = np.zeros(self.body.dimension)
        u[list(self.held)] = list(self.held.values())
        u[self.free] = _of("displacement", displacement, self.dimension)
        return u

    def restrict(self, load: ArrayLike) -> Vector:
        """Return the loads on the free unknowns from those on all of the body's."""
        return _of("load", load, self.body.dimension)[self.free]

    def energy(self, displacement: ArrayLike) -> float:
        """Return the strain energy of the body at these displacements [force * length]."""
        return self.body.energy(self.expand(displacement))

    def internal_force(self, displacement: ArrayLike) -> Vector:
        """Return the gradient of the energy at the free unknowns [force]."""
        return np.asarray(self.body.internal_force(self.expand(displacement))[self.free])

    def tangent(self, displacement: ArrayLike) -> Any:
        """Return the Hessian of the energy at the free unknowns, CSC [force / length]."""
        return sp.csc_array(sp.csr_array(self.body.tangent(self.expand(displacement)))[self.free][:, self.free])

    def support_forces(self, displacement: ArrayLike) -> Vector:
        """Return what the supports do to the body, (n of the body,) [force]: forces at supported unknowns, zero at
        free ones.

        Loads and contact forces that act on held unknowns go straight into the supports and are not in it.
        """
        force = self.body.internal_force(self.expand(displacement)).copy()
        force[self.free] = 0.0
        return force

    def contact(self, geometry: ContactGeometry) -> SupportedContact:
        """Return a contact geometry over the body's unknowns as one over the free unknowns.

        Raises
        ------
        InvalidProblem
            It is over another number of unknowns.
        """
        over = getattr(geometry, "dimension", self.body.dimension)
        if over != self.body.dimension:
            raise InvalidProblem(
                f"contact: expected rows over the {self.body.dimension} unknowns of the body, got "
                f"{over}; state dimension={self.body.dimension} where it is made"
            )
        return SupportedContact(self, geometry)


def _of(what: str, values: ArrayLike, size: int) -> Vector:
    read = real_array(what, values)
    if read.shape != (size,):
        raise InvalidProblem(f"{what}: expected shape ({size},), got {read.shape}")
    return read


@computes
@dataclass(frozen=True, eq=False)
class SupportedContact:
    """Contacts of a supported body: only the free unknowns move them."""

    support: Supported
    geometry: ContactGeometry

    @property
    def contacts(self) -> int:
        """Return the number of contacts m."""
        return self.geometry.contacts

    @property
    def dimension(self) -> int:
        """Return the number of free unknowns."""
        return self.support.dimension

    def state(self, displacement: Vector) -> ContactState:
        """Return the gaps, and the rows of the free unknowns."""
        found = self.geometry.state(self.support.expand(displacement))
        free = self.support.free
        tangent = None if found.tangent is None else sp.csr_array(found.tangent[:, free])
        return ContactState(found.gap, sp.csr_array(found.normal[:, free]), tangent, found.rounding)

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Return the curvature on the free unknowns, or None where it is not known."""
        found = self.geometry.curvature(self.support.expand(displacement), normal_force)
        free = self.support.free
        return None if found is None else sp.csc_array(sp.csr_array(found)[free][:, free])

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Return the slips (m, d-1) since the anchors [length]."""
        return self.geometry.slip_since(self.support.expand(displacement), anchor)

    def positions(self, displacement: Vector) -> Vector:
        """Return where the contacts are, (m, d) [length]."""
        return self.geometry.positions(self.support.expand(displacement))
