"""Solve many load cases by influence functions of contacts, with residuals by exact products.

Residuals of many right-hand sides at once are formed beyond double precision by products without rounding. Ozaki,
Ogita, Oishi, Rump (2012), Numer. Algorithms 59: numbers are cut into slices of so few bits that sums of products of
slices are doubles,

    K x = K1 x1 + (K1 x2 + K2 x1) + (K1 x3 + K2 x2 + K3 x1) + rest,    |rest| <= 2^-65 |K| max|x| for each entry of K,

in units in which the diagonal of K is about one. A residual costs six products of sparse and dense matrices, a tenth of
one in twice double precision.

Let B = [E_N; E_T; A] be the rows of contacts and ties, E_T there with friction alone, Y = K^-1 B' their influence
functions, the displacements under unit forces along them, and W = B Y. Of a load f within the limits c = (g, o, b)

    B u - c = Y'f - c - W l

in which only the unknowns of contacts appear. Rows are scaled so that W_ii = 1, and lengths and forces accordingly.
Without friction the forces of the closed contacts and ties C solve W_CC l_C = (Y'f - c)_C. With friction in the plane C
also contains the tangential rows of sticking contacts, and the friction of a slipping one is mu t l_N, t = +-1: l = P
l_C, and

    (W P)_CC l_C = (Y'f - c)_C.

Every answer is proven. The forces computed for C solve the system M with an error of the right-hand side of their
residual r and of e, the error of Y'f, W and products with them. With V = M^-1 the forces l* of the answer on C satisfy

    |l - l*| <= |V| (|r| + e),    |(B u - c)_i - (B u* - c)_i| <= e_i + |(W P)_iC| |V| (|r| + e).

Without friction, if forces are positive and gaps open by more than these bounds, l* satisfies the Karush-Kuhn-Tucker
conditions and is the solution, as K is positive definite. With friction, if also friction bounds and slip directions
hold by more than these, l* is an equilibrium, and the only one within the margins of these signs. In space C contains
both tangential rows of sticking contacts, with |l_T| <= mu l_N for both together; slip, whose direction is not a row of
B, is left to `solve`. Where the least eigenvalue w of W for all contacts and ties suffices, |V| x is not formed without
friction: the eigenvalues of W_CC are no smaller, so that no entry of V x exceeds |x|/w.

The influence functions are corrected once. With the relative size q of the correction the remaining error is estimated
as q^2 times ALLOWANCE, as in certificates. A dot product, summed in parts of p numbers and groups of p parts, has an
error of at most (2 p + number of groups) eps/2 of the sum of sizes of its terms.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import Unsupported
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.dense import lower_factor
from contactqp.linalg.extended import Residuals, extend, two_sum
from contactqp.linalg.factorization import fixing_unknowns
from contactqp.linalg.measures import lengths
from contactqp.linalg.runtime import lapack
from contactqp.model.arrays import EPS, TINY, Array, Indices, Vector
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# Binary digits of the first and second slices; with this many entries in a row sums of products have 53 bits.
OF_ROWS, OF_COLUMNS, LONGEST_ROW = (22, 44), (21, 42), 512
# The error of residuals for each entry of a row, in units of the diagonal and of the largest entry of x.
LEFT_OUT = 2.0**-64


class SlicedStiffness:
    """A stiffness (n, n) CSR cut into slices, in units that are powers of two near `unit` (n,), about 1/sqrt(K_jj).

    Raises Unsupported: a row has too many entries.
    """

    def __init__(self, stiffness: Any, unit: Vector) -> None:
        self.longest = int(np.max(np.diff(stiffness.indptr), initial=0))
        if self.longest > LONGEST_ROW:
            raise Unsupported(f"residuals by slices: {self.longest} entries in a row, expected at most {LONGEST_ROW}")
        self._unit = 2.0 ** np.round(np.log2(unit))
        places = stiffness.indices, stiffness.indptr
        scaled = stiffness.data * self._unit[stiffness.indices]
        scaled *= np.repeat(self._unit, np.diff(stiffness.indptr))  # exact, as they are powers of two
        self._slices = [sp.csr_array((data, *places), shape=stiffness.shape) for data in _slices(scaled, OF_ROWS)]

    def residual(self, right: Array, x: Array) -> Array:
        """Return right - K x (n, q) for several x (n, q) at once."""
        y = x / self._unit[:, None]
        size = 2.0 ** np.ceil(np.log2(np.maximum(abs(y).max(axis=0), TINY)))
        x1, x2, x3 = _slices(y / size, OF_COLUMNS)
        K1, K2, K3 = self._slices
        high, low = two_sum(right * self._unit[:, None] / size, -(K1 @ x1))
        left = (high - (K1 @ x2 + K2 @ x1)) + (low - (K1 @ x3 + K2 @ x2 + K3 @ x1))
        return np.asarray(left * size / self._unit[:, None])


def _slices(values: Array, bits: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Return the leading bits of numbers, the following ones, and the rest."""
    first = np.ldexp(np.rint(np.ldexp(values, bits[0])), -bits[0])
    rest = values - first
    second = np.ldexp(np.rint(np.ldexp(rest, bits[1])), -bits[1])
    return first, second, rest - second


