"""What solving a local problem gives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Vector
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem_data import ReadOnly
from contactqp.model.verdicts import LocalCertificate


@dataclass(frozen=True, eq=False)
class LocalSolution(ReadOnly):
    """Forces and velocities of one LocalProblem, with the certificate that judged them."""

    problem: LocalProblem = field(repr=False)
    force: NDArray[np.float64]  # (m, d) r, on the body, in the order (N, T1, T2)
    velocity: NDArray[np.float64]  # (m, d) u = W r + q + V l
    joint_force: Vector  # (p,) l
    contact_status: NDArray[np.str_]  # (m,) of open, stick, slip, and closed without friction
    certificate: LocalCertificate
    method: str  # the algorithm, and the convex method where it has one
    seconds: float
    iterations: int
    history: tuple[float, ...] = field(default=(), repr=False)  # the algorithm's own measure of progress


def local_status(problem: LocalProblem, certificate: LocalCertificate) -> NDArray[np.str_]:
    """(m,) of open, stick, slip, and closed without friction: each contact in the certificate's own measures."""
    push, tolerance = certificate.force_measure, certificate.tolerance
    sliding = np.where(certificate.slip_measure > tolerance, "slip", "stick")
    closed = np.where(problem.friction > 0, sliding, "closed")
    return np.where(push > tolerance, closed, "open").astype("<U8")
