"""Find out cheaply whether a frictional answer is the only one, and whether its forces are.

Forces: with E_c the normal rows of closed contacts (those that slip with their friction along, E_N + mu E_T'd), E_b the
tangential rows of those that stick and A the ties, contact forces that balance a displacement are unique where no
combination of these rows but one of ties alone vanishes.
Displacements: `contactqp.critical_friction` where the answer is the only one at every load; at this load, in the
plane and with few contacts, the answers of all combinations of open, stick and slip are counted.

Each combination is a linear system in the contact forces l and joints j (`contactqp.linalg.delassus`), and an
answer where its signs hold. Answers are told apart by how the contacts move: normal rows, and tangential ones where
there is friction. Signs and motions are measured contact by contact, against the lengths that meet there: a contact
that is far, or has slipped far, hides no answer at another. Where a system leaves something free that moves contacts, a
linear program decides whether signs can hold; if they can, there is a family of answers. `contactqp.equilibria` refines
each of them; here they are counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.critical_friction import (
    LARGEST_RATIO,
    SINGULAR_SYSTEM,
    CriticalFriction,
    combinations,
    critical,
    regular,
    system_matrices,
    too_many,
)
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import contact_compliance
from contactqp.linalg.iteration import Systems, systems_of
from contactqp.linalg.measures import directions, lengths
from contactqp.linalg.nonnegative import DEPENDENT_ROWS
from contactqp.model.arrays import Array, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, STICK
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Violations

# Contacts with friction up to which bounds are looked for in every answer to a case: less than half of its solution.
MOST_PROVEN = 200
# 4^5 systems take some ten milliseconds.
MOST_COUNTED = 5
# Each system that leaves something free takes some linear programs.
MOST_LOOSE = 30
# Signs that fail by this part of the lengths that meet at their contact, or of its force, may be rounding.
DOUBTFUL = 1e-9
# Answers that are there only by more than this part are not sure to be others: friction is near its limit.
SURE = 1e-13
# Of the largest force, what rounding may leave of another.
ROUNDING = 1e-13
# Of the largest displacement that the loads make without contacts, what rounding may leave of another.
NOTHING = 1e-12
# Answers whose forces move every contact alike, to this part of what the forces make of it, are one.
SAME = 1e-6


def proves_friction(problem: ContactProblem) -> bool:
    """Return whether bounds with friction take less than half of the solution: of few contacts that are condensed."""
    return problem.frictional and problem.contacts <= MOST_PROVEN and systems_of(problem) is Systems.CONDENSED


def several_answers(problem: ContactProblem, condensation: Condensation) -> bool | None:
    """Return whether more than one answer exists, or a family of them; it is computed once for a problem.

    None where too many systems leave something free, where their signs are beyond the range of doubles, or where the
    others are there by an allowance for rounding alone.
    """
    of = (problem.load, problem.gap, problem.tie_value, problem.friction, problem.slip_origin)
    cached = problem._computed.several_answers
    if cached is None or any(mine is not other for mine, other in zip(of, cached[0], strict=True)):
        several = _several_answers(problem, condensation, DOUBTFUL)
        if several and not _several_answers(problem, condensation, SURE):
            several = None
        cached = problem._computed.several_answers = of, several
    found: bool | None = cached[1]
    return found


def _several_answers(problem: ContactProblem, condensation: Condensation, doubtful: float) -> bool | None:
    system = _Systems(problem, condensation, doubtful)
    status = combinations(system.mu)
    matrices, right = system.assembled(status)
    singular = ~regular(matrices)
    y = np.zeros_like(right)
    y[~singular] = np.linalg.solve(matrices[~singular], right[~singular][:, :, None])[:, :, 0]
    found = [y[b] for b in np.flatnonzero(~singular & system.holds(status, y))]
    loose = []
    for b in np.flatnonzero(singular):
        y[b], free = _least(matrices[b], right[b])
        sizes = abs(right[b]) + abs(matrices[b]) @ abs(y[b])
        rounding = system.nothing + ROUNDING * abs(y[b]).max(initial=0.0)
        if np.any(abs(matrices[b] @ y[b] - right[b]) > doubtful * sizes + rounding):
            continue
        if len(free):
            signs = _Signs(system, status[b], y[b], free)
            if signs.may_hold:
                loose.append(signs)
        elif system.holds(status[b : b + 1], y[b : b + 1])[0]:
            found.append(y[b])
    if len(loose) > MOST_LOOSE:
        return None
    for signs in loose:
        if (extremes := signs.extremes()) is None:
            return None
        found += extremes
    return any(system.differ(one, found[0]) for one in found[1:])


def _least(matrix: Array, right: Vector) -> tuple[Vector, Array]:
    """Return the least-squares solution of least norm, and the directions (k, q) of the null space."""
    left, values, rotation = np.linalg.svd(matrix)
    kept = values > SINGULAR_SYSTEM * values[0]
    return rotation[kept].T @ ((left.T @ right)[kept] / values[kept]), rotation[~kept]


class _Systems:
    """The linear systems of all combinations in y = (l, j); signs may fail by a doubtful part of what meets."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, doubtful: float) -> None:
        self.doubtful = doubtful
        compliance = contact_compliance(problem, condensation)
        if problem.friction is None or problem.slip_origin is None:
            raise ValueError("answers are counted with friction only")
        self.mu = problem.friction
        self._W, self._V, self._J = compliance.W, compliance.V, compliance.J
        free, self._held = compliance.free(problem, condensation)
        limits = np.stack([problem.gap, problem.slip_origin[:, 0]], axis=1) / compliance.scale[:, None]
        self._room = (limits.ravel() - free).reshape(-1, 2)  # of gap and slip without forces
        self._given = (abs(limits).ravel() + abs(free)).reshape(-1, 2)
        self.nothing = NOTHING * max(float(abs(part).max(initial=0.0)) for part in (free, self._held))
        self._compliance = np.diagonal(self._W).reshape(-1, 2)
        self._slope = -np.hstack([self._W, self._V])
        self._acting_rows = np.repeat(self.mu > 0, 2)
        self._acting_rows[::2] = True
        self._felt = self._slope[self._acting_rows]

    def assembled(self, status: NDArray[np.int8]) -> tuple[Array, Array]:
        """Return the matrices (c, q, q) and right-hand sides (c, q) of combinations (c, m)."""
        m, joints = len(self.mu), len(self._J)
        matrices = np.zeros((len(status), 2 * m + joints, 2 * m + joints))
        right = np.zeros(matrices.shape[:2])
        matrices[:, : 2 * m, : 2 * m] = system_matrices(self._W, self.mu, status)
        closed = np.stack([status != OPEN, status == STICK], axis=2).reshape(len(status), 2 * m)
        matrices[:, : 2 * m, 2 * m :] = np.where(closed[:, :, None], self._V, 0.0)
        right[:, : 2 * m] = np.where(closed, -self._room.ravel(), 0.0)
        matrices[:, 2 * m :, : 2 * m], matrices[:, 2 * m :, 2 * m :] = self._V.T, self._J
        right[:, 2 * m :] = self._held
        return matrices, right

    def holds(self, status: NDArray[np.int8], y: Array) -> Mask:
        """Return which solutions (c, q) have the signs of their combination (c, m)."""
        m = len(self.mu)
        force = y[:, : 2 * m].reshape(len(y), m, 2)
        room = self._room - (y @ self._slope.T).reshape(force.shape)
        gap, slip = room[:, :, 0], -room[:, :, 1]
        length, pushed = self._allowed(y)
        opened, stuck = status == OPEN, status == STICK
        right = np.where(opened, gap >= -length[:, :, 0], force[:, :, 0] >= -pushed[:, :, 0])
        bound = self.mu * (force[:, :, 0] + pushed[:, :, 0]) + pushed[:, :, 1]
        right &= np.where(stuck, abs(force[:, :, 1]) <= bound, True)
        right &= np.where(opened | stuck | (self.mu == 0), True, status * slip >= -length[:, :, 1])
        return np.asarray(np.all(right, axis=1))

    def _allowed(self, y: Array) -> tuple[Array, Array]:
        """Return how far lengths and forces of solutions (c, q) may miss their signs by rounding, (c, m, 2) each."""
        meeting = self._given + self.nothing / self.doubtful + (abs(y) @ abs(self._slope).T).reshape(len(y), -1, 2)
        largest = np.max(abs(y), axis=1, initial=0.0)[:, None, None]
        compliance = np.broadcast_to(self._compliance, meeting.shape)
        felt = compliance > SINGULAR_SYSTEM * compliance.max(initial=0.0)
        asked = np.divide(meeting, compliance, out=np.broadcast_to(largest, meeting.shape).copy(), where=felt)
        return self.doubtful * meeting, self.doubtful * asked + ROUNDING * largest

    def _by_state(self, status: NDArray[np.int8]) -> Iterator[Indices]:
        """Yield the open, the closed and the sticking contacts, and those that slide against friction."""
        for mask in (status == OPEN, status != OPEN, status == STICK, (abs(status) == 1) & (self.mu > 0)):
            yield np.flatnonzero(mask)

    def sizes(self, status: NDArray[np.int8], y: Vector) -> Vector:
        """Return by how much every row of `signs` may fail in a solution (q,)."""
        length, pushed = (part[0] for part in self._allowed(y[None]))
        opened, closed, stuck, sliding = self._by_state(status)
        bound = self.mu[stuck] * pushed[stuck, 0] + pushed[stuck, 1]
        return np.concatenate([length[opened, 0], pushed[closed, 0], bound, bound, length[sliding, 1]])

    def signs(self, status: NDArray[np.int8]) -> tuple[Vector, Array]:
        """Return room and its slope in y: the signs hold where room + slope y >= 0."""
        m, unit = len(self.mu), np.eye(self._slope.shape[1])
        opened, closed, stuck, sliding = self._by_state(status)
        sign, bound = status[sliding].astype(float), self.mu[stuck, None] * unit[2 * stuck]
        none = np.zeros(len(closed) + 2 * len(stuck))
        room = np.concatenate([self._room[opened, 0], none, -sign * self._room[sliding, 1]])
        friction, slip = unit[2 * stuck + 1], sign[:, None] * self._slope[2 * sliding + 1]
        rows = [-self._slope[2 * opened], unit[2 * closed], bound - friction, bound + friction, slip]
        return room, np.vstack(rows) if m else np.zeros((0, len(unit)))

    def differ(self, one: Vector, other: Vector) -> bool:
        """Return whether forces and joints of two answers move any contact differently."""
        sizes = abs(self._felt) @ np.maximum(abs(one), abs(other))
        doubtful = 10 * (self.doubtful * self._given.ravel()[self._acting_rows] + self.nothing)
        return bool(np.any(abs(self._felt @ (one - other)) > SAME * sizes + doubtful))

    def moving(self, free: Array) -> Array:
        """Return how free directions (k, q) move the contacts: rows (r, k) that are not zero."""
        change = self._felt @ free.T
        return np.asarray(change[np.any(abs(change) > np.sqrt(SINGULAR_SYSTEM), axis=1)])


