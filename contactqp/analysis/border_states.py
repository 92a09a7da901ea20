"""Decide the states of contacts near the border of two states.

Certificates determine states up to their tolerance. Here the answer is computed beyond double precision in given
states, and the signs of its gaps, forces, slips and margins decide.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.rate_data import (
    SAME_RATE,
    Direction,
    NoRates,
    Parts,
    Rates,
    Scales,
    Solved,
    errors_of,
    named,
    shape_of_tangents,
    touch,
    turned_by_rounding,
)  # fmt: skip
from contactqp.analysis.rate_systems import RateSystem
from contactqp.analysis.slip_law import SlipLaw, is_at_bound, slips_that_begin
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.linalg.dense import unknown_scale
from contactqp.linalg.extended import Extended, extended_rows
from contactqp.linalg.friction_states import refined_in
from contactqp.linalg.measures import lengths
from contactqp.linalg.refinement import CAUTION, ROUNDED_AWAY, answer_on
from contactqp.model.arrays import EPS, INVISIBLE, TINY, Array, Indices, Mask, Vector
from contactqp.model.coulomb import (
    OPEN,
    SLIP_BACK,
    SLIP_ON,
    STICK,
    Status,
    combinations_at,
    number_of_combinations,
)
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Certificate

# The most combinations of states of contacts at a border.
MOST_COMBINATIONS = 256
# The relative distance within which friction is at its bound.
AT_BOUND = 4 * EPS
# The relative error of rates along directions computed from answers.
RATE_EPS = 64 * EPS
# In space, the relative rounding of a gap, a force or a slip, and of the friction bound, in doubles.
AT_BORDER = 64 * EPS
# A slip within this angle of its friction is not due to rounding.
ALIGNED = 1e-3
# Slips in space below this part of the lengths at the contact are computed beyond double precision.
TURNED = 1e-3
# The nominal length of a beginning slip, large enough that its direction does not change.
NOMINAL_SLIP = 1e100
# The assumed error of beginning slips before their directions have converged.
COARSE = 1e-6
# The most iterations of the directions of beginning slips, and their tolerance.
MOST_TURNS, TURNS_NO_MORE = 30, 1e-12
FRICTIONLESS = "no contact has friction: rates by coefficients are those of problems that have some"
# The rates whose signs determine states.
BY_SIGN = ("normal_force", "friction_force", "slip", "gap")


@dataclass(frozen=True, eq=False)
class Decided:
    """The states of an answer's contacts, those near a border decided beyond double precision."""

    status: Status  # (m,)
    grazing: Indices  # with zero gap and force
    at_bound: Indices  # sticking with friction at its bound
    normal_force: Vector  # (m,)
    friction_force: Array  # (m, d-1)
    gap: Vector  # (m,)
    slip: Array  # (m, d-1)
    sure: bool  # whether contacts at a border are there to twice double precision, not only within a tolerance


def decided(
    problem: ContactProblem, condensation: Condensation, status: Status, near: Indices, answer: Parts
) -> Decided | None:
    """Return the states of an answer with contacts near a border decided, None if refinement fails.

    The answer is refined in its states, and states near a border are changed by its signs until all agree; if this
    fails, all their combinations are tried. Gaps and forces within the error of refinement are zero. Friction is at its
    bound if they agree to a few roundings, as the product of coefficient and force is rounded.

    Parameters
    ----------
    problem, condensation : with friction in the plane, or without
    status : (m,) array of int, the states to begin with
    near : contacts near a border of two states
    answer : Parts, displacement, normal forces, friction and tie forces
    """
    tried: dict[bytes, Decided | Status | None] = {}

    def look(at: Status) -> Decided | Status | None:
        if at.tobytes() not in tried:
            tried[at.tobytes()] = _decided_in(problem, condensation, at, near, answer)
        return tried[at.tobytes()]

    following: Decided | Status | None = status
    while isinstance(following, np.ndarray) and following.tobytes() not in tried:
        following = look(following)
    if isinstance(following, Decided) or 4.0 ** len(near) > MOST_COMBINATIONS:
        return following if isinstance(following, Decided) else None
    choices = (OPEN, STICK, SLIP_ON, SLIP_BACK) if problem.frictional else (OPEN, SLIP_ON)
    for at in combinations_at(near, [choices] * len(near), status):
        found = look(at)
        if isinstance(found, Decided):
            return found
    return None


