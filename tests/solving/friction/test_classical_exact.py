"""The classical enforcements that are exact, with friction: the course chapter's section 2.4, its signs corrected."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods import Settings, find
from contactqp.solving.methods.augmented_lagrangian import _uzawa
from contactqp.solving.methods.textbook_algebra import solve_linear
from tests.solving.friction.problems import (
    TOUCH,
    one_contact,
    pad,
    random_problem,
    rough_truss,
    two_masses,
    walls_that_conflict,
)
from tests.solving.friction.test_classical_springs import K11, K12, K22, MU
from tests.solving.friction.test_exact import PULLS, STATES
from tests.solving.friction.test_several import FAMILIES, _breaks_coulomb

EXACT: dict[str, tuple[str, dict[str, object]]] = {
    "lagrange-multiplier": ("lagrange-multiplier", {}),
    "master-slave": ("master-slave", {}),
    "augmented": ("augmented-lagrangian", {}),
    **{f"augmented, {beta:g}": ("augmented-lagrangian", {"penalty": beta}) for beta in (0.0, 1e3, 1e5, 1e8)},
    "augmented, 1e3 and 1e7": ("augmented-lagrangian", {"penalty": 1e3, "tangential_penalty": 1e7}),
}


def solved(name: str, problem: cq.ContactProblem, **more: object) -> cq.Solution:
    method, options = EXACT[name]
    return cq.solve(problem, method, **(options | more))


@pytest.mark.sampled(16)
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("name", EXACT)
def test_truss_on_a_rough_floor(name: str, state: str) -> None:
    """Examples 2.17 and 2.18, Problems 2.4 and 2.5: stick, and slip either way, whatever the penalty."""
    friction, origin, moved, force, ratio, status = STATES[state]
    solution = solved(name, rough_truss(friction, origin))
    np.testing.assert_allclose(solution.displacement, [moved, -1e-3], 1e-12)
    if force is not None:
        np.testing.assert_allclose(solution.normal_force, force, 1e-12)
    np.testing.assert_allclose(solution.friction_force[0], ratio * solution.normal_force, 1e-11, atol=1e-10)
    assert solution.contact_status.tolist() == [status]
    assert solution.certificate.passed
    assert solution.method == EXACT[name][0]
    assert solution.work.iterations == len(solution.history) <= 3


def test_the_systems_that_the_chapter_prints() -> None:
    """Example 2.18 (a): friction that pushes along the slip gives 31.337 kN, -g a node 1 mm above; both are refused."""
    problem = rough_truss()
    K, mu = np.asarray(problem.stiffness), 0.3
    printed = np.block([[K, np.array([[-mu], [-1.0]])], [np.array([[0.0, -1.0]]), np.zeros((1, 1))]])
    dx, dz, force = solve_linear("printed", printed, np.array([60.0, -100.0, 1e-3]))
    np.testing.assert_allclose([dx, dz, force], [0.00127559165036171109, -1e-3, 31.3370248886046936], 1e-13)
    # Its friction on the node is +mu l_N: l_T = -mu l_N, along a slip in +x.
    refused = cq.certify(problem, [dx, dz], [force], [-mu * force])
    assert refused.slip_direction > 1e-2
    assert not refused.passed
    assert not cq.certify(problem, [0.8344e-3 + dx, dz], [force], [mu * force]).passed, "the sum that it prints"
    literal = solve_linear("printed", printed, np.array([60.0, -100.0, -1e-3]))
    np.testing.assert_allclose(literal, [0.00184193548554705760, 1e-3, 190.121226140568952], 1e-13)
    lifted = cq.certify(problem, literal[:2], literal[2:], -mu * literal[2:])
    assert lifted.complementarity > 0.1
    assert not lifted.passed


@pytest.mark.sampled(48)
@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("pull", PULLS)
def test_two_masses_on_a_rough_floor(pull: str, name: str) -> None:
    """Example 2.19, true Coulomb: nothing but the floor holds the masses' heights."""
    force, origin, moved, friction, status = PULLS[pull]
    solution = solved(name, two_masses(force, origin))
    np.testing.assert_allclose(solution.displacement, [*moved, 0.0, 0.0], 1e-12, atol=1e-17)
    np.testing.assert_allclose(solution.normal_force, [19.62, 9.81], 1e-12)
    # Springs of beta that the rows cancel leave beta times the last places of the displacements in the forces.
    spring = max((b for b in EXACT[name][1].values() if isinstance(b, float)), default=0.0)
    last_places = 4 * spring * np.spacing(np.max(abs(solution.displacement)))
    np.testing.assert_allclose(solution.friction_force[:, 0], friction, 1e-12, atol=1e-13 + last_places)
    assert " ".join(solution.contact_status) == status


