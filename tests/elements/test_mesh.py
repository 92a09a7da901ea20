"""Meshes from arrays, their boundary and sets, and one clear refusal for everything that is wrong with a mesh."""

import numpy as np
import pytest

from contactqp.elements import mesh
from contactqp.elements.mesh import Mesh, mesh_from_arrays
from contactqp.elements.reference_elements import REFERENCES, Block, Geometry
from contactqp.elements.shapes import box, rectangle
from contactqp.errors import InvalidProblem
from tests.elements.bodies import PLANE, SOLID

#  3 - 4 - 5
#  |   |   |
#  0 - 1 - 2
POINTS = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 1.0]]
QUADS = [[0, 1, 4, 3], [1, 2, 5, 4]]


def test_the_boundary_is_what_one_element_alone_has():
    mesh = mesh_from_arrays(POINTS, {"quad4": QUADS})
    (facets,) = mesh.facets_of(mesh.boundary)
    assert sorted(facets.nodes.tolist()) == [[0, 1], [1, 2], [2, 5], [3, 0], [4, 3], [5, 4]]
    assert np.isclose(mesh.volume(), 2.0, rtol=1e-15)
    assert mesh.elements == 2


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", PLANE + SOLID)
def test_the_boundary_of_a_block_has_as_many_facets_as_its_sides(kind):
    flat = kind in PLANE
    mesh = rectangle(1.0, 1.0, (3, 2), kind) if flat else box((1.0, 1.0, 1.0), (3, 2, 2), kind)
    squares = 2 * (3 + 2) if flat else 2 * (6 + 6 + 4)
    simplex = REFERENCES[kind].linear in ("tri3", "tet4")
    assert len(mesh.boundary) == squares * (2 if simplex and not flat else 1)


def test_a_node_set_stands_for_the_facets_that_lie_in_it_wholly():
    mesh = mesh_from_arrays(
        POINTS, {"quad4": QUADS}, node_sets={"low": [2, 0, 1], "corner": [0]}, sides={"top": [[4, 5]]}
    )
    assert mesh.side("low")[0].nodes.tolist() == [[0, 1], [1, 2]]
    assert mesh.nodes("low").tolist() == [0, 1, 2]
    assert mesh.nodes("top").tolist() == [4, 5]
    assert mesh.side("top")[0].nodes.tolist() == [[5, 4]]
    with pytest.raises(InvalidProblem, match="side 'corner' has no faces: no boundary facet has all its nodes in that"):
        mesh.side("corner")
    with pytest.raises(InvalidProblem, match="there is no set 'low '; it has 'corner', 'low', 'top'"):
        mesh.nodes("low ")
    with pytest.raises(InvalidProblem, match="there is no set"):
        mesh.side("left")


@pytest.mark.parametrize("kind", SOLID)
def test_facets_are_found_by_their_corners_in_any_turn(kind):
    mesh = box((1.0, 1.0, 1.0), (2, 2, 2), kind)
    facet = REFERENCES[REFERENCES[kind].facet]
    corners = mesh.side("top")[0].nodes[:, : facet.corners]
    turned = np.random.default_rng(0).permuted(corners, axis=1)
    again = mesh_from_arrays(mesh.points, {kind: mesh.blocks[0].nodes}, sides={"up": turned})
    np.testing.assert_array_equal(again.side("up")[0].nodes, mesh.side("top")[0].nodes)


