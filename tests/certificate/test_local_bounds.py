"""Bounds on the forces of local problems hold against exact rational forces, in any contact's own units."""

from __future__ import annotations

from decimal import Decimal, localcontext
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.certificate import frictional_bounds
from contactqp.linalg.exact_algebra import dot, inverse_of

OPEN, STICK, SLIP_ON, SLIP_BACK = range(4)


def all_forces(W: Any, q: Any, mu: Any) -> list[list[Fraction]] | None:
    """The forces of all equilibria in the plane, from every combination of states; None where one is singular."""
    W = [[Fraction(int(x)) for x in row] for row in W]
    q, mu = [Fraction(int(x)) for x in q], [Fraction(x) for x in mu]
    found: list[list[Fraction]] = []
    for states in product(range(4), repeat=len(mu)):
        rows, right = [], []
        for i, state in enumerate(states):
            normal, tangent = 2 * i, 2 * i + 1
            own = [[Fraction(int(j == k)) for j in range(len(q))] for k in (normal, tangent)]
            sign = {SLIP_ON: 1, SLIP_BACK: -1}.get(state, 0)
            rows += [own[0] if state == OPEN else W[normal]]
            rows += [W[tangent] if state == STICK else [t + sign * mu[i] * n for n, t in zip(*own, strict=True)]]
            right += [Fraction() if state == OPEN else -q[normal], -q[tangent] if state == STICK else Fraction()]
        if (inverse := inverse_of(rows)) is None:
            return None
        r = [dot(row, right) for row in inverse]
        u = [sum((w * x for w, x in zip(row, r, strict=True)), Fraction()) + y for row, y in zip(W, q, strict=True)]
        if all(_holds(state, r[2 * i :], u[2 * i :], mu[i]) for i, state in enumerate(states)) and r not in found:
            found.append(r)
    return found


def _holds(state: int, r: Any, u: Any, mu: Fraction) -> bool:
    if state == OPEN:
        return bool(u[0] >= 0)
    if state == STICK:
        return bool(r[0] >= 0 and abs(r[1]) <= mu * r[0])
    return bool(r[0] >= 0 and u[1] * (1 if state == SLIP_ON else -1) >= 0)


def norm(W: Any, r: Any) -> float:
    response = [sum((int(w) * x for w, x in zip(row, r, strict=True)), Fraction()) for row in W]
    return float(sum((a * b for a, b in zip(r, response, strict=True)), Fraction())) ** 0.5


def drawn(rng: np.random.Generator, skew: bool = False) -> tuple[Any, Any, Any]:
    m = int(rng.choice([1, 2, 2, 3]))
    shape = rng.integers(-3, 4, (2 * m, 2 * m))
    W = shape @ shape.T
    if skew:
        turn = np.triu(rng.integers(-2, 3, W.shape), 1)
        W = 4 * (W + np.eye(2 * m, dtype=int)) + turn - turn.T
    return W, rng.integers(-6, 7, 2 * m), rng.choice([0.0, 0.25, 1.0, 4.0], m)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("problems", [15, pytest.param(110, marks=pytest.mark.slow)])
