"""The inexact primal-dual active set by conjugate gradients, for bodies that are too large to factorise.

On the contacts A that are closed, with all ties, conjugate gradients approach K u = f - E_A'l_A, E_A u = g_A; forces
come from the residual r = f - K u, l_A = (E_A D^-1 E_A')^-1 E_A D^-1 r. After each step the current forces l and gaps
determine the next set (Hintermueller, Ito and Kunisch 2003), the contacts with l_i + (E u - g)_i / (E_i D^-1 E_i') > 0.
The violations of the current set have the energy

    delta^2 = sum of (E_i D^-1 E_i') l_i^2 over tensions + sum of (E u - g)_i^2 / (E_i D^-1 E_i') over penetrations,

and the set is changed as soon as the error r'M r of the displacement on it is no larger, so that systems of early sets
are solved no more accurately than needed. Only the last one is solved to the final tolerance.
"""

from __future__ import annotations

import time

import numpy as np

from contactqp.certificate.multigrid_bounds import balanced_forces, dual_norm, force_norm
from contactqp.linalg.contact_iteration import ContactIteration, Limits
from contactqp.linalg.krylov import ConjugateGradients, ConstrainedRows
from contactqp.linalg.measures import beyond, ratio
from contactqp.model.arrays import EPS, Indices, Mask, Vector, tell
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods.method import Settings

# The relative error in energy of the solution without contact, which gives the first set.
FIRST = 0.3
# A set is changed when the error on it falls below this part of its violations, a smaller one if sets recur.
TRUST, TIGHTER, LEAST_TRUST = 3.0, 0.1, 1e-6
# The most changes of the set, and the most steps on one set.
SETS, STEPS = 200, 2000
# After the first number of shrinkings several layers of contacts are opened at once, at most the second number.
SINGLE_LAYERS, MOST_LAYERS = 2, 64
# The tolerance on the equilibrium of the last set relative to that of the call, and on wrong signs relative to that.
EQUILIBRIUM, SIGN = 0.7, 0.1
TIGHTEST = 1e-13
# The residual relative to the forces that meet at an unknown, when only rounding is left.
ROUNDING_OF_RESIDUALS = 4 * EPS
# The tolerance of the certificate on equilibrium, independent of that of the method.
LOOSEST = 1e-9
# If the load is below this part of the forces of the known displacement, the iteration starts from rest.
UNLOADED = 1e-4
# With a larger relative error in energy the signs are not examined.
SIGNS_SETTLED = 1e-4
# For a set that another method starts from: the relative error in energy, and the most steps in all (45 are needed on
# membranes of a million nodes), after which the hierarchy is considered unsuitable.
IDENTIFIED, IDENTIFYING_STEPS = 1e-3, 150
# Products of ties have at most this many times the entries of K and the ties; with more, a backend takes less time.
MOST_SHARED = 4
# It is also unsuitable if sets alternately grow and shrink this often and in this part of the steps; on bodies and
# membranes they do so at most six times and in a third of the steps.
TURNS, OFTEN = 10, 0.42
# Forces and lengths below this part of the energy norm of the displacement count as zero (`contactqp.linalg.measures`),
# a tenth of the certificate's limit.
ZERO_BY_ENERGY = 1e-13
# The error in energy on the set, and its bound, relative to the energy of the contact forces (of the displacement
# without them), so that the certificate can prove 1e-6.
ENERGY, BOUND = 1e-7, 3e-7


def solve_by_iteration(
    problem: Limits, iteration: ContactIteration, settings: Settings, energy: float = ENERGY
) -> Candidate:
    """Return displacement and forces on a set that their signs confirm; `claimed` is False if none was found.

    Parameters
    ----------
    problem : load, gaps and tie values
    iteration : stiffness and rows
    settings : limits, and the answer to start from
    energy : the error in energy on that set, over the energy of the contact forces
    """
    return _Search(problem, iteration, settings, energy).run()


