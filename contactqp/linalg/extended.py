"""Vectors of twice double precision, and residuals formed in it.

The difference between an answer and the truth is K^-1 r; computed in double precision, r is rounding noise as soon as
the answer is good. Here every number is an unevaluated sum hi + lo of two doubles (Dekker 1971), products with
matrices of doubles are accumulated by the compensated dot product Dot2 (Ogita, Rump and Oishi 2005), and the relative
error of a sum is about EPS = 2^-104 of the sum of sizes: plain IEEE arithmetic, the same on every platform. The
matrices of a problem are laid out for such products once for a stiffness and its rows (`ExtendedRows`).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

EPS = 2.0**-104
# Rows with more entries are summed on their own, in pairs.
LONG = 2**9
# Matrices of at most so many places, as wide as their longest row, are one block, which takes a step for each column
# of it: no wider than this.
ONE_BLOCK, NARROW = 2**11, 2**6
# Entries of a block whose products are formed at once: calls cost less than that, and all of it stays in the cache.
WORTH_A_CALL = 2**11
_SPLITTER = 2.0**27 + 1.0
_NONE: Array = np.zeros(0)  # a sum without terms


class Extended:
    """A vector hi + lo with |lo| at most half a unit in the last place of hi."""

    __slots__ = ("hi", "lo")

    def __init__(self, hi: Any, lo: Any = None) -> None:
        self.hi: Array = np.array(hi, dtype=float)
        self.lo: Array = np.zeros(self.hi.shape) if lo is None else np.array(lo, dtype=float)

    def __len__(self) -> int:
        return len(self.hi)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        del copy  # a sum of two arrays is a new array
        return np.asarray(self.hi + self.lo, dtype=dtype)

    def __getitem__(self, index: Any) -> Extended:
        return Extended(self.hi[index], self.lo[index])

    def __neg__(self) -> Extended:
        return _holding(-self.hi, -self.lo)

    def __add__(self, other: Extended | Array) -> Extended:
        if isinstance(other, Extended):
            return _normalised(*two_sum(self.hi, other.hi), self.lo + other.lo)
        return _normalised(*two_sum(self.hi, np.asarray(other, dtype=float)), self.lo)

    def __sub__(self, other: Extended | Array) -> Extended:
        if isinstance(other, Extended):
            return _normalised(*two_sum(self.hi, -other.hi), self.lo - other.lo)
        return self + np.negative(other)

    def parted(self, *places: int) -> list[Extended]:
        """The parts between these places, which share their entries with the whole."""
        ends = zip((0, *places), (*places, len(self.hi)), strict=True)
        return [_holding(self.hi[start:end], self.lo[start:end]) for start, end in ends]

    def times(self, factor: Array | float) -> Extended:
        """Return the product with powers of two."""
        return _holding(self.hi * factor, self.lo * factor)

    def added_at(self, index: Any, values: Array) -> Extended:
        """Return a copy with doubles added to some entries."""
        increment = np.zeros_like(self.hi)
        increment[index] = values
        return self + increment

    def positive_part(self) -> Extended:
        """Return max(x, 0) of every entry."""
        positive = self.hi > 0
        return _holding(np.where(positive, self.hi, 0.0), np.where(positive, self.lo, 0.0))

    def double(self) -> Array:
        """Return the vector rounded to double precision."""
        return self.hi + self.lo

    def dot(self, other: Extended) -> float:
        """Return x'y, accumulated in extended precision and then rounded."""
        product, error = two_product(self.hi, other.hi)
        error = error + (self.hi * other.lo + self.lo * other.hi)
        if len(product) > LONG:
            return sum(_summed(product, error))
        total, carried = 0.0, 0.0
        for term, rest in zip(product.tolist(), error.tolist(), strict=True):
            partial = total + term
            virtual = partial - total
            carried += (total - (partial - virtual)) + (term - virtual) + rest
            total = partial
        return total + carried


def _holding(hi: Array, lo: Array) -> Extended:
    """Return hi + lo of two arrays that nobody else holds, which are therefore not copied."""
    made = object.__new__(Extended)
    made.hi, made.lo = hi, lo
    return made


def _normalised(total: Array, error: Array, lower: Array) -> Extended:
    """Return total + (error + lower), the error being that of the total."""
    return _holding(*two_sum(total, error + lower))


