"""Rows, verdicts, ranges, files, charts, and the exit code."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import contactqp as cq
from contactqp.certificate.certificate import certificate_of
from contactqp.cli import command
from contactqp.model.solution import Answer, Candidate
from contactqp.solving import methods as registry
from contactqp.solving.methods import find
from contactqp.solving.methods.method import Method, Settings
from contactqp.solving.sparse_run import has_sparse_systems
from contactqp.study import rows as report_rows
from contactqp.study.curves import Chart
from contactqp.study.page.case_view import stability_bars
from contactqp.study.running.journal import Crash
from contactqp.study.running.runner import Stopped
from contactqp.study.settings import condensable
from contactqp.study.stability import stability_cells as cells_module
from contactqp.study.stability import stability_report as report_module
from contactqp.study.stability.problem_axes import GAP
from contactqp.study.stability.stability_cells import (
    AXES,
    COLUMNS,
    CUT_OFF,
    STATED,
    VERDICTS,
    StabilityRow,
    cells,
    digits_lost,
    find_axis,
    row_of,
    stability_row,
    too_large,
)
from contactqp.study.stability.stability_charts import LETTERS, best_penalty_of_truss
from contactqp.study.stability.stability_report import (
    StabilityStudy,
    as_json,
    grouped,
    page_of,
    safe_ranges,
    stability_sections,
    terminal_lines,
    write_stability,
)

ROOT = Path(__file__).parents[3]
FEW = ("active-set", "penalty", "lagrange-multiplier", "pyqpmad")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[StabilityStudy, Path]:
    """Few values of each axis, few methods; and the folder that it was written to."""
    folder = tmp_path_factory.mktemp("stability") / "out"
    axes = [dataclasses.replace(axis, values=axis.values[:: max(1, len(axis.values) // 3)][:4]) for axis in AXES[:4]]
    study, files, notes = write_stability(folder, axes, FEW)
    assert {file.parent for file in files} == {folder}
    assert not notes
    return study, folder


@pytest.fixture(scope="module")
def small(written: tuple[StabilityStudy, Path]) -> StabilityStudy:
    return written[0]


def test_every_method_is_tried_at_every_value_or_the_row_says_why() -> None:
    keys = [cell.key for cell in cells()]
    assert len(keys) == len(set(keys))
    for axis in AXES:
        mine = {(cell.method, cell.value) for cell in cells([axis])}
        names = set(axis.knobs) if axis.knobs else {method.name for method in cq.methods()}
        assert mine == {(name, value) for name in names for value in axis.values}
    missing = stability_row("redundancy", 1.0, "gurobi")
    assert missing.verdict in (report_rows.MISSING, report_rows.RIGHT)


def test_methods_with_dense_matrices_are_cut_off_where_these_take_gigabytes() -> None:
    dense = {method.name: method for method in cq.methods() if not has_sparse_systems(method)}
    assert {"penalty", "master-slave", "lemke", "daqp"} <= set(dense)
    assert not {"active-set", "clarabel", "osqp", "cvxpy"} & set(dense)
    for axis in ("contacts", "closed-contacts"):
        row = stability_row(axis, 1e4, "penalty")
        assert (row.verdict, row.contacts) == (CUT_OFF, 10_000)
        assert row.message == "a dense matrix of 10000 contacts takes 0.8 GB, and this method makes several of them"
        [found] = safe_ranges(find_axis(axis), [row])
        assert f"cut off at 1e+04 ({row.message})" in found.words
    for method in dense.values():
        assert too_large(10_000, method)
        assert not too_large(1_000, method)
    assert not too_large(100_000, find("active-set"))


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["contacts", "closed-contacts"])
@pytest.mark.parametrize("method", ["active-set", "clarabel"])
def test_very_many_contacts_are_right_in_little_memory(axis: str, method: str) -> None:
    """A process of its own, whose peak is that of this row and of its imports."""
    code = (
        "from contactqp.study.footprint_child import peak;"
        "from contactqp.study.stability.stability_cells import stability_row;"
        f"row = stability_row({axis!r}, 1e5, {method!r});"
        "print(row.verdict, peak() // 2**20)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    verdict, megabytes = done.stdout.split()
    assert verdict == report_rows.RIGHT
    assert int(megabytes) < 1000


@pytest.mark.slow
def test_very_many_contacts_are_not_condensed_onto_to_write_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bodies all of whose 10 000 unknowns touch something: as a dense matrix that is 0.8 GB."""

    def refuse(*_: object) -> None:
        raise AssertionError("all contacts were condensed onto")

    problem = find_axis("contacts").pose(1e4).problem
    monkeypatch.setattr("contactqp.study.settings.condense", refuse)
    assert condensable(problem, find("penalty"))
    monkeypatch.setattr("contactqp.study.truth.condense", refuse)
    assert find_axis("contacts").pose(1e4).truth.errors(np.zeros(10_000), np.zeros(10_000), np.zeros(0)).judged > 0.1


