"""The registry of methods, one file an idea and one table for all, and what a caller may ask of one."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any

import numpy as np

from contactqp.errors import BackendMissing, InvalidProblem, Unsupported, free_memory, shown
from contactqp.linalg.iteration import constraints_are_many
from contactqp.linalg.runtime import MOST_OF_MEMORY
from contactqp.model.arrays import within_time
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import is_whole, refuse_not_positive
from contactqp.model.solution import Candidate, Solution
from contactqp.solving.methods import (
    active_set,
    augmented_lagrangian,
    backends,
    complementarity,
    cvxpy_models,
    lagrange_multiplier,
    master_slave,
    penalty,
)
from contactqp.solving.methods.method import Method, Settings

__all__ = [
    "FEW_ROWS",
    "Method",
    "Settings",
    "algorithm_name",
    "find",
    "methods",
    "of_same_letters",
    "options_of",
    "refuse_arguments",
    "refuse_too_dense",
    "refuse_unsupported",
    "register",
    "registered_name",
    "warm_candidate",
]

DEFAULT_METHOD = "active-set"
# Options of the convex steps of friction in space, for methods that take no cones.
POLYGON_OPTIONS = ("facets", "polygon")

_MODULES = (
    active_set,
    backends,
    cvxpy_models,
    complementarity,
    master_slave,
    lagrange_multiplier,
    penalty,
    augmented_lagrangian,
)
_REGISTRY: dict[str, Method] = {method.name: method for module in _MODULES for method in module.METHODS}


def methods() -> tuple[Method, ...]:
    """Return every method, installed or not: entries with `name`, `kind`, `installed` and what each can do.

    >>> "active-set" in [method.name for method in methods()]
    True
    """
    return tuple(_REGISTRY.values())


def register(method: Method) -> None:
    """Add a method, which `solve`, `compare` and `methods` know by its name from then on.

    Raises
    ------
    InvalidProblem
        A method of that name is there.
    """
    if method.name in _REGISTRY:
        raise InvalidProblem(f"method: expected a name of its own, got {shown(method.name)}, which another one has")
    _REGISTRY[method.name] = method


def registered_name(name: Any) -> str:
    """Return the name under which a method is registered; case does not count, nor whether - or _ joins its words.

    Raises Unsupported: there is no such method; the nearest names are given.
    """
    if not isinstance(name, str):
        raise Unsupported(f"method: expected a name, got {shown(name)}")
    if name in _REGISTRY:
        return name
    meant = of_same_letters(name, _REGISTRY)
    if meant is None:
        near = difflib.get_close_matches(name.casefold().replace("_", "-"), _REGISTRY, n=3)
        cure = f"nearest: {', '.join(near)}" if near else f"the methods: {', '.join(sorted(_REGISTRY))}"
        raise Unsupported(f"no method is called {shown(name)}; {cure}")
    return meant


def of_same_letters(name: Any, names: Iterable[str]) -> str | None:
    """Return the known name that differs in case alone, or in - for _; None where there is none."""
    if not isinstance(name, str):
        return None
    same = {one.casefold().replace("_", "-"): one for one in names}
    return same.get(name.casefold().replace("_", "-"))


def find(name: str) -> Method:
    """Return the installed method of that name.

    Raises Unsupported: there is no such method; the nearest names are given; BackendMissing: it exists and its package
    is not installed; the pip command is given.
    """
    method = _REGISTRY[registered_name(name)]
    if method.packages and not method.installed:
        raise BackendMissing(f"method {method.name!r} needs {', '.join(method.packages)}: {method.install}")
    return method


# Arguments of `solve` that every method has, and what other packages call them.
ARGUMENTS = (
    "tolerance",
    "condense",
    "polish",
    "time_limit",
    "max_iter",
    "warm_start",
    "algorithm",
    "progress",
    "method",
)
ELSEWHERE = {"tol": "tolerance", "eps": "tolerance", "eps_abs": "tolerance", "rtol": "tolerance", "atol": "tolerance",
             "solver": "method", "maxiter": "max_iter", "max_iterations": "max_iter", "timeout": "time_limit",
             "initvals": "warm_start", "x0": "warm_start", "beta": "penalty", "kappa": "perturbation"}  # fmt: skip
# Arguments that belong to the problem and not to `solve`.
OF_THE_PROBLEM = ("load", "gap", "friction", "slip_origin", "normal", "tangent", "tie", "tie_value")


def options_of(name: str, names: Iterable[str], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options, stated for several methods, that apply to one of them.

    An option that none of the methods takes is kept, so that `solve` refuses it.
    """
    return {key: value for key, value in options.items() if takes(name, key) or not any(takes(n, key) for n in names)}


