"""Error against run time: every answer has its point, in its units, and those without one are counted.

Charts over all cases: they show what the statistics say, and what is missing is shown as missing.
"""

from __future__ import annotations

import importlib.util
import json
import re
from dataclasses import replace
from typing import Any

import pytest

from contactqp.study import rows
from contactqp.study.curves import FLOOR, MARGIN, MARKS, Chart, log_axis, marker
from contactqp.study.report_charts import case_charts, overview_charts
from contactqp.study.report_data import ReportData
from contactqp.study.statistics import overview
from contactqp.study.truth import ABSOLUTE_FORCE
from tests.study.charts_examples import LIMIT, report

needs_plotly = pytest.mark.skipif(importlib.util.find_spec("plotly") is None, reason="plotly is not installed")


def _case_charts(data: ReportData) -> tuple[Chart, ...]:
    return case_charts(data, data.cases[0])


def _case_trace(chart: Chart, method: str, variant: str) -> dict[str, Any]:
    (found,) = (t for t in chart.figure["data"] if t["meta"] == {"method": method, "variant": variant})
    return dict(found)


def test_one_chart_of_displacements_and_one_of_forces() -> None:
    in_u, in_force = _case_charts(report())
    assert "displacements" in in_u.title
    assert "contact forces" in in_force.title
    for chart, factor in ((in_u, 1), (in_force, 10)):
        raw = _case_trace(chart, "osqp", "raw")
        assert raw["x"] == pytest.approx([1.0, 2.0])  # milliseconds
        assert raw["y"] == pytest.approx([factor * 1e-2, factor * 1e-9])


def test_raw_and_polished_condensed_and_whole_can_be_told_apart_without_colour() -> None:
    chart, _ = _case_charts(report())
    ways = [_case_trace(chart, "osqp", variant) for variant in ("final", "raw", "raw, all unknowns")]
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
    final = _case_trace(_case_charts(report())[0], "osqp", "final")
    assert final["y"] == [FLOOR, FLOOR]
    assert final["customdata"][0] == ["tolerance = 1", "0", "0", "right"]
    assert "zero is drawn at 1e-17" in _case_charts(report())[0].caption


def test_answers_that_nobody_should_use_are_marked() -> None:
    assert _case_trace(_case_charts(report())[0], "osqp", "raw")["text"] == [MARKS[rows.REFUSED], ""]
    assert "text" not in _case_trace(_case_charts(report())[0], "osqp", "final")
    data = report("one")
    passed = replace(data, rows=tuple(replace(row, verdict=rows.WRONG) for row in data.rows))
    assert set(_case_trace(_case_charts(passed)[0], "active-set", "final")["text"]) == {MARKS[rows.WRONG]}


def test_the_physical_limit_is_a_labelled_line() -> None:
    chart, _ = _case_charts(report())
    (line,) = (shape for shape in chart.figure["layout"]["shapes"] if shape["type"] == "line")
    assert line["x0"] == line["x1"] == pytest.approx(1e3 * LIMIT)
    assert any("one linear solve: 0.1 ms" in note["text"] for note in chart.figure["layout"]["annotations"])
    low, _ = chart.figure["layout"]["xaxis"]["range"]
    assert 10**low < 1e3 * LIMIT


def test_a_limit_far_from_all_methods_leaves_no_axis_empty() -> None:
    """One linear solve of two unknowns takes 9 microseconds, what is around it 600: two decades were empty."""
    data = report("one")
    chart, _ = _case_charts(replace(data, cases=(replace(data.cases[0], linear_solve=LIMIT / 100),)))
    assert all(shape["type"] != "line" for shape in chart.figure["layout"]["shapes"])
    (label,) = (note for note in chart.figure["layout"]["annotations"] if "one linear solve" in note["text"])
    assert (label["xref"], label["x"], label["text"]) == ("paper", 0, "\u25c2 one linear solve: 0.001 ms")
    low, high = chart.figure["layout"]["xaxis"]["range"]
    assert high - low < 2


def test_without_a_limit_there_is_no_line() -> None:
    data = report("one")
    data = replace(data, cases=(replace(data.cases[0], linear_solve=None),))
    assert all(shape["type"] != "line" for shape in _case_charts(data)[0].figure["layout"]["shapes"])


