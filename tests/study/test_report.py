"""The report: files, exit code, nothing half-written, columns as documented."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.certificate import certificate_of
from contactqp.model.solution import Answer, Candidate
from contactqp.solving import methods as registry
from contactqp.solving.methods.method import Method, Settings
from contactqp.study import collecting, rows
from contactqp.study import reporting as report
from contactqp.study.case_study import CaseStudy, load_studies
from contactqp.study.footprint import Footprint
from contactqp.study.rows import Row
from contactqp.study.running.runner import Running
from contactqp.study.settings import Setting, chosen_methods
from contactqp.study.truth import Truth
from tests.study.csv_rows import from_csv

HERE = Running(jobs=0)
ROOT = Path(__file__).parents[2]
CASES = [ROOT / "cases" / "bar_wall.toml", ROOT / "cases" / "two_bars.toml"]
FEW = ["active-set", "osqp", "penalty", "augmented-lagrangian"]


def _write(folder: Path, methods: Sequence[str] = FEW, cases: Sequence[Path] = CASES) -> report.ReportResult:
    return report.write_report(cases, folder, methods=methods, tolerances=(1e-3, 1e-9), repeats=1, running=HERE)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, report.ReportResult]:
    folder = tmp_path_factory.mktemp("study") / "report"
    return folder, _write(folder)


def test_two_cases_write_every_file(written: tuple[Path, report.ReportResult]) -> None:
    folder, result = written
    assert result.exit_code == 0
    assert not result.summary.unmet
    names = {file.name for file in folder.iterdir()}
    assert names == {"index.html", "results.csv", "results.json"}
    assert {folder / name for name in names} == set(result.files)
    assert not list(folder.parent.glob(".contactqp*"))


def test_csv_and_json_hold_the_same_rows(written: tuple[Path, report.ReportResult]) -> None:
    folder, result = written
    data = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert from_csv((folder / "results.csv").read_text(encoding="utf-8")) == result.rows
    assert tuple(rows.Row(**row) for row in data["rows"]) == result.rows
    assert (data["schema"], data["schema_version"]) == ("contactqp-report", 2)
    assert data["columns"] == dict(rows.COLUMNS)
    assert {"numpy", "scipy", "contactqp", "osqp"} <= set(data["versions"])
    assert data["machine"]["python"]
    assert data["settings"]["tolerances"] == [1e-3, 1e-9]
    assert data["created"]
    assert [case["name"] for case in data["cases"]] == ["bar_wall", "two_bars"]
    assert all(case["judgements"] and not case["unmet"] for case in data["cases"])
    assert all(case["footprint"]["certified"] and case["footprint"]["stages"] for case in data["cases"])


def test_columns_are_those_that_are_documented() -> None:
    text = (ROOT / "docs" / "report.md").read_text(encoding="utf-8")
    table = text.partition("## Columns")[2].partition("\n## ")[0]
    documented = dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", table, flags=re.MULTILINE))
    assert documented == dict(rows.COLUMNS)
    verdicts = dict(re.findall(r"^\| ([\w ]+) \| (.+) \|$", text.partition("## Verdicts")[2], flags=re.MULTILINE))
    verdicts.pop("verdict")
    assert verdicts == dict(rows.VERDICTS)


def test_errors_are_true_errors(written: tuple[Path, report.ReportResult]) -> None:
    _, result = written
    mine = [row for row in result.rows if row.case == "two_bars"]
    # The case states the ladder of its source; λ = 95 β / (β + 105000).
    penalty = {row.knob_value: row for row in mine if row.method == "penalty"}
    assert set(penalty) == {1e3, 1e5, 1e6, 1e8}
    for beta, row in penalty.items():
        assert beta is not None
        assert row.error_force == pytest.approx(105000 / (beta + 105000), rel=1e-6)
        assert row.verdict == rows.APPROXIMATE
    exact = [row for row in mine if row.variant == "polished" or row.method == "active-set"]
    assert {row.method for row in exact} >= {"active-set", "osqp"}
    assert all(row.verdict == rows.RIGHT and row.expectations_unmet == 0 for row in exact)
    raw = {row.knob_value: row for row in mine if row.method == "osqp" and row.variant == "raw"}
    assert raw[1e-3].verdict == rows.REFUSED
    assert (raw[1e-3].error_force or 0) > (raw[1e-9].error_force or 0)


def test_uzawa_gains_a_digit_an_iteration(written: tuple[Path, report.ReportResult]) -> None:
    _, result = written
    errors = [row.error_force for row in result.rows if row.case == "two_bars" and row.variant == "uzawa"]
    assert errors[0] is not None
    assert errors[1] is not None
    assert errors[1] < 0.2 * errors[0]


def test_the_page_says_what_was_found(written: tuple[Path, report.ReportResult]) -> None:
    page = (written[0] / "index.html").read_text(encoding="utf-8")
    assert "Two bars that meet" in page
    assert "augmented-lagrangian" in page
    assert "osqp" in page
    for text in ("Called solved, and was right", "against run time", "one linear solve", "Performance profile"):
        assert text in page
    if importlib.util.find_spec("matplotlib"):
        assert page.count('<img src="data:image/png;base64,') == 2 * 2  # the answers, and their stamps


@pytest.fixture(scope="module")
def replaced(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, report.ReportResult]:
    """A report of one row, into a folder where an old one was and a file of somebody's own."""
    folder = tmp_path_factory.mktemp("replaced")
    (folder / "results.csv").write_text("old")
    (folder / "mine.txt").write_text("keep")
    return folder, _write(folder, ["active-set"], CASES[:1])


