"""Every wrong case file is refused by the command line: exit code 2, one line, the file, the key, what was expected."""

import os
import time
from pathlib import Path

import pytest

from contactqp.cli import main

from .refusals import accept, complaint, mutated, refuse

GOOD = """
title = "Everything that a scene can have"
units = { length = "m", force = "kN" }
axes = ["x", "z"]
gravity = ["0 m/s^2", "-9.81 m/s^2"]
fixed = ["root", "hinge.x"]
nodes = [
    { name = "root", at = ["0 m", "0 m"] },
    { name = "tip", at = ["2 m", "0 m"] },
    { name = "hinge", at = ["2 m", "1 m"] },
    { name = "foot", at = ["3 m", "0 m"] },
]
beams = [{ name = "beam", nodes = ["root", "tip"], area = "30 cm^2", inertia = "2000 cm^4", modulus = "210 GPa" }]
bars = [{ name = "rod", nodes = ["tip", "hinge"], area = "15 cm^2", modulus = "2.1e8 kN/m^2" }]
springs = [
    { name = "soil", nodes = ["hinge"], direction = [0, 1], stiffness = "100 kN/m" },
    { name = "link", nodes = ["tip", "foot"], stiffness = "200 kN/m" },
]
strings = [{ name = "wire", nodes = ["root", "tip", "foot"], tension = "5 kN" }]
masses = [{ name = "weight", node = "foot", mass = "2 t" }]
matrices = [{ name = "K", unknowns = ["foot.x", "foot.z"], unit = "kN/m", rows = [[100, 0], [0, 100]] }]
obstacles = [{ name = "floor", point = ["0 m", "-1 mm"], normal = [0, 1] }]
contacts = [{ name = "tip on floor", node = "tip", obstacle = "floor" }, { name = "pair", nodes = ["foot", "tip"] }]
loads = [{ unknown = "tip.z", value = "-20 kN" }, { unknown = "tip.theta", value = "1 kN*m" }]
line_loads = [{ name = "snow", string = "wire", value = ["0 kN/m", "-1 kN/m"] }]
path = { steps = 4, events = "exact" }

[[ties]]
name = "together"
terms = [{ unknown = "hinge.z", factor = 1 }, { unknown = "tip.theta", factor = "0.5 m" }]
value = "0 m"

[[study]]
method = "penalty"
penalty = ["1e5 kN/m"]

[[expect]]
quantity = "status"
at = "tip on floor"
value = "closed"
derivation = "the load"

[[expect]]
quantity = "gap"
at = "tip on floor"
value = "0 m"
tolerance = "1e-9 m"
derivation = "the load"

[[published]]
quantity = "closing load factor"
at = "tip on floor"
printed = "0.5"
verdict = "wrong"
where = "nowhere"
why = "invented"
"""

