"""W = H'M^-1 H and what belongs to it, against dense algebra in other words, and what has no local form."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import contactqp as cq
from contactqp.exchange.local_form import SingularMatrix, body_motion
from contactqp.linalg.delassus import velocity_of
from tests.exchange.files import MU, OFFSET, B, F, G, H, M


def bodies(seed, joints=0, unsymmetric=0.0):
    random = np.random.default_rng(seed)
    n, m, d = 9, 2, 3
    A = random.standard_normal((n, n))
    scale = 10.0 ** random.uniform(-5, 5, n)  # unknowns in different units
    matrix = np.outer(scale, scale) * (A @ A.T + np.eye(n) + unsymmetric * random.standard_normal((n, n)))
    directions = random.standard_normal((n, d * m)) * scale[:, None]
    tied = dict(joints=random.standard_normal((n, joints)) * scale[:, None], joint_offset=random.random(joints))
    return cq.GlobalProblem(
        matrix, directions, random.random(n) * scale, random.random(d * m), [0.3, 0.8], d, **(tied if joints else {})
    )


@pytest.mark.parametrize("unsymmetric", [0.0, 0.2])
def test_the_local_form_moves_as_the_bodies_do(unsymmetric):
    problem = bodies(1, unsymmetric=unsymmetric)
    local = cq.local_form_of(problem)
    r = np.random.default_rng(2).random((2, 3))
    v = body_motion(problem, r, np.zeros(0))
    assert problem.matrix @ v == pytest.approx(problem.directions @ r.ravel() + problem.load, rel=1e-9)
    assert velocity_of(local, r).ravel() == pytest.approx(problem.directions.T @ v + problem.offset, rel=1e-9)
    assert (local.asymmetry == 0) == (unsymmetric == 0)
    assert (local.asymmetry > 1e-3) == (unsymmetric > 0)


def test_joints_of_the_local_form_are_those_of_the_bodies():
    problem = bodies(3, joints=2)
    local = cq.local_form_of(problem)
    random = np.random.default_rng(4)
    r, joint = random.random((2, 3)), random.random(2)
    v = body_motion(problem, r, joint)
    assert velocity_of(local, r, joint).ravel() == pytest.approx(problem.directions.T @ v + problem.offset, rel=1e-9)
    told = local.bilateral.T @ r.ravel() + local.bilateral_delassus @ joint + local.bilateral_offset
    assert told == pytest.approx(problem.joints.T @ v + problem.joint_offset, rel=1e-9)


def test_a_contact_problem_has_the_local_form_of_its_global_form():
    problem = cq.GlobalProblem(M, H, F, OFFSET, MU[:1], 3, joints=G, joint_offset=B)
    direct, through = cq.local_form_of(problem), cq.local_form_of(problem.contact_problem())
    assert np.array_equal(direct.delassus.toarray(), through.delassus.toarray())
    assert np.array_equal(direct.bilateral_offset, through.bilateral_offset)
    assert direct.delassus.toarray() == pytest.approx(H.T @ np.linalg.inv(M) @ H, abs=1e-15)
    assert cq.local_form_of(direct) is direct


def test_a_solution_of_the_bodies_solves_the_local_form_and_its_contrary_does_not():
    rows = dict(normal=[[0.0, -1.0]], gap=[0.01], tangent=[[1.0, 0.0]], friction=0.5, contact_names=["foot"])
    problem = cq.ContactProblem(stiffness=[[2.0, -0.5], [-0.5, 3.0]], load=[2.0, -1.0], **rows)
    solution = cq.solve(problem)
    force = np.column_stack([solution.normal_force, -solution.friction_force])
    local = cq.local_form_of(problem)
    assert local.contact_name(0) == "foot"
    assert cq.certify_local(local, force).passed
    assert not cq.certify_local(local, force * [1, -1]).passed


def test_bodies_that_are_not_connected_leave_W_sparse():
    n = 600
    chains = sp.block_diag([sp.diags([2.0, 3.0])] * (n // 2), format="csr")
    H = sp.identity(n, format="csr")
    local = cq.local_form_of(cq.GlobalProblem(chains, H, np.ones(n), np.zeros(n), 0.3, 2))
    assert local.delassus.nnz == n
    assert local.delassus.diagonal()[:2] == pytest.approx([1 / 2, 1 / 3])


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("size", [3, 50])
def test_bodies_that_only_contact_holds_have_no_local_form(scale, size):
    """A chain of springs that floats, and the same chain when one end is held."""
    chain = 2 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1)
    chain[0, 0] = chain[-1, -1] = 1
    H = np.zeros((size, 2))
    H[0, 0] = H[-1, 1] = 1
    with pytest.raises(SingularMatrix, match=r"local form: M is singular .*nothing but contact holds"):
        cq.local_form_of(cq.GlobalProblem(scale * chain, H, np.zeros(size), [0, 0], 0.3, 2))
    chain[0, 0] = 2
    local = cq.local_form_of(cq.GlobalProblem(scale * chain, H, np.zeros(size), [0, 0], 0.3, 2))
    assert local.delassus.toarray() == pytest.approx(np.array([[1, 1], [1, size]]) / scale, rel=1e-10)


def test_a_zero_row_is_singular_and_large_differences_of_scale_are_not():
    with pytest.raises(SingularMatrix):
        cq.local_form_of(cq.GlobalProblem(np.diag([1.0, 0.0]), np.eye(2), [0, 0], [0, 0], 0.3, 2))
    local = cq.local_form_of(cq.GlobalProblem(np.diag([1e-12, 1e12]), np.eye(2), [0, 0], [0, 0], 0.3, 2))
    assert local.delassus.diagonal() == pytest.approx([1e12, 1e-12])


def test_joints_with_an_unsymmetric_matrix_are_not_supported():
    with pytest.raises(cq.Unsupported, match="joints with an M that is not symmetric"):
        cq.local_form_of(bodies(5, joints=1, unsymmetric=0.2))


BAD = {
    "dimension: expected 2 or 3, got 5": dict(dimension=5),
    "matrix: expected a square matrix": dict(matrix=M[:2]),
    "directions: expected 3 rows and 3 columns a contact": dict(directions=H[:, :2]),
    "load: expected shape": dict(load=F[:2]),
    "offset: expected shape": dict(offset=OFFSET[:2]),
    "friction: expected a coefficient >= 0": dict(friction=-0.1),
    "joints: expected 3 rows": dict(joints=np.ones((2, 1))),
    "joint_offset was given without joints": dict(joint_offset=[1.0]),
    "joint_offset: expected shape": dict(joints=G, joint_offset=[1.0, 2.0]),
    "matrix: expected finite numbers": dict(matrix=M * np.nan),
}


@pytest.mark.parametrize("expected", BAD)
def test_wrong_data_of_bodies_are_refused(expected):
    good = dict(matrix=M, directions=H, load=F, offset=OFFSET, friction=0.3, dimension=3)
    with pytest.raises(cq.InvalidProblem, match=expected):
        cq.GlobalProblem(**(good | BAD[expected]))


def test_asymmetry_is_measured_as_of_a_stiffness():
    def asymmetry(matrix):
        return cq.GlobalProblem(matrix, np.eye(2), [0, 0], [0, 0], 0.3, 2).asymmetry

    assert asymmetry([[1.0, 2.0], [2.0, 4.0]]) == 0
    assert asymmetry([[1.0, 2.0], [1.0, 4.0]]) == pytest.approx(0.5)
    assert asymmetry([[0.0, 2.0], [1.0, 4.0]]) == np.inf
