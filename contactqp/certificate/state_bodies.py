"""On what combinations of open, stick and slip are solved, for a certificate: condensed, sparse or iterated on."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from contactqp.certificate.figures import energy_norm, kept_residuals, response, rigid_rounding
from contactqp.errors import BackendFailed
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.convexity import StiffnessFactor, refuse_indefinite_by_iteration, stiffness_factor
from contactqp.linalg.delassus import contact_compliance
from contactqp.linalg.dense import saddle_point
from contactqp.linalg.extended import extend, extended_rows
from contactqp.linalg.iterated_states import CombinationSystem, FrictionalAnswer, FrictionRows
from contactqp.linalg.iteration import frictional_iteration
from contactqp.linalg.measures import row_sizes
from contactqp.model.arrays import Array, Mask, Vector
from contactqp.model.coulomb import OPEN, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

if TYPE_CHECKING:
    from contactqp.linalg.friction_states import RefinedState, ScaledRows

# Equilibrium at every unknown that the answer of a combination that is iterated on is asked for.
ROUNDING_OF_FIGURES = 1e-10
# A turn of slip directions that changes the displacement by this part of its energy norm is the last.
SETTLED_TURN = 1e-10
# Steps of GMRES and conjugate gradients after which no further system is solved: a right answer takes some ten.
MOST_COMPARING = 150
FAR = "it is far from the answers of the combinations that it leads to"
# Ties that leave this part of a contact's compliance, as that of the bodies without them, hold it.
HELD = 1e-13
# Steps of conjugate gradients towards the response to forces.
MOST_STEPS = 200


class Bodies(Protocol):
    """The bodies on which combinations of states are solved."""

    along: Vector  # (m,) the response of a contact to its own force
    across: Vector  # (m,) the same of friction
    width: int  # d-1
    frictional: Mask  # (m,) contacts that friction acts on
    floats: bool

    def refined(self, status: Status, start: Answer) -> RefinedState:
        """Return the answer of a combination, refined from a start."""

    def response_norm(self, normal: Vector, friction: Array) -> float:
        """Return the energy norm of the response of the tied bodies to contact forces (m,), (m, d-1)."""

    def untied_norm(self, normal: Vector, friction: Array, tie: Vector) -> tuple[float, float] | None:
        """Return the energy norm of the response of untied bodies to all forces, and its error; None: not known."""

    def rounding(self, displacement: Vector) -> float:
        """Return the energy norm of the rounding of a rigid displacement."""


class CondensedBodies:
    """Bodies that are condensed onto their contacts."""

    def __init__(self, problem: ContactProblem, condensation: Condensation) -> None:
        from contactqp.linalg.delassus import condensed_frictional_rows

        self._problem, self._condensation, self._outward = problem, condensation, condensation.outward
        self._rows = condensed_frictional_rows(problem, condensation)
        self.width, self.frictional = self._rows.width, _with_friction(self._rows)
        self.floats = condensation.rigid.count > 0
        compliance = contact_compliance(problem, condensation)
        per_contact = np.diag(compliance.W).reshape(problem.contacts, -1)
        per_contact = np.where(per_contact > HELD, per_contact, 0.0) * compliance.scale[:, None] ** 2
        self.along, self.across = per_contact[:, 0], np.max(per_contact[:, 1:], axis=1, initial=0.0)

    def refined(self, status: Status, start: Answer) -> RefinedState:
        """Return the answer of a combination, refined from a start."""
        from contactqp.linalg.friction_states import refined_in

        left = kept_residuals(self._problem, start)
        return refined_in(self._problem, self._condensation, self._rows, status, start, independent=True, left=left)

    def response_norm(self, normal: Vector, friction: Array) -> float:
        """Return the energy norm of the response of the tied bodies to contact forces (m,), (m, d-1)."""
        condensation = self._condensation
        load = normal @ condensation.normal + self._outward @ friction.ravel()
        saddle = saddle_point(condensation, np.zeros(0, dtype=np.intp))
        x, _, _ = saddle.solve(load, np.zeros(0), np.zeros(self._problem.ties))
        return float(np.sqrt(max(float(load @ x), 0.0)))

    def untied_norm(self, normal: Vector, friction: Array, tie: Vector) -> tuple[float, float] | None:
        """Return the energy norm of the response of untied bodies to all forces, and a bound on its error."""
        rows = extended_rows(self._problem)
        load = rows.contact_force(extend(normal), extend(tie)) + rows.friction_force(extend(friction.ravel()))
        u, left = response(self._problem, self._condensation, load, tied=False)
        norm, rounding = energy_norm(self._problem, u)
        return norm, rounding + left

    def rounding(self, displacement: Vector) -> float:
        """Return the energy norm of the rounding of a rigid displacement."""
        return rigid_rounding(self._problem, self._condensation.rigid, displacement)


class SparseBodies:
    """Bodies that are held, in the plane, in all their unknowns; a contact's response is that of its own unknowns."""

    floats = False

    def __init__(self, problem: ContactProblem) -> None:
        from contactqp.linalg.sparse_states import frictional_rows

        self._problem, self._rows = problem, frictional_rows(problem)
        self.width, self.frictional = self._rows.width, _with_friction(self._rows)
        self.along, self.across = (row_sizes(problem, rows).compliance for rows in (problem.normal, problem.tangent))

    def refined(self, status: Status, start: Answer) -> RefinedState:
        """Return the answer of a combination, refined from a start."""
        from contactqp.linalg.sparse_states import refined_sparse

        return refined_sparse(self._problem, status, start)

    def response_norm(self, normal: Vector, friction: Array) -> float:
        """Return the energy norm of the response of the tied bodies to contact forces (m,), (m, 1)."""
        assert self._problem.tangent is not None
        load = self._problem.normal.T @ normal + self._problem.tangent.T @ friction.ravel()
        return self._rows.system(self._problem, np.full(len(normal), OPEN, dtype=np.int8)).response_norm(load)

    def untied_norm(self, normal: Vector, friction: Array, tie: Vector) -> tuple[float, float] | None:
        """Return the energy norm of the response of untied bodies to all forces; None where K is singular."""
        problem = self._problem
        assert problem.tangent is not None
        if (factor := self._untied) is None:
            return None
        load = problem.normal.T @ normal + problem.tangent.T @ friction.ravel() + problem.tie.T @ tie
        return factor.response_norm(load), 0.0

    @cached_property
    def _untied(self) -> StiffnessFactor | None:
        """Factors of K, in which the ties are not."""
        return stiffness_factor(self._problem)

    def rounding(self, displacement: Vector) -> float:
        """Return 0, since no body floats."""
        del displacement
        return 0.0


