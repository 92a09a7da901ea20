"""The stiffness and the stresses of elastic bodies: patch tests, rigid motions, symmetry, and scikit-fem's own matrix.

Stresses are exact for uniform and for linear fields.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from contactqp.elements import reference_elements
from contactqp.elements.material import Material
from contactqp.elements.mesh import mesh_from_arrays
from contactqp.elements.mesh_files import mesh_from_skfem
from contactqp.elements.reference_elements import REFERENCES, Geometry
from contactqp.elements.shapes import ball, box, disc, rectangle
from contactqp.elements.solid import Body, assemble, pattern, stress_at_nodes, stress_in, von_mises
from contactqp.errors import InvalidProblem
from tests.elements.bodies import MODELS, STEEL, body, distorted

GRADIENTS = {2: np.array([[1.0, 0.4], [-0.3, 0.7]]), 3: np.array([[1.0, 0.4, 0.2], [-0.3, 0.7, 0.5], [0.1, -0.6, 0.9]])}


def stress_at_quadrature(b, u):
    """Return positions (E, q, d) and stresses (E, q, 6) at the points of the stiffness, block by block."""
    found = []
    for block in b.mesh.blocks:
        geometry = Geometry(block.kind, b.mesh.points[block.nodes], b.stiffness_rule(block).points)
        found.append(SimpleNamespace(positions=geometry.positions, stress=stress_in(b, block, geometry, u)))
    return found


def constant_strain(b):
    """u of a constant strain that is in equilibrium without body forces, and its stress."""
    x = b.mesh.points
    gradient = np.diag([0.8, -0.5]) if b.model == "axisymmetric" else GRADIENTS[b.dimension]
    u = x @ gradient.T
    full = np.zeros((3, 3))
    full[: b.dimension, : b.dimension] = (gradient + gradient.T) / 2
    if b.model == "axisymmetric":
        full[2, 2] = gradient[0, 0]
    E, nu = b.material.modulus, b.material.poisson
    if b.model == "plane-stress":
        full[2, 2] = -nu / (1 - nu) * np.trace(full)
    s = E / (1 + nu) * (full + nu / (1 - 2 * nu) * np.trace(full) * np.eye(3))
    return u.ravel(), np.array([s[0, 0], s[1, 1], s[2, 2], s[0, 1], s[1, 2], s[0, 2]])


def patch_error(b, K):
    """The interior displacements that K finds when the boundary is moved as constant strain asks, against the exact."""
    u, _ = constant_strain(b)
    held = np.zeros(b.mesh.points.shape, dtype=bool)
    for block in b.mesh.facets_of(b.mesh.boundary):
        held[block.nodes] = True
    held = held.ravel()
    K = sp.csr_array(K)
    found = spla.spsolve(sp.csc_array(K[~held][:, ~held]), -K[~held][:, held] @ u[held])
    assert (~held).sum() >= b.dimension
    return np.abs(found - u[~held]).max() / np.abs(u).max()


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("kind", "model"), MODELS)
def test_a_constant_strain_is_exact_on_a_distorted_mesh(kind, model):
    b = Body(distorted(kind, 3 if kind in ("tri3", "tet4") else 2), STEEL, model)
    assert patch_error(b, b.stiffness) < 1e-12
    u, stress = constant_strain(b)
    for points in stress_at_quadrature(b, u):
        np.testing.assert_allclose(points.stress, np.broadcast_to(stress, points.stress.shape), atol=1e-11)


def test_the_patch_test_fails_a_stiffness_that_is_slightly_wrong():
    """One element with its shape functions in the wrong places is enough."""
    b = Body(distorted("quad4"), STEEL, "plane-strain")
    where = pattern([b.mesh.blocks[0].nodes], len(b.mesh.points))
    K = b.element_stiffness(b.mesh.blocks[0])
    K[0] = K[1]
    entries = K.reshape(-1, 4, 2, 4, 2).transpose(2, 4, 0, 1, 3).reshape(2, 2, -1)
    assert patch_error(b, assemble(where, entries)) > 1e-3


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("kind", "model"), MODELS)
def test_the_stiffness_is_symmetric_to_the_last_digit_and_only_rigid_motions_cost_nothing(kind, model):
    b = body(kind, model)
    K = b.stiffness
    assert K.format == "csc"
    assert K.indices.dtype == np.int32
    assert abs(K - K.T).max() == 0
    R = b.rigid_motions()
    assert abs(K @ R).max() < 1e-13 * abs(K).max() * abs(R).max()
    eigenvalues = np.linalg.eigvalsh(K.toarray())
    rigid = R.shape[1]
    assert rigid == {"3d": 6, "axisymmetric": 1}.get(model, 3)
    assert np.linalg.matrix_rank(R) == rigid
    assert abs(eigenvalues[:rigid]).max() < 1e-13 * eigenvalues[-1]
    assert eigenvalues[rigid] > 1e-5 * eigenvalues[-1]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("kind", "model"), MODELS)
def test_the_internal_forces_are_those_of_the_stresses(kind, model):
    """u'K u is the integral of stress times strain: B in the stiffness, and displacement gradients in the stresses."""
    b = body(kind, model)
    u = np.random.default_rng(3).standard_normal(b.size)
    work = 0.0
    for block, points in zip(b.mesh.blocks, stress_at_quadrature(b, u), strict=True):
        _, weights = b.integration(block, b.stiffness_rule(block))
        s = points.stress
        nu, E = b.material.poisson, b.material.modulus
        normal, shear = s[..., :3], s[..., 3:]
        density = ((1 + nu) * (normal**2).sum(-1) - nu * normal.sum(-1) ** 2 + 2 * (1 + nu) * (shear**2).sum(-1)) / E
        work += float((density * weights).sum())
    assert np.isclose(u @ b.stiffness @ u, work, rtol=1e-12)


