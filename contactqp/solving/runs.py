"""What an answer costs, counted by factorisations and right-hand sides.

A method's answer on the contact unknowns: condense, run it, and polish what it found.

What attempts share whose method is shown the problem as it is, with all its unknowns.

An answer with Coulomb friction by a method's own systems of stick and slip, in the problem's own unknowns.

The active set by conjugate gradients on the whole problem, where a body is too large to factorise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import BackendFailed, NotConverged, Unsupported
from contactqp.linalg.condensation import Condensation, condense, unknown_scale
from contactqp.linalg.condensation import condense as condensation_of
from contactqp.linalg.existence import describe_motion, refuse_conflict, refuse_driven_motion
from contactqp.linalg.factorization import DENSE_SIZE
from contactqp.linalg.iteration import Iteration, iterated, iteration
from contactqp.linalg.measures import lay_out
from contactqp.linalg.refinement import (
    INVISIBLE,
    closed_contacts,
    least_displacement,
    polish,
    shift_to_least_norm,
    without_noise,
)
from contactqp.linalg.saddle import saddle_point
from contactqp.linalg.scaling import nondimensional
from contactqp.linalg.schur import LARGE
from contactqp.model.arrays import Array, Vector, own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate, Final, FreeMotion, Work
from contactqp.solving.methods import Method, Settings
from contactqp.solving.methods.inexact_active_set import solve_by_iteration


class Meter:
    """Counts what one answer costs, the condensation included where it is the first to need it."""

    def __init__(self, problem: ContactProblem) -> None:
        self._problem = problem
        self._factorisations = self._back_substitutions = 0

    @contextmanager
    def running(self) -> Iterator[None]:
        factorisations, back_substitutions = self._counts()
        yield
        now = self._counts()
        self._factorisations += now[0] - factorisations
        self._back_substitutions += now[1] - back_substitutions

    def _counts(self) -> tuple[int, int]:
        known: Condensation | None = self._problem._computed.condensation
        return (known.factorisations, known.back_substitutions) if known else (0, 0)

    def read(self, iterations: int | None, corrections: int) -> Work:
        way = condense(self._problem)
        interior = self._problem.dimension - len(way.retained)
        return Work(
            factorisations=self._factorisations,
            back_substitutions=self._back_substitutions,
            iterations=iterations,
            retained=len(way.retained),
            polish_corrections=corrections,
            solver="dense" if way.solver == "superlu" and interior <= DENSE_SIZE else way.solver,
        )


class MeteredAttempt:
    """The part of an attempt that says what it costs, by its meter."""

    candidate: Candidate
    _meter: Meter

    def counting(self) -> object:
        """A context whose work counts as this attempt's."""
        return self._meter.running()

    def work(self, corrections: int) -> Work:
        """What it has cost so far."""
        return self._meter.read(self.candidate.iterations, corrections)


# The kind of methods that condense whatever they are shown.
CONDENSES_ITSELF = "active set"


