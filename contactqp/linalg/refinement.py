"""Compute the answer for a set of closed contacts, refined to the last digits, and correct the set.

The condensed saddle-point system acts as an approximate inverse; residuals are formed on the full problem in extended
precision and corrections added in extended precision (mixed-precision refinement; Higham 2002, chapter 12), so the
answer is right to the last digits of double precision as long as eps * condition number < 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import is_

import numpy as np

from contactqp.linalg.condensation import Condensation
from contactqp.linalg.dense import BALANCED, SaddlePoint, saddle_point
from contactqp.linalg.equilibration import affordable_systems
from contactqp.linalg.extended import FINE_EPS, Extended, ExtendedAnswer, Residuals, extend, extended_rows, residuals_of
from contactqp.linalg.factorization import RIGID_FORCE
from contactqp.linalg.floating import UNRESISTED, imbalance, imbalance_of_acting, rigid_forces
from contactqp.linalg.least_norm import WITHIN_ROUNDING, shift_to_least_norm
from contactqp.linalg.measures import forces_that_meet, lengths_that_meet, longest_stated, own_compliance, row_sizes
from contactqp.linalg.nonnegative import forces_without_tension
from contactqp.model.arrays import EPS, INVISIBLE, Array, Indices, Vector, refuse_late, time_is_up, zero_beneath
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# Refinement stops when a sweep no longer halves the correction; good sets need two or three.
MAX_SWEEPS = 12
# This part of the systems that are affordable may exchange dependent contacts of one set.
FOR_EXCHANGES = 5
# The smallest ratio of successive corrections that a solve in double precision is trusted with.
LEAST_CONTRACTION = EPS
# Corrections below this part of the answer are rounding of twice double precision and do not measure contraction.
ROUNDED_AWAY = 2.0**-90
# Corrections in other directions may contract less than measured by this factor.
CAUTION = 1e4
# The relative size of the next correction at which refinement stops, far below the precision of doubles.
LAST_CORRECTION = 1e-22
# Refinement is settled where all that it still changes is at most this part of the answer, both in the root of energy:
# a sixteenth of the noise of residuals that bounds allow for (`certificate.figures.residual_noise`).
SETTLED = FINE_EPS / np.sqrt(RIGID_FORCE) / 16
# Displacements below this part of the forces, both in the root of energy, are refined separately.
SMALL = 1e-3

# A resultant is carried without tension if nonnegative forces leave a residual of at most this part, and forces below
# this part of it count as zero.
CARRIED, NO_SHARE = 1e-9, 1e-12
# A shift below this part of the displacement needs no refinement, as rounding of K along a rigid motion makes it 1e-27
# of |K||u|.
SLIGHT = 2**10 * EPS


@dataclass(frozen=True, eq=False, kw_only=True)
class OnSet(ExtendedAnswer):
    """The equality-constrained answer on one set of closed contacts, in extended precision."""

    gap: Extended  # (m,)
    gaps: Vector  # (m,) the same in double precision
    lengths: Vector  # (m,) that meet at the contacts
    doubles: Answer  # the answer in double precision
    saddle: SaddlePoint
    contraction: float  # ratio of successive corrections in refinement
    remainder: float  # the largest change by further refinement [square root of energy]
    nothing: Vector  # (m + k,) lengths of contacts and ties below which gaps are rounding
    settled: bool  # whether `remainder` is too small to show in bounds
    cleared: float = 0.0  # relative forces by rounding of K along rigid motions

    @property
    def rounding_of_gaps(self) -> Vector:
        """Return the lengths (m,) below which gaps cannot be distinguished from zero."""
        return np.maximum(WITHIN_ROUNDING * self.lengths, self.nothing[: len(self.lengths)])


def answer_on(
    problem: ContactProblem,
    condensation: Condensation,
    closed: Indices,
    start: Answer | None = None,
    residual: Residuals | None = None,
    caution: float = 1.0,
    at_rest: bool = False,
) -> OnSet:
    """Solve K u + E_B'l_B + A'nu = f, E_B u = g_B, A u = b on the closed contacts B, by refinement.

    K is used as stated unless its rounding along rigid motions spoils the balance of forces, or any force if these
    motions are stated; then K is set to zero along them.

    Parameters
    ----------
    problem : ContactProblem
    condensation : the Condensation of the problem
    closed : (q,) array of int, B
    start : where refinement begins; free motions stay as they are there
    residual : the residuals of the start, if known; used if it has no friction and no force on open contacts
    caution : refinement goes on until this many times what it still has to do is negligible
    at_rest : whether, without a start, free motions take the displacement to its least norm within the gaps
    """
    found = _refined(problem, condensation, closed, start, residual, caution, at_rest)
    if not condensation.rigid.count:
        return found
    missed = max(_imbalance(problem, condensation, found), rigid_forces(problem, found.doubles, condensation.rigid))
    if missed <= BALANCED:
        return found
    again = _refined(problem, condensation, closed, start, None, caution, at_rest, cleared=True)
    return replace(again, cleared=imbalance_of_acting(problem, found.doubles, condensation.rigid, missed))


def _imbalance(problem: ContactProblem, condensation: Condensation, found: OnSet) -> float:
    """Return the relative imbalance of the outer forces on rigid motions, without forces of rounding size."""
    missed = imbalance(problem, found.doubles, condensation.rigid)
    if missed <= BALANCED:
        return missed
    push, tie = _forces_beyond_noise(condensation, found)
    loud = Answer(found.doubles.displacement, push, None, tie)
    return min(missed, imbalance(problem, loud, condensation.rigid))


def _forces_beyond_noise(condensation: Condensation, found: OnSet) -> tuple[Vector, Vector]:
    """Return contact and tie forces in doubles, with zeros for rounding errors, which would drive an unloaded body."""
    compliance = condensation.delassus.compliance
    push, tie = found.doubles.normal_force, found.doubles.tie_force
    force = np.concatenate([push, tie])
    force[abs(force) * compliance <= found.nothing] = 0.0
    return force[: len(push)], force[len(push) :]


def _refined(
    problem: ContactProblem,
    condensation: Condensation,
    closed: Indices,
    start: Answer | None,
    residual: Residuals | None,
    caution: float,
    at_rest: bool,
    cleared: bool = False,
) -> OnSet:
    """Run `answer_on` with K as stated, or `cleared` of its rounding along rigid motions."""
    size_of = _CorrectionSize(problem, condensation, closed)
    saddle = saddle_point(condensation, closed)
    answer, residual = _start(problem, closed, start, residual)
    rows = condensation.cleared_rows(problem) if cleared else extended_rows(problem)
    last, q = np.inf, saddle.contraction and max(saddle.contraction, size_of.least_contraction)
    for sweep in range(MAX_SWEEPS):
        if residual is None:
            residual = residuals_of(rows, problem, answer)
        du, dl, dn = condensation.correction(saddle, *residual.double(closed))
        residual = None
        answer = answer.corrected(du, closed, dl, dn)
        if at_rest and sweep == 0 and start is None and saddle.free.shape[1]:
            shift, _ = shift_to_least_norm(problem, condensation, answer.double(), closed)
            answer = replace(answer, displacement=answer.displacement + shift)
        u, force, tie = answer.rounded(closed)
        size, whole = size_of(du, dl, dn), size_of(u, force, tie)
        rounding = ROUNDED_AWAY * whole
        if sweep == 1 and q is None:
            q = max(size / max(last, rounding) if last > 0 else 0.0, size_of.least_contraction)
            saddle.contraction = q if last > rounding and saddle.regular else None
        elif sweep > 0 and q is not None and rounding < last < np.inf and 2 * size < last:
            q = max(q, size / last)
            saddle.contraction = q if saddle.regular else None
        if sweep > 1 and size > 0.5 * last:
            break
        if q is not None and size_of.is_negligible(size * min(q * caution, 1.0), (u, force, tie), whole):
            break
        last = size
    nothing = INVISIBLE * whole * size_of.row_sizes
    q = q or 0.0
    remainder = size * min(q * CAUTION, 1.0) / (1 - q) if q < 1 else np.inf
    gap = rows.gap(problem, answer.displacement)
    gaps, doubles = gap.double(), answer.double()
    return OnSet(
        **vars(answer),
        gap=gap,
        gaps=gaps,
        lengths=lengths_that_meet(problem, problem.normal, problem.gap, doubles.displacement),
        doubles=doubles,
        saddle=saddle,
        contraction=q,
        remainder=remainder,
        nothing=nothing,
        settled=remainder * (np.sqrt(problem.stiffness_sizes.size) + problem.contacts) <= SETTLED * whole,
    )


def _start(
    problem: ContactProblem, closed: Indices, start: Answer | None, residual: Residuals | None
) -> tuple[ExtendedAnswer, Residuals | None]:
    """Return a start without friction and forces on open contacts, by default at rest, and its residuals if known."""
    if start is None:
        return ExtendedAnswer.at_rest(problem), Residuals.at_rest(problem)
    kept = np.zeros(problem.contacts, dtype=bool)
    kept[closed] = True
    force = np.where(kept, start.normal_force, 0.0)
    answer = ExtendedAnswer(Extended(start.displacement), Extended(force), None, Extended(start.tie_force))
    dropped = start.normal_force[~kept].any() or (start.friction_force is not None and start.friction_force.any())
    return answer, None if dropped else residual


class _CorrectionSize:
    """The size of a correction, the largest change of displacement or force in the square root of energy."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, closed: Indices) -> None:
        self.row_sizes = np.sqrt(condensation.delassus.compliance)  # (m + k,) of a unit force in the root of energy
        self._unknown, self._problem, self._rigid = 1.0 / condensation.unknown_scale, problem, condensation.rigid
        self._row = self.row_sizes[closed]
        own = np.sqrt(own_compliance(problem, problem.normal)[closed])
        if problem.ties:
            self._row = np.concatenate([self._row, self.row_sizes[problem.contacts :]])
            own = np.concatenate([own, np.sqrt(own_compliance(problem, problem.tie))])
        # The error of a force is relative to the stiffness of its own unknowns, which is large where they move
        # together.
        together = np.divide(self._row, own, out=np.ones_like(own), where=own > 0)
        self.least_contraction = LEAST_CONTRACTION * float(together.max(initial=1.0))

    def __call__(self, du: Vector, dl: Vector, dn: Vector) -> float:
        force = np.concatenate([dl, dn]) if dn.size else dl
        return float(max(self._moved(du), (self._row * abs(force)).max(initial=0.0)))

    def _moved(self, du: Vector) -> float:
        return float((self._unknown * abs(du)).max(initial=0.0))

    def is_negligible(self, size: float, answer: tuple[Vector, Vector, Vector], whole: float) -> bool:
        """Return whether a correction is far below the rounding of doubles of size `whole`, or of twice double
        precision.

        The rigid part of a displacement counts only for the latter. A displacement that is small compared with forces,
        as with weak springs, determines gaps on which these do work, so it is weighted accordingly.
        """
        if not FINE_EPS * whole < size <= LAST_CORRECTION * whole:
            return size <= FINE_EPS * whole
        u, force, tie = answer
        moved = self._moved(u)
        if 0 < moved < SMALL * whole and size > max(LAST_CORRECTION * moved / whole, FINE_EPS) * moved:
            return False
        if not self._rigid.count:
            return True
        return size <= LAST_CORRECTION * self(self._rigid.without_rigid_part(u, self._problem.diagonal), force, tie)


