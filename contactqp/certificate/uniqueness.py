"""Examine cheaply whether forces, and with friction the answer, are unique.

Forces with friction: with E_c the normal rows of closed contacts (those that slip with their friction along, E_N + mu
E_T'd), E_b the tangential rows of those that stick and A the ties, contact forces for a displacement are unique if no
combination of these rows vanishes, except of ties only. Displacements: `contactqp.critical_friction` where the answer
is the only one at every load; at this load, in the plane and with few contacts, the answers of all combinations of
open, stick and slip are counted (`contactqp.certificate.other_answers`). Bodies with free motions have many
displacements, and only quantities that these motions do not change are unique.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain, islice, pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.critical_friction import LARGEST_RATIO, CriticalFriction, critical, too_many
from contactqp.certificate.other_answers import MOST_COUNTED, several_answers
from contactqp.errors import BackendFailed
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.convexity import are_independent, inverse_of_gram
from contactqp.linalg.delassus import contact_compliance, unit_rows
from contactqp.linalg.floating import DEPENDENT_IN_ENERGY
from contactqp.linalg.iteration import Systems, systems_of
from contactqp.linalg.measures import directions, lengths
from contactqp.linalg.nonnegative import DEPENDENT_ROWS, given_rows, highs, width_of
from contactqp.linalg.runtime import lapack
from contactqp.linalg.sparse_saddle import REGULARISATIONS, ClosedState, Effort, SparseSaddle, kept_saddle
from contactqp.model.arrays import EPS, TINY, Array, Indices, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Violations

# The number of contacts with friction up to which bounds cost less than half of a solution and are always computed.
MOST_PROVEN = 200
# Unit rows are independent if the pivots of their Gram matrix are above this.
INDEPENDENT = 1e-12
# The most closed contacts for linearising the Tresca fixed-point iteration, which needs a dense system.
MOST_LINEARISED = 100
# The most contacts with redundant forces, each of which needs linear programs, and the tangents of a friction disc in
# space.
MOST_LOOKED_AT, DIRECTIONS = 30, 16
# The range of forces examined relative to the largest, and the difference that counts.
FARTHEST, CHANGES = 10.0, 1e-8
# The most closed contacts and ties whose forces are compared without friction, and the least change that counts.
MOST_SHARING, GAINS = 500, 0.5
# The least weight of a contact in a dependence.
SHARE = 1e-6
# Motions and forces are free if the response to a unit is at least this part of 1/d, also with the smaller d that
# separates soft motions and nearly dependent rows from free and redundant ones.
ALMOST_FREE, NEARER = 1e-3, 1e-11

SEVERAL = "several answers"  # other answers exist at this load
POSSIBLE = "several answers possible"  # other answers are not excluded
FORCES = "forces not unique"
UNKNOWN = "not examined"


def proves_friction(problem: ContactProblem) -> bool:
    """Return whether bounds with friction cost less than half of the solution, for few condensed contacts."""
    return problem.frictional and problem.contacts <= MOST_PROVEN and systems_of(problem) is Systems.CONDENSED


@dataclass(frozen=True, eq=False)
class Uniqueness:
    """Findings on whether other answers to the same problem exist."""

    findings: tuple[str, ...] = ()  # none: with friction, this is the only answer
    notes: tuple[str, ...] = ()
    contraction: float | None = None  # contraction of Tresca's fixed point at this answer


def uniqueness(
    problem: ContactProblem, answer: Answer, found: Violations, condensation: Condensation | None, tolerance: float
) -> Uniqueness:
    """Return whether other equilibria may exist at this load; without friction the energy has one minimum.

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
        # A touching contact without force that slips would have friction with any share of the force.
        moves = (problem.friction > 0) & (found.slip_measure > tolerance)
        self.dragged = self.closed[moves[self.closed]]
        # A touching contact without force and slip could have any friction within its share.
        self.still = self.closed[(problem.friction[self.closed] > 0) & ~moves[self.closed]]
        slip = (problem.tangent @ answer.displacement).reshape(problem.slip_origin.shape) - problem.slip_origin
        self.direction = directions(slip)
        self.slip = lengths(slip)
        self.force = answer.normal_force
        given = np.zeros(self.direction.size) if answer.friction_force is None else answer.friction_force
        self.friction: Array = given.reshape(self.direction.shape)


