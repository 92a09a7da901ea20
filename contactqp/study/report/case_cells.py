"""What a report does with one case, as cells: its truth, its record, and each of its rungs answered and timed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

from contactqp.model.arrays import Vector
from contactqp.scene.scene import Scene
from contactqp.study.attempt import Timing
from contactqp.study.case_study import CaseStudy
from contactqp.study.footprint.footprint import Footprint
from contactqp.study.footprint.measuring import measure
from contactqp.study.linear_solve import linear_solve_seconds
from contactqp.study.report.case_record import CaseRecord, record
from contactqp.study.rows import Row
from contactqp.study.rungs import Rung
from contactqp.study.running.cells import Cell
from contactqp.study.truth import Truth

# Cases whose problems a process keeps: the one at hand, and the one before while others still work on it.
KEPT = 2
# Seconds after which a process that measures a case is stopped.
PATIENCE = 120.0
# What is expected of a cell, relative to one answer to a problem of a few unknowns: unknowns that make it twice that,
# and what a record takes more than an answer, as it has pictures.
DOUBLING, PICTURES = 100, 30


@dataclass(frozen=True)
class Ticket:
    """A case on its way to another process, which makes the problem of it; equal where the case is the same."""

    name: str
    digest: str
    scene: Scene = field(compare=False, repr=False)


@dataclass(frozen=True, eq=False)
class FoundTruth:
    """The truth of a case without its problem; `normal_force` is None where nothing is proven."""

    source: str
    displacement: Vector | None = None
    normal_force: Vector | None = None
    tie_force: Vector | None = None
    unique_forces: bool = True
    free: bool = False
    contradicted: bool = False

    @classmethod
    def of(cls, truth: Truth | None) -> FoundTruth:
        if truth is None:
            return cls("nothing, as no answer is proven")
        values = (truth.displacement, truth.normal_force, truth.tie_force)
        return cls(truth.source, *values, truth.unique_forces, truth.free, truth.contradicted)

    def on(self, study: CaseStudy) -> Truth | None:
        """The truth of that case's problem."""
        if self.displacement is None or self.normal_force is None:
            return None
        values = (self.displacement, self.normal_force, self.tie_force)
        return Truth(study.problem, *values, self.source, self.unique_forces, self.free, self.contradicted)


@dataclass(frozen=True)
class LinearSolve:
    """What one linear solve takes; see `contactqp.study.linear_solve`."""

    seconds: float | None


def ticket_of(study: CaseStudy) -> Ticket:
    return Ticket(study.name, study.digest, study.scene)


def truth_cell(study: CaseStudy) -> Cell:
    """Finds the truth of a case."""
    return _cell(study, "truth", find_truth, (ticket_of(study),), FoundTruth)


def record_cell(study: CaseStudy, truth: FoundTruth) -> Cell:
    """Finds what is told of a case besides its rows."""
    cell = _cell(study, "record", make_record, (ticket_of(study), truth), CaseRecord)
    return replace(cell, cost=PICTURES + 2 * cell.cost)


def answer_cells(study: CaseStudy, truth: FoundTruth) -> Iterator[tuple[Rung, Cell]]:
    """Each rung of a case answered, and held against the truth."""
    for rung in study.rungs:
        yield rung, _cell(study, _name(rung), find_answer, (ticket_of(study), truth, rung), Row)


def footprint_cell(study: CaseStudy) -> Cell:
    """Measures what solving a case takes."""
    return _cell(study, "footprint", take_footprint, (ticket_of(study),), Footprint)


def timing_cell(study: CaseStudy, rung: Rung, first: float, repeats: int, cost: float) -> Cell:
    """A rung timed, whose first call took so long."""
    arguments = (ticket_of(study), rung, first, repeats)
    return Cell(f"{study.name}/{_name(rung)}/time", take_time, arguments, Timing, study.digest, cost)


def limit_cell(study: CaseStudy) -> Cell:
    """One linear solve of the case's bodies timed."""
    return _cell(study, "linear solve", time_linear_solve, (ticket_of(study),), LinearSolve)


def _cell(study: CaseStudy, name: str, function: Any, arguments: tuple[Any, ...], result: type) -> Cell:
    cost = 1 + study.problem.dimension / DOUBLING
    return Cell(f"{study.name}/{name}", function, arguments, result, study.digest, cost)


def _name(rung: Rung) -> str:
    """osqp/raw/tolerance=1e-06,polish=False: everything that solve is told."""
    options = ",".join(f"{name}={value}" for name, value in rung.options.items())
    return "/".join((rung.method.name, rung.variant, options or rung.knob))


def take_footprint(ticket: Ticket) -> Footprint:
    return measure(str(ticket.scene.file), time_limit=PATIENCE)


def find_truth(ticket: Ticket) -> FoundTruth:
    return FoundTruth.of(_study(ticket).truth())


def make_record(ticket: Ticket, truth: FoundTruth) -> CaseRecord:
    study = _study(ticket)
    return record(study, truth.on(study))


def find_answer(ticket: Ticket, truth: FoundTruth, rung: Rung) -> Row:
    study = _study(ticket)
    return study.answer(rung, truth.on(study))


def take_time(ticket: Ticket, rung: Rung, first: float, repeats: int) -> Timing:
    """Warm from the second time on that this process has the method on this case."""
    tried = (ticket.digest, rung.method.name)
    warm = tried in _WARM
    _WARM.add(tried)
    return _study(ticket).timing(rung, first, repeats, warm)


def time_linear_solve(ticket: Ticket) -> LinearSolve:
    return LinearSolve(linear_solve_seconds(_study(ticket).problem))


_WARM: set[tuple[str, str]] = set()


@lru_cache(maxsize=KEPT)
def _study(ticket: Ticket) -> CaseStudy:
    """The case in this process; its rungs come one by one."""
    return CaseStudy(ticket.name, ticket.scene, ticket.scene.problem(), ())
