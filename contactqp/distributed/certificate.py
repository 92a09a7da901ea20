"""The certificate of an answer that no rank has whole: `contactqp.certify` by reductions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.bounds import FRICTION_HAS_NONE, Bounds, no_bounds
from contactqp.certificate.certificate import ROUNDING_OF_ANSWERS, grazes, not_finite, status_words
from contactqp.certificate.failures import (
    MOST_NAMED,
    PARTS,
    failed_errors,
    fails_force_bound,
    said_of_balance,
    said_of_estimates,
    said_of_figure,
    said_of_force_bound,
    said_of_grazing,
    said_of_law,
    said_of_part,
)
from contactqp.certificate.figures import IMPLIED, NO_RESULTANT, Resultants, resultants
from contactqp.certificate.uniqueness import UNKNOWN
from contactqp.distributed.floating import floating_bodies
from contactqp.distributed.problem import (
    Bodies,
    DistributedAnswer,
    DistributedProblem,
    said_of_first,
    said_of_worst,
    worst,
)
from contactqp.distributed.violations import coulomb_residual, outer_forces, outer_resultant, row_sizes, violations
from contactqp.errors import InvalidProblem, NotConverged
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem_data import refuse_not_positive
from contactqp.model.solution import FIGURES, Certificate, Violations

# The least of a sum of sizes, h(a) = sum_j |b_j'a| over a with w'a = 1, from few sums: Kelley's cutting planes (1960).
#
# The sums s = sum_j sign(b_j'a) b_j for some a tell that h(a) = s'a, and h(c) >= |s'c| for every other c. The least t
# with t >= |s'c| for all s so far, a linear program of a few unknowns, is a lower bound, and its c is asked next. With
# six unknowns and a hundred thousand summands a hundred questions bring the bounds together.

# How near to each other the bounds end: figures are read with a few digits.
NEAR = 1e-9
MOST_QUESTIONS = 1000
# The linear program's own, beneath NEAR.
LP_TOLERANCE = 1e-10


class CuttingPlanes:
    """The search for one minimum.

    Parameters
    ----------
    weight : (p,) array
        w, not zero. h is the norm of some basis, its parts h(e_i) of about one size.

    Attributes
    ----------
    question : (p,) array
        The a whose sums are wanted next.
    best : (p,) array
        The a with the least h(a) / |w'a| so far.
    done : bool
        Whether that is the least.
    """

    def __init__(self, weight: Vector) -> None:
        self._weight = weight / np.max(abs(weight))
        self._least = np.inf
        self._cuts: list[Vector] = []
        self.best, self.done = self._weight, False
        self._questions = [self._weight, *np.eye(len(weight))]  # these bound the program

    @property
    def question(self) -> Vector:
        return np.asarray(self._questions[0])

    def tell(self, sums: Vector) -> None:
        """Take the sums of the question, and ask the next.

        Raises
        ------
        NotConverged
            The bounds did not come together.
        """
        asked = self._questions.pop(0)
        along = abs(float(self._weight @ asked))
        value = float(sums @ asked) / along if along > 0 else np.inf
        if value < self._least:
            self._least, self.best = value, asked
        self._cuts.append(sums)
        if self._questions:
            return
        following, lower = _program(np.array(self._cuts), self._weight)
        self._questions = [following]
        self.done = self._least - lower <= NEAR * self._least
        if not self.done and len(self._cuts) >= MOST_QUESTIONS:
            raise NotConverged(f"the balance of forces could not be judged: {MOST_QUESTIONS} motions were too few")


def _program(cuts: Vector, weight: Vector) -> tuple[Vector, float]:
    """argmin and least t >= |s'c| over c with w'c = 1."""
    from scipy.optimize import linprog

    count, width = cuts.shape
    one = np.ones((count, 1))
    found = linprog(
        np.append(np.zeros(width), 1.0),
        A_ub=np.block([[cuts, -one], [-cuts, -one]]),
        b_ub=np.zeros(2 * count),
        A_eq=np.append(weight, 0.0)[None],
        b_eq=[1.0],
        bounds=[(None, None)] * width + [(0, None)],
        method="highs",
        options={"primal_feasibility_tolerance": LP_TOLERANCE, "dual_feasibility_tolerance": LP_TOLERANCE},
    )
    if found.x is None:
        raise NotConverged(f"the balance of forces could not be judged: {found.message}")
    return np.asarray(found.x[:width]), float(found.x[width])


# Whether the outer forces of every body balance, wherever its parts are: `contactqp.certificate.figures` by reductions.
#
# A body's motions, at most six, are judged at its home (`contactqp.distributed.problem`): it is sent the triangular
# factors R of w_j = z_j size_j on each rank, which together have the singular values of the whole w, and the sums that
# the search for the worst motion asks for.


def balance(problem: DistributedProblem, answer: DistributedAnswer, bodies: Bodies) -> float:
    """The worst |z'r| / |z|'(|f| + |E|'|l| + |A|'|nu|) over all rigid motions z of the bodies. Collective.

    Bodies float as far as `soft_motions` tell; one that floats in another way is taken for held.

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
    # K z is zero but for the rounding of K; what that makes of the displacement is no lack of balance.
    stray = np.column_stack([abs(problem.product(z)) * u for z in Z.T])
    parts = _Parts(bodies, floating.floats, Z * size[:, None])
    spectra, work, stray = parts.singular(), bodies.totals(Z * outer[:, None]), bodies.totals(stray)
    at_home = [i for i, (values, _) in enumerate(spectra) if values[0] > 0]  # no force acts on the others
    searches = {i: _Search(resultants(*spectra[i], work[i], stray[i])) for i in at_home}
    parts.mix({i: search.found.weight for i, search in searches.items()})
    forces, hidden = bodies.totals(abs(parts.basis)), 1.0 if problem.frictional else 0.0
    for i, search in searches.items():
        search.begin(forces[i], hidden)
    while problem.ranks.any([search.planes is not None for search in searches.values()]):
        sums = parts.asked({i: search.direction() for i, search in searches.items()})
        with problem.ranks.together():
            for i, search in searches.items():
                search.tell(sums[i])
    return float(problem.ranks.max(max((search.worst for search in searches.values()), default=0.0)))


