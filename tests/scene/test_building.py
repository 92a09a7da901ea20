"""Scenes become the numbers of their contact problems, exactly; ties are eliminated exactly."""

from __future__ import annotations

import pickle
from dataclasses import replace
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.scene import building
from contactqp.scene.building import exact_problem
from contactqp.scene.scene import Scene

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


WIRE = dict(
    title="a wire along a slope of 3 in 4",
    axes=["x", "z"],
    nodes=[{"name": n, "at": [f"{4 * i} m", f"{3 * i} m"]} for i, n in enumerate("abc")],
    strings=[{"name": "wire", "nodes": ["a", "b", "c"], "tension": "50 N"}],
    line_loads=[{"name": "snow", "string": "wire", "value": ["0 N/m", "-3 N/m"]}],
    fixed=["a", "c"],
)


def test_a_string_is_its_segments_in_exact_numbers():
    exact = exact_problem(Scene(**WIRE))
    # Two segments of 5 m, each with T / h P and P = I - n n', n = (4, 3) / 5.
    rows = {("b.x", "b.x"): F(36, 5), ("b.x", "b.z"): F(-48, 5), ("b.z", "b.z"): F(64, 5)}
    assert {key: exact.stiffness[key] for key in rows} == rows
    assert exact.load == {"a.x": 0, "a.z": F(-15, 2), "b.x": 0, "b.z": -15, "c.x": 0, "c.z": F(-15, 2)}
    assert exact.rational
    halves = [{"name": n, "nodes": list(n), "tension": "0.05 kN"} for n in ("ab", "bc")]
    loads = [WIRE["line_loads"][0] | {"name": n, "string": n} for n in ("ab", "bc")]
    apart = exact_problem(Scene(**WIRE | {"strings": halves, "line_loads": loads}))
    assert (apart.stiffness, apart.load) == (exact.stiffness, exact.load)


def test_a_string_in_space_deflects_across_itself_only():
    """What is left along the string is a free motion, named, as long as no load drives it."""
    scene = Scene(
        title="a wire in space", axes=["x", "y", "z"], fixed=["a", "c"],
        nodes=[{"name": n, "at": [f"{i} m", "0 m", "0 m"]} for i, n in enumerate("abc")],
        strings=[{"name": "wire", "nodes": ["a", "b", "c"], "tension": "2 N"}],
        loads=[{"unknown": "b.y", "value": "3 N"}, {"unknown": "b.z", "value": "-1 N"}],
    )  # fmt: skip
    solution = cq.run(scene)[-1]
    np.testing.assert_allclose(solution.displacement, [0, 0.75, -0.25], atol=1e-15)
    assert len(solution.free_motions) == 1
    pulled = scene.model_copy(update={"loads": (scene.loads[0].model_copy(update={"unknown": "b.x"}),)})
    with pytest.raises(cq.NoEquilibrium, match=r"b\.x"):
        cq.run(pulled)


def test_a_line_load_on_a_beam_has_its_ends_exactly_in_one_element_or_two():
    """q L^4 / (8 E I) and q L^3 / (6 E I) at the end of a cantilever on a slope of 3 in 4, in exact numbers."""
    q, length, bending = F(5), F(10), F(200)
    nodes = [{"name": n, "at": [f"{4 * i} m", f"{3 * i} m"]} for i, n in enumerate("abc")]
    beam = {"area": "1 m^2", "inertia": "2 m^4", "modulus": "100 Pa"}
    load = {"value": ["-3 N/m", "4 N/m"]}  # across the beam, to its left
    scene = dict(title="a cantilever", axes=["x", "y"], fixed=["a"])
    one = Scene(
        **scene,
        nodes=[nodes[0], nodes[2]],
        beams=[{"name": "beam", "nodes": ["a", "c"], **beam}],
        line_loads=[{"name": "q", "beam": "beam", **load}],
    )
    two = Scene(
        **scene,
        nodes=nodes,
        beams=[{"name": n, "nodes": list(n), **beam} for n in ("ab", "bc")],
        line_loads=[{"name": n, "beam": n, **load} for n in ("ab", "bc")],
    )
    assert exact_problem(one).load["c.theta"] == -q * length**2 / 12
    deflection, slope = q * length**4 / (8 * bending), q * length**3 / (6 * bending)
    for solution in (cq.run(one)[-1], cq.run(two)[-1]):
        expected = [float(-F(3, 5) * deflection), float(F(4, 5) * deflection), float(slope)]
        np.testing.assert_allclose([solution.at(f"c.{name}") for name in ("x", "y", "theta")], expected, rtol=1e-12)


