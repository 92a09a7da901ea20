"""The cells of a report run, and their results put together: first all answers side by side, then all times alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil

from contactqp.study.attempt import ENOUGH, LONG, Timing, crashed, timed
from contactqp.study.case_study import CaseStudy
from contactqp.study.footprint.footprint import Footprint
from contactqp.study.report.case_cells import (
    FoundTruth,
    answer_cells,
    footprint_cell,
    limit_cell,
    record_cell,
    timing_cell,
    truth_cell,
)
from contactqp.study.report.case_record import CaseRecord, unjudged
from contactqp.study.rows import CRASHED, Row
from contactqp.study.rungs import Rung
from contactqp.study.running.cells import Cell, Crash, Result
from contactqp.study.running.journal import Journal
from contactqp.study.running.progress import Progress
from contactqp.study.running.runner import run_cells
from contactqp.study.running.workers import Crew, Workers

# Seconds that a cell takes beside what it is there for.
OVERHEAD = 1e-3


@dataclass(frozen=True, eq=False)
class _Try:
    """One rung of one case, with the cell that answers it."""

    study: CaseStudy
    rung: Rung
    cell: Cell


class Collector:
    """Runs a report, and knows how far it is.

    Parameters
    ----------
    studies : sequence of CaseStudy
    workers : Workers
    journal : Journal
    progress : Progress
    repeats : int
        Timed calls of each rung, at most.
    time_limit : float
        Of each cell [s].
    """

    def __init__(
        self,
        studies: Sequence[CaseStudy],
        workers: Workers,
        journal: Journal,
        progress: Progress,
        repeats: int,
        time_limit: float,
    ) -> None:
        self._studies, self._workers, self._journal, self._progress = studies, workers, journal, progress
        self._repeats, self._time_limit = repeats, time_limit
        self.rows = sum(len(study.rungs) for study in studies)
        self.answered = self.timed = 0
        self._changed: dict[str, None] = {}  # cases whose kept results are not theirs any more
        self._kept = 0
        self._seconds = 0.0  # that timing the answered rows is expected to take

    def collect(self) -> tuple[tuple[CaseRecord, ...], tuple[Row, ...]]:
        """All records and rows, in the order of the cases.

        Raises
        ------
        ContactQPError
            A case is wrong.
        """
        # The largest first: at the end no process waits for another one's long cell.
        studies = sorted(self._studies, key=lambda study: -study.problem.dimension)
        with self._workers.side_by_side() as crew:
            truths = self._truths(studies, crew)
            tries = [_Try(study, *each) for study in studies for each in answer_cells(study, truths[study.name])]
            told = {study.name: record_cell(study, truths[study.name]) for study in studies}
            answers = [*told.values(), *(one.cell for one in tries)]
            found = self._run("answers", answers, crew, later=self._timing_left)
        with self._workers.alone() as crew:
            limits, footprints = self._limits(studies, crew), self._footprints(studies, crew)
            rows = self._times(tries, {one.cell.key: _row(one, found[one.cell.key]) for one in tries}, crew)
        rows = {one.cell.key: replace(rows[one.cell.key], linear_solve_seconds=limits[one.study.name]) for one in tries}
        of_case = {study.name: [rows[one.cell.key] for one in tries if one.study is study] for study in studies}
        records = (
            replace(
                _record(study, truths[study.name], found[told[study.name].key]),
                contradicted=truths[study.name].contradicted,
                linear_solve=limits[study.name],
                footprint=footprints.get(study.name),
            )
            for study in self._studies
        )
        return tuple(records), tuple(row for study in self._studies for row in of_case[study.name])

    def __str__(self) -> str:
        return f"interrupted: {self.answered} of {self.rows} rows answered, {self.timed} timed"

    @property
    def notes(self) -> tuple[str, ...]:
        """What was taken from an interrupted report, and what was not."""
        said = [f"{self._kept} results were kept from a report that was interrupted"] if self._kept else []
        return (*said, *(f"{name}: changed since the report was interrupted, run again" for name in self._changed))

    def _truths(self, studies: Sequence[CaseStudy], crew: Crew) -> dict[str, FoundTruth]:
        cells = {study.name: truth_cell(study) for study in studies}
        found = self._run("truths", list(cells.values()), crew, later=None)
        return {name: _truth(found[cell.key]) for name, cell in cells.items()}

    def _times(self, tries: Sequence[_Try], rows: Mapping[str, Row], crew: Crew) -> dict[str, Row]:
        """The rows with their times; a method that crashes while it is timed has crashed."""
        cells = {
            key: timing_cell(one.study, one.rung, row.seconds, self._repeats, self._expected(row))
            for one in tries
            if (row := rows[key := one.cell.key]).seconds is not None
        }
        found = self._run("times", list(cells.values()), crew, later=lambda: 0.0)
        return {key: _timed(row, found[cells[key].key]) if key in cells else row for key, row in rows.items()}

    def _footprints(self, studies: Sequence[CaseStudy], crew: Crew) -> dict[str, Footprint]:
        """What solving each case takes that has a file."""
        cells = {study.name: footprint_cell(study) for study in studies if study.scene.file is not None}
        found = self._run("footprints", list(cells.values()), crew, later=self._timing_left)
        results = ((name, found[cell.key]) for name, cell in cells.items())
        return {name: result for name, result in results if isinstance(result, Footprint)}

    def _limits(self, studies: Sequence[CaseStudy], crew: Crew) -> dict[str, float | None]:
        """Seconds of one linear solve of each case; None where it crashed, as the case's rows will have too."""
        cells = {study.name: limit_cell(study) for study in studies}
        found = self._run("linear solves", list(cells.values()), crew, later=self._timing_left)
        results = {name: found[cell.key] for name, cell in cells.items()}
        return {name: None if isinstance(one, Crash) else one.seconds for name, one in results.items()}

    def _run(
        self, what: str, cells: Sequence[Cell], crew: Crew, later: Callable[[], float] | None
    ) -> dict[str, Result]:
        self._changed |= dict.fromkeys(cell.key.partition("/")[0] for cell in self._journal.changed(cells))
        self._progress.part(what, later)
        return run_cells(cells, crew, self._journal, watcher=self, time_limit=self._time_limit)

    def begin(self, cells: Sequence[Cell], found: Mapping[str, Result]) -> None:
        for cell in cells:
            if cell.key in found:
                self._kept += 1
                self._count(cell, found[cell.key])
        self._progress.begin(cells, found)

    def done(self, cell: Cell, result: Result) -> None:
        self._count(cell, result)
        self._progress.done(cell, result)

    def tick(self) -> None:
        self._progress.tick()

    def _count(self, cell: Cell, result: Result) -> None:
        self.answered += cell.result is Row
        self.timed += cell.result is Timing
        self._seconds += self._expected(result) if isinstance(result, Row) else 0.0

    def _timing_left(self) -> float:
        return self._seconds * self.rows / max(self.answered, 1)

    def _expected(self, row: Row) -> float:
        """Seconds that timing a row will take."""
        if row.seconds is None:
            return 0.0
        calls = 1 if row.seconds >= LONG else min(self._repeats, ceil(ENOUGH / max(row.seconds, OVERHEAD)))
        return calls * row.seconds + OVERHEAD


def _truth(found: FoundTruth | Crash) -> FoundTruth:
    return FoundTruth(f"nothing, as it was not found: {found.message}") if isinstance(found, Crash) else found


def _record(study: CaseStudy, truth: FoundTruth, found: CaseRecord | Crash) -> CaseRecord:
    if isinstance(found, Crash):
        return unjudged(study, truth.source, f"{study.name}: not judged: {found.message}")
    return found


def _row(one: _Try, found: Row | Crash) -> Row:
    return crashed(one.study.problem, one.rung, one.study.name, found.message) if isinstance(found, Crash) else found


def _timed(row: Row, found: Timing | Crash) -> Row:
    if isinstance(found, Crash):
        return replace(row, verdict=CRASHED, message=f"while it was timed: {found.message}")
    return timed(row, found)
