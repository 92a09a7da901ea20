"""Loads on bodies as consistent nodal forces, and mass matrices.

f_i is the integral of N_i times the load. In plane problems the integrals carry the body's thickness, in axial symmetry
the full circle 2 pi r. A load that varies is a function of the points (p, d), evaluated at the quadrature points. A
consistent mass matrix is the integral of rho N_i N_j, a lumped one a diagonal of the same masses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from contactqp.elements.material import measure
from contactqp.elements.reference_elements import Block, Geometry, at_rule, sum_at_nodes
from contactqp.elements.scalars import Number, Numbers, keep_own, square_root, squared_length
from contactqp.elements.solid import Body, Membrane, assemble, pattern
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arguments import checks
from contactqp.model.arrays import Array, Index, Vector
from contactqp.model.problem_data import ReadOnly, read_array

Field = ArrayLike | Callable[[Array], ArrayLike]


class Load(Protocol):
    """A load on a body, whose name is `body`."""

    @property
    def body(self) -> str: ...

    def forces(self, body: Body) -> Vector:
        """Return the (N d,) nodal forces [force]."""
        ...


def refuse_on_membrane(load: Load, membrane: Membrane) -> None:
    """Raise InvalidProblem where a load of this kind does not act on membranes."""
    if isinstance(load, Traction | BodyForce | Gravity | Weight):
        raise InvalidProblem(
            f"{membrane.name}: a membrane takes a Pressure from 'above' or 'below' and PointLoads of one component, "
            f"got {type(load).__name__}"
        )


@checks
@dataclass(frozen=True, eq=False)
class Traction(ReadOnly):
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

    def __post_init__(self) -> None:
        keep_own(self, "value")

    def forces(self, body: Body) -> Vector:
        """Return the nodal forces (N d,) of the load on a body, node by node [force]."""

        def per_reference_area(facets: Geometry) -> Vector:
            t = field_values(f"traction on {self.side!r}", self.value, facets.positions, (body.dimension,))
            return np.asarray(t * np.linalg.norm(facets.normal, axis=-1, keepdims=True))

        return integrated(body, body.mesh.side(self.side), per_reference_area)


@checks
@dataclass(frozen=True, eq=False)
class Pressure(ReadOnly):
    """A pressure on a side: f_i = -integral of N_i p n dA with n out of the body, so that p > 0 pushes the body.

    On a membrane it acts from one side of its plane: from above, f_i = -integral of N_i p dA along z, or from below.

    Parameters
    ----------
    body, side : str
        The side of a membrane is "above" or "below".
    value : float, or a function of (p, d) points that returns (p,)
        p [force / length^2].
    """

    body: str
    side: str
    value: Field

    def __post_init__(self) -> None:
        keep_own(self, "value")

    def forces(self, body: Body | Membrane) -> Vector:
        """Return the nodal forces (N d,) of the load on a body, node by node [force]."""
        if isinstance(body, Membrane):
            return self._on_membrane(body)

        def per_reference_area(facets: Geometry) -> Vector:
            p = field_values(f"pressure on {self.side!r}", self.value, facets.positions, ())
            return -p[..., None] * facets.normal

        return integrated(body, body.mesh.side(self.side), per_reference_area)

    def _on_membrane(self, membrane: Membrane) -> Vector:
        """Return its (N,) forces along z."""
        if self.side not in ("above", "below"):
            raise InvalidProblem(
                f"{membrane.name}: pressure: expected the side 'above' or 'below' of a membrane, got {self.side!r}"
            )
        total = np.zeros(membrane.size)
        for block in membrane.mesh.blocks:
            elements = at_rule(block, membrane.mesh.points, block.kind.fine_rule)
            p = field_values(f"pressure on {membrane.name!r}", self.value, elements.positions, ())
            weights = block.kind.fine_rule.weights * elements.determinant
            total += sum_at_nodes(block, (elements.shape.T @ (p * weights)[..., None]), membrane.size)[:, 0]
        return -total if self.side == "above" else total


@dataclass(frozen=True, eq=False)
class BodyForce(ReadOnly):
    """A force per volume: f_i = integral of N_i b dV.

    Parameters
    ----------
    body : str
    value : (d,) array, or a function of (p, d) points that returns (p, d), b [force / length^3]
    """

    body: str
    value: Field

    def __post_init__(self) -> None:
        keep_own(self, "value")

    def forces(self, body: Body) -> Vector:
        """Return the nodal forces (N d,) of the load on a body, node by node [force]."""

        def per_reference_volume(elements: Geometry) -> Vector:
            b = field_values("body force", self.value, elements.positions, (body.dimension,))
            return b * elements.determinant[..., None]

        return integrated(body, body.mesh.blocks, per_reference_volume)


@checks
@dataclass(frozen=True, eq=False)
class Gravity(ReadOnly):
    """The weight of a body: the body force rho a.

    Parameters
    ----------
    body : str
    acceleration : (d,) array
        a [length / time^2]; the material's density is in force time^2 / length^4, so that rho a is [force / length^3].
    """

    body: str
    acceleration: ArrayLike

    def __post_init__(self) -> None:
        keep_own(self, "acceleration")

    def forces(self, body: Body) -> Vector:
        """Return the nodal forces (N d,) of the load on a body, node by node [force]."""
        if not body.material.density > 0:
            raise InvalidProblem(f"{body.name}: gravity needs a density > 0, {body.material.name} has none")
        return BodyForce(self.body, body.material.density * np.asarray(self.acceleration, dtype=float)).forces(body)


@dataclass(frozen=True, eq=False)
class Weight(ReadOnly):
    """The weight of a body in a motion: f = M a with the body's own mass matrix, so that a free fall strains nothing.

    Parameters
    ----------
    body : str
    acceleration : (d,) array, a [length / time^2]
    lumped : bool, whether M is the lumped mass; consistent, f is that of `Gravity`
    """

    body: str
    acceleration: ArrayLike
    lumped: bool = False

    def __post_init__(self) -> None:
        keep_own(self, "acceleration")

    def forces(self, body: Body) -> Vector:
        falling = np.tile(np.asarray(self.acceleration, dtype=float), len(body.mesh.points))
        return np.asarray(solid_mass(body, self.lumped) @ falling)


@checks
@dataclass(frozen=True, eq=False)
class PointLoad(ReadOnly):
    """The same force at each of some nodes.

    Parameters
    ----------
    body : str
    nodes : str, int or sequence of int
        A named set, or node numbers.
    force : (d,) array
        On each node [force]; in axial symmetry on its full circle; of a membrane the one along z.
    """

    body: str
    nodes: str | int | Sequence[int]
    force: ArrayLike

    def __post_init__(self) -> None:
        keep_own(self, "nodes", "force")

    def forces(self, body: Body | Membrane) -> Vector:
        """Return the nodal forces (N d,) of the load on a body, node by node [force]."""
        d = len(body.axes)
        force = field_values("point load", self.force, np.zeros((1, body.mesh.dimension)), (d,))
        total = np.zeros((len(body.mesh.points), d))
        total[node_numbers(body, self.nodes)] = force
        return total.ravel()


def node_numbers(body: Body | Membrane, nodes: str | int | Sequence[int] | NDArray[Any]) -> Index:
    """Return the nodes of a named set, or with these numbers, each once.

    Raises InvalidProblem: no such set, or numbers that are not integers or out of range.
    """
    if isinstance(nodes, str):
        return body.mesh.nodes(nodes)
    numbers = np.unique(np.asarray(nodes))
    if not numbers.size or not np.issubdtype(numbers.dtype, np.integer):
        raise InvalidProblem(f"{body.name}: expected a named set or node numbers, got {shown(nodes)}")
    return body.mesh.places(body.name, numbers)


def field_values(what: str, value: Field, positions: Vector, shape: tuple[int, ...]) -> Vector:
    """Return the values of a field at (..., d) positions: (..., *shape).

    Raises InvalidProblem: a value of another shape, or one that is not finite.

    Parameters
    ----------
    what : str, the name of the field in messages
    value : array or function, one value for all positions, or a function from (p, d) points to (p, *shape)
    positions : (..., d) array, where the field is evaluated [length]
    shape : tuple of int, the shape of one value
    """
    points = positions.reshape(-1, positions.shape[-1])
    expected = (len(points), *shape) if callable(value) else shape
    found = read_array(what, value(points) if callable(value) else value)
    if found.shape != expected:
        raise InvalidProblem(f"{what}: expected a value of shape {expected}, got {found.shape}")
    if not np.all(np.isfinite(found)):
        raise InvalidProblem(f"{what}: expected finite numbers, got {found[~np.isfinite(found)][0]}")
    return np.broadcast_to(found, (len(points), *shape)).reshape(*positions.shape[:-1], *shape)


def integrated(body: Body, blocks: Sequence[Block], density: Callable[[Geometry], Vector]) -> Vector:
    """Return f_i, the sum over elements or facets and points of N_i w density, times the body's measure: (N d,).

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


