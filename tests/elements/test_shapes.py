"""Built-in shapes: areas and volumes converge, nothing is inverted, sides are where they should be."""

import numpy as np
import pytest

from contactqp.elements import shapes
from contactqp.elements.reference_elements import REFERENCES, at_rule
from contactqp.elements.shapes import spacing
from contactqp.errors import InvalidProblem
from tests.elements.bodies import PLANE, SOLID

R, H = 2.0, 3.0
FLAT = {
    "disc": (shapes.disc, np.pi * R**2, {}),
    "half_disc": (shapes.half_disc, np.pi * R**2 / 2, {"top": (1, 1)}),
    "quarter_disc": (shapes.quarter_disc, np.pi * R**2 / 4, {"top": (1, 1), "left": (0, -1)}),
}
BALLS = {"full": {}, "half": {"top": (2, 1)}, "quarter": {"top": (2, 1), "left": (0, -1)}}
BALLS["eighth"] = BALLS["quarter"] | {"front": (1, -1)}
CYLINDERS = {"full": {}, "half": {"front": (1, -1)}, "quarter": {"front": (1, -1), "left": (0, -1)}}
SHARE = {"full": 1, "half": 2, "quarter": 4, "eighth": 8}


def geometries(mesh, side):
    for block in mesh.side(side):
        yield at_rule(block, mesh.points, block.kind.fine_rule), block.kind.fine_rule.weights


def area(mesh, side):
    return sum(float((np.linalg.norm(g.normal, axis=-1) @ w).sum()) for g, w in geometries(mesh, side))


def faces(mesh, side, axis, sign):
    """Whether the side is flat, at coordinate 0, with its normals along sign times the axis."""
    nodes = mesh.nodes(side)
    assert len(nodes)
    assert np.abs(mesh.points[nodes, axis]).max() < 1e-14
    for geometry, _ in geometries(mesh, side):
        n = geometry.normal / np.linalg.norm(geometry.normal, axis=-1, keepdims=True)
        np.testing.assert_allclose(n[..., axis], sign, rtol=1e-13)


def covers(mesh):
    """Each boundary facet belongs to exactly one side."""
    pairs = np.concatenate(list(mesh.sides.values()))
    assert len(np.unique(pairs, axis=0)) == len(pairs) == len(mesh.boundary)


def order(kind):
    return 2 if len(REFERENCES[kind].nodes) == REFERENCES[kind].corners else 4


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", PLANE)
@pytest.mark.parametrize("name", FLAT)
def test_discs_converge_to_their_area(name, kind):
    shape, exact, flat = FLAT[name]
    meshes = [shape(R, (n, n), kind) for n in (1, 2, 4)]
    errors = [abs(mesh.volume() / exact - 1) for mesh in meshes]
    assert np.log2(errors[1] / errors[2]) > order(kind) - 0.1
    for mesh in meshes:
        covers(mesh)
        np.testing.assert_allclose(np.linalg.norm(mesh.points[mesh.nodes("arc")], axis=1), R, rtol=1e-15)
        for side, (axis, sign) in flat.items():
            faces(mesh, side, axis, sign)
            assert np.isclose(area(mesh, side), 2 * R if name == "half_disc" else R, rtol=1e-13)
        assert mesh.points[mesh.nodes("pole")].tolist() == [[0.0, -R]]


@pytest.mark.sampled(20)
@pytest.mark.parametrize("kind", SOLID)
@pytest.mark.parametrize("part", BALLS)
def test_balls_converge_to_their_volume(part, kind):
    meshes = [shapes.ball(R, (n, n), kind, part=part) for n in (1, 2)]
    errors = [abs(mesh.volume() / (4 / 3 * np.pi * R**3 / SHARE[part]) - 1) for mesh in meshes]
    assert np.log2(errors[0] / errors[1]) > order(kind) - 0.2
    for mesh in meshes:
        covers(mesh)
        np.testing.assert_allclose(np.linalg.norm(mesh.points[mesh.nodes("sphere")], axis=1), R, rtol=1e-15)
        for side, (axis, sign) in BALLS[part].items():
            faces(mesh, side, axis, sign)
        np.testing.assert_allclose(mesh.points[mesh.nodes("pole")], [[0.0, 0.0, -R]], atol=1e-15)


