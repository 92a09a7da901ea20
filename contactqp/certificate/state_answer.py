"""Compare an answer with friction with the equilibrium of its own combination of open, stick and slip.

A small residual does not imply accurate forces, and Coulomb's law is not a minimisation that would bound them. But with
every contact fixed in the state of the answer, the problem is a linear system (in the plane; in space Newton's method
updates the slip directions). It is solved from the answer, refined in twice double precision, and its signs are
checked: nonnegative gaps and forces, friction within its bound, and slip along it. If they hold, it is an equilibrium,
and the distance to it is judged like a bound: in the energy norm of the displacement, in that of the contact forces,
and force by force. If they fail, the failing contacts change their state, and the distance to the first combination
that holds is judged.

A failing sign is measured by the change that corrects it: a length over |E_i D|, D = 1/sqrt(K_jj), the root of the
energy that closes it with all other unknowns fixed; a force by the energy of its response. It is added to the distance,
so that contacts at the border of two states may be in either. For bodies that are not factorised the system of a
combination is solved by GMRES, in double precision.

This is a comparison, not a proof: other equilibria may exist (`contactqp.certificate.uniqueness`). If forces of
redundant contacts are not unique, or the system is singular, the figures remain, and the minimisation with the friction
forces fixed: u and l_N of an equilibrium minimise 1/2 u'Ku - (f - E_T'l_T)'u over E_N u <= g, for which bounds are
proven.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from contactqp.certificate import messages
from contactqp.certificate.bounds import NEXT_TO_NOTHING
from contactqp.certificate.figures import (
    FEW_DIGITS,
    RIGID_ROUNDING,
    energy_norm,
    kept_residuals,
    own_forces,
    response,
    rigid_rounding,
)
from contactqp.certificate.state_bodies import (
    Bodies,
    Compared,
    IteratedBodies,
    SparseBodies,
    StateVerdict,
    figures_alone,
    squared_lengths,
    with_friction_held,
)
from contactqp.errors import BackendFailed, NotConverged
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import FIXED_BY_TIES, condensed_frictional_rows, contact_compliance
from contactqp.linalg.dense import saddle_point
from contactqp.linalg.extended import FINE_EPS, extend, extended_rows
from contactqp.linalg.iteration import Systems, systems_of
from contactqp.linalg.measures import HELD_BY_DOUBLES, force_size, in_energy, lengths, row_sizes
from contactqp.linalg.measures import directions as directions_of
from contactqp.model.arrays import Array, Vector, refuse_late, seconds_of_unfinished
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import STATE, Answer, Violations

if TYPE_CHECKING:
    from contactqp.linalg.friction_states import RefinedState


# The most combinations that are examined, the answer's own and those by its failing signs.
COMBINATIONS = 10
# Signs that fail by less than this part of the limit of the distance do not change the combination.
HARDLY = 0.1
# Friction within this relative distance of its bound is at its bound.
AT_BOUND = 1e-9
# Refinement has converged if the last correction is below this part of the limit of the distance.
REFINED = 1e-3
# Reasons for refusing an answer, or for not comparing it.
OUT_OF_TIME = "the time limit ended the search before the answer was compared with that of its own states"
NONE_HOLDS = "no combination of open, stick and slip near the answer's own has an answer whose signs hold"
NO_INVERSE = "the system of its combination of open, stick and slip has no inverse"
UNSETTLED = (
    "refinement does not settle from it: it is far from the answer of its combination of open, stick and slip, or the "
    "system of that is singular to working precision"
)
BY_ITERATION = "the answer of its combination was found by iteration, to 1e-10 in energy"
# The most operations for factorising the system of one combination (some seconds).
MOST_OPERATIONS = 2e11


@dataclass(frozen=True, eq=False)
class _Distance:
    """The distances of an answer from that of its states, each with its scale [square root of energy]."""

    displacement: tuple[float, float]
    force: tuple[float, float]
    contact: tuple[float, float]
    worst: int  # the contact with the largest distance of forces
    failing: float  # change by failing signs
    size: float  # of the forces of the combination, |l_c|_W
    rounding: float  # rounding of the distance of displacements
    forgiven: tuple[float, float]  # rounding of displacement and forces without strain

    def relative(self, nothing: float) -> dict[str, float]:
        """Return the three distances over their scales, including failing signs; distances up to `nothing` are zero.

        Rounding of the answer to doubles is subtracted.
        """
        moved, pushed = self.forgiven
        return {
            "displacement": _part(self.displacement[0] - moved + self.failing, self.displacement[1], nothing),
            "contact forces": _part(self.force[0] - pushed + self.failing, self.force[1], nothing),
            "contact": _part(self.contact[0] + self.failing, self.contact[1], nothing),
        }


def state_verdict(
    problem: ContactProblem,
    answer: Answer,
    found: Violations,
    condensation: Condensation | None,
    tolerances: tuple[float, float],
) -> StateVerdict:
    """Compare a frictional answer with that of its own combination of states.

    Parameters
    ----------
    problem, answer, found : ContactProblem, Answer, and the Violations of the answer
    condensation : Condensation or None
        None where the bodies are not condensed: sparse systems compare where contacts are many, else nothing does.
    tolerances : two floats
        The largest distance that passes, relative; and the part of the intrinsic size that is nothing.
    """
    tolerance, nothing = tolerances[0], tolerances[1] * found.intrinsic_size
    bodies: Bodies
    if condensation is not None:
        if (reason := _too_large(problem, condensation, answer)) is not None:
            return figures_alone(reason)
        bodies = CondensedBodies(problem, condensation)
    elif seconds_of_unfinished() is not None:
        return _out_of_time()
    elif (systems := systems_of(problem)) is Systems.ITERATED:
        bodies = IteratedBodies(problem)
    elif systems is Systems.SPARSE:
        bodies = SparseBodies(problem)
    else:
        return figures_alone("the bodies are not factorised as a whole")
    try:
        compared = _Comparison(problem, answer, found, bodies)
        nothing = min(nothing, tolerance * compared.pushed_by_loads())
        distance, reason = compared.nearest(tolerance, nothing)
    except BackendFailed as error:
        distance, reason = None, str(error)
    except NotConverged:
        if seconds_of_unfinished() is None:
            raise
        return _out_of_time()
    if reason is not None:
        return with_friction_held(problem, answer, condensation, tolerance, nothing, reason)
    if distance is None:
        return StateVerdict(STATE, float("inf"), failures=(f"state: {NONE_HOLDS}",))
    relative = distance.relative(nothing)
    largest = max(relative.values())
    failures: tuple[str, ...] = ()
    if not all(part <= tolerance for part in relative.values()):  # NaN fails
        failures = messages.of_distances(problem, distance.worst, relative, tolerance)
    if compared.redundant and not failures:
        held = "redundant contacts: forces are compared as far as the bodies feel them"
        return StateVerdict(STATE, largest, distance.displacement[1], notes=(held,), displacement=compared.displacement)
    notes = (BY_ITERATION,) if isinstance(bodies, IteratedBodies) else ()
    beside = None if failures else compared.compared
    return StateVerdict(STATE, largest, distance.displacement[1], failures, notes, compared.displacement, beside)


def _out_of_time() -> StateVerdict:
    return replace(figures_alone(OUT_OF_TIME), failures=(f"state: {OUT_OF_TIME}",))


def remember_verdict(
    problem: ContactProblem, answer: Answer, tolerances: tuple[float, float], verdict: StateVerdict
) -> None:
    """Keep the verdict of an answer on candidate contacts for the certificate of the whole problem.

    Parameters
    ----------
    problem, answer, tolerances, verdict : as `state_verdict` takes and returns them
    """
    problem._computed.judged_state = _numbers(problem, answer, tolerances), verdict


def last_verdict(problem: ContactProblem, answer: Answer, tolerances: tuple[float, float]) -> StateVerdict | None:
    """Return the verdict kept last if it is that of this answer."""
    cached: tuple[Array, StateVerdict] | None = problem._computed.judged_state
    if cached is None or not np.array_equal(cached[0], _numbers(problem, answer, tolerances)):
        return None
    return cached[1]


def _numbers(problem: ContactProblem, answer: Answer, tolerances: tuple[float, float]) -> Array:
    """Return all numbers that a verdict depends on, besides the stiffness and the rows, as one vector."""
    parts = [problem.load, problem.load_size, problem.gap, problem.tie_value, problem.friction, problem.slip_origin]
    parts += [answer.displacement, answer.normal_force, answer.tie_force, answer.friction_force]
    return np.concatenate([*(part.ravel() for part in parts if part is not None), tolerances])


def _too_large(problem: ContactProblem, condensation: Condensation, answer: Answer) -> str | None:
    closed = int(np.count_nonzero(answer.normal_force))
    width = 1 if problem.slip_origin is None else problem.slip_origin.shape[1]
    size = float(len(condensation.retained) + (1 + width) * closed + problem.ties)
    if 2 / 3 * size**3 <= MOST_OPERATIONS:
        return None
    return f"the system of its combination, {size:.0f} equations, is too large to be solved beside it"


class CondensedBodies:
    """Bodies that are condensed onto their contacts."""

    def __init__(self, problem: ContactProblem, condensation: Condensation) -> None:
        self._problem, self._condensation = problem, condensation
        for saddle in condensation.saddles.values():  # a verdict does not depend on what was refined before
            saddle.contraction = None
        self._rows = condensed_frictional_rows(problem, condensation)
        self.width, self.frictional = self._rows.width, self._rows.slides & (self._rows.coefficient > 0)
        self.floats = condensation.rigid.count > 0
        compliance = contact_compliance(problem, condensation)
        per_contact = compliance.W.diagonal().reshape(problem.contacts, -1)
        per_contact = np.where(per_contact > FIXED_BY_TIES, per_contact, 0.0) * compliance.scale[:, None] ** 2
        self.along, self.across = per_contact[:, 0], per_contact[:, 1:].max(axis=1, initial=0.0)

    def refined(self, status: Status, start: Answer) -> RefinedState:
        """Return the answer of a combination, refined from a start."""
        from contactqp.linalg.friction_states import refined_in

        left = kept_residuals(self._problem, start)
        return refined_in(self._problem, self._condensation, self._rows, status, start, independent=True, left=left)

    def response_norm(self, normal: Vector, friction: Array) -> float:
        """Return the energy norm of the response of the tied bodies to contact forces (m,), (m, d-1)."""
        condensation, rows = self._condensation, self._rows
        along = (friction * rows.tangent_length[:, None]).ravel() @ rows.tangent
        load = normal @ condensation.normal + along / rows.scale
        saddle = saddle_point(condensation, np.zeros(0, dtype=np.intp))
        x, _, _ = saddle.solve(load, np.zeros(0), np.zeros(self._problem.ties))
        return float(np.sqrt(max(float(load @ x), 0.0)))

    def untied_norm(self, normal: Vector, friction: Array, tie: Vector) -> tuple[float, float] | None:
        """Return the energy norm of the response of untied bodies to all forces, and a bound on its error."""
        rows = extended_rows(self._problem)
        load = rows.contact_force(extend(normal), extend(tie)) + rows.friction_force(extend(friction.ravel()))
        u, left = response(self._problem, self._condensation, load, tied=False)
        norm, rounding = energy_norm(self._problem, u)
        return norm, rounding + left

    def rounding(self, displacement: Vector) -> float:
        """Return the energy norm of the rounding of a rigid displacement."""
        return rigid_rounding(self._problem, self.floats, displacement)


class _Comparison:
    """The comparison of one answer with the answers of combinations of states."""

    def __init__(self, problem: ContactProblem, answer: Answer, found: Violations, bodies: Bodies) -> None:
        self._problem, self._answer, self._found = problem, answer, found
        self._bodies, self._width, self._frictional = bodies, bodies.width, bodies.frictional
        self._along, self._across = bodies.along, bodies.across
        self._slip = self.slip(answer.displacement)
        # |E_i D|^2 of normal and tangential rows, and of the bodies where a row touches nothing stiff.
        normal, along = row_sizes(problem, problem.normal).compliance, row_sizes(problem, problem.tangent)
        tangent = along.compliance.reshape(problem.contacts, -1).max(axis=1, initial=0.0)
        self._own = np.where(normal > 0, normal, self._along), np.where(tangent > 0, tangent, self._across)
        given = np.zeros(self._slip.shape) if answer.friction_force is None else answer.friction_force
        self.friction, self._dragged, self._slipped = given, lengths(given), lengths(self._slip)
        self.still = lengths(found.nothing.tangent.reshape(-1, self._width))  # slips (m,) up to which there is none
        # Along a tangent whose unknowns are all supported any friction is right.
        self._felt = along.lengths(np.ones(problem.dimension)).reshape(problem.contacts, -1) > 0
        self.redundant = False  # whether the compared combination has forces that are not unique
        self.displacement: Vector | None = None  # of that combination
        self.compared: Compared | None = None

    def nearest(self, tolerance: float, nothing: float) -> tuple[_Distance | None, str | None]:
        """Return the distance to the first combination whose signs hold, None, or the reason for having none.

        Contacts at their friction bound with negligible slip stick first; if that leads far away they slip.
        """
        believed = self._believed()
        found, reason = self._nearest_from(believed, tolerance, nothing)
        most = self.coefficient * np.maximum(self._answer.normal_force, 0.0)
        slides = (believed == STICK) & (most > 0) & (self._dragged >= (1 - AT_BOUND) * most)
        if not slides.any() or (found is not None and max(found.relative(nothing).values()) <= tolerance):
            return found, reason
        kept = self.redundant, self.displacement, self.compared
        sliding = np.where(slides, self._sliding(), believed).astype(np.int8)
        other, _ = self._nearest_from(sliding, tolerance, nothing)
        if other is not None and max(other.relative(nothing).values()) <= tolerance:
            return other, None
        self.redundant, self.displacement, self.compared = kept
        return found, reason

    def _nearest_from(self, status: Status, tolerance: float, nothing: float) -> tuple[_Distance | None, str | None]:
        """Return `nearest` starting from one combination."""
        seen: set[bytes] = set()
        for _ in range(COMBINATIONS):
            refuse_late("another combination was compared", judging=True)
            seen.add(status.tobytes())
            refined = self._bodies.refined(status, self._answer)
            if not refined.regular:
                return None, NO_INVERSE
            moved, _ = energy_norm(self._problem, refined.last.displacement)
            strain, unsure = energy_norm(self._problem, refined.displacement)
            if not self._problem.diagonal.any():  # without elastic parts, lengths and forces are compared directly
                strain = self._longest(strain)
            reached = refined.displacement.double()
            signs = _Signs(self, refined, status, HARDLY * tolerance * strain)
            distance = self._distance(refined, signs, strain)
            limit = tolerance * max(distance.displacement[1], distance.force[1])
            last = self._last_correction(refined, moved)
            if not last <= max(REFINED * limit, nothing):
                return None, UNSETTLED
            if signs.failing <= max(HARDLY * limit, nothing):
                self.redundant, self.displacement = refined.redundant, reached
                self.compared = self._comparison(refined, status, distance, last, unsure)
                return distance, None
            status = signs.changed(status)
            if status.tobytes() in seen:
                return None, None
        return None, None

    def _comparison(
        self, refined: RefinedState, status: Status, distance: _Distance, last: float, unsure: float
    ) -> Compared:
        """Return the result of the comparison with a refined answer, and its distance.

        Parameters
        ----------
        refined, status : the refined answer of a combination, and its states
        distance : the distance of the answer from it
        last : size of the last correction of the refinement
        unsure : by which rounding may change its energy norm
        """
        (moved, strain), (pushed, _) = distance.displacement, distance.force
        moved += distance.rounding
        still = np.where(np.isfinite(self.still), self.still, 0.0)
        return Compared(refined, status, self._frictional, moved, pushed, last, strain, distance.size, unsure, still)

    def _last_correction(self, refined: RefinedState, moved: float) -> float:
        """Return the size of the last correction, whose displacement has the energy norm `moved` [root of energy]."""
        forces, last = (refined.normal_force.double(), refined.friction_force.double()), refined.last
        rounding = FINE_EPS * max(float(abs(part).max(initial=0.0)) for part in forces)
        normal, along = (np.where(abs(x) > rounding, x, 0.0) for x in (last.normal_force, last.friction_force))
        return float(np.hypot(moved, self._bodies.response_norm(normal, along)))

    def _believed(self) -> Status:
        """Return the states (m,): closed where the force as a length exceeds the gap, slipping where slip exceeds room.

        Room is the difference of friction from its bound, as a length.
        """
        force, gap, size = self._answer.normal_force, self._found.gap, self._slipped
        room = self.coefficient * np.maximum(force, 0.0) - self._dragged
        # With negligible slip its direction is uncertain, and the contact sticks at its bound.
        moved = np.where(size > self.still, size, 0.0)
        sticks = (moved == 0) | (self._across * room > moved)
        status = np.where(sticks & self._frictional, STICK, self._sliding())
        # If ties fix all unknowns of a contact, it is closed if it has a force.
        touching = gap <= (nothing := self._found.nothing.normal)
        gap = np.where(gap < -nothing, gap, np.maximum(gap, 0.0))  # touching contacts without a force are open
        closed = np.where(self._along > 0, self._along * force > gap, (force > 0) & touching)
        return np.where(closed, status, OPEN).astype(np.int8)

    def _sliding(self) -> Status:
        """Return the slip states (m,) along the slip, or along friction without slip; in space all are SLIP_ON."""
        if self._width > 1:
            return np.full(len(self._slip), SLIP_ON, dtype=np.int8)
        direction = np.where(self._slipped > self.still, self._slip[:, 0], self.friction[:, 0])
        return np.where(direction < 0, SLIP_BACK, SLIP_ON).astype(np.int8)

    @cached_property
    def coefficient(self) -> Vector:
        """The coefficients of friction (m,), 0 where a contact cannot slide."""
        assert self._problem.friction is not None
        return np.where(self._frictional, self._problem.friction, 0.0)

    def slip(self, displacement: object) -> Array:
        """Return the slips E_T u - slip_origin (m, d-1)."""
        origin = self._problem.slip_origin
        assert origin is not None
        moved = extended_rows(self._problem).slip(extend(displacement)) - extend(origin.ravel())
        return np.asarray(moved.double().reshape(-1, self._width))

    def _distance(self, refined: RefinedState, signs: _Signs, strain: float) -> _Distance:
        """Return the distance from a refined answer whose displacement has the energy norm `strain`."""
        problem, answer = self._problem, self._answer
        push, other = refined.normal_force.double(), refined.friction_force.double().reshape(-1, self._width)
        normal = (extend(answer.normal_force) - refined.normal_force).double()
        apart, rounding = energy_norm(problem, extend(answer.displacement) - refined.displacement)
        apart_in_friction = (extend(self.friction.ravel()) - refined.friction_force).double().reshape(other.shape)
        dragged = np.where(self._frictional[:, None] & self._felt, apart_in_friction, 0.0)
        of_forces, change = self._bodies.response_norm(push, other), self._bodies.response_norm(normal, dragged)
        own_size = max(force_size(problem, problem.normal, push), force_size(problem, problem.tangent, other.ravel()))
        # Forces along a rigid motion have no elastic response, only rounding.
        felt = of_forces > max(NEXT_TO_NOTHING * strain, np.sqrt(RIGID_ROUNDING) * own_size * self._bodies.floats)
        size = of_forces if felt else strain
        whole = max(size, own_size)
        own_normal, own_tangent = self._own
        if not problem.diagonal.any():
            own_normal, own_tangent = (squared_lengths(rows, problem) for rows in (problem.normal, problem.tangent))
            given = abs(answer.normal_force) * np.sqrt(own_normal)
            whole = max(float(given.max(initial=0.0)), float(problem.load_size.max(initial=0.0)))
        of_contact = np.hypot(abs(normal) * np.sqrt(own_normal), lengths(dragged) * np.sqrt(own_tangent))
        if refined.redundant:
            of_contact = np.zeros_like(of_contact)
        worst = int(np.argmax(of_contact))
        return _Distance(
            (apart, strain),
            max((change, size), self._with_ties(refined, normal, dragged), key=lambda one: _part(one[0], one[1], 0.0)),
            (float(of_contact[worst]), whole),
            worst,
            signs.failing,
            of_forces,
            rounding,
            (self._rounding(), RIGID_ROUNDING * whole if problem.ties or self._bodies.floats else 0.0),
        )

    def _longest(self, least: float) -> float:
        """Return the longest of the lengths that meet at contacts in units of energy, at least `least`."""
        met = in_energy(self._found.lengths, self._own[0])
        return float(np.max(met[np.isfinite(met)], initial=least))

    def _with_ties(self, refined: RefinedState, normal: Vector, dragged: Array) -> tuple[float, float]:
        """Return the distance of all forces on untied bodies and their size; else that of ties at their unknowns."""
        if not self._problem.ties:
            return 0.0, 1.0
        push, other = refined.normal_force.double(), refined.friction_force.double().reshape(-1, self._width)
        tie, missed = refined.tie_force, extend(self._answer.tie_force) - refined.tie_force
        whole = self._bodies.untied_norm(push, other, tie.double())
        apart = self._bodies.untied_norm(normal, dragged, missed.double())
        if whole is not None and apart is not None and whole[1] <= FEW_DIGITS * whole[0]:
            return apart[0], whole[0]
        if refined.redundant:
            return 0.0, 1.0
        largest = np.max(own_forces(self._problem, push, tie.double()))
        return float(np.max(own_forces(self._problem, np.zeros_like(push), missed.double()))), float(largest)

    def pushed_by_loads(self) -> float:
        """Return the strain by loads with all other unknowns fixed [square root of energy], infinite without loads.

        For a gap that a body crosses rigidly, lengths that count as zero may be larger.
        """
        pushed = float((self._problem.own_scale * self._problem.load_size).max(initial=0.0))
        return pushed if pushed > 0 else float("inf")

    def _rounding(self) -> float:
        """Return the energy norm of rounding the displacement to doubles."""
        size = abs(self._answer.displacement)
        held = HELD_BY_DOUBLES * np.sqrt(size @ (self._problem.stiffness_sizes @ size))
        return max(float(held), self._bodies.rounding(self._answer.displacement) if self._bodies.floats else 0.0)


class _Signs:
    """The signs of the answer of a combination, and the change that corrects failing ones.

    A gap of the refined answer fails if it exceeds rounding of the lengths that meet, or if closing it costs more than
    `least`, a part of the strain [square root of energy], as lengths that count as zero relative to a far gap may
    exceed all strain.
    """

    def __init__(self, of: _Comparison, refined: RefinedState, status: Status, least: float) -> None:
        problem, nothing = of._problem, of._found.nothing
        slip = of.slip(refined.displacement)
        gap = extended_rows(problem).gap(problem, refined.displacement).double()
        force = refined.normal_force.double()
        self._friction = refined.friction_force.double().reshape(-1, of._width)
        own_normal, own_tangent = of._own
        closing = in_energy(np.maximum(-gap, 0.0), own_normal)
        meets = (-gap > nothing.normal) | (closing > least)
        penetrated = np.where((status == OPEN) & meets, np.maximum(-gap, 0.0), 0.0)
        tension = np.where(status != OPEN, np.maximum(-force, 0.0), 0.0)
        beyond = np.maximum(lengths(self._friction) - of.coefficient * np.maximum(force, 0.0), 0.0)
        beyond = np.where((status == STICK) & of._frictional, beyond, 0.0)
        sliding = (abs(status) == 1) & of._frictional
        against = np.maximum(-(refined.directions * slip).sum(axis=1), 0.0)
        against = np.where(sliding & (against > of.still), against, 0.0)
        self._lengths = np.hypot(in_energy(penetrated, own_normal), in_energy(against, own_tangent))
        self._penetrated, self._tension, self._beyond, self._against = penetrated, tension, beyond, against
        excess = beyond[:, None] * directions_of(self._friction)
        pushed = of._bodies.response_norm(-tension, excess) if tension.any() or beyond.any() else 0.0
        self.failing = float(np.hypot(np.linalg.norm(self._lengths), pushed))

    def changed(self, status: Status) -> Status:
        """Return the corrected states: penetrated contacts stick, those in tension open, others slip on or stick."""
        slips = np.where(self._friction[:, 0] < 0, SLIP_BACK, SLIP_ON) if self._friction.shape[1] == 1 else SLIP_ON
        changed = np.where(self._penetrated > 0, STICK, status)
        changed = np.where(self._beyond > 0, slips, changed)
        changed = np.where(self._against > 0, STICK, changed)
        return np.where(self._tension > 0, OPEN, changed).astype(np.int8)


def _part(size: float, scale: float, nothing: float) -> float:
    if size <= nothing:
        return 0.0
    return size / scale if scale > nothing else float("inf")
