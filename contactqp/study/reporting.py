"""The report: every case by every method and every value of its knob, written to a folder."""

from __future__ import annotations

import datetime
import shlex
import sys
import textwrap
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from contactqp.errors import SceneError
from contactqp.scene.judging import case_files
from contactqp.scene.shipped import shipped_folder
from contactqp.study.case_study import CaseStudy, load_studies
from contactqp.study.collecting import Collector, Rounds
from contactqp.study.conclusion import (
    busy,
    conclude,
    deliver,
    linear_algebra,
    load,
    machine,
    report_folder,
    unfinished,
    versions,
    workshop,
    write,
)
from contactqp.study.page.case_view import stability_bars
from contactqp.study.page.render import missing_packages, render
from contactqp.study.report_charts import case_charts, overview_charts
from contactqp.study.report_data import ReportData, Summary, as_json, changes, read_report, summarise
from contactqp.study.rows import CRASHED, Row, folded, to_csv
from contactqp.study.running.journal import source_digest
from contactqp.study.running.runner import Running, Stopped, progress, stopped_after, stopped_by_signals, workers_of
from contactqp.study.running.workers import Workers
from contactqp.study.settings import BRIEF_TOLERANCES, STIFFENINGS, TOLERANCES, UZAWA_ITERATIONS, chosen_methods
from contactqp.study.telling import examples_chart, telling_case, telling_cases, telling_chart

# Rounds of timing, and the seconds after which those of one setting are enough, in full and in brief.
REPEATS, ENOUGH = 3, 0.05
BRIEF_ROUNDS = Rounds(2, 0.5)
HERE = Running()
DEFAULT_CASES = "cases"
PAGE = "index.html"
# Seconds between two pages of an unfinished report, at least; and so many times what writing one takes.
EVERY, SHARE = 5.0, 20.0
WIDTH = 80  # letters of a line on the terminal
NAMES = 25  # of these for the names of methods


@dataclass(frozen=True)
class ReportResult:
    """The results of a report, and the files that it wrote."""

    summary: Summary
    rows: tuple[Row, ...]
    files: tuple[Path, ...]
    notes: tuple[str, ...]  # what was left out, and why
    load: float | None = None  # of the machine, before it began

    @property
    def exit_code(self) -> int:
        """Return 1 if anything claims to be right and is not, else 0."""
        return self.summary.exit_code


def report(
    cases: Sequence[str], output: str, running: Running = HERE, full: bool = False, compare: str | None = None
) -> int:
    """Write the report of the command line, print what it found and where it is, and return the exit code.

    Without cases it is the brief report of the telling ones, or, in full, that of all in the folder ``cases``. With the
    results.json of an old report to `compare` with, what changed since then is printed at the end.

    Parameters
    ----------
    cases : sequence of str
        Case files and folders of them.
    output : str
        The folder of the report.
    running : Running
        Where and how the solves run.
    full : bool
        Whether all cases are taken where none is named.
    compare : str, optional
        The results.json of an old report.
    """
    old = None if compare is None else read_report(compare)
    try:
        if cases or full:
            result = write_report(case_files(cases or [_default_cases()]), output, running=running)
        else:
            result = write_report(telling_cases(_folder_with_a_page(output)), output, running=running, brief=True)
    except Stopped as stop:
        print(f"contactqp: {stop}", file=sys.stderr)
        return stop.code
    for note in result.notes:
        print(f"contactqp: {note}", file=sys.stderr)
    found = conclude(result.rows, result.load)
    print(folded(found.cells(), NAMES))
    if found.note:
        print(f"\n{textwrap.fill(found.note, WIDTH)}")
    for question, answer in found.answers:
        print(f"\n{textwrap.fill(f'{question} {answer}'.strip(), WIDTH)}")
    print()
    for text in result.summary.unmet_lines():
        print(textwrap.fill(f"not met: {text}", WIDTH, subsequent_indent="  "))
    print(textwrap.fill(f"{len(result.rows)} rows; {result.summary}", WIDTH))
    print(f"written: {', '.join(map(str, result.files))}")
    if old is not None:
        print(f"\nsince {compare}:\n{changes(old, read_report(Path(output) / 'results.json'))}")
    return result.exit_code