# The error in energy of the answer of a combination that is iterated on, and how often slip directions in space turn.
ENERGY, TURNS = 1e-10, 8
# Of the square of the energy norm of a response, what is left to be found.
RESPONSE_LEFT = 1e-2


class IteratedBodies:
    """Bodies that are too large to factorise; a contact's response is that of its own unknowns."""

    def __init__(self, problem: ContactProblem) -> None:
        self._problem, self._iteration = problem, frictional_iteration(problem)
        refuse_indefinite_by_iteration(problem, self._iteration)
        self._before, self.floats = self._iteration.krylov_iterations, self._iteration.rigid.count > 0
        self._rows = FrictionRows(problem, self._iteration)
        self.width, self.frictional = self._rows.width, self._rows.friction > 0
        self.along, self.across = (row_sizes(problem, rows).compliance for rows in (problem.normal, problem.tangent))
        self.across = np.max(self.across.reshape(problem.contacts, -1), axis=1, initial=0.0)

    def refined(self, status: Status, start: Answer) -> RefinedState:
        """Solve a combination by GMRES from a start; in space the slip directions turn with the answer."""
        from contactqp.linalg.friction_states import RefinedState

        assert start.friction_force is not None
        here = FrictionalAnswer(start.displacement, start.normal_force, start.friction_force, start.tie_force)
        states = self._rows.in_states(status, here)
        for _ in range(TURNS):
            left = self._before + MOST_COMPARING - self._iteration.krylov_iterations
            if left <= 0:
                raise BackendFailed(FAR)
            system = CombinationSystem(self._rows, states)
            found = system.answer(system.solved(system.closed(here.displacement), ROUNDING_OF_FIGURES, ENERGY, left))
            last = Answer(
                found.displacement - here.displacement,
                found.normal_force - here.normal_force,
                found.friction_force - here.friction_force,
                found.tie_force - here.tie_force,
            )
            here, moved = found, energy_norm(self._problem, extend(last.displacement))[0]
            if not moved > SETTLED_TURN * energy_norm(self._problem, extend(here.displacement))[0]:
                break
            states = self._rows.in_states(status, here)
        held = self._rows.constrained(states)
        return RefinedState(
            extend(here.displacement),
            extend(here.normal_force),
            extend(here.friction_force.ravel()),
            extend(here.tie_force),
            states.direction,
            last,
            regular=bool(np.all(np.isfinite(here.displacement))),
            redundant=self._iteration.constrained(self._iteration.rows[held], self._rows.limit[held]).redundant,
        )

    def response_norm(self, normal: Vector, friction: Array) -> float:
        """Return the energy norm of the response of the tied bodies to contact forces, to a few per cent."""
        iteration, rows = self._iteration, self._rows
        ties = np.arange(rows.m, rows.plain)
        load = iteration.forces(np.concatenate([normal, np.zeros(len(ties)), friction.ravel()]))
        if not load.any():
            return 0.0
        held = iteration.held(ties, np.zeros(len(ties)))
        run = iteration.run(np.zeros_like(load), load, ties, held)
        while run.square() > RESPONSE_LEFT * run.gained and run.steps < MOST_STEPS and run.step():
            iteration.krylov_iterations += 1
        return float(np.sqrt(run.gained + run.square()))

    def untied_norm(self, normal: Vector, friction: Array, tie: Vector) -> None:
        """Return None: it would take as many steps again."""

    def rounding(self, displacement: Vector) -> float:
        """Return the energy norm of the rounding of a rigid displacement."""
        return rigid_rounding(self._problem, self._iteration.rigid, displacement)


def _with_friction(rows: ScaledRows) -> Mask:
    """Return the contacts that friction acts on (m,)."""
    return np.asarray(rows.slides & (rows.coefficient > 0))


def own_compliances(problem: ContactProblem, along: Vector, across: Vector) -> tuple[Vector, Vector]:
    """Return |E_i D|^2 of normal and tangential rows, (m,) each; of the bodies where a row touches nothing stiff."""
    normal = row_sizes(problem, problem.normal).compliance
    tangent = np.max(row_sizes(problem, problem.tangent).compliance.reshape(problem.contacts, -1), axis=1, initial=0.0)
    return np.where(normal > 0, normal, along), np.where(tangent > 0, tangent, across)


def squared_lengths(rows: Any, problem: ContactProblem) -> Vector:
    """Return the largest |E_i|^2 of the rows of each contact (m,)."""
    squared = np.asarray(rows.power(2).sum(axis=1)).reshape(problem.contacts, -1)
    return np.asarray(np.max(squared, axis=1, initial=0.0))
