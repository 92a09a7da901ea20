"""Run the cells of a report and collect their results: first all answers in parallel, then all timings one by one."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from math import ceil
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.condensation import condense
from contactqp.linalg.factorization import factorise, fixing_unknowns
from contactqp.linalg.iteration import iterated
from contactqp.linalg.pardiso import NotPositive, Pardiso
from contactqp.linalg.schur import LastBlock
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.scene.scene import Scene
from contactqp.study.case_study import CaseStudy
from contactqp.study.comparison import LONG, VISIT, VISIT_CALLS, Timing, crashed, timed
from contactqp.study.footprint import Footprint, measure
from contactqp.study.report_data import CaseRecord, record, unjudged
from contactqp.study.rows import CRASHED, Row
from contactqp.study.running.journal import Cell, Crash, Journal, Result
from contactqp.study.running.runner import Progress, run_cells
from contactqp.study.running.workers import Pool, Workers
from contactqp.study.settings import BRIEF_LADDERS, Setting
from contactqp.study.statistics import BODY
from contactqp.study.truth import TrueAnswer, Truth

# The most linear solves that are timed, and the seconds after which no more are.
REPEATS, ENOUGH_SOLVES = 9, 0.2


def linear_solve_seconds(problem: ContactProblem) -> float | None:
    """Return the time [s] of one linear solve of the bodies without contact, a lower bound for contact solvers.

    It is one factorisation of K and one back-substitution of the load by the sparse solver of contact, the median of at
    most nine solves after a first. Contacts and ties are left out, and where the bodies then float, as few unknowns are
    fixed as necessary, which is not timed. None where a body is too large to factorise, and where nothing is elastic.
    """
    solve = None if iterated(problem) else linear_solve(problem)
    if solve is None:
        return None
    solve()
    times: list[float] = []
    while len(times) < REPEATS and sum(times) < ENOUGH_SOLVES:
        started = time.perf_counter()
        solve()
        times.append(time.perf_counter() - started)
    return statistics.median(times)


def linear_solve(problem: ContactProblem) -> Callable[[], Vector] | None:
    """Return the function that is timed, a solve for the free unknowns, None if there are none."""
    condensation = condense(problem)
    fixed = fixing_unknowns(condensation.rigid.motions, np.zeros(0, dtype=np.intp), problem.diagonal)
    moving = np.setdiff1d(np.arange(problem.dimension), fixed)
    if not moving.size:
        return None
    stiffness, load = sp.csr_matrix(problem.stiffness_rows[moving][:, moving]), problem.load[moving]
    by_pardiso = condensation.solver == LastBlock.solver and _positive(stiffness)
    return (lambda: _pardiso(stiffness).solve_all(load)) if by_pardiso else lambda: factorise(stiffness).solve(load)


def _pardiso(stiffness: Any) -> Pardiso:
    return Pardiso(stiffness, np.zeros(0, dtype=np.intp))


def _positive(stiffness: Any) -> bool:
    """Return whether PARDISO factorises this stiffness, which may fail where bodies nearly float."""
    try:
        _pardiso(stiffness)
    except NotPositive:
        return False
    return True


# The number of cases whose problems a process keeps in memory.
KEPT = 2
# Seconds after which a process that measures a case is stopped.
PATIENCE = 120.0
# Costs for the estimate of the time left: seconds of an answer with few unknowns, additional seconds of a body,
# unknowns per second; seconds of a record, mostly for its pictures, of a footprint, which starts a process, and of the
# final files.
ANSWER, OF_BODY, A_SECOND, PICTURES, FOOTPRINT, FILES = 0.01, 0.03, 1.2e5, 0.7, 2.5, 1.0


@dataclass(frozen=True)
class Ticket:
    """A case in the form sent to another process, which builds the problem; tickets of the same case are equal."""

    name: str
    digest: str
    scene: Scene = field(compare=False, repr=False)


@dataclass(frozen=True, eq=False)
class FoundTruth:
    """The truth of a case without its problem, which every process builds; `answer` is None where nothing is proven."""

    source: str
    answer: TrueAnswer | None = None

    @classmethod
    def of(cls, truth: Truth | None) -> FoundTruth:
        """Return the truth without its problem."""
        if truth is None:
            return cls("nothing, as no answer is proven")
        return cls(truth.source, TrueAnswer(**{one.name: getattr(truth, one.name) for one in fields(TrueAnswer)}))

    def on(self, study: CaseStudy) -> Truth | None:
        """Return the truth of that case's problem; None where nothing is proven."""
        return None if self.answer is None else Truth(**vars(self.answer), problem=study.problem)


