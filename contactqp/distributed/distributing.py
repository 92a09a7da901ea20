"""From a ContactProblem that every rank has to the part of each: rows go where the graph of K is cut least."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.environment import petsc
from contactqp.distributed.partition import partition
from contactqp.distributed.problem import DistributedProblem, Numbers
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.rows import Rows
from contactqp.factorization import null_space
from contactqp.multigrid import block_size, in_blocks
from contactqp.problem import ContactProblem
from contactqp.violations import bodies


def distribute(problem: ContactProblem, ranks: Ranks) -> DistributedProblem:
    """This rank's part of a problem that all ranks were given alike. Collective."""
    K = in_blocks(problem.stiffness_rows)
    size = block_size(K)
    owner = _owners(ranks, K)
    order = np.argsort(owner, kind="stable")  # new block i was block order[i]
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    mine = np.flatnonzero(owner == ranks.rank)
    dofs = (size * mine[:, None] + np.arange(size)).ravel()
    new = (size * place[:, None] + np.arange(size)).ravel()  # the new number of each unknown
    stiffness = _matrix(ranks, problem.stiffness_rows[dofs], dofs, new, size)
    dof_owner = np.repeat(owner, size)

    def part(rows: Any) -> NDArray[np.intp]:
        return np.flatnonzero(_owner_of_rows(rows, dof_owner) == ranks.rank)

    contacts, ties = part(problem.normal), part(problem.tie)
    B = problem.near_null_space
    tangential: dict[str, Any] = {}
    if problem.tangent is not None and problem.slip_origin is not None:
        per = problem.slip_origin.shape[1]
        along = (per * contacts[:, None] + np.arange(per)).ravel()
        tangential = {
            "tangent": _rows(problem.tangent[along], new, stiffness),
            "friction": None if problem.friction is None else problem.friction[contacts],
            "slip_origin": problem.slip_origin[contacts],
        }
    return DistributedProblem(
        ranks=ranks,
        stiffness=stiffness,
        load=problem.load[dofs],
        normal=_rows(problem.normal[contacts], new, stiffness),
        gap=problem.gap[contacts],
        tie=_rows(problem.tie[ties], new, stiffness),
        tie_value=problem.tie_value[ties],
        held=np.zeros(len(dofs), dtype=bool),
        body=bodies(problem)[dofs].astype(np.int64),
        near_null_space=_constants(len(dofs), size) if B is None else B[dofs],
        rigid=_null_space(problem)[dofs] if B is None else None,
        dof_number=dofs.astype(np.int64),
        contact_number=contacts.astype(np.int64),
        tie_number=ties.astype(np.int64),
        units=problem.units,
        dof_name=_named(problem.dof_name, dofs),
        contact_name=_named(problem.contact_name, contacts),
        tie_name=_named("tie {}".format, ties),
        **tangential,
    )


def _null_space(problem: ContactProblem) -> NDArray[np.float64]:
    """(n, r) the motions that nothing resists, each body's from the first column on."""
    motions = null_space(problem.stiffness_rows).motions
    of = bodies(problem)[np.argmax(abs(motions), axis=0)] if motions.size else np.zeros(0, dtype=np.intp)
    column = [int(np.sum(of[:i] == body)) for i, body in enumerate(of)]
    packed = np.zeros((len(motions), max(column, default=-1) + 1))
    for i, place in enumerate(column):
        packed[:, place] += motions[:, i]
    return packed


def _owners(ranks: Ranks, K: Any) -> NDArray[np.intp]:
    """The rank of each block of unknowns, on every rank: each states the graph of an equal share of them."""
    count = len(K.indptr) - 1
    begin, end = (count * (ranks.rank + i) // ranks.size for i in range(2))
    indptr = K.indptr[begin : end + 1].astype(np.int64)
    return ranks.gathered(partition(ranks, indptr - indptr[0], K.indices[indptr[0] : indptr[-1]].astype(np.int64)))


def _owner_of_rows(rows: Any, owner: NDArray[np.intp]) -> NDArray[np.intp]:
    """The rank that has the first unknown of each row."""
    rows = sp.csr_matrix(rows)
    found = np.zeros(rows.shape[0], dtype=np.intp)  # a row of nothing may stand anywhere
    some = np.diff(rows.indptr) > 0
    found[some] = owner[rows.indices[rows.indptr[:-1][some]]]
    return found


def _matrix(ranks: Ranks, rows: Any, dofs: NDArray[np.intp], new: NDArray[np.intp], size: int) -> Any:
    """Rows of K in the new numbers: `rows` are those of the unknowns `dofs`."""
    PETSc = petsc()
    row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
    own = np.arange(rows.shape[0])
    # PETSc wants a place for every diagonal entry, of an unknown without stiffness too.
    entries = (np.append(rows.data, np.zeros(len(own))), (np.append(row, own), np.append(new[rows.indices], new[dofs])))
    csr = sp.csr_matrix(sp.coo_matrix(entries, shape=rows.shape))
    K = PETSc.Mat().createAIJ(
        size=((rows.shape[0], len(new)), (rows.shape[0], len(new))),
        bsize=size,
        csr=(csr.indptr.astype(PETSc.IntType), csr.indices.astype(PETSc.IntType), csr.data),
        comm=ranks.comm,
    )
    K.setOption(PETSc.Mat.Option.SPD, False)
    K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return K


def _rows(rows: Any, new: NDArray[np.intp], like: Any) -> Rows:
    """Rows of a sparse matrix over the unknowns in their old numbers."""
    rows = sp.csr_matrix(rows)
    columns = np.unique(rows.indices)
    return Rows(rows[:, columns], new[columns], like)


def _constants(count: int, size: int) -> NDArray[np.float64]:
    return np.tile(np.eye(size), (count // size, 1))


def _named(name: Callable[[int], str], numbers: NDArray[np.intp] | Numbers) -> Callable[[int], str]:
    return lambda here: name(int(numbers[here]))
