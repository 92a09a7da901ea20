"""The textbook's active-set loop with friction, in which every contact is open, sticks, or slips one way or the other.

The system of the current statuses is solved. Then an open contact that penetrates closes and sticks, a closed one in
tension opens, a sticking one with |l_T| > mu l_N slips in the direction of its friction, and a slipping one whose slip
opposes its friction sticks. This is repeated until nothing changes. If it cycles, or if so many contacts opened that a
body floats, one contact is changed at a time, the one of least index first, to an untried combination; where bodies
float, then also one while another that slips sticks instead, as the first may be the last that holds them. If none is
left, the search goes back to an earlier step. With several contacts this may take long, and above a critical
coefficient of friction there may be no answer or several (Klarbring 1990), of which the first found is taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np
import scipy.sparse as sp

from contactqp.errors import NotConverged
from contactqp.model.arrays import Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status, status_names
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate
from contactqp.solving.methods.method import Settings
from contactqp.solving.methods.stick_and_slip import (
    FrictionalEnforcement,
    FrictionalStep,
    coefficients,
    origins,
    status_rows,
)
from contactqp.solving.methods.textbook_algebra import FloatingBodies, SingularSystem
from contactqp.solving.methods.textbook_loop import Budget, Sizes, last_candidate

# The most contacts named in a message.
MOST_NAMES = 8
# What helps where this search, of contacts with wrong signs alone, comes to an end.
CURE = "try active-set, which searches among all contacts"


def status_loop(
    name: str,
    problem: ContactProblem,
    settings: Settings,
    enforce: FrictionalEnforcement,
    *,
    compliance: Vector | None = None,
    stiffness: tuple[Vector, Vector] | None = None,
) -> Candidate:
    """Repeat `enforce` on the statuses until they no longer change.

    The first statuses are those of `settings.warm_start`, else all open, or all stuck if the bodies float.

    Raises NotConverged: the first system is singular, or every one that may follow.

    Parameters
    ----------
    name : the method's name, for messages
    problem : ContactProblem
    settings : limits, and the answer to start from
    enforce : solves the system of one status
    compliance : (m,) array, optional
        The compliance of tangential springs [length / force], zero by default. The slip is E_T u - o less the spring's
        own stretch.
    stiffness : two (m,) arrays, optional
        Forces that one unit of normal and of tangential length make [force / length], zero by default. Rounding of
        lengths is seen in the forces by these factors.

    Returns
    -------
    Candidate
        `history` is the number of contacts whose status is wrong, one number an iteration. Not claimed where no
        combination is left to try, or where the loop stops at `settings.max_iter` (50 m + 200) or at
        `settings.time_limit`.
    """
    none = np.zeros(problem.contacts)
    loop = _Loop(
        name, problem, settings, enforce, none if compliance is None else compliance, stiffness or (none, none)
    )
    try:
        return loop.run()
    except SingularSystem as error:
        raise NotConverged(f"{error}; {CURE}", tuple(loop.history)) from None


class _Loop:
    def __init__(
        self,
        name: str,
        problem: ContactProblem,
        settings: Settings,
        enforce: FrictionalEnforcement,
        compliance: Vector,
        stiffness: tuple[Vector, Vector],
    ) -> None:
        self._name, self._problem, self._settings, self._enforce = name, problem, settings, enforce
        self._compliance, self._stiffness = compliance, stiffness
        self._bodies = FloatingBodies(problem)
        self._sizes = Sizes.of(problem, self._bodies)
        self._tangent, self._origin = sp.csr_array(problem.tangent), origins(problem)
        self._friction = coefficients(problem)
        self._budget = Budget(settings, 50 * problem.contacts + 200)
        self._together: int | None = None  # iterations that changed all wrong contacts, once single changes have begun
        self._tried: set[bytes] = set()
        self._singular: SingularSystem | None = None  # the first of several
        self._ways: list[Iterator[tuple[Status, Mask]]] = []  # alternatives of earlier steps
        self.history: list[float] = []

    def run(self) -> Candidate:
        step = self._first_step()
        while True:
            following = self._following(step)
            wrong = following != step.status
            self.history.append(float(np.count_nonzero(wrong)))
            reason, after = self._stop(wrong), None
            if not reason:
                after = self._next_step(step, following)
                reason = (
                    ""
                    if after
                    else f"no combination of open, stick and slip is left to try that could mend {self._named(wrong)}; "
                    + CURE
                )
            if after is None:
                return self._candidate(step, reason)
            step = after

    def _first_step(self) -> FrictionalStep:
        first = self._warm_status()
        none = np.zeros(len(first), dtype=bool)
        found = self._untried(first, none) or self._untried(self._closing(), none)
        if found is None:
            raise self._singular or SingularSystem(f"{self._name}: no system to begin with")
        return found

    def _warm_status(self) -> Status:
        """Return the statuses of a warm start; contacts with force stick unless it states that they slip."""
        warm = self._settings.warm_start
        if warm is None:
            return np.full(self._problem.contacts, OPEN, dtype=np.int8)
        closing = self._closing()
        friction = warm.answer.friction_force
        if warm.contact_status is not None and friction is not None:
            slips = (warm.contact_status == "slip") & (friction[:, 0] != 0)
            closing = np.where(slips, np.sign(friction[:, 0]), closing)
        return np.where(warm.answer.normal_force > 0, closing, OPEN).astype(np.int8)

    def _closing(self) -> Status:
        """Return the statuses of closing contacts, which stick, or slip if they have no friction."""
        return np.where(self._friction > 0, STICK, SLIP_ON).astype(np.int8)

    def _next_step(self, step: FrictionalStep, following: Status) -> FrictionalStep | None:
        """Return the step of the next system, None if all alternatives have been tried."""
        if self._together is None:
            # Of dependent rows the contact that has just penetrated is kept.
            found = self._untried(following, (step.status != OPEN) | (following == OPEN))
            if found is not None:
                return found
            self._together = len(self.history)
        self._ways.append(_one_by_one(step, following))
        if self._bodies.rigid.shape[1]:
            self._ways[-1] = chain(self._ways[-1], _exchanged(step, following, self._friction > 0))
        while self._ways:
            for changed, newcomer in self._ways[-1]:
                found = self._untried(changed, ~newcomer)
                if found is not None:
                    return found
            self._ways.pop()  # then go back to alternatives of the previous step
        return None

    def _untried(self, status: Status, last: Mask) -> FrictionalStep | None:
        """Return the step of a status, None where it has been tried or is singular.

        Of dependent rows those of the contacts `last` are left out first.
        """
        if status.tobytes() in self._tried:
            return None
        self._tried.add(status.tobytes())
        try:
            found = self._step(status, np.argsort(last, kind="stable"))
        except SingularSystem as error:
            self._singular = self._singular or error
            return None
        if found.status.tobytes() != status.tobytes():
            if found.status.tobytes() in self._tried:
                return None
            self._tried.add(found.status.tobytes())
        return found

    def _step(self, status: Status, preference: Indices) -> FrictionalStep:
        if self._bodies.rigid.shape[1]:
            rows = status_rows(self._name, self._problem, status, preference, independent=False)
            if not all(self._bodies.held_by(self._bodies.unit(side)) for side in (rows.held, rows.pushed)):
                raise SingularSystem(
                    f"{self._name}: the bodies are not held where {self._named(status == STICK)} stick and "
                    f"{self._named(abs(status) == 1)} slip"
                )
        return self._enforce(status, preference)

    def _following(self, step: FrictionalStep) -> Status:
        """Return the status of every contact by the signs of this answer; violations within rounding change nothing."""
        problem, status, friction = self._problem, step.status, self._friction
        if problem.contacts == 0:
            return status
        u, normal, tangential = step.answer.displacement, step.answer.normal_force, step.friction
        pushes = ((problem.normal, normal), (self._tangent, tangential), (problem.tie, step.answer.tie_force))
        holds = (
            (problem.normal, problem.gap, status != OPEN),
            (self._tangent, self._origin, status == STICK),
            (problem.tie, problem.tie_value, np.ones(problem.ties, dtype=bool)),
        )
        noise = self._sizes.noise(u, self._sizes.forces(u, pushes), holds)
        length, shift = noise.of_lengths(problem.normal, problem.gap), noise.of_lengths(self._tangent, self._origin)
        push = noise.of_forces(problem.normal) + self._stiffness[0] * length
        drag = noise.of_forces(self._tangent) + self._stiffness[1] * shift
        slip = self._tangent @ u - self._origin
        stuck, slides = status == STICK, (abs(status) == 1) & (friction > 0)
        beyond = stuck & (abs(tangential) > friction * np.maximum(normal, 0.0) + drag + friction * push)
        # The tangential row was dependent and left out, so the contact slips although it should stick.
        loose = stuck & (tangential == 0) & (abs(slip) > shift)
        against = slides & (status * (slip - self._compliance * tangential) < -(shift + self._compliance * drag))
        found = status.copy()
        found[beyond] = np.where(tangential[beyond] > 0, SLIP_ON, SLIP_BACK)
        found[loose] = np.where(slip[loose] > 0, SLIP_ON, SLIP_BACK)
        found[against] = STICK
        found[(status != OPEN) & (normal < -push)] = OPEN
        closing = (status == OPEN) & (problem.normal @ u - problem.gap > length)
        return np.where(closing, self._closing(), found).astype(np.int8)

    def _stop(self, wrong: Mask) -> str:
        """Return the reason why the loop ends here, or an empty string."""
        if not wrong.any():
            return "open, stick and slip no longer change"
        spent = self._budget.spent(len(self.history))
        return f"{spent}, while {self._named(wrong)} still changed" if spent else ""

    def _candidate(self, step: FrictionalStep, reason: str) -> Candidate:
        found = last_candidate(self._name, step, reason, self.history, self._together)
        return replace(found, contact_status=status_names(step.status))

    def _named(self, contacts: Mask) -> str:
        indices = np.flatnonzero(contacts)
        names = ", ".join(self._problem.contact_name(int(i)) for i in indices[:MOST_NAMES])
        return (names or "no contacts") + (", ..." if indices.size > MOST_NAMES else "")


def _one_by_one(step: FrictionalStep, following: Status) -> Iterator[tuple[Status, Mask]]:
    """Yield statuses in which one wrong contact is changed, and that contact, first by its signs, then to other
    states.
    """
    wrong = np.flatnonzero(following != step.status)
    pushed = np.where(step.friction < 0, SLIP_BACK, SLIP_ON)
    ways = [following, pushed, -pushed, np.full_like(following, STICK), np.full_like(following, OPEN)]
    for way in ways:
        for i in wrong:
            if way[i] != step.status[i]:
                changed = step.status.copy()
                changed[i] = way[i]
                yield changed, changed != step.status


def _exchanged(step: FrictionalStep, following: Status, rough: Mask) -> Iterator[tuple[Status, Mask]]:
    """Yield statuses in which a wrong contact is changed by its signs while a slipping one sticks instead, and both.

    Of bodies that float the contact may be the last one that holds them.
    """
    for i in np.flatnonzero(following != step.status):
        for j in np.flatnonzero((abs(step.status) == 1) & rough):
            if i != j:
                changed = step.status.copy()
                changed[i], changed[j] = following[i], STICK
                yield changed, changed != step.status
