"""Decks that CalculiX is run on, where it is installed: what it computes right passes, the rest is named."""

from __future__ import annotations

import pathlib
import time
from functools import partial

import numpy as np
import pytest

import contactqp as cq
from benchmarks.decks import large_decks, used
from contactqp.exchange.calculix_results import read_displacements
from contactqp.exchange.processes import run_calculix
from tests.decks import STACK, Deck, lame_force, needs_calculix, press_fit, two_blocks, write
from tests.decks import run_calculix as run

NODES, FACES = "NODE TO SURFACE", "SURFACE TO SURFACE"
# Springs that yield nothing, and, node to face, pull with next to nothing.
STIFF = {NODES: "LINEAR\n1e9, 1e-6", FACES: "LINEAR\n1e9", "MORTAR": "LINEAR\n1e9"}
pytestmark = needs_calculix


@pytest.mark.sampled(8)
@pytest.mark.parametrize("element", ["hex8", "tet4", "hex20", "tet10"])
@pytest.mark.parametrize("kind", [NODES, FACES])
def test_blocks_that_do_not_match_are_right(tmp_path: pathlib.Path, element: str, kind: str) -> None:
    found = cq.crosscheck(write(tmp_path, two_blocks(element, kind, STIFF[kind])), error_tolerance=2e-3)
    assert found.passed, found.summary()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("element", "stiffness"),
    [("hex8", "1e7"), ("hex20", "1e5"), pytest.param("tet10", "1e7", marks=pytest.mark.slow)],
)
def test_faces_on_springs_have_the_forces_of_springs_at_integration_points(
    tmp_path: pathlib.Path, element: str, stiffness: str
) -> None:
    deck = write(tmp_path, two_blocks(element, FACES, f"LINEAR\n{stiffness}"))
    verdict = cq.crosscheck(deck, reference="penalty", error_tolerance=2e-3)
    assert verdict.passed
    assert verdict.pairs[0].error < 4e-4
    # Springs at the nodes are further away: 0.05 to 1.2 % in the resultant.
    nodes = cq.solve(cq.read_deck(deck).problem("penalty")).normal_force.sum()
    assert abs(nodes / verdict.pairs[0].resultant - 1) > 1.1 * verdict.pairs[0].error


@pytest.mark.slow
def test_a_mortar_is_right_where_its_master_reaches_further(tmp_path: pathlib.Path) -> None:
    found = cq.crosscheck(write(tmp_path, two_blocks("hex8", "MORTAR", STIFF["MORTAR"])))
    assert found.passed, found.summary()


@pytest.mark.slow
def test_adhesion_is_named(tmp_path: pathlib.Path) -> None:
    found = cq.crosscheck(write(tmp_path, two_blocks("hex8", NODES, "LINEAR\n1e7, 100., 1.", above=0.0011)))
    assert found.word == "wrong"
    assert "adhesion" in found.summary()


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", [NODES, FACES])
@pytest.mark.parametrize("push", [1e-4, 4e-3])
def test_friction_sticks_and_slips_alike(tmp_path: pathlib.Path, kind: str, push: float) -> None:
    text = two_blocks("hex8", kind, STIFF[kind], push=push, friction="0.3, 1e8")
    found = cq.crosscheck(write(tmp_path, text))
    assert found.passed, found.summary()
    tangential = np.linalg.norm(found.pairs[0].total[:2])
    assert tangential == pytest.approx(np.linalg.norm(found.pairs[0].reference_total[:2]), rel=5e-3)
    assert tangential > 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", [NODES, FACES])
def test_gaps_adjusted_nodes_and_clearances_are_those_of_calculix(tmp_path: pathlib.Path, kind: str) -> None:
    resultants = []
    for name, adjust, clearance in (("gap", "", ""), ("adjust", ", ADJUST=0.001", ""), ("clear", "", "0.0002")):
        if clearance and kind == NODES:  # CalculiX has it for faces alone
            continue
        text = two_blocks("hex8", kind, STIFF[kind], above=0.0005, adjust=adjust)
        if clearance:
            stated = f"*CLEARANCE, MASTER=MASTER, SLAVE=SLAVE, VALUE={clearance}\n*BOUNDARY"
            text = text.replace("*BOUNDARY", stated, 1)
        found = cq.crosscheck(write(tmp_path, text, f"{name}.inp"))
        assert found.passed, found.summary()
        resultants.append(found.pairs[0].reference_resultant)
    assert resultants[1] == pytest.approx(2 * resultants[0], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [NODES, FACES])
