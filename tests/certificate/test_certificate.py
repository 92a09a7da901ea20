"""The certificate passes what is right and refuses what is wrong, whatever the units."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

import contactqp as cq
from contactqp.certificate.certificate import FIGURES, compute_certificate
from contactqp.certificate.figures import kept_residuals, violations
from contactqp.model.solution import Answer
from tests.examples import (
    CANTILEVER_FORCE,
    block_between,
    body_on_spring_in_mid_air,
    cantilever,
    seeded_problem,
    truss,
    two_bars,
)


def _right(problem: cq.ContactProblem) -> dict[str, np.ndarray]:
    solution = cq.solve(problem)
    return dict(displacement=solution.displacement.copy(), normal_force=solution.normal_force.copy())


def test_the_exact_answer_passes_and_is_proven() -> None:
    certificate = cq.certify(truss(), **_right(truss()))
    assert certificate.passed
    assert certificate.proven
    assert not certificate.failures
    assert certificate.energy_error is not None
    assert certificate.energy_error < 1e-15
    assert certificate.force_bound is not None
    assert certificate.force_bound[0] < 1e-12


WRONG = {
    "flipped sign": lambda u, f: (u, -f),
    "forces off by 0.1 %": lambda u, f: (u, 1.001 * f),
    "ignored contact": lambda _, f: (np.linalg.solve(truss().stiffness, truss().load), 0 * f),
    "penetration of 1e-6": lambda u, f: (u * [1.0, 1 + 4e-6], f),
    "NaN displacement": lambda u, f: (u * np.nan, f),
    "NaN force": lambda u, f: (u, f * np.nan),
    "infinite force": lambda u, f: (u, f * np.inf),
    "zero answer": lambda u, f: (0 * u, 0 * f),
    "half converged": lambda u, f: (0.5 * u, 0.5 * f),
    "displacement off in one unknown": lambda u, f: (u * [1 + 1e-5, 1.0], f),
}


@pytest.mark.parametrize("kind", WRONG)
def test_wrong_answers_are_refused(kind: str) -> None:
    right = _right(truss())
    u, force = WRONG[kind](right["displacement"], right["normal_force"])
    certificate = cq.certify(truss(), displacement=u, normal_force=force)
    assert not certificate.passed
    assert certificate.failures


def test_tension_is_named_with_its_contact_and_unit() -> None:
    right = _right(truss())
    certificate = cq.certify(truss(), right["displacement"], -right["normal_force"])
    assert certificate.tension > 0.1
    assert any(
        "floor" in failure and "kN" in failure for failure in certificate.failures if failure.startswith("tension")
    )


def test_a_tensile_force_in_equilibrium_is_refused() -> None:
    """The bonded answer: contact held in tension, residual zero."""
    problem = truss(load=[60.0, 100.0])
    K = problem.stiffness
    u = np.array([(60.0 + K[0, 1] * 1e-3) / K[0, 0], -1e-3])
    force = [-(100.0 - (K @ u)[1])]
    certificate = cq.certify(problem, u, force)
    assert certificate.equilibrium < 1e-12
    assert certificate.penetration < 1e-12
    assert not certificate.passed
    assert certificate.tension > 0.1


def test_beam_force_ten_percent_off_passes_every_residual_test_and_is_refused() -> None:
    problem = cantilever()
    solution = cq.solve(problem)
    assert solution.normal_force[0] == pytest.approx(CANTILEVER_FORCE, rel=1e-6)
    force = 1.1 * solution.normal_force
    answer = np.linalg.solve(problem.stiffness, problem.load - problem.normal.T @ force)
    # Put the tip back on the stop by a rigid-looking correction that the stiff bending terms hide.
    answer += (
        (problem.gap[0] - answer[-2])
        * np.linalg.solve(problem.stiffness, problem.normal.toarray()[0])
        / (np.linalg.solve(problem.stiffness, problem.normal.toarray()[0])[-2])
    )
    certificate = cq.certify(problem, answer, force)
    figures = {name: getattr(certificate, name) for name in FIGURES}
    assert max(figures.values()) < 1e-9, figures
    assert not certificate.passed
    assert certificate.force_error == pytest.approx(0.1, rel=1e-3)
    assert any(failure.startswith("force_error") for failure in certificate.failures)


def test_a_body_in_mid_air_fails_the_balance_and_the_equilibrium_without_its_rigid_motion() -> None:
    """Beside |K||u| of the whole displacement, 1e11, the load of 10 that nothing carries would be rounding."""
    problem = body_on_spring_in_mid_air()
    certificate = cq.certify(problem, displacement=[0.9, 0.9 + 1e-10], normal_force=[0.0])
    assert max(getattr(certificate, name) for name in FIGURES if name not in ("balance", "equilibrium")) < 2e-10
    assert certificate.balance == pytest.approx(1.0)
    assert certificate.equilibrium == pytest.approx(1.0)
    assert not certificate.passed
    held = cq.solve(problem)
    assert held.certificate.passed
    assert held.normal_force[0] == pytest.approx(10.0, rel=1e-9)
    assert list(held.contact_status) == ["closed"]


def test_grazing_contacts_are_named() -> None:
    problem = truss(load=[0.0, -1.0], gap=[0.0], contact_names=["touching"])
    K = problem.stiffness
    lifted = cq.ContactProblem(
        stiffness=K, load=K @ [1.0, 0.0], normal=[[0.0, -1.0]], gap=[0.0], contact_names=["touching"]
    )
    solution = cq.solve(lifted)
    assert solution.certificate.grazing == (0,)
    assert list(solution.contact_status) == ["grazing"]
    assert "touching" in str(solution.certificate)
    assert cq.solve(problem).certificate.grazing == ()


def test_a_force_that_is_proven_does_not_graze() -> None:
    """A stop on a very stiff spring takes 1 of a load of 4e10: it was said to graze beside a bound of 2e-14."""
    stop = cq.solve(cq.ContactProblem([[1e10]], [4e10 + 1], [[1.0]], [4.0])).certificate
    assert stop.force_bound is not None
    assert (stop.grazing, stop.force_bound[0] < 1e-6) == ((), True)
    # A force of 1e-13 of the load may be its rounding.
    assert cq.solve(cq.ContactProblem([[1e10]], [4e10 + 2.0**-8], [[1.0]], [4.0])).certificate.grazing == (0,)


def test_redundant_contacts_have_a_force_error_and_no_force_bound() -> None:
    problem = truss(normal=[[0.0, -1.0], [0.0, -1.0]], gap=[1e-3, 1e-3], contact_names=None)
    solution = cq.solve(problem)
    certificate = solution.certificate
    assert certificate.passed
    assert certificate.force_bound is None
    assert any(reason.startswith("force_bound") and "redundant" in reason for reason in certificate.reasons)
    assert certificate.force_error is not None
    assert certificate.force_error < 1e-12
    shared = cq.certify(problem, solution.displacement, np.full(2, solution.normal_force.sum() / 2))
    assert shared.passed, "any share of the force among equal contacts is right"


def test_a_bound_that_cannot_be_had_says_why() -> None:
    slip = truss(tangent=[[1.0, 0.0]], friction=0.3)
    right = _right(truss())
    certificate = cq.certify(slip, **right, friction_force=[0.0])
    assert certificate.energy_error is None
    assert certificate.force_error is None
    assert not certificate.proven
    assert len(certificate.reasons) == 3


def test_coulomb_figures() -> None:
    """Example 2.18 with the true law: slip, |l_T| = mu l_N along the slip."""
    origin, friction = 533489 / 639328600, 0.3
    slip = truss(tangent=[[1.0, 0.0]], friction=friction, slip_origin=[origin])
    u, force = np.array([30058 / 30933965, -1e-3]), 180933933661 / 6186793000
    assert cq.certify(slip, u, [force], friction_force=[friction * force]).passed
    against = cq.certify(slip, u, [force], friction_force=[-friction * force])
    assert against.slip_direction > 1e-2
    beyond = cq.certify(slip, u, [force], friction_force=[1.01 * friction * force])
    assert beyond.cone > 1e-4
    assert not beyond.passed


def test_missing_and_misshapen_forces_are_no_guess() -> None:
    tied = cq.ContactProblem(
        stiffness=np.eye(2), load=[1.0, 0.0], normal=np.zeros((0, 2)), gap=[], tie=[[1.0, -1.0]], tie_value=[0.0]
    )
    with pytest.raises(cq.InvalidProblem, match="tie_force"):
        cq.certify(tied, [0.5, 0.5], [], tie_force=[0.5, 0.5])
    with pytest.raises(cq.InvalidProblem, match="tie_force"):
        compute_certificate(tied, [0.5, 0.5], [])
    recovered = cq.certify(tied, [0.5, 0.5], [])
    assert recovered.passed
    assert recovered.recovered == ("tie_force",)
    assert any("recovered" in note and "tie_force" in note for note in recovered.notes)
    assert not cq.certify(tied, [0.5, 0.4], []).passed
    with pytest.raises(cq.InvalidProblem, match="displacement"):
        cq.certify(truss(), np.zeros(3), [0.0])
    with pytest.raises(cq.InvalidProblem, match="friction_force"):
        cq.certify(truss(), np.zeros(2), [0.0], friction_force=[1.0])
    assert cq.certify(tied, [0.5, 0.5], [], tie_force=[0.5]).passed
    assert not cq.certify(tied, [0.5, 0.5], [], tie_force=[-0.5]).passed
    assert cq.certify(tied, [0.5, 0.51], [], tie_force=[0.5]).tie > 1e-3


def test_a_factorisation_of_another_problem_is_refused() -> None:
    from contactqp.linalg.condensation import condense

    right = _right(truss())
    assert cq.certify(truss(), **right, factorization=condense(truss())).passed
    with pytest.raises(cq.InvalidProblem, match="factorization"):
        cq.certify(truss(), **right, factorization=condense(two_bars()))


# --- invariance -------------------------------------------------------------------------------------------------------


def _figures(problem: cq.ContactProblem, u: np.ndarray, force: np.ndarray) -> dict[str, float]:
    certificate = cq.certify(problem, u, force)
    return {name: getattr(certificate, name) for name in FIGURES}


def _agree(one: dict[str, float], other: dict[str, float]) -> None:
    for name in FIGURES:
        if max(one[name], other[name]) > 1e-12:
            assert other[name] == pytest.approx(one[name], rel=1e-6), name


def _candidate(seed: int, floating: bool) -> tuple[cq.ContactProblem, np.ndarray, np.ndarray]:
    problem = block_between(seed=seed) if floating else seeded_problem(seed)
    random = np.random.default_rng(seed)
    solution = cq.solve(problem)
    noise = 10.0 ** random.uniform(-10, 0)
    u = solution.displacement * (1 + noise * random.standard_normal(problem.dimension))
    force = solution.normal_force + noise * random.standard_normal(problem.contacts)
    return problem, u, force


def _scaled(problem: cq.ContactProblem, unknowns: np.ndarray, contacts: np.ndarray) -> cq.ContactProblem:
    """u = D u', rows multiplied by r."""
    D, R = sp.diags(unknowns), sp.diags(contacts)
    return cq.ContactProblem(
        stiffness=D @ sp.csr_array(problem.stiffness) @ D,
        load=unknowns * problem.load,
        normal=R @ problem.normal @ D,
        gap=contacts * problem.gap,
    )


