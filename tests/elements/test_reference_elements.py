"""Reference elements and quadrature: exact integrals, polynomials reproduced, facets turned outward, VTK's order."""

import itertools
from math import factorial

import numpy as np
import pytest

from contactqp.elements.reference_elements import KINDS, REFERENCES, at_rule, gauss, tetrahedron, triangle
from tests.elements.bodies import distorted

ALL = list(REFERENCES)
SIMPLEX_RULES = [(triangle, 1, 1), (triangle, 3, 2), (triangle, 6, 4)]
SIMPLEX_RULES += [(tetrahedron, 1, 1), (tetrahedron, 4, 2), (tetrahedron, 8, 3), (tetrahedron, 15, 5)]


def _errors(rule, degree):
    """Of all monomials of that degree over the unit simplex: prod(p_a!) / (d + sum p)!."""
    d = rule.points.shape[1]
    for powers in itertools.product(range(degree + 1), repeat=d):
        if sum(powers) == degree:
            exact = np.prod([factorial(p) for p in powers]) / factorial(d + degree)
            yield abs(np.prod(rule.points**powers, axis=1) @ rule.weights - exact)


@pytest.mark.parametrize(("family", "points", "degree"), SIMPLEX_RULES)
def test_rules_on_simplices_are_exact_to_their_degree_and_no_further(family, points, degree):
    rule = family(points)
    assert len(rule.weights) == points
    assert rule.weights.min() > 0
    assert rule.points.min() > 0
    assert rule.points.sum(axis=1).max() < 1
    for lower in range(degree + 1):
        assert max(_errors(rule, lower)) < 1e-16
    assert max(_errors(rule, degree + 1)) > 1e-6


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("order", [2, 3])
def test_gauss_is_exact_to_degree_2n_minus_1_in_each_coordinate(order, dimension):
    rule = gauss(order, dimension)
    for power in range(2 * order):
        exact = (0 if power % 2 else 2 / (power + 1)) ** dimension
        assert np.isclose(np.prod(rule.points**power, axis=1) @ rule.weights, exact, rtol=1e-15, atol=1e-15)
    assert not np.isclose(rule.points[:, 0] ** (2 * order) @ rule.weights, 2**dimension / (2 * order + 1))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", ALL)
def test_shape_functions_are_one_at_their_node_and_zero_at_the_others(name):
    kind = REFERENCES[name]
    np.testing.assert_array_equal(kind.shape(kind.nodes), np.eye(len(kind.nodes)))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", ALL)
def test_gradients_are_those_of_the_shape_functions(name):
    kind = REFERENCES[name]
    x, step = np.random.default_rng(1).uniform(0, 0.3, (5, kind.dimension)), 1e-6
    for axis in range(kind.dimension):
        e = step * np.eye(kind.dimension)[axis]
        slope = (kind.shape(x + e) - kind.shape(x - e)) / (2 * step)
        assert abs(slope).max() > 0.1
        np.testing.assert_allclose(kind.gradient(x)[..., axis], slope, atol=1e-9)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", ALL)
def test_every_complete_polynomial_of_the_degree_is_reproduced(name):
    kind = REFERENCES[name]
    degree = 1 if len(kind.nodes) == kind.corners else 2
    x = np.random.default_rng(2).uniform(0, 0.3, (4, kind.dimension))
    for powers in itertools.product(range(degree + 1), repeat=kind.dimension):
        if sum(powers) <= degree:
            nodal = np.prod(kind.nodes**powers, axis=1)
            np.testing.assert_allclose(kind.shape(x) @ nodal, np.prod(x**powers, axis=1), atol=1e-15)


# VTK file formats, figures of the quadratic cells: between which corners each node after the corners lies.
VTK_MIDDLES = {
    "tri6": ["01", "12", "02"],
    "quad8": ["01", "12", "23", "03"],
    "quad9": ["01", "12", "23", "03", "0123"],
    "tet10": ["01", "12", "02", "03", "13", "23"],
    "hex20": ["01", "12", "23", "03", "45", "56", "67", "47", "04", "15", "26", "37"],
    "hex27": ["01", "12", "23", "03", "45", "56", "67", "47", "04", "15", "26", "37",
              "0347", "1256", "0145", "2367", "0123", "4567", "01234567"],
}  # fmt: skip


@pytest.mark.parametrize("name", VTK_MIDDLES)
def test_nodes_stand_in_the_order_of_vtk(name):
    kind = REFERENCES[name]
    middles = [kind.nodes[[int(c) for c in corners]].mean(axis=0) for corners in VTK_MIDDLES[name]]
    np.testing.assert_array_equal(kind.nodes[kind.corners :], middles)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", KINDS)
def test_facets_enclose_the_element_and_point_out_of_it(name):
    """The divergence theorem on a distorted mesh: the integral of n is 0, that of x.n is d times the volume."""
    mesh = distorted(name)
    total, flux = np.zeros(mesh.dimension), 0.0
    for block in mesh.facets_of(mesh.boundary):
        geometry = at_rule(block, mesh.points, block.kind.fine_rule)
        n = geometry.normal * block.kind.fine_rule.weights[:, None]
        total += n.sum(axis=(0, 1))
        flux += float((geometry.positions * n).sum())
    assert np.abs(total).max() < 1e-13
    assert np.isclose(flux, mesh.dimension * mesh.volume(), rtol=1e-13)
    assert mesh.volume() > 0.5


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", KINDS)
def test_facets_list_corners_then_middles_between_them_then_the_centre(name):
    kind = REFERENCES[name]
    facet = REFERENCES[kind.facet]
    assert kind.facets
    for nodes in kind.facets:
        assert len(nodes) == len(facet.nodes)
        corners = kind.nodes[list(nodes[: facet.corners])]
        flat = REFERENCES[facet.linear].shape(facet.nodes) @ corners
        np.testing.assert_array_equal(kind.nodes[list(nodes)], flat)
