"""A scene becomes the numbers of the book, exactly; the same scene can be written in Python; units change nothing."""

import pickle
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.scene.building import exact_problem
from contactqp.scene.schema import Scene

CASES = Path(__file__).parents[2] / "cases"
WALL = dict(
    title="A bar and a rigid wall",
    units={"length": "m", "force": "kN"},
    axes=["x"],
    nodes=[{"name": "support", "at": ["0 m"]}, {"name": "1", "at": ["2 m"]}],
    bars=[{"name": "bar", "nodes": ["support", "1"], "area": "15 cm^2", "modulus": "2.1e8 kN/m^2"}],
    fixed=["support"],
    obstacles=[{"name": "wall", "point": ["2.001 m"], "normal": [-1]}],
    contacts=[{"name": "tip", "node": "1", "obstacle": "wall"}],
    loads=[{"unknown": "1.x", "value": "300 kN"}],
)


def test_the_bar_and_the_wall_in_exact_numbers():
    exact = exact_problem(Scene(**WALL))
    assert exact.unknowns.free == ("1.x",)
    assert exact.stiffness["1.x", "1.x"] == 157500
    assert exact.load == {"1.x": 300}
    (contact,) = exact.contacts
    assert (contact.normal, contact.gap) == ({"1.x": 1}, F(1, 1000))
    assert exact.rational


def test_the_file_and_python_are_the_same_scene():
    file, written = cq.load_scene(CASES / "bar_wall.toml").problem(), Scene(**WALL).problem()
    for name in ("stiffness", "load", "gap", "tie_value"):
        np.testing.assert_array_equal(getattr(file, name), getattr(written, name))
    assert (file.normal != written.normal).nnz == 0
    assert file.dof_names == ("1.x",)
    assert file.contact_names == ("tip",)
    assert (file.units.length, file.units.force) == ("m", "kN")


def test_a_scene_is_frozen_and_can_be_sent_to_another_process():
    scene = Scene(**WALL)
    with pytest.raises(Exception, match="frozen"):
        scene.title = "another"
    assert pickle.loads(pickle.dumps(scene)) == scene


def test_a_scene_made_in_python_is_checked_like_a_file():
    with pytest.raises(cq.SceneError, match=r"^bars\[0\].area \('bar'\): expected an area"):
        Scene(**WALL | {"bars": [WALL["bars"][0] | {"area": 15}]})
    with pytest.raises(cq.SceneError, match="there is no key 'load'; nearest: 'loads'"):
        Scene(**WALL, load=[])
    with pytest.raises(cq.SceneError, match="there is no key 'self'"):
        Scene(**(WALL | {"self": 1}))


@pytest.mark.parametrize(("length", "force"), [("mm", "N"), ("m", "N"), ("in", "lbf"), ("um", "MN")])
def test_the_answer_does_not_depend_on_the_units(length, force):
    scene = Scene(**WALL | {"units": {"length": length, "force": force}})
    solution = cq.run(scene)[-1]
    reference = cq.run(Scene(**WALL))[-1]
    metre = F(1) / scene.system._factor(scene.bars[0].modulus.dimension._replace(force=0, length=1))
    kilonewton = 1000 / scene.system._factor(scene.loads[0].value.dimension)
    np.testing.assert_allclose(solution.displacement, reference.displacement * float(metre), rtol=1e-14)
    np.testing.assert_allclose(solution.normal_force, reference.normal_force * float(kilonewton), rtol=1e-13)


def test_rotations_come_with_beams_only():
    problem = cq.load_scene(CASES / "tie_column_solid.toml").problem()
    assert [name for name in problem.dof_names if name.endswith("theta")] == ["2.theta", "top.theta"]
    assert exact_problem(cq.load_scene(CASES / "tie_column_solid.toml")).rational


def test_an_irrational_bar_is_said_to_be_so():
    exact = exact_problem(cq.load_scene(CASES / "truss_floor.toml"))
    assert not exact.rational
    assert isinstance(exact.contacts[0].gap, F)


def test_friction_brings_tangential_rows_and_nothing_else_does():
    assert cq.load_scene(CASES / "truss_floor.toml").problem().tangent is None
    data = dict(
        title="rubbing", axes=["x", "z"], nodes=[{"name": "1", "at": ["0 m", "0 m"]}],
        springs=[
            {"name": "a", "nodes": ["1"], "direction": [1, 0], "stiffness": "1 N/m"},
            {"name": "b", "nodes": ["1"], "direction": [0, 1], "stiffness": "1 N/m"},
        ],
        obstacles=[{"name": "floor", "point": ["0 m", "-1 mm"], "normal": [0, 1]}],
        contacts=[{"name": "foot", "node": "1", "obstacle": "floor", "friction": 0.3}],
    )  # fmt: skip
    problem = Scene(**data).problem()
    assert problem.tangent.toarray().tolist() == [[1, 0]]
    assert problem.friction.tolist() == [0.3]


def test_a_mass_weighs():
    data = dict(
        title="a stone on a floor", axes=["x", "z"], gravity=["0 m/s^2", "-9.81 m/s^2"],
        nodes=[{"name": "stone", "at": ["0 m", "0 m"]}], fixed=["stone.x"],
        masses=[{"name": "m", "node": "stone", "mass": "2 kg"}],
        obstacles=[{"name": "floor", "point": ["0 m", "0 m"], "normal": [0, 1]}],
        contacts=[{"name": "foot", "node": "stone", "obstacle": "floor"}],
    )  # fmt: skip
    assert exact_problem(Scene(**data)).load["stone.z"] == F(-1962, 100)
    assert np.isclose(cq.run(Scene(**data))[-1].normal_force[0], 19.62, rtol=1e-12)


def test_a_large_chain_is_sparse():
    count = 300
    scene = Scene(
        title="a chain", axes=["x"], nodes=[{"name": str(i), "at": [f"{i} m"]} for i in range(count)], fixed=["0"],
        springs=[{"name": str(i), "nodes": [str(i), str(i + 1)], "stiffness": "1 N/m"} for i in range(count - 1)],
    )  # fmt: skip
    stiffness = scene.problem().stiffness
    assert stiffness.nnz == 3 * (count - 1) - 2