@dataclass(frozen=True)
class LinearSolve:
    """The time of one linear solve; see `linear_solve_seconds`."""

    seconds: float | None


def ticket_of(study: CaseStudy) -> Ticket:
    """Return the case in the form sent to another process."""
    return Ticket(study.name, study.digest, study.scene)


def truth_cell(study: CaseStudy) -> Cell:
    """Return the cell that finds the truth of a case."""
    return _cell(study, "truth", find_truth, (ticket_of(study),), FoundTruth)


def record_cell(study: CaseStudy, truth: FoundTruth) -> Cell:
    """Return the cell that makes the record of a case."""
    cell = _cell(study, "record", make_record, (ticket_of(study), truth), CaseRecord)
    return replace(cell, cost=PICTURES + 4 * cell.cost)


def answer_cells(study: CaseStudy, truth: FoundTruth) -> Iterator[Cell]:
    """Yield the cells that solve a case by each setting."""
    for setting in study.settings:
        yield _cell(study, _name(setting), find_answer, (ticket_of(study), truth, setting), Row)


def answer_key(study: CaseStudy, setting: Setting) -> str:
    """Return the key of the cell that solves a case by a setting."""
    return f"{study.name}/{_name(setting)}"


def footprint_cell(study: CaseStudy) -> Cell:
    """Return the cell that measures the footprint of a case."""
    cell = _cell(study, "footprint", take_footprint, (ticket_of(study),), Footprint)
    return replace(cell, cost=FOOTPRINT + cell.cost)


def timing_cell(study: CaseStudy, setting: Setting, first: float, round_: int, cost: float) -> Cell:
    """Return the cell that times a setting in one of several rounds.

    Parameters
    ----------
    study : CaseStudy
    setting : Setting
    first : time of its first call [s]
    round_ : the number of the round, from 0
    cost : expected time [s]
    """
    arguments = (ticket_of(study), setting, first)
    return Cell(f"{study.name}/{_name(setting)}/time {round_}", take_time, arguments, Timing, study.digest, cost)


def limit_cell(study: CaseStudy, round_: int, cost: float) -> Cell:
    """Return the cell that times linear solves of the bodies of a case, in one of the rounds of its methods.

    Parameters
    ----------
    study : CaseStudy
    round_ : the number of the round, from 0
    cost : expected time [s]
    """
    cell = _cell(study, f"linear solve {round_}", time_linear_solve, (ticket_of(study),), LinearSolve)
    return replace(cell, cost=cost)


def _cell(study: CaseStudy, name: str, function: Any, arguments: tuple[Any, ...], result: type) -> Cell:
    cost = _answer_seconds(study)
    return Cell(f"{study.name}/{name}", function, arguments, result, study.digest, cost)


def _answer_seconds(study: CaseStudy) -> float:
    """Return about the seconds of one answer to a case."""
    unknowns = study.problem.dimension
    return ANSWER + OF_BODY * (unknowns >= BODY) + unknowns / A_SECOND


def _name(setting: Setting) -> str:
    """Return all options of solve as a key: osqp/raw/tolerance=1e-06,polish=False."""
    options = ",".join(f"{name}={value}" for name, value in setting.options.items())
    return "/".join((setting.method.name, setting.variant, options or setting.knob))


def take_footprint(ticket: Ticket) -> Footprint:
    """Return the footprint of a case; the functions from here on run in the processes of the cells."""
    return measure(str(ticket.scene.file), time_limit=PATIENCE)


def find_truth(ticket: Ticket) -> FoundTruth:
    """Return the truth of a case."""
    return FoundTruth.of(_study(ticket).truth())


