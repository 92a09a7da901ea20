"""Every equilibrium of a small problem with Coulomb friction in the plane, by all combinations of contact states.

In y = (l, a), contact forces l_N and l_T, then forces of ties and coordinates of rigid motions, all scaled, with R x =
base + slope y the normal and tangential lengths of the contacts and H y = h the conditions of ties and balance, a
combination is

    open: l_N = l_T = 0    closed: N x = g    stick: T x = o    slip: l_T = s mu l_N,

and it is an answer where its signs hold: g - N x >= 0 where open, l_N >= 0 where closed, |l_T| <= mu l_N where it
sticks, s (T x - o) >= 0 where it slips. Where a system does not determine forces or motions, a linear program searches
a solution with the right signs. Every sign is measured relative to the lengths of its own contact, which may differ
from those of the others by orders of magnitude. Small singular values may be rounding errors of zero, so both cases are
tried.

Of a problem with the condensed compliance S^+, rigid motions Z and all rows R = [N; T; A],

    R x = R S^+ f - W l + R Z a,   W = R S^+ R',   Z'R'l = Z'f,   A x = b,

and each solution is refined on the problem in twice double precision, which also decides whether it is an equilibrium.
Above a critical coefficient of friction there may be none or several (Klarbring 1990).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from contactqp.certificate.certificate import holds
from contactqp.certificate.other_answers import DISPLACEMENT_ROUNDING
from contactqp.errors import Unsupported
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import FrictionalRows, condensed_frictional_rows
from contactqp.linalg.friction_states import answer_in
from contactqp.linalg.measures import parts
from contactqp.model.arrays import Array, Mask, Vector, refuse_late
from contactqp.model.coulomb import OPEN, STICK, Status, all_combinations
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# 4^8 systems take seconds.
MOST_CONTACTS = 8
# Systems solved at once.
BATCH = 4096
# Sweeps of equilibration; rows and columns shorter than this are rounding errors and are not scaled.
SWEEPS, SHORTEST = 3, 1e-10
# Relative singular values of an equilibrated system that are certainly nonzero, above the first, and certainly zero,
# below the second. Between them rounding of soft bodies' compliances does not allow a decision.
REGULAR, SINGULAR = 1e-8, 1e-15
# Signs that fail by less than this part of the contact's own lengths or force are decided by refinement.
DOUBTFUL = 1e-8
# Systems of at least this reciprocal condition are solved by their inverse, up to the second part of what is largest.
WELL_CONDITIONED, OF_INVERSES = 1e-6, 1e-8
# Sign conditions are infeasible if Farkas' weights prove a violation above the first part of their sizes, with a
# residual below the second.
PROVEN, OF_PROOFS = 1e-6, 1e-12
# Rounding errors of a sum relative to the sizes of its terms, and those of compliances.
ROUNDING_OF_SIZES = 1e-12


@dataclass(frozen=True, eq=False)
class Combinations:
    """All combinations of m contacts in the plane; q unknowns y, the first 2m of them l_N and l_T."""

    coefficient: Vector  # (m,) mu in scaled forces
    base: Vector  # (2m,) N x and T x without forces and motions
    slope: Array  # (2m, q)
    target: Vector  # (2m,) g and o
    fixed: Array  # (q - 2m, q) H
    fixed_right: Vector  # (q - 2m,) h
    nothing: float  # length below which values are rounding errors

    @cached_property
    def _lengths(self) -> Vector:
        """Return the sizes of the lengths of every row (2m,), the median of the others for a row without any."""
        size = abs(self.base) + abs(self.target) + self.nothing / DOUBTFUL
        return _filled(size, float(np.max(abs(self.fixed_right), initial=0.0)))

    @cached_property
    def _forces(self) -> Vector:
        """Return the forces that cause these lengths (2m,), or those that balance the bodies where nothing is
        compliant.
        """
        rows = np.arange(len(self.base))
        compliance = abs(self.slope[rows, rows])
        felt = compliance > ROUNDING_OF_SIZES * np.max(compliance, initial=0.0)
        asked = np.divide(self._lengths, compliance, out=np.zeros_like(self._lengths), where=felt)
        return _filled(np.maximum(asked, np.max(abs(self.fixed_right), initial=0.0)), 1.0)

    def plausible(self) -> Iterator[tuple[Status, Vector]]:
        """Yield the combinations (m,) and their y (q,) whose signs hold, or fail by rounding at most."""
        combinations = all_combinations(self.coefficient)
        while batch := list(itertools.islice(combinations, BATCH)):
            refuse_late("every combination of open, stick and slip was tried")
            yield from self._of_batch(np.array(batch, dtype=np.int8).reshape(len(batch), len(self.coefficient)))

    def _of_batch(self, status: Status) -> Iterator[tuple[Status, Vector]]:
        matrix, right = self._assembled(status)
        row, column = _equilibrated(matrix)
        doubtful = ~self._plainly_fail(status, matrix, right, row, column)
        status, matrix, right = status[doubtful], matrix[doubtful], right[doubtful]
        row, column = row[doubtful], column[doubtful]
        left, values, rotation = np.linalg.svd(row[:, :, None] * matrix * column[:, None, :])
        coordinates = np.einsum("bji,bj->bi", left, row * right)
        largest = values[:, :1] if values.shape[1] else np.ones((len(values), 1))
        least, most = (np.sum(values > part * largest, axis=1) for part in (REGULAR, SINGULAR))
        for extra in range(int(np.max(most - least, initial=-1)) + 1):
            rank = least + extra
            kept = np.arange(values.shape[1]) < np.minimum(rank, most)[:, None]
            inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
            y = column * np.einsum("bji,bj->bi", rotation, inverse * coordinates)
            missing = abs(np.einsum("bij,bj->bi", matrix, y) - right)
            rounding = ROUNDING_OF_SIZES * np.sum(abs(matrix), axis=2) * np.max(abs(y), axis=1, initial=0.0)[:, None]
            solved = np.all(missing <= DOUBTFUL * abs(right) + rounding + self.nothing, axis=1)
            bound = (rank == values.shape[1]) & ~self._all_hold(status, y)  # no free component can repair its signs
            for b in np.flatnonzero(solved & (rank <= most) & ~bound):
                refuse_late("every combination of open, stick and slip was tried")
                free = rotation[b, rank[b] :]
                if (found := self._with_signs(status[b], y[b], free, column[b])) is not None:
                    yield status[b], found

    def _plainly_fail(self, status: Status, matrix: Array, right: Vector, row: Array, column: Array) -> Mask:
        """Return which combinations (b, m) have regular systems whose one solution misses signs by more than rounding.

        This excludes most combinations by an inverse, at a tenth of the cost of singular values.

        Parameters
        ----------
        status : (b, m) states of the contacts
        matrix, right : (b, q, q), (b, q), their systems
        row, column : (b, q), factors that equilibrate them
        """
        scaled = row[:, :, None] * matrix * column[:, None, :]
        regular = np.linalg.det(scaled) != 0
        inverse = np.linalg.inv(np.where(regular[:, None, None], scaled, np.eye(scaled.shape[1])))
        sizes = [np.max(np.sum(abs(part), axis=2), axis=1, initial=0.0) for part in (scaled, inverse)]
        regular &= sizes[0] * sizes[1] < 1 / WELL_CONDITIONED
        z = np.einsum("bij,bj->bi", inverse, row * right)
        doubt = OF_INVERSES * np.max(abs(z), axis=1, initial=0.0)[:, None] * column
        return np.asarray(regular & ~self._all_hold(status, column * z, doubt))

    def _all_hold(self, status: Status, y: Array, doubt: Array | None = None) -> Mask:
        """Return which combinations (b, m) have solutions (b, q) that satisfy all signs of `_signs`.

        With an uncertainty `doubt` (b, q) of y, signs that may hold count as satisfied.
        """
        m, rounding = status.shape[1], ROUNDING_OF_SIZES * np.max(abs(y), axis=1, initial=0.0)[:, None]
        off = self.base - self.target + y @ self.slope.T
        least = -DOUBTFUL * self._lengths - rounding * np.sum(abs(self.slope), axis=1)
        if doubt is not None:
            least = least - doubt @ abs(self.slope).T
            rounding = rounding + np.max(doubt, axis=1, initial=0.0)[:, None]
        normal, tangential, of_forces = y[:, :m], y[:, m : 2 * m], DOUBTFUL * self._forces
        of_bound = self.coefficient * of_forces[:m] + of_forces[m:]
        room = self.coefficient * normal - abs(tangential)
        right = np.where(status == OPEN, -off[:, :m] >= least[:, :m], normal >= -of_forces[:m] - rounding)
        right &= (status != STICK) | (room >= -of_bound - rounding * (1.0 + self.coefficient))
        sliding = (abs(status) == 1) & (self.coefficient > 0)
        right &= ~sliding | (status * off[:, m:] >= least[:, m:])
        return np.asarray(np.all(right, axis=1))

    def _with_signs(self, status: Status, y: Vector, free: Array, scale: Vector) -> Vector | None:
        """Return one of the solutions y + scale free'c whose signs may hold, or None."""
        room, change, size = self._signs(status)
        if not _hold(room, change, size, y) and len(free):
            y = _within(room, change, size, y, free, scale)
        return y if _hold(room, change, size, y) else None

    def _assembled(self, status: Status) -> tuple[Array, Array]:
        """Return the systems (b, q, q), (b, q): a row for each normal and friction force, then the rows of H."""
        (count, m), q = status.shape, self.slope.shape[1]
        unit = np.eye(q)
        closed, stuck = status != OPEN, status == STICK
        sliding = np.where(stuck, 0, status) * self.coefficient
        matrix, right = np.empty((count, q, q)), np.zeros((count, q))
        matrix[:, :m] = np.where(closed[:, :, None], self.slope[:m], unit[:m])
        matrix[:, m : 2 * m] = np.where(
            stuck[:, :, None], self.slope[m:], unit[m : 2 * m] - sliding[:, :, None] * unit[:m]
        )
        matrix[:, 2 * m :], right[:, 2 * m :] = self.fixed, self.fixed_right
        lengths = self.target - self.base
        right[:, :m] = np.where(closed, lengths[:m], 0.0)
        right[:, m : 2 * m] = np.where(stuck, lengths[m:], 0.0)
        return matrix, right

    def _signs(self, status: Status) -> tuple[Vector, Array, Vector]:
        """Return room, slope in y and size of the sign conditions, which hold where room + slope y >= 0."""
        m, unit = len(status), np.eye(self.slope.shape[1])
        off = self.base - self.target
        opened, closed, stuck = (np.flatnonzero(mask) for mask in (status == OPEN, status != OPEN, status == STICK))
        sliding = np.flatnonzero((abs(status) == 1) & (self.coefficient > 0))
        bound, sign = self.coefficient[stuck, None] * unit[stuck], status[sliding].astype(float)
        room = [-off[opened], np.zeros(len(closed)), np.zeros(2 * len(stuck)), sign * off[m + sliding]]
        slope = [-self.slope[opened], unit[closed], bound - unit[m + stuck], bound + unit[m + stuck]]
        bound_size = self.coefficient[stuck] * self._forces[stuck] + self._forces[m + stuck]
        size = [self._lengths[opened], self._forces[closed], bound_size, bound_size, self._lengths[m + sliding]]
        return (
            np.concatenate(room),
            np.vstack([*slope, sign[:, None] * self.slope[m + sliding]]),
            np.concatenate(size),
        )


