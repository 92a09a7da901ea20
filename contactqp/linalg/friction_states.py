"""Solve the linear system of one combination of open, stick and slip, unsymmetric where a contact slips.

    [ S + C   N_c' + T_c' diag(mu t)   T_b'   A' ] [ x   ]   [ f_S ]
    [ N_c                                        ] [ l_N ] = [ g   ]      c: closed contacts, t the direction of slip
    [ T_b                                        ] [ l_T ]   [ o   ]      b: those that stick, t = 0 there
    [ A                                          ] [ nu  ]   [ b   ]

(Wriggers 2006, section 9.3.3). In the plane t = +-1 is part of the combination and C = 0. In space directions turn with
the slip s, t = s/|s|, and C = T' diag(mu l_N / |s| (I - t t')) T belongs to Newton's method; as C is large for small
slips, its friction force is an additional unknown with the compliance |s| / mu l_N. The system is used as an
approximate inverse in refinement with residuals of the full problem in twice double precision. Rows are scaled as in
`contactqp.linalg.delassus`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import accumulate
from operator import is_
from typing import Any, Protocol

import numpy as np

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import NONE_ACROSS, AcrossSlips, FrictionalRows, ReducedStates, across_slips, unit_rows
from contactqp.linalg.dense import BALANCED, REGULAR
from contactqp.linalg.extended import (
    Extended,
    ExtendedAnswer,
    ExtendedRows,
    Residuals,
    extend,
    extended_rows,
    residuals_of,
)
from contactqp.linalg.factorization import right_singular
from contactqp.linalg.floating import (
    UNRESISTED,
    imbalance,
    imbalance_of_acting,
    independent_rows,
    rigid_forces,
)
from contactqp.linalg.measures import directions as directions_of
from contactqp.linalg.measures import lengths, longest_stated
from contactqp.linalg.runtime import lapack
from contactqp.model.arrays import EPS, INVISIBLE, Array, Mask, Vector, refuse_late, zero_beneath
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, AnswerOf


class ScaledRows(Protocol):
    """The units of scaled rows; attributes are those of `FrictionalRows`."""

    width: int
    normal_length: Vector
    tangent_length: Vector
    tie_length: Vector
    slides: Mask
    coefficient: Vector


# Changes of displacements and forces; those of friction (m, d-1) are of sticking contacts.
Correction = AnswerOf[Vector, Array]


class Corrections(Protocol):
    """The factorised system of one combination; attributes are those of `StateSystem`."""

    regular: bool
    redundant: bool

    def correct(self, load: Vector, gap: Vector, slip: Vector, tie: Vector) -> Correction:
        """Return the correction for residuals of the full problem.

        Parameters
        ----------
        load : (n,) array [force], what is out of balance
        gap, slip, tie : (m,), ((d-1) m,), (k,) arrays [length]
            What gaps, slips and ties miss; those of open contacts and of slips that are free do not count.
        """


# Refinement stops when a sweep no longer halves the correction.
MAX_SWEEPS = 12
# In space the first corrections change directions and need not decrease.
TURNS = 5
# At a double root Newton's corrections only halve; they are continued for this many sweeps.
SLOW_SWEEPS, HALVED = 60, 0.6
# Factors are recomputed unless a sweep with the old ones reduces the correction to this part.
WELL_TURNED = 0.1
# As directions are doubles, corrections below this part of the answer may be due to their rounding.
ROUNDED, UNSEEN = 1e-15, EPS / 2
# A factor by which later corrections may contract less than the last one. Comparisons include the last correction in
# their bounds instead.
CAUTION = 1e4
# The same system is used for slip directions and relative mu l_N / |s| that differ by less.
SAME_SYSTEM = 1e-9
# Refinement has failed if the last correction exceeds this part of the answer.
REFINEMENT_FAILED = 1e-12
# A slip below this part of the friction bound, both in sqrt(energy), has no direction.
LEAST_SLIP = 1e-13
# Corrections below this part of the answer do not change its doubles.
BELOW_DOUBLES = 1e-20
# The work named in the message if the time limit has passed.
LATE = "the answer was solved for on its combination of open, stick and slip"
# Larger systems are reduced to the forces by a Schur complement if nothing floats.
REDUCED = 100
# With a reciprocal condition, or relative singular values, below this, a system does not determine motions or forces.
SINGULAR_STATES = 1e-12


class StateSystem:
    """The factorised linear system of one combination.

    Parameters
    ----------
    condensation : Condensation, that of the problem
    rows : FrictionalRows
    status : (m,) array of int, the combination
    directions : (m, d-1) array, of slip, of unit length; zero where a contact does not slip
    turning : (m,) array, mu l_N / |s| in scaled forces and lengths; None in the plane
    independent : bool
        Whether rows that depend on others get no correction and motions that no row resists stay at rest. Forces and
        motions of the start are then kept there, and a nearly singular stiffness does not make the system irregular.

    Attributes
    ----------
    regular : bool, whether the matrix has an inverse; else minimum-norm least-squares corrections are used
    redundant : bool, whether rows depend on others (where `independent` was asked for)
    sound : bool, whether it is regular beyond rounding; rows of forces may depend though constrained rows do not
    """

    def __init__(
        self,
        condensation: Condensation,
        rows: FrictionalRows,
        status: Status,
        directions: Array,
        turning: Vector | None = None,
        independent: bool = False,
    ) -> None:
        self._of = status, directions, turning
        self.closed, self.stuck = (status != OPEN).nonzero()[0], (status == STICK).nonzero()[0]
        self._condensation, self._rows, self.redundant = condensation, rows, False
        # Which of the normal, tangential and tie rows (m + (d-1) m + k,) are in the system, and their scales.
        m, end = len(rows.normal), len(rows.normal) + len(rows.tangent)
        along, ties = np.arange(m, end).reshape(-1, rows.width), np.arange(end, end + len(rows.tie))
        acting = np.concatenate([self.closed, along[self.stuck].ravel(), ties])
        # A tangential row whose unknowns are all supported is zero, and its force has no effect.
        self._acting = acting[rows.all_rows[acting].any(axis=1)]
        across, self._reduced = NONE_ACROSS if turning is None else across_slips(directions, turning), None
        self._contacts, self._size, self._across, self.sound = m, len(rows.S), len(across.contacts), True
        held = not rows.motions.shape[1] and condensation.schur_factor.smallest_pivot >= REGULAR
        if held and self._size + len(acting) >= REDUCED:
            reduced = ReducedStates(rows, self._acting, directions, across)
            self._reduced = reduced if reduced.regular else None
        if self._reduced is None:
            self._factorise(self._whole(directions, across, independent), 0.0 if independent else SINGULAR_STATES)
        self.regular = self._reduced is not None or self._inverse is None
        units = (rows.normal_length, rows.tangent_length.repeat(rows.width), rows.tie_length)
        self._units = np.concatenate(units)[self._acting]

    def _whole(self, directions: Array, across: AcrossSlips, independent: bool) -> Array:
        """Return the matrix, with `independent` without dependent rows."""
        rows, p = self._rows, self._size
        tangent = rows.tangent.reshape(self._contacts, rows.width, p)
        added = np.einsum("iw,iwp->ip", across.rows, tangent[across.contacts])
        held, stiffness = rows.all_rows[self._acting], rows.S
        if independent:
            kept = independent_rows(unit_rows(held)[0])
            free = _motions_across(rows.motions, np.concatenate([held, added]))
            stiffness = stiffness + free @ free.T
            self.redundant = len(kept) < len(held)
            held, self._acting = held[kept], self._acting[kept]
        pushing = self._acting[self._acting < self._contacts]
        pushed = held.copy()
        drag = np.einsum("iw,iwp->ip", directions[pushing], tangent[pushing])
        pushed[: len(pushing)] += rows.coefficient[pushing, None] * drag
        matrix = np.zeros((p + len(held) + len(added),) * 2)
        matrix[:p, :p], matrix[:p, p:] = stiffness, np.concatenate([pushed, added]).T
        matrix[p:, :p] = np.concatenate([held, added])
        crossed = np.arange(p + len(held), len(matrix))
        matrix[crossed, crossed] = -across.compliance
        return matrix

    def suits(self, status: Status, directions: Array, turning: Vector | None) -> bool:
        """Return whether this is the system of a combination, up to rounding of slip directions."""
        own, along, turned = self._of
        if not np.array_equal(own, status) or (abs(along - directions) > SAME_SYSTEM).any():
            return False
        return turned is None or turning is None or bool((abs(turned - turning) <= SAME_SYSTEM * turning).all())

    def _factorise(self, matrix: Array, singular: float) -> None:
        self._inverse: Array | None = None
        factor, pivots, info = lapack().dgetrf(matrix)
        condition = lapack().dgecon(factor, np.linalg.norm(matrix, 1))[0] if info == 0 else 0.0
        self.sound = condition >= SINGULAR_STATES
        if not (info == 0 and (condition >= singular or not singular)):  # minimum-norm least squares
            self._inverse = np.asarray(np.linalg.pinv(matrix, rcond=SINGULAR_STATES), dtype=float)
            self._singular = matrix
        self._factor = (factor, pivots)

    def correct(self, load: Vector, gap: Vector, slip: Vector, tie: Vector, transposed: bool = False) -> Correction:
        """Return the correction of `Corrections.correct`, or that of the transposed system.

        Parameters
        ----------
        load, gap, slip, tie : as in `Corrections.correct`
        transposed : whether the system is the transposed one
        """
        reduced, inner = self._condensation.reduce_residual(load)
        rows, m, p = self._rows, self._contacts, self._size
        rows.corrections += 1
        lengths, q = np.concatenate([gap, slip.ravel(), tie]), p + len(self._acting)
        right = np.zeros(q + self._across)
        right[:p], right[p:q] = reduced * rows.scale, lengths[self._acting] / self._units
        if self._reduced is not None:
            found = self._reduced.solve(right, transposed)
        elif self._inverse is not None:
            found = (self._inverse.T if transposed else self._inverse) @ right
        else:
            found = lapack().dgetrs(*self._factor, right, trans=int(transposed))[0]
        forces, end = np.zeros(len(lengths)), m * (1 + rows.width)
        forces[self._acting] = found[p:q] / self._units
        du = self._condensation.expand(found[:p] * rows.scale, inner)
        return Correction(du, forces[:m], forces[m:end].reshape(m, rows.width), forces[end:])

    def unresolved(self) -> list[Correction]:
        """Return a basis of the null space of a singular system, in the form of `correct`."""
        values, right = right_singular(self._singular)
        free, rows, m, p = right[np.sum(values > SINGULAR_STATES * values[0]) :], self._rows, self._contacts, self._size
        _, inner = self._condensation.reduce_residual(np.zeros(len(self._condensation.unknown_scale)))
        moved = (self._condensation.expand(one[:p] * rows.scale, inner) for one in free)
        end = m * (1 + rows.width)
        forces = np.zeros((len(free), end + len(rows.tie)))
        forces[:, self._acting] = free[:, p : p + len(self._acting)] / self._units
        along = forces[:, m:end].reshape(-1, m, rows.width)
        return [Correction(*one) for one in zip(moved, forces[:, :m], along, forces[:, end:], strict=True)]


def _motions_across(motions: Array, held: Array) -> Array:
    """Return combinations of orthonormal motions (p, q) that no constrained row resists."""
    if not motions.shape[1] or not len(held):
        return motions
    values, rotation = right_singular(unit_rows(held)[0] @ motions)
    return np.asarray(motions @ rotation[int(np.sum(values > UNRESISTED)) :].T)


@dataclass(frozen=True, eq=False)
class RefinedState(AnswerOf[Extended, Extended]):
    """The answer of one combination in extended precision, with unchecked signs; friction forces are flat."""

    status: Status  # (m,) the combination
    directions: Array  # (m, d-1) of slip
    last: Correction
    regular: bool  # whether all systems were regular
    redundant: bool  # whether forces of dependent contacts or ties were kept
    cleared: float = 0.0  # relative forces by rounding of K along rigid motions, if K was cleared of it

    def answer(self, width: int) -> Answer:
        """Return the answer in double precision, friction forces as (m, width)."""
        friction = self.friction_force.double().reshape(-1, width)
        return Answer(self.displacement.double(), self.normal_force.double(), friction, self.tie_force.double())


def refined_in(
    problem: ContactProblem,
    condensation: Condensation,
    rows: FrictionalRows,
    status: Status,
    start: Answer,
    independent: bool = False,
    left: Residuals | None = None,
    cleared: bool | None = None,
) -> RefinedState:
    """Refine the answer of one combination from a start.

    The system of the last combination is reused if it is the same; an answer of `answer_in` is not refined again. In
    space the first slip directions are those of the start. K is used as stated unless its rounding along rigid motions
    spoils the balance of forces, as in `contactqp.linalg.refinement.answer_on`.

    Parameters
    ----------
    problem : ContactProblem
    condensation : the Condensation of the problem
    rows : FrictionalRows
    status : (m,) array of int, the combination
    start : Answer
    independent : as in `StateSystem`
    left : the residuals of the start, where they are known
    cleared : whether K is cleared of its rounding along rigid motions, where that is not to be decided here
    """
    known: RefinedState | None = problem._computed.of_answer.refined[1]
    ours = all(map(is_, problem._computed.of_answer.refined[0], _data(problem, start)))
    if known and ours and cleared is None and known.regular and np.array_equal(known.status, status):
        return known

    def system(directions: Array, turning: Vector | None) -> StateSystem:
        last: dict[bool, StateSystem] = rows.system
        for kept in (last.get(independent), last.get(False)):
            # A regular system has independent rows and no free motions.
            if kept is not None and (kept.regular or not independent) and kept.suits(status, directions, turning):
                return kept
        made = StateSystem(condensation, rows, status, directions, turning, independent)
        last[independent] = made
        return made

    caution = np.inf if independent else CAUTION
    if not cleared:
        found = refined_by(system, problem, rows, status, start, left=left, caution=caution)
        if cleared is False or not (rigid := condensation.rigid).count:
            return found
        answer = without_noise(problem, condensation.unknown_scale, rows, found.answer(rows.width), start)
        if (missed := max(imbalance(problem, answer, rigid), rigid_forces(problem, answer, rigid))) <= BALANCED:
            return found
    found = refined_by(system, problem, rows, status, start, exact=condensation.cleared_rows(problem))
    return found if cleared else replace(found, cleared=imbalance_of_acting(problem, answer, rigid, missed))


def refined_by(
    make: Callable[[Array, Vector | None], Corrections],
    problem: ContactProblem,
    rows: ScaledRows,
    status: Status,
    start: Answer,
    exact: ExtendedRows | None = None,
    sweeps: int = MAX_SWEEPS,
    left: Residuals | None = None,
    caution: float = np.inf,
) -> RefinedState:
    """Refine as `refined_in` does, with any rows and systems.

    Parameters
    ----------
    make : function of slip directions (m, d-1) and their turning, returns the system
    problem, rows, status, start, left : as in `refined_in`
    exact : form the residuals; those of the problem where it is None
    sweeps : at most so many are made in the plane
    caution : refinement goes on until this many times what it still has to do is negligible
    """
    in_space, origin, given = rows.width > 1, _origin(problem), _friction_of(start, rows.width)
    pushing = np.where(status != OPEN, start.normal_force, 0.0)
    sticking = np.where(status[:, None] == STICK, given, 0.0).ravel()
    refuse_late(LATE)
    exact = exact or extended_rows(problem)
    if exact.together is not None or not np.array_equal(pushing, start.normal_force):
        left = None  # for small problems as fast as an update
    # The ends of displacement, tie forces, normal forces and friction of sticking contacts in one vector.
    first = np.concatenate([start.displacement, start.tie_force, pushing, sticking])
    n, tied, pushed = ends = list(accumulate((problem.dimension, problem.ties, problem.contacts)))
    # Corrections of normal and friction forces are measured together in energy scale, as friction may be zero.
    unit, parts = np.ones(len(first)), sorted({0, n, tied} - {len(first)})
    unit[tied:pushed], unit[pushed:] = rows.normal_length, rows.tangent_length.repeat(rows.width)
    x, size, last = extend(first), np.inf, np.inf
    slip = (exact.slip(x[:n]) - origin).double() if in_space else origin
    directions, turning = slip_directions(rows, status, slip, pushing, given)
    system, coefficients = make(directions, turning), _coefficients(problem)[:, None]
    regular = system.regular
    for sweep in range(SLOW_SWEEPS if in_space else sweeps):
        # If directions hardly change, the factors of an earlier sweep are a good inverse.
        if in_space and size > max(WELL_TURNED * last, ROUNDED):
            refuse_late(LATE)
            system = make(directions, turning)
            regular = regular and system.regular
        last = size
        u, tie, force, stick = x.parted(*ends)
        friction = stick + force.spread(coefficients * directions)
        if left is None:
            left = residuals_of(exact, problem, ExtendedAnswer(u, force, friction, tie))
        else:
            left = replace(left, force=left.force - exact.friction_force(friction - given.ravel()))
        if not in_space:
            slip = ((exact.slip(u) if left.slip is None else left.slip) - origin).double()
        correction = system.correct(left.force.double(), left.gap.double(), -slip, left.tie.double())
        du, dl, dt = correction.displacement, correction.normal_force, correction.friction_force
        change = np.concatenate([du, correction.tie_force, dl, dt.ravel()])
        x = x + change
        whole = x.double()
        moved, most = np.maximum.reduceat(abs(unit * change), parts), np.maximum.reduceat(abs(unit * whole), parts)
        size = float(np.divide(moved, most, out=np.zeros(len(most)), where=most > 0).max())
        unseen = UNSEEN if turning is not None and turning.any() else 0.0
        if in_space:
            slip = (exact.slip(x[:n]) - origin).double()
            directions, turning = slip_directions(rows, status, slip, whole[tied:pushed], directions)
        turns = in_space and sweep < TURNS and size > ROUNDED
        halves = in_space and ROUNDED < size < HALVED * last
        foreseen = size * min(caution * size / last, 1.0)
        settled = size <= max(unseen, BELOW_DOUBLES) or (sweep and foreseen <= BELOW_DOUBLES)
        if settled or (size > 0.5 * last and not turns and not halves):
            break
        left = None
    u, tie, force, stick = x.parted(*ends)
    friction = stick + force.spread(coefficients * directions)
    return RefinedState(u, force, friction, tie, status.copy(), directions, correction, regular, system.redundant)


def answer_in(
    problem: ContactProblem, condensation: Condensation, rows: FrictionalRows, status: Status, start: Answer
) -> Answer:
    """Return the answer of one combination, refined from a start; undetermined components are those of the start.

    Its signs are checked by `contactqp.certificate.certificate.holds`.

    Parameters
    ----------
    problem, condensation, rows, status, start : as in `refined_in`
    """
    refined = refined_in(problem, condensation, rows, status, start)
    if not refined.regular:
        # A slender stiffness appears singular; components along soft motions missing in least-squares corrections show
        # if no row is dependent.
        near = refined.answer(rows.width)
        slender = refined_in(problem, condensation, rows, status, near, independent=True)
        refined = slender if slender.regular and not slender.redundant and _settled(slender) else refined
    answer = without_noise(problem, condensation.unknown_scale, rows, refined.answer(rows.width), start)
    problem._computed.of_answer.refined = _data(problem, answer), refined
    return answer


def _data(problem: ContactProblem, answer: Answer) -> tuple[Any, ...]:
    """Return what a refined answer belongs to besides the stiffness and the rows; all of it is read-only."""
    return answer, problem.load, problem.gap, problem.tie_value, problem.slip_origin, problem.friction


def _settled(refined: RefinedState) -> bool:
    """Return whether the last correction of the displacement is at the level of rounding of slip directions."""
    moved, far = (abs(one).max(initial=0.0) for one in (refined.last.displacement, refined.displacement.double()))
    return bool(far == 0 or moved <= REFINEMENT_FAILED * far)


def slip_directions(
    rows: ScaledRows, status: Status, slip: Vector, force: Vector, before: Array | None = None
) -> tuple[Array, Vector | None]:
    """Return unit directions of slip (m, d-1) and their rates mu l_N / |s| (m,), None in the plane.

    A contact at its friction bound without slip keeps the direction `before`.

    Parameters
    ----------
    rows : ScaledRows
    status : (m,) array of int, the combination
    slip : ((d-1) m,) array [length], of all contacts; in the plane it is not used
    force : (m,) array, normal forces [force]
    before : (m, d-1) array, friction or its directions until now, if any
    """
    if rows.width == 1:
        return np.where(status == STICK, 0.0, status)[:, None].astype(float), None
    sliding = abs(status) == 1
    vectors = np.where(sliding[:, None], slip.reshape(-1, rows.width), 0.0)
    size = lengths(vectors) / rows.tangent_length
    bound = rows.coefficient * np.maximum(force, 0.0) * rows.normal_length
    turning = np.divide(bound, size, out=np.zeros_like(size), where=size > bound * LEAST_SLIP)
    if before is None:
        return directions_of(vectors), turning
    still = sliding & (turning == 0) & np.any(before != 0, axis=1)
    return directions_of(np.where(still[:, None], before, vectors)), turning


def without_noise(problem: ContactProblem, scale: Vector, rows: ScaledRows, answer: Answer, start: Answer) -> Answer:
    """Set entries to zero that are below the rounding of refinement, relative to start, answer and load.

    All are measured in the root of energy: displacements divided by the scale of the unknown, loads multiplied by it,
    and forces multiplied by the scaled length of the row.

    Parameters
    ----------
    problem, rows : ContactProblem, ScaledRows
    scale : (n,) array, the scale of the unknowns
    answer, start : the refined answer, and the one where refinement began
    """
    far = float(abs(problem.load * scale).max(initial=0.0))
    for one in (answer, start):
        for size in (one.displacement / scale, rows.normal_length * one.normal_force, rows.tie_length * one.tie_force):
            far = max(far, float(abs(size).max(initial=0.0)))
    values = (answer.displacement, answer.normal_force, _friction_of(answer, rows.width), answer.tie_force)
    units = (1.0 / scale, rows.normal_length, rows.tangent_length[:, None], rows.tie_length)
    u, *forces = zero_beneath(values, units, INVISIBLE * far)
    if (u != answer.displacement).any():
        kept = abs(answer.displacement) * units[0] > INVISIBLE * longest_stated(problem)
        u = np.where(kept, answer.displacement, u)
    return Answer(u, *forces)


def _coefficients(problem: ContactProblem) -> Vector:
    return np.zeros(problem.contacts) if problem.friction is None else problem.friction


def _friction_of(answer: Answer, width: int) -> Array:
    return np.zeros((len(answer.normal_force), width)) if answer.friction_force is None else answer.friction_force


def _origin(problem: ContactProblem) -> Vector:
    return np.zeros(problem.contacts) if problem.slip_origin is None else problem.slip_origin.ravel()
