"""Friction in space on bodies: held by friction alone, redundant, tied, elastic; what nothing holds."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.solving.solve import _without_friction
from tests.solving.friction.space import WAYS, block, direction, elastic_block, plane_block
from tests.solving.friction.test_space import solved


def rigid_table(push, turn: float = 0.0, friction=0.4, legs: int = 4, weight: float = 8.0) -> cq.ContactProblem:
    """A rigid table on legs at the corners of a square of side 2; unknowns: three displacements, three rotations."""
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])[:legs]
    normal = [[0.0, 0.0, -1.0, -y, x, 0.0] for x, y in corners]
    tangent = [row for x, y in corners for row in ([1.0, 0, 0, 0, 0, -y], [0, 1.0, 0, 0, 0, x])]
    return cq.ContactProblem(
        stiffness=np.zeros((6, 6)),
        load=[*push, -weight, 0.0, 0.0, turn],
        normal=normal,
        gap=np.zeros(legs),
        tangent=tangent,
        friction=friction,
        dof_names=["x", "y", "z", "rx", "ry", "rz"],
    )


@pytest.mark.sampled(6)
@pytest.mark.parametrize("way", ["by itself", "newton", "nsgs", "admm", "aclm, clarabel", "tresca, clarabel"])
def test_a_rigid_table_held_by_friction_alone(way: str) -> None:
    """mu W = 3.2; its legs share the weight as they like, and what they carry together is the load."""
    push = 3.1 * direction(0.7)
    solution = solved(rigid_table(push), way)
    np.testing.assert_allclose(solution.displacement, 0.0, atol=1e-12)
    np.testing.assert_allclose(solution.normal_force.sum(), 8.0, rtol=1e-12)
    np.testing.assert_allclose(solution.friction_force.sum(axis=0), push, atol=1e-12)
    assert np.all(np.linalg.norm(solution.friction_force, axis=1) <= 0.4 * solution.normal_force * (1 + 1e-12))
    assert solution.free_motions == ()


@pytest.mark.slow
def test_a_table_that_is_pushed_or_turned_too_much_has_no_equilibrium() -> None:
    """A push of 3.3 exceeds mu W = 3.2; a moment of 4.6 exceeds mu W sqrt(2) = 4.525, and 4.5 does not."""
    for angle in (0.0, 0.7, -2.0):
        with pytest.raises(cq.NoEquilibrium, match="drives a rigid motion"):
            cq.solve(rigid_table(3.3 * direction(angle)))
    assert cq.solve(rigid_table([0.0, 0.0], turn=4.5)).certificate.passed
    with pytest.raises(cq.NoEquilibrium, match="drives a rigid motion"):
        cq.solve(rigid_table([0.0, 0.0], turn=4.6))
    with pytest.raises(cq.NoEquilibrium, match="drives a rigid motion"):
        cq.solve(rigid_table([0.0, 0.0]).replace(load=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))


def test_a_table_on_ice_is_at_rest_and_its_motions_are_listed() -> None:
    """mu = 0 at all legs but one: it turns freely about that leg; nothing drives it."""
    solution = cq.solve(rigid_table([0.0, 0.0], friction=[0.4, 0.0, 0.0, 0.0]))
    assert len(solution.free_motions) == 1
    np.testing.assert_allclose(solution.displacement, 0.0, atol=1e-12)
    assert solution.contact_status[0] == "stick"
    with pytest.raises(cq.NoEquilibrium):
        cq.solve(rigid_table([0.0, 0.0], turn=0.1, friction=[0.4, 0.0, 0.0, 0.0]))


def test_a_body_that_nothing_touches_is_free() -> None:
    """Another body beside the block, without load and contacts: three motions, at rest."""
    one = block(4.0 * direction(0.3))
    both = cq.ContactProblem(
        stiffness=np.block([[one.stiffness, np.zeros((3, 3))], [np.zeros((3, 6))]]),
        load=[*one.load, 0.0, 0.0, 0.0],
        normal=[[0.0, 0.0, -1.0, 0.0, 0.0, 0.0]],
        gap=[0.0],
        tangent=np.eye(2, 6),
        friction=0.3,
    )
    solution = cq.solve(both)
    assert len(solution.free_motions) == 3
    np.testing.assert_allclose(solution.displacement[:2], 0.5 * direction(0.3), rtol=1e-14)
    np.testing.assert_allclose(solution.displacement[2:], 0.0, atol=1e-15)
    with pytest.raises(cq.NoEquilibrium):
        cq.solve(both.replace(load=[*one.load, 1.0, 0.0, 0.0]))


def test_a_load_that_drives_a_motion_by_rounding_only_drives_none() -> None:
    """Forces whose sum over a floating body is 1e-17, not 0, and no contact that pushes."""
    shape = np.random.default_rng(3).normal(size=(6, 5))
    K = shape @ shape.T
    u = np.random.default_rng(4).normal(size=6)
    far = cq.ContactProblem(K, K @ u, -np.eye(1, 6), [5.0 - u[0]], np.eye(6)[1:3], friction=0.2)
    motion = np.linalg.svd(K)[0][:, -1]
    assert 0 < abs(motion @ far.load) < 1e-12
    solution = cq.solve(far)
    assert solution.contact_status.tolist() == ["open"]
    np.testing.assert_allclose(solution.displacement, u - motion * (motion @ u), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["by itself", "nsgs", "admm", "aclm, clarabel"])
def test_a_contact_that_is_there_three_times(way: str) -> None:
    one = block(4.0 * direction(1.0))
    thrice = one.replace(
        normal=np.repeat(one.normal.toarray(), 3, axis=0),
        gap=np.zeros(3),
        tangent=np.tile(one.tangent.toarray(), (3, 1)),
        friction=np.full(3, 0.3),
        slip_origin=np.zeros((3, 2)),
    )
    solution = solved(thrice, way)
    np.testing.assert_allclose(solution.displacement[:2], 0.5 * direction(1.0), rtol=1e-12)
    np.testing.assert_allclose(solution.normal_force.sum(), 10.0, rtol=1e-12)
    np.testing.assert_allclose(solution.friction_force.sum(axis=0), 3.0 * direction(1.0), rtol=1e-12)


@pytest.mark.sampled(11)
@pytest.mark.parametrize("way", WAYS)
def test_a_tie_between_two_blocks(way: str) -> None:
    """Two blocks tied to move alike along the plane, one on ice: mu N = 3 against the pushes on both."""
    one, t = block([0.0, 0.0]), direction(2.0)
    K = np.kron(np.eye(2), one.stiffness)
    tie = np.hstack([np.eye(2, 3), -np.eye(2, 3)])
    problem = cq.ContactProblem(
        stiffness=K,
        load=[*(4.0 * t), -10.0, *(1.0 * t), -5.0],
        normal=[[0.0, 0.0, -1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, -1.0]],
        gap=[0.0, 0.0],
        tangent=np.delete(np.eye(6), [2, 5], axis=0),
        friction=[0.3, 0.0],
        tie=tie,
        tie_value=[0.0, 0.0],
    )
    solution = solved(problem, way)
    # Together 2 x 2 springs and a push of 5: slip (5 - 3) / 4.
    np.testing.assert_allclose(solution.displacement, [*(0.5 * t), 0.0] * 2, atol=1e-12)
    np.testing.assert_allclose(solution.friction_force, [3.0 * t, [0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(solution.tie_force, 1.0 * t - 1.0 * t, atol=1e-12)


def _held(problem: cq.ContactProblem, contacts: np.ndarray) -> cq.ContactProblem:
    """The slip of some contacts tied to zero, no friction anywhere."""
    rows = problem.tangent.toarray()[np.sort(np.concatenate([2 * contacts, 2 * contacts + 1]))]
    return problem.replace(friction=np.zeros(problem.contacts), tie=rows, tie_value=np.zeros(len(rows)))


@pytest.mark.slow
def test_with_enough_friction_every_contact_that_closes_is_tied() -> None:
    """mu = 1e6 against ties of the same slips; mu = 0 against no tangential rows at all."""
    rough = elastic_block((5, 4, 3), friction=1e6)
    solution = cq.solve(rough)
    closed = np.flatnonzero(solution.normal_force > 0)
    assert len(closed) == 30
    assert set(solution.contact_status) == {"stick"}
    tied = cq.solve(_held(rough, closed))
    np.testing.assert_allclose(solution.displacement, tied.displacement, atol=1e-13)
    np.testing.assert_allclose(solution.normal_force, tied.normal_force, atol=1e-13)
    smooth = rough.replace(friction=np.zeros(rough.contacts))
    bare = cq.ContactProblem(rough.stiffness, rough.load, rough.normal, rough.gap)
    np.testing.assert_allclose(cq.solve(smooth).displacement, cq.solve(bare).displacement, atol=1e-13)
    assert np.max(abs(cq.solve(smooth).displacement - solution.displacement)) > 1e-3


def test_some_contacts_on_ice() -> None:
    """mu by contact, 0 in one half: those carry no friction, the others obey their own bounds."""
    problem = elastic_block((6, 6, 3))
    mu = np.where(np.arange(problem.contacts) % 2, 0.0, np.linspace(0.05, 0.5, problem.contacts))
    solution = cq.solve(problem.replace(friction=mu))
    assert np.all(solution.friction_force[mu == 0] == 0.0)
    size = np.linalg.norm(solution.friction_force, axis=1)
    slips = solution.contact_status == "slip"
    assert np.count_nonzero(slips[mu > 0]) > 5
    np.testing.assert_allclose(size[slips], (mu * solution.normal_force)[slips], rtol=1e-12)
    assert solution.certificate.passed


@pytest.mark.sampled(3)
@pytest.mark.parametrize("angle", [0.0, 0.6, 2.2])
def test_a_sheared_block_is_in_a_uniform_state(angle: float) -> None:
    """nu = 0: pressure p = E 0.04, shear t = mu p where it slides; G = 1/2, its top leads by h t / G, the rest is slip.

    64 hexahedra and 25 contacts, all of which carry by their share of the area, in the direction of the push.
    """
    p, mu, way = 0.04, 0.2, direction(angle)
    t = mu * p
    push = 0.5 * t / 0.5 + 0.001
    problem = elastic_block((4, 4, 4), mu, tuple(push * way), poisson=0.0, shear=tuple(t * way))
    solution = cq.solve(problem)
    edge = np.array([0.5, 1.0, 1.0, 1.0, 0.5]) / 4
    shares = np.sort(np.outer(edge, edge).ravel())
    np.testing.assert_allclose(np.sort(solution.normal_force), p * shares, rtol=1e-10)
    order = np.argsort(solution.normal_force)
    np.testing.assert_allclose(solution.friction_force[order] / shares[:, None], np.tile(t * way, (25, 1)), atol=1e-12)
    np.testing.assert_allclose(solution.slip, np.tile(0.001 * way, (25, 1)), atol=1e-12)
    assert set(solution.contact_status) == {"slip"}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("push", [0.002, 0.01])
def test_plane_strain_in_space_is_plane_strain(push: float) -> None:
    """Front and back held in y: every section is the plane problem, its forces shared by the width of the elements."""
    space, plane = elastic_block((8, 4, 4), 0.3, (push, 0.0), plane_strain=True), plane_block((8, 4), 0.3, push)
    one, other = cq.solve(space), cq.solve(plane)
    assert {"stick", "slip"} <= set(other.contact_status) or push > 0.002
    share = np.array([0.5, 1.0, 1.0, 1.0, 0.5]) / 4
    order = np.argsort(other.normal_force)
    expected = np.sort(np.outer(share, other.normal_force).ravel())
    np.testing.assert_allclose(np.sort(one.normal_force), expected, atol=1e-10 * expected.max())
    rubbed = np.sort(np.outer(share, other.friction_force[order, 0]).ravel())
    np.testing.assert_allclose(np.sort(one.friction_force[:, 0]), rubbed, atol=1e-10 * expected.max())
    np.testing.assert_allclose(one.friction_force[:, 1], 0.0, atol=1e-10 * expected.max())
    np.testing.assert_allclose(one.energy, other.energy, rtol=1e-9)


@pytest.mark.slow
def test_a_pushed_elastic_block_turned_by_a_quarter() -> None:
    """8 x 8 x 4 hexahedra, 81 contacts, partly sliding; pushed along y instead of x all turns with the push."""
    one, other = (cq.solve(elastic_block(push=push)) for push in ((0.005, 0.0), (0.0, 0.005)))
    assert {"stick", "slip"} == set(one.contact_status)
    np.testing.assert_allclose(np.sort(one.normal_force), np.sort(other.normal_force), rtol=1e-9)
    np.testing.assert_allclose(np.sort(one.friction_force[:, 0]), np.sort(other.friction_force[:, 1]), atol=1e-12)
    np.testing.assert_allclose(one.energy, other.energy, rtol=1e-12)
    assert one.work.factorisations == 1
    # Contacts that slide obliquely: the block bulges.
    assert np.max(abs(one.friction_force[:, 1])) > 0.1 * np.max(abs(one.friction_force[:, 0]))


@pytest.mark.slow
def test_polygons_of_more_and_more_sides_approach_the_cone() -> None:
    """Tresca's steps with discs against those with inscribed polygons, without a finish: the last step's own error."""
    problem = elastic_block((4, 4, 2), push=(0.006, 0.003))
    cone = cq.solve(problem)
    for way in ("aclm, clarabel", "tresca, clarabel", "aclm, active set, 8 sides", "tresca, active set, 32 sides"):
        found = solved(problem, way)
        np.testing.assert_allclose(found.displacement, cone.displacement, atol=1e-12)
        np.testing.assert_allclose(found.friction_force, cone.friction_force, atol=1e-12)


@pytest.mark.slow
def test_a_column_in_a_corner_is_held_where_few_algorithms_come_to_an_answer() -> None:
    """It stands on a bowl and along a wall, off the bowl's middle: without friction it would slide.

    Newton's method, Gauss-Seidel and proximal points miss it; convex steps come to it.
    """
    mesh = box((1.0, 1.5, 7.6), (1, 3, 2), "hex8", grading=50.0)
    structure = cq.Structure([cq.Body(mesh, cq.Material(1.0, 0.499), "3d", name="column")])
    bowl = cq.pair(structure.surface("column", "bottom"), cq.Paraboloid([0.45, 1.45, 0.0], [0.0, 0.0, 1.0], 0.9))
    wall = cq.pair(structure.surface("column", "right"), cq.Plane([1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]))
    top = np.flatnonzero(mesh.points[:, 2] == 7.6)
    load = np.zeros(structure.size)
    load[3 * top + 2] = -1e-4 / len(top)
    solution = cq.solve(structure.assemble([]).problem([bowl, wall], friction=0.8).replace(load=load))
    assert solution.certificate.passed
    assert solution.method.startswith(("Tresca", "aclm"))
    assert solution.normal_force.max() > 1e-5


def test_the_answer_without_friction_that_candidates_start_from_condenses_normals_alone() -> None:
    """Tangents of a whole surface would be three times as many unknowns: a ball of 33 195 took 15 s for 2.5."""
    body = Body(box((1.0, 1.0, 0.5), (4, 4, 2)), Material(1.0, 0.3), "3d", name="block")
    structure = Structure([body])
    held = [Support("block", "top", axis, -0.01 if axis == 2 else 0.0) for axis in range(3)]
    paraboloid = cq.Paraboloid([0.5, 0.5, 0.0], [0.0, 0.0, 1.0], 5.0)
    pairs = [cq.pair(structure.surface("block", "bottom"), paraboloid)]
    assembled = structure.assemble(held)
    force, work = _without_friction(assembled.problem(pairs, friction=0.3))
    slippery = cq.solve(assembled.problem(pairs))
    assert force == pytest.approx(slippery.normal_force, abs=1e-12 * float(np.max(slippery.normal_force)))
    assert work.retained == slippery.work.retained
