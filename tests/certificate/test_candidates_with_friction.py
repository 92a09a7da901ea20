"""With friction in space only contacts that close, and those near, are condensed onto; the answer is that of all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate import subset_bounds
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg import iteration
from contactqp.linalg.condensation import condense, eliminate
from contactqp.linalg.schur import NestedBlock
from contactqp.scene import explaining

CELLS, CONTACTS = 8, 81
HELD = {
    "supported": ("top",),
    "quarter": ("left", "front"),
}


@pytest.fixture(autouse=True)
def few_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty contacts are many."""
    monkeypatch.setattr(iteration, "MANY_WITH_FRICTION", 20)


def pressed(held: str, friction: float = 0.3, weight: float = 1.0) -> cq.ContactProblem:
    """A block of hexahedra on a paraboloid, its top moved down and sideways, or pressed by forces in two symmetries."""
    body = Body(box((1.0, 1.0, 0.5), (CELLS, CELLS, 3)), Material(1.0, 0.3), "3d", name="block")
    structure = Structure([body])
    if held == "supported":
        supports = [Support("block", "top", axis, value * weight) for axis, value in enumerate((0.004, 0.002, -0.01))]
        centre = 0.45
    else:
        supports = [Support("block", side, axis) for axis, side in enumerate(HELD[held])]
        centre = 0.0
    assembled = structure.assemble(supports)
    paraboloid = cq.Paraboloid([centre, centre, 0.0], [0.0, 0.0, 1.0], 5.0)
    problem = assembled.problem([cq.pair(structure.surface("block", "bottom"), paraboloid)], friction=friction)
    if held == "supported":
        return problem
    force, points = np.zeros(body.size), body.mesh.points
    top = np.flatnonzero(points[:, 2] == 0.5)
    force[3 * top + 2] = -0.01 * weight / len(top)
    return problem.replace(load=force[assembled.free])


def all_at_once(problem: cq.ContactProblem) -> cq.Solution:
    twin = problem._without_results()
    subset_bounds.take_all(twin)
    return cq.solve(twin)


def same(one: cq.Solution, other: cq.Solution) -> None:
    size = np.max(other.normal_force)
    np.testing.assert_allclose(one.normal_force, other.normal_force, rtol=0, atol=1e-11 * size)
    np.testing.assert_allclose(one.friction_force, other.friction_force, rtol=0, atol=1e-11 * size)
    np.testing.assert_allclose(
        one.displacement, other.displacement, rtol=0, atol=1e-11 * np.max(abs(other.displacement))
    )


@pytest.mark.slow
@pytest.mark.parametrize("held", HELD)
def test_the_answer_is_that_of_all_contacts(held: str) -> None:
    problem = pressed(held)
    some, reference = cq.solve(problem), all_at_once(problem)
    same(some, reference)
    assert list(some.contact_status) == list(reference.contact_status)
    assert some.certificate.passed
    assert some.certificate.basis == reference.certificate.basis == "state"
    assert some.work.retained < reference.work.retained
    assert some.work.factorisations == 2  # without friction, onto normals alone, and with the candidates' tangents


@pytest.mark.slow
def test_contacts_that_close_beyond_the_candidates_join_them() -> None:
    small, large = pressed("quarter", weight=0.02), pressed("quarter", weight=3.0)
    first = cq.solve(small)
    second = cq.solve(small.replace(load=large.load), warm_start=first)
    assert np.sum(second.normal_force > 0) > 2 * np.sum(first.normal_force > 0)
    same(second, all_at_once(large))


@pytest.mark.slow
def test_what_closes_nothing_and_what_starts_from_there() -> None:
    problem = pressed("supported")
    apart = cq.solve(problem.replace(gap=problem.gap + 1.0))
    assert apart.certificate.passed
    assert set(apart.contact_status) == {"open"}
    assert np.all(apart.friction_force == 0)
    same(cq.solve(problem._without_results(), warm_start=replace(apart, problem=problem)), all_at_once(problem))


