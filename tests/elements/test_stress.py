"""Stresses at quadrature points and nodes: exact for uniform and for linear fields."""

import numpy as np
import pytest

from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body, stress_at_nodes, stress_at_quadrature, von_mises
from contactqp.errors import InvalidProblem
from tests.elements.bodies import MODELS, STEEL, body
from tests.elements.test_solid import constant_strain

E, NU = STEEL.modulus, STEEL.poisson


@pytest.mark.parametrize(("kind", "model"), MODELS)
def test_a_uniform_stress_is_exact_at_the_nodes_of_a_distorted_mesh(kind, model):
    b = body(kind, model)
    u, stress = constant_strain(b)
    np.testing.assert_allclose(stress_at_nodes(b, u), np.tile(stress, (len(b.mesh.points), 1)), atol=1e-11)


def bending(x):
    """Pure bending in plane stress, sigma_xx = E y: u = (x y, -x^2/2 - nu y^2/2); uniform in a third direction."""
    X, Y = x[:, 0], x[:, 1]
    return np.column_stack([X * Y, -(X**2) / 2 - NU * Y**2 / 2])


@pytest.mark.parametrize("kind", ["tri6", "quad8", "quad9"])
def test_bending_is_exact_with_quadratic_elements(kind):
    b = Body(rectangle(3.0, 1.0, (2, 2), kind, corner=(0.0, -0.5)), STEEL, "plane-stress")
    expected = np.zeros((len(b.mesh.points), 6))
    expected[:, 0] = E * b.mesh.points[:, 1]
    np.testing.assert_allclose(stress_at_nodes(b, bending(b.mesh.points).ravel()), expected, atol=1e-11)
    (points,) = stress_at_quadrature(b, bending(b.mesh.points).ravel())
    np.testing.assert_allclose(points.stress[..., 0], E * points.positions[..., 1], atol=1e-11)
    assert np.abs(points.stress[..., 1:]).max() < 1e-11


@pytest.mark.parametrize("kind", ["tet10", "hex20", "hex27"])
def test_bending_in_space_is_exact_with_quadratic_elements(kind):
    """Timoshenko & Goodier 1970, art. 102: sigma_xx = E y, anticlastic."""
    b = Body(box((2.0, 1.0, 1.0), (2, 1, 1), kind, corner=(0.0, -0.5, -0.5)), STEEL, "3d")
    x, y, z = b.mesh.points.T
    u = np.column_stack([x * y, -(x**2) / 2 - NU * (y**2 - z**2) / 2, -NU * y * z])
    expected = np.zeros((len(b.mesh.points), 6))
    expected[:, 0] = E * y
    np.testing.assert_allclose(stress_at_nodes(b, u.ravel()), expected, atol=1e-10)


def test_von_mises_is_root_three_times_pure_shear_and_blind_to_pressure():
    shear = np.array([0, 0, 0, 2.0, 0, 0])
    assert np.isclose(von_mises(shear), 2 * np.sqrt(3))
    np.testing.assert_allclose(von_mises([shear + np.array([p, p, p, 0, 0, 0]) for p in (1.0, -7.0)]), 2 * np.sqrt(3))
    turned = np.array([2.0, -2.0, 0, 0, 0, 0])  # the same shear in axes turned by 45 degrees
    assert np.isclose(von_mises(turned), von_mises(shear))


def test_a_displacement_of_another_length_is_refused():
    b = Body(rectangle(1.0, 1.0, (1, 1)), STEEL, "plane-strain", name="block")
    with pytest.raises(InvalidProblem, match=r"block: expected a displacement of shape \(8,\), got \(6,\)"):
        stress_at_nodes(b, np.zeros(6))