exponents = st.integers(-6, 6)


@pytest.mark.slow
@settings(deadline=None, max_examples=12)
@given(seed=st.integers(0, 40), floating=st.booleans(), data=st.data())
def test_figures_are_invariant_under_scaling_of_unknowns_and_rows(
    seed: int, floating: bool, data: st.DataObject
) -> None:
    problem, u, force = _candidate(seed, floating)
    n, m = problem.dimension, problem.contacts
    unknowns = 10.0 ** np.array(data.draw(st.lists(exponents, min_size=n, max_size=n)), dtype=float)
    contacts = 10.0 ** np.array(data.draw(st.lists(st.integers(-4, 4), min_size=m, max_size=m)), dtype=float)
    _agree(_figures(problem, u, force), _figures(_scaled(problem, unknowns, contacts), u / unknowns, force / contacts))


@settings(deadline=None, max_examples=6)
@given(seed=st.integers(0, 40), floating=st.booleans(), length=st.integers(-6, 6), size=st.integers(-6, 6))
def test_figures_are_invariant_under_change_of_units(seed: int, floating: bool, length: int, size: int) -> None:
    problem, u, force = _candidate(seed, floating)
    per_length, per_force = 10.0**length, 10.0**size
    other = cq.ContactProblem(
        stiffness=problem.stiffness * (per_force / per_length),
        load=problem.load * per_force,
        normal=problem.normal,
        gap=problem.gap * per_length,
    )
    _agree(_figures(problem, u, force), _figures(other, u * per_length, force * per_force))


