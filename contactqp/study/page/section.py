"""What another study hands over to be shown on the page: headings, words, charts, tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from contactqp.study.report.chart import Chart


class TitledTable(Protocol):
    """A table with its title."""

    @property
    def title(self) -> str: ...

    @property
    def headings(self) -> tuple[str, ...]: ...

    @property
    def lines(self) -> tuple[tuple[str, ...], ...]: ...


class Section(Protocol):
    """A part of the page: each of the words is a paragraph."""

    @property
    def heading(self) -> str: ...

    @property
    def words(self) -> tuple[str, ...]: ...

    @property
    def charts(self) -> tuple[Chart, ...]: ...

    @property
    def tables(self) -> Sequence[TitledTable]: ...