def test_a_press_fit_has_the_force_of_lame(tmp_path: pathlib.Path, kind: str) -> None:
    found = cq.crosscheck(write(tmp_path, press_fit(kind, STIFF[kind].replace("1e9", "1e8"))))
    assert found.passed, found.summary()
    assert found.pairs[0].reference_resultant == pytest.approx(lame_force(), rel=6e-3)
    soft = cq.crosscheck(write(tmp_path, press_fit(kind, STIFF[kind].replace("1e9", "2e4")), "soft.inp"))
    assert soft.word == "wrong"
    assert soft.pairs[0].resultant < 0.9 * soft.pairs[0].reference_resultant


@pytest.mark.sampled(9)
@pytest.mark.parametrize("model", ["CPE", "CPS", "CAX"])
@pytest.mark.parametrize("element", ["quad4", "tri3", "quad8"])
def test_plane_and_axisymmetric_decks_are_right(tmp_path: pathlib.Path, model: str, element: str) -> None:
    deck = Deck(model)
    section = "" if model == "CAX" else "0.5"
    deck.body("UP", cq.rectangle(1.0, 1.0, (6, 3), element).mapped(lambda x: x + np.array([3.0, 1.0])), section=section)
    deck.body(
        "LOW", cq.rectangle(1.6, 1.0, (5, 2), element).mapped(lambda x: x + np.array([2.7, 0.0])), section=section
    )
    deck.surface("SLAVE", "UP", "bottom")
    deck.surface("MASTER", "LOW", "top")
    deck.nset("TOP", "UP", "top")
    deck.nset("BOTTOM", "LOW", "bottom")
    deck.pair(NODES, STIFF[NODES])
    deck.lines += ["*BOUNDARY", "BOTTOM, 1, 2"]
    deck.step += ["*BOUNDARY", "TOP, 1, 1", "TOP, 2, 2, -0.001"]
    found = cq.crosscheck(write(tmp_path, deck.text()))
    assert found.passed, found.summary()


def shaft_in_hub(element: str, width: float) -> Deck:
    """Return an axisymmetric deck: a shaft from 5 mm on in a hub of 20 to 40 mm, 4 mm long, held along the axis."""
    deck = Deck("CAX")
    for name, inner, wide in (("HUB", 20.0, 20.0), ("SHAFT", 5.0, width)):
        deck.body(name, cq.rectangle(wide, 4.0, (12, 2), element, corner=(inner, 0.0)), section="")
    deck.surface("SLAVE", "HUB", "left")
    deck.surface("MASTER", "SHAFT", "right")
    deck.pair(NODES, STIFF[NODES])
    held = [(name, side) for name in ("HUB", "SHAFT") for side in ("bottom", "top")]
    for name, side in held:
        deck.nset(name + side.upper(), name, side)
    deck.lines += ["*BOUNDARY", *(f"{name}{side.upper()}, 2, 2" for name, side in held)]
    return deck


@pytest.mark.parametrize("element", ["quad8", "tri6", "quad4"])
def test_an_axisymmetric_press_fit_has_the_force_of_lame(tmp_path: pathlib.Path, element: str) -> None:
    """A shaft of 5 to 20 mm in a hub of 20 to 40 mm, 4 mm long, held along the axis, with 0.01 mm of interference."""
    deck = shaft_in_hub(element, 15.01)
    found = cq.crosscheck(write(tmp_path, deck.text()), error_tolerance=2e-3)
    assert found.passed, found.summary()
    coarse = 1e-2 if element == "quad4" else 3e-3
    assert found.pairs[0].reference_resultant == pytest.approx(4 * lame_force(), rel=coarse)
    assert "out of balance" not in found.summary()