@pytest.mark.sampled(16)
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", EXACT)
def test_pad_on_an_incline(name: str, sign: float) -> None:
    np.testing.assert_allclose(solved(name, pad(sign * 3564.0)).friction_force, [[sign * 3564.0]], 1e-14)
    held = solved(name, pad(sign * 3636.0, spring=1000.0))
    np.testing.assert_allclose(held.displacement[0], sign * 0.036, 1e-11)
    np.testing.assert_allclose(held.friction_force, [[sign * 3600.0]], 1e-12)
    with pytest.raises(cq.NoEquilibrium, match=r"that no contact, friction or tie holds back: .* by \+0.3 "):
        solved(name, pad(sign * 3636.0))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", EXACT)
def test_mirrored_tangents_mirror_the_friction(name: str) -> None:
    one = solved(name, rough_truss())
    other = solved(name, rough_truss(slip_origin=-TOUCH, tangent=[[-1.0, 0.0]]))
    np.testing.assert_allclose(other.displacement, one.displacement, 1e-14)
    np.testing.assert_allclose(other.friction_force, -one.friction_force, 1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXACT)
def test_a_contact_that_cannot_slide_or_is_there_twice(name: str) -> None:
    fixed = solved(name, rough_truss(0.3, 0.0, tangent=[[0.0, 0.0]]))
    np.testing.assert_allclose(fixed.normal_force, 30.2549928366469910, 1e-12)
    assert fixed.friction_force[0, 0] == 0.0
    rows = dict(normal=[[0.0, -1.0]] * 2, gap=[1e-3] * 2, tangent=[[1.0, 0.0]] * 2, contact_names=None)
    for friction in (0.3, 0.8):
        twice = solved(name, rough_truss(friction, [TOUCH] * 2, **rows))
        once = solved(name, rough_truss(friction))
        np.testing.assert_allclose(twice.displacement, once.displacement, 1e-12)
        np.testing.assert_allclose(twice.normal_force.sum(), once.normal_force[0], 1e-12)
        np.testing.assert_allclose(twice.friction_force.sum(), once.friction_force[0, 0], 1e-11)