# What is replaced, by what, and words that the message must have.
MUTATIONS = {
    "missing unit": ('area = "15 cm^2"', 'area = "15"', "bars[0].area ('rod'): expected an area"),
    "a number, not a text": ('area = "15 cm^2"', "area = 15", "a number without a unit"),
    "wrong dimension": ('area = "15 cm^2"', 'area = "15 cm"', "which is a length"),
    "unknown unit": ('"2.1e8 kN/m^2"', '"2.1e8 KN/m^2"', "unit 'KN' is unknown (nearest: kN)"),
    "mass for a length": ('"-1 mm"', '"-1 kg"', "obstacles[0].point[1] ('floor'): expected a length"),
    "negative area": ('area = "15 cm^2"', 'area = "-15 cm^2"', "expected a positive number"),
    "no area": ('area = "15 cm^2"', 'area = "0 cm^2"', "expected a positive number"),
    "negative modulus": ('modulus = "210 GPa"', 'modulus = "-210 GPa"', "beams[0].modulus ('beam')"),
    "negative stiffness": ('stiffness = "100 kN/m"', 'stiffness = "-100 kN/m"', "springs[0].stiffness ('soil')"),
    "no tension": ('tension = "5 kN"', 'tension = "0 kN"', "strings[0].tension ('wire'): expected a positive number"),
    "tension of a membrane": (
        'tension = "5 kN"',
        'tension = "5 kN/m"',
        "strings[0].tension ('wire'): expected a force",
    ),
    "negative mass": ('mass = "2 t"', 'mass = "-2 t"', "masses[0].mass"),
    "negative inertia": ('inertia = "2000', 'inertia = "-2000', "beams[0].inertia"),
    "nan": ('"15 cm^2"', '"nan cm^2"', "expected an area"),
    "bare nan": (
        "normal = [0, 1]",
        "normal = [0, nan]",
        "obstacles[0].normal[1] ('floor'): expected a number, got NaN",
    ),
    "infinite": ('value = "-20 kN"', 'value = "-inf kN"', "loads[0].value: expected a force"),
    "huge": ('"15 cm^2"', '"1e9999999999 cm^2"', "out of range"),
    "huge integer": ("steps = 4", "steps = " + 5000 * "9", "expected TOML"),
    "there is no key": ('area = "15', 'aera = "15', "bars[0].aera ('rod'): there is no key 'aera'; nearest: 'area'"),
    "unknown top key": ("gravity = [", "gravitation = [", "there is no key 'gravitation'; nearest: 'gravity'"),
    "unknown key in units": ('force = "kN"', 'froce = "kN"', "units.froce: there is no key 'froce'; nearest: 'force'"),
    "missing key": (
        ', modulus = "2.1e8 kN/m^2"',
        "",
        "bars[0].modulus ('rod'): expected a modulus such as \"210 GPa\", and missing",
    ),
    "no title": ('title = "Everything that a scene can have"', "", "title: expected, and missing"),
    "title is a number": (
        'title = "Everything that a scene can have"',
        "title = 3",
        "title: expected a name in quotes",
    ),
    "empty name": ('name = "rod"', 'name = " "', "bars[0].name"),
    "name is a number": ('name = "rod"', "name = 3", "bars[0].name: expected a name in quotes"),
    "node name with a full stop": ('"tip", at', '"tip.a", at', "without a full stop"),
    "no nodes": ('nodes = ["tip", "hinge"]', "nodes = []", "bars[0].nodes ('rod'): expected at least 2, got 0"),
    "three nodes": ('nodes = ["tip", "hinge"]', 'nodes = ["tip", "hinge", "root"]', "expected at most 2, got 3"),
    "there is no node": (
        'nodes = ["tip", "hinge"]',
        'nodes = ["tpi", "hinge"]',
        "there is no node 'tpi'; nearest: 'tip'",
    ),
    "unknown node of a mass": ('node = "foot", mass', 'node = "shoe", mass', "masses[0].node ('weight')"),
    "unknown node of a contact": ('node = "tip", obst', 'node = "tap", obst', "contacts[0].node ('tip on floor')"),
    "bar from a node to itself": ('nodes = ["tip", "hinge"]', 'nodes = ["tip", "tip"]', "two different nodes"),
    "zero-length bar": ('at = ["2 m", "1 m"]', 'at = ["2 m", "0 m"]', "zero length between 'tip' and 'hinge'"),
    "string of one node": ('["root", "tip", "foot"]', '["root"]', "strings[0].nodes ('wire'): expected at least 2"),
    "string to nowhere": (
        '["root", "tip", "foot"]',
        '["root", "toe"]',
        "strings[0].nodes[1] ('wire'): there is no node",
    ),
    "string that stands still": (
        '["root", "tip", "foot"]',
        '["root", "tip", "tip"]',
        "strings[0].nodes ('wire'): expected two",
    ),
    "string around a corner": ('["root", "tip", "foot"]', '["root", "tip", "hinge"]', "got a turn at 'tip'"),
    "string that comes back": ('["root", "tip", "foot"]', '["root", "foot", "tip"]', "got a turn at 'foot'"),
    "load on no string": (
        'string = "wire"',
        'string = "wier"',
        "line_loads[0].string ('snow'): there is no string 'wier'",
    ),
    "load on no beam": ('string = "wire"', 'beam = "wire"', "line_loads[0].beam ('snow'): there is no beam 'wire'"),
    "load on nothing": (', string = "wire"', "", "line_loads[0] ('snow'): expected 'string' or 'beam', got none"),
    "load on two": (
        'string = "wire"',
        'string = "wire", beam = "wire"',
        "line_loads[0] ('snow'): expected 'string' or 'beam', got both",
    ),
    "force on a string": ('["0 kN/m", "-1 kN/m"]', '["0 kN", "-1 kN"]', "expected a force per length"),
    "load of another dimension": (
        '["0 kN/m", "-1 kN/m"]',
        '["0 kN/m", "-1 kN/m", "0 kN/m"]',
        "line_loads[0].value ('snow'): expected 2",
    ),
    "duplicate node": ('"hinge", at', '"tip", at', "nodes[2].name: expected distinct names, got 'tip'"),
    "duplicate bar": (
        '{ name = "rod"',
        '{ name = "rod", nodes = ["root", "tip"], area = "1 m^2", modulus = "1 Pa" }, { name = "rod"',
        "bars[1].name",
    ),
    "duplicate contact": ('name = "pair"', 'name = "tip on floor"', "contacts[1].name: expected distinct names"),
    "contact without obstacle": (', obstacle = "floor"', "", "contacts[0] ('tip on floor'): expected 'obstacle'"),
    "contact with nothing": (', node = "tip", obstacle = "floor"', "", "contacts[0] ('tip on floor'): expected 'node'"),
    "contact with both": ('nodes = ["foot", "tip"] }', 'nodes = ["foot", "tip"], node = "tip" }', "got both"),
    "contact with a direction and an obstacle": (
        'obstacle = "floor" }',
        'obstacle = "floor", direction = [0, 1] }',
        "direction",
    ),
    "there is no obstacle": (
        'obstacle = "floor"',
        'obstacle = "flor"',
        "there is no obstacle 'flor'; nearest: 'floor'",
    ),
    "contact of a fixed node": ('node = "tip", obstacle', 'node = "root", obstacle', "expected a node that can move"),
    "negative friction": ('obstacle = "floor" }', 'obstacle = "floor", friction = -0.3 }', "not negative, got -0.3"),
    "zero normal": ("normal = [0, 1]", "normal = [0, 0]", "obstacles[0].normal ('floor'): expected a direction"),
    "normal of another dimension": ("normal = [0, 1]", "normal = [0, 0, 1]", "expected 2 components"),
    "point of another dimension": (
        'at = ["3 m", "0 m"]',
        'at = ["3 m"]',
        "nodes[3].at ('foot'): expected 2 components",
    ),
    "spring without direction": ("direction = [0, 1], ", "", "springs[0].direction ('soil'): expected for a spring to"),
    "spring with a zero direction": ("direction = [0, 1]", "direction = [0, 0]", "expected a direction"),
    "load on an there is no unknown": (
        'unknown = "tip.z"',
        'unknown = "tip.y"',
        "loads[0].unknown: there is no unknown 'tip.y'",
    ),
    "load on a support": ('unknown = "tip.z", value', 'unknown = "root.z", value', "'root.z', which is fixed"),
    "load twice": (
        '{ unknown = "tip.theta", value = "1 kN*m" }',
        '{ unknown = "tip.z", value = "1 kN" }',
        "'tip.z' twice",
    ),
    "moment on a displacement": ('value = "-20 kN"', 'value = "-20 kN*m"', "loads[0].value: expected a force"),
    "rotation without a beam": ('unknown = "tip.theta", value', 'unknown = "foot.theta", value', "no beam ends there"),
    "fixed twice": ('"hinge.x"]', '"hinge.x", "hinge.x"]', "fixed[2]: expected distinct names"),
    "fixed nowhere": ('"hinge.x"]', '"hinge.q"]', "fixed[1]: there is no unknown 'hinge.q'"),
    "tie with a number for a lever": ('factor = "0.5 m"', "factor = 0.5", "expected a length (its lever)"),
    "tie with a length for a factor": ("factor = 1 }", 'factor = "1 m" }', "a number without a unit"),
    "tie with a zero factor": ("factor = 1 }", "factor = 0 }", "expected a factor that is not zero"),
    "tie without terms": (
        'terms = [{ unknown = "hinge.z", factor = 1 }, { unknown = "tip.theta", factor = "0.5 m" }]',
        "terms = []",
        "ties[0].terms ('together')",
    ),
    "tie of fixed unknowns": (
        '[{ unknown = "hinge.z", factor = 1 }, { unknown = "tip.theta", factor = "0.5 m" }]',
        '[{ unknown = "root.z", factor = 1 }]',
        "expected a free unknown",
    ),
    "tie value without a unit": ('value = "0 m"\n\n[[study]]', "value = 0\n\n[[study]]", "ties[0].value ('together')"),
    "matrix that is not square": ("[[100, 0], [0, 100]]", "[[100, 0]]", "matrices[0] ('K'): expected 2 rows"),
    "matrix with a wrong unit": ('unit = "kN/m"', 'unit = "kN"', "unit: expected a unit of stiffness"),
    "matrix on a rotation": ('["foot.x", "foot.z"]', '["foot.x", "tip.theta"]', "got the rotation 'tip.theta'"),
    "matrix that is not symmetric": ("[[100, 0], [0, 100]]", "[[100, 5], [0, 100]]", "stiffness: expected symmetric"),
    "matrix that is indefinite": (
        "[[100, 0], [0, 100]]",
        "[[-1e9, 0], [0, 100]]",
        "stiffness: expected positive semidefinite",
    ),
    "units of the wrong kind": ('length = "m"', 'length = "kN"', "units: length: expected a unit of length"),
    "unknown axis": ('axes = ["x", "z"]', 'axes = ["x", "w"]', "axes[1]: expected 'x', 'y' or 'z'"),
    "an axis twice": ('axes = ["x", "z"]', 'axes = ["x", "x"]', "axes: expected distinct axes"),
    "no axes": ('axes = ["x", "z"]', "axes = []", "axes: expected at least 1"),
    "mass without gravity": ('gravity = ["0 m/s^2", "-9.81 m/s^2"]', "", "gravity: expected, since masses[0]"),
    "a loose node": (
        '{ name = "foot", at',
        '{ name = "lost", at = ["9 m", "9 m"] }, { name = "foot", at',
        "nodes[3] ('lost'): expected an element",
    ),
    "no steps": ("steps = 4", "steps = 0", "path.steps: expected a number of at least 1, got 0"),
    "a contact of a node with itself": (
        'nodes = ["foot", "tip"] }]',
        'nodes = ["foot", "foot"] }]',
        "nodes: expected two that may touch each other, got 'foot' twice",
    ),
    "a tolerance in another unit": (
        'tolerance = "1e-9 m"',
        'tolerance = "1e-9 N"',
        "tolerance: expected a part of the value, or one in its unit, got 1e-9 N",
    ),
    "half a step": ("steps = 4", "steps = 4.5", "path.steps: expected a whole number, got 4.5 (number)"),
    "other events": ('events = "exact"', 'events = "about"', "path.events: expected 'exact'"),
    "a list for a table": (
        'path = { steps = 4, events = "exact" }',
        "path = [4]",
        "path: expected a table, got a list",
    ),
    "a table for a list": ('["root", "hinge.x"]', "{ root = 1 }", "fixed: expected a list, got a table"),
    "there is no quantity": ('quantity = "gap"', 'quantity = "gab"', "there is no quantity 'gab'; nearest: 'gap'"),
    "expectation of nothing": (
        'quantity = "gap"\nat = "tip on floor"',
        'quantity = "gap"',
        "expects 'at' naming the contact",
    ),
    "expectation of an there is no contact": (
        'quantity = "gap"\nat = "tip on floor"',
        'quantity = "gap"\nat = "wall"',
        "expect[1].at: there is no contact",
    ),
    "zero with a relative tolerance": ('tolerance = "1e-9 m"', "tolerance = 1e-9", "since the value is zero"),
    "there is no status": ('value = "closed"', 'value = "close"', "there is no status 'close'; nearest: 'closed'"),
    "expectation of a wrong dimension": (
        'value = "0 m"\ntolerance',
        'value = "0 kN"\ntolerance',
        "expect[1]: expected a length",
    ),
    "unknown verdict": ('verdict = "wrong"', 'verdict = "maybe"', "published[0].verdict: expected 'right' or 'wrong'"),
    "study without a knob": ('penalty = ["1e5 kN/m"]', "", "study[0]: expected the values of one knob"),
    "broken TOML": ('title = "Everything', 'title = "Everything\n', "expected TOML"),
    "a key twice": ('title = "Every', 'title = "a"\ntitle = "Every', "expected TOML"),
}