class CondensedAttempt(MeteredAttempt):
    """What a method made of a problem, condensed or whole, as far as it has been looked at.

    Raises
    ------
    NoEquilibrium, NotConverged, BackendFailed, Unsupported
        As `solve`.
    """

    def __init__(self, problem: ContactProblem, method: Method, settings: Settings, condense: bool | str) -> None:
        self._problem, self._method, self._meter = problem, method, Meter(problem)
        with self._meter.running():
            self._way = _condensed(problem)
            refuse_driven_motion(problem, self._way)
            if not method.semidefinite and saddle_point(self._way, np.zeros(0, dtype=np.intp)).free.shape[1]:
                raise Unsupported(
                    f"{method.name}: bodies held by contact alone (the stiffness is singular); try active-set"
                )
            try:
                shown, self.candidate = self._run(settings, condense)
            except (NotConverged, BackendFailed):
                self.refuse_conflict()
                raise
            self._whole = shown is problem
            self._closed: NDArray[np.intp] | None = None
            if self.candidate.finite:
                self._closed = closed_contacts(
                    shown, self._way, self.candidate.displacement, self.candidate.normal_force
                )

    def final(self, polished: bool) -> Final:
        """The answer that is to be certified."""
        found = self._polished() if polished and self._method.polish else None
        return self._as_it_came() if found is None else found

    @cached_property
    def expanded(self) -> Candidate:
        """The candidate in the unknowns of the problem: back-substitution that polishing can do without."""
        if self._whole:
            return self.candidate
        _, inner = self._way.reduce_load(self._problem.load)
        return replace(self.candidate, displacement=self._way.expand(self.candidate.displacement, inner))

    @property
    def start(self) -> Candidate:
        """What another load may start from: in the unknowns of the problem, exact where the method was shown them."""
        return self.candidate if self._whole else self._way.spread_candidate(self.candidate)

    def work(self, corrections: int) -> Work:
        """What it has cost so far; a method that was shown all unknowns saw them all, unless it condenses by itself."""
        spent = super().work(corrections)
        if self._whole and self._method.kind != CONDENSES_ITSELF:
            return replace(spent, retained=self._problem.dimension)
        return spent

    def refuse_conflict(self) -> None:
        """Raise NoEquilibrium if the constraints conflict."""
        refuse_conflict(self._problem, self._way)

    def _run(self, settings: Settings, wanted: bool | str) -> tuple[ContactProblem, Candidate]:
        """The problem as the method was shown it, and the method's candidate."""
        problem, way = self._problem, self._way
        # Condensed, motions that nothing drives or resists are held: with them "auto" condenses even where nothing
        # lies inside.
        smaller = len(way.retained) < problem.dimension or way.rigid.count > 0
        bare = not problem.contacts and not problem.ties
        if not bare and not (smaller if wanted == "auto" else wanted):
            return problem, _run_scaled(problem, self._method, settings)
        load, inner = way.reduce_load(problem.load)
        reduced = way.reduced_problem(problem, load, inner)
        if bare:
            return reduced, _linear(way, load)
        if settings.warm_start is not None:
            settings = replace(settings, warm_start=way.restrict_candidate(settings.warm_start))
        return reduced, _run_scaled(reduced, self._method, settings)

    def _polished(self) -> Final | None:
        """The refined answer on the candidate's contact set, or None where its signs do not hold."""
        problem, way = self._problem, self._way
        if self._closed is None:
            return None
        answer, corrections, holds = polish(problem, way, self._closed, self._method.corrections)
        if not holds:
            return None
        answer, free = least_displacement(problem, way, answer)
        return Final(*without_noise(problem, way, answer), described(self._problem, free), corrections, polished=True)

    def _as_it_came(self) -> Final:
        """The candidate, its free motions put to rest as far as they are free."""
        candidate = self.expanded
        u, force, tie = candidate.displacement, candidate.normal_force, candidate.tie_force
        if not candidate.finite:
            return Final(u, force, tie)
        shift, free = shift_to_least_norm(self._problem, self._way, Answer(u, force, None, tie))
        return Final(u + shift, force, tie, described(self._problem, free))


def described(problem: ContactProblem, free: Array) -> tuple[FreeMotion, ...]:
    """The columns of a basis (n, q) as motions whose largest unknown moves by one, in words."""
    directions = (direction / direction[np.argmax(abs(direction))] for direction in free.T)
    return tuple(FreeMotion(direction, describe_motion(problem, direction)) for direction in directions)


def _condensed(problem: ContactProblem) -> Condensation:
    """The condensation. Meanwhile, what refinement and certificate need of a large stiffness is laid out by another
    thread: sparse solvers analyse a matrix on one core."""
    if problem.dimension < LARGE:
        return condensation_of(problem)
    with ThreadPoolExecutor(1) as pool:
        laid_out = pool.submit(own_floating_point(lay_out), problem)
        way = condensation_of(problem)
        laid_out.result()
    return way


def _linear(way: Condensation, load: Vector) -> Candidate:
    """Without contacts and ties there is one linear system and nothing to choose."""
    none = np.zeros(0)
    x, _, _ = saddle_point(way, np.zeros(0, dtype=np.intp)).solve(load, none, none)
    return Candidate(x, none, none, status="a linear system")


def _run_scaled(problem: ContactProblem, method: Method, settings: Settings) -> Candidate:
    if not method.scale:
        return method.solve(problem, settings)
    twin, scaling = nondimensional(problem)
    if settings.warm_start is not None:
        settings = replace(settings, warm_start=scaling.scale(settings.warm_start))
    return scaling.unscale(method.solve(twin, settings))


class WholeAttempt:
    """The part of an attempt that hands out its candidate: nothing is to be expanded."""

    candidate: Candidate

    @property
    def expanded(self) -> Candidate:
        """The candidate in the unknowns of the problem."""
        return self.candidate

    @property
    def start(self) -> Candidate:
        """What another load may start from."""
        return self.candidate


