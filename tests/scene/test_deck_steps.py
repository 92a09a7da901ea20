"""The steps of a deck: loads stay until another takes their place, and friction knows where slip has come to."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

import contactqp as cq
from contactqp.exchange.calculix_results import read_displacements
from contactqp.exchange.deck.reading import read_deck_model
from tests.decks import STACK, needs_calculix, run_calculix, write

STEPS = {
    "a force takes the place of another": ["*CLOAD\nTOP, 3, -1.\nTOP, 3, -2.", "*CLOAD\n15, 3, -5."],
    "forces stay": ["*CLOAD\nTOP, 3, -1.", "*CLOAD\nTOP, 1, 0.", ""],
    "forces are taken away": ["*CLOAD\nTOP, 3, -1.\n15, 3, -1.", "*CLOAD, OP=NEW\n16, 3, -5."],
    "a pressure takes the place of another": ["*DLOAD\n2, P2, 30.\n1, P2, 3.", "*DLOAD\nSOLID, P2, 10."],
    "a pressure on a surface": ["*DSLOAD\nUPPER, P, 30.", "*DSLOAD\nUPPER, P, 10."],
    "pressures are taken away": ["*DLOAD\n2, P2, 30.", "*DLOAD, OP=NEW\n2, P1, -10."],
    "gravity takes the place of gravity": [f"*DLOAD\nSOLID, GRAV, {size}., 0., 0., -1." for size in (9, 2)],
    "supports stay and move": ["*BOUNDARY\nTOP, 3, 3, -0.02", "*BOUNDARY\n15, 3, 3, -0.03", "*CLOAD\n11, 3, 1."],
    "supports are taken away": [
        "*BOUNDARY\nTOP, 3, 3, -0.02",
        "*BOUNDARY, OP=NEW\nBOTTOM, 1, 3\nALL, 1, 2\n*CLOAD\nTOP, 3, -3.",
    ],
    "forces are taken away without others": ["*CLOAD\nTOP, 3, -1.\n15, 3, -1.", "*CLOAD, OP=NEW"],
    "pressures are taken away without others": ["*DLOAD\n2, P2, 30.", "*DLOAD, OP=NEW"],
    "supports are taken away, and stated by another card": [
        "*BOUNDARY\nTOP, 3, 3, -0.02",
        "*BOUNDARY, OP=NEW\n*BOUNDARY\nBOTTOM, 1, 3\nALL, 1, 2\n15, 3, 3, -0.03",
    ],
    "an amplitude ends with its step": ["*CLOAD, AMPLITUDE=A\nTOP, 3, -1.", ""],
}  # fmt: skip
PERIODS = [1.0, 2.0, 4.0]


def in_steps(steps: list[str], before: str = "", stack: str = STACK) -> str:
    """Return a deck of these steps, with a surface UPPER and an amplitude A."""
    head = stack.partition("*STEP")[0]
    head = head.replace("*SURFACE INTERACTION", "*SURFACE, NAME=UPPER\n2, S2\n*SURFACE INTERACTION", 1)
    head += "*AMPLITUDE, NAME=A\n0., 0., 1., 3., 2., 5.\n" + before
    for period, step in zip(PERIODS, steps, strict=False):
        head += f"*STEP\n*STATIC\n{period}, {period}\n{step}\n*NODE PRINT, NSET=ALL\nU\n*END STEP\n"
    return head.replace("\n\n", "\n")


@pytest.mark.sampled(9)
@needs_calculix
@pytest.mark.parametrize("name", STEPS)
def test_loads_of_steps_are_those_of_calculix(tmp_path: pathlib.Path, name: str) -> None:
    text = in_steps(STEPS[name], "" if "supports" in name else "15, 3, 3, -0.02\n".join(["*BOUNDARY\n", ""]))
    deck = cq.read_deck(write(tmp_path, text))
    run_calculix(tmp_path, text)
    field, _ = read_displacements(tmp_path / "job.dat")
    assert field.time == pytest.approx(deck.model.end)
    labels, moved = deck.displacements(cq.solve(deck.problem("penalty")).displacement[: len(deck.free)])
    theirs = field.values[np.argsort(field.nodes)]
    assert labels.tolist() == sorted(field.nodes.tolist())
    assert abs(theirs).max() > 1e-3
    assert np.allclose(moved, theirs, rtol=0, atol=2e-4 * abs(theirs).max())  # its springs are not quite linear


def test_what_both_programs_do_differently_is_refused(tmp_path: pathlib.Path) -> None:
    differ = {
        "expected GRAV on the same elements": [f"*DLOAD\nSOLID, GRAV, 9., {way}" for way in ("0., 0., -1.", "1.")],
        "has a *DSLOAD on the face of element 2": ["*DLOAD\n2, P2, 3.", "*DSLOAD\nUPPER, P, 3."],
        "takes away the *DLOAD of earlier steps too": ["*DLOAD\n2, P2, 3.", "*DSLOAD, OP=NEW\nUPPER, P, 3."],
        "with the first of its keyword": ["", "*CLOAD\n15, 3, 1.\n*CLOAD, OP=NEW\n16, 3, 1."],
        "before the step included": ["*BOUNDARY, OP=NEW\nBOTTOM, 1, 3"],
    }  # fmt: skip
    for said, steps in differ.items():
        with pytest.raises(cq.InvalidProblem, match=said.replace("*", r"\*")):
            read_deck_model(write(tmp_path, in_steps(steps)))


def solved(folder: pathlib.Path, steps: list[str], enforcement: str = "exact") -> cq.Solution:
    return cq.solve(cq.read_deck(write(folder, in_steps(steps, stack=RUBBING))).problem(enforcement))


# A cube on a wider block is pressed down, pushed aside until it slips, and back by less than its shear gives.
CORNERS = enumerate([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], 1)
WIDER = {f"{node}, {x}., {y}., {z}.": f"{node}, {3 * x - 1}., {3 * y - 1}., {z}." for node, (x, y, z) in CORNERS}
RUBBING = (
    STACK.replace("1e4\n*CONTACT", "1e4\n*FRICTION\n0.3, 1e5\n*CONTACT")
    .replace("ALL, 1, 2", "ALL, 2, 2")
    .replace("1000., 0.", "1000., 0.2")
)
for narrow, wide in WIDER.items():
    RUBBING = RUBBING.replace(f" {narrow}\n", f" {wide}\n")
STRAIGHT = ["*BOUNDARY\nTOP, 1, 1, 0.038\nTOP, 3, 3, -0.03"]
BACK_AND_FORTH = ["*BOUNDARY\nTOP, 1, 1\nTOP, 3, 3, -0.03", "*BOUNDARY\nTOP, 1, 1, 0.04", "*BOUNDARY\nTOP, 1, 1, 0.038"]


@pytest.mark.slow
def test_slip_starts_from_where_the_step_before_ended(tmp_path: pathlib.Path) -> None:
    assert " 7, 2., 2., 1.\n" in RUBBING
    pressed, aside, back = (solved(tmp_path, BACK_AND_FORTH[:count]) for count in (1, 2, 3))
    straight = solved(tmp_path, STRAIGHT)
    for one in (pressed, aside, back, straight):
        assert one.certificate.passed
    for one in (aside, straight):  # they slip
        size = abs(one.friction_force.sum(axis=0)[0])
        assert size == pytest.approx(0.3 * one.normal_force.sum(), rel=1e-9)
    # Shear takes away a part of the force that a straight way to the same place has.
    assert abs(back.friction_force.sum(axis=0)[0]) < 0.95 * abs(straight.friction_force.sum(axis=0)[0])
    still = solved(tmp_path, [*BACK_AND_FORTH[:2], "*BOUNDARY\nTOP, 1, 1, 0.04"])
    assert np.allclose(still.friction_force, aside.friction_force, rtol=1e-9)


@pytest.mark.slow
@needs_calculix
def test_friction_over_steps_is_that_of_calculix(tmp_path: pathlib.Path) -> None:
    text = in_steps(BACK_AND_FORTH, stack=RUBBING)
    deck = cq.read_deck(write(tmp_path, text))
    run_calculix(tmp_path, text)
    field, _ = read_displacements(tmp_path / "job.dat")
    theirs = field.values[np.argsort(field.nodes)].ravel()
    ours, straight = (
        deck.expand(solved(tmp_path, steps, "penalty").displacement[: len(deck.free)])
        for steps in (BACK_AND_FORTH, STRAIGHT)
    )
    # In increments of its own, with smoothed springs, it is as far off in one step.
    assert np.allclose(ours, theirs, rtol=0, atol=3e-3 * abs(theirs).max())
    assert abs(straight - theirs).max() > 3e-2 * abs(theirs).max()  # the way matters


@needs_calculix
def test_a_deck_of_steps_is_judged_at_its_end(tmp_path: pathlib.Path) -> None:
    verdict = cq.crosscheck(write(tmp_path, in_steps(BACK_AND_FORTH, stack=RUBBING)), reference="penalty")
    assert verdict.passed
    assert verdict.pairs[0].reference_resultant > 0
    assert any("friction is followed step by step" in line for line in verdict.ledger.assumed)
    assert len(set(verdict.ledger)) == len(list(verdict.ledger))  # each line once, although three steps are solved


@pytest.mark.slow
def test_a_pair_that_nothing_reaches_changes_no_slip(tmp_path: pathlib.Path) -> None:
    faces = "*SURFACE, NAME=SIDE\n2, S3\n*SURFACE, NAME=FAR\n1, S5\n"
    pair = "*SURFACE INTERACTION, NAME=OTHER\n*CONTACT PAIR, INTERACTION=OTHER, TYPE=NODE TO SURFACE\nSIDE, FAR\n"
    stack = RUBBING.replace("*SURFACE INTERACTION, NAME=TOUCH", f"{faces}{pair}*SURFACE INTERACTION, NAME=TOUCH", 1)
    deck = cq.read_deck(write(tmp_path, in_steps(BACK_AND_FORTH, stack=stack)))
    assert [len(one.labels) for one in deck.contacts("node-to-segment").pairs] == [0, 4]
    friction = solved(tmp_path, BACK_AND_FORTH).friction_force
    assert np.allclose(cq.solve(deck.problem()).friction_force, friction, rtol=1e-9)


def test_a_step_without_an_answer_is_named(tmp_path: pathlib.Path) -> None:
    lifted = ["*BOUNDARY, OP=NEW\nBOTTOM, 1, 3\n*CLOAD\nTOP, 3, 1.", BACK_AND_FORTH[0]]
    stack = RUBBING.replace("ALL, 2, 2\n", "")
    with pytest.raises(cq.InvalidProblem, match="stands with the first of all"):
        cq.read_deck(write(tmp_path, in_steps(lifted, stack=stack)))
    lifted[0] = "*CLOAD\nTOP, 3, 1."
    with pytest.raises(cq.NoEquilibrium, match=r"^step 1: "):
        cq.read_deck(write(tmp_path, in_steps(lifted, stack=stack))).problem()


def test_more_steps_than_are_followed_are_refused(tmp_path: pathlib.Path) -> None:
    text = in_steps([""]) + 100 * "*STEP\n*STATIC\n*END STEP\n"
    with pytest.raises(cq.InvalidProblem, match="expected at most 100 steps, got 101"):
        read_deck_model(write(tmp_path, text))
