"""A deck's contact in another code is judged pair by pair: what is right passes, and what is wrong is named."""

from __future__ import annotations

import pathlib
import re
import sys
import time

import numpy as np
import pytest

import contactqp as cq
from contactqp.oracle.foreign.crosscheck_verdict import CrossCheck
from tests.cli.commands import run as command
from tests.decks import STACK, Deck, needs_calculix, two_blocks, write


def printed(
    deck: pathlib.Path,
    displacement: np.ndarray,
    time_: float = 1.0,
    name: str = "model.dat",
    radial: np.ndarray | float = 1.0,
) -> pathlib.Path:
    """Write displacements of all nodes of a deck as CalculiX prints them, of radial ones these parts."""
    labels, moved = cq.read_deck(deck).displacements(displacement)
    moved[:, 0] *= radial
    rows = [
        f"{label:10d}" + "".join(f" {x:13.6E}" for x in (*row, 0.0)[:3])
        for label, row in zip(labels, moved, strict=True)
    ]
    title = f" displacements (vx,vy,vz) for set ALL and time {time_:14.7E}"
    file = deck.with_name(name)
    file.write_text("\n".join(["", title, "", *rows, ""]))
    return file


def exact(deck: pathlib.Path) -> np.ndarray:
    return np.asarray(cq.solve(cq.read_deck(deck).problem()).displacement)


def judged(folder: pathlib.Path, text: str = STACK, change: object = None, **options: object) -> CrossCheck:
    deck = write(folder, text)
    u = exact(deck)
    return cq.crosscheck(deck, printed(deck, u if change is None else change(u)), **options)  # type: ignore[operator]


def test_the_exact_answer_is_right_to_its_printed_digits(tmp_path: pathlib.Path) -> None:
    found = judged(tmp_path)
    assert found
    assert found.word == "right"
    pair = found.pairs[0]
    assert (pair.name, pair.type, pair.word) == ("ABOVE on BELOW", "NODE TO SURFACE", "right")
    assert pair.resultant == pytest.approx(5.0, rel=1e-4)
    assert pair.reference_resultant == pytest.approx(5.0, rel=1e-9)
    assert pair.penalty_resultant == pytest.approx(0.01 / 0.0021)
    assert pair.total.tolist() == pytest.approx([0.0, 0.0, 5.0], abs=1e-4)


@pytest.mark.slow
def test_the_springs_that_a_deck_states_are_told_apart(tmp_path: pathlib.Path) -> None:
    deck = write(tmp_path, STACK)
    penalty = cq.solve(cq.read_deck(deck).problem("penalty")).displacement[: len(exact(deck))]
    results = printed(deck, penalty)
    found = cq.crosscheck(deck, results)
    assert found.word == "wrong"
    assert any("1e+04 times area and overlap: springs in the place of contact" in one for one in found.pairs[0].causes)
    assert any("that of the springs that the deck states" in one for one in found.pairs[0].causes)
    assert cq.crosscheck(deck, results, reference="penalty").passed
    assert cq.crosscheck(deck, results, error_tolerance=0.1).passed


@pytest.mark.slow
def test_friction_that_yields_is_wrong_where_the_normal_forces_are_right(tmp_path: pathlib.Path) -> None:
    text = two_blocks("hex8", "NODE TO SURFACE", "LINEAR\n1e9", divisions=((2, 2, 1), (3, 3, 1)), push=3e-5,
                      friction="0.3, 1e5")  # fmt: skip
    deck = write(tmp_path, text)
    problem = cq.read_deck(deck).problem
    yielding, right = cq.solve(problem("penalty")), exact(deck)
    results = printed(deck, yielding.displacement[: len(right)])
    found = cq.crosscheck(deck, results)
    (pair,) = found.pairs
    assert pair.node_error < 1e-2
    assert pair.reference_friction == pytest.approx(np.linalg.norm(cq.solve(problem()).friction_force, axis=1).sum())
    assert pair.friction == pytest.approx(np.linalg.norm(yielding.friction_force, axis=1).sum(), rel=1e-4)
    assert pair.friction < 0.9 * pair.reference_friction
    assert found.word == "wrong"
    assert f"friction at all nodes {pair.friction:.6g}, exact {pair.reference_friction:.6g}" in found.summary()
    assert any("friction yields on the stick slope that the deck states" in one for one in pair.causes)
    assert cq.crosscheck(deck, results, reference="penalty").passed
    assert cq.crosscheck(deck, printed(deck, right)).passed
    assert judged(tmp_path).pairs[0].friction is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("element", "kind"),
    [("hex8", "NODE TO SURFACE"), ("hex20", "SURFACE TO SURFACE")],
)
def test_friction_of_a_block_that_slips_is_its_part_of_the_normal_force(
    tmp_path: pathlib.Path, element: str, kind: str
) -> None:
    text = two_blocks(element, kind, "LINEAR\n1e9", divisions=((2, 2, 1), (3, 3, 1)), push=1e-2, friction="0.3, 1e8")
    deck = write(tmp_path, text)
    (pair,) = cq.crosscheck(deck, printed(deck, exact(deck))).pairs
    assert pair.reference_friction == pytest.approx(0.3 * pair.reference_resultant, rel=5e-3)
    assert pair.friction == pytest.approx(pair.reference_friction, rel=2e-2)


