"""The steps of a motion: each posed by the scheme, solved, and certified with its neighbours."""

from __future__ import annotations

import copy
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.motion.balance import Motion
from contactqp.analysis.motion.contact_time import ImpactsMinded, meeting, slowest_frequency
from contactqp.analysis.motion.critical_step import critical_step
from contactqp.analysis.motion.history import MotionHistory
from contactqp.analysis.motion.mass import touched
from contactqp.analysis.motion.schemes.scheme import Scheme, State
from contactqp.analysis.motion.step_certificate import StepJudge
from contactqp.analysis.motion.step_contact import Answered, Posed, StepContact
from contactqp.errors import (
    BackendFailed,
    InvalidProblem,
    NoEquilibrium,
    NotCertified,
    NotConverged,
    SeveralEquilibria,
    TimeStepWarning,
)
from contactqp.linalg.stages import CERTIFY, METHOD, stage
from contactqp.model.arrays import Vector
from contactqp.model.problem_data import refuse_not_positive
from contactqp.model.solution import Work

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


class MotionRun:
    """One motion as it is made."""

    def __init__(
        self, scheme: Scheme, load: Callable[[float], Vector], start: float, method: str, options: dict[str, Any]
    ) -> None:
        self._scheme, self._load = scheme, load
        self._contacts = tuple(StepContact(template, method, options) for template in scheme.templates)
        self._judges = tuple(StepJudge(template) for template in scheme.templates)
        self._pending: list[list[tuple[Posed, Answered]]] = [[] for _ in scheme.templates]
        self._notes: list[str] = []
        self._certified = 0  # steps
        self._impacts = ImpactsMinded(scheme.body.problem)
        self._motion = Motion(scheme, [], load, start, method, [0.0], self._work)

    def start(self, u: Vector, v: Vector) -> None:
        self._motion.states.append(self._scheme.first(u, v, self._load(self._motion.start)))

    def lasting(self, duration: float) -> MotionHistory:
        """The history so far and of the steps that a duration takes."""
        refuse_not_positive("duration", duration)
        with np.errstate(over="ignore"):
            ratio = float(np.float64(duration) / self._scheme.body.step)
        if ratio > MOST_STEPS:
            raise InvalidProblem(
                f"duration: {duration:g} takes more steps of {self._scheme.body.step:g} than can be counted"
            )
        whole = abs(ratio - round(ratio)) <= WHOLE
        return self._steps(max(round(ratio) if whole else int(np.ceil(ratio)), 1))

    def _resumed(self, states: list[State], duration: float) -> MotionHistory:
        """What `MotionHistory.resume` asks for: these states and more, the first history untouched."""
        twin = copy.copy(self)
        twin._motion = replace(self._motion, states=list(states), seconds=list(self._motion.seconds), work=twin._work)
        twin._impacts = copy.deepcopy(self._impacts)
        twin._notes, twin._pending = list(self._notes), [[] for _ in self._pending]
        twin._certified = len(states) - 1
        return twin.lasting(duration)

    def _steps(self, count: int) -> MotionHistory:
        """So many steps, certified."""
        began, motion = time.perf_counter() - self._motion.seconds[0], self._motion
        first, state = len(motion.states), motion.states[-1]
        load = self._load(motion.time(first - 1))
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(first, first + count):
                next_load = self._load(motion.time(k))
                before, state = state, self._step(state, load, next_load)
                motion.states.append(state)
                load = next_load
                if self._impacts.unminded:
                    self._mind_contact_time(self._impacts.new(before, state), before, state, k)
                if k % BLOCK == 0 or k == first + count - 1:
                    motion.seconds[0] = time.perf_counter() - began
                    self._judge(k)
        return self.history

    @property
    def history(self) -> MotionHistory:
        return MotionHistory(self._motion, lambda: tuple(self._notes), self._resumed)

    def _step(self, state: State, load: Vector, next_load: Vector) -> State:
        answers: tuple[Answered, ...] = ()
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
        """How many of the steps done no block has certified."""
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

    def _mind_contact_time(self, closing: NDArray[np.intp], before: State, state: State, k: int) -> None:
        """Warn, once, where a step is too long for contacts that close."""
        scheme, h = self._scheme, self._scheme.body.step
        if scheme.inertia is None or not len(closing):
            return
        closed = np.flatnonzero(state.normal_force > 0)
        share = scheme.inertia * scheme.body.mass + scheme.body.stiffness
        contact, template = self._contacts[-1], scheme.templates[-1]
        factor = float(template.stiffness.diagonal().max() / share.diagonal().max())
        omega = slowest_frequency(
            lambda y: factor * contact.held(y, closed),
            scheme.body.mass,
            scheme.inertia,
            np.where(meeting(scheme.body.problem, scheme.body.mass, closing), before.velocity, 0.0),
        )
        if omega is None or np.pi / omega >= RESOLVED * h:
            return
        self._impacts.unminded = False
        names = ", ".join(scheme.body.problem.contact_name(int(i)) for i in closing[:3])
        self._warn(
            f"time step {h:.3g} is too long to resolve the contact that closes at time {self._motion.time(k):.6g} "
            f"({names}): it lasts about {np.pi / omega:.2g}, half a period of the slowest vibration that it starts; "
            f"take steps of {np.pi / omega / RESOLVED:.2g} or less"
        )

    def mind_critical_step(self, penalty: float | None) -> None:
        """Refuse an unstable step; of penalty springs warn, since they act in contact only."""
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
        warnings.warn(message, TimeStepWarning, stacklevel=4)
