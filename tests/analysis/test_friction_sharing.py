"""Contacts with friction that share their forces have the rates of what is unique, and none of what is not."""

from __future__ import annotations

import math
from collections import Counter
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis import rate_systems, shared_forces
from contactqp.analysis.rate_data import REDUNDANT

K = np.array([[4.0, 1.0], [1.0, 3.0]])
FLOOR, WALL = ([0.0, -1.0], [1.0, 0.0]), ([1.0, 0.0], [0.0, 1.0])


def node(load: list[float], *sides: tuple[list[float], list[float]], friction: Any = 0.25) -> cq.ContactProblem:
    """Return one node that touches some sides, each a normal and a tangent."""
    normal, tangent = ([side[k] for side in sides] for k in (0, 1))
    return cq.ContactProblem(K, load, normal, np.zeros(len(sides)), tangent=tangent, friction=friction)


@pytest.mark.slow
@pytest.mark.parametrize(("force", "length"), [(1.0, 1.0), (2.0**-30, 2.0**30), (2.0**30, 2.0**-30)])
def test_a_node_in_a_corner_sticks_however_its_walls_share_the_load(force: float, length: float) -> None:
    problem = node([2.0, -3.0], FLOOR, WALL, friction=0.3)
    problem = problem.replace(stiffness=K * force / length, load=problem.load * force)
    answer = cq.solve(problem)
    assert "forces not unique" in answer.certificate.uniqueness
    for name, direction, moved, unit in (
        ("load", [1.0, 1.0], [0.0, 0.0], length / force), ("friction", [1.0, 2.0], [0.0, 0.0], length),
        ("stiffness", np.eye(2), [0.0, 0.0], length**2 / force), ("gap", [1.0, 1.0], [1.0, -1.0], 1.0),
    ):  # fmt: skip
        found = answer.derivative("displacement", name, direction)
        assert np.all(abs(found.value - moved) <= found.bound)
        assert np.max(found.bound) <= 1e-14 * unit
    load = answer.derivative("reaction", "load", [1.0, 1.0])
    assert load.value == pytest.approx([1.0, 1.0])
    for of in ("normal_force", "friction_force"):
        found = answer.derivative(of, "load", [1.0, 1.0])
        assert (found.value, found.right, found.reason) == (None, None, REDUNDANT)
    assert answer.pullback("reaction", [2.0, 3.0], "load") == pytest.approx([2.0, 3.0])
    with pytest.raises(cq.InvalidProblem, match="redundant"):
        answer.pullback("normal_force", [1.0, 0.0], "load")
    with pytest.raises(cq.InvalidProblem, match="redundant"):
        answer.pullback("displacement", [1.0, 0.0], "gap")


@pytest.mark.slow
@pytest.mark.parametrize("pull", [0.25, 0.75, 2.0])
def test_the_same_floor_twice_has_the_rates_of_one(pull: float) -> None:
    """At 0.75, the bound of 0.25 x 3, to either side; of slips it is by the coefficient of both."""
    K_plain = np.diag([4.0, 3.0])
    one = cq.ContactProblem(K_plain, [pull, -3.0], [FLOOR[0]], [0.0], tangent=[FLOOR[1]], friction=0.25)
    two = cq.ContactProblem(K_plain, [pull, -3.0], [FLOOR[0]] * 2, [0.0] * 2, tangent=[FLOOR[1]] * 2, friction=0.25)
    answer, truth = cq.solve(two), cq.exact(one, enclose=False)
    for name, direction, of_one in (
        ("load", [1.0, 1.0], [1.0, 1.0]), ("gap", [1.0, 1.0], [1.0]), ("gap", [3.0, 1.0], None),
        ("slip_origin", [[1.0], [1.0]], [[1.0]]), ("friction", 1.0, [1.0]), ("stiffness", np.eye(2), np.eye(2)),
    ):  # fmt: skip
        for of in ("displacement", "reaction", "energy"):
            found = answer.derivative(of, name, direction)
            if of_one is None:  # the nearer one is the floor: ahead that of 1, back that of 3
                sides = [truth.derivative(of, name, [size]) for size in (3.0, 1.0)]
                exact = sides[0].left, sides[1].right
            elif name == "friction" and pull == 0.75:  # what slips would take more or less, as forces are shared
                assert found.reason == REDUNDANT
                continue
            else:
                side = truth.derivative(of, name, of_one)
                exact = side.left, side.right
            for rate, expected in zip((found.left, found.right), exact, strict=True):
                assert np.asarray(rate) == pytest.approx(np.asarray(expected, dtype=float), abs=1e-12)


