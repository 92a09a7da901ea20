"""Portion: consecutive or collected rows of all that a problem consists of; the whole of it is one too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.problem import Numbers
from contactqp.distributed.ranks import Ranks, T
from contactqp.linalg.factorization import null_space
from contactqp.linalg.measures import bodies
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem, Units

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
    """Where the whole is, and how a rank gets its rows of it. Collective."""

    def rows(self, counts: NDArray[np.intp], values: NDArray[Any] | None) -> NDArray[Any]:
        """Those of this rank, of an array; counts[r] of them, in their order, are rank r's."""

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
