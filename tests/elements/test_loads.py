"""Consistent nodal forces and mass matrices, against closed forms and scikit-fem.

Forces have exact resultants, moments and work on straight, curved and axisymmetric boundaries; masses have the mass,
centre and inertia of rigid motions.
"""

from __future__ import annotations

from fractions import Fraction as F
from math import pi

import numpy as np
import pytest

from contactqp.elements.loads import BodyForce, Gravity, PointLoad, Pressure, Traction, Weight, bar_mass, solid_mass
from contactqp.elements.material import Material
from contactqp.elements.mesh_files import mesh_from_skfem
from contactqp.elements.shapes import ball, box, disc, half_disc, quarter_disc, rectangle
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem
from tests.elements.bodies import MODELS, PLANE, SOLID, STEEL, distorted


def resultant(body, forces):
    return forces.reshape(-1, body.dimension).sum(axis=0)


def moment(body, forces):
    x, f = body.mesh.points, forces.reshape(-1, body.dimension)
    return np.cross(x, f).sum(axis=0) if body.dimension == 3 else (x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]).sum()


def work(forces, u):
    return float(forces @ np.asarray(u).ravel())


@pytest.mark.parametrize("kind", PLANE)
def test_a_linear_traction_has_its_exact_force_and_moment(kind):
    """t = (2 y, 3) on x = 2, 0 <= y <= 1.5, thickness 4: force (9, 18), moment 18 * 2 - 4 * 2 * 1.5^3 / 3."""
    b = Body(rectangle(2.0, 1.5, (2, 3), kind), STEEL, "plane-stress", thickness=4.0, name="block")
    f = Traction("block", "right", lambda x: np.column_stack([2 * x[:, 1], np.full(len(x), 3.0)])).forces(b)
    np.testing.assert_allclose(resultant(b, f), [9.0, 18.0], rtol=1e-14)
    assert np.isclose(moment(b, f), 36.0 - 9.0, rtol=1e-13)
    loaded = np.flatnonzero(np.abs(f.reshape(-1, 2)).max(axis=1) > 1e-12)
    assert set(loaded) <= set(b.mesh.nodes("right"))


@pytest.mark.parametrize(
    ("kind", "weights"), [("quad4", [1, 2, 1]), ("quad8", [1, 4, 2, 4, 1]), ("tri6", [1, 4, 2, 4, 1])]
)
def test_a_constant_traction_has_the_textbooks_nodal_forces(kind, weights):
    b = Body(rectangle(2.0, 1.0, (2, 1), kind), STEEL, "plane-strain", name="block")
    f = Traction("block", "bottom", [0.0, 1.0]).forces(b).reshape(-1, 2)
    nodes = b.mesh.nodes("bottom")
    nodes = nodes[np.argsort(b.mesh.points[nodes, 0])]
    np.testing.assert_allclose(f[nodes, 1], 2.0 * np.array(weights) / sum(weights), atol=1e-15)


@pytest.mark.parametrize("kind", SOLID)
def test_a_linear_pressure_has_its_exact_force_and_moment(kind):
    """p = x + 2 y on z = 1 of [0, 1] x [0, 2] x [0, 1] pushes down by 5, with the moments of the centre of pressure."""
    b = Body(box((1.0, 2.0, 1.0), (2, 3, 1), kind), STEEL, "3d", name="block")
    f = Pressure("block", "top", lambda x: x[:, 0] + 2 * x[:, 1]).forces(b)
    np.testing.assert_allclose(resultant(b, f), [0, 0, -5.0], atol=1e-14)
    m_x = -(1.0 + 2 * 8 / 3)  # -integral of y p
    m_y = 2 / 3 + 2.0  # integral of x p
    np.testing.assert_allclose(moment(b, f), [m_x, m_y, 0.0], atol=1e-13)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("mesh", [disc(2.0, (2, 2), k) for k in PLANE] + [ball(2.0, (1, 1), k) for k in SOLID])
def test_a_constant_pressure_all_around_balances_itself(mesh):
    b = Body(mesh, STEEL, "3d" if mesh.dimension == 3 else "plane-strain", name="body")
    side = "sphere" if mesh.dimension == 3 else "arc"
    f = Pressure("body", side, 3.0).forces(b)
    assert np.abs(f).max() > 0.1
    assert np.abs(resultant(b, f)).max() < 1e-13
    assert np.abs(moment(b, f)).max() < 1e-13
    # The work on swelling u = x is -p d V.
    assert np.isclose(work(f, b.mesh.points), -3.0 * b.dimension * b.mesh.volume(), rtol=1e-13)


@pytest.mark.parametrize("kind", PLANE)
def test_a_pressure_on_an_arc_pushes_up_by_pressure_times_chord(kind):
    """Holds for every approximation of the arc, because it has the same ends."""
    b = Body(half_disc(2.0, (2, 2), kind), STEEL, "plane-strain", name="body")
    np.testing.assert_allclose(resultant(b, Pressure("body", "arc", 3.0).forces(b)), [0.0, 12.0], atol=1e-13)
    np.testing.assert_allclose(resultant(b, Pressure("body", "top", 3.0).forces(b)), [0.0, -12.0], atol=1e-13)


