"""Enclosures hold the exact rationals, are narrow, and refuse what balls cannot decide."""

from __future__ import annotations

import time
from dataclasses import replace
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from benchmarks.problem_families import FAMILIES, family
from contactqp.elements.material import Material
from contactqp.elements.shapes import rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.oracle.exact import enclosed_answer, refinement
from contactqp.oracle.exact.enclosed_answer import enclose
from contactqp.oracle.exact.refinement import FixedMatrix, fixed, least_eigenvalue, refine
from tests.examples import truss

# Redundant rows, contacts that touch with no force or with one of 1e-20 of the largest, stiffnesses ten decades apart.
REFUSED = {
    "interference_removed",
    "decaying_path",
    "unstrained",
    "stack_free_to_slide",
    "held_by_ties",
    "shared_with_ties",
    "summed_rows",
    "exactly_grazing",
    "duplicated_rows",
    "single_grazing",
    "redundant_polytopes",
    "bounds_everywhere",
    "linear_programs",
    "paired_inequalities",
    "chains_without_energy",
    "pyramids_of_feet",
}


def pressed_block(divisions: tuple[int, int]) -> cq.ContactProblem:
    """A block that is pressed onto a paraboloid."""
    body = Body(rectangle(1.0, 0.5, divisions, "quad4"), Material(modulus=1.0, poisson=0.3), "plane-strain", name="b")
    structure = Structure([body])
    system = structure.assemble([Support("b", "top", 0), Support("b", "top", 1, -0.02)])
    contact = cq.pair(structure.surface("b", "bottom"), cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0))
    return system.problem([contact])


def holds(enclosed: cq.ExactSolution, exact: cq.ExactSolution) -> bool:
    """Whether every interval holds its exact number; of displacements that move freely, the forces that they make."""
    assert enclosed.radius is not None
    names = ["displacement", "normal_force", "tie_force", "gap"]
    if enclosed.free_motions:
        names = ["normal_force", "tie_force"]
        apart = enclosed.displacement - exact.displacement
        stiffness = [[F(x) for x in row] for row in sp.csr_matrix(enclosed.problem.stiffness).toarray().tolist()]
        if any(abs(sum(x * y for x, y in zip(row, apart, strict=True))) > F(1, 10**25) for row in stiffness):
            return False
    return all(
        abs(mid - value) <= F(float(radius))
        for name in names
        for mid, radius, value in zip(
            getattr(enclosed, name), getattr(enclosed.radius, name), getattr(exact, name), strict=True
        )
    )


@pytest.mark.sampled(168)
@pytest.mark.parametrize("name", [name for name, entry in FAMILIES.items() if entry.solvable and "printed" not in name])
@pytest.mark.parametrize("seed", [1, 2])
def test_every_interval_holds_the_exact_rational(name: str, seed: int) -> None:
    problem = family(name, seed)
    try:
        enclosed = cq.exact(problem, enclose=True)
    except (cq.NotCertified, cq.NotConverged):
        assert name in REFUSED | {"lifted_off_spring", "staged_programs"}
        return
    exact = cq.exact(problem)
    assert holds(enclosed, exact)
    assert not enclosed.rational
    assert enclosed.contact_status == exact.contact_status
    assert enclosed.unique_forces
    assert exact.unique_forces
    assert enclosed.radius is not None
    pushing = enclosed.doubles.normal_force > 0
    assert np.all(enclosed.radius.normal_force[pushing] <= 1e-12 * enclosed.doubles.normal_force[pushing])


@pytest.mark.slow
def test_intervals_that_are_a_little_too_narrow_would_be_seen() -> None:
    problem = pressed_block((10, 5))
    enclosed, exact = cq.exact(problem, enclose=True), cq.exact(problem, enclose=False)
    assert holds(enclosed, exact)
    assert enclosed.radius is not None
    narrower = replace(enclosed.radius, displacement=enclosed.radius.displacement * 0)
    assert not holds(replace(enclosed, radius=narrower), exact)


