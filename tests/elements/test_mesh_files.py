"""Meshes from Gmsh, VTU and scikit-fem: the same body, the same sides, the same sets."""

import sys

import numpy as np
import pytest

from contactqp.elements.mesh_files import mesh_from_meshlane, mesh_from_skfem, read_mesh
from contactqp.elements.shapes import ball, box, half_disc
from contactqp.errors import BackendMissing, InvalidProblem
from tests.elements.bodies import PLANE, SOLID, distorted

MESHIO = {
    "tri3": "triangle", "tri6": "triangle6", "quad4": "quad", "quad8": "quad8", "quad9": "quad9", "tet4": "tetra",
    "tet10": "tetra10", "hex8": "hexahedron", "hex20": "hexahedron20", "hex27": "hexahedron27",
    "line2": "line", "line3": "line3",
}  # fmt: skip

# Two squares side by side, "left" and "right", that share the physical line "between"; an arc's centre is left over.
GMSH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
4
1 1 "base"
1 2 "between"
2 1 "left"
2 2 "right"
$EndPhysicalNames
$Nodes
7
1 0 0 0
2 1 0 0
3 2 0 0
4 0 1 0
5 1 1 0
6 2 1 0
7 9 9 0
$EndNodes
$Elements
6
1 1 2 1 1 2 1
2 1 2 1 1 2 3
3 1 2 2 2 5 2
4 1 2 7 3 4 5
5 3 2 1 1 1 2 5 4
6 3 2 2 2 2 3 6 5
$EndElements
"""


@pytest.fixture
def gmsh(tmp_path):
    pytest.importorskip("meshlane")
    file = tmp_path / "squares.msh"
    file.write_text(GMSH)
    return file


def test_physical_groups_are_sides_parts_and_sets(gmsh):
    mesh = read_mesh(gmsh, drop_unconnected=True)
    assert len(mesh.points) == 6
    assert mesh.elements == 2
    assert mesh.side("base")[0].nodes.tolist() == [[0, 1], [1, 2]]  # turned outward
    assert mesh.side("7")[0].nodes.tolist() == [[4, 3]]  # a group without a name
    assert mesh.nodes("between").tolist() == [1, 4]
    assert mesh.nodes("left").tolist() == [0, 1, 3, 4]
    with pytest.raises(InvalidProblem, match="side 'between' has no faces"):
        mesh.side("between")


def test_a_part_has_its_own_sides(gmsh):
    mesh = read_mesh(gmsh, part="right")
    assert mesh.points.tolist() == [[1, 0], [2, 0], [1, 1], [2, 1]]
    assert mesh.side("base")[0].nodes.tolist() == [[0, 1]]
    assert mesh.side("between")[0].nodes.tolist() == [[2, 0]]
    with pytest.raises(InvalidProblem, match="there is no set '7'"):
        mesh.nodes("7")
    with pytest.raises(InvalidProblem, match=r"squares.msh: mesh: there is no group 'middle'; it has '7', 'base'"):
        read_mesh(gmsh, part="middle")
    with pytest.raises(InvalidProblem, match=r"squares.msh: mesh: the group 'base' has no elements of dimension 2"):
        read_mesh(gmsh, part="base")


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_the_mark_that_editors_put_before_text_changes_nothing(gmsh, ends):
    plain = read_mesh(gmsh, drop_unconnected=True)
    gmsh.write_bytes(b"\xef\xbb\xbf" + GMSH.replace("\n", ends).encode())
    marked = read_mesh(gmsh, drop_unconnected=True)
    assert marked.points.tolist() == plain.points.tolist()
    assert marked.nodes("left").tolist() == plain.nodes("left").tolist()


def test_bad_files_are_refused_by_name(gmsh, tmp_path):
    with pytest.raises(InvalidProblem, match=r"squares.msh: mesh: node 6 at \(9, 9\) belongs to no element"):
        read_mesh(gmsh)
    gmsh.write_text(GMSH.replace("3 1 2 2 2 5 2", "3 1 2 1 2 5 2"))
    with pytest.raises(InvalidProblem, match="side 'base': 1 of its 3 facets are not on the boundary"):
        read_mesh(gmsh, drop_unconnected=True)
    gmsh.write_text(GMSH.replace("6 2 1 0\n", "6 2 1 0.5\n"))
    with pytest.raises(InvalidProblem, match=r"expected plane elements with one z, got z from 0 to 0\.5"):
        read_mesh(gmsh, drop_unconnected=True)
    gmsh.write_text(GMSH.replace("6 3 2 2 2 2 3 6 5", "6 3 2 2 2 2 5 6 3"))
    with pytest.raises(InvalidProblem, match=r"element 1 \(quad4, .*inverted"):
        read_mesh(gmsh, drop_unconnected=True)
    with pytest.raises(InvalidProblem, match="there is no file"):
        read_mesh(tmp_path / "none.msh")
    nonsense = tmp_path / "mesh.msh"
    nonsense.write_text("nonsense")
    with pytest.raises(InvalidProblem, match=r"mesh\.msh: meshlane cannot read it"):
        read_mesh(nonsense)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("mesh.vtu", b"hello", "meshlane cannot read it .*[Cc]ouldn't read"),
        ("mesh.msh", bytes(range(256)), "meshlane cannot read it"),
        ("mesh.bdf", b"GRID,1\n", "meshlane cannot read it .*BEGIN BULK"),
        ("mesh.obj", b"v 0 0 0\n", "expected plane elements or solid ones, got none"),
        ("mesh.abc", b"hello", "meshlane cannot read it"),
    ],
)
def test_a_file_that_meshlane_stumbles_over_is_refused_and_nothing_printed(name, content, message, tmp_path, capfd):
    pytest.importorskip("meshlane")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidProblem, match=rf"^{name}: .*{message}") as refused:
        read_mesh(tmp_path / name)
    assert "\n" not in str(refused.value)
    assert capfd.readouterr() == ("", "")


def test_a_missing_meshlane_is_named_with_its_pip_command(gmsh, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshlane", None)
    with pytest.raises(BackendMissing, match=r"squares.msh needs meshlane: pip install meshlane"):
        read_mesh(gmsh)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", PLANE + SOLID)
@pytest.mark.parametrize("suffix", [".vtu", ".msh"])
def test_every_kind_survives_a_file(kind, suffix, tmp_path):
    """The same nodes in the same order: VTK's order is ours, also through Gmsh's other one."""
    meshlane = pytest.importorskip("meshlane")
    mesh = distorted(kind)
    flat = np.column_stack([mesh.points, np.zeros((len(mesh.points), 3 - mesh.dimension))])
    (facets,) = mesh.side("top")
    cells = [(MESHIO[kind], mesh.blocks[0].nodes)]
    if facets.kind.name in MESHIO:
        cells.append((MESHIO[facets.kind.name], facets.nodes[:, ::1]))
    flags = np.zeros(len(flat), dtype=np.int64)
    flags[mesh.nodes("left")] = 1
    tags = [np.full(len(nodes), i, dtype=np.int32) for i, (_, nodes) in enumerate(cells)]
    file = tmp_path / f"body{suffix}"
    if suffix == ".vtu":
        sets = {"point_data": {"left": flags}, "cell_data": {"top": tags}}
        meshlane.Mesh(flat, cells, **sets).write(file)
    else:
        data = {"gmsh:physical": [t + 1 for t in tags], "gmsh:geometrical": [t + 1 for t in tags]}
        names = {"all": np.array([1, mesh.dimension]), "top": np.array([2, mesh.dimension - 1])}
        meshlane.write(file, meshlane.Mesh(flat, cells, cell_data=data, field_data=names), file_format="gmsh22")
    again = read_mesh(file)
    np.testing.assert_allclose(again.points, mesh.points, rtol=1e-15)
    np.testing.assert_array_equal(again.blocks[0].nodes, mesh.blocks[0].nodes)
    np.testing.assert_array_equal(again.side("top")[0].nodes, facets.nodes)
    if suffix == ".vtu":
        np.testing.assert_array_equal(again.nodes("left"), mesh.nodes("left"))


def test_cells_without_their_nodes_are_refused():
    meshlane = pytest.importorskip("meshlane")
    mesh = meshlane.Mesh(np.zeros((4, 3)), [])
    mesh.cells = [meshlane.CellBlock("quad", np.zeros((2, 0), dtype=int))]
    with pytest.raises(InvalidProblem, match=r"expected 4 nodes a quad4, got nodes of shape \(2, 0\)"):
        mesh_from_meshlane(mesh)


def test_cells_that_are_not_offered_are_refused():
    meshlane = pytest.importorskip("meshlane")
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]], dtype=float)
    with pytest.raises(InvalidProblem, match=r"expected cells of vertex, .*, got wedge"):
        mesh_from_meshlane(meshlane.Mesh(points, [("wedge", [[0, 1, 2, 3, 4, 5]])]))
    with pytest.raises(InvalidProblem, match="expected plane elements or solid ones, got none"):
        mesh_from_meshlane(meshlane.Mesh(points, [("line", [[0, 1]])]))


@pytest.mark.parametrize(
    "name", ["MeshTri", "MeshTri2", "MeshQuad", "MeshQuad2", "MeshTet", "MeshTet2", "MeshHex", "MeshHex2"]
)
def test_scikit_fem_meshes_keep_their_boundaries_and_subdomains(name):
    skfem = pytest.importorskip("skfem")
    theirs = getattr(skfem, name)().refined(1)
    last = theirs.dim() - 1
    linear = theirs.p[:, : theirs.nvertices]
    theirs = theirs.with_boundaries({"floor": lambda x: x[last] == 0})
    halves = np.flatnonzero(linear[0][theirs.t].mean(axis=0) < 0.5)
    theirs = theirs.with_subdomains({"west": halves})
    mesh = mesh_from_skfem(theirs)
    assert np.isclose(mesh.volume(), 1.0, rtol=1e-14)
    assert np.abs(mesh.points[mesh.nodes("floor"), last]).max() == 0
    assert len(mesh.nodes("floor")) == np.count_nonzero(mesh.points[:, last] == 0)
    west = mesh_from_skfem(theirs, part="west")
    assert np.isclose(west.volume(), 0.5, rtol=1e-14)
    assert west.elements == len(halves)
    assert west.points[west.nodes("floor"), 0].max() == 0.5


def test_scikit_fem_meshes_without_a_counterpart_are_refused():
    skfem = pytest.importorskip("skfem")
    with pytest.raises(InvalidProblem, match="MeshLine1 of scikit-fem has no counterpart here"):
        mesh_from_skfem(skfem.MeshLine())


def test_our_shapes_are_scikit_fems_meshes():
    """The volume of their integrals, on our meshes in their hands."""
    skfem = pytest.importorskip("skfem")
    for mesh, theirs in ((half_disc(1.0, (2, 2), "tri3"), skfem.MeshTri), (ball(1.0, (1, 1), "tet4"), skfem.MeshTet)):
        element = skfem.ElementTriP1() if theirs is skfem.MeshTri else skfem.ElementTetP1()
        basis = skfem.Basis(theirs(mesh.points.T, mesh.blocks[0].nodes.T), element)
        assert np.isclose(float(basis.dx.sum()), mesh.volume(), rtol=1e-14)
    hexahedra = box((1.0, 2.0, 3.0), (1, 1, 1))
    assert np.isclose(hexahedra.volume(), 6.0)
