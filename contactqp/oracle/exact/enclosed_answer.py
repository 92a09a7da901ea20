"""From a problem of floats that is not small to an `ExactSolution` of intervals."""

from __future__ import annotations

import time
from fractions import Fraction

import numpy as np
import scipy.sparse as sp

from contactqp.errors import NoEquilibrium, Unsupported
from contactqp.model.solution import FreeMotion
from contactqp.oracle.exact.definite import SAFE
from contactqp.oracle.exact.enclosure import Enclosure, enclose
from contactqp.oracle.exact.exact_solution import ExactSolution, Floats, Fractions, Parts
from contactqp.oracle.exact.fixed_point import Fixed, FixedMatrix, fixed
from contactqp.oracle.exact.free_motions import carried, hold
from contactqp.oracle.exact.rational_answer import Asked, symmetrised
from contactqp.oracle.exact.refinement import refine
from contactqp.solving.solve import solve

REGULAR = "the system of this contact set is regular: these are its only displacements and forces"
STRICT = "every normal force of the set and every gap outside of it is strictly positive"
MINIMUM = "the stiffness is positive definite within the ties: the equilibrium is the only one, and the minimum"
BUT_FOR_MOTIONS = "the stiffness is positive definite once free motions are held: no other equilibrium but for these"
LOCAL = (
    "the stiffness is positive definite against ties and contacts that push: the equilibrium is a strict local minimum"
)
FLOATS_THAT_FLOAT = (
    "the floats of the stiffness are not proven to be positive definite, as a body that floats on its contacts has "
    "them: that no other equilibrium lies far away is not proven"
)


def prove_by_enclosure(asked: Asked) -> ExactSolution:
    """Intervals of all displacements and forces.

    Raises
    ------
    NotCertified
        The contact set is not proven: contacts that just touch, redundant ones, bodies that float.
    NotConverged
        Refinement ends too early.
    NoEquilibrium
        Floats find none.
    Unsupported
        Friction.
    """
    problem = asked.problem
    if problem.frictional:
        raise Unsupported(f"exact: friction with {problem.dimension} unknowns, too many for rational numbers")
    try:
        first = solve(problem, asked.method, **asked.options)
        held = hold(problem, first) if first.free_motions else None
        if held is None:
            refined = refine(problem, asked.method, first=first, **asked.options)
        else:
            refined = refine(held.problem, asked.method, **asked.options)
    except NoEquilibrium as error:
        raise NoEquilibrium(f"{error} (found in floats, not proven)") from None
    found = enclose(refined)
    notes = symmetrised(problem)
    notes += () if held is None else (carried(held, refined, found.tie_force),)
    return _answer(asked, found, first.free_motions, notes)


def _answer(asked: Asked, found: Enclosure, motions: tuple[FreeMotion, ...], notes: tuple[str, ...]) -> ExactSolution:
    problem, refined = asked.problem, found.refined
    push, ranges = refined.normal_force.fractions(), np.empty((problem.contacts, 2), dtype=object)
    ranges[:, 0], ranges[:, 1] = push, push
    gap = refined.gap.fractions()
    gap[refined.closed] = Fraction(0)
    closed = np.zeros(problem.contacts, dtype=bool)
    closed[refined.closed] = True
    slip, slip_radius = _slip(found)
    rubs = None if slip is None else slip.shape
    none = np.zeros(0) if rubs is None else np.zeros(rubs)
    return ExactSolution(
        problem=problem,
        displacement=refined.displacement.fractions(),
        normal_force=push,
        friction_force=None if rubs is None else fixed(none).fractions().reshape(rubs),
        tie_force=refined.tie_force.fractions()[: problem.ties],
        gap=gap,
        slip=slip,
        contact_status=tuple("closed" if yes else "open" for yes in closed),
        rational=False,
        radius=Parts(
            found.displacement,
            found.normal_force,
            None if rubs is None else none,
            found.tie_force[: problem.ties],
            found.gap,
            slip_radius,
        ),
        unique_forces=True,
        force_range=ranges,
        free_motions=motions,
        energy=None,
        equilibria=None,
        uniqueness=(),
        events=(),
        data=asked.source,
        way=f"iterative refinement in {refined.rounds} rounds, and bounds of what is left",
        proof=(REGULAR, STRICT, LOCAL if not found.definite else BUT_FOR_MOTIONS if motions else MINIMUM),
        notes=notes if found.definite else (*notes, FLOATS_THAT_FLOAT),
        method=asked.method,
        seconds=time.perf_counter() - asked.started,
    )


def _slip(found: Enclosure) -> tuple[Fractions | None, Floats | None]:
    problem = found.refined.problem
    if problem.tangent is None or problem.slip_origin is None:
        return None, None
    shape = problem.slip_origin.shape
    moved: Fixed = FixedMatrix(sp.csr_matrix(problem.tangent)) @ found.refined.displacement - fixed(problem.slip_origin)
    radius = abs(problem.tangent) @ found.displacement * SAFE
    return moved.fractions().reshape(shape), np.asarray(radius).reshape(shape)
