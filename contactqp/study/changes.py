"""What changed between two reports: versions, verdicts, errors, and run times beyond their spread."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from contactqp.errors import SceneError
from contactqp.study.conclusion import MethodLine, conclude
from contactqp.study.report_data import SCHEMA
from contactqp.study.rows import Row, aligned

# Errors that differ by less than this factor, and those of rounding, are the same.
FACTOR, ROUNDING = 10.0, 1e-12
# The least spread that a time is taken to have: two runs of the same differ by as much.
LEAST_SPREAD = 0.2
HEADINGS = ("case", "method", "answer", "knob", "what", "before", "now")
_WORDS = ("case", "method", "variant", "condensed", "knob")
_KEY = (*_WORDS, "knob_value")
_NUMBERS = ("knob_value", "error_judged", "seconds", "seconds_spread", "linear_solve_seconds")


def changes(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Return what changed between two reports as text, from the contents of their results.json.

    Times are compared in linear solves of the same bodies where both reports have them, else in seconds. They have
    changed where they differ by more than the sum of their spreads, each at least 20 %. Methods that change places in
    the table of the conclusion are told, and whether their times lie within these spreads.
    """
    before, now = _rows(old), _rows(new)
    lines = [line for key in before if key in now for line in _of_row(before[key], now[key])]
    parts = [*_versions(old, new), *_counts(before, now)]
    parts.append(aligned([HEADINGS, *lines]) if lines else "no verdict, error or time has changed")
    return "\n".join([*parts, *_order(list(before.values()), list(now.values()))])


def _order(before: list[Row], now: list[Row]) -> Iterator[str]:
    """Return in words which methods have changed places by their times in linear solves."""
    old, new = ({line.method: line for line in conclude(rows).lines if line.linear_solves} for rows in (before, now))
    names = sorted(old.keys() & new.keys(), key=lambda name: old[name].linear_solves or 0.0)
    swapped = [
        (fast, slow)
        for i, fast in enumerate(names)
        for slow in names[i + 1 :]
        if (new[fast].linear_solves or 0.0) > (new[slow].linear_solves or 0.0)
    ]
    beyond = [
        pair for pair in swapped if not any(_within_spread(lines[pair[0]], lines[pair[1]]) for lines in (old, new))
    ]
    if len(names) > 1 and not beyond:
        within = ", ".join(" and ".join(pair) for pair in swapped)
        exception = f", but for {within}, whose times lie within their spreads" if swapped else ""
        yield f"the {len(names)} methods have the same order by time{exception}"
    for fast, slow in beyond:
        first, second = (f"{lines[fast].linear_solves:.3g} and {lines[slow].linear_solves:.3g}" for lines in (old, new))
        yield f"{slow} is faster than {fast} now: {first} linear solves before, {second} now"


def _within_spread(one: MethodLine, other: MethodLine) -> bool:
    times = [line.linear_solves or 0.0 for line in (one, other)]
    rooms = [time * max(line.spread or 0.0, LEAST_SPREAD) for time, line in zip(times, (one, other), strict=True)]
    return abs(times[0] - times[1]) <= sum(rooms)


def read_report(file: str | Path) -> dict[str, Any]:
    """Return the contents of a results.json.

    Raises
    ------
    SceneError
        The file cannot be read, or is no report.
    """
    path = Path(file)
    try:
        contents = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"{path}: expected the results.json of a report, got: {error.strerror}") from None
    except ValueError:
        raise SceneError(f"{path}: expected the results.json of a report, got no JSON") from None
    if not (isinstance(contents, dict) and contents.get("schema") == SCHEMA and _is_whole(contents)):
        raise SceneError(f"{path}: expected the results.json of a report, got other JSON")
    return contents


def _is_whole(contents: Mapping[str, Any]) -> bool:
    """Return whether the parts that are compared are of the kinds that a report writes."""
    groups = all(isinstance(contents.get(name, {}), dict) for name in ("versions", "machine"))
    return groups and isinstance(contents.get("rows"), list) and all(map(_is_row, contents["rows"]))


def _is_row(row: Any) -> bool:
    words = isinstance(row, dict) and all(isinstance(row.get(name, ""), str) for name in (*_WORDS, "verdict"))
    return words and all(isinstance(row.get(name), int | float | None) for name in _NUMBERS)


def _rows(contents: Mapping[str, Any]) -> dict[tuple[Any, ...], Row]:
    known = {column.name for column in fields(Row)}
    rows = (Row(**{name: value for name, value in row.items() if name in known}) for row in contents["rows"])
    return {tuple(getattr(row, name) for name in _KEY): row for row in rows}


def _versions(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    before, now = old.get("versions", {}), new.get("versions", {})
    for name in [*before, *(name for name in now if name not in before)]:
        if before.get(name) != now.get(name):
            yield f"{name}: {before.get(name, 'none')} before, {now.get(name, 'none')} now"
    if old.get("machine") != new.get("machine"):
        yield "the machine is another: times are compared in linear solves of the same bodies"


def _counts(before: Mapping[Any, Row], now: Mapping[Any, Row]) -> Iterator[str]:
    gone, come = sum(key not in now for key in before), sum(key not in before for key in now)
    if gone or come:
        yield f"{len(before) - gone} rows are in both reports, {gone} in the old one alone, {come} in the new one alone"


def _of_row(before: Row, now: Row) -> Iterator[tuple[str, ...]]:
    knob = before.knob if before.knob_value is None else f"{before.knob} {before.knob_value:g}"
    place = (before.case, before.method, before.variant, knob)
    if before.verdict != now.verdict:
        yield *place, "verdict", before.verdict, now.verdict
    if before.error_judged is not None and now.error_judged is not None:
        errors = before.error_judged, now.error_judged
        smaller, larger = (max(error, ROUNDING) for error in sorted(errors))
        if larger > FACTOR * smaller:
            yield *place, "error", f"{errors[0]:.1e}", f"{errors[1]:.1e}"
    yield from ((*place, *line) for line in _times(before, now))


def _times(before: Row, now: Row) -> Iterator[tuple[str, str, str]]:
    if before.seconds is None or now.seconds is None:
        return
    unit, scales = "time [ms]", (1e3, 1e3)
    if before.linear_solve_seconds and now.linear_solve_seconds:
        unit, scales = "linear solves", (1 / before.linear_solve_seconds, 1 / now.linear_solve_seconds)
    times = before.seconds * scales[0], now.seconds * scales[1]
    rooms = [
        time * max(row.seconds_spread or 0.0, LEAST_SPREAD) for time, row in zip(times, (before, now), strict=True)
    ]
    if abs(times[0] - times[1]) > sum(rooms):
        yield unit, f"{times[0]:.3g}", f"{times[1]:.3g}"