@pytest.mark.slow
def test_the_next_load_needs_no_factorisation() -> None:
    problem = pressed("quarter")
    first = cq.solve(problem)
    second = cq.solve(problem.replace(load=0.98 * problem.load), warm_start=first)
    assert second.work.factorisations == 0
    same(second, all_at_once(problem.replace(load=0.98 * problem.load)))


@pytest.mark.slow
def test_a_body_that_friction_alone_holds_is_condensed_onto_all_contacts() -> None:
    """Pushed sideways on a flat floor it would slide away without friction, so that no first candidates are known."""
    body = Body(box((1.0, 1.0, 0.5), (CELLS, CELLS, 2)), Material(1.0, 0.3), "3d", name="block")
    structure = Structure([body])
    assembled = structure.assemble([])
    floor = cq.Plane([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    problem = assembled.problem([cq.pair(structure.surface("block", "bottom"), floor)], friction=0.5)
    force = np.zeros((body.size // 3, 3))
    force[:] = np.array([0.002, 0.001, -0.01]) / len(force)
    solution = cq.solve(problem.replace(load=force.ravel()[assembled.free]))
    assert solution.certificate.passed
    assert solution.normal_force.sum() == pytest.approx(0.01, rel=1e-9)


def test_explain_says_what_is_condensed_onto(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = pressed("supported")
    said = explaining._systems(problem)
    assert said.reason == (
        f"onto contacts that may close, of {CONTACTS} that touch {3 * CONTACTS} unknowns with the ties: friction "
        "retains three rows of each"
    )
    monkeypatch.setattr(iteration, "MANY_WITH_FRICTION", 300)
    assert (
        explaining._systems(problem._without_results()).reason
        == f"onto {3 * CONTACTS} unknowns that contacts and ties touch"
    )


@pytest.mark.slow
@pytest.mark.parametrize("wrong", ["none", "friction", "normal", "missing", "reversed"])
def test_answers_of_others_are_judged_with_all_contacts(wrong: str) -> None:
    problem = pressed("supported")
    truth = all_at_once(problem)
    u, normal, friction = truth.displacement, truth.normal_force.copy(), truth.friction_force.copy()
    pushed = int(np.argmax(normal))
    if wrong == "friction":
        friction[pushed] *= 1 - 1e-4
    elif wrong == "normal":
        normal[pushed] *= 1 + 1e-4
    elif wrong == "reversed":
        friction = -friction
    elif wrong == "missing":  # an equilibrium of the other contacts, which penetrates where nobody looked
        kept = np.flatnonzero(np.arange(CONTACTS) != pushed)
        without = all_at_once(problem.with_contacts(kept))
        u = without.displacement
        normal[kept], friction[kept] = without.normal_force, without.friction_force
        normal[pushed], friction[pushed] = 0.0, 0.0
    certificate = cq.certify(problem._without_results(), u, normal, friction)
    assert certificate.passed == (wrong == "none"), str(certificate)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("held", HELD)
def test_a_block_that_is_condensed_further_is_that_of_the_stiffness(held: str) -> None:
    problem = pressed(held)
    wide = condense(problem)
    retained = np.union1d(wide.retained[::3], wide.retained[:12])
    nested = NestedBlock(wide._elimination, wide.retained, retained)
    direct = eliminate(problem.stiffness_rows, retained)
    size = np.max(abs(direct.schur))
    np.testing.assert_allclose(nested.schur, direct.schur, rtol=0, atol=1e-11 * size)
    load = np.random.default_rng(0).standard_normal(problem.dimension)
    (mine, inner), (theirs, other) = nested.reduce(load), direct.reduce(load)
    np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-10 * np.max(abs(theirs)))
    at = np.random.default_rng(1).standard_normal(len(retained))
    found, expected = nested.expand(at, inner), direct.expand(at, other)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.max(abs(expected)))
    motions, wanted = (
        nested.expand_motions(np.eye(len(retained))[:, :2]),
        direct.expand_motions(np.eye(len(retained))[:, :2]),
    )
    np.testing.assert_allclose(motions, wanted, rtol=0, atol=1e-10 * np.max(abs(wanted)))
