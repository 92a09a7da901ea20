"""Derivatives are those of exact answers, towards either side, in any units; what has none says why."""

from __future__ import annotations

import pickle
from dataclasses import replace
from fractions import Fraction
from itertools import chain, combinations
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.analysis import rate_systems
from contactqp.linalg.condensation import condense
from contactqp.linalg.exact_algebra import dot, inverse_of

STEP = Fraction(1, 2**30)


def exact(K: Any, f: Any, E: Any, g: Any) -> tuple[list[Fraction], list[Fraction]]:
    """Displacement and contact forces in rational numbers, by trying all sets of closed contacts."""
    n, m = len(f), len(g)
    for closed in chain.from_iterable(combinations(range(m), count) for count in range(m + 1)):
        rows = [[*K[i], *(E[c][i] for c in closed)] for i in range(n)]
        rows += [[*E[c], *(Fraction() for _ in closed)] for c in closed]
        if (inverse := inverse_of(rows)) is None:
            continue
        right = [*f, *(g[c] for c in closed)]
        x = [dot(row, right) for row in inverse]
        force = dict(zip(closed, x[n:], strict=True))
        if all(one >= 0 for one in force.values()) and all(dot(E[i], x[:n]) <= g[i] for i in range(m)):
            return x[:n], [force.get(i, Fraction()) for i in range(m)]
    raise AssertionError("no set holds")


def rational(values: Any) -> Any:
    return [rational(row) for row in values] if np.ndim(values) > 1 else [Fraction(float(x)) for x in values]


def rate(data: Any, direction: Any, sign: int) -> tuple[Any, ...]:
    """The one-sided rates of displacement and forces, exact where nothing changes within the step."""
    (K, f, E, g), (df, dg, dK), t = data, (rational(part) for part in direction), sign * STEP

    def along(values: Any, rates: Any) -> Any:
        return [a + t * b for a, b in zip(values, rates, strict=True)]

    moved = [along(*rows) for rows in zip(K, dK, strict=True)], along(f, df), E, along(g, dg)
    pairs = zip(exact(*data), exact(*moved), strict=True)
    return tuple(np.array([float((b - a) / t) for a, b in zip(*pair, strict=True)]) for pair in pairs)


