"""Refine an answer with residuals formed in integers, and bound the least eigenvalues for enclosures.

The correction w = D (u* - u) of an approximation (u, l, nu), magnified by D, solves a problem of the same kind:

    minimise  1/2 w'Kw - D r'w,   r = f - K u - E'l - A'nu,
    subject to  E_i w = D (g - E u)_i   if l_i is large compared to the residuals, so that its correction has any sign,
        E_i w <= D (g - E u)_i  otherwise, with l_i set to zero,
                A w = D (b - A u).

The residuals are formed in integers without rounding, and D grows as they decrease, so that contacts undecided in
doubles show a gap or a force. This is scaled refinement of quadratic programs: Weber, Sager and Gleixner (2019),
Mathematical Programming Computation 11, 421, where slacks and their signs are magnified too.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem, NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.model.arrays import EPS, Array, Indices, Vector, refuse_late, tell
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import AnswerOf, Solution
from contactqp.solving.solve import solve

# Floats as integers, with exact products of sparse matrices.

Integers = NDArray[Any]  # object arrays of Python integers


@dataclass(frozen=True, eq=False)
class Fixed:
    """The numbers `integers` / 2^`bits`."""

    integers: Integers
    bits: int

    def __add__(self, other: Fixed) -> Fixed:
        bits = max(self.bits, other.bits)
        return Fixed(self._at(bits) + other._at(bits), bits)

    def __sub__(self, other: Fixed) -> Fixed:
        bits = max(self.bits, other.bits)
        return Fixed(self._at(bits) - other._at(bits), bits)

    def __getitem__(self, where: Any) -> Fixed:
        return Fixed(self.integers[where], self.bits)

    def _at(self, bits: int) -> Integers:
        return self.integers << (bits - self.bits) if bits > self.bits else self.integers

    def rounded(self, bits: int) -> Fixed:
        """Return the numbers rounded down to multiples of 2^-bits."""
        return self if bits >= self.bits else Fixed(self.integers >> (self.bits - bits), bits)

    def times_power(self, exponent: int) -> Fixed:
        """Return the numbers times 2^exponent."""
        return Fixed(self.integers, self.bits - exponent)

    def floats(self) -> Array:
        """Return the nearest doubles.

        Raises NotConverged: a number overflows.
        """
        one = 1 << max(self.bits, 0)
        more = 1 << max(-self.bits, 0)
        try:
            return np.array([x * more / one for x in self.integers.tolist()], dtype=float)
        except OverflowError:
            raise NotConverged("refine: the numbers of what is left leave the range of doubles") from None

    def floats_at(self, power: int) -> Array:
        """Return the nearest doubles of 2^power x, as `floats` does."""
        return self.times_power(power).floats()

    def fractions(self) -> NDArray[Any]:
        one = Fraction(1, 2**self.bits) if self.bits >= 0 else Fraction(2**-self.bits)
        array = np.empty(len(self.integers), dtype=object)
        array[:] = [x * one for x in self.integers.tolist()]
        return array

    @property
    def exponent(self) -> int:
        """Return the least e with |x| < 2^e for all numbers, a very small one if all are zero."""
        return max((abs(x).bit_length() for x in self.integers.tolist()), default=0) - self.bits


def fixed(values: Any) -> Fixed:
    """Return floats in fixed point without rounding."""
    flat = np.asarray(values, dtype=float).ravel()
    mantissa, exponent = np.frexp(flat)
    used = exponent[mantissa != 0]
    bits = int(53 - np.min(used)) if used.size else 0
    whole = np.ldexp(mantissa, 53).astype(np.int64).astype(object)
    shifts = np.where(mantissa != 0, exponent - 53 + bits, 0).astype(object)
    return Fixed(whole << shifts if len(flat) else np.zeros(0, dtype=object), bits)


class FixedMatrix:
    """A sparse matrix of floats in exact arithmetic."""

    def __init__(self, rows: Any) -> None:
        rows = rows.tocsr()
        self.shape = rows.shape
        self._data, self._columns = fixed(rows.data), rows.indices
        self._filled = np.flatnonzero(np.diff(rows.indptr))
        self._starts = rows.indptr[:-1][self._filled]

    def __matmul__(self, x: Fixed) -> Fixed:
        sums = np.full(self.shape[0], 0, dtype=object)
        if len(self._filled):
            sums[self._filled] = np.add.reduceat(self._data.integers * x.integers[self._columns], self._starts)
        return Fixed(sums, self._data.bits + x.bits)


# Proven lower bounds of the least eigenvalue of symmetric matrices of floats.
#
# A factorisation P (M - s I) P' = L D L' + R with D > 0 proves lambda_min(M) >= s - |R| once R is bounded, independent
# of rounding in the factorisation. The entries of R are computed, and their rounding is bounded by the same products of
# absolute values; for dense matrices P = I and D^(1/2) is part of L. This is an a posteriori form of the floating-point
# Cholesky test of Rump (2006), BIT 46, 433.

# The largest relative error of sums of up to 1e8 positive floats.
SAFE = 1 + 1e-7
# The most multiplications for which the product L D L' is formed.
MOST_WORK = 3e9
POWER_STEPS = 12
# Denser matrices with fewer rows are factorised as dense ones.
DENSE, MOST_DENSE = 0.2, 6000


def largest_row_sum(matrix: Any) -> float:
    """Return an upper bound of |M|_inf, thus of all eigenvalues of a symmetric M."""
    sums = np.asarray(abs(matrix).sum(axis=1)).ravel()
    return float(np.max(sums, initial=0.0)) * SAFE


def least_eigenvalue(matrix: Any, uncertainty: float = 0.0) -> float | None:
    """Return a positive proven lower bound of lambda_min, None if none was found.

    Parameters
    ----------
    matrix : (n, n) sparse symmetric matrix of floats
    uncertainty : the matrix meant differs by at most this, in the infinity norm
    """
    matrix = sp.csc_matrix(matrix)
    size = matrix.shape[0]
    if not size:
        return np.inf
    estimate = _estimate(matrix)
    if estimate is None:
        return None
    for part in (0.5, 0.1):
        shift = part * estimate
        if shift <= uncertainty + _forming(matrix, shift):
            return None  # the rounding of the data is as large
        off = _left_out(matrix, shift)
        if off is not None and (bound := (shift - (off + uncertainty) * SAFE) / SAFE) > 0:
            return float(bound)
    return None


def _estimate(matrix: Any) -> float | None:
    """Return an estimate of the least eigenvalue by inverse iteration, None if the matrix is singular."""
    factors = _dense_factors(matrix) if is_dense(matrix) else _factors(matrix)
    if factors is None:
        return None
    x = np.random.default_rng(0).standard_normal(matrix.shape[0])
    value = 0.0
    for _ in range(POWER_STEPS):
        y = factors.solve(x / np.linalg.norm(x))
        length = float(np.linalg.norm(y))
        if not np.isfinite(length) or length == 0:
            return None
        value, x = 1 / length, y
    return value


def is_dense(matrix: Any) -> bool:
    """Return whether a matrix is factorised as a dense one."""
    size = matrix.shape[0]
    return bool(size <= MOST_DENSE and matrix.nnz > DENSE * size * size)


@dataclass(frozen=True, eq=False)
class _Cholesky:
    L: Array

    def solve(self, right: Array) -> Array:
        return np.asarray(scipy.linalg.cho_solve((self.L, True), right))


def _dense_factors(matrix: Any) -> _Cholesky | None:
    try:
        return _Cholesky(np.linalg.cholesky(matrix.toarray()))
    except np.linalg.LinAlgError:
        return None


def _left_out_of_dense(shifted: Any) -> tuple[float, float] | None:
    """Return the computed |M - LL'|_inf and a bound on its rounding error, for any order of sums."""
    factors = _dense_factors(shifted)
    if factors is None or not np.all(np.isfinite(factors.L)):
        return None
    L, size = np.tril(factors.L), len(factors.L)
    absolute = abs(L) @ (abs(L).T @ np.ones(size))
    return largest_row_sum(shifted.toarray() - L @ L.T), 2 * (size + 4) * EPS * float(np.max(absolute))