class _Parts:
    """What this rank has of the columns w (n_here, r) of bodies; all methods are collective."""

    def __init__(self, bodies: Bodies, floats: NDArray[np.bool_], columns: Array) -> None:
        self._bodies, self._floats, self._columns = bodies, floats, columns
        self.basis = np.zeros_like(columns)

    def singular(self) -> list[tuple[Vector, Array]]:
        """The singular values and right vectors of w of each body at home here."""
        width = self._columns.shape[1]
        factors = np.zeros((len(self._floats), width, width))
        for place in np.flatnonzero(self._floats):
            factor = np.linalg.qr(self._columns[self._bodies.members(int(place))])[1]
            factors[place, : len(factor)] = factor
        came, body = self._bodies.parts(factors)
        stacked = (came[body == i].reshape(-1, width) for i in range(self._bodies.count))
        return [np.linalg.svd(rows, full_matrices=False)[1:] for rows in stacked]

    def mix(self, weights: dict[int, Array]) -> None:
        """Make the basis w weight' of the bodies at home here with weights (p, r), p <= r."""
        width = self._columns.shape[1]
        told = np.zeros((self._bodies.count, width, width))
        for i, weight in weights.items():
            told[i, :, : len(weight)] = weight.T
        self.basis = self._bodies.combined(self._columns, self._bodies.told(told))

    def asked(self, directions: dict[int, Vector]) -> Array:
        """The sums (count, r) of sign(basis a) basis for a direction (p,) of each body at home here."""
        told = np.zeros((self._bodies.count, self.basis.shape[1]))
        for i, direction in directions.items():
            told[i, : len(direction)] = direction
        along = self._bodies.combined(self.basis, self._bodies.told(told)[:, :, None])
        return self._bodies.totals(np.sign(along) * self.basis)


