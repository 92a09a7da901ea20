"""Verdicts of the comparison with an answer's own states, and the solution of combinations without condensation.

Bodies are then solved by sparse systems in all unknowns, or iteratively. If no combination can be compared, the
minimisation with fixed friction forces is judged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from contactqp.certificate import messages
from contactqp.certificate.balance import PUSHED_BY_ROUNDING
from contactqp.certificate.bounds import Bounds, error_bounds, error_failures, force_bound_fails
from contactqp.certificate.energy_bounds import energy_bounds
from contactqp.certificate.figures import energy_norm, response, rigid_rounding
from contactqp.certificate.multigrid_bounds import iterated_bounds
from contactqp.errors import BackendFailed
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.convexity import (
    StiffnessFactor,
    refuse_indefinite,
    refuse_indefinite_by_iteration,
    stiffness_factor,
)
from contactqp.linalg.delassus import (
    ContactCompliance,
    RefinedForces,
    condensed_frictional_rows,
    contact_compliance,
)
from contactqp.linalg.extended import FINE_EPS, extend, extended_rows, residuals
from contactqp.linalg.floating import RESISTED, motions_as_stated
from contactqp.linalg.iterated_states import CombinationSystem, FrictionalAnswer, FrictionRows
from contactqp.linalg.iteration import frictional_iteration, iterated, iteration
from contactqp.linalg.measures import lengths, own_compliance, row_sizes
from contactqp.model.arrays import EPS, Array, Mask, Vector
from contactqp.model.coulomb import OPEN, Status
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import FIGURES_ALONE, Answer

if TYPE_CHECKING:
    from contactqp.linalg.friction_states import RefinedState

# A refined answer is rejected if ties have residuals above this part of their sizes.
UNMET = 1e-22
# The rounding of Coulomb's law in doubles relative to the friction.
LAW_ROUNDING = 8 * EPS
# The tolerance of equilibrium at every unknown for iterative solution of a combination.
ROUNDING_OF_FIGURES = 1e-10
# Slip directions have converged if their update changes the displacement by less than this part of its energy norm.
SETTLED_TURN = 1e-10
# Steps of GMRES and conjugate gradients after which no further system is solved; a right answer needs about ten.
MOST_COMPARING = 150
# After this many of them a distance above this, in energy norm, is accepted, as more digits would not change the
# verdict.
STEPS_TO_TELL, FAR_APART = 12, 1e-4
# Slip directions do not converge if their update exceeds this part of the previous one.
SLOW_TURN = 0.5
FAR_FROM_ANSWERS = "it is far from the answers of the combinations that it leads to"
UNSURE_MOTIONS = (
    "whether springs or rounding resist the rigid motions of the bodies is not known, and it changes the forces: "
    "stated in near_null_space, they are exact"
)
# The most steps of conjugate gradients for the response to forces.
MOST_STEPS = 200


class Bodies(Protocol):
    """The bodies on which combinations of states are solved."""

    along: Vector  # (m,) compliance of a contact to its own normal force
    across: Vector  # (m,) the same for friction
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


class SparseBodies:
    """Bodies in the plane in all unknowns; a contact's compliance is that of its own unknowns."""

    def __init__(self, problem: ContactProblem) -> None:
        from contactqp.linalg.sparse_states import frictional_rows

        refuse_indefinite(problem)
        self._problem, self._rows = problem, frictional_rows(problem)
        self.floats = self._rows.floats
        self.width, self.frictional = self._rows.width, self._rows.slides & (self._rows.coefficient > 0)
        self.along, self.across = (row_sizes(problem, rows).compliance for rows in (problem.normal, problem.tangent))

    def refined(self, status: Status, start: Answer) -> RefinedState:
        """Return the answer of a combination, refined from a start."""
        from contactqp.linalg.sparse_states import refined_sparse

        return refined_sparse(self._problem, status, start)

    def response_norm(self, normal: Vector, friction: Array) -> float:
        """Return the energy norm of the response of the tied bodies to contact forces (m,), (m, 1), less resultants."""
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
        return factor.response_norm(load)

    @cached_property
    def _untied(self) -> StiffnessFactor | None:
        """Return factors of K without ties."""
        return stiffness_factor(self._problem)

    def rounding(self, displacement: Vector) -> float:
        """Return the energy norm of the rounding of a rigid displacement."""
        return rigid_rounding(self._problem, self.floats, displacement)


# The error in energy of the iterative solution of a combination, and the most updates of slip directions in space.
ENERGY, TURNS = 1e-10, 8
# The relative error of the squared energy norm of a response.
RESPONSE_LEFT = 1e-2


