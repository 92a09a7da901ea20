"""An answer with Coulomb friction, by the algorithm asked for or by the first that finds one."""

from __future__ import annotations

from contextlib import suppress

from contactqp.errors import InvalidProblem, NoEquilibrium, NotConverged, SeveralEquilibria, Unsupported
from contactqp.linalg.condensation import condense
from contactqp.linalg.existence import refuse_conflict, refuse_driven_motion
from contactqp.linalg.iteration import iterated
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate, Final
from contactqp.model.verdicts import Answer
from contactqp.solving.associated_attempt import solve_associated
from contactqp.solving.condensed_attempt import described
from contactqp.solving.friction.combinations import MOST_CONTACTS
from contactqp.solving.friction.enumeration import all_equilibria
from contactqp.solving.friction.exact_enumeration import MOST_PROVEN, MOST_UNKNOWNS, exact_equilibria
from contactqp.solving.friction.force_system import CombinationAnswer, ForceSystem, Lengths
from contactqp.solving.friction.free_motion import at_rest, free_motions, without_noise
from contactqp.solving.friction.local_algorithms import ALGORITHMS, TAKEN
from contactqp.solving.friction.newton import refined, solve_newton
from contactqp.solving.friction.on_contacts import solve_on_contacts
from contactqp.solving.friction.tresca import solve_tresca
from contactqp.solving.metering import Meter, MeteredAttempt
from contactqp.solving.methods import Method, Settings
from contactqp.solving.whole_attempt import WholeAttempt

# Of bodies, in the order in which they are listed; those that are registered follow.
NAMES = ("tresca", "aclm", "newton", "nsgs", "ppa", "admm", *TAKEN)
DEFAULT_METHOD = "active-set"


class FrictionAttempt(WholeAttempt, MeteredAttempt):
    """One answer to a frictional problem, refined to the last digits by the algorithm that found it."""

    exact = True  # whether the algorithm promises Coulomb's answer

    def __init__(
        self,
        problem: ContactProblem,
        answer: Answer,
        meter: Meter,
        name: str,
        history: tuple[float, ...] = (),
        iterations: int | None = None,
    ) -> None:
        self.name = name  # the algorithm, and the convex method where it has one
        self._problem, self._answer, self._meter = problem, answer, meter
        steps = len(history) + 1 if iterations is None else iterations
        self.candidate = Candidate(
            answer.displacement, answer.normal_force, answer.tie_force, iterations=steps, history=history
        )

    def final(self, polished: bool) -> Final:
        """The answer that is to be certified: as it was found, on its combination of open, stick and slip."""
        del polished
        way = condense(self._problem)
        free = free_motions(self._problem, way, self._answer)
        answer = without_noise(self._problem, at_rest(self._problem, way, self._answer, free))
        return Final(
            answer.displacement,
            answer.normal_force,
            answer.tie_force,
            free_motions=described(self._problem, free),
            friction_force=answer.friction_force,
        )

    def refuse_conflict(self) -> None:
        """Constraints that conflict get no answer this far."""


class AssociatedAttempt(FrictionAttempt):
    """The answer to the associated relaxation, which is Coulomb's only where nothing slides."""

    exact = False


def attempt_friction(
    problem: ContactProblem, method: Method, settings: Settings, algorithm: str | None
) -> FrictionAttempt:
    """An answer by `algorithm`. None is, in the plane, Newton's method from `settings.warm_start` if there is one, then
    Tresca's fixed point, then the algorithms of the local form, then enumeration where contacts are few; in space the
    algorithms of the local form, by steps of `method` where that is not the default.

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
    InvalidProblem
        There is no such algorithm.
    """
    if algorithm is not None and algorithm not in (*NAMES, *ALGORITHMS):
        known = ", ".join(dict.fromkeys((*NAMES, *ALGORITHMS)))
        raise InvalidProblem(f"algorithm: expected one of {known} or None, got {algorithm!r}")
    _refuse_iterated(problem)
    meter = Meter(problem)
    with meter.running():
        refuse_driven_motion(problem, condense(problem))
    if algorithm == "associated":
        return _relaxed(problem, method, settings, meter)
    if algorithm == "enumeration":
        return _only(problem)
    if algorithm is None or ALGORITHMS[algorithm].convex:
        _refuse_method(method)
    if _in_space(problem) or algorithm not in (None, "tresca", "newton"):
        convex = algorithm is None and method.name != DEFAULT_METHOD
        return _on_contacts(problem, method, settings, meter, "aclm" if convex else algorithm)
    try:
        if algorithm == "newton":
            return _by_newton(problem, settings, meter)
        if algorithm == "tresca":
            return _by_tresca(problem, method, settings, meter)
    except NotConverged:
        refuse_conflict(problem, condense(problem))
        raise
    return _by_any(problem, method, settings, meter)


def _by_any(problem: ContactProblem, method: Method, settings: Settings, meter: Meter) -> FrictionAttempt:
    if settings.warm_start is not None:
        with suppress(NotConverged):
            return _by_newton(problem, settings, meter)
    try:
        return _by_tresca(problem, method, settings, meter)
    except NotConverged as error:
        refuse_conflict(problem, condense(problem))
        with suppress(NotConverged):
            return _on_contacts(problem, method, settings, meter, None)
        if problem.contacts > MOST_CONTACTS:
            raise error from None
    return _listed(problem)[0]


