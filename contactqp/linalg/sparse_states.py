"""Solve the sparse system of one combination of open, stick and slip in the plane in all unknowns, without
condensation.

    [ K + d   N_c' + T_c' diag(mu t)   T_b'   A' ] [ u   ]   [ f ]
    [ N_c     -d                                 ] [ l_N ] = [ g ]      c: closed contacts, t = -1, 0, 1 their slip
    [ T_b             -d                         ] [ l_T ]   [ o ]      b: those that stick
    [ A                        -d                ] [ nu  ]   [ b ]

is the system of `contactqp.linalg.friction_states` before condensation, in the same scale: unknowns by 1/sqrt(K_jj),
rows of unit length in the energy. The d on the diagonal, as in `contactqp.linalg.sparse_saddle`, permits a sparse
elimination in any order; residuals in extended precision remove its effect. Where bodies float,
H' (H u - h) is added in place of d u, with H u = h the equations of lengths: this changes no answer.
Successive combinations differ in few contacts, and the factors of one are reused for the next.

Without friction the system without contacts gives the response of tied bodies to contact forces (`TiedBodies`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed
from contactqp.linalg import pardiso
from contactqp.linalg.convexity import moves_beyond_bodies
from contactqp.linalg.dense import orthonormal
from contactqp.linalg.equilibration import scaled_by
from contactqp.linalg.factorization import null_space_by_part, right_singular
from contactqp.linalg.friction_states import MAX_SWEEPS, Correction, RefinedState, refined_by
from contactqp.linalg.iteration import held_by_hierarchy
from contactqp.linalg.krylov import separated
from contactqp.linalg.schur import factorised, with_pivots
from contactqp.linalg.sparse_saddle import CONTRACTS, CORRECTIONS, REGULARISATIONS, SWEEPS, SparseSaddle
from contactqp.model.arrays import EPS, Array, Indices, Vector
from contactqp.model.coulomb import OPEN, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# The value of d; with unit diagonal and rows a sweep of refinement then gains about nine digits.
REGULARISATION = 1e-9
# The number of systems kept: that of an answer, and the one without contacts that measures forces.
KEPT = 2
# The most changed equations for which the factors of a combination are reused; for more, the back-substitutions take as
# long as new factors.
MOST_CHANGES = 32
# A system is singular if its factors return a known solution with a relative error above this.
SINGULAR = 1e-3

# A response is settled once a sweep of refinement changes it by less than this part in the energy norm.
SETTLED = 1e-6
# The values of d for responses of tied bodies, tried in turn: soft bodies need the smaller.
BENEATH = REGULARISATIONS[1:]
ROUNDED_RESPONSE = 64 * EPS  # the rounding of a response in doubles, relative to the forces
# The most free motions that are looked for by so many iterations, and energies of unit motions that count as none, or
# may be one of a soft body.
MOST_FREE, ITERATIONS, FREE, SOFT, HELD = 16, 3, 1e-13, 1e-11, 1e-11

# A solution or right-hand side: unknowns (n,), normal and friction forces of contacts (m,), and ties (k,).
_Parts = tuple[Vector, Vector, Vector, Vector]


class SparseFrictionalRows:
    """A frictional problem in the plane in all unknowns, with the attributes of `FrictionalRows`, sparse.

    `factorisations` says how many systems of combinations have been factorised.
    """

    width = 1

    def __init__(self, problem: ContactProblem) -> None:
        if problem.friction is None or problem.tangent is None:
            raise ValueError("frictional rows of a problem without friction")
        self.scale = problem.own_scale
        unknowns = sp.diags(self.scale)
        self.S = scaled_by(self.scale, sp.csr_matrix(problem.stiffness_rows), self.scale)
        ((self.normal, self.normal_length), (self.tangent, self.tangent_length), (self.tie, self.tie_length)) = (
            _unit(sp.csr_matrix(rows @ unknowns)) for rows in (problem.normal, problem.tangent, problem.tie)
        )
        self.slides = np.diff(self.tangent.indptr) > 0
        self.coefficient = problem.friction * self.tangent_length / self.normal_length
        # A basis (n, q) of the rigid motions of bodies that float, orthonormal in the same scale.
        held = held_by_hierarchy(problem) or not problem.diagonal.all() or moves_beyond_bodies(problem)
        n = problem.dimension
        motions = sp.csr_matrix((n, 0)) if held else null_space_by_part(problem.stiffness_rows)[0]
        self.motions = sp.csr_matrix(sp.diags(1 / self.scale) @ motions)
        self.floats = motions.shape[1] > 0
        self._order, self._ordered = pardiso.EliminationOrder(n), False
        self._systems: dict[bytes, StateSystem] = {}
        self._factorised: SparseStateSystem | None = None
        self.factorisations = 0

    def system(self, problem: ContactProblem, status: Status) -> StateSystem:
        """Return the system of a combination; the last few are kept for the certificate."""
        key = status.tobytes()
        if key not in self._systems:
            if len(self._systems) == KEPT:
                self._systems.pop(next(iter(self._systems)))
            self._systems[key] = self._made(problem, status)
        return self._systems[key]

    def joined(self, matrix: Any, upper: Any, kind: int) -> Callable[[Array], Array]:
        """Return a function that solves with a saddle point whose upper block holds the constrained rows, too.

        Rows are exchanged, or eliminated after their unknowns: a pivot -d would hide the stiffness of a body that hangs
        on many others.

        Raises BackendFailed: the upper block is singular, or PARDISO is needed and not installed.

        Parameters
        ----------
        matrix, upper : (p, p) and (n, n) sparse matrices, the saddle point and its upper block
        kind : as in `factorised`
        """
        try:
            return with_pivots(matrix)
        except BackendFailed:
            if not pardiso.available():
                raise
        unknowns = np.arange(len(self.scale))
        if not self._ordered:
            self._order.factorised(sp.csc_matrix(upper), unknowns)
            self._ordered = True
        return self._order.factorised(matrix, unknowns, kind).solve_all

    def _made(self, problem: ContactProblem, status: Status) -> StateSystem:
        """Return the system of a combination, by the factors of the last one if few equations differ."""
        last = self._factorised
        if last is not None and last.regular and np.any(status != OPEN):
            few = sum(len(some) for some in _changes(last.status, status)) <= MOST_CHANGES
            changed = ChangedStateSystem(self, last, status) if few else None
            if changed is not None and changed.regular:
                return changed
        made = SparseStateSystem(problem, self, status)
        self.factorisations += 1
        if np.any(status != OPEN):
            self._factorised = made
        return made


def _unit(rows: Any) -> tuple[Any, Vector]:
    """Return rows of unit length and the lengths that they were divided by."""
    rows.eliminate_zeros()
    length = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
    length = np.where(length > 0, length, 1.0)
    return sp.csr_matrix(sp.diags(1.0 / length) @ rows), length


def frictional_rows(problem: ContactProblem) -> SparseFrictionalRows:
    """Return the frictional rows of a stiffness, its rows and coefficients, made once."""
    kept = problem._computed.sparse_frictional_rows
    if kept is None or kept[0] is not problem.friction:
        kept = problem._computed.sparse_frictional_rows = (problem.friction, SparseFrictionalRows(problem))
    rows: SparseFrictionalRows = kept[1]
    return rows


class StateSystem(ABC):
    """The system of one combination in all unknowns; attributes are those of `friction_states.StateSystem`.

    Attributes
    ----------
    status : (m,) array, the combination
    back_substitutions : int, how many it has taken
    regular : whether it has an inverse
    drag : (m,) array, friction over normal force of contacts that slip, with the sign of their slip; zero for others
    """

    redundant = False  # with dependent rows the system is not regular
    regular: bool

    def __init__(self, rows: SparseFrictionalRows, status: Status) -> None:
        self.status, self.back_substitutions = status, 0
        self._rows, self._closed, self._stuck = rows, status != OPEN, status == STICK
        self.drag = np.where(self._stuck, 0.0, status) * rows.coefficient

    @abstractmethod
    def _once(self, load: Vector, gap: Vector, slip: Vector, tie: Vector) -> _Parts:
        """Return u (n,), l_N and l_T (m,), nu (k,) of the regularised system with scaled right-hand sides.

        l_T is that of contacts that stick, zero elsewhere.
        """

    def _solve(self, load: Vector, gap: Vector, slip: Vector, tie: Vector) -> _Parts:
        """Return the solution without regularisation, by refinement in double precision."""
        right = (load, np.where(self._closed, gap, 0.0), np.where(self._stuck, slip, 0.0), tie)
        found, last = self._once(*right), _largest(right)
        for _ in range(CORRECTIONS):
            left = self._left(right, found)
            size = _largest(left)
            if not size < CONTRACTS * last:
                break
            u, normal, friction, tied = self._once(*left)
            found, last = ((found[0] + u, found[1] + normal, found[2] + friction, found[3] + tied), size)
        return found

    def _left(self, right: _Parts, found: _Parts) -> _Parts:
        """Return the scaled residuals of a solution, in double precision."""
        rows, (u, normal, friction, tied) = self._rows, found
        force = right[0] - rows.S @ u - rows.normal.T @ normal - rows.tie.T @ tied
        force -= rows.tangent.T @ (self.drag * normal + friction)
        gap = np.where(self._closed, right[1] - rows.normal @ u, 0.0)
        slip = np.where(self._stuck, right[2] - rows.tangent @ u, 0.0)
        return force, gap, slip, right[3] - rows.tie @ u

    def _regular(self) -> bool:
        """Return whether a random solution is found to some digits from the right-hand sides that belong to it."""
        random, rows = np.random.default_rng(0), self._rows
        sizes = (len(rows.scale), len(self.status), len(self.status), len(rows.tie_length))
        u, normal, friction, tied = (random.uniform(0.5, 1.0, size) for size in sizes)
        given = u, np.where(self._closed, normal, 0.0), np.where(self._stuck, friction, 0.0), tied
        right = self._left((np.zeros(sizes[0]), np.zeros(sizes[1]), np.zeros(sizes[2]), np.zeros(sizes[3])), given)
        found = self._once(*(-part for part in right))
        return all(bool(np.all(abs(part - own) <= SINGULAR)) for part, own in zip(found, given, strict=True))

    def correct(self, load: Vector, gap: Vector, slip: Vector, tie: Vector) -> Correction:
        """Return du (n,), dl_N (m,), dl_T (m, 1) of sticking contacts and dnu (k,) from residuals of the problem.

        Parameters
        ----------
        load : (n,) array [force], what is out of balance
        gap, slip, tie : (m,), (m,), (k,) arrays [length], what gaps, slips and ties miss
        """
        rows = self._rows
        lengths = (gap / rows.normal_length, slip / rows.tangent_length, tie / rows.tie_length)
        moved, pushing, sticking, tied = self._solve(load * rows.scale, *lengths)
        friction_force = (sticking / rows.tangent_length)[:, None]
        return Correction(moved * rows.scale, pushing / rows.normal_length, friction_force, tied / rows.tie_length)

    def response_norm(self, load: Vector) -> float:
        """Return the energy norm of the response to a load (n,) with all constrained lengths held at zero."""
        held, scaled = np.zeros(len(self.status)), load * self._rows.scale
        scaled = scaled - self._rows.motions @ (self._rows.motions.T @ scaled)  # nothing elastic resists these
        moved = self._once(scaled, held, held, np.zeros(len(self._rows.tie_length)))[0]
        return float(np.sqrt(max(float(scaled @ moved), 0.0)))


class SparseStateSystem(StateSystem):
    """The factorised system of one combination.

    Raises BackendFailed as `contactqp.linalg.sparse_saddle.factorised` does.
    """

    def __init__(self, problem: ContactProblem, rows: SparseFrictionalRows, status: Status) -> None:
        super().__init__(rows, status)
        self.closed, self.stuck = closed, stuck = (np.flatnonzero(self._closed), np.flatnonzero(self._stuck))
        held = sp.vstack([rows.normal[closed], rows.tangent[stuck], rows.tie], format="csr")
        dragged = sp.diags(self.drag[closed]) @ rows.tangent[closed]
        count, n = held.shape
        slips = bool(np.any(self.drag))
        pushed = held + sp.vstack([dragged, sp.csr_matrix((count - len(closed), n))], format="csr") if slips else held
        self._joined = held if rows.floats and count else sp.csr_matrix((count, n))
        upper = rows.S + (self._joined.T @ held if self._joined.nnz else REGULARISATION * sp.identity(n))
        matrix = sp.bmat([[upper, pushed.T], [held, -REGULARISATION * sp.identity(count)]], format="csc")
        symmetric = pardiso.INDEFINITE if count else pardiso.POSITIVE_DEFINITE
        kind = pardiso.UNSYMMETRIC if slips else symmetric
        self.size = matrix.shape[0]
        if self._joined.nnz:
            self._factor = rows.joined(matrix, upper, kind)
        else:
            self._factor = factorised(matrix, kind, pardiso.elimination_order(problem), np.arange(problem.dimension))
        self.regular = self._regular()

    def by_factors(self, right: Array) -> Array:
        """Return the solution for a right-hand side (p,), or for several (p, q)."""
        self.back_substitutions += 1 if right.ndim == 1 else right.shape[1]
        return self._factor(right)

    def right(self, load: Vector, gap: Vector, slip: Vector, tie: Vector) -> Vector:
        """Return the right-hand side of the system (p,), in its scaled units.

        Parameters
        ----------
        load, gap, slip, tie : (n,), (m,), (m,), (k,) arrays
            What is out of balance, and what gaps, slips and ties miss; of gaps and slips those enter that are held.
        """
        lengths = np.concatenate([gap[self.closed], slip[self.stuck], tie])
        return np.concatenate([load + self._joined.T @ lengths, lengths])

    def places(self) -> tuple[Indices, Indices]:
        """Return the indices of normal and of sticking forces in the system, (m,) each, -1 for none."""
        pushing, sticking = np.full((2, len(self.status)), -1)
        pushing[self.closed] = len(self._rows.scale) + np.arange(len(self.closed))
        sticking[self.stuck] = len(self._rows.scale) + len(self.closed) + np.arange(len(self.stuck))
        return pushing, sticking

    def parts(self, found: Vector) -> _Parts:
        """Return displacement, normal, friction and tie forces of a solution (p,)."""
        closed, stuck = self.closed, self.stuck
        normal_force, friction_force = np.zeros((2, len(self.status)))
        cuts = np.cumsum([len(self._rows.scale), len(closed), len(stuck)])
        moved, normal_force[closed], friction_force[stuck], tied = np.split(found, cuts)
        return moved, normal_force, friction_force, tied

    def _once(self, load: Vector, gap: Vector, slip: Vector, tie: Vector) -> _Parts:
        return self.parts(self.by_factors(self.right(load, gap, slip, tie)))


class ChangedStateSystem(StateSystem):
    """The system of a combination that differs in few equations from a factorised one, by the factors of that.

    Every change borders the factorised matrix B by an unknown y and an equation,

        [ B  C ] [ x ]   [ b ]      C: a row of a contact that closes or sticks; or one, where y is what is missing of
        [ R  D ] [ y ] = [ r ]         the equation of one that does so no more
                                    R: this row; or what says that the force is zero, or mu t l_N

    and is solved by B^-1 C and the dense D - R B^-1 C (Golub and Van Loan 2013, section 2.1.4).

    Parameters
    ----------
    rows : SparseFrictionalRows
    factorised : SparseStateSystem
    status : (m,) array, the combination
    """

    def __init__(self, rows: SparseFrictionalRows, factorised: SparseStateSystem, status: Status) -> None:
        super().__init__(rows, status)
        self._factorised, self._changes = (factorised, _changes(factorised.status, status))
        opens, frees, closes, sticks, turns = self._changes
        drag, before = self.drag, factorised.drag
        (pushing, sticking), size = factorised.places(), factorised.size
        zero, free = _units(pushing[opens], size), _units(sticking[frees], size)
        felt, stuck, along = (
            _padded(some, size) for some in (rows.normal[closes], rows.tangent[sticks], rows.tangent[turns])
        )
        dragged = _padded(sp.csr_matrix(sp.diags(drag[closes]) @ rows.tangent[closes]), size)
        columns = sp.vstack([zero, free, felt + dragged, stuck, along])
        if rows.floats:  # a row that is no longer met leaves the upper block, too
            gone = sp.vstack([rows.normal[opens], rows.tangent[frees]], format="csr")
            gone.resize(columns.shape[0], size)
            columns = columns + gone
        slides, slides_back = sp.diags(drag[frees]), sp.diags((before - drag)[turns])
        bounds = (slides @ _units(pushing[frees], size), slides_back @ _units(pushing[turns], size))
        self._equations = sp.csr_matrix(sp.vstack([zero, free - bounds[0], felt, stuck, bounds[1]]))
        counts = len(opens) + len(frees), len(closes) + len(sticks), len(turns)
        self._responses = factorised.by_factors(columns.T.toarray())
        self._border = np.diag(np.repeat([0.0, -REGULARISATION, 1.0], counts)) - self._equations @ self._responses
        self.back_substitutions += columns.shape[0]
        try:
            self.regular = self._regular()
        except np.linalg.LinAlgError:
            self.regular = False

    def _once(self, load: Vector, gap: Vector, slip: Vector, tie: Vector) -> _Parts:
        opens, frees, closes, sticks, turns = self._changes
        self.back_substitutions += 1
        found = self._factorised.by_factors(self._factorised.right(load, gap, slip, tie))
        none = np.zeros(len(opens) + len(frees)), np.zeros(len(turns))
        right = np.concatenate([none[0], gap[closes], slip[sticks], none[1]])
        added = np.linalg.solve(self._border, right - self._equations @ found)
        u, normal, friction, tied = self._factorised.parts(found - self._responses @ added)
        cuts = np.cumsum([len(opens) + len(frees), len(closes), len(sticks)])
        _, normal[closes], sticking, _ = np.split(added, cuts)
        normal[opens] = 0.0
        friction[frees] = 0.0
        friction[sticks] = sticking + self._factorised.drag[sticks] * normal[sticks]
        return u, normal, friction, tied


def _changes(before: Status, after: Status) -> tuple[Indices, ...]:
    """Return the contacts that open, stop sticking, close, begin to stick, and reverse their slip."""
    flags = (
        (before != OPEN) & (after == OPEN),
        (before == STICK) & (after != STICK),
        (before == OPEN) & (after != OPEN),
        (before != STICK) & (after == STICK),
        (abs(before) == 1) & (after == -before),
    )
    return tuple(np.flatnonzero(part) for part in flags)


def _units(places: Indices, size: int) -> Any:
    """Return rows (q, size) of zeros with a one at each of these places."""
    return sp.csr_matrix((np.ones(len(places)), places, np.arange(len(places) + 1)), shape=(len(places), size))


def _padded(rows: Any, size: int) -> Any:
    """Return rows extended by columns of zeros to `size` columns."""
    return sp.csr_matrix((rows.data, rows.indices, rows.indptr), shape=(rows.shape[0], size))


def _largest(parts: _Parts) -> float:
    return max(float(np.max(abs(part), initial=0.0)) for part in parts)


def refined_sparse(problem: ContactProblem, status: Status, start: Answer, sweeps: int = MAX_SWEEPS) -> RefinedState:
    """Refine the answer of a combination from a start, in extended precision.

    Raises BackendFailed as `SparseStateSystem` does.

    Parameters
    ----------
    problem : in the plane, with friction
    status : (m,) array of int, the combination
    start : where refinement begins
    sweeps : at most so many corrections
    """
    rows = frictional_rows(problem)
    return refined_by(lambda *_: rows.system(problem, status), problem, rows, status, start, sweeps=sweeps)


class TiedBodies:
    """The response of an equilibrated problem's bodies to forces, with all contacts open and their ties held.

    Parameters
    ----------
    problem : ContactProblem, equilibrated
    units : (n,) array, those of its unknowns
    """

    def __init__(self, problem: ContactProblem, units: Vector) -> None:
        self._problem, self._units, self._left = problem, units, list(BENEATH)
        self._motions, self._separated = np.zeros((problem.dimension, 0)), problem.ties < 2
        self._saddle = self._factorised(self._left.pop(0))

    def _factorised(self, added: float) -> SparseSaddle:
        return SparseSaddle(self._problem, np.zeros(0, dtype=np.intp), added)

    def response(self, force: Vector, balancing: Any = None) -> tuple[float, float] | None:
        """Return |y|_K with K y + A'nu = P f and A y = 0 for forces f (n,), and what its refinement leaves open.

        P removes the part that drives motions which neither K nor ties resist, in the units of the problem. Where there
        are some, f less the forces of `balancing` rows that balance it on them takes its place. None if these do not,
        or if what resists is too soft to be distinguished from nothing.
        """
        if not force.any():
            return 0.0, 0.0
        found = None if self._motions.shape[1] else self._swept(force)
        if found is None and not self._separated:
            self._separated, ties = True, separated(self._problem.tie)
            if ties is not None:
                self._problem = self._problem.replace(tie=ties, tie_value=np.zeros(ties.shape[0]))
                self._saddle = self._factorised(self._saddle.regularisation)
            found = self._swept(force)
        if found is None and not self._motions.shape[1]:
            self._motions = self._free_motions()
        if self._motions.shape[1]:
            if (balanced := force if balancing is None else self._balanced(force, balancing)) is None:
                return None
            found = self._swept(force := balanced)
        while found is None and self._left:
            try:
                self._saddle = self._factorised(self._left.pop(0))
            except BackendFailed:
                break
            found = self._swept(force)
        return found

    def _balanced(self, force: Vector, rows: Any) -> Vector | None:
        """Return forces (n,) less the least ones of rows (q, n) that balance them on free motions, None if none do."""
        motions = self._motions / self._units[:, None]
        driven, moved = motions.T @ force, rows @ motions
        share = np.linalg.lstsq(moved.T, driven, rcond=None)[0]
        left = abs(moved.T @ share - driven)
        return force - rows.T @ share if np.all(left <= SETTLED * abs(motions).T @ abs(force)) else None

    def _swept(self, force: Vector) -> tuple[float, float] | None:
        """Return the norm after sweeps of refinement and what further ones may change; None if they do not contract."""
        K, A, change, shared = self._problem.stiffness_rows, self._problem.tie, np.inf, np.inf
        force = force - self._units * (self._motions @ (self._motions.T @ (force / self._units)))
        y, nu, left, size = np.zeros(len(force)), np.zeros(self._problem.ties), force, 0.0
        for _ in range(SWEEPS):
            du, _, dn = self._saddle.solve(left, np.zeros(0), -(missed := A @ y))
            tied = self._separated and np.all(abs(missed) <= ROUNDED_RESPONSE * (abs(A) @ abs(y)))
            y, nu, before, change = y + du, nu + dn, change, self._strain(du)
            left, size, last, shared = force - K @ y - A.T @ nu, self._strain(y), shared, np.max(abs(dn), initial=0.0)
            creeps = shared > CONTRACTS * min(last, np.max(abs(missed), initial=0.0) / self._saddle.regularisation)
            tied |= shared <= (ROUNDED_RESPONSE if creeps else SETTLED) * np.max(abs(nu), initial=0.0)
            if (change <= SETTLED * size and tied) or change > CONTRACTS * before:
                break
        met = np.linalg.norm(left) <= SETTLED * np.linalg.norm(force)
        rounded = ROUNDED_RESPONSE * float(np.linalg.norm(force))
        return (size, 2 * change + rounded) if met and tied and change <= SETTLED * size + rounded else None

    def _strain(self, y: Vector) -> float:
        return float(np.sqrt(max(float(y @ (self._problem.stiffness_rows @ y)), 0.0)))

    def _free_motions(self) -> Array:
        """Return orthonormal motions (n, q) that neither K nor ties resist, none if there are many or some are soft.

        The response of the regularised system to random forces consists of them, more so in every iteration.
        """
        count, K = min(MOST_FREE, self._problem.dimension), self._problem.stiffness_rows
        motions = np.random.default_rng(0).standard_normal((self._problem.dimension, count))
        for _ in range(ITERATIONS):
            moved = [self._saddle.solve(z, np.zeros(0), np.zeros(self._problem.ties))[0] for z in motions.T]
            motions = np.linalg.qr(np.column_stack(moved))[0]
        values, turned = np.linalg.eigh(motions.T @ (K @ motions))
        free = values <= FREE
        if np.any(~free & (values < SOFT)) or (free.all() and count < self._problem.dimension):
            return motions[:, :0]
        motions = motions @ turned[:, free]
        if self._problem.ties:
            held, turned = right_singular(self._problem.tie @ motions)
            motions = motions @ turned[int(np.sum(held > HELD)) :].T
        return orthonormal(self._units[:, None] * motions)
