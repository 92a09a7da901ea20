"""Results of CalculiX, .frd and .dat, written here word by word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.errors import InvalidProblem, Unsupported
from contactqp.exchange.answer_files import read_answer
from contactqp.exchange.calculix_results import read_dat

# Two springs of 3 and 2 in a row; node 17 stops at a wall half a unit away, and node 3 is held.
PROBLEM = cq.ContactProblem(
    stiffness=[[3.0, -3.0], [-3.0, 5.0]],
    load=[6.0, 0.0],
    normal=[[0.0, 1.0]],
    gap=[0.5],
    dof_names=["4.1", "17.1"],
    contact_names=["node 17"],
)
FRD = """\
    1C
    1UPGM               CalculiX
    2C                             3                                     1
 -1         3 0.00000E+00 0.00000E+00 0.00000E+00
 -1         4 1.00000E+00 0.00000E+00 0.00000E+00
 -1        17 2.00000E+00 0.00000E+00 0.00000E+00
 -3
    1PSTEP                         1           1           1
  100CL  101 0.500000000           3                     0    1           1
 -4  DISP        4    1
 -5  D1          1    2    1    0
 -5  D2          1    2    2    0
 -5  D3          1    2    3    0
 -5  ALL         1    2    0    0    1ALL
 -1         3 0.00000E+00 0.00000E+00 0.00000E+00
 -1         4 1.00000E+00 0.00000E+00 0.00000E+00
 -1        17 2.50000E-01 0.00000E+00 0.00000E+00
 -3
    1PSTEP                         2           1           1
  100CL  102 1.000000000           3                     0    1           1
 -4  DISP        4    1
 -5  D1          1    2    1    0
 -5  D2          1    2    2    0
 -5  D3          1    2    3    0
 -5  ALL         1    2    0    0    1ALL
 -1         3 0.00000E+00 0.00000E+00 0.00000E+00
 -1         4 2.50000E+00 0.00000E+00 0.00000E+00
 -1        17 5.00000E-01 0.00000E+00 0.00000E+00
 -3
    1PSTEP                         3           1           1
  100CL  102 1.000000000           3                     0    1           1
 -4  CONTACT     6    1
 -5  COPEN       1    4    1    1
 -5  CSLIP1      1    4    2    2
 -5  CSLIP2      1    4    3    3
 -5  CPRESS      1    4    1    2
 -5  CSHEAR1     1    4    2    3
 -5  CSHEAR2     1    4    3    1
 -1        17-1.00000E-99 0.00000E+00 0.00000E+00 2.50000E+00 0.00000E+00-0.00000E+00
 -3
 9999
"""
DAT = """\

 displacements (vx,vy,vz) for set NALL and time  0.5000000E+00

         3  0.000000E+00  0.000000E+00  0.000000E+00
         4  1.000000E+00  0.000000E+00  0.000000E+00
        17  2.500000E-01  0.000000E+00  0.000000E+00

 displacements (vx,vy,vz) for set NALL and time  0.1000000E+01

         3  0.000000E+00  0.000000E+00  1.000000-101
         4  2.500000E+00  0.000000E+00  0.000000E+00
        17  5.000000E-01  0.000000E+00  0.000000E+00

 relative contact displacement (slave node,normal,tang1,tang2) for all contact elements and time 0.1000000E+01

        17 -1.000000-101  0.000000E+00  0.000000E+00

 contact stress (slave node,press,tang1,tang2) for all contact elements and time 0.1000000E+01

        17  2.500000E+00  0.000000E+00  0.000000E+00

 statistics for slave set S, master set M and time  0.1000000E+01

   total surface force (fx,fy,fz) and moment about the origin (mx,my,mz)

    0.000000E+00  2.400000E+04  0.000000E+00 -1.199851E+05  0.000000E+00  5.327472E+05
