"""Large deformations that make no sense are refused in one line, with the file and the key."""

import pytest

from .refusals import accept, mutated, refuse

ARCH = """
title = "An arch over a floor"
deformation = "large"
axes = ["x", "z"]
nodes = [
    { name = "l", at = ["-1 m", "0 m"] },
    { name = "t", at = ["0 m", "0.2 m"] },
    { name = "r", at = ["1 m", "0 m"] },
]
bars = [
    { name = "a", nodes = ["l", "t"], area = "1 m^2", modulus = "100 Pa", law = "green" },
    { name = "b", nodes = ["t", "r"], area = "1 m^2", modulus = "100 Pa" },
]
fixed = ["l", "r"]
obstacles = [{ name = "floor", point = ["0 m", "-0.1 m"], normal = [0, 1] }]
contacts = [{ name = "foot", node = "t", obstacle = "floor" }]
loads = [{ name = "down", unknown = "t.z", value = "-1 N" }]
path = { steps = 4 }

[[expect]]
quantity = "displacement"
at = "t.z"
value = "-0.3 m"
derivation = "on the floor"
"""
PATH = "path = { steps = 4 }"
BY_NODE = 'path = { control = "displacement", controlled = "t.z", target = "-0.2 m" }'
CLAIM = 'quantity = "displacement"\nat = "t.z"\nvalue = "-0.3 m"'
WRONG = {
    "a deformation that is none": ('"large"', '"huge"', "deformation: expected 'small' or 'large', got"),
    "no path": (PATH, "", "path: expected with deformation = 'large', the path on which the loads grow, and missing"),
    "a law that is none": ('"green"', '"grean"', "bars[0].law ('a'): expected 'green', 'engineering' or 'logarithmic'"),
    "exact events": (PATH, 'path = { events = "exact" }', "path.events: expected none with deformation = 'large'"),
    "a spring": (
        PATH,
        PATH + '\nsprings = [{ name = "s", nodes = ["t"], direction = [1, 0], stiffness = "1 N/m" }]',
        "springs: expected none with deformation = 'large', which is offered of bars",
    ),
    "a beam": (
        PATH,
        PATH + '\nbeams = [{ name = "s", nodes = ["l", "t"], area = "1 m^2", modulus = "1 Pa", inertia = "1 m^4" }]',
        "beams: expected none with deformation = 'large'",
    ),
    "a string": (
        PATH,
        PATH + '\nstrings = [{ name = "s", nodes = ["l", "t"], tension = "1 N" }]',
        "strings: expected none with deformation = 'large'",
    ),
    "a tie": (
        PATH,
        PATH + '\nties = [{ name = "s", terms = [{ unknown = "t.x", factor = 1 }], value = "0 m" }]',
        "ties: expected none with deformation = 'large'",
    ),
    "a motion": (
        PATH,
        'motion = { duration = "1 s", time_step = "1 s" }',
        "motion: expected none with deformation = 'large'",
    ),
    "two nodes in contact": (
        'node = "t", obstacle = "floor"',
        'nodes = ["l", "t"]',
        "contacts[0] ('foot'): expected 'node' and 'obstacle' with deformation = 'large'",
    ),
    "an obstacle of space": (
        'name = "floor", point = ["0 m", "-0.1 m"], normal = [0, 1]',
        'name = "floor", kind = "sphere", centre = ["0 m", "-1 m"], radius = "0.9 m"',
        "obstacles[0].kind ('floor'): a sphere does not exist in 2 dimensions",
    ),
    "a gap along an axis": (
        'name = "floor", point = ["0 m", "-0.1 m"], normal = [0, 1]',
        'name = "floor", kind = "paraboloid", apex = ["0 m", "-0.1 m"], axis = [0, 1], radius = "0.9 m"',
        "obstacles[0].measure ('floor'): expected 'normal' with deformation = 'large'",
    ),
    "a control that is none": (
        PATH,
        'path = { control = "force" }',
        "path.control: expected 'load', 'displacement' or",
    ),
    "nothing controlled": (
        PATH,
        'path = { control = "displacement", target = "1 m" }',
        "path: controlled: expected with control = 'displacement', and missing",
    ),
    "no target": (
        PATH,
        'path = { control = "displacement", controlled = "t.z" }',
        "path: target: expected with control = 'displacement', and missing",
    ),
    "a target without a unit": (
        PATH,
        'path = { control = "displacement", controlled = "t.z", target = -0.2 }',
        "path.target: expected a length such as",
    ),
    "a control of a fixed unknown": (PATH, BY_NODE.replace("t.z", "l.z"), "path.controlled: there is no unknown 'l.z'"),
    "an arc of load control": (
        PATH,
        'path = { arc_length = "1 cm" }',
        "path: arc_length: expected with control = 'arc-length' only, got it with 'load'",
    ),
    "an arc of no length": (
        PATH,
        'path = { control = "arc-length", arc_length = "0 cm" }',
        "path.arc_length: expected a positive number",
    ),
    "corners of an arc": (
        PATH,
        'path = { control = "arc-length", corners = [{ down = 1 }] }',
        "path.corners: expected none with control = 'arc-length', whose load factor follows",
    ),
    "friction on an arc": (
        'obstacle = "floor" }]\nloads = [{ name = "down", unknown = "t.z", value = "-1 N" }]\n' + PATH,
        'obstacle = "floor", friction = 0.3 }]\nloads = [{ name = "down", unknown = "t.z", value = "-1 N" }]\n'
        + BY_NODE,
        "contacts[0].friction ('foot'): expected none with control = 'displacement': friction needs control = 'load'",
    ),
    "a time between steps": (
        CLAIM,
        CLAIM + "\ntime = 0.3",
        "at time 3/10: expected a step of the path, nearest: load factor 0.25",
    ),
    "a time of an arc": (
        PATH + "\n\n[[expect]]\n" + CLAIM,
        'path = { control = "arc-length" }\n\n[[expect]]\n' + CLAIM + "\ntime = 0.5",
        "expect[0].time: expected none with control = 'arc-length', whose load factor comes and goes",
    ),
    "a time of displacement control": (
        PATH + "\n\n[[expect]]\n" + CLAIM,
        BY_NODE + "\n\n[[expect]]\n" + CLAIM + "\nload_factor = 0.5",
        "expect[0].load_factor: expected 'reached' with control = 'displacement'",
    ),
    "a place that is not reached": (
        PATH + "\n\n[[expect]]\n" + CLAIM,
        BY_NODE + "\n\n[[expect]]\n" + CLAIM + '\nreached = "-0.11 m"',
        "where -0.11 m is reached: expected a step of the path, nearest: t.z -0.1",
    ),
    "a place of load control": (
        CLAIM,
        CLAIM + '\nreached = "-0.1 m"',
        "expect[0].reached: expected with control = 'di",
    ),
    "a limit load of load control": (
        CLAIM,
        'quantity = "limit load"\nat = "t.z"\nvalue = "1 N"',
        "expect[0].quantity: 'limit load' expects control = 'displacement' or 'arc-length'",
    ),
    "a snap on an arc": (
        PATH + "\n\n[[expect]]\n" + CLAIM,
        BY_NODE + '\n\n[[expect]]\nquantity = "snap-through load factor"\nvalue = "1"',
        "'snap-through load factor' expects control = 'load', got 'displacement'",
    ),
    "a snap that does not come": (
        CLAIM,
        'quantity = "snap-through load factor"\noccurrence = 2\nvalue = "1"',
        "expected 2 snap-throughs or more on the path, got one at 0.29032",
    ),
    "a stiffness": (
        CLAIM,
        'quantity = "stiffness"\nat = "t.z"\nalong = "t.z"\nvalue = "1 N/m"',
        "'stiffness' means nothing with deformation = 'large'",
    ),
    "a slip": (CLAIM, 'quantity = "tie rank"\nvalue = "1"', "'tie rank' means nothing with deformation = 'large'"),
    "a number of what is not counted": (
        CLAIM,
        CLAIM + "\noccurrence = 2",
        "the quantity 'displacement' expects no 'occurrence'",
    ),
    "both a place and a time": (CLAIM, CLAIM + '\nreached = "-0.1 m"\ntime = 1', "expected 'reached' or a load factor"),
}


