"""Solids at large strains: derivatives, patch tests, rigid rotations, closed forms, and elements turned inside out."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import brentq

import contactqp as cq
from contactqp.elements.deformable import Deformable, Supported
from contactqp.elements.loads import Traction
from contactqp.elements.material import Material
from contactqp.elements.mesh import Mesh
from contactqp.elements.nonlinear_solid import LAWS, NeoHookean, NonlinearSolid
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem, NotConverged
from tests.elements.bodies import body
from tests.elements.derivatives import check_derivatives

KINDS = {"tri3": "plane-strain", "quad4": "plane-strain", "quad8": "plane-strain", "tet4": "3d", "hex8": "3d"}
CASES = [(kind, model, law) for kind, model in KINDS.items() for law in LAWS]
CASES += [("quad9", "plane-stress", "saint-venant-kirchhoff"), ("tet10", "3d", "neo-hookean")]


def solid(kind, model, law):
    return NonlinearSolid(body(kind, model), law)


def affine(part, F):
    """The displacement of x = F X."""
    X = part.body.mesh.points
    return (X @ (F - np.eye(len(F))).T).ravel()


def stretch(d):
    """A large stretch, shear and turn."""
    return np.array([[1.4, 0.5, 0.1], [-0.3, 0.8, 0.2], [0.2, -0.1, 1.2]])[:d, :d]


def turn(d, angle):
    Q = np.eye(d)
    Q[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return Q if d == 2 else Q @ np.array([[1, 0, 0], [0, 0.6, -0.8], [0, 0.8, 0.6]])


@pytest.mark.sampled(12)
@pytest.mark.parametrize(("kind", "model", "law"), CASES)
def test_force_and_tangent_are_the_derivatives_of_the_energy(kind, model, law):
    part = solid(kind, model, law)
    assert isinstance(part, Deformable)
    random = np.random.default_rng(0)
    size = float(np.ptp(part.body.mesh.points))
    u = affine(part, stretch(part.body.dimension)) + 0.01 * size * random.uniform(-1, 1, part.dimension)
    # Of a body of modulus one and size one, whose numbers are of order one.
    mesh = Mesh(part.body.mesh.points / size, part.body.mesh.blocks)
    scaled = Body(mesh, Material(1.0, part.body.material.poisson), model)
    check_derivatives(NonlinearSolid(scaled, law), u / size, 1e-6)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("kind", "model", "law"), CASES)
def test_a_homogeneous_deformation_is_exact_on_a_distorted_mesh(kind, model, law):
    """The patch test: the same stress everywhere, by hand from F, and no force on any inner node."""
    part = solid(kind, model, law)
    d = part.body.dimension
    F = stretch(d)
    u = affine(part, F)
    material = part.body.material
    lame_lambda, lame_mu = material.lame_lambda, material.lame_mu
    full = np.eye(3)
    full[:d, :d] = F
    if law == "neo-hookean":
        J = np.linalg.det(full)
        inverse = np.linalg.inv(full.T @ full)
        S = lame_mu * (np.eye(3) - inverse) + lame_lambda * np.log(J) * inverse
    else:
        G = (full.T @ full - np.eye(3)) / 2
        if model == "plane-stress":
            G[2, 2] = -lame_lambda / (lame_lambda + 2 * lame_mu) * (G[0, 0] + G[1, 1])
        S = lame_lambda * np.trace(G) * np.eye(3) + 2 * lame_mu * G
    sigma = (F @ S[:d, :d] @ F.T) / np.linalg.det(F)
    for found in part.cauchy_stress(u):
        np.testing.assert_allclose(found, np.broadcast_to(sigma, found.shape), atol=1e-12 * abs(sigma).max())
    force = part.internal_force(u).reshape(-1, d)
    mesh = part.body.mesh
    outside = np.concatenate([block.nodes.ravel() for block in mesh.facets_of(mesh.boundary)])
    inner = np.setdiff1d(np.arange(len(force)), outside)
    assert len(inner)
    assert abs(force[inner]).max() <= 1e-12 * abs(force).max()
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-12 * abs(force).max())


@pytest.mark.sampled(7)
@pytest.mark.parametrize("angle", [0.4, np.pi / 2, 3.0])
@pytest.mark.parametrize(("kind", "model", "law"), CASES)
def test_a_rigid_rotation_costs_nothing(kind, model, law, angle):
    part = solid(kind, model, law)
    Q = turn(part.body.dimension, angle)
    u = affine(part, Q)
    stiff = part.body.material.modulus * part.body.mesh.volume() * part.body.thickness
    assert abs(part.energy(u)) <= 1e-14 * stiff
    size = float(np.ptp(part.body.mesh.points))
    assert abs(part.internal_force(u)).max() <= 1e-12 * stiff / size
    assert part.energy(affine(part, stretch(part.body.dimension))) > 1e-2 * stiff
    # Frame indifference: what is stretched and then turned has turned forces.
    F = stretch(part.body.dimension)
    turned = part.internal_force(affine(part, Q @ F)).reshape(-1, len(Q))
    straight = part.internal_force(affine(part, F)).reshape(-1, len(Q))
    np.testing.assert_allclose(turned, straight @ Q.T, atol=1e-11 * abs(straight).max())


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("kind", "model", "law"), CASES)
def test_at_rest_the_tangent_is_the_linear_stiffness(kind, model, law):
    part = solid(kind, model, law)
    K, linear = part.tangent(np.zeros(part.dimension)), part.body.stiffness
    assert abs(K - linear).max() <= 1e-13 * abs(linear).max()
    assert abs(part.internal_force(np.zeros(part.dimension))).max() == 0


def uniaxial_stretch(law, lame_lambda, lame_mu, nominal, thick):
    """The stretch (along, across) of a bar under a nominal traction; `thick`: no motion along the third axis."""

    def stresses(along, across):
        third = 1.0 if thick else across
        if law == "neo-hookean":
            log = np.log(along * across * third)
            return [lame_mu * (1 - 1 / s**2) + lame_lambda * log / s**2 for s in (along, across)]
        strains = [(s * s - 1) / 2 for s in (along, across, third)]
        return [lame_lambda * sum(strains) + 2 * lame_mu * e for e in strains[:2]]

    def across(along):
        return brentq(lambda s: stresses(along, s)[1], 0.1, 3, xtol=1e-15)

    along = brentq(lambda s: s * stresses(s, across(s))[0] - nominal, 0.8, 1.7, xtol=1e-15)
    return along, across(along)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("model", ["plane-strain", "3d"])
def test_a_block_in_tension_has_its_closed_form(model, law):
    material = Material(modulus=1.0, poisson=0.3)
    mesh = box((1.0, 2.0, 1.5), (1, 2, 1)) if model == "3d" else rectangle(1.0, 2.0, (1, 2))
    part = Body(mesh, material, model, name="block")
    X, d = mesh.points, mesh.dimension
    held = [d * i + a for a in range(d) for i in np.flatnonzero(X[:, a] == 0)]
    body_ = Supported(NonlinearSolid(part, law), held)
    pull = np.zeros(d)
    pull[0] = 0.4
    load = Traction("block", "right", tuple(pull)).forces(part)
    history = cq.large_deformation(body_, [body_.restrict(load)], steps=4)
    found = X + body_.expand(history[-1].displacement).reshape(X.shape)
    along, across = uniaxial_stretch(law, material.lame_lambda, material.lame_mu, 0.4, model != "3d")
    np.testing.assert_allclose(found[:, 0], along * X[:, 0], atol=1e-12)
    np.testing.assert_allclose(found[:, 1], across * X[:, 1], atol=1e-12)
    assert along > 1.25
    assert history.energies[-1].elastic == pytest.approx(body_.energy(history[-1].displacement))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("law", LAWS)
def test_a_block_is_pressed_flat_by_a_plane(law):
    """Under a rigid plane that comes down by a tenth, without friction: the same closed form, from the other side."""
    material, size = Material(modulus=1.0, poisson=0.3), 2.0
    part = Body(rectangle(1.0, size, (2, 4)), material, "plane-strain", name="block")
    X = part.mesh.points
    held = [2 * i + a for a in range(2) for i in np.flatnonzero(X[:, a] == 0)]
    supported = Supported(NonlinearSolid(part, law), held)
    plane = cq.Plane([0.0, 0.9 * size], [0.0, -1.0])
    contact = supported.contact(cq.ObstacleContact(part.surface("top"), plane, dimension=part.size))
    history = cq.large_deformation(supported, [np.zeros(supported.dimension)], contact, steps=1)
    found = X + supported.expand(history[-1].displacement).reshape(X.shape)
    np.testing.assert_allclose(found[:, 1], 0.9 * X[:, 1], atol=1e-12)
    across = found[:, 0].max()
    np.testing.assert_allclose(found[:, 0], across * X[:, 0], atol=1e-12)
    force = history[-1].normal_force.sum()
    sigma = NonlinearSolid(part, law).cauchy_stress(supported.expand(history[-1].displacement))[0]
    np.testing.assert_allclose(sigma[..., 0, 0], 0, atol=1e-12)
    assert force == pytest.approx(-sigma[0, 0, 1, 1] * across, rel=1e-11)
    assert force > 0.05
    assert history[-1].certificate.passed


@pytest.mark.slow
def test_a_soft_block_on_a_ball_bends_around_it_with_quadratic_convergence():
    part = Body(rectangle(2.0, 1.0, (8, 4), corner=(-1.0, 0.0)), Material(1.0, 0.3), "plane-strain", name="block")
    X = part.mesh.points
    held = [2 * i + a for a in range(2) for i in np.flatnonzero(X[:, 1] == 1)]
    supported = Supported(NonlinearSolid(part), held)
    ball = cq.Circle([0.05, -0.75], 1.0)  # a quarter of the height into the block
    contact = supported.contact(cq.ObstacleContact(part.surface("bottom"), ball, dimension=part.size))
    history = cq.large_deformation(supported, [np.zeros(supported.dimension)], contact, steps=1, method="clarabel")
    last = history[0]  # no load: all of it happens at once
    closed = last.normal_force > 0
    assert 3 <= closed.sum() < len(closed)
    assert abs(last.gap[closed]).max() < 1e-14
    assert last.gap[~closed].min() > 0
    errors = [iteration.error for iteration in last.iterations if not iteration.changed]
    assert len(errors) >= 3
    assert all(after <= max(10 * before**2, 1e-14) for before, after in pairwise(errors))
    by_active_set = cq.large_deformation(supported, [np.zeros(supported.dimension)], contact, steps=1)
    np.testing.assert_allclose(by_active_set[-1].displacement, last.displacement, atol=1e-10)


def test_an_element_turned_inside_out_is_named():
    part = NonlinearSolid(body("quad4", "plane-strain"))
    u = np.zeros(part.dimension)
    node = int(part.body.mesh.blocks[0].nodes[3][2])
    u[2 * node] = -10 * float(np.ptp(part.body.mesh.points))
    assert part.energy(u) == np.inf
    for call in (part.internal_force, part.tangent, part.cauchy_stress):
        with pytest.raises(InvalidProblem, match=r"quad4 element \d+ is turned inside out"):
            call(u)


@pytest.mark.slow
def test_a_load_that_would_turn_elements_inside_out_does_not_converge():
    """Saint Venant and Kirchhoff's law gives way: confined, P = (s^3 - s) / 2 is least at s = 1 / sqrt(3), -0.19245."""
    part = Body(rectangle(1.0, 1.0, (1, 1)), Material(1.0, 0.0), "plane-strain", name="block")
    X = part.mesh.points
    held = [*range(0, 8, 2), *(2 * i + 1 for i in np.flatnonzero(X[:, 1] == 0))]
    supported = Supported(NonlinearSolid(part, "saint-venant-kirchhoff"), held)
    with pytest.raises(NotConverged, match=r"load factor 1: .*turned inside out") as failure:
        cq.large_deformation(supported, [[-0.1, -0.1]], steps=4, max_iter=60)
    so_far = failure.value.history
    assert so_far.times.tolist() == [0, 0.25, 0.5, 0.75]
    s = 1 + so_far[-1].displacement
    np.testing.assert_allclose((s**3 - s) / 2, -0.15, atol=1e-13)
    path = cq.large_deformation(supported, [[-0.1, -0.1]], control="arc-length", steps=8, arc_length=0.1)
    (limit,) = path.limit_points
    assert 0.2 * limit.load_factor == pytest.approx(1 / np.sqrt(27), rel=1e-10)
    np.testing.assert_allclose(1 + limit.displacement, 1 / np.sqrt(3), rtol=1e-9)


def test_a_law_of_ones_own_is_taken():
    part = body("quad4", "plane-strain")
    own = NonlinearSolid(part, NeoHookean(part.material.lame_lambda, part.material.lame_mu))
    u = affine(own, stretch(2))
    assert own.energy(u) == NonlinearSolid(part).energy(u)


@pytest.mark.parametrize(
    ("kind", "model", "law", "message"),
    [
        ("quad4", "axisymmetric", "neo-hookean", "no form for the model 'axisymmetric'"),
        ("quad4", "plane-stress", "neo-hookean", "no form for the model 'plane-stress'"),
        ("quad4", "plane-strain", "ogden", "expected a law of"),
    ],
)
def test_what_has_no_form_is_refused(kind, model, law, message):
    with pytest.raises(InvalidProblem, match=message):
        NonlinearSolid(body(kind, model), law)
    with pytest.raises(InvalidProblem, match="expected a Body"):
        NonlinearSolid("block")
    with pytest.raises(InvalidProblem, match="displacement: expected shape"):
        NonlinearSolid(body("quad4", "plane-strain")).energy(np.zeros(3))
