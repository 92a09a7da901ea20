"""Answers with Coulomb friction of problems that are dealt out to ranks."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.distributed.cases import RANKS

CASES = (
    "truss_friction",
    "truss_rough",
    "truss_friction_unloaded",
    "pad_on_incline",
    "wedge",
    "two_masses",
    "block_on_incline_sideways",
)
# Some of their contacts stick and others slide.
PARTIAL = ("pushed in the plane/0.1", "pushed in the plane/0.3", "pushed in space/0.3", "two blocks/0.3")
FLOATING = ("on an incline/0.3", "on an incline/1.0")


@pytest.mark.parametrize("count", RANKS)
def test_the_answer_is_that_of_one_process_on_any_number_of_ranks(on_ranks: Callable[..., str], count: int) -> None:
    said = on_ranks("rubbing.py", count, "mumps", *CASES, *PARTIAL, *FLOATING).splitlines()
    assert len(said) == len(CASES) + len(PARTIAL) + len(FLOATING)
    for line in said[len(CASES) : len(CASES) + len(PARTIAL)]:
        assert " 0 stick" not in line
        assert " 0 slip" not in line


@pytest.mark.parametrize(("count", "solver"), [(2, "gamg"), pytest.param(2, "hypre", marks=pytest.mark.slow)])
def test_no_preconditioner_changes_the_answer(on_ranks: Callable[..., str], count: int, solver: str) -> None:
    assert len(on_ranks("rubbing.py", count, solver, *PARTIAL, *FLOATING).splitlines()) == len(PARTIAL + FLOATING)


@pytest.mark.parametrize("count", [2])
def test_curved_bodies_that_stick_in_the_middle_and_slide_around_it(on_ranks: Callable[..., str], count: int) -> None:
    """Cattaneo and Mindlin's spheres: rows of two bodies, directions of slip in space."""
    assert " 0 slip" not in on_ranks("rubbing.py", count, "auto", "cattaneo_mindlin_sphere")


@pytest.mark.parametrize("count", [3])
def test_the_fixed_point_alone_comes_to_the_same_answer(on_ranks: Callable[..., str], count: int) -> None:
    assert " 1 steps" not in on_ranks(
        "rubbing.py", count, "mumps", "--steps", "pushed in the plane/0.3", "two blocks/0.3"
    )


@pytest.mark.parametrize("count", [3])
def test_wrong_answers_are_refused(on_ranks: Callable[..., str], count: int) -> None:
    assert "refused" in on_ranks("rubbing_wrongly.py", count)


@pytest.mark.parametrize("count", [2])
def test_a_load_path_keeps_what_has_slipped_as_one_process_does(on_ranks: Callable[..., str], count: int) -> None:
    """Contacts that close on the way count their slip from there; energies and events are the same too."""
    said = on_ranks("rubbing_path.py", count, 4, "pad_on_incline", "klarbring_press_first", "order_press_first")
    assert len(said.splitlines()) == 3
    assert "slip" in said