def _hold(room: Vector, change: Array, size: Vector, y: Vector) -> bool:
    rounding = ROUNDING_OF_SIZES * np.sum(abs(change), axis=1) * np.max(abs(y), initial=0.0)
    return bool(np.all(room + change @ y >= -DOUBTFUL * size - rounding))


def _within(room: Vector, change: Array, size: Vector, start: Vector, free: Array, scale: Vector) -> Vector:
    """Return the solution start + scale free'c that maximises the least margin of the signs, each limited to its size.

    Coefficients that are rounding errors of the orthonormal directions (c, q) are set to zero, as bodies would
    otherwise move arbitrarily far.
    """
    from scipy.optimize import linprog

    count, slope = len(free), change @ (scale * free).T
    slope[abs(slope) <= ROUNDING_OF_SIZES * (abs(change) @ scale)[:, None]] = 0.0
    moving = np.any(abs(slope) > ROUNDING_OF_SIZES * np.max(abs(slope), initial=0.0), axis=1)
    step = float(np.median(size[moving])) if np.any(moving) else 1.0
    rows, rest = np.column_stack([-slope * (step / size)[:, None], np.ones(len(room))]), (room + change @ start) / size
    if not (np.all(np.isfinite(rows)) and np.all(np.isfinite(rest))):
        return start
    if _proven_to_fail(rows[:, :-1], rest):
        return start
    answer = linprog(
        np.append(np.zeros(count), -1.0),
        A_ub=rows,
        b_ub=rest,
        bounds=[(None, None)] * count + [(None, 1.0)],
        method="highs",
    )
    return start if answer.x is None else np.asarray(start + step * scale * (free.T @ answer.x[:-1]))