def plain_residuals(problem: ContactProblem, answer: Answer) -> Residuals:
    """Return the residuals of an answer in double precision, each to a few dozen roundings of the sizes that meet."""
    u = answer.displacement
    outer = problem.normal.T @ answer.normal_force + problem.tie.T @ answer.tie_force
    if problem.tangent is not None and answer.friction_force is not None:
        outer = outer + problem.tangent.T @ answer.friction_force.ravel()
    force = problem.load - problem.stiffness_rows @ u - outer
    return Residuals(
        extend(force), extend(problem.gap - problem.normal @ u), extend(problem.tie_value - problem.tie @ u)
    )


# The factor on errors estimated from corrections of influence functions, and the largest relative correction.
ALLOWANCE, LARGEST_CORRECTION = 1e4, 1e-6
# The number of influence functions computed at a time. The factors are read once for all of them, and some fifteen
# arrays of their size should not exceed the memory of all functions at the loaded unknowns, unless that is small.
FEWEST, MOST, ARRAYS = 8, 32, 15
# The number of terms of a product in one partial sum.
PART = 64
# The most changes of states for one load, and the number of systems kept.
MOST_SETS, KEPT = 50, 16
# The number of earlier cases from which the nearest one provides the first states.
NEIGHBOURS = 128
# Fractions of the coefficients of friction for continuation if the states are not found directly.
PARTS = (0.25, 0.5, 0.75, 0.9, 1.0)
# Relative errors of forces and gaps up to which a case is accepted, else it is left to `solve`, as are cases with
# margins below `GRAZING`.
PROVEN, GRAZING = 1e-7, 1e-8
# The range of scaled lengths whose products neither underflow nor overflow.
SMALLEST, LARGEST = 1e-100, 1e100
# The largest |I - V M| of an approximate inverse V.
INVERSE_ERROR = 0.1


@dataclass(frozen=True, eq=False)
class ProvenForces:
    """The answer of one load case on its contacts and, behind these, its ties."""

    force: Vector  # (m + k,), normal forces and those of ties
    bound: Vector  # (m + k,) error bounds, with friction of a contact's whole force
    gap: Vector  # (m,)
    status: Status  # (m,) without friction SLIP_ON where closed
    friction_force: Vector | None = None  # (m,) in the plane, (2 m,) in space


class SolvedCases:
    """The states of the last solved cases, by the excess of their rows without contact forces."""

    def __init__(self) -> None:
        self._excess, self._status = np.zeros((0, 0)), list[Status]()
        self._next = 0

    def keep(self, excess: Vector, status: Status) -> None:
        """Keep the states (m,) of a case with its excess (q,), replacing the oldest if there are many."""
        if not self._status:
            self._excess = np.empty((NEIGHBOURS, len(excess)))
        self._excess[self._next] = excess
        self._status[self._next : self._next + 1] = [status]
        self._next = (self._next + 1) % NEIGHBOURS

    def nearest(self, excess: Vector) -> Status | None:
        """Return the states of the case with the nearest excess, None without cases."""
        if not self._status:
            return None
        apart = self._excess[: len(self._status)] - excess
        return self._status[int(np.argmin(np.einsum("ij,ij->i", apart, apart)))]


