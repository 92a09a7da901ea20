"""Contacts that the products of their rows no longer tell from dependent ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

import contactqp as cq
from contactqp.solving.methods.active_set import _furthest

COUNT = 8


def falling_stack(heavy: float, floor: float) -> cq.ContactProblem:
    """Seven masses of 1 under a heavy one fall at 1 onto a floor that sinks at `floor`: M v + E'p = M v_free."""
    mass = np.append(np.ones(COUNT - 1), heavy)
    rows = np.eye(COUNT, k=-1) - np.eye(COUNT)
    gap = np.zeros(COUNT)
    gap[0] = floor
    return cq.ContactProblem(np.diag(mass), -mass, rows, gap)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("exponent", [33, 40, 44, 47, 50])
def test_a_heavy_mass_on_light_ones_is_stopped(exponent: int) -> None:
    """All fall at 1/4 afterwards; the impulse between two of them is 3/4 of the mass above."""
    heavy = 2.0**exponent
    found = cq.solve(falling_stack(heavy, 0.25))
    np.testing.assert_allclose(found.displacement, np.full(COUNT, -0.25), rtol=1e-14)
    np.testing.assert_allclose(found.normal_force, 0.75 * (heavy + np.arange(COUNT - 1, -1, -1.0)), rtol=1e-14)


def test_rows_that_conflict_have_no_equilibrium_all_the_same() -> None:
    """u <= 1 and u >= 2."""
    with pytest.raises((cq.NoEquilibrium, cq.NotConverged)):
        cq.solve(cq.ContactProblem([[1.0]], [0.0], [[1.0], [-1.0]], [1.0, -2.0]))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", range(20))
def test_motions_that_rows_bound_one_by_one_go_where_a_linear_program_sends_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, m = int(rng.integers(1, 4)), int(rng.integers(1, 7))
    rows = np.zeros((m, q))
    rows[np.arange(m), rng.integers(0, q, m)] = rng.choice([-2.0, -1.0, 0.0, 1.0, 3.0], m)
    drive, limit = rng.normal(size=q), rng.normal(size=m) + 0.5
    found = linprog(-drive, A_ub=rows, b_ub=limit, bounds=(None, None), method="highs")
    expected = np.zeros(q) if found.x is None else found.x
    np.testing.assert_allclose(_furthest(drive, rows, limit), expected, atol=1e-12)


def test_what_a_row_feels_by_rounding_bounds_no_motion() -> None:
    """Two unknowns that nothing holds: the second row is skew by a rounding, and would stop the first at 1e17."""
    problem = cq.ContactProblem(
        stiffness=np.zeros((2, 2)), load=[1.0, 1.0], normal=[[1.0, 0.0], [1e-17, 1.0]], gap=[0.5, 0.25]
    )
    found = cq.solve(problem)
    np.testing.assert_allclose(found.displacement, [0.5, 0.25], rtol=1e-14)
    np.testing.assert_allclose(found.normal_force, [1.0, 1.0], rtol=1e-14)
