"""The contact-stabilised Newmark scheme of Deuflhard, Krause and Ertel (2008).

    w = the admissible displacement nearest to u + h v in the norm of M
    M (u+ - w) + h^2/2 (K (u + u+) / 2 + E'l + A'nu - (f + f+) / 2) = 0,    E_N u+ <= g,  l_N >= 0,  complementary
    v+ = v + 2 (u+ - w) / h

The forces of the projection never enter the velocity: what an impact has, is lost in it.
"""

from __future__ import annotations

import numpy as np

from contactqp.analysis.motion.schemes.scheme import Body, Scheme, SchemeEntry, State
from contactqp.analysis.motion.step_contact import StepProblem, StepResult
from contactqp.model.arrays import Vector


class ContactStabilised(Scheme):
    """The scheme with the unknowns x = w, then x = u+."""

    name = "deuflhard-krause-ertel"

    def __init__(self, body: Body) -> None:
        self.body = body
        self.inertia = 4 / body.step**2
        self._inertia = self.inertia / 2 * body.mass
        predictor = body.template(self._inertia)
        if predictor.frictional:
            predictor = predictor.replace(friction=0.0)
        self.templates = (predictor, body.template(self._inertia + body.stiffness / 2))

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        body, u = self.body, state.displacement
        limits = body.problem.gap, None, body.slip_from(u), body.problem.tie_value, u
        if not answers:
            return StepProblem(self._inertia @ (body.step * state.velocity), *limits)
        force = self._inertia @ answers[0].increment + (load + next_load) / 2 - body.stiffness @ u
        return StepProblem(force, *limits)

    def accept(self, state: State, answers: tuple[StepResult, ...]) -> State:
        predicted, found = answers
        v = state.velocity + 2 / self.body.step * (found.increment - predicted.increment)
        return State(found.unknown, v, found.normal, found.friction, found.tie, state.displacement)

    def answered(self, before: State, after: State) -> tuple[StepResult, ...]:
        """Return the results of both problems; the forces of the projection are not kept."""
        (found,) = super().answered(before, after)
        motion = found.increment - self.body.step / 2 * (after.velocity - before.velocity)
        normal, friction, tie = (np.zeros_like(force) for force in (found.normal, found.friction, found.tie))
        return StepResult(before.displacement + motion, normal, friction, tie, motion), found


SCHEMES = (SchemeEntry("deuflhard-krause-ertel", lambda body, _: ContactStabilised(body)),)
