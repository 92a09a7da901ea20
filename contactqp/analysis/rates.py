"""Compute the rates of an answer along a direction of its data, one-sided if contacts are at the border of two states.

If every contact keeps its state, the rates solve one linear system (`contactqp.analysis.rate_systems`; Fiacco 1976;
Robinson 1980). At a border they solve a contact problem. Without friction the displacement changes at the rate du that
minimises

    1/2 du'K du - df'du    over    E_c du = dg_c,    E_w du <= dg_w,    A du = db,

with the contacts c with force, and the grazing contacts w, whose gap and force both vanish (for membranes over
obstacles Mignot 1976). This is a contact problem with the same stiffness, with contacts w, and contacts c among its
ties; its forces are the rates of the forces. With friction every combination of possible states of the contacts at a
border is tried, and one that agrees with its rates is right. In space a sticking contact begins to slip along its
friction, with no slip rate across it. The slip direction of a grazing contact without slip is unknown: for one contact
all are found as roots of a polynomial; for several one is found, which is the only one if answers are unique at every
load.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from contactqp.analysis.border_states import (
    NOMINAL_SLIP,
    RATE_EPS,
    Borders,
    decided,
    decided_in_space,
    negligibly_open,
    resolved,
    seen_states,
    sticking_at_bound,
)  # fmt: skip
from contactqp.analysis.friction_sharing import SEEN, FrictionSharing, among_states, on_sides, states_hold
from contactqp.analysis.rate_data import (
    REDUNDANT,
    SAME_RATE,
    SINGULAR,
    Direction,
    NoRates,
    Parts,
    Rates,
    Scales,
    Solved,
    at_border,
    begin_in_one_way,
    closed_on,
    named,
    parts_from,
    rates_posed,
    repeated,
    shape_of_tangents,
    slips_across,
    with_reaction,
)  # fmt: skip
from contactqp.analysis.rate_systems import LARGE, RateSystem
from contactqp.analysis.shared_forces import Sharing, unheld
from contactqp.analysis.slip_law import StateMargins, falls, steps_to_events
from contactqp.certificate import bounds
from contactqp.errors import InvalidProblem, NoEquilibrium, NotCertified, NotConverged, Unsupported
from contactqp.linalg.condensation import condense
from contactqp.linalg.dense import saddle_point
from contactqp.linalg.iteration import constraints_are_many, contacts_are_many, factorised, iterated, may_be_factorised
from contactqp.linalg.measures import lengths
from contactqp.model.arrays import INVISIBLE, Indices, Mask, Vector
from contactqp.model.coulomb import OPEN, SLIP_ON, STICK, Status
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Solution
from contactqp.solving.solve import solve

IN_SPACE = "graze in space where other answers are not excluded, and together may begin to slip in many directions"
# The most contacts with shared forces for which displacements have rates by gaps.
MOST_SHARING = 64


class Linearised:
    """An answer with the systems of its rates, which share its factorisation.

    Raises Unsupported: bodies that are not factorised, or with friction not condensed; InvalidProblem: the answer is
    not certified.

    Attributes
    ----------
    undecided : (q,) array, contacts at the border of two states
    status : (m,) array, the states of the other contacts
    push : (m,) array, contact forces [force]
    system : RateSystem or None, None if some contacts are undecided, or nothing is condensed
    is_sparse : bool, whether nothing is condensed
    sure : bool, whether contacts near a border were examined beyond double precision, or there are none
    """

    def __init__(self, solution: Solution) -> None:
        problem = solution.problem
        if not solution.certificate.passed:
            raise InvalidProblem("derivatives: the answer is not certified")
        self.solution, self.problem, self.scales = solution, problem, Scales(problem)
        if not iterated(problem):
            self._linearise()
            return
        if not may_be_factorised(problem):
            raise Unsupported("derivatives: of bodies that are factorised alone")
        with factorised(problem):
            self._linearise()

    def _linearise(self) -> None:
        """Determine the states of the contacts, and the system of their rates if no state is undecided."""
        problem = self.problem
        # Contacts that never close, and rows of zeros, are not condensed, as they have no effect.
        self.is_sparse = problem.has_idle_rows or constraints_are_many(problem) or contacts_are_many(problem)
        if self.is_sparse and problem.frictional:
            raise Unsupported("derivatives: with friction, of contacts that are condensed alone")
        self._decide()
        self.undecided = np.union1d(self.grazing, self._at_bound).astype(np.intp)
        answer, certificate = self.solution, self.solution.certificate
        measure = None if certificate.violations is None else certificate.violations.slip_measure
        slid = np.zeros(len(self.push), dtype=bool) if measure is None else measure > certificate.tolerance
        self.borders = Borders(
            problem, self.scales, self.undecided, self.status, self.push, self._drag, self._slip, slid,
            still=~slid & (measure is not None),
        )  # fmt: skip
        slip = np.zeros(shape_of_tangents(problem)) if answer.slip is None else answer.slip
        self._answer = Parts(answer.displacement, answer.normal_force, slip, answer.tie_force)
        if problem.frictional:
            self._answer = resolved(problem, self.status, self._answer)
        self._systems: dict[bytes, RateSystem] = {}
        self._posed: dict[bytes, ContactProblem] = {}
        self.redundant = self._forces_depend()
        if self.redundant and len(self.grazing) and self.sharings_are_few and not self.is_sparse:
            self._close_what_may_push()
        whole = not (self.is_sparse or len(self.undecided))
        self.system = self._system(self.status) if whole else None
        self.shares = self._sharing_with_friction(slid) if problem.frictional else None

    def _decide(self) -> None:
        """Determine the states of contacts, deciding those at a border by the certificate if possible.

        Forces and gaps in given states are known far beyond double precision if the answer is unique: any nonzero force
        keeps its contact closed. In space with friction, and for large bodies without contacts near a border, doubles
        are used.
        """
        solution, problem, words = self.solution, self.problem, self.solution.contact_status
        none = np.zeros(shape_of_tangents(problem))
        self._slip = none if solution.slip is None else solution.slip
        self._drag = none if solution.friction_force is None else solution.friction_force
        self.push, self._gap, self.status = solution.normal_force, solution.gap, seen_states(words, self._slip)
        self.grazing, self._at_bound = (
            np.flatnonzero((words == "grazing") | negligibly_open(solution.certificate, self.status)),
            sticking_at_bound(problem, self.status, self.push, self._drag),
        )
        near = np.union1d(self.grazing, self._at_bound).astype(np.intp)
        in_space = problem.frictional and none.shape[1] > 1
        self.sure = not len(near)
        if len(near) and in_space:
            answer = Answer(solution.displacement, self.push, self._drag, solution.tie_force)
            self.status, self.grazing, self._at_bound, self.sure = decided_in_space(
                problem, self.status, self.grazing, answer, self._gap, self._slip
            )
        elif (len(near) or problem.dimension <= LARGE) and not (self.is_sparse or in_space):
            status, pushing = self.status.copy(), self.grazing[solution.normal_force[self.grazing] > 0]
            status[pushing] = STICK if problem.frictional else SLIP_ON
            parts = Parts(solution.displacement, solution.normal_force, self._drag, solution.tie_force)
            found = decided(problem, condense(problem), status, near, parts)
            self.sure = self.sure or (found is not None and found.sure)
            if found is not None:
                self.status, self.grazing, self._at_bound = found.status, found.grazing, found.at_bound
                self.push, self._drag, self._gap, self._slip = (
                    found.normal_force, found.friction_force, found.gap, found.slip
                )  # fmt: skip
        self.closed = np.flatnonzero(self.status != OPEN)
        self._touching = np.union1d(self.closed, self.grazing).astype(np.intp)

    def _forces_depend(self) -> bool:
        """Return whether rows of ties and touching contacts are dependent, so that forces are not unique."""
        if self.problem.frictional:
            return False  # the system says it
        if self.is_sparse:  # nothing is condensed; the certificate has examined it
            return any(bounds.REDUNDANT in reason for reason in self.solution.certificate.reasons)
        if not saddle_point(condense(self.problem), self._touching).redundant:
            return False
        if not len(self.grazing) or saddle_point(condense(self.problem), self.closed).redundant:
            return True
        # Grazing contacts may take over a part of the others' forces if their rows are dependent on these.
        return self._sharing.takes_part(np.isin(self._touching, self.grazing))

    def _sharing_with_friction(self, slid: Mask) -> FrictionSharing | None:
        """Return the contacts with friction, and ties, that share forces, None if none do, or too many touch."""
        if (self.system is not None and self.system.regular) or len(self._touching) > MOST_SHARING:
            return None
        forces = Parts(self._answer.displacement, self.push, self._drag, self._answer.tie)
        found = FrictionSharing(self.problem, self.scales, self.status, self._touching, forces, self._slip, slid)
        if not found.null.size:
            return None
        if found.is_steady and not len(others := np.setdiff1d(self.undecided, found.members)):
            system = self._system(found.steady)
            if not found.moves(system):
                self.status, self.closed = found.steady, np.flatnonzero(found.steady != OPEN)
                alone = system if system.regular else system.of_independent_rows()
                self.system = alone if alone.regular else system
                self.undecided = self.grazing = self._at_bound = others  # they are at no border
                return found
        return found if self.system is None and not self._in_space else None

    def _close_what_may_push(self) -> None:
        """Treat contacts without force as closed if they have a force in another distribution."""
        stay = self._sharing.stay(self._resultant, np.zeros_like(self.push), np.zeros(self.problem.ties))
        closed = np.union1d(self.closed, [] if stay is None else stay).astype(np.intp)
        self.closed, self.status = closed, closed_on(self.problem, closed)
        self.grazing = self.undecided = np.setdiff1d(self.grazing, closed)

    def _system(self, status: Status, rates: Rates | None = None, off: Vector | None = None) -> RateSystem:
        """Return the system of some states; `rates` has beginning slips and forces, with relative error `off`."""
        key = status.tobytes()
        if key in self._systems and rates is None:
            return self._systems[key]
        problem, slip = self.problem, self._answer.tangent.copy()
        begins = self._at_bound[abs(status[self._at_bound]) == 1] if slip.shape[1] > 1 else self._at_bound[:0]
        push, free = self._answer.normal.copy(), self.borders.free
        if rates is not None:
            slip[free], push[free] = rates.slip[free], rates.normal_force[free]
        if len(begins):
            along = self._drag[begins] / lengths(self._drag[begins])[:, None]
            slip[begins] = NOMINAL_SLIP * along
            across = np.column_stack([-along[:, 1], along[:, 0]])
            problem = slips_across(problem, begins, across)
        answer = Parts(self._answer.displacement, push, slip, np.concatenate([self._answer.tie, np.zeros(len(begins))]))
        system = RateSystem(problem, condense(problem), status, answer)
        if rates is None:
            self._systems[key] = system
        if len(begins):
            system.across = begins, across, np.zeros(len(begins))
        if self._in_space and len(self.undecided) and key != self.status.tobytes():
            known = self.extended_answer
            if known is not None and known.bound is not None:
                self.borders.tell_law(self._system(self.status).law, system, known, begins, (rates, off))
        return system

    @property
    def has_events(self) -> bool:
        """Return whether steps to events are available: not if slips turn, or many contacts share forces."""
        turns = self.turns or (self.shares is not None and self._in_space)
        return not turns and (not (self.redundant and self.is_sparse) or self.sharings_are_few)

    @property
    def turns(self) -> bool:
        """Return whether slips in space may turn, so that the answer is not linear along any direction."""
        return self._in_space and (self.system is None or self.system.turns)

    @property
    def _in_space(self) -> bool:
        """Return whether friction has two directions."""
        return self.problem.frictional and self._drag.shape[1] > 1

    @property
    def has_bounds(self) -> bool:
        """Return whether errors of rates are available for a proven answer with certain states and slip directions."""
        if not (self.turns or self.redundant):
            return self.sure
        known = self.extended_answer
        return (self.redundant or self.sure) and known is not None and known.bound is not None

    @cached_property
    def stands(self) -> bool:
        """Return whether contacts with friction satisfy their states beyond double precision."""
        asked = self.problem.frictional and self.sure and (self.shares is None or self.system is None)
        known = self.extended_answer if asked else None
        if known is None or not parts_from(self.problem, known, self._touching, self.closed):
            return False
        others = np.setdiff1d(np.arange(self.problem.contacts), self.undecided)
        return states_hold(self.problem, self.status, known, self._slip, others)

    def only(self, of: str, direction: Direction) -> bool:
        """Return whether forces of one kind, and their rates, are unique although contacts or ties are redundant."""
        if self.shares is not None:
            return self.shares.only(of, direction.friction)
        asked = self.sharings_are_few and of in ("normal_force", "tie_force")
        return asked and self._sharing.only(ties=of == "tie_force")

    @cached_property
    def _sharing(self) -> Sharing:
        """Return all distributions of the forces of touching contacts."""
        return Sharing(self.problem, self._touching, self.scales.units)

    @property
    def sharings_are_few(self) -> bool:
        """Return whether few enough contacts touch to try all distributions of their forces."""
        few = not self.is_sparse or self.problem.ties <= MOST_SHARING
        return few and len(self._touching) <= MOST_SHARING

    @property
    def irregular(self) -> str | None:
        """Return why there are no rates for any direction, with friction."""
        mu, free = self.problem.friction, self.borders.free
        if mu is None or not self.problem.frictional:
            return None
        if self.system is not None:
            return None if self.system.regular or self.shares else SINGULAR
        if len(free) < 2 or not self.solution.certificate.uniqueness:  # all slips of a single contact are found
            return None
        # Contacts that may begin to slip may have unique rates for every change of data.
        others = np.setdiff1d(self.closed, free)
        alone = len(free) == len(self.undecided) and not np.any((self.status[others] != STICK) & (mu[others] > 0))
        in_one_way = alone and begin_in_one_way(self.problem, free, others, self.status)
        return None if in_one_way else f"{named(self.problem, free)} {IN_SPACE}"

    def sides(self, direction: Direction) -> tuple[Rates | NoRates, Rates | NoRates]:
        """Return the rates on the minus and plus side of a direction, or in their place why there are none."""
        towards = self._among_states if self.problem.frictional else self._by_problem
        if self.shares is not None:
            # At a border unique forces have rates; otherwise states decide.
            unique = on_sides(towards, direction) if self.system is None else None
            if unique and all(isinstance(one, Rates) for one in unique):
                return unique
            shared = self.shares.sides(direction, self.system, self.borders, self._system, self._in_states)
            back, ahead = (
                two if isinstance(one, NoRates) and isinstance(two, Rates) else one
                for one, two in zip(shared, unique or shared, strict=True)
            )
            return back, ahead
        if self.system is not None and not self._is_shifted(direction):
            back, ahead = on_sides(partial(self._in_states, self.system), direction, False)
            return self._carried(back, direction) if self.redundant and isinstance(back, Rates) else back, ahead
        return on_sides(towards, direction, bool(len(self.undecided)) or self._is_shifted(direction))

    def _is_shifted(self, direction: Direction) -> bool:
        """Return whether the distribution of shared forces changes."""
        return self.redundant and (direction.moves or direction.rows is not None)

    def adjoint(self, weights: Parts) -> Parts:
        """Return the solution of the transposed system without friction, if nothing is condensed or at a border."""
        zero = Direction.zero(self.problem)
        found = self._by_problem(
            Direction(**(vars(zero) | dict(load=weights.displacement, gap=weights.normal, tie_value=weights.tie)))
        )
        return Parts.of(found)

    def _in_states(self, system: RateSystem, direction: Direction) -> Rates:
        """Return the rates in one combination of states."""
        known = self.extended_answer if direction.by_answer or system.turns else None
        if (found := system.rates(direction, self.push, known)) is None:
            raise NoRates(SINGULAR)
        return found

    @cached_property
    def extended_answer(self) -> Solved | None:
        """Return the answer in twice double precision from the system of its states."""
        if self.is_sparse:
            return None
        if self.shares is not None and self.system is not None:
            return self.shares.answer(self.system)
        if self.redundant:
            carried = self._carrying(np.zeros_like(self.push), np.zeros(self.problem.ties))
            return None if carried is None else carried[1]
        system = self._system(self.status)
        return system.answer() if system.regular else None

    def _by_problem(self, direction: Direction) -> Rates:
        """Return the rates without friction as the answer of a problem with the grazing contacts as contacts.

        If gaps of redundant contacts or ties change, those required by the energy stay closed, and others may open.
        """
        problem, k, load = self.problem, self.problem.ties, direction.whole_load
        closed, grazing, status, limit = self.closed, self.grazing, self.status, direction.whole_gap
        if self._is_shifted(direction):
            stay = self._sharing.stay(self._resultant, limit, direction.tie_value)
            if stay is None:
                raise NoRates("contacts that touch, and ties, cannot change their gaps and values so")
            closed, grazing = stay, np.setdiff1d(self._touching, stay)
            if direction.rows is not None:
                turn, (force, more) = direction.rows[stay].T, self._sharing.alone(stay, self._resultant)
                if np.any(abs(turn @ more) > SEEN * (abs(turn) @ abs(more))):
                    raise NoRates(REDUNDANT)
                load = direction.load + direction.strained - turn @ force
            status = closed_on(problem, closed)
        if closed.tobytes() not in self._posed:
            self._posed[closed.tobytes()] = rates_posed(problem, closed, grazing)
        value = np.concatenate([direction.tie_value, limit[closed]])
        try:
            posed = self._posed[closed.tobytes()]
            found = solve(posed.replace(load=load, gap=limit[grazing], tie_value=value))
        except NoEquilibrium as none:
            # If gaps change nearly equally, the closed contact among those with shared forces is undecided.
            raise NoRates(REDUNDANT if self._is_shifted(direction) else str(none)) from None
        except (NotCertified, NotConverged) as none:
            raise NoRates(str(none)) from None
        force = np.zeros(problem.contacts)
        force[closed], force[grazing] = found.tie_force[k:], found.normal_force
        tangents = np.zeros(shape_of_tangents(problem))
        parts = Parts(found.displacement, force, tangents, found.tie_force[:k].copy())
        many = any(bounds.REDUNDANT in one for one in found.certificate.reasons)
        rates = with_reaction(problem, direction, parts, tangents, status, None)
        shared = many and bool(np.any(found.normal_force > 0))
        rates = replace(rates, shared=shared, motions=tuple(unheld(found, None)))
        if self.redundant or (shared and not self.is_sparse):
            return self._carried(rates, direction)
        return self._bounded(rates, direction) or rates

    @property
    def _resultant(self) -> Vector:
        """Return the nodal forces (n,) of contacts and ties."""
        return np.asarray(self.problem.normal.T @ self.push + self.problem.tie.T @ self.solution.tie_force)

    def _bounded(self, rates: Rates, direction: Direction) -> Rates | None:
        """Return rates without friction from the system of their states, with error bounds.

        None if forces are shared, nothing is condensed, or the signs do not agree with these states.
        """
        if self.is_sparse or rates.shared:
            return None
        status, pushes = self.status.copy(), rates.normal_force[self.grazing] > 0
        status[self.grazing[pushes]] = SLIP_ON
        known = self.extended_answer if direction.by_answer else None
        sides = self.grazing[pushes], self.grazing[~pushes]
        found = self._system(status).where_signs_hold(direction, self.push, known, sides, 1.0)
        return None if found is None else replace(found, status=self.status, motions=rates.motions)

    def _carrying(self, gap: Vector, tie_value: Vector) -> tuple[Indices, Solved] | None:
        """Return independent contacts that carry all forces as gaps (m,) and tie values (k,) change, and the answer on
        them.

        The answer is beyond double precision; None if it is not confirmed.
        """
        if self.is_sparse or not self.sharings_are_few:
            return None
        carrying = self._sharing.carrying(self._resultant, gap, tie_value)
        if carrying is None:
            return None
        system = self._system(closed_on(self.problem, carrying))
        known = system.answer() if system.regular else None
        return (carrying, known) if known and system.carries(known, self._touching) else None

    def _carried(self, rates: Rates, direction: Direction) -> Rates:
        """Return rates at redundant contacts, with error bounds if independent ones carry the changes.

        Forces of contacts that carry the answer, and of others with positive rates, are one distribution: if its signs
        agree, the rates of the displacement are those of the system of these contacts. For changes of rows, which admit
        other distributions, all signs must be certain.
        """
        without = replace(rates, bound=None, off=None)
        shift = (direction.whole_gap, direction.tie_value) if self._is_shifted(direction) else None
        found = self._carrying(*(shift or (np.zeros_like(self.push), np.zeros(self.problem.ties))))
        if found is None:
            return without
        carrying, known = found
        turned = 0.0 if direction.rows is None else -(direction.rows.T @ known.found.normal)
        turns, whole = self.scales.of("gap", rates.gap), self.scales.largest(rates)
        may = self._touching[abs(turns[self._touching]) <= SAME_RATE * whole]
        joining = self._sharing.joining(rates.reaction + turned, carrying, may)
        system = self._system(closed_on(self.problem, np.union1d(carrying, joining).astype(np.intp)))
        sides, margin = (joining, np.setdiff1d(self._touching, system.closed)), 0.0
        if direction.rows is not None:  # a multiple of a closed contact that changes with it stays closed
            apart = repeated(self.problem, direction.rows, sides[1], system.closed)
            sides, margin = (joining, np.setdiff1d(sides[1], apart)), -1.0
        exact = system.where_signs_hold(direction, self.push, known, sides, margin)
        if exact is None:
            return without
        return replace(exact, status=rates.status, shared=rates.shared, motions=rates.motions)

    def _among_states(self, direction: Direction) -> Rates:
        """Return the rates with friction of the only combination of states that agrees with its rates."""
        return among_states(self.borders, direction, self._system, self._in_states)

    def events(self, rates: Rates, sign: float) -> Iterator[float]:
        """Yield the steps along sign times these rates at which contacts leave the states of the rates.

        Forces and gaps of grazing contacts do not decrease, as they start from zero.
        """
        if self.redundant:
            turns, whole = self.scales.of("gap", sign * rates.gap), self.scales.largest(rates)
            members = self._touching[turns[self._touching] <= SAME_RATE * whole]
            moved = abs(self.problem.normal) @ abs(rates.displacement)
            rounded = (abs(rates.gap) <= RATE_EPS * moved) | (abs(turns) <= INVISIBLE * whole)
            gap = np.where(rounded, 0.0, sign * rates.gap)
            yield Sharing(self.problem, members, self.scales.units).reach(self._resultant, sign * rates.reaction)
            apart = np.setdiff1d(np.flatnonzero(self.status == OPEN), self.grazing)
            yield from falls(self._gap[apart], gap[apart])
            return
        parts = rates.gap, rates.normal_force, rates.friction_force, rates.slip
        along = StateMargins(*(sign * part for part in parts))
        now = StateMargins(self._gap, self.push, self._drag, self._slip)
        mu, of = (self.problem.friction, self.undecided) if self.problem.frictional else (None, self.grazing[:0])
        rests = np.array([i for i in of if STICK in self.borders.choices(int(i))], dtype=np.intp)
        if self.shares is not None and rates.shared:
            shared = rates if sign > 0 else rates.reversed()
            yield from self.shares.events(shared, now, self.grazing, rests, self._at_bound)
        else:
            yield from steps_to_events(mu, rates.status, now, along, self.grazing, rests, self._at_bound)

    def at_border(self) -> str:
        """Return in words the contacts at a border."""
        return at_border(self.problem, self.grazing, self._at_bound)
