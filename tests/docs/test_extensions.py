"""What the pages' own extensions make of docstrings and fields."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from tests.docs.blocks import DOCS

sys.path.insert(0, str(DOCS / "extensions"))

from absolute_values import escaped
from commented_fields import field_comments


@dataclass(frozen=True)
class Example:
    """With fields."""

    first: float  # [m]
    second: int | None  # where none, nothing
    _hidden: int = 0
    third: str = ""


def test_fields_are_described_by_the_comments_behind_them() -> None:
    assert field_comments(Example) == {
        "first": ("float", "[m]"),
        "second": ("int or None", "where none, nothing"),
        "third": ("str", ""),
    }


def test_absolute_values_are_escaped_outside_of_literals_only() -> None:
    lines = ["|x| and `|y|`", "formula::", "", "    |z|", "", "after |w|", ">>> a | b"]
    assert escaped(lines) == ["\\|x\\| and `|y|`", "formula::", "", "    |z|", "", "after \\|w\\|", ">>> a | b"]