def identified_by_iteration(
    problem: Limits, iteration: ContactIteration, settings: Settings, error: float = IDENTIFIED
) -> Candidate | None:
    """Return a less accurate candidate for the start of another method, None if the iteration takes too long.

    Parameters
    ----------
    problem, iteration, settings
        As in `solve_by_iteration`.
    error : the error in energy at which the set is taken, over the energy of the displacement
    """
    search = _Search(problem, iteration, settings, ENERGY, steps=IDENTIFYING_STEPS, identified=error)
    found = search.run() if search.steps_left() > 0 else None
    return found if search.steps_left() > 0 else None


def projects_slowly(problem: ContactProblem) -> bool:
    """Return whether ties share so many unknowns that their products, which projections factorise, outweigh K."""
    shared = np.bincount(problem.tie.indices, minlength=1).astype(float)
    return bool(shared @ shared > MOST_SHARED * (problem.stiffness_rows.nnz + problem.tie.nnz))


class _Search:
    """The current displacement, its set, and the cost so far."""

    def __init__(
        self,
        problem: Limits,
        iteration: ContactIteration,
        settings: Settings,
        energy: float,
        steps: int | None = None,
        identified: float = 0.0,
    ) -> None:
        self.problem, self.iteration, self.energy = problem, iteration, energy
        self.identified = identified
        self.identifies, self._last_step = steps is not None, iteration.krylov_iterations + (steps or SETS * STEPS)
        self.m = len(problem.gap)
        self.limit = np.concatenate([problem.gap, problem.tie_value])
        self.sets_left = settings.max_iter or SETS
        self.tolerance = max(min(settings.tolerance, LOOSEST), TIGHTEST)
        self.end = np.inf if settings.time_limit is None else time.perf_counter() + settings.time_limit
        self.seen: set[object] = set()
        self.sizes: list[int] = []  # of the sets
        self.trust = TRUST
        self.history: list[float] = []
        self.shrunk, self.layers, self.most_layers = 0, 1, MOST_LAYERS
        self.before: Vector | None = None  # a displacement without contact forces
        self.start(settings.warm_start)

    def start(self, candidate: Candidate | None) -> None:
        """Choose the first displacement and set: those of a known solution, or of the bodies without contact."""
        if candidate is not None and self._loaded(candidate):
            self.x = candidate.answer.displacement.copy()
            self.residual = self.problem.load - self.iteration.product(self.x)
            self.before, self.residual_before = np.zeros_like(self.x), self.problem.load
            self.closed = self.iteration.supported(self.problem, candidate.answer.normal_force > 0, self.x)
            return
        resting = self.iteration.rest(self.problem)
        if resting is not None:
            self.x, self.closed = resting
            self.residual = self.problem.load.copy()
            return
        run = self.iteration.run_without_rows(self.problem.load.copy())
        enough = FIRST**2 * run.square()
        while run.estimate() > enough and run.steps < STEPS and self.steps_left() > 0 and self._step(run):
            pass
        self.iteration.learn(run)
        self.x, self.residual = run.x.copy(), run.residual.copy()
        self.before, self.residual_before = run.x, run.residual
        self.closed = self._penetration() > 0

    def _loaded(self, candidate: Candidate) -> bool:
        """Return whether the load exceeds the rounding of the forces of the known displacement."""
        scale, norm = 1 / np.sqrt(self.iteration.diagonal), self.iteration.norm
        taken = norm(scale * self.iteration.product(candidate.answer.displacement))
        return norm(scale * self.problem.load) > UNLOADED * taken

    def run(self) -> Candidate:
        sets = 0
        while True:
            sets += 1
            self.sizes.append(self.iteration.count(self.closed))
            tell(f"contact set {sets}: {self.sizes[-1]} closed")
            mark = self.iteration.mark(self.closed)
            if mark in self.seen:
                self.trust *= TIGHTER
            self.seen.add(mark)
            stopped = self._solve_on_set()
            if not stopped and (sets >= self.sets_left or self.trust < LEAST_TRUST):
                disagree = self.iteration.count(self.tension | self.penetrated)
                stopped = f"no contact set was found; {disagree} contacts disagree"
            if not stopped and self.identifies and self._turns():
                self._last_step = self.iteration.krylov_iterations
                stopped = f"sets of {self.sizes[-2]} and {self.sizes[-1]} contacts alternate"
            if stopped:
                return self._candidate(sets, stopped)
            self.closed = self.iteration.supported(self.problem, self._following(), self.x)

    def _turns(self) -> bool:
        """Return whether sets alternately grow and shrink, as with coupled rows of many unknowns."""
        changes = np.sign(np.diff(self.sizes))
        changes = changes[changes != 0]
        turns = np.count_nonzero(changes[1:] != changes[:-1])
        return bool(turns >= TURNS and turns >= OFTEN * len(self.sizes))

    def _following(self) -> Mask:
        """Return the next set by the signs; a set that keeps shrinking opens twice as many layers each time.

        After the first overshoot the number of layers is halved and limited.
        """
        iteration = self.iteration
        if iteration.any(self.penetrated):
            if self.layers > 1:
                self.most_layers = max(1, self.layers // 2)
            self.shrunk, self.layers = 0, 1
        else:
            self.shrunk += 1
            self.layers = min(2 * self.layers, self.most_layers) if self.shrunk > SINGLE_LAYERS else 1
        opened = self.tension
        while self.layers > 1:
            opened = iteration.around(self.tension, self.layers - 1) & self.closed
            if 2 * iteration.count(opened) <= iteration.count(self.closed):
                break
            opened, self.layers = self.tension, self.layers // 2
        return self.closed & ~opened | self.penetrated

    def _candidate(self, sets: int, stopped: str) -> Candidate:
        """Return the last iterate as a candidate; where the set was found, tension within the tolerance is removed."""
        force = self.force
        if stopped == FOUND:
            force = np.where(np.arange(len(force)) < self.m, np.maximum(force, 0.0), force)
            force = balanced_forces(self.problem, self.x, force, self.iteration)
        return Candidate(
            Answer(self.x, force[: self.m], None, force[self.m :]),
            iterations=sets,
            claimed=stopped == FOUND,
            status=stopped,
            history=tuple(self.history),
        )

    def _solve_on_set(self) -> str:
        """Iterate until the set is contradicted (""), the answer is accurate enough (FOUND), or return another reason
        to end.
        """
        on_set, held, run = self._start_on_set()
        stopped = self._steps_on_set(run, held, on_set)
        held.close(self.x)  # corrects rounding of closed gaps
        self.iteration.learn(run)
        return stopped

    def _start_on_set(self) -> tuple[Indices, ConstrainedRows, ConjugateGradients]:
        on_set = np.concatenate([np.flatnonzero(self.closed), np.arange(self.m, len(self.limit))])
        held = self.iteration.held(on_set, self.limit[on_set])
        self.iteration.close(held, self.x, self.residual)
        return on_set, held, self.iteration.run(self.x, self.residual, on_set, held)

    def _steps_on_set(self, run: ConjugateGradients, held: ConstrainedRows, on_set: Indices) -> str:
        goal: _Goal | None = None
        while True:
            self._look(run, held, on_set)
            contradicted = self.iteration.any(self.tension | self.penetrated)
            error = run.estimate()
            if contradicted:
                if run.steps and error <= self.trust**2 * self.history[-1] ** 2:
                    return ""
            elif self.identifies:
                if run.steps and error <= self.identified**2 * self._work(run):
                    return FOUND
            elif error <= SIGNS_SETTLED**2 * self._work(run):
                goal = goal or _Goal(self)
                if goal.reached(run):
                    return FOUND
            if self.iteration.any(time.perf_counter() > self.end):
                return "the time limit is reached"
            if run.steps >= STEPS or self.steps_left() <= 0:
                return f"conjugate gradients did not converge in {run.steps} steps"
            if not self._step(run):
                if contradicted:
                    return ""
                return FOUND  # no search direction, so the residual is rounding or the certificate refuses

    def steps_left(self) -> int:
        """Return the remaining number of steps of conjugate gradients."""
        return self._last_step - self.iteration.krylov_iterations

    def _step(self, run: ConjugateGradients) -> bool:
        self.iteration.krylov_iterations += 1
        return run.step()

    def _work(self, run: ConjugateGradients) -> float:
        """Return x'K x, twice the strain energy."""
        return self.iteration.dot(self.x, self.problem.load - run.residual)

    def _energy_norm(self, run: ConjugateGradients) -> float:
        """Return the energy norm |x|_K of the displacement."""
        return float(np.sqrt(max(self._work(run), 0.0)))

    def _penetration(self) -> Vector:
        return np.asarray((self.iteration.lengths(self.x) - self.limit)[: self.m])

    def _look(self, run: ConjugateGradients, held: ConstrainedRows, on_set: Indices) -> None:
        """Form the forces, and find the contacts whose sign contradicts the set by more than the tolerance allows."""
        self.force = np.zeros(len(self.limit))
        self.force[on_set] = held.forces(run.residual)
        m, allowed, strained = self.m, SIGN * self.tolerance, self.iteration.elastic(self.x)
        pull = self.iteration.force_measure(self.force, strained, self.problem.load)[:m]
        compliance, least = self.iteration.own_compliance[:m], ZERO_BY_ENERGY * self._energy_norm(run)
        pulling = -self.force[:m] * np.sqrt(compliance) > least
        self.tension = pulling & (pull > allowed)
        depth, lengths = self._penetration(), (self.iteration.length_sizes(strained) + abs(self.limit))[:m]
        self.penetrated = ~self.closed & (depth > np.maximum(allowed * lengths, least * np.sqrt(compliance)))
        pulled = np.where(self.tension, self.force[:m] * np.sqrt(compliance), 0.0)
        sunk = np.where(self.penetrated, depth, 0.0) / np.sqrt(np.where(self.penetrated, compliance, 1.0))
        self.history.append(float(np.hypot(self.iteration.norm(pulled), self.iteration.norm(sunk))))


class _Goal:
    """The required accuracy of the answer on a set; sizes are computed once, when the signs first agree with the
    set.
    """

    def __init__(self, search: _Search) -> None:
        iteration = search.iteration
        inner, outer = iteration.product_sizes(iteration.elastic(search.x)), iteration.force_sizes(search.force)
        self.sizes = inner + abs(search.problem.load) + outer
        self.equilibrium = EQUILIBRIUM * search.tolerance
        self.size = _size(search)
        self.nothing = ZERO_BY_ENERGY * _strain(search) * np.sqrt(iteration.diagonal)
        self.energy = search.energy * self.size
        self.iteration, self.on_set = (
            iteration,
            np.append(search.closed, np.ones(len(search.limit) - search.m, dtype=bool)),
        )

    def reached(self, run: ConjugateGradients) -> bool:
        error = run.estimate()
        left = ratio(beyond(abs(run.unbalanced), self.nothing), self.sizes)
        if not self.iteration.any(left > ROUNDING_OF_RESIDUALS):
            return True
        if error > self.iteration.least_eigenvalue * self.energy**2:
            return False
        if self.iteration.any(left > self.equilibrium):
            return False
        # The bounds allow contacts to open, where the residual of a body held by them has more energy.
        self.iteration.learn(run)
        share = np.where(self.on_set, self.iteration.own_compliance, 1.0)
        forces = self.iteration.balanced(run.unbalanced, np.where(self.on_set, 1 / share, 0.0))
        weight = dual_norm(self.iteration, run.unbalanced - self.iteration.forces(forces), learned=True)
        if weight <= BOUND * self.size:
            return True
        self.energy *= min(0.5, BOUND * self.size / weight)
        return False


def _size(search: _Search) -> float:
    """Return a lower bound of |l|_W, or |x|_K where there are no forces."""
    iteration, force = search.iteration, search.force
    if not iteration.any(force != 0):
        return _strain(search)
    if search.before is None:
        return force_norm(np.where(np.arange(len(force)) < search.m, force, 0.0), search.m, iteration) or _strain(
            search
        )
    # |l|_W >= l'E v / |v|_K for any v, nearly equal if v is the difference to the displacement without contact.
    back = search.before - search.x
    energy = iteration.dot(back, search.residual - search.residual_before)
    return abs(iteration.dot(force, iteration.lengths(back))) / np.sqrt(energy) if energy > 0 else 0.0


def _strain(search: _Search) -> float:
    """Return the energy norm |x|_K of the displacement that a search has."""
    return float(np.sqrt(max(search.iteration.dot(search.x, search.problem.load - search.residual), 0.0)))


FOUND = "signs and equilibrium hold"
