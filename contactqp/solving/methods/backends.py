"""Call the quadratic programming backends of qpsolvers by one function, with a table of their capabilities.

The contact problem is a quadratic program: P = K, q = -f, G = E_N, h = g, and the ties are A x = b. Its dual z >= 0 is
the contact force l_N and y the tie force nu; no sign is flipped. The table `BACKENDS` lists their tolerances, limits
and matrix formats.

Left out: quadprog, ECOS, CVXOPT and KVXOPT (GPL; the first two also refuse a semidefinite stiffness), MOSEK (qpsolvers
reaches it through CVXOPT only), COPT (prints its licence search to the terminal at every call, and calls unbounded
problems solved), qpax and jaxopt (single precision unless the whole process is switched), PDHCG, HPIPM, qpSWIFT,
qpOASES and NPPro (no wheels to install).
"""

from __future__ import annotations

import contextlib
import io
import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed, Unsupported, of_backend
from contactqp.linalg.runtime import silenced_output
from contactqp.model.arrays import Indices, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods.method import QUADRATIC_PROGRAM, Method, Settings


@dataclass(frozen=True)
class Backend:
    """The keywords of one backend of qpsolvers, by its own names, and the matrices that it accepts.

    `method_of(backend)` makes a `Method` of it, which `register` adds to the methods of `solve`.
    """

    name: str  # qpsolvers' name, and ours
    package: str  # the module that has to be importable
    install: str
    tolerances: tuple[str, ...]  # keywords that receive Settings.tolerance
    tightest: float = 0.0  # the smallest tolerance it accepts; smaller ones it would ignore without a word
    iteration_limit: str = "max_iter"
    default_limit: int | None = None  # where the backend's own default stops too early
    time_limit: str | None = None  # keyword that receives seconds; None: the backend knows no time limit
    sparse: bool = True  # matrices it takes; a dense stiffness is passed dense if possible
    dense: bool = False
    semidefinite: bool = True
    needs_inequality: bool = False  # whether it fails without inequality rows
    bounds: bool = False  # whether separate bounds of unknowns make it faster
    warm_start: bool = False  # takes a displacement to start from
    fixed: tuple[tuple[str, Any], ...] = ()  # settings that are always passed; reasons are given beside them
    status: tuple[str, ...] = ()  # path of its status text in Solution.extras
    iterations: tuple[str, ...] = ()  # path of its iteration count, empty if qpsolvers drops it
    note: str = ""


