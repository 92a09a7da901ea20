"""Vectors of twice double precision, and residuals formed in it.

The difference between an answer and the truth is K^-1 r; computed in double precision, r is rounding noise as soon as
the answer is good. Here every number is an unevaluated sum hi + lo of two doubles (Dekker 1971), products with
matrices of doubles are accumulated by the compensated dot product Dot2 (Ogita, Rump and Oishi 2005), and the relative
error of a sum is about FINE_EPS of the sum of sizes: plain IEEE arithmetic, the same on every platform. The
matrices of a problem are laid out for such products once for a stiffness and its rows (`ExtendedRows`).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp

from contactqp.model.arrays import Array, Indices, Vector
from contactqp.model.computed import OfStiffness
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, AnswerOf

# The rounding of twice double precision, for numbers as they are added and multiplied here.
FINE_EPS = 2.0**-104
# Inner products with more entries are summed in pairs.
LONG = 2**9
# If |K||du| is at most this part of |K||u| everywhere, K du is formed in doubles, with an error of 2^-101 |K||u|.
SLIGHT = 2.0**-48
# The squared number of unknowns and rows up to which all matrices are stored as one dense array, as products with zeros
# are cheaper than indexing.
ONE_ARRAY = 2**13
# The number of products formed at once, large compared with the cost of calls and small enough for the cache.
WORTH_A_CALL = 2**15
_SPLITTER = 2.0**27 + 1.0


class Extended:
    """A vector hi + lo with |lo| at most half a unit in the last place of hi."""

    __slots__ = ("hi", "lo")

    def __init__(self, hi: Any, lo: Any = None) -> None:
        self.hi: Array = np.array(hi, dtype=float)
        self.lo: Array = np.zeros(self.hi.shape) if lo is None else np.array(lo, dtype=float)

    def __len__(self) -> int:
        return len(self.hi)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return np.asarray(self.hi + self.lo, dtype=dtype)

    def __getitem__(self, index: Any) -> Extended:
        return Extended(self.hi[index], self.lo[index])

    def __neg__(self) -> Extended:
        return _holding(-self.hi, -self.lo)

    def __add__(self, other: Extended | Array) -> Extended:
        lower = self.lo
        if isinstance(other, Extended):
            lower, other = lower + other.lo, other.hi
        total, error = two_sum(self.hi, np.asarray(other, dtype=float))
        return _holding(*two_sum(total, error + lower))

    def __sub__(self, other: Extended | Array) -> Extended:
        return self + (-other)

    def parted(self, *places: int) -> list[Extended]:
        """Return the parts between these indices as views."""
        ends = zip((0, *places), (*places, len(self.hi)), strict=True)
        return [_holding(self.hi[start:end], self.lo[start:end]) for start, end in ends]

    def times(self, factor: Array | float) -> Extended:
        """Return the product with powers of two."""
        return _holding(self.hi * factor, self.lo * factor)

    def spread(self, factors: Array) -> Extended:
        """Return the products of every entry with the doubles of its row (q, w), flat."""
        products, errors = two_product(factors, self.hi[:, None])
        return _holding(products.ravel(), (errors + factors * self.lo[:, None]).ravel())

    def added_at(self, index: Any, values: Array) -> Extended:
        """Return a copy with doubles added to some entries."""
        increment = np.zeros(len(self.hi))
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
            return float(sum(_added(product, error)))
        total, carried = 0.0, 0.0
        for term, rest in zip(product.tolist(), error.tolist(), strict=True):
            partial = total + term
            virtual = partial - total
            carried += (total - (partial - virtual)) + (term - virtual) + rest
            total = partial
        return total + carried


def _holding(hi: Array, lo: Array) -> Extended:
    """Return hi + lo of two arrays without copying them."""
    made = object.__new__(Extended)
    made.hi, made.lo = hi, lo
    return made


def joined(*parts: Extended) -> Extended:
    """Return extended vectors one after the other in one."""
    return _holding(np.concatenate([one.hi for one in parts]), np.concatenate([one.lo for one in parts]))


def extend(values: Any) -> Extended:
    """Return a vector in extended precision, from doubles or extended ones."""
    return values if isinstance(values, Extended) else Extended(values)


def _flat(force: Extended | Array) -> Extended:
    """Return friction forces (m, d-1), or a flat vector of them, as a flat one in extended precision."""
    return force if isinstance(force, Extended) else Extended(force.ravel())


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
    high = _SPLITTER * a
    high -= high - a
    return high, a - high


class SparseRows:
    """A sparse matrix whose product with an extended vector is extended: rows of similar length side by side."""

    def __init__(self, matrix: Any) -> None:
        rows = matrix if sp.issparse(matrix) and matrix.format == "csr" else sp.csr_matrix(matrix)
        self.shape: tuple[int, int] = rows.shape
        lengths = rows.indptr[1:] - rows.indptr[:-1]
        width_class = np.ceil(np.log2(np.maximum(lengths, 1))).astype(int)
        filled = lengths > 0
        classes = np.flatnonzero(np.bincount(width_class[filled]))
        self._blocks = [_block(rows, np.flatnonzero((width_class == c) & filled)) for c in classes]

    def __matmul__(self, vector: Extended) -> Extended:
        doubles = not vector.lo.any()
        if self._blocks and len(self._blocks[0].members) == self.shape[0]:
            return _holding(*two_sum(*_product(self._blocks[0], vector, doubles)))
        hi, lo = np.zeros(self.shape[0]), np.zeros(self.shape[0])
        for block in self._blocks:
            hi[block.members], lo[block.members] = two_sum(*_product(block, vector, doubles))
        return _holding(hi, lo)


def _product(block: _Block, vector: Extended, doubles: bool) -> tuple[Array, Array]:
    """Return the rounded sums (q,) of the rows of a block times a vector, and their errors.

    Products are formed for several slots at once.
    """
    width, count = block.values.shape
    together = max(1, WORTH_A_CALL // count)
    for start in range(0, width, together):
        values, columns = block.values[start : start + together], block.columns[start : start + together]
        products, errors = two_product(values, vector.hi.take(columns))
        if not doubles:
            errors += values * vector.lo.take(columns)
        sums, left = _added(products, errors)
        if start == 0:
            total, rest = sums, left
            continue
        total, carried = two_sum(total, sums)
        rest = rest + (carried + left)
    return total, rest


def _added(terms: Array, errors: Array) -> tuple[Array, Array]:
    """Return the rounded sum of terms (q, ...) over the first axis and its error, those of the terms included.

    They are added in pairs and in place, which overwrites both arrays.
    """
    count = len(terms)
    while count > 1:
        half = count // 2
        sums, carried = two_sum(terms[:half], terms[count - half : count])
        errors[:half] += errors[count - half : count] + carried
        terms[:half] = sums
        count -= half
    return terms[0], errors[0]


class _Block(NamedTuple):
    """Rows of a matrix, slot by slot, each slot contiguous in memory; short rows are filled with zeros."""

    members: Indices  # (q,) which rows
    values: Array  # (width, q)
    columns: Indices  # (width, q)


def _block(rows: Any, members: Indices) -> _Block:
    start, lengths = rows.indptr[members], rows.indptr[members + 1] - rows.indptr[members]
    width = int(lengths.max())
    slots = np.arange(width, dtype=start.dtype)[:, None] + start
    values, columns = rows.data.take(slots, mode="clip"), rows.indices.take(slots, mode="clip")
    if not (lengths == width).all():
        filled = np.arange(width)[:, None] < lengths
        values, columns = np.where(filled, values, 0.0), np.where(filled, columns, 0)
    return _Block(members, values, columns)


class StiffnessRows(SparseRows):
    """A stiffness that adds K du to its last product for a slight change du of a displacement, once |K| is stored."""

    def __init__(self, rows: Any, shared: OfStiffness) -> None:
        super().__init__(rows)
        self._rows, self._shared = rows, shared
        self._last: tuple[Extended, Extended] | None = None

    def __matmul__(self, vector: Extended) -> Extended:
        last, sizes = self._last, self._shared.sizes  # read at once, as other threads may store another product
        if last is not None and sizes is not None:
            change = (vector - last[0]).double()
            if (sizes @ abs(change) <= SLIGHT * (sizes @ abs(vector.hi))).all():
                return last[1] + np.asarray(self._rows @ change)
        self._last = last = vector, super().__matmul__(vector)
        return last[1]


class ExtendedMatrix(Protocol):
    """A matrix whose product with an extended vector is extended."""

    shape: tuple[int, int]

    def __matmul__(self, vector: Extended) -> Extended: ...


class DenseRows:
    """A small matrix as an array, zeros included, whose product with an extended vector is extended."""

    def __init__(self, transposed: Array, halves: tuple[Array, Array] | None = None) -> None:
        self.shape: tuple[int, int] = (transposed.shape[1], transposed.shape[0])
        self._transposed = transposed
        self._halves = _split(transposed) if halves is None else halves

    def part(self, rows: slice, columns: slice) -> DenseRows:
        """Return a block of the matrix, which shares its entries."""
        high, low = self._halves
        return DenseRows(self._transposed[columns, rows], (high[columns, rows], low[columns, rows]))

    def __matmul__(self, vector: Extended) -> Extended:
        if not self.shape[1]:
            return Extended(np.zeros(self.shape[0]))
        return _holding(*two_sum(*_added(*self._products(vector))))

    def missing(self, limit: Array, vector: Extended) -> Extended:
        """Return limit - A x, the limit being one more term of each sum."""
        products, errors = self._products(vector)
        terms = np.concatenate([products, -limit[None]])
        hi, lo = two_sum(*_added(terms, np.concatenate([errors, np.zeros((1, len(limit)))])))
        return _holding(-hi, -lo)

    def _products(self, vector: Extended) -> tuple[Array, Array]:
        products, errors = two_product(self._transposed, vector.hi[:, None], self._halves)
        if vector.lo.any():
            errors += self._transposed * vector.lo[:, None]
        return products, errors


class ClearedRows:
    """Q'KQ with Q = I - Z Y', Y'Z = I: a stiffness without rounding along rigid motions Z (n, r).

    Z and Y are doubles; the rounding error of Y'Z = I is of second order.
    """

    def __init__(self, stiffness: ExtendedMatrix, motions: Array, inverse: Array) -> None:
        self.shape, self._stiffness = stiffness.shape, stiffness
        self._motions, self._resultants = SparseRows(motions), SparseRows(motions.T)
        self._coordinates, self._spread = inverse, SparseRows(inverse.T)

    def __matmul__(self, vector: Extended) -> Extended:
        force = self._stiffness @ (vector - self._motions @ extend(self._coordinates @ vector.double()))
        return force - self._spread @ (self._resultants @ force)


class ExtendedRows:
    """The matrices of a problem for products in extended precision, each formed on first use."""

    def __init__(self, problem: ContactProblem) -> None:
        self._of_stiffness = problem._computed.of_stiffness
        self._stiffness = problem.stiffness
        self._given = problem.stiffness_rows, problem.normal, problem.tie, problem.tangent
        counts = [0 if matrix is None else matrix.shape[0] for matrix in self._given]
        self.ends = list(accumulate(counts))  # of unknowns, contacts, ties and tangents among all of them

    @cached_property
    def together(self) -> DenseRows | None:
        """Return [K, E_N', A', E_T'; E_N, 0, ...; A, 0, ...; E_T, 0, ...] where that is small, else None."""
        n, m, k, size = self.ends
        if size * size > ONE_ARRAY:
            return None
        transposed = np.zeros((size, size))
        K = self._stiffness
        transposed[:n, :n] = K.T if isinstance(K, np.ndarray) else K.toarray().T
        for matrix, start, end in zip(self._given[1:], (n, m, k), (m, k, size), strict=True):
            if start < end:
                transposed[start:end, :n] = rows = matrix.toarray()
                transposed[:n, start:end] = rows.T
        return DenseRows(transposed)

    def _rows(self, which: int) -> ExtendedMatrix:
        """Return the rows of contacts, ties or tangents."""
        if self.together is None:
            return SparseRows(self._given[which])
        return self.together.part(slice(self.ends[which - 1], self.ends[which]), slice(self.ends[0]))

    @cached_property
    def stiffness(self) -> ExtendedMatrix:
        """Return the stiffness K (n, n), which is laid out once."""
        if self.together is not None:
            return self.together.part(slice(self.ends[0]), slice(self.ends[0]))
        rows: StiffnessRows = self._of_stiffness.extended or StiffnessRows(self._given[0], self._of_stiffness)
        self._of_stiffness.extended = rows
        return rows

    @cached_property
    def normal(self) -> ExtendedMatrix:
        """Return the normal rows E_N (m, n)."""
        return self._rows(1)

    @cached_property
    def tie(self) -> ExtendedMatrix:
        """Return the ties A (k, n)."""
        return self._rows(2)

    @cached_property
    def tangent(self) -> ExtendedMatrix | None:
        """Return the tangential rows E_T (m (d - 1), n), None where there are none."""
        return None if self._given[3] is None else self._rows(3)

    @cached_property
    def outward(self) -> ExtendedMatrix:
        """Return the transpose [E_N; A]' (n, m + k), which takes forces to the unknowns."""
        if self.together is not None:
            return self.together.part(slice(self.ends[0]), slice(self.ends[0], self.ends[2]))
        rows = sp.vstack(self._given[1:3]) if self.ends[2] > self.ends[1] else self._given[1]
        return SparseRows(rows.T)

    @cached_property
    def _tangent_transposed(self) -> ExtendedMatrix | None:
        if self._given[3] is None:
            return None
        if self.together is not None:
            return self.together.part(slice(self.ends[0]), slice(self.ends[2], None))
        return SparseRows(self._given[3].T)

    def lay_out(self) -> None:
        """Form the matrices needed for residuals in advance."""
        for name in ("stiffness", "outward", "normal", "tie") if self.together is None else ():
            getattr(self, name)

    def contact_force(self, normal_force: Extended, tie_force: Extended) -> Extended:
        """Return E_N'l_N + A'nu (n,) [force]."""
        return self.outward @ (joined(normal_force, tie_force) if len(tie_force) else normal_force)

    def friction_force(self, force: Extended | Array | None) -> Extended:
        """Return E_T'l_T (n,) of friction forces (m, d-1), or of a flat vector in extended precision [force]."""
        if self._tangent_transposed is None or force is None:
            return Extended(np.zeros(self.ends[0]))
        return self._tangent_transposed @ _flat(force)

    def cleared(self, motions: Array, inverse: Array) -> ExtendedRows:
        """Return rows whose stiffness is zero along rigid motions Z (n, r); `inverse` (r, n) is Y' with Y'Z = I."""
        twin = copy(self)
        twin.stiffness, twin.together = ClearedRows(self.stiffness, motions, inverse), None
        return twin

    def gap(self, problem: ContactProblem, displacement: Extended) -> Extended:
        """Return g - E_N u (m,)."""
        if isinstance(self.normal, DenseRows):
            return self.normal.missing(problem.gap, displacement)
        return Extended(problem.gap) - self.normal @ displacement

    def slip(self, displacement: Extended) -> Extended:
        """Return E_T u as a flat vector."""
        return Extended(np.zeros(0)) if self.tangent is None else self.tangent @ displacement


def extended_rows(problem: ContactProblem) -> ExtendedRows:
    """Return the rows for extended precision, formed once and shared by `replace`."""
    rows: ExtendedRows = problem._computed.extended or ExtendedRows(problem)
    problem._computed.extended = rows
    return rows


@dataclass(frozen=True, eq=False)
class ExtendedAnswer(AnswerOf[Extended, Extended | Array | None]):
    """A displacement with contact and tie forces in twice double precision.

    Friction forces, if any, are (m, d-1) in doubles, or flat in extended precision.
    """

    @classmethod
    def of(cls, answer: Answer) -> ExtendedAnswer:
        """Return an answer in doubles in extended precision."""
        u, normal, tie = Extended(answer.displacement), Extended(answer.normal_force), Extended(answer.tie_force)
        return cls(u, normal, answer.friction_force, tie)

    @classmethod
    def at_rest(cls, problem: ContactProblem) -> ExtendedAnswer:
        """Return the displacement of zero without forces."""
        u, force, tie = (Extended(np.zeros(size)) for size in (problem.dimension, problem.contacts, problem.ties))
        return cls(u, force, None, tie)

    def corrected(self, du: Vector, closed: Indices, dl: Vector, dn: Vector) -> ExtendedAnswer:
        """Return the answer with a correction in doubles.

        Parameters
        ----------
        du, dl, dn : (n,), (q,), (k,) arrays, changes of displacement, forces of the closed contacts, and ties
        closed : (q,) array of int
        """
        force = self.normal_force.added_at(closed, dl)
        tie = self.tie_force + dn if dn.size else self.tie_force
        return ExtendedAnswer(self.displacement + du, force, self.friction_force, tie)

    def rounded(self, closed: Indices) -> tuple[Vector, Vector, Vector]:
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

    def double(self, closed: Indices) -> tuple[Vector, Vector, Vector]:
        """Return the residuals of equilibrium, of the closed contacts' gaps and of the ties in double precision."""
        return self.force.double(), self.gap.hi[closed] + self.gap.lo[closed], self.tie.double()


def residuals_of(rows: ExtendedRows, problem: ContactProblem, answer: ExtendedAnswer) -> Residuals:
    """Return the residuals of an answer in extended precision, formed by these rows."""
    u, normal, tie, friction = answer.displacement, answer.normal_force, answer.tie_force, answer.friction_force
    if rows.together is not None:
        n, m, k, size = rows.ends
        parts, limits = [u, normal, tie], [problem.load, problem.gap, problem.tie_value]
        if size > k:
            limits.append(np.zeros(size - k))
            parts.append(_flat(limits[-1] if friction is None else friction))
        left = rows.together.missing(np.concatenate(limits), joined(*parts))
        force, gap, open_tie, beside = left.parted(n, m, k)
        return Residuals(force, gap, open_tie, -beside if size > k else None)
    outer = extend(problem.load) - rows.contact_force(normal, tie)
    if friction is not None:
        outer = outer - rows.friction_force(friction)
    gap, open_tie = extend(problem.gap) - rows.normal @ u, extend(problem.tie_value) - rows.tie @ u
    return Residuals(outer - rows.stiffness @ u, gap, open_tie)


def residuals(problem: ContactProblem, answer: Answer) -> Residuals:
    """Return the residuals of an answer, formed in extended precision."""
    return residuals_of(extended_rows(problem), problem, ExtendedAnswer.of(answer))
