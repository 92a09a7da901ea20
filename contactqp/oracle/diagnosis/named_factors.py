"""Factors that a wrong answer may have, and what they are called: signs, units, halves, rings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# A factor this close to a known one is meant to be it.
CLOSE = 1e-4
LARGEST_POWER = 12
# Powers of ten of units, their names as problems have them.
LENGTHS = {"m": 0, "mm": -3, "cm": -2, "um": -6, "µm": -6, "km": 3}
FORCES = {"N": 0, "kN": 3, "MN": 6, "mN": -3}
WORDS = {"m": "metres", "mm": "millimetres", "cm": "centimetres", "um": "micrometres", "µm": "micrometres"}
ENGLISH_LENGTHS = {25.4: "inches", 2.54: "inches", 0.0254: "inches", 0.3048: "feet", 12.0: "feet and inches"}
ENGLISH_FORCES = {9.80665: "kilogram-force", 4.4482216153: "pound-force", 4448.2216153: "kilopound-force"}
OTHERS = (
    (2.0, "half", "both halves of a symmetric model added, or everything counted twice"),
    (0.5, "half", "half of a symmetric model"),
    (2 * np.pi, "radian", "a whole ring instead of one radian of it"),
    (1 / (2 * np.pi), "radian", "one radian of a ring instead of all of it"),
)


class NamedFactor(NamedTuple):
    """The kind of a factor, its exact value, and a guess in words, empty where there is nothing to say."""

    kind: str
    exact: float
    guess: str


def named_factor(factor: float, length: bool, unit: str) -> NamedFactor | None:
    """What a factor of displacements or of forces is called; None if it has no name.

    `unit` is the problem's own: a displacement 1000 times too large was given in the next smaller one.
    """
    if factor == 0:
        return NamedFactor("zero", 0.0, "")
    if abs(factor - 1) <= CLOSE:
        return NamedFactor("right", 1.0, "")
    sign, size = (1.0 if factor > 0 else -1.0), abs(factor)
    if abs(size - 1) <= CLOSE:
        return NamedFactor("sign", -1.0, "")
    power = round(float(np.log10(size)))
    if power and abs(power) <= LARGEST_POWER and abs(size / 10.0**power - 1) <= CLOSE:
        return NamedFactor("unit", sign * 10.0**power, _power_of_ten(power, length, unit))
    for known, called in (ENGLISH_LENGTHS if length else ENGLISH_FORCES).items():
        for exact in (known, 1 / known):
            if abs(size / exact - 1) <= CLOSE:
                return NamedFactor("unit", sign * exact, f"{called} somewhere")
    for exact, kind, guess in OTHERS:
        if abs(size / exact - 1) <= CLOSE:
            return NamedFactor(kind, sign * exact, guess)
    return None


def _power_of_ten(power: int, length: bool, unit: str) -> str:
    known = LENGTHS if length else FORCES
    if unit not in known:
        unit = "" if unit else ("m" if power > 0 else "mm") if length else ("kN" if power > 0 else "N")
    theirs = [name for name, size in known.items() if unit in known and size == known[unit] - power]
    if not theirs:
        return "another unit"
    return f"{WORDS.get(theirs[0], theirs[0])} instead of {WORDS.get(unit, unit)}"
