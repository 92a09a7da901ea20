"""Charts of a report: error against run time, case by case, and methods compared over all cases."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactqp.errors import counted
from contactqp.study import rows, statistics
from contactqp.study.curves import (
    BLUE,
    FLOOR,
    GREEN,
    GREY,
    METHOD,
    ORANGE,
    TABLE,
    TEMPLATE,
    VERMILION,
    Chart,
    cells,
    curves,
    error_text,
    key_traces,
    layout,
    legend,
    log_axis,
    marker,
    meta,
    method_line,
    method_style,
    on_cases,
    percent,
    rounded,
    route_key,
    traces,
    variant_name,
    vertical_line,
)
from contactqp.study.report_data import CaseRecord, ReportData
from contactqp.study.rows import UNIT_ROUNDOFF, Row, milliseconds
from contactqp.study.truth import ABSOLUTE_ENERGY, ABSOLUTE_FORCE

TIME_AXIS = "run time [ms]"
HEIGHT = 620


@dataclass(frozen=True)
class Quantity:
    """A part of the answer whose errors are drawn."""

    column: str  # of the rows
    name: str
    title: str
    measure: str  # of the relative error
    absolute: str  # part of `Row.error_measure` where it is not relative


QUANTITIES = (
    Quantity("error_displacement", "u", "error in the displacements", "relative, energy norm", ABSOLUTE_ENERGY),
    Quantity("error_force", "λ", "error in the contact forces", "relative, largest contact", ABSOLUTE_FORCE),
)


def case_charts(data: ReportData, case: CaseRecord) -> tuple[Chart, ...]:
    """Return the charts of error in u and in λ against run time; none where nothing could be measured.

    They have no tables: their numbers are the case's rows, which a page shows once.
    """
    mine = data.rows_of(case.name)
    charts = (case_chart(mine, case, quantity) for quantity in QUANTITIES)
    return tuple(chart for chart in charts if chart is not None)


def case_chart(mine: Sequence[Row], case: CaseRecord, quantity: Quantity) -> Chart | None:
    """Return the chart of one quantity of a case against run time; None where nothing could be measured."""
    length, force = case.length or "length", case.force or "force"
    units = {"u": f"√({force}·{length})", "λ": force}
    absolute = any(quantity.absolute in row.error_measure for row in mine)
    unit = f"absolute [{units[quantity.name]}]" if absolute else f"{quantity.measure} [1]"
    figure = work_precision(mine, quantity, unit, f"{force}/{length}", case.linear_solve)
    if figure is None:
        return None
    sentences = _CAPTION, _limit_text(case.linear_solve), _truth_text(case), _without_points(mine, quantity)
    return Chart(
        name=f"{case.name}-error-{'u' if quantity.name == 'u' else 'force'}",
        title=f"{case.title}: {quantity.title} against run time",
        caption=" ".join(filter(None, sentences)),
        figure=figure,
    )


# How errors near zero are drawn.
_READING = (
    "Lower is more exact, further left is faster. Errors in the grey band are rounding in double precision; zero is "
    f"drawn at {FLOOR:g}."
)
_CAPTION = (
    f"{_READING} Each curve is one method over the values of its knob (tolerance, "
    "penalty, iterations); where longer times are not more exact, a line joins the points that no faster one excels. "
    "Run times are those to the answer, without its certificate. "
    "All numbers stand in the table of the case's answers."
)


def _limit_text(seconds: float | None) -> str:
    if seconds is None:
        return ""
    return (
        f"One linear solve of the same bodies without contact takes {milliseconds(seconds)} ms: no contact solver that "
        "factorises the stiffness can be faster."
    )


def _truth_text(case: CaseRecord) -> str:
    """Return a note on what a method's error does not tell where its own solution is the truth."""
    found = re.search(r"([\w-]+), proven to", case.truth)
    if found is None:
        return ""
    which = "The truth is" if found.start() == 0 else "Numbers that the case does not state are those of"
    return f"{which} the proven solution of {found[1]} itself, whose own error there is zero and tells nothing."


def work_precision(
    drawn_rows: Sequence[Row], quantity: Quantity, unit: str, stiffness: str, limit: float | None
) -> Mapping[str, Any] | None:
    """Return the figure of errors against run time, or None if no row has a time and an error.

    Parameters
    ----------
    drawn_rows : sequence of Row, the rows of one case, or medians
    quantity : the part of the answer whose errors are drawn
    unit : unit of the error, and what it is relative to
    stiffness : unit of penalties
    limit : time of one linear solve [s]
    """
    drawn = curves(drawn_rows, quantity.column)
    if not drawn:
        return None
    points = [row for curve in drawn for row in curve.points]
    times = [1e3 * (row.seconds or 0.0) for row in points]
    shape, label = _limit_line(limit, min(times)) if limit else ({}, {})
    times += [1e3 * limit] if limit and shape else []
    errors = [FLOOR, 1.0, *(getattr(row, quantity.column) for row in points)]
    arranged = layout(
        log_axis(TIME_AXIS, times),
        log_axis(f"true error in {quantity.name}, {unit}", errors),
        HEIGHT,
        template=TEMPLATE,
        shapes=[*_rounding(unit), *([shape] if shape else [])],
        annotations=[label] if label else [],
        legend=legend("Methods"),
        legend2=legend("Lines and marks", y=1.02, yanchor="bottom", itemclick=False, itemdoubleclick=False),
    )
    return dict(data=traces(drawn, quantity.column, stiffness) + key_traces(drawn), layout=arranged)


