"""Blocks of elements: divided bars, and one from outside that is one file and one registration."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.scene.blocks import BLOCKS
from contactqp.scene.building import exact_problem
from contactqp.scene.explaining import explain
from contactqp.scene.judging import Trial, judge, judge_all
from contactqp.scene.scene import Scene, register_block
from contactqp.study.answer_pictures import fields_of
from tests.block_registry import registered_blocks
from tests.scene import toy_block

# A cantilever of E I = 1 kN m^2 and 1 m with a spring c = 10 kN/m * (0.5 m)^2 = 2.5 kN m at its tip, under 1 kN there:
# with u = [v, theta], 12 v - 6 theta = P and -6 v + (4 + c) theta = 0.
CASE = """
title = "A cantilever whose tip is turned back"
units = { length = "m", force = "kN" }
axes = ["x", "y"]
nodes = [{ name = "wall", at = ["0 m", "0 m"] }, { name = "tip", at = ["1 m", "0 m"] }]
beams = [{ name = "beam", nodes = ["wall", "tip"], area = "1 m^2", inertia = "1 m^4", modulus = "1 kN/m^2" }]
torsion_springs = [{ name = "hinge", node = "tip", stiffness = "10 kN/m", lever = "50 cm" }]
fixed = ["wall", "wall.theta"]
obstacles = [{ name = "floor", point = ["0 m", "-1 m"], normal = [0, 1] }]
contacts = [{ name = "foot", node = "tip", obstacle = "floor" }]
loads = [{ unknown = "tip.y", value = "-1 kN" }]

[[expect]]
quantity = "displacement"
at = "tip.theta"
value = "-1/7 rad"
derivation = "theta = 6 v / 6.5, 12 v - 6 theta = P: v = 6.5 P / 42"

