"""Render a report or a study into one HTML file that loads nothing."""

from __future__ import annotations

import base64
import gzip
import importlib.util
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from typing import Any, NamedTuple

from contactqp.scene.schema import PHYSICS
from contactqp.study.conclusion import busy, conclude, load_of
from contactqp.study.curves import ALL_UNKNOWNS, FINAL, RAW, UZAWA, Chart
from contactqp.study.page.case_view import (
    FACETS,
    CaseView,
    Line,
    StabilityBars,
    Table,
    case_view,
    facets_of,
    marked,
    plain_table,
    table_of_chart,
)
from contactqp.study.report_data import ReportData
from contactqp.study.rows import COLUMNS, VERDICTS
from contactqp.study.telling import left_out_lines


@lru_cache(maxsize=4096)
def mathml(latex: str, display: str = "inline") -> str:
    """Return a formula of LaTeX as MathML, which browsers set without a library; `display` is "inline" or "block".

    >>> "<mi>K</mi><mi>u</mi>" in mathml("K u")
    True
    """
    from latex2mathml.converter import convert

    return str(convert(latex, display=display))


class Section(NamedTuple):
    """A section of the page of a study: each of the words is a paragraph."""

    heading: str
    words: tuple[str, ...]
    charts: tuple[Chart, ...]
    tables: tuple[Table, ...]  # their labels are their titles


NEEDED = ("jinja2", "plotly", "latex2mathml")
_LEGENDS = {"method": "Methods", "variant": "Variants", "verdict": "Verdicts"}
_VARIANTS = {FINAL: "final answers", RAW: "raw answers, before polish", UZAWA: "Uzawa's iteration"}


@dataclass(frozen=True)
class ChartItem:
    """A chart, ready for its template."""

    anchor: str
    chart: Chart
    numbers: Table | None


@dataclass(frozen=True)
class Facet:
    """One group of boxes in the filters of the page: (value, label) of each."""

    name: str
    legend: str
    choices: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Tile:
    """One number at the top of the page."""

    number: int
    what: str
    text: str
    bad: bool = False


def missing_packages() -> str:
    """Return the message where packages of the page are missing; empty where it can be made. Imports nothing."""
    absent = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if not absent:
        return ""
    verb = "is" if len(absent) == 1 else "are"
    return f"no page, as {', '.join(absent)} {verb} not installed: pip install {' '.join(absent)}"


def render(
    data: ReportData,
    overview: Sequence[Chart] = (),
    by_case: Mapping[str, Sequence[Chart]] | None = None,
    notes: Sequence[str] = (),
    telling: Chart | None = None,
    examples: Chart | None = None,
    ranges: StabilityBars | None = None,
    running: str = "",
    opened: str = "",
) -> str:
    """Return the HTML page of a report.

    Raises ModuleNotFoundError: one of `NEEDED` is not installed; `missing_packages` says so before.

    Parameters
    ----------
    data : ReportData
    overview : sequence of Chart, charts over all cases
    by_case : mapping of case names to sequences of Chart, charts of each case
    notes : sequence of str, limitations of this report, in addition to those of any report
    telling : the chart of the first screen
    examples : the chart after it, of the small cases
    ranges : the ranges of the stability study beside this report
    running : what is still running; empty for a finished report
    opened : name of the case that is open at first; the first one by default
    """
    first, second = items("first", [telling] if telling else []), items("second", [examples] if examples else [])
    shared = items("all", overview)
    opened = opened or next((case.name for case in data.cases), "")
    load = load_of(data.facts)
    views, found = tuple(_views(data, by_case or {})), conclude(data.rows, load)
    headings, *lines = found.cells()
    return fill_template(
        "page.html",
        [*first, *second, *shared, *(item for _, charts in views for item in charts)],
        data=data,
        answers=found.answers,
        note=found.note,
        lines=plain_table("methods, the most right first", headings, lines),
        first=first,
        second=second,
        ranges=ranges,
        left_out=tuple(_left_out(data)),
        running=running,
        opened=opened,
        busy=busy(load),
        overview=shared,
        views=views,
        groups=tuple(_by_physics(view for view, _ in views)),
        tiles=_tiles(data),
        parts=_parts(bool(overview)),
        facets=_facets(data),
        methods=_methods(data),
        columns=plain_table("columns of the tables", ("column of results.csv", "meaning"), COLUMNS.items()),
        verdicts=plain_table("verdicts", ("verdict", "meaning"), ((marked(v), text) for v, text in VERDICTS.items())),
        facts=tuple(fact_tables(data.facts)),
        command=data.facts["command"],
        notes=notes,
    )


