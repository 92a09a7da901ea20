"""A method's answer on the contact unknowns: condense, run it, and polish what it found."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import BackendFailed, NotConverged, Unsupported
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.condensation import condense as condensation_of
from contactqp.linalg.elimination import LARGE
from contactqp.linalg.existence import describe_motion, refuse_conflict, refuse_driven_motion
from contactqp.linalg.measures import lay_out
from contactqp.linalg.polishing import closed_contacts, least_displacement, polish, shift_to_least_norm, without_noise
from contactqp.linalg.saddle import saddle_point
from contactqp.linalg.scaling import nondimensional
from contactqp.model.arrays import Array, Vector
from contactqp.model.floating_point import own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate, Final, FreeMotion, Work
from contactqp.model.verdicts import Answer
from contactqp.solving.metering import Meter, MeteredAttempt
from contactqp.solving.methods import Method, Settings

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
