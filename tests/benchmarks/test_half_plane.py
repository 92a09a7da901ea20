"""The closed forms that convergence is measured against satisfy elasticity and the contact conditions."""

import numpy as np
import pytest

from benchmarks.half_plane import Parabola, Punch

FIELDS = [Parabola(half_width=0.7, radius=40.0), Punch(half_width=0.7, force=3.0)]


def points():
    x = np.random.default_rng(0).uniform(-3, 3, (200, 2))
    x[:, 1] = -abs(x[:, 1]) - 0.05
    return x


def differences(function, x, h=1e-6):
    """d/dx_b of a function of the points, as the last axis."""
    return np.stack([(function(x + h * e) - function(x - h * e)) / (2 * h) for e in np.eye(2)], axis=-1)


@pytest.mark.parametrize("exact", FIELDS)
def test_gradients_stresses_and_forces_belong_together(exact):
    x = points()
    gradient, stress = exact.gradient(x), exact.stress(x)
    np.testing.assert_allclose(differences(exact.displacement, x), gradient, atol=1e-6 * abs(gradient).max())
    strain = (gradient + gradient.transpose(0, 2, 1)) / 2
    lame_mu, nu = exact.elastic.shear, exact.elastic.poisson
    lame_lambda = 2 * lame_mu * nu / (1 - 2 * nu)
    volume = np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    np.testing.assert_allclose(2 * lame_mu * strain + lame_lambda * volume, stress, atol=1e-14 * abs(stress).max())
    divergence = np.einsum("pabb->pa", differences(exact.stress, x))
    assert abs(divergence).max() < 1e-6 * abs(stress).max()


@pytest.mark.parametrize("exact", FIELDS)
def test_the_surface_is_free_outside_and_presses_with_the_whole_force_inside(exact):
    a = exact.half_width
    t = (np.arange(2000) + 0.5) / 2000 * np.pi - np.pi / 2
    inside = np.column_stack([a * np.sin(t), 0 * t])
    outside = np.array([[-2.0, 0.0], [-0.71, 0.0], [0.71, 0.0], [2.0, 0.0]])
    pressure = -exact.stress(inside)[:, 1, 1]
    assert pressure.min() > 0
    assert abs(exact.stress(outside)[:, 1]).max() < 1e-250
    assert np.isclose((pressure * a * np.cos(t)).sum() * np.pi / 2000, exact.force, rtol=1e-6)


def test_the_parabola_touches_inside_and_is_clear_outside():
    exact = FIELDS[0]
    x = np.linspace(-2, 2, 401)
    gap = x**2 / (2 * exact.radius) - exact.displacement(np.column_stack([x, 0 * x]))[:, 1]
    inside = abs(x) <= exact.half_width
    assert abs(gap[inside]).max() < 1e-16
    assert gap[~inside].min() > 0


def test_the_punch_is_flat_inside_and_the_surface_bends_away_outside():
    exact = FIELDS[1]
    x = np.array([-2.0, -1.0, -0.71, -0.69, -0.3, 0.0, 0.3, 0.69, 0.71, 1.0, 2.0])
    height = exact.displacement(np.column_stack([x, 0 * x]))[:, 1]
    inside = abs(x) < exact.half_width
    assert abs(height[inside]).max() < 1e-16
    assert height[~inside].min() > 0
    assert np.all(np.diff(height[x > exact.half_width]) > 0)
