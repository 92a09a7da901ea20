"""Nodes against rigid obstacles in the current configuration: gaps, normals and tangents that turn with the motion.

The normal of a curved obstacle turns from point to point by the Hessian of its signed distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.elements.deformable import ContactGeometry, ContactState
from contactqp.elements.obstacle import Obstacle, Plane, tangent_frames
from contactqp.elements.pairing import paired
from contactqp.elements.round_obstacle import Circle, Cylinder, Paraboloid, Sphere
from contactqp.elements.scalars import real_array, unit_vector
from contactqp.elements.surface import Surface
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, Vector, computes
from contactqp.model.problem_data import ReadOnly, read_only

# Of a coordinate: a few operations lie between it and a gap.
ROUNDING = 16 * np.finfo(float).eps
# Where truncation (step^2) and rounding (eps / step) of a central difference meet.
RELATIVE_STEP = float(np.cbrt(np.finfo(float).eps))


@computes
@dataclass(frozen=True, eq=False)
class ObstacleContact(ReadOnly):
    """Nodes that may touch one rigid obstacle: `cq.pair` with the current points.

    Parameters
    ----------
    points : (p, d) array or Surface
        Where the nodes are at rest [length]. The nodes of a surface come with their unknowns.
    obstacle : Plane, Circle, Sphere, Cylinder, Paraboloid or SignedDistance
        Or anything with `dimension`, `distance(points)` and `normals(points)`, the gradient of the distance.
    unknowns : (p, d) array of int, optional
        unknowns[i, a] is the place of node i's displacement along axis a in u. By default u is (p d,), node by node.
    dimension : int, optional
        n, the number of all unknowns; by default one more than the largest in `unknowns`.

    Raises
    ------
    InvalidProblem
        As `cq.pair`; a paraboloid that measures its gap along the axis: that is no distance, and its normals are not
        the gradient of its gap.
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
        """Return where the nodes are, (m, d) [length]."""
        return np.asarray(self.points + real_array("displacement", displacement)[self.unknowns])

    def state(self, displacement: Vector) -> ContactState:
        """Return gaps and rows at a displacement.

        Raises
        ------
        InvalidProblem
            A node where the obstacle has no normal.
        """
        x = self.positions(displacement)
        found = paired(x, self.obstacle, self.unknowns, self.dimension)
        size = np.max(abs(x), axis=1, initial=0.0) + abs(found.gap) + float(getattr(self.obstacle, "radius", 0.0))
        return ContactState(found.gap, found.normal, found.tangent, ROUNDING * size)

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Return minus the sum of l_N d2 gap / d u2, (n, n) CSC [force / length]."""
        pushing = np.flatnonzero(normal_force)
        places = self.unknowns[pushing]
        blocks = distance_hessians(self.obstacle, self.positions(displacement)[pushing])
        blocks = -np.asarray(normal_force)[pushing, None, None] * blocks
        rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None, :])
        triplets = (blocks.ravel(), (rows.ravel(), columns.ravel()))
        return sp.csc_array(sp.coo_array(triplets, shape=(self.dimension, self.dimension)))

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Return t.(x - anchor) along the current tangents, (m, d-1) [length]; where the obstacle is curved, of the
        chord.
        """
        x = self.positions(displacement)
        frames = tangent_frames(np.asarray(self.obstacle.normals(x), dtype=float))
        return np.asarray(np.einsum("pij,pj->pi", frames, x - anchor))


@computes
class ContactGroup:
    """Several contact geometries of one u, one after the other: for bodies that may touch several obstacles.

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

    def state(self, displacement: Vector) -> ContactState:
        """Return gaps and rows of all geometries."""
        states = [part.state(displacement) for part in self.parts]
        widths = {state.normal.shape[1] for state in states}
        if len(widths) > 1:
            raise InvalidProblem(f"contact group: expected rows over the same unknowns, got {sorted(widths)}")
        smooth = any(state.tangent is None for state in states)
        return ContactState(
            np.concatenate([state.gap for state in states]),
            sp.csr_array(sp.vstack([state.normal for state in states], format="csr")),
            None if smooth else sp.csr_array(sp.vstack([state.tangent for state in states], format="csr")),
            np.concatenate([state.rounding for state in states]),
        )

    def curvature(self, displacement: Vector, normal_force: Vector) -> Any:
        """Return the sum over all geometries, or None where one does not know it."""
        total = None
        for part, force in zip(self.parts, self._split(normal_force), strict=True):
            found = part.curvature(displacement, force)
            if found is None:
                return None
            total = found if total is None else total + found
        return total

    def slip_since(self, displacement: Vector, anchor: Vector) -> Vector:
        """Return the slips (m, d-1) of all geometries."""
        pairs = zip(self.parts, self._split(anchor), strict=True)
        return np.concatenate([part.slip_since(displacement, where) for part, where in pairs])

    def positions(self, displacement: Vector) -> NDArray[np.float64]:
        """Return the positions (m, d) of all geometries."""
        return np.concatenate([part.positions(displacement) for part in self.parts])

    def _split(self, values: Vector) -> list[Vector]:
        return np.split(np.asarray(values), self._ends)


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