def extend(values: Any) -> Extended:
    """Return a vector of doubles, or one that is extended already, in extended precision."""
    return values if isinstance(values, Extended) else Extended(values)


def two_sum(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the rounded sum of a + b and its error, which together are exact (Knuth 1969)."""
    total = a + b
    virtual = total - a
    return total, (a - (total - virtual)) + (b - virtual)


def two_product(a: Array, b: Array, halves: tuple[Array, Array] | None = None) -> tuple[Array, Array]:
    """Return the rounded product of a b and its error, exact together (Dekker 1971); `halves` of a may be known."""
    product = a * b
    a_high, a_low = _split(a) if halves is None else halves
    b_high, b_low = _split(b)
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def _split(a: Array) -> tuple[Array, Array]:
    scaled = _SPLITTER * a
    high = scaled - (scaled - a)
    return high, a - high


class _Entries(NamedTuple):
    """The entries of a matrix, row by row, as those of a CSR matrix."""

    data: Array
    indices: NDArray[np.intp]
    indptr: NDArray[np.intp]
    shape: tuple[int, int]


def _stacked(matrices: list[Any]) -> _Entries:
    """Return the entries of [A; B; ...] of CSR matrices with the same columns; those without rows are left out."""
    filled = [matrix for matrix in matrices if matrix.shape[0]]
    if len(filled) < 2:
        one = filled[0] if filled else matrices[0]
        return _Entries(one.data, one.indices, one.indptr, one.shape)
    indptr, before = [filled[0].indptr], filled[0].indptr[-1]
    for matrix in filled[1:]:
        indptr.append(matrix.indptr[1:] + before)
        before = before + matrix.indptr[-1]
    data, indices = (np.concatenate([getattr(one, name) for one in filled]) for name in ("data", "indices"))
    return _Entries(data, indices, np.concatenate(indptr), (sum(one.shape[0] for one in filled), filled[0].shape[1]))


def _transposed(matrices: list[Any]) -> _Entries:
    """Return the entries of [A; B; ...]' of CSR matrices with the same columns."""
    rows = _stacked(matrices)
    size, count = rows.shape
    order = rows.indices.argsort(kind="stable")
    starts = np.zeros(count + 1, dtype=np.intp)
    np.bincount(rows.indices, minlength=count).cumsum(out=starts[1:])
    return _Entries(
        rows.data[order], np.arange(size).repeat(rows.indptr[1:] - rows.indptr[:-1])[order], starts, (count, size)
    )


def _are_one_block(lengths: NDArray[np.intp]) -> bool:
    """Whether rows with so many entries each are so few, and so short, that all of them are one block."""
    widest = int(lengths.max(initial=0))
    return widest * len(lengths) <= ONE_BLOCK and widest <= NARROW


class SparseRows:
    """A sparse matrix whose product with an extended vector is extended: rows of similar length side by side."""

    def __init__(self, matrix: Any) -> None:
        rows = (
            matrix
            if isinstance(matrix, _Entries) or (sp.issparse(matrix) and matrix.format == "csr")
            else sp.csr_matrix(matrix)
        )
        self.shape: tuple[int, int] = rows.shape
        lengths = rows.indptr[1:] - rows.indptr[:-1]
        self._long: list[tuple[int, Array, NDArray[np.intp]]] = []
        self.is_one_block = _are_one_block(lengths)
        if self.is_one_block:
            self._blocks = [_block(rows, lengths.nonzero()[0], halves=True)] if lengths.any() else []
            return
        width_class = np.ceil(np.log2(np.maximum(lengths, 1))).astype(int)
        short = (lengths > 0) & (lengths <= LONG)
        classes = np.unique(width_class[short])
        self._blocks = [_block(rows, np.flatnonzero((width_class == c) & short)) for c in classes]
        self._long = [
            (i, rows.data[rows.indptr[i] : rows.indptr[i + 1]], rows.indices[rows.indptr[i] : rows.indptr[i + 1]])
            for i in (lengths > LONG).nonzero()[0].tolist()
        ]

    def __matmul__(self, vector: Extended) -> Extended:
        doubles = not vector.lo.any()
        if self._blocks and not self._long and len(self._blocks[0].members) == self.shape[0]:
            return _holding(*two_sum(*_product(self._blocks[0], vector, doubles)))
        hi, lo = np.zeros(self.shape[0]), np.zeros(self.shape[0])
        for block in self._blocks:
            hi[block.members], lo[block.members] = two_sum(*_product(block, vector, doubles))
        for i, value, column in self._long:
            product, error = two_product(value, vector.hi[column])
            hi[i], lo[i] = _summed(product, error + value * vector.lo[column])
        return _holding(hi, lo)


def _product(block: _Block, vector: Extended, doubles: bool) -> tuple[Array, Array]:
    """Return the rounded sums (q,) of the rows of a block times a vector, and their errors.

    Products are formed for as many slots at once as make an operation worth its call; their sums run slot by slot.
    """
    width, count = block.values.shape
    total, rest = _NONE, _NONE
    together = width if block.halves is not None else max(1, WORTH_A_CALL // count)
    for start in range(0, width, together):
        values, columns = block.values[start : start + together], block.columns[start : start + together]
        products, errors = two_product(values, vector.hi.take(columns), block.halves)
        if not doubles:
            errors = errors + values * vector.lo.take(columns)
        for product, error in zip(products, errors, strict=True):
            if total is _NONE:
                total, rest = product, error
                continue
            total, carried = two_sum(total, product)
            rest = rest + (carried + error)
    return total, rest


def _summed(terms: Array, errors: Array) -> tuple[float, float]:
    """Return the sum of terms and their errors, added in pairs."""
    while len(terms) > 1:
        if len(terms) % 2:
            terms, errors = np.append(terms, 0.0), np.append(errors, 0.0)
        terms, carried = two_sum(terms[::2], terms[1::2])
        errors = errors[::2] + errors[1::2] + carried
    total, rest = two_sum(terms, errors)
    return float(total[0]), float(rest[0])


class _Block(NamedTuple):
    """Rows of a matrix, slot by slot, each slot contiguous in memory; short rows are filled with zeros."""

    members: NDArray[np.intp]  # (q,) which rows
    values: Array  # (width, q)
    columns: NDArray[np.intp]  # (width, q)
    halves: tuple[Array, Array] | None  # of the values, where all products are formed at once


def _block(rows: Any, members: NDArray[np.intp], halves: bool = False) -> _Block:
    start, lengths = rows.indptr[members], rows.indptr[members + 1] - rows.indptr[members]
    width = int(lengths.max())
    slots = np.arange(width, dtype=start.dtype)[:, None] + start
    values, columns = rows.data.take(slots, mode="clip"), rows.indices.take(slots, mode="clip")
    if not (lengths == width).all():
        filled = np.arange(width)[:, None] < lengths
        values, columns = np.where(filled, values, 0.0), np.where(filled, columns, 0)
    return _Block(members, values, columns, _split(values) if halves else None)


class ExtendedMatrix(Protocol):
    """A matrix whose product with an extended vector is extended."""

    shape: tuple[int, int]

    def __matmul__(self, vector: Extended) -> Extended: ...


class ClearedRows:
    """Q'KQ with Q = I - Z Y', Y'Z = I: a stiffness whose rounding along rigid motions Z (n, r) is taken away.

    Z and Y are doubles; what Y'Z misses of one by rounding is rounding of K's rounding.
    """

    def __init__(self, stiffness: SparseRows, motions: Array, inverse: Array) -> None:
        self.shape = stiffness.shape
        self._stiffness = stiffness
        self._motions, self._resultants = SparseRows(motions), SparseRows(motions.T)
        self._coordinates, self._spread = inverse, SparseRows(inverse.T)

    def __matmul__(self, vector: Extended) -> Extended:
        force = self._stiffness @ (vector - self._motions @ extend(self._coordinates @ vector.double()))
        return force - self._spread @ (self._resultants @ force)


class ExtendedRows:
    """The matrices of a problem, for products in extended precision; each is laid out when it is asked for."""

    def __init__(self, problem: ContactProblem) -> None:
        self._of_stiffness = problem._computed.of_stiffness
        self._given = problem.stiffness_rows, problem.normal, problem.tie, problem.tangent

    @cached_property
    def stiffness(self) -> ExtendedMatrix:
        """Return the stiffness K (n, n), which is laid out once."""
        if self._of_stiffness.extended is None:
            self._of_stiffness.extended = SparseRows(self._given[0])
        rows: SparseRows = self._of_stiffness.extended
        return rows

    @cached_property
    def normal(self) -> ExtendedMatrix:
        """Return the normal rows E_N (m, n)."""
        return SparseRows(self._given[1])

    @cached_property
    def tie(self) -> ExtendedMatrix:
        """Return the ties A (k, n)."""
        return SparseRows(self._given[2])

    @cached_property
    def tangent(self) -> SparseRows | None:
        """Return the tangential rows E_T (m (d - 1), n), None where there are none."""
        return None if self._given[3] is None else SparseRows(self._given[3])

    @cached_property
    def together(self) -> SparseRows | None:
        """[K; E_N; A; E_T] where these are one block, whose product takes as many steps as that with one of them."""
        given = [matrix for matrix in self._given if matrix is not None]
        if sum(matrix.shape[0] for matrix in given) > ONE_BLOCK:
            return None
        rows = SparseRows(_stacked(given))
        return rows if rows.is_one_block else None

    def parted(self, together: Extended) -> list[Extended]:
        """The parts K u, E_N u, A u and, if there are tangents, E_T u of a product with all of them."""
        stiffness, normal, tie, _ = self._given
        contacts = stiffness.shape[0] + normal.shape[0]
        return together.parted(stiffness.shape[0], contacts, contacts + tie.shape[0])

    @cached_property
    def outward(self) -> ExtendedMatrix:
        """Return the transpose [E_N; A]' (n, m + k), which takes forces to the unknowns."""
        return SparseRows(_transposed(list(self._given[1:3])))

    @cached_property
    def _tangent_transposed(self) -> SparseRows | None:
        return None if self._given[3] is None else SparseRows(_transposed([self._given[3]]))

    def lay_out(self) -> None:
        """Lay out what residuals of an answer are formed with."""
        for name in ("outward", *(("stiffness", "normal", "tie") if self.together is None else ())):
            getattr(self, name)

    def contact_force(self, normal_force: Extended, tie_force: Extended) -> Extended:
        """Return E_N'l_N + A'nu (n,) [force]."""
        if not len(tie_force):
            return self.outward @ normal_force
        hi = np.concatenate([normal_force.hi, tie_force.hi])
        return self.outward @ _holding(hi, np.concatenate([normal_force.lo, tie_force.lo]))

    def friction_force(self, force: Extended | NDArray[np.float64] | None) -> Extended:
        """Return E_T'l_T (n,) of friction forces (m, d-1), or of a flat vector in extended precision [force]."""
        if self._tangent_transposed is None or force is None:
            return Extended(np.zeros(self.stiffness.shape[0]))
        return self._tangent_transposed @ (force if isinstance(force, Extended) else Extended(force.ravel()))

    def cleared(self, motions: Array, inverse: Array) -> ExtendedRows:
        """Return rows whose stiffness is zero along rigid motions Z (n, r); `inverse` (r, n) is Y' with Y'Z = I."""
        assert isinstance(self.stiffness, SparseRows)
        twin = copy(self)
        twin.stiffness, twin.together = ClearedRows(self.stiffness, motions, inverse), None
        return twin

    def gap(self, problem: ContactProblem, displacement: Extended) -> Extended:
        """Return g - E_N u (m,)."""
        if self.together is None:
            return Extended(problem.gap) - self.normal @ displacement
        return Extended(problem.gap) - self.parted(self.together @ displacement)[1]

    def slip(self, displacement: Extended) -> Extended:
        """Return E_T u as a flat vector."""
        if self.together is not None:
            return self.parted(self.together @ displacement)[3]
        return Extended(np.zeros(0)) if self.tangent is None else self.tangent @ displacement


def extended_rows(problem: ContactProblem) -> ExtendedRows:
    """Return the rows for extended precision; they are formed once and shared by all that `replace` derives."""
    if problem._computed.extended is None:
        problem._computed.extended = ExtendedRows(problem)
    rows: ExtendedRows = problem._computed.extended
    return rows


@dataclass(frozen=True, eq=False)
class ExtendedAnswer:
    """A displacement with contact and tie forces in twice double precision; friction forces in doubles, if any."""

    displacement: Extended  # (n,)
    normal_force: Extended  # (m,)
    tie_force: Extended  # (k,)
    friction_force: Extended | Array | None = None  # (m, d-1), or flat in extended precision

    @classmethod
    def of(cls, answer: Answer) -> ExtendedAnswer:
        """Return the answer that these doubles are."""
        u, normal, tie = Extended(answer.displacement), Extended(answer.normal_force), Extended(answer.tie_force)
        return cls(u, normal, tie, answer.friction_force)

    @classmethod
    def at_rest(cls, problem: ContactProblem) -> ExtendedAnswer:
        """Return the displacement of zero without forces."""
        return cls(*(Extended(np.zeros(size)) for size in (problem.dimension, problem.contacts, problem.ties)))

    def corrected(self, du: Vector, closed: NDArray[np.intp], dl: Vector, dn: Vector) -> ExtendedAnswer:
        """Return the answer with a correction in doubles; contact forces (q,) are those of the closed contacts."""
        force = self.normal_force.added_at(closed, dl)
        tie = self.tie_force + dn if dn.size else self.tie_force
        return ExtendedAnswer(self.displacement + du, force, tie, self.friction_force)

    def rounded(self, closed: NDArray[np.intp]) -> tuple[Vector, Vector, Vector]:
        """Return displacement, forces of the closed contacts and of ties in double precision."""
        force = self.normal_force.hi[closed] + self.normal_force.lo[closed]
        return self.displacement.double(), force, self.tie_force.double()

    def double(self) -> Answer:
        """Return the answer without friction, rounded to double precision."""
        return Answer(self.displacement.double(), self.normal_force.double(), None, self.tie_force.double())


@dataclass(frozen=True, eq=False)
class Residuals:
    """The residuals of equilibrium, gaps and ties of an answer, in extended precision."""

    force: Extended  # (n,) f - K u - E_N'l_N - E_T'l_T - A'nu
    gap: Extended  # (m,) g - E_N u
    tie: Extended  # (k,) b - A u
    slip: Extended | None = None  # ((d-1) m,) E_T u, where it was formed with the others

    @classmethod
    def at_rest(cls, problem: ContactProblem) -> Residuals:
        """Return the residuals of zero displacement without forces, which are the data of the problem."""
        return cls(Extended(problem.load), Extended(problem.gap), Extended(problem.tie_value))

    def double(self, closed: NDArray[np.intp]) -> tuple[Vector, Vector, Vector]:
        """Return the residuals of equilibrium, of the closed contacts' gaps and of the ties in double precision."""
        return self.force.double(), self.gap.hi[closed] + self.gap.lo[closed], self.tie.double()


def residuals_of(rows: ExtendedRows, problem: ContactProblem, answer: ExtendedAnswer) -> Residuals:
    """Return the residuals of an answer, formed with these rows in extended precision."""
    u, friction = answer.displacement, answer.friction_force
    outer = extend(problem.load) - rows.contact_force(answer.normal_force, answer.tie_force)
    if friction is not None:
        outer = outer - rows.friction_force(friction)
    if rows.together is None:
        gap, open_tie = extend(problem.gap) - rows.normal @ u, extend(problem.tie_value) - rows.tie @ u
        return Residuals(outer - rows.stiffness @ u, gap, open_tie)
    product, m = rows.together @ u, problem.contacts
    limit = np.zeros(len(product) - len(outer))
    lower = np.concatenate([outer.lo, limit])
    limit[:m], limit[m : m + problem.ties] = problem.gap, problem.tie_value
    force, gap, open_tie, beside = rows.parted(_holding(np.concatenate([outer.hi, limit]), lower) - product)
    return Residuals(force, gap, open_tie, -beside if len(beside) else None)


def residuals(problem: ContactProblem, answer: Answer) -> Residuals:
    """Return the residuals of an answer, formed in extended precision."""
    return residuals_of(extended_rows(problem), problem, ExtendedAnswer.of(answer))


def plain_residuals(problem: ContactProblem, answer: Answer) -> Residuals:
    """Return the residuals of an answer in double precision, each to a few dozen roundings of the sizes that meet."""
    u = answer.displacement
    outer = problem.normal.T @ answer.normal_force + problem.tie.T @ answer.tie_force
    if problem.tangent is not None and answer.friction_force is not None:
        outer = outer + problem.tangent.T @ answer.friction_force.ravel()
    force = problem.load - problem.stiffness_rows @ u - outer
    return Residuals(
        extend(force), extend(problem.gap - problem.normal @ u), extend(problem.tie_value - problem.tie @ u)
    )
