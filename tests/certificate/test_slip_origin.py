"""What an error of the slip origin, which earlier steps of a load path leave, makes of an answer."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.uniqueness import FORCES


@pytest.mark.slow
@pytest.mark.parametrize(("width", "problems"), [(2, 20), (1, 40), (2, 40)])
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


def node_on_a_guide(width: int, origin: float, friction: float = 0.5) -> cq.ContactProblem:
    """A node above a floor on a guide of 45 degrees, u_x + u_z = 0, that is pressed into the wedge by N + T_x = 3."""
    across = [[0.0, 1.0, 0.0]] * (width - 1)
    return cq.ContactProblem(
        stiffness=[[2.0, 0.5, 0.0], [0.5, 2.0, 0.0], [0.0, 0.0, 2.0]], load=[2.0, 0.0, -1.0],
        normal=[[0.0, 0.0, -1.0]], gap=[0.0],
        tangent=[[1.0, 0.0, 0.0], *across], friction=friction, slip_origin=[[origin, *[0.0] * (width - 1)]],
        tie=[[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]], tie_value=[0.0, 0.0],
    )  # fmt: skip


@pytest.mark.sampled(5)
@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize("origin", [0.0, 1e-30, 1e-17, -1e-17, 1e-14, 1e-12])
def test_a_slip_that_is_nothing_beside_what_meets_proves_no_answer_the_only_one(width: int, origin: float) -> None:
    """The node cannot move, so that any N in [2, 6] is right; a length of 1e-12 of what meets has no direction."""
    problem = node_on_a_guide(width, origin)
    for normal in (2.0, 3.0, 6.0):
        friction = [3.0 - normal, *[0.0] * (width - 1)]
        tie = [2.0 - friction[0], 0.0]
        found = cq.certify(problem, np.zeros(3), [normal], friction, tie)
        assert found.passed
        assert not found.proven
        assert FORCES in found.uniqueness
    solution = cq.solve(problem)
    assert solution.contact_status == ["stick"]
    assert FORCES in solution.certificate.uniqueness
    assert 2 - 1e-9 <= solution.normal_force <= 6 + 1e-9
    other = cq.certify(problem, np.zeros(3), [7.0], [-4.0, *[0.0] * (width - 1)], [6.0, 0.0])
    assert not other.passed


@pytest.mark.parametrize("width", [1, 2])
def test_a_slip_that_is_something_has_its_own_direction(width: int) -> None:
    problem = node_on_a_guide(width, 1e-6)
    solution = cq.solve(problem)
    assert solution.contact_status == ["slip"]
    np.testing.assert_allclose(solution.normal_force, [6.0], rtol=1e-12)
    assert FORCES not in solution.certificate.uniqueness
    still = cq.certify(problem, np.zeros(3), [2.0], [1.0, *[0.0] * (width - 1)], [1.0, 0.0])
    assert not still.passed