@pytest.mark.slow
def test_two_hundred_contacts_are_known_to_twelve_digits() -> None:
    problem = pressed_block((199, 30))
    assert problem.contacts == 200
    answer = cq.exact(problem)
    assert not answer.rational
    assert answer.radius is not None
    doubles, pushing = answer.doubles, np.array(answer.contact_status) == "closed"
    assert 50 < np.count_nonzero(pushing) < 200
    assert np.all(answer.radius.normal_force[pushing] <= 1e-12 * doubles.normal_force[pushing])
    seen = abs(doubles.displacement) > 1e-25 * np.max(abs(doubles.displacement))
    assert np.all(answer.radius.displacement[seen] <= 1e-12 * abs(doubles.displacement[seen]))
    assert np.all(answer.radius.gap[~pushing] <= 1e-12 * doubles.gap[~pushing])
    # The block is symmetric, but its floats are not to the last digit: nodes in the middle move sideways by rounding.
    assert np.count_nonzero(~seen) < 0.02 * problem.dimension
    assert any("positive definite" in line for line in answer.proof)
    solution = cq.solve(problem)
    assert solution.normal_force == pytest.approx(doubles.normal_force, rel=1e-9)


@pytest.mark.slow
def test_two_hundred_contacts_condensed_to_a_dense_matrix() -> None:
    rng = np.random.default_rng(6)
    basis = rng.standard_normal((200, 200))
    problem = cq.ContactProblem(
        basis @ basis.T / 200 + np.eye(200), rng.standard_normal(200), np.eye(200), 0.1 * rng.random(200)
    )
    answer = cq.exact(problem)
    assert answer.radius is not None
    pushing = answer.doubles.normal_force > 0
    assert 20 < np.count_nonzero(pushing) < 180
    assert np.all(answer.radius.normal_force[pushing] <= 1e-12 * answer.doubles.normal_force[pushing])
    # Independently: the set's system in doubles.
    K, f = problem.stiffness, problem.load
    system = np.block([[K, np.eye(200)[:, pushing]], [np.eye(200)[pushing], np.zeros((pushing.sum(),) * 2)]])
    solved = np.linalg.solve(system, np.concatenate([f, problem.gap[pushing]]))
    assert answer.doubles.normal_force[pushing] == pytest.approx(solved[200:], rel=1e-9)


def test_a_wrong_set_is_not_enclosed() -> None:
    refined = refine(pressed_block((10, 5)))
    assert enclose(refined).definite
    weak = refined.closed[1:]
    with pytest.raises(cq.NotCertified, match="neither the gap nor the force"):
        enclose(replace(refined, closed=weak))


def test_residuals_left_in_widen_the_radii_in_proportion() -> None:
    refined = refine(pressed_block((10, 5)))
    spoiled = replace(refined, imbalance=refined.imbalance + fixed(np.full(110, 2.0**-80)))
    radius = enclose(spoiled).displacement
    assert np.all(radius > 1e10 * enclose(refined).displacement)
    # What 2^-80 on every unknown really moves lies within.
    shift = np.linalg.solve(refined.problem.stiffness.toarray(), np.full(110, 2.0**-80))
    assert np.all(abs(shift) <= 10 * radius)


def test_what_just_touches_is_refused_by_name_or_decided_in_rationals() -> None:
    touching = cq.ContactProblem([[2.0]], [1.0], [[1.0]], [0.5], contact_names=["stop"])
    with pytest.raises(cq.NotCertified, match="neither the gap nor the force of stop"):
        cq.exact(touching, enclose=True)
    assert cq.exact(touching).contact_status == ("grazing",)


def test_a_gap_of_a_part_in_1e15_is_decided() -> None:
    gap = float(np.nextafter(0.5, 1))
    answer = cq.exact(cq.ContactProblem([[2.0]], [1.0], [[1.0]], [gap]), enclose=True)
    assert answer.contact_status == ("open",)
    closed = cq.exact(cq.ContactProblem([[2.0]], [1.0], [[1.0]], [float(np.nextafter(0.5, 0))]), enclose=True)
    assert closed.contact_status == ("closed",)
    assert closed.doubles.normal_force[0] == 2.0**-53


