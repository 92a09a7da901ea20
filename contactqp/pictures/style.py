"""How pictures look: colours, markers of the contact status, labels with units, legends, files."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.exchange.whole_file import PICTURES, check_file, check_installed, write_whole
from contactqp.model.arrays import Array
from contactqp.model.problem import Units

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Colour = Literal["displacement", "von mises"]
COLOURS: tuple[str, ...] = get_args(Colour)
COLOUR_MAP = "viridis"
# Colours of Okabe and Ito (2008), distinct to colour-blind readers and from the colour map's.
PRESSURE, UNDEFORMED, OBSTACLE, OUTLINE = "#D55E00", "0.5", "0.3", "0.15"
# Of curves: Okabe's and Ito's without their yellow, which is too light for a line on white; and dashes that tell curves
# apart in print.
LINE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (7, 2, 1, 2, 1, 2)), (0, (2, 1)), (0, (9, 3)))
# Of the longest arrow, relative to the size of the bodies.
ARROW = 0.14
# Smaller ones than this part of the longest are no more than a dot.
DOT = 1e-3


@dataclass(frozen=True)
class Marker:
    """The shape and the filling of a contact point."""

    shape: str
    face: str


MARKERS: Mapping[str, Marker] = {
    "open": Marker("o", "white"),
    "closed": Marker("o", "black"),
    "grazing": Marker("D", "0.7"),
    "stick": Marker("s", "black"),
    "slip": Marker("^", "black"),
    "held": Marker("X", "white"),
}


def length_unit(units: Units) -> str:
    """``"mm"``, or the dimension where no unit is stated."""
    return units.length or "length"


def force_unit(units: Units) -> str:
    """``"N"``, or the dimension where no unit is stated."""
    return units.force or "force"


def pressure_unit(units: Units) -> str:
    """``"N/mm²"``, of pressures and stresses.

    >>> pressure_unit(Units(length="m", force="kN")), pressure_unit(Units())
    ('kN/m²', 'force/length²')
    """
    return f"{force_unit(units)}/{length_unit(units)}²"


def energy_unit(units: Units) -> str:
    """``"N·mm"``.

    >>> energy_unit(Units(length="m", force="kN")), energy_unit(Units())
    ('kN·m', 'force·length')
    """
    return f"{force_unit(units)}·{length_unit(units)}"


def plain(text: str, most: int = 40) -> str:
    """A user's text as it is, shortened: dollars start no formula, an underline in front hides nothing in a legend.

    >>> plain("$a$"), plain("_tip"), plain("abcdef", most=4)
    ('\\\\$a\\\\$', ' _tip', 'abc…')
    """
    short = text if len(text) <= most else f"{text[: most - 1]}…"
    return (" " if short.startswith("_") else "") + short.replace("$", r"\$")


def colour_label(colour: str, units: Units) -> str:
    """What stands at the colour bar.

    Raises
    ------
    InvalidProblem
        There is no such colouring.
    """
    if colour == "displacement":
        return f"displacement, magnitude [{length_unit(units)}]"
    if colour == "von mises":
        return f"von Mises stress [{pressure_unit(units)}]"
    raise InvalidProblem(f"colour: expected one of {', '.join(map(repr, COLOURS))}, got {colour!r}")


def colour_range(values: Array) -> tuple[float, float]:
    """From the least to the largest value; wider where they differ by rounding only, so that ticks can be read."""
    low, high = float(values.min()), float(values.max())
    size = max(abs(low), abs(high))
    if high - low > 1e-6 * size:
        return low, high
    return (0.9 * low, 1.1 * high) if size > 0 else (0.0, 1.0)


def number(value: float) -> str:
    """Four digits, written out where that is readable.

    >>> number(14992.27), number(0.00012345), number(2.5e-9)
    ('14990', '0.0001234', '2.5e-09')
    """
    if 1e-4 <= abs(value) < 1e7:
        return np.format_float_positional(value, precision=4, fractional=False, trim="-")
    return f"{value:.4g}"


def count_label(status: str, number: int) -> str:
    """``"closed (13)"``."""
    return f"{status} ({number})"


def arrows_to_draw(position: Array, value: Array, most: int) -> NDArray[np.int64]:
    """Which contacts get an arrow: all that push; of more than `most` every so many-th, and always the largest.

    They are counted along the longest side of the box around their positions (p, d).
    """
    largest = float(np.nanmax(value, initial=0.0))
    along = position[:, np.argmax(np.ptp(position, axis=0))] if len(position) else np.zeros(0)
    order = np.argsort(along, kind="stable")
    pushing = order[value[order] > DOT * largest]
    if not len(pushing):
        return pushing
    return np.unique([*pushing[:: -(-len(pushing) // most)], pushing[np.argmax(value[pushing])]])


def headline(title: str, text: str) -> str:
    """The user's title, if any, and below it what the picture shows."""
    return "\n".join(filter(None, [title.replace("$", r"\$"), text[0].upper() + text[1:]]))


