"""Matrices in the formats of other codes, written here by hand, by SciPy or by NumPy; and what is refused of them."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

import contactqp as cq
from contactqp.exchange.matrix_files import read_matrix
from contactqp.exchange.text_matrices import read_load

K = np.array([[4.0, -1.0, 0.0], [-1.0, 5.0, 2.5], [0.0, 2.5, 3.0]])
WIDE = np.array([[1.0, 0.0, -2.5e-30, 1e30], [0.0, 1 / 3, 0.0, 0.0]])


def dense(matrix):
    return matrix.toarray() if sp.issparse(matrix) else matrix


WRITERS = {
    "a.mtx": lambda file, A: scipy.io.mmwrite(file, sp.coo_matrix(A), precision=17),
    "array.mtx": lambda file, A: scipy.io.mmwrite(file, A, precision=17),
    "a.rua": lambda file, A: scipy.io.hb_write(file, sp.csc_matrix(A)),
    "a.npy": np.save,
    "fortran.npy": lambda file, A: np.save(file, np.asfortranarray(A)),
    "big.npy": lambda file, A: np.save(file, A.astype(">f8")),
    "one.npz": lambda file, A: np.savez_compressed(file, anything=A),
    "csr.npz": lambda file, A: sp.save_npz(file, sp.csr_matrix(A)),
    "csc.npz": lambda file, A: sp.save_npz(file, sp.csc_array(A)),
    "coo.npz": lambda file, A: sp.save_npz(file, sp.coo_array(A)),
    "a.csv": lambda file, A: np.savetxt(file, A, delimiter=",", fmt="%.17g"),
    "a.txt": lambda file, A: np.savetxt(file, A, fmt="%.17g", header="some matrix"),
    "other.suffix": lambda file, A: np.savetxt(file, A, delimiter=";", fmt="%.17g"),
}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("A", [K, WIDE], ids=["square", "wide"])
@pytest.mark.parametrize("name", WRITERS)
def test_a_matrix_comes_back_to_the_last_bit(tmp_path, name, A):
    WRITERS[name](tmp_path / name, A)
    matrix, labels, ledger = read_matrix(tmp_path / name)
    assert np.array_equal(dense(matrix), A)
    assert labels is None
    assert ledger.read
    assert not ledger.assumed


@pytest.mark.parametrize("name", ["a.npy", "a.mtx", "csr.npz"])
def test_content_decides_and_not_the_suffix(tmp_path, name):
    WRITERS[name](tmp_path / name, K)
    (tmp_path / name).rename(tmp_path / "file.csv")
    assert np.array_equal(dense(read_matrix(tmp_path / "file.csv").matrix), K)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("%%MatrixMarket matrix coordinate real symmetric\n% c\n\n3 3 5\n1 1 4\n2 1 -1\n2 2 5\n3 2 2.5\n3 3 3\n", K),
        ("%%MatrixMarket MATRIX Array INTEGER Symmetric\n2 2\n1\n2\n3\n", [[1, 2], [2, 3]]),
        ("%%MatrixMarket matrix array real skew-symmetric\n3 3\n1\n2\n3\n", [[0, -1, -2], [1, 0, -3], [2, 3, 0]]),
        ("%%MatrixMarket matrix coordinate real skew-symmetric\n2 2 1\n2 1 7\n", [[0, -7], [7, 0]]),
        ("%%MatrixMarket matrix coordinate real general\n1 2 3\n1 1 1\n1 2 2\n1 1 0.5\n", [[1.5, 2]]),
        ("%%MatrixMarket matrix array real general\n0 3\n", np.zeros((0, 3))),
    ],
)
def test_matrix_market_by_its_definition(tmp_path, text, expected):
    (tmp_path / "a.mtx").write_text(text)
    matrix, _, ledger = read_matrix(tmp_path / "a.mtx")
    assert np.array_equal(dense(matrix), expected)
    halved, summed = "symmetric" in text.lower(), text.count("\n1 1 ") > 1
    assert len(ledger.converted) == halved + summed
    assert any("1 entries are stored more than once" in line for line in ledger.converted) == summed


HEAD = "%%MatrixMarket matrix "
BAD_MARKET = {
    "rows": (f"{HEAD}coordinate real general\n999999999999 2 1\n1 1 1\n", "sizes: expected at most .* rows"),
    "entries": (f"{HEAD}coordinate real general\n2 2 99999999\n1 1 1\n", "expected what a file of .* bytes can hold"),
    "dense": (f"{HEAD}array real general\n900 900\n1\n", "expected what a file of .* bytes can hold"),
    "few": (f"{HEAD}coordinate real general\n2 2 2\n1 1 1\n", "entries: expected 6 numbers, got 3"),
    "many": (f"{HEAD}array real general\n1 1\n1\n2\n", "entries: expected 1 numbers, got more"),
    "zero": (f"{HEAD}coordinate real general\n2 2 1\n0 1 1\n", "entry 1, row: expected a number from 1 to 2, got 0"),
    "beyond": (f"{HEAD}coordinate real general\n2 2 1\n1 3 1\n", "entry 1, column: expected .* to 2, got 3"),
    "half": (f"{HEAD}coordinate real general\n2 2 1\n1.5 1 1\n", "row: expected a number from 1 to 2, got 1.5"),
    "both halves": (f"{HEAD}coordinate real symmetric\n2 2 2\n1 2 1\n2 1 1\n", "expected one half of a symmetric"),
    "oblong": (f"{HEAD}coordinate real symmetric\n2 3 1\n1 1 1\n", "expected a square matrix"),
    "word": (f"{HEAD}array real general\n1 1\nx\n", "entries: expected a number, got 'x'"),
    "underscore": (f"{HEAD}array real general\n1 1\n1_0\n", "entries: expected a number, got '1_0'"),
    "field": (f"{HEAD}array words general\n1 1\n1\n", "first line: expected real or integer, got 'words'"),
    "short": (f"{HEAD}array real\n1 1\n1\n", "first line: expected %%MatrixMarket matrix"),
    "sizes": (f"{HEAD}array real general\n1\n1\n", "sizes: expected rows and columns, got '1'"),
}


@pytest.mark.parametrize("fault", BAD_MARKET)
def test_a_matrix_market_file_with_a_fault(tmp_path, fault):
    text, words = BAD_MARKET[fault]
    (tmp_path / "a.mtx").write_text(text)
    with pytest.raises(cq.InvalidProblem, match=rf"a\.mtx: .*{words}") as refused:
        read_matrix(tmp_path / "a.mtx")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", ["complex general", "pattern symmetric", "complex hermitian"])
def test_numbers_that_are_not_real_are_not_supported(tmp_path, kind):
    (tmp_path / "a.mtx").write_text(f"{HEAD}coordinate {kind}\n1 1 1\n1 1 1 0\n")
    with pytest.raises(cq.Unsupported, match=r"a\.mtx: first line: expected real numbers"):
        read_matrix(tmp_path / "a.mtx")


BOEING = """stiffness                                                               K
             7             1             1             2             1