@pytest.mark.parametrize("skew", [False, True])
def test_no_bound_is_below_the_distance_to_exact_forces(skew: bool, problems: int) -> None:
    rng, claimed, several = np.random.default_rng(5), {"global": 0, "local": 0, None: 0}, 0
    for _ in range(problems):
        W, q, mu = drawn(rng, skew)
        exact = all_forces(W, q, mu) if np.all(np.diag(W) > 0) else None
        if not exact:
            continue
        several += len(exact) > 1
        own = np.repeat(2.0 ** rng.integers(-3, 4, len(mu)), 2)  # each contact in units of its own
        problem = cq.LocalProblem(W * np.outer(own, own), q * own, mu, 2)
        for right in exact:
            part = float(rng.choice([0.0, 1e-14, 1e-10, 1e-6]))
            given = np.array([float(x) for x in right]) / own * (1 + part * rng.normal(size=len(q)))
            found = cq.certify_local(problem, given, tolerance=1e-3)
            claimed[found.scope] += 1
            if not found.proven:
                assert len(found.reasons) == 1
                continue
            held = [Fraction(float(x)) * Fraction(float(s)) for x, s in zip(given, own, strict=True)]
            away = [norm(W, [a - b for a, b in zip(held, one, strict=True)]) for one in exact]
            nearest = int(np.argmin(away))
            size = norm(W, exact[nearest]) or 1.0
            assert found.force_error * size >= away[nearest] * (1 - 1e-6)
            assert found.force_error * size <= 1.1 * away[nearest] + 1e-13 * size
            off = [a - b for a, b in zip(held, exact[nearest], strict=True)]
            lengths = np.hypot(*np.array([float(x) for x in off]).reshape(-1, 2).T)
            assert np.all(found.force_bound * own[::2] >= lengths * (1 - 1e-6))
            assert found.scope == "local" or len(exact) == 1
            assert found.scope == "global" or sum(one < found.radius for one in away) == 1
    assert several >= 2 * (not skew) * (problems // 100)
    assert min(claimed["global"], claimed["local"]) >= 2 * problems // 11, claimed
    assert claimed[None] <= 0.3 * sum(claimed.values()), claimed


def test_a_bound_that_were_too_small_would_be_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    original = frictional_bounds.LocalBounds

    def smaller(error: float, bound: Any, *others: Any) -> Any:
        return original(0.9 * error, 0.9 * bound, *others)

    monkeypatch.setattr(frictional_bounds, "LocalBounds", smaller)
    with pytest.raises(AssertionError):
        test_no_bound_is_below_the_distance_to_exact_forces(False, 30)


def ball(rng: np.random.Generator, skew: bool = False) -> tuple[cq.LocalProblem, Any]:
    """A local problem in space, made around forces whose slips have rational lengths."""
    m = int(rng.integers(1, 5))
    shape = rng.integers(-2, 3, (3 * m, 3 * m))
    W = shape @ shape.T + np.diag(rng.integers(1, 12, 3 * m))
    turn = np.triu(rng.integers(-2, 3, W.shape), 1) * skew
    W = W + turn - turn.T
    mu, force, velocity = float(rng.choice([0.25, 4.0])), np.zeros((m, 3)), np.zeros((m, 3))
    for i in range(m):
        along = np.array([(3, 4), (-3, 4), (4, -3), (-4, -3)][rng.integers(4)]) / 5
        state, push = rng.choice(["open", "stick", "slip"]), float(rng.integers(1, 40))
        if state == "open":
            velocity[i] = float(rng.integers(1, 5)), *rng.integers(-3, 4, 2)
            continue
        part = 1.0 if state == "slip" else float(rng.integers(0, 8)) / 8
        force[i] = push, *(-part * mu * push * along)
        velocity[i, 1:] = float(rng.integers(1, 9)) * along * (state == "slip")
    return cq.LocalProblem(W, velocity.ravel() - W @ force.ravel(), mu, 3), force


@pytest.mark.slow
@pytest.mark.parametrize("skew", [False, True])
def test_in_space_bounds_hold_against_forces_that_problems_are_made_around(skew: bool) -> None:
    rng, claimed = np.random.default_rng(6), {"global": 0, "local": 0, None: 0}
    for _ in range(80):
        problem, right = ball(rng, skew)
        W = problem.delassus.toarray()
        size = float(np.sqrt(right.ravel() @ W @ right.ravel()))
        given = right * (1 + 1e-8 * rng.normal(size=right.shape))
        found = cq.certify_local(problem, given, tolerance=1e-4)
        claimed[found.scope] += 1
        if not found.proven or not size:
            continue
        apart = float(np.sqrt((given - right).ravel() @ W @ (given - right).ravel()))
        assert found.force_error * size >= apart * (1 - 1e-5)
        assert found.force_error * size <= 1.01 * apart + 1e-11 * size
        assert np.all(found.force_bound >= np.linalg.norm(given - right, axis=1) * (1 - 1e-5))
        assert found.scope == "global" or apart < found.radius
    assert claimed["global"] >= 20, claimed
    assert claimed["local"] >= 5, claimed


def slipping(W: Any, q: Any, mu: float, near: Any) -> Any:
    """The forces of one contact that slips in space, to 50 digits: Newton's method with differences of its law."""
    exact = np.vectorize(Decimal, otypes=[object])
    W, q, r, size = exact(W), exact(q), exact(near), Decimal("1e-25")

    def law(r: Any) -> Any:
        u = W @ r + q
        return np.array([u[0], *(r[1:] + Decimal(mu) * r[0] * u[1:] / (u[1] ** 2 + u[2] ** 2).sqrt())])

    for _ in range(6):
        slopes = [(law(r + size * unit) - law(r)) / size for unit in exact(np.eye(3))]
        r = r - exact(np.linalg.solve(np.array(slopes, dtype=float).T, law(r).astype(float)))
    assert max(abs(law(r))) < Decimal("1e-40")
    return r


@pytest.mark.parametrize("seed", [47, 113, 136])
def test_slips_that_turn_with_the_last_digits_of_forces_hide_no_unique_forces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape, q = rng.standard_normal((3, 6)), rng.standard_normal(3) - [2.0, 0.0, 0.0]
    problem = cq.LocalProblem(shape @ shape.T, q, 0.8, 3)
    given = cq.solve(problem).force
    found = cq.certify_local(problem, given)
    assert found.scope == "global", found.reasons
    with localcontext(prec=50):
        right = slipping(problem.delassus.toarray(), q, 0.8, given[0])
        apart = np.linalg.norm((np.vectorize(Decimal)(given[0]) - right).astype(float))
    assert apart <= found.force_bound[0] < 1e-14


def test_what_is_not_bounded_is_said() -> None:
    joined = cq.LocalProblem([[1.0, 0.0], [0.0, 1.0]], [-1.0, 0.0], 0.3, 2, bilateral=[[1.0], [0.0]])
    judged = cq.certify_local(joined, [0.0, 0.0], [1.0])
    assert judged.passed
    assert judged.reasons == ("force_error, force_bound: local problems with joints have none",)
    skew = cq.LocalProblem([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [-1.0, 2.0, 0.0], 3.0, 3)
    sticks = cq.certify_local(skew, cq.solve(skew).force)
    assert (sticks.proven, sticks.scope) == (True, "local")
    assert "delassus is not symmetric by 0.1" in str(sticks)
    refused = cq.certify_local(skew, [2.0, 0.0, 0.0])
    assert (refused.passed, refused.proven, refused.force_bound) == (False, False, None)
    none = cq.certify_local(cq.LocalProblem(np.zeros((0, 0)), [], 0.3, 2), [])
    assert (none.proven, none.scope, none.force_error) == (True, "global", 0.0)
    known = cq.certify_local(cq.LocalProblem(np.eye(2), [-1.0, 0.0], 0.3, 2), [1.0, 0.0])
    assert "proven: at most" in str(known)
    assert "from the only forces" in str(known)


def other_slips(W: Any, q: Any, mu: float, angle: float) -> list[Any]:
    """The forces of one contact that slips in another direction than `angle`, up to 0.6 from it, found by bisection."""

    def of(a: Any) -> tuple[Any, Any, Any]:
        """Forces whose gap velocity is zero, how far the slip turns from t, and whether it points along it."""
        t = np.array([np.cos(a), np.sin(a)])
        unit = np.array([np.ones_like(a), -mu * t[0], -mu * t[1]])
        push = -q[0] / (W[0] @ unit)
        slip = q[1:, None] + push * (W[1:] @ unit)
        return push * unit, t[0] * slip[1] - t[1] * slip[0], (push > 0) & (np.sum(t * slip, axis=0) > 0)

    tried = angle + np.linspace(-0.6, 0.6, 1200) + 1.3e-4
    _, turn, along = of(tried)
    found = []
    for i in np.flatnonzero((turn[:-1] * turn[1:] < 0) & along[:-1] & along[1:]):
        ends = tried[i : i + 2].copy()
        for _ in range(50):
            middle = ends.mean(keepdims=True)
            ends[0 if of(middle)[1][0] * of(ends[:1])[1][0] > 0 else 1] = middle[0]
        if abs(ends[0] - angle) > 1e-6:
            found.append(of(ends[:1])[0][:, 0])
    return found


@pytest.mark.parametrize("form", ["local", "skew", "bodies"])
@pytest.mark.parametrize("problems", [20, pytest.param(2000, marks=pytest.mark.slow)])
def test_no_other_slip_is_within_the_radius(form: str, problems: int) -> None:
    """In space, where friction beside the critical one has two answers near each other."""
    rng, local = np.random.default_rng(4), 0
    for _ in range(problems):
        shape, angle = rng.normal(size=(3, 3)), rng.uniform(0, 2 * np.pi)
        W = shape @ shape.T + 0.3 * np.eye(3)
        if form == "skew":
            turn = np.triu(rng.normal(size=(3, 3)), 1)
            W = W + turn - turn.T
        mu = float(rng.uniform(0.5, 3.0) * W[0, 0] / np.hypot(*W[0, 1:]))
        t = np.array([np.cos(angle), np.sin(angle)])
        right = np.r_[1.0, -mu * t]
        q = np.r_[0.0, rng.uniform(0.01, 2) * t] - W @ right
        others = other_slips(W, q, mu, angle)
        if not others:
            continue
        if form != "bodies":
            found = cq.certify_local(cq.LocalProblem(W, q, mu, 3), right)
        else:
            sign = np.array([1.0, -1.0, -1.0])
            K = np.linalg.inv(W * np.outer(sign, sign))
            problem = cq.ContactProblem(
                (K + K.T) / 2, np.zeros(3), np.eye(3)[:1], q[:1], tangent=np.eye(3)[1:], friction=mu, slip_origin=-q[1:]
            )
            found = cq.certify(problem, -np.linalg.solve(K, sign * right), [1.0], sign[1:] * right[1:])
        assert found.passed
        assert found.scope != "global"
        if found.scope == "local":
            local += 1
            apart = [float(np.sqrt((other - right) @ W @ (other - right))) for other in others]
            assert min(apart) > found.radius
    assert local >= max(1, problems // 50)


@pytest.mark.parametrize(
    ("contacts", "planted", "least"),
    [(60, 12, 6), pytest.param(300, 4, 2, marks=pytest.mark.slow), pytest.param(500, 4, 0, marks=pytest.mark.slow)],
)
def test_a_force_that_is_a_thousandth_off_is_outside_of_every_bound_of_a_millionth(
    contacts: int, planted: int, least: int
) -> None:
    """Of up to a thousand forces one is wrong: it is refused, or what is proven is no less than what was planted."""
    rng, n = np.random.default_rng(12), 2 * contacts
    near = 0.3 * rng.random(n - 1)
    W = sp.diags([near, np.full(n, 2.0), near], [-1, 0, 1]).tocsr()
    problem = cq.LocalProblem(W, rng.normal(size=n) - np.tile([1.0, 0.0], contacts), 0.4, 2)
    force = cq.solve(problem).force
    right = cq.certify_local(problem, force)
    assert right.proven
    assert right.force_error < 1e-12
    bounded = 0
    for i, j in zip(rng.choice(np.flatnonzero(force[:, 0] > 0.1), planted), np.tile([0, 1], planted // 2), strict=True):
        wrong = force.copy()
        wrong[i, j] += 1e-3 * force[i, 0]
        assert not cq.certify_local(problem, wrong).passed
        loose = cq.certify_local(problem, wrong, tolerance=0.1)
        if loose.force_bound is not None:
            bounded += 1
            assert loose.force_bound[i] >= 1e-3 * force[i, 0] * (1 - 1e-9)
            assert loose.force_error > 1e-6
    assert bounded >= least  # a local statement reaches no answer so far off: it is refused
