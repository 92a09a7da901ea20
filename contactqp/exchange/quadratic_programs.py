"""Read quadratic programs: QPS and MPS, the .mat of qpbenchmark, the .npz of `qpsolvers.Problem.save`.

All become a ContactProblem as `ContactProblem.from_qp` makes it. A constant of the energy is left out, which the ledger
says: it moves nothing.
"""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendMissing
from contactqp.exchange.numpy_files import read_npz
from contactqp.exchange.refusal import Ledger, Path, check_finite, wrong
from contactqp.model.problem import ContactProblem

QPS, MATLAB = (".qps", ".mps"), (".mat",)
# What qpsolvers calls the parts of a problem; those that it does not have are pickled as None and never unpickled.
PARTS = ("P", "q", "G", "h", "A", "b", "lb", "ub")
# From here on a bound is none, in the .mat files of qpbenchmark and in HiGHS.
INFINITE = 1e20


def is_quadratic_program(path: Path) -> bool:
    """Whether a file is a quadratic program, by its suffix or, an archive, by the names in it."""
    suffix = FilePath(path).suffix.lower()
    if suffix in (*QPS, *MATLAB):
        return True
    if suffix != ".npz" or not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        names = {name.removesuffix(".npy") for name in archive.namelist()}
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
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        found: dict[str, Any] = loadmat(path, appendmat=False)
    except OSError:
        raise
    except (MatReadError, ValueError, TypeError, KeyError, NotImplementedError, EOFError, IndexError) as error:
        raise wrong(path, "content", "a .mat file of qpbenchmark", f"{type(error).__name__}: {error}") from None
    missing = [name for name in ("P", "q", "A", "l", "u") if name not in found]
    if missing:
        raise wrong(path, "content", "P, q, A, l and u of qpbenchmark", f"none called {', '.join(missing)}")
    q, lower, upper = (_vector(path, name, found[name]) for name in ("q", "l", "u"))
    A, n = sp.csr_matrix(found["A"]), len(q)
    count = A.shape[0] - n
    if count < 0 or A.shape[1] != n or len(lower) != A.shape[0] or len(upper) != A.shape[0]:
        shapes = f"A {A.shape}, q ({n},), l ({len(lower)},), u ({len(upper)},)"
        raise wrong(path, "shapes", "l <= A x <= u with as many rows at the end as there are unknowns", shapes)
    if abs(A[count:] - sp.identity(n)).max() if n else False:
        raise wrong(path, "A", f"the identity in its last {n} rows, for bounds", "other entries")
    lower, upper = np.where(lower <= -INFINITE, -np.inf, lower), np.where(upper >= INFINITE, np.inf, upper)
    sides = dict(lb=lower[count:], ub=upper[count:], C=A[:count], l=lower[:count], u=upper[:count])
    problem = ContactProblem.from_qp(_real(path, "P", found["P"]), q, **sides)
    return problem, _ledger(path, problem, "qpbenchmark", float(np.ravel(found.get("r", 0.0))[0]))


def _read_qps(path: Path) -> tuple[ContactProblem, Ledger]:
    """By HiGHS; `-sense` maximise turns the signs of the energy."""
    try:
        import highspy
    except ImportError:
        raise BackendMissing(f"{path}: .qps and .mps files are read by HiGHS: pip install highspy") from None
    if not FilePath(path).is_file():
        raise FileNotFoundError(2, "No such file", str(path))
    reader: Any = highspy.Highs()  # type: ignore[no-untyped-call]
    reader.silent()
    with tempfile.TemporaryDirectory() as folder:
        copy = FilePath(folder, "program.mps")  # HiGHS goes by the suffix, and knows none for QPS
        shutil.copyfile(path, copy)
        status = reader.readModel(str(copy))
    if status == highspy.HighsStatus.kError:
        raise wrong(path, "content", "a quadratic program in QPS form", "what HiGHS cannot read")
    model = reader.getModel()
    linear, hessian = model.lp_, model.hessian_
    n, m = linear.num_col_, linear.num_row_
    if any(kind != highspy.HighsVarType.kContinuous for kind in linear.integrality_):
        raise wrong(path, "content", "continuous unknowns", "integers among them")
    sign = -1.0 if linear.sense_ == highspy.ObjSense.kMaximize else 1.0
    P = sp.csc_matrix((n, n))
    if hessian.dim_:
        lower = sp.csc_matrix((hessian.value_, hessian.index_, hessian.start_), shape=(n, n))
        P = lower + sp.tril(lower, -1).T
    entries = (linear.a_matrix_.value_, linear.a_matrix_.index_, linear.a_matrix_.start_)
    by_columns = linear.a_matrix_.format_ == highspy.MatrixFormat.kColwise
    C = (sp.csc_matrix if by_columns else sp.csr_matrix)(entries, shape=(m, n))
    sides = {
        name: np.array(values, dtype=float)
        for name, values in (
            ("l", linear.row_lower_),
            ("u", linear.row_upper_),
            ("lb", linear.col_lower_),
            ("ub", linear.col_upper_),
        )
    }
    problem = ContactProblem.from_qp(sign * P, sign * np.array(linear.col_cost_), C=sp.csr_matrix(C), **sides)
    if linear.col_names_ and len(set(linear.col_names_)) == n:
        problem = problem.replace(dof_names=list(linear.col_names_))
    return problem, _ledger(path, problem, "QPS", float(linear.offset_))


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