@pytest.mark.slow
@settings(deadline=None, max_examples=12)
@given(seed=st.integers(0, 40), floating=st.booleans(), data=st.data())
def test_figures_are_invariant_under_permutation(seed: int, floating: bool, data: st.DataObject) -> None:
    problem, u, force = _candidate(seed, floating)
    p = np.array(data.draw(st.permutations(range(problem.dimension))))
    q = np.array(data.draw(st.permutations(range(problem.contacts))))
    other = cq.ContactProblem(
        stiffness=np.asarray(problem.stiffness)[np.ix_(p, p)],
        load=problem.load[p],
        normal=problem.normal.toarray()[np.ix_(q, p)],
        gap=problem.gap[q],
    )
    _agree(_figures(problem, u, force), _figures(other, u[p], force[q]))


# --- bounds -----------------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 400), size=st.floats(-12, 0.5), what=st.sampled_from(["u", "force", "both"]))
def test_bounds_are_never_below_the_truth_and_near_it(seed: int, size: float, what: str) -> None:
    problem = seeded_problem(seed)
    solution = cq.solve(problem)
    random = np.random.default_rng(seed)
    u, force = solution.displacement.copy(), solution.normal_force.copy()
    noise = 10.0**size
    if what != "force":
        u = u + noise * random.standard_normal(len(u))
    if what != "u":
        force = force + noise * random.standard_normal(len(force))
    certificate = cq.certify(problem, u, force)
    K = np.asarray(problem.stiffness)
    W = problem.normal @ np.linalg.solve(K, problem.normal.toarray().T)

    def norm(v: np.ndarray, M: np.ndarray) -> float:
        return float(np.sqrt(v @ M @ v))

    rounding = 1e-12
    errors = {
        "energy_error": norm(u - solution.displacement, K) / norm(solution.displacement, K),
        "force_error": norm(force - solution.normal_force, W) / norm(solution.normal_force, W),
    }
    for name, error in errors.items():
        bound = getattr(certificate, name)
        assert bound is not None
        assert bound >= error * (1 - 1e-6) - rounding, name
        assert bound <= 1000 * error + rounding, name
    assert certificate.force_bound is not None
    assert np.all(certificate.force_bound >= abs(force - solution.normal_force) * (1 - 1e-6) - rounding)


