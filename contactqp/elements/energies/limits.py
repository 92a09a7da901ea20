"""Constraints on linear combinations of unknowns, and on many unknowns at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.energies.constrained_energy import (
    Condition,
    Contribution,
    Form,
    Found,
    PartState,
    minus,
    read_form,
    read_number,
)
from contactqp.errors import InvalidProblem
from contactqp.model.problem_data import ReadOnly, read_array, read_only


@dataclass(frozen=True)
class _Bound:
    """A form and a number; the force of the constraint is its multiplier."""

    name: str
    form: Form
    bound: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "form", read_form(self.name, self.form))
        object.__setattr__(self, "bound", read_number(f"{self.name}: bound", self.bound))

    def state(self, found: Found) -> PartState:
        force = found.multiplier[self.name]
        return PartState(found.value(self.form), force, "active" if force > 0 else "inactive")


@dataclass(frozen=True)
class AtMost(_Bound):
    """The constraint form(u) <= bound; its force is the multiplier, not negative, that acts against growth.

    Raises
    ------
    InvalidProblem
        The form or the bound is none.
    """

    def contribution(self) -> Contribution:
        return Contribution(unilateral=(Condition(self.name, self.form, self.bound),))


@dataclass(frozen=True)
class AtLeast(_Bound):
    """The constraint form(u) >= bound; its force is the multiplier, not negative, that acts against decrease.

    Raises
    ------
    InvalidProblem
        The form or the bound is none.
    """

    def contribution(self) -> Contribution:
        return Contribution(unilateral=(Condition(self.name, minus(self.form), -self.bound),))


@dataclass(frozen=True)
class Equal(_Bound):
    """The constraint form(u) = bound, a support or a tie of several unknowns; its force is nu of K u + A'nu = f.

    Raises
    ------
    InvalidProblem
        The form or the bound is none.
    """

    bound: float = 0.0

    def contribution(self) -> Contribution:
        return Contribution(ties=(Condition(self.name, self.form, self.bound),))

    def state(self, found: Found) -> PartState:
        return PartState(found.value(self.form), found.multiplier[self.name], "tied")


@dataclass(frozen=True)
class Obstacle(ReadOnly):
    """The bounds lower <= u_j <= upper on many unknowns; their force is that of the lower bounds less that of the
    upper ones.

    Each bound is a constraint of its own: "<name>: <unknown> from below" or "from above" is what
    `ConstrainedMinimum.multiplier` calls it. `deformation` is the least distance of an unknown from a bound.

    Parameters
    ----------
    name : str
    unknowns : sequence of str
    lower, upper : float or array, optional
        At least one; infinite entries bound nothing.

    Raises
    ------
    InvalidProblem
        No bound, NaN, or a lower bound above the upper.
    """

    name: str
    unknowns: tuple[str, ...]
    lower: Any = None
    upper: Any = None
    _conditions: tuple[Condition, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "unknowns", tuple(self.unknowns))
        lower, upper = self._side("lower", -np.inf), self._side("upper", np.inf)
        crossed = np.flatnonzero(lower > upper)
        if crossed.size:
            i = int(crossed[0])
            raise InvalidProblem(
                f"{self.name}: expected lower <= upper, got {lower[i]:g} and {upper[i]:g} for {self.unknowns[i]}"
            )
        below = [
            Condition(f"{self.name}: {u} from below", {u: -1.0}, -float(b))
            for u, b in zip(self.unknowns, lower, strict=True)
            if b > -np.inf
        ]
        above = [
            Condition(f"{self.name}: {u} from above", {u: 1.0}, float(b))
            for u, b in zip(self.unknowns, upper, strict=True)
            if b < np.inf
        ]
        if not below + above:
            raise InvalidProblem(f"{self.name}: expected a lower or an upper bound, got neither")
        object.__setattr__(self, "_conditions", (*below, *above))

    def _side(self, which: str, none: float) -> NDArray[np.float64]:
        given = getattr(self, which)
        count = len(self.unknowns)
        bounds = read_array(f"{self.name}: {which}", none if given is None else given)
        if bounds.shape not in ((), (count,)) or np.any(np.isnan(bounds)) or np.any(bounds == -none):
            raise InvalidProblem(f"{self.name}: {which}: expected one number or {count}, none of them NaN or {-none}")
        if bounds.ndim:
            object.__setattr__(self, which, read_only(bounds))
        return np.broadcast_to(bounds, (count,))

    def contribution(self) -> Contribution:
        return Contribution(unilateral=self._conditions)

    def state(self, found: Found) -> PartState:
        total = -sum(
            found.multiplier[condition.name] * factor
            for condition in self._conditions
            for factor in condition.form.values()
        )
        distance = min(condition.bound - found.value(condition.form) for condition in self._conditions)
        active = any(found.multiplier[condition.name] > 0 for condition in self._conditions)
        return PartState(distance, float(total), "active" if active else "inactive")
