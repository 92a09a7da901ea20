"""Answers of problems that are dealt out to ranks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from contactqp.certificate.balance import _worst_direction
from contactqp.distributed.certificate import CuttingPlanes
from contactqp.errors import NotConverged
from contactqp.linalg.contact_iteration import resting_place
from tests.distributed.cases import RANKS

# Nodes on obstacles, bodies that float and rest on their contacts, several of them, free motions, mortar rows, ties.
BODIES = ("hertz_line", "floating_disc", "stacked_blocks", "membrane_ball", "patch_two_blocks")
NODES = ("truss_floor", "tie_symmetry", "tie_column_solid", "tie_beam_section", "two_bars", "bars_colliding")
KINDS = ("gallery:well-posed", "gallery:degenerate", "gallery:floating", "gallery:redundant", "gallery:tied")
# Mortar rows, a tie, bodies that meet, bodies that float.
FEW = ("patch_two_blocks", "tie_beam_section", "bars_colliding", KINDS[2])


def are_all_answered(said: str, names: tuple[str, ...]) -> None:
    assert len(said.splitlines()) == len(names) + 2 * len(set(names) & set(KINDS))  # three of each kind of the gallery


@pytest.mark.slow
@pytest.mark.parametrize("count", RANKS)
def test_the_answer_is_that_of_one_process_on_any_number_of_ranks(on_ranks: Callable[..., str], count: int) -> None:
    names = BODIES + NODES + KINDS
    are_all_answered(on_ranks("answers_as_one_process.py", count, "mumps", *names), names)


@pytest.mark.parametrize("count", [pytest.param(count, marks=pytest.mark.slow) for count in (1, 2, 3, 4)])
def test_small_ones_on_every_number_of_ranks(on_ranks: Callable[..., str], count: int) -> None:
    """Two bodies with one contact may leave a rank without any of it."""
    assert len(on_ranks("answers_as_one_process.py", count, "auto", "floating_disc", *NODES).splitlines()) == 7


@pytest.mark.slow
@pytest.mark.parametrize(("count", "solver"), [(2, "gamg"), pytest.param(2, "hypre", marks=pytest.mark.slow)])
def test_no_preconditioner_changes_the_answer(on_ranks: Callable[..., str], count: int, solver: str) -> None:
    cases = ("block_on_paraboloid", "stacked_blocks", "tie_symmetry")
    assert len(on_ranks("answers_as_one_process.py", count, solver, *cases).splitlines()) == len(cases)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
def test_options_name_other_preconditioners(on_ranks: Callable[..., str], count: int) -> None:
    assert on_ranks("other_preconditioners.py", count).strip() == "obeyed"


@pytest.mark.slow
def test_what_is_wrong_is_refused_on_two_ranks(on_ranks: Callable[..., str]) -> None:
    """What the slow tests show of each script on more ranks, those of bounds and of friction included."""
    scripts = ("refused_answers.py", "refused_arguments.py", "bounds.py", "friction_refused.py")
    said = on_ranks("together.py", 2, *scripts)
    assert (said.count("judged"), said.count("refused")) == (2, 4)  # of two scripts both ranks speak, maybe at once


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3])
def test_what_is_no_answer_is_refused(on_ranks: Callable[..., str], count: int) -> None:
    assert "refused" in on_ranks("refused_answers.py", count)


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_petscs_solvers_agree_with_the_active_set_and_are_judged_as_it_is(on_ranks, ranks, tmp_path):
    assert on_ranks("comparing.py", ranks, tmp_path) == "compared\n"


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, *(pytest.param(count, marks=pytest.mark.slow) for count in (1, 3))])
def test_its_levels_are_those_of_whole_matrices_and_its_spectrum_ends_at_one(
    on_ranks: Callable[..., str], count: int
) -> None:
    assert on_ranks("levels.py", count).strip() == "equal"


# A block that can fall and turn: motions (down at the left end, down at the right end), a stop below each end.
FALLING = np.array([1.0, 1.0])
STOPS = np.eye(2)
CONTACTS = np.array([True, True])


def test_a_block_comes_to_rest_on_its_stops_with_forces_that_balance_its_weight() -> None:
    place, force = resting_place(FALLING, STOPS, np.array([0.1, 0.3]), CONTACTS)
    np.testing.assert_allclose(place, [0.1, 0.3])
    np.testing.assert_allclose(STOPS.T @ force, FALLING)


def test_rows_may_have_any_scale_and_lengths_any_unit() -> None:
    rows = np.array([[1e3, 0.0], [0.0, 1e-6]])
    place, force = resting_place(1e9 * FALLING, rows, np.array([1e-9, 1e-20]), CONTACTS)
    np.testing.assert_allclose(place, [1e-12, 1e-14], rtol=1e-6)
    np.testing.assert_allclose(rows.T @ force, 1e9 * FALLING)


def test_what_nothing_stops_is_said() -> None:
    why, _ = resting_place(FALLING, np.array([[1.0, 0.0]]), np.array([0.1]), np.array([True]))
    assert why == "the load drives a rigid motion that no contact and no tie holds back"
    # A tie stops it; an obstacle on the other side does not.
    place, _ = resting_place(FALLING, STOPS, np.array([0.1, 0.3]), np.array([True, False]))
    np.testing.assert_allclose(place, [0.1, 0.3])
    why, _ = resting_place(FALLING, -STOPS, np.array([0.1, 0.3]), CONTACTS)
    assert isinstance(why, str)


def test_bodies_that_overlap_at_the_start_rest_where_they_are() -> None:
    """Between two walls that are too near each other no rigid motion parts them; the body has to give way."""
    walls = np.array([[1.0], [-1.0]])
    place, force = resting_place(np.array([2.0]), walls, np.array([-0.1, -0.1]), CONTACTS)
    np.testing.assert_allclose(place, [0.0], atol=1e-15)
    np.testing.assert_allclose(walls.T @ force, [2.0])


@pytest.mark.parametrize("limit", [-1.0, 1.0])
def test_contacts_that_no_motion_reaches_say_nothing(limit: float) -> None:
    place, force = resting_place(np.array([1.0]), np.array([[1.0], [0.0]]), np.array([0.5, limit]), CONTACTS)
    np.testing.assert_allclose(place, [0.5])
    np.testing.assert_allclose(force, [1.0, 0.0])


def _found(basis: np.ndarray, weight: np.ndarray) -> tuple[float, int]:
    search, queries = CuttingPlanes(weight), 0
    while not search.done:
        query, queries = search.query, queries + 1
        search.add_cut(basis.T @ np.sign(basis @ query))
    best = search.best
    return abs(float(weight @ best)) / float(np.sum(abs(basis @ best))), queries


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("count", "width"), [(3, 2), (20, 3), (2000, 3), (12, 6), (300, 6), (3000, 6)])
def test_the_worst_motion_is_that_of_the_whole_program(count: int, width: int) -> None:
    rng = np.random.default_rng(count)
    sizes = np.exp(2 * rng.standard_normal(count)) * (rng.random(count) < 0.8)
    sizes[: width + 1] = 1.0
    basis = np.linalg.qr(rng.standard_normal((count, width)) * sizes[:, None])[0]
    weight = rng.standard_normal(width)
    direction = _worst_direction(basis, weight / np.max(abs(weight)))
    expected = abs(weight @ direction) / np.sum(abs(basis @ direction))
    found, queries = _found(basis, weight)
    assert found == pytest.approx(expected, rel=1e-8)
    # No coordinate alone is as bad, so there was something to search.
    assert np.max(abs(weight) / np.sum(abs(basis), axis=0)) < found
    assert queries < 200


def test_a_search_that_gets_no_nearer_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("contactqp.distributed.certificate.MOST_QUERIES", 8)
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((2000, 6)))[0]
    with pytest.raises(NotConverged, match="balance of forces"):
        _found(basis, np.arange(1.0, 7.0))