def test_a_heavy_divided_beam_is_lifted_off_a_floor_as_far_as_in_closed_form():
    """Lifted by P at its end, the length a = 2 P / q is off the floor, and the end is q a^4 / (24 E I) above it."""
    count = 100
    beam = {"area": "0.1 m^2", "inertia": "1e-4 m^4", "modulus": "10 GPa", "density": "1000 kg/m^3", "divisions": count}
    scene = Scene(
        title="a heavy beam on a floor",
        units={"length": "mm", "force": "kN"},
        axes=["x", "z"],
        gravity=["0 m/s^2", "-10 m/s^2"],
        nodes=[{"name": "a", "at": ["0 m", "0 m"]}, {"name": "b", "at": ["10 m", "0 m"]}],
        beams=[{"name": "beam", "nodes": ["a", "b"], **beam}],
        fixed=["a"],
        obstacles=[{"name": "floor", "point": ["0 m", "0 m"], "normal": [0, 1]}],
        contacts=[{"name": f"{i}", "node": f"beam {i}", "obstacle": "floor"} for i in range(1, count)],
        loads=[{"unknown": "b.z", "value": "2 kN"}],
    )
    solution = cq.run(scene)[-1]
    assert solution.certificate.proven
    assert solution.at("b.z") == pytest.approx(1000 * 4**4 / (24 * 1e6) * 1e3, rel=1e-4)  # mm
    assert np.flatnonzero(solution.normal_force > 0)[-1] == 59
    assert solution.normal_force[-40:].sum() == pytest.approx(2.0, rel=0.05)  # the concentrated force q a / 2


def test_a_divided_beam_under_its_weight_has_exact_nodes():
    """5 q L^4 / (384 E I) in the middle of a beam on two supports, q = rho A g."""
    beam = {"area": "2 m^2", "inertia": "3 m^4", "modulus": "64 Pa", "density": "5 kg/m^3", "divisions": 4}
    data = dict(
        title="a beam",
        axes=["x", "y"],
        gravity=["0 m/s^2", "-10 m/s^2"],
        nodes=[{"name": "a", "at": ["0 m", "0 m"]}, {"name": "b", "at": ["8 m", "0 m"]}],
        beams=[{"name": "beam", "nodes": ["a", "b"], **beam}],
        fixed=["a.x", "a.y", "b.y"],
    )
    assert cq.run(Scene(**data))[-1].at("beam 2.y") == pytest.approx(-5 * 100 * 8**4 / (384 * 64 * 3), rel=1e-12)
    with pytest.raises(cq.SceneError, match=r"beams\[0\].divisions \('beam'\): expected no node 'beam 1'.*of the beam"):
        Scene(**data | {"nodes": [*data["nodes"], {"name": "beam 1", "at": ["1 m", "0 m"]}]})


def test_a_tie_of_one_term_is_a_support_that_settles_and_refused_supports_of_nodes_say_so():
    """A beam whose end settles by 2 mm, on a pier 5 mm below: R = 48 E I / L^3 (1 mm + 5 q L^4 / 384 E I - 5 mm)."""
    beam = {"area": "0.1 m^2", "inertia": "1e-4 m^4", "modulus": "30 GPa", "divisions": 2}
    data = dict(
        title="a settlement",
        axes=["x", "y"],
        nodes=[{"name": "a", "at": ["0 m", "0 m"]}, {"name": "b", "at": ["10 m", "0 m"]}],
        beams=[{"name": "beam", "nodes": ["a", "b"], **beam}],
        fixed=["a.x", "a.y"],
        obstacles=[{"name": "pier", "point": ["0 m", "-5 mm"], "normal": [0, 1]}],
        contacts=[{"name": "pier", "node": "beam 1", "obstacle": "pier"}],
        line_loads=[{"name": "q", "beam": "beam", "value": ["0 kN/m", "-2 kN/m"]}],
    )
    tie = {"name": "settles", "terms": [{"unknown": "b.y", "factor": 1}], "value": "-2 mm"}
    sagging = 5 * 2000.0 * 10**4 / (384 * 3e6)
    expected = 48 * 3e6 / 10**3 * (sagging - 0.004)
    assert cq.run(Scene(**data, ties=[tie]))[-1].force_at("pier") == pytest.approx(expected, rel=1e-12)
    for place in ("b.y", "b"):
        support = {"name": "b", "on": place, "axis": "y", "value": "-2 mm"}
        with pytest.raises(cq.SceneError, match="a tie of one term"):
            Scene(**data, supports=[support])