@pytest.mark.parametrize("element", ["quad8", "tri6", "quad4"])
def test_a_shaft_that_is_widened_to_a_radius_presses_on_its_hub_as_lame_has_it(
    tmp_path: pathlib.Path, element: str
) -> None:
    """The bore of a shaft of 5 to 20 mm is widened by 0.02 mm in a hub of 20 to 40 mm: one tube in plane strain."""
    deck = shaft_in_hub(element, 15.0)
    deck.nset("BORE", "SHAFT", "left")
    deck.step += ["*BOUNDARY", "BORE, 1, 1, 0.02"]
    found = cq.crosscheck(write(tmp_path, deck.text()), error_tolerance=2e-3)
    assert found.passed, found.summary()
    # Of u = A r + B / r with no pressure at 40 mm and u = 0.02 mm at 5 mm the pressure at 20 mm.
    of_a, of_b = 210_000 / (1.3 * 0.4), 210_000 / 1.3
    A, B = np.linalg.solve([[5.0, 1 / 5.0], [of_a, -of_b / 40.0**2]], [0.02, 0.0])
    pressure = of_b * B / 20.0**2 - of_a * A
    coarse = 2e-2 if element == "quad4" else 3e-3
    assert found.pairs[0].reference_resultant == pytest.approx(pressure * 2 * np.pi * 20.0 * 4.0, rel=coarse)


@pytest.mark.slow
def test_a_tie_moves_as_in_calculix(tmp_path: pathlib.Path) -> None:
    text = two_blocks("hex8", NODES, STIFF[NODES])
    text = text.replace(
        "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=NODE TO SURFACE", "*TIE, NAME=T, POSITION TOLERANCE=0.01"
    )
    file = write(tmp_path, text)
    deck = cq.read_deck(file)
    labels, moved = deck.displacements(cq.solve(deck.problem()).displacement)
    theirs, _ = read_displacements(run_calculix(file, labels, tmp_path / "run", 60.0).results)
    assert theirs.nodes.tolist() == labels.tolist()
    assert abs(theirs.values - moved).max() <= 1e-6 * abs(moved).max()


@pytest.mark.slow
@pytest.mark.parametrize("name", [*large_decks(), "hexahedra"])
def test_bodies_of_twenty_thousand_unknowns_take_less_than_two_minutes(tmp_path: pathlib.Path, name: str) -> None:
    hexahedra = partial(two_blocks, "hex20", NODES, "LINEAR\n1e8, 1e-6", divisions=((12, 12, 7), (10, 10, 6)))
    deck = write(tmp_path, (large_decks() | {"hexahedra": hexahedra})[name]())
    assert len(cq.read_deck(deck).dof_names) >= 20_000
    began, before = time.monotonic(), sum(used())
    found = cq.crosscheck(deck)
    assert found.passed, found.summary()
    # Of a processor, where a busy machine lets the clock go on: these take the longest.
    assert (sum(used()) - before if "friction" in name else time.monotonic() - began) < 120
    if "press fit" in name:
        assert found.pairs[0].reference_resultant == pytest.approx(lame_force(), rel=1e-4)


