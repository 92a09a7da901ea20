"""Schemes of Newmark's family: the trapezoidal rule, backward Euler, and variants without oscillating contact forces.

The trapezoidal rule (Newmark 1959, gamma = 1/2, beta = 1/4) takes contact at the end of the step:

    M (v+ - v) / h + K (u + u+) / 2 + E'(l + l+) / 2 + A'nu = (f + f+) / 2,    u+ = u + h (v + v+) / 2,
    E_N u+ <= g,  l_N+ >= 0,  complementary

With mass at the contacts it creates energy at impacts and its contact forces oscillate; it is included because it is in
use. Without mass there (modified mass: Khenous, Laborde and Renard 2008) contact nodes are in static equilibrium, K u+
+ E'l+ + A'nu = f+, which avoids both. Ties and contacts between unknowns with and without mass are refused, as forces
would be the mean of a step on one side and those of its end on the other.

Central differences with modified mass (Doyen, Ern and Piperno 2011) are explicit in the unknowns I with mass, and solve
a small static contact problem in those C that contacts act on:

    M_II (u+ - 2u + u-)_I / h^2 + (K u)_I = f_I,
    K_CC u_C+ + E_C'l + K_CI u_I+ = f_C+,    E_C u_C+ <= g,  l_N >= 0,  complementary

The contact-stabilised scheme (Deuflhard, Krause and Ertel 2008) projects the prediction first:

    w = the admissible displacement nearest to u + h v in the norm of M
    M (u+ - w) + h^2/2 (K (u + u+) / 2 + E'l + A'nu - (f + f+) / 2) = 0,    E_N u+ <= g,  l_N >= 0,  complementary
    v+ = v + 2 (u+ - w) / h

The forces of the projection do not enter the velocity: a contact node keeps its velocity until the body behind it has
taken its momentum. If the mass at the contact is the whole mass, it stays at its obstacle. The projection does not
determine unknowns without mass, such as rotations of beams between point masses, and the step does not use them; they
are in static equilibrium at its end, as with modified mass.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.motion.mass_matrix import massless
from contactqp.analysis.motion.schemes.scheme import Scheme, SchemeData, SchemeEntry, State, TwoStep
from contactqp.analysis.motion.step_contact import StepProblem, StepResult
from contactqp.errors import Unsupported
from contactqp.linalg.dense import Factorization
from contactqp.linalg.factorization import factorise
from contactqp.model.arrays import Vector

# Velocities of resting contacts are noted if they have more than this part of the energy.
LOST_IN_CONTACT = 0.05
# A contact rests if it moves by less than this part of its velocity times the step.
AT_REST = 1e-6


class Trapezoidal(Scheme):
    """The scheme with x = u+, whose forces are those at the end of the step."""

    def __init__(self, body: SchemeData, name: str) -> None:
        self.body, self.name = body, name
        self.inertia = 4 / body.step**2
        self._inertia = self.inertia * body.mass
        self.templates = (body.template(self._inertia + body.stiffness),)
        self._massless = massless(body.mass)
        self._any_massless = bool(np.any(self._massless))
        # Factors of K u and f for unknowns with mass (2 K u, f + f+) and without (K u, f+).
        self._load_share = np.where(self._massless, 0.0, 1.0)
        internal = sp.diags(-1.0 - self._load_share) @ body.stiffness
        self._from_state = sp.csr_matrix(sp.hstack([internal, body.step * self._inertia]))
        self._bare_contacts = body.on_massless("contact", name)
        self._tie_share = np.where(body.on_massless("tie", name), 1.0, 0.5)

    def first(self, displacement: Vector, velocity: Vector, load: Vector) -> State:
        """Return the start with the contact forces of bodies at rest on each other, half of which act in the first
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
            pull[self._massless] = 0.0  # at unknowns without mass only the force at the end acts
            force -= pull
        return StepProblem(force, body.problem.gap, None, body.slip_from(u), body.problem.tie_value, u)

    def accept(self, state: State, answers: tuple[StepResult, ...]) -> State:
        found, u, h = answers[-1], state.displacement, self.body.step
        velocity = 2 / h * found.increment - state.velocity
        if self._any_massless:
            velocity[self._massless] = found.increment[self._massless] / h
        return State(found.unknown, found.normal, found.friction, self._tie_share * found.tie, velocity, u)

    def answered(self, before: State, after: State) -> tuple[StepResult, ...]:
        return (replace(super().answered(before, after)[0], tie=after.tie_force / self._tie_share),)

    def contact_weight(self) -> Vector:
        """Return 1/2, as half of a force acts before its instant and half after, and 1 for unknowns without mass."""
        return np.where(self._bare_contacts, 1.0, 0.5)