@pytest.mark.sampled(8)
@pytest.mark.parametrize("name", EXACT)
def test_without_friction_at_some_contacts(name: str) -> None:
    """The second mass on ice slides freely: 12 N go to the first, which slips."""
    ice = two_masses(12.0).replace(friction=[0.25, 0.0])
    solution = solved(name, ice)
    np.testing.assert_allclose(solution.friction_force[:, 0], [4.905, 0.0], 1e-11, atol=1e-12)
    np.testing.assert_allclose(solution.displacement[:2], [7.095e-3, 19.095e-3], 1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lagrange-multiplier", "master-slave", "augmented"])
def test_random_problems_against_every_equilibrium(name: str) -> None:
    """What is returned is in enumeration's list; without an equilibrium every method refuses."""
    rng = np.random.default_rng(11)
    counts = {"solved": 0, "given up": 0, "none": 0}
    for _ in range(30):
        problem = random_problem(rng)
        known = cq.equilibria(problem)
        try:
            solution = solved(name, problem)
        except (cq.NotConverged, cq.NoEquilibrium):
            counts["given up" if known else "none"] += 1
            continue
        counts["solved"] += 1
        assert _breaks_coulomb(solution) < 1e-9
        size = np.linalg.norm(solution.displacement)
        assert min(np.linalg.norm(solution.displacement - s.displacement) for s in known) < 1e-8 * size
    assert counts["given up"] <= 1, counts
    assert counts["none"] >= 1, counts


@pytest.mark.parametrize("family", FAMILIES)
def test_one_contact_above_the_critical_friction(family: str) -> None:
    compliance, free, friction, states = FAMILIES[family]
    solution = solved("lagrange-multiplier", one_contact(compliance, free, friction))
    found = (solution.normal_force[0], -solution.friction_force[0, 0])
    assert any(np.allclose(found, state, rtol=1e-12, atol=1e-12) for state in states), found


@pytest.mark.slow
def test_uzawa_arrives_or_says_that_it_does_not() -> None:
    for friction, origin, moved, force, ratio, _ in STATES.values():
        problem = rough_truss(friction, origin)
        solution = cq.solve(problem, "augmented-lagrangian", update="uzawa", tolerance=1e-11)
        np.testing.assert_allclose(solution.displacement, [moved, -1e-3], 1e-9)
        if force is not None:
            np.testing.assert_allclose(solution.normal_force, force, 1e-9)
        np.testing.assert_allclose(solution.friction_force[0], ratio * solution.normal_force, 1e-9, atol=1e-8)
        assert solution.history[-1] <= 1e-11
        with pytest.raises(cq.NotConverged, match="stopped after 2") as stopped:
            cq.solve(problem, "augmented-lagrangian", update="uzawa", max_iter=2)
        assert len(stopped.value.history) == 2
    # One slipping contact of stiffness S contracts by S_s / (S_s + beta).
    felt = float((K11 * K22 - K12 * K12) / (K11 + MU * K12))
    halving = cq.solve(rough_truss(), "augmented-lagrangian", update="uzawa", penalty=felt)
    rates = np.array(halving.history[4:15]) / np.array(halving.history[3:14])
    np.testing.assert_allclose(rates, 0.5, rtol=0.05)


@pytest.mark.slow
def test_uzawa_that_comes_no_nearer_ends() -> None:
    """Where nothing is stiff the forces may turn in a circle, or not, as rounding has it: a thousand steps took 9 s."""

    def turned(force: Any, inner: Settings) -> Candidate:
        del inner
        return Candidate(Answer(np.zeros(3), np.array([-force[1], force[0]]), None, np.zeros(0)))

    def uzawa(most: int | None) -> Candidate:
        settings = Settings(1e-9, most, None, None, {})
        return _uzawa(settings, np.array([1.0, 0.0]), turned, lambda step: step.answer.normal_force, lambda _: 1.0)

    ended, stopped = uzawa(None), uzawa(120)
    assert "no nearer in 100 iterations" in ended.status
    assert "stopped after 120" in stopped.status
    assert not ended.claimed
    assert not stopped.claimed
    assert 100 < len(ended.history) < 120


@pytest.mark.slow
@pytest.mark.parametrize("pull", list(PULLS)[1:] + list(PULLS)[:1])
def test_uzawa_where_contacts_rest_at_zero(pull: str) -> None:
    """Gaps of zero: a penetration relative to itself is 1 until it is the rounding of the displacements."""
    force, origin, moved, friction, status = PULLS[pull]
    solution = cq.solve(two_masses(force, origin), "augmented-lagrangian", update="uzawa")
    np.testing.assert_allclose(solution.displacement, [*moved, 0.0, 0.0], 1e-9, atol=1e-16)
    np.testing.assert_allclose(solution.friction_force[:, 0], friction, 1e-9, atol=1e-9)
    assert " ".join(solution.contact_status) == status


def test_what_is_no_answer_has_a_history_and_names() -> None:
    problem = two_masses(12.0).replace(contact_names=["big", "small"])
    with pytest.raises(cq.NotConverged, match="stopped after 1 iterations, while small still changed") as stopped:
        solved("lagrange-multiplier", problem, max_iter=1)
    assert stopped.value.history == (1.0,)
    assert stopped.value.solution is not None
    with pytest.raises(cq.NotConverged, match="stopped after 1e-09 s"):
        solved("augmented", problem, time_limit=1e-9)
    loose = pad(3636.0).replace(contact_names=["shoe"])
    none = find("master-slave").solve_friction(loose, Settings())
    assert none.status.startswith(
        "master-slave: no combination of open, stick and slip is left to try that could mend "
    )
    assert "shoe; try active-set, which searches among all contacts" in none.status
    assert none.history == (1.0,)
    adrift = pad(0.0, pressed=-1.0)
    with pytest.raises(cq.NoEquilibrium, match="no contact, friction or tie holds back"):
        cq.solve(adrift, "penalty", penalty=10.0)


@pytest.mark.slow
def test_walls_that_conflict_are_named() -> None:
    squeezed = walls_that_conflict()
    for name in EXACT:
        with pytest.raises(cq.NoEquilibrium, match="left, right"):
            solved(name, squeezed)
    between = cq.solve(squeezed, "penalty", penalty=9.0)
    np.testing.assert_allclose(between.normal_force, [0.9, 0.9], 1e-14)


def test_what_is_asked_for_wrongly() -> None:
    twin = rough_truss()
    for name in ("lagrange-multiplier", "augmented-lagrangian", "master-slave"):
        with pytest.raises(cq.Unsupported, match=f"{name}: algorithm='tresca' takes convex steps of another method"):
            cq.solve(twin, name, algorithm="tresca")
    space = cq.ContactProblem(np.eye(3), np.ones(3), -np.eye(1, 3), [0.0], tangent=np.eye(3)[1:], friction=0.3)
    with pytest.raises(cq.Unsupported, match="penalty: two tangential rows"):
        cq.solve(space, "penalty", penalty=1.0)
    for wrong in (0.0, -1.0, [1.0, 2.0], np.nan):
        with pytest.raises(cq.InvalidProblem, match="tangential_penalty: expected a positive"):
            cq.solve(twin, "penalty", penalty=1.0, tangential_penalty=wrong)
    smooth = twin.replace(friction=0.0)
    for name in ("penalty", "augmented-lagrangian"):
        with pytest.raises(cq.InvalidProblem, match="tangential_penalty was given, and the problem has no friction"):
            cq.solve(smooth, name, penalty=1.0, tangential_penalty=1.0)
    with pytest.raises(cq.InvalidProblem, match="penalty has no default"):
        cq.solve(twin, "penalty")


def test_a_body_too_large_to_factorise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CONTACTQP_SPARSE_SOLVER", "pyamg")
    with pytest.raises(cq.Unsupported, match=r"lagrange-multiplier: .* not factorised"):
        cq.solve(rough_truss(), "lagrange-multiplier")


def test_the_registry_says_what_a_method_does_with_friction() -> None:
    named = {method.name: method.friction for method in cq.methods()}
    own = {name for name, friction in named.items() if friction == "stick and slip"}
    assert own == {
        "master-slave",
        "lagrange-multiplier",
        "penalty",
        "perturbed-lagrangian",
        "augmented-lagrangian",
    }
    assert named["active-set"] == "convex steps"
    assert named["projected-gauss-seidel"] == ""


def test_a_warm_start_saves_the_free_solution() -> None:
    problem = rough_truss(0.8)
    cold = solved("lagrange-multiplier", problem)
    warm = solved("lagrange-multiplier", problem, warm_start=cold)
    assert (len(cold.history), len(warm.history)) == (2, 1)
    np.testing.assert_array_equal(warm.displacement, cold.displacement)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, pytest.param(6, marks=pytest.mark.slow)])