def _decided_in(
    problem: ContactProblem, condensation: Condensation, status: Status, near: Indices, answer: Parts
) -> Decided | Status | None:
    """Return the states if the signs of their answer agree, else those that follow from the signs, or None."""
    found = _beyond_doubles(problem, condensation, status.copy(), answer)
    if found is None:
        return None
    (push, drag, gap, slip), no_force, no_gap, room = found
    following, grazing, at_bound, away = status.copy(), [], [], 0.0
    for i in near:
        smooth = problem.friction is None or problem.friction[i] == 0
        if abs(push[i]) <= no_force[i] and abs(gap[i]) <= no_gap[i]:
            grazing.append(i)
            left = ((abs(push[i]), no_force[i]), (abs(gap[i]), no_gap[i]))
            away = max([away, *(INVISIBLE * size / nothing for size, nothing in left if nothing > 0)])
        elif status[i] == OPEN or push[i] < 0:
            following[i] = OPEN if status[i] != OPEN or gap[i] > 0 else SLIP_ON if smooth else STICK
        elif smooth:
            following[i] = SLIP_ON
        elif status[i] == STICK and abs(room[i]) > AT_BOUND * abs(drag[i, 0]):
            following[i] = STICK if room[i] > 0 else SLIP_ON if drag[i, 0] > 0 else SLIP_BACK
        elif status[i] == STICK or slip[i, 0] == 0:
            at_bound.append(i)
            away = max(away, abs(room[i]) / abs(drag[i, 0])) if drag[i, 0] else away
        else:
            following[i] = status[i] if status[i] * slip[i, 0] > 0 else STICK
    if not np.array_equal(following, status):
        return following
    following[at_bound], following[grazing] = STICK, OPEN
    at_border = np.array(grazing, dtype=np.intp), np.array(at_bound, dtype=np.intp)
    return Decided(following, *at_border, push, drag, gap, slip, away <= ROUNDED_AWAY)


def _beyond_doubles(
    problem: ContactProblem, condensation: Condensation, status: Status, answer: Parts
) -> tuple[tuple[Vector, Array, Vector, Array], Vector, Vector, Vector] | None:
    """Return forces, friction, gaps and slips in some states, their errors, and the margins of friction."""
    rows, shape = extended_rows(problem), shape_of_tangents(problem)
    none = np.zeros(shape)
    if not problem.frictional:
        on = answer_on(problem, condensation, np.flatnonzero(status != OPEN), caution=CAUTION)
        if on.saddle.redundant or on.contraction * CAUTION > 1 or on.cleared > 0:
            return None
        compliance, lengths = condensation.delassus.compliance[: problem.contacts], on.nothing[: problem.contacts]
        nothing = np.divide(lengths, compliance, out=np.zeros_like(lengths), where=compliance > 0)
        return (on.doubles.normal_force, none, on.gaps, none), nothing, lengths, np.zeros(problem.contacts)
    scaled = condensed_frictional_rows(problem, condensation)
    start = Answer(answer.displacement, answer.normal, answer.tangent, answer.tie)
    if not (found := refined_in(problem, condensation, scaled, status, start)).regular:
        return None
    u, push = found.displacement.double(), found.normal_force.double()
    unit = condensation.unknown_scale
    normal, tangent = (np.sqrt(sp.csr_array(one).power(2) @ unit**2) for one in (problem.normal, problem.tangent))
    last = max(np.max(abs(found.last.displacement) / unit, initial=0.0), np.max(abs(found.last.normal_force) * normal))
    whole = max(np.max(abs(u) / unit, initial=0.0), np.max(abs(push) * normal), np.max(abs(problem.load) * unit))
    if last > EPS * whole:
        return None
    nothing = INVISIBLE * whole + last
    force = np.divide(nothing, normal, out=np.zeros_like(normal), where=normal > 0)
    drag = found.friction_force.double()
    assert problem.friction is not None
    room = found.normal_force.spread(np.outer(problem.friction, np.ones(shape[1]))) - Extended(
        abs(found.friction_force.hi), np.where(found.friction_force.hi < 0, -1.0, 1.0) * found.friction_force.lo
    )
    slip = (
        rows.slip(found.displacement) - (none if problem.slip_origin is None else problem.slip_origin).ravel()
    ).double()
    slip[abs(slip) <= nothing * tangent] = 0.0
    gap = rows.gap(problem, found.displacement).double()
    return (push, drag.reshape(shape), gap, slip.reshape(shape)), force, nothing * normal, room.double()