def test_a_line_load_comes_with_its_corner_of_the_path():
    path = {"events": "exact", "corners": [{"snow": "1/2"}, {"snow": 1, "pull": 1}]}
    fixed = ["a", "c", "b.x"]
    pull = [{"name": "pull", "unknown": "b.z", "value": "9 N"}]
    scene = Scene(**WIRE | {"path": path, "fixed": fixed, "loads": pull})
    history = cq.run(scene)
    assert exact_problem(scene).load["b.z"] == -6
    np.testing.assert_allclose(history[-1].displacement, [-6 / (64 / 5)], rtol=1e-14)
    with pytest.raises(cq.SceneError, match=r"'snow' \(line_loads\[0\]\) is in none"):
        Scene(**WIRE | {"path": {"corners": [{"pull": 1}]}, "fixed": fixed, "loads": pull})


def test_loads_of_one_name_share_a_factor():
    pull = [{"name": "snow", "unknown": "b.z", "value": "-2 N"}]
    twice = [WIRE["line_loads"][0], WIRE["line_loads"][0]]
    changes = {"path": {"corners": [{"snow": "1/2"}]}, "fixed": ["a", "c", "b.x"], "loads": pull}
    scene = Scene(**WIRE | changes | {"line_loads": twice})
    np.testing.assert_allclose(cq.run(scene)[-1].displacement, [(-2 - 15 - 15) / 2 / (64 / 5)], rtol=1e-14)


def test_strings_stand_in_scenes_of_nodes_in_two_dimensions_or_three():
    flat = {"nodes": [{"name": n, "at": [f"{i} m"]} for i, n in enumerate("abc")], "axes": ["x"], "line_loads": []}
    with pytest.raises(cq.SceneError, match="strings: expected a scene with two axes or three"):
        Scene(**WIRE | flat)
    membrane = dict(name="m", tension="1 N/m", shape=dict(kind="disc", element="quad4", radius="1 m", divisions=[2, 2]))
    snow = WIRE["line_loads"][0] | {"value": ["0 N/m", "0 N/m", "-3 N/m"]}
    for key, value in (("strings", WIRE["strings"]), ("line_loads", [snow])):
        with pytest.raises(cq.SceneError, match=f"{key}: expected none in a scene of bodies"):
            Scene(**{"title": "both", "axes": ["x", "y", "z"], "membranes": [membrane], key: value})


def test_a_large_chain_is_sparse():
    count = 300
    scene = Scene(
        title="a chain", axes=["x"], nodes=[{"name": str(i), "at": [f"{i} m"]} for i in range(count)], fixed=["0"],
        springs=[{"name": str(i), "nodes": [str(i), str(i + 1)], "stiffness": "1 N/m"} for i in range(count - 1)],
    )  # fmt: skip
    stiffness = scene.problem().stiffness
    assert stiffness.nnz == 3 * (count - 1) - 2


def case(name):
    return exact_problem(cq.load_scene(CASES / name))


def test_the_reduced_problem_has_the_solution_of_the_whole():
    """A rational counter-example to the printed eq. 2.20: its first right-hand block lacks -K_us A_s^-1 b."""
    exact, masters = case("master_slave_gap.toml"), ["1.x", "2.x", "master.x"]
    K = np.array(building.reduced_stiffness(exact, masters), dtype=float).reshape(3, 3)
    f = np.array(building.reduced_load(exact, masters), dtype=float)
    right = [float(F(n, 28588)) for n in (11657, 4869, 21289)]
    np.testing.assert_allclose(np.linalg.solve(K, f), right, rtol=1e-14)
    printed = f.copy()
    printed[:2] = [3, -1]
    wrong = [float(F(n, 7147)) for n in (3058, 856, 5241)]
    np.testing.assert_allclose(np.linalg.solve(K, printed), wrong, rtol=1e-14)


def test_masters_that_do_not_decide_the_slaves_are_refused():
    with pytest.raises(cq.SceneError, match="expected masters that decide the 2 others"):
        building.reduced_stiffness(case("master_slave_gap.toml"), ["1.x", "2.x"])


def test_the_rank_does_not_count_a_tie_twice():
    exact = case("tie_symmetry.toml")
    assert building.rank(exact) == 3
    twice = replace(exact, ties=(*exact.ties, exact.ties[0]))
    assert building.rank(twice) == 3
