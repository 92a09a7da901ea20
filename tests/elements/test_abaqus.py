"""Abaqus and CalculiX input files: sets, surfaces, labels that are no counts, and what is refused."""

import numpy as np
import pytest

from contactqp.elements.abaqus import read_abaqus
from contactqp.elements.mesh_files import read_mesh
from contactqp.elements.reference_elements import REFERENCES
from contactqp.errors import InvalidProblem

FILE = """** two squares
*Heading
 two squares, NODE 1
*Node, nset=everything
 10, 0., 0.
 20, 1., 0.
 30, 2., 0.
 40, 0., 1.
 50, 1., 1.
 60, 2., 1.
*Element, type=CPE4R, elset=left
 7, 10, 20, 50, 40
*Element, type=CPS4
 9, 20, 30,
 60, 50
*Elset, elset=right
 9,
*Elset, elset=both
 left, right
*Nset, nset=low, generate
 10, 30, 10
*Nset, nset="corner"
 low,
 60
*Surface, name=base, type=element
 both, S1
*Surface, name=END
 9, S2
*Surface, name=dots, type=NODE
 low, 1.
*Material, name=steel
*Elastic
 210000., 0.3
*Step
*End Step
"""


def write(tmp_path, text):
    file = tmp_path / "job.inp"
    file.write_text(text)
    return file


def test_sets_and_surfaces_are_read(tmp_path):
    mesh = read_mesh(write(tmp_path, FILE))
    assert mesh.points.tolist() == [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]]
    assert mesh.blocks[0].kind.name == "quad4"
    assert mesh.blocks[0].nodes.tolist() == [[0, 1, 4, 3], [1, 2, 5, 4]]
    assert mesh.side("BASE")[0].nodes.tolist() == [[0, 1], [1, 2]]
    assert mesh.side("END")[0].nodes.tolist() == [[2, 5]]
    assert mesh.nodes("LOW").tolist() == mesh.nodes("DOTS").tolist() == [0, 1, 2]
    assert mesh.nodes("CORNER").tolist() == [0, 1, 2, 5]
    assert mesh.nodes("EVERYTHING").tolist() == mesh.nodes("BOTH").tolist() == list(range(6))
    right = read_mesh(write(tmp_path, FILE), part="RIGHT")
    assert right.points.tolist() == [[1, 0], [2, 0], [1, 1], [2, 1]]
    assert right.side("BASE")[0].nodes.tolist() == [[0, 1]]


# Abaqus elements guide, "Element faces": the nodes of each face, counted from 1.
FACES = {
    "CPE3": ["1-2", "2-3", "3-1"],
    "CPS6M": ["1-2", "2-3", "3-1"],
    "CAX8R": ["1-2", "2-3", "3-4", "4-1"],
    "C3D4": ["1-2-3", "1-4-2", "2-4-3", "3-4-1"],
    "C3D10HS": ["1-2-3", "1-4-2", "2-4-3", "3-4-1"],
    "C3D8I": ["1-2-3-4", "5-8-7-6", "1-5-6-2", "2-6-7-3", "3-7-8-4", "4-8-5-1"],
    "C3D20R": ["1-2-3-4", "5-8-7-6", "1-5-6-2", "2-6-7-3", "3-7-8-4", "4-8-5-1"],
}
KIND = {
    "CPE3": "tri3",
    "CPS6M": "tri6",
    "CAX8R": "quad8",
    "C3D4": "tet4",
    "C3D10HS": "tet10",
    "C3D8I": "hex8",
    "C3D20R": "hex20",
}


@pytest.mark.parametrize("name", FACES)
def test_face_numbers_are_abaqus(name, tmp_path):
    kind = REFERENCES[KIND[name]]
    lines = ["*NODE"] + [f"{i + 1}, " + ", ".join(map(repr, map(float, x))) for i, x in enumerate(kind.nodes)]
    lines += [f"*ELEMENT, TYPE={name}", ", ".join(map(str, [1, *range(1, len(kind.nodes) + 1)]))]
    for face in range(len(FACES[name])):
        lines += [f"*SURFACE, NAME=F{face + 1}", f"1, S{face + 1}"]
    mesh = read_mesh(write(tmp_path, "\n".join(lines)))
    corners = REFERENCES[kind.facet].corners
    for face, expected in enumerate(FACES[name]):
        (block,) = mesh.side(f"F{face + 1}")
        assert {int(i) + 1 for i in block.nodes[0][:corners]} == {int(c) for c in expected.split("-")}


