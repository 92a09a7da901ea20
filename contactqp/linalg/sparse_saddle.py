"""Solve sparse saddle-point systems with closed contacts and ties, where these are too many for condensation.

    [ K    E_C'  A' ] [ u  ]   [ f   ]
    [ E_C           ] [ l  ] = [ g_C ]
    [ A             ] [ nu ]   [ b   ]

The matrix is factorised with +d and -d added to its diagonal. That makes it quasi-definite: L D L' exists in any order
of elimination (Vanderbei 1995), also for singular K and dependent rows. Residuals in extended precision remove the
effect of d: every sweep is a step of the proximal method of multipliers (Rockafellar 1976), which converges to a
solution if there is one. If unknowns or multipliers are not unique it is the solution near the start, so that the
positive multipliers of an interior point stay positive and no basis has to be chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed
from contactqp.linalg import pardiso
from contactqp.linalg.equilibration import least_length, rows_alone
from contactqp.linalg.extended import Extended, ExtendedAnswer, Residuals, extended_rows, residuals_of
from contactqp.linalg.factorization import with_added_diagonal
from contactqp.linalg.influence import plain_residuals
from contactqp.linalg.krylov import uncoupled
from contactqp.linalg.measures import outer_forces, row_sizes
from contactqp.linalg.schur import LARGE, OF_RANK, PivotedSaddle, RankedSaddle, factorised
from contactqp.model.arrays import TINY, Indices, Mask, Vector, refuse_late
from contactqp.model.problem import ContactProblem

# Values of d, for entries of at most one, tried from the largest, which has the least rounding. The next one is used if
# sweeps contract too slowly, as with nearly dependent rows.
REGULARISATIONS = (1e-7, 1e-9, 1e-11, 1e-13)
# For narrow bands, factorised with row exchanges, the last one is used directly if the first contracts too slowly.
BETWEEN = REGULARISATIONS[1:-1]
# Up to this part of unknowns fixed by closed contacts, eliminating these, too, is cheaper than another analysis.
FEW_FIXED = 0.2
# The residual at which no smaller d is tried, and the reduction that a smaller d must achieve.
FINE, WORTH_ANOTHER = 1e-22, 0.1
GROWS = 4.0  # a sweep has failed if the larger residual grows by more than this
# Parts of K, one small beside rows that nearly depend on each other, with springs; how often they are tried in vain.
SMALL_STIFFNESS, MOST_IN_VAIN = ((1e-4, 0.0), (1e-8, 0.0), (1e-12, 0.0), (1e-4, 1e-6)), 3
MET_TOGETHER = 1e-20  # closed contacts and ties met to this part of the largest length do not contradict each other
# Sweeps of one factorisation, and the part of the residual that one must take away to be followed by another.
SWEEPS, CONTRACTS = 20, 0.3
# After one that leaves more than this part none follows; two in turn end them where they leave more than CONTRACTS.
CREEPS = 0.5
# Corrections in doubles before residuals in extended precision: they come near to what rounding of doubles leaves.
CORRECTIONS = 2
# Residuals above this part of the forces and lengths that meet have half of their digits in doubles: as many as a
# correction needs that is refined in doubles.
HALF_OF_THE_DIGITS = 1e-8
SOLVED = 2.0**-88  # residuals below this part of the forces and lengths that meet are rounding in extended precision
MET = 1e-14  # rows with residuals above this part of the largest length are not satisfied, as they conflict
# The same relative to acting forces and imposed lengths, which may be smaller.
MET_BESIDE_IMPOSED = 1e-10
NEARLY_MET = 1e-6  # rows with residuals above this part of the largest length contradict each other
# Forces and lengths below this part of the largest have no sign, as their error is about 1e-28 of it.
SIGNED = 1e-20
NO_FORCE = 1e-12  # forces below this part of those that cause the lengths that meet count as zero
BALANCED = 1e-20  # forces balanced to this part of those that meet belong to a solution
NEARLY_BALANCED = 1e-7  # residuals above this part of the forces that meet are not due to a backend's tolerance
# Changes of the set of closed contacts that leave no fewer contacts wrong, before it is given up; and where more than
# FEW_WRONG of them are, before another backend is asked, whose answer may be nearer.
WASTED, WASTED_AT_FIRST, FEW_WRONG = 25, 6, 10
# The most factorisations for the answer of one backend before another one is run.
SYSTEMS_AT_FIRST = 150
# Contacts that close one by one along a motion that nothing resists, and the part of the fastest approach that is none.
BLOCKING, STANDS_STILL = 50, 1e-9


class SparseSaddle:
    """The factorised, regularised saddle point of closed contacts and all ties of an equilibrated problem.

    Parameters
    ----------
    problem : ContactProblem, equilibrated: entries of K and the rows are at most about one
    closed : (c,) array of int, the closed contacts
    regularisation : float, d, added to the diagonal of K and subtracted from the zeros below it
    """

    def __init__(self, problem: ContactProblem, closed: Indices, regularisation: float) -> None:
        self.regularisation = regularisation
        self._K = sp.csr_matrix(problem.stiffness_rows)
        self._rows = sp.csr_matrix(sp.vstack([problem.normal[closed], problem.tie]))
        self._contacts = len(closed)
        self._fixing, self._fixed = rows_alone(self._rows)
        self._entries = self._rows.data[self._rows.indptr[self._fixing]]
        self._left = np.delete(np.arange(self._rows.shape[0]), self._fixing)
        order = pardiso.elimination_order(problem)
        self.factors = None if self._left.size else self._in_the_pattern_of_stiffness(order, regularisation)
        if self.factors is not None:
            self._free = np.arange(problem.dimension)
            self._factor: Callable[[Vector], Vector] = self.factors.solve_all
            return
        self._free = np.delete(np.arange(problem.dimension), self._fixed)
        rows = self._rows[self._left][:, self._free]
        stiffness = self._K[self._free][:, self._free] if self._fixed.size else self._K
        if (solve := uncoupled(stiffness, rows, regularisation)) is not None:
            self._factor = solve
            return
        upper = with_added_diagonal(stiffness, np.full(len(self._free), regularisation))
        lower = -regularisation * sp.identity(rows.shape[0])
        matrix = sp.bmat([[upper, rows.T], [rows, lower]], format="csc") if rows.shape[0] else upper.tocsc()
        kind = pardiso.INDEFINITE if rows.shape[0] else pardiso.POSITIVE_DEFINITE
        self._factor = factorised(matrix, kind, order, self._free)

    def _in_the_pattern_of_stiffness(
        self, order: pardiso.EliminationOrder, regularisation: float
    ) -> pardiso.Pardiso | None:
        """Return the factors of K with the rows and columns of fixed unknowns replaced by those of the identity.

        They have the pattern of K, whose factors for the certificate then need no further analysis. None if so many
        unknowns are fixed that leaving them out is cheaper, or if PARDISO is not used.
        """
        n, fixed = self._K.shape[0], np.zeros(self._K.shape[0], dtype=bool)
        if not (n > LARGE and pardiso.available() and len(self._fixed) <= FEW_FIXED * n):
            return None
        fixed[self._fixed] = True
        lifted = with_added_diagonal(self._K, np.full(n, regularisation))
        rows = np.repeat(np.arange(n), np.diff(lifted.indptr))
        lifted.data[fixed[rows] | fixed[lifted.indices]] = 0.0
        lifted.data[fixed[rows] & (lifted.indices == rows)] = 1.0
        try:
            return order.factorised(lifted, np.arange(n))
        except pardiso.NotPositive:
            return None

    def solve(self, force: Vector, gap: Vector, tie: Vector) -> tuple[Vector, Vector, Vector]:
        """Return u (n,), l (c,) and nu (k,) of the regularised system with this right-hand side."""
        lengths = np.concatenate([gap, tie])
        u, carried = np.zeros(len(force)), np.zeros(len(lengths))
        u[self._fixed] = lengths[self._fixing] / self._entries
        if self._fixed.size:
            force, lengths = force - self._K @ u, lengths - self._rows @ u
        right, moved = force[self._free], np.zeros(len(force))
        if self.factors is not None:
            right[self._fixed] = 0.0
        found = self._factor(np.concatenate([right, lengths[self._left]]))
        moved[self._free], carried[self._left] = np.split(found, [len(self._free)])
        if self._fixed.size:
            left = force - self._K @ moved - self._rows.T @ carried
            carried[self._fixing] = left[self._fixed] / self._entries
        u += moved
        return u, carried[: self._contacts], carried[self._contacts :]

    def correction(self, force: Vector, gap: Vector, tie: Vector) -> tuple[Vector, Vector, Vector, int]:
        """Return corrections of u, l and nu for residuals, refined in double precision, and the back-substitutions."""
        *_, (solved, found) = enumerate(islice(self.refined(force, gap, tie), 1 + CORRECTIONS), 1)
        return *found[:-1], solved

    def refined(self, force: Vector, gap: Vector, tie: Vector) -> Iterator[tuple[Vector, Vector, Vector, float]]:
        """Yield u, l and nu, and with each the residual that it meets, as long as these contract in doubles.

        Residuals in doubles cost a small part of those in extended precision and are as good for the first digits.
        """
        lengths = np.concatenate([gap, tie])
        left, u, carried, size, last = (force, lengths), np.zeros(len(force)), np.zeros(len(lengths)), 0.0, np.inf
        while size < CONTRACTS * last:
            last = max(float(abs(part).max(initial=0.0)) for part in left)
            du, dl, dn = self.solve(left[0], *np.split(left[1], [self._contacts]))
            u, carried = u + du, carried + np.concatenate([dl, dn])
            yield u, carried[: self._contacts], carried[self._contacts :], last
            left = force - self._K @ u - self._rows.T @ carried, lengths - self._rows @ u
            size = max(float(abs(part).max(initial=0.0)) for part in left)


@dataclass
class Effort:
    """The number of factorisations and back-substitutions of saddle points so far, with their limits.

    `wasted` changes of the closed contacts may leave no fewer of them wrong, and `most` factorisations are made; `cut`
    says that one was not made for either reason. `pivots` says whether rows not met together get factors with pivots,
    in vain `in_vain` times, `ranked` whether dense ones tell their rank. `changed`, `singles` and `corrected` count
    contacts that changed one by one in primal and dual active sets and in corrections. `first` was added to the
    diagonal where sweeps met a set of contacts.
    """

    factorisations: int = 0
    back_substitutions: int = 0
    wasted: int = WASTED
    most: float = np.inf
    cut: bool = False
    pivots: bool = False
    ranked: bool = False
    changed: int = 0
    singles: int = 0
    corrected: int = 0
    in_vain: int = 0
    first: float = REGULARISATIONS[0]

    def exhausted(self) -> bool:
        """Return whether no more factorisations may be made, and note in `cut` that one was wanted."""
        at_end = self.factorisations >= self.most
        self.cut |= at_end
        return at_end


@dataclass(frozen=True, eq=False)
class ClosedState:
    """An answer with some contacts closed and zero forces on the others, with its residuals.

    Attributes
    ----------
    problem : the equilibrated problem, in whose units everything here is
    closed : (m,) array of bool, the closed contacts
    answer, left : ExtendedAnswer, Residuals
    force, length : the largest force that meets at an unknown, the largest length
    force_residual, length_residual : float
        The worst residual of equilibrium, and of closed contacts and ties, relative to these.
    unmet : float
        The larger of them relative to acting forces, those of load and stiffness, and to lengths imposed or caused by
        loads and those of the row (if no rounding), so that no self-equilibrated force or diverging unknown hides it.
    in_conflict : bool, whether the search for a vertex without conflicting contacts has failed
    """

    problem: ContactProblem
    closed: Mask
    answer: ExtendedAnswer
    left: Residuals
    force: float
    length: float
    force_residual: float
    length_residual: float
    unmet: float
    in_conflict: bool = False

    @classmethod
    def started(cls, problem: ContactProblem, closed: Mask, answer: ExtendedAnswer) -> ClosedState:
        """Return the state of an answer as a start; far from a solution its residuals are formed in doubles."""
        state = cls.of(problem, closed, answer, plain=True)
        return state if state.residual > HALF_OF_THE_DIGITS else cls.of(problem, closed, answer)

    @classmethod
    def of(cls, problem: ContactProblem, closed: Mask, answer: ExtendedAnswer, plain: bool = False) -> ClosedState:
        """Return the state of an answer, without forces on open contacts.

        Parameters
        ----------
        problem, closed, answer : ContactProblem, (m,) mask, ExtendedAnswer
        plain : bool, whether residuals are formed in doubles
        """
        force = answer.normal_force
        force = Extended(np.where(closed, force.hi, 0.0), np.where(closed, force.lo, 0.0))
        answer = ExtendedAnswer(answer.displacement, force, None, answer.tie_force)
        doubles = answer.double()
        left = plain_residuals(problem, doubles) if plain else residuals_of(extended_rows(problem), problem, answer)
        u = abs(doubles.displacement)
        strain = problem.stiffness_sizes @ u
        forces = strain + outer_forces(problem, doubles)
        lengths = row_sizes(problem, problem.normal).lengths(u) + abs(problem.gap)
        own = np.append(lengths[closed], row_sizes(problem, problem.tie).lengths(u) + abs(problem.tie_value))
        longest = max(*(float(values.max(initial=0.0)) for values in (u, own)), least_length(problem, closed))
        # Without acting forces, those that would cause the lengths that meet.
        largest = max(float(forces.max(initial=0.0)), NO_FORCE * longest)
        force_left, gap, open_tie = left.double(np.flatnonzero(closed))
        missed, unbalanced = abs(np.append(gap, open_tie)), float(abs(force_left).max(initial=0.0))
        unmet = float(missed.max(initial=0.0))
        acting = max(float(strain.max(initial=0.0)), float(problem.load_size.max(initial=0.0)))
        given = float(abs(np.append(problem.gap[closed], problem.tie_value)).max(initial=0.0))
        caused = float(problem.load_size[problem.diagonal > 0].max(initial=0.0))  # by stiffnesses of at most about one
        imposed = max(given, caused) if given > 0 else longest
        hidden = max(_part(unbalanced, max(acting, NO_FORCE * longest)), _part(unmet, imposed))
        own, beyond = np.maximum(own, u[problem.diagonal > 0].max(initial=TINY)), missed > FINE * longest
        hidden = max(hidden, float((missed / own)[beyond & (own > MET * imposed)].max(initial=0.0)))
        parts = _part(unbalanced, largest), _part(unmet, longest), hidden
        return cls(problem, closed, answer, left, largest, longest, *parts)

    @property
    def residual(self) -> float:
        """Return the larger of the two relative residuals."""
        return max(self.force_residual, self.length_residual)

    def better_than(self, before: ClosedState, part: float = 1.0) -> bool:
        """Return whether one residual has fallen below a part of its earlier value and the larger has not grown.

        A sweep may reduce one of them while rounding of the data keeps the other. Both are relative to the smaller
        force and length of the two states, so that diverging unknowns do not count as progress.
        """
        force, length = min(self.force, before.force), min(self.length, before.length)
        own, last = (
            (_part(s.force_residual * s.force, force), _part(s.length_residual * s.length, length))
            for s in (self, before)
        )
        if max(own) < part * max(last):
            return True
        product, earlier = (max(pair[0], FINE) * max(pair[1], FINE) for pair in (own, last))
        return bool(max(own) <= GROWS * max(last) and product < part * earlier)

    @property
    def solved(self) -> bool:
        """Return whether equilibrium, closed contacts and ties are met together."""
        return self.residual <= MET and self.unmet <= MET_BESIDE_IMPOSED

    @property
    def pulled(self) -> Mask:
        """Return the closed contacts in tension (m,)."""
        return np.asarray(self.closed & (self.answer.normal_force.double() < -SIGNED * self.force))

    @property
    def penetrated(self) -> Mask:
        """Return the open contacts that are penetrated (m,).

        Since unknowns without stiffness may diverge, penetrations are compared with the lengths that meet at the
        contact and those of stiff unknowns, not with the largest length.
        """
        gap, u = self.left.gap.double(), abs(self.answer.displacement.double())
        beneath = gap < -SIGNED * self.length
        if np.any(stiff := self.problem.diagonal > 0):
            own = row_sizes(self.problem, self.problem.normal).lengths(u) + abs(self.problem.gap)
            beneath |= gap < -MET_BESIDE_IMPOSED * np.maximum(own, u[stiff].max())
        return np.asarray(~self.closed & beneath)

    @property
    def holds(self) -> bool:
        """Return whether the answer solves the problem, with small residuals and neither tension nor penetration."""
        return self.solved and not (self.pulled.any() or self.penetrated.any())

    @property
    def driven(self) -> bool:
        """Return whether unbalanced forces may drive a motion, being more than rounding of entries of K leaves."""
        problem, left = self.problem, abs(self.left.force.double())
        strain = problem.stiffness_sizes @ abs(self.answer.displacement.double())
        rounding = np.where(strain > 0, MET * (strain + problem.load_size), 0.0)
        return bool(np.any(left > np.maximum(rounding, BALANCED * self.force)))


def _part(value: float, size: float) -> float:
    if value == 0 and not np.isnan(size):
        return 0.0
    return value / size if value < np.inf and size > 0 else np.inf  # NaN is not small


def solved_on(problem: ContactProblem, closed: Mask, start: ExtendedAnswer, effort: Effort) -> ClosedState:
    """Return the answer with these contacts closed nearest to a start; `solved` tells whether it exists.

    Parameters
    ----------
    problem, closed, start, effort : ContactProblem, (m,) mask, ExtendedAnswer, Effort
    """
    state = ClosedState.started(problem, closed, start)
    for regularisation in sorted(REGULARISATIONS, key=lambda added: added != effort.first):
        if regularisation in BETWEEN and pardiso.elimination_order(problem).band is not None:
            continue
        try:
            saddle = kept_saddle(problem, closed, regularisation, effort)
        except BackendFailed:  # d is too small for pivots on the diagonal
            break
        after = _swept(state, saddle, effort)
        # Residuals of rows that contradict each other by rounding cannot be reduced, and multipliers would drift.
        if regularisation < REGULARISATIONS[0] and state.solved and not after.better_than(state, WORTH_ANOTHER):
            break
        state = after
        if state.residual <= FINE:
            effort.first = regularisation
            break
    state = _by_rank(state, start, effort) if effort.ranked and not state.solved else state
    return by_pivots(state, effort) if effort.pivots and state.length_residual > MET_TOGETHER else state


def _by_rank(state: ClosedState, start: ExtendedAnswer, effort: Effort) -> ClosedState:
    """Return the state by dense rank-revealing factors, or the same state if they fail."""
    problem, closed = state.problem, np.flatnonzero(state.closed)
    if state.residual > NEARLY_MET or (len(closed) + problem.ties) * problem.dimension**2 > OF_RANK:
        return state
    saddle, effort.factorisations = RankedSaddle(problem, closed), effort.factorisations + 1
    for before in (state, ClosedState.of(problem, state.closed, start)):
        after = _swept(_corrected(before, saddle, effort), saddle, effort)
        if after.solved:
            return after
    return state


def by_pivots(state: ClosedState, effort: Effort) -> ClosedState:
    """Return the state with all rows satisfied by factors with row exchanges, or the same state if they fail."""
    problem, closed = state.problem, np.flatnonzero(state.closed)
    few = len(closed) + problem.ties <= problem.dimension
    if not few or state.residual > NEARLY_MET or effort.in_vain >= MOST_IN_VAIN:
        return state
    for part, spring in SMALL_STIFFNESS:
        try:
            saddle = PivotedSaddle(problem, closed, part, spring)
        except BackendFailed:
            continue
        effort.factorisations += 1
        # The first answer has rounding errors of forces that may be far larger than those of the previous state.
        after = _swept(_corrected(state, saddle, effort), saddle, effort)
        if after.solved and after.length_residual <= MET_TOGETHER:
            return after
    effort.in_vain += 1
    return state


def _corrected(state: ClosedState, saddle: SparseSaddle | PivotedSaddle | RankedSaddle, effort: Effort) -> ClosedState:
    closed = np.flatnonzero(state.closed)
    du, dl, dn, solved = saddle.correction(*state.left.double(closed))
    effort.back_substitutions += solved
    return ClosedState.of(state.problem, state.closed, state.answer.corrected(du, closed, dl, dn))


def kept_saddle(problem: ContactProblem, closed: Mask, regularisation: float, effort: Effort) -> SparseSaddle:
    """Return the factorised saddle point; the last one of a stiffness is kept for the certificate.

    Parameters
    ----------
    problem, closed, regularisation, effort : equilibrated, (m,) mask, added to the diagonal, counts a factorisation
    """
    kept: dict[tuple[bytes, float], SparseSaddle] = problem._computed.sparse_saddle
    key = closed.tobytes(), regularisation
    if key not in kept:
        refuse_late("another set of closed contacts was solved for")
        kept.clear()
        kept[key] = SparseSaddle(problem, np.flatnonzero(closed), regularisation)
        effort.factorisations += 1
    return kept[key]


def _swept(state: ClosedState, saddle: SparseSaddle | PivotedSaddle | RankedSaddle, effort: Effort) -> ClosedState:
    """Refine with one factorisation as long as sweeps clearly reduce the residual."""
    slow = 0
    for _ in range(SWEEPS):
        if not state.residual > SOLVED:
            break
        after = _corrected(state, saddle, effort)
        if not after.better_than(state):
            break
        slow = 0 if after.better_than(state, CONTRACTS) else slow + 1 + (not after.better_than(state, CREEPS))
        state = after
        if slow >= 2:
            break
    return state


def nearest_state(
    problem: ContactProblem, closed: Mask, start: ExtendedAnswer, effort: Effort, driven: bool = False
) -> ClosedState:
    """Return the state reached by changes of the closed contacts; `holds` tells whether it solves the problem.

    All contacts in tension open and all penetrated ones close (Hintermueller, Ito, Kunisch 2003), as long as their
    number decreases. If the load then drives an unresisted motion, contacts close in the order in which it reaches
    them.

    Parameters
    ----------
    problem, closed, start, effort : as in `solved_on`
    driven : bool, whether contacts close likewise where the first set of contacts leaves such a motion
    """
    state = solved_on(problem, closed, start, effort)
    if driven and not state.solved and state.force_residual <= NEARLY_BALANCED:
        state = _blocked(ClosedState.of(problem, closed, start), state, effort)
    state = with_right_signs(state, effort)
    if state.holds and state.driven:
        blocked = _blocked(state, state, effort)
        return blocked if blocked.holds and blocked.better_than(state) else state
    return state


def with_right_signs(state: ClosedState, effort: Effort) -> ClosedState:
    """Return the state reached from a solved one by opening contacts in tension and closing penetrated ones."""
    problem, fewest, wasted = state.problem, np.inf, 0
    while state.solved and not state.holds:
        pulled, penetrated = state.pulled, state.penetrated
        wrong = int(np.sum(pulled) + np.sum(penetrated))
        wasted = 0 if wrong < fewest else wasted + 1
        if wasted > (WASTED if wrong <= FEW_WRONG else effort.wasted):
            effort.cut |= wasted <= WASTED
            break
        if effort.exhausted():
            break
        fewest = min(fewest, wrong)
        after = solved_on(problem, (state.closed & ~pulled) | penetrated, state.answer, effort)
        state = after if after.solved else _blocked(state, after, effort)
    return state


def _blocked(start: ClosedState, driven: ClosedState, effort: Effort) -> ClosedState:
    """Return the state in which contacts that block driven motions are closed, until all forces balance.

    Unbalanced forces drive a motion d, which only the regularisation resists. From a feasible start the contact i with
    the least (g - E u)_i / (E d)_i closes (the ratio test of active-set methods, Nocedal and Wright 2006, section
    16.5).
    """
    problem, gap = start.problem, np.maximum(start.left.gap.double(), 0.0)
    for _ in range(BLOCKING):
        if driven.force_residual <= BALANCED or driven.length_residual > NEARLY_MET or effort.exhausted():
            break
        force, gaps, ties = driven.left.double(np.flatnonzero(driven.closed))
        saddle = kept_saddle(problem, driven.closed, REGULARISATIONS[0], effort)
        rate = problem.normal @ saddle.solve(force, 0.0 * gaps, 0.0 * ties)[0]
        nearing = np.flatnonzero(~driven.closed & (rate > STANDS_STILL * np.max(abs(rate), initial=0.0)))
        if not nearing.size:
            break
        closed = driven.closed.copy()
        closed[nearing[np.argmin(gap[nearing] / rate[nearing])]] = True
        driven = solved_on(problem, closed, start.answer, effort)
    return driven