BACKENDS = (
    Backend(
        "osqp",
        "osqp",
        "pip install osqp",
        # With its default of 1e-4 it declares feasible stiff problems infeasible. Its own polish stays off, so that raw
        # answers are unpolished.
        tolerances=("eps_abs", "eps_rel", "eps_prim_inf", "eps_dual_inf"),
        default_limit=50_000,  # its own 4000 ends at KKT errors of 1e-4
        time_limit="time_limit",
        warm_start=True,
        status=("info", "status"),
        iterations=("info", "iter"),
    ),
    Backend(
        "clarabel",
        "clarabel",
        "pip install clarabel",
        # Its defaults of 1e-8 leave multiplier errors of 4e-3 on stiff problems.
        tolerances=("tol_gap_abs", "tol_gap_rel", "tol_feas", "tol_infeas_abs", "tol_infeas_rel"),
        time_limit="time_limit",
        needs_inequality=True,  # an unconstrained problem goes to SciPy's LSQR with its tolerance of 1e-6
        status=("status",),
    ),
    Backend(
        "piqp",
        "piqp",
        "pip install piqp",
        tolerances=("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"),
        dense=True,
        bounds=True,
        status=("info", "status"),
        iterations=("info", "iter"),
    ),
    Backend(
        "proxqp",
        "proxsuite",
        "pip install proxsuite",
        tolerances=("eps_abs", "eps_duality_gap_abs"),
        dense=True,
        # Its test has no complementarity: without the duality gap, and with a relative part, it returns points with
        # force across an open gap as solved.
        fixed=(("eps_rel", 0.0), ("check_duality_gap", True), ("eps_duality_gap_rel", 0.0)),
        warm_start=True,
        status=("info", "status"),
        iterations=("info", "iter"),
    ),
    Backend(
        "daqp",
        "daqp",
        "pip install daqp",
        tolerances=("primal_tol", "dual_tol"),
        iteration_limit="iter_limit",
        default_limit=100_000,  # its own 1000 is fewer than some problems have contacts
        time_limit="time_limit",
        sparse=False,
        dense=True,
        warm_start=True,
    ),
    Backend(
        "highs",
        "highspy",
        "pip install highspy",
        tolerances=("primal_feasibility_tolerance", "dual_feasibility_tolerance"),
        tightest=1e-10,
        iteration_limit="qp_iteration_limit",
        default_limit=20_000,  # without a limit it may not end where stiffnesses differ by orders of magnitude
        time_limit="time_limit",
        # Added to the stiffness. Its default of 1e-7 spoils forces and calls unbounded problems solved; without any it
        # gives up on floating bodies.
        fixed=(("qp_regularization_value", 1e-12),),
    ),
    Backend(
        "scs",
        "scs",
        "pip install scs",
        tolerances=("eps_abs", "eps_rel", "eps_infeas"),
        iteration_limit="max_iters",
        time_limit="time_limit_secs",
        needs_inequality=True,  # as Clarabel
        warm_start=True,
        status=("status",),
        iterations=("iter",),
    ),
    Backend(
        "qpalm",
        "qpalm",
        "pip install qpalm",
        tolerances=("eps_abs", "eps_rel", "eps_prim_inf", "eps_dual_inf"),
        time_limit="time_limit",
        needs_inequality=True,  # without rows it can divide by zero and take the process with it
        warm_start=True,
        status=("info", "status"),
        iterations=("info", "iter"),
    ),
    Backend(
        "pyqpmad",
        "pyqpmad",
        "pip install pyqpmad",
        tolerances=("tolerance",),
        sparse=False,
        dense=True,
        semidefinite=False,  # it factorises the stiffness
        iterations=("num_iterations",),
    ),
    Backend(
        "sip",
        "sip_qp_python",
        "pip install sip-qp-python",
        tolerances=("eps_abs", "eps_rel"),
        iteration_limit="max_iterations",
        time_limit="time_limit",
        warm_start=True,
    ),
    Backend(
        "qtqp",
        "qtqp",
        "pip install qtqp",
        tolerances=("tol_gap_abs", "tol_gap_rel", "tol_feas", "tol_infeas_abs", "tol_infeas_rel"),
        needs_inequality=True,  # it refuses problems with equations alone
        status=("status",),
    ),
    Backend(
        "gurobi",
        "gurobipy",
        "pip install gurobipy",
        tolerances=("FeasibilityTol", "OptimalityTol", "BarConvTol"),
        tightest=1e-9,
        iteration_limit="BarIterLimit",
        time_limit="TimeLimit",
        note="commercial; the wheel's own licence is limited to small problems",
    ),
)


def backend_options(backend: Backend, settings: Settings) -> dict[str, Any]:
    """Return the keyword arguments of one call in the backend's names."""
    options = dict(backend.fixed)
    options.update(dict.fromkeys(backend.tolerances, max(settings.tolerance, backend.tightest)))
    limit = settings.max_iter or backend.default_limit
    if limit is not None:
        options[backend.iteration_limit] = int(limit)
    if settings.time_limit is not None:
        if backend.time_limit is None:
            raise Unsupported(f"{backend.name}: this backend has no time limit")
        options[backend.time_limit] = float(settings.time_limit)
    options.update(settings.options)
    return options


DEVELOPERS_WARNINGS = (DeprecationWarning, PendingDeprecationWarning, FutureWarning)


