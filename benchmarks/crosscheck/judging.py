"""One attempt: solved by its code, judged by what `contactqp check` runs, measured."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import contactqp as cq
from benchmarks.crosscheck import calculix, peers
from benchmarks.crosscheck.attempts import RIGHT, WRONG, Attempt
from benchmarks.crosscheck.block import YOUNG, Block, block, block_in_metres, block_with_friction
from contactqp.exchange.problem_folder import write_problem
from contactqp.study.checking import AnswerVerdict, check_answer
from contactqp.study.verdict import CheckOptions

PROBLEMS: dict[str, Callable[[], Block]] = {
    "block": block,
    "friction": block_with_friction,
    "metres": block_in_metres,
}


@dataclass(frozen=True, eq=False)
class Judged:
    """What came of an attempt."""

    attempt: Attempt
    block: Block
    version: str
    said: str  # by the code of its own answer
    command: str  # that judges it, in the folder of the answers
    verdict: AnswerVerdict

    @property
    def word(self) -> str:
        return RIGHT if self.verdict.passed else WRONG

    @property
    def force_error(self) -> float:
        """Largest error of a normal force, of the largest one."""
        right = _right(self.attempt.problem)
        return float(np.max(abs(self.verdict.certificate.answer.normal_force - right)) / np.max(right))

    @property
    def overlap(self) -> float:
        """The deepest penetration of a contact [length]."""
        return float(max(0.0, -np.min(self.gap)))

    @property
    def gap(self) -> np.ndarray:
        """(m,) gaps of the answer."""
        problem = self.block.problem
        return np.asarray(problem.gap - problem.normal @ self.verdict.certificate.answer.displacement)

    @property
    def pressure(self) -> np.ndarray:
        """(m,) forces of the answer by the areas of the contacts."""
        return np.asarray(self.verdict.certificate.answer.normal_force / self.block.area)

    @property
    def spring(self) -> tuple[float, float]:
        """Least and largest pressure by overlap of the contacts that overlap, of 50 E by a length of 1."""
        overlapping = self.gap < -1e-3 * self.overlap
        stiffness = self.pressure[overlapping] / -self.gap[overlapping]
        return float(np.min(stiffness)) / (50 * YOUNG), float(np.max(stiffness)) / (50 * YOUNG)

    @property
    def pulls(self) -> np.ndarray:
        """(m,) which contacts pull, by more than a thousandth of the largest force that is right."""
        force = self.verdict.certificate.answer.normal_force
        return np.asarray(force < -1e-3 * np.max(_right(self.attempt.problem)))


@cache
def _right(problem: str) -> np.ndarray:
    """(m,) the normal forces of the certified solution."""
    return np.asarray(cq.solve(PROBLEMS[problem]().problem).normal_force)


def prepare(folder: Path) -> None:
    """The problems as folders that `contactqp check` reads, their areas, and the arrays for the processes."""
    for name, make in PROBLEMS.items():
        one = make()
        write_problem(folder / name, one.problem)
        peers.save(one, folder / f"{name}.npz")
    lines = [f"{block().problem.contact_name(i)},{area!r}" for i, area in enumerate(block().area.tolist())]
    (folder / "areas.csv").write_text("\n".join(["contact,area", *lines, ""]))


def own_stiffness(folder: Path) -> float:
    """Let CalculiX store its stiffness and make that the problem's; how far it is from ours, of the largest entry."""
    from contactqp.exchange.matrix_files import read_matrix

    place = folder / "calculix"
    write_problem(place, block().problem)
    calculix.run(place, "block", calculix.matrix_deck(block()))
    theirs, ours = read_matrix(place / "block.sti"), block().problem
    if theirs.labels != ours.dof_names:
        raise RuntimeError("CalculiX has other unknowns than the block")
    stated = json.loads((place / "problem.json").read_text())
    (place / stated["files"]["stiffness"]).unlink()
    stated["files"]["stiffness"] = "block.sti"
    (place / "problem.json").write_text(json.dumps(stated))
    return float(abs(theirs.matrix - ours.stiffness).max() / abs(ours.stiffness).max())


def judge(attempt: Attempt, folder: Path) -> Judged:
    """Solve and judge; the folder has been prepared."""
    name = attempt.name.replace(" ", "-").replace(",", "")
    if attempt.contact is not None:
        problem, answer = "calculix", folder / f"{name}.dat"
        code, said = calculix.run(folder, name, calculix.contact_deck(block(), attempt.contact))
        says, version = f"exit code {code}{_warnings(said)}", calculix.version()
    else:
        problem, answer = attempt.problem, folder / f"{name}.json"
        says, version = peers.run(attempt.code, folder / f"{problem}.npz", answer, attempt.arguments)
    areas = str(folder / "areas.csv") if attempt.pressures else None
    options = CheckOptions(
        tolerance=attempt.limits[0],
        error_tolerance=attempt.limits[1],
        compression=attempt.compression,
        pressure_areas=areas,
    )
    verdict = check_answer(str(folder / problem), str(answer), options)
    if not isinstance(verdict, AnswerVerdict):
        raise TypeError(f"{attempt.name}: {type(verdict).__name__}")
    command = _command(problem, answer.name, attempt)
    return Judged(attempt, PROBLEMS[attempt.problem](), version, says, command, verdict)


def _warnings(said: str) -> str:
    reduced = "hard" in said and "reduced to" in said
    return ", warns that HARD is reduced to LINEAR" if reduced else ""


def _command(problem: str, answer: str, attempt: Attempt) -> str:
    words = ["contactqp check", problem, answer]
    words += ["--compression negative"] if attempt.compression == "negative" else []
    words += ["--pressure-areas areas.csv"] if attempt.pressures else []
    limits = zip(("--tolerance", "--error-tolerance"), attempt.limits, (1e-9, 1e-6), strict=True)
    return " ".join([*words, *(f"{option} {value:g}" for option, value, usual in limits if value != usual)])