def closed_contacts(problem: ContactProblem, compliance: Vector, u: Vector, force: Vector) -> Indices:
    """Return the contacts that an answer closes, those with W_ii l_i > gap_i, both lengths.

    Parameters
    ----------
    problem : ContactProblem
    compliance : (m,) array [length / force], W_ii
    u, force : (n,), (m,) arrays, displacement and normal forces of the answer
    """
    return np.asarray((compliance * force > problem.gap - problem.normal @ u).nonzero()[0])


def polish(
    problem: ContactProblem,
    condensation: Condensation,
    closed: Indices,
    max_corrections: int,
    start: Answer | None = None,
    residual: Residuals | None = None,
    caution: float = 1.0,
) -> tuple[OnSet, int, bool]:
    """Refine the answer on a set of closed contacts and correct the set.

    A correction opens contacts in tension and closes penetrated ones. In a redundant set, a penetrated dependent
    contact replaces another one, which does not count as a correction while it is affordable; then forces without
    tension are chosen if they exist, and contacts with zero force leave the set. A set that holds to rounding of
    doubles is corrected by signs in extended precision, as long as the result also holds. An answer that
    `without_noise` has rounded is not refined again. Raises NotConverged: a set would be corrected when the time is up.

    Parameters
    ----------
    problem, condensation, closed, start, residual, caution : as in `answer_on`
    max_corrections : int, the largest number of corrections

    Returns
    -------
    answer : OnSet
    corrections : int
    holds : bool, whether no contact pulls and no open one penetrates
    """
    given, kept = problem._computed.of_answer.polished
    ours = all(map(is_, given, (start, problem.load, problem.gap, problem.tie_value)))
    if kept and ours and np.array_equal(kept.saddle.closed, closed):
        return kept, 0, True
    seen: set[bytes] = set()
    corrections, exchanges, holding = 0, 0, None
    while True:
        answer = answer_on(problem, condensation, closed, start, residual, caution, at_rest=True)
        if holding is not None and not _regular(answer):
            return holding
        proposal = None
        if answer.saddle.redundant:
            if not _ties_are_met(problem, answer):
                return holding or (answer, corrections, False)
            proposal = _exchanged(answer)
            exchanges += proposal is not None and exchanges < min(
                len(closed), affordable_systems(problem) // FOR_EXCHANGES
            )
            if proposal is None:
                lean = _without_tension(condensation, answer)
                if len(lean) < len(closed):
                    seen.add(closed.tobytes())
                    closed = lean
                    answer = answer_on(problem, condensation, closed, start, residual, caution, at_rest=True)
        if proposal is None:
            if answer.saddle.free.shape[1]:
                answer, _ = least_displacement(problem, condensation, answer, caution)
            tension, penetrated = _wrong(problem, answer)
            reached, driven = _reached_by_drive(problem, condensation, answer)
            if not (tension.size or penetrated.size or driven):
                holding = answer, corrections, True
                proposal = _decided(problem, condensation, answer, closed)
                if proposal is None or np.array_equal(proposal, closed):
                    return holding
        if proposal is None:
            penetrated = np.union1d(penetrated, reached)
            proposal = np.union1d(np.setdiff1d(closed, tension), penetrated).astype(np.intp)
        seen.add(closed.tobytes())
        ended = corrections >= max_corrections + exchanges or proposal.tobytes() in seen
        if ended or (holding is not None and time_is_up()):
            return holding or (answer, corrections, False)
        refuse_late("a set of closed contacts was corrected", judging=True)
        closed = proposal
        corrections += 1