def resolved(problem: ContactProblem, status: Status, answer: Parts) -> Parts:
    """Return the answer with accurate slips in space, also if displacements are much larger.

    Rounding of the displacement to doubles would turn the direction of a relatively small slip.

    Parameters
    ----------
    problem : with friction
    status : (m,) array of int, the states of the answer
    answer : displacement, normal forces, slips in place of friction, and tie forces
    """
    if problem.tangent is None or answer.tangent.shape[1] == 1:
        return answer
    condensation = condense(problem)
    rows = condensed_frictional_rows(problem, condensation)
    moved = (abs(problem.tangent) @ abs(answer.displacement)).reshape(answer.tangent.shape)
    near = np.linalg.norm(answer.tangent, axis=1) < TURNED * np.linalg.norm(moved, axis=1)
    if not np.any(near & (abs(status) == 1)):
        return answer
    start = Answer(answer.displacement, answer.normal, None, answer.tie)
    found = refined_in(problem, condensation, rows, status, start)
    if not found.regular:
        return answer
    origin = np.zeros(answer.tangent.size) if problem.slip_origin is None else problem.slip_origin.ravel()
    slip = (extended_rows(problem).slip(found.displacement) - origin).double().reshape(answer.tangent.shape)
    return Parts(found.displacement.double(), found.normal_force.double(), slip, found.tie_force.double())


def seen_states(words: Any, slip: Array) -> Status:
    """Return the states (m,) from certificates' words; in the plane the slip has a sign."""
    status = np.where(np.isin(words, ("closed", "slip")), SLIP_ON, OPEN).astype(np.int8)
    status[words == "stick"] = STICK
    if slip.shape[1] == 1:
        status[(status == SLIP_ON) & (slip[:, 0] < 0)] = SLIP_BACK
    return status


def negligibly_open(certificate: Certificate, status: Status) -> Mask:
    """Return the open contacts (m,) without force whose gap certificates consider negligible."""
    found = certificate.violations
    if found is None:
        return np.zeros(len(status), dtype=bool)
    return np.asarray((found.gap_measure == 0) & (found.force_measure == 0) & (status == OPEN))


def sticking_at_bound(problem: ContactProblem, status: Status, push: Vector, drag: Array) -> Indices:
    """Return the contacts that stick with friction nearly at its bound.

    Parameters
    ----------
    problem : whose coefficients of friction allow it
    status : (m,) array of int, the states
    push, drag : (m,) and (m, d-1) arrays [force], normal forces and friction
    """
    if not problem.frictional or problem.friction is None:
        return np.zeros(0, dtype=np.intp)
    return np.flatnonzero((status == STICK) & (lengths(drag) >= (1 - SAME_RATE) * problem.friction * push))


