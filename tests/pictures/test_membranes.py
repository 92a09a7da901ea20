"""Membranes: the surface is where its nodes are, and dots are where forces push, as large as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.solid import Membrane
from contactqp.pictures.space_drawing import DOTS, membrane_figure
from contactqp.study.answer_pictures import fields_of_membranes

pytest.importorskip("matplotlib")
CASE = Path(__file__).parents[2] / "cases" / "membrane_ball.toml"


@pytest.mark.slow
def test_a_membrane_over_a_ball() -> None:
    scene = cq.load_scene(CASE)
    solution = cq.solve(scene.problem())
    fields = fields_of_membranes(scene, solution)
    figure = membrane_figure(fields, title="A membrane")
    space, plane = figure.axes[:2]
    assert [item for item in space.collections if item.get_gid() == "surface"]
    assert space.get_zlim() == pytest.approx((0.0, 1.0), abs=1e-12)  # from the rim to the ball's top
    (dots,) = [item for item in plane.collections if item.get_gid() == "forces"]
    assert len(dots.get_offsets()) == np.count_nonzero(solution.normal_force > 0)
    assert np.linalg.norm(dots.get_offsets(), axis=1).max() < 0.8  # the contact's radius is 0.698
    assert dots.get_sizes().max() == pytest.approx(DOTS[1])
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert any(label.startswith("closed (") for label in labels)
    assert labels[-1].endswith(" N")
    assert [axes.get_xlabel() for axes in (space, plane)] == ["x [m]", "x [m]"]


def test_supported_nodes_have_no_force() -> None:
    scene = cq.load_scene(CASE)
    fields = fields_of_membranes(scene, cq.solve(scene.problem()))
    assert np.all(np.isnan(fields.force) == (fields.status == "held"))


def test_a_membrane_made_in_python_is_drawn_as_one() -> None:
    mesh = cq.rectangle(2.0, 2.0, (8, 8), "quad4", corner=(-1.0, -1.0))
    structure = cq.Structure([Membrane(mesh, tension=1.0, name="skin")])
    sides = [cq.Support("skin", side, 0) for side in ("left", "right", "bottom", "top")]
    dome = 0.2 - np.sum(mesh.points**2, axis=1) / 2
    system, contacts = structure.assemble(sides), [cq.pair_scalar(mesh.points, dome)]
    solution = cq.solve(system.problem(contacts))
    assert any(solution.normal_force > 0)
    with pytest.raises(
        cq.InvalidProblem,
        match="expected 49 unknowns and 0 contacts, as the system and the pairings have, got 49 and 49",
    ):
        cq.draw(solution, system=system)
    for drawn in (cq.draw(solution), cq.draw(solution, system=system, contacts=contacts)):
        assert [item for item in drawn.axes[0].collections if item.get_gid() == "surface"]