def _proven_to_fail(rows: Array, rest: Vector) -> bool:
    """Return whether weights w >= 0 prove that rows c <= rest fails for every c: rows'w = 0 and rest'w < 0 (Farkas).

    Weights of sum one bound the violation for the best c. Most linear programs are avoided by this test, at a tenth of
    their cost.
    """
    from scipy.optimize import nnls

    try:
        weight, _ = nnls(np.vstack([rows.T, rest]), np.append(np.zeros(rows.shape[1]), -1.0))
    except (RuntimeError, np.linalg.LinAlgError):  # too many steps, or SciPy before 1.15 met a singular system
        return False
    total = float(np.sum(weight))
    left = np.max(abs(rows.T @ weight), initial=0.0)
    return bool(total > 0 and rest @ weight < -PROVEN * total and left <= OF_PROOFS * total)


def _filled(size: Vector, other: float) -> Vector:
    """Return sizes with the median of the others in place of zeros; `other` where all are zero."""
    known = size[size > 0]
    return np.where(size > 0, size, float(np.median(known)) if len(known) else other or 1.0)


def separate_parts(problem: ContactProblem) -> Iterator[tuple[ContactProblem, str]]:
    """Yield the problems of bodies that neither contacts nor ties join to others, with the names of their contacts."""
    part, K = parts(problem), problem.stiffness_rows
    for one in range(int(part.max(initial=-1)) + 1):
        of = np.flatnonzero(part == one)
        kept, ties = (np.flatnonzero(np.diff(rows[:, of].tocsr().indptr)) for rows in (problem.normal, problem.tie))
        if not kept.size:
            continue
        data = {name: getattr(problem, name)[kept] for name in ("gap", "friction", "slip_origin")}
        data |= {name: getattr(problem, name)[kept][:, of] for name in ("normal", "tangent")}
        data |= {"tie": problem.tie[ties][:, of], "tie_value": problem.tie_value[ties], "load": problem.load[of]}
        names = ", ".join(problem.contact_name(int(i)) for i in kept)
        yield ContactProblem(stiffness=K[of][:, of], **data), names


