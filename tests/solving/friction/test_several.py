"""Problems with no, one or several equilibria, and what enumeration and Tresca's fixed point make of random ones."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.certificate import holds
from contactqp.linalg.condensation import condense
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.model.arrays import Array
from contactqp.model.coulomb import Status, all_combinations
from contactqp.model.solution import Answer
from contactqp.solving.friction import enumeration
from contactqp.solving.friction.enumeration import Combinations, _hold
from tests.solving.friction.problems import TOUCH, one_contact, pad, random_problem, rough_truss, walls_that_conflict

# Klarbring's (1990) family; critical coefficient W_nn/|W_nt| = 1/2. Free displacement q = W f.
KLARBRING = [[1.0, 2.0], [2.0, 5.0]]
# A rod that touches the ground at tan(theta) = 2, m = l = 1 (Painleve); critical coefficient 4/3.
ROD = [[1.6, -1.2], [-1.2, 3.4]]

# (W, q, mu) and every equilibrium (r_n, r_t on the body), worked out by hand from the signs of the four states.
FAMILIES = {
    "Klarbring, above critical": (KLARBRING, (0.3, 1.25), 0.8, [(0, 0), (1, -0.65), (0.5, -0.4)]),
    "Klarbring, below critical": (KLARBRING, (0.3, 1.25), 0.4, [(0, 0)]),
    "Klarbring, slides left": (KLARBRING, (-7.0, -17.0), 0.8, [(35 / 13, 28 / 13)]),
    "rod, slides": (ROD, (-0.01, -1.0), 1.0, [(0.025, 0.025)]),
    "rod, impact without collision": (ROD, (-0.01, -1.0), 1.5, [(1.234 / 4, 1.612 / 4)]),
    "rod, three": (ROD, (0.01, -1.0), 1.5, [(0, 0), (1.166 / 4, 1.588 / 4), (0.05, 0.075)]),
}


@pytest.mark.parametrize("name", FAMILIES)
def test_all_equilibria_of_one_contact(name: str) -> None:
    compliance, free, friction, states = FAMILIES[name]
    found = cq.equilibria(one_contact(compliance, free, friction))
    forces = [(float(s.normal_force[0]), -float(s.friction_force[0, 0])) for s in found]
    assert len(forces) == len(states)
    for state in states:
        assert any(np.allclose(force, state, rtol=1e-12, atol=1e-12) for force in forces), (state, forces)
    assert all(s.certificate.passed for s in found)


def test_enumeration_does_not_choose_among_several() -> None:
    problem = one_contact(*FAMILIES["Klarbring, above critical"][:3])
    with pytest.raises(cq.SeveralEquilibria, match=r"3 equilibria.*l_N = 0\.5.*equilibria"):
        cq.solve(problem, algorithm="enumeration")
    displacement = cq.solve(problem).displacement
    assert any(np.allclose(displacement, s.displacement, atol=1e-12) for s in cq.equilibria(problem))


def test_the_fixed_point_is_damped_where_it_cycles() -> None:
    """mu = 0.8 against mu_c = 0.5: the bounds alternate 5.4, 1, 5.4, ... though the answer is unique."""
    problem = one_contact(*FAMILIES["Klarbring, slides left"][:3])
    start = cq.equilibria(problem)[0]
    for force in (0.01, 1.0, 5.4, 100.0):
        warm = cq.solve(problem, algorithm="tresca", warm_start=_with_force(start, force))
        np.testing.assert_allclose(warm.normal_force, 35 / 13, rtol=1e-13)
        np.testing.assert_allclose(warm.displacement, [0.0, -11 / 13], rtol=1e-13, atol=1e-15)


def _with_force(solution: cq.Solution, force: float) -> cq.Solution:
    from dataclasses import replace

    return replace(solution, answer=replace(solution.answer, normal_force=np.array([force])))


def test_a_contact_that_is_there_twice_shares_its_force() -> None:
    once = cq.solve(rough_truss())
    twice = rough_truss(
        normal=[[0.0, -1.0]] * 2,
        gap=[1e-3] * 2,
        tangent=[[1.0, 0.0]] * 2,
        slip_origin=[TOUCH] * 2,
        contact_names=None,
    )
    for solution in (cq.solve(twice, algorithm="tresca"), *cq.equilibria(twice)):
        np.testing.assert_allclose(solution.displacement, once.displacement, rtol=1e-14)
        np.testing.assert_allclose(solution.normal_force.sum(), once.normal_force[0], rtol=1e-13)
    assert len(cq.equilibria(twice)) == 1


def test_walls_that_conflict_are_named() -> None:
    for algorithm in (None, "tresca", "enumeration"):
        with pytest.raises(cq.NoEquilibrium, match="left, right"):
            cq.solve(walls_that_conflict(), algorithm=algorithm)


def test_what_is_not_there_says_so() -> None:
    twin = pad(1.0)
    with pytest.raises(cq.InvalidProblem, match="newton, nsgs, ppa, combinations, admm, aclm, tresca, enumeration"):
        cq.solve(twin, algorithm="lemke")
    space = cq.ContactProblem(np.eye(3), np.ones(3), -np.eye(1, 3), [0.0], tangent=np.eye(3)[1:], friction=0.3)
    with pytest.raises(cq.Unsupported, match="two tangential"):
        cq.solve(space, algorithm="enumeration")
    with pytest.raises(cq.Unsupported, match="needs a regular stiffness"):
        cq.solve(twin, "projected-gauss-seidel")
    with pytest.raises(cq.InvalidProblem, match="without it"):
        cq.equilibria(pad(1.0, friction=0.0))
    nine = cq.ContactProblem(np.eye(18), np.zeros(18), -np.eye(9, 18), np.ones(9), tangent=np.eye(18)[9:], friction=1.0)
    with pytest.raises(cq.Unsupported, match="9 contacts"):
        cq.equilibria(nine)
    assert cq.solve(nine).contact_status.tolist() == ["open"] * 9


def test_a_body_too_large_to_factorise_and_a_limit_of_time(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(cq.NotConverged, match="time limit"):
        cq.solve(rough_truss(), algorithm="tresca", time_limit=1e-9)
    monkeypatch.setenv("CONTACTQP_SPARSE_SOLVER", "pyamg")
    with pytest.raises(cq.Unsupported, match="not factorised"):
        cq.solve(rough_truss(), algorithm="enumeration")
    with pytest.raises(cq.Unsupported, match="not factorised"):
        cq.equilibria(rough_truss())


@pytest.mark.slow
def test_units_and_the_scale_of_rows_change_nothing() -> None:
    """u = d v unknown by unknown, forces times F, lengths times L, the rows of contact i times r_i."""
    rng = np.random.default_rng(7)
    for _ in range(30):
        problem = random_problem(rng)
        length, force = 10.0 ** rng.uniform(-6, 6), 10.0 ** rng.uniform(-9, 9)
        d, r = 10.0 ** rng.uniform(-4, 4, problem.dimension), 10.0 ** rng.uniform(-4, 4, problem.contacts)
        other = cq.ContactProblem(
            stiffness=problem.stiffness * np.outer(d, d) * force / length,
            load=problem.load * d * force,
            normal=problem.normal.toarray() * d * r[:, None],
            gap=problem.gap * length * r,
            tangent=problem.tangent.toarray() * d * r[:, None],
            friction=problem.friction,
            slip_origin=problem.slip_origin * length * r[:, None],
            tie=problem.tie.toarray() * d if problem.ties else None,
            tie_value=problem.tie_value * length if problem.ties else None,
        )
        here, there = cq.equilibria(problem), cq.equilibria(other)
        assert len(here) == len(there)
        for one, same in zip(here, there, strict=True):
            assert one.contact_status.tolist() == same.contact_status.tolist()
            atol = 1e-11 * np.max(abs(one.displacement))
            np.testing.assert_allclose(same.displacement * d / length, one.displacement, rtol=0, atol=atol)


def test_an_unsettled_fixed_point_is_no_answer() -> None:
    problem = one_contact(*FAMILIES["Klarbring, slides left"][:3])
    start = _with_force(cq.equilibria(problem)[0], 100.0)
    # A bound so high sticks: one step is not enough.
    with pytest.raises(cq.NotConverged, match="settled") as refused:
        cq.solve(problem, algorithm="tresca", warm_start=start, max_iter=1)
    assert len(refused.value.history) == 1


def _breaks_coulomb(solution: cq.Solution) -> float:
    """The worst of the law's conditions, written out: lengths and forces of these problems are of order one."""
    p = solution.problem
    u, normal, friction = solution.displacement, solution.normal_force, solution.friction_force[:, 0]
    balance = p.stiffness @ u + p.normal.T @ normal + p.tangent.T @ friction + p.tie.T @ solution.tie_force - p.load
    gap, slip = p.gap - p.normal @ u, p.tangent @ u - p.slip_origin[:, 0]
    sliding = np.minimum(abs(slip), abs(friction - p.friction * normal * np.sign(slip)))
    parts = (balance, np.minimum(gap, normal), np.maximum(abs(friction) - p.friction * normal, 0.0), sliding)
    size = max(1.0, *(float(np.max(abs(v), initial=0.0)) for v in (u, normal, friction)))
    ties = abs(p.tie @ u - p.tie_value)
    return max(float(np.max(abs(part), initial=0.0)) for part in (*parts, ties)) / size


