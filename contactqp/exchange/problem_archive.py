"""A problem in one .npz file: arrays called stiffness (K), load (f), normal (E_N), gap (g), ..., dense or sparse.

A sparse matrix is K_data, K_indices, K_indptr, K_shape (and K_format where it is not csr), as `scipy.sparse.save_npz`
names them. dof_names and contact_names may be there too, as arrays of text.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from contactqp.exchange.ledger import Ledger
from contactqp.exchange.numpy_files import is_sparse, read_npz, real, sparse_matrix
from contactqp.exchange.problem_parts import SYMBOLS, part_called, problem_of
from contactqp.exchange.refusal import Path, wrong
from contactqp.model.problem import ContactProblem

OF_SPARSE = ("data", "indices", "indptr", "shape", "format", "row", "col")
NAMES = ("dof_names", "contact_names")


def read_problem_archive(path: Path) -> tuple[ContactProblem, Ledger]:
    """The problem in an archive, and its ledger.

    Raises
    ------
    InvalidProblem
        No archive, a part that is missing or there twice, arrays that are no numbers or no problem together.
    Unsupported
        Python objects, complex numbers, sparse forms other than CSR, CSC and COO.
    """
    arrays, ledger = read_npz(path), Ledger(str(path))
    parts: dict[str, Any] = {}
    used = set(NAMES)
    for called in dict.fromkeys((*SYMBOLS, *SYMBOLS.values())):
        part, value = part_called(called), _value(path, arrays, called)
        if part is None or value is None:
            continue
        if part in parts:
            raise wrong(path, part, "it once", f"{part} and {SYMBOLS[part]}")
        parts[part] = value
        used |= {called, *(f"{called}_{piece}" for piece in OF_SPARSE)}
        ledger.read.append(f"{part}: {called}, shape {value.shape}")
    names = {name: _texts(path, name, arrays[name]) for name in NAMES if name in arrays}
    ledger.ignored.extend(name for name in arrays if name not in used)
    return problem_of(
        path, parts, ledger, dof_names=names.get("dof_names"), contact_names=names.get("contact_names")
    ), ledger


def _value(path: Path, arrays: Mapping[str, NDArray[Any]], name: str) -> Any:
    if is_sparse(arrays, f"{name}_"):
        return sparse_matrix(path, arrays, f"{name}_")
    return real(path, name, arrays[name]) if name in arrays else None


def _texts(path: Path, name: str, values: NDArray[Any]) -> list[str]:
    if values.dtype.kind != "U":
        raise wrong(path, name, "an array of text", values.dtype.name)
    return [str(one) for one in values.ravel()]
