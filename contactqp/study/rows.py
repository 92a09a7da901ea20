"""The table of every study: one flat row for each method and value of its knob, the columns, CSV and text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import zip_longest
from typing import Any

from contactqp.model.summary import WIDTH as COLUMNS_OF_TEXT
from contactqp.model.summary import aligned, csv_text, wrapped
from contactqp.study.settings import DEFAULT_TOLERANCE
from contactqp.study.truth import ABSOLUTE_ENERGY, CONTRADICTED

RIGHT = "right"
REFUSED = "refused"
APPROXIMATE = "approximate"
NOT_CONVERGED = "not converged"
BACKEND_FAILED = "backend failed"
CRASHED = "crashed"
MISSING = "missing"
UNSUPPORTED = "unsupported"
WRONG = "wrong but passed"

# Half the distance from 1 to the next double: smaller relative errors are rounding of the answer itself.
UNIT_ROUNDOFF = 1.1e-16
# Values of the column `condensed` where there is a choice.
CONDENSED, WHOLE = "yes", "no"

# The columns in the order of the table.
VERDICTS: Mapping[str, str] = {
    RIGHT: "the certificate passes and the true error is small",
    APPROXIMATE: "approximate by design, returned with a certificate that says how far off it is",
    REFUSED: "the method promises the exact answer and was refused, mostly by the certificate",
    NOT_CONVERGED: "the method gave up; errors, if any, are those of its last iterate",
    BACKEND_FAILED: "the backend raised an exception of its own, or returned nothing usable",
    CRASHED: "the process that ran it died, was stopped at the time limit, or met a bug; the message says which",
    UNSUPPORTED: "the method cannot do this problem",
    MISSING: "not installed; the message is the pip command",
    WRONG: "the certificate passes and the true error is not small: must never happen",
}


def column(meaning: str, default: Any = None) -> Any:
    """Return a dataclass field of a row, with the meaning of its column."""
    return field(default=default, metadata={"meaning": meaning})


@dataclass(frozen=True)
class Row:
    """One method with one value of its knob on one problem. What does not apply, or is not finite, is None."""

    case: str = column("name of the case; empty in a comparison of one problem", "")
    method: str = column("name of the method", "")
    kind: str = column("family of the method", "")
    promises_exact: bool = column("whether the method promises the exact answer, or is approximate by design", True)
    variant: str = column("raw, polished or uzawa, where the method has such variants", "")
    condensed: str = column(
        "yes: the method worked on the contact unknowns alone; no: it was told to work on all unknowns; "
        "empty: there is no choice",
        "",
    )
    knob: str = column("what trades error for time: tolerance, penalty, perturbation, iterations", "")
    knob_value: float | None = column("its value; stiffnesses in the case's units; none: the method's own default")
    knob_stiffnesses: float | None = column("a penalty or perturbation as a multiple of the contact stiffness")
    verdict: str = column("one of the verdicts listed below", "")
    error_displacement: float | None = column("true error in u, energy norm, relative to that of the truth")
    error_displacement_max: float | None = column("largest true error of an unknown, relative to the largest unknown")
    error_force: float | None = column("largest true error of a contact force, relative to the largest force")
    error_measure: str = column("relative, or which errors are absolute or measured otherwise, and why", "")
    error_judged: float | None = column("the worst of the errors that decide, each relative to a size that is not zero")
    error_allowed: float | None = column("error_judged up to which the answer is right: 1e-6 and rounding")
    error_asked: float | None = column("error_judged up to which a method that calls its answer solved is not wrong")
    seconds: float | None = column(
        "run time of solve on a fresh problem, certificate not included; median of the repeats"
    )
    seconds_spread: float | None = column(
        "distance of the quartiles of the repeats, relative to their median; empty of a single one"
    )
    repeats: int = column("timed repeats after the warm-up; 0: the first call was so long that it was timed itself", 0)
    linear_solve_seconds: float | None = column(
        "one linear solve of the case's bodies without contact by the same sparse solver: the physical limit"
    )
    unknowns: int | None = column("unknowns of the problem")
    contacts: int | None = column("contacts of the problem")
    claimed: bool | None = column("whether the method itself called its raw answer solved")
    flag_wrong: bool | None = column("the method called its raw answer solved, and that is wrong")
    raw_error_displacement: float | None = column("error_displacement before polish, where the answer was polished")
    raw_error_force: float | None = column("error_force before polish, where the answer was polished")
    certificate_passed: bool | None = column("verdict of the certificate")
    certificate_proven: bool | None = column("whether the certificate could bound the errors")
    certificate_basis: str = column("what the verdict rests on: bounds, state or figures", "")
    certificate_worst: float | None = column("largest of the certificate's figures of violation")
    certificate_figure: str = column("which figure that is", "")
    bound_displacement: float | None = column("the certificate's bound on the relative error in u, energy norm")
    bound_force: float | None = column("the certificate's bound on the relative error in the forces, energy norm")
    iterations: int | None = column("iterations of the method")
    factorisations: int | None = column("factorisations of the stiffness")
    back_substitutions: int | None = column("right-hand sides solved with them")
    polish_corrections: int | None = column("changes of the method's contact set while polishing")
    expectations_unmet: int | None = column("exact values of the case that the answer misses, where they were compared")
    message: str = column("what the method, the certificate or the error says", "")


def columns_of(kind: type) -> Mapping[str, str]:
    """Return the meaning of each column of a table whose rows are of a kind."""
    return {column.name: column.metadata["meaning"] for column in fields(kind)}


COLUMNS: Mapping[str, str] = columns_of(Row)


def as_dicts(rows: Iterable[Any]) -> list[dict[str, Any]]:
    """Return rows as plain data with one key for each column."""
    return [asdict(row) for row in rows]


def to_csv(rows: Iterable[Any], columns: Mapping[str, str] = COLUMNS) -> str:
    """Return comma-separated values with a header; numbers have all their digits, None is empty."""
    return csv_text(tuple(columns), ((getattr(row, name) for name in columns) for row in rows))


# The columns that fit a screen, with their headings there.
READABLE: Mapping[str, str] = {
    "method": "method",
    "variant": "variant",
    "condensed": "condensed",
    "knob": "knob",
    "knob_value": "value",
    "error_displacement": "error in u",
    "error_displacement_max": "max-norm",
    "error_force": "error in λ",
    "seconds": "time [ms]",
    "verdict": "verdict",
    "certificate_worst": "violation",
    "claimed": "claimed",
    "raw_error_force": "raw error in λ",
    "iterations": "iterations",
    "message": "message",
}


# Run times that spread by more than this part of their median are shown with it.
WIDE = 0.2


def readable(row: Row) -> dict[str, str]:
    """Return the cells of `READABLE` as text, rounded."""
    cells = {name: _rounded(name, getattr(row, name)) for name in READABLE}
    if row.seconds_spread is not None and row.seconds_spread > WIDE:
        cells["seconds"] += f" ± {100 * row.seconds_spread:.0f} %"
    return cells


def _rounded(name: str, value: Any) -> str:
    if name == "seconds":
        return milliseconds(value)
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "0" if value == 0 else f"{value:.1e}" if isinstance(value, float) else str(value)


def brief_comparison(rows: Sequence[Row], truth: str) -> str:
    """Return rows for a terminal of 80 columns: who is fastest and who is not right, then all of them by their times.

    Parameters
    ----------
    rows : sequence of Row
    truth : what the errors are measured against
    """
    ran = sorted((row for row in rows if row.seconds is not None), key=lambda row: (row.seconds, row.verdict != RIGHT))
    cells = [("method", "error in u", "error in λ", "time [ms]", "verdict")]
    for row in ran:
        shown = readable(row)
        error = shown["error_displacement_max" if _largest_unknown_decides(row) else "error_displacement"]
        cells.append((_with_knob(row), error, shown["error_force"], milliseconds(row.seconds), row.verdict))
    sentences = [f"{_with_knob(row)}: {shortened_text(row.message, MESSAGE)}" for row in rows if _says_why(row)]
    missing = ", ".join(row.method for row in rows if row.verdict == MISSING)
    sentences += [f"not installed: {missing} (`contactqp methods` has the pip commands)"] if missing else []
    table = side_by_side(cells) if ran else ""
    against = _in_lines(f"errors against: {truth}")
    parts = [*_in_lines(_in_short(rows)), table, *wrapped(*sentences)]
    # A truth that may be wrong is said before any verdict that rests on it.
    parts = [*against, *parts] if CONTRADICTED in truth else [*parts, *against]
    return "\n".join(filter(None, parts))


def _largest_unknown_decides(row: Row) -> bool:
    """Return whether the energy norm misses the error in u: it vanishes, or is singular, and the largest unknown errs
    more than what the energy and the forces say.
    """
    if ABSOLUTE_ENERGY in row.error_measure:
        return True
    shown = max(row.error_displacement or 0.0, row.error_force or 0.0)
    return row.error_judged is not None and row.error_judged > shown and row.error_judged == row.error_displacement_max


# Letters of a message in a comparison.
MESSAGE = 150


def _in_short(rows: Sequence[Row]) -> str:
    """Return which of the right answers came first, and which rows are wrong, refused or without an answer."""
    right = [row for row in rows if row.verdict == RIGHT and row.seconds is not None]
    first = "no method has a right answer"
    if right:
        fastest = min(right, key=lambda row: row.seconds or 0.0)
        of = f"the fastest of {len(right)} right answers" if len(right) > 1 else "the only right answer"
        first = f"{fastest.method}: {of}, {milliseconds(fastest.seconds)} ms"
    wrong = {
        verdict: list(dict.fromkeys(row.method for row in rows if row.verdict == verdict))
        for verdict in (WRONG, REFUSED, NOT_CONVERGED, BACKEND_FAILED, CRASHED, UNSUPPORTED, APPROXIMATE)
    }
    return "; ".join([first, *(f"{verdict}: {', '.join(names)}" for verdict, names in wrong.items() if names)])


def _with_knob(row: Row) -> str:
    """Return the method with its variant and the value of its knob, where these are not the usual ones."""
    variant = [row.variant] if row.variant not in ("", "polished") else []
    usual = row.knob_value is None or (row.knob == "tolerance" and row.knob_value == DEFAULT_TOLERANCE)
    return " ".join([row.method, *variant, *([] if usual else [f"{row.knob_value:.3g}"])])


def milliseconds(seconds: float | None) -> str:
    """Return a time as text in a table [ms].

    >>> milliseconds(0.01234), milliseconds(None)
    ('12.3', '')
    """
    return "" if seconds is None else f"{1e3 * seconds:.3g}"


def _says_why(row: Row) -> bool:
    return row.verdict not in (RIGHT, APPROXIMATE, MISSING) and bool(row.message)


def _in_lines(text: str) -> list[str]:
    return textwrap.wrap(text, COLUMNS_OF_TEXT, subsequent_indent="  ", break_on_hyphens=False)


def side_by_side(cells: Sequence[Sequence[str]]) -> str:
    """Return columns side by side under the headings of the first line; empty columns are left out."""
    shown = [cell for cell in zip(*cells, strict=True) if any(cell[1:])]
    return "\n".join(aligned(list(zip(*shown, strict=True))))


def folded(cells: Sequence[Sequence[str]], first: int) -> str:
    """Return the same with the first column folded at so many letters, and headings at the width of what they head.

    >>> print(folded([("method", "error of the force"), ("penalty, best of 6", "1e-06"), ("osqp", "1e-16")], 9))
    method     error
               of the
               force
    penalty,   1e-06
      best of
      6
    osqp       1e-16
    """
    widths = [first, *(max(map(len, column[1:]), default=0) for column in list(zip(*cells, strict=True))[1:])]
    lines: list[Sequence[str]] = []
    for line in cells:
        parts = [
            textwrap.wrap(cell, max(width, 6), subsequent_indent="" if i else "  ", break_long_words=False) or [""]
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ]
        lines += zip_longest(*parts, fillvalue="")
    return side_by_side(lines)


def shortened_text(text: str, widest: int) -> str:
    """Return the text on one line, cut at `widest` letters."""
    text = " ".join(text.split())
    return text if len(text) <= widest else text[: widest - 1] + "…"
