"""A local problem's certificate says where other forces or velocities satisfy the law too."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate import local_certificate
from contactqp.certificate.uniqueness import FORCES, POSSIBLE

KLARBRING = np.array([[1.0, 2.0], [2.0, 5.0]])  # critical coefficient W_NN / |W_NT| = 1/2


@pytest.mark.parametrize(("friction", "findings"), [(0.4, ()), (0.8, (POSSIBLE,))])
def test_one_contact_below_and_above_its_critical_coefficient(friction: float, findings: tuple[str, ...]) -> None:
    # At q = (0.3, 1.25) and mu = 0.8 the contact may be open, stick and slip.
    problem = cq.LocalProblem(delassus=KLARBRING, offset=[0.3, 1.25], friction=friction, dimension=2)
    certificate = cq.solve(problem).certificate
    assert certificate.passed
    assert certificate.uniqueness == findings
    if findings:
        assert "mu = 0.8 of contact 0 is not below the critical 0.5" in " ".join(str(certificate).split())
        for force in ([0.0, 0.0], [1.0, -0.65], [0.5, -0.4]):
            assert cq.certify_local(problem, force).passed


def test_a_block_between_two_walls() -> None:
    # q_T = -1: it hangs by any pressure of the walls, or slides past them.
    W = np.zeros((4, 4))
    W[::2, ::2], W[1::2, 1::2] = [[1.0, -1.0], [-1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]
    problem = cq.LocalProblem(delassus=W, offset=[0.0, -1.0, 0.0, -1.0], friction=0.5, dimension=2)
    hangs = cq.certify_local(problem, [2.0, 0.5, 2.0, 0.5])
    slides = cq.certify_local(problem, np.zeros(4))
    assert hangs.passed
    assert slides.passed
    assert hangs.uniqueness == (FORCES, POSSIBLE)
    assert POSSIBLE in slides.uniqueness


def test_contacts_that_share_their_rows() -> None:
    W = np.kron(np.ones((2, 2)), np.eye(3))
    problem = cq.LocalProblem(delassus=W, offset=np.tile([-1.0, 0.1, 0.0], 2), friction=0.5, dimension=3)
    assert FORCES in cq.solve(problem).certificate.uniqueness
    alone = cq.LocalProblem(delassus=np.eye(3), offset=[-1.0, 0.1, 0.0], friction=0.5, dimension=3)
    assert cq.solve(alone).certificate.uniqueness == ()


@pytest.mark.parametrize("apart", [1e-12, 1e-7])
def test_contacts_that_nearly_share_their_rows_need_singular_values_only_near_the_border(
    apart: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows that differ by 1e-12 depend on each other by the condition of their block, those of 1e-7 do not."""
    found, svd = [], np.linalg.svd
    monkeypatch.setattr(np.linalg, "svd", lambda *given, **how: found.append(given) or svd(*given, **how))
    W = np.kron([[1.0, 1.0], [1.0, 1.0 + apart]], np.eye(3))
    problem = cq.LocalProblem(delassus=W, offset=np.tile([-1.0, 0.1, 0.0], 2), friction=0.5, dimension=3)
    certificate = cq.certify_local(problem, np.tile([0.5, -0.05, 0.0], 2))
    assert (FORCES in certificate.uniqueness) == (apart < 1e-10)
    assert bool(found) == (apart > 1e-10)


def test_the_compliance_along_pushes_is_the_same_by_dense_and_by_sparse_products(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(4)
    rows, m = rng.normal(size=(15, 15)), 5
    problem = cq.LocalProblem(delassus=rows @ rows.T, offset=rng.normal(size=15), friction=0.5, dimension=3)
    pushes, kept = rng.normal(size=(m, 3, 3)), rng.random(15) < 0.5
    B = np.zeros((15, 15))
    for i in range(m):
        B[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = pushes[i]
    expected = (B @ problem.scaled_delassus.toarray() @ B.T)[np.ix_(kept, kept)]
    for size in (200, 0):
        monkeypatch.setattr(local_certificate, "WORTH_SPARSE_PRODUCTS", size)
        found = local_certificate._compliance_along(problem, pushes, kept)
        np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(("joint", "findings"), [(1.01, (FORCES,)), (2.0, ())])
def test_a_joint_is_among_what_a_contact_may_depend_on(joint: float, findings: tuple[str, ...]) -> None:
    """A contact and a joint that move alike share their force, unless the joint has a compliance of its own."""
    problem = cq.LocalProblem(
        delassus=np.eye(2),
        offset=[-1.0, 0.5],
        friction=0.1,
        dimension=2,
        bilateral=[[1.0], [-0.1]],
        bilateral_delassus=[[joint]],
        bilateral_offset=[-1.0],
    )
    slides = np.array([[1.0, -0.1]])
    depends = local_certificate._dependent(problem, np.array([True]), np.array([False]), slides)
    assert depends == (FORCES in findings)


def test_an_unsymmetric_operator_is_said_to_be_so() -> None:
    W = np.array([[1.0, 2.001], [2.0, 5.0]])
    problem = cq.LocalProblem(delassus=W, offset=[-7.0, -17.0], friction=0.3, dimension=2)
    certificate = cq.solve(problem).certificate
    assert certificate.passed
    assert certificate.uniqueness == ()  # by the determinants, which need no symmetry
    assert any("not symmetric by 0.0002" in note for note in certificate.notes)


def test_complex_forces_are_refused() -> None:
    problem = cq.LocalProblem(delassus=KLARBRING, offset=[0.3, 1.25], friction=0.4, dimension=2)
    with pytest.raises(cq.InvalidProblem, match="force: expected real numbers"):
        cq.certify_local(problem, np.array([0.0, 1j]))
    bodies = cq.ContactProblem(
        stiffness=np.eye(2), load=[-1.0, 0.0], normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]], friction=0.3
    )
    with pytest.raises(cq.InvalidProblem, match="friction_force: expected real numbers"):
        cq.certify(bodies, np.zeros(2), [1.0], np.array([1j]))
    with pytest.raises(cq.InvalidProblem, match="friction: expected a coefficient, got True"):
        bodies.replace(friction=True)