def test_thickness_scales_the_stiffness_and_axial_symmetry_has_the_full_circle():
    mesh = distorted("quad4")
    thin, thick = Body(mesh, STEEL, "plane-stress"), Body(mesh, STEEL, "plane-stress", thickness=3.0)
    np.testing.assert_allclose(thick.stiffness.toarray(), 3 * thin.stiffness.toarray(), rtol=1e-14)
    ring = Body(rectangle(0.5, 1.0, (1, 1), corner=(2.0, 0.0)), STEEL, "axisymmetric")
    stretch = np.tile([0.0, 1.0], 4) * np.repeat(ring.mesh.points[:, 1], 2)
    force = ring.stiffness @ stretch
    volume = np.pi * (2.5**2 - 2.0**2)
    strain_energy = STEEL.constitutive("axisymmetric")[1, 1] * volume
    assert np.isclose(stretch @ force, strain_energy, rtol=1e-13)


def test_elements_of_several_kinds_share_a_body():
    """Two squares, one of them cut into triangles: constant strain across the interface."""
    points = [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1.2], [2, 1], [1, 0.5]]
    elements = {"quad4": [[1, 2, 5, 4]], "tri3": [[0, 1, 3], [1, 4, 3]]}
    mesh = mesh_from_arrays(points[:6], elements, sides={"bottom": [[0, 1], [1, 2]]})
    b = Body(mesh, STEEL, "plane-strain")
    u, stress = constant_strain(b)
    for found in stress_at_quadrature(b, u):
        np.testing.assert_allclose(found.stress, np.broadcast_to(stress, found.stress.shape), atol=1e-12)
    internal = (b.stiffness @ u).reshape(-1, 2)
    assert abs(internal.sum(axis=0)).max() < 1e-12
    assert abs(b.stiffness - b.stiffness.T).max() == 0
    assert b.surface("bottom").facets.tolist() == [[1, 2], [0, 1]]


def skfem_stiffness(mesh, element, rule, b):
    """scikit-fem's linear elasticity with our quadrature points, in our order of unknowns."""
    skfem = pytest.importorskip("skfem")
    from scipy.spatial import cKDTree
    from skfem.models.elasticity import lame_parameters, linear_elasticity

    unit = not b.mesh.blocks[0].kind.linear.startswith(("quad", "hex"))
    X, W = (rule.points, rule.weights) if unit else ((rule.points + 1) / 2, rule.weights / 2**b.dimension)
    basis = skfem.Basis(mesh, skfem.ElementVector(element), quadrature=(X.T, W))
    E, nu = b.material.modulus, b.material.poisson
    lame = lame_parameters(E, nu)
    if b.model == "plane-stress":
        lame = (2 * lame[0] * lame[1] / (lame[0] + 2 * lame[1]), lame[1])
    distance, node = cKDTree(b.mesh.points).query(basis.doflocs.T)
    assert distance.max() < 1e-12
    order = np.argsort(node, kind="stable")
    return linear_elasticity(*lame).assemble(basis)[order][:, order]


