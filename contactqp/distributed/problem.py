"""DistributedProblem: each rank's part of one contact problem."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.ranks import Ranks
from contactqp.distributed.rows import Rows
from contactqp.model.arrays import Vector
from contactqp.model.problem import Units

Numbers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class DistributedProblem:
    """min 1/2 u'Ku - f'u over E_N u <= g, A u = b, with Coulomb friction on E_T u: what one rank has of it.

    Unknowns that supports hold have rows of their own in K, a positive diagonal and nothing else, so that nodes stay
    whole blocks; load and rows are zero there, and so is u.

    Attributes
    ----------
    ranks : Ranks
    stiffness : PETSc.Mat
        K (n, n), in the blocks of its nodes, symmetric: MPIBAIJ, or MPIAIJ where nodes have one unknown.
    load : (n_here,) array [force]
    normal, tie : Rows
        E_N (m_here, n) and A (k_here, n).
    gap, tie_value : (m_here,) and (k_here,) arrays [length]
    held : (n_here,) array of bool
        Unknowns that supports hold.
    body : (n_here,) array of int
        The number of the body, a connected part of K, that an unknown belongs to; the same on all ranks.
    near_null_space : (n_here, q) array
        Motions that cost a body little energy; zero where held.
    rigid : (n_here, r) array, optional
        Motions that nothing resists where they are known, each body's from the first column on; bodies that float in
        a way that neither these nor `near_null_space` have are taken for held.
    dof_number, contact_number, tie_number : arrays of int
        The place of each unknown, contact and tie in the ContactProblem that one process would have made; -1 where
        held.
    tangent : Rows, optional
        E_T ((d-1) m_here, n), contact-major, on the rank of its contact.
    friction : (m_here,) array, optional
    slip_origin : (m_here, d-1) array, optional [length]
    dof_name, contact_name, tie_name : functions
        From a place on this rank to what a message calls it.
    """

    ranks: Ranks
    stiffness: Any
    load: Vector
    normal: Rows
    gap: Vector
    tie: Rows
    tie_value: Vector
    held: NDArray[np.bool_]
    body: Numbers
    near_null_space: NDArray[np.float64]
    dof_number: Numbers
    contact_number: Numbers
    tie_number: Numbers
    tangent: Rows | None = None
    friction: Vector | None = None
    slip_origin: NDArray[np.float64] | None = None
    rigid: NDArray[np.float64] | None = None
    units: Units = field(default_factory=Units)
    dof_name: Callable[[int], str] = "unknown {}".format
    contact_name: Callable[[int], str] = "contact {}".format
    tie_name: Callable[[int], str] = "tie {}".format
    shared: dict[str, Any] = field(default_factory=dict, repr=False)  # made once for K and the rows; `replace` keeps it

    @property
    def contacts(self) -> int:
        """m_here."""
        return len(self.gap)

    @property
    def ties(self) -> int:
        """k_here."""
        return len(self.tie_value)

    @cached_property
    def dimension(self) -> int:
        """How many unknowns the problem has on all ranks, without the held ones; first asked collectively."""
        return int(self.ranks.sum(int(np.sum(~self.held))))

    @property
    def soft_motions(self) -> NDArray[np.float64]:
        """(n_here, q + r) motions among whose combinations, body by body, are those that nothing resists."""
        known = (self.near_null_space,) if self.rigid is None else (self.near_null_space, self.rigid)
        return np.hstack(known)

    @property
    def frictional(self) -> bool:
        """Whether any contact of any rank rubs. Collective."""
        return self.ranks.any(self.friction is not None and np.any(self.friction > 0))

    @cached_property
    def diagonal(self) -> Vector:
        """K_jj (n_here,)."""
        return np.array(self.stiffness.getDiagonal().array)

    @cached_property
    def metric(self) -> Vector:
        """D (n_here,): K_jj, and the largest of them where an unknown has no stiffness. First asked collectively."""
        largest = self.ranks.max(float(np.max(self.diagonal, initial=0.0))) or 1.0
        return np.where(self.diagonal > 0, self.diagonal, largest)

    def product(self, x: Vector) -> Vector:
        """K x. Collective."""
        at, into = self._vectors
        at.array[:] = x
        self.stiffness.mult(at, into)
        return np.array(into.array)

    @cached_property
    def _vectors(self) -> tuple[Any, Any]:
        right, left = self.stiffness.createVecs()
        return right, left

    def whole(self, values: NDArray[Any], numbers: Numbers) -> NDArray[Any]:
        """Values of all ranks in the order of their numbers, on every rank; negative numbers are left out. Collective.

        ``problem.whole(u, problem.dof_number)`` is the displacement as one process would have it.
        """
        kept = numbers >= 0
        every, order = self.ranks.gathered(values[kept]), self.ranks.gathered(numbers[kept])
        return np.asarray(every[np.argsort(order)])
