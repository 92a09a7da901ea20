"""Error against run time as a picture: one curve for each method, traced by its knob."""

from __future__ import annotations

import importlib.util
import statistics
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contactqp.pictures.style import LINE_COLOURS
from contactqp.study.rows import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*", "h", "p", "d")
# Errors below are drawn here: a logarithm has no zero, and doubles have no more digits.
LEAST_ERROR = 1e-17
ERRORS: Mapping[str, str] = {
    "error_displacement": "true error in u, relative, energy norm [1]",
    "error_force": "true error in λ, relative, largest contact [1]",
}
SUFFIX = ".png"


def can_draw() -> bool:
    """Whether matplotlib is installed; it is not imported to find out."""
    return importlib.util.find_spec("matplotlib") is not None


def curves(rows: Iterable[Row], error: str) -> dict[tuple[str, str, str], list[tuple[float, float]]]:
    """(milliseconds, error) of each (method, variant, knob) along the knob; rows without both are left out."""
    found: dict[tuple[str, str, str], list[tuple[float, float]]] = {}
    for row in rows:
        value = getattr(row, error)
        if value is not None and row.seconds is not None:
            points = found.setdefault((row.method, row.variant, row.knob), [])
            points.append((1e3 * row.seconds, max(value, LEAST_ERROR)))
    return found


def medians(rows: Sequence[Row]) -> list[Row]:
    """The median over cases of time and errors for each rung that all cases share (stiffnesses are not shared)."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        if row.knob not in ("penalty", "perturbation") or row.knob_value is None:
            groups.setdefault((row.method, row.variant, row.knob, row.knob_value), []).append(row)
    return [_middle(key, group) for key, group in groups.items()]


def _middle(key: tuple[Any, ...], group: Sequence[Row]) -> Row:
    method, variant, knob, value = key
    return Row(
        method=method,
        variant=variant,
        knob=knob,
        knob_value=value,
        seconds=_median(row.seconds for row in group),
        error_displacement=_median(row.error_displacement for row in group),
        error_force=_median(row.error_force for row in group),
    )


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.median(known) if known else None


def draw(rows: Sequence[Row], title: str) -> Figure:
    """Two panels, error in u and error in λ against run time, both logarithmic, and one legend for both."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 5.6), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True)
    styles = _styles(rows)
    for panel, (error, label) in zip(panels, ERRORS.items(), strict=True):
        _set_axes(panel)
        _draw_panel(panel, curves(rows, error), styles, label)
    figure.suptitle(title)
    _add_legend(figure, styles, {row.variant for row in rows})
    return figure


def save(figure: Figure, file: Path) -> None:
    """Write a picture; the suffix of the file says in which format."""
    figure.savefig(file, dpi=110)


def _styles(rows: Iterable[Row]) -> dict[str, tuple[str, str]]:
    """A colour and a marker for each method; no two methods share both."""
    names = dict.fromkeys(row.method for row in rows if row.seconds is not None)
    return {name: (LINE_COLOURS[i % len(LINE_COLOURS)], MARKERS[i % len(MARKERS)]) for i, name in enumerate(names)}


def _draw_panel(
    panel: Axes, drawn: Mapping[Any, list[tuple[float, float]]], styles: Mapping[str, Any], label: str
) -> None:
    for (method, variant, _), points in drawn.items():
        colour, marker = styles[method]
        times, errors = zip(*points, strict=True)
        raw = variant == "raw"
        panel.plot(
            times,
            errors,
            color=colour,
            marker=marker,
            markersize=6,
            markerfacecolor="none" if raw else colour,
            linestyle={"raw": "--", "uzawa": ":"}.get(variant, "-"),
            linewidth=1.2,
            label=f"{method} {variant}".strip(),
        )
    panel.set_ylim(LEAST_ERROR / 3, 10)
    panel.set_ylabel(label)
    panel.set_xlabel("run time to the answer, without its certificate [ms]")
    across = panel.get_yaxis_transform()
    panel.text(0.02, LEAST_ERROR * 1.6, "no error in double precision", transform=across, fontsize="x-small")


def _set_axes(panel: Axes) -> None:
    """Logarithmic, with times written out: 10, 20, 50."""
    from matplotlib.ticker import LogLocator, NullFormatter, NullLocator, StrMethodFormatter

    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panel.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.yaxis.set_minor_formatter(NullFormatter())
    panel.grid(True, which="major", linewidth=0.4, alpha=0.6)


_VARIANTS: Mapping[str, tuple[Any, str, str]] = {
    "raw": ("--", "none", "before polish"),
    "polished": ("-", "0.3", "after polish"),
    "uzawa": (":", "0.3", "Uzawa's iteration"),
}


def _add_legend(figure: Figure, styles: Mapping[str, tuple[str, str]], variants: set[str]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour, marker=marker, linestyle="-", label=name)
        for name, (colour, marker) in styles.items()
    ]
    handles += [
        Line2D([], [], color="0.3", marker="o", linestyle=line, markerfacecolor=face, label=text)
        for variant, (line, face, text) in _VARIANTS.items()
        if variant in variants
    ]
    if handles:
        figure.legend(handles=handles, loc="outside right upper", fontsize="small", title="method")
