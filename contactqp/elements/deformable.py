"""Define the protocols of bodies and contacts at large deformation, supported bodies, and contact with rigid obstacles.

Any class with the methods of `Deformable` or `ContactGeometry` can be used. A `Supported` body is again deformable,
with the free unknowns. Gaps, normals and tangents of `ObstacleContact` belong to the current configuration; the
curvature of an obstacle enters by the Hessian of its signed distance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.elements.obstacle import RELATIVE_STEP, Obstacle, Plane, tangent_frames
from contactqp.elements.pairing import paired, unknowns_of_surfaces
from contactqp.elements.round_obstacle import Circle, Cylinder, Paraboloid, Sphere
from contactqp.elements.scalars import real_number, real_vector, unit_vector
from contactqp.elements.surface import Surface
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arguments import checks, read_whole
from contactqp.model.arrays import EPS, Array, Index, Vector, computes
from contactqp.model.problem_data import ReadOnly, is_whole, read_array, read_only, read_shaped


@runtime_checkable
class Deformable(Protocol):
    """A body with an energy: its force is the gradient and its tangent the Hessian of that energy.

    At an inadmissible displacement (an inverted element) `energy` is inf and the two others raise InvalidProblem, which
    names the element.
    """

    @property
    def dimension(self) -> int:
        """Return the number of unknowns n."""

    def energy(self, displacement: Vector) -> float:
        """Return the elastic energy [force * length], zero at rest."""

    def internal_force(self, displacement: Vector) -> Vector:
        """Return the gradient of the energy (n,) [force], the loads in equilibrium with this displacement."""

    def tangent(self, displacement: Vector) -> Any:
        """Return the Hessian of the energy (n, n), sparse or dense, symmetric [force / length]."""


def unknown_names_of(body: Deformable) -> tuple[str, ...] | None:
    """Return the names of a body's unknowns, None if it has no `unknown_names`."""
    named = getattr(body, "unknown_names", None)
    return None if named is None else named()


