"""Answers of problems that are dealt out to ranks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.distributed.cases import few_and_all

# Nodes on obstacles, bodies that float and rest on their contacts, several of them, free motions, mortar rows, ties.
BODIES = ("hertz_line", "floating_disc", "stacked_blocks", "membrane_ball", "patch_two_blocks")
NODES = ("truss_floor", "tie_symmetry", "tie_column_solid", "tie_beam_section", "two_bars", "bars_colliding")
KINDS = ("gallery:well-posed", "gallery:degenerate", "gallery:floating", "gallery:redundant", "gallery:tied")
# One of every kind.
FEW = ("stacked_blocks", "membrane_ball", "patch_two_blocks", "tie_beam_section", "bars_colliding", *KINDS[1:4])


@pytest.mark.parametrize(("count", "names"), few_and_all(FEW, BODIES + NODES + KINDS))
def test_the_answer_is_that_of_one_process_on_any_number_of_ranks(
    on_ranks: Callable[..., str], count: int, names: tuple[str, ...]
) -> None:
    said = on_ranks("answers_as_one_process.py", count, "mumps", *names).splitlines()
    assert len(said) == len(names) + 2 * len(set(names) & set(KINDS))  # three of each kind of the gallery


@pytest.mark.parametrize("count", [pytest.param(count, marks=pytest.mark.slow) for count in (1, 2, 3, 4)])
def test_small_ones_on_every_number_of_ranks(on_ranks: Callable[..., str], count: int) -> None:
    """Two bodies with one contact may leave a rank without any of it."""
    assert len(on_ranks("answers_as_one_process.py", count, "auto", "floating_disc", *NODES).splitlines()) == 7


@pytest.mark.parametrize(("count", "solver"), [(2, "gamg"), pytest.param(2, "hypre", marks=pytest.mark.slow)])
def test_no_preconditioner_changes_the_answer(on_ranks: Callable[..., str], count: int, solver: str) -> None:
    cases = ("block_on_paraboloid", "stacked_blocks", "tie_symmetry")
    assert len(on_ranks("answers_as_one_process.py", count, solver, *cases).splitlines()) == len(cases)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("count", [1, 2])
def test_options_name_other_preconditioners(on_ranks: Callable[..., str], count: int) -> None:
    assert on_ranks("other_preconditioners.py", count).strip() == "obeyed"


@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_what_is_no_answer_is_refused(on_ranks: Callable[..., str], count: int) -> None:
    assert "refused" in on_ranks("refused_answers.py", count)


@pytest.mark.parametrize("count", [2])
def test_arguments_that_are_no_good_are_refused_in_one_line(on_ranks: Callable[..., str], count: int) -> None:
    assert "refused" in on_ranks("refused_arguments.py", count)


@pytest.mark.slow
@pytest.mark.parametrize("count", [3])
def test_what_a_row_feels_by_rounding_alone_it_does_not_resist(on_ranks: Callable[..., str], count: int) -> None:
    assert "held" in on_ranks("partly_held.py", count)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc to look at memory in")
def test_solutions_again_and_again_take_no_more_memory(on_ranks: Callable[..., str]) -> None:
    """PETSc keeps what Python drops until it is told that all ranks have dropped it."""
    assert on_ranks("same_memory.py", 2).strip() == "the same"
