"""Scale a problem so that all rows of its matrices have entries near one, also for singular K."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.dense import unknown_scale
from contactqp.linalg.extended import Extended, ExtendedMatrix, ExtendedRows, extended_rows
from contactqp.linalg.factorization import solved_between_diagonals
from contactqp.linalg.pardiso import elimination_order
from contactqp.model.arrays import EPS, Array, Index, Indices, Mask, Vector
from contactqp.model.computed import Computed
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate, NegligibleSizes

# Rounds of equilibration, after which row and column maxima differ by little more than powers of two.
ROUNDS = 12
HARDLY_GIVEN = 1e-10  # beside the number of entries, what keeps factors that no entry determines near one
# Maxima between this and its inverse change factors by less than what rounding these to powers of two does.
NEAR_ONE = 1.1
MOST_BARE = 6  # the most unknowns without stiffness in a contact problem of bodies; a quadratic program has more
NO_LENGTH = 1e-6  # without imposed lengths, lengths below this part of the load count as zero
# Sweeps over rows and columns, whose convergence depends on the coupling of the bodies.
BALANCING_SWEEPS = 10
# Rows whose largest entries differ from one, or from each other, by more than this factor (2^30 = 1e9) do not determine
# the scale of an unknown without stiffness, nor do the largest entries of such unknowns.
ALIKE = 30
HARDLY = 1e-2  # the weight of the exponents of unknowns relative to those of entries in the balance
ROUNDING_OF_A_ROW = 1e-13  # an entry below this part of the largest of its row is a rounding error of zero


@dataclass(frozen=True, eq=False)
class Scaling:
    """The factors that map a ContactProblem to its nondimensional twin and back."""

    unknowns: Array  # (n,) D
    contacts: Array  # (m,) r of the contacts
    ties: Array  # (k,) r of the ties
    length: float  # l
    force: float  # the unit of forces, equal to l where K is the measure

    def unscale(self, candidate: Candidate) -> Candidate:
        """Return a candidate of the twin in the units of the problem."""
        found = candidate.answer
        answer = replace(
            found,
            displacement=self.length * self.unknowns * found.displacement,
            normal_force=self.force * found.normal_force / self.contacts,
            tie_force=self.force * found.tie_force / self.ties,
        )
        return replace(candidate, answer=answer)

    def scale(self, answer: Answer) -> Answer:
        """Return an answer of the problem in the units of the twin."""
        return replace(
            answer,
            displacement=answer.displacement / (self.length * self.unknowns),
            normal_force=answer.normal_force * self.contacts / self.force,
            tie_force=answer.tie_force * self.ties / self.force,
        )


def equilibrated(problem: ContactProblem) -> tuple[ContactProblem, Scaling]:
    """Return a frictionless problem in units with the largest entries of all rows of K, E_N and A near one.

    All factors are powers of two, so that the twin's data are those of the problem to the last bit (Ruiz 2001, in the
    maximum norm). Where K does not relate forces to lengths, as in a linear program, forces have a separate unit.
    """
    known = problem._computed.equilibrated
    if known is None:
        known = problem._computed.equilibrated = _equilibrated(problem, *_units_of_bodies(problem))
    twin, scaling = known
    return _loaded(problem, twin, scaling, _of_stiffness_times)


def balanced(problem: ContactProblem) -> tuple[ContactProblem, Scaling]:
    """Return a program in units with which entries of rows and K have a mean near one; otherwise as `equilibrated`.

    With row maxima near one, most entries of a program may be far below one, for which interior points fail. The result
    is not cached.
    """

    def times(_: ContactProblem, twin: ContactProblem, factor: float) -> ContactProblem:
        return ContactProblem._of_checked(twin._values() | dict(stiffness=twin.stiffness * factor), Computed())

    twin, scaling = _equilibrated(problem, *_units_of_programs(problem), rounds=0)
    return _loaded(problem, twin, scaling, times)


def _loaded(
    problem: ContactProblem,
    twin: ContactProblem,
    scaling: Scaling,
    of_stiffness_times: Callable[[ContactProblem, ContactProblem, float], ContactProblem],
) -> tuple[ContactProblem, Scaling]:
    """Return the twin with load, gaps and ties in their own units, and its scaling."""
    D, r, t = scaling.unknowns, scaling.contacts, scaling.ties
    load, gap, value = D * problem.load, problem.gap / r, problem.tie_value / t
    imposed = max(_size(np.minimum(gap, 0.0)), _size(value))
    length = force = _near(max(imposed, _size(load)))
    if mostly_bare(problem):
        stiffest = _size(twin.stiffness_rows.data)
        moved = _size(load) / stiffest if stiffest > 0 else 0.0
        # If the imposed values are rounding of zero, K in such units would be below its regularisation.
        reached = imposed if imposed > NO_LENGTH * moved else moved
        length = _near(reached or _size(np.where(np.isfinite(gap), gap, 0.0)))
        force = _near(max(_size(load), length * stiffest))
        twin = of_stiffness_times(problem, twin, length / force)
    twin = twin.replace(gap=gap / length, tie_value=value / length)
    twin = twin._with_load_sum(load / force, D * problem.load_size / force)
    return twin, replace(scaling, length=length, force=force)


def _of_stiffness_times(problem: ContactProblem, twin: ContactProblem, factor: float) -> ContactProblem:
    """Return the twin in another unit of force; the last one is kept with its cached results."""
    known = problem._computed.equilibrated_forces
    if known is None or known[0] != factor:
        values = twin._values() | dict(stiffness=twin.stiffness * factor)
        scaled = ContactProblem._of_checked(values, Computed())
        scaled._computed.of_stiffness.elimination_order = elimination_order(problem)
        known = problem._computed.equilibrated_forces = (factor, scaled)
    found: ContactProblem = known[1]
    return found


def _size(values: Array) -> float:
    return float(abs(values).max(initial=0.0))


def _near(size: float) -> float:
    """Return the power of two nearest to a size, and one where that is zero."""
    return float(_power_of_two(np.array(size or 1.0)))


def in_range(twin: ContactProblem) -> bool:
    """Return whether all numbers of an equilibrated problem are finite, except gaps that are infinite."""
    arrays = (twin.stiffness_rows.data, twin.normal.data, twin.tie.data, twin.load, twin.gap, twin.tie_value)
    return all(bool(np.all(np.isfinite(array))) for array in arrays)


def _equilibrated(problem: ContactProblem, d: Array, r: Array, rounds: int = ROUNDS) -> tuple[ContactProblem, Scaling]:
    """Return the twin of a problem without load, gaps and ties, from factors of unknowns and rows after some rounds."""
    K = sp.csr_matrix(problem.stiffness_rows)
    rows = sp.csr_matrix(sp.vstack([problem.normal, problem.tie]))
    sizes_K, sizes, columns = abs(K), abs(rows), abs(rows.T.tocsr())
    for _ in range(rounds):
        of_rows = r * _largest(sizes, d)
        of_unknowns = d * np.maximum(_largest(sizes_K, d), _largest(columns, r))
        d, r = d / _root(of_unknowns), r / _root(of_rows)
        if np.all(_near_one(of_unknowns)) and np.all(_near_one(of_rows)):
            break
    d, r = _power_of_two(d), _power_of_two(r)
    m = problem.contacts
    scaled, stiffness = sp.csr_array(scaled_by(r, rows, d)), sp.csc_array(scaled_by(d, K, d))
    nothing, free = np.zeros(problem.dimension), np.zeros(problem.ties)
    twin = problem._transformed(stiffness, nothing, nothing, scaled[:m], np.zeros(m), scaled[m:], free)
    twin._computed.of_stiffness.elimination_order = elimination_order(problem)
    if extended_rows(problem).together is None:
        twin._computed.extended = _in_units(problem, twin, d, r)
    return twin, Scaling(d, 1.0 / r[:m], 1.0 / r[m:], 1.0, 1.0)


class _ScaledRows:
    """diag(l) M diag(r) of a stored extended matrix, exact as l and r are powers of two."""

    def __init__(self, rows: ExtendedMatrix, left: Array, right: Array) -> None:
        self.shape = rows.shape
        self._rows, self._left, self._right = rows, left, right

    def __matmul__(self, vector: Extended) -> Extended:
        product = self._rows @ vector.times(self._right)
        return product.times(self._left)


def _units_of_bodies(problem: ContactProblem) -> tuple[Array, Array]:
    """Return factors of unknowns and rows for which K has a unit diagonal and the largest entry of each row is one.

    These do not depend on the units of unknowns and rows. The maximum norm alone has many such factors, and those near
    the units of the problem may have rows with entries of 1e-8 beside one. Unknowns without stiffness follow from rows
    that they share with others. All unknowns have one factor if this makes entries of rows more alike, as beside
    springs over many decades. Where most unknowns have no stiffness entries of rows determine all factors.
    """
    rows, d = abs(sp.csr_matrix(sp.vstack([problem.normal, problem.tie]))), np.ones(problem.dimension)
    if 2 * np.sum(problem.diagonal == 0) > problem.dimension:
        return _units_of_programs(problem)
    columns, d = rows.T.tocsr(), _inverse(np.sqrt(problem.diagonal))
    for _ in range(ROUNDS):
        reached = np.where(d == 0, _inverse(_largest(columns, _inverse(_largest(rows, d)))), 0.0)
        if not reached.any():
            break
        d = d + reached
    even = np.full(len(d), np.exp2(np.mean(np.log2(d[d > 0])))) if d.any() else np.ones(len(d))
    d = min(np.where(d > 0, d, 1.0), even, key=lambda one: _unlike(rows, one))
    return d, 1.0 / np.where((largest := _largest(rows, d)) > 0, largest, 1.0)


def _unlike(rows: Any, d: Array) -> float:
    """Return the squares of log(E d) less its mean in each row."""
    entries = sp.coo_array(rows)
    at, logs = entries.row[entries.data > 0], np.log2((entries.data * d[entries.col])[entries.data > 0])
    mean = np.bincount(at, logs) / np.maximum(np.bincount(at), 1)
    return float(np.sum((logs - mean[at]) ** 2))


def _inverse(sizes: Array) -> Array:
    """Return the inverse of each size, and zero where that is zero."""
    return np.where(sizes > 0, 1.0 / np.where(sizes > 0, sizes, 1.0), 0.0)


def _units_of_programs(problem: ContactProblem) -> tuple[Array, Array]:
    """Return factors d of unknowns and r of rows with the least squares of log(d_j^2 K_jj) and log(r_i |E_ij| d_j).

    They make the geometric means of entries one (A. R. Curtis and J. K. Reid, J. Inst. Maths Applics 10, 1972) whatever
    the units of the problem. Sweeps over rows and columns would keep these along chains of rows.
    """
    E = abs(sp.coo_matrix(sp.vstack([problem.normal, problem.tie])))
    E.eliminate_zeros()
    (m, n), of_E, stiff = E.shape, np.log2(E.data), problem.diagonal > 0
    of_K = np.log2(np.where(stiff, problem.diagonal, 1.0))
    of_unknowns = 4.0 * stiff + np.bincount(E.col, minlength=n), 2.0 * of_K + np.bincount(E.col, of_E, n)
    of_rows = np.bincount(E.row, minlength=m), np.bincount(E.row, of_E, m)
    pattern = sp.csc_matrix((np.ones(E.nnz), (E.col, E.row)), shape=(n, m))
    D, R = (np.asarray(entries, dtype=float) + HARDLY_GIVEN for entries in (of_unknowns[0], of_rows[0]))
    logs = np.concatenate([of_unknowns[1], of_rows[1]], dtype=float)
    d, r = np.split(np.exp2(-solved_between_diagonals((D, R), pattern, logs)), [n])
    return d, r


def _in_units(problem: ContactProblem, twin: ContactProblem, d: Array, r: Array) -> ExtendedRows:
    """Return the rows of a twin for extended precision from the stored ones of the problem."""
    given, made, m = extended_rows(problem), ExtendedRows(twin), problem.contacts
    made.stiffness = _ScaledRows(given.stiffness, d, d)
    made.normal, made.tie = _ScaledRows(given.normal, r[:m], d), _ScaledRows(given.tie, r[m:], d)
    made.outward = _ScaledRows(given.outward, d, r)
    return made


def scaled_by(left: Array, matrix: Any, right: Array) -> Any:
    """Return diag(left) M diag(right) of a CSR matrix, in its pattern."""
    data = matrix.data * np.repeat(left, np.diff(matrix.indptr)) * right[matrix.indices]
    return sp.csr_matrix((data, matrix.indices, matrix.indptr), shape=matrix.shape)


def _largest(sizes: Any, scale: Array) -> Array:
    """Return the largest entry of every row of a CSR matrix of sizes, its columns scaled."""
    largest = np.zeros(sizes.shape[0])
    filled = np.flatnonzero(np.diff(sizes.indptr))
    if filled.size:
        largest[filled] = np.maximum.reduceat(sizes.data * scale[sizes.indices], sizes.indptr[filled])
    return largest


def _near_one(sizes: Array) -> Array:
    """Return whether each size is zero, or nearer to one than to other powers of two."""
    return np.asarray((sizes == 0) | ((sizes >= 1 / NEAR_ONE) & (sizes <= NEAR_ONE)))


def _root(sizes: Array) -> Array:
    return np.asarray(np.sqrt(np.where(sizes > 0, sizes, 1.0)))


def _power_of_two(values: Array) -> Array:
    return np.asarray(2.0 ** np.round(np.log2(values)))


def least_length(twin: ContactProblem, closed: Mask | None = None) -> float:
    """Return the length below which lengths count as zero, if no gap or tie imposes one.

    As K is at most one, displacements by a load are at least as large as the load, or zero. With `closed` contacts (m,)
    the gaps of the others impose nothing.
    """
    if (twin.gap if closed is None else twin.gap[closed]).any() or twin.tie_value.any():
        return 0.0
    return NO_LENGTH * _size(twin.load_size)


def mostly_bare(problem: ContactProblem) -> bool:
    """Return whether K has no entry at many loaded or constrained unknowns, as in a linear program, unlike bodies."""
    bare = problem.diagonal == 0
    if problem.frictional or np.sum(bare) <= MOST_BARE:
        return False
    acting = problem.load != 0
    for rows in (problem.normal, problem.tie):
        lengths = np.diff(rows.indptr)
        acting[rows.indices[np.repeat(lengths > 1, lengths)]] = True
    return int(np.sum(bare & acting)) > MOST_BARE


def entries_of(problem: ContactProblem) -> int:
    """Return the number of entries of K and of the rows of contacts and ties, at least one."""
    return max(int(problem.stiffness_rows.nnz + problem.normal.nnz + problem.tie.nnz), 1)


# A search for the closed contacts of condensed bodies may solve as many systems as take about a second: these entries
# over those of K and the rows, and at least some.
AFFORDABLE_ENTRIES, LEAST_AFFORDABLE = 1_000_000, 60
# With sparse systems, if K is not that of a program, as many as take some seconds.
SPARSE_ENTRIES, LEAST_SPARSE = 10_000_000, 600


def affordable_systems(problem: ContactProblem, sparse: bool = False) -> float:
    """Return the number of systems that a search for the closed contacts may solve; programs count their own."""
    if sparse:
        return np.inf if mostly_bare(problem) else max(LEAST_SPARSE, SPARSE_ENTRIES // entries_of(problem))
    return max(LEAST_AFFORDABLE, AFFORDABLE_ENTRIES // entries_of(problem))


def negligible_in_rows(
    problem: ContactProblem, answer: Answer, part: float, connected: Indices, beside: float
) -> NegligibleSizes:
    """Return what counts as zero where K gives no scale, a fraction of the largest equilibrated force and length.

    Forces are those of the `connected` unknowns (n,) by part, at least `beside` of the largest; with friction only
    loads.

    Parameters
    ----------
    problem : ContactProblem
    answer : Answer
    part : the fraction that counts as none
    connected : (n,) array of int, the number of the part that each unknown belongs to
    beside : the least force of a part that counts, relative to the largest of all
    """
    twin, scaling = (balanced if mostly_bare(problem) else equilibrated)(problem)
    u = abs(answer.displacement)
    meeting = problem.load_size
    # With friction no bound would show that forces of two walls on each other hide a load, so that loads alone count.
    if not problem.frictional:
        meeting = meeting + problem.stiffness_sizes @ u + abs(problem.normal).T @ abs(answer.normal_force)
        meeting = meeting + abs(problem.tie).T @ abs(answer.tie_force)
    along = np.zeros((0, len(u))) if problem.tangent is None else abs(problem.tangent)
    lengths = (u / scaling.unknowns, abs(problem.tie_value) / scaling.ties)
    least = least_length(twin, answer.normal_force > 0)
    length = part * max(least * scaling.length, *(_size(sizes) for sizes in lengths))
    # Where no force acts, those that would move the largest length.
    stiffest = float(np.max(problem.diagonal * scaling.unknowns**2, initial=0.0))
    acting = np.zeros(int(connected.max(initial=-1)) + 1)
    np.maximum.at(acting, connected, meeting * scaling.unknowns)
    largest = _size(acting)
    acting = np.where(acting > 0, np.maximum(acting, beside * largest), largest)[connected]
    force = part * acting if largest > stiffest * length else np.full(len(acting), stiffest * length)
    tangent = length * (along @ scaling.unknowns)
    return NegligibleSizes(force / scaling.unknowns, length * scaling.contacts, tangent, length * scaling.ties)


def balancing_factors(sizes: Array, group: Indices) -> tuple[Vector, Vector]:
    """Return factors s (k,) of rows and t (r,) of columns, equal within a group, with s_i sizes_ij t_j near 1.

    They approximately minimise the sum of squares of log(s_i sizes_ij t_j) over sizes above rounding of the largest in
    their row, and are then scaled to make the largest of each row one.
    """
    there = sizes > ROUNDING_OF_A_ROW * sizes.max(axis=1, initial=0.0, keepdims=True)
    logarithm = np.log(np.where(there, sizes, 1.0))
    of_row, of_column, found = np.zeros(len(sizes)), np.zeros(sizes.shape[1]), np.unique(group)
    in_group = group[None] == found[:, None]
    of_group = in_group.T
    in_rows, in_columns = np.maximum(there.sum(axis=1), 1), np.maximum(there.sum(axis=0) @ of_group, 1)
    for _ in range(BALANCING_SWEEPS):
        of_row = -(np.where(there, logarithm + of_column, 0.0).sum(axis=1) / in_rows)
        each = np.where(there, logarithm + of_row[:, None], 0.0).sum(axis=0) @ of_group
        of_column = -(each / in_columns) @ in_group
    size = np.where(there, logarithm + of_column, -np.inf).max(axis=1, initial=-np.inf)
    return np.exp(np.where(np.isfinite(size), -size, 0.0)), np.exp(of_column)


def balanced_exponents(entries: Any, exponent: Index, unknowns: Index, free: Mask) -> Index | None:
    """Return binary exponents of D (n,) for which the entries E_ij D_j of each row are similar, else None.

    Exponents of the `free` unknowns are the least squares of log |E_ij D_j / R_i| over D and R; the others are given.
    Where nothing is given, those of D are made small.

    Parameters
    ----------
    entries : sparse array in coordinates, (r, n), E, without entries of zero
    exponent : (z,) array, the binary exponents of the entries
    unknowns, free : (n,) arrays, the exponents of D that are given, and which are not
    """
    from scipy.sparse.linalg import lsqr

    count, z = entries.shape[0], len(exponent)
    mine = np.flatnonzero(free[entries.col])
    columns, at = np.unique(entries.col[mine], return_inverse=True)
    q = len(columns)
    place = np.concatenate([np.arange(z), mine, z + np.arange(q)])
    unknown = np.concatenate([entries.row, count + at, count + np.arange(q)])
    factors = np.concatenate([-np.ones(z), np.ones(len(mine)), np.full(q, HARDLY)])
    given = np.append(exponent + np.where(free[entries.col], 0, unknowns[entries.col]), np.zeros(q))
    equations = sp.csr_array((factors, (place, unknown)), shape=(z + q, count + q))
    found = np.round(lsqr(equations, -given.astype(float), atol=1e-12, btol=1e-12)[0]).astype(np.int64)
    balanced = unknowns.copy()
    balanced[columns] = found[count:]
    left = exponent + balanced[entries.col] - found[entries.row]
    return balanced if int(np.max(abs(left), initial=0)) <= ALIKE else None


# Numbers without dimension for backends that have absolute tolerances. With u = l D y, D = 1/sqrt(K_jj) and rows of
# unit length in the energy, min 1/2 u'Ku - f'u over E u <= g becomes
#
#     min 1/2 y'(DKD)y - (D f / l)'y   subject to   (E_i D / r_i) y <= g_i / (l r_i),   r_i = |E_i D|,
#
# whose stiffness has a unit diagonal and whose rows have unit length in any system of units. The length l (the square
# root of an energy) makes loads and gaps of order one; forces come back as l_i = l y_i / r_i.


def nondimensional(problem: ContactProblem) -> tuple[ContactProblem, Scaling]:
    """Return the nondimensional twin of a problem."""
    D = unknown_scale(problem)
    normal, contacts = _unit_rows(problem.normal, D)
    tie, ties = _unit_rows(problem.tie, D)
    load, gap, value = D * _without_idle_part(problem), problem.gap / contacts, problem.tie_value / ties
    length = float(np.max(np.concatenate([abs(load), -gap, abs(value)]), initial=0.0)) or 1.0
    K = problem.stiffness
    stiffness = sp.csc_array(sp.diags(D) @ K @ sp.diags(D)) if sp.issparse(K) else K * np.outer(D, D)
    twin = problem._transformed(
        stiffness, load / length, D * problem.load_size / length, normal, gap / length, tie, value / length
    )
    if (known := problem._computed.condensation) is not None:
        twin._computed.rigid_motions = known.rigid.motions / D[:, None]
    return twin, Scaling(D, contacts, ties, length, length)


def _without_idle_part(problem: ContactProblem) -> Array:
    """Return the load without rounding errors of larger ones on unknowns without stiffness."""
    rounding = 16 * EPS * problem.load_size
    bare = problem.diagonal == 0
    return np.where(bare & (abs(problem.load) <= rounding), 0.0, problem.load)


def _unit_rows(rows: Any, D: Array) -> tuple[Any, Array]:
    scaled = sp.csr_array(rows @ sp.diags(D))
    length = np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1)).ravel())
    return sp.csr_array(sp.diags(1.0 / length) @ scaled), length


def bounds_of_unknowns(problem: ContactProblem) -> tuple[Vector, Vector]:
    """Return the least and largest values (n,) of the unknowns by contacts and ties of one unknown [length]."""
    lower, upper = np.full(problem.dimension, -np.inf), np.full(problem.dimension, np.inf)
    for rows, limit, both in ((problem.normal, problem.gap, False), (problem.tie, problem.tie_value, True)):
        single = np.flatnonzero(np.diff(rows.indptr) == 1)
        unknown, entry = rows.indices[rows.indptr[single]], rows.data[rows.indptr[single]]
        value = limit[single] / entry
        np.minimum.at(upper, unknown[(entry > 0) | both], value[(entry > 0) | both])
        np.maximum.at(lower, unknown[(entry < 0) | both], value[(entry < 0) | both])
    return lower, upper


# Bounds of energies hold for solutions within this multiple of the size of the answer.
REACH = 1e3
# The relative rounding of a bound of an unknown, a quotient of doubles.
ROUNDED_BOUND = EPS


def reach(problem: ContactProblem, displacement: Vector, residual: Vector) -> Vector:
    """Return R (n,), the largest change of each unknown from U in the direction of a residual [length].

    It is limited by contacts and ties of that unknown, else REACH times the size of the answer.
    """
    farthest = REACH * (abs(displacement) + np.max(abs(displacement), initial=0.0))
    lower, upper = bounds_of_unknowns(problem)
    left = np.where(residual > 0, upper - displacement, displacement - lower)
    rounding = ROUNDED_BOUND * np.where(residual > 0, abs(upper), abs(lower))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.minimum(farthest, np.maximum(left, 0.0) + rounding))


def nearest_bounds(problem: ContactProblem) -> tuple[Indices, Indices]:
    """Return the contacts of one unknown that are its tightest lower and upper bounds (n,), -1 for none."""
    rows = problem.normal
    single = np.flatnonzero((np.diff(rows.indptr) == 1) & np.isfinite(problem.gap))
    unknown, entry = rows.indices[rows.indptr[single]], rows.data[rows.indptr[single]]
    value, found = problem.gap[single] / entry, np.full((2, problem.dimension), -1, dtype=np.intp)
    for side, sign in ((0, -1.0), (1, 1.0)):
        of_side = np.flatnonzero(sign * entry > 0)
        of_side = of_side[np.argsort(-sign * value[of_side], kind="stable")]  # the nearest is written last
        found[side][unknown[of_side]] = single[of_side]
    return found[0], found[1]


def rows_alone(rows: Any) -> tuple[Indices, Indices]:
    """Return the rows of one entry whose unknown no other such row has, and these unknowns."""
    single = np.flatnonzero(np.diff(rows.indptr) == 1)
    single = single[rows.data[rows.indptr[single]] != 0]
    unknown = rows.indices[rows.indptr[single]]
    alone = np.bincount(unknown, minlength=rows.shape[1])[unknown] == 1
    return single[alone], unknown[alone].astype(np.intp)


def worst_of_neighbours(problem: ContactProblem, size: Vector) -> Mask:
    """Return the contacts (m,) with the largest positive size (m,) among those that share an unknown."""
    E = problem.normal
    at_unknowns, around = np.zeros(problem.dimension), np.zeros(problem.contacts)
    contact = np.repeat(np.arange(problem.contacts), np.diff(E.indptr))
    np.maximum.at(at_unknowns, E.indices, size[contact])
    np.maximum.at(around, contact, at_unknowns[E.indices])
    return np.asarray((size > 0) & (size >= around))
