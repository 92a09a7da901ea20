"""One rung tried: solved, timed, held against the truth, and written down as a row."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from contactqp.errors import (
    BackendFailed,
    BackendMissing,
    ContactQPError,
    NotCertified,
    NotConverged,
    Unsupported,
)
from contactqp.model.problem import CARRIED, MEASURED, ContactProblem
from contactqp.model.solution import FIGURES, Certificate, Solution
from contactqp.solving.solve import solve
from contactqp.study import rows
from contactqp.study.rows import Row
from contactqp.study.rungs import Rung, condensable
from contactqp.study.truth import ERROR_TOLERANCE, Errors, Truth

# A method is called wrong about itself only beyond this multiple of the tolerance that was asked of it.
GENEROSITY = 100.0
# A first call that takes longer [s] is its own timing: what it imports no longer matters beside it.
LONG = 2.0
# Seconds of timed calls after which a median is good enough.
ENOUGH = 0.05

# What a case expects that a solution misses; None where nothing was compared.
Judge = Callable[[Solution], Sequence[str] | None]
# From a problem, a method's name and its options to the last solution of a load path.
Walk = Callable[..., Solution]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one call of solve gave: a solution, an error, or an error that carries its solution."""

    solution: Solution | None
    error: ContactQPError | None
    seconds: float


@dataclass(frozen=True)
class Timing:
    """How long an answer takes."""

    seconds: float  # median of the repeats
    repeats: int  # 0: one call, which was its own warm-up


def attempt(problem: ContactProblem, rung: Rung, truth: Truth | None, repeats: int = 1) -> Row:
    """The row of one rung, answered and timed in this process."""
    row = answer(problem, rung, truth)
    if row.seconds is None or row.seconds >= LONG or not repeats:
        return row
    return timed(row, timing(problem, rung, row.seconds, repeats))


def answer(
    problem: ContactProblem,
    rung: Rung,
    truth: Truth | None,
    case: str = "",
    judge: Judge | None = None,
    walk: Walk | None = None,
) -> Row:
    """The row of one rung by its first call, whose time may have imports in it, or what else the machine did.

    Every call gets a fresh problem, so that nobody lives off another's factorisation. Where the answer depends on the
    way to it, with friction, `walk` is called in place of solve.
    """
    outcome = call(problem, rung, walk)
    unmet = judge(outcome.solution) if judge and outcome.solution and not outcome.error else None
    return _row(problem, rung, outcome, truth, case, unmet)


def timing(
    problem: ContactProblem, rung: Rung, first: float, repeats: int, walk: Walk | None = None, warm: bool = True
) -> Timing:
    """The time of one rung: the median of so many calls, fewer where they are long, or one very long call.

    Parameters
    ----------
    first : float
        What a call took before [s], in this process or another.
    warm : bool
        Whether what the method imports is here already; else one call is not timed.
    """
    if first >= LONG or not repeats:
        return Timing(call(problem, rung, walk).seconds, 0)
    if not warm:
        call(problem, rung, walk)
    times: list[float] = []
    while len(times) < repeats and sum(times) < ENOUGH:
        times.append(call(problem, rung, walk).seconds)
    return Timing(statistics.median(times), len(times))


def timed(row: Row, time: Timing) -> Row:
    """The row of an answer with its time."""
    return replace(row, seconds=time.seconds, repeats=time.repeats)


def crashed(problem: ContactProblem, rung: Rung, case: str, message: str) -> Row:
    """The row of a rung whose process died, or that never came to an end."""
    return Row(**_of_rung(problem, rung, case), verdict=rows.CRASHED, message=message)


def call(problem: ContactProblem, rung: Rung, walk: Walk | None = None) -> Outcome:
    """One timed call of solve, or of `walk`. Errors of contactqp are outcomes; all others are bugs and are not caught.

    The time is that to the answer; certifying it, and the raw answer behind it, is not the method's. That of a walk has
    the certificates of its steps in it.
    """
    fresh = _fresh(problem)
    solution: Solution | None = None
    error: ContactQPError | None = None
    started = time.perf_counter()
    try:
        solution = (walk or solve)(fresh, rung.method.name, **rung.options)
    except ContactQPError as raised:
        solution, error = getattr(raised, "solution", None), raised
    seconds = time.perf_counter() - started
    if solution is not None and walk is None:
        seconds = solution.seconds - solution.certify_seconds
    return Outcome(solution, error, seconds)


def _fresh(problem: ContactProblem) -> ContactProblem:
    """The same problem that shares no factorisation."""
    values = {f.name: getattr(problem, f.name) for f in fields(problem) if f.name not in (*MEASURED, *CARRIED)}
    return ContactProblem(**values)


