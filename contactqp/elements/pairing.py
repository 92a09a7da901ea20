"""The rows E_N, E_T and the gaps of nodes and an obstacle, also for users with matrices of their own.

Each contact moves as a weighted sum of node displacements (`contact_rows`). A membrane or another scalar field over an
obstacle has one unknown a node, u >= height(x) (`pair_scalar`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.elements.nodal_pressure import NodalPressure, nodal_pressure, tributary_areas
from contactqp.elements.obstacle import Obstacle, Plane, points_near, tangent_frames
from contactqp.elements.surface import Surface, check_surface, middle_normals
from contactqp.errors import InvalidProblem, StartWarning, counted, shown, warn
from contactqp.model.arguments import checked, checks, read_whole
from contactqp.model.arrays import Array, Index, computes, own_floating_point
from contactqp.model.problem_data import ReadOnly, is_whole, read_array
from contactqp.model.summary import number

# The largest overlap of an interference fit relative to the size of the body.
DEEP = 0.25
# Cosine of the angle between the outward normals of a side and of an obstacle, from which they agree.
AGREE = 0.5
CURE = "the normal of an obstacle points out of it, to where the body is"


def doubt_of_depth(depth: float, size: float, called: str, unit: str = "") -> str:
    """Return a warning that a contact starts deep inside an obstacle, empty where it does not.

    Parameters
    ----------
    depth : float [length], how deep it starts; negative outside
    size : float [length], that of the body: its longest side, and in axial symmetry its diameter where that is longer
    called : str, the name of the obstacle or body
    unit : the unit of length, for the text
    """
    if not depth > DEEP * size > 0:
        return ""
    part = f"{100 * depth / size:.2g} % of the size of its body"
    cure = f"move it or the obstacle, or turn that round; {CURE}"
    return f"it starts {depth:.6g}{unit and f' {unit}'} inside {called}, {part}, and will be dragged out: {cure}"


def doubt_of_side(surface: Surface, gap: Array, normals: Array, called: str, unit: str = "") -> str:
    """Return a warning about the initial position of a side beside an obstacle, empty where there is no doubt.

    Where a side is nearest to an obstacle its normal must point to it, except at an edge.

    Parameters
    ----------
    surface : Surface
    gap : (p,) array, distances of its nodes to the obstacle [length]
    normals : (p, d) array, the obstacle's normals there
    called : the name of the obstacle in messages
    unit : the unit of lengths in messages
    """
    if not len(gap):
        return ""
    nearest = int(np.argmin(gap))
    facets = np.any(surface.facets == surface.nodes[nearest], axis=1)
    outward = middle_normals(surface)[facets].mean(axis=0)
    if float(outward @ normals[nearest]) > AGREE:
        return f"the side and {called} face the same way: {CURE}; turn it round?"
    size = float(np.ptp(surface.points, axis=0).max())
    if surface.revolved:
        size = max(size, 2 * float(abs(surface.points[:, 0]).max()))
    return doubt_of_depth(-float(gap[nearest]), size, called, unit)


Side = Literal["above", "below"]


__all__ = ["Pairing", "Plane", "pair"]


@checks
@computes
@dataclass(frozen=True, eq=False)
class Pairing(ReadOnly):
    """The ``normal``, ``gap`` and ``tangent`` of a ContactProblem; it unpacks as ``E_N, g, E_T``.

    Parameters
    ----------
    normal : (p, n) sparse array
        E_N [-].
    gap : (p,) array
        g, positive when open [length].
    tangent : ((d-1) p, n) sparse array
        E_T, contact-major [-].
    nodes : (p,) array of int
        The node of each contact, by its number in the surface or its index among the points.
    points : (p, d) array
        The positions of those nodes [length].
    direction : (p, d) array
        The unit normal of each contact, out of the obstacle or of the master surface.
    unpaired : (q,) array of int
        Nodes without a contact of their own, ascending.
    area : (p,) array, optional
        The tributary area of each contact, including thickness or full circle [area]; None for bare points. It is
        positive for every kind of facet, but pressures follow from `pressure`.
    projection : NodalPressure, optional
        The projection of forces to pressures; None for bare points.
    notes : tuple of str
        Limits of the pressures of this pairing, such as facets too coarse for the gap between curved sides.
    """

    normal: Any
    gap: Array
    tangent: Any
    nodes: Index
    points: Array
    direction: Array
    unpaired: Index
    area: Array | None = None
    projection: NodalPressure | None = None
    notes: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[Any]:
        return iter((self.normal, self.gap, self.tangent))

    def __repr__(self) -> str:
        gaps = f", gaps from {number(self.gap.min())} to {number(self.gap.max())}" if len(self.gap) else ""
        left = f", {counted('node', len(self.unpaired))} unpaired" if len(self.unpaired) else ""
        noted = f", {counted('note', len(self.notes))}" if self.notes else ""
        unknowns = counted("unknown", self.normal.shape[1])
        return f"Pairing({counted('contact', len(self.gap))} on {unknowns}{gaps}{left}{noted})"

    def pressure(self, normal_force: ArrayLike) -> Array:
        """Return the contact pressure at each node, positive in compression, (p,) [force / area].

        It is the projection of the forces onto the trace of the surface (contactqp.elements.nodal_pressure), for a
        mortar the pressure field that it integrates. Without tensile forces there are no tensile pressures. NaN marks
        unknown forces.

        Raises
        ------
        InvalidProblem
            Bare points have no area; not one force for each contact.
        """
        force = read_array("normal_force", normal_force)
        pressure = self.per_area(force)
        return pressure if np.any(force < 0) else np.maximum(pressure, 0.0)

    def per_area(self, force: ArrayLike) -> Array:
        """Return the same projection of one component of nodal forces, of either sign, such as friction, (p,) [force
        / area].

        Raises
        ------
        InvalidProblem
            Bare points have no area; not one force for each contact.
        """
        given = read_array("normal_force", force)
        if self.projection is None:
            raise InvalidProblem("pressure: points have no area: expected a pairing of a Surface")
        if given.shape != self.gap.shape:
            fewer = given.ndim == 1 and len(given) < len(self.gap)
            left_out = "; a problem leaves out contacts of supported nodes, see System.free_contacts" if fewer else ""
            raise InvalidProblem(f"normal_force: expected shape {self.gap.shape}, got {given.shape}{left_out}")
        return self.projection.of(given)


@checked
@own_floating_point
def pair(
    points: ArrayLike | Surface,
    obstacle: Obstacle,
    *,
    unknowns: ArrayLike | None = None,
    dimension: int | None = None,
) -> Pairing:
    """Pair every point with the obstacle: E_N u <= gap, with E_N = -n' and gap = signed distance of the point.

    The distance is linearised at the initial position, for displacements small against the obstacle's radii of
    curvature.

    Parameters
    ----------
    points : (p, d) array or Surface
        The nodes that may touch [length], d = 1, 2 or 3. The nodes of a surface come with their areas and unknowns.
    obstacle : Plane, Circle, Sphere, Cylinder, Paraboloid or SignedDistance
        Or anything with `dimension`, `distance(points)` and `normals(points)`; normals point to the body's side.
    unknowns : (p, d) array of int, optional
        unknowns[i, a] is the place of node i's displacement along axis a in u. By default u is (p d,), node by node.
    dimension : int, optional
        n, the number of all unknowns; by default that of the surface, or one more than the largest in `unknowns`.

    Returns
    -------
    Pairing
        Unpacks as ``E_N, g, E_T``. The tangents of a point are orthonormal. With a surface `area` is the tributary area
        of each node (contactqp.elements.nodal_pressure).

    Raises
    ------
    InvalidProblem
        Shapes do not fit, numbers are not finite, unknowns are out of range, or the obstacle has no normal at a point.

    Warns
    -----
    StartWarning
        A surface starts inside of the obstacle, deeper than a quarter of the size of its body, or both face the same
        way.

    Examples
    --------
    >>> E_N, g, E_T = pair([[0.0, 0.001]], Plane(point=[0.0, 0.0], normal=[0.0, 1.0]))
    >>> E_N.toarray().tolist(), g.tolist(), E_T.toarray().tolist()
    ([[0.0, -1.0]], [0.001], [[1.0, 0.0]])
    """
    found = paired(points, obstacle, unknowns, dimension)
    if isinstance(points, Surface):
        doubt = doubt_of_side(points, found.gap, found.direction, "the obstacle")
        if doubt:
            warn(f"{points.name}: {doubt}", StartWarning)
    return found


def paired(
    points: ArrayLike | Surface, obstacle: Obstacle, unknowns: ArrayLike | None = None, dimension: int | None = None
) -> Pairing:
    """Return the pairing of `pair`, without its warnings.

    Parameters
    ----------
    points, obstacle, unknowns, dimension
        As in `pair`.
    """
    if isinstance(points, Surface):
        return _pair_surface(points, obstacle, unknowns, dimension)
    x = _points(points, obstacle)
    columns, n = _numbers_of_unknowns(unknowns, x.shape, dimension)
    return _pair_points(x, columns, obstacle, n, np.arange(len(x)))


def _numbers_of_unknowns(
    unknowns: ArrayLike | None, shape: tuple[int, ...], dimension: int | None
) -> tuple[Index, int]:
    """Return the indices of the points' unknowns in this shape, by default in order, and the number of all unknowns."""
    numbers = np.arange(np.prod(shape)).reshape(shape) if unknowns is None else read_whole("unknowns", unknowns)
    if numbers.shape != shape:
        raise InvalidProblem(f"unknowns: expected whole numbers of shape {shape}, got {numbers.dtype} {numbers.shape}")
    if numbers.min(initial=0) < 0:
        raise InvalidProblem(f"unknowns: expected numbers from 0, got {int(numbers.min())}")
    return numbers, count_unknowns(int(numbers.max(initial=-1)), dimension)


