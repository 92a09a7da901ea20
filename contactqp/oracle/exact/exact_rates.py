"""Derivatives of exact answers in Fractions, towards either side.

Without friction the displacement changes at the rate du that minimises 1/2 du'K du - df'du over the changes

    E_i du = dg_i    where a contact stays closed,    E_i du <= dg_i    where another touches,    A du = db,

which is one more problem in rational numbers. Redundant contacts share the force r = f - K u in many ways; then those
stay closed that push in one of the ways in which l'dg + nu'db is least (Shapiro, SIAM J. Control Optim. 26, 1988).

With friction in the plane contacts keep the states that they are in exactly; those at the border of two states may go
to either. In each combination rates solve a linear system (`contactqp.analysis.rate_systems` has it); those of one
whose signs lead to where it says are the answer's.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

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
    fractions,
    is_zero,
    null_space,
    solve_any,
    stack,
    take,
    zeros,
)
from contactqp.model.arguments import checked
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, combinations_of, number_of_combinations
from contactqp.oracle.exact.exact_solution import ExactSolution, Fractions
from contactqp.oracle.exact.rational_equilibrium import settle
from contactqp.oracle.exact.rational_problem import MOST_PIVOTS, Family, RationalProblem, of_floats

FORCES = ("normal_force", "friction_force", "tie_force")
QUANTITIES = (*FORCES, "displacement", "gap", "slip", "reaction", "energy")
PARAMETERS = ("load", "gap", "tie_value", "friction", "slip_origin", "stiffness", "rows")
# Along these the answer is linear while contacts keep their states.
LINEAR = ("load", "gap", "tie_value", "slip_origin")
# Combinations of states of contacts at a border, at most.
MOST = 1024
CANNOT = "contacts that touch, and ties, cannot change their gaps and values so"
DRIVEN = "the direction drives a motion that nothing holds"
FREE = "bodies are free to move, and their displacements are not unique"
REDUNDANT = "contacts that touch, or ties, are redundant, and their forces are not unique"
SINGULAR = "in a combination of states that may come the rates are not unique"
SMOOTH = "no contact has friction: rates by coefficients are those of problems that have some"


@dataclass(frozen=True, eq=False)
class ExactDerivative:
    """Rates in Fractions towards minus and plus a direction; `value` is both where they are one, else None.

    `reach` are the steps (back, ahead) within which no contact changes its state, infinity where none ever does; None
    where the answer is not linear along the direction. Where contacts share their forces in many ways, they are those
    within which all that touch can exert the force that is needed.
    """

    value: Any
    left: Any
    right: Any
    exists: bool
    reason: str = ""
    reach: tuple[Fraction | float, Fraction | float] | None = None


@checked
def exact_derivative(answer: ExactSolution, of: str, with_respect_to: str, direction: Any) -> ExactDerivative:
    """Return the exact rates of a quantity of an exact answer; names as in `Solution.derivative`.

    Raises InvalidProblem: a name that is none of these, a wrong shape, or numbers that are not finite; Unsupported: an
    enclosed answer, one of a case's own numbers, friction in space, or too many contacts at a border.

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
    if isinstance(ahead, str) or isinstance(back, str):
        return ExactDerivative(None, None, None, False, ahead if isinstance(ahead, str) else str(back))
    left, right, same = -back[0], ahead[0], bool(np.all(ahead[0] == -back[0]))
    reason = "" if same else "the two sides differ: contacts are at the border of two states"
    reach = None
    if with_respect_to in LINEAR and not (ahead[1] is None or back[1] is None):
        reach = back[1], ahead[1]
    return ExactDerivative(right if same else None, left, right, same, reason, reach)


