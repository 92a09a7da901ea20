"""Formulas as MathML, which browsers show by themselves: MathJax would be fetched from a network."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util import logging

# What the converter does not know it leaves as it is: an environment's ampersands, a command's backslash.
LEFT_OVER = re.compile(r"<m[iotn]>(?:&|\\\w*)</m[iotn]>")
# Browsers align columns by style; the attribute is not in MathML Core.
COLUMN = re.compile(r'columnalign="(\w+)"')


def setup(app: Any) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(_mathml(node, "inline"))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="formula">{_mathml(node, "block")}</div>\n')
    raise nodes.SkipNode


def _mathml(node: nodes.math | nodes.math_block, display: str) -> str:
    converted = convert(node.astext(), display=display)
    if left := LEFT_OVER.search(converted):
        logging.getLogger(__name__).warning("formula: %s is not understood", left[0], location=node)
    return COLUMN.sub(r'style="text-align: \1"', converted)