class BackwardEuler(Scheme):
    """The scheme with x = u+: M (v+ - v) / h + K u+ + E'l + A'nu = f+, u+ = u + h v+, E_N u+ <= g. It loses energy
    everywhere.
    """

    name = "backward-euler"
    keeps_energy = False

    def __init__(self, body: SchemeData) -> None:
        self.body = body
        self.inertia = 1 / body.step**2
        self._inertia = self.inertia * body.mass
        self.templates = (body.template(self._inertia + body.stiffness),)

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        del load, answers
        body, u = self.body, state.displacement
        force = next_load - body.stiffness @ u + self._inertia @ (body.step * state.velocity)
        return StepProblem(force, body.problem.gap, None, body.slip_from(u), body.problem.tie_value, u)


class ContactStabilised(Scheme):
    """The scheme with the unknowns x = w, then x = u+."""

    name = "deuflhard-krause-ertel"

    def __init__(self, body: SchemeData) -> None:
        self.body = body
        self.inertia = 4 / body.step**2
        self._inertia = self.inertia / 2 * body.mass
        self._massless = massless(body.mass)
        # Factors of forces: those on unknowns without mass are those at the end of the step alone, halved as K is.
        self._contact_share = np.where(body.on_massless("contact", self.name), 2.0, 1.0)
        self._tie_share = np.where(body.on_massless("tie", self.name), 2.0, 1.0)
        only = sp.diags(self._massless.astype(float))
        predictor = body.template(self._inertia + only @ body.stiffness @ only)
        if predictor.frictional:
            predictor = predictor.replace(friction=0.0)
        self.templates = (predictor, body.template(self._inertia + body.stiffness / 2))

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        body, u = self.body, state.displacement
        limits = body.problem.gap, None, body.slip_from(u), body.problem.tie_value, u
        if not answers:
            return StepProblem(self._inertia @ (body.step * state.velocity), *limits)
        internal = body.stiffness @ u
        force = np.where(self._massless, (next_load - internal) / 2, (load + next_load) / 2 - internal)
        return StepProblem(self._inertia @ answers[0].increment + force, *limits)

    def accept(self, state: State, answers: tuple[StepResult, ...]) -> State:
        (predicted, found), h = answers, self.body.step
        v = state.velocity + 2 / h * (found.increment - predicted.increment)
        v[self._massless] = found.increment[self._massless] / h
        forces = self._contact_share * found.normal, self._friction_share * found.friction, self._tie_share * found.tie
        return State(found.unknown, *forces, v, state.displacement)

    def answered(self, before: State, after: State) -> tuple[StepResult, ...]:
        """Return the results of both problems, without the forces of the projection."""
        (found,) = super().answered(before, after)
        forces = {
            "normal": found.normal / self._contact_share,
            "friction": found.friction / self._friction_share,
            "tie": found.tie / self._tie_share,
        }
        found = replace(found, **forces)
        motion = found.increment - self.body.step / 2 * (after.velocity - before.velocity)
        normal, friction, tie = (np.zeros_like(force) for force in (found.normal, found.friction, found.tie))
        return StepResult(before.displacement + motion, normal, friction, tie, motion), found

    @property
    def _friction_share(self) -> Vector:
        """Return the factor of each component of friction, that of its contact."""
        rows = self.body.tangent.shape[0]
        return np.repeat(self._contact_share, rows // max(len(self._contact_share), 1)) if rows else np.zeros(0)

    def notes(self, states: Sequence[State]) -> Iterator[str]:
        """Yield a note on the energy in velocities of resting contacts towards their obstacles, if it is large.

        Contact i rests if two steps change its gap by much less than h E_i v > 0. Its kinetic energy, without coupled
        motion, is (E_i v)^2 / (2 E_i M^-1 E_i'), with the diagonal of M.
        """
        problem, mass = self.body.problem, self.body.mass.diagonal()
        moved_by = problem.normal.power(2) @ np.divide(1.0, mass, out=np.zeros_like(mass), where=mass > 0)
        worst, place = LOST_IN_CONTACT, None
        lengths = [problem.normal @ state.displacement for state in states]
        for k, state in enumerate(states[2:], start=2):
            towards = problem.normal @ state.velocity
            moved = abs(lengths[k] - lengths[k - 1]) + abs(lengths[k - 1] - lengths[k - 2])
            rests = (moved <= AT_REST * self.body.step * towards) & (towards > 0) & (moved_by > 0)
            if not rests.any():
                continue
            kept = np.divide(towards**2, 2 * moved_by, out=np.zeros_like(towards), where=rests)
            u, v = state.displacement, state.velocity
            part = float(kept.sum()) / (0.5 * float(u @ (self.body.stiffness @ u) + v @ (self.body.mass @ v)))
            if part > worst:
                worst, place = part, (k, int(np.argmax(kept)), float(towards[np.argmax(kept)]))
        if place is not None:
            step, contact, speed = place
            yield (
                f"{problem.contact_name(contact)} rests at its obstacle in step {step} and keeps a velocity of "
                f"{speed:.6g} towards it, and such velocities have {worst:.0%} of the energy: {self.name!r} takes no "
                "momentum from the mass at contacts; take a finer mesh there, or 'moreau-jean' where masses are few"
            )


class ModifiedMassCentral(TwoStep):
    """The scheme with x = u+: explicit for unknowns with mass, with a small static contact problem for the others."""

    name = "modified-mass-central"

    def __init__(self, body: SchemeData) -> None:
        if body.problem.ties:
            raise Unsupported("modified-mass-central: ties; take modified-mass, or remove the tied unknowns")
        self.body = body
        bare = massless(body.mass)
        self._moving, self._bare = np.flatnonzero(~bare), np.flatnonzero(bare)
        self._inertia = body.mass / body.step**2
        only = sp.diags(bare.astype(float))
        self.templates = (body.template(self._inertia + only @ body.stiffness @ only),)
        self._coupling = body.stiffness[self._bare][:, self._moving]

    @cached_property
    def _mass(self) -> Factorization:
        return factorise(self.body.mass[self._moving][:, self._moving])

    def __getstate__(self) -> dict[str, Any]:
        """Return the pickled state without factors, which are computed again if needed."""
        return {name: value for name, value in self.__dict__.items() if name != "_mass"}

    def starting(self, displacement: Vector, velocity: Vector, load: Vector) -> Vector:
        """Return the acceleration at the start, 0 for unknowns without mass."""
        del velocity
        acceleration = np.zeros(len(load))
        force = load - self.body.stiffness @ displacement
        acceleration[self._moving] = self._mass.solve(force[self._moving])
        return acceleration

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        del answers
        body, u = self.body, state.displacement
        internal = body.stiffness @ u
        force = load - internal + self._inertia @ (u - state.before)
        ahead = self._mass.solve(force[self._moving]) * body.step**2
        force[self._bare] = (next_load - internal)[self._bare] - self._coupling @ ahead
        return StepProblem(force, body.problem.gap, None, body.slip_from(u), None, u)


SCHEMES = (
    SchemeEntry("modified-mass", lambda body, _: Trapezoidal(body, "modified-mass"), massless_contacts=True),
    SchemeEntry("newmark", lambda body, _: Trapezoidal(body, "newmark")),
    SchemeEntry("backward-euler", lambda body, _: BackwardEuler(body)),
    SchemeEntry(
        "modified-mass-central", lambda body, _: ModifiedMassCentral(body), explicit=True, massless_contacts=True
    ),
    SchemeEntry("deuflhard-krause-ertel", lambda body, _: ContactStabilised(body)),
)
