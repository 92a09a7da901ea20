"""How often methods call their own answers solved, and how often they are right: bars side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from contactqp.study.charts.layout import METHOD, layout, legend, meta, on_cases
from contactqp.study.charts.numbers import percent, rounded
from contactqp.study.charts.style import BLUE, GREEN, GREY, ORANGE, VERMILION
from contactqp.study.report.chart import Chart
from contactqp.study.rows import Row
from contactqp.study.statistics.overview import Overview
from contactqp.study.statistics.rates import Rates, method_rates

BAR_HEIGHT, AROUND = 44, 170  # pixels for each method, and for axis and legend
# Colour, pattern and words of each bar: what the method says, what is true, what the certificate lets pass.
_BARS = {
    "claimed": (ORANGE, "/", "called solved by the method itself"),
    "right": (BLUE, "", "right, by the true error"),
    "certified": (GREEN, ".", "passed by the certificate, as solve runs it"),
}


def rates_chart(found: Overview) -> Chart:
    """Claimed, right, and passed by the certificate."""
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


def _parts(rates: Rates, column: str) -> tuple[int, int]:
    return getattr(rates, column), rates.certifiable if column == "certified" else rates.own


def _bar(shown: Sequence[Rates], column: str, colour: str, pattern: str, words: str) -> dict[str, Any]:
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
    ordered = dict(type="category", autorange="reversed", automargin=True, title=METHOD)
    across = dict(title=dict(text=title)) | dict(xaxis)
    above = legend("", y=1.0, yanchor="bottom", traceorder="normal")
    return layout(across, ordered, BAR_HEIGHT * len(shown) + AROUND, barmode="group", legend=above)


def _rate_cells(rates: Rates) -> tuple[str, ...]:
    if not rates.installed:
        return rates.method, "not installed", "", "", "", "", ""
    own = (str(rates.claimed), str(rates.right), str(rates.unsupported)) if rates.own else ("", "", "")
    return rates.method, str(rates.own or "no flag"), *own, str(rates.certifiable), str(rates.certified)


def silently_wrong_chart(all_rows: Sequence[Row]) -> Chart:
    """Wrong answers that were called solved, by the methods' flags and by the certificate."""
    found = [rates for rates in method_rates(all_rows) if rates.installed]
    total, ours = sum(rates.silently_wrong for rates in found), sum(rates.wrong_but_passed for rates in found)
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
        name="silently-wrong",
        title="Wrong answers that were called right",
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
