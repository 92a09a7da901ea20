"""From a ContactProblem to the part of each rank: rows go where the graph of K is cut least.

    share    an equal share of consecutive rows (`portion`)
    owner    the rank of each node of the share: parts of equal size, few entries of K between them (`partition`)
    part     what has come here of all shares, in new numbers: the nodes of rank 0 first, then those of rank 1, ...

A problem may be given to all ranks alike, or to the first alone: the others then never have more of it than a share and
a part, and no rank anything of the length of all unknowns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.formats import held_in_blocks
from contactqp.distributed.numbering import Numbering
from contactqp.distributed.portion import OfAll, OfFirst, Portion, share_of, whole_portion
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.rows import Rows
from contactqp.linalg.multigrid import block_size, constants, in_blocks
from contactqp.model.problem import ContactProblem


def distribute(problem: ContactProblem, ranks: Ranks) -> DistributedProblem:
    """This rank's part of a problem that all ranks were given alike. Collective."""
    return part_of(ranks, share_of(ranks, OfAll(ranks), whole_portion(problem)))


def share_of_first(whole: Portion | None, ranks: Ranks) -> Portion:
    """This rank's share of what the first rank alone has; the others give None. Collective."""
    return share_of(ranks, OfFirst(ranks), whole)


def part_of(ranks: Ranks, share: Portion) -> DistributedProblem:
    """The part of a rank that has a share of a problem. Collective."""
    K = in_blocks(share.stiffness, ranks.sum)
    size = block_size(K)
    numbering = Numbering(ranks, K, size)
    owner = np.repeat(numbering.owner, size)
    load, body, motions, names, number = ranks.exchanged(
        owner, share.load, share.body, share.motions, share.dof_names, _numbers(ranks, share.load)
    )
    stiffness = _matrix(ranks, K, numbering)
    touching, contacts = _touching(share.normal, numbering)
    gap, friction, origin, called, contact = ranks.exchanged(
        contacts, share.gap, share.friction, share.slip_origin, share.contact_names, _numbers(ranks, share.gap)
    )
    tying, ties = _touching(share.tie, numbering)
    tie_value, tie = ranks.exchanged(ties, share.tie_value, _numbers(ranks, share.tie_value))
    tangential: dict[str, Any] = {}
    if width := origin.shape[1]:
        along = np.repeat(contacts, width)
        rows = _moved(ranks, share.tangent, numbering.new(share.tangent.indices), along)
        tangential = {"tangent": Rows.over_touched(rows, stiffness), "friction": friction, "slip_origin": origin}
    return DistributedProblem(
        ranks=ranks,
        stiffness=stiffness,
        load=load,
        normal=Rows.over_touched(_moved(ranks, share.normal, touching, contacts), stiffness),
        gap=gap,
        tie=Rows.over_touched(_moved(ranks, share.tie, tying, ties), stiffness),
        tie_value=tie_value,
        held=np.zeros(len(load), dtype=bool),
        body=body,
        near_null_space=motions if share.hinted else constants(len(load), size),
        rigid=None if share.hinted else motions,
        dof_number=number,
        contact_number=contact,
        tie_number=tie,
        units=share.units,
        dof_name=_called("unknown {}", names, number),
        contact_name=_called("contact {}", called, contact),
        tie_name=_called("tie {}", names[:0], tie),
        **tangential,
    )


def _numbers(ranks: Ranks, values: NDArray[Any]) -> NDArray[np.int64]:
    """Of the rows of a share, from the first on over all ranks."""
    return ranks.first(len(values)) + np.arange(len(values), dtype=np.int64)


def _touching(rows: Any, numbering: Numbering) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """The unknowns of the entries, in new numbers; and of each row the rank that has the first of its unknowns."""
    unknowns = numbering.new(rows.indices)
    owner = np.zeros(rows.shape[0], dtype=np.intp)  # a row of nothing may stand anywhere
    some = np.diff(rows.indptr) > 0
    owner[some] = numbering.owner_of(unknowns[rows.indptr[:-1][some]])
    return unknowns, owner


def _moved(ranks: Ranks, rows: Any, columns: NDArray[np.int64], owner: NDArray[np.intp]) -> Any:
    """Rows (or rows of blocks) with new columns, sent to their owners; in CSR or BSR as they are."""
    order = np.argsort(owner, kind="stable")
    lengths = np.diff(rows.indptr)[order]
    counts = np.bincount(owner, minlength=ranks.size)
    ends = np.append(0, np.cumsum(lengths))
    entries = np.repeat(rows.indptr[order] - ends[:-1], lengths) + np.arange(ends[-1])
    stored = np.diff(ends[np.append(0, np.cumsum(counts))])
    (came,) = ranks.sent(counts, lengths)
    indices, data = ranks.sent(stored, columns[entries], rows.data[entries])
    size = block_size(rows)
    shape = (size * len(came), rows.shape[1])
    kind = sp.csr_matrix if size == 1 else sp.bsr_matrix
    return kind((data, indices, np.append(0, np.cumsum(came))), shape=shape)


def _matrix(ranks: Ranks, K: Any, numbering: Numbering) -> Any:
    """K in the new numbers, from the rows (of blocks) of each rank's share."""
    PETSc = petsc()
    rows = sp.csr_matrix(_moved(ranks, K, numbering.new_blocks(K.indices), numbering.owner))
    rows.eliminate_zeros()  # what blocks were filled with
    rows = _with_diagonal(rows, ranks.first(rows.shape[0]))
    K = held_in_blocks(ranks.comm, rows.tobsr((numbering.size, numbering.size)))
    K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return K


def _with_diagonal(rows: Any, first: int) -> Any:
    """PETSc wants a place for every diagonal entry, of an unknown without stiffness too."""
    rows.sort_indices()
    bare = np.flatnonzero(rows.diagonal(first) == 0) if rows.shape[0] else np.zeros(0, dtype=np.intp)
    if not bare.size:
        return rows
    row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
    places = (np.append(row, bare), np.append(rows.indices, first + bare))
    return sp.csr_matrix(sp.coo_matrix((np.append(rows.data, np.zeros(len(bare))), places), shape=rows.shape))


def _called(kind: str, names: NDArray[np.str_], numbers: NDArray[np.int64]) -> Callable[[int], str]:
    return (lambda here: str(names[here, 0])) if names.size else (lambda here: kind.format(numbers[here]))
