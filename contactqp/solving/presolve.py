"""Remove redundant rows before a method runs, and restore their forces afterwards.

Where rows outnumber the unknowns, as in quadratic programs, some depend on others. Parallel contacts and ties, E_i =
c_i E_k, constrain the same displacement: of contacts with c_i > 0 only those with the least g_i / c_i can close, and of
ties with equal b_i / c_i one suffices. The force F of the kept row k is distributed over those that close together with
the least sum of squares, l_i = F c_i / (sum of c_j^2), all of one sign. Bounds of one unknown are parallel rows, too. A
contact with E_i u < g_i for all u within the bounds of its unknowns cannot close, and one parallel to a tie that
prevents penetration has zero force.

No tolerance is involved: rows are parallel and gaps equal in rational arithmetic, and the range of a row includes the
rounding error of its sum. The certificate checks all rows.

A problem of very many contacts is solved by a subset of them, which grows until no other contact is penetrated
(`solve_among`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.certificate import certificate_of
from contactqp.certificate.figures import contact_status
from contactqp.certificate.subset_bounds import among, candidates_around, first_candidates, take_all, widened
from contactqp.errors import NoEquilibrium, NotCertified, NotConverged
from contactqp.linalg.condensation import condense
from contactqp.linalg.equilibration import bounds_of_unknowns
from contactqp.linalg.existence import Conflict
from contactqp.linalg.interior_point import remember_of_all_rows
from contactqp.linalg.iteration import contacts_are_many
from contactqp.model.arrays import EPS, TINY, Array, Indices, Vector, tell
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate, Final, Solution, Work
from contactqp.solving.methods import Method, Settings
from contactqp.solving.runs import Run

# The seed of the random weights of the columns; rows with equal weighted sums have their entries compared.
SEED = 0
# The most names of rows in a note.
NAMED = 8
# Rounding of a sum of q products, and of the bounds in them, is at most (q + ROUNDINGS) eps of the sum of their sizes.
ROUNDINGS = 4
ONE = Fraction(1)


@dataclass(frozen=True)
class Parallel:
    """Parallel rows, of which row i is c_i times the first one."""

    rows: Indices
    factors: tuple[Fraction, ...]  # c_i, the first of them one

    def tightest(self, limit: Vector) -> tuple[Indices, list[Fraction]]:
        """Return the contacts with the least g_i / c_i, which close together, and their factors."""
        reached = [Fraction(float(limit[i])) / c for i, c in zip(self.rows, self.factors, strict=True)]
        least = min(reached)
        at = [place for place, value in enumerate(reached) if value == least]
        return self.rows[at], [self.factors[place] for place in at]

    def same(self, limit: Vector) -> tuple[Indices, list[Fraction]]:
        """Return the ties that the first one implies, and their factors."""
        first = Fraction(float(limit[self.rows[0]]))
        pairs = enumerate(zip(self.rows, self.factors, strict=True))
        at = [place for place, (i, c) in pairs if Fraction(float(limit[i])) == c * first]
        return self.rows[at], [self.factors[place] for place in at]


def parallel_rows(rows: Any, signed: bool, beyond: int = 0) -> tuple[Parallel, ...]:
    """Return the parallel rows of a CSR matrix; signed rows, as contacts are, must point the same way.

    Groups without a row of index `beyond` or larger are left out.
    """
    lengths = np.diff(rows.indptr)
    filled = np.flatnonzero(lengths)
    if not filled.size:
        return ()
    first = np.zeros(len(lengths))
    first[filled] = rows.data[rows.indptr[filled]]
    ratio = rows.data / np.repeat(first, lengths)
    # Equal quotients of doubles are rounded equally, and so are sums in the same order.
    marks = np.random.default_rng(SEED).uniform(1.0, 2.0, rows.shape[1])[rows.indices] * ratio
    key = np.add.reduceat(marks, rows.indptr[filled])
    sense = np.sign(first[filled]) if signed else np.ones(len(filled))
    order = np.lexsort((filled, sense, key))
    changes = (np.diff(key[order]) != 0) | (np.diff(sense[order]) != 0)
    ends = np.concatenate([[0], np.flatnonzero(changes) + 1, [len(order)]])
    several = np.flatnonzero(np.diff(ends) > 1)  # most groups consist of a single row
    several = several[filled[order[ends[several + 1] - 1]] >= beyond]
    groups = [filled[order[ends[i] : ends[i + 1]]] for i in several]
    if not groups:
        return ()
    counts = np.array([len(members) - 1 for members in groups])
    powers = _powers_of_two(
        rows, np.repeat([members[0] for members in groups], counts), np.concatenate([members[1:] for members in groups])
    )
    of_groups = np.split(powers, np.cumsum(counts)[:-1])
    return tuple(found for pair in zip(groups, of_groups, strict=True) for found in _verified(rows, *pair))


def _powers_of_two(rows: Any, ones: Indices, others: Indices) -> Vector:
    """Return the factors c of rows that are exactly c times others with c a power of two, NaN for the rest.

    Products with c are exact unless they underflow.
    """
    lengths = np.diff(rows.indptr)
    alike = np.flatnonzero(lengths[ones] == lengths[others])
    count = lengths[ones[alike]]
    starts = np.cumsum(count) - count
    within = np.arange(int(np.sum(count))) - np.repeat(starts, count)
    one, other = (np.repeat(rows.indptr[of[alike]], count) + within for of in (ones, others))
    with np.errstate(over="ignore", under="ignore"):
        factor = rows.data[rows.indptr[others[alike]]] / rows.data[rows.indptr[ones[alike]]]
        same = np.repeat(factor, count) * rows.data[one] == rows.data[other]
    same &= (rows.indices[one] == rows.indices[other]) & (abs(rows.data[other]) > TINY)
    exact = np.logical_and.reduceat(same, starts) & (abs(np.frexp(factor)[0]) == 0.5) if len(alike) else same
    found = np.full(len(ones), np.nan)
    found[alike[exact]] = factor[exact]
    return found


def _verified(rows: Any, members: Indices, powers: Vector) -> Iterator[Parallel]:
    """Yield groups of the rows among `members` that are exactly parallel to their first one.

    `powers` are the factors of rows that are powers of two.
    """
    if not np.isnan(powers).any():
        yield Parallel(members, (ONE, *(Fraction(c) if c != 1 else ONE for c in powers.tolist())))
        return
    entries = [slice(rows.indptr[i], rows.indptr[i + 1]) for i in members]
    columns, values = rows.indices[entries[0]], rows.data[entries[0]]
    found, factors = [int(members[0])], [ONE]
    for i, at in zip(members[1:], entries[1:], strict=True):
        factor = _factor(values, rows.data[at]) if np.array_equal(columns, rows.indices[at]) else None
        if factor is not None:
            found.append(int(i))
            factors.append(factor)
    if len(found) > 1:
        yield Parallel(np.array(found, dtype=np.intp), tuple(factors))


def _factor(values: Vector, others: Vector) -> Fraction | None:
    """Return the rational c with others = c * values, or None where there is none."""
    factor = Fraction(float(others[0])) / Fraction(float(values[0]))
    pairs = zip(values.tolist(), others.tolist(), strict=True)
    return factor if all(Fraction(other) == factor * Fraction(value) for value, other in pairs) else None


def never_close(problem: ContactProblem) -> Indices:
    """Return the contacts of several unknowns that cannot close within the bounds of single unknowns."""
    E = problem.normal
    lower, upper = bounds_of_unknowns(problem)
    with np.errstate(invalid="ignore"):  # 0 times infinity does not occur: entries of zero are not stored
        farthest = np.where(E.data > 0, E.data * upper[E.indices], E.data * lower[E.indices])
    lengths, filled = np.diff(E.indptr), np.flatnonzero(np.diff(E.indptr) > 1)
    if not filled.size:
        return filled
    totals, sizes = np.full(len(lengths), np.inf), np.zeros(len(lengths))
    sums = sp.csr_matrix((farthest, E.indices, E.indptr), shape=E.shape)
    totals[filled] = np.asarray(sums.sum(axis=1)).ravel()[filled]
    sizes[filled] = np.asarray(abs(sums).sum(axis=1)).ravel()[filled]
    rounding = (lengths + ROUNDINGS) * EPS * sizes
    return np.flatnonzero((lengths > 1) & np.isfinite(totals) & (totals + rounding < problem.gap))


def held_by_ties(problem: ContactProblem) -> Indices:
    """Return the contacts whose gap a tie fixes as nonnegative, E_i = c A_k with c b_k <= g_i; the tie carries their
    force.
    """
    m, held = problem.contacts, []
    for group in _groups(problem)[2]:
        ties = [(i - m, c) for i, c in zip(group.rows.tolist(), group.factors, strict=True) if i >= m]
        if not ties:
            continue
        tie, unit = ties[0]
        value = Fraction(float(problem.tie_value[tie])) / unit
        for i, c in zip(group.rows.tolist(), group.factors, strict=True):
            if i < m and np.isfinite(problem.gap[i]) and c * value <= Fraction(float(problem.gap[i])):
                held.append(i)
    return np.array(sorted(held), dtype=np.intp)


@dataclass(frozen=True)
class Shares:
    """The distribution of the forces of kept rows over all rows: force = matrix @ (forces of the kept rows)."""

    kept: Indices
    matrix: Any  # (all, kept) CSR

    def restricted(self, force: Vector) -> Vector:
        """Return the forces of the kept rows with the same resultant as those of all rows."""
        weight = np.asarray(self.matrix.multiply(self.matrix).sum(axis=0)).ravel()
        return np.asarray(self.matrix.T @ force / weight)


@dataclass(frozen=True, eq=False)
class Presolved:
    """A problem with the kept rows, and the distributions that give all rows their forces."""

    problem: ContactProblem
    contacts: Shares
    ties: Shares
    notes: tuple[str, ...]

    def restricted(self, start: Candidate | None) -> Candidate | None:
        """Return a start for the kept rows from one for all rows."""
        if start is None:
            return None
        answer = start.answer
        normal, tie = self.contacts.restricted(answer.normal_force), self.ties.restricted(answer.tie_force)
        return replace(start, answer=replace(answer, normal_force=normal, tie_force=tie))

    def spread(self, found: Candidate | Final) -> Any:
        """Return the answer for all rows from one for the kept rows."""
        answer = found.answer
        normal, tie = self.contacts.matrix @ answer.normal_force, self.ties.matrix @ answer.tie_force
        return replace(found, answer=replace(answer, normal_force=normal, tie_force=tie))


def _groups(problem: ContactProblem) -> tuple[tuple[Parallel, ...], ...]:
    """Return the groups of parallel rows of contacts, of ties, and of ties with contacts, found once."""
    if problem._computed.parallel_rows is None:
        E, A = problem.normal, problem.tie
        both = parallel_rows(sp.csr_matrix(sp.vstack([E, A])), False, len(problem.gap)) if problem.ties else ()
        problem._computed.parallel_rows = parallel_rows(E, True), parallel_rows(A, False), both
    groups: tuple[tuple[Parallel, ...], ...] = problem._computed.parallel_rows
    return groups


def presolved(problem: ContactProblem) -> Presolved | None:
    """Return the frictionless problem without idle and parallel rows, None if it has none."""
    groups = _groups(problem)
    tied = held_by_ties(problem)
    idle, notes = np.union1d(never_close(problem), tied), list[str]()
    contacts = _shares(problem.contacts, [(g.rows, *g.tightest(problem.gap)) for g in groups[0]], idle)
    together = [g.same(problem.tie_value) for g in groups[1]]
    ties = _shares(problem.ties, [(same[0], *same) for same in together], np.zeros(0, dtype=np.intp))
    if len(contacts.kept) == problem.contacts and len(ties.kept) == problem.ties:
        return None
    aside = np.setdiff1d(np.arange(problem.contacts), np.concatenate([contacts.kept, idle]))
    equal = np.diff(contacts.matrix.indptr)[aside] > 0
    for rows, text in (
        (aside[~equal], "parallel to nearer ones"),
        (aside[equal], "parallel to equal ones"),
        (tied, "held by ties"),
        (np.setdiff1d(idle, tied), "out of reach within bounds"),
    ):
        names = [problem.contact_name(int(i)) for i in rows[:NAMED]]
        if names:
            notes.append(f"set aside: {', '.join(names)}{_more(len(rows), text)}")
    dropped = np.setdiff1d(np.arange(problem.ties), ties.kept)
    if dropped.size:
        names = [problem.tie_name(int(i)) for i in dropped[:NAMED]]
        notes.append(f"set aside: {', '.join(names)}{_more(len(dropped), 'parallel to equal ones')}")
    return Presolved(_with(problem, contacts.kept, ties.kept), contacts, ties, tuple(notes))


def _more(count: int, text: str) -> str:
    return f"{f' and {count - NAMED} more' if count > NAMED else ''}, {text}"


def _shares(count: int, groups: list[tuple[Indices, Indices, list[Fraction]]], idle: Indices) -> Shares:
    """Return which of `count` rows are kept, and the distribution of their forces over all rows.

    Of each group (all rows, those that act together, their factors) the first acting row is kept; idle rows are
    removed.
    """
    owner, share, kept = np.arange(count), np.ones(count), np.ones(count, dtype=bool)
    for members, acting, factors in groups:
        first = factors[0]
        relative = [c / first for c in factors]
        total = sum((c * c for c in relative), Fraction(0))
        kept[members], share[members] = False, 0.0
        kept[acting[0]] = True
        owner[members] = acting[0]
        share[acting] = [float(c / total) for c in relative]
    kept[idle] = False
    place = np.cumsum(kept) - 1
    used = np.flatnonzero(kept[owner] & (share != 0))
    matrix = sp.csr_matrix((share[used], (used, place[owner[used]])), shape=(count, int(np.sum(kept))))
    return Shares(np.flatnonzero(kept), matrix)


def _with(problem: ContactProblem, contacts: Indices, ties: Indices) -> ContactProblem:
    """Return the problem with these rows only, with cached results for other loads and gaps."""
    cached = problem._computed.presolved
    if cached is None or not (np.array_equal(cached[0], contacts) and np.array_equal(cached[1], ties)):
        cached = problem._computed.presolved = (contacts, ties, problem.with_contacts(contacts).with_ties(ties))
    fewer: ContactProblem = cached[2].replace(
        load=problem.load, gap=problem.gap[contacts], tie_value=problem.tie_value[ties]
    )
    return fewer if problem.load_sum is None else fewer._with_load_sum(problem.load, problem.load_size)


class PresolvedRun(Run):
    """A run on the kept rows that returns an answer for all rows.

    Raises NoEquilibrium, NotConverged, BackendFailed, Unsupported as the run on the kept rows.

    Parameters
    ----------
    fewer : Presolved, the problem of the kept rows
    problem : ContactProblem, that of all rows
    method : Method
    settings : Settings, its `warm_start` is one on all rows
    begin : function of a problem and settings, makes the run on the kept rows
    """

    def __init__(
        self, fewer: Presolved, problem: ContactProblem, method: Method, settings: Settings, begin: Callable[..., Run]
    ) -> None:
        super().__init__(problem, method)
        self._fewer = fewer
        settings = replace(settings, warm_start=fewer.restricted(settings.warm_start))
        with self._proofs_of_all_rows():
            self._run = begin(fewer.problem, settings)
        self.candidate = fewer.spread(self._run.candidate)

    @contextmanager
    def _proofs_of_all_rows(self) -> Iterator[None]:
        """Extend the proof of a conflict, raised inside the block, to all rows by weights of zero."""
        try:
            yield
        except NoEquilibrium as error:
            if isinstance(error.proof, Conflict):
                normal, tie = np.zeros(self.problem.contacts), np.zeros(self.problem.ties)
                normal[self._fewer.contacts.kept], tie[self._fewer.ties.kept] = error.proof.normal, error.proof.tie
                error.proof = replace(error.proof, normal=normal, tie=tie)
            raise

    @property
    def expanded(self) -> Candidate:
        """Return the candidate in the unknowns and rows of the problem."""
        whole: Candidate = self._fewer.spread(self._run.expanded)
        return whole

    @property
    def start(self) -> Candidate:
        """Return the start for another load."""
        whole: Candidate = self._fewer.spread(self._run.start)
        return whole

    def final(self) -> Final:
        """Return the answer to be certified, with a force for every row."""
        self._run.polish = self.polish
        fewer = self._fewer
        with self._run.meter.running():
            found = self._run.final()
            whole: Final = fewer.spread(found)
            kept = fewer.contacts.kept, fewer.ties.kept
            answers = found.answer, whole.answer
            remember_of_all_rows(fewer.problem, self.problem, answers, fewer.contacts.matrix, kept)
        return whole

    def work(self, corrections: int) -> Work:
        """Return the work so far, without the certificate of all rows."""
        return self._run.work(corrections)

    def refuse_conflict(self) -> None:
        """Raise NoEquilibrium if the constraints conflict."""
        with self._proofs_of_all_rows():
            self._run.refuse_conflict()

    def _certified(self, started: float) -> tuple[Solution, bool]:
        solution, polished = super()._certified(started)
        certificate = solution.certificate
        noted = replace(certificate, notes=(*certificate.notes, *self._fewer.notes))
        return replace(solution, certificate=noted), polished


WithoutFriction = Callable[[ContactProblem], tuple[Vector, Work]]


def solve_among(
    problem: ContactProblem,
    start: Solution | None,
    solve: Callable[[ContactProblem, Solution | None], Solution],
    without_friction: WithoutFriction,
) -> Solution | None:
    """Solve a problem with a growing subset of its contacts, and certify the answer with all contacts.

    Returns None if the contacts are few or no subset is found. If the subset cannot hold the bodies, all contacts are
    used.

    Parameters
    ----------
    problem : ContactProblem
    start : Solution or None, where to start from, of all contacts
    solve : function of a problem of the candidates and a start, returns its solution
    without_friction : function of a problem
        Returns normal forces (m,) of the problem without friction and what they have cost.
    """
    started = time.perf_counter()
    candidates, spent = _first(problem, start, without_friction)
    while candidates is not None:
        tell(f"{len(candidates)} of {problem.contacts} contacts are candidates")
        subset = among(problem, candidates)
        try:
            solution = solve(subset, _restricted(start, subset, candidates))
        except NoEquilibrium:
            spent = _spent_on(subset).after(spent)
            take_all(problem)
            solution = solve(problem, start)
            return replace(solution, work=solution.work.after(spent), seconds=time.perf_counter() - started)
        except (NotConverged, NotCertified) as error:
            if isinstance(error.solution, Solution):
                error.solution = _of_all(problem, candidates, error.solution, spent, started)
            raise
        wider = widened(problem, candidates, _gap(problem, solution.displacement), solution.displacement)
        if wider is None:
            return _of_all(problem, candidates, solution, spent, started)
        spent = solution.work.after(spent)
        candidates = wider
    return None


def _first(
    problem: ContactProblem, start: Solution | None, without_friction: WithoutFriction
) -> tuple[Indices | None, Work]:
    """Return the first subset, None for all contacts, and the work of finding it.

    With friction it is that of the last load, or contacts near those closed at the start, or those closed without
    friction.
    """
    if not problem.frictional or not contacts_are_many(problem) or problem._computed.subset is not None:
        return first_candidates(problem), Work()
    if start is not None:
        return candidates_around(problem, np.flatnonzero(start.normal_force > 0)), Work()
    try:
        force, work = without_friction(problem)
    except (NoEquilibrium, NotConverged, NotCertified):
        return None, Work()
    return candidates_around(problem, np.flatnonzero(force > 0)), work


def _spent_on(subset: ContactProblem) -> Work:
    """Return the work spent on a problem without an answer."""
    condensation = condense(subset)
    return Work(factorisations=condensation.factorisations, back_substitutions=condensation.back_substitutions)


def _gap(problem: ContactProblem, displacement: Vector) -> Vector:
    return np.asarray(problem.gap - problem.normal @ displacement)


def _restricted(start: Solution | None, subset: ContactProblem, candidates: Indices) -> Solution | None:
    if start is None:
        return None
    answer = start.answer
    friction = None if answer.friction_force is None else answer.friction_force[candidates]
    few = replace(answer, normal_force=answer.normal_force[candidates], friction_force=friction)
    return replace(start, problem=subset, answer=few)


def _of_all(problem: ContactProblem, candidates: Indices, solution: Solution, spent: Work, started: float) -> Solution:
    """Return the solution with all contacts, certified with all of them."""

    def spread(force: Array) -> Array:
        everywhere = np.zeros((problem.contacts, *force.shape[1:]))
        everywhere[candidates] = force
        return everywhere

    def of_all(found: Any) -> Any:
        friction = None if problem.slip_origin is None else np.zeros_like(problem.slip_origin)
        if found.answer.friction_force is not None:
            friction = spread(found.answer.friction_force)
        answer = replace(found.answer, normal_force=spread(found.answer.normal_force), friction_force=friction)
        return replace(found, problem=problem, answer=answer)

    answered = time.perf_counter()
    raw = solution.raw
    whole: Solution = of_all(solution)
    whole = replace(whole, certificate=certificate_of(problem, whole.answer))
    certified = time.perf_counter()
    return replace(
        whole,
        contact_status=contact_status(problem, whole.certificate),
        raw=None if raw is None else of_all(raw),
        seconds=certified - started,
        certify_seconds=certified - answered,
        work=solution.work.after(spent),
    )