def test_redundant_contacts_are_refused() -> None:
    stops = cq.ContactProblem([[2.0]], [3.0], [[1.0], [1.0]], [0.5, 0.5])
    with pytest.raises(cq.NotCertified, match=r"not proven|neither the gap"):
        cq.exact(stops, enclose=True)


def test_friction_is_refused() -> None:
    with pytest.raises(cq.Unsupported, match="friction"):
        cq.exact(truss(tangent=[[1.0, 0.0]], friction=0.3), enclose=True)
    with pytest.raises(cq.Unsupported, match="not a quadratic program"):
        refine(truss(tangent=[[1.0, 0.0]], friction=0.3))


def test_tangential_rows_without_friction_are_enclosed_too() -> None:
    plain = truss(tangent=[[1.0, 0.0]], friction=0.0, slip_origin=[[1e-3]])
    enclosed, exact = cq.exact(plain, enclose=True), cq.exact(plain)
    assert enclosed.slip is not None
    assert exact.slip is not None
    assert enclosed.radius is not None
    assert enclosed.radius.slip is not None
    assert abs(enclosed.slip[0, 0] - exact.slip[0, 0]) <= F(float(enclosed.radius.slip[0, 0]))
    assert enclosed.friction_force is not None
    assert enclosed.friction_force[0, 0] == 0


@pytest.mark.slow
@pytest.mark.parametrize("method", ["active-set", "clarabel", "osqp", "projected-gauss-seidel"])
def test_refinement_by_any_method_ends_far_beyond_doubles(method: str) -> None:
    problem = pressed_block((10, 5))
    refined = refine(problem, method, digits=60)
    assert refined.closed.tolist() == np.flatnonzero(cq.exact(problem).doubles.normal_force > 0).tolist()
    exact = cq.exact(problem, enclose=False)
    error = max(abs(x - y) for x, y in zip(refined.displacement.fractions(), exact.displacement, strict=True))
    assert 0 < error < F(1, 10**55)


def test_refinement_of_a_contact_that_doubles_leave_undecided() -> None:
    # A stop that is 2^-70 of the load from touching: its own load is beyond the doubles beside it.
    problem = cq.ContactProblem(np.diag([1.0, 1.0]), [1.0, 2.0**-70], [[1.0, 0.0], [0.0, 1.0]], [0.5, 0.0])
    refined = refine(problem)
    assert refined.closed.tolist() == [0, 1]
    assert refined.normal_force.fractions().tolist() == [F(1, 2), F(1, 2**70)]


def test_refinement_ends_when_what_is_left_no_longer_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = pressed_block((4, 2))

    def nothing_more(walk: Any) -> None:
        walk.settled = True

    monkeypatch.setattr(refinement._Walk, "step", nothing_more)
    with pytest.raises(cq.NotConverged, match=rf"after {refinement.MOST_IDLE_ROUNDS} rounds, 1e-40 wanted"):
        refine(problem, digits=40)


@pytest.mark.slow
def test_refinement_ends_where_a_correction_has_no_answer() -> None:
    # Units 1e54 apart: a correction has no answer in doubles, and forty rounds change nothing of what is left.
    problem = cq.ContactProblem(
        [
            [1.9474907362110682e58, 2.262464535677256e74, 2.1304900783462597e46, -1.1371358823982071e04],
            [2.262464535677256e74, 1.5959217702184217e91, 1.3559701269470461e63, -3.3877954276191509e20],
            [2.1304900783462597e46, 1.3559701269470461e63, 1.3159904258525295e35, -6.0892953602145653e-08],
            [-1.1371358823982071e04, -3.3877954276191509e20, -6.0892953602145653e-08, 7.048317636788607e-50],
        ],
        [4.3689130158990183e91, -5.7795746911228506e107, 3.1280912572552506e80, 9.4397839041805723e37],
        [[2.0, 1.0, 2.0, 2.0], [2.0, -1.0, 0.0, -1.0], [1.0, 2.0, 2.0, 1.0]],
        [-1.2246964524181805, -0.8321491168137407, 2.592983837293826],
    )
    with pytest.raises(cq.NotConverged, match=r"residuals of .* after \d+ rounds, 1e-40 wanted \(.*no contact forces"):
        refine(problem, digits=40)


