"""`contactqp report --stability`: run the stability study, summarise it, and write its page, JSON and CSV."""

from __future__ import annotations

import datetime
import itertools
import json
import shlex
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from contactqp.study import rows as report_rows
from contactqp.study.conclusion import deliver, machine, report_folder, unfinished, versions, workshop, write
from contactqp.study.page.case_view import bars_of, plain_table
from contactqp.study.page.render import Section, Tile, missing_packages, render_study
from contactqp.study.rows import side_by_side
from contactqp.study.running.journal import Journal, source_digest
from contactqp.study.running.runner import (
    Progress,
    Running,
    Stopped,
    progress,
    run_cells,
    stopped_after,
    stopped_by_signals,
    workers_of,
)
from contactqp.study.running.workers import Workers
from contactqp.study.settings import chosen_methods
from contactqp.study.stability import problem_axes
from contactqp.study.stability.axis_problem import Axis
from contactqp.study.stability.stability_cells import (
    AXES,
    COLUMNS,
    CUT_OFF,
    PATIENCE,
    STATED,
    STIFFENING,
    VERDICTS,
    StabilityRow,
    cells,
    row_of,
    runnable,
    short_dicts,
    to_csv,
)
from contactqp.study.stability.stability_charts import (
    best_penalty_of_truss,
    digits_curves,
    digits_heat_map,
    penalty_valley,
    verdict_heat_map,
)

# An approximate method is called useful up to this error.
USEFUL = 1e-3


@dataclass(frozen=True)
class SafeRange:
    """The values of one axis at which one method is right, in numbers and in words."""

    axis: str
    method: str  # with its variant
    lowest: float | None  # of the longest run of neighbouring values at which it is right; None: nowhere
    highest: float | None
    everywhere: bool
    best: float | None  # the smallest error of u and λ together
    best_value: float | None
    refused: tuple[float, ...]  # values at which it was refused, or gave up
    words: str  # without the method's name


def safe_ranges(axis: Axis, rows: Sequence[StabilityRow]) -> tuple[SafeRange, ...]:
    """Return the safe range of each method that was tried on the axis."""
    names = dict.fromkeys(row.name for row in rows if row.axis == axis.name and row.verdict != report_rows.MISSING)
    return tuple(_safe_range(axis, name, [r for r in rows if (r.axis, r.name) == (axis.name, name)]) for name in names)


def _safe_range(axis: Axis, name: str, rows: Sequence[StabilityRow]) -> SafeRange:
    tried = sorted((row for row in rows if row.verdict != CUT_OFF), key=lambda row: row.value)
    exact = all(row.promises_exact for row in tried)
    good = (lambda row: row.right) if exact else _is_useful
    runs = [list(run) for is_good, run in itertools.groupby(tried, good) if is_good]  # of neighbours
    run = max(runs, key=len, default=[])
    errors = [(row.error, row.value) for row in tried if row.error is not None and row.verdict != report_rows.REFUSED]
    best = min(errors, default=(None, None))
    refused = tuple(row.value for row in tried if row.verdict in _GIVEN_UP)
    whole = len(run) == len(tried)
    found = SafeRange(
        axis=axis.name,
        method=name,
        lowest=run[0].value if run else None,
        highest=run[-1].value if run else None,
        everywhere=whole and bool(run),
        best=best[0],
        best_value=best[1],
        refused=refused,
        words="",
    )
    return replace(found, words="; ".join(_parts(axis, found, runs, rows, exact)) + ".")


def grouped(ranges: Sequence[SafeRange]) -> Iterator[str]:
    """Yield the ranges in words, methods of the same words together, those that are right everywhere last."""
    alike: dict[str, list[str]] = {}
    for found in sorted(ranges, key=lambda found: found.everywhere):
        alike.setdefault(found.words, []).append(found.method)
    for words, methods in alike.items():
        yield f"{', '.join(methods)}: {words}"


_GIVEN_UP = (report_rows.REFUSED, report_rows.NOT_CONVERGED, report_rows.BACKEND_FAILED)


def _is_useful(row: StabilityRow) -> bool:
    return row.right or (row.error is not None and row.error <= USEFUL and row.verdict == report_rows.APPROXIMATE)


