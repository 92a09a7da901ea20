"""What a family of seeded problems is, and the register of them all; `problem_families` fills it."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from benchmarks.bricks import Generator
from contactqp import ContactProblem


@dataclass(frozen=True)
class Family:
    """One named family; `well_posed`: a unique answer that rounding of the data does not decide."""

    name: str
    make: Callable[[Generator], ContactProblem] = field(repr=False)
    well_posed: bool
    solvable: bool = True

    @property
    def about(self) -> str:
        """The first line of the maker's docstring."""
        return (self.make.__doc__ or "").strip().split("\n")[0]


FAMILIES: dict[str, Family] = {}


def family(name: str, seed: int) -> ContactProblem:
    """The problem of a family with that seed."""
    rng = np.random.default_rng([zlib.crc32(name.encode()), seed])
    return FAMILIES[name].make(rng)


def member(well_posed: bool, solvable: bool = True) -> Callable[[Callable[[Generator], ContactProblem]], Callable]:
    def register(make: Callable[[Generator], ContactProblem]) -> Callable[[Generator], ContactProblem]:
        name = make.__name__
        FAMILIES[name] = Family(name, make, well_posed, solvable)
        return make

    return register
