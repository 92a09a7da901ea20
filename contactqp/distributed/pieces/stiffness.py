"""K of all pieces as one matrix over the ranks: elements go in batch by batch, so that little is held beside K."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.formats import block_type
from contactqp.distributed.pieces.nodes import Nodes
from contactqp.elements.geometry import Block, batches
from contactqp.elements.solid import Body, pattern
from contactqp.elements.structure import Part
from contactqp.model.arrays import Index


def assemble_stiffness(bodies: Sequence[Body], nodes: Nodes) -> Any:
    """K of all unknowns, free or not, with blocks of one node each. Collective.

    Parameters
    ----------
    bodies : sequence of Body
        This rank's pieces, in the order of `nodes`.
    nodes : Nodes
    """
    PETSc = petsc()
    d = bodies[0].dimension
    size = (d * len(nodes.own), None)
    K = PETSc.Mat().create(comm=nodes.ranks.comm)
    K.setSizes((size, size), bsize=d)
    K.setType(block_type(d))
    here, elsewhere = _row_lengths(bodies, nodes)
    blocks = [count.astype(PETSc.IntType) for count in (here, elsewhere)]
    K.setPreallocationNNZ((blocks[0], blocks[1]) if nodes.ranks.size > 1 else blocks[0])
    K.setUp()
    first = 0
    for body in bodies:
        place = nodes.place[first : first + len(body.mesh.points)].astype(PETSc.IntType)
        first += len(place)
        for block in body.mesh.blocks:
            for part in batches(block, (block.nodes.shape[1] * d) ** 2):
                _add(K, body, part, place)
    K.assemble()
    K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return K


def _add(K: Any, body: Body, part: Block, place: NDArray[Any]) -> None:
    PETSc = petsc()
    used, numbers = np.unique(part.nodes, return_inverse=True)
    where = pattern([numbers.reshape(part.nodes.shape)], len(used))
    blocks = body.node_blocks([part], where)
    indptr = where.indptr.astype(PETSc.IntType)
    K.setValuesBlockedIJV(indptr, place[used[where.indices]], blocks, addv=True, rowmap=place[used])


def _row_lengths(bodies: Sequence[Body], nodes: Nodes) -> tuple[Index, Index]:
    """How many nodes of this rank and of others each own node meets in elements of any rank."""
    ranks, first, count = nodes.ranks, nodes.first, len(nodes.own)
    has = incidence(bodies)
    meeting = sp.csr_matrix(has @ has.T)
    row = np.repeat(np.arange(len(nodes.numbers)), np.diff(meeting.indptr))
    place, other = nodes.place[row], nodes.place[meeting.indices]
    foreign = nodes.owners[row] != ranks.rank
    told = ranks.exchanged(nodes.owners[row[foreign]], place[foreign], other[foreign])
    touched = np.zeros(count, dtype=bool)
    touched[told[0] - first] = True
    # Only rows that other ranks have a part in may get columns twice.
    mine = ~foreign
    mine[mine] = touched[place[mine] - first]
    pairs = np.stack([np.concatenate([told[0], place[mine]]), np.concatenate([told[1], other[mine]])])
    pairs = np.unique(pairs, axis=1)
    alone = ~foreign & ~mine
    rows = np.concatenate([place[alone], pairs[0]]) - first
    columns = np.concatenate([other[alone], pairs[1]]) - first
    here = (columns >= 0) & (columns < count)
    return np.bincount(rows[here], minlength=count), np.bincount(rows[~here], minlength=count)


def incidence(bodies: Sequence[Part]) -> Any:
    """Which nodes the elements of this rank have: (nodes, elements) CSR of ones."""
    element, node, first, elements = [], [], 0, 0
    for body in bodies:
        for block in body.mesh.blocks:
            element.append(np.repeat(np.arange(elements, elements + len(block)), block.nodes.shape[1]))
            node.append(first + block.nodes.ravel())
            elements += len(block)
        first += len(body.mesh.points)
    none = np.zeros(0, dtype=np.int64)
    rows, columns = np.concatenate([none, *node]), np.concatenate([none, *element])
    return sp.csr_matrix((np.ones(len(rows), dtype=np.float32), (rows, columns)), shape=(first, elements))