@pytest.mark.slow
def test_a_tie_across_a_sticking_contact_takes_a_share_of_its_friction_alone() -> None:
    tied = cq.solve(
        cq.ContactProblem(K, [0.2, -3.0], [FLOOR[0]], [0.0], [FLOOR[1]], 0.3, tie=[[1.0, 0.0]], tie_value=[0.0])
    )
    assert tied.derivative("normal_force", "load", [0.0, -1.0]).value == pytest.approx([1.0])
    assert tied.derivative("friction_force", "load", [1.0, 0.0]).reason == REDUNDANT
    assert tied.derivative("tie_force", "load", [1.0, 0.0]).reason == REDUNDANT
    # As the tie moves the contact begins to slip.
    moved = tied.derivative("displacement", "tie_value", [1.0])
    assert (moved.left, moved.right) == (pytest.approx([1.0, 0.0]), pytest.approx([1.0, 0.0]))


@pytest.mark.slow
def test_a_node_at_the_bound_of_its_floor_slips_away_from_the_wall_and_not_towards_it() -> None:
    corner = cq.solve(cq.ContactProblem(np.diag([4.0, 3.0]), [-0.75, -3.0], *_sides(FLOOR, WALL), friction=0.25))
    found = corner.derivative("displacement", "load", [1.0, 0.0])
    assert (found.left, found.right) == (pytest.approx([0.25, 0.0]), pytest.approx([0.0, 0.0], abs=1e-14))


def _sides(*sides: tuple[list[float], list[float]]) -> tuple[Any, Any, Any]:
    return [side[0] for side in sides], [0.0] * len(sides), [side[1] for side in sides]


@pytest.mark.slow
def test_floors_of_other_coefficients_that_may_let_go_have_no_rates() -> None:
    """A load of 0.2 under 3 sticks by the one of 0.3, and slips where the smooth one takes more than 2.33."""
    for load in ([0.2, -3.0], [1.5, -3.0]):
        smooth = cq.solve(node(load, FLOOR, FLOOR, friction=[0.3, 0.0]))
        found = smooth.derivative("displacement", "load", [1.0, 0.0])
        assert (found.value, found.left, found.right, found.exists) == (None, None, None, False)
        assert found.reason


@pytest.mark.slow
def test_floors_without_friction_share_what_a_coefficient_of_one_of_them_makes() -> None:
    """Of 2 on two smooth floors a coefficient of one changes the displacement by -l_1/2, 0 to -1, one of both by -1."""
    floors = dict(normal=[FLOOR[0]] * 3, gap=[0.0, 0.0, 9.0], tangent=[FLOOR[1]] * 3, friction=[0.0, 0.0, 0.5])
    smooth = cq.ContactProblem(np.diag([2.0, 2.0]), [1.0, -2.0], **floors)
    for answer in (cq.solve(smooth), cq.exact(smooth)):
        for of in ("displacement", "reaction", "friction_force"):
            one, both = (answer.derivative(of, "friction", way) for way in ([1.0, 0.0, 0.0], [1.0, 1.0, 0.0]))
            assert (one.value, one.left, one.right, one.exists) == (None, None, None, False)
            assert both.exists == (of != "friction_force")
        assert [float(x) for x in answer.derivative("displacement", "friction", [1, 1, 0]).value] == [-1.0, 0.0]
    assert not np.any(cq.solve(smooth).derivative("friction_force", "load", [1.0, 0.0]).value)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("blind", [False, True])