class _Signs:
    """The signs of one combination along the solutions start + free'c of a system that leaves something free."""

    def __init__(self, system: _Systems, status: NDArray[np.int8], start: Vector, free: Array) -> None:
        self._start, self._free, self._moving, self._doubtful = start, free, system.moving(free), system.doubtful
        room, change = system.signs(status)
        self._left, self._slope, self._allowed = room + change @ start, change @ free.T, system.sizes(status, start)
        self._idle = np.all(abs(self._slope) <= np.sqrt(SINGULAR_SYSTEM), axis=1)

    @property
    def may_hold(self) -> bool:
        """Return whether all signs that no c changes hold."""
        return bool(np.all(self._left[self._idle] >= -self._allowed[self._idle]))

    def extremes(self) -> list[Vector] | None:
        """Return the solutions whose signs hold that move the contacts furthest apart; none where no signs hold.

        None where the signs cannot be put in doubles.
        """
        from scipy.optimize import linprog

        size = self._allowed / self._doubtful
        nonzero = size[~self._idle & (size > 0)]
        step = float(np.median(nonzero)) if len(nonzero) else 1.0
        size = np.where(size > 0, size, step)
        moving = self._moving
        wanted = np.vstack([moving, -moving]) if len(moving) else np.zeros((1, len(self._free)))
        slope, room = -self._slope * (step / size)[:, None], self._left / size + self._doubtful
        if not (np.all(np.isfinite(slope)) and np.all(np.isfinite(room)) and np.all(np.isfinite(moving))):
            return None
        found = []
        for row in wanted:
            answer = linprog(
                -row,
                A_ub=slope,
                b_ub=room,
                bounds=[(-1e3, 1e3)] * len(self._free),  # beyond a thousand times its size a family is a family
                method="highs",
            )
            if answer.x is None:
                return []
            found.append(self._start + step * self._free.T @ answer.x)
        return found


