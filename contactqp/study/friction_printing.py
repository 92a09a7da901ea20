"""Outcomes of frictional files as a table on a screen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from contactqp.study.file_outcome import FileOutcome
from contactqp.study.friction_files import SHARED_FIGURES, figures

# Contacts on a screen; --json has all.
MOST_CONTACTS = 10
PASSED, REFUSED = Text("passed", style="green"), Text("REFUSED", style="red")


def print_outcomes(console: Console, outcomes: Sequence[FileOutcome]) -> None:
    """One row a file and method: sizes, the worst of each figure, the errors that other codes publish."""
    if not outcomes:
        return
    header = ["file", "contacts", "", "algorithm", "state of contacts", *(n.replace("_", " ") for n in SHARED_FIGURES)]
    header += ["natural map", "siconos", "asymmetry", "seconds", "certificate"]
    table = Table(box=box.SIMPLE, pad_edge=False)
    for title in header:
        table.add_column(title, no_wrap=title == "file")
    for outcome in outcomes:
        table.add_row(*_row(outcome))
    console.print(table)


def _row(outcome: FileOutcome) -> list[str | Text]:
    solution = outcome.solution
    known = figures(solution.certificate) if solution is not None else {}
    states = ", ".join(f"{number} {status}" for status, number in outcome.statuses.items())
    return [
        escape(Path(outcome.file).name),
        f"{outcome.problem.contacts}",
        f"{outcome.problem.dimension}D"
        if outcome.problem.dimension > 1
        else "",  # without tangential rows nothing says
        escape(solution.method) if solution is not None else "",
        states,
        *(_figure(known.get(name)) for name in (*SHARED_FIGURES, "natural_map", "siconos_error")),
        f"{outcome.problem.asymmetry:.0e}",
        f"{outcome.seconds:.2f}",
        PASSED if outcome.passed else REFUSED,
    ]


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.1e}"


def vector_text(values: NDArray[np.float64]) -> str:
    """``(1, 2.5, -3)``."""
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"
