"""A history or many load cases contact by contact, as rows to be printed, plotted or written to a file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar, overload

from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array
from contactqp.model.problem_data import Units
from contactqp.model.solution import Solution
from contactqp.model.summary import Printed, Table, csv_text, number, without_rounding

# Rows that are printed, at most.
PRINTED = 40


@dataclass(frozen=True)
class ContactRow:
    """One contact at one instant; forces and gaps that are rounding of the terms they are the sum of are 0."""

    instant: int  # its place in the history, from 0 at the start
    time: float
    contact: str
    status: str  # "open", "closed", "grazing", "stick" or "slip"
    normal_force: float  # positive in compression
    friction_force: tuple[float, ...]  # (d-1,) l_T, what the body does to the obstacle; () without friction
    gap: float  # positive when open

    @property
    def cells(self) -> tuple[Any, ...]:
        """Return the row's entries in the order of `ContactTable.columns`."""
        return (
            self.instant, self.time, self.contact, self.status, self.normal_force, *self.friction_force, self.gap
        )  # fmt: skip


@dataclass(frozen=True)
class CaseRow:
    """One contact in one load case, as `Solutions` has it; numbers are NaN where the case has no answer."""

    case: int | str  # its number from 0 on, or its name
    contact: str
    status: str  # "open", "closed", "grazing", "stick", "slip" or, without an answer, "unknown"
    normal_force: float  # positive in compression
    friction_force: tuple[float, ...]  # (d-1,) l_T, what the body does to the obstacle; () without friction
    gap: float  # positive when open
    passed: bool  # the verdict on the case

    @property
    def cells(self) -> tuple[Any, ...]:
        """Return the row's entries in the order of `ContactTable.columns`."""
        return self.case, self.contact, self.status, self.normal_force, *self.friction_force, self.gap, self.passed


Row = TypeVar("Row", ContactRow, CaseRow)


@dataclass(frozen=True)
class ContactTable(Printed, Sequence[Row], Generic[Row]):
    """The table of `History.table` or `Solutions.table`: a row for each contact at each instant or in each load case.

    `str` prints it.
    """

    columns: tuple[str, ...]  # with units where the problem has them: "time [s]", "normal_force [N]"
    rows: tuple[Row, ...]

    @overload
    def __getitem__(self, place: int) -> Row: ...

    @overload
    def __getitem__(self, place: slice) -> tuple[Row, ...]: ...

    def __getitem__(self, place: int | slice) -> Row | tuple[Row, ...]:
        return self.rows[place]

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        return f"ContactTable({len(self)} rows: {', '.join(self.columns)})"

    def __str__(self) -> str:
        shown = self.rows[:PRINTED]
        cells = tuple(
            tuple(number(cell) if isinstance(cell, float) else str(cell) for cell in row.cells) for row in shown
        )
        few = f", the first {len(shown)} shown; to_csv() has all" if len(shown) < len(self) else ""
        title = f"{len(self)} row{'' if len(self) == 1 else 's'}{few}"
        first = "#" if self.columns[0] == "instant" else self.columns[0]
        headings = (first, *(name.replace("_force", "") for name in self.columns[1:]))
        return Table(title, headings, cells).text()

    def to_dicts(self) -> list[dict[str, Any]]:
        """Return rows as plain data with one key for each column."""
        return [dict(zip(self.columns, row.cells, strict=True)) for row in self.rows]

    def to_csv(self) -> str:
        """Return comma-separated values with a header; numbers have all their digits."""
        return csv_text(self.columns, (row.cells for row in self.rows))

    def write_csv(self, file: str | Path) -> None:
        """Write `to_csv` to a file.

        Raises
        ------
        InvalidProblem
            The file cannot be written.
        """
        try:
            Path(file).write_text(self.to_csv(), encoding="utf-8", newline="\n")
        except (OSError, ValueError) as error:
            raise InvalidProblem(
                f"{file}: expected a file that can be written, got: {getattr(error, 'strerror', None) or error}"
            ) from None


def contact_table(history: Sequence[Solution], times: Sequence[float], time_label: str) -> ContactTable[ContactRow]:
    """Return the table of a history; its solutions are certified on the way.

    Parameters
    ----------
    history : sequence of Solution
    times : sequence of float
    time_label : str
        The heading of the column of times, with their unit.
    """
    friction = history[0].friction_force if len(history) else None
    measured = columns_of(history[0].problem.units if len(history) else Units(), friction)
    rows = (row for k, solution in enumerate(history) for row in _rows(k, float(times[k]), solution))
    return ContactTable(("instant", time_label, "contact", "status", *measured), tuple(rows))


def columns_of(units: Units, friction: Array | None) -> list[str]:
    """Return the headings of forces and gap, with units; `friction` (..., d-1) is the friction force, if there is."""
    components = 0 if friction is None else friction.shape[-1]
    names = ["friction_force"] if components == 1 else [f"friction_force_{k + 1}" for k in range(components)]
    force, length = (f" [{unit}]" if unit else "" for unit in (units.force, units.length))
    return [*(f"{name}{force}" for name in ("normal_force", *names)), f"gap{length}"]


def _rows(instant: int, time: float, solution: Solution) -> Iterator[ContactRow]:
    clean, problem = without_rounding(solution), solution.problem
    normal, gap = clean.normal_force.tolist(), clean.gap.tolist()
    friction = [[]] * len(normal) if clean.friction_force is None else clean.friction_force.tolist()
    for i, status in enumerate(solution.contact_status):
        name = problem.contact_name(i)
        yield ContactRow(instant, time, name, str(status), normal[i], tuple(friction[i]), gap[i])