def solve_quadratic_program(backend: Backend, problem: ContactProblem, settings: Settings) -> Candidate:
    """Minimise 1/2 u'Ku - f'u over E_N u <= g, A u = b by one backend; l_N is its dual z, nu its dual y.

    `settings.tolerance` is passed to every tolerance the backend has: defaults are wrong by up to 4e-3 in the forces.

    Raises BackendFailed: the backend raised (its exception is the cause), or returned nothing, or something that is not
    finite; Unsupported: a time limit, where the backend has none; a singular stiffness, where it takes none.

    Returns
    -------
    Candidate
        `claimed` is the backend's own flag; `status` its own words and warnings.
    """
    from qpsolvers import solve_problem

    reached = problem.gap <= NEVER_REACHED
    if not np.all(reached):
        candidate = solve_quadratic_program(backend, problem.with_contacts(np.flatnonzero(reached)), settings)
        force = np.zeros(problem.contacts)
        force[reached] = candidate.answer.normal_force
        return replace(candidate, answer=replace(candidate.answer, normal_force=force))
    options = backend_options(backend, settings)
    bounds = _bounds(problem) if backend.bounds and problem.dimension > BOUNDS_PAY else None
    program, initial = _program(backend, problem, bounds), _initial(backend, settings)
    hear_greeting(backend.package)
    with collected_words() as words, of_backend(backend.name):
        solution = solve_problem(program, solver=backend.name, initvals=initial, **options)
    limit = options.get(backend.iteration_limit)
    within = "" if limit is None else f" within {limit} iterations: max_iter allows more"
    found = "solved" if solution.found else f"not solved{within}"
    status = "; ".join([f"{backend.name}: {_said(solution.extras, backend.status) or found}", *words])
    if bounds is not None and solution.z_box is not None:
        solution.z = bounds.forces(problem, solution)
    return _candidate(problem, solution, _iterations(solution.extras, backend), status)


# Contacts with larger scaled gaps are left out, as backends treat them as infinite, scale badly by them, or, as PIQP,
# print warnings. An answer that reached one would be refused.
NEVER_REACHED = 1e25
# The number of unknowns from which on bounds are passed as bounds instead of rows.
BOUNDS_PAY = 200


@dataclass(frozen=True, eq=False)
class _Bounds:
    """The contacts of one unknown alone, as the nearest lower and upper bound of each."""

    contacts: Indices  # those that are bounds
    lower: Vector  # (n,), infinite where there is none
    upper: Vector
    of_lower: Indices  # (n,) the contact of each bound, -1 where there is none
    of_upper: Indices

    def forces(self, problem: ContactProblem, solution: Any) -> Vector:
        """Return the contact forces (m,) of a solution with multipliers of rows and of bounds."""
        force = np.zeros(problem.contacts)
        if solution.z is not None and len(solution.z):
            force[np.delete(np.arange(problem.contacts), self.contacts)] = solution.z
        entry = np.zeros(problem.contacts)
        entry[self.contacts] = abs(problem.normal.data[problem.normal.indptr[self.contacts]])
        for contact, pushes in ((self.of_lower, -solution.z_box), (self.of_upper, solution.z_box)):
            acting = np.flatnonzero((contact >= 0) & (pushes > 0))
            force[contact[acting]] = pushes[acting] / entry[contact[acting]]
        return force


def _bounds(problem: ContactProblem) -> _Bounds | None:
    rows, n = problem.normal, problem.dimension
    contacts = np.flatnonzero(np.diff(rows.indptr) == 1)
    if not contacts.size:
        return None
    unknown, entry = rows.indices[rows.indptr[contacts]], rows.data[rows.indptr[contacts]]
    limit = problem.gap[contacts] / entry
    sides = []
    for taken, order in ((entry < 0, np.argsort(limit, kind="stable")), (entry > 0, np.argsort(-limit, kind="stable"))):
        order = order[taken[order]]  # the nearest of several bounds is written last
        value, contact = np.full(n, np.nan), np.full(n, -1)
        value[unknown[order]], contact[unknown[order]] = limit[order], contacts[order]
        sides.append((value, contact))
    (lower, of_lower), (upper, of_upper) = sides
    lower, upper = np.where(of_lower < 0, -np.inf, lower), np.where(of_upper < 0, np.inf, upper)
    return None if np.any(lower > upper) else _Bounds(contacts, lower, upper, of_lower, of_upper)


