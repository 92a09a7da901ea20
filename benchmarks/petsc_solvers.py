"""PETSc's solvers of bound-constrained problems, for comparison: each contact limits one unknown.

Installed beside the system's Python (Debian 12):

    apt-get install python3-petsc4py
    python3 -m venv --system-site-packages petsc && . petsc/bin/activate
    pip install 'numpy==1.24.*' -e '.[solids,fast]'
    export PETSC_DIR=/usr/lib/petscdir/petsc3.18/x86_64-linux-gnu-real
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

import contactqp as cq

# Far beyond any displacement of these problems: no limit.
FAR = 1e20


def available() -> bool:
    return importlib.util.find_spec("petsc4py") is not None


def ways() -> dict[str, Callable[[cq.ContactProblem], tuple[float, np.ndarray]]]:
    """Name and solver; each returns seconds and displacement."""
    return {"PETSc vinewtonrsls, MUMPS": newton, "PETSc TAO bntr, ICC": trust_region}


def newton(problem: cq.ContactProblem) -> tuple[float, np.ndarray]:
    """The reduced-space active-set Newton method with MUMPS' Cholesky factorisation (Benson and Munson 2006)."""
    from petsc4py import PETSc

    A, load, x = _system(problem)
    residual = x.duplicate()
    snes = PETSc.SNES().create()
    snes.setType("vinewtonrsls")
    snes.setFunction(lambda _, u, r: (A.mult(u, r), r.axpy(-1.0, load)), residual)
    snes.setJacobian(lambda *_: None, A)
    snes.setVariableBounds(*_limits(problem))
    snes.setTolerances(rtol=1e-12, atol=0.0)
    snes.getKSP().setType("preonly")
    snes.getKSP().getPC().setType("cholesky")
    snes.getKSP().getPC().setFactorSolverType("mumps")
    return _timed(lambda: snes.solve(None, x), x)


def trust_region(problem: cq.ContactProblem) -> tuple[float, np.ndarray]:
    """The bounded Newton trust-region method; conjugate gradients with incomplete Cholesky factors, since PETSc's
    multigrid refuses the sets that change size."""
    from petsc4py import PETSc

    A, load, x = _system(problem)
    work = x.duplicate()

    def objective(_: Any, u: Any, gradient: Any) -> float:
        A.mult(u, work)
        work.copy(gradient)
        gradient.axpy(-1.0, load)
        return float(0.5 * u.dot(work) - load.dot(u))

    options = PETSc.Options()
    options["tao_bnk_ksp_type"], options["tao_bnk_ksp_rtol"], options["tao_bnk_pc_type"] = "stcg", 1e-10, "icc"
    tao = PETSc.TAO().create()
    tao.setType("bntr")
    tao.setObjectiveGradient(objective, x.duplicate())
    tao.setHessian(lambda *_: None, A)
    tao.setVariableBounds(_limits(problem))
    tao.setTolerances(gatol=1e-12 * float(np.linalg.norm(problem.load)), grtol=0.0, gttol=0.0)
    tao.setFromOptions()
    return _timed(lambda: tao.solve(x), x)


def _system(problem: cq.ContactProblem) -> tuple[Any, Any, Any]:
    from petsc4py import PETSc

    K = sp.csr_matrix(problem.stiffness)
    A = PETSc.Mat().createAIJ(K.shape, csr=(K.indptr, K.indices, K.data))
    A.setOption(PETSc.Mat.Option.SPD, True)
    load, x = PETSc.Vec().createSeq(problem.dimension), PETSc.Vec().createSeq(problem.dimension)
    load.setArray(problem.load)
    return A, load, x


def _limits(problem: cq.ContactProblem) -> tuple[Any, Any]:
    from petsc4py import PETSc

    lower, upper = np.full(problem.dimension, -FAR), np.full(problem.dimension, FAR)
    rows = problem.normal.tocoo()
    limit = problem.gap[rows.row] / rows.data
    lower[rows.col[rows.data < 0]] = limit[rows.data < 0]
    upper[rows.col[rows.data > 0]] = limit[rows.data > 0]
    return PETSc.Vec().createWithArray(lower), PETSc.Vec().createWithArray(upper)


def _timed(work: Callable[[], Any], x: Any) -> tuple[float, np.ndarray]:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started, x.getArray().copy()
