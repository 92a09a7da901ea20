"""With friction, derivatives are those of exact answers, at the border of two states towards either side."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis.derivatives import QUANTITIES
from contactqp.analysis.slip_law import slips_that_begin
from contactqp.linalg.measures import lengths

STEP = 2.0**-20  # so that what is stepped to is a double exactly


def drawn(rng: np.random.Generator) -> cq.ContactProblem:
    n, m = int(rng.integers(3, 6)), int(rng.integers(1, 4))
    shape = rng.integers(-3, 4, (n, n))
    rows = [rng.integers(-2, 3, (m, n)).astype(float) for _ in range(2)]
    for one in rows:
        one[~one.any(axis=1), 0] = 1.0
    return cq.ContactProblem(
        shape @ shape.T + np.diag(rng.integers(2, 6, n)), rng.integers(-9, 10, n), rows[0], rng.integers(0, 3, m) / 4,
        rows[1], rng.integers(0, 4, m) / 8,
    )  # fmt: skip


def at_borders(rng: np.random.Generator) -> cq.ContactProblem:
    """Draw a problem around an answer whose first contact grazes, or sticks at its bound."""
    problem = drawn(rng)
    n, m = problem.dimension, problem.contacts
    u, push, drag = rng.integers(-4, 5, n) / 2, rng.integers(1, 5, m).astype(float), np.zeros(m)
    gap, origin = problem.normal @ u, problem.tangent @ u
    for i in range(m):
        sign = rng.choice([-1.0, 1.0])
        kinds = ["bound", "grazes", "grazes apart", "stick", "slip", "open"]
        kind = rng.choice(kinds[: 3 if i == 0 else None])
        push[i] *= kind in ("bound", "stick", "slip")
        drag[i] = push[i] * sign * (0.125 if kind == "stick" else 0.25)
        origin[i] -= 0.5 * sign * (kind in ("slip", "grazes apart"))
        gap[i] += 0.5 * (kind == "open")
    load = problem.stiffness @ u + problem.normal.T @ push + problem.tangent.T @ drag
    return problem.replace(load=load, gap=gap, slip_origin=origin, friction=np.full(m, 0.25))


def rate(base: Any, moved: Any, of: str, sign: int) -> np.ndarray:
    """Return the exact rate towards a side, of answers in Fractions."""
    before, after = (np.ravel(np.array(getattr(one, of), dtype=object)) for one in (base, moved))
    return np.array([float((b - a) * int(1 / STEP)) * sign for a, b in zip(before, after, strict=True)])


def directions(rng: np.random.Generator, problem: cq.ContactProblem) -> dict[str, np.ndarray]:
    n, m = problem.dimension, problem.contacts
    turn = rng.integers(-2, 3, (n, n))
    found = dict(
        load=rng.integers(-3, 4, n), gap=rng.integers(-3, 4, m), slip_origin=rng.integers(-3, 4, (m, 1)),
        friction=rng.integers(0, 3, m), stiffness=turn + turn.T, rows=rng.integers(-1, 2, (m, n)),
    )  # fmt: skip
    return {name: direction.astype(float) for name, direction in found.items()}


def moved(problem: cq.ContactProblem, name: str, step: np.ndarray) -> cq.ContactProblem:
    field = "normal" if name == "rows" else name
    value = getattr(problem, field)
    return problem.replace(**{field: (value.toarray() if field == "normal" else value) + step})


@pytest.mark.parametrize(
    ("border", "problems"),
    [(False, 2), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((True, 3), (False, 25), (True, 25)))],
)
def test_rates_are_those_of_exact_answers(border: bool, problems: int) -> None:
    rng, seen, two_sided, slips, bounded = np.random.default_rng(8), 0, 0, 0, 0
    for _ in range(problems):
        problem = at_borders(rng) if border else drawn(rng)
        solution = cq.solve(problem)
        if solution.certificate.uniqueness:
            continue
        base = cq.exact(problem)
        slips += int(np.sum(solution.contact_status == "slip"))
        for name, direction in directions(rng, problem).items():
            if border and name not in ("load", "gap", "slip_origin"):
                continue
            if name == "friction" and np.any(problem.friction < STEP * direction):
                continue
            sides = {sign: cq.exact(moved(problem, name, sign * STEP * direction)) for sign in (1, -1)}
            for of in ("displacement", "normal_force", "friction_force"):
                found = solution.derivative(of, name, direction)
                if found.right is None:
                    assert border
                    assert "several rates" in found.reason or "in many ways" in found.reason
                    continue
                right, left = (rate(base, sides[sign], of, sign) for sign in (1, -1))
                near = 1e-8 * max(1.0, np.max(abs(right)), np.max(abs(left)))
                if name in ("friction", "stiffness", "rows"):  # along which answers are not linear
                    assert np.max(abs((right + left) / 2 - np.ravel(found.value))) <= 100 * near
                else:
                    assert np.max(abs(right - np.ravel(found.right))) <= near
                    assert np.max(abs(left - np.ravel(found.left))) <= near
                    assert found.exists == bool(np.max(abs(left - right)) <= near)
                if found.bound is not None and name not in ("friction", "stiffness", "rows"):
                    bounded += 1
                    assert np.all(abs(right - np.ravel(found.right)) <= np.ravel(found.bound))
                    assert np.all(abs(left - np.ravel(found.left)) <= np.ravel(found.bound))
                seen += 1
                two_sided += not found.exists
    assert seen >= 6 * problems
    assert bounded >= seen // 4
    assert slips >= problems // 12  # of the answers that are unique
    assert (two_sided >= 2 * problems) == border


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, pytest.param(2.0**-60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("border", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_bounds_hold_against_fractions_and_those_of_a_tenth_would_not(border: bool, unit: float) -> None:
    """Of every quantity along every parameter, also those along which answers are not linear."""
    rng, parts = np.random.default_rng(15), {}
    for _ in range(12 if border else 4):
        problem = at_borders(rng) if border else drawn(rng)
        problem = problem.replace(stiffness=problem.stiffness * unit, load=problem.load * unit)
        tie, value = rng.integers(-2, 3, (1, problem.dimension)).astype(float), [0.25]
        problem = problem if border else problem.replace(tie=tie, tie_value=value)
        solution, answer = cq.solve(problem), cq.exact(problem)
        if solution.certificate.uniqueness:
            continue
        for name, direction in directions(rng, problem).items():
            scale = unit / 3 if name in ("load", "stiffness") else 1 / 3
            for of in QUANTITIES:
                found, true = (one.derivative(of, name, direction * scale) for one in (solution, answer))
                if found.bound is None or true.right is None:
                    continue
                for rates, exactly in ((found.left, true.left), (found.right, true.right)):
                    if rates is None or exactly is None:
                        continue
                    for one, other, bound in zip(*map(np.ravel, (rates, exactly, found.bound)), strict=True):
                        error = abs(Fraction(float(one)) - Fraction(other))
                        assert error <= Fraction(float(bound)), (of, name)
                        part = error / Fraction(float(bound)) if bound > 0 else Fraction()
                        parts.setdefault((of, name), []).append(part)
    assert len(parts) == 6 * (len(QUANTITIES) - border)  # no ties at borders
    for of in ("displacement", "normal_force"):
        for name in ("friction", "stiffness", "rows"):
            found = parts[of, name]
            assert sum(part > Fraction(1, 10) for part in found) >= len(found) // 20, (of, name)


@pytest.mark.slow
@pytest.mark.parametrize("problems", [1, 6])
@pytest.mark.parametrize("width", [1, 2])
def test_differences_of_answers_and_gradients(width: int, problems: int) -> None:
    """In space, too, where the directions of slip turn; with a tie, of every quantity by every parameter."""
    rng, seen, step = np.random.default_rng(9), 0, 1e-5
    for _ in range(problems):
        n, m = 7, 2
        shape = rng.standard_normal((n, n))
        problem = cq.ContactProblem(
            shape @ shape.T + 3 * np.eye(n), 5 * rng.standard_normal(n), rng.standard_normal((m, n)),
            rng.uniform(0, 0.3, m), 0.7 * rng.standard_normal((width * m, n)), rng.uniform(0.05, 0.4, m),
            tie=rng.standard_normal((1, n)), tie_value=[0.1],
        )  # fmt: skip
        solution, turn = cq.solve(problem), rng.standard_normal((n, n))
        along = dict(
            load=rng.standard_normal(n), gap=rng.standard_normal(m), friction=0.1 * rng.standard_normal(m),
            slip_origin=rng.standard_normal((m, width)), stiffness=turn + turn.T, rows=rng.standard_normal((m, n)),
            tie_value=np.ones(1),
        )  # fmt: skip
        for name, direction in along.items():
            ahead, back = (cq.solve(moved(problem, name, sign * step * direction)) for sign in (1, -1))
            if any(one.contact_status.tolist() != solution.contact_status.tolist() for one in (ahead, back)):
                continue
            for of in QUANTITIES:
                found = solution.derivative(of, name, direction).value
                difference = (np.asarray(value(ahead, of)) - np.asarray(value(back, of))) / (2 * step)
                assert found == pytest.approx(difference, abs=1e-6 * max(1.0, np.max(abs(difference))))
                weights = rng.standard_normal(np.shape(found))
                gradient = solution.pullback(of, weights, name)
                gradient = gradient.toarray() if hasattr(gradient, "toarray") else gradient
                assert np.sum(gradient * direction) == pytest.approx(np.sum(weights * found), abs=1e-10)
                seen += 1
    assert seen >= 100 * problems // 3


def value(solution: cq.Solution, of: str) -> Any:
    problem = solution.problem
    return problem.load - problem.stiffness @ solution.displacement if of == "reaction" else getattr(solution, of)


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("force", "length"), [(1.0, 1.0), (2.0**30, 2.0**-30), (1e-9, 1e9), (1e9, 1e-9)])
def test_a_slider_on_a_spring_in_any_units(force: float, length: float) -> None:
    """A spring of stiffness 2 and a floor with mu = 0.3 under 10: slips at 3, u = (f - 3)/2."""
    K = np.array([[2.0, 0.0], [0.0, 5.0]]) * force / length

    def slider(pull: float) -> cq.Solution:
        load = np.array([pull, -10.0]) * force
        return cq.solve(cq.ContactProblem(K, load, [[0.0, -1.0]], [0.0], [[1.0, 0.0]], friction=0.3))

    slipping, sticking, at_bound = slider(5.0), slider(1.0), slider(3.0)
    near, pulled, soft = dict(rel=1e-12), [1.0, 0.0], [0.5 * length / force, 0.0]
    assert slipping.derivative("displacement", "load", pulled).value == pytest.approx(soft, **near)
    assert slipping.derivative("displacement", "friction", 1.0).value == pytest.approx([-5.0 * length, 0.0], **near)
    assert slipping.derivative("friction_force", "load", [0.0, -1.0]).value == pytest.approx(np.array([[0.3]]), **near)
    assert slipping.derivative("displacement", "load", pulled).reach == pytest.approx((2.0 * force, np.inf), **near)
    assert sticking.derivative("friction_force", "load", pulled).value == pytest.approx(np.array([[1.0]]), **near)
    assert sticking.derivative("displacement", "load", pulled).reach == pytest.approx((4 * force, 2 * force), **near)
    found = at_bound.derivative("displacement", "load", pulled)
    assert (found.value, found.left.tolist()) == (None, [0.0, 0.0])
    assert found.right == pytest.approx(soft, **near)
    assert found.reason == "the two sides differ: contact 0 sticks at its bound"
    with pytest.raises(cq.InvalidProblem, match="sticks at its bound"):
        at_bound.pullback("displacement", [1.0, 0.0], "load")


def test_what_has_no_derivative_with_friction_says_why() -> None:
    still = cq.ContactProblem(
        np.eye(3), [0.0, -10.0, -5.0], [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0]], [0.0, 0.0],
        [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], friction=[0.0, 0.5],
    )  # fmt: skip
    found = cq.solve(still).derivative("friction_force", "friction", [1.0, 0.0])
    assert "contact 0 has neither friction nor slip" in found.reason
    with pytest.raises(cq.InvalidProblem, match="neither friction nor slip"):
        cq.solve(still).pullback("displacement", np.ones(3), "friction")
    slid = cq.solve(still.replace(load=[-2.0, -10.0, -5.0]))
    assert slid.derivative("friction_force", "friction", [1.0, 0.0]).value[0] == pytest.approx([-10.0])
    smooth = cq.solve(still.replace(friction=0.0))
    assert "no contact has friction" in smooth.derivative("friction_force", "friction", 1.0).reason
    smooth = cq.solve(cq.ContactProblem([[1.0]], [2.0], [[1.0]], [1.0]))
    for call, message in (
        (
            lambda: smooth.derivative("friction_force", "load", [1.0]),
            "of: 'friction_force' of a problem without tangential",
        ),
        (lambda: smooth.derivative("gap", "friction", [1.0]), "with_respect_to: 'friction' of a problem without"),
        (lambda: smooth.derivative("gap", "rows", [[1.0, 0.0]]), r"direction: expected shape \(1, 1\), got \(1, 2\)"),
    ):
        with pytest.raises(cq.InvalidProblem, match=message):
            call()
    assert smooth.derivative("reaction", "rows", [[1.0]]).value == pytest.approx([1.0])  # u = 1/E: f - K u = 2 - 1/E


@pytest.mark.sampled(3)
@pytest.mark.parametrize("unit", [1.0, 2.0**-30, 1e9])
def test_what_begins_to_slip_in_space_does_so_along_its_friction(unit: float) -> None:
    """A weight of 10 on springs of 2 and 4, mu = 1/2, pulled by (3, 4), which is the bound; t = (3, 4)/5.

    Slipping along t it is held by t'K t = (9 2 + 16 4)/25 = 3.28 and its friction turns with what pulls across.
    """
    floor = dict(normal=[[0.0, 0.0, -1.0]], gap=[0.0], tangent=[[1.0, 0, 0], [0.0, 1, 0]], friction=0.5)
    K, t = np.diag([2.0, 4.0, 5.0]) / unit, np.array([0.6, 0.8])
    body = cq.solve(cq.ContactProblem(K, [3.0, 4.0, -10.0], **floor))
    found = body.derivative("displacement", "load", [1.0, 1.0, 0.0])
    assert (found.value, found.exists, found.reach) == (None, False, None)
    exact = np.array([[Fraction(3, 5), Fraction(4, 5), 0]]).T[:, 0] * Fraction(140, 328)
    assert all(
        abs(Fraction(x / unit) - y) <= Fraction(b / unit)
        for x, y, b in zip(found.right, exact, found.bound, strict=True)
    )
    assert found.left == pytest.approx([0.0, 0.0, 0.0], abs=1e-15 * unit)
    assert found.right == pytest.approx([*(t * 1.4 / 3.28 * unit), 0.0], rel=1e-13, abs=1e-15 * unit)
    assert found.reason == "the two sides differ: contact 0 sticks at its bound"
    drag = body.derivative("friction_force", "load", [1.0, 1.0, 0.0])
    assert drag.left == pytest.approx(np.array([[1.0, 1.0]]))  # it sticks
    held = np.array([1.0, 1.0]) - np.diag([2.0, 4.0]) @ t * 1.4 / 3.28
    assert drag.right == pytest.approx(held[None])
    assert drag.right[0] @ t == pytest.approx(0.0, abs=1e-14)
    across = body.derivative("displacement", "load", [-0.8, 0.6, 0.0])  # to either side it sticks
    assert across.value == pytest.approx([0.0, 0.0, 0.0], abs=1e-15 * unit)
    lighter = body.derivative("displacement", "load", [0.0, 0.0, 1.0])
    assert lighter.right == pytest.approx([*(t * 0.5 / 3.28 * unit), 0.0], abs=1e-15 * unit)
    near = cq.solve(body.problem.replace(load=[3.0, 4.0, -10.0 - 1e-12])).derivative("displacement", "load", [1, 1, 0])
    assert near.value == pytest.approx([0.0, 0.0, 0.0], abs=1e-15 * unit)  # it does not slip yet


def at_borders_in_space(rng: np.random.Generator) -> cq.ContactProblem:
    """Draw a problem in space around an answer whose first contact grazes, or sticks at its bound: all are doubles."""
    m = int(rng.integers(1, 4))
    n = 3 * m + int(rng.integers(0, 3))
    shape = rng.integers(-2, 3, (n, n))
    K, rows = (shape @ shape.T + 8 * np.eye(n)).astype(float), np.eye(n)[rng.permutation(n)[: 3 * m]]
    E, T = rows[:m] * rng.choice([-1.0, 1.0], m)[:, None], rows[m:]
    u = rng.integers(-4, 5, n) / 2
    push, drag, gap, origin = np.zeros(m), np.zeros((m, 2)), E @ u, (T @ u).reshape(m, 2)
    kinds = ["bound", "slipped", "grazes", "stick", "slip", "open"]
    for i in range(m):
        kind, turn = rng.choice(kinds[: 3 if i == 0 else None]), np.array([3.0, 4.0]) * rng.choice([-1.0, 1.0], 2)
        push[i] = 2.5 * rng.integers(1, 5) * (kind in ("bound", "stick", "slip"))
        drag[i] = turn * push[i] * (0.025 if kind == "stick" else 0.05)
        origin[i] -= 0.125 * turn * (kind in ("slip", "slipped"))
        gap[i] += 0.5 * (kind == "open")
    load = K @ u + E.T @ push + T.T @ drag.ravel()
    return cq.ContactProblem(K, load, E, gap, T, 0.25, origin)


@pytest.mark.slow
@pytest.mark.parametrize(("problems", "seed"), [(2, 6), *((4, seed) for seed in range(5))])
def test_rates_at_borders_in_space_are_differences_of_answers(problems: int, seed: int) -> None:
    rng, seen, two_sided, missing, step = np.random.default_rng(seed), 0, 0, 0, 2.0**-20
    for _ in range(problems):
        problem = at_borders_in_space(rng)
        solution, m = cq.solve(problem), problem.contacts
        if solution.certificate.uniqueness:
            continue
        along = dict(
            load=rng.standard_normal(problem.dimension), gap=rng.standard_normal(m),
            slip_origin=rng.standard_normal((m, 2)), friction=rng.uniform(0.0, 1.0, m),
        )  # fmt: skip
        for name, direction in along.items():
            sides = [cq.solve(moved(problem, name, sign * step * direction)) for sign in (-1, 1)]
            for of in ("displacement", "normal_force", "friction_force", "energy"):
                found = solution.derivative(of, name, direction)
                assert found.right is not None, found.reason
                for sign, side, rates in zip((-1, 1), sides, (found.left, found.right), strict=True):
                    difference = (np.asarray(value(side, of)) - np.asarray(value(solution, of))) / (sign * step)
                    assert rates == pytest.approx(difference, abs=2e-4 * max(1.0, np.max(abs(difference))))
                two_sided += not found.exists
                seen += 1
    assert seen >= 8 * problems
    assert two_sided >= 2 * problems
    assert missing <= seen // 50


def at_many_borders(rng: np.random.Generator, d: int) -> cq.ContactProblem:
    """Draw a problem of softer bodies whose contacts graze, unslipped or slipped, stick at their bounds, or do not."""
    m = int(rng.integers(1, 5))
    n = d * m + int(rng.integers(0, 3))
    shape = rng.integers(-2, 3, (n, n))
    K = (shape @ shape.T + int(rng.choice([1, 2, 8])) * np.eye(n)).astype(float)
    rows = np.eye(n)[rng.permutation(n)[: d * m]]
    E, T, u = rows[:m] * rng.choice([-1.0, 1.0], m)[:, None], rows[m:], rng.integers(-4, 5, n) / 2
    push, drag, gap, origin = np.zeros(m), np.zeros((m, d - 1)), E @ u, (T @ u).reshape(m, d - 1)
    kinds, mu = ["bound", "slipped", "grazes", "stick", "slip", "open", "grazes"], rng.choice([0.25, 0.5, 0.125, 1.0])
    for i in range(m):
        kind = rng.choice(kinds[: 3 if i == 0 else None])
        turn = np.array([5.0] if d == 2 else [3.0, 4.0]) * rng.choice([-1.0, 1.0], d - 1)
        push[i] = 2.5 * rng.integers(1, 5) * (kind in ("bound", "stick", "slip"))
        drag[i] = turn * push[i] * mu / (10 if kind == "stick" else 5)
        origin[i] -= 0.125 * turn * (kind in ("slip", "slipped"))
        gap[i] += 0.5 * (kind == "open")
    return cq.ContactProblem(K, K @ u + E.T @ push + T.T @ drag.ravel(), E, gap, T, float(mu), origin)


@pytest.mark.slow
@pytest.mark.parametrize(("dimension", "problems"), [(2, 12), (3, 14)])
def test_rates_where_many_contacts_are_at_borders_are_differences_of_answers(dimension: int, problems: int) -> None:
    """Other answers may exist; of one contact that may begin to slip all rates are found, so that one is the only one.

    A gap that rounding of the displacement leaves, as in the thirteenth problem in space, is none.
    """
    rng, step, refused = np.random.default_rng(1), 2.0**-20, 0
    for _ in range(problems):
        problem = at_many_borders(rng, dimension)
        solution, m = cq.solve(problem), problem.contacts
        along = dict(
            load=rng.standard_normal(problem.dimension), gap=rng.standard_normal(m),
            slip_origin=rng.standard_normal((m, dimension - 1)), friction=rng.uniform(0.0, 1.0, m),
        )  # fmt: skip
        for name, direction in along.items():
            found = solution.derivative("displacement", name, direction)
            refused += found.right is None
            for sign, rates in ((-1, found.left), (1, found.right)):
                side = cq.solve(moved(problem, name, sign * step * direction), warm_start=solution)
                difference = (side.displacement - solution.displacement) / (sign * step)
                assert rates is None or rates == pytest.approx(difference, abs=1e-3 * max(1, np.max(abs(difference))))
    assert refused == 0


@pytest.mark.parametrize("seed", range(8))
def test_slips_that_begin_are_along_their_friction(seed: int) -> None:
    rng, (q, d) = np.random.default_rng(seed), (1 + seed % 3, 2)
    shape = rng.standard_normal((3 * q, 3 * q)) / 3
    S = shape @ shape.T + np.eye(3 * q)
    push, drag = rng.uniform(1.0, 2.0, q), rng.standard_normal((q, d)) * 2
    drag *= np.maximum(1.0, 2.0 / lengths(drag))[:, None]  # more than 0.3 of the forces
    pushes, drags = -S[:q, q:].reshape(q, q, d), -S[q:, q:].reshape(q, d, q, d)
    found = slips_that_begin(np.full(q, 0.3), push, drag, pushes, drags)
    assert len(found) >= 1
    for slips in found[:1]:
        forces = push + np.einsum("ijk,jk->i", pushes, slips), drag + np.einsum("iajk,jk->ia", drags, slips)
        along = 0.3 * forces[0][:, None] * slips / lengths(slips)[:, None]
        assert forces[1] == pytest.approx(along, abs=1e-5)
        assert np.all(lengths(slips) > 1e-2)


def test_a_contact_at_its_bound_is_followed_to_the_next_event() -> None:
    """A block of weight 10 on a spring of stiffness 2, pulled by 3 = 0.3 10, its bound."""
    K, wall = np.diag([2.0, 5.0]), dict(normal=[[0.0, -1.0]], gap=[0.0], tangent=[[1.0, 0.0]], friction=0.3)
    block = cq.solve(cq.ContactProblem(K, [3.0, -10.0], **wall))
    assert block.derivative("displacement", "load", [1.0, 0.0]).reach == pytest.approx((6.0, np.inf))  # slips back
    assert block.derivative("displacement", "load", [0.0, -1.0]).reach == pytest.approx((10.0, np.inf))  # lifts off
    # What grazes though it has slipped by 1 slips on as it closes, until the spring has brought it back to its origin.
    apart = cq.solve(cq.ContactProblem(K, [2.0, 0.0], **wall, slip_origin=[[0.0]]))
    found = apart.derivative("displacement", "load", [0.0, -1.0])
    assert found.right == pytest.approx([-0.15, 0.0])
    assert found.reach == pytest.approx((np.inf, 1.0 / 0.15))


def test_the_energy_has_two_rates_where_friction_at_its_bound_lets_go() -> None:
    """A spring of 3 pulled by 0.3 = 0.1 x 3: lifted by 1, it slips by 0.1/3, and J' = (K u - f)'u' = -0.3 x 0.1/3."""
    block = cq.ContactProblem(np.diag([3.0, 7.0]), [0.3, -3.0], [[0.0, -1.0]], [0.0], [[1.0, 0.0]], friction=0.1)
    found = cq.solve(block).derivative("energy", "load", [0.0, 1.0])
    assert (found.exists, found.value) == (False, None)
    assert (found.left, found.right) == (pytest.approx(0.0, abs=1e-15), pytest.approx(-0.3 * 0.1 / 3.0))