def make_record(ticket: Ticket, truth: FoundTruth) -> CaseRecord:
    """Return the record of a case."""
    study = _study(ticket)
    return record(study, truth.on(study))


def find_answer(ticket: Ticket, truth: FoundTruth, setting: Setting) -> Row:
    """Return the row of one setting, not timed yet."""
    study = _study(ticket)
    return study.answer(setting, truth.on(study))


def take_time(ticket: Ticket, setting: Setting, first: float) -> Timing:
    """Return run times of one setting, whose first call took so many seconds.

    The first timing of a method on a case begins with a call that is not timed, which loads what the method needs. On
    bodies, whose answers take longer than that, only the first body does.
    """
    study = _study(ticket)
    tried = ("" if study.problem.dimension >= BODY else ticket.digest, setting.method.name)
    warm = tried in _WARM
    _WARM.add(tried)
    return study.timing(setting, first, warm)


def time_linear_solve(ticket: Ticket) -> LinearSolve:
    """Return the time of one linear solve of the bodies of a case."""
    return LinearSolve(linear_solve_seconds(_study(ticket).problem))


_WARM: set[tuple[str, str]] = set()


@lru_cache(maxsize=KEPT)
def _study(ticket: Ticket) -> CaseStudy:
    """Return the case of a ticket in this process, without settings, which are passed separately."""
    return CaseStudy(ticket.name, ticket.scene, ticket.scene.problem(), ())


# Least seconds of a call; seconds of a cell beside its calls; and the ratio of a call's time to the measured part,
# which leaves out making a fresh problem.
OVERHEAD, AROUND, BESIDE = 1e-3, 4e-3, 1.1
# The ratio of the time of a call alone to that of a first call beside other processes, which share caches and memory.
# On two cores it was 0.43 to 0.55 for bodies of 1 000 to 40 000 unknowns.
ALONE = 0.5
# A first call beyond this multiple of the case's median loaded packages, so the next one is expected to take the
# median.
UNUSUAL = 3.0


