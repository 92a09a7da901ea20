"""Two elastic spheres by the mortar, on meshes that do not match, converge to Hertz's force and pressure."""

import numpy as np
import pytest

from benchmarks import hertz_spheres
from benchmarks.hertz_spheres import CONTACT, MATERIALS, RADII, Hertz, half_space, level, main, orders


@pytest.mark.slow
def test_force_and_pressure_converge_to_hertz():
    levels = [level(4), level(8)]
    force, l1 = orders(levels)
    assert force > 0.9
    assert l1 > 0.9
    assert levels[-1].force < 0.01
    assert levels[-1].peak < 0.03
    assert all(found.radius < 1 for found in levels)


@pytest.mark.slow
def test_blunter_spheres_are_seen():
    """With radii 5 % larger the same approach gives about 2 % more force."""
    assert level(8, (1.05 * RADII[0], 1.05 * RADII[1])).force > 0.02


@pytest.mark.slow
def test_the_exit_code_says_whether_the_peak_is_near_enough(monkeypatch):
    assert main(["--finest", "8"]) == 0
    monkeypatch.setattr(hertz_spheres, "LARGEST_PEAK_ERROR", 0.01)
    assert main(["--finest", "8"]) == 1


def test_the_surface_beside_the_contact_sinks_as_johnson_says():
    """Johnson 1985, eq. 3.42b: u_z = p0 / (2 E* a) ((2 a^2 - r^2) asin(a/r) + r a sqrt(1 - a^2/r^2)), r > a."""
    hertz, material = Hertz(), MATERIALS[0]
    r = np.linspace(2 * CONTACT, 5 * CONTACT, 7)
    u = half_space(np.column_stack([0.6 * r, 0.8 * r, 0 * r]), material, hertz)
    modulus = material.modulus / (1 - material.poisson**2)
    parts = (2 * CONTACT**2 - r**2) * np.arcsin(CONTACT / r) + r * CONTACT * np.sqrt(1 - (CONTACT / r) ** 2)
    np.testing.assert_allclose(u[:, 2], hertz.peak / (2 * modulus * CONTACT) * parts, rtol=1e-9)
    np.testing.assert_allclose(u[:, 0] * 0.8, u[:, 1] * 0.6, rtol=1e-9)


@pytest.mark.slow
def test_the_half_space_is_in_equilibrium():
    """(1 - 2 nu) laplace(u) + grad(div(u)) = 0, by differences."""
    hertz, material = Hertz(), MATERIALS[1]
    x = np.random.default_rng(0).uniform(-2, 2, (50, 3))
    x[:, 2] = 2 + abs(x[:, 2])
    h, e = 1e-2, np.eye(3)

    def u(a, b=None):
        return half_space(x + h * (a + (0 if b is None else b)), material, hertz)

    second = np.empty((3, 3, len(x), 3))
    for i in range(3):
        for j in range(3):
            second[i, j] = (u(e[i], e[j]) - u(e[i], -e[j]) - u(-e[i], e[j]) + u(-e[i], -e[j])) / (4 * h**2)
    laplacian = np.einsum("iipc->pc", second)
    divergence = np.einsum("icpc->pi", second)
    assert abs((1 - 2 * material.poisson) * laplacian + divergence).max() < 1e-3 * abs(second).max()
