"""Bars in several elements: the nodes inside of them, what they are called, and refusals."""

from fractions import Fraction as F

import numpy as np
import pytest

import contactqp as cq
from contactqp.scene.building import exact_problem
from contactqp.scene.judging import Trial, judge
from contactqp.scene.scene import Scene
from contactqp.study.answer_pictures import fields_of

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
    assert scene.node("rod 5").at[0].si == F(5, 3)
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
