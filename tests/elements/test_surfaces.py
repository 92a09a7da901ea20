"""Facets, what belongs to their nodes, and which surfaces are refused."""

from dataclasses import replace

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements import surface
from contactqp.elements.nodal_pressure import node_normals, tributary_areas
from contactqp.elements.node_to_segment import closest_point
from contactqp.elements.surface import kind_of, triangle_quadrature
from contactqp.errors import InvalidProblem

KINDS = list(surface.KINDS.values())
SQUARE = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 3.0, 0.0], [0.0, 3.0, 0.0]])


def surface(points, facets, name="side"):
    points = np.asarray(points, dtype=float)
    return cq.Surface(points, np.array(facets), np.arange(points.size).reshape(points.shape), name)


def one_facet(kind, affine=None):
    """The reference element itself, in the plane z = 0."""
    d = kind.nodes.shape[1] + 1
    points = np.zeros((len(kind.nodes), d))
    points[:, : d - 1] = kind.nodes
    return surface(points if affine is None else points @ affine.T, [np.arange(len(points))])


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_shape_functions_are_one_at_their_node_and_sum_to_one(kind):
    np.testing.assert_allclose(kind.shape(kind.nodes), np.eye(len(kind.nodes)), atol=1e-14)
    xi = np.random.default_rng(0).uniform(-1, 1, (7, kind.nodes.shape[1]))
    np.testing.assert_allclose(kind.shape(xi).sum(axis=1), 1, atol=1e-14)


@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_derivatives_are_differences(kind):
    xi, h = np.random.default_rng(0).uniform(-1, 1, (7, kind.nodes.shape[1])), 1e-6
    for a, e in enumerate(np.eye(xi.shape[1])):
        slope = (kind.shape(xi + h * e) - kind.shape(xi - h * e)) / (2 * h)
        np.testing.assert_allclose(kind.derivatives(xi)[:, :, a], slope, atol=1e-9)
        bend = (kind.derivatives(xi + h * e) - kind.derivatives(xi - h * e)) / (2 * h)
        np.testing.assert_allclose(kind.second_derivatives(xi)[:, :, :, a], bend, atol=1e-9)


def test_the_triangle_rule_is_exact_to_its_degree():
    """int xi^a eta^b = a! b! / (a + b + 2)!."""
    xi, w = triangle_quadrature(3)
    exact = {(0, 0): 1 / 2, (1, 0): 1 / 6, (2, 2): 4 / 720, (3, 1): 6 / 720, (0, 4): 24 / 720}
    for (a, b), value in exact.items():
        assert np.isclose(w @ (xi[:, 0] ** a * xi[:, 1] ** b), value, rtol=1e-13)
    assert not np.isclose(w @ xi[:, 0] ** 6, 720 / 40320, rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("line2", [1 / 2] * 2),
        ("line3", [1 / 6, 1 / 6, 4 / 6]),
        ("tri3", [1 / 3] * 3),
        ("tri6", [3 / 57] * 3 + [16 / 57] * 3),
        ("quad4", [1 / 4] * 4),
        ("quad8", [3 / 76] * 4 + [16 / 76] * 4),
        ("quad9", [1 / 36] * 4 + [4 / 36] * 4 + [16 / 36]),
    ],
)
def test_tributary_areas_of_undistorted_facets(name, parts):
    """The integrals of the shape functions; Hinton, Rock and Zienkiewicz' where those are not positive."""
    kind = next(k for k in KINDS if k.name == name)
    area = {"line": 2, "tri": 1 / 2, "quad": 4}[name.rstrip("0123456789")]
    np.testing.assert_allclose(tributary_areas(one_facet(kind)), area * np.array(parts), rtol=1e-13)
    if kind.nodes.shape[1] == 2:
        turned = one_facet(kind, np.array([[2.0, 1, 0], [0, 3, 0], [2, 0, 1]]))
        scale = np.linalg.norm(np.cross([2, 0, 2], [1, 3, 0]))
        np.testing.assert_allclose(tributary_areas(turned), scale * area * np.array(parts), rtol=1e-13)


def test_the_areas_of_curved_facets_sum_to_the_arc():
    """Quadratic lines on a circle: the length converges as h^4."""
    error = []
    for n in (4, 8, 16):
        angle = np.linspace(0, 2 * np.pi, 2 * n + 1)[:-1]
        k = 2 * np.arange(n)
        ring = surface(
            np.stack([np.cos(angle), np.sin(angle)], axis=1), np.stack([k, (k + 2) % (2 * n), k + 1], axis=1)
        )
        error.append(abs(tributary_areas(ring).sum() - 2 * np.pi))
        np.testing.assert_allclose(node_normals(ring), ring.points, atol=1e-12)
    orders = np.log2(np.array(error[:-1]) / error[1:])
    assert (orders > 3.8).all()
    assert error[-1] < 2e-4