def test_the_guide_prints_what_is_printed(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (pathlib.Path(__file__).parents[2] / "docs" / "guide" / "decks.md").read_text(encoding="utf-8")
    deck = page.split('deck = """')[1].split('"""')[0]
    shown = page.split("```text\nsquares.inp: WRONG")[1].split("```")[0]
    write(tmp_path, deck, "squares.inp")
    monkeypatch.chdir(tmp_path)
    found = cq.crosscheck("squares.inp", error_tolerance=1e-3).summary()
    if "CalculiX 2.20" in found:
        assert f"squares.inp: WRONG{shown}".rstrip() in found


@pytest.mark.slow
def test_a_slave_that_is_held_has_the_forces_of_its_master(tmp_path: pathlib.Path) -> None:
    held = STACK.replace("BOTTOM, 1, 3", "BOTTOM, 1, 3\n5, 1, 3\n6, 1, 3\n7, 1, 3\n8, 1, 3")
    text = held.replace("ABOVE, BELOW", "BELOW, ABOVE").replace("1e4\n", "1e8, 1e-6\n")
    found = cq.crosscheck(write(tmp_path, text))
    assert found.passed, found.summary()
    assert found.pairs[0].resultant == pytest.approx(10.0, rel=1e-4)


def test_results_in_the_other_format_are_read(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("1e4\n", "1e8, 1e-6\n").replace("*NODE PRINT, NSET=ALL", "*NODE FILE")
    run(tmp_path, text)
    found = cq.crosscheck(write(tmp_path, text), tmp_path / "job.frd")
    assert found.passed, found.summary()


def test_a_deck_in_another_hand_is_run_as_it_is_meant(tmp_path: pathlib.Path) -> None:
    """CalculiX itself takes no blanks and quotes around names, no number of +7, and no contact without a type."""
    text = STACK.replace("1e4\n", "1.0+7\n").replace("ABOVE, BELOW", '\t"Above" ,\tBelow')
    text = text.replace(
        "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=NODE TO SURFACE", '*Contact Pair,\n interaction = "Touch"'
    )
    text = text.replace("1, 1, 2, 3, 4, 5, 6, 7, 8", "1, 1, 2, 3, 4,\n** within\n 5, 6, 7, 8").replace("\n", "\r\n")
    (tmp_path / "model.inp").write_bytes(("\ufeff" + text).encode("utf-8"))
    found = cq.crosscheck(tmp_path / "model.inp")
    assert found.passed, found.summary()
    assert found.pairs[0].resultant == pytest.approx(5.0, rel=1e-4)


def in_metres(text: str) -> str:
    """Return a deck of millimetres and newtons in metres and newtons."""
    lines, keyword = [], ""
    for line in text.splitlines():
        keyword = line if line.startswith("*") else keyword
        words = [word.strip() for word in line.split(",")]
        if line.startswith("*"):
            words = [line]
        elif keyword.startswith("*NODE,"):
            words[1:] = [f"{1e-3 * float(word):.12e}" for word in words[1:]]
        elif keyword.startswith("*ELASTIC"):
            words[0] = f"{1e6 * float(words[0]):.8e}"
        elif keyword.startswith("*SURFACE BEHAVIOR"):
            words = [f"{scale * float(word):.8e}" for scale, word in zip((1e9, 1e6), words, strict=False)]
        elif keyword.startswith("*BOUNDARY") and len(words) == 4:
            words[3] = f"{1e-3 * float(words[3]):.8e}"
        lines.append(", ".join(words))
    return "\n".join([*lines, ""])


@pytest.mark.slow
@pytest.mark.parametrize("kind", [NODES, FACES])
def test_a_verdict_is_the_same_in_other_units(tmp_path: pathlib.Path, kind: str) -> None:
    text = two_blocks("hex8", kind, STIFF[kind])
    small, large = (cq.crosscheck(write(tmp_path, one, f"{at}.inp")) for at, one in enumerate((text, in_metres(text))))
    assert (small.word, large.word) == ("right", "right")
    assert large.pairs[0].resultant == pytest.approx(small.pairs[0].resultant, rel=1e-5)
    assert large.pairs[0].reference_resultant == pytest.approx(small.pairs[0].reference_resultant, rel=1e-9)
    assert large.pairs[0].error == pytest.approx(small.pairs[0].error, rel=0.05, abs=1e-6)


@pytest.mark.slow
def test_a_mortar_in_metres_ends_in_calculix_without_a_word(tmp_path: pathlib.Path) -> None:
    text = in_metres(two_blocks("hex8", "MORTAR", STIFF["MORTAR"]))  # in millimetres it is right: see above
    with pytest.raises(cq.BackendFailed, match="CalculiX ended with exit code 201: it names no error"):
        cq.crosscheck(write(tmp_path, text))


def test_what_calculix_passes_over_is_named(tmp_path: pathlib.Path) -> None:
    clear = "*CLEARANCE, MASTER=BELOW, SLAVE=ABOVE, VALUE=0.\n*STEP"
    found = cq.crosscheck(write(tmp_path, STACK.replace("1e4\n", "1e7\n").replace("*STEP", clear, 1)))
    assert found.word == "wrong"
    assert found.pairs[0].resultant == pytest.approx(5.0, rel=1e-3)
    assert found.pairs[0].reference_resultant == pytest.approx(10.0)
    assert "a *CLEARANCE, which CalculiX has for TYPE=SURFACE TO SURFACE alone" in found.summary()
