"""Decide by which systems a problem is solved (`systems_of`), and solve large bodies iteratively in one process.

Problems are condensed, solved by sparse systems, or iterated on with a multigrid hierarchy. It is also decided here
what may be factorised nevertheless, and which problems begin with a subset of their contacts.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from enum import Enum

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed, BackendMissing, Unsupported, free_memory
from contactqp.linalg import pardiso, schur
from contactqp.linalg.contact_iteration import ContactIteration, FloatingMotions
from contactqp.linalg.convexity import moves_beyond_bodies
from contactqp.linalg.dense import RigidMotions
from contactqp.linalg.equilibration import mostly_bare
from contactqp.linalg.factorization import stated_motions, widest_level
from contactqp.linalg.krylov import AssembledRows, ConjugateGradients, ConstrainedRows, OneProcess
from contactqp.linalg.measures import sizes_of
from contactqp.linalg.multigrid import COARSEST_TOUCHED, Hierarchy, available
from contactqp.linalg.pardiso import SOLVER_VARIABLE
from contactqp.linalg.runtime import LITTLE_MEMORY
from contactqp.linalg.v_cycle import HeldHierarchy
from contactqp.model.arrays import Array, Indices, Mask, Vector, refuse_late
from contactqp.model.problem import ContactProblem

# A body in space (with more than COUPLED entries per row, unlike one in the plane) is solved iteratively if its factors
# are predicted to take ten times the time of the iteration, as for a cube of 200 000 unknowns; the factors would prove
# the answer. With friction nothing is proven in space, and with more than MANY_WITH_FRICTION contacts, each with three
# condensed unknowns, this holds for a cube of 10 000 unknowns already.
MOST_OPERATIONS, COUPLED = 7e12, 40
MOST_WITH_FRICTION, MANY_WITH_FRICTION = 1.75e10, 300
# Entries of the factors of a cube of n unknowns over n^(4/3), measured at 74 000 and 180 000 unknowns with PARDISO.
ENTRIES_IN_SPACE = 43
# The unknowns of a node in space.
AXES = 3
# With more contact unknowns than this, dense systems cost more than one or two sparse factorisations.
MANY = 3000
# Up to this size a large floating body is factorised by SuperLU; beyond it the factors exceed typical memory.
LARGEST_BY_SUPERLU = 500_000
# Times relative to r^3 of condensing, measured on strips, plates and blocks: of each unknown, where a backend finds the
# closed contacts, or of each entry, where a hierarchy does; of each operation of a sparse factorisation, in a backend,
# by SuperLU and by PARDISO; operations per squared unknown in space. Problems up to SMALLEST are not examined; with
# more than OF_PLANES entries per row a body has the fill-in of one in space.
PER_UNKNOWN, PER_ENTRY, IN_BACKENDS, BY_SUPERLU, BY_PARDISO, IN_SPACE = 1e4, 3.6e3, 2.4, 0.5, 0.05, 175
SMALLEST, OF_PLANES = 3e7, 25
# Where rows outnumber unknowns contacts close one by one, as many as there are unknowns: condensed systems of r of
# these then take r / OF_A_VERTEX times as long, measured with dense K of 700 unknowns between bounds.
OF_A_VERTEX = 100
# With friction both kinds of systems are solved for combinations of states, and each costs more if condensed.
FRICTION_CONDENSED = 3.0


class Systems(Enum):
    """The systems by which a problem is solved and certified."""

    ITERATED = "products with K and a hierarchy, nothing being factorised"
    SPARSE = "sparse saddle points of all unknowns"
    SUBSET = "the bodies condensed onto the contacts that may close"
    CONDENSED = "the bodies condensed onto all contacts and ties"


def systems_of(problem: ContactProblem) -> Systems:
    """Return the systems with the least predicted cost, which both `solve` and the certificate use."""
    if iterated(problem):
        return Systems.ITERATED
    if constraints_are_many(problem):
        return Systems.SPARSE
    return Systems.SUBSET if contacts_are_many(problem) else Systems.CONDENSED


def iterated(problem: ContactProblem) -> bool:
    """Return whether a problem is solved and certified without a factorisation.

    In space this is so if pyamg is installed and factors are predicted to be far too expensive or to exceed the free
    memory; with more than 300 frictional contacts, none of them on springs, if they cost more than the iteration.
    Bodies that float along unstated motions, and methods that need factors (`factorised`), are left to PARDISO, which
    refuses what does not fit into memory; SuperLU, which cannot predict it, is used for floating bodies up to a size.
    CONTACTQP_SPARSE_SOLVER=pyamg forces the iteration, another solver prevents it.
    """
    chosen = os.environ.get(SOLVER_VARIABLE, "")
    if chosen:
        return chosen == "pyamg"
    if not (_is_large(problem) and available()):
        return False
    if pardiso.available() or not factors_are_dear(problem):
        return not problem._computed.of_stiffness.factorised and iterable(problem)
    return problem.dimension > LARGEST_BY_SUPERLU or iterable(problem)


def _is_large(problem: ContactProblem) -> bool:
    if not sp.issparse(problem.stiffness) or problem.stiffness.nnz <= COUPLED * problem.dimension:
        return False
    in_space = problem.slip_origin is not None and problem.slip_origin.shape[1] > 1
    many = problem.frictional and in_space and problem.contacts > MANY_WITH_FRICTION
    if many and not _rests_on_springs(problem) and _of_cube(problem)[0] > MOST_WITH_FRICTION:
        return True
    return factors_are_dear(problem)


def _of_cube(problem: ContactProblem) -> tuple[float, float]:
    """Return the operations and bytes of factors of K, if it is that of a cube."""
    n = problem.dimension
    return grid_operations(n, problem.stiffness_rows.nnz / n), 8.0 * ENTRIES_IN_SPACE * n ** (4 / 3)


def factors_are_dear(problem: ContactProblem) -> bool:
    """Return whether factors of K are predicted to take more than `MOST_OPERATIONS`, or more than the free memory.

    Slender bodies need less than a cube: eliminated from one end to the other, n b^2 operations and n b entries with b
    unknowns per level of the breadth-first search.
    """
    operations, needed = _of_cube(problem)
    free = free_memory() if needed > LITTLE_MEMORY else None
    if operations <= MOST_OPERATIONS and (free is None or needed <= free):
        return False
    operations, needed = _of_levels(problem)
    return operations > MOST_OPERATIONS or (free is not None and needed > free)


def factors_take(problem: ContactProblem, operations: float) -> bool:
    """Return whether factors of K are predicted to take more than so many operations."""
    return _of_cube(problem)[0] > operations and _of_levels(problem)[0] > operations


def _of_levels(problem: ContactProblem) -> tuple[float, float]:
    """Return the operations and bytes of factors of K by levels of the breadth-first search, or as those of a cube."""
    n, of_stiffness = float(problem.dimension), problem._computed.of_stiffness
    if of_stiffness.widest_level is None:
        nodes = problem.stiffness_rows[::AXES][:, ::AXES]  # one unknown per node, with a ninth of the entries
        of_stiffness.widest_level = AXES * (widest_level(nodes) or problem.dimension)
    operations, needed = _of_cube(problem)
    return min(operations, n * of_stiffness.widest_level**2), min(needed, 8.0 * n * of_stiffness.widest_level)


def _rests_on_springs(problem: ContactProblem) -> bool:
    """Return whether some unknowns are uncoupled in K, as springs behind contacts, which have no coarser level.

    With friction on them the iteration takes five times as long as factors, or does not converge.
    """
    return bool(np.any(np.diff(problem.stiffness.indptr) == 1))


def contacts_are_many(problem: ContactProblem) -> bool:
    """Return whether there are so many contacts that a subset costs less; never with friction in the plane."""
    cached = problem._computed.all_contacts
    if problem.frictional not in cached:
        cached[problem.frictional] = not _are_many(problem)
    return not cached[problem.frictional]


def _are_many(problem: ContactProblem) -> bool:
    if problem.frictional:
        in_space = problem.slip_origin is not None and problem.slip_origin.shape[1] > 1
        return in_space and problem.contacts > MANY_WITH_FRICTION
    return problem.normal.nnz > MANY and problem.contacts > 1 and len(np.unique(problem.normal.indices)) > MANY


def constraints_are_many(problem: ContactProblem) -> bool:
    """Return whether sparse saddle points, including the identification of contacts, should cost less than condensing.

    Condensed, the r unknowns that contacts and ties touch take time like r^3, and like r^4 where these rows outnumber
    the unknowns. Sparse, p unknowns and rows take time like p, for residuals and steps, and like the operations of a
    sparse factorisation: p b^2 for a band of b, 10 p^1.5 (d/5)^2 for a plane grid with d entries in a row where that is
    less; in space more. With a hierarchy few factorisations are needed, while the interior point of a backend needs one
    per step. If K has more motions without energy than bodies have rigid ones, condensing would treat each as a rigid
    motion.
    """
    cached = problem._computed.constraints_are_many
    if problem.frictional not in cached:
        cached[problem.frictional] = _constraints_are_many(problem)
    return cached[problem.frictional]


def condense_anyway(problem: ContactProblem) -> None:
    """Condense a problem regardless of predictions, as sparse systems have not led to an answer."""
    problem._computed.constraints_are_many[problem.frictional] = False


# The number of contacts and ties that can be condensed in a second or two after sparse systems have failed.
MOST_CONDENSED = 2500


def may_be_condensed(problem: ContactProblem) -> bool:
    """Return whether all unknowns have stiffness, and contacts and ties are few enough to be condensed.

    Sparse systems are less accurate for slender bodies.
    """
    return problem.contacts + problem.ties <= MOST_CONDENSED and bool(problem.diagonal.all())


def _constraints_are_many(problem: ContactProblem) -> bool:
    if not (problem.contacts or problem.ties):
        return False
    if problem.frictional and not _in_the_plane(problem):
        return False
    if mostly_bare(problem) if not problem.diagonal.all() else moves_beyond_bodies(problem):
        return True
    rows = [problem.normal, problem.tie]
    if problem.frictional and problem.tangent is not None:
        rows.append(problem.tangent)
    times = FRICTION_CONDENSED if problem.frictional else 1.0
    if times * float(sum(some.nnz for some in rows)) ** 3 <= SMALLEST:
        return False  # rows have at most one entry per unknown
    dense = times * float(np.count_nonzero(np.bincount(np.concatenate([some.indices for some in rows])))) ** 3
    if not problem.frictional and problem.contacts + problem.ties > problem.dimension:
        dense *= max(1.0, dense ** (1 / 3) / OF_A_VERTEX)
    lengths = np.concatenate([some.indptr[1:] - some.indptr[:-1] for some in rows])
    long = int(np.sum(lengths > 1))
    size = float(problem.dimension + long)
    if dense <= max(SMALLEST, PER_UNKNOWN * size):
        return False
    per_row = (problem.stiffness_rows.nnz + 2 * int(np.sum(lengths[lengths > 1]))) / size
    grid = grid_operations(size, per_row)
    by_solver = BY_PARDISO if pardiso.available() else BY_SUPERLU

    def predicted(operations: float) -> tuple[float, float]:
        few = problem.frictional and (problem.ties or problem.contacts <= MANY_WITH_FRICTION)  # unique where condensed
        with_backends = np.inf if few else PER_UNKNOWN * size + IN_BACKENDS * operations
        return with_backends, PER_ENTRY * per_row * size + by_solver * operations

    if dense > max(predicted(grid)):
        return True  # a narrower band would be cheaper still
    narrowest = np.max(np.diff(problem.stiffness_rows.indptr)) // 2  # half of a row is on one side in any order
    if dense <= min(predicted(min(grid, size * float(narrowest) ** 2))):
        return False
    with_backends, with_hierarchy = predicted(min(grid, size * float(_band(problem)) ** 2))
    if (dense > with_backends) == (dense > with_hierarchy):
        return bool(dense > with_backends)
    return bool(dense > (with_hierarchy if size > schur.LARGE and held_by_hierarchy(problem) else with_backends))


def grid_operations(size: float, per_row: float) -> float:
    """Return the operations that factorising a plane grid of `size` unknowns takes, with `per_row` entries a row."""
    plane, space = float(10 * size**1.5 * (per_row / 5) ** 2), IN_SPACE * size**2
    return plane if per_row <= OF_PLANES else max(plane, space)


def _in_the_plane(problem: ContactProblem) -> bool:
    return problem.slip_origin is not None and problem.slip_origin.shape[1] == 1


def _band(problem: ContactProblem) -> int:
    """Return the half bandwidth of K and all rows of more than one entry, in the reverse Cuthill-McKee order."""
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    rows = sp.vstack([problem.normal, problem.tie], format="csr")
    rows = rows[np.flatnonzero(np.diff(rows.indptr) > 1)]
    K = sp.csr_matrix(problem.stiffness_rows)
    graph = sp.csr_matrix(sp.bmat([[K, rows.T], [rows, None]]) if rows.shape[0] else K)
    place = np.argsort(reverse_cuthill_mckee(graph, symmetric_mode=True))
    entries = graph.tocoo()
    return int(np.max(abs(place[entries.row] - place[entries.col]), initial=0))


def may_be_factorised(problem: ContactProblem) -> bool:
    """Return whether an iterated body may be factorised, by a solver that checks memory and unless the user chose
    another.
    """
    return (pardiso.available() or not factors_are_dear(problem)) and not os.environ.get(SOLVER_VARIABLE, "")


@contextmanager
def factorised(problem: ContactProblem) -> Iterator[None]:
    """Allow a stiffness of any size to be factorised inside the block, for methods that work with factors.

    Afterwards the factors are kept and used for the same stiffness.
    """
    of_stiffness = problem._computed.of_stiffness
    of_stiffness.factorised = True
    try:
        yield
    except (Unsupported, BackendFailed):
        of_stiffness.factorised = False
        raise


def held_by_hierarchy(problem: ContactProblem) -> bool:
    """Return whether no body floats according to a multigrid hierarchy; False without pyamg."""
    return iterable(problem) and bool(problem._computed.of_stiffness.supported)


def iterable(problem: ContactProblem) -> bool:
    """Return whether the rigid motions of all floating bodies are known to a multigrid hierarchy; False without
    pyamg.
    """
    with problem._lock:
        of_stiffness = problem._computed.of_stiffness
        if of_stiffness.iterable is None:
            try:
                of_stiffness.supported = not iteration(problem).floating.count
            except (BackendMissing, Unsupported):
                of_stiffness.supported = of_stiffness.iterable = False
            else:
                of_stiffness.iterable = True
        return of_stiffness.iterable


class Iteration(ContactIteration):
    """A stiffness and its rows in one process, with the V-cycle of a hierarchy.

    Raises Unsupported: a body floats along motions that `near_null_space` does not state: without a factorisation these
    cannot be distinguished from soft ones; BackendMissing: pyamg is not installed.

    Attributes
    ----------
    matrix : (n, n) sparse matrix, K, in blocks where it has them
    rows, touched : (m + k, t) CSR matrix and (t,) array of int, contacts, then ties, over the unknowns that they touch
    rigid : the rigid motions of bodies that float
    """

    solver = "pyamg"
    hierarchy: Hierarchy
    rigid: RigidMotions

    def __init__(self, problem: ContactProblem, tangents: bool = False, shared: Iteration | None = None) -> None:
        super().__init__()
        bare = np.flatnonzero(problem.diagonal == 0)
        if bare.size:
            raise Unsupported(f"pyamg: {problem.dof_name(int(bare[0]))} has no stiffness; {_INSTEAD}")
        rows = sp.vstack([problem.normal, problem.tie, *([problem.tangent] if tangents else [])], format="csr")
        mostly = 2 * len(np.unique(rows.indices)) > problem.dimension
        coarsest = COARSEST_TOUCHED if mostly else None
        hierarchy = (
            Hierarchy(problem.stiffness_rows, problem.near_null_space, coarsest) if shared is None else shared.hierarchy
        )
        self.rigid = _rigid_motions(problem, hierarchy) if shared is None else shared.rigid
        if problem._computed.of_stiffness.bodies is None:
            problem._computed.of_stiffness.bodies = hierarchy.bodies
        self.matrix, self._product = hierarchy.levels[0].matrix, hierarchy.levels[0].product
        self._diagonal, self._compliance = problem.diagonal, 1 / problem.diagonal
        self._sizes = problem.stiffness_sizes
        afloat = np.any(self.rigid.motions, axis=1) if self.rigid.count else None
        self.hierarchy, self._hierarchy = hierarchy, HeldHierarchy(hierarchy, rows, afloat)
        self.rows, self.touched = self._hierarchy.rows[0]
        self._row_sizes = abs(self.rows)
        self._near = problem.stiffness_rows[self.touched]
        self._near_sizes = abs(self._near)
        self._no_rows = np.zeros(0, dtype=np.intp)
        self._plain = self._hierarchy.cycle(self._no_rows)
        motions, m = self.rigid.motions, problem.contacts
        self.floating = FloatingMotions(OneProcess(), self._diagonal, motions, m, self.lengths, self.own_compliance)

    def dot(self, a: Vector, b: Vector) -> float:
        return float(a @ b)

    def dots(self, some: Array, b: Vector) -> Vector:
        return np.asarray(some @ b)

    def any(self, flags: Mask | bool) -> bool:
        return bool(np.any(flags))

    def count(self, flags: Mask) -> int:
        return int(np.sum(flags))

    def mark(self, flags: Mask) -> object:
        return flags.tobytes()

    def largest(self, values: Vector) -> Vector:
        return values

    @property
    def diagonal(self) -> Vector:
        return self._diagonal

    @property
    def entries(self) -> sp.csr_matrix:
        return self.rows

    def of_rows(self, chosen: Indices) -> Iteration:
        other = copy(self)
        other._hierarchy = self._hierarchy.of_rows(chosen)
        other.rows, other._row_sizes = self.rows[chosen], self._row_sizes[chosen]
        other.floating = self.floating.with_rows(other.lengths, other.own_compliance)
        return other

    def lengths_of(self, entries: sp.csr_matrix, x: Vector) -> Vector:
        return np.asarray(entries @ x[self.touched])

    def forces_of(self, entries: sp.csr_matrix, force: Vector) -> Vector:
        return self._spread(entries.T @ force)

    def constrained(self, entries: sp.csr_matrix, limit: Vector) -> AssembledRows:
        return AssembledRows(entries, self.touched, limit, self._compliance[self.touched])

    def refuse_late(self, what: str) -> None:
        refuse_late(what)

    def smoother(self, rows: Indices, sprung: sp.csr_matrix) -> Callable[[Vector], Vector]:
        """Return the preconditioner M r with constrained rows, and springs on sums of rows `sprung` E."""
        return self._hierarchy.cycle(rows, sprung)

    @property
    def own_compliance(self) -> Vector:
        return np.asarray(self.rows.multiply(self.rows) @ self._compliance[self.touched])

    def product(self, x: Vector) -> Vector:
        return self._product(x)

    def product_sizes(self, x: Vector) -> Vector:
        return np.asarray(self._sizes @ abs(x))

    def lengths(self, x: Vector) -> Vector:
        return np.asarray(self.rows @ x[self.touched])

    def length_sizes(self, x: Vector) -> Vector:
        return np.asarray(self._row_sizes @ abs(x[self.touched]))

    def forces(self, force: Vector) -> Vector:
        return self._spread(self.rows.T @ force)

    def force_sizes(self, force: Vector) -> Vector:
        return self._spread(self._row_sizes.T @ abs(force))

    def _spread(self, near: Vector) -> Vector:
        whole = np.zeros_like(self._diagonal)
        whole[self.touched] = near
        return whole

    def force_measure(self, force: Vector, x: Vector, load: Vector) -> Vector:
        sizes = self._near_sizes @ abs(x) + abs(load[self.touched]) + self._row_sizes.T @ abs(force)
        return sizes_of(self.rows).measure(force, sizes)

    def held(self, rows: Indices, limit: Vector) -> ConstrainedRows:
        closed = np.isin(np.arange(self.floating.contacts), rows)
        return self.at_rest(self.constrained(self.rows[rows], limit), closed)

    def close(self, held: ConstrainedRows, x: Vector, residual: Vector) -> None:
        away = x[self.touched]
        held.close(x)
        residual -= self._near.T @ (x[self.touched] - away)

    def run(self, x: Vector, residual: Vector, rows: Indices, held: ConstrainedRows) -> ConjugateGradients:
        """Return conjugate gradients on the displacements that satisfy constrained rows; see `ContactIteration.run`.

        Parameters
        ----------
        x, residual, rows, held
        """
        return ConjugateGradients(self.product, self._hierarchy.cycle(rows), x, residual, held)

    def run_without_rows(self, residual: Vector) -> ConjugateGradients:
        return ConjugateGradients(self.product, self._plain, np.zeros_like(residual), residual, self.floating)

    def smooth(self, force: Vector) -> Vector:
        return self._plain(force)

    def around(self, contacts: Mask, layers: int) -> Mask:
        normal = self._row_sizes[: len(contacts)]
        for _ in range(layers):
            reached = self._near_sizes.T @ (normal.T @ contacts.astype(float))
            contacts = normal @ reached[self.touched] > 0
        return contacts


def _rigid_motions(problem: ContactProblem, hierarchy: Hierarchy) -> RigidMotions:
    """Return the stated rigid motions of floating bodies; raise Unsupported for a body that may have others."""
    floating = np.flatnonzero(hierarchy.soft > 0)
    if not floating.size:
        return RigidMotions(np.zeros((problem.dimension, 0)))
    rigid = RigidMotions(np.zeros((problem.dimension, 0)))
    if problem.near_null_space is not None:
        rigid = stated_motions(problem.stiffness_rows, problem.stiffness_sizes, problem.near_null_space)
    for body in floating:
        members = np.flatnonzero(hierarchy.bodies == body)
        found = np.count_nonzero(np.any(rigid.motions[members], axis=0))
        if found < hierarchy.soft[body]:
            raise Unsupported(
                f"pyamg: the body of {problem.dof_name(int(members[0]))} floats: no support holds all of its motions "
                f"(least energy {hierarchy.held[body]:.1e} of its diagonal's), and near_null_space states {found} of "
                f"{hierarchy.soft[body]} as rigid; {_INSTEAD}"
            )
    return rigid


_INSTEAD = "hold it by supports, or factorise: CONTACTQP_SPARSE_SOLVER=pardiso (pip install pypardiso) or superlu"


def iteration(problem: ContactProblem) -> Iteration:
    """Return the iteration of a stiffness and its rows, made once and shared by `replace`."""
    if problem._computed.iteration is None:
        problem._computed.iteration = Iteration(problem)
    made: Iteration = problem._computed.iteration
    return made


def frictional_iteration(problem: ContactProblem) -> Iteration:
    """Return the iteration with tangential rows after contacts and ties, on the same hierarchy."""
    if problem._computed.frictional_iteration is None:
        problem._computed.frictional_iteration = Iteration(problem, tangents=True, shared=iteration(problem))
    made: Iteration = problem._computed.frictional_iteration
    return made
