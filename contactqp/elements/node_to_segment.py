"""Body against body, node to segment: each slave node stays outside the master facet that is nearest to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.nearest_facet import Partners, nearest_facets
from contactqp.elements.nodal_pressure import faceting_notes, nodal_pressure, node_normals, same_facets, tributary_areas
from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.pairing import Pairing, contact_rows, count_unknowns
from contactqp.elements.surface import (
    Surface,
    check_apart,
    check_distances,
    check_surface,
    diameters,
    kind_of,
    middle_normals,
)
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import own_floating_point

# Polygons of two round bodies that fit, a shaft in its bore, overlap by h^2 / (8 R): 5 % of h as long as h < 0.4 R.
OVERLAP = 0.05
# Gauss points per direction on a facet that stands over the end of the master surface: its part is known to a tenth.
POINTS = 8


@own_floating_point
def pair_node_to_segment(
    slave: Surface,
    master: Surface,
    *,
    reach: float | None = None,
    overlap: float | None = None,
    dimension: int | None = None,
) -> Pairing:
    """Pair each node of the slave surface with the nearest point of the master surface.

    gap = (x_i - X).n and E_N u = -n.(u_i - sum_j N_j u_j), with X the closest point of the nearest master facet that
    faces the node, N_j that facet's shape functions at X, and n its outward normal there (Wriggers 2006, section 9.1;
    contactqp.elements.nearest_facet says what n is on edges between facets). Displacements are small: the pair stays.

    Forces balance, and so do moments: the foot is on the line of the force. A constant pressure is not transmitted
    exactly between meshes that do not match: this pairing fails the contact patch test (Taylor & Papadopoulos 1991),
    and `pair_mortar` passes it. Only slave nodes are held out of the other body, so that the finer mesh, or the softer
    body, should be the slave.

    Parameters
    ----------
    slave, master : Surface
        Their unknowns are numbered in the same u. Any kind of facet, curved or not.
    reach : float, optional
        Slave nodes further than this from the master surface, on either side, have no partner [length]; by default
        there is no limit.
    overlap : float, optional
        How deep a slave node may be inside the master body at the start [length]; default: 0.05 of the diameter of
        the facet it meets.
    dimension : int, optional
        n, the number of all unknowns; by default one more than the largest of both surfaces.

    Returns
    -------
    Pairing
        One contact for each slave node that has a partner, by ascending node; `area` is the node's tributary area.
        `unpaired` lists the slave nodes without: no facet faces them, all are beyond `reach`, or they stand over the
        end of the master surface (by more than 1e-6 of a facet).

    Raises
    ------
    InvalidProblem
        A surface that is none, surfaces that share a node, no slave node that faces a master facet, overlap.
    """
    check_surface(slave)
    check_surface(master)
    check_apart(slave, master)
    check_distances(reach, overlap)
    largest = max(int(slave.unknowns.max()), int(master.unknowns.max()))
    n = count_unknowns(largest, dimension)
    nodes = slave.nodes
    points = slave.points[nodes]
    partners = nearest_facets(points, node_normals(slave), master, reach)
    if reach is None and not partners.found.any():
        raise InvalidProblem(
            f"{slave.name} and {master.name} do not face each other: expected facets whose normals point out of their "
            "bodies and against each other"
        )
    paired = np.flatnonzero(partners.found & ~partners.beyond)
    _refuse_overlap(slave, master, nodes[paired], partners, paired, overlap)
    contact = np.arange(len(paired))
    facet = master.facets[partners.facet[paired]]
    k = facet.shape[1]
    weights = np.column_stack([np.ones(len(paired)), -kind_of(master).shape(partners.xi[paired])])
    columns = np.concatenate([slave.unknowns[nodes[paired], np.newaxis], master.unknowns[facet]], axis=1)
    normals = partners.normal[paired]
    entry = np.repeat(contact, k + 1)
    E_N, E_T = contact_rows(
        entry,
        weights.ravel(),
        columns.reshape(len(entry), slave.dimension),
        normals[entry],
        tangent_frames(normals)[entry],
        (len(paired), n),
    )
    unpaired = np.setdiff1d(nodes, nodes[paired])
    covered = _covered(slave, master, nodes[paired], reach)
    uneven = len(paired) < len(nodes) or not same_facets(slave, master)
    return Pairing(
        E_N,
        partners.gap[paired],
        E_T,
        nodes[paired],
        points[paired],
        normals,
        unpaired,
        tributary_areas(slave)[paired],
        nodal_pressure(slave, nodes[paired], covered=covered, uneven=uneven),
        faceting_notes(slave, master, partners.gap[paired]),
    )


def _covered(slave: Surface, master: Surface, paired: NDArray[np.int64], reach: float | None) -> NDArray[np.float64]:
    """Return the part of each slave facet that stands over the master, for facets only some of whose nodes are
    paired.

    Where no point of any facet of a paired node does, a master narrower than a facet, its facets count whole.
    """
    with_partner = np.isin(slave.facets, paired)
    covered = with_partner.any(axis=1).astype(float)
    ends = np.flatnonzero(with_partner.any(axis=1) & ~with_partner.all(axis=1))
    if len(ends):
        kind = kind_of(slave)
        xi, weight = kind.quadrature(POINTS)
        at = np.einsum("qk,pkd->pqd", kind.shape(xi), slave.points[slave.facets[ends]]).reshape(-1, slave.dimension)
        normals = np.repeat(middle_normals(slave)[ends], len(xi), axis=0)
        partners = nearest_facets(at, normals, master, reach)
        over = (partners.found & ~partners.beyond).reshape(len(ends), len(xi))
        covered[ends] = (over @ weight) / weight.sum()
        area = np.zeros(len(slave.points))
        np.add.at(area, slave.facets, covered[:, np.newaxis])
        covered[(with_partner & (area[slave.facets] == 0)).any(axis=1)] = 1.0
    return covered


def _refuse_overlap(
    slave: Surface,
    master: Surface,
    nodes: NDArray[np.int64],
    partners: Partners,
    paired: NDArray[np.int64],
    overlap: float | None,
) -> None:
    facet = partners.facet[paired]
    allowed = (
        OVERLAP * diameters(master.points[master.facets[facet]]) if overlap is None else np.full(len(paired), overlap)
    )
    deeper = -partners.gap[paired] - allowed
    if len(paired) and deeper.max() > 0:
        worst = int(np.argmax(deeper))
        raise InvalidProblem(
            f"{slave.name}: node {nodes[worst]} is {-partners.gap[paired][worst]:.6g} inside {master.name} (facet "
            f"{facet[worst]}) at the start: expected an overlap of at most {allowed[worst]:.6g}"
        )