RSA                        3             3             5             0
(4I5)           (5I5)           (3E16.8)            (1P,3D16.8)
F                          1             0
    1    3    5    6
    1    2    2    3    3
  4.00000000E+00 -1.00000000E+00  5.00000000E+00
  2.50000000E+00  3.00000000E+00
  2.00000000D+00-1.00000000D+00  5.00000000-100
"""


def test_a_symmetric_harwell_boeing_file_with_its_load(tmp_path):
    (tmp_path / "a.hb").write_text(BOEING)
    matrix, _, ledger = read_matrix(tmp_path / "a.hb")
    assert np.array_equal(matrix.toarray(), K)
    assert any("other half" in line for line in ledger.converted)
    load, _ = read_load(tmp_path / "a.hb")
    assert load.tolist() == [2.0, -1.0, 5e-100]
    WRITERS["a.rua"](tmp_path / "a.rua", K)
    assert read_load(tmp_path / "a.rua") is None


def test_a_folder_of_harwell_boeing_takes_the_load_from_it(tmp_path):
    (tmp_path / "K.rsa").write_text(BOEING)
    (tmp_path / "contacts.csv").write_text("contact,dof,coefficient,gap\nleft,0,1,0.5\n")
    problem = cq.read_problem(tmp_path)
    assert problem.load.tolist() == [2.0, -1.0, 5e-100]
    assert problem.normal.toarray().tolist() == [[1, 0, 0]]


BAD_BOEING = {
    "pattern": (("RSA", "PSA"), cq.Unsupported, "line 3: expected an assembled matrix of real numbers"),
    "complex": (("RSA", "CSA"), cq.Unsupported, "line 3: expected an assembled matrix of real numbers"),
    "elements": (("RSA", "RSE"), cq.Unsupported, "line 3: expected an assembled matrix of real numbers"),
    "type": (("RSA", "XYZ"), cq.InvalidProblem, "line 3: expected a type of matrix"),
    "format": (("(3E16.8)", "(3Q16.8)"), cq.InvalidProblem, "line 4: expected a Fortran format"),
    "entries": (("  5    ", "999    "), cq.InvalidProblem, "expected what a file|expected .* lines"),
    "pointer": (("    1    3    5    6", "    1    5    3    6"), cq.InvalidProblem, "pointers that .* never go back"),
    "row": (("    1    2    2    3    3", "    1    2    2    3    9"), cq.InvalidProblem, "expected indices from 0"),
    "value": (("2.50000000E+00", "2.5000x000E+00"), cq.InvalidProblem, "line 9: expected a number with its decimal"),
    "point": (("  2.50000000E+00", "   250000000E+00"), cq.InvalidProblem, "expected a number with its decimal point"),
    "lines": (("  2.50000000E+00  3.00000000E+00\n", ""), cq.InvalidProblem, "expected a number|lines"),
    "upper": (("    1    2    2    3    3", "    1    2    1    3    3"), cq.InvalidProblem, "entries on both sides"),
}


@pytest.mark.parametrize("fault", BAD_BOEING)
def test_a_harwell_boeing_file_with_a_fault(tmp_path, fault):
    change, error, words = BAD_BOEING[fault]
    assert change[0] in BOEING
    (tmp_path / "a.rsa").write_text(BOEING.replace(*change, 1))
    with pytest.raises(error, match=rf"a\.rsa: .*({words})") as refused:
        read_matrix(tmp_path / "a.rsa")
    assert "\n" not in str(refused.value)


def npy(header: str) -> bytes:
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()


BAD_NUMPY = {
    "huge": (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (99999999, 99999999), }"), "expected .* bytes"),
    "short": (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (2, 2), }") + bytes(31), "expected 32 bytes"),
    "objects": (npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }") + bytes(8), "array of real numbers"),
    "complex": (npy("{'descr': '<c16', 'fortran_order': False, 'shape': (1,), }") + bytes(16), "real numbers"),
    "texts": (npy("{'descr': '<U1', 'fortran_order': False, 'shape': (1,), }") + bytes(4), "real numbers, got <U1"),
    "fields": (npy("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }") + bytes(8), "real numbers"),
    "code": (npy("__import__('os').system('true')"), "a header of NumPy"),
    "cube": (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1, 1, 1), }") + bytes(8), "a matrix or a vector"),
    "negative": (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }"), "an array of real numbers"),
    "nested": (npy("(" * 4000), "a header of NumPy"),
    "long": (b"\x93NUMPY\x02\x00\xff\xff\xff\xff", "a header of at most"),
}


@pytest.mark.parametrize("fault", BAD_NUMPY)
def test_an_npy_file_with_a_fault(tmp_path, fault):
    data, words = BAD_NUMPY[fault]
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises((cq.InvalidProblem, cq.Unsupported), match=rf"a\.npy: .*{words}") as refused:
        read_matrix(tmp_path / "a.npy")
    assert "\n" not in str(refused.value)


def packed(**arrays) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


SPARSE = dict(data=[1.0, 2.0], indices=[0, 1], indptr=[0, 1, 2], shape=[2, 2], format="csr")
BAD_ARCHIVES = {
    "pointers": (SPARSE | {"indptr": [0, 2, 1]}, "pointers that begin at 0 and never go back"),
    "indices": (SPARSE | {"indices": [0, 7]}, "expected indices from 0 to 1, got 7"),
    "rows": (SPARSE | {"shape": [10**12, 2]}, "expected at most .* rows in a file of this size"),
    "form": (SPARSE | {"format": "bsr"}, "expected the sparse form csr, csc or coo, got 'bsr'"),
    "shape": (SPARSE | {"shape": [2, 2, 2]}, "shape: expected rows and columns"),
    "two": ({"a": [1.0], "b": [2.0]}, "expected one array, or SciPy's sparse matrix"),
    "words": ({"a": ["x"]}, "a: expected real numbers"),
}


@pytest.mark.parametrize("fault", BAD_ARCHIVES)
def test_an_archive_with_a_fault(tmp_path, fault):
    arrays, words = BAD_ARCHIVES[fault]
    (tmp_path / "a.npz").write_bytes(packed(**arrays))
    with pytest.raises((cq.InvalidProblem, cq.Unsupported), match=rf"a\.npz: .*{words}"):
        read_matrix(tmp_path / "a.npz")


def test_an_archive_that_holds_a_name_twice_or_is_none(tmp_path):
    file = tmp_path / "a.npz"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("K.npy", npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1,), }") + bytes(8))
        archive.writestr("K", npy("{'descr': '<f8', 'fortran_order': False, 'shape': (0,), }"))
    with pytest.raises(cq.InvalidProblem, match="K: expected every array once"):
        read_matrix(file)
    file.write_bytes(b"PK\x03\x04 and nothing")
    with pytest.raises(cq.InvalidProblem, match=r"a\.npz: content: expected an archive of arrays"):
        read_matrix(file)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2\n3\n", "line 2: expected 2 numbers, as in the lines before, got 1"),
        ("1 2\n3 x\n", "line 2: expected a number, got 'x'"),
        ("1 1_000\n", "line 1: expected a number, got '1_000'"),
        ("", "content: expected numbers in text or CSV, got no number"),
        ("a b\n1 2 3\n", "first line: expected 3 names, one a column, got 2"),
        ("1\x002\n", "line 1: expected numbers in text or CSV, got the byte 0x00: a binary file"),
    ],
)
def test_a_text_with_a_fault(tmp_path, text, words):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(cq.InvalidProblem, match=rf"a\.txt: {words}"):
        read_matrix(tmp_path / "a.txt")


def test_names_above_the_columns_are_labels(tmp_path):
    (tmp_path / "K.csv").write_text("1.x,1.y\n2,-1\n-1,2\n")
    assert read_matrix(tmp_path / "K.csv").labels == ("1.x", "1.y")
