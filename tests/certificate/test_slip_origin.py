"""What an error of the slip origin, which earlier steps of a load path leave, makes of an answer."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq


@pytest.mark.parametrize(
    ("width", "problems"), [(2, 20), *(pytest.param(width, 40, marks=pytest.mark.slow) for width in (1, 2))]
)
def test_what_an_error_of_the_slip_origin_makes_of_the_answer_is_bounded(width: int, problems: int) -> None:
    """|d|_W <= sum (mu_i n_i + t_i) |delta_i| / (1 - kappa), as docs/formulation.md says; a tenth bounds nothing."""
    rng, m, parts = np.random.default_rng(5), 3, []
    for _ in range(problems):
        n = (1 + width) * m + 2
        A = rng.normal(size=(n, n))
        rows = rng.normal(size=(m, 1 + width, n))
        normal, tangent = rows[:, 0], rows[:, 1:].reshape(width * m, n)
        origin = 0.1 * rng.normal(size=(m, width))
        problem = cq.ContactProblem(
            A @ A.T + 2 * np.eye(n), 9 * normal.sum(axis=0), normal, 0.1 * rng.normal(size=m), tangent, 0.2, origin
        )
        kappa = cq.critical_friction(problem).kappa
        if kappa >= 0.9:
            continue
        delta = 10.0 ** rng.integers(-6, 0) * rng.normal(size=(m, width)) * np.eye(m)[rng.integers(m), :, None]
        one, other = cq.solve(problem), cq.solve(problem.replace(slip_origin=origin + delta))
        K = np.asarray(problem.stiffness)
        every = np.concatenate([normal[:, None], tangent.reshape(m, width, n)], axis=1).reshape(-1, n)
        inverse = np.linalg.inv(every @ np.linalg.solve(K, every.T)).reshape(m, 1 + width, m, 1 + width)
        own = inverse[np.arange(m), :, np.arange(m)]
        largest = 0.2 * np.sqrt(own[:, 0, 0]) + np.sqrt(np.linalg.eigvalsh(own[:, 1:, 1:])[:, -1])
        moved = one.displacement - other.displacement  # whose energy norm is |d|_W
        parts.append(float(np.sqrt(moved @ K @ moved) * (1 - kappa) / (largest @ np.linalg.norm(delta, axis=1))))
    assert len(parts) >= problems // 4
    assert 0.1 < max(parts) <= 1
