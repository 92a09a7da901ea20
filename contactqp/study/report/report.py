"""The main job: every case by every method and every value of its knob, written to a folder."""

from __future__ import annotations

import datetime
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contactqp.errors import SceneError
from contactqp.scene.arguments import case_files
from contactqp.scene.explanation import report_note
from contactqp.study.attempt import ENOUGH
from contactqp.study.case_study import CaseStudy, load_studies
from contactqp.study.report import picture
from contactqp.study.report.case_record import CaseRecord, record
from contactqp.study.report.machine import machine, versions
from contactqp.study.report.page import page
from contactqp.study.report.report_data import ReportData, as_json
from contactqp.study.report.summary import Summary, summarise
from contactqp.study.rows import Row, aligned, to_csv
from contactqp.study.rungs import STIFFENINGS, TOLERANCES, UZAWA_ITERATIONS, chosen_methods

if TYPE_CHECKING:
    from rich.progress import Progress

REPEATS = 3
DEFAULT_CASES = "cases"
PICTURE = "error_against_time"


@dataclass(frozen=True)
class ReportResult:
    """What a report found, and the files that it wrote."""

    summary: Summary
    rows: tuple[Row, ...]
    files: tuple[Path, ...]
    notes: tuple[str, ...]  # what was left out, and why

    @property
    def exit_code(self) -> int:
        """1 if anything claims to be right and is not, else 0."""
        return self.summary.exit_code


def report(cases: Sequence[str], output: str) -> int:
    """The report of the command line: says on the terminal what it found and where, and returns the exit code.

    Without cases those of the folder ``cases`` are taken.
    """
    result = write_report(case_files(cases or [_default_cases()]), output, progress=True)
    for note in result.notes:
        print(f"contactqp: {note}", file=sys.stderr)
    print(aligned(result.summary.cells()))
    for text in result.summary.unmet:
        print(f"not met: {text}")
    print(f"{len(result.rows)} rows; {result.summary}")
    print(f"written: {', '.join(str(file) for file in result.files if file.suffix != picture.SUFFIX)}")
    return result.exit_code


def _default_cases() -> str:
    if not Path(DEFAULT_CASES).is_dir():
        raise SceneError(f"report: expected case files, or a folder {DEFAULT_CASES!r} here, got neither")
    return DEFAULT_CASES


def write_report(
    cases: Sequence[str | Path],
    output: str | Path,
    *,
    methods: Sequence[str] | None = None,
    tolerances: Sequence[float] = TOLERANCES,
    repeats: int = REPEATS,
    progress: bool = False,
) -> ReportResult:
    """Try every method with every value of its knob on every case, and write index.html, results.csv and results.json.

    Parameters
    ----------
    cases : sequence of paths
        Case files.
    output : path
        The folder, made if need be. Files appear in it complete or not at all, when everything has been run.
    methods : sequence of names, optional
        All by default, the missing ones listed as missing.
    tolerances : sequence of float
        The ladder of the methods whose knob is the tolerance, where the case states none.
    repeats : int
        Timed calls after the first, at most; each on a fresh problem.
    progress : bool
        Show a progress bar on stderr.

    Raises
    ------
    SceneError, InvalidProblem
        A case is wrong, or the folder cannot be written; before anything is solved.
    """
    chosen = chosen_methods(methods)
    studies = load_studies(cases, chosen, tolerances)
    folder = Path(output)
    with _workshop(folder) as workshop:
        records, rows = _run(studies, repeats, progress)
        summary = summarise(rows, (text for case in records for text in case.unmet))
        facts: dict[str, Any] = dict(
            created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            machine=machine(),
            versions=versions(chosen),
            settings=_settings(tolerances, repeats),
            seeds="none: nothing is random",
        )
        data = ReportData(records, rows, summary, facts)
        notes = (*_limited(studies), *_draw(data, workshop))
        _write(workshop / "results.csv", to_csv(rows))
        _write(workshop / "results.json", as_json(data))
        _write(workshop / "index.html", _page(data, workshop))
        files = _deliver(workshop, folder)
    return ReportResult(summary, rows, files, notes)