def _pair_surface(surface: Surface, obstacle: Obstacle, unknowns: ArrayLike | None, dimension: int | None) -> Pairing:
    if unknowns is not None:
        raise InvalidProblem(f"{surface.name}: expected no `unknowns`, the surface has its own")
    check_surface(surface)
    nodes = surface.nodes
    x = _points(surface.points[nodes], obstacle)
    n = unknowns_of_surfaces(dimension, surface)
    found = _pair_points(x, surface.unknowns[nodes], obstacle, n, nodes)
    return replace(found, area=tributary_areas(surface), projection=nodal_pressure(surface, nodes))


def _pair_points(
    x: Array,
    columns: Index,
    obstacle: Obstacle,
    n: int,
    nodes: Index,
) -> Pairing:
    outward = read_array("obstacle: normals", obstacle.normals(x))
    contact = np.arange(len(x))
    E_N, E_T = contact_rows(contact, np.ones(len(x)), columns, outward, tangent_frames(outward), (len(x), n))
    gap = read_array("obstacle: distances", obstacle.distance(x))
    return Pairing(E_N, gap, E_T, nodes, x, outward, np.array([], dtype=np.int64))


def _points(points: ArrayLike, obstacle: Obstacle) -> Array:
    x = points_near(obstacle, points).astype(float)
    if not np.all(np.isfinite(x)):
        raise InvalidProblem(f"points: expected finite numbers, got {x[~np.isfinite(x)][0]}")
    return x


