"""Contacts that stay open, have no friction, or touch nothing but rigid motions: no reason to refuse or to go wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.coulomb_law import natural_map

FACTS = dict(load=[-1.0, 0.2, 0.0, 0.0], normal=[[-1.0, 0, 0, 0], [0, 0, -1.0, 0]], gap=[0.0, 1.0])


@pytest.mark.parametrize(
    ("tangent", "friction"), [([0, 0, 0, 1.0], 0.0), ([0, 0, 0, 0.0], 0.3)], ids=["smooth", "held"]
)
def test_an_open_contact_that_cannot_rub_does_not_refuse_the_answer(tangent: list[float], friction: float) -> None:
    # The cone of mu = 0 is a ray: zero times a negative normal component is not inside it.
    problem = cq.ContactProblem(
        stiffness=np.eye(4), tangent=[[0, 1.0, 0, 0], tangent], friction=[0.3, friction], **FACTS
    )
    solution = cq.solve(problem)
    np.testing.assert_allclose(solution.normal_force, [1.0, 0.0], atol=1e-15)
    assert solution.contact_status.tolist() == ["stick", "open"]
    wrong = cq.certify(problem, np.array([0, 0, -2.0, 0]), [1.0, 0.0], [0.2, 0.0])
    assert not wrong.passed
    assert wrong.natural_map > 0.1


@pytest.mark.parametrize("algorithm", [None, "newton", "nsgs", "admm", "aclm", "tresca"])
def test_an_open_contact_without_friction_in_local_form(algorithm: str | None) -> None:
    problem = cq.LocalProblem(delassus=np.eye(4), offset=[-1.0, 0.2, 1.0, 0.0], friction=[0.3, 0.0], dimension=2)
    solution = cq.solve(problem, algorithm=algorithm)
    np.testing.assert_allclose(solution.force, [[1.0, -0.2], [0.0, 0.0]], atol=1e-12)


def test_the_natural_map_of_a_contact_without_friction() -> None:
    force, gap = np.zeros((1, 2)), np.array([[1.0, 0.0]])
    assert np.array_equal(natural_map(force, gap, np.zeros(1)), force)
    assert np.array_equal(natural_map(force, -gap, np.zeros(1)), -gap)  # penetration is still one


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5, 8])
def test_what_only_rigid_motions_move_has_no_compliance(seed: int) -> None:
    # The stiffness has rank two and the contacts touch two unknowns that its null space moves freely: their Delassus
    # operator is rounding, which scaled to a diagonal of one looks indefinite.
    root = np.random.default_rng(seed).normal(size=(4, 2))
    load = root @ [1.0, 2.0] - [1.0, 0, 0, 0]
    rows = dict(normal=[[-1.0, 0, 0, 0]] * 2, gap=[0.0, 0.0], tangent=[[0, 1.0, 0, 0]] * 2, friction=[2.0, 0.3])
    problem = cq.ContactProblem(stiffness=root @ root.T, load=load, **rows)
    for algorithm in ("nsgs", "admm", "aclm"):
        solution = cq.solve(problem, algorithm=algorithm)
        assert abs(sum(solution.normal_force) - 1.0) < 1e-12
        assert abs(solution.friction_force.sum()) < 1e-12


def test_a_step_of_a_path_whose_free_motion_drowns_its_answer_is_solved_another_way() -> None:
    # One motion is held by rounding alone: without contact forces the bodies would go 1e15 of their own lengths.
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6))
    motion = rng.normal(size=6)
    held = np.eye(6) - np.outer(motion, motion) / (motion @ motion)
    values, vectors = np.linalg.eigh(held @ (root @ root.T + np.eye(6)) @ held)
    K = (vectors * np.maximum(values, 0)) @ vectors.T
    unit = np.eye(6)
    problem = cq.ContactProblem(
        stiffness=(K + K.T) / 2,
        load=np.zeros(6),
        normal=-unit[[0, 2]],
        gap=[0.05, 0.02],
        tangent=unit[[1, 3]],
        friction=1.0,
    )
    history = cq.follow_path(problem, loads=[rng.normal(size=6) - [1.0, 0, 1.0, 0, 0, 0]], steps=1)
    assert all(solution.certificate.passed for solution in history)


def test_a_load_that_condensation_cancels_drives_no_motion() -> None:
    # One spring between three unknowns, in units far from one: what is left of the load on the contacts' unknowns is
    # the rounding of the condensation, and drives none of the two motions that the spring leaves free.
    way = np.array([96.0, 1.0, -8.0])
    stiffness, load = 2.0**-52 * np.outer(way, way), way * 2.32830644e-09
    rows = dict(normal=[[-256.0, 0, 0]], gap=[2.0**23], tangent=[[0, 8.0, 0]], friction=0.125, slip_origin=[2.0**27])
    problem = cq.ContactProblem(stiffness=stiffness, load=load, **rows)
    assert cq.solve(problem, algorithm="tresca").contact_status.tolist() == ["open"]
    driven = problem.replace(load=[load[0] * (1 + 1e-9), *load[1:]])
    with pytest.raises(cq.NoEquilibrium, match="drives a rigid motion"):
        cq.solve(driven, algorithm="tresca")


@pytest.mark.parametrize("idle", [{"gap": [np.inf], "friction": 0.3}, {"gap": [0.1], "friction": 0.0}])
@pytest.mark.parametrize("algorithm", ["newton", "tresca", "enumeration"])
def test_an_algorithm_is_no_mistake_without_friction(idle: dict[str, Any], algorithm: str) -> None:
    # A sweep over the coefficient begins at zero, and one over the gap ends where nothing touches.
    facts = dict(stiffness=[[2.0, -1.0], [-1.0, 2.0]], load=[1.0, -3.0], normal=[[0, -1.0]], **idle)
    problem = cq.ContactProblem(tangent=[[1.0, 0]], **facts)
    found, smooth = cq.solve(problem, algorithm=algorithm), cq.solve(problem)
    assert np.array_equal(found.displacement, smooth.displacement)
    assert found.certificate.passed
    with pytest.raises(cq.InvalidProblem, match="algorithm: expected one of newton"):
        cq.solve(problem, algorithm="nonsense")
    with pytest.raises(cq.Unsupported, match="leave it out, or give the problem its tangent and friction=0"):
        cq.solve(cq.ContactProblem(**{name: facts[name] for name in facts if name != "friction"}), algorithm=algorithm)


@pytest.mark.parametrize("idle", [{"gap": [np.inf], "friction": 0.3}, {"gap": [0.1], "friction": 0.0}])
def test_polygons_are_no_mistake_without_friction(idle: dict[str, Any]) -> None:
    problem = cq.ContactProblem(np.eye(3), load=[1.0, 0.1, -3.0], normal=[[0, 0, -1.0]], tangent=np.eye(3)[:2], **idle)
    found = cq.solve(problem, "clarabel", algorithm="tresca", facets=16, polygon="inscribed")
    np.testing.assert_allclose(found.displacement, cq.solve(problem).displacement, rtol=1e-12)


@pytest.mark.parametrize("friction", [[0.1], [0.0], [0.7]])
def test_friction_that_supports_take_is_said_to_be_undetermined(friction: list[float]) -> None:
    facts = dict(stiffness=[[2.0, -1.0], [-1.0, 2.0]], load=[1.0, -3.0], normal=[[0, -1.0]], gap=[0.1], friction=0.3)
    problem = cq.ContactProblem(tangent=[[0.0, 0.0]], contact_names=["foot"], **facts)
    found = cq.certify(problem, [0.45, -0.1], [2.35], friction)
    assert found.passed
    assert any("friction on supports" in note and "(foot)" in note for note in found.notes)
    assert not cq.certify(problem, [0.45, -0.1], [2.35], [0.71]).passed  # the cone is 0.705 wide
    felt = cq.ContactProblem(tangent=[[1.0, 0.0]], contact_names=["foot"], **facts)
    assert not any("friction on supports" in note for note in cq.solve(felt).certificate.notes)


def test_friction_on_a_symmetry_plane_is_undetermined_where_it_sticks_alone() -> None:
    # The second tangent is held; along the first one the contact sticks or slips.
    for load, notes in ((0.2, 1), (5.0, 0)):
        problem = cq.ContactProblem(
            np.eye(3), [load, 0.0, -3.0], -np.eye(3)[2:], [0.0], tangent=[[1.0, 0, 0], [0, 0, 0]], friction=0.3
        )
        found = cq.solve(problem).certificate
        assert sum("friction on supports" in note for note in found.notes) == notes
