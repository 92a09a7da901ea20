"""Contacts that the products of their rows no longer tell from dependent ones."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq

COUNT = 8


def falling_stack(heavy: float, floor: float) -> cq.ContactProblem:
    """Seven masses of 1 under a heavy one fall at 1 onto a floor that sinks at `floor`: M v + E'p = M v_free."""
    mass = np.append(np.ones(COUNT - 1), heavy)
    rows = np.eye(COUNT, k=-1) - np.eye(COUNT)
    gap = np.zeros(COUNT)
    gap[0] = floor
    return cq.ContactProblem(np.diag(mass), -mass, rows, gap)


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