@dataclass(frozen=True, eq=False)
class LinearisedContacts:
    """The contacts at one displacement; to first order E_N (u_new - u) <= gap and slip E_T (u_new - u).

    Attributes
    ----------
    gap : (m,) array, positive when open [length]
    normal : (m, n) sparse array, E_N = -d gap / d u
    tangent : ((d-1) m, n) sparse array, or None, E_T, contact-major
    rounding : (m,) array, a bound of the rounding errors of the gaps [length]
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

    def state(self, displacement: Vector) -> LinearisedContacts:
        """Return gaps and rows at a displacement; InvalidProblem where a contact has lost its pair."""

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Return minus the sum over the contacts of l_N times the Hessian of the gap, (n, n) [force / length], or None
        where it is not known.

        It is the geometric stiffness of the contact forces. Without it Newton's method converges linearly on curved
        obstacles.
        """

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Return how far each contact has moved from its anchor (m, d) along the current tangents, (m, d-1)
        [length].
        """

    def positions(self, displacement: Vector) -> Vector:
        """Return the positions of the contacts (m, d) [length], which serve as anchors of slips."""


@checks
@computes
@dataclass(frozen=True, eq=False)
class Supported(ReadOnly):
    """A body with supports: unknown j is unknown free[j] of the body, the others keep their values.

    Parameters
    ----------
    body : Deformable
    held : array of int, or mapping of int to float
        Indices of the fixed unknowns of the body, with their displacements unless zero [length].

    Raises
    ------
    InvalidProblem
        An index out of range, or no free unknown.

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
        given = self.held if isinstance(self.held, Mapping) else read_whole("held", self.held).ravel().tolist()
        values = dict(given) if isinstance(given, Mapping) else dict.fromkeys(given, 0.0)
        n = self.body.dimension
        for place, value in values.items():
            if not is_whole(place) or not 0 <= place < n:
                raise InvalidProblem(f"held: expected places from 0 to {n - 1}, got {shown(place)}")
            real_number(f"held: displacement of place {place}", value)
        if len(values) == n:
            raise InvalidProblem("held: every unknown is; expected some that are free")
        object.__setattr__(self, "held", values)

    @cached_property
    def free(self) -> Index:
        """Return the index in the body's u of each free unknown, ascending."""
        return read_only(np.setdiff1d(np.arange(self.body.dimension), list(self.held)).astype(np.int64))

    @property
    def dimension(self) -> int:
        """Return the number of free unknowns."""
        return len(self.free)

    def unknown_names(self) -> tuple[str, ...] | None:
        """Return the names of the free unknowns, None if the body has no names."""
        names = unknown_names_of(self.body)
        return None if names is None else tuple(names[j] for j in self.free.tolist())

    def expand(self, displacement: ArrayLike) -> Vector:
        """Return the u of the body from that of the free unknowns."""
        u = np.zeros(self.body.dimension)
        u[list(self.held)] = list(self.held.values())
        u[self.free] = real_vector("displacement", displacement, self.dimension)
        return u

    def restrict(self, load: ArrayLike) -> Vector:
        """Return the loads on the free unknowns from those on all of the body's."""
        return real_vector("load", load, self.body.dimension)[self.free]

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
        """Return the support forces on the body at all its unknowns, zero at free ones [force].

        Loads and contact forces on supported unknowns are not included.
        """
        force = self.body.internal_force(self.expand(displacement)).copy()
        force[self.free] = 0.0
        return force

    def contact(self, geometry: ContactGeometry) -> SupportedContact:
        """Return a contact geometry over the body's unknowns as one over the free unknowns.

        Raises
        ------
        InvalidProblem
            The geometry has another number of unknowns.
        """
        over = getattr(geometry, "dimension", self.body.dimension)
        if over != self.body.dimension:
            raise InvalidProblem(
                f"contact: expected rows over the {self.body.dimension} unknowns of the body, got "
                f"{over}; state dimension={self.body.dimension} where it is made"
            )
        return SupportedContact(self, geometry)


@computes
@dataclass(frozen=True, eq=False)
class SupportedContact:
    """Contacts of a supported body as functions of its free unknowns."""

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

    def state(self, displacement: Vector) -> LinearisedContacts:
        """Return the gaps, and the rows of the free unknowns."""
        found = self.geometry.state(self.support.expand(displacement))
        free = self.support.free
        tangent = None if found.tangent is None else sp.csr_array(found.tangent[:, free])
        return LinearisedContacts(found.gap, sp.csr_array(found.normal[:, free]), tangent, found.rounding)

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Return the curvature on the free unknowns, or None where it is not known."""
        found = self.geometry.curvature(self.support.expand(displacement), normal_force)
        free = self.support.free
        return None if found is None else sp.csc_array(sp.csr_array(found)[free][:, free])

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Return the slips (m, d-1) since the anchors [length]."""
        return self.geometry.slip_since(self.support.expand(displacement), anchor)

    def positions(self, displacement: Vector) -> Vector:
        """Return the positions of the contacts, (m, d) [length]."""
        return self.geometry.positions(self.support.expand(displacement))


# The rounding error of a gap relative to the coordinates, for a few operations.
ROUNDING_OF_COORDINATES = 16 * EPS


