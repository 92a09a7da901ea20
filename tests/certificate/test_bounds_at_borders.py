"""Contacts within rounding of another state: what is proven nearby holds against all equilibria, and some of it is."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate import frictional_bounds
from contactqp.certificate.force_norms import eliminated
from contactqp.linalg.delassus import ContactOperators
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK
from tests.certificate.test_frictional_bounds import distances, numbers, off
from tests.certificate.test_local_bounds import all_forces, norm

PLANE = ("touches at rest", "touches and slips", "sticks with all friction", "sticks", "slips", "open")


def drawn(rng: np.random.Generator, m: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Forces (l_N, l_T) (m, 2) and lengths (gap, slip) (m, 2) of contacts in the plane, and their coefficient."""
    mu, force, length = float(rng.choice([0.5, 1.0, 2.0, 4.0])), np.zeros((m, 2)), np.zeros((m, 2))
    for i in range(m):
        state, sign, push = rng.choice(PLANE), rng.choice([-1, 1]), 8 * int(rng.integers(1, 9))
        if state == "open":
            length[i] = rng.integers(1, 5), rng.integers(-3, 4)
        elif state == "touches and slips":
            length[i, 1] = sign * rng.integers(1, 4)
        elif state != "touches at rest":
            force[i] = push, sign * mu * push * (rng.integers(0, 4) / 4 if state == "sticks" else 1)
            length[i, 1] = sign * rng.integers(1, 4) * (state == "slips")
    return force, length, mu


def bodies(rng: np.random.Generator) -> tuple[cq.ContactProblem, Any]:
    """Bodies of whole numbers around an answer, and its parts u, l_N, l_T."""
    m = int(rng.integers(1, 4))
    n = 2 * m + int(rng.integers(0, 3))
    shape, rows = rng.integers(-3, 4, (n, n)), np.zeros((2 * m, n))
    rows[np.arange(2 * m), rng.permutation(n)[: 2 * m]] = 1.0
    rows[:, 0] += rng.integers(1, 3, 2 * m)
    K = shape @ shape.T + np.diag(rng.integers(1, 4, n))
    (force, length, mu), u = drawn(rng, m), rng.integers(-8, 9, n).astype(float)
    load = K @ u + rows[:m].T @ force[:, 0] + rows[m:].T @ force[:, 1]
    gap, origin = rows[:m] @ u + length[:, 0], rows[m:] @ u - length[:, 1]
    problem = cq.ContactProblem(K, load, rows[:m], gap, tangent=rows[m:], friction=mu, slip_origin=origin[:, None])
    return problem, (u, force[:, 0], force[:, 1])