class IteratedBodies:
    """Bodies that are too large to factorise; a contact's compliance is that of its own unknowns."""

    def __init__(self, problem: ContactProblem) -> None:
        self._problem, self._iteration = problem, frictional_iteration(problem)
        refuse_indefinite_by_iteration(problem, self._iteration)
        self._before, self.floats = self._iteration.krylov_iterations, self._iteration.rigid.count > 0
        self._rows = FrictionRows(problem, self._iteration)
        self.width, self.frictional = self._rows.width, self._rows.friction > 0
        self.along, self.across = (row_sizes(problem, rows).compliance for rows in (problem.normal, problem.tangent))
        self.across = np.max(self.across.reshape(problem.contacts, -1), axis=1, initial=0.0)
        self._felt: tuple[Vector, float] | None = None  # the last forces and the norm of their response

    def refined(self, status: Status, start: Answer) -> RefinedState:
        """Solve a combination by GMRES from a start; in space the slip directions are updated with the answer."""
        from contactqp.linalg.friction_states import Correction, RefinedState

        assert start.friction_force is not None
        here = FrictionalAnswer(start.displacement, start.normal_force, start.friction_force, start.tie_force)
        states, moved = self._rows.in_states(status, here), np.inf
        for _ in range(TURNS):
            left = self._before + MOST_COMPARING - self._iteration.krylov_iterations
            if left <= 0:
                raise BackendFailed(FAR_FROM_ANSWERS)
            system = CombinationSystem(self._rows, states)
            found = system.answer(self._solved(system, here.displacement, left))
            last = Correction(
                found.displacement - here.displacement,
                found.normal_force - here.normal_force,
                found.friction_force - here.friction_force,
                found.tie_force - here.tie_force,
            )
            here, before, moved = found, moved, energy_norm(self._problem, extend(last.displacement))[0]
            strain = energy_norm(self._problem, extend(here.displacement))[0]
            if not moved > SETTLED_TURN * strain or moved > max(SLOW_TURN * before, FAR_APART * strain):
                break
            states = self._rows.in_states(status, here)
        held = self._rows.constrained(states)
        return RefinedState(
            extend(here.displacement),
            extend(here.normal_force),
            extend(here.friction_force.ravel()),
            extend(here.tie_force),
            status,
            states.direction,
            last,
            regular=bool(np.all(np.isfinite(here.displacement))),
            redundant=self._iteration.constrained(self._iteration.rows[held], self._rows.limit[held]).redundant,
        )

    def _solved(self, system: CombinationSystem, u: Vector, most: int) -> Vector:
        """Return the answer of a combination from a displacement, to a few digits if both are far apart."""
        before = self._iteration.krylov_iterations
        x = system.solved(system.closed(u), ROUNDING_OF_FIGURES, ENERGY, min(most, STEPS_TO_TELL))
        left = before + most - self._iteration.krylov_iterations
        if left <= 0 or self._strain(x - u) > FAR_APART * self._strain(x):
            return x
        return system.solved(x, ROUNDING_OF_FIGURES, ENERGY, left)

    def _strain(self, x: Vector) -> float:
        return float(np.sqrt(max(self._iteration.dot(x, self._iteration.product(x)), 0.0)))

    def response_norm(self, normal: Vector, friction: Array) -> float:
        """Return the energy norm of the response of the tied bodies to contact forces, to a few per cent."""
        iteration, rows = self._iteration, self._rows
        ties = np.arange(rows.m, rows.plain)
        load = iteration.forces(np.concatenate([normal, np.zeros(len(ties)), friction.ravel()]))
        if not load.any():
            return 0.0
        if self._felt is not None and any(np.array_equal(load, sign * self._felt[0]) for sign in (1.0, -1.0)):
            return self._felt[1]  # the error of an answer and the last correction are often equal
        held = iteration.held(ties, np.zeros(len(ties)))
        run = iteration.run(np.zeros_like(load), load.copy(), ties, held)
        while run.square() > RESPONSE_LEFT * run.gained and run.steps < MOST_STEPS and run.step():
            iteration.krylov_iterations += 1
        self._felt = load, float(np.sqrt(run.gained + run.square()))
        return self._felt[1]

    def untied_norm(self, normal: Vector, friction: Array, tie: Vector) -> None:
        """Return None, as it would take as many steps again."""

    def rounding(self, displacement: Vector) -> float:
        """Return the energy norm of the rounding of a rigid displacement."""
        return rigid_rounding(self._problem, self.floats, displacement)