def test_certificates_cannot_be_changed() -> None:
    certificate = cq.certify(truss(), **_right(truss()))
    with pytest.raises(dataclasses.FrozenInstanceError):
        certificate.passed = True  # type: ignore[misc]


def test_a_heavy_neighbour_hides_nothing() -> None:
    """A body 1e12 times as stiff, moved 1 m, stands beside: what is wrong in the light one is still seen."""
    heavy = cq.ContactProblem(
        stiffness=np.diag([1.0, 1e12]),
        load=[3e-8, 1e12],
        normal=[[1.0, 0.0]],
        gap=[1e-8],
        tie=[[0.0, 1.0]],
        tie_value=[1.0],
    )
    right = cq.solve(heavy)
    assert right.certificate.passed
    u, force, tie = right.displacement, right.normal_force, right.tie_force
    assert cq.certify(heavy, u * [1 + 1e-6, 1.0], force, tie_force=tie).penetration > 1e-7
    assert not cq.certify(heavy, u, 1.001 * force, tie_force=tie).passed


def test_a_support_held_as_a_row_may_move_by_rounding() -> None:
    """u_0 = 0 as a tie, met to 1e-19 beside displacements of 1e-3: rounding is not measured against itself."""
    K = 1e5 * np.array([[1.0, -1.0], [-1.0, 2.0]])
    problem = cq.ContactProblem(K, [0.0, 200.0], [[0.0, 1.0]], [5e-4], tie=[[1.0, 0.0]])
    solution = cq.solve(problem)
    moved = solution.displacement + np.array([1e-19, 0.0])
    assert cq.certify(problem, moved, solution.normal_force, tie_force=solution.tie_force).passed
    moved = solution.displacement + np.array([1e-9, 0.0])
    assert not cq.certify(problem, moved, solution.normal_force, tie_force=solution.tie_force).passed


