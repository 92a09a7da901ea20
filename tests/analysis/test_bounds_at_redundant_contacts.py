"""Where contacts share forces, rates of what is unique are off by no more than their bounds, against Fractions."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis import derivatives, gradients
from contactqp.analysis.rate_systems import RateSystem
from contactqp.analysis.shared_forces import Sharing

UNIQUE = ("displacement", "gap", "reaction", "energy")


def drawn(rng: np.random.Generator) -> cq.ContactProblem:
    """A problem around an answer whose rows are combinations of a few, all numbers that doubles hold exactly."""
    n, r = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    shape, few = rng.integers(-3, 4, (n, n)), rng.integers(-2, 3, (r, n)).astype(float)
    few[~few.any(axis=1), 0] = 1.0
    more = rng.integers(-1, 3, (int(rng.integers(1, 3)), r)).astype(float)
    more[~more.any(axis=1), 0] = 1.0
    rows = np.vstack([few, more @ few])
    rows = rows[rows.any(axis=1)]
    K, m = shape @ shape.T + np.diag(rng.integers(1, 6, n)), len(rows)
    u, push = rng.integers(-4, 5, n) / 4, rng.integers(0, 5, m) * (rng.random(m) < 0.7)
    return cq.ContactProblem(K, K @ u + rows.T @ push, rows, rows @ u + 0.5 * (push == 0) * (rng.random(m) < 0.4))


def directions(rng: np.random.Generator, problem: cq.ContactProblem) -> dict[str, Any]:
    n, m, turn = problem.dimension, problem.contacts, rng.integers(-2, 3, (problem.dimension,) * 2)
    rows = (problem.normal.toarray() != 0) * rng.integers(-2, 3, (m, n)) / 3
    together = problem.normal @ rng.integers(-2, 3, n).astype(float)  # along which no contact opens
    found = dict(load=rng.integers(-3, 4, n) / 3, stiffness=(turn + turn.T) / 3, rows=rows)
    return {"gap": rng.integers(-3, 4, m) / 3, "gap ": together} | found


def sides(found: Any, true: Any) -> list[tuple[Fraction, Fraction]]:
    """Return the errors of both sides, and what they may be."""
    pairs = []
    for one, other in ((found.left, true.left), (found.right, true.right)):
        assert (one is None) == (other is None)
        if one is None:
            continue
        for x, y, bound in zip(np.ravel(one), np.ravel(other), np.ravel(found.bound), strict=True):
            pairs.append((abs(Fraction(float(x)) - Fraction(y)), Fraction(float(bound))))
    return pairs


@pytest.mark.slow
def test_bounds_hold_against_fractions_and_those_of_a_tenth_would_not() -> None:
    rng, counts, parts = np.random.default_rng(12), Counter[str](), []
    for _ in range(20):
        problem = drawn(rng)
        solution, answer = cq.solve(problem), cq.exact(problem, enclose=False)
        for name, direction in directions(rng, problem).items():
            for of in UNIQUE:
                found, true = (one.derivative(of, name.strip(), direction) for one in (solution, answer))
                assert (found.right is None) == (true.right is None)
                if found.bound is None:
                    assert found.reason or found.bound_reason
                    counts[f"{name} none"] += found.right is not None
                    continue
                counts[name] += 1
                for error, bound in sides(found, true):
                    assert error <= bound, (name, of)
                    parts += [error / bound] if bound else []
    assert max(parts) > Fraction(1, 10)
    for name in ("load", "gap", "gap ", "stiffness"):
        assert counts[f"{name} none"] <= counts[name] / 4


@pytest.mark.slow
@pytest.mark.parametrize("rough", [False, True])
def test_ties_that_repeat_leave_the_bounds_of_what_is_unique(rough: bool) -> None:
    """Twice a tie, with twice its value, whose force is shared: all else is as without it, and against Fractions."""
    K, direction = np.diag([2.0, 3.0, 4.0]) + 1, np.array([1.0, -2.0, 3.0]) / 3
    rows = dict(normal=[[0.0, 0.0, 1.0]], gap=[0.5], tangent=[[1.0, 0.0, 0.0]], friction=0.1 if rough else 0.0)
    tie = np.array([[1.0, 1.0, 0.0]])
    few = cq.ContactProblem(K, [9.0, 5.0, 4.0], **rows, tie=tie, tie_value=[0.1])
    twice = cq.solve(few.replace(tie=np.vstack([tie, 2 * tie, np.eye(3)[:0]]), tie_value=[0.1, 0.2]))
    along = dict(
        load=direction, gap=[1 / 3], stiffness=np.eye(3), rows=[[0.0, 0.0, 1 / 3]], tie_value=[1 / 3, 2 * (1 / 3)]
    )
    for parameter, change in along.items():
        for of in (*UNIQUE, "normal_force"):
            found = twice.derivative(of, parameter, change)
            once = cq.exact(few).derivative(of, parameter, change[:1] if parameter == "tie_value" else change)
            assert found.value is not None
            assert all(error <= bound for error, bound in sides(found, once)), (of, parameter)
            if parameter != "tie_value":
                weights = np.ones(np.shape(found.value))
                gradient, bound = twice.pullback(of, weights, parameter, return_bound=True)
                assert np.sum(gradient * np.asarray(change)) == pytest.approx(np.sum(found.value), abs=1e-13)
                assert bound is not None
    assert twice.derivative("tie_force", "load", direction).reason == derivatives.REDUNDANT
    apart = twice.derivative("displacement", "tie_value", [1.0, 0.0])
    assert (apart.right, "tie 1 repeats tie 0" in apart.reason) == (None, True)
    for asked in (("tie_force", np.ones(2), "load"), ("displacement", np.ones(3), "tie_value")):
        with pytest.raises(cq.InvalidProblem, match=r"repeats|share"):
            twice.pullback(*asked)
    nearly = cq.solve(few.replace(tie=np.vstack([tie, 2 * tie]), tie_value=[0.1, np.nextafter(0.2, 1.0)]))
    conflict = "the answer is not proven: energy_error: ties that depend on each other to rounding conflict"
    assert rough or nearly.derivative("displacement", "load", direction).bound_reason.startswith(conflict)


@pytest.mark.slow
def test_a_wall_that_repeats_another_and_turns_with_it_keeps_the_bounds() -> None:
    problem = cq.ContactProblem(np.diag([2.0, 3.0]) + 1, [9.0, 5.0], [[0.1, 0.2], [0.2, 0.4]], [0.25, 0.5])
    solution, turn = cq.solve(problem), np.array([[1 / 3, -1 / 7], [2 / 3, -2 / 7]])
    for of in ("displacement", "gap", "energy"):
        found, true = (one.derivative(of, "rows", turn) for one in (solution, cq.exact(problem)))
        assert found.value is not None
        assert all(error <= bound for error, bound in sides(found, true))
    turn[1, 1] += 2.0**-50
    other = solution.derivative("displacement", "rows", turn)
    assert other.bound is None or not np.array_equal(other.left, other.right)


def test_gradients_at_contacts_that_share_a_force_in_another_way_exist_with_bounds() -> None:
    """Of three walls two have no force in the sharing that is found and some in others: they do not graze."""
    rows = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    problem = cq.ContactProblem(np.diag([2.0, 3.0]), [6.0, 7.0], rows, [1.0, 1.0, 2.0])
    solution = cq.solve(problem)
    assert solution.normal_force == pytest.approx([0.0, 0.0, 4.0])
    gradient, bound = solution.pullback("displacement", [1.0, 1.0], "load", return_bound=True)
    assert np.all(abs(gradient) <= bound)
    assert np.all(bound <= 1e-15)
    grazing = cq.solve(problem.replace(load=[6.0, 3.0]))  # the second wall is pushed in no sharing
    with pytest.raises(cq.InvalidProblem, match="graze"):
        grazing.pullback("displacement", [1.0, 1.0], "load")


def carried_by(which: list[int]) -> Any:
    """Return a choice of what carries that is not the linear program's."""
    return lambda *_: np.array(which, dtype=np.intp)


