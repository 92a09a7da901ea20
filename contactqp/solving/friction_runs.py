"""Solve problems with Coulomb friction by the requested algorithm, or by the first that finds an answer.

Components along rigid motions that no contact, friction or tie of the answer resists are removed, and forces of
rounding size are set to zero. The associated relaxation is also available, but its answer is never presented as
Coulomb's.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.certificate import holds, holds_by_products
from contactqp.certificate.coulomb_law import rounded_slips
from contactqp.errors import InvalidProblem, NoEquilibrium, NotConverged, SeveralEquilibria, Unsupported, shown
from contactqp.linalg import pardiso
from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.convexity import refuse_indefinite_by_iteration
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.linalg.existence import refuse_conflict, refuse_driven_motion
from contactqp.linalg.factorization import right_singular
from contactqp.linalg.floating import UNRESISTED
from contactqp.linalg.friction_states import answer_in
from contactqp.linalg.iterated_states import FrictionRows
from contactqp.linalg.iteration import Systems, frictional_iteration, iterated
from contactqp.linalg.measures import forces_that_meet, lengths, row_sizes
from contactqp.model.arrays import Array, all_finite, on_one_thread, time_is_up
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status, slips
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate, Final, Work
from contactqp.solving.friction.algorithms import ALGORITHMS, TAKEN, Algorithm
from contactqp.solving.friction.associated import associated_answer
from contactqp.solving.friction.by_iteration import solve_friction_by_iteration
from contactqp.solving.friction.contact_form import solve_on_contacts
from contactqp.solving.friction.enumeration import MOST_CONTACTS, all_equilibria
from contactqp.solving.friction.exact_enumeration import (
    MOST_PROVEN,
    MOST_UNKNOWNS,
    NONE_AT_ALL,
    NONE_IN_FLOATS,
    SEVERAL,
    refuse_parts_without_equilibrium,
    rounded_equilibria,
)
from contactqp.solving.friction.force_system import CombinationAnswer, ForceSystem, Lengths
from contactqp.solving.friction.newton import refined, solve_sparse_newton
from contactqp.solving.friction.tresca import tresca_on_bodies
from contactqp.solving.methods import DEFAULT_METHOD, Method, Settings, algorithm_name, find
from contactqp.solving.runs import Meter, Run, RunByIteration, described


def free_motions(problem: ContactProblem, condensation: Condensation, answer: Answer) -> Array:
    """Return an orthonormal basis (n, q) of the rigid motions that displace no contact with force and no tie."""
    if not condensation.rigid.count:
        return condensation.rigid.motions
    basis = condensation.rigid.basis
    if problem.tangent is None or problem.friction is None:
        return basis
    pushes = answer.normal_force > 0
    rows = sp.vstack(
        [
            problem.normal[pushes],
            problem.tangent[np.repeat(pushes & (problem.friction > 0), problem.tangent.shape[0] // problem.contacts)],
            problem.tie,
        ]
    )
    if not rows.shape[0]:
        return basis
    size = np.max(abs(rows) @ abs(basis), axis=1, initial=0.0)
    values, rotation = right_singular((rows @ basis) / np.where(size > 0, size, 1.0)[:, None])
    return np.asarray(basis @ rotation[int(np.sum(values > UNRESISTED)) :].T)


def at_rest(problem: ContactProblem, condensation: Condensation, answer: Answer, free: Array) -> Answer:
    """Return the answer of least norm along free motions that the gaps of open contacts admit.

    The rounding errors of the removed motion are eliminated by refinement.

    Parameters
    ----------
    problem, condensation : ContactProblem, Condensation
    answer : Answer
    free : (n, q) array, an orthonormal basis of the free motions; q may be 0
    """
    if not free.shape[1]:
        return answer
    u = answer.displacement
    resting = replace(answer, displacement=u - free @ (free.T @ u))
    rows = condensed_frictional_rows(problem, condensation)
    for found in (answer_in(problem, condensation, rows, _combination(problem, answer), resting), resting):
        if holds(problem, found):
            return found
    return answer


def _combination(problem: ContactProblem, answer: Answer) -> Status:
    """Return the states of an answer (m,): open without a force, sticking where the slip is rounding, else sliding.

    A slip in the direction of its friction is a rounding error and counts as stick.
    """
    slip = slips(problem, answer.displacement)
    assert slip is not None
    assert problem.slip_origin is not None
    assert answer.friction_force is not None
    moved = row_sizes(problem, problem.tangent).lengths(abs(answer.displacement))
    rounding = rounded_slips(moved, problem.slip_origin)
    sliding = np.where(slip[:, 0] < 0, SLIP_BACK, SLIP_ON) if slip.shape[1] == 1 else np.full(len(slip), SLIP_ON)
    driven = np.sum(slip * answer.friction_force.reshape(slip.shape), axis=1) < 0
    closed = np.where(driven | (lengths(slip) <= rounding), STICK, sliding)
    return np.where(answer.normal_force > 0, closed, OPEN).astype(np.int8)


# Contact forces below this part of the forces that meet there are rounding errors of a nearly singular stiffness.
NOISE = 1e-15


def without_negligible_forces(problem: ContactProblem, answer: Answer) -> Answer:
    """Return the answer without contact forces of rounding size, if it remains an equilibrium."""
    force = answer.normal_force
    heard = row_sizes(problem, problem.normal).measure(force, forces_that_meet(problem, answer)) > NOISE
    if np.all(heard | (force == 0)) or answer.friction_force is None:
        return answer
    friction = np.where(heard[:, None], answer.friction_force, 0.0)
    quiet = replace(answer, normal_force=np.where(heard, force, 0.0), friction_force=friction)
    return quiet if holds(problem, quiet) else answer


_FACTORISE = "factorise: CONTACTQP_SPARSE_SOLVER=pardiso (pip install pypardiso) or superlu"
# The relative error in energy required of an iteration, as by the certificate.
ENERGY = 1e-10


# The convex method of runs whose algorithms refine their answers and do not use it.
REFINED = find(DEFAULT_METHOD)


class FrictionRun(Run):
    """One answer to a frictional problem, refined to the last digits by the algorithm that found it.

    Parameters
    ----------
    problem : ContactProblem
    answer : Answer, what the algorithm found
    name : str, the algorithm, and the convex method where it takes steps of one
    meter : the counter of the cost so far
    history : tuple of float, the algorithm's own measure of progress, one number an iteration
    iterations : the iterations of the algorithm; by default one more than the history has
    exact : bool, whether the algorithm promises Coulomb's answer; the associated relaxation does not
    condensation : Condensation, that of the problem; formed where it is needed if none is given
    """

    def __init__(
        self,
        problem: ContactProblem,
        answer: Answer,
        name: str,
        meter: Meter | None = None,
        history: tuple[float, ...] = (),
        iterations: int | None = None,
        exact: bool = True,
        condensation: Condensation | None = None,
    ) -> None:
        super().__init__(problem, REFINED)
        self.name, self.exact, self._answer, self._condensation = name, exact, answer, condensation
        self.meter = meter or self.meter
        steps = len(history) + 1 if iterations is None else iterations
        self.candidate = Candidate(replace(answer, friction_force=None), iterations=steps, history=history)

    def final(self) -> Final:
        """Return the answer to be certified, that of its combination of open, stick and slip; unfinished as it is."""
        if not self.candidate.claimed:
            return Final(self._answer)
        condensation = self._condensation or condense(self.problem)
        free = free_motions(self.problem, condensation, self._answer)
        answer = without_negligible_forces(self.problem, at_rest(self.problem, condensation, self._answer, free))
        return Final(answer, free_motions=described(self.problem, free))

    def refuse_conflict(self) -> None:
        """Do nothing: conflicting constraints were refused before an answer was found."""


class SparseFrictionRun(FrictionRun):
    """The answer to a problem in the plane whose contacts are many, found and refined in sparse systems.

    Raises NotConverged as `solve_sparse_newton` does.
    """

    def __init__(self, problem: ContactProblem, settings: Settings) -> None:
        with on_one_thread():  # nothing dense here is large
            found = solve_sparse_newton(problem, settings)
        super().__init__(problem, found.answer, "newton", iterations=found.steps)
        self._found = found
        if found.late:
            self.candidate = replace(self.candidate, claimed=False, status=found.late)

    def final(self) -> Final:
        """Return the answer as it was found: no body floats, and noise has been removed."""
        return Final(self._found.answer)

    def work(self, corrections: int) -> Work:
        """Return what the answer has cost; combinations that differ in few contacts share a factorisation."""
        return Work(
            factorisations=self._found.factorisations,
            back_substitutions=self._found.back_substitutions,
            iterations=self._found.steps,
            retained=self.problem.dimension,
            polish_corrections=corrections,
            solver="pardiso" if pardiso.available() else "superlu",
        )


class IteratedFrictionRun(RunByIteration):
    """Coulomb's answer on a body too large to factorise, by Tresca's fixed point and Newton's method.

    Raises NotConverged, NoEquilibrium as `solve_friction_by_iteration` does; Unsupported: another method than the
    active set.
    """

    def __init__(self, problem: ContactProblem, method: Method, settings: Settings) -> None:
        super().__init__(problem, method, frictional_iteration)
        self.name = algorithm_name("tresca", method.name)
        refuse_indefinite_by_iteration(problem, self.iteration)
        refuse_driven_motion(problem, self.iteration.rigid)
        start = _known_answer(problem, settings.warm_start)
        certifiable = partial(holds_by_products, problem, self.iteration.rigid)
        with on_one_thread():  # nothing dense here is large
            self.candidate = solve_friction_by_iteration(
                problem, self.iteration, settings.now, start, ENERGY, certifiable
            )

    def final(self) -> Final:
        """Return the candidate with its free motions at rest, which is the answer that is to be certified."""
        answer, free = self.candidate.answer, self.iteration.rigid.motions
        if free.shape[1]:
            rows = FrictionRows(self.problem, self.iteration)
            u, free = rows.at_rest(answer.displacement, answer.normal_force)
            answer = replace(answer, displacement=u)
        return Final(answer, described(self.problem, free))


def _known_answer(problem: ContactProblem, found: Candidate | None) -> Answer | None:
    """Return a warm start as an answer, or None if it has no friction forces."""
    if found is None or found.answer.friction_force is None or not all_finite(found.answer):
        return None
    return replace(found.answer, friction_force=found.answer.friction_force.reshape(problem.contacts, -1))


# The number of contacts up to which trying all combinations is cheaper than long attempts of algorithms.
FEW_CONTACTS = 3
# The most Tresca problems (three to eight usually suffice) before other algorithms are tried for few contacts.
STEPS_BEFORE_LISTING = 20
# The entry of Tresca's fixed point as part of the default sequence.
TRESCA_AT_ONCE = replace(ALGORITHMS["tresca"], on_bodies=partial(tresca_on_bodies, at_once=True))


def refuse_unknown_algorithm(algorithm: str | None) -> None:
    """Raise InvalidProblem if no algorithm of friction has this name; None stands for any."""
    if algorithm is not None and algorithm not in (*ALGORITHMS, *TAKEN):
        names = ", ".join((*ALGORITHMS, *TAKEN))
        raise InvalidProblem(f"algorithm: expected one of {names} or None, got {shown(algorithm)}")


def run_friction(
    problem: ContactProblem, method: Method, settings: Settings, systems: Systems, algorithm: str | None
) -> Run:
    """Find an answer with Coulomb friction, by one algorithm or by one after another until one succeeds.

    Parameters
    ----------
    problem, method, settings : ContactProblem, Method, Settings
    systems : Systems
        Those that cost the problem least.
    algorithm : str or None
        None stands, on bodies that are iterated on, for Tresca's and Newton's method by iteration; else, in the plane,
        Newton's method in sparse systems where contacts are many, else from `settings.warm_start` if there is one, then
        Tresca's fixed point, then the algorithms of the local form, then enumeration where contacts are few; in space
        the algorithms of the local form, by steps of `method` where that is not the default.

    Raises
    ------
    NoEquilibrium
        The constraints conflict, the load drives a motion that nothing holds, or no combination of open, stick and slip
        is an equilibrium, proven in rational numbers.
    SeveralEquilibria
        Enumeration was asked for and finds more than one.
    NotConverged, BackendFailed
        The algorithm, or the convex method in it, gave up.
    Unsupported
        Bodies too large to factorise, a method that is approximate by design or needs a regular stiffness,
        enumeration in space or of too many contacts.
    """
    if systems is Systems.ITERATED:
        if algorithm not in (None, "tresca"):
            raise Unsupported(
                f"friction: a body this large is not factorised, and without factors there is 'tresca' alone, got "
                f"{algorithm!r}; {_FACTORISE}"
            )
        return IteratedFrictionRun(problem, method, settings)
    if algorithm in (None, "newton") and method.name == DEFAULT_METHOD and systems is Systems.SPARSE:
        with suppress(NotConverged):
            return SparseFrictionRun(problem, settings)
    meter = Meter(problem)
    with meter.running():
        condensation = condense(problem)
        if condensation.rigid.count:
            refuse_driven_motion(problem, condensation.rigid)
        if algorithm == "associated":
            answer, name = associated_answer(problem, condensation, method, settings)
            return FrictionRun(problem, answer, name, meter, exact=False, condensation=condensation)
        if algorithm == "enumeration":
            return _only(problem, condensation)
        if algorithm is None or ALGORITHMS[algorithm].convex:
            _refuse_method(method)
        if algorithm is not None:
            return _by(ALGORITHMS[algorithm], problem, condensation, method, settings, meter)
        if _in_space(problem):
            convex = ALGORITHMS["aclm"] if method.name != DEFAULT_METHOD else None
            return _by(convex, problem, condensation, method, settings, meter)
        return _by_any(problem, condensation, method, settings, meter)


def _by_any(
    problem: ContactProblem, condensation: Condensation, method: Method, settings: Settings, meter: Meter
) -> FrictionRun:
    """Return the first answer found in the plane, by Newton's method from a start, else by the other algorithms."""
    if settings.warm_start is not None:
        with suppress(NotConverged):
            return _by(ALGORITHMS["newton"], problem, condensation, method, settings, meter)
    few = problem.contacts <= FEW_CONTACTS
    steps = settings
    if settings.max_iter is None and problem.contacts <= MOST_CONTACTS:
        steps = replace(settings, max_iter=STEPS_BEFORE_LISTING)
    try:
        return _by(TRESCA_AT_ONCE, problem, condensation, method, steps, meter)
    except NotConverged as error:
        if time_is_up():
            raise
        if few:
            with suppress(NotConverged):
                return _listed(problem, condensation)[0]
        with suppress(NotConverged):
            return _by(None, problem, condensation, method, settings, meter)
        if few or problem.contacts > MOST_CONTACTS or settings.max_iter is not None:
            raise error from None
        return _listed(problem, condensation, f"; {error}")[0]


