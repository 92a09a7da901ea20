"""Ties eliminated in exact numbers, against the multiplier system."""

from dataclasses import replace
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.scene import building
from contactqp.scene.building import exact_problem

CASES = Path(__file__).parents[2] / "cases"


def case(name):
    return exact_problem(cq.load_scene(CASES / name))


def test_the_reduced_problem_has_the_solution_of_the_whole():
    """A rational counter-example to the printed eq. 2.20: its first right-hand block lacks -K_us A_s^-1 b."""
    exact, masters = case("master_slave_gap.toml"), ["1.x", "2.x", "master.x"]
    K = np.array(building.reduced_stiffness(exact, masters), dtype=float).reshape(3, 3)
    f = np.array(building.reduced_load(exact, masters), dtype=float)
    right = [float(F(n, 28588)) for n in (11657, 4869, 21289)]
    np.testing.assert_allclose(np.linalg.solve(K, f), right, rtol=1e-14)
    printed = f.copy()
    printed[:2] = [3, -1]
    wrong = [float(F(n, 7147)) for n in (3058, 856, 5241)]
    np.testing.assert_allclose(np.linalg.solve(K, printed), wrong, rtol=1e-14)


def test_masters_that_do_not_decide_the_slaves_are_refused():
    with pytest.raises(cq.SceneError, match="expected masters that decide the 2 others"):
        building.reduced_stiffness(case("master_slave_gap.toml"), ["1.x", "2.x"])


def test_the_rank_does_not_count_a_tie_twice():
    exact = case("tie_symmetry.toml")
    assert building.rank(exact) == 3
    twice = replace(exact, ties=(*exact.ties, exact.ties[0]))
    assert building.rank(twice) == 3
