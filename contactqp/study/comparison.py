"""Solve by a method with a setting, time it and compare the answer with the truth; `compare` tries many methods."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from contactqp.certificate.idle_rows import ActingRows, acting_rows
from contactqp.certificate.number_range import near_one, refuse_far_from_one
from contactqp.errors import (
    BackendFailed,
    BackendMissing,
    ContactQPError,
    InvalidProblem,
    NotCertified,
    NotConverged,
    Unsupported,
    counted,
    shown,
)
from contactqp.linalg.iteration import contacts_are_many, iterated
from contactqp.model.arguments import checked
from contactqp.model.arrays import in_any_time, own_floating_point, stated_limit, time_is_up
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import FIGURES, Certificate, Solution
from contactqp.model.summary import Printed, RowsOf, finite
from contactqp.solving.methods import Method, meant_option, registered_name, takes, within_time_of
from contactqp.solving.methods.method import ACTIVE_SET
from contactqp.solving.solve import begin, solve
from contactqp.study import rows
from contactqp.study.rows import Row, as_dicts, brief_comparison, to_csv
from contactqp.study.settings import (
    STIFFNESSES,
    Setting,
    chosen_methods,
    condensable,
    contact_stiffness,
    single_settings,
)
from contactqp.study.truth import ERROR_TOLERANCE, Errors, Reference, Truth, truth_of, truth_of_reference

# A method's flag counts as wrong only if the error exceeds this multiple of the required tolerance.
GENEROSITY = 100.0
# A first call that takes longer [s] is used as the timing, since imports are then negligible.
LONG = 2.0
# The most calls of a setting that are timed in one turn, and the seconds of a turn.
VISIT_CALLS, VISIT = 2, 5e-3
# The least number of run times for which a spread is given.
FEWEST_SPREAD = 2

# Maps a solution to the expectations of its case that it misses; None where nothing was compared.
Judge = Callable[[Solution], Sequence[str] | None]
# Maps a problem, a method's name and its options to the last solution of a load path or a motion.
FollowHistory = Callable[..., Solution]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of one call of solve: a solution, an error, or an error that carries its solution."""

    solution: Solution | None
    error: ContactQPError | None
    seconds: float


@dataclass(frozen=True)
class Timing:
    """Run times of one setting [s], one for each call after the warm-up."""

    seconds: tuple[float, ...]
    warm: bool = True  # False for a single call, which included the warm-up


def attempt(problem: ContactProblem, setting: Setting, truth: Truth | None) -> Row:
    """Solve with one setting in this process, and time it by calls after the first unless that took seconds.

    Errors are measured against `truth`; without one they are None. After the time limit of the call nothing is tried.
    """
    if time_is_up() and setting.method.installed:
        name, late = setting.method.name, f"not tried: the time limit of {stated_limit(None)} was over"
        return Row(method=name, kind=setting.method.kind, verdict=rows.NOT_CONVERGED, message=late)
    row = answer(problem, setting, truth)
    if row.seconds is None or row.seconds >= LONG or time_is_up():
        return row
    times = timing(problem, setting, row.seconds)
    return row if time_is_up() else timed(row, [times])


def answer(
    problem: ContactProblem,
    setting: Setting,
    truth: Truth | None,
    case: str = "",
    judge: Judge | None = None,
    follow: FollowHistory | None = None,
) -> Row:
    """Return the row of one setting by its first call, whose time may include imports.

    Every call gets a fresh problem, so that no method profits from the factorisation of another.

    Parameters
    ----------
    problem : ContactProblem
    setting : Setting
    truth : Truth or None
        The solution that errors are measured against; without one they are None.
    case : str
        Name of the case, for the row.
    judge : callable, optional
        Returns the expectations of the case that a solution misses.
    follow : callable, optional
        Called in place of solve where the answer depends on the history that leads to it.
    """
    outcome = call(problem, setting, follow)
    with in_any_time():
        return _row(problem, setting, outcome, truth, case, judge)


def timing(
    problem: ContactProblem,
    setting: Setting,
    first: float,
    follow: FollowHistory | None = None,
    warm: bool = True,
) -> Timing:
    """Return run times of one setting: those of a few short calls, or of one long call.

    Parameters
    ----------
    problem : ContactProblem
    setting : Setting
    first : time that a call took before [s], in this process or another
    follow : callable, optional
        Called in place of solve where the answer depends on the history that leads to it.
    warm : whether the modules of the method are imported already; else a first call is not timed
    """
    if first >= LONG:
        return Timing((_seconds(problem, setting, follow),), warm=False)
    if not warm:
        _seconds(problem, setting, follow)
    times: list[float] = []
    while len(times) < VISIT_CALLS and sum(times) < VISIT:
        times.append(_seconds(problem, setting, follow))
    return Timing(tuple(times))


