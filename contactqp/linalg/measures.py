"""Compute the forces and lengths that meet at unknowns and contacts to measure residuals, and which count as zero.

Componentwise figures compare forces and lengths at one place. Where displacements decay to 1e-20 of the largest, or a
load acts on a support, only rounding meets, which must not be compared with itself. With D_j = 1/sqrt(K_jj) and the
displacement u_e without its rigid part, the intrinsic size S [square root of energy] is the largest of

    |u_e|_K,    max_j D_j |f|_j,    max_i length_i / |E_i D|,

length_i being |g_i| where the answer closes that gap (|b_i| of a tie, |slip_origin_i| where contact i sticks there) and
at most ten times |E_i||u_e| elsewhere; of rows that touch unknowns without stiffness too, which may yield, it is at
most ten times what the stiff ones move. A problem without load and ties to impose lengths has its smallest gap. A force
at unknown j counts as zero up to t S / D_j, a length of row i up to t S |E_i D|, with t a thousandth of the tolerance,
1e-12 by default. So does the rounding of doubles: of |K||u| and |E||u|, including the rigid part, and a few roundings
of |K||z| for a rigid motion z.

Where contacts carry a load beside a weak spring, S is the elongation of the spring alone and unrelated to actual
lengths. So lengths count as zero at most up to 1000 t = 1e-9 of the longest among the gaps, tie values and
displacements |E||u| of the part's rows, each over |E_i D|, if one of the first two is not zero; slips likewise with the
slip origins and slips included. Rounding of a solve in doubles may be longer where rows hardly move but their
surroundings do: 1e-14 |u_e|_K of the part also counts as zero, up to 1e-6 of these lengths. Where a body crosses a gap
rigidly before it is loaded, S is unrelated to its loads, and redundant contacts may have self-equilibrated forces,
which no bound shows. So with loads, contact forces count as zero at most up to 1e-9 of the largest of D_j |f|_j and
|u_e|_K of the part, over D_j, or a rounding of |K||u|. Without loads, forces that all count as zero need not balance.

The resultant of contacts and ties, f - K u, is included in the first two, as D_j |K u|_j <= |u_e|_K. The forces
themselves are not used, as self-equilibrated ones may have any size. Parts of a problem that are not connected by
stiffness, contact or tie have separate sizes, at least a tolerance (1e-9) of the largest; an unloaded part has the
largest. The bounds are computed from all residuals, so that nothing is hidden from them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.equilibration import mostly_bare, negligible_in_rows
from contactqp.linalg.extended import extended_rows
from contactqp.linalg.factorization import RIGID_FORCE, connected_parts, joined_parts
from contactqp.model.arrays import EPS, Array, Indices, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, NegligibleSizes


@dataclass(frozen=True, eq=False)
class RowSizes:
    """The absolute values of rows E (r, n)."""

    rows: Any  # E, CSR
    row: Indices  # (z,) the row of each entry
    entries: Vector  # (z,) the sizes of the entries
    compliance: Vector  # (r,) |E_i D|^2, D = 1/sqrt(K_jj) [length / force]
    touching: Indices  # the rows that touch an unknown
    first: Indices  # the first unknown of each of these

    def resultant(self, force: Vector) -> Vector:
        """Return E'l (n,) of forces l (r,) [force]."""
        return self._sums(self.rows.data, force, of_rows=False)

    def moved(self, displacement: Vector) -> Vector:
        """Return E u (r,) of displacements u (n,) [length]."""
        return self._sums(self.rows.data, displacement, of_rows=True)

    def lengths(self, size: Vector) -> Vector:
        """Return |E||u| (r,) of sizes |u| (n,) [length]."""
        return self._sums(self.entries, size, of_rows=True)

    def forces(self, size: Vector) -> Vector:
        """Return |E|'|l| (n,) of sizes |l| (r,) [force]."""
        return self._sums(self.entries, size, of_rows=False)

    def measure(self, force: Vector, meeting: Vector, least: Vector | None = None) -> Vector:
        """Return max_j |E_ij l_i| / F_j (r,) of forces l (r,), F (n,) those that meet; l up to `least` (n,) give 0."""
        acting, at = self.entries * abs(force)[self.row], self.rows.indices
        measure = np.zeros(self.rows.shape[0])
        np.maximum.at(measure, self.row, ratio(acting if least is None else beyond(acting, least[at]), meeting[at]))
        return measure

    def _sums(self, entries: Vector, values: Vector, of_rows: bool) -> Vector:
        """Return sums of entries times values over each row, or over each unknown."""
        if len(entries) > MANY_ENTRIES:
            matrix = sp.csr_array((entries, self.rows.indices, self.rows.indptr), shape=self.rows.shape)
            return np.asarray((matrix if of_rows else matrix.T) @ values)
        at, of = (self.row, self.rows.indices) if of_rows else (self.rows.indices, self.row)
        return np.bincount(at, weights=entries * values[of], minlength=self.rows.shape[not of_rows]).astype(float)


