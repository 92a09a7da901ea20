"""An axis of difficulty: a name, its values, and a function from a value to a problem with its truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from contactqp.study.stability.posed import Posed

# Values as near as this to one are named by their distance from it.
NEXT_TO_ONE = 1e-2


@dataclass(frozen=True)
class Axis:
    """One axis.

    `pose` returns the same problem for the same value, always. Values are powers of two where that keeps the data
    doubles.
    """

    name: str
    title: str
    quantity: str  # what the values are, with its unit: the title of an axis of a chart
    values: tuple[float, ...]
    pose: Callable[[float], Posed] = field(repr=False)
    about: str = ""  # what is swept, and why
    labels: tuple[str, ...] = ()  # of the values, where they are no numbers
    # Where the values are a method's own knob: the names of the methods that are swept, and their knobs.
    knobs: Mapping[str, str] = field(default_factory=dict)
    # The largest value that is tried, and why: beyond it the study would take too long.
    largest: float = float("inf")
    why_largest: str = ""

    def label(self, value: float) -> str:
        """The value in words."""
        if self.labels:
            return self.labels[self.values.index(value)]
        # Of what lies next to one, the distance is what matters.
        return f"1{value - 1:+.2g}" if 0 < abs(value - 1) < NEXT_TO_ONE else f"{value:.4g}"


def powers_of_two(*exponents: int) -> tuple[float, ...]:
    """2^e for each exponent."""
    return tuple(2.0**e for e in exponents)
