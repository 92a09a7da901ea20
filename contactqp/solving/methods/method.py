"""What every method is: a name, what it promises, and a function from a ContactProblem to a Candidate."""

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
    """The settings of a call; a method reads those that concern it."""

    tolerance: float = 1e-9  # relative, on the nondimensional problem
    max_iter: int | None = None
    time_limit: float | None = None  # seconds
    warm_start: Candidate | None = None
    options: Mapping[str, Any] = field(default_factory=dict)  # those that `Method.options` names

    @property
    def now(self) -> Settings:
        """Return the same settings with what is left of the time of the call."""
        left = seconds_left()
        return self if self.time_limit is None or left is None else replace(self, time_limit=min(self.time_limit, left))


@dataclass(frozen=True)
class Method:
    """One entry of the registry: capabilities are declared here and read by `solve`, never tested for by name."""

    name: str
    kind: str  # "active set", "quadratic program", "modelling language", "complementarity", "classical enforcement"
    solve: Callable[[ContactProblem, Settings], Candidate] = field(repr=False)
    # The same from a condensation alone, in the unknowns that it retains; without it the method is shown the condensed
    # problem.
    solve_condensed: Callable[[ContactProblem, Condensation, Settings], Candidate] | None = field(
        default=None, repr=False
    )
    # A frictional problem of the plane by its own systems of stick and slip; without it, what the method can do with
    # friction is to take the convex steps of an algorithm.
    solve_friction: Callable[[ContactProblem, Settings], Candidate] | None = field(default=None, repr=False)
    # With friction it is Coulomb's law of bodies with contact springs: its options for the springs' stiffnesses, normal
    # and tangential.
    springs: tuple[str, str] | None = None
    exact: bool = True  # promises the exact answer; otherwise approximate by design
    polish: bool = False  # its answer is polished on the contact set that it finds
    corrections: int = (
        2  # of the contact set that polishing may make: two do not turn a backend into an active-set method
    )
    scale: bool = False  # wants a nondimensional problem
    semidefinite: bool = True  # accepts a singular stiffness (bodies held by contact alone)
    sparse: bool = True  # works on sparse matrices without making them dense
    timed: bool = True  # takes a time limit
    options: tuple[str, ...] = ()  # keyword arguments of its own
    required: tuple[str, ...] = ()  # those that have no default
    knob: str | None = None  # what trades error for time: "tolerance", "penalty", "perturbation"
    packages: tuple[str, ...] = ()  # importable modules it needs
    install: str = ""  # the pip command that brings them
    note: str = ""

    @property
    def friction(self) -> str:
        """Return how it solves friction: "stick and slip" by its own systems, "convex steps" of algorithms, or none."""
        if self.solve_friction is not None:
            return "stick and slip"
        return "convex steps" if self.exact and self.semidefinite else ""

    @property
    def installed(self) -> bool:
        """Return whether every package it needs can be found (nothing is imported to find out)."""
        return all(importlib.util.find_spec(package) is not None for package in self.packages)
