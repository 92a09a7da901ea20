"""Events in pictures of histories: a line at each, a label where there is room for one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.history import Event
from contactqp.pictures import style

# Of the width of a panel: what an upright label takes.
ROOM = 0.022
# Lines nearer than this part of the width are one line.
ONE_LINE = 1 / 2000
# Events whose contacts are named at one label, and letters of a name.
MOST_NAMED, MOST_LETTERS = 2, 20
KINDS: Mapping[str, dict[str, Any]] = {
    "closed": dict(color="black", linestyle="-"),
    "opened": dict(color="0.45", linestyle="--"),
    "slip": dict(color="#D55E00", linestyle="-."),
    "stick": dict(color="#0072B2", linestyle=":"),
}


@dataclass(frozen=True)
class Label:
    """What stands above the time of the first event that it is about."""

    time: float
    text: str
    events: int


def labels(events: Sequence[Event], width: float) -> list[Label]:
    """Labels that do not cover each other; one of several events stands at the first.

    Parameters
    ----------
    events : sequence of Event
    width : float
        The range of times that is drawn.

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
    """What the picture says of events without a label of their own, or nothing."""
    hidden = sum(label.events - 1 for label in found if label.events > MOST_NAMED)
    if not hidden:
        return ""
    named = sum(label.events for label in found) - hidden
    return f"{named} events are named; + n stands for n more there, {hidden} in all"


def draw_lines(panel: Any, events: Sequence[Event], width: float) -> None:
    """An upright line at each event."""
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
    """Upright, above the panel."""
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


def draw_points(panel: Any, events: Sequence[Event], x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    """A marker on a curve at each event, x and y (number of events,)."""
    for kind in KINDS:
        mine = np.array([event.kind == kind for event in events], dtype=bool)
        if not np.any(mine):
            continue
        marker = style.MARKERS["open" if kind == "opened" else kind]
        look = dict(marker=marker.shape, markerfacecolor=marker.face, color="black", markersize=5)
        panel.plot(x[mine], y[mine], linestyle="none", gid=f"event {kind}", zorder=4, **look)


def handles(events: Sequence[Event], points: bool) -> list[Any]:
    """For the legend: each kind with its line, its marker where there are points, and how many there are."""
    found = []
    for kind, look in KINDS.items():
        count = sum(event.kind == kind for event in events)
        if count:
            marker = style.MARKERS["open" if kind == "opened" else kind]
            shape = dict(marker=marker.shape, markerfacecolor=marker.face, markeredgecolor="black") if points else {}
            found.append(style.line_handle(style.count_label(kind, count), linewidth=0.9, **shape, **look))
    return found


def _apart(times: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """The first of those that lie within `least` of each other."""
    times = np.unique(times)
    if least <= 0:
        return times
    _, first = np.unique(np.floor((times - times[0]) / least), return_index=True)
    return times[first]
