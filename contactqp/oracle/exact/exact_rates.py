"""Compute one-sided derivatives of exact answers in Fractions.

Without friction the displacement changes at the rate du that minimises 1/2 du'K du - df'du over the changes

    E_i du = dg_i    for contacts with force,    E_i du <= dg_i    for others that touch,    A du = db,

which is another problem in rational numbers. If the forces that balance r = f - K u are not unique, the contacts remain
closed that have a force in one of the solutions with least l'dg + nu'db (Shapiro, SIAM J. Control Optim. 26, 1988).

With friction in the plane contacts keep their states, except those at the border of two states or with forces that are
not unique, which may change to any state compatible with their slip. Forces are sums of gamma >= 0 times the edges E_i
+ s mu_i T_i of Coulomb's cones, with s = +1 and -1 for sticking contacts, else the direction of slip. In each
combination of states whose edges can balance f - K u, rates solve a linear system in du, dgamma and dnu, with dgamma >=
0 where gamma is always zero; opening contacts must not close, and slips must begin along s.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from flint import fmpq, fmpq_mat

from contactqp.errors import InvalidProblem, Unsupported, shown
from contactqp.linalg.exact_algebra import Polyhedron
from contactqp.linalg.rational import (
    NoSolution,
    beside,
    column,
    dot,
    fraction,
    fraction_rows,
    fractions,
    is_zero,
    null_space,
    solve_any,
    stack,
    take,
    unit_rows,
    zeros,
)
from contactqp.model.arguments import checked
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, combinations_of, number_of_combinations
from contactqp.oracle.exact.exact_solution import ExactDerivative, ExactSolution
from contactqp.oracle.exact.rational_equilibrium import settle
from contactqp.oracle.exact.rational_problem import MOST_PIVOTS, Family, RationalProblem, longest, of_floats, region_of

FORCES = ("normal_force", "friction_force", "tie_force")
QUANTITIES = (*FORCES, "displacement", "gap", "slip", "reaction", "energy")
PARAMETERS = ("load", "gap", "tie_value", "friction", "slip_origin", "stiffness", "rows")
# Parameters in which the answer is linear while contacts keep their states.
LINEAR = ("load", "gap", "tie_value", "slip_origin")
# The most combinations of states of contacts at a border.
MOST = 1024
CANNOT = "contacts that touch, and ties, cannot change their gaps and values so"
DRIVEN = "the direction drives a motion that nothing holds"
FREE = "bodies are free to move, and their displacements are not unique"
REDUNDANT = "contacts that touch, or ties, are redundant, and their forces are not unique"
SINGULAR = "in a combination of states that may come the rates are not unique"
SMOOTH = "no contact has friction: rates by coefficients are those of problems that have some"
# States of all contacts, and rates of the data.
States: TypeAlias = tuple[int, ...]
Along: TypeAlias = dict[str, fmpq_mat]


@checked
def exact_derivative(answer: ExactSolution, of: str, with_respect_to: str, direction: Any) -> ExactDerivative:
    """Return the exact rates of a quantity of an exact answer; names as in `Solution.derivative`.

    Raises InvalidProblem: an unknown name, a wrong shape, or numbers that are not finite; Unsupported: an enclosed
    answer, one of the exact numbers of a case, friction in space, or too many contacts at a border.

    Parameters
    ----------
    answer : rational, of a problem's floats
    of, with_respect_to : quantity and parameter
    direction : array in the shape of the parameter, the change of the parameter
    """
    for argument, name, known in (("of", of, QUANTITIES), ("with_respect_to", with_respect_to, PARAMETERS)):
        if name not in known:
            raise InvalidProblem(f"{argument}: expected one of {', '.join(known)}, got {name!r}")
    if not answer.rational or answer.events or answer.data.startswith("the case"):
        raise Unsupported("exact derivatives: of rational answers to a problem's floats alone")
    exact = _ExactRates(answer)
    along = exact.read(with_respect_to, direction)
    ahead, back = (exact.rates(of, {name: sign * part for name, part in along.items()}) for sign in (1, -1))
    if isinstance(ahead, str) and isinstance(back, str):
        return ExactDerivative(None, None, None, False, ahead)
    left, right = None if isinstance(back, str) else -back[0], None if isinstance(ahead, str) else ahead[0]
    same = left is not None and right is not None and bool(np.all(left == right))
    reason = "" if same else "the two sides differ: contacts are at the border of two states"
    for sign, side in (("minus", back), ("plus", ahead)):
        reason = f"towards {sign} the direction: {side}" if isinstance(side, str) else reason
    before, after = (0.0 if isinstance(side, str) else side[1] for side in (back, ahead))
    reach = None if with_respect_to not in LINEAR or before is None or after is None else (before, after)
    return ExactDerivative(right if same else None, left, right, same, reason, reach)


class _ExactRates:
    """The data and contact states of an exact answer."""

    def __init__(self, answer: ExactSolution) -> None:
        self.answer, self.data = answer, of_floats(answer.problem)
        if self.data.frictional and self.data.width > 1:
            raise Unsupported("exact derivatives: with friction in the plane alone")
        self.u = column(answer.displacement)
        self.sharing = None if self.data.frictional else _sharing_of(answer, self.data)
        if self.sharing is not None:
            return
        if number_of_combinations([self._choices(i) for i in range(self.data.contacts)]) > MOST:
            raise Unsupported("exact derivatives: too many contacts at the border of two states")
        widest = (self._choices(i, True) for i in range(self.data.contacts))
        states = tuple(STICK if STICK in choices else choices[-1] for choices in widest)
        self.exerted = self.data.f - self.data.K * self.u
        cones = _cones_that_exert(self.exerted, self.data, states)
        assert cones is not None  # the states of the answer's forces
        self.cones, self.shared = cones, cones.contacts_that_share()

    def _choices(self, i: int, shares: bool = False) -> tuple[int, ...]:
        """Return the states to which a contact may change if its force is not unique; SLIP_ON without friction."""
        answer, mu, word = self.answer, self.data.friction[i], self.answer.contact_status[i]
        if word == "open":
            return (OPEN,)
        grazes = shares or word == "grazing"
        if answer.slip is None or answer.friction_force is None:
            return (OPEN, SLIP_ON) if grazes else (SLIP_ON,)
        slip, drag = answer.slip[i, 0], answer.friction_force[i, 0]
        along = SLIP_BACK if slip < 0 or (slip == 0 and mu and drag < 0) else SLIP_ON
        if slip or mu == 0:
            return (OPEN, along) if grazes else (along,)
        if grazes:
            return OPEN, STICK, SLIP_ON, SLIP_BACK
        return (STICK,) if abs(drag) < fraction(mu) * answer.normal_force[i] else (STICK, along)

    def read(self, parameter: str, direction: Any) -> Along:
        """Return the rates of load, gap, slip, tie and friction as columns, and those due to a changed matrix."""
        data, problem = self.data, self.answer.problem
        shapes = dict(
            load=(data.unknowns,), gap=(data.contacts,), tie_value=(data.ties,), friction=(data.contacts,),
            slip_origin=(data.contacts * data.width,), stiffness=problem.stiffness.shape, rows=problem.normal.shape,
        )  # fmt: skip
        try:
            dense = direction.toarray() if hasattr(direction, "toarray") else np.array(direction, dtype=object)
        except Exception:  # noqa: BLE001  whatever an object says of itself as an array
            raise InvalidProblem(f"direction: expected finite numbers, got {shown(direction)}") from None
        if len(shapes[parameter]) == 1 and dense.size == shapes[parameter][0]:
            dense = dense.ravel()
        if dense.shape != shapes[parameter]:
            raise InvalidProblem(f"direction: expected shape {shapes[parameter]}, got {dense.shape}")
        try:
            entries = [Fraction(x) for x in dense.ravel().tolist()]
        except (TypeError, ValueError, OverflowError):
            raise InvalidProblem(f"direction: expected finite numbers, got {shown(direction)}") from None
        names = dict(load="own", gap="gap", tie_value="tie", friction="friction", slip_origin="slip")
        along = {name: zeros(shapes[parameter][0], 1) for parameter, name in names.items()}
        along |= dict(strained=zeros(data.unknowns, 1), stiffness=zeros(0, data.unknowns), rows=zeros(0, data.unknowns))
        if parameter in names:
            along[names[parameter]] = column(entries)
            return along
        along[parameter] = change = fmpq_mat(dense.shape[0], dense.shape[1], column(entries).entries())
        along["strained" if parameter == "stiffness" else "gap"] = -(change * self.u)
        return along

    def rates(self, of: str, along: Along) -> tuple[Any, Fraction | float | None] | str:
        """Return the exact rates of a quantity along a direction and their reach, or the reason why there are none."""
        if self.sharing is not None:
            return self._without_friction(of, along, self.sharing)
        if any(self._is_still(i) for i, change in enumerate(along["friction"].entries()) if change != 0):
            return "a contact has neither friction nor slip, which friction could act against"
        choices = [self._choices(i, i in self.shared) for i in range(self.data.contacts)]
        if number_of_combinations(choices) > MOST or (of in FORCES and not self.cones.only(of)):
            return REDUNDANT
        found: list[tuple[Any, Fraction | float]] = []
        for states in combinations_of(choices):
            rates = self._in_states(states, of, along)
            if isinstance(rates, str):
                return rates
            if rates is not None:
                found.append(rates)
        if any(np.any(found[0][0] != other) for other, _ in found):
            return "several rates continue the answer"
        if not found:
            return "no rates continue the answer"
        return found[0][0], max(reach for _, reach in found)

    def _is_still(self, i: int) -> bool:
        """Return whether a contact that may have a force has neither friction nor slip."""
        slip, pushes = self.answer.slip, self.answer.normal_force[i] > 0 or i in self.shared
        return self.data.friction[i] == 0 and pushes and slip is not None and slip[i, 0] == 0

    def _without_friction(self, of: str, along: Along, sharing: _Sharing) -> tuple[Any, Fraction | float | None] | str:
        """Return the rates of a quantity without friction and their reach, or the reason why there are none."""
        data, touching = self.data, sharing.contacts
        if not is_zero(along["friction"]):
            return SMOOTH
        motions = null_space(stack(data.K, data.A, take(data.E, sharing.pushing)))
        if not all(is_zero(along[name] * motions) for name in ("stiffness", "rows")):
            return FREE
        if not is_zero(along["own"].transpose() * motions):
            return DRIVEN
        least = sharing.least(stack(take(along["gap"], touching), along["tie"]))
        if least is None:
            return CANNOT
        load = along["own"] + along["strained"]
        if along["rows"].nrows():
            turn = take(along["rows"], touching)
            if not least.exert_one(turn):
                return REDUNDANT
            load -= turn.transpose() * take(least.family.start, range(len(touching)))
        found = _minimal(data, load, along, least)
        if found is None:
            return DRIVEN
        du, ahead, more = found
        either = beside(motions, more)
        if of in FORCES and not (sharing.only(of) and ahead.only(of)):
            return REDUNDANT
        if either.ncols() and (of in ("displacement", "slip") or (of == "gap" and not is_zero(data.E * either))):
            return FREE
        normal, forces = zeros(data.contacts, 1), ahead.family.start.entries()
        for i, push in zip(ahead.contacts, forces, strict=False):
            normal[i, 0] = push
        ties = column(forces[len(ahead.contacts) :])
        rates = self._quantities(du, [normal, zeros(data.contacts * data.width, 1), ties], along)
        if not is_zero(data.E * either):
            return rates[of], None
        gaps = zip(self.answer.gap, rates["gap"], strict=True)
        steps: list[Fraction | float] = [gap / -rate for gap, rate in gaps if gap > 0 > rate]
        return rates[of], min([ahead.reach(least), *steps])

    def _in_states(self, states: States, of: str, along: Along) -> tuple[Any, Fraction | float] | str | None:
        """Return the rates of a quantity in a combination of states and their reach, or the reason why there are none.

        None if the combination cannot exert the forces of the answer, or not beyond it.
        """
        data, cones = self.data, _cones_that_exert(self.exerted, self.data, states)
        if cones is None:
            return None
        turned, ways = cones.turned(along), cones.family.directions
        if is_zero(turned * ways):  # the same additional force for all force distributions
            ways = zeros(cones.rows.nrows(), 0)
        n, c = data.unknowns, [i for i, s in enumerate(states) if s != OPEN]
        b, idle = [i for i, s in enumerate(states) if s == STICK], data.idle_ties
        held, size = stack(take(data.E, c), take(data.T, b), data.A), cones.rows.nrows()
        none = unit_rows(size, [len(cones.edges) + tie for tie in idle])
        system = beside(
            stack(data.K, held, zeros(len(idle), n)),
            stack(cones.rows.transpose(), zeros(held.nrows(), size), none),
            stack(turned * ways, zeros(held.nrows() + len(idle), ways.ncols())),
        )
        load = along["own"] + along["strained"] - turned * cones.sizes
        right = stack(load, take(along["gap"], c), take(along["slip"], b), along["tie"], zeros(len(idle), 1))
        solved = solve_any(system, right)
        if solved is None:
            return None
        x, more = solved[0], zeros(system.ncols(), 0) if solved[1] else null_space(system)
        least, matrix = self._conditions(states, cones, along, ways)
        region = region_of(least + matrix * x, matrix * more)
        if region.empty:
            return None
        if region.ends(fraction_rows(take(more, range(n)))) != []:
            return REDUNDANT if ways.ncols() else SINGULAR
        forces = cones.forces(of) if of in FORCES else zeros(0, size)
        if region.ends(fraction_rows(forces * take(more, range(n, n + size)))) != []:
            return REDUNDANT
        x += more * column(region.point())
        du, sizes, shift = (take(x, part) for part in (range(n), range(n, n + size), range(n + size, x.nrows())))
        rates = self._quantities(du, [cones.forces(name) * sizes for name in FORCES], along)
        widened = cones.widened(along) * (cones.sizes + ways * shift)
        rates["friction_force"] += np.array(fractions(widened), dtype=object)[:, None]
        return rates[of], min([cones.reach(sizes), *self._events(states, rates)])

    def _conditions(self, states: States, cones: _Cones, along: Along, ways: fmpq_mat) -> tuple[fmpq_mat, fmpq_mat]:
        """Return (q, 1) and (q, n + p + k + r): the first plus the second times rates must not be negative.

        They are rates of edges of size zero, of gaps of touching contacts that open, of beginning slips, and, if r
        parameters of the force distribution count, sizes.
        """
        data, n, size = self.data, self.data.unknowns, cones.rows.nrows()
        grow = [n + place for place in range(len(cones.edges)) if not cones.presses(place)]
        opens = [i for i, state in enumerate(states) if state == OPEN and self.answer.gap[i] == 0]
        begins = [i for i, state in enumerate(states) if self._begins(i, state)]
        sides = fmpq_mat(len(begins), len(begins), [states[i] * (i == j) for i in begins for j in begins])
        motion = stack(-1 * take(data.E, opens), sides * take(data.T, begins))
        shared = range(len(cones.edges) if ways.ncols() else 0)
        given = (zeros(len(grow), 1), take(along["gap"], opens), -1 * (sides * take(along["slip"], begins)))
        return stack(*given, take(cones.sizes, shared)), stack(
            unit_rows(n + size + ways.ncols(), grow),
            beside(motion, zeros(motion.nrows(), size + ways.ncols())),
            beside(zeros(len(shared), n + size), take(ways, shared)),
        )

    def _begins(self, i: int, state: int) -> bool:
        """Return whether a contact without slip begins to slip in a state."""
        slip = self.answer.slip
        return bool(abs(state) == 1 and self.data.friction[i] and slip is not None and not slip[i, 0])

    def _events(self, states: States, rates: dict[str, Any]) -> Iterator[Fraction]:
        """Yield the steps at which contacts close, or stop slipping; those at a border already move away from it."""
        answer, mu = self.answer, self.data.friction
        pairs = list(zip(answer.gap, rates["gap"], strict=True))
        for i, state in enumerate(states):
            pushes = answer.normal_force[i] or rates["normal_force"][i] or i in self.shared
            if mu[i] and abs(state) == 1 and answer.slip is not None and pushes:
                pairs.append((state * answer.slip[i, 0], state * rates["slip"][i, 0]))
        yield from (size / -rate for size, rate in pairs if size > 0 > rate)

    def _quantities(self, du: fmpq_mat, forces: list[fmpq_mat], along: Along) -> dict[str, Any]:
        """Return the rates of all quantities from those of displacements, normal, friction and tie forces."""
        data, m = self.data, self.data.contacts
        parts = dict(zip(FORCES, forces, strict=True)) | dict(displacement=du, gap=along["gap"] - data.E * du)
        parts["reaction"] = along["own"] + along["strained"] - data.K * du
        parts["slip"] = data.T * du - along["slip"]
        found: dict[str, Any] = {name: np.array(fractions(part), dtype=object) for name, part in parts.items()}
        found |= {name: found[name].reshape(m, data.width) for name in ("friction_force", "slip")}
        half = along["strained"] * fmpq(1, 2)
        found["energy"] = fraction(dot(data.K * self.u - data.f, du) - dot(self.u, along["own"] + half))
        return found


@dataclass(frozen=True, eq=False)
class _Cones:
    """The edges of the cones of contact forces, and all sizes of edges and ties that exert a given force."""

    data: RationalProblem
    edges: tuple[tuple[int, int], ...]  # contact, and direction of its friction
    rows: fmpq_mat  # (p + k, n) E_i + side mu_i T_i of each edge, and ties
    family: Family  # sizes (p + k,) of these, nonnegative for edges
    sizes: fmpq_mat  # (p + k, 1) one solution

    def presses(self, place: int) -> bool:
        """Return whether an edge has a positive size in some solution."""
        return place not in self.family.zero_rooms

    def contacts_that_share(self) -> frozenset[int]:
        """Return the contacts whose forces are not unique."""
        size, same = self.rows.nrows(), self.family.are_same
        return frozenset(i for place, (i, _) in enumerate(self.edges) if not same(unit_rows(size, [place])))

    def forces(self, of: str) -> fmpq_mat:
        """Return the matrix that maps sizes to normal, friction or tie forces."""
        count, mu = len(self.edges), self.data.friction
        if of == "tie_force":
            return unit_rows(count + self.data.ties, range(count, count + self.data.ties))
        found = zeros(self.data.contacts, count + self.data.ties)
        for place, (i, side) in enumerate(self.edges):
            found[i, place] = fmpq(1) if of == "normal_force" else side * mu[i]
        return found

    def only(self, of: str) -> bool:
        """Return whether the forces of one kind are unique."""
        return self.family.are_same(self.forces(of))

    def widened(self, along: Along) -> fmpq_mat:
        """Return the matrix that maps sizes to the rates of friction due to changed coefficients.

        A contact that sticks strictly within its cone is not affected.
        """
        found = zeros(self.data.contacts, self.rows.nrows())
        for place, (i, side) in enumerate(self.edges):
            other = next((p for p, edge in enumerate(self.edges) if edge == (i, -side)), None)
            if other is None or not (self.presses(place) and self.presses(other)):
                found[i, place] = side * along["friction"][i, 0]
        return found

    def turned(self, along: Along) -> fmpq_mat:
        """Return the matrix (n, p + k) that maps sizes to their additional force along a direction."""
        found = self.widened(along).transpose() * self.data.T
        if along["rows"].nrows():
            found += self.forces("normal_force").transpose() * along["rows"]
        return found.transpose()

    def reach(self, rates: fmpq_mat) -> Fraction | float:
        """Return the largest step along rates of the sizes (p + k, 1) up to which the edges can exert the force."""
        sizes, rates = (take(part, range(len(self.edges))) for part in (self.sizes, rates))
        return longest(fractions(sizes), fraction_rows(beside(self.family.slope, rates)))


def _cones_that_exert(force: fmpq_mat, data: RationalProblem, states: States) -> _Cones | None:
    """Return the edges of contacts in some states that exert a force (n, 1) with the ties, None if they cannot."""
    sides: dict[int, tuple[int, ...]] = {STICK: (1, -1), OPEN: ()}
    edges = tuple((i, side) for i, state in enumerate(states) for side in sides.get(state, (state,)))
    normal, tangent = (take(part, [i for i, _ in edges]) for part in (data.E, data.T))
    drags = [side * data.friction[i] * x for (i, side), row in zip(edges, tangent.tolist(), strict=True) for x in row]
    rows = stack(normal + fmpq_mat(len(edges), data.unknowns, drags), data.A)
    count, idle = len(edges), data.idle_ties
    acting = stack(rows.transpose(), unit_rows(rows.nrows(), [count + tie for tie in idle]))
    solved = solve_any(acting, stack(force, zeros(len(idle), 1)))
    if solved is None:
        return None
    start, directions = solved[0], zeros(rows.nrows(), 0) if solved[1] else null_space(acting)
    room, slope = (take(part, range(count)) for part in (start, directions))
    region = region_of(room, slope)
    if region.empty:
        return None
    sizes = start + directions * column(region.point())
    return _Cones(data, edges, rows, Family(start, directions, room, slope), sizes)


@dataclass(frozen=True, eq=False)
class _Sharing:
    """All forces of touching contacts (some without tension) and ties that exert the same nodal force."""

    contacts: tuple[int, ...]
    family: Family  # forces (q + k,), contacts first, with slacks of contacts without tension

    @property
    def pushing(self) -> list[int]:
        """Return the contacts with a positive force in some solution."""
        ends = zip(self.contacts, self.family.ranges(range(len(self.contacts))), strict=True)
        return [i for i, (_, most) in ends if most is None or most > 0]

    def only(self, of: str) -> bool:
        """Return whether the normal or tie forces are unique; there is no friction."""
        count, size = len(self.contacts), int(self.family.start.nrows())
        entries = dict(normal_force=range(count), tie_force=range(count, size)).get(of, range(0))
        return self.family.are_same(unit_rows(size, entries))

    def least(self, cost: fmpq_mat) -> _Sharing | None:
        """Return the solutions with least product of forces and cost (q + k, 1), None if there is no least one."""
        one, family = cost.transpose(), self.family
        slope = one * family.directions
        if is_zero(slope):
            return self
        ways = Polyhedron(fractions(family.room), fraction_rows(family.slope), int(slope.ncols()))
        at, _ = ways.range(fraction_rows(slope)[0])
        if at is None:
            return None
        start, room_there = (part + move * column(at) for part, move in (
            (family.start, family.directions), (family.room, family.slope)))  # fmt: skip
        # The last slack is the least product minus the product.
        there = Family(start, family.directions, stack(room_there, zeros(1, 1)), stack(family.slope, -1 * slope))
        return replace(self, family=there)

    def exert_one(self, turn: fmpq_mat) -> bool:
        """Return whether turned rows (q, n) of the contacts exert the same force for all solutions."""
        size = self.family.start.nrows()
        return self.family.are_same(turn.transpose() * unit_rows(size, range(len(self.contacts))))

    def reach(self, before: _Sharing) -> Fraction | float:
        """Return the largest step x for which forces `before` + x times these are nonnegative."""
        place = {i: p for p, i in enumerate(before.contacts)}
        start = take(before.family.start, [place[i] for i in self.contacts])
        ways = take(beside(self.family.directions, self.family.start), range(len(self.contacts)))
        return longest(fractions(start), fraction_rows(ways))


def _sharing_of(answer: ExactSolution, data: RationalProblem) -> _Sharing:
    """Return all force distributions of touching contacts for an answer without friction."""
    touching = tuple(i for i, gap in enumerate(answer.gap) if gap == 0)
    start = stack(column([answer.normal_force[i] for i in touching]), column(answer.tie_force))
    return _shared(data, touching, start, range(len(touching)))


def _shared(data: RationalProblem, contacts: tuple[int, ...], start: fmpq_mat, pushing_only: Iterable[int]) -> _Sharing:
    """Return all forces of contacts and ties with the nodal force of these (q + k, 1), zero for ties of zeros.

    `pushing_only` are the indices of the contacts without tension.
    """
    size, places = int(start.nrows()), list(pushing_only)
    rows = stack(take(data.E, contacts), data.A)
    idle = [len(contacts) + tie for tie in data.idle_ties]
    directions = null_space(stack(rows.transpose(), unit_rows(size, idle)))
    return _Sharing(contacts, Family(start, directions, take(start, places), take(directions, places)))


def _minimal(
    data: RationalProblem, load: fmpq_mat, along: Along, least: _Sharing
) -> tuple[fmpq_mat, _Sharing, fmpq_mat] | None:
    """Return the rates of displacements and forces without friction, and motions (n, r) that may be added.

    None if the load drives a motion that nothing resists.

    Parameters
    ----------
    data : RationalProblem, the problem of the answer
    load : (n, 1) fmpq_mat, the rate of the load
    along : dict, the direction
    least : _Sharing, the forces of the answer that the direction leaves
    """
    closed, gap = least.pushing, along["gap"]
    others = [i for i in least.contacts if i not in closed]
    posed = RationalProblem(
        K=data.K, f=load, E=take(data.E, others), g=take(gap, others), A=stack(data.A, take(data.E, closed)),
        b=stack(along["tie"], take(gap, closed)), T=zeros(0, data.unknowns), friction=(fmpq(0),) * len(others),
        slip_origin=zeros(0, 1),
    )  # fmt: skip
    try:
        found = settle(posed, [(), tuple(range(len(others)))], MOST_PIVOTS)
    except NoSolution:
        return None
    du, ties = found.answer.displacement, found.answer.tie_force.entries()
    pushes = dict(zip([*others, *closed], [*found.answer.normal_force.entries(), *ties[data.ties :]], strict=True))
    apart = (gap - data.E * du).entries()
    touching = tuple(i for i in least.contacts if apart[i] == 0)
    forces = column([*(pushes[i] for i in touching), *ties[: data.ties]])
    free = [place for place, i in enumerate(touching) if i not in closed]
    return du, _shared(data, touching, forces, free), found.motions
