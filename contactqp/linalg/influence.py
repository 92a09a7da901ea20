"""Residuals by plain products, in double precision or beyond it, and the influence functions that they correct.

Residuals of many right-hand sides at once are formed to some digits beyond it by products without rounding. Ozaki,
Ogita, Oishi, Rump (2012), Numer. Algorithms 59: numbers are cut into slices of so few bits that sums of products of
slices are doubles,

    K x = K1 x1 + (K1 x2 + K2 x1) + (K1 x3 + K2 x2 + K3 x1) + rest,    |rest| <= 2^-65 |K| max|x| for each entry of K,

in the units in which the diagonal of K is about one. Each product is a plain one of sparse and dense matrices: a
residual takes as long as six of these, a tenth of one in twice double precision.

Let B = [E_N; E_T; A] be the rows of contacts and ties, E_T there with friction alone, Y = K^-1 B' their influence
functions, the displacements under unit forces along them, and W = B Y. Of a load f within the limits c = (g, o, b)

    B u - c = Y'f - c - W l

in which no unknown but those of contacts appears. Rows are scaled so that W_ii = 1, and lengths and forces with them.
Without friction the forces of the closed contacts and ties C solve W_CC l_C = (Y'f - c)_C; with friction in the plane C
holds the slips of contacts that stick, too, and the friction of one that slips is mu t l_N, t = +-1: l = P l_C, and

    (W P)_CC l_C = (Y'f - c)_C.

Every answer is proven. The forces computed for C solve a system M whose right-hand side is off by their residual r and
by e, the error of Y'f, of W and of the products with them. With V = M^-1 the forces l* of the answer on C satisfy

    |l - l*| <= |V| (|r| + e),    |(B u - c)_i - (B u* - c)_i| <= e_i + |(W P)_iC| |V| (|r| + e).

Without friction, where forces are positive and gaps open by more than these bounds, l* meets the conditions of Karush,
Kuhn and Tucker: K being positive definite, it is the solution. With friction, where also friction is within its bound
and slips go where they should by more than these, l* meets Coulomb's law: it is an equilibrium, and the only one nearer
than what these signs hold by. In space C holds both slips of contacts that stick, and |l_T| <= mu l_N is asked of the
two forces together; what slips does so in a direction that is no row of B, and is left to `solve`. Where the least
eigenvalue w of W for all contacts and ties tells enough, |V| x is not formed without friction: the eigenvalues of W_CC
are not less, so that no entry of V x exceeds |x|/w.

The influence functions are corrected once. The size q of the correction, relative to the functions, tells that of what
is left, q^2, and ALLOWANCE times as much is counted, as it is in certificates. A product of vectors, added up in parts
of p numbers and these in groups of p, is off by at most (2 p + number of groups) eps/2 of the sum of its terms' sizes.
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
from contactqp.linalg.extended import Extended, Residuals, extend, two_sum
from contactqp.linalg.factorization import fixing_unknowns
from contactqp.linalg.measures import lengths
from contactqp.linalg.runtime import lapack
from contactqp.model.arrays import EPS, TINY, Array, Indices, Vector
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# Bits behind the point of the first and second slices; with so many entries in a row sums of products have 53 bits.
OF_ROWS, OF_COLUMNS, LONGEST_ROW = (22, 44), (21, 42), 512
# What residuals may be off by, in the units of the diagonal and of the largest entry of x, for each entry of a row.
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
        scaled *= np.repeat(self._unit, np.diff(stiffness.indptr))  # all of it exact: they are powers of two
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
    """Return the leading bits of numbers, the following ones, and what is left."""
    first = np.ldexp(np.rint(np.ldexp(values, bits[0])), -bits[0])
    rest = values - first
    second = np.ldexp(np.rint(np.ldexp(rest, bits[1])), -bits[1])
    return first, second, rest - second


# A change of the displacement whose |K||du| is nowhere more than this part of |K||u| changes K u by a product in double
# precision, of which rounding leaves 2^-101 |K||u|.
SLIGHT = 2.0**-48


def elastic_after(problem: ContactProblem, displacement: Vector, elastic: Extended, change: Vector) -> Extended | None:
    """Return K (u + du) after a slight change of u; None if it is not slight.

    Parameters
    ----------
    problem : ContactProblem
    displacement : (n,) array [length], u
    elastic : Extended (n,), K u [force]
    change : (n,) array [length], du
    """
    sizes = problem.stiffness_sizes
    if not (sizes @ abs(change) <= SLIGHT * (sizes @ abs(displacement))).all():
        return None
    added: Vector = problem.stiffness_rows @ change
    return elastic + added


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


# What corrections of influence functions tell of their errors is counted so many times; corrections larger than a part
# of the functions tell nothing.
ALLOWANCE, LARGEST_CORRECTION = 1e4, 1e-6
# Influence functions at once: factors are read once for all of them, and some fifteen arrays of their size are there
# for a while, which should not take more than all functions at the loaded unknowns, unless that is next to nothing.
FEWEST, MOST, ARRAYS = 8, 32, 15
# Terms of a product that are added up by themselves.
PART = 64
# Corrections of the states of contacts for one load, at most, and states whose systems are kept.
MOST_SETS, KEPT = 50, 16
# Cases among which that of the nearest loads is looked for, whose states a case begins with.
NEIGHBOURS = 128
# Parts of the coefficients of friction by which states are come to where they are not found at once.
PARTS = (0.25, 0.5, 0.75, 0.9, 1.0)
# Forces are proven to this part of the largest, gaps to this part of the largest length, or left to `solve`; so is what
# is nearer than `GRAZING` of these to other states.
PROVEN, GRAZING = 1e-7, 1e-8
# Lengths, scaled, whose products neither underflow nor overflow.
SMALLEST, LARGEST = 1e-100, 1e100
# An inverse is known to be near where what is missing of it is less than this.
NEAR = 0.1


@dataclass(frozen=True, eq=False)
class ProvenForces:
    """The answer of one load case on its contacts and, behind these, its ties."""

    force: Vector  # (m + k,), normal forces and those of ties
    bound: Vector  # (m + k,) of the error of each, with friction of the whole force of a contact
    gap: Vector  # (m,)
    status: Status  # (m,) without friction SLIP_ON where closed
    friction_force: Vector | None = None  # (m,) in the plane, (2 m,) in space


class SolvedCases:
    """The last cases that were solved, by what their rows exceed their limits without forces, and their states."""

    def __init__(self) -> None:
        self._excess, self._status = np.zeros((0, 0)), list[Status]()
        self._next = 0

    def keep(self, excess: Vector, status: Status) -> None:
        """Keep the states (m,) of a case with some excess (q,), in place of the oldest where there are many."""
        if not self._status:
            self._excess = np.empty((NEIGHBOURS, len(excess)))
        self._excess[self._next] = excess
        self._status[self._next : self._next + 1] = [status]
        self._next = (self._next + 1) % NEIGHBOURS

    def nearest(self, excess: Vector) -> Status | None:
        """Return the states of the case whose excess is nearest; None where there is no case."""
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
        """Return by how much rows exceed their limits without forces of contacts and ties, scaled (q,)."""
        return np.asarray(free - self._scale * limit)

    def forces(self, free: Vector, size: float, limit: Vector, status: Status, friction: Vector) -> ProvenForces | None:
        """Return the proven forces of a load, or None where it is left to `solve`.

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
        """Return the places of tangential rows, none without friction."""
        m = self._contacts
        return slice(m, m + self._width * m)

    def _margins(self, system: _System, x: Vector, slack: Vector, bounds: tuple[Vector, Vector]) -> Vector:
        """Return by how much more than its error each sign of some states holds."""
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
        """Return a number that no eigenvalue of the true W is less than, next to nothing where none is known."""
        from scipy.linalg import eigvalsh

        values = eigvalsh(self._W, check_finite=False) if self.accurate else np.zeros(1)
        rounding = 8 * len(self._W) * EPS * values[-1]  # of LAPACK's eigenvalues, and of W's two halves
        missing = 2 * np.linalg.norm(self._of_row) * np.linalg.norm(self._of_column)
        return max(float(values[0] - rounding - missing), TINY)

    def _in_own_states(self, excess: Vector, status: Status, friction: Vector) -> tuple[_System, Vector, Vector] | None:
        """Return the system of the states that a load leads to, its forces, and gaps, slips (turned) and ties' misses.

        The states are corrected as signs say (Newton's method for the law), until they stay, or come again. In space
        closed contacts with friction stick; None where one would slip then.
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
        """Return the system of some states; None where it has no inverse."""
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
    less by 1 / k. As many springs as there are rigid `motions` (n, r) leave nothing of W among them: a unit force on
    one of them moves the bodies rigidly by 1 / k. With k = K_jj the sum K_jj + k has no rounding.
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
            # LAPACK prints that a matrix of no rows is none of its.
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
        """Return all forces (q,) from those of the members, or what these may be off by."""
        found = np.zeros(self._count)
        found[self.members] = x
        found[self._slip_rows] = (abs(self._dragged) if sizes else self._dragged) * x[self._of_slips]
        return found

    def bounded(self, size: Vector) -> Vector:
        """Return bounds of M^-1 x for all |x| <= size, infinite where the inverse is not known."""
        sizes, missing = self._inverse
        if not missing < NEAR:
            return np.full(len(size), np.inf)
        found = sizes @ size
        return np.asarray(found + missing / (1 - missing) * found.max(initial=0.0))

    @cached_property
    def _inverse(self) -> tuple[Any, float]:
        """|V| of the inverse in doubles and q >= |I - V M|, the errors of M included."""
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
