"""Systems of many contacts by their Schur complement on the forces: as the whole systems, or these themselves."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.linalg import friction_states
from contactqp.linalg.condensation import condense
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.linalg.friction_states import StateSystem, slip_directions
from contactqp.model.coulomb import OPEN, SLIP_ON, STICK


def body(width: int, stiffness: np.ndarray | None = None) -> cq.ContactProblem:
    """Ten contacts with `width` tangents each on a full stiffness, and a tie."""
    random, m = np.random.default_rng(3), 10
    n = m * (1 + width) + 4
    B = random.standard_normal((n, n))
    K = B @ B.T + n * np.eye(n) if stiffness is None else stiffness
    unit = np.eye(n)
    tangent = unit[[i * (1 + width) + 1 + k for i in range(m) for k in range(width)]]
    tangent[0] = tangent[0] + 0.1 * unit[-1]
    return cq.ContactProblem(
        K, 100 * random.standard_normal(n), -unit[: m * (1 + width) : 1 + width], np.full(m, 0.01), tangent, 0.4,
        tie=unit[-2:-1] - unit[-1:], tie_value=[0.01],
    )  # fmt: skip


def system(problem: cq.ContactProblem, independent: bool = False) -> StateSystem:
    """The system of open, sticking and slipping contacts, whose slips turn in space."""
    condensation = condense(problem)
    rows, random = condensed_frictional_rows(problem, condensation), np.random.default_rng(4)
    status = np.array([OPEN, STICK, SLIP_ON, SLIP_ON, STICK] * 2, dtype=np.int8)
    slip, push = random.standard_normal(10 * rows.width), random.uniform(1.0, 2.0, 10)
    directions, turning = slip_directions(rows, status, slip, push)
    return StateSystem(condensation, rows, status, directions, turning, independent)


@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize("transposed", [False, True])
def test_corrections_are_those_of_the_whole_system(
    width: int, transposed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, random = body(width), np.random.default_rng(5)
    residuals = [random.standard_normal(size) for size in (problem.dimension, 10, 10 * width, 1)]
    whole = system(problem)
    monkeypatch.setattr(friction_states, "REDUCED", 0)
    reduced = system(problem)
    assert whole._reduced is None
    assert reduced._reduced is not None
    assert reduced.regular
    one, other = (each.correct(*residuals, transposed=transposed) for each in (whole, reduced))
    for mine, theirs in zip(vars(one).values(), vars(other).values(), strict=True):
        assert np.any(mine)
        np.testing.assert_allclose(theirs, mine, rtol=1e-11, atol=1e-12 * abs(mine).max())


@pytest.mark.parametrize("spoiled", ["a contact stated twice", "a soft body"])
def test_where_digits_would_be_lost_the_whole_system_is_factorised(
    spoiled: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(friction_states, "REDUCED", 0)
    problem = body(2)
    if spoiled == "a soft body":
        motion = np.ones(problem.dimension) / np.sqrt(problem.dimension)
        bent = np.eye(problem.dimension) - (1 - 1e-10) * np.outer(motion, motion)
        problem = body(2, bent)
    else:
        normal = problem.normal.toarray()
        normal[2] = normal[3]
        problem = problem.replace(normal=normal)
    made = system(problem, independent=True)
    assert made._reduced is None
    assert made.redundant == (spoiled == "a contact stated twice")


@pytest.mark.parametrize("width", [1, 2])
def test_answers_are_the_same_to_the_last_digits(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = body(width)
    whole = cq.solve(problem)
    monkeypatch.setattr(friction_states, "REDUCED", 0)
    reduced = cq.solve(body(width))
    assert whole.certificate.passed
    assert reduced.certificate.passed
    assert np.any(whole.friction_force)
    for name in ("displacement", "normal_force", "friction_force", "tie_force"):
        mine, theirs = getattr(whole, name), getattr(reduced, name)
        np.testing.assert_allclose(theirs, mine, rtol=1e-15, atol=1e-25 * abs(mine).max())
