"""Derivatives of exact answers in Fractions, towards either side: of every combination of states, the one that holds.

Without friction, and with it in the plane, contacts keep the states that they are in exactly; those at the border of
two states may go to either. In each combination rates solve a linear system (`contactqp.analysis.rate_systems` has it),
here in rational numbers; those of one whose signs lead to where it says are the answer's. Redundant contacts share
their forces in many ways, but the displacement has one rate by loads and stiffness, and so has what follows from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat

from contactqp.errors import InvalidProblem, Unsupported, shown
from contactqp.linalg.rational import column, dot, fraction, fractions, is_zero, null_space, solve_any, take, zeros
from contactqp.model.arguments import checked
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK
from contactqp.oracle.exact.exact_solution import ExactSolution, Fractions
from contactqp.oracle.exact.rational_problem import of_floats

OF_DISPLACEMENT = ("displacement", "gap", "slip", "reaction", "energy")
QUANTITIES = ("normal_force", "friction_force", "tie_force", *OF_DISPLACEMENT)
PARAMETERS = ("load", "gap", "tie_value", "friction", "slip_origin", "stiffness", "rows")
# Along these the answer is linear while contacts keep their states.
LINEAR = ("load", "gap", "tie_value", "slip_origin")
# Combinations of states of contacts at a border, at most.
MOST = 1024


@dataclass(frozen=True, eq=False)
class ExactDerivative:
    """Rates in Fractions towards minus and plus a direction; `value` is both where they are one, else None.

    `reach` are the steps (back, ahead) within which no contact changes its state, infinity where none ever does; None
    where the answer is not linear along the direction, and where contacts share their forces in many ways.
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
        self.choices = [self._choices(i) for i in range(self.data.contacts)]
        if np.prod([float(len(one)) for one in self.choices]) > MOST:
            raise Unsupported("exact derivatives: too many contacts at the border of two states")

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
        """Return load, gap, slip, tie and friction of the rates, as columns."""
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
        if parameter in names:
            along[names[parameter]] = column(entries)
            along["own"] = along["load"]
            return along
        change = fmpq_mat(dense.shape[0], dense.shape[1], column(entries).entries())
        if parameter == "stiffness":
            along["load"] = along["strained"] = -(change * self.u)
        else:
            along["load"], along["gap"] = -(change.transpose() * self.force), -(change * self.u)
        return along

    def rates(self, of: str, along: dict[str, fmpq_mat]) -> tuple[Any, Fraction | float | None] | str:
        """Return the exact rates of a quantity towards a direction and how far they reach, or why there are none."""
        found: list[tuple[Any, Fraction | float | None]] = []
        shares = self._may_share(along)
        for states in product(*self.choices):
            rates = self._in_states(states, along)
            if rates is None:
                continue
            if not (rates["unique"] or (shares and of in OF_DISPLACEMENT and rates["moves as one"])):
                return "in a combination of states that may come the rates are not unique"
            if self._holds(states, rates, along):
                reach = min(self._events(states, rates), default=math.inf) if rates["unique"] else None
                found.append((rates[of], reach))
        if any(np.any(found[0][0] != other) for other, _ in found):
            return "several rates continue the answer"
        if not found:
            return "no rates continue the answer"
        reaches = [reach for _, reach in found if reach is not None]
        return found[0][0], min(reaches) if len(reaches) == len(found) else None

    def _may_share(self, along: dict[str, fmpq_mat]) -> bool:
        """Return whether forces that are not unique leave the displacement its rates: all that touch keep touching."""
        held = is_zero(along["gap"]) and is_zero(along["tie"])
        return held and not any(self.data.friction) and all(len(one) == 1 for one in self.choices)

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
        x, unique = solved[0].entries(), solved[1]
        found = self._quantities(x, unique, (c, b), (signs, own), along)
        # What may be added to the solutions moves nothing: forces alone are many.
        found["moves as one"] = unique or is_zero(take(null_space(system), range(data.unknowns)))
        return found

    def _quantities(
        self, x: list[fmpq], unique: bool, places: tuple[list[int], list[int]], law: tuple[list[int], list[fmpq]],
        along: dict[str, fmpq_mat],
    ) -> dict[str, Any]:  # fmt: skip
        data, (c, b), (signs, own) = self.data, places, law
        n, m = data.unknowns, data.contacts
        u, normal = fmpq_mat(n, 1, x[:n]), [fmpq(0)] * m
        for place, i in enumerate(c):
            normal[i] = x[n + place]
        found: dict[str, Any] = dict(unique=unique, displacement=_fractions(x[:n]), normal_force=_fractions(normal))
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


def _array(rows: list[Any], columns: int) -> Any:
    return np.array(rows, dtype=object).reshape(len(rows), columns)


def _fractions(values: list[fmpq]) -> Fractions:
    return np.array([fraction(x) for x in values], dtype=object)
