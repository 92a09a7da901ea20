"""The verdicts of docs/crosscheck.md on CalculiX follow from the decks alone."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("skfem")

import contactqp as cq
from benchmarks.crosscheck import calculix
from benchmarks.crosscheck.attempts import ATTEMPTS, Attempt
from benchmarks.crosscheck.block import block

EVERY = [one for asked in ATTEMPTS.values() for one in asked if one.contact is not None]
# What is off by less than a hundredth of the resultant is right where nothing else is asked for.
WRONG = {
    "node to face, HARD": "3 nodes pull with 600.* adhesion",
    "node to face, slave nodes": "6 nodes pull with 180.* adhesion",
    "mortar, floor as large as the block": "slave nodes stand over the edge of the master surface",
    "loads of 21 characters": "first 20 characters of each number",
}


@pytest.mark.sampled(10)
@pytest.mark.skipif(not calculix.available(), reason="CalculiX (ccx) is not installed")
@pytest.mark.parametrize("attempt", EVERY, ids=lambda one: one.name)
def test_the_verdict_follows_from_the_deck(tmp_path: Path, attempt: Attempt) -> None:
    assert attempt.contact is not None
    deck = tmp_path / "model.inp"
    deck.write_text(calculix.contact_deck(block(), attempt.contact), encoding="ascii")
    found = cq.crosscheck(deck)
    assert found.passed == (attempt.name not in WRONG), found.summary()
    if attempt.name in WRONG:
        assert re.search(WRONG[attempt.name], found.summary()), found.summary()
    right = cq.solve(block().problem).normal_force.sum()
    assert found.pairs[0].reference_resultant == pytest.approx(right, rel=1e-9)
    # As the page judges: springs of 50 E are told from contact at the digits that are printed.
    closely = cq.crosscheck(deck, found.results, error_tolerance=1e-4)
    assert closely.passed == (attempt.name in ("node to face, stiff springs", "face to face, stiff springs",
                                               "node to face, stiff springs, pressures"))  # fmt: skip
    if attempt.name == "node to face, springs":
        assert "springs in the place of contact" in closely.summary()
        assert cq.crosscheck(deck, found.results, reference="penalty", error_tolerance=1e-4).passed
