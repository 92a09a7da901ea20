"""Contacts that never close and rows of zeros have no part in derivatives: these are those of the others."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq

ACTING = [0, 2]  # of the contacts
BY_CONTACT = ("normal_force", "friction_force", "gap", "slip", "friction", "slip_origin", "rows")


def pair(rough: bool) -> tuple[cq.ContactProblem, cq.ContactProblem]:
    """A problem, and the same one with a contact that never closes, one of a row of zeros, and a tie of zeros."""
    rng = np.random.default_rng(3)
    shape, rows, tangents, tie = (rng.standard_normal(size) for size in ((4, 4), (4, 4), (4, 4), (1, 4)))
    rows[3], none = 0.0, np.zeros((1, 4))
    data = dict(stiffness=shape @ shape.T + np.eye(4), load=3 * rng.standard_normal(4))
    gap = np.array([0.1, np.inf, 0.2, 1.0])
    some, every = ({}, {}) if not rough else (dict(tangent=tangents[ACTING], friction=0.1), {})
    every = dict(tangent=tangents, friction=0.1) if rough else every
    few = cq.ContactProblem(**data, normal=rows[ACTING], gap=gap[ACTING], tie=tie, tie_value=[0.1], **some)
    whole = cq.ContactProblem(
        **data, normal=rows, gap=gap, tie=np.vstack([none, tie]), tie_value=[0.0, 0.1], **every
    )  # fmt: skip
    return few, whole


def part(name: str, values: Any) -> Any:
    return values[ACTING] if name in BY_CONTACT else values[1:] if name in ("tie_force", "tie_value") else values


def directions(problem: cq.ContactProblem) -> dict[str, Any]:
    rng, n, m = np.random.default_rng(5), problem.dimension, problem.contacts
    turn, gap = rng.standard_normal((n, n)), rng.standard_normal(m)
    gap[3] = 0.0
    found = dict(
        load=rng.standard_normal(n), gap=gap, tie_value=np.array([0.0, 1.0]), stiffness=turn + turn.T,
        rows=rng.standard_normal((m, n)),
    )  # fmt: skip
    if problem.frictional:
        found |= dict(friction=rng.random(m), slip_origin=rng.standard_normal((m, 1)))
    return found


@pytest.mark.sampled(2)
@pytest.mark.parametrize("rough", [False, True])
def test_derivatives_and_gradients_are_those_of_what_acts(rough: bool) -> None:
    few, whole = map(cq.solve, pair(rough))
    quantities = ("displacement", "normal_force", "tie_force", "gap", "reaction", "energy")
    for of in (*quantities, "friction_force", "slip") if rough else quantities:
        for parameter, direction in directions(whole.problem).items():
            true = few.derivative(of, parameter, part(parameter, direction))
            found = whole.derivative(of, parameter, direction)
            assert part(of, found.value) == pytest.approx(true.value, rel=1e-12, abs=1e-13)
            assert found.reach == (true.reach and pytest.approx(true.reach))
            if of not in ("gap", "slip"):
                assert part(of, found.bound) == pytest.approx(true.bound)
            if parameter == "tie_value":
                with pytest.raises(cq.InvalidProblem, match="tie 0 acts on nothing"):
                    whole.pullback(of, np.zeros(np.shape(found.value)), parameter)
                continue
            weights = np.resize([1.0, -2.0, 0.5], np.shape(found.value))
            if of in ("gap", "slip"):
                weights[[1, 3]] = 0.0
            gradient, bound = whole.pullback(of, weights, parameter, return_bound=True)
            gradient, bound = (one.toarray() if sp.issparse(one) else one for one in (gradient, bound))
            along = direction * (whole.problem.normal.toarray() != 0) if parameter == "rows" else direction
            assert np.sum(gradient * along) == pytest.approx(np.sum(weights * found.value), rel=1e-10)
            assert np.all(bound <= 1e-13 * np.max(abs(gradient), initial=1.0))
            if of not in ("gap", "slip") and parameter not in ("stiffness", "rows"):
                matrix, apart = whole.jacobian(of, parameter, return_bound=True)
                assert matrix @ np.ravel(direction) == pytest.approx(np.ravel(found.value), rel=1e-10, abs=1e-12)
                assert apart.shape == matrix.shape


@pytest.mark.sampled(2)
@pytest.mark.parametrize("rough", [False, True])
def test_gradients_and_jacobians_of_gaps_and_slips_there_are_those_of_derivatives(rough: bool) -> None:
    """With weights on what never closes and on a row of zeros, whose gap may change, too."""
    whole = cq.solve(pair(rough)[1])
    for of in ("gap", "slip") if rough else ("gap",):
        for parameter, direction in directions(whole.problem).items():
            if parameter == "tie_value":
                continue
            if parameter == "gap":
                direction[3] = 0.5
            found = whole.derivative(of, parameter, direction)
            weights = np.resize([1.0, -2.0, 0.5, 3.0], np.shape(found.value))
            gradient = whole.pullback(of, weights, parameter)
            gradient = gradient.toarray() if sp.issparse(gradient) else gradient
            along = direction * (whole.problem.normal.toarray() != 0) if parameter == "rows" else direction
            rate = whole.derivative(of, parameter, along) if parameter == "rows" else found
            assert np.sum(gradient * along) == pytest.approx(np.sum(weights * rate.value), rel=1e-10)
            if parameter not in ("stiffness", "rows"):
                matrix, bound = whole.jacobian(of, parameter, return_bound=True)
                assert matrix @ np.ravel(direction) == pytest.approx(np.ravel(found.value), rel=1e-10, abs=1e-12)
                assert np.all(bound <= 1e-13 * np.max(abs(matrix)))
            if not rough:
                far = whole.problem.replace(gap=np.where(np.isfinite(whole.problem.gap), whole.problem.gap, 2.0**40))
                true = cq.exact(far).derivative(of, parameter, direction)
                assert all(abs(Fraction(float(x)) - y) <= Fraction(float(bound)) for x, y, bound in zip(
                    found.value, true.value, found.bound, strict=True))  # fmt: skip
                assert found.reach is None or np.minimum(found.reach, 2.0**30) == pytest.approx(
                    [min(float(step), 2.0**30) for step in true.reach]
                )


@pytest.mark.parametrize("tangent", [[[1.0, 0.0]], np.eye(2)])
def test_friction_of_contacts_that_all_never_close_has_gradients(tangent: Any) -> None:
    alone = cq.solve(cq.ContactProblem(np.diag([2.0, 2.0]), [1.0, -2.0], [[0.0, 1.0]], [np.inf], tangent, 0.5))
    for parameter in ("load", "friction", "slip_origin", "gap", "stiffness"):
        gradient = alone.pullback("friction_force", np.ones_like(alone.friction_force), parameter)
        assert gradient.shape == np.shape(getattr(alone.problem, parameter))
        assert not np.any(gradient)


@pytest.mark.parametrize("rough", [False, True])
def test_gaps_that_never_close_and_slips_there_have_the_rates_of_the_displacement(rough: bool) -> None:
    whole = cq.solve(pair(rough)[1])
    moved = whole.derivative("displacement", "load", np.ones(4))
    gap = whole.derivative("gap", "load", np.ones(4))
    assert gap.value == pytest.approx(-(whole.problem.normal @ moved.value), abs=1e-14)
    assert np.all(gap.bound <= 1e-13)
    if rough:
        slip = whole.derivative("slip", "load", np.ones(4))
        assert slip.value.ravel() == pytest.approx(whole.problem.tangent @ moved.value, abs=1e-14)


def test_what_hardly_touches_is_told_from_what_grazes_beside_a_row_of_zeros() -> None:
    """A gap of 1e-16 is there, whatever else says nothing: the derivative exists, and its reach is as small."""
    K, rows = np.array([[3.0, -1.0], [-1.0, 2.0]]), [[1.0, 0.0], [0.0, 0.0]]
    free = cq.solve(cq.ContactProblem(K, [1.0, 1.0], rows, [np.inf, 1.0]))
    gap = np.nextafter(free.displacement[0], 1.0)
    found = cq.solve(free.problem.replace(gap=[gap, 1.0])).derivative("displacement", "load", [1.0, 0.0])
    assert found.value == pytest.approx([0.4, 0.2])
    assert 0.0 < found.reach[1] < 1e-15
    assert found.bound is not None


def test_a_row_of_zeros_that_its_gap_or_its_change_would_close_is_looked_at() -> None:
    body = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0], [0.0]], [1.0, 1.0]))
    assert body.derivative("displacement", "gap", [0.0, -1.0]).reach == pytest.approx((np.inf, 1.0))
    touching = cq.solve(cq.ContactProblem([[2.0]], [4.0], [[1.0], [0.0]], [3.0, 0.0]))
    answer = cq.exact(touching.problem)
    for parameter, direction in (("rows", [[0.0], [1.0]]), ("gap", [0.0, -1.0])):  # e u <= 0 holds a body that moved
        found, true = (one.derivative("displacement", parameter, direction) for one in (touching, answer))
        assert (found.right, found.value, true.value) == (None, None, None)
        assert "contact 1 acts on nothing that moves and has no gap" in found.reason
    assert touching.derivative("displacement", "gap", [1.0, 0.0]).value == pytest.approx([0.0])
    with pytest.raises(cq.InvalidProblem, match="contact 1 acts on nothing"):
        touching.pullback("displacement", [1.0], "gap")
    assert touching.pullback("displacement", [1.0], "rows").toarray().tolist() == [[0.0], [0.0]]


BETWEEN_WALLS = cq.ContactProblem([[2.0]], [0.0], [[1.0], [-1.0]], [0.0, 0.0])
PRESSED = cq.ContactProblem([[2.0]], [3.0], [[1.0], [0.0], [0.0]], [1.0, 0.0, 0.5])  # beside rows of zeros


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    ("problem", "direction", "missing"),
    [
        (BETWEEN_WALLS, [1.0, 0.0], "left"),
        (BETWEEN_WALLS, [-3.0, 1.0], "right"),
        (BETWEEN_WALLS.replace(tangent=[[0.0], [0.0]], friction=0.3), [1.0, 0.0], "left"),
        (PRESSED, [1.0, 1.0, -1.0], "left"),
        (PRESSED, [1.0, -1.0, 0.0], "right"),
        (PRESSED.replace(tangent=[[0.0]] * 3, friction=0.3), [1.0, -1.0, 0.0], "right"),
    ],
)
def test_a_side_without_an_answer_leaves_the_other_its_rate(
    problem: cq.ContactProblem, direction: list[float], missing: str
) -> None:
    """Walls that close up leave no room, nor does a row of zeros with a negative gap: there is no answer beyond."""
    solution, exact = cq.solve(problem), cq.exact(problem)
    step = Fraction(1, 8) * (-1 if missing == "left" else 1)
    with pytest.raises(cq.NoEquilibrium):
        cq.exact(problem.replace(gap=problem.gap + float(step) * np.array(direction)))
    beyond = cq.exact(problem.replace(gap=problem.gap - float(step) * np.array(direction)))
    for of in ("displacement", "gap"):
        found, truth = (one.derivative(of, "gap", direction) for one in (solution, exact))
        given = "left" if missing == "right" else "right"
        rate = (getattr(beyond, of) - getattr(exact, of)) / -step
        for one in (found, truth):
            assert (one.value, getattr(one, missing), one.exists) == (None, None, False)
            assert np.array_equal(getattr(one, given).astype(float), rate.astype(float)), (of, one)
            assert one.reach is None or one.reach[missing == "right"] == 0.0
        sides = {"left": "minus", "right": "plus"}
        assert found.reason.startswith(f"towards {sides[missing]} the direction: ")


def test_a_body_that_moves_freely_is_named_before_a_row_of_zeros() -> None:
    free = cq.ContactProblem([[1.0, -1.0], [-1.0, 1.0]], [1.0, -1.0], [[0.0, 0.0], [0.0, 1.0]], [0.0, 3.0])
    found = cq.solve(free).derivative("displacement", "gap", [1.0, 0.0])
    assert (found.value, found.left, found.right) == (None, None, None)
    assert found.reason.startswith("bodies are free to move")


def test_friction_on_supports_has_the_rates_of_the_law() -> None:
    """With a slip of 1/2 there friction is a quarter of a force that begins; without slip it may be anything."""
    foot = cq.ContactProblem(np.diag([4.0, 2.0]), [2.0, 0.0], [[0.0, -1.0]], [0.0], [[0.0, 0.0]], 0.25, [-0.5])
    grazing = cq.solve(foot).derivative("friction_force", "load", [0.0, -1.0])
    assert (grazing.left.tolist(), grazing.right.tolist(), grazing.exists) == ([[0.0]], [[0.25]], False)
    sticking = cq.solve(foot.replace(load=[2.0, -3.0], slip_origin=[0.0]))
    for found in (sticking, cq.exact(sticking.problem)):
        assert found.derivative("friction_force", "slip_origin", [1.0]).value is None
        assert not np.any(found.derivative("displacement", "slip_origin", [1.0]).value)
    with pytest.raises(cq.InvalidProblem, match="would have to slip"):
        sticking.pullback("friction_force", [[1.0]], "slip_origin")


def test_in_space_friction_turns_as_a_slip_begins_where_supports_hold_it() -> None:
    """Friction of 1/4, at most 1/2: as the origin moves by d across, the slip is (|d|/sqrt(3), -d), to either side."""
    tangent = [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    foot = cq.ContactProblem(np.diag([4.0, 4.0, 2.0]), [0.25, 0.0, -2.0], [[0.0, 0.0, -1.0]], [0.0], tangent, 0.25)
    across = cq.solve(foot).derivative("displacement", "slip_origin", [[0.0, 1.0]])
    assert (across.value, across.left, across.right) == (None, None, None)
    assert "would have to slip" in across.reason
    for far in (-(2.0**-20), 2.0**-20):
        moved = cq.solve(foot.replace(slip_origin=[[0.0, far]])).displacement[0]
        assert moved / abs(far) == pytest.approx(1 / np.sqrt(3.0), rel=1e-4)
    assert cq.solve(foot).derivative("displacement", "slip_origin", [[1.0, 0.0]]).value == pytest.approx([1.0, 0, 0])