@pytest.mark.slow
@pytest.mark.parametrize(("count", "without"), [(28, 1), pytest.param(60, 2, marks=pytest.mark.slow)])
def test_random_problems_against_the_law_and_against_each_other(count: int, without: int) -> None:
    """What solve returns obeys the law and is in enumeration's list; where the list is empty it refuses."""
    rng = np.random.default_rng(4)
    counts = {"one": 0, "none": 0, "several": 0, "by the fixed point": 0}
    for _ in range(count):
        problem = random_problem(rng)
        known = cq.equilibria(problem)
        assert all(_breaks_coulomb(state) < 1e-11 for state in known)
        if not known:
            counts["none"] += 1
            with pytest.raises((cq.NoEquilibrium, cq.NotConverged)):  # rounding may hold the bodies, 1e15 away
                cq.solve(problem)
            continue
        counts["several" if len(known) > 1 else "one"] += 1
        solution = cq.solve(problem)
        counts["by the fixed point"] += solution.method.startswith("Tresca")
        assert _breaks_coulomb(solution) < 1e-11
        size = np.linalg.norm(solution.displacement)
        assert min(np.linalg.norm(solution.displacement - s.displacement) for s in known) < 1e-9 * size
    assert counts["one"] > 2 / 3 * count, counts
    assert counts["none"] >= without, counts
    assert counts["several"] >= 1, counts
    assert counts["by the fixed point"] > 0.9 * (counts["one"] + counts["several"]), counts