def squared_lengths(rows: Any, problem: ContactProblem) -> Vector:
    """Return the largest |E_i|^2 of the rows of each contact (m,)."""
    squared = np.asarray(rows.power(2).sum(axis=1)).reshape(problem.contacts, -1)
    return np.asarray(np.max(squared, axis=1, initial=0.0))


@dataclass(frozen=True, eq=False)
class Compared:
    """The refined answer of a combination with which an answer was compared; norms are square roots of energies."""

    refined: RefinedState
    status: Status
    frictional: Mask  # (m,) contacts that friction acts on
    displacement: float  # |u - u_c|_K at most
    force: float  # |l - l_c|_W
    last: float  # of the last correction of the refinement
    strain: float  # |u_c|_K
    size: float  # |l_c|_W
    unsure: float  # rounding of |u_c|_K
    still: Vector  # (m,) slips up to which there is none [length]


@dataclass(frozen=True, eq=False)
class RefinedLengths:
    """The refined answer in the scale of the compliance, with forces multiplied and lengths divided by it."""

    normal: Vector  # (m,) l_N
    friction: Array  # (m, d-1) l_T
    gap: Vector  # (m,) of w
    slip: Array  # (m, d-1) of w
    correction: float  # |w - u|_K of the refined displacement u, and errors of gaps and slips
    still: Vector | float = 0.0  # (m,) slips up to which there is none, whose direction decides nothing

    def room(self, mu: Vector) -> Vector:
        """Return mu l_N - |l_T| (m,), reduced by its rounding."""
        return np.asarray((1 - LAW_ROUNDING) * mu * self.normal - lengths(self.friction))


def refined_lengths(
    problem: ContactProblem, condensation: Condensation, compared: Compared, compliance: ContactCompliance
) -> RefinedLengths | None:
    """Return the response w to the refined forces, one more correction away, with its gaps and slips.

    None if ties are violated.

    Parameters
    ----------
    problem, condensation, compliance : the ContactProblem, its Condensation, and the operators of its contacts
    compared : what the answer was compared with, whose refined answer is taken
    """
    found, rows, m = compared.refined, extended_rows(problem), problem.contacts
    u, force, friction = found.displacement, found.normal_force, found.friction_force
    missed = abs((rows.tie @ u - extend(problem.tie_value)).double())
    size = abs(problem.tie) @ abs(u.double()) + abs(problem.tie_value)
    size = size + np.sqrt(own_compliance(problem, problem.tie)) * compared.strain  # neither may have moved
    if np.any(missed > UNMET * size):
        return None
    left = extend(problem.load) - rows.stiffness @ u - rows.contact_force(force, found.tie_force)
    left = left - rows.friction_force(friction)
    step, error = response(problem, condensation, left, tied=problem.ties > 0)
    moved = u + step
    correction = 2 * energy_norm(problem, step)[0] + error
    origin = np.zeros(0) if problem.slip_origin is None else problem.slip_origin.ravel()
    gap = (extend(problem.gap) - rows.normal @ moved).double()
    slip = (rows.slip(moved) - extend(origin)).double().reshape(m, -1)
    scale = compliance.scale
    forces = force.double() * scale, friction.double().reshape(slip.shape) * scale[:, None]
    return RefinedLengths(*forces, gap / scale, slip / scale[:, None], correction, compared.still / scale)


def with_rounding_of_motions(
    problem: ContactProblem, condensation: Condensation, compared: Compared, bounds: Bounds
) -> Bounds | str:
    """Return bounds enlarged by the change of the combination's forces due to rounding of K along rigid motions.

    Stated motions are exact, and it only counts whether K was cleared of that rounding. If others change more than
    `RESISTED` of the forces they may have a real resistance, and the reason is returned that nothing is proven.

    Parameters
    ----------
    problem, condensation : the ContactProblem, whose bodies float, and its Condensation
    compared : what the answer was compared with
    bounds : the bounds of the answer
    """
    from contactqp.linalg.friction_states import refined_in

    rows = condensed_frictional_rows(problem, condensation)
    stated = bool(motions_as_stated(problem, condensation.rigid.motions)[1].all())
    start, found = compared.refined.answer(rows.width), compared.refined
    cleared = refined_in(problem, condensation, rows, compared.status, start, cleared=True)
    if not stated:
        found = refined_in(problem, condensation, rows, compared.status, start, cleared=False)
    normal = (cleared.normal_force - found.normal_force).double()
    friction = (cleared.friction_force - found.friction_force).double().reshape(len(normal), -1)
    friction = np.where(compared.frictional[:, None], friction, 0.0)
    pushed = PUSHED_BY_ROUNDING * lengths(np.column_stack([normal, friction]))
    size = np.max(abs(start.normal_force), initial=0.0)
    if not stated and not np.all(pushed <= PUSHED_BY_ROUNDING * RESISTED * size):
        return UNSURE_MOTIONS
    compliance = contact_compliance(problem, condensation)
    across = np.max(compliance.W.diagonal().reshape(len(pushed), -1), axis=1)
    strained = float(np.sum(np.sqrt(across) * compliance.scale * pushed))
    bound = pushed + (0.0 if bounds.force_bound is None else bounds.force_bound)
    own = np.sqrt(own_compliance(problem, problem.normal))
    return replace(
        bounds,
        energy_error=(bounds.energy_error or 0.0) + strained / (bounds.energy_scale or 1.0),
        force_error=(bounds.force_error or 0.0) + strained / (bounds.force_scale or 1.0),
        force_bound=bound,
        relative_force_bound=np.nan_to_num(bound) * own / (bounds.force_scale or bounds.energy_scale or 1.0),
    )


