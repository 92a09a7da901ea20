"""The style of pictures: colours, markers, labels with units, legends, magnification, pieces of elements, files."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.elements.mesh import Mesh
from contactqp.elements.reference_elements import Block, Reference, facet_keys
from contactqp.errors import InvalidProblem
from contactqp.exchange.files import PICTURES, check_file, check_installed, write_whole
from contactqp.model.arrays import Array, Index
from contactqp.model.problem import Units

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOUR_MAP = "viridis"
# Colours of Okabe and Ito (2008), distinct to colour-blind readers and from those of the colour map.
PRESSURE, UNDEFORMED, OBSTACLE, OUTLINE = "#D55E00", "0.5", "0.3", "0.15"
LOAD = "#AA3377"  # of P. Tol's bright scheme
FRICTION = "#117733"  # of his muted one
# Colours of curves, without the yellow of Okabe and Ito, which is too light for a line on white; and dashes, which
# distinguish curves in print.
LINE_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (7, 2, 1, 2, 1, 2)), (0, (2, 1)), (0, (9, 3)))
# Length of the longest arrow, relative to the size of the bodies.
ARROW = 0.14
# Arrows shorter than this part of the longest would be dots, and are not drawn.
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
    """Return the unit of length, ``"mm"``, or the dimension where no unit is stated."""
    return units.length or "length"


def force_unit(units: Units) -> str:
    """Return the unit of force, ``"N"``, or the dimension where no unit is stated."""
    return units.force or "force"


def pressure_unit(units: Units) -> str:
    """Return the unit of pressures and stresses, ``"N/mm²"``.

    >>> pressure_unit(Units(length="m", force="kN")), pressure_unit(Units())
    ('kN/m²', 'force/length²')
    """
    return f"{force_unit(units)}/{length_unit(units)}²"


def energy_unit(units: Units) -> str:
    """Return the unit of energy, ``"N·mm"``.

    >>> energy_unit(Units(length="m", force="kN")), energy_unit(Units())
    ('kN·m', 'force·length')
    """
    return f"{force_unit(units)}·{length_unit(units)}"


def plain(text: str, most: int = 40) -> str:
    """Return a user's text for matplotlib, shortened and escaped: dollars and a leading underscore have no special
    meaning.

    >>> plain("$a$"), plain("_tip"), plain("abcdef", most=4)
    ('\\\\$a\\\\$', ' _tip', 'abc…')
    """
    short = text if len(text) <= most else f"{text[: most - 1]}…"
    return (" " if short.startswith("_") else "") + short.replace("$", r"\$")


def colour_range(values: Array) -> tuple[float, float]:
    """Return the least and the largest value, or a wider range where they differ by rounding only."""
    low, high = float(values.min()), float(values.max())
    size = max(abs(low), abs(high))
    if high - low > 1e-6 * size:
        return low, high
    return (0.9 * low, 1.1 * high) if size > 0 else (0.0, 1.0)


def number(value: float) -> str:
    """Return a number with four digits, without exponent where that is readable.

    >>> number(14992.27), number(0.00012345), number(2.5e-9)
    ('14990', '0.0001234', '2.5e-09')
    """
    if value == 0 or 1e-4 <= abs(value) < 1e7:
        return np.format_float_positional(value, precision=4, fractional=False, trim="-")
    return f"{value:.4g}"


def count_label(status: str, number: int) -> str:
    """Return a state with its count: ``"closed (13)"``."""
    return f"{status} ({number})"


def arrows_to_draw(position: Array, value: Array, most: int) -> Index:
    """Return the contacts that get an arrow: all under force, or about `most` of them, the largest included.

    `position` (p, d) and `value` (p,) are those of the contacts, which are counted along the longest side of the box
    around them.
    """
    largest = float(np.nanmax(value, initial=0.0))
    along = position[:, np.argmax(np.ptp(position, axis=0))] if len(position) else np.zeros(0)
    order = np.argsort(along, kind="stable")
    pushing = order[value[order] > DOT * largest]
    if not len(pushing):
        return pushing
    return np.unique([*pushing[:: -(-len(pushing) // most)], pushing[np.argmax(value[pushing])]])


def load_label(load: Array, axes: Sequence[str], units: Units) -> str:
    """Return the entry of nodal loads (N, d) in a legend, with their resultant.

    >>> load_label(np.array([[0.0, -2.0], [0.0, -1.0]]), ("x", "y"), Units(force="kN"))
    'load, in all 0 and -3 kN along x and y, longest arrow 2 kN'
    """
    longest = float(np.linalg.norm(load, axis=1).max(initial=0.0))
    largest = float(np.max(abs(load).sum(axis=0), initial=0.0))
    total = [0.0 if abs(part) <= 1e-12 * largest else part for part in load.sum(axis=0).tolist()]
    unit, along = force_unit(units), " and ".join(axes)
    return (
        f"load, in all {' and '.join(map(number, total))} {unit} along {along}, longest arrow {number(longest)} {unit}"
    )


def headline(title: str, text: str) -> str:
    """Return the user's title, if any, and below it what the picture shows."""
    return "\n".join(filter(None, [title.replace("$", r"\$"), text[0].upper() + text[1:]]))


