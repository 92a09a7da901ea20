"""What parts the forces of another code from the exact ones at a contact pair, in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.surface import Surface, diameters, kind_of
from contactqp.errors import counted
from contactqp.model.arrays import Vector
from contactqp.oracle.foreign.crosscheck_forces import PairNodes

# A spring law is recognised where its stiffnesses at nine nodes in ten differ by no more than this factor.
ALIKE = 1.5
# Nodes lie in one plane where the part of their coordinates across it is below this.
PLANE = 1e-9
# A slave node stands over the edge of the master within this part of a facet.
EDGE = 1e-6
# A force of this part of what the tolerance is of the resultant is worth a word.
WORTH = 0.1
# A pair has no force where its forces are below this part of the reference's.
NOTHING = 1e-3
# Nodes that push with less than this part of the largest force say little of a stiffness.
PUSHING = 0.02


@dataclass(frozen=True, eq=False)
class Found:
    """The forces of a pair as they are compared: after `PairNodes.shares`.

    Attributes
    ----------
    judged : PairNodes
    force, truth : (q,) arrays
        Normal forces of the other code, and of the reference [force].
    gap : (q,) array
        In the answer of the other code, NaN where a node has no partner [length].
    size : float
        The resultant that errors are measured by [force].
    """

    judged: PairNodes
    force: Vector
    truth: Vector
    gap: Vector
    size: float


def causes_of(found: Found, tolerance: float) -> Iterator[str]:
    """Yield what parts a pair from the reference: no contact, adhesion, springs, a lost edge, forces across gaps."""
    if abs(found.force).sum() <= NOTHING * found.truth.sum():
        yield "it has no contact force: the pair was not found, or its surfaces do not reach each other"
        return
    least = WORTH * tolerance * found.size
    area = found.judged.shares @ found.judged.area
    pulls = found.force < -least
    if pulls.any():
        pull = f"{counted('node', int(pulls.sum()))} pull with {-found.force[pulls].sum():.4g} in all"
        yield (
            f"{pull}, {_range(-found.force[pulls] / area[pulls])} per area, across gaps of {_range(found.gap[pulls])}: "
            "adhesion, which contact has not"
        )
    yield from _springs(found, area)
    edge = _over_the_edge(found.judged)
    if found.judged.contact.pair.type == "MORTAR" and (edge & (abs(found.force - found.truth) > least)).any():
        yield (
            f"{counted('slave node', int(edge.sum()))} stand over the edge of the master surface, where a mortar "
            "loses a part of its integrals; let the master reach further than the slave"
        )
    far = (found.force > least) & (found.gap > 0) & (found.truth <= 0)
    if far.any():
        count = counted("node", int(far.sum()))
        yield f"{count} push across gaps of {_range(found.gap[far])}, where nothing touches"


def _springs(found: Found, area: Vector) -> Iterator[str]:
    pushing = (found.force > PUSHING * found.force.max(initial=0.0)) & (found.gap < 0)
    if pushing.sum() < 2:
        return
    stiffness = found.force[pushing] / (-found.gap[pushing] * area[pushing])
    low, high = np.quantile(stiffness, [0.05, 0.95])
    if high <= ALIKE * low:
        stated = found.judged.contact.interaction.stiffness
        told = "HARD" if stated is None else f"the deck states {stated:.4g}"
        springs = f"{np.median(stiffness):.4g} times area and overlap: springs in the place of contact ({told})"
        yield f"the force is {springs}"


def is_plane(surface: Surface) -> bool:
    """Return whether all nodes of a surface lie in one plane, up to the rounding of coordinates."""
    x = surface.points[surface.nodes]
    x = x - x.mean(axis=0)
    return bool(np.linalg.svd(x, compute_uv=False)[-1] <= PLANE * np.linalg.norm(x))


def _over_the_edge(judged: PairNodes) -> NDArray[np.bool_]:
    """Return which slave nodes stand over an edge that belongs to one facet of the master only, (q,)."""
    pairing, master = judged.contact.pairing, judged.contact.master
    edges = master.facets[:, kind_of(master).edges].reshape(-1, kind_of(master).edges.shape[1])
    ordered, count = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    ends = master.points[ordered[count == 1]]  # (e, 1 or 2, d)
    start, along = ends[:, 0], ends[:, -1] - ends[:, 0]
    length = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    size = float(diameters(master.points[master.facets]).max())
    found = np.zeros(len(judged.nodes), dtype=bool)
    for i, row in enumerate(judged.row.tolist()):
        if row >= 0:
            foot = pairing.points[row] - pairing.gap[row] * pairing.direction[row]
            part = np.clip(((foot - start) * along).sum(axis=1) / length, 0.0, 1.0)
            apart = np.linalg.norm(foot - start - part[:, None] * along, axis=1)
            found[i] = bool(apart.min(initial=np.inf) <= EDGE * size)
    return found


def _range(values: Vector) -> str:
    known = values[np.isfinite(values)]
    if not len(known):
        return "unknown size"
    low, high = float(known.min()), float(known.max())
    return f"{low:.4g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.4g} to {high:.4g}"
