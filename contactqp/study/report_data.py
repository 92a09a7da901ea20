"""The contents of a report as plain data: the record of each case, the rows and their summary, and what has changed
between two reports: versions, verdicts, errors, and run times beyond their spread.
"""

from __future__ import annotations

import json
import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from contactqp.errors import BackendMissing, ContactQPError, SceneError, Unsupported
from contactqp.scene.claims import Remark
from contactqp.scene.explaining import Explanation, explain
from contactqp.scene.judging import Failure, Judgement, judge, trials
from contactqp.scene.printing import judgement_data
from contactqp.scene.scene import Scene
from contactqp.study import rows
from contactqp.study.answer_pictures import AnswerPictures, answer_pictures
from contactqp.study.case_study import CaseStudy
from contactqp.study.conclusion import MethodLine, conclude, load_of
from contactqp.study.footprint import Footprint
from contactqp.study.rows import COLUMNS, VERDICTS, Row, as_dicts
from contactqp.study.statistics import Rates, method_rates, overview, overview_data
from contactqp.study.truth import Truth


@dataclass(frozen=True)
class Sizes:
    """The numbers of the problem's blocks, under the full load."""

    unknowns: int  # n
    contacts: int  # m
    tangential_rows: int  # (d - 1) m with friction, else 0
    ties: int  # k
    nonzeros: int  # of the stiffness

    @classmethod
    def of(cls, study: CaseStudy) -> Sizes:
        """Return the sizes of the case's problem."""
        problem = study.problem
        tangent, dense = problem.tangent, isinstance(problem.stiffness, np.ndarray)
        return cls(
            unknowns=problem.dimension,
            contacts=problem.contacts,
            tangential_rows=0 if tangent is None else tangent.shape[0],
            ties=problem.ties,
            nonzeros=int(np.count_nonzero(problem.stiffness) if dense else problem.stiffness.nnz),
        )


@dataclass(frozen=True)
class CaseRecord:
    """The facts about one case in a report, apart from its rows."""

    name: str
    title: str
    file: str
    source: str  # where the case comes from
    about: str  # what it is, in the words of its file
    length: str  # unit
    force: str  # unit
    sizes: Sizes
    explanation: Explanation  # what was included and what was left out, and why
    truth: str  # what errors are measured against
    judgements: tuple[dict[str, Any], ...]  # as `contactqp run --json` prints them
    unmet: tuple[str, ...]  # expectations that are not met
    remarks: tuple[Remark, ...]  # sentences of the source and our verdicts on them
    picture: bytes | None = None  # PNG of geometry, deformed shape and contact forces
    history_picture: bytes | None = None  # PNG of a path or a motion
    thumbnail: bytes | None = None  # PNG of the geometry alone, in the size of a stamp
    no_picture: str = ""  # why there is no picture
    contradicted: bool = False  # whether the proven solution contradicts the case's exact values
    physics: str = ""  # what it is about: one of `contactqp.scene.schema.PHYSICS`
    scheme: str = ""  # impact scheme of a motion
    linear_solve: float | None = None  # time of one linear solve of the bodies without contact [s]
    footprint: Footprint | None = None  # time and memory of one answer in a process of its own


def record(study: CaseStudy, truth: Truth | None) -> CaseRecord:
    """Return the record of a case that has been judged and drawn."""
    judged = tuple(_judgements(study.scene))
    drawn = answer_pictures(judged[0]) if judged else AnswerPictures(why_not="no method answers")
    return replace(
        unjudged(study, "nothing, as no answer is proven" if truth is None else truth.source),
        judgements=tuple(judgement_data(outcome) for outcome in judged),
        unmet=tuple(f"{study.name}: {text}" for outcome in judged for text in _unmet(outcome)),
        picture=drawn.answer,
        history_picture=drawn.history,
        thumbnail=drawn.thumbnail,
        no_picture=drawn.why_not,
    )


def unjudged(study: CaseStudy, truth: str, *unmet: str) -> CaseRecord:
    """Return the record of a case before anything is solved; `truth` says what errors are measured against."""
    scene = study.scene
    return CaseRecord(
        name=study.name,
        title=scene.title,
        file=str(scene.file or ""),
        source=scene.source,
        about=scene.about,
        length=scene.units.length,
        force=scene.units.force,
        sizes=Sizes.of(study),
        explanation=explain(scene),
        truth=truth,
        judgements=(),
        unmet=unmet,
        remarks=scene.remarks,
        physics=scene.physics,
        scheme="" if scene.motion is None else scene.motion.scheme,
    )


