"""How a method looks in every chart: the same colour, symbol and dash wherever it appears."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from zlib import crc32

# Okabe and Ito (2008), distinct to colour-blind readers. Their yellow is too light on white; for their black stands a
# grey that is seen on white and on black.
BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
GREY = "#767676"
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, GREY)
# Plotly's names; each has an "-open" twin.
SYMBOLS = ("circle", "square", "diamond", "cross", "x", "triangle-up", "triangle-down", "pentagon", "star", "hexagram")
# "solid", or lengths of line and space.
DASHES = ("solid", "6px,3px", "2px,2px", "8px,2px,2px,2px", "12px,3px", "8px,2px,2px,2px,2px,2px")


@dataclass(frozen=True)
class MethodStyle:
    """Colour, symbol and dash of one method, in Plotly's words."""

    colour: str
    symbol: str
    dash: str

    @property
    def hollow(self) -> str:
        """The symbol without filling."""
        return f"{self.symbol}-open"


# No two share a symbol, so that print without colour can be read; no two share colour and dash, for lines without
# symbols.
STYLES: Mapping[str, MethodStyle] = {
    "active-set": MethodStyle(VERMILION, "star", DASHES[0]),
    "osqp": MethodStyle(BLUE, "circle", DASHES[0]),
    "clarabel": MethodStyle(GREEN, "square", DASHES[0]),
    "piqp": MethodStyle(PURPLE, "diamond", DASHES[0]),
    "proxqp": MethodStyle(ORANGE, "triangle-up", DASHES[0]),
    "daqp": MethodStyle(SKY, "triangle-down", DASHES[0]),
    "highs": MethodStyle(GREY, "pentagon", DASHES[0]),
    "scs": MethodStyle(BLUE, "cross", DASHES[1]),
    "qpalm": MethodStyle(GREEN, "x", DASHES[1]),
    "pyqpmad": MethodStyle(PURPLE, "triangle-left", DASHES[1]),
    "sip": MethodStyle(ORANGE, "triangle-right", DASHES[1]),
    "qtqp": MethodStyle(SKY, "hexagram", DASHES[1]),
    "gurobi": MethodStyle(GREY, "hexagon", DASHES[1]),
    "cvxpy": MethodStyle(VERMILION, "diamond-tall", DASHES[1]),
    "lemke": MethodStyle(BLUE, "hourglass", DASHES[2]),
    "projected-gauss-seidel": MethodStyle(GREEN, "bowtie", DASHES[2]),
    "master-slave": MethodStyle(PURPLE, "star-square", DASHES[2]),
    "lagrange-multiplier": MethodStyle(ORANGE, "star-diamond", DASHES[2]),
    "penalty": MethodStyle(SKY, "diamond-wide", DASHES[2]),
    "perturbed-lagrangian": MethodStyle(GREY, "star-triangle-up", DASHES[2]),
    "augmented-lagrangian": MethodStyle(VERMILION, "star-triangle-down", DASHES[2]),
}


def method_style(name: str) -> MethodStyle:
    """The style of a method, whatever else is shown beside it.

    Names that are not in `STYLES` get one that depends on nothing but the name; two such may coincide.

    Examples
    --------
    >>> method_style("osqp")
    MethodStyle(colour='#0072B2', symbol='circle', dash='solid')
    """
    if name in STYLES:
        return STYLES[name]
    number = crc32(name.encode())
    symbol, rest = number % len(SYMBOLS), number // len(SYMBOLS)
    return MethodStyle(COLOURS[rest % len(COLOURS)], SYMBOLS[symbol], DASHES[rest // len(COLOURS) % len(DASHES)])