def _settings(tolerances: Sequence[float], repeats: int) -> dict[str, Any]:
    return dict(
        tolerances=list(tolerances),
        stiffenings=list(STIFFENINGS),
        uzawa_iterations=list(UZAWA_ITERATIONS),
        repeats=f"at most {repeats}, fewer once {ENOUGH} s are spent",
        timing="wall clock of solve on a fresh problem, without its certificate; median after one warm-up",
    )


@contextmanager
def _workshop(folder: Path) -> Iterator[Path]:
    """A folder beside the report's, gone at the end whatever happens."""
    try:
        if folder.exists() and not folder.is_dir():
            raise SceneError(f"{folder}: expected a folder for the report, and there is a file of that name")
        folder.parent.mkdir(parents=True, exist_ok=True)
        workshop = tempfile.TemporaryDirectory(prefix=".contactqp-report-", dir=folder.parent)
    except OSError as error:
        raise SceneError(f"{folder}: expected a folder that can be written, got: {error.strerror}") from None
    with workshop as path:
        yield Path(path)


def _run(studies: Sequence[CaseStudy], repeats: int, shown: bool) -> tuple[tuple[CaseRecord, ...], tuple[Row, ...]]:
    with _progress(shown) as bar:
        task = bar.add_task("", total=sum(len(study.rungs) for study in studies))
        cases, rows = [], []
        for study in studies:
            bar.update(task, description=study.name)
            truth = study.truth()
            for row in study.rows(truth, repeats):
                rows.append(row)
                bar.advance(task)
            cases.append(record(study, truth))
    return tuple(cases), tuple(rows)


def _progress(shown: bool) -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True, disable=not shown)


def _limited(studies: Sequence[CaseStudy]) -> Iterator[str]:
    """Which cases keep methods out of the report."""
    for study in studies:
        if report_note(study.scene):
            yield f"{study.name}: {report_note(study.scene)}"


def _draw(data: ReportData, workshop: Path) -> tuple[str, ...]:
    """One picture for each case, one for all; returns what is to be said if there are none."""
    if not picture.can_draw():
        return ("no pictures, as matplotlib is not installed: pip install 'contactqp[report]'",)
    for case in data.cases:
        title = f"{case.title}: error against run time"
        picture.save(picture.draw(data.rows_of(case.name), title), workshop / _picture_name(case.name))
    if len(data.cases) > 1:
        title = f"Error against run time, median over {len(data.cases)} cases (knobs with units left out)"
        picture.save(picture.draw(picture.medians(data.rows), title), workshop / _picture_name(""))
    return ()


def _picture_name(case: str) -> str:
    return f"{PICTURE}{'_' if case else ''}{case}{picture.SUFFIX}"


def _page(data: ReportData, workshop: Path) -> str:
    files = {name: workshop / _picture_name(name) for name in ["", *(case.name for case in data.cases)]}
    pictures = {name: file.read_bytes() for name, file in files.items() if file.exists()}
    cases = [(case.name, case.title, case.truth) for case in data.cases]
    flat = {key: value for group in data.facts.values() if isinstance(group, dict) for key, value in group.items()}
    facts = {name: str(value) for name, value in (dict(data.facts) | flat).items()}
    return page(cases, data.rows, data.summary, facts, pictures)


def _write(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8", newline="\n")


def _deliver(workshop: Path, folder: Path) -> tuple[Path, ...]:
    """Every file is moved in one step; the page comes last, pictures of an earlier report go first."""
    folder.mkdir(exist_ok=True)
    for old in folder.glob(f"{PICTURE}*{picture.SUFFIX}"):
        old.unlink()
    made = sorted(workshop.iterdir(), key=lambda file: (file.name == "index.html", file.suffix, file.name))
    for file in made:
        os.replace(file, folder / file.name)
    return tuple(folder / file.name for file in made)