SKFEM = [
    ("MeshTri", "ElementTriP1", "plane-strain"),
    ("MeshTri2", "ElementTriP2", "plane-stress"),
    ("MeshQuad", "ElementQuad1", "plane-stress"),
    ("MeshQuad2", "ElementQuad2", "plane-strain"),
    ("MeshTet", "ElementTetP1", "3d"),
    ("MeshTet2", "ElementTetP2", "3d"),
    ("MeshHex", "ElementHex1", "3d"),
    ("MeshHex2", "ElementHex2", "3d"),
]


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("mesh", "element", "model"), SKFEM)
def test_the_stiffness_is_scikit_fems_on_the_same_distorted_mesh(mesh, element, model):
    skfem = pytest.importorskip("skfem")
    theirs = getattr(skfem, mesh)().refined(1)
    random = np.random.default_rng(5)
    moved = theirs.doflocs + random.uniform(-0.03, 0.03, theirs.doflocs.shape)
    theirs = type(theirs)(moved, theirs.t)
    b = Body(mesh_from_skfem(theirs), STEEL, model)
    block = b.mesh.blocks[0]
    K = skfem_stiffness(theirs, getattr(skfem, element)(), block.kind.rule, b)
    assert abs(K - b.stiffness).max() < 1e-12 * abs(K).max()
    softer = Body(b.mesh, Material(modulus=210.0, poisson=0.29), model)
    assert abs(K - softer.stiffness).max() > 1e-3 * abs(K).max()


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("mesh", "element", "kind"), [("MeshQuad", "ElementQuadS2", "quad8"), ("MeshHex", "ElementHexS2", "hex20")]
)
def test_serendipity_elements_are_scikit_fems(mesh, element, kind):
    skfem = pytest.importorskip("skfem")
    theirs = getattr(skfem, mesh)().refined(1)
    theirs = type(theirs)(theirs.p + np.random.default_rng(5).uniform(-0.05, 0.05, theirs.p.shape), theirs.t)
    serendipity = getattr(skfem, element)()
    basis = skfem.Basis(theirs, serendipity)
    unit = (REFERENCES[kind].nodes + 1) / 2
    if kind == "hex20":
        unit = unit[:, [1, 0, 2]]  # scikit-fem's hexahedra are left-handed
    place = [int(np.argmin(abs(serendipity.doflocs - x).max(axis=1))) for x in unit]
    b = Body(
        mesh_from_arrays(basis.doflocs.T, {kind: basis.element_dofs[place].T}),
        STEEL,
        "3d" if kind == "hex20" else "plane-strain",
    )
    K = skfem_stiffness(theirs, serendipity, REFERENCES[kind].rule, b)
    assert abs(K - b.stiffness).max() < 1e-12 * abs(K).max()


def test_the_work_of_assembly_grows_with_the_entries_only():
    """Duplicates are summed: no more entries than pairs of nodes that share an element."""
    b = Body(box((1.0, 1.0, 1.0), (4, 4, 4)), STEEL, "3d")
    line = 3 * 5 - 2  # neighbours of 5 nodes on a line, themselves included
    assert b.stiffness.nnz == 9 * line**3


def test_batches_of_elements_change_nothing(monkeypatch):
    mesh = distorted("hex8", 3)
    whole = Body(mesh, STEEL, "3d").stiffness
    monkeypatch.setattr(reference_elements, "BATCH", 10 * 8 * 6 * 24)  # ten elements at a time, and seven at last
    assert abs(Body(mesh, STEEL, "3d").stiffness - whole).max() == 0
    nodes = mesh.blocks[0].nodes.copy()
    nodes[25] = nodes[25][[4, 5, 6, 7, 0, 1, 2, 3]]
    with pytest.raises(InvalidProblem, match=r"element 25 \(hex8, .*inverted"):
        mesh_from_arrays(mesh.points, {"hex8": nodes})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "3d"}, "block: a 2D mesh and the model '3d'"),
        ({"model": "plane"}, "block: model: expected one of 'plane-strain'"),
        ({"material": None}, "block: material: expected a Material, got None"),
        ({"mesh": None}, "block: mesh: expected a Mesh, got None"),
        ({"thickness": "1 mm"}, "block: thickness: expected a number"),
        ({"thickness": 0.0}, "block: expected a positive thickness, got 0.0"),
        ({"thickness": float("nan")}, "positive thickness"),
        ({"model": "axisymmetric", "thickness": 2.0}, "the model 'axisymmetric' has no thickness, got 2.0"),
    ],
)
def test_bodies_that_do_not_fit_are_refused(options, message):
    given = {"mesh": rectangle(1.0, 1.0, (1, 1)), "material": STEEL, "model": "plane-strain", "name": "block"} | options
    with pytest.raises(InvalidProblem, match=message):
        Body(**given)


