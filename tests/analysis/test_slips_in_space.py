"""Rates of slips that turn are off by no more than their bounds, held against sixty digits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis.derivatives import QUANTITIES
from contactqp.analysis.friction_sharing import states_hold
from contactqp.analysis.rate_systems import RateSystem
from contactqp.analysis.rates import Linearised
from contactqp.analysis.slip_law import SlipLaw
from contactqp.linalg.extended import Extended
from contactqp.model.coulomb import SLIP_ON, STICK
from tests.analysis.slips_in_space import Reference, decimals


def drawn(rng: np.random.Generator, spread: float = 0.0) -> cq.ContactProblem:
    """Draw contacts of points, pressed and pulled along any plane, stiffness and units apart by exp(2 spread)."""
    m = int(rng.integers(1, 3))
    n, shape = 3 * m + 1, rng.integers(-3, 4, (3 * m + 1, 3 * m + 1)) / 3
    scale = np.exp(rng.uniform(-spread, spread, n))
    K = scale[:, None] * (shape @ shape.T + np.diag(rng.integers(1, 5, n) / 3)) * scale
    normal, tangent = np.zeros((m, n)), np.zeros((2 * m, n))
    for i in range(m):
        axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        normal[i, 3 * i : 3 * i + 3], tangent[2 * i : 2 * i + 2, 3 * i : 3 * i + 3] = axes[0], axes[1:]
    load = normal.T @ (3 + 3 * rng.random(m)) + tangent.T @ rng.standard_normal(2 * m) * 2
    return cq.ContactProblem(
        (K + K.T) / 2, load, normal, rng.random(m) / 5, tangent=tangent, friction=rng.uniform(0.05, 0.4, m),
        slip_origin=rng.standard_normal((m, 2)) / 1000, tie=rng.integers(-2, 3, (1, n)) / 3 + np.eye(n)[-1:],
        tie_value=[0.05],
    )  # fmt: skip


def directions(rng: np.random.Generator, problem: cq.ContactProblem) -> dict[str, Any]:
    n, m = problem.dimension, problem.contacts
    turn = rng.integers(-2, 3, (n, n)) / 3
    return dict(
        load=rng.standard_normal(n), gap=rng.standard_normal(m), tie_value=np.ones(problem.ties),
        friction=rng.random(m), slip_origin=rng.standard_normal((m, 2)), stiffness=turn + turn.T,
        rows=problem.normal.toarray() * rng.standard_normal((m, n)),
    )  # fmt: skip


def parts(
    problem: cq.ContactProblem, rng: np.random.Generator, quantities: tuple[str, ...] = QUANTITIES
) -> list[float]:
    """Return what parts of their bounds rates of one answer, and products of gradients with directions, are off by."""
    solution = cq.solve(problem)
    reference, found = Reference(problem, solution), []
    for parameter, direction in directions(rng, problem).items():
        true = reference.rates(parameter, direction)
        for of in quantities:
            rate = solution.derivative(of, parameter, direction)
            if rate.bound is None:
                return []
            exact, value, bound = (np.ravel(one) for one in (true[of], decimals(rate.value), decimals(rate.bound)))
            found += [part_of(abs(x - y), most) for x, y, most in zip(value, exact, bound, strict=True)]
            weights = rng.standard_normal(np.shape(rate.value))
            pair = solution.pullback(of, weights, parameter, return_bound=True)
            gradient, apart, along = (decimals(one).ravel() for one in (*pair, direction))
            product = decimals(weights).ravel() @ exact
            found.append(part_of(abs(gradient @ along - product), apart @ abs(along)))
    return found


def part_of(error: Any, bound: Any) -> float:
    """Return an error as a part of its bound; where that is zero the error must be."""
    return float(error / bound) if bound else np.inf if error else 0.0


@pytest.mark.slow
@pytest.mark.parametrize("spread", [0.0, 3.0])
def test_bounds_hold_against_sixty_digits_and_those_of_a_tenth_would_not(spread: float) -> None:
    of_all = [parts(drawn(np.random.default_rng(seed), spread), np.random.default_rng(seed)) for seed in range(12)]
    whole = [part for found in of_all for part in found]
    assert sum(bool(found) for found in of_all) >= 8
    assert 0.1 < max(whole) <= 1.0


def test_a_slip_in_space_has_the_rates_of_the_closed_form() -> None:
    """A block on springs that slips by s = (f - mu N f/|f|)/k takes mu N f/|f|, which turns with f."""
    problem = cq.ContactProblem(
        np.diag([2.0, 2.0, 5.0]), [6.0, 8.0, -10.0], [[0.0, 0.0, -1.0]], [0.0], np.eye(3)[:2], 0.25
    )
    solution = cq.solve(problem)
    for direction, friction in (([1.0, 0.0, 0.0], [0.16, -0.12]), ([0.0, 0.0, -1.0], [0.15, 0.2])):
        rate = solution.derivative("friction_force", "load", direction)
        assert abs(rate.value - [friction]) == pytest.approx(0.0, abs=1e-15)
        assert np.all(abs(rate.value - [friction]) <= rate.bound + 2.0**-54)  # the closed forms are no doubles
        assert np.all(rate.bound <= 1e-15)


def near_its_origin() -> cq.ContactProblem:
    """A contact that has moved by 1e6 and slipped by 1e-3, of which doubles keep six digits."""
    origin = np.array([[1e6, 2e6]]) / 3
    return cq.ContactProblem(
        np.diag([2.0, 2.0, 5.0]), [*(2 * origin[0] + [1.002, 0.7]), -10.0], [[0.0, 0.0, -1.0]], [0.0],
        np.eye(3)[:2], 0.12, slip_origin=origin,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("refined", [True, False])
def test_directions_that_doubles_hardly_tell_are_refined(refined: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the answer beyond doubles the direction of the slip is off, and more than bounds say."""
    if not refined:
        monkeypatch.setattr(RateSystem, "_newton", RateSystem.solve)
    found = parts(near_its_origin(), np.random.default_rng(1), ("friction_force",))
    assert found
    assert (max(found) <= 1.0) == refined