def test_what_hardly_sticks_or_slips_is_told_from_what_is_at_its_bound() -> None:
    """A block of weight 8 on a spring of stiffness 2, mu = 1/4, pulled by 2 and a little less or more."""
    K, floor = np.diag([2.0, 4.0]), dict(normal=[[0.0, -1.0]], gap=[0.0], tangent=[[1.0, 0.0]], friction=0.25)
    found = []
    for more in (-(2.0**-40), 0.0, 2.0**-40):
        block = cq.solve(cq.ContactProblem(K, [2.0 + more, -8.0], **floor))
        found.append(block.derivative("displacement", "load", [1.0, 0.0]))
    assert [one.exists for one in found] == [True, False, True]
    assert [found[0].value.tolist(), found[1].left.tolist()] == [[0.0, 0.0], [0.0, 0.0]]
    assert found[0].reach == pytest.approx((4.0, 2.0**-40))
    assert (found[1].right, found[2].value) == (pytest.approx([0.5, 0.0]), pytest.approx([0.5, 0.0]))
    assert found[2].reach == pytest.approx((2.0**-40, np.inf))


@pytest.mark.slow
def test_contacts_that_may_share_their_forces_have_no_derivatives() -> None:
    """Opposite walls, or the same twice: in one of the states that may come, the forces are many."""
    K, half = np.diag([2.0, 5.0]), np.array([0.5, 0.5])
    walls = dict(normal=[[0.0, -1.0], [0.0, 1.0]], gap=[0.0, 0.0], tangent=[[1.0, 0.0], [1.0, 0.0]], friction=half)
    between = cq.ContactProblem(K, [1.0, -10.0], **walls)
    twice = between.replace(normal=[[0.0, -1.0], [0.0, -1.0]], friction=[0.0, 0.5])
    for problem in (between, twice):
        solution = cq.solve(problem)
        assert "grazing" in solution.contact_status
        for name, direction in (("load", [1.0, 1.0]), ("slip_origin", [[1.0], [0.0]])):
            found = solution.derivative("normal_force", name, direction)
            assert (found.value, found.right) == (None, None)
            assert "in many ways" in found.reason
    # Along the floor they keep grazing, without forces that could be shared.
    along = cq.solve(twice.replace(load=[1.0, 0.0], friction=[0.25, 0.5]))
    assert along.contact_status.tolist() == ["grazing", "grazing"]
    assert along.derivative("displacement", "load", [1.0, 0.0]).value == pytest.approx([0.5, 0.0])
    assert "in many ways" in along.derivative("displacement", "load", [0.0, -1.0]).reason
    # Where one is moved back it slips alone: nothing is shared.
    apart = along.derivative("normal_force", "gap", [-1.0, 1.0])
    assert apart.right == pytest.approx([5.0, 0.0])
    assert apart.left == pytest.approx([0.0, -5.0])