def row_sizes(problem: ContactProblem, rows: Any) -> RowSizes:
    """Return the sizes of rows (r, n) over all unknowns; those of the problem's own rows are computed once."""
    if rows is not problem.normal and rows is not problem.tangent and rows is not problem.tie:
        return sizes_of(rows, problem.diagonal)
    made: dict[int, RowSizes] = problem._computed.row_sizes
    if id(rows) not in made:
        made[id(rows)] = sizes_of(rows, problem.diagonal)
    return made[id(rows)]


def sizes_of(rows: Any, diagonal: Vector | None = None) -> RowSizes:
    """Return the sizes of rows (r, n) over unknowns with diagonal entries K_jj; the compliance is 0 without these."""
    compliance = reciprocal(np.zeros(rows.shape[1]) if diagonal is None else diagonal)
    size, row = abs(rows.data), np.arange(rows.shape[0]).repeat(rows.indptr[1:] - rows.indptr[:-1])
    found = np.bincount(row, weights=size**2 * compliance[rows.indices], minlength=rows.shape[0])
    touching = (rows.indptr[1:] > rows.indptr[:-1]).nonzero()[0]
    return RowSizes(rows, row, size, found.astype(float), touching, rows.indices[rows.indptr[touching]])


# Sums of more entries are products of sparse matrices, which take a tenth of the time.
MANY_ENTRIES = 10_000
# A gap is closed by an answer if it is smaller than this part of its lengths.
CLOSED = 1e-6
# The largest size given by open gaps, relative to the lengths that meet there.
WITHIN_REACH = 10.0
# The least size of a separate part, relative to the largest.
BESIDE_OTHERS = 1e-9
# The largest ratio of lengths that count as zero to the longest one, in units of the intrinsic fraction.
OF_ALL_LENGTHS = 1e3
# The default fraction of the intrinsic size below which forces and lengths count as zero.
NOTHING_BY_DEFAULT = 1e-12
# A row is at rest if its lengths are below this part of the largest displacement around it, in the energy scale.
ROUNDING_OF_LENGTH = 1e-14
# Up to 1e-6, as CLOSED, if that is rounding of the displacements around them.
OF_NEAR_LENGTHS = 1e6
# The error of forces and lengths by rounding a displacement to doubles, relative to |K||u| and |E||u|.
HELD_BY_DOUBLES = EPS
# A load such as F sin(pi) on an unknown without stiffness and rows is rounding up to this part of the largest load.
ROUNDING_OF_LOADS = 64 * EPS


