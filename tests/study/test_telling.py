"""The brief report: its cases, its settings, its first chart, and the page that is there while it runs."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import replace
from math import log10
from pathlib import Path
from typing import Any

import pytest

from contactqp.errors import SceneError
from contactqp.scene.scene import load_scene
from contactqp.study import collecting, report_data, telling
from contactqp.study import reporting as report
from contactqp.study.answer_pictures import AnswerPictures
from contactqp.study.case_study import load_studies
from contactqp.study.conclusion import busy
from contactqp.study.curves import STYLES, Chart
from contactqp.study.footprint import Footprint
from contactqp.study.report_data import Sizes
from contactqp.study.running.runner import Running, Stopped
from contactqp.study.settings import DEFAULT_TOLERANCE, brief_settings, chosen_methods
from contactqp.study.telling import AREA, LABEL, LETTER, Box, examples_chart, left_out_lines, telling_chart
from tests.study.charts_examples import report as charted
from tests.study.statistics_examples import right, wrong

CASES = Path(__file__).parents[2] / "cases"
needs_page = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("plotly", "jinja2", "latex2mathml")), reason="no page"
)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    return telling.telling_cases(tmp_path_factory.mktemp("report"))


@pytest.mark.slow
def test_hertz_comes_at_three_sizes(files: tuple[Path, ...]) -> None:
    sizes = [load_scene(file).problem().dimension for file in files[-3:]]
    assert sizes == pytest.approx(list(telling.HERTZ), rel=0.06)
    assert [file.stem for file in files[:-3]] == list(telling.EXAMPLES)
    assert not list(files[-1].parent.glob("*.unfinished"))


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"hertz_1000\.toml: cannot be written: No such file"):
        telling.telling_cases(tmp_path / "nowhere")


def test_final_answers_come_once_and_knobs_are_swept(files: tuple[Path, ...]) -> None:
    (small,) = load_studies(files[:1], chosen_methods(None), brief=True)
    for name, count in (("active-set", 1), ("osqp", 4), ("clarabel", 4), ("penalty", 6), ("augmented-lagrangian", 6)):
        mine = [setting for setting in small.settings if setting.method.name == name]
        assert len(mine) == count
        assert not any(setting.whole for setting in mine)
    polished = [s for s in small.settings if s.variant == "polished" and s.knob == "tolerance"]
    assert polished
    assert {s.value for s in polished} == {DEFAULT_TOLERANCE}


@pytest.mark.slow
def test_of_a_large_body_final_answers_alone(files: tuple[Path, ...]) -> None:
    problem = load_scene(files[-1]).problem()
    counts = {method.name: len(list(brief_settings(problem, method))) for method in chosen_methods(None)}
    assert counts["osqp"] == counts["active-set"] == counts["augmented-lagrangian"] == 1
    assert counts["penalty"] == counts["perturbed-lagrangian"] == 3


def test_the_first_chart_drops_no_method_that_has_points() -> None:
    data = charted()
    chart = telling_chart(data)
    assert chart is not None
    name = next(case.name for case in data.cases if case.title in chart.title)
    drawn = {trace["meta"]["method"] for trace in chart.figure["data"]}
    points = {r.method for r in data.rows_of(name) if r.error_force is not None and r.seconds is not None}
    assert drawn == points
    assert len(points) > 1


def test_the_first_chart_is_of_the_largest_case_that_tells_all() -> None:
    data = charted()
    (case, *_) = data.cases
    rows = [row for row in data.rows_of(case.name) if row.error_force is not None and row.seconds is not None]
    large = replace(case, name="large", title="Large", sizes=replace(case.sizes, unknowns=9999))
    few = replace(large, name="few", title="Few", sizes=replace(case.sizes, unknowns=99999))
    more = [*data.rows, *(replace(row, case="large") for row in rows), replace(rows[0], case="few")]
    chart = telling_chart(replace(data, cases=(*data.cases, large, few), rows=tuple(more)))
    assert chart is not None
    assert chart.title.startswith("Large")


def test_the_second_chart_is_of_the_small_cases_and_drops_no_method() -> None:
    data = charted()
    data = replace(data, rows=tuple(replace(row, unknowns=3) for row in data.rows))
    chart = examples_chart(data)
    assert chart is not None
    drawn = {trace["meta"]["method"] for trace in chart.figure["data"]} - {""}
    points = {row.method for row in data.rows if row.error_force is not None and row.seconds is not None}
    assert drawn == points
    large = replace(data, rows=tuple(replace(row, unknowns=9999) for row in data.rows))
    assert examples_chart(large) is None


def test_what_condensation_saves_is_that_of_the_same_answers() -> None:
    """OSQP takes 4 and 9 times as long on all unknowns, which Clarabel is wrong on, and DAQP was not tried on."""
    body = dict(unknowns=1000, contacts=10, knob="tolerance", knob_value=1e-9)
    rows = [
        right("body", "osqp", 1.0, condensed="yes", variant="polished", **body),
        right("body", "osqp", 4.0, condensed="no", variant="polished", **body),
        right("body", "scs", 1.0, condensed="yes", variant="polished", **body),
        right("body", "scs", 9.0, condensed="no", variant="polished", **body),
        right("body", "clarabel", 1.0, condensed="yes", variant="polished", **body),
        wrong("body", "clarabel", 1.0, condensed="no", variant="polished", **body),
        right("body", "daqp", 1.0, condensed="yes", variant="polished", **body),
    ]
    case = replace(charted().cases[0], sizes=Sizes(1000, 10, 0, 0, 7000))
    condensed, saved = left_out_lines(case, rows, {"body": "A body"})
    assert "its 1000 unknowns are condensed onto those of 10 contacts" in condensed
    assert saved == "A body: on all 1000 unknowns the same answers take 6 times as long (geometric mean of osqp, scs)."
    assert [text for text in left_out_lines(replace(case, sizes=Sizes(3, 3, 0, 0, 7)), rows[:1], {})] == []


def _crowd() -> tuple[Chart, list[str]]:
    """The first chart of all methods, whose final answers take about as long and are all exact."""
    data = charted()
    (case, *_) = data.cases
    names = [name for name in STYLES if name not in ("pyqpmad", "sip", "qtqp", "gurobi")]
    rows = []
    for i, name in enumerate(names):
        rows.append(right(case.name, name, 0.15 * 1.06**i, error_force=0.0, variant="polished"))
        for j, error in enumerate((1e-3, 1e-5, 1e-9)):
            rows.append(right(case.name, name, 0.1 * 1.04 ** (i + 3 * j), error_force=error * 1.7**i, variant="raw"))
    chart = telling_chart(replace(data, cases=(replace(case, linear_solve=0.07),), rows=tuple(rows)))
    assert chart is not None
    return chart, names


def _boxes(chart: Chart) -> tuple[list[tuple[str, Box]], list[Box]]:
    """Where the names of a first chart and its marks are [px]."""
    layout = chart.figure["layout"]
    (left, right), (low, high) = layout["xaxis"]["range"], layout["yaxis"]["range"]

    def pixel(x: float, y: float) -> tuple[float, float]:
        return AREA[0] * (x - left) / (right - left), AREA[1] * (y - low) / (high - low)

    names = []
    for note in layout["annotations"]:
        if note.get("name") != LABEL:
            continue
        x, y = pixel(note["x"], note["y"])
        x, y = (x + note["ax"], y - note["ay"]) if note["showarrow"] else (x + note["xshift"], y + note["yshift"])
        width, height = LETTER[0] * len(note["text"]), LETTER[1]
        names.append((note["text"], (x - width / 2, y - height / 2, x + width / 2, y + height / 2)))
    marks = []
    for trace in chart.figure["data"]:
        for x, y in zip(trace["x"], trace["y"], strict=True) if "markers" in trace["mode"] else ():
            x, y = pixel(log10(x), log10(y))
            marks.append((x - 4.5, y - 4.5, x + 4.5, y + 4.5))
    return names, marks


@pytest.mark.parametrize("crowded", [False, True])
def test_every_name_in_the_first_chart_stands_free_of_marks_and_names(crowded: bool) -> None:
    chart, methods = _crowd() if crowded else (telling_chart(charted()), ["active-set", "osqp", "penalty"])
    assert chart is not None
    names, marks = _boxes(chart)
    assert {name for name, _ in names} == set(methods)
    assert not chart.figure["layout"]["showlegend"]
    assert len(marks) == sum(len(trace["x"]) for trace in chart.figure["data"] if "markers" in trace["mode"])
    for i, (_, box) in enumerate(names):
        assert min(box[:2]) > -2
        assert box[2] < AREA[0] + 2
        assert box[3] < AREA[1] + 2
        for other in [*marks, *(earlier for _, earlier in names[:i])]:
            assert not (
                min(box[2], other[2]) - max(box[0], other[0]) > 1 and min(box[3], other[3]) - max(box[1], other[1]) > 1
            )


def test_exact_answers_stand_apart_and_beside_their_names() -> None:
    """Seventeen marks within a factor of three of time, all with an error of zero, lay over each other at 1e-17."""
    chart, methods = _crowd()
    layout = chart.figure["layout"]
    (band,) = (shape for shape in layout["shapes"] if shape["type"] == "rect")
    exact = {
        trace["meta"]["method"]: (x, y)
        for trace in chart.figure["data"]
        for x, y in zip(trace["x"], trace["y"], strict=True)
        if "markers" in trace["mode"] and y < band["y1"]
    }
    assert set(exact) == set(methods)
    assert layout["yaxis"]["range"][0] == pytest.approx(log10(band["y0"]))
    _, marks = _boxes(chart)
    for i, one in enumerate(marks):
        for other in marks[:i]:
            inside = max(one[3], other[3]) < AREA[1] * (log10(band["y1"]) - layout["yaxis"]["range"][0]) / (
                layout["yaxis"]["range"][1] - layout["yaxis"]["range"][0]
            )
            apart = min(one[2], other[2]) < max(one[0], other[0]) or min(one[3], other[3]) < max(one[1], other[1])
            assert apart or not inside
    assert "heights say nothing" in chart.caption


def test_where_names_find_no_room_the_chart_has_a_legend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(telling, "AREA", (60.0, 40.0))
    chart, methods = _crowd()
    assert len([note for note in chart.figure["layout"]["annotations"] if note.get("name") == LABEL]) < len(methods)
    assert chart.figure["layout"]["showlegend"]


def test_the_axes_of_the_first_chart_end_close_to_what_they_show() -> None:
    chart, _ = _crowd()
    layout = chart.figure["layout"]
    times = [log10(70.0), *(log10(x) for trace in chart.figure["data"] for x in trace["x"])]
    (left, right) = layout["xaxis"]["range"]
    assert right - left < 1.15 * (max(times) - min(times))
    assert left < min(times) < max(times) < right


def test_a_busy_machine_is_told() -> None:
    assert busy(0.0) == ""
    assert busy(None) == ""
    assert busy(1000.0).startswith("the machine was busy (a load of 1000.0 on ")


class _Pages:
    """Takes the place of the page, and keeps what was told."""

    def __init__(self) -> None:
        self.running: list[str] = []
        self.rows: list[int] = []

    def __call__(self, data: report_data.ReportData, *_: object, running: str = "", **__: object) -> str:
        self.running.append(running)
        self.rows.append(len(data.rows))
        return f"<p>{running}</p>"


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch) -> _Pages:
    found = _Pages()
    monkeypatch.setattr(report, "render", found)
    monkeypatch.setattr(report, "missing_packages", lambda: "")
    for name in ("overview_charts", "case_charts"):
        monkeypatch.setattr(report, name, lambda *_: ())
    monkeypatch.setattr(report, "EVERY", 0.0)
    monkeypatch.setattr(report, "SHARE", 0.0)
    monkeypatch.setattr(report_data, "answer_pictures", lambda _: AnswerPictures(why_not="no pictures"))
    monkeypatch.setattr(collecting, "measure", lambda case, **_: Footprint(case, "active-set", failure="not measured"))
    return found


def _write(folder: Path, **options: Any) -> report.ReportResult:
    cases = [CASES / "bar_wall.toml"]
    methods = ["active-set", "daqp", "penalty"]
    return report.write_report(cases, folder, methods=methods, running=Running(jobs=0), brief=True, **options)


@pytest.mark.slow
def test_the_page_is_there_from_the_beginning_and_grows(pages: _Pages, tmp_path: Path) -> None:
    result = _write(tmp_path)
    assert pages.running[0] == "it has begun"
    assert pages.rows[0] == 0
    assert pages.rows == sorted(pages.rows)
    assert pages.rows[-1] == len(result.rows) > 8
    assert pages.running[-1] == ""
    parts = dict.fromkeys(text.partition(":")[0] for text in pages.running[1:-1])
    assert list(parts) == ["truths", "answers", "footprints", "times"]
    assert (tmp_path / "index.html").read_text() == "<p></p>"


@pytest.mark.slow
def test_a_report_that_is_stopped_leaves_a_page_and_goes_on(
    pages: _Pages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:

        def stop(*_: object) -> None:
            raise KeyboardInterrupt

        patched.setattr(collecting, "take_time", stop)
        with pytest.raises(Stopped):
            _write(tmp_path)
    assert re.search(r"<p>(answers|footprints|times): \d+ of \d+", (tmp_path / "index.html").read_text())
    assert not (tmp_path / "results.json").exists()
    result = _write(tmp_path)
    assert any("were kept from a report that was interrupted" in note for note in result.notes)
    assert pages.running[-1] == ""


@needs_page
def test_an_unfinished_page_says_so_and_a_finished_one_does_not() -> None:
    from contactqp.study.page.render import render

    data = charted()
    facts = dict(data.facts) | dict(command="contactqp report", load=dict(at_start=1000.0))
    running = render(replace(data, facts=facts), running="times: 3 of 9")
    assert "<strong>Still running:</strong> times: 3 of 9" in running
    assert "run times are not to be trusted" in running
    finished = render(replace(data, facts=facts | dict(load=dict(at_start=0.0))), opened="two")
    assert re.findall(r'<details class="case" id="case-(\w+)"[^>]* open', finished) == ["two"]
    assert re.findall(r'<details class="case" id="case-(\w+)"[^>]* open', running) == ["one"]
    assert "Still running" not in finished
    assert "run times are not to be trusted" not in finished
