"""Tables fit the terminal; numbers are drawn with letters."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from rich.console import Console

from contactqp.cli import main
from contactqp.scene.tables import ASCII, BLOCKS, MOST_ROWS, Drawn, bars, course, print_table

CASES = Path(__file__).parents[2] / "cases"


def printed(width, rows, drawn, encoding="utf-8"):
    class Screen(io.StringIO):
        pass

    Screen.encoding = encoding
    screen = Screen()
    print_table(Console(file=screen, width=width), ["name", "force"], rows, drawn)
    return screen.getvalue().splitlines()


ROWS = [["a", "8.12345678901"], ["b", "4.12345678901"]]
FORCES = [Drawn(2, lambda width, letters: bars([8, 4], width, letters))]


def test_a_picture_takes_the_room_that_there_is():
    wide, narrow, none = (printed(width, ROWS, FORCES) for width in (80, 40, 22))
    assert "█" * 24 in "".join(wide)
    assert "█" * 10 in "".join(narrow)
    assert "█" * 11 not in "".join(narrow)
    assert "█" not in "".join(none)
    for lines, width in ((wide, 80), (narrow, 40), (none, 22)):
        assert len(lines) >= len(ROWS)
        assert all(len(line) <= width for line in lines)
        assert any("8.12345678901" in line for line in lines)


def test_numbers_stay_whole_on_a_narrow_terminal():
    header = ["contact between two bodies", "sum of normal forces [kN]", "gap [mm]", "error", "what of it"]
    row = ["foot of the left leg", "8.12345678901", "-0.00084321234567", "1.0e-12", "met"]
    screen = io.StringIO()
    print_table(Console(file=screen, width=60), header, [row, ["a", "0.3", "2 rad", "7", "met"]])
    lines = screen.getvalue().splitlines()
    assert max(map(len, lines)) <= 60
    assert "…" not in screen.getvalue()
    assert all(any(number in line for line in lines) for number in ("8.12346", "-0.000843212", "1.0e-12", "2 rad"))


def test_what_is_too_wide_stands_in_two_tables_and_no_word_letter_by_letter():
    header = ["contact", "nodes", "pressing", "normal force [N]", "peak pressure [N/mm^2]", "friction x [N]"]
    screen = io.StringIO()
    print_table(Console(file=screen, width=40), header, [["pair", "64", "43", "70", "67.2652", "-0.148473"]])
    lines = screen.getvalue().splitlines()
    assert max(map(len, lines)) <= 40
    assert sum(line.startswith(" contact ") for line in lines) == 2
    assert sum(line.startswith(" pair ") for line in lines) == 2
    assert all(any(word in line for line in lines) for word in ("pressing", "67.2652", "-0.148473", "[N/mm^2]"))


def test_pictures_are_ascii_where_the_output_has_no_blocks():
    text = "".join(printed(80, ROWS, FORCES, "latin-1"))
    assert text.isascii()
    assert "#" * 24 in text


def test_pictures_are_cut_with_their_rows():
    count = MOST_ROWS + 5
    drawn = [Drawn(1, lambda width, letters: bars(range(count), width, letters))]
    lines = printed(80, [[str(i), "1"] for i in range(count)], drawn)
    assert "... and 5 more rows (--json has all)" in lines[-1]


def shown(capsys, case, *options):
    with pytest.MonkeyPatch.context() as changed:
        changed.setenv("COLUMNS", "200")
        with pytest.raises(SystemExit) as exit_:
            main(["run", str(CASES / f"{case}.toml"), "--method", "active-set", "--verbose", *options])
    assert exit_.value.code == 0
    return capsys.readouterr().out


def test_run_draws_forces_and_gaps(capsys):
    lines = shown(capsys, "string_over_floor_fine").splitlines()
    first, middle = (next(line for line in lines if line.startswith(f" {name} ")) for name in ("1", "9"))
    assert first.rstrip().endswith("█" * 24)  # the largest gap, and no force
    assert "·" in first
    assert "0.111111111111" + " " * 5 + "█" * 24 in middle
    assert middle.rstrip().endswith("·")


@pytest.mark.slow
def test_gaps_that_rounding_leaves_are_no_picture(capsys):
    out = shown(capsys, "von_mises_arc")
    (contact,) = (line for line in out.splitlines() if line.startswith(" node      closed"))
    assert contact.count("█" * 24) == 1  # the force's
    assert contact.rstrip().endswith("·")


@pytest.mark.slow
def test_run_draws_the_course_of_a_path_and_of_a_pressure(capsys):
    (row,) = (line for line in shown(capsys, "truss_floor").splitlines() if "load factor 0 to 1" in line)
    picture = row.split()[1]
    assert len(picture) == 24
    assert picture[:16] == "·" * 16  # it closes at 0.717
    assert picture[-1] == "█"
    assert list(picture[17:]) == sorted(picture[17:])
    (row,) = (line for line in shown(capsys, "hertz_line").splitlines() if "pressure, at most" in line)
    picture = row.split()[1]
    assert picture == picture.replace(" ", "")
    assert {picture[0], picture[-1]} == {"·"}
    assert "█" in picture[3:-3]


def test_no_picture_goes_into_json(capsys):
    out = shown(capsys, "truss_floor", "--json")
    assert json.loads(out)[0]["normal_force"]["foot"] == pytest.approx(30.2548805943)
    assert out.isascii()


@pytest.mark.slow
def test_a_pipe_of_another_encoding_gets_ascii_without_colours():
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "NO_COLOR": "1"}
    command = [sys.executable, "-m", "contactqp", "run", str(CASES / "truss_floor.toml")]
    done = subprocess.run(command, capture_output=True, env=environment, check=True)
    assert done.stdout.isascii()
    assert b"#" * 24 in done.stdout
    assert b"\x1b" not in done.stdout
    assert done.stderr == b""


def test_bars_are_in_proportion_to_the_eighth_of_a_letter():
    assert bars([8, 4, 1, 0.5], 1) == ["█", "▌", "▏", "▏"]
    assert bars([100.0, 50.0, 25.0], 8) == ["████████", "████", "██"]
    assert bars([8, 4, 1], 4, ASCII) == ["####", "##", "#"]


def test_zero_and_negative_values_are_seen():
    assert bars([1, 0], 4) == ["████", "·"]
    assert bars([1, 0, 1e-13], 4, ASCII) == ["####", "0", "0"]  # what rounding leaves is nothing
    assert bars([2, 0, -1], 4) == ["    │████", "    │", "  ██│"]
    assert bars([2, -2], 2, ASCII) == ["  |##", "##|"]
    assert bars([0, 0], 4) == ["·", "·"]
    assert bars([], 4) == []


def test_what_is_no_number_has_no_bar():
    assert bars([1.0, np.nan, np.inf], 2) == ["██", "", ""]


def test_a_course_rises_from_zero_to_the_largest():
    assert course([0, 1, 2, 4, 8], 5) == "·▂▃▅█"
    assert course([0, 1, 2, 4, 8], 5, ASCII) == "0:-+@"
    assert course([-8, -4, 0, 8], 4) == "▁▃·█"
    assert course([0, 0], 5) == "··"
    assert course([], 5) == ""
    assert course([1, np.nan], 2)[1] == "?"


def test_of_values_that_share_a_letter_the_furthest_is_drawn():
    peak = np.zeros(1000)
    peak[503] = 1.0
    line = course(peak, 10)
    assert len(line) == 10
    assert line == "·····█····"


@pytest.mark.sampled(2)
@pytest.mark.parametrize("letters", [BLOCKS, ASCII], ids=["blocks", "ascii"])
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(values=st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=40), width=st.integers(1, 30))
@example(values=[5e-324], width=1)
@example(values=[-1.7e308, 1.7e308], width=2)
def test_any_numbers_fit_their_place(letters, values, width):
    drawn = bars(values, width, letters)
    assert len(drawn) == len(values)
    assert all(len(bar) <= 2 * width + 1 for bar in drawn)
    assert len(course(values, width, letters)) == min(width, len(values))