def takes(name: str, option: str) -> bool:
    """Return whether a method takes an option of `solve`, on some problem."""
    method = _REGISTRY[registered_name(name)]
    return option in (*ARGUMENTS, *method.options, *_polygon_options(method))


def _polygon_options(method: Method) -> tuple[str, ...]:
    return POLYGON_OPTIONS if method.solve_friction is None else ()


def meant_option(name: str, options: Sequence[str]) -> str:
    """Return a hint at the argument of `solve` or option of a method that resembles a name."""
    if name in OF_THE_PROBLEM:
        return f" (it belongs to the problem: solve(problem.replace({name}=...)))"
    meant = ELSEWHERE.get(name.casefold())
    names = (*ARGUMENTS, *options)
    if meant is None or meant not in names:
        near = difflib.get_close_matches(name.casefold(), names, n=1)
        meant = near[0] if near else None
    return "" if meant is None else f" (do you mean {meant!r}?)"


def refuse_arguments(tolerance: Any, condense: Any, polish: Any, time_limit: Any, max_iter: Any) -> None:
    """Raise InvalidProblem on an argument of `contactqp.solve` that is of the wrong kind.

    Parameters
    ----------
    tolerance, condense, polish, time_limit, max_iter
        As in `contactqp.solve`.
    """
    refuse_not_positive("tolerance", tolerance)
    if time_limit is not None:
        refuse_not_positive("time_limit", time_limit)
    if max_iter is not None and (not is_whole(max_iter) or max_iter < 1):
        raise InvalidProblem(f"max_iter: expected a positive integer, got {shown(max_iter)}")
    if not (isinstance(condense, bool) or (isinstance(condense, str) and condense == "auto")):
        raise InvalidProblem(f"condense: expected True, False or 'auto', got {shown(condense)}")
    if not isinstance(polish, bool):
        raise InvalidProblem(f"polish: expected True or False, got {shown(polish)}")


def within_time_of(options: Mapping[str, Any]) -> AbstractContextManager[None]:
    """Return the context of a call of many solutions, for which a `time_limit` among its options holds as a whole."""
    limit = options.get("time_limit")
    if limit is not None:
        refuse_not_positive("time_limit", limit)
    return within_time(limit)


def warm_candidate(problem: ContactProblem, warm_start: Any) -> Candidate | None:
    """Return the candidate to start from that a solution of a problem with the same contacts gives."""
    if warm_start is None:
        return None
    if not isinstance(warm_start, Solution):
        raise InvalidProblem(f"warm_start: expected a Solution, got {type(warm_start).__name__}")
    shapes = ((problem.dimension,), (problem.contacts,), (problem.ties,))
    answer = warm_start.answer
    values = (answer.displacement, answer.normal_force, answer.tie_force)
    if tuple(value.shape for value in values) != shapes:
        raise InvalidProblem(f"warm_start: expected a solution of {problem!r}, got one of {warm_start.problem!r}")
    friction = answer.friction_force
    fits = problem.slip_origin is not None and friction is not None and friction.shape == problem.slip_origin.shape
    return Candidate(answer if fits else replace(answer, friction_force=None))