def test_what_is_magnified_beyond_doubles_is_no_overflow() -> None:
    """A far gap beside residuals of next to nothing."""
    gap = fixed(np.array([2.0**900, 1.0]))
    np.testing.assert_array_equal(gap.floats_at(100), [2.0**1000, 2.0**100])
    with pytest.raises(cq.NotConverged, match="leave the range of doubles"):
        gap.floats_at(200)


def test_products_of_integers_are_not_rounded() -> None:
    rng = np.random.default_rng(3)
    matrix = sp.random(30, 20, 0.2, random_state=1, format="csr")
    x = rng.standard_normal(20) * 10.0 ** rng.integers(-30, 30, 20)
    exact = [
        sum((F(a) * F(b) for a, b in zip(row, x.tolist(), strict=True)), F(0)) for row in matrix.toarray().tolist()
    ]
    assert (FixedMatrix(matrix) @ fixed(x)).fractions().tolist() == exact
    assert fixed([0.0, -3.5, 5e-324]).fractions().tolist() == [0, F(-7, 2), F(5e-324)]
    assert (fixed([1.5]) - fixed([0.25]) + fixed([1e300])).fractions()[0] == F(1e300) + F(5, 4)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(10))
def test_the_least_eigenvalue_is_never_overestimated(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = 40
    rotation = np.linalg.qr(rng.standard_normal((size, size)))[0]
    values = 10.0 ** rng.uniform(-8, 0, size)
    matrix = rotation @ np.diag(values) @ rotation.T
    matrix = (matrix + matrix.T) / 2
    bound, truth = least_eigenvalue(sp.csc_matrix(matrix)), np.linalg.eigvalsh(matrix)[0]
    assert bound is not None
    assert 0.05 * truth < bound < truth
    assert least_eigenvalue(sp.csc_matrix(matrix - 1.01 * truth * np.eye(size))) is None
    assert least_eigenvalue(sp.csc_matrix(matrix), uncertainty=truth) is None


def test_a_matrix_that_rounding_may_make_singular_is_factorised_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not known of the matrix is as large as its least eigenvalue: no shift can prove it, and none is tried."""
    made: list[int] = []
    factors = refinement._factors
    monkeypatch.setattr(refinement, "_factors", lambda matrix: (made.append(1), factors(matrix))[1])
    chain = sp.csc_matrix(sp.diags([-np.ones(59), 2 * np.ones(60), -np.ones(59)], [-1, 0, 1]))
    truth = 2 - 2 * np.cos(np.pi / 61)
    assert least_eigenvalue(chain, uncertainty=0.6 * truth) is None
    assert len(made) == 1
    bound = least_eigenvalue(chain, uncertainty=0.4 * truth)
    assert bound is not None
    assert 0 < bound < 0.6 * truth


@pytest.mark.parametrize("size", [3, 60, 2000])
def test_the_least_eigenvalue_of_a_chain_sparse_or_dense(size: int) -> None:
    """Three unknowns are dense, more are not: 2 - 2 cos(pi / (n + 1))."""
    ends = -np.ones(size - 1)
    chain = sp.csc_matrix(sp.diags([ends, 2 * np.ones(size), ends], [-1, 0, 1]))
    truth = 2 - 2 * np.cos(np.pi / (size + 1))
    bound = least_eigenvalue(chain)
    assert bound is not None
    assert 0.05 * truth < bound < truth
    less = sp.csc_matrix(chain - 1.001 * truth * sp.identity(size))
    assert least_eigenvalue(less) is None


@pytest.mark.slow
def test_dense_matrices_of_thousands_are_proven_within_seconds() -> None:
    """Products of dense factors are made by BLAS, not entry by entry."""
    rng = np.random.default_rng(2)
    basis = rng.standard_normal((1500, 1500))
    matrix = sp.csc_matrix(basis @ basis.T / 1500 + np.eye(1500))
    started = time.process_time()
    bound = least_eigenvalue(matrix)
    assert time.process_time() - started < 10
    assert bound is not None
    assert 0.4 < bound <= np.linalg.eigvalsh(matrix.toarray())[0]


def test_a_singular_matrix_is_not_proven_definite() -> None:
    assert least_eigenvalue(sp.csc_matrix(np.array([[1.0, -1.0], [-1.0, 1.0]]))) is None
    assert least_eigenvalue(sp.csc_matrix(np.array([[0.0]]))) is None
    assert least_eigenvalue(sp.csc_matrix(np.array([[0.0, 1.0], [1.0, 0.0]]))) is None


@pytest.mark.parametrize("load", [[300.0, 0.0], [300.0, 1e-6]])
def test_where_there_is_no_equilibrium_its_proof_is_handed_on(load: list[float]) -> None:
    """Gaps that overlap by 1e-9, and a load that drives an unknown without stiffness."""
    walls = [[1.0, 0.0], [-1.0, 0.0]]
    driven = load[1] > 0
    problem = cq.ContactProblem(np.diag([1e5, 0.0 if driven else 1e5]), load, walls, [1.0, -1.0 - 1e-9 * (not driven)])
    with pytest.raises(cq.NoEquilibrium, match="drives" if driven else "contact 0, contact 1") as caught:
        cq.exact(problem, enclose=True)
    assert caught.value.proof is not None


@pytest.mark.slow
def test_motions_that_contacts_without_force_block_prove_no_absence() -> None:
    """Three feet in pyramids of friction: no motion is free, and held at values of floats they would miss contacts."""
    problem = family("pyramids_of_feet", 1)
    assert cq.exact(problem, enclose=False).displacement is not None
    with pytest.raises(
        cq.NotCertified, match="the stiffness, with the contacts that push, is not proven to be positive definite"
    ):
        cq.exact(problem, enclose=True)


def chain(count: int) -> cq.ContactProblem:
    """A sparse chain of springs between walls, pulled at its end against a stop."""
    K = sp.diags([-np.ones(count - 1), 2.0 * np.ones(count), -np.ones(count - 1)], [-1, 0, 1], format="csr")
    end = sp.csr_matrix(([1.0], ([0], [count - 1])), shape=(1, count))
    return cq.ContactProblem(K, np.arange(count) == count - 1.0, end, [0.5])


def test_what_is_too_large_to_be_factorised_is_refused_before_it_is_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    assert cq.exact(chain(400)).free_motions == ()
    monkeypatch.setattr(enclosed_answer, "factors_are_dear", lambda _: True)
    monkeypatch.setattr(enclosed_answer, "solve", lambda *_, **__: pytest.fail("it was solved"))
    with pytest.raises(cq.Unsupported, match=r"exact: 400 unknowns: an enclosure needs factors .* a coarser mesh"):
        cq.exact(chain(400))


def test_factors_whose_rounding_is_not_bounded_are_told_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    """That the stiffness was not proven to be positive definite had been said, after as long as a minute."""
    monkeypatch.setattr(enclosed_answer, "MOST_WORK", 100.0)
    monkeypatch.setattr(enclosed_answer, "refine", lambda *_, **__: pytest.fail("it was refined"))
    with pytest.raises(cq.NotCertified, match=r"take more than the 1e\+02 multiplications whose rounding is bounded"):
        cq.exact(chain(400), enclose=True)