@checked
@own_floating_point
def pair_scalar(
    points: ArrayLike,
    obstacle_height: ArrayLike | Callable[[Array], Any],
    *,
    side: Side = "above",
    unknowns: ArrayLike | None = None,
    dimension: int | None = None,
) -> Pairing:
    """Pair a scalar field with an obstacle at the nodes: s (u - height) >= 0, s = 1 above and -1 below.

    E_N = -s at the node's unknown and gap = -s height, so that gap - E_N u = s (u - height). The multiplier is the
    force on the membrane at the node, positive along s [force]; a pressure is its projection onto the surface.

    Parameters
    ----------
    points : (p, d) array
        The nodes [length], d = 1, 2 or 3: the domain of u.
    obstacle_height : callable or (p,) array
        Heights [the unit of u], or a function from (p, d) points to them. An infinite height on the far side of the
        membrane (-inf above, +inf below) means that there is no obstacle: the node is left out and listed as unpaired.
    side : "above" or "below"
        The side of the obstacle that the membrane is on.
    unknowns : (p,) array of int, optional
        The place of each node in u; by default 0 to p-1.
    dimension : int, optional
        n, the number of all unknowns; by default one more than the largest in `unknowns`.

    Returns
    -------
    Pairing
        Without tangents: E_T has no rows. `direction` is s, (p, 1).

    Raises
    ------
    InvalidProblem
        Shapes do not fit, heights are NaN or infinite on the membrane's side, or unknowns are out of range.

    Examples
    --------
    >>> pairing = pair_scalar([[0.0, 0.0], [1.0, 0.0]], [0.5, -np.inf])
    >>> pairing.normal.toarray().tolist(), pairing.gap.tolist(), pairing.unpaired.tolist()
    ([[-1.0, 0.0]], [-0.5], [1])
    """
    x = read_array("points", points)
    if x.ndim != 2 or not np.all(np.isfinite(x)):
        raise InvalidProblem(f"points: expected finite numbers of shape (p, d), got shape {x.shape}")
    sign = 1.0 if side == "above" else -1.0
    given = obstacle_height(x) if callable(obstacle_height) else obstacle_height
    height = read_array("obstacle_height", given)
    if height.shape != (len(x),):
        raise InvalidProblem(f"obstacle_height: expected shape ({len(x)},), got {height.shape}")
    wrong = np.flatnonzero(np.isnan(height) | (height == sign * np.inf))
    if wrong.size:
        i = int(wrong[0])
        raise InvalidProblem(f"obstacle_height: expected a number at node {i}, {x[i].tolist()}, got {height[i]}")
    places, n = _numbers_of_unknowns(unknowns, (len(x),), dimension)
    nodes = np.flatnonzero(np.isfinite(height))
    one = np.ones(len(nodes))
    normals = sign * one[:, np.newaxis]
    contact, columns = np.arange(len(nodes)), places[nodes, np.newaxis].astype(np.int64)
    E_N, E_T = contact_rows(contact, one, columns, normals, np.zeros((len(nodes), 0, 1)), (len(nodes), n))
    unpaired = np.flatnonzero(~np.isfinite(height))
    return Pairing(E_N, -sign * height[nodes], E_T, nodes, x[nodes], normals, unpaired)