class _ExactRates:
    """The data and the states of an exact answer."""

    def __init__(self, answer: ExactSolution) -> None:
        self.answer, self.data = answer, of_floats(answer.problem)
        if self.data.frictional and self.data.width > 1:
            raise Unsupported("exact derivatives: with friction in the plane alone")
        self.u, self.force = column(answer.displacement), column(answer.normal_force)
        self.choices = [self._choices(i) for i in range(self.data.contacts)] if self.data.frictional else []
        if number_of_combinations(self.choices) > MOST:
            raise Unsupported("exact derivatives: too many contacts at the border of two states")
        self.sharing = None if self.data.frictional else _sharing_of(answer, self.data)

    def _choices(self, i: int) -> tuple[int, ...]:
        """Return the states that a contact may go to; SLIP_ON where it pushes without friction."""
        answer, mu, word = self.answer, self.data.friction[i], self.answer.contact_status[i]
        if word == "open":
            return (OPEN,)
        if answer.slip is None or answer.friction_force is None:
            return (OPEN, SLIP_ON) if word == "grazing" else (SLIP_ON,)
        if mu == 0:
            along = SLIP_BACK if answer.slip[i, 0] < 0 else SLIP_ON
            return (OPEN, along) if word == "grazing" else (along,)
        slip, drag = answer.slip[i, 0], answer.friction_force[i, 0]
        along = SLIP_ON if slip > 0 else SLIP_BACK
        if word == "slip":
            return (along,)
        if word == "grazing":
            return (OPEN, along) if slip else (OPEN, STICK, SLIP_ON, SLIP_BACK)
        if abs(drag) < fraction(mu) * answer.normal_force[i]:
            return (STICK,)
        return STICK, SLIP_ON if drag > 0 else SLIP_BACK

    def read(self, parameter: str, direction: Any) -> dict[str, fmpq_mat]:
        """Return load, gap, slip, tie and friction of the rates, as columns, and what a matrix changes."""
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
        names = dict(load="load", gap="gap", tie_value="tie", friction="friction", slip_origin="slip")
        sizes = (data.unknowns, data.contacts, data.ties, data.contacts, data.contacts * data.width)
        along = {name: zeros(size, 1) for name, size in zip(names.values(), sizes, strict=True)}
        along |= dict(own=zeros(data.unknowns, 1), strained=zeros(data.unknowns, 1))
        along |= dict(stiffness=zeros(0, data.unknowns), rows=zeros(0, data.unknowns))
        if parameter in names:
            along[names[parameter]] = column(entries)
            along["own"] = along["load"]
            return along
        along[parameter] = change = fmpq_mat(dense.shape[0], dense.shape[1], column(entries).entries())
        if parameter == "stiffness":
            along["load"] = along["strained"] = -(change * self.u)
        else:
            along["load"], along["gap"] = -(change.transpose() * self.force), -(change * self.u)
        return along

    def rates(self, of: str, along: dict[str, fmpq_mat]) -> tuple[Any, Fraction | float | None] | str:
        """Return the exact rates of a quantity towards a direction and how far they reach, or why there are none."""
        if self.sharing is not None:
            return self._without_friction(of, along, self.sharing)
        if any(self._is_still(i) for i, change in enumerate(along["friction"].entries()) if change != 0):
            return "a contact has neither friction nor slip, which friction could act against"
        found: list[tuple[Any, Fraction | float]] = []
        for states in combinations_of(self.choices):
            rates = self._in_states(states, along)
            if rates is None:
                continue
            if not rates["unique"]:
                return SINGULAR
            if self._holds(states, rates, along):
                found.append((rates[of], min(self._events(states, rates), default=math.inf)))
        if any(np.any(found[0][0] != other) for other, _ in found):
            return "several rates continue the answer"
        if not found:
            return "no rates continue the answer"
        return found[0][0], min(reach for _, reach in found)

    def _is_still(self, i: int) -> bool:
        """Return whether a contact that pushes has neither friction nor slip."""
        slip = self.answer.slip
        return self.data.friction[i] == 0 and self.force[i, 0] > 0 and slip is not None and slip[i, 0] == 0

    def _without_friction(
        self, of: str, along: dict[str, fmpq_mat], sharing: _Sharing
    ) -> tuple[Any, Fraction | float | None] | str:
        """Return the rates of a quantity and how far they reach, or why there are none, without friction."""
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
        x, none = [*du.entries(), *ahead.family.start.entries()], [fmpq(0)] * data.contacts
        rates = self._quantities(x, (list(ahead.contacts), []), ([0] * data.contacts, none), along)
        if not is_zero(data.E * either):
            return rates[of], None
        gaps = zip(self.answer.gap, rates["gap"], strict=True)
        steps: list[Fraction | float] = [gap / -rate for gap, rate in gaps if gap > 0 > rate]
        return rates[of], min([ahead.reach(least), *steps])

    def _events(self, states: tuple[int, ...], rates: dict[str, Any]) -> Iterator[Fraction]:
        """Yield the steps at which contacts leave these states; what is at a border already moves away from it."""
        answer = self.answer
        for i, state in enumerate(states):
            pairs = [(answer.gap[i], rates["gap"][i])]
            if state != OPEN:
                pairs = [(answer.normal_force[i], rates["normal_force"][i])]
            mu = fraction(self.data.friction[i])
            if mu and state == STICK and answer.friction_force is not None:
                push, change = mu * answer.normal_force[i], mu * rates["normal_force"][i]
                drag, drags = answer.friction_force[i, 0], rates["friction_force"][i, 0]
                pairs += [(push - side * drag, change - side * drags) for side in (1, -1)]
            elif mu and state != OPEN and answer.slip is not None and (answer.normal_force[i] or pairs[0][1]):
                pairs.append((state * answer.slip[i, 0], state * rates["slip"][i, 0]))
            yield from (size / -rate for size, rate in pairs if size > 0 > rate)

    def _in_states(self, states: tuple[int, ...], along: dict[str, fmpq_mat]) -> dict[str, Any] | None:
        """Return the rates in a combination of states, None where its system has none."""
        data = self.data
        c, b = ([i for i, s in enumerate(states) if s != OPEN], [i for i, s in enumerate(states) if s == STICK])
        E, T, A = (_array(part.tolist(), data.unknowns) for part in (data.E, data.T, data.A))
        signs = [s if abs(s) == 1 else 0 for s in states]
        pushed = [E[i] + (data.friction[i] * signs[i]) * T[i] if data.width and signs[i] else E[i] for i in c]
        held = [*(E[i] for i in c), *(T[i] for i in b), *A]
        acting = [*pushed, *(T[i] for i in b), *A]
        size = len(held)
        top = np.concatenate([np.array(data.K.tolist(), dtype=object), _array(acting, data.unknowns).T], axis=1)
        low = np.concatenate([_array(held, data.unknowns), _array([[fmpq(0)] * size] * size, size)], axis=1)
        load = along["load"].entries()
        own = [data.friction[i] * 0 for i in range(data.contacts)]
        if data.width:
            own = [along["friction"][i, 0] * self.force[i, 0] * signs[i] for i in range(data.contacts)]
            dragged = [sum((T[i][j] * own[i] for i in c), fmpq(0)) for j in range(data.unknowns)]
            load = [x - y for x, y in zip(load, dragged, strict=True)]
        right = [*load, *(along["gap"][i, 0] for i in c), *(along["slip"][i, 0] for i in b), *along["tie"].entries()]
        whole = np.concatenate([top, low])
        system = fmpq_mat(len(whole), len(whole), whole.ravel().tolist())
        solved = solve_any(system, fmpq_mat(len(right), 1, right))
        if solved is None:
            return None
        return self._quantities(solved[0].entries(), (c, b), (signs, own), along) | dict(unique=solved[1])

    def _quantities(
        self, x: list[fmpq], places: tuple[list[int], list[int]], law: tuple[list[int], list[fmpq]],
        along: dict[str, fmpq_mat],
    ) -> dict[str, Any]:  # fmt: skip
        data, (c, b), (signs, own) = self.data, places, law
        n, m = data.unknowns, data.contacts
        u, normal = fmpq_mat(n, 1, x[:n]), [fmpq(0)] * m
        for place, i in enumerate(c):
            normal[i] = x[n + place]
        found: dict[str, Any] = dict(displacement=_fractions(x[:n]), normal_force=_fractions(normal))
        found["tie_force"] = _fractions(x[n + len(c) + len(b) :])
        found["gap"] = np.array(fractions(along["gap"] - data.E * u), dtype=object)
        found["reaction"] = np.array(fractions(along["own"] + along["strained"] - data.K * u), dtype=object)
        half = along["strained"] * fmpq(1, 2)
        found["energy"] = fraction(dot(data.K * self.u - data.f, u) - dot(self.u, along["own"] + half))
        if data.width:
            drag = [data.friction[i] * signs[i] * normal[i] + (own[i] if i in c else 0) for i in range(m)]
            for place, i in enumerate(b):
                drag[i] = x[n + len(c) + place]
            found["friction_force"] = _fractions(drag).reshape(m, 1)
            found["slip"] = np.array(fractions(data.T * u - along["slip"]), dtype=object).reshape(m, -1)
        else:
            found["friction_force"] = found["slip"] = np.zeros((m, 0), dtype=object)
        return found

    def _holds(self, states: tuple[int, ...], rates: dict[str, Any], along: dict[str, fmpq_mat]) -> bool:
        return all(sign >= 0 for i, s in enumerate(states) for sign in self._signs(i, s, rates, along))

    def _signs(self, i: int, state: int, rates: dict[str, Any], along: dict[str, fmpq_mat]) -> Iterator[Any]:
        """Yield the quantities that must not be negative if a contact at a border changes to a state."""
        if len(self.choices[i]) == 1:
            return
        grazes = self.answer.contact_status[i] == "grazing"
        if state == OPEN:
            yield rates["gap"][i]
            return
        if grazes:
            yield rates["normal_force"][i]
        if self.data.friction[i] == 0:
            return
        room = fraction(self.data.friction[i]) * rates["normal_force"][i]
        room += fraction(along["friction"][i, 0] * self.force[i, 0])
        if state == STICK and grazes:
            yield room - abs(rates["friction_force"][i, 0])
        elif state == STICK:
            drag = self.answer.friction_force
            assert drag is not None
            yield room - (1 if drag[i, 0] > 0 else -1) * rates["friction_force"][i, 0]
        elif not grazes or len(self.choices[i]) > 2:
            yield state * rates["slip"][i, 0]


