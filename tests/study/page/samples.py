"""A small report with charts, and with texts that would break a page that does not escape them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from contactqp.study.case_study import load_studies
from contactqp.study.curves import Chart
from contactqp.study.page.case_view import facets_of
from contactqp.study.report_data import CaseRecord, ReportData, record, summarise, unjudged
from contactqp.study.rows import Row
from contactqp.study.settings import chosen_methods

CASES = Path(__file__).parents[3] / "cases"
EVIL = """<script>alert(1)</script></script><img src=x onerror=alert(2)> "quoted" 'single' & {{ 7 * 7 }} λ→∞"""
METHODS = ("active-set", "osqp", "penalty")
COLOURS = {"active-set": "#000000", "osqp": "#D55E00", "penalty": "#0072B2"}


@cache
def data_of(*names: str) -> ReportData:
    """The report of cases with few methods."""
    studies = load_studies([CASES / f"{name}.toml" for name in names], chosen_methods(METHODS), (1e-3, 1e-9))
    cases, rows = [], []
    for study in studies:
        truth = study.truth()
        rows += [study.answer(setting, truth) for setting in study.settings]
        cases.append(record(study, truth))
    return report_of(cases, rows)


@cache
def bare_record(name: str) -> CaseRecord:
    """What is known of a case before anything is solved."""
    (study,) = load_studies([CASES / f"{name}.toml"], [])
    return unjudged(study, "nothing")


def report_of(cases: list[CaseRecord], rows: list[Row]) -> ReportData:
    files = " ".join(case.file for case in cases)
    facts: dict[str, Any] = dict(
        created="today", command=f"contactqp report {files}", machine=dict(python="CPython"), settings=dict(repeats=0)
    )
    return ReportData(tuple(cases), tuple(rows), summarise(rows, (u for case in cases for u in case.unmet)), facts)


@cache
def hostile() -> ReportData:
    """`data_of` two cases, the second of which says `EVIL` wherever a user may say something."""
    tame = data_of("bar_wall", "truss_friction")
    first, second = tame.cases
    bad = replace(second, title=EVIL, about=EVIL, source=EVIL, truth=EVIL, unmet=(EVIL,), name="evil <b>")
    rows = [replace(row, case=bad.name, message=EVIL) if row.case == second.name else row for row in tame.rows]
    return report_of([first, bad], rows)


def chart(rows: tuple[Row, ...], name: str = "force", title: str = "Error in the contact forces") -> Chart:
    """Error against run time, one curve for each method and variant."""
    found: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.seconds is not None and row.error_force is not None:
            found.setdefault((row.method, facets_of(row)["variant"]), []).append(row)
    traces = [_trace(method, variant, points) for (method, variant), points in found.items()]
    axes = dict(xaxis=_axis("run time [ms]"), yaxis=_axis("true error in λ, relative [1]"))
    lines = tuple(
        (method, variant, f"{row.error_force:.1e}") for (method, variant), points in found.items() for row in points
    )
    figure = dict(data=traces, layout=axes)
    return Chart(name, title, "Down and to the left is better.", figure, ("method", "answer", "error [1]"), lines)


def _trace(method: str, variant: str, points: list[Row]) -> dict[str, Any]:
    return dict(
        type="scatter",
        mode="lines+markers",
        name=f"{method} {variant}".strip(),
        x=[1e3 * (row.seconds or 0.0) for row in points],
        y=[max(row.error_force or 0.0, 1e-17) for row in points],
        meta=dict(method=method, variant=variant),
        line=dict(color=COLOURS[method], dash="dash" if variant == "raw" else "solid"),
        marker=dict(size=9, symbol="square-open" if variant == "raw" else "circle"),
        hovertemplate="%{x:.3g} ms, error %{y:.1e}<extra>%{fullData.name}</extra>",
    )


def _axis(title: str) -> dict[str, Any]:
    return dict(type="log", title=dict(text=title), exponentformat="power")