def test_a_pressure_is_a_force_over_an_area():
    side = surface(SQUARE, [[3, 2, 1, 0]])
    pairing = cq.pair(side, cq.Plane(point=[0.0, 0.0, -1.0], normal=[0.0, 0.0, 1.0]))
    np.testing.assert_allclose(pairing.area, 1.5, rtol=1e-14)
    np.testing.assert_allclose(pairing.pressure([3.0, 3.0, 3.0, 3.0]), 2.0, rtol=1e-14)
    assert pairing.nodes.tolist() == [0, 1, 2, 3]
    assert pairing.unpaired.size == 0
    E_N, g, E_T = pairing
    assert (E_N.shape, g.tolist(), E_T.shape) == ((4, 12), [1.0] * 4, (8, 12))
    with pytest.raises(InvalidProblem, match="normal_force: expected shape"):
        pairing.pressure([1.0])
    with pytest.raises(InvalidProblem, match="points have no area"):
        cq.pair(SQUARE, cq.Plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])).pressure(np.ones(4))
    with pytest.raises(InvalidProblem, match="the surface has its own"):
        cq.pair(side, cq.Plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0]), unknowns=side.unknowns)
    with pytest.raises(InvalidProblem, match="expected numbers from 0 to 10"):
        cq.pair(side, cq.Plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0]), dimension=11)


def test_only_the_nodes_of_the_surface_are_paired_in_ascending_order():
    points = np.array([[0.0, 9.0], [2.0, 0.0], [5.0, 5.0], [1.0, 0.0], [0.0, 0.0]])
    pairing = cq.pair(surface(points, [[3, 1], [4, 3]]), cq.Plane(point=[0.0, -1.0], normal=[0.0, 1.0]))
    assert pairing.nodes.tolist() == [1, 3, 4]
    assert pairing.points.tolist() == [[2.0, 0.0], [1.0, 0.0], [0.0, 0.0]]
    np.testing.assert_allclose(pairing.area, [0.5, 1.0, 0.5], rtol=1e-14)
    assert pairing.normal.shape == (3, 10)
    assert pairing.normal.toarray()[:, [3, 7, 9]].tolist() == [[-1, 0, 0], [0, -1, 0], [0, 0, -1]]


def test_a_hole_that_fits_has_no_gap():
    angle = np.linspace(0, 2 * np.pi, 9)[:-1]
    shaft = surface(2 * np.stack([np.cos(angle), np.sin(angle)], axis=1), [[i, (i + 1) % 8] for i in range(8)])
    pairing = cq.pair(shaft, cq.Circle([0.0, 0.0], 2.0, inside=True))
    np.testing.assert_allclose(pairing.gap, 0, atol=1e-15)
    np.testing.assert_allclose(pairing.direction, -shaft.points / 2, atol=1e-15)


QUAD = np.array([[0, 1, 2, 3]])
FOLDED = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.2, 0.2, 0.0], [0.0, 1.0, 0.0]]


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (lambda: surface(SQUARE, np.zeros((0, 4), dtype=int)), "side: facets: expected shape .* at least one facet"),
        (lambda: surface(SQUARE, [[0, 1, 2, 7]]), "facet 0: expected nodes from 0 to 3, got 7"),
        (lambda: surface(SQUARE, [[0, 1, 2, 3], [0, 1, 2, -1]]), "facet 1: expected nodes from 0 to 3, got -1"),
        (lambda: surface(SQUARE, [[0.0, 1.0, 2.0]]), "facets: expected whole numbers"),
        (lambda: surface(SQUARE, [[0, 1, 2, 2]]), r"facet 0 \(nodes \[0, 1, 2, 2\]\) is degenerate or folded"),
        (lambda: surface(SQUARE, [[0, 1, 2], [0, 1, 1]]), "facet 1 .* is degenerate"),
        (lambda: surface(FOLDED, [[0, 1, 2, 3]]), "degenerate or folded"),
        (lambda: surface(SQUARE, [[0, 1, 3, 2]]), "degenerate or folded"),
        (lambda: surface(SQUARE, [[0, 1]]), "no facet has 2 nodes in 3 dimensions; known are"),
        (lambda: surface(SQUARE[:, :1], [[0, 1]]), "points: expected shape"),
        (lambda: surface(SQUARE * [1, 1, np.nan], [[0, 1, 2, 3]]), "node 0: expected finite coordinates"),
        (
            lambda: cq.Surface(SQUARE, np.array([[0, 1, 2, 3]]), np.arange(8).reshape(4, 2)),
            "surface: unknowns: expected shape",
        ),
        (
            lambda: cq.Surface(SQUARE, np.array([[0, 1, 2, 3]]), -np.ones((4, 3), dtype=int)),
            "node 0: expected unknowns from 0",
        ),
    ],
)
def test_surfaces_that_are_none_are_refused(broken, message):
    with pytest.raises(InvalidProblem, match=message):
        cq.pair(broken(), cq.Plane(point=[0.0, 0.0, -1.0], normal=[0.0, 0.0, 1.0]))