def refuse_many(contacts: int) -> str | None:
    """Return the reason why a problem has too many combinations, or None."""
    if contacts <= MOST_CONTACTS:
        return None
    return f"enumeration: {contacts} contacts; at most {MOST_CONTACTS} have few combinations enough"


def _equilibrated(matrix: Array) -> tuple[Array, Array]:
    """Return factors of rows and columns (b, q) that bring their largest entries near one (Ruiz 2001).

    Otherwise the compliance of a soft body makes the system of a much stiffer one appear singular.
    """
    row, column = np.ones(matrix.shape[:2]), np.ones(matrix.shape[:2])
    for _ in range(SWEEPS):
        size = abs(row[:, :, None] * matrix * column[:, None, :])
        for factor, axis in ((row, 2), (column, 1)):
            length = np.max(size, axis=axis, initial=0.0)
            factor /= np.sqrt(np.where(length > SHORTEST, length, 1.0))
    return row, column


# Displacements are equal if the contacts' displacements agree to this part of the lengths that meet there.
SAME_DISPLACEMENT = 1e-8


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """One equilibrium, and the combination that it was found in."""

    status: Status  # (m,) of OPEN, STICK, SLIP_BACK, SLIP_ON
    answer: Answer


def all_equilibria(problem: ContactProblem, condensation: Condensation) -> tuple[Equilibrium, ...]:
    """Return every equilibrium that differs from the others in its displacement; an empty tuple if there is none.

    With redundant contacts, one of the many possible distributions of forces is returned.

    Raises Unsupported: there are more than eight contacts.
    """
    if (reason := refuse_many(problem.contacts)) is not None:
        raise Unsupported(reason)
    rows = condensed_frictional_rows(problem, condensation)
    found: list[Equilibrium] = []
    for status, start in _Systems(problem, condensation, rows).plausible():
        answer = answer_in(problem, condensation, rows, status, _least_ties(rows, start))
        if holds(problem, answer) and not any(_same(problem, answer, other.answer) for other in found):
            found.append(Equilibrium(status, answer))
    return tuple(found)


