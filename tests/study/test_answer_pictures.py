"""Small pictures of answers for a page."""

from __future__ import annotations

import importlib.util
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.scene.judging import Failure, Judgement, Trial, judge
from contactqp.scene.scene import load_scene
from contactqp.study.answer_pictures import answer_pictures
from tests.model.test_summary import pressed_block

pytest.importorskip("matplotlib")
CASES = Path(__file__).parents[2] / "cases"
ORANGE = (0xD5, 0x5E, 0x00)  # contact forces


def _judged(name: str) -> Judgement:
    return judge(load_scene(CASES / f"{name}.toml"), Trial())


def _read(picture: bytes | None) -> Any:
    from PIL import Image

    assert picture is not None
    return Image.open(io.BytesIO(picture))


def _farthest(image: Any, colour: tuple[int, int, int]) -> int:
    """The distance of the nearest colour of a picture's palette."""
    counts = image.convert("RGB").getcolors(image.width * image.height)
    return min(max(abs(a - b) for a, b in zip(found, colour, strict=True)) for _, found in counts)


@pytest.mark.slow
def test_a_structure_and_its_path() -> None:
    drawn = answer_pictures(_judged("two_bars_path"))
    for picture in (drawn.answer, drawn.history):
        image = _read(picture)
        assert (image.format, image.mode) == ("PNG", "P")
        assert image.width > 600  # letters can be read
        assert len(picture or b"") < 30_000
    assert _farthest(_read(drawn.answer), ORANGE) < 8


@pytest.mark.slow
def test_a_gap_that_is_rounding_is_told_as_zero() -> None:
    """The truss that snaps meets its stop to 1e-17 m."""
    figure = cq.draw(cq.run("von_mises_snaps"), scene="von_mises_snaps")
    told = [text.get_text() for legend in figure.legends for text in legend.get_texts() if "gap" in text.get_text()]
    assert told == ["node: closed, force 8.966 N, gap 0 m"]


@pytest.mark.slow
def test_few_arrows_keep_their_colour_beside_large_bodies() -> None:
    drawn = answer_pictures(_judged("stacked_blocks"))
    assert drawn.history is None  # one instant
    assert _farthest(_read(drawn.answer), ORANGE) < 25
    assert len(drawn.answer or b"") < 40_000


def test_a_solution_of_bodies_is_drawn_on_them_also_under_another_load() -> None:
    problem = pressed_block()
    drawn = cq.draw(cq.solve(problem))
    assert drawn.axes[0].get_xlabel() == "x [m]"
    assert not any("load" in text.get_text() for text in drawn.legends[0].get_texts())
    pushed = problem.replace(load=problem.load + np.where(np.arange(problem.dimension) == 0, -1e-4, 0.0))
    loaded = cq.draw(cq.solve(pushed))
    assert any("load, in all -0.0001 and 0 MN" in text.get_text() for text in loaded.legends[0].get_texts())


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("factor", "said"), [(1.0, "0 and -2 MN"), (1.5, "0 and -3 MN"), (0.0, "")])
def test_the_load_of_bodies_is_told_with_what_acts_on_supports(factor: float, said: str) -> None:
    block = cq.Body(cq.rectangle(1.0, 0.5, (4, 2)), cq.Material(1.0, 0.3), "plane-strain", name="block")
    held = [cq.Support("block", "left", axis) for axis in (0, 1)]
    system = cq.Structure([block]).assemble(held, [cq.Traction("block", "top", [0.0, -2.0])])
    problem = system.problem([], units={"length": "m", "force": "MN"})
    assert problem.load.sum() == pytest.approx(-1.75)  # a node at the end of the loaded side is held
    drawn = cq.draw(cq.solve(problem.replace(load=factor * problem.load)))
    labels = [text.get_text() for text in drawn.legends[0].get_texts() if "load" in text.get_text()]
    assert labels == [] if not said else labels[0].startswith(f"load, in all {said} along x and y")


@pytest.mark.sampled(2)
@pytest.mark.parametrize("supported", [True, False])
def test_a_solid_at_large_deformation_is_drawn_where_it_is(supported: bool) -> None:
    """A block between a plane that comes down by a tenth and its supports, or ties, which hold its lower side."""
    block = cq.Body(cq.rectangle(1.0, 2.0, (2, 4)), cq.Material(1.0, 0.3), "plane-strain", name="block")
    low = np.flatnonzero(block.mesh.points[:, 1] == 0)
    plane = cq.ObstacleContact(block.surface("top"), cq.Plane([0.0, 1.8], [0.0, -1.0]), dimension=block.size)
    solid, held = cq.NonlinearSolid(block), np.concatenate([2 * low, 2 * low + 1])
    if supported:
        body = cq.Supported(solid, held)
        found = cq.large_deformation(body, [np.zeros(body.dimension)], body.contact(plane), steps=1)
    else:
        found = cq.large_deformation(solid, [np.zeros(block.size)], plane, steps=1, tie=np.eye(block.size)[held])
    axes = found[-1].plot().axes[0]
    drawn = {artist.get_gid(): artist for artist in axes.collections if artist.get_gid()}
    np.testing.assert_allclose(drawn["closed"].get_offsets()[:, 1], 1.8, atol=1e-12)
    edges = np.concatenate([np.concatenate(a.get_segments()) for a in axes.collections if a.get_gid() == "deformed"])
    assert edges[:, 1].max() == pytest.approx(1.8)
    obstacle = np.concatenate(drawn["obstacle"].get_segments())
    np.testing.assert_allclose(obstacle[:, 1], 1.8, atol=1e-12)
    assert "largest force: contact" in str(found[-1])


def test_bodies_that_a_problem_does_not_know_are_no_picture_and_a_line_says_what_to_pass() -> None:
    parts = ("stiffness", "load", "normal", "gap", "near_null_space")
    problem = pressed_block()
    bare = cq.ContactProblem(**{name: getattr(problem, name) for name in parts})
    drawn = cq.draw(cq.solve(bare))
    assert "system=..., contacts=[...]" in drawn.legends[0].get_title().get_text()  # where it covers nothing
    assert drawn.texts == [drawn._suptitle]
    wall = cq.ContactProblem([[2.0]], [3.0], [[1.0]], [1.0])
    assert not cq.draw(cq.solve(wall)).legends[0].get_title().get_text()


def test_why_there_is_no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    judged = _judged("two_bars")
    failed = answer_pictures(Failure(judged.scene, judged.trial, "did not converge", judged.history))
    assert (failed.answer, failed.history, failed.why_not) == (None, None, "did not converge")
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    assert "pip install matplotlib" in answer_pictures(judged).why_not


@pytest.mark.slow
def test_a_thumbnail_is_the_geometry_without_letters() -> None:
    small = answer_pictures(_judged("truss_floor")).thumbnail
    image = _read(small)
    assert max(image.size) <= 240
    assert min(image.size) > 60
    assert len(small or b"") < 10_000