def intrinsic_size(problem: ContactProblem, answer: Any, elastic: Vector) -> Vector:
    """Return the intrinsic size S (n,) at each unknown, that of its connected part.

    `elastic` (n,) is the displacement without its rigid part.
    """
    D, part = scale_through_rows(problem), parts(problem)
    size = _strain(problem, part, elastic)
    np.maximum.at(size, part, D * problem.load_size)
    u, stiff = answer.displacement, problem.diagonal > 0
    few_yield = not (stiff.all() or mostly_bare(problem))
    for rows, limit in (one for one in rows_and_limits(problem) if one[1].size):
        of_row = row_sizes(problem, rows)
        met = of_row.lengths(abs(u))
        reached = met if elastic is u else of_row.lengths(abs(elastic))
        length = imposed(limit, of_row.moved(u), met, reached, of_row.compliance)
        if few_yield:
            moved, may = (of_row.lengths(one) for one in (np.where(stiff, abs(u), 0.0), np.where(stiff, 0.0, 1.0)))
            length = beside_yielding(length, moved, may > 0, of_row.compliance)
        np.maximum.at(size, part[of_row.first], length[of_row.touching])
    size[~np.isfinite(size)] = 0.0  # overflow must not excuse anything
    whole = float(size.max(initial=0.0))
    if not problem.load_size.any() and not problem.tie_value.any():
        gaps = in_energy(abs(problem.gap), row_sizes(problem, problem.normal).compliance)
        least = float(np.min(gaps[np.isfinite(gaps) & (gaps > 0)], initial=np.inf))
        whole = max(whole, least if np.isfinite(least) else 0.0)
        return np.full(len(part), whole)
    return np.asarray(np.where(driven_parts(problem, part), np.maximum(size, BESIDE_OTHERS * whole), whole)[part])


def _strain(problem: ContactProblem, part: Indices, elastic: Vector) -> Vector:
    """Return |u_e|_K of every part [square root of energy]."""
    square = np.bincount(part, weights=elastic * (problem.stiffness_rows @ elastic))
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def driven_parts(problem: ContactProblem, part: Indices) -> Mask:
    """Return which parts have a load, an overlap, a tie value or a slip origin."""
    driven = np.zeros(int(part.max(initial=-1)) + 1, dtype=bool)
    driven[part[problem.load_size > 0]] = True
    for rows, limit in () if driven.all() else (one for one in rows_and_limits(problem) if one[1].size):
        of_row = row_sizes(problem, rows)
        reached = limit[of_row.touching]
        moving = reached < 0 if rows is problem.normal else reached != 0
        driven[part[of_row.first[moving]]] = True
    return driven


def negligible_in(problem: ContactProblem, answer: Any, elastic: Vector, size: Vector, part: float) -> NegligibleSizes:
    """Return the forces and lengths that count as zero, a fraction of the intrinsic sizes or rounding.

    Parameters
    ----------
    problem, answer : ContactProblem, Answer
    elastic : (n,) array, the displacement without its rigid part, of which K, being rounded, leaves RIGID_FORCE at most
    size, part : (n,) array and float, the intrinsic sizes and the fraction of them
    """
    if not problem.diagonal.all() and (mostly_bare(problem) or not problem.diagonal.any()):
        return negligible_in_rows(problem, answer, part, parts(problem), BESIDE_OTHERS)
    u, D = abs(answer.displacement), scale_through_rows(problem)
    force = np.divide(part * size, D, out=np.zeros(len(D)), where=D > 0)
    held = HELD_BY_DOUBLES * inner_forces(problem, answer.displacement)
    force, of_contacts = np.maximum(force, held), _least_contact_force(problem, elastic, size, part, held)
    if elastic is not answer.displacement:
        force = np.maximum(force, RIGID_FORCE * (problem.stiffness_sizes @ abs(answer.displacement - elastic)))
    force[untouched(problem)] = ROUNDING_OF_LOADS * problem.load_size.max(initial=0.0)

    def lengths(rows: Any, size: Vector) -> Vector:
        rounded = HELD_BY_DOUBLES * row_sizes(problem, rows).lengths(u)
        return np.asarray(np.maximum(part * of_rows(problem, rows, size), rounded))

    least = ROUNDING_OF_LENGTH / part * elastic if part > 0 else elastic
    across, tangent = _beside_lengths(problem, u, least, size), np.zeros(0)
    if problem.tangent is not None:
        tangent = lengths(problem.tangent, _beside_lengths(problem, u, least, size, part * size))
    of_contacts = None if of_contacts is None else np.minimum(force, of_contacts)
    tie = lengths(problem.tie, across) if problem.ties else np.zeros(0)
    return NegligibleSizes(force, lengths(problem.normal, across), tangent, tie, of_contacts)


