"""Certificates of answers that no rank has whole, against those of one process."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.distributed.cases import RANKS

# Supports, ties, bodies that float, friction in the plane and in space, contacts that graze.
CASES = (
    "truss_floor",
    "tie_beam_section",
    "tie_symmetry",
    "floating_disc",
    "truss_friction",
    "stacked_blocks",
    "two_masses",
    "string_just_touching",
    "hanging_block",
    "block_on_incline_sideways",
    "hertz_bodies",
)


# Of every kind one, among them all wrong answers that there are.
FEW = ("tie_beam_section", "block_on_incline_sideways")


def are_judged_in_every_way(said: str, names: tuple[str, ...]) -> None:
    judged = [line.partition(": ")[0].partition(", ") for line in said.splitlines()]
    assert {case for case, _, _ in judged} == set(names)
    # What is judged alike must have been wrong in every way.
    assert {kind for _, _, kind in judged} >= {
        "right",
        "half-converged",
        "flipped sign",
        "tension",
        "penetration",
        "friction along the slip",
        "friction beyond its bound",
        "tie",
        "tie force",
        "displacement is NaN",
        "tie_force is NaN",
    }
    unbalanced = [line for line in said.splitlines() if not line.endswith(("balance 0", "balance inf"))]
    assert unbalanced, "no answer leaves a floating body without balance"


@pytest.mark.slow
@pytest.mark.parametrize("count", RANKS)
def test_every_figure_and_word_is_that_of_one_process(on_ranks: Callable[..., str], count: int) -> None:
    are_judged_in_every_way(on_ranks("certificates.py", count, *CASES), CASES)


@pytest.mark.slow
def test_what_is_made_for_one_rule_is_judged_as_by_one_process(on_ranks: Callable[..., str]) -> None:
    """A tie that an unknown without stiffness takes up hides no tension; forces behind a rigid motion are judged.

    Rounding of a load across what bears it is no load.
    """
    said = on_ranks("certificates.py", 2, "lever", "fallen", "across").splitlines()
    problems = [line.partition(",")[0] for line in said]
    assert problems == ["lever"] * 3 + ["fallen"] * 3 + ["pushed out"] * 3 + ["across the bar"] * 2


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3])
def test_bounds_that_a_solver_has_enter_the_verdict(on_ranks: Callable[..., str], count: int) -> None:
    assert "judged" in on_ranks("bounds.py", count)
