"""Schemes with an impact law in velocities or displacements, and the explicit scheme with penalty springs.

Moreau's and Jean's scheme: impulses and velocities, with Newton's impact law.

    M (v+ - v) + h K (theta u+ + (1 - theta) u) + E'P = h f,    u+ = u + h (theta v+ + (1 - theta) v)

with, at contacts that the step would close (g - E_N (u + h/2 v) <= 0), Newton's law on the velocities of approach,

    E_N v+ <= -e E_N v,  P_N >= 0,  complementary,

and Coulomb's law of P_T and E_T v+ (Moreau 1988; Jean 1999; Acary and Brogliato 2008, section 10.1). With theta = 1/2
energy changes by -P'E (v+ + v) / 2 alone, a loss of (1 - e^2) / (1 + e)^2 P^2 W / 2 at one contact that closes.
Newton's law may create energy if several contacts close at once with e > 0, or if a step stops a separating one.
Contacts close in velocity, with an overlap of the order of h |E_N v|.

Central differences with contact in the displacement (Paoli and Schatzman 2002), and with penalty springs.

    M (u+ - 2u + u-) / h^2 + K u + E'l + A'nu = f,    E_N (u+ + e u-) / (1 + e) <= g,  l_N >= 0,  complementary

A contact is closed for two steps, of which the second undoes what the first does too much. If a contact that shares a
body with it closes in between, energy may grow, by a part that shorter steps leave as it is: in Newton's cradle from
1/2 to 3/5 at gaps of a tenth of what a step approaches, while gaps that no step crosses keep it.

The penalty scheme has l_N = beta (E_N u - g)+ instead, with the displacement at the start of the step. Both are stable
up to h = 2 / omega, omega the highest frequency (with all contact springs, for the penalty).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.motion.schemes.scheme import (
    Block,
    Scheme,
    SchemeData,
    SchemeEntry,
    SchemeSettings,
    State,
    TwoStep,
)
from contactqp.analysis.motion.step_contact import StepProblem, StepResult
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import EPS, Array, Vector

# A rebound below this part of the velocity change by a step's forces is lost in rounding.
NO_REBOUND = 1e-6
# The most touched unknowns for which contact rows are stored dense.
MOST_DENSE = 60
# A predicted gap below this part of its lengths is zero.
GAP_ROUNDING = 64 * EPS


class MoreauJean(Scheme):
    """The scheme of Moreau and Jean with x = v+, whose forces are impulses."""

    name = "moreau-jean"

    def __init__(self, body: SchemeData, theta: float, restitution: float) -> None:
        self.body, self._theta, self._restitution = body, theta, restitution
        self.templates = (body.template(body.mass + (theta * body.step) ** 2 * body.stiffness),)
        self.keeps_energy = theta == 0.5
        self.inertia = 1 / (theta * body.step) ** 2
        velocities = body.mass - body.step**2 * theta * (1 - theta) * body.stiffness
        self._from_state = sp.csr_matrix(sp.hstack([velocities, -body.step * body.stiffness]))
        self._touched = np.unique(body.problem.normal.indices)
        self._normal: Any = body.problem.normal[:, self._touched]
        if len(self._touched) <= MOST_DENSE:
            self._normal = self._normal.toarray()  # a sparse product is ten times slower than a small dense one
        self._normal_size = abs(self._normal)
        self._touching_gap = GAP_ROUNDING * abs(body.problem.gap)
        self._no_rebound = np.zeros(body.problem.contacts)
        self._inertia_of_touched = self.templates[0].diagonal[self._touched]

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        del answers
        body, theta, h = self.body, self._theta, self.body.step
        u, v = state.displacement, state.velocity
        force = self._from_state @ np.concatenate([v, u])
        force += h * (load if load is next_load else theta * next_load + (1 - theta) * load)
        ahead = u[self._touched] + h / 2 * v[self._touched]
        room = body.problem.gap - self._normal @ ahead
        near = room <= self._touching_gap + GAP_ROUNDING * (self._normal_size @ abs(ahead))
        return StepProblem(force, self._rebound(v, force) if self._restitution else self._no_rebound, near)

    def _rebound(self, velocity: Vector, force: Vector) -> Vector:
        """Return -e E_N v, 0 where it is negligible relative to the change by a step's forces."""
        rebound = -self._restitution * (self._normal @ velocity[self._touched])
        change = self._normal_size @ (abs(force[self._touched]) / self._inertia_of_touched)
        return np.where(abs(rebound) <= NO_REBOUND * change, 0.0, rebound)

    def accept(self, state: State, answers: tuple[StepResult, ...]) -> State:
        found, h, theta = answers[-1], self.body.step, self._theta
        u = theta * found.unknown
        u += (1 - theta) * state.velocity
        u *= h
        u += state.displacement
        forces = found.normal / h, found.friction / h, found.tie / h
        return State(u, *forces, found.unknown, state.displacement)

    def answered(self, before: State, after: State) -> tuple[StepResult, ...]:
        del before
        v, h = after.velocity, self.body.step
        return (StepResult(v, h * after.normal_force, h * after.friction_force, h * after.tie_force, v),)

    def contact_motion(self, displacements: Block, velocities: Block) -> Block:
        """Return h (v_(k+1) + v_k) / 2, as an impulse has the work P'E (v+ + v) / 2."""
        del displacements
        return self.body.step * (velocities[1:] + velocities[:-1]) / 2


