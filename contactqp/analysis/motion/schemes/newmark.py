"""The trapezoidal rule (Newmark 1959, gamma = 1/2, beta = 1/4) with contact at the end of the step; backward Euler.

    M (v+ - v) / h + K (u + u+) / 2 + E'(l + l+) / 2 + A'nu = (f + f+) / 2,    u+ = u + h (v + v+) / 2,
    E_N u+ <= g,  l_N+ >= 0,  complementary

With mass at the contacts it creates energy at impacts and its contact forces chatter: it is kept because people use it.
Without (`modified_mass`) contact nodes are in static equilibrium, K u+ + E'l+ + A'nu = f+ there, and both are cured.
A tie between unknowns with mass and without would have the mean of a step on one side and its end on the other: it is
refused, as is such a contact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.motion.mass_matrix import massless
from contactqp.analysis.motion.schemes.scheme import Body, Scheme, SchemeEntry, State
from contactqp.analysis.motion.step_contact import StepProblem, StepResult
from contactqp.model.arrays import Vector


class Trapezoidal(Scheme):
    """The scheme with x = u+, whose forces are those at the end of the step."""

    def __init__(self, body: Body, name: str) -> None:
        self.body, self.name = body, name
        self.inertia = 4 / body.step**2
        self._inertia = self.inertia * body.mass
        self.templates = (body.template(self._inertia + body.stiffness),)
        self._massless = massless(body.mass)
        self._any_massless = bool(np.any(self._massless))
        # Of 2 K u and f + f+ where there is mass; K u and f+ where there is none.
        self._load_share = np.where(self._massless, 0.0, 1.0)
        internal = sp.diags(-1.0 - self._load_share) @ body.stiffness
        self._from_state = sp.csr_matrix(sp.hstack([internal, body.step * self._inertia]))
        self._bare_contacts = body.on_massless("contact", name)
        self._tie_share = np.where(body.on_massless("tie", name), 1.0, 0.5)

    def first(self, displacement: Vector, velocity: Vector, load: Vector) -> State:
        """Return the start with the contact forces of bodies that rest on each other; they count half in the first
        step.
        """
        state = super().first(displacement, velocity, load)
        _, normal_force, friction_force = self.body.starting(displacement, velocity, load)
        return replace(state, normal_force=normal_force, friction_force=friction_force)

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        del answers
        body, u = self.body, state.displacement
        force = self._from_state @ np.concatenate([u, state.velocity])
        force += self._load_share * load + next_load
        if state.normal_force.any():
            pull = body.pull(state)
            pull[self._massless] = 0.0  # there the force of the end balances alone
            force -= pull
        return StepProblem(force, body.problem.gap, None, body.slip_from(u), body.problem.tie_value, u)

    def accept(self, state: State, answers: tuple[StepResult, ...]) -> State:
        found, u, h = answers[-1], state.displacement, self.body.step
        velocity = 2 / h * found.increment - state.velocity
        if self._any_massless:
            velocity[self._massless] = found.increment[self._massless] / h
        return State(found.unknown, velocity, found.normal, found.friction, self._tie_share * found.tie, u)

    def answered(self, before: State, after: State) -> tuple[StepResult, ...]:
        return (replace(super().answered(before, after)[0], tie=after.tie_force / self._tie_share),)

    def contact_weight(self) -> Vector:
        """Return 1/2, as half of a force works before its instant and half after, and 1 where there is no mass."""
        return np.where(self._bare_contacts, 1.0, 0.5)


class BackwardEuler(Scheme):
    """The scheme with x = u+: M (v+ - v) / h + K u+ + E'l + A'nu = f+, u+ = u + h v+, E_N u+ <= g. It loses energy
    everywhere.
    """

    name = "backward-euler"
    keeps_energy = False

    def __init__(self, body: Body) -> None:
        self.body = body
        self.inertia = 1 / body.step**2
        self._inertia = self.inertia * body.mass
        self.templates = (body.template(self._inertia + body.stiffness),)

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        del load, answers
        body, u = self.body, state.displacement
        force = next_load - body.stiffness @ u + self._inertia @ (body.step * state.velocity)
        return StepProblem(force, body.problem.gap, None, body.slip_from(u), body.problem.tie_value, u)


SCHEMES = (
    SchemeEntry("modified-mass", lambda body, _: Trapezoidal(body, "modified-mass"), massless_contacts=True),
    SchemeEntry("newmark", lambda body, _: Trapezoidal(body, "newmark")),
    SchemeEntry("backward-euler", lambda body, _: BackwardEuler(body)),
)
