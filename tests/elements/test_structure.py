"""Several bodies in one u: supports, loads, contact rows of the free unknowns, and the way back."""

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla

import contactqp as cq
from contactqp.elements.loads import Gravity, Pressure, Traction
from contactqp.elements.pairing import Pairing
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body, stress_at_nodes
from contactqp.elements.structure import Structure, Support
from contactqp.errors import InvalidProblem
from tests.elements.bodies import STEEL

E, NU = STEEL.modulus, STEEL.poisson
FLOOR = cq.Plane(point=[0.0, 0.0], normal=[0.0, 1.0])


def block(name="block", low=0.0, kind="quad4", cells=(2, 2)):
    return Body(rectangle(2.0, 1.0, cells, kind, corner=(0.0, low)), STEEL, "plane-stress", name=name)


def on_floor(structure, name="block", side="bottom"):
    surface = structure.surface(name, side)
    nodes = surface.nodes
    return cq.pair(surface.points[nodes], FLOOR, unknowns=surface.unknowns[nodes], dimension=structure.size)


def test_bodies_stand_one_after_the_other():
    lower, upper = block("lower"), block("upper", low=1.0, cells=(3, 1))
    structure = Structure([lower, upper])
    assert structure.size == lower.size + upper.size
    assert structure.first("upper") == lower.size
    assert structure.surface("upper", "bottom").unknowns[0].tolist() == [lower.size, lower.size + 1]
    K = structure.stiffness.toarray()
    np.testing.assert_array_equal(K[: lower.size, : lower.size], lower.stiffness.toarray())
    np.testing.assert_array_equal(K[lower.size :, lower.size :], upper.stiffness.toarray())
    assert np.abs(K[: lower.size, lower.size :]).max() == 0
    u = np.arange(structure.size, dtype=float)
    assert structure.displacements("upper", u)[0].tolist() == [lower.size, lower.size + 1]
    assert structure.unknown_names()[lower.size + 3] == "upper node 1 y"


def test_rows_of_sides_are_over_all_unknowns_of_their_structure_or_body():
    lower, upper = block("lower"), block("upper", low=1.0, cells=(3, 1))
    structure = Structure([lower, upper])
    joint = structure.surface("upper", "bottom"), structure.surface("lower", "top")
    floor = cq.pair(structure.surface("lower", "bottom"), FLOOR)
    for found in (floor, cq.pair_node_to_segment(*joint), cq.pair_mortar(*joint)):
        assert found.normal.shape[1] == structure.size
    assert cq.pair(lower.surface("bottom"), FLOOR).normal.shape[1] == lower.size
    assert cq.ObstacleContact(lower.surface("bottom"), FLOOR).dimension == lower.size
    assert cq.pair(lower.surface("bottom"), FLOOR, dimension=structure.size).normal.shape[1] == structure.size
    with pytest.raises(InvalidProblem, match="unknowns: expected numbers from 0 to 3, got 17"):
        cq.pair(lower.surface("bottom"), FLOOR, dimension=4)


def test_prescribed_displacements_strain_the_block_uniformly():
    structure = Structure([block()])
    stretch = 0.01
    supports = [
        Support("block", "left", 0),
        Support("block", "right", 0, 2.0 * stretch),
        Support("block", structure.body("block").mesh.nearest((0, 0)), 1),
    ]
    system = structure.assemble(supports)
    u = system.expand(spla.spsolve(system.K, system.f))
    x = structure.body("block").mesh.points
    np.testing.assert_allclose(structure.displacements("block", u), x * [stretch, -NU * stretch], atol=1e-15)
    stress = stress_at_nodes(structure.body("block"), u)
    np.testing.assert_allclose(stress, np.tile([E * stretch, 0, 0, 0, 0, 0], (len(x), 1)), atol=1e-12)
    forces = system.support_forces(u).reshape(-1, 2)
    right = structure.body("block").mesh.nodes("right")
    assert np.isclose(forces[right, 0].sum(), E * stretch * 1.0)
    np.testing.assert_allclose(forces.sum(axis=0), 0, atol=1e-13)
    assert abs(system.K - system.K.T).max() == 0


def test_a_prescribed_field_is_taken_at_the_nodes():
    """u = (x y, y^2) on the whole outline, each support in its own order of nodes."""
    structure = Structure([block(cells=(3, 2))])
    fields = (lambda x: x[:, 0] * x[:, 1], lambda x: x[:, 1] ** 2)
    sides = ("top", "left", "right", "bottom")
    system = structure.assemble([Support("block", side, axis, fields[axis]) for side in sides for axis in (0, 1)])
    mesh = structure.body("block").mesh
    outline = np.unique(np.concatenate([mesh.nodes(side) for side in sides]))
    u = structure.displacements("block", system.given)[outline]
    np.testing.assert_array_equal(u, np.column_stack([field(mesh.points[outline]) for field in fields]))
    assert len(system.free) == 2 * (len(mesh.points) - len(outline))


