"""Who can touch whom: the rows E_N, E_T and the gaps of nodes and an obstacle, for people with their own matrices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.elements.contact_rows import contact_rows, count_unknowns
from contactqp.elements.nodal_pressure import NodalPressure, nodal_pressure
from contactqp.elements.obstacle import Obstacle, Plane, tangent_frames
from contactqp.elements.reading import real_array
from contactqp.elements.surface import Surface
from contactqp.elements.surface_checks import check_surface
from contactqp.elements.tributary import tributary_areas
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import computes, own_floating_point
from contactqp.model.problem_data import ReadOnly, read_whole

__all__ = ["Pairing", "Plane", "pair"]


@computes
@dataclass(frozen=True, eq=False)
class Pairing(ReadOnly):
    """What ContactProblem takes as ``normal``, ``gap`` and ``tangent``; unpacks as ``E_N, g, E_T``.

    Parameters
    ----------
    normal : (p, n) sparse array
        E_N [-].
    gap : (p,) array
        g, positive when open [length].
    tangent : ((d-1) p, n) sparse array
        E_T, contact-major [-].
    nodes : (p,) array of int
        The node of each contact: its number in the surface, or its place among the points.
    points : (p, d) array
        Where those nodes are [length].
    direction : (p, d) array
        The unit normal of each contact, out of the obstacle or of the master surface.
    unpaired : (q,) array of int
        Nodes that have no contact of their own, ascending.
    area : (p,) array, optional
        What belongs to each contact of the surface, its thickness or full circle included [area]; None for bare points.
        A weight, positive for every kind of facet; pressures come from `pressure`.
    projection : NodalPressure, optional
        How forces become pressures; None for bare points.
    notes : tuple of str
        What the pressures of this pairing cannot be trusted for: facets too coarse for the gap between curved sides.
    """

    normal: Any
    gap: NDArray[np.float64]
    tangent: Any
    nodes: NDArray[np.int64]
    points: NDArray[np.float64]
    direction: NDArray[np.float64]
    unpaired: NDArray[np.int64]
    area: NDArray[np.float64] | None = None
    projection: NodalPressure | None = None
    notes: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[Any]:
        return iter((self.normal, self.gap, self.tangent))

    def pressure(self, normal_force: ArrayLike) -> NDArray[np.float64]:
        """The contact pressure at each node, positive in compression, (p,) [force / area].

        It is the projection of the forces onto the trace of the surface (contactqp.elements.nodal_pressure), and of a
        mortar the pressure field that it integrates. Where no force pulls, no pressure does. NaN forces are unknown.

        Raises
        ------
        InvalidProblem
            Bare points have no area; not one force for each contact.
        """
        force = real_array("normal_force", normal_force)
        pressure = self.per_area(force)
        return pressure if np.any(force < 0) else np.maximum(pressure, 0.0)

    def per_area(self, force: ArrayLike) -> NDArray[np.float64]:
        """The same projection of one component of nodal forces, of either sign, such as friction, (p,) [force / area].

        Raises
        ------
        InvalidProblem
            Bare points have no area; not one force for each contact.
        """
        given = real_array("normal_force", force)
        if self.projection is None:
            raise InvalidProblem("pressure: points have no area: expected a pairing of a Surface")
        if given.shape != self.gap.shape:
            raise InvalidProblem(f"normal_force: expected shape {self.gap.shape}, got {given.shape}")
        return self.projection.of(given)


@own_floating_point
def pair(
    points: ArrayLike | Surface,
    obstacle: Obstacle,
    *,
    unknowns: ArrayLike | None = None,
    dimension: int | None = None,
) -> Pairing:
    """Pair every point with the obstacle: E_N u <= gap, with E_N = -n' and gap = signed distance of the point.

    The distance is linearised where the point starts: displacements small against the obstacle's radii of curvature.

    Parameters
    ----------
    points : (p, d) array or Surface
        The nodes that may touch [length], d = 1, 2 or 3. The nodes of a surface come with their areas and unknowns.
    obstacle : Plane, Circle, Sphere, Cylinder, Paraboloid or SignedDistance
        Or anything with `dimension`, `distance(points)` and `normals(points)`; normals point to the body's side.
    unknowns : (p, d) array of int, optional
        unknowns[i, a] is the place of node i's displacement along axis a in u. By default u is (p d,), node by node.
    dimension : int, optional
        n, the number of all unknowns; by default one more than the largest in `unknowns`.

    Returns
    -------
    Pairing
        Unpacks as ``E_N, g, E_T``. The tangents of a point are orthonormal. With a surface `area` is the tributary area
        of each node (contactqp.elements.tributary).

    Raises
    ------
    InvalidProblem
        Shapes that do not fit, numbers that are not finite, unknowns out of range, a point where the obstacle has no
        normal.

    Examples
    --------
    >>> E_N, g, E_T = pair([[0.0, 0.001]], Plane(point=[0.0, 0.0], normal=[0.0, 1.0]))
    >>> E_N.toarray().tolist(), g.tolist(), E_T.toarray().tolist()
    ([[0.0, -1.0]], [0.001], [[1.0, 0.0]])
    """
    if isinstance(points, Surface):
        return _pair_surface(points, obstacle, unknowns, dimension)
    x = _points(points, obstacle.dimension)
    columns = np.arange(x.size).reshape(x.shape) if unknowns is None else read_whole("unknowns", unknowns)
    if columns.shape != x.shape:
        raise InvalidProblem(
            f"unknowns: expected whole numbers of shape {x.shape}, got {columns.dtype} {columns.shape}"
        )
    if columns.min(initial=0) < 0:
        raise InvalidProblem(f"unknowns: expected numbers from 0, got {int(columns.min())}")
    n = count_unknowns(int(columns.max(initial=-1)), dimension)
    return _pair_points(x, columns, obstacle, n, np.arange(len(x)))


def _pair_surface(surface: Surface, obstacle: Obstacle, unknowns: ArrayLike | None, dimension: int | None) -> Pairing:
    if unknowns is not None:
        raise InvalidProblem(f"{surface.name}: expected no `unknowns`, the surface has its own")
    check_surface(surface)
    nodes = surface.nodes
    x = _points(surface.points[nodes], obstacle.dimension)
    n = count_unknowns(int(surface.unknowns.max()), dimension)
    found = _pair_points(x, surface.unknowns[nodes], obstacle, n, nodes)
    return replace(found, area=tributary_areas(surface), projection=nodal_pressure(surface, nodes))


def _pair_points(
    x: NDArray[np.float64],
    columns: NDArray[np.int64],
    obstacle: Obstacle,
    n: int,
    nodes: NDArray[np.int64],
) -> Pairing:
    outward = real_array("obstacle: normals", obstacle.normals(x))
    contact = np.arange(len(x))
    E_N, E_T = contact_rows(contact, np.ones(len(x)), columns, outward, tangent_frames(outward), (len(x), n))
    gap = real_array("obstacle: distances", obstacle.distance(x))
    return Pairing(E_N, gap, E_T, nodes, x, outward, np.array([], dtype=np.int64))


def _points(points: ArrayLike, dimension: int) -> NDArray[np.float64]:
    x = real_array("points", points)
    if x.ndim != 2 or x.shape[1] != dimension:
        raise InvalidProblem(f"points: expected shape (p, {dimension}) as the obstacle has it, got {x.shape}")
    if not np.all(np.isfinite(x)):
        raise InvalidProblem(f"points: expected finite numbers, got {x[~np.isfinite(x)][0]}")
    return x
