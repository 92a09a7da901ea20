"""Distribute a ContactProblem over ranks, so that few entries of K couple unknowns of different ranks.

1. Each rank gets an equal share of consecutive rows of the problem (`share_from_first_rank`).
2. The graph of K is cut on these shares into parts of equal size with few edges between them (`partition_graph`).
3. Rows go to the ranks of their parts and get new numbers: the nodes of rank 0 first, then those of rank 1, ...
   (`problem_from_share`).

The problem may be given to all ranks or to the first alone. Then the others only store a share and a part, and no
array of the length of all unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Ranks, ask_ranks, block_matrix, entries_of_rows, petsc
from contactqp.distributed.rows import Rows
from contactqp.linalg.factorization import null_space
from contactqp.linalg.measures import bodies
from contactqp.linalg.multigrid import block_size, constants, in_blocks
from contactqp.model.arrays import Array, Index, Indices, Vector
from contactqp.model.problem import ContactProblem, Units


def partition_graph(ranks: Ranks, indptr: Index, indices: Index) -> Indices:
    """Return a rank for each vertex of this rank, for parts of equal size with few edges between them. Collective.

    PETSc's partitioners (PTScotch, ParMETIS) are used.

    Parameters
    ----------
    ranks : the processes
    indptr, indices : arrays of int
        Vertex i of this rank has the neighbours indices[indptr[i]:indptr[i + 1]], numbered through all ranks rank after
        rank. The graph is symmetric; a vertex may be its own neighbour.
    """
    count = len(indptr) - 1
    if ranks.size == 1:
        return np.zeros(count, dtype=np.intp)
    PETSc = petsc()
    row = np.repeat(np.arange(count), np.diff(indptr))
    other = indices != row + ranks.offset(count)  # the partitioners do not accept loops
    ends = np.append(0, np.cumsum(np.bincount(row[other], minlength=count))).astype(PETSc.IntType)
    edges = indices[other].astype(PETSc.IntType)
    graph = PETSc.Mat().createAIJ(
        size=((count, None), (count, None)), csr=(ends, edges, np.ones(len(edges))), comm=ranks.comm
    )
    parts, owner = PETSc.MatPartitioning().create(ranks.comm), PETSc.IS().create(ranks.comm)
    parts.setAdjacency(graph)
    parts.setFromOptions()
    parts.apply(owner)
    found = np.array(owner.getIndices(), dtype=np.intp)
    for item in (parts, owner, graph):
        item.destroy()
    return found


class Numbering:
    """New numbers of the unknowns: the nodes of rank 0 first, then those of rank 1, ..., each in their previous order.

    A rank stores the new numbers of the blocks of its share and requests others from their ranks. The constructor is
    collective.

    Parameters
    ----------
    ranks : Ranks, the processes
    stiffness : CSR or BSR matrix
        The rows of K of this rank's share, which follow those of the rank before, over all unknowns.
    size : int, the number of unknowns of a block

    Attributes
    ----------
    owner : (blocks of the share,) array, the rank to which each block is sent
    """

    def __init__(self, ranks: Ranks, stiffness: Any, size: int) -> None:
        self.ranks, self.size = ranks, size
        indptr, indices = stiffness.indptr, stiffness.indices
        self.owner = partition_graph(ranks, indptr.astype(np.int64), indices.astype(np.int64))
        counts = np.bincount(self.owner, minlength=ranks.size)
        every = ranks.gathered(counts[None, :])  # number of blocks of each share (row) for each rank (column)
        self._first = ranks.offset(len(self.owner))
        self._share_ends = np.cumsum(every.sum(axis=1))
        self._ends = np.cumsum(every.sum(axis=0))
        before = self._ends - every.sum(axis=0) + every[: ranks.rank].sum(axis=0)
        order = np.argsort(self.owner, kind="stable")
        self._new = np.empty(len(order), dtype=np.int64)
        self._new[order] = np.repeat(before - (np.cumsum(counts) - counts), counts) + np.arange(len(order))

    def new_blocks(self, blocks: NDArray[Any]) -> Index:
        """Return the new numbers of blocks, given in any order and with repetitions. Collective."""
        distinct, place = np.unique(blocks, return_inverse=True)
        owners = np.searchsorted(self._share_ends, distinct, side="right")
        (found,) = ask_ranks(self.ranks, owners, distinct, lambda asked, _: (self._new[asked - self._first],))
        return np.asarray(found[place])

    def new_unknowns(self, unknowns: NDArray[Any]) -> Index:
        """Return the new numbers of unknowns. Collective."""
        return np.asarray(self.size * self.new_blocks(unknowns // self.size) + unknowns % self.size)

    def owner_of(self, new: Index) -> Indices:
        """Return the ranks of unknowns, given their new numbers."""
        return np.asarray(np.searchsorted(self.size * self._ends, new, side="right"))


# Blocks have one, two or three unknowns, so shares that begin at multiples of six cut none.
_WHOLE_BLOCKS = 6


@dataclass(frozen=True, eq=False)
class ProblemRows:
    """All rows of a problem, or consecutive ones: K, E_N, E_T and A are CSR matrices over all unknowns.

    Missing names and slip origins are arrays without columns.
    """

    stiffness: Any
    load: Vector
    body: Index
    motions: Array  # near_null_space, or without it the null space of K
    dof_names: NDArray[np.str_]  # (n_here, 1) or (n_here, 0)
    normal: Any
    gap: Vector
    tangent: Any  # (w m_here, n)
    friction: Vector
    slip_origin: Array  # (m_here, w)
    contact_names: NDArray[np.str_]  # (m_here, 1) or (m_here, 0)
    tie: Any
    tie_value: Vector
    tie_names: NDArray[np.str_]  # (k_here, 1) or (k_here, 0)
    from_near_null_space: bool  # whether `motions` are the problem's near_null_space
    units: Units


def rows_of_problem(problem: ContactProblem) -> ProblemRows:
    """Return all rows of a problem, copying names only."""
    n, m = problem.dimension, problem.contacts
    near, E_T, origin = problem.near_null_space, problem.tangent, problem.slip_origin
    hinted = near is not None and near.shape[1] > 0
    return ProblemRows(
        stiffness=problem.stiffness_rows,
        load=problem.load,
        body=bodies(problem).astype(np.int64),
        motions=_null_space(problem) if near is None or not hinted else near,
        dof_names=_names(problem.dof_names, n),
        normal=sp.csr_matrix(problem.normal),
        gap=problem.gap,
        tangent=sp.csr_matrix((0, n) if E_T is None else E_T),
        friction=np.zeros(m) if problem.friction is None else problem.friction,
        slip_origin=np.zeros((m, 0)) if origin is None else origin,
        contact_names=_names(problem.contact_names, m),
        tie=sp.csr_matrix(problem.tie),
        tie_value=problem.tie_value,
        tie_names=_names(problem.tie_names, problem.ties),
        from_near_null_space=hinted,
        units=problem.units,
    )


def _null_space(problem: ContactProblem) -> Array:
    """Return the null space (n, r) of K, each body's motions from the first column on."""
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
    """Return this rank's part of a problem that all ranks have. Collective."""
    return problem_from_share(ranks, _Sharing(ranks, from_first=False).share(rows_of_problem(problem)))