def drawn(rng: np.random.Generator, grazes: bool) -> tuple[cq.ContactProblem, Any]:
    n, m = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    shape = rng.integers(-3, 4, (n, n))
    K = shape @ shape.T + np.diag(rng.integers(1, 4, n))
    E = rng.integers(-2, 3, (m, n)).astype(float)
    E[~E.any(axis=1), 0] = 1.0
    g, f = rng.integers(0, 4, m) / 2, rng.integers(-9, 10, n).astype(float)
    if grazes:  # made around an answer whose first contact neither pushes nor stands off
        u = rng.integers(-4, 5, n) / 2
        g = E @ u + np.where(rng.random(m) < 0.4, 0.5, 0.0)
        g[0] = E[0] @ u
        force = np.where(g > E @ u, 0.0, rng.integers(1, 5, m))
        force[0] = 0.0
        f = K @ u + E.T @ force
    return cq.ContactProblem(K, f, E, g), tuple(rational(x) for x in (K, f, E, g))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("problems", [4, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("grazes", [False, True])
def test_rates_are_those_of_exact_answers(grazes: bool, problems: int) -> None:
    rng, one_sided, two_sided, seen, bounded = np.random.default_rng(27), 0, 0, 0, 0
    for _ in range(problems):
        problem, data = drawn(rng, grazes)
        solution, n, m = cq.solve(problem), problem.dimension, problem.contacts
        if not grazes and "grazing" in solution.contact_status:
            continue
        turn = rng.integers(-2, 3, (n, n))
        none = np.zeros(n), np.zeros(m), np.zeros((n, n))
        directions = ("load", rng.integers(-3, 4, n)), ("gap", rng.integers(-3, 4, m)), ("stiffness", turn + turn.T)
        for place, (name, direction) in enumerate(directions):
            along = tuple(direction if i == place else part for i, part in enumerate(none))
            for of, which in (("displacement", 0), ("normal_force", 1)):
                found = solution.derivative(of, name, direction.astype(float))
                if found.left is None and found.right is None:
                    assert "redundant" in found.reason or "cannot change" in found.reason
                    continue
                seen += 1
                truths = []
                for sign, side in ((1, found.right), (-1, found.left)):
                    if side is None and "cannot change" in found.reason:  # no displacement is within the gaps
                        one_sided += 1
                        with pytest.raises(AssertionError, match="no set holds"):
                            rate(data, along, sign)
                    elif side is not None:
                        truths.append((rate(data, along, sign)[which], side))
                # Along a stiffness the answer is not linear: a step leaves some of its curvature.
                near = (1e-9 if name != "stiffness" else 1e-6) * max(1.0, *(np.max(abs(one)) for one, _ in truths))
                assert all(np.max(abs(one - side)) <= near for one, side in truths)
                same = len(truths) == 2 and bool(np.max(abs(truths[0][0] - truths[1][0])) <= near)
                assert found.exists == same
                two_sided += not found.exists
                if found.bound is not None and name != "stiffness":
                    bounded += 1
                    assert all(np.all(abs(one - side) <= found.bound) for one, side in truths)
    assert one_sided >= (problems // 20 if grazes else 0)
    assert seen >= 5 * problems // 3
    assert bounded >= seen // 3
    assert (two_sided >= problems // 2) == grazes


def test_bounds_hold_against_fractions_and_those_of_a_tenth_would_not() -> None:
    rng, parts = np.random.default_rng(31), {}
    for grazes in (False, True) * 2:
        problem, _ = drawn(rng, grazes)
        solution, answer = cq.solve(problem), cq.exact(problem)
        n, m = problem.dimension, problem.contacts
        turn = rng.integers(-3, 4, (n, n)) / 3
        shapes = dict(load=rng.integers(-3, 4, n) / 3, gap=rng.integers(-3, 4, m) / 3, stiffness=turn + turn.T)
        for name, direction in (shapes | dict(rows=rng.integers(-3, 4, (m, n)) / 3)).items():
            for of in ("displacement", "normal_force", "gap", "reaction", "energy"):
                found = solution.derivative(of, name, direction)
                if found.bound is None or (true := answer.derivative(of, name, direction)).right is None:
                    continue
                for rates, exactly in ((found.left, true.left), (found.right, true.right)):
                    for one, other, bound in zip(*map(np.ravel, (rates, exactly, found.bound)), strict=True):
                        error = abs(Fraction(float(one)) - other)
                        assert error <= Fraction(float(bound))
                        part = error / Fraction(float(bound)) if bound > 0 else Fraction()
                        parts.setdefault((name, of), []).append(part)
    assert len(parts) == 4 * 5
    for (name, of), found in parts.items():
        assert len(found) >= (15 if of != "energy" else 5), (name, of)
        many = len(found) if of in ("displacement", "normal_force") else 0
        assert sum(part > Fraction(1, 10) for part in found) >= many // 20, (name, of)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("completed", [True, False])
def test_a_rounded_answer_has_the_rates_of_the_exact_one(completed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Products of a direction with a displacement that is off by 1e-10 are off, unless what they lack is added."""
    if not completed:
        none = rate_systems.Parts(*[np.zeros(1)] * 4)
        monkeypatch.setattr(rate_systems.RateSystem, "completed", lambda _, x, *__: (x, none, None))
    rng, outside = np.random.default_rng(5), 0
    for _ in range(8):
        problem, _ = drawn(rng, False)
        answer, solution = cq.exact(problem), cq.solve(problem)
        assert solution.certificate.proven
        rounded = replace(solution.answer, displacement=solution.displacement * (1 + 1e-10))
        solution = replace(solution, answer=rounded)
        turn = rng.integers(-3, 4, (problem.dimension, problem.dimension)) / 3
        found, true = (one.derivative("displacement", "stiffness", turn + turn.T) for one in (solution, answer))
        errors = [abs(float(Fraction(float(x)) - y)) for x, y in zip(found.value, true.value, strict=True)]
        outside += bool(np.any(errors > found.bound))
    assert outside == 0 if completed else outside >= 4


BAR = dict(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])  # kN and m


@pytest.mark.parametrize(("force", "length"), [(1.0, 1.0), (1e3, 1e3), (1e-9, 1e9), (1e9, 1e-9)])
def test_the_bar_and_the_wall_in_any_units(force: float, length: float) -> None:
    units = dict(stiffness=force / length, load=force, normal=1.0, gap=length)
    problem = cq.ContactProblem(**{name: np.asarray(value) * units[name] for name, value in BAR.items()})
    solution = cq.solve(problem)
    found = solution.derivative("normal_force", "gap", [1.0])
    assert found.value == pytest.approx([-157500.0 * force / length], rel=1e-14)
    assert found.exists
    back, ahead = found.reach
    assert ahead == pytest.approx((300.0 / 157500.0 - 1e-3) * length, rel=1e-12)  # then the wall is out of reach
    assert back == np.inf
    assert solution.derivative("energy", "load", [1.0]).value == pytest.approx(-1e-3 * length)
    assert solution.jacobian("normal_force", "load") == pytest.approx(np.array([[1.0]]))


def test_gradients_are_rows_of_the_jacobian() -> None:
    rng = np.random.default_rng(3)
    shape = rng.standard_normal((6, 6))
    problem = cq.ContactProblem(
        shape @ shape.T + np.eye(6), 3 * rng.standard_normal(6), rng.standard_normal((4, 6)), [0.1, 0.1, 5.0, 0.1],
        tie=rng.standard_normal((1, 6)), tie_value=[0.2],
    )  # fmt: skip
    solution = cq.solve(problem)
    assert np.count_nonzero(solution.normal_force) >= 2
    turn = rng.standard_normal((6, 6))
    for of in ("displacement", "normal_force", "tie_force", "gap", "energy"):
        weights = rng.standard_normal(np.shape(getattr(solution, of)))
        for parameter in ("load", "gap", "tie_value"):
            expected = np.atleast_1d(weights) @ solution.jacobian(of, parameter)
            assert solution.pullback(of, weights, parameter) == pytest.approx(expected, abs=1e-12)
        along = solution.derivative(of, "stiffness", turn + turn.T).value
        gradient = solution.pullback(of, weights, "stiffness")
        assert np.sum(gradient * (turn + turn.T)) == pytest.approx(np.sum(weights * along), rel=1e-10)
    sparse = cq.solve(problem.replace(stiffness=sp.csr_array(problem.stiffness)))
    gradient = solution.pullback("displacement", np.ones(6), "stiffness")
    assert sparse.pullback("displacement", np.ones(6), "stiffness").toarray() == pytest.approx(gradient, abs=1e-12)
    found = solution.derivative("gap", "load", np.ones(6))
    assert pickle.loads(pickle.dumps(found)).value.tolist() == found.value.tolist()


def test_what_has_no_derivative_says_why() -> None:
    touch = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0]], [2.0], contact_names=["stop"]))
    found = touch.derivative("normal_force", "load", [1.0])
    assert (found.value, found.exists, found.left.tolist(), found.right.tolist()) == (None, False, [0.0], [1.0])
    assert found.reason == "the two sides differ: stop grazes"
    with pytest.raises(cq.InvalidProblem, match="stop grazes"):
        touch.pullback("normal_force", [1.0], "load")
    with pytest.raises(cq.InvalidProblem, match="jacobian of gap with respect to load: the two sides differ"):
        touch.jacobian("gap", "load")
    twice = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0], [1.0]], [1.0, 1.0]))
    assert "redundant" in twice.derivative("normal_force", "load", [1.0]).reason
    tied = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0]], [3.0], tie=[[1.0], [1.0]], tie_value=[1.0, 1.0]))
    assert tied.contact_status.tolist() == ["open"]
    assert "or ties, are redundant" in tied.derivative("tie_force", "load", [1.0]).reason
    assert twice.derivative("displacement", "load", [1.0]).value == pytest.approx([0.0])
    floating = cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [1.0, 1.0], [[1.0, 0.0]], [0.5])
    assert cq.solve(floating).derivative("displacement", "load", [0.0, 1.0]).value == pytest.approx([0.0, 1.0])


def test_bad_arguments_are_one_clear_error() -> None:
    solution = cq.solve(cq.ContactProblem(**BAR))
    for call, message in (
        (lambda: solution.derivative("force", "gap", [1.0]), "of: expected one of displacement, normal_force"),
        (lambda: solution.derivative("gap", "mass", [1.0]), "with_respect_to: expected one of load, gap"),
        (lambda: solution.derivative("gap", "load", [1.0, 2.0]), r"direction: expected shape \(1,\), got \(2,\)"),
        (lambda: solution.derivative("gap", "load", [np.nan]), "direction: expected finite"),
        (lambda: solution.derivative("gap", "stiffness", [[1.0, 0.0]]), "direction: expected"),
        (lambda: solution.jacobian("gap", "stiffness"), "with_respect_to: expected one of load, gap, tie_value"),
        (lambda: solution.pullback("gap", [1.0, 2.0], "load"), "weights: expected finite numbers in the shape"),
    ):
        with pytest.raises(cq.InvalidProblem, match=message):
            call()
    two = cq.solve(cq.ContactProblem(np.eye(2), [1.0, 1.0], [[1.0, 0.0]], [0.5]))
    with pytest.raises(cq.InvalidProblem, match="symmetric"):
        two.derivative("gap", "stiffness", [[0.0, 1.0], [0.0, 0.0]])


def membrane(twice: list[int]) -> cq.ContactProblem:
    """60 x 60 nodes that may all touch, so that systems are sparse; some contacts are stated twice."""
    line = sp.diags([-np.ones(59), 2 * np.ones(60), -np.ones(59)], [-1, 0, 1])
    K = sp.csr_array(sp.kron(line, sp.eye(60)) + sp.kron(sp.eye(60), line))
    rows = -sp.eye(3600, format="csr")
    return cq.ContactProblem(K, np.full(3600, -0.01), sp.vstack([rows, rows[twice]]), np.full(3600 + len(twice), 0.5))


@pytest.mark.slow
def test_a_gradient_of_a_large_body_is_one_substitution(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes half as many as one that is refined, at most, and is as right as rates whose errors are bounded."""
    plate, middle = membrane([]), np.arange(1800, 1860)
    problem = cq.ContactProblem(plate.stiffness, plate.load, plate.normal[middle], np.full(60, 0.5))
    solution, rng, factors = cq.solve(problem), np.random.default_rng(5), condense(problem)

    def four_gradients(of: str, weights: Any) -> tuple[Any, int]:
        before = factors.back_substitutions
        found = [solution.pullback(of, weights, "load") for _ in range(4)]
        return found[0], factors.back_substitutions - before

    for of in ("displacement", "normal_force"):
        weights, direction = rng.standard_normal(np.shape(getattr(solution, of))), rng.standard_normal(3600)
        gradient, once = four_gradients(of, weights)
        rate = solution.derivative(of, "load", direction)
        assert gradient @ direction == pytest.approx(weights @ rate.value, rel=1e-11)
        monkeypatch.setattr(rate_systems, "ENOUGH_OF_GRADIENTS", 0.0)  # as where factors lose too many digits
        refined, often = four_gradients(of, weights)
        monkeypatch.undo()
        assert 0 < 2 * once <= often
        assert gradient == pytest.approx(refined, abs=1e-12 * np.max(abs(refined)))
        found, bound = solution.pullback(of, weights, "load", return_bound=True)  # refined as far as it goes
        assert abs(found @ direction - weights @ rate.value) <= bound @ abs(direction) + abs(weights) @ rate.bound
        assert np.max(bound) <= 1e-12 * np.max(abs(found))


@pytest.mark.slow
def test_many_contacts_are_not_condensed() -> None:
    problem, direction = membrane([]), np.linspace(0.0, 1e-3, 3600)
    solution = cq.solve(problem)
    found = solution.derivative("displacement", "load", direction)
    step = min(1e-2, 0.5 * found.reach[1])
    assert step > 0
    moved = cq.solve(problem.replace(load=problem.load + step * direction)).displacement - solution.displacement
    assert found.value == pytest.approx(moved / step, abs=1e-9 * np.max(abs(found.value)) + 1e-14 / step)
    middle = 1830
    assert solution.contact_status[middle] == "closed"
    assert "redundant" in cq.solve(membrane([middle])).derivative("normal_force", "load", direction).reason


def test_what_hardly_touches_is_told_from_what_grazes() -> None:
    """A force of 1e-13 of the load is one: the derivative exists, and reaches no further than that."""
    K, load = [[2.0, -1.0], [-1.0, 2.0]], [3.0, 0.0]
    u = np.linalg.solve(K, load)
    near, found = dict(stiffness=K, load=load, normal=np.eye(2)[1:]), []
    for shift in (-1e-13, 0.0, 1e-13):
        solution = cq.solve(cq.ContactProblem(**near, gap=[1.0 + shift]))
        assert solution.contact_status.tolist() == ["grazing"]
        found.append(solution.derivative("normal_force", "load", [1.0, 0.0]))
    assert u == pytest.approx([2.0, 1.0])
    assert [one.exists for one in found] == [True, False, True]
    assert found[0].value == pytest.approx([0.5])
    assert found[2].value.tolist() == [0.0]
    assert 0 < max(found[0].reach[0], found[2].reach[1]) < 1e-12
    assert (found[1].left.tolist(), found[1].right.tolist()) == ([0.0], [pytest.approx(0.5)])


def test_bodies_that_float_hardly_touch_or_graze_too() -> None:
    """A spring of stiffness 1 pushed against a stop by its one end; another is where the other end comes to."""
    found = []
    for shift in (-(2.0**-42), 0.0, 2.0**-42):
        solution = cq.solve(cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [1.0, 1.0], np.eye(2), [0.5, 1.5 + shift]))
        assert solution.contact_status.tolist() == ["closed", "grazing"]
        found.append(solution.derivative("normal_force", "load", [0.0, 1.0]))
    assert [one.exists for one in found] == [True, False, True]
    assert found[0].value == pytest.approx([0.0, 1.0])
    assert found[2].value == pytest.approx([1.0, 0.0])
    assert (found[1].left, found[1].right) == (pytest.approx([1.0, 0.0]), pytest.approx([0.0, 1.0]))
    assert found[0].reach == pytest.approx((2.0**-42, np.inf))
    assert found[2].reach == pytest.approx((2.0, 2.0**-42))


def test_contacts_that_never_close_and_rows_of_zeros_change_nothing() -> None:
    K, load = [[2.0, -1.0], [-1.0, 2.0]], [4.0, 1.0]
    plain = cq.solve(cq.ContactProblem(K, load, [[1.0, 0.0]], [1.0]))
    idle = cq.solve(cq.ContactProblem(K, load, [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]], [1.0, np.inf, 0.5]))
    for parameter, direction in (("load", [1.0, 2.0]), ("stiffness", [[1.0, 0.0], [0.0, 1.0]])):
        found = idle.derivative("normal_force", parameter, direction).value
        assert found == pytest.approx([*plain.derivative("normal_force", parameter, direction).value, 0.0, 0.0])
        expected = plain.pullback("displacement", [1.0, 2.0], parameter)
        assert idle.pullback("displacement", [1.0, 2.0], parameter) == pytest.approx(expected)
    assert idle.derivative("normal_force", "gap", [1.0, 1.0, 1.0]).value == pytest.approx([-1.5, 0.0, 0.0])
    assert idle.derivative("gap", "load", [1.0, 0.0]).reach[1] == np.inf
    rough = cq.solve(cq.ContactProblem(
        K, load, np.eye(2), [1.0, np.inf], tangent=[[0.0, 1.0], [1.0, 0.0]], friction=0.3))  # fmt: skip
    # l' = 1 + u', of what slips 2 u' = -0.3 l'.
    assert rough.derivative("normal_force", "load", [1.0, 0.0]).value == pytest.approx([1 / 1.15, 0.0])
    moved = rough.jacobian("displacement", "load")
    assert rough.jacobian("gap", "load") == pytest.approx(-moved)
    assert rough.jacobian("slip", "load") == pytest.approx(moved[::-1])


def test_gaps_of_bodies_that_are_free_to_move_are_not_unique() -> None:
    """A spring and a body free beside it, whose gap to a wall is any that is open."""
    free = cq.solve(cq.ContactProblem([[0.0, 0.0], [0.0, 9.0]], [0.0, 18.0], [[1.0, 1.0], [0.0, 1.0]], [4.0, 1.0]))
    found = free.derivative("gap", "gap", [1.0, 0.0])
    assert (found.value, found.right) == (None, None)
    assert "free to move" in found.reason
    with pytest.raises(cq.InvalidProblem, match="free to move"):
        free.pullback("gap", [1.0, 0.0], "gap")
    assert free.derivative("normal_force", "gap", [0.0, 1.0]).value == pytest.approx([0.0, -9.0])  # those are unique


@pytest.mark.slow
def test_redundant_contacts_may_set_free_what_they_hold() -> None:
    """A point in a wedge and on a floor at its apex: lifted by the floor, it moves between the walls."""
    seen = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 1.0, 1.0]])
    walls = [[-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [-1.0, 0.0, 0.0]]
    problem = cq.ContactProblem(seen, [-1.0, 0.0, 0.0], walls, [0.0, 0.0, 0.0])
    solution, exact = cq.solve(problem), cq.exact(problem)
    for of in ("displacement", "gap"):
        rate, truth = (one.derivative(of, "gap", [0.0, 0.0, -1.0]) for one in (solution, exact))
        assert (rate.right, rate.reason) == (None, truth.reason)
        assert np.array_equal(rate.left, truth.left.astype(float))
    energy = solution.derivative("energy", "gap", [0.0, 0.0, -1.0])
    assert (energy.left, energy.right) == (0.0, 1.0)
    sinks = solution.derivative("displacement", "gap", [1.0, 1.0, 1.0])
    np.testing.assert_allclose(
        sinks.right, exact.derivative("displacement", "gap", [1.0, 1.0, 1.0]).right.astype(float)
    )


@pytest.mark.slow
def test_bodies_free_to_slide_have_the_rates_of_what_is_determined() -> None:
    """Two blocks on a floor that nothing holds sideways: weights change the forces beneath, pushes are not borne."""
    K = np.zeros((4, 4))
    K[np.ix_([1, 3], [1, 3])] = [[3.0, -3.0], [-3.0, 3.0]]
    stack = cq.solve(cq.ContactProblem(K, [0.0, -2.0, 0.0, -5.0], [[0.0, -1.0, 0.0, 0.0]], [0.0]))
    assert len(stack.free_motions) == 2
    found = stack.derivative("normal_force", "load", [0.0, 0.0, 0.0, -1.0])
    assert found.value == pytest.approx([1.0])
    assert found.reach == pytest.approx((7.0, np.inf))
    assert stack.derivative("energy", "load", [0.0, 0.0, 0.0, 1.0]).value == pytest.approx(5.0 / 3.0)
    assert stack.derivative("normal_force", "stiffness", K).value == pytest.approx([0.0])  # it bears 7 all the same
    assert stack.derivative("energy", "stiffness", K).value == pytest.approx(25.0 / 6.0)  # (5/3)^2 3/2
    held = stack.derivative("normal_force", "stiffness", np.diag([1.0, 0.0, 0.0, 0.0]))
    assert (held.value, "free to move" in held.reason) == (None, True)
    for of, load in (("normal_force", [1.0, 0.0, 0.0, -1.0]), ("displacement", [0.0, 0.0, 0.0, -1.0])):
        found = stack.derivative(of, "load", load)
        assert (found.value, "free to move" in found.reason) == (None, True)


@pytest.mark.slow
def test_displacements_at_redundant_contacts_have_rates_by_gaps() -> None:
    """Twice the same wall, pushed against: the body follows the one that comes nearer, of energy and reaction, too."""
    twice = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0], [1.0]], [1.0, 1.0], contact_names=["one", "other"]))
    assert "redundant" in twice.certificate.reasons[0]
    found = twice.derivative("displacement", "gap", [-1.0, -3.0])
    assert (found.value, found.left, found.right) == (None, pytest.approx([-1.0]), pytest.approx([-3.0]))
    assert "redundant" in found.reason
    assert found.reach == pytest.approx((1.0, np.inf))  # then the walls are out of reach
    found = twice.derivative("energy", "gap", [-1.0, -3.0])  # rates of 1/2 2 u^2 - 4 u at u = 1
    assert (found.left, found.right) == (pytest.approx(2.0), pytest.approx(6.0))
    found = twice.derivative("reaction", "gap", [-1.0, -3.0])
    assert (found.left, found.right) == (pytest.approx([2.0]), pytest.approx([6.0]))
    assert twice.derivative("displacement", "gap", [2.0, 2.0]).value == pytest.approx([2.0])
    assert "redundant" in twice.derivative("normal_force", "gap", [2.0, 2.0]).reason
    # The second one's row longer by e > 0: (1 + e) u <= 1, u' = -1, and it bears all; by e < 0 the first one bears it.
    found = twice.derivative("displacement", "rows", [[0.0], [1.0]])
    assert (found.value, found.left, found.right) == (None, pytest.approx([0.0]), pytest.approx([-1.0]))
    found = twice.derivative("energy", "rows", [[0.0], [1.0]])
    assert (found.left, found.right) == (pytest.approx(0.0, abs=1e-15), pytest.approx(2.0))
    assert twice.derivative("displacement", "rows", [[1.0], [1.0]]).value == pytest.approx([-1.0])
    assert "redundant" in twice.derivative("normal_force", "rows", [[1.0], [1.0]]).reason
    beside = cq.ContactProblem(np.diag([2.0, 2.0]), [4.0, 2.0], [[1.0, 0.0]] * 2, [1.0, 1.0])
    tilted = cq.solve(beside).derivative("displacement", "rows", [[0.0, 1.0], [0.0, 1.0]])
    assert tilted.value == pytest.approx([-1.0, -1.0])  # u = (1, 1), and a force of 2 has a part of 2 e on the other
    # Ties that repeat leave the contact its force: u = (-e, -e) / 2 for the row (-1 - e, 0) with a gap of 1/2.
    tied = cq.ContactProblem(
        np.eye(2), [-3.0, 1.0], [[-1.0, 0.0]], [0.5], tie=[[-1.0, 1.0], [-1.0, 1.0]], tie_value=[0.0, 0.0]
    )
    assert cq.solve(tied).derivative("displacement", "rows", [[-1.0, 0.0]]).value == pytest.approx([0.5, 0.5])
    # A force of 2 that both may bear, and which is gone after a load of -2 more, however they share it.
    assert twice.derivative("displacement", "load", [-1.0]).reach == pytest.approx((np.inf, 2.0))
    between = cq.solve(cq.ContactProblem([[2.0]], [0.0], [[1.0], [-1.0]], [1.0, -1.0]))
    assert "cannot change their gaps" in between.derivative("displacement", "gap", [-1.0, 0.0]).reason
    with pytest.raises(cq.InvalidProblem, match="redundant"):
        twice.pullback("displacement", [1.0], "gap")


