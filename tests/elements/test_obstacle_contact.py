"""Nodes and obstacles in the current configuration: rows are derivatives of gaps, curvatures derivatives of rows."""

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.deformable import ContactGeometry, ContactGroup, Deformable, ObstacleContact, Supported
from contactqp.elements.nonlinear_truss import NonlinearTruss
from contactqp.errors import InvalidProblem
from tests.elements.derivatives import check_derivatives
from tests.elements.test_obstacles import OBSTACLES

STEP = 1e-5
FLAT = {"plane"}


def contact_with(name, count=3, seed=0):
    obstacle = OBSTACLES[name]
    random = np.random.default_rng(seed)
    contact = ObstacleContact(random.uniform(1, 2, (count, obstacle.dimension)), obstacle)
    return contact, random.uniform(0, 0.5, contact.dimension)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", OBSTACLES)
def test_rows_and_curvature_are_derivatives_of_the_gaps_of_now(name):
    contact, u = contact_with(name)
    force = np.array([1.0, 2.0, 0.0])
    steps = STEP * np.eye(len(u))
    state = contact.state(u)
    slope = np.array([(contact.state(u + h).gap - contact.state(u - h).gap) / (2 * STEP) for h in steps]).T
    np.testing.assert_allclose(-state.normal.toarray(), slope, atol=1e-8)
    assert np.abs(slope).max() > 0.1
    rows = [(contact.state(u + h).normal - contact.state(u - h).normal).T @ force / (2 * STEP) for h in steps]
    curvature = contact.curvature(u, force).toarray()
    np.testing.assert_allclose(curvature, np.array(rows).T, atol=1e-5)  # differences of differences of the function
    assert (np.abs(curvature).max() > 1e-2) == (name not in FLAT)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", OBSTACLES)
def test_slip_is_measured_along_the_tangents_of_now(name):
    contact, u = contact_with(name)
    anchor = contact.positions(u)
    assert np.abs(contact.slip_since(u, anchor)).max() == 0
    du = 1e-6 * np.random.default_rng(1).standard_normal(len(u))
    E_T = contact.state(u).tangent
    np.testing.assert_allclose(contact.slip_since(u + du, anchor).ravel(), E_T @ du, atol=1e-10)
    assert np.abs(E_T @ du).max() > 1e-8


def test_a_node_that_slides_along_a_circle_has_a_normal_that_turns():
    contact = ObstacleContact([[0.0, 2.0]], cq.Circle([0.0, 0.0], 1.0))
    np.testing.assert_allclose(contact.state(np.array([2.0, -2.0])).normal.toarray(), [[-1.0, 0.0]], atol=1e-16)
    np.testing.assert_allclose(contact.state(np.array([2.0, -2.0])).gap, [1.0])
    with pytest.raises(InvalidProblem, match="lies at the centre"):
        contact.state(np.array([0.0, -2.0]))


def test_several_obstacles_are_one_geometry():
    floor, ball = cq.Plane([0.0, 0.0], [0.0, 1.0]), cq.Circle([3.0, 0.0], 1.0)
    parts = [ObstacleContact([[0.0, 1.0]], floor), ObstacleContact([[0.0, 1.0]], ball)]
    group, u = ContactGroup(parts), np.array([1.0, -1.0])
    assert isinstance(group, ContactGeometry)
    assert group.contacts == 2
    np.testing.assert_allclose(group.state(u).gap, [0.0, 1.0], atol=1e-15)
    np.testing.assert_allclose(group.state(u).normal.toarray(), [[0, -1], [1, 0]], atol=1e-15)
    np.testing.assert_allclose(group.curvature(u, np.array([5.0, 3.0])).toarray(), [[0, 0], [0, -1.5]], atol=1e-15)
    np.testing.assert_allclose(group.slip_since(u, np.zeros((2, 2))), [[1.0], [0.0]], atol=1e-15)
    with pytest.raises(InvalidProblem, match="at least one"):
        ContactGroup([])
    with pytest.raises(InvalidProblem, match="same unknowns"):
        ContactGroup([parts[0], ObstacleContact([[0.0, 1.0]], ball, dimension=3)]).state(np.zeros(3))


