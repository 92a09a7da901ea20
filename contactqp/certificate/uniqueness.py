"""Whether a frictional answer is the only one, and its forces too, as far as that can be told cheaply.

Forces: with E_c the normal rows of closed contacts (those that slip with their friction along, E_N + mu E_T'd), E_b the
tangential rows of those that stick and A the ties, contact forces that balance a displacement are unique where no
combination of these rows but one of ties alone vanishes.
Displacements: `contactqp.critical_friction` where it is for every load, `contactqp.certificate.answer_count` at this
load.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.answer_count import MOST_COUNTED, several_answers
from contactqp.certificate.critical_coefficients import CriticalFriction, critical, too_many
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.contact_compliance import contact_compliance
from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb_cone import directions, lengths
from contactqp.model.problem import ContactProblem
from contactqp.model.verdicts import Answer, Violations

SEVERAL = "several answers"  # others were found at this load
POSSIBLE = "several answers possible"  # others are not excluded
FORCES = "forces not unique"
UNKNOWN = "not examined"

# Singular values of rows of unit length, relative to the largest, beneath which they depend on each other.
DEPENDENT = 1e-10
# Pivots of their Gram matrix above this part of one say that they do not.
INDEPENDENT = 1e-12
# Linearising Tresca's fixed point takes a dense system of all closed contacts, at every answer.
MOST_LINEARISED = 100
# A contact takes part in a dependence with a share of at least this.
SHARE = 1e-6


@dataclass(frozen=True, eq=False)
class Uniqueness:
    """What is known of other answers to the same problem."""

    findings: tuple[str, ...] = ()  # none: with friction, this is the only answer
    notes: tuple[str, ...] = ()
    contraction: float | None = None  # of Tresca's fixed point at this answer


def uniqueness(
    problem: ContactProblem, answer: Answer, found: Violations, condensation: Condensation | None, tolerance: float
) -> Uniqueness:
    """Of an answer; without friction nothing is said, `force_bound` says it."""
    if not problem.frictional or not problem.contacts:
        return Uniqueness()
    reason = "the bodies are not factorised as a whole"
    if condensation is not None:
        reason = too_many(problem, condensation) or ""
    if condensation is None or reason:
        return Uniqueness((UNKNOWN,), (f"uniqueness was not examined: {reason}",))
    state = _State(problem, answer, found, tolerance)
    known = critical(problem, condensation)
    said = [_forces(problem, state, condensation), _displacements(problem, known, condensation)]
    contraction = _contraction(problem, state, condensation)
    notes = [note for _, note in said if note]
    if contraction is not None and contraction >= 1:
        notes.append(
            f"friction: Tresca's fixed point multiplies the error of its bounds by {contraction:.3g} around this "
            "answer: without damping it cycles"
        )
    return Uniqueness(tuple(finding for finding, _ in said if finding), tuple(notes), contraction)


class _State:
    """Which contacts are closed, stick and slip, by the certificate's measures."""

    def __init__(self, problem: ContactProblem, answer: Answer, found: Violations, tolerance: float) -> None:
        if problem.friction is None or problem.tangent is None or problem.slip_origin is None:
            raise ValueError("the state of a problem without friction")
        pushes = (found.force_measure > 0) & (found.gap_measure <= np.maximum(found.force_measure, tolerance))
        loaded = pushes & (found.force_measure > tolerance)
        self.closed = np.flatnonzero(pushes | (found.gap_measure <= tolerance))
        rubs = loaded & (problem.friction > 0)
        self.stuck = np.flatnonzero(rubs & (found.slip_measure <= tolerance))
        self.slides = np.flatnonzero(rubs & (found.slip_measure > tolerance))
        # What touches without pressing and slips would rub as soon as it took its share.
        moves = (problem.friction > 0) & (found.slip_measure > tolerance)
        self.dragged = self.closed[moves[self.closed]]
        slip = (problem.tangent @ answer.displacement).reshape(problem.slip_origin.shape) - problem.slip_origin
        self.direction = directions(slip)
        self.slip = lengths(slip)
        self.force = answer.normal_force


def _displacements(
    problem: ContactProblem, known: CriticalFriction, condensation: Condensation
) -> tuple[str | None, str | None]:
    if known.unique:
        return None, None
    flat = problem.slip_origin is not None and problem.slip_origin.shape[1] == 1
    if flat and problem.contacts <= MOST_COUNTED:
        several = several_answers(problem, condensation)
        if several:
            listed = "contactqp.equilibria lists them"
            return SEVERAL, f"friction: several answers exist at this load ({_reason(problem, known)}); {listed}"
        if several is not None:
            return None, None
    may = "may exist" if known.above.size else "are not excluded"
    return POSSIBLE, f"friction: several answers {may} ({_reason(problem, known)})"


