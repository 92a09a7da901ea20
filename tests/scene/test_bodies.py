"""Scenes of bodies become what the Python API makes of them, and their quantities mean what they say."""

from fractions import Fraction as F

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.loads import Pressure
from contactqp.elements.material import Material
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.scene.body_answers import summary_data
from contactqp.scene.building import build
from contactqp.scene.explaining import explain
from contactqp.scene.judging import Trial, judge
from contactqp.scene.scene import Scene

BLOCK = dict(
    name="block",
    shape={"kind": "rectangle", "element": "quad4", "size": ["2 mm", "1 mm"], "divisions": [4, 2], "grading": 3},
    model="plane-strain",
    thickness="10 mm",
    modulus="210 GPa",
    poisson=0.3,
    density="7850 kg/m^3",
)
PRESSED = dict(
    title="A block pressed on a plane",
    units={"length": "mm", "force": "N"},
    axes=["x", "y"],
    bodies=[BLOCK],
    obstacles=[{"name": "floor", "point": ["0 mm", "0 mm"], "normal": [0, 1]}],
    contacts=[{"name": "foot", "side": "block.bottom", "obstacle": "floor"}],
    supports=[{"name": "symmetry", "on": "block.left", "axis": "x"}],
    pressures=[{"name": "press", "side": "block.top", "value": "100 MPa"}],
)
POISSON_STRAIN = 100 / 210e3 * (1 - 0.3**2)


def values(trial=None, *claims, **changes):
    """What the answer says of each claim (quantity, keys)."""
    expect = [
        {"quantity": q, "value": "1" + unit, "tolerance": 1e-12, "derivation": "a probe", **keys}
        for q, unit, keys in claims
    ]
    judgement = judge(Scene(**PRESSED | changes, expect=expect), trial or Trial())
    return [row.got for row in judgement.expectations]


def test_the_scene_is_what_the_python_api_makes():
    problem = Scene(**PRESSED).problem()
    mesh = rectangle(2.0, 1.0, (4, 2), "quad4", grading=3.0)
    body = Body(mesh, Material(210e3, 0.3), "plane-strain", thickness=10.0, name="block")
    structure = Structure([body])
    system = structure.assemble([Support("block", "left", 0)], [Pressure("block", "top", 100.0)])
    floor = cq.Plane([0.0, 0.0], [0.0, 1.0])
    pairing = cq.pair(structure.surface("block", "bottom"), floor, dimension=structure.size)
    expected = system.problem([pairing])
    assert abs(problem.stiffness - expected.stiffness).max() == 0
    assert abs(problem.normal - expected.normal).max() == 0
    np.testing.assert_array_equal(problem.load, expected.load)
    np.testing.assert_array_equal(problem.gap, expected.gap)
    assert problem.contact_names == tuple(f"foot {node}" for node in pairing.nodes)
    assert problem.dof_names == expected.dof_names
    assert (problem.units.length, problem.units.force) == ("mm", "N")


def test_forces_pressures_stresses_and_displacements_of_a_uniform_state():
    corner = {"at": "block", "near": ["2 mm", "1 mm"]}
    found = values(
        None,
        ("contact force", " N", {"at": "foot"}),
        ("contact resultant", " N", {"at": "foot", "along": "y"}),
        ("contact resultant", " N", {"at": "foot", "along": "x"}),
        ("peak pressure", " MPa", {"at": "foot"}),
        ("contact pressure", " MPa", {"at": "foot", "near": ["2 mm", "0 mm"]}),
        ("closed contacts", "", {"at": "foot"}),
        ("contact half-width", " mm", {"at": "foot", "near": ["0 mm", "0 mm"]}),
        ("node gap", " mm", {"at": "foot", "near": ["0 mm", "0 mm"]}),
        ("node displacement", " mm", {**corner, "along": "y"}),
        ("stress", " MPa", {**corner, "component": "yy"}),
        ("stress", " MPa", {**corner, "component": "zz"}),
        ("support force", " N", {"at": "symmetry"}),
        ("energy", " J", {}),
        ("free motions", "", {}),
    )
    expected = [2000, 2000, 0, 100, 100, 5, 2, 0, -POISSON_STRAIN, -100, -30, 0, -1000 * POISSON_STRAIN, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-9)


