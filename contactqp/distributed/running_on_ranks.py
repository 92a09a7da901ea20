"""Solve a scene's load, or its load path in steps, on the ranks of MPI.

With friction a path is computed as in one process, with slip measured from the previous position of each contact, or
from where it closed. The state of contacts before a step (`contactqp.analysis.friction_step`), a few numbers for each,
is complete on every rank, so that all ranks take the same decisions.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.analysis.friction_step import (
    GAP_ROUNDING,
    SAME_DISPLACEMENT,
    STILL,
    WIDENED,
    WIDENINGS,
    Anchors,
    SolvedStep,
    State,
    step_to,
    widening,
)
from contactqp.analysis.history import Energies, Event, History, contact_changes
from contactqp.analysis.load_path import DEFAULT_STEPS, changes
from contactqp.distributed.checkpoint import Checkpoint
from contactqp.distributed.distributed_bodies import DistributedBodyModel, distributed_model, energies, in_pieces
from contactqp.distributed.distributing import distribute
from contactqp.distributed.preconditioner import AUTO
from contactqp.distributed.problem import DistributedProblem, DistributedSolution
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solving import (
    certified_solution,
    options_on_ranks,
    solve_distributed,
    solve_whole,
    whole_in_errors,
    whole_solution,
)
from contactqp.distributed.violations import row_sizes
from contactqp.errors import NoEquilibrium, NotConverged, Unsupported
from contactqp.linalg.measures import reciprocal
from contactqp.model.arrays import Array, Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.scene.building import build
from contactqp.scene.schema import SceneData, end_time

if TYPE_CHECKING:
    from contactqp.scene.building import Model

    ModelOnRanks = Model | DistributedBodyModel


def follow_distributed(
    problem: DistributedProblem,
    loads: Iterable[Vector],
    method: str,
    checkpoint: Checkpoint | None = None,
    **options: Any,
) -> Iterator[DistributedSolution]:
    """Yield the solution without friction under each load, started from the previous one. Collective.

    Parameters
    ----------
    problem : the problem; its own load is not used
    loads : iterable of (n_here,) arrays, the loads [force]
    method : as in `solve_distributed`
    checkpoint : answers that it has are certified again and not solved for; every other one is written there
    **options
        Options of `solve_distributed`.
    """
    before: DistributedSolution | None = None
    for step, load in enumerate(loads):
        at = replace(problem, load=load)
        if checkpoint is not None and step < checkpoint.steps:
            before = certified_solution(at, checkpoint.read(step, at), method, options.get("solver", AUTO))
        else:
            before = _solved_from(before, at, method, options)
            if checkpoint is not None:
                checkpoint.write(step, at, before.answer)
        yield before


def _solved_from(
    start: DistributedSolution | None, problem: DistributedProblem, method: str, options: dict[str, Any]
) -> DistributedSolution:
    return solve_distributed(problem, method, warm_start=None if start is None else start.answer, **options)


def follow_with_friction(
    problem: DistributedProblem,
    loads: Iterable[Vector],
    method: str,
    checkpoint: Checkpoint | None = None,
    **options: Any,
) -> Iterator[DistributedSolution]:
    """Yield the solution with friction under each load (n_here,). Collective.

    The problem of each solution has the slip origins of its step, as those of `contactqp.follow_path`.

    Raises Unsupported: a checkpoint is given.

    Parameters
    ----------
    problem : the problem; its own load is not used
    loads : iterable of (n_here,) arrays, the loads [force]
    method : as in `solve_distributed`
    checkpoint : None, a checkpoint is refused
    **options
        Options of `solve_distributed`.
    """
    if checkpoint is not None:
        raise Unsupported("engine 'petsc': a checkpoint of a load path with friction")
    stepper = _Stepper(problem, method, options)
    origin = problem.gathered(_origin(problem), problem.contact_number)
    anchors, state = Anchors(origin, np.zeros(len(origin), dtype=bool)), None
    for load in loads:
        if state is None:
            stepper.turn(load, load)
            state = stepper.solve(1.0, origin, np.zeros(len(origin), dtype=bool))
            # A closed contact without force is at the problem's slip origin.
            at_rest = state.touching & ~state.pushes
            anchors = Anchors(np.where(at_rest[:, None], origin, state.position), state.touching)
            stepper.accept(state)
        else:
            stepper.turn(stepper.load, load)
            state = stepper.accept(step_to(1.0, replace(state, fraction=0.0), anchors, stepper.solve))
            anchors = Anchors(state.position, state.touching)
        yield stepper.before


class _Stepper:
    """Implements `contactqp.analysis.friction_step.SolveStepper` over the ranks; all methods are collective."""

    before: DistributedSolution

    def __init__(self, problem: DistributedProblem, method: str, options: dict[str, Any]) -> None:
        self._problem, self._method, self._options = problem, method, options
        self._start_solution: DistributedSolution | None = None
        self._farthest = float(problem.ranks.max(float(np.max(abs(problem.gap), initial=0.0))))
        self._compliance = row_sizes(problem, problem.normal).compliance

    def turn(self, start: Vector, load: Vector) -> None:
        """Start the step from one load to the next."""
        self._start, self.load = start, load

    def solve(self, fraction: float, origin: Array, held_open: Mask) -> State:
        """Return the equilibrium at a fraction of the load step.

        `origin` (m, d-1) and `held_open` (m,) are the slip origins and the contacts held open, of all ranks.
        """
        problem, here = self._problem, self._problem.contact_number
        load = self.load if fraction == 1 else self._start + fraction * (self.load - self._start)
        pulled = problem.ranks.max(float(np.max(reciprocal(np.sqrt(problem.diagonal)) * abs(load), initial=0.0)))
        far = np.where(
            held_open[here], widening(abs(problem.gap), self._farthest, self._compliance, float(pulled)), 0.0
        )
        for k in range(WIDENINGS):
            at = replace(problem, load=load, slip_origin=origin[here], gap=problem.gap + far * WIDENED**k)
            solution = _solved_from(self._start_solution, at, self._method, self._options)
            if not problem.ranks.any(solution.answer.normal_force[held_open[here]] > 0):
                return self._state(solution, fraction, held_open, origin)
        raise NoEquilibrium("a contact that is held open closes")

    def accept(self, state: State) -> State:
        """Return a state as a step of the path, with the gaps of the problem; the next solve starts from it.

        Raises
        ------
        NotConverged
            The result depends on contacts that do not reach their obstacle: there are several equilibria.
        """
        found: Any = state.step.finish()
        ranks = self._problem.ranks
        if ranks.any(found.problem.gap != self._problem.gap):
            wide = found.answer.displacement
            found = _solved_from(found, replace(found.problem, gap=self._problem.gap), self._method, self._options)
            moved = np.array([np.max(abs(part), initial=0.0) for part in (found.answer.displacement - wide, wide)])
            change, size = ranks.max(moved)
            if change > SAME_DISPLACEMENT * size:
                raise NotConverged("contacts that need not close may: several equilibria, and one was asked for")
        self.before = self._start_solution = found
        return state

    def _state(self, solution: DistributedSolution, fraction: float, held_open: Mask, origin: Array) -> State:
        """Return the state of a solution for the next step, with the gaps of the problem."""
        problem, u = self._problem, solution.answer.displacement
        rows: Any = problem.tangent
        largest = float(problem.ranks.max(float(np.max(np.sqrt(problem.metric) * abs(u), initial=0.0))))
        lengths = problem.normal.length_sizes(u) + abs(problem.gap)
        rounding = GAP_ROUNDING * (lengths + np.sqrt(row_sizes(problem, problem.normal).compliance) * largest)
        gap = problem.gap - problem.normal.lengths(u)
        position = rows.lengths(u).reshape(_origin(problem).shape)
        still = STILL * (rows.length_sizes(u) + np.sqrt(row_sizes(problem, rows).compliance) * largest)
        still = still.reshape(position.shape)
        gap, rounding, position, still = (self._gathered(part) for part in (gap, rounding, position, still))
        pushes = self._gathered(solution.answer.normal_force) > 0
        step: Any = solution
        return State(
            fraction=fraction,
            gap=gap,
            position=position,
            pushes=pushes,
            slides=pushes & (self._gathered(solution.status) == "slip"),
            touching=pushes | (gap <= rounding),
            overlap=held_open & (gap < -rounding),
            step=SolvedStep(step),
            origin=origin,
            still=still,
        )

    def _gathered(self, values: Any) -> Any:
        return self._problem.gathered(values, self._problem.contact_number)


def energies_with_friction(solutions: Sequence[DistributedSolution]) -> Iterator[Energies]:
    """Yield the energies of each step, as `contactqp.History.energies` with friction. Collective."""
    work = dissipated = 0.0
    before: Vector | None = None
    for now in solutions:
        problem, u = now.problem, now.answer.displacement
        dot, moved = problem.ranks.dot, np.zeros_like(u) if before is None else u - before
        work += dot(problem.load - problem.product(moved) / 2, moved)
        rows, friction = problem.tangent, now.answer.friction_force
        if before is not None and rows is not None and friction is not None:
            dissipated += dot(friction.ravel(), rows.lengths(u) - _origin(problem).ravel())
        before = u
        yield Energies(dot(u, problem.product(u)) / 2, kinetic=0.0, work=work, dissipated=dissipated)


def _origin(problem: DistributedProblem) -> Array:
    """Return the slip origins (m_here, d-1)."""
    if problem.slip_origin is None:
        raise ValueError("a path with friction of a problem without tangential rows")
    return problem.slip_origin


# The fields of a scene that do not affect its answers.
_WORDS = ("title", "source", "about", "expect", "published", "remarks", "study", "report")
# Bytes of a digest, enough to exclude collisions, and of a file in memory at once.
_SIZE, _CHUNK = 12, 2**20


def run_on_ranks(model: ModelOnRanks, method: str, checkpoint: str | Path | None = None, **options: Any) -> History:
    """Solve a model like `contactqp.run` with ``engine="petsc"``. Collective.

    Raises Unsupported, InvalidProblem as `contactqp.run` does.

    Parameters
    ----------
    model : Model or DistributedBodyModel, the model of a scene
    method : as in `solve_distributed`
    checkpoint : str or Path, optional
        A folder where the steps of a path are kept.
    **options
        Options of `contactqp.run`.
    """
    chosen, ranks = options_on_ranks(options), Ranks()
    _refuse(model)
    steps = None
    if checkpoint is not None:
        with ranks.raising_together():
            digest = digest_of(model.scene)
        steps = Checkpoint(checkpoint, digest, ranks)
    friction = model.scene.path is not None and model.problem.frictional
    follow = follow_with_friction if friction else follow_distributed
    at = list(_instants(model))
    times = [time for time, _ in at]
    if isinstance(model, DistributedBodyModel):
        found = list(follow(model.problem, (load for _, load in at), method, steps, **chosen))
        solutions: Any = in_pieces(model, found)
        compute = energies_with_friction if friction else energies
        events = _events(solutions, times, solutions[0].problem.contact_name, friction)
        return History(solutions, times, events, energies=lambda: compute(found))
    part = distribute(model.problem, ranks)
    with whole_in_errors(model.problem):
        found = list(follow(part, (load[part.dof_number] for _, load in at), method, steps, **chosen))
    problems = [_whole_problem(model.problem, load, solution) for (_, load), solution in zip(at, found, strict=True)]
    solutions = [whole_solution(problem, solution) for problem, solution in zip(problems, found, strict=True)]
    return History(solutions, times, _events(solutions, times, model.problem.contact_name, friction))


def _whole_problem(problem: ContactProblem, load: Vector, solution: DistributedSolution) -> ContactProblem:
    """Return the whole problem of one step: with its load and its slip origins."""
    part = solution.problem
    if part.slip_origin is None:
        return problem.replace(load=load)
    return problem.replace(load=load, slip_origin=part.gathered(part.slip_origin, part.contact_number))


def _events(
    solutions: Sequence[Any], times: Sequence[float], name: Callable[[int], str], friction: bool
) -> Callable[[], Iterable[Event]]:
    """Return a function that finds every change of a contact's state, at the first step after it."""
    if not friction:
        return lambda: changes(solutions, times)

    def with_friction() -> Iterable[Event]:
        states = [(one.normal_force > 0, (one.normal_force > 0) & (one.contact_status == "slip")) for one in solutions]
        return contact_changes(states, times, name)

    return with_friction