def test_other_states_that_exert_the_same_force_are_not_overlooked(
    blind: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Taken for steady, the floor that may let go would have the rates of one that sticks."""
    if blind:
        monkeypatch.setattr(shared_forces.Group, "is_steady", lambda *_: True)
    smooth = cq.solve(node([0.2, -3.0], FLOOR, FLOOR, friction=[0.3, 0.0]))
    assert (smooth.derivative("displacement", "load", [1.0, 0.0]).value is None) != blind


IN_SPACE = (
    ([0.0, 0.0, -1.0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    ([0.0, 1.0, 0.0], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
)


def edge(load: list[float], friction: Any = 0.3) -> cq.Solution:
    normal, tangent = [one for one, _ in IN_SPACE], [row for _, rows in IN_SPACE for row in rows]
    return cq.solve(cq.ContactProblem(np.diag([4.0, 3.0, 5.0]), load, normal, [0.0, 0.0], tangent, friction))


@pytest.mark.slow
def test_an_edge_in_space_holds_a_node_until_it_slips_along_it() -> None:
    held = edge([0.2, 3.0, -3.0])
    assert held.contact_status.tolist() == ["stick", "stick"]
    found = held.derivative("displacement", "load", [1.0, 1.0, 1.0])
    assert found.value == pytest.approx([0.0, 0.0, 0.0], abs=1e-14)
    assert np.max(found.bound) < 1e-15
    assert found.reach is None  # cones in space are no polyhedra
    assert held.derivative("reaction", "load", [1.0, 2.0, 3.0]).value == pytest.approx([1.0, 2.0, 3.0])
    assert held.derivative("normal_force", "load", [1.0, 1.0, 1.0]).reason == REDUNDANT
    assert held.derivative("displacement", "gap", [1.0, 1.0]).reason == REDUNDANT
    assert held.pullback("reaction", [1.0, 2.0, 3.0], "load") == pytest.approx([1.0, 2.0, 3.0])
    # It slips along the edge by (5 - 0.3 x 6)/4, and along the load at a quarter of its rate.
    slid = edge([5.0, 3.0, -3.0])
    assert slid.derivative("displacement", "load", [1.0, 0.0, 0.0]).value == pytest.approx([0.25, 0.0, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("blind", [False, True])
def test_slips_that_may_begin_in_space_are_not_overlooked(blind: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two floors the smooth one may take so much that the other lets go, in the direction of what pulls."""
    if blind:
        monkeypatch.setattr(shared_forces.Group, "may_move", lambda *_: False)
        monkeypatch.setattr(shared_forces.Group, "is_steady", lambda *_: True)
    normal, tangent = IN_SPACE[0]
    floors = [normal] * 2, [0.0, 0.0], tangent * 2, [0.3, 0.0]
    smooth = cq.solve(cq.ContactProblem(np.diag([4.0, 3.0, 5.0]), [0.2, 0.1, -3.0], *floors))
    assert (smooth.derivative("displacement", "load", [1.0, 0.0, 0.0]).value is None) != blind


def in_corners(rng: np.random.Generator) -> cq.ContactProblem:
    """Draw nodes that touch up to three walls each, some of them the same, with coefficients of their own and ties."""
    nodes = int(rng.integers(1, 4))
    n = 2 * nodes + int(rng.integers(0, 2))
    shape = rng.integers(-2, 3, (n, n))
    walls = (FLOOR, WALL, ([-1.0, 0.0], [0.0, 1.0]), ([0.6, 0.8], [-0.8, 0.6]), ([0.0, 1.0], [1.0, 0.0]))
    normal, tangent = [], []
    for k in range(nodes):
        for _ in range(int(rng.choice([1, 2, 2, 3]))):
            pair = np.zeros((2, n))
            pair[:, 2 * k : 2 * k + 2] = walls[rng.integers(0, 3 if rng.random() < 0.7 else 5)]
            normal, tangent = [*normal, pair[0]], [*tangent, pair[1]]
    m = len(normal)
    friction = rng.choice([0.25, 0.5, 0.125, 0.0], m) if rng.random() < 0.5 else np.full(m, rng.choice([0.25, 0.5]))
    tie = dict(tie=[tangent[rng.integers(0, m)]], tie_value=[0.0]) if rng.random() < 0.3 else {}
    gap = 0.25 * (rng.random(m) < 0.2)
    return cq.ContactProblem(
        (shape @ shape.T + 2 * np.eye(n)).astype(float), rng.integers(-4, 5, n).astype(float), np.array(normal), gap,
        np.array(tangent), friction, **tie,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 150])