def new_figure(width: float, height: float) -> Figure:
    """Return a figure of this size [inch], whose layout keeps its parts from overlapping."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def add_legend(figure: Figure, handles: Sequence[Any], columns: int) -> None:
    """Add a legend below everything else."""
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize="small", frameon=False)


def marker_handle(status: str, label: str) -> Any:
    """Return the entry of a contact point in a legend."""
    from matplotlib.lines import Line2D

    marker = MARKERS[status]
    return Line2D(
        [], [], linestyle="none", marker=marker.shape, color="black", markerfacecolor=marker.face, label=label
    )


def line_handle(label: str, **style: Any) -> Any:
    """Return the entry of a line in a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], label=label, **style)


def check_picture(file: str | Path) -> Path:
    """Return the file as a path if a picture can be written to it.

    Raises
    ------
    InvalidProblem
        The suffix is none of .png, .pdf and .svg, or the folder does not exist.
    BackendMissing
        matplotlib is not installed.
    """
    path = check_file(file, PICTURES)
    check_installed("matplotlib", f"drawing {path.name}")
    return path


def save(figure: Figure, file: Path) -> None:
    """Write the figure to a file, completely or not at all."""
    # The layout is done twice, since the first pass does not know the ticks. It may clip the labels of axes with equal
    # scales, so the file is saved with a tight bounding box.
    figure.draw_without_rendering()
    write_whole(file, lambda beside: figure.savefig(beside, dpi=160, bbox_inches="tight"))


# The largest displacement is magnified to at most this part of the picture's size...
LARGEST = 0.06
# ... and at least this part counts as visible without magnification.
VISIBLE = 0.02
# A gap that goes from g_0 to g is drawn as g_0 + scale (g - g_0), which magnified is an overlap for contacts that have
# closed, and a gap for bodies that overlapped and press: of at most this part of the picture's size.
OVERLAP = 0.002


def magnification(scale: float | None, size: float, displacement: Array, initial_gap: Array, gap: Array) -> float:
    """Return the stated scale, or 1, 2 or 5 times a power of ten that makes the displacements visible.

    Parameters
    ----------
    scale : float or None, the scale that the user states; None to choose one
    size : the largest side of the box around the undeformed bodies [length]
    displacement : (N, d) array [length]
    initial_gap, gap : (m,) arrays, gaps of all contacts, before and under the load [length]

    Raises
    ------
    InvalidProblem
        The scale is not finite or not positive.

    >>> magnification(None, 100.0, np.array([[0.0, -0.01]]), np.zeros(1), np.zeros(1))
    500.0
    >>> magnification(None, 100.0, np.array([[0.0, -0.01]]), np.array([0.01]), np.zeros(1))
    20.0
    >>> magnification(None, 100.0, np.array([[0.0, -0.01]]), np.array([-0.01]), np.zeros(1))
    20.0
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
    # A gap that closes, or an overlap that is pushed apart.
    touching = (closing > 0) | ((closing < 0) & (initial_gap < 0))
    start = np.where(closing > 0, np.maximum(initial_gap, 0.0), abs(initial_gap))
    allowed = (start + OVERLAP * size)[touching] / abs(closing[touching])
    return max(1.0, _rounded_down(min([LARGEST * size / largest, *allowed])))


def _rounded_down(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, at most the value but for rounding."""
    power = 10.0 ** math.floor(math.log10(value * (1 + 1e-12)))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-12)))


def scale_text(scale: float) -> str:
    """Return the sentence of the title on the scale.

    >>> scale_text(500.0), scale_text(1.0)
    ('displacements magnified 500 times', 'displacements true to scale')
    """
    return "displacements true to scale" if scale == 1 else f"displacements magnified {scale:g} times"


# The number of chords of a curved edge; for a parabola they are off by 1/144 of its rise.
CURVED_PIECES = 6
# Number of elements beyond which the curve of a single one is not visible.
MANY = 20_000


@dataclass(frozen=True, eq=False)
class Pieces:
    """Reference points (q, d) of one kind of element or facet, and the triangles (t, 3) between them."""

    points: Array
    triangles: Index


