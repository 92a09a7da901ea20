"""The tab key: what a shell is offered after the words that stand there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


def offered(folder: Path, line: str) -> list[str]:
    """Return what bash is offered at the end of a line."""
    words = dict(_CONTACTQP_COMPLETE="bash_complete", COMP_WORDS=line, COMP_CWORD=str(len(line.split(" ")) - 1))
    path = os.pathsep.join(
        entry for entry in (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")) if entry
    )
    done = subprocess.run(
        [sys.executable, "-m", "contactqp"],
        capture_output=True,
        text=True,
        check=True,
        cwd=folder,
        env=os.environ | words | {"PYTHONPATH": path},
    )
    return [item.partition(",")[2] for item in done.stdout.splitlines()]


@pytest.mark.sampled(7)
@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("contactqp ch", ["check"]),
        ("contactqp run bar_w", ["bar_wall", "bar_wall_path"]),
        ("contactqp run mi", ["mine.toml"]),
        ("contactqp explain fol", ["folder/"]),
        ("contactqp run bar_wall --method mas", ["master-slave"]),
        ("contactqp init mine.toml --like cantil", ["cantilever_stop"]),
        ("contactqp run --verb", ["--verbose"]),
    ],
)
def test_commands_cases_files_and_methods_are_completed(tmp_path: Path, line: str, found: list[str]) -> None:
    (tmp_path / "mine.toml").write_text("")
    (tmp_path / "folder").mkdir()
    assert offered(tmp_path, line) == found


@pytest.mark.slow
def test_the_line_that_is_documented_makes_a_function_for_the_shell() -> None:
    page = (Path(__file__).parents[2] / "docs" / "command_line.md").read_text(encoding="utf-8")
    assert 'eval "$(_CONTACTQP_COMPLETE=bash_source contactqp)"' in page
    environment = os.environ | {"_CONTACTQP_COMPLETE": "bash_source"}
    done = subprocess.run(
        [sys.executable, "-m", "contactqp"], capture_output=True, text=True, check=False, env=environment
    )
    assert "_contactqp_completion()" in done.stdout or "at least bash" in done.stderr
