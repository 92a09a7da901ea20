"""What a report's problems left out, and what that saved: read off its records and computed from its rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from contactqp.study import rows
from contactqp.study.report_data import CaseRecord
from contactqp.study.rows import Row
from contactqp.study.statistics import Route, solved


def left_out_lines(case: CaseRecord, all_rows: Sequence[Row]) -> Iterator[str]:
    """Yield what the problem of a case left out, and what that saved there and over all rows."""
    left = [block.name for block in case.explanation.blocks if not block.included]
    if left:
        yield f"{case.title}: left out, as nothing of it is in the case: {', '.join(left)}."
    if case.sizes.unknowns > case.sizes.contacts > 0:
        yield (
            f"{case.title}: its {case.sizes.unknowns} unknowns are condensed onto those of {case.sizes.contacts} "
            "contacts before a method is called."
        )
    yield from _saved(all_rows)
    count = case.footprint.contacts if case.footprint else None
    if count is not None and count.dropped:
        yield (
            f"{case.title}: {count.dropped} of {count.looked_at} contacts are out of reach, left out, and checked "
            "afterwards."
        )
    modules = case.footprint.modules if case.footprint else None
    if modules is not None and modules.left_out:
        yield f"{case.title}: installed and not imported: {', '.join(modules.left_out)}."


def _saved(all_rows: Sequence[Row]) -> Iterator[str]:
    """Yield how many times as long right answers take on all unknowns as on those of the contacts."""
    condensed = {_answer(row): row for row in all_rows if row.condensed == rows.CONDENSED and solved(row)}
    for case in dict.fromkeys(row.case for row in all_rows):
        whole = [row for row in all_rows if row.case == case and row.condensed == rows.WHOLE and solved(row)]
        factors = {
            row.method: row.seconds / pair.seconds
            for row in whole
            if (pair := condensed.get(_answer(row))) is not None and row.seconds and pair.seconds
        }
        if factors and (whole[0].unknowns or 0) >= MANY:
            mean = float(np.exp(np.mean(np.log(list(factors.values())))))
            yield (
                f"{case}: on all {whole[0].unknowns} unknowns the same answers take {mean:.2g} times as long "
                f"(geometric mean of {', '.join(factors)})."
            )


# Unknowns below which the time of an answer is that of calls of Python.
MANY = 500


def _answer(row: Row) -> tuple[str, Route, str, float | None]:
    return row.case, Route(row.method, row.variant), row.knob, row.knob_value
