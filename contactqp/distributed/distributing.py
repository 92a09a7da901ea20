"""Distribute a ContactProblem over ranks: rows go where the graph of K is cut least.

    share    an equal share of consecutive rows (`portion`)
    owner    the rank of each node of the share: parts of equal size, few entries of K between them (`partition`)
    part     what has come here of all shares, in new numbers: the nodes of rank 0 first, then those of rank 1, ...

A problem may be given to all ranks alike, or to the first alone: the others then never have more of it than a share and
a part, and no rank anything of the length of all unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import held_in_blocks, petsc
from contactqp.distributed.problem import DistributedProblem, Numbers
from contactqp.distributed.ranks import Ranks, T, asked
from contactqp.distributed.rows import Rows
from contactqp.linalg.factorization import null_space
from contactqp.linalg.measures import bodies
from contactqp.linalg.multigrid import block_size, constants, in_blocks
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem, Units

# Which rank gets which vertex of a graph: PETSc's partitioners (PTScotch, ParMETIS), on the graph's own ranks.


def partition(ranks: Ranks, indptr: NDArray[np.int64], indices: NDArray[np.int64]) -> NDArray[np.intp]:
    """The rank of each vertex of this rank, parts of equal size with few edges between them. Collective.

    Parameters
    ----------
    ranks : Ranks
    indptr, indices : arrays of int
        Vertex i of this rank has the neighbours indices[indptr[i]:indptr[i + 1]], numbered through all ranks rank after
        rank. The graph is symmetric; a vertex may be its own neighbour.
    """
    count = len(indptr) - 1
    if ranks.size == 1:
        return np.zeros(count, dtype=np.intp)
    PETSc = petsc()
    first = ranks.first(count)
    row = np.repeat(np.arange(count), np.diff(indptr))
    other = indices != row + first  # the partitioners take no loops
    kept = np.concatenate([[0], np.cumsum(np.bincount(row[other], minlength=count))]).astype(PETSc.IntType)
    edges = indices[other].astype(PETSc.IntType)
    graph = PETSc.Mat().createAIJ(
        size=((count, None), (count, None)), csr=(kept, edges, np.ones(len(edges))), comm=ranks.comm
    )
    parts, owner = PETSc.MatPartitioning().create(ranks.comm), PETSc.IS().create(ranks.comm)
    parts.setAdjacency(graph)
    parts.setFromOptions()
    parts.apply(owner)
    found = np.array(owner.getIndices(), dtype=np.intp)
    for item in (parts, owner, graph):
        item.destroy()
    return found


# New numbers for the unknowns: the nodes of rank 0 first, then those of rank 1, ..., on each in their old order.


class Numbering:
    """What a rank knows of the new numbers: those of the blocks of its share; it asks for others. Collective.

    Parameters
    ----------
    ranks : Ranks
    stiffness : CSR or BSR matrix
        The rows of K of this rank's share, which follow those of the rank before, over all unknowns.
    size : int
        Unknowns of a block.

    Attributes
    ----------
    owner : (blocks of the share,) array
        The rank that each block goes to.
    first : int
        The old number of the first block of the share.
    """

    def __init__(self, ranks: Ranks, stiffness: Any, size: int) -> None:
        self.ranks, self.size = ranks, size
        indptr, indices = stiffness.indptr, stiffness.indices
        self.owner = partition(ranks, indptr.astype(np.int64), indices.astype(np.int64))
        counts = np.bincount(self.owner, minlength=ranks.size)
        every = ranks.gathered(counts[None, :])  # how many each share has for each rank
        self.first = ranks.first(len(self.owner))
        self._share_ends = np.cumsum(every.sum(axis=1))
        self._ends = np.cumsum(every.sum(axis=0))
        before = self._ends - every.sum(axis=0) + every[: ranks.rank].sum(axis=0)
        order = np.argsort(self.owner, kind="stable")
        self._new = np.empty(len(order), dtype=np.int64)
        self._new[order] = np.repeat(before - (np.cumsum(counts) - counts), counts) + np.arange(len(order))

    def new_blocks(self, blocks: NDArray[Any]) -> NDArray[np.int64]:
        """The new numbers of blocks, in any order and more than once. Collective."""
        distinct, place = np.unique(blocks, return_inverse=True)
        whom = np.searchsorted(self._share_ends, distinct, side="right")
        (found,) = asked(self.ranks, whom, distinct, lambda came, _: (self._new[came - self.first],))
        return np.asarray(found[place])

    def new(self, unknowns: NDArray[Any]) -> NDArray[np.int64]:
        """The new numbers of unknowns. Collective."""
        return np.asarray(self.size * self.new_blocks(unknowns // self.size) + unknowns % self.size)

    def owner_of(self, new: NDArray[np.int64]) -> NDArray[np.intp]:
        """The ranks of unknowns in their new numbers."""
        return np.asarray(np.searchsorted(self.size * self._ends, new, side="right"))


# Portion: consecutive or collected rows of all that a problem consists of; the whole of it is one too.

# Blocks have one, two or three unknowns: shares that begin at multiples of all of them cut none.
_WHOLE_BLOCKS = 6


@dataclass(frozen=True, eq=False)
class Portion:
    """Some unknowns, contacts and ties, with their rows of K, E_N, E_T and A over all unknowns (CSR).

    What a problem has not is there without width: names, or directions of slip.
    """

    stiffness: Any
    load: Vector
    body: Numbers
    motions: NDArray[np.float64]  # near_null_space, or the motions that nothing resists where there is none
    dof_names: NDArray[np.str_]  # (n_here, 1) or (n_here, 0)
    normal: Any
    gap: Vector
    tangent: Any  # (w m_here, n)
    friction: Vector
    slip_origin: NDArray[np.float64]  # (m_here, w)
    contact_names: NDArray[np.str_]  # (m_here, 1) or (m_here, 0)
    tie: Any
    tie_value: Vector
    hinted: bool  # whether the motions are near_null_space
    units: Units


class Holder(Protocol):
    """The holder of a whole problem, from which each rank gets its rows. Collective."""

    def rows(self, counts: NDArray[np.intp], values: NDArray[Any] | None) -> NDArray[Any]:
        """Return this rank's rows of an array; counts[r] of them, in their order, are rank r's."""

    def told(self, value: T) -> T:
        """What whoever has the whole knows of it."""


class OfAll:
    """Every rank has the whole."""

    def __init__(self, ranks: Ranks) -> None:
        self.ranks = ranks

    def rows(self, counts: NDArray[np.intp], values: NDArray[Any] | None) -> NDArray[Any]:
        begin = int(counts[: self.ranks.rank].sum())
        return np.asarray(values)[begin : begin + int(counts[self.ranks.rank])]

    def told(self, value: T) -> T:
        return value


class OfFirst:
    """The first rank has the whole, the others nothing of it."""

    def __init__(self, ranks: Ranks) -> None:
        self.ranks = ranks

    def rows(self, counts: NDArray[np.intp], values: NDArray[Any] | None) -> NDArray[Any]:
        return self.ranks.scattered(counts, values)

    def told(self, value: T) -> T:
        return self.ranks.told(value)


def whole_portion(problem: ContactProblem) -> Portion:
    """All of a problem. No array is copied but what names are made to."""
    n, m = problem.dimension, problem.contacts
    near, E_T, origin = problem.near_null_space, problem.tangent, problem.slip_origin
    return Portion(
        stiffness=problem.stiffness_rows,
        load=problem.load,
        body=bodies(problem).astype(np.int64),
        motions=_null_space(problem) if near is None else near,
        dof_names=_names(problem.dof_names, n),
        normal=sp.csr_matrix(problem.normal),
        gap=problem.gap,
        tangent=sp.csr_matrix((0, n) if E_T is None else E_T),
        friction=np.zeros(m) if problem.friction is None else problem.friction,
        slip_origin=np.zeros((m, 0)) if origin is None else origin,
        contact_names=_names(problem.contact_names, m),
        tie=sp.csr_matrix(problem.tie),
        tie_value=problem.tie_value,
        hinted=near is not None,
        units=problem.units,
    )


def share_of(ranks: Ranks, holder: Holder, whole: Portion | None) -> Portion:
    """An equal share of the rows, consecutive ones. Collective.

    Parameters
    ----------
    whole : Portion, optional
        None on ranks that have it not.
    """
    sizes = None if whole is None else (len(whole.load), len(whole.gap), len(whole.tie_value), whole.slip_origin.shape)
    n, m, k, (_, width) = holder.told(sizes)  # type: ignore[misc]  # whoever has the whole says so
    unknowns, contacts, ties = _counts(ranks, n, _WHOLE_BLOCKS), _counts(ranks, m), _counts(ranks, k)

    def rows(counts: NDArray[np.intp], name: str) -> NDArray[Any]:
        return holder.rows(counts, None if whole is None else getattr(whole, name))

    def entries(counts: NDArray[np.intp], name: str) -> Any:
        return _entries(ranks, holder, counts, None if whole is None else getattr(whole, name), n)

    return Portion(
        stiffness=entries(unknowns, "stiffness"),
        load=rows(unknowns, "load"),
        body=rows(unknowns, "body"),
        motions=rows(unknowns, "motions"),
        dof_names=rows(unknowns, "dof_names"),
        normal=entries(contacts, "normal"),
        gap=rows(contacts, "gap"),
        tangent=entries(width * contacts, "tangent"),
        friction=rows(contacts, "friction"),
        slip_origin=rows(contacts, "slip_origin"),
        contact_names=rows(contacts, "contact_names"),
        tie=entries(ties, "tie"),
        tie_value=rows(ties, "tie_value"),
        hinted=holder.told(whole is not None and whole.hinted),
        units=holder.told(Units() if whole is None else whole.units),
    )


def _counts(ranks: Ranks, count: int, step: int = 1) -> NDArray[np.intp]:
    """Equal counts for all ranks, multiples of `step` but for the last one."""
    steps = -(-count // step)
    return np.diff(np.minimum(step * (steps * np.arange(ranks.size + 1) // ranks.size), count))


def _entries(ranks: Ranks, holder: Holder, counts: NDArray[np.intp], rows: Any, columns: int) -> Any:
    """Rows of a CSR matrix."""
    ends = np.cumsum(counts)
    stored = holder.told(None if rows is None else np.diff(rows.indptr[np.append(0, ends)]).astype(np.intp))
    lengths = holder.rows(counts, None if rows is None else np.diff(rows.indptr))
    indices = holder.rows(stored, None if rows is None else rows.indices)  # type: ignore[arg-type]  # as above
    data = holder.rows(stored, None if rows is None else rows.data)  # type: ignore[arg-type]
    indptr = np.append(0, np.cumsum(lengths))
    return sp.csr_matrix((data, indices, indptr), shape=(int(counts[ranks.rank]), columns))


def _null_space(problem: ContactProblem) -> NDArray[np.float64]:
    """(n, r) the motions that nothing resists, each body's from the first column on."""
    motions = null_space(problem.stiffness_rows).motions
    of = bodies(problem)[np.argmax(abs(motions), axis=0)] if motions.size else np.zeros(0, dtype=np.intp)
    column = [int(np.sum(of[:i] == body)) for i, body in enumerate(of)]
    packed = np.zeros((len(motions), max(column, default=-1) + 1))
    for i, place in enumerate(column):
        packed[:, place] += motions[:, i]
    return packed


def _names(names: Sequence[str] | None, count: int) -> NDArray[np.str_]:
    return np.empty((count, 0), dtype=str) if names is None else np.array(names, dtype=str).reshape(count, 1)


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
    """Return the numbers of the rows of a share, counted over all ranks."""
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