def _ties_are_met(problem: ContactProblem, answer: OnSet) -> bool:
    u = answer.doubles.displacement
    missing = abs((extend(problem.tie_value) - extended_rows(problem).tie @ answer.displacement).double())
    rounding = WITHIN_ROUNDING * lengths_that_meet(problem, problem.tie, problem.tie_value, u)
    return bool(np.all(missing <= np.maximum(rounding, answer.nothing[problem.contacts :])))


def _exchanged(answer: OnSet) -> Indices | None:
    """Return the redundant set in which the most penetrated dependent contact replaces another one.

    None if no dependent contact is penetrated. If none can be replaced, the set is returned unchanged, as its rows
    conflict.
    """
    closed = answer.saddle.closed
    dependent = np.setdiff1d(np.arange(len(closed)), answer.saddle.independent)
    penetrated = -answer.gaps > answer.rounding_of_gaps
    excess = np.where(penetrated, -answer.gaps / answer.lengths, 0.0)[closed[dependent]]
    if not np.any(excess):
        return None
    leaving = answer.saddle.exchange(int(dependent[np.argmax(excess)]), answer.doubles.normal_force[closed])
    return closed if leaving is None else np.delete(closed, leaving)


def _wrong(problem: ContactProblem, answer: OnSet) -> tuple[Indices, Indices]:
    """Return the contacts that must open, in tension or with a gap in spite of a force, and the penetrated ones.

    Closed contacts count as not penetrated; in a set with free motions only those with a force.
    """
    gap, push = answer.gaps, answer.doubles.normal_force
    rounding = answer.rounding_of_gaps
    penetrated = -gap > rounding
    penetrated[answer.saddle.closed] = False
    # A dependent contact is closed by the others, whatever its force.
    opening = (gap > rounding) & (push > 0)
    if (push < 0).any():
        opening |= _push(problem, answer.doubles) < -WITHIN_ROUNDING
    return opening.nonzero()[0], penetrated.nonzero()[0]