def _displacements(
    problem: ContactProblem, constants: CriticalFriction, condensation: Condensation
) -> tuple[str | None, str | None]:
    if constants.unique:
        return None, None
    flat = problem.slip_origin is not None and problem.slip_origin.shape[1] == 1
    if flat and problem.contacts <= MOST_COUNTED:
        several = several_answers(problem, condensation)
        if several:
            reason = _reason(problem, constants, condensation)
            return SEVERAL, f"friction: several answers exist at this load ({reason}); contactqp.equilibria lists them"
        if several is not None:
            return None, None
    may = "may exist" if constants.above.size else "are not excluded"
    return POSSIBLE, f"friction: several answers {may} ({_reason(problem, constants, condensation)})"


def _reason(problem: ContactProblem, constants: CriticalFriction, condensation: Condensation) -> str:
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
    what = "contacts alone hold a body" if condensation.rigid.count else "rows of contacts depend on each other"
    return f"{what}, which no bound covers; {single}"


def _forces(problem: ContactProblem, state: _State, condensation: Condensation) -> tuple[str | None, str | None]:
    named = _dependent_contacts(problem, state, condensation)
    if not named.size:
        return None, None
    names = ", ".join(problem.contact_name(int(i)) for i in named[:8]) + (", ..." if len(named) > 8 else "")
    return FORCES, f"redundant contacts: forces other than these belong to the same displacement at {names}"


def _dependent_contacts(problem: ContactProblem, state: _State, condensation: Condensation) -> Indices:
    """Return the closed contacts whose forces may change without any displacement."""
    if condensation.tangent is None or problem.friction is None or _never_dependent(problem, condensation):
        return np.zeros(0, dtype=np.intp)
    scale, m = condensation.scale, problem.contacts
    tangent = (condensation.tangent.toarray() * scale).reshape(m, -1, len(scale))
    dragged = np.zeros((m, len(scale)))
    at = state.dragged
    dragged[at] = problem.friction[at, None] * np.einsum("ik,ikj->ij", state.direction[at], tangent[at])
    width = tangent.shape[1]
    held = tangent[state.still].reshape(-1, len(scale))
    of = np.concatenate([state.closed, np.repeat(state.still, width)])
    rows = np.vstack([condensation.normal[state.closed] * scale + dragged[state.closed], held])
    felt = np.any(rows != 0, axis=1)  # friction along a supported tangent has no effect
    size = np.linalg.norm(rows, axis=1)
    both = unit_rows(np.vstack([rows[felt], condensation.tie * scale]))[0]
    count = int(np.sum(felt))
    if not count or _independent(both):
        return np.zeros(0, dtype=np.intp)
    _, values, rotation = np.linalg.svd(both.T, full_matrices=len(both) > len(scale))
    values = np.concatenate([values, np.zeros(len(both) - len(values))])
    null = rotation[values <= DEPENDENT_ROWS * values[0], :count].T
    shared = np.unique(of[felt][np.max(abs(null), axis=1, initial=0.0) > SHARE])
    turns = np.zeros((len(rows), null.shape[1]))
    turns[felt] = null / size[felt, None]
    return _that_change(turns, shared, problem.friction, state) if 0 < len(shared) <= MOST_LOOKED_AT else shared


def _that_change(turns: Array, shared: Indices, mu: Vector, state: _State) -> Indices:
    """Return those of some contacts whose forces may change within Signorini's and Coulomb's laws.

    Parameters
    ----------
    turns : (q, k), how the forces of closed contacts, and the friction of those that do not slip, may change in balance
    shared : contacts
    mu, state : coefficients of friction (m,), and the state of all contacts
    """
    closed, still, width = state.closed, state.still, state.friction.shape[1]
    normal = np.maximum(state.force[closed], 0.0)
    scale = np.max(normal, initial=0.0) or 1.0
    pressed, rubbed = turns[: len(closed)], turns[len(closed) :].reshape(len(still), width, turns.shape[1])
    place = np.searchsorted(closed, still)
    at = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    along = np.array([[1.0], [-1.0]]) if width == 1 else np.column_stack([np.cos(at), np.sin(at)])
    # Discs lie within the polygons of their tangents.
    left = mu[still, None] * normal[place, None] - state.friction[still] @ along.T
    change = mu[still, None, None] * pressed[place, None] - np.einsum("ijk,aj->iak", rubbed, along)
    rows = np.vstack([pressed, change.reshape(-1, turns.shape[1])])
    room = np.concatenate([normal, np.maximum(left, 0.0).ravel()]) / scale
    length = np.linalg.norm(rows, axis=1)
    rows, room = (one[length > 0] for one in (rows, room))
    length = length[length > 0]
    of = np.concatenate([closed, np.repeat(still, width)])
    unit = float(np.max(length, initial=0.0)) or 1.0
    widest = [width_of(turns[of == i] / unit, rows / unit, room, FARTHEST) for i in shared]
    return np.asarray(shared[np.array(widest) > CHANGES])


