"""The registry of methods: one file an idea, one table for all."""

from __future__ import annotations

import difflib

from contactqp.errors import BackendMissing, InvalidProblem, Unsupported
from contactqp.solving.methods import (
    active_set,
    augmented_lagrangian,
    backends,
    cvxpy_models,
    lagrange_multiplier,
    lemke,
    master_slave,
    penalty,
    perturbed_lagrangian,
    projected_gauss_seidel,
)
from contactqp.solving.methods.method import Method, Settings

__all__ = ["Method", "Settings", "find", "methods", "register"]

_MODULES = (
    active_set,
    backends,
    cvxpy_models,
    lemke,
    projected_gauss_seidel,
    master_slave,
    lagrange_multiplier,
    penalty,
    perturbed_lagrangian,
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
    """Add a method of one's own: `solve`, `compare` and `methods` know it by its name from then on.

    Raises
    ------
    InvalidProblem
        A method of that name is there.
    """
    if method.name in _REGISTRY:
        raise InvalidProblem(f"method: expected a name of its own, got {method.name!r}, which another one has")
    _REGISTRY[method.name] = method


def find(name: str) -> Method:
    """The installed method of that name.

    Raises
    ------
    Unsupported
        There is no such method; the nearest names are given.
    BackendMissing
        It exists and its package is not installed; the pip command is given.
    """
    if not isinstance(name, str):
        raise Unsupported(f"method: expected a name, got {name!r}")
    if name not in _REGISTRY:
        near = difflib.get_close_matches(name, _REGISTRY, n=3) or sorted(_REGISTRY)
        raise Unsupported(f"no method is called {name!r}; nearest: {', '.join(near)}")
    method = _REGISTRY[name]
    if not method.installed:
        raise BackendMissing(f"method {name!r} needs {', '.join(method.packages)}: {method.install}")
    return method