# A value of each axis at which a method breaks, which one, and how.
BREAKS = (
    ("penalty", 1e20, "penalty", report_rows.APPROXIMATE),
    ("stiffness-contrast", 2.0**52, "lagrange-multiplier", report_rows.REFUSED),
    ("singular-stiffness", 2.0**-60, "projected-gauss-seidel", report_rows.UNSUPPORTED),
    ("mesh-grading", 2.0**60, "lagrange-multiplier", report_rows.REFUSED),
    ("gap-ratio", 2.0**-50, "penalty", report_rows.APPROXIMATE),
    ("load-ratio", 2.0**540, "penalty", report_rows.APPROXIMATE),
    ("grazing", 2.0**-1, "penalty", report_rows.APPROXIMATE),
    ("redundancy", 2.0**-30, "lagrange-multiplier", report_rows.REFUSED),
    ("friction", 1.0 - 2.0**-40, "penalty", report_rows.APPROXIMATE),
    ("friction", 1.0, "active-set", STATED),
    ("incline", 2.0, "projected-gauss-seidel", report_rows.UNSUPPORTED),
    ("mass-ratio", 2.0**80, "projected-gauss-seidel", report_rows.NOT_CONVERGED),
    ("unit-systems", 0.0, "penalty", report_rows.APPROXIMATE),
    ("contacts", 1e2, "penalty", report_rows.APPROXIMATE),
    ("closed-contacts", 1e5, "lemke", CUT_OFF),
)


def test_each_axis_breaks_some_method() -> None:
    assert {axis for axis, *_ in BREAKS} == {axis.name for axis in AXES}


@pytest.mark.parametrize("method", ["penalty", "lemke"])
def test_that_a_block_slides_down_an_incline_too_steep_for_its_friction_is_right(method: str) -> None:
    row = stability_row("incline", 0.5, method)
    assert row.verdict == report_rows.RIGHT
    assert "the load drives a rigid motion" in row.message


@pytest.mark.sampled(9)
@pytest.mark.parametrize(("axis", "value", "method", "verdict"), BREAKS)
def test_methods_break_and_the_row_says_so(axis: str, value: float, method: str, verdict: str) -> None:
    row = stability_row(axis, value, method)
    assert row.verdict == verdict
    assert row.message
    assert not row.wrong


def test_an_equilibrium_that_does_not_exist_is_refused() -> None:
    row = stability_row("incline", 0.5, "active-set")
    assert row.verdict == report_rows.RIGHT
    assert "drives a rigid motion" in row.message


