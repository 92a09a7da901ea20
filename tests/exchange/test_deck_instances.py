"""Decks with parts and instances, as Abaqus/CAE writes them, are the flat decks that they stand for."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

import contactqp as cq
from contactqp.exchange.deck.reading import read_deck_model
from tests.decks import ASSEMBLED, STACK, needs_calculix, write


def test_a_deck_of_instances_is_that_of_its_nodes(tmp_path: pathlib.Path) -> None:
    deck = cq.read_deck(write(tmp_path, ASSEMBLED))
    flat = STACK.replace(
        "*NODE PRINT", "*CLOAD\n12, 3, -1.\n*DLOAD\nSOLID, GRAV, 0.25, 0., 0., -1.\n*NODE PRINT"
    )  # node 1, turned by a right angle
    solution, other = (cq.solve(one.problem()) for one in (deck, cq.read_deck(write(tmp_path, flat, "flat.inp"))))
    assert solution.normal_force.sum() == pytest.approx(5.5, rel=1e-12)
    assert np.allclose(np.sort(solution.normal_force), np.sort(other.normal_force), rtol=1e-12)
    assert solution.at("5.z") == pytest.approx(other.at("5.z"), rel=1e-12)
    below = sum(solution.at(f"{node}.z") for node in (5, 6, 7, 8)) / 4
    assert below == pytest.approx(-(5.5 + 0.5 / 2) / 1000)  # half of a cube's weight is at its top
    assert solution.force_at("node 11") == pytest.approx(other.force_at("node 12"), rel=1e-12)
    assert deck.model.points[deck.model.labels == 11].tolist() == [[1.0, 0.0, 1.01]]
    assert any("*INSTANCE UP-1: 10 added to labels" in line for line in deck.ledger.converted)


def test_turns_are_right_handed_and_follow_the_move(tmp_path: pathlib.Path) -> None:
    text = ASSEMBLED.replace("0., 0., 1.01\n0.5, 0.5, 0., 0.5, 0.5, 1., 90.", "1., 2.\n1., 0., 0., 1., 0., 3., 30.")
    model = read_deck_model(write(tmp_path, text))
    moved = model.points[model.labels == 12][0]  # (1, 0, 0), at (2, 2, 0), turned about the line x = 1, y = 0
    half, root = 0.5, np.sqrt(3) / 2
    assert moved == pytest.approx([1 + root * 1 - half * 2, half * 1 + root * 2, 0.0], abs=1e-11)


def test_parts_may_be_written_in_instances(tmp_path: pathlib.Path) -> None:
    part = ASSEMBLED.partition("*Part, name=Cube\n")[2].partition("*End Part")[0]
    text = ASSEMBLED.replace("*Instance, name=Low, part=Cube\n", f"*Instance, name=Low\n{part}")
    assert cq.solve(cq.read_deck(write(tmp_path, text)).problem()).normal_force.sum() == pytest.approx(5.5)


MISTAKES = {
    "a part that is not there": ("part=Cube\n*End", "part=Cub\n*End", "a part that is defined above, got 'CUB'"),
    "a part twice": ("*Assembly, ", "*Part, name=Cube\n*End Part\n*Assembly, ", "CUBE stands twice"),
    "a part without an end": ("*End Part\n", "", "*ASSEMBLY: expected it by itself"),
    "an assembly without an end": ("*End Assembly\n", "", "expected *END ASSEMBLY before the end of the deck"),
    "an end without a beginning": ("*Assembly, name=Assembly\n*Instance", "*Instance", "*INSTANCE: expected it in an"),
    "the end of something else": ("*End Part", "*End Instance", "*END INSTANCE: expected *INSTANCE before it"),
    "an instance that is not there": ("instance=Up-1\n 5", "instance=Up\n 5", "expected an instance, got 'UP'"),
    "a label of no instance": ("Up-1.1, 3", "1, 3", "expected INSTANCE.LABEL outside of parts, got '1'"),
    "a label that its instance has not": ("Up-1.1, 3", "Up-1.9, 3", "there is no node 19"),
    "a reference point": ("*Nset, nset=Bottom", "*Node\n1, 0.\n*Nset, nset=Bottom",
                          "points, are not offered; put loads"),
    "a load in a part": ("*End Part", "*Boundary\n1, 1\n*End Part", "*BOUNDARY: it is not followed in a part"),
    "an axis of no length": ("0.5, 0.5, 1., 90.", "0.5, 0.5, 0., 90.", "two different points of an axis"),
    "a third line of a place": ("1., 90.\n", "1., 90.\n1.\n", "at most a translation and a rotation"),
    "an instance of a library": ("name=Low, part=Cube", "library=Old, instance=Low", "LIBRARY is not offered"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_named_with_their_line(tmp_path: pathlib.Path, name: str) -> None:
    old, new, said = MISTAKES[name]
    assert old in ASSEMBLED
    with pytest.raises(cq.InvalidProblem) as caught:
        cq.read_deck(write(tmp_path, ASSEMBLED.replace(old, new, 1))).problem()
    message = str(caught.value)
    assert said in message
    assert "model.inp: line" in message
    assert "\n" not in message


def test_instances_without_an_assembly_are_refused(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("*NSET, NSET=BOTTOM", "*NSET, NSET=BOTTOM, INSTANCE=A")
    with pytest.raises(cq.InvalidProblem, match=r"\*NSET: INSTANCE: expected it in an \*ASSEMBLY"):
        read_deck_model(write(tmp_path, text))


@needs_calculix
def test_calculix_runs_the_flat_deck(tmp_path: pathlib.Path) -> None:
    verdict = cq.crosscheck(write(tmp_path, ASSEMBLED), reference="penalty")
    assert verdict.pairs[0].reference_resultant == pytest.approx(5.5, rel=0.05)
    assert verdict.passed