def test_axes_have_units_also_of_absolute_errors() -> None:
    in_u, in_force = _case_charts(report())
    assert in_u.figure["layout"]["xaxis"]["title"]["text"] == "run time [ms]"
    assert in_u.figure["layout"]["yaxis"]["title"]["text"] == "true error in u, relative, energy norm [1]"
    data = report("one")
    data = replace(data, rows=tuple(replace(row, error_measure=ABSOLUTE_FORCE) for row in data.rows))
    in_u, in_force = _case_charts(data)
    assert in_force.figure["layout"]["yaxis"]["title"]["text"] == "true error in λ, absolute [kN]"
    assert in_u.figure["layout"]["yaxis"]["title"]["text"] == "true error in u, relative, energy norm [1]"


def test_the_caption_counts_answers_without_a_point() -> None:
    chart, _ = _case_charts(report("one"))
    assert "Answers without a point: 1 unsupported." in chart.caption
    assert "Not installed: gurobi." in chart.caption
    points = [t for t in chart.figure["data"] if t["meta"]["method"]]
    assert sum(len(t["x"]) for t in points) == 1 + 2 + 2 + 2 + 1


def test_penalties_have_their_unit() -> None:
    assert _case_trace(_case_charts(report())[0], "penalty", "final")["customdata"][0][0] == "penalty = 100000 kN/mm"


def test_a_case_without_a_truth_has_no_chart() -> None:
    data = report("one")
    unknown = tuple(replace(row, error_displacement=None, error_force=None) for row in data.rows)
    assert _case_charts(replace(data, rows=unknown)) == ()


@needs_plotly
def test_plotly_takes_the_figures_and_they_are_small() -> None:
    from plotly.graph_objects import Figure

    charts = _case_charts(report())
    assert charts
    for chart in charts:
        Figure(dict(chart.figure))
        assert len(json.dumps(chart.figure, allow_nan=False)) < 8000


def test_where_the_truth_is_a_solution_its_own_error_is_said_to_tell_nothing() -> None:
    data = report()
    assert "tells nothing" not in _case_charts(data)[0].caption
    for truth, words in (
        ("active-set, proven to 1e-15 in u and 1e-15 in λ", "The truth is the proven solution of active-set"),
        ("the case's exact values (3 of 4 numbers; the others: active-set, proven to 1e-15 in u)", "Numbers that"),
    ):
        chart, _ = case_charts(data, replace(data.cases[0], truth=truth))
        assert words in chart.caption


def test_symbols_at_the_ends_of_an_axis_are_seen_whole() -> None:
    low, high = log_axis("", [1e-17, 1.0])["range"]
    assert (low, high) == pytest.approx((-17 - MARGIN * 17, MARGIN * 17))


def _charts() -> dict[str, Chart]:
    return {chart.name: chart for chart in overview_charts(report())}


def _trace(chart: Chart, **known: Any) -> dict[str, Any]:
    (found,) = (t for t in chart.figure["data"] if all(t[name] == value for name, value in known.items()))
    return dict(found)


def test_all_of_them_with_captions_units_and_tables() -> None:
    charts = _charts()
    names = ["median-error-u", "median-error-force", "profile", "profile-raw", "mean-times", "rates", "silently-wrong"]
    assert list(charts) == names
    for chart in charts.values():
        assert chart.caption.endswith(".")
        assert chart.lines
        assert all(len(line) == len(chart.headings) for line in chart.lines)
        axes = chart.figure["layout"]["xaxis"], chart.figure["layout"]["yaxis"]
        assert all("[" in axis["title"]["text"] or axis["title"]["text"] == "method" for axis in axes)
        assert all(set(trace["meta"]) == {"method", "variant"} for trace in chart.figure["data"])


def test_claimed_and_right_stand_side_by_side() -> None:
    chart = _charts()["rates"]
    bars = {t["meta"]["variant"]: dict(zip(t["y"], t["customdata"], strict=True)) for t in chart.figure["data"]}
    assert bars["claimed"]["osqp"] == "8 of 8"
    assert bars["right"]["osqp"] == "4 of 8"
    assert bars["certified"]["osqp"] == "4 of 4"
    assert ("gurobi", "not installed", "", "", "", "", "") in chart.lines
    assert "Not installed: gurobi." in chart.caption
    assert "2 cases" in chart.caption
    assert len({t["marker"]["pattern"]["shape"] for t in chart.figure["data"]}) == 3  # not by colour alone