def _judgements(scene: Scene) -> Iterator[Judgement | Failure]:
    """Yield the judgements of the active-set answer along its load path and of each method that the case names."""
    for trial in trials(scene):
        try:
            yield judge(scene, trial)
        except (BackendMissing, Unsupported):  # the method's own row says so
            continue
        except ContactQPError as error:
            yield Failure(scene, trial, f"{trial}: {error}", error.code)


def _unmet(outcome: Judgement | Failure) -> list[str]:
    """Return the expectations that are not met, in words."""
    if isinstance(outcome, Failure):
        return [outcome.message]
    rows = (*outcome.expectations, *outcome.published)
    return [f"{outcome.trial}: {row.quantity}: expected {row.expected}, got {row.got}" for row in rows if not row.ok]


@dataclass(frozen=True)
class MethodSummary:
    """Counts of one method over all cases and knobs; failures count, missing methods have no rows."""

    method: str
    installed: bool
    tried: int  # rows
    right: int  # the certificate passes and the truth agrees
    refused: int  # refused, not converged, failed, crashed or unsupported
    approximate: int
    wrong_but_passed: int
    own_answers: int  # before polish and certificate; of methods that promise exact ones and have a flag
    claimed: int  # own answers that the method itself called solved
    own_right: int  # own answers that are right, by what was asked of them
    silently_wrong: int  # claimed answers that are wrong


@dataclass(frozen=True)
class Summary:
    """The summary of a whole report."""

    methods: tuple[MethodSummary, ...]
    wrong_but_passed: int  # wrong answers that our certificate passed: must be 0
    silently_wrong: int  # wrong answers that methods called solved
    unmet: tuple[str, ...]  # expectations of the cases that are not met
    contradicted: tuple[str, ...] = ()  # cases whose exact values differ from the proven solution

    @property
    def exit_code(self) -> int:
        """Return 1 if anything claims to be right and is not."""
        return 1 if self.wrong_but_passed or self.unmet else 0

    def cells(self) -> list[list[str]]:
        """Return the table of the methods, headings first."""
        words = {True: "yes", False: "no"}
        lines = [[words[cell] if isinstance(cell, bool) else str(cell) for cell in astuple(m)] for m in self.methods]
        return [[column.name.replace("_", " ") for column in fields(MethodSummary)], *lines]

    def unmet_lines(self) -> list[str]:
        """Return the expectations that are not met, each line once with its count."""
        return [f"{text} ({count} times)" if count > 1 else text for text, count in Counter(self.unmet).items()]

    @property
    def doubt(self) -> str:
        """Return the cases that may be wrong themselves; empty where none is in doubt."""
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
    """Count rows by method. A raw answer is counted once: on its own row if it has one, else on that of the method."""
    methods = tuple(_method_summary(rates, all_rows) for rates in method_rates(all_rows))
    of_rows = (f"{row.case}: {row.method}: {row.message}" for row in all_rows if row.expectations_unmet)
    return Summary(
        methods=methods,
        wrong_but_passed=sum(method.wrong_but_passed for method in methods),
        silently_wrong=sum(method.silently_wrong for method in methods),
        unmet=(*unmet, *of_rows),
        contradicted=tuple(contradicted),
    )


def _method_summary(rates: Rates, all_rows: Sequence[Row]) -> MethodSummary:
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


SCHEMA, SCHEMA_VERSION = "contactqp-report", 2


@dataclass(frozen=True)
class ReportData:
    """The cases, rows and summary of a report, and the machine and versions that they were made with."""

    cases: tuple[CaseRecord, ...]
    rows: tuple[Row, ...]
    summary: Summary
    facts: Mapping[str, Any]  # created, machine, versions, settings, seeds

    def rows_of(self, case: str) -> tuple[Row, ...]:
        """Return the rows of one case."""
        return tuple(row for row in self.rows if row.case == case)


