"""Read quadratic programs: QPS and MPS, the .mat of qpbenchmark, the .npz of `qpsolvers.Problem.save`.

All become a ContactProblem as `ContactProblem.from_qp` makes it. A constant of the energy is left out, which the ledger
says: it moves nothing.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendMissing
from contactqp.exchange.files import Ledger, Path, check_finite, wrong
from contactqp.exchange.numpy_files import names_in_npz, read_npz, sparse_matrix
from contactqp.exchange.own_process import read_in_own_process
from contactqp.model.problem import ContactProblem

QPS, MATLAB = (".qps", ".mps"), (".mat",)
# What qpsolvers calls the parts of a problem; those that it does not have are pickled as None and never unpickled.
PARTS = ("P", "q", "G", "h", "A", "b", "lb", "ub")
# From here on a bound is none, in the .mat files of qpbenchmark and in HiGHS.
INFINITE = 1e20


def is_quadratic_program(path: Path) -> bool:
    """Return whether a file is a quadratic program, by its suffix or, an archive, by the names in it."""
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
    problem = ContactProblem.from_qp(**parts)
    return problem, _ledger(path, problem, "qpsolvers", 0.0)


def _read_matlab(path: Path) -> tuple[ContactProblem, Ledger]:
    """minimise 1/2 x'P x + q'x + r subject to l <= A x <= u; the last n rows of A are the identity."""
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
    return problem, _ledger(path, problem, "qpbenchmark", float(constant[0]) if len(constant) else 0.0)


def _read_qps(path: Path) -> tuple[ContactProblem, Ledger]:
    """By HiGHS, which turns the signs of an energy that is to be maximised."""
    if importlib.util.find_spec("highspy") is None:
        raise BackendMissing(f"{path}: .qps and .mps files are read by HiGHS: pip install highspy")
    found = _matrices(path, read_in_own_process(path, "qps", "a quadratic program in QPS form"))
    parts = {name: found[name] for name in ("C", "l", "u", "lb", "ub")}
    parts["dof_names"] = _names(found["names"], len(found["q"]))
    parts["range_names"] = _names(found["row_names"], found["C"].shape[0])
    problem = ContactProblem.from_qp(found["P"], found["q"], **parts)
    return problem, _ledger(path, problem, "QPS", float(found["offset"]))


def _names(given: Any, count: int) -> list[str] | None:
    """Return the names in a file, none where it does not name each of so many differently."""
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
    return sp.csr_matrix(matrix, dtype=float) if sp.issparse(matrix) else np.asarray(matrix, dtype=float)


def _ledger(path: Path, problem: ContactProblem, form: str, constant: float) -> Ledger:
    ledger = Ledger(str(path))
    counts = f"{problem.dimension} unknowns, {problem.contacts} inequalities, {problem.ties} equations"
    ledger.read.append(f"a quadratic program ({form}): {counts}")
    if constant:
        ledger.ignored.append(f"the constant {constant:.9g} of the energy, which moves nothing")
    return ledger
