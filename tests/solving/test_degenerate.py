"""Redundant, conflicting, nearly equal and far-apart rows; soft supports; stacks of loose bodies: right or refused."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import block_diag

import contactqp as cq
from contactqp.certificate import bounds
from contactqp.linalg import interior_point, least_norm, refinement
from contactqp.linalg.condensation import condense
from contactqp.linalg.equilibration import affordable_systems, equilibrated
from contactqp.linalg.extended import ExtendedAnswer
from contactqp.linalg.factorization import null_space
from contactqp.linalg.sparse_saddle import Effort
from contactqp.model.solution import Answer


def test_of_two_parallel_contacts_the_nearer_carries() -> None:
    """The stops are 8e-15 apart, and the farther one has the larger row."""
    problem = cq.ContactProblem(np.eye(2), [-5e4, 1e4], [[0.0, 128.0], [0.0, 1 / 64]], [1e-12, 0.0])
    solution = cq.solve(problem)
    assert solution.normal_force == pytest.approx([0.0, 640000.0], rel=1e-12)
    assert solution.certificate.proven


@pytest.mark.parametrize("d", [1e-13, 1e-9, 1e-8, 1e-7])
def test_dependent_rows_that_differ_in_their_last_digits(d: float) -> None:
    """A tie and two contacts say u1 <= -d, a third contact u1 <= 0: the third never carries."""
    K = [[2.0, -1.0, 0.0], [-1.0, 3.0, -1.0], [0.0, -1.0, 1.0]]
    E = [[1.0, -1.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 1.0]]
    solution = cq.solve(cq.ContactProblem(K, [0.0, -1.0, 8000.0], E, [0.5, 0.0, -d], tie=[[-1.0, -1.0, 1.0]]))
    assert solution.normal_force[1] == 0.0
    assert solution.displacement[1] == pytest.approx(-d, rel=1e-9)
    assert solution.certificate.proven


def test_what_cannot_be_repaired_does_not_pass() -> None:
    """Opposite walls that leave no room: no displacement near the candidate is feasible, and that speaks against it."""
    problem = cq.ContactProblem(np.eye(1), [0.0], [[1.0], [-1.0]], [1.0, -1.0 - 1e-12])
    certificate = cq.certify(problem, [1.0], [0.0, 1.0])
    assert not certificate.passed
    assert not certificate.proven


def test_conflicts_by_a_hair_are_named() -> None:
    problem = cq.ContactProblem(np.eye(2), [0.0, 0.0], [[1.0, 0.0], [-1.0, 0.0]], [1.0, -1.0 - 1e-8])
    with pytest.raises(cq.NoEquilibrium, match="contact 0, contact 1"):
        cq.solve(problem)


@pytest.mark.parametrize("softness", [1e-9, 1e-12])
@pytest.mark.parametrize("springs", [100, 1000])
def test_a_soft_support_is_a_support(springs: int, softness: float) -> None:
    """Its force is spread over all unknowns of the lowest motion; its energy is not."""
    K = sp.diags([np.r_[1.0, np.full(springs - 1, 2.0), 1.0], -np.ones(springs), -np.ones(springs)], [0, 1, -1]).tolil()
    assert null_space(K).count == 1
    K[0, 0] += softness
    assert null_space(K).count == 0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("stiffness", [(1e6, 1e-6, 1e6), (1e-6, 1e6, 1e-6), (1.0, 1e9, 1e-3, 1e6, 1e-9, 1.0)])
def test_stacks_of_loose_bodies_with_far_apart_stiffness(stiffness: tuple[float, ...]) -> None:
    """Each block of two masses and a spring rests on the one before: forces 2, 4, ... from the top."""
    count = len(stiffness)
    K = block_diag(*(k * np.array([[1.0, -1.0], [-1.0, 1.0]]) for k in stiffness))
    E = np.zeros((count, 2 * count))
    E[0, 0] = -1.0
    for i in range(1, count):
        E[i, 2 * i - 1], E[i, 2 * i] = 1.0, -1.0
    problem = cq.ContactProblem(K, np.full(2 * count, -1.0), E, np.zeros(count))
    assert cq.solve(problem).normal_force == pytest.approx([2.0 * (count - i) for i in range(count)], rel=1e-9)


def test_forces_on_rigid_motions_strain_nothing_and_pass() -> None:
    mass = cq.ContactProblem(
        np.diag([2.0, 2.0, 0.0]), [1.0, 0.0, -10.0], [[1.0, 1.0, -1.0]], [0.0], tie=[[1.0, 1.0, 0.0]]
    )
    solution = cq.solve(mass)
    assert solution.normal_force == pytest.approx([10.0])
    assert not cq.certify(mass, solution.displacement, [10.01], tie_force=solution.tie_force).passed


def test_rows_whose_squares_are_no_doubles_count() -> None:
    solution = cq.solve(cq.ContactProblem([[1.0]], [1.0], [[1e-300]], [1e-301]))
    assert solution.displacement == pytest.approx([0.1])
    assert solution.normal_force == pytest.approx([0.9e300])
    assert solution.certificate.proven


@pytest.mark.parametrize(
    "argument",
    [dict(tolerance=float("nan")), dict(tolerance="a"), dict(max_iter=0), dict(polish="no"), dict(condense=1),
     dict(warm_start=3), dict(time_limit=-1.0)],
)  # fmt: skip
def test_arguments_are_checked(argument: dict[str, object]) -> None:
    problem = cq.ContactProblem([[1.0]], [1.0], [[1.0]], [0.1])
    with pytest.raises(cq.InvalidProblem):
        cq.solve(problem, **argument)  # type: ignore[arg-type]


def test_a_thousand_unknowns_held_by_contact_alone() -> None:
    """A floating chain of 1000 springs pressed on a wall: the wall carries the whole load."""
    n = 1001
    K = sp.diags([np.r_[1.0, np.full(n - 2, 2.0), 1.0], -np.ones(n - 1), -np.ones(n - 1)], [0, 1, -1])
    problem = cq.ContactProblem(K.tocsc(), np.full(n, 1e-3), np.eye(1, n, n - 1), [0.5])
    solution = cq.solve(problem)
    assert solution.normal_force == pytest.approx([1.001], rel=1e-12)
    assert solution.certificate.proven


def test_a_loose_body_beside_a_touching_one_stays_at_its_least_displacement() -> None:
    """Two floating springs: one is pressed on a stop, the other, under balanced loads, is free."""
    K = block_diag(*(k * np.array([[1.0, -1.0], [-1.0, 1.0]]) for k in (9.0, 4.0)))
    E = [
        [-1.0, 1.0, 1.0, 1.0],
        [1.0, -1.0, 0.0, 0.0],
        [-1.0, -1.0, 0.0, -1.0],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 1.0, -1.0, 0.0],
    ]
    solution = cq.solve(cq.ContactProblem(K, [-4.0, 4.0, 0.0, 8.0], E, [2.0, 0.0, 0.0, 0.0, 1.0]))
    assert solution.displacement == pytest.approx([-2 / 9, 2 / 9, 0.0, 0.0], abs=1e-15)
    assert [motion.description for motion in solution.free_motions] == ["unknown 0 by +1, unknown 1 by +1"]


def test_nothing_moves_and_nothing_pushes() -> None:
    """A tie takes the whole load: the displacement is zero, and so are its energy and the contact forces."""
    problem = cq.ContactProblem(
        [[8.0, -8.0], [-8.0, 9.0]],
        [-6.0, 6.0],
        [[-1.0, 1.0], [0.0, -1.0], [1.0, -1.0]],
        [0.0, 0.0, 1.0],
        tie=[[1.0, -1.0]],
    )
    solution = cq.solve(problem)
    assert solution.tie_force == pytest.approx([-6.0])
    assert not np.any(solution.displacement)
    assert not cq.certify(problem, [1e-3, 1e-3], np.zeros(3), tie_force=[-6.0]).passed


@pytest.mark.parametrize("rows", [[1.0], [1.0, 2.0, 3.0]])
def test_what_condensation_leaves_of_a_floating_chain_is_no_stiffness(rows: list[float]) -> None:
    """A chain that only the contacts at its end hold: S is a rounding of zero, one number, and its own scale."""
    springs = np.array([12.44140625, 1404.8125, 36.080078125, 44.43359375, 27.37109375])
    K = sp.diags([np.r_[springs, 0.0] + np.r_[0.0, springs], -springs, -springs], [0, 1, -1])
    load = np.array([0.0322265625, 14.34375, 1.40625, 2.25, -1.53125, -5.859375])
    normal = np.zeros((len(rows), 6))
    normal[:, 5] = rows
    problem = cq.ContactProblem(stiffness=K, load=load, normal=normal, gap=0.0185546875 * np.array(rows))
    assert condense(problem).rigid.count == 1
    solution = cq.solve(problem)
    assert solution.certificate.passed
    assert solution.normal_force @ rows == load.sum()
    off = cq.certify(problem, solution.displacement, solution.normal_force * (1 + 1e-12))
    assert off.force_error is not None
    assert off.force_error > 0.9e-12


@pytest.mark.parametrize("seed", [11, 76, 81, 114, 186])
def test_grazing_of_two_chains_is_decided_beneath_the_rounding_of_doubles(seed: int) -> None:
    """The gap is the approach rounded: rationals say whether the chains touch, with forces of 1e-12 beside 1e3."""
    pytest.importorskip("flint")
    rng = np.random.default_rng(seed)
    first, second = rng.integers(1, 12, 2)
    K = np.zeros((first + second, first + second))
    for start, size in ((0, first), (first, second)):
        for i, spring in enumerate(10 ** rng.uniform(0, 6, size)):
            at = start + i
            K[at, at] += spring
            if i:
                K[at - 1, at - 1] += spring
                K[at, at - 1] = K[at - 1, at] = -spring
    load = np.zeros(first + second)
    load[rng.integers(0, first + second, 3)] = rng.normal(size=3) * 10 ** rng.uniform(-2, 4, 3)
    row = np.zeros(first + second)
    row[[first - 1, -1]] = 1.0, -1.0
    problem = cq.ContactProblem(K, load, [row], [row @ np.linalg.solve(K, load)])
    solution, exact = cq.solve(problem), cq.exact(problem)
    assert solution.certificate.passed
    assert solution.normal_force[0] == pytest.approx(float(exact.normal_force[0]), rel=1e-9, abs=0)


def _floating_chain(rng: np.random.Generator) -> tuple[cq.ContactProblem, np.ndarray]:
    """A chain of springs that floats, pins without stiffness joined to it by rods, the last stopped where it stands.

    All numbers are few bits, so that loads and gaps belong to the displacement that comes with it exactly.
    """
    n, pins = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    K = np.zeros((n + pins, n + pins))
    for i in range(n - 1):
        K[i : i + 2, i : i + 2] += (
            float(rng.integers(1, 8)) * 2.0 ** float(rng.integers(-4, 5)) * np.array([[1, -1], [-1, 1]])
        )
    u = rng.integers(-8, 9, n + pins) / 8
    u[-1] = 0.0
    rods = np.zeros((pins, n + pins))
    for rod, (one, other) in zip(rods, zip([0, *range(n, n + pins - 1)], range(n, n + pins), strict=True), strict=True):
        rod[[one, other]] = rng.integers(1, 5) / 2, -rng.integers(1, 5) / 2
    rows = np.eye(n + pins)[[n + pins - 1, int(rng.integers(0, n + pins))]] * [[1.0], [-1.0]]
    load = K @ u + rows.T @ (rng.integers(4, 16, 2) / 8) + rods.T @ (rng.integers(-8, 9, pins) / 8)
    return cq.ContactProblem(K, load, rows, rows @ u, tie=rods, tie_value=rods @ u), u


@pytest.mark.slow
@pytest.mark.parametrize("method", ["active-set", "lemke"])
def test_contacts_on_pins_that_are_tied_to_what_floats(method: str) -> None:
    rng, solved = np.random.default_rng(26), 0
    for _ in range(40):
        problem, u = _floating_chain(rng)
        found = cq.solve(problem, method)
        assert found.certificate.passed
        assert found.work.routes == ()
        if not found.free_motions:
            assert found.displacement == pytest.approx(u, abs=1e-12)
            solved += 1
    assert solved > 20


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 4.0**40, 4.0**-150])
def test_a_contact_where_a_tie_holds_on_a_frame_that_floats(unit: float) -> None:
    """Force on the stop and force in the tie are one, and the least is none on the stop, in any unit."""
    frame = np.array(
        [
            [2, 1, -1, 0, 0, 0, -1, -1],
            [1, 2, 0, 0, 0, -1, -1, -1],
            [-1, 0, 2, -1, -1, 1, 0, 0],
            [0, 0, -1, 2, 1, -1, 0, -1],
            [0, 0, -1, 1, 2, -1, -1, 0],
            [0, -1, 1, -1, -1, 2, 0, 0],
            [-1, -1, 0, 0, -1, 0, 2, 1],
            [-1, -1, 0, -1, 0, 0, 1, 2],
        ]
    )
    K, one = np.zeros((9, 9)), np.eye(9)
    K[:8, :8] = frame
    load = unit * np.array([0, -0.21875, -0.25, 0, 0, 0, 0, 0, 0.125])
    problem = cq.ContactProblem(
        K, load, [one[2], one[4], -one[1]], np.zeros(3), tie=one[[8, 2]], tie_value=[0.75 * unit, 0]
    )
    found = cq.solve(problem)
    assert found.work.routes == ()
    assert found.normal_force / unit == pytest.approx([0, 0, 0.21875], abs=1e-15)
    assert found.tie_force / unit == pytest.approx([0.125, -0.25], abs=1e-15)
    assert len(found.free_motions) == 1


@pytest.mark.slow
@pytest.mark.parametrize("rows", [(1.0, 1.0), (2.0**23, 2.0**-7), (2.0**-30, 2.0**30)])
@pytest.mark.parametrize("method", ["active-set", "lemke", "lagrange-multiplier", "clarabel"])
def test_nothing_but_gaps_moves_what_has_no_stiffness_whatever_the_units_of_rows(
    rows: tuple[float, float], method: str
) -> None:
    scale = np.array([2.0**19, *rows])
    normal, gap = np.diag([1.0, -1.0, -1.0]) * scale[:, None], np.array([0.0, -0.5, -0.375]) * scale
    solution = cq.solve(cq.ContactProblem(np.diag([7.75, 0.0, 0.0]), np.zeros(3), normal, gap), method)
    np.testing.assert_allclose(solution.displacement, [0.0, 0.5, 0.375], rtol=1e-15, atol=1e-16)
    assert np.max(abs(solution.normal_force)) <= 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("force", [2.0**-80, 2.0**-40, 1.0, 2.0**60])
@pytest.mark.parametrize("length", [1.0, 2.0**-30])
def test_loads_on_what_has_no_stiffness_beside_a_body_that_nothing_touches(force: float, length: float) -> None:
    """What stands on the floor has no stiffness, and what has one touches nothing: no unit makes either a rounding."""
    problem = cq.ContactProblem(
        stiffness=np.diag([0.0, 0.0, 304.0]) * force / length,
        load=np.array([0.0859375, 3.75, -190.0]) * force,
        normal=[[0.0, 1.0, 0.0]],
        gap=[-0.875 * length],
        tangent=[[-1.0, 0.0, 0.0]],
        friction=0.125,
        slip_origin=[[0.75 * length]],
    )
    solution = cq.solve(problem)
    np.testing.assert_allclose(solution.displacement / length, [-0.75, -0.875, -0.625], rtol=1e-14)
    np.testing.assert_allclose(solution.normal_force / force, [3.75], rtol=1e-14)
    np.testing.assert_allclose(solution.friction_force / force, [[-0.0859375]], rtol=1e-12)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["active-set", "clarabel", "lemke", "lagrange-multiplier"])
def test_a_chain_that_loads_squeeze_is_pushed_out_of_a_stop_without_force(method: str) -> None:
    """Nothing is left of the loads where the stop is: what rounding leaves of them was measured by itself.

    It drove the chain off the stop, and the answer of an interior point passed, 6e-8 too far out, with a force of 1e-9.
    """
    chain = np.array([[3.0, -3, 0], [-3, 8, -5], [0, -5, 5]])
    problem = cq.ContactProblem(chain, [-9.0, 9, 0], [[0.0, 0, 1]], [-1.0])
    found = cq.solve(problem, method)
    assert abs(found.normal_force[0]) < 1e-14
    assert found.displacement == pytest.approx([-4.0, -1.0, -1.0], abs=1e-13)
    assert found.free_motions
    if method == "active-set":
        assert not found.work.routes


def _drawn_body(rng: np.random.Generator, *, rough: bool) -> dict[str, np.ndarray]:
    """Return a body of stiffness B'B + 1 with two contacts in small integers, at a load that closes one or both."""
    n = int(rng.integers(2, 5))
    B = rng.integers(-2, 3, size=(n, n)).astype(float)
    normal = rng.integers(-2, 3, size=(2, n)) + np.eye(2, n) / 2
    data = {"stiffness": B.T @ B + np.eye(n), "normal": normal, "gap": rng.integers(0, 3, 2) / 4}
    data["load"] = 4 * normal.sum(axis=0) + rng.integers(-2, 3, n)
    if rough:
        data |= {"tangent": rng.integers(-1, 2, size=(2, n)) + np.eye(2, n, 1) / 4, "friction": np.full(2, 0.125)}
    return data