SEVERAL = "several answers"  # others were found at this load
POSSIBLE = "several answers possible"  # others are not excluded
FORCES = "forces not unique"
UNKNOWN = "not examined"

# Pivots of the Gram matrix of rows of unit length above this part of one say that they do not depend on each other.
INDEPENDENT = 1e-12
# Linearising the Tresca fixed-point iteration takes a dense system of all closed contacts, at every answer.
MOST_LINEARISED = 100
# A contact takes part in a dependence with a share of at least this.
SHARE = 1e-6


@dataclass(frozen=True, eq=False)
class Uniqueness:
    """Findings on whether other answers to the same problem exist."""

    findings: tuple[str, ...] = ()  # none: with friction, this is the only answer
    notes: tuple[str, ...] = ()
    contraction: float | None = None  # of the Tresca fixed-point iteration at this answer


def uniqueness(
    problem: ContactProblem, answer: Answer, found: Violations, condensation: Condensation | None, tolerance: float
) -> Uniqueness:
    """Say whether other equilibria may exist at this load; without friction the energy has one minimum.

    Parameters
    ----------
    problem : ContactProblem
    answer : Answer
    found : Violations
        Its figures.
    condensation : Condensation or None
        None where the bodies are not condensed: then nothing is examined, and the notes say so.
    tolerance : float
        Up to which figures count as zero.
    """
    if not problem.frictional or not problem.contacts:
        return Uniqueness()
    reason = too_many(problem, condensation)
    if condensation is None or reason is not None:
        reason = reason or "the bodies are not condensed onto their contacts"
        return Uniqueness((UNKNOWN,), (f"uniqueness was not examined: {reason}",))
    constants, state = critical(problem, condensation), _State(problem, answer, found, tolerance)
    sentences = [_forces(problem, state, condensation), _displacements(problem, constants, condensation)]
    contraction = _contraction(problem, state, condensation)
    notes = [note for _, note in sentences if note]
    if contraction is not None and contraction >= 1:
        notes.append(
            "friction: the Tresca fixed-point iteration, each step of which takes its friction bounds from the forces "
            f"of the step before, multiplies their error by {contraction:.3g} a step near this answer: without damping "
            "it does not converge"
        )
    return Uniqueness(tuple(finding for finding, _ in sentences if finding), tuple(notes), contraction)