def answer_at(model: ModelOnRanks, time: Fraction, method: str, **options: Any) -> Any:
    """Return the solution under the load at a pseudo-time, solved separately. Collective.

    Parameters
    ----------
    model : Model or DistributedBodyModel, the model of a scene
    time : the pseudo-time of the load path
    method : as in `solve_distributed`
    **options
        Options of `contactqp.run`.
    """
    if isinstance(model, DistributedBodyModel):
        at = replace(model.problem, load=model.load_at(time))
        return in_pieces(model, [solve_distributed(at, method, **options_on_ranks(options))])[0]
    return solve_whole(model.problem.replace(load=model.load_at(time)), method, **options)


def model_on_ranks(scene: SceneData) -> ModelOnRanks:
    """Return the model of a scene: elastic bodies in pieces, all other scenes whole on every rank. Collective.

    Raises
    ------
    SceneError, BackendMissing
        As `contactqp.scene.building.build`; an error of one rank, such as a missing file, is raised on all.
    """
    ranks = Ranks()
    if scene.bodies and not (scene.membranes or scene.motion or scene.large):
        return distributed_model(scene, ranks)
    with ranks.raising_together():
        return build(scene)


def digest_of(scene: SceneData) -> str:
    """Return a hash of all data of a scene that affect its answers, including the contents of mesh files."""
    stated = scene.model_copy(update=dict.fromkeys(_WORDS))
    found = hashlib.blake2b(repr(stated).encode(), digest_size=_SIZE)
    folder = Path() if scene.file is None else scene.file.parent
    for body in (*scene.bodies, *scene.membranes):
        if (name := getattr(body.mesh, "file", None)) is not None:
            with open(folder / name, "rb") as file:
                while chunk := file.read(_CHUNK):
                    found.update(chunk)
    return found.hexdigest()


def _instants(model: ModelOnRanks) -> Iterator[tuple[float, Vector]]:
    """Yield pseudo-time and load of the unloaded start and of equal steps between the corners of a path."""
    path = model.scene.path
    if path is None:
        yield 1.0, model.problem.load
        return
    corners = [model.load_at(Fraction(i + 1)) for i in range(int(end_time(model.scene)))]
    rest, steps = np.zeros_like(corners[0]), path.steps or DEFAULT_STEPS
    yield 0.0, rest
    for leg, (start, end) in enumerate(pairwise([rest, *corners])):
        for i in range(1, steps + 1):
            yield leg + i / steps, end if i == steps else start + i / steps * (end - start)


def _refuse(model: ModelOnRanks) -> None:
    scene, path = model.scene, model.scene.path
    reasons = {
        "a motion": scene.motion is not None,
        "large deformations": scene.large,
        "exact events of a load path; state its steps alone": path is not None and path.events is not None,
    }
    if found := [feature for feature, present in reasons.items() if present]:
        raise Unsupported(f"engine 'petsc': {found[0]}")