def test_a_middle_node_off_the_middle_is_refused():
    line = surface([[0.0, 0.0], [1.0, 0.0], [0.8, 0.0]], [[0, 1, 2]])
    with pytest.raises(InvalidProblem, match=r"facet 0 .* is degenerate or folded"):
        cq.pair(line, cq.Plane(point=[0.0, 0.0], normal=[0.0, 1.0]))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("kind", KINDS, ids=lambda k: k.name)
def test_the_closest_point_is_the_least_of_a_fine_sample(kind):
    rng = np.random.default_rng(7)
    d = kind.nodes.shape[1] + 1
    base = one_facet(kind).points
    q = 40
    positions = base + 0.15 * rng.uniform(-1, 1, (q, *base.shape))
    x = rng.uniform(-1.3, 1.3, (q, d)) * ([1.0] * (d - 1) + [0.5])
    foot = closest_point(kind, positions, x)
    s = np.linspace(-1, 1, 20001 if d == 2 else 151)
    grid = np.stack(np.meshgrid(*[s] * (d - 1), indexing="ij"), axis=-1).reshape(-1, d - 1)
    shape = kind.shape(grid[kind.inside(grid, 0.0)])
    for i in range(q):
        least = np.linalg.norm(x[i] - shape @ positions[i], axis=1).min()
        assert foot.distance[i] <= least + 1e-12
        assert foot.distance[i] >= least - 3e-2
    assert kind.inside(foot.xi, 1e-9).all()
    np.testing.assert_allclose(np.einsum("qk,qkd->qd", kind.shape(foot.xi), positions), foot.position, atol=1e-13)


def test_kinds_are_told_by_dimension_and_nodes():
    assert kind_of(surface(SQUARE, [[0, 1, 2, 3]])).name == "quad4"


@pytest.mark.parametrize("nodes", [2, 3])
def test_revolved_areas_are_those_of_rings(nodes):
    """A disc of radius 2: all areas positive, and 4 pi in all; to the axis belongs a third of the first line2."""
    r = np.linspace(0, 2, 3 if nodes == 2 else 5)
    points = np.column_stack([r, np.zeros(len(r))])
    facets = np.array([[0, 1], [1, 2]]) if nodes == 2 else np.array([[0, 2, 1], [2, 4, 3]])
    surface = cq.Surface(points, facets, np.arange(2 * len(r)).reshape(-1, 2))
    areas = tributary_areas(replace(surface, revolved=True))
    assert areas.min() > 0
    np.testing.assert_allclose(areas.sum(), 4 * np.pi, rtol=1e-13)
    if nodes == 2:
        np.testing.assert_allclose(areas[0], np.pi / 3, rtol=1e-13)


@pytest.mark.parametrize("unit", [1e80, 1e-80])
def test_lengths_whose_areas_have_no_square_are_refused_with_the_cure(unit):
    side = surface(SQUARE * unit, [[0, 1, 2, 3]])
    with pytest.raises(InvalidProblem, match=r"side: facet 0 .*from 1e-75 to 1e\+75, got .*another unit of length"):
        cq.pair_mortar(side, side)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("unit", [2.0**240, 2.0**-240])
def test_pairs_are_the_same_in_other_units(unit):
    def pairs(unit):
        other = SQUARE[::-1] - [0, 0, 0.1]
        slave = surface(SQUARE[::-1] * unit, [[0, 1, 2, 3]], "slave")
        master = cq.Surface(other[::-1] * unit, np.array([[0, 1, 2, 3]]), np.arange(12, 24).reshape(4, 3), "master")
        return [f(slave, master) for f in (cq.pair_mortar, cq.pair_node_to_segment)]

    for one, other in zip(pairs(1.0), pairs(unit), strict=True):
        assert len(one.gap) == 4
        assert one.gap == pytest.approx(0.1)
        np.testing.assert_allclose(other.gap / unit, one.gap, rtol=1e-12)
        np.testing.assert_allclose(other.normal.toarray(), one.normal.toarray(), rtol=0, atol=1e-12)
