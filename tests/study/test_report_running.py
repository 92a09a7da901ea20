"""A report that is killed, interrupted or crashed into: what it says afterwards is what it would have said."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from contactqp.cli import main
from contactqp.errors import SceneError
from contactqp.study import collecting, report_data, rows
from contactqp.study import reporting as report
from contactqp.study.answer_pictures import AnswerPictures
from contactqp.study.footprint import Footprint
from contactqp.study.rows import Row
from contactqp.study.running.journal import Journal
from contactqp.study.running.runner import Running
from tests.study.csv_rows import from_csv
from tests.study.running.test_journal import disk_of

ROOT = Path(__file__).parents[2]
CASES = [ROOT / "cases" / "two_bars.toml", ROOT / "cases" / "patch_two_blocks.toml"]
METHODS = ["active-set", "clarabel", "daqp", "penalty"]
JOURNAL = "unfinished_report.jsonl"
# What is measured is never the same twice.
TIMES: dict[str, Any] = dict(seconds=None, seconds_spread=None, repeats=0, linear_solve_seconds=None)


@pytest.fixture(autouse=True)
def nothing_but_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """What runs in this process makes no page, pictures and footprints."""
    monkeypatch.setattr(report, "missing_packages", lambda: "no page")
    monkeypatch.setattr(report_data, "answer_pictures", lambda _: AnswerPictures(why_not="no pictures"))
    monkeypatch.setattr(collecting, "measure", lambda case, **_: Footprint(case, "active-set", failure="not measured"))


def _write(folder: Path, jobs: int, cases: Sequence[Path] = CASES, methods: Sequence[str] = METHODS) -> Any:
    running = Running(jobs=jobs)
    return report.write_report(cases, folder, methods=methods, tolerances=(1e-6,), repeats=1, running=running)


def _timeless(table: Sequence[Row]) -> list[Row]:
    assert all((row.seconds is None) == (row.verdict in (rows.MISSING, rows.CRASHED)) for row in table)
    return [replace(row, **TIMES) for row in table]


@pytest.mark.slow  # the table of a report that is killed says so too
def test_the_table_is_the_same_in_processes(tmp_path: Path) -> None:
    here, there = (_write(tmp_path / str(jobs), jobs, CASES[:1], METHODS[:3]) for jobs in (0, 2))
    assert len(here.rows) > 4
    assert _timeless(here.rows) == _timeless(there.rows)
    assert all(row.repeats > 0 for row in there.rows)


@pytest.mark.slow
def test_the_table_is_the_same_however_many_processes(tmp_path: Path) -> None:
    files = sorted((ROOT / "cases").glob("t*.toml"))[::3]  # of bars, ties, friction, a penalty, a path
    one, two = (_write(tmp_path / str(jobs), jobs, files) for jobs in (1, 2))
    assert len(one.rows) > 5 * len(files)
    assert _timeless(one.rows) == _timeless(two.rows)


@pytest.mark.slow
@pytest.mark.parametrize("methods", [METHODS[:1], pytest.param(METHODS[:2], marks=pytest.mark.slow)], ids=len)
def test_a_journal_cut_at_every_line_gives_the_same_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, methods: Sequence[str]
) -> None:
    kept = tmp_path / "kept"
    with monkeypatch.context() as patched:
        patched.setattr(Journal, "remove", Journal.close)
        whole = _write(kept, 0, CASES[:1], methods)
    lines = (kept / JOURNAL).read_bytes().splitlines(keepends=True)
    assert len(lines) == 1 + 4 + 2 * len(whole.rows)  # head; truth, record, footprint, linear solve; rows
    for count in range(len(lines)):
        folder = tmp_path / str(count)
        folder.mkdir()
        (folder / JOURNAL).write_bytes(b"".join(lines[:count]) + lines[count][: len(lines[count]) // 2])
        again = _write(folder, 0, CASES[:1], methods)
        assert _timeless(again.rows) == _timeless(whole.rows)
        assert again.summary.cells() == whole.summary.cells()
        times = max(count - 5 - len(whole.rows), 0)
        assert [row.seconds for row in again.rows[:times]] == [row.seconds for row in whole.rows[:times]]
        assert not (folder / JOURNAL).exists()


@pytest.mark.slow
def test_a_changed_case_file_is_run_again_and_the_other_is_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = [Path(shutil.copy(case, tmp_path)) for case in CASES]
    with monkeypatch.context() as patched:
        patched.setattr(Journal, "remove", Journal.close)
        first = _write(tmp_path / "report", 0, cases, METHODS[:1])
    cases[0].write_text(cases[0].read_text().replace('value = "95 kN"', 'value = "96 kN"', 1))
    second = _write(tmp_path / "report", 0, cases, METHODS[:1])
    assert any(note.startswith("two_bars: changed") for note in second.notes)
    assert "6 results were kept from a report that was interrupted" in second.notes
    assert [row.verdict for row in second.rows] == [rows.WRONG, rows.RIGHT]
    assert second.rows[1] == first.rows[1]  # its time too
    assert second.exit_code == 1


CRASHING = """
import os, signal
def solve(*_, **__):
    os.kill(os.getpid(), signal.SIGSEGV)
