"""Bodies that floats leave free to move: held where nothing pushes, so that everything else can be enclosed.

K z = 0 holds to rounding only where z is a motion of assembled bodies, and what rounding leaves of the load along z has
nothing to balance it. As many unknowns as there are motions are therefore held where floats leave them, which neither
strains nor loads anything; what the holding carries is enclosed with the rest, and has to be rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.errors import NotCertified
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.oracle.exact.exact_solution import Floats
from contactqp.oracle.exact.refinement import Refined

# What may be held, as a part of all forces that there are.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Held:
    """A problem with ties in addition that hold its free motions."""

    problem: ContactProblem
    unknowns: NDArray[np.intp]  # (r,) held, one a motion
    free: Solution  # of the problem as it was


def hold(problem: ContactProblem, solution: Solution) -> Held:
    """The problem with one unknown a free motion tied to where the solution has it."""
    motions = np.array([motion.direction for motion in solution.free_motions])
    # Column pivots are unknowns whose rows of the motions are independent, and well so.
    order = scipy.linalg.qr(motions, mode="r", pivoting=True)[1]
    unknowns = np.sort(order[: len(motions)])
    rows = sp.identity(problem.dimension, format="csr")[unknowns]
    ties = sp.vstack([sp.csr_matrix(problem.tie), rows]).tocsr()
    values = np.concatenate([problem.tie_value, solution.displacement[unknowns]])
    held = problem.replace(tie=ties, tie_value=values)
    return Held(held, unknowns, solution)


def carried(held: Held, refined: Refined, radius: Floats) -> str:
    """In words: what is held where, and the most that the holding carries.

    Raises
    ------
    NotCertified
        It carries more than rounding: the motions are not free.
    """
    problem = held.problem
    first = problem.ties - len(held.unknowns)
    most = float(np.max(abs(refined.tie_force.floats()[first:]) + radius[first:]))
    u, push = abs(refined.displacement.floats()), refined.normal_force.floats()
    there = abs(problem.stiffness) @ u + abs(problem.load) + abs(problem.normal).T @ push
    if not most <= ROUNDING * float(np.max(there)):
        raise NotCertified(
            f"exact: motions that floats call free take {most:.3g} {problem.units.force}".rstrip() + " to hold",
            held.free,
        )
    named = ", ".join(problem.dof_name(int(j)) for j in held.unknowns)
    return (
        f"free motions are held at {named}, where floats leave them; what rounding has left to hold is at most "
        f"{most:.2g} {problem.units.force}".rstrip()
    )