def test_other_units_give_the_same_answer():
    claims = (("peak pressure", " MPa", {"at": "foot"}), ("energy", " J", {}), ("contact force", " N", {"at": "foot"}))
    found = values(None, *claims, units={"length": "m", "force": "kN"})
    np.testing.assert_allclose(found, [100e3, -POISSON_STRAIN * 1e-3, 2.0], rtol=1e-10)


def test_gravity_is_weight():
    (found,) = values(None, ("contact force", " N", {"at": "foot"}), pressures=[], gravity=["0 m/s^2", "-10 m/s^2"])
    assert found == pytest.approx(7850 * 2e-3 * 1e-3 * 10e-3 * 10, rel=1e-11)


def test_load_factors_scale_loads_and_leave_prescribed_displacements():
    """Pressed down by a support: the force of the contact is that of the support plus the load."""
    supports = [*PRESSED["supports"], {"name": "lid", "on": "block.top", "axis": "y", "value": "-1 um"}]
    loads = {"supports": supports, "pressures": [], "point_loads": [
        {"name": "nail", "on": "block", "near": ["1 mm", "0.25 mm"], "force": ["0 N", "-600 N"]}
    ]}  # fmt: skip
    claims = [
        (quantity, " N", {"at": at, "load_factor": factor})
        for factor in (0, 0.5, 1)
        for quantity, at in (("contact force", "foot"), ("support force", "lid"))
    ]
    forces = np.array(values(None, *claims, **loads)).reshape(3, 2)
    np.testing.assert_allclose(forces.sum(axis=1), [0, 300, 600], atol=1e-8)
    assert forces[0, 1] == pytest.approx(-1e-3 * 210e3 / (1 - 0.3**2) * 20, rel=1e-10)
    assert forces[2, 1] > forces[1, 1] > forces[0, 1]


def test_prescribed_energy_counts_all_unknowns():
    """A block drawn down by a support has 1/2 the work of the support, positive."""
    supports = [*PRESSED["supports"], {"name": "lid", "on": "block.top", "axis": "y", "value": "-1 um"}]
    found = values(None, ("energy", " J", {}), ("support force", " N", {"at": "lid"}), supports=supports, pressures=[])
    assert found[0] == pytest.approx(-0.5e-3 * found[1], rel=1e-11)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("element", ["quad4", "tri3", "quad8", "quad9", "tri6"])
def test_axisymmetric_pressure_is_force_over_rings(element):
    """A round block under uniform pressure: the force is that of the full circle, the pressure the same everywhere."""
    body = {**BLOCK, "model": "axisymmetric", "shape": {**BLOCK["shape"], "element": element}}
    body.pop("thickness")
    found = values(
        None,
        ("contact force", " N", {"at": "foot"}),
        ("peak pressure", " MPa", {"at": "foot"}),
        ("contact pressure", " MPa", {"at": "foot", "near": ["2 mm", "0 mm"]}),
        bodies=[body],
    )
    assert found[0] == pytest.approx(100 * np.pi * 4, rel=1e-10)
    if element in ("quad4", "tri3"):
        assert found[1:] == pytest.approx([100, 100], rel=1e-10)
    else:  # right in the mean only, as contactqp.elements.nodal_pressure says
        assert found[1:] == pytest.approx([100, 100], rel=0.35)