def _least_ties(rows: FrictionalRows, start: Answer) -> Answer:
    """Return the start with the least forces of dependent ties, as refinement does not change their distribution."""
    if len(rows.tie) < 2 or not np.all(np.isfinite(start.tie_force)):
        return start
    pulled = rows.tie.T @ (start.tie_force * rows.tie_length)
    return replace(start, tie_force=np.linalg.lstsq(rows.tie.T, pulled, rcond=None)[0] / rows.tie_length)


def _same(problem: ContactProblem, one: Answer, other: Answer) -> bool:
    """Return whether two displacements move every contact alike, each in the lengths that meet there."""
    weight = np.sqrt(np.where(problem.diagonal > 0, problem.diagonal, np.max(problem.diagonal) or 1.0))
    largest = np.maximum(abs(one.displacement), abs(other.displacement))
    size = SAME_DISPLACEMENT * largest + DISPLACEMENT_ROUNDING * np.max(weight * largest, initial=0.0) / weight
    rows = [problem.normal]
    if problem.tangent is not None and problem.friction is not None:
        rows.append(problem.tangent[problem.friction > 0])  # in the plane, one row a contact
    difference = one.displacement - other.displacement
    return all(bool(np.all(abs(row @ difference) <= abs(row) @ size)) for row in rows)


class _Systems:
    """The systems of the combinations of one problem, and the displacement for given forces and motions."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, rows: FrictionalRows) -> None:
        self._condensation, self._rows = condensation, rows
        load, self._inner = condensation.reduce_load(problem.load)
        load = load * rows.scale
        self._m, R = problem.contacts, rows.all_rows
        self._free = rows.compliance @ load
        # R x = base + slope y.
        base, slope = R @ self._free, np.hstack([-R @ rows.compliance @ R.T, R @ rows.motions])
        target, drive = np.concatenate(rows.lengths(problem)), rows.motions.T @ load
        balance = np.hstack([(R @ rows.motions).T, np.zeros((rows.motions.shape[1],) * 2)])
        of_contacts, tied = slice(2 * self._m), slice(2 * self._m, None)
        self._combinations = Combinations(
            coefficient=rows.coefficient,
            base=base[of_contacts],
            slope=slope[of_contacts],
            target=target[of_contacts],
            fixed=np.vstack([slope[tied], balance]),
            fixed_right=np.concatenate([(target - base)[tied], drive]),
            nothing=DISPLACEMENT_ROUNDING * max(float(np.max(abs(part), initial=0.0)) for part in (base, drive)),
        )

    def plausible(self) -> Iterator[tuple[Status, Answer]]:
        """Yield the combinations whose signs hold, or fail by rounding at most."""
        for status, y in self._combinations.plausible():
            yield status, self._answer(y)

    def _answer(self, y: Vector) -> Answer:
        rows, m = self._rows, self._m
        forces, motion = np.split(y, [len(rows.all_rows)])
        x = self._free - rows.compliance @ rows.all_rows.T @ forces + rows.motions @ motion
        lengths: tuple[Array, ...] = (rows.normal_length, rows.tangent_length, rows.tie_length)
        normal, friction, tie = (
            force / length for force, length in zip(np.split(forces, [m, 2 * m]), lengths, strict=True)
        )
        return Answer(self._condensation.expand(x * rows.scale, self._inner), normal, friction[:, None], tie)
