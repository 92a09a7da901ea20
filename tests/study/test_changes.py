"""What changed between two reports: what did is told, what did not is not, and what is no report is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from contactqp.cli import main
from contactqp.study import reporting as report
from contactqp.study.report_data import changes, read_report
from contactqp.study.rows import Row, as_dicts
from tests.study.statistics_examples import right, wrong

UNIT = dict(linear_solve_seconds=1e-3)


def _report(*table: Row, osqp: str = "1.0", machine: str = "ours") -> dict[str, Any]:
    facts = dict(schema="contactqp-report", versions=dict(osqp=osqp, numpy="2.0"), machine=dict(processor=machine))
    return facts | dict(rows=as_dicts(table))


def test_nothing_has_changed_where_nothing_has() -> None:
    same = _report(right("a", "osqp", 1e-3, **UNIT))
    assert changes(same, same) == "no verdict, error or time has changed"


def test_verdicts_errors_times_and_versions_are_told() -> None:
    before = _report(right("a", "osqp", 1e-3, **UNIT), right("b", "osqp", 1e-3, **UNIT), right("c", "osqp", 1e-3))
    now = _report(
        wrong("a", "osqp", 1e-3, **UNIT), right("b", "osqp", 3e-3, **UNIT), right("d", "osqp", 1e-3), osqp="1.1"
    )
    lines = changes(before, now).splitlines()
    assert lines[:2] == [
        "osqp: 1.0 before, 1.1 now",
        "2 rows are in both reports, 1 in the old one alone, 1 in the new one alone",
    ]
    assert lines[2] == "a:"
    assert lines[3].split("  ")[-1] == "verdict right before, refused now"
    assert lines[4].endswith(" before, 5.0e-01 now")
    assert lines[5] == "b:"
    assert lines[6].split("  ")[-1] == "linear solves 1 before, 3 now"


def test_no_line_is_longer_than_a_terminal_is_wide() -> None:
    """A case, a method, an answer, a knob and what changed made 108 letters."""
    knob = dict(knob="perturbation", knob_value=4.8e10, variant="polished", **UNIT)
    names = [f"perturbed-lagrangian-{i}" for i in range(9)]
    before = _report(*(right("string_over_floor", name, 1e-3 * (1 + i), **knob) for i, name in enumerate(names)))
    now = _report(
        *(wrong("string_over_floor", name, 9e-3 / (1 + i), **knob) for i, name in enumerate(names)), osqp="2" * 70
    )
    lines = changes(before, now).splitlines()
    assert max(map(len, lines)) <= 80
    assert any("perturbed-lagrangian-8, polished, perturbation 4.8e+10" in line for line in lines)


@pytest.mark.parametrize(
    ("now", "spread", "told"), [(1.3e-3, None, False), (1.7e-3, None, True), (1.7e-3, 0.5, False), (5e-3, 0.5, True)]
)
def test_times_within_their_spread_are_the_same(now: float, spread: float | None, told: bool) -> None:
    before = _report(right("a", "osqp", 1e-3, seconds_spread=spread, **UNIT))
    after = _report(right("a", "osqp", now, seconds_spread=spread, **UNIT))
    assert ("linear solves" in changes(before, after)) is told


def test_a_slower_machine_is_no_slower_method() -> None:
    before = _report(right("a", "osqp", 1e-3, linear_solve_seconds=1e-3))
    after = _report(right("a", "osqp", 9e-3, linear_solve_seconds=9e-3), machine="theirs")
    text = changes(before, after)
    assert "the machine is another" in text
    assert text.endswith("no verdict, error or time has changed")


def test_errors_of_rounding_are_the_same() -> None:
    before, after = (_report(right("a", "osqp", 1e-3, error_judged=error, **UNIT)) for error in (1e-17, 8e-13))
    assert changes(before, after) == "no verdict, error or time has changed"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "No such file"),
        ("{", "no JSON"),
        ("[]", "other JSON"),
        ('{"schema": "x"}', "other JSON"),
        ('{"schema": "contactqp-report", "rows": [3]}', "other JSON"),
        ('{"schema": "contactqp-report", "rows": [{"seconds": "long"}]}', "other JSON"),
        ('{"schema": "contactqp-report", "rows": [{"case": []}]}', "other JSON"),
        ('{"schema": "contactqp-report", "rows": [], "versions": 3}', "other JSON"),
    ],
)
def test_what_is_no_report_is_refused_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str | None, told: str
) -> None:
    file = tmp_path / "old.json"
    if text is not None:
        file.write_text(text)
    with pytest.raises(SystemExit) as stopped:
        main(["report", "-o", str(tmp_path / "new"), "--compare", str(file)])
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "old.json: expected the results.json of a report" in error
    assert told in error
    assert not (tmp_path / "new").exists()


def test_the_command_prints_them_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new = tmp_path / "old.json", tmp_path / "results.json"
    old.write_text(json.dumps(_report(right("a", "osqp", 1e-3, **UNIT))))
    new.write_text(json.dumps(_report(wrong("a", "osqp", 1e-3, **UNIT))))
    empty = report.ReportResult(report.summarise((), ()), (), (), ())
    monkeypatch.setattr(report, "write_report", lambda *_, **__: empty)
    report.report([], str(tmp_path), compare=str(old))
    assert capsys.readouterr().out.rstrip().endswith(changes(read_report(old), read_report(new)))


def _timed(**linear_solves: float) -> dict[str, Any]:
    """A report in which each method has been timed on one body, with a spread of 30 %."""
    body: dict[str, Any] = dict(unknowns=1000, seconds_spread=0.3, **UNIT)
    return _report(*(right("a", method, 1e-3 * time, **body) for method, time in linear_solves.items()))


def test_methods_that_change_places_are_told_beyond_their_spreads() -> None:
    before = _timed(osqp=2.0, clarabel=3.0, piqp=9.0)
    assert changes(before, before).endswith("the 3 methods have the same order by time")
    neighbours = " ".join(changes(before, _timed(osqp=3.1, clarabel=3.0, piqp=9.0)).split())
    assert neighbours.endswith("same order by time, but for osqp and clarabel, whose times lie within their spreads")
    many = {name: 2.0 + i / 100 for i, name in enumerate(("osqp", "clarabel", "piqp", "daqp", "scs"))}
    turned = dict(zip(many, reversed(many.values()), strict=True))
    pairs = " ".join(changes(_timed(**many), _timed(**turned)).split())
    assert pairs.endswith("but for 10 of 10 pairs, whose times lie within their spreads")
    text = changes(before, _timed(osqp=9.0, clarabel=3.0, piqp=2.0))
    assert "piqp is faster than osqp now: 2 and 9 linear solves before, 9 and 2 now" in text
    assert "piqp is faster than clarabel now: 3 and 9 linear solves before, 3 and 2 now" not in text  # within, now
    assert "same order" not in text
