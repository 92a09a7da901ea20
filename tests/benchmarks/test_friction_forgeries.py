"""Forged answers with friction are refused, right ones are not, and the forgeries are worth their name."""

from __future__ import annotations

import pytest

from benchmarks.friction_forgeries import FAMILIES, run, table


@pytest.mark.slow
def test_no_forgery_passes_and_no_right_answer_is_refused() -> None:
    reports = run(5 * 8, jobs=1)
    assert not [report for report in reports if report.passed or report.right_refused]
    assert sum(report.hidden for report in reports) > 5  # they break no figure
    assert all(any(line.startswith(family) for line in table(reports)) for family in FAMILIES)