@pytest.mark.parametrize("pairing", ["mortar", "node-to-segment"])
def test_a_slave_pushes_its_master_with_what_it_feels(pairing):
    upper = {**BLOCK, "name": "upper", "shape": {**BLOCK["shape"], "corner": ["0 mm", "1 mm"], "divisions": [7, 2]}}
    found = values(
        None,
        ("contact resultant", " N", {"at": "joint", "along": "y"}),
        ("contact force", " N", {"at": "foot"}),
        bodies=[BLOCK, upper],
        contacts=[*PRESSED["contacts"], {"name": "joint", "sides": ["upper.bottom", "block.top"], "pairing": pairing}],
        supports=[*PRESSED["supports"], {"name": "left", "on": "upper.left", "axis": "x"}],
        pressures=[{"name": "press", "side": "upper.top", "value": "100 MPa"}],
    )
    assert found == pytest.approx([2000, 2000], rel=1e-10)


def test_a_claim_about_bodies_can_fail():
    for quantity, wrong, at in (("contact force", "2001 N", "foot"), ("peak pressure", "99 MPa", "foot")):
        claim = {"quantity": quantity, "at": at, "value": wrong, "tolerance": 1e-4, "derivation": "wrong"}
        (row,) = judge(Scene(**PRESSED, expect=[claim]), Trial()).expectations
        assert not row.ok


def test_a_load_path_finds_when_a_contact_closes():
    """Hung from its top over a floor 1 um below and drawn down by 100 MPa: the gap is p H (1 - nu^2) / E at contact."""
    scene = Scene(
        **PRESSED
        | {
            "obstacles": [{"name": "floor", "point": ["0 mm", "-0.2 um"], "normal": [0, 1]}],
            "supports": [*PRESSED["supports"], {"name": "hung", "on": "block.top", "axis": "y"}],
            "pressures": [],
            "tractions": [{"name": "pull", "side": "block.bottom", "value": ["0 MPa", "-100 MPa"]}],
            "path": {"steps": 4, "events": "exact"},
        }
    )
    history = cq.run(scene)
    assert history[0].energy == 0
    closed = [event.time for event in history.events if event.kind == "closed"]
    assert len(closed) == 5
    np.testing.assert_allclose(closed, 0.2e-3 / POISSON_STRAIN, rtol=1e-9)
    assert history[-1].normal_force.sum() == pytest.approx(2000 * (1 - 0.2e-3 / POISSON_STRAIN), rel=1e-9)


def test_a_stated_overlap_presses():
    """A floor 1 um inside the block, whose top is held: sigma = E / (1 - nu^2) 1e-3."""
    contact = {**PRESSED["contacts"][0], "overlap": "1 um"}
    (found,) = values(
        None,
        ("peak pressure", " MPa", {"at": "foot"}),
        contacts=[contact],
        obstacles=[{"name": "floor", "point": ["0 mm", "1 um"], "normal": [0, 1]}],
        supports=[*PRESSED["supports"], {"name": "lid", "on": "block.top", "axis": "y"}],
        pressures=[],
    )
    assert found == pytest.approx(210 / (1 - 0.3**2), rel=1e-10)


def test_friction_rows_come_in_with_friction():
    contact = {**PRESSED["contacts"][0], "friction": 0.3}
    problem = Scene(**PRESSED | {"contacts": [contact]}).problem()
    assert problem.tangent.shape[0] == problem.contacts
    assert set(problem.friction) == {0.3}


def test_near_is_a_node_to_within_one_percent_of_an_element():
    """Of 0.5 mm times 0.75 mm at this corner: the value of a neighbour must not be taken for that of the point."""

    def corner(x):
        return values(None, ("node displacement", " mm", {"at": "block", "along": "y", "near": [x, "1 mm"]}))

    assert corner("2.005 mm") == corner("2 mm")
    with pytest.raises(cq.SceneError, match=r"near: expected a node of the body 'block' .* node \d+ at \(2, 1\), 0.02"):
        corner("2.02 mm")
    with pytest.raises(cq.SceneError, match=r"near: expected a node of the contact, got node \d+ of 'block'"):
        values(None, ("contact pressure", " MPa", {"at": "foot", "near": ["2 mm", "1 mm"]}))


