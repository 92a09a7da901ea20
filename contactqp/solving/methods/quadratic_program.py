"""Every quadratic programming backend of qpsolvers, by one function.

The contact problem is a quadratic program as it stands: P = K, q = -f, G = E_N, h = g, and the ties are A x = b. Its
dual z >= 0 is the contact force l_N and y the tie force nu; no sign is flipped. Backends differ in their tolerances,
limits and matrix formats, and the table `backends.BACKENDS` is where that is written down.
"""

from __future__ import annotations

import contextlib
import io
import math
import warnings
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate
from contactqp.solving.methods.backends import BACKENDS, Backend, backend_options
from contactqp.solving.methods.method import Method, Settings

DEVELOPERS_WARNINGS = (DeprecationWarning, PendingDeprecationWarning, FutureWarning)


def solve_quadratic_program(backend: Backend, problem: ContactProblem, settings: Settings) -> Candidate:
    """min 1/2 u'K u - f'u subject to E_N u <= g, A u = b, by one backend; l_N is its dual z, nu its dual y.

    `settings.tolerance` is passed to every tolerance the backend has: defaults are wrong by up to 4e-3 in the forces.

    Returns
    -------
    Candidate
        `claimed` is the backend's own flag; `status` its own words and warnings.

    Raises
    ------
    BackendFailed
        The backend raised (its exception is the cause), or returned nothing, or something that is not finite.
    Unsupported
        A time limit, where the backend has none; a singular stiffness, where it takes none.
    """
    from qpsolvers import solve_problem

    options = backend_options(backend, settings)
    program, initial = _program(backend, problem), _initial(backend, settings)
    with collected_words() as words:
        try:
            solution = solve_problem(program, solver=backend.name, initvals=initial, **options)
        except (KeyboardInterrupt, SystemExit, MemoryError):
            raise
        except BaseException as error:
            # Backends raise what they like: ValueError, RuntimeError, their own types, and Rust's panics, which are
            # no Exception. Nothing but the backend runs here, and the cause is kept.
            raise BackendFailed(f"{backend.name}: {type(error).__name__}: {error}") from error
    found = "solved" if solution.found else "not solved"
    status = "; ".join([f"{backend.name}: {_said(solution.extras, backend.status) or found}", *words])
    return _candidate(problem, solution, _iterations(solution.extras, backend), status)


def _program(backend: Backend, problem: ContactProblem) -> Any:
    from qpsolvers import Problem

    # Copies: some backends scale in place, and refuse the problem's own read-only arrays.
    form = _dense if backend.dense and not (backend.sparse and sp.issparse(problem.stiffness)) else _sparse
    G, h = problem.normal, problem.gap.copy()
    if problem.contacts == 0 and backend.needs_inequality:
        G, h = sp.csr_array((1, problem.dimension)), np.ones(1)  # 0'u <= 1 holds always and does nothing
    rows = [form(G), h] if h.size else [None, None]
    ties = [form(problem.tie), problem.tie_value.copy()] if problem.ties else [None, None]
    return Problem(form(problem.stiffness), -problem.load, *rows, *ties)


def _sparse(matrix: Any) -> Any:
    """A copy: some backends want matrices that they could write to."""
    return sp.csc_matrix(matrix, copy=True)


def _dense(matrix: Any) -> Any:
    # Row by row: pyqpmad factorises a column-ordered matrix in place, and qpsolvers uses it afterwards.
    return np.array(matrix.toarray() if sp.issparse(matrix) else matrix, order="C")


def _initial(backend: Backend, settings: Settings) -> Vector | None:
    # A start is a hint: a backend that takes none finds the same answer without.
    if settings.warm_start is None or not backend.warm_start:
        return None
    return settings.warm_start.displacement


@contextlib.contextmanager
def collected_words() -> Iterator[list[str]]:
    """Collect what a backend warns and prints; it belongs to the status of its answer, not on the terminal."""
    words: list[str] = []
    with warnings.catch_warnings(record=True) as caught, contextlib.redirect_stdout(io.StringIO()) as printed:
        warnings.simplefilter("always")
        yield words
    # Announcements of changed defaults are for the backend's developers; what concerns the answer is a UserWarning.
    words.extend(str(w.message) for w in caught if not issubclass(w.category, DEVELOPERS_WARNINGS))
    words.extend(printed.getvalue().split("\n")[:1] if printed.getvalue() else [])


def _candidate(problem: ContactProblem, solution: Any, iterations: int | None, status: str) -> Candidate:
    displacement, force, tie_force = (
        _values(values, size, status)
        for values, size in (
            (solution.x, problem.dimension),
            (solution.z if problem.contacts else (), problem.contacts),
            (solution.y if problem.ties else (), problem.ties),
        )
    )
    return Candidate(displacement, force, tie_force, iterations, bool(solution.found), status)


def _values(values: Any, size: int, status: str) -> Vector:
    if values is None:
        raise BackendFailed(f"{status}: nothing was returned")
    vector = np.array(values, dtype=float).ravel()
    if vector.shape != (size,) or not np.all(np.isfinite(vector)):
        raise BackendFailed(f"{status}: expected {size} finite numbers, got {vector}")
    return vector


def _found(extras: Any, path: tuple[str, ...]) -> Any:
    """What lies at a path of keys and attributes, or None."""
    for name in path:
        extras = extras.get(name) if isinstance(extras, dict) else getattr(extras, name, None)
    return extras


def _said(extras: Any, path: tuple[str, ...]) -> str:
    return str(_found(extras, path)) if path and _found(extras, path) is not None else ""


def _iterations(extras: Any, backend: Backend) -> int | None:
    count = _found(extras, backend.iterations) if backend.iterations else None
    return int(count) if isinstance(count, (int, float)) and math.isfinite(count) else None


def _note(backend: Backend) -> str:
    timeless = "" if backend.time_limit else "no time limit"
    dense = "" if backend.sparse else "makes matrices dense"
    return "; ".join(note for note in (backend.note, timeless, dense) if note)


def method_of(backend: Backend) -> Method:
    """The method that calls a backend, scaled before and polished after the call."""
    return Method(
        name=backend.name,
        kind="quadratic program",
        solve=partial(solve_quadratic_program, backend),
        polish=True,
        scale=True,
        semidefinite=backend.semidefinite,
        sparse=backend.sparse,
        knob="tolerance",
        packages=("qpsolvers", backend.package),
        install=backend.install,
        note=_note(backend),
    )


METHODS = tuple(method_of(backend) for backend in BACKENDS)