class _State:
    """The contacts that are closed, stick and slip by the certificate's measures."""

    def __init__(self, problem: ContactProblem, answer: Answer, found: Violations, tolerance: float) -> None:
        if problem.friction is None or problem.tangent is None or problem.slip_origin is None:
            raise ValueError("the state of a problem without friction")
        pushes = (found.force_measure > 0) & (found.gap_measure <= np.maximum(found.force_measure, tolerance))
        loaded = pushes & (found.force_measure > tolerance)
        self.closed = np.flatnonzero(pushes | (found.gap_measure <= tolerance))
        frictional = loaded & (problem.friction > 0)
        self.stuck = np.flatnonzero(frictional & (found.slip_measure <= tolerance))
        self.slides = np.flatnonzero(frictional & (found.slip_measure > tolerance))
        # What touches without pressing and slips would have friction as soon as it took its share.
        moves = (problem.friction > 0) & (found.slip_measure > tolerance)
        self.dragged = self.closed[moves[self.closed]]
        slip = (problem.tangent @ answer.displacement).reshape(problem.slip_origin.shape) - problem.slip_origin
        self.direction = directions(slip)
        self.slip = lengths(slip)
        self.force = answer.normal_force


def _displacements(
    problem: ContactProblem, constants: CriticalFriction, condensation: Condensation
) -> tuple[str | None, str | None]:
    if constants.unique:
        return None, None
    flat = problem.slip_origin is not None and problem.slip_origin.shape[1] == 1
    if flat and problem.contacts <= MOST_COUNTED:
        several = several_answers(problem, condensation)
        if several:
            listed = "contactqp.equilibria lists them"
            return SEVERAL, f"friction: several answers exist at this load ({_reason(problem, constants)}); {listed}"
        if several is not None:
            return None, None
    may = "may exist" if constants.above.size else "are not excluded"
    return POSSIBLE, f"friction: several answers {may} ({_reason(problem, constants)})"


