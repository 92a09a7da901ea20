"""Motions in reports: by active-set unless the case says otherwise, judged by what the case expects of its end."""

from pathlib import Path

import pytest

from contactqp.study.reporting import write_report
from contactqp.study.running.runner import Running

CASES = Path(__file__).parents[2] / "cases"
HERE = Running(jobs=0)
# Steps four times as long; the block comes to rest at the end of one all the same.
COARSE = {'"5 ms"': '"20 ms"', '"5.1 ms"': '"20.1 ms"'}
# Line by line what the file of the case ends with, and what becomes of it.
WRONG = ('value = "0.1962 m"', 'value = "0.1963 m"')


def coarse() -> str:
    """The case of a block that slides until it stops, in fewer steps."""
    text = (CASES / "sliding_block_stops.toml").read_text()
    for fine, longer in COARSE.items():
        assert text.count(fine) == 1
        text = text.replace(fine, longer)
    return text


@pytest.mark.slow
def test_a_report_steps_a_motion_by_active_set(tmp_path):
    (file := tmp_path / "stops.toml").write_text(coarse())
    result = write_report([file], tmp_path / "out", repeats=1, running=HERE)
    (row,) = result.rows
    assert (row.method, row.verdict, row.expectations_unmet) == ("active-set", "right", 0)
    assert any("a motion solves one small contact problem a step" in note for note in result.notes)
    assert not result.summary.unmet


@pytest.mark.slow
def test_a_report_tries_the_methods_that_a_case_names_and_finds_what_is_wrong(tmp_path):
    text = coarse()
    assert text.count(WRONG[0]) == 1
    file = tmp_path / "off.toml"
    limit = '[report]\nmethods = ["active-set", "clarabel"]\nwhy = "two are enough"\n\n[motion]'
    file.write_text(text.replace(*WRONG).replace("[motion]", limit))
    result = write_report([file], tmp_path / "out", tolerances=[1e-8], repeats=1, running=HERE)
    assert {row.method for row in result.rows} == {"active-set", "clarabel"}
    right = [row.expectations_unmet for row in result.rows if row.verdict == "right"]
    assert right
    assert set(right) == {1}
    assert any("displacement 1.x" in text for text in result.summary.unmet)
    assert result.exit_code == 1
