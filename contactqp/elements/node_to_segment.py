"""Body against body, node to segment: each slave node stays outside the master facet that is nearest to it.

Only facets that face the node are considered. Candidates are found by overlapping balls in O(n log n) for facets of any
sizes. The closest point is computed on straight, bilinear and quadratic facets, and nodes beyond the end of the surface
are marked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from contactqp.elements.nodal_pressure import (
    faceting_notes,
    kinks,
    nodal_pressure,
    node_normals,
    same_facets,
    tributary_areas,
)
from contactqp.elements.obstacle import tangent_frames
from contactqp.elements.pairing import Pairing, contact_rows, unknowns_of_surfaces
from contactqp.elements.surface import (
    OVERLAP,
    FacetKind,
    Surface,
    bounding_balls,
    check_apart,
    check_distances,
    check_surface,
    diameters,
    kind_of,
    middle_normals,
    normal_vectors,
    overlapping_balls,
    solve_small,
    tangent_vectors,
)
from contactqp.errors import InvalidProblem
from contactqp.model.arguments import checked
from contactqp.model.arrays import EPS, Array, Index, Mask, own_floating_point

# Cosine: two normals further than this over 90 degrees apart face each other; walls at right angles never do.
FACING = 1e-6
# Feet closer together than this part of the facet are one point.
SAME_FOOT = 1e-9
# A point may stand over the end of a surface by this part of the facet: meshes of flush bodies differ by rounding.
FLUSH = 1e-6
# The true normal at the end of a curved side differs from the last facet's by about the kink at that facet's other end,
# at most twice that. A point in the direction of the true normal is still over the surface.
BENT = 2.0
# Points times facets searched together: some 300 MB where every facet has to be searched.
PAIRS = 20_000_000
NEWTON_STEPS = 50
HALVINGS = 20
# In reference coordinates, whose size is one: rounding of a quadratic's minimiser.
CONVERGED = 1e-13
# A foot this far outside the reference element counts as inside: it is on the edge but for rounding.
EDGE = 1e-10
# The range of iterates in reference coordinates.
OUTERMOST_ITERATE = 2.0


@dataclass(frozen=True, eq=False)
class Partners:
    """The nearest facing facet of each of p points; facet is -1 where there is none."""

    facet: Index  # (p,)
    xi: Array  # (p, d-1)
    gap: Array  # (p,) signed distance, positive outside the facets' body [length]
    normal: Array  # (p, d) unit vectors, out of the facets' body
    beyond: Mask  # (p,) the point stands over the end of the surface

    @property
    def found(self) -> Mask:
        return self.facet >= 0


def nearest_facets(points: Array, normals: Array, surface: Surface, reach: float | None) -> Partners:
    """Find the facets of `surface` nearest to the points, among those with a normal against the point's.

    Where the foot is inside a facet the normal is the facet's. On an edge or a corner between facets it is the
    direction of the point from there, the gradient of the distance; and for a point on the edge the facets' mean.

    Parameters
    ----------
    points, normals : (p, d) arrays, the points and the outward unit normals of the body that they belong to
    surface : Surface
    reach : float or None, the largest distance of facets [length]
    """
    corner = surface.points[surface.nodes]
    everywhere = np.linalg.norm(points - corner.mean(axis=0), axis=1) + np.ptp(corner, axis=0).sum()
    limit = everywhere if reach is None else np.minimum(everywhere, reach)
    search = np.minimum(scipy.spatial.cKDTree(corner).query(points)[0], limit)
    blocks = len(points) // max(PAIRS // len(surface.facets), 1000) + 1
    found = [
        part
        for block in np.array_split(np.arange(len(points)), blocks)
        for part in _search(block, points, normals, surface, search, limit)
    ]
    return _chosen(surface, points, _Found.joined(found))


@dataclass(frozen=True, eq=False)
class _Found:
    """Points i, facets j, and the feet of the points on the facets."""

    i: Index
    j: Index
    foot: Foot

    def only(self, keep: Mask) -> _Found:
        foot = Foot(self.foot.xi[keep], self.foot.position[keep], self.foot.distance[keep])
        return _Found(self.i[keep], self.j[keep], foot)

    @staticmethod
    def joined(parts: list[_Found]) -> _Found:
        feet = [part.foot for part in parts]
        foot = Foot(
            np.concatenate([foot.xi for foot in feet]),
            np.concatenate([foot.position for foot in feet]),
            np.concatenate([foot.distance for foot in feet]),
        )
        return _Found(np.concatenate([part.i for part in parts]), np.concatenate([part.j for part in parts]), foot)


def _search(
    active: Index, points: Array, normals: Array, surface: Surface, search: Array, limit: Array
) -> Iterator[_Found]:
    """Find all nearest facing facets of the `active` points by searches of growing radius, up to `limit`."""
    kind, positions, middle = kind_of(surface), surface.points[surface.facets], middle_normals(surface)
    centres, radii = bounding_balls(positions)
    best = np.full(len(points), np.inf)
    while active.size:
        # Wider by rounding, so that all facets that share the foot are found.
        i, j = overlapping_balls(points[active], search[active] * (1 + SAME_FOOT), centres, radii * (1 + SAME_FOOT))
        i = active[i]
        facing = (normals[i] * middle[j]).sum(axis=1) < -FACING
        i, j = i[facing], j[facing]
        found = _Found(i, j, closest_point(kind, positions[j], points[i]))
        np.minimum.at(best, i, found.foot.distance)
        # A facet beyond the radius of this search may have nearer ones beside it that were not searched.
        done = (best <= search * (1 + SAME_FOOT)) | (search >= limit)
        near = found.foot.distance <= np.minimum(best[i] + SAME_FOOT * radii[j], limit[i] * (1 + SAME_FOOT))
        yield found.only(near & done[i])
        active = active[~done[active]]
        wider = np.where(np.isfinite(best[active]), best[active], 2 * search[active])
        search[active] = np.minimum(np.maximum(wider, radii.min()), limit[active])


def _chosen(surface: Surface, points: Array, found: _Found) -> Partners:
    """Choose the first of the nearest facets of each point; the normal and the end of the surface follow from all of
    them.
    """
    kind = kind_of(surface)
    p, d = points.shape
    i, j, foot = found.i, found.j, found.foot
    best = np.lexsort((j, foot.distance, i))
    first = best[np.unique(i[best], return_index=True)[1]]
    chosen = np.full(p, -1)
    chosen[i[first]] = first
    positions = surface.points[surface.facets[j]]
    size = diameters(positions)
    same = np.linalg.norm(foot.position - foot.position[chosen[i]], axis=1) <= SAME_FOOT * size
    tangents = tangent_vectors(positions, kind.derivatives(foot.xi))
    normals = normal_vectors(tangents)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    apart = points[i] - foot.position
    height = (apart * normals).sum(axis=1)
    over = np.linalg.norm(apart - height[:, np.newaxis] * normals, axis=1)
    perpendicular = over <= SAME_FOOT * size
    mean, upright = np.zeros((p, d)), np.zeros((p, d))
    np.add.at(mean, i[same], normals[same])
    np.add.at(upright, i[same & perpendicular], normals[same & perpendicular])
    has = chosen >= 0
    c = chosen[has]
    is_upright = np.bincount(i[same & perpendicular], minlength=p)[has] > 0
    side = np.where((apart[c] * mean[has]).sum(axis=1) < 0, -1.0, 1.0)[:, np.newaxis]
    direction = np.where(is_upright[:, np.newaxis], upright[has], side * apart[c])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    kink = np.linalg.norm(kinks(surface), axis=2).max(axis=1)[j]
    flush = FLUSH * size + BENT * kink * np.linalg.norm(apart, axis=1)
    ends = _over_the_end(kind, surface, j, foot.xi, tangents, normals, apart, flush)
    beyond = np.zeros(p, dtype=bool)
    beyond[i[same & ends]] = True
    normal, gap, xi, facet = np.zeros((p, d)), np.zeros(p), np.zeros((p, d - 1)), np.full(p, -1)
    normal[has], xi[has], facet[has] = direction, foot.xi[c], j[c]
    gap[has] = (apart[c] * direction).sum(axis=1)
    return Partners(facet, xi, gap, normal, beyond)


def _over_the_end(
    kind: FacetKind,
    surface: Surface,
    facet: Index,
    xi: Array,
    tangents: Array,
    normals: Array,
    apart: Array,
    flush: Array,
) -> Mask:
    """Return whether each point lies beyond an edge that belongs to one facet only, (q,)."""
    corners = np.sort(surface.facets[:, kind.edges], axis=2).reshape(-1, kind.edges.shape[1])
    _, inverse, count = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
    last = (count[inverse.ravel()] == 1).reshape(len(surface.facets), -1)
    over = np.zeros(len(facet), dtype=bool)
    for e, edge in enumerate(kind.edges):
        start, along = kind.nodes[edge[0]], kind.nodes[edge[-1]] - kind.nodes[edge[0]]
        from_start = xi - start
        if kind.nodes.shape[1] == 1:
            off_edge = np.abs(from_start[:, 0])
            outward = np.sign(start[0]) * tangents[:, :, 0]
        else:
            off_edge = np.abs(from_start[:, 0] * along[1] - from_start[:, 1] * along[0])
            outward = np.cross(tangents @ along, normals)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        over |= last[facet, e] & (off_edge <= FLUSH) & ((apart * outward).sum(axis=1) > flush)
    return over


@dataclass(frozen=True, eq=False)
class Foot:
    """The closest points of q facets to q points."""

    xi: Array  # (q, d-1) reference coordinates
    position: Array  # (q, d)
    distance: Array  # (q,) [length]


def closest_point(kind: FacetKind, positions: Array, points: Array) -> Foot:
    """Minimise |x - X(xi)| over the closed facet: the foot of the perpendicular if it is inside, else the best of
    the edges.

    Newton's method with the second derivatives of the facet, Gauss-Newton where they make it indefinite, halved until
    the distance falls, from the best of the nodes and the centre (Konyukhov & Schweizerhof 2013, section 3).

    Parameters
    ----------
    kind : FacetKind
    positions : (q, k, d) array, the facets' nodes [length]
    points : (q, d) array [length]
    """
    axes = kind.nodes.shape[1]
    everywhere = np.full(axes, OUTERMOST_ITERATE)
    samples = np.vstack([kind.centre, kind.nodes])
    inner = _minimise(kind, positions, points, np.zeros(axes), np.eye(axes), samples, -everywhere, everywhere)
    best = _foot(kind, positions, points, inner)
    distance = np.where(kind.inside(inner, EDGE), best.distance, np.inf)
    xi, position = best.xi, best.position
    for edge in kind.edges:
        start, along = kind.nodes[edge[0]], (kind.nodes[edge[-1]] - kind.nodes[edge[0]])[np.newaxis]
        ends = np.zeros(1), np.ones(1)
        on_edge = np.linspace(0.0, 1.0, 5)[:, np.newaxis]
        foot = _foot(kind, positions, points, _minimise(kind, positions, points, start, along, on_edge, *ends))
        closer = foot.distance < distance
        xi = np.where(closer[:, np.newaxis], foot.xi, xi)
        position = np.where(closer[:, np.newaxis], foot.position, position)
        distance = np.minimum(distance, foot.distance)
    return Foot(xi, position, distance)


def _foot(kind: FacetKind, positions: Array, points: Array, xi: Array) -> Foot:
    position = np.einsum("qk,qkd->qd", kind.shape(xi), positions)
    return Foot(xi, position, np.linalg.norm(points - position, axis=1))


def _minimise(
    kind: FacetKind,
    positions: Array,
    points: Array,
    start: Array,
    along: Array,
    samples: Array,
    low: Array,
    high: Array,
) -> Array:
    """Return the minimiser of |x - X(start + s along)| over low <= s <= high, along (a, d-1): its xi, (q, d-1)."""

    def distance(s: Array, which: Index) -> Array:
        return _foot(kind, positions[which], points[which], start + s @ along).distance

    everyone = np.arange(len(points))
    tried = np.stack([distance(np.tile(s, (len(points), 1)), everyone) for s in samples])
    s = samples[np.argmin(tried, axis=0)] if len(points) else np.zeros((0, len(along)))
    at, active = tried.min(axis=0, initial=np.inf), everyone
    # A distance is flat at its minimum: below this the last steps towards it cannot be told from rounding.
    slack = 64 * EPS * (np.abs(positions).max(axis=(1, 2)) + np.abs(points).max(axis=1))
    for _ in range(NEWTON_STEPS):
        step = _newton_step(kind, positions[active], points[active], start + s[active] @ along, along)
        step *= np.minimum(1.0, 1.0 / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-300))
        new = np.clip(s[active] + step, low, high)
        value = distance(new, active)
        for _ in range(HALVINGS):
            worse = value > at[active] + slack[active]
            if not worse.any():
                break
            new[worse] = (new[worse] + s[active[worse]]) / 2
            value[worse] = distance(new[worse], active[worse])
        moved = np.abs(new - s[active]).max(axis=1)
        better = value <= at[active] + slack[active]
        s[active[better]], at[active[better]] = new[better], value[better]
        active = active[better & (moved > CONVERGED)]
        if not active.size:
            break
    return start + s @ along


def _newton_step(kind: FacetKind, positions: Array, points: Array, xi: Array, along: Array) -> Array:
    """Return -H^-1 gradient of |x - X|^2 / 2 in s, with H made positive definite, (q, a)."""
    apart = points - np.einsum("qk,qkd->qd", kind.shape(xi), positions)
    tangents = np.einsum("qda,sa->qds", tangent_vectors(positions, kind.derivatives(xi)), along)
    bend = np.einsum("qkab,qkd,qd->qab", kind.second_derivatives(xi), positions, apart)
    metric = np.einsum("qds,qdt->qst", tangents, tangents)
    hessian = metric - np.einsum("sa,qab,tb->qst", along, bend, along)
    size = np.trace(metric, axis1=1, axis2=2)
    indefinite = np.linalg.eigvalsh(hessian)[:, 0] <= 1e-3 * np.linalg.eigvalsh(metric)[:, 0]
    hessian[indefinite] = metric[indefinite]
    # A regularisation below rounding, for parallel tangents far outside a facet and vanishing ones at a line's end.
    ridge = np.where(size > 0, 1e-15 * size, 1.0)
    hessian += ridge[:, np.newaxis, np.newaxis] * np.eye(len(along))
    gradient = np.einsum("qds,qd->qs", tangents, apart)
    return solve_small(hessian, gradient)


# Gauss points per direction on a facet over the end of the master surface, which give its covered part to a tenth.
POINTS = 8


@checked
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
    `nearest_facets` says what n is on edges between facets). Displacements are small: the pair stays.

    Forces balance, and so do moments: the foot is on the line of the force. A constant pressure is not transmitted
    exactly between meshes that do not match: this pairing fails the contact patch test (Taylor & Papadopoulos 1991),
    and `pair_mortar` passes it. Only slave nodes are kept from penetrating, so the finer mesh, or the softer body,
    should be the slave.

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
        n, the number of all unknowns; by default the largest number that is known of both surfaces.

    Returns
    -------
    Pairing
        One contact for each slave node that has a partner, by ascending node; `area` is the node's tributary area.
        `unpaired` lists the slave nodes without: no facet faces them, all are beyond `reach`, or they stand over the
        end of the master surface (by more than 1e-6 of a facet).

    Raises
    ------
    InvalidProblem
        An argument is not a Surface, the surfaces share a node, no slave node faces a master facet, or the bodies
        overlap.
    """
    check_surface(slave)
    check_surface(master)
    check_apart(slave, master)
    check_distances(reach, overlap)
    n = unknowns_of_surfaces(dimension, slave, master)
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


def _covered(slave: Surface, master: Surface, paired: Index, reach: float | None) -> Array:
    """Return the part of each slave facet that lies over the master, for facets with only some nodes paired.

    The facets of a paired node count as wholly covered if none of their points lies over the master, which is then
    narrower than a facet.
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
    nodes: Index,
    partners: Partners,
    paired: Index,
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
            f"{facet[worst]}) at the start: expected an overlap of at most {allowed[worst]:.6g}, "
            "which 'overlap' can change"
        )