"""


@pytest.fixture
def case(tmp_path: Path) -> Path:
    """A case of which a few methods make all rows."""
    text = CASES[0].read_text()
    limit = '[report]\nmethods = ["active-set", "daqp", "penalty", "augmented-lagrangian"]\nwhy = "enough"\n\n'
    file = tmp_path / "bars.toml"
    file.write_text(text.replace("[[study]]", f"{limit}[[study]]", 1))
    return file


class Command:
    """`contactqp report` in a process group of its own."""

    def __init__(self, case: Path, folder: Path, modules: Path | None = None) -> None:
        paths = [str(modules)] if modules else []
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([*paths, *sys.path])}
        command = [sys.executable, "-m", "contactqp", "report", str(case), "-o", str(folder), "--jobs", "1"]
        pipe = subprocess.PIPE
        self.journal = folder / JOURNAL
        self.process = subprocess.Popen(
            command, stdout=pipe, stderr=pipe, text=True, env=environment, start_new_session=True
        )

    def when_lines(self, count: int) -> None:
        """Wait until so many lines are in the journal."""
        deadline = time.monotonic() + 60
        while not (self.journal.exists() and self.journal.read_bytes().count(b"\n") >= count):
            assert self.process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.005)

    def end(self) -> tuple[int, str, str]:
        """Exit code, stdout and stderr."""
        out, err = self.process.communicate(timeout=120)
        return self.process.returncode, out, err


def _table(folder: Path) -> list[Row]:
    return _timeless(from_csv((folder / "results.csv").read_text(encoding="utf-8")))


POSIX = pytest.mark.skipif(sys.platform == "win32", reason="process groups and signals of POSIX")


@pytest.mark.slow
@POSIX
def test_killed_and_interrupted_it_goes_on_and_ends_with_the_same_table(
    case: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "report"
    kept = _stopped(Command(case, folder), 8, signal.SIGKILL)  # among the answers
    more = _stopped(Command(case, folder), 32, signal.SIGINT)  # among the times
    with pytest.raises(SystemExit) as end:
        main(["report", str(case), "-o", str(folder), "--jobs", "1"])
    out, err = capfd.readouterr()
    assert end.value.code == 0
    assert more > kept
    assert f"{more} results were kept" in err
    assert "written:" in out
    assert not (folder / JOURNAL).exists()
    whole = report.write_report([case], tmp_path / "whole", running=Running(jobs=0))
    assert _table(folder) == _timeless(whole.rows)


@POSIX
@pytest.mark.slow
def test_a_polite_kill_is_an_interruption(case: Path, tmp_path: Path) -> None:
    assert _stopped(Command(case, tmp_path / "report"), 8, signal.SIGTERM) >= 7


def _stopped(command: Command, lines: int, number: signal.Signals) -> int:
    """Stop a report and all its processes when its journal has so many lines; how many results it then has."""
    command.when_lines(lines)
    os.killpg(command.process.pid, number)  # as a terminal does
    code, out, err = command.end()
    assert sorted(file.name for file in command.journal.parent.iterdir()) == ["index.html", JOURNAL]
    assert out == ""
    if number == signal.SIGKILL:
        assert code == -number
    else:
        assert code == 128 + number
        progress = re.compile(r"contactqp: (?!interrupted)\w+: \d+ of \d+")
        (line,) = (line for line in err.splitlines() if not progress.match(line))
        assert line.startswith("contactqp: interrupted: ")
        assert line.endswith("; the same command goes on from there")
    return command.journal.read_bytes().count(b"\n") - 1


@POSIX
@pytest.mark.slow
def test_a_backend_that_crashes_costs_its_own_rows(case: Path, tmp_path: Path) -> None:
    modules = tmp_path / "modules"
    modules.mkdir()
    (modules / "daqp.py").write_text(CRASHING)
    code, _, err = Command(case, tmp_path / "report", modules).end()
    assert code == 0
    table = from_csv((tmp_path / "report" / "results.csv").read_text(encoding="utf-8"))
    crashed = [row for row in table if row.verdict == rows.CRASHED]
    assert {row.method for row in crashed} == {"daqp"}
    assert len(crashed) == sum(row.method == "daqp" for row in table)
    assert all(row.message == "the process died of a segmentation fault (SIGSEGV)" for row in crashed)
    assert all(row.seconds is None and row.error_force is None for row in crashed)
    assert any(row.verdict == rows.RIGHT for row in table)
    assert f"crashed: {len(crashed)} of {len(table)} rows" in err
    assert "Traceback" not in err


def test_two_reports_into_one_folder_are_refused(tmp_path: Path) -> None:
    held = Journal(tmp_path / JOURNAL, {})
    with pytest.raises(SceneError, match="another report is being written to this folder"):
        _write(tmp_path, 0, CASES[:1], METHODS[:1])
    held.close()


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], pytest.param(["--stability"], marks=pytest.mark.slow)], ids=["cases", "study"])
def test_a_full_disk_is_one_line_and_exit_code_2_and_the_same_command_goes_on(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], options: list[str]
) -> None:
    folder = tmp_path / "report"
    arguments = ["report", *(options or [str(case)]), "-o", str(folder), "--jobs", "1"]
    kept = []
    for room in (20_000, 0):
        with monkeypatch.context() as full:
            disk_of(full, room)
            with pytest.raises(SystemExit) as exit_:
                main(arguments)
        assert exit_.value.code == 2
        out, err = capfd.readouterr()
        assert out == ""
        assert "Traceback" not in err
        *_, line = (line for line in err.splitlines() if line.startswith("contactqp: "))  # before it: how far it is
        (file,) = folder.iterdir()
        kept.append(file.read_bytes().count(b"\n") - 1)
        assert kept[-1] > 0
        assert line == (
            f"contactqp: {file}: cannot be written: No space left on device; the {kept[-1]} results found so far are "
            "kept in it; free space there and run the same command again"
        )
    assert kept[0] == kept[1]  # the second found what the first had kept
