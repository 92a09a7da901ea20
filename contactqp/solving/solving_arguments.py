"""What `solve` is asked for, checked before anything is computed."""

from __future__ import annotations

from typing import Any

from contactqp.certificate.certificate import refuse_not_positive
from contactqp.errors import InvalidProblem, Unsupported
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import is_whole
from contactqp.model.solution import Candidate, Solution
from contactqp.solving.methods import Method, Settings

# Of the convex steps of friction in space, for methods that take no cones.
POLYGON_OPTIONS = ("facets", "polygon")


def refuse_arguments(tolerance: Any, condense: Any, polish: Any, time_limit: Any, max_iter: Any) -> None:
    """Raise InvalidProblem on an argument of the wrong kind."""
    refuse_not_positive("tolerance", tolerance)
    if time_limit is not None:
        refuse_not_positive("time_limit", time_limit)
    if max_iter is not None and (not is_whole(max_iter) or max_iter < 1):
        raise InvalidProblem(f"max_iter: expected a positive integer, got {max_iter!r}")
    if not (isinstance(condense, bool) or condense == "auto"):
        raise InvalidProblem(f"condense: expected True, False or 'auto', got {condense!r}")
    if not isinstance(polish, bool):
        raise InvalidProblem(f"polish: expected True or False, got {polish!r}")


def warm_candidate(problem: ContactProblem, warm_start: Any) -> Candidate | None:
    """A solution of a problem with the same contacts as a place to start from."""
    if warm_start is None:
        return None
    if not isinstance(warm_start, Solution):
        raise InvalidProblem(f"warm_start: expected a Solution, got {type(warm_start).__name__}")
    shapes = ((problem.dimension,), (problem.contacts,), (problem.ties,))
    values = (warm_start.displacement, warm_start.normal_force, warm_start.tie_force)
    if tuple(value.shape for value in values) != shapes:
        raise InvalidProblem(f"warm_start: expected a solution of {problem!r}, got one of {warm_start.problem!r}")
    friction = warm_start.friction_force
    fits = problem.slip_origin is not None and friction is not None and friction.shape == problem.slip_origin.shape
    return Candidate(*values, friction_force=friction if fits else None)


def refuse_unsupported(problem: ContactProblem, method: Method, settings: Settings, algorithm: str | None) -> None:
    """Raise on options that the method does not have or misses, and on what it cannot do."""
    in_space = problem.frictional and problem.slip_origin is not None and problem.slip_origin.shape[1] > 1
    options = (*method.options, *(POLYGON_OPTIONS if in_space and method.solve_friction is None else ()))
    unknown = sorted(set(settings.options) - set(options))
    if unknown:
        known = ", ".join(options) or "none"
        raise InvalidProblem(f"{method.name}: unknown option {unknown[0]!r}; its own options: {known}")
    missing = [name for name in method.required if settings.options.get(name) is None]
    if missing:
        raise InvalidProblem(f"{method.name}: {missing[0]} has no default, state it: solve(..., {missing[0]}=...)")
    if algorithm is not None and problem.frictional and method.solve_friction is not None:
        raise Unsupported(
            f"{method.name}: algorithm={algorithm!r} takes convex steps of another method, and this one has systems of "
            "stick and slip of its own: leave one of the two out"
        )
    if algorithm is not None and not problem.frictional:
        raise Unsupported(
            f"{method.name}: algorithm={algorithm!r} is an outer law of friction, and this problem has none"
        )
