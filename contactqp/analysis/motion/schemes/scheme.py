"""Define the interface of a time-stepping scheme: the contact problem of a step, and the state from its result.

Writing h for the time step, a motion satisfies

    M dv/dt + K u + E_N'l_N + E_T'l_T + A'nu = f,    du/dt = v,
    E_N u <= g,  l_N >= 0,  l_N (g - E_N u) = 0,    A u = b

with Coulomb's law for l_T and the velocities of slip, and an impact law where velocities jump.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.motion.mass_matrix import massless
from contactqp.analysis.motion.step_contact import StepProblem, StepResult
from contactqp.errors import Unsupported
from contactqp.model.arrays import Array, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_only
from contactqp.model.solution import AnswerOf
from contactqp.solving.solve import solve

Block = Array  # one row per step

NO_SLIP = np.zeros(0)
# Gaps and velocities below this part of their lengths are zero, as bodies at rest have some rounding errors.
RESTING = 1e-12


@dataclass(frozen=True, eq=False)
class State(AnswerOf[Vector, Vector], ReadOnly):
    """The data of a motion at the end of a step on which the next step depends.

    Forces are those of the step that ended, or impulses over h; those of friction are flat, ((d-1) m,), and empty
    without friction.
    """

    velocity: Vector  # v (n,); of two-step schemes (u - before) / h, half a step earlier
    before: Vector  # u one step earlier


@dataclass(frozen=True, eq=False)
class SchemeData(ReadOnly):
    """The data of every scheme: the problem, its mass matrix, and the time step."""

    problem: ContactProblem
    mass: Any  # M (n, n) CSR
    step: float  # h

    @property
    def stiffness(self) -> Any:
        return self.problem.stiffness_rows

    def template(self, stiffness: Any) -> ContactProblem:
        """Return the contact problem of a step, with the rows, friction and names of the body and another stiffness."""
        problem = self.problem
        return problem.replace(stiffness=stiffness, near_null_space=None)

    @cached_property
    def tangent(self) -> Any:
        """Return E_T of contacts with friction, or no rows without friction."""
        return (
            self.problem.tangent if self.problem.frictional else read_only(sp.csr_matrix((0, self.problem.dimension)))
        )

    def slip_from(self, displacement: Vector) -> Vector:
        """Return E_T u, the slip origin of a step, ((d-1) m,) [length]."""
        if not self.tangent.shape[0]:
            return NO_SLIP
        return np.asarray(self.tangent @ displacement)

    def still(self, displacement: Vector, velocity: Vector, before: Vector) -> State:
        """Return a state without forces."""
        problem = self.problem
        forces = np.zeros(problem.contacts), np.zeros(self.tangent.shape[0]), np.zeros(problem.ties)
        return State(displacement, *forces, velocity, before)

    def starting(self, displacement: Vector, velocity: Vector, load: Vector) -> tuple[Vector, Vector, Vector]:
        """Return the acceleration, normal forces (m,) and friction ((d-1) m,) of bodies in contact at the start.

        On the unknowns with mass, M a + E_N'l_N + E_T'l_T + A'nu = f - K u. At contacts that are closed and neither
        approach nor part, E_N a <= 0, and Coulomb's law holds with the slip velocity E_T (v + h a) after a step.
        """
        problem, force = self.problem, load - self.stiffness @ displacement
        room, approach = problem.gap - problem.normal @ displacement, problem.normal @ velocity
        sizes = abs(problem.normal)
        closed = room <= RESTING * (sizes @ abs(displacement) + abs(problem.gap))
        still = abs(approach) <= RESTING * (sizes @ abs(velocity))
        moving, bare = np.flatnonzero(~massless(self.mass)), massless(self.mass).astype(float)
        resting = np.flatnonzero(closed & still & (sizes @ bare == 0))
        rows, rough = np.zeros(0, dtype=np.intp), {}
        if self.tangent.shape[0] and len(resting):
            width = self.tangent.shape[0] // problem.contacts
            rows = (resting[:, None] * width + np.arange(width)).ravel()
            slipping = -(self.tangent[rows] @ velocity) / self.step
            rough = dict(
                tangent=self.tangent[rows][:, moving],
                friction=problem.friction[resting],  # type: ignore[index]
                slip_origin=slipping,
            )
        acceleration, normal = np.zeros(problem.dimension), np.zeros(problem.contacts)
        friction = np.zeros(self.tangent.shape[0])
        if not len(moving):
            return acceleration, normal, friction
        start = ContactProblem(
            self.mass[moving][:, moving],
            force[moving],
            problem.normal[resting][:, moving],
            np.zeros(len(resting)),
            tie=problem.tie[abs(problem.tie) @ bare == 0][:, moving],
            **rough,
        )
        found = solve(start)
        acceleration[moving], normal[resting] = found.displacement, found.normal_force
        if found.friction_force is not None:
            friction[rows] = found.friction_force.ravel()
        return acceleration, normal, friction

    def on_massless(self, what: str, scheme: str) -> Mask:
        """Return the contacts (m,) or ties (k,) that act on unknowns without mass.

        Raises
        ------
        Unsupported
            One acts on unknowns with mass and on others without.
        """
        problem, bare = self.problem, massless(self.mass)
        groups = [problem.tie] if what == "tie" else [problem.normal]
        if what == "contact" and self.tangent.shape[0]:
            width = self.tangent.shape[0] // problem.contacts
            groups += [self.tangent[place::width] for place in range(width)]
        on_bare, on_mass = (
            sum(abs(rows) @ unknowns.astype(float) for rows in groups) > 0 for unknowns in (bare, ~bare)
        )
        if np.any(on_bare & on_mass):
            i = int(np.argmax(on_bare & on_mass))
            name = problem.tie_name(i) if what == "tie" else problem.contact_name(i)
            raise Unsupported(f"{scheme}: {name} acts on unknowns with mass and on others without; take another scheme")
        return np.asarray(on_bare)

    def pull(self, state: State) -> Vector:
        """Return E_N'l_N + E_T'l_T of a state, (n,) [force]."""
        force = self._rows_transposed[0] @ state.normal_force
        if len(state.friction_force):
            force = force + self._rows_transposed[1] @ state.friction_force
        return np.asarray(force)

    @cached_property
    def _rows_transposed(self) -> tuple[Any, Any]:
        return sp.csr_matrix(self.problem.normal.T), sp.csr_matrix(self.tangent.T)


class Scheme(ABC):
    """A time-stepping scheme, linear except for contact, with one stiffness for each problem of its steps."""

    name: str
    body: SchemeData
    templates: tuple[ContactProblem, ...]  # one for each problem that a step solves, in their order
    inertia: float | None = None  # s if the stiffness of the last template is proportional to s M + K, None if explicit
    springs: float | None = None  # beta if contacts are springs with elastic energy
    keeps_energy: bool = True  # whether `kinetic` + 1/2 u'Ku is constant without contact and load

    def first(self, displacement: Vector, velocity: Vector, load: Vector) -> State:
        """Return the state from which the first step starts; the load is that of the start."""
        del load
        return self.body.still(displacement, velocity, displacement)

    @abstractmethod
    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        """Return the next problem of the step from `state`; `answers` are the results of its earlier problems.

        Parameters
        ----------
        state : State
            The motion at the start of the step.
        load, next_load : (n,) arrays [force]
            f at the start and at the end of the step.
        answers : tuple of StepResult
            The results of the step's earlier problems; empty for its first one.
        """

    def accept(self, state: State, answers: tuple[StepResult, ...]) -> State:
        """Return the state at the end of the step: by default the last problem's, with v+ = (u+ - u) / h."""
        found, u = answers[-1], state.displacement
        return State(found.unknown, found.normal, found.friction, found.tie, found.increment / self.body.step, u)

    def answered(self, before: State, after: State) -> tuple[StepResult, ...]:
        """Return the results that led from one state to the next, the inverse of `accept`."""
        u, motion = after.displacement, after.displacement - before.displacement
        return (StepResult(u, after.normal_force, after.friction_force, after.tie_force, motion),)

    def notes(self, states: Sequence[State]) -> Iterator[str]:
        """Yield notes of this scheme on a motion, by default none."""
        del states
        yield from ()

    def contact_motion(self, displacements: Block, velocities: Block) -> Block:
        """Return the motions (steps, n) for the work of contact forces in each step, from all states (steps + 1, n)."""
        del velocities
        return np.diff(displacements, axis=0)

    def contact_weight(self) -> Vector:
        """Return the part of a contact's force that acts in its own step, (m,); the rest acts in the next step."""
        return np.ones(self.body.problem.contacts)

    def kinetic(self, displacements: Block, velocities: Block, loads: Block) -> Vector:
        """Return 1/2 v'Mv (steps + 1,) of states given as (steps + 1, n) arrays."""
        del displacements, loads
        return np.asarray(np.einsum("ij,ij->i", velocities, (self.body.mass @ velocities.T).T) / 2)


