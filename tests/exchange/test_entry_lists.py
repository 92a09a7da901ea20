"""Stiffness matrices as CalculiX and Abaqus print them; the files are written here word by word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from contactqp.errors import InvalidProblem, Unsupported
from contactqp.exchange.matrix_files import read_matrix

# Two springs of 3 and 2 in a row, the second one's end held.
K = np.array([[3.0, -3.0], [-3.0, 5.0]])
STI = "1 1  3.0000000000000e+00\n1 2 -3.0000000000000e+00\n2 2  5.0000000000000e+00\n"
DOF = "4.1\n17.1\n"
ABAQUS = "** written by hand\n4,1, 4,1, 3.0e+00\n17,1, 4,1, -3.0e+00\n17,1, 17,1, 5.0e+00\n"
FIXED = ABAQUS + "20,1, 17,1, -2.0e+00\n20,1, 20,1, 1.0e+36\n"


def sti(folder: Path, entries: str = STI, unknowns: str | None = DOF) -> Path:
    (folder / "job.sti").write_text(entries)
    if unknowns is not None:
        (folder / "job.dof").write_text(unknowns)
    return folder / "job.sti"


def mtx(folder: Path, text: str) -> Path:
    (folder / "job_STIF1.mtx").write_text(text)
    return folder / "job_STIF1.mtx"


def test_calculix_triangle_is_mirrored_and_unknowns_have_their_names(tmp_path: Path) -> None:
    matrix, labels, ledger = read_matrix(sti(tmp_path))
    assert matrix.toarray().tolist() == K.tolist()
    assert labels == ("4.1", "17.1")
    assert "the other triangle is its mirror image" in ledger.converted
    assert any("prescribed displacements are zero" in line for line in ledger.assumed)


def test_both_triangles_are_taken_as_they_are(tmp_path: Path) -> None:
    matrix, _, ledger = read_matrix(sti(tmp_path, STI + "2 1 -3.0\n"))
    assert matrix.toarray().tolist() == K.tolist()
    assert not ledger.converted


@pytest.mark.parametrize(
    ("entries", "unknowns", "message"),
    [
        (STI[:-9], DOF, "last line: expected a line break"),
        (STI[:-1], DOF, "last line: expected a line break"),
        (STI[: STI.index("2 2")], DOF, "diagonal: expected an entry for each of 2 unknowns, got none for unknown 2"),
        (STI + "1 2 -3.0\n", DOF, r"each once, got entry \(1, 2\) twice"),
        (STI + "3 3 1.0\n", DOF, "indices: expected at most 2"),
        (STI + "2 999999999999 1.0\n", DOF, "indices: expected at most 2"),
        (STI.replace("1 2 ", "0 2 "), DOF, "whole numbers from 1 on"),
        (STI.replace("1 2 ", "1.5 2 "), DOF, "whole numbers from 1 on"),
        (STI.replace("5.0000000000000e+00", "nan"), DOF, "finite"),
        (STI.replace("5.0", "five"), DOF, "could not convert"),
        (STI + "1 2\n", DOF, "number of columns changed"),
        ("1 1 1.0 2.0\n", "1.1\n", "3 numbers a line, got 4"),
        ("", DOF, "got nothing"),
        (STI, None, r"job\.dof: expected"),
        (STI, "4.1\n4.1\n", "each unknown once, got 4.1 twice"),
        (STI, "4.1\n17.1", "cut off"),
        (STI, "4.1\nx\n", "line 2: expected node.axis"),
        (STI, "", "got nothing"),
        (STI, DOF + "18.1\n", "got none for unknown 3"),
    ],
)
def test_calculix_refusals(tmp_path: Path, entries: str, unknowns: str | None, message: str) -> None:
    with pytest.raises(InvalidProblem, match=message) as refused:
        read_matrix(sti(tmp_path, entries, unknowns))
    assert "\n" not in str(refused.value)


def test_mass_is_no_stiffness(tmp_path: Path) -> None:
    (tmp_path / "job.mas").write_text(STI)
    with pytest.raises(InvalidProblem, match=r"mass matrix; the stiffness is in the \.sti"):
        read_matrix(tmp_path / "job.mas")


@pytest.mark.parametrize(
    "text",
    [
        ABAQUS,
        ABAQUS.replace("** written by hand", "*MATRIX INPUT, NAME=K"),
        ABAQUS.replace("17,1, 4,1,", "4,1, 17,1,"),  # the other triangle
        ABAQUS + "4,1, 17,1, -3.0\n",  # both
        ABAQUS.replace("\n", "\r\n"),
    ],
)
def test_abaqus_labels(tmp_path: Path, text: str) -> None:
    matrix, labels, _ = read_matrix(mtx(tmp_path, text))
    assert matrix.toarray().tolist() == K.tolist()
    assert labels == ("4.1", "17.1")


def test_abaqus_fixed_unknowns_are_left_out(tmp_path: Path) -> None:
    matrix, labels, ledger = read_matrix(mtx(tmp_path, FIXED))
    assert matrix.toarray().tolist() == K.tolist()
    assert labels == ("4.1", "17.1")
    assert ledger.converted[-1].startswith("1 fixed unknowns")


def test_abaqus_coordinates_have_no_names(tmp_path: Path) -> None:
    matrix, labels, _ = read_matrix(mtx(tmp_path, STI))
    assert matrix.toarray().tolist() == K.tolist()
    assert labels is None


def test_matrix_market_keeps_its_suffix(tmp_path: Path) -> None:
    banner = "%%MatrixMarket matrix coordinate real symmetric\n2 2 3\n"
    matrix, _, _ = read_matrix(mtx(tmp_path, banner + "1 1 3\n2 1 -3\n2 2 5\n"))
    assert matrix.toarray().tolist() == K.tolist()


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        (ABAQUS[:-3], InvalidProblem, "cut off"),
        (ABAQUS.replace("4,1, 4,1", "-4,1, -4,1"), Unsupported, "internal nodes"),
        (ABAQUS + "4,1, 4,1, 1.0\n", InvalidProblem, "twice"),
        (ABAQUS + "4,1, 20,1, 1.0\n", InvalidProblem, "none for unknown 3"),
        (ABAQUS + "4,1, 17,1, -3.0\n20,1, 4,1, 1.0\n20,1, 20,1, 1.0\n", InvalidProblem, "without its mirror"),
        ("4,1, 4,1, 1e36\n", InvalidProblem, "an unknown that is not fixed"),
        ("4,1, 4,1, 1e400\n", InvalidProblem, "finite"),
        ("1 1 1.0\n1 99999999999 1.0\n", InvalidProblem, "an entry for each of 99999999999 unknowns"),
        ("1 2\n", InvalidProblem, "got 2 words"),
        ("** nothing\n", InvalidProblem, "first line"),
    ],
)
def test_abaqus_refusals(tmp_path: Path, text: str, kind: type[Exception], message: str) -> None:
    with pytest.raises(kind, match=message) as refused:
        read_matrix(mtx(tmp_path, text))
    assert "\n" not in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sti", "mtx"])
def test_mutations_are_refused_in_one_line_or_read(tmp_path: Path, kind: str) -> None:
    """A byte changed, a piece cut out or doubled, the rest cut off: one line of an own error, or a matrix."""
    rng = np.random.default_rng(21)
    data = (STI if kind == "sti" else FIXED).encode()
    file = sti(tmp_path) if kind == "sti" else mtx(tmp_path, FIXED)
    said: list[str] = []
    for _ in range(400):
        at, to = np.sort(rng.integers(0, len(data), 2))
        changed = data[:at] + bytes([rng.integers(256)]) + data[at + 1 :]
        file.write_bytes([changed, data[:at], data[:at] + data[to:], data[:to] + data[at:]][rng.integers(4)])
        try:
            read_matrix(file)
        except (InvalidProblem, Unsupported) as error:
            said.append(str(error))
    assert len(said) > 200
    assert not any("\n" in line for line in said)


def test_a_line_without_end_is_not_read_whole(tmp_path: Path) -> None:
    with pytest.raises(InvalidProblem, match="line 1: expected at most 65536 bytes"):
        read_matrix(sti(tmp_path, "1 " * 100_000 + "\n"))
