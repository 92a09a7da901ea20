"""Wrong case files of elastic bodies and membranes: exit code 2, one line, the file, the key, what was expected."""

import pytest

from .refusals import accept, mutated, refuse

GOOD = """
title = "Everything that a scene of bodies can have"
units = { length = "mm", force = "N" }
axes = ["x", "y"]
gravity = ["0 m/s^2", "-9.81 m/s^2"]
obstacles = [
    { name = "floor", point = ["0 mm", "0 mm"], normal = [0, 1] },
    { name = "pipe", kind = "circle", centre = ["0 mm", "-9 mm"], radius = "1 cm", inside = true },
]
contacts = [
    { name = "foot", side = "lower.bottom", obstacle = "floor" },
    { name = "joint", sides = ["upper.bottom", "lower.top"], pairing = "mortar", overlap = "0 mm", reach = "1 mm" },
]
supports = [
    { name = "pin", on = "lower", near = ["0 mm", "0 mm"], axis = "x" },
    { name = "guide", on = "upper.left", axis = "x", value = "0.001 mm" },
]
tractions = [{ name = "drag", side = "lower.right", value = ["0 MPa", "-1 MPa"] }]
pressures = [{ name = "press", side = "upper.top", value = "100 MPa" }]
point_loads = [{ name = "nail", on = "upper.top", force = ["0 N", "-1 N"] }]

[[bodies]]
name = "lower"
shape = { kind = "rectangle", element = "quad4", size = ["2 mm", "1 mm"], divisions = [4, 2], grading = 2 }
model = "plane-strain"
thickness = "1 cm"
modulus = "210 GPa"
poisson = 0.3
density = "7850 kg/m^3"

[[bodies]]
name = "upper"
mesh = { file = "upper.inp", unit = "mm" }
model = "plane-strain"
thickness = "10 mm"
modulus = "70 GPa"
poisson = 0.33
density = "0 kg/m^3"

[report]
methods = ["active-set"]
why = "the others are tried elsewhere"

[[expect]]
quantity = "contact force"
at = "foot"
value = "2000 N"
tolerance = 0.2
derivation = "about the pressure times 20 mm^2"

[[expect]]
quantity = "stress"
at = "lower"
near = ["1 mm", "1 mm"]
component = "yy"
value = "-100 MPa"
tolerance = 0.5
derivation = "about the pressure"
"""
MESH = """*NODE
1, 0, 1
2, 2, 1
3, 2, 2
4, 0, 2
*ELEMENT, TYPE=CPE4, ELSET=ALL
1, 1, 2, 3, 4
*SURFACE, NAME=bottom
1, S1
*SURFACE, NAME=top
1, S3
*NSET, NSET=left
1, 4
"""
MUTATIONS = {
    "missing set": (
        'side = "lower.bottom"',
        'side = "lower.bottm"',
        "contacts[0] ('foot'): mesh: there is no set 'bottm'",
    ),
    "missing side of a load": (
        '"upper.top", value',
        '"upper.up", value',
        "pressures[0] ('press'): mesh: there is no set",
    ),
    "missing set of a point load": ('on = "upper.top"', 'on = "upper.tip"', "point_loads[0] ('nail'): mesh: there is"),
    "missing set of a support": (
        'on = "upper.left"',
        'on = "upper.lift"',
        "supports[1] ('guide'): mesh: there is no set",
    ),
    "no set": ('on = "upper.left"', 'on = "upper"', "supports[1] ('guide'): on: expected a set of a body"),
    "a set and a point": ('on = "lower", near', 'on = "lower.left", near', "on: expected a body alone beside 'near'"),
    "missing body": (
        'side = "lower.right"',
        'side = "lover.right"',
        "tractions[0].side ('drag'): there is no body 'lover'",
    ),
    "missing body of a contact": (
        '["upper.bottom", ',
        '["uper.bottom", ',
        "contacts[1].sides[0] ('joint'): there is no",
    ),
    "missing body of a support": (
        'on = "lower", near',
        'on = "power", near',
        "supports[0].on ('pin'): there is no body",
    ),
    "a side without a body": ('side = "lower.right"', 'side = "right"', "side: expected a side of a body"),
    "missing obstacle": ('obstacle = "floor"', 'obstacle = "flor"', "there is no obstacle 'flor'; nearest: 'floor'"),
    "wrong element": ('element = "quad4"', 'element = "quad5"', "there is no element 'quad5'; nearest: 'quad"),
    "element of another dimension": (
        'element = "quad4"',
        'element = "hex8"',
        "bodies[0] ('lower'): shape: expected a kind",
    ),
    "unknown shape": (
        'kind = "rectangle"',
        'kind = "rectangel"',
        "there is no shape 'rectangel'; nearest: 'rectangle'",
    ),
    "unknown key of a shape": ("grading = 2", "grade = 2", "bodies[0].shape.grade ('lower'): there is no key 'grade'"),
    "another shape's key": ("grading = 2", 'radius = "1 mm"', "radius: a rectangle has no such key; its own: kind,"),
    "shape without a size": ('size = ["2 mm", "1 mm"], ', "", "size: expected for a rectangle, and missing"),
    "too few divisions": ("divisions = [4, 2]", "divisions = [4]", "divisions: expected 2 for a rectangle, got 1"),
    "no divisions": (
        "divisions = [4, 2]",
        "divisions = [4, 0]",
        "divisions[1] ('lower'): expected a number of at least 1, got",
    ),
    "half a division": (
        "divisions = [4, 2]",
        "divisions = [4, 1.5]",
        "divisions[1] ('lower'): expected a whole number",
    ),
    "grading below one": ("grading = 2", "grading = 0.5", "expected a ratio of sizes of at least 1, got 0.5"),
    "grading to nowhere": ("= 2", '= 2, towards = ["up"]', "bodies[0] ('lower'): shape: expected `towards`"),
    "towards without grading": (
        "grading = 2",
        'towards = ["top"]',
        "towards: expected with 'grading', without which",
    ),
    "size without a unit": ('size = ["2 mm", "1 mm"]', "size = [2, 1]", "bodies[0].shape.size[0] ('lower')"),
    "flat": ('size = ["2 mm", "1 mm"]', 'size = ["2 mm", "0 mm"]', "expected a positive number"),
    "negative modulus": (
        'modulus = "210 GPa"',
        'modulus = "-210 GPa"',
        "bodies[0].modulus ('lower'): expected a positive",
    ),
    "poisson a half": (
        "poisson = 0.3\n",
        "poisson = 0.5\n",
        "expected Poisson's ratio above -1 and below 0.5, got 0.5",
    ),
    "negative density": ('"7850 kg/m^3"', '"-7850 kg/m^3"', "bodies[0].density ('lower'): expected zero or a positive"),
    "density of another kind": ('"7850 kg/m^3"', '"7850 kg"', "bodies[0].density ('lower'): expected a density"),
    "gravity without density": (
        'density = "0 kg/m^3"',
        "",
        "bodies[1].density ('upper'): expected, since there is gravity",
    ),
    "no thickness": ('thickness = "1 cm"', "", "thickness: expected for the model 'plane-strain', and missing"),
    "two thicknesses": (
        'thickness = "1 cm"',
        'thickness = "2 cm"',
        "expected bodies of one thickness, got 10 mm and 2 cm",
    ),
    "unknown model": (
        'model = "plane-strain"\nthickness = "1 cm"',
        'model = "plane"',
        "bodies[0].model ('lower'): expected",
    ),
    "axisymmetric beside plane": (
        'model = "plane-strain"\nthickness = "1 cm"',
        'model = "axisymmetric"',
        "expected axisymmetric bodies only",
    ),
    "3d in a plane": (
        'model = "plane-strain"\nthickness = "10 mm"',
        'model = "3d"',
        "bodies[1].model ('upper'): expected a model for",
    ),
    "a model of another dimension": (
        'model = "plane-strain"\nthickness = "1 cm"',
        'model = "3d"',
        "model: expected one for a rectangle, got '3d'",
    ),
    "shape and mesh": ("mesh = {", 'shape = { kind = "disc" }, mesh = {', "expected TOML"),
    "mesh without a unit": (', unit = "mm" }', " }", "bodies[1].mesh.unit ('upper'): expected, and missing"),
    "mesh in newtons": (', unit = "mm" }', ', unit = "N" }', "unit: expected a unit of length"),
    "mesh file missing": ('"upper.inp"', '"uper.inp"', "bodies[1] ('upper'): mesh: there is no file"),
    "mesh part missing": (', unit = "mm" }', ', unit = "mm", part = "HALF" }', "bodies[1] ('upper'): upper.inp:"),
    "mesh of no format": ('"upper.inp"', '"bad.toml"', "bodies[1] ('upper'): bad.toml: meshlane cannot read it"),
    "body name with a full stop": ('name = "upper"', 'name = "upper.1"', "expected a body's name without a full stop"),
    "two bodies of one name": ('name = "upper"', 'name = "lower"', "bodies[1].name: expected distinct names"),
    "far from the body": (
        'near = ["0 mm", "0 mm"]',
        'near = ["0 m", "9 m"]',
        "supports[0] ('pin'): near: expected a node of the body 'lower' within",
    ),
    "near between nodes": (
        'near = ["0 mm", "0 mm"]',
        'near = ["0.2 mm", "0 mm"]',
        "supports[0] ('pin'): near: expected a node of the body 'lower' within 0.00601 of the point",
    ),
    "stress between nodes": (
        'near = ["1 mm", "1 mm"]',
        'near = ["1.1 mm", "1 mm"]',
        "got the nearest, node 8 at (1, 1), 0.1 away",
    ),
    "pressure of a node off the contact": (
        'quantity = "contact force"\nat = "foot"\nvalue = "2000 N"',
        'quantity = "contact pressure"\nat = "foot"\nnear = ["0 mm", "1 mm"]\nvalue = "200 MPa"',
        "near: expected a node of the contact, got node 2 of 'lower'",
    ),
    "near in space": (
        'near = ["0 mm", "0 mm"]',
        'near = ["0 m", "0 m", "0 m"]',
        "supports[0].near ('pin'): expected 2",
    ),
    "axis of another dimension": ('axis = "x" }', 'axis = "z" }', "supports[0].axis ('pin'): there is no axis 'z'"),
    "contradicting supports": (
        'axis = "x", value = "0.001 mm" }',
        'axis = "x" }, { name = "o", on = "upper.left", axis = "x", value = "1 mm" }',
        "supports: support of 'upper': node 0 along x is to move by 1",
    ),
    "force for a traction": ('"-1 MPa"]', '"-1 N"]', "tractions[0].value[1] ('drag'): expected a pressure"),
    "pressure for a force": ('force = ["0 N", "-1 N"]', 'force = ["0 N", "-1 Pa"]', "point_loads[0].force[1] ('nail')"),
    "traction in space": (
        '["0 MPa", "-1 MPa"]',
        '["0 MPa", "0 MPa", "-1 MPa"]',
        "tractions[0].value ('drag'): expected 2",
    ),
    "sides without pairing": (
        ', pairing = "mortar"',
        "",
        "pairing: expected 'mortar' or 'node-to-segment' for two sides",
    ),
    "unknown pairing": (
        '"mortar"',
        '"mortal"',
        "contacts[1].pairing ('joint'): expected 'mortar' or 'node-to-segment'",
    ),
    "pairing with an obstacle": (
        'obstacle = "floor"',
        'obstacle = "floor", pairing = "mortar"',
        "pairing: expected none with 'side'",
    ),
    "sides and an obstacle": ('pairing = "mortar"', 'pairing = "mortar", obstacle = "floor"', "got both"),
    "contact of a node": (
        'side = "lower.bottom"',
        'node = "lower"',
        "contacts[0] ('foot'): expected 'side' or 'sides'",
    ),
    "a body against itself": ('["upper.bottom", "lower.top"]', '["lower.top", "lower.top"]', "contacts[1] ('joint')"),
    "sides that face away": ('"lower.top"]', '"lower.bottom"]', "with a partner in reach"),
    "no radius": (', radius = "1 cm"', "", "obstacles[1] ('pipe'): radius: expected for a circle, and missing"),
    "no kind": (
        ', kind = "circle"',
        "",
        "obstacles[1] ('pipe'): kind: expected 'circle' or 'sphere' beside centre, inside, radius, and missing",
    ),
    "negative radius": ('radius = "1 cm"', 'radius = "-1 cm"', "obstacles[1].radius ('pipe'): expected a positive"),
    "a plane's key": (
        ", inside = true }",
        ", normal = [0, 1] }",
        "normal: a circle has no such key; its own: name, kind",
    ),
    "sphere in a plane": (
        '"circle"',
        '"sphere"',
        "obstacles[1].kind ('pipe'): a sphere does not exist in 2 dimensions",
    ),
    "inside an obstacle": (
        'point = ["0 mm", "0 mm"]',
        'point = ["0 mm", "1 mm"]',
        "lower.bottom: node 0 at (0, 0) is 1 inside 'floor' at the start: expected an overlap of at most",
    ),
    "two bottoms": ('"lower.top"', '"lower.bottom"', "contacts[1] ('joint'): expected sides that may touch"),
    "zero normal": ("normal = [0, 1]", "normal = [0, 0]", "obstacles[0].normal ('floor'): expected a direction"),
    "nodes beside bodies": ("[report]", '[[nodes]]\nname = "a"\nat = ["0 m", "0 m"]\n[report]', "nodes: expected none"),
    "fixed bodies": (
        'axes = ["x", "y"]',
        'axes = ["x", "y"]\nfixed = ["lower"]',
        "fixed: expected none in a scene of bodies",
    ),
    "other axes": ('axes = ["x", "y"]', 'axes = ["x", "z"]', "axes: expected ['x', 'y'] or ['x', 'y', 'z']"),
    "quantity of nodes": ('quantity = "contact force"', 'quantity = "normal force"', "is asked of scenes of nodes"),
    "quantity of no contact": (
        'at = "foot"',
        'at = "food"',
        "expect[0].at: there is no contact 'food'; nearest: 'foot'",
    ),
    "force for a pressure": ('value = "-100 MPa"', 'value = "-100 N"', "expect[1]: expected a stress"),
    "stress without component": ('component = "yy"', "", "the quantity 'stress' expects 'component' of the stress"),
    "stress of no point": ('near = ["1 mm", "1 mm"]\n', "", "the quantity 'stress' expects 'near' with a point"),
    "stress far away": (
        'near = ["1 mm", "1 mm"]',
        'near = ["1 m", "1 m"]',
        "near: expected a node of the body 'lower' within",
    ),
    "unknown component": ('component = "yy"', 'component = "yx"', "expect[1].component: expected 'xx', 'yy'"),
    "path with prescribed displacements": ("[report]", "[path]\nsteps = 2\n[report]", "supports[1].value ('guide')"),
    "report of no method": ('["active-set"]', '["active"]', "report.methods[0]: there is no method 'active'"),
    "report of nothing": ('["active-set"]', "[]", "report.methods: expected at least 1, got 0"),
}


def written(folder, text=GOOD, mesh=MESH):
    (folder / "upper.inp").write_text(mesh)
    file = folder / "bad.toml"
    # Names of sets in Abaqus files are in upper case.
    for name in ("bottom", "top", "left"):
        text = text.replace(f'"upper.{name}"', f'"upper.{name.upper()}"')
    file.write_text(text)
    return str(file)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("command", [["run"], ["explain", "--no-solve"]], ids=" ".join)
def test_the_good_file_is_good(command, tmp_path, capsys):
    accept(capsys, written(tmp_path), *command)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", MUTATIONS)
def test_a_wrong_file_is_refused_in_one_line(name, tmp_path, capsys):
    old, new, words = MUTATIONS[name]
    refuse(capsys, written(tmp_path, mutated(GOOD, old, new)), words)