class _Search:
    """The worst motion of one body, at its home; `planes` while it is not found."""

    def __init__(self, found: Resultants) -> None:
        self.found, self.worst = found, 0.0
        self.planes: CuttingPlanes | None = None
        self._seen = np.zeros(0, dtype=np.intp)

    def begin(self, forces: Vector, hidden: float) -> None:
        """`forces` (r,) are the sums of the sizes of the coordinates."""
        forces = forces[: len(self.found.work)]
        if self.found.unseen(forces, hidden):
            self.worst = hidden
            return
        self.worst, self._seen = self.found.worst(forces), np.flatnonzero(self.found.seen(forces))
        if len(self._seen) > 1 and self.worst > NO_RESULTANT:
            self.planes = CuttingPlanes(self.found.work[self._seen])

    def direction(self) -> Vector:
        """(p,) the coordinates of the motion that is asked about; zero where nothing is."""
        asked = np.zeros(len(self.found.work))
        if self.planes is not None:
            asked[self._seen] = self.planes.question
        return asked

    def tell(self, sums: Vector) -> None:
        """Take the answer (r,)."""
        if self.planes is None:
            return
        asked = self.direction()
        self.worst = max(self.worst, self.found.net(asked) / float(sums[: len(asked)] @ asked))
        self.planes.tell(sums[self._seen])
        self.planes = None if self.planes.done else self.planes


NOT_ASKED = "no solver was given that could bound it"
NOT_COMPARED = "the verdict rests on the figures alone: bodies that are dealt out to ranks have no system of one state"
NOT_FACTORISED = "uniqueness was not examined: bodies that are dealt out to ranks are not condensed onto their contacts"


def certify_distributed(
    problem: DistributedProblem,
    answer: DistributedAnswer,
    tolerance: float = 1e-9,
    error_tolerance: float = 1e-6,
    bounds: Callable[[], Bounds] | None = None,
) -> Certificate:
    """Judge anyone's answer, of which each rank has its part, as `contactqp.certify` judges it. Collective.

    The certificate is the same on all ranks, but for `violations` and `force_bound`, which are those of the rank's own
    unknowns, contacts and ties; `grazing` are numbers of contacts as one process would have them.

    Parameters
    ----------
    problem : DistributedProblem
    answer : DistributedAnswer
    tolerance : float
        Largest figure that passes.
    error_tolerance : float
        Largest bound on the relative error that passes.
    bounds : function, optional
        Called by all ranks where the answer is finite and nothing rubs: how far the answer is from the truth.

    Raises
    ------
    InvalidProblem
        Wrong shapes on any rank, or no positive tolerance. NaN is no error here: it fails.
    """
    refuse_not_positive("tolerance", tolerance)
    refuse_not_positive("error_tolerance", error_tolerance)
    ranks = problem.ranks
    with ranks.together():
        _refuse_shapes(problem, answer)
    frictional = problem.frictional
    if failures := _not_finite(problem, answer):
        return not_finite(frictional, failures, tolerance, error_tolerance)
    known = _known(frictional, bounds)
    bodies = Bodies(ranks, problem.body)
    found = violations(problem, answer, bodies, ROUNDING_OF_ANSWERS * tolerance)
    named = [name for name in FIGURES if name != "balance"]
    figures = dict(zip(named, worst(ranks, *(getattr(found, name) for name in named)), strict=True))
    figures["balance"] = balance(problem, answer, bodies)
    law = coulomb_residual(problem, answer, found)
    natural_map = None if law is None else worst(ranks, law)[0]
    failures = [
        *_failed_figures(problem, answer, found, figures, tolerance),
        *_failed_law(problem, law, natural_map, IMPLIED * tolerance),
        *failed_errors(known, error_tolerance, ROUNDING_OF_ANSWERS * tolerance * found.intrinsic_size),
        *_failed_force_bound(problem, answer, known, error_tolerance),
    ]
    grazing, names = _grazing(problem, answer, found, known, tolerance)
    examined = ((UNKNOWN,), (NOT_FACTORISED, NOT_COMPARED)) if frictional else ((), ())
    return Certificate(
        **figures,
        natural_map=natural_map,
        energy_error=known.energy_error,
        force_error=known.force_error,
        force_bound=known.force_bound,
        reasons=known.reasons,
        grazing=grazing,
        failures=tuple(failures),
        notes=(*said_of_grazing(names), *said_of_estimates(known), *examined[1]),
        uniqueness=examined[0],
        contraction=None,
        tolerance=tolerance,
        error_tolerance=error_tolerance,
        passed=not failures,
        proven=known.proven,
        basis=known.basis,
        violations=found,
    )


