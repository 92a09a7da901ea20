"""From nodal contact forces to nodal pressures: the projection onto the dual basis of the side's own trace.

A pressure p does the work F_i = int N_i p dA at node i, so that nodal forces are moments of the pressure. The value q_j
that belongs to a function psi_j = sum_i C_ij N_i is the moment with it over its integral,

    q_j = int psi_j p dA / int psi_j dA = (C' F)_j / (C' a)_j,    a_i = int N_i dA,    sum_j psi_j = 1.

A constant pressure comes out exactly at every node, and sum_j (C' a)_j q_j is the resultant. The q_j are those of the
projection with functions biorthogonal to psi (Wohlmuth 2000), as in the mortar. The system with the consistent mass
matrix, M p = F, is not solved: it amplifies oscillations from node to node several times, and forces oscillate on
nonmatching meshes, on linear simplices and for unilateral contact at quadratic corners.

Such a mean belongs to the middle x_j = int psi_j x dA / int psi_j dA, which at the end of a side is a third of a facet
away from the node, and off the node too where facets of two sizes meet. The value at node i is therefore

    p_i = sum_j (C_ij + D_ij) q_j,    sum_j C_ij = 1,    sum_j D_ij = 0,    sum_j (C_ij + D_ij) x_j = x_i,

the last along the side, with the smallest D over the functions around the node, so that a pressure that varies linearly
over a flat side is exact at every node, its ends included. There are two: over the facets at the node, and over their
neighbours too but without the node's own function. The smaller D q is used if both have one sign: the first gives zero
slope at a plane of symmetry, the second does not follow the singularity at a punch's edge. It is limited to half of C
q, so that the pressure has the sign of the forces and vanishes with them, also where it falls to zero within a facet.

dA carries the thickness of a plane body and 2 pi r of a revolved one, as the forces do. The functions psi by facet:

    line2, line3, tri3, quad4, quad9    N_i of each node.
    tri6     One function for each middle of an edge, where alone a constant pressure has forces: its N, and equal
             shares of those of the corners beside it, whose value is the mean of the middles beside them.
    quad8    The bilinear functions of the corners, as combinations of the eight: a constant pressure pulls at the
             corners, where a one-sided contact lets go instead, and only sums over corner and middles still are
             right. A middle's value is the mean of its two corners.
    revolved A node on the axis has no area of its own on line3, and little on line2: it hands its force to the nearest
             node of its facet, and begins with that node's value. A smooth pressure varies with r^2 there, so that D
             is the smallest with sum_j (C_ij + D_ij) int psi_j r^2 dA / int psi_j dA = 0: a parabola is exact.

Where nodes meet the facets of another mesh, how the force is shared between a corner and a middle depends on where the
other nodes are. There every quadratic facet has the linear functions of its corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.elements.surface import KINDS, FacetKind, Surface, diameters, kind_of, normal_vectors, tangent_vectors
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import EPS, Array, Index, Mask, Vector
from contactqp.model.problem_data import ReadOnly, read_array

# Per direction: exact for the shape functions on facets with straight edges, 1e-6 or better on curved ones.
GAUSS_POINTS = 5
# The shape functions whose integral is zero (tri6) or negative (quad8) at the corners.
NOT_POSITIVE = ("tri6", "quad8")
# A note is written if facets change the pressure by this part of it or more.
NOTABLE = 0.1
# Cosine of 30 degrees: a facet's normal that deviates more from the mean of its neighbours' marks a true edge.
EDGE = np.cos(np.pi / 6)
# Facets match where the nodes of one side stand over nodes of the other, to this part of the distance between nodes.
MATCHING = 0.05
# Facets that bend less against each other are flat [radians].
FLAT = 1e-9


def tributary_areas(surface: Surface) -> Array:
    """Return a_i, the integral of N_i over the facets, one for each of `surface.nodes`, positive [area].

    In 2D the integral is over the thickness, a_i = t integral of N_i ds, so that with t = 1 areas and forces are both
    per unit thickness; on a revolved surface over full circles, a_i = integral of 2 pi r N_i ds.

    The integrals of six-node triangles and eight-node quadrilaterals are zero (tri6) or negative (quad8, -1/12 of the
    facet's area) at the corners, that of revolved quadratic facets is zero at a node on the axis. For these the areas
    are a_i = A_f int N_i^2 / sum_j int N_j^2 on each facet (Hinton, Rock & Zienkiewicz 1976): positive and of the right
    sum. Such an area is only a weight of its node; pressures are computed by `nodal_pressure`.

    Raises InvalidProblem: an area that is not positive: a middle node far off the middle of its facet.
    """
    kind = kind_of(surface)
    shape, elements = _surface_elements(surface)
    if kind.name in NOT_POSITIVE or (surface.revolved and kind.quadratic):
        squares = elements @ shape**2
        parts = squares * (elements.sum(axis=1) / squares.sum(axis=1))[:, np.newaxis]
    else:
        parts = elements @ shape
    areas = _summed(surface, parts)
    if areas.min() <= 0:
        node = int(surface.nodes[np.argmin(areas)])
        raise InvalidProblem(
            f"{surface.name}: node {node}: expected a positive tributary area, got {areas.min():.3g}: "
            "its facets are too distorted"
        )
    return areas


def nodal_moments(surface: Surface) -> Array:
    """Return int N_i (1, x, x_0^2) dA over each facet, (p, k, 2 + d): first the nodal forces of a unit pressure
    [area].
    """
    shape, elements = _surface_elements(surface)
    x = np.einsum("qk,pkd->pqd", shape, surface.points[surface.facets])
    functions = np.concatenate([np.ones_like(x[:, :, :1]), x, x[:, :, :1] ** 2], axis=2)
    moments: Array = np.einsum("pq,qk,pqc->pkc", elements, shape, functions, optimize=True)
    return moments


def node_normals(surface: Surface) -> Array:
    """Return the unit vectors along the sum of the normals of the facets at each of `surface.nodes`, (nodes, d).

    Facets count by their surface element at the node. Where the sum vanishes (both sides of a sheet) it is zero.
    """
    normals = _normals_at(surface, kind_of(surface).nodes)  # (p, k, d)
    total = np.zeros(surface.points.shape)
    np.add.at(total, surface.facets, normals)
    total = total[surface.nodes]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.where(length > 0, length, 1.0)


def facet_normals(surface: Surface) -> Array:
    """Return the outward unit normal of each facet at each of its nodes, (p, k, d)."""
    normals = _normals_at(surface, kind_of(surface).nodes)
    unit: Array = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    return unit


def _surface_elements(surface: Surface) -> tuple[Array, Array]:
    """Return N_i at the Gauss points, (q, k), and dA of each facet there with its thickness or circle, (p, q)
    [area].
    """
    kind = kind_of(surface)
    xi, weights = kind.quadrature(GAUSS_POINTS)
    shape = kind.shape(xi)
    elements = np.linalg.norm(_normals_at(surface, xi), axis=2) * weights * surface.thickness
    if surface.revolved:
        elements = elements * 2 * np.pi * (surface.points[surface.facets][:, :, 0] @ shape.T)
    return shape, elements


def _summed(surface: Surface, parts: Array) -> Array:
    """Return the parts of facets (p, k) added up at each of `surface.nodes`."""
    total = np.bincount(surface.facets.ravel(), parts.ravel(), minlength=len(surface.points))
    return total[surface.nodes].astype(np.float64)


def _normals_at(surface: Surface, xi: Array) -> Array:
    """Return the normal vectors of all facets at the reference points, as long as the surface element, (p, q, d)."""
    kind = kind_of(surface)
    positions = surface.points[surface.facets]
    derivatives = kind.derivatives(xi)
    at = [
        normal_vectors(tangent_vectors(positions, np.broadcast_to(here, (len(positions), *here.shape))))
        for here in derivatives
    ]
    return np.stack(at, axis=1)


def faceting_notes(slave: Surface, master: Surface, gap: Array) -> tuple[str, ...]:
    """Return a note if both sides are curved, their facets do not match, and these change the pressure by NOTABLE.

    A facet of length L on a circle of radius R spans the angle theta = L / R, and its middle is off the circle by the
    sagitta f = L theta / 8. Where its middle meets the corner of another facet, the two overlap by about f too much.
    That changes the pressure by about E f / L. To close a gap or interference g of the bodies takes E g / R. The ratio
    of the two is (f / theta) / g: by this part the pressure changes from node to node, and its mean by f / g. Of
    quadratic facets f follows from the kinks between them (`deviation`).
    """
    largest = float(np.max(np.abs(gap), initial=0.0))
    errors = deviation(slave), deviation(master)
    if min(errors) == 0 or nodes_over(slave, master) is not None:
        return ()
    wave = sum(float(np.max(bow / np.maximum(turn, FLAT))) for bow, turn in (_bows(slave), _bows(master)))
    if wave < NOTABLE * largest:
        return ()
    part = f"about {wave / largest:.2g} times what it takes to close that" if largest > 0 else "as much as itself"
    return (
        f"{slave.name} on {master.name}: both sides are curved and their facets do not match: they are off by up to "
        f"{errors[0]:.3g} and {errors[1]:.3g} [length] where gap or interference is at most {largest:.3g}, so that the "
        f"facets change the pressure by {part} from node to node; finer or quadratic elements, or facets that match, "
        "are needed",
    )


def deviation(surface: Surface) -> float:
    """Return the largest distance between the facets and the smooth surface through their nodes, estimated [length].

    Along the line s L t between two corners of a facet the smooth surface leaves it at the slopes k.t, with the kinks
    k = n - n_f of the smooth normal against the facet's: by k.t L s (1 - s) at most, L (|k_i.t| + |k_j.t|) / 8 in the
    middle. On quadratic facets, which have a node there, by k.t L s (1 - s) (1 - 2 s)^2, a quarter of that. Edges of
    more than 30 degrees are not curvature.
    """
    return float(np.max(_bows(surface)[0]))


def _bows(surface: Surface) -> tuple[Array, Array]:
    """Return how far each line between two corners of a facet is off the smooth surface [length], and its normal's
    turn.
    """
    kind, kink = kind_of(surface), kinks(surface)
    smooth = facet_normals(surface)[:, : kind.corners] + kink
    i, j = np.triu_indices(kind.corners, 1)
    line = surface.points[surface.facets[:, j]] - surface.points[surface.facets[:, i]]
    bend = np.abs((kink[:, i] * line).sum(axis=2)) + np.abs((kink[:, j] * line).sum(axis=2))
    bend[bend <= FLAT * np.linalg.norm(line, axis=2)] = 0.0
    return bend / (32 if kind.quadratic else 8), np.linalg.norm(smooth[:, i] - smooth[:, j], axis=2)


def kinks(surface: Surface) -> Array:
    """Return n - n_f in each corner of each facet, (f, corners, d): zero where it has no neighbour, or at a true
    edge.
    """
    corners = kind_of(surface).corners
    smooth = np.zeros(surface.points.shape)
    smooth[surface.nodes] = node_normals(surface)
    kink: Array = smooth[surface.facets[:, :corners]] - facet_normals(surface)[:, :corners]
    kink[(kink**2).sum(axis=2) > 2 * (1 - EDGE)] = 0.0
    return kink


def same_facets(slave: Surface, master: Surface) -> bool:
    """Return whether each facet of the slave faces a facet of the master with nodes at the same places."""
    over = nodes_over(slave, master)
    if over is None or slave.facets.shape[1] != master.facets.shape[1]:
        return False
    partner = np.sort(over[np.searchsorted(slave.nodes, slave.facets)], axis=1)
    both = np.concatenate([np.unique(np.sort(master.facets, axis=1), axis=0), np.unique(partner, axis=0)])
    return len(np.unique(both, axis=0)) == len(master.facets)


def nodes_over(slave: Surface, master: Surface) -> Index | None:
    """Return the master node that faces each of `slave.nodes`, where each has one: offsets along the side vanish."""
    points, others, normals = slave.points[slave.nodes], master.points[master.nodes], node_normals(slave)
    _, nearest = scipy.spatial.cKDTree(others).query(points)
    apart = others[nearest] - points
    along = apart - (apart * normals).sum(axis=1, keepdims=True) * normals
    spacing = scipy.spatial.cKDTree(points).query(points, k=2)[0][:, 1]
    return master.nodes[nearest] if (np.linalg.norm(along, axis=1) <= MATCHING * spacing).all() else None


# A node is on the axis of symmetry if it is nearer to it than so many diameters of its facet.
ON_AXIS = 1e-9
# A pressure at a node differs from the mean around it by at most this part of the mean: a positive contact force then
# never gives a pressure of zero or below, even if the forces oscillate from node to node.
LARGEST_CHANGE = 0.5
# Offsets of less than this part of the distances between the middles are rounding, as are the squares of spreads.
ROUNDING_OF_OFFSETS = 1e-12


@dataclass(frozen=True, eq=False)
class NodalPressure(ReadOnly):
    """The projection from the forces of p nodes to pressures at them.

    Attributes
    ----------
    collected : (p, q) sparse array
        C, the functions psi in those of the nodes, and so also the mean at each node of the values beside it [-].
    integral : (p,) array, a, the nodal forces of a unit pressure [area]
    near, far : (p, q) sparse arrays, the two D, from the middle of each function to the node [-]
    """

    collected: Any
    integral: Vector
    near: Any
    far: Any

    def of(self, force: ArrayLike) -> Vector:
        """Return forces per area at the nodes, of either sign, (p,) [force / area].

        An unknown force, NaN, is left out with its part of the area, and the value at its node is NaN, as is a value
        whose functions have no known node. Beside it D is not used.
        """
        given = read_array("force", force)
        finite = np.isfinite(given)
        area = self.collected.T @ np.where(finite, self.integral, 0.0)
        least = abs(self.collected.T) @ np.where(finite, abs(self.integral), 0.0)
        there = area > EPS * least
        moment = self.collected.T @ np.where(finite, given, 0.0)
        value = np.where(there, moment / np.where(there, area, 1.0), np.nan)
        nodal = self.collected @ value
        near, far = (D @ np.where(there, value, 0.0) for D in (self.near, self.far))
        size = np.minimum(np.minimum(np.abs(near), np.abs(far)), LARGEST_CHANGE * np.abs(nodal))
        whole = (abs(self.near) + abs(self.far)) @ (~there).astype(float) == 0
        change = np.where(whole & (np.sign(near) == np.sign(far)), np.sign(near) * size, 0.0)
        return np.where(finite, nodal + change, np.nan)


def from_areas(area: Vector) -> NodalPressure:
    """Return the projection of forces that each have an area of their own: force / area."""
    each = sp.csr_array(sp.identity(len(area), format="csr"))
    return NodalPressure(each, area, 0 * each, 0 * each)


def nodal_pressure(
    surface: Surface, nodes: Index, *, covered: Vector | None = None, uneven: bool = False
) -> NodalPressure:
    """Return the projection for the nodes of a surface that have a contact; the others carry no pressure.

    The shape function of a node without contact is added to those of the facet's other nodes, so that all psi sum to 1
    up to the boundary of contact.

    Parameters
    ----------
    surface : Surface
    nodes : (p,) array of int
        Ascending.
    covered : (facets,) array, optional
        The part of each facet that has a partner [-]; by default 1.
    uneven : bool
        Whether the forces are those of nodes on facets of another mesh: quadratic facets have the linear functions of
        their corners, whatever their kind, and D, which would enlarge what is uneven at the ends, is left out.

    Raises
    ------
    InvalidProblem
        A function whose integral is not positive: a middle node far off the middle of its facet.
    """
    facets = np.searchsorted(surface.nodes, surface.facets)
    size, at = len(surface.nodes), np.searchsorted(surface.nodes, nodes)
    collected = _functions(surface, facets, size, uneven)
    part = nodal_moments(surface)
    if covered is not None:
        part = part * covered[:, np.newaxis, np.newaxis]
    whole = np.bincount(facets.ravel(), part[:, :, 0].ravel(), minlength=size)
    used = np.flatnonzero(abs(collected).sum(axis=0))
    area = (collected.T @ whole)[used]
    if area.min() <= 0 and covered is None:
        node = int(surface.nodes[used[np.argmin(area)]])
        raise InvalidProblem(
            f"{surface.name}: node {node}: expected a positive area that its pressure acts on, got {area.min():.3g}: "
            "its facets are too distorted"
        )
    moments = np.zeros((size, part.shape[2]))
    np.add.at(moments, facets, _handed(part, np.isin(facets, at)))
    if uneven:
        near = far = 0 * collected
    else:
        near, far = (_change(surface, facets, collected, moments, far=far) for far in (False, True))
    return NodalPressure(collected[at][:, used], moments[at, 0], near[at][:, used], far[at][:, used])


def _handed(part: Vector, mine: Mask) -> Vector:
    """Return the parts (f, k, c) of nodes without contact, distributed equally to those with one, `mine` (f, k)."""
    kept = mine[:, :, np.newaxis]
    handed = np.where(kept, 0.0, part).sum(axis=1, keepdims=True) / np.maximum(kept.sum(axis=1, keepdims=True), 1)
    return np.where(kept, part + handed, 0.0)


def _change(surface: Surface, facets: Index, collected: Any, moments: Vector, *, far: bool) -> Any:
    """Return D of all nodes from the integrals of N_i, N_i x and N_i x_0^2, (size, 2 + d): least squares along the
    side.

    The functions at a node i are those of its facets, or those of their neighbours too (`far`) but for its own. With
    the offsets c_ij of their middles x_j from the mean of these, H_i = sum_j c_ij c_ij', and the offset
    r_i = sum_j C_ij x_j - x_i of C's own middle from the node, D_ij = -c_ij . H_i^+ r_i. On the axis r^2 takes the
    place of x, and the neighbours are always taken.
    """
    size, d, on_axis = len(surface.nodes), surface.dimension, _on_axis(surface)[:, np.newaxis]
    x, normals = (np.where(on_axis, 0.0, each) for each in (surface.points[surface.nodes], node_normals(surface)))
    moments = collected.T @ moments
    there = moments[:, 0] > 0
    mean = moments[:, 1:] / np.where(there, moments[:, 0], 1.0)[:, np.newaxis]
    middle, squared = mean[:, :d], mean[:, d:] * np.eye(d)[0]
    beside = sp.coo_array((np.ones(facets.size), (facets.ravel(), np.arange(facets.size) // facets.shape[1]))).tocsr()
    around = beside @ (beside.T @ sp.diags_array(there.astype(float)))
    wide = sp.diags_array((far | on_axis[:, 0]).astype(float))
    i, j = np.stack((around + wide @ (beside @ (beside.T @ around))).nonzero())
    if far:
        i, j = i[i != j], j[i != j]

    def over(values: Vector) -> Vector:
        return np.stack([np.bincount(i, column, minlength=size) for column in values.T], axis=1)

    def along(vectors: Vector, normal: Vector) -> Vector:
        tangential: Vector = vectors - (vectors * normal).sum(axis=1, keepdims=True) * normal
        return tangential

    place = np.where(on_axis[i], squared[j], middle[j])
    centre = over(place) / np.maximum(np.bincount(i, minlength=size), 1)[:, np.newaxis]
    c = along(place - centre[i], normals[i])
    H = over((c[:, :, np.newaxis] * c[:, np.newaxis, :]).reshape(-1, d * d)).reshape(-1, d, d)
    r = along(np.where(on_axis, collected @ squared, collected @ middle) - x, normals)
    r[np.linalg.norm(r, axis=1) <= ROUNDING_OF_OFFSETS * np.sqrt(np.trace(H, axis1=1, axis2=2))] = 0.0
    slope = np.einsum("iab,ib->ia", np.linalg.pinv(H, rcond=ROUNDING_OF_OFFSETS, hermitian=True), r)
    changed = np.any(r != 0, axis=1)[i]
    return _sparse(i[changed], j[changed], -(c * slope[i]).sum(axis=1)[changed], size)


def _sparse(rows: Index, columns: Index, values: Vector, size: int) -> Any:
    return sp.csr_array(sp.coo_array((values, (rows, columns)), shape=(size, size)))


def _functions(surface: Surface, facets: Index, size: int, uneven: bool) -> Any:
    """Return C over all nodes of the surface."""
    kind = kind_of(surface)
    if kind.name == "tri6" and not uneven:
        return _middles(facets, size)
    of_corners = kind.name == "quad8" or (uneven and kind.quadratic)
    each = np.arange(size)
    functions = _corners(kind, facets, size) if of_corners else _sparse(each, each, np.ones(size), size)
    if surface.revolved:
        functions = functions @ _without_axis(surface, facets[:, :2] if of_corners else facets, size)
    return functions


def _corners(kind: FacetKind, facets: Index, size: int) -> Any:
    """Return the linear functions of the corners at all nodes; facets (p, k)."""
    corners = KINDS[kind.nodes.shape[1] + 1, kind.corners]
    values = corners.shape(kind.nodes)
    node, corner = np.nonzero(np.abs(values) > EPS)
    pairs = np.column_stack([facets[:, node].ravel(), facets[:, corner].ravel()])
    entries, first = np.unique(pairs, axis=0, return_index=True)
    return _sparse(entries[:, 0], entries[:, 1], np.tile(values[node, corner], len(facets))[first], size)


def _middles(facets: Index, size: int) -> Any:
    """Return C of corners whose forces go to the middles beside them and whose value is the mean of these; facets (p,
    6).
    """
    after = facets[:, 3:]
    pairs = np.column_stack(
        [np.tile(facets[:, :3].ravel(), 2), np.r_[after.ravel(), np.roll(after, 1, axis=1).ravel()]]
    )
    corner, beside = np.unique(pairs, axis=0).T
    share, middle = 1 / np.bincount(corner, minlength=size)[corner], np.unique(after)
    rows, columns = np.concatenate([corner, middle]), np.concatenate([beside, middle])
    return _sparse(rows, columns, np.concatenate([share, np.ones(len(middle))]), size)


def _without_axis(surface: Surface, facets: Index, size: int) -> Any:
    """Return C where nodes on the axis take the value of the nearest node of their facet, the middle one if there is
    one; facets (p, k).
    """
    on_axis = _on_axis(surface)[facets[:, :2]]
    facet, end = np.nonzero(on_axis & ~on_axis[:, ::-1])
    axis, nearest = facets[facet, end], facets[facet, 2 if facets.shape[1] == 3 else 1 - end]
    single = np.setdiff1d(np.arange(size), axis)
    return _sparse(np.r_[single, axis], np.r_[single, nearest], np.ones(len(single) + len(axis)), size)


def _on_axis(surface: Surface) -> Mask:
    """Return which of `surface.nodes` lie on the axis of a revolved surface."""
    if not surface.revolved:
        return np.zeros(len(surface.nodes), dtype=bool)
    size = np.zeros(len(surface.points))
    np.maximum.at(size, surface.facets, diameters(surface.points[surface.facets])[:, np.newaxis])
    return np.asarray(np.abs(surface.points[surface.nodes, 0]) <= ON_AXIS * size[surface.nodes])