def _beside_lengths(problem: ContactProblem, u: Vector, least: Vector, size: Vector, still: Any = None) -> Vector:
    """Return sizes S (n,) limited to 1e3 times the longest of |g|, |b| and |E||u| over |E_i D| in the part.

    The limit is at least the strain of displacements `least` (n,), up to 1e6 times the longest length. Parts without
    stated lengths have none; for slips those whose lengths, with slip origins, are at most `still` (n,).
    """
    part, (longest, here) = parts(problem), _longest_stated(problem, still is not None)
    cut = (longest[part] > (0.0 if still is None else still)) & (size > OF_ALL_LENGTHS * longest[part])
    if not cut.any():
        return size
    for of_row in here:
        _raise_to(longest, part, of_row, of_row.lengths(abs(u)))
    rest = np.clip(_strain(problem, part, least), OF_ALL_LENGTHS * longest, OF_NEAR_LENGTHS * longest)
    return np.where(cut, np.minimum(size, rest[part]), size)


def longest_stated(problem: ContactProblem) -> Vector:
    """Return the longest of |g|, |b| and |slip_origin| of the part of each unknown, over |E_i D|, (n,) in sqrt(energy).

    It is infinite where none is stated. Displacements of bodies held by contacts, ties and friction only are of this
    size, whatever the forces.
    """
    longest = _longest_stated(problem, along=True)[0][parts(problem)]
    return np.where(longest > 0, longest, np.inf)


def _longest_stated(problem: ContactProblem, along: bool) -> tuple[Vector, list[RowSizes]]:
    """Return the longest of |g|, |b| and, if asked for, |slip_origin| over |E_i D| of each part, and those rows."""
    part, here = parts(problem), list[RowSizes]()
    longest = np.zeros(int(part.max(initial=-1)) + 1)
    for rows, limit in rows_and_limits(problem):
        if limit.size and (along or rows is not problem.tangent):
            here.append(row_sizes(problem, rows))
            _raise_to(longest, part, here[-1], np.where(np.isfinite(limit), abs(limit), 0.0))
    return longest, here


def _raise_to(largest: Vector, part: Indices, of_row: RowSizes, length: Vector) -> None:
    """Raise the largest length of each part to those of rows (r,), in the root of energy."""
    np.maximum.at(largest, part[of_row.first], in_energy(length, of_row.compliance)[of_row.touching])


def _least_contact_force(
    problem: ContactProblem, elastic: Vector, size: Vector, part: float, held: Vector
) -> Vector | None:
    """Return the contact forces (n,) that count as zero, None if the same as for residuals.

    Where a body crosses a gap rigidly they are 1000 t of its loads, or `held` (n,), a rounding of |K||u|.
    """
    D, of_part = scale_through_rows(problem), parts(problem)
    acting = np.zeros(int(of_part.max(initial=-1)) + 1)
    np.maximum.at(acting, of_part, D * problem.load_size)
    if not ((acting > 0)[of_part] & (size > OF_ALL_LENGTHS * acting[of_part])).any():
        return None
    acting = np.where(acting > 0, np.maximum(acting, _strain(problem, of_part, elastic)), np.inf)[of_part]
    pushed = np.divide(OF_ALL_LENGTHS * part * acting, D, out=np.full_like(D, np.inf), where=D > 0)
    return np.asarray(np.maximum(pushed, held))