def test_rates_where_forces_are_shared_are_differences_of_answers(first: int) -> None:
    seen: Counter[str] = Counter()
    for seed in range(first, first + 150):
        rng, step = np.random.default_rng(seed), 2.0**-20
        problem = in_corners(rng)
        if not problem.frictional:
            continue
        try:
            answer = cq.solve(problem)
        except cq.ContactQPError:
            continue
        if answer.certificate.uniqueness != ("forces not unique",):
            continue
        m = problem.contacts
        along = dict(load=rng.standard_normal(problem.dimension), gap=rng.standard_normal(m),
                     friction=rng.uniform(0, 1, m) * (problem.friction > 0))  # fmt: skip
        for name, direction in along.items():
            found = answer.derivative("displacement", name, direction)
            seen[f"{name} {found.right is not None}"] += 1
            for sign, rate in ((-1, found.left), (1, found.right)):
                if rate is not None:
                    changed = problem.replace(**{name: getattr(problem, name) + sign * step * direction})
                    moved = cq.solve(changed, warm_start=answer).displacement - answer.displacement
                    assert rate == pytest.approx(moved / (sign * step), abs=1e-3 * max(1, np.max(abs(moved)) / step))
    assert seen["load True"] >= 4
    assert seen["load False"] <= 1  # a tie that presses a contact without force against its wall may hold any friction
    assert seen["gap True"] + seen["friction True"] >= 5


def rate_of(problem: cq.ContactProblem, of: str, name: str, step: Any) -> Any:
    """Return by how much an exact answer changes as one of a problem's arrays does, exactly."""
    there, here = (cq.exact(one, enclose=False) for one in (problem.replace(**{name: step}), problem))
    return np.array(getattr(there, of), dtype=object) - np.array(getattr(here, of), dtype=object)


def fractions(values: Any) -> Any:
    return np.array([Fraction(x) for x in np.ravel(values).tolist()], dtype=object).reshape(np.shape(values))


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 2.0**-30, 2.0**30])
def test_a_node_that_grazes_both_walls_of_a_corner_has_unique_forces_to_either_side(scale: float) -> None:
    """Pushed to one wall it leaves the other: rows of both depend on one another, but nothing is shared."""
    at = np.array([2.0, -1.0])
    corner = cq.ContactProblem(
        K * scale, K @ at * scale, [FLOOR[0], WALL[0]], [1.0, 2.0], [FLOOR[1], WALL[1]], 0.25,
        slip_origin=[[2.0], [-1.0]],
    )  # fmt: skip
    answer = cq.solve(corner)
    assert answer.contact_status.tolist() == ["grazing", "grazing"]
    back = dict(displacement=[(7, 15), (0, 1)], normal_force=[(-8, 15), (0, 1)], friction_force=[(2, 15), (0, 1)])
    ahead = dict(displacement=[(0, 1), (2, 11)], normal_force=[(0, 1), (20, 11)], friction_force=[(0, 1), (5, 11)])
    for of in ("displacement", "normal_force", "friction_force"):
        found, unit = answer.derivative(of, "load", [2.0 * scale, scale]), 1.0 if of == "displacement" else scale
        assert found.reach == (np.inf, np.inf)
        for rate, ratios in ((found.left, back[of]), (found.right, ahead[of])):
            exact = np.array([Fraction(*ratio) * Fraction(unit) for ratio in ratios])
            assert np.all(abs(fractions(np.ravel(rate)) - exact) <= np.ravel(found.bound))
            assert np.max(found.bound) <= 1e-14 * unit