def bar_mass(density: Number, area: Number, start: Any, end: Any, lumped: bool = False) -> Numbers:
    """Return M = (rho A L / 6) [[2 I, I], [I, 2 I]], or lumped (rho A L / 2) [[I, 0], [0, I]].

    Parameters
    ----------
    density, area : Fraction or float, rho [force time^2 / length^4], A [length^2]
    start, end : (dimension,) arrays, the two nodes [length]
    lumped : bool

    Returns
    -------
    (2 dimension, 2 dimension) array [force time^2 / length] on (u_start, u_end): a bar has inertia along and across
    itself. Exact where all data are and L is rational.

    >>> bar_mass(6.0, 1.0, [0.0], [2.0]).tolist()
    [[4.0, 2.0], [2.0, 4.0]]
    """
    d = np.asarray(end) - np.asarray(start)
    part = density * area * square_root(squared_length(d)) / 6
    weights = np.array([[3, 0], [0, 3]] if lumped else [[2, 1], [1, 2]])
    M: Numbers = part * np.kron(weights, np.eye(len(d), dtype=int))
    return M


def solid_mass(body: Body, lumped: bool = False) -> Any:
    """Return M of an elastic body: (N d, N d) CSC, symmetric positive definite [force time^2 / length].

    The consistent matrix is M_ij = integral of rho N_i N_j, with the body's thickness or over the full circle. The
    lumped one is the diagonal of each element's consistent matrix, scaled to the element's mass, which is positive for
    every kind of element, unlike row sums (Hinton, Rock and Zienkiewicz 1976). For linear triangles, tetrahedra and
    rectangles both lumpings are the same.

    Raises InvalidProblem: the material has no density.
    """
    if not body.material.density > 0:
        raise InvalidProblem(f"{body.name}: a mass needs a density > 0, {body.material.name} has none")
    nodes = len(body.mesh.points)
    blocks = [_element_masses(body, block) for block in body.mesh.blocks]
    if lumped:
        total = np.zeros(nodes)
        for block, masses in zip(body.mesh.blocks, blocks, strict=True):
            share = np.einsum("eii->ei", masses)
            share = share * (masses.sum(axis=(1, 2)) / share.sum(axis=1))[:, None]
            total += np.bincount(block.nodes.ravel(), weights=share.ravel(), minlength=nodes)
        scalar = sp.diags(total)
    else:
        where = pattern([block.nodes for block in body.mesh.blocks], nodes)
        scalar = assemble(where, np.concatenate([masses.ravel() for masses in blocks])[np.newaxis, np.newaxis])
    return sp.csc_array(sp.kron(scalar, sp.identity(body.dimension)))


def _element_masses(body: Body, block: Block) -> Array:
    """Return the integrals of rho N_i N_j over each element, (E, n, n), symmetric to the last digit."""
    geometry, weights = body.integration(block, block.kind.fine_rule)
    weighted = weights[:, :, None] * (body.material.density * geometry.shape)
    masses = np.matmul(np.swapaxes(weighted, 1, 2), geometry.shape)
    return np.asarray((masses + np.swapaxes(masses, 1, 2)) / 2)