def _default_cases() -> str:
    """Return the folder of cases here, else that of the cases that come with the package."""
    if Path(DEFAULT_CASES).is_dir():
        return DEFAULT_CASES
    shipped = shipped_folder()
    if shipped is None:
        raise SceneError(f"report: expected case files, or a folder {DEFAULT_CASES!r} here, got neither")
    return str(shipped)


def write_report(
    cases: Sequence[str | Path],
    output: str | Path,
    *,
    methods: Sequence[str] | None = None,
    tolerances: Sequence[float] = TOLERANCES,
    repeats: int = REPEATS,
    running: Running = HERE,
    brief: bool = False,
) -> ReportResult:
    """Try every method with every value of its knob on every case, and write index.html, results.csv and results.json.

    Results are written as they are found to ``unfinished_report.jsonl`` in the folder, which is removed at the end.
    After an interruption of any kind the same call continues from there.

    Parameters
    ----------
    cases : sequence of paths, case files
    output : path
        The folder, made if need be. Files appear in it complete or not at all: the page from the beginning on, and
        again as it grows; the others when everything has been run.
    methods : sequence of names, optional
        All by default, the missing ones listed as missing.
    tolerances : sequence of float, the ladder of the methods whose knob is the tolerance, where the case states none
    repeats : rounds of timing at most; every call on a fresh problem
    running : processes, time limit and display of progress
    brief : final answers at the default tolerance alone, raw ones at three, and nothing on all unknowns

    Raises
    ------
    SceneError, InvalidProblem
        A case is wrong, or the folder cannot be written; before anything is solved.
    BackendMissing
        A Dask cluster is asked for and distributed is not installed.
    Stopped
        The report was interrupted by Ctrl-C or SIGTERM; the message says how far it was.
    """
    chosen = chosen_methods(methods)
    studies = load_studies(cases, chosen, tolerances, brief)
    rounds = BRIEF_ROUNDS if brief else Rounds(repeats, ENOUGH)
    folder = _folder_with_a_page(output)
    before = load()
    with stopped_by_signals(), workers_of(running, one_thread=bool(busy(before))) as workers:
        facts: dict[str, Any] = dict(
            machine=workers.ask(machine),
            versions=workers.ask(partial(versions, chosen)),
            settings=_settings(BRIEF_TOLERANCES if brief else tolerances, rounds, workers),
            seeds="none: nothing is random",
            left_out=list(_limited(studies)),
        )
        conditions = facts | dict(source=source_digest())
        with unfinished(folder, conditions, running.fresh) as journal, progress(running.shown) as bar:
            facts |= dict(command=_command(cases, brief), load=dict(at_start=before, threads_for_times=workers.threads))
            facts |= dict(linear_algebra=workers.ask(linear_algebra))
            page = _GrowingPage(folder, facts)
            collector = Collector(studies, workers, journal, bar, rounds, running.time_limit, brief, page)
            with stopped_after(lambda: str(collector)):
                collector.collect()
                facts["load"] |= dict(at_end=load())
                data = _report_data(collector, facts)
                notes = (
                    *filter(None, [busy(before)]),
                    *workers.notes,
                    *journal.notes,
                    *collector.notes,
                    *_limited(studies),
                    *_crashed(data.rows),
                )
                with workshop(folder) as shop:
                    notes = (*notes, *filter(None, [missing_packages()]))
                    write(shop / "results.csv", to_csv(data.rows))
                    write(shop / "results.json", as_json(data))
                    if not missing_packages():
                        write(shop / PAGE, _page(data, folder, notes))
                    files = _deliver(shop, folder)
    return ReportResult(data.summary, data.rows, files, notes, before)


