"""Force and peak pressure of Hertz's ball converge, the pressure to Hertz's own."""

from benchmarks.hertz_convergence import level, orders


def test_force_and_peak_pressure_converge_at_first_order_or_better():
    levels = [level(divisions, (30, 45, 60)) for divisions in (6, 12, 24)]
    force, pressure = orders(levels)
    assert force > 0.9
    assert pressure > 0.9
    assert levels[0].pressure_error > 0.05
    assert levels[-1].pressure_error < 0.02