def _regular(answer: OnSet) -> bool:
    """Return whether the rows of a set are clearly independent."""
    return not answer.saddle.redundant and answer.contraction * CAUTION <= 1


def _decided(problem: ContactProblem, condensation: Condensation, answer: OnSet, closed: Indices) -> Indices | None:
    """Return the set by the signs, in extended precision, of gaps and forces that are zero in doubles.

    None if a set is nearly redundant or bodies float, as rounding of the data decides there. Undecided signs are
    refined further.
    """
    if condensation.rigid.count or not _regular(answer):
        return None
    push, gap = answer.doubles.normal_force, answer.gaps
    compliance = condensation.delassus.compliance[: len(push)]
    settled = answer.nothing[: len(compliance)]
    noise = np.maximum(settled, answer.remainder * np.sqrt(compliance))
    is_closed = np.zeros(len(noise), dtype=bool)
    is_closed[closed] = True
    length = np.where(is_closed, push * compliance, gap)
    size = abs(length)
    if ((size > settled) & (size <= noise)).any():
        answer = answer_on(problem, condensation, closed, caution=CAUTION)
        noise = np.maximum(answer.nothing[: len(compliance)], answer.remainder * np.sqrt(compliance))
        push, gap = answer.doubles.normal_force, answer.gaps
    return np.asarray(np.where(is_closed, push * compliance >= -noise, gap < -noise).nonzero()[0])


