"""Restore the rigid motions of free bodies whose stiffness was printed with few digits.

A matrix from a file has six to twelve digits, so that K z of a rigid motion z is not zero but the effect of rounding:
small springs of either sign that hold or drive the body. Where a motion is rigid up to that, K is replaced by K + d,
with the least change d on the pattern of K such that

    (K + d) Z = 0,    d = d',    sum_ij (d_ij / w_ij)^2 = min,    w_ij the rounding of K_ij.

This least-squares problem has as many equations as there are unknowns times motions, and is solved by singular values,
or by LSQR where there are many, and refined. Recognised rotations have only the digits of K and are corrected together
with it.

A motion is stated by the user, or recognised where K has few decimal digits and the motion has nearly no energy. It is
taken for rigid only if K z is within the effect of lost digits everywhere, acts at many unknowns, in rows whose entries
have all the digits of K, and has random signs. A real spring or elastic foundation meets none of these and is kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.model.arrays import EPS, Array, Indices

# Forces K z below this part of |K||z| are rounding errors of doubles, so the matrix was not printed.
EXACT = 256 * EPS
# The error of the entries of motions from singular vectors, relative to the largest.
ROUNDED_MOTION = 16 * EPS
# The relative rounding of entries whose digits cannot be counted, as after a change of units.
COARSEST = 1e-6
# The largest energy of candidate motions, with K scaled to unit diagonal.
SOFT = 1e-4
# The least part of the unknowns at which lost digits have an effect.
WIDESPREAD = 0.25
# The largest forces K z in roundings of the entries; a motion that itself has the digits of K has a few.
INEXACT = 8.0
# The least part of the entries, in rows with forces K z, that have all the digits of K; of printed entries nine in ten
# have. Entries with fewer digits are exact, and so are their sums.
ALL_DIGITS = 0.5
# The number of standard deviations beyond which the energy of a motion is not a sum of roundings.
DEVIATIONS = 4.0
# The forces of springs resist the motion everywhere, while this part of the works z_j (K z)_j of lost digits has the
# other sign.
OTHER_SIGN = 0.01
# The least and the largest number of digits of a printed matrix, and the number of entries that are examined first.
# Fewer digits belong to whole numbers, which are exact.
FEWEST_DIGITS, MOST_DIGITS, LOOKED_AT = 4, 12, 64
# A larger change, in roundings of the unit diagonal, is not one of rounding.
MOST_ROUNDINGS, COARSEST_ROUNDINGS = 2.0, 16.0
# Entries of a motion that are this close to 0, 1 or -1 are rounded to it.
SNAPPED = 1e-3
# The number of rotations by that of translations: of a beam, in the plane, in space.
TURNS = {1: 1, 2: 1, 3: 3}
# The number of unknowns up to which motions that were not stated are searched.
RECOGNISED_UP_TO = 20_000
# The number of unknowns up to which motions are found by a dense eigenvalue problem.
DENSE = 600
# The most motions of one body that are searched; six can be rigid, mechanisms may have more.
MOST_MOTIONS = 12
# The weight of corrections of a rotation, relative to that of changes of the largest entries.
TURNED = 10.0
# The refinements of the change; the smallest and the largest tolerance of LSQR in one, and its most iterations.
REFINEMENTS, SOLVED, HARDLY_SOLVED, MOST_STEPS = 8, 1e-8, 0.1, 1000
# The first half of the refinements by LSQR are damped against noise; as they reduce the energy of rotations only by a
# tenth each, the others are not.
DAMPED = 4.0
# The number of equations up to which singular values are used, as LSQR needs hundreds of iterations for rotations.
FEW_EQUATIONS = 700
# Forces K z of motions of length one, K of unit diagonal, that are rounding of their sums; and the singular value, of
# the largest, that is: the correction of a turn comes in by its product with the change, a rounding of few digits.
NOISE, NO_ROOM = EPS / 8, 1e-13
# The energy z'(K + d)z that half a rounding of every entry makes of a rigid motion, as a part of |z|'|K||z|: beyond
# twice that (`contactqp.linalg.factorization.RIGID_ENERGY`) a motion is not taken for rigid.
ROUNDED_ENERGY = EPS / 2


@dataclass(frozen=True, eq=False)
class Cleared:
    """A stiffness with restored rigid motions."""

    stiffness: Any  # (n, n) CSR
    change: float  # max |d_ij| / sqrt(K_ii K_jj)


def clear_of_printing(stiffness: Any, stated: Array | None) -> Cleared | None:
    """Return K (n, n; CSR) with restored rigid motions, None where nothing is to be changed.

    Parameters
    ----------
    stiffness : CSR matrix
    stated : (n, q) array, optional
        Motions that may be rigid, none if q = 0; without them they are recognised where K has few digits.
    """
    roundings = []
    exact = stated is None and _whole(stiffness.data)
    if (digits := None if exact else _rounding_of_digits(stiffness)) is not None:
        roundings.append(digits)
    if stated is not None and _noisy(stiffness, stated):
        roundings.append(COARSEST * abs(stiffness))
    if not roundings or (stiffness.shape[0] > RECOGNISED_UP_TO if stated is None else not stated.shape[1]):
        return None
    root = np.sqrt(np.where(stiffness.diagonal() > 0, stiffness.diagonal(), 1.0))
    scale: Array = np.exp2(-np.round(np.log2(root)))  # scaling by powers of two does not round
    changes, largest = [], 0.0
    for members in _bodies(stiffness):
        unit = scale[members]
        body = _scaled(stiffness, members, scale)
        for rounding in roundings:
            weight = _scaled(rounding, members, scale)
            if stated is None:
                motions, turns = _recognised(body, weight, unit)
            else:
                motions, turns = stated[members] / unit[:, None], 0
            if (found := _change(body, weight, motions, turns, rounding is digits)) is not None:
                change = found.tocoo()
                i, j = members[change.row], members[change.col]
                values = change.data / (scale[i] * scale[j])
                largest = max(largest, float(np.max(abs(values) / (root[i] * root[j]))))
                changes.append((values, i, j))
                break
    if not changes:
        return None
    values, rows, columns = (np.concatenate(parts) for parts in zip(*changes, strict=True))
    return Cleared(sp.csr_array(stiffness + sp.csr_array((values, (rows, columns)), shape=stiffness.shape)), largest)


def _noisy(stiffness: Any, motions: Array) -> bool:
    """Return whether forces K z beyond rounding act at many unknowns, as by lost digits, and not at few, as by
    supports.
    """
    root = np.sqrt(np.where(stiffness.diagonal() > 0, stiffness.diagonal(), 1.0))[:, None]
    forces = abs(stiffness @ motions) / root
    felt = forces > 8 * EXACT * np.max(root * abs(motions), axis=0)
    return bool(np.mean(np.any(felt, axis=1)) >= WIDESPREAD / 4)


def _bodies(stiffness: Any) -> Iterator[Indices]:
    """Yield the unknowns of each connected part of K that has more than one."""
    from scipy.sparse.csgraph import connected_components

    count, label = connected_components(stiffness, directed=False)
    order = np.argsort(label, kind="stable")
    for members in np.split(order, np.cumsum(np.bincount(label, minlength=count))[:-1]):
        if len(members) > 1:
            yield members


def _scaled(matrix: Any, members: Indices, scale: Array) -> Any:
    part = sp.diags(scale[members])
    whole = len(members) == matrix.shape[0]
    return sp.csr_matrix(part @ (matrix if whole else matrix[members][:, members]) @ part)


def _rounding_of_digits(stiffness: Any) -> Any | None:
    """Return half a unit of the last printed digit of each entry, on the pattern of K; None where digits are too few or
    all.

    Digits are counted as significant ones, or as decimals where all entries have equally many.
    """
    entries = abs(stiffness.data)
    sample = entries[:: max(1, len(entries) // LOOKED_AT)]
    if not len(entries) or not _has_digits(sample, MOST_DIGITS):
        return None
    for digits in range(1, MOST_DIGITS + 1):
        if _has_digits(entries, digits):
            break
    else:
        return None
    if digits < FEWEST_DIGITS:
        return None
    half = 0.5 * 10.0 ** (np.floor(np.log10(entries)) - digits + 1)
    places = _places(entries)
    rounding = sp.csr_matrix(stiffness, copy=True)
    rounding.data = half if places is None else np.maximum(half, 0.5 * 10.0**-places)
    return rounding


def _whole(entries: Array) -> bool:
    """Return whether all entries are whole numbers, the largest of them to the last digit."""
    power = np.floor(np.log10(abs(entries[entries != 0])))
    largest = entries[entries != 0][power == np.max(power, initial=-1.0)]
    return bool(np.all(entries == np.round(entries)) and np.any(largest % 10 != 0))


def _has_digits(entries: Array, digits: int) -> bool:
    """Return whether positive numbers are decimals of so many digits, to rounding."""
    unit = 10.0 ** (np.floor(np.log10(entries)) - digits + 1)
    return bool(np.all(abs(np.round(entries / unit) * unit - entries) <= 4 * EPS * entries))


def _places(entries: Array) -> int | None:
    """Return the largest number of decimals of the entries, None where they have none or too many."""
    for places in range(1, MOST_DIGITS + 1):
        if np.max(entries) * 10.0**places > 1 / EPS:
            return None
        if np.all(abs(np.round(entries * 10.0**places) / 10.0**places - entries) <= 4 * EPS * entries):
            return places
    return None


def _recognised(body: Any, weight: Any, scale: Array) -> tuple[Array, int]:
    """Return motions (p, q) of a body that are resisted by lost digits only, and how many of the last ones are
    rotations.

    Translations come first and are exact.
    """
    translations = _translations(body, weight, scale)
    if not translations.shape[1] and body.shape[0] > DENSE:
        return translations, 0  # further rigid motions are unlikely, and the search may cost more than the solve
    lowest = _lowest(body)
    if not lowest.shape[1]:
        return lowest, 0
    if not translations.shape[1] and lowest.shape[1] == 1:
        single = lowest * scale[:, None]
        single = single / np.max(abs(single))
        whole = np.round(single)
        translations = whole / scale[:, None] if np.all(abs(single - whole) <= SNAPPED) else translations
    basis = _independent(translations)
    count = lowest.shape[1] - basis.shape[1]
    # Without a second direction there is no rotation; other soft motions are those of parts on soft springs.
    one_way = translations.shape[1] == 1 and bool(np.all(translations))
    if count > (0 if one_way else TURNS.get(basis.shape[1], 0)):
        return lowest[:, :0], 0  # inexact translations, for which loads along them could not be recognised
    turns = _independent(lowest - basis @ (basis.T @ lowest), count)
    return np.column_stack([basis, turns]), turns.shape[1]


def _translations(body: Any, weight: Any, scale: Array) -> Array:
    """Return translations (p, q) that are resisted by lost digits only, for unknowns ordered by node or by axis."""
    size, found = body.shape[0], np.zeros((body.shape[0], 0))
    for directions in (1, 2, 3, 6):
        if size % directions:
            continue
        nodes = size // directions
        for order in (np.arange(size) % directions, np.arange(size) // nodes):
            tried = (order[:, None] == np.arange(directions)) / scale[:, None]
            left = abs(_forces(body, tried)) <= INEXACT * (weight @ abs(tried)) + _of_doubles(body, tried)
            rigid = tried[:, np.all(left, axis=0)]
            found = rigid if rigid.shape[1] > found.shape[1] else found
    return found


def _lowest(body: Any) -> Array:
    """Return the motions (p, q) of negligible energy, positive or negative."""
    size = body.shape[0]
    if size <= DENSE:
        values, vectors = np.linalg.eigh(body.toarray())
        return np.asarray(vectors[:, abs(values) <= SOFT][:, :MOST_MOTIONS])
    from scipy.sparse.linalg import ArpackNoConvergence, eigsh

    try:
        start = np.random.default_rng(0).standard_normal(size)
        values, vectors = eigsh(body, k=MOST_MOTIONS, sigma=-2 * SOFT, which="LM", v0=start, tol=1e-10)
    except (ArpackNoConvergence, RuntimeError):
        return np.zeros((size, 0))
    return np.asarray(vectors[:, abs(values) <= SOFT])


def _change(body: Any, weight: Any, motions: Array, turns: int, known: bool) -> Any | None:
    """Return the change d (p, p) of a scaled stiffness that frees its rigid motions, None without such motions.

    `weight` holds the rounding of each entry, `known` from its digits or the coarsest that there may be. The last
    `turns` motions are known to the digits of K only, and corrected.
    """
    rigid = _rigid_but_for_rounding(body, weight, motions, turns, known)
    if not rigid.shape[1]:
        return None
    most = MOST_ROUNDINGS * weight.max() * (1.0 if known else COARSEST_ROUNDINGS)
    # Most patterns admit the rotations as recognised, and then K + d has them to rounding.
    inexact = turns if rigid.shape[1] == motions.shape[1] else 0
    for corrected in (0, inexact) if inexact else (0,):
        change, left = _least_change(body, weight, rigid.copy(), corrected, most)
        allowed = _of_doubles(body, rigid) if corrected else EXACT * (abs(body) @ abs(rigid))
        if abs(change).max() <= most and np.all(abs(left) <= allowed):
            return change
    return None


def _least_change(body: Any, weight: Any, rigid: Array, turns: int, most: float) -> tuple[Any, Array]:
    """Return the least change (p, p) and the remaining forces (p, r); the last `turns` motions are corrected too.

    It is abandoned where an entry changes by more than `most`, or where the pattern does not admit the motions.
    """
    change, before = body * 0.0, np.inf
    for step in range(REFINEMENTS):
        left = _forces(body + change, rigid)
        nothing = 2 * EPS * (_of_doubles(body, rigid) / EXACT if turns else abs(body) @ abs(rigid))
        if np.all(abs(left) <= nothing) and _cost_nothing(body, rigid, left):
            break
        largest = float(np.max(abs(left)))
        if not turns and largest > before / 2:
            break
        before = largest
        damped = DAMPED if step < REFINEMENTS / 2 else 0.0
        more, moved = _LeastChange(body + change, weight, rigid, turns).change(-left, nothing, damped)
        change = sp.csr_matrix(change + more)
        rigid[:, rigid.shape[1] - turns :] += moved - rigid @ (rigid.T @ moved)
        if abs(change).max() > most:
            break
    return change, _forces(body + change, rigid)


def _cost_nothing(body: Any, rigid: Array, forces: Array) -> bool:
    """Return whether all combinations of motions (p, r) with these forces (p, r) have an energy below rounding."""
    energies, mix = np.linalg.eigh(rigid.T @ forces)
    size = abs(rigid @ mix)
    return bool(np.all(abs(energies) <= ROUNDED_ENERGY * np.sum(size * (abs(body) @ size), axis=0)))


def _rigid_but_for_rounding(body: Any, weight: Any, motions: Array, turns: int, known: bool) -> Array:
    """Return orthonormal motions (p, r) whose forces K z are those of lost digits, none where other causes are as
    likely.

    If all motions qualify they are returned as they are. Where no digits are known, the forces may come from
    inaccurately stated motions, which have energy. The last `turns` motions have only the digits of K.
    """
    kept = _independent(motions)
    energies, mix = np.linalg.eigh(kept.T @ (body @ kept))
    kept = kept @ mix[:, abs(energies) <= SOFT]
    forces, most = _forces(body, kept), INEXACT * (weight @ abs(kept)) + _of_doubles(body, kept)
    if turns:  # they displace unknowns that should not move
        most = most + INEXACT * weight.max() * _reach(body, kept)
    within = np.all(abs(forces) <= most, axis=0)
    kept, forces = kept[:, within], forces[:, within]
    size = abs(kept) * _of_doubles(body, kept)
    impossible = bool(np.any(np.sum(kept * forces, axis=0) < -np.sum(size, axis=0)))
    # No stiffness has negative energy. As inexact rotations cause elastic forces everywhere, translations decide.
    exact = motions[:, : motions.shape[1] - turns] if turns else kept
    if not impossible and not (known and _explained_by_lost_digits(body, weight, exact)):
        return np.zeros((len(kept), 0))
    return np.linalg.qr(motions)[0] if kept.shape[1] == motions.shape[1] else kept


def _explained_by_lost_digits(body: Any, weight: Any, motions: Array) -> bool:
    """Return whether the works z_j (K z)_j of motions (p, r) have random signs at many unknowns with lost digits."""
    work = motions * _forces(body, motions)
    felt = abs(work) > abs(motions) * _of_doubles(body, motions)
    rows = np.any(felt, axis=1)
    if np.mean(rows) < WIDESPREAD or np.mean(_all_digits(body[rows], weight[rows])) < ALL_DIGITS:
        return False
    irregular = abs(np.sum(work)) <= DEVIATIONS * np.sqrt(2 * np.sum(work**2))
    return bool(irregular and -np.sum(np.minimum(work, 0.0)) >= OTHER_SIGN * np.sum(abs(work)))


def _all_digits(body: Any, weight: Any) -> NDArray[np.bool_]:
    """Return for each entry whether its last digit, half a unit of which is in `weight`, is not zero."""
    units = np.round(body.data / (2 * weight.data))
    return np.asarray(units % 10 != 0)


def _independent(motions: Array, most: int | None = None) -> Array:
    """Return an orthonormal basis of the span of motions, of at most `most` columns."""
    basis, values, _ = np.linalg.svd(motions, full_matrices=False)
    kept: Array = basis[:, values > 1e-12 * np.max(values, initial=0.0)]
    return kept[:, :most]


def _forces(matrix: Any, motions: Array) -> Array:
    """Return K z for every column, summed in the longest floats of the machine."""
    rows = sp.csr_matrix(matrix)
    if not rows.nnz or not motions.shape[1]:
        return np.zeros_like(motions)
    products = rows.data.astype(np.longdouble)[:, None] * motions[rows.indices].astype(np.longdouble)
    forces = np.zeros(motions.shape, dtype=np.longdouble)
    filled = np.flatnonzero(np.diff(rows.indptr))
    forces[filled] = np.add.reduceat(products, rows.indptr[filled], axis=0)
    return np.asarray(forces, dtype=float)


def _of_doubles(matrix: Any, motions: Array) -> Array:
    """Bound the rounding errors of K z (p, q), by the products and by entries of z that should be zero."""
    return np.asarray(EXACT * (abs(matrix) @ abs(motions)) + ROUNDED_MOTION * _reach(matrix, motions))


def _reach(matrix: Any, motions: Array) -> Array:
    """Return the forces (p, q) that motions would make if all their entries were as large as the largest."""
    row: Array = np.asarray(abs(matrix).sum(axis=1), dtype=float).reshape(-1, 1)
    largest: Array = np.max(abs(motions), axis=0, initial=0.0)
    return row * largest


class _LeastChange:
    """The least change on the pattern of K that has given forces on motions Z (p, r).

    Its unknowns are y_ij = d_ij / w_ij for i <= j, and corrections x of the last motions in d Z + K x. The equations of
    unknown i are scaled to unit covariance.
    """

    def __init__(self, body: Any, weight: Any, motions: Array, turns: int) -> None:
        upper = sp.csr_matrix(sp.triu(weight, format="csr"))
        self._i = np.repeat(np.arange(upper.shape[0]), np.diff(upper.indptr))
        self._j = upper.indices
        self._weight = upper.data / np.max(upper.data)
        self._off_diagonal = self._i != self._j
        self._motions, self._upper, self._turns = motions, upper, turns
        self._body = TURNED * body
        size, count = motions.shape
        square = self._weight**2
        blocks = np.zeros((size, count, count))
        for mine, other, kept in ((self._i, self._j, slice(None)), (self._j, self._i, self._off_diagonal)):
            z = motions[other[kept]]
            np.add.at(blocks, mine[kept], square[kept, None, None] * z[:, :, None] * z[:, None, :])
        turned = np.arange(count - turns, count)
        blocks[:, turned, turned] += np.asarray(self._body.multiply(self._body).sum(axis=1)).reshape(-1, 1)
        values, vectors = np.linalg.eigh(blocks)
        kept = values > 1e-12 * values[:, -1:]
        self._whiten = (vectors * np.where(kept, 1 / np.sqrt(np.where(kept, values, 1.0)), 0.0)[:, None, :]).swapaxes(
            1, 2
        )

    def change(self, forces: Array, nothing: Array, damped: float) -> tuple[Any, Array]:
        """Return the least d and corrections x (p, turns) with d Z + K x = forces, up to errors `nothing` (p, r).

        LSQR is damped, so that components that roundings of the entries hardly change are left out.
        """
        from scipy.sparse.linalg import LinearOperator, lsqr

        shape = (self._motions.size, len(self._weight) + self._turns * len(self._motions))
        right = self._whitened(forces).ravel()
        if shape[0] <= FEW_EQUATIONS:
            y, x = self._parts(self._by_singular_values(right))
            return self._matrix(y), TURNED * x
        operator = LinearOperator(shape, matvec=self._forces, rmatvec=self._work, dtype=float)
        if not self._turns:
            found = lsqr(operator, right, atol=SOLVED, btol=SOLVED, iter_lim=MOST_STEPS)[0]
            return self._matrix(found), np.zeros((len(self._motions), 0))
        part = np.linalg.norm(self._whitened(nothing)) / np.linalg.norm(right)
        solved = float(np.clip(part / 64, SOLVED, HARDLY_SOLVED)) if damped else SOLVED
        damp = damped * EPS / self._upper.data.max()
        found = lsqr(operator, right, damp=damp, atol=EPS, btol=solved, conlim=0, iter_lim=MOST_STEPS)[0]
        y, x = self._parts(found)
        return self._matrix(y), TURNED * x

    def _by_singular_values(self, right: Array) -> Array:
        """Return the least unknowns for whitened forces (e,), without noise and components that the pattern does not
        admit.
        """
        left, values, unknowns = np.linalg.svd(self._dense(), full_matrices=False)
        asked = left.T @ right
        kept = (abs(asked) > NOISE) & (values > NO_ROOM * values[0])
        return np.asarray(unknowns.T[:, kept] @ (asked[kept] / values[kept]))

    def _dense(self) -> Array:
        """Return the matrix that maps the unknowns y, then x, to whitened forces."""
        z, whiten = self._motions, self._whiten
        (size, count), each, beside = z.shape, np.arange(len(self._weight)), self._off_diagonal
        changed = np.zeros((size, count, len(each)))
        for mine, other, kept in ((self._i, self._j, slice(None)), (self._j, self._i, beside)):
            felt = np.einsum("kab,kb->ka", whiten[mine[kept]], self._weight[kept, None] * z[other[kept]])
            changed[mine[kept], :, each[kept]] = felt
        turned = np.einsum("ij,iat->iajt", self._body.toarray(), whiten[:, :, count - self._turns :])
        return np.concatenate([changed, turned.reshape(size, count, -1)], axis=2).reshape(size * count, -1)

    def _parts(self, unknowns: Array) -> tuple[Array, Array]:
        y, x = np.split(unknowns.ravel(), [len(self._weight)])
        return y, x.reshape(len(self._motions), self._turns)

    def _matrix(self, y: Array) -> Any:
        upper = sp.csr_matrix((self._weight * y, self._upper.indices, self._upper.indptr), shape=self._upper.shape)
        return sp.csr_matrix(upper + sp.triu(upper, 1).T)

    def _whitened(self, forces: Array) -> Array:
        return np.asarray(np.einsum("ijk,ik->ij", self._whiten, forces))

    def _forces(self, unknowns: Array) -> Array:
        y, x = self._parts(unknowns)
        forces = self._matrix(y) @ self._motions
        forces[:, forces.shape[1] - self._turns :] += self._body @ x
        return self._whitened(forces).ravel()

    def _work(self, multiplier: Array) -> Array:
        m = np.einsum("ijk,ij->ik", self._whiten, multiplier.reshape(self._motions.shape))
        i, j, z = self._i, self._j, self._motions
        work = np.einsum("ij,ij->i", z[j], m[i])
        work[self._off_diagonal] += np.einsum("ij,ij->i", z[i[self._off_diagonal]], m[j[self._off_diagonal]])
        return np.append(self._weight * work, (self._body.T @ m[:, m.shape[1] - self._turns :]).ravel())