def new_figure(width: float, height: float) -> Figure:
    """A figure [inch] whose parts are laid out so that none covers another."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def add_legend(figure: Figure, handles: Sequence[Any], columns: int) -> None:
    """Below everything else."""
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize="small", frameon=False)


def marker_handle(status: str, label: str) -> Any:
    """A contact point in a legend."""
    from matplotlib.lines import Line2D

    marker = MARKERS[status]
    return Line2D(
        [], [], linestyle="none", marker=marker.shape, color="black", markerfacecolor=marker.face, label=label
    )


def line_handle(label: str, **style: Any) -> Any:
    """A line in a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **style)


def check_picture(file: str | Path) -> Path:
    """The file as a path, if a picture can be written to it.

    Raises
    ------
    InvalidProblem
        A suffix that is none of .png, .pdf and .svg, a folder that is not there.
    BackendMissing
        matplotlib is not installed.
    """
    path = check_file(file, PICTURES)
    check_installed("matplotlib", "report", f"drawing {path.name}")
    return path


def save(figure: Figure, file: Path) -> None:
    """Write the figure whole or not at all."""
    # The layout is right from the second time on: the first one does not know the ticks yet.
    figure.draw_without_rendering()
    write_whole(file, lambda beside: figure.savefig(beside, dpi=160))


# How many times larger than they are displacements are drawn.

# The largest displacement is drawn as at most this part of the picture's size...
LARGEST = 0.06
# ... and at least this part counts as visible without magnification.
VISIBLE = 0.02
# A gap that goes from g_0 to g is drawn as g_0 + scale (g - g_0), which magnified is an overlap for contacts that have
# closed: of at most this part of the picture's size.
OVERLAP = 0.01


def magnification(scale: float | None, size: float, displacement: Array, initial_gap: Array, gap: Array) -> float:
    """The stated scale, or 1, 2 or 5 times a power of ten that makes the displacements visible.

    Parameters
    ----------
    scale : float or None
        As stated by the user; None to choose one.
    size : float
        Of the undeformed bodies, the largest side of the box around them [length].
    displacement : (N, d) array [length]
    initial_gap, gap : (m,) arrays
        Of all contacts, before and under the load [length].

    Raises
    ------
    InvalidProblem
        A scale that is not finite or not positive.

    >>> magnification(None, 100.0, np.array([[0.0, -0.01]]), np.zeros(1), np.zeros(1))
    500.0
    >>> magnification(None, 100.0, np.array([[0.0, -0.01]]), np.array([0.01]), np.zeros(1))
    100.0
    >>> magnification(None, 100.0, np.array([[0.0, -3.0]]), np.zeros(1), np.zeros(1))
    1.0
    """
    if scale is not None:
        if not (math.isfinite(scale) and scale > 0):
            raise InvalidProblem(f"scale: expected a positive number, got {scale}")
        return float(scale)
    largest = float(np.linalg.norm(displacement, axis=1).max(initial=0.0))
    if largest >= VISIBLE * size or largest == 0:
        return 1.0
    closing = initial_gap - gap
    closes = closing > 0
    allowed = (np.maximum(initial_gap, 0.0) + OVERLAP * size)[closes] / closing[closes]
    return max(1.0, _rounded_down(min([LARGEST * size / largest, *allowed])))


def _rounded_down(value: float) -> float:
    """1, 2 or 5 times a power of ten, not above the value but for rounding."""
    power = 10.0 ** math.floor(math.log10(value * (1 + 1e-12)))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-12)))


def scale_text(scale: float) -> str:
    """What the title says of it.

    >>> scale_text(500.0), scale_text(1.0)
    ('displacements magnified 500 times', 'displacements true to scale')
    """
    return "displacements true to scale" if scale == 1 else f"displacements magnified {scale:g} times"


# Pictures as small PNG files for pages that hold many of them.

# Of a palette: enough for a colour map of 256 colours in bands that are told apart, and for the letters' edges.
PALETTE_SIZE = 64


def small_png(figure: Figure, dpi: float) -> bytes:
    """The figure as a PNG of at most `COLOURS` colours, without an alpha channel.

    Colours are chosen by maximum coverage: a few arrows keep theirs beside large coloured bodies. Needs Pillow, which
    matplotlib brings with it.
    """
    from PIL import Image

    drawn, small = io.BytesIO(), io.BytesIO()
    figure.draw_without_rendering()  # the layout is right from the second time on
    figure.savefig(drawn, format="png", dpi=dpi)
    with Image.open(drawn) as image:
        few = image.convert("RGB").quantize(PALETTE_SIZE, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(small, "PNG", optimize=True)
    return small.getvalue()
