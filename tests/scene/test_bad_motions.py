"""Motions that make no sense are refused in one line, with the file and the key, what came and what was expected."""

import pytest

from .refusals import accept, mutated, refuse

ROD = """
title = "A rod and a ball fall"
axes = ["x", "z"]
gravity = ["0 m/s^2", "-9.81 m/s^2"]
fixed = ["a"]
nodes = [
    { name = "a", at = ["0 m", "0 m"] },
    { name = "b", at = ["1 m", "0 m"] },
    { name = "c", at = ["2 m", "0 m"] },
]
bars = [{ name = "rod", nodes = ["a", "b"], area = "1 cm^2", modulus = "1 MPa", density = "7850 kg/m^3" }]
masses = [{ name = "ball", node = "c", mass = "1 kg" }]
obstacles = [{ name = "floor", point = ["0 m", "-1 m"], normal = [0, 1] }]
contacts = [{ name = "foot", node = "c", obstacle = "floor", friction = 0.3 }]

[motion]
duration = "20 ms"
time_step = "1 ms"
scheme = "moreau-jean"
theta = 0.75
velocities = [{ of = "c", value = ["1 m/s", "0 m/s"] }]
displacements = [{ of = "b.x", value = ["1 mm"] }]

[[expect]]
quantity = "velocity"
at = "c.x"
time = "10 ms"
value = "1 m/s"
derivation = "nothing touches it"
"""
CLAIM = 'quantity = "velocity"\nat = "c.x"\ntime = "10 ms"\nvalue = "1 m/s"'
WRONG = {
    "no density": (', density = "7850 kg/m^3"', "", "bars[0].density ('rod'): expected in a motion"),
    "negative density": (
        '"7850 kg',
        '"-7850 kg',
        "bars[0].density ('rod'): expected zero or a positive number, got '-78",
    ),
    "a density of another kind": (
        '"7850 kg/m^3"',
        '"7850 kg/m"',
        "bars[0].density ('rod'): expected a density such as",
    ),
    "a path too": ("[motion]", "path = { steps = 3 }\n[motion]", "motion: expected [motion] or [path], got both"),
    "a study": (
        "[[expect]]",
        '[[study]]\nmethod = "penalty"\npenalty = ["1 N/m"]\n[[expect]]',
        "study: expected none in a motion",
    ),
    "no duration": ('duration = "20 ms"\n', "", 'motion.duration: expected a time such as "2 ms", and missing'),
    "a duration without a unit": ('"20 ms"', "20", "motion.duration: expected a time such as"),
    "a negative duration": ('"20 ms"', '"-20 ms"', "motion.duration: expected a positive number, got '-20 ms'"),
    "a step of no time": ('time_step = "1 ms"', 'time_step = "0 s"', "motion.time_step: expected a positive number"),
    "a length for a time": ('time_step = "1 ms"', 'time_step = "1 mm"', "motion.time_step: expected a time such as"),
    "a million steps": (
        'time_step = "1 ms"',
        'time_step = "1 ns"',
        "motion: time_step: expected at most 1000000 steps",
    ),
    "a scheme that is none": ('"moreau-jean"', '"moreau-jeen"', "no scheme 'moreau-jeen'; nearest: 'moreau-jean'"),
    "a knob that is out of range": ("theta = 0.75", "theta = 0.25", "theta: expected a number from 0.5 to 1, got 0.25"),
    "a knob of another scheme": (
        '"moreau-jean"',
        '"newmark"',
        "theta: the scheme 'newmark' has none, only moreau-jean",
    ),
    "restitution beyond one": ("theta = 0.75", "restitution = 2", "restitution: expected a number from 0 to 1, got 2"),
    "no penalty": (
        'scheme = "moreau-jean"\ntheta = 0.75',
        'scheme = "penalty"',
        "penalty: expected for the scheme 'penalty', and missing",
    ),
    "a mass that is neither": ("theta = 0.75", 'mass = "lumpy"', "motion.mass: expected 'consistent' or 'lumped'"),
    "a key that is none": (
        "theta = 0.75",
        "thetta = 0.75",
        "motion.thetta: there is no key 'thetta'; nearest: 'theta'",
    ),
    "a start of nothing": (
        '{ of = "c", value',
        '{ of = "d", value',
        "motion.velocities[0].of: there is no bar or beam or node or",
    ),
    "a start with too few numbers": ('["1 m/s", "0 m/s"]', '["1 m/s"]', "motion.velocities[0].value ('c'): expected 2"),
    "a length for a velocity": (
        '["1 m/s", "0 m/s"]',
        '["1 m", "0 m"]',
        "motion.velocities[0].value[0]: expected a vel",
    ),
    "a start of what is fixed": ('{ of = "c", value', '{ of = "a", value', "expected 0 for 'a.x', which is fixed"),
    "two starts": (
        '{ of = "b.x", value = ["1 mm"] }',
        '{ of = "b.x", value = ["1 mm"] }, { of = "b", value = ["2 mm", "0 mm"] }',
        "motion.displacements[1] ('b'): expected 0.001 m for 'b.x', as motion.displacements[0] states it, got 0.002 m",
    ),
    "starts of two parts that share a node": (
        '{ of = "c", value = ["1 m/s", "0 m/s"] }',
        '{ of = "b", value = ["1 m/s", "2 m/s"] }, '
        '{ of = "rod", value = ["0 m/s", "0 m/s"], to = ["1 m/s", "-2 m/s"] }',
        "motion.velocities[1] ('rod'): expected 2.0 m/s for 'b.z', as motion.velocities[0] states it, got -2.0 m/s",
    ),
    "an end of a node": (
        'value = ["1 mm"] }',
        'value = ["1 mm"], to = ["2 mm"] }',
        "motion.displacements[0].to ('b.x'): expected of a bar or beam only",
    ),
    "a name of two things": (
        'name = "rod"',
        'name = "c"',
        "velocities[0].of: expected a name of one thing, got 'c', a bar",
    ),
    "no mass at all": (
        'masses = [{ name = "ball", node = "c", mass = "1 kg" }]',
        'springs = [{ name = "s", nodes = ["b", "c"], stiffness = "1 N/m" }]',
        "motion.mass: ",
    ),
    "an origin of slip": (
        "friction = 0.3",
        'friction = 0.3, slip_origin = ["0 m", "0 m"]',
        "slip_origin ('foot'): expected none in a motion, which finds it itself",
    ),
    "an overlap": (
        'displacements = [{ of = "b.x", value = ["1 mm"] }]',
        'displacements = [{ of = "c.z", value = ["-2 m"] }]',
        "motion.displacement: foot overlaps by 1 at the start",
    ),
    "a pseudo-time": (
        'time = "10 ms"',
        "time = 1",
        'expect[0].time: expected a time such as "2 ms" in a motion, got 1',
    ),
    "a time before it": ('time = "10 ms"', 'time = "-1 ms"', "expect[0].time: expected one from 0 s to 0.02 s"),
    "a time after it": ('time = "10 ms"', 'time = "21 ms"', "where the motion ends, got 21 ms"),
    "a load factor": ('time = "10 ms"', "load_factor = 2", "expect[0].load_factor: expected none in a motion"),
    "a claim of statics": (CLAIM, 'quantity = "reaction"\nat = "a.x"\nvalue = "1 N"', "'reaction' is asked of statics"),
    "an event at a number": (
        CLAIM,
        'quantity = "event time"\nat = "foot"\nevent = "closed"\nvalue = "1"',
        """expect[0]: 'event time' expects a time such as "2 ms" in a motion, got a number""",
    ),
    "an event number zero": (
        CLAIM,
        'quantity = "event time"\nat = "foot"\nevent = "closed"\noccurrence = 0\nvalue = "1 s"',
        "expect[0].occurrence: expected a number from 1 on, or from -1 on downwards",
    ),
    "a velocity in metres": ('value = "1 m/s"', 'value = "1 m"', "expected a velocity such as"),
    "momentum of nothing": (
        CLAIM,
        'quantity = "momentum"\nat = "road"\nalong = "x"\nvalue = "1 N*s"',
        "there is no moving part 'road'; nearest: 'rod'",
    ),
    "a time of an energy": (
        CLAIM,
        'quantity = "events"\nat = "foot"\ntime = "1 ms"\nvalue = "1"',
        "'events' depends on no time",
    ),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", WRONG)
def test_wrong_motions_are_refused_in_one_line(name, tmp_path, capsys):
    old, new, words = WRONG[name]
    file = tmp_path / "falling.toml"
    file.write_text(mutated(ROD, old, new))
    refuse(capsys, str(file), words)


def test_the_good_motion_is_good(tmp_path, capsys):
    file = tmp_path / "falling.toml"
    file.write_text(ROD)
    accept(capsys, str(file))
    accept(capsys, str(file), "explain", "--no-solve")


def test_a_motion_needs_a_mass(tmp_path, capsys):
    file = tmp_path / "light.toml"
    text = ROD.replace('masses = [{ name = "ball", node = "c", mass = "1 kg" }]', "").replace('"7850 kg', '"0 kg')
    spring = 'springs = [{ name = "s", nodes = ["b", "c"], stiffness = "1 N/m" }]\n[motion]'
    file.write_text(text.replace("[motion]", spring))
    refuse(capsys, str(file), "motion: expected a bar, beam, body or point mass that has mass, got none")


def test_an_unstable_step_is_refused_with_both_numbers(tmp_path, capsys):
    file = tmp_path / "falling.toml"
    text = ROD.replace('scheme = "moreau-jean"\ntheta = 0.75', 'scheme = "paoli-schatzman"')
    file.write_text(text.replace('time_step = "1 ms"', 'time_step = "0.2 s"').replace('"20 ms"', '"1 s"'))
    refuse(capsys, str(file), "motion.time_step: paoli-schatzman is stable up to 0.102307")
    file.write_text(text)
    accept(capsys, str(file))


STILL = ROD.split("[motion]")[0] + "[[expect]]\n"
OF_STATICS = {
    "a claim of a motion": (
        'quantity = "kinetic energy"\nvalue = "1 J"',
        "'kinetic energy' expects [motion], and there",
    ),
    "a velocity": (
        'quantity = "velocity"\nat = "c.x"\nvalue = "1 m/s"',
        "'velocity' expects [motion], and there is none",
    ),
    "a time": (
        'quantity = "gap"\nat = "foot"\ntime = "1 ms"\nvalue = "1 m"',
        "expect[0].time: expected a time only with [motion], got 1 ms",
    ),
    "an event": (
        'quantity = "event time"\nat = "foot"\nevent = "closed"\nvalue = "1 s"',
        "expect[0]: 'event time' expects a pseudo-time, a number, without [motion]",
    ),
}


@pytest.mark.parametrize("name", OF_STATICS)
def test_what_only_motions_have_is_refused_in_statics(name, tmp_path, capsys):
    claim, words = OF_STATICS[name]
    file = tmp_path / "still.toml"
    file.write_text(f'{STILL}{claim}\nderivation = "none"\n')
    refuse(capsys, str(file), words)


BODY = """
title = "A block falls"
axes = ["x", "y"]
gravity = ["0 m/s^2", "-9.81 m/s^2"]
obstacles = [{ name = "plane", point = ["0 m", "-1 m"], normal = [0, 1] }]
contacts = [{ name = "foot", side = "block.bottom", obstacle = "plane" }]
supports = [{ name = "middle", on = "block.left", axis = "x" }]
motion = { duration = "10 ms", time_step = "1 ms", velocities = [{ of = "block", value = ["0 m/s", "-1 m/s"] }] }

[[bodies]]
name = "block"
shape = { kind = "rectangle", element = "quad4", size = ["1 m", "1 m"], divisions = [1, 1] }
model = "plane-strain"
thickness = "1 m"
modulus = "1 MPa"
poisson = 0.3
density = "1000 kg/m^3"
"""
OF_BODIES = {
    "no density": ('density = "1000 kg/m^3"\n', "", "bodies[0].density ('block'): expected"),
    "no weight": ('"1000 kg/m^3"', '"0 kg/m^3"', "bodies[0].density ('block'): expected a positive number in a motion"),
    "a negative density": ('"1000 kg/m^3"', '"-1 kg/m^3"', "bodies[0].density ('block'): expected zero or a positive"),
    "a support that moves": (
        'axis = "x" }',
        'axis = "x", value = "1 mm" }',
        "supports[0].value ('middle'): expected 0 in a motion, which holds supports still, got 1 mm",
    ),
    "a start of a side": ('of = "block"', 'of = "block.top"', "velocities[0].of: there is no body 'block.top'"),
    "a start of what is held": (
        '["0 m/s", "-1 m/s"]',
        '["1 m/s", "0 m/s"]',
        "motion.velocities[0] ('block'): expected 0",
    ),
}


@pytest.mark.parametrize("name", OF_BODIES)
def test_wrong_motions_of_bodies_are_refused_in_one_line(name, tmp_path, capsys):
    old, new, words = OF_BODIES[name]
    file = tmp_path / "block.toml"
    file.write_text(mutated(BODY, old, new))
    refuse(capsys, str(file), words)


def test_a_membrane_does_not_move(tmp_path, capsys):
    file = tmp_path / "membrane.toml"
    file.write_text(
        'title = "m"\naxes = ["x", "y", "z"]\nmotion = { duration = "1 s", time_step = "1 s" }\n'
        '[[membranes]]\nname = "m"\ntension = "1 N/m"\n'
        'shape = { kind = "disc", element = "tri3", radius = "1 m", divisions = [2, 2] }\n'
    )
    refuse(capsys, str(file), "membranes: expected none in a motion, they have no mass")


def test_check_refuses_a_motion(tmp_path, capsys):
    from contactqp.cli import main

    file = tmp_path / "falling.toml"
    file.write_text(ROD)
    with pytest.raises(SystemExit) as exit_:
        main(["check", str(file), str(file)])
    assert exit_.value.code == 2
    assert "check: a motion has no answer of its own at its end" in capsys.readouterr().err
