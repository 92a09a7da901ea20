"""The primal-dual active set by conjugate gradients, inexact: for bodies too large to factorise.

On the contacts A that are closed, with all ties, conjugate gradients approach K u = f - E_A'l_A, E_A u = g_A; forces
come from the residual r = f - K u, l_A = (E_A D^-1 E_A')^-1 E_A D^-1 r. After each step the forces l and the gaps of
the moment say which contacts they would close and open (Hintermueller, Ito and Kunisch 2003): those with
l_i + (E u - g)_i / (E_i D^-1 E_i') > 0. What contradicts the set has the energy

    delta^2 = sum of (E_i D^-1 E_i') l_i^2 over tensions + sum of (E u - g)_i^2 / (E_i D^-1 E_i') over penetrations,

and the set is changed as soon as the error r'M r of the displacement on it is not larger than that: what a system of
an early set is solved to is not better than the set. Only the last set is solved to the end.
"""

from __future__ import annotations

import time

import numpy as np

from contactqp.certificate.multigrid_bounds import balanced_forces, dual_norm, force_norm
from contactqp.linalg.contact_iteration import ContactIteration, Limits
from contactqp.linalg.krylov import ConjugateGradients, ConstrainedRows
from contactqp.linalg.measures import beyond, ratio
from contactqp.model.arrays import EPS, Indices, Mask, Vector, tell
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods.method import Settings

# The bodies without contact are solved to this part of their energy norm: the first set comes from them.
FIRST = 0.3
# A set is changed when the error on it is this part of what contradicts it; less where sets come back.
TRUST, TIGHTER, LEAST_TRUST = 3.0, 0.1, 1e-6
# Changes of the set, and steps on one of them, before the method gives up.
SETS, STEPS = 200, 2000
# A set that has shrunk so many times does so by more than one layer of contacts, of so many at most.
SINGLE_LAYERS, MOST_LAYERS = 2, 64
# Of the tolerance, on the equilibrium of the last set; and what forces and gaps of the wrong sign may be of it.
EQUILIBRIUM, SIGN = 0.7, 0.1
TIGHTEST = 1e-13
# What is left of the forces that meet at an unknown when their rounding is all that is left.
ROUNDING_OF_RESIDUALS = 4 * EPS
# What the certificate asks of the equilibrium, whatever the method is asked for.
LOOSEST = 1e-9
# A load of this part of what the known displacement takes is none beside the rounding of that: start from rest.
UNLOADED = 1e-4
# An error in energy larger than this, of the energy of the displacement, is not worth a closer look.
SETTLED = 1e-4
# A set that another method goes on from, which changes what is still wrong of it: the error in energy on it, of the
# energy of the displacement, and steps in all (on membranes of a million nodes it takes 45), beyond which a hierarchy
# is taken to be of no use.
IDENTIFIED, IDENTIFYING_STEPS = 1e-3, 150
# It is of no use, either, where sets grow and shrink in turn: so often, and in so many of them. Of bodies and membranes
# sets turn up to six times, and in one of three.
TURNS, OFTEN = 10, 0.42
# Forces and lengths of this part of the energy norm of the displacement are nothing
# (`contactqp.linalg.measures`): a tenth of what the certificate takes for nothing.
NOTHING = 1e-13
# Error in energy on the set, and its bound, of the energy of the contact forces (of the displacement without them): the
# certificate shall prove 1e-6.
ENERGY, BOUND = 1e-7, 3e-7


def solve_by_iteration(
    problem: Limits, iteration: ContactIteration, settings: Settings, energy: float = ENERGY
) -> Candidate:
    """Find displacement and forces on a set that their signs confirm; `claimed` is False where none was found.

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
    """Return a less accurate candidate, whose set another method starts from; None where the iteration takes too long.

    Parameters
    ----------
    problem, iteration, settings
        As in `solve_by_iteration`.
    error : the error in energy at which the set is taken, over the energy of the displacement
    """
    search = _Search(problem, iteration, settings, ENERGY, steps=IDENTIFYING_STEPS, identified=error)
    found = search.run() if search.steps_left() > 0 else None
    return found if search.steps_left() > 0 else None


class _Search:
    """The displacement of the moment, its set, and what it has cost."""

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
        """Return whether the load is more than rounding of what a known displacement takes."""
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
        """Return whether sets grow and shrink in turn, as where rows of many unknowns open and close each other."""
        changes = np.sign(np.diff(self.sizes))
        changes = changes[changes != 0]
        turns = np.count_nonzero(changes[1:] != changes[:-1])
        return bool(turns >= TURNS and turns >= OFTEN * len(self.sizes))

    def _following(self) -> Mask:
        """Return the set that the signs lead to; a set that keeps shrinking does so by layers that double.

        From the first that goes too far on, half as many at most.
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
        """Steps until the set is contradicted ("") or the answer is good enough (FOUND) or something else ends them."""
        on_set, held, run = self._start_on_set()
        stopped = self._steps_on_set(run, held, on_set)
        held.close(self.x)  # what rounding has opened on the way
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
            elif error <= SETTLED**2 * self._work(run):
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
                return FOUND  # nothing to go along: what is left is rounding, or else the certificate will tell

    def steps_left(self) -> int:
        """Steps of conjugate gradients that may still be taken."""
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
        compliance, least = self.iteration.own_compliance[:m], NOTHING * self._energy_norm(run)
        pulling = -self.force[:m] * np.sqrt(compliance) > least
        self.tension = pulling & (pull > allowed)
        depth, lengths = self._penetration(), (self.iteration.length_sizes(strained) + abs(self.limit))[:m]
        self.penetrated = ~self.closed & (depth > np.maximum(allowed * lengths, least * np.sqrt(compliance)))
        pulled = np.where(self.tension, self.force[:m] * np.sqrt(compliance), 0.0)
        sunk = np.where(self.penetrated, depth, 0.0) / np.sqrt(np.where(self.penetrated, compliance, 1.0))
        self.history.append(float(np.hypot(self.iteration.norm(pulled), self.iteration.norm(sunk))))


class _Goal:
    """How good the answer on a set has to be; sizes are taken once, when the set is first agreed with."""

    def __init__(self, search: _Search) -> None:
        iteration = search.iteration
        inner, outer = iteration.product_sizes(iteration.elastic(search.x)), iteration.force_sizes(search.force)
        self.sizes = inner + abs(search.problem.load) + outer
        self.equilibrium = EQUILIBRIUM * search.tolerance
        self.size = _size(search)
        self.nothing = NOTHING * _strain(search) * np.sqrt(iteration.diagonal)
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
        # The bounds let the contacts open: what is left may weigh far more then, on a body that they alone hold well.
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
    # |l|_W >= l'E v / |v|_K for any v: for the way back to the bodies without contact it is nearly equal.
    back = search.before - search.x
    energy = iteration.dot(back, search.residual - search.residual_before)
    return abs(iteration.dot(force, iteration.lengths(back))) / np.sqrt(energy) if energy > 0 else 0.0


def _strain(search: _Search) -> float:
    """Return the energy norm |x|_K of the displacement that a search has."""
    return float(np.sqrt(max(search.iteration.dot(search.x, search.problem.load - search.residual), 0.0)))


FOUND = "signs and equilibrium hold"