def _parts(
    axis: Axis, found: SafeRange, runs: Sequence[Sequence[StabilityRow]], rows: Sequence[StabilityRow], exact: bool
) -> Iterator[str]:
    quality = "right" if exact else f"error below {USEFUL:g}"
    where = " and ".join(_span(axis, run[0].value, run[-1].value) for run in runs) or "nowhere"
    yield f"{quality} {'at all values tried, ' if found.everywhere else ''}{where}"
    if not exact and found.best is not None and found.best_value is not None:
        yield f"best {found.best:.1e} at {axis.label(found.best_value)}"
    yield from _others(axis, rows)


def _span(axis: Axis, lowest: float, highest: float) -> str:
    if lowest == highest:
        return f"at {axis.label(lowest)}"
    return f"from {axis.label(lowest)} to {axis.label(highest)}"


def _others(axis: Axis, rows: Sequence[StabilityRow]) -> Iterator[str]:
    """Yield each other ending, with the values at which it occurred."""
    endings = (*_GIVEN_UP, report_rows.CRASHED, STATED, report_rows.UNSUPPORTED, CUT_OFF, report_rows.WRONG)
    for ending in endings:
        values = sorted(row.value for row in rows if row.verdict == ending)
        if values:
            where = axis.label(values[0]) if len(values) == 1 else f"{len(values)} values, "
            where += "" if len(values) == 1 else f"{axis.label(values[0])} to {axis.label(values[-1])}"
            told = (row.message for row in rows if row.verdict == ending and ending in (CUT_OFF, report_rows.CRASHED))
            why = "".join(f" ({message})" for message in itertools.islice(told, 1))
            yield f"{ending} at {where}{why}"


SCHEMA, SCHEMA_VERSION = "contactqp-stability", 1


@dataclass(frozen=True)
class StabilityStudy:
    """The results of the study: its axes, and every method at each of their values."""

    axes: tuple[Axis, ...]
    rows: tuple[StabilityRow, ...]
    facts: Mapping[str, Any]  # created, machine, versions, settings

    def rows_of(self, axis: Axis) -> tuple[StabilityRow, ...]:
        """Return the rows of one axis."""
        return tuple(row for row in self.rows if row.axis == axis.name)

    def ranges(self, axis: Axis) -> tuple[SafeRange, ...]:
        """Return the range of values in which each method is right."""
        return safe_ranges(axis, self.rows_of(axis))

    @property
    def wrong(self) -> tuple[StabilityRow, ...]:
        """Return the wrong answers that passed without a statement of the certificate: there must be none."""
        return tuple(row for row in self.rows if row.wrong)

    @property
    def flags_wrong(self) -> int:
        """Return how often a method's own flag was wrong."""
        return sum(row.flag_wrong is True for row in self.rows)

    @property
    def refused_right(self) -> tuple[StabilityRow, ...]:
        """Return the answers that are right and were refused."""
        return tuple(row for row in self.rows if row.refused_right)

    @property
    def exit_code(self) -> int:
        """Return 1 if anything of ours is wrong and passed, else 0."""
        return 1 if self.wrong else 0

    def cells(self) -> list[list[str]]:
        """Return a table of the axes with the counts of each verdict, headings first."""
        endings = [name for name in VERDICTS if name != report_rows.MISSING]
        table = [["axis", "from", "to", *endings, "right answers refused"]]
        for axis in self.axes:
            mine = self.rows_of(axis)
            counts = Counter(row.verdict for row in mine)
            refused = sum(row.refused_right is True for row in mine)
            ends = [axis.label(axis.values[0]), axis.label(axis.values[-1])]
            table.append([axis.name, *ends, *(str(counts[name] or "") for name in endings), str(refused or "")])
        return table

    def __str__(self) -> str:
        counts = Counter(row.verdict for row in self.rows)
        return (
            f"{len(self.rows)} rows; wrong but passed: {len(self.wrong)}; errors that the certificate states: "
            f"{counts[STATED]}; right answers refused: {len(self.refused_right)}; cut off: {counts[CUT_OFF]}; "
            f"methods silently wrong by themselves: {self.flags_wrong}"
        )


def as_json(study: StabilityStudy) -> str:
    """Return the text of stability.json."""
    contents = dict(schema=SCHEMA, schema_version=SCHEMA_VERSION, **study.facts)
    contents |= dict(columns=dict(COLUMNS), verdicts=dict(VERDICTS), summary=_summary_data(study))
    contents["axes"] = [_axis_data(study, axis) for axis in study.axes]
    head = json.dumps(contents, indent=1, allow_nan=False, ensure_ascii=False).removesuffix("\n}")
    rows = (json.dumps(row, allow_nan=False, ensure_ascii=False) for row in short_dicts(study.rows))
    return head + ',\n "rows": [\n  ' + ",\n  ".join(rows) + "\n ]\n}\n"


