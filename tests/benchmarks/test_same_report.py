"""The comparison of two reports finds a verdict, an error and a row that are not the same, and forgives times."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.same_report import differences, rows_of


def row(**changes: Any) -> dict[str, Any]:
    usual = dict(case="bar", method="osqp", variant="raw", condensed="", knob="tolerance", knob_value=1e-3)
    return usual | dict(verdict="right", error_force=1e-8, seconds=0.1, message="") | changes


def compared(
    tmp_path: Path, before: list[dict[str, Any]], after: list[dict[str, Any]], relative: float = 0
) -> list[str]:
    files = []
    for name, rows in (("before", before), ("after", after)):
        files.append(tmp_path / f"{name}.json")
        files[-1].write_text(json.dumps({"rows": rows}))
    return list(differences(rows_of(str(files[0])), rows_of(str(files[1])), relative))


def test_only_the_times_may_differ(tmp_path: Path) -> None:
    assert compared(tmp_path, [row()], [row(seconds=9.0)]) == []


@pytest.mark.parametrize("changes", [dict(verdict="wrong but passed"), dict(error_force=2e-8), dict(error_force=None)])
def test_another_verdict_or_error_is_found(tmp_path: Path, changes: dict[str, Any]) -> None:
    (found,) = compared(tmp_path, [row()], [row(**changes)])
    assert found.startswith("bar osqp raw tolerance 0.001: ")


def test_errors_may_differ_by_a_part_that_is_asked_for(tmp_path: Path) -> None:
    assert compared(tmp_path, [row()], [row(error_force=1.01e-8)], relative=0.1) == []
    assert len(compared(tmp_path, [row()], [row(error_force=-1e-8)], relative=0.1)) == 1


def test_a_row_of_one_of_them_alone_is_found(tmp_path: Path) -> None:
    assert compared(tmp_path, [row()], []) == ["bar osqp raw tolerance 0.001: only before"]
    with pytest.raises(SystemExit, match="two rows have one name"):
        compared(tmp_path, [row(), row()], [])
