"""Which node of which body each contact belongs to, and the area that its force is spread over."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from contactqp.elements.pairing import Pairing
from contactqp.elements.structure import Structure
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index

# A contact's point is a copy of its node's coordinates; what is further off, relative to the structure, is another one.
SAME_PLACE = 1e-9


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
