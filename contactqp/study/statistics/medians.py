"""The median over cases of error and run time, for each rung that all cases share."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence

from contactqp.study import rows
from contactqp.study.rows import Row
from contactqp.study.statistics.routes import ANSWERED, Route, compared_cases


def median_cases(all_rows: Sequence[Row]) -> tuple[str, ...]:
    """The compared cases whose errors are all relative: others cannot be put beside them."""
    absolute = {row.case for row in all_rows if row.error_judged is not None and row.error_measure != "relative"}
    return tuple(case for case in compared_cases(all_rows) if case not in absolute)


def median_rows(all_rows: Sequence[Row]) -> tuple[Row, ...]:
    """One row for each way and value of the knob that was tried on each of `median_cases`.

    An answer that failed has infinite errors and takes infinitely long; a median that is infinite is None. Knobs with
    units differ from case to case and are left out.
    """
    cases = median_cases(all_rows)
    shared = [row for row in all_rows if row.case in cases and (row.knob == "tolerance" or row.knob_value is None)]
    shared = [row for row in shared if row.verdict != rows.MISSING]
    tried = dict.fromkeys((Route.of(row), row.variant, row.knob, row.knob_value) for row in shared)
    found = []
    for route, *rung in tried:
        group = [row for row in shared if route.takes(row) and [row.variant, row.knob, row.knob_value] == rung]
        if {row.case for row in group} == set(cases):
            found.append(_median_row(route, group))
    return tuple(found)


def median_limit(all_rows: Sequence[Row]) -> float | None:
    """The median over `median_cases` of one linear solve [s]; None if one of them has none."""
    cases = median_cases(all_rows)
    limits = {row.case: row.linear_solve_seconds for row in all_rows if row.case in cases}
    known = [limit for limit in limits.values() if limit is not None]
    return statistics.median(known) if known and len(known) == len(limits) else None


def _median_row(route: Route, group: Sequence[Row]) -> Row:
    one = group[0]
    return Row(
        method=one.method,
        kind=one.kind,
        promises_exact=one.promises_exact,
        variant=one.variant,
        condensed=rows.WHOLE if route.whole else "",
        knob=one.knob,
        knob_value=one.knob_value,
        seconds=_median(group, "seconds"),
        error_displacement=_median(group, "error_displacement"),
        error_force=_median(group, "error_force"),
    )


def _median(group: Sequence[Row], column: str) -> float | None:
    values = [getattr(row, column) if row.verdict in (*ANSWERED, rows.WRONG) else None for row in group]
    middle = statistics.median(math.inf if value is None else value for value in values)
    return middle if math.isfinite(middle) else None
