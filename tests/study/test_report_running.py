"""A report that is killed, interrupted or crashed into: what it says afterwards is what it would have said."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from contactqp.study import rows
from contactqp.study.report import picture, report
from contactqp.study.rows import Row, from_csv
from contactqp.study.running.journal import Journal
from contactqp.study.running.running import Running

ROOT = Path(__file__).parents[2]
CASES = [ROOT / "cases" / "two_bars.toml", ROOT / "cases" / "patch_two_blocks.toml"]
METHODS = ["active-set", "clarabel", "daqp", "penalty"]
JOURNAL = "unfinished_report.jsonl"
# What is measured is never the same twice.
TIMES = dict(seconds=None, repeats=0)


@pytest.fixture(autouse=True)
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "can_draw", lambda: False)


def _write(folder: Path, jobs: int, cases: Sequence[Path] = CASES, methods: Sequence[str] = METHODS) -> Any:
    running = Running(jobs=jobs)
    return report.write_report(cases, folder, methods=methods, tolerances=(1e-6,), repeats=1, running=running)


def _timeless(table: Sequence[Row]) -> list[Row]:
    assert all((row.seconds is None) == (row.verdict in (rows.MISSING, rows.CRASHED)) for row in table)
    return [replace(row, **TIMES) for row in table]


def test_the_table_is_the_same_however_many_processes(tmp_path: Path) -> None:
    one, two = (_write(tmp_path / str(jobs), jobs) for jobs in (1, 2))
    assert len(one.rows) > 10
    assert _timeless(one.rows) == _timeless(two.rows)
    assert all(row.repeats > 0 for row in two.rows)
    here = _write(tmp_path / "here", 0)
    assert [row.verdict for row in here.rows] == [row.verdict for row in two.rows]


def test_a_journal_cut_at_every_line_gives_the_same_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = tmp_path / "kept"
    with monkeypatch.context() as patched:
        patched.setattr(Journal, "remove", Journal.close)
        whole = _write(kept, 0, CASES[:1], METHODS[:2])
    lines = (kept / JOURNAL).read_bytes().splitlines(keepends=True)
    assert len(lines) == 1 + 2 + 2 * len(whole.rows)  # head; truth and record; answer and time of each row
    for count in range(len(lines)):
        folder = tmp_path / str(count)
        folder.mkdir()
        (folder / JOURNAL).write_bytes(b"".join(lines[:count]) + lines[count][: len(lines[count]) // 2])
        again = _write(folder, 0, CASES[:1], METHODS[:2])
        assert _timeless(again.rows) == _timeless(whole.rows)
        assert again.summary == whole.summary
        times = max(count - 3 - len(whole.rows), 0)
        assert [row.seconds for row in again.rows[:times]] == [row.seconds for row in whole.rows[:times]]
        assert not (folder / JOURNAL).exists()


def test_a_changed_case_file_is_run_again_and_the_other_is_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cases = [Path(shutil.copy(case, tmp_path)) for case in CASES]
    with monkeypatch.context() as patched:
        patched.setattr(Journal, "remove", Journal.close)
        first = _write(tmp_path / "report", 0, cases, METHODS[:1])
    cases[0].write_text(cases[0].read_text().replace('value = "95 kN"', 'value = "96 kN"', 1))
    second = _write(tmp_path / "report", 0, cases, METHODS[:1])
    assert any(note.startswith("two_bars: changed") for note in second.notes)
    assert "4 results were kept from a report that was interrupted" in second.notes
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
    """A case of thirty rows, of which a few methods make all."""
    text = CASES[0].read_text()
    limit = '[report]\nmethods = ["active-set", "lemke", "daqp", "penalty", "augmented-lagrangian"]\nwhy = "enough"\n\n'
    file = tmp_path / "bars.toml"
    file.write_text(text.replace("[[study]]", f"{limit}[[study]]", 1))
    return file


class Command:
    """`contactqp report` in a process group of its own."""

    def __init__(self, case: Path, folder: Path, modules: Path | None = None) -> None:
        paths = [str(modules)] if modules else []
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([*paths, *sys.path])}
        command = [sys.executable, "-m", "contactqp", "report", str(case), "-o", str(folder), "--jobs", "2"]
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


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Row]]:
    """The rows of that case by a report that nobody interrupts."""
    yield []


def _table(folder: Path) -> list[Row]:
    return _timeless(from_csv((folder / "results.csv").read_text(encoding="utf-8")))


@pytest.mark.skipif(sys.platform == "win32", reason="process groups and signals of POSIX")
def test_killed_half_way_twice_and_restarted_it_ends_with_the_same_table(case: Path, tmp_path: Path) -> None:
    folder, kept = tmp_path / "report", []
    for lines in (10, 45):  # among the answers, and among the times
        command = Command(case, folder)
        command.when_lines(lines)
        os.killpg(command.process.pid, signal.SIGKILL)
        assert command.end()[0] == -signal.SIGKILL
        assert [file.name for file in folder.iterdir()] == [JOURNAL]
        kept.append((folder / JOURNAL).read_bytes().count(b"\n") - 1)
    code, out, err = Command(case, folder).end()
    assert code == 0
    assert kept[1] > kept[0]
    assert f"{kept[1]} results were kept" in err
    assert "written:" in out
    assert not (folder / JOURNAL).exists()
    whole = Command(case, tmp_path / "whole")
    assert whole.end()[0] == 0
    assert _table(folder) == _table(tmp_path / "whole")


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupted_it_says_how_far_it_is_and_goes_on(
    case: Path, tmp_path: Path, number: signal.Signals, code: int
) -> None:
    folder = tmp_path / "report"
    command = Command(case, folder)
    command.when_lines(12)
    os.killpg(command.process.pid, number)  # as a terminal does
    returned, out, err = command.end()
    assert returned == code
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith("contactqp: interrupted: ")
    assert line.endswith("; the same command goes on from there")
    assert "Traceback" not in err
    assert [file.name for file in folder.iterdir()] == [JOURNAL]
    again = Command(case, folder)
    assert again.end()[0] == 0
    assert (folder / "index.html").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_backend_that_crashes_costs_its_own_rows(case: Path, tmp_path: Path) -> None:
    modules = tmp_path / "modules"
    modules.mkdir()
    (modules / "daqp.py").write_text(CRASHING)
    command = Command(case, tmp_path / "report", modules)
    code, out, err = command.end()
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


def test_two_reports_into_one_folder_are_refused(case: Path, tmp_path: Path) -> None:
    command = Command(case, tmp_path / "report")
    command.when_lines(2)
    code, _, err = Command(case, tmp_path / "report").end()
    assert code == 2
    assert err == f"contactqp: {tmp_path / 'report'}: another report is being written to this folder\n"
    assert command.end()[0] == 0