def other_forces(problem: ContactProblem, pressing: Mask, grazing: Mask) -> tuple[bool | None, bool]:
    """Return whether other forces belong to the same displacement without friction, and whether grazing contacts press
    in some of them.

    The forces of all solutions are complementary to each displacement of them. So they differ by a change l of closed
    contacts and n of ties with E'l + A'n = 0, in which a contact that grazes only gains force, and a small multiple of
    each such change leaves the others pressing. The first is None if this was not decided.

    Parameters
    ----------
    problem : without friction
    pressing, grazing : (m,) masks, of contacts with a force, and of those that touch without one
    """
    rows = sp.csr_array(sp.vstack([problem.normal[pressing], problem.normal[grazing], problem.tie]))
    if not rows.nnz or rows.shape[0] > MOST_SHARING:
        return None, False
    moved = np.unique(rows.indices)
    unit = _with_largest_of_one(rows[:, moved])  # in any units of rows and unknowns
    unit = _with_largest_of_one(_with_largest_of_one(unit.T).T)
    touches = np.zeros(rows.shape[0], dtype=bool)
    touches[pressing.sum() : pressing.sum() + grazing.sum()] = True
    held = unit[~touches].toarray()
    values = np.linalg.svd(held, compute_uv=False)
    several = len(held) > len(moved) or (bool(len(held)) and bool(values[-1] <= DEPENDENT_ROWS * values[0]))
    if not touches.any():
        return several, False
    # Changes may have any size, so that the largest gain of all is at least one if there is any.
    bounds = np.column_stack([np.where(touches, 0.0, -np.inf), np.where(touches, 1.0, np.inf)])
    found = highs(-touches.astype(float), **given_rows("eq", unit.T, np.zeros(unit.shape[1])), bounds=bounds)
    gains = found is not None and -found.fun > GAINS
    return True if several or gains else None if found is None else False, gains


def _with_largest_of_one(rows: Any) -> Any:
    largest = abs(rows).max(axis=1).toarray().ravel()
    return sp.csr_array(rows.multiply(1 / np.where(largest > 0, np.maximum(largest, TINY), 1.0)[:, None]))


def _never_dependent(problem: ContactProblem, condensation: Condensation) -> bool:
    """Return whether the rows of all contacts and ties are independent, for any closed set; it is computed once."""
    if problem._computed.independent_rows is None:
        tangent = np.zeros((0, len(condensation.scale)))
        if condensation.tangent is not None:
            tangent = condensation.tangent.toarray()
        felt = tangent[np.any(tangent != 0, axis=1)]
        rows = np.vstack([condensation.normal, felt, condensation.tie]) * condensation.scale
        problem._computed.independent_rows = _independent(unit_rows(rows)[0])
    return problem._computed.independent_rows


def _independent(rows: Array) -> bool:
    """Return whether unit rows are proven independent; False if undecided."""
    if len(rows) > rows.shape[1]:
        return False
    try:
        factor = np.linalg.cholesky(rows @ rows.T)
    except np.linalg.LinAlgError:
        return False
    return bool(np.min(np.diag(factor) ** 2, initial=1.0) > INDEPENDENT)


