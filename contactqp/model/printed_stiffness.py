"""Free bodies whose stiffness was printed: K z of a rigid motion z is the rounding of the digits, and is taken away.

A matrix that went through a file keeps six to twelve digits of every entry, and a motion z that should cost nothing
meets the forces K z that the lost digits make: springs of either sign that hold or drive the body. Where motions are
rigid but for that, K + d takes the place of K, d being the least change on the pattern of K with

    (K + d) Z = 0,    d = d',    sum_ij (d_ij / w_ij)^2 = min,    w_ij the rounding of K_ij.

a least-squares problem of as many equations as there are unknowns times motions, solved by singular values, or by LSQR
where there are many, and refined. Turns that were recognised are known to the digits of K only, and corrected with it:
K + d on a pattern with zeros has no others.

A motion is stated by the user, or recognised: K has few decimal digits, and the motion is among those of least energy.
It is taken for rigid only if K z is nowhere more than lost digits make, is there at many unknowns, where entries of K
have as many digits as any has, and has signs that follow no rule: a spring or a soft bed that holds the body has not,
and stays what it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.model.arrays import EPS, Array, Indices

# Forces K z beneath this part of |K||z| are the rounding of doubles: the matrix was not printed.
EXACT = 256 * EPS
# Motions come from singular vectors: every entry carries so much of the largest.
ROUNDED_MOTION = 16 * EPS
# The rounding of entries, relative, where digits cannot be counted: some unit was changed after they were printed.
COARSEST = 1e-6
# Energies of motions, K scaled to unit diagonal, that are looked at.
SOFT = 1e-4
# The part of the unknowns at which lost digits show, at least.
WIDESPREAD = 0.25
# Forces K z of so many roundings of the entries: a motion that is itself known to the digits of K has a few.
INEXACT = 8.0
# The part of the entries, in the rows where forces K z are felt, that have all the digits of K, at least: of printed
# ones nine in ten have. Entries with fewer are exact, and their sums are.
ALL_DIGITS = 0.5
# Standard deviations beyond which the energy of a motion is no sum of roundings.
DEVIATIONS = 4.0
# Springs push back where they are moved to: of the work z_j (K z)_j of lost digits this part has the other sign.
OTHER_SIGN = 0.01
# Decimal digits of a printed matrix, at least and at most, and entries that are looked at first. Fewer are those of
# whole numbers, which are exact: what half a digit of theirs would be holds or drives anything.
FEWEST_DIGITS, MOST_DIGITS, LOOKED_AT = 4, 12, 64
# A change of so many roundings of the largest entries, the diagonal being one, is no rounding of them.
MOST_ROUNDINGS, COARSEST_ROUNDINGS = 2.0, 16.0
# Entries of a single motion that are so near to 0, 1 or -1 are that.
SNAPPED = 1e-3
# Rotations beside so many translations: of a beam, in the plane, in space.
TURNS = {1: 1, 2: 1, 3: 3}
# Unknowns up to which motions are looked for that nobody stated.
RECOGNISED_UP_TO = 20_000
# Unknowns up to which all motions of a body are found by a dense eigenvalue problem.
DENSE = 600
# Motions of one body that are looked for; rigid ones are six at most, mechanisms may be more.
MOST_MOTIONS = 12
# What it costs to correct a turn, beside the rounding of the largest entries: next to nothing.
TURNED = 10.0
# Refinements of the change; those by LSQR to a part between these, and its steps.
REFINEMENTS, SOLVED, HARDLY_SOLVED, MOST_STEPS = 8, 1e-8, 0.1, 1000
# The first half of those by LSQR are damped, so that noise changes nothing; what they leave of the energy of turns
# falls by a tenth a refinement only, and the others are not.
DAMPED = 4.0
# Equations up to which the change is found by singular values: LSQR takes hundreds of steps for what turns lack.
FEW_EQUATIONS = 700
# Forces K z of motions of length one, K of unit diagonal, that are rounding of their sums; and the singular value, of
# the largest, that is: the correction of a turn comes in by its product with the change, a rounding of few digits.
NOISE, NO_ROOM = EPS / 8, 1e-13
# The energy z'(K + d)z that half a rounding of every entry makes of a rigid motion, as a part of |z|'|K||z|: beyond
# twice that (`contactqp.linalg.factorization.RIGID_ENERGY`) a motion is not taken for rigid.
ROUNDED_ENERGY = EPS / 2


@dataclass(frozen=True, eq=False)
class Cleared:
    """A stiffness without the rounding of its digits along rigid motions."""

    stiffness: Any  # (n, n) CSR
    change: float  # max |d_ij| / sqrt(K_ii K_jj)


def clear_of_printing(stiffness: Any, stated: Array | None) -> Cleared | None:
    """Return K (n, n; CSR) without what lost digits make of its rigid motions; None where there is nothing to change.

    Parameters
    ----------
    stiffness : CSR matrix
    stated : (n, q) array, optional
        Motions that may be rigid; without them they are recognised where K has few digits.
    """
    roundings = []
    exact = stated is None and _whole(stiffness.data)
    if (digits := None if exact else _rounding_of_digits(stiffness)) is not None:
        roundings.append(digits)
    if stated is not None and _noisy(stiffness, stated):
        roundings.append(COARSEST * abs(stiffness))
    if not roundings or (stated is None and stiffness.shape[0] > RECOGNISED_UP_TO):
        return None
    root = np.sqrt(np.where(stiffness.diagonal() > 0, stiffness.diagonal(), 1.0))
    scale: Array = np.exp2(-np.round(np.log2(root)))  # powers of two scale without rounding
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
    """Return whether forces K z beyond rounding act at many unknowns, as lost digits make them; supports act at few."""
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
    """Return half a unit of the last printed digit of each entry, on the pattern of K; None where digits are few or
    all.

    Digits are counted from the first of each entry, or, where all have as many after the point, from there.
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
    """Return how many places after the point entries have at most; None where they have none or too many."""
    for places in range(1, MOST_DIGITS + 1):
        if np.max(entries) * 10.0**places > 1 / EPS:
            return None
        if np.all(abs(np.round(entries * 10.0**places) / 10.0**places - entries) <= 4 * EPS * entries):
            return places
    return None


