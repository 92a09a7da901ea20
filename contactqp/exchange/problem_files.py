"""Read a problem from a file or a folder of any format, recognised by its content.

Quadratic programs, QPS and MPS, the .mat of qpbenchmark and the .npz of `qpsolvers.Problem.save`, become a
ContactProblem as `ContactProblem.from_qp` makes it. A constant term of the energy is dropped with a note in the ledger,
as it does not change the answer.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendMissing, InvalidProblem, counted, counts
from contactqp.exchange.fclib import SIGNATURE, SIGNATURE_PLACES, is_hdf5, read_fclib
from contactqp.exchange.files import Ledger, Path, check_finite, read_bytes, refuse_utf_16, wrong
from contactqp.exchange.matrix_files import stiffness_suffixes
from contactqp.exchange.numpy_files import ZIP, names_in_npz, read_npz, sparse_matrix
from contactqp.exchange.problem_folder import is_problem_folder, read_problem_archive, read_problem_folder
from contactqp.exchange.problem_writing import PROBLEM_FILE
from contactqp.exchange.processes import read_in_own_process
from contactqp.exchange.siconos import read_siconos
from contactqp.model.arguments import checked
from contactqp.model.local_problem import GlobalProblem, LocalProblem
from contactqp.model.problem import ContactProblem

QPS, MATLAB = (".qps", ".mps"), (".mat",)
# qpsolvers' names for the parts of a problem; missing parts are stored as a pickled None, which is never unpickled.
PARTS = ("P", "q", "G", "h", "A", "b", "lb", "ub")
# Bounds of at least this size mean "unbounded" in the .mat files of qpbenchmark and in HiGHS.
INFINITE = 1e20


def is_quadratic_program(path: Path) -> bool:
    """Return whether a file is a quadratic program, by its suffix or, for an archive, by the names in it."""
    suffix = FilePath(path).suffix.lower()
    if suffix in (*QPS, *MATLAB):
        return True
    names = names_in_npz(path) if suffix == ".npz" else set()
    return {"P", "q"} <= names <= set(PARTS)


def read_quadratic_program(path: Path) -> tuple[ContactProblem, Ledger]:
    """Return the problem in a file and what was read, assumed and left out.

    Raises
    ------
    InvalidProblem
        The file is damaged, or its parts make no convex problem.
    BackendMissing
        A .qps or .mps file without highspy, which reads them.
    """
    suffix = FilePath(path).suffix.lower()
    if suffix in QPS:
        return _read_qps(path)
    return _read_matlab(path) if suffix in MATLAB else _read_archive(path)


def _read_archive(path: Path) -> tuple[ContactProblem, Ledger]:
    arrays = read_npz(path, none_for_objects=True)
    parts: dict[str, Any] = {name: arrays.get(name) for name in PARTS}
    pairs = (("P", "q"), ("G", "h"), ("A", "b"))
    pickled = [matrix for matrix, beside in pairs if parts[matrix] is None and parts[beside] is not None]
    if pickled:
        what = "pickled objects, as qpsolvers saves sparse matrices, of which nothing is read: save them by .toarray()"
        raise wrong(path, ", ".join(pickled), "arrays", what)
    problem = ContactProblem.from_qp(**parts)
    return problem, _ledger_of_program(path, problem, "qpsolvers", 0.0)


def _read_matlab(path: Path) -> tuple[ContactProblem, Ledger]:
    """Read min 1/2 x'P x + q'x + r over l <= A x <= u, where the last n rows of A are the identity."""
    found = _matrices(path, read_in_own_process(path, "mat", "a .mat file of qpbenchmark"))
    missing = [name for name in ("P", "q", "A", "l", "u") if name not in found]
    if missing:
        raise wrong(path, "content", "P, q, A, l and u of qpbenchmark", f"none called {', '.join(missing)}")
    q, lower, upper = (_vector(path, name, found[name]) for name in ("q", "l", "u"))
    A, n = sp.csr_matrix(_real(path, "A", found["A"])), len(q)
    count = A.shape[0] - n
    if count < 0 or A.shape[1] != n or len(lower) != A.shape[0] or len(upper) != A.shape[0]:
        shapes = f"A {A.shape}, q ({n},), l ({len(lower)},), u ({len(upper)},)"
        raise wrong(path, "shapes", "l <= A x <= u with as many rows at the end as there are unknowns", shapes)
    if abs(A[count:] - sp.identity(n)).max() if n else False:
        raise wrong(path, "A", f"the identity in its last {n} rows, for bounds", "other entries")
    lower, upper = np.where(lower <= -INFINITE, -np.inf, lower), np.where(upper >= INFINITE, np.inf, upper)
    sides = dict(lb=lower[count:], ub=upper[count:], C=A[:count], l=lower[:count], u=upper[:count])
    problem = ContactProblem.from_qp(_real(path, "P", found["P"]), q, **sides)
    constant = _vector(path, "r", found["r"]) if "r" in found else np.zeros(1)
    return problem, _ledger_of_program(path, problem, "qpbenchmark", float(constant[0]) if len(constant) else 0.0)


def _read_qps(path: Path) -> tuple[ContactProblem, Ledger]:
    """Read a program with HiGHS; the signs of one that is to be maximised are reversed."""
    if importlib.util.find_spec("highspy") is None:
        raise BackendMissing(f"{path}: .qps and .mps files are read by HiGHS: pip install highspy")
    refuse_utf_16(path, read_bytes(path, EXPECTED, HEAD))
    found = _matrices(path, read_in_own_process(path, "qps", "a quadratic program in QPS form"))
    parts = {name: found[name] for name in ("C", "l", "u", "lb", "ub")}
    parts["dof_names"] = _names(found["names"], len(found["q"]))
    parts["range_names"] = _names(found["row_names"], found["C"].shape[0])
    problem = ContactProblem.from_qp(found["P"], found["q"], **parts)
    return problem, _ledger_of_program(path, problem, "QPS", float(found["offset"]))


def _names(given: Any, count: int) -> list[str] | None:
    """Return the names in a file, None unless they are `count` different ones."""
    names = [name.decode("utf-8", errors="replace") for name in given.ravel().tolist()]
    return names if len(names) == len(set(names)) == count else None


def _matrices(path: Path, arrays: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays that were read, sparse matrices put together again."""
    sparse = {name.removesuffix("_indptr") for name in arrays if name.endswith("_indptr")}
    parts = {f"{name}_{part}" for name in sparse for part in ("data", "indices", "indptr", "shape")}
    found = {name: array for name, array in arrays.items() if name not in parts}
    return found | {name: sparse_matrix(path, arrays, f"{name}_") for name in sparse}


