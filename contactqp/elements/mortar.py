"""Body against body by a segment-based mortar: weighted gaps that pass the contact patch test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from contactqp.elements.mortar_segments import Integrals, integrate, joined, segments
from contactqp.elements.nodal_pressure import faceting_notes, from_areas, tributary_areas
from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.pairing import Pairing, contact_rows, unknowns_of_surfaces
from contactqp.elements.surface import (
    OVERLAP,
    Surface,
    check_apart,
    check_distances,
    check_surface,
    diameters,
    kind_of,
    middle_normals,
)
from contactqp.errors import InvalidProblem
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Index, own_floating_point

# A node with less than this part of its tributary area covered has no multiplier, as its row would be redundant.
COVERED = 0.05


@checked
@own_floating_point
def pair_mortar(
    slave: Surface,
    master: Surface,
    *,
    reach: float | None = None,
    overlap: float | None = None,
    dimension: int | None = None,
) -> Pairing:
    """Pair two surfaces by one weighted gap for each slave node.

    gap_i = int psi_i gap dA / a_i with a_i = int psi_i dA, over the part of the slave surface that faces the master,
    and (E_N u)_i = int psi_i n.(u_slave - u_master) dA / a_i with the slave facet's outward normal n. So lambda_i is a
    nodal FORCE, and the contact pressure is the field sum_i (lambda_i / a_i) psi_i: `pairing.pressure(lambda)` are its
    nodal values. Integration is over the exact intersections of slave facets with projected master facets.

    psi_i are the slave's own shape functions, which are nowhere negative: a gap that is open everywhere gives positive
    weighted gaps, each node has one inequality, and a partly covered facet is integrated over the covered part, without
    inverting a matrix. (Biorthogonal functions make E_N's slave block diagonal, which is not needed here; they change
    sign, and on a sliver of a facet they become arbitrarily large: Wohlmuth 2000; Popp et al. 2010; Cichosz & Bischoff
    2011.) A node of which less than 5 % is covered has no row of its own: its psi is added to those of the facet's
    other nodes, so that all psi sum to 1 up to the boundary of contact.

    Forces and moments balance exactly, also with an initial gap and on curved surfaces, since both tractions of a point
    are on one line along n. A constant pressure is transmitted exactly between meshes that do not match (the patch test
    of Taylor & Papadopoulos 1991 and El-Abbasi & Bathe 2001); to rounding for triangles and parallelograms, and to the
    error of quadrature for other quadrilaterals, whose shape functions are not polynomials of the position: 1e-12, and
    more only where J in the corners differs by more than a factor of 4.

    Parameters
    ----------
    slave, master : Surface
        Their facets are linear: line2 in 2D; tri3 and quad4, also one against the other, in 3D. Their unknowns are
        numbered in the same u. The slave should have the finer mesh or be the softer body.
    reach : float, optional
        Parts with a larger gap have no partner [length]. By default each slave facet looks for master facets as far as
        three times the distance from its centre to the nearest master node, plus its diameter.
    overlap : float, optional
        How deep the bodies may overlap at the start [length]; default: 0.05 of the slave facet's diameter.
    dimension : int, optional
        n, the number of all unknowns; by default the largest number that is known of both surfaces.

    Returns
    -------
    Pairing
        One contact for each slave node with a multiplier, by ascending node. `area` is a_i times the thickness, the
        covered area only. `direction` is the mean of -n weighted by psi_i. `unpaired` lists the slave nodes without a
        row.

    Raises
    ------
    InvalidProblem
        The bodies are axisymmetric; facets are quadratic (their trace is not linear on any split, which the patch test
        would show); an argument is not a Surface; the surfaces share a node, do not face each other or overlap; or
        master facets lie behind each other.
    """
    for surface in (slave, master):
        check_surface(surface)
        if kind_of(surface).quadratic:
            raise InvalidProblem(
                f"{surface.name}: expected linear facets (line2, tri3, quad4) for a mortar, got "
                f"{kind_of(surface).name}; pair_node_to_segment takes quadratic ones"
            )
        if surface.revolved:
            raise InvalidProblem(
                f"{surface.name}: a mortar weighs gaps over plane or spatial surfaces, not over circles; "
                "pair_node_to_segment takes axisymmetric bodies"
            )
    check_apart(slave, master)
    check_distances(reach, overlap)
    n = unknowns_of_surfaces(dimension, slave, master)
    covers = _covers(slave, master, reach)
    if reach is None and not len(covers.slave):
        raise InvalidProblem(
            f"{slave.name} and {master.name} face each other nowhere: expected facets whose normals point out of their "
            "bodies and within 60 degrees of against each other"
        )
    _refuse_overlap(slave, master, covers, overlap)
    return _assemble(slave, master, covers, n)


@dataclass(frozen=True, eq=False)
class _Covers:
    """The master facets that cover slave facets, and the integrals over the common parts."""

    slave: Index
    master: Index
    over: Integrals


def _covers(slave: Surface, master: Surface, reach: float | None) -> _Covers:
    kinds = kind_of(slave), kind_of(master)
    found = [(part.slave, part.master, integrate(*kinds, part)) for part in segments(slave, master, reach)]
    facets, others, integrals = zip(*found, strict=True)
    s, m, over = np.concatenate(facets), np.concatenate(others), joined(list(integrals))
    if reach is None:
        return _Covers(s, m, over)
    near = over.least_gap <= reach
    return _Covers(s[near], m[near], over.only(near))


def _refuse_overlap(slave: Surface, master: Surface, covers: _Covers, overlap: float | None) -> None:
    size = diameters(slave.points[slave.facets])[covers.slave]
    allowed = OVERLAP * size if overlap is None else np.full(len(size), overlap)
    gap = covers.over.least_gap
    if len(size) and (gap + allowed).min() < 0:
        worst = int(np.argmin(gap + allowed))
        f, g = int(covers.slave[worst]), int(covers.master[worst])
        raise InvalidProblem(
            f"{slave.name}: facet {f} (nodes {slave.facets[f].tolist()}) is {-gap[worst]:.6g} inside "
            f"{master.name} (facet {g}) at the start: expected an overlap of at most {allowed[worst]:.6g}, "
            "which 'overlap' can change"
        )


def _multiplier_functions(slave: Surface, covers: _Covers) -> Array:
    """Return T of psi_i = sum_j T_ij N_j on each slave facet, (p, k, k); it is the identity except where a node without
    multiplier passes its psi to the others.
    """
    k = slave.facets.shape[1]
    touched = slave.facets[covers.slave]
    covered = np.bincount(touched.ravel(), covers.over.shape.ravel(), minlength=len(slave.points))
    whole = np.ones(len(slave.points))
    whole[slave.nodes] = tributary_areas(slave) / slave.thickness
    kept = covered >= COVERED * whole
    alone = ~kept[touched].any(axis=1)
    kept[touched[alone]] = True
    mine = kept[slave.facets]
    share = mine / np.maximum(mine.sum(axis=1, keepdims=True), 1)
    handed: Array = share[:, :, np.newaxis] * ~mine[:, np.newaxis, :]
    return np.eye(k) * mine[:, :, np.newaxis] + handed


def _assemble(slave: Surface, master: Surface, covers: _Covers, n: int) -> Pairing:
    psi, inward = _multiplier_functions(slave, covers), -middle_normals(slave)
    on, over, owner = psi[covers.slave], covers.over, slave.facets[covers.slave]
    shape = np.matmul(on, over.shape[:, :, np.newaxis])
    total = _summed(owner, np.concatenate([shape, np.matmul(on, over.gap[:, :, np.newaxis])], axis=2), slave)
    direction = _summed(owner, shape * inward[covers.slave, np.newaxis], slave)
    nodes = np.flatnonzero(total[:, 0] > 0)
    area, direction = total[nodes, 0], _unit(slave, nodes, direction[nodes])
    mass = np.zeros((len(psi), *over.mass.shape[1:]))
    np.add.at(mass, covers.slave, over.mass)
    parts = [
        _entries(np.arange(len(psi)), slave.facets, psi @ mass, slave),
        _entries(covers.slave, master.facets[covers.master], -(on @ over.coupling), master),
    ]
    facet, row, weight, unknowns = (np.concatenate(part) for part in zip(*parts, strict=True))
    used = weight != 0
    facet, weight, unknowns = facet[used], weight[used], unknowns[used]
    contact = np.searchsorted(nodes, slave.facets[facet, row[used]])
    normals = inward[facet]
    tangents = _turned(tangent_frames(direction)[contact], direction[contact], normals)
    E_N, E_T = contact_rows(contact, weight / area[contact], unknowns, normals, tangents, (len(nodes), n))
    unpaired = np.setdiff1d(slave.nodes, nodes)
    gap, area = total[nodes, 1] / area, area * slave.thickness
    points, projection, notes = slave.points[nodes], from_areas(area), faceting_notes(slave, master, gap)
    return Pairing(E_N, gap, E_T, nodes, points, direction, unpaired, area, projection, notes)


def _summed(nodes: Index, values: Array, body: Surface) -> Array:
    """Return the values (s, k, c) of facets added up at their nodes (s, k): (N, c)."""
    total = np.zeros((len(body.points), values.shape[2]))
    np.add.at(total, nodes, values)
    return total


def _entries(facet: Index, columns: Index, weight: Array, body: Surface) -> tuple[Index, Index, Array, Index]:
    """Return for each entry of `weight` its slave facet, the index of the row's node in it, the weight, and the
    unknowns.
    """
    count, k, others = weight.shape
    facets = np.repeat(facet, k * others)
    rows = np.tile(np.repeat(np.arange(k), others), count)
    nodes = np.broadcast_to(columns[:, np.newaxis, :], weight.shape).ravel()
    return facets, rows, weight.ravel(), body.unknowns[nodes]


def _unit(slave: Surface, nodes: Index, vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=1)
    if len(nodes) and length.min() == 0:
        raise InvalidProblem(
            f"{slave.name}: node {nodes[np.argmin(length)]}: its facets have opposite normals: expected one side"
        )
    unit: Array = vectors / length[:, np.newaxis]
    return unit


def _turned(tangents: Array, start: Array, end: Array) -> Array:
    """Return the tangents (q, d-1, d) of the normals `start`, turned with them into the normals `end`, (q, d):
    t.start = 0.

    The smallest rotation that turns a into b maps t to t - (t.b) (a + b) / (1 + a.b).
    """
    both = start + end
    along = np.einsum("qtd,qd->qt", tangents, end) / (1 + (start * end).sum(axis=1))[:, np.newaxis]
    turned: Array = tangents - along[:, :, np.newaxis] * both[:, np.newaxis, :]
    return turned
