"""Mass matrices: closed forms, mass, centre and inertia of rigid motions, and the consistent matrix of scikit-fem."""

from fractions import Fraction as F
from math import pi

import numpy as np
import pytest

from contactqp.elements.loads import Gravity, Weight, bar_mass, solid_mass
from contactqp.elements.material import Material
from contactqp.elements.mesh_files import mesh_from_skfem
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem
from tests.elements.bodies import MODELS, distorted

DENSE = Material(1.0, 0.3, density=7.0)


def test_the_mass_of_a_bar_is_exact():
    M = bar_mass(F(3), F(2), [F(0), F(0)], [F(3), F(4)])
    assert M.tolist() == [[10, 0, 5, 0], [0, 10, 0, 5], [5, 0, 10, 0], [0, 5, 0, 10]]
    assert isinstance(M[0, 0], F)
    lumped = bar_mass(F(3), F(2), [F(0), F(0)], [F(3), F(4)], lumped=True)
    assert lumped.tolist() == np.diag([15, 15, 15, 15]).tolist()


@pytest.mark.parametrize("lumped", [False, True])
@pytest.mark.parametrize(("kind", "model"), MODELS)
def test_translations_have_the_whole_mass(kind, model, lumped):
    body = Body(distorted(kind), DENSE, model)
    M = solid_mass(body, lumped)
    # Volumes by the quadrature of a constant; of the full circle in axial symmetry.
    volume = sum(body.integration(block, block.kind.fine_rule)[1].sum() for block in body.mesh.blocks)
    d = body.dimension
    ones = np.tile(np.eye(d), (len(body.mesh.points), 1))
    np.testing.assert_allclose(ones.T @ M @ ones, 7.0 * volume * np.eye(d), rtol=1e-12, atol=1e-12)
    assert abs(M - M.T).max() == 0.0
    assert np.linalg.eigvalsh(M.toarray())[0] > 0
    assert M.diagonal().min() > 0
    if lumped:
        assert abs(M - np.diag(M.diagonal())).max() == 0.0


def test_the_consistent_mass_turns_as_the_body_does():
    """z'Mz of a rotation about the corner: rho t (a^3 b + a b^3) / 3; quadratic displacements have it, too."""
    for kind in ("tri3", "quad4", "quad8", "tri6"):
        body = Body(rectangle(2.0, 3.0, (3, 2), kind), DENSE, "plane-stress", thickness=0.5)
        x = body.mesh.points
        turn = np.column_stack([-x[:, 1], x[:, 0]]).ravel()
        assert turn @ solid_mass(body) @ turn == pytest.approx(7.0 * 0.5 * (8 * 3 + 2 * 27) / 3, rel=1e-12)


def test_the_full_circle_is_weighed():
    body = Body(rectangle(2.0, 1.0, (4, 3), "quad4"), DENSE, "axisymmetric")
    along = np.tile([0.0, 1.0], len(body.mesh.points))
    for lumped in (False, True):
        assert along @ solid_mass(body, lumped) @ along == pytest.approx(7.0 * pi * 4.0, rel=1e-12)


def test_lumping_a_quadrilateral_and_a_serendipity_square():
    square = Body(rectangle(2.0, 2.0, (1, 1), "quad4"), DENSE, "plane-strain")
    np.testing.assert_allclose(solid_mass(square, True).diagonal(), 7.0, rtol=1e-13)
    # Hinton, Rock and Zienkiewicz: 3/76 of the mass at corners and 16/76 at the middles of the sides.
    eight = Body(rectangle(2.0, 2.0, (1, 1), "quad8"), DENSE, "plane-strain")
    found = np.sort(solid_mass(eight, True).diagonal()[::2])
    np.testing.assert_allclose(found, 28.0 / 76 * np.array([3, 3, 3, 3, 16, 16, 16, 16]), rtol=1e-12)


def test_scikit_fem_has_the_same_mass():
    import skfem
    from skfem.helpers import dot

    vector_mass = skfem.BilinearForm(lambda u, v, _: dot(u, v))
    theirs = skfem.MeshTri().refined(2).scaled((1.0, 2.0))
    basis = skfem.Basis(theirs, skfem.ElementVector(skfem.ElementTriP1()), intorder=4)
    M = 7.0 * skfem.asm(vector_mass, basis).toarray()
    place = basis.nodal_dofs.T.ravel()
    ours = solid_mass(Body(mesh_from_skfem(theirs), DENSE, "plane-strain"))
    np.testing.assert_allclose(ours.toarray(), M[np.ix_(place, place)], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("lumped", [False, True])
def test_weight_is_mass_times_gravity(lumped):
    """To rounding that of the integral where linear elements are rectangles; lumped quadratic kinds weigh otherwise."""
    for kind, same in (("quad4", True), ("quad8", not lumped)):
        body = Body(rectangle(2.0, 3.0, (3, 2), kind), DENSE, "plane-stress", thickness=0.5)
        f = Weight("body", [0.0, -9.81], lumped).forces(body)
        M = solid_mass(body, lumped)
        np.testing.assert_allclose(f, M @ np.tile([0.0, -9.81], len(body.mesh.points)), rtol=1e-14)
        assert f.sum() == pytest.approx(-9.81 * 7.0 * 0.5 * 6.0, rel=1e-13)
        integral = Gravity("body", [0.0, -9.81]).forces(body)
        assert np.allclose(f, integral, rtol=1e-12, atol=1e-12) is same


def test_what_has_no_mass_is_refused():
    mesh = rectangle(1.0, 1.0, (1, 1), "quad4")
    with pytest.raises(InvalidProblem, match="block: a mass needs a density > 0, material has none"):
        solid_mass(Body(mesh, Material(1.0, 0.3), "plane-strain", name="block"))
