"""What `contactqp run` prints: the answer on a screen, what was expected and what is not met, and the same as JSON."""

import json
import re
import shutil
from pathlib import Path

import pytest

import contactqp.cli
from tests.cli.commands import CASES, WALL, run
from tests.examples import PUSHED_OFF


@pytest.mark.slow
def test_run_prints_the_answer_and_what_was_expected(capsys):
    code, out, err = run(capsys, "run", WALL)
    assert (code, err) == (0, "")
    for words in ("A bar and a rigid wall", "certificate passed", "142.5", "closed", "met"):
        assert words in out
    assert "NOT MET" not in out


def test_run_takes_a_folder_and_prints_a_line_for_each_case(capsys, tmp_path):
    for name in ("two_bars", "bar_wall"):
        shutil.copy(CASES / f"{name}.toml", tmp_path)
    code, out, _ = run(capsys, "run", tmp_path)
    assert code == 0
    *cases, last = out.splitlines()
    assert [line.split()[0] for line in cases] == ["bar_wall", "two_bars"]
    assert all(re.search(r" passed, proven; (\d+) of \1 met$", line) for line in cases)
    assert last == "2 of 2 met (--verbose prints the answers)"
    code, out, _ = run(capsys, "run", tmp_path, "--verbose")
    assert code == 0
    assert all(title in out for title in ("Two bars that meet", "A bar and a rigid wall"))


@pytest.mark.parametrize(
    "case",
    [
        "hanging_block",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("cable_on_floor", "cattaneo_mindlin_sphere")),
    ],
)
def test_of_a_case_with_much_to_tell_the_answer_stands_on_a_screen_and_words_are_whole(capsys, case):
    out = run(capsys, "run", case)[1]
    lines = out.splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80
    assert not re.search(r"^ \w\s*$", out, re.MULTILINE)  # no word stands letter by letter
    assert not re.search(r"\n *\n *\n", out)
    whole = run(capsys, "run", case, "--verbose")[1]
    assert len(whole) > len(out)


@pytest.mark.slow
def test_of_every_case_the_answer_stands_on_a_screen(capsys):
    cases = sorted(CASES.glob("*.toml"))
    assert len(cases) >= 60
    for case in cases:
        code, out, _ = run(capsys, "run", case)
        assert code == 0
        assert len(out.splitlines()) <= 40, case.stem
        assert max(map(len, out.splitlines())) <= 80, case.stem


def test_of_one_case_the_answer_stands_on_a_screen_and_all_claims_with_verbose(capsys):
    code, out, _ = run(capsys, "run", WALL)
    assert code == 0
    assert len(out.splitlines()) <= 40
    assert max(map(len, out.splitlines())) <= 80
    assert re.search(r"by 14 other methods and settings: (\d+) of \1 met \(--verbose lists them\)", out)
    out = run(capsys, "run", WALL, "--method", "lemke", "--method", "daqp")[1]
    assert "by daqp: 8 of 8 met" in out
    whole = run(capsys, "run", WALL, "--verbose")[1]
    assert "wrong, as stated" in " ".join(whole.split())
    assert max(map(len, whole.splitlines())) <= 80
    assert len(whole.splitlines()) > 80


def test_a_folder_of_matrices_prints_its_displacements_and_forces(capsys, tmp_path):
    problem = contactqp.ContactProblem(
        [[315000.0, -157500.0], [-157500.0, 157500.0]], [0.0, 300.0], [[0.0, 1.0]], [1e-3]
    )
    contactqp.write_problem(tmp_path / "mine", problem.replace(contact_names=["wall"]))
    code, out, _ = run(capsys, "run", tmp_path / "mine")
    assert code == 0
    assert re.search(r"wall +closed +221.25 +0\n", out)
    assert re.search(r"unknown 1 +0.001\n", out)


def test_a_load_path_is_printed_instant_by_instant(capsys):
    _, out, _ = run(capsys, "run", CASES / "bar_wall_path.toml", "--method", "active-set", "--verbose")
    assert re.search(r"load factor +tip \[kN\]", out)
    assert re.search(r"0\.666666666667 +42\.5 ", out)
    assert re.search(r"0\.5 +0 ", out)
    _, out, _ = run(capsys, "run", CASES / "bar_wall_path.toml", "--method", "active-set", "--json")
    (data,) = json.loads(out)
    assert data["history"]["over"] == "load factor"
    assert data["history"]["at"][-1] == 1.0
    assert data["history"]["normal_force"]["tip"] == pytest.approx([0, 0, 0, 0, 0, 42.5, 92.5, 142.5])
    _, out, _ = run(capsys, "run", CASES / "bar_bounces.toml", "--method", "active-set", "--verbose")
    assert re.search(r"\d+ of 1601 instants; --json prints all", out)


