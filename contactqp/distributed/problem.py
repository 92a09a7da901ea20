"""One rank's part of a contact problem, of its answers and of its bodies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.ranks import Ranks
from contactqp.distributed.rows import Rows, StoredBlocks, stored_rows
from contactqp.model.arrays import Vector
from contactqp.model.problem import Units
from contactqp.model.solution import Certificate, Work

# One rank's part of an answer that nobody has judged.


@dataclass(frozen=True, eq=False)
class DistributedAnswer:
    """The fields of `contactqp.model.solution.Answer`, of the unknowns, contacts and ties of one rank."""

    displacement: Vector  # (n_here,) [length], zero where supports hold
    normal_force: Vector  # (m_here,) [force], positive in compression
    friction_force: NDArray[np.float64] | None  # (m_here, d-1) [force]
    tie_force: Vector  # (k_here,) [force]


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


# Bodies over the ranks: what their parts on several ranks come to is found on one of them, the body's home.


class Bodies:
    """Which bodies have unknowns here, and which are at home here. Making it is collective, and so are its methods.

    Attributes
    ----------
    number : (q,) array of int
        The bodies with unknowns on this rank.
    of : (n_here,) array of int
        The place in `number` of each unknown's body.
    count : int
        How many bodies are at home on this rank.
    """

    def __init__(self, ranks: Ranks, body: Numbers) -> None:
        self._ranks = ranks
        self.number, self.of = np.unique(body, return_inverse=True)
        self._order = np.argsort(self.of, kind="stable")
        self._first = np.searchsorted(self.of[self._order], np.arange(len(self.number) + 1))
        self._home = self.number % ranks.size
        here = np.full(len(self.number), ranks.rank)
        came, self._from = ranks.exchanged(self._home, self.number, here)
        at_home, self._place = np.unique(came, return_inverse=True)
        self.count = len(at_home)

    def members(self, place: int) -> NDArray[np.intp]:
        """The unknowns here of the body at this place in `number`."""
        return self._order[self._first[place] : self._first[place + 1]]

    def combined(self, columns: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Columns (n_here, r) times the weights (q, r, p) of each body, (n_here, p)."""
        out = np.zeros((len(columns), weights.shape[2]))
        for place in np.flatnonzero(np.any(weights, axis=(1, 2))):
            here = self.members(int(place))
            out[here] = columns[here] @ weights[place]
        return out

    def totals(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(count, r) the sums over all unknowns (n_here, r) of each body at home here."""
        here = [np.bincount(self.of, column, len(self.number)) for column in values.T]
        return self.sums(np.column_stack(here))

    def parts(self, values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.intp]]:
        """The rows of values (q, ...) of the bodies at home here, and the place (0 to `count`) of each one's body."""
        (came,) = self._ranks.exchanged(self._home, values)
        return came, self._place

    def sums(self, values: NDArray[Any]) -> NDArray[Any]:
        """(count, ...) the sums of values (q, ...), body by body, at home."""
        return self._reduced(np.add, values)

    def largest(self, values: NDArray[Any]) -> NDArray[Any]:
        """(count, ...) the largest of values (q, ...) that are not negative, body by body, at home."""
        return self._reduced(np.maximum, values)

    def told(self, values: NDArray[Any]) -> NDArray[Any]:
        """(q, ...) the values (count, ...) that the homes have for the bodies on this rank."""
        (came,) = self._ranks.exchanged(self._from, values[self._place])
        found = np.empty_like(came)
        found[np.argsort(self._home, kind="stable")] = came
        return found

    def _reduced(self, operation: Any, values: NDArray[Any]) -> NDArray[Any]:
        came, place = self.parts(values)
        total = np.zeros((self.count, *values.shape[1:]))
        operation.at(total, place, came)
        return total


# Where on the ranks the worst of something is, and what its rank says of it.


def worst(ranks: Ranks, *values: Vector) -> list[float]:
    """The largest of each array on any rank, NaN where one is; 0 of nothing. Collective."""
    here = np.array([[np.max(part, initial=0.0) for part in values]])
    return [float(value) for value in np.max(ranks.gathered(here), axis=0)]


def said_of_worst(ranks: Ranks, values: Vector, numbers: Numbers, say: Callable[[int], str]) -> str:
    """What the rank of the largest value, or of NaN, says of its place there. Collective.

    Parameters
    ----------
    values : (a,) array, at least one on some rank
    numbers : (a,) array of int
        How one process would number them: of equals the first counts.
    say : function
        From a place on this rank to a sentence.
    """
    size = np.where(np.isnan(values), np.inf, values)
    order = np.lexsort((numbers, -size, ~np.isnan(values)))
    best = [(bool(np.isnan(values[i])), float(size[i]), -int(numbers[i])) for i in order[:1]]
    return str(_said(ranks, best, lambda: say(int(order[0]))))


def said_of_first(ranks: Ranks, flags: NDArray[np.bool_], numbers: Numbers, say: Callable[[int], str]) -> str | None:
    """What the rank with the first flag that is set says of its place; None where none is set. Collective."""
    places = np.flatnonzero(flags)
    first = places[np.argsort(numbers[places], kind="stable")][:1]
    return _said(ranks, [-int(numbers[i]) for i in first], lambda: say(int(first[0])))


def _said(ranks: Ranks, best: list[Any], say: Callable[[], str]) -> str | None:
    """What the rank of the largest entry says."""
    every = [(entry, -rank) for rank, entries in enumerate(ranks.comm.allgather(best)) for entry in entries]
    if not every:
        return None
    chosen = -max(every)[1]
    said: str = ranks.comm.bcast(say() if ranks.rank == chosen else None, root=chosen)
    return said


# |K| x of a matrix that PETSc holds.


def stiffness_sizes(problem: DistributedProblem, x: Vector) -> Vector:
    """|K| x (n_here,). Collective; nothing is kept."""
    with stored_rows(problem.stiffness) as stored:
        touched = stored.unknowns_of_others
        away = Rows(sp.csr_matrix((0, len(touched))), touched, problem.stiffness).near(x)
        out = np.zeros(len(x))
        for begin, end in stored.parts():
            sizes = _sizes(stored.here, begin, end, x) + _sizes(stored.away, begin, end, away)
            out[begin * stored.size : end * stored.size] = sizes
    return out


def _sizes(blocks: StoredBlocks, begin: int, end: int, x: Vector) -> Vector:
    rows = blocks.rows(begin, end)
    np.abs(rows.data, out=rows.data)
    return np.asarray(rows @ x)


# DistributedSolution: what the ranks have of an answer, with the certificate that judged it.


@dataclass(frozen=True, eq=False)
class DistributedSolution:
    """Displacement and forces of one problem; `answer` is the part of the rank.

    What `contactqp.Solution` has whole is gathered on every rank, collectively and once, when it is asked for.
    """

    problem: DistributedProblem = field(repr=False)
    answer: DistributedAnswer = field(repr=False)
    status: NDArray[np.str_] = field(repr=False)  # (m_here,) of open, closed, grazing, stick, slip
    certificate: Certificate  # the same on all ranks but for what is contact by contact
    method: str
    seconds: float  # to the certified answer, of the slowest rank
    certify_seconds: float  # of these, for the certificate
    work: Work
    motions: NDArray[np.float64] = field(repr=False)  # (n_here, q) that no load drives and no contact or tie resists

    @cached_property
    def displacement(self) -> Vector:
        """(n,) in the numbers of one process."""
        return self.problem.whole(self.answer.displacement, self.problem.dof_number)

    @cached_property
    def normal_force(self) -> Vector:
        """(m,)."""
        return self.problem.whole(self.answer.normal_force, self.problem.contact_number)

    @cached_property
    def friction_force(self) -> NDArray[np.float64] | None:
        """(m, d-1), None without tangential rows."""
        force = self.answer.friction_force
        return None if force is None else self.problem.whole(force, self.problem.contact_number)

    @cached_property
    def tie_force(self) -> Vector:
        """(k,)."""
        return self.problem.whole(self.answer.tie_force, self.problem.tie_number)

    @cached_property
    def gap(self) -> Vector:
        """(m,) g - E_N u, positive when open [length]."""
        gap = self.problem.gap - self.problem.normal.lengths(self.answer.displacement)
        return self.problem.whole(gap, self.problem.contact_number)

    @cached_property
    def contact_status(self) -> NDArray[np.str_]:
        """(m,)."""
        return self.problem.whole(self.status, self.problem.contact_number)

    @cached_property
    def free_motions(self) -> tuple[Vector, ...]:
        """(n,) each, its largest component one."""
        every = [self.problem.whole(motion, self.problem.dof_number) for motion in self.motions.T]
        return tuple(motion / motion[np.argmax(abs(motion))] for motion in every)

    @cached_property
    def energy(self) -> float:
        """1/2 u'Ku - f'u."""
        u = self.answer.displacement
        return self.problem.ranks.dot(u, self.problem.product(u) / 2 - self.problem.load)
