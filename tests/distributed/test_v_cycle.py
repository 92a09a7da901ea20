"""The V-cycle over ranks is what conjugate gradients and the bounds take it for."""

from __future__ import annotations

from collections.abc import Callable

import pytest


@pytest.mark.parametrize("count", [3, pytest.param(1, marks=pytest.mark.slow)])
def test_its_levels_are_those_of_whole_matrices_and_its_spectrum_ends_at_one(
    on_ranks: Callable[..., str], count: int
) -> None:
    assert on_ranks("levels.py", count).strip() == "equal"
