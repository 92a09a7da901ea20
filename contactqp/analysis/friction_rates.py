"""Which way contacts with friction go on: Coulomb's law in rates, in the plane.

Along a leg the load grows by df. Contacts that are open, and those that stick inside their cone, go on so. Those at the
edge of their cone, l_T = e mu l_N with e = +-1, slip on or stick,

    l_T' = e mu l_N', e s' >= 0     or     s' = 0, e l_T' <= mu l_N',

and contacts with neither gap nor force choose among open, stick and slip as Coulomb's law says of rates:

    gap' >= 0, l' = 0     or     gap' = 0, l_N' >= 0, |l_T'| <= mu l_N', l_T' = mu l_N' s'/|s'| where s' != 0.

Above a critical friction there may be no choice (the motion snaps) or several (Klarbring 1990). Continuations that
differ by a rigid motion that no load drives and no contact resists are one, and that motion rests.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import prod

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import NoEquilibrium, NotConverged, SeveralEquilibria
from contactqp.linalg.friction_states import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.arrays import Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.solving.friction.force_system import CombinationAnswer, ForceSystem, Lengths
from contactqp.solving.friction.newton import suggested

# Rates that fail by this part of the largest, lengths and forces both in sqrt(energy), fail by rounding.
STEADY = 1e-11
# Rates that fail by more than this part fail by more than rounding of the data: all do where absence is claimed.
CLEARLY = 1e-8
# Rates that differ by this part of the largest are two continuations.
DISTINCT = 1e-7
# Combinations of undecided contacts up to which all are tried, so that several continuations are seen.
ALL_TRIED = 256
# Up to this many are tried where the quick search finds none.
MOST_TRIED = 4096
# Steps of the quick search.
QUICK_STEPS = 40
NAMES_IN_A_MESSAGE = 8
WORDS = {OPEN: "open", STICK: "stick", SLIP_BACK: "slip back", SLIP_ON: "slip on"}


@dataclass(frozen=True, eq=False)
class Standing:
    """Where the contacts stand at one instant."""

    status: Status  # (m,) as they came
    edge: NDArray[np.int8]  # (m,) e = +-1 at the edge of the cone, else 0
    null: Mask  # (m,) neither gap nor force

    @property
    def undecided(self) -> NDArray[np.intp]:
        """Contacts that have a choice."""
        return np.flatnonzero(self.null | (self.edge != 0))


def continuation(system: ForceSystem, rates: Lengths, standing: Standing, problem: ContactProblem, at: str) -> Status:
    """The combination that the contacts go on in.

    Raises
    ------
    NoEquilibrium
        There is none, since every combination fails by far more than rounding: the equilibrium is lost at this load.
    SeveralEquilibria
        Several, and nothing chooses.
    NotConverged
        None was found, and one nearly holds, or too many contacts are undecided to try all combinations.
    """
    choices = _choices(system, standing)
    count = prod(len(choice) for choice in choices)
    if count > ALL_TRIED:
        quick = _quick(system, rates, standing)
        if quick is not None:
            return _resting(system, rates, standing, quick)
        if count > MOST_TRIED:
            raise NotConverged(f"follow_path: {at}: no continuation was found for {len(choices)} undecided contacts")
    found: list[CombinationAnswer] = []
    nearest = np.inf
    for status in _combinations(standing, choices):
        answer = system.solve(status, rates)
        nearest = min(nearest, _failing(system, rates, standing, answer))
        known = [other for other in found if _same(system, standing, answer, other, rates)]
        if not known and _holds(system, rates, standing, answer):
            found.append(answer)
    names = _named(problem, standing.undecided)
    if not found and nearest <= CLEARLY:
        raise NotConverged(
            f"follow_path: {at}: no continuation was found, and one choice of open, stick and slip at {names} fails by "
            f"{nearest:.2g} of the rates only, which rounding may have made"
        )
    if not found:
        raise NoEquilibrium(
            f"follow_path: {at}: no continuation: the equilibrium is lost, no choice of open, stick and slip at "
            f"{names} keeps its signs as the load goes on"
        )
    loose = [one for one in found if system.undetermined(one.status)]
    if len(found) > 1 or loose:
        listed = "; ".join(
            _described(problem, standing, one) + (" at any rate" if one in loose else "") for one in found
        )
        raise SeveralEquilibria(f"follow_path: {at}: several continuations, and nothing chooses ({listed})")
    return _resting(system, rates, standing, found[0].status)


def _choices(system: ForceSystem, standing: Standing) -> list[tuple[int, ...]]:
    choices: list[tuple[int, ...]] = []
    for i in standing.undecided.tolist():
        smooth = system.coefficient[i] <= 0
        if not standing.null[i]:
            choices.append((STICK, int(standing.edge[i])))
        else:
            choices.append((OPEN, SLIP_ON) if smooth else (OPEN, STICK, SLIP_BACK, SLIP_ON))
    return choices


def _combinations(standing: Standing, choices: list[tuple[int, ...]]) -> Iterator[Status]:
    for chosen in product(*choices):
        status = standing.status.copy()
        status[standing.undecided] = chosen
        yield status


def _wrong(system: ForceSystem, standing: Standing, answer: CombinationAnswer) -> Vector:
    """(m,) by how much rates fail; -inf where there is no choice."""
    coefficient, e = system.coefficient, standing.edge
    at_null = answer.worst(coefficient)
    at_edge = np.where(
        answer.status == STICK, e * answer.friction - coefficient * answer.normal, -e * answer.slip.astype(float)
    )
    return np.where(standing.null, at_null, np.where(e != 0, at_edge, -np.inf))


def _size(answer: CombinationAnswer, rates: Lengths) -> float:
    parts = (answer.gap, answer.slip, answer.normal, answer.friction)
    return max(rates.size if np.any(rates.load) else 0.0, *(float(np.max(abs(part), initial=0.0)) for part in parts))


def _failing(system: ForceSystem, rates: Lengths, standing: Standing, answer: CombinationAnswer) -> float:
    """By how much a combination is no answer, or its signs fail, of the largest rate."""
    size = _size(answer, rates)
    wrong = max(float(np.max(_wrong(system, standing, answer), initial=0.0)), answer.left)
    return wrong / size if size > 0 else float(np.where(wrong > 0, np.inf, 0.0))


def _holds(system: ForceSystem, rates: Lengths, standing: Standing, answer: CombinationAnswer) -> bool:
    return _failing(system, rates, standing, answer) <= STEADY


def _same(
    system: ForceSystem, standing: Standing, one: CombinationAnswer, other: CombinationAnswer, rates: Lengths
) -> bool:
    """Whether two continuations are one but for motions that no load drives and no contact resists."""
    loaded = ~standing.null & (standing.status != OPEN)
    return system.same(one, other, loaded, DISTINCT * max(_size(one, rates), _size(other, rates)))


def _quick(system: ForceSystem, rates: Lengths, standing: Standing) -> Status | None:
    """Newton's method on the undecided contacts, from how they came."""
    m, status, seen = system.contacts, standing.status.copy(), set()
    for _ in range(QUICK_STEPS):
        if status.tobytes() in seen:
            return None
        seen.add(status.tobytes())
        answer = system.solve(status, rates)
        if _holds(system, rates, standing, answer):
            return status
        e = standing.edge
        trial = e * (answer.friction + system.resistance[m:] * answer.slip) - system.coefficient * answer.normal
        at_edge = np.where(trial > 0, e, STICK)
        undecided = np.where(standing.null, suggested(system, answer), np.where(e != 0, at_edge, standing.status))
        status = system.plain(undecided.astype(np.int8))
    return None


def _resting(system: ForceSystem, rates: Lengths, standing: Standing, status: Status) -> Status:
    """The same continuation, contacts at their edge that do not slip called stuck."""
    answer = system.solve(status, rates)
    still = (standing.edge != 0) & ~standing.null & (abs(answer.slip) <= STEADY * _size(answer, rates))
    resting = np.where(still, STICK, status).astype(np.int8)
    if np.array_equal(resting, status):
        return status
    other = system.solve(resting, rates)
    return (
        resting if _holds(system, rates, standing, other) and _same(system, standing, answer, other, rates) else status
    )


def _described(problem: ContactProblem, standing: Standing, answer: CombinationAnswer) -> str:
    chosen = [f"{problem.contact_name(i)} {WORDS[int(answer.status[i])]}" for i in standing.undecided.tolist()]
    return ", ".join(chosen[:NAMES_IN_A_MESSAGE])


def _named(problem: ContactProblem, contacts: NDArray[np.intp]) -> str:
    names = [problem.contact_name(i) for i in contacts.tolist()]
    more = len(names) - NAMES_IN_A_MESSAGE
    return (", ".join(names[:NAMES_IN_A_MESSAGE]) or "no contact") + (f" and {more} more" if more > 0 else "")
