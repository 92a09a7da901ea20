"""What the pages under docs/ show runs, and prints what they say."""

from __future__ import annotations

import pathlib
import re

import pytest

DOCS = pathlib.Path(__file__).parent.parent / "docs"


def shown(page: str) -> list[tuple[str, str | None]]:
    """The Python blocks of a page, each with what the text block right behind it says is printed."""
    text = (DOCS / page).read_text()
    found = re.findall(r"```python\n(.*?)```(?:\n+```text\n(.*?)```)?", text, re.DOTALL)
    return [(code, printed or None) for code, printed in found]


@pytest.mark.parametrize("page", ["constrained_energy.md"])
def test_a_page_prints_what_it_shows(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    scope: dict[str, object] = {}
    blocks = shown(page)
    assert len([printed for _, printed in blocks if printed]) >= 6
    for code, printed in blocks:
        exec(compile(code, page, "exec"), scope)
        assert capsys.readouterr().out == (printed or "")