def _reason(problem: ContactProblem, known: CriticalFriction) -> str:
    if known.above.size:
        i = int(np.argmax(known.ratio))
        mu = 0.0 if problem.friction is None else float(problem.friction[i])
        others = f", as at {len(known.above) - 1} more contacts" if len(known.above) > 1 else ""
        return f"mu = {mu:.3g} of {problem.contact_name(i)} is not below the critical {known.single[i]:.3g}{others}"
    single = f"largest mu/mu_c of a contact alone: {known.contraction:.3g}"
    if np.isfinite(known.kappa):
        return f"coupled contacts are above the sufficient bound for one answer, kappa = {known.kappa:.3g}; {single}"
    return f"contacts are redundant or alone hold a body, which no bound covers; {single}"


def _forces(problem: ContactProblem, state: _State, condensation: Condensation) -> tuple[str | None, str | None]:
    named = _dependent_contacts(problem, state, condensation)
    if not named.size:
        return None, None
    names = ", ".join(problem.contact_name(int(i)) for i in named[:8]) + (", ..." if len(named) > 8 else "")
    return FORCES, f"redundant contacts: forces other than these belong to the same displacement at {names}"


def _dependent_contacts(problem: ContactProblem, state: _State, condensation: Condensation) -> NDArray[np.intp]:
    """Closed contacts whose forces may change without moving anything."""
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
    null = rotation[values <= DEPENDENT * values[0], :count].T
    shares = np.max(abs(null), axis=1, initial=0.0)
    return np.unique(of[felt][shares > SHARE])


def _never_dependent(problem: ContactProblem, condensation: Condensation) -> bool:
    """Whether the rows of all contacts and ties are independent, whatever is closed; found out once."""
    if "independent_rows" not in problem._shared:
        tangent = np.zeros((0, len(condensation.scale)))
        if condensation.tangent is not None:
            tangent = condensation.tangent.toarray()
        felt = tangent[np.any(tangent != 0, axis=1)]
        rows = np.vstack([condensation.normal, felt, condensation.tie]) * condensation.scale
        problem._shared["independent_rows"] = _independent(_unit(rows))
    return bool(problem._shared["independent_rows"])


def _independent(rows: Array) -> bool:
    """Whether unit rows are independent beyond doubt; if not, they may be all the same."""
    if len(rows) > rows.shape[1]:
        return False
    try:
        factor = np.linalg.cholesky(rows @ rows.T)
    except np.linalg.LinAlgError:
        return False
    return bool(np.min(np.diag(factor) ** 2, initial=1.0) > INDEPENDENT)


def _contraction(problem: ContactProblem, state: _State, condensation: Condensation) -> float | None:
    """Spectral radius of bounds mu l_N -> mu l_N of the next Tresca problem, linearised at the answer.

    Closed contacts stay closed, those that stick stick; where one slips, l_T = theta d, d = s/|s|, changes with theta
    and with the slip: dl_T = d dtheta + theta/|s| (1 - d d') ds. None where more than 100 contacts are closed.
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
    matrix = np.block([[compliance.W[np.ix_(used, used)], compliance.V[used]], [compliance.V[used].T, compliance.J]])
    flexible, matrix[first:n] = matrix[first:n].copy(), np.eye(n + joints)[first:n]
    right = np.zeros((n + joints, len(state.slides)))
    for k, i in enumerate(state.slides):
        own, direction = slice(k * (d - 1), (k + 1) * (d - 1)), state.direction[i]
        # In the units of the compliance: forces times sqrt(W_NN), lengths over it.
        with np.errstate(over="ignore", divide="ignore"):
            turned = float(compliance.scale[i] ** 2 * mu[i] * max(state.force[i], 0.0) / state.slip[i])
        if not np.isfinite(turned):
            return None
        rows = slice(first + own.start, first + own.stop)
        matrix[rows] += turned * (np.eye(d - 1) - np.outer(direction, direction)) @ flexible[own]
        right[rows, k] = mu[i] * direction
    try:
        change = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        change = np.linalg.lstsq(matrix, right, rcond=None)[0]
    pressed = change[np.searchsorted(state.closed, state.slides)]
    return float(np.max(abs(np.linalg.eigvals(pressed)), initial=0.0)) if len(pressed) else 0.0


def _unit(rows: Array) -> Array:
    length: Vector = np.linalg.norm(rows, axis=1)
    return np.asarray(rows / np.where(length > 0, length, 1.0)[:, None])
