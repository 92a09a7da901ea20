"""Certificates of answers that no rank has whole, against those of one process."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.distributed.cases import few_and_all

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
FEW = ("tie_beam_section", "floating_disc", "two_masses", "string_just_touching", "block_on_incline_sideways")


@pytest.mark.parametrize(("count", "names"), few_and_all(FEW, CASES))
def test_every_figure_and_word_is_that_of_one_process(
    on_ranks: Callable[..., str], count: int, names: tuple[str, ...]
) -> None:
    said = on_ranks("certificates.py", count, *names)
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


def test_a_tie_that_an_unknown_without_stiffness_takes_up_hides_no_tension(on_ranks: Callable[..., str]) -> None:
    assert on_ranks("certificates.py", 2, "lever").count("judged") == 3


def test_forces_behind_a_rigid_motion_are_judged_as_by_one_process(on_ranks: Callable[..., str]) -> None:
    assert on_ranks("certificates.py", 2, "fallen").count("judged") == 6


def test_rounding_of_a_load_across_what_bears_it_is_no_load_on_ranks_either(on_ranks: Callable[..., str]) -> None:
    assert on_ranks("certificates.py", 2, "across").count("judged") == 2


@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_bounds_that_a_solver_has_enter_the_verdict(on_ranks: Callable[..., str], count: int) -> None:
    assert "judged" in on_ranks("bounds.py", count)
