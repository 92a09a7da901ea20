"""The course chapter's static examples with their exact answers, as the method tests use them.

Every answer is the exact rational number of a two- or three-line derivation; forces are positive in compression.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate


@dataclass(frozen=True, eq=False)
class Example:
    name: str
    problem: ContactProblem
    displacement: tuple[float, ...]
    contact_load: tuple[float, ...]  # E_N' l_N, unique where redundant contacts make l_N itself not unique
    tie_force: tuple[float, ...] = ()


def ratio(numerator: int, denominator: int) -> float:
    return float(Fraction(numerator, denominator))


def bar(load: float, gap: float = 1e-3) -> ContactProblem:
    """Example 2.5: one bar, EA/L = 157500 kN/m, a wall 1 mm away."""
    return ContactProblem(stiffness=[[157500.0]], load=[load], normal=[[1.0]], gap=[gap])


# Example 2.10: two-bar truss over a frictionless floor 1 mm below, kN and m.
TRUSS = ContactProblem(
    stiffness=[[59803.0, 6883.1], [6883.1, 77443.0]], load=[60.0, -100.0], normal=[[0.0, -1.0]], gap=[1e-3]
)
TRUSS_FORCE = ratio(180933933661, 5980300000)
# Example 2.13: two bars that meet over a gap of 1 mm, P = 300 kN.
TWO_BARS = ContactProblem(stiffness=np.diag([157500.0, 315000.0]), load=[300.0, 0.0], normal=[[1.0, -1.0]], gap=[1e-3])
# A body that nothing but the obstacle holds.
HELD = ContactProblem(stiffness=[[0.0]], load=[2.0], normal=[[1.0]], gap=[0.5])
DUPLICATE = ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0], [1.0]], gap=[1e-3, 1e-3])
# The second contact says u <= 1/2 mm; the first, u <= 1 mm, has a row that depends on it.
DEPENDENT = ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0], [2.0]], gap=[1e-3, 1e-3])
TIE = {"tie": [[1.0, -1.0]], "tie_value": [0.0]}
TIED = ContactProblem(stiffness=np.eye(2), load=[1.0, 0.0], normal=np.zeros((0, 2)), gap=[], **TIE)
TIED_TOUCHING = ContactProblem(stiffness=np.eye(2), load=[1.0, 0.0], normal=[[1.0, 0.0]], gap=[0.2], **TIE)
FREE = ContactProblem(stiffness=np.eye(2), load=[1.0, 0.0], normal=np.zeros((0, 2)), gap=[])

EXAMPLES = (
    Example("2.5, open", bar(100.0), (ratio(1, 1575),), (0.0,)),
    Example("2.5, P = 300 kN", bar(300.0), (1e-3,), (142.5,)),
    Example("2.5, overlap", bar(0.0, gap=-1e-3), (-1e-3,), (157.5,)),
    Example("2.10", TRUSS, (ratio(668831, 598030000), -1e-3), (0.0, -TRUSS_FORCE)),
    Example("2.13", TWO_BARS, (ratio(41, 31500), ratio(19, 63000)), (95.0, -95.0)),
    Example("floating", HELD, (0.5,), (2.0,)),
    Example("duplicate", DUPLICATE, (1e-3,), (142.5,)),
    Example("dependent", DEPENDENT, (5e-4,), (221.25,)),
    Example("tied", TIED, (0.5, 0.5), (0.0, 0.0), (0.5,)),
    Example("tied and touching", TIED_TOUCHING, (0.2, 0.2), (0.6, 0.0), (0.2,)),
    Example("no constraint", FREE, (1.0, 0.0), (0.0, 0.0)),
)


def supported_bar(size: float) -> Example:
    """K alone is singular, the tie is its support, where the displacement is zero; the other end meets a stop."""
    K = np.array([[size, -size], [-size, size]])
    bar = ContactProblem(K, [0.0, 3 * size], normal=[[0.0, 1.0]], gap=[1.0], tie=[[1.0, 0.0]])
    return Example(f"supported, {size:g}", bar, (0.0, 1.0), (0.0, 2 * size), (size,))


# A beam element (EI = L = 1) clamped at its left end by ties; its right end meets a stop.
CLAMPED = ContactProblem(
    stiffness=[[12.0, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]],
    load=[0.0, 0, -1, 0],
    normal=[[0.0, 0, -1, 0]],
    gap=[0.25],
    tie=[[1.0, 0, 0, 0], [0, 1, 0, 0]],
)
SUPPORTED = (
    *map(supported_bar, (1.0, 1e-7, 1e9)),
    Example("clamped beam", CLAMPED, (0.0, 0.0, -0.25, -0.375), (0.0, 0.0, -0.25, 0.0), (-0.75, -0.75)),
)
# The second tie says what the first does; together they pull the two unit springs half a unit apart.
REPEATED_TIES = Example(
    "repeated ties",
    ContactProblem(
        stiffness=np.eye(2),
        load=[1.0, 0.0],
        normal=[[1.0, 0.0]],
        gap=[9.0],
        tie=[[1.0, -1.0], [-2.0, 2.0]],
        tie_value=[0.5, -1.0],
    ),
    (0.75, 0.25),
    (0.0, 0.0),
    (0.25, 0.0),
)


def require_answer(example: Example, candidate: Candidate, tolerance: float) -> None:
    """Displacement, contact and tie forces, each within `tolerance` of its largest component; no tension."""
    require_near("displacement", candidate.displacement, example.displacement, tolerance)
    contact_load = example.problem.normal.T @ candidate.normal_force
    largest = max(map(abs, (*example.contact_load, *example.problem.load)))
    require_near("contact load", contact_load, example.contact_load, tolerance, largest)
    require_near("tie force", candidate.tie_force, example.tie_force, tolerance)
    if np.any(candidate.normal_force < -tolerance * largest):
        raise AssertionError(f"tension: {candidate.normal_force}")


def require_near(
    what: str, values: ArrayLike, expected: ArrayLike, tolerance: float, largest: float | None = None
) -> None:
    values, expected = np.asarray(values, dtype=float), np.asarray(expected, dtype=float)
    if values.shape != expected.shape:
        raise AssertionError(f"{what}: {values} instead of {expected}")
    size = float(np.max(np.abs(expected), initial=0.0)) if largest is None else largest
    if not np.all(np.abs(values - expected) <= tolerance * size):
        raise AssertionError(f"{what}: {values} instead of {expected}")
