"""Load paths with Coulomb friction: in steps, or from one exact event to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from contactqp.analysis.friction_events import ExactPath, Segment
from contactqp.analysis.friction_steps import FrictionSteps
from contactqp.analysis.history import Event, History
from contactqp.analysis.lazy_solutions import LazySolutions
from contactqp.analysis.step_jumps import step_notes
from contactqp.certificate.figures import holds
from contactqp.errors import Unsupported
from contactqp.linalg.friction_states import STICK
from contactqp.linalg.threads import one_blas_thread
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.solving.friction_runs import FrictionRun


def follow_with_friction(
    problem: ContactProblem, corners: Sequence[Vector], count: int, exactly: bool, method: str, options: dict[str, Any]
) -> History:
    """The legs from corner to corner, in so many steps each and, if exactly, at every event.

    Raises
    ------
    Unsupported
        Exact events with two tangential directions a contact, and what `FrictionSteps` cannot do.
    """
    if exactly and problem.slip_origin is not None and problem.slip_origin.shape[1] > 1:
        raise Unsupported(
            "follow_path(events='exact'): two tangential rows a contact: slip turns within a leg; give steps instead"
        )
    steps = FrictionSteps(problem, method, options)
    if exactly:
        with one_blas_thread(problem):
            return _between_events(problem, corners, count, steps[0])
    times = [0.0]
    for leg, (start, end) in enumerate(pairwise(corners)):
        steps.turn(start, end)
        for i in range(count):
            steps.go_to((i + 1) / count)
            times.append(leg + (i + 1) / count)
    return History(steps, times, lambda: steps.changes(times), notes=lambda: step_notes(problem, steps, times))


def _between_events(problem: ContactProblem, corners: Sequence[Vector], count: int, first: Solution) -> History:
    path, instants, times = ExactPath(problem, first), _Instants(first), [0.0]
    jump = path.jump_at_start()
    if jump:
        raise Unsupported(f"follow_path(events='exact'): {jump}: it would jump; give steps")
    events: list[Event] = []
    for leg, (start, end) in enumerate(pairwise(corners)):
        found, segments = path.leg(start, end, leg)
        events += [replace(event, time=leg + event.time) for event in found]
        fractions = sorted({(i + 1) / count for i in range(count)} | {segment.end for segment in segments})
        for fraction in fractions:
            here = [segment for segment in segments if segment.start <= fraction <= segment.end]
            load = end if fraction == 1 else start + fraction * (end - start)
            instants.add(path, problem.replace(load=load), fraction, here)
            times.append(leg + fraction)
    return History(instants, times, lambda: events, linear=True)


class _Instants(LazySolutions):
    """Solutions at instants between which all is linear, certified when they are looked at."""

    def __init__(self, first: Solution) -> None:
        super().__init__([first])
        self._displacement = first.displacement

    def add(self, path: ExactPath, problem: ContactProblem, fraction: float, segments: Sequence[Segment]) -> None:
        """The answer to the problem's load in a segment; its slip counts from the instant before.

        At an event two segments meet: the slip is that of the first, and which of them the load, rounded, is in is
        seen by the signs.
        """
        past = segments[0]
        before = np.asarray(problem.tangent @ self._displacement) if problem.tangent is not None else past.anchor
        here = problem.replace(slip_origin=np.where(past.status == STICK, past.anchor, before))
        for segment in segments:
            answer = path.at(problem.load, fraction, segment)
            if holds(here, answer):
                break
        self.append(FrictionRun(here, answer, "exact events", iterations=0))
        self._displacement = answer.displacement