def test_the_good_file_is_good(tmp_path, capsys):
    file = tmp_path / "good.toml"
    file.write_text(GOOD)
    accept(capsys, str(file), "explain")


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", MUTATIONS)
def test_a_wrong_file_is_refused_in_one_line(name, tmp_path, capsys):
    old, new, words = MUTATIONS[name]
    file = tmp_path / "bad.toml"
    file.write_text(mutated(GOOD, old, new))
    refuse(capsys, str(file), words)


@pytest.mark.parametrize("command", ["run", "explain"])
@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "an empty file"),
        (b" \n\n", "an empty file"),
        (GOOD.encode()[:700], "expected TOML"),
        (bytes(range(256)), "expected text in UTF-8"),
        (b"\x7fELF\x02\x01\x01\x00" * 8, "expected TOML"),
        ("title = 'Tr\u00e4ger'".encode("latin-1"), "expected text in UTF-8"),
        (GOOD.encode("utf-16"), "expected text in UTF-8"),
        (b"[" * 5000, "expected TOML"),
        (b"not a scene at all", "expected TOML"),
        (b"title = 'x'\n", "axes: expected, and missing"),
    ],
)
def test_a_file_that_is_no_scene_is_refused(command, content, words, tmp_path, capsys):
    file = tmp_path / "bad.toml"
    file.write_bytes(content)
    refuse(capsys, str(file), words, command)