def _reached_by_drive(problem: ContactProblem, condensation: Condensation, answer: OnSet) -> tuple[Indices, bool]:
    """Return the contacts first reached by a free motion driven by the load, and whether there is such a motion."""
    if not answer.saddle.free.shape[1]:
        return np.zeros(0, dtype=np.intp), False
    load, inner = condensation.reduce_load(problem.load)
    size = condensation.reduced_size(problem, inner)
    drive = answer.saddle.drive(_net(condensation, load, answer.doubles.normal_force, answer.doubles.tie_force), size)
    if drive.any():  # unless driven by rounding only
        drive = answer.saddle.drive(_net(condensation, load, *_forces_beyond_noise(condensation, answer)), size)
    if not drive.any():
        return np.zeros(0, dtype=np.intp), False
    drive = condensation.scale * drive
    approach = condensation.normal @ drive
    ahead = approach > UNRESISTED * (abs(condensation.normal) @ abs(drive))
    travel = np.full(problem.contacts, np.inf)
    travel[ahead] = np.maximum(answer.gaps[ahead], 0.0) / approach[ahead]
    return np.flatnonzero(np.isfinite(travel) & (travel <= travel.min(initial=np.inf))), True


def _net(condensation: Condensation, load: Vector, push: Vector, tie: Vector) -> Vector:
    """Return a condensed load (p,) less the forces of contacts and ties.

    These forces do no work on a free motion except by its rounding errors.
    """
    return np.asarray(load - condensation.normal.T @ push - condensation.tie.T @ tie)


