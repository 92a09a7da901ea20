"""Force and peak pressure of Hertz's ball converge, the pressure to Hertz's own."""

from functools import cache

import pytest

from benchmarks import hertz_convergence
from benchmarks.hertz_convergence import level, main, orders


@pytest.mark.slow
def test_force_and_peak_pressure_converge_at_first_order_or_better():
    levels = [level(divisions, (30, 45, 60)) for divisions in (6, 12, 24)]
    force, pressure = orders(levels)
    assert force > 0.9
    assert pressure > 0.9
    assert levels[0].pressure_error > 0.05
    assert levels[-1].pressure_error < 0.02


@pytest.mark.slow
def test_the_exit_code_says_whether_the_peak_is_within_one_percent(monkeypatch: pytest.MonkeyPatch):
    """It is on the mesh of 48 divisions, off by 0.6 %, and not yet on that of 24."""
    monkeypatch.setattr(hertz_convergence, "level", cache(level))  # both refine from the same coarse meshes
    assert main(["--finest", "24"]) == 1
    assert main(["--finest", "48"]) == 0
