"""Forces of problems that are judged by their energy are bounded contact by contact, and no bound is too small."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from benchmarks.judging import exact_truth
from contactqp.certificate.energy_bounds import CAUTION, NOT_APART, energy_bounds
from contactqp.certificate.uniqueness import _taken_at_random
from contactqp.model.solution import Answer


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(3))
def test_forces_on_soft_parts_are_bounded_beside_stiff_ones(seed: int) -> None:
    """The contact carries its load exactly and nothing else is strained: the force is the load, however soft the body.

    The solution that an answer is compared with is found to a part of the largest strain of the problem, which may
    strain the soft springs by more than the force on them.
    """
    rng, bounded = np.random.default_rng(seed), 0
    for _ in range(8):
        soft, push = 2.0 ** rng.integers(-62, -36), 2.0 ** rng.integers(-55, -25)
        K = np.zeros((3, 3))
        K[0, 0], K[1:, 1:] = 1.0, soft * np.array([[1.0, -1.0], [-1.0, 1.5]])
        problem = cq.ContactProblem(K, [1.0, push, 0.0], [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 1e8])
        moved = rng.choice([-1.0, 1.0]) * 10.0 ** rng.integers(-2, 6)
        spoiled = push * rng.choice([0.9, 0.99, 1.0, 1.01, 1.1])
        answer = Answer(np.array([1.0, 0.0, moved]), np.array([spoiled, 0.0]), None, np.zeros(0))
        bound = energy_bounds(problem, answer).force_bound
        if bound is not None:
            bounded += 1
            assert bound[0] >= abs(spoiled - push) * (1 - 1e-12)
    assert bounded >= 4


@pytest.mark.slow
def test_forces_of_many_skew_contacts_on_soft_parts_are_bounded() -> None:
    """Six hundred contacts, each on a body of its own, of two unknowns, which it holds at zero by its load alone."""
    bodies, push, bounded, rng = 600, 2.0**-40, 0, np.random.default_rng(0)
    body, skew = np.array([[1.0, -1.0], [-1.0, 1.5]]), np.array([1.0, 0.5])
    rows = sp.csr_matrix(np.hstack([np.zeros((bodies, 1)), np.kron(np.eye(bodies), skew)]))
    load = np.concatenate([[1.0], np.tile(push * skew, bodies)])
    for soft in 2.0 ** np.arange(-60, -50, 3):
        K = sp.block_diag([sp.csr_array([[1.0]]), *[sp.csr_array(soft * body)] * bodies], format="csr")
        problem = cq.ContactProblem(K, load, rows, np.zeros(bodies))
        moved = np.concatenate([[1.0], 1e-2 * rng.normal(size=2 * bodies)])
        spoiled = push * rng.choice([0.9, 0.99, 1.01, 1.1], bodies)
        bound = energy_bounds(problem, Answer(moved, spoiled, None, np.zeros(0))).force_bound
        if bound is not None:
            bounded += 1
            assert np.all(bound >= abs(push - spoiled) * (1 - 1e-12))
    assert bounded >= 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7, 9])
def test_forces_of_many_rows_that_share_unknowns_are_bounded(seed: int) -> None:
    """A chain of more than five hundred closed rows on springs over many decades; the load is made from its answer."""
    rng = np.random.default_rng([17, seed])
    m = int(rng.integers(510, 700))
    n = m + int(rng.integers(1, 20))
    bands = [rng.integers(1, 3, m) * (-1.0) ** k for k in range(rng.integers(2, 4))]
    E = sp.diags_array(bands, offsets=range(len(bands)), shape=(m, n)).tocsr()
    decades = int(rng.integers(5, 45))
    springs = np.exp2(rng.integers(-decades, 1, n).astype(float))
    u, force = rng.integers(-4, 5, n).astype(float), np.ldexp(rng.integers(1, 9, m), rng.integers(-decades, 1, m))
    problem = cq.ContactProblem(sp.diags_array(springs).tocsr(), springs * u + E.T @ force, E, E @ u)
    compared = 0
    for moved, spoiled in ((0.0, 0.0), (1e-9, 1e-9), (1e-3, 1e-3), (0.0, 1e-3)):
        pushed = force * (1 + spoiled * rng.normal(size=m))
        found = energy_bounds(problem, Answer(u + moved * rng.normal(size=n), pushed, None, np.zeros(0)))
        if found.force_bound is not None:
            compared += 1
            assert np.all(found.force_bound >= abs(pushed - force) * (1 - 1e-12))
    assert compared == 4


def test_motions_of_many_rows_are_not_shorter_than_those_of_dense_systems() -> None:
    rng = np.random.default_rng(0)
    rows = sp.csr_array(rng.random((60, 70)) * (rng.random((60, 70)) < 0.05) + np.eye(60, 70))
    root = sp.csr_array(rng.random((70, 70)) * (rng.random((70, 70)) < 0.1))
    stiffness, residual = sp.csr_array(root @ root.T), 10.0 ** rng.uniform(-6, 0, 70)
    motions = np.linalg.pinv(rows.toarray())
    energy = np.sum(motions * (stiffness @ motions), axis=0)
    exact = np.column_stack([abs(motions).T @ residual, np.sqrt(energy)])
    told, moved = _taken_at_random(rows, residual, stiffness, missed := rng.random(60))
    np.testing.assert_allclose(moved, motions @ missed)
    assert np.all(CAUTION * told >= exact)
    assert np.all(told <= 30 * exact)


@pytest.mark.slow
def test_forces_that_no_factors_bound_have_a_reason_instead(monkeypatch: pytest.MonkeyPatch) -> None:
    m = 501
    E = sp.diags_array([np.ones(m), -0.5 * np.ones(m)], offsets=[0, 1], shape=(m, m + 1)).tocsr()
    problem = cq.ContactProblem(sp.eye_array(m + 1).tocsr(), E.T @ np.ones(m), E, np.zeros(m))
    answer = Answer(np.zeros(m + 1), np.ones(m), None, np.zeros(0))
    assert energy_bounds(problem, answer).force_bound is not None
    monkeypatch.setattr("contactqp.linalg.convexity.WELL_APART", 2.0)
    monkeypatch.setattr("contactqp.linalg.schur.OF_BAND", 0.0)
    found = energy_bounds(problem, answer)
    assert found.force_bound is None
    assert found.reasons == (f"force_bound: {NOT_APART}",)


@pytest.mark.slow
def test_forces_of_programs_are_bounded_contact_by_contact() -> None:
    """Stiffness over sixteen decades, rows that share unknowns, ties: each force against that in rational numbers."""
    compared = 0
    for seed in range(400):
        rng = np.random.default_rng([7, seed])
        n, m = int(rng.integers(3, 8)), int(rng.integers(1, 4))
        B = rng.integers(-2, 3, (n, n)) * (rng.random((n, n)) < 0.5)
        scale = 2.0 ** rng.integers(-28, 1, n)
        E = rng.integers(-2, 3, (m, n)) * (rng.random((m, n)) < 0.5)
        gap = np.where(rng.random(m) < 0.6, 0.0, rng.integers(0, 3, m))
        load = np.ldexp(rng.integers(-8, 9, n).astype(float), rng.integers(-30, 1, n)) * (rng.random(n) < 0.7)
        A = rng.integers(-1, 2, (int(rng.random() < 0.3), n))
        if not (E.any(axis=1).all() and A.any(axis=1).all()):
            continue
        K = scale[:, None] * (B.T @ B) * scale
        problem = cq.ContactProblem(K, load, E, gap, tie=A, tie_value=np.zeros(len(A)))
        truth, _ = exact_truth(problem, None)
        if truth is None or not truth.unique_forces:
            continue
        u, force = truth.rounded()
        for size in (1e-6, 1e-2):
            spoiled = force * (1 + size * rng.normal(size=m))
            answer = Answer(u + size * rng.normal(size=n), spoiled, None, np.asarray(truth.tie_force, dtype=float))
            bound = energy_bounds(problem, answer).force_bound
            if bound is None:
                continue
            exact = [Fraction(int(one.p), int(one.q)) for one in truth.force]
            error = [abs(Fraction(one) - true) for one, true in zip(spoiled.tolist(), exact, strict=True)]
            assert np.all(bound >= np.array(error, dtype=float) * (1 - 1e-12)), seed
            compared += 1
    assert compared > 300
