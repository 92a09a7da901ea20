"""The claims of a report's page, recomputed from results.csv by the script of its documentation."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from contactqp.study.reporting import ReportResult, write_report

ROOT = Path(__file__).parents[2]
SCRIPT = re.search(r"```python\n(.*?)```", (ROOT / "docs" / "report.md").read_text(encoding="utf-8"), re.DOTALL)
# Clarabel calls a string solved that just touches and is not; the cantilever is tried on all unknowns too; the
# projected Gauss-Seidel method does not take a body that floats.
CASES = ("string_just_touching", "cantilever_stop", "tie_beam_section")
METHODS = ("active-set", "clarabel", "projected-gauss-seidel", "penalty", "augmented-lagrangian", "gurobi")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ReportResult]:
    folder = tmp_path_factory.mktemp("claims")
    files = [ROOT / "cases" / f"{name}.toml" for name in CASES]
    return folder, write_report(files, folder / "report", methods=METHODS, tolerances=(1e-6, 1e-9), repeats=1)


def _run(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> list[str]:
    assert SCRIPT is not None
    monkeypatch.chdir(folder)
    exec(compile(SCRIPT[1], "docs/report.md", "exec"), {})
    return capsys.readouterr().out.splitlines()


def test_the_script_on_the_page_of_the_report_has_at_most_twenty_lines() -> None:
    assert SCRIPT is not None
    assert len([line for line in SCRIPT[1].splitlines() if line]) <= 20


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
def test_the_script_says_what_the_report_says(
    written: tuple[Path, ReportResult], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, result = written
    first, *lines = _run(folder, monkeypatch, capsys)
    assert first == f"wrong but passed: {result.summary.wrong_but_passed}"
    summary = {method.method: method for method in result.summary.methods if method.installed}
    overview = json.loads((folder / "report" / "results.json").read_text(encoding="utf-8"))["overview"]
    assert sorted(overview["compared_cases"]) == sorted(CASES)
    means = {one["method"]: one for one in overview["times"] if one["variant"] == "" and not one["whole"]}
    assert [_parsed(line)[0] for line in lines] == list(summary)
    for line in lines:
        name, counts, mean = _parsed(line)
        method = summary[name]
        assert counts == [method.own_answers, method.claimed, method.own_right, method.silently_wrong]
        assert mean == pytest.approx(means[name]["shifted_geometric_mean_seconds"], rel=1e-5)
    assert summary["clarabel"].silently_wrong > 0  # else nothing is counted


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
def test_a_row_that_is_spoiled_is_seen(
    written: tuple[Path, ReportResult],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = (written[0] / "report" / "results.csv").read_text(encoding="utf-8")
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "results.csv").write_text(text.replace(",right,", ",wrong but passed,", 1), encoding="utf-8")
    assert _run(tmp_path, monkeypatch, capsys)[0] == "wrong but passed: 1"


def _parsed(line: str) -> tuple[str, list[int], float]:
    found: Any = re.fullmatch(r"(\S+): own (\d+) claimed (\d+) right (\d+) silently wrong (\d+) mean (\S+) s", line)
    return found[1], [int(found[i]) for i in range(2, 6)], float(found[6])
