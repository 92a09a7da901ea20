"""How fast methods are over many cases: performance profiles and mean run times."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from contactqp.study.charts.curves import marker, variant_name, way_key
from contactqp.study.charts.layout import METHOD, layout, legend, log_axis, meta, method_line, on_cases
from contactqp.study.charts.numbers import milliseconds, rounded
from contactqp.study.charts.style import method_style
from contactqp.study.report.chart import Chart
from contactqp.study.statistics.means import LIMIT, SHIFT
from contactqp.study.statistics.overview import Overview
from contactqp.study.statistics.profiles import profile, ratios
from contactqp.study.statistics.routes import Route, RouteTimes

SOLVED = "Solved means a true error of at most 1e-6 (and what rounding the answer adds), whatever flags say."
PROFILE_HEIGHT = 620
POINT_HEIGHT, AROUND = 26, 170  # pixels for each method of a chart of means, and for axis and legend
FACTORS = (1.0, 2.0, 10.0)  # of the fastest time, in the tables


def profile_charts(found: Overview) -> Iterator[Chart]:
    """As solve runs the methods, and as they are by themselves."""
    usual = [times for times in found.times if not times.route.variant and not times.route.whole]
    yield _profile(
        "profile",
        "Performance profile: as solve runs the methods",
        "Condensed onto the contact unknowns, and polished where the method is.",
        usual,
    )
    yield _profile(
        "profile-raw",
        "Performance profile: the methods by themselves",
        "Raw answers on all unknowns, as the methods give them by themselves; the active set works on the contact "
        "unknowns by itself.",
        list(_by_themselves(found.times)),
    )


def _by_themselves(all_times: Sequence[RouteTimes]) -> Iterator[RouteTimes]:
    """One route for each method: before polish where it is polished, on all unknowns where there is a choice."""
    by_route = {times.route: times for times in all_times}
    for name in dict.fromkeys(route.method for route in by_route):
        ways = (Route(name, variant, whole) for variant in ("raw", "") for whole in (True, False))
        yield next(by_route[way] for way in ways if way in by_route)


def _profile(name: str, title: str, about: str, shown: Sequence[RouteTimes]) -> Chart:
    compared = ratios({times.route: times.seconds for times in shown})
    finite = np.concatenate([values[np.isfinite(values)] for values in compared.values()])
    last = 1.5 * float(np.max(finite, initial=2.0))
    data = [_steps(times, compared[times.route], last) for times in shown]
    cases = shown[0].cases
    axis = log_axis("run time, as a multiple of the fastest method's on the same case [1]", [1.0, last])
    return Chart(
        name=name,
        title=title,
        caption=f"{on_cases(cases)} {about} Each curve tells on which part of the cases a method was right within a "
        "multiple of the fastest right answer (Dolan and Moré 2002): at 1 on the left where it was the fastest, on the "
        f"right where it was right at all, by its best knob. Higher and further left is better. "
        f"{SOLVED} What failed or is unsupported never counts as "
        "right, and is never dropped.",
        figure=dict(
            data=data,
            layout=layout(
                axis | dict(range=[0.0, rounded(math.log10(last))]),
                dict(title=dict(text="part of the cases that are solved [%]"), range=[0, 103]),
                PROFILE_HEIGHT,
                legend=legend("Methods"),
            ),
        ),
        headings=("method", *(f"within {factor:g} times [%]" for factor in FACTORS), "solved", "failed", "unsupported"),
        lines=tuple(
            (
                str(times.route),
                *(f"{100 * part:.0f}" for part in profile(compared[times.route], np.array(FACTORS))),
                *map(str, (times.solved, times.failed, times.unsupported)),
            )
            for times in shown
        ),
    )


def _steps(times: RouteTimes, compared: np.ndarray, last: float) -> dict[str, Any]:
    """The profile as steps, its symbol where it rises."""
    factors = np.unique(np.concatenate([[1.0], compared[np.isfinite(compared)], [last]]))
    parts = 100 * profile(compared, factors)
    name = times.route.method
    told = f"<b>{name}</b><br>right on %{{y}} % of {len(compared)} cases within %{{x}} times the fastest<extra></extra>"
    xs, ys = [rounded(x) for x in factors], [rounded(float(y)) for y in parts]
    drawn = method_line(name, xs, ys, variant_name(times.route), hovertemplate=told, mode="lines+markers")
    drawn["line"] |= dict(shape="hv")
    return drawn


def means_chart(found: Overview) -> Chart:
    """Shifted geometric means of every way of every method, the fastest method on top."""
    order = _order(found)
    shown = list(zip(found.times, found.means, strict=True))
    data = [_mean_point(times, mean) for times, mean in shown]
    ways = dict.fromkeys((times.route.variant, times.route.whole) for times, _ in shown)
    keyed = [way_key(*way) for way in ways]
    methods = dict(type="category", categoryorder="array", categoryarray=order[::-1], automargin=True)
    axis = log_axis("shifted geometric mean of the run times [ms]", [1e3 * mean for _, mean in shown])
    return Chart(
        name="mean-times",
        title="Mean run times, failures included",
        caption=f"{on_cases(found.cases)} The shifted geometric mean over these cases of the run time to the fastest "
        f"right answer: {1e3 * SHIFT:g} ms are added to each time and taken off the mean, so that tiny cases do not "
        f"decide. Further left is better; methods are in the order of their best "
        f"mean. {SOLVED} A case without a right answer counts as {LIMIT:g} s, and there the clock stops for answers "
        "that take longer.",
        figure=dict(
            data=data + keyed,
            layout=layout(
                axis,
                methods | dict(title=METHOD),
                POINT_HEIGHT * len(order) + AROUND,
                legend=legend("", y=1.0, yanchor="bottom"),
            ),
        ),
        headings=("method and way", "shifted geometric mean [ms]", "solved", "failed", "unsupported", "cases"),
        lines=tuple(
            (str(t.route), milliseconds(mean), str(t.solved), str(t.failed), str(t.unsupported), str(len(t.cases)))
            for t, mean in shown
        ),
    )


def _order(found: Overview) -> list[str]:
    """Methods by their best mean."""
    best: dict[str, float] = {}
    for times, mean in zip(found.times, found.means, strict=True):
        best[times.route.method] = min(mean, best.get(times.route.method, math.inf))
    return sorted(best, key=lambda name: best[name])


def _mean_point(times: RouteTimes, mean: float) -> dict[str, Any]:
    route, style = times.route, method_style(times.route.method)
    solved = f"{times.solved} of {len(times.cases)} solved"
    return dict(
        type="scatter",
        mode="markers",
        name=str(route),
        x=[rounded(1e3 * mean)],
        y=[route.method],
        marker=marker(style.colour, style.symbol, route.variant, route.whole),
        hovertemplate=f"<b>{route.method}</b>, {variant_name(route)}<br>%{{x}} ms<br>{solved}<extra></extra>",
        showlegend=False,
        meta=meta(route.method, variant_name(route)),
    )
