"""Contact forces of a step with friction: by states they are what the law asks, and what friction's algorithms find."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis.motion import step_friction
from contactqp.analysis.motion.step_friction import frictional_forces, states_of
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK

ONE = np.array([[1.0, 0.5], [0.5, 2.0]])  # u_N, u_T of r_N, r_T


def still(m: int) -> np.ndarray:
    return np.full(m, OPEN, dtype=np.int8)


@pytest.mark.parametrize(
    ("free", "coefficient", "expected"),
    [
        ([1.0, 3.0], 0.5, (0.0, 0.0)),  # open
        ([-1.0, -0.5], 0.5, (1.0, 0.0)),  # r_N = 1 alone stops it
        ([-1.0, 2.0], 0.6, (1 / 0.7, 0.6 / 0.7)),  # slips on: u_N = r_N + r_T / 2 - 1 = 0, r_T = -0.6 r_N
        ([-1.0, -3.0], 0.5, (1 / 1.25, -0.5 / 1.25)),  # slips back
    ],
)
def test_one_contact_by_hand(
    free: list[float], coefficient: float, expected: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(step_friction, "solve", None)  # no local problem is needed
    normal, friction = frictional_forces(ONE, np.array(free), np.array([coefficient]), still(1), "active-set", {})
    np.testing.assert_allclose([normal[0], friction[0, 0]], expected, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("seed", range(40))
def test_states_find_what_the_algorithms_find(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m = 3
    root = rng.normal(size=(2 * m, 8))
    W, c = root @ root.T / 8 + np.eye(2 * m), rng.normal(size=2 * m)
    coefficient = rng.choice([0.0, 0.1, 0.3], size=m)
    start = rng.integers(SLIP_BACK, STICK + 1, size=m).astype(np.int8)
    normal, friction = frictional_forces(W, c, coefficient, start, "active-set", {})
    local = cq.LocalProblem(delassus=W, offset=c, friction=coefficient, dimension=2)
    known = cq.solve(local)
    np.testing.assert_allclose(np.column_stack([normal, -friction]), known.force, atol=1e-10)
    assert cq.certify_local(local, np.column_stack([normal, -friction])).passed


def test_states_that_cycle_are_left_to_an_algorithm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step_friction, "MAX_CHANGES", 0)
    normal, friction = frictional_forces(ONE, np.array([-1.0, 2.0]), np.array([0.6]), still(1), "active-set", {})
    np.testing.assert_allclose([normal[0], friction[0, 0]], [1 / 0.7, 0.6 / 0.7], rtol=1e-12)


def test_contacts_that_say_the_same_are_left_to_an_algorithm() -> None:
    W = np.kron(np.ones((2, 2)), ONE)
    normal, friction = frictional_forces(
        W, np.array([-1.0, 2.0, -1.0, 2.0]), np.array([0.6, 0.6]), still(2), "active-set", {}
    )
    np.testing.assert_allclose([normal.sum(), friction.sum()], [1 / 0.7, 0.6 / 0.7], rtol=1e-9)


def test_the_states_of_forces() -> None:
    found = states_of(
        np.array([0.0, 1, 1, 1, 1]), np.array([[0.0], [0.1], [0.5], [-0.5], [0.0]]), np.r_[0.5 * np.ones(4), 0]
    )
    assert found.tolist() == [OPEN, STICK, SLIP_ON, SLIP_BACK, SLIP_ON]