class Collector:
    """Runs the cells of a report and counts what is done.

    Parameters
    ----------
    studies : sequence of CaseStudy
    workers : Workers
    journal : Journal
    progress : Progress
    rounds : Rounds, in how many rounds every setting is timed
    time_limit : float, limit for each cell [s]
    brief : bool, measure the footprints of two cases alone
    show : callable, optional
        Called with this whenever something has been found; while it runs nothing is timed.
    """

    def __init__(
        self,
        studies: Sequence[CaseStudy],
        workers: Workers,
        journal: Journal,
        progress: Progress,
        rounds: Rounds,
        time_limit: float,
        brief: bool = False,
        show: Callable[[Collector], None] = lambda _: None,
    ) -> None:
        self._brief, self._show = brief, show
        self._unjudged: dict[str, CaseRecord] = {}
        self._found: dict[str, Result] = {}  # by the keys of the cells
        self._studies, self._workers, self._journal, self._progress = studies, workers, journal, progress
        self._rounds, self._time_limit = rounds, time_limit
        self.rows = sum(len(study.settings) for study in studies)
        self.answered = self.timed = 0
        self._changed: dict[str, None] = {}  # cases that changed since their results were kept
        self._kept = 0
        self._quicker = 1.0  # the time of a timed call over that of the first one
        # Seconds that timing each answered row is expected to take, by its case.
        self._expected: dict[str, list[float]] = {study.name: [] for study in studies}

    def collect(self) -> None:
        """Run all cells; `found` then returns all records and rows.

        Raises ContactQPError: a case is wrong.
        """
        self._show(self)
        # The largest first, so that at the end no process has a long cell alone.
        studies = sorted(self._studies, key=lambda study: -study.problem.dimension)
        with self._workers.side_by_side() as pool:
            self._quicker = ALONE if pool.size > 1 else 1.0
            self._run("truths", [truth_cell(study) for study in studies], pool, later=None)
            truths = {study.name: self._truth(study.name) for study in studies}
            records = [record_cell(study, truths[study.name]) for study in studies]
            answers = [cell for study in studies for cell in answer_cells(study, truths[study.name])]
            measuring = sum(cell.cost for cell in self._footprint_cells(studies))
            self._run("answers", [*records, *answers], pool, later=lambda: measuring + self._timing_left())
        with self._workers.alone() as pool:
            self._run("footprints", self._footprint_cells(studies), pool, later=self._timing_left)
            self._run("times", list(self._timing_cells(studies)), pool, later=lambda: FILES)

    def found(self) -> tuple[tuple[CaseRecord, ...], tuple[Row, ...]]:
        """Return the finished records and rows in the order of the cases; rows not timed yet have no time."""
        rows = (self._row(study, setting) for study in self._studies for setting in study.settings)
        return tuple(map(self._record, self._studies)), tuple(row for row in rows if row is not None)

    def _record(self, study: CaseStudy) -> CaseRecord:
        truth, record = self._truth(study.name), self._found.get(f"{study.name}/record")
        if isinstance(record, Crash):
            record = unjudged(study, truth.source, f"{study.name}: not judged: {record.message}")
        if record is None:
            if study.name not in self._unjudged:
                self._unjudged[study.name] = unjudged(study, "not known yet")
            record = self._unjudged[study.name]
        footprint = self._found.get(f"{study.name}/footprint")
        return replace(
            record,
            contradicted=truth.answer is not None and truth.answer.contradicted,
            linear_solve=self._limit(study.name),
            footprint=footprint if isinstance(footprint, Footprint) else None,
        )

    def _row(self, study: CaseStudy, setting: Setting) -> Row | None:
        """Return the row of a setting, if it is found; a method that crashes while it is timed has crashed."""
        key = answer_key(study, setting)
        row = self._found.get(key)
        if row is None:
            return None
        if isinstance(row, Crash):
            row = crashed(study.problem, setting, study.name, row.message)
        names = (f"{key}/time {round_}" for round_ in range(max(self._rounds.most, 1)))
        timings = [self._found[name] for name in names if name in self._found]
        row = replace(row, linear_solve_seconds=self._limit(study.name))
        return _timed(row, timings) if timings else replace(row, seconds=None)

    def _truth(self, name: str) -> FoundTruth:
        found = self._found.get(f"{name}/truth", FoundTruth("not known yet"))
        return FoundTruth(f"nothing, as it was not found: {found.message}") if isinstance(found, Crash) else found

    def _limit(self, name: str) -> float | None:
        """Return the seconds of one linear solve of a case, the median of the rounds; None where it crashed."""
        found = (self._found.get(f"{name}/linear solve {round_}") for round_ in range(max(self._rounds.most, 1)))
        times = [one.seconds for one in found if isinstance(one, LinearSolve) and one.seconds is not None]
        return statistics.median(times) if times else None

    def __str__(self) -> str:
        return f"interrupted: {self.answered} of {self.rows} rows answered, {self.timed} timed"

    @property
    def notes(self) -> tuple[str, ...]:
        """Return notes on which results of an interrupted report were reused."""
        kept = [f"{self._kept} results were kept from a report that was interrupted"] if self._kept else []
        return (*kept, *(f"{name}: changed since the report was interrupted, run again" for name in self._changed))

    def _timing_cells(self, studies: Sequence[CaseStudy]) -> Iterator[Cell]:
        """Yield the cells that time all answers: the smallest body first, then the largest case and so on.

        The first calls of all methods on a body are not timed, and the smallest one loses least by that; what the large
        ones take is known early then, and with it the time that is left. One linear solve and the methods of a case
        take turns, to and fro: a machine that is busy for a while disturbs all alike, and none is always the first.
        """
        bodies = [study for study in studies if study.problem.dimension >= BODY]
        for study in sorted(studies, key=lambda study: study not in bodies[-1:]):
            answers = ((setting, self._found[answer_key(study, setting)]) for setting in study.settings)
            firsts = [(setting, row.seconds) for setting, row in answers if isinstance(row, Row)]
            known = [first for _, first in firsts if first is not None] or [0.0]
            least, usual = min(known), statistics.median(known)
            for round_ in range(max(self._rounds.most, 1)):
                yield limit_cell(study, round_, _solves(self._quicker * least))
                for setting, first in firsts if round_ % 2 == 0 else firsts[::-1]:
                    if first is not None and round_ < self._rounds.of(first):
                        yield timing_cell(study, setting, first, round_, self._cost(min(first, UNUSUAL * usual)))

    def _footprint_cells(self, studies: Sequence[CaseStudy]) -> list[Cell]:
        """Return the cells of the cases that have a file; in brief of the largest that all settings are run on."""
        have_file = [study for study in studies if study.scene.file is not None]
        if self._brief:
            have_file = [study for study in have_file if study.problem.dimension <= BRIEF_LADDERS][:1]
        return [footprint_cell(study) for study in have_file]

    def _run(self, what: str, cells: Sequence[Cell], pool: Pool, later: Callable[[], float] | None) -> None:
        self._changed |= dict.fromkeys(cell.key.partition("/")[0] for cell in self._journal.changed(cells))
        self._progress.part(what, later, pool.size)
        run_cells(cells, pool, self._journal, watcher=self, time_limit=self._time_limit)

    def begin(self, cells: Sequence[Cell], found: Mapping[str, Result]) -> None:
        """Start a part: `found` holds the results of the cells that are finished already."""
        for cell in cells:
            if cell.key in found:
                self._kept += 1
                self._count(cell, found[cell.key])
        self._progress.begin(cells, found)

    def done(self, cell: Cell, result: Result) -> None:
        """Count a finished cell."""
        self._count(cell, result)
        self._progress.done(cell, result)
        self._show(self)

    def tick(self) -> None:
        """Show the progress."""
        self._progress.tick()

    @property
    def progress(self) -> str:
        """Return the current part, the numbers of finished and of all cells, and the seconds left."""
        return str(self._progress)

    def _count(self, cell: Cell, result: Result) -> None:
        self._found[cell.key] = result
        self.answered += cell.result is Row
        self.timed += cell.result is Timing and cell.key.endswith("/time 0")
        if isinstance(result, Row):
            seconds = 0.0 if result.seconds is None else self._timing(result.seconds)
            self._expected[cell.key.partition("/")[0]].append(seconds)

    def _timing_left(self) -> float:
        """Return the seconds that timing, of unanswered rows as of others of their case, and the files are to take."""
        return FILES + sum(self._timing_of_one(study) * len(study.settings) for study in self._studies)

    def _timing_of_one(self, study: CaseStudy) -> float:
        """Return the seconds that timing one setting of a case is expected to take, by its size if none is answered."""
        seconds = self._expected[study.name]
        if not seconds:
            return self._timing(_answer_seconds(study))
        usual = statistics.median(seconds)
        return statistics.mean(min(one, UNUSUAL * usual) for one in seconds)

    def _timing(self, seconds: float) -> float:
        """Return the seconds that timing a setting takes whose call takes so many."""
        return self._rounds.of(seconds) * self._cost(seconds)

    def _cost(self, first: float) -> float:
        """Return the seconds that a cell of timing takes for a setting whose first call took so many."""
        return BESIDE * _visit(self._quicker * first) + AROUND


@dataclass(frozen=True)
class Rounds:
    """The number of rounds in which a setting is timed, limited by a count and by seconds."""

    most: int
    enough: float

    def of(self, seconds: float) -> int:
        """Return the rounds of a setting whose call takes so many seconds."""
        if seconds >= LONG or self.most == 0:
            return 1
        return min(self.most, ceil(self.enough / max(_visit(seconds), OVERHEAD)))


def _visit(seconds: float) -> float:
    """Return the seconds of one round of a setting whose call takes so many."""
    return min(VISIT_CALLS, ceil(VISIT / max(seconds, OVERHEAD))) * seconds


def _solves(seconds: float) -> float:
    """Return the seconds for timing linear solves of this duration, with two that are not counted."""
    return min(REPEATS * seconds, ENOUGH_SOLVES + seconds) + 2 * seconds + AROUND


def _timed(row: Row, found: Sequence[Timing | Crash]) -> Row:
    for one in found:
        if isinstance(one, Crash):
            return replace(row, verdict=CRASHED, message=f"while it was timed: {one.message}")
    return timed(row, [one for one in found if isinstance(one, Timing)])
