"""Formulas for a page: LaTeX becomes MathML, which browsers set without any library."""

from __future__ import annotations

from functools import lru_cache


@lru_cache(maxsize=4096)
def mathml(latex: str, display: str = "inline") -> str:
    """``<math>`` of a formula; `display` is "inline" or "block".

    >>> "<mi>K</mi><mi>u</mi>" in mathml("K u")
    True
    """
    from latex2mathml.converter import convert

    return str(convert(latex, display=display))