@pytest.mark.slow
def test_a_wrong_method_that_passes_is_found(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def lie(problem: cq.ContactProblem, _: Settings) -> Candidate:
        return Candidate(Answer(np.zeros(problem.dimension), np.ones(problem.contacts), None, np.zeros(problem.ties)))

    monkeypatch.setitem(registry._REGISTRY, "liar", Method(name="liar", kind="test", solve=lie))
    assert stability_row("mesh-grading", 1.0, "liar").verdict == report_rows.REFUSED
    honest = certificate_of

    def blind(*args: Any, **options: Any) -> cq.Certificate:
        return dataclasses.replace(honest(*args, **options), passed=True, failures=(), force_bound=np.zeros(1))

    monkeypatch.setattr("contactqp.solving.runs.certificate_of", blind)
    axis = dataclasses.replace(find_axis("mesh-grading"), values=(1.0,))
    study, _, _ = write_stability(tmp_path, [axis], ["liar"])
    assert [row.verdict for row in study.rows] == [report_rows.WRONG]
    assert study.exit_code == 1
    assert any("WRONG BUT PASSED" in line for line in terminal_lines(study))


def test_ranges_follow_the_rows() -> None:
    axis = find_axis("stiffness-contrast")

    def row(value: float, verdict: str) -> StabilityRow:
        return StabilityRow(axis=axis.name, value=value, method="some", verdict=verdict, error_force=1e-15)

    verdicts = [report_rows.RIGHT] * 5 + [report_rows.REFUSED] * (len(axis.values) - 5)
    [found] = safe_ranges(axis, [row(*pair) for pair in zip(axis.values, verdicts, strict=True)])
    assert (found.lowest, found.highest, found.everywhere) == (axis.values[0], axis.values[4], False)
    assert found.refused == axis.values[5:]
    assert "right from 1 to 8192;" in found.words
    assert "refused at" in found.words
    verdicts[4] = report_rows.NOT_CONVERGED
    [shorter] = safe_ranges(axis, [row(*pair) for pair in zip(axis.values, verdicts, strict=True)])
    assert shorter.highest == axis.values[3]
    [nowhere] = safe_ranges(axis, [row(value, report_rows.REFUSED) for value in axis.values])
    assert "right nowhere" in nowhere.words
    [whole] = safe_ranges(axis, [row(value, report_rows.RIGHT) for value in axis.values])
    assert whole.everywhere
    several = [dataclasses.replace(whole, method="other"), shorter, dataclasses.replace(shorter, method="third")]
    assert [words.partition(": ")[0] for words in grouped(several)] == ["some, third", "other"]


def test_digits_are_those_of_a_double() -> None:
    assert digits_lost(0.0) == digits_lost(2.0**-53) == 0.0
    assert digits_lost(1.0) == digits_lost(7.0) == digits_lost(float("inf")) == pytest.approx(15.9546)
    assert digits_lost(2.0**-53 * 100) == pytest.approx(2.0)
    assert digits_lost(None) is None


def test_files_hold_the_rows_and_their_columns(written: tuple[StabilityStudy, Path], tmp_path: Path) -> None:
    small, folder = written
    data = json.loads((folder / "stability.json").read_text(encoding="utf-8"))
    assert (data["schema"], data["schema_version"]) == ("contactqp-stability", 1)
    assert tuple(StabilityRow(**row) for row in data["rows"]) == small.rows
    assert data["columns"] == dict(COLUMNS)
    assert data["summary"]["wrong_but_passed"] == 0
    assert [axis["name"] for axis in data["axes"]] == [axis.name for axis in small.axes]
    written = list(csv.DictReader(io.StringIO((folder / "stability.csv").read_text(encoding="utf-8"))))
    assert list(written[0]) == list(COLUMNS)
    assert len(written) == len(small.rows)
    assert {path.name for path in folder.iterdir()} == {"stability.csv", "stability.html", "stability.json"}
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(cq.SceneError, match="folder"):
        write_stability(blocked)


def test_columns_verdicts_and_axes_are_documented() -> None:
    text = (ROOT / "docs" / "stability.md").read_text(encoding="utf-8")
    table = text.partition("## Columns")[2].partition("\n## ")[0]
    assert dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", table, flags=re.MULTILINE)) == dict(COLUMNS)
    table = text.partition("## Verdicts")[2].partition("\n## ")[0]
    documented = dict(re.findall(r"^\| (\w) \| ([\w ]+) \| .+ \|$", table, flags=re.MULTILINE))
    assert documented == {letter: name for name, (letter, _) in LETTERS.items()}
    assert set(LETTERS) | {report_rows.MISSING} == set(VERDICTS)
    table = text.partition("## Axes")[2].partition("\n## ")[0]
    assert re.findall(r"^\| `([\w-]+)` \|", table, flags=re.MULTILINE) == [axis.name for axis in AXES]


def charts_of(study: StabilityStudy) -> list[Chart]:
    return [chart for section in stability_sections(study) for chart in section.charts]


def test_charts_are_plotlys(small: StabilityStudy) -> None:
    graph_objects = pytest.importorskip("plotly.graph_objects")
    charts = charts_of(small)
    assert len({chart.name for chart in charts}) == len(charts) == 3 * len(small.axes) + 1
    for chart in charts:
        graph_objects.Figure(chart.figure)  # refuses what Plotly does not know
        json.dumps(chart.figure, allow_nan=False)
        assert chart.caption
        layout = chart.figure["layout"]
        assert layout["xaxis"]["title"]["text"]
        assert layout["yaxis"]["title"]["text"]
        assert all(len(line) == len(chart.headings) for line in chart.lines)
    valley = next(chart for chart in charts if chart.name == "stability-penalty-valley")
    assert "21.684" in valley.caption
    assert "21.684" in valley.figure["layout"]["annotations"][0]["text"]


def test_cells_of_a_verdict_map_have_letters(small: StabilityStudy) -> None:
    chart = next(chart for chart in charts_of(small) if chart.name == "stability-mesh-grading-verdicts")
    [trace] = chart.figure["data"]
    assert set(np.ravel(trace["text"])) <= {letter for letter, _ in LETTERS.values()}
    assert [line[0] for line in chart.lines] == ["active-set", "penalty", "lagrange-multiplier"]


def test_sections_say_where_ranges_end(small: StabilityStudy) -> None:
    sections = stability_sections(small)
    assert [section.heading for section in sections[1:5]] == [axis.title for axis in small.axes]
    assert any("error below 0.001" in words for words in sections[1].words)
    assert any("predicted" in words for words in sections[1].words)


def test_a_study_that_was_interrupted_goes_on(
    written: tuple[StabilityStudy, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small, _ = written
    calls: list[str] = []
    honest = cells_module.stability_row

    def stopped(axis: str, *arguments: Any) -> StabilityRow:
        calls.append(axis)
        if len(calls) == 10:
            raise KeyboardInterrupt
        return honest(axis, *arguments)

    monkeypatch.setattr(cells_module, "stability_row", stopped)
    axes = small.axes[-1:]
    with pytest.raises(Stopped, match="9 rows found; the same command goes on from there"):
        write_stability(tmp_path, axes, FEW)
    assert [file.name for file in tmp_path.iterdir()] == ["unfinished_stability.jsonl"]
    study, _, _ = write_stability(tmp_path, axes, FEW)
    assert len(calls) == 10 + len(study.rows) - 9
    timeless = [dataclasses.replace(row, seconds=None) for row in study.rows]
    assert timeless == [dataclasses.replace(row, seconds=None) for row in small.rows_of(axes[0])]


def test_cells_of_many_contacts_are_expected_to_take_long() -> None:
    """Of 1e4 contacts a cell takes ten seconds on average, of a few bars 60 ms."""
    costs = {(cell.axis, cell.value): cells_module.runnable(cell).cost for cell in cells(methods=["active-set"])}
    assert costs["contacts", 1e4] > 100
    assert costs["closed-contacts", 1e5] > costs["closed-contacts", 1e4]
    assert {cost for (axis, _), cost in costs.items() if not axis.endswith("contacts")} == {1}


def test_a_cell_whose_process_died_is_a_row() -> None:
    cell = next(iter(cells(methods=["osqp"])))
    row = row_of(cell, Crash("died of a segmentation fault (SIGSEGV)"))
    assert (row.verdict, row.method, row.axis) == (report_rows.CRASHED, "osqp", cell.axis)
    assert "SIGSEGV" in row.message
    others = [StabilityRow(axis=row.axis, value=v, method="osqp", verdict=report_rows.RIGHT) for v in (10.0, 100.0)]
    [found] = safe_ranges(find_axis(row.axis), [row, *others])
    assert f"; crashed at {find_axis(row.axis).label(row.value)} ({row.message})" in found.words


def test_the_page_has_every_axis_and_needs_nothing(small: StabilityStudy, tmp_path: Path) -> None:
    page = page_of(small, tmp_path)
    assert all(axis.title in page for axis in small.axes)
    assert "21.684" in page
    assert page.index("Where each method is right") < page.index('id="axes"')
    assert not re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=[\"']https?:", page)
    assert "must be 0" not in page
    wrong = dataclasses.replace(small, rows=(dataclasses.replace(small.rows[0], verdict=report_rows.WRONG),))
    assert "must be 0" in page_of(wrong, tmp_path)


def test_the_numbers_of_the_pages_best_penalty_are_measured() -> None:
    """docs/stability.md states S, λ, the best β and its error, and what Table 2.1 prints at 1e20."""
    page = " ".join((Path(__file__).parents[3] / "docs" / "stability.md").read_text(encoding="utf-8").split())
    best = best_penalty_of_truss()
    assert f"(S = {best.stiffness:.0f} kN/m, λ = {best.force:.3f} kN, g = 1e-3 m, ulp(g) = 2⁻⁶² m)" in page
    assert (GAP, best.last_place) == (1e-3, 2.0**-62)
    measured = f"that is {best.penalty:.1e} kN/m with an error of {best.error:.1e}"
    assert measured.replace("e+", "e").replace("e-0", "e-") in page
    penetration = best.force / (best.stiffness + 1e20) / best.last_place
    assert f"the exact penetration is {penetration:.1f} times ulp(g)" in page
    assert f"= {math.floor(1e3 * float(best.quantum(1e20))) / 1e3:.3f}... kN" in page


def test_the_page_and_that_of_a_report_name_each_other(small: StabilityStudy, tmp_path: Path) -> None:
    assert "index.html" not in page_of(small, tmp_path)
    (tmp_path / "index.html").touch()
    assert '<a href="index.html">' in page_of(small, tmp_path)
    assert stability_bars(tmp_path) is None
    (tmp_path / "stability.json").write_text(as_json(small), encoding="utf-8")
    found = stability_bars(tmp_path)
    assert found is not None
    assert found.page == ""
    (tmp_path / "stability.html").touch()
    assert getattr(stability_bars(tmp_path), "page", None) == "stability.html"


def test_bars_are_the_safe_ranges(small: StabilityStudy, tmp_path: Path) -> None:
    (tmp_path / "stability.json").write_text(as_json(small), encoding="utf-8")
    found = stability_bars(tmp_path)
    assert found is not None
    assert [title for title, _ in found.axes] == [axis.title for axis in small.axes]
    bars = {method: line for method, line in found.lines}
    assert all(small.ranges(axis) for axis in small.axes)
    for place, axis in enumerate(small.axes):
        for one in small.ranges(axis):
            bar = bars[one.method][place]
            assert bar is not None
            assert bar.words == one.words
            inside = [v for v in axis.values if one.lowest is not None and one.lowest <= v <= (one.highest or 0)]
            assert bar.width == pytest.approx(100 * len(inside) / len(axis.values))
            if inside:
                assert bar.start == pytest.approx(100 * axis.values.index(inside[0]) / len(axis.values))


@pytest.mark.parametrize("text", ["", "{}", '{"axes": [1]}', '{"axes": [{"title": "a"}]}'])
def test_a_study_that_cannot_be_read_has_no_bars(tmp_path: Path, text: str) -> None:
    (tmp_path / "stability.json").write_text(text, encoding="utf-8")
    assert stability_bars(tmp_path) is None


def test_the_command_line_runs_the_study_alone(
    small: StabilityStudy, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(report_module, "write_stability", lambda output, **_: (small, (Path(output),), ("a note",)))
    done = CliRunner().invoke(command, ["report", "--stability", "-o", str(tmp_path / "found")])
    assert done.exit_code == 0
    assert "wrong but passed: 0" in done.output
    assert "contactqp: a note" in done.stderr


def test_words_of_an_axis_have_its_unit(small: StabilityStudy) -> None:
    penalty = next(section for section in stability_sections(small) if section.heading.startswith("Penalty"))
    assert "Values: β, κ [kN/m]." in penalty.words