@pytest.mark.sampled(9)
@pytest.mark.parametrize("name", WRONG)
def test_wrong_large_deformations_are_refused_in_one_line(name, tmp_path, capsys):
    old, new, words = WRONG[name]
    file = tmp_path / "arch.toml"
    file.write_text(mutated(ARCH, old, new))
    refuse(capsys, str(file), words)


BY_ARC = 'path = { control = "arc-length", arc_length = "2 cm", steps = 5 }'


@pytest.mark.sampled(6)
@pytest.mark.parametrize("path", [BY_NODE, PATH, BY_ARC])
@pytest.mark.parametrize("command", ["explain", "run"])
def test_the_good_arch_is_good(tmp_path, capsys, command, path):
    file = tmp_path / "arch.toml"
    file.write_text(ARCH.replace(PATH, path).split("[[expect]]")[0] + CLAIM_OF_NOTHING)
    accept(capsys, str(file), command)


CLAIM_OF_NOTHING = (
    '[[expect]]\nquantity = "displacement"\nat = "t.x"\nvalue = "0 m"\ntolerance = "1 um"\nderivation = "-"'
)
SMALL = ARCH.replace('deformation = "large"\n', "").replace(', law = "green"', "")
OF_SMALL = {
    "a law": (
        '"100 Pa" },\n    { name = "b"',
        '"100 Pa", law = "green" },\n    { name = "b"',
        "bars[0].law ('a'): exp",
    ),
    "a control": (PATH, 'path = { control = "load" }', "path.control: expected with deformation = 'large' only"),
    "a limit load": (CLAIM, 'quantity = "limit load"\nat = "t.z"\nvalue = "1 N"', "expects deformation = 'large'"),
    "a load factor": (CLAIM, 'quantity = "load factor"\nvalue = "1"', "'load factor' expects deformation = 'large'"),
    "a place": (CLAIM, CLAIM + '\nreached = "-0.1 m"', "expect[0].reached: expected with deformation = 'large' only"),
    "divisions": ('"100 Pa" },\n    { name = "b"', '"100 Pa", divisions = 2 },\n    { name = "b"', "bars[0].divisions"),
    "a ball": (
        'name = "floor", point = ["0 m", "-0.1 m"], normal = [0, 1]',
        'name = "floor", kind = "circle", centre = ["0 m", "-1 m"], radius = "0.9 m"',
        "expected a plane for nodes, got 'circle': round obstacles take deformation = 'large'",
    ),
}


