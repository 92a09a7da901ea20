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
# Nothing sticks or some do, in the plane and in space, floating.
FEW = ("two_masses", PARTIAL[2], FLOATING[0])


def are_answered_with_states(said: str, names: tuple[str, ...]) -> None:
    lines = said.splitlines()
    assert len(lines) == len(names)
    partial = [line for line in lines if line.startswith(PARTIAL)]
    assert len(partial) == len(set(names) & set(PARTIAL)) > 0
    for line in partial:
        assert " 0 stick" not in line
        assert " 0 slip" not in line


@pytest.mark.slow
@pytest.mark.parametrize("count", RANKS)
def test_the_answer_is_that_of_one_process_on_any_number_of_ranks(on_ranks: Callable[..., str], count: int) -> None:
    names = CASES + PARTIAL + FLOATING
    are_answered_with_states(on_ranks("friction_answers.py", count, "mumps", *names), names)


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["gamg", "hypre"])
def test_no_preconditioner_changes_the_answer(on_ranks: Callable[..., str], solver: str) -> None:
    """Without friction one does not change it either, which is shown every time."""
    names = PARTIAL + FLOATING
    assert len(on_ranks("friction_answers.py", 2, solver, *names).splitlines()) == len(names)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2])
def test_curved_bodies_that_stick_in_the_middle_and_slide_around_it(on_ranks: Callable[..., str], count: int) -> None:
    """Cattaneo and Mindlin's spheres: rows of two bodies, directions of slip in space."""
    assert " 0 slip" not in on_ranks("friction_answers.py", count, "auto", "cattaneo_mindlin_sphere")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "names"), [(2, PARTIAL[3:]), pytest.param(3, PARTIAL[1::2], marks=pytest.mark.slow)], ids=["few", "more"]
)
def test_the_fixed_point_alone_comes_to_the_same_answer(
    on_ranks: Callable[..., str], count: int, names: tuple[str, ...]
) -> None:
    assert " 1 steps" not in on_ranks("friction_answers.py", count, "mumps", "--steps", *names)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3])
def test_wrong_answers_are_refused(on_ranks: Callable[..., str], count: int) -> None:
    assert "refused" in on_ranks("friction_refused.py", count)


@pytest.mark.slow
def test_what_is_lifted_is_anchored_where_it_lands_on_ranks_too(on_ranks: Callable[..., str]) -> None:
    assert "where it lands" in on_ranks("friction_path.py", 2, "lifted")


@pytest.mark.slow
@pytest.mark.parametrize("count", [2])
def test_a_load_path_keeps_what_has_slipped_as_one_process_does(on_ranks: Callable[..., str], count: int) -> None:
    """Contacts that close on the way count their slip from there; energies and events are the same too."""
    said = on_ranks("friction_path.py", count, 4, "pad_on_incline", "klarbring_press_first", "order_press_first")
    assert len(said.splitlines()) == 3
    assert "slip" in said
