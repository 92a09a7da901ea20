"""`contactqp report --stability`: the study run, written to a folder and told on a terminal."""

from __future__ import annotations

import datetime
import shlex
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from contactqp.study.attempt import chosen_methods
from contactqp.study.charts.curves import Chart
from contactqp.study.page.render import Tile, missing_packages, render_study
from contactqp.study.report.delivery import deliver, machine, report_folder, unfinished, versions, workshop, write
from contactqp.study.running.journal import Journal, source_digest
from contactqp.study.running.runner import (
    Progress,
    Running,
    Stopped,
    progress,
    run_cells,
    stopped_by_signals,
    workers_of,
)
from contactqp.study.running.workers import Workers
from contactqp.study.stability import problem_axes
from contactqp.study.stability.axes import AXES
from contactqp.study.stability.cells import (
    COLUMNS,
    PATIENCE,
    STIFFENING,
    VERDICTS,
    StabilityRow,
    cells,
    row_of,
    runnable,
    to_csv,
)
from contactqp.study.stability.charts import digits_curves, digits_heat_map, verdict_heat_map
from contactqp.study.stability.penalty_valley import of_truss, penalty_valley
from contactqp.study.stability.posed import Axis
from contactqp.study.stability.study import StabilityStudy, as_json, grouped, lines

# The study as sections of a page: headings, words, charts, tables.


class Table(NamedTuple):
    """A table of a page."""

    title: str
    headings: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


class Section(NamedTuple):
    """A section of a page."""

    heading: str
    words: tuple[str, ...]
    charts: tuple[Chart, ...]
    tables: tuple[Table, ...]


def stability_charts(study: StabilityStudy) -> tuple[Chart, ...]:
    """Return the charts of all sections."""
    return tuple(chart for section in stability_sections(study) for chart in section.charts)


def stability_sections(study: StabilityStudy) -> tuple[Section, ...]:
    """One section of what it all comes to, one for each axis, one of what was refused needlessly."""
    return (_summary(study), *(_of_axis(study, axis) for axis in study.axes), *_needless(study))


def _summary(study: StabilityStudy) -> Section:
    headings, *lines = study.cells()
    table = Table("By axis", tuple(headings), tuple(tuple(line) for line in lines))
    verdicts = Table("Verdicts", ("verdict", "meaning"), tuple(VERDICTS.items()))
    return Section("How it ended", (str(study),), (), (table, verdicts))


def _of_axis(study: StabilityStudy, axis: Axis) -> Section:
    rows = study.rows_of(axis)
    charts = [digits_heat_map(axis, rows), verdict_heat_map(axis, rows), digits_curves(axis, rows)]
    words = [axis.about]
    if axis.name == problem_axes.PENALTY_STIFFNESS.name:
        charts.insert(0, penalty_valley(rows))
        words += list(_of_best(study))
    words += [f"Values: {axis.quantity}.", *grouped(study.ranges(axis))]
    return Section(axis.title, tuple(words), tuple(charts), ())


def _of_best(study: StabilityStudy) -> Iterator[str]:
    """The best β of the penalty method, measured and predicted."""
    best = of_truss()
    found = {chosen.method: chosen for chosen in study.ranges(problem_axes.PENALTY_STIFFNESS)}.get("penalty")
    if found is not None and found.best is not None and found.best_value is not None:
        yield (
            f"Best β: {found.best_value:.1e} kN/m with an error of {found.best:.1e}; predicted {best.penalty:.1e} kN/m "
            f"with {best.error:.1e}."
        )


def _needless(study: StabilityStudy) -> Sequence[Section]:
    """Right answers that were refused, by reason."""
    if not study.refused_right:
        return ()
    reasons = Counter((row.axis, reason_of(row.message)) for row in study.refused_right)
    lines = tuple((axis, reason, str(count)) for (axis, reason), count in reasons.most_common())
    table = Table("Right answers that were refused", ("axis", "reason", "rows"), lines)
    words = f"{len(study.refused_right)} answers were right to 1e-6 and were refused all the same."
    return (Section("Refused, and right", (words,), (), (table,)),)


def reason_of(message: str) -> str:
    """What a refusal names first: a figure of the certificate, or the method's own words."""
    words = message.removeprefix("expected otherwise: ").split(": ")
    if "the certificate refuses the answer" in words:
        return words[words.index("the certificate refuses the answer") + 1]
    return words[1] if len(words) > 1 else words[0]