def fill_template(template: str, drawn: Iterable[ChartItem], **values: object) -> str:
    """Return a template filled with values, style, script, Plotly and the figures of its charts."""
    from markupsafe import Markup

    whole = dict(css=Markup(_page_file("page.css")), script=Markup(_page_file("page.js")))
    whole |= dict(plotly=Markup(_packed_plotly()), figures=Markup(packed(_figures(drawn))))
    return str(_templates().get_template(template).render(**whole, **values))


@cache
def _templates() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    found = Environment(
        loader=PackageLoader("contactqp.study.page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters["mathml"] = lambda latex, display="inline": Markup(mathml(latex, display))
    return found


@cache
def _packed_plotly() -> str:
    from plotly.offline import get_plotlyjs

    return packed(get_plotlyjs())


def _page_file(name: str) -> str:
    return (files("contactqp.study.page") / name).read_text(encoding="utf-8")


def _views(
    data: ReportData, by_case: Mapping[str, Sequence[Chart]]
) -> Iterator[tuple[CaseView, tuple[ChartItem, ...]]]:
    anchors = anchors_of(f"case-{case.name}" for case in data.cases)
    for anchor, case in zip(anchors, data.cases, strict=True):
        charts = by_case.get(case.name, ())
        yield case_view(anchor, case, data.rows_of(case.name)), items(anchor, charts)


def _left_out(data: ReportData) -> Iterator[str]:
    """Yield what was left out of the largest case whose footprint is known, or of the largest."""
    measured = [case for case in data.cases if case.footprint is not None] or data.cases
    largest = max(measured, key=lambda case: case.sizes.unknowns, default=None)
    titles = {case.name: case.title for case in data.cases}
    return iter(()) if largest is None else left_out_lines(largest, data.rows, titles)


def _by_physics(views: Iterable[CaseView]) -> Iterator[tuple[str, list[CaseView]]]:
    """Yield the cases by what they are about, simple ones first."""
    groups: dict[str, list[CaseView]] = {}
    for view in views:
        groups.setdefault(view.case.physics, []).append(view)
    for physics in (*PHYSICS, ""):
        if physics in groups:
            yield physics, groups[physics]


def anchors_of(names: Iterable[str]) -> list[str]:
    """Return an identifier for each name, all different, that a URL can hold."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)
        found.append(plain if plain not in found else f"{plain}-{len(found)}")
    return found


def items(anchor: str, charts: Sequence[Chart]) -> tuple[ChartItem, ...]:
    """Return the charts with their anchors on the page and their numbers as tables."""
    anchors = anchors_of(f"{anchor}-{chart.name}" for chart in charts)
    return tuple(ChartItem(place, chart, table_of_chart(chart)) for place, chart in zip(anchors, charts, strict=True))


def _figures(drawn: Iterable[ChartItem]) -> str:
    """Return JSON of all figures by the anchors of their charts."""
    figures = {item.anchor: item.chart.figure for item in drawn if item.chart.figure}
    return json.dumps(figures, allow_nan=False, separators=(",", ":"), ensure_ascii=False)


def packed(text: str) -> str:
    """Return gzip in base64, which needs no escapes in HTML; always the same for the same text."""
    return base64.b64encode(gzip.compress(text.encode(), compresslevel=9, mtime=0)).decode("ascii")


def _tiles(data: ReportData) -> tuple[Tile, ...]:
    found = data.summary
    wrong, unmet = found.wrong_but_passed, len(found.unmet)
    alarm = "; ".join(filter(None, ["‼ must be 0", found.doubt]))
    return (
        Tile(wrong, "wrong but passed", alarm if wrong else "✓ no answer passes that is wrong", wrong > 0),
        Tile(unmet, "expectations unmet", "✗ see below" if unmet else "✓ all that the cases expect holds", unmet > 0),
        Tile(found.silently_wrong, "silently wrong", "answers that a method by itself calls solved, and are not"),
        Tile(len(data.rows), "rows", f"of {len(data.cases)} cases and {len(found.methods)} methods"),
    )


def _parts(overview: bool) -> tuple[tuple[str, str], ...]:
    parts = (
        ("overview", "All cases together", overview),
        ("methods", "Methods", True),
        ("cases", "Cases", True),
        ("meaning", "Columns and verdicts", True),
        ("limitations", "Limitations", True),
        ("rerun", "Machine and versions", True),
    )
    return tuple((anchor, name) for anchor, name, there in parts if there)


def _facets(data: ReportData) -> tuple[Facet, ...]:
    """Return the filters with the values of the rows, in the order in which they occur."""
    facets = []
    for name in FACETS:
        values = dict.fromkeys(facets_of(row)[name] for row in data.rows)
        labels = {value: _label(name, value) for value in values}
        facets.append(Facet(name, _LEGENDS[name], tuple(labels.items())))
    return tuple(facets)


def _label(facet: str, value: str) -> str:
    if facet == "verdict":
        return marked(value)
    return _variant_label(value) if facet == "variant" else value


def _variant_label(value: str) -> str:
    """Return a variant in words, with a note where it works on all unknowns without condensation."""
    variant = value.removesuffix(ALL_UNKNOWNS)
    return _VARIANTS.get(variant, variant) + (ALL_UNKNOWNS if variant != value else "")


def _methods(data: ReportData) -> Table:
    headings, *lines = data.summary.cells()
    return Table("methods", tuple(headings), tuple(Line(tuple(line)) for line in lines), {0: "method"})


def fact_tables(facts: Mapping[str, Any]) -> Iterator[Table]:
    """Yield one table for each group of facts, and one for facts in no group."""
    single = {name: value for name, value in facts.items() if not isinstance(value, Mapping)}
    groups = {name: value for name, value in facts.items() if isinstance(value, Mapping)}
    for name, group in ({"report": single} | groups).items():
        yield plain_table(name, (name, ""), [(_spaced(key), _fact(value)) for key, value in group.items()])


def _spaced(key: str) -> str:
    """Return a key in words; names of environment variables stay as they are."""
    return key.replace("_", " ") if key.islower() else key


def _fact(value: Any) -> str:
    """Return a fact as text: what is listed with commas between, numbers to four digits."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        return f"{value:.4g}" if isinstance(value, float) else str(value)
    return ", ".join(map(_fact, value))


@dataclass(frozen=True)
class SectionView:
    """A section, ready for its template."""

    anchor: str
    section: Section
    charts: tuple[ChartItem, ...]


def render_study(
    sections: Sequence[Section],
    tiles: Sequence[Tile],
    columns: Mapping[str, str],
    facts: Mapping[str, Any],
    command: str,
    beside: str = "",
    ranges: StabilityBars | None = None,
) -> str:
    """Return the HTML page of a study along axes.

    Raises ModuleNotFoundError: one of `NEEDED` is not installed; `missing_packages` says so before.

    Parameters
    ----------
    sections : sequence of Section, the parts of the page
    tiles : sequence of Tile, the numbers at its top
    columns : mapping, names and meanings of the columns of the data beside the page
    facts : mapping, machine, versions, settings
    command : the command that makes this page again
    beside : the page of a report in the same folder; empty where there is none
    ranges : where each method is right
    """
    views = tuple(_study_views(sections))
    return fill_template(
        "study.html",
        [item for view in views for item in view.charts],
        sections=views,
        tiles=tuple(tiles),
        columns=plain_table("columns of the data", ("column", "meaning"), columns.items()),
        facts=tuple(fact_tables(facts)),
        command=command,
        ranges=ranges,
        beside=beside,
    )


def _study_views(sections: Sequence[Section]) -> Iterator[SectionView]:
    anchors = anchors_of(f"part-{section.heading}" for section in sections)
    for anchor, section in zip(anchors, sections, strict=True):
        yield SectionView(anchor, section, items(anchor, section.charts))