def of_rows(problem: ContactProblem, rows: Any, size: Vector) -> Vector:
    """Return the length S |E_i D| of every row that belongs to an intrinsic size S (n,) of the unknowns.

    Rows without stiff unknowns have the scale of connected rows (`scale_through_rows`).
    """
    of_row, beside = row_sizes(problem, rows), np.zeros(rows.shape[0])
    beside[of_row.touching] = size[of_row.first]
    felt = np.sqrt(of_row.compliance)
    if not felt.all() and not problem.diagonal.all():
        felt = np.where(felt > 0, felt, np.sqrt(rows.power(2) @ scale_through_rows(problem) ** 2))
    return np.asarray(beside * felt)


def bodies(problem: ContactProblem) -> Indices:
    """Return the number of the body, a connected part of K, that each unknown belongs to (n,)."""
    if (of_stiffness := problem._computed.of_stiffness).bodies is None:
        K, n = problem.stiffness_rows, problem.dimension
        one = n > 0 and K.indptr[1] == n and K.has_canonical_format  # join the first unknown to each other one
        of_stiffness.bodies = np.zeros(n, dtype=np.intp) if one else connected_parts(K)[1].astype(np.intp)
    return of_stiffness.bodies


def parts(problem: ContactProblem) -> Indices:
    """Return the number of the part that each unknown belongs to (n,): bodies joined by contacts and ties."""
    found: Indices | None = problem._computed.parts
    if found is None:
        found = bodies(problem)
        count = int(found.max(initial=-1)) + 1
        if count > 1:
            one, other = np.concatenate([_joined(rows, found) for rows, _ in rows_and_limits(problem)], axis=1)
            apart = one != other
            if apart.any():
                found = joined_parts(count, one[apart], other[apart])[found].astype(np.intp)
        problem._computed.parts = found
    return found


def _joined(rows: Any, body: Indices) -> Indices:
    """Return the body of each of z entries of CSR rows, and the body of the first entry of its row, (2, z)."""
    counts = rows.indptr[1:] - rows.indptr[:-1]
    first = rows.indices[rows.indptr[:-1][counts > 0]]
    return np.stack([body[rows.indices], np.repeat(body[first], counts[counts > 0])])


def rows_and_limits(problem: Any) -> list[tuple[Any, Vector]]:
    """Return the rows of contacts, ties and tangents of a problem, or of one rank's part, each with its lengths."""
    rows = [(problem.normal, problem.gap), (problem.tie, problem.tie_value)]
    if problem.tangent is not None and problem.slip_origin is not None:
        rows.append((problem.tangent, problem.slip_origin.ravel()))
    return rows


def imposed(limit: Vector, moved: Vector, whole: Vector, elastic: Vector, compliance: Vector) -> Vector:
    """Return the length that each row imposes on an answer (r,) [square root of energy].

    Parameters
    ----------
    limit, moved, whole, elastic : (r,) arrays, g, E u, |E||u| and |E||u_e| of the rows [length]
    compliance : (r,) array, |E_i D|^2 [length / force]
    """
    finite = np.isfinite(limit)
    if not finite.all():
        limit = np.where(finite, limit, 0.0)
    length = abs(limit)
    closes = finite & (abs(limit - moved) <= CLOSED * (whole + length))
    reached = np.minimum(length, WITHIN_REACH * elastic)  # elastic lengths are not negative
    return in_energy(np.where(closes, length, reached), compliance)


def beside_yielding(length: Vector, moved: Vector, may_yield: Mask, compliance: Vector) -> Vector:
    """Return the lengths (r,) that rows impose if unknowns without stiffness may yield [root of energy].

    A row with such an unknown imposes at most ten times the displacement of its stiff unknowns.

    Parameters
    ----------
    length : (r,) array, the lengths as `imposed` returns them [square root of energy]
    moved : (r,) array, |E||u| over the stiff unknowns alone [length]
    may_yield : (r,) array of bool, whether the row touches an unknown without stiffness
    compliance : (r,) array, |E_i D|^2 [length / force]
    """
    return np.where(may_yield, np.minimum(length, in_energy(WITHIN_REACH * moved, compliance)), length)


