"""What a part of a structure adds to a quadratic energy, and what the minimum says about it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.model.problem_data import is_number

# A linear form of the unknowns by their names.
Form = Mapping[str, float]


@dataclass(frozen=True)
class Square:
    """1/2 stiffness (form(u) - offset)^2."""

    form: Form
    stiffness: float
    offset: float = 0.0


@dataclass(frozen=True)
class Condition:
    """form(u) <= bound, or = bound in a tie."""

    name: str
    form: Form
    bound: float


@dataclass(frozen=True)
class Contribution:
    """What a part adds: unknowns of its own, energy, constraints."""

    internal: tuple[str, ...] = ()
    squares: tuple[Square, ...] = ()
    load: Form | None = None  # energy -load(u)
    unilateral: tuple[Condition, ...] = ()
    ties: tuple[Condition, ...] = ()


@dataclass(frozen=True)
class Found:
    """Unknowns and multipliers of a minimum by their names."""

    unknown: Mapping[str, float]
    multiplier: Mapping[str, float]  # of conditions, one-sided ones not negative

    def value(self, form: Form) -> float:
        return float(sum(factor * self.unknown[name] for name, factor in form.items()))


@dataclass(frozen=True)
class PartState:
    """One part at the minimum."""

    deformation: float  # elongation, rotation, or the bounded combination of unknowns
    force: float  # what the part resists it with; the docstring of the part says which sign
    status: str  # "taut" | "slack", "pushes" | "idle", "active" | "inactive", "elastic" | "yields", "tied"
    plastic: float = 0.0  # plastic part of the deformation


class Part(Protocol):
    """Anything with a name that adds energy or constraints."""

    @property
    def name(self) -> str: ...

    def contribution(self) -> Contribution:
        """What it adds."""

    def state(self, found: Found) -> PartState:
        """What became of it."""


def read_form(part: str, given: Any) -> dict[str, float]:
    """A linear form as its user wrote it, zeros left out.

    Raises
    ------
    InvalidProblem
        It is no mapping from names to finite numbers, or zero.
    """
    if not isinstance(given, Mapping):
        raise InvalidProblem(f"{part}: expected a mapping from unknowns to factors, as {{'x': 1.0}}, got {given!r}")
    form = {str(name): read_number(f"{part}: factor of {name!r}", factor) for name, factor in given.items()}
    form = {name: factor for name, factor in form.items() if factor}
    if not form:
        raise InvalidProblem(f"{part}: expected at least one unknown with a factor that is not zero, got {dict(given)}")
    return form


def read_number(what: str, value: Any, *, positive: bool = False, above: float | None = None) -> float:
    """A finite number.

    Raises
    ------
    InvalidProblem
        It is none, or not above what it must be above.
    """
    least = 0.0 if positive else above
    expected = "a finite number" if least is None else f"a finite number above {least:g}"
    if not is_number(value) or not np.isfinite(value):
        raise InvalidProblem(f"{what}: expected {expected}, got {value!r}")
    if least is not None and not value > least:
        raise InvalidProblem(f"{what}: expected {expected}, got {value!r}")
    return float(value)


def plus(form: Form, others: Iterable[tuple[str, float]]) -> dict[str, float]:
    """A form with unknowns of the part's own."""
    return dict(form) | dict(others)


def minus(form: Form) -> dict[str, float]:
    return {name: -factor for name, factor in form.items()}