def test_answers_of_other_laws_are_refused() -> None:
    """Friction along the slip, beyond the cone, short of it, and the associated relaxation (sliding dilates)."""
    problem = rough_truss()
    right = cq.solve(problem)
    u, normal, friction = right.displacement, right.normal_force, right.friction_force
    assert holds(problem, Answer(u, normal, friction, np.zeros(0)))
    K, mu = np.asarray(problem.stiffness), 0.3
    # Associated: the gap opens by mu |s|; (E_N + mu E_T) u = g + mu origin, force along E_N + mu E_T.
    row = np.array([mu, -1.0])
    origin = problem.slip_origin[0, 0]
    force = (row @ np.linalg.solve(K, problem.load) - 1e-3 - mu * origin) / (row @ np.linalg.solve(K, row))
    dilated = np.linalg.solve(K, problem.load - force * row)
    assert dilated[0] > origin, "it slides"
    wrong = {
        "slip_direction": (u, normal, -friction),
        "cone": (u, normal, 1.01 * friction),
        "equilibrium": (u, normal, 0.9 * friction),
        "complementarity": (dilated, [force], [[mu * force]]),
    }
    for figure, (moved, pressed, rubbed) in wrong.items():
        certificate = cq.certify(problem, moved, pressed, rubbed)
        assert getattr(certificate, figure) > 1e-4, figure
        assert not certificate.passed
        assert not holds(problem, Answer(np.asarray(moved), np.asarray(pressed), np.asarray(rubbed), np.zeros(0)))


