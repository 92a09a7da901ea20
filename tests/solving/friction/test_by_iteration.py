"""Friction on bodies that are iterated on: the answers of the factorising way, forged ones, and what is refused."""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

import contactqp as cq
from contactqp.certificate.state_bodies import IteratedBodies
from contactqp.linalg import multigrid
from contactqp.linalg.iterated_states import FrictionalAnswer, FrictionRows
from contactqp.linalg.iteration import frictional_iteration, iterated
from contactqp.linalg.pardiso import SOLVER_VARIABLE
from contactqp.solving.friction import by_iteration
from tests.blocks_in_space import fresh, on_paraboloid, on_sphere, stacked, with_ties

needs_pyamg = pytest.mark.skipif(not multigrid.available(), reason="needs pyamg")
pytestmark = [needs_pyamg, pytest.mark.usefixtures("iterating")]


@pytest.fixture
def iterating(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SOLVER_VARIABLE, "pyamg")


def factorised(problem: cq.ContactProblem, **options: Any) -> cq.Solution:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(SOLVER_VARIABLE, "superlu")
        return cq.solve(fresh(problem), **options)


def uneven(problem: cq.ContactProblem) -> cq.ContactProblem:
    """Coefficients from none to two, contact by contact."""
    return problem.replace(friction=np.random.default_rng(1).choice([0.0, 0.05, 0.3, 2.0], problem.contacts))


def from_elsewhere(problem: cq.ContactProblem) -> cq.ContactProblem:
    """Slip counted from where nothing has been."""
    origin = np.random.default_rng(2).normal(size=problem.slip_origin.shape) * 1e-3
    return problem.replace(slip_origin=origin)


def in_units(problem: cq.ContactProblem, length: float, force: float, row: float) -> cq.ContactProblem:
    """The same with other units and longer rows."""
    return cq.ContactProblem(
        stiffness=problem.stiffness * (force / length),
        load=problem.load * force,
        normal=problem.normal * row,
        gap=problem.gap * row * length,
        tangent=problem.tangent * row,
        friction=problem.friction,
        slip_origin=problem.slip_origin * row * length,
        tie=problem.tie,
        tie_value=problem.tie_value * length,
        near_null_space=problem.near_null_space,
    )


