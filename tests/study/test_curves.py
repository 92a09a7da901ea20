"""Every method looks like itself everywhere, and like no other."""

from __future__ import annotations

import importlib.util

import pytest

import contactqp as cq
from contactqp.study.curves import COLOURS, DASHES, STYLES, SYMBOLS, MethodStyle, method_style


def test_every_method_has_a_style_of_its_own() -> None:
    assert set(STYLES) == {method.name for method in cq.methods()}
    assert len({style.symbol for style in STYLES.values()}) == len(STYLES)  # never by colour alone
    assert len({(style.colour, style.dash) for style in STYLES.values()}) == len(STYLES)


def test_a_foreign_method_looks_the_same_every_time() -> None:
    first = method_style("my own method")
    assert first == method_style("my own method")
    assert (first.colour in COLOURS, first.symbol in SYMBOLS, first.dash in DASHES) == (True, True, True)
    assert len({method_style(f"method {i}") for i in range(40)}) > 30


def _luminance(colour: str) -> float:
    """Relative luminance of sRGB (WCAG 2)."""
    parts = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("colour", COLOURS)
def test_colours_are_seen_on_white_and_on_black(colour: str) -> None:
    light = _luminance(colour)
    assert 1.05 / (light + 0.05) > 2
    assert (light + 0.05) / 0.05 > 3


@pytest.mark.skipif(importlib.util.find_spec("plotly") is None, reason="plotly is not installed")
def test_plotly_knows_every_style() -> None:
    from plotly.graph_objects import Scatter

    for style in {*STYLES.values(), *(MethodStyle(COLOURS[0], symbol, DASHES[0]) for symbol in SYMBOLS)}:
        Scatter(marker=dict(symbol=style.symbol, color=style.colour), line=dict(dash=style.dash))
        Scatter(marker=dict(symbol=style.hollow))
