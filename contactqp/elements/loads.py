"""Loads on bodies as consistent nodal forces: f_i is the integral of N_i times what acts on the body.

In plane problems the integrals carry the body's thickness, in axial symmetry the full circle 2 pi r. A load that varies
is a function of the points (p, d), evaluated at the quadrature points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.elements.geometry import Block, Geometry, at_rule, sum_at_nodes
from contactqp.elements.kinematics import measure
from contactqp.elements.mass import solid_mass
from contactqp.elements.membrane import Membrane
from contactqp.elements.reading import real_array
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Vector

Field = ArrayLike | Callable[[NDArray[np.float64]], ArrayLike]


class Load(Protocol):
    """What acts on a body; `body` is its name."""

    @property
    def body(self) -> str: ...

    def forces(self, body: Body) -> Vector:
        """(N d,) nodal forces [force]."""
        ...


@dataclass(frozen=True, eq=False)
class Traction:
    """A force per area on a side: f_i = integral of N_i t dA.

    Parameters
    ----------
    body, side : str
    value : (d,) array, or a function of (p, d) points that returns (p, d)
        t in the directions of the axes [force / length^2].
    """

    body: str
    side: str
    value: Field

    def forces(self, body: Body) -> Vector:
        def per_reference_area(facets: Geometry) -> Vector:
            t = field_values(f"traction on {self.side!r}", self.value, facets.positions, (body.dimension,))
            return np.asarray(t * np.linalg.norm(facets.normal, axis=-1, keepdims=True))

        return _integrated(body, body.mesh.side(self.side), per_reference_area)


@dataclass(frozen=True, eq=False)
class Pressure:
    """A pressure on a side: f_i = -integral of N_i p n dA with n out of the body, so that p > 0 pushes the body.

    Parameters
    ----------
    body, side : str
    value : float, or a function of (p, d) points that returns (p,)
        p [force / length^2].
    """

    body: str
    side: str
    value: Field

    def forces(self, body: Body) -> Vector:
        def per_reference_area(facets: Geometry) -> Vector:
            p = field_values(f"pressure on {self.side!r}", self.value, facets.positions, ())
            return -p[..., None] * facets.normal

        return _integrated(body, body.mesh.side(self.side), per_reference_area)


@dataclass(frozen=True, eq=False)
class BodyForce:
    """A force per volume: f_i = integral of N_i b dV.

    Parameters
    ----------
    body : str
    value : (d,) array, or a function of (p, d) points that returns (p, d)
        b [force / length^3].
    """

    body: str
    value: Field

    def forces(self, body: Body) -> Vector:
        def per_reference_volume(elements: Geometry) -> Vector:
            b = field_values("body force", self.value, elements.positions, (body.dimension,))
            return b * elements.determinant[..., None]

        return _integrated(body, body.mesh.blocks, per_reference_volume)


@dataclass(frozen=True, eq=False)
class Gravity:
    """The weight of a body: the body force rho a.

    Parameters
    ----------
    body : str
    acceleration : (d,) array
        a [length / time^2]; the material's density is in force time^2 / length^4, so that rho a is [force / length^3].
    """

    body: str
    acceleration: ArrayLike

    def forces(self, body: Body) -> Vector:
        if not body.material.density > 0:
            raise InvalidProblem(f"{body.name}: gravity needs a density > 0, {body.material.name} has none")
        return BodyForce(self.body, body.material.density * np.asarray(self.acceleration, dtype=float)).forces(body)


@dataclass(frozen=True, eq=False)
class Weight:
    """The weight of a body in a motion: f = M a with the body's own mass matrix, so that a free fall strains nothing.

    Parameters
    ----------
    body : str
    acceleration : (d,) array
        a [length / time^2].
    lumped : bool
        Whether M is the lumped mass; consistent, f is that of `Gravity`.
    """

    body: str
    acceleration: ArrayLike
    lumped: bool = False

    def forces(self, body: Body) -> Vector:
        falling = np.tile(np.asarray(self.acceleration, dtype=float), len(body.mesh.points))
        return np.asarray(solid_mass(body, self.lumped) @ falling)


@dataclass(frozen=True, eq=False)
class PointLoad:
    """The same force at each of some nodes.

    Parameters
    ----------
    body : str
    nodes : str, int or sequence of int
        A named set, or node numbers.
    force : (d,) array
        On each node [force]; in axial symmetry on its full circle.
    """

    body: str
    nodes: str | int | Sequence[int]
    force: ArrayLike

    def forces(self, body: Body) -> Vector:
        force = field_values("point load", self.force, np.zeros((1, body.dimension)), (body.dimension,))
        total = np.zeros(body.mesh.points.shape)
        total[node_numbers(body, self.nodes)] = force
        return total.ravel()


def node_numbers(body: Body | Membrane, nodes: str | int | Sequence[int] | NDArray[Any]) -> NDArray[np.int64]:
    """The nodes that a name, a number or numbers stand for, each once.

    Raises
    ------
    InvalidProblem
        No such set; numbers that are none or out of range.
    """
    if isinstance(nodes, str):
        return body.mesh.nodes(nodes)
    numbers = np.unique(np.asarray(nodes))
    if not numbers.size or not np.issubdtype(numbers.dtype, np.integer):
        raise InvalidProblem(f"{body.name}: expected a named set or node numbers, got {nodes!r}")
    return body.mesh.places(body.name, numbers)


def field_values(what: str, value: Field, positions: Vector, shape: tuple[int, ...]) -> Vector:
    """The value of a field at (..., d) positions: (..., *shape).

    Raises
    ------
    InvalidProblem
        A value of another shape, or one that is not finite; `what` is what it belongs to.
    """
    points = positions.reshape(-1, positions.shape[-1])
    expected = (len(points), *shape) if callable(value) else shape
    found = real_array(what, value(points) if callable(value) else value)
    if found.shape != expected:
        raise InvalidProblem(f"{what}: expected a value of shape {expected}, got {found.shape}")
    if not np.all(np.isfinite(found)):
        raise InvalidProblem(f"{what}: expected finite numbers, got {found[~np.isfinite(found)][0]}")
    return np.broadcast_to(found, (len(points), *shape)).reshape(*positions.shape[:-1], *shape)


def _integrated(body: Body, blocks: Sequence[Block], density: Callable[[Geometry], Vector]) -> Vector:
    """f_i = sum over elements or facets and points of N_i w density, times the body's measure: (N d,).

    `density` is (E, q, d), per area or volume of the reference element.
    """
    total = np.zeros(body.mesh.points.shape)
    for block in blocks:
        rule = block.kind.fine_rule
        geometry = at_rule(block, body.mesh.points, rule)
        weights = rule.weights * measure(geometry.positions, body.model, body.thickness)
        at_points = density(geometry) * weights[..., None]
        total += sum_at_nodes(block, np.matmul(geometry.shape.T, at_points), len(body.mesh.points))
    return total.ravel()
