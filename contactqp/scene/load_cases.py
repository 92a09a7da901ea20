"""Solve a case under many loads from a table of load cases, and print and write the answers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from rich.console import Console
from rich.markup import escape

from contactqp.analysis.load_cases import Solutions
from contactqp.analysis.many_loads import solve_many
from contactqp.errors import InvalidProblem, Unsupported, counted
from contactqp.exchange.files import write_whole
from contactqp.exchange.tables import CaseRows, read_case_rows
from contactqp.model.problem import ContactProblem
from contactqp.model.summary import finite, number
from contactqp.scene.judging import Knob, Trial
from contactqp.scene.scene import build_for
from contactqp.scene.schema import SceneData
from contactqp.scene.tables import print_noted


@dataclass(frozen=True, eq=False)
class CaseAnswers:
    """The answers of a scene under many loads, by the names of the load cases."""

    scene: SceneData
    names: tuple[str, ...]
    solutions: Solutions

    @property
    def met(self) -> bool:
        """Return whether every load case has a certified answer."""
        return bool(self.solutions.passed.all())


def solve_cases(scene: SceneData, file: str, method: str, knobs: Mapping[str, Knob]) -> CaseAnswers:
    """Solve a scene under each load case of a table, in the scene's units; omitted values are those of the scene.

    Raises Unsupported: the scene has a load path, a motion or large deformations; InvalidProblem: the table is invalid
    or names unknown columns.

    Parameters
    ----------
    scene : Scene
    file : the table, whose columns are named as `read_case_rows` says
    method : a name of `contactqp.methods()`
    knobs : mapping, options of the method by name, stiffnesses with their units
    """
    if scene.path is not None or scene.motion is not None or scene.large:
        raise Unsupported("--loads: of cases without load path, motion and large deformations")
    problem: ContactProblem = build_for(scene).problem
    contacts = [problem.contact_name(i) for i in range(problem.contacts)]
    rows = read_case_rows(Path(file), [problem.dof_name(j) for j in range(problem.dimension)], contacts)
    if not rows.names:
        raise InvalidProblem(f"{file}: expected a row for each load case, got none")
    given: dict[str, Any] = dict(loads=_loads(problem, rows), gaps=_filled(problem.gap, rows.gaps, len(rows.names)))
    if rows.friction is not None and problem.friction is None:
        raise InvalidProblem(f"{file}: friction: expected a case whose contacts have friction, got one without")
    if rows.friction is not None and problem.friction is not None:
        columns = dict.fromkeys(range(problem.contacts), rows.friction)
        given["friction"] = _filled(problem.friction, columns, len(rows.names))
    options = Trial(method, dict(knobs)).options(scene)
    return CaseAnswers(scene, rows.names, solve_many(problem, method=method, **given, **options))


def _loads(problem: ContactProblem, rows: CaseRows) -> Any:
    """Return the loads of all cases as a sparse matrix, since few unknowns of a body are loaded."""
    loaded = np.union1d(np.flatnonzero(problem.load), np.array(list(rows.loads), dtype=np.intp))
    own = {int(j): (None,) * len(rows.names) for j in loaded}
    columns = _filled(problem.load[loaded], {k: (own | rows.loads)[j] for k, j in enumerate(own)}, len(rows.names))
    at = np.tile(loaded, len(rows.names)), np.arange(0, columns.size + 1, max(len(loaded), 1))
    ends = at[1] if len(loaded) else np.zeros(len(rows.names) + 1, dtype=np.intp)
    return sp.csr_array((columns.ravel(), at[0], ends), shape=(len(rows.names), problem.dimension))


def _filled(own: Any, columns: Mapping[int, Sequence[float | None]], count: int) -> Any:
    """Return one row for each case, the problem's own values with the stated ones inserted."""
    filled = np.tile(own, (count, 1))
    for place, cells in columns.items():
        stated = [i for i, cell in enumerate(cells) if cell is not None]
        filled[stated, place] = [cells[i] for i in stated]
    return filled


def print_cases(console: Console, answers: CaseAnswers) -> None:
    """Print a line for each load case, with its largest force, and the envelope of the forces."""
    many = answers.solutions
    console.print(f"[bold]{escape(answers.scene.title)}[/bold]", soft_wrap=True)
    largest = f"largest force [{answers.scene.units.force}]"
    columns = ["load case", "closed", largest, "at", "certificate", ""]
    print_noted(console, columns, list(_lines(answers)), [[why] for why in many.failures])
    worst = many.envelope()
    if np.any(worst.load >= 0):
        named = [answers.names[i] if i >= 0 else "" for i in worst.load]
        cells = zip(worst.names, map(number, worst.normal_force), named, strict=True)
        print_noted(console, ["contact", largest, "load case"], list(map(list, cells)), [[]] * len(named))
    console.print(f"{int(many.passed.sum())} of {counted('load case', len(many))} passed")


def _lines(answers: CaseAnswers) -> Iterator[list[str]]:
    many, problem = answers.solutions, answers.solutions.problem
    status = many.contact_status
    for i, name in enumerate(answers.names):
        verdict = ("passed, proven" if many.proven[i] else "passed") if many.passed[i] else "REFUSED"
        if not problem.contacts or np.isnan(many.normal_force[i]).any():
            yield [name, "", "", "", verdict]
            continue
        worst = int(np.argmax(many.normal_force[i]))
        closed = str(int(np.sum(status[i] != "open")))
        yield [name, closed, number(many.normal_force[i, worst]), problem.contact_name(worst), verdict]


def write_cases(answers: CaseAnswers, file: str) -> None:
    """Write a row for each contact of each load case as comma-separated values, numbers with all their digits."""
    write_whole(Path(file), answers.solutions.table(answers.names).write_csv)


def cases_data(answers: CaseAnswers) -> list[dict[str, Any]]:
    """Return each load case as plain data."""
    many, problem = answers.solutions, answers.solutions.problem
    status, names = many.contact_status, [problem.contact_name(j) for j in range(problem.contacts)]

    def by_name(values: Any) -> dict[str, Any]:
        found = values.tolist() if values.dtype.kind == "U" else finite(values)
        return dict(zip(names, found, strict=True))

    return [
        {
            "case": name,
            "passed": bool(many.passed[i]),
            "proven": bool(many.proven[i]),
            "failure": many.failures[i] or None,
            "status": by_name(status[i]),
            "normal_force": by_name(many.normal_force[i]),
            "gap": by_name(many.gap[i]),
        }
        for i, name in enumerate(answers.names)
    ]