def test_a_negative_radius_is_refused():
    with pytest.raises(InvalidProblem, match=r"expected radii x >= 0, got -1 at node"):
        Body(disc(1.0, (1, 1)), STEEL, "axisymmetric")


def test_a_side_of_two_kinds_of_facet_is_no_surface():
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1], [0.5, 0.5, 2]]
    hexahedron = [0, 1, 2, 3, 4, 5, 6, 7]
    mesh = mesh_from_arrays(
        points, {"hex8": [hexahedron], "tet4": [[4, 5, 7, 8], [5, 6, 7, 8]]}, node_sets={"all": range(9)}
    )
    with pytest.raises(InvalidProblem, match=r"body: side 'all' has facets of several kinds \(quad4, tri3\)"):
        Body(mesh, STEEL, "3d").surface("all")


def test_a_surface_is_numbered_with_the_unknowns_of_its_body_and_points_outward():
    b = Body(ball(2.0, (2, 2), part="half"), STEEL, "3d", name="indenter")
    surface = b.surface("sphere", first=100)
    assert surface.name == "indenter.sphere"
    np.testing.assert_array_equal(surface.unknowns[5], [115, 116, 117])
    x = surface.points[surface.facets]
    normal = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
    assert ((normal * x.mean(axis=1)).sum(axis=1) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(surface.points[surface.nodes], axis=1), 2.0, rtol=1e-15)


E, NU = STEEL.modulus, STEEL.poisson


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("kind", "model"), MODELS)
def test_a_uniform_stress_is_exact_at_the_nodes_of_a_distorted_mesh(kind, model):
    b = body(kind, model)
    u, stress = constant_strain(b)
    np.testing.assert_allclose(stress_at_nodes(b, u), np.tile(stress, (len(b.mesh.points), 1)), atol=1e-11)


def bending(x):
    """Pure bending in plane stress, sigma_xx = E y: u = (x y, -x^2/2 - nu y^2/2); uniform in a third direction."""
    X, Y = x[:, 0], x[:, 1]
    return np.column_stack([X * Y, -(X**2) / 2 - NU * Y**2 / 2])


@pytest.mark.parametrize("kind", ["tri6", "quad8", "quad9"])
def test_bending_is_exact_with_quadratic_elements(kind):
    b = Body(rectangle(3.0, 1.0, (2, 2), kind, corner=(0.0, -0.5)), STEEL, "plane-stress")
    expected = np.zeros((len(b.mesh.points), 6))
    expected[:, 0] = E * b.mesh.points[:, 1]
    np.testing.assert_allclose(stress_at_nodes(b, bending(b.mesh.points).ravel()), expected, atol=1e-11)
    (points,) = stress_at_quadrature(b, bending(b.mesh.points).ravel())
    np.testing.assert_allclose(points.stress[..., 0], E * points.positions[..., 1], atol=1e-11)
    assert np.abs(points.stress[..., 1:]).max() < 1e-11


@pytest.mark.parametrize("kind", ["tet10", "hex20", "hex27"])
def test_bending_in_space_is_exact_with_quadratic_elements(kind):
    """Timoshenko & Goodier 1970, art. 102: sigma_xx = E y, anticlastic."""
    b = Body(box((2.0, 1.0, 1.0), (2, 1, 1), kind, corner=(0.0, -0.5, -0.5)), STEEL, "3d")
    x, y, z = b.mesh.points.T
    u = np.column_stack([x * y, -(x**2) / 2 - NU * (y**2 - z**2) / 2, -NU * y * z])
    expected = np.zeros((len(b.mesh.points), 6))
    expected[:, 0] = E * y
    np.testing.assert_allclose(stress_at_nodes(b, u.ravel()), expected, atol=1e-10)


def test_von_mises_is_root_three_times_pure_shear_and_blind_to_pressure():
    shear = np.array([0, 0, 0, 2.0, 0, 0])
    assert np.isclose(von_mises(shear), 2 * np.sqrt(3))
    np.testing.assert_allclose(von_mises([shear + np.array([p, p, p, 0, 0, 0]) for p in (1.0, -7.0)]), 2 * np.sqrt(3))
    turned = np.array([2.0, -2.0, 0, 0, 0, 0])  # the same shear in axes turned by 45 degrees
    assert np.isclose(von_mises(turned), von_mises(shear))


def test_a_displacement_of_another_length_is_refused():
    b = Body(rectangle(1.0, 1.0, (1, 1)), STEEL, "plane-strain", name="block")
    with pytest.raises(InvalidProblem, match=r"block: expected a displacement of shape \(8,\), got \(6,\)"):
        stress_at_nodes(b, np.zeros(6))
