"""Pictures of histories: displacements, gaps, forces and energies against time or load, with the events marked."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.analysis.history import History
from contactqp.model.arrays import Array
from contactqp.pictures import event_marks, style
from contactqp.pictures.history_fields import HistoryFields, history_fields
from contactqp.pictures.history_loads import load_panel
from contactqp.pictures.history_panels import ALL, Curve, Panel, time_label, time_panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# [inch]: width; height of a panel against time, of the one of load and displacement, of a line of text, of a letter of
# an upright label; and what title and axis add.
WIDTH, HEIGHT, LOAD_HEIGHT, LINE, LETTER, TEXT = 9.5, 1.45, 2.7, 0.16, 0.062, 1.3
# Notes that are shown, and letters of a line of them.
MOST_NOTES, NOTE_LINE = 3, 120
# Of so few instants each is marked, since the lines between them are chords.
FEW = 60
# What varies by less than this part of what it is made of varies by rounding, and is drawn flat.
FLAT = 1e-9
# Larger numbers leave no room for a picture within what doubles hold.
LARGEST = 1e300


def draw_history(history: History, file: str | Path, *, title: str = "", time_unit: str = "") -> None:
    """Draw a load path or a motion: what moves, the gaps and forces of contacts, energies, and every event.

    Parameters
    ----------
    history : History
        Of `follow_path`, `impact`, `run`, or what a `NotConverged` carries as its `history`.
    file : str or Path
        Ends in .png, .pdf or .svg.
    title : str
        Stands above.
    time_unit : str
        Of the times of a motion, for labels.

    Raises
    ------
    InvalidProblem
        Another suffix, a folder that is not there, no History.
    BackendMissing
        matplotlib is not installed.

    Notes
    -----
    Of a load path the curves are those of the unknowns whose loads do most, and of the contacts that push hardest; what
    all contacts do together is a curve where some are left out. A load path also has the load over the displacement,
    of up to three loads that come one by one, or up to four loaded unknowns. A motion shows the unknowns that its
    contacts touch.
    """
    path = style.check_picture(file)
    style.save(history_figure(history, title=title, time_unit=time_unit), path)


def history_figure(history: History, *, title: str = "", time_unit: str = "") -> Figure:
    """The figure that `draw_history` writes."""
    fields = history_fields(history)
    panels, load = time_panels(fields, time_unit), load_panel(fields)
    width = float(np.ptp(fields.times))
    found, remarks = event_marks.labels(fields.events, width), _remarks(fields)
    heights = [HEIGHT] * len(panels) + [LOAD_HEIGHT] * (load is not None)
    letters = max((len(label.text) for label in found), default=0)
    result = style.new_figure(WIDTH, sum(heights) + TEXT + LETTER * letters + LINE * len(remarks))
    axes = result.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    for place, (drawn, panel) in enumerate(zip(axes, panels, strict=False)):
        _draw_curves(drawn, panel, [fields.times] * len(panel.curves))
        event_marks.draw_lines(drawn, fields.events, width)
        if place:
            drawn.sharex(axes[0])
        if place < len(panels) - 1:
            drawn.tick_params(labelbottom=False)
    event_marks.draw_labels(axes[0], found)
    axes[len(panels) - 1].set_xlabel(time_label(fields, time_unit))
    if load is not None:
        _draw_load(axes[-1], load, fields)
    if remarks:
        below = dict(xycoords="axes fraction", xytext=(0, -34), textcoords="offset points", annotation_clip=False)
        axes[-1].annotate("\n".join(remarks), (0, 0), va="top", fontsize="small", gid="remarks", **below)
    result.suptitle(style.headline(title, _headline(fields)))
    handles = event_marks.handles(fields.events, points=load is not None)
    style.add_legend(result, handles, columns=max(len(handles), 1))
    return result


def _draw_curves(axes: Any, panel: Panel, abscissas: Sequence[Array]) -> None:
    handles = []
    for curve, x in zip(panel.curves, abscissas, strict=True):
        look = _look(curve) | (dict(marker=".", markersize=4) if len(x) <= FEW else {})
        handles += axes.plot(_drawable(x), _drawable(curve.y), gid=curve.label, label=style.plain(curve.label), **look)
    low, high = _range(panel.curves)
    if high - low < FLAT * panel.size:
        middle, room = (low + high) / 2, 0.05 * panel.size
        axes.set_ylim(middle - room, middle + room)
    axes.set_ylabel(panel.label.replace(" [", "\n["), fontsize="small")
    axes.legend(handles=handles, **_BESIDE)
    axes.grid(True, linewidth=0.3, alpha=0.6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


_BESIDE: dict[str, Any] = dict(
    loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, fontsize="x-small", frameon=False, handlelength=3.2
)


def _draw_load(axes: Any, panel: Panel, fields: HistoryFields) -> None:
    _draw_curves(axes, panel, panel.x)
    axes.set_xlabel(panel.x_label)
    instants = fields.instants(fields.events)
    for curve, x in zip(panel.curves, panel.x, strict=True):
        event_marks.draw_points(axes, fields.events, _drawable(x)[instants], _drawable(curve.y)[instants])


def _range(curves: Sequence[Curve]) -> tuple[float, float]:
    """The least and the largest value drawn, zero where there is none."""
    values = np.concatenate([_drawable(curve.y) for curve in curves])
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)


def _look(curve: Curve) -> dict[str, Any]:
    if curve.number == ALL:
        return dict(color="black", linestyle="-", linewidth=1.8)
    colours, dashes = style.LINE_COLOURS, style.DASHES
    return dict(color=colours[curve.number % len(colours)], linestyle=dashes[curve.number % len(dashes)], linewidth=1.4)


def _drawable(values: Array) -> Array:
    """Without what is no number, or too large for a picture."""
    with np.errstate(invalid="ignore"):
        return np.where(abs(values) <= LARGEST, values, np.nan)


def _headline(fields: HistoryFields) -> str:
    what = "motion" if fields.moving else "load path"
    events = {0: "no event", 1: "1 event"}.get(len(fields.events), f"{len(fields.events)} events")
    instants = "1 instant" if len(fields.times) == 1 else f"{len(fields.times)} instants"
    return f"{what}: {instants}, {events}"


def _remarks(fields: HistoryFields) -> list[str]:
    """Lines below the panels: events without a label of their own, what is not drawn, and the notes of the history."""
    told = [f"note: {note}" for note in fields.notes[:MOST_NOTES]]
    if len(fields.notes) > MOST_NOTES:
        told.append(f"and {len(fields.notes) - MOST_NOTES} more in history.notes")
    hidden = event_marks.thinned(event_marks.labels(fields.events, float(np.ptp(fields.times))))
    lines = [line for text in (hidden, _left_out(fields), *told) for line in textwrap.wrap(text, NOTE_LINE)]
    return [line.replace("$", r"\$") for line in lines]


def _left_out(fields: HistoryFields) -> str:
    """What is said of numbers that are none or too large, or nothing."""
    values = [fields.displacement, fields.normal_force, np.column_stack([fields.times, *fields.energies.values()])]
    count = int(np.sum(np.any([~np.all(abs(value) <= LARGEST, axis=1) for value in values], axis=0)))
    return f"{count} instants with values beyond {LARGEST:g} are left out" if count else ""