class Influence:
    """The influence functions of the contacts and ties of a problem that does not float, at the loaded unknowns.

    Parameters
    ----------
    problem, condensation : the problem, whose body is held without contacts, and its Condensation
    loaded : unknowns at which loads may act
    rough : whether contacts have friction
    springs : the number of last ties that `held_by_springs` has put on the unknowns of its springs
    """

    def __init__(
        self, problem: ContactProblem, condensation: Condensation, loaded: Indices, rough: bool, springs: int
    ) -> None:
        operator = condensation.delassus
        stiffness = SlicedStiffness(problem.stiffness_rows, condensation.unknown_scale)
        tangent = problem.tangent if rough and problem.tangent is not None else problem.tie[:0]
        on_retained, response, self._scale = operator.rows, operator.response, operator.row_scale
        self._contacts, self.rough, self.springs, m = problem.contacts, rough, springs, problem.contacts
        self._width = tangent.shape[0] // max(m, 1)
        if rough and condensation.tangent is not None:
            own = condensation.tangent.toarray() * condensation.scale
            on_retained = np.vstack([operator.rows[:m], own, operator.rows[m:]])
            response = operator.solve(on_retained.T)
            compliance = np.einsum("ip,pi->i", on_retained, response)
            self._scale = 1.0 / np.sqrt(np.maximum(compliance, TINY))
            response = response * self._scale
        rows = sp.csr_array(sp.diags(self._scale) @ sp.vstack([problem.normal, tangent, problem.tie]))
        unit, count = condensation.unknown_scale, len(self._scale)
        self._functions, W, largest = np.empty((len(loaded), count)), np.empty((count, count)), np.empty(count)
        correction = 0.0
        at_once = min(MOST, max(FEWEST, count * len(loaded) // (ARRAYS * len(unit))))
        for start in range(0, count, at_once):
            of = slice(start, start + at_once)
            Y = condensation.responses(condensation.scale[:, None] * response[:, of])
            change = condensation.free_displacements(stiffness.residual(rows[of].T.toarray(), Y))
            Y += change
            self._functions[:, of], W[:, of] = Y[loaded], rows @ Y
            largest[of] = np.max(abs(Y) / unit[:, None], axis=0)
            correction = max(correction, float(np.max(abs(change) / (unit[:, None] * largest[of]))))
        self.accurate = bool(correction <= LARGEST_CORRECTION and np.all(np.isfinite(largest)))
        self._W = (W + W.T) / 2
        self._W[count - springs :, count - springs :] = 0.0
        # Scaled friction of a contact in units of its scaled normal force.
        self._along = self._scale[self._tangents].reshape(m, self._width) / self._scale[:m, None]
        self._definite = not (rough or springs)
        # Errors of Y'f are this times D'|f|; those of W_ij the product of row i's and column j's.
        refined = EPS + ALLOWANCE * correction**2 + stiffness.longest * LEFT_OUT / EPS * correction
        terms, longest = 2 * PART + len(loaded) // PART**2 + 2, int(np.max(np.diff(rows.indptr), initial=0))
        self._unit, self._of_load = unit[loaded], (refined + EPS / 2 * terms) * largest
        self._of_column, self._of_row = (refined + EPS * longest) * largest, abs(rows) @ unit
        self._least_eigenvalue = self._bounded_eigenvalue() if self._definite else 0.0
        self._systems: dict[bytes, _System | None] = {}

    def free(self, loads: Any) -> tuple[Array, Vector]:
        """Return Y'f, scaled, a row for each of some loads at the loaded unknowns, and the size D'|f| of each load."""
        found = np.zeros((loads.shape[0], len(self._scale)))
        for first in range(0, len(self._unit), PART**2):
            group = np.zeros_like(found)
            for start in range(first, min(first + PART**2, len(self._unit)), PART):
                group += loads[:, start : start + PART] @ self._functions[start : start + PART]
            found += group
        return found, np.asarray(abs(loads) @ self._unit)

    def excess(self, free: Vector, limit: Vector) -> Vector:
        """Return the excess of rows over their limits without contact and tie forces, scaled (q,)."""
        return np.asarray(free - self._scale * limit)

    def forces(self, free: Vector, size: float, limit: Vector, status: Status, friction: Vector) -> ProvenForces | None:
        """Return the proven forces of a load, None if it is left to `solve`.

        Parameters
        ----------
        free, size : (q,) array and float
            What `free` returns of the load.
        limit : (q,) array
            Gaps, with friction slip origins, and tie values.
        status : (m,) array of int
            The states to begin with; without friction SLIP_ON stands for closed.
        friction : (m,) array
            Coefficients of friction, which count where there is any.
        """
        length = self._scale * limit
        m, tangents = self._contacts, self._tangents
        ratio = friction if self.rough else np.zeros(m)
        found = self._in_own_states(free - length, status, ratio)
        for part in PARTS if found is None and self._width == 1 else ():
            found = self._in_own_states(free - length, status, part * ratio)
            if found is None:
                return None
            status = found[0].status
        if found is None:
            return None
        system, x, slack = found
        members, pushing, terms = system.members, abs(system.spread(x)), abs(free) + abs(length)
        error = self._of_load * size + EPS * (len(members) + 6) * (terms + pushing.sum())
        error += self._of_row * (self._of_column @ pushing) + self._of_column * (self._of_row @ pushing)
        off = abs(slack[members]) + error[members]
        largest = max(float(terms.max(initial=0.0)), float(pushing.max(initial=0.0)))
        if not SMALLEST < largest < LARGEST:
            return None
        bound = np.full(len(members), np.inf)
        if self._definite:
            bound[:] = np.linalg.norm(off) / self._least_eigenvalue
        if bound.max(initial=0.0) > PROVEN * pushing.max(initial=0.0):
            bound = system.bounded(off)
        of_force = system.spread(bound, sizes=True)
        of_length = error + abs(self._W) @ of_force
        holds = self._margins(system, x, slack, (bound, of_length)) > GRAZING * largest
        accurate = bound.max(initial=0.0) <= PROVEN * pushing.max(initial=0.0) and of_length.max() <= PROVEN * largest
        if not (holds.all() and accurate):
            return None
        force, bounds = system.spread(x) * self._scale, of_force * self._scale
        gap = np.where(system.status != OPEN, 0.0, slack[:m] / self._scale[:m])
        own = np.r_[0:m, tangents.stop : len(force)]
        if not self.rough:
            return ProvenForces(force, bounds, gap, system.status)
        bounds[:m] = lengths(np.column_stack([bounds[:m], bounds[tangents].reshape(m, self._width)]))
        return ProvenForces(force[own], bounds[own], gap, system.status, force[tangents])

    @property
    def _tangents(self) -> slice:
        """Return the indices of tangential rows, none without friction."""
        m = self._contacts
        return slice(m, m + self._width * m)

    def _margins(self, system: _System, x: Vector, slack: Vector, bounds: tuple[Vector, Vector]) -> Vector:
        """Return the margin of each sign of some states beyond its error."""
        m, status, (of_force, of_length) = self._contacts, system.status, bounds
        push, of_push = np.zeros(m), np.zeros(m)
        closed, stuck = system.closed, system.stuck
        push[closed], of_push[closed] = x[: len(closed)], of_force[: len(closed)]
        margins = [(push - of_push)[closed], (slack - of_length)[:m][status == OPEN]]
        if self.rough:
            drag, of_drag = (self._dragged(system, part) for part in (x, of_force))
            margins += [system.friction[stuck] * (push - of_push)[stuck] - drag - of_drag]
            slips = np.flatnonzero((abs(status) == 1) & (system.friction > 0))
            margins += [(-status[slips] * slack[m + slips]) - of_length[m + slips]]
        return np.concatenate(margins)

    def _dragged(self, system: _System, x: Vector) -> Vector:
        """Return the sizes of the friction forces of contacts that stick, in units of their normal forces."""
        first = len(system.closed)
        drag = x[first : first + self._width * len(system.stuck)].reshape(-1, self._width)
        return lengths(drag * self._along[system.stuck])

    def _bounded_eigenvalue(self) -> float:
        """Return a lower bound of the eigenvalues of the true W, nearly zero if none is known."""
        from scipy.linalg import eigvalsh

        values = eigvalsh(self._W, check_finite=False) if self.accurate else np.zeros(1)
        rounding = 8 * len(self._W) * EPS * values[-1]  # errors of LAPACK's eigenvalues and of the symmetry of W
        missing = 2 * np.linalg.norm(self._of_row) * np.linalg.norm(self._of_column)
        return max(float(values[0] - rounding - missing), TINY)

    def _in_own_states(self, excess: Vector, status: Status, friction: Vector) -> tuple[_System, Vector, Vector] | None:
        """Return the system of the states for a load, its forces, and gaps, slips (signed) and residuals of ties.

        The states are corrected by signs (Newton's method for the law) until they are constant or recur. In space
        closed contacts with friction stick; None if one would slip.
        """
        m, tried = self._contacts, set[bytes]()
        for _ in range(MOST_SETS):
            if status.tobytes() in tried or (system := self._system(status, friction)) is None:
                return None
            tried.add(status.tobytes())
            x = system.solve(excess[system.members])
            slack = self._W @ system.spread(x) - excess
            following = np.full(m, OPEN, dtype=np.int8)
            closed, stuck = system.closed, system.stuck
            closes = slack[:m] < 0
            closes[closed] = x[: len(closed)] > 0
            beyond = (
                self._dragged(system, x) > friction[stuck] * x[np.searchsorted(closed, stuck)] if self.rough else ()
            )
            if not self.rough:
                following[closes] = SLIP_ON
            elif self._width > 1:
                following[closes] = np.where(friction > 0, STICK, SLIP_ON)[closes]
                if np.array_equal(following, status) and np.any(beyond):
                    return None
            else:
                slip = -slack[self._tangents]
                kept = np.where(status == OPEN, np.where(slip < 0, SLIP_BACK, SLIP_ON), status)
                kept[(abs(status) == 1) & (status * slip < 0)] = STICK
                drag = x[len(closed) : len(closed) + len(stuck)]
                kept[stuck[beyond]] = np.where(drag[beyond] > 0, SLIP_ON, SLIP_BACK)
                kept[friction == 0] = SLIP_ON
                following[closes] = kept[closes]
            if np.array_equal(following, status):
                return system, x, slack
            status = following
        return None

    def _system(self, status: Status, friction: Vector) -> _System | None:
        """Return the system of some states, None if it is singular."""
        key = status.tobytes() + (friction.tobytes() if self.rough else b"")
        if key not in self._systems:
            if len(self._systems) >= KEPT:
                self._systems.pop(next(iter(self._systems)))
            errors = self._of_row, self._of_column
            ratio = friction / self._along[:, 0] if self._width == 1 else np.zeros(self._contacts)
            system = _System(self._W, status, friction, ratio, self._tangents, errors, self._definite)
            self._systems[key] = system if system.regular else None
        return self._systems[key]


def held_by_springs(problem: ContactProblem, motions: Array) -> ContactProblem:
    """Return a floating problem on springs, with a tie of value zero for the unknown of each behind its own ties.

    A spring k on unknown j adds k u_j to its forces, and a force p along j takes it away if p = -k u_j, that is, if

        0 = e_j'u + p / k = (Y'f)_j - (W l)_j + p_j / k,

    Y, W and l those of the problem on springs, p among the forces l: an equation as that of a tie, in which W_jj is
    less by 1 / k. With as many springs as rigid `motions` (n, r), their W vanishes: a unit force on one of them moves
    the bodies rigidly by 1 / k. With k = K_jj the sum K_jj + k has no rounding.
    """
    places = fixing_unknowns(motions, np.zeros(0, dtype=np.intp), problem.diagonal)
    own = sp.csr_array((np.ones(len(places)), (np.arange(len(places)), places)), shape=(len(places), problem.dimension))
    K = sp.csr_array(problem.stiffness_rows + own.T @ sp.diags(problem.diagonal[places]) @ own)
    ties, values = sp.vstack([problem.tie, own]), np.concatenate([problem.tie_value, np.zeros(len(places))])
    return problem.replace(stiffness=K, near_null_space=None, tie=ties, tie_value=values)


class _System:
    """The linear system of the forces in one combination of states, factorised.

    Parameters
    ----------
    W : (q, q) array, scaled
    status : (m,) array of int
    friction, ratio : (m,) arrays, coefficients of friction, and in the plane these in scaled forces
    tangents : slice, the places of tangential rows
    errors : what each row and each column contributes to the errors of W
    definite : whether all such systems are positive definite
    """

    def __init__(
        self,
        W: Array,
        status: Status,
        friction: Vector,
        ratio: Vector,
        tangents: slice,
        errors: tuple[Vector, Vector],
        definite: bool,
    ) -> None:
        self.status, self.friction, self._count = status, friction, len(W)
        rough = tangents.stop > tangents.start
        width = (tangents.stop - tangents.start) // max(len(status), 1)
        self.closed = np.flatnonzero(status != OPEN)
        self.stuck = np.flatnonzero(status == STICK) if rough else np.zeros(0, dtype=np.intp)
        along = (tangents.start + width * self.stuck[:, None] + np.arange(width)).ravel()
        self.members = np.concatenate([self.closed, along, np.arange(tangents.stop, len(W))])
        self._slips = np.flatnonzero(abs(status) == 1) if width == 1 else np.zeros(0, dtype=np.intp)
        self._slip_rows, self._of_slips = tangents.start + self._slips, np.searchsorted(self.closed, self._slips)
        self._dragged = (status * ratio)[self._slips]
        self._rows, self._columns = ([part[self.members] for part in errors] for _ in range(2))
        self._matrix = W[np.ix_(self.members, self.members)]
        self._matrix[:, self._of_slips] += W[np.ix_(self.members, self._slip_rows)] * self._dragged
        for part, whole in zip(self._columns, errors, strict=True):
            part[self._of_slips] += abs(self._dragged) * whole[self._slip_rows]
        self._symmetric = definite
        if not definite:
            # LAPACK prints an error for a matrix without rows.
            found: tuple[Any, ...] = lapack().dgetrf(self._matrix) if len(self.members) else (0,)
            self._factor, self.regular = list(found[:-1]), found[-1] == 0
        else:
            factor = lower_factor(self._matrix)
            self._factor, self.regular = [factor], factor is not None

    def solve(self, right: Array) -> Array:
        if not len(right):
            return right
        if self._symmetric:
            return np.asarray(lapack().dpotrs(self._factor[0], right, lower=True)[0])
        return np.asarray(lapack().dgetrs(*self._factor, right)[0])

    def spread(self, x: Vector, sizes: bool = False) -> Vector:
        """Return all forces (q,), or their errors, from those of the members."""
        found = np.zeros(self._count)
        found[self.members] = x
        found[self._slip_rows] = (abs(self._dragged) if sizes else self._dragged) * x[self._of_slips]
        return found

    def bounded(self, size: Vector) -> Vector:
        """Return bounds of M^-1 x for all |x| <= size, infinite if the inverse is unknown."""
        sizes, missing = self._inverse
        if not missing < INVERSE_ERROR:
            return np.full(len(size), np.inf)
        found = sizes @ size
        return np.asarray(found + missing / (1 - missing) * found.max(initial=0.0))

    @cached_property
    def _inverse(self) -> tuple[Any, float]:
        """Return |V| of the inverse in doubles and q >= |I - V M|, including the errors of M."""
        count = len(self.members)
        if not count:
            return np.zeros((0, 0)), 0.0
        V = self.solve(np.eye(count))
        sizes = abs(V)
        missing = abs(np.eye(count) - V @ self._matrix).sum(axis=1)
        missing += EPS * (count + 2) * (sizes @ abs(self._matrix)).sum(axis=1)
        of_row, of_column = self._columns
        missing += (sizes @ self._rows[0]) * of_column.sum() + (sizes @ self._rows[1]) * of_row.sum()
        return sizes, float(missing.max())
