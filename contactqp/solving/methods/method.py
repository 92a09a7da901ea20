"""Define a method: a name, its capabilities, and a function from a ContactProblem to a Candidate."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from contactqp.linalg.condensation import Condensation
from contactqp.model.arrays import seconds_left
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate


@dataclass(frozen=True)
class Settings:
    """The settings of a call, of which a method reads those that apply to it."""

    tolerance: float = 1e-9  # relative, on the nondimensional problem
    max_iter: int | None = None
    time_limit: float | None = None  # seconds
    warm_start: Candidate | None = None
    options: Mapping[str, Any] = field(default_factory=dict)  # values of the options in `Method.options`

    @property
    def now(self) -> Settings:
        """Return the settings with the remaining time of the call as limit."""
        left = seconds_left()
        return self if self.time_limit is None or left is None else replace(self, time_limit=min(self.time_limit, left))


# The kinds of methods.
ACTIVE_SET = "active set"  # our own, which condenses every problem itself
QUADRATIC_PROGRAM = "quadratic program"
MODELLING_LANGUAGE = "modelling language"
COMPLEMENTARITY = "complementarity"
CLASSICAL_ENFORCEMENT = "classical enforcement"


@dataclass(frozen=True)
class Method:
    """One entry of the registry: `solve` reads the kind and the capabilities that are stated here, never the name."""

    name: str
    kind: str  # ACTIVE_SET, QUADRATIC_PROGRAM, MODELLING_LANGUAGE, COMPLEMENTARITY, CLASSICAL_ENFORCEMENT
    solve: Callable[[ContactProblem, Settings], Candidate] = field(repr=False)
    # A function that solves from a condensation, in its retained unknowns; without it the method solves the condensed
    # problem.
    solve_condensed: Callable[[ContactProblem, Condensation, Settings], Candidate] | None = field(
        default=None, repr=False
    )
    # A function for frictional problems in the plane by own systems of stick and slip; without it the method can only
    # solve the convex steps of an algorithm of friction.
    solve_friction: Callable[[ContactProblem, Settings], Candidate] | None = field(default=None, repr=False)
    # The options for normal and tangential stiffness, if the method with friction solves Coulomb's law for bodies with
    # contact springs.
    springs: tuple[str, str] | None = None
    exact: bool = True  # promises the exact answer; otherwise approximate by design
    polish: bool = False  # whether its answer is polished on its contact set
    corrections: int = (
        2  # changes of the contact set that polishing may make, few, so that the answer remains that of the method
    )
    scale: bool = False  # needs a nondimensional problem
    semidefinite: bool = True  # accepts a singular stiffness (bodies held by contact alone)
    sparse: bool = True  # works on sparse matrices without making them dense
    timed: bool = True  # takes a time limit
    options: tuple[str, ...] = ()  # keyword arguments of its own
    required: tuple[str, ...] = ()  # options without default
    knob: str | None = None  # the parameter that trades error for time: "tolerance", "penalty", "perturbation"
    packages: tuple[str, ...] = ()  # importable modules it needs
    install: str = ""  # the pip command that installs them
    note: str = ""

    @property
    def friction(self) -> str:
        """Return how it solves friction: "stick and slip" by its own systems, "convex steps" of algorithms, or ""."""
        if self.solve_friction is not None:
            return "stick and slip"
        return "convex steps" if self.exact and self.semidefinite else ""

    @property
    def installed(self) -> bool:
        """Return whether every package it needs can be found, without importing any."""
        return all(importlib.util.find_spec(package) is not None for package in self.packages)
