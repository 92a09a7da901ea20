"""One step of a load path with friction: the slip of every contact counts from where it was, or from where it closed.

A contact that was closed before the step is anchored at its E_T u of then. One that closes within the step is anchored
at its E_T u at the fraction of the step at which its gap reaches zero: the contacts without an anchor are held open,
and where they overlap at the end of the step the first load at which one of them touches is searched for. On loads
between which no other contact changes its state gaps are linear, and the secant finds that load exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from contactqp.analysis.lazy_solutions import Unfinished
from contactqp.errors import NoEquilibrium, NotCertified, NotConverged, SeveralEquilibria
from contactqp.model.arrays import Array, Mask, Vector

# Loads tried for one closing: bisection takes over where the secant does not shrink its bracket.
MOST_LOADS = 60
# A bracket of this part of the leg holds a jump: no load shows the contact touching.
JUMP = 1e-13
# Halvings of a step towards a load that the bodies without the contacts that are to close still hold.
HALVINGS = 30


@dataclass(frozen=True, eq=False)
class State:
    """One equilibrium along a path, as far as the next one needs it."""

    fraction: float  # of the leg
    gap: Vector  # (m,) g - E_N u [length]; negative at contacts that were held open and overlap
    position: Array  # (m, d-1) E_T u [length]
    pushes: Mask  # (m,) which carry a force
    slides: Mask  # (m,) which of them slip
    touching: Mask  # (m,) closed, or with no gap but rounding
    overlap: Mask  # (m,) held open, and too far in to be rounding
    step: Unfinished


# The equilibrium at a fraction of the leg, from slip origins (m, d-1), with contacts held open.
Solve = Callable[[float, Array, Mask], State]


@dataclass(frozen=True, eq=False)
class Anchors:
    """Where contacts stood at the end of a step."""

    position: Array  # (m, d-1) E_T u
    anchored: Mask  # (m,)


def step_to(fraction: float, before: State, anchors: Anchors, solve: Solve) -> State:
    """The state at a fraction of the leg, contacts that close on the way anchored where they do.

    Raises
    ------
    NoEquilibrium, SeveralEquilibria, NotConverged
        Of the solve at the end of the step, all contacts anchored.
    """
    origin, anchored = anchors.position.copy(), anchors.anchored.copy()
    low = before
    while True:
        high = None if np.all(anchored) else _tried(solve, fraction, origin=origin, held_open=~anchored)
        if high is None and np.all(anchored):
            return solve(fraction, origin, ~anchored)
        if high is not None and not np.any(high.overlap):
            return high
        touched = _first_touch(low, high, fraction, partial(_tried, solve, origin=origin, held_open=~anchored))
        if touched is None:
            # What moves freely until it is stopped has no place where it closes; it is anchored where the step began.
            anchored[:] = True
            continue
        closing = ~anchored & (touched.touching | touched.overlap)
        origin[closing] = touched.position[closing]
        anchored |= closing
        low = touched


def _tried(solve: Solve, fraction: float, *, origin: Array, held_open: Mask) -> State | None:
    """The state, or None where the bodies without these contacts have none."""
    try:
        return solve(fraction, origin, held_open)
    except (NoEquilibrium, SeveralEquilibria, NotConverged, NotCertified):
        return None


def _first_touch(
    low: State, high: State | None, fraction: float, solve: Callable[[float], State | None]
) -> State | None:
    """The first state after `low` in which a contact that is held open touches, or None where motion is free."""
    if high is None:
        low, high = _furthest(low, fraction, solve)
        if high is None:
            return None
    same_side, last_over = 0, None
    for _ in range(MOST_LOADS):
        at = _secant(low, high) if same_side < 2 else 0.0
        if not low.fraction < at < high.fraction:
            at = (low.fraction + high.fraction) / 2
        if high.fraction - low.fraction <= JUMP:
            return high
        here = solve(at)
        if here is None:
            return high
        held = high.gap < 0
        if not np.any(here.overlap) and np.any(here.touching & held):
            return here
        over = bool(np.any(here.overlap))
        same_side = same_side + 1 if over == last_over else 0
        last_over, (low, high) = over, (low, here) if over else (here, high)
    return high


def _secant(low: State, high: State) -> float:
    """Where the first of the gaps that are negative at `high` vanishes if all are linear in between."""
    falls = high.overlap & (low.gap > high.gap)
    if not np.any(falls):
        return (low.fraction + high.fraction) / 2
    part = np.maximum(low.gap[falls], 0.0) / (np.maximum(low.gap[falls], 0.0) - high.gap[falls])
    return float(low.fraction + np.min(part) * (high.fraction - low.fraction))


def _furthest(low: State, fraction: float, solve: Callable[[float], State | None]) -> tuple[State, State | None]:
    """A state without overlap, and one with it, between `low` and a fraction that has none."""
    beyond = fraction
    for _ in range(HALVINGS):
        at = (low.fraction + beyond) / 2
        here = solve(at)
        if here is None:
            beyond = at
        elif np.any(here.overlap):
            return low, here
        else:
            low = here
    return low, None
