"""How often methods call their own answers solved, how often those are right, and what the certificate makes of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from contactqp.study import rows
from contactqp.study.rows import Row
from contactqp.study.statistics.routes import ANSWERED


@dataclass(frozen=True)
class Rates:
    """Counts of one method; failures are in `own` and in `certifiable`, and are neither claimed nor right.

    A method's own answers are its raw ones, or all where it has no others; that of the active set is the refined one,
    and has no flag. They are right by what was asked of them (`error_asked`), certified ones by 1e-6.
    """

    method: str
    installed: bool
    cases: int
    own: int  # rows of the method's own answers
    claimed: int  # of these, that it called solved
    right: int  # of `own`, that are right
    silently_wrong: int  # of `claimed`, that are wrong
    unsupported: int  # of `own`, that it refused to try
    certifiable: int  # rows as `solve` runs it
    certified: int  # of these, that the certificate passed
    wrong_but_passed: int  # of `certified`, that are wrong: must be 0


def method_rates(all_rows: Iterable[Row], cases: Sequence[str] | None = None) -> tuple[Rates, ...]:
    """Of every method, over some cases or all."""
    taken = [row for row in all_rows if cases is None or row.case in cases]
    return tuple(
        _rates(name, [row for row in taken if row.method == name]) for name in dict.fromkeys(r.method for r in taken)
    )


def _rates(name: str, mine: Sequence[Row]) -> Rates:
    tried = [row for row in mine if row.verdict != rows.MISSING]
    own, as_solve = own_answers(tried), [row for row in tried if row.variant in ("", "polished")]
    return Rates(
        method=name,
        installed=bool(tried),
        cases=len({row.case for row in mine}),
        own=len(own),
        claimed=sum(row.claimed is True for row in own),
        right=sum(_right(row) for row in own),
        silently_wrong=sum(row.flag_wrong is True for row in own),
        unsupported=sum(row.verdict == rows.UNSUPPORTED for row in own),
        certifiable=len(as_solve),
        certified=sum(row.verdict in (rows.RIGHT, rows.WRONG) for row in as_solve),
        wrong_but_passed=sum(row.verdict == rows.WRONG for row in mine),
    )


def own_answers(tried: Sequence[Row]) -> list[Row]:
    """The rows of a method's own answers: none of a method that promises no exact answer, or has no flag."""
    exact = [row for row in tried if row.promises_exact and row.kind != "active set"]
    return [row for row in exact if row.variant == "raw"] or exact


def _right(row: Row) -> bool:
    if row.verdict not in ANSWERED or row.error_judged is None or row.error_asked is None:
        return False
    return row.error_judged <= row.error_asked