def refined_local_lengths(
    problem: LocalProblem, force: Array, found: RefinedForces
) -> tuple[RefinedLengths, float, float, float]:
    """Return refined forces in the form for bodies, the distance of the given ones, the last change and the size."""
    shape, scale = force.shape, problem.contact_scale[:, None]
    W = problem.scaled_delassus

    def norm(forces: Array) -> float:
        scaled = (forces.reshape(shape) / scale).ravel()
        return float(np.sqrt(max(scaled @ (W @ scaled), 0.0)))

    r, u = found.force.double().reshape(shape) / scale, found.velocity.double().reshape(shape) * scale
    meeting = abs(W) @ abs(r).ravel() + (abs(problem.offset).reshape(shape) * scale).ravel()
    correction = float(FINE_EPS * np.linalg.norm(meeting))
    refined = RefinedLengths(r[:, 0], -r[:, 1:], u[:, 0], u[:, 1:], correction)
    apart = norm((extend(force.ravel()) - found.force).double())
    return refined, apart, norm(found.last), norm(found.force.double())


@dataclass(frozen=True, eq=False)
class StateVerdict:
    """The verdict of the comparison, with its basis, distance and messages."""

    basis: str
    distance: float | None = None  # the largest of the three, relative; None without comparison
    energy: float = 0.0  # |u|_K of the answer that it was compared with
    failures: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    displacement: Vector | None = None  # of that answer
    compared: Compared | None = None  # if it is near enough to pass


def figures_alone(reason: str) -> StateVerdict:
    """Return the verdict without a combination for comparison."""
    return StateVerdict(FIGURES_ALONE, notes=(f"the verdict rests on the figures alone: {reason}",))


def with_friction_held(
    problem: ContactProblem,
    answer: Answer,
    condensation: Condensation | None,
    tolerance: float,
    nothing: float,
    reason: str,
) -> StateVerdict:
    """Return the verdict by the bounds of the minimisation with the answer's friction as a load.

    Parameters
    ----------
    problem, answer : ContactProblem, Answer
    condensation : the Condensation of the problem, None where its bodies are not condensed
    tolerance, nothing : the largest relative error that passes; the error that counts as none [square root of energy]
    reason : why there is no combination to compare with
    """
    if problem.tangent is None or answer.friction_force is None:
        return figures_alone(reason)
    load = problem.load - problem.tangent.T @ answer.friction_force.ravel()
    minimised = problem.replace(load=load, friction=np.zeros(problem.contacts))
    held = Answer(answer.displacement, answer.normal_force, None, answer.tie_force)
    if condensation is None and iterated(problem):
        bounds = iterated_bounds(minimised, held, iteration(problem))
    elif condensation is None:
        bounds = energy_bounds(minimised, held)
    else:
        bounds = error_bounds(minimised, held, residuals(minimised, held), condensation)
    pairs = ((bounds.energy_error, bounds.energy_scale), (bounds.force_error, bounds.force_scale))
    far = [error for error, scale in pairs if error is not None and error * (scale or 1.0) > nothing]
    words = error_failures(bounds, tolerance, nothing) if far else ()
    failures = tuple(f"with friction held, {text}" for text in words)
    if force_bound_fails(bounds, tolerance, nothing):
        assert bounds.relative_force_bound is not None
        worst = int(np.argmax(bounds.relative_force_bound))
        failures += (f"with friction held, {messages.of_force_bound(problem, answer, bounds, worst, tolerance)}",)
    return replace(figures_alone(reason), energy=bounds.energy_scale, failures=failures)