def _by(
    algorithm: Algorithm | None,
    problem: ContactProblem,
    condensation: Condensation,
    method: Method,
    settings: Settings,
    meter: Meter,
) -> FrictionRun:
    """Return the answer of an algorithm, on the bodies if it can; for None, that of the default sequence on the local
    form.
    """
    settings = settings if settings.time_limit is None else settings.now
    try:
        if algorithm is not None and algorithm.on_bodies is not None and not _in_space(problem):
            found: Any = algorithm.on_bodies(problem, condensation, method, settings)
        else:
            name = None if algorithm is None else algorithm.name
            found = solve_on_contacts(problem, condensation, method, settings, name)
    except NotConverged as error:
        if isinstance(error.solution, Answer):  # what there was when the time was up
            steps, name = tuple(error.history), str(error).partition(":")[0]
            run = FrictionRun(problem, error.solution, name, meter, steps, len(steps))
            run.candidate = replace(run.candidate, claimed=False, status=str(error))
            run.finish()  # raises with the certified answer
        if not time_is_up():
            refuse_conflict(problem, condensation)
        raise
    return FrictionRun(
        problem, found.answer, found.name, meter, found.history, found.iterations, condensation=condensation
    )


def run_on_combination(
    problem: ContactProblem,
    system: ForceSystem,
    lengths: Lengths,
    found: CombinationAnswer,
    combinations: int,
    meter: Meter,
) -> FrictionRun:
    """Refine the answer of a combination found on the contact unknowns, without checking its signs.

    Parameters
    ----------
    problem, system, lengths, found : the problem, the systems of combinations, lengths and forces of this load
    combinations, meter : how many combinations were tried, and the counter of what the answer costs
    """
    with meter.running():
        answer = refined(problem, condense(problem), system, lengths, found)
    return FrictionRun(problem, answer, "newton", meter, iterations=combinations)


