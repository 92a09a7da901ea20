"""Changes of contact state along one leg of a load path, found exactly.

While no contact changes its state, displacements and forces are linear in the load. At a load where contacts have
neither gap nor force, which of them close follows from the contact problem in rates: contacts that carry force stay
closed, those without gap and force satisfy E_i v <= 0, l_i' >= 0, l_i' E_i v = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain, combinations

import numpy as np

from contactqp.analysis.history import Event
from contactqp.errors import NotConverged, Unsupported
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.refinement import OnSet, answer_on
from contactqp.model.arrays import Indices, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.solving.methods import find

# Two events nearer than this part of a leg are one: doubles cannot order them.
SIMULTANEOUS = 1e-12
# Rates below this part of the largest are zero.
STEADY = 1e-12
# Subsets of simultaneous contacts that are tried one by one when the quick search does not settle.
TRIED_ONE_BY_ONE = 12


@dataclass(frozen=True, eq=False)
class _State:
    """One instant: contacts that carry force, contacts with neither gap nor force."""

    fraction: float
    closed: Indices
    undecided: Indices


def events_of_leg(problem: ContactProblem, start: Vector, end: Vector, first: Solution, method: str) -> list[Event]:
    """Every event of one leg, its time counted from 0 at the start of the leg to 1 at its end."""
    if not find(method).exact:
        raise Unsupported(f"{method}: exact events (it is approximate by design); give steps instead")
    way = condense(problem)
    direction = problem.replace(load=end - start, gap=np.zeros(problem.contacts), tie_value=np.zeros(problem.ties))
    undecided = np.array(first.certificate.grazing, dtype=np.intp)
    carrying = np.setdiff1d(np.flatnonzero(first.normal_force > 0), undecided)
    state = _State(0.0, carrying, undecided)
    events: list[Event] = []
    limit = 20 * problem.contacts + 20
    for _ in range(limit):
        chosen, rates = _rates(direction, way, state)
        events += _decided(state, chosen)
        here = answer_on(problem.replace(load=start + state.fraction * (end - start)), way, chosen)
        following = _next_state(state, chosen, here, rates)
        if following is None:
            return events
        state = following
    raise NotConverged(f"follow_path: more than {limit} changes of state in one leg")


def _decided(state: _State, chosen: Indices) -> list[Event]:
    """The events at a state: undecided contacts that were open close, those that carried force open."""
    events = []
    for i in state.undecided:
        was_closed, is_closed = i in state.closed, i in chosen
        if was_closed != is_closed:
            events.append(Event("closed" if is_closed else "opened", int(i), state.fraction))
    return events


def _rates(direction: ContactProblem, way: Condensation, state: _State) -> tuple[Indices, OnSet]:
    """The closed contacts just after a state, and the rates of displacement and force."""
    certain = np.setdiff1d(state.closed, state.undecided)
    trial, seen = certain, set()
    while trial.tobytes() not in seen:
        seen.add(trial.tobytes())
        rates = _rates_on(direction, way, trial)
        tension, closing = _wrong_rates(state, trial, rates)
        if not tension.size and not closing.size:
            return trial, rates
        trial = np.union1d(np.setdiff1d(trial, tension), closing).astype(np.intp)
    for subset in _subsets(state.undecided):
        trial = np.union1d(certain, np.array(subset, dtype=np.intp)).astype(np.intp)
        rates = _rates_on(direction, way, trial)
        if not any(wrong.size for wrong in _wrong_rates(state, trial, rates)):
            return trial, rates
    raise NotConverged(f"follow_path: no continuation was found at {state.fraction:.6g} of the leg")


def _subsets(contacts: Indices) -> chain[tuple[int, ...]]:
    few = contacts[:TRIED_ONE_BY_ONE]
    return chain.from_iterable(combinations(few, size) for size in range(len(few) + 1))


def _rates_on(direction: ContactProblem, way: Condensation, closed: Indices) -> OnSet:
    rates = answer_on(direction, way, closed)
    load, inner = way.reduce_load(direction.load)
    if np.any(rates.saddle.drive(load, way.reduced_size(direction, inner))):
        raise Unsupported(
            "follow_path(events='exact'): the motion jumps where the load sets a loose body going; give steps instead"
        )
    return rates


def _wrong_rates(state: _State, trial: Indices, rates: OnSet) -> tuple[Indices, Indices]:
    undecided = state.undecided
    force, closing = rates.normal_force.double(), -rates.gap.double()
    pulls = force < -STEADY * np.max(abs(force), initial=0.0)
    closes = closing > STEADY * np.max(abs(closing), initial=0.0)
    inside = np.isin(undecided, trial)
    return undecided[inside & pulls[undecided]], undecided[~inside & closes[undecided]]


def _next_state(state: _State, chosen: Indices, here: OnSet, rates: OnSet) -> _State | None:
    """The next fraction at which an open gap or a contact force reaches zero, and all contacts that do so there."""
    count = len(here.gap)
    is_closed = np.isin(np.arange(count), chosen)
    value = np.where(is_closed, here.normal_force.double(), here.gap.double())
    rate = np.where(is_closed, rates.normal_force.double(), rates.gap.double())
    settled = ~np.isin(np.arange(count), state.undecided) | (value > 0)
    falls = settled & (rate < -STEADY * np.max(abs(rate), initial=0.0))
    ahead = np.full(count, np.inf)
    ahead[falls] = np.maximum(value[falls], 0.0) / -rate[falls]
    reach = state.fraction + np.min(ahead, initial=np.inf)
    if not reach < 1 - SIMULTANEOUS:
        return None
    together = np.flatnonzero(ahead <= np.min(ahead) + SIMULTANEOUS)
    return _State(float(reach), chosen, together)