def decided_in_space(
    problem: ContactProblem, status: Status, grazing: Indices, answer: Answer, gap: Vector, slip: Array
) -> tuple[Status, Indices, Indices, bool]:
    """Return the states (m,) in space, grazing contacts, those sticking at their bound, and whether these are certain.

    The answer satisfies its states up to rounding of doubles, so that larger forces and gaps are not zero, nor are
    larger slips along their friction. A gap must also be nonzero in twice double precision or, if that is not
    available, exceed the rounding of the whole displacement.

    Parameters
    ----------
    problem : with friction in space
    status : (m,) array of int, the states that certificates see
    grazing : grazing contacts by the certificate
    answer, gap, slip : Answer, its gaps (m,) and slips (m, 2)
    """
    assert problem.tangent is not None
    assert problem.friction is not None
    assert answer.friction_force is not None
    u, push, status = abs(answer.displacement), answer.normal_force, status.copy()
    met = abs(problem.normal) @ u + abs(np.where(np.isfinite(problem.gap), problem.gap, 0.0))
    origin = 0.0 if problem.slip_origin is None else abs(problem.slip_origin)
    along = lengths((abs(problem.tangent) @ u).reshape(slip.shape) + origin)
    drag, slid = answer.friction_force.reshape(slip.shape), lengths(slip)
    still = slid <= AT_BORDER * along
    pushes, apart = push > AT_BORDER * np.max(push, initial=0.0), gap > AT_BORDER * met
    for i in grazing[pushes[grazing] & ~apart[grazing]]:
        smooth = problem.friction[i] == 0 or not still[i]
        status[i] = SLIP_ON if smooth else STICK
    grazing = grazing[~pushes[grazing]]
    system = RateSystem(problem, condense(problem), status, Parts(answer.displacement, push, slip, answer.tie_force))
    known = system.answer() if system.regular else None
    if known is not None and known.bound is not None:
        apart &= system.gap(known, np.where(np.isfinite(problem.gap), problem.gap, 0.0)) > 0
    else:
        unit = unknown_scale(problem)
        rounded = np.sqrt(sp.csr_array(problem.normal).power(2) @ unit**2) * np.max(u / unit, initial=0.0)
        apart = gap > AT_BORDER * (met + rounded)
    grazing = grazing[~apart[grazing]]
    near = (status == STICK) & (lengths(drag) >= (1 - SAME_RATE) * problem.friction * push)
    turned = lengths(slip * lengths(drag)[:, None] - drag * slid[:, None])
    status[near & ~still & (turned <= ALIGNED * lengths(drag) * slid)] = SLIP_ON
    at_bound = np.flatnonzero((status == STICK) & (lengths(drag) >= (1 - AT_BORDER) * problem.friction * push))
    system = RateSystem(problem, condense(problem), status, Parts(answer.displacement, push, slip, answer.tie_force))
    known = system.answer() if system.regular else None
    sure = known is not None and known.bound is not None and touch(problem, known, grazing)
    if known is not None and sure:
        _, forces, drags, _ = known.extended
        sure = is_at_bound(problem.friction[at_bound], forces[at_bound], [drags[2 * at_bound + k] for k in (0, 1)])
    return status, grazing, at_bound, sure


