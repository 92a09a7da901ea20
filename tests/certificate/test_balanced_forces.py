"""Bounds with friction of bodies, and of nodes without stiffness, that contacts alone hold."""

from functools import partial
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate import force_norms
from tests.certificate.test_frictional_bounds import KLARBRING, bounds_hold, chain, floating_problem


@pytest.mark.parametrize("problems", [8, pytest.param(150, marks=pytest.mark.slow)])
def test_no_bound_is_below_the_distance_to_the_exact_answer_of_bodies_that_contacts_alone_hold(problems: int) -> None:
    claimed = bounds_hold(floating_problem, np.random.default_rng(22), problems)
    assert claimed["local"] >= 2 * problems // 3, claimed
    assert claimed["global"] >= problems // 4, claimed


def guided_problem(rng: np.random.Generator) -> cq.ContactProblem:
    """Nodes without stiffness and a chain that contacts alone hold, moved sideways against springs."""
    chained, beside, bare, m = (int(rng.integers(a, b)) for a, b in ((2, 4), (1, 3), (0, 2), (1, 4)))
    n, stiff = chained + beside + bare, chained + beside
    K, shape = np.zeros((n, n), dtype=int), rng.integers(-2, 3, (beside, beside))
    K[:chained, :chained] = chain(rng, chained)
    K[chained:stiff, chained:stiff] = shape @ shape.T + np.diag(rng.integers(1, 4, beside))
    brace = np.zeros(n, dtype=int)
    brace[[0, 1, chained]] = 1, -1, rng.integers(-1, 2)
    held, down = [*range(chained), *range(stiff, n)], np.zeros((m, n))
    along = np.zeros((m, n))
    for i in range(m):
        down[i, rng.choice(held) if i else rng.integers(chained)] = -1.0
        along[i, chained + rng.integers(beside)] = 1.0
        if rng.random() < 0.3:  # a slope, felt by what contacts hold
            along[i, rng.choice(held)] = rng.integers(-1, 2)
    load = rng.integers(-9, 10, n)
    load[held] -= rng.integers(0, 10)
    return cq.ContactProblem(
        K + np.outer(brace, brace), load, down, rng.integers(-2, 3, m) / 4, tangent=along,
        friction=rng.choice([0.125, 0.25, 0.5, 1.0, 2.0], m), slip_origin=rng.integers(-2, 3, (m, 1)) / 4,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("problems", [5, 150])
def test_bodies_that_contacts_alone_hold_have_one_answer_where_balance_closes_contacts(problems: int) -> None:
    claimed = bounds_hold(guided_problem, np.random.default_rng(27), problems)
    assert min(claimed.values()) >= problems // 3, claimed


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", ["two_masses", "two_masses_penalty", "wedge", "jenkins_loop", "sliding_block_stops"])
def test_nodes_without_stiffness_that_contacts_hold_are_proven(name: str) -> None:
    """Masses on a floor, of Example 2.19 among others: the floor carries their weight in every answer."""
    problem = cq.load_scene(name).problem()
    solution = cq.solve(problem)
    found = cq.certify(problem, solution)
    assert (found.proven, found.scope) == (True, "global")
    assert found.force_bound.max() <= 1e-12 * abs(solution.normal_force).max()
    wrong = cq.certify(problem, solution.displacement, solution.normal_force * (1 + 1e-5), solution.friction_force)
    assert not wrong.passed


def _scopes(problem: cq.ContactProblem, answers: Any) -> list[Any]:
    return [cq.certify(problem, one.displacement, one.normal_force, one.friction_force).scope for one in answers]


@pytest.mark.slow
def test_several_answers_beside_a_massless_node_are_proven_nearby_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Klarbring's block, and a massless node that its load presses on the floor, moved sideways against a spring."""
    K, none = np.zeros((4, 4)), [0.0, 0.0]
    K[:2, :2], K[3, 3] = KLARBRING["stiffness"], 1.0
    problem = cq.ContactProblem(
        K, [-1.0, 0.65, -2.0, 0.5], [[-1.0, 0, 0, 0], [*none, -1.0, 0]], none,
        tangent=[[0, 1.0, 0, 0], [*none, 0, 1.0]], friction=0.8,
    )  # fmt: skip
    answers = cq.equilibria(problem)
    assert len(answers) == 3
    scopes = partial(_scopes, problem, answers)
    assert scopes() == ["local"] * 3
    monkeypatch.setattr(force_norms, "coupling", lambda *_: 0.0)
    assert scopes() == ["global"] * 3  # a false claim, which the comparison with all equilibria above refuses