@pytest.mark.parametrize("name", OF_SMALL)
def test_what_only_large_deformations_have_is_refused_elsewhere(name, tmp_path, capsys):
    old, new, words = OF_SMALL[name]
    file = tmp_path / "arch.toml"
    file.write_text(mutated(SMALL, old, new))
    refuse(capsys, str(file), words)


def test_check_refuses_a_large_deformation(tmp_path, capsys):
    file = tmp_path / "arch.toml"
    file.write_text(ARCH)
    from contactqp.cli import main

    with pytest.raises(SystemExit) as exit_:
        main(["check", str(file), str(file)])
    assert exit_.value.code == 2
    assert "check: a large deformation has no problem of its own at its end" in capsys.readouterr().err


def test_bodies_and_one_axis_are_refused(tmp_path, capsys):
    file = tmp_path / "block.toml"
    body = 'name = "b"\nshape = { kind = "rectangle", element = "quad4", size = ["1 m", "1 m"], divisions = [1, 1] }\n'
    file.write_text(
        f'title = "b"\ndeformation = "large"\naxes = ["x", "y"]\n[[bodies]]\n{body}model = "plane-strain"\n'
        'thickness = "1 m"\nmodulus = "1 Pa"\npoisson = 0.3\n'
    )
    refuse(capsys, str(file), "bodies: expected none with deformation = 'large'")
    file.write_text(
        'title = "b"\ndeformation = "large"\naxes = ["x"]\npath = {}\nnodes = [{ name = "n", at = ["0 m"] }]\n'
    )
    refuse(capsys, str(file), "axes: expected two or three with deformation = 'large', got one")


def test_a_path_that_breaks_off_ends_with_what_there_is(tmp_path, capsys):
    """Displacement control runs onto a floor: exit 1, one line why, and events and limit points so far."""
    from contactqp.cli import main

    file = tmp_path / "arch.toml"
    file.write_text(ARCH.replace(PATH, BY_NODE.replace("-0.2 m", "-0.5 m")))
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(file)])
    captured = capsys.readouterr()
    assert exit_.value.code == 1
    assert captured.err.count("\n") == 1
    assert str(file) in captured.err
    assert "t.z can go no further" in captured.err
    assert "Traceback" not in captured.err + captured.out
    assert "instants so far, to load factor" in captured.out
    assert "closed" in captured.out
    assert "maximum" in captured.out
    assert "0.290327" in captured.out
