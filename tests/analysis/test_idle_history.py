"""Rows that constrain nothing, in paths, motions and comparisons: the answers are those without these rows."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import contactqp as cq

K = np.array([[200.0, -100.0], [-100.0, 200.0]])
LOAD = [3.0, 1.0]
ROW, ZERO = [1.0, 0.0], [0.0, 0.0]
PATH = [[3.0, 1.0], [-3.0, 2.0]]


def idle(kind: str) -> cq.ContactProblem:
    """One contact that acts, as the second, between rows that constrain nothing."""
    rows, gap, tie = {
        "gap": ([[0.0, 1.0], ROW, ROW], [np.inf, 1e-3, np.inf], None),
        "row": ([ZERO, ROW, ZERO], [0.5, 1e-3, 0.0], None),
        "tie": ([ROW, ROW], [np.inf, 1e-3], [ZERO]),
    }[kind]
    return cq.ContactProblem(K, LOAD, rows, gap, tie=tie, tie_value=None if tie is None else [0.0])


def alone() -> cq.ContactProblem:
    return cq.ContactProblem(K, LOAD, [ROW], [1e-3])


def rough(*, idle_row: bool) -> cq.ContactProblem:
    """A block on a rough floor; another contact of it never closes."""
    stiffness = np.kron(K, np.eye(2))
    normal, tangent = np.zeros((2, 4)), np.zeros((2, 4))
    normal[1, 1], normal[0, 3], tangent[1, 0], tangent[0, 2] = -1.0, -1.0, 1.0, 1.0
    gap, kept = np.array([np.inf, 0.0]), slice(None) if idle_row else slice(1, None)
    return cq.ContactProblem(
        stiffness, [1.0, -3.0, 0.0, -1.0], normal[kept], gap[kept], tangent=tangent[kept], friction=0.3
    )


@pytest.mark.sampled(6)
@pytest.mark.parametrize("kind", ["gap", "row", "tie"])
@pytest.mark.parametrize("events", [None, "exact"])
def test_a_path_is_that_without_them(kind, events):
    problem = idle(kind)
    path = cq.follow_path(problem, PATH, steps=4, events=events)
    plain = cq.follow_path(alone(), PATH, steps=4, events=events)
    assert np.array_equal(path.times, plain.times)
    assert np.array_equal(path.displacements, plain.displacements)
    assert np.array_equal(path.normal_forces[:, 1], plain.normal_forces[:, 0])
    assert np.all(np.delete(path.normal_forces, 1, axis=1) == 0)
    assert [(e.kind, e.contact, e.time, e.name) for e in path.events] == [
        (e.kind, 1, e.time, "contact 1") for e in plain.events
    ]
    assert len(plain.events) == 2
    assert path.energies == plain.energies
    last = path[-1]
    assert last.certificate.passed
    assert last.problem.contacts == problem.contacts
    assert np.array_equal(last.problem.load, PATH[-1])
    assert cq.certify(last.problem, last.displacement, last.normal_force, tie_force=last.tie_force).passed


@pytest.mark.slow
@pytest.mark.parametrize("events", [None, "exact"])
def test_a_path_with_friction_is_that_without_them(events):
    loads = [[1.0, -3.0, 0.0, -1.0], [3.0, -3.0, 0.0, -1.0]]
    path = cq.follow_path(rough(idle_row=True), loads, steps=4, events=events)
    plain = cq.follow_path(rough(idle_row=False), loads, steps=4, events=events)
    assert path.friction_forces is not None
    assert plain.friction_forces is not None
    assert np.array_equal(path.friction_forces[:, 1], plain.friction_forces[:, 0])
    assert np.all(path.friction_forces[:, 0] == 0)
    assert plain.events
    assert [(e.kind, e.contact, e.time) for e in path.events] == [(e.kind, 1, e.time) for e in plain.events]
    assert path.energies == plain.energies
    for here, there in zip(path, plain, strict=True):
        assert here.certificate.passed
        assert here.problem.slip_origin[1] == there.problem.slip_origin[0]
        assert cq.certify(here.problem, here.displacement, here.normal_force, here.friction_force).passed


@pytest.mark.sampled(10)
@pytest.mark.parametrize("kind", ["gap", "row", "tie"])
@pytest.mark.parametrize("scheme", ["moreau-jean", "newmark", "paoli-schatzman", "penalty"])
def test_a_motion_is_that_without_them(kind, scheme):
    start = ([1.0, 1.0], [0.0, 0.0], [1.0, 0.5], 0.1, 0.001)
    knobs = {"penalty": 1e4} if scheme == "penalty" else {}
    motion = cq.impact(idle(kind), *start, scheme=scheme, **knobs)
    plain = cq.impact(alone(), *start, scheme=scheme, **knobs)
    assert np.array_equal(motion.displacements, plain.displacements)
    assert np.array_equal(motion.velocities, plain.velocities)
    assert np.array_equal(motion.normal_forces[:, 1], plain.normal_forces[:, 0])
    assert np.any(motion.normal_forces)
    assert motion.tie_forces.shape == (len(plain), 1 if kind == "tie" else 0)
    assert motion.energies == plain.energies
    assert {event.contact for event in motion.events} == {1}
    assert np.array_equal(motion[50].normal_force, motion.normal_forces[50])
    assert motion[50].problem.contacts == idle(kind).contacts
    assert motion.resume(0.01).normal_forces.shape == (len(plain) + 10, motion.normal_forces.shape[1])


@pytest.mark.slow
def test_a_motion_with_friction_that_travels():
    start = ([1.0] * 4, [0.0] * 4, [0.1, 0.0, 0.0, 0.0], 0.02, 0.001)
    motion = cq.impact(rough(idle_row=True), *start)
    plain = cq.impact(rough(idle_row=False), *start)
    assert motion.friction_forces is not None
    assert np.array_equal(motion.friction_forces[:, 1], plain.friction_forces[:, 0])
    for other in (pickle.loads(pickle.dumps(motion)), copy.copy(motion), copy.deepcopy(motion)):
        assert np.array_equal(other.normal_forces, motion.normal_forces)
        assert other.events == motion.events
        assert other[-1].certificate.passed


@pytest.mark.slow
@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", ["gap", "row", "tie"])
def test_a_comparison_is_that_without_them(kind):
    problem, methods = idle(kind), ["active-set", "penalty", "clarabel"]
    table, plain = cq.compare(problem, methods), cq.compare(alone(), methods)
    assert [row.verdict for row in table] == [row.verdict for row in plain]
    assert [row.error_force for row in table] == [row.error_force for row in plain]
    solution = cq.solve(problem)
    wrong = (solution.displacement, 1.01 * solution.normal_force)
    against = [cq.compare(problem, ["active-set"], reference=known).rows[0] for known in (solution, wrong)]
    assert against[0].error_force == 0
    assert against[1].error_force == pytest.approx(0.01, rel=0.02)
    with pytest.raises(cq.InvalidProblem, match="reference"):
        cq.compare(problem, ["active-set"], reference=(solution.displacement, [1.0]))


@pytest.mark.parametrize(
    "ask",
    [
        lambda problem: cq.solve(problem),
        lambda problem: cq.follow_path(problem, PATH, steps=2),
        lambda problem: cq.impact(problem, [1.0, 1.0], [0.0, 0.0], [1.0, 0.5], 0.1, 0.001),
    ],
)
def test_a_row_of_zeros_that_is_not_met_is_refused_alike(ask):
    conflicting = cq.ContactProblem(K, LOAD, [ROW, ZERO], [1e-3, -0.5])
    with pytest.raises(cq.NoEquilibrium, match=r"contact 1 acts on nothing that moves.*overlap of 0\.5"):
        ask(conflicting)
    rows = cq.compare(conflicting, ["active-set"]).rows
    assert "acts on nothing that moves" in rows[0].message


def test_critical_coefficients_are_those_without_them():
    found = cq.critical_friction(rough(idle_row=True))
    plain = cq.critical_friction(rough(idle_row=False))
    assert found.single.tolist() == [np.inf, plain.single[0]]
    assert found.ratio.tolist() == [0.0, plain.ratio[0]]
    assert (found.contraction, found.kappa, found.unique) == (plain.contraction, plain.kappa, plain.unique)