def test_what_is_no_file_is_refused(tmp_path, capsys):
    assert "there is none of that name" in complaint(capsys, "run", str(tmp_path / "missing.toml"))
    assert "got a directory" in complaint(capsys, "explain", str(tmp_path))
    assert "expected case files (*.toml) in this folder" in complaint(capsys, "run", str(tmp_path))
    assert complaint(capsys, "run", "bad\0name.toml")
    (tmp_path / "K.csv").write_text("1\n")
    words = "got a problem of matrices; contactqp.compare and contactqp.solve_many take those, in Python"
    assert words in complaint(capsys, "report", str(tmp_path))
    assert "contactqp.solve_many, in Python" in complaint(capsys, "run", str(tmp_path), "--loads", "loads.csv")


def test_a_wrong_entry_is_not_told_as_a_list_that_is_too_short(tmp_path, capsys):
    file = tmp_path / "bad.toml"
    file.write_text(GOOD.replace("axes = [", 'axes = ["q"] # [', 1))
    words = complaint(capsys, "run", str(file))
    assert "axes[0]: expected 'x', 'y' or 'z', got 'q'" in words
    assert "expected at least" not in words


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="needs a file that its reader may not read")
def test_a_file_that_may_not_be_read_is_refused(tmp_path, capsys):
    file = tmp_path / "secret.toml"
    file.write_text(GOOD)
    Path.chmod(file, 0)
    assert "Permission denied" in complaint(capsys, "run", str(file))


