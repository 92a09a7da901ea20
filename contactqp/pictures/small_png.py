"""Pictures as small PNG files for pages that hold many of them."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Of a palette: enough for a colour map of 256 colours in bands that are told apart, and for the letters' edges.
COLOURS = 64


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
        few = image.convert("RGB").quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(small, "PNG", optimize=True)
    return small.getvalue()