# The page until there is something to show.
_BEGUN = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Contact problems</title>
<p><b>Still running:</b> the report has begun. This page grows; load it again.</p></html>
"""


def _folder_with_a_page(output: str | Path) -> Path:
    """Return the folder of a report, made if need be, with a page that says that it has begun where it has none."""
    folder = report_folder(output)
    if not (folder / PAGE).exists() and not missing_packages():
        with suppress(OSError), workshop(folder) as shop:  # what is written next says that it cannot be
            write(shop / PAGE, _BEGUN)
            deliver(shop, folder)
    return folder


def _report_data(collector: Collector, facts: Mapping[str, Any]) -> ReportData:
    """Return what has been found so far, with its summary."""
    records, found = collector.found()
    summary = summarise(
        found,
        unmet=(text for case in records for text in case.unmet),
        contradicted=(case.name for case in records if case.contradicted),
    )
    created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return ReportData(records, found, summary, dict(facts) | dict(created=created))


def _page(data: ReportData, folder: Path, notes: Sequence[str], running: str = "") -> str:
    charts = {case.name: case_charts(data, case) for case in data.cases}
    case = telling_case(data)
    opened = "" if case is None else case.name
    return render(
        data,
        overview_charts(data),
        charts,
        notes=notes,
        telling=telling_chart(data),
        examples=examples_chart(data),
        ranges=stability_bars(folder),
        running=running,
        opened=opened,
    )


class _GrowingPage:
    """Writes the page of an unfinished report, from the beginning on and then now and then."""

    def __init__(self, folder: Path, facts: Mapping[str, Any]) -> None:
        self._folder, self._facts = folder, facts
        self._next = 0.0  # not before this time [s]
        self._off = bool(missing_packages())

    def __call__(self, collector: Collector) -> None:
        started = time.monotonic()
        if self._off or started < self._next:
            return
        data = _report_data(collector, self._facts)
        try:
            with workshop(self._folder) as shop:
                write(shop / PAGE, _page(data, self._folder, (), running=collector.progress))
                deliver(shop, self._folder)
        except OSError:  # the journal says so, which cannot be written either
            self._off = True
        took = time.monotonic() - started
        self._next = started + took + max(EVERY, SHARE * took)


def _command(cases: Sequence[str | Path], brief: bool) -> str:
    """Return the command that makes a report again."""
    return shlex.join(["contactqp", "report", *([] if brief else map(str, cases))])


def _settings(tolerances: Sequence[float], rounds: Rounds, workers: Workers) -> dict[str, Any]:
    return dict(
        tolerances=list(tolerances),
        stiffenings=list(STIFFENINGS),
        uzawa_iterations=list(UZAWA_ITERATIONS),
        rounds=f"at most {rounds.most}, fewer once {rounds.enough:g} s are spent on a setting",
        answers=workers.how,
        timing="wall clock of solve on a fresh problem, without its certificate; median after a warm-up; all methods "
        "of a case in turn, and again, in one process, while nothing else of the report runs",
    )


def _limited(studies: Sequence[CaseStudy]) -> Iterator[str]:
    """Yield which settings are not tried on which case."""
    for study in studies:
        for text in study.left_out:
            yield f"{study.name}: {text}"


def _crashed(rows: Sequence[Row]) -> Iterator[str]:
    """Yield how many rows crashed, and the first of them."""
    crashed = [row for row in rows if row.verdict == CRASHED]
    if crashed:
        first = crashed[0]
        yield f"crashed: {len(crashed)} of {len(rows)} rows; the first: {first.case}: {first.method}: {first.message}"


def _deliver(shop: Path, folder: Path) -> tuple[Path, ...]:
    """Move the finished files to the folder; where there is no page, that of an earlier report is removed."""
    if not (shop / PAGE).exists():  # one of an earlier report would speak of other rows
        (folder / PAGE).unlink(missing_ok=True)
    return deliver(shop, folder)