def test_contacts_over_other_unknowns_than_the_body_has_are_refused():
    held = Supported(truss(), [0, 1, 4, 5])
    contact = ObstacleContact([[0.0, 1.0]], cq.Circle([0.0, -3.0], 2.0), dimension=held.body.dimension + 2)
    with pytest.raises(InvalidProblem, match="expected rows over the 6 unknowns of the body, got 8; state dimension=6"):
        held.contact(contact)


def test_a_surface_brings_its_own_unknowns():
    from contactqp.elements.surface import Surface

    points = np.array([[0.0, 1.0], [1.0, 1.0]])
    surface = Surface(points, np.array([[1, 0]]), np.array([[2, 3], [0, 1]]))
    contact = ObstacleContact(surface, cq.Plane([0.0, 0.0], [0.0, 1.0]))
    np.testing.assert_allclose(contact.state(np.array([0.0, -0.5, 0.0, 0.25])).gap, [1.25, 0.5])
    with pytest.raises(InvalidProblem, match="has its own"):
        ObstacleContact(surface, cq.Plane([0.0, 0.0], [0.0, 1.0]), unknowns=[[0, 1], [2, 3]])


def test_a_gap_along_an_axis_is_refused():
    with pytest.raises(InvalidProblem, match="measure='normal'"):
        ObstacleContact([[0.0, 1.0]], cq.Paraboloid([0.0, 0.0], [0.0, 1.0], 1.0))


def truss():
    return NonlinearTruss([[-1.0, 0.0], [0.0, 0.7], [1.1, 0.0]], [[0, 1], [1, 2]], 2.0, [1.0, 0.5])


def test_a_supported_body_is_a_body_of_its_free_unknowns():
    held = Supported(truss(), {0: 0.0, 1: 0.0, 4: -0.2, 5: 0.1})
    assert isinstance(held, Deformable)
    assert held.free.tolist() == [2, 3]
    u = np.array([0.3, -0.1])
    np.testing.assert_allclose(held.expand(u), [0, 0, 0.3, -0.1, -0.2, 0.1])
    check_derivatives(held, u)
    forces = held.support_forces(u).reshape(-1, 2)
    np.testing.assert_allclose(forces.sum(axis=0), -held.internal_force(u), atol=1e-15)
    assert np.abs(forces).max() > 0.1
    assert held.restrict(np.arange(6.0)).tolist() == [2.0, 3.0]


def test_contacts_of_a_supported_body_see_its_free_unknowns_alone():
    held = Supported(truss(), [0, 1, 4, 5])
    everywhere = ObstacleContact(truss().nodes, cq.Circle([0.0, -3.0], 2.0))
    contact, u = held.contact(everywhere), np.array([0.3, -0.1])
    whole, state = everywhere.state(held.expand(u)), contact.state(u)
    np.testing.assert_array_equal(state.gap, whole.gap)
    np.testing.assert_array_equal(state.normal.toarray(), whole.normal.toarray()[:, 2:4])
    np.testing.assert_array_equal(state.tangent.toarray(), whole.tangent.toarray()[:, 2:4])
    force = np.array([1.0, 2.0, 3.0])
    curvature = everywhere.curvature(held.expand(u), force).toarray()[2:4, 2:4]
    np.testing.assert_array_equal(contact.curvature(u, force).toarray(), curvature)
    assert np.abs(curvature).max() > 0.1
    anchor = contact.positions(np.zeros(2))
    np.testing.assert_array_equal(contact.slip_since(u, anchor), everywhere.slip_since(held.expand(u), anchor))


@pytest.mark.parametrize(
    ("held", "message"), [([6], "places from 0 to 5"), ({0: np.inf}, "finite"), (range(6), "every unknown")]
)
def test_bad_supports_are_refused(held, message):
    with pytest.raises(InvalidProblem, match=message):
        Supported(truss(), held if isinstance(held, dict) else list(held))