def in_energy(length: Vector, compliance: Vector) -> Vector:
    """Return lengths of rows over |E_i D| (r,) [square root of energy], zero for rows without stiff unknowns."""
    return np.divide(length, np.sqrt(compliance), out=np.zeros(length.shape), where=compliance > 0)


def scale_through_rows(problem: ContactProblem) -> Vector:
    """Return D (n,): 1/sqrt(K_jj), or of an unknown without stiffness the scale that its rows give it, else 0.

    Answers are measured by it. It is zero where rows reach nothing stiff, and no length counts as zero there. A row
    with stiff unknowns k gives max_k |E_ik| D_k / |E_ij|; the least of several is used and passed on to further rows:
    a row that hardly moves the unknown carries none of its load, which would make the size of the problem.
    """
    if problem._computed.scale_through_rows is None:
        problem._computed.scale_through_rows = given_on(problem, reciprocal(np.sqrt(problem.diagonal)))
    return problem._computed.scale_through_rows


def given_on(problem: ContactProblem, D: Vector, choice: np.ufunc = np.minimum) -> Vector:
    """Return scales (n,): D, and where it is 0 the least or largest of the rows, as in `scale_through_rows`."""
    while (unknown := D == 0).any():
        given = choice(*(_given_by(rows, D, choice) for rows in (problem.normal, problem.tie)))
        D = np.where(unknown & np.isfinite(given), given, D)
        if not np.any(D[unknown] > 0):
            break
    return D


def _given_by(rows: Any, D: Vector, choice: np.ufunc) -> Vector:
    row = np.arange(rows.shape[0]).repeat(rows.indptr[1:] - rows.indptr[:-1])
    size, largest, start = abs(rows.data), np.zeros(rows.shape[0]), np.inf if choice is np.minimum else 0.0
    np.maximum.at(largest, row, size * D[rows.indices])
    acting = (size > 0) & (largest[row] > 0)
    choice.at(given := np.full_like(D, start), rows.indices[acting], largest[row[acting]] / size[acting])
    return given


def untouched(problem: ContactProblem) -> Any:
    """Return which unknowns (n,) have neither stiffness nor rows."""
    if problem._computed.untouched is None:
        touched = problem.diagonal > 0
        for rows, _ in () if touched.all() else rows_and_limits(problem):
            touched[rows.indices[rows.data != 0]] = True
        problem._computed.untouched = ~touched
    return problem._computed.untouched


def lay_out(problem: ContactProblem) -> None:
    """Form the data of the stiffness for residuals and figures in advance, so that no timing includes it."""
    extended_rows(problem).lay_out()
    problem.stiffness_sizes, bodies(problem)


def inner_forces(problem: ContactProblem, displacement: Vector) -> Vector:
    """Return |K||u| (n,) [force], kept for the last displacement with a read-only array."""
    kept = problem._computed.of_answer.inner_forces
    if kept is None or kept[0] is not displacement:
        kept = displacement, np.asarray(problem.stiffness_sizes @ abs(displacement))
        if not displacement.flags.writeable:
            problem._computed.of_answer.inner_forces = kept
    return kept[1]


def forces_that_meet(problem: ContactProblem, answer: Answer) -> Vector:
    """Return F (n,): the sum of the sizes of all forces that meet at each unknown [force]."""
    return inner_forces(problem, answer.displacement) + outer_forces(problem, answer)


def outer_forces(problem: ContactProblem, answer: Answer) -> Vector:
    """Return F without |K||u| (n,): the sizes of loads, contact forces and tie forces at each unknown [force]."""
    outer = problem.load_size + row_sizes(problem, problem.normal).forces(abs(answer.normal_force))
    if problem.ties:
        outer = outer + row_sizes(problem, problem.tie).forces(abs(answer.tie_force))
    if problem.tangent is not None and answer.friction_force is not None:
        outer = outer + row_sizes(problem, problem.tangent).forces(abs(answer.friction_force).ravel())
    return np.asarray(outer)