def test_rates_of_a_wrong_choice_of_contacts_have_no_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two walls the one that comes nearer carries all: signs at the other's rates say so."""
    twice = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0], [1.0]], [1.0, 1.0]))
    found = twice.derivative("displacement", "gap", [-1.0, -3.0])
    assert (found.left, found.right, found.bound <= 1e-14) == (-1.0, -3.0, True)
    for which in ([0], [1]):
        monkeypatch.setattr(Sharing, "carrying", carried_by(which))
        found = twice.derivative("displacement", "gap", [-1.0, -3.0])
        assert (found.bound, found.bound_reason) == (None, gradients.SHARED)


def test_what_does_not_push_or_touch_carries_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gap of 2^-60 more and a force of the wrong sign show in the answer on the contacts that are to carry."""
    twice = cq.ContactProblem([[2.0]], [4.0], [[1.0], [1.0], [-1.0]], [1.0, 1.0, -1.0])
    for problem, which, seen in ((twice, [2], False), (twice, [0], True)):
        monkeypatch.setattr(Sharing, "carrying", carried_by(which))
        assert (cq.solve(problem).derivative("displacement", "load", [1.0]).bound is not None) == seen
    beside = cq.ContactProblem(np.eye(2), [4.0, 0.0], [[1.0, 0.0]] * 2, [1.0, 1.0 + 2.0**-52])
    monkeypatch.setattr(Sharing, "carrying", carried_by([1]))
    found = cq.solve(beside).derivative("displacement", "load", [1.0, 0.0])
    assert found.bound is None or found.value.tolist() == [0.0, 0.0]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("checked", [True, False])
def test_gaps_that_differ_beneath_doubles_have_no_bound(checked: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of thirds whose gaps move by 3 and by 1 together, to rounding: which stays closed is not told."""
    problem = cq.ContactProblem([[2.0]], [4.0], [[1.0], [3.0]], [1.0, 3.0])
    direction = [1 / 3, 1.0 - 2.0**-53]
    true = cq.exact(problem).derivative("displacement", "gap", direction)
    if not checked:
        monkeypatch.setattr(RateSystem, "where_signs_hold", lambda self, *given: self.rates(*given[:3]))
    found = cq.solve(problem).derivative("displacement", "gap", direction)
    below = found.bound is None or all(error <= bound for error, bound in sides(found, true))
    assert below or not checked