BLOCK = on_paraboloid(friction=0.3)
CASES = {
    "a row an unknown": BLOCK,
    "hardly any friction": BLOCK.replace(friction=1e-6),
    "all stick": BLOCK.replace(friction=5.0),
    "coefficients of all sizes": uneven(BLOCK),
    "pushed along, every contact turns its slip": on_paraboloid(friction=0.2, pushed=0.004),
    "three unknowns a row": on_sphere(friction=0.3),
    "mortar": stacked(friction=0.3),
    "ties": with_ties(BLOCK),
    "slip from elsewhere": from_elsewhere(BLOCK),
    "nothing touches": BLOCK.replace(gap=BLOCK.gap + 1.0),
    "small lengths, large forces, long rows": in_units(BLOCK, 1e-6, 1e9, 1e3),
    "large lengths, small forces, short rows": in_units(BLOCK, 1e6, 1e-9, 1e-3),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_answer_is_that_of_the_factorising_way(name: str) -> None:
    problem = fresh(CASES[name])
    solution, reference = cq.solve(problem), factorised(problem)
    certificate = solution.certificate
    assert certificate.passed
    assert certificate.basis == "state"
    push = np.max(reference.normal_force, initial=0.0)
    assert np.max(abs(solution.normal_force - reference.normal_force)) <= 1e-8 * push
    assert np.max(abs(solution.friction_force - reference.friction_force)) <= 1e-8 * push
    assert np.max(abs(solution.displacement - reference.displacement)) <= 1e-7 * np.max(abs(reference.displacement))
    assert solution.tie_force == pytest.approx(reference.tie_force, rel=1e-6, abs=1e-7 * push)
    assert solution.contact_status.tolist() == reference.contact_status.tolist()
    assert solution.work.solver == "pyamg"
    assert solution.work.factorisations == solution.work.back_substitutions == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a row an unknown", "three unknowns a row"])
def test_the_fixed_point_comes_to_the_same_without_newton(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = fresh(CASES[name])
    monkeypatch.setattr(by_iteration.FrictionNewton, "run", lambda *_: None)
    solution, reference = cq.solve(problem), factorised(problem)
    push = np.max(reference.normal_force)
    assert solution.work.iterations is not None
    assert solution.work.iterations > 2
    assert np.max(abs(solution.normal_force - reference.normal_force)) <= 1e-7 * push
    assert np.max(abs(solution.friction_force - reference.friction_force)) <= 1e-7 * push


@pytest.mark.slow
@pytest.mark.parametrize("too_much", [1.004, 1.3])
def test_an_indefinite_stiffness_is_refused_where_no_coarse_level_shows_it(
    too_much: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A few unknowns in the middle of the block have negative energy along one of their motions."""
    monkeypatch.setattr(multigrid, "COARSEST", 100)
    problem = fresh(BLOCK)
    right = cq.solve(problem)
    K = sp.csr_matrix(problem.stiffness)
    row = K[problem.dimension // 2]
    near = row.indices[np.argsort(-abs(row.data))][:9]
    values, vectors = np.linalg.eigh(K[near][:, near].toarray())
    z = np.zeros((problem.dimension, 1))
    z[near, 0] = vectors[:, -1]
    curved = problem.replace(stiffness=K - too_much * values[-1] * sp.csr_matrix(z) @ sp.csr_matrix(z).T)
    for ask in (cq.solve, lambda one: cq.certify(one, right.displacement, right.normal_force, right.friction_force)):
        with pytest.raises(cq.InvalidProblem, match="expected positive semidefinite, got z'Kz = -"):
            ask(curved)


@pytest.mark.slow
def test_a_next_step_starts_from_the_one_before() -> None:
    problem = fresh(BLOCK)
    first = cq.solve(problem)
    further = problem.replace(load=1.02 * problem.load, slip_origin=first.slip + problem.slip_origin)
    cold, warm = cq.solve(further), cq.solve(further, warm_start=first)
    assert warm.work.krylov_iterations < cold.work.krylov_iterations
    assert np.max(abs(warm.normal_force - factorised(further).normal_force)) <= 1e-8 * np.max(cold.normal_force)


def forged(problem: cq.ContactProblem, way: str) -> tuple[Any, ...]:
    """The right answer to a question nearby, or forces that are one part in a hundred off."""
    if way == "friction":
        right = cq.solve(problem.replace(friction=1.01 * problem.friction))
        return right.displacement, right.normal_force, right.friction_force, right.tie_force
    right = cq.solve(problem)
    u, normal, friction = right.displacement.copy(), right.normal_force.copy(), right.friction_force.copy()
    if way == "one force":
        normal[int(np.argmax(normal))] *= 1.01
    elif way == "all forces":
        normal, friction = 1.01 * normal, 1.01 * friction
    elif way == "direction":
        friction = friction @ np.array([[np.cos(0.01), np.sin(0.01)], [-np.sin(0.01), np.cos(0.01)]])
    return u, normal, friction, right.tie_force


@pytest.mark.slow
def test_an_answer_that_is_not_certifiable_is_solved_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solved to the same part it would stay as it is, and be refused until all combinations are used up."""
    asked: list[float] = []
    plain = by_iteration.CombinationSystem.solved

    def solved(self: Any, x: Any, tolerance: float, energy: float, most: int = 10_000) -> Any:
        asked.append(energy)
        return plain(self, x, tolerance, energy, most)

    refusals = count()
    good = by_iteration.FrictionNewton.certifiable
    monkeypatch.setattr(by_iteration.CombinationSystem, "solved", solved)
    monkeypatch.setattr(
        by_iteration.FrictionNewton, "certifiable", lambda self, answer: next(refusals) > 1 and good(self, answer)
    )
    solution = cq.solve(fresh(BLOCK))
    assert solution.certificate.passed
    assert min(asked) == pytest.approx(1e-2 * asked[0])


@pytest.mark.sampled(8)
@pytest.mark.parametrize("way", ["friction", "one force", "all forces", "direction"])
@pytest.mark.parametrize("name", ["a row an unknown", "mortar"])
def test_forces_that_are_one_part_in_a_hundred_off_are_refused(name: str, way: str) -> None:
    problem = fresh(CASES[name])
    judged = cq.certify(problem, *forged(problem, way))
    assert not judged.passed
    assert judged.failures


def beam(springs: int, friction: float) -> cq.ContactProblem:
    """A stiff chain in space, hung from one soft spring a direction, that stands on its last node: next to all of its
    residual may be hidden in the chain."""
    n = 3 * springs
    chain = sp.diags([np.full(n, 2.0), np.full(n - 3, -1.0), np.full(n - 3, -1.0)], [0, 3, -3]).tolil()
    for axis in range(3):
        chain[n - 3 + axis, n - 3 + axis] = 1.0
        chain[axis, axis] = 1.0 + 1e-4
    normal, tangent = np.zeros((1, n)), np.zeros((2, n))
    normal[0, n - 1], tangent[0, n - 3], tangent[1, n - 2] = -1.0, 1.0, 1.0
    load = np.zeros(n)
    load[-3:] = 0.2, 0.1, -1.0
    return cq.ContactProblem(sp.csc_matrix(chain), load, normal, [0.0], tangent=tangent, friction=friction)


@pytest.mark.slow
def test_an_answer_that_is_far_off_is_told_in_a_few_turns_of_its_slips() -> None:
    """They do not settle: it had taken 116 steps, thirty times those that a right answer takes."""
    problem = fresh(CASES["pushed along, every contact turns its slip"])
    found, steps = cq.solve(problem), frictional_iteration(problem)
    before = steps.krylov_iterations
    assert cq.certify(problem, found.displacement, found.normal_force, found.friction_force).passed
    right = steps.krylov_iterations - before
    without = cq.solve(problem.replace(friction=0.0))
    before = steps.krylov_iterations
    assert not cq.certify(problem, without.displacement, without.normal_force, 0 * found.friction_force).passed
    assert 0 < right < steps.krylov_iterations - before <= 50
    larger = cq.certify(problem, 1.01 * found.displacement, 1.01 * found.normal_force, 1.01 * found.friction_force)
    assert larger.distance == pytest.approx(0.01, rel=0.02)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("off", [0.0, 1e-5, 0.1])
def test_a_force_that_a_small_residual_hides_is_compared_with_the_state(off: float) -> None:
    problem = beam(60, 0.3)
    right = factorised(problem)
    rubbing = right.friction_force * (1 + off)
    normal = right.normal_force * (1 + off)
    load = problem.load - problem.normal.T @ normal - problem.tangent.T @ rubbing.ravel()
    u = np.linalg.solve(problem.stiffness.toarray(), load)  # in balance with what was forged
    judged = cq.certify(problem, u, normal, rubbing)
    assert judged.equilibrium <= 1e-9
    assert judged.passed == (off == 0.0)


@pytest.mark.slow
def test_contacts_that_come_twice_share_their_forces_in_some_way() -> None:
    twice = fresh(BLOCK).replace(
        normal=sp.vstack([BLOCK.normal, BLOCK.normal]),
        gap=np.tile(BLOCK.gap, 2),
        tangent=sp.vstack([BLOCK.tangent, BLOCK.tangent]),
        slip_origin=np.zeros((2 * BLOCK.contacts, 2)),
        friction=np.full(2 * BLOCK.contacts, 0.3),
        contact_names=None,
    )
    solution, reference = cq.solve(twice), factorised(BLOCK)
    assert solution.certificate.passed
    push = np.max(reference.normal_force)
    together = solution.normal_force.reshape(2, -1).sum(axis=0)
    assert np.max(abs(together - reference.normal_force)) <= 1e-7 * push
    rubbing = solution.friction_force.reshape(2, -1, 2).sum(axis=0)
    assert np.max(abs(rubbing - reference.friction_force)) <= 1e-7 * push


def test_what_is_not_iterated_on_is_said_with_the_cure() -> None:
    for algorithm in ("newton", "nsgs", "enumeration"):
        with pytest.raises(cq.Unsupported, match=r"'tresca' alone, got .*CONTACTQP_SPARSE_SOLVER=pardiso"):
            cq.solve(BLOCK, algorithm=algorithm)
    with pytest.raises(cq.Unsupported, match=r"clarabel: .*only iterated on"):
        cq.solve(BLOCK, "clarabel")


def test_a_limit_of_time_is_kept_and_hands_over_what_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = fresh(BLOCK)
    right = cq.solve(problem)
    with pytest.raises(cq.NotConverged, match="time limit"):
        cq.solve(problem, time_limit=1e-6)
    monkeypatch.setattr(by_iteration.FrictionNewton, "run", lambda *_: None)
    with pytest.raises(cq.NotConverged, match="have not settled in 3 steps") as ended:
        cq.solve(problem, max_iter=3)
    near = ended.value.solution
    assert near is not None
    assert not near.certificate.passed
    assert np.max(abs(near.normal_force - right.normal_force)) <= 0.05 * np.max(right.normal_force)
    assert near.certificate.distance is not None  # what is known of its error
    assert 0 < near.certificate.distance < 0.1


@pytest.mark.slow
def test_gmres_ends_with_the_time_of_the_call(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = fresh(BLOCK)
    cq.solve(problem)  # what lasts is there
    looks = count()
    patched = "contactqp.linalg.iteration.refuse_late"
    monkeypatch.setattr(patched, lambda what: stopped(what) if next(looks) == 2 else None)
    with pytest.raises(cq.NotConverged, match="before GMRES came to an end"):
        cq.solve(problem.replace(load=1.1 * problem.load))


def stopped(what: str) -> None:
    raise cq.NotConverged(f"stopped, before {what}")


@pytest.fixture
def large(monkeypatch: pytest.MonkeyPatch) -> cq.ContactProblem:
    """A block that is large enough to be iterated on, by nobody's choice."""
    monkeypatch.delenv(SOLVER_VARIABLE)
    monkeypatch.setattr("contactqp.linalg.iteration.MOST_WITH_FRICTION", 0.0)
    monkeypatch.setattr("contactqp.linalg.iteration.MANY_WITH_FRICTION", 20)
    return fresh(BLOCK)


def test_contacts_that_rub_on_springs_are_factorised(large: cq.ContactProblem) -> None:
    """A multigrid hierarchy has no coarser level of springs: friction on them took five times as long, or no end."""
    m, springs = large.contacts, sp.eye_array(large.contacts)
    on_springs = cq.ContactProblem(
        stiffness=sp.csc_array(sp.block_diag([large.stiffness, 1e3 * springs], format="csc")),
        load=np.pad(large.load, (0, m)),
        normal=sp.csr_array(sp.hstack([large.normal, -springs], format="csr")),
        gap=large.gap,
        tangent=sp.csr_array(sp.hstack([large.tangent, sp.csr_array((2 * m, m))], format="csr")),
        friction=large.friction,
    )
    assert iterated(large)
    assert not iterated(on_springs)


@pytest.mark.slow
def test_many_contacts_that_rub_are_iterated_on_and_other_algorithms_have_their_factors(
    large: cq.ContactProblem,
) -> None:
    assert iterated(large)
    assert not iterated(large.replace(friction=0.0))
    solution = cq.solve(large)
    assert solution.work.solver == "pyamg"
    exact = factorised(large)
    assert cq.certify(fresh(large), normal_force=exact.normal_force, friction_force=exact.friction_force).passed
    few = fresh(large.with_contacts(np.arange(30)))
    assert iterated(few)
    assert np.all(cq.critical_friction(few).single > 0)
    other = cq.solve(large, algorithm="nsgs")
    assert other.work.factorisations > 0
    assert other.normal_force == pytest.approx(solution.normal_force, abs=1e-8 * np.max(solution.normal_force))


@pytest.mark.slow
def test_where_the_iteration_ends_without_an_answer_the_body_is_factorised(
    large: cq.ContactProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(by_iteration.FrictionNewton, "run", lambda *_: None)
    monkeypatch.setattr(by_iteration, "MAX_STEPS", 2)
    with pytest.raises(cq.NotConverged):
        cq.solve(large, max_iter=2)
    solution = cq.solve(large)
    assert solution.work.factorisations > 0
    assert solution.work.routes[0].startswith(
        "Tresca fixed-point iteration, each step by active-set: tresca: the friction bounds have not settled"
    )
    assert solution.work.routes[1] == "factorised: its answer is certified"


def test_what_was_formed_at_a_displacement_is_kept_for_that_one_alone() -> None:
    problem = fresh(on_paraboloid((5, 5, 3), friction=0.3))
    solution = cq.solve(problem)
    rows = FrictionRows(problem, frictional_iteration(problem))
    answer = FrictionalAnswer(solution.displacement, solution.normal_force, solution.friction_force, solution.tie_force)
    system = by_iteration.CombinationSystem(rows, rows.coulomb(answer, None))
    x = system.solved(system.closed(1.01 * solution.displacement), 1e-9, 1e-9)
    other = system.closed(1.02 * solution.displacement)
    for at in (x, other, x, other.copy()):
        assert system.error_at(at) == system.error(system.unbalanced(at))
    assert system.error_at(other) > 1e6 * system.error_at(x)


def test_the_response_to_forces_is_that_of_the_opposite_ones_and_of_no_others() -> None:
    problem = fresh(on_paraboloid((5, 5, 3), friction=0.3))
    bodies, random = IteratedBodies(problem), np.random.default_rng(4)
    normal, friction = random.random(problem.contacts), random.standard_normal((problem.contacts, 2))
    first = bodies.response_norm(normal, friction)
    steps = bodies._iteration.krylov_iterations
    assert bodies.response_norm(-normal, -friction) == first
    assert bodies._iteration.krylov_iterations == steps
    truth = np.sqrt(_response(problem, normal, friction))
    assert first == pytest.approx(truth, rel=0.1)
    other = np.sqrt(_response(problem, normal, -friction))
    assert bodies.response_norm(normal, -friction) == pytest.approx(other, rel=0.1)


def _response(problem: cq.ContactProblem, normal: Any, friction: Any) -> float:
    """Return f'K^-1 f of contact forces, by SuperLU."""
    load = problem.normal.T @ normal + problem.tangent.T @ friction.ravel()
    return float(load @ spsolve(sp.csc_matrix(problem.stiffness), load))