def _factors(matrix: Any) -> Any:
    from scipy.sparse.linalg import splu

    options = dict(SymmetricMode=True, Equil=False)
    try:
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError:  # exactly singular
        return None


def _forming(matrix: Any, shift: float) -> float:
    """Return a bound of the rounding error of subtracting the shift, and a product, from the matrix."""
    return 4 * EPS * (largest_row_sum(matrix) + shift)


def _left_out(matrix: Any, shift: float) -> float | None:
    """Return a bound of |R|_inf, None if the shifted matrix is not found to be positive definite."""
    size = matrix.shape[0]
    refuse_late("the least eigenvalue of the stiffness was bounded")
    shifted = sp.csc_matrix(matrix - shift * sp.identity(size, format="csc"))
    forming = _forming(matrix, shift)
    if is_dense(shifted):
        parts = _left_out_of_dense(shifted)
        return None if parts is None else (sum(parts) + forming) * SAFE
    factors = _factors(shifted)
    if factors is None:
        return None
    order: Indices = factors.perm_r
    pivots = factors.U.diagonal()
    if not np.array_equal(order, factors.perm_c) or not np.all(pivots > 0) or not np.all(np.isfinite(pivots)):
        return None
    refuse_late("the factors of the stiffness were multiplied")
    L = sp.csc_matrix(factors.L)
    counts = np.diff(L.indptr).astype(float)
    if float(np.sum(counts**2)) > MOST_WORK:
        return None
    scaled = sp.csc_matrix(L @ sp.diags(pivots))
    back = np.empty(size, dtype=np.intp)
    back[order] = np.arange(size)
    permuted = shifted[back][:, back]
    rest = permuted - scaled @ L.T
    terms = float(np.max(np.diff(sp.csr_matrix(L).indptr))) + 4
    # Rounding of the products, of their sums, and of forming the shifted matrix and the difference.
    absolute = abs(scaled) @ (abs(L).T @ np.ones(size))
    rounding = 2 * terms * EPS * float(np.max(absolute)) + forming
    return (largest_row_sum(rest) + rounding) * SAFE


