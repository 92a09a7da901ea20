"""What a large deformation asks of a body and of its contacts: two small protocols that anyone's code can meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from contactqp.model.arrays import Vector


@runtime_checkable
class Deformable(Protocol):
    """A body with an energy: its force is the gradient and its tangent the Hessian of that energy.

    Where the body cannot be (an element turned inside out) `energy` is inf and the two others raise InvalidProblem,
    which names the place.
    """

    @property
    def dimension(self) -> int:
        """n, the number of unknowns."""

    def energy(self, displacement: Vector) -> float:
        """The elastic energy [force * length], zero at rest."""

    def internal_force(self, displacement: Vector) -> Vector:
        """Its gradient (n,) [force]: the loads that hold the body there."""

    def tangent(self, displacement: Vector) -> Any:
        """Its Hessian (n, n), sparse or dense, symmetric [force / length]."""


@dataclass(frozen=True, eq=False)
class ContactState:
    """Contacts as they are at one displacement; to first order E_N (u_new - u) <= gap and slip E_T (u_new - u).

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
    """Who can touch whom, in the current configuration."""

    @property
    def contacts(self) -> int:
        """m."""

    def state(self, displacement: Vector) -> ContactState:
        """Gaps and rows at a displacement; InvalidProblem where a pair is lost."""

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """- sum over the contacts of l_N times the Hessian of the gap, (n, n) [force / length]; None: not known.

        It is what the contact forces add to the tangent as their directions turn. Without it Newton's method converges
        linearly wherever the obstacle is curved.
        """

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """(m, d-1): how far each contact has moved from its anchor (m, d) along the tangents of now [length]."""

    def positions(self, displacement: Vector) -> Vector:
        """(m, d): where the contacts are [length]: anchors of a slip."""
