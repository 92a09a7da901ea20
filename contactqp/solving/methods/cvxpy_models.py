"""State the contact problem in the modelling language cvxpy, as an independent route to a solver."""

from __future__ import annotations

import importlib
from dataclasses import replace
from typing import Any

import numpy as np

from contactqp.errors import BackendFailed, BackendMissing, InvalidProblem, Unsupported, of_backend, shown
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.methods.backends import BACKENDS, backend_options, collected_words, hear_greeting
from contactqp.solving.methods.method import MODELLING_LANGUAGE, Method, Settings

NAME = "cvxpy"


def solve_modelled(problem: ContactProblem, settings: Settings) -> Candidate:
    """Minimise 1/2 u'Ku - f'u over E_N u <= g, A u = b, stated in cvxpy; the forces are the dual values.

    cvxpy's dual of E_N u <= g is l_N >= 0, and that of A u == b is nu, in the signs of K u + E_N' l_N + A' nu = f.

    Raises BackendMissing, Unsupported: the solver is not installed; there is none of that name; BackendFailed: cvxpy or
    the solver raised, or found no values.

    Options
    -------
    solver : str, optional
        The name of a solver of cvxpy, Clarabel by default. Solvers that are also methods here get `settings.tolerance`;
        others run at their defaults.
    """
    cp = _cvxpy()
    solver = _solver(cp, settings.options.get("solver", "CLARABEL"))
    u = cp.Variable(problem.dimension)
    # K is positive semidefinite by construction; cvxpy's own test can fail by rounding.
    energy = 0.5 * cp.quad_form(u, cp.psd_wrap(problem.stiffness)) - problem.load @ u
    contacts = [problem.normal @ u <= problem.gap] if problem.contacts else []
    ties = [problem.tie @ u == problem.tie_value] if problem.ties else []
    model = cp.Problem(cp.Minimize(energy), contacts + ties)
    options = _options(solver, settings)
    if solver == "HIGHS":
        hear_greeting("highspy")
    with collected_words() as words, of_backend(f"{NAME}: {solver}"):
        model.solve(solver=solver, verbose=False, **options)
    status = "; ".join([f"{NAME}: {solver}: {model.status}", *words])
    answer = Answer(
        displacement=_values(u.value, problem.dimension, status),
        normal_force=_values(contacts[0].dual_value if contacts else (), problem.contacts, status),
        friction_force=None,
        tie_force=_values(ties[0].dual_value if ties else (), problem.ties, status),
    )
    return Candidate(answer, iterations=_iterations(model), claimed=model.status == cp.OPTIMAL, status=status)


def _cvxpy() -> Any:
    """Return the module cvxpy, untyped since half of its functions carry no annotations."""
    return importlib.import_module("cvxpy")


def _solver(cp: Any, name: Any) -> str:
    if not isinstance(name, str):
        raise InvalidProblem(f"{NAME}: solver: expected a name such as 'CLARABEL', got {shown(name)}")
    solver, installed = str.upper(name), cp.installed_solvers()
    if solver in installed:
        return solver
    if solver in cp.settings.SOLVERS:
        raise BackendMissing(f"{NAME}: solver {shown(name)} is not installed; installed are {', '.join(installed)}")
    raise Unsupported(f"{NAME}: no solver is called {shown(name)}; installed are {', '.join(installed)}")


def _options(solver: str, settings: Settings) -> dict[str, Any]:
    """Return the solver's keyword arguments from the table of backends, empty for solvers that are not in it."""
    for backend in BACKENDS:
        if backend.name.upper() == solver:
            return backend_options(backend, replace(settings, options={}))  # `solver` is cvxpy's own
    if settings.time_limit is not None or settings.max_iter is not None:
        raise Unsupported(f"{NAME}: solver {solver}: its keywords for limits of time and iterations are not known here")
    return {}


def _values(values: Any, size: int, status: str) -> Vector:
    vector = np.array([np.nan] if values is None else values, dtype=float).ravel()
    if vector.shape != (size,) or not np.all(np.isfinite(vector)):
        raise BackendFailed(f"{status}: no finite values")
    return vector


def _iterations(model: Any) -> int | None:
    count = model.solver_stats.num_iters if model.solver_stats is not None else None
    return None if count is None else int(count)


METHODS = (
    Method(
        name=NAME,
        kind=MODELLING_LANGUAGE,
        solve=solve_modelled,
        polish=True,
        scale=True,
        options=("solver",),
        knob="tolerance",
        packages=("cvxpy",),
        install="pip install cvxpy",
        note="an independent route: the energy is stated in cvxpy; any of its solvers",
    ),
)