def _reason(problem: ContactProblem, constants: CriticalFriction) -> str:
    if constants.above.size:
        i = int(np.argmax(constants.ratio))
        mu = 0.0 if problem.friction is None else float(problem.friction[i])
        others = f", as at {len(constants.above) - 1} more contacts" if len(constants.above) > 1 else ""
        return f"mu = {mu:.3g} of {problem.contact_name(i)} is not below the critical {constants.single[i]:.3g}{others}"
    single = f"{LARGEST_RATIO}: {constants.contraction:.3g}"
    if np.isfinite(constants.kappa):
        return (
            f"coupled contacts are above the sufficient bound for one answer, kappa = {constants.kappa:.3g}; {single}"
        )
    return f"contacts are redundant or alone hold a body, which no bound covers; {single}"


def _forces(problem: ContactProblem, state: _State, condensation: Condensation) -> tuple[str | None, str | None]:
    named = _dependent_contacts(problem, state, condensation)
    if not named.size:
        return None, None
    names = ", ".join(problem.contact_name(int(i)) for i in named[:8]) + (", ..." if len(named) > 8 else "")
    return FORCES, f"redundant contacts: forces other than these belong to the same displacement at {names}"


def _dependent_contacts(problem: ContactProblem, state: _State, condensation: Condensation) -> Indices:
    """Return the closed contacts whose forces may change without moving anything."""
    if condensation.tangent is None or problem.friction is None or _never_dependent(problem, condensation):
        return np.zeros(0, dtype=np.intp)
    scale, m = condensation.scale, problem.contacts
    tangent = (condensation.tangent.toarray() * scale).reshape(m, -1, len(scale))
    dragged = np.zeros((m, len(scale)))
    at = state.dragged
    dragged[at] = problem.friction[at, None] * np.einsum("ik,ikj->ij", state.direction[at], tangent[at])
    width = tangent.shape[1]
    held = tangent[state.stuck].reshape(-1, len(scale))
    of = np.concatenate([state.closed, np.repeat(state.stuck, width)])
    rows = np.vstack([condensation.normal[state.closed] * scale + dragged[state.closed], held])
    felt = np.any(rows != 0, axis=1)  # a tangent that is supported has no friction to speak of
    both = _unit(np.vstack([rows[felt], condensation.tie * scale]))
    count = int(np.sum(felt))
    if not count or _independent(both):
        return np.zeros(0, dtype=np.intp)
    _, values, rotation = np.linalg.svd(both.T, full_matrices=len(both) > len(scale))
    values = np.concatenate([values, np.zeros(len(both) - len(values))])
    null = rotation[values <= DEPENDENT_ROWS * values[0], :count].T
    shares = np.max(abs(null), axis=1, initial=0.0)
    return np.unique(of[felt][shares > SHARE])


