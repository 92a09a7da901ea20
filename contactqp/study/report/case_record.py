"""What a report knows of one case besides its rows: plain data, made once, drawn and written by others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactqp.errors import BackendMissing, ContactQPError, Unsupported
from contactqp.scene.claims import Remark
from contactqp.scene.explaining import Explanation, explain
from contactqp.scene.judging import Failure, Judgement, judge, trials
from contactqp.scene.printing import judgement_data
from contactqp.scene.scene import Scene
from contactqp.study.answer_pictures import AnswerPictures, answer_pictures
from contactqp.study.case_study import CaseStudy
from contactqp.study.footprint.footprint import Footprint
from contactqp.study.truth import Truth


@dataclass(frozen=True)
class Sizes:
    """The numbers of the problem's blocks, under the full load."""

    unknowns: int  # n
    contacts: int  # m
    tangential_rows: int  # (d - 1) m where anything rubs, else 0
    ties: int  # k
    nonzeros: int  # of the stiffness

    @classmethod
    def of(cls, study: CaseStudy) -> Sizes:
        """Those of the case's problem."""
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
    """One case as a report tells it."""

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
    unmet: tuple[str, ...]  # expectations that are not met, in words
    remarks: tuple[Remark, ...]  # sentences of the source, with our verdict
    picture: bytes | None = None  # PNG of geometry, deformed shape and contact forces
    history_picture: bytes | None = None  # PNG of a path or a motion
    no_picture: str = ""  # why there is no picture
    contradicted: bool = False  # the case's exact values, by the proven solution
    scheme: str = ""  # by which a motion is stepped
    linear_solve: float | None = None  # seconds of one linear solve of the bodies without contact
    footprint: Footprint | None = None  # what one answer takes in a process of its own


def record(study: CaseStudy, truth: Truth | None) -> CaseRecord:
    """Everything of one case that does not depend on a method's knob."""
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
    """What is known of a case before anything is solved; `truth` says what errors are measured against."""
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
        scheme="" if scene.motion is None else scene.motion.scheme,
    )


def _judgements(scene: Scene) -> Iterator[Judgement | Failure]:
    """All that the case says, of the active-set answer along its load path and of each method that it names itself."""
    for trial in trials(scene):
        try:
            yield judge(scene, trial)
        except (BackendMissing, Unsupported):  # the method's own row says so
            continue
        except ContactQPError as error:
            yield Failure(scene, trial, f"{trial}: {error}")


def _unmet(outcome: Judgement | Failure) -> list[str]:
    """What is not met, in words."""
    if isinstance(outcome, Failure):
        return [outcome.message]
    rows = (*outcome.expectations, *outcome.published)
    return [f"{outcome.trial}: {row.quantity}: expected {row.expected}, got {row.got}" for row in rows if not row.ok]
