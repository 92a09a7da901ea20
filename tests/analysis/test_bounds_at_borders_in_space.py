"""Rates at a border of two states in space are off by no more than their bounds, held against sixty digits."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis.derivatives import _linearised, read_direction
from contactqp.analysis.slip_law import SlipLaw
from tests.analysis.slips_in_space import Data, Reference, decimals, solved
from tests.analysis.test_derivatives_with_friction import at_borders_in_space
from tests.analysis.test_slips_in_space import part_of

OF = ("displacement", "normal_force", "friction_force", "gap", "slip")


def size_of(vector: np.ndarray) -> Any:
    return (vector @ vector).sqrt()


class AtBorder(Reference):
    """The answer of a problem, its grazing contacts open, and rates in the states that they go to."""

    def __init__(self, problem: cq.ContactProblem, solution: cq.Solution) -> None:
        self.kinds = list(solution.contact_status)
        self.slid = [bool(np.any(slip)) for slip in solution.slip]
        super().__init__(problem, solution)

    def _find(self, x: np.ndarray) -> None:
        self.status = ["open" if one == "grazing" else one for one in self.kinds]
        super()._find(x)

    def rates(self, parameter: str, direction: Any, start: Any = None, status: Any = None) -> dict[str, np.ndarray]:
        """Return the rates in states -1 ... 2 (m,), from rates in doubles, which say how slips begin."""
        return self._in_digits(lambda: self._rates(self.data.along(parameter, direction), start, status))

    def _rates(self, d: Data, start: Any, status: Any) -> dict[str, np.ndarray]:
        parts = start.displacement, start.normal_force, start.friction_force, start.tie_force
        y = np.concatenate([decimals(part).ravel() for part in parts])
        step = y
        while max(abs(s) for s in step) > Decimal(10) ** -40 * max(abs(x) for x in y):
            missed, jacobian = self._missed_by(y, d, status)
            step = solved(jacobian, -missed)
            y = y + step
        du, push, drag, _ = self._parts(y)
        gap, slip = d.gap - self.data.normal @ du, self.data.tangent @ du - d.slip_origin.ravel()
        return dict(displacement=du, normal_force=push, friction_force=drag.ravel(), gap=gap, slip=slip)

    def _missed_by(self, y: np.ndarray, d: Data, status: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return what rates leave of their equations, and how these change with them."""
        own, n, m = self.data, self.n, self.m
        _, now, drag_now, _ = self._parts(self.x)
        du, push, drag, tie = self._parts(y)
        missed = np.concatenate([
            own.stiffness @ du + own.normal.T @ push + own.tangent.T @ drag.ravel() + own.tie.T @ tie - d.load,
            push, drag.ravel(), own.tie @ du - d.tie_value,
        ])  # fmt: skip
        J = decimals(np.eye(len(y)))
        J[:n, :n], J[:n, n : n + m], J[:n, n + m : n + 3 * m] = own.stiffness, own.normal.T, own.tangent.T
        J[:n, n + 3 * m :], J[n + 3 * m :, :n], J[n + 3 * m :, n + 3 * m :] = own.tie.T, own.tie, decimals(0.0)
        eye = decimals(np.eye(2))
        for i, state in enumerate(status):
            rows, at = own.tangent[2 * i : 2 * i + 2], slice(n + m + 2 * i, n + m + 2 * i + 2)
            slip, mu, more = rows @ du - d.slip_origin[i], own.friction[i], d.friction[i]
            if state == 0:
                continue
            missed[n + i], J[n + i, n + i], J[n + i, :n] = own.normal[i] @ du - d.gap[i], Decimal(0), own.normal[i]
            if state == 2:
                missed[at], J[at, at], J[at, :n] = slip, 0 * eye, rows
                continue
            whole, size = self._slip(self.x, i)
            if self.kinds[i] == "stick":  # begins along its friction, across which it is still
                t = drag_now[i] / size_of(drag_now[i])
                across = np.array([-t[1], t[0]])
                missed[at] = [slip @ across, drag[i] @ t - mu * push[i] - more * now[i]]
                J[at, at] = np.array([0 * t, t])
                J[at, :n] = np.array([across @ rows, 0 * rows[0]])
                J[n + m + 2 * i + 1, n + i] = -mu
                continue
            if self.kinds[i] == "grazing" and not self.slid[i]:  # along its own rate, whose length does not matter
                t, turns = slip / size_of(slip), mu * push[i] / size_of(slip)
                missed[at] = drag[i] - mu * push[i] * t
                J[at, :n] = -turns * (eye - np.outer(t, t)) @ rows
            else:
                t = whole / size
                turns = mu * now[i] / size * (eye - np.outer(t, t))
                missed[at] = drag[i] - mu * push[i] * t - turns @ slip - more * now[i] * t
                J[at, :n] = -turns @ rows
            J[at, n + i] = -mu * t
        return missed, J