class TwoStep(Scheme):
    """The common part of central differences: v = (u_k - u_(k-1)) / h is the velocity half a step before u_k."""

    def first(self, displacement: Vector, velocity: Vector, load: Vector) -> State:
        """Return the start with u before it from u0 - h v0 + h^2/2 a0."""
        before = displacement - self.body.step * velocity
        before += self.body.step**2 / 2 * self.starting(displacement, velocity, load)
        return self.body.still(displacement, velocity, before)

    def starting(self, displacement: Vector, velocity: Vector, load: Vector) -> Vector:
        """Return the acceleration a0 at the start."""
        return self.body.starting(displacement, velocity, load)[0]

    def kinetic(self, displacements: Block, velocities: Block, loads: Block) -> Vector:
        """Return 1/2 v'Mv+ with v and v+ = v + h a the velocities half a step before and after, a from K and f
        alone.

        The sum with the elastic energy 1/2 u'Ku is constant for central differences in free flight.
        """
        body = self.body
        momentum = (body.mass @ velocities.T).T
        push = loads - (body.stiffness @ displacements.T).T
        push[:, body.mass.diagonal() == 0] = 0.0
        return np.asarray(np.einsum("ij,ij->i", velocities, momentum + body.step * push) / 2)


@dataclass(frozen=True)
class SchemeSettings:
    """The parameters of schemes; `impact` checks them and refuses those that a scheme does not use."""

    theta: float  # from 1/2 to 1
    restitution: float  # from 0 to 1
    penalty: float | None  # stiffness of contact springs [force / length]


@dataclass(frozen=True)
class SchemeEntry:
    """A registered scheme, with its properties for `impact`."""

    name: str
    make: Callable[[SchemeData, SchemeSettings], Scheme]
    explicit: bool = False  # stable up to a critical step, with mass required at every unknown
    massless_contacts: bool = False  # removes the mass from the unknowns touched by contacts
    friction: bool = True  # whether it supports friction
    knobs: tuple[str, ...] = ()  # the fields of SchemeSettings that it uses