[[expect]]
quantity = "hinge force"
at = "hinge"
value = "-5/7 kN"
derivation = "k lever theta = 10 * 0.5 * theta"
"""


@pytest.fixture
def case(tmp_path: Path) -> Iterator[Path]:
    file = tmp_path / "hinge.toml"
    file.write_text(CASE)
    with registered_blocks():
        toy_block.register()
        yield file


def test_it_is_loaded_and_solved(case: Path) -> None:
    scene = cq.load_scene(case)
    solution = cq.run(scene)[-1]
    assert solution.certificate.passed
    np.testing.assert_allclose(solution.displacement, [0.0, -6.5 / 42, -1 / 7], atol=1e-14)
    assert [name for name, _ in scene.elements] == ["beams[0]", "torsion_springs[0]"]


def test_its_claims_are_judged(case: Path) -> None:
    (judgement,) = judge_all(cq.load_scene(case))
    assert [row.quantity for row in judgement.expectations] == ["displacement tip.theta", "hinge force hinge"]
    assert judgement.met


def test_a_claim_about_it_that_is_wrong_is_not_met(case: Path) -> None:
    case.write_text(CASE.replace('"-5/7 kN"', '"5/7 kN"'))
    (judgement,) = judge_all(cq.load_scene(case))
    assert [row.ok for row in judgement.expectations] == [True, False]


def test_it_is_explained(case: Path) -> None:
    blocks = {block.name: block for block in explain(cq.load_scene(case)).blocks}
    assert blocks["torsional springs"].included
    assert blocks["torsional springs"].reason == "1 in the scene"
    assert "torsional springs" in blocks["Newton loop"].reason


def test_it_is_drawn(case: Path) -> None:
    scene = cq.load_scene(case)
    members = fields_of(scene, cq.solve(scene.problem())).members
    assert [(member.kind, member.nodes) for member in members] == [("beam", (0, 1)), ("torsional spring", (1,))]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("wrong", "right", "message"),
    [
        (
            'node = "tip", stiff',
            'node = "tup", stiff',
            r"torsion_springs\[0\].node \('hinge'\): there is no node 'tup'",
        ),
        ('"10 kN/m", lever', '"10 kN", lever', r"torsion_springs\[0\].stiffness \('hinge'\): expected a stiffness"),
        ("lever = ", "levre = ", r"torsion_springs\[0\].levre \('hinge'\): there is no key 'levre'; nearest: 'lever'"),
        ('at = "hinge"', 'at = "henge"', r"expect\[1\].at: there is no torsional spring 'henge'; nearest: 'hinge'"),
    ],
)
def test_what_is_wrong_of_it_is_refused_with_its_key(case: Path, wrong: str, right: str, message: str) -> None:
    assert wrong in CASE
    case.write_text(CASE.replace(wrong, right))
    with pytest.raises(cq.SceneError, match=message):
        cq.load_scene(case)


@pytest.mark.usefixtures("case")
def test_large_displacements_and_bodies_refuse_it() -> None:
    keys = {"title": "t", "torsion_springs": [{"name": "h", "node": "a", "stiffness": "1 N/m", "lever": "1 m"}]}
    path = {"steps": 1}
    with pytest.raises(cq.SceneError, match="torsion_springs: expected none with deformation = 'large'"):
        Scene(**keys, axes=["x", "y"], deformation="large", path=path, nodes=[{"name": "a", "at": ["0 m", "0 m"]}])
    shape = {"kind": "rectangle", "element": "quad4", "size": ["1 m", "1 m"], "divisions": [1, 1]}
    body = {"name": "b", "shape": shape, "model": "plane-strain", "thickness": "1 m", "modulus": "1 Pa", "poisson": 0}
    with pytest.raises(cq.SceneError, match="bodies and torsion_springs in one scene are not offered yet"):
        Scene(**keys, axes=["x", "y"], bodies=[body])


def test_names_that_are_taken_are_refused_and_a_block_ends_with_its_test() -> None:
    kinds = dict(BLOCKS)
    with registered_blocks():
        toy_block.register()
        for key in ("torsion_springs", "bars", "expect", "problem"):
            with pytest.raises(cq.InvalidProblem, match="expected a block with names of its own"):
                register_block(key, toy_block.TorsionSpring)
    assert kinds == BLOCKS

    class Large(toy_block.TorsionSpring):
        large = True

    with pytest.raises(cq.InvalidProblem, match="expected no form at large displacements"):
        register_block("large_springs", Large)
    with pytest.raises(cq.SceneError, match="there is no key 'torsion_springs'"):
        Scene(title="t", axes=["x"], torsion_springs=[])


def test_its_numbers_are_exact(case: Path) -> None:
    from contactqp.scene.building import exact_problem

    exact = exact_problem(cq.load_scene(case))
    assert exact.stiffness["tip.theta", "tip.theta"] == Fraction(13, 2)
    assert exact.rational


WALL = dict(
    title="a divided bar and a wall",
    units={"length": "m", "force": "kN"},
    axes=["x"],
    nodes=[{"name": "a", "at": ["0 m"]}, {"name": "b", "at": ["2 m"]}],
    bars=[{"name": "rod", "nodes": ["a", "b"], "area": "15 cm^2", "modulus": "210 GPa", "divisions": 6}],
    fixed=["a"],
    obstacles=[{"name": "wall", "point": ["2001 mm"], "normal": [-1]}],
    contacts=[{"name": "tip", "node": "b", "obstacle": "wall"}],
    loads=[{"unknown": "b.x", "value": "300 kN"}],
)


def test_a_divided_bar_is_the_bar():
    expect = [
        {"quantity": "normal force", "at": "tip", "value": "285/2 kN", "derivation": "as in one piece"},
        {"quantity": "displacement", "at": "rod 2.x", "value": "1/3 mm", "derivation": "linear, two sixths of 1 mm"},
    ]
    judgement = judge(Scene(**WALL, expect=expect), Trial())
    assert judgement.met, judgement.expectations


def test_the_nodes_inside_are_exact_and_can_be_named():
    scene = Scene(**WALL | {"contacts": [{"name": "tip", "node": "rod 5", "obstacle": "wall"}]})
    assert list(scene.every_node) == ["a", "b", "rod 1", "rod 2", "rod 3", "rod 4", "rod 5"]
    assert scene.every_node["rod 5"][0].si == F(5, 3)
    exact = exact_problem(scene)
    assert exact.rational
    assert exact.stiffness["rod 5.x", "b.x"] == -6 * 157500
    assert exact.contacts[0].gap == F(2001, 1000) - F(5, 3)


def test_a_picture_has_all_nodes():
    scene = Scene(**WALL)
    fields = fields_of(scene, cq.run(scene)[-1])
    (bar,) = fields.members
    np.testing.assert_allclose(bar.path[:, 0], np.linspace(0, 2, 7))
    np.testing.assert_allclose(bar.displacement[:, 0], np.linspace(0, 1e-3, 7), atol=1e-15)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"divisions": 0}, r"bars\[0\].divisions \('rod'\)"),
        ({"divisions": 2.5}, r"bars\[0\].divisions \('rod'\)"),
        ({"nodes": ["a", "rod 3"]}, r"bars\[0\].nodes\[1\] \('rod'\): there is no node 'rod 3'"),
    ],
)
def test_divisions_that_make_no_sense_are_refused(changes, words):
    with pytest.raises(cq.SceneError, match=words):
        Scene(**WALL | {"bars": [WALL["bars"][0] | changes]})


def test_divisions_that_do_not_fit_the_scene_are_refused():
    claim = {"quantity": "bar force", "at": "rod", "value": "1 kN", "derivation": "none"}
    with pytest.raises(cq.SceneError, match="expected a bar in one piece, got 'rod'"):
        Scene(**WALL, expect=[claim])
    with pytest.raises(cq.SceneError, match="expected no node 'rod 1', which stands inside of the bar"):
        Scene(**WALL | {"nodes": [*WALL["nodes"], {"name": "rod 1", "at": ["1 m"]}]})
    plane = [{"name": "a", "at": ["0 m", "0 m"]}, {"name": "b", "at": ["2 m", "0 m"]}]
    with pytest.raises(cq.SceneError, match=r"bars\[0\].divisions \('rod'\): expected 1 in a scene with 2 axes"):
        Scene(**WALL | {"axes": ["x", "y"], "nodes": plane, "obstacles": [], "contacts": []})
