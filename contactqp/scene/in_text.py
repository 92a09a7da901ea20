"""Numbers drawn with letters: a bar for each of them, or the course of many in one line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

# Of the largest value; what is smaller is drawn as zero.
ROUNDING = 1e-12


@dataclass(frozen=True)
class Letters:
    """What bars and lines are made of."""

    full: str
    starts: str  # growing parts of a letter, from the left
    ends: str  # growing parts of a letter, from the right
    heights: str  # growing from the bottom
    zero: str
    axis: str


BLOCKS = Letters("█", "▏▎▍▌▋▊▉", "▐", "▁▂▃▄▅▆▇█", "·", "│")
# Where the output's encoding has no blocks.
ASCII = Letters("#", "", "", ".:-=+*#@", "0", "|")


def bars(values: ArrayLike, width: int, letters: Letters = BLOCKS) -> list[str]:
    """A horizontal bar for each value, the largest as long as `width`; what is more than rounding has a trace of one.

    With negative values among them, bars go to both sides of an axis, and `width` is that of each side.
    """
    sizes = np.asarray(values, dtype=float)
    finite = np.abs(sizes[np.isfinite(sizes)])
    largest = float(np.max(finite, initial=0.0))
    both_sides = bool(np.any(sizes[np.isfinite(sizes)] < 0))
    return [_bar(value, largest, width, both_sides, letters) for value in sizes.tolist()]


def _bar(value: float, largest: float, width: int, both_sides: bool, letters: Letters) -> str:
    if not math.isfinite(value):
        return ""
    if abs(value) <= ROUNDING * largest:
        return f"{'':{width}}{letters.axis}" if both_sides else letters.zero
    # Divided first: the width times the largest double is none.
    length = abs(value) / largest * width
    if not both_sides:
        return _filled(length, letters.full, letters.starts)
    if value > 0:
        return f"{'':{width}}{letters.axis}{_filled(length, letters.full, letters.starts)}"
    return f"{_filled(length, letters.full, letters.ends)[::-1]:>{width}}{letters.axis}"


def _filled(length: float, full: str, parts: str) -> str:
    """So many letters, the last one in part; at least the smallest part."""
    steps = len(parts) + 1
    whole, part = divmod(max(round(length * steps), 1), steps)
    return full * whole + (parts[part - 1] if part else "")


def course(values: ArrayLike, width: int, letters: Letters = BLOCKS) -> str:
    """The course of values in one line of at most `width` letters, from the least of them, or zero, to the largest.

    Of values that share a letter the one furthest from zero is drawn; zero has a letter of its own.
    """
    numbers = np.asarray(values, dtype=float)
    finite = numbers[np.isfinite(numbers)]
    low, high = float(np.min(finite, initial=0.0)), float(np.max(finite, initial=0.0))
    return "".join(_height(value, low, high, letters) for value in _furthest(numbers, width))


def _furthest(numbers: np.ndarray, width: int) -> Sequence[float]:
    parts = np.array_split(numbers, min(width, len(numbers))) if len(numbers) else []
    return [float(part[np.argmax(np.abs(part))]) for part in parts]


def _height(value: float, low: float, high: float, letters: Letters) -> str:
    if not math.isfinite(value):
        return "?"
    if high <= low or abs(value) <= ROUNDING * max(high, -low):
        return letters.zero
    steps = len(letters.heights)
    # Halved where need be: the difference of the largest doubles of both signs is none, half of the smallest is zero.
    half = 1.0 if math.isfinite(high - low) else 0.5
    part = (half * value - half * low) / (half * high - half * low)
    return letters.heights[min(int(part * steps), steps - 1)]