def test_a_box_may_have_a_crown():
    """Beside it no other shape has one; the gap to the plane below is that of the paraboloid."""
    shape = {"kind": "box", "element": "hex8", "size": ["2 mm"] * 3, "divisions": [2, 2, 2], "crown": "1 cm"}
    body = {"name": "block", "shape": shape, "model": "3d", "modulus": "1 GPa", "poisson": 0}
    floor = {"name": "floor", "point": ["0 mm"] * 3, "normal": [0, 0, 1]}
    crowned = Scene(
        title="crowned", units={"length": "mm"}, axes=["x", "y", "z"], bodies=[body], obstacles=[floor],
        contacts=[{"name": "foot", "side": "block.bottom", "obstacle": "floor"}],
    )  # fmt: skip
    np.testing.assert_allclose(sorted(crowned.problem().gap), np.sort([0, 1, 1, 2, 4, 4, 5, 5, 8]) / 20.0, atol=1e-15)
    with pytest.raises(cq.SceneError, match="crown: a rectangle has no such key"):
        Scene(**PRESSED | {"bodies": [PRESSED["bodies"][0] | {"shape": BLOCK["shape"] | {"crown": "1 cm"}}]})


def test_contacts_of_held_nodes_are_left_out_and_counted():
    held = [*PRESSED["supports"], {"name": "pin", "on": "block", "near": ["2 mm", "0 mm"], "axis": "y"}]
    held += [{"name": "pin x", "on": "block", "near": ["2 mm", "0 mm"], "axis": "x"}]
    scene = Scene(**PRESSED | {"supports": held})
    model, solution = build(scene), cq.run(scene)[-1]
    assert model.problem.contacts == 4
    forces = model.normal_forces("foot", solution)
    assert len(forces) == 5
    assert forces[4] == 0
    assert model.gaps("foot", solution)[4] == 0  # where the support leaves it


def test_a_held_side_above_an_obstacle_has_the_gap_that_its_supports_leave():
    """Its contacts are none of the problem: their gap is the initial one, less what the supports move."""
    obstacle = {"name": "floor", "point": ["0 mm", "-1 mm"], "normal": [0, 1]}
    for moved, gap in (("0 mm", 1e-3), ("-0.4 mm", 0.6e-3), ("0.5 mm", 1.5e-3)):
        supports = [{"name": "held", "on": "block.bottom", "axis": "y", "value": moved}]
        supports += [{"name": "middle", "on": "block.left", "axis": "x"}]
        scene = Scene(
            title="held", units={"length": "m", "force": "kN"}, axes=["x", "y"], obstacles=[obstacle],
            contacts=[{"name": "foot", "side": "block.bottom", "obstacle": "floor"}], supports=supports,
            tractions=[{"name": "press", "side": "block.top", "value": ["0 MPa", "-5 MPa"]}],
            bodies=[{
                "name": "block", "model": "plane-strain", "thickness": "1 m", "modulus": "21 GPa", "poisson": 0.3,
                "shape": {"kind": "rectangle", "element": "quad4", "size": ["1 m", "1 m"], "divisions": [4, 4]},
            }],
        )  # fmt: skip
        model, solution = build(scene), cq.run(scene)[-1]
        assert model.problem.contacts == 0
        np.testing.assert_allclose(model.gaps("foot", solution), gap, rtol=1e-12)
        (told,) = summary_data(model, solution)["contacts"]
        assert told["smallest_gap"] == pytest.approx(gap, rel=1e-12)