def _summary_data(study: StabilityStudy) -> dict[str, Any]:
    best = best_penalty_of_truss()
    return dict(
        rows=len(study.rows),
        verdicts=dict(Counter(row.verdict for row in study.rows)),
        wrong_but_passed=len(study.wrong),
        refused_right=len(study.refused_right),
        backends_silently_wrong=study.flags_wrong,
        best_penalty=dict(asdict(best), penalty=best.penalty, error=best.error),
    )


def _axis_data(study: StabilityStudy, axis: Axis) -> dict[str, Any]:
    return dict(
        name=axis.name,
        title=axis.title,
        quantity=axis.quantity,
        about=axis.about,
        values=list(axis.values),
        labels=list(axis.labels),
        ranges=[asdict(found) for found in study.ranges(axis)],
    )


def terminal_lines(study: StabilityStudy) -> Iterator[str]:
    """Yield what is printed on the terminal."""
    yield side_by_side(study.cells())
    for axis in study.axes:
        yield f"\n{axis.title} ({axis.quantity})"
        yield from (f"  {words}" for words in grouped(study.ranges(axis)))
    for row in study.wrong:
        yield f"WRONG BUT PASSED: {row.axis} = {row.label}: {row.name}: error {row.error}: {row.message}"
    yield str(study)


def stability_sections(study: StabilityStudy) -> tuple[Section, ...]:
    """Return a section of the summary, one for each axis, and one of right answers that were refused."""
    return (_summary_section(study), *(_axis_section(study, axis) for axis in study.axes), *_needless_section(study))


def _summary_section(study: StabilityStudy) -> Section:
    headings, *lines = study.cells()
    table = plain_table("By axis", headings, lines)
    verdicts = plain_table("Verdicts", ("verdict", "meaning"), VERDICTS.items())
    return Section("How it ended", (str(study),), (), (table, verdicts))


def _axis_section(study: StabilityStudy, axis: Axis) -> Section:
    rows = study.rows_of(axis)
    charts = [digits_heat_map(axis, rows), verdict_heat_map(axis, rows), digits_curves(axis, rows)]
    words = [axis.about]
    if axis.name == problem_axes.PENALTY_STIFFNESS.name:
        charts.insert(0, penalty_valley(rows))
        words += list(_best_penalty_words(study))
    words += [f"Values: {axis.quantity}.", *grouped(study.ranges(axis))]
    return Section(axis.title, tuple(words), tuple(charts), ())


def _best_penalty_words(study: StabilityStudy) -> Iterator[str]:
    """Yield the best β of the penalty method, measured and predicted."""
    best = best_penalty_of_truss()
    found = {chosen.method: chosen for chosen in study.ranges(problem_axes.PENALTY_STIFFNESS)}.get("penalty")
    if found is not None and found.best is not None and found.best_value is not None:
        yield (
            f"Best β: {found.best_value:.1e} kN/m with an error of {found.best:.1e}; predicted {best.penalty:.1e} kN/m "
            f"with {best.error:.1e}."
        )


def _needless_section(study: StabilityStudy) -> Sequence[Section]:
    """Return the section of right answers that were refused, by reason; none where there are none."""
    if not study.refused_right:
        return ()
    reasons = Counter((row.axis, reason_of(row.message)) for row in study.refused_right)
    lines = ((axis, reason, count) for (axis, reason), count in reasons.most_common())
    table = plain_table("Right answers that were refused", ("axis", "reason", "rows"), lines)
    words = f"{len(study.refused_right)} answers were right to 1e-6 and were refused all the same."
    return (Section("Refused, and right", (words,), (), (table,)),)


def reason_of(message: str) -> str:
    """Return what a refusal names first: a figure of the certificate, or the method's own words."""
    words = message.removeprefix("expected otherwise: ").split(": ")
    if "the certificate refuses the answer" in words:
        return words[words.index("the certificate refuses the answer") + 1]
    return words[1] if len(words) > 1 else words[0]