@pytest.mark.sampled(15)
@pytest.mark.parametrize("kind", SOLID)
@pytest.mark.parametrize("part", CYLINDERS)
def test_cylinders_converge_to_their_volume(part, kind):
    meshes = [shapes.cylinder(R, H, (n, n, 2), kind, part=part, grading=2.0) for n in (1, 2)]
    errors = [abs(mesh.volume() / (np.pi * R**2 * H / SHARE[part]) - 1) for mesh in meshes]
    assert np.log2(errors[0] / errors[1]) > order(kind) - 0.2
    for mesh in meshes:
        covers(mesh)
        side = mesh.points[mesh.nodes("side")]
        np.testing.assert_allclose(np.linalg.norm(side[:, :2], axis=1), R, rtol=1e-15)
        assert (mesh.points[mesh.nodes("top"), 2] == H).all()
        for name, (axis, sign) in ({"bottom": (2, -1)} | CYLINDERS[part]).items():
            faces(mesh, name, axis, sign)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", PLANE + SOLID)
def test_boxes_are_exact_and_their_sides_are_named_after_where_they_are(kind):
    if kind in PLANE:
        mesh = shapes.rectangle(2.0, 1.0, (3, 2), kind, corner=(1.0, -1.0), grading=4.0, towards=("middle", "top"))
        assert np.isclose(mesh.volume(), 2.0, rtol=1e-14)
        at = {"left": (0, 1.0), "right": (0, 3.0), "bottom": (1, -1.0), "top": (1, 0.0)}
    else:
        mesh = shapes.box((2.0, 1.0, 0.5), (3, 2, 2), kind, corner=(1.0, -1.0, 0.0), grading=4.0)
        assert np.isclose(mesh.volume(), 1.0, rtol=1e-14)
        at = {
            "left": (0, 1.0),
            "right": (0, 3.0),
            "front": (1, -1.0),
            "back": (1, 0.0),
            "bottom": (2, 0.0),
            "top": (2, 0.5),
        }
    covers(mesh)
    assert set(mesh.sides) == set(at)
    for side, (axis, value) in at.items():
        np.testing.assert_allclose(mesh.points[mesh.nodes(side), axis], value, atol=1e-15)


@pytest.mark.parametrize("kind", SOLID)
def test_a_crowned_box_has_a_paraboloid_for_its_bottom(kind):
    """z = 0.1 + r^2 / (2 R) below, the flat top above, and the volume by the integral of r^2."""
    mesh = shapes.box((1.0, 2.0, 0.5), (2, 4, 2), kind, corner=(0.0, -1.0, 0.1), crown=5.0)
    covers(mesh)
    bottom, top = mesh.points[mesh.nodes("bottom")], mesh.points[mesh.nodes("top")]
    np.testing.assert_allclose(bottom[:, 2], 0.1 + (bottom[:, 0] ** 2 + bottom[:, 1] ** 2) / 10.0, rtol=1e-14)
    np.testing.assert_allclose(top[:, 2], 0.6, rtol=1e-15)
    if kind not in ("tet4", "hex8"):
        assert np.isclose(mesh.volume(), 1.0 - (2 / 3 + 2 / 3) / 10.0, rtol=1e-12)
    with pytest.raises(InvalidProblem, match=r"a crown that stays below the top, of a radius above 2, got 1\.9"):
        shapes.box((1.0, 2.0, 0.5), (2, 4, 2), kind, corner=(0.0, -1.0, 0.1), crown=1.9)
    with pytest.raises(InvalidProblem, match="expected a positive crown, got -5"):
        shapes.box((1.0, 2.0, 0.5), (2, 4, 2), kind, crown=-5.0)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", PLANE + SOLID)
@pytest.mark.parametrize("grading", [5.0, 20.0])
def test_graded_round_shapes_are_sound_and_finest_at_the_pole(kind, grading):
    """The mesh checks run on every mesh: nothing is inverted. The elements at the pole are the smallest."""
    solid = kind in SOLID
    mesh = (
        shapes.ball(R, (3, 3), kind, part="eighth", grading=grading)
        if solid
        else shapes.half_disc(R, (4, 4), kind, grading=grading)
    )
    block = mesh.blocks[0]
    size = np.linalg.norm(np.ptp(mesh.points[block.nodes], axis=1), axis=1)
    at_pole = (block.nodes == mesh.nodes("pole")[0]).any(axis=1)
    assert size[at_pole].max() < 2.5 / grading * size.max()
    assert size[at_pole].max() < 2 * size.min()


