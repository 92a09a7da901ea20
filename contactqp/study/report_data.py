"""The contents of a report as plain data: the record of each case, the rows and their summary."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields, replace
from typing import Any

import numpy as np

from contactqp.errors import BackendMissing, ContactQPError, Unsupported
from contactqp.scene.claims import Remark
from contactqp.scene.explaining import Explanation, explain
from contactqp.scene.judging import Failure, Judgement, judge, trials
from contactqp.scene.printing import judgement_data
from contactqp.scene.scene import Scene
from contactqp.study import rows
from contactqp.study.answer_pictures import AnswerPictures, answer_pictures
from contactqp.study.case_study import CaseStudy
from contactqp.study.conclusion import conclude
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
        """1 if anything claims to be right and is not."""
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
        """The cases that may be wrong themselves; empty where none is in doubt."""
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
    contents |= dict(overview=overview_data(overview(data.rows)), conclusion=conclude(data.rows).data())
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
