"""Membranes: scikit-fem's Laplacian, a closed form, and membranes in structures."""

import numpy as np
import pytest
import scipy.sparse.linalg as spla

import contactqp as cq
from contactqp.elements.loads import Traction
from contactqp.elements.mesh import mesh_from_arrays
from contactqp.elements.pairing import pair_scalar
from contactqp.elements.shapes import box, disc, rectangle
from contactqp.elements.solid import Body, Membrane
from contactqp.elements.structure import Structure, Support
from contactqp.errors import InvalidProblem
from tests.elements.bodies import PLANE, STEEL, distorted


@pytest.mark.parametrize("kind", ["tri3", "quad4"])
def test_the_stiffness_is_scikit_fems(kind):
    skfem = pytest.importorskip("skfem")
    from skfem.models.poisson import laplace

    mesh = distorted(kind)
    made = {"tri3": (skfem.MeshTri, skfem.ElementTriP1()), "quad4": (skfem.MeshQuad, skfem.ElementQuad1())}[kind]
    theirs = made[0](np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(mesh.blocks[0].nodes.T))
    expected = 3.0 * laplace.assemble(skfem.Basis(theirs, made[1], intorder=4))  # 3 x 3 points, as ours
    found = Membrane(mesh, 3.0).stiffness
    np.testing.assert_allclose(found.toarray(), expected.toarray(), atol=1e-13)
    assert abs(found - found.T).max() == 0


@pytest.mark.parametrize("kind", PLANE)
def test_a_linear_deflection_is_in_balance_and_has_its_energy(kind):
    """w = x: no force inside, and the energy T/2 times the area."""
    mesh = rectangle(2.0, 1.0, (3, 2), kind).mapped(lambda x: x + 0.02 * np.sin(5 * x[:, ::-1]))
    membrane = Membrane(mesh, 3.0)
    w = mesh.points[:, 0]
    force = membrane.stiffness @ w
    inside = np.setdiff1d(np.arange(membrane.size), np.unique(np.concatenate([mesh.nodes(s) for s in mesh.sides])))
    np.testing.assert_allclose(force[inside], 0, atol=1e-9)
    np.testing.assert_allclose(w @ force / 2, 1.5 * mesh.volume(), rtol=1e-9)
    np.testing.assert_allclose(membrane.areas().sum(), mesh.volume(), rtol=1e-4)
    assert membrane.areas().min() > 0


def test_a_membrane_between_two_rings_is_a_logarithm():
    flat = rectangle(1.0, np.pi / 2, (16, 16), "quad4", corner=(1.0, 0.0))
    mesh = flat.mapped(lambda x: x[:, :1] * np.column_stack([np.cos(x[:, 1]), np.sin(x[:, 1])]))
    structure = Structure([Membrane(mesh, 7.0, name="sheet")])
    system = structure.assemble([Support("sheet", "left", 0, 1.0), Support("sheet", "right", 0)])
    w = structure.displacements("sheet", system.expand(spla.spsolve(system.K, system.f)))[:, 0]
    exact = np.log(2 / np.linalg.norm(mesh.points, axis=1)) / np.log(2)
    assert np.abs(w - exact).max() < 5e-4
    assert structure.unknown_names()[:2] == ("sheet node 0 z", "sheet node 1 z")


def test_a_part_that_nothing_holds_rests_on_its_obstacle_or_is_named():
    """Two squares in one mesh, the left one held at a node, both pushed down by 1 at every node."""
    points = [[0, 0], [1, 0], [1, 1], [0, 1], [3, 0], [4, 0], [4, 1], [3, 1]]
    sheet = Membrane(mesh_from_arrays(points, {"quad4": [[0, 1, 2, 3], [4, 5, 6, 7]]}), 1.0, name="sheet")
    system = Structure([sheet]).assemble([Support("sheet", 0, 0)])
    down = -np.ones(len(system.free))
    resting = cq.solve(system.problem([pair_scalar(points, np.full(8, -0.5))]).replace(load=down))
    assert resting.certificate.passed
    np.testing.assert_allclose(resting.normal_force[-4:], 1.0, rtol=1e-12)
    with pytest.raises(cq.NoEquilibrium, match=r"sheet along z by -1 \(node 4 and 3 more\)"):
        cq.solve(system.problem([]).replace(load=down))
    with pytest.raises(cq.NoEquilibrium, match=r"sheet along z by -1 \(node 4 and 3 more\)"):
        cq.solve(system.problem([pair_scalar(points, np.where(np.arange(8) < 4, -0.5, -np.inf))]).replace(load=down))


