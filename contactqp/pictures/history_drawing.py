"""Pictures of load paths, motions and many load cases: curves against time, load or number, with events marked."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.analysis.history import Event, History
from contactqp.analysis.load_cases import Solutions
from contactqp.errors import InvalidProblem, counted
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array
from contactqp.model.names import read_names
from contactqp.pictures import style
from contactqp.pictures.history_panels import (
    ALL,
    Curve,
    HistoryFields,
    Panel,
    case_fields,
    chosen_contacts,
    contact_panels,
    history_fields,
    load_panel,
    time_label,
    time_panels,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Width of an upright label, relative to that of a panel.
ROOM = 0.022
# Lines of events nearer than this part of the width are drawn as one line.
ONE_LINE = 1 / 2000
# Events that one label names at most, and letters of a name.
MOST_NAMED, MOST_LETTERS = 2, 20
# The most load cases that are named below the axis, and the longest name that is written horizontally there.
NAMED_CASES, SHORT_NAME = 16, 4
KINDS: Mapping[str, dict[str, Any]] = {
    "closed": dict(color="black", linestyle="-"),
    "opened": dict(color="0.45", linestyle="--"),
    "slip": dict(color="#D55E00", linestyle="-."),
    "stick": dict(color="#0072B2", linestyle=":"),
}


@dataclass(frozen=True)
class Label:
    """A label above the time of its first event."""

    time: float
    text: str
    events: int


def labels(events: Sequence[Event], width: float) -> list[Label]:
    """Return labels that do not cover each other; a label of several events stands at the first.

    Parameters
    ----------
    events : sequence of Event
    width : float
        Length of the range of times that is drawn.

    >>> tip = [Event("closed", 0, 0.5, "tip"), Event("slip", 0, 0.5, "tip"), Event("opened", 0, 0.9, "tip")]
    >>> [(label.time, label.text) for label in labels(tip, width=1.0)]
    [(0.5, 'closed tip, slip tip'), (0.9, 'opened tip')]
    """
    groups: list[list[Event]] = []
    for event in sorted(events, key=lambda event: event.time):
        if groups and event.time - groups[-1][0].time <= ROOM * width:
            groups[-1].append(event)
        else:
            groups.append([event])
    return [Label(group[0].time, _text(group), len(group)) for group in groups]


def _text(group: Sequence[Event]) -> str:
    named = [f"{event.kind} {style.plain(event.name or str(event.contact), MOST_LETTERS)}" for event in group]
    if len(named) <= MOST_NAMED:
        return ", ".join(named)
    return f"{named[0]} + {len(named) - 1}"


def thinned(found: Sequence[Label]) -> str:
    """Return a remark on events without a label of their own; empty where all have one."""
    hidden = sum(label.events - 1 for label in found if label.events > MOST_NAMED)
    if not hidden:
        return ""
    named = sum(label.events for label in found) - hidden
    return f"{named} of {named + hidden} events are named; + n: n more at that place"


def draw_lines(panel: Any, events: Sequence[Event], width: float) -> None:
    """Draw an upright line at each event."""
    from matplotlib.collections import LineCollection

    for kind, look in KINDS.items():
        times = np.array([event.time for event in events if event.kind == kind])
        if not len(times):
            continue
        x = _apart(times, ONE_LINE * width)
        lines = [[(t, 0.0), (t, 1.0)] for t in x.tolist()]
        across = panel.get_xaxis_transform()
        marks = LineCollection(lines, transform=across, linewidths=0.7, zorder=1, gid=f"event {kind}", **look)
        panel.add_collection(marks, autolim=False)


def draw_labels(panel: Any, found: Sequence[Label]) -> None:
    """Write upright labels above the panel."""
    for label in found:
        panel.text(
            *(label.time, 1.03, label.text),
            transform=panel.get_xaxis_transform(),
            rotation=90,
            ha="center",
            va="bottom",
            fontsize="x-small",
            gid="event label",
        )


def draw_points(panel: Any, events: Sequence[Event], x: Array, y: Array) -> None:
    """Draw a marker on a curve at each event.

    Parameters
    ----------
    panel : matplotlib axes
    events : sequence of Event
    x, y : (number of events,) arrays, the places of the events on the curve
    """
    for kind in KINDS:
        mine = np.array([event.kind == kind for event in events], dtype=bool)
        if not np.any(mine):
            continue
        marker = style.MARKERS["open" if kind == "opened" else kind]
        look = dict(marker=marker.shape, markerfacecolor=marker.face, color="black", markersize=5)
        panel.plot(x[mine], y[mine], linestyle="none", gid=f"event {kind}", zorder=4, **look)


def event_handles(events: Sequence[Event], points: bool) -> list[Any]:
    """Return the entries of the legend: each kind with its line, its marker if there are points, and its count."""
    found = []
    for kind, look in KINDS.items():
        count = sum(event.kind == kind for event in events)
        if count:
            marker = style.MARKERS["open" if kind == "opened" else kind]
            shape = dict(marker=marker.shape, markerfacecolor=marker.face, markeredgecolor="black") if points else {}
            found.append(style.line_handle(style.count_label(kind, count), linewidth=0.9, **shape, **look))
    return found


def _apart(times: Array, least: float) -> Array:
    """Return the times without those that lie within `least` of another one."""
    times = np.unique(times)
    if least <= 0 or not len(times):
        return times
    _, first = np.unique(np.floor((times - times[0]) / least), return_index=True)
    return times[first]


# Sizes [inch]: width; height of a panel against time, of that of load and displacement, of a line of text, of a letter
# of an upright label, and of title and axis.
WIDTH, HEIGHT, LOAD_HEIGHT, LINE, LETTER, TEXT = 9.5, 1.45, 2.7, 0.16, 0.062, 1.3
# Notes that are shown at most, and letters of a line of them.
MOST_NOTES, NOTE_LINE = 3, 120
# Up to this number of instants each is marked, since the lines between them are chords.
MARKED_INSTANTS = 60
# Curves that vary by less than this part of the size of their terms vary by rounding, and are drawn flat.
FLAT = 1e-9
# Larger numbers cannot be drawn within the range of doubles.
LARGEST = 1e300


@checked
def draw_history(history: History, file: str | Path, *, title: str = "", time_unit: str = "") -> None:
    """Draw a load path or a motion: displacements, gaps and forces of contacts, energies, and every event.

    Parameters
    ----------
    history : History
        A history of `follow_path`, `impact` or `run`, or the `history` of a `NotConverged`.
    file : str or Path
        A file that ends in .png, .pdf or .svg.
    title : str
        The title of the picture.
    time_unit : str
        Unit of the times of a motion, for labels.

    Raises
    ------
    InvalidProblem
        The suffix is unknown, the folder does not exist, or `history` is not a History.
    BackendMissing
        matplotlib is not installed.

    Notes
    -----
    For a load path the curves are those of the unknowns whose loads do most work, and of the contacts with the largest
    forces; where contacts are left out, another curve shows the sum of all. A load path also has the load over the
    displacement, for up to three loads that come one by one, or up to four loaded unknowns. A motion shows the unknowns
    that its contacts touch.
    """
    path = style.check_picture(file)
    style.save(history_figure(history, title=title, time_unit=time_unit), path)


def history_figure(history: History, *, title: str = "", time_unit: str = "") -> Figure:
    """Return the figure that `draw_history` writes."""
    fields = history_fields(history)
    panels, load = time_panels(fields, time_unit), load_panel(fields)
    width = float(np.ptp(fields.times))
    found, remarks = labels(fields.events, width), _remarks(fields)
    heights = [HEIGHT] * len(panels) + [LOAD_HEIGHT] * (load is not None)
    letters = max((len(label.text) for label in found), default=0)
    result = style.new_figure(WIDTH, sum(heights) + TEXT + LETTER * letters + LINE * len(remarks))
    axes = result.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    for place, (drawn, panel) in enumerate(zip(axes, panels, strict=False)):
        _draw_curves(drawn, panel, [fields.times] * len(panel.curves))
        draw_lines(drawn, fields.events, width)
        if place:
            drawn.sharex(axes[0])
        if place < len(panels) - 1:
            drawn.tick_params(labelbottom=False)
    draw_labels(axes[0], found)
    axes[len(panels) - 1].set_xlabel(time_label(fields, time_unit, history.time_label))
    if load is not None:
        _draw_load(axes[-1], load, fields)
    if remarks:
        below = dict(xycoords="axes fraction", xytext=(0, -34), textcoords="offset points", annotation_clip=False)
        axes[-1].annotate("\n".join(remarks), (0, 0), va="top", fontsize="small", gid="remarks", **below)
    result.suptitle(style.headline(title, _headline(fields)))
    handles = event_handles(fields.events, points=load is not None)
    style.add_legend(result, handles, columns=max(len(handles), 1))
    return result


def cases_figure(many: Solutions, *, title: str = "", names: Sequence[str] | None = None) -> Figure:
    """Return the figure of many load cases: gaps and forces of contacts over the cases.

    A few cases with `names` are named below the axis, others numbered.

    Curves are those of the contacts with the largest forces, and of all together. A case without an answer is a gap in
    the curves and an upright line.

    Raises InvalidProblem: the problem has no contacts, or `names` are not one for each case.
    """
    if not many.problem.contacts:
        raise InvalidProblem("draw: expected cases with contacts, got none; displacement(i) is that of case i")
    fields = case_fields(many)
    finite = fields.gap[np.isfinite(fields.gap)]
    panels = contact_panels(fields, chosen_contacts(fields), float(np.max(abs(finite), initial=0.0)))
    failed = np.flatnonzero(~many.passed)
    result = style.new_figure(WIDTH, HEIGHT * len(panels) + TEXT)
    axes = result.subplots(len(panels), 1, squeeze=False, sharex=True)[:, 0]
    for drawn, panel in zip(axes, panels, strict=True):
        _draw_curves(drawn, panel, [fields.times] * len(panel.curves))
        for case in _apart(failed.astype(float), ONE_LINE * len(many)).tolist():
            drawn.axvline(case, color=style.PRESSURE, linewidth=0.8, zorder=1, gid="failed case")
    axes[-1].set_xlabel("load case")
    called = read_names("names", names, len(many)) or ()
    if 0 < len(called) <= NAMED_CASES:
        short = [style.plain(name, most=MOST_LETTERS) for name in called]
        axes[-1].set_xticks(range(len(many)), short, rotation=30 if max(map(len, short)) > SHORT_NAME else 0)
    else:
        axes[-1].xaxis.get_major_locator().set_params(integer=True)
    what = f"{counted('load case', len(many))}, {int(many.passed.sum())} passed"
    result.suptitle(style.headline(title, what))
    handle = style.line_handle(f"without a certified answer: {len(failed)}", color=style.PRESSURE, linewidth=0.8)
    style.add_legend(result, [handle] if len(failed) else [], columns=1)
    return result


def _draw_curves(axes: Any, panel: Panel, abscissas: Sequence[Array]) -> None:
    handles = []
    for curve, x in zip(panel.curves, abscissas, strict=True):
        look = _look(curve) | (dict(marker=".", markersize=4) if len(x) <= MARKED_INSTANTS else {})
        handles += axes.plot(_drawable(x), _drawable(curve.y), gid=curve.label, label=style.plain(curve.label), **look)
    low, high = _range(panel.curves)
    if high - low < FLAT * panel.size:
        middle = (low + high) / 2
        room = 0.05 * max(panel.size, FLAT * abs(middle))  # a gap that stays open dwarfs other terms
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
        draw_points(axes, fields.events, _drawable(x)[instants], _drawable(curve.y)[instants])


def _range(curves: Sequence[Curve]) -> tuple[float, float]:
    """Return the least and the largest value drawn, zero where there is none."""
    values = np.concatenate([_drawable(curve.y) for curve in curves])
    values = values[np.isfinite(values)]
    return (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)


def _look(curve: Curve) -> dict[str, Any]:
    if curve.number == ALL:
        return dict(color="black", linestyle="-", linewidth=1.8)
    colours, dashes = style.LINE_COLOURS, style.DASHES
    return dict(color=colours[curve.number % len(colours)], linestyle=dashes[curve.number % len(dashes)], linewidth=1.4)


def _drawable(values: Array) -> Array:
    """Return values with NaN in place of those that are too large for a picture."""
    with np.errstate(invalid="ignore"):
        return np.where(abs(values) <= LARGEST, values, np.nan)


def _headline(fields: HistoryFields) -> str:
    what = "motion" if fields.moving else "load path"
    events = {0: "no event", 1: "1 event"}.get(len(fields.events), f"{len(fields.events)} events")
    instants = "1 instant" if len(fields.times) == 1 else f"{len(fields.times)} instants"
    return f"{what}: {instants}, {events}"


def _remarks(fields: HistoryFields) -> list[str]:
    """Return the lines below the panels: events without labels, values that are not drawn, notes of the history."""
    notes = [f"note: {note}" for note in fields.notes[:MOST_NOTES]]
    if len(fields.notes) > MOST_NOTES:
        notes.append(f"and {len(fields.notes) - MOST_NOTES} more in history.notes")
    hidden = thinned(labels(fields.events, float(np.ptp(fields.times))))
    lines = [line for text in (hidden, _undrawn(fields), *notes) for line in textwrap.wrap(text, NOTE_LINE)]
    return [line.replace("$", r"\$") for line in lines]


def _undrawn(fields: HistoryFields) -> str:
    """Return a remark on instants with values that are not finite or too large; empty where there are none."""
    values = [fields.displacement, fields.normal_force, np.column_stack([fields.times, *fields.energies.values()])]
    count = int(np.sum(np.any([~np.all(abs(value) <= LARGEST, axis=1) for value in values], axis=0)))
    return f"{count} instants with values beyond {LARGEST:g} are left out" if count else ""
