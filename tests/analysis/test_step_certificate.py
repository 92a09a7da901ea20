"""Steps judged in blocks: the figures are those of the certificate, and wrong answers are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import contactqp as cq
from contactqp.analysis.motion.step_certificate import FIGURES, StepJudge
from contactqp.analysis.motion.step_contact import StepProblem, StepResult

rng = np.random.default_rng(7)
ROOT = rng.normal(size=(6, 6))
PROBLEM = cq.ContactProblem(
    stiffness=ROOT @ ROOT.T + np.eye(6),
    load=np.zeros(6),
    normal=rng.normal(size=(2, 6)),
    gap=np.zeros(2),
    tangent=rng.normal(size=(4, 6)),
    friction=[0.3, 0.5],
    tie=rng.normal(size=(1, 6)),
)


def step(seed: int) -> tuple[StepProblem, StepResult]:
    rng = np.random.default_rng(seed)
    posed = StepProblem(rng.normal(size=6), rng.normal(size=2), None, rng.normal(size=4), rng.normal(size=1))
    x = rng.normal(size=6)
    return posed, StepResult(x, rng.normal(size=2), rng.normal(size=4), rng.normal(size=1), x)


def test_the_figures_are_those_of_the_certificate() -> None:
    """Of answers that are wrong in every way: cone and slip are bounded from above, the others alike."""
    steps = [step(seed) for seed in range(20)]
    found = StepJudge(PROBLEM).figures([p for p, _ in steps], [a for _, a in steps])
    for k, (posed, answer) in enumerate(steps):
        problem = PROBLEM.replace(
            load=posed.load, gap=posed.gap, slip_origin=posed.slip_origin, tie_value=posed.tie_value
        )
        known = cq.certify(problem, answer.unknown, answer.normal, answer.friction, answer.tie)
        for name in FIGURES:
            mine, theirs = getattr(found, name)[k], getattr(known, name)
            if name in ("cone", "slip_direction"):
                assert theirs * (1 - 1e-9) <= mine <= 5 * theirs + 1e-12, name
            else:
                assert mine == pytest.approx(theirs, rel=1e-9), name


def test_each_figure_names_its_step() -> None:
    problem = PROBLEM.replace(load=rng.normal(size=6), gap=[0.1, 0.2], tie_value=[0.3])
    right = cq.solve(problem)
    assert right.friction_force is not None
    posed = StepProblem(problem.load, problem.gap, None, None, problem.tie_value)
    x = right.displacement
    answer = StepResult(x, right.normal_force, right.friction_force.ravel(), right.tie_force, x)
    judge = StepJudge(PROBLEM)
    assert judge.figures([posed] * 3, [answer] * 3).first_above(1e-12) is None
    spoiled = {
        "equilibrium": (posed, replace(answer, unknown=x * (1 + 1e-6))),
        "tie": (replace(posed, tie_value=np.array([0.4])), answer),
        "penetration": (replace(posed, gap=posed.gap - 1.0), answer),
        "tension": (posed, replace(answer, normal=answer.normal - 1.0)),
        "complementarity": (replace(posed, gap=posed.gap + 1.0), replace(answer, normal=answer.normal + 1.0)),
        "cone": (posed, replace(answer, friction=answer.friction + 5.0)),
    }
    for name, (asked, wrong) in spoiled.items():
        found = judge.figures([posed, asked, posed], [answer, wrong, answer])
        assert getattr(found, name)[1] > 1e-8, name
        refused = found.first_above(1e-9)
        assert refused is not None
        assert refused[0] == 1


def test_what_is_no_number_fails_and_a_contact_that_was_not_looked_at_has_no_force() -> None:
    judge, (posed, answer) = StepJudge(PROBLEM), step(3)
    nan = replace(answer, unknown=np.full(6, np.nan))
    refused = judge.figures([posed], [nan]).first_above(1e-9)
    assert refused is not None
    assert refused[2] == np.inf
    unseen = replace(posed, closable=np.array([False, False]), gap=np.array([-9.0, -9.0]))
    quiet = replace(answer, normal=np.zeros(2), friction=np.zeros(4))
    assert judge.figures([unseen], [quiet]).penetration[0] == 0.0
    assert judge.figures([unseen], [replace(quiet, normal=np.array([1.0, 0.0]))]).tension[0] > 0.0
