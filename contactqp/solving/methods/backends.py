"""The backends of qpsolvers: what each takes and gives, as one table.

Left out: quadprog, ECOS, CVXOPT and KVXOPT (GPL; the first two also refuse a semidefinite stiffness), MOSEK (qpsolvers
reaches it through CVXOPT only), COPT (prints its licence search to the terminal at every call, and calls unbounded
problems solved), qpax and jaxopt (single precision unless the whole process is switched), PDHCG, HPIPM, qpSWIFT,
qpOASES and NPPro (no wheels to install).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from contactqp.errors import Unsupported
from contactqp.solving.methods.method import Settings


@dataclass(frozen=True)
class Backend:
    """What one backend of qpsolvers takes and gives. Every keyword here is the backend's own."""

    name: str  # qpsolvers' name, and ours
    package: str  # the module that has to be importable
    install: str
    tolerances: tuple[str, ...]  # keywords that receive Settings.tolerance
    tightest: float = 0.0  # the smallest tolerance it accepts; smaller ones it would ignore without a word
    iteration_limit: str = "max_iter"
    default_limit: int | None = None  # where the backend's own default stops too early
    time_limit: str | None = None  # keyword that receives seconds; None: the backend knows no time limit
    sparse: bool = True  # which matrices it takes: a dense stiffness is handed over dense where it may
    dense: bool = False
    semidefinite: bool = True
    needs_inequality: bool = False  # without inequality rows it, or qpsolvers in its place, does something else
    warm_start: bool = False  # takes a displacement to start from
    fixed: tuple[tuple[str, Any], ...] = ()  # settings that are always made, each with its reason beside it
    status: tuple[str, ...] = ()  # where its own words are in Solution.extras
    iterations: tuple[str, ...] = ()  # where its count of them is there; empty: qpsolvers does not hand it on
    note: str = ""


BACKENDS = (
    Backend(
        "osqp",
        "osqp",
        "pip install contactqp",
        # Infeasibility at its default of 1e-4 is declared of stiff problems that have an answer. Its own polish is off
        # by default and stays off: a raw answer is to be raw.
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
        "pip install contactqp",
        # Its defaults of 1e-8 leave multiplier errors of 4e-3 on stiff problems.
        tolerances=("tol_gap_abs", "tol_gap_rel", "tol_feas", "tol_infeas_abs", "tol_infeas_rel"),
        time_limit="time_limit",
        needs_inequality=True,  # an unconstrained problem goes to SciPy's LSQR with its tolerance of 1e-6
        status=("status",),
    ),
    Backend(
        "piqp",
        "piqp",
        "pip install 'contactqp[backends]'",
        tolerances=("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"),
        dense=True,
        status=("info", "status"),
        iterations=("info", "iter"),
    ),
    Backend(
        "proxqp",
        "proxsuite",
        "pip install 'contactqp[backends]'",
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
        "pip install 'contactqp[backends]'",
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
        "pip install 'contactqp[backends]'",
        tolerances=("primal_feasibility_tolerance", "dual_feasibility_tolerance"),
        tightest=1e-10,
        iteration_limit="qp_iteration_limit",
        time_limit="time_limit",
        # Added to the stiffness. Its default of 1e-7 spoils forces and calls unbounded problems solved; without any it
        # gives up on floating bodies.
        fixed=(("qp_regularization_value", 1e-12),),
    ),
    Backend(
        "scs",
        "scs",
        "pip install 'contactqp[backends]'",
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
        "pip install 'contactqp[backends]'",
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
    """The keywords for one call, in the backend's own words."""
    options = dict(backend.fixed)
    options.update(dict.fromkeys(backend.tolerances, max(settings.tolerance, backend.tightest)))
    limit = settings.max_iter or backend.default_limit
    if limit is not None:
        options[backend.iteration_limit] = int(limit)
    if settings.time_limit is not None:
        if backend.time_limit is None:
            raise Unsupported(f"{backend.name}: this backend has no time limit")
        options[backend.time_limit] = float(settings.time_limit)
    return options