def _program(backend: Backend, problem: ContactProblem, bounds: _Bounds | None = None) -> Any:
    from qpsolvers import Problem

    # Copies, as some backends scale in place and do not accept read-only arrays.
    form = _dense if backend.dense and not (backend.sparse and sp.issparse(problem.stiffness)) else _sparse
    G, h = problem.normal, problem.gap.copy()
    if bounds is not None:
        others = np.delete(np.arange(problem.contacts), bounds.contacts)
        G, h = G[others], h[others]
    if problem.contacts == 0 and backend.needs_inequality:
        G, h = sp.csr_array((1, problem.dimension)), np.ones(1)  # the constraint 0'u <= 1 has no effect
    rows = [form(G), h] if h.size else [None, None]
    ties = [form(problem.tie), problem.tie_value.copy()] if problem.ties else [None, None]
    box = [None, None] if bounds is None else [bounds.lower, bounds.upper]
    return Problem(form(problem.stiffness), -problem.load, *rows, *ties, *box)


def _sparse(matrix: Any) -> Any:
    """Return a writable copy in CSC form, as some backends need."""
    return sp.csc_matrix(matrix, copy=True)


def _dense(matrix: Any) -> Any:
    # Row by row: pyqpmad factorises a column-ordered matrix in place, and qpsolvers uses it afterwards.
    return np.array(matrix.toarray() if sp.issparse(matrix) else matrix, order="C")


def _initial(backend: Backend, settings: Settings) -> Vector | None:
    # A start is optional, so it is dropped for backends that take none.
    if settings.warm_start is None or not backend.warm_start:
        return None
    return settings.warm_start.answer.displacement.copy()  # DAQP takes no array that it cannot write to


@cache
def hear_greeting(package: str) -> None:
    """Discard the version line that the first instance of HiGHS in a process always prints."""
    if package != "highspy":
        return
    import highspy

    with contextlib.suppress(AttributeError), silenced_output():
        highspy.Highs()  # type: ignore[no-untyped-call]


@contextlib.contextmanager
def collected_words() -> Iterator[list[str]]:
    """Collect the warnings and the output of a backend for the status of its answer."""
    words: list[str] = []
    with warnings.catch_warnings(record=True) as caught, contextlib.redirect_stdout(io.StringIO()) as printed:
        warnings.simplefilter("always")
        yield words
    # Deprecation warnings do not concern users; warnings about the answer are UserWarnings.
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
    return Candidate(Answer(displacement, force, None, tie_force), iterations, bool(solution.found), status)


def _values(values: Any, size: int, status: str) -> Vector:
    if values is None:
        raise BackendFailed(f"{status}: nothing was returned")
    vector = np.array(values, dtype=float).ravel()
    if vector.shape != (size,) or not np.all(np.isfinite(vector)):
        raise BackendFailed(f"{status}: expected {size} finite numbers, got {vector}")
    return vector


def _found(extras: Any, path: tuple[str, ...]) -> Any:
    """Return the value at a path of keys and attributes, or None."""
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
    """Return the method that calls a backend, scaled before and polished after the call."""
    return Method(
        name=backend.name,
        kind=QUADRATIC_PROGRAM,
        solve=partial(solve_quadratic_program, backend),
        polish=True,
        scale=True,
        semidefinite=backend.semidefinite,
        sparse=backend.sparse,
        timed=backend.time_limit is not None,
        knob="tolerance",
        packages=("qpsolvers", backend.package),
        install=backend.install,
        note=_note(backend),
    )


METHODS = tuple(method_of(backend) for backend in BACKENDS)
