"""One combination of open, stick and slip in the plane as a sparse system of all unknowns, nothing being condensed.

    [ K + d   N_c' + T_c' diag(mu t)   T_b'   A' ] [ u   ]   [ f ]
    [ N_c     -d                                 ] [ l_N ] = [ g ]      c: closed contacts, t = -1, 0, 1 their slip
    [ T_b             -d                         ] [ l_T ]   [ o ]      b: those that stick
    [ A                        -d                ] [ nu  ]   [ b ]

is the system of `contactqp.linalg.friction_states` before condensation, in the same scale: unknowns by 1/sqrt(K_jj),
rows of unit length in the energy. The d on the diagonal, as in `contactqp.linalg.sparse_saddle`, let it be eliminated
in an order that keeps it sparse; residuals in extended precision take them back. It is meant for bodies that are held.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg import pardiso
from contactqp.linalg.extended import extended_rows
from contactqp.linalg.factorization import inverse_root
from contactqp.linalg.friction_states import MAX_SWEEPS, RefinedState, refined_by
from contactqp.linalg.sparse_saddle import factorised
from contactqp.model.arrays import Array, Vector
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# d: with a diagonal and rows of one it costs a sweep of refinement some seven digits of the sixteen.
REGULARISATION = 1e-9
# Systems that are kept: that of an answer, and the one without contacts that measures forces.
KEPT = 2
# Responses to right-hand sides of one that reach this part of 1/d are those of a system without an inverse.
ALMOST_FREE = 1e-3


class SparseFrictionalRows:
    """A frictional problem in the plane in all its unknowns; attributes as those of `FrictionalRows`, sparse."""

    width = 1

    def __init__(self, problem: ContactProblem) -> None:
        if problem.friction is None or problem.tangent is None:
            raise ValueError("frictional rows of a problem without friction")
        self.scale = inverse_root(problem.diagonal)
        unknowns = sp.diags(self.scale)
        self.S = sp.csr_matrix(unknowns @ problem.stiffness_rows @ unknowns)
        (self.normal, self.normal_length), (self.tangent, self.tangent_length), (self.tie, self.tie_length) = (
            _unit(sp.csr_matrix(rows @ unknowns)) for rows in (problem.normal, problem.tangent, problem.tie)
        )
        self.slides = np.diff(self.tangent.indptr) > 0
        self.coefficient = problem.friction * self.tangent_length / self.normal_length
        self._systems: dict[bytes, SparseStateSystem] = {}

    def system(self, problem: ContactProblem, status: Status) -> SparseStateSystem:
        """The factorised system of a combination; the last are kept, since polish and certificate ask alike."""
        key = status.tobytes()
        if key not in self._systems:
            if len(self._systems) == KEPT:
                self._systems.pop(next(iter(self._systems)))
            self._systems[key] = SparseStateSystem(problem, self, status)
        return self._systems[key]


def _unit(rows: Any) -> tuple[Any, Vector]:
    """Rows of unit length, and what they were divided by."""
    rows.eliminate_zeros()
    length = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
    length = np.where(length > 0, length, 1.0)
    return sp.csr_matrix(sp.diags(1.0 / length) @ rows), length


def frictional_rows(problem: ContactProblem) -> SparseFrictionalRows:
    """Made once for a stiffness, its rows and its coefficients."""
    kept = problem._computed.sparse_frictional_rows
    if kept is None or kept[0] is not problem.friction:
        kept = problem._computed.sparse_frictional_rows = (problem.friction, SparseFrictionalRows(problem))
    rows: SparseFrictionalRows = kept[1]
    return rows


class SparseStateSystem:
    """The factorised system of one combination; attributes as those of `StateSystem`, and what it has been asked for.

    Raises
    ------
    BackendFailed
        As `contactqp.linalg.sparse_saddle.factorised`.
    """

    redundant = False  # where rows depend on others the system is not regular

    def __init__(self, problem: ContactProblem, rows: SparseFrictionalRows, status: Status) -> None:
        self._rows, self._contacts, self._ties = rows, problem.contacts, problem.ties
        self._closed, self._stuck = np.flatnonzero(status != OPEN), np.flatnonzero(status == STICK)
        closed, stuck = self._closed, self._stuck
        drag = np.where(status == STICK, 0.0, status)[closed] * rows.coefficient[closed]
        held = sp.vstack([rows.normal[closed], rows.tangent[stuck], rows.tie], format="csr")
        dragged = sp.diags(drag) @ rows.tangent[closed]
        more = sp.csr_matrix((held.shape[0] - len(closed), held.shape[1]))
        pushed = held + sp.vstack([dragged, more], format="csr") if np.any(drag) else held
        upper = rows.S + REGULARISATION * sp.identity(held.shape[1])
        lower = -REGULARISATION * sp.identity(held.shape[0])
        matrix = sp.bmat([[upper, pushed.T], [held, lower]], format="csc")
        kind = pardiso.UNSYMMETRIC if np.any(drag) else pardiso.INDEFINITE
        self._factor = factorised(matrix, kind, pardiso.elimination_order(problem), np.arange(problem.dimension))
        self.back_substitutions = 0
        response = self._solve(np.random.default_rng(0).uniform(0.5, 1.0, matrix.shape[0]))
        self.regular = bool(np.max(abs(response), initial=0.0) < ALMOST_FREE / REGULARISATION)

    def _solve(self, right: Vector) -> Vector:
        self.back_substitutions += 1
        return self._factor(right)

    def correct(self, load: Vector, gap: Vector, slip: Vector, tie: Vector) -> tuple[Vector, Vector, Array, Vector]:
        """du (n,), dl_N (m,), dl_T (m, 1) of sticking contacts, dnu (k,) for residuals of the problem."""
        rows, closed, stuck = self._rows, self._closed, self._stuck
        lengths = (
            gap[closed] / rows.normal_length[closed],
            slip[stuck] / rows.tangent_length[stuck],
            tie / rows.tie_length,
        )
        found = self._solve(np.concatenate([load * rows.scale, *lengths]))
        parts = np.cumsum([len(load), len(closed), len(stuck)])
        moved, pushing, sticking, tied = np.split(found, parts)
        normal_force, friction_force = np.zeros(self._contacts), np.zeros((self._contacts, 1))
        normal_force[closed] = pushing / rows.normal_length[closed]
        friction_force[stuck, 0] = sticking / rows.tangent_length[stuck]
        return moved * rows.scale, normal_force, friction_force, tied / rows.tie_length

    def response_norm(self, load: Vector) -> float:
        """The energy norm of the response to a load (n,), lengths held at zero."""
        right = np.zeros(len(load) + len(self._closed) + len(self._stuck) + self._ties)
        right[: len(load)] = load * self._rows.scale
        return float(np.sqrt(max(float(right @ self._solve(right)), 0.0)))


def refined_sparse(problem: ContactProblem, status: Status, start: Answer, sweeps: int = MAX_SWEEPS) -> RefinedState:
    """The answer of a combination, refined from a start in extended precision.

    Raises
    ------
    BackendFailed
        As `SparseStateSystem`.
    """
    rows, exact = frictional_rows(problem), extended_rows(problem)
    return refined_by(lambda *_: rows.system(problem, status), exact, problem, rows, status, start, sweeps)
