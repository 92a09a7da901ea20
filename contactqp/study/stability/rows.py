"""The table of the study: a flat row for each method at each value of an axis."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from contactqp.study import rows as report_rows
from contactqp.study.rows import as_dicts, column, columns_of
from contactqp.study.stability.condition import UNIT_ROUNDOFF
from contactqp.study.truth import ERROR_TOLERANCE

CUT_OFF, STATED = "cut off", "stated"
VERDICTS: Mapping[str, str] = {
    **report_rows.VERDICTS,
    STATED: (
        "the certificate passes, the true error is above 1e-6, and the certificate says so itself: its force bound "
        "is as large, or it says that single forces cannot be told apart, or that there are other equilibria"
    ),
    CUT_OFF: "not tried: at this size the method takes longer than the study allows; the message says how large",
}
# All digits of a double.
ALL_DIGITS = -math.log10(UNIT_ROUNDOFF)


def digits_lost(error: float | None) -> float | None:
    """log₁₀ of the error over 2⁻⁵³, from 0 to 15.95, where none is left; None without an error."""
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
        """The method with its variant."""
        return f"{self.method} ({self.variant})" if self.variant else self.method

    @property
    def error(self) -> float | None:
        """The larger of the errors in u and in λ."""
        known = [x for x in (self.error_displacement, self.error_force) if x is not None]
        return max(known, default=None)

    @property
    def right(self) -> bool:
        """Whether it ended as it should."""
        return self.verdict == report_rows.RIGHT

    @property
    def wrong(self) -> bool:
        """Whether the certificate passed what is wrong: must never happen."""
        return self.verdict == report_rows.WRONG


COLUMNS: Mapping[str, str] = columns_of(StabilityRow)


def is_small(error: float | None) -> bool:
    """Whether an error is one that a certificate must let pass."""
    return error is not None and error <= ERROR_TOLERANCE


def short_dicts(rows: Iterable[StabilityRow]) -> list[dict[str, Any]]:
    """The same without what is empty: `StabilityRow(**row)` gives the row back."""
    empty = asdict(StabilityRow())
    return [{key: value for key, value in row.items() if value != empty[key]} for row in as_dicts(rows)]


def to_csv(rows: Iterable[StabilityRow]) -> str:
    """Comma-separated values with a header; numbers with all their digits, None as nothing."""
    return report_rows.to_csv(rows, COLUMNS)
