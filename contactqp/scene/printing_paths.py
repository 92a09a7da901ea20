"""What happened on a load path or in a motion: events, limit points and notes, of one that was cut short too."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.markup import escape

from contactqp.analysis.history import History
from contactqp.analysis.large.deformation import LargeHistory
from contactqp.scene.corners import has_corners
from contactqp.scene.judging import Failure
from contactqp.scene.schema import SceneData
from contactqp.scene.tables import print_table, written


def print_failure(console: Console, failure: Failure) -> None:
    """How far a path or a motion came that was cut short; the message itself is not printed."""
    history = failure.history
    if history is None or len(history) == 0:
        return
    what = when(failure.scene)
    console.print(escape(f"{failure.scene.title}: {len(history)} instants so far, to {what} {history.times[-1]:.12g}"))
    print_way(console, history, what)
    print_notes(console, history)


def print_way(console: Console, history: History, when: str) -> None:
    """Events and limit points."""
    names = history[-1].problem.contact_name
    rows = [[event.kind, event.name or names(event.contact), written(event.time)] for event in history.events]
    print_table(console, ["event", "contact", when], rows)
    if isinstance(history, LargeHistory):
        points = [[point.kind, written(point.load_factor), _shape(point.smooth)] for point in history.limit_points]
        print_table(console, ["limit point", "load factor", "form"], points)


def _shape(smooth: bool) -> str:
    return "smooth" if smooth else "corner: a contact closes or opens"


def print_notes(console: Console, history: History) -> None:
    for note in history.notes:
        console.print(f"[yellow]{escape(note)}[/yellow]")


def when(scene: SceneData) -> str:
    """What the time of an event is."""
    if scene.motion is not None:
        return "time [s]"
    return "time" if has_corners(scene) else "load factor"


def large_data(history: History) -> dict[str, Any]:
    """Load factors, limit points and snaps of a large deformation."""
    if not isinstance(history, LargeHistory):
        return {}
    return {
        "load_factors": [float(t) for t in history.times],
        "stable": [bool(stable) for stable in history.stable],
        "limit_points": [
            {"kind": point.kind, "load_factor": point.load_factor, "after": point.after, "smooth": point.smooth}
            for point in history.limit_points
        ],
        "snap_throughs": [{"above": snap.low, "load_factor": snap.high} for snap in history.snaps],
    }