def test_numpy_integers_count() -> None:
    problem = cq.LocalProblem(delassus=KLARBRING, offset=[-7.0, -17.0], friction=0.3, dimension=2)
    assert cq.solve(problem, algorithm="nsgs", max_iter=np.int64(50)).certificate.passed
    space = cq.LocalProblem(delassus=np.eye(3), offset=[-1.0, 1.0, 0.0], friction=0.5, dimension=3)
    assert cq.solve(space, algorithm="tresca", facets=np.int64(8)).certificate.passed
    with pytest.raises(cq.InvalidProblem, match="facets: expected a whole number from 3 to 10000, got 1000000"):
        cq.solve(space, algorithm="tresca", facets=10**6)


def test_a_point_that_slides_away_is_named_by_the_problems_own_unknowns() -> None:
    point = cq.ContactProblem(
        stiffness=np.zeros((2, 2)),
        load=[0.7, -1.0],
        normal=[[0.0, -1.0]],
        gap=[0.0],
        tangent=[[1.0, 0.0]],
        friction=0.5,
    )
    for algorithm in (None, "tresca", "newton", "nsgs"):
        with pytest.raises(
            cq.NoEquilibrium, match=r"no contact, friction or tie holds back: unknown 0 by \+1, unknown 1"
        ):
            cq.solve(point, algorithm=algorithm)


def test_a_tangent_beneath_the_range_of_doubles() -> None:
    # Its friction is that of mu = 1e-300 along a unit row: the contact slips as if there were none.
    data = dict(stiffness=[[5.0, -2.0], [-2.0, 1.0]], load=[-1.0, -3.0], normal=[[-1.0, 0.0]], gap=[0.0])
    solution = cq.solve(cq.ContactProblem(**data, tangent=[[0.0, 1e-300]], friction=0.3))
    np.testing.assert_allclose(solution.normal_force, [7.0], rtol=1e-12)


def test_findings_are_found_when_they_are_read_and_kept_in_copies(monkeypatch: pytest.MonkeyPatch) -> None:
    """A solve does not wait for them: mu is above W_NN / |W_NT| = 1/2, and several answers exist."""
    problem = cq.LocalProblem(KLARBRING, [0.3, 1.25], 0.8, 2)
    examined: list[object] = []
    examine = local_certificate._critical_friction
    monkeypatch.setattr(local_certificate, "_critical_friction", lambda one: examined.append(one) or examine(one))
    certificate = cq.solve(problem).certificate
    assert certificate.passed
    assert examined == []
    for copy in (pickle.loads(pickle.dumps(certificate)), replace(certificate), certificate):
        assert copy.uniqueness == (POSSIBLE,)
        assert "mu = 0.8 of contact 0 is not below the critical 0.5" in copy.notes[0]
    again = pickle.loads(pickle.dumps(certificate))
    count = len(examined)
    assert replace(again, passed=False).uniqueness == (POSSIBLE,)
    assert len(examined) == count


def test_velocities_that_differ_by_rounding_are_listed_once() -> None:
    """Contact 0 presses with one; nothing moves at contact 1, where rounding alone meets, in any of its states."""
    W = np.array([[8.0, 0.0, -4.0, 0.0], [0.0, 9.0, -1.0, 10.0], [-4.0, -1.0, 3.0, -2.0], [0.0, 10.0, -2.0, 13.0]])
    W += 2.0**-20 * np.eye(4)
    problem = cq.LocalProblem(delassus=W, offset=[-W[0, 0], -2.0, 4.0, 1.0], friction=[0.0, 8.0], dimension=2)
    [found] = cq.equilibria(problem)
    np.testing.assert_allclose(found.velocity, [[0.0, -2.0], [0.0, 1.0]], atol=1e-12)
    W = np.array([[1.25, -1.0, 2.0, 2.0], [-1.0, 5.25, 0.0, -2.0], [2.0, 0.0, 5.25, 4.0], [2.0, -2.0, 4.0, 4.25]])
    three = cq.LocalProblem(delassus=W, offset=[-2.0, -1.0, -5.25, -4.0], friction=[1.0, 0.125], dimension=2)
    slips = np.sort([one.velocity[0, 1] for one in cq.equilibria(three)])  # of the rational answers
    np.testing.assert_allclose(slips, [-1.0, -11.0 / 14.0, 0.0], atol=1e-12)
