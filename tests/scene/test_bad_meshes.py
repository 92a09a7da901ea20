"""Wrong meshes and membranes in case files: exit code 2, one line, the file, the key, what was expected."""

import pytest

from contactqp.cli import main

from .test_bad_bodies import MESH, written
from .test_bad_files import complaint

MESHES = {
    "inverted mesh": ("1, 1, 2, 3, 4", "1, 1, 4, 3, 2", "element 0 (quad4, nodes 0, 3, 2, 1): inverted"),
    "a loose node": ("*ELEMENT", "5, 9, 9\n*ELEMENT", "node 4 at (9, 9) belongs to no element"),
    "empty set": ("*NSET, NSET=left\n1, 4", "*NSET, NSET=left", "node set 'LEFT' is empty"),
    "an element twice": (
        "1, 1, 2, 3, 4",
        "1, 1, 2, 3, 4\n2, 2, 3, 4, 1",
        "duplicate, it lies on the corners of element 0",
    ),
    "overlap": ("1, 0, 1\n2, 2, 1", "1, 0, 0.5\n2, 2, 0.5", "contacts[1] ('joint'): upper.BOTTOM: facet 0"),
    "a side of a set without faces": ("*SURFACE, NAME=bottom\n1, S1", "*NSET, NSET=bottom\n1", "has no faces"),
    "broken": ("2, 2, 1", "2, two, 1", "upper.inp: *NODE: expected numbers"),
    "nothing": (MESH, "", "upper.inp: expected *NODE and *ELEMENT, got none"),
}


@pytest.mark.parametrize("command", ["run", "explain"])
@pytest.mark.parametrize("name", MESHES)
def test_a_wrong_mesh_is_refused_in_one_line(name, command, tmp_path, capsys):
    old, new, words = MESHES[name]
    assert MESH.count(old) == 1
    file = written(tmp_path, mesh=MESH.replace(old, new))
    message = complaint(capsys, command, file)
    assert message.count(file) == 1
    assert words in message


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
    assert MEMBRANE.count(old) == 1
    file = written(tmp_path, MEMBRANE.replace(old, new))
    message = complaint(capsys, "run", file)
    assert file in message
    assert words in message


def test_the_good_membrane_is_good(tmp_path, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["run", written(tmp_path, MEMBRANE)])
    assert exit_.value.code == 0, capsys.readouterr()


@pytest.mark.parametrize(
    ("added", "words"),
    [
        ('supports = [{ name = "a", on = "b.c", axis = "x" }]', "supports: expected none in a scene without bodies"),
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
