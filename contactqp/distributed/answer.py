"""One rank's part of an answer that nobody has judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Vector


@dataclass(frozen=True, eq=False)
class DistributedAnswer:
    """The fields of `contactqp.model.solution.Answer`, of the unknowns, contacts and ties of one rank."""

    displacement: Vector  # (n_here,) [length], zero where supports hold
    normal_force: Vector  # (m_here,) [force], positive in compression
    friction_force: NDArray[np.float64] | None  # (m_here, d-1) [force]
    tie_force: Vector  # (k_here,) [force]