@dataclass(frozen=True, eq=False)
class _Sharing:
    """The forces of contacts that touch, some of which may not pull, and of all ties, that exert the same force."""

    contacts: tuple[int, ...]
    family: Family  # forces (q + k,), those of contacts first, whose rooms are those of contacts that may not pull

    @property
    def pushing(self) -> list[int]:
        """Return the contacts that push in one of the ways to share the force."""
        ends = self.family.ranges(range(len(self.contacts)))
        return [i for i, (_, most) in zip(self.contacts, ends, strict=True) if most is None or most > 0]

    def only(self, of: str) -> bool:
        """Return whether there is only one such normal or tie force; friction there is none."""
        count, size = len(self.contacts), int(self.family.start.nrows())
        entries = dict(normal_force=range(count), tie_force=range(count, size)).get(of, range(0))
        return all(least == most and least is not None for least, most in self.family.ranges(entries))

    def least(self, cost: fmpq_mat) -> _Sharing | None:
        """Return the ways in which the product of the forces with a cost (q + k, 1) is least; None if there is none."""
        one, family = cost.transpose(), self.family
        slope = one * family.directions
        if is_zero(slope):
            return self
        room = [fraction(x) for x in family.room.entries()]
        ways = Polyhedron(room, _rows_of(family.slope), int(slope.ncols()))
        at, _ = ways.range(_rows_of(slope)[0])
        if at is None:
            return None
        start, room_there = (part + move * column(at) for part, move in (
            (family.start, family.directions), (family.room, family.slope)))  # fmt: skip
        # The last room is by how much the product is below the least.
        there = Family(start, family.directions, stack(room_there, zeros(1, 1)), stack(family.slope, -1 * slope))
        return replace(self, family=there)

    def exert_one(self, turn: fmpq_mat) -> bool:
        """Return whether turned rows (q, n) of the contacts exert one force, however they share it."""
        family = self.family
        rooms = Family(family.room, family.slope, family.room, family.slope).ranges(range(family.room.nrows()))
        none = [place for place, (_, most) in enumerate(rooms) if most == 0]
        ways = take(family.directions, range(len(self.contacts))) * null_space(take(family.slope, none))
        return is_zero(turn.transpose() * ways)

    def reach(self, before: _Sharing) -> Fraction | float:
        """Return the largest step x along which forces `before` + x times these push."""
        place = {i: p for p, i in enumerate(before.contacts)}
        at = [place[i] for i in self.contacts]
        start = [fraction(before.family.start[p, 0]) for p in at]
        moved = _rows_of(self.family.directions)[: len(at)]
        rates = [fraction(x) for x in self.family.start.entries()]
        slopes = [[*row, rate] for row, rate in zip(moved, rates, strict=False)]
        size = int(self.family.directions.ncols()) + 1
        step = [Fraction(0)] * (size - 1) + [Fraction(1)]
        _, most = Polyhedron([*start, Fraction(0)], [*slopes, step], size).range(step)
        return math.inf if most is None else most[-1]


