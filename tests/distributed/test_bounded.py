"""PETSc's own solvers of problems with bounds beside the active set."""

from __future__ import annotations

import pytest


@pytest.mark.parametrize("ranks", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_petscs_solvers_agree_with_the_active_set_and_are_judged_as_it_is(on_ranks, ranks, tmp_path):
    assert on_ranks("comparing.py", ranks, tmp_path) == "compared\n"