def as_json(data: ReportData) -> str:
    """Return the text of results.json."""
    contents = dict(schema=SCHEMA, schema_version=SCHEMA_VERSION, **data.facts)
    contents |= dict(columns=dict(COLUMNS), verdicts=dict(VERDICTS), summary=asdict(data.summary))
    contents |= dict(
        overview=overview_data(overview(data.rows)), conclusion=conclude(data.rows, load_of(data.facts)).data()
    )
    contents["cases"] = [_case(case) for case in data.cases]
    contents["rows"] = as_dicts(data.rows)
    return json.dumps(contents, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def _case(case: CaseRecord) -> dict[str, Any]:
    return dict(
        name=case.name,
        file=case.file,
        title=case.title,
        units=dict(length=case.length, force=case.force),
        **asdict(case.sizes),
        linear_solve_seconds=case.linear_solve,
        truth=case.truth,
        unmet=list(case.unmet),
        judgements=list(case.judgements),
        footprint=None if case.footprint is None else case.footprint.data(),
    )


# Errors that differ by less than this factor, and those of rounding, are the same.
FACTOR, ROUNDING_OF_ERRORS = 10.0, 1e-12
# The least spread that a time is taken to have: two runs of the same differ by as much.
LEAST_SPREAD = 0.2
_WORDS = ("case", "method", "variant", "condensed", "knob")
_KEY = (*_WORDS, "knob_value")
_NUMBERS = ("knob_value", "error_judged", "seconds", "seconds_spread", "linear_solve_seconds")


def changes(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Return what changed between two reports as text, from the contents of their results.json.

    Times are compared in linear solves of the same bodies where both reports have them, else in seconds. They have
    changed where they differ by more than the sum of their spreads, each at least 20 %. It reports methods that change
    places in the table of the conclusion, and whether their times lie within these spreads. No line is longer than 80
    letters.
    """
    before, now = _rows_by_key(old), _rows_by_key(new)
    found = {key: lines for key in before if key in now and (lines := list(_of_row(before[key], now[key])))}
    parts = [*_versions(old, new), *_counts(before, now)]
    parts += [] if found else ["no verdict, error or time has changed"]
    parts = [textwrap.fill(part, WIDTH, subsequent_indent="  ") for part in parts]
    parts += _table({key: (before[key], lines) for key, lines in found.items()})
    order = _order(list(before.values()), list(now.values()))
    return "\n".join([*parts, *(textwrap.fill(part, WIDTH, subsequent_indent="  ") for part in order)])


# Letters of a line, and of the place of a change in it, at most.
WIDTH, PLACE = 80, 44


def _table(found: Mapping[Any, tuple[Row, Sequence[tuple[str, str, str]]]]) -> Iterator[str]:
    """Yield the lines that tell what has changed: each case, and below it its methods, their knobs and the changes."""
    placed = [(row.case, _place(row), line) for row, lines in found.values() for line in lines]
    widest = min(max((len(place) for _, place, _ in placed), default=0), PLACE)
    case = None
    for this, place, (what, before, now) in placed:
        if this != case:
            case = this
            yield f"{case}:"
        line = f"  {place.ljust(widest)}  {what} {before} before, {now} now"
        yield from textwrap.wrap(line, WIDTH, subsequent_indent=6 * " ", drop_whitespace=True)


def _place(row: Row) -> str:
    """Return the method of a row, its answer and its knob in words."""
    knob = row.knob if row.knob_value is None else f"{row.knob} {row.knob_value:g}"
    return ", ".join(filter(None, (row.method, row.variant, knob)))


# Pairs of methods that are named, at most, where they have changed places.
MOST_PAIRS = 6


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
        if len(swapped) > MOST_PAIRS:
            within = f"{len(swapped)} of {len(names) * (len(names) - 1) // 2} pairs"
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

    Raises SceneError: the file cannot be read, or is not a report.
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


def _rows_by_key(contents: Mapping[str, Any]) -> dict[tuple[Any, ...], Row]:
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


def _of_row(before: Row, now: Row) -> Iterator[tuple[str, str, str]]:
    """Yield what has changed of a row, what it was before, and what it is now."""
    if before.verdict != now.verdict:
        yield "verdict", before.verdict, now.verdict
    if before.error_judged is not None and now.error_judged is not None:
        errors = before.error_judged, now.error_judged
        smaller, larger = (max(error, ROUNDING_OF_ERRORS) for error in sorted(errors))
        if larger > FACTOR * smaller:
            yield "error", f"{errors[0]:.1e}", f"{errors[1]:.1e}"
    yield from _times(before, now)


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
