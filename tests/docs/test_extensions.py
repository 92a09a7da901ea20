"""What the pages' own extensions make of docstrings and fields."""

from __future__ import annotations

import sys
from dataclasses import dataclass

import pytest

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


@dataclass(frozen=True)
class More(Example):
    """With a field of its own."""

    fourth: str = ""


def test_fields_are_described_by_the_comments_behind_them() -> None:
    assert field_comments(Example) == {
        "first": ("float", "[m]"),
        "second": ("int or None", "where none, nothing"),
        "third": ("str", ""),
    }


def test_fields_of_a_base_come_first() -> None:
    assert list(field_comments(More)) == ["first", "second", "third", "fourth"]


def test_absolute_values_are_escaped_outside_of_literals_only() -> None:
    lines = ["|x| and `|y|`", "formula::", "", "    |z|", "", "after |w|", ">>> a | b"]
    assert escaped(lines) == ["\\|x\\| and `|y|`", "formula::", "", "    |z|", "", "after \\|w\\|", ">>> a | b"]


def test_public_names_are_told_from_words() -> None:
    pytest.importorskip("sphinx", reason="the extra docs")
    from public_names import public_name

    named = ["Solution", "contactqp.solve", "cq.certify", "exact()", "problems()"]
    assert [public_name(text) for text in named] == [
        "contactqp.Solution",
        "contactqp.solve",
        "contactqp.certify",
        "contactqp.exact",
        "contactqp.testing.problems",
    ]
    words = ["exact", "solve", "Nobody", "history.pair", "contactqp.certificate.bounds", "u'Ku"]
    assert [text for text in words if public_name(text)] == []


@pytest.mark.parametrize(
    ("formula", "understood"), [(r"\frac{u}{2}", True), (r"\begin{aligned} u &= 1 \end{aligned}", False)]
)
def test_a_formula_that_is_not_understood_is_noticed(formula: str, understood: bool) -> None:
    pytest.importorskip("sphinx", reason="the extra docs")
    from latex2mathml.converter import convert
    from mathml import LEFT_OVER

    assert (LEFT_OVER.search(convert(formula)) is None) == understood
