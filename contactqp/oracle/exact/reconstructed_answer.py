"""From an approximation whose signs an enclosure cannot decide to a proven `ExactSolution` of rational numbers."""

from __future__ import annotations

import time
from fractions import Fraction

import numpy as np

from contactqp.errors import NotCertified, NotConverged
from contactqp.model.solution import Solution
from contactqp.oracle.exact.enclosed_answer import FLOATS_THAT_FLOAT, LOCAL, MINIMUM
from contactqp.oracle.exact.enclosure import is_convex, regular
from contactqp.oracle.exact.exact_solution import ExactSolution, Fractions
from contactqp.oracle.exact.fixed_point import fixed
from contactqp.oracle.exact.rational_answer import PROVEN, Asked, symmetrised
from contactqp.oracle.exact.reconstruction import DIGITS, Reconstructed, reconstruct
from contactqp.oracle.exact.refinement import refine

ONLY = "the rows of all contacts without gap are independent: these are the only forces that hold this displacement"


def prove_by_reconstruction(asked: Asked, first: Solution) -> ExactSolution | None:
    """Rational numbers with small denominators, proven; None where there are none, or others beside them."""
    problem = asked.problem
    try:
        found = reconstruct(refine(problem, asked.method, DIGITS, first=first, **asked.options))
        if found is None:
            return None
        gap = -found.displacement.times(problem.normal, problem.gap).fractions()
        regular(problem, np.flatnonzero(gap == 0), first)
        convex = is_convex(problem)
        if not convex:
            regular(problem, np.flatnonzero(found.normal_force.fractions() > 0), first)
    except (NotCertified, NotConverged):
        return None
    return _answer(asked, found, gap, convex)


def _answer(asked: Asked, found: Reconstructed, gap: Fractions, convex: bool) -> ExactSolution:
    problem = asked.problem
    u, push = found.displacement.fractions(), found.normal_force.fractions()
    ranges = np.empty((problem.contacts, 2), dtype=object)
    ranges[:, 0], ranges[:, 1] = push, push
    none, slip = None, None
    if problem.tangent is not None and problem.slip_origin is not None:
        shape = problem.slip_origin.shape
        slip = found.displacement.times(problem.tangent, problem.slip_origin).fractions().reshape(shape)
        none = np.full(shape, Fraction(0), dtype=object)
    load = fixed(problem.load).fractions()
    # u'(K u - f) - f'u
    twice = found.displacement.times(problem.stiffness, problem.load).fractions() - load
    return ExactSolution(
        problem=problem,
        displacement=u,
        normal_force=push,
        friction_force=none,
        tie_force=found.tie_force.fractions(),
        gap=gap,
        slip=slip,
        contact_status=tuple(_status(x, force) for x, force in zip(gap, push, strict=True)),
        rational=True,
        radius=None,
        unique_forces=True,
        force_range=ranges,
        free_motions=(),
        energy=sum((x * y for x, y in zip(u, twice, strict=True)), Fraction(0)) / 2,
        equilibria=None,
        uniqueness=(),
        events=(),
        data=asked.source,
        way="iterative refinement, and the fractions nearest to it",
        proof=(*PROVEN, ONLY, MINIMUM if convex else LOCAL),
        notes=symmetrised(problem) + (() if convex else (FLOATS_THAT_FLOAT,)),
        method=asked.method,
        seconds=time.perf_counter() - asked.started,
    )


def _status(gap: Fraction, force: Fraction) -> str:
    return "closed" if force else "open" if gap else "grazing"
