"""The history of a motion: states at equal steps, their energies, events and, when they are looked at, solutions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.history import History
from contactqp.analysis.lazy_solutions import LazySolutions
from contactqp.analysis.motion.balance import Motion, energies, events
from contactqp.analysis.motion.schemes.scheme import State
from contactqp.analysis.motion.step_contact import Answered, Posed
from contactqp.certificate.certificate import compute_certificate, contact_status
from contactqp.errors import Unsupported
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import read_only
from contactqp.model.solution import Solution


@dataclass(frozen=True, eq=False)
class Moving(Solution):
    """One instant of a motion.

    `displacement`, `normal_force`, `gap`, `slip` (since the step before) are those of the bodies; forces are those of
    the step that ended, in Moreau's and Jean's scheme impulses over the time step. `certificate` judges `step_problem`,
    the contact problem that the scheme posed for the step, in whose unknown the answer was `step_unknown`.
    """

    velocity: Vector = field(default_factory=lambda: np.zeros(0))  # (n,) [length / time]
    time: float = 0.0
    step_problem: ContactProblem | None = field(default=None, repr=False)
    step_unknown: Vector = field(default_factory=lambda: np.zeros(0), repr=False)


class MotionHistory(History):
    """A `History` of a motion, the start included; `times` are in the user's unit of time."""

    def __init__(
        self,
        motion: Motion,
        notes: Callable[[], Sequence[str]],
        resume: Callable[[list[State], float], MotionHistory],
    ) -> None:
        super().__init__(
            LazySolutions(_Instant(motion, k) for k in range(len(motion.states))),
            [motion.time(k) for k in range(len(motion.states))],
            lambda: events(motion),
            energies=lambda: energies(motion),
            notes=notes,
        )
        self.motion = replace(motion, states=list(motion.states))
        self._resume = resume

    def resume(self, duration: float) -> MotionHistory:
        """This motion and how it goes on, with the same scheme, step and factorisation.

        Raises
        ------
        Unsupported
            The history was pickled.
        InvalidProblem, NotConverged
            As `impact`.
        """
        return self._resume(self.motion.states, duration)

    def __copy__(self) -> MotionHistory:
        """The same motion, which shares its states and the solutions that were looked at."""
        twin = MotionHistory(self.motion, partial(tuple, self.notes), self._resume)
        twin._solutions = self._solutions
        return twin

    def __deepcopy__(self, memo: dict[int, Any]) -> MotionHistory:
        return self.__copy__()

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled: every instant looked at, and the loads at all of them. It cannot go on from there."""
        return super().__getstate__() | dict(_resume=_refuse_to_go_on)

    @property
    def displacements(self) -> NDArray[np.float64]:
        """(steps, n) [length]."""
        return read_only(np.array([state.displacement for state in self.motion.states]))

    @property
    def velocities(self) -> NDArray[np.float64]:
        """(steps, n) [length / time]; of central differences those half a step before, after the start's."""
        return read_only(np.array([state.velocity for state in self.motion.states]))

    @property
    def normal_forces(self) -> NDArray[np.float64]:
        """(steps, m) [force], positive in compression."""
        return read_only(np.array([state.normal_force for state in self.motion.states]))

    @property
    def friction_forces(self) -> NDArray[np.float64] | None:
        """(steps, m, d-1) [force], or None without friction."""
        problem = self.motion.scheme.body.problem
        if not problem.frictional or problem.slip_origin is None:
            return None
        shape = (len(self.motion.states), *problem.slip_origin.shape)
        return read_only(np.array([state.friction_force for state in self.motion.states])).reshape(shape)

    @property
    def tie_forces(self) -> NDArray[np.float64]:
        """(steps, k) [force]."""
        return read_only(np.array([state.tie_force for state in self.motion.states]))


def _refuse_to_go_on(*_: Any) -> Any:
    raise Unsupported("a motion that was pickled cannot be resumed: its load and factors are where it was made")


@dataclass(frozen=True, eq=False)
class _Instant:
    """One state, made a solution and certified when it is looked at."""

    motion: Motion
    number: int

    def finish(self) -> Solution:
        return _looked_at(self.motion, self.number)


def _looked_at(motion: Motion, k: int) -> Moving:
    """Instant k with the certificate of the step that ended there; the start is certified as it was given."""
    body, state = motion.scheme.body, motion.states[k]
    problem = body.problem.replace(load=motion.load(motion.time(k)))
    before = motion.states[max(k - 1, 0)].displacement
    if problem.slip_origin is not None and problem.tangent is not None:
        problem = problem.replace(slip_origin=problem.tangent @ before)
    step, found = _step_problem(motion, k)
    friction = None if step.slip_origin is None else _shaped(found.friction, step)
    certificate = compute_certificate(step, found.unknown, found.normal, friction, found.tie)
    status = contact_status(step, certificate)
    force = np.zeros(problem.contacts)
    force[: len(state.normal_force)] = state.normal_force
    return Moving(
        problem=problem,
        displacement=state.displacement,
        normal_force=force,
        friction_force=None if problem.slip_origin is None else _shaped(state.friction_force, problem),
        tie_force=state.tie_force,
        contact_status=status if len(status) == problem.contacts else np.where(force > 0, "closed", "open"),
        free_motions=(),
        certificate=certificate,
        method=f"{motion.scheme.name} with {motion.method}",
        seconds=motion.seconds[0],
        certify_seconds=0.0,
        work=motion.work(),
        velocity=state.velocity,
        time=motion.time(k),
        step_problem=step,
        step_unknown=found.unknown,
    )


def _shaped(friction: Vector, problem: ContactProblem) -> NDArray[np.float64]:
    assert problem.slip_origin is not None
    return friction.reshape(problem.slip_origin.shape) if len(friction) else np.zeros_like(problem.slip_origin)


def _step_problem(motion: Motion, k: int) -> tuple[ContactProblem, Answered]:
    """The problem of the step that ends at k. A contact that it may not close gets a gap that stays open."""
    template = motion.scheme.templates[-1]
    m, ties = template.contacts, template.ties
    rubbing = 0 if template.slip_origin is None else template.slip_origin.size
    if k == 0:
        x = motion.states[0].displacement
        found = Answered(x, np.zeros(m), np.zeros(rubbing), np.zeros(ties), x)
        gap, origin = motion.scheme.body.problem.gap[:m], motion.scheme.body.slip_from(x)
        posed = Posed(template.stiffness_rows @ x, gap, None, origin, template.tie @ x)
    else:
        posed, found = motion.posed(k)
    gap = posed.gap
    if posed.looked_at is not None:
        reach = template.normal @ found.unknown
        gap = np.where(posed.looked_at, gap, np.maximum(reach, 0.0) + abs(reach))
    step = template.replace(
        load=posed.load, gap=gap, tie_value=np.zeros(ties) if posed.tie_value is None else posed.tie_value
    )
    if rubbing:
        unmoved = posed.slip_origin is None or not len(posed.slip_origin)
        step = step.replace(slip_origin=np.zeros(rubbing) if unmoved else posed.slip_origin)
    if posed.base is not None:
        load, size = posed.load + template.stiffness_rows @ posed.base, abs(posed.load)
        step = step.with_load_sum(load, size + template.stiffness_sizes @ abs(posed.base))
    return step, found
