"""Scenes of bodies of which each rank makes its piece: the problem and its claims are those of one process."""

from __future__ import annotations

import pytest

from contactqp.elements.shapes import rectangle
from tests.distributed.cases import RANKS
from tests.shipped_cases import FOLDER

CASES = (
    "hertz_line",  # axisymmetric or plane bodies, loads on sides
    "hertz_sphere",
    "block_on_paraboloid",  # in space
    "hertz_bodies",  # two bodies, a mortar on meshes that do not match, a support at a point
    "stacked_blocks",  # three bodies of several kinds, gravity, nothing held sideways
    "cattaneo_mindlin_sphere",  # friction, node to segment, a path with corners
)
OF_A_FILE = """
title = "A block from a file on a floor"
source = "none"
about = "Quadrilaterals below, triangles above; a set of nodes stands for a side."
units = { length = "mm", force = "N" }
axes = ["x", "y"]
obstacles = [{ name = "floor", point = ["0 mm", "0 mm"], normal = [0, 1] }]
contacts = [{ name = "foot", side = "block.SOLE", obstacle = "floor" }]
supports = [
    { name = "guide", on = "block", near = ["0.002 m", "0 mm"], axis = "x", value = "0.5 mm" },
    { name = "lid", on = "block.LID", axis = "x", value = "0.25 mm" },
]
tractions = [{ name = "press", side = "block.LID", value = ["1 MPa", "-3 MPa"] }]
point_loads = [{ name = "poke", on = "block.LID", force = ["0 N", "-1 N"] }]

[[bodies]]
name = "block"
mesh = { file = "block.inp", unit = "m" }
model = "plane-stress"
thickness = "3 mm"
modulus = "2 GPa"
poisson = 0.3
"""


def block_of_two_kinds():
    """In metres: 2 mm times 2 mm, its nodes in no order, the upper half of its cells cut in two."""
    mesh = rectangle(0.002, 0.002, (6, 8))
    label = [(i * 17) % 63 + 1 for i in range(63)]
    lines = ["*NODE"]
    lines += [f"{at}, {x:.17g}, {y:.17g}" for at, (x, y) in sorted(zip(label, mesh.points.tolist(), strict=True))]
    cells = [[label[i] for i in nodes] for nodes in mesh.blocks[0].nodes]
    upper = [mesh.points[nodes, 1].mean() > 0.001 for nodes in mesh.blocks[0].nodes]
    quads = [nodes for nodes, cut in zip(cells, upper, strict=True) if not cut]
    cut = [nodes for nodes, cut in zip(cells, upper, strict=True) if cut]
    triangles = [[a, b, c] for a, b, c, _ in cut] + [[a, c, d] for a, _, c, d in cut]
    for kind, elements in (("CPS4", quads), ("CPS3", triangles)):
        lines.append(f"*ELEMENT, TYPE={kind}, ELSET={kind}")
        first = 1 if kind == "CPS4" else 1 + len(quads)
        lines += [f"{first + i}, {', '.join(map(str, nodes))}" for i, nodes in enumerate(elements)]
    for name, side in (("SOLE", "bottom"), ("LID", "top")):
        lines.append(f"*NSET, NSET={name}")
        lines += [f"{label[i]}," for i in mesh.nodes(side)]
    return "\n".join(lines) + "\n"


@pytest.fixture
def of_a_file(tmp_path):
    """A case whose mesh is read from a file."""
    (tmp_path / "block.inp").write_text(block_of_two_kinds())
    (tmp_path / "of_a_file.toml").write_text(OF_A_FILE)
    return tmp_path / "of_a_file.toml"


@pytest.mark.slow
@pytest.mark.parametrize("ranks", RANKS)
def test_the_problem_is_that_of_one_process(on_ranks, ranks, of_a_file):
    said = on_ranks("same_as_one_process.py", ranks, *(FOLDER / f"{name}.toml" for name in CASES), of_a_file)
    assert said.split("\n")[:-1] == [f"{name}: the same on {ranks}" for name in (*CASES, "of_a_file")]


@pytest.mark.slow
def test_a_wrong_problem_is_seen(on_ranks):
    # Both ranks may speak at once.
    with pytest.raises(pytest.fail.Exception, match=r"(?s)AssertionError.*load"):
        on_ranks("same_as_one_process.py", 2, "--spoil", FOLDER / "hertz_line.toml")


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
def test_claims_are_answered_as_by_one_process(on_ranks, ranks, of_a_file):
    """Those of two cases are compared every time, by the command line."""
    names = CASES[:5]
    said = on_ranks("claims_as_one_process.py", ranks, *(FOLDER / f"{name}.toml" for name in names), of_a_file)
    assert said.split("\n")[:-1] == [f"{name}: the same on {ranks}" for name in (*names, "of_a_file")]


def are_some_refused(said: str) -> None:
    lines = said.splitlines()
    assert lines
    assert lines.count("None") < len(lines), "some are refused"


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [2, 3])
def test_what_is_wrong_is_refused_on_all_ranks_in_the_same_words(on_ranks, ranks):
    are_some_refused(on_ranks("refused_alike.py", ranks, 1))


@pytest.mark.slow
@pytest.mark.parametrize(("ranks", "name"), [(4, "patch_two_blocks"), (7, "flat_punch")])
def test_more_ranks_than_layers_of_elements(on_ranks, ranks, name):
    assert on_ranks("same_as_one_process.py", ranks, FOLDER / f"{name}.toml") == f"{name}: the same on {ranks}\n"
