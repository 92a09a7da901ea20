"""A scene of bodies is written as a deck that states the same problem."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.abaqus import HEX_FACES
from contactqp.elements.reference_elements import REFERENCES, Block
from contactqp.scene.deck.writing import _Plate, write_deck
from tests.cli.commands import run as command
from tests.decks import needs_calculix

CASES = pathlib.Path(__file__).parents[2] / "cases"


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", ["patch_two_blocks", "flat_punch", "hertz_bodies"])
def test_the_deck_has_the_stiffness_loads_and_supports_of_the_scene(tmp_path: pathlib.Path, name: str) -> None:
    scene = cq.load_scene(CASES / f"{name}.toml")
    deck = cq.read_deck(write_deck(scene, tmp_path))
    ours, theirs = deck.problem(discretisation="mortar"), cq.run(scene)[-1].problem
    assert abs(ours.stiffness - theirs.stiffness).max() <= 1e-9 * abs(theirs.stiffness).max()
    assert np.allclose(ours.load, theirs.load, atol=1e-9 * abs(theirs.load).max())


def test_the_answer_of_the_deck_is_that_of_the_scene(tmp_path: pathlib.Path) -> None:
    scene = cq.load_scene(CASES / "patch_two_blocks.toml")
    problem = cq.read_deck(write_deck(scene, tmp_path)).problem(discretisation="mortar")
    expected = cq.run(scene)[-1].displacement
    assert np.allclose(cq.solve(problem).displacement, expected, atol=1e-9 * abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hertz_line", "floating_disc", "hertz_sphere", "stacked_blocks"])
def test_a_plane_is_a_plate_whose_nodes_are_held(tmp_path: pathlib.Path, name: str) -> None:
    scene = cq.load_scene(CASES / f"{name}.toml")
    deck = cq.read_deck(write_deck(scene, tmp_path))
    found = cq.solve(deck.problem(discretisation="mortar" if name == "stacked_blocks" else "node-to-segment"))
    expected = cq.run(scene)[-1]
    assert found.normal_force.sum() == pytest.approx(expected.normal_force.sum(), rel=1e-9)
    assert len(found.free_motions) == len(expected.free_motions)
    if name != "stacked_blocks":  # whose feet are shared out by a mortar there, node by node here
        assert np.sort(found.normal_force)[-5:] == pytest.approx(np.sort(expected.normal_force)[-5:], rel=1e-5)


@pytest.mark.parametrize("normal", [[0.3, 0.2, 1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-1.0, -2.0, 0.5]])
def test_a_plate_lies_in_its_plane(normal: list[float]) -> None:
    box = cq.Body(cq.box((1.0, 2.0, 3.0), (2, 2, 2), "hex8"), cq.Material(1.0, 0.0), "3d")
    n, point = np.array(normal) / np.linalg.norm(normal), np.array([0.5, -1.0, 0.25])
    plate = _Plate(box, n, point)
    height = (plate.points - point) @ n
    assert np.allclose(height, [-3.0] * 4 + [0.0] * 4, atol=1e-12)
    along = plate.points[4:] - box.mesh.points.mean(axis=0)
    assert np.linalg.norm(along - (along @ n)[:, None] * n, axis=1).min() > 1.5
    mesh = cq.Mesh(plate.points, (Block(REFERENCES["hex8"], np.arange(8)[None]),))
    assert mesh.facets_of(np.array([[0, HEX_FACES[plate.face - 1]]]))[0].nodes.tolist()[0] in (
        [4, 5, 6, 7],
        [7, 6, 5, 4],
    )


@pytest.mark.parametrize("name", ["bar_wall", "membrane_ball", "cable_on_floor", "tie_column_solid", "bar_impact"])
def test_what_has_no_deck_is_refused(tmp_path: pathlib.Path, name: str) -> None:
    with pytest.raises(
        cq.Unsupported, match="export: a deck has elastic bodies, no membranes, bars, masses or matrices"
    ):
        write_deck(cq.load_scene(CASES / f"{name}.toml"), tmp_path)


def test_paths_and_round_obstacles_are_refused(tmp_path: pathlib.Path) -> None:
    with pytest.raises(cq.Unsupported, match="a deck has one static step of small displacements"):
        write_deck(cq.load_scene(CASES / "cattaneo_mindlin_cylinder.toml"), tmp_path)
    plane = 'point = ["0 mm", "-10 mm"], normal = [0, 1]'
    text = (CASES / "hertz_line.toml").read_text(encoding="utf-8")
    assert plane in text
    round_ = text.replace(plane, 'kind = "circle", centre = ["0 mm", "-30 mm"], radius = "20 mm"')
    (tmp_path / "round.toml").write_text(round_, encoding="utf-8")
    with pytest.raises(cq.Unsupported, match="foot: a deck has planes as obstacles, 'plane' is none"):
        write_deck(cq.load_scene(tmp_path / "round.toml"), tmp_path)


@pytest.mark.sampled(5)
@needs_calculix
@pytest.mark.parametrize(
    "name",
    ["patch_two_blocks", "stacked_blocks", "floating_disc", "hertz_bodies", "hertz_line"],
)
def test_calculix_runs_what_the_command_writes(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    code, out, _ = command(capsys, "export", CASES / f"{name}.toml", "--inp", tmp_path / "decks")
    assert (code, out.startswith("written: ")) == (0, True)
    assert cq.crosscheck(tmp_path / "decks" / f"{name}.inp").passed


@needs_calculix
@pytest.mark.slow
def test_what_calculix_leaves_open_of_a_case_is_told(tmp_path: pathlib.Path) -> None:
    punch = cq.crosscheck(write_deck(cq.load_scene(CASES / "flat_punch.toml"), tmp_path))
    assert punch.word == "undecided"
    assert "the printed digits leave 0.081 of the resultant open" in punch.summary()
    with pytest.raises(cq.BackendFailed, match="too many cutbacks"):
        cq.crosscheck(write_deck(cq.load_scene(CASES / "hertz_sphere.toml"), tmp_path))