@pytest.mark.slow
def test_a_case_without_an_answer_has_a_line_with_its_name(capsys, tmp_path):
    (tmp_path / "pushed_off.toml").write_text(PUSHED_OFF)
    code, out, err = run(capsys, "run", tmp_path / "pushed_off.toml", WALL)
    assert code == 1
    assert out.splitlines()[0].split(maxsplit=1) == ["pushed_off", "1 of 1 without an answer"]
    assert out.splitlines()[-1] == "1 of 2 met (--verbose prints the answers)"
    assert "rigid motion" in err


@pytest.mark.slow
def test_what_is_not_met_is_printed_in_full_among_many_claims_and_cases(capsys, tmp_path):
    text = Path(WALL).read_text().replace('value = "285/2 kN"', 'value = "143 kN"')
    (tmp_path / "off.toml").write_text(text)
    for arguments in ([tmp_path / "off.toml"], [tmp_path / "off.toml", WALL]):
        code, out, _ = run(capsys, "run", *arguments)
        assert code == 1
        assert re.search(r"normal force tip +143 +142\.5 +kN .*NOT MET", out)
    assert out.splitlines()[-1] == "1 of 2 met (--verbose prints the answers)"


def test_an_expectation_that_is_not_met_is_exit_1(capsys, tmp_path):
    file = tmp_path / "off.toml"
    file.write_text(Path(WALL).read_text().replace('value = "285/2 kN"', 'value = "143 kN"', 1))
    code, out, _ = run(capsys, "run", file)
    assert code == 1
    assert "NOT MET" in out
    code, _, _ = run(capsys, "run", file, WALL)
    assert code == 1


def test_of_a_method_that_the_case_says_nothing_of_the_certificate_decides(capsys):
    arguments = ("run", WALL, "--method", "perturbed-lagrangian", "--perturbation")
    for perturbation, code, said in (("2e6 kN/m", 1, True), ("1e15 kN/m", 0, False)):
        ended, out, _ = run(capsys, *arguments, perturbation)
        assert (ended, "the case says nothing of perturbed-lagrangian: its certificate" in out) == (code, said)
        (one,) = json.loads(run(capsys, *arguments, perturbation, "--json")[1])
        assert (one["met"], one["expectations"], one["contact_status"]) == (code == 0, [], {"tip": "closed"})


NODE = """
title = "A node that may stick, slip or lift off"
units = { length = "m", force = "N" }
axes = ["x", "y"]
nodes = [{ name = "1", at = ["0 m", "0 m"] }]
matrices = [{ name = "K", unknowns = ["1.y", "1.x"], unit = "N/m", rows = [[5, -2], [-2, 1]] }]
obstacles = [{ name = "floor", point = ["0 m", "0 m"], normal = [0, 1] }]
contacts = [{ name = "foot", node = "1", obstacle = "floor", friction = 0.8 }]
loads = [{ unknown = "1.y", value = "-1 N" }, { unknown = "1.x", value = "0.65 N" }]
"""


def test_several_answers_are_told(capsys, tmp_path):
    (tmp_path / "node.toml").write_text(NODE)
    out = run(capsys, "run", tmp_path / "node.toml")[1]
    assert "several answers exist at this load" in " ".join(out.split())
    (one,) = json.loads(run(capsys, "run", tmp_path / "node.toml", "--json")[1])
    assert one["certificate"]["uniqueness"] == ["several answers"]
    assert "several answers exist at this load" in one["certificate"]["notes"][0]
    (tmp_path / "node.toml").write_text(NODE.replace("friction = 0.8", "friction = 0.2"))
    (one,) = json.loads(run(capsys, "run", tmp_path / "node.toml", "--json")[1])
    assert one["certificate"]["uniqueness"] == []


