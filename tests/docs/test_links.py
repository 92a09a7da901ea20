"""Links in README.md and between the pages lead somewhere, headings included."""

from __future__ import annotations

import re

import pytest

from tests.docs.blocks import FENCE, ROOT, pages

LINK = re.compile(r"\]\((?!https?://|mailto:)([^)\s]+)\)")


def slug(heading: str) -> str:
    """The anchor of a heading, as GitHub and MyST make it."""
    kept = re.sub(r"[^\w\- ]", "", heading.strip().lower())
    return kept.replace(" ", "-")


def broken(page: str, text: str) -> list[str]:
    """The links of a page that lead nowhere."""
    found = []
    for link in LINK.findall(FENCE.sub("", text)):
        path, _, anchor = link.partition("#")
        target = ((ROOT / page).parent / path).resolve() if path else ROOT / page
        if not target.exists():
            found.append(link)
        elif anchor:
            headings = re.findall(r"^#+ (.+)$", FENCE.sub("", target.read_text()), re.MULTILINE)
            found += [link] if anchor not in map(slug, headings) else []
    return found


@pytest.mark.parametrize("page", pages())
def test_the_links_of_a_page_lead_somewhere(page: str) -> None:
    assert broken(page, (ROOT / page).read_text(encoding="utf-8")) == []


def test_a_broken_link_and_a_broken_anchor_are_found() -> None:
    text = "[a](docs/none.md) [b](docs/tour.md#no-such-heading) [c](#nor-this) [d](docs/tour.md#a-bar-and-a-wall)"
    assert broken("README.md", text) == ["docs/none.md", "docs/tour.md#no-such-heading", "#nor-this"]