def _vector(path: Path, name: str, values: Any) -> Any:
    vector = np.asarray(values.toarray() if sp.issparse(values) else values)
    if vector.dtype.kind not in "fiu":
        raise wrong(path, name, "real numbers", vector.dtype)
    vector = vector.astype(float).ravel()
    if name == "q":
        check_finite(path, name, vector)
    return vector


def _real(path: Path, name: str, matrix: Any) -> Any:
    if matrix.dtype.kind not in "fiu":
        raise wrong(path, name, "real numbers", matrix.dtype)
    if matrix.ndim > 2:
        raise wrong(path, name, "a matrix", f"an array of shape {matrix.shape}")
    return sp.csr_matrix(matrix, dtype=float) if sp.issparse(matrix) else np.asarray(matrix, dtype=float)


def _ledger_of_program(path: Path, problem: ContactProblem, form: str, constant: float) -> Ledger:
    ledger = Ledger(str(path))
    counts = f"{problem.dimension} unknowns, {problem.contacts} inequalities, {problem.ties} equations"
    ledger.read.append(f"a quadratic program ({form}): {counts}")
    if constant:
        ledger.ignored.append(f"the constant {constant:.9g} of the energy, which moves nothing")
    return ledger


EXPECTED = (
    "a folder or .npz of matrices, a file of FCLIB (HDF5) or Siconos (text), a quadratic program, or a deck (.inp)"
)
HEAD = max(SIGNATURE_PLACES) + len(SIGNATURE)
HDF5, TEXT, ARCHIVE, DECK = (".hdf5", ".h5"), (".dat",), (".npz",), (".inp",)
# Decks are read by `contactqp.scene`, a layer above this one, which is therefore imported by name.
DECK_READER = "contactqp.scene.deck.deck:read_deck_problem"


@checked
def read_problem(path: Path, *, as_stored: bool = False) -> ContactProblem | LocalProblem | GlobalProblem:
    """Return the problem in a folder or .npz of matrices, a quadratic program, a deck, or a file of FCLIB or Siconos.

    Parameters, results and errors are those of `read_fclib`; matrices and decks make a ContactProblem.
    """
    return read_problem_with_ledger(path, as_stored=as_stored)[0]


