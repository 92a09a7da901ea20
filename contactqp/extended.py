"""Residuals in extended precision, where the platform has it.

The difference between an answer and the truth is K^-1 r; computed in double precision, r is rounding noise as soon as
the answer is good. NumPy's long double carries 64 bits on x86 (eps 1e-19) and 113 on some others; where it is plain double,
`EPS` says so and every rounding allowance grows with it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.problem import ContactProblem

Extended = NDArray[np.longdouble]
EPS = float(np.finfo(np.longdouble).eps)


def extend(values: Any) -> Extended:
    return np.asarray(values, dtype=np.longdouble)


class ExtendedRows:
    """The matrices of a problem in extended precision, and the products that residuals are made of."""

    def __init__(self, problem: ContactProblem) -> None:
        self.stiffness = _csr(problem.stiffness)
        self.normal = _csr(problem.normal)
        self.tie = _csr(problem.tie)
        self.tangent = None if problem.tangent is None else _csr(problem.tangent)
        self._normal_transposed, self._tie_transposed = self.normal.T.tocsr(), self.tie.T.tocsr()

    def internal_force(self, displacement: Extended) -> Extended:
        """K u."""
        return np.asarray(self.stiffness @ displacement)

    def contact_force(self, normal_force: Extended, tie_force: Extended) -> Extended:
        """E_N' l_N + A' nu."""
        return np.asarray(self._normal_transposed @ normal_force + self._tie_transposed @ tie_force)


def extended_rows(problem: ContactProblem) -> ExtendedRows:
    """Made once for a stiffness and its rows; shared by every problem that `replace` derives."""
    shared = problem._shared
    if "extended" not in shared:
        shared["extended"] = ExtendedRows(problem)
    rows: ExtendedRows = shared["extended"]
    return rows


def _csr(matrix: Any) -> Any:
    return sp.csr_matrix(matrix).astype(np.longdouble)
