"""Certify a distributed answer: `contactqp.certify` by reductions over the ranks."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from contactqp.certificate import messages
from contactqp.certificate.balance import NO_RESULTANT, Resultants, resultants
from contactqp.certificate.bounds import FRICTION_HAS_NONE, Bounds, error_failures, force_bound_fails, no_bounds
from contactqp.certificate.certificate import ROUNDING_OF_ANSWERS, grazes
from contactqp.certificate.coulomb_law import IMPLIED
from contactqp.certificate.figures import status_words
from contactqp.certificate.uniqueness import UNKNOWN
from contactqp.distributed.problem import (
    Bodies,
    DistributedProblem,
    floating_bodies,
    largest_over_ranks,
    message_of_first,
    message_of_largest,
)
from contactqp.distributed.violations import (
    coulomb_residual,
    outer_forces,
    outer_resultant,
    row_sizes,
    untouched,
    violations,
)
from contactqp.errors import InvalidProblem, NotConverged
from contactqp.linalg.existence import LP_OPTIONS
from contactqp.model.arrays import Array, Index, Mask, Vector
from contactqp.model.problem_data import refuse_not_positive
from contactqp.model.solution import ANSWER_PARTS, FIGURES, GLOBALLY, Answer, Certificate, Violations

# The relative distance of the bounds of a minimum at the end; figures need few digits only.
BOUNDS_APART = 1e-9
MOST_QUERIES = 1000


class CuttingPlanes:
    """Minimise the sum of sizes h(a) = sum_j |b_j'a| over w'a = 1 by Kelley's cutting planes (1960), from few sums.

    The sums s = sum_j sign(b_j'a) b_j at a give h(a) = s'a, and h(c) >= |s'c| for every other c. The least t with
    t >= |s'c| for all previous s, a linear program of a few unknowns, is a lower bound of the minimum, and its c is the
    next query. With six unknowns and a hundred thousand summands about a hundred queries suffice.

    Parameters
    ----------
    weight : (p,) array
        w, not zero. h is the norm of some basis whose parts h(e_i) are of about one size.

    Attributes
    ----------
    best : (p,) array, the a with the least h(a) / |w'a| so far
    done : bool, whether `best` is the minimum, up to BOUNDS_APART
    """

    def __init__(self, weight: Vector) -> None:
        self._weight = weight / np.max(abs(weight))
        self._least = np.inf
        self._cuts: list[Vector] = []
        self.best, self.done = self._weight, False
        self._queries = [self._weight, *np.eye(len(weight))]  # these bound the program

    @property
    def query(self) -> Vector:
        """Return the a (p,) at which sums are needed next."""
        return np.asarray(self._queries[0])

    def add_cut(self, sums: Vector) -> None:
        """Add the sums (p,) at the query, and find the next query.

        Raises NotConverged: the bounds did not come together.
        """
        query = self._queries.pop(0)
        along = abs(float(self._weight @ query))
        value = float(sums @ query) / along if along > 0 else np.inf
        if value < self._least:
            self._least, self.best = value, query
        self._cuts.append(sums)
        if self._queries:
            return
        following, lower = self._program()
        self._queries = [following]
        self.done = self._least - lower <= BOUNDS_APART * self._least
        if not self.done and len(self._cuts) >= MOST_QUERIES:
            raise NotConverged(f"the balance of forces could not be judged: {MOST_QUERIES} motions were too few")

    def _program(self) -> tuple[Vector, float]:
        """Return the minimiser c and the minimum of t >= |s'c| over w'c = 1."""
        from scipy.optimize import linprog

        cuts = np.array(self._cuts)
        count, width = cuts.shape
        one = np.ones((count, 1))
        found = linprog(
            np.append(np.zeros(width), 1.0),
            A_ub=np.block([[cuts, -one], [-cuts, -one]]),
            b_ub=np.zeros(2 * count),
            A_eq=np.append(self._weight, 0.0)[None],
            b_eq=[1.0],
            bounds=[(None, None)] * width + [(0, None)],
            method="highs",
            options=LP_OPTIONS,
        )
        if found.x is None:
            raise NotConverged(f"the balance of forces could not be judged: {found.message}")
        return np.asarray(found.x[:width]), float(found.x[width])


def balance(problem: DistributedProblem, answer: Answer, bodies: Bodies, negligible: Vector) -> float:
    """Return the largest |z'r| / |z|'(|f| + |E|'|l| + |A|'|nu|) over all rigid motions z of the bodies. Collective.

    The motions of a body, at most six, are judged at its home. The home receives the triangular factors R of w_j = z_j
    size_j on each rank, which together have the singular values of the whole w, and the sums for the search for the
    worst motion. A body whose rigid motion is not a combination of known motions counts as supported.

    Parameters
    ----------
    problem, answer : the problem and the answer, distributed over all ranks
    bodies : the bodies, each with its home
    negligible : (n_here,) array [force], up to which forces are rounding: those on unknowns that nothing touches,
        such as F sin(pi), and all that act on a body without load

    Raises
    ------
    NotConverged
        The worst motion of a body was not found.
    """
    floating = floating_bodies(problem, bodies)
    if not problem.ranks.any(floating.floats):
        return 0.0
    Z, u = floating.motions, abs(answer.displacement)
    outer, size = outer_resultant(problem, answer), outer_forces(problem, answer)
    rounding = untouched(problem) & (size <= negligible)
    outer[rounding] = size[rounding] = 0.0
    # K z is zero up to rounding of K, whose product with the displacement is not an imbalance.
    stray = np.column_stack([abs(problem.product(z)) * u for z in Z.T])
    columns = _BodyColumns(bodies, floating.floats, Z * size[:, None])
    spectra, work, stray = columns.singular_values(), bodies.totals(Z * outer[:, None]), bodies.totals(stray)
    # Bodies without load need no balance if all forces on them are negligible.
    heard = bodies.totals(((size > negligible) | (problem.load != 0)).astype(float)[:, None])
    at_home = [i for i, (values, _) in enumerate(spectra) if values[0] > 0 and np.any(heard[i] > 0)]
    searches = {i: _WorstMotion(resultants(*spectra[i], work[i], stray[i])) for i in at_home}
    columns.set_basis({i: search.resultants.weight for i, search in searches.items()})
    forces, hidden = bodies.totals(abs(columns.basis)), 1.0 if problem.frictional else 0.0
    for i, search in searches.items():
        search.begin(forces[i], hidden)
    while problem.ranks.any([search.planes is not None for search in searches.values()]):
        sums = columns.sums_along({i: search.direction() for i, search in searches.items()})
        with problem.ranks.raising_together():
            for i, search in searches.items():
                search.add_cut(sums[i])
    return float(problem.ranks.max(max((search.figure for search in searches.values()), default=0.0)))


class _BodyColumns:
    """The rows on this rank of columns w (n_here, r) of each body; all methods are collective."""

    def __init__(self, bodies: Bodies, floats: Mask, columns: Array) -> None:
        self._bodies, self._floats, self._columns = bodies, floats, columns
        self.basis = np.zeros_like(columns)

    def singular_values(self) -> list[tuple[Vector, Array]]:
        """Return the singular values and right singular vectors of w of each body that has its home here."""
        width = self._columns.shape[1]
        factors = np.zeros((len(self._floats), width, width))
        for place in np.flatnonzero(self._floats):
            factor = np.linalg.qr(self._columns[self._bodies.members(int(place))])[1]
            factors[place, : len(factor)] = factor
        received, body = self._bodies.at_homes(factors)
        stacked = (received[body == i].reshape(-1, width) for i in range(self._bodies.count))
        return [np.linalg.svd(rows, full_matrices=False)[1:] for rows in stacked]

    def set_basis(self, weights: dict[int, Array]) -> None:
        """Set the basis w weight' of the bodies with their home here; weights are (p, r), p <= r."""
        self.basis = self._combined(self._columns, weights, self._columns.shape[1])

    def sums_along(self, directions: dict[int, Vector]) -> Array:
        """Return the sums (count, r) of sign(basis a) basis for a direction a (p,) of each body at its home."""
        along = self._combined(self.basis, {i: direction[None] for i, direction in directions.items()}, 1)
        return self._bodies.totals(np.sign(along) * self.basis)

    def _combined(self, columns: Array, weights: dict[int, Array], count: int) -> Array:
        """Return columns (n_here, r) times weight' of each body, (n_here, count); fewer weights are padded by zeros."""
        padded = np.zeros((self._bodies.count, columns.shape[1], count))
        for i, weight in weights.items():
            padded[i, : weight.shape[1], : len(weight)] = weight.T
        return self._bodies.combined(columns, self._bodies.from_homes(padded))


class _WorstMotion:
    """The search, at the home of a body, for its motion with the largest imbalance of forces; `planes` until it
    ends.
    """

    def __init__(self, found: Resultants) -> None:
        self.resultants, self.figure = found, 0.0
        self.planes: CuttingPlanes | None = None
        self._seen = np.zeros(0, dtype=np.intp)

    def begin(self, forces: Vector, hidden: float) -> None:
        """Start the search, given the sums (r,) of the sizes of the coordinates."""
        forces = forces[: len(self.resultants.work)]
        if self.resultants.unseen(forces, hidden):
            self.figure = hidden
            return
        self.figure, self._seen = self.resultants.worst(forces), np.flatnonzero(self.resultants.seen(forces))
        if len(self._seen) > 1 and self.figure > NO_RESULTANT:
            self.planes = CuttingPlanes(self.resultants.work[self._seen])

    def direction(self) -> Vector:
        """Return the coordinates (p,) of the motion at which sums are needed, zero if none are."""
        direction = np.zeros(len(self.resultants.work))
        if self.planes is not None:
            direction[self._seen] = self.planes.query
        return direction

    def add_cut(self, sums: Vector) -> None:
        """Add the sums (r,) along `direction`."""
        if self.planes is None:
            return
        direction = self.direction()
        self.figure = max(self.figure, self.resultants.net(direction) / float(sums[: len(direction)] @ direction))
        self.planes.add_cut(sums[self._seen])
        self.planes = None if self.planes.done else self.planes


NOT_ASKED = "no solver was given that could bound it"
NOT_COMPARED = "the verdict rests on the figures alone: bodies that are dealt out to ranks have no system of one state"
NOT_FACTORISED = "uniqueness was not examined: bodies that are dealt out to ranks are not condensed onto their contacts"


def certify_distributed(
    problem: DistributedProblem,
    answer: Answer,
    tolerance: float = 1e-9,
    error_tolerance: float = 1e-6,
    bounds: Callable[[], Bounds] | None = None,
) -> Certificate:
    """Judge any answer, of which each rank has its part, as `contactqp.certify` does. Collective.

    The certificate is the same on all ranks, except that `violations` and `force_bound` are those of the rank's own
    unknowns, contacts and ties; `grazing` are numbers of contacts in one process.

    Parameters
    ----------
    problem : the problem
    answer : the part of this rank
    tolerance : largest figure that passes
    error_tolerance : largest bound on the relative error that passes
    bounds : function, optional
        Returns the bounds of the error; all ranks call it where the answer is finite and there is no friction.

    Raises
    ------
    InvalidProblem
        Wrong shapes on any rank, or a tolerance that is not positive. NaN raises no error, but fails.
    """
    refuse_not_positive("tolerance", tolerance)
    refuse_not_positive("error_tolerance", error_tolerance)
    ranks = problem.ranks
    with ranks.raising_together():
        _refuse_shapes(problem, answer)
    frictional = problem.frictional
    if failures := _not_finite(problem, answer):
        return messages.not_finite(frictional, failures, tolerance, error_tolerance)
    if frictional or bounds is None:
        error_bounds = no_bounds(FRICTION_HAS_NONE if frictional else NOT_ASKED)
    else:
        error_bounds = bounds()
    bodies = Bodies(ranks, problem.body)
    found = violations(problem, answer, bodies, ROUNDING_OF_ANSWERS * tolerance)
    names = [name for name in FIGURES if name != "balance"]
    figures: dict[str, Any] = dict(
        zip(names, largest_over_ranks(ranks, *(getattr(found, name) for name in names)), strict=True)
    )
    forces = outer_forces(problem, answer)
    acts = bool(problem.load.any() or np.any(forces > found.nothing.force))
    figures["balance"] = balance(problem, answer, bodies, found.nothing.force) if ranks.any(acts) else 0.0
    law = coulomb_residual(problem, answer, found)
    natural_map = None if law is None else largest_over_ranks(ranks, law)[0]
    failures = [
        *_failed_figures(problem, answer, found, figures, tolerance),
        *_failed_law(problem, law, natural_map, IMPLIED * tolerance),
        *error_failures(error_bounds, error_tolerance, ROUNDING_OF_ANSWERS * tolerance * found.intrinsic_size),
        *_failed_force_bound(problem, answer, error_bounds, error_tolerance),
    ]
    grazing, names = _grazing(problem, answer, found, error_bounds, tolerance)
    not_examined = (NOT_FACTORISED, NOT_COMPARED) if frictional else ()
    return Certificate(
        **figures,
        natural_map=natural_map,
        energy_error=error_bounds.energy_error,
        force_error=error_bounds.force_error,
        force_bound=error_bounds.force_bound,
        reasons=error_bounds.reasons,
        grazing=grazing,
        failures=tuple(failures),
        notes=(*messages.of_grazing(names), *messages.of_estimates(error_bounds), *not_examined),
        uniqueness=(UNKNOWN,) if frictional else (),
        contraction=None,
        tolerance=tolerance,
        error_tolerance=error_tolerance,
        passed=not failures,
        proven=error_bounds.proven,
        scope=GLOBALLY if error_bounds.proven else None,
        basis=error_bounds.basis,
        violations=found,
    )


def contact_status(problem: DistributedProblem, certificate: Certificate) -> Any:
    """Return the status (m_here,) of this rank's contacts: open, closed, grazing and, with friction, stick or slip."""
    return status_words(certificate, problem.friction, np.isin(problem.contact_number, certificate.grazing))


def _refuse_shapes(problem: DistributedProblem, answer: Answer) -> None:
    tangential = None if problem.slip_origin is None else problem.slip_origin.shape
    shapes = (problem.load.shape, problem.gap.shape, tangential, problem.tie_value.shape)
    for name, shape in zip(ANSWER_PARTS, shapes, strict=True):
        values = getattr(answer, name)
        if values is None and name == "friction_force":
            if problem.friction is not None and np.any(problem.friction > 0):
                raise InvalidProblem("friction_force: the problem has friction; expected one force a contact, got None")
        elif np.shape(values) != shape:
            raise InvalidProblem(f"{name}: expected shape {shape} on this rank, got {np.shape(values)}")


def _not_finite(problem: DistributedProblem, answer: Answer) -> list[str]:
    """Return a message for each part of the answer that is not finite, with its first such unknown, contact or tie."""
    numbers = problem.dof_number, problem.contact_number, problem.contact_number, problem.tie_number
    texts = []
    for name, number in zip(ANSWER_PARTS, numbers, strict=True):
        values = getattr(answer, name)
        values = np.zeros(len(number)) if values is None else values
        flags = ~np.all(np.isfinite(values), axis=tuple(range(1, values.ndim)))
        message = partial(messages.of_part, problem, name, values)
        texts.append(message_of_first(problem.ranks, flags, number, message))
    return [text for text in texts if text is not None]


def _failed_figures(
    problem: DistributedProblem, answer: Answer, found: Violations, figures: dict[str, float], tolerance: float
) -> list[str]:
    numbers = {"equilibrium": problem.dof_number, "tie": problem.tie_number}
    texts = []
    for name in FIGURES:
        if figures[name] <= tolerance:
            continue
        if name == "balance":
            texts.append(messages.of_balance(figures[name], tolerance))
            continue
        number = numbers.get(name, problem.contact_number)
        message = partial(messages.of_figure, problem, answer, found, name, tolerance=tolerance)
        texts.append(message_of_largest(problem.ranks, getattr(found, name), number, message))
    return texts


def _failed_law(problem: DistributedProblem, law: Vector | None, largest: float | None, limit: float) -> list[str]:
    if law is None or largest is None or largest <= limit:
        return []
    message = partial(messages.of_law, problem, law, limit=limit)
    return [message_of_largest(problem.ranks, law, problem.contact_number, message)]


def _failed_force_bound(
    problem: DistributedProblem, answer: Answer, bounds: Bounds, error_tolerance: float
) -> list[str]:
    relative = bounds.relative_force_bound
    if not problem.ranks.any(force_bound_fails(bounds, error_tolerance, 0.0)) or relative is None:
        return []
    message = partial(messages.of_force_bound, problem, answer, bounds, tolerance=error_tolerance)
    return [message_of_largest(problem.ranks, relative, problem.contact_number, message)]


def _grazing(
    problem: DistributedProblem, answer: Answer, found: Violations, bounds: Bounds, tolerance: float
) -> tuple[tuple[int, ...], list[str]]:
    """Return the numbers of the grazing contacts of all ranks, and the names of the first ones."""
    compliance = row_sizes(problem, problem.normal).compliance
    here = np.flatnonzero(grazes(answer, found, compliance, bounds, tolerance))
    numbers: Index = problem.contact_number[here]
    here = here[np.argsort(numbers)]
    first = [(int(problem.contact_number[i]), problem.contact_name(int(i))) for i in here[: messages.MOST_NAMED]]
    every = sorted(name for part in problem.ranks.comm.allgather(first) for name in part)
    return tuple(np.sort(problem.ranks.gathered(numbers)).tolist()), [name for _, name in every[: messages.MOST_NAMED]]