# Bits of the parts of an approximation below its largest.
KEPT, MOST_DIGITS = 360, 90
MOST_ROUNDS = 40
# Rounds with the same contact set without halving the residual forces or lengths, after which refinement fails.
MOST_IDLE_ROUNDS = 3
# A force that exceeds all residuals by this factor is certainly positive.
STANDS_OUT = 2.0**10
# A contact whose gap is this multiple of possible corrections stays open.
STAYS_OPEN = 2.0**20


@dataclass(frozen=True, eq=False)
class Refined(AnswerOf[Fixed, None]):
    """An approximation of many digits, and its exact residuals; forces of open contacts are zero."""

    problem: ContactProblem
    imbalance: Fixed  # (n,) f - K u - E'l - A'nu
    gap: Fixed  # (m,) g - E u
    tie_error: Fixed  # (k,) b - A u
    closed: Indices  # contacts with a force
    rounds: int
    first: Solution  # in doubles


def refine(
    problem: ContactProblem,
    method: str = "active-set",
    digits: int = 40,
    *,
    first: Solution | None = None,
    **options: Any,
) -> Refined:
    """Solve a frictionless problem to many more digits than double precision.

    Parameters
    ----------
    problem : ContactProblem
        Its floats are taken as they stand.
    method, **options
        As in `contactqp.solve`, for the magnified problems.
    digits : int
        The number of digits of the residuals, relative to the load and to the lengths of the problem, at most 90.
    first : Solution, optional
        The solution in doubles, if it is known.

    Raises
    ------
    NotConverged
        Residuals do not decrease enough: the contact set keeps changing, or the data are too ill-conditioned.
    InvalidProblem, Unsupported
        Too many digits are asked for, or there is friction.
    NoEquilibrium, NotCertified
        Raised by the first solution.

    Examples
    --------
    A wall 0.1 away, the float: of the force 300 - 157500 * 0.1000000000000000055511... a double holds 16 digits.

    >>> wall = ContactProblem(stiffness=[[157500.0]], load=[30000.0], normal=[[1.0]], gap=[0.1])
    >>> force = refine(wall).normal_force.fractions()[0]
    >>> force == 30000 - 157500 * Fraction(0.1)
    True
    """
    if not 0 < digits <= MOST_DIGITS:
        raise InvalidProblem(f"refine: digits: expected 1 to {MOST_DIGITS}, got {digits}")
    if problem.frictional:
        raise Unsupported("refine: Coulomb friction is not a quadratic program")
    if first is None:
        first = solve(problem, method, **options)
    walk = _Walk(problem, first, method, options)
    goal = 2.0 ** (-digits * 3.3219)
    lowest, idle, reason = walk.residuals, 0, ""
    for rounds in range(MOST_ROUNDS + 1):
        if walk.settled and max(walk.residuals) <= goal:
            return walk.refined(rounds, first)
        if rounds == MOST_ROUNDS or idle == MOST_IDLE_ROUNDS:
            break
        refuse_late(f"round {rounds + 1} of the refinement")
        tell(f"refine the answer, round {rounds + 1}")
        try:
            walk.step()
        except NotConverged as error:
            refuse_late(f"round {rounds + 1} of the refinement ended")
            reason = f" ({error})"
            break
        if not walk.settled or any(now < before / 2 for now, before in zip(walk.residuals, lowest, strict=True)):
            lowest, idle = walk.residuals, 0
        else:
            idle += 1
    raise NotConverged(
        f"refine: residuals of {max(walk.residuals):.1e} after {rounds} rounds, {goal:.0e} wanted{reason}",
        solution=first,
    )


