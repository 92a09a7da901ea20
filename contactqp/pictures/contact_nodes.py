"""Which node of which body each contact belongs to, and the area that its force is spread over."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.elements.geometry import at_rule, sum_at_nodes
from contactqp.elements.pairing import Pairing
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure
from contactqp.errors import InvalidProblem

Index = NDArray[np.int64]
# A contact's point is a copy of its node's coordinates; what is further off, relative to the structure, is another one.
SAME_PLACE = 1e-9
# A node whose int N_i r ds is less than this part of int |N_i| r ds has no area: a quadratic facet's node on the axis.
CANCELLED = 0.05


def contact_nodes(structure: Structure, pairing: Pairing, name: str) -> tuple[Index, Index, bool]:
    """The bodies (p,) and, within them, the nodes (p,) that the pairing's forces press on along `direction`.

    Third, whether the partner is an obstacle: no row then touches another node than its contact's own.

    Found from the rows: a contact moves by -n.(w_i u_i + ...), so its own node is the one at its point with w_i > 0;
    the nodes of a master surface have w_i < 0.

    Raises
    ------
    InvalidProblem
        A contact whose row touches no node of the structure at its point.
    """
    d = int(structure.bodies[0].mesh.points.shape[1])
    points = np.concatenate([body.mesh.points for body in structure.bodies])
    rows = sp.coo_array(pairing.normal)
    weight = -rows.data * pairing.direction[rows.row, rows.col % d]
    summed = sp.coo_array((weight, (rows.row, rows.col // d)), shape=(len(pairing.gap), len(points))).tocsr().tocoo()
    mine = summed.data > 0
    contact, node = summed.row[mine], summed.col[mine]
    distance = np.linalg.norm(points[node] - pairing.points[contact], axis=1)
    near = distance <= SAME_PLACE * np.ptp(points, axis=0).max()
    found = np.full(len(pairing.gap), -1)
    found[contact[near]] = node[near]
    if len(found) and found.min() < 0:
        i = int(np.argmin(found))
        raise InvalidProblem(
            f"{name}: contact {i} at {pairing.points[i].tolist()}: expected a node of the structure at this point in "
            "its row, got none"
        )
    first = np.cumsum([0, *[len(body.mesh.points) for body in structure.bodies]])
    owner = np.searchsorted(first, found, side="right") - 1
    return owner, found - first[owner], bool(np.all(rows.col // d == found[rows.row]))


def contact_areas(structure: Structure, pairing: Pairing, owner: Index, node: Index) -> NDArray[np.float64] | None:
    """What each contact's force is divided by to give a pressure, (p,) [length^2]; None for a pairing without areas.

    The area a_i of a plane pairing is a length: here it is multiplied by the body's thickness, and in axial symmetry,
    where forces are those of the full circle, by 2 pi int N_i r ds / int N_i ds over the facets between the contact
    nodes. On the axis that vanishes for straight quadratic facets and all but vanishes for curved ones, as the
    consistent force does: such a node gets the area 0.
    """
    if pairing.area is None:
        return None
    area = pairing.area.copy()
    for number in np.unique(owner):
        mine = owner == number
        body = structure.bodies[number]
        if body.model == "axisymmetric":
            area[mine] *= 2 * np.pi * _mean_radius(body, node[mine])
        else:
            area[mine] *= body.thickness
    return area


def _mean_radius(body: Body, nodes: Index) -> NDArray[np.float64]:
    """int N_i r ds / int N_i ds at each of the nodes; the node's own radius where no facet lies between them."""
    count = len(body.mesh.points)
    inside = np.zeros(count, dtype=bool)
    inside[nodes] = True
    total = np.zeros((count, 3))
    for block in body.mesh.facets_of(body.mesh.boundary):
        geometry = at_rule(block, body.mesh.points, block.kind.fine_rule)
        length = np.linalg.norm(geometry.normal, axis=2) * block.kind.fine_rule.weights
        length = length * np.all(inside[block.nodes], axis=1, keepdims=True)
        moment, shape = length * geometry.positions[..., 0], geometry.shape
        total += sum_at_nodes(block, np.stack([moment @ shape, moment @ np.abs(shape), length @ shape], axis=2), count)
    moment, size, whole = total[nodes].T
    own = body.mesh.points[nodes, 0]
    radius = np.where(whole > 0, moment / np.where(whole > 0, whole, 1.0), own)
    cancelled = np.logical_and(whole > 0, moment < CANCELLED * size)
    return np.where(cancelled, 0.0, radius)