def _never_dependent(problem: ContactProblem, condensation: Condensation) -> bool:
    """Return whether the rows of all contacts and ties are independent, whatever is closed; it is computed once."""
    if problem._computed.independent_rows is None:
        tangent = np.zeros((0, len(condensation.scale)))
        if condensation.tangent is not None:
            tangent = condensation.tangent.toarray()
        felt = tangent[np.any(tangent != 0, axis=1)]
        rows = np.vstack([condensation.normal, felt, condensation.tie]) * condensation.scale
        problem._computed.independent_rows = _independent(_unit(rows))
    return problem._computed.independent_rows


def _independent(rows: Array) -> bool:
    """Return whether unit rows are proven independent; False leaves the question open."""
    if len(rows) > rows.shape[1]:
        return False
    try:
        factor = np.linalg.cholesky(rows @ rows.T)
    except np.linalg.LinAlgError:
        return False
    return bool(np.min(np.diag(factor) ** 2, initial=1.0) > INDEPENDENT)


def _contraction(problem: ContactProblem, state: _State, condensation: Condensation) -> float | None:
    """Return the spectral radius of the map mu l_N -> mu l_N of one Tresca step, linearised at the answer.

    Closed contacts stay closed, those that stick stick; where one slips, l_T = theta d, d = s/|s|, changes with theta
    and with the slip: dl_T = d dtheta + theta/|s| (1 - d d') ds. None where more than 100 contacts are closed, or
    where numbers leave the range of floats.
    """
    if problem.friction is None or len(state.closed) > MOST_LINEARISED:
        return None
    compliance = contact_compliance(problem, condensation)
    m, mu = problem.contacts, problem.friction
    d, joints = len(compliance.W) // m, len(compliance.J)
    place = np.arange(m * d).reshape(m, d)
    sliding = place[state.slides, 1:]
    used = np.concatenate([place[state.closed, 0], place[state.stuck, 1:].ravel(), sliding.ravel()])
    n, first = len(used), len(used) - sliding.size
    matrix = np.zeros((n + joints, n + joints))
    matrix[:n, :n], matrix[n:, n:] = compliance.W[used[:, None], used], compliance.J
    matrix[:n, n:], matrix[n:, :n] = compliance.V[used], compliance.V[used].T
    flexible, matrix[first:n] = matrix[first:n].copy(), np.eye(n + joints)[first:n]
    # In the units of the compliance: forces times sqrt(W_NN), lengths over it.
    slides = state.slides
    with np.errstate(over="ignore", divide="ignore"):
        turned = compliance.scale[slides] ** 2 * mu[slides] * np.maximum(state.force[slides], 0.0) / state.slip[slides]
    if not np.all(np.isfinite(turned)):
        return None
    direction, count = state.direction[slides], len(slides)
    across = np.eye(d - 1) - direction[:, :, None] * direction[:, None, :]
    turning = turned[:, None, None] * across @ flexible.reshape(count, d - 1, n + joints)
    matrix[first:n] += turning.reshape(sliding.size, n + joints)
    right = np.zeros((n + joints, count))
    right[np.arange(first, n), np.arange(count).repeat(d - 1)] = (mu[slides, None] * direction).ravel()
    if not np.all(np.isfinite(matrix)):
        return None
    if not count:  # the friction bounds of contacts that stick move nothing
        return 0.0
    try:
        change = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        change = np.linalg.lstsq(matrix, right, rcond=None)[0]
    pressed = change[np.searchsorted(state.closed, state.slides)]
    if not np.all(np.isfinite(pressed)):
        return None  # forces and slips so far apart that their ratio leaves the floats
    return float(np.max(abs(np.linalg.eigvals(pressed)), initial=0.0))


def _unit(rows: Array) -> Array:
    length: Vector = np.linalg.norm(rows, axis=1)
    return np.asarray(rows / np.where(length > 0, length, 1.0)[:, None])
