"""Load paths with friction that make no sense are refused in one line, with the file and the key."""

import pytest

from .refusals import accept, mutated, refuse

RUBBING = """
title = "Pressed, pushed and let go"
axes = ["x", "z"]
nodes = [{ name = "1", at = ["0 m", "0 m"] }]
springs = [{ name = "a", nodes = ["1"], direction = [1, 0], stiffness = "100 N/m" }]
obstacles = [{ name = "floor", point = ["0 m", "0 m"], normal = [0, 1] }]
contacts = [{ name = "foot", node = "1", obstacle = "floor", friction = 0.3 }]
loads = [
    { name = "weight", unknown = "1.z", value = "-10 N" },
    { name = "push", unknown = "1.x", value = "5 N" },
]
path = { events = "exact", corners = [{ weight = 1 }, { weight = 1, push = 1 }, { weight = 1 }] }

[[expect]]
quantity = "displacement"
at = "1.x"
time = 2
value = "20 mm"
derivation = "(5 N - 3 N) / 100 N/m"
"""
OF_FRICTION = {
    "a load that is not there": (
        "{ weight = 1, push = 1 }",
        "{ weight = 1, psuh = 1 }",
        "no load 'psuh'; nearest: 'push'",
    ),
    "a factor with a unit": ("push = 1 }", 'push = "1 N" }', "path.corners[1].push: expected a number"),
    "a load in no corner": ("{ weight = 1, push = 1 }", "{ weight = 1 }", "'push' (loads[1]) is in none"),
    "a load without a name": ('{ name = "push", ', "{ ", "loads[1].name: expected, since the load path has corners"),
    "no corner": (
        "[{ weight = 1 }, { weight = 1, push = 1 }, { weight = 1 }]",
        "[]",
        "path.corners: expected at least 1",
    ),
    "off the path": (
        "time = 2",
        "time = 2.5",
        "displacement 1.x at time 5/2: expected a step of the load path, nearest",
    ),
    "after its end": ("time = 2", "time = 3.5", "expect[0].time: expected one from 0 to 3, the end of the path"),
    "a load factor": (
        "time = 2",
        "load_factor = 0.5",
        "expect[0].load_factor: expected 'time', since the load path has",
    ),
    "an origin of slip": (
        "friction = 0.3",
        'friction = 0.3, slip_origin = ["0 m", "0 m"]',
        "a load path, which finds it",
    ),
    "an origin without friction": (
        "friction = 0.3",
        'slip_origin = ["0 m", "0 m"]',
        "slip_origin: expected with friction",
    ),
    "friction of what has none": (
        'quantity = "displacement"\nat = "1.x"\ntime = 2\nvalue = "20 mm"',
        'quantity = "friction resultant"\nalong = "x"\nat = "foot"\nvalue = "3 N"',
        "'friction resultant' is asked of scenes of bodies",
    ),
    "an event that never comes": (
        'quantity = "displacement"\nat = "1.x"\ntime = 2\nvalue = "20 mm"',
        'quantity = "event time"\nat = "foot"\nevent = "opened"\nvalue = "1"',
        "expected contact 'foot' to open on the load path; its events: closed at 0, slip at 1.6, stick at 2",
    ),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", OF_FRICTION)
def test_wrong_friction_and_corners_are_refused_in_one_line(name, tmp_path, capsys):
    old, new, words = OF_FRICTION[name]
    file = tmp_path / "rubbing.toml"
    file.write_text(mutated(RUBBING, old, new))
    refuse(capsys, str(file), words)


@pytest.mark.slow
def test_the_good_path_with_friction_is_good(tmp_path, capsys):
    file = tmp_path / "rubbing.toml"
    file.write_text(RUBBING)
    accept(capsys, str(file))
    accept(capsys, str(file), "explain", "--no-solve")
