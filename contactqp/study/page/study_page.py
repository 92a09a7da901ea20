"""The page of a study along axes: its sections with their charts and tables, one HTML file that loads nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from contactqp.study.page.render import ChartItem, Tile, anchors_of, fact_tables, filled, items
from contactqp.study.page.section import Section
from contactqp.study.page.tables import Table, plain_table


@dataclass(frozen=True)
class SectionView:
    """A section, ready for its template."""

    anchor: str
    section: Section
    charts: tuple[ChartItem, ...]
    tables: tuple[tuple[str, Table], ...]  # with their titles


def render_study(
    sections: Sequence[Section],
    tiles: Sequence[Tile],
    columns: Mapping[str, str],
    facts: Mapping[str, Any],
    command: str,
) -> str:
    """The page.

    Parameters
    ----------
    sections : sequence of Section
    tiles : sequence of Tile
        What it all comes to.
    columns : mapping
        Names and meanings of the columns of the data beside the page.
    facts : mapping
        Machine, versions, settings.
    command : str
        What makes this page again.

    Raises
    ------
    ModuleNotFoundError
        A package is not installed; `contactqp.study.page.render.missing_packages` says so before.
    """
    views = tuple(_views(sections))
    return filled(
        "study.html",
        [item for view in views for item in view.charts],
        sections=views,
        tiles=tuple(tiles),
        columns=plain_table("columns of the data", ("column", "meaning"), columns.items()),
        facts=tuple(fact_tables(facts)),
        command=command,
    )


def _views(sections: Sequence[Section]) -> Iterator[SectionView]:
    anchors = anchors_of(f"part-{section.heading}" for section in sections)
    for anchor, section in zip(anchors, sections, strict=True):
        tables = ((table.title, plain_table(table.title, table.headings, table.lines)) for table in section.tables)
        yield SectionView(anchor, section, items(anchor, section.charts), tuple(tables))