def _sharing_of(answer: ExactSolution, data: RationalProblem) -> _Sharing:
    """Return the ways in which the contacts that touch may share the force of an answer without friction."""
    touching = tuple(i for i, gap in enumerate(answer.gap) if gap == 0)
    start = stack(column([answer.normal_force[i] for i in touching]), column(answer.tie_force))
    return _shared(data, touching, start, range(len(touching)))


def _shared(data: RationalProblem, contacts: tuple[int, ...], start: fmpq_mat, pushing_only: Iterable[int]) -> _Sharing:
    """Return all forces of contacts and ties that exert what these do (q + k, 1); ties of zeros exert nothing.

    `pushing_only` are the places of the contacts that may not pull.
    """
    size, places = int(start.nrows()), list(pushing_only)
    rows = stack(take(data.E, contacts), data.A)
    unit = fmpq_mat(size, size, [int(i == j) for i in range(size) for j in range(size)])
    idle = [place for place in range(len(contacts), size) if is_zero(take(rows, [place]))]
    directions = null_space(stack(rows.transpose(), take(unit, idle)))
    return _Sharing(contacts, Family(start, directions, take(start, places), take(directions, places)))


def _minimal(
    data: RationalProblem, load: fmpq_mat, along: dict[str, fmpq_mat], least: _Sharing
) -> tuple[fmpq_mat, _Sharing, fmpq_mat] | None:
    """Return the rates of displacements without friction, those of forces, and motions (n, r) that may be added.

    None where the load drives a motion that nothing holds.

    Parameters
    ----------
    data : RationalProblem, that of the answer
    load : (n, 1) fmpq_mat, what drives the rates
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
    forces = _column([*(pushes[i] for i in touching), *ties[: data.ties]])
    free = [place for place, i in enumerate(touching) if i not in closed]
    return du, _shared(data, touching, forces, free), found.motions


def _rows_of(values: fmpq_mat) -> list[list[Fraction]]:
    return [[fraction(x) for x in row] for row in values.tolist()]


def _array(rows: list[Any], columns: int) -> Any:
    return np.array(rows, dtype=object).reshape(len(rows), columns)


def _column(values: list[fmpq]) -> fmpq_mat:
    return fmpq_mat(len(values), 1, values)


def _fractions(values: list[fmpq]) -> Fractions:
    return np.array([fraction(x) for x in values], dtype=object)
