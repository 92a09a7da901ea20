"""The table of the algorithms of Coulomb friction by name, their stopping criteria, and the default sequence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from contactqp.errors import BackendFailed, BackendMissing, InvalidProblem, NoEquilibrium, NotConverged, Unsupported
from contactqp.linalg.condensation import Condensation
from contactqp.model.arrays import stated_limit, tell, time_is_up
from contactqp.model.problem import ContactProblem
from contactqp.solving.friction.admm import admm
from contactqp.solving.friction.alart_curnier import ROUNDED, drawn_combinations, newton, proximal_points
from contactqp.solving.friction.convex_steps import ConvexSteps, cone_fixed_point, tresca_fixed_point
from contactqp.solving.friction.gauss_seidel import gauss_seidel
from contactqp.solving.friction.local_form import NEARER, Deadline, FoundOnBodies, Iterate, LocalForm
from contactqp.solving.friction.newton import solve_newton
from contactqp.solving.friction.tresca import tresca_on_bodies
from contactqp.solving.methods import Method, Settings, algorithm_name, find

Accepted = Callable[[Iterate], bool]


@dataclass(frozen=True)
class Algorithm:
    """One algorithm of Coulomb friction: `solve`, problems in local form and ranks of MPI read this table."""

    name: str
    iterates: Callable[[LocalForm, ConvexSteps | None, Iterate], Iterator[Iterate]]
    convex: bool  # takes steps of a convex method
    limit: int  # default limit of iterations
    patience: int  # iterates without progress before it is stopped
    about: str
    # The function that works on bodies in the plane, without a local form.
    on_bodies: Callable[[ContactProblem, Condensation, Method, Settings], FoundOnBodies] | None = None
    on_ranks: bool = False  # whether it runs on ranks of MPI


def _newton_only(form: LocalForm, steps: ConvexSteps | None, start: Iterate) -> Iterator[Iterate]:
    del steps
    yield newton(form, start)


def _with_steps(
    run: Callable[[LocalForm, ConvexSteps, Iterate], Iterator[Iterate]],
) -> Callable[[LocalForm, ConvexSteps | None, Iterate], Iterator[Iterate]]:
    def iterates(form: LocalForm, steps: ConvexSteps | None, start: Iterate) -> Iterator[Iterate]:
        if steps is None:
            raise ValueError("convex steps are needed")
        return run(form, steps, start)

    return iterates


def _newton_on_bodies(
    problem: ContactProblem, condensation: Condensation, method: Method, settings: Settings
) -> FoundOnBodies:
    del method
    found = solve_newton(problem, condensation, settings.warm_start, settings.max_iter)
    return FoundOnBodies(found.answer, "newton", iterations=found.steps)


ALGORITHMS = {
    algorithm.name: algorithm
    for algorithm in (
        Algorithm(
            "newton",
            _newton_only,
            False,
            1,
            2,
            "semismooth Newton (Alart and Curnier), regularised",
            on_bodies=_newton_on_bodies,
        ),
        Algorithm("nsgs", lambda form, _, start: gauss_seidel(form, start), False, 5000, 200, "nonsmooth Gauss-Seidel"),
        Algorithm(
            "ppa", lambda form, _, start: proximal_points(form, start), False, 300, 300, "proximal points by Newton"
        ),
        Algorithm(
            "combinations",
            lambda form, _, start: drawn_combinations(form, start),
            False,
            5000,
            5000,
            "Newton's method from drawn combinations of states",
        ),
        Algorithm("admm", lambda form, _, start: admm(form, start), False, 20000, 60, "ADMM, the shift from the dual"),
        Algorithm("aclm", _with_steps(cone_fixed_point), True, 200, 40, "convex problems over shifted cones"),
        Algorithm(
            "tresca",
            _with_steps(tresca_fixed_point),
            True,
            100,
            40,
            "convex problems of given friction bounds",
            on_bodies=tresca_on_bodies,
            on_ranks=True,
        ),
    )
}
# Names with a special meaning in `solve`.
TAKEN = ("enumeration", "associated")


def register(algorithm: Algorithm) -> None:
    """Register an algorithm, which `solve` then finds by its name, for local problems and for bodies.

    Raises
    ------
    InvalidProblem
        An algorithm of that name is there.
    """
    if algorithm.name in ALGORITHMS or algorithm.name in TAKEN:
        raise InvalidProblem(f"algorithm: expected a name of its own, got {algorithm.name!r}, which another one has")
    ALGORITHMS[algorithm.name] = algorithm


# Newton's method starts from the iterate of this number, then from later ones, each number half as large again.
FIRST_POLISH = 4
# It also starts from iterates with an error below this, in the scale of the local form.
NEARLY = 1e-6
# The most iterates without progress for problems with few contacts.
PATIENCE, PATIENCE_A_CONTACT = 40, 20
# A reduction of the error by less than this factor does not count as progress.
HARDLY_BETTER = 0.8


@dataclass(frozen=True, eq=False)
class Outcome:
    """The last iterate of an algorithm, with the algorithm's name."""

    iterate: Iterate
    name: str
    accepted: bool
    steps: ConvexSteps | None = None


