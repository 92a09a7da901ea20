"""The study as sections of a page: headings, words, charts, tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from contactqp.study.report.chart import Chart
from contactqp.study.stability.axes import penalty_stiffness
from contactqp.study.stability.axis import Axis
from contactqp.study.stability.best_penalty import of_truss
from contactqp.study.stability.curves import digits_curves
from contactqp.study.stability.heat_maps import digits_heat_map, verdict_heat_map
from contactqp.study.stability.penalty_valley import penalty_valley
from contactqp.study.stability.ranges import grouped
from contactqp.study.stability.rows import VERDICTS
from contactqp.study.stability.study import StabilityStudy


class Table(NamedTuple):
    """A table of a page."""

    title: str
    headings: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]


class Section(NamedTuple):
    """A section of a page."""

    heading: str
    words: tuple[str, ...]
    charts: tuple[Chart, ...]
    tables: tuple[Table, ...]


def stability_charts(study: StabilityStudy) -> tuple[Chart, ...]:
    """Those of all sections."""
    return tuple(chart for section in stability_sections(study) for chart in section.charts)


def stability_sections(study: StabilityStudy) -> tuple[Section, ...]:
    """One section of what it all comes to, one for each axis, one of what was refused needlessly."""
    return (_summary(study), *(_of_axis(study, axis) for axis in study.axes), *_needless(study))


def _summary(study: StabilityStudy) -> Section:
    headings, *lines = study.cells()
    table = Table("By axis", tuple(headings), tuple(tuple(line) for line in lines))
    verdicts = Table("Verdicts", ("verdict", "meaning"), tuple(VERDICTS.items()))
    return Section("How it ended", (str(study),), (), (table, verdicts))


def _of_axis(study: StabilityStudy, axis: Axis) -> Section:
    rows = study.rows_of(axis)
    charts = [digits_heat_map(axis, rows), verdict_heat_map(axis, rows), digits_curves(axis, rows)]
    words = [axis.about]
    if axis.name == penalty_stiffness.AXIS.name:
        charts.insert(0, penalty_valley(rows))
        words += list(_of_best(study))
    words += [f"Values: {axis.quantity}.", *grouped(study.ranges(axis))]
    return Section(axis.title, tuple(words), tuple(charts), ())


def _of_best(study: StabilityStudy) -> Iterator[str]:
    """The best β of the penalty method, measured and predicted."""
    best = of_truss()
    found = {chosen.method: chosen for chosen in study.ranges(penalty_stiffness.AXIS)}.get("penalty")
    if found is not None and found.best is not None and found.best_value is not None:
        yield (
            f"Best β: {found.best_value:.1e} kN/m with an error of {found.best:.1e}; predicted {best.penalty:.1e} kN/m "
            f"with {best.error:.1e}."
        )


def _needless(study: StabilityStudy) -> Sequence[Section]:
    """Right answers that were refused, by reason."""
    if not study.refused_right:
        return ()
    reasons = Counter((row.axis, reason_of(row.message)) for row in study.refused_right)
    lines = tuple((axis, reason, str(count)) for (axis, reason), count in reasons.most_common())
    table = Table("Right answers that were refused", ("axis", "reason", "rows"), lines)
    words = f"{len(study.refused_right)} answers were right to 1e-6 and were refused all the same."
    return (Section("Refused, and right", (words,), (), (table,)),)


def reason_of(message: str) -> str:
    """What a refusal names first: a figure of the certificate, or the method's own words."""
    words = message.removeprefix("expected otherwise: ").split(": ")
    if "the certificate refuses the answer" in words:
        return words[words.index("the certificate refuses the answer") + 1]
    return words[1] if len(words) > 1 else words[0]
