"""A scene's load, or its load path in steps, on the ranks of MPI."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contactqp.analysis.history import History
from contactqp.analysis.load_path import DEFAULT_STEPS, changes
from contactqp.distributed.checkpoint import Checkpoint
from contactqp.distributed.distributing import distribute
from contactqp.distributed.path import follow_distributed, instants
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.whole import gathered, options_on_ranks, whole_in_errors
from contactqp.errors import Unsupported
from contactqp.problem import Vector
from contactqp.scene.corners import end_time
from contactqp.scene.schema import Scene

if TYPE_CHECKING:
    from contactqp.scene.models import Model

# What a scene says that changes no answer of it.
_WORDS = ("title", "source", "about", "expect", "published", "remarks", "study", "report")
# Bytes of a digest, as many as two scenes never share by chance; and of a file that are in memory at once.
_SIZE, _CHUNK = 12, 2**20


def run_on_ranks(model: Model, method: str, checkpoint: str | Path | None = None, **options: Any) -> History:
    """As `contactqp.run` with ``engine="petsc"``, of a model that every rank has. Collective.

    Raises
    ------
    Unsupported, InvalidProblem
        As there.
    """
    scene, chosen, ranks = model.scene, options_on_ranks(options), Ranks()
    _refuse(model)
    kept = None
    if checkpoint is not None:
        with ranks.together():
            digest = digest_of(scene)
        kept = Checkpoint(checkpoint, digest, ranks)
    part = distribute(model.problem, ranks)
    at = list(_instants(model))
    along = follow_distributed(part, (load[part.dof_number] for _, load in at), method, kept, **chosen)
    with whole_in_errors(model.problem):
        solutions = [
            gathered(model.problem.replace(load=load), solution) for (_, load), solution in zip(at, along, strict=True)
        ]
    times = [time for time, _ in at]
    return History(solutions, times, lambda: changes(solutions, times))


def digest_of(scene: Scene) -> str:
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


def _instants(model: Model) -> Iterator[tuple[float, Vector]]:
    path = model.scene.path
    if path is None:
        return iter([(1.0, model.problem.load)])
    corners = [model.load_at(Fraction(i + 1)) for i in range(int(end_time(model.scene)))]
    return instants(corners, path.steps or DEFAULT_STEPS)


def _refuse(model: Model) -> None:
    scene = model.scene
    path = scene.path
    reasons = {
        "a motion": scene.motion is not None,
        "large deformations": scene.large,
        "exact events of a load path; state its steps alone": path is not None and path.events is not None,
        "a load path with friction": path is not None and model.problem.frictional,
    }
    if found := [what for what, there in reasons.items() if there]:
        raise Unsupported(f"engine 'petsc': {found[0]}")