def in_units(problem: cq.ContactProblem, force: float, length: float) -> cq.ContactProblem:
    return cq.ContactProblem(
        problem.stiffness_rows.toarray() * (force / length), problem.load * force, problem.normal, problem.gap * length,
        problem.tangent, problem.friction, tie=problem.tie, tie_value=problem.tie_value * length,
    )  # fmt: skip


UNITS = [(1.0, 1.0), (2.0**-30, 2.0**10), (2.0**30, 2.0**-30)]


@pytest.mark.slow
@pytest.mark.parametrize(("seeds", "units"), [((0, 60), UNITS[0]), ((60, 100), UNITS[1]), ((60, 100), UNITS[2])])
def test_shared_forces_have_bounds_above_the_error_and_reach_as_far_as_answers_say(
    seeds: tuple[int, int], units: tuple[float, float]
) -> None:
    """The rates hold exactly within the reach, unless other answers come up, and beyond it no more."""
    seen: Counter[str] = Counter()
    for seed in range(*seeds):
        rng = np.random.default_rng(seed)
        problem = in_corners(rng)
        if not problem.frictional:
            continue
        problem = in_units(problem, *units)
        answer, known = cq.solve(problem), cq.exact(problem, enclose=False)
        size = float(np.max(abs(answer.displacement))) or units[1]
        same = np.max(abs(np.array(known.displacement, dtype=float) - answer.displacement)) <= 1e-9 * size
        if "forces not unique" not in answer.certificate.uniqueness or not same:
            continue
        for name, unit in (("load", units[0]), ("gap", units[1])):
            direction = rng.integers(-8, 9, np.shape(getattr(problem, name))) / 4 * unit
            found = answer.derivative("displacement", name, direction)
            if found.bound is None or found.reach is None:
                seen["bound"] += found.left is not None
                assert found.left is found.right is None or found.bound_reason
                continue
            for sign, rate, reach in ((-1, found.left, found.reach[0]), (1, found.right, found.reach[1])):
                if rate is None:  # no answer on this side
                    with pytest.raises(cq.NoEquilibrium):
                        cq.solve(problem.replace(**{name: getattr(problem, name) + sign * 2.0**-20 * direction}))
                    continue
                step = 2.0 ** np.floor(np.log2(min(0.99 * reach, 1.0)) - 10)
                there = getattr(problem, name) + sign * step * direction
                exact = rate_of(problem, "displacement", name, there) / (sign * Fraction(step))
                assert np.all(abs(fractions(rate) - exact) <= found.bound)
                assert np.max(found.bound) <= 1e-13 * max(float(np.max(abs(rate))), size)
                seen[name] += 1
                if np.isfinite(reach):
                    there = getattr(problem, name) + sign * reach * (1 + 2.0**-10) * direction
                    try:
                        beyond = rate_of(problem, "displacement", name, there)
                    except cq.NoEquilibrium:
                        seen["ends"] += 1
                        continue
                    beyond = beyond / (sign * Fraction(reach * (1 + 2.0**-10)))
                    seen["ends" if np.max(abs(beyond - exact)) > 1e-9 * np.max(abs(rate)) else "goes on"] += 1
    assert min(seen["load"], seen["gap"]) >= (seeds[1] - seeds[0]) // 6
    assert seen["ends"] >= 20 * seen["goes on"]
    assert seen["ends"] >= 2


