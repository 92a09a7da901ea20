"""What a report comes to, as it is told: what is in doubt, and what is not met."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from contactqp.study import reporting as report
from contactqp.study import rows
from contactqp.study.case_study import load_studies
from contactqp.study.running.runner import Running
from contactqp.study.settings import chosen_methods
from contactqp.study.truth import Truth

HERE = Running(jobs=0)
CASES = Path(__file__).parents[2] / "cases"
CONTRADICTED = "which the proven solution contradicts: one of them is wrong"


@pytest.fixture
def typo(tmp_path: Path) -> Path:
    """A case that expects another force than the right one."""
    file = tmp_path / "typo.toml"
    file.write_text((CASES / "two_bars.toml").read_text().replace('value = "95 kN"', 'value = "96 kN"', 1))
    return file


def _truth(file: Path) -> Truth:
    (study,) = load_studies([file], [])
    truth = study.truth()
    assert truth is not None
    return truth


def test_a_truth_that_the_proven_solution_contradicts_says_so(typo: Path, tmp_path: Path) -> None:
    right, wrong = _truth(CASES / "two_bars.toml"), _truth(typo)
    assert (right.contradicted, right.source) == (False, "the case's exact values")
    assert (wrong.contradicted, wrong.source) == (True, f"the case's exact values, {CONTRADICTED}")
    # Where the case states a part alone, the others are those of the same solution.
    stated = (CASES / "cantilever_stop.toml").read_text()
    part = tmp_path / "part.toml"
    part.write_text(stated.replace('value = "-1 mm"', 'value = "-1.1 mm"'))
    assert not _truth(CASES / "cantilever_stop.toml").contradicted
    assert _truth(part).contradicted
    assert re.fullmatch(rf".* \(3 of 4 numbers; the others: .*\), {CONTRADICTED}", _truth(part).source)


@pytest.mark.slow
def test_wrong_answers_of_a_case_in_doubt_are_told_with_their_count(
    typo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(report, "chosen_methods", lambda _: chosen_methods(["active-set", "lemke"]))
    folder = tmp_path / "report"
    assert report.report([str(CASES / "bar_wall.toml"), str(typo)], str(folder), HERE) == 1
    doubt = "see typo: the proven solution contradicts exact values of the case"
    out = " ".join(capsys.readouterr().out.split())  # lines of the terminal end at 80 columns
    assert f"; wrong but passed: 3 ({doubt}); expectations unmet: " in out
    assert f"must be 0; {doubt}" in (folder / "index.html").read_text(encoding="utf-8")
    data = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert data["summary"]["contradicted"] == ["typo"]
    assert [case["truth"].endswith(CONTRADICTED) for case in data["cases"]] == [False, True]
    assert {row["verdict"] for row in data["rows"] if row["case"] == "typo"} == {rows.WRONG}


@pytest.mark.slow
def test_what_is_not_met_is_told_once_with_how_often(
    typo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(report, "chosen_methods", lambda _: chosen_methods(["active-set", "daqp"]))
    folder = tmp_path / "report"
    assert report.report([str(typo)], str(folder), HERE) == 1
    out, page = capsys.readouterr().out, (folder / "index.html").read_text(encoding="utf-8")
    whole = out.replace("\n  ", " ")  # lines of the terminal end at 80 columns
    told = [line.removeprefix("not met: ") for line in whole.splitlines() if line.startswith("not met: ")]
    missed = "expected otherwise: normal force tips"
    assert f"typo: active-set: {missed}" in told
    assert f"typo: daqp: {missed} (4 times)" in told  # one for each tolerance
    assert len(set(told)) == len(told)
    assert all(f"<li>{line}</li>" in page for line in told)
    unmet = json.loads((folder / "results.json").read_text(encoding="utf-8"))["summary"]["unmet"]
    assert f"expectations unmet: {len(unmet)};" in out
    assert len(unmet) == len(told) + 3