class EnforcedAttempt(WholeAttempt, MeteredAttempt):
    """The method's candidate as it came: textbook systems in the numbers of the problem, nothing condensed or polished.

    Raises
    ------
    Unsupported
        Two tangential directions a contact, or bodies too large to factorise.
    NoEquilibrium
        The constraints conflict.
    NotConverged, InvalidProblem
        As the method.
    """

    def __init__(
        self,
        problem: ContactProblem,
        method: Method,
        solve_friction: Callable[[ContactProblem, Settings], Candidate],
        settings: Settings,
    ) -> None:
        if problem.slip_origin is not None and problem.slip_origin.shape[1] > 1:
            raise Unsupported(
                f"{method.name}: two tangential rows a contact; its systems of stick and slip are those of the plane"
            )
        if iterated(problem):
            raise Unsupported(f"{method.name}: a body this large is not factorised, and its systems of friction are")
        self._problem, self._method, self._meter = problem, method, Meter(problem)
        with self._meter.running():
            try:
                self.candidate = solve_friction(problem, settings)
            except NotConverged:
                self.refuse_conflict()
                raise

    def final(self, polished: bool) -> Final:
        """The answer that is to be certified: the candidate, without what its refinement has left of zeros."""
        del polished
        u, normal, friction, tie = _without_noise(self._problem, self.candidate)
        # A spring's stretch is no slip, which a certificate that knows of no springs cannot tell.
        status = None if self._method.exact else self.candidate.contact_status
        return Final(u, normal, tie, friction_force=friction[:, None], contact_status=status)

    def work(self, corrections: int) -> Work:
        """What it has cost so far."""
        return replace(super().work(corrections), retained=self._problem.dimension)

    def refuse_conflict(self) -> None:
        """Raise NoEquilibrium if the constraints conflict."""
        refuse_conflict(self._problem, condense(self._problem))


def _without_noise(problem: ContactProblem, found: Candidate) -> tuple[Vector, Vector, Vector, Vector]:
    """Displacement, normal, friction and tie forces, zero where they are no more than what refinement leaves of it.

    All are compared as square roots of energy: forces by the rows that they act along.
    """
    D = unknown_scale(problem)
    friction = np.zeros(problem.contacts) if found.friction_force is None else found.friction_force[:, 0]
    values = (found.displacement, found.normal_force, friction, found.tie_force)
    rows = (problem.normal, sp.csr_array(problem.tangent), problem.tie)
    units = (1.0 / D, *(np.sqrt(row.power(2) @ D**2) for row in rows))
    sizes = [abs(value) * unit for value, unit in zip(values, units, strict=True)]
    largest = max(np.max(size, initial=0.0) for size in (*sizes, abs(problem.load) * D))
    u, normal, friction, tie = (
        np.where(size < INVISIBLE * largest, 0.0, value) for value, size in zip(values, sizes, strict=True)
    )
    return u, normal, friction, tie


_ELSE = "to factorise it all the same: CONTACTQP_SPARSE_SOLVER=pardiso or superlu"


class IteratedAttempt(WholeAttempt):
    """The answer, its last system solved to the accuracy that the certificate asks for.

    Raises
    ------
    Unsupported
        Another method than the active set, or a wish to condense.
    NotConverged
        As `solve_by_iteration`.
    """

    def __init__(self, problem: ContactProblem, method: Method, settings: Settings, condense: bool | str) -> None:
        if method.kind != "active set":
            raise Unsupported(
                f"{method.name}: a body this large is not factorised, only iterated on, by active-set; {_ELSE}"
            )
        if condense is True:
            raise Unsupported(f"{method.name}: condensing a body this large means factorising it; {_ELSE}")
        known: Iteration | None = problem._computed.iteration
        self._before = known.krylov_iterations if known else 0
        self._way = iteration(problem)
        self._size = problem.dimension
        self.candidate = solve_by_iteration(problem, self._way, settings)

    def final(self, polished: bool) -> Final:
        """The answer that is to be certified: the candidate."""
        del polished
        return Final(self.candidate.displacement, self.candidate.normal_force, self.candidate.tie_force)

    def counting(self) -> object:
        """A context whose work counts as this attempt's."""
        return nullcontext()

    def work(self, corrections: int) -> Work:
        """What it has cost so far."""
        return Work(
            iterations=self.candidate.iterations,
            retained=self._size,
            polish_corrections=corrections,
            solver=self._way.solver,
            krylov_iterations=self._way.krylov_iterations - self._before,
        )

    def refuse_conflict(self) -> None:
        """Does nothing: constraints that conflict are not told from others without a factorisation."""