def share_from_first_rank(whole: ProblemRows | None, ranks: Ranks) -> ProblemRows:
    """Return this rank's equal share of a problem that only the first rank has; the others pass None. Collective."""
    return _Sharing(ranks, from_first=True).share(whole)


class _Sharing:
    """Equal shares of the rows of a problem that all ranks or only the first have. All methods are collective."""

    def __init__(self, ranks: Ranks, *, from_first: bool) -> None:
        self._ranks, self._from_first = ranks, from_first

    def share(self, whole: ProblemRows | None) -> ProblemRows:
        sizes = None if whole is None else (len(whole.load), len(whole.gap), len(whole.tie_value))
        n, m, k = self._shared(sizes)
        width = self._shared(None if whole is None else whole.slip_origin.shape[1])
        unknowns, contacts, ties = self._counts(n, _WHOLE_BLOCKS), self._counts(m), self._counts(k)
        fields: dict[str, Any] = {name: self._shared(getattr(whole, name, None)) for name in _FACTS}
        for names, counts in ((_OF_UNKNOWNS, unknowns), (_OF_CONTACTS, contacts), (_OF_TIES, ties)):
            fields |= {name: self._rows(counts, getattr(whole, name, None)) for name in names}
        matrices = {"stiffness": unknowns, "normal": contacts, "tangent": width * contacts, "tie": ties}
        for name, counts in matrices.items():
            fields[name] = self._entries(counts, getattr(whole, name, None), n)
        return ProblemRows(**fields)

    def _shared(self, value: Any) -> Any:
        """Return a value of the whole problem, sent by the first rank if only this has it."""
        return self._ranks.broadcast(value) if self._from_first else value

    def _counts(self, count: int, step: int = 1) -> Indices:
        """Return equal counts for all ranks, multiples of `step` except the last one."""
        steps = -(-count // step)
        return np.diff(np.minimum(step * (steps * np.arange(self._ranks.size + 1) // self._ranks.size), count))

    def _rows(self, counts: Indices, values: Any) -> NDArray[Any]:
        """Return this rank's rows of an array whose first counts[0] rows belong to rank 0, ..."""
        if self._from_first:
            return self._ranks.scatter(counts, values)
        begin = int(counts[: self._ranks.rank].sum())
        return np.asarray(values)[begin : begin + int(counts[self._ranks.rank])]

    def _entries(self, counts: Indices, rows: Any, columns: int) -> sp.csr_matrix:
        """Return this rank's rows of a CSR matrix."""
        ends = np.append(0, np.cumsum(counts))
        stored = self._shared(None if rows is None else np.diff(rows.indptr[ends]).astype(np.intp))
        lengths = self._rows(counts, None if rows is None else np.diff(rows.indptr))
        indices, data = (self._rows(stored, getattr(rows, name, None)) for name in ("indices", "data"))
        shape = (int(counts[self._ranks.rank]), columns)
        return sp.csr_matrix((data, indices, np.append(0, np.cumsum(lengths))), shape=shape)


# The fields of ProblemRows that are not matrices.
_FACTS = ("from_near_null_space", "units")
_OF_UNKNOWNS = ("load", "body", "motions", "dof_names")
_OF_TIES = ("tie_value", "tie_names")
_OF_CONTACTS = ("gap", "friction", "slip_origin", "contact_names")


def problem_from_share(ranks: Ranks, share: ProblemRows) -> DistributedProblem:
    """Partition a problem of which each rank has a share, and return the part of this rank. Collective."""
    K = in_blocks(share.stiffness, ranks.sum)
    size = block_size(K)
    numbering = Numbering(ranks, K, size)
    owner = np.repeat(numbering.owner, size)
    load, body, motions, dof_names, dof_number = ranks.exchange(
        owner, share.load, share.body, share.motions, share.dof_names, _numbers(ranks, share.load)
    )
    stiffness = _matrix(ranks, K, numbering)
    columns, owner = _new_columns(share.normal, numbering)
    gap, friction, origin, contact_names, contact_number = ranks.exchange(
        owner, share.gap, share.friction, share.slip_origin, share.contact_names, _numbers(ranks, share.gap)
    )
    normal = Rows.from_csr(_moved(ranks, share.normal, columns, owner), stiffness)
    tangential: dict[str, Any] = {}
    if width := origin.shape[1]:
        columns = numbering.new_unknowns(share.tangent.indices)
        rows = _moved(ranks, share.tangent, columns, np.repeat(owner, width))
        tangential = {"tangent": Rows.from_csr(rows, stiffness), "friction": friction, "slip_origin": origin}
    columns, owner = _new_columns(share.tie, numbering)
    tie_value, tie_names, tie_number = ranks.exchange(
        owner, share.tie_value, share.tie_names, _numbers(ranks, share.tie_value)
    )
    hinted = share.from_near_null_space
    return DistributedProblem(
        ranks=ranks,
        stiffness=stiffness,
        load=load,
        normal=normal,
        gap=gap,
        tie=Rows.from_csr(_moved(ranks, share.tie, columns, owner), stiffness),
        tie_value=tie_value,
        constrained=np.zeros(len(load), dtype=bool),
        body=body,
        near_null_space=motions if hinted else constants(len(load), size),
        rigid_motions=None if hinted else motions,
        dof_number=dof_number,
        contact_number=contact_number,
        tie_number=tie_number,
        units=share.units,
        dof_name=_namer("unknown {}", dof_names, dof_number),
        contact_name=_namer("contact {}", contact_names, contact_number),
        tie_name=_namer("tie {}", tie_names, tie_number),
        **tangential,
    )


def _numbers(ranks: Ranks, values: NDArray[Any]) -> Index:
    """Return the numbers of the rows of a share, counted over all ranks."""
    return ranks.offset(len(values)) + np.arange(len(values), dtype=np.int64)


def _new_columns(rows: Any, numbering: Numbering) -> tuple[Index, Indices]:
    """Return the new column numbers of entries, and for each row the rank of its first unknown."""
    unknowns = numbering.new_unknowns(rows.indices)
    owner = np.zeros(rows.shape[0], dtype=np.intp)  # rows without entries may be on any rank
    some = np.diff(rows.indptr) > 0
    owner[some] = numbering.owner_of(unknowns[rows.indptr[:-1][some]])
    return unknowns, owner


def _moved(ranks: Ranks, rows: Any, columns: Index, owner: Indices) -> Any:
    """Send rows (or rows of blocks) with new columns to their owners; return those received, as CSR or BSR."""
    order = np.argsort(owner, kind="stable")
    entries, lengths = entries_of_rows(rows.indptr, order)
    counts = np.bincount(owner, minlength=ranks.size)
    ends = np.append(0, np.cumsum(lengths))
    stored = np.diff(ends[np.append(0, np.cumsum(counts))])
    (received,) = ranks.send(counts, lengths)
    indices, data = ranks.send(stored, columns[entries], rows.data[entries])
    size = block_size(rows)
    kind = sp.csr_matrix if size == 1 else sp.bsr_matrix
    return kind((data, indices, np.append(0, np.cumsum(received))), shape=(size * len(received), rows.shape[1]))


def _matrix(ranks: Ranks, K: Any, numbering: Numbering) -> Any:
    """Build K in the new numbers from the rows (of blocks) of each rank's share."""
    rows = sp.csr_matrix(_moved(ranks, K, numbering.new_blocks(K.indices), numbering.owner))
    rows.eliminate_zeros()  # by which blocks were filled
    rows = _with_diagonal(rows, ranks.offset(rows.shape[0]))
    K = block_matrix(ranks.comm, rows.tobsr((numbering.size, numbering.size)))
    K.setOption(petsc().Mat.Option.SYMMETRIC, True)
    return K


def _with_diagonal(rows: Any, first: int) -> Any:
    """Store every diagonal entry, also of unknowns without stiffness, as PETSc requires."""
    rows.sort_indices()
    bare = np.flatnonzero(rows.diagonal(first) == 0) if rows.shape[0] else np.zeros(0, dtype=np.intp)
    if not bare.size:
        return rows
    row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
    places = (np.append(row, bare), np.append(rows.indices, first + bare))
    return sp.csr_matrix(sp.coo_matrix((np.append(rows.data, np.zeros(len(bare))), places), shape=rows.shape))


def _namer(kind: str, names: NDArray[np.str_], numbers: Index) -> Callable[[int], str]:
    return (lambda here: str(names[here, 0])) if names.size else (lambda here: kind.format(numbers[here]))