def test_exact_rates_are_those_of_all_ways_to_share() -> None:
    """A node in a corner, and one floor twice, whose first may let go: displacements and the energy have rates."""
    corner = cq.exact(node([2.0, -3.0], FLOOR, WALL, friction=0.3))
    moved = corner.derivative("displacement", "gap", [1, 1])
    assert moved.value.tolist() == [1, -1]
    assert corner.derivative("reaction", "load", [1, 1]).value.tolist() == [1, 1]
    assert corner.derivative("normal_force", "load", [1, 1]).reason.endswith(
        "redundant, and their forces are not unique"
    )
    stuck = corner.derivative("displacement", "load", [0, 1])
    # Upwards, until the floor pushes no more: the wall, which carries 2, holds 0.6 by friction, and the load is -3.
    assert stuck.reach == (math.inf, 3 + Fraction(0.3) * 2)
    floors = cq.exact(node([0.0, -3.0], FLOOR, FLOOR))
    lifted = floors.derivative("displacement", "gap", [1, 0])
    assert (lifted.left.tolist(), lifted.right.tolist()) == ([0, -1], [0, 0])


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 60])
def test_exact_rates_where_forces_are_shared_are_those_in_doubles_and_differences_of_exact_answers(first: int) -> None:
    seen: Counter[str] = Counter()
    step = Fraction(1, 2**22)
    for seed in range(first, first + 60):
        rng = np.random.default_rng(seed)
        problem = in_corners(rng)
        if not problem.frictional:
            continue
        answer, known = cq.solve(problem), cq.exact(problem, enclose=False)
        unlike = np.max(abs(np.array(known.displacement, dtype=float) - answer.displacement))
        if answer.certificate.uniqueness != ("forces not unique",) or unlike > 1e-9 * np.max(abs(answer.displacement)):
            continue
        m = problem.contacts
        along = dict(load=rng.integers(-8, 9, problem.dimension) / 4, gap=rng.integers(-8, 9, m) / 4,
                     slip_origin=rng.integers(-8, 9, (m, 1)) / 4,
                     friction=rng.integers(0, 5, m) / 8 * (problem.friction > 0))  # fmt: skip
        for name, direction in along.items():
            found, exact = (one.derivative("displacement", name, direction) for one in (answer, known))
            assert found.right is None or exact.right is not None
            if exact.right is None:
                continue
            for sign, side, true in ((-1, found.left, exact.left), (1, found.right, exact.right)):
                assert side is None or side == pytest.approx(true.astype(float), abs=1e-9 * max(1, np.max(abs(side))))
                there = getattr(problem, name) + sign * float(step) * direction
                moved = rate_of(problem, "displacement", name, there) / (sign * step)
                assert np.max(abs(moved - true)) <= 1e-4 * max(1, np.max(abs(true)))
                seen[name] += 1
            if found.reach is not None:
                per_step = [[float(1 / end) if end else np.inf for end in pair] for pair in (found.reach, exact.reach)]
                np.testing.assert_allclose(*per_step, rtol=1e-8, atol=1e-12)
                seen["reach"] += 1
    assert min(seen[name] for name in ("load", "gap", "slip_origin", "friction", "reach")) >= 4


@pytest.mark.slow
@pytest.mark.parametrize("blind", [False, True])
def test_of_floors_that_move_hardly_apart_it_is_not_told_which_holds(
    blind: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The least system that fits both holds neither to twice double precision, and proves nothing."""
    if blind:
        monkeypatch.setattr(rate_systems, "all_held", lambda *_: True)
    answer = cq.solve(node([2.0, -3.0], FLOOR, FLOOR))
    found = answer.derivative("displacement", "gap", [1.0, 1.0 + 2.0**-40])
    assert (found.bound is not None) == blind
    assert blind or "share forces" in found.bound_reason
    assert answer.derivative("displacement", "gap", [1.0, 1.0]).bound is not None


@pytest.mark.slow
def test_held_rows_that_are_independent_may_push_along_ones_that_are_not() -> None:
    """With a coefficient of one a slip pushes along the row that a tie holds: the least system holds nothing then."""
    held = cq.ContactProblem(
        [[0.0, 0.0], [0.0, 8.0]], [3.03125, -5.03125], [[-1.0, -1.0], [2.0, -1.0], [0.0, 2.0]], [0.5, 0.5, -1.0],
        [[-2.0, 0.0], [0.0, -2.0], [-1.0, 1.0]], [1.0, 1.0, 0.0625], [[0.25], [1.0], [-0.5]],
        tie=[[0.0, -1.0]], tie_value=[0.5],
    )  # fmt: skip
    found = cq.solve(held).derivative("displacement", "load", [-1.0, -1.0])
    assert found.value == pytest.approx([0.0, 0.0], abs=1e-14)
    assert "share forces" in found.bound_reason
