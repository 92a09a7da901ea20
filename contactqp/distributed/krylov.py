"""PETSc's GMRES on an operator that is a function."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from contactqp.distributed.environment import petsc
from contactqp.model.arrays import Vector

# Vectors kept until GMRES starts anew.
RESTART = 60


def gmres(
    operator: Callable[[Vector], Vector], right: Vector, like: Any, reduction: float, most: int
) -> tuple[Vector, int]:
    """x with |right - A x| <= reduction |right|, or what `most` steps come to, and the steps taken. Collective.

    Parameters
    ----------
    operator : function
        A x of the part of a vector that this rank has. Collective.
    right : (n_here,) array
    like : PETSc.Mat
        K: it says which rank has which unknowns.
    """
    PETSc = petsc()
    matrix = PETSc.Mat().createPython(like.getSizes(), _Operator(operator), comm=like.comm)
    matrix.setUp()
    solver = PETSc.KSP().create(like.comm)
    solver.setOperators(matrix)
    solver.setType("gmres")
    solver.setGMRESRestart(min(RESTART, most))
    solver.getPC().setType("none")
    solver.setTolerances(rtol=reduction, atol=0.0, divtol=np.inf, max_it=most)
    into, given = like.createVecs()
    given.array[:] = right
    solver.solve(given, into)
    steps, found = int(solver.getIterationNumber()), np.array(into.array)
    for item in (solver, matrix, into, given):
        item.destroy()
    return found, steps


class _Operator:
    """A matrix as PETSc asks it."""

    def __init__(self, operator: Callable[[Vector], Vector]) -> None:
        self._operator = operator

    def mult(self, matrix: Any, x: Any, y: Any) -> None:
        """y = A x."""
        del matrix
        y.array[:] = self._operator(np.array(x.array_r))