@pytest.mark.parametrize(
    ("towards", "expected"),
    [("low", [0, 1, 3, 7]), ("high", [0, 4, 6, 7]), ("both", [0, 1, 5, 6]), ("middle", [0, 4, 5, 9])],
)
def test_spacing_is_geometric(towards, expected):
    found = spacing(3, 4.0, towards)
    np.testing.assert_allclose(found[::2], np.array(expected) / expected[-1], rtol=1e-15)
    np.testing.assert_allclose(found[1::2], (found[:-1:2] + found[2::2]) / 2, rtol=1e-15)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: shapes.disc(-1.0, (1, 1)), "expected a positive radius, got -1.0"),
        (lambda: shapes.rectangle(1.0, float("nan"), (1, 1)), "expected a positive length, got nan"),
        (lambda: shapes.disc(1.0, (0, 1)), "expected whole numbers of divisions >= 1, got 0"),
        (lambda: shapes.disc(1.0, (1.5, 1)), r"disc: divisions\[0\]: expected a whole number, got 1.5"),
        (lambda: shapes.disc(1.0, (1, 1, 1)), "disc: divisions: expected 2 entries"),
        (lambda: shapes.box((1, 1, 1), (1, 1)), "box: divisions: expected 3 entries"),
        (lambda: shapes.cylinder(1.0, 1.0, (1, 1)), "cylinder: divisions: expected 3 entries"),
        (lambda: shapes.disc(1.0, (1, 1), "hex8"), "expected a kind of tri3, tri6, quad4, quad8, quad9, got 'hex8'"),
        (lambda: shapes.ball(1.0, (1, 1), "quad4"), "expected a kind of tet4, tet10, hex8, hex20, hex27"),
        (
            lambda: shapes.ball(1.0, (1, 1), part="third"),
            "ball: part: expected one of 'full', 'half', 'quarter'",
        ),
        (
            lambda: shapes.cylinder(1.0, 1.0, (1, 1, 1), part="eighth"),
            "cylinder: expected a part of full, half, quarter",
        ),
        (lambda: shapes.disc(1.0, (1, 1), grading=0.5), "expected a grading from 1 to 1e\\+10, got 0.5"),
        (lambda: shapes.disc(1.0, (1, 1), grading=1e12), "expected a grading from 1 to 1e\\+10, got 1e\\+12"),
        (lambda: shapes.rectangle(1.0, 1.0, (1, 1), towards=("front",)), "expected `towards` to be a list of"),
        (lambda: shapes.rectangle(1.0, 1.0, (1, 1), towards="top"), "towards: expected a sequence, each a string"),
    ],
)
def test_shapes_that_are_none_are_refused(make, message):
    with pytest.raises(InvalidProblem, match=message):
        make()


@pytest.mark.sampled(3)
@pytest.mark.parametrize("parts", [1, 2, 3, 7])
@pytest.mark.parametrize(
    "lattice",
    [
        shapes.box.lattice((1.0, 2.0, 3.0), (3, 4, 2), "tet10", crown=20.0),
        shapes.ball.lattice(1.0, (2, 3), "hex8", part="quarter"),
        shapes.disc.lattice(1.0, (3, 2), "tri3"),
        shapes.cylinder.lattice(1.0, 2.0, (2, 1, 3), "hex20", part="half"),
    ],
)
def test_the_parts_of_a_lattice_are_its_elements(lattice, parts):
    """Each element once, with nodes that are called the same in every part, in the order of the mesh's numbers."""
    whole, mesh = lattice.elements(), lattice.mesh()
    found = np.concatenate([lattice.elements(part, parts) for part in range(parts)])
    assert np.array_equal(np.unique(found, axis=0), np.unique(whole, axis=0))
    assert len(found) == len(whole) == mesh.elements
    codes = np.unique(lattice.elements(0, parts))
    numbers = np.searchsorted(np.unique(whole), codes)
    assert np.array_equal(lattice.position(lattice.keys(codes)), mesh.points[numbers])
    if parts > 1:
        assert len(codes) < len(mesh.points), "a part is less than the whole"
