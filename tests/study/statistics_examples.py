"""Rows of a study of three cases whose statistics are computed by hand."""

from __future__ import annotations

from typing import Any

from contactqp.study import rows
from contactqp.study.rows import Row

ALLOWED = dict(error_allowed=1e-6, error_asked=1e-6, error_measure="relative")


def right(case: str, method: str, seconds: float, **changes: Any) -> Row:
    """An answer that is right, and is called so."""
    known: dict[str, Any] = dict(verdict=rows.RIGHT, error_judged=1e-12, claimed=True, flag_wrong=False)
    known |= dict(error_displacement=1e-12, error_force=1e-13)
    return Row(case=case, method=method, seconds=seconds, **(known | ALLOWED | changes))


def wrong(case: str, method: str, seconds: float, **changes: Any) -> Row:
    """A raw answer that is called solved, is wrong, and is refused."""
    known: dict[str, Any] = dict(verdict=rows.REFUSED, error_judged=0.5, claimed=True, flag_wrong=True)
    known |= dict(error_displacement=0.5, error_force=0.1)
    return Row(case=case, method=method, seconds=seconds, **(known | ALLOWED | changes))


def gave_up(case: str, method: str, verdict: str = rows.NOT_CONVERGED, **changes: Any) -> Row:
    """No answer."""
    claimed = False if verdict == rows.NOT_CONVERGED else None
    return Row(case=case, method=method, verdict=verdict, claimed=claimed, **changes)


def study() -> tuple[Row, ...]:
    """Three cases of three methods, one of them missing, and a fourth that only one method was put to.

    a: ours 1 ms, theirs 4 ms right and 2 ms wrong; b: ours 3 ms, theirs gave up; c: ours 7 ms, theirs cannot do it.
    """
    return (
        *(right(case, "ours", time, kind="active set") for case, time in (("a", 1e-3), ("b", 3e-3), ("c", 7e-3))),
        right("a", "theirs", 4e-3, variant="raw"),
        wrong("a", "theirs", 2e-3, variant="raw"),
        gave_up("b", "theirs", variant="raw"),
        gave_up("c", "theirs", rows.UNSUPPORTED, variant="raw"),
        *(gave_up(case, "absent", rows.MISSING) for case in "abc"),
        right("alone", "ours", 1.0, kind="active set"),
    )