def read_problem_with_ledger(
    path: Path, *, as_stored: bool = False
) -> tuple[ContactProblem | LocalProblem | GlobalProblem, Ledger]:
    """Return the problem as `read_problem` does, and the ledger of what was read, converted, assumed and ignored."""
    if is_quadratic_program(path):
        return read_quadratic_program(path)
    if is_deck(path):
        module, _, function = DECK_READER.partition(":")
        found: tuple[ContactProblem, Ledger] = getattr(importlib.import_module(module), function)(path)
        return found
    if is_of_matrices(path):
        folder = _folder(path)
        if folder.is_dir() and not is_problem_folder(folder):
            raise InvalidProblem(f"{path}: expected {EXPECTED}, got a folder without problem.json or stiffness")
        return read_problem_folder(folder) if folder.is_dir() else read_problem_archive(path)
    if FilePath(path).suffix.lower() == ".toml":
        raise wrong(path, "content", "a problem", "a case file: contactqp.run solves it, contactqp.load_scene reads it")
    if FilePath(path).suffix.lower() in stiffness_suffixes():
        raise wrong(path, "content", "a folder of this stiffness, a load, and contacts", "the stiffness alone")
    hdf5 = is_hdf5(read_bytes(path, EXPECTED, HEAD)) or FilePath(path).suffix.lower() in HDF5
    problem = read_fclib(path, as_stored=as_stored) if hdf5 else read_siconos(path, as_stored=as_stored)
    return problem, _ledger(path, problem, "FCLIB" if hdf5 else "Siconos")


def is_deck(path: Path) -> bool:
    """Return whether a file is an input deck of Abaqus or CalculiX, by its suffix."""
    return FilePath(path).suffix.lower() in DECK


def is_of_matrices(path: Path) -> bool:
    """Return whether this is a folder (or the problem.json in it) or an archive of matrices, or a deck."""
    file = FilePath(path)
    if os.path.isdir(file):
        return True
    if os.path.isfile(file) and is_quadratic_program(path):
        return True
    if file.name == PROBLEM_FILE or file.suffix.lower() in (*ARCHIVE, *DECK):
        return True
    return os.path.isfile(file) and read_bytes(path, EXPECTED, len(ZIP)) == ZIP


def is_problem_file(path: Path) -> bool:
    """Return whether a file or folder is one that `read_problem` reads, by content or suffix, and not a case file.

    A folder is one if it holds a problem.json or a stiffness.
    """
    file = FilePath(path)
    suffix = file.suffix.lower()
    if file.is_dir():
        return is_problem_folder(file)
    if suffix == ".toml":
        return False
    if (
        suffix in (*HDF5, *TEXT, *QPS, *MATLAB, *DECK)
        or file.name == PROBLEM_FILE
        or suffix in (*ARCHIVE, *stiffness_suffixes())
    ):
        return True
    if not file.is_file():
        return False
    head = read_bytes(path, EXPECTED, HEAD)
    first = head.split(maxsplit=1)[:1]
    return is_hdf5(head) or head.startswith(ZIP) or bool(first and first[0].isdigit())


def _folder(path: Path) -> FilePath:
    file = FilePath(path)
    return file.parent if file.name == PROBLEM_FILE else file


def _ledger(path: Path, problem: ContactProblem | LocalProblem | GlobalProblem, code: str) -> Ledger:
    ledger = Ledger(str(path))
    if isinstance(problem, LocalProblem):
        ledger.read.append(f"{code}, local form: {counted('contact', problem.contacts)} in {problem.dimension}D")
    elif isinstance(problem, GlobalProblem):
        ledger.read.append(f"{code}, global form: {counts(unknown=len(problem.load), contact=len(problem.friction))}")
    else:
        ledger.read.append(f"{code}, global form: {counts(unknown=problem.dimension, contact=problem.contacts)}")
        ledger.converted.append("E_N = -H_N', g = w_N, E_T = H_T', slip_origin = -w_T, ties G' u = -b")
    if problem.asymmetry > 0:
        became = "symmetrised" if isinstance(problem, ContactProblem) else "it stays as it is"
        ledger.converted.append(f"asymmetric by {problem.asymmetry:.1g}: {became}")
    if isinstance(problem, ContactProblem):
        ledger.note_rigid_change(problem.rigid_change)
    return ledger
