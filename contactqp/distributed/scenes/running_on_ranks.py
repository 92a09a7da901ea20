"""A scene's load, or its load path in steps, on the ranks of MPI."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.analysis.history import Event, History
from contactqp.analysis.load_path import DEFAULT_STEPS, changes
from contactqp.distributed.checkpoint import Checkpoint
from contactqp.distributed.distributing import distribute
from contactqp.distributed.preconditioner import AUTO
from contactqp.distributed.problem import DistributedProblem, DistributedSolution
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.scenes.distributed_bodies import DistributedBodyModel, distributed_model, energies, in_pieces
from contactqp.distributed.scenes.friction_on_ranks import changes_of_rubbing, energies_of_rubbing, follow_rubbing
from contactqp.distributed.solving import judged, solve_distributed
from contactqp.distributed.whole import gathered, options_on_ranks, solve_whole, whole_in_errors
from contactqp.errors import Unsupported
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.scene.building import build
from contactqp.scene.schema import SceneData
from contactqp.scene.unknowns import end_time

if TYPE_CHECKING:
    from contactqp.scene.building import Model

    ModelOnRanks = Model | DistributedBodyModel


# One load after another on the ranks of MPI, each solved for from the answer before.


def follow_distributed(
    problem: DistributedProblem,
    loads: Iterable[Vector],
    method: str,
    checkpoint: Checkpoint | None = None,
    **options: Any,
) -> Iterator[DistributedSolution]:
    """The solution under each load, started from the one before. Collective.

    Parameters
    ----------
    problem : DistributedProblem
        Its load is not used.
    loads : iterable of (n_here,) arrays [force]
    checkpoint : Checkpoint, optional
        Answers that it has are judged again and not solved for; every other one is kept there.
    method, **options
        Of `solve_distributed`.
    """
    before: DistributedSolution | None = None
    for step, load in enumerate(loads):
        at = replace(problem, load=load)
        if checkpoint is not None and step < checkpoint.steps:
            before = judged(at, checkpoint.read(step, at), method, options.get("solver", AUTO))
        else:
            start = None if before is None else before.answer
            before = solve_distributed(at, method, warm_start=start, **options)
            if checkpoint is not None:
                checkpoint.write(step, at, before.answer)
        yield before


def instants(corners: Sequence[Vector], steps: int) -> Iterator[tuple[float, Vector]]:
    """Pseudo-time and load of the start, without a load, and of so many equal steps from corner to corner."""
    rest = np.zeros_like(corners[0])
    yield 0.0, rest
    for leg, (start, end) in enumerate(pairwise([rest, *corners])):
        for i in range(1, steps + 1):
            yield leg + i / steps, end if i == steps else start + i / steps * (end - start)


# What a scene says that changes no answer of it.
_WORDS = ("title", "source", "about", "expect", "published", "remarks", "study", "report")
# Bytes of a digest, as many as two scenes never share by chance; and of a file that are in memory at once.
_SIZE, _CHUNK = 12, 2**20


def run_on_ranks(model: ModelOnRanks, method: str, checkpoint: str | Path | None = None, **options: Any) -> History:
    """As `contactqp.run` with ``engine="petsc"``, of a model that is built already. Collective.

    Raises
    ------
    Unsupported, InvalidProblem
        As there.
    """
    chosen, ranks = options_on_ranks(options), Ranks()
    _refuse(model)
    kept = None
    if checkpoint is not None:
        with ranks.together():
            digest = digest_of(model.scene)
        kept = Checkpoint(checkpoint, digest, ranks)
    if isinstance(model, DistributedBodyModel):
        return _run_pieces(model, method, kept, chosen)
    part = distribute(model.problem, ranks)
    at = list(_instants(model))
    along = _followed(model, part, (load[part.dof_number] for _, load in at), method, kept, chosen)
    with whole_in_errors(model.problem):
        found = list(along)
    whole = [_whole_problem(model.problem, load, solution) for (_, load), solution in zip(at, found, strict=True)]
    solutions = [gathered(problem, solution) for problem, solution in zip(whole, found, strict=True)]
    times = [time for time, _ in at]
    return History(solutions, times, _events(model, solutions, times, model.problem.contact_name))


def _run_pieces(model: DistributedBodyModel, method: str, kept: Checkpoint | None, options: dict[str, Any]) -> History:
    """Nobody ever has the whole; what is asked of the solutions is asked by all ranks together."""
    at = list(_instants(model))
    found = list(_followed(model, model.problem, (load for _, load in at), method, kept, options))
    solutions: Any = in_pieces(model, found)
    times = [time for time, _ in at]
    told = energies_of_rubbing if _rubs_along(model) else energies
    events = _events(model, solutions, times, solutions[0].problem.contact_name)
    return History(solutions, times, events, energies=lambda: told(found))


def _rubs_along(model: ModelOnRanks) -> bool:
    """Whether a path has friction."""
    return model.scene.path is not None and model.problem.frictional


def _followed(
    model: ModelOnRanks,
    part: DistributedProblem,
    loads: Iterator[Vector],
    method: str,
    kept: Checkpoint | None,
    options: dict[str, Any],
) -> Iterator[DistributedSolution]:
    if not _rubs_along(model):
        return follow_distributed(part, loads, method, kept, **options)
    if kept is not None:
        raise Unsupported("engine 'petsc': a checkpoint of a load path with friction")
    return follow_rubbing(part, loads, method, **options)


def _whole_problem(problem: ContactProblem, load: Vector, solution: DistributedSolution) -> ContactProblem:
    """Return the whole problem of one step: with its load and its slip origins."""
    part = solution.problem
    if part.slip_origin is None:
        return problem.replace(load=load)
    return problem.replace(load=load, slip_origin=part.whole(part.slip_origin, part.contact_number))


def _events(
    model: ModelOnRanks, solutions: Sequence[Any], times: Sequence[float], name: Callable[[int], str]
) -> Callable[[], Iterable[Event]]:
    if not _rubs_along(model):
        return lambda: changes(solutions, times)
    names = [name(i) for i in range(len(solutions[0].normal_force))]
    return lambda: changes_of_rubbing(solutions, times, names)


def answer_at(model: ModelOnRanks, time: Fraction, method: str, **options: Any) -> Any:
    """The solution under the load at a pseudo-time, of its own. Collective."""
    if isinstance(model, DistributedBodyModel):
        at = replace(model.problem, load=model.load_at(time))
        return in_pieces(model, [solve_distributed(at, method, **options_on_ranks(options))])[0]
    return solve_whole(model.problem.replace(load=model.load_at(time)), method, **options)


def model_on_ranks(scene: SceneData) -> ModelOnRanks:
    """The scene's model: elastic bodies in pieces; all else is small, and every rank has it. Collective.

    Raises
    ------
    SceneError, BackendMissing
        As `contactqp.scene.building.build`; what one rank refuses, a file that it does not have, all do.
    """
    ranks = Ranks()
    if scene.bodies and not (scene.membranes or scene.motion or scene.large):
        return distributed_model(scene, ranks)
    with ranks.together():
        return build(scene)


def digest_of(scene: SceneData) -> str:
    """Another text for a scene with another answer: of all that it says, and of the mesh files that it names."""
    said = scene.model_copy(update=dict.fromkeys(_WORDS))
    found = hashlib.blake2b(repr(said).encode(), digest_size=_SIZE)
    folder = Path() if scene.file is None else scene.file.parent
    for body in (*scene.bodies, *scene.membranes):
        if (name := getattr(body.mesh, "file", None)) is not None:
            with open(folder / name, "rb") as file:
                while chunk := file.read(_CHUNK):
                    found.update(chunk)
    return found.hexdigest()


def _instants(model: ModelOnRanks) -> Iterator[tuple[float, Vector]]:
    path = model.scene.path
    if path is None:
        return iter([(1.0, model.problem.load)])
    corners = [model.load_at(Fraction(i + 1)) for i in range(int(end_time(model.scene)))]
    return instants(corners, path.steps or DEFAULT_STEPS)


def _refuse(model: ModelOnRanks) -> None:
    scene = model.scene
    path = scene.path
    reasons = {
        "a motion": scene.motion is not None,
        "large deformations": scene.large,
        "exact events of a load path; state its steps alone": path is not None and path.events is not None,
    }
    if found := [what for what, there in reasons.items() if there]:
        raise Unsupported(f"engine 'petsc': {found[0]}")