@pytest.mark.slow
@pytest.mark.parametrize("push", [1e-4, 1e-2])
def test_friction_of_many_faces_is_that_of_nodes_and_what_both_differ_by_on_springs(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, push: float
) -> None:
    text = two_blocks("hex20", "SURFACE TO SURFACE", "LINEAR\n1e9", divisions=((3, 3, 2), (4, 4, 1)), push=push,
                      friction="0.3, 1e8")  # fmt: skip
    deck = write(tmp_path, text)
    results = printed(deck, exact(deck))
    (whole,) = cq.crosscheck(deck, results).pairs
    monkeypatch.setattr("contactqp.oracle.foreign.crosscheck.MOST_POINTS", 0)
    found = cq.crosscheck(deck, results)
    (nearly,) = found.pairs
    size = whole.reference_resultant
    assert nearly.reference_resultant == pytest.approx(size, rel=2e-4)
    assert nearly.reference_friction == pytest.approx(whole.reference_friction, abs=4e-4 * size)
    assert abs(nearly.reference_force - whole.reference_force).max() < 1e-4 * size
    assert nearly.mesh_node_error == pytest.approx(whole.mesh_node_error, rel=0.02)
    assert nearly.mesh_error == pytest.approx(whole.mesh_error, rel=0.03)
    assert any("the difference of both on springs" in line for line in found.ledger.assumed)


def test_units_are_words(tmp_path: pathlib.Path) -> None:
    deck = write(tmp_path, STACK)
    wrong = printed(deck, 1.1 * cq.solve(cq.read_deck(deck).problem()).displacement)
    found = cq.crosscheck(deck, wrong, units={"length": "mm", "force": "N"})
    plain = cq.crosscheck(deck, wrong)
    assert not found.passed
    assert found.summary() != plain.summary()
    assert (
        found.summary().replace(" N,", ",").replace(" [N]", "").replace(" [mm]", "").split() == plain.summary().split()
    )
    assert found.data()["units"] == {"length": "mm", "force": "N"}
    with pytest.raises(cq.InvalidProblem, match="units: expected a length, got 'N'"):
        cq.crosscheck(deck, wrong, units={"length": "N", "force": "mm"})