def found_by_enumeration(problem: ContactProblem) -> tuple[FrictionRun, ...]:
    """Find every equilibrium of a small problem, in rationals where floats find none.

    Raises Unsupported as `run_friction` does.
    """
    few = problem.contacts <= MOST_PROVEN and problem.dimension <= MOST_UNKNOWNS
    return _in_floats(problem) or (_that_hold(problem, rounded_equilibria(problem)) if few else ())


def _in_floats(problem: ContactProblem) -> tuple[FrictionRun, ...]:
    if iterated(problem):
        raise Unsupported(f"enumeration: a body this large is not factorised; {_FACTORISE}")
    if _in_space(problem):
        raise Unsupported("enumeration: two tangential rows a contact; slip directions in space cannot be listed")
    meter = Meter(problem)
    with meter.running():
        found = all_equilibria(problem, condense(problem))
    return tuple(FrictionRun(problem, one.answer, "enumeration", meter) for one in found)


def _that_hold(problem: ContactProblem, exact: list[Answer]) -> tuple[FrictionRun, ...]:
    """Return the equilibria that also satisfy the law in doubles, without those caused by rounding of a singular K."""
    return tuple(FrictionRun(problem, one, "enumeration") for one in exact if holds(problem, one))


def _in_rationals(problem: ContactProblem) -> tuple[FrictionRun, ...]:
    """Return the rational equilibria, rounded; raise NotConverged if none satisfies the law in doubles."""
    exact = rounded_equilibria(problem)
    found = _that_hold(problem, exact)
    if exact and not found:
        raise NotConverged(f"{NONE_IN_FLOATS}, and in rational numbers there is one: see contactqp.exact_equilibria")
    return found


