"""The master-slave method of the course chapter (eqs 2.17-2.20), with the load term that its eq. 2.20 lacks."""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy.sparse as sp

from contactqp.model.arrays import Indices, Mask, Vector
from contactqp.model.coulomb import Status
from contactqp.model.problem import ContactProblem, Matrix
from contactqp.model.solution import Candidate
from contactqp.solving.methods.method import CLASSICAL_ENFORCEMENT, Method, Settings
from contactqp.solving.methods.status_loop import status_loop
from contactqp.solving.methods.stick_and_slip import FrictionalStep, status_rows
from contactqp.solving.methods.textbook_algebra import (
    SingularSystem,
    binding_rows,
    rows_independent_of_earlier,
    solve_linear,
)
from contactqp.solving.methods.textbook_loop import Step, active_set_loop

NAME = "master-slave"


def solve_master_slave(problem: ContactProblem, settings: Settings) -> Candidate:
    """Eliminate the slave unknowns of closed contacts and ties, which are multi-point constraints C u = q:

        u_s = T u_m + c                                 T = -C_s^-1 C_m,  c = C_s^-1 q
        B'K B u_m = B'(f - K {0; c})                     B = [I; T]

    (the course chapter, eqs 2.17-2.20; its eq. 2.20 omits the part of K {0; c} that falls on unknowns no constraint
    touches, which is right only without gaps). Slaves are chosen by QR of C with column pivoting, so that C_s is well
    conditioned; constraints that follow from others are left out. The forces follow from the equilibrium of the slaves,
    C_s' lambda = (f - K u)_s, positive in compression.

    Raises NotConverged: the closed contacts do not hold the bodies, or ties contradict each other.
    """
    return active_set_loop(NAME, problem, settings, partial(_enforce, problem))


def _enforce(problem: ContactProblem, closed: Mask, preference: Indices) -> Step:
    rows, values, ties, contacts = binding_rows(NAME, problem, closed, preference)
    slaves = choose_slaves(rows)
    B, offset = transformation(rows, values, slaves)
    K = problem.stiffness
    reduced = B.T @ (K @ B) if sp.issparse(K) else B.T @ (B.T @ K).T
    displacement = B @ solve_linear(NAME, reduced, B.T @ (problem.load - K @ offset), refined=True) + offset
    force = np.linalg.solve(rows[:, slaves].toarray().T, (problem.load - K @ displacement)[slaves])
    return Step.on_rows(problem, displacement, force, ties, contacts)


def solve_frictional(problem: ContactProblem, settings: Settings) -> Candidate:
    """Stick is a tie of both rows (the rough contact of the course chapter's Example 2.17). Slip is a tie of the normal
    row only, and its forces act along P = E_N + s mu E_T: they are eliminated by motions that do no work on them,

        u = B u_m + c,  H B = 0        T'K B u_m = T'(f - K c),  P T = 0

    with slaves of H for the displacements u and slaves of P for the motions T, so that the system of slip is
    unsymmetric (a Petrov-Galerkin form). The forces follow from the equilibrium of the slaves of P.

    Raises NotConverged: the contacts do not hold the bodies, or ties contradict each other.
    """
    return status_loop(NAME, problem, settings, partial(_enforce_friction, problem))


def _enforce_friction(problem: ContactProblem, status: Status, preference: Indices) -> FrictionalStep:
    rows = status_rows(NAME, problem, status, preference, independent=True)
    if rows_independent_of_earlier(rows.pushed).size < rows.values.size:
        raise SingularSystem(f"{NAME}: the forces of contacts that slip depend on each other")
    B, offset = transformation(rows.held, rows.values, choose_slaves(rows.held))
    slaves = choose_slaves(rows.pushed)
    T, _ = transformation(rows.pushed, np.zeros(rows.values.size), slaves)
    K = problem.stiffness
    reduced = T.T @ (K @ B) if sp.issparse(K) else T.T @ (B.T @ K).T
    displacement = B @ solve_linear(NAME, reduced, T.T @ (problem.load - K @ offset), refined=True) + offset
    force = np.linalg.solve(rows.pushed[:, slaves].toarray().T, (problem.load - K @ displacement)[slaves])
    return rows.step(displacement, force[rows.of_contacts], force[: rows.ties.size])


def choose_slaves(rows: Matrix) -> Indices:
    """Return as many slave unknowns as there are rows, such that the square matrix C_s is well conditioned.

    Parameters
    ----------
    rows : (r, n) csr_array, C, with independent rows

    Returns
    -------
    (r,) index array
    """
    from scipy.linalg import qr

    if rows.shape[0] == 0:
        return np.zeros(0, dtype=np.intp)
    touched = np.unique(rows.indices)
    pivots = qr(rows[:, touched].toarray(), mode="r", pivoting=True)[1]
    return np.asarray(touched[pivots[: rows.shape[0]]])


def transformation(rows: Matrix, values: Vector, slaves: Indices) -> tuple[Matrix, Vector]:
    """Return B and c of u = B u_m + c, the displacements that satisfy C u = q (the course chapter, eqs 2.17-2.19).

    Parameters
    ----------
    rows : (r, n) csr_array, C
    values : (r,), q
    slaves : (r,) index array

    Returns
    -------
    B : (n, n - r) csr_array
    c : (n,)
        Zero at the masters.
    """
    n = rows.shape[1]
    masters = np.setdiff1d(np.arange(n), slaves)
    identity = sp.csr_array((np.ones(masters.size), (masters, np.arange(masters.size))), shape=(n, masters.size))
    offset = np.zeros(n)
    if slaves.size == 0:
        return identity, offset
    C_s, C_m = rows[:, slaves].toarray(), rows[:, masters]
    touched = np.unique(C_m.indices)
    try:
        offset[slaves] = np.linalg.solve(C_s, values)
        T = sp.coo_array(-np.linalg.solve(C_s, C_m[:, touched].toarray()))
    except np.linalg.LinAlgError:
        raise SingularSystem(f"{NAME}: rounding hides which of the closed contacts and ties are independent") from None
    dependence = sp.csr_array((T.data, (slaves[T.row], touched[T.col])), shape=(n, masters.size))
    return sp.csr_array(identity + dependence), offset


METHODS = (
    Method(
        name=NAME,
        kind=CLASSICAL_ENFORCEMENT,
        solve=solve_master_slave,
        solve_friction=solve_frictional,
        note="closed contacts and ties are multi-point constraints, slaves eliminated (course chapter, eqs 2.17-2.20)",
    ),
)