def test_signs_of_many_combinations_are_those_of_each() -> None:
    rng, m = np.random.default_rng(0), 3
    root, coefficient, none = rng.normal(size=(2 * m, 2 * m)), np.array([0.5, 0.0, 1.2]), np.zeros((0, 2 * m))
    data = coefficient, rng.normal(size=2 * m), -root @ root.T, np.zeros(2 * m), none, np.zeros(0), 1e-12
    systems, status = Combinations(*data), np.array(list(all_combinations(coefficient)), dtype=np.int8)
    y = rng.choice([0.0, 1e-9, 1.0], (len(status), 2 * m)) * rng.normal(size=(len(status), 2 * m)) + [1, 1, 1, 0, 0, 0]
    one_by_one = [_hold(*systems._signs(combination), one) for combination, one in zip(status, y, strict=True)]
    assert 0 < sum(one_by_one) < len(status)
    assert systems._all_hold(status, y).tolist() == one_by_one


def _drawn(seed: int) -> cq.ContactProblem:
    """Three contacts on a body that is soft, floats or stands on integers, so that systems are regular and not."""
    rng = np.random.default_rng(seed)
    n, rank = int(rng.integers(2, 6)), int(rng.integers(0, 6))
    if seed % 2:
        half = rng.standard_normal((n, min(rank, n)))
        K, N, T = half @ half.T, rng.standard_normal((3, n)), rng.standard_normal((3, n))
    else:
        K = np.diag(rng.integers(0, 3, n)).astype(float)
        N, T = rng.integers(-1, 2, (3, n)).astype(float), rng.integers(-1, 2, (3, n)).astype(float)
        N[~N.any(axis=1), 0] = 1.0
    gap = np.where(rng.random(3) < 0.5, 0.0, rng.uniform(0, 0.3, 3))
    friction = float(rng.choice([0.0, 0.5, 2.0]))
    return cq.ContactProblem(K, rng.integers(-3, 4, n).astype(float), N, gap, tangent=T, friction=friction)


@pytest.mark.slow
def test_combinations_that_are_dropped_early_are_those_whose_signs_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    """Singular values and linear programs of all find the same; most of them are not needed."""
    seeds = range(16)
    dropped, proven = Combinations._plainly_fail, enumeration._proven_to_fail
    programs: list[bool] = []
    monkeypatch.setattr(enumeration, "_proven_to_fail", lambda *rows: programs.append(proven(*rows)) or programs[-1])
    short = [_states(_drawn(seed)) for seed in seeds]
    assert sum(programs) > 0.5 * len(programs) > 0

    def nothing(self: Combinations, status: Status, *systems: Array) -> Array:
        assert not (dropped(self, status, *systems) & self._all_hold(status, _by_least_squares(*systems))).any()
        return np.zeros(len(status), dtype=bool)

    monkeypatch.setattr(Combinations, "_plainly_fail", nothing)
    monkeypatch.setattr(enumeration, "_proven_to_fail", lambda *_: False)
    assert short == [_states(_drawn(seed)) for seed in seeds]
    assert any(short)


def test_signs_that_hold_by_a_narrow_margin_are_proven_by_no_weights() -> None:
    between = np.array([[1.0], [-1.0]])  # c <= a and -c <= b
    assert not enumeration._proven_to_fail(between, np.array([1.0, -1.0]))
    assert not enumeration._proven_to_fail(between, np.array([1.0, -1.0 - 1e-7]))
    assert enumeration._proven_to_fail(between, np.array([1.0, -1.0 - 1e-3]))


def _states(problem: cq.ContactProblem) -> list[tuple[int, ...]]:
    condensation = condense(problem)
    rows = condensed_frictional_rows(problem, condensation)
    return [tuple(status) for status, _ in enumeration._Systems(problem, condensation, rows).plausible()]


def _by_least_squares(matrix: Array, right: Array, *_: Array) -> Array:
    return np.array([np.linalg.lstsq(one, b, rcond=1e-12)[0] for one, b in zip(matrix, right, strict=True)])