def _without_tension(condensation: Condensation, answer: OnSet) -> Indices:
    """Return the members of a redundant set that carry its resultant without tension, or all if impossible.

    Contacts with a gap are excluded.
    """
    closed, ties = answer.saddle.closed, condensation.tie * condensation.scale
    contacts = condensation.normal[closed] * condensation.scale
    resultant = contacts.T @ answer.doubles.normal_force[closed]
    size = np.linalg.norm(resultant)
    if size == 0:
        return closed[:0]
    touching = np.flatnonzero(answer.gaps[closed] <= answer.rounding_of_gaps[closed])
    rows = np.vstack([contacts[touching], ties])
    unit = rows / np.linalg.norm(rows, axis=1)[:, None]
    share, missing = forces_without_tension(unit, resultant / size, np.arange(len(rows)) < len(touching))
    return np.asarray(closed[touching][share[: len(touching)] > NO_SHARE]) if missing <= CARRIED else closed


def without_noise(problem: ContactProblem, condensation: Condensation, answer: OnSet) -> Answer:
    """Return the answer on a set whose signs hold in doubles, with rounding errors of the refinement set to zero."""
    u, tie = answer.doubles.displacement, answer.doubles.tie_force
    push = np.where(answer.normal_force.hi > 0, answer.doubles.normal_force, 0.0)
    root = 1.0 / condensation.unknown_scale
    force, size = np.concatenate([push, tie]), np.sqrt(condensation.delassus.compliance)
    loads = abs(problem.load) / root
    largest = max([part.max(initial=0.0) for part in (root * abs(u), size * abs(force), loads)])
    zeroed, force = zero_beneath((u, force), (root, size), INVISIBLE * largest)
    if np.any(zeroed != u):
        zeroed = np.where(root * abs(u) > INVISIBLE * longest_stated(problem), u, zeroed)
    clean = Answer(zeroed, force[: len(push)], None, force[len(push) :])
    if answer.settled and not condensation.rigid.count:
        problem._computed.of_answer.polished = (clean, problem.load, problem.gap, problem.tie_value), answer
    return clean


def least_displacement(
    problem: ContactProblem, condensation: Condensation, answer: OnSet, caution: float = 1.0
) -> tuple[OnSet, Array]:
    """Return the answer of least norm along the motions that nothing drives or resists.

    Parameters
    ----------
    problem, condensation, caution : as in `answer_on`
    answer : OnSet

    Returns
    -------
    answer : OnSet, the answer there
    free : (n, q) array, an orthonormal basis of those motions
    """
    if not condensation.rigid.count:
        return answer, condensation.rigid.motions
    clean = without_noise(problem, condensation, answer)
    pushing = pushing_contacts(problem, clean)
    shift, free = shift_to_least_norm(problem, condensation, clean, pushing)
    far, largest = abs(shift).max(initial=0.0), abs(clean.displacement).max(initial=0.0)
    if far <= WITHIN_ROUNDING * largest:
        return answer, free
    if far <= SLIGHT * largest:
        closer = answer.displacement + shift
        gap = answer.gap - problem.normal @ shift
        doubles = replace(answer.doubles, displacement=closer.double())
        lengths = lengths_that_meet(problem, problem.normal, problem.gap, doubles.displacement)
        double = dict(gaps=gap.double(), doubles=doubles, lengths=lengths)
        return replace(answer, displacement=closer, gap=gap, **double), free
    # The shift is rigid to double precision only, so the result is refined again.
    moved = replace(clean, displacement=clean.displacement + shift)
    return answer_on(problem, condensation, pushing, moved, caution=caution), free


def pushing_contacts(problem: ContactProblem, answer: Answer) -> Indices:
    """Return the contacts with a force beyond rounding."""
    return np.asarray(np.flatnonzero(_push(problem, answer) > WITHIN_ROUNDING))


def _push(problem: ContactProblem, answer: Answer) -> Vector:
    """Return the measure of every contact force (m,), negative in tension."""
    force = answer.normal_force
    return row_sizes(problem, problem.normal).measure(force, forces_that_meet(problem, answer)) * np.sign(force)