def test_what_is_no_membrane_is_refused():
    with pytest.raises(InvalidProblem, match="drum: expected a positive tension, got 0"):
        Membrane(disc(1.0, (1, 1)), 0.0, name="drum")
    with pytest.raises(InvalidProblem, match="drum: tension: expected a number, got '5'"):
        Membrane(disc(1.0, (1, 1)), "5", name="drum")
    with pytest.raises(InvalidProblem, match="drum: mesh: expected a Mesh, got None"):
        Membrane(None, 1.0, name="drum")
    with pytest.raises(InvalidProblem, match="drum: expected a plane mesh for a membrane, got one in 3D"):
        Membrane(box((1.0, 1.0, 1.0), (1, 1, 1)), 1.0, name="drum")
    drum = Membrane(disc(1.0, (1, 1)), 1.0, name="drum")
    with pytest.raises(InvalidProblem, match="membrane and 2D ones"):
        Structure([drum, Body(disc(1.0, (1, 1)), STEEL, "plane-strain", name="disc")])
    structure = Structure([drum])
    for load in (Traction("drum", "arc", [0.0, 0.0]), cq.Gravity("drum", [0.0, 0.0])):
        with pytest.raises(
            InvalidProblem, match=r"drum: a membrane takes a Pressure .* PointLoads .*, got (Tract|Grav)"
        ):
            structure.assemble([], [load])
    with pytest.raises(InvalidProblem, match=r"drum: pressure: expected the side 'above' or 'below' .*, got 'arc'"):
        structure.assemble([], [cq.Pressure("drum", "arc", 1.0)])
    with pytest.raises(InvalidProblem, match=r"point load: expected a value of shape \(1,\), got \(2,\)"):
        structure.assemble([], [cq.PointLoad("drum", 0, [0.0, 1.0])])
    with pytest.raises(InvalidProblem, match=r"expected the axis 0 \(z\), got 2"):
        structure.assemble([Support("drum", "arc", 2)])
    with pytest.raises(InvalidProblem, match=r"expected the axis 0 \(z\), got 'x'"):
        structure.assemble([Support("drum", "arc", "x")])
    held = (structure.assemble([Support("drum", "arc", axis, 0.1)]).prescribed for axis in (0, "z"))
    np.testing.assert_array_equal(*held)


def round_drum(elements: int, tension: float) -> tuple[cq.Structure, cq.Membrane]:
    drum = cq.Membrane(disc(1.0, (elements, elements)), tension, name="drum")
    return cq.Structure([drum]), drum


def test_a_round_membrane_under_pressure_is_a_paraboloid():
    """w = -p (a^2 - r^2) / (4 T), down from above and up from below; the load is p times the area."""
    structure, drum = round_drum(12, 3.0)
    down, up = (
        structure.assemble([Support("drum", "arc", 0)], [cq.Pressure("drum", side, 2.0)]) for side in ("above", "below")
    )
    w = structure.displacements("drum", down.expand(cq.solve(down.problem([])).displacement))[:, 0]
    exact = -2.0 * (1 - np.sum(drum.mesh.points**2, axis=1)) / (4 * 3.0)
    assert np.max(abs(w - exact)) < np.max(abs(exact)) / (5 * 12**2)  # of second order in 12 elements
    np.testing.assert_array_equal(down.load, -up.load)
    np.testing.assert_allclose(down.load.sum(), -2.0 * drum.mesh.volume(), rtol=1e-12)
    linear = structure.assemble([], [cq.Pressure("drum", "above", lambda x: 1.0 + x[..., 0])])
    np.testing.assert_allclose(linear.load.sum(), -drum.mesh.volume(), rtol=1e-12)


def test_a_point_load_on_a_membrane_is_along_z():
    structure, drum = round_drum(4, 1.0)
    middle = int(np.argmin(np.sum(drum.mesh.points**2, axis=1)))
    load = structure.assemble([Support("drum", "arc", 0)], [cq.PointLoad("drum", middle, [-5.0])]).load
    assert load[middle] == -5.0
    assert np.count_nonzero(load) == 1


def test_a_membrane_pressed_on_a_plate_carries_there_what_presses_on_it():
    """It touches the plate h below for r < c with h = p/(4T) (a^2 - c^2) + p c^2/(2T) ln(c/a): a force of p pi c^2."""
    c, p, tension = 0.5, 2.0, 3.0
    depth = p / (4 * tension) * (1 - c**2) + p * c**2 / (2 * tension) * np.log(c)
    structure, drum = round_drum(20, tension)
    system = structure.assemble([Support("drum", "arc", 0)], [cq.Pressure("drum", "above", p)])
    plate = cq.pair_scalar(drum.mesh.points, np.full(drum.size, -depth))
    solution = cq.solve(system.problem(plate))
    assert solution.certificate.proven
    np.testing.assert_allclose(solution.normal_force.sum(), p * np.pi * c**2, rtol=0.02)