def test_two_supports_may_differ_by_rounding_and_by_no_more():
    third = [Support("block", "left", 1, 0.1 + 0.2), Support("block", "bottom", 1, 0.3)]
    assert np.nanmax(Structure([block()]).assemble(third).prescribed) == pytest.approx(0.3, rel=1e-15)
    with pytest.raises(InvalidProblem, match=r"is to move by 0\.3000000003 and, by another support, by 0\.3$"):
        Structure([block()]).assemble([third[0], Support("block", "bottom", 1, 0.3 * (1 + 1e-9))])


def test_loads_add_up_and_supports_carry_them():
    structure = Structure([block("a"), block("b", low=2.0)])
    supports = [Support(name, "bottom", axis) for name in "ab" for axis in (0, 1)]
    loads = [Gravity("b", [0.0, -10.0]), Pressure("b", "top", 3.0), Traction("b", "right", [5.0, 0.0])]
    system = structure.assemble(supports, loads)
    u = system.expand(spla.spsolve(system.K, system.f))
    on_b = system.support_forces(u)[structure.first("b") :].reshape(-1, 2).sum(axis=0)
    np.testing.assert_allclose(on_b, [-5.0, 10 * STEEL.density * 2.0 + 6.0], rtol=1e-12)
    assert np.abs(system.support_forces(u)[: structure.first("b")]).max() < 1e-13
    assert np.abs(structure.displacements("a", u)).max() == 0


def test_a_block_pressed_on_the_floor():
    """The top is moved down by d; a frictionless floor gives sigma_yy = -E d / height everywhere."""
    structure = Structure([block(kind="quad8")])
    d = 0.02
    system = structure.assemble(
        [Support("block", "top", 1, -d), Support("block", structure.body("block").mesh.nearest((0, 1)), 0)]
    )
    problem = system.problem([on_floor(structure)], units={"length": "mm", "force": "kN"})
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert np.isclose(solution.normal_force.sum(), E * d * 2.0, rtol=1e-12)
    u = system.expand(solution.displacement)
    stress = stress_at_nodes(structure.body("block"), u)
    np.testing.assert_allclose(stress[:, 1], -E * d, rtol=1e-10)
    pairing = on_floor(structure)
    contact = pairing.normal.T @ solution.normal_force
    assert np.isclose(system.support_forces(u, contact)[1::2].sum(), -E * d * 2.0, rtol=1e-12)
    assert problem.dof_name(0) == "block node 0 x"


def test_what_the_supports_prescribe_moves_the_gap():
    """A column whose only contact node is prescribed sideways: the gap is taken at the prescribed place."""
    structure = Structure([block()])
    n = structure.size
    row = sp.csr_array(np.eye(n)[[0, 1]].sum(axis=0)[None])  # u_x + u_y of node 0
    nodes, nobody = np.array([0]), np.zeros(0, dtype=np.int64)
    pairing = Pairing(row, np.array([0.5]), sp.csr_array((1, n)), nodes, np.zeros((1, 2)), np.eye(2)[:1], nobody)
    system = structure.assemble([Support("block", 0, 0, 0.2)])
    problem = system.problem([pairing])
    assert np.isclose(problem.gap[0], 0.3)
    assert problem.normal.toarray()[0].tolist() == [1.0] + [0.0] * (n - 2)


def test_contacts_that_no_free_unknown_moves_are_left_out_and_keep_their_names():
    structure = Structure([block(cells=(2, 1))])
    system = structure.assemble([Support("block", "left", 0), Support("block", "left", 1, -0.0)])
    pairing = on_floor(structure)
    nodes = structure.surface("block", "bottom").nodes
    kept = system.free_contacts([pairing])
    assert kept.tolist() == [i for i, node in enumerate(nodes) if structure.bodies[0].mesh.points[node, 0] > 0]
    problem = system.problem([pairing, pairing])
    assert problem.contacts == 4
    assert [problem.contact_name(i) for i in range(4)] == [f"contact {i}" for i in (*kept, *(kept + 3))]
    sunk = structure.assemble([Support("block", "left", 0), Support("block", "left", 1, -0.25)])
    with pytest.raises(InvalidProblem, match=r"contact \d: its nodes are supported and overlap by 0.25"):
        sunk.problem([pairing])