def _seconds(problem: ContactProblem, setting: Setting, follow: FollowHistory | None) -> float:
    """Return the time of one call to the answer [s], whose certificate the row has from another call."""
    if follow is None and isinstance(problem, ContactProblem):
        try:
            seconds = _seconds_to_answer(problem._without_results(), setting.method.name, **setting.options)
        except ContactQPError:
            seconds = None
        if seconds is not None:
            return seconds
    return call(problem, setting, follow).seconds


def timed(row: Row, timings: Sequence[Timing]) -> Row:
    """Return the row with the median of its run times, and their spread where there are several."""
    times = [seconds for one in timings for seconds in one.seconds]
    middle = statistics.median(times)
    warm = sum(len(one.seconds) for one in timings if one.warm)
    return replace(row, seconds=middle, repeats=warm, seconds_spread=_spread(times))


def _spread(times: Sequence[float]) -> float | None:
    """Return the distance of the quartiles over the median, None of a single one.

    >>> _spread([1.0, 2.0, 2.0, 3.0])
    0.25
    """
    if len(times) < FEWEST_SPREAD:
        return None
    lower, middle, upper = statistics.quantiles(times, n=4, method="inclusive")
    return (upper - lower) / middle


def crashed(problem: ContactProblem, setting: Setting, case: str, message: str) -> Row:
    """Return the row of a setting whose process died or was stopped.

    Parameters
    ----------
    problem : ContactProblem
    setting : Setting
    case : str
        Name of the case.
    message : str
        Why there is no answer.
    """
    return Row(**_setting_columns(problem, setting, case), verdict=rows.CRASHED, message=message)


def call(problem: ContactProblem, setting: Setting, follow: FollowHistory | None = None) -> Outcome:
    """Call solve once, or `follow`, and time it.

    Errors of contactqp are outcomes; all others are bugs and are not caught. The time [s] excludes the certificate and
    the raw answer, except in `follow`, where each step is certified.
    """
    fresh = problem._without_results()  # a copy without shared factorisations
    solution: Solution | None = None
    error: ContactQPError | None = None
    started = time.perf_counter()
    try:
        solution = (follow or solve)(fresh, setting.method.name, **setting.options)
    except ContactQPError as raised:
        solution, error = getattr(raised, "solution", None), raised
    seconds = time.perf_counter() - started
    if solution is not None and follow is None:
        seconds = solution.seconds - solution.certify_seconds
    return Outcome(solution, error, seconds)


def _row(
    problem: ContactProblem,
    setting: Setting,
    outcome: Outcome,
    truth: Truth | None,
    case: str,
    judge: Judge | None,
) -> Row:
    solution = outcome.solution
    unmet = judge(solution) if judge and solution and not outcome.error else None
    columns = _setting_columns(problem, setting, case)
    if not isinstance(outcome.error, BackendMissing | Unsupported):
        columns |= dict(seconds=outcome.seconds)
    errors = raw_errors = None
    if solution is not None:
        raw = solution.raw
        if truth is not None:
            errors = truth.errors(solution.displacement, solution.normal_force, solution.tie_force)
            raw_errors = truth.errors(raw.displacement, raw.normal_force, raw.tie_force) if raw else None
        columns |= _certificate_columns(solution.certificate) | _work_columns(solution)
    claimed = _claimed(setting, outcome)
    columns |= _error_columns(errors, raw_errors)
    if errors is not None:
        columns |= dict(error_asked=_asked(setting, errors))
    columns |= dict(claimed=claimed, flag_wrong=_flag_wrong(setting, claimed, raw_errors or errors))
    if unmet is not None:
        columns |= dict(expectations_unmet=len(unmet))
    return Row(**columns, verdict=_verdict(setting, outcome, errors), message=_message(outcome, unmet))


def _setting_columns(problem: ContactProblem, setting: Setting, case: str) -> dict[str, Any]:
    method = setting.method
    condensed = rows.CONDENSED if condensable(problem, method) else ""
    return dict(
        case=case,
        method=method.name,
        kind=method.kind,
        promises_exact=method.exact,
        variant=setting.variant,
        condensed=rows.WHOLE if setting.whole else condensed,
        knob=setting.knob,
        knob_value=setting.value,
        knob_stiffnesses=_stiffnesses(problem, setting),
        unknowns=problem.dimension,
        contacts=problem.contacts,
    )


def _stiffnesses(problem: ContactProblem, setting: Setting) -> float | None:
    if setting.knob not in STIFFNESSES or setting.value is None:
        return None
    stiffnesses = setting.value / contact_stiffness(problem)
    return stiffnesses if math.isfinite(stiffnesses) else None


