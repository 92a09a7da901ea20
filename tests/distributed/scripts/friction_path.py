"""Load paths with friction over the ranks are those of one process: friction_path.py STEPS NAME... or "lifted"."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import contactqp as cq
from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.running_on_ranks import follow_with_friction

CASES = Path(__file__).parents[3] / "cases"
SAME = 1e-9


def same(ours: np.ndarray, theirs: np.ndarray, what: str) -> None:
    off, size = np.max(abs(ours - theirs)), np.max(abs(theirs))
    assert off <= SAME * size, f"{what} is off by {off} of {size}"


def energies(history: cq.History) -> np.ndarray:
    return np.array([[one.elastic, one.work, one.dissipated] for one in history.energies])


def events(history: cq.History) -> list[tuple[str, str, float]]:
    return [(event.kind, event.name, event.time) for event in history.events]


def compare(name: str, steps: int) -> None:
    scene = cq.load_scene(CASES / f"{name}.toml")
    scene = scene.model_copy(update={"path": scene.path.model_copy(update={"events": None, "steps": steps})})
    ranks = Ranks()
    one, many = ranks.comm.bcast(cq.run(scene) if ranks.rank == 0 else None), cq.run(scene, engine="petsc")
    for part in ("displacements", "normal_forces", "friction_forces"):
        same(getattr(many, part), getattr(one, part), f"{name}: {part}")
    same(energies(many), energies(one), f"{name}: energies")
    assert events(many) == events(one), f"{name}: {events(many)}, not {events(one)}"
    for ours, theirs in zip(many, one, strict=True):
        assert ours.certificate.passed
        assert list(ours.contact_status) == list(theirs.contact_status)
    if ranks.rank == 0:
        print(f"{name}: {len(many)} answers, {', '.join(kind for kind, _, _ in events(many))}", flush=True)


def lifted() -> None:
    """A block without gap is lifted, put down elsewhere, and anchored where it lands."""
    rows = {"normal": [[0.0, 0.0, -1.0]], "gap": [0.0], "tangent": np.eye(3)[:2], "friction": 0.3}
    problem = distribute(cq.ContactProblem(np.diag([2.0, 2.0, 5.0]), np.zeros(3), **rows), Ranks())
    loads = np.array([[0.0, 0.0, 0.0], [2.0, 2.0, 5.0], [4.0, 2.0, -5.0]])[:, problem.dof_number]
    *_, last = follow_with_friction(problem, loads, "active-set")
    origin = problem.gathered(last.problem.slip_origin, problem.contact_number)
    np.testing.assert_allclose(origin, [[1.5, 1.0]], rtol=1e-9)
    if problem.ranks.rank == 0:
        print("lifted: anchored where it lands", flush=True)


if __name__ == "__main__":
    if sys.argv[1:] == ["lifted"]:
        sys.exit(lifted())
    for name in sys.argv[2:]:
        compare(name, int(sys.argv[1]))