@pytest.fixture
def at_borders(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether each proof at borders that was looked for was had."""
    asked, whole = list[bool](), frictional_bounds._at_borders

    def noted(*given: Any) -> Any:
        found = whole(*given)
        asked.append(found is not None)
        return found

    monkeypatch.setattr(frictional_bounds, "_at_borders", noted)
    return asked


@pytest.mark.parametrize("problems", [10, pytest.param(400, marks=pytest.mark.slow)])
def test_bounds_of_bodies_hold_against_all_exact_equilibria(problems: int, at_borders: list[bool]) -> None:
    rng = np.random.default_rng(1)
    for _ in range(problems):
        problem, parts = bodies(rng)
        known, K = cq.exact_equilibria(problem), np.asarray(problem.stiffness)
        if any(one.continuum for one in known):
            continue
        part = float(rng.choice([0.0, 1e-14, 1e-9, 1e-7]))
        u, normal, friction = (off(rng, x, part) for x in parts)
        found = cq.certify(problem, u, normal, friction, tolerance=1e-5, error_tolerance=1e-4)
        if not found.proven:
            continue
        truths = [numbers(one) for one in known]
        apart = [distances(problem, K, u, np.column_stack([normal, friction]), truth) for truth in truths]
        nearest, own = min(apart, key=lambda pair: pair[0])
        assert found.energy_error >= nearest * (1 - 1e-9)
        assert np.all(found.force_bound >= own * (1 - 1e-9))
        if found.scope == "local":
            sizes = [float(np.sqrt(max(v @ K @ v, 0.0))) or 1.0 for v in (np.array(t[0], dtype=float) for t in truths)]
            within = [one * size < found.radius for (one, _), size in zip(apart, sizes, strict=True)]
            assert sum(within) == 1
    assert sum(at_borders) >= problems // 10


@pytest.mark.slow
@pytest.mark.parametrize("problems", [12, pytest.param(300, marks=pytest.mark.slow)])
def test_bounds_of_local_problems_hold_against_all_exact_forces(problems: int, at_borders: list[bool]) -> None:
    rng = np.random.default_rng(2)
    for _ in range(problems):
        m = int(rng.integers(1, 4))
        shape, (force, length, mu) = rng.integers(-3, 4, (2 * m, 2 * m)), drawn(rng, m)
        W, right = shape @ shape.T + np.diag(rng.integers(1, 4, 2 * m)), force * [1, -1]
        q = length.ravel() - W @ right.ravel()
        exact = all_forces(W, q, np.full(m, mu))
        if exact is None:
            continue
        part = float(rng.choice([0.0, 1e-14, 1e-9]))
        given = right * (1 + part * rng.normal(size=right.shape))
        found = cq.certify_local(cq.LocalProblem(W, q, mu, 2), given, tolerance=1e-5)
        if not found.proven:
            continue
        off_by = [np.array([float(x) for x in one]).reshape(-1, 2) - given for one in exact]
        held = [Fraction(float(x)) for x in given.ravel()]
        away = [norm(W, [a - b for a, b in zip(held, one, strict=True)]) for one in exact]
        nearest = int(np.argmin(away))
        assert found.force_error * (norm(W, exact[nearest]) or 1.0) >= away[nearest] * (1 - 1e-6)
        assert np.all(found.force_bound >= np.linalg.norm(off_by[nearest], axis=1) * (1 - 1e-6))
        assert found.scope == "global" or sum(one < found.radius for one in away) == 1
    assert sum(at_borders) >= problems // 25


def test_in_space_contacts_at_borders_are_proven(at_borders: list[bool]) -> None:
    """One touches at rest, one slips, and one sticks with friction that kappa of all three is not below 1 for."""
    rng, scopes = np.random.default_rng(3), []
    for mu in (0.5, 3.0):
        shape, friction = rng.normal(size=(9, 9)), np.array([mu, mu, 3.0])
        W = np.eye(9) + 0.02 * shape @ shape.T
        right = np.array([[0.0, 0.0, 0.0], [1.0, -0.8 * mu, -0.6 * mu], [1.0, 0.5, 0.5]])
        length = np.array([[0.0, 0.0, 0.0], [0.0, 0.8, 0.6], [0.0, 0.0, 0.0]])
        found = cq.certify_local(cq.LocalProblem(W, length.ravel() - W @ right.ravel(), friction, 3), right)
        assert found.passed
        scopes.append(found.scope)
    assert (scopes, at_borders) == (["local", None], [True, False])


@pytest.mark.parametrize("d", [2, 3])
def test_what_is_eliminated_keeps_its_state(d: int) -> None:
    """Of forces on the remaining contacts, those that stick move nowhere, and what slips is dragged by what presses."""
    rng = np.random.default_rng(d)
    shape = rng.normal(size=(4 * d, 4 * d))
    W, none = shape @ shape.T + np.eye(4 * d), np.zeros((4 * d, 0))
    operators = ContactOperators(W, none, none[:0], np.ones(4), 0, W.diagonal())
    status = np.array([STICK, OPEN, SLIP_BACK if d == 2 else STICK, SLIP_ON], dtype=np.int8)
    law = np.array([False, False, False, True])
    mu = np.full(4, 0.3)
    found = eliminated(operators, status, mu, law)
    assert found is not None
    force = found.whole @ (drawn_force := rng.normal(size=d))
    moved = (operators.W @ force).reshape(4, d)
    assert np.allclose(force.reshape(4, d)[3], drawn_force)
    assert np.allclose(moved[3], found.W @ drawn_force)
    assert np.allclose(moved[0], 0.0, atol=1e-12)
    assert np.allclose(force.reshape(4, d)[1], 0.0)
    if d == 2:
        assert moved[2, 0] == pytest.approx(0.0, abs=1e-12)
        assert force[5] == pytest.approx(-0.3 * force[4])
        assert abs(moved[2, 1]) > 1e-3
    assert drawn_force @ found.energy @ drawn_force == pytest.approx(force @ operators.W @ force)
