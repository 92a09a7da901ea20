"""A chart of a page: what Plotly draws, what a newcomer must know to read it, and its numbers as a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Chart:
    """One chart.

    Parameters
    ----------
    name : str
        Its identifier on the page.
    title : str
    caption : str
        What is drawn, and how to read it.
    figure : mapping
        "data" and "layout" of Plotly; colours of text, grid and background are the page's, not the figure's.
    headings, lines : tuples of str
        The same numbers as a table, for those who read.
    """

    name: str
    title: str
    caption: str
    figure: Mapping[str, Any]
    headings: tuple[str, ...] = ()
    lines: tuple[tuple[str, ...], ...] = ()
