"""Error against run time: every answer has its point, in its units, and those without one are counted."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from typing import Any

import pytest

from contactqp.study import rows
from contactqp.study.charts.comparison import case_charts
from contactqp.study.charts.curves import FLOOR, MARGIN, MARKS, Chart, log_axis
from contactqp.study.report.report_data import ReportData
from contactqp.study.truth import ABSOLUTE_FORCE
from tests.study.charts.examples import LIMIT, report

needs_plotly = pytest.mark.skipif(importlib.util.find_spec("plotly") is None, reason="plotly is not installed")


def _charts(data: ReportData) -> tuple[Chart, ...]:
    return case_charts(data, data.cases[0])


def _trace(chart: Chart, method: str, variant: str) -> dict[str, Any]:
    (found,) = (t for t in chart.figure["data"] if t["meta"] == {"method": method, "variant": variant})
    return dict(found)


def test_one_chart_of_displacements_and_one_of_forces() -> None:
    in_u, in_force = _charts(report())
    assert "displacements" in in_u.title
    assert "contact forces" in in_force.title
    for chart, factor in ((in_u, 1), (in_force, 10)):
        raw = _trace(chart, "osqp", "raw")
        assert raw["x"] == pytest.approx([1.0, 2.0])  # milliseconds
        assert raw["y"] == pytest.approx([factor * 1e-2, factor * 1e-9])


def test_raw_and_polished_condensed_and_whole_can_be_told_apart_without_colour() -> None:
    chart, _ = _charts(report())
    ways = [_trace(chart, "osqp", variant) for variant in ("final", "raw", "raw, all unknowns")]
    looks = {(t["line"]["dash"], t["line"]["width"], t["marker"]["symbol"], t["marker"]["size"]) for t in ways}
    assert len(looks) == 3
    assert [t["showlegend"] for t in ways] == [True, False, False]  # a method is in the legend once
    keys = [t["name"] for t in chart.figure["data"] if not t["meta"]["method"]]
    assert keys == [
        "final answer, polished where the method is",
        "the method's raw answer",
        "raw answer, on all unknowns",
        f"{MARKS[rows.REFUSED]} refused: the certificate does not pass",
    ]


def test_zero_is_drawn_at_the_floor_and_hover_says_zero() -> None:
    final = _trace(_charts(report())[0], "osqp", "final")
    assert final["y"] == [FLOOR, FLOOR]
    assert final["customdata"][0] == ["tolerance = 1", "0", "0", "right"]
    notes = [note["text"] for note in _charts(report())[0].figure["layout"]["annotations"]]
    assert any("zero is drawn at 1e-17" in note for note in notes)


def test_answers_that_nobody_should_use_are_marked() -> None:
    assert _trace(_charts(report())[0], "osqp", "raw")["text"] == [MARKS[rows.REFUSED], ""]
    assert "text" not in _trace(_charts(report())[0], "osqp", "final")
    data = report("one")
    passed = replace(data, rows=tuple(replace(row, verdict=rows.WRONG) for row in data.rows))
    assert set(_trace(_charts(passed)[0], "active-set", "final")["text"]) == {MARKS[rows.WRONG]}


def test_the_physical_limit_is_a_labelled_line() -> None:
    chart, _ = _charts(report())
    (line,) = (shape for shape in chart.figure["layout"]["shapes"] if shape["type"] == "line")
    assert line["x0"] == line["x1"] == pytest.approx(1e3 * LIMIT)
    assert any("one linear solve: 0.1 ms" in note["text"] for note in chart.figure["layout"]["annotations"])
    low, _ = chart.figure["layout"]["xaxis"]["range"]
    assert 10**low < 1e3 * LIMIT


def test_without_a_limit_there_is_no_line() -> None:
    data = report("one")
    data = replace(data, cases=(replace(data.cases[0], linear_solve=None),))
    assert all(shape["type"] != "line" for shape in _charts(data)[0].figure["layout"]["shapes"])


def test_axes_have_units_also_of_absolute_errors() -> None:
    in_u, in_force = _charts(report())
    assert in_u.figure["layout"]["xaxis"]["title"]["text"] == "run time [ms]"
    assert in_u.figure["layout"]["yaxis"]["title"]["text"] == "true error in u, relative, energy norm [1]"
    data = report("one")
    data = replace(data, rows=tuple(replace(row, error_measure=ABSOLUTE_FORCE) for row in data.rows))
    in_u, in_force = _charts(data)
    assert in_force.figure["layout"]["yaxis"]["title"]["text"] == "true error in λ, absolute [kN]"
    assert in_u.figure["layout"]["yaxis"]["title"]["text"] == "true error in u, relative, energy norm [1]"


def test_the_caption_counts_answers_without_a_point() -> None:
    chart, _ = _charts(report("one"))
    assert "Answers without a point: 1 unsupported." in chart.caption
    assert "Not installed: gurobi." in chart.caption
    points = [t for t in chart.figure["data"] if t["meta"]["method"]]
    assert sum(len(t["x"]) for t in points) == 1 + 2 + 2 + 2 + 1


def test_penalties_have_their_unit() -> None:
    assert _trace(_charts(report())[0], "penalty", "final")["customdata"][0][0] == "penalty = 100000 kN/mm"


def test_a_case_without_a_truth_has_no_chart() -> None:
    data = report("one")
    unknown = tuple(replace(row, error_displacement=None, error_force=None) for row in data.rows)
    assert _charts(replace(data, rows=unknown)) == ()


@needs_plotly
def test_plotly_takes_the_figures_and_they_are_small() -> None:
    from plotly.graph_objects import Figure

    for chart in _charts(report()):
        Figure(dict(chart.figure))
        assert len(json.dumps(chart.figure, allow_nan=False)) < 8000


def test_where_the_truth_is_a_solution_its_own_error_is_said_to_tell_nothing() -> None:
    data = report()
    assert "tells nothing" not in _charts(data)[0].caption
    for truth, words in (
        ("active-set, proven to 1e-15 in u and 1e-15 in λ", "The truth is the proven solution of active-set"),
        ("the case's exact values (3 of 4 numbers; the others: active-set, proven to 1e-15 in u)", "Numbers that"),
    ):
        chart, _ = case_charts(data, replace(data.cases[0], truth=truth))
        assert words in chart.caption


def test_symbols_at_the_ends_of_an_axis_are_seen_whole() -> None:
    low, high = log_axis("", [1e-17, 1.0])["range"]
    assert (low, high) == pytest.approx((-17 - MARGIN * 17, MARGIN * 17))
