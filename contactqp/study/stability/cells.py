"""The cells of the study: one method at one value of an axis, a function of plain arguments."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from contactqp.model.solution import Solution
from contactqp.solving.methods import Method
from contactqp.study import rows as report_rows
from contactqp.study.attempt import DEFAULT_TOLERANCE, Rung, answer, chosen_methods, contact_stiffness
from contactqp.study.rows import Row
from contactqp.study.running.journal import Cell as RunningCell
from contactqp.study.running.journal import Crash
from contactqp.study.stability.axes import AXES, find_axis
from contactqp.study.stability.condition import Prediction, predict
from contactqp.study.stability.posed import Axis, Posed, stated
from contactqp.study.stability.rows import CUT_OFF, STATED, StabilityRow, digits_lost, is_small

# β and κ beside the contact stiffness where the axis is not theirs: a modelling error of 1e-6.
STIFFENING = 1e6
# Seconds for methods that can stop; nearly all cells take milliseconds.
PATIENCE = 5.0


@dataclass(frozen=True)
class Cell:
    """One row to be made: `stability_row(*arguments)`."""

    axis: str
    value: float
    method: str
    variant: str = ""

    @property
    def key(self) -> str:
        """The same in every run."""
        return f"stability/{self.axis}={self.value!r}/{self.method}{'/' if self.variant else ''}{self.variant}"

    @property
    def arguments(self) -> tuple[str, float, str, str]:
        """The arguments of `stability_row`."""
        return self.axis, self.value, self.method, self.variant


def cells(axes: Sequence[Axis] = AXES, methods: Sequence[str] | None = None) -> Iterator[Cell]:
    """Every method at every value of every axis, missing ones too; on the axis of a knob the methods that have it."""
    for axis in axes:
        for value in axis.values:
            for method in chosen_methods(methods):
                if axis.knobs and method.name not in axis.knobs:
                    continue
                yield Cell(axis.name, value, method.name)
                if axis.knobs and "update" in method.options:
                    yield Cell(axis.name, value, method.name, "uzawa")


def runnable(cell: Cell) -> RunningCell:
    """The cell as what runs cells takes it."""
    return RunningCell(cell.key, stability_row, cell.arguments, StabilityRow)


def row_of(cell: Cell, found: StabilityRow | Crash) -> StabilityRow:
    """The row of a cell; of one whose process died, what is known of it all the same."""
    if not isinstance(found, Crash):
        return found
    [chosen] = chosen_methods([cell.method])
    known: dict[str, Any] = dict(axis=cell.axis, value=cell.value, label=find_axis(cell.axis).label(cell.value))
    known |= dict(method=chosen.name, kind=chosen.kind, promises_exact=chosen.exact, variant=cell.variant)
    return StabilityRow(**known, verdict=report_rows.CRASHED, message=found.message)


def stability_row(axis: str, value: float, method: str, variant: str = "") -> StabilityRow:
    """One cell: the problem posed, the method run, its answer held against the truth, the prediction beside it."""
    swept, [chosen] = find_axis(axis), chosen_methods([method])
    known: dict[str, Any] = dict(axis=axis, value=value, label=swept.label(value), variant=variant)
    known |= dict(method=chosen.name, kind=chosen.kind, promises_exact=chosen.exact)
    if chosen.installed and value > swept.largest:
        message = f"tried up to {swept.largest:.6g} {swept.quantity}: {swept.why_largest}"
        return StabilityRow(**known, verdict=CUT_OFF, message=message)
    posed = _posed(axis, value)
    rung = _rung(posed, swept, value, chosen, variant)
    solutions: list[Solution] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # numbers overflow at the ends of some axes: that is swept
        found = answer(posed.problem, rung, posed.truth, judge=solutions.append)
    stiffness = None if rung.knob == "tolerance" else rung.value
    prediction = predict(posed, chosen, variant, stiffness) if chosen.installed else Prediction("")
    return StabilityRow(
        **known, **_of_problem(posed), **_of_attempt(found, posed, solutions), **_of_prediction(prediction)
    )


@lru_cache(maxsize=4)
def _posed(axis: str, value: float) -> Posed:
    return find_axis(axis).pose(value)


def _rung(posed: Posed, axis: Axis, value: float, method: Method, variant: str) -> Rung:
    options: dict[str, Any] = {}
    if method.knob == "tolerance" and "no time limit" not in method.note:
        options["time_limit"] = PATIENCE
    if variant:
        options["update"] = variant
    knob = axis.knobs.get(method.name) or (method.required[0] if method.required else method.knob or "")
    if method.knob == "tolerance":
        return Rung(method, "polished", knob, DEFAULT_TOLERANCE, options | {knob: DEFAULT_TOLERANCE})
    if axis.knobs or method.required:
        size = value if axis.knobs else float(f"{STIFFENING * contact_stiffness(posed.problem):.1e}")
        return Rung(method, variant, knob, size, options | {knob: size})
    return Rung(method, variant, knob, None, options)


def _of_problem(posed: Posed) -> dict[str, Any]:
    rubs = posed.problem.frictional
    count = len(posed.exact) if rubs else None
    return dict(unknowns=posed.problem.dimension, contacts=posed.problem.contacts, equilibria=count)


def _of_attempt(found: Row, posed: Posed, solutions: Sequence[Solution]) -> dict[str, Any]:
    verdict, said = _verdict(found, posed, solutions)
    known: dict[str, Any] = dict(
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
        message=said or found.message,
    )
    if solutions:
        known["largest_force"] = _finite(float(np.max(solutions[0].normal_force, initial=0.0)))
    refused = found.verdict in (report_rows.REFUSED, report_rows.NOT_CONVERGED)
    if refused and posed.truth.exists and found.error_displacement is not None:
        known["refused_right"] = is_small(found.error_displacement) and is_small(found.error_force)
    return known


def _verdict(found: Row, posed: Posed, solutions: Sequence[Solution]) -> tuple[str, str]:
    """The verdict, and what the certificate states of an error that it lets pass.

    Where there is no equilibrium, a refusal is the right answer.
    """
    if found.verdict == report_rows.REFUSED and not posed.truth.exists:
        return report_rows.RIGHT, ""
    if found.verdict == report_rows.WRONG and (said := stated(posed.truth, solutions[0])):
        return STATED, said
    return found.verdict, ""


def _of_prediction(prediction: Prediction) -> dict[str, Any]:
    return dict(
        system=prediction.system,
        condition=_finite(prediction.condition),
        condition_missing=prediction.missing,
        predicted_digits_lost=prediction.digits_lost,
        force_condition=_finite(prediction.force_condition),
        predicted_modelling=prediction.modelling,
        predicted_error_force=_finite(prediction.error),
    )


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