def _contraction(problem: ContactProblem, state: _State, condensation: Condensation) -> float | None:
    """Return the spectral radius of the map mu l_N -> mu l_N of one Tresca step, linearised at the answer.

    Closed contacts stay closed and sticking ones stick; where one slips, l_T = theta d, d = s/|s|, changes with theta
    and with the slip: dl_T = d dtheta + theta/|s| (1 - d d') ds. None if more than 100 contacts are closed, or if
    numbers overflow.
    """
    if problem.friction is None or len(state.closed) > MOST_LINEARISED:
        return None
    if not len(state.slides):  # friction bounds of sticking contacts have no effect
        return 0.0
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
    try:
        change = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        change = np.linalg.lstsq(matrix, right, rcond=None)[0]
    pressed = change[np.searchsorted(state.closed, state.slides)]
    if not np.all(np.isfinite(pressed)):
        return None  # the ratio of forces and slips overflows
    return float(np.max(abs(np.linalg.eigvals(pressed)), initial=0.0))


# Rows are independent if the reciprocal condition, estimated to a factor of about ten, exceeds this.
SURELY_INDEPENDENT = 1e-6


def are_dependent(matrix: Array) -> bool:
    """Return whether the rows of a matrix (q, q), each in units of its largest entry, depend on each other.

    Singular values decide only where the condition, which is estimated, is near the border. It is False if numbers
    overflow.
    """
    size = np.sqrt(np.maximum(abs(matrix).max(axis=1, initial=0.0), TINY))
    if not np.isfinite(scaled := matrix / np.outer(size, size)).all():
        return False
    factor, _, failed = lapack().dgetrf(scaled)
    norm = float(np.linalg.norm(scaled, 1))
    condition = 0.0 if failed else float(lapack().dgecon(factor, norm)[0])
    if condition > SURELY_INDEPENDENT:
        return False
    # The reciprocal condition in the 1-norm, here from above, is at least an n-th of that in the 2-norm.
    if len(scaled) * (condition + EPS * abs(factor).max() / max(norm, TINY)) > DEPENDENT_ROWS:
        condition = float(np.divide(*np.linalg.svd(scaled, compute_uv=False)[[-1, 0]]))
    return condition <= DEPENDENT_ROWS


@dataclass(frozen=True)
class Unique:
    """Whether a state's displacement and forces are unique for its closed contacts."""

    displacement: bool
    forces: bool


def unique_on(state: ClosedState) -> Unique:
    """Return whether displacement and forces of these closed contacts are unique.

    The response of the regularised saddle point to a force on a free motion, or to contradicting gaps of dependent
    rows, is 1/d times these, which random forces and gaps include. Soft bodies and nearly dependent rows, such as
    differences of thousands of unknowns, may respond as strongly, but refinement meets these, and a smaller d or the
    motions of the rows themselves tell.
    """
    problem, closed = state.problem, state.closed
    unique = _answered(kept_saddle(problem, closed, REGULARISATIONS[0], Effort()), state)
    if not unique.forces:
        unique = replace(unique, forces=are_independent(sp.vstack([problem.normal[closed], problem.tie])))
    if unique.displacement and unique.forces:
        return unique
    try:
        nearer = _answered(SparseSaddle(problem, np.flatnonzero(closed), NEARER), state, 2)
    except BackendFailed:
        return unique
    return Unique(unique.displacement or nearer.displacement, unique.forces or nearer.forces)


def _answered(saddle: SparseSaddle, state: ClosedState, sweeps: int | None = None) -> Unique:
    """Return whether random forces and gaps respond less than free motions and dependent rows, or sweeps meet them.

    Refinement takes away neither forces along free motions nor contradictions of dependent rows. With the smaller d a
    small response that does not meet them tells nothing: its factors round by as much as free motions respond.
    """
    random, most = np.random.default_rng(0), ALMOST_FREE / saddle.regularisation
    rounds_less = saddle.regularisation > NEARER
    sizes = state.problem.dimension, int(np.sum(state.closed)), state.problem.ties
    force, gap, tie = (random.uniform(0.5, 1.0, size) for size in sizes)
    moved = ((u, left) for u, *_, left in saddle.refined(force, gap * 0.0, tie * 0.0))
    pushed = ((np.concatenate(found), left) for _, *found, left in saddle.refined(force * 0.0, gap, tie))

    def met(responses: Iterator[tuple[Vector, float]]) -> bool:
        steps = pairwise(chain([(np.full(1, np.inf), np.inf)], islice(responses, sweeps)))
        return any(left < ALMOST_FREE or (rounds_less and np.all(abs(x) < most)) for (x, _), (_, left) in steps)

    return Unique(met(moved), met(pushed))


