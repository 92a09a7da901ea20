"""The states of a motion, and what happened in it: energies at every state, and changes of contact."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.history import Energies, Event
from contactqp.analysis.motion.schemes.scheme import Scheme, State
from contactqp.analysis.motion.step_contact import Answered, Posed
from contactqp.model.arrays import Vector
from contactqp.model.problem_data import ReadOnly

# Steps whose energies are found at once.
BLOCK = 256
# Slip of this part of what moves is rounding.
SLIPS = 1e-9


def events(motion: Motion) -> Iterator[Event]:
    """Contacts that begin or cease to push, and, with friction, to slip."""
    problem = motion.scheme.body.problem
    slipping = np.zeros(problem.contacts, dtype=bool)
    pairs = enumerate(pairwise(motion.states), start=1)
    for k, (before, now) in pairs:
        was, pushes = before.normal_force > 0, now.normal_force > 0
        slips = _slips(motion, before, now) & pushes
        for i in np.flatnonzero((was != pushes) | (slips != slipping)):
            time, name = motion.time(k), problem.contact_name(int(i))
            if was[i] != pushes[i]:
                yield Event("closed" if pushes[i] else "opened", int(i), time, name)
            if slips[i] and not slipping[i]:
                yield Event("slip", int(i), time, name)
            elif slipping[i] and not slips[i] and pushes[i]:
                yield Event("stick", int(i), time, name)
        slipping = slips


def _slips(motion: Motion, before: State, now: State) -> NDArray[np.bool_]:
    body, problem = motion.scheme.body, motion.scheme.body.problem
    if not problem.frictional or problem.friction is None:
        return np.zeros(problem.contacts, dtype=bool)
    way = now.displacement - before.displacement
    size = np.linalg.norm(now.friction_force.reshape(problem.contacts, -1), axis=1)
    slip = np.max(abs(body.tangent @ way).reshape(problem.contacts, -1), axis=1)
    at_cone = size >= (1 - SLIPS) * problem.friction * now.normal_force
    return np.asarray(at_cone & (slip > SLIPS * np.max(abs(body.tangent) @ abs(way))))


def energies(motion: Motion) -> Iterator[Energies]:
    """Of every state, a block at a time.

    What the normal forces take is their work along the scheme's way. A scheme that keeps energy without contact has
    lost to the impact, or made of it, whatever else is missing after a step beside contact forces.
    """
    scheme, states = motion.scheme, motion.states
    first: float | None = None
    sums = np.zeros(3)  # work, impact, friction
    for start in range(0, len(states), BLOCK):
        begin = max(start - 1, 0)
        block = states[begin : start + BLOCK]
        around = states[max(begin - 1, 0) : start + BLOCK + 1]
        loads = np.array([motion.load(motion.time(k)) for k in range(begin, begin + len(block))])
        stored = _stored(motion, block, loads)
        if first is None:
            first = float(stored[:, 0].sum())
            yield Energies(float(stored[0, 0]), float(stored[1, 0]), 0.0, 0.0)
        gain = np.diff(stored.sum(axis=0))
        done = _done(motion, block, loads)
        if scheme.keeps_energy:
            touching = np.any(np.array([s.normal_force for s in around]) > 0, axis=1)
            near = np.convolve(touching, np.ones(3), "same") > 0  # a predictor acts a step before its force
            near = near[len(states[max(begin - 1, 0) : begin]) :][: len(block)]
            acting = near[1:] | near[:-1]
            done[1] = np.where(acting, done[0] - done[2] - gain, done[1])
        for i in range(len(gain)):
            sums += done[:, i]
            elastic, kinetic = stored[:, i + 1].tolist()
            work, impact, friction = sums.tolist()
            drift = elastic + kinetic - first - work + impact + friction
            yield Energies(elastic, kinetic, work, friction, impact, drift)


def _stored(motion: Motion, block: list[State], loads: NDArray[np.float64]) -> NDArray[np.float64]:
    """Elastic and kinetic energy, (2, states)."""
    scheme, body = motion.scheme, motion.scheme.body
    u, v = np.array([s.displacement for s in block]), np.array([s.velocity for s in block])
    elastic = np.einsum("ij,ij->i", u, (body.stiffness @ u.T).T) / 2
    if scheme.springs is not None:
        elastic += np.sum(np.array([s.normal_force for s in block]) ** 2, axis=1) / (2 * scheme.springs)
    kinetic = scheme.kinetic(u, v, loads)
    if block[0] is motion.states[0]:
        kinetic[0] = v[0] @ (body.mass @ v[0]) / 2  # as it was given, at one instant
    return np.array([elastic, kinetic])


def _done(motion: Motion, block: list[State], loads: NDArray[np.float64]) -> NDArray[np.float64]:
    """The work of the loads, what normal forces took and what friction took, (3, steps)."""
    scheme, problem = motion.scheme, motion.scheme.body.problem
    u, v = np.array([s.displacement for s in block]), np.array([s.velocity for s in block])
    ways, weight = scheme.contact_way(u, v), scheme.contact_weight()

    def along(force: Vector, rows: Any) -> Vector:
        share = np.repeat(weight, force.shape[1] // max(len(weight), 1))
        acting = share * force[1:] + (1 - share) * force[:-1]
        return np.asarray(np.einsum("ij,ij->i", acting, (rows @ ways.T).T))

    work = np.einsum("ij,ij->i", (loads[1:] + loads[:-1]) / 2, np.diff(u, axis=0))
    taken = rubbed = np.zeros(len(ways))
    if scheme.springs is None:
        taken = along(np.array([s.normal_force for s in block]), problem.normal)
    if problem.frictional:
        rubbed = along(np.array([s.friction_force for s in block]), scheme.body.tangent)
    return np.array([work, taken, rubbed])


@dataclass(frozen=True, eq=False)
class Known(ReadOnly):
    """A load at the instants of a motion."""

    times: tuple[float, ...]
    loads: NDArray[np.float64]

    def __call__(self, instant: float) -> Vector:
        return np.asarray(self.loads[self.times.index(instant)])


@dataclass(frozen=True, eq=False)
class Motion:
    """The states of a motion, and the scheme that made them."""

    scheme: Scheme
    states: list[State]
    load: Callable[[float], Vector]
    start: float  # time of the first state
    method: str
    seconds: list[float]  # of all steps, one number
    work: Callable[[], Any]  # Work so far

    def __getstate__(self) -> dict[str, Any]:
        """What is copied or pickled: the states, and of the load its values at their times."""
        times = [self.time(k) for k in range(len(self.states))]
        known = Known(tuple(times), np.array([self.load(instant) for instant in times]))
        return self.__dict__ | dict(load=known, work=partial(copy.copy, self.work()))

    def time(self, k: int) -> float:
        return self.start + k * self.scheme.body.step

    def posed(self, k: int) -> tuple[Posed, Answered]:
        """What the scheme posed last for step k, the step that ends at state k, and its answer."""
        before, load, next_load = self.states[k - 1], self.load(self.time(k - 1)), self.load(self.time(k))
        *earlier, found = self.scheme.answered(before, self.states[k])
        return self.scheme.pose(before, load, next_load, tuple(earlier)), found