def test_wrong_flags_are_counted_beside_our_own() -> None:
    chart = _charts()["silently-wrong"]
    theirs, ours = chart.figure["data"]
    assert dict(zip(theirs["y"], theirs["x"], strict=True))["osqp"] == 4
    assert set(ours["x"]) == {0}
    assert "4 raw answers" in chart.caption
    assert chart.caption.endswith("certificate: 0.")


def test_where_nothing_is_wrong_a_sentence_says_so_and_no_chart() -> None:
    data = report()
    clean = tuple(replace(row, flag_wrong=False) for row in data.rows)
    chart = next(c for c in overview_charts(replace(data, rows=clean)) if c.name == "silently-wrong")
    assert not chart.figure
    assert chart.caption.startswith("None: of 8 raw answers that their methods called solved, none has an error above")


def test_a_wrong_answer_that_passes_is_not_hidden() -> None:
    data = report()
    spoiled = (replace(data.rows[0], verdict=rows.WRONG), *data.rows[1:])
    chart = next(c for c in overview_charts(replace(data, rows=spoiled)) if c.name == "silently-wrong")
    assert chart.caption.endswith("certificate: 1.")
    assert sum(chart.figure["data"][1]["x"]) == 1


def test_profiles_end_below_all_for_a_method_that_fails() -> None:
    chart = _charts()["profile"]
    ours, osqp = _trace(chart, name="active-set"), _trace(chart, name="osqp")
    assert osqp["y"][0] == ours["y"][-1] == 100.0  # polished osqp takes 1 ms, the active set 2 ms
    assert ours["y"][0] == 0.0
    assert ours["x"][1] == pytest.approx(2.0)
    assert not any(t["name"] == "gurobi" for t in chart.figure["data"])
    lemke = _trace(_charts()["profile-raw"], name="lemke")
    assert set(lemke["y"]) == {0.0}
    assert ("lemke, raw", "0", "0", "0", "0", "0", "2") in _charts()["profile-raw"].lines


def test_by_themselves_means_raw_and_on_all_unknowns() -> None:
    variants = {t["name"]: t["meta"]["variant"] for t in _charts()["profile-raw"].figure["data"]}
    assert variants == {"active-set": "final", "osqp": "raw, all unknowns", "lemke": "raw", "penalty": "final"}


def test_means_are_those_of_the_statistics() -> None:
    found = overview(report().rows)
    chart = _charts()["mean-times"]
    assert found.times
    for times, mean in zip(found.times, found.means, strict=True):
        assert _trace(chart, name=str(times.route))["x"] == pytest.approx([1e3 * mean], rel=1e-3)
    assert chart.figure["layout"]["yaxis"]["categoryarray"][-1] == "osqp"  # the fastest is on top


def test_ways_can_be_told_apart_without_lines() -> None:
    looks = [marker("", "circle", variant, whole) for variant in ("", "raw", "uzawa") for whole in (False, True)]
    assert len({(look["symbol"], look["size"]) for look in looks}) == 6


def test_captions_say_what_is_good() -> None:
    assert len(_charts()) > 1
    for name, chart in _charts().items():
        if name != "silently-wrong":  # whose second bar must be 0
            assert re.search(r"further left is (faster|better)|best at 100 %", chart.caption, re.IGNORECASE), name


def test_without_a_case_for_all_only_the_flags_are_left() -> None:
    data = report("one")
    few = tuple(row for row in data.rows if row.method != "osqp") + tuple(report("two").rows[1:3])
    assert [chart.name for chart in overview_charts(replace(data, rows=few))] == ["silently-wrong"]


@pytest.mark.skipif(importlib.util.find_spec("plotly") is None, reason="plotly is not installed")
def test_plotly_takes_the_figures() -> None:
    from plotly.graph_objects import Figure

    charts = _charts().values()
    assert charts
    for chart in charts:
        Figure(dict(chart.figure))  # it refuses what it does not know
        json.dumps(chart.figure, allow_nan=False)
