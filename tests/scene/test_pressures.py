"""What a case file is told of pressures: right at every node, and a word on facets too coarse for them."""

import json

import numpy as np
import pytest

from contactqp.cli import main
from contactqp.scene.judging import Trial, judge
from contactqp.scene.scene import Scene

KINDS = ["tri3", "quad4", "tri6", "quad8", "quad9"]


def pressed(kind, model, near, held="x"):
    """A block or a cylinder on a floor under 5 MPa: its pressure at some points, and the largest; `held`: its left."""
    shape = {"kind": "rectangle", "element": kind, "size": ["2 mm", "1 mm"], "divisions": [4, 2], "grading": 3}
    body = {"name": "block", "shape": shape, "model": model, "modulus": "210 GPa", "poisson": 0.3}
    thick = {} if model == "axisymmetric" else {"thickness": "0.5 mm"}
    probe = {"tolerance": 1e-9, "derivation": "the stress is uniform", "at": "foot", "value": "5 MPa"}
    scene = Scene(
        title="pressed",
        units={"length": "mm", "force": "N"},
        axes=["x", "y"],
        bodies=[body | thick],
        obstacles=[{"name": "floor", "point": ["0 mm", "0 mm"], "normal": [0, 1]}],
        contacts=[{"name": "foot", "side": "block.bottom", "obstacle": "floor"}],
        supports=[{"name": f"left {axis}", "on": "block.left", "axis": axis} for axis in held],
        pressures=[{"name": "press", "side": "block.top", "value": "5 MPa"}],
        expect=[
            *({"quantity": "contact pressure", "near": [f"{x} mm", "0 mm"]} | probe for x in near),
            {"quantity": "peak pressure"} | probe,
        ],
    )
    return judge(scene, Trial())


@pytest.mark.sampled(15)
@pytest.mark.parametrize("model", ["plane-strain", "plane-stress", "axisymmetric"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_uniform_pressure_is_claimed_at_the_axis_and_at_the_edge(kind, model):
    judgement = pressed(kind, model, [0, 2])
    assert [row.ok for row in judgement.expectations] == [True] * 3


def test_no_pressure_is_claimed_where_a_support_holds_the_node():
    """It may carry anything: a claim of 0 would pass."""
    (held, beside, peak) = pressed("quad4", "plane-stress", [0, 2], held="xy").expectations
    assert np.isnan(held.got)
    assert not held.ok
    assert np.isfinite([beside.got, peak.got]).all()


def ring(inner, outer, cells):
    """Quarter of a ring of quad4 in an Abaqus file, two elements thick."""
    r, angle = np.linspace(inner, outer, 3), np.linspace(0, np.pi / 2, cells + 1)
    nodes = [(a * np.cos(b), a * np.sin(b)) for b in angle for a in r]
    lines = ["*NODE", *(f"{i + 1}, {x!r}, {y!r}" for i, (x, y) in enumerate(map(tuple, np.array(nodes).tolist())))]
    lines.append("*ELEMENT, TYPE=CPS4, ELSET=ALL")
    corners = [(3 * j + i, 3 * j + i + 1, 3 * j + i + 4, 3 * j + i + 3) for j in range(cells) for i in range(2)]
    lines += [", ".join(map(str, [e + 1, *(c + 1 for c in four)])) for e, four in enumerate(corners)]
    lines += ["*SURFACE, NAME=inner", *(f"{2 * j + 1}, S4" for j in range(cells))]
    lines += ["*SURFACE, NAME=outer", *(f"{2 * j + 2}, S2" for j in range(cells))]
    lines += [
        "*NSET, NSET=along x",
        "1, 2, 3",
        "*NSET, NSET=along y",
        f"{3 * cells + 1}, {3 * cells + 2}, {3 * cells + 3}",
    ]
    return "\n".join(lines) + "\n"


FIT = """title = "Lame's press fit"
units = { length = "mm", force = "N" }
axes = ["x", "y"]
contacts = [{ name = "fit", sides = ["shaft.OUTER", "hub.INNER"], pairing = "mortar", overlap = "0.1 mm" }]
supports = [
    { name = "shaft x", on = "shaft.ALONG Y", axis = "x" },
    { name = "shaft y", on = "shaft.ALONG X", axis = "y" },
    { name = "hub x", on = "hub.ALONG Y", axis = "x" },
    { name = "hub y", on = "hub.ALONG X", axis = "y" },
]
"""


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("cells", "told"), [((11, 8), True), ((11, 11), False)])
def test_facets_as_coarse_as_the_interference_are_told(tmp_path, capsys, cells, told):
    """By the table and by --json; facets that match are worth no word."""
    text = FIT
    for name, inner, outer, count in (("shaft", 0.5, 1.001, cells[0]), ("hub", 1.0, 2.0, cells[1])):
        (tmp_path / f"{name}.inp").write_text(ring(inner, outer, count))
        text += f"""
[[bodies]]
name = "{name}"
mesh = {{ file = "{name}.inp", unit = "mm" }}
model = "plane-stress"
thickness = "1 mm"
modulus = "1 GPa"
poisson = 0.3
"""
    (tmp_path / "fit.toml").write_text(text)
    said = []
    for options in ([], ["--json"]):
        with pytest.raises(SystemExit):
            main(["run", str(tmp_path / "fit.toml"), "--method", "active-set", *options])
        said.append(capsys.readouterr().out)
    (told_in_json,) = json.loads(said[1])
    assert ("both sides are curved" in " ".join(said[0].split())) == told
    assert len(told_in_json["contact_notes"]) == told