@pytest.mark.slow
def test_redundant_contacts_that_graze_have_unique_displacements() -> None:
    """Twice the same wall, which a spring just touches: its forces are unique, 0, until they share one."""
    twice = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0], [1.0]], [2.0, 2.0]))
    found = twice.derivative("displacement", "gap", [-1.0, -3.0])
    assert (found.left.tolist(), found.right.tolist()) == ([0.0], [-3.0])
    found = twice.derivative("normal_force", "gap", [-1.0, -3.0])  # the second alone
    assert (found.left.tolist(), found.right.tolist()) == ([0.0, 0.0], [0.0, 6.0])
    found = twice.derivative("normal_force", "load", [1.0])
    assert (found.right, "redundant" in found.reason) == (None, True)
    pressed = cq.solve(cq.ContactProblem([[2.0]], [6.0], [[1.0], [1.0]], [2.0, 2.0]))
    assert "redundant" in pressed.derivative("displacement", "gap", [1.0, 0.0]).reason
    wedged = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0], [-1.0]], [2.0, -2.0]))  # between two walls
    assert "redundant" in wedged.derivative("normal_force", "load", [1.0]).reason
    assert wedged.derivative("displacement", "load", [1.0]).value == pytest.approx([0.0])


@pytest.mark.parametrize("exactly", [True, False])
def test_what_grazes_to_an_allowance_has_no_bound(exactly: bool) -> None:
    """A gap that is a displacement rounded to doubles grazes to 1e-22 of what meets there: no bound rests on that."""
    coupling = 0.0 if exactly else -3.0
    free = cq.ContactProblem([[2.0**40, coupling], [coupling, 2.0**10]], [-1.0, 3.0 * 2**12], [[1.0, 0.0]], [1.0])
    problem = free.replace(gap=cq.solve(free).displacement[:1])
    solution, answer = cq.solve(problem), cq.exact(problem)
    found, true = (one.derivative("displacement", "load", [1.0, 0.0]) for one in (solution, answer))
    assert not found.exists
    assert true.exists != exactly
    assert (found.bound is None) != exactly


