"""The point of a facet that is closest to a given point, for straight, bilinear and quadratic facets alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.facet import FacetKind, solve_small, tangent_vectors
from contactqp.model.arrays import Array

NEWTON_STEPS = 50
HALVINGS = 20
# In reference coordinates, whose size is one: rounding of a quadratic's minimiser.
CONVERGED = 1e-13
# A foot this far outside the reference element counts as inside: it is on the edge but for rounding.
EDGE = 1e-10
# Where a foot may wander on its way, in reference coordinates.
FAR = 2.0


@dataclass(frozen=True, eq=False)
class Foot:
    """The closest points of q facets to q points."""

    xi: Array  # (q, d-1) reference coordinates
    position: Array  # (q, d)
    distance: Array  # (q,) [length]


def closest_point(kind: FacetKind, positions: Array, points: Array) -> Foot:
    """min |x - X(xi)| over the closed facet: the foot of the perpendicular if it is inside, else the best of the edges.

    Newton's method with the second derivatives of the facet, Gauss-Newton where they make it indefinite, halved until
    the distance falls, from the best of the nodes and the centre (Konyukhov & Schweizerhof 2013, section 3).

    Parameters
    ----------
    kind : FacetKind
    positions : (q, k, d) array
        The facets' nodes [length].
    points : (q, d) array [length]
    """
    axes = kind.nodes.shape[1]
    everywhere = np.full(axes, FAR)
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
    """The minimiser of |x - X(start + s along)| over low <= s <= high, along (a, d-1): its xi, (q, d-1)."""

    def distance(s: Array, which: NDArray[np.int64]) -> Array:
        return _foot(kind, positions[which], points[which], start + s @ along).distance

    everyone = np.arange(len(points))
    tried = np.stack([distance(np.tile(s, (len(points), 1)), everyone) for s in samples])
    s = samples[np.argmin(tried, axis=0)] if len(points) else np.zeros((0, len(along)))
    at, active = tried.min(axis=0, initial=np.inf), everyone
    # A distance is flat at its minimum: below this the last steps towards it cannot be told from rounding.
    slack = 64 * np.finfo(float).eps * (np.abs(positions).max(axis=(1, 2)) + np.abs(points).max(axis=1))
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
    """-H^-1 gradient of |x - X|^2 / 2 in s, with H made positive definite, (q, a)."""
    apart = points - np.einsum("qk,qkd->qd", kind.shape(xi), positions)
    tangents = np.einsum("qda,sa->qds", tangent_vectors(positions, kind.derivatives(xi)), along)
    bend = np.einsum("qkab,qkd,qd->qab", kind.second_derivatives(xi), positions, apart)
    metric = np.einsum("qds,qdt->qst", tangents, tangents)
    hessian = metric - np.einsum("sa,qab,tb->qst", along, bend, along)
    size = np.trace(metric, axis1=1, axis2=2)
    indefinite = np.linalg.eigvalsh(hessian)[:, 0] <= 1e-3 * np.linalg.eigvalsh(metric)[:, 0]
    hessian[indefinite] = metric[indefinite]
    # Far outside a facet its two tangents may be parallel, and a line's end has none: elsewhere this is below rounding.
    ridge = np.where(size > 0, 1e-15 * size, 1.0)
    hessian += ridge[:, np.newaxis, np.newaxis] * np.eye(len(along))
    gradient = np.einsum("qds,qd->qs", tangents, apart)
    return solve_small(hessian, gradient)