def contact_status(problem: DistributedProblem, certificate: Certificate) -> Any:
    """(m_here,) of open, closed, grazing and, with friction, stick, slip, as `contactqp.certificate.certificate`
    measures them.
    """
    return status_words(certificate, problem.friction, np.isin(problem.contact_number, certificate.grazing))


def _known(frictional: bool, bounds: Callable[[], Bounds] | None) -> Bounds:
    if frictional:
        return no_bounds(FRICTION_HAS_NONE)
    return no_bounds(NOT_ASKED) if bounds is None else bounds()


def _refuse_shapes(problem: DistributedProblem, answer: DistributedAnswer) -> None:
    rubbed = None if problem.slip_origin is None else problem.slip_origin.shape
    expected = dict(zip(PARTS, (problem.load.shape, problem.gap.shape, rubbed, problem.tie_value.shape), strict=True))
    for name, shape in expected.items():
        values = getattr(answer, name)
        if values is None and name == "friction_force":
            if problem.friction is not None and np.any(problem.friction > 0):
                raise InvalidProblem("friction_force: the problem has friction; expected one force a contact, got None")
        elif np.shape(values) != shape:
            raise InvalidProblem(f"{name}: expected shape {shape} on this rank, got {np.shape(values)}")


def _not_finite(problem: DistributedProblem, answer: DistributedAnswer) -> list[str]:
    """What is not finite, in words, the first unknown, contact or tie of each part of the answer."""
    numbers = problem.dof_number, problem.contact_number, problem.contact_number, problem.tie_number
    said = []
    for name, number in zip(PARTS, numbers, strict=True):
        values = getattr(answer, name)
        values = np.zeros(len(number)) if values is None else values
        flags = ~np.all(np.isfinite(values), axis=tuple(range(1, values.ndim)))
        say = partial(said_of_part, problem, name, values)
        said.append(said_of_first(problem.ranks, flags, number, say))
    return [text for text in said if text is not None]


def _failed_figures(
    problem: DistributedProblem,
    answer: DistributedAnswer,
    found: Violations,
    figures: dict[str, float],
    tolerance: float,
) -> list[str]:
    numbers = {"equilibrium": problem.dof_number, "tie": problem.tie_number}
    said = []
    for name in FIGURES:
        if figures[name] <= tolerance:
            continue
        if name == "balance":
            said.append(said_of_balance(figures[name], tolerance))
            continue
        number = numbers.get(name, problem.contact_number)
        say = partial(said_of_figure, problem, answer, found, name, tolerance=tolerance)
        said.append(said_of_worst(problem.ranks, getattr(found, name), number, say))
    return said


def _failed_law(problem: DistributedProblem, law: Vector | None, largest: float | None, limit: float) -> list[str]:
    if law is None or largest is None or largest <= limit:
        return []
    say = partial(said_of_law, problem, law, limit=limit)
    return [said_of_worst(problem.ranks, law, problem.contact_number, say)]


def _failed_force_bound(
    problem: DistributedProblem, answer: DistributedAnswer, known: Bounds, tolerance: float
) -> list[str]:
    relative = known.relative_force_bound
    if not problem.ranks.any(fails_force_bound(known, tolerance)) or relative is None:
        return []
    say = partial(said_of_force_bound, problem, answer, known, tolerance=tolerance)
    return [said_of_worst(problem.ranks, relative, problem.contact_number, say)]


def _grazing(
    problem: DistributedProblem, answer: DistributedAnswer, found: Violations, known: Bounds, tolerance: float
) -> tuple[tuple[int, ...], list[str]]:
    """The numbers of the contacts of all ranks that graze, and the names of the first of them."""
    compliance = row_sizes(problem, problem.normal).compliance
    here = np.flatnonzero(grazes(answer, found, compliance, known, tolerance))
    here = here[np.argsort(problem.contact_number[here])]
    numbers = np.sort(problem.ranks.gathered(problem.contact_number[here]))
    names = [(int(problem.contact_number[i]), problem.contact_name(int(i))) for i in here[:MOST_NAMED]]
    every = sorted(name for part in problem.ranks.comm.allgather(names) for name in part)
    return tuple(int(number) for number in numbers), [name for _, name in every[:MOST_NAMED]]