def test_why_there_is_no_bound_is_said() -> None:
    walls = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0], [1.0]], [1.0, 1.0]))
    together = walls.derivative("displacement", "rows", [[1.0], [1.0]])
    assert together.value == [-1.0]
    assert together.bound <= 1e-15
    crossed = cq.ContactProblem(np.diag([2.0, 3.0]), [6.0, 7.0], [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [1.0, 1.0, 2.0])
    turn = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]  # no row repeats another, and the third gap stays closed
    found = cq.solve(crossed).derivative("displacement", "rows", turn)
    assert (found.bound, found.bound_reason) == (None, gradients.SHARED)
    block = cq.ContactProblem(
        np.diag([2.0, 3.0, 5.0]), [3.0, 0.0, -10.0], [[0.0, 0.0, -1.0]], [0.0], np.eye(3)[:2], 0.3
    )
    at_bound = cq.solve(block).derivative("displacement", "load", [1.0, 0.0, 0.0])
    assert at_bound.bound is None  # 0.3 is not a double
    assert "may be beside the border" in at_bound.bound_reason
    exactly = cq.solve(block.replace(friction=0.25, load=[2.5, 0.0, -10.0])).derivative("slip", "load", [1.0, 0.0, 0.0])
    assert np.max(exactly.bound) < 1e-12
    pair = walls.pullback("displacement", [1.0], "load", return_bound=True)
    assert (pair[1] is None) == bool(pair.bound_reason)
    never = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0], [1.0]], [1.0, np.inf]))
    pair = never.pullback("gap", [0.0, 1.0], "load", return_bound=True)
    assert (pair[0], pair[1], pair.bound_reason) == ([0.0], None, derivatives.NEVER_CLOSES)
    matrix = never.jacobian("gap", "load", return_bound=True)
    assert (matrix.bound_reason, matrix[1].shape) == ("", (2, 1))
    assert walls.derivative("displacement", "load", [1.0]).bound_reason == ""


def test_a_body_between_walls_that_do_not_push_is_not_free() -> None:
    """Two of three walls bear no force here, and could share it with the third: nothing moves."""
    rows = [[-2.0, 2.0], [-2.0, -2.0], [0.0, 2.0]]
    answer = cq.solve(cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [-2.0, 2.0], rows, [-4.0, 2.0, -3.0]))
    assert answer.normal_force == pytest.approx([2.0, 0.0, 0.0])
    found = answer.derivative("displacement", "load", [1.0, 1.0])
    assert found.value == pytest.approx([0.0, 0.0], abs=1e-14)
    assert "share forces" in found.bound_reason
    energy = answer.derivative("energy", "load", [1.0, 1.0])
    assert energy.value == pytest.approx(1.0)  # -u'df
    assert answer.pullback("energy", 1.0, "load") == pytest.approx([-0.5, 1.5])
    # As the third wall gives way there is room between the second and the third, and the body moves along.
    one_sided = cq.solve(answer.problem.replace(gap=[-4.0, 2.5, -3.0]))
    assert one_sided.derivative("displacement", "load", [1.0, 1.0]).reason.startswith("bodies are free")
