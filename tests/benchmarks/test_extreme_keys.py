"""Every key of a case at an extreme is answered or refused in one line; benchmarks/extreme_keys.py takes all cases."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from benchmarks import extreme_keys
from benchmarks.adversary.faults import FAULTS


def test_one_value_of_a_case_is_changed_and_the_others_stay() -> None:
    (case,) = extreme_keys.cases(["bar_wall"]).values()
    every = [(path, value) for path, value in extreme_keys.keys(case) if path]
    assert len(every) > 20
    for path, value in every:
        assert tomllib.loads(extreme_keys.changed(case, path, value).decode()) == case
    path = next(path for path, _ in every if path[-1] == "area")
    other = tomllib.loads(extreme_keys.changed(case, path, "1e12 cm^2").decode())
    assert other["bars"][0].pop("area") == "1e12 cm^2"
    del case["bars"][0]["area"]
    assert other == case


def test_numbers_keep_their_units_and_text_stays_none() -> None:
    rng = np.random.default_rng(0)
    lengths = {str(extreme_keys.extreme("15 cm^2", rng)) for _ in range(200)}
    assert {"1e100 cm^2", "0 cm^2", "-1 cm^2", "[]"} <= lengths
    counts = {str(extreme_keys.extreme(4, rng)) for _ in range(200)}
    assert {"0", "-1", str(10**100)} <= counts
    assert all(extreme_keys.extreme("wall", rng) in extreme_keys.OTHERS for _ in range(50))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bar_wall", "truss_friction", "von_mises_truss", "mass_bounces"])
def test_extremes_are_answered_or_refused_in_one_line(name: str) -> None:
    count, findings, _ = extreme_keys.tried([name], 20261129, 600.0)
    assert findings == []
    assert count["files"] == count["of"] > 20


@pytest.mark.slow
def test_an_error_of_several_lines_is_found(capsys: pytest.CaptureFixture[str]) -> None:
    with FAULTS["lines"]():
        assert extreme_keys.main(["bar_wall", "--minutes", "0.02"]) == 1
    assert "printed: " in capsys.readouterr().out