"""


def written(folder: Path, name: str, text: str) -> Path:
    (folder / name).write_bytes(text.encode("latin-1"))
    return folder / name


@pytest.mark.parametrize(("name", "text"), [("job.frd", FRD), ("job.dat", DAT), ("renamed.txt", DAT)])
def test_the_last_increment_is_the_answer(tmp_path: Path, name: str, text: str) -> None:
    parts, ledger, named, *_ = read_answer(written(tmp_path, name, text), PROBLEM)
    assert parts["displacement"].tolist() == [2.5, 0.5]
    assert parts["normal_pressure"].tolist() == [2.5]
    assert named == {"displacement", "normal_pressure"}
    assert "displacements of 1 earlier times" in ledger.ignored
    assert any(line.startswith("7 displacements that are not unknowns") for line in ledger.ignored)
    force = 2.0 * parts["normal_pressure"]  # on an area of two
    assert cq.certify(PROBLEM, parts["displacement"], force).passed


@pytest.mark.parametrize(("name", "text"), [("job.frd", FRD), ("job.dat", DAT)])
def test_text_that_windows_saved_again_is_read_and_utf_16_named(tmp_path: Path, name: str, text: str) -> None:
    plain, saved, wide = (tmp_path / part / name for part in ("plain", "saved", "wide"))
    for file, data in (
        (plain, text.encode()),
        (saved, b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode()),
        (wide, text.encode("utf-16")),
    ):
        file.parent.mkdir()
        file.write_bytes(data)
    expected, found = (read_answer(file, PROBLEM).parts["displacement"] for file in (plain, saved))
    assert found.tolist() == expected.tolist()
    with pytest.raises(InvalidProblem, match="UTF-16: save it as UTF-8"):
        read_answer(wide, PROBLEM)


def test_tables_of_no_contact_are_named_in_the_ledger(tmp_path: Path) -> None:
    ledger = read_answer(written(tmp_path, "job.dat", DAT), PROBLEM).ledger
    assert any("statistics for slave set" in line for line in ledger.ignored)


def test_tables_of_two_sets_are_one_answer(tmp_path: Path) -> None:
    text = DAT.replace(
        "        17  5.000000E-01",
        "\n displacements (vx,vy,vz) for set B and time  0.1000000E+01\n\n        17  5.000000E-01",
    )
    assert read_answer(written(tmp_path, "job.dat", text), PROBLEM).parts["displacement"].tolist() == [2.5, 0.5]


def test_a_contact_without_element_does_not_press(tmp_path: Path) -> None:
    two = PROBLEM.replace(normal=[[0.0, 1.0], [1.0, 0.0]], gap=[0.5, 9.0], contact_names=["node 17", "node 4"])
    parts, ledger, *_ = read_answer(written(tmp_path, "job.dat", DAT), two)
    assert parts["normal_pressure"].tolist() == [2.5, 0.0]
    assert ledger.assumed == ["1 contacts have no contact element: no pressure"]


def test_pressures_of_contacts_without_node_are_left_out(tmp_path: Path) -> None:
    parts, ledger, *_ = read_answer(written(tmp_path, "job.dat", DAT), PROBLEM.replace(contact_names=["the stop"]))
    assert set(parts) == {"displacement"}
    assert any("not called by their slave node" in line for line in ledger.ignored)


def test_pressures_at_every_node_are_extrapolated_and_left_out(tmp_path: Path) -> None:
    zeros = " 0.00000E+00" * 6 + "\n"
    block = " -1        17-1.00000E-99"
    text = FRD.replace(block, f" -1         3{zeros} -1         4{zeros}{block}")
    parts, ledger, *_ = read_answer(written(tmp_path, "job.frd", text), PROBLEM)
    assert set(parts) == {"displacement"}
    assert any("integration points of faces" in line for line in ledger.ignored)


def test_pressures_of_faces_are_no_pressures_at_nodes(tmp_path: Path) -> None:
    text = DAT.replace("(slave node,", "(slave element+face,").replace("        17 ", "        17      3 ")
    text = text.replace("        17      3  5.000000E-01", "        17  5.000000E-01")
    text = text.replace("        17      3  2.500000E-01", "        17  2.500000E-01")
    parts, ledger, *_ = read_answer(written(tmp_path, "job.dat", text), PROBLEM)
    assert set(parts) == {"displacement"}
    assert any("slave element+face" in line for line in ledger.ignored)


def test_a_pressure_of_a_node_that_is_no_contact_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidProblem, match="one of node 17 too"):
        read_answer(written(tmp_path, "job.dat", DAT), PROBLEM.replace(contact_names=["node 4"]))


def test_a_pressure_of_a_node_that_is_held_is_left_out(tmp_path: Path) -> None:
    stress = DAT.index(" contact stress")
    text = DAT[:stress] + DAT[stress:].replace("        17 ", "         3 -3.000000E+00  0.0  0.0\n        17 ", 1)
    parts, ledger, *_ = read_answer(written(tmp_path, "job.dat", text), PROBLEM)
    assert parts["normal_pressure"].tolist() == [2.5]
    assert "contact pressures at 1 nodes that are held, such as node 3" in ledger.ignored


def test_unknowns_need_node_and_axis(tmp_path: Path) -> None:
    with pytest.raises(InvalidProblem, match=r"unknowns called node.axis, such as 12.2"):
        read_answer(written(tmp_path, "job.dat", DAT), PROBLEM.replace(dof_names=["left", "right"]))
    with pytest.raises(InvalidProblem, match=r"displacement: expected one of each unknown, 18.1 too"):
        read_answer(written(tmp_path, "job.dat", DAT), PROBLEM.replace(dof_names=["4.1", "18.1"]))
    assert len(read_answer(written(tmp_path, "a.dat", DAT), PROBLEM.replace(dof_names=["4.x", "17.x"])).parts) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FRD[:-6], "expected a line 9999"),
        (FRD[: FRD.rindex(" -3")], "expected a line 9999"),
        (FRD.replace(" -1        17 5.00000E-01 0.00000E+00 0.00000E+00\n", ""), "3 nodes of DISP"),
        (FRD.replace("17 5.00000E-01 0.00000E+00 0.00000E+00", "17 5.00000E-01"), "expected a number, got ''"),
        (FRD.replace("17 5.00000E-01", "17 5.0x000E-01"), "expected a number"),
        (FRD.replace("        17 5.00000E-01", "      1 7 5.00000E-01"), "expected a whole number"),
        (FRD.replace(" -1        17 5.0", " -1         4 5.0"), "each node of DISP once"),
        (FRD.replace(" -4  DISP        4", " -4  DISP        5"), "5 lines -5"),
        (FRD.replace(" -4  DISP        4", " -4  DISP    99999"), "1 to 100 components"),
        (
            FRD.replace(
                "           3                     0    1           1",
                "   999999999                     0    1           1",
            ),
            "999999999 nodes",
        ),
        (FRD.replace("    1C\n", "    2C\n", 1), "first line"),
        (FRD + "garbage\n", "nothing after 9999"),
        ("    1C\n\xff\n", "0xff"),
        ("    1C\n 9999\n", "with displacements, got none"),
    ],
)
def test_refused_frd(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidProblem, match=message) as refused:
        read_answer(written(tmp_path, "job.frd", text), PROBLEM)
    assert "\n" not in str(refused.value)


def test_binary_frd_is_refused_by_name(tmp_path: Path) -> None:
    header = FRD.split(" -1 ")[0].replace("        1\n", "        3\n")
    with pytest.raises(Unsupported, match="line 3: a binary block"):
        read_answer(written(tmp_path, "job.frd", header + "\x00\xff" * 40), PROBLEM)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (DAT[:-9], "cut off"),
        (
            DAT.replace("        17  5.000000E-01  0.000000E+00  0.0", "        17  5.000000E-01  0.0"),
            "a node and 3 values",
        ),
        (DAT.replace("        17  5.00", "        17  5,00"), "expected a number"),
        (DAT.replace("        17  5.00", "         4  5.00"), "each node once at a time"),
        ("", "got nothing"),
        ("1 2 3\n", "the title of a table"),
        ("\n\n", "no table"),
    ],
)
def test_refused_dat(tmp_path: Path, text: str, message: str) -> None:
    from contactqp.exchange.calculix_results import read_dat_answer

    with pytest.raises(InvalidProblem, match=message) as refused:
        read_dat_answer(written(tmp_path, "job.dat", text), PROBLEM)
    assert "\n" not in str(refused.value)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("text", [FRD, DAT])
def test_mutations_are_refused_in_one_line_or_read(tmp_path: Path, text: str) -> None:
    """A byte changed, a piece cut out or doubled, the rest cut off: one line of an own error, or an answer."""
    rng = np.random.default_rng(20)
    data = text.encode()
    said: list[str] = []
    for _ in range(400):
        at, to = np.sort(rng.integers(0, len(data), 2))
        kind = rng.integers(4)
        mutant = [
            data[:at] + bytes([rng.integers(256)]) + data[at + 1 :],
            data[:at],
            data[:at] + data[to:],
            data[:to] + data[at:],
        ][kind]
        (tmp_path / "job.frd").write_bytes(mutant)
        try:
            read_answer(tmp_path / "job.frd", PROBLEM)
        except (InvalidProblem, Unsupported) as error:
            said.append(str(error))
    assert len(said) > 200
    assert not any("\n" in line for line in said)


def test_exponents_without_a_letter_are_read_behind_a_point_too(tmp_path):
    file = tmp_path / "job.dat"
    file.write_text(" displacements (vx,vy,vz) for set S and time 1.0E+00\n\n 1 -2.-02 1.5-101 0.E+00\n")
    assert read_dat(file)[0][0].values.tolist() == [[-0.02, 1.5e-101, 0.0]]
