"""Decide whether K is semidefinite, by a Cholesky factorisation or a direction of negative curvature in extended
precision, and whether rows of constraints are independent or contradict each other by rounding; solve equations of many
such rows.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed, InvalidProblem
from contactqp.linalg import pardiso
from contactqp.linalg.contact_iteration import ContactIteration
from contactqp.linalg.dense import DENSE_SIZE
from contactqp.linalg.exact_algebra import contradiction
from contactqp.linalg.extended import SparseRows, extend, extended_rows
from contactqp.linalg.factorization import SuperLU, connected_parts, right_singular, with_added_diagonal
from contactqp.linalg.measures import untouched
from contactqp.linalg.nonnegative import DEPENDENT_ROWS
from contactqp.linalg.schur import LARGE, factorised, with_pivots
from contactqp.model.arrays import EPS, Array, Index, Mask, Vector
from contactqp.model.names import listed
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import BUCKLED

# The most contacts and ties whose overlap is looked for in rational numbers, and why nothing is claimed with one.
MOST_ROWS, DECIDED = 60, "what rounding of the data decides is not proven"
# The relative rounding of a motion that is computed in doubles, and of a row's sum over it.
ROUNDED_SUM = Fraction(256 * EPS)
# Negative curvature beyond this part of |z|'|K||z| is not a rounding error of the entries.
CURVED = 1e-12
# The relative amount by which diagonals must exceed the sum of the other entries, above rounding.
DOMINANT = 1e-12
# With pivots below this part of the diagonal entry a stiffness is singular to working precision.
REGULAR = 1e-8
# Pivots above this part exceed those that the raised diagonal gives for a motion without energy.
DEFINITE = 1e-10
# The most unknowns of a direction named in a message, and roundings of a sum that sets off others.
NAMED, SUMMED = 6, 8
# The part of random gaps up to which a motion of independent rows meets them.
MET = 1e-3
# Steps of conjugate gradients that show a negative eigenvalue.
STEPS = 15
# The most rigid motions of a body, and pivots of K with a unit diagonal below which a motion has no energy.
RIGID_MOTIONS, NO_ENERGY = 6, 1e-13


def motions_of_dense(problem: ContactProblem) -> int:
    """Return the number of motions without energy of a dense K, by Cholesky factors with pivots on the diagonal.

    K is dense where half of its entries are not zero; of others nothing is computed, and the number is zero.
    """
    n = problem.dimension
    if 2 * problem.stiffness_rows.nnz < n * n or not problem.diagonal.all():
        return 0
    from scipy.linalg.lapack import dpstrf

    root = 1.0 / np.sqrt(problem.diagonal)
    _, _, rank, _ = dpstrf(problem.stiffness_rows.toarray() * np.outer(root, root), tol=NO_ENERGY)
    return n - int(rank)


def moves_beyond_bodies(problem: ContactProblem) -> bool:
    """Return whether a dense K has more motions without energy than bodies have rigid ones, as a fit to few data.

    Condensing would treat each of them as rigid.
    """
    if problem.frictional or problem._is_small:
        return False
    motions = motions_of_dense(problem)
    return motions > RIGID_MOTIONS and motions > RIGID_MOTIONS * connected_parts(problem.stiffness_rows)[0]


def diagonal_dominance(problem: ContactProblem) -> Vector:
    """Return d (n,) >= 0 for which K - diag(d) is semidefinite, by Gershgorin's circles.

    d_j is K_jj less the sum of the other |K_ji| in connected parts where that is positive in every row, else zero.
    """
    excess = 2 * problem.diagonal - problem.stiffness_sizes @ np.ones(problem.dimension)
    part = connected_parts(problem.stiffness_rows)[1]
    weak = part[~(excess > DOMINANT * problem.diagonal)]
    return np.where(np.isin(part, weak), 0.0, excess)


def refuse_indefinite(problem: ContactProblem) -> None:
    """Raise InvalidProblem with the direction if K has negative curvature; a stiffness is examined once."""
    stiffness_factor(problem, wanted=False)


def stiffness_factor(
    problem: ContactProblem, wanted: bool = True, factors: pardiso.Pardiso | None = None, least: float = REGULAR
) -> StiffnessFactor | None:
    """Return factors of K if `wanted`, None if K is singular to working precision.

    Raises InvalidProblem: K is indefinite, as `refuse_indefinite` says.

    Parameters
    ----------
    problem : K is its stiffness
    wanted : whether the factors are wanted, or only that K is found to be semidefinite
    factors : Pardiso, optional
        Factors of a matrix that may have the entries of K, whose analysis then serves.
    least : the pivot, as a part of its diagonal entry, beneath which K counts as singular: from `DEFINITE` on it is not
    """
    of_stiffness, factor = problem._computed.of_stiffness, None
    if of_stiffness.convex is None:
        factor = _refuse_indefinite(problem, factors)
        of_stiffness.convex = True
    if not wanted:
        return None
    factor = factor or _factorised(problem, factors)
    return None if factor is None or factor.smallest_pivot < least else factor


class StiffnessFactor:
    """The factors of K with its diagonal raised by the factor 1 + CURVED, which a step of refinement corrects."""

    def __init__(self, problem: ContactProblem, factors: pardiso.Pardiso | None = None) -> None:
        self._K, self._sizes = problem.stiffness_rows, problem.stiffness_sizes
        lifted = with_added_diagonal(self._K, CURVED * problem.diagonal)
        if problem.dimension > LARGE and pardiso.available():
            by_pardiso = None if factors is None else factors.beside(lifted)
            if by_pardiso is None:
                by_pardiso = pardiso.elimination_order(problem).factorised(lifted, np.arange(problem.dimension))
            self._solve, self.smallest_pivot = by_pardiso.solve_all, by_pardiso.smallest_pivot
        else:
            by_superlu = SuperLU(sp.csc_matrix(lifted))
            self._solve, self.smallest_pivot = by_superlu.solve, by_superlu.smallest_pivot

    def response_norm(self, force: Vector) -> tuple[float, float]:
        """Return |K^-1 f|_K = sqrt(f'K^-1 f) of forces f (n,) [square root of energy], and a bound on its rounding.

        2 f'y - y'K y errs by the square of what y lacks.
        """
        moved = self._solve(force)
        moved = moved + self._solve(force - self._K @ moved)
        square = max(float(force @ moved + moved @ (force - self._K @ moved)), 0.0)
        size = abs(moved) @ (2 * abs(force) + self._sizes @ abs(moved))
        rounding, norm = SUMMED * EPS * float(size), float(np.sqrt(square))
        return norm, min(float(np.sqrt(rounding)), rounding / norm) if norm > 0 else float(np.sqrt(rounding))


def _factorised(problem: ContactProblem, factors: pardiso.Pardiso | None) -> StiffnessFactor | None:
    """Return the factors of K if its pivots are positive, else None."""
    if np.any(problem.diagonal <= 0):
        return None
    try:
        factor = StiffnessFactor(problem, factors)
    except (pardiso.NotPositive, BackendFailed, InvalidProblem):
        return None
    return factor if factor.smallest_pivot > 0 else None


def _refuse_indefinite(problem: ContactProblem, factors: pardiso.Pardiso | None) -> StiffnessFactor | None:
    """Raise InvalidProblem for an indefinite K; return its factors if they decided it."""
    if np.all(2 * problem.diagonal - problem.stiffness_sizes @ np.ones(problem.dimension) >= 0):
        return None  # dominant diagonals: Gershgorin's circles
    if problem.dimension > DENSE_SIZE and (factor := _factorised(problem, factors)) is not None:
        return factor
    scale = problem.own_scale
    K = sp.csr_matrix(sp.diags(scale) @ problem.stiffness_rows @ sp.diags(scale))
    acting = np.flatnonzero(np.diff(K.indptr))
    direction = _lowest(sp.csr_matrix(K[acting][:, acting]))
    if direction is None:
        return None
    z = np.zeros(problem.dimension)
    z[acting] = scale[acting] * direction
    _refuse_curved(problem, z)
    return None


def _refuse_curved(problem: ContactProblem, z: Vector) -> None:
    """Raise InvalidProblem if K has negative curvature along z (n,) that is not rounding of its entries."""
    z = z / np.max(abs(z))
    curvature = extend(z).dot(extended_rows(problem).stiffness @ extend(z))
    if curvature < -CURVED * float(abs(z) @ (problem.stiffness_sizes @ abs(z))):
        names = ", ".join(problem.dof_name(int(j)) for j in np.argsort(-abs(z))[:NAMED] if abs(z[j]) > CURVED)
        raise InvalidProblem(
            f"stiffness: expected positive semidefinite, got z'Kz = {curvature:.3g} along a direction z whose largest "
            f"entry is one ({names}): the energy is not convex{BUCKLED}"
        )


def refuse_indefinite_by_iteration(problem: ContactProblem, iteration: ContactIteration) -> None:
    """Raise InvalidProblem if conjugate gradients from a random force meet negative curvature; it is tried once.

    With positive eigenvalues of M K between a fifth and one, a negative one appears in a dozen steps, which amplify it
    by three each; GMRES would not show it.
    """
    of_stiffness = problem._computed.of_stiffness
    if of_stiffness.convex or of_stiffness.convex_by_iteration:
        return
    random = np.random.default_rng(0).standard_normal(problem.dimension)
    run = iteration.run_without_rows(np.sqrt(problem.diagonal) * random)
    while run.steps < STEPS and run.step():
        iteration.refuse_late("the stiffness was found convex")
        iteration.krylov_iterations += 1
    if run.fall is not None:
        _refuse_curved(problem, run.fall)
    of_stiffness.convex_by_iteration = True


def _lowest(matrix: Any) -> Vector | None:
    """Return the eigenvector of the least eigenvalue if that is negative, None if Cholesky's pivots are positive."""
    if matrix.nnz == matrix.shape[0]:  # diagonal
        lowest = int(np.argmin(matrix.data)) if matrix.nnz else 0
        return np.eye(1, matrix.shape[0], lowest)[0] if matrix.nnz and matrix.data[lowest] < 0 else None
    lifted = sp.csc_matrix(matrix + CURVED * sp.identity(matrix.shape[0]))
    if matrix.shape[0] <= DENSE_SIZE:
        values, vectors = np.linalg.eigh(matrix.toarray())
        return vectors[:, 0] if values[0] < 0 else None
    try:
        if matrix.shape[0] > LARGE and pardiso.available():
            pardiso.Pardiso(lifted, np.zeros(0, dtype=np.intp))
            return None
        if SuperLU(lifted).smallest_pivot > 0:
            return None
    except (pardiso.NotPositive, InvalidProblem, BackendFailed):
        pass
    from scipy.sparse.linalg import ArpackNoConvergence, eigsh

    try:
        values, vectors = eigsh(matrix, k=1, which="SA", v0=np.ones(matrix.shape[0]), tol=1e-8)
    except ArpackNoConvergence:
        return None
    return vectors[:, 0] if values[0] < 0 else None


def are_independent(rows: Any) -> bool:
    """Return whether sparse rows (r, n) are independent: a motion v meets random gaps g and is below 1/DEPENDENT_ROWS.

    The shortest one is that of [a I E'; E 0], whose condition number is that of the rows E where a is below their least
    singular value (Bjorck 1996, section 2.5.1). Rows whose factors would take too long are not called independent.
    """
    sizes = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
    if not (np.isfinite(sizes) & (sizes > 0)).all():
        return False
    unit, n = sp.csr_array(sp.diags(1 / sizes) @ rows), rows.shape[1]
    gaps = np.random.default_rng(0).uniform(0.5, 1.0, len(sizes))
    try:
        solve = with_pivots(sp.bmat([[DEPENDENT_ROWS * sp.identity(n), unit.T], [unit, None]], format="csc"))
    except BackendFailed:
        return False
    motion = solve(np.concatenate([np.zeros(n), gaps]))[:n]
    return bool(np.all(abs(motion) * DEPENDENT_ROWS < 1) and np.all(abs(unit @ motion - gaps) < MET))


# The regularisation of the minimum-norm equations with unit rows, removed by refinement.
REGULARISATION, REFINEMENTS = 1e-12, 6


def least_solution(rows: Any, right: Vector) -> Vector:
    """Return the x (q,) of least norm with R x = b for a sparse R (p, q), whose rows may depend on each other.

    It solves x + R' y = 0, R x - d y = b with a small d, refined to rounding. With dependent rows its norm exceeds the
    least one by at most about 1e-4.

    Raises BackendFailed: the factorisation ran out of memory, or met a pivot of zero.
    """
    lengths = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
    (p, q), unit = rows.shape, sp.csr_matrix(sp.diags(1.0 / lengths) @ rows)
    matrix = sp.bmat([[sp.identity(q), unit.T], [unit, -REGULARISATION * sp.identity(p)]], format="csc")
    solve = factorised(matrix, pardiso.INDEFINITE, pardiso.EliminationOrder(q), np.arange(q))
    found, last = np.zeros(q), np.inf
    for _ in range(REFINEMENTS):
        left = right / lengths - unit @ found
        if not 0 < (size := float(np.max(abs(left), initial=0.0))) < last:
            break
        found, last = found + solve(np.concatenate([np.zeros(q), left]))[:q], size
    return np.asarray(found)


# The number of rows up to which weights are computed by dense algebra, and corrections for more rows.
MOST_DENSE, CANCELLATIONS = 500, 2


def nearly_cancelling(rows: Any, scale: Vector, weights: Vector) -> Vector:
    """Return the weights (q,) with the least sum of unit rows; for many rows those near given weights."""
    rows = sp.csr_matrix(rows @ sp.diags(scale))
    if rows.shape[0] <= MOST_DENSE:
        length = np.linalg.norm(rows.toarray(), axis=1)
        _, rotation = right_singular((rows.toarray() / length[:, None]).T)
        return np.asarray(rotation[-1] / length)
    across = SparseRows(rows.T.tocsr())
    for _ in range(CANCELLATIONS):
        part, left = sp.csr_matrix((sp.diags(abs(weights)) @ rows).T), (across @ extend(weights)).double()
        weights = weights * (1.0 - np.sign(weights) * least_solution(part, left))
    return weights


# The most entries of E E', and its least pivot with unit diagonal.
MOST_ENTRIES, WELL_APART = 1e7, 1e-6


def inverse_of_gram(rows: Any) -> Callable[[Array], Array] | None:
    """Return a function that solves E E' X = B (a, q) for sparse rows E (a, n), None if they are nearly dependent.

    If E E' is ill-conditioned, [I E'; E 0] is used, with the root of its condition number.
    """
    n = rows.shape[1]
    if np.sum(np.square(np.bincount(rows.indices, minlength=n), dtype=float)) <= MOST_ENTRIES:
        gram = SuperLU(sp.csc_matrix(rows @ rows.T))
        if gram.smallest_pivot > WELL_APART:
            return gram.solve
    try:
        both = with_pivots(sp.bmat([[sp.identity(n), rows.T], [rows, None]], format="csc"))
    except BackendFailed:
        return None
    return lambda right: np.column_stack([-both(np.concatenate([np.zeros(n), one]))[n:] for one in right.T])


def overlap_by_rounding(problem: ContactProblem, near: Mask | None = None) -> str | None:
    """Say which of few contacts and ties contradict each other, taken exactly, and by how much; None if none do.

    The weights that prove it are rational numbers (Farkas' lemma). What exceeds the rounding of the rows is refused
    before, so that the overlap is one that rounding of the data may cause.

    Parameters
    ----------
    problem : ContactProblem; friction makes no difference
    near : (m,) mask, optional, the contacts that are examined, by default all
    """
    limited = np.isfinite(problem.gap) if near is None else near & np.isfinite(problem.gap)
    closed = np.flatnonzero(limited)
    if not 2 <= len(closed) + problem.ties <= MOST_ROWS or _independent_by_unknowns(problem, limited):
        return None
    rows = sp.csr_array(sp.vstack([problem.normal[closed], problem.tie]))
    if rows.nnz > MOST_ROWS**2:
        return None
    limit = [Fraction(float(x)) for x in (*problem.gap[closed], *problem.tie_value)]
    parts = np.split(np.arange(rows.nnz), rows.indptr[1:-1])
    entries = [{int(rows.indices[k]): Fraction(float(rows.data[k])) for k in part} for part in parts]
    weights = contradiction(entries, limit, len(closed))
    if weights is None:
        return None
    names = [problem.contact_name(int(i)) for i in closed] + [problem.tie_name(i) for i in range(problem.ties)]
    overlap, unit = float(1 / max(abs(y) for y in weights)), problem.units.length
    involved = listed([name for name, y in zip(names, weights, strict=True) if y])
    return f"{involved} (weighted) overlap by {overlap:.2g}{' ' + unit if unit else ''}: {DECIDED}"


def _independent_by_unknowns(problem: ContactProblem, chosen: Mask) -> bool:
    """Return whether these contacts (m,) and all ties can be left out one after the other, each as the last that acts
    on some unknown: then they are independent, and none contradict.
    """
    normal, tie = problem.normal, problem.tie
    owner = np.repeat(np.arange(problem.contacts), np.diff(normal.indptr))
    counted = chosen[owner]
    owner = np.concatenate([owner[counted], problem.contacts + np.repeat(np.arange(problem.ties), np.diff(tie.indptr))])
    unknowns = np.concatenate([normal.indices[counted], tie.indices])
    if len(np.unique(owner)) < np.count_nonzero(chosen) + problem.ties:
        return False  # a row is empty
    while len(owner):
        alone = np.bincount(unknowns)[unknowns] == 1
        left = ~np.isin(owner, owner[alone])
        if left.all():
            return False
        owner, unknowns = owner[left], unknowns[left]
    return True


def drive_by_rounding(problem: ContactProblem, motions: Array, held: Mask) -> str | None:
    """Say by how much loads drive a motion of unknowns without stiffness that closed contacts and ties allow, taken
    exactly; None if none does.

    The equilibrium is elsewhere or there is none then, as of a linear program whose costs balance to rounding only. By
    Farkas' lemma, with rational weights, no forces l >= 0, nu have Z'E'l + Z'A'nu = Z'f; only small numbers of motions,
    contacts and ties are examined. What rows leave of a motion by its own rounding is zero. Of elastic bodies the rigid
    motions have the rounding of K, and loads on them that balance to rounding are meant to.

    Parameters
    ----------
    problem : ContactProblem, without friction
    motions : (n, r) array, rigid motions, to rounding; with no columns those of single unknowns without stiffness
    held : (m,) mask of the closed contacts
    """
    stiff, loose = np.flatnonzero(problem.diagonal), np.flatnonzero(problem.diagonal == 0)
    if not motions.size and 0 < loose.size * problem.dimension <= MOST_ROWS**2:
        motions = np.zeros((problem.dimension, loose.size))
        motions[loose, np.arange(loose.size)] = 1.0
    near = np.flatnonzero(held & np.isfinite(problem.gap))
    rows = sp.csr_array(sp.vstack([problem.normal[near], problem.tie]))
    count, few = rows.shape[0] + motions.shape[1], max(rows.nnz, motions.size) <= MOST_ROWS**2
    if problem.frictional or not (motions.size and count <= MOST_ROWS and few and problem.load.any()):
        return None
    moving = [z for z in _simplest(motions, problem.own_scale) if not any(z[j] for j in stiff)]
    felt = [[_sum_of(rows.data[a:b], z, rows.indices[a:b]) for a, b in pairwise(rows.indptr)] for z in moving]
    signs = [{i: Fraction(-1)} for i in range(len(near))]
    taken = [{i: value for i, value in enumerate(of_motion) if value} for of_motion in felt]
    work = [sum((Fraction(float(f)) * z[j] for j, f in enumerate(problem.load) if f), Fraction(0)) for z in moving]
    weights = contradiction([*signs, *taken], [*[Fraction(0)] * len(near), *work], len(near))
    if weights is None:
        return None
    driven = [sum((y * z[j] for y, z in zip(weights[len(near) :], moving, strict=True)), Fraction(0)) for j in loose]
    part = 1 / sum(abs(Fraction(float(f)) * z) for f, z in zip(problem.load[loose], driven, strict=True))
    return f"the loads on a motion that nothing holds balance but for {float(part):.1g} of them: {DECIDED}"


def drives_by_rounding(problem: ContactProblem, motions: Array, held: Mask) -> tuple[str | None, str | None]:
    """Return `drive_by_rounding` with the contacts that an answer closes, and with all: no equilibrium exists then."""
    found = drive_by_rounding(problem, motions, held)
    return found, found and drive_by_rounding(problem, motions, np.ones(problem.contacts, dtype=bool))


def in_proportion(problem: ContactProblem, unknowns: Index) -> Index:
    """Return binary exponents of units (n,) in which loads on unknowns that nothing touches keep their size.

    Such a load is rounding, as F sin(pi) is, if it is small beside the largest of the others as they are stated; the
    unknown has no unit of its own.

    Parameters
    ----------
    problem : ContactProblem
    unknowns : (n,) exponents of the units of all unknowns, of which those that nothing touches are replaced
    """
    load, alone = problem.load_size, untouched(problem)
    if not (load[alone].any() and load[~alone].any()):
        return unknowns
    size, unit = np.frexp(load[~alone])[1][load[~alone] > 0], unknowns[~alone][load[~alone] > 0]
    return np.where(alone, np.max(size + unit) - np.max(size), unknowns)


def _simplest(motions: Array, scale: Vector) -> list[list[Fraction]]:
    """Return motions (n, r) combined to unit ones at r unknowns, without rounding of zeros and simple mantissas.

    An entry is zero beside the others in the scale D (n,) of the unknowns.
    """
    from scipy.linalg import qr

    pivots = qr((motions / scale[:, None]).T, mode="r", pivoting=True)[1][: motions.shape[1]]
    combined = motions @ np.linalg.inv(motions[pivots])
    size = abs(combined) / scale[:, None]
    combined[size <= float(ROUNDED_SUM) * size.max(axis=0)] = 0.0
    return [[_simple(float(x)) for x in z] for z in combined.T]


def _simple(value: float) -> Fraction:
    mantissa, exponent = np.frexp(value)
    exact = Fraction(float(mantissa))
    ratio = exact.limit_denominator(MOST_ROWS)
    return (ratio if abs(ratio - exact) <= ROUNDED_SUM else exact) * Fraction(2) ** int(exponent)


def _sum_of(entries: Vector, motion: list[Fraction], unknowns: Any) -> Fraction:
    """Return the sum of entries times a motion at unknowns, zero where it is rounding of the motion."""
    terms = [Fraction(float(x)) * motion[j] for x, j in zip(entries, unknowns, strict=True)]
    total = sum(terms, Fraction(0))
    return total if abs(total) > ROUNDED_SUM * sum(map(abs, terms)) else Fraction(0)
