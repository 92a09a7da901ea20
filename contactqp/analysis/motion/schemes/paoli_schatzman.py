"""Central differences with contact in the displacement (Paoli and Schatzman 2002), and with penalty springs.

    M (u+ - 2u + u-) / h^2 + K u + E'l + A'nu = f,    E_N (u+ + e u-) / (1 + e) <= g,  l_N >= 0,  complementary

The penalty scheme has l_N = beta (E_N u - g)+ instead, of the displacement at the start of the step. Both are stable up
to h = 2 / omega, omega the highest frequency (with all contact springs, for the penalty).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from contactqp.analysis.motion.schemes.scheme import Block, Body, SchemeEntry, SchemeSettings, State, TwoStep
from contactqp.analysis.motion.step_contact import StepProblem, StepResult
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, Vector


class _Central(TwoStep):
    """Central differences with x = u+, whose forces are those of the start of the step."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self._inertia = body.mass / body.step**2

    def _free(self, state: State, load: Vector) -> Vector:
        u = state.displacement
        return np.asarray(load - self.body.stiffness @ u + self._inertia @ (u - state.before))


class PaoliSchatzman(_Central):
    """Central differences with contact by a projection, with restitution e."""

    name = "paoli-schatzman"

    def __init__(self, body: Body, restitution: float) -> None:
        super().__init__(body)
        self._restitution = restitution
        self.templates = (body.template(self._inertia),)

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        del next_load, answers
        problem, e = self.body.problem, self._restitution
        gap = (1 + e) * problem.gap - e * (problem.normal @ state.before) if e else problem.gap
        u = state.displacement
        return StepProblem(self._free(state, load), gap, None, self.body.slip_from(u), problem.tie_value, u)


class ExplicitPenalty(_Central):
    """Central differences with contact springs of stiffness beta, which overlap by l_N / beta."""

    name = "penalty"

    def __init__(self, body: Body, penalty: float) -> None:
        super().__init__(body)
        self._penalty = self.springs = penalty
        self.keeps_energy = False
        self.templates = (body.template(self._inertia).with_contacts(np.zeros(0, dtype=np.intp)),)

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        del next_load, answers
        force = self._free(state, load) - self.body.problem.normal.T @ self._springs(state.displacement)
        return StepProblem(force, np.zeros(0), None, None, self.body.problem.tie_value, state.displacement)

    def accept(self, state: State, answers: tuple[StepResult, ...]) -> State:
        ended = super().accept(state, answers)
        return replace(ended, normal_force=self._springs(ended.displacement))

    def answered(self, before: State, after: State) -> tuple[StepResult, ...]:
        return (replace(super().answered(before, after)[0], normal=np.zeros(0)),)

    def starting(self, displacement: Vector, velocity: Vector, load: Vector) -> Vector:
        """Return the acceleration at the start of bodies on contact springs, which carry nothing before they are
        pressed.
        """
        free = replace(self.body, problem=self.body.problem.with_contacts(np.zeros(0, dtype=np.intp)))
        pushed = load - self.body.problem.normal.T @ self._springs(displacement)
        return free.starting(displacement, velocity, pushed)[0]

    def kinetic(self, displacements: Block, velocities: Block, loads: Block) -> Vector:
        """Return 1/2 v'Mv+ of every state, with the forces of the springs in v+ too."""
        return super().kinetic(
            displacements, velocities, loads - self._springs(displacements.T).T @ self.body.problem.normal
        )

    def _springs(self, displacement: Array) -> Array:
        """Return the forces (m,) of one displacement (n,), or (m, steps) of several (n, steps) [force]."""
        problem = self.body.problem
        overlap = (problem.normal @ displacement).T - problem.gap
        return np.asarray(self._penalty * np.maximum(overlap, 0.0).T)


def _with_penalty(body: Body, settings: SchemeSettings) -> ExplicitPenalty:
    if settings.penalty is None:
        raise InvalidProblem("penalty: the scheme 'penalty' has no default stiffness; state penalty=beta")
    return ExplicitPenalty(body, settings.penalty)


SCHEMES = (
    SchemeEntry(
        "paoli-schatzman",
        lambda body, settings: PaoliSchatzman(body, settings.restitution),
        explicit=True,
        knobs=("restitution",),
    ),
    SchemeEntry("penalty", _with_penalty, explicit=True, friction=False, knobs=("penalty",)),
)
