"""A penalty by the area on a regular mesh has few different springs: the diagnosis says penalty, and not how near."""

from __future__ import annotations

import numpy as np

import contactqp as cq
from contactqp.oracle.judged_answer import JudgedAnswer


def chain() -> tuple[cq.ContactProblem, np.ndarray]:
    """Nine unknowns that stop at one wall each, and the areas of these: whole ones, and halves at both ends."""
    K = np.diag(np.full(9, 2.0)) - np.diag(np.ones(8), 1) - np.diag(np.ones(8), -1)
    area = np.array([0.5, *np.ones(7), 0.5])
    return cq.ContactProblem(stiffness=K, load=np.arange(3.0, 12.0), normal=np.eye(9), gap=np.full(9, 0.5)), area


def penalised(stiffness: np.ndarray) -> JudgedAnswer:
    problem, _ = chain()
    u = np.linalg.solve(np.asarray(problem.stiffness) + np.diag(stiffness), problem.load + stiffness * problem.gap)
    assert np.all(u > problem.gap)
    return cq.certify(problem, displacement=u, normal_force=stiffness * (u - problem.gap))


def test_few_springs_are_a_penalty() -> None:
    judged = penalised(1e4 * chain()[1])
    assert judged.findings[0].kind == "penalty"
    assert "penalty of 5e+03 to 1e+04, few different ones" in judged.diagnosis


def test_printed_springs_are_few_too() -> None:
    noise = 1 + 1e-3 * np.random.default_rng(3).uniform(-1, 1, 9)
    assert penalised(1e4 * chain()[1] * noise).findings[0].kind == "penalty"


def test_springs_of_any_stiffness_are_not_few() -> None:
    judged = penalised(1e4 * np.geomspace(1, 20, 9))
    assert "few different ones" not in judged.diagnosis


def test_inexact_forces_are_no_pressures() -> None:
    problem, _ = chain()
    right = cq.solve(problem)
    force = right.normal_force * np.where(np.arange(9) < 5, 1.0, 1.0001)
    judged = cq.certify(problem, displacement=right.displacement, normal_force=force)
    assert not judged.passed
    assert "pressure" not in [finding.kind for finding in judged.findings]