_VERDICTS_OF_ERRORS = (
    (BackendMissing, rows.MISSING),
    (Unsupported, rows.UNSUPPORTED),
    (BackendFailed, rows.BACKEND_FAILED),
    (NotConverged, rows.NOT_CONVERGED),
    (ContactQPError, rows.REFUSED),
)


def _verdict(setting: Setting, outcome: Outcome, errors: Errors | None) -> str:
    if outcome.error is not None:
        return next(verdict for kind, verdict in _VERDICTS_OF_ERRORS if isinstance(outcome.error, kind))
    if outcome.solution is None or not outcome.solution.certificate.passed:
        return rows.REFUSED if setting.method.exact else rows.APPROXIMATE
    return rows.RIGHT if errors is None or errors.small else rows.WRONG


def _claimed(setting: Setting, outcome: Outcome) -> bool | None:
    """Return the method's own flag "solved", None for the active set, whose answer is refined."""
    solution = outcome.solution
    if solution is None or setting.method.kind == ACTIVE_SET:
        return None
    return solution.raw.claimed if solution.raw else not isinstance(outcome.error, NotConverged)


def _flag_wrong(setting: Setting, claimed: bool | None, errors: Errors | None) -> bool | None:
    """Return whether an answer was flagged as solved although its error exceeds the error tolerance and what was
    asked.
    """
    if claimed is None or errors is None or not setting.method.exact:
        return None
    return claimed and errors.judged > _asked(setting, errors)


def _asked(setting: Setting, errors: Errors) -> float:
    return max(ERROR_TOLERANCE, GENEROSITY * setting.tolerance) + errors.allowance


def _certificate_columns(certificate: Certificate) -> dict[str, Any]:
    worst = max(FIGURES, key=lambda name: float(getattr(certificate, name)))
    return dict(
        certificate_passed=certificate.passed,
        certificate_proven=certificate.proven,
        certificate_basis=certificate.basis,
        certificate_worst=finite(getattr(certificate, worst)),
        certificate_figure=worst,
        bound_displacement=finite(certificate.energy_error),
        bound_force=finite(certificate.force_error),
    )


def _work_columns(solution: Solution) -> dict[str, Any]:
    work = solution.work
    return dict(
        iterations=work.iterations,
        factorisations=work.factorisations,
        back_substitutions=work.back_substitutions,
        polish_corrections=work.polish_corrections,
    )


def _error_columns(errors: Errors | None, raw: Errors | None) -> dict[str, Any]:
    columns: dict[str, Any] = {}
    if errors is not None:
        columns |= dict(
            error_displacement=finite(errors.displacement),
            error_displacement_max=finite(errors.displacement_max),
            error_force=finite(errors.force),
            error_measure=errors.measure,
            error_judged=finite(errors.judged),
            error_allowed=errors.allowed,
        )
    if raw is not None:
        columns |= dict(raw_error_displacement=finite(raw.displacement), raw_error_force=finite(raw.force))
    return columns


def _message(outcome: Outcome, unmet: Sequence[str] | None) -> str:
    if isinstance(outcome.error, BackendMissing):
        return str(outcome.error).rpartition(": ")[2]
    messages = ["expected otherwise: " + "; ".join(unmet)] if unmet else []
    if outcome.error is not None:
        messages.append(str(outcome.error))
    elif outcome.solution is not None:
        messages.extend(outcome.solution.certificate.failures)
    if outcome.solution is not None and isinstance(outcome.error, NotCertified) and outcome.solution.raw is not None:
        messages.append(f"raw: {outcome.solution.raw.status}")
    return "; ".join(messages)


@dataclass(frozen=True)
class Comparison(Printed, RowsOf[Row]):
    """The table of `compare`, with one row for each method and value of its knob; `str` prints it."""

    rows: tuple[Row, ...]
    truth: str  # the source of the reference solution

    def __repr__(self) -> str:
        return f"Comparison({counted('row', len(self))} against {self.truth})"

    def __str__(self) -> str:
        return brief_comparison(self.rows, self.truth)

    def to_dicts(self) -> list[dict[str, Any]]:
        """Return rows as plain data; `contactqp.study.rows.COLUMNS` has the meaning of each key."""
        return as_dicts(self.rows)

    def to_csv(self) -> str:
        """Return comma-separated values with a header."""
        return to_csv(self.rows)


HOW_OPTIONS = "options are keywords, penalty=1e4, several values of a knob knobs={'penalty': [1e4, 1e6]}"