@checks
@computes
@dataclass(frozen=True, eq=False)
class ObstacleContact(ReadOnly):
    """Nodes that may touch one rigid obstacle: `cq.pair` with the current points.

    Parameters
    ----------
    points : (p, d) array or Surface
        Reference positions of the nodes [length]. A surface also states their unknowns.
    obstacle : Plane, Circle, Sphere, Cylinder, Paraboloid or SignedDistance
        Or anything with `dimension`, `distance(points)` and `normals(points)`, the gradient of the distance.
    unknowns : (p, d) array of int, optional
        unknowns[i, a] is the index in u of node i's displacement along axis a. By default u is (p d,), node by node.
    dimension : int, optional
        n, the number of all unknowns; by default that of the surface, or one more than the largest in `unknowns`.

    Raises
    ------
    InvalidProblem
        As `cq.pair`; or a paraboloid that measures its gap along the axis, which is not a distance.
    """

    points: Any
    obstacle: Obstacle
    unknowns: Any = None
    dimension: int | None = None

    def __post_init__(self) -> None:
        if isinstance(self.obstacle, Paraboloid) and self.obstacle.measure == "axis":
            raise InvalidProblem(
                "paraboloid: its gap along the axis has no normal that follows large motions; expected measure='normal'"
            )
        if isinstance(self.points, Surface):
            if self.unknowns is not None:
                raise InvalidProblem(f"{self.points.name}: expected no `unknowns`, the surface has its own")
            nodes = self.points.nodes
            object.__setattr__(self, "dimension", unknowns_of_surfaces(self.dimension, self.points))
            object.__setattr__(self, "unknowns", self.points.unknowns[nodes])
            object.__setattr__(self, "points", self.points.points[nodes])
        found = paired(self.points, self.obstacle, self.unknowns, self.dimension)
        places = np.arange(found.points.size).reshape(found.points.shape) if self.unknowns is None else self.unknowns
        object.__setattr__(self, "points", found.points)
        object.__setattr__(self, "unknowns", read_only(np.array(places, dtype=np.int64)))
        object.__setattr__(self, "dimension", found.normal.shape[1])

    @property
    def contacts(self) -> int:
        """Return the number of contacts m = p."""
        return len(self.points)

    def positions(self, displacement: Vector) -> Vector:
        """Return the current positions of the nodes, (m, d) [length]."""
        u = read_array("displacement", displacement)
        if u.ndim != 1 or len(u) < (self.dimension or 0):
            raise InvalidProblem(f"displacement: expected the {self.dimension} unknowns, got shape {u.shape}")
        return np.asarray(self.points + u[self.unknowns])

    def state(self, displacement: Vector) -> LinearisedContacts:
        """Return gaps and rows at a displacement.

        Raises
        ------
        InvalidProblem
            A node where the obstacle has no normal.
        """
        x = self.positions(displacement)
        found = paired(x, self.obstacle, self.unknowns, self.dimension)
        size = np.max(abs(x), axis=1, initial=0.0) + abs(found.gap) + float(getattr(self.obstacle, "radius", 0.0))
        return LinearisedContacts(found.gap, found.normal, found.tangent, ROUNDING_OF_COORDINATES * size)

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Return minus the sum of l_N d2 gap / d u2, (n, n) CSC [force / length]."""
        force = real_vector("normal_force", normal_force, self.contacts)
        pushing = np.flatnonzero(force)
        places = self.unknowns[pushing]
        blocks = distance_hessians(self.obstacle, self.positions(displacement)[pushing])
        blocks = -force[pushing, None, None] * blocks
        rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None, :])
        triplets = (blocks.ravel(), (rows.ravel(), columns.ravel()))
        return sp.csc_array(sp.coo_array(triplets, shape=(self.dimension, self.dimension)))

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Return t.(x - anchor) along the current tangents, (m, d-1) [length]; on a curved obstacle x - anchor is the
        chord.
        """
        x = self.positions(displacement)
        frames = tangent_frames(np.asarray(self.obstacle.normals(x), dtype=float))
        start = read_shaped({"anchor": (anchor, x.shape)})["anchor"]
        return np.asarray(np.einsum("pij,pj->pi", frames, x - start))


