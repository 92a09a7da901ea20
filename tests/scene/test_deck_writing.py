"""A scene of bodies is written as a deck that states the same problem."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

import contactqp as cq
from contactqp.scene.deck.writing import write_deck
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


@pytest.mark.parametrize("name", ["bar_wall", "hertz_line", "membrane_ball", "cable_on_floor"])
def test_what_has_no_deck_is_refused(tmp_path: pathlib.Path, name: str) -> None:
    with pytest.raises(cq.Unsupported, match="export: a deck has"):
        write_deck(cq.load_scene(CASES / f"{name}.toml"), tmp_path)


@needs_calculix
@pytest.mark.parametrize("name", ["patch_two_blocks", pytest.param("hertz_bodies", marks=pytest.mark.slow)])
def test_calculix_runs_what_the_command_writes(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    code, out, _ = command(capsys, "export", CASES / f"{name}.toml", "--inp", tmp_path / "decks")
    assert (code, out.startswith("written: ")) == (0, True)
    assert cq.crosscheck(tmp_path / "decks" / f"{name}.inp").passed