def _recognised(body: Any, weight: Any, scale: Array) -> tuple[Array, int]:
    """Return motions (p, q) of a body that only lost digits resist, and how many of the last ones are rotations.

    Translations come first and are exact.
    """
    translations = _translations(body, weight, scale)
    if not translations.shape[1] and body.shape[0] > DENSE:
        return translations, 0  # hardly anything else is rigid, and to find out may cost more than to solve
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
    # Unknowns that all move one way turn nowhere: what else they do is that of parts on soft springs.
    one_way = translations.shape[1] == 1 and bool(np.all(translations))
    if count > (0 if one_way else TURNS.get(basis.shape[1], 0)):
        return lowest[:, :0], 0  # translations that are not known well enough to say which loads drive them
    turns = _independent(lowest - basis @ (basis.T @ lowest), count)
    return np.column_stack([basis, turns]), turns.shape[1]


def _translations(body: Any, weight: Any, scale: Array) -> Array:
    """Return translations (p, q) that only lost digits resist, whether unknowns stand node by node or axis by axis."""
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
    """Return the motions (p, q) whose energy is next to nothing, of either sign."""
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
    """Return the change d (p, p) of a scaled stiffness after which rigid motions take no force; None without such
    motions.

    `weight` holds the rounding of each entry, `known` from its digits or the coarsest that there may be. The last
    `turns` motions are known to the digits of K only, and corrected.
    """
    rigid = _rigid_but_for_rounding(body, weight, motions, turns, known)
    if not rigid.shape[1]:
        return None
    most = MOST_ROUNDINGS * weight.max() * (1.0 if known else COARSEST_ROUNDINGS)
    # Most patterns have room for the turns as they were recognised, and then K + d has them to rounding.
    inexact = turns if rigid.shape[1] == motions.shape[1] else 0
    for corrected in (0, inexact) if inexact else (0,):
        change, left = _least_change(body, weight, rigid.copy(), corrected, most)
        allowed = _of_doubles(body, rigid) if corrected else EXACT * (abs(body) @ abs(rigid))
        if abs(change).max() <= most and np.all(abs(left) <= allowed):
            return change
    return None


def _least_change(body: Any, weight: Any, rigid: Array, turns: int, most: float) -> tuple[Any, Array]:
    """Return the least change (p, p) and the forces (p, r) that are left; the last `turns` motions are corrected too.

    Given up where an entry changes by more than `most`, or where the pattern has no room for the motions as they are.
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
    """Return whether no combination of motions (p, r) with these forces (p, r) has more than a rounding's energy."""
    energies, mix = np.linalg.eigh(rigid.T @ forces)
    size = abs(rigid @ mix)
    return bool(np.all(abs(energies) <= ROUNDED_ENERGY * np.sum(size * (abs(body) @ size), axis=0)))