def test_friction_brings_the_tangents_of_the_kept_contacts_and_where_slip_starts():
    structure = Structure([block(cells=(2, 1))])
    pairing = on_floor(structure)
    system = structure.assemble([Support("block", "left", 1), Support("block", "bottom", 0, 0.1)])
    problem = system.problem([pairing], friction=[0.1, 0.2, 0.3])
    kept = system.free_contacts([pairing])
    np.testing.assert_array_equal(problem.friction, np.array([0.1, 0.2, 0.3])[kept])
    np.testing.assert_allclose(problem.slip_origin, -0.1)
    assert system.problem([pairing]).tangent is None


@pytest.mark.parametrize(
    ("supports", "message"),
    [
        ([Support("plate", "left", 0)], "there is no body 'plate'; it has 'block'"),
        ([Support("block", "front", 0)], "there is no set 'front'"),
        ([Support("block", "left", 2)], r"support of 'block': expected the axis 0 \(x\) or 1 \(y\), got 2"),
        ([Support("block", "left", 0, float("nan"))], "support of 'block': expected finite numbers, got nan"),
        (
            [Support("block", "left", 0, lambda x: x)],
            r"support of 'block': expected a value of shape \(3,\), got \(3, 2",
        ),
        (
            [Support("block", "left", 1), Support("block", "bottom", 1, lambda x: x[:, 0] - 0.5)],
            r"node 0 along y is to move by -0.5 and, by another support, by 0",
        ),
        ([Support("block", 99, 0)], "block: expected nodes from 0 to 8, got 99"),
        (
            [Support("block", "left", 1), Support("block", "bottom", 1, -0.5)],
            r"node 0 along y is to move by -0.5 and, by another support, by 0",
        ),
        ([Support("block", range(9), 0), Support("block", range(9), 1)], "the supports hold every unknown"),
    ],
)
def test_supports_that_do_not_fit_are_refused(supports, message):
    with pytest.raises(InvalidProblem, match=message):
        Structure([block()]).assemble(supports)


def test_structures_that_do_not_fit_are_refused():
    with pytest.raises(InvalidProblem, match="expected at least one body"):
        Structure([])
    with pytest.raises(InvalidProblem, match="expected bodies with distinct names, got 'block' more than once"):
        Structure([block(), block(low=2.0)])
    with pytest.raises(InvalidProblem, match="expected bodies of one dimension"):
        Structure([block(), Body(box((1, 1, 1), (1, 1, 1)), STEEL, "3d", name="cube")])
    structure = Structure([block()])
    with pytest.raises(InvalidProblem, match=r"pairing 0: expected rows over all 18 unknowns, got 4"):
        structure.assemble().problem([cq.pair([[0.0, 0.0], [1.0, 0.0]], FLOOR)])


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("height", "fits"), [(0.3, True), (0.1 + 0.2, True), (0.3 + 1e-9, False)])
def test_supported_nodes_that_touch_by_the_rounding_of_coordinates_do_not_overlap(height: float, fits: bool) -> None:
    mesh = cq.rectangle(1.0, 0.5, (4, 2), "quad4", corner=(0.0, 0.3))
    structure = cq.Structure([cq.Body(mesh, cq.Material(2.1e11, 0.3), "plane-strain", name="block")])
    held = [cq.Support("block", "left", axis) for axis in (0, 1)]
    system = structure.assemble(held, [cq.Pressure("block", "top", 1e6)])
    pairing = cq.pair(structure.surface("block", "bottom"), cq.Plane([0.0, height], [0.0, 1.0]))
    if fits:
        assert cq.solve(system.problem([pairing])).normal_force.sum() > 0
    else:
        with pytest.raises(cq.InvalidProblem, match="overlap by 1e-09; nothing can part them"):
            system.problem([pairing])


def test_axes_have_letters_and_structures_are_shown_in_a_line() -> None:
    body = Body(rectangle(2.0, 1.0, (2, 1), "quad4"), STEEL, "plane-strain", name="block")
    structure = Structure([body])
    by_letter, by_number = (structure.prescribed([Support("block", "left", axis, 0.1)]) for axis in ("y", 1))
    assert np.array_equal(by_letter, by_number, equal_nan=True)
    assert repr(structure) == "Structure(block; 12 unknowns)"
    assert repr(body) == "Body(block: Mesh(6 nodes, 2 quad4, sides bottom, left, right, top), plane-strain)"
    with pytest.raises(InvalidProblem, match="Support: axis: expected a whole number or one of 'x', 'y', 'z'"):
        Support("block", "left", "w")