def swapped(nodes, a, b):
    nodes = [list(element) for element in nodes]
    nodes[1][a], nodes[1][b] = nodes[1][b], nodes[1][a]
    return nodes


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"elements": {"quad4": [QUADS[0], [4, 5, 2, 1]]}},
            r"element 1 \(quad4, nodes 4, 5, 2, 1\): inverted, its Jacobian is -0.25",
        ),
        ({"elements": {"quad4": swapped(QUADS, 0, 1)}}, r"element 1 \(quad4, nodes 2, 1, 5, 4\): inverted"),
        (
            {"elements": {"quad4": [*QUADS, [4, 3, 0, 1]]}},
            r"element 2 \(quad4, .*duplicate, it lies on the corners of element 0",
        ),
        (
            {"elements": {"quad4": [QUADS[0], [1, 2, 5, 2]]}},
            r"element 1 \(quad4, .*degenerate, node 2 stands in it twice",
        ),
        ({"elements": {"quad4": QUADS[:1], "tri3": [[1, 2, 0]]}}, r"element 1 \(tri3, .*degenerate, it has no area"),
        ({"elements": {"quad4": QUADS[:1]}}, r"node 2 at \(2, 0\) belongs to no element \(2 such node\(s\)\)"),
        ({"elements": {"quad4": [QUADS[0], [1, 2, 6, 4]]}}, r"element 1 \(quad4, .*expected nodes from 0 to 5"),
        ({"elements": {"quad4": np.zeros((0, 4), dtype=int)}}, "expected elements, got none"),
        ({"elements": {}}, "expected elements, got none"),
        ({"elements": {"quad5": QUADS}}, "elements: expected one of tri3, .*, got 'quad5'"),
        ({"elements": {"tri3": QUADS}}, r"tri3 elements: expected nodes of shape \(E, 3\), got \(2, 4\)"),
        ({"elements": {"quad4": np.array(QUADS) + 0.5}}, "quad4 elements: expected whole numbers, got float64"),
        ({"elements": {"tet4": QUADS}}, "mesh: tet4 elements in 2D"),
        ({"points": [[0.0]]}, r"expected points of shape \(N, 2\) or \(N, 3\), got \(1, 1\)"),
        ({"points": [*POINTS[:5], [2.0, float("inf")]]}, r"mesh: node 5 is at \[2.0, inf\]; expected finite numbers"),
        ({"node_sets": {"contact": []}}, "node set 'contact' is empty; expected at least one node"),
        ({"node_sets": {"contact": [6]}}, "node set 'contact': expected nodes from 0 to 5, got 6"),
        ({"node_sets": {"contact": [0.5]}}, "node set 'contact': expected whole numbers, got float64"),
        ({"points": [*POINTS[:5], [2.0, "one"]]}, "mesh: points: expected real numbers, got list"),
        ({"points": [*POINTS[:5], [2.0]]}, "mesh: points: expected real numbers, got list"),
        ({"points": np.array(POINTS) + 0j}, "mesh: points: expected real numbers, got ndarray .complex numbers"),
        ({"points": 1e200 * np.array(POINTS)}, r"element 0 .*: its coordinates, up to 1e\+200, are too large"),
        (
            {"elements": {"quad4": [QUADS[0], [1, 2, 5]]}},
            "quad4 elements: expected whole numbers in rows of one length",
        ),
        ({"sides": {"contact": []}}, r"side 'contact': expected facets of shape \(p, k\), p > 0, got \(0,\)"),
        ({"sides": {"contact": [[0, 1], [1, 4]]}}, "side 'contact': the facet of nodes 1, 4 is not on the boundary"),
        ({"sides": {"contact": [[0, 1, 2, 3]]}}, "side 'contact': facets of 4 nodes fit none of the mesh's elements"),
    ],
)
def test_bad_meshes_are_refused_by_name(changes, message):
    given = {"points": POINTS, "elements": {"quad4": QUADS}} | changes
    with pytest.raises(InvalidProblem, match=message):
        mesh_from_arrays(given.pop("points"), given.pop("elements"), **given)


def test_a_folded_quadrilateral_is_refused_with_the_node_where_it_folds():
    points = [*POINTS[:5], [1.2, 0.4]]  # node 5 of the second element lies inside the triangle 1 2 4
    with pytest.raises(InvalidProblem, match=r"element 1 .*inverted, its Jacobian is .*, worst near its node 5"):
        mesh_from_arrays(points, {"quad4": QUADS})


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", PLANE + SOLID)
def test_every_kind_is_refused_when_it_is_turned_inside_out(kind):
    mesh = rectangle(1.0, 1.0, (2, 2), kind) if kind in PLANE else box((1.0, 1.0, 1.0), (1, 1, 1), kind)
    with pytest.raises(InvalidProblem, match=rf"element 0 \({kind}, .*inverted"):
        mesh.mapped(lambda x: x * ([-1, 1] if kind in PLANE else [-1, 1, 1]))


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", PLANE + SOLID)
def test_every_kind_is_refused_when_it_is_flat_and_accepted_when_it_is_thin(kind):
    mesh = rectangle(1.0, 1.0, (2, 2), kind) if kind in PLANE else box((1.0, 1.0, 1.0), (1, 1, 1), kind)
    thin = np.ones(mesh.dimension)
    thin[0] = 1e-6
    mesh.mapped(lambda x: 1e-3 * x * thin)
    mesh.mapped(lambda x: x + 1e6)
    with pytest.raises(InvalidProblem, match=r"degenerate, it has no (area|volume)"):
        mesh.mapped(lambda x: x * (thin == 1))


def test_three_elements_on_one_facet_overlap():
    points = [*POINTS, [1.5, 0.5]]
    mesh = mesh_from_arrays(points, {"quad4": QUADS, "tri3": [[1, 6, 4]]})
    with pytest.raises(InvalidProblem, match="elements 0, 1, 2 share one facet; expected two at most"):
        len(mesh.boundary)