def _row(
    problem: ContactProblem,
    rung: Rung,
    outcome: Outcome,
    truth: Truth | None,
    case: str,
    unmet: Sequence[str] | None,
) -> Row:
    solution = outcome.solution
    known = _of_rung(problem, rung, case)
    if not isinstance(outcome.error, BackendMissing | Unsupported):
        known |= dict(seconds=outcome.seconds)
    errors = raw_errors = None
    if solution is not None:
        raw = solution.raw
        if truth is not None:
            errors = truth.errors(solution.displacement, solution.normal_force, solution.tie_force)
            raw_errors = truth.errors(raw.displacement, raw.normal_force, raw.tie_force) if raw else None
        known |= _of_certificate(solution.certificate) | _of_work(solution)
    claimed = _claimed(rung, outcome)
    known |= _of_errors(errors, raw_errors)
    if errors is not None:
        known |= dict(error_asked=_asked(rung, errors))
    known |= dict(claimed=claimed, flag_wrong=_flag_wrong(rung, claimed, raw_errors or errors))
    if unmet is not None:
        known |= dict(expectations_unmet=len(unmet))
    message = _message(outcome, unmet)
    return Row(**known, verdict=_verdict(rung, outcome, errors), message=message)


def _of_rung(problem: ContactProblem, rung: Rung, case: str) -> dict[str, Any]:
    method = rung.method
    known: dict[str, Any] = dict(case=case, method=method.name, kind=method.kind, promises_exact=method.exact)
    known |= dict(variant=rung.variant, knob=rung.knob, knob_value=rung.value)
    return known | dict(condensed=_condensed(problem, rung), unknowns=problem.dimension, contacts=problem.contacts)


def _condensed(problem: ContactProblem, rung: Rung) -> str:
    if rung.whole:
        return rows.WHOLE
    return rows.CONDENSED if condensable(problem, rung.method) else ""


_OF_ERRORS = (
    (BackendMissing, rows.MISSING),
    (Unsupported, rows.UNSUPPORTED),
    (BackendFailed, rows.BACKEND_FAILED),
    (NotConverged, rows.NOT_CONVERGED),
    (ContactQPError, rows.REFUSED),
)


def _verdict(rung: Rung, outcome: Outcome, errors: Errors | None) -> str:
    if outcome.error is not None:
        return next(verdict for kind, verdict in _OF_ERRORS if isinstance(outcome.error, kind))
    if outcome.solution is None or not outcome.solution.certificate.passed:
        return rows.REFUSED if rung.method.exact else rows.APPROXIMATE
    return rows.RIGHT if errors is None or errors.small else rows.WRONG


def _claimed(rung: Rung, outcome: Outcome) -> bool | None:
    """Whether the method itself called its answer solved; the active set has no answer but the refined one."""
    solution = outcome.solution
    if solution is None or rung.method.kind == "active set":
        return None
    return solution.raw.claimed if solution.raw else not isinstance(outcome.error, NotConverged)


def _flag_wrong(rung: Rung, claimed: bool | None, errors: Errors | None) -> bool | None:
    """Claimed, and worse than both the certificate's error tolerance and what was asked of the method, generously."""
    if claimed is None or errors is None or not rung.method.exact:
        return None
    return claimed and errors.judged > _asked(rung, errors)


def _asked(rung: Rung, errors: Errors) -> float:
    return max(ERROR_TOLERANCE, GENEROSITY * rung.tolerance) + errors.allowance


def _of_certificate(certificate: Certificate) -> dict[str, Any]:
    worst = max(FIGURES, key=lambda name: float(getattr(certificate, name)))
    return dict(
        certificate_passed=certificate.passed,
        certificate_proven=certificate.proven,
        certificate_basis=certificate.basis,
        certificate_worst=_finite(getattr(certificate, worst)),
        certificate_figure=worst,
        bound_displacement=_finite(certificate.energy_error),
        bound_force=_finite(certificate.force_error),
    )


def _of_work(solution: Solution) -> dict[str, Any]:
    work = solution.work
    return dict(
        iterations=work.iterations,
        factorisations=work.factorisations,
        back_substitutions=work.back_substitutions,
        polish_corrections=work.polish_corrections,
    )


def _of_errors(errors: Errors | None, raw: Errors | None) -> dict[str, Any]:
    known: dict[str, Any] = {}
    if errors is not None:
        known |= dict(error_displacement=_finite(errors.displacement))
        known |= dict(error_displacement_max=_finite(errors.displacement_max))
        known |= dict(error_force=_finite(errors.force), error_measure=errors.measure)
        known |= dict(error_judged=_finite(errors.judged), error_allowed=errors.allowed)
    if raw is not None:
        known |= dict(raw_error_displacement=_finite(raw.displacement), raw_error_force=_finite(raw.force))
    return known


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def _message(outcome: Outcome, unmet: Sequence[str] | None) -> str:
    said = []
    if isinstance(outcome.error, BackendMissing):
        return str(outcome.error).rpartition(": ")[2]
    if unmet:
        said.append("expected otherwise: " + "; ".join(unmet))
    if outcome.error is not None:
        said.append(str(outcome.error))
    elif outcome.solution is not None:
        said.extend(outcome.solution.certificate.failures)
    if outcome.solution is not None and isinstance(outcome.error, NotCertified) and outcome.solution.raw is not None:
        said.append(f"raw: {outcome.solution.raw.status}")
    return "; ".join(said)
