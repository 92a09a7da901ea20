"""Contact solutions converge to closed forms at their orders, on coarse meshes; benchmarks/convergence.py goes on."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import contact_of_half_planes, membrane_over_ball
from benchmarks.contact_of_half_planes import hertz_level, punch_level
from benchmarks.convergence import orders, study
from benchmarks.half_plane import Parabola
from benchmarks.membrane_over_ball import RADIUS, RIM, SLOPE, deflection, gradient, membrane_level, on_disc, on_square


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "h1"), [("tri3", 0.9), ("quad4", 0.9), ("tri6", 1.3), ("quad8", 1.3)])
def test_hertz_line_contact(kind, h1):
    """Order 1 in H1 with linear elements, 3/2 with quadratic ones: the pressure is a root at the edge of contact."""
    levels = [hertz_level(kind, cells) for cells in ((8, 16, 32) if h1 < 1 else (8, 16))]
    found = orders(levels, ["h1", "force", "peak"])
    assert found["h1"] > h1
    assert found["force"] > 0.9
    assert found["peak"] > 0.9
    assert levels[-1].peak < 0.01
    assert all(level.half_width < 1 for level in levels)


@pytest.mark.slow
def test_a_parabola_of_another_radius_is_no_limit(monkeypatch):
    """With 5 % off the radius of the obstacle alone, errors stay where they are."""
    monkeypatch.setattr(contact_of_half_planes, "Parabola", WrongObstacle)
    levels = [hertz_level("quad4", cells) for cells in (16, 32)]
    found = orders(levels, ["h1", "force"])
    assert found["h1"] < 0.7
    assert abs(found["force"]) < 0.2


class WrongObstacle(Parabola):
    """The fields of one parabola, the obstacle of a blunter one."""

    def potentials(self, z):
        exact = Parabola(self.half_width, 0.95 * self.radius)
        return exact.potentials(z)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tri3", "quad4"])
def test_the_flat_punch(kind):
    levels = [punch_level(kind, cells) for cells in (8, 16, 32)]
    found = orders(levels, ["force", "l1"])
    assert found["force"] > 0.9
    assert found["l1"] > 0.4
    assert levels[-1].force < 0.03
    assert levels[-1].l1 < 0.15


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", ["tri3", "quad4"])
@pytest.mark.parametrize("mesh", [on_square, on_disc])
def test_the_free_boundary_of_the_membrane(mesh, kind):
    levels = [membrane_level(mesh(kind, cells)) for cells in (8, 16, 32)]
    found = orders(levels, ["h1", "radius"])
    assert found["h1"] > 0.85
    assert found["radius"] > 0.9
    assert levels[-1].radius < 2e-3
    assert all(level.boundary < 1 for level in levels), "the last node that presses is within an element of a"


def test_the_membranes_closed_form():
    assert np.isclose(RADIUS**2 * np.log(RIM / RADIUS), 1 - RADIUS**2, rtol=1e-14)
    assert np.isclose(SLOPE, 0.680259411891719, rtol=1e-14)
    x = np.random.default_rng(0).uniform(-2, 2, (300, 2))
    h = 1e-6
    found = np.stack([(deflection(x + h * e) - deflection(x - h * e)) / (2 * h) for e in np.eye(2)], axis=1)
    np.testing.assert_allclose(found, gradient(x)[:, 0], atol=1e-5)


def test_the_membrane_converges_to_no_other_radius(monkeypatch):
    monkeypatch.setattr(membrane_over_ball, "RADIUS", 1.01 * RADIUS)
    levels = [membrane_level(on_disc("quad4", cells)) for cells in (16, 32)]
    assert orders(levels, ["radius"])["radius"] < 0.5


@pytest.mark.slow
def test_a_missed_target_is_said(capsys):
    level = hertz_level("quad4", 8)

    def made_up(cells):
        return replace(level, size=1 / cells, h1=1 / cells)

    assert study("made up", made_up, 16, {"h1": 0.99}, {"h1": 0.07})
    assert not study("made up", made_up, 16, {"h1": 1.01}, {})
    assert not study("made up", made_up, 16, {"h1": 0.99}, {"h1": 0.06})
    assert capsys.readouterr().out.count("MISSED") == 2
