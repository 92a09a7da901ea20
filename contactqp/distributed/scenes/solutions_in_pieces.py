"""Solutions of bodies of which each rank has a piece, as tables and claims ask for them. All of it is collective."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.analysis.history import Energies, History
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.scenes.distributed_bodies import DistributedBodyModel
from contactqp.distributed.solution import DistributedSolution
from contactqp.model.problem import Units


@dataclass(frozen=True, eq=False)
class ProblemInPieces:
    """What is said of the problem of a solution; names are those of one process, on every rank."""

    part: DistributedProblem = field(repr=False)
    contact_names: tuple[str, ...] = field(repr=False)
    frictional: bool

    def contact_name(self, i: int) -> str:
        """Of a contact by its number in one process."""
        return self.contact_names[i]

    def dof_name(self, j: int) -> str:
        """Of an unknown by its number in one process."""
        return self.dof_names[j]

    @property
    def units(self) -> Units:
        """Of the scene."""
        return self.part.units

    @property
    def contacts(self) -> int:
        """m, on all ranks."""
        return len(self.contact_names)

    @property
    def tangent(self) -> None:
        """Pictures of paths ask for it, and these are without friction."""
        return None

    @cached_property
    def normal(self) -> Any:
        """E_N (m, n) in the numbers of one process, gathered on every rank."""
        part, rows = self.part, self.part.normal.entries.tocoo()
        column = part.normal.near(part.dof_number.astype(float)).astype(np.int64)[rows.col]
        free, gathered = column >= 0, part.ranks.gathered
        places = gathered(part.contact_number[rows.row][free]), gathered(column[free])
        return sp.csr_matrix((gathered(rows.data[free]), places), shape=(self.contacts, part.dimension))

    @cached_property
    def load(self) -> NDArray[np.float64]:
        """(n,) gathered on every rank [force]."""
        return self.part.whole(self.part.load, self.part.dof_number)

    @cached_property
    def dof_names(self) -> tuple[str, ...]:
        """(n,) gathered on every rank: for those who ask for every number."""
        here = np.array([self.part.dof_name(i) for i in range(len(self.part.dof_number))], dtype=np.str_)
        return tuple(map(str, self.part.whole(here, self.part.dof_number)))


@dataclass(frozen=True, eq=False)
class SolutionInPieces:
    """As `contactqp.Solution`; displacements are gathered when they are asked for, contacts are few."""

    found: DistributedSolution
    problem: ProblemInPieces

    def __getattr__(self, name: str) -> Any:
        """All else is the distributed solution's."""
        return getattr(self.found, name)


def in_pieces(model: DistributedBodyModel, solutions: Sequence[DistributedSolution]) -> list[SolutionInPieces]:
    """The solutions with the names of the scene."""
    names, frictional = np.array(model.row_names, dtype=np.str_)[model.kept], model.problem.frictional
    told = tuple(map(str, names))
    return [SolutionInPieces(one, ProblemInPieces(one.problem, told, frictional)) for one in solutions]


def energies(solutions: Sequence[DistributedSolution]) -> Iterator[Energies]:
    """Of a path without friction: what the loads have done and what is elastic, as `History.energies` has it."""
    work = 0.0
    for before, now in pairwise(chain(solutions[:1], solutions)):
        u, dot = now.answer.displacement, now.problem.ranks.dot
        work += dot(before.problem.load + now.problem.load, u - before.answer.displacement) / 2
        yield Energies(dot(u, now.problem.product(u)) / 2, kinetic=0.0, work=work, dissipated=0.0)


def gather(history: History) -> None:
    """Have every rank hold what pictures and files take of a history, so that one of them can write them."""
    for solution in history:
        for name in ("displacement", "normal_force", "friction_force", "tie_force", "gap", "contact_status", "energy"):
            getattr(solution, name)
        for name in ("load", "dof_names", "normal"):
            getattr(solution.problem, name)
    for name in ("events", "energies"):
        getattr(history, name)