@pytest.mark.slow
def test_a_windows_file_is_read(tmp_path, capsys):
    file = tmp_path / "windows.toml"
    file.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    accept(capsys, str(file), "explain")


WALL = (Path(__file__).parents[2] / "cases" / "bar_wall.toml").read_text()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            '[[study]]\nmethod = "penalty"',
            '[[study]]\nmethod = "penlaty"',
            "study[0].method: there is no method 'penlaty'",
        ),
        ('penalty = ["1e4 kN/m"', 'penalty = ["-1e4 kN/m"', "study[0].penalty: expected positive values"),
        ('[[study]]\nmethod = "penalty"', '[[study]]\nmethod = "lemke"', "study[0].penalty: 'lemke' has no such knob"),
        (
            '[[study]]\nmethod = "penalty"',
            '[[study]]\nmethod = "penalty"\nupdate = "uzawa"',
            "study[0].update: 'penalty' has no such knob; its own: penalty",
        ),
        (
            '[[study]]\nmethod = "penalty"\npenalty = ["1e4 kN/m", "1e5 kN/m", "1e6 kN/m", "1e7 kN/m", "1e8 kN/m"]',
            '[[study]]\nmethod = "active-set"\ntolerance = [1e-6]',
            "study[0].tolerance: 'active-set' has no such knob",
        ),
        ('obstacle = "wall" }', 'obstacle = "wall", friction = 0.3 }', "contacts[0].friction ('tip')"),
    ],
)
def test_what_only_a_shipped_case_shows(old, new, words, tmp_path, capsys):
    assert old in WALL
    file = tmp_path / "wall.toml"
    file.write_text(WALL.replace(old, new, 1))
    assert words in complaint(capsys, "run", str(file))


