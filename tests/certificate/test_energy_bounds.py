"""What the enclosed energy rests on where K does not see everything."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.energy_bounds import diagonal_dominance


def problem_of(K: np.ndarray) -> cq.ContactProblem:
    n = len(K)
    return cq.ContactProblem(K, np.zeros(n), np.eye(1, n), [1.0])


def test_a_dominant_row_beside_one_that_is_not_has_nothing_to_spare() -> None:
    """K (1, -2) = 0, though the first row is dominant by one."""
    K = np.zeros((3, 3))
    K[:2, :2] = [[2.0, 1.0], [1.0, 0.5]]
    K[2, 2] = 3.0
    assert diagonal_dominance(problem_of(K)) == pytest.approx([0.0, 0.0, 3.0])


@pytest.mark.parametrize("seed", range(20))
def test_what_is_left_of_the_stiffness_is_semidefinite(seed: int) -> None:
    random = np.random.default_rng(seed)
    B = random.normal(size=(8, 8)) * (random.random((8, 8)) < 0.2)
    K = B.T @ B + np.diag(random.choice([0.0, 0.5, 4.0], 8))
    dominance = diagonal_dominance(problem_of(K))
    assert np.all(dominance >= 0)
    assert np.min(np.linalg.eigvalsh(K - np.diag(dominance))) > -1e-12