@pytest.mark.parametrize("kind", PLANE)
def test_axisymmetric_loads_are_those_of_the_full_circle(kind):
    ring = Body(rectangle(1.0, 3.0, (2, 2), kind, corner=(1.0, 0.0)), STEEL, "axisymmetric", name="ring")
    pushed = resultant(ring, Pressure("ring", "right", 2.0).forces(ring))
    np.testing.assert_allclose(pushed, [-2.0 * 2 * np.pi * 2.0 * 3.0, 0.0], rtol=1e-14, atol=1e-13)
    pushed = resultant(ring, Pressure("ring", "top", 2.0).forces(ring))
    np.testing.assert_allclose(pushed, [0.0, -2.0 * np.pi * (4.0 - 1.0)], rtol=1e-14, atol=1e-13)
    weight = resultant(ring, Gravity("ring", [0.0, -10.0]).forces(ring))
    np.testing.assert_allclose(weight[1], -10 * STEEL.density * np.pi * 3.0 * 3.0, rtol=1e-14)


def test_the_pressure_on_half_a_ball_is_that_on_its_great_circle():
    for kind in ("tri6", "quad9"):
        b = Body(quarter_disc(2.0, (4, 4), kind), STEEL, "axisymmetric", name="ball")
        up = resultant(b, Pressure("ball", "arc", 3.0).forces(b))[1]
        assert np.isclose(up, 3.0 * np.pi * 4.0, rtol=1e-13)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", PLANE + SOLID)
def test_gravity_has_the_weight_and_its_moment(kind):
    if kind in PLANE:
        b = Body(rectangle(2.0, 1.0, (2, 2), kind, corner=(1.0, 1.0)), STEEL, "plane-stress", thickness=0.5, name="b")
        f = Gravity("b", [0.0, -9.81]).forces(b)
        weight = 9.81 * 7.85 * 2.0 * 0.5
        np.testing.assert_allclose(resultant(b, f), [0, -weight], atol=1e-13)
        assert np.isclose(moment(b, f), -weight * 2.0, rtol=1e-13)
    else:
        b = Body(box((2.0, 1.0, 1.0), (2, 1, 2), kind), STEEL, "3d", name="b")
        f = Gravity("b", [0.0, 0.0, -9.81]).forces(b)
        weight = 9.81 * 7.85 * 2.0
        np.testing.assert_allclose(resultant(b, f), [0, 0, -weight], atol=1e-12)
        np.testing.assert_allclose(moment(b, f), [-weight / 2, weight, 0], atol=1e-12)


def test_a_body_force_that_varies_does_its_exact_work():
    """b = (x y, 0) on [0, 2] x [0, 1] does 8/3 * 1/2 on u = (x, 0)."""
    b = Body(rectangle(2.0, 1.0, (3, 2), "quad8"), STEEL, "plane-strain", name="b")
    f = BodyForce("b", lambda x: np.column_stack([x[:, 0] * x[:, 1], 0 * x[:, 0]])).forces(b)
    assert np.isclose(work(f, b.mesh.points * [1, 0]), 4 / 3, rtol=1e-13)


def test_point_loads_act_at_each_node_of_a_set():
    b = Body(rectangle(2.0, 1.0, (2, 1)), STEEL, "plane-strain", name="b")
    f = PointLoad("b", "left", [1.0, -2.0]).forces(b).reshape(-1, 2)
    assert f[b.mesh.nodes("left")].tolist() == [[1.0, -2.0]] * 2
    assert resultant(b, f.ravel()).tolist() == [2.0, -4.0]
    f = PointLoad("b", b.mesh.nearest((2.0, 1.0)), [0.0, 1.0]).forces(b).reshape(-1, 2)
    assert b.mesh.points[f[:, 1] == 1.0].tolist() == [[2.0, 1.0]]


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (Traction("b", "front", [0, 1]), "there is no set 'front'; it has 'bottom', 'left', 'right', 'top'"),
        (Traction("b", "top", [0, 1, 2]), r"traction on 'top': expected a value of shape \(2,\), got \(3,\)"),
        (Traction("b", "top", lambda x: x[:, 0]), r"traction on 'top': expected a value of shape \(6, 2\), got \(6,\)"),
        (Pressure("b", "top", float("nan")), "pressure on 'top': expected finite numbers, got nan"),
        (Pressure("b", "top", [1.0]), r"pressure on 'top': expected a value of shape \(\), got \(1,\)"),
        (BodyForce("b", [1.0]), "body force: expected a value of shape"),
        (PointLoad("b", 6, [0, 1]), "b: expected nodes from 0 to 5, got 6"),
        (PointLoad("b", [-1], [0, 1]), "b: expected nodes from 0 to 5, got -1"),
        (PointLoad("b", [], [0, 1]), "b: expected a named set or node numbers"),
        (PointLoad("b", 0, [0]), "point load: expected a value of shape"),
    ],
)
def test_loads_that_do_not_fit_are_refused(load, message):
    b = Body(rectangle(2.0, 1.0, (2, 1)), STEEL, "plane-strain", name="b")
    with pytest.raises(InvalidProblem, match=message):
        load.forces(b)


def test_gravity_needs_a_density():
    b = Body(rectangle(2.0, 1.0, (2, 1)), Material(modulus=1.0, poisson=0.3, name="foam"), "plane-strain", name="b")
    with pytest.raises(InvalidProblem, match="b: gravity needs a density > 0, foam has none"):
        Gravity("b", [0, -1]).forces(b)


DENSE = Material(1.0, 0.3, density=7.0)


def test_the_mass_of_a_bar_is_exact():
    M = bar_mass(F(3), F(2), [F(0), F(0)], [F(3), F(4)])
    assert M.tolist() == [[10, 0, 5, 0], [0, 10, 0, 5], [5, 0, 10, 0], [0, 5, 0, 10]]
    assert isinstance(M[0, 0], F)
    lumped = bar_mass(F(3), F(2), [F(0), F(0)], [F(3), F(4)], lumped=True)
    assert lumped.tolist() == np.diag([15, 15, 15, 15]).tolist()


@pytest.mark.sampled(3)
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
