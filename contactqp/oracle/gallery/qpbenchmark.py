"""The gallery as a test set of qpbenchmark, in the form that its CONTRIBUTING.md asks for, exact answers beside.

    contact_problems.py    the class ContactProblems: `qpbenchmark contact_problems.py run`
    data/NAME.npz          one problem, as `qpsolvers.Problem.save` writes it
    answers/NAME.json      its exact answer in qpsolvers' names and signs: x, y, z, and the cost
    results/               where qpbenchmark writes its report
    README.md              what the problems are

With G = E_N, h = g, A, b of the ties, z is l_N and y is nu; no sign is flipped. Coulomb's friction is no quadratic
program: problems with friction are left out.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.oracle.gallery.algebra import times
from contactqp.oracle.gallery.gallery import filled
from contactqp.oracle.gallery.problem import GalleryProblem

SCRIPT = "contact_problems.py"
PROGRAM = '''"""Contact problems with exact answers: bodies on obstacles, redundant contacts, bodies that float."""

from pathlib import Path
from typing import Iterator

import qpbenchmark
from qpbenchmark.benchmark import main
from qpbenchmark.problem import Problem

HERE = Path(__file__).resolve().parent


class ContactProblems(qpbenchmark.TestSet):
    """The problems in data/, whose exact answers lie in answers/."""

    @property
    def title(self) -> str:
        return "Contact problems with exact answers"

    @property
    def description(self) -> str:
        return "Elastic bodies pressed onto obstacles; every answer is known in rational numbers."

    @property
    def sparse_only(self) -> bool:
        return False

    def __iter__(self) -> Iterator[Problem]:
        for path in sorted((HERE / "data").glob("*.npz")):
            yield Problem.load(str(path))


if __name__ == "__main__":
    main(test_set_path=str(Path(__file__).resolve()), results_path=str(HERE / "results" / "qpbenchmark_results.csv"))
'''
README = """# Contact problems with exact answers

A test set for [qpbenchmark](https://github.com/qpsolvers/qpbenchmark), written by `contactqp gallery --as qpbenchmark`.

    pip install qpbenchmark
    python {script} run

`answers/NAME.json` has the exact answer of `data/NAME.npz` as doubles and as fractions: `x`, the multipliers `z` of
G x <= h and `y` of A x = b, and the cost. Where `unique_multipliers` is false, others are right too. Where `rounding`
is not zero, the answer is that of fractions to which the doubles are the nearest, and may be off by that part.

| problem | unknowns | rows of G | rows of A | what it is |
|---|---|---|---|---|
{rows}
"""


def write_qpbenchmark(folder: str | Path, problems: Sequence[GalleryProblem]) -> tuple[Path, int]:
    """Write the problems without friction as a test set of qpbenchmark to a folder that is new or empty.

    Returns
    -------
    tuple of Path and int
        The folder, and how many problems are in it.

    Raises
    ------
    InvalidProblem
        Something is in the folder, no problem is without friction, or the file system refuses.
    """
    programs = [known for known in problems if not known.problem.frictional]
    if not programs:
        raise InvalidProblem(f"{folder}: expected a problem without friction, which alone is a quadratic program")

    def fill(root: Path) -> None:
        for name in ("data", "answers", "results"):
            (root / name).mkdir()
        for known in programs:
            np.savez(root / "data" / f"{known.name}.npz", **_arrays(known))
            _write(root / "answers" / f"{known.name}.json", json.dumps(_answer(known), indent=1) + "\n")
        _write(root / "results" / ".gitkeep", "")
        _write(root / "README.md", README.format(script=SCRIPT, rows="\n".join(_row(known) for known in programs)))
        _write(root / SCRIPT, PROGRAM)

    return filled(folder, fill, last=SCRIPT), len(programs)


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _row(known: GalleryProblem) -> str:
    data = known.data
    what = known.description.replace("|", "/").replace("\n", " ")
    return f"| {known.name} | {data.unknowns} | {data.contacts} | {len(data.tie)} | {what} |"


def _arrays(known: GalleryProblem) -> dict[str, Any]:
    """P, q, G, h, A, b, lb, ub; those that are none are objects, as `qpsolvers.Problem.save` writes them."""
    program = known.problem.to_qp()
    parts = {name: getattr(program, name) for name in ("P", "q", "G", "h", "A", "b", "lb", "ub")}
    return {name: np.array(part.toarray() if hasattr(part, "toarray") else part) for name, part in parts.items()}


def _answer(known: GalleryProblem) -> dict[str, Any]:
    data, exact = known.data, known.exact
    u = exact.displacement
    terms = zip(times(data.stiffness, u), data.load, u, strict=True)
    cost = sum(((force / 2 - load) * moved for force, load, moved in terms), Fraction(0))
    parts = {"x": exact.displacement, "z": exact.normal_force, "y": exact.tie_force}
    return {
        **{name: [float(value) for value in values] for name, values in parts.items()},
        "cost": float(cost),
        "exact": {**{name: [str(value) for value in values] for name, values in parts.items()}, "cost": str(cost)},
        "unique_x": known.unique_displacement,
        "unique_multipliers": known.unique_forces,
        "rounding": float(known.rounding),
        "source": known.source,
    }