@pytest.mark.slow
def test_a_pair_without_force_is_told(tmp_path: pathlib.Path) -> None:
    found = judged(tmp_path, change=lambda u: np.repeat([0.0, -0.02], len(u) // 2))
    assert found.word == "wrong"
    assert any("it has no contact force" in one for one in found.pairs[0].causes)


def test_nodes_that_pull_are_told(tmp_path: pathlib.Path) -> None:
    away = STACK.replace("TOP, 3, 3, -0.02", "TOP, 3, 3, 0.02")  # nothing touches; held together by a force of 1 each
    deck = write(tmp_path, away)
    found = cq.crosscheck(deck, printed(deck, np.array([0.004] * 4 + [0.016] * 4)))
    assert found.word == "wrong"
    assert any("4 nodes pull with 4 in all" in one for one in found.pairs[0].causes)


@pytest.mark.slow
def test_other_loads_are_out_of_balance_and_cut_numbers_are_named(tmp_path: pathlib.Path) -> None:
    free = STACK.replace("*BOUNDARY\nTOP, 3, 3, -0.02\n", "*CLOAD\nTOP, 3, -2.50000000000000e-01\n")
    deck = write(tmp_path, free)
    cut = write(tmp_path, free.replace("-2.50000000000000e-01", "-2.5"), "cut.inp")
    results = printed(cut, exact(cut))
    found = cq.crosscheck(deck, results)
    assert "out of balance where nothing touches: " in found.findings[0]
    assert re.search(r"\b1[5-8]\.z by -2\.25", found.findings[0])  # the four are off alike, and three are named
    assert "first 20 characters of each number" in found.findings[1]
    whole = write(tmp_path, free.replace("-2.50000000000000e-01", "-0.25"), "whole.inp")
    assert len(cq.crosscheck(whole, results).findings) == 1


@pytest.mark.slow
def test_supports_that_moved_are_told(tmp_path: pathlib.Path) -> None:
    deck = write(tmp_path, STACK)
    other = write(tmp_path, STACK.replace("-0.02", "-0.021"), "other.inp")
    found = cq.crosscheck(deck, printed(other, exact(other)))
    assert "4 supports moved: 15.z by -0.021, the deck prescribes -0.02" in found.findings[0]


@pytest.mark.slow
def test_two_pairs_are_judged_one_by_one(tmp_path: pathlib.Path) -> None:
    other = "\n".join(f"{n + 20}, {10 + x}., {y}., {z}" for n, x, y, z in (
        (1, 0, 0, 0.0), (2, 1, 0, 0.0), (3, 1, 1, 0.0), (4, 0, 1, 0.0), (5, 0, 0, 1.0), (6, 1, 0, 1.0), (7, 1, 1, 1.0),
        (8, 0, 1, 1.0), (11, 0, 0, 1.0), (12, 1, 0, 1.0), (13, 1, 1, 1.0), (14, 0, 1, 1.0), (15, 0, 0, 2.0),
        (16, 1, 0, 2.0), (17, 1, 1, 2.0), (18, 0, 1, 2.0)))  # fmt: skip
    text = STACK.replace("*ELEMENT", f"{other}\n*ELEMENT").replace(
        "*NSET, NSET=TOP", "3, 21, 22, 23, 24, 25, 26, 27, 28\n4, 31, 32, 33, 34, 35, 36, 37, 38\n*NSET, NSET=TOP"
    )
    text = text.replace("15, 18\n", "15, 18\n35, 38\n").replace("1, 2, 3, 4\n*MAT", "1, 2, 3, 4, 21, 22, 23, 24\n*MAT")
    text = text.replace("*SURFACE INTER", "*SURFACE, NAME=BELOW2\n3, S2\n*SURFACE, NAME=ABOVE2\n4, S1\n*SURFACE INTER")
    text = text.replace("ABOVE, BELOW\n", "ABOVE, BELOW\nABOVE2, BELOW2\n")
    found = judged(tmp_path, text)
    assert [pair.reference_resultant for pair in found.pairs] == pytest.approx([5.0, 10.0])
    assert [pair.word for pair in found.pairs] == ["right", "right"]
    deck = tmp_path / "model.inp"
    names = cq.read_deck(deck).dof_names
    off = exact(deck).copy()
    off[[names.index(f"{n}.z") for n in (31, 32, 33, 34)]] += 1e-3
    found = cq.crosscheck(deck, printed(deck, off))
    assert [pair.word for pair in found.pairs] == ["right", "wrong"]


def test_few_printed_digits_leave_a_verdict_open(tmp_path: pathlib.Path) -> None:
    deck = write(tmp_path, STACK.replace("1000., 0.", "1e12, 0.").replace("-0.02", "-0.0100000001"))
    found = cq.crosscheck(deck, printed(deck, exact(deck)))
    assert found.word == "undecided"
    assert "printed digits" in found.summary()


def test_results_that_fit_no_deck_are_refused(tmp_path: pathlib.Path) -> None:
    deck = write(tmp_path, STACK)
    results = printed(deck, exact(deck), 0.5)
    with pytest.raises(cq.InvalidProblem, match=r"the results end at time 0\.5 of 1: the run broke off"):
        cq.crosscheck(deck, results)
    text = printed(deck, exact(deck)).read_text()
    results.write_text(text.replace(text.splitlines()[5] + "\n", ""))
    with pytest.raises(cq.InvalidProblem, match="got none of node 3; print U of all"):
        cq.crosscheck(deck, results)
    results.write_text(text[:-10])
    with pytest.raises(cq.InvalidProblem, match="cut off"):
        cq.crosscheck(deck, results)
    with pytest.raises(cq.InvalidProblem, match="error_tolerance"):
        cq.crosscheck(deck, results, error_tolerance=0.0)


# Programs in the place of ccx that end as none should.

BAD = {
    "crashes": ("print(' *ERROR in e_c3d: nonpositive jacobian'); sys.exit(201)", "exit code 201: *ERROR in e_c3d"),
    "is killed": ("os.kill(os.getpid(), 11)", "signal 11"),
    "writes nothing": ("pass", "ended without results"),
    "says so and goes on": ("print('*ERROR reading *NODE')", "*ERROR reading *NODE"),
    "writes half a file": ("open('job.dat', 'w').write(' displacements (vx,vy,vz) for set A and time 1.0E+00\\n"
                           " 1  0.1')", "left half a file"),
    "stops early": ("open('job.dat', 'w').write(' displacements (vx,vy,vz) for set A and time 1.0E-01\\n"
                    " 1  0.0E+00  0.0E+00  0.0E+00\\n')", "the run broke off"),
    "loops": ("time.sleep(60)", "did not end within 1 s"),
}  # fmt: skip


@pytest.mark.sampled(4)
@pytest.mark.skipif(sys.platform == "win32", reason="a script with a line #!")
@pytest.mark.parametrize("how", BAD)
def test_a_program_that_ends_badly_is_told_in_one_line(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    code, said = BAD[how]
    program = tmp_path / "program"
    program.write_text(f"#!{sys.executable}\nimport os, sys, time\n{code}\n")
    program.chmod(0o755)
    monkeypatch.setenv("CONTACTQP_CCX", str(program))
    monkeypatch.chdir(tmp_path)  # where it writes when it is asked for its version
    began = time.monotonic()
    with pytest.raises(cq.BackendFailed) as caught:
        cq.crosscheck(write(tmp_path, STACK), time_limit=1.0)
    assert said in str(caught.value)
    assert time.monotonic() - began < 30
    assert (tmp_path / "model.ccx" / "job.inp").is_file()


def test_the_command_says_right_wrong_or_not_installed(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    deck = write(tmp_path, STACK)
    results = printed(deck, exact(deck))
    code, out, _ = command(capsys, "crosscheck", deck, results)
    assert (code, ": right by its results" in out) == (0, True)
    results = printed(deck, 1.1 * exact(deck))
    code, out, _ = command(capsys, "crosscheck", deck, results, "--json")
    assert (code, '"verdict": "wrong"' in out) == (1, True)
    monkeypatch.setenv("CONTACTQP_CCX", "no-such-program")
    code, _, error = command(capsys, "crosscheck", deck)
    assert (code, len(error.splitlines())) == (3, 1)


@pytest.mark.slow
@needs_calculix
def test_calculix_is_run_and_judged(tmp_path: pathlib.Path) -> None:
    found = cq.crosscheck(write(tmp_path, STACK), reference="penalty", error_tolerance=1e-3)
    assert found.passed, found.summary()
    assert found.code.startswith("CalculiX 2.")
    stiff = cq.crosscheck(write(tmp_path, STACK.replace("1e4\n", "1e8, 1e-6\n"), "stiff.inp"))
    assert stiff.passed, stiff.summary()
    assert (tmp_path / "stiff.ccx" / "job.log").is_file()


@pytest.mark.sampled(2)
@pytest.mark.parametrize("element", ["quad4", "quad8"])
def test_pressures_on_the_axis_of_round_blocks_are_those_beside_it(tmp_path: pathlib.Path, element: str) -> None:
    """Under the corner of a quadratic side on the axis is no area: its force over that was drawn as no pressure."""
    deck = Deck("CAX")
    deck.body("UP", cq.rectangle(1.0, 1.0, (4, 2), element).mapped(lambda x: x + np.array([0.0, 1.0])), section="")
    deck.body("LOW", cq.rectangle(1.0, 1.0, (4, 2), element), section="")
    deck.surface("SLAVE", "UP", "bottom")
    deck.surface("MASTER", "LOW", "top")
    sides = ("TOP", "UP", "top"), ("BOTTOM", "LOW", "bottom"), ("A", "UP", "left"), ("B", "LOW", "left")
    for name, body, side in sides:
        deck.nset(name, body, side)
    deck.pair("NODE TO SURFACE", "HARD")
    deck.lines += ["*BOUNDARY", "BOTTOM, 2, 2", "A, 1, 1", "B, 1, 1"]
    deck.step += ["*BOUNDARY", "TOP, 2, 2, -0.001"]
    file = write(tmp_path, deck.text())
    # CalculiX prints means over a wedge: of its sides, and at corners of quadratic elements four times the middle, too.
    corner = np.isclose(cq.read_deck(file).assembly.points * [4.0, 2.0] % 1.0, 0.0).all(axis=1) & (element == "quad8")
    side = np.cos(np.pi / 180.0)
    radial = np.where(corner, (2.0 + side) / 3.0, side)
    (pair,) = cq.crosscheck(file, printed(file, 1.1 * exact(file), radial=radial)).pairs
    mean = pair.reference_resultant / np.pi
    assert pair.reference_pressure == pytest.approx(np.full(len(pair.labels), mean), rel=1e-6)
    assert pair.pressure == pytest.approx(1.1 * pair.reference_pressure, rel=1e-4)
    assert pair.force.sum() == pytest.approx(1.1 * pair.reference_resultant, rel=1e-4)


@pytest.mark.slow
def test_both_pressures_and_their_difference_are_drawn(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    deck = write(tmp_path, STACK)
    results = printed(deck, exact(deck))
    code, out, _ = command(capsys, "crosscheck", deck, results, "--plot", tmp_path / "pressures.png")
    assert (code, "written: " in out) == (0, True)
    assert (tmp_path / "pressures.png").read_bytes().startswith(b"\x89PNG")
    code, _, error = command(capsys, "crosscheck", deck, results, "--plot", tmp_path / "pressures.txt")
    assert (code, len(error.splitlines())) == (2, 1)


@pytest.mark.slow
def test_pictures_of_pressures_have_the_units_that_are_told(tmp_path: pathlib.Path) -> None:
    pytest.importorskip("matplotlib")
    from contactqp.pictures.drawing import crosscheck_figure

    deck = write(tmp_path, STACK)
    results = printed(deck, exact(deck))
    for units, unit, length in (({"length": "mm", "force": "N"}, " [N/mm²]", " [mm]"), (None, "", "")):
        found = cq.crosscheck(deck, results, units=units)
        axes = crosscheck_figure(found, list(found.pairs)).axes[:3]
        assert [one.get_title() for one in axes[:2]] == [f"pressure by its results{unit}", f"pressure, exact{unit}"]
        assert {one.get_xlabel() for one in axes} == {f"along the surface{length}"}


def test_pairs_of_two_types_are_refused_before_calculix_ends_at_them(tmp_path: pathlib.Path) -> None:
    other = "*SURFACE, NAME=SIDE\n2, S3\n*SURFACE, NAME=FAR\n1, S5\n*CONTACT PAIR, INTERACTION=TOUCH, "
    other += "TYPE=SURFACE TO SURFACE\nSIDE, FAR\n*BOUNDARY\nBOTTOM"
    deck = write(tmp_path, STACK.replace("*BOUNDARY\nBOTTOM", other, 1))
    with pytest.raises(cq.InvalidProblem, match=r"line 47: \*CONTACT PAIR: CalculiX runs contact pairs of one TYPE"):
        cq.crosscheck(deck)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("size", [1e3, 1e15, 1e40, 1e59])
def test_one_displacement_far_away_is_wrong(tmp_path: pathlib.Path, size: float) -> None:
    def change(u: np.ndarray) -> np.ndarray:
        return np.where(np.arange(len(u)) == int(np.argmax(abs(u))), size, u)

    assert judged(tmp_path, change=change).word == "wrong"


def test_displacements_that_diverged_are_refused(tmp_path: pathlib.Path) -> None:
    """At 1e308 the forces overflow, and a pair without a number for its force was called right."""
    with pytest.raises(cq.InvalidProblem, match=r"is displaced by 1e\+308: the other code diverged"):
        judged(tmp_path, change=lambda u: np.where(np.arange(len(u)) == len(u) - 1, 1e308, u))


@pytest.mark.slow
def test_a_pair_of_which_no_node_is_above_a_face_is_judged(tmp_path: pathlib.Path) -> None:
    """The upper cubes stand five lengths beside the lower one: no contact is found, and no force is right."""
    beside = re.sub(r"(?m)^(1[1-8]), ([01])\.", r"\1, 5\2.", STACK)
    assert beside != STACK
    assert judged(tmp_path, beside).word == "right"
    pulled = judged(tmp_path, beside, lambda u: u + 0.3)
    assert pulled.word == "wrong"
    assert pulled.pairs[0].reference_resultant == 0.0
    assert np.all(np.isnan(pulled.pairs[0].gap))
