"""Pictures and VTU files of what was solved on the command line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from contactqp.analysis.history import History
from contactqp.errors import InvalidProblem
from contactqp.pictures.history_drawing import draw_history
from contactqp.pictures.style import check_picture, save
from contactqp.pictures.vtu import check_vtu, write_vtu
from contactqp.scene.judging import Failure, Judgement, Trial
from contactqp.scene.schema import SceneData
from contactqp.study.answer_fields import fields_of
from contactqp.study.answer_pictures import TIME_UNIT, answer_figure

# What the picture of a history is called after its case and method.
HISTORY = "history"


@dataclass(frozen=True)
class AnswerFiles:
    """Where answers are drawn and written to.

    Parameters
    ----------
    plot, vtu : Path or None
        As asked for. With several cases the name of the case is put before the suffix, with several answers of one
        case the method too: ``bar.png`` becomes ``bar.truss_floor.lemke.png``. A history is drawn to a picture of its
        own, ``bar.history.png``.
    several_cases : bool
    every_method : bool
        All answers of a case; otherwise the first one, which is the one that is printed in full.
    """

    plot: Path | None
    vtu: Path | None
    several_cases: bool
    every_method: bool

    def write(self, outcomes: Sequence[Judgement | Failure]) -> list[Path]:
        """Write the files of one scene's outcomes, and return them.

        A trial without an answer has none, but for the picture of a history that was cut short.
        """
        chosen = outcomes if self.every_method else outcomes[:1]
        written = []
        for outcome in chosen:
            names = [_stem(outcome.scene)] if self.several_cases else []
            names += [_slug(outcome.trial)] if len(chosen) > 1 else []
            if isinstance(outcome, Judgement):
                written += self._write_one(outcome, names)
            elif outcome.history is not None:
                title = f"{outcome.scene.title}, {outcome.trial}, as far as it came"
                written += self._write_history(outcome.history, title, names)
        return written

    def _write_one(self, judgement: Judgement, names: Sequence[str]) -> list[Path]:
        written = []
        if self.plot is not None:
            written.append(_named(self.plot, names))
            title = f"{judgement.scene.title}, {judgement.trial}"
            save(answer_figure(judgement.scene, judgement.solution, title=title), written[-1])
            written += self._write_history(judgement.history, title, names)
        if self.vtu is not None:
            written.append(_named(self.vtu, names))
            write_vtu(fields_of(judgement.scene, judgement.solution), written[-1])
        return written

    def _write_history(self, history: History, title: str, names: Sequence[str]) -> list[Path]:
        """The picture of a path or a motion; one instant has none."""
        if self.plot is None or len(history) < 2:
            return []
        file = _named(self.plot, [*names, HISTORY])
        draw_history(history, file, title=title, time_unit=TIME_UNIT)
        return [file]


def answer_files(scenes: Sequence[SceneData], plot: str | None, vtu: str | None, *, every_method: bool) -> AnswerFiles:
    """What the command line asks for, checked before anything is solved.

    Raises
    ------
    InvalidProblem
        A wrong suffix, a folder that is not there, two cases that would write to one file.
    BackendMissing
        matplotlib or meshlane is not installed.
    """
    stems = [_stem(scene) for scene in scenes]
    stems += [f"{stem}.{HISTORY}" for stem in stems if plot is not None]
    twice = next((stem for stem in stems if stems.count(stem) > 1), None)
    if twice is not None:
        asked = Path(plot if plot is not None else str(vtu))
        raise InvalidProblem(
            f"{asked}: expected cases whose files have distinct names, got {twice!r} more than once: they would all be "
            f"written to {_named(asked, [twice])}"
        )
    return AnswerFiles(
        None if plot is None else check_picture(plot),
        None if vtu is None else check_vtu(vtu),
        len(scenes) > 1,
        every_method,
    )


def _stem(scene: SceneData) -> str:
    return scene.file.stem if scene.file is not None else scene.title


def _slug(trial: Trial) -> str:
    """The trial as a part of a file name: ``penalty-penalty=1e8-kN-m``."""
    return re.sub(r"[^\w.+=-]+", "-", str(trial))


def _named(file: Path, names: Sequence[str]) -> Path:
    return file.with_name(".".join([file.stem, *names]) + file.suffix)
