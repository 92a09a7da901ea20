"""Quadratic programs over second-order cones, by Clarabel, SCS, or whatever cvxpy has.

    min 1/2 x'P x + c'x    over    A x + y = b,  y in zeros x nonnegatives x second-order cones

in that order, the cones of one size.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed, BackendMissing
from contactqp.model.arrays import Array, Vector
from contactqp.solving.methods import Settings
from contactqp.solving.methods.backends import collected_words

SOLVERS = ("clarabel", "scs", "cvxpy")
# Interior points know forces to the square root of their gap: of the root this part of the tolerance is asked for, down
# to rounding.
TIGHTER, TIGHTEST = 0.1, 1e-12


@dataclass(frozen=True, eq=False)
class ConicProgram:
    """One program; the rows of A are `zeros`, then `nonnegatives`, then `cones` of `width` rows each."""

    P: Any  # (n, n) symmetric, positive semidefinite
    c: Vector
    A: Any
    b: Vector
    zeros: int
    nonnegatives: int
    cones: int
    width: int


def solve_conic(program: ConicProgram, solver: str, settings: Settings) -> tuple[Vector, Vector]:
    """x and the multipliers z of the rows, P x + c + A'z = 0.

    Raises
    ------
    BackendMissing, BackendFailed
        The solver is not installed; it raised, or found nothing finite.
    """
    found = {"clarabel": _clarabel, "scs": _scs, "cvxpy": _cvxpy}[solver](program, settings)
    if found is None or not all(np.all(np.isfinite(part)) for part in found):
        raise BackendFailed(f"{solver}: no finite values")
    return found


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise BackendMissing(f"{name} is not installed: pip install {name}") from error


def _clarabel(program: ConicProgram, settings: Settings) -> tuple[Vector, Vector] | None:
    clarabel = _module("clarabel")
    cones = [clarabel.ZeroConeT(program.zeros), clarabel.NonnegativeConeT(program.nonnegatives)]
    cones += [clarabel.SecondOrderConeT(program.width)] * program.cones
    options = clarabel.DefaultSettings()
    options.verbose = False
    options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = max((settings.tolerance * TIGHTER) ** 2, TIGHTEST)
    if settings.time_limit is not None:
        options.time_limit = settings.time_limit
    P, A = sp.csc_matrix(sp.triu(program.P)), sp.csc_matrix(program.A)
    try:
        solution = clarabel.DefaultSolver(P, program.c, A, program.b, cones, options).solve()
    except (KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # Rust's panics are no Exception
        raise BackendFailed(f"clarabel: {type(error).__name__}: {error}") from error
    # What it stops at is looked at by its users, whatever it calls it.
    return np.array(solution.x), np.array(solution.z)


def _scs(program: ConicProgram, settings: Settings) -> tuple[Vector, Vector] | None:
    scs = _module("scs")
    data = dict(P=sp.csc_matrix(sp.triu(program.P)), c=program.c, A=sp.csc_matrix(program.A), b=program.b)
    cones = dict(z=program.zeros, l=program.nonnegatives, q=[program.width] * program.cones)
    tolerance = max(settings.tolerance * 1e-2, TIGHTEST)
    limit = {} if settings.time_limit is None else {"time_limit_secs": settings.time_limit}
    with collected_words():
        try:
            solution = scs.SCS(data, cones, verbose=False, eps_abs=tolerance, eps_rel=tolerance, **limit).solve()
        except ValueError as error:
            raise BackendFailed(f"scs: {error}") from error
    return np.asarray(solution["x"]), np.asarray(solution["y"])


def _cvxpy(program: ConicProgram, settings: Settings) -> tuple[Vector, Vector] | None:
    cp = _module("cvxpy")
    x = cp.Variable(len(program.c))
    energy = 0.5 * cp.quad_form(x, cp.psd_wrap(sp.csc_matrix(program.P))) + program.c @ x
    A, b = sp.csr_matrix(program.A), program.b
    z, first = program.zeros, program.zeros + program.nonnegatives
    constraints: list[Any] = []
    if z:
        constraints.append(A[:z] @ x == b[:z])
    if program.nonnegatives:
        constraints.append(A[z:first] @ x <= b[z:first])
    if program.cones:
        room = cp.reshape(b[first:] - A[first:] @ x, (program.width, program.cones), order="F")
        constraints.append(cp.SOC(room[0], room[1:], axis=0))
    model = cp.Problem(cp.Minimize(energy), constraints)
    solver = settings.options.get("solver", "CLARABEL")
    with collected_words():
        try:
            model.solve(solver=solver, verbose=False)
        except (KeyboardInterrupt, SystemExit, MemoryError):
            raise
        except BaseException as error:
            raise BackendFailed(f"cvxpy: {type(error).__name__}: {error}") from error
    if x.value is None:
        return None
    multipliers = [np.atleast_1d(constraint.dual_value) for constraint in constraints[: bool(z) + bool(first - z)]]
    if program.cones:
        top, rest = constraints[-1].dual_value
        multipliers.append(
            np.vstack([np.atleast_2d(top), np.asarray(rest).reshape(-1, program.cones)]).ravel(order="F")
        )
    return np.asarray(x.value), np.concatenate(multipliers) if multipliers else np.zeros(0)


def diagonal_rows(values: Array) -> Any:
    """A sparse diagonal of an array, flattened."""
    return sp.csc_array(sp.diags(np.ravel(values)))
