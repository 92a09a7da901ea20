"""Charts over all cases: they show what the statistics say, and what is missing is shown as missing."""

from __future__ import annotations

import importlib.util
import json
import re
from dataclasses import replace
from typing import Any

import pytest

from contactqp.study import rows
from contactqp.study.charts.comparison import overview_charts
from contactqp.study.charts.curves import Chart, marker
from contactqp.study.statistics import overview
from tests.study.charts.examples import report


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
    for times, mean in zip(found.times, found.means, strict=True):
        assert _trace(chart, name=str(times.route))["x"] == pytest.approx([1e3 * mean], rel=1e-3)
    assert chart.figure["layout"]["yaxis"]["categoryarray"][-1] == "osqp"  # the fastest is on top


def test_ways_can_be_told_apart_without_lines() -> None:
    looks = [marker("", "circle", variant, whole) for variant in ("", "raw", "uzawa") for whole in (False, True)]
    assert len({(look["symbol"], look["size"]) for look in looks}) == 6


def test_captions_say_what_is_good() -> None:
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

    for chart in _charts().values():
        Figure(dict(chart.figure))
        json.dumps(chart.figure, allow_nan=False)
