"""Static condensation onto the contact unknowns.

With c the retained unknowns (those that contacts or ties touch, and those that fix what would float without them) and
i the interior,

    S = K_cc - K_ci K_ii^-1 K_ic,    f_S = f_c - K_ci K_ii^-1 f_i,    u_i = K_ii^-1 (f_i - K_ic u_c),

and min 1/2 x'Sx - f_S'x subject to E_c x <= g, A_c x = b has the forces of the full problem as its own. K_ii is
factorised once, for every load, gap, method and certificate that follows (`contactqp.linalg.schur`).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem, Unsupported, shown
from contactqp.linalg.convexity import refuse_indefinite
from contactqp.linalg.dense import (
    DENSE_SIZE,
    LIFT,
    SUSPICIOUS_PIVOT,
    WRITTEN_OUT,
    BackSubstitution,
    Delassus,
    DenseCholesky,
    RigidMotions,
    SaddlePoint,
    orthonormal,
    unknown_scale,
)
from contactqp.linalg.extended import ExtendedRows, extended_rows
from contactqp.linalg.factorization import (
    FAR_APART,
    condensed_null_space,
    connected_parts,
    factorise,
    fixing_unknowns,
    null_space,
    stated_motions,
    unknowns_far_apart,
)
from contactqp.linalg.floating import NullSpace, motions_as_stated, unresisted
from contactqp.linalg.pardiso import SOLVER_VARIABLE, NotPositive, TooLarge, available
from contactqp.linalg.schur import CHOICES, FEW, LARGE, Elimination, LastBlock, NestedBlock, TrailingBlock, same_matrix
from contactqp.model.arrays import CONDENSE, EPS, RUNNING, TINY, Array, Indices, Vector, refuse_late, stage
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import csr_rows

# A diagonal entry reduced by condensation to less than this is mostly rounding, as on a rigid body.
NOTHING_LEFT = 1e-8
# Interior loads whose condensed sum falls below this part of them are measured by their absolute values.
CANCELLED = 1e-4
# Rounding of the diagonal of S is about this times the condition of K_ii and the part of the diagonal that cancels.
LOST_DIGITS = 8 * EPS
# Rounding of a condensed stiffness relative to its diagonal; larger negative pivots show an indefinite K.
CONDENSED_ROUNDING = 1e-6
SMALL = 900  # the size of K up to which its eigenvectors are cheap
# For large bodies without stated rigid motions some nodes are retained in advance, if their unknowns are at most this
# number, or this part of the touched ones, which is cheap compared with a second factorisation.
FEW_MORE, PART_MORE = 48, 0.125
LOST = 1e-2  # the energy, relative to that change, below which a motion of a changed printed stiffness is not elastic
LEAST_SOFT = 1e-13  # the least energy of a soft motion, K scaled to unit diagonal, that its rounding does not change


class Condensation:
    """A stiffness and its rows, condensed; shared by all problems with the same K, E_N, E_T and A.

    Attributes
    ----------
    expand : function
        The full displacement (n,) from that of the retained unknowns (p,) and the state of `reduce_load`.
    solver : whose factors they are
    """

    expand: Callable[[Vector, Vector], Vector]
    solver: str

    def __init__(self, problem: ContactProblem) -> None:
        self._before: Condensation | None = None  # the condensation of a condensed problem
        self.saddles: dict[Any, Any] = {}  # filled by `dense.saddle_point`
        self._cleared: ExtendedRows | None = None
        self.factorisations = 0
        self._spent = 0  # half back-substitutions of abandoned eliminations
        self._rows = (problem.stiffness, problem.normal, problem.tangent, problem.tie)
        self._sparse, self._diagonal = problem.stiffness_rows, problem.diagonal
        self.unknown_scale = unknown_scale(problem)
        touched = touched_unknowns(problem)
        self._wider: Condensation | None = problem._computed.wider_condensation
        stated = _stated_motions(problem)
        floats = stated.count > 0
        self.rigid = RigidMotions(stated.motions[:, :0]) if floats else stated
        retained = touched
        if problem.near_null_space is None and problem.dimension >= LARGE:
            retained = np.union1d(touched, self._precaution(touched))
        elif floats:
            retained = np.union1d(touched, fixing_unknowns(stated.motions, touched, self._diagonal))
        self._eliminate_if_regular(retained, self.unknown_scale)
        if problem.dimension > SMALL:
            refuse_late("the condensed stiffness was factorised")
        if floats and self._floats_no_further(stated):
            self.rigid = stated
        elif self._may_be_singular(problem):
            self._find_rigid_motions(problem, touched)
            if stated.count == self.rigid.count and self.rigid.softest > LEAST_SOFT:  # not mixed with soft motions
                self.rigid = RigidMotions(stated.motions, self.rigid.softest, stated.forces)
        if self.rigid.softest < LOST * problem.rigid_change:
            raise InvalidProblem(
                f"stiffness: it was printed, and {self.rigid.softest:.2g} of it resists a motion, which lost digits "
                "may have made; state the rigid motions as near_null_space, or print more digits"
            )
        self._clear_rigid_motions()
        self.normal = columns_of(problem.normal, self.retained)
        self.tie = columns_of(problem.tie, self.retained)
        self.tangent = None if problem.tangent is None else _sparse_columns_of(problem.tangent, self.retained)

    def fits(self, problem: ContactProblem) -> bool:
        """Return whether a problem has the stiffness and the rows that were condensed."""
        theirs = (problem.stiffness, problem.normal, problem.tangent, problem.tie)
        return all(same_matrix(mine, other) for mine, other in zip(self._rows, theirs, strict=True))

    def _precaution(self, touched: Indices) -> Indices:
        """Return unknowns that would hold floating bodies, if retaining them is cheap, else none."""
        if FAR_APART * connected_parts(self._sparse)[0] > max(FEW_MORE, PART_MORE * len(touched)):
            return touched[:0]
        apart = unknowns_far_apart(self._sparse)
        beside = np.setdiff1d(apart, touched)
        return beside if len(beside) <= max(FEW_MORE, PART_MORE * len(touched)) else touched[:0]

    def _eliminate_if_regular(self, retained: Indices, of_stiffness: Array) -> None:
        """Eliminate the interior unknowns; if their block is singular, some distant ones are retained as well."""
        try:
            self._eliminate(retained, of_stiffness, singular=self._sparse.shape[0] <= SMALL)
        except NotPositive:
            self._eliminate(np.union1d(retained, unknowns_far_apart(self._sparse)), of_stiffness)

    def _eliminate(self, retained: Indices, of_stiffness: Array, singular: bool = True) -> None:
        self._reduced: tuple[Vector, Vector, Vector] | None = None
        self._crossing: tuple[Vector, Vector] | None = None  # |K_ci||K_ii^-1 f_i| of the first `inner`
        nested = self._nested(retained)
        self._elimination: Elimination = eliminate(self._sparse, retained, singular) if nested is None else nested
        self.expand, self.solver, self.retained = self._elimination.expand, self._elimination.solver, retained
        if nested is None and len(retained) < self._sparse.shape[0]:
            self.factorisations += 1
            if (clock := RUNNING.get()) is not None:
                clock.factorisations += 1
        self.schur = self._elimination.schur
        self.scale = self._scale(of_stiffness)
        vars(self).pop("schur_factor", None)

    def _nested(self, retained: Indices) -> NestedBlock | None:
        """Return the elimination that starts from a wider condensation, if that retains all of these unknowns."""
        wider, self._wider = self._wider, None
        if wider is None or not np.all(np.isin(retained, wider.retained)):
            return None
        try:
            return NestedBlock(wider._elimination, wider.retained, retained)
        except NotPositive:
            return None

    @property
    def back_substitutions(self) -> int:
        """Return the number of right-hand sides solved so far, forward and backward."""
        return (self._spent + self._elimination.half_substitutions + 1) // 2

    def _scale(self, of_stiffness: Array) -> Array:
        """Return 1/sqrt(S_jj), or the scale of K where condensation nearly cancelled the diagonal."""
        left, scale = self.schur.diagonal(), of_stiffness[self.retained]
        alive = left > NOTHING_LEFT * self._diagonal[self.retained]
        scale[alive] = 1.0 / np.sqrt(np.maximum(left[alive], TINY))
        return scale

    def _may_be_singular(self, problem: ContactProblem) -> bool:
        """Return whether a pivot is so small that K may be singular, given the digits lost in condensation, or False
        if no body is stated to float.
        """
        if problem.near_null_space is not None and not problem.near_null_space.shape[1]:
            self._schur_smallest_pivot(problem, rounded=False)
            return False
        if self._elimination.smallest_pivot < SUSPICIOUS_PIVOT:
            return True
        if self._schur_smallest_pivot(problem) < max(SUSPICIOUS_PIVOT, lost := self.lost_digits):
            return True
        return len(self.schur) > 1 and self.schur_factor.least_stiffness < max(LIFT * len(self.schur), lost)

    def _find_rigid_motions(self, problem: ContactProblem, touched: Indices) -> None:
        """Find the rigid motions; if the interior floats, some distant nodes are retained, so that S has them all.

        If these do not hold it either, or if K is small, the null space of K itself is computed.
        """
        scale, large = self.unknown_scale, problem.dimension > SMALL
        if large and self._elimination.smallest_pivot < SUSPICIOUS_PIVOT:
            self._spent += self._elimination.half_substitutions
            self._eliminate(np.union1d(self.retained, unknowns_far_apart(self._sparse)), scale)
        if large and self._elimination.smallest_pivot >= SUSPICIOUS_PIVOT:
            if self._may_be_singular(problem):
                self.rigid = condensed_null_space(self._sparse, self.retained, self._elimination, self.scale)
            return
        self.rigid = null_space(self._sparse)
        fixing = fixing_unknowns(self.rigid.motions, touched, self._diagonal)
        held = np.union1d(touched, fixing)
        if not np.array_equal(held, self.retained):
            self._spent += self._elimination.half_substitutions
            self._eliminate(held, scale)

    def _floats_no_further(self, stated: RigidMotions) -> bool:
        """Return whether the stated motions span the null space of K, as S is regular once these are anchored."""
        if self._elimination.smallest_pivot < SUSPICIOUS_PIVOT:
            return False
        motions, _ = np.linalg.qr(stated.motions[self.retained] / self.scale[:, None])
        anchored = self.schur * (self.scale[:, None] * self.scale) + motions @ motions.T
        return DenseCholesky(anchored, np.ones(len(anchored))).smallest_pivot >= max(SUSPICIOUS_PIVOT, self.lost_digits)

    @cached_property
    def bodies(self) -> Indices:
        """Return the number of the body, a connected part of K, that each retained unknown belongs to (p,)."""
        return np.asarray(connected_parts(self._sparse)[1][self.retained])

    @cached_property
    def delassus(self) -> Delassus:
        """Return the Delassus operator of the contacts and ties, which a condensed problem shares."""
        return Delassus(self) if self._before is None else self._before.delassus

    @cached_property
    def lost_digits(self) -> float:
        """Return the rounding error of S relative to its diagonal."""
        left = (self._diagonal[self.retained] * self.scale**2).max(initial=0.0)
        return float(LOST_DIGITS / self._elimination.smallest_pivot * left)

    def _schur_smallest_pivot(self, problem: ContactProblem, rounded: bool = True) -> float:
        lowest = self.schur_factor.smallest_pivot
        if lowest < -CONDENSED_ROUNDING:
            refuse_indefinite(problem)  # otherwise K has been rounded where bodies float
            if not rounded:
                raise InvalidProblem(f"stiffness: as it stands it is indefinite, by {lowest:.3g} of its diagonal")
        return lowest

    @cached_property
    def schur_factor(self) -> DenseCholesky:
        """Return the Cholesky factors of S in its scale.

        Its pivots are those in that scale: a diagonal that is all rounding must not be scaled to one.
        """
        scaled = self.schur * (self.scale[:, None] * self.scale)
        return DenseCholesky(scaled, np.ones(len(scaled)))

    def _clear_rigid_motions(self) -> None:
        """Set S to zero along rigid motions, removing its rounding errors."""
        if not self.rigid.count or not len(self.schur):
            return
        Q, _ = np.linalg.qr(self._scaled_motions)
        cleared = self.schur * (self.scale[:, None] * self.scale)
        cleared = cleared - Q @ (Q.T @ cleared)
        cleared = cleared - (cleared @ Q) @ Q.T
        cleared[abs(cleared) < len(Q) * EPS] = 0.0
        self.schur = (cleared + cleared.T) / 2 / (self.scale[:, None] * self.scale)
        vars(self).pop("schur_factor", None)

    def reduce_load(self, load: Vector) -> tuple[Vector, Vector]:
        """Return f_S (p,) and the state that `expand` needs; both are kept for the refinement."""
        reduced, inner = self.reduce_residual(load)
        if self._reduced is None or self._reduced[2] is not inner:
            self._reduced = (load.copy(), reduced, inner)
        return self._reduced[1:]

    def reduce_residual(self, load: Vector) -> tuple[Vector, Vector]:
        """Return the result of `reduce_load` without keeping it, for a residual of the refinement."""
        if self._reduced is not None and np.array_equal(self._reduced[0], load):
            return self._reduced[1:]
        reduced, inner = self._elimination.reduce(load)
        if self.rigid.count:
            added = self.rigid.work_to_add(self._scaled_motions, self.bodies, load, reduced * self.scale)
            reduced = reduced + added / self.scale
        return reduced, inner

    def reduce_passing_load(self, load: Vector) -> tuple[Vector, Vector]:
        """Return `reduce_residual` of a new load, such as that of a time step; no body may float."""
        return self._elimination.reduce(load)

    def responses(self, retained: Array) -> Array:
        """Return displacements (n, q) without interior loads, from those of the retained unknowns (p, q)."""
        return self._elimination.expand_motions(retained)

    def free_displacements(self, loads: Array) -> Array:
        """Return displacements (n, q) under loads without contacts and ties, in doubles; nothing may float."""
        if isinstance(self._elimination, LastBlock):  # one pass over the factors for all of them
            reduced, inner = self._elimination.reduce(loads)
            return self.expand(self._free(reduced), inner)
        states = (self.reduce_passing_load(load) for load in loads.T)
        return np.column_stack([self.expand(self._free(reduced), inner) for reduced, inner in states])

    def _free(self, reduced: Array) -> Array:
        return np.asarray((self.schur_factor.solve((reduced.T * self.scale).T).T * self.scale).T)

    def correction(
        self, saddle: SaddlePoint, residual: Vector, gap: Vector, open_tie: Vector
    ) -> tuple[Vector, Vector, Vector]:
        """Solve the full saddle-point system once with the condensed factors, in double precision.

        Parameters
        ----------
        saddle : that of the condensed system with q closed contacts
        residual : (n,) array [force]
        gap : (q,) array [length], of the closed contacts
        open_tie : (k,) array [length], what the ties miss; empty where the saddle point is without ties

        Returns
        -------
        du, dl, dnu : (n,), (q,), (k,) arrays
            Changes of displacement, contact forces and tie forces.
        """
        reduced, inner = self.reduce_residual(residual)
        dx, dl, dn = saddle.solve(reduced, gap, open_tie)
        return self.expand(dx, inner), dl, dn

    def remember_load(self, load: Vector, reduced: Vector, inner: Vector) -> None:
        """Store the reduced form of a load that is a combination of reduced ones."""
        self._reduced = (load.copy(), reduced, inner)

    def reduced_size(self, problem: ContactProblem, inner: Vector) -> Vector:
        """Return the sizes behind each entry of f_S (p,): where a body floats, |f_c| + |K_ci||K_ii^-1 f_i|.

        Where the interior loads cancel, rounding of all loads counts, and the sizes of |f| are added.
        """
        size = problem.load_size[self.retained]
        if not self.rigid.count or len(size) == problem.dimension:
            return size
        if self._crossing is None or self._crossing[0] is not inner:
            held = abs(self.expand(np.zeros(len(self.retained)), inner))
            crossing = abs(self._sparse[self.retained]) @ held
            left, loads = self.scale * (size + crossing), problem.own_scale * problem.load_size
            if np.max(left, initial=0.0) < CANCELLED * np.max(loads):
                crossing += abs(self._elimination.reduce(problem.load_size)[0])
            self._crossing = inner, crossing
        return np.asarray(size + self._crossing[1])

    def reduced_problem(self, problem: ContactProblem, reduced_load: Vector, inner: Vector) -> ContactProblem:
        """Return the condensed problem, a ContactProblem that keeps its own condensation."""
        size = self.reduced_size(problem, inner)
        data = (self._held_schur(), reduced_load, size, self.normal, problem.gap, self.tie, problem.tie_value)
        reduced = problem._transformed(*data)
        reduced._computed.condensation, reduced._computed.unknown_scale = self._of_reduced(reduced), self.scale
        return reduced

    def cleared_rows(self, problem: ContactProblem) -> ExtendedRows:
        """Return rows whose stiffness is exactly zero along rigid motions."""
        if self._cleared is None:
            weight, (motions, _) = np.sqrt(self._diagonal), motions_as_stated(problem, self.rigid.motions)
            inverse = np.asarray(np.linalg.pinv(weight[:, None] * motions) * weight, dtype=float)
            self._cleared = extended_rows(problem).cleared(motions, inverse)
        return self._cleared

    def idle_motions(self) -> Array:
        """Return an orthonormal basis (p, q), scaled, of the rigid motions that no contact and no tie resists."""
        rows = np.vstack([self.normal, self.tie]) * self.scale
        return orthonormal(self._scaled_motions @ self.unresisted(rows))

    def unresisted(self, rows: Array) -> Array:
        """Return the coordinates (r, q) of the rigid motions that scaled rows (k, p) do not resist."""
        return unresisted(self._scaled_motions, self.bodies, rows)

    @property
    def _scaled_motions(self) -> Array:
        """The rigid motions (p, r) of the retained unknowns, scaled."""
        return self.rigid.motions[self.retained] / self.scale[:, None]

    def null_space(self, closed: Indices, tied: bool) -> SaddlePoint:
        """Return the saddle point of closed contacts by the null-space method, which admits any set."""
        return NullSpace(self, closed, tied)

    def _held_schur(self) -> Array:
        """Return S with springs on the idle motions, which carry no force as no load drives these."""
        if not self.rigid.count or not (idle := self.idle_motions()).shape[1]:
            return self.schur
        return self.schur + idle @ idle.T / (self.scale[:, None] * self.scale)

    def _of_reduced(self, reduced: ContactProblem) -> Condensation:
        """Return the condensation of the condensed problem, which has no interior."""
        twin = object.__new__(Condensation)
        twin.__dict__ |= self.__dict__
        twin.rigid = RigidMotions(self.rigid.motions[self.retained], self.rigid.softest)
        twin.unknown_scale, twin._before = self.scale, self
        twin._cleared = None
        twin._retain_all(reduced)
        return twin

    @classmethod
    def of_condensed(cls, problem: ContactProblem, rigid: RigidMotions, scale: Array) -> Condensation:
        """Return the condensation of a problem that retains every unknown and whose rigid motions are known."""
        made = object.__new__(cls)
        made.saddles, made.factorisations, made._spent = {}, 0, 0
        made._cleared, made._wider, made._before = None, None, None
        made.rigid, made.scale, made.unknown_scale = rigid, scale, scale
        made._retain_all(problem)
        made.schur = made._elimination.schur
        made.normal, made.tie, made.tangent = problem.normal.toarray(), problem.tie.toarray(), problem.tangent
        return made

    def _retain_all(self, problem: ContactProblem) -> None:
        self._rows = (problem.stiffness, problem.normal, problem.tangent, problem.tie)
        self._sparse, self._diagonal = problem.stiffness_rows, problem.diagonal
        self.retained, self._reduced, self._crossing = np.arange(problem.dimension), None, None
        self._elimination = eliminate(self._sparse, self.retained)
        self.expand, self.solver = self._elimination.expand, self._elimination.solver


def eliminate(stiffness: Any, retained: Indices, singular: bool = True) -> Elimination:
    """Return the fastest available elimination for a stiffness (n, n) in CSR and unknowns (p,) to retain.

    Raises
    ------
    NotPositive
        The interior is singular, as far as PARDISO can tell. Raised only if `singular` is False; otherwise SuperLU is
        tried, whose pivots are known, and which takes much longer.
    InvalidProblem
        The environment names a solver that is none.
    Unsupported
        S, or the factors of the stiffness, do not fit into memory.
    """
    try:
        return _eliminate(stiffness, retained, singular)
    except TooLarge as error:
        raise Unsupported(str(error)) from None
    except MemoryError:
        count = len(retained)
        size = f"{count**2 * np.dtype(float).itemsize / 2**30:.0f} GiB"
        raise Unsupported(
            f"{count} unknowns at contacts and ties that may act: their dense stiffness takes {size}, and memory is "
            "full"
        ) from None


def _eliminate(stiffness: Any, retained: Indices, singular: bool) -> Elimination:
    chosen = os.environ.get(SOLVER_VARIABLE, "")
    if chosen and chosen not in CHOICES:
        raise InvalidProblem(f"{SOLVER_VARIABLE}: expected one of {', '.join(CHOICES)}, got {shown(chosen)}")
    count = stiffness.shape[0] - len(retained)
    wanted = count >= LARGE and available() if chosen in ("", "pyamg") else chosen == "pardiso" and count > 0
    if wanted and np.all(np.delete(stiffness.diagonal(), retained) > 0):
        try:
            return LastBlock(stiffness, retained)
        except NotPositive:  # the pivots of the other solver decide whether it is indefinite
            if not singular:
                raise
    if count > max(DENSE_SIZE, FEW * len(retained)):
        return TrailingBlock(sp.csr_matrix(stiffness), retained)
    return BackSubstitution(stiffness, retained, factorise)


def columns_of(rows: Any, columns: Indices) -> Array:
    """Return some columns of CSR rows as an array; for few rows a full array is made first, which is faster."""
    if not rows.shape[0]:
        return np.zeros((0, len(columns)))
    if rows.shape[0] * rows.shape[1] <= WRITTEN_OUT:
        return np.asarray(rows.toarray()[:, columns])
    return np.asarray(rows[:, columns].toarray())


def _sparse_columns_of(rows: Any, columns: Indices) -> Any:
    few = rows.shape[0] * rows.shape[1] <= WRITTEN_OUT
    return csr_rows(columns_of(rows, columns)) if few else rows[:, columns]


def condense(problem: ContactProblem) -> Condensation:
    """Return the condensation of a problem, computed once and shared by `problem.replace`."""
    problem._refuse_exchanged_arrays()
    if problem.has_idle_rows:
        raise Unsupported(
            "contacts with a gap of infinity or a row of zeros, and ties of zeros, constrain nothing: "
            "solve, certify, equilibria, paths and motions leave them out; here, leave them out yourself"
        )
    if problem._computed.condensation is None:
        with stage(CONDENSE):
            refuse_late("the stiffness was condensed")
            problem._computed.condensation = Condensation(problem)
    condensation: Condensation = problem._computed.condensation
    return condensation


def free_motions(condensation: Condensation, saddle: SaddlePoint) -> Array:
    """Return an orthonormal basis (n, q) of the motions that neither K nor rows of the closed set resist."""
    return orthonormal(condensation.rigid.motions @ saddle.free_coordinates)


def _stated_motions(problem: ContactProblem) -> RigidMotions:
    """Return the motions of `near_null_space` that K does not resist, each of one body."""
    if problem.near_null_space is None:
        return RigidMotions(np.zeros((problem.dimension, 0)))
    return stated_motions(problem.stiffness_rows, problem.stiffness_sizes, problem.near_null_space)


def touched_unknowns(problem: ContactProblem) -> Indices:
    """Return the unknowns that contacts, their tangents and ties touch."""
    rows = [problem.normal, problem.tie] + ([] if problem.tangent is None else [problem.tangent])
    return np.bincount(np.concatenate([row.indices for row in rows]), minlength=problem.dimension).nonzero()[0]