def far_moved(rng: np.random.Generator) -> cq.ContactProblem:
    """A problem around an answer that moves far and slips little, in any units, as directions of few digits tell."""
    m, more, tied = (int(rng.integers(*ends)) for ends in ((1, 4), (0, 3), (0, 2)))
    n, normal, tangent = 3 * m + more, np.zeros((m, 3 * m + more)), np.zeros((2 * m, 3 * m + more))
    shape = rng.standard_normal((n, n))
    K = shape @ shape.T + np.diag(rng.uniform(0.5, 2, n))
    rng.uniform(size=n)
    for i in range(m):
        axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        normal[i, 3 * i : 3 * i + 3], tangent[2 * i : 2 * i + 2, 3 * i : 3 * i + 3] = axes[0], axes[1:]
    u = rng.standard_normal(n) * 10.0 ** rng.uniform(-2, 4)
    push, mu = rng.uniform(0.5, 3, m) * (rng.random(m) < 0.85), rng.uniform(0.05, 0.4, m)
    drag, origin = np.zeros((m, 2)), (tangent @ u).reshape(m, 2)
    for i in range(m):
        angle = rng.uniform(0, 6.28)
        along = np.array([np.cos(angle), np.sin(angle)])
        if rng.random() < 0.25:
            drag[i] = rng.uniform(0, 0.9) * mu[i] * push[i] * along
        else:
            drag[i] = mu[i] * push[i] * along
            origin[i] -= along * 10.0 ** rng.uniform(-10, 0) * np.max(abs(u))
    gap = normal @ u + (push == 0) * 0.3 * np.max(abs(u))
    rng.choice(3, 2)
    force, length = 10.0 ** rng.choice([-9, -3, 0, 3, 9], 2)
    load = K @ u + normal.T @ push + tangent.T @ drag.ravel()
    tie = dict(tie=np.eye(n)[-1:], tie_value=[u[-1] * length]) if tied else {}
    return cq.ContactProblem(
        (K + K.T) / 2 * force / length, load * force, normal, gap * length, tangent=tangent, friction=mu,
        slip_origin=origin * length, **tie,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [26, 3, 9, 19, 23, 24, 25])
def test_bounds_of_bodies_that_have_moved_far_hold(seed: int) -> None:
    """Of seed 26 the reaction was formed with a friction that doubles rounded, twice as far off as its bound."""
    found = parts(far_moved(np.random.default_rng(seed)), np.random.default_rng(seed), ("reaction", "displacement"))
    assert not found or max(found) <= 1.0
    assert found or seed != 26