@pytest.mark.slow
def test_an_earlier_report_is_replaced_whole(replaced: tuple[Path, report.ReportResult]) -> None:
    folder, _ = replaced
    assert (folder / "results.csv").read_text().startswith("case,method,")
    assert (folder / "mine.txt").read_text() == "keep"


@pytest.mark.slow
def test_without_its_libraries_no_page_is_left(
    replaced: tuple[Path, report.ReportResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "report"
    assert (replaced[0] / "index.html") in replaced[1].files
    shutil.copytree(replaced[0], folder)
    assert (folder / "index.html").exists()
    monkeypatch.setattr("contactqp.study.page.render.NEEDED", ("jinja2", "plotly_is_not_here"))
    result = _write(folder, ["active-set"], CASES[:1])
    assert any("plotly_is_not_here is not installed: pip install" in note for note in result.notes)
    assert not (folder / "index.html").exists()  # the old one would speak of other rows
    assert (folder / "results.csv").exists()
    assert result.exit_code == 0


@pytest.mark.slow
def test_a_wrong_method_that_passes_makes_the_exit_code_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lie(problem: cq.ContactProblem, _: Settings) -> Candidate:
        return Candidate(Answer(np.zeros(problem.dimension), np.ones(problem.contacts), None, np.zeros(problem.ties)))

    monkeypatch.setitem(registry._REGISTRY, "liar", Method(name="liar", kind="test", solve=lie))
    honest = certificate_of
    refused = _write(tmp_path / "refused", ["active-set", "liar"], CASES[1:])
    assert refused.exit_code == 0  # refused is not wrong
    assert refused.summary.silently_wrong == 1  # its own flag was

    def blind(*args: Any, **options: Any) -> cq.Certificate:
        return dataclasses.replace(honest(*args, **options), passed=True, failures=())

    monkeypatch.setattr("contactqp.solving.runs.certificate_of", blind)
    believed = _write(tmp_path / "believed", ["active-set", "liar"], CASES[1:])
    assert believed.exit_code == 1
    assert believed.summary.wrong_but_passed == 1
    assert [row.method for row in believed.rows if row.verdict == rows.WRONG] == ["liar"]


def test_an_unmet_expectation_makes_the_exit_code_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collecting, "measure", lambda case, **_: Footprint(case, "active-set", failure="not measured"))
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(CASES[1].read_text().replace('value = "95 kN"', 'value = "96 kN"', 1))
    result = _write(tmp_path / "report", ["active-set"], [wrong])
    assert result.exit_code == 1
    assert any("normal force tips" in text for text in result.summary.unmet)
    assert result.rows[0].verdict == rows.WRONG  # against the case's own value


@pytest.mark.slow
def test_a_report_that_ends_early_leaves_what_it_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No file of the report, nothing of it half-written, and the same call goes on: after an error, an interruption."""
    folder, honest = tmp_path / "report", CaseStudy.answer
    answered: list[str] = []
    ends: list[type[BaseException]] = [KeyboardInterrupt, cq.SceneError]

    def fail_twice(study: CaseStudy, setting: Setting, truth: Truth | None) -> Row:
        if study.name == "bar_wall" and answered == ["two_bars"] and ends:
            raise ends.pop()("in the middle")
        answered.append(study.name)
        return honest(study, setting, truth)

    monkeypatch.setattr(CaseStudy, "answer", fail_twice)
    for kind, said in ((cq.SceneError, "in the middle"), (KeyboardInterrupt, "1 of 2 rows answered, 0 timed")):
        with pytest.raises(kind, match=said):
            _write(folder, ["active-set"])
        assert sorted(file.name for file in folder.iterdir()) == ["index.html", "unfinished_report.jsonl"]
    result = _write(folder, ["active-set"])
    assert answered == ["two_bars", "bar_wall"]  # the first one was kept
    assert [row.verdict for row in result.rows] == [rows.RIGHT] * 2
    assert any("kept" in note for note in result.notes)
    assert not list(folder.glob("*unfinished*"))


@pytest.mark.slow
def test_a_bug_costs_its_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: cq.ContactProblem, __: Settings) -> Candidate:
        raise RuntimeError("who would have thought")

    monkeypatch.setitem(registry._REGISTRY, "broken", Method(name="broken", kind="test", solve=broken))
    result = _write(tmp_path, ["broken", "active-set"], CASES[:1])
    assert [row.verdict for row in result.rows] == [rows.CRASHED, rows.RIGHT]
    assert "RuntimeError: who would have thought" in result.rows[0].message
    assert [method.refused for method in result.summary.methods] == [1, 0]
    assert any("crashed: 1 of 2 rows" in note for note in result.notes)


def test_a_bad_case_or_folder_is_refused_before_anything_is_solved(tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("title = ")
    with pytest.raises(cq.SceneError, match=r"broken\.toml"):
        _write(tmp_path / "report", ["active-set"], [CASES[0], broken])
    with pytest.raises(cq.SceneError, match="folder"):
        _write(broken, ["active-set"])
    assert sorted(file.name for file in tmp_path.iterdir()) == ["broken.toml"]


@pytest.mark.slow
def test_without_cases_those_of_the_folder_here_or_those_that_come_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert report._default_cases() == str(CASES[0].parent)
    (tmp_path / "cases").mkdir()
    (tmp_path / "cases" / "wall.toml").write_text(CASES[0].read_text())
    monkeypatch.setattr(report, "chosen_methods", lambda _: chosen_methods(["active-set"]))
    assert report.report((), "report", HERE, full=True) == 0
    assert "wrong but passed: 0" in capsys.readouterr().out
    assert (tmp_path / "report" / "index.html").exists()
    assert {row["case"] for row in json.loads((tmp_path / "report" / "results.json").read_text())["rows"]} == {"wall"}


@pytest.mark.slow
@pytest.mark.parametrize("all_of_them", [False, True])
def test_without_cases_the_telling_ones_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], all_of_them: bool
) -> None:
    monkeypatch.setattr(report, "chosen_methods", lambda _: chosen_methods(["active-set"]))
    if not all_of_them:
        monkeypatch.setattr(report, "telling_cases", lambda _: CASES[:1])
    assert report.report((), str(tmp_path / "report"), HERE) == 0
    assert "wrong but passed: 0" in capsys.readouterr().out
    found = {row["case"] for row in json.loads((tmp_path / "report" / "results.json").read_text())["rows"]}
    assert len(found) == 8 if all_of_them else found == {"bar_wall"}


def test_the_folder_of_a_report_has_a_page_before_its_cases_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed within its first second a report left case files and no page."""
    pages = []

    def cases(folder: Path) -> None:
        pages.append((folder / "index.html").read_text())
        raise cq.SceneError("killed")

    monkeypatch.setattr(report, "telling_cases", cases)
    for _ in range(2):
        with pytest.raises(cq.SceneError, match="killed"):
            report.report((), str(tmp_path / "report"), HERE)
    assert len(pages) == 2
    assert "the report has begun" in pages[0]
    assert pages[0] == pages[1]


def test_a_case_that_is_named_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(cq.SceneError, match=r"bar_wall.toml: expected each case once, got it as .*bar_wall.toml too"):
        _write(tmp_path / "out", cases=[CASES[0], CASES[1], CASES[0].parent / ".." / "cases" / CASES[0].name])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("limit", [float("nan"), float("inf"), 1e300, 0.0, -1.0])
def test_a_time_limit_is_a_time(limit: float) -> None:
    with pytest.raises(cq.InvalidProblem, match="time limit: expected seconds"):
        Running(time_limit=limit)


def test_a_folder_has_a_name() -> None:
    with pytest.raises(cq.SceneError, match="expected a folder"):
        report.write_report(CASES, "")


def test_two_cases_of_one_name_stay_apart(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "wall.toml").write_text(CASES[0].read_text())
    files = [tmp_path / folder / "wall.toml" for folder in ("a", "b")]
    assert [study.name for study in load_studies(files, ())] == ["a-wall", "b-wall"]


@pytest.mark.slow
def test_a_case_may_limit_its_methods(tmp_path: Path) -> None:
    case = tmp_path / "limited.toml"
    text = CASES[0].read_text()
    head, found, tail = text.partition("[[study]]")
    case.write_text(f'{head}[report]\nmethods = ["active-set", "lemke"]\nwhy = "two are enough"\n\n{found}{tail}')
    result = report.write_report([case], tmp_path / "out", methods=["active-set", "osqp", "lemke"], running=HERE)
    assert {row.method for row in result.rows} == {"active-set", "lemke"}
    assert "limited: only active-set, lemke: two are enough" in result.notes


PUSHED = """
title = "Pressed, pushed and let go"
axes = ["x", "z"]
nodes = [{ name = "1", at = ["0 m", "0 m"] }]
springs = [
    { name = "a", nodes = ["1"], direction = [1, 0], stiffness = "100 N/m" },
    { name = "b", nodes = ["1"], direction = [0, 1], stiffness = "100 N/m" },
]
obstacles = [{ name = "floor", point = ["0 m", "0 m"], normal = [0, 1] }]
contacts = [{ name = "foot", node = "1", obstacle = "floor", friction = 0.3 }]
loads = [
    { name = "weight", unknown = "1.z", value = "-10 N" },
    { name = "push", unknown = "1.x", value = "5 N" },
]
path = { steps = 2, corners = [{ weight = 1 }, { weight = 1, push = 1 }, { weight = 1 }] }
expect = [
    { quantity = "displacement", at = "1.x", value = "20 mm", derivation = "(5 N - 3 N) / 100 N/m, and it stays" },
    { quantity = "displacement", at = "1.z", value = "0 m", tolerance = "1e-15 m", derivation = "closed" },
    { quantity = "normal force", at = "foot", value = "10 N", derivation = "pressed" },
]
"""


@pytest.mark.slow
def test_with_friction_every_method_walks_the_path(tmp_path: Path) -> None:
    """Its last load alone, no push at all, would leave it where it was: that is no truth, and nobody is wrong."""
    case = tmp_path / "pushed.toml"
    case.write_text(PUSHED)
    methods = ["active-set", "osqp", "lemke", "penalty", "perturbed-lagrangian", "projected-gauss-seidel"]
    result = _write(tmp_path / "report", methods, [case])
    assert result.exit_code == 0
    verdicts = {row.method: row.verdict for row in result.rows}
    assert verdicts["active-set"] == verdicts["osqp"] == rows.RIGHT
    assert verdicts["projected-gauss-seidel"] == rows.UNSUPPORTED
    assert verdicts["penalty"] == verdicts["perturbed-lagrangian"] == rows.APPROXIMATE
    assert all(row.verdict in (rows.RIGHT, rows.UNSUPPORTED, rows.APPROXIMATE) for row in result.rows)
    (active,) = (row for row in result.rows if row.method == "active-set")
    assert active.error_displacement is not None
    assert active.error_displacement < 1e-12
    assert cq.solve(cq.load_scene(case).problem()).displacement[0] == 0.0


@pytest.mark.slow
def test_a_wrong_end_of_a_path_is_found(tmp_path: Path) -> None:
    case = tmp_path / "pushed.toml"
    case.write_text(PUSHED.replace("20 mm", "19 mm"))
    assert _write(tmp_path / "report", ["active-set"], [case]).exit_code == 1


@pytest.mark.slow
def test_exact_events_with_friction_take_no_method(tmp_path: Path) -> None:
    case = tmp_path / "pushed.toml"
    case.write_text(PUSHED.replace("steps = 2", 'events = "exact"'))
    result = _write(tmp_path / "report", ["active-set", "osqp"], [case])
    assert [row.method for row in result.rows] == ["active-set"]
    assert any("exact event" in note for note in result.notes)
    assert result.exit_code == 0
