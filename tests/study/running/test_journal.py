"""A journal that is cut anywhere is as good as what is whole of it, and never better."""

from __future__ import annotations

import errno
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from contactqp.errors import SceneError
from contactqp.study.running.journal import Cell, Crash, Journal
from tests.study.running.cell_functions import Number, half

CONDITIONS = {"versions": {"numpy": "1.26"}, "settings": {"tolerances": (1e-3, 1e-9), "repeats": 3}}


def _cell(i: int, digest: str = "d") -> Cell:
    return Cell(f"cell {i}", half, (float(i),), Number, digest)


CELLS = [_cell(i) for i in range(4)]


def _written(file: Path) -> bytes:
    journal = Journal(file, CONDITIONS)
    for i, cell in enumerate(CELLS[:-1]):
        assert journal.write(cell, Number(i / 3)) == Number(i / 3)
    journal.write(CELLS[-1], Crash("died"))
    journal.close()
    return file.read_bytes()


def _found(file: Path) -> list[Any]:
    journal = Journal(file, CONDITIONS)
    found = [journal.find(cell) for cell in CELLS]
    journal.close()
    return found


def test_what_is_written_is_found(tmp_path: Path) -> None:
    _written(tmp_path / "journal")
    assert _found(tmp_path / "journal") == [Number(0.0), Number(1 / 3), Number(2 / 3), Crash("died")]


def test_cut_at_any_byte_what_is_whole_is_found_and_the_rest_can_be_written(tmp_path: Path) -> None:
    file = tmp_path / "journal"
    data = _written(file)
    everything = _found(file)
    for end in range(0, len(data), 7):
        file.write_bytes(data[:end])
        whole = max(data[:end].count(b"\n") - 1, 0)
        assert _found(file) == everything[:whole] + [None] * (4 - whole)
        assert _written(file).count(b"\n") == 1 + whole + 4
        assert _found(file) == everything


def test_a_line_that_the_disk_has_lost_is_left_out(tmp_path: Path) -> None:
    file = tmp_path / "journal"
    lines = _written(file).splitlines()
    lines[2] = b"\0" * len(lines[2])
    lines[3] = lines[3].replace(b'"value"', b'"vague"')
    file.write_bytes(b"\n".join(lines) + b"\n")
    assert _found(file) == [Number(0.0), None, None, Crash("died")]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"versions": {"numpy": "2.0"}}, "numpy 1.26 instead of 2.0"),
        ({"versions": {"numpy": "1.26", "scipy": "1.10"}}, "scipy None instead of 1.10"),
        ({"settings": {"tolerances": (1e-3,), "repeats": 3}}, r"tolerances \[0.001, 1e-09\] instead of \[0.001\]"),
    ],
)
def test_other_conditions_start_over_and_it_says_why(tmp_path: Path, changes: Any, told: str) -> None:
    file = tmp_path / "journal"
    _written(file)
    journal = Journal(file, CONDITIONS | changes)
    assert CELLS
    assert all(journal.find(cell) is None for cell in CELLS)
    assert len(journal.notes) == 1
    assert re.search(told, journal.notes[0])
    journal.close()
    assert len(file.read_bytes().splitlines()) == 1


def test_fresh_starts_over_and_says_nothing(tmp_path: Path) -> None:
    _written(tmp_path / "journal")
    journal = Journal(tmp_path / "journal", CONDITIONS, fresh=True)
    assert journal.notes == ()
    assert journal.find(CELLS[0]) is None
    journal.close()


def test_results_of_another_state_of_a_case_are_not_found(tmp_path: Path) -> None:
    _written(tmp_path / "journal")
    journal = Journal(tmp_path / "journal", CONDITIONS)
    changed = [_cell(0), _cell(1, "other"), _cell(9)]
    assert [journal.find(cell) for cell in changed] == [Number(0.0), None, None]
    assert list(journal.changed(changed)) == changed[1:2]
    journal.write(changed[1], Number(5.0))
    journal.close()
    journal = Journal(tmp_path / "journal", CONDITIONS)
    assert journal.find(changed[1]) == Number(5.0)
    journal.close()


