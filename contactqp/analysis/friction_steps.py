"""The solutions along a load path with Coulomb friction, each from where the one before left its contacts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from contactqp.analysis.anchoring import Anchors, State, step_to
from contactqp.analysis.friction_stepping import PlaneStepper, SolveStepper, Stepper
from contactqp.analysis.history import Event
from contactqp.analysis.lazy_solutions import LazySolutions
from contactqp.certificate.subset_bounds import first_candidates
from contactqp.errors import InvalidProblem, NoEquilibrium, NotCertified, NotConverged, SeveralEquilibria, Unsupported
from contactqp.linalg.iteration import iterated
from contactqp.linalg.threads import one_blas_thread
from contactqp.model.arrays import Mask, Vector
from contactqp.model.problem import ContactProblem
from contactqp.solving.methods import Method, Settings, find, refuse_arguments, refuse_unsupported

# Of `solve`, and what they are if nobody says.
DEFAULTS: dict[str, Any] = dict(tolerance=1e-9, condense="auto", polish=True, time_limit=None, max_iter=None)
ARGUMENTS = tuple(DEFAULTS)


class FrictionSteps(LazySolutions):
    """The solutions at the steps; refined, expanded and certified when they are looked at.

    The problem of each has its slip origin: `Solution.slip` is the slip of its step, counted from where a contact was
    at the step before or from where it closed within the step. A contact that is open at the end of a step has no
    anchor; its slip origin is its E_T u of the step before and says nothing.
    """

    _before: State
    _anchors: Anchors

    def __init__(self, problem: ContactProblem, method: str, options: dict[str, Any]) -> None:
        if problem.slip_origin is None:
            raise ValueError("a path with friction of a problem without tangential rows")
        super().__init__()
        self._problem = problem
        self._stepper = _stepper(problem, method, options)
        self._leg = -1
        self._states: list[tuple[Mask, Mask]] = []
        nothing = np.zeros(problem.dimension)
        self._stepper.turn(nothing, nothing)
        origin = problem.slip_origin
        with one_blas_thread(problem):
            state = self._stepper.solve(1.0, origin, np.zeros(problem.contacts, dtype=bool))
        # A contact that is closed and carries nothing is where the caller anchored it.
        at_rest = state.touching & ~state.pushes
        self._keep(state, Anchors(np.where(at_rest[:, None], origin, state.position), state.touching))

    def turn(self, start: Vector, end: Vector) -> None:
        """Set out from one corner to the next."""
        self._stepper.turn(start, end)
        self._leg += 1
        self._before = replace(self._before, fraction=0.0)

    def go_to(self, fraction: float) -> None:
        """One more step, to the load at a fraction of the leg.

        Raises
        ------
        NoEquilibrium, SeveralEquilibria, NotConverged
            As `solve`, with the pseudo-time.
        """
        try:
            with one_blas_thread(self._problem):
                state = step_to(fraction, self._before, self._anchors, self._stepper.solve)
                self._keep(state, Anchors(state.position, state.touching))
        except (NoEquilibrium, SeveralEquilibria) as error:
            raise type(error)(f"follow_path: at t = {self._leg + fraction:.6g}: {error}") from error
        except NotConverged as error:
            message = f"follow_path: at t = {self._leg + fraction:.6g}: {error}"
            raise NotConverged(message, error.history, error.solution) from error
        except NotCertified as error:
            message = f"follow_path: at t = {self._leg + fraction:.6g}: {error}"
            raise NotCertified(message, error.solution) from error

    def _keep(self, state: State, anchors: Anchors) -> None:
        self._before = state = self._stepper.accept(state)
        self._anchors = anchors
        self.append(state.step)
        self._states.append((state.pushes, state.slides))

    def changes(self, times: Sequence[float]) -> Iterator[Event]:
        """Every change of state, at the first step that shows it."""
        for (before, now), time in zip(pairwise(self._states), times[1:], strict=True):
            for i in range(self._problem.contacts):
                for kind in kinds((before[0][i], before[1][i]), (now[0][i], now[1][i])):
                    yield Event(kind, i, time, self._problem.contact_name(i))


def refuse_options(problem: ContactProblem, chosen: Method, options: dict[str, Any]) -> None:
    """Raise on options that `solve` refuses, and on a start that the path has itself."""
    if options.get("algorithm") == "associated":
        raise Unsupported("associated: it is no step of Coulomb friction, and a path would carry its dilation along")
    if "warm_start" in options:
        raise InvalidProblem("warm_start: a path starts each step from the one before")
    known = {name: options[name] for name in ARGUMENTS if name in options}
    refuse_arguments(**(DEFAULTS | known))
    others = {name: value for name, value in options.items() if name not in (*ARGUMENTS, "algorithm")}
    refuse_unsupported(problem, chosen, Settings(options=others), options.get("algorithm"))


def _stepper(problem: ContactProblem, method: str, options: dict[str, Any]) -> Stepper:
    """Newton on the contact unknowns in the plane, unless the caller wants something else, or the bodies are large."""
    chosen = find(method)
    if not chosen.exact or not chosen.semidefinite:
        raise Unsupported(f"{chosen.name}: a path with Coulomb friction takes an exact convex method; try active-set")
    refuse_options(problem, chosen, options)
    limited = options.get("max_iter") is not None or options.get("time_limit") is not None
    in_plane = problem.slip_origin is not None and problem.slip_origin.shape[1] == 1
    whole = iterated(problem) or first_candidates(problem) is not None
    own = chosen.solve_friction is not None  # systems of stick and slip
    if in_plane and not (whole or limited or own) and options.get("algorithm") in (None, "newton"):
        return PlaneStepper(problem, method, {**options, "algorithm": None})
    return SolveStepper(problem, method, options)


def kinds(before: tuple[Any, Any], now: tuple[Any, Any]) -> list[str]:
    """What happened to a contact that (pushed, slid) before and does so now."""
    (pushed, slid), (pushes, slides) = before, now
    if pushed != pushes:
        return (["closed", "slip"] if slides else ["closed"]) if pushes else ["opened"]
    if pushed and slid != slides:
        return ["slip" if slides else "stick"]
    return []