def force_size(problem: ContactProblem, rows: Any, force: Vector) -> float:
    """Return |D E'l|, the size of forces of rows at their own unknowns with the rest fixed [square root of energy]."""
    felt = problem.own_scale * row_sizes(problem, rows).resultant(force)
    return float(np.sqrt(felt @ felt))


def lengths_that_meet(problem: ContactProblem, rows: Any, limit: Vector, displacement: Vector) -> Vector:
    """Return L_i = (|E||u| + |g|)_i of every row (r,), infinite where that is zero [length].

    It is zero up to the rounding 1e-14 |E_i D| max_j |u_j / D_j| of the displacements of the bodies that the row
    touches, D = 1/sqrt(K_jj): the displacement at a support (u_j = 0 as a row) is a rounding error, a violation if
    relative to itself, and none relative to infinity, as 0/0 is 0.

    Parameters
    ----------
    problem, rows : ContactProblem and (r, n) CSR matrix E, rows of it
    limit, displacement : (r,) array g of these rows, and (n,) array u, which may be without its rigid part [length]
    """
    sizes = row_sizes(problem, rows)
    length = sizes.lengths(abs(displacement)) + abs(limit)
    least = ROUNDING_OF_LENGTH * np.sqrt(sizes.compliance)
    size = np.sqrt(problem.diagonal) * abs(displacement)
    if (length <= least * size.max(initial=0.0)).any():
        touched = np.zeros(rows.shape[0])
        np.maximum.at(touched, sizes.row, largest_of_bodies(problem, size)[rows.indices])
        length = np.where(length <= least * touched, np.inf, length)
    return np.asarray(length)


def largest_of_bodies(problem: ContactProblem, size: Vector) -> Vector:
    """Return, for each unknown, the largest size (n,) of any unknown of its body (n,)."""
    largest = np.zeros(int((body := bodies(problem)).max()) + 1)
    np.maximum.at(largest, body, size)
    return np.asarray(largest[body])


def own_compliance(problem: ContactProblem, rows: Any) -> Vector:
    """Return |E_i D|^2 (r,), D = 1/sqrt(K_jj): the compliance of row i, all other unknowns held [length / force]."""
    return row_sizes(problem, rows).compliance


def lengths(vectors: Array) -> Vector:
    """Return |v| of every row of vectors (m, d), infinite if an entry is, and without overflow of squares.

    >>> [f"{length:.12g}" for length in lengths(np.array([[3e200, 4e200], [3e-200, 4e-200]]))]
    ['5e+200', '5e-200']
    """
    if vectors.shape[-1] == 2:
        return np.hypot(vectors[..., 0], vectors[..., 1])  # a reduction takes several times as long
    return abs(vectors.ravel()) if vectors.shape[-1] == 1 else np.hypot.reduce(vectors, axis=-1, initial=0.0)


def directions(vectors: Array) -> Array:
    """Return v/|v| of every row, and zero where v is zero."""
    size = lengths(vectors)[:, None]
    return np.asarray(np.divide(vectors, size, out=np.zeros(vectors.shape), where=size > 0))


def ratio(size: Vector, scale: Vector) -> Vector:
    """Return size / scale entry by entry, with 0/0 = 0 and infinity where the scale alone vanishes."""
    return np.divide(size, scale, out=np.where(size > 0, np.inf, 0.0), where=scale > 0)


def reciprocal(size: Array) -> Array:
    """Return 1/size entry by entry, and 0 where the size is not positive."""
    return np.divide(1.0, size, out=np.zeros(size.shape), where=size > 0)


def beyond(size: Vector, negligible: Vector) -> Vector:
    """Return sizes with 0 where they are at most `negligible`; NaN is kept, and an infinite limit has no effect."""
    return np.asarray(np.where((size <= negligible) & np.isfinite(negligible), 0.0, size))