JOURNAL = "unfinished_stability.jsonl"
# In this process, whose methods are those of its registry.
HERE = Running(jobs=0)


def report_stability(output: str, running: Running = HERE) -> int:
    """The study of the command line: runs, writes, says what it found, and returns the exit code."""
    try:
        study, files, notes = write_stability(output, running=running)
    except Stopped as stop:
        print(f"contactqp: {stop}", file=sys.stderr)
        return stop.code
    for note in notes:
        print(f"contactqp: {note}", file=sys.stderr)
    print("\n".join(lines(study)))
    print(f"written: {', '.join(map(str, files))}")
    return study.exit_code


def write_stability(
    output: str | Path,
    axes: Sequence[Axis] = AXES,
    methods: Sequence[str] | None = None,
    *,
    running: Running = HERE,
) -> tuple[StabilityStudy, tuple[Path, ...], tuple[str, ...]]:
    """Every method at every value of every axis: stability.html, stability.csv and stability.json in a folder.

    What is found streams to ``unfinished_stability.jsonl`` there; after an interruption the same call goes on.

    Returns
    -------
    study, files, notes
        What was found; what was written; what was left out, and why.

    Raises
    ------
    SceneError
        The folder cannot be written.
    Stopped
        By Ctrl-C or SIGTERM; it says how far it was.
    """
    folder = report_folder(output)
    with stopped_by_signals(), workers_of(running) as workers:
        facts = _facts(workers, methods)
        conditions = facts | dict(source=source_digest())
        with (
            unfinished(folder, conditions, running.fresh, JOURNAL) as journal,
            progress(running.shown) as bar,
            _told_how_far(journal),
        ):
            rows = run_study(axes, methods, workers, journal, bar, running.time_limit)
            created = dict(created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"))
            study = StabilityStudy(tuple(axes), rows, facts | created)
            with workshop(folder) as shop:
                write(shop / "stability.csv", to_csv(study.rows))
                write(shop / "stability.json", as_json(study))
                if not missing_packages():
                    write(shop / "stability.html", page_of(study))
                files = deliver(shop, folder)
        notes = (*workers.notes, *journal.notes, *filter(None, [missing_packages()]))
    return study, files, notes


def run_study(
    axes: Sequence[Axis],
    methods: Sequence[str] | None,
    workers: Workers,
    journal: Journal,
    bar: Progress,
    time_limit: float,
) -> tuple[StabilityRow, ...]:
    """All cells, side by side: their times are no part of what is studied."""
    todo = list(cells(axes, methods))
    bar.part("stability", later=lambda: 0.0)
    with workers.side_by_side() as crew:
        found = run_cells([runnable(cell) for cell in todo], crew, journal, watcher=bar, time_limit=time_limit)
    return tuple(row_of(cell, found[cell.key]) for cell in todo)


@contextmanager
def _told_how_far(journal: Journal) -> Iterator[None]:
    """An interruption says what is done."""
    try:
        yield
    except KeyboardInterrupt as stop:
        raise Stopped(f"interrupted: {journal.count} rows found; the same command goes on from there", stop) from None


def _facts(workers: Workers, methods: Sequence[str] | None) -> dict[str, Any]:
    return dict(
        machine=workers.ask(machine),
        versions=workers.ask(partial(versions, chosen_methods(methods))),
        settings=dict(patience=PATIENCE, stiffening=STIFFENING),
        seeds="none: nothing is random",
    )


def page_of(study: StabilityStudy) -> str:
    """stability.html."""
    command = shlex.join(["contactqp", "report", "--stability"])
    return render_study(stability_sections(study), _tiles(study), COLUMNS, study.facts, command)


def _tiles(study: StabilityStudy) -> tuple[Tile, ...]:
    wrong = len(study.wrong)
    return (
        Tile(wrong, "wrong but passed", "‼ must be 0" if wrong else "✓ no answer passes that is wrong", wrong > 0),
        Tile(study.flags_wrong, "silently wrong", "answers that a method by itself calls solved, and are not"),
        Tile(len(study.refused_right), "right and refused", "answers right to 1e-6 that the certificate does not pass"),
        Tile(len(study.rows), "rows", f"on {len(study.axes)} axes"),
    )
