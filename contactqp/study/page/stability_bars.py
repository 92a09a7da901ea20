"""The safe range of each method along each axis of the stability study, as bars on the page of a report."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FILE, PAGE = "stability.json", "stability.html"


@dataclass(frozen=True)
class Bar:
    """The longest run of neighbouring values of an axis at which a method is right."""

    start: float  # where it begins on the axis [%]
    width: float  # [%]; 0: nowhere
    words: str


@dataclass(frozen=True)
class StabilityBars:
    """One line of bars for each method, those that are right at most values first."""

    axes: tuple[tuple[str, str], ...]  # title, and from where to where its values go
    lines: tuple[tuple[str, tuple[Bar | None, ...]], ...]  # None: not tried on that axis
    page: str  # of the study, beside that of the report; empty where it is not there


def stability_bars(folder: Path) -> StabilityBars | None:
    """Return the safe ranges of the stability study in a folder; None where there is none that can be read."""
    try:
        axes = json.loads((folder / FILE).read_text(encoding="utf-8"))["axes"]
        named = tuple((str(axis["title"]), _ends(axis)) for axis in axes)
        bars = [{found["method"]: _bar(axis["values"], found) for found in axis["ranges"]} for axis in axes]
    except (OSError, ValueError, KeyError, TypeError, IndexError):
        return None
    methods = dict.fromkeys(method for found in bars for method in found)
    lines = [(method, tuple(found.get(method) for found in bars)) for method in methods]
    lines.sort(key=lambda line: -sum(bar.width for bar in line[1] if bar is not None))
    return StabilityBars(named, tuple(lines), PAGE if (folder / PAGE).exists() else "")


def _ends(axis: Mapping[str, Any]) -> str:
    shown = axis["labels"] or [f"{value:g}" for value in axis["values"]]
    return f"{axis['quantity']}: {shown[0]} to {shown[-1]}"


def _bar(values: Sequence[float], found: Mapping[str, Any]) -> Bar:
    words = str(found["words"])
    if found["lowest"] is None:
        return Bar(0.0, 0.0, words)
    first, last = values.index(found["lowest"]), values.index(found["highest"])
    return Bar(100 * first / len(values), 100 * (last - first + 1) / len(values), words)