@checked
@own_floating_point
def compare(
    problem: ContactProblem,
    methods: str | Sequence[Any] | None = None,
    reference: Reference | None = None,
    *,
    knobs: Mapping[str, Sequence[float]] | None = None,
    **options: Any,
) -> Comparison:
    """Solve one problem by many methods and compare every answer with the truth.

    Parameters
    ----------
    problem : ContactProblem
    methods : name or sequence of names, optional
        All of `contactqp.methods()` by default; those that are not installed are listed as missing.
    reference : Solution, or (displacement, normal_force[, tie_force]), optional
        The truth. By default the active-set solution, if its certificate proves it; without a truth, errors are None.
    knobs : mapping of method names to values, optional
        Values of the knobs. By default penalty and perturbation, which have no default, go through 1e1 ... 1e6 times
        the contact stiffness (`contactqp.study.settings.contact_stiffness`); the others are run as `solve` runs them.
    **options
        Options of `solve`, each for the methods that take it: ``penalty=1e4``, ``tolerance=1e-6``. ``time_limit`` [s]
        is that of the whole comparison, the default reference included. Methods are tried in the order of `methods`;
        those whose turn does not come have rows that say so, and backends without a time limit of their own are not
        run.

    Returns
    -------
    Comparison
        A method that fails is a row with the reason, not an exception. Each method is called twice and the second call
        is timed, without its certificate, unless the first one takes seconds.

    Raises
    ------
    Unsupported
        There is no method of that name.
    InvalidProblem
        Methods are not names; the reference has wrong shapes; a knob is given for a method that is not compared or has
        none; an option that none of the methods takes.

    Examples
    --------
    >>> import contactqp as cq
    >>> wall = cq.ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])
    >>> table = cq.compare(wall, methods=["active-set", "penalty"], knobs={"penalty": [1e8]})
    >>> [(row.method, row.verdict, f"{row.error_force:.0e}") for row in table]
    [('active-set', 'right', '0e+00'), ('penalty', 'approximate', '2e-03')]
    """
    for name in () if methods is None or isinstance(methods, str) else methods:
        if not isinstance(name, str):
            raise InvalidProblem(f"compare: methods: expected names, got {shown(name)}; {HOW_OPTIONS}")
    chosen = chosen_methods(methods)
    values = dict(knobs or {})
    for name in values:
        if name not in {method.name for method in chosen if method.knob}:
            raise InvalidProblem(f"knobs: {name!r} is not a compared method with a knob")
    for name in options:
        if not any(takes(method.name, name) for method in chosen):
            known = [option for method in chosen for option in method.options]
            raise InvalidProblem(f"compare: none of the methods takes an option {name!r}{meant_option(name, known)}")
    refuse_far_from_one("compare", problem)
    with within_time_of(options):
        if (rows := acting_rows(problem)) is not None and rows.met:
            problem, reference = rows.problem, None if reference is None else _on_acting_rows(rows, reference)
        truth = truth_of(problem, reference)
        settings = (setting for method in chosen for setting in _settings(problem, method, values, options))
        unknown = "nothing, as no answer is proven to be the only one; reference= states what to compare with"
        source = unknown if truth is None else truth.source
        return Comparison(tuple(attempt(problem, setting, truth) for setting in settings), source)


def _settings(
    problem: ContactProblem, method: Method, knobs: Mapping[str, Sequence[float]], options: Mapping[str, Any]
) -> Iterator[Setting]:
    """Yield the settings of a method: the values of its parameter, each with the other options that it takes."""
    if time_is_up():
        yield Setting(method)
        return
    own = {name: value for name, value in options.items() if takes(method.name, name)}
    values = knobs.get(method.name)
    if values is None and method.knob in own:
        values = [own.pop(method.knob)]
    for setting in single_settings(problem, method, values):
        yield replace(setting, options={**setting.options, **own})


def _on_acting_rows(rows: ActingRows, reference: Reference) -> Reference:
    """Return a reference of the whole problem restricted to the rows that constrain something."""
    whole = truth_of_reference(rows.whole, reference)
    ties = () if whole.tie_force is None else (whole.tie_force[rows.ties],)
    return (whole.displacement, whole.normal_force[rows.contacts], *ties)


@own_floating_point
def _seconds_to_answer(problem: ContactProblem, method: str, **arguments: Any) -> float | None:
    """Run a method as `solve` does, and return the seconds to its answer, which is dropped instead of certified.

    None where `solve` does more than run it: with friction, rows that constrain nothing, numbers that take other units,
    or so many contacts that it begins with some of them.
    """
    if problem.frictional or problem.has_idle_rows or contacts_are_many(problem):
        return None
    if near_one(problem) is not None or iterated(problem):
        return None
    return begin(problem, registered_name(method), **arguments).seconds_to_answer()