def parts_of_bounds(problem: cq.ContactProblem, rng: np.random.Generator) -> tuple[list[float], int]:
    """Return what parts of their bounds rates to either side are off by, and how many have none."""
    solution, found, without, m = cq.solve(problem), [], 0, problem.contacts
    reference, unit = AtBorder(problem, solution), np.max(abs(problem.load))
    along = dict(load=rng.standard_normal(problem.dimension) * unit, gap=rng.standard_normal(m),
                 slip_origin=rng.standard_normal((m, 2)), friction=rng.uniform(0.0, 1.0, m))  # fmt: skip
    for name, direction in along.items():
        sides = _linearised(solution).sides(read_direction(solution, solution.normal_force, name, direction))
        back = reference.rates(name, -direction, sides[0].reversed(), sides[0].status)
        exact = [{of: -value for of, value in back.items()}]
        exact.append(reference.rates(name, direction, sides[1], sides[1].status))
        for of in OF:
            rate = solution.derivative(of, name, direction)
            if rate.bound is None:
                without += 1
                continue
            for true, value in zip(exact, (rate.left, rate.right), strict=True):
                pairs = zip(decimals(value).ravel(), true[of], decimals(rate.bound).ravel(), strict=True)
                found += [part_of(abs(x - y), most) for x, y, most in pairs]
    return found, without


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 9])
def test_bounds_at_borders_in_space_hold_against_sixty_digits(first: int) -> None:
    worst, without = 0.0, 0
    for seed in range(first, first + 3):
        problem = at_borders_in_space(np.random.default_rng(seed))
        found, none = parts_of_bounds(problem, np.random.default_rng(seed))
        worst, without = max([worst, *found]), without + none
    assert 1e-3 < worst <= 1.0
    assert without == 0


def grazing_slipped() -> cq.ContactProblem:
    """A block on springs that has slipped by (3, 4)/8 and whose floor it leaves."""
    K = np.array([[4.0, 1.0, 1.0], [1.0, 5.0, 0.0], [1.0, 0.0, 6.0]])
    u = np.array([1.0, 2.0, 0.0])
    origin = [[1.0 - 3 / 8, 2.0 - 4 / 8]]
    return cq.ContactProblem(K, K @ u, [[0.0, 0.0, -1.0]], [0.0], np.eye(3)[:2], 0.25, origin)


@pytest.mark.parametrize("told", [True, False])
def test_a_bound_without_the_directions_of_slips_would_not_hold(told: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """What grazes and has slipped slips on along its slip, which the law of an open contact does not know."""
    if not told:
        monkeypatch.setattr(SlipLaw, "with_slips", lambda law, *_: law)
    problem = grazing_slipped()
    solution = cq.solve(problem)
    assert solution.contact_status.tolist() == ["grazing"]
    found, direction = solution.derivative("displacement", "load", [1.0, 0.0, -1.0]), [1.0, 0.0, -1.0]
    # Pressed by l with l (0, 0, -1) + l (0.15, 0.2, 0) on it: K du + E'l = df and du_3 = 0.
    K, push = np.asarray(problem.stiffness), np.array([0.15, 0.2, -1.0])
    exact = np.linalg.solve(np.block([[K, push[:, None]], [np.array([[0.0, 0.0, -1.0, 0.0]])]]), [*direction, 0.0])
    apart = abs(found.right - exact[:3])
    assert bool(np.all(apart <= found.bound + 1e-16)) == told
    assert np.max(found.bound) < 1e-12


def test_friction_that_is_at_its_bound_to_a_rounding_has_rates_without_a_bound() -> None:
    """0.3 is not a double: the answer sticks or slips by a rounding, and which of the two bounds would have to say."""
    floor = dict(normal=[[0.0, 0.0, -1.0]], gap=[0.0], tangent=np.eye(3)[:2], friction=0.3)
    answer = cq.solve(cq.ContactProblem(np.diag([2.0, 4.0, 5.0]), [1.8, 2.4, -10.0], **floor))
    found = answer.derivative("displacement", "load", [1.0, 1.0, 0.0])
    assert found.bound is None
    assert "beside the border" in found.bound_reason
    assert found.left == pytest.approx([0.0, 0.0, 0.0], abs=1e-15)
    assert found.right == pytest.approx([0.6 * 1.4 / 3.28, 0.8 * 1.4 / 3.28, 0.0])


def two_that_begin(seed: int, friction: float) -> cq.ContactProblem:
    """Two contacts of a body graze, which a third holds by a friction at which other answers are not excluded."""
    rng, m, n = np.random.default_rng(seed), 3, 9
    shape = rng.integers(-2, 3, (n, n))
    K, rows = (shape @ shape.T + 4 * np.eye(n)).astype(float), np.eye(n)[rng.permutation(n)]
    E, T, u = rows[:m] * rng.choice([-1.0, 1.0], m)[:, None], rows[m:], rng.integers(-4, 5, n) / 2
    load = K @ u + E.T @ [0.0, 0.0, 5.0] + T.T @ [0.0, 0.0, 0.0, 0.0, 1.0, 2.0]
    return cq.ContactProblem(K, load, E, E @ u, T, [friction, friction, 4.0], (T @ u).reshape(m, 2))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_two_contacts_that_begin_to_slip_have_rates_where_they_alone_have_one_answer(seed: int) -> None:
    problem, step = two_that_begin(seed, 0.125), 2.0**-20
    answer, direction = cq.solve(problem), np.random.default_rng(seed).standard_normal(9)
    assert answer.certificate.uniqueness
    found = answer.derivative("displacement", "load", direction)
    for sign, rate in ((-1, found.left), (1, found.right)):
        moved = cq.solve(problem.replace(load=problem.load + sign * step * direction), warm_start=answer)
        difference = (moved.displacement - answer.displacement) / (sign * step)
        assert rate == pytest.approx(difference, abs=1e-3 * max(1, np.max(abs(difference))))


def test_two_contacts_that_may_begin_to_slip_in_several_ways_have_none() -> None:
    answer = cq.solve(two_that_begin(0, 3.0))
    found = answer.derivative("displacement", "load", np.ones(9))
    assert found.right is None
    assert "other answers are not excluded" in found.reason