def pieces(kind: Reference, cuts: int) -> Pieces:
    """Return a triangle cut into cuts^2 triangles, or a quadrilateral into 2 cuts^2."""
    steps = np.arange(cuts + 1)
    i, j = (a.ravel() for a in np.meshgrid(steps, steps, indexing="ij"))
    a, b = (a.ravel() for a in np.meshgrid(steps[:-1], steps[:-1], indexing="ij"))
    corner = (cuts + 1) * a + b
    lower = np.stack([corner, corner + cuts + 1, corner + 1], axis=1)
    upper = np.stack([corner + cuts + 1, corner + cuts + 2, corner + 1], axis=1)
    if kind.linear.startswith("tri"):
        inside = i + j <= cuts
        place = np.cumsum(inside) - 1
        triangles = np.concatenate([lower[a + b < cuts], upper[a + b < cuts - 1]])
        return Pieces(np.stack([i, j], axis=1)[inside] / cuts, place[triangles])
    return Pieces(2 * np.stack([i, j], axis=1) / cuts - 1, np.concatenate([lower, upper]))


def cuts(block: Block) -> int:
    """Return the number of cuts of each edge of a block's elements; bilinear fields on quadrilaterals need two."""
    if len(block) > MANY:
        return 1
    if len(block.kind.nodes) > block.kind.corners:
        return CURVED_PIECES
    return 1 if block.kind.linear == "tri3" else 2


def sample(block: Block, values: Array, points: Array) -> Array:
    """Interpolate nodal values (N, c) at the reference points (q, d) of each element: Σ N_i values_i, (E, q, c)."""
    return np.asarray(np.matmul(block.kind.shape(points), values[block.nodes]))


def edges(mesh: Mesh) -> tuple[Block, ...]:
    """Return every edge of a plane mesh once, the inner ones too, by kind."""
    total = sum(len(block) for block in mesh.blocks)
    counts = np.concatenate([np.full(len(block), len(block.kind.facets)) for block in mesh.blocks])
    element = np.repeat(np.arange(total), counts)
    local = np.arange(len(element)) - np.repeat(np.cumsum(counts) - counts, counts)
    return tuple(_distinct(block) for block in mesh.facets_of(np.stack([element, local], axis=1)))


def _distinct(block: Block) -> Block:
    _, first = np.unique(facet_keys(block.nodes, block.kind.name), axis=0, return_index=True)
    return Block(block.kind, block.nodes[first])


def edge_points(block: Block) -> Array:
    """Return reference points (q, 1) along the lines of a block: the ends, or as many as a curve needs."""
    count = CURVED_PIECES if block.kind.name == "line3" else 1
    return np.linspace(-1.0, 1.0, count + 1)[:, np.newaxis]


def outline_points(kind: Reference) -> Array:
    """Return reference points (q, 2) once around a triangle or quadrilateral, along its edges."""
    corners = kind.nodes[: kind.corners]
    count = CURVED_PIECES if len(kind.nodes) > kind.corners else 1
    along = np.arange(count)[:, np.newaxis] / count
    following = np.roll(corners, -1, axis=0)
    return np.concatenate([start + along * (end - start) for start, end in zip(corners, following, strict=True)])


# Colours of a small picture: enough for a colour map in distinct bands and for the edges of letters.
PALETTE_SIZE = 64
# Pixels of the longer side of the smallest picture.
THUMBNAIL, DPI_OF_THUMBNAIL = 240, 60
THICKER = 2.0  # thin lines would vanish


def thumbnail(figure: Figure) -> bytes:
    """Return the first axes of a figure without text as a small PNG. The figure is modified."""
    from PIL import Image

    first = figure.axes[0]
    # Matplotlib 3.10 lays out a title that was removed, and a colour bar whose axes were.
    for field in (*first.collections, *first.images):
        if field.colorbar is not None:
            field.colorbar.remove()
    legend = first.get_legend()
    for part in (*figure.axes[1:], *figure.legends, *first.texts, *([legend] if legend is not None else [])):
        part.remove()
    for text in figure.texts:
        text.set_visible(False)
        text.set_in_layout(False)
    for line in first.lines:
        line.set_linewidth(THICKER * line.get_linewidth())
    first.set_title("")
    first.set_axis_off()
    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=DPI_OF_THUMBNAIL, bbox_inches="tight")
    with Image.open(drawn) as image:
        reduced = image.convert("RGB")
        reduced.thumbnail((THUMBNAIL, THUMBNAIL))
        reduced.quantize(PALETTE_SIZE, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    return small.getvalue()


def small_png(figure: Figure, dpi: float) -> bytes:
    """Return the figure as a PNG of at most `PALETTE_SIZE` colours, for pages that hold many of them.

    Colours are chosen by maximum coverage, so that a few arrows keep theirs beside large coloured bodies. There is no
    alpha channel. It needs Pillow, which matplotlib requires.
    """
    from PIL import Image

    drawn, small = io.BytesIO(), io.BytesIO()
    figure.draw_without_rendering()  # the layout is right from the second time on
    figure.savefig(drawn, format="png", dpi=dpi, bbox_inches="tight")
    with Image.open(drawn) as image:
        plain = image.convert("RGB")
        reduced = plain.quantize(PALETTE_SIZE, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    reduced.save(small, "PNG", optimize=True)
    return small.getvalue()