def test_sparse_stiffness_and_other_units(count: int) -> None:
    import scipy.sparse as sp

    rng, compared = np.random.default_rng(5), 0
    for _ in range(count):
        problem = random_problem(rng)
        length, force = 10.0 ** rng.uniform(-6, 6), 10.0 ** rng.uniform(-9, 9)
        other = cq.ContactProblem(
            stiffness=sp.csc_array(problem.stiffness * force / length),
            load=problem.load * force,
            normal=problem.normal,
            gap=problem.gap * length,
            tangent=problem.tangent,
            friction=problem.friction,
            slip_origin=problem.slip_origin * length,
            tie=problem.tie,
            tie_value=problem.tie_value * length,
        )
        for method, options in (("lagrange-multiplier", {}), ("penalty", {"penalty": 40.0})):
            scaled = {name: value * force / length for name, value in options.items()}
            try:
                here = cq.solve(problem, method, **options)
            except (cq.NotConverged, cq.NoEquilibrium) as error:
                with pytest.raises(type(error)):
                    cq.solve(other, method, **scaled)
                continue
            there = cq.solve(other, method, **scaled)
            assert there.contact_status.tolist() == here.contact_status.tolist()
            atol = 1e-10 * np.max(abs(here.displacement))
            np.testing.assert_allclose(there.displacement / length, here.displacement, 0, atol=atol)
            compared += 1
    assert compared >= count


def test_an_answer_of_the_loop_that_is_wrong_is_refused() -> None:
    """The certificate looks at what an exact method returns: friction the other way does not pass as its answer."""
    from contactqp.solving.methods import find
    from contactqp.solving.runs import Run
    from contactqp.solving.solve import begin

    right = begin(rough_truss(), "lagrange-multiplier")
    assert find("lagrange-multiplier").exact
    assert isinstance(right, Run)
    candidate = right.candidate
    assert candidate.friction_force is not None
    right.candidate = replace(candidate, answer=replace(candidate.answer, friction_force=-candidate.friction_force))
    with pytest.raises(cq.NotCertified, match="equilibrium"):
        right.finish()


@pytest.mark.parametrize("order", [[0, 1, 2], [1, 2, 0], [2, 1, 0]])
@pytest.mark.parametrize("name", ["lagrange-multiplier", "master-slave", "augmented", "augmented, 0"])
def test_a_contact_that_sticks_alone_slips_where_another_sticks_instead(name: str, order: list[int]) -> None:
    """Three masses on springs slide on a floor: after two steps the last one that sticks should slip, and none would
    hold them. The first, which slipped against its later friction, sticks instead: forces -3/10, 1 and 1.
    """
    chain = 10.0 * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])[np.ix_(order, order)]
    K, none, along = np.zeros((6, 6)), np.zeros((3, 3)), np.eye(3)
    K[:3, :3] = chain
    load = np.append(np.array([-1.5, 0.7, 2.5])[order], [-2.0, -2.0, -2.0])
    rows = {"normal": np.hstack([none, -along]), "tangent": np.hstack([along, none])}
    problem = cq.ContactProblem(K, load, gap=np.zeros(3), friction=0.5, **rows)
    solution = solved(name, problem)
    np.testing.assert_allclose(solution.friction_force.ravel(), np.array([-0.3, 1.0, 1.0])[order], rtol=1e-12)
    np.testing.assert_allclose(solution.displacement[:3], np.array([0.0, 0.12, 0.27])[order], atol=1e-13)
    assert solution.contact_status.tolist() == np.array(["stick", "slip", "slip"])[order].tolist()
