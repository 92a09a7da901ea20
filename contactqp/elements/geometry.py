"""From reference elements to space: Jacobians, gradients and normals of many elements at once; boundaries of meshes.

A facet is on the boundary where it belongs to one element only; facets are found by the nodes that they have.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.reference_elements import REFERENCES, Quadrature, Reference
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Index
from contactqp.model.problem_data import ReadOnly

# Numbers that are held at a time for a batch of elements (32 MB): more would leave the processor's cache and, for large
# meshes, the memory.
BATCH = 2**22


@dataclass(frozen=True, eq=False)
class Block(ReadOnly):
    """The elements of one kind: their reference element, and nodes (E, n) of int in its order."""

    kind: Reference
    nodes: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.nodes)


def batches(block: Block, numbers: int) -> Iterator[Block]:
    """Yield the block in pieces, so many elements at a time that `numbers` for each of them come to BATCH."""
    step = max(1, BATCH // numbers)
    for start in range(0, len(block), step):
        yield Block(block.kind, block.nodes[start : start + step])


@dataclass(frozen=True, eq=False)
class Geometry:
    """The geometry of E elements of one kind in space at q points of the reference element.

    Parameters
    ----------
    kind : Reference
    corners : (E, n, d) array
        Coordinates of the nodes [length].
    points : (q, d) array
        On the reference element.
    """

    kind: Reference
    corners: NDArray[np.float64]
    points: NDArray[np.float64]

    @cached_property
    def shape(self) -> NDArray[np.float64]:
        """Return N_i, (q, n)."""
        return self.kind.shape(self.points)

    @property
    def positions(self) -> NDArray[np.float64]:
        """Return x = N_i x_i, (E, q, d) [length]."""
        return np.asarray(np.matmul(self.shape, self.corners))

    @cached_property
    def jacobian(self) -> NDArray[np.float64]:
        """Return J_ab = dx_a / dxi_b, (E, q, d, dimension of the kind) [length]."""
        gradient = self.kind.gradient(self.points)
        q, n, k = gradient.shape
        flat = np.moveaxis(gradient, 1, 2).reshape(q * k, n) @ self.corners
        return np.swapaxes(flat.reshape(len(self.corners), q, k, -1), 2, 3)

    @cached_property
    def determinant(self) -> NDArray[np.float64]:
        """Return det J, (E, q); negative where an element is turned inside out."""
        return np.asarray((self.jacobian[..., 0] * _cofactors(self.jacobian)[..., 0]).sum(axis=-1))

    @property
    def gradient(self) -> NDArray[np.float64]:
        """Return dN_i/dx_a = dN_i/dxi_b (J^-1)_ba, (E, q, n, d) [1/length]."""
        inverse_transposed = _cofactors(self.jacobian) / self.determinant[..., None, None]
        return np.asarray(np.matmul(self.kind.gradient(self.points), np.swapaxes(inverse_transposed, 2, 3)))

    @property
    def normal(self) -> NDArray[np.float64]:
        """Return the normals of facets, as long as the facet is large: n dA = normal dxi, (E, q, d). They point out
        of the body (Surface).
        """
        if self.kind.dimension == 1:
            t = self.jacobian[..., 0]
            return np.stack([t[..., 1], -t[..., 0]], axis=-1)
        return np.cross(self.jacobian[..., 0], self.jacobian[..., 1])


def at_rule(block: Block, points: NDArray[np.float64], rule: Quadrature) -> Geometry:
    """Return the block's elements at the points of a quadrature rule; `points` are the coordinates of all nodes."""
    return Geometry(block.kind, points[block.nodes], rule.points)


def sum_at_nodes(block: Block, values: NDArray[np.float64], nodes: int) -> NDArray[np.float64]:
    """Sum at each of the nodes what the elements (E, n, c) bring to it: (nodes, c)."""
    at = block.nodes.ravel()
    columns = [
        np.bincount(at, weights=values[..., column].ravel(), minlength=nodes) for column in range(values.shape[-1])
    ]
    return np.stack(columns, axis=1).astype(np.float64)


def _cofactors(J: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return det(J) J^-T of (..., d, d) matrices, d = 2 or 3, column by column from the other columns."""
    if J.shape[-1] == 2:
        (a, b), (c, d) = np.moveaxis(J, (-2, -1), (0, 1))
        return np.stack([np.stack([d, -b], axis=-1), np.stack([-c, a], axis=-1)], axis=-1)
    columns = [np.cross(J[..., (i + 1) % 3], J[..., (i + 2) % 3]) for i in range(3)]
    return np.stack(columns, axis=-1)


def boundary(blocks: Sequence[Block]) -> Index:
    """Return the (p, 2) pairs (element, local facet) of the facets that belong to one element only.

    Raises
    ------
    InvalidProblem
        A facet belongs to three elements: they overlap.
    """
    pairs, keys = [], []
    first = 0
    for block in blocks:
        elements, local = np.divmod(np.arange(len(block) * len(block.kind.facets)), len(block.kind.facets))
        pairs.append(np.stack([elements + first, local], axis=1))
        keys.append(facet_keys(block.nodes[:, list(block.kind.facets)].reshape(len(elements), -1), block.kind.facet))
        first += len(block)
    pair, key = np.concatenate(pairs), np.concatenate(keys)
    order, new = groups(key)
    starts = np.flatnonzero(new)
    count = np.diff(np.append(starts, len(order)))
    if count.max(initial=0) > 2:
        three = pair[order[starts[np.argmax(count > 2)] :][:3], 0]
        raise InvalidProblem(f"mesh: elements {', '.join(map(str, three))} share one facet; expected two at most")
    single = order[starts[count == 1]]
    facets: Index = pair[np.sort(single)]
    return facets


def facet_keys(facets: Index, kind: str) -> Index:
    """Return keys that tell facets apart whatever their turn: their smallest corners in ascending order, (p, 2) or
    (p, 3).

    Two faces of a mesh that share three corners are one face, so three corners are enough for four.
    """
    corners = np.sort(facets[:, : REFERENCES[kind].corners], axis=1)
    return corners[:, : min(3, corners.shape[1])]


def find(facets: Index, among: Index) -> Index:
    """Return, for each row of `facets` (keys), its place in `among` (distinct keys), or -1."""
    order, new = groups(np.concatenate([among, facets]))
    group = np.empty(len(order), dtype=np.int64)
    group[order] = np.cumsum(new) - 1
    place = np.full(len(order), -1)
    place[group[: len(among)]] = np.arange(len(among))
    return place[group[len(among) :]]


def groups(keys: Index) -> tuple[Index, NDArray[np.bool_]]:
    """Return an order that puts equal rows side by side, and where in it a new row begins."""
    base = int(keys.max(initial=0)) + 1
    if keys.min(initial=0) >= 0 and base ** keys.shape[1] <= np.iinfo(np.int64).max:
        packed = keys @ base ** np.arange(keys.shape[1])  # one number a row sorts five times as fast
        order = np.argsort(packed, kind="stable")
    else:
        order = np.lexsort(keys.T)
    ordered = keys[order]
    new = np.ones(len(order), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return order, new