def _on_contacts(
    problem: ContactProblem, method: Method, settings: Settings, meter: Meter, algorithm: str | None
) -> FrictionAttempt:
    with meter.running():
        try:
            found = solve_on_contacts(problem, condense(problem), method, settings, algorithm)
        except NotConverged:
            refuse_conflict(problem, condense(problem))
            raise
    return FrictionAttempt(problem, found.answer, meter, found.name, found.history, found.iterations)


def attempt_on(
    problem: ContactProblem,
    system: ForceSystem,
    lengths: Lengths,
    found: CombinationAnswer,
    combinations: int,
    meter: Meter,
) -> FrictionAttempt:
    """The answer of a combination that was found on the contact unknowns, refined; nobody has seen its signs."""
    with meter.running():
        answer = refined(problem, condense(problem), system, lengths, found)
    return FrictionAttempt(problem, answer, meter, "newton", iterations=combinations)


def attempt_with(problem: ContactProblem, answer: Answer, name: str) -> FrictionAttempt:
    """An answer that is known."""
    return FrictionAttempt(problem, answer, Meter(problem), name, iterations=0)


def found_by_enumeration(problem: ContactProblem) -> tuple[FrictionAttempt, ...]:
    """Every equilibrium of a small problem.

    Raises
    ------
    Unsupported
        As `attempt_friction`.
    """
    _refuse_iterated(problem)
    if _in_space(problem):
        raise Unsupported("enumeration: two tangential rows a contact; slip directions in space cannot be listed")
    meter = Meter(problem)
    with meter.running():
        found = all_equilibria(problem, condense(problem))
    return tuple(FrictionAttempt(problem, one.answer, meter, "enumeration") for one in found)


def _listed(problem: ContactProblem) -> tuple[FrictionAttempt, ...]:
    """Every equilibrium of a small problem, at least one."""
    found = found_by_enumeration(problem)
    if not found:
        refuse_conflict(problem, condense(problem))
        _refuse_unproven(problem)
        raise NoEquilibrium(
            "enumeration: no combination of open, stick and slip is an equilibrium, proven in rational numbers"
        )
    return found


def _only(problem: ContactProblem) -> FrictionAttempt:
    found = _listed(problem)
    if len(found) > 1:
        listed = "; ".join(_described(problem, one) for one in found)
        raise SeveralEquilibria(
            f"enumeration: {len(found)} equilibria, and nothing in the problem chooses ({listed}); "
            "contactqp.equilibria(problem) returns them all"
        )
    return found[0]


def _refuse_unproven(problem: ContactProblem) -> None:
    """Raise NotConverged unless no combination is an equilibrium in rational numbers either."""
    none = "enumeration: floats found no combination of open, stick and slip that is an equilibrium"
    if problem.contacts > MOST_PROVEN or problem.dimension > MOST_UNKNOWNS:
        raise NotConverged(
            f"{none}; that there is none is proven in rational numbers up to {MOST_PROVEN} contacts and "
            f"{MOST_UNKNOWNS} unknowns"
        )
    if exact_equilibria(problem):
        raise NotConverged(f"{none}, and in rational numbers there is one: contactqp.exact_equilibria lists them")


def _described(problem: ContactProblem, attempt: FrictionAttempt) -> str:
    forces = attempt.candidate.normal_force
    return ", ".join(f"{problem.contact_name(i)}: l_N = {force:.6g}" for i, force in enumerate(forces.tolist()))


def _by_newton(problem: ContactProblem, settings: Settings, meter: Meter) -> FrictionAttempt:
    with meter.running():
        found = solve_newton(
            problem, condense(problem), settings.warm_start, settings.max_iter, time_limit=settings.time_limit
        )
    return FrictionAttempt(problem, found.answer, meter, "newton", iterations=found.steps)


def _refuse_method(method: Method) -> None:
    if not method.exact:
        raise Unsupported(
            f"{method.name}: Coulomb friction takes exact convex steps, and this is approximate by design"
        )
    if not method.semidefinite:
        raise Unsupported(
            f"{method.name}: the convex steps of Coulomb friction have a singular stiffness; try active-set"
        )


def _by_tresca(problem: ContactProblem, method: Method, settings: Settings, meter: Meter) -> FrictionAttempt:
    with meter.running():
        found = solve_tresca(problem, condense(problem), method, settings)
    return FrictionAttempt(problem, found.answer, meter, f"tresca with {method.name}", found.changes)


def _relaxed(problem: ContactProblem, method: Method, settings: Settings, meter: Meter) -> AssociatedAttempt:
    with meter.running():
        answer, name = solve_associated(problem, method, settings)
    return AssociatedAttempt(problem, answer, meter, name)


def _in_space(problem: ContactProblem) -> bool:
    return problem.slip_origin is not None and problem.slip_origin.shape[1] > 1


def _refuse_iterated(problem: ContactProblem) -> None:
    if iterated(problem):
        raise Unsupported("friction: a body this large is not factorised, and Coulomb friction is not iterated on")
