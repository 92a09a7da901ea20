"""The notebook runs from its first cell to its last, and says what its text says."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOK = Path(__file__).parents[2] / "docs" / "is_this_answer_right.ipynb"


@pytest.fixture(scope="module")
def run() -> tuple[dict[str, Any], str]:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {}
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        for cell in cells:
            if cell["cell_type"] == "code":
                assert cell["outputs"] == []  # outputs are what a reader's own run makes
                exec(compile("".join(cell["source"]), str(NOTEBOOK), "exec"), names)
    return names, said.getvalue()


def test_the_pasted_answer_is_right_to_its_digits(run: tuple[dict[str, Any], str]) -> None:
    names, _ = run
    assert names["judged"].passed
    assert not names["turned"].passed
    assert not names["large"].passed
    assert names["solution"].certificate.proven
    assert names["solution"].normal_force[0] == pytest.approx(names["force"][0], rel=1e-5)


def test_what_is_wrong_is_said(run: tuple[dict[str, Any], str]) -> None:
    _, said = run
    assert "compression='negative'" in said
    assert "REFUSED" in said


def test_a_notebook_shows_tables(run: tuple[dict[str, Any], str]) -> None:
    names, _ = run
    assert "<table" in names["solution"]._repr_html_()