# A row that its own motion moves by one less this part depends on others, which move with it.
MOVES_OTHERS = 1e-3
# The most rows whose motions are found by dense systems, and random forces for more rows.
MOST_BY_MOTIONS, PROBES = 500, 24


def taken_by(rows: Any, residual: Vector, stiffness: Any, missed: Vector, unique: bool) -> tuple[Array, Vector]:
    """Return |r|'|v| and |v|_K for a motion v of each row (a, 2), with residuals r, and the motion c_j v_j of all (n,).

    Rows that share no unknown have separate motions. All are infinite if rows overflow or are dependent.

    Parameters
    ----------
    rows, stiffness : (a, n), (n, n) sparse arrays, E and K
    residual, missed : (n,) array [force], the sizes of r, and (a,) array [length], c
    unique : whether forces are unique; if not, the motions of rows that depend on others or are many are infinite
    """
    rows = sp.csr_array(rows)
    size = np.asarray(rows.multiply(rows).sum(axis=1))
    if not (np.all(np.isfinite(size)) and np.all(size > 0) and np.all(np.isfinite(residual))):
        return np.full((rows.shape[0], 2), np.inf), np.zeros(rows.shape[1])
    energy, moved = np.asarray((rows @ stiffness).multiply(rows).sum(axis=1)), rows.T @ (missed / size)
    taken: Array = np.column_stack([abs(rows) @ residual, np.sqrt(np.maximum(energy, 0.0))]) / size[:, None]
    of_row = sp.csgraph.connected_components(sp.bmat([[None, rows], [rows.T, None]]), directed=False)[1][: len(size)]
    for group in np.flatnonzero(np.bincount(of_row) > 1):
        together = np.flatnonzero(of_row == group)
        few = rows[together]
        touched = np.unique(few.indices) if few.nnz < few.shape[1] else np.flatnonzero(np.bincount(few.indices))
        few, own, left = few[:, touched], residual[touched], missed[together]
        if len(together) > MOST_BY_MOTIONS or len(together) * len(touched) > MOST_BY_MOTIONS**2:
            if unique:
                taken[together], moved[touched] = _taken_at_random(few, own, stiffness[touched], left)
            else:
                taken[together] = np.inf
            continue
        dense = few.toarray()
        motions = np.linalg.pinv(dense) if unique else np.linalg.pinv(dense, DEPENDENT_IN_ENERGY)
        energy = np.sum(motions * (stiffness[touched][:, touched] @ motions), axis=0)
        taken[together, 0], moved[touched] = abs(motions).T @ own, motions @ left
        taken[together, 1] = np.sqrt(np.maximum(energy, 0.0))
        if not unique:
            taken[together[abs(np.sum(dense * motions.T, axis=1) - 1) > MOVES_OTHERS]] = np.inf
    return taken, moved


def _taken_at_random(rows: Any, residual: Vector, stiffness: Any, missed: Vector) -> tuple[Array, Vector]:
    """Return `taken_by` with probabilistic bounds for the shortest motions v = E'(E E')^-1 e_i of connected rows.

    For D = diag(d) and z of standard normal entries the mean of (v'D z)^2 is |D v|^2, and (E E')^-1 E D z gives v'D z
    for all motions by one solution. |r|'|v| is at most sqrt(n) |diag(r) v|, and v'K v at most the sum of s_j v_j^2,
    with s_j the sum of |K_ji| over i. The root mean of `PROBES` is too small by a factor of four with a probability
    below 1e-10. `stiffness` (n, ...) are rows of K.
    """
    count, n = rows.shape
    weights = np.column_stack([np.sqrt(n) * residual, np.sqrt(np.asarray(abs(stiffness).sum(axis=1)))])
    forces = np.random.default_rng(0).standard_normal((n, PROBES))
    solve = inverse_of_gram(rows)
    if solve is None:
        return np.full((count, 2), np.inf), np.zeros(n)
    answered = [solve(rows @ (weight[:, None] * forces)) for weight in weights.T]
    taken = np.column_stack([np.sqrt(np.mean(sizes**2, axis=1)) for sizes in answered])
    return taken, rows.T @ solve(missed[:, None])[:, 0]
