"""The exact equilibrium with friction: the combination of open, stick and slip that floats propose, solved and proven.

In the plane slip goes one way or the other. In space its direction has to be rational; t = (1 - q^2, 2 q) / (1 + q^2)
runs through all rational directions with q, and the one nearest to what floats say is tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat

from contactqp.errors import Unsupported
from contactqp.linalg.rational import column, fraction, from_fraction
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.oracle.exact.closed_set import Combination, Direction, Settled, balanced, system_of
from contactqp.oracle.exact.exact_problem import RationalProblem
from contactqp.solving.friction.exact_enumeration import (
    MOST_CONTACTS,
    MOST_UNKNOWNS,
    ExactEquilibrium,
    exact_equilibria,
)

# All 4^3 combinations are tried in some ten milliseconds; of more contacts only where the proposal fails.
LISTED = 3
# Directions that people write down have small numbers.
DENOMINATOR = 10**5


@dataclass(frozen=True, eq=False)
class Proposal:
    """What floats make of a frictional problem, None where they fail."""

    problem: ContactProblem
    solution: Solution | None


@dataclass(frozen=True, eq=False)
class SettledWithFriction:
    """A proven equilibrium, and how many there are (None: not counted)."""

    settled: Settled
    equilibria: int | None
    continuum: bool = False


def settle_with_friction(data: RationalProblem, proposal: Proposal) -> SettledWithFriction | None:
    """None, proven, where no combination of open, stick and slip is an equilibrium.

    Raises
    ------
    Unsupported
        In space, where slip directions are irrational; or the proposal fails and there are too many combinations.
    """
    found = next((one for u in _proposed(data, proposal.solution) if (one := balanced(data, u)) is not None), None)
    countable = data.width == 1 and data.contacts <= MOST_CONTACTS and data.unknowns <= MOST_UNKNOWNS
    if found is not None and not (countable and data.contacts <= LISTED):
        settled = _called(found, "the proposed combination of open, stick and slip")
        return SettledWithFriction(settled, None)
    if not countable:
        where = "the slip directions of floats are no rational ones" if data.width > 1 else "its signs fail exactly"
        raise Unsupported(f"exact: the combination of open, stick and slip that floats propose is not proven: {where}")
    states = exact_equilibria(proposal.problem, **_numbers(data))
    if not states:
        return None
    count, continuum = len(states), any(one.continuum for one in states)
    if found is not None:
        settled = _called(found, "the proposed combination of open, stick and slip")
        return SettledWithFriction(settled, count, continuum)
    for state in sorted(states, key=lambda state: _distance(state, proposal.solution)):
        if (found := balanced(data, column(state.displacement))) is not None:
            settled = _called(found, "all combinations of open, stick and slip")
            return SettledWithFriction(settled, count, continuum)
    raise ArithmeticError("a listed equilibrium fails the exact proof")


def _called(found: Settled, way: str) -> Settled:
    return Settled(found.answer, found.unique_forces, found.ranges, found.motions, way)


def _distance(state: ExactEquilibrium, solution: Solution | None) -> float:
    if solution is None:
        return 0.0
    return float(np.linalg.norm(state.displacement.astype(float) - solution.displacement))


def _proposed(data: RationalProblem, solution: Solution | None) -> Iterator[fmpq_mat]:
    """Displacements of the combination that floats are in, and of it with contacts that just touch held closed."""
    if solution is None:
        return
    states = solution.contact_status
    for touching in (False, True):
        closed = tuple(i for i, word in enumerate(states) if word != "open" and (touching or word != "grazing"))
        stuck = tuple(i for i in closed if data.friction[i] > 0 and states[i] != "slip")
        directions = {i: d for i in closed if states[i] == "slip" and (d := _direction(solution, i))}
        solved = system_of(data, Combination(closed, stuck, directions)).solve()
        if solved is not None:
            yield solved[0]
        if "grazing" not in states:
            return


def _direction(solution: Solution, contact: int) -> Direction | None:
    if solution.friction_force is None:
        return None
    force = np.asarray(solution.friction_force[contact])
    size = float(np.linalg.norm(force))
    if size == 0:
        return None
    if len(force) == 1:
        return (fmpq(1 if force[0] > 0 else -1),)
    x, y = (force / size).tolist()
    if x <= -1 + 1e-12:
        return fmpq(-1), fmpq(0)
    q = from_fraction(Fraction(y / (1 + x)).limit_denominator(DENOMINATOR))
    return (1 - q * q) / (1 + q * q), 2 * q / (1 + q * q)


def _numbers(data: RationalProblem) -> dict[str, Any]:
    """The data as arrays of Fractions, by the names of `exact_equilibria`."""
    parts = dict(stiffness=data.K, load=data.f, normal=data.E, gap=data.g, tangent=data.T, tie=data.A)
    parts.update(tie_value=data.b, slip_origin=data.slip_origin)
    numbers: dict[str, Any] = {name: _array(part) for name, part in parts.items()}
    return numbers | {"friction": [fraction(mu) for mu in data.friction]}


def _array(part: fmpq_mat) -> Any:
    array = np.empty(part.nrows() * part.ncols(), dtype=object)
    array[:] = [fraction(x) for x in part.entries()]
    return array
