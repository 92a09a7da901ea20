"""From nodal contact forces to nodal pressures: the projection onto the dual basis of the side's own trace.

A pressure p does the work F_i = int N_i p dA at node i, so that nodal forces are moments of the pressure. The value q_j
that belongs to a function psi_j = sum_i C_ij N_i is the moment with it over its integral,

    q_j = int psi_j p dA / int psi_j dA = (C' F)_j / (C' a)_j,    a_i = int N_i dA,    sum_j psi_j = 1.

A constant pressure comes out exactly at every node, and sum_j (C' a)_j q_j is the resultant. The q_j are those of the
projection with functions biorthogonal to psi (Wohlmuth 2000), as the mortar has them. The consistent mass matrix,
M p = F, is not solved: it enlarges what is uneven from node to node several times, and the forces of meshes that do not
match, of linear simplices and of one-sided contact at quadratic corners are uneven.

dA carries the thickness of a plane body and 2 pi r of a revolved one, as the forces do. The functions psi by facet:

    line2, line3, tri3, quad4, quad9    N_i of each node.
    tri6     One function for each middle of an edge, where alone a constant pressure has forces: its N, and equal
             shares of those of the corners beside it. The value in a corner is the mean over its facets of the plane
             through the three middles.
    quad8    The bilinear functions of the corners, as combinations of the eight: a constant pressure pulls at the
             corners, where a one-sided contact lets go instead, and only sums over corner and middles still are
             right. A middle's value is the mean of its two corners.
    revolved A node on the axis has no area of its own on line3, and little on line2. A smooth pressure has no slope
             there, which ties the value p_0 on the axis to those of the rest of its facet: p_0 = p_1 on line2,
             p_0 = (4 p_middle - p_1) / 3 on line3.

Where nodes meet the facets of another mesh, how the force is shared between a corner and a middle depends on where the
other nodes are. There every quadratic facet has the linear functions of its corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from contactqp.elements.facet import KINDS, FacetKind, diameters, kind_of
from contactqp.elements.reading import real_array
from contactqp.elements.surface import Surface
from contactqp.elements.tributary import shape_integrals
from contactqp.errors import InvalidProblem
from contactqp.problem_data import ReadOnly

Vector = NDArray[np.float64]
Index = NDArray[np.int64]
# A node is on the axis of symmetry if it is nearer to it than so many diameters of its facet.
ON_AXIS = 1e-9


@dataclass(frozen=True, eq=False)
class NodalPressure(ReadOnly):
    """How the forces of p nodes become pressures.

    Attributes
    ----------
    collected : (p, q) sparse array
        C, the functions psi in those of the nodes [-].
    integral : (p,) array
        a, the nodal forces of a unit pressure [area].
    evaluated : (p, q) sparse array
        The value at each node from the q values of the projection [-].
    """

    collected: Any
    integral: Vector
    evaluated: Any

    def of(self, force: ArrayLike) -> Vector:
        """Forces per area at the nodes, of either sign, (p,) [force / area].

        A force that is not known, NaN, is left out with its part of the area, and the value at its node is NaN. So is
        one whose functions have no known node.
        """
        given = real_array("force", force)
        known = np.isfinite(given)
        area = self.collected.T @ np.where(known, self.integral, 0.0)
        least = abs(self.collected.T) @ np.where(known, abs(self.integral), 0.0)
        there = area > np.finfo(float).eps * least
        moment = self.collected.T @ np.where(known, given, 0.0)
        value = np.where(there, moment / np.where(there, area, 1.0), np.nan)
        return np.where(known, self.evaluated @ value, np.nan)


def from_areas(area: Vector) -> NodalPressure:
    """Of forces that each have an area of their own: force / area."""
    each = sp.csr_array(sp.identity(len(area), format="csr"))
    return NodalPressure(each, area, each)


def nodal_pressure(
    surface: Surface, nodes: Index, *, covered: Vector | None = None, linear: bool = False
) -> NodalPressure:
    """The projection for some nodes of a surface, those that have a contact; on the others there is no pressure.

    A facet's node without contact hands its N to those that have one, so that all psi still sum to 1 up to the boundary
    of contact.

    Parameters
    ----------
    surface : Surface
    nodes : (p,) array of int
        Ascending.
    covered : (facets,) array, optional
        Which part of each facet has a partner [-]; by default all of them all.
    linear : bool
        Whether quadratic facets have the linear functions of their corners, whatever their kind.

    Raises
    ------
    InvalidProblem
        A function whose integral is not positive: a middle node far off the middle of its facet.
    """
    facets = np.searchsorted(surface.nodes, surface.facets)
    size, at = len(surface.nodes), np.searchsorted(surface.nodes, nodes)
    collected, evaluated = _functions(surface, facets, size, linear)
    integral = shape_integrals(surface)
    if covered is not None:
        integral = integral * covered[:, np.newaxis]
    whole = np.bincount(facets.ravel(), integral.ravel(), minlength=size)
    used = np.flatnonzero(abs(collected).sum(axis=0))
    area = (collected.T @ whole)[used]
    if area.min() <= 0 and covered is None:
        node = int(surface.nodes[used[np.argmin(area)]])
        raise InvalidProblem(
            f"{surface.name}: node {node}: expected a positive area that its pressure acts on, got {area.min():.3g}: "
            "its facets are too distorted"
        )
    mine = np.isin(facets, at)
    handed = np.where(mine, 0.0, integral).sum(axis=1, keepdims=True) / np.maximum(mine.sum(axis=1, keepdims=True), 1)
    whole = np.bincount(facets.ravel(), np.where(mine, integral + handed, 0.0).ravel(), minlength=size)
    return NodalPressure(collected[at][:, used], whole[at].astype(np.float64), evaluated[at][:, used])


def _sparse(rows: Index, columns: Index, values: Vector, size: int) -> Any:
    return sp.csr_array(sp.coo_array((values, (rows, columns)), shape=(size, size)))


def _functions(surface: Surface, facets: Index, size: int, linear: bool) -> tuple[Any, Any]:
    """C and the values at the nodes, as NodalPressure has them, over all nodes of the surface."""
    kind = kind_of(surface)
    if kind.name == "tri6" and not linear:
        return _middles(facets, size)
    of_corners = kind.name == "quad8" or (linear and kind.quadratic)
    each = np.arange(size)
    functions = _corners(kind, facets, size) if of_corners else _sparse(each, each, np.ones(size), size)
    if surface.revolved:
        functions = functions @ _without_axis(surface, facets[:, :2] if of_corners else facets, size)
    return functions, functions


def _corners(kind: FacetKind, facets: Index, size: int) -> Any:
    """The linear functions of the corners at all nodes; facets (p, k)."""
    corners = KINDS[kind.nodes.shape[1] + 1, kind.corners]
    values = corners.shape(kind.nodes)
    node, corner = np.nonzero(np.abs(values) > np.finfo(float).eps)
    pairs = np.column_stack([facets[:, node].ravel(), facets[:, corner].ravel()])
    entries, first = np.unique(pairs, axis=0, return_index=True)
    return _sparse(entries[:, 0], entries[:, 1], np.tile(values[node, corner], len(facets))[first], size)


def _middles(facets: Index, size: int) -> tuple[Any, Any]:
    """Corners hand their forces to the middles beside them, and have their values from them; facets (p, 6)."""
    corner, after, opposite = facets[:, :3], facets[:, 3:], np.roll(facets[:, 3:], -1, axis=1)
    before = np.roll(after, 1, axis=1)
    beside = np.unique(np.column_stack([np.tile(corner.ravel(), 2), np.r_[after.ravel(), before.ravel()]]), axis=0)
    share = 1 / np.bincount(beside[:, 0], minlength=size)[beside[:, 0]]
    middle = np.unique(after)
    rows, columns = np.concatenate([beside, np.column_stack([middle, middle])]).T
    collected = _sparse(rows, columns, np.concatenate([share, np.ones(len(middle))]), size)
    mean = 1 / np.bincount(corner.ravel(), minlength=size)[corner]
    rows = np.concatenate([np.tile(corner.ravel(), 3), middle])
    columns = np.concatenate([after.ravel(), before.ravel(), opposite.ravel(), middle])
    values = np.concatenate([mean.ravel(), mean.ravel(), -mean.ravel(), np.ones(len(middle))])
    return collected, _sparse(rows, columns, values, size)


def _without_axis(surface: Surface, facets: Index, size: int) -> Any:
    """Each node has its own value but those on the axis, which have no slope along their facet; facets (p, 2 or 3)."""
    r = surface.points[surface.facets[:, :2], 0]
    on_axis = np.abs(r) <= ON_AXIS * diameters(surface.points[surface.facets])[:, np.newaxis]
    facet, end = np.nonzero(on_axis & ~on_axis[:, ::-1])
    axis, other = facets[facet, end], facets[facet, 1 - end]
    single = np.setdiff1d(np.arange(size), axis)
    rows, columns, values = [single, axis], [single, other], [np.ones(len(single)), np.ones(len(axis))]
    if facets.shape[1] == 3:
        values[1] = np.full(len(axis), -1 / 3)
        rows.append(axis)
        columns.append(facets[facet, 2])
        values.append(np.full(len(axis), 4 / 3))
    return _sparse(np.concatenate(rows), np.concatenate(columns), np.concatenate(values), size)