# A linear solve that many times faster than any method would leave most of the axis empty.
FAR_LEFT = 15.0


def _limit_line(limit: float, fastest: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the line of one linear solve [s] and its label; a label at the border where the line is far left of it.

    Parameters
    ----------
    limit : time of one linear solve [s]
    fastest : the least time in the chart [ms]
    """
    text = f"one linear solve: {milliseconds(limit)} ms"
    shape, label = vertical_line(1e3 * limit, text)
    if fastest <= FAR_LEFT * 1e3 * limit:
        return shape, label
    return {}, label | dict(x=0, xref="paper", text=f"\u25c2 {text}", textangle=0)


def _rounding(unit: str) -> list[dict[str, Any]]:
    """Return the band of errors of rounding to double precision, which only relative errors have."""
    if not unit.startswith("relative"):
        return []
    band = dict(type="rect", xref="paper", yref="y", x0=0, x1=1, y0=FLOOR / 10, y1=UNIT_ROUNDOFF, layer="below")
    return [dict(**band, fillcolor=GREY, opacity=0.15, line=dict(width=0))]


def _without_points(mine: Sequence[Row], quantity: Quantity) -> str:
    """Return a sentence on rows without a point, and why; empty where there are none."""
    missing = [row.method for row in mine if row.verdict == rows.MISSING]
    lacking = [row for row in mine if getattr(row, quantity.column) is None or row.seconds is None]
    verdicts = Counter(row.verdict for row in lacking if row.verdict != rows.MISSING)
    counts = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    sentences = [f"Answers without a point: {counts}."] if counts else []
    return " ".join(sentences + ([f"Not installed: {', '.join(dict.fromkeys(missing))}."] if missing else []))


# Rates: how often methods call their own answers solved, and how often these are right, as bars side by side.

BAR_HEIGHT, AROUND_BARS = 44, 170  # pixels for each method, and for axis and legend
# Colour, pattern and words of the three bars of a method.
_BARS = {
    "claimed": (ORANGE, "/", "called solved by the method itself"),
    "right": (BLUE, "", "right, by the true error"),
    "certified": (GREEN, ".", "passed by the certificate, as solve runs it"),
}


def rates_chart(found: statistics.Overview) -> Chart:
    """Return the chart of answers that were claimed, that were right, and that passed the certificate."""
    shown = [rates for rates in found.rates if rates.own or rates.certifiable]
    data = [_bar(shown, column, *words) for column, words in _BARS.items()]
    missing = [rates.method for rates in found.rates if not rates.installed]
    return Chart(
        name="rates",
        title="Called solved, and was right",
        caption=f"{on_cases(found.cases)} Of a method's own answers, at every tolerance: how many it called solved, "
        "and how many were right (error at most 1e-6, or 100 times the tolerance that was asked). Where the first bar "
        "is longer than the second, some flags were wrong; the third is best at 100 %, and counts of an approximate "
        "method those answers alone that are as good as exact. Answers that failed count as neither, and so do those "
        "of Uzawa's iteration that is stopped early on purpose; methods that are approximate by design, and the active "
        f"set, raise no flag. Not installed: {', '.join(missing) or 'none'}.",
        figure=dict(data=data, layout=_bars_layout(shown, "part of the answers [%]", dict(range=[0, 108]))),
        headings=("method", "own answers", "called solved", "right", "unsupported", "as solve runs it", "certified"),
        lines=tuple(_rate_cells(rates) for rates in found.rates),
    )


def _parts(rates: statistics.Rates, column: str) -> tuple[int, int]:
    return getattr(rates, column), rates.certifiable if column == "certified" else rates.own


def _bar(shown: Sequence[statistics.Rates], column: str, colour: str, pattern: str, words: str) -> dict[str, Any]:
    parts = [_parts(rates, column) for rates in shown]
    return dict(
        type="bar",
        orientation="h",
        name=words,
        y=[rates.method for rates in shown],
        x=[rounded(100 * part / whole) if whole else None for part, whole in parts],
        text=[percent(part, whole) for part, whole in parts],
        textposition="outside",
        customdata=[f"{part} of {whole}" for part, whole in parts],
        hovertemplate=f"%{{y}}<br>{words}: %{{customdata}}<extra></extra>",
        marker=dict(color=colour, pattern=dict(shape=pattern, fillmode="overlay")),
        meta=meta("", column),
    )


def _bars_layout(shown: Sequence[Any], title: str, xaxis: Mapping[str, Any]) -> dict[str, Any]:
    ordered = dict(type="category", autorange="reversed", automargin=True, dtick=1, title=METHOD)
    across = dict(title=dict(text=title)) | dict(xaxis)
    above = legend("", y=1.0, yanchor="bottom", traceorder="normal")
    return layout(across, ordered, BAR_HEIGHT * len(shown) + AROUND_BARS, barmode="group", legend=above)


def _rate_cells(rates: statistics.Rates) -> tuple[str, ...]:
    if not rates.installed:
        return rates.method, "not installed", "", "", "", "", ""
    own = (str(rates.claimed), str(rates.right), str(rates.unsupported)) if rates.own else ("", "", "")
    return rates.method, str(rates.own or "no flag"), *own, str(rates.certifiable), str(rates.certified)


def silently_wrong_chart(all_rows: Sequence[Row]) -> Chart:
    """Return the chart of wrong answers that methods called solved or that passed the certificate; words if none is."""
    found = [rates for rates in statistics.method_rates(all_rows) if rates.installed]
    total, ours = sum(rates.silently_wrong for rates in found), sum(rates.wrong_but_passed for rates in found)
    name, title = "silently-wrong", "Wrong answers that were called right"
    if not total and not ours:
        claimed, passed = sum(rates.claimed for rates in found), sum(rates.certifiable for rates in found)
        words = f"None: of {claimed} raw answers that their methods called solved, none has an error above 1e-6 and "
        words += (
            f"above 100 times the tolerance that was asked, and of {passed} answers that were certified none passed "
        )
        return Chart(name, title, words + "that is wrong. The table of methods counts them.", {})
    counts = {
        "silently_wrong": (VERMILION, "x", "called solved by the method itself, and wrong", "own"),
        "wrong_but_passed": (GREY, "", "passed by the certificate, and wrong (must be 0)", "certifiable"),
    }
    data = [
        dict(
            type="bar",
            orientation="h",
            name=words,
            y=[rates.method for rates in found],
            x=[getattr(rates, column) for rates in found],
            text=[_of(getattr(rates, column), getattr(rates, whole)) for rates in found],
            textposition="outside",
            hovertemplate=f"%{{y}}<br>{words}: %{{text}}<extra></extra>",
            marker=dict(color=colour, pattern=dict(shape=pattern, fillmode="overlay")),
            meta=meta("", column),
        )
        for column, (colour, pattern, words, whole) in counts.items()
    ]
    most = max((rates.silently_wrong for rates in found), default=0)
    return Chart(
        name=name,
        title=title,
        caption=f"Over all cases, tolerances and ways: {total} raw answers that their methods called solved are wrong, "
        "with an error above 1e-6 and above 100 times the tolerance that was asked. Wrong answers that passed the "
        f"certificate: {ours}.",
        figure=dict(data=data, layout=_bars_layout(found, "number of answers [1]", dict(range=[0, 1.2 * most + 1]))),
        headings=(
            "method",
            "own answers",
            "called solved",
            "called solved and wrong",
            "passed the certificate and wrong",
        ),
        lines=tuple((r.method, *map(str, (r.own, r.claimed, r.silently_wrong, r.wrong_but_passed))) for r in found),
    )


def _of(part: int, whole: int) -> str:
    return f"{part} of {whole}" if whole else "no flag"


# Run times over many cases: performance profiles and means.

SOLVED = "Solved means a true error of at most 1e-6 (and what rounding the answer adds), whatever flags say."
PROFILE_HEIGHT = 620
POINT_HEIGHT, AROUND = 26, 170  # pixels for each method of a chart of means, and for axis and legend
FACTORS = (1.0, 2.0, 10.0)  # of the fastest time, in the tables


def profile_charts(found: statistics.Overview) -> Iterator[Chart]:
    """Yield the performance profiles of methods as solve runs them, and of their raw answers on all unknowns."""
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


def _by_themselves(all_times: Sequence[statistics.RouteTimes]) -> Iterator[statistics.RouteTimes]:
    """Yield one route for each method: before polish where it is polished, on all unknowns where there is a choice."""
    by_route = {times.route: times for times in all_times}
    for name in dict.fromkeys(route.method for route in by_route):
        routes = (statistics.Route(name, variant, whole) for variant in ("raw", "") for whole in (True, False))
        yield next(by_route[route] for route in routes if route in by_route)


def _profile(name: str, title: str, about: str, shown: Sequence[statistics.RouteTimes]) -> Chart:
    compared = statistics.ratios({times.route: times.seconds for times in shown})
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
                *(f"{100 * part:.0f}" for part in statistics.profile(compared[times.route], np.array(FACTORS))),
                *map(str, (times.solved, times.failed, times.unsupported)),
            )
            for times in shown
        ),
    )


def _steps(times: statistics.RouteTimes, compared: np.ndarray, last: float) -> dict[str, Any]:
    """Return the profile as steps, with symbols where it rises."""
    factors = np.unique(np.concatenate([[1.0], compared[np.isfinite(compared)], [last]]))
    parts = 100 * statistics.profile(compared, factors)
    name = times.route.method
    hint = f"<b>{name}</b><br>right on %{{y}} % of {len(compared)} cases within %{{x}} times the fastest<extra></extra>"
    xs, ys = [rounded(x) for x in factors], [rounded(float(y)) for y in parts]
    drawn = method_line(name, xs, ys, variant_name(times.route), hovertemplate=hint, mode="lines+markers")
    drawn["line"] |= dict(shape="hv")
    return drawn


def means_chart(found: statistics.Overview) -> Chart:
    """Return the chart of shifted geometric means of every route, the fastest method on top."""
    order = _order(found)
    shown = list(zip(found.times, found.means, strict=True))
    data = [_mean_point(times, mean) for times, mean in shown]
    routes = dict.fromkeys((times.route.variant, times.route.whole) for times, _ in shown)
    legend_keys = [route_key(*route) for route in routes]
    methods = dict(type="category", categoryorder="array", categoryarray=order[::-1], automargin=True, dtick=1)
    axis = log_axis("shifted geometric mean of the run times [ms]", [1e3 * mean for _, mean in shown])
    return Chart(
        name="mean-times",
        title="Mean run times, failures included",
        caption=f"{on_cases(found.cases)} The shifted geometric mean over these cases of the run time to the fastest "
        f"right answer: {1e3 * statistics.SHIFT:g} ms are added to each time and taken off the mean, so that tiny "
        "cases do not decide. Further left is better; methods are in the order of their best "
        f"mean. {SOLVED} A case without a right answer counts as {statistics.LIMIT:g} s, and there the clock stops for "
        "answers that take longer.",
        figure=dict(
            data=data + legend_keys,
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


def _order(found: statistics.Overview) -> list[str]:
    """Return the methods in the order of their best mean."""
    best: dict[str, float] = {}
    for times, mean in zip(found.times, found.means, strict=True):
        best[times.route.method] = min(mean, best.get(times.route.method, math.inf))
    return sorted(best, key=lambda name: best[name])


def _mean_point(times: statistics.RouteTimes, mean: float) -> dict[str, Any]:
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


def overview_charts(data: ReportData) -> tuple[Chart, ...]:
    """Return the charts over all cases; comparisons are left out where no case was put to all methods."""
    found, wrong = statistics.overview(data.rows), silently_wrong_chart(data.rows)
    if not found.cases:
        return (wrong,)
    return *_medians(data.rows), *profile_charts(found), means_chart(found), rates_chart(found), wrong


def _medians(all_rows: Sequence[Row]) -> Iterator[Chart]:
    charts = (median_chart(all_rows, quantity) for quantity in QUANTITIES)
    return (chart for chart in charts if chart is not None)


def median_chart(all_rows: Sequence[Row], quantity: Quantity) -> Chart | None:
    """Return the chart of median errors against median times; None where fewer than two cases can be laid together."""
    cases, middle = statistics.median_cases(all_rows), statistics.median_rows(all_rows)
    figure = work_precision(middle, quantity, f"{quantity.measure} [1]", "", statistics.median_limit(all_rows))
    return None if len(cases) < 2 or figure is None else _median_chart(cases, middle, quantity, figure)


def _median_chart(cases: Sequence[str], middle: Sequence[Row], quantity: Quantity, figure: Mapping[str, Any]) -> Chart:
    return Chart(
        name=f"median-error-{'u' if quantity.name == 'u' else 'force'}",
        title=f"{quantity.title.capitalize()} against run time, median over {counted('case', len(cases))}",
        caption=f"{_READING} Of each value of a knob, the median time and the median "
        f"error over the {len(cases)} cases that every installed method was put to and whose errors are relative. An "
        "answer that failed has infinite errors and takes infinitely long; what fails in more than half of the cases "
        "has no point. Penalties are multiples of the contact stiffness of each case. One linear solve is the "
        "median time of factorising the stiffness of these bodies and solving once without contact: the physical limit "
        "of a solver that factorises.",
        figure=figure,
        headings=(*TABLE, f"error in {quantity.name}, {quantity.measure} [1]"),
        lines=tuple((*cells(row, ""), error_text(getattr(row, quantity.column))) for row in middle),
    )