def run_algorithm(
    form: LocalForm,
    algorithm: Algorithm,
    method: Method,
    settings: Settings,
    start: Iterate,
    accepted: Accepted,
    polish: bool = True,
) -> Outcome:
    """Iterate until an iterate, refined by Newton's method where that helps, is accepted; else return the best one.

    Raises NotConverged, BackendFailed, BackendMissing, Unsupported: of the convex method, or an overflow; where the
    time is up, the best one is returned instead.

    Parameters
    ----------
    form : the frictional problem in its contact forces
    algorithm : an entry of `ALGORITHMS`
    method : the convex method of its steps, where it takes such
    settings : tolerance and limits
    start : the answer from which it starts
    accepted : function, says whether an iterate is the answer
    polish : whether Newton's method refines iterates in between
    """
    steps = ConvexSteps(form, method, settings) if algorithm.convex else None
    name = algorithm.name if steps is None else algorithm_name(algorithm.name, method.name + steps.polygons)
    deadline = Deadline(settings.time_limit)
    limit = algorithm.limit if settings.max_iter is None else settings.max_iter
    patience = min(algorithm.patience, PATIENCE + PATIENCE_A_CONTACT * form.m)
    best, history, next_polish, nearly = start, [], FIRST_POLISH, NEARLY
    try:
        for found in algorithm.iterates(form, steps, start):
            history.append(found.error)
            tell(f"{name}, step {found.iterations}: the law is violated by {found.error:.1e}")
            last = found.iterations >= limit or deadline.passed or _stagnates(history, patience)
            nearest = found
            if polish and (found.iterations >= next_polish or last or found.error <= nearly):
                next_polish = found.iterations + max(FIRST_POLISH, found.iterations // 2)
                nearly = min(nearly, NEARER * found.error)
                nearest = found if _ends_at_rounding(algorithm, found) else newton(form, found)
            best = nearest if nearest.error < best.error else best
            if accepted(nearest):
                kept = replace(nearest, iterations=found.iterations, history=tuple(history))
                return Outcome(kept, name, True, steps)
            if last:
                break
    except NoEquilibrium as error:
        # An error of a convex step; whether the load drives a rigid motion is proven elsewhere.
        raise NotConverged(
            f"{name}: the convex problem of a step has no answer that floats find", tuple(history)
        ) from error
    except NotConverged:
        if not time_is_up():
            raise
    except BackendFailed as error:
        if not history:
            raise
        raise NotConverged(f"{name}: {error}", tuple(history)) from error
    kept = replace(best, iterations=len(history), history=tuple(history))
    return Outcome(kept, name, False, steps)


def _ends_at_rounding(algorithm: Algorithm, found: Iterate) -> bool:
    """Return whether an iterate is where Newton's method ended because no step lowers a residual of rounding size."""
    return algorithm.iterates is _newton_only and found.error <= ROUNDED * found.size


def _stagnates(errors: list[float], patience: int) -> bool:
    """Return whether the later half of many iterates is hardly better than the earlier."""
    count = len(errors)
    return count >= patience and min(errors[count // 2 :]) > HARDLY_BETTER * min(errors[: count // 2])


# The default sequence of algorithms, with their iterations.
ATTEMPTS = (
    *(("newton", 1), ("nsgs", 12), ("ppa", 100), ("admm", 1000)),
    *(("aclm", 60), ("tresca", 60), ("combinations", 1000), ("ppa", 1000), ("admm", 20000)),
)
# The numbers of short and of long attempts among them.
SHORT_ATTEMPTS, LONG_ATTEMPTS = 2, 2
# An iterate satisfies the law to rounding if it violates it by less than this part of the typical gap or slip.
SOLVED = 1e-14
# Algorithms that do not profit from a start.
FROM_THE_START = ("nsgs", "admm", "aclm", "tresca", "combinations")
# Algorithms from whose unsuccessful iterates no other one starts. In the plane all combinations are listed instead, and
# where fewer steps are allowed than an attempt takes none is drawn.
DRAWN = ("combinations",)


def run_any(
    form: LocalForm,
    settings: Settings,
    start: Iterate,
    accepted: Accepted,
    refuse_none: Callable[[], None] = lambda: None,
    attempts: int = len(ATTEMPTS),
    few: int = 0,
) -> Outcome:
    """Run Newton's method from a start, then from iterates of other algorithms, until an answer is accepted.

    With few contacts the attempts end at an iterate that satisfies the law to rounding but is not accepted, since the
    others would reach the same one; combinations near it are tried elsewhere.

    Parameters
    ----------
    form : the frictional problem in its contact forces
    settings : tolerance and limits, which all attempts share
    start : the answer from which the first attempt starts
    accepted : function, says whether an iterate is the answer
    refuse_none : function, raises where there is no answer; it is asked behind the short attempts
    attempts : how many of `ATTEMPTS` are made
    few : how many contacts are few
    """
    deadline = Deadline(settings.time_limit)
    best: Outcome | None = None
    for number, (name, limit) in enumerate(ATTEMPTS[:attempts]):
        if number and deadline.passed:
            break
        if name in DRAWN and (form.d == 2 or (settings.max_iter or limit) < limit):
            continue
        if number == SHORT_ATTEMPTS:
            refuse_none()
        from_best = start if best is None or name in FROM_THE_START else best.iterate
        try:
            found = run_algorithm(
                form,
                ALGORITHMS[name],
                find("clarabel" if ALGORITHMS[name].convex else "active-set"),
                replace(settings, max_iter=min(limit, settings.max_iter or limit), time_limit=deadline.remaining),
                from_best,
                accepted,
            )
        except (NotConverged, BackendFailed, BackendMissing, Unsupported):
            continue
        if found.accepted:
            return found
        if best is None or (found.iterate.error < best.iterate.error and name not in DRAWN):
            best = found
        if best.iterate.error <= SOLVED and form.m <= few:
            break
    if best is None and deadline.passed:
        raise NotConverged(f"friction: stopped at the time limit of {stated_limit(settings.time_limit)}")
    if best is None:
        raise NotConverged("friction: no algorithm came to an answer")
    return best
