"""The stability study: its axes, its cells (one method at one value of an axis), and the rows that they become."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from contactqp.certificate.bounds import REDUNDANT
from contactqp.certificate.uniqueness import FORCES, SEVERAL
from contactqp.errors import InvalidProblem
from contactqp.model.solution import Solution
from contactqp.model.summary import finite
from contactqp.solving.methods import Method
from contactqp.solving.sparse_run import has_sparse_systems
from contactqp.study import rows as report_rows
from contactqp.study.comparison import answer
from contactqp.study.rows import Row, as_dicts, column, columns_of
from contactqp.study.running.journal import Cell as RunningCell
from contactqp.study.running.journal import Crash
from contactqp.study.settings import DEFAULT_TOLERANCE, Setting, chosen_methods, contact_stiffness
from contactqp.study.stability import body_axes, problem_axes
from contactqp.study.stability.axis_problem import UNIT_ROUNDOFF, Axis, AxisProblem, Prediction, SweptTruth, predict
from contactqp.study.truth import ERROR_TOLERANCE

# The rounding of the truth to doubles, which may add to an error that equals its bound.
ROUNDING_OF_TRUTH = 1e-12

AXES: tuple[Axis, ...] = (
    problem_axes.PENALTY_STIFFNESS,
    body_axes.STIFFNESS_CONTRAST,
    body_axes.SINGULAR_STIFFNESS,
    body_axes.MESH_GRADING,
    body_axes.GAP_RATIO,
    body_axes.LOAD_RATIO,
    body_axes.GRAZING,
    problem_axes.REDUNDANCY,
    problem_axes.FRICTION,
    problem_axes.INCLINE,
    body_axes.MASS_RATIO,
    problem_axes.UNIT_SYSTEMS,
    problem_axes.CONTACTS,
    problem_axes.CLOSED_CONTACTS,
)


def find_axis(name: str) -> Axis:
    """Return the axis of that name.

    Raises InvalidProblem: there is none; the message lists the names.
    """
    for axis in AXES:
        if axis.name == name:
            return axis
    raise InvalidProblem(f"stability: no axis is called {name!r}; expected {', '.join(axis.name for axis in AXES)}")


CUT_OFF, STATED = "cut off", "stated"
VERDICTS: Mapping[str, str] = {
    **report_rows.VERDICTS,
    STATED: (
        "the certificate passes, the true error is above 1e-6, and the certificate says so itself: its force bound "
        "is as large, or it says that single forces cannot be told apart, or that there are other equilibria"
    ),
    CUT_OFF: (
        "not tried: dense matrices of this method would take more memory than the study allows; the message says how "
        "much"
    ),
}
# All digits of a double.
ALL_DIGITS = -math.log10(UNIT_ROUNDOFF)


def digits_lost(error: float | None) -> float | None:
    """Return log₁₀ of the error over 2⁻⁵³, from 0 to 15.95, where no digit is right; None without an error."""
    if error is None or math.isnan(error):
        return None
    if error <= UNIT_ROUNDOFF:
        return 0.0
    return min(math.log10(error) + ALL_DIGITS, ALL_DIGITS) if math.isfinite(error) else ALL_DIGITS


@dataclass(frozen=True)
class StabilityRow:
    """One method at one value of an axis. What does not apply, or is not finite, is None."""

    axis: str = column("name of the axis", "")
    value: float = column("where on the axis; of units, their place in the list", 0.0)
    label: str = column("the value in words", "")
    method: str = column("name of the method", "")
    kind: str = column("family of the method", "")
    promises_exact: bool = column("whether the method promises the exact answer, or is approximate by design", True)
    variant: str = column("uzawa, or empty: the method as solve runs it", "")
    knob: str = column("tolerance, penalty or perturbation, where the method has such a knob", "")
    knob_value: float | None = column("its value, in the problem's units")
    unknowns: int = column("n", 0)
    contacts: int = column("m", 0)
    equilibria: int | None = column("how many answers the problem has; none: one, as the problem is convex")
    verdict: str = column("one of the verdicts listed below", "")
    error_displacement: float | None = column(
        "true error in u: energy norm, and where K is singular the largest unknown, relative"
    )
    error_force: float | None = column("largest true error of a contact force, relative to the largest force")
    error_measure: str = column("relative, or which errors are measured otherwise, and why", "")
    largest_force: float | None = column("the largest contact force that was returned, in the problem's units")
    digits_lost_displacement: float | None = column("log₁₀ of error_displacement over 2⁻⁵³, from 0 to 15.95")
    digits_lost_force: float | None = column("log₁₀ of error_force over 2⁻⁵³, from 0 to 15.95")
    raw_digits_lost_displacement: float | None = column("the same of u before polish, where the answer was polished")
    raw_digits_lost_force: float | None = column("the same of λ before polish, where the answer was polished")
    refused_right: bool | None = column("the method was refused, or gave up, and its answer is right to 1e-6")
    claimed: bool | None = column("whether the method itself called its raw answer solved")
    flag_wrong: bool | None = column("the method called its raw answer solved, and that is wrong")
    certificate_passed: bool | None = column("verdict of the certificate")
    bound_force: float | None = column("the certificate's bound on the relative error in the forces, energy norm")
    system: str = column("the matrix that the method factorises for the right contacts", "")
    condition: float | None = column("its condition number κ = ‖A‖₂ ‖A⁻¹‖₂, by an inverse in rational numbers")
    condition_missing: str = column("why there is no condition number", "")
    predicted_digits_lost: float | None = column("log₁₀ of the condition number")
    force_condition: float | None = column(
        "Skeel's condition number of the forces: what relative changes of one part in all entries make of them"
    )
    predicted_modelling: float | None = column("relative error in λ by β or κ in exact arithmetic, S / (S + β)")
    predicted_error_force: float | None = column(
        "predicted_modelling, and rounding: β ulp / λ of the penalty method, 2⁻⁵³ force_condition of the others"
    )
    seconds: float | None = column("run time of one call, certificate not included")
    message: str = column("what the method, the certificate or the error says", "")

    @property
    def name(self) -> str:
        """Return the method with its variant."""
        return f"{self.method} ({self.variant})" if self.variant else self.method

    @property
    def error(self) -> float | None:
        """Return the larger of the errors in u and in λ."""
        return max((x for x in (self.error_displacement, self.error_force) if x is not None), default=None)

    @property
    def right(self) -> bool:
        """Return whether the outcome is right."""
        return self.verdict == report_rows.RIGHT

    @property
    def wrong(self) -> bool:
        """Return whether the certificate passed a wrong answer, which must never happen."""
        return self.verdict == report_rows.WRONG


COLUMNS: Mapping[str, str] = columns_of(StabilityRow)


def is_small(error: float | None) -> bool:
    """Return whether a certificate must pass an answer with this error."""
    return error is not None and error <= ERROR_TOLERANCE


def short_dicts(rows: Iterable[StabilityRow]) -> list[dict[str, Any]]:
    """Return rows as plain data without empty entries: `StabilityRow(**row)` makes the row again."""
    empty = asdict(StabilityRow())
    return [{key: value for key, value in row.items() if value != empty[key]} for row in as_dicts(rows)]


def to_csv(rows: Iterable[StabilityRow]) -> str:
    """Return comma-separated values with a header; numbers have all their digits, None is empty."""
    return report_rows.to_csv(rows, COLUMNS)


# β and κ beside the contact stiffness where the axis is not theirs: a modelling error of 1e-6.
STIFFENING = 1e6
# Bytes of a dense matrix of all contacts beyond which methods that make some are cut off: a process stays below 2 GB.
LARGEST_MATRIX = 2e8
# Seconds for methods that can stop; nearly all cells take milliseconds.
PATIENCE = 5.0


@dataclass(frozen=True)
class Cell:
    """One row to be computed by `stability_row(*arguments)`."""

    axis: str
    value: float
    method: str
    variant: str = ""

    @property
    def key(self) -> str:
        """Return the name of the cell, the same in every run."""
        return f"stability/{self.axis}={self.value!r}/{self.method}{'/' if self.variant else ''}{self.variant}"

    @property
    def arguments(self) -> tuple[str, float, str, str]:
        """Return the arguments of `stability_row`."""
        return self.axis, self.value, self.method, self.variant


def cells(axes: Sequence[Axis] = AXES, methods: Sequence[str] | None = None) -> Iterator[Cell]:
    """Yield every method at every value of every axis, missing methods too; an axis of a knob has its methods only."""
    for axis in axes:
        for value in axis.values:
            for method in chosen_methods(methods):
                if axis.knobs and method.name not in axis.knobs:
                    continue
                yield Cell(axis.name, value, method.name)
                if axis.knobs and "update" in method.options:
                    yield Cell(axis.name, value, method.name, "uzawa")


# Axes whose values are numbers of contacts, and how many of them double the time of a cell; the others' are small.
SIZES, DOUBLING = (problem_axes.CONTACTS.name, problem_axes.CLOSED_CONTACTS.name), 50


def runnable(cell: Cell) -> RunningCell:
    """Return the cell in the form in which `run_cells` takes it, with its cost relative to that of a small problem."""
    cost = 1 + (cell.value / DOUBLING if cell.axis in SIZES else 0.0)
    return RunningCell(cell.key, stability_row, cell.arguments, StabilityRow, cost=cost)


def row_of(cell: Cell, found: StabilityRow | Crash) -> StabilityRow:
    """Return the row of a cell, or of the crash that ended it."""
    if not isinstance(found, Crash):
        return found
    axis, [method] = find_axis(cell.axis), chosen_methods([cell.method])
    columns = _cell_columns(axis, cell.value, method, cell.variant)
    return StabilityRow(**columns, verdict=report_rows.CRASHED, message=found.message)


def _cell_columns(axis: Axis, value: float, method: Method, variant: str) -> dict[str, Any]:
    return dict(
        axis=axis.name,
        value=value,
        label=axis.label(value),
        method=method.name,
        kind=method.kind,
        promises_exact=method.exact,
        variant=variant,
    )


def stability_row(axis: str, value: float, method: str, variant: str = "") -> StabilityRow:
    """Solve the problem at one value of an axis by one method, and compare the answer with the truth and prediction.

    Parameters
    ----------
    axis : name of the axis
    value : one of its values
    method : name of the method
    variant : "uzawa" or empty
    """
    swept, [chosen] = find_axis(axis), chosen_methods([method])
    columns = _cell_columns(swept, value, chosen, variant)
    posed = _axis_problem(axis, value)
    if chosen.installed and (message := too_large(posed.problem.contacts, chosen)):
        return StabilityRow(**columns, **_problem_columns(posed), verdict=CUT_OFF, message=message)
    setting = _setting(posed, swept, value, chosen, variant)
    solutions: list[Solution] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # numbers overflow at the ends of some axes: that is swept
        found = answer(posed.problem, setting, posed.truth, judge=solutions.append)
    stiffness = None if setting.knob == "tolerance" else setting.value
    prediction = predict(posed, chosen, variant, stiffness) if chosen.installed else Prediction("")
    return StabilityRow(
        **columns,
        **_problem_columns(posed),
        **_attempt_columns(found, posed, solutions),
        **_prediction_columns(prediction),
    )


def too_large(contacts: int, method: Method) -> str:
    """Return why a method is not tried on so many contacts; empty where it is.

    Methods that condense onto all contacts hold several dense matrices of them at a time; the others work on sparse
    systems there.
    """
    size = 8 * contacts**2
    if has_sparse_systems(method) or size <= LARGEST_MATRIX:
        return ""
    return f"a dense matrix of {contacts} contacts takes {size / 1e9:.3g} GB, and this method makes several of them"


@lru_cache(maxsize=4)
def _axis_problem(axis: str, value: float) -> AxisProblem:
    return find_axis(axis).pose(value)


def _setting(posed: AxisProblem, axis: Axis, value: float, method: Method, variant: str) -> Setting:
    options: dict[str, Any] = {}
    if method.knob == "tolerance" and "no time limit" not in method.note:
        options["time_limit"] = PATIENCE
    if variant:
        options["update"] = variant
    knob = axis.knobs.get(method.name) or (method.required[0] if method.required else method.knob or "")
    if method.knob == "tolerance":
        return Setting(method, "polished", knob, DEFAULT_TOLERANCE, options | {knob: DEFAULT_TOLERANCE})
    if axis.knobs or method.required:
        size = value if axis.knobs else float(f"{STIFFENING * contact_stiffness(posed.problem):.1e}")
        return Setting(method, variant, knob, size, options | {knob: size})
    return Setting(method, variant, knob, None, options)


def _problem_columns(posed: AxisProblem) -> dict[str, Any]:
    count = len(posed.exact) if posed.problem.frictional else None
    return dict(unknowns=posed.problem.dimension, contacts=posed.problem.contacts, equilibria=count)


def _attempt_columns(found: Row, posed: AxisProblem, solutions: Sequence[Solution]) -> dict[str, Any]:
    verdict, statement = _verdict(found, posed, solutions)
    columns: dict[str, Any] = dict(
        knob=found.knob,
        knob_value=found.knob_value,
        verdict=verdict,
        error_displacement=found.error_displacement,
        error_force=found.error_force,
        error_measure=found.error_measure,
        digits_lost_displacement=digits_lost(found.error_displacement),
        digits_lost_force=digits_lost(found.error_force),
        raw_digits_lost_displacement=digits_lost(found.raw_error_displacement),
        raw_digits_lost_force=digits_lost(found.raw_error_force),
        claimed=found.claimed,
        flag_wrong=found.flag_wrong,
        certificate_passed=found.certificate_passed,
        bound_force=found.bound_force,
        seconds=found.seconds,
        message=statement or found.message,
    )
    if solutions:
        columns["largest_force"] = finite(float(np.max(solutions[0].normal_force, initial=0.0)))
    refused = found.verdict in (report_rows.REFUSED, report_rows.NOT_CONVERGED)
    if refused and posed.truth.exists and found.error_displacement is not None:
        columns["refused_right"] = is_small(found.error_displacement) and is_small(found.error_force)
    return columns


def _verdict(found: Row, posed: AxisProblem, solutions: Sequence[Solution]) -> tuple[str, str]:
    """Return the verdict, and the statement by which the certificate admits an error that it passes.

    Where there is no equilibrium, a refusal is the right answer.
    """
    if found.verdict == report_rows.REFUSED and not posed.truth.exists:
        return report_rows.RIGHT, ""
    if found.verdict == report_rows.WRONG and (statement := certificate_statement(posed.truth, solutions[0])):
        return STATED, statement
    return found.verdict, ""


def _prediction_columns(prediction: Prediction) -> dict[str, Any]:
    return dict(
        system=prediction.system,
        condition=finite(prediction.condition),
        condition_missing=prediction.missing,
        predicted_digits_lost=prediction.digits_lost,
        force_condition=finite(prediction.force_condition),
        predicted_modelling=prediction.modelling,
        predicted_error_force=finite(prediction.error),
    )


def certificate_statement(truth: SweptTruth, solution: Solution) -> str:
    """Return the statement by which a passing certificate admits an error above 1e-6; empty where it has none.

    That uniqueness was not examined, or that other answers are not excluded, is not such a statement.
    """
    certificate = solution.certificate
    if SEVERAL in certificate.uniqueness:
        return f"the certificate says: {'; '.join(certificate.uniqueness)}"
    if not truth.exists:
        return ""
    if certificate.force_bound is None:
        statements = [text for text in certificate.reasons if text.startswith("force_bound") and REDUNDANT in text]
        statements += [finding for finding in certificate.uniqueness if finding == FORCES]
        resultants = replace(truth, unique_forces=False)
        errors = resultants.errors(solution.displacement, solution.normal_force, solution.tie_force)
        return f"the certificate says: {statements[0]}" if statements and errors.small else ""
    off = np.abs(solution.normal_force - truth.normal_force)
    allowed = certificate.force_bound + ROUNDING_OF_TRUTH * np.abs(truth.normal_force)
    together = replace(truth, unique_forces=False).errors(solution.displacement, truth.normal_force, solution.tie_force)
    if bool(np.all(off <= allowed)) and together.small:
        return f"the certificate's own force bound is {float(np.max(certificate.force_bound)):.1e}"
    return ""
