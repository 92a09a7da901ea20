"""Wrong meshes and membranes in case files: exit code 2, one line, the file, the key, what was expected."""

import pytest

from .refusals import accept, complaint, mutated, refuse
from .test_bad_bodies import MESH, written

MESHES = {
    "inverted mesh": ("1, 1, 2, 3, 4", "1, 1, 4, 3, 2", "element 0 (quad4, nodes 0, 3, 2, 1): inverted"),
    "a loose node": ("*ELEMENT", "5, 9, 9\n*ELEMENT", "node 4 at (9, 9) belongs to no element"),
    "empty set": ("*NSET, NSET=left\n1, 4", "*NSET, NSET=left", "node set 'LEFT' is empty"),
    "an element twice": (
        "1, 1, 2, 3, 4",
        "1, 1, 2, 3, 4\n2, 2, 3, 4, 1",
        "duplicate, it lies on the corners of element 0",
    ),
    "no number": ("2, 2, 1", "2, nan, 1", "upper.inp: mesh: node 1 is at [nan, 1.0]; expected finite numbers"),
    "far too large": ("2, 2, 1", "2, 1e308, 1", "upper.inp: element 0 (quad4, nodes 0, 1, 2, 3): its coordinates"),
    "flat": ("3, 2, 2\n4, 0, 2", "3, 2, 1\n4, 0, 1", "element 0 (quad4, nodes 0, 1, 2, 3): degenerate, it has no area"),
    "collapsed": ("1, 1, 2, 3, 4", "1, 1, 2, 3, 3", "degenerate, node 2 stands in it twice"),
    "unknown node": ("1, 1, 2, 3, 4", "1, 1, 2, 3, 9", "upper.inp: there is no node with the label 9"),
    "unknown node of a set": ("left\n1, 4", "left\n1, 77", "there is no node, in the set LEFT, with the label 77"),
    "unknown element of a side": ("bottom\n1, S1", "bottom\n8, S1", "there is no element, in the surface BOTTOM"),
    "empty side": ("bottom\n1, S1", "bottom", "upper.inp: side 'BOTTOM' is empty; expected at least one facet"),
    "no step": ("NSET=left\n1, 4", "NSET=left, GENERATE\n1, 4, 0", "expected a first and a last label"),
    "a label twice": ("4, 0, 2", "3, 0, 2", "upper.inp: expected one node with the label 3, got several"),
    "two kinds on one place": (
        "1, 1, 2, 3, 4",
        "1, 1, 2, 3, 4\n*ELEMENT, TYPE=CPE3\n2, 1, 2, 3\n*ELEMENT, TYPE=CPE3\n3, 1, 2, 4",
        "upper.inp: mesh: elements 0, 1, 2 share one facet; expected two at most",
    ),
    "overlap": ("1, 0, 1\n2, 2, 1", "1, 0, 0.5\n2, 2, 0.5", "contacts[1] ('joint'): upper.BOTTOM: facet 0"),
    "a side of a set without faces": ("*SURFACE, NAME=bottom\n1, S1", "*NSET, NSET=bottom\n1", "has no faces"),
    "broken": ("2, 2, 1", "2, two, 1", "upper.inp: *NODE: expected numbers"),
    "nothing": (MESH, "", "upper.inp: expected *NODE and *ELEMENT, got none"),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("command", ["run", "explain"])
@pytest.mark.parametrize("name", MESHES)
def test_a_wrong_mesh_is_refused_in_one_line(name, command, tmp_path, capsys):
    old, new, words = MESHES[name]
    refuse(capsys, written(tmp_path, mesh=mutated(MESH, old, new)), words, command)


MEMBRANE = """
title = "A membrane"
axes = ["x", "y", "z"]
membranes = [
    { name = "drum", tension = "5 N/m", shape = { kind = "disc", element = "tri3", radius = "1 m", divisions = [2, 2]}},
]
obstacles = [{ name = "ball", kind = "sphere", centre = ["0 m", "0 m", "-0.9 m"], radius = "1 m" }]
contacts = [{ name = "touch", membrane = "drum", obstacle = "ball" }]
supports = [{ name = "rim", on = "drum.arc", axis = "z" }]

[[expect]]
quantity = "free motions"
value = "0"
tolerance = "0.5"
derivation = "the rim is held"
"""
OF_MEMBRANES = {
    "no tension": (
        'tension = "5 N/m"',
        'tension = "0 N/m"',
        "membranes[0].tension ('drum'): expected a positive number",
    ),
    "in a plane": ('axes = ["x", "y", "z"]', 'axes = ["x", "y"]', "expected 2 components"),
    "a ball for a membrane": ('kind = "disc"', 'kind = "ball"', "expected a plane shape, got 'ball'"),
    "a missing membrane": ('membrane = "drum"', 'membrane = "dum"', "there is no membrane 'dum'; nearest: 'drum'"),
    "held sideways": ('axis = "z"', 'axis = "x"', "supports[0].axis ('rim'): expected 'z' for a membrane, got 'x'"),
    "friction": ('obstacle = "ball" }', 'obstacle = "ball", friction = 0.3 }', "a membrane does not slide"),
    "in a hole": ('radius = "1 m" }]', 'radius = "1 m", inside = true }]', "expected an obstacle below the membrane"),
    "a load on it": (
        "[[expect]]",
        '[[pressures]]\nname = "p"\nside = "drum.arc"\nvalue = "1 Pa"\n[[expect]]',
        "no body",
    ),
    "stress of it": (
        'quantity = "free motions"\nvalue = "0"',
        'quantity = "stress"\nat = "drum"\nnear = ["0 m", "0 m", "0 m"]\ncomponent = "xx"\nvalue = "0 Pa"',
        "expect[0]",
    ),
}


@pytest.mark.parametrize("name", OF_MEMBRANES)
def test_a_wrong_membrane_is_refused_in_one_line(name, tmp_path, capsys):
    old, new, words = OF_MEMBRANES[name]
    refuse(capsys, written(tmp_path, mutated(MEMBRANE, old, new)), words)


def test_a_mesh_in_place_of_a_case_is_told_where_it_belongs(tmp_path, capsys):
    mesh = tmp_path / "block.msh"
    mesh.write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n")
    told = complaint(capsys, "run", str(mesh))
    assert told.endswith('a mesh is named in a case: bodies with mesh = { file = "block.msh", unit = "mm" }\n')


def test_the_good_membrane_is_good(tmp_path, capsys):
    accept(capsys, written(tmp_path, MEMBRANE))


@pytest.mark.parametrize(
    ("added", "words"),
    [
        (
            'supports = [{ name = "a", on = "b.c", axis = "x" }]',
            "supports: expected none in a scene without bodies; fixed =",
        ),
        ('contacts = [{ name = "a", side = "b.c", obstacle = "o" }]', "contacts[0] ('a'): expected 'node' or 'nodes'"),
        (
            'obstacles = [{ name = "o", kind = "circle", centre = ["0 m", "0 m"], radius = "1 m" }]',
            "obstacles[0].kind ('o'): expected a plane for nodes, got 'circle'",
        ),
        ('[[expect]]\nquantity = "peak pressure"\nat = "a"\nvalue = "1 Pa"\nderivation = "none"', "scenes of bodies"),
    ],
)
def test_scenes_of_nodes_take_nothing_of_bodies(added, words, tmp_path, capsys):
    text = 'title = "t"\naxes = ["x", "y"]\nnodes = [{ name = "n", at = ["0 m", "0 m"] }]\nfixed = ["n.x"]\n'
    text += 'springs = [{ name = "s", nodes = ["n"], direction = [0, 1], stiffness = "1 N/m" }]\n'
    assert words in complaint(capsys, "run", written(tmp_path, text + added))


def test_a_scene_of_nothing_is_refused(tmp_path, capsys):
    text = 'title = "t"\naxes = ["x", "y"]\n'
    assert "nodes: expected 'nodes', 'bodies' or 'membranes', got none" in complaint(
        capsys, "run", written(tmp_path, text)
    )
