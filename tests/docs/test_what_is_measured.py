"""The small table on the page about choosing a method, from the rows of a report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from contactqp.study.rows import Row, to_csv
from docs.generating import what_is_measured as page

ROWS = (
    Row(case="a", method="active-set", verdict="right", seconds=0.001),
    Row(case="b", method="active-set", verdict="right", seconds=0.002),
    Row(case="a", method="osqp", variant="raw", verdict="refused", seconds=0.001, claimed=True, flag_wrong=True),
    Row(case="a", method="osqp", variant="raw", verdict="not converged", seconds=9.0, claimed=False),
    Row(case="b", method="osqp", variant="raw", verdict="right", seconds=0.001, claimed=True, flag_wrong=False),
    Row(case="a", method="osqp", variant="polished", verdict="right", seconds=0.003),
    Row(case="b", method="osqp", variant="polished", verdict="right", seconds=0.002),
    Row(case="a", method="penalty", verdict="approximate", seconds=0.001, claimed=True, flag_wrong=False),
    Row(case="a", method="penalty", verdict="right", seconds=0.003, claimed=True, flag_wrong=False),
    Row(case="a", method="gurobi", verdict="missing"),
    Row(case="b", method="penalty", verdict="unsupported"),
)


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(page, "KEPT", tmp_path / "choosing.csv")
    (tmp_path / "results.csv").write_text(to_csv(ROWS))
    about = {"created": "2030-01-02T03:04", "machine": {"cores": 2, "python": "CPython 3.11"}, "versions": {"x": "1.0"}}
    (tmp_path / "results.json").write_text(json.dumps(about))
    page.keep(tmp_path)
    return tmp_path / "choosing.csv"


def test_a_report_is_counted_by_hand(kept: Path) -> None:
    assert kept.read_text().splitlines()[2:] == [
        "active-set,2,0,0,2,2,0,0,0,1.0",
        "osqp,2,3,1,2,2,0,2,1,2.0",  # 3 and 1 times as long
        "penalty,1,0,0,2,1,1,2,0,2.0",
    ]


@pytest.mark.usefixtures("kept")
def test_the_page_shows_what_is_kept() -> None:
    text = page.what_is_measured()
    assert text.startswith("2030-01-02, 2 cores, CPython 3.11; x 1.0.\n")
    assert "| `osqp` | 2 | 1 of 3 | 2 of 2 | 1 of 2 | 2.0 |" in text
    assert "| `penalty` | 1 |  | 1 of 2, 1 approximate | 0 of 2 | 2.0 |" in text


def test_what_is_kept_in_the_repository_is_no_more_than_was_tried() -> None:
    source, kept = page.read_kept()
    assert "contactqp" in source
    assert len(kept) >= 10
    for line in kept:
        assert int(line["raw_right"]) <= int(line["raw"])
        assert int(line["right"]) + int(line["approximate"]) <= int(line["answers"])
        assert int(line["called_wrongly"]) <= int(line["called_solved"])