def test_shells_and_trusses_in_a_solid_are_sides(tmp_path):
    nodes = "\n".join(
        f"{i}, {x}, {y}, {z}" for i, (x, y, z) in enumerate([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], 1)
    )
    text = f"*NODE\n{nodes}\n*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4\n*ELEMENT, TYPE=S3, ELSET=SKIN\n2, 1, 2, 3\n"
    mesh = read_mesh(write(tmp_path, text))
    assert mesh.side("SKIN")[0].nodes.tolist() == [[0, 2, 1]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("type=CPE4R", "type=C3D6", "the type C3D6 is not offered"),
        ("type=CPE4R", "type=SPRINGA", "the type SPRINGA is not offered"),
        ("7, 10, 20, 50, 40", "7, 10, 20, 50", "TYPE=CPE4R: expected a label and 4 nodes for each element"),
        ("7, 10, 20, 50, 40", "7, 10, 20, 50, 41", "there is no node with the label 41"),
        ("7, 10, 20, 50, 40", "7, 10, 20, 50, forty", r"\*ELEMENT: expected numbers"),
        ("10, 0., 0.", "10, 0.", r"\*NODE: expected a label and two or three coordinates"),
        ("30, 2., 0.", "30, 2.", r"\*NODE: expected a label and two or three coordinates"),
        (" left, right", " left, middle", "there is no set MIDDLE at this place; it has LEFT, RIGHT"),
        (" 9,\n", " 8,\n", "there is no element, in the set RIGHT, with the label 8"),
        (" low,\n 60", " low,\n 61", "there is no node, in the set CORNER, with the label 61"),
        (" 9, S2", " 9, SPOS", r"\*SURFACE END: expected a face S1 to S6, got 'SPOS'"),
        (" 9, S2", " 9, S6", r"\*SURFACE END: quad4 elements have no face S6"),
        ("*Surface, name=END", "*Surface", r"\*SURFACE: expected NAME="),
        ("10, 0., 0.", "10.5, 0., 0.", r"\*NODE: expected whole numbers as labels"),
        ("20, 1., 0.", "10, 1., 0.", "expected one node with the label 10, got several"),
        (" 9, S2", "", "side 'END' is empty; expected at least one facet"),
        (
            "*Step",
            "*Nset, nset=G, generate\n10, 60, 0",
            "GENERATE: expected a first .* a positive step, got '10, 60, 0'",
        ),
        ("*Step", "*Nset, nset=G, generate\n10, last", "GENERATE: expected a first and a last label"),
        ("*Step", "*Nset, nset=G, generate\n60, 10", "node set 'G' is empty; expected at least one node"),
        ("*Step", "*Nset, nset=G", "node set 'G' is empty; expected at least one node"),
        ("*Step", "*Include, input=more.inp", "INCLUDE is not followed"),
        ("*Step", "*Instance, name=a, part=p\n1., 0., 0.", "expected one part in its own place"),
        ("*Step", "*Instance, name=a, part=p\n*Instance, name=b, part=p", "expected one part in its own place"),
    ],
)
def test_what_cannot_be_read_rightly_is_refused(old, new, message, tmp_path):
    assert old in FILE
    with pytest.raises(InvalidProblem, match=message):
        read_mesh(write(tmp_path, FILE.replace(old, new)))


def test_comments_in_any_encoding_are_passed_over_and_other_encodings_refused(tmp_path):
    file = tmp_path / "body.inp"
    file.write_bytes(("** Tr\xe4ger\n" + FILE).encode("latin-1"))
    assert read_mesh(file).elements == 2
    file.write_bytes(FILE.encode("utf-16"))
    with pytest.raises(InvalidProblem, match=r"body.inp: expected \*NODE and \*ELEMENT, got none"):
        read_mesh(file)


def test_a_face_given_twice_counts_once(tmp_path):
    mesh = read_mesh(write(tmp_path, FILE.replace(" 9, S2", " 9, S2\n 9, S2")))
    assert len(mesh.side("END")[0]) == 1


def test_an_empty_file_has_no_mesh():
    with pytest.raises(InvalidProblem, match=r"expected \*NODE and \*ELEMENT, got none"):
        read_abaqus("** nothing")


def test_nodes_far_from_the_labels_are_found():
    cells = read_abaqus("*NODE\n1000000, 0, 0\n5, 1, 0\n77, 0, 1\n*ELEMENT, TYPE=CPE3\n1, 1000000, 5, 77\n")
    np.testing.assert_array_equal(cells.cells[0][1], [[0, 1, 2]])


def test_messages_stay_short_whatever_a_file_says(tmp_path):
    file = tmp_path / "long.inp"
    file.write_text(FILE + f"*Elset, elset=all\n {'9' * 5000},\n")
    with pytest.raises(InvalidProblem, match="there is no set 999") as caught:
        read_mesh(file)
    assert len(str(caught.value)) < 500