@pytest.mark.slow
def test_names_that_look_like_markup_are_printed_as_they_are(tmp_path, capsys):
    file = tmp_path / "wall.toml"
    file.write_text(WALL.replace('"tip"', '"[/]"'))
    for command in ("run", "explain"):
        with pytest.raises(SystemExit) as exit_:
            main([command, str(file)])
        assert exit_.value.code == 0
        assert "[/]" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (  # of a misspelled key one thing is said: that the right one is missing follows from it
            [('area = "15', 'aera = "15')],
            "bars[0].aera ('rod'): there is no key 'aera'; nearest: 'area'\n",
        ),
        (
            [('area = "15', 'aera = "15'), ('"2.1e8 kN/m^2"', '"2.1e8 kN/m"')],
            "nearest: 'area' (1 of 2; the next: bars[0].modulus ('rod'): expected a modulus such as",
        ),
        (
            [('"30 cm^2"', '"30 cm"'), ('"15 cm^2"', '"15 cm"'), ('mass = "2 t"', 'mass = "2 m"')],
            "which is a length (1 of 3; the next: ",
        ),
    ],
)
def test_the_next_mistake_of_a_file_is_told_too(changes, words, tmp_path, capsys):
    file, text = tmp_path / "case.toml", GOOD
    for old, new in changes:
        text = mutated(text, old, new)
    file.write_text(text)
    assert words in complaint(capsys, "run", str(file))


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('title = "Everything', 'titel = "Everything', "titel"),
        ('{ name = "foot", at = ["3 m"', '{ name = "foot", at = ["3 kg"', "nodes[3].at[0]"),
        ('obstacle = "floor" }', 'obstacle = "flor" }', "contacts[0].obstacle"),
        ('"5 kN" }]', '"5 kX" }]', "strings[0].tension"),
        ('[[ties]]\nname = "together"\n', '[[ties]]\nnaem = "together"\n', "ties[0].naem"),
        ("path = { steps = 4", "path = { stps = 4", "path.stps"),
    ],
)
def test_a_wrong_key_has_the_number_of_its_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, old: str, new: str, key: str, ends: str
) -> None:
    text = mutated(GOOD, old, new)
    file = tmp_path / "case.toml"
    file.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", ends).encode())
    changed = text.index(new) + next((i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), 0)
    refuse(capsys, str(file), f"case.toml: line {text[:changed].count(chr(10)) + 1}: {key}")


def test_a_line_is_told_at_once_in_long_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    about = 'about = """\n' + "word\n" * 4000 + '"""\n'
    text = mutated(GOOD, "units = {", about + "units = {").replace('"5 kN" }]', '"5 kX" }]')
    file = tmp_path / "case.toml"
    file.write_text(text)
    started = time.process_time()
    message = complaint(capsys, "run", str(file))
    assert time.process_time() - started < 5
    assert f"line {text[: text.index('5 kX')].count(chr(10)) + 1}: strings[0].tension" in message


def test_a_missing_key_has_the_line_of_its_table_and_none_where_the_file_has_none(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "case.toml"
    lines = mutated(GOOD, 'method = "penalty"\n', "").split("\n")
    file.write_text("\n".join(lines))
    refuse(capsys, str(file), f"case.toml: line {lines.index('[[study]]') + 1}: study[0].method")
    file.write_text(mutated(GOOD, 'axes = ["x", "z"]\n', ""))
    refuse(capsys, str(file), "case.toml: axes: expected")


def test_a_list_over_many_lines_has_the_line_where_it_begins(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    text = mutated(GOOD, 'axes = ["x", "z"]', 'axes = [\n    "x",\n    "q",\n]')
    file = tmp_path / "case.toml"
    file.write_text(text)
    begins = text[: text.index("axes")].count("\n") + 1
    assert any(f"line {line}: axes" in complaint(capsys, "run", str(file)) for line in (begins, begins + 2))
