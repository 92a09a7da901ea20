"""Define the part of a contact problem, its bodies and its solution that one rank has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.distributed.ranks import Product, Ranks
from contactqp.distributed.rows import Rows, StoredBlocks, stored_rows
from contactqp.linalg.multigrid import FLOATING, energy_ratios, of_size_one
from contactqp.model.arrays import Array, Index, Indices, Mask, Vector
from contactqp.model.problem import Units
from contactqp.model.solution import Answer, Certificate, Work


@dataclass
class Computed:
    """Results shared by all problems with the same stiffness and rows; None or empty until they are computed."""

    floating_bodies: Any = None  # FloatingBodies
    iterations: dict[tuple[str, bool], Any] = field(default_factory=dict)  # by solver, and with or without friction

    def clear(self) -> None:
        """Forget all results."""
        self.floating_bodies = None
        self.iterations.clear()


@dataclass(frozen=True, eq=False)
class DistributedProblem:
    """The part that one rank has of min 1/2 u'Ku - f'u over E_N u <= g, A u = b, with Coulomb friction on E_T u.

    Constrained unknowns keep rows in K with only a positive diagonal, so that nodes remain whole blocks; there the
    load, the rows and u are zero.

    Attributes
    ----------
    ranks : the processes
    stiffness : PETSc.Mat
        K (n, n), symmetric, in blocks of nodes: MPIBAIJ, or MPIAIJ if nodes have one unknown.
    load : (n_here,) array, forces f on the unknowns of this rank [force]
    normal, tie : E_N (m_here, n) and A (k_here, n)
    gap, tie_value : (m_here,) and (k_here,) arrays, g and b [length]
    constrained : (n_here,) array of bool, the unknowns constrained by supports
    body : (n_here,) array of int
        The number of the body, a connected part of K, of each unknown; the same numbers on all ranks.
    near_null_space : (n_here, q) array, motions that cost a body little energy; zero at constrained unknowns
    dof_number, contact_number, tie_number : arrays of int
        The index of each unknown, contact and tie in the ContactProblem of one process, -1 for constrained unknowns.
    tangent : E_T ((d-1) m_here, n), contact-major, on the rank of its contact
    friction : (m_here,) array, optional
        Coefficients of friction.
    slip_origin : (m_here, d-1) array, optional
        E_T u at zero slip [length].
    rigid_motions : (n_here, r) array, optional
        The null space of K if known, each body's motions from the first column on. A body whose rigid motions are not
        combinations of these and `near_null_space` counts as supported.
    units : the units of messages and tables
    dof_name, contact_name, tie_name : functions, return the name for messages of an index on this rank
    computed : results that `dataclasses.replace` keeps
    """

    ranks: Ranks
    stiffness: Any
    load: Vector
    normal: Rows
    gap: Vector
    tie: Rows
    tie_value: Vector
    constrained: Mask
    body: Index
    near_null_space: Array
    dof_number: Index
    contact_number: Index
    tie_number: Index
    tangent: Rows | None = None
    friction: Vector | None = None
    slip_origin: Array | None = None
    rigid_motions: Array | None = None
    units: Units = field(default_factory=Units)
    dof_name: Callable[[int], str] = "unknown {}".format
    contact_name: Callable[[int], str] = "contact {}".format
    tie_name: Callable[[int], str] = "tie {}".format
    computed: Computed = field(default_factory=Computed, repr=False)

    @property
    def contacts(self) -> int:
        """Return the number m_here of contacts on this rank."""
        return len(self.gap)

    @property
    def ties(self) -> int:
        """Return the number k_here of ties on this rank."""
        return len(self.tie_value)

    @cached_property
    def dimension(self) -> int:
        """Return the number of unconstrained unknowns on all ranks; the first call is collective."""
        return int(self.ranks.sum(int(np.sum(~self.constrained))))

    @property
    def frictional(self) -> bool:
        """Return whether any contact of any rank has friction. Collective."""
        return self.ranks.any(self.friction is not None and np.any(self.friction > 0))

    @cached_property
    def diagonal(self) -> Vector:
        """Return K_jj (n_here,) [force / length]."""
        return np.array(self.stiffness.getDiagonal().array)

    @cached_property
    def metric(self) -> Vector:
        """Return D (n_here,): K_jj, or the largest one for unknowns without stiffness; the first call is collective."""
        largest = self.ranks.max(float(np.max(self.diagonal, initial=0.0))) or 1.0
        return np.where(self.diagonal > 0, self.diagonal, largest)

    @cached_property
    def product(self) -> Product:
        """Return the function x -> K x. Collective."""
        return Product(self.stiffness)

    def product_sizes(self, x: Vector) -> Vector:
        """Return |K| x (n_here,), computed from a few rows of K at a time. Collective."""
        with stored_rows(self.stiffness) as stored:
            touched = stored.unknowns_of_others
            away = Rows(sp.csr_matrix((0, len(touched))), touched, self.stiffness).at_touched(x)
            out = np.zeros(len(x))
            for begin, end in stored.parts():
                sizes = _size_of(stored.here, begin, end) @ x + _size_of(stored.away, begin, end) @ away
                out[begin * stored.size : end * stored.size] = sizes
        return out

    def gathered(self, values: NDArray[Any], numbers: Index) -> NDArray[Any]:
        """Return the values of all ranks in the order of their numbers, without those of negative numbers.

        ``problem.gathered(u, problem.dof_number)`` is the displacement as in one process. Collective.
        """
        free = numbers >= 0
        every, order = self.ranks.gathered(values[free]), self.ranks.gathered(numbers[free])
        return np.asarray(every[np.argsort(order)])


def _size_of(blocks: StoredBlocks, begin: int, end: int) -> sp.bsr_matrix:
    rows = blocks.rows(begin, end)
    np.abs(rows.data, out=rows.data)
    return rows


class Bodies:
    """The bodies with unknowns on this rank, and those with their home here.

    Each body has one home, where the contributions of all ranks are combined. The constructor, `totals`, `at_homes`,
    `sums` and `from_homes` are collective.

    Attributes
    ----------
    numbers : (q,) array of int, the bodies with unknowns on this rank
    index : (n_here,) array of int, the index in `numbers` of each unknown's body
    count : int, the number of bodies with their home here
    """

    def __init__(self, ranks: Ranks, body: Index) -> None:
        self._ranks = ranks
        self.numbers, self.index = np.unique(body, return_inverse=True)
        self._order = np.argsort(self.index, kind="stable")
        self._first = np.searchsorted(self.index[self._order], np.arange(len(self.numbers) + 1))
        self._home = self.numbers % ranks.size
        here = np.full(len(self.numbers), ranks.rank)
        received, self._from = ranks.exchange(self._home, self.numbers, here)
        at_home, self._place = np.unique(received, return_inverse=True)
        self.count = len(at_home)

    def members(self, place: int) -> Indices:
        """Return the unknowns on this rank of the body at this index of `numbers`."""
        return self._order[self._first[place] : self._first[place + 1]]

    def combined(self, columns: Array, weights: Array) -> Array:
        """Return the columns (n_here, r) times the weights (q, r, p) of each unknown's body, (n_here, p)."""
        out = np.zeros((len(columns), weights.shape[2]))
        for place in np.flatnonzero(np.any(weights, axis=(1, 2))):
            here = self.members(int(place))
            out[here] = columns[here] @ weights[place]
        return out

    def totals(self, values: Array) -> Array:
        """Return the sums (count, r) over the unknowns of all ranks, of values (n_here, r), at the homes."""
        here = [np.bincount(self.index, column, len(self.numbers)) for column in values.T]
        return self.sums(np.column_stack(here))

    def at_homes(self, values: NDArray[Any]) -> tuple[NDArray[Any], Indices]:
        """Return the values (q, ...) of all ranks at the homes, and for each the index of its body below `count`."""
        (received,) = self._ranks.exchange(self._home, values)
        return received, self._place

    def sums(self, values: Array) -> Array:
        """Return the sums (count, ...) over the ranks of values (q, ...), body by body, at the homes."""
        received, place = self.at_homes(values)
        total = np.zeros((self.count, *values.shape[1:]))
        np.add.at(total, place, received)
        return total

    def from_homes(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values (q, ...) for the bodies on this rank from those at their homes, (count, ...) each."""
        (received,) = self._ranks.exchange(self._from, values[self._place])
        found = np.empty_like(received)
        found[np.argsort(self._home, kind="stable")] = received
        return found


@dataclass(frozen=True, eq=False)
class FloatingBodies:
    """The motions z of all bodies with K z = 0 up to rounding, as columns."""

    motions: Array  # (n_here, r) zero columns for bodies with fewer than r, or supported ones
    floats: Mask  # (q,) whether each body on this rank floats


def floating_bodies(problem: DistributedProblem, bodies: Bodies) -> FloatingBodies:
    """Return the combinations of known motions whose energy is at most FLOATING times that with the diagonal of K.

    They are computed once for a stiffness. Collective.
    """
    found: FloatingBodies | None = problem.computed.floating_bodies
    if found is None:
        problem.computed.floating_bodies = found = _find_floating(problem, bodies)
    return found


def _find_floating(problem: DistributedProblem, bodies: Bodies) -> FloatingBodies:
    known = problem.near_null_space
    if problem.rigid_motions is not None:
        known = np.hstack([known, problem.rigid_motions])
    B = of_size_one(known, problem.ranks.max)
    width = B.shape[1]
    # Unknowns without any stiffness float, with an arbitrary metric.
    metric = np.where(problem.diagonal > 0, problem.diagonal, 1.0)
    forces = np.column_stack([problem.product(b) for b in B.T]) if width else B
    sizes = np.zeros((2, len(bodies.numbers), width, width))
    for i, j in np.ndindex(width, width):
        for k, other in enumerate((forces[:, j], metric * B[:, j])):
            sizes[k, :, i, j] = np.bincount(bodies.index, B[:, i] * other, len(bodies.numbers))
    energy, size = (bodies.sums(part) for part in sizes)
    mixed = np.zeros((bodies.count, width, width))
    for place in np.flatnonzero(np.trace(size, axis1=1, axis2=2) > 0):  # a body that is held everywhere has no motion
        ratios, vectors = energy_ratios(energy[place], size[place])
        free = ratios <= FLOATING
        mixed[place, :, : np.count_nonzero(free)] = vectors[:, free]
    combined = bodies.from_homes(mixed)
    most = int(problem.ranks.max(int(np.sum(np.any(combined, axis=(0, 1))))))
    return FloatingBodies(bodies.combined(B, combined[:, :, :most]), np.any(combined, axis=(1, 2)))


def without_rigid_part(problem: DistributedProblem, bodies: Bodies, displacement: Vector) -> Vector:
    """Return the displacement (n_here,) without its rigid part, as in `contactqp.linalg.measures`. Collective."""
    floating = floating_bodies(problem, bodies)
    if not problem.ranks.any(floating.floats):
        return displacement
    Z, K = floating.motions, problem.diagonal
    width = Z.shape[1]
    products = [bodies.totals((K * Z[:, i])[:, None] * np.column_stack([Z, displacement])) for i in range(width)]
    gram = np.stack(products, axis=1)  # (count, r, r + 1)
    coordinates = np.array([np.linalg.lstsq(g[:, :width], g[:, width:], rcond=None)[0] for g in gram])
    moved = bodies.combined(Z, bodies.from_homes(coordinates.reshape(-1, width, 1)))
    return np.asarray(displacement - moved[:, 0])


def largest_over_ranks(ranks: Ranks, *values: Vector) -> list[float]:
    """Return the largest entry of each array over all ranks, NaN if one is, 0 without entries. Collective."""
    here = np.array([[np.max(part, initial=0.0) for part in values]])
    return [float(value) for value in np.max(ranks.gathered(here), axis=0)]


def message_of_largest(ranks: Ranks, values: Vector, numbers: Index, message: Callable[[int], str]) -> str:
    """Find the largest value over all ranks, or NaN, and return the message of its rank. Collective.

    Parameters
    ----------
    ranks : the processes
    values : (a,) array, values of this rank; at least one rank has some
    numbers : (a,) array of int, their numbers in one process: of equal values the one with the lowest number counts
    message : function, returns the message for a place on this rank
    """
    size = np.where(np.isnan(values), np.inf, values)
    order = np.lexsort((numbers, -size, ~np.isnan(values)))
    best = [(bool(np.isnan(values[i])), float(size[i]), -int(numbers[i])) for i in order[:1]]
    return str(_message_of_best(ranks, best, lambda: message(int(order[0]))))


def message_of_first(ranks: Ranks, flags: Mask, numbers: Index, message: Callable[[int], str]) -> str | None:
    """Find the set flag with the lowest number, and return the message of its rank. Collective.

    Parameters
    ----------
    ranks : the processes
    flags : (a,) array of bool, flags of this rank
    numbers : (a,) array of int, their numbers in one process
    message : function, returns the message for a place on this rank

    Returns
    -------
    str or None
        None where no flag is set.
    """
    places = np.flatnonzero(flags)
    first = places[np.argsort(numbers[places], kind="stable")][:1]
    return _message_of_best(ranks, [-int(numbers[i]) for i in first], lambda: message(int(first[0])))


def _message_of_best(ranks: Ranks, best: list[Any], message: Callable[[], str]) -> str | None:
    """Return the message of the rank with the largest entry; each rank has at most one."""
    every = [(entry, -rank) for rank, entries in enumerate(ranks.comm.allgather(best)) for entry in entries]
    if not every:
        return None
    chosen = -max(every)[1]
    found: str = ranks.comm.bcast(message() if ranks.rank == chosen else None, root=chosen)
    return found


@dataclass(frozen=True, eq=False)
class DistributedSolution:
    """Displacement and forces of one problem; `answer` is the part of this rank.

    The fields of `contactqp.Solution` are gathered on every rank at their first use, which is collective.
    """

    problem: DistributedProblem = field(repr=False)
    answer: Answer = field(repr=False)
    status: NDArray[np.str_] = field(repr=False)  # (m_here,) of open, closed, grazing, stick, slip
    certificate: Certificate  # the same on all ranks except arrays over contacts
    method: str
    seconds: float  # until the certified answer, of the slowest rank
    certify_seconds: float  # the part of the certificate
    work: Work
    motions: Array = field(repr=False)  # (n_here, q) not driven by the load and not resisted by contacts or ties

    @cached_property
    def displacement(self) -> Vector:
        """Return u (n,) in the numbers of one process."""
        return self.problem.gathered(self.answer.displacement, self.problem.dof_number)

    @cached_property
    def normal_force(self) -> Vector:
        """Return the normal forces (m,), positive in compression."""
        return self._of_contacts(self.answer.normal_force)

    @cached_property
    def friction_force(self) -> Array | None:
        """Return the friction forces (m, d-1), None without tangential rows."""
        return None if self.answer.friction_force is None else self._of_contacts(self.answer.friction_force)

    @cached_property
    def tie_force(self) -> Vector:
        """Return the forces (k,) on the ties."""
        return self.problem.gathered(self.answer.tie_force, self.problem.tie_number)

    @cached_property
    def gap(self) -> Vector:
        """Return g - E_N u (m,), positive when open [length]."""
        return self._of_contacts(self.problem.gap - self.problem.normal.lengths(self.answer.displacement))

    @cached_property
    def contact_status(self) -> NDArray[np.str_]:
        """Return the status (m,) of each contact: open, closed, grazing, stick or slip."""
        return self._of_contacts(self.status)

    @cached_property
    def free_motions(self) -> tuple[Vector, ...]:
        """Return the rigid motions (n,) with no drive and no resistance, with largest component one."""
        every = [self.problem.gathered(motion, self.problem.dof_number) for motion in self.motions.T]
        return tuple(motion / motion[np.argmax(abs(motion))] for motion in every)

    @cached_property
    def energy(self) -> float:
        """Return 1/2 u'Ku - f'u [force * length]."""
        u = self.answer.displacement
        return self.problem.ranks.dot(u, self.problem.product(u) / 2 - self.problem.load)

    def _of_contacts(self, values: NDArray[Any]) -> NDArray[Any]:
        return self.problem.gathered(values, self.problem.contact_number)