def test_a_file_that_is_no_journal_is_written_over(tmp_path: Path) -> None:
    (tmp_path / "journal").write_text('{"schema": "something else"}\n{"key": "cell 0", "digest": "d"}\n')
    assert _found(tmp_path / "journal") == [None] * 4
    head = json.loads((tmp_path / "journal").read_text())
    assert (head["schema"], head["schema_version"]) == ("contactqp-unfinished-study", 1)


def test_two_at_a_time_are_refused(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal", CONDITIONS)
    journal.write(CELLS[0], Number(0.0))
    with pytest.raises(SceneError, match="another report is being written"):
        Journal(tmp_path / "journal", CONDITIONS)
    journal.close()
    assert _found(tmp_path / "journal")[0] == Number(0.0)


@pytest.mark.slow
def test_a_process_that_is_killed_lets_go_and_leaves_what_it_found(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys, pathlib\n"
        "from tests.study.running import test_journal as t\n"
        "journal = t.Journal(pathlib.Path(sys.argv[1]), t.CONDITIONS)\n"
        "journal.write(t.CELLS[0], t.Number(0.0))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "journal")], check=False, env=environment)
    assert _found(tmp_path / "journal") == [Number(0.0), None, None, None]


def test_a_finished_study_leaves_no_file(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal", CONDITIONS)
    journal.remove()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(SceneError, match="expected a folder that can be written, got: Permission denied"):
        Journal(tmp_path / "journal", CONDITIONS)


class Disk(io.FileIO):
    """A file on a disk that has room for so many bytes, and says what it is asked to beyond."""

    room = 0
    error = errno.ENOSPC

    def write(self, data: Any) -> int:
        if len(data) <= self.room:
            self.room -= len(data)
            return super().write(data)
        if self.room:
            half, self.room = bytes(data)[: self.room], 0
            return super().write(half)
        raise OSError(self.error, os.strerror(self.error))


def disk_of(monkeypatch: pytest.MonkeyPatch, room: int, error: int = errno.ENOSPC) -> None:
    """Journals that are opened from now on lie on such a disk."""

    honest = Path.open

    def opened(file: Path, mode: str = "r", *arguments: Any, **options: Any) -> Any:
        if mode != "a+b":
            return honest(file, mode, *arguments, **options)
        disk = Disk(file, "a+")
        disk.room, disk.error = room, error
        return io.BufferedRandom(disk)

    monkeypatch.setattr(Path, "open", opened)


@pytest.mark.parametrize(
    ("error", "todo"),
    [(errno.ENOSPC, "free space there and run"), (errno.EDQUOT, "free space there and run"), (errno.EIO, "run")],
)
def test_a_full_disk_is_one_line_and_what_was_found_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int, todo: str
) -> None:
    file = tmp_path / "journal"
    whole = len(_written(file))
    file.unlink()
    with monkeypatch.context() as full:
        disk_of(full, whole - 5, error)
        journal = Journal(file, CONDITIONS)
        for i, cell in enumerate(CELLS[:-1]):
            journal.write(cell, Number(i / 3))
        with pytest.raises(SceneError) as refused:
            journal.write(CELLS[-1], Crash("died"))
    reason = f"{os.strerror(error)}; the 3 results found so far are kept in it; {todo} the same command again"
    assert str(refused.value) == f"{file}: cannot be written: {reason}"
    journal.close()  # what is left of the line does not come up once more
    assert file.stat().st_size == whole - 5
    assert _found(file) == [Number(0.0), Number(1 / 3), Number(2 / 3), None]  # and it is locked no more


def test_a_disk_that_was_full_from_the_start_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as full:
        disk_of(full, 0)
        with pytest.raises(SceneError, match="nothing was found yet; free space there and run"):
            Journal(tmp_path / "journal", CONDITIONS)
    assert _found(tmp_path / "journal") == [None] * 4