def _bar_on_a_floor(friction: float = 0.3) -> cq.ContactProblem:
    """Two nodes on springs, the second on a floor that it touches (g = 0) and where it sticks."""
    return cq.ContactProblem(
        stiffness=np.diag([10.0, 10.0, 1000.0, 1000.0]) + 5.0 * np.outer([1, 1, -1, -1], [1, 1, -1, -1]),
        load=[1.0, 0.0, -0.5, -3.0],
        normal=[[0.0, 0.0, 0.0, -1.0]],
        gap=[0.0],
        tangent=[[0.0, 0.0, 1.0, 0.0]],
        friction=friction,
    )


@pytest.mark.parametrize(("tolerance", "noise"), [(1e-9, 1e-12), (1e-6, 1e-9)])
@pytest.mark.parametrize("where", [2, 3])
def test_what_a_solver_leaves_of_zero_is_no_slip_and_no_penetration(where: int, tolerance: float, noise: float) -> None:
    """A contact whose lengths are all zero has none to be measured by: the largest of its body stands in for them."""
    problem = _bar_on_a_floor()
    right = cq.solve(problem)
    assert right.contact_status[0] == "stick"
    given = (right.normal_force, right.friction_force, right.tie_force)
    sizes = np.sqrt(problem.diagonal) * abs(right.displacement)
    forgiven = noise * np.max(sizes) / np.sqrt(problem.diagonal[where])
    for part, passes in ((0.5, True), (2.0, False)):
        u = right.displacement.copy()
        u[where] = -part * forgiven
        judged = cq.certify(problem, u, *given, tolerance=tolerance)
        figures = ("slip_direction", "penetration", "natural_map")
        assert all(getattr(judged, name) <= 4 * tolerance for name in figures) is passes, (part, judged)


def test_where_nothing_is_elastic_equilibrium_and_gaps_decide() -> None:
    """A rigid table on four legs: any share of the load that balances is right, and no energy bounds anything."""
    legs = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    rows = [[-1.0, -y, x] for x, y in legs]
    table = cq.ContactProblem(np.zeros((3, 3)), [-8.0, -2.0, 1.0], rows, np.zeros(4))
    share = np.array([2 + x / 4 + y / 2 for x, y in legs])
    assert cq.certify(table, np.zeros(3), share).passed
    assert cq.solve(table).certificate.passed
    tilted = cq.certify(table, [0.0, 1e-6, 0.0], share)
    assert tilted.penetration > 1e-9
    assert not tilted.passed
    assert not cq.certify(table, np.zeros(3), [*share[:3], share[3] + 1e-6]).passed


@pytest.mark.sampled(2)
@pytest.mark.parametrize("length", [1.0, 1e-40])
@pytest.mark.parametrize(("rub", "passes"), [(0.0, True), (1.5, True), (-1.5, True), (1.51, False), (1e6, False)])
def test_friction_on_a_node_that_is_held_across_stays_within_its_bound(rub: float, passes: bool, length: float) -> None:
    """A load of 5 presses a node that only moves along the normal: any friction up to 0.3 * 5 would do, and no more."""
    problem = cq.ContactProblem([[10.0 / length]], [5.0], [[1.0]], [0.0], tangent=[[0.0]], friction=[0.3])
    judged = cq.certify(problem, [0.0], [5.0], [[rub]])
    assert judged.passed is passes, judged
    assert (judged.cone > 1e-3) is not passes


@pytest.mark.sampled(4)
@pytest.mark.parametrize("weak", [0.0, np.cos(np.pi / 2), 1e-13, 1e-10])
def test_a_tangential_row_that_is_rounding_is_none(weak: float) -> None:
    """A node whose tangent is (cos 90 deg, 1) in a mesh where the second direction is held."""
    K = np.array([[3.0, -1.0, -1.0], [-1.0, 3.0, -1.0], [-1.0, -1.0, 3.0]])
    u, normal, tangent = np.array([0.0, 0.1, -0.2]), np.array([[-1.0, 0.0, 0.0]]), np.array([[weak, 0.0, 0.0]])
    for rub, passes in ((1.5, True), (-1.5, True), (1.6, False), (1e3, False), (1e5, False)):
        load = K @ u + normal[0] * 5.0 + tangent[0] * rub
        problem = cq.ContactProblem(K, load, normal, [0.0], tangent=tangent, friction=[0.3])
        assert cq.certify(problem, u, [5.0], [[rub]]).passed is passes, rub