def contact_rows(
    contact: Index, weight: Array, unknowns: Index, normals: Array, tangents: Array, shape: tuple[int, int]
) -> tuple[Any, Any]:
    """Return E_N and E_T of contacts that approach by -n.w and slip by t.w, w = sum over the entries of weight
    u_node.

    Entries of one contact add up. A node that meets an obstacle is one entry of weight 1; a node that meets a facet has
    further ones of weight -N_j for the facet's nodes.

    Parameters
    ----------
    contact : (e,) array of int, the contact that an entry belongs to
    weight : (e,) array [-]
    unknowns : (e, d) array of int, indices in u of the displacement of the entry's node
    normals : (e, d) array, n, unit vectors out of the obstacle
    tangents : (e, d-1, d) array, orthonormal
    shape : (contacts, n)

    Returns
    -------
    (contacts, n) and ((d-1) contacts, n) sparse arrays, the second contact-major.
    """
    contacts, n = shape
    d = unknowns.shape[1]
    along = (np.arange(d - 1) + (d - 1) * contact[:, np.newaxis])[:, :, np.newaxis]
    E_N = _sum((-weight[:, np.newaxis] * normals, contact[:, np.newaxis], unknowns), (contacts, n))
    E_T = _sum((weight[:, None, None] * tangents, along, unknowns[:, np.newaxis, :]), ((d - 1) * contacts, n))
    return E_N, E_T


def _sum(entries: tuple[Array, Index, Index], shape: tuple[int, int]) -> Any:
    values, rows, columns = (np.broadcast_to(part, entries[0].shape).ravel() for part in entries)
    matrix = sp.csr_array(sp.coo_array((values, (rows, columns)), shape=shape))
    matrix.eliminate_zeros()
    return matrix


def unknowns_of_surfaces(dimension: int | None, *surfaces: Surface) -> int:
    """Return n: as stated, else the largest that is known of a surface.

    Raises InvalidProblem as `count_unknowns`.
    """
    largest = max(int(surface.unknowns.max()) for surface in surfaces)
    known = [surface.unknown_count - 1 for surface in surfaces if surface.unknown_count is not None]
    return count_unknowns(max(largest, *known) if dimension is None and known else largest, dimension)


def count_unknowns(largest: int, dimension: int | None) -> int:
    """Return n: as stated, else one more than the largest number in use.

    Raises InvalidProblem: an index beyond the stated dimension, or a dimension that is not an integer.
    """
    if dimension is None:
        return largest + 1
    if not is_whole(dimension):
        raise InvalidProblem(f"dimension: expected the number of all unknowns, got {shown(dimension)}")
    if largest >= dimension:
        raise InvalidProblem(f"unknowns: expected numbers from 0 to {dimension - 1}, got {largest}")
    return dimension
