"""Certificates of right and wrong answers, dealt out to the ranks: figure for figure those of one process."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import contactqp as cq
from contactqp.certificate.figures import contact_status as status_of_one
from contactqp.distributed.certificate import certify_distributed, contact_status
from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks
from contactqp.model.solution import FIGURES, Answer
from contactqp.scene.building import build

CASES = Path(__file__).parents[3] / "cases"
# Residuals in double precision differ from those in extended precision by a few dozen roundings.
ROUNDING, RELATIVE = 1e-13, 1e-6


def right(problem: cq.ContactProblem) -> Answer:
    found = cq.solve(problem)
    return Answer(found.displacement, found.normal_force, found.friction_force, found.tie_force)


def wrong(problem: cq.ContactProblem, answer: Answer) -> Iterator[tuple[str, Answer]]:
    """Each kind of wrong answer that the problem can have."""
    rng = np.random.default_rng(1)
    u, push, rub, tie = answer.displacement, answer.normal_force, answer.friction_force, answer.tie_force
    largest, at = np.max(abs(u)), int(np.argmax(push)) if len(push) else 0
    moved = u.copy()
    moved[int(np.argmax(abs(u)))] *= 1 + 1e-4
    yield "one unknown moved", replace(answer, displacement=moved)
    yield "half-converged", replace(answer, displacement=u + 1e-5 * largest * rng.standard_normal(len(u)))
    if np.any(push):
        yield "flipped sign", replace(answer, normal_force=-push)
        pulled = push.copy()
        pulled[at] *= -0.5
        yield "tension", replace(answer, normal_force=pulled)
        deep = problem.normal[[at]]
        yield "penetration", replace(answer, displacement=u + np.asarray(deep.sum(axis=0)).ravel() * 0.01 * largest)
    for name, values in (("displacement", u), ("normal_force", push), ("friction_force", rub), ("tie_force", tie)):
        if values is not None and values.size:
            nothing = values.copy()
            nothing.flat[values.size // 2] = np.nan
            yield f"{name} is NaN", replace(answer, **{name: nothing})
    if rub is not None and rub.size and np.any(rub):
        yield "friction along the slip", replace(answer, friction_force=-rub)
        yield "friction beyond its bound", replace(answer, friction_force=3.0 * rub)
    if len(tie):
        yield "tie force", replace(answer, tie_force=tie + 0.1 * max(np.max(abs(tie)), 1.0))
        along = np.asarray(problem.tie[[0]].sum(axis=0)).ravel()
        yield "tie", replace(answer, displacement=u + along * 1e-3 * largest)


def same(one: cq.Certificate, many: cq.Certificate, what: str) -> None:
    for name in (*FIGURES, "natural_map"):
        a, b = getattr(one, name), getattr(many, name)
        assert (a is None) == (b is None), (what, name, a, b)
        if a is not None:
            assert a == b or abs(a - b) <= ROUNDING + RELATIVE * abs(a), (what, name, a, b)
    by_comparison = ("energy_error", "force_", "unproven", "state")  # ranks judge by the figures alone
    of_figures = [text for text in one.failures if not text.startswith(by_comparison)]
    assert of_figures == list(many.failures), (what, of_figures, many.failures)


def of_one_process(problem: cq.ContactProblem, answer: Answer) -> cq.JudgedAnswer:
    return cq.certify(problem, answer.displacement, answer.normal_force, answer.friction_force, answer.tie_force)


def judge(problem: cq.ContactProblem, ranks: Ranks, what: str) -> None:
    part = distribute(problem, ranks)
    answer = ranks.comm.bcast(right(problem) if ranks.rank == 0 else None)
    for kind, candidate in [("right", answer), *wrong(problem, answer)]:
        called = f"{what}, {kind}"
        one = ranks.comm.bcast(of_one_process(problem, candidate) if ranks.rank == 0 else None)
        here = Answer(
            candidate.displacement[part.dof_number],
            candidate.normal_force[part.contact_number],
            None if candidate.friction_force is None else candidate.friction_force[part.contact_number],
            candidate.tie_force[part.tie_number],
        )
        many = certify_distributed(part, here)
        same(one, many, called)
        assert kind != "right" or many.passed, called
        assert many.passed == (not many.failures), called
        status = part.gathered(contact_status(part, many), part.contact_number)
        assert list(status) == list(status_of_one(problem, one)), called
        assert one.grazing == many.grazing, (called, one.grazing, many.grazing)
        if ranks.rank == 0:
            print(
                f"{called}: {max(getattr(many, name) for name in FIGURES):.2g}, balance {many.balance:.2g}", flush=True
            )


def lever() -> cq.ContactProblem:
    """Return a stiff bar against two equal stops, tied to an unknown without stiffness that takes up its length."""
    stops, tie = [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], {"tie": [[0.5, 0.0, 1.0]], "tie_value": [0.25]}
    stiffness = np.array([[3.2e7, -1.6e7, 0.0], [-1.6e7, 1.6e7, 0.0], [0.0, 0.0, 0.0]])
    return cq.ContactProblem(stiffness, [1.0, 0.0, 0.0], stops, [0.0, 0.0], **tie)


def judge_alike(ranks: Ranks, problem: cq.ContactProblem, candidate: Answer, right: bool, what: str) -> None:
    part = distribute(problem, ranks)
    here = Answer(
        candidate.displacement[part.dof_number],
        candidate.normal_force[part.contact_number],
        None,
        candidate.tie_force[part.tie_number],
    )
    many, one = certify_distributed(part, here), of_one_process(problem, candidate)
    assert many.passed == one.passed == right, (what, many.failures, one.failures)
    if ranks.rank == 0:
        print(f"{what}: judged", flush=True)


def pulling(ranks: Ranks) -> None:
    """One of the two equal stops pulls with a part of the load."""
    for tension in (0.0, 1e-6, 1e-3):
        candidate = Answer(np.array([0.0, 0.0, 0.25]), np.array([1.0 + tension, -tension]), None, np.zeros(1))
        judge_alike(ranks, lever(), candidate, tension == 0.0, f"lever, tension {tension:g}")


def fallen(ranks: Ranks) -> None:
    """A bar falls by 1 m onto supports, two of them at one node; without load rounding is left of their forces."""
    bar, rows = 1e9 * np.array([[1.0, -1.0], [-1.0, 1.0]]), [[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]]
    problem = cq.ContactProblem(bar, [1.0, 1.0], rows, np.ones(3), near_null_space=np.ones((2, 1)))
    for tension in (0.0, 2.5e-6, 9e-4):
        candidate = Answer(np.ones(2), np.array([1.0, 1.0 + tension, -tension]), None, np.zeros(0))
        judge_alike(ranks, problem, candidate, tension == 0.0, f"fallen, tension {tension:g}")
    pushed = problem.replace(load=np.zeros(2), gap=np.array([-1e-3, 1.0, 1.0]))
    for force, right in ((0.0, True), (1e-11, True), (1e-5, False)):
        candidate = Answer(np.full(2, -1e-3), np.array([force, 0.0, 0.0]), None, np.zeros(0))
        judge_alike(ranks, pushed, candidate, right, f"pushed out, force {force:g}")


def across(ranks: Ranks) -> None:
    """A bar on a stop: across it, where nothing holds, F sin(pi) is rounding, and 3e-10 is a load."""
    for load, right in ((300 * np.sin(np.pi), True), (3e-10, False)):
        problem = cq.ContactProblem(np.diag([157500.0, 0.0]), [-300.0, load], [[-1.0, 0.0]], [1e-3])
        candidate = Answer(np.array([-1e-3, 0.0]), np.array([142.5]), None, np.zeros(0))
        judge_alike(ranks, problem, candidate, right, f"across the bar, load {load:g}")


if __name__ == "__main__":
    made_here = {"lever": pulling, "fallen": fallen, "across": across}
    for name in sys.argv[1:]:
        if name in made_here:
            made_here[name](Ranks())
        else:
            judge(build(cq.load_scene(CASES / f"{name}.toml")).problem, Ranks(), name)