@pytest.mark.parametrize("soft", [1.0, 1e-8, 1e-15, 1e-17, 1e-20])
def test_friction_that_drives_is_refused_however_soft_the_body_is_along_the_normal(soft: float) -> None:
    """A block of weight 7 on a spring across, 1, that nothing pulls: friction of 2.1 may not hold it 2.1 away."""
    rows = dict(normal=[[0.0, -1.0]], gap=[0.0], tangent=[[1.0, 0.0]], friction=[0.3])
    problem = cq.ContactProblem(np.diag([1.0, soft]), [0.0, -7.0], **rows)
    assert cq.certify(problem, [0.0, 0.0], [7.0], [[0.0]]).passed
    assert cq.certify(problem, [2.1, 0.0], [7.0], [[-2.1]]).slip_direction > 0.1
    assert not cq.certify(problem, [2.1, 0.0], [7.0], [[-2.1]]).passed
    assert not cq.certify(problem, [-2.1, 0.0], [7.0], [[2.1]]).passed


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("origin", "passes"), [(1e-17, True), (-1e-13, True), (1e-3, False)])
@pytest.mark.parametrize("length", [1.0, 1e-20, 1e20])
def test_a_slip_of_rounding_where_a_node_is_held_across_turns_no_friction(
    origin: float, passes: bool, length: float
) -> None:
    problem = cq.ContactProblem(
        [[1.0 / length]], [5.0], [[1.0]], [0.0], tangent=[[0.0]], friction=[0.3], slip_origin=[[origin * length]]
    )
    assert cq.certify(problem, [0.0], [5.0], [[1.0]]).passed is passes


def test_friction_where_nothing_touches_and_nothing_moves_is_refused() -> None:
    problem = cq.ContactProblem([[10.0]], [5.0], [[1.0]], [np.inf], tangent=[[0.0]], friction=[0.3])
    assert cq.certify(problem, [0.5], [0.0], [[0.0]]).passed
    judged = cq.certify(problem, [0.5], [0.0], [[1e-3]])
    assert not judged.passed
    assert judged.failures == ("cone: contact 0 constrains nothing and has friction",)


def test_a_reason_stands_once_for_all_bounds_that_it_is_a_reason_for() -> None:
    problem = cq.ContactProblem([[1.0]], [5.0], [[1.0]], [0.0], tangent=[[0.0]], friction=[0.3])
    lines = str(cq.solve(problem).certificate).splitlines()
    assert lines[0] == "passed, not proven"
    assert lines[1:3] == [
        "  relative distance to the equilibrium with the same contacts open, sticking and",
        "    slipping: 0",
    ]
    bounds = [line for line in lines if line.startswith("  no bound: ")]
    assert len(bounds) == 1
    assert bounds[0].startswith("  no bound: energy_error, force_error, force_bound: Coulomb friction is no")
    twice = problem.replace(normal=[[1.0], [1.0]], gap=[0.0, 0.0], tangent=[[0.0], [0.0]], friction=[0.3, 0.3])
    judged = str(cq.certify(twice, [0.0], [2.5, 2.5], [[0.0], [0.0]]))
    assert "  no bound: energy_error, force_error, force_bound: friction: " in judged


def test_an_answer_is_measured_once_but_for_each_load_that_shares_its_stiffness() -> None:
    problem = truss()
    answer = Answer(**_right(problem), friction_force=None, tie_force=np.zeros(0))
    left = kept_residuals(problem, answer)
    assert kept_residuals(problem, answer) is left
    heavier = problem.replace(load=2 * problem.load)
    missing = kept_residuals(heavier, answer).force.double() - left.force.double()
    assert missing == pytest.approx(problem.load)
    meeting = [violations(one, answer, left).meeting for one in (problem, heavier, problem)]
    assert meeting[0].tobytes() == meeting[2].tobytes()
    assert np.all(meeting[1] > meeting[0])
