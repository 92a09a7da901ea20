"""An answer with Coulomb friction by a method's own systems of stick and slip, in the problem's own unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from contactqp.errors import NotConverged, Unsupported
from contactqp.linalg.condensation import condense, unknown_scale
from contactqp.linalg.existence import refuse_conflict
from contactqp.linalg.iteration import iterated
from contactqp.linalg.polishing import INVISIBLE
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate, Final, Work
from contactqp.solving.metering import Meter, MeteredAttempt
from contactqp.solving.methods import Method, Settings
from contactqp.solving.whole_attempt import WholeAttempt


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
