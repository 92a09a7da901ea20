"""DistributedSolution: what the ranks have of an answer, with the certificate that judged it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.answer import DistributedAnswer
from contactqp.distributed.problem import DistributedProblem
from contactqp.model.arrays import Vector
from contactqp.model.solution import Certificate, Work


@dataclass(frozen=True, eq=False)
class DistributedSolution:
    """Displacement and forces of one problem; `answer` is the part of the rank.

    What `contactqp.Solution` has whole is gathered on every rank, collectively and once, when it is asked for.
    """

    problem: DistributedProblem = field(repr=False)
    answer: DistributedAnswer = field(repr=False)
    status: NDArray[np.str_] = field(repr=False)  # (m_here,) of open, closed, grazing, stick, slip
    certificate: Certificate  # the same on all ranks but for what is contact by contact
    method: str
    seconds: float  # to the certified answer, of the slowest rank
    certify_seconds: float  # of these, for the certificate
    work: Work
    motions: NDArray[np.float64] = field(repr=False)  # (n_here, q) that no load drives and no contact or tie resists

    @cached_property
    def displacement(self) -> Vector:
        """(n,) in the numbers of one process."""
        return self.problem.whole(self.answer.displacement, self.problem.dof_number)

    @cached_property
    def normal_force(self) -> Vector:
        """(m,)."""
        return self.problem.whole(self.answer.normal_force, self.problem.contact_number)

    @cached_property
    def friction_force(self) -> NDArray[np.float64] | None:
        """(m, d-1), None without tangential rows."""
        force = self.answer.friction_force
        return None if force is None else self.problem.whole(force, self.problem.contact_number)

    @cached_property
    def tie_force(self) -> Vector:
        """(k,)."""
        return self.problem.whole(self.answer.tie_force, self.problem.tie_number)

    @cached_property
    def gap(self) -> Vector:
        """(m,) g - E_N u, positive when open [length]."""
        gap = self.problem.gap - self.problem.normal.lengths(self.answer.displacement)
        return self.problem.whole(gap, self.problem.contact_number)

    @cached_property
    def contact_status(self) -> NDArray[np.str_]:
        """(m,)."""
        return self.problem.whole(self.status, self.problem.contact_number)

    @cached_property
    def free_motions(self) -> tuple[Vector, ...]:
        """(n,) each, its largest component one."""
        every = [self.problem.whole(motion, self.problem.dof_number) for motion in self.motions.T]
        return tuple(motion / motion[np.argmax(abs(motion))] for motion in every)

    @cached_property
    def energy(self) -> float:
        """1/2 u'Ku - f'u."""
        u = self.answer.displacement
        return self.problem.ranks.dot(u, self.problem.product(u) / 2 - self.problem.load)