def _listed(problem: ContactProblem, condensation: Condensation, tried: str = "") -> tuple[FrictionRun, ...]:
    """Return every equilibrium of a small problem; raise where there is none, with what was `tried` before."""
    found = _in_floats(problem)
    if not found:
        refuse_conflict(problem, condensation)
        if problem.contacts > MOST_PROVEN or problem.dimension > MOST_UNKNOWNS:
            refuse_parts_without_equilibrium(problem)
            within = f"up to {MOST_PROVEN} contacts and {MOST_UNKNOWNS} unknowns"
            raise NotConverged(f"{NONE_IN_FLOATS}; that there is none is proven in rational numbers {within}{tried}")
        if not (found := _in_rationals(problem)):
            raise NoEquilibrium(NONE_AT_ALL)
    return found


def _only(problem: ContactProblem, condensation: Condensation) -> FrictionRun:
    found = _listed(problem, condensation)
    if len(found) > 1:
        listed = "; ".join(_described(problem, one) for one in found)
        raise SeveralEquilibria(SEVERAL.format(len(found), listed))
    return found[0]


def _described(problem: ContactProblem, run: FrictionRun) -> str:
    forces = enumerate(run.candidate.answer.normal_force.tolist())
    return ", ".join(f"{problem.contact_name(i)}: l_N = {force:.6g}" for i, force in forces)


def _refuse_method(method: Method) -> None:
    if not method.exact:
        raise Unsupported(
            f"{method.name}: Coulomb friction takes exact convex steps, and this is approximate by design"
        )
    if not method.semidefinite:
        raise Unsupported(
            f"{method.name}: it needs a regular stiffness, and steps of Coulomb friction may have none; try active-set"
        )


def _in_space(problem: ContactProblem) -> bool:
    return problem.slip_origin is not None and problem.slip_origin.shape[1] > 1