def test_meshes_from_files_are_found_beside_the_case_and_have_their_unit(tmp_path):
    meshlane = pytest.importorskip("meshlane")
    mesh = rectangle(2.0, 1.0, (4, 2), "quad4", grading=3.0)
    low = (mesh.points[:, 1] < 1e-9).astype(int)
    left = (mesh.points[:, 0] < 1e-9).astype(int)
    high = (mesh.points[:, 1] > 1 - 1e-9).astype(int)
    points = np.column_stack([mesh.points, np.zeros(len(mesh.points))])
    sets = {"bottom": low, "left": left, "top": high}
    meshlane.Mesh(points, [("quad", mesh.blocks[0].nodes)], point_data=sets).write(tmp_path / "block.vtu")
    case = tmp_path / "case.toml"
    case.write_text(
        """
title = "From a file"
units = { length = "m", force = "N" }
axes = ["x", "y"]
obstacles = [{ name = "floor", point = ["0 mm", "0 mm"], normal = [0, 1] }]
contacts = [{ name = "foot", side = "block.bottom", obstacle = "floor" }]
supports = [{ name = "symmetry", on = "block.left", axis = "x" }]
pressures = [{ name = "press", side = "block.top", value = "100 MPa" }]
bodies = [
    { name = "block", mesh = { file = "block.vtu", unit = "mm" }, model = "plane-strain", thickness = "10 mm", \
modulus = "210 GPa", poisson = 0.3 },
]
"""
    )
    solution = cq.run(cq.load_scene(case))[-1]
    assert solution.normal_force.sum() == pytest.approx(2000, rel=1e-11)
    assert np.abs(solution.displacement).max() < 1e-6


def test_explain_says_what_is_there_and_what_is_left_out():
    explanation = explain(Scene(**PRESSED | {"report": {"methods": ["active-set"], "why": "it is quick"}}))
    found = {block.name: block for block in explanation.blocks}
    assert found["body block"].reason == "8 elements (quad4), 15 nodes, plane-strain"
    assert not found["gravity"].included
    assert found["all methods in a report"].reason == "only active-set: it is quick"
    assert explanation.contacts == ("foot: block.bottom against the obstacle 'floor', 5 nodes, gaps from 0 to 0 mm",)
    assert len(explanation.fixed) == 3
    assert len(explanation.unknowns) == 27


def test_a_load_factor_of_one_is_the_problem_itself():
    model = build(Scene(**PRESSED))
    np.testing.assert_array_equal(model.load_at(F(1)), model.problem.load)
    np.testing.assert_array_equal(model.load_at(F(1, 2)), model.problem.load / 2)


def test_a_side_closes_with_its_first_node_and_opens_with_its_last():
    """On a load path as in a motion. Pressed from the right the block swells by nu (1 + nu) p / E towards the floor."""
    swells = F(100) * F(39, 100) / 210_000  # of its 1 mm
    changes = {
        "supports": [*PRESSED["supports"], {"name": "top", "on": "block.top", "axis": "y"}],
        "pressures": [{"name": "press", "side": "block.right", "value": "100 MPa"}],
        "obstacles": [{"name": "floor", "point": ["0 mm", f"-{swells * F(7, 20)} mm"], "normal": [0, 1]}],
        "path": {"steps": 5, "corners": [{"press": 1}, {"press": -1}]},
    }
    events = {"closed": "2/5", "opened": "1 + 2/5"}
    expect = [
        {"quantity": "event time", "at": "foot", "event": event, "value": time, "derivation": "the step after it"}
        for event, time in events.items()
    ]
    judgement = judge(Scene(**PRESSED | changes, expect=expect), Trial())
    assert judgement.met, judgement.expectations
    assert len([event for event in judgement.history.events if event.kind == "closed"]) == 5


def test_loads_of_one_name_on_several_sides_share_a_factor():
    """A block, pressed by one traction and a half on the same side, in two loads of one name."""
    press = {"name": "press", "side": "block.right", "value": "100 MPa"}
    across = {"name": "press", "side": "block.right", "value": ["-50 MPa", "0 MPa"]}
    path = {"steps": 1, "corners": [{"press": 2}]}
    one = PRESSED | {"pressures": [press | {"value": "300 MPa"}], "path": path | {"corners": [{"press": 1}]}}
    several = PRESSED | {"pressures": [press, press | {"value": "0 MPa"}], "tractions": [across], "path": path}
    expected = cq.run(Scene(**one))[-1].displacement
    np.testing.assert_allclose(cq.run(Scene(**several))[-1].displacement, expected, rtol=1e-12, atol=1e-15)
    assert abs(expected).max() > 1e-3
