"""The steps of a motion: each stated by the scheme, solved, and certified together with its neighbours.

A step must resolve how long a contact lasts: half a period of the slowest vibration that an impact excites. A rod of
length L that hits a wall stays for 2 L / c, half the period of its slowest vibration with the touching end fixed. On
matrices: omega is the lowest frequency with the closed contacts kept closed that is not zero and that the velocities at
the impact excite, the time is pi / omega. It comes from Lanczos' method on the operator of a time step, which is
factorised already; only frequencies that a step is too long to resolve need be found, and these are far apart there.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.analysis.motion.mass_matrix import critical_step, touched
from contactqp.analysis.motion.motion_history import Motion, MotionHistory, said_of_motion
from contactqp.analysis.motion.schemes.scheme import Scheme, State
from contactqp.analysis.motion.step_certificate import StepJudge
from contactqp.analysis.motion.step_contact import StepContact, StepProblem, StepResult
from contactqp.errors import (
    BackendFailed,
    InvalidProblem,
    NoEquilibrium,
    NotCertified,
    NotConverged,
    SeveralEquilibria,
    TimeStepWarning,
    warn,
)
from contactqp.linalg.runtime import CERTIFY, METHOD, stage
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import refuse_not_positive
from contactqp.model.solution import Work

# Frequencies whose share of a step's operator is this near to one are rigid motions, or well resolved.
RESOLVED_SHARE = 1e-9
# Steps certified at once.
BLOCK = 64
TOLERANCE = 1e-9
# A duration that is this near to a whole number of steps is one.
WHOLE = 1e-6
# Times of more steps than this are no longer apart in double precision.
MOST_STEPS = 2.0**53
# A contact that lasts less than so many steps is not resolved.
RESOLVED = 10
# Central differences may step at their critical step, known to this part.
CRITICAL = 1e-6
# Enough to part the slowest vibration from others where the step is long.
LANCZOS_STEPS = 24
# Shares below this are the rounding of motions that contacts hold: a step would last for a million contacts.
HELD = 1e-13
# A vector that this part is left of lies in the space that was spanned before.
SPANNED = 1e-12


class MotionRun:
    """One motion while its steps are taken."""

    def __init__(
        self, scheme: Scheme, load: Callable[[float], Vector], start: float, method: str, options: dict[str, Any]
    ) -> None:
        self._scheme, self._load = scheme, load
        self._contacts = tuple(StepContact(template, method, options) for template in scheme.templates)
        self._judges = tuple(StepJudge(template) for template in scheme.templates)
        self._pending: list[list[tuple[StepProblem, StepResult]]] = [[] for _ in scheme.templates]
        self._notes: list[str] = []
        self._certified = 0  # steps
        self._impacts = FirstImpacts(scheme.body.problem)
        self._motion = Motion(scheme, [], load, start, method, [0.0], self._work)

    def start(self, u: Vector, v: Vector) -> None:
        self._motion.states.append(self._scheme.first(u, v, self._load(self._motion.start)))

    def lasting(self, duration: float) -> MotionHistory:
        """Take the steps of a duration and return the history from the start."""
        refuse_not_positive("duration", duration)
        with np.errstate(over="ignore"):
            ratio = float(np.float64(duration) / self._scheme.body.step)
        if ratio > MOST_STEPS:
            raise InvalidProblem(
                f"duration: {duration:g} takes more steps of {self._scheme.body.step:g} than can be counted"
            )
        if ratio < 1 - WHOLE:
            step = self._scheme.body.step
            raise InvalidProblem(f"time_step: expected one no longer than the duration, {duration:g}, got {step:g}")
        whole = abs(ratio - round(ratio)) <= WHOLE
        return self._steps(round(ratio) if whole else int(np.ceil(ratio)))

    def _resumed(self, states: list[State], duration: float) -> MotionHistory:
        """Continue from these states for `MotionHistory.resume`, and leave the first history untouched."""
        twin = copy.copy(self)
        twin._motion = replace(self._motion, states=list(states), seconds=list(self._motion.seconds), work=twin._work)
        twin._impacts = copy.deepcopy(self._impacts)
        twin._notes, twin._pending = list(self._notes), [[] for _ in self._pending]
        twin._certified = len(states) - 1
        return twin.lasting(duration)

    def _steps(self, count: int) -> MotionHistory:
        """Take a number of steps and certify them."""
        began, motion = time.perf_counter() - self._motion.seconds[0], self._motion
        first, state = len(motion.states), motion.states[-1]
        load = self._load(motion.time(first - 1))
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(first, first + count):
                next_load = self._load(motion.time(k))
                before, state = state, self._step(state, load, next_load)
                motion.states.append(state)
                load = next_load
                if self._impacts.awaited:
                    self._check_contact_time(self._impacts.new(before, state), before, state, k)
                if k % BLOCK == 0 or k == first + count - 1:
                    motion.seconds[0] = time.perf_counter() - began
                    self._judge(k)
        return self.history

    @property
    def history(self) -> MotionHistory:
        notes = tuple(self._notes)  # of the steps until now
        return MotionHistory(self._motion, lambda: (*notes, *said_of_motion(self._motion)), self._resumed)

    def _step(self, state: State, load: Vector, next_load: Vector) -> State:
        answers: tuple[StepResult, ...] = ()
        for contact, pending in zip(self._contacts, self._pending, strict=True):
            posed = self._scheme.pose(state, load, next_load, answers)
            try:
                with stage(METHOD):
                    found = contact.solve(posed)
            except (NotConverged, NotCertified, BackendFailed, NoEquilibrium, SeveralEquilibria) as error:
                done = len(self._motion.states) - 1
                for pairs in self._pending:
                    del pairs[self._steps_since(done) :]  # a step of two problems may have answered one
                self._judge(done)
                raise NotConverged(f"{self._scheme.name}: step {done + 1}: {error}", self.history) from error
            pending.append((posed, found))
            answers = (*answers, found)
        return self._scheme.accept(state, answers)

    def _steps_since(self, done: int) -> int:
        """Count the steps so far that no block has certified."""
        return done - self._certified

    def _judge(self, last: int) -> None:
        """Certify the steps since the last block."""
        for judge, pending, template in zip(self._judges, self._pending, self._scheme.templates, strict=True):
            first = self._certified + 1
            if not pending:
                continue
            with stage(CERTIFY):
                refused = judge.refused([p for p, _ in pending], [a for _, a in pending], TOLERANCE)
            pending.clear()
            if refused is None:
                continue
            step, figure, worst = refused
            instant = self._motion.time(first + step)
            del self._motion.states[first + step :]
            if not np.isfinite(worst):
                raise NotConverged(
                    f"{self._scheme.name}: the motion has left all numbers at time {instant:g}", self.history
                )
            raise NotConverged(
                f"{self._scheme.name}: the certificate refuses the step that ends at time {instant:g}: {figure} is "
                f"{worst:.3g}, tolerance {TOLERANCE:g} ({template!r})",
                self.history,
            )
        self._certified = last

    def _work(self) -> Work:
        return Work(
            factorisations=sum(contact.factorisations for contact in self._contacts),
            back_substitutions=sum(contact.back_substitutions for contact in self._contacts),
            iterations=len(self._motion.states) - 1,
            retained=len(touched(self._scheme.body.problem)),
        )

    def _check_contact_time(self, closing: NDArray[np.intp], before: State, state: State, k: int) -> None:
        """Warn, once, where a step is too long for contacts that close."""
        scheme, h = self._scheme, self._scheme.body.step
        if scheme.inertia is None or not len(closing):
            return
        closed = np.flatnonzero(state.normal_force > 0)
        share = scheme.inertia * scheme.body.mass + scheme.body.stiffness
        contact, template = self._contacts[-1], scheme.templates[-1]
        factor = float(template.stiffness.diagonal().max() / share.diagonal().max())
        omega = slowest_frequency(
            lambda y: factor * contact.respond_closed(y, closed),
            scheme.body.mass,
            scheme.inertia,
            np.where(meeting(scheme.body.problem, scheme.body.mass, closing), before.velocity, 0.0),
        )
        if omega is None or np.pi / omega >= RESOLVED * h:
            return
        self._impacts.awaited = False
        names = ", ".join(scheme.body.problem.contact_name(int(i)) for i in closing[:3])
        self._warn(
            f"time step {h:.3g} is too long to resolve the contact that closes at time {self._motion.time(k):.6g} "
            f"({names}): it lasts about {np.pi / omega:.2g}, half a period of the slowest vibration that it starts; "
            f"take steps of {np.pi / omega / RESOLVED:.2g} or less"
        )

    def check_critical_step(self, penalty: float | None) -> None:
        """Refuse an unstable step; warn of one that penalty springs make unstable, as they act in contact only."""
        body = self._scheme.body
        limit = critical_step(body.mass, body.stiffness)
        if body.step > limit * (1 + CRITICAL):
            raise InvalidProblem(
                f"time_step: {self._scheme.name} is stable up to {limit:.6g} (2 over the highest frequency of "
                f"stiffness and mass), got {body.step:.6g}"
            )
        if penalty is None or self._scheme.springs is None:
            return
        E = body.problem.normal
        touching = critical_step(body.mass, body.stiffness + penalty * (E.T @ E))
        if body.step > touching * (1 + CRITICAL):
            self._warn(
                f"time step {body.step:.6g} is unstable with all contacts closed: contact springs of {penalty:g} are "
                f"stable up to {touching:.6g}"
            )

    def _warn(self, message: str) -> None:
        self._notes.append(message)
        warn(message, TimeStepWarning)


def slowest_frequency(respond: Callable[[Vector], Vector], mass: Any, inertia: float, velocity: Vector) -> float | None:
    """Return omega [1 / time], or None where all motions are rigid.

    Parameters
    ----------
    respond : function
        x = (M s + K)^-1 y with the closed contacts held, s = `inertia`: its frequencies are those of s / (s + omega^2)
        as the eigenvalues of x = respond(s M x).
    mass : (n, n) matrix
    inertia : float
        s [1 / time^2].
    velocity : (n,) array
        What the impact excites: vibrations that have no part in it are not found.
    """
    basis: list[Vector] = []
    images: list[Vector] = []
    vector = respond(inertia * (mass @ velocity))
    for _ in range(LANCZOS_STEPS):
        for other in 2 * basis:
            vector = vector - (other @ (mass @ vector)) * other
        size = np.sqrt(max(float(vector @ (mass @ vector)), 0.0))
        reference = np.sqrt(float(images[-1] @ (mass @ images[-1]))) if images else size
        if not np.isfinite(size) or size <= SPANNED * reference or size == 0:
            break
        basis.append(vector / size)
        images.append(respond(inertia * (mass @ basis[-1])))
        vector = images[-1]
    if not basis:
        return None
    operator = np.array([[a @ (mass @ b) for b in images] for a in basis])
    shares = np.linalg.eigvalsh((operator + operator.T) / 2)
    slow = shares[(shares > HELD) & (shares < 1 - RESOLVED_SHARE)]
    return float(np.sqrt(inertia * (1 / slow[-1] - 1))) if len(slow) else None


class FirstImpacts:
    """The contacts that have closed by an impact so far; each is reported at its first impact."""

    def __init__(self, problem: ContactProblem) -> None:
        self._normal, self._met = problem.normal, np.zeros(problem.contacts, dtype=bool)
        self.awaited = problem.contacts > 0

    def new(self, before: State, now: State) -> NDArray[np.intp]:
        """Return the contacts that begin to push in a step, approaching, for the first time."""
        closing = np.flatnonzero((now.normal_force > 0) & (before.normal_force <= 0) & ~self._met)
        if len(closing):
            closing = closing[self._normal[closing] @ before.velocity > 0]
            self._met[closing] = True
            self.awaited = not bool(np.all(self._met))
        return closing


def meeting(problem: ContactProblem, mass: Any, contacts: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return which unknowns belong to the bodies that contacts act on, (n,); ties make one body of two."""
    from scipy.sparse.csgraph import connected_components

    tied = abs(problem.tie).T @ abs(problem.tie)
    rows = abs(problem.normal[contacts])
    label = connected_components(abs(problem.stiffness_rows) + abs(mass) + tied, directed=False)[1]
    return np.isin(label, label[sp.csr_matrix(rows).indices])