class _Walk:
    def __init__(self, problem: ContactProblem, first: Solution, method: str, options: dict[str, Any]) -> None:
        self.problem, self._method, self._options = problem, method, options
        self._K, self._E, self._A = (
            FixedMatrix(sp.csr_matrix(x)) for x in (problem.stiffness, problem.normal, problem.tie)
        )
        self._Et, self._At = (FixedMatrix(sp.csr_matrix(x.T)) for x in (problem.normal, problem.tie))
        self._f, self._g, self._b = fixed(problem.load), fixed(problem.gap), fixed(problem.tie_value)
        # sqrt(K_jj) makes displacements and forces comparable; |E_i| / sqrt(K_jj) gaps and normal forces.
        self._scale = _root(problem)
        self._arm, self._tie_arm = (np.asarray(abs(rows) @ (1 / self._scale)) for rows in (problem.normal, problem.tie))
        self.settled = False
        self._key: Any = None
        self._take(fixed(first.displacement), fixed(np.maximum(first.normal_force, 0.0)), fixed(first.tie_force))
        # Sizes of forces and lengths in sqrt(energy).
        sizes = [abs(problem.load) / self._scale, self._scale * abs(first.displacement)]
        sizes.append(self._arm * abs(first.normal_force))
        self._size = max((float(np.max(part, initial=0.0)) for part in sizes), default=0.0) or 1.0

    def _take(self, u: Fixed, push: Fixed, tie: Fixed) -> None:
        self.u, self.push, self.tie = (x.rounded(KEPT - min(x.exponent, KEPT)) for x in (u, push, tie))
        self.gap = self._g - self._E @ self.u
        self.tie_error = self._b - self._A @ self.u
        self.imbalance = self._f - self._K @ self.u - self._Et @ self.push - self._At @ self.tie

    @property
    def residuals(self) -> tuple[float, float]:
        """Return the largest residual forces and lengths, relative to the sizes of the problem."""
        closed = np.array([x > 0 for x in self.push.integers], dtype=bool)
        forces = abs(self.imbalance.floats()) / self._scale
        lengths = np.concatenate(
            [abs(self.gap[closed].floats()) / self._arm[closed], abs(self.tie_error.floats()) / self._tie_arm]
        )
        overlap = np.maximum(-self.gap.floats(), 0.0) / self._arm
        return (
            float(np.max(forces, initial=0.0)) / self._size,
            float(max(np.max(lengths, initial=0.0), np.max(overlap, initial=0.0))) / self._size,
        )

    def step(self) -> None:
        """Solve the magnified problem of the correction, and add it."""
        problem, m = self.problem, self.problem.contacts
        remains = max(*self.residuals, 2.0**-KEPT)
        force = self._arm * self.push.floats() / self._size
        certain = force > STANDS_OUT * remains
        if not np.all(certain | (force == 0)):
            held = Fixed(np.where(certain, self.push.integers, 0), self.push.bits)
            self._take(self.u, held, self.tie)
            remains = max(*self.residuals, 2.0**-KEPT)
        gap = self.gap.floats() / self._arm / self._size
        near = ~certain & (gap < STAYS_OPEN * remains)
        power = int(np.floor(-np.log2(remains)))
        held_, loose = np.flatnonzero(certain), np.flatnonzero(near)
        part = self._magnified(held_, loose, power)
        try:
            found = solve(part, self._method, **self._options)
        except (NotCertified, NotConverged) as error:
            if not isinstance(error.solution, Solution):
                raise
            found = error.solution
        except NoEquilibrium as error:
            reason = f"refine: what is left, magnified by 2^{power}, has no equilibrium: {error}"
            raise NotConverged(reason) from None
        push = np.zeros(m)
        push[held_] = found.tie_force[problem.ties :]
        push[loose] = np.maximum(found.normal_force, 0.0)
        more = fixed(push).times_power(-power)
        total = self.push + more
        before = certain.copy()
        self._take(
            self.u + fixed(found.displacement).times_power(-power),
            Fixed(np.where([x > 0 for x in total.integers], total.integers, 0), total.bits),
            self.tie + fixed(found.tie_force[: problem.ties]).times_power(-power),
        )
        self.settled = np.array_equal(before, [x > 0 for x in self.push.integers])

    def _magnified(self, held: Indices, loose: Indices, power: int) -> ContactProblem:
        problem = self.problem
        values = np.concatenate([self.tie_error.floats_at(power), self.gap[held].floats_at(power)])
        load, gap = self.imbalance.floats_at(power), self.gap[loose].floats_at(power)
        key = (held.tobytes(), loose.tobytes())
        if self._key != key:
            self._key = key
            self._part = ContactProblem(
                stiffness=problem.stiffness,
                load=load,
                normal=problem.normal[loose],
                gap=gap,
                tie=sp.vstack([problem.tie, problem.normal[held]]).tocsr(),
                tie_value=values,
            )
            return self._part
        return self._part.replace(load=load, gap=gap, tie_value=values)

    def refined(self, rounds: int, first: Solution) -> Refined:
        closed = np.flatnonzero([x > 0 for x in self.push.integers])
        return Refined(
            self.u,
            self.push,
            None,
            self.tie,
            self.problem,
            self.imbalance,
            self.gap,
            self.tie_error,
            closed,
            rounds,
            first,
        )


def _root(problem: ContactProblem) -> Vector:
    diagonal = problem.diagonal
    largest = float(np.max(diagonal, initial=0.0)) or 1.0
    return np.asarray(np.sqrt(np.where(diagonal > 0, diagonal, largest)))