# Seconds for one cell, at most: few take one, and methods that cannot be told a time limit must not hold up the study.
LONGEST_CELL = 90.0
REPORT = "index.html"
JOURNAL = "unfinished_stability.jsonl"
# By default the study runs in this process, which has the methods that its user registered.
HERE = Running(jobs=0)


def report_stability(output: str, running: Running = HERE) -> int:
    """Run and write the study of the command line, print what it found, and return the exit code."""
    try:
        study, files, notes = write_stability(output, running=running)
    except Stopped as stop:
        print(f"contactqp: {stop}", file=sys.stderr)
        return stop.code
    for note in notes:
        print(f"contactqp: {note}", file=sys.stderr)
    print("\n".join(terminal_lines(study)))
    print(f"written: {', '.join(map(str, files))}")
    return study.exit_code


def write_stability(
    output: str | Path,
    axes: Sequence[Axis] = AXES,
    methods: Sequence[str] | None = None,
    *,
    running: Running = HERE,
) -> tuple[StabilityStudy, tuple[Path, ...], tuple[str, ...]]:
    """Run every method at every value of every axis, and write stability.html, .csv and .json to a folder.

    Results are written as they are found to ``unfinished_stability.jsonl`` there; after an interruption the same call
    continues.

    Raises SceneError: the folder cannot be written; Stopped: the study was interrupted by Ctrl-C or SIGTERM; the
    message says how far it was.

    Parameters
    ----------
    output : path, the folder, made if need be
    axes : sequence of Axis, all by default
    methods : sequence of names, optional
        All by default.
    running : processes, time limit and display of progress

    Returns
    -------
    study, files, notes
        What was found; what was written; what was left out, and why.
    """
    folder = report_folder(output)
    with stopped_by_signals(), workers_of(running) as workers:
        facts = _facts(workers, methods)
        conditions = facts | dict(source=source_digest())
        with (
            unfinished(folder, conditions, running.fresh, JOURNAL) as journal,
            progress(running.shown) as bar,
            stopped_after(lambda: f"interrupted: {journal.count} rows found"),
        ):
            rows = run_study(axes, methods, workers, journal, bar, running.time_limit)
            created = dict(created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"))
            study = StabilityStudy(tuple(axes), rows, facts | created)
            with workshop(folder) as shop:
                write(shop / "stability.csv", to_csv(study.rows))
                write(shop / "stability.json", as_json(study))
                if not missing_packages():
                    write(shop / "stability.html", page_of(study, folder))
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
    """Run all cells side by side, since their times are not studied, and return their rows.

    Parameters
    ----------
    axes : sequence of Axis
    methods : sequence of names or None, None for all
    workers : Workers
    journal : Journal
    bar : Progress
    time_limit : limit for each cell [s], at most `LONGEST_CELL`
    """
    todo = list(cells(axes, methods))
    bar.part("stability", later=lambda: 0.0)
    with workers.side_by_side() as pool:
        limit = min(time_limit, LONGEST_CELL)
        found = run_cells([runnable(cell) for cell in todo], pool, journal, watcher=bar, time_limit=limit)
    return tuple(row_of(cell, found[cell.key]) for cell in todo)


def _facts(workers: Workers, methods: Sequence[str] | None) -> dict[str, Any]:
    return dict(
        machine=workers.ask(machine),
        versions=workers.ask(partial(versions, chosen_methods(methods))),
        settings=dict(patience=PATIENCE, stiffening=STIFFENING),
        seeds="none: nothing is random",
    )


def page_of(study: StabilityStudy, folder: Path) -> str:
    """Return the text of stability.html, which names the report in the same folder where there is one."""
    command = shlex.join(["contactqp", "report", "--stability"])
    beside = REPORT if (folder / REPORT).exists() else ""
    ranges = bars_of([_axis_data(study, axis) for axis in study.axes])
    return render_study(stability_sections(study), _tiles(study), COLUMNS, study.facts, command, beside, ranges)


def _tiles(study: StabilityStudy) -> tuple[Tile, ...]:
    wrong = len(study.wrong)
    return (
        Tile(wrong, "wrong but passed", "‼ must be 0" if wrong else "✓ no answer passes that is wrong", wrong > 0),
        Tile(study.flags_wrong, "silently wrong", "answers that a method by itself calls solved, and are not"),
        Tile(len(study.refused_right), "right and refused", "answers right to 1e-6 that the certificate does not pass"),
        Tile(len(study.rows), "rows", f"on {len(study.axes)} axes"),
    )
