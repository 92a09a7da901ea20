"""What a report's rows come to: rates for each method, and whether anything claims to be right and is not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields

from contactqp.study import rows
from contactqp.study.rows import Row
from contactqp.study.statistics.rates import Rates, method_rates


@dataclass(frozen=True)
class MethodSummary:
    """One method over all cases and knobs; failures count, missing methods have no rows to count."""

    method: str
    installed: bool
    tried: int  # rows
    right: int  # the certificate passes and the truth agrees
    refused: int  # refused, not converged, failed, crashed or unsupported
    approximate: int
    wrong_but_passed: int
    own_answers: int  # before polish and certificate; of methods that promise exact ones and have a flag
    claimed: int  # of these, those that the method itself called solved
    own_right: int  # of the own answers, those that are right, by what was asked of them
    silently_wrong: int  # of the claimed, those that are wrong


@dataclass(frozen=True)
class Summary:
    """Of a whole report."""

    methods: tuple[MethodSummary, ...]
    wrong_but_passed: int  # ours: must be 0
    silently_wrong: int  # the methods' own flags
    unmet: tuple[str, ...]  # expectations of the cases that are not met
    contradicted: tuple[str, ...] = ()  # cases whose exact values are not those of the proven solution

    @property
    def exit_code(self) -> int:
        """1 if anything claims to be right and is not."""
        return 1 if self.wrong_but_passed or self.unmet else 0

    def cells(self) -> list[list[str]]:
        """The table of the methods, headings first."""
        words = {True: "yes", False: "no"}
        lines = [[words[cell] if isinstance(cell, bool) else str(cell) for cell in astuple(m)] for m in self.methods]
        return [[column.name.replace("_", " ") for column in fields(MethodSummary)], *lines]

    def unmet_lines(self) -> list[str]:
        """What is not met, each line once, with how often it is said."""
        return [f"{text} ({count} times)" if count > 1 else text for text, count in Counter(self.unmet).items()]

    @property
    def doubt(self) -> str:
        """Where what is wrong may be the case; empty where no case is in doubt."""
        if not self.contradicted:
            return ""
        return f"see {', '.join(self.contradicted)}: the proven solution contradicts exact values of the case"

    def __str__(self) -> str:
        doubt = f" ({self.doubt})" if self.doubt else ""
        return (
            f"wrong but passed: {self.wrong_but_passed}{doubt}; expectations unmet: {len(self.unmet)}; "
            f"methods silently wrong by themselves: {self.silently_wrong}"
        )


def summarise(all_rows: Sequence[Row], unmet: Iterable[str], contradicted: Iterable[str] = ()) -> Summary:
    """Counts by method. A raw answer is counted once: on its own row where it has one, else on that of the method."""
    methods = tuple(_of_method(rates, all_rows) for rates in method_rates(all_rows))
    of_rows = (f"{row.case}: {row.method}: {row.message}" for row in all_rows if row.expectations_unmet)
    return Summary(
        methods=methods,
        wrong_but_passed=sum(method.wrong_but_passed for method in methods),
        silently_wrong=sum(method.silently_wrong for method in methods),
        unmet=(*unmet, *of_rows),
        contradicted=tuple(contradicted),
    )


def _of_method(rates: Rates, all_rows: Sequence[Row]) -> MethodSummary:
    verdicts = [row.verdict for row in all_rows if row.method == rates.method]
    failed = (rows.REFUSED, rows.NOT_CONVERGED, rows.BACKEND_FAILED, rows.CRASHED, rows.UNSUPPORTED)
    return MethodSummary(
        method=rates.method,
        installed=rates.installed,
        tried=len(verdicts) - verdicts.count(rows.MISSING),
        right=verdicts.count(rows.RIGHT),
        refused=sum(verdicts.count(verdict) for verdict in failed),
        approximate=verdicts.count(rows.APPROXIMATE),
        wrong_but_passed=rates.wrong_but_passed,
        own_answers=rates.own,
        claimed=rates.claimed,
        own_right=rates.right,
        silently_wrong=rates.silently_wrong,
    )
