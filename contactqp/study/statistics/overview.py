"""What all rows of a study come to, computed once for the page, the JSON and the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from contactqp.study.rows import Row
from contactqp.study.statistics.means import LIMIT, SHIFT, shifted_geometric_mean
from contactqp.study.statistics.rates import Rates, method_rates
from contactqp.study.statistics.routes import RouteTimes, compared_cases, route_times


@dataclass(frozen=True)
class Overview:
    """Methods compared on the cases that all of them were put to."""

    cases: tuple[str, ...]
    rates: tuple[Rates, ...]  # on those cases
    times: tuple[RouteTimes, ...]
    means: tuple[float, ...]  # shifted geometric means of the times [s]


def overview(all_rows: Sequence[Row]) -> Overview:
    """Of the rows of a report."""
    cases, times = compared_cases(all_rows), route_times(all_rows)
    means = tuple(shifted_geometric_mean(found.seconds) for found in times)
    return Overview(cases, method_rates(all_rows, cases), times, means)


def overview_data(found: Overview) -> dict[str, Any]:
    """As it stands in results.json; a time without end is null."""
    return dict(
        compared_cases=list(found.cases),
        solved="error_judged at most error_allowed, by the truth, whatever flags say",
        shift_seconds=SHIFT,
        limit_seconds=LIMIT,
        rates=[asdict(rates) for rates in found.rates],
        times=[_times(times, mean) for times, mean in zip(found.times, found.means, strict=True)],
    )


def _times(times: RouteTimes, mean: float) -> dict[str, Any]:
    return dict(
        **asdict(times.route),
        solved=times.solved,
        failed=times.failed,
        unsupported=times.unsupported,
        shifted_geometric_mean_seconds=mean,
        seconds=[value if math.isfinite(value) else None for value in times.seconds],
    )