def test_middle_nodes_out_of_place_are_refused():
    """The two middles of opposite edges exchanged: every element kind would still be assembled."""
    mesh = rectangle(1.0, 1.0, (1, 1), "quad8")
    nodes = mesh.blocks[0].nodes[:, [0, 1, 2, 3, 6, 5, 4, 7]]
    with pytest.raises(InvalidProblem, match="inverted"):
        mesh_from_arrays(mesh.points, {"quad8": nodes})


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["quad8", "quad9"])
def test_an_element_that_folds_between_its_nodes_and_quadrature_points_is_refused(kind, monkeypatch):
    """Middle nodes out of place at random: det J may be positive where the stiffness looks and negative beside it."""
    reference = REFERENCES[kind]
    block = Block(reference, np.arange(len(reference.nodes))[None])
    fine = np.stack(np.meshgrid(*[np.linspace(-1, 1, 41)] * 2), axis=-1).reshape(-1, 2)
    random = np.random.default_rng(0)
    folded = []
    for _ in range(400):
        points = reference.nodes.astype(float)
        points[reference.corners :] += random.uniform(-0.6, 0.6, points[reference.corners :].shape)
        if Geometry(reference, points[None], fine).determinant.min() < -0.05:
            folded.append(points)
    for points in folded:
        with pytest.raises(InvalidProblem, match="inverted"):
            Mesh(points, (block,))
    monkeypatch.setattr(mesh, "UNEVEN", -np.inf)
    missed = 0
    for points in folded:
        try:
            Mesh(points, (block,))
        except InvalidProblem:
            continue
        missed += 1
    assert missed > 0, "some of them fold only where nothing but the lattice looks"


def test_linear_elements_beside_quadratic_ones_are_refused():
    """Else the middle node between them would hang, and a gap or an overlap open that no force resists."""
    quadratic = rectangle(1.0, 1.0, (1, 1), "quad8")
    e = quadratic.blocks[0].nodes[0]
    points = [*quadratic.points, [2.0, 0.0], [2.0, 1.0]]
    with pytest.raises(InvalidProblem, match="elements 0 and 1 share a facet, and only one of them has a middle node"):
        mesh_from_arrays(points, {"quad8": [e], "quad4": [[e[1], 8, 9, e[2]]]})
    apart = [*quadratic.points, [3.0, 0.0], [4.0, 0.0], [4.0, 1.0], [3.0, 1.0]]
    assert mesh_from_arrays(apart, {"quad8": [e], "quad4": [[8, 9, 10, 11]]}).elements == 2
    solid = box((1.0, 1.0, 1.0), (1, 1, 1), "hex20")
    top = solid.side("top")[0].nodes[0][:4]
    points = [*solid.points, *(solid.points[top] + [0.0, 0.0, 1.0])]
    with pytest.raises(InvalidProblem, match="elements 0 and 1 share a facet"):
        mesh_from_arrays(points, {"hex20": solid.blocks[0].nodes, "hex8": [[*top, 20, 21, 22, 23]]})


def test_a_side_is_a_set_of_facets():
    """A facet stated twice must not be loaded twice."""
    mesh = mesh_from_arrays(POINTS, {"quad4": QUADS}, sides={"low": [[1, 2], [0, 1], [1, 0]]})
    assert mesh.side("low")[0].nodes.tolist() == [[1, 2], [0, 1]]
    twice = mesh.with_sides({"more": np.array([[0, 0], [0, 0]])})
    assert len(twice.side("more")[0]) == 1
    for pair in ([2, 0], [-1, 0], [0, 4], [1, -1]):
        with pytest.raises(InvalidProblem, match=rf"side 'x': there is no facet {pair[1]} of an element {pair[0]}"):
            mesh.with_sides({"x": np.array([[0, 0], pair])})


@pytest.mark.parametrize("point", [[np.nan, 0.0], [0.0], [0.0, 0.0, 0.0], ["a", "b"], 1.0])
def test_the_nearest_node_of_no_point(point):
    mesh = mesh_from_arrays(POINTS, {"quad4": QUADS})
    with pytest.raises(InvalidProblem, match="point: expected"):
        mesh.nearest(point)


def test_the_nearest_node_and_other_coordinates():
    mesh = mesh_from_arrays(POINTS, {"quad4": QUADS}, sides={"top": [[4, 5], [3, 4]]})
    assert mesh.nearest((1.9, 0.7)) == 5
    turned = mesh.mapped(lambda x: x @ np.array([[0.0, 1.0], [-1.0, 0.0]]))
    np.testing.assert_allclose(turned.points[turned.nodes("top"), 0], -1.0)
    assert np.isclose(turned.volume(), mesh.volume())