@pytest.mark.sampled(5)
@pytest.mark.parametrize("rough", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_bodies_that_nothing_joins_have_the_answers_that_each_has_alone(seed: int, rough: bool) -> None:
    rng = np.random.default_rng(seed)
    pair = [_drawn_body(rng, rough=rough) for _ in range(2)]
    matrices = [name for name in ("stiffness", "normal", "tangent") if name in pair[0]]
    both = {name: block_diag(*(one[name] for one in pair)) for name in matrices}
    both |= {name: np.concatenate([one[name] for one in pair]) for name in set(pair[0]) - set(matrices)}
    alone, together = [cq.solve(cq.ContactProblem(**one)) for one in pair], cq.solve(cq.ContactProblem(**both))
    assert any(force > 0 for one in alone for force in one.normal_force)
    assert together.certificate.proven == all(one.certificate.proven for one in alone)
    for name in ("displacement", "normal_force", *(["friction_force"] if rough else [])):
        expected = np.concatenate([getattr(one, name) for one in alone])
        np.testing.assert_allclose(getattr(together, name), expected, rtol=0, atol=1e-12 * np.max(abs(expected)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_tie_is_two_contacts_that_oppose_each_other(seed: int) -> None:
    """One of the two carries the force of the tie, and nothing else changes."""
    rng = np.random.default_rng(seed)
    body = _drawn_body(rng, rough=False)
    row, value = rng.integers(1, 4, size=(1, len(body["load"]))).astype(float), np.array([0.25])
    tied = cq.solve(cq.ContactProblem(**body, tie=row, tie_value=value))
    rows = {"normal": np.vstack([body["normal"], row, -row]), "gap": np.concatenate([body["gap"], value, -value])}
    opposed = cq.solve(cq.ContactProblem(**body | rows))
    np.testing.assert_allclose(opposed.displacement, tied.displacement, rtol=0, atol=1e-12)
    np.testing.assert_allclose(opposed.normal_force[:2], tied.normal_force, rtol=0, atol=1e-10)
    assert opposed.normal_force[2] - opposed.normal_force[3] == pytest.approx(tied.tie_force[0], abs=1e-10)
    assert opposed.certificate.passed


def count_calls(monkeypatch: pytest.MonkeyPatch, module: ModuleType, name: str) -> list[None]:
    """Return a list that grows by an entry with each call of a function."""
    calls, original = list[None](), getattr(module, name)

    def counted(*arguments: Any, **options: Any) -> Any:
        calls.append(None)
        return original(*arguments, **options)

    monkeypatch.setattr(module, name, counted)
    return calls


@pytest.mark.slow
def test_rows_that_meet_at_rest_are_not_exchanged_for_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    """Opposite rows of gap 0 allow u = 0 alone; gaps of 1e-33 beside lengths of 1e-33 cost one system each."""
    rng = np.random.default_rng(30)
    rows = rng.standard_normal((200, 30))
    load = rng.standard_normal(30)
    problem = cq.ContactProblem(np.eye(30), load, np.vstack([rows, -rows]), np.zeros(400))
    systems = count_calls(monkeypatch, refinement, "answer_on")
    solution = cq.solve(problem, condense=False)
    assert np.max(abs(solution.displacement)) <= 1e-20
    assert rows.T @ (solution.normal_force[:200] - solution.normal_force[200:]) == pytest.approx(load, rel=1e-9)
    assert solution.certificate.proven
    assert len(systems) <= 10


@pytest.mark.slow
def test_a_search_for_closed_contacts_ends_after_affordable_systems(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stiffness has rank one, 300 rows act on 20 unknowns, and the answer to judge is far from the solution."""
    rng = np.random.default_rng(133)
    a, rows = rng.standard_normal(20), rng.standard_normal((300, 20))
    load = rows.T @ (abs(rng.standard_normal(300)) * (rng.random(300) < 0.5))
    problem = cq.ContactProblem(np.outer(a, a), load, rows, abs(rng.standard_normal(300)) * (rng.random(300) < 0.5))
    systems = count_calls(monkeypatch, refinement, "answer_on")
    certificate = cq.certify(problem, rng.standard_normal(20), abs(rng.standard_normal(300)))
    assert not certificate.passed
    assert len(systems) <= 2 * (affordable_systems(problem) + bounds.LAST_CORRECTIONS)


def test_single_changes_of_all_starts_share_their_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(40, 40), format="csr")
    twin, _ = equilibrated(cq.ContactProblem(chain, -np.ones(40), -sp.identity(40, format="csr"), np.full(40, 3.0)))
    monkeypatch.setattr(least_norm, "SINGLE_CHANGES", 40 + 40)
    systems, effort = count_calls(monkeypatch, least_norm, "solved_on"), Effort()
    free = ExtendedAnswer.of(Answer(np.zeros(40), np.zeros(40), None, np.zeros(0)))
    start = interior_point.solved_on(twin, np.zeros(40, dtype=bool), free, effort)
    for _ in range(5):
        assert not least_norm.by_single_changes(start, effort).holds
    assert len(systems) == 1
