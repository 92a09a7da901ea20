"""The pictures of an answer: what moved and what pushes, and of a path or a motion its history."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from typing import TYPE_CHECKING

from contactqp.analysis.history import History
from contactqp.errors import ContactQPError
from contactqp.model.solution import Solution
from contactqp.pictures.contact_fields import ContactFields
from contactqp.pictures.drawing import figure
from contactqp.pictures.frame_drawing import structure_figure
from contactqp.pictures.history_drawing import history_figure
from contactqp.pictures.membrane_drawing import membrane_figure
from contactqp.pictures.small_png import small_png
from contactqp.scene.judging import Failure, Judgement
from contactqp.scene.schema import SceneData
from contactqp.study.answer_fields import fields_of, fields_of_membranes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Times of scenes are in seconds.
TIME_UNIT = "s"
# Dots per inch at which the smallest letters can still be read: bodies have the larger figures and letters.
DPI, DPI_OF_BODIES = 90.0, 75.0


def answer_figure(scene: SceneData, solution: Solution, *, title: str = "") -> Figure:
    """Geometry, deformed shape and contact forces; magnified, large displacements would be others."""
    if scene.membranes:
        return membrane_figure(fields_of_membranes(scene, solution), title=title)
    fields = fields_of(scene, solution)
    if isinstance(fields, ContactFields):
        return figure(fields, title=title)
    return structure_figure(fields, scale=1.0 if scene.large else None, title=title)


@dataclass(frozen=True)
class AnswerPictures:
    """PNG of one answer; None where there is none to draw."""

    answer: bytes | None = None
    history: bytes | None = None  # of a path or a motion
    why_not: str = ""  # why there is no picture of the answer


def answer_pictures(outcome: Judgement | Failure) -> AnswerPictures:
    """Small pictures for a page, without the case's title; nothing is raised where a picture cannot be had."""
    if importlib.util.find_spec("matplotlib") is None:
        return AnswerPictures(why_not="matplotlib is not installed: pip install 'contactqp[report]'")
    history = None if outcome.history is None else _history(outcome.history)
    if isinstance(outcome, Failure):
        return AnswerPictures(history=history, why_not=outcome.message)
    try:
        drawn = answer_figure(outcome.scene, outcome.solution)
    except ContactQPError as error:
        return AnswerPictures(history=history, why_not=str(error))
    return AnswerPictures(small_png(drawn, DPI_OF_BODIES if outcome.scene.meshed else DPI), history)


def _history(history: History) -> bytes | None:
    """One instant has no history."""
    return small_png(history_figure(history, time_unit=TIME_UNIT), DPI) if len(history) > 1 else None