@pytest.mark.parametrize("off", ["off", "off_turns"])
def test_what_the_law_is_off_by_belongs_to_the_bound(off: str, monkeypatch: pytest.MonkeyPatch) -> None:
    solution = cq.solve(drawn(np.random.default_rng(3)))
    direction = np.ones(solution.problem.dimension)
    small = solution.derivative("friction_force", "load", direction).bound
    at = SlipLaw.at.__func__

    def worse(cls: type[SlipLaw], *arguments: Any) -> SlipLaw:
        law = at(cls, *arguments)
        return SlipLaw(**(vars(law) | {off: vars(law)[off] + 1e-6}))

    monkeypatch.setattr(SlipLaw, "at", classmethod(worse))
    large = cq.solve(solution.problem).derivative("friction_force", "load", direction).bound
    assert np.max(large) > 1e-8 > np.max(small)


@pytest.mark.parametrize(("slip", "push"), [(0.0, 0.0), (1e-3, 0.0), (0.0, 1e-3)])
def test_a_law_that_is_not_told_has_no_bound(slip: float, push: float) -> None:
    law = SlipLaw.at(
        np.array([0.5]), np.array([SLIP_ON], dtype=np.int8), Extended([3e-3, 4e-3]), Extended([7e-3]), np.array([slip]),
        np.array([push]),
    )  # fmt: skip
    assert law.is_known == (slip == push == 0.0)
    assert law.directions.double() == pytest.approx([0.6, 0.8], abs=1e-16)
    assert law.turns.double() == pytest.approx([0.7], rel=1e-15)


def in_an_edge() -> cq.ContactProblem:
    """Return two nodes of which one slips along two walls at once, so that other answers are not excluded."""
    stiffness = [
        [21.0, -9.0, -7.0, 4.0, 4.0, 4.0], [-9.0, 15.0, 9.0, -5.0, -5.0, -4.0], [-7.0, 9.0, 14.0, -8.0, 0.0, -7.0],
        [4.0, -5.0, -8.0, 21.0, -5.0, 4.0], [4.0, -5.0, 0.0, -5.0, 15.0, -4.0], [4.0, -4.0, -7.0, 4.0, -4.0, 17.0],
    ]  # fmt: skip
    x, y, z, a, b, c = np.eye(6)
    return cq.ContactProblem(
        stiffness, [-18.25, 8.75, 13.25, -25.45, 20.1, -25.05], [x, b, -c], [-0.25, 0.5, 1.0], [y, z, c, a, a, b],
        [0.125, 0.125, 0.25], slip_origin=[[0.0, -0.5], [-1.15, -1.2], [-1.3, 0.1]],
    )  # fmt: skip


@pytest.mark.slow
def test_an_answer_that_is_not_the_only_one_is_proven_for_its_rates_by_its_states() -> None:
    problem = in_an_edge()
    answer = cq.solve(problem)
    assert answer.contact_status.tolist() == ["open", "slip", "slip"]
    assert not cq.certify(problem, **vars_of(answer)).proven
    found = parts(problem, np.random.default_rng(1), ("displacement", "friction_force"))
    assert 0.1 < max(found) <= 1.0


def vars_of(answer: cq.Solution) -> dict[str, Any]:
    return {name: getattr(answer, name) for name in ("displacement", "normal_force", "friction_force")}


@pytest.mark.parametrize("of", ["normal", "displacement", "tangent"])
def test_states_hold_only_beyond_what_the_answer_may_be_off_by(of: str) -> None:
    """Of what sticks friction is beneath its bound, of what slips the slip is there; both push."""
    held = cq.ContactProblem(
        np.diag([2.0, 2.0, 5.0]), [0.6, 0.8, -10.0], [[0.0, 0.0, -1.0]], [0.0], np.eye(3)[:2], 0.25
    )
    answer = cq.solve(held if of == "tangent" else in_an_edge())
    linearised = Linearised(answer)
    known, contacts = linearised.extended_answer, np.arange(answer.problem.contacts)
    assert known is not None
    assert known.bound is not None
    assert (linearised.status == STICK).any() == (of == "tangent")

    def holds(factor: float) -> bool:
        size = factor * np.abs(getattr(known.found, of))
        far = replace(known, bound=replace(known.bound, **{of: size}))
        slip = answer.slip
        assert slip is not None
        return states_hold(linearised.problem, linearised.status, far, slip, contacts)

    assert holds(1e-12)
    assert not holds(10.0)
