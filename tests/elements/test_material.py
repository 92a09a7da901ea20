"""Hooke's law in its four models, against uniaxial tests and against each other."""

import numpy as np
import pytest

from contactqp.elements.material import MODELS, STRAINS, Material
from contactqp.errors import InvalidProblem

E, NU = 210.0, 0.3
STEEL = Material(modulus=E, poisson=NU)


def test_uniaxial_tension_in_space_strains_by_e_and_nu():
    strain = np.linalg.solve(STEEL.constitutive("3d"), [1.0, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(strain, [1 / E, -NU / E, -NU / E, 0, 0, 0], atol=1e-18)
    shear = np.linalg.solve(STEEL.constitutive("3d"), [0, 0, 0, 1.0, 0, 0])
    assert np.isclose(shear[3], 2 * (1 + NU) / E)


def test_plane_stress_leaves_no_stress_across_and_plane_strain_no_strain():
    strain = np.linalg.solve(STEEL.constitutive("plane-stress"), [1.0, 0, 0])
    np.testing.assert_allclose(strain, [1 / E, -NU / E, 0], atol=1e-18)
    np.testing.assert_array_equal(STEEL.stress_matrix("plane-stress")[2], 0)
    strain = np.linalg.solve(STEEL.constitutive("plane-strain"), [1.0, 0, 0])
    stress = STEEL.stress_matrix("plane-strain") @ strain
    np.testing.assert_allclose(stress, [1, 0, NU, 0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(strain[0], (1 - NU**2) / E)


@pytest.mark.parametrize("model", MODELS)
def test_every_model_is_symmetric_and_positive_definite(model):
    D = STEEL.constitutive(model)
    assert D.shape == (len(STRAINS[model]),) * 2
    np.testing.assert_array_equal(D, D.T)
    assert np.linalg.eigvalsh(D)[0] > 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"modulus": 0.0}, "rubber: expected a positive modulus, got 0.0"),
        ({"modulus": float("nan")}, "positive modulus"),
        ({"poisson": 0.5}, "rubber: expected Poisson's ratio between -1 and 0.5, got 0.5"),
        ({"poisson": -1.0}, "Poisson"),
        ({"poisson": float("nan")}, "Poisson"),
        ({"density": -1.0}, "density >= 0"),
        ({"density": float("inf")}, "rubber: density: expected one finite number, got inf"),
        ({"modulus": "210"}, "rubber: modulus: expected a number, got '210'"),
        ({"poisson": None}, "rubber: poisson: expected a number, got None"),
        ({"modulus": [1.0, 2.0]}, "rubber: modulus: expected a number, got"),
    ],
)
def test_materials_that_are_none_are_refused(wrong, message):
    with pytest.raises(InvalidProblem, match=message):
        Material(**{"modulus": 1.0, "poisson": 0.3, "name": "rubber"} | wrong)