def test_a_contact_that_leaves_its_obstacle_unpushed_is_doubted(capsys, tmp_path):
    beam = (
        "title = 'beam'\nunits = { length = 'mm', force = 'kN' }\naxes = ['x', 'y']\nfixed = ['root', 'tip.x']\n"
        "nodes = [{ name = 'root', at = ['0 m', '0 m'] }, { name = 'tip', at = ['2 m', '0 m'] }]\n"
        "beams = [{ name = 'b', nodes = ['root', 'tip'], area = '30 cm^2', inertia = '2000 cm^4', "
        "modulus = '210 GPa' }]\n"
        "contacts = [{ name = 'stop', node = 'tip', obstacle = 'block' }]\n"
        "loads = [{ unknown = 'tip.y', value = '-20 kN' }]\n"
        "obstacles = [{ name = 'block', point = ['0 m', '-5 mm'], normal = [0, %d] }]\n"
    )
    for normal, doubted in ((1, False), (-1, True)):
        (tmp_path / "beam.toml").write_text(beam % normal)
        _, out, err = run(capsys, "run", tmp_path / "beam.toml")
        assert ("('stop'): it starts 5 mm inside 'block' and ends outside, and nothing has pushed it" in err) is doubted
        assert re.search(r"tip\.theta +-0\.0\d+ rad", out)


@pytest.mark.slow
def test_a_verdict_that_does_not_hold_is_exit_1(capsys, tmp_path):
    file = tmp_path / "off.toml"
    text = (CASES / "truss_floor.toml").read_text()
    assert 'printed = "30.255 kN"\nverdict = "right"' in text
    file.write_text(
        text.replace('printed = "30.255 kN"\nverdict = "right"', 'printed = "30.255 kN"\nverdict = "wrong"')
    )
    code, out, _ = run(capsys, "run", file)
    assert code == 1
    assert "NOT wrong" in out


def test_what_a_verdict_rests_on_is_printed_and_written(capsys):
    rough, critical = (str(CASES / f"{name}.toml") for name in ("truss_friction", "klarbring_limit_press_first"))
    for case, verdict in ((rough, "error bounds proven"), (critical, "not proven (friction)")):
        assert f"certificate passed, {verdict}" in " ".join(run(capsys, "run", case)[1].split())
    written = [json.loads(run(capsys, "run", case, "--json")[1])[0] for case in (rough, WALL)]
    assert [one["certificate"]["basis"] for one in written] == ["state", "bounds"]


# Frictional cases, and of what their error bounds are proven: of the only answer, of the only one nearby, or of none
# where others are at the same load, or at one as near as rounding.
PROVEN = {
    "truss_friction": "global", "truss_friction_overload": "global", "truss_friction_unloaded": "global",
    "truss_friction_horizontal_first": "global", "truss_friction_vertical_first": "global", "truss_rough": "global",
    "two_masses": "global", "wedge": "global", "jenkins_loop": "global", "sliding_block_stops": "global",
    "truss_dragged": "global", "pad_on_incline": "global", "block_on_incline_sideways": "global",
    "corner_triangle": "local", "cattaneo_mindlin_cylinder": "local", "klarbring_slides_back": "local",
    "klarbring_press_first": "local", "hanging_block": None, "klarbring_limit_press_first": None,
}  # fmt: skip


@pytest.mark.sampled(8)
@pytest.mark.parametrize("case", PROVEN)
def test_answers_to_frictional_cases_are_proven_where_they_are_the_only_ones(capsys, case):
    certificate = json.loads(run(capsys, "run", CASES / f"{case}.toml", "--json")[1])[0]["certificate"]
    assert certificate["passed"]
    assert certificate["proven"] is (PROVEN[case] is not None)
    assert certificate["scope"] == PROVEN[case]


def test_json_holds_the_same(capsys):
    code, out, _ = run(capsys, "run", WALL, "--json")
    first, *others = json.loads(out)
    assert code == 0
    assert first["method"] == "active-set"
    assert first["normal_force"] == {"tip": 142.5}
    assert first["contact_status"] == {"tip": "closed"}
    assert first["certificate"]["passed"]
    assert first["expectations"]
    assert all(row["ok"] for row in first["expectations"])
    assert {other["knobs"].get("penalty") for other in others if other["method"] == "penalty"} >= {"1e8 kN/m"}


def test_quiet_prints_what_is_not_met_alone(capsys, tmp_path):
    assert run(capsys, "run", "bar_wall", "--quiet") == (0, "", "")
    code, out, _ = run(capsys, "run", CASES / "bar_wall.toml", CASES / "two_bars.toml", "--quiet", "--jobs", "1")
    assert (code, out) == (0, "")
    turned = tmp_path / "turned.toml"
    text = (CASES / "two_bars.toml").read_text(encoding="utf-8")
    turned.write_text(text.replace('value = "95 kN"', 'value = "96 kN"'), encoding="utf-8")
    code, out, _ = run(capsys, "run", CASES / "bar_wall.toml", turned, "--quiet", "--jobs", "1")
    assert code == 1
    assert "NOT MET" in out
    assert "bar_wall" not in out
    assert out.splitlines()[-1] == "1 of 2 met"
