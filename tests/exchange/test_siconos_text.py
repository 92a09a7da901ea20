"""Siconos's text: every storage, local and global told apart by what is in the file."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from tests.exchange.files import (
    MU,
    OFFSET,
    F,
    H,
    M,
    Q,
    W,
    blocks_text,
    columns_text,
    dense_text,
    global_text,
    local_text,
    triplets_text,
)

STORAGES = {
    "dense": dense_text,
    "blocks": lambda matrix: blocks_text(matrix, [2, 4], [2, 4]),
    "triplets": triplets_text,
    "columns": columns_text,
}
IN_SPACE = STORAGES | {"blocks": lambda matrix: blocks_text(matrix, [1, 3], [2, 3])}


@pytest.mark.sampled(4)
@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("end", ["", "0\n", "1"])
def test_a_local_file_is_a_local_problem(tmp_path, storage, end):
    file = tmp_path / "a.dat"
    file.write_text(local_text(STORAGES[storage](W), end))
    problem = cq.read_siconos(file)
    assert isinstance(problem, cq.LocalProblem)
    assert np.array_equal(problem.delassus.toarray(), W)
    assert np.array_equal(problem.offset, Q)
    assert np.array_equal(problem.friction, MU)
    assert problem.dimension == 2


@pytest.mark.sampled(4)
@pytest.mark.parametrize("storage", IN_SPACE)
@pytest.mark.parametrize("other", IN_SPACE)
def test_a_global_file_is_a_contact_problem(tmp_path, storage, other):
    """Three unknowns and one contact in space: M has the size of W, and the text alone tells."""
    file = tmp_path / "a-condensed.dat"
    file.write_text(global_text(IN_SPACE[storage](M), IN_SPACE[other](H), "1\n"))
    stored = cq.read_siconos(file, as_stored=True)
    assert isinstance(stored, cq.GlobalProblem)
    for name, expected in dict(matrix=M, directions=H).items():
        assert np.array_equal(getattr(stored, name).toarray(), expected)
    for name, expected in dict(load=F, offset=OFFSET, friction=MU[:1]).items():
        assert np.array_equal(getattr(stored, name), expected)
    problem = cq.read_siconos(file)
    assert isinstance(problem, cq.ContactProblem)
    assert np.array_equal(problem.normal.toarray(), -H[:, :1].T)


def test_values_are_column_by_column(tmp_path):
    file = tmp_path / "a.dat"
    file.write_text("2 1  0 2 2  2 2  1 0.5 0.25 3   -1 -2   0.7")
    assert cq.read_siconos(file).delassus.toarray().tolist() == [[1.0, 0.25], [0.5, 3.0]]


def test_line_breaks_mean_nothing(tmp_path):
    file = tmp_path / "a.dat"
    file.write_text(local_text(columns_text(W)).replace("\n", "   \n\n  "))
    assert np.array_equal(cq.read_siconos(file).delassus.toarray(), W)


def test_block_rows_at_the_end_may_be_empty(tmp_path):
    """The list of first blocks ends with the last block row that has any."""
    half = np.diag([1.0, 1.0, 0.0, 0.0])
    text = blocks_text(half, [2, 4], [2, 4])
    short = text.replace("\n3\n1\n0\t1\t1\n", "\n2\n1\n0\t1\n")
    assert short != text
    file = tmp_path / "a.dat"
    file.write_text(local_text(short))
    assert np.array_equal(cq.read_siconos(file).delassus.toarray(), half)


def test_a_global_file_without_contacts(tmp_path):
    file = tmp_path / "a.dat"
    none = "2 3 0 2 " + columns_text(np.zeros((3, 0))).split("\n", 4)[4]
    file.write_text(f"2 0 {triplets_text(M)} {none} 1 2 3")
    problem = cq.read_siconos(file)
    assert isinstance(problem, cq.ContactProblem)
    assert problem.contacts == 0
    assert problem.load.tolist() == [1, 2, 3]


@pytest.mark.parametrize("name", ["a.dat", "b.hdf5.dat", "c.txt"])
def test_content_not_suffix_says_what_a_file_is(tmp_path, name):
    text, hdf5 = tmp_path / name, tmp_path / f"binary-{name}"
    text.write_text(local_text(dense_text(W)))
    cq.write_fclib(tmp_path / "a.hdf5", cq.read_problem(text))
    (tmp_path / "a.hdf5").rename(hdf5)
    for file in (text, hdf5):
        assert np.array_equal(cq.read_problem(file).delassus.toarray(), W)