@pytest.mark.parametrize("far", [0.0, 2.0**19])
def test_directions_of_small_slips_of_bodies_that_have_moved_far(far: float) -> None:
    """A slip of (3, 4) d, d = 2^-10/3, under a weight of 10 and mu = 1/2: C = (I - t t')/d, t = (3, 4)/5.

    The displacement far + 4 d is no double: beside far = 2^19 its rounding turns the slip by 1e-8.
    """
    K, d, t = np.diag([2.0, 3.0]), 2.0**-10 / 3, np.array([0.6, 0.8])
    load = [2 * far + 2.0**-9 + 3, 3 * far + 2.0**-8 + 4, -10.0]
    whole = np.diag([2.0, 3.0, 1.0])
    sliding = cq.solve(
        cq.ContactProblem(
            whole, load, [[0.0, 0.0, -1.0]], [0.0], [[1.0, 0, 0], [0.0, 1, 0]], friction=0.5, slip_origin=[[far, far]]
        )
    )
    assert sliding.contact_status.tolist() == ["slip"]
    found = sliding.derivative("displacement", "load", [1.0, -2.0, 0.0]).value
    expected = np.linalg.solve(K + (np.eye(2) - np.outer(t, t)) / d, [1.0, -2.0])
    assert found == pytest.approx([*expected, 0.0], rel=1e-11, abs=1e-14)


def test_rates_that_rounding_alone_tells_apart_are_one() -> None:
    """A row that turns where nothing moves changes nothing, whichever way the contact that grazes may slip."""
    K = np.array([[5.0, 1.0, 2.0], [1.0, 7.0, -1.0], [2.0, -1.0, 4.0]])
    problem = cq.ContactProblem(
        K, K @ [0.0, 1.0, -1.0], [[2.0, 0.0, 2.0]], [-2.0], tangent=[[0.0, 1.0, 1.0]], friction=0.25
    )
    solution = cq.solve(problem)
    assert solution.contact_status.tolist() == ["grazing"]
    for of in ("displacement", "normal_force", "friction_force"):
        found = solution.derivative(of, "rows", [[4.0, 0.0, 0.0]])
        assert found.exists, found.reason
        assert found.value == pytest.approx(np.zeros_like(found.value), abs=1e-25)