def refuse_unsupported(problem: ContactProblem, method: Method, settings: Settings, algorithm: str | None) -> None:
    """Raise on options that the method does not have or misses, and on what it cannot do.

    Parameters
    ----------
    problem : ContactProblem
    method : Method
    settings : their `options` are those that were given
    algorithm : str or None, the algorithm of friction that was asked for
    """
    in_plane = problem.slip_origin is None or (problem.contacts > 0 and problem.slip_origin.shape[1] == 1)
    polygons = problem.friction is not None and not in_plane
    options = (*method.options, *(_polygon_options(method) if polygons else ()))
    unknown = sorted(set(settings.options) - set(options))
    if unknown:
        own = ", ".join(options) or "none"
        hint = meant_option(unknown[0], options)
        every = ", ".join(name for name in ARGUMENTS if name != "method")
        raise InvalidProblem(
            f"{method.name}: unknown option {unknown[0]!r}{hint}; options of its own: {own}; of every method: {every}"
        )
    missing = [name for name in method.required if settings.options.get(name) is None]
    if missing:
        needed = missing[0] if missing[0] == method.name else f"{method.name}: {missing[0]}"
        raise InvalidProblem(f"{needed} has no default, state it: solve(..., {missing[0]}=...)")
    if settings.time_limit is not None and not method.timed and not constraints_are_many(problem):
        raise Unsupported(
            f"{method.name}: this backend has no time limit: leave time_limit out, or take clarabel or osqp"
        )
    if algorithm is not None and problem.friction is not None and method.solve_friction is not None:
        raise Unsupported(
            f"{method.name}: algorithm={shown(algorithm)} takes convex steps of another method, and this one has "
            "systems of stick and slip of its own: leave one of the two out"
        )
    if algorithm is not None and problem.friction is None:
        raise Unsupported(
            f"{method.name}: algorithm={shown(algorithm)} solves problems with friction, and this one states none: "
            "leave it out, or give the problem its tangent and friction=0"
        )


# The number of dense matrices that methods need at a time: 10 for DAQP, 24 for Lemke's method. Where sparse systems are
# predicted to cost less, dense ones are refused beyond this number of operations (minutes) and of rows.
COPIES, MOST_DENSE, FEW_ROWS = 10, 5e11, 1000


def refuse_too_dense(problem: ContactProblem, method: Method, condense: bool | str) -> None:
    """Raise Unsupported where dense matrices of the unknowns that a method is shown would take too much.

    Parameters
    ----------
    problem, method : ContactProblem, Method
    condense : bool or "auto", as in `solve`; where it is True only what does not fit into memory is refused
    """
    rows = [some for some in (problem.normal, problem.tangent, problem.tie) if some is not None]
    shown = len(np.unique(np.concatenate([some.indices for some in rows])))
    if condense is False and not method.sparse:
        shown = problem.dimension
    size = max(shown, problem.contacts + problem.ties)
    needed, free = 8 * COPIES * size**2, free_memory()
    too_large = free is not None and needed > MOST_OF_MEMORY * free
    too_long = condense is not True and float(size) ** 3 > MOST_DENSE and constraints_are_many(problem)
    if not (too_large or too_long):
        return
    why = f"{free / 2**30:.1f} GiB are free" if too_large and free is not None else "minutes to hours"
    raise Unsupported(
        f"{method.name}: {problem.contacts} contacts and {problem.ties} ties would become dense matrices of {size} "
        f"rows, about {needed / 2**30:.1f} GiB ({why}); active-set, clarabel and piqp take sparse systems "
        "(condense='auto')"
    )


def algorithm_name(algorithm: str, method: str) -> str:
    """Return what an answer calls an algorithm whose steps are convex problems, and the method that solves these.

    >>> algorithm_name("tresca", "active-set"), algorithm_name("aclm", "clarabel")
    ('Tresca fixed-point iteration, each step by active-set', 'aclm, each step by clarabel')
    """
    called = {"tresca": "Tresca fixed-point iteration"}.get(algorithm, algorithm)
    return f"{called}, each step by {method}"
