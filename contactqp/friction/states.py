"""One combination of open, stick and slip is one linear system, unsymmetric where something slips.

    [ S     N_c' + T_c' diag(s mu)   T_b'   A' ] [ x   ]   [ f_S ]
    [ N_c                                      ] [ l_N ] = [ g   ]      c: closed contacts, s = +-1 where they slip
    [ T_b                                      ] [ l_T ]   [ o   ]      b: those that stick, s = 0 there
    [ A                                        ] [ nu  ]   [ b   ]

(Wriggers 2006, section 9.3.3, with the slip's sign in place of its direction). The system acts as an approximate
inverse: residuals are formed on the full problem in twice double precision, as polishing without friction does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.condensation import Condensation
from contactqp.extended import Extended, extend, extended_rows, two_product
from contactqp.factorization import Array
from contactqp.friction.rows import FrictionalRows
from contactqp.problem import ContactProblem, Vector
from contactqp.violations import FIGURES, Answer, residuals, residuals_of, violations

# A contact is open, sticks, or slips with s < 0 or s > 0.
OPEN, STICK, SLIP_BACK, SLIP_ON = 0, 2, -1, 1
Status = NDArray[np.int8]

# Refinement stops when a sweep no longer halves the correction.
MAX_SWEEPS = 12
# A correction of this part of the answer is beneath what doubles hold.
NEGLIGIBLE = 1e-20
# Beneath this reciprocal condition, or singular value relative to the largest, a system leaves motions or forces free.
SINGULAR = 1e-12
# Figures of an answer whose signs hold: what the certificate asks for, less what rounding may add to it.
HOLDS = 1e-10


class StateSystem:
    """The factorised linear system of one combination."""

    def __init__(
        self, problem: ContactProblem, condensation: Condensation, rows: FrictionalRows, status: Status
    ) -> None:
        self.closed, self.stuck = np.flatnonzero(status != OPEN), np.flatnonzero(status == STICK)
        self.sliding = np.where(status == STICK, 0.0, status)
        self._way, self._rows = condensation, rows
        normal, tangent = rows.normal[self.closed], rows.tangent[self.stuck]
        dragged = (self.sliding * rows.coefficient)[self.closed, None] * rows.tangent[self.closed]
        held = np.vstack([normal, tangent, rows.tie])
        pushed = np.vstack([normal + dragged, tangent, rows.tie])
        size = len(rows.S)
        self._matrix = np.block([[rows.S, pushed.T], [held, np.zeros((len(held), len(held)))]])
        self._size, self._contacts, self._ties = size, problem.contacts, problem.ties
        self._factorise()

    def _factorise(self) -> None:
        from scipy.linalg.lapack import dgecon, dgetrf

        self._inverse: Array | None = None
        factor, pivots, info = dgetrf(self._matrix)
        condition = dgecon(factor, np.linalg.norm(self._matrix, 1))[0] if info == 0 else 0.0
        if condition < SINGULAR:  # the least correction that fits best
            self._inverse = np.linalg.pinv(self._matrix, rcond=SINGULAR)
        self._factor = (factor, pivots)

    def correct(self, load: Vector, gap: Vector, slip: Vector, tie: Vector) -> tuple[Vector, Vector, Vector, Vector]:
        """du (n,), dl_N (m,), dl_T (m,) of sticking contacts, dnu (k,) for residuals of the full problem."""
        from scipy.linalg import lu_solve

        reduced, inner = self._way.reduce_load(load)
        rows, c, b, p = self._rows, self.closed, self.stuck, self._size
        lengths = (gap[c] / rows.normal_length[c], slip[b] / rows.tangent_length[b], tie / rows.tie_length)
        right = np.concatenate([reduced * rows.scale, *lengths])
        y = lu_solve(self._factor, right) if self._inverse is None else self._inverse @ right
        normal_force, friction_force = np.zeros(self._contacts), np.zeros(self._contacts)
        normal_force[c] = y[p : p + len(c)] / rows.normal_length[c]
        friction_force[b] = y[p + len(c) : p + len(c) + len(b)] / rows.tangent_length[b]
        tie_force = y[len(y) - self._ties :] / rows.tie_length
        return self._way.expand(y[:p] * rows.scale, inner), normal_force, friction_force, tie_force


def answer_in(
    problem: ContactProblem, condensation: Condensation, rows: FrictionalRows, status: Status, start: Answer
) -> Answer:
    """The answer of one combination, refined from `start`; where it leaves something free, near the start.

    Nothing is said of whether its signs hold: see `holds`.
    """
    system = StateSystem(problem, condensation, rows, status)
    exact = extended_rows(problem)
    u, tie = extend(start.displacement), extend(start.tie_force)
    force = extend(np.where(status != OPEN, start.normal_force, 0.0))
    stick = extend(np.where(status == STICK, _friction_of(start), 0.0))
    origin = extend(_origin(problem))
    last = np.inf
    for _ in range(MAX_SWEEPS):
        friction = stick + _bound(problem, force, system.sliding)
        left = residuals_of(exact, problem, u, force, tie, friction)
        slip = (origin - exact.slip(u)).double()
        du, dl, dt, dn = system.correct(left.force.double(), left.gap.double(), slip, left.tie.double())
        u, force, stick, tie = u + du, force + dl, stick + dt, tie + dn
        # Relative to the largest of each kind: no unit is compared with another.
        pairs = ((du, u), (dl, force), (dt, stick), (dn, tie))
        size = max(_part(change, whole.double()) for change, whole in pairs)
        if size <= NEGLIGIBLE or size > 0.5 * last:
            break
        last = size
    friction = stick + _bound(problem, force, system.sliding)
    return Answer(u.double(), force.double(), friction.double()[:, None], tie.double())


def holds(problem: ContactProblem, answer: Answer, tolerance: float = HOLDS) -> bool:
    """Whether an answer satisfies equilibrium, contact and Coulomb's law, each figure by the certificate's measure."""
    if not answer.finite():
        return False
    found = violations(problem, answer, residuals(problem, answer))
    figures = (name for name in FIGURES if name != "balance")  # which equilibrium implies to this tolerance
    return all(float(np.max(getattr(found, name), initial=0.0)) <= tolerance for name in figures)


def _bound(problem: ContactProblem, force: Extended, sliding: Array) -> Extended:
    """s mu l_N, exactly."""
    coefficient = sliding * (0.0 if problem.friction is None else problem.friction)
    product, error = two_product(coefficient, force.hi)
    return Extended(product, error + coefficient * force.lo)


def _friction_of(answer: Answer) -> Vector:
    return np.zeros_like(answer.normal_force) if answer.friction_force is None else answer.friction_force[:, 0]


def _origin(problem: ContactProblem) -> Vector:
    return np.zeros(problem.contacts) if problem.slip_origin is None else problem.slip_origin[:, 0]


def _part(change: Vector, whole: Vector) -> float:
    largest = float(np.max(abs(whole), initial=0.0))
    return float(np.max(abs(change), initial=0.0)) / largest if largest > 0 else 0.0