@checks
@computes
class ContactGroup:
    """Several contact geometries over the same unknowns, for bodies that may touch several obstacles.

    Raises
    ------
    InvalidProblem
        No geometries, or rows of different lengths.
    """

    def __init__(self, parts: Sequence[ContactGeometry]) -> None:
        if not parts:
            raise InvalidProblem("contact group: expected at least one contact geometry, got none")
        self.parts = tuple(parts)
        self._ends = np.cumsum([part.contacts for part in self.parts])[:-1]

    @property
    def contacts(self) -> int:
        """Return the number of contacts of all geometries."""
        return sum(part.contacts for part in self.parts)

    def state(self, displacement: Vector) -> LinearisedContacts:
        """Return the gaps and rows of the contacts of all geometries, one geometry after the other."""
        states = [part.state(displacement) for part in self.parts]
        widths = {state.normal.shape[1] for state in states}
        if len(widths) > 1:
            raise InvalidProblem(f"contact group: expected rows over the same unknowns, got {sorted(widths)}")
        smooth = any(state.tangent is None for state in states)
        return LinearisedContacts(
            np.concatenate([state.gap for state in states]),
            sp.csr_array(sp.vstack([state.normal for state in states], format="csr")),
            None if smooth else sp.csr_array(sp.vstack([state.tangent for state in states], format="csr")),
            np.concatenate([state.rounding for state in states]),
        )

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Return the sum of the curvatures of all geometries, (n, n) [force / length], None if one of them has none."""
        total = None
        for part, force in zip(self.parts, self._split("normal_force", normal_force), strict=True):
            found = part.curvature(displacement, force)
            if found is None:
                return None
            total = found if total is None else total + found
        return total

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Return the slips (m, d-1) of all geometries."""
        pairs = zip(self.parts, self._split("anchor", anchor), strict=True)
        return np.concatenate([part.slip_since(displacement, where) for part, where in pairs])

    def positions(self, displacement: Vector) -> Array:
        """Return the positions (m, d) of all geometries."""
        return np.concatenate([part.positions(displacement) for part in self.parts])

    def _split(self, name: str, values: Vector) -> list[Vector]:
        found = read_array(name, values)
        if len(np.atleast_1d(found)) != self.contacts or not found.ndim:
            raise InvalidProblem(f"{name}: expected one for each of {self.contacts} contacts, got {shown(values)}")
        return np.split(found, self._ends)


def distance_hessians(obstacle: Obstacle, points: Array) -> Array:
    """Return d n / d x of each of the (p, d) points, (p, d, d), symmetric [1 / length].

    A plane has none; a circle, a sphere or a cylinder has (1 - n n') / r without the part along the axis, r the
    distance from the centre or the axis. Of any other obstacle the normals are differenced.

    >>> distance_hessians(Circle([0.0, 0.0], 1.0), np.array([[0.0, 2.0]])).tolist()
    [[[0.5, 0.0], [0.0, 0.0]]]
    """
    d = points.shape[1]
    if isinstance(obstacle, Plane) or not len(points):
        return np.zeros((len(points), d, d))
    if not isinstance(obstacle, Circle | Sphere | Cylinder):
        return _differences(obstacle, points)
    n = np.asarray(obstacle.normals(points), dtype=float)
    distance = np.asarray(obstacle.distance(points), dtype=float)
    outside = -1.0 if obstacle.inside else 1.0
    r = float(obstacle.radius) + outside * distance
    across = np.eye(d) - n[:, :, None] * n[:, None, :]
    if isinstance(obstacle, Cylinder):
        a = unit_vector(np.asarray(obstacle.axis, dtype=float), "cylinder axis")
        across -= np.outer(a, a)
    return np.asarray(across * (outside / r)[:, None, None])


def _differences(obstacle: Obstacle, points: Array) -> Array:
    size = np.max(abs(points)) + np.max(abs(np.asarray(obstacle.distance(points), dtype=float)))
    h = RELATIVE_STEP * float(size or 1.0)
    columns = [(obstacle.normals(points + h * e) - obstacle.normals(points - h * e)) / (2 * h) for e in _axes(points)]
    found = np.stack(columns, axis=2).astype(float)
    return np.asarray((found + np.swapaxes(found, 1, 2)) / 2)


def _axes(points: Array) -> Array:
    return np.eye(points.shape[1])
