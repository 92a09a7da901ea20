"""Everything a file can have wrong is refused in one line: file, place in it, what was expected, what came."""

from __future__ import annotations

import contextlib

import h5py
import numpy as np
import pytest

import contactqp as cq
from tests.exchange.files import (
    MU,
    H,
    M,
    Q,
    W,
    blocks_text,
    columns_text,
    dense_text,
    global_text,
    global_tree,
    local_text,
    local_tree,
    put,
    triplets_text,
    write_hdf5,
)

INTEGER = {name: np.array([value], dtype=np.int32) for name, value in dict(one=1, two=2, four=4, five=5).items()}


def at(values, place, value):
    changed = np.array(values)
    changed[place] = value
    return changed


LOCAL, JOINTS, TRIPLETS, GLOBAL = (
    local_tree(),
    local_tree(joints=True),
    local_tree("triplet"),
    global_tree(joints=True),
)
ROWS = LOCAL["fclib_local"]["W"]
BAD_HDF5 = {
    "no problem": ({"solution": {"r": Q}}, r"content: expected /fclib_local or /fclib_global, got \['solution'\]"),
    "two problems": (LOCAL | GLOBAL, r"content: expected one problem, got \['fclib_local', 'fclib_global'\]"),
    "no W": (put(LOCAL, "fclib_local/W", None), "fclib_local/W/m: expected this dataset, got none"),
    "no q": (put(LOCAL, "fclib_local/vectors/q", None), "fclib_local/vectors/q: expected this dataset, got none"),
    "no vectors": (put(LOCAL, "fclib_local/vectors", None), "fclib_local/vectors/mu: expected this dataset"),
    "no spacedim": (put(LOCAL, "fclib_local/spacedim", None), "fclib_local/spacedim: expected this dataset"),
    "spacedim 1": (put(LOCAL, "fclib_local/spacedim", INTEGER["one"]), "fclib_local/spacedim: expected 2 or 3, got 1"),
    "spacedim list": (put(LOCAL, "fclib_local/spacedim", np.array([2, 2])), "spacedim: expected one integer, got 2"),
    "spacedim real": (put(LOCAL, "fclib_local/spacedim", np.array([2.0])), "expected a list of integers, got float64"),
    "q short": (put(LOCAL, "fclib_local/vectors/q", Q[:3]), r"q: expected 4 numbers \(2 for each of the 2 contacts"),
    "q NaN": (put(LOCAL, "fclib_local/vectors/q", at(Q, 2, np.nan)), r"q: expected finite numbers, got nan at \[2\]"),
    "q words": (put(LOCAL, "fclib_local/vectors/q", np.array([b"a"] * 4)), "q: expected a list of numbers"),
    "q group": (put(LOCAL, "fclib_local/vectors/q", {"x": Q}), "q: expected a dataset, got a group"),
    "mu negative": (put(LOCAL, "fclib_local/vectors/mu", -MU), "mu: expected coefficients of friction >= 0, got -0.5"),
    "mu NaN": (put(LOCAL, "fclib_local/vectors/mu", at(MU, 0, np.nan)), "mu: expected finite numbers, got nan"),
    "mu short": (put(LOCAL, "fclib_local/vectors/mu", MU[:1]), "q: expected 2 numbers .*got 4"),
    "W size": (put(LOCAL, "fclib_local/W/m", INTEGER["five"]), r"W/m, .*: expected \(4, 4\) .* got \(5, 4\)"),
    "W mark": (put(LOCAL, "fclib_local/W/nz", np.array([-3])), r"W/nz: expected -1 \(columns\), .* got -3"),
    "W nzmax": (put(LOCAL, "fclib_local/W/nzmax", INTEGER["five"]), "W/nzmax: expected at least the 9 entries .*got 5"),
    "W x short": (put(LOCAL, "fclib_local/W/x", ROWS["x"][:8]), "W/x: expected 9 entries, got 8"),
    "W i short": (put(LOCAL, "fclib_local/W/i", ROWS["i"][:8]), "W/i: expected 9 entries, got 8"),
    "W p short": (put(LOCAL, "fclib_local/W/p", ROWS["p"][:4]), "W/p: expected 5 pointers, got 4"),
    "W p back": (
        put(LOCAL, "fclib_local/W/p", at(ROWS["p"], 2, 1)),
        r"W/p: .* got 2 and then 1 at \[2\]",
    ),
    "W p start": (put(LOCAL, "fclib_local/W/p", at(ROWS["p"], 0, 1)), r"W/p: .*begin at 0.* got 1 at \[0\]"),
    "W i outside": (put(LOCAL, "fclib_local/W/i", at(ROWS["i"], 3, 4)), r"W/i: expected indices from 0 to 3, got 4 at"),
    "W i negative": (put(LOCAL, "fclib_local/W/i", at(ROWS["i"], 3, -1)), "W/i: expected indices from 0 to 3, got -1"),
    "W NaN": (put(LOCAL, "fclib_local/W/x", at(ROWS["x"], 1, np.inf)), "W/x: expected finite numbers, got inf"),
    "W indefinite": (put(LOCAL, "fclib_local/W/x", -ROWS["x"]), "delassus: expected positive semidefinite"),
    "triplet row": (
        put(TRIPLETS, "fclib_local/W/i", at(TRIPLETS["fclib_local"]["W"]["i"], 0, 7)),
        r"W/i \(rows\): expected indices from 0 to 3, got 7",
    ),
    "triplet column": (
        put(TRIPLETS, "fclib_local/W/p", at(TRIPLETS["fclib_local"]["W"]["p"], 0, 7)),
        r"W/p \(columns\): expected indices from 0 to 3, got 7",
    ),
    "triplet number": (put(TRIPLETS, "fclib_local/W/nz", np.array([10])), "W/nzmax: expected at least the 10"),
    "V without R": (put(JOINTS, "fclib_local/R", None), "fclib_local/R/m: expected this dataset"),
    "R without V": (put(JOINTS, "fclib_local/V", None), "fclib_local/V/m: expected this dataset"),
    "no s": (put(JOINTS, "fclib_local/vectors/s", None), "vectors/s: expected this dataset"),
    "H size": (put(GLOBAL, "fclib_global/H/n", INTEGER["four"]), r"H/m, .*expected \(3, 3\) .* got \(3, 4\)"),
    "M size": (put(GLOBAL, "fclib_global/M/n", INTEGER["four"]), r"M/m, .*expected \(3, 3\) .* got \(3, 4\)"),
    "G size": (put(GLOBAL, "fclib_global/G/m", INTEGER["four"]), r"G/m, .*expected \(3, 1\) .* got \(4, 1\)"),
    "no b": (put(GLOBAL, "fclib_global/vectors/b", None), "vectors/b: expected this dataset"),
    "w short": (put(GLOBAL, "fclib_global/vectors/w", Q[:2]), "w: expected 3 numbers .*got 2"),
    "M indefinite": (
        put(GLOBAL, "fclib_global/M/x", -GLOBAL["fclib_global"]["M"]["x"]),
        "stiffness: expected positive semidefinite",
    ),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("fault", BAD_HDF5)
def test_an_fclib_file_with_a_fault(tmp_path, fault):
    tree, expected = BAD_HDF5[fault]
    file = write_hdf5(tmp_path / "bad.hdf5", tree)
    with pytest.raises(cq.InvalidProblem, match=rf"bad\.hdf5: .*{expected}") as refused:
        cq.read_fclib(file)
    assert "\n" not in str(refused.value)


def test_contacts_that_resist_rolling_are_not_supported(tmp_path):
    rolling = {"fclib_global_rolling": GLOBAL["fclib_global"]}
    five = put(LOCAL, "fclib_local/spacedim", INTEGER["five"])
    for name, tree in dict(a=rolling, b=five).items():
        with pytest.raises(cq.Unsupported, match=rf"{name}\.hdf5.*resist rolling"):
            cq.read_fclib(write_hdf5(tmp_path / f"{name}.hdf5", tree))
    (tmp_path / "c.dat").write_text("5" + local_text(dense_text(W))[1:])
    with pytest.raises(cq.Unsupported, match=r"c\.dat: dimension is 5.*resist rolling"):
        cq.read_siconos(tmp_path / "c.dat")


def test_a_file_that_is_none_or_no_hdf5(tmp_path):
    whole = write_hdf5(tmp_path / "a.hdf5", LOCAL).read_bytes()
    (tmp_path / "cut.hdf5").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.hdf5").write_text("2\n2\n")
    (tmp_path / "empty.hdf5").write_bytes(b"")
    for name, expected in {
        "absent.hdf5": "and there is none of that name",
        "text.hdf5": "got something else",
        "empty.hdf5": "got an empty file",
        "cut.hdf5": "got a damaged one",
        ".": "got a folder",
    }.items():
        for read in (cq.read_fclib, cq.read_problem):
            if name == "." and read is cq.read_fclib:
                continue
            with pytest.raises(cq.InvalidProblem, match=expected) as refused:
                read(tmp_path / name)
            assert str(tmp_path / name) in str(refused.value)
            assert "\n" not in str(refused.value)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("fraction", np.linspace(0.3, 0.98, 18))
def test_a_damaged_hdf5_file_is_refused_or_whole(tmp_path, fraction):
    """Wherever bytes are overwritten, the answer is one line or the problem, never another exception."""
    data = bytearray(write_hdf5(tmp_path / "a.hdf5", local_tree(joints=True)).read_bytes())
    place = int(fraction * len(data))
    data[place : place + 64] = b"\xa5" * 64
    (tmp_path / "b.hdf5").write_bytes(data)
    with contextlib.suppress(cq.InvalidProblem):
        assert np.all(np.isfinite(cq.read_fclib(tmp_path / "b.hdf5").delassus.data))


DENSE, BLOCKS, COLUMNS, TRIPLES = (
    dense_text(W),
    blocks_text(W, [2, 4], [2, 4]),
    columns_text(W),
    triplets_text(W),
)
GOOD = local_text(DENSE)
BAD_TEXT = {
    "empty": ("  \n", "content: expected a Siconos file .text., got an empty file"),
    "no text": ("2\n\xe9", "content: expected a Siconos file .text., got the byte 0xc3 at place 2"),
    "words": ("title = 'x'", r"dimension \(line 1\): expected an integer, got 'title'"),
    "dimension 4": ("4\n1\n", "dimension: expected 2 or 3, got 4"),
    "contacts": ("2\n-1\n", "number of contacts: expected a size, got -1"),
    "storage": ("2\n2\n7 4 4", r"first matrix, storage \(line 3\): expected 0 \(dense\), 1 .* got '7'"),
    "size twice": (GOOD.replace("4\t4", "4\t5"), r"size when it is stated again: expected \(4, 4\), got \(4, 5\)"),
    "oblong": (
        GOOD.replace("0\n4\n4\n4\t4\n", "0\n4\n3\n4\t3\n"),
        r"expected a square one .* got \(4, 3\)",
    ),
    "not a number": (GOOD.replace("-0.125", "x"), r"q \(line 8\): expected a number, got 'x'"),
    "NaN": (GOOD.replace("-0.125", "nan"), r"q: expected finite numbers, got nan at \[3\]"),
    "NaN in W": (GOOD.replace("5\n", "inf\n", 1), "first matrix: expected finite numbers, got inf"),
    "negative mu": (
        GOOD.replace("0.29999999999999999", "-0.3"),
        "mu: expected coefficients .* got -0.3",
    ),
    "too many": (GOOD + "0 1", "after the 6 numbers of q and mu: expected the end, got 2 more, beginning with '0'"),
    "no flag": (GOOD + "7", "expected the end, got 1 more, beginning with '7'"),
    "global too many": (global_text(dense_text(M), dense_text(H), "1 1"), "after mu: expected the end, got 2 more"),
    "H size": (
        global_text(dense_text(M), dense_text(H[:, :2]) + "0 0 0"),
        r"H, size: expected \(3, 3\), got \(3, 2\)",
    ),
    "indefinite": (local_text(dense_text(-W)), "delassus: expected positive semidefinite"),
    "block count": (local_text(BLOCKS.replace("\n3\n2\n2\n", "\n2\n2\n2\n")), "expected at most 3 and 2, got 3 and 3"),
    "block ends": (local_text(BLOCKS.replace("2\t4", "2\t5", 1)), "first matrix, block rows: expected .* reach 4"),
    "block column": (
        local_text(BLOCKS.replace("0\t0\t1\n0\n", "0\t0\t2\n0\n")),
        "columns: expected .* got 2",
    ),
    "block pointer": (
        local_text(BLOCKS.replace("0\t1\t3", "0\t3\t1")),
        "first block of each block row: expected",
    ),
    "block number": (local_text(BLOCKS.replace("\n2\n4 -1", "\n5\n4 -1")), r"number of a block \(line 19\): .* '5'"),
    "origin": (local_text(COLUMNS.replace("\n2\nCS", "\n4\nCS")), r"origin \(line 6\): expected 1 .*got '4'"),
    "banner": (local_text(COLUMNS.replace("CSparse", "Matrix")), "dump .line 7.: expected 'CSparse', got 'Matrix'"),
    "dump size": (local_text(COLUMNS.replace("4-by-4", "4-by-5")), r"expected \(4, 4\), got \(4, 5\)"),
    "dump column": (local_text(COLUMNS.replace("col 2", "col 3")), r"column 2 \(line .*\): expected '2', got '3'"),
    "dump place": (local_text(COLUMNS.replace("locations 3 to", "locations 4 to")), "expected '3', got '4'"),
    "dump last": (local_text(COLUMNS.replace("to 8", "to 88")), "expected a last location from 6 to 8, got '88'"),
    "dump few": (local_text(COLUMNS.replace("nnz: 9", "nnz: 10")), "first matrix: expected 10 entries, got 9"),
    "dump row": (local_text(COLUMNS.replace("      3 : 5", "      4 : 5")), "row: expected indices from 0 to 3, got 4"),
    "dump colon": (local_text(COLUMNS.replace("      3 : 5", "      3 ; 5")), "dump .line 21.: expected ':', got ';'"),
    "triplet row": (local_text(TRIPLES.replace("3 3 :", "3 4 :")), "column: expected indices from 0 to 3, got 4"),
    "triplet word": (
        local_text(TRIPLES.replace("3 3 :", "3 x :")),
        r"column .line 17.: .* got 'x'",
    ),
    "triplet huge": (local_text(TRIPLES.replace("nnz: 9", "nnz: 999999999999")), "expected 3999999999996 values"),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("fault", BAD_TEXT)
def test_a_siconos_file_with_a_fault(tmp_path, fault):
    text, expected = BAD_TEXT[fault]
    assert text not in (GOOD, *(local_text(matrix) for matrix in (BLOCKS, COLUMNS, TRIPLES)))
    file = tmp_path / "bad.dat"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(cq.InvalidProblem, match=rf"bad\.dat: .*{expected}") as refused:
        cq.read_siconos(file)
    assert "\n" not in str(refused.value)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("text", [GOOD, *(local_text(matrix) for matrix in (BLOCKS, COLUMNS, TRIPLES))])
def test_text_that_ends_early_is_refused_wherever_it_ends(tmp_path, text):
    file, words = tmp_path / "cut.dat", text.split()
    for kept in range(1, len(words)):
        file.write_text(" ".join(words[:kept]))
        with pytest.raises(cq.InvalidProblem, match=r"cut\.dat: .*expected"):
            cq.read_siconos(file)


def test_a_global_text_that_ends_early_is_refused_and_never_read_as_a_local_one(tmp_path):
    file, words = tmp_path / "cut.dat", global_text(dense_text(M), blocks_text(H, [3], [3])).split()
    for kept in range(1, len(words)):
        file.write_text(" ".join(words[:kept]))
        with pytest.raises(cq.InvalidProblem, match=r"cut\.dat: .*expected"):
            cq.read_siconos(file)


def test_a_dump_of_rows_is_not_supported(tmp_path):
    file = tmp_path / "rows.dat"
    file.write_text(local_text(COLUMNS.replace("\n2\nCS", "\n3\nCS")))
    with pytest.raises(cq.Unsupported, match=r"rows\.dat: first matrix: a dump of compressed rows"):
        cq.read_siconos(file)


def test_arrays_that_are_stated_and_not_there_fill_no_memory(tmp_path):
    """Chunks that were never written take no place in a file and all of it in the memory."""
    file = write_hdf5(tmp_path / "a.hdf5", put(LOCAL, "fclib_local/vectors/q", None))
    with h5py.File(file, "a") as stored:
        stored.create_dataset("fclib_local/vectors/q", shape=(10**12,), dtype="f8", chunks=(1024,))
    with pytest.raises(cq.InvalidProblem, match=r"a\.hdf5: fclib_local/vectors/q: expected at most .* MiB"):
        cq.read_fclib(file)
    huge = {"fclib_local/W/m": np.array([10**9], dtype=np.int32), "fclib_local/W/n": np.array([10**9], dtype=np.int32)}
    tree = LOCAL | {}
    for place, value in huge.items():
        tree = put(tree, place, value)
    with pytest.raises(cq.InvalidProblem, match=r"b\.hdf5: "):
        cq.read_fclib(write_hdf5(tmp_path / "b.hdf5", tree))