@dataclass(frozen=True, eq=False)
class Borders:
    """The contacts of an answer with friction at the border of two states, and their possible states."""

    problem: ContactProblem
    scales: Scales
    undecided: Indices
    status: Status  # (m,) sticking if at the bound, open if grazing
    push: Vector  # (m,)
    drag: Array  # (m, d-1)
    slip: Array  # (m, d-1)
    slid: Mask  # (m,) contacts with slip
    still: Mask  # (m,) contacts without slip by the certificate's measure

    def choices(self, i: int) -> tuple[int, ...]:
        """Return the possible states of a contact at a border; in space SLIP_ON is slip along its direction."""
        friction, in_space = self.problem.friction, self.drag.shape[1] > 1
        assert friction is not None
        if self.status[i] == STICK:
            return STICK, SLIP_ON if in_space or self.drag[i, 0] > 0 else SLIP_BACK
        if friction[i] == 0:
            return OPEN, SLIP_ON
        if self.slid[i]:
            return OPEN, SLIP_ON if in_space or self.slip[i, 0] > 0 else SLIP_BACK
        return (OPEN, STICK, SLIP_ON) if in_space else (OPEN, STICK, SLIP_ON, SLIP_BACK)

    def combinations(self) -> Iterator[Status]:
        """Yield states (m,) with each combination of possible states of contacts at a border.

        Raises NoRates: there are too many combinations.
        """
        choices = [self.choices(int(i)) for i in self.undecided]
        if number_of_combinations(choices) > MOST_COMBINATIONS:
            raise NoRates(f"{len(choices)} contacts at the border of two states have too many combinations of them")
        return combinations_at(self.undecided, choices, self.status)

    @property
    def free(self) -> Indices:
        """Return the contacts that may begin to slip in any tangential direction."""
        found = [i for i in self.undecided if self.drag.shape[1] > 1 and len(self.choices(int(i))) > 2]
        return np.array(found, dtype=np.intp)

    def without_direction(self, friction: Vector) -> str | None:
        """Return why there are no rates by coefficients: a contact without slip gets friction that it did not have."""
        problem = self.problem
        if problem.friction is None or not friction.any():
            return None
        if not problem.frictional:
            return FRICTIONLESS
        still = np.flatnonzero((problem.friction == 0) & (self.status != OPEN) & (friction != 0) & self.still)
        text = "neither friction nor slip, which friction could act against"
        return f"{named(problem, still)} has {text}" if len(still) else None

    def unit_slips(self, begins: Indices) -> Iterator[Direction]:
        """Yield unit changes of slip origins of some contacts along both tangents."""
        zero = Direction.zero(self.problem)
        for place in np.ndindex(len(begins), 2):
            unit = zero.slip_origin.copy()
            unit[begins[place[0]], place[1]] = 1.0
            yield replace(zero, slip_origin=unit)

    def starts(self, held: Rates, moved: list[Rates], begins: Indices) -> Iterator[Rates]:
        """Yield rates with possible beginning slips: all of one contact, at most one set for several.

        Parameters
        ----------
        held : the rates at which these contacts stick
        moved : their changes along unit slips of each contact in both tangents
        begins : the contacts
        """
        assert self.problem.friction is not None
        pushes = np.stack([one.normal_force[begins] for one in moved], axis=1).reshape(len(begins), -1, 2)
        drags = np.stack([one.friction_force[begins] for one in moved], axis=2).reshape(len(begins), 2, -1, 2)
        forces = held.normal_force[begins], held.friction_force[begins]
        for found in slips_that_begin(self.problem.friction[begins], *forces, pushes, drags):
            push, slip = held.normal_force.copy(), held.slip.copy()
            push[begins] += np.einsum("ijk,jk->i", pushes, found)
            slip[begins] = found
            yield replace(held, normal_force=push, slip=slip)

    def turned(
        self, status: Status, begins: Indices, direction: Direction, system_of: Callable[..., RateSystem],
        rates_of: Callable[[RateSystem, Direction], Rates],
    ) -> Iterator[RateSystem]:  # fmt: skip
        """Yield systems in which some contacts in space begin to slip along their friction, by Newton's method.

        Parameters
        ----------
        status, begins, direction : (m,) and (q,) arrays, the states and these contacts, and what the rates are along
        system_of : returns the system of some states, and of slips that begin at some rates
        rates_of : returns the rates of a system along a direction
        """
        held = status.copy()
        held[begins] = STICK
        system = system_of(held)
        moved = [rates_of(system, unit) for unit in self.unit_slips(begins)]
        for rates in self.starts(rates_of(system, direction), moved, begins):
            settled = False
            for _ in range(MOST_TURNS):
                system, before, pushed = system_of(status, rates), rates.slip[begins], rates.normal_force[begins]
                rates = rates_of(system, direction)
                changed, size = lengths(rates.slip[begins] - before), lengths(rates.slip[begins])
                if not (system.regular and np.all(size > 0)):
                    break
                if settled:  # by quadratic convergence the error is far below the last change
                    pushes = rates.normal_force[begins]
                    off = changed / size + abs(pushes - pushed) / np.maximum(abs(pushes), TINY)
                    yield system_of(status, rates, off + 8 * EPS)
                    break
                settled = bool(np.all(changed <= TURNS_NO_MORE * size))

    def tell_law(
        self, law: SlipLaw, system: RateSystem, known: Solved, begins: Indices,
        rates: tuple[Rates | None, Vector | None],
    ) -> None:  # fmt: skip
        """Set the friction law in space from the answer beyond doubles, and that of contacts that begin to slip.

        Parameters
        ----------
        law, known : of the answer
        system, begins : the system, and contacts that begin to slip along their friction in it
        rates : rates that determine slips in any direction, and their relative error
        """
        assert known.bound is not None
        off = lengths(known.bound.tangent[begins]) + lengths(known.found.tangent[begins] - self.drag[begins])
        off = 8 * EPS + 2 * off / lengths(self.drag[begins])
        law = law.with_slips(begins, system.directions[begins], np.zeros(len(begins)), off)
        if system.across is not None:
            system.across = *system.across[:2], off
        slips, free = abs(system.status) == 1, self.free[abs(system.status[self.free]) == 1]
        at = self.undecided[(self.status == OPEN)[self.undecided] & (slips & self.slid)[self.undecided]]
        off = turned_by_rounding(self.problem, self.slip, known)[at]
        law = law.with_slips(at, system.directions[at], np.zeros(len(at)), off)
        if rates[0] is not None and len(free):
            off = np.full(len(free), COARSE) if rates[1] is None else rates[1]
            law = law.with_slips(free, system.directions[free], system.law.turns.hi[free], off)
        system.law = law

    def signs(self, found: Rates, direction: Direction, system: RateSystem, errors: bool = False) -> Vector:
        """Return quantities, or errors, that are nonnegative if rates lead undecided contacts to a system's states.

        Parameters
        ----------
        found : the rates
        direction : the direction of the rates in load, gaps, stiffness and other data
        system : the linear system of the states
        errors : whether to return the bounds of its errors instead
        """
        mu, sign = self.problem.friction, 1.0 if errors else -1.0  # errors add up
        assert mu is not None
        _, of_normal, of_tangent, _ = self.scales.units
        of_slip = of_tangent.reshape(self.drag.shape).max(axis=1, initial=0.0)
        of = {
            name: errors_of(self.problem, name, found, direction) if errors else getattr(found, name)
            for name in BY_SIGN
        }
        push, drags = of["normal_force"] * of_normal, of["friction_force"] * of_normal[:, None]
        room = mu * push + direction.friction * self.push * of_normal * (8 * EPS if errors else 1.0)
        size = lengths(self.drag)[:, None]
        ways = np.divide(self.drag, size, out=np.zeros_like(self.drag), where=size > 0), system.directions
        along, onward = (abs(one) if errors else one for one in ways)
        drag, slips = np.sum(along * drags, axis=1), np.sum(onward * of["slip"], axis=1)
        if errors and drags.shape[1] > 1:  # directions in space are rounded
            drag = drag + 8 * EPS * lengths(found.friction_force) * of_normal
            slips = slips + 8 * EPS * lengths(found.slip)
        slips = np.divide(slips, of_slip, out=np.zeros_like(push), where=of_slip > 0)
        gaps = np.divide(of["gap"], of_normal, out=np.zeros_like(push), where=of_normal > 0)
        signs: list[float] = []
        for i in self.undecided:
            grazes, state = self.status[i] != STICK, system.status[i]
            if state == OPEN:
                signs += [gaps[i]]
            elif state == STICK and grazes and drags.shape[1] == 1:
                signs += [push[i], room[i] + sign * drags[i, 0], room[i] + drags[i, 0]]
            elif state == STICK and grazes:
                signs += [push[i], room[i] + sign * float(np.linalg.norm(drags[i]))]
            elif state == STICK:
                signs += [room[i] + sign * drag[i]]
            else:
                turns = not grazes or STICK in self.choices(int(i))
                signs += ([push[i]] if grazes else []) + ([slips[i]] if turns else [])
        return np.array(signs)

    def hold(self, found: Rates, direction: Direction, system: RateSystem) -> bool:
        """Return whether rates lead undecided contacts to the states of their system."""
        unit, of_normal, _, _ = self.scales.units
        push = abs(found.normal_force * of_normal)
        whole = max(np.max(push, initial=0.0), np.max(abs(found.displacement) / unit, initial=0.0))
        nothing = np.array(SAME_RATE * whole)
        if found.bound is not None:
            rounded = direction.strained.any() or direction.turned.any() or direction.friction.any()
            nothing = self.signs(found, direction, system, errors=True) + (RATE_EPS * whole if rounded else 0.0)
        return bool(np.all(self.signs(found, direction, system) >= -nothing))
