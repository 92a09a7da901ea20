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
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.model.arrays import Array, Vector
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

EPS = 2.0**-104
# Where the processor has floats of 64 digits, sums of at most so many terms lose no more than half an eps of the sum of
# sizes in them: enough for what is told from the rounding of doubles, in a third of the time.
SHORT = 2**11
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

    def half(self) -> Extended:
        return _holding(self.hi / 2, self.lo / 2)

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


def two_product(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the rounded product of a b and its error, which together are exact (Dekker 1971, Veltkamp's splitting)."""
    product = a * b
    a_high, a_low = _split(a)
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


def _transposed(matrices: list[Any]) -> _Entries:
    """Return the entries of [A; B; ...]' of CSR matrices with the same columns."""
    columns, count = np.concatenate([matrix.indices for matrix in matrices]), matrices[0].shape[1]
    lengths = np.concatenate([np.diff(matrix.indptr) for matrix in matrices])
    order = np.argsort(columns, kind="stable")
    starts = np.zeros(count + 1, dtype=np.intp)
    np.cumsum(np.bincount(columns, minlength=count), out=starts[1:])
    data = np.concatenate([matrix.data for matrix in matrices])
    return _Entries(data[order], np.repeat(np.arange(len(lengths)), lengths)[order], starts, (count, len(lengths)))


class SparseRows:
    """A sparse matrix whose product with an extended vector is extended: rows of similar length side by side."""

    def __init__(self, matrix: Any) -> None:
        rows = (
            matrix
            if isinstance(matrix, _Entries) or (sp.issparse(matrix) and matrix.format == "csr")
            else sp.csr_matrix(matrix)
        )
        self.shape: tuple[int, int] = rows.shape
        lengths = np.diff(rows.indptr)
        widest = int(np.max(lengths, initial=0))
        if widest * len(lengths) <= ONE_BLOCK and widest <= NARROW:
            self._blocks, self._long = ([_block(rows, np.flatnonzero(lengths))] if widest else []), []
            return
        width_class = np.ceil(np.log2(np.maximum(lengths, 1))).astype(int)
        short = (lengths > 0) & (lengths <= LONG)
        classes = np.unique(width_class[short])
        self._blocks = [_block(rows, np.flatnonzero((width_class == c) & short)) for c in classes]
        self._long = [
            (i, rows.data[rows.indptr[i] : rows.indptr[i + 1]], rows.indices[rows.indptr[i] : rows.indptr[i + 1]])
            for i in np.flatnonzero(lengths > LONG)
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
    together = max(1, WORTH_A_CALL // count)
    for start in range(0, width, together):
        values, columns = block.values[start : start + together], block.columns[start : start + together]
        products, errors = two_product(values, vector.hi[columns])
        if not doubles:
            errors = errors + values * vector.lo[columns]
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


def images(matrix: Any, columns: Array) -> Array:
    """Return K z of every column z (n, q), accurate to half an eps of |K||z| and rounded to doubles."""
    rows = sp.csr_matrix(matrix)
    if not columns.size:
        return np.zeros((rows.shape[0], columns.shape[1]))
    if np.finfo(np.longdouble).nmant == 63 and np.max(np.diff(rows.indptr), initial=0) <= SHORT:
        long = sp.csr_matrix((rows.data.astype(np.longdouble), rows.indices, rows.indptr), shape=rows.shape)
        return np.column_stack([np.asarray(long @ z.astype(np.longdouble), dtype=float) for z in columns.T])
    return exact_images(rows, columns)


def exact_images(matrix: Any, columns: Array) -> Array:
    """Return K z of every column z (n, q), accumulated in pairs of doubles to tell soft motions from rigid ones."""
    extended = SparseRows(sp.csr_matrix(matrix))
    return np.column_stack([(extended @ extend(z)).double() for z in columns.T]) if columns.size else columns * 0.0


class _Block(NamedTuple):
    """Rows of a matrix, slot by slot, each slot contiguous in memory; short rows are filled with zeros."""

    members: NDArray[np.intp]  # (q,) which rows
    values: Array  # (width, q)
    columns: NDArray[np.intp]  # (width, q)


def _block(rows: Any, members: NDArray[np.intp]) -> _Block:
    start, lengths = rows.indptr[members], rows.indptr[members + 1] - rows.indptr[members]
    width = int(lengths.max())
    slots = np.arange(width, dtype=start.dtype)[:, None] + start
    values, columns = rows.data.take(slots, mode="clip"), rows.indices.take(slots, mode="clip")
    if np.all(lengths == width):
        return _Block(members, values, columns)
    filled = np.arange(width)[:, None] < lengths
    return _Block(members, np.where(filled, values, 0.0), np.where(filled, columns, 0))


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
    """The matrices of a problem, for products in extended precision."""

    stiffness: SparseRows | ClearedRows

    def __init__(self, problem: ContactProblem) -> None:
        self.stiffness = _stiffness_rows(problem)
        self.normal = SparseRows(problem.normal)
        self.tie = SparseRows(problem.tie)
        self.tangent = None if problem.tangent is None else SparseRows(problem.tangent)
        self._outward = SparseRows(_transposed([problem.normal, problem.tie]))
        self._tangent_transposed = None if problem.tangent is None else SparseRows(_transposed([problem.tangent]))

    def contact_force(self, normal_force: Extended, tie_force: Extended) -> Extended:
        """Return E_N'l_N + A'nu (n,) [force]."""
        hi = np.concatenate([normal_force.hi, tie_force.hi])
        return self._outward @ _holding(hi, np.concatenate([normal_force.lo, tie_force.lo]))

    def friction_force(self, force: Extended | NDArray[np.float64] | None) -> Extended:
        """Return E_T'l_T (n,) of friction forces (m, d-1), or of a flat vector in extended precision [force]."""
        if self._tangent_transposed is None or force is None:
            return Extended(np.zeros(self.stiffness.shape[0]))
        return self._tangent_transposed @ (force if isinstance(force, Extended) else Extended(force.ravel()))

    def cleared(self, motions: Array, inverse: Array) -> ExtendedRows:
        """Return rows whose stiffness is zero along rigid motions Z (n, r); `inverse` (r, n) is Y' with Y'Z = I."""
        twin = copy(self)
        assert isinstance(self.stiffness, SparseRows)
        twin.stiffness = ClearedRows(self.stiffness, motions, inverse)
        return twin

    def gap(self, problem: ContactProblem, displacement: Extended) -> Extended:
        """Return g - E_N u (m,)."""
        return Extended(problem.gap) - self.normal @ displacement

    def slip(self, displacement: Extended) -> Extended:
        """Return E_T u as a flat vector."""
        return Extended(np.zeros(0)) if self.tangent is None else self.tangent @ displacement


def _stiffness_rows(problem: ContactProblem) -> SparseRows:
    of_stiffness = problem._computed.of_stiffness
    if of_stiffness.extended is None:
        of_stiffness.extended = SparseRows(problem.stiffness_rows)
    rows: SparseRows = of_stiffness.extended
    return rows


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
        return ExtendedAnswer(self.displacement + du, force, self.tie_force + dn, self.friction_force)

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
    gap, open_tie = extend(problem.gap) - rows.normal @ u, extend(problem.tie_value) - rows.tie @ u
    return Residuals(outer - rows.stiffness @ u, gap, open_tie)


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


def velocity_of(problem: LocalProblem, force: Array, joint_force: Vector | None = None) -> Array:
    """Return u = W r + q + V l (m, d) of a problem in local form at forces (m, d) and (p,), in twice double precision.

    Forces that redundant contacts press against each other may be so large that in doubles nothing is left of q.
    """
    u = SparseRows(problem.delassus) @ extend(np.asarray(force, dtype=float).ravel()) + extend(problem.offset)
    if joint_force is not None and problem.joints:
        u = u + SparseRows(problem.bilateral) @ extend(joint_force)
    return np.asarray(u.double().reshape(problem.contacts, problem.dimension))