class _Central(TwoStep):
    """Central differences with x = u+, whose forces are those of the start of the step."""

    def __init__(self, body: SchemeData) -> None:
        self.body = body
        self._inertia = body.mass / body.step**2

    def _free(self, state: State, load: Vector) -> Vector:
        u = state.displacement
        return np.asarray(load - self.body.stiffness @ u + self._inertia @ (u - state.before))


class PaoliSchatzman(_Central):
    """Central differences with contact by a projection, with restitution e."""

    name = "paoli-schatzman"

    def __init__(self, body: SchemeData, restitution: float) -> None:
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

    def __init__(self, body: SchemeData, penalty: float) -> None:
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
        """Return the acceleration at the start of bodies on contact springs, which have no force until compressed."""
        free = replace(self.body, problem=self.body.problem.with_contacts(np.zeros(0, dtype=np.intp)))
        pushed = load - self.body.problem.normal.T @ self._springs(displacement)
        return free.starting(displacement, velocity, pushed)[0]

    def kinetic(self, displacements: Block, velocities: Block, loads: Block) -> Vector:
        """Return 1/2 v'Mv+ of every state, including the forces of the springs in v+."""
        return super().kinetic(
            displacements, velocities, loads - self._springs(displacements.T).T @ self.body.problem.normal
        )

    def _springs(self, displacement: Array) -> Array:
        """Return the forces (m,) of one displacement (n,), or (m, steps) of several (n, steps) [force]."""
        problem = self.body.problem
        overlap = (problem.normal @ displacement).T - problem.gap
        return np.asarray(self._penalty * np.maximum(overlap, 0.0).T)


def _with_penalty(body: SchemeData, settings: SchemeSettings) -> ExplicitPenalty:
    if settings.penalty is None:
        raise InvalidProblem("penalty: the scheme 'penalty' has no default stiffness; state penalty=beta")
    return ExplicitPenalty(body, settings.penalty)


SCHEMES = (
    SchemeEntry(
        "moreau-jean",
        lambda body, settings: MoreauJean(body, settings.theta, settings.restitution),
        knobs=("theta", "restitution"),
    ),
    SchemeEntry(
        "paoli-schatzman",
        lambda body, settings: PaoliSchatzman(body, settings.restitution),
        explicit=True,
        knobs=("restitution",),
    ),
    SchemeEntry("penalty", _with_penalty, explicit=True, friction=False, knobs=("penalty",)),
)