def test_a_tie_of_zeros_has_no_force_whose_gradient_could_not_exist() -> None:
    """Its force is none whatever the parameters; what other values of it would make no displacement does."""
    problem = cq.ContactProblem(
        [[3.0, 1.0], [1.0, 2.0]], [1.0, 5.0], [[0.0, 1.0]], [0.5], tie=[[0.0, 0.0], [1.0, -1.0]], tie_value=[0.0, 0.0]
    )
    solution = cq.solve(problem)
    assert solution.jacobian("tie_force", "load") == pytest.approx(np.array([[0.0, 0.0], [1.0, 0.0]]))
    assert solution.pullback("tie_force", [3.0, 2.0], "gap") == pytest.approx([-8.0])
    for ask in (solution.jacobian, lambda of, by: solution.pullback(of, [1.0, 1.0], by)):
        with pytest.raises(cq.InvalidProblem, match="tie 0 acts on nothing that moves"):
            ask("displacement", "tie_value")


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-320, 1e-300, 1e300])
def test_directions_of_any_size_have_rates_or_a_reason(size: float) -> None:
    """Refinement of a subnormal direction contracts by nothing: its remainder was divided by zero."""
    bar = cq.ContactProblem(
        [[22.0, 2.0, 0.0], [2.0, 9.0, 0.0], [0.0, 0.0, 9.0]], [1.0, 1.0, 4.0], [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
        [0.0, 0.4], tie=[[0.0, 1.0, -1.0]], tie_value=[0.0], tangent=[[-1.0, 0.0, 0.0], [1.0, 1.0, 0.0]], friction=0.4,
    )  # fmt: skip
    for of in ("displacement", "normal_force", "tie_force"):
        found = cq.solve(bar).derivative(of, "tie_value", [size])
        assert found.value is not None or found.reason


def test_the_reaction_of_a_stiff_body_that_moves_is_no_rounding() -> None:
    """Parts on springs of 1e15 and 1e8 move by 10 as one: their stiffness times that is of 1 where nothing acts."""
    K = np.zeros((4, 4))
    for i, spring in enumerate((2.0**27, 2.0**50, 2.0**50)):
        K[i : i + 2, i : i + 2] += spring * np.array([[1.0, -1.0], [-1.0, 1.0]])
    body = cq.ContactProblem(K, [-1.0, 0.0, 0.0, 0.0], [[-1.0, 0.0, 0.0, 0.0]], [1.0])
    solution, answer = cq.solve(body), cq.exact(body)
    for parameter, direction in (("gap", [1 / 3]), ("load", [-1.0, 1 / 3, 0.0, 0.0])):
        found, true = (one.derivative("reaction", parameter, direction) for one in (solution, answer))
        assert found.value[1:].tolist() == [0.0, 0.0, 0.0]
        errors = [abs(Fraction(float(x)) - y) for x, y in zip(found.value, true.value, strict=True)]
        assert all(error <= bound for error, bound in zip(errors, found.bound, strict=True))