def _rigid_but_for_rounding(body: Any, weight: Any, motions: Array, turns: int, known: bool) -> Array:
    """Return orthonormal motions (p, r) whose forces K z are those of lost digits; none where other forces are as
    likely.

    The motions themselves, one after another, where all of them are. Where no digits are known, the forces may be those
    of motions that were stated roughly: these cost energy. The last `turns` motions are known to the digits of K only.
    """
    kept = _independent(motions)
    energies, mix = np.linalg.eigh(kept.T @ (body @ kept))
    kept = kept @ mix[:, abs(energies) <= SOFT]
    forces, most = _forces(body, kept), INEXACT * (weight @ abs(kept)) + _of_doubles(body, kept)
    if turns:  # they move what they should leave in place
        most = most + INEXACT * weight.max() * _reach(body, kept)
    within = np.all(abs(forces) <= most, axis=0)
    kept, forces = kept[:, within], forces[:, within]
    size = abs(kept) * _of_doubles(body, kept)
    impossible = bool(np.any(np.sum(kept * forces, axis=0) < -np.sum(size, axis=0)))
    # A negative energy is no stiffness's. Turns that are inexact meet elastic forces everywhere: translations tell.
    exact = motions[:, : motions.shape[1] - turns] if turns else kept
    if not impossible and not (known and _of_lost_digits(body, weight, exact)):
        return np.zeros((len(kept), 0))
    return np.linalg.qr(motions)[0] if kept.shape[1] == motions.shape[1] else kept


def _of_lost_digits(body: Any, weight: Any, motions: Array) -> bool:
    """Return whether the works z_j (K z)_j of motions (p, r) act at many unknowns with signs that follow no rule, and
    where entries have lost digits.
    """
    work = motions * _forces(body, motions)
    felt = abs(work) > abs(motions) * _of_doubles(body, motions)
    rows = np.any(felt, axis=1)
    if np.mean(rows) < WIDESPREAD or np.mean(_all_digits(body[rows], weight[rows])) < ALL_DIGITS:
        return False
    irregular = abs(np.sum(work)) <= DEVIATIONS * np.sqrt(2 * np.sum(work**2))
    return bool(irregular and -np.sum(np.minimum(work, 0.0)) >= OTHER_SIGN * np.sum(abs(work)))


def _all_digits(body: Any, weight: Any) -> NDArray[np.bool_]:
    """Return for each entry whether its last digit, of which `weight` holds half a unit, is no zero."""
    units = np.round(body.data / (2 * weight.data))
    return np.asarray(units % 10 != 0)


def _independent(motions: Array, most: int | None = None) -> Array:
    """Return an orthonormal basis of the span of motions, of at most so many columns."""
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
    """Bound the forces K z (p, q) that doubles make by rounding: the products, and entries of z that should be zero."""
    return np.asarray(EXACT * (abs(matrix) @ abs(motions)) + ROUNDED_MOTION * _reach(matrix, motions))


def _reach(matrix: Any, motions: Array) -> Array:
    """Return the forces (p, q) that motions would make if all their entries were as large as the largest."""
    row: Array = np.asarray(abs(matrix).sum(axis=1), dtype=float).reshape(-1, 1)
    largest: Array = np.max(abs(motions), axis=0, initial=0.0)
    return row * largest


class _LeastChange:
    """The least change on the pattern of K that has given forces on motions Z (p, r).

    Its unknowns are y_ij = d_ij / w_ij for i <= j, and corrections x of the last motions, d Z + K x: by so many
    roundings as K has. The equations of unknown i are scaled to unit covariance.
    """

    def __init__(self, body: Any, weight: Any, motions: Array, turns: int) -> None:
        upper = sp.csr_matrix(sp.triu(weight, format="csr"))
        self._i = np.repeat(np.arange(upper.shape[0]), np.diff(upper.indptr))
        self._j = upper.indices
        self._weight = upper.data / np.max(upper.data)
        self._beside = self._i != self._j
        self._motions, self._upper, self._turns = motions, upper, turns
        self._body = TURNED * body
        size, count = motions.shape
        square = self._weight**2
        blocks = np.zeros((size, count, count))
        for mine, other, kept in ((self._i, self._j, slice(None)), (self._j, self._i, self._beside)):
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
        """Return the least d and corrections x (p, turns) with d Z + K x = forces (p, r), up to what is nothing (p, r).

        By LSQR, what a rounding of the entries changes by less than `damped` of that of doubles is not asked for.
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
        """Return the least unknowns for whitened forces (e,), without noise and what the pattern cannot take."""
        left, values, unknowns = np.linalg.svd(self._dense(), full_matrices=False)
        asked = left.T @ right
        kept = (abs(asked) > NOISE) & (values > NO_ROOM * values[0])
        return np.asarray(unknowns.T[:, kept] @ (asked[kept] / values[kept]))

    def _dense(self) -> Array:
        """Return the matrix that maps the unknowns y, then x, to whitened forces."""
        z, whiten = self._motions, self._whiten
        (size, count), each, beside = z.shape, np.arange(len(self._weight)), self._beside
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
        work[self._beside] += np.einsum("ij,ij->i", z[i[self._beside]], m[j[self._beside]])
        return np.append(self._weight * work, (self._body.T @ m[:, m.shape[1] - self._turns :]).ravel())
