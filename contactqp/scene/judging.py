"""A case judged: which methods it is solved by, and what it says of each answer."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.analysis.history import History
from contactqp.errors import (
    BackendFailed,
    BackendMissing,
    InvalidProblem,
    NoEquilibrium,
    NotCertified,
    NotConverged,
    SceneError,
    TimeStepWarning,
    Unsupported,
)
from contactqp.model.engines import SERIAL, engine_named
from contactqp.model.solution import Solution
from contactqp.scene.answers_of_nodes import Answer
from contactqp.scene.claims import KNOBS, Claim
from contactqp.scene.corners import end_time, has_corners
from contactqp.scene.expectations import Comparison, answer_of, compare_expectation, compare_published
from contactqp.scene.instant import Instant
from contactqp.scene.running import built, run_model
from contactqp.scene.schema import SceneData
from contactqp.scene.units import Quantity
from contactqp.solving.methods import find
from contactqp.solving.solve import solve

if TYPE_CHECKING:
    from contactqp.scene.answers_of_bodies import BodyAnswer
    from contactqp.scene.models import Model

Knob = Quantity | str | float | int | bool
# A step of a motion is over at a time if it is so up to this part of a step.
SAME_STEP = 1e-6
# A step of the load path stands at a load factor if it does so to rounding.
SAME_TIME = 1e-12


@dataclass(frozen=True)
class Trial:
    """A method with the knobs it is run with; quantities still carry their units."""

    method: str = "active-set"
    knobs: Mapping[str, Knob] = field(default_factory=dict)
    engine: str = SERIAL
    checkpoint: str | None = None  # the folder for the steps of a load path, of engines that keep them

    def options(self, scene: SceneData) -> dict[str, Any]:
        """The knobs as numbers in the scene's units."""
        return {
            name: float(scene.system.value(knob)) if isinstance(knob, Quantity) else knob
            for name, knob in self.knobs.items()
        }

    def concerns(self, claim: Claim) -> bool:
        """Whether the claim is about this method: by name and knobs, or because both are about the exact answer."""
        if claim.method is None:
            return self.engine != SERIAL or find(self.method).exact
        stated = {name: knob for name, knob in self.knobs.items() if name in (*KNOBS, "update")}
        return claim.method == self.method and claim.knobs == stated

    def __str__(self) -> str:
        engine = [] if self.engine == SERIAL else [f"engine={self.engine}"]
        return " ".join([self.method, *(f"{name}={knob}" for name, knob in self.knobs.items()), *engine])


@dataclass(frozen=True, eq=False)
class Judgement:
    """One trial of one scene."""

    scene: SceneData
    model: Model
    trial: Trial
    history: History
    expectations: tuple[Comparison, ...]
    published: tuple[Comparison, ...]

    @property
    def solution(self) -> Solution:
        """At the end of the load path, or under the full load."""
        return self.history[-1]

    @property
    def met(self) -> bool:
        """Whether all that the case says of this method holds."""
        return all(row.ok for row in (*self.expectations, *self.published))


@dataclass(frozen=True, eq=False)
class Failure:
    """A trial without an answer; `history` is that until then, of a path or a motion that was cut short."""

    scene: SceneData
    trial: Trial
    message: str
    history: History | None = None
    met: bool = False


def judge_all(
    scene: SceneData,
    methods: Sequence[str] = (),
    knobs: Mapping[str, Knob] | None = None,
    engine: str = SERIAL,
    checkpoint: str | None = None,
) -> list[Judgement | Failure]:
    """Every trial of a scene; with an engine of several ranks the same on all of them.

    Raises
    ------
    InvalidProblem, Unsupported, BackendMissing, SceneError
        The scene or the method cannot be run at all; the message names the file.
    """
    where = f"{scene.file}: " if scene.file else ""
    try:
        if engine != SERIAL:
            asked = (Trial(method, dict(knobs or {}), engine, checkpoint) for method in methods or (Trial.method,))
            return [_outcome(scene, trial, where) for trial in asked]
        return [
            _outcome(scene, trial, where) for method in methods or (None,) for trial in trials(scene, method, knobs)
        ]
    except (InvalidProblem, Unsupported, BackendMissing, SceneError) as error:
        raise type(error)(f"{where}{error}") from None


def _outcome(scene: SceneData, trial: Trial, where: str) -> Judgement | Failure:
    try:
        return judge(scene, trial)
    except (NoEquilibrium, NotConverged, NotCertified, BackendFailed) as error:
        history = getattr(error, "history", None)
        so_far = history if isinstance(history, History) else None
        return Failure(scene, trial, f"{where}{trial}: {error}", so_far)


def trials(scene: SceneData, method: str | None = None, knobs: Mapping[str, Knob] | None = None) -> tuple[Trial, ...]:
    """What a case is run with.

    Without `method`: active-set, and every method that the case itself says something about. With `method`, but
    without a knob that it needs: each of the knobs that the case states for it.

    Raises
    ------
    SceneError
        A knob that the method needs is stated neither here nor in the case.
    """
    stated = _distinct(
        Trial(claim.method, claim.knobs) for claim in (*scene.expect, *scene.published) if claim.method is not None
    )
    if method is None:
        return _distinct([Trial(), *stated])
    required = find(method).required
    if all(name in (knobs or {}) for name in required):
        return (Trial(method, dict(knobs or {})),)
    swept = (
        Trial(study.method, {study.knob[0]: float(value) if isinstance(value, Fraction) else value, **study.options})
        for study in scene.study
        for value in study.knob[1]
    )
    found = _distinct(
        Trial(method, {**trial.knobs, **(knobs or {})}) for trial in (*stated, *swept) if trial.method == method
    )
    if not found:
        raise SceneError(
            f'{method}: expected {required[0]}, as in --{required[0]} "1e8 kN/m", and the case states none'
        )
    return found


def _distinct(many: Iterable[Trial]) -> tuple[Trial, ...]:
    found: list[Trial] = []
    for trial in many:
        if trial not in found:
            found.append(trial)
    return tuple(found)


def judge(scene: SceneData, trial: Trial) -> Judgement:
    """Solve a scene by one method and compare with all that the case says of that method.

    Methods that are approximate by design are asked along a load path only where the way matters, with friction.
    """
    options, model = trial.options(scene), built(scene, trial.engine)
    history: History
    if trial.engine != SERIAL:
        history = run_model(model, trial.method, trial.engine, trial.checkpoint, **options)
    elif scene.motion is not None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", TimeStepWarning)  # the history's notes keep what it says
            history = run_model(model, trial.method, **options)
    elif scene.large or (scene.path is not None and (find(trial.method).exact or model.problem.frictional)):
        history = run_model(model, trial.method, **options)
    else:
        history = History([solve(model.problem, trial.method, **options)], [float(end_time(scene))])
    answers = _Answers(model, trial, history)
    return Judgement(
        scene=scene,
        model=model,
        trial=trial,
        history=history,
        expectations=tuple(
            compare_expectation(claim, answers.of(claim)) for claim in scene.expect if trial.concerns(claim)
        ),
        published=tuple(
            compare_published(claim, answers.of(claim)) for claim in scene.published if trial.concerns(claim)
        ),
    )


def _seconds(time: Fraction | Quantity) -> Fraction:
    return time.si if isinstance(time, Quantity) else time


class _Answers:
    """Answers by time: from the motion or load path where it has been there, solved for otherwise."""

    def __init__(self, model: Model, trial: Trial, history: History) -> None:
        self._model, self._trial, self._history = model, trial, history
        self._known: dict[Fraction | Quantity, Answer | BodyAnswer] = {}

    def of(self, claim: Claim) -> Answer | BodyAnswer:
        """The answer that the claim is about.

        Raises
        ------
        SceneError
            With friction, where no step of the path stands there.
        """
        motion = self._model.scene.motion
        if motion is not None:
            return self._moving(motion.end if claim.time is None else _seconds(claim.time))
        if self._model.scene.large:
            return self._deformed(claim)
        whole = end_time(self._model.scene) if has_corners(self._model.scene) else claim.load_factor
        time = whole if claim.time is None else claim.time
        if time not in self._known:
            self._known[time] = self._at(_seconds(time), claim)
        return self._known[time]

    def _moving(self, time: Fraction) -> Answer | BodyAnswer:
        """At the end of the last step that is over at a time, to a rounding of the step."""
        times = self._history.times
        step = max(int(np.searchsorted(times, float(time) + SAME_STEP * (times[1] - times[0]), side="right")) - 1, 0)
        return answer_of(self._model, self._history[step], Instant(history=self._history, step=step))

    def _deformed(self, claim: Claim) -> Answer | BodyAnswer:
        """At a step of the path, which no other load has an answer without."""
        scene, history = self._model.scene, self._history
        wanted, found, what = float(end_time(scene)), history.times, "load factor"
        if claim.time is not None or claim.load_factor != 1:
            wanted = float(claim.load_factor if claim.time is None else _seconds(claim.time))
        elif claim.reached is not None and scene.path is not None:
            what = f"{scene.path.controlled}"
            wanted = float(scene.system.value(claim.reached))
            place = (self._model.problem.dof_names or ()).index(what)
            found = history.displacements[:, place]
        elif scene.path is not None and scene.path.control not in (None, "load"):
            wanted = float(found[-1])
        step = len(found) - 1 - int(np.argmin(abs(found[::-1] - wanted)))
        if abs(found[step] - wanted) > SAME_TIME * max(1.0, float(np.max(abs(found)))):
            raise SceneError(f"{claim}: expected a step of the path, nearest: {what} {found[step]:.12g}")
        instant = Instant(Fraction(float(history.times[step])), history, step)
        return answer_of(self._model, history[step], instant)

    def _at(self, time: Fraction, claim: Claim) -> Answer | BodyAnswer:
        times = self._history.times
        (steps,) = np.nonzero(abs(times - float(time)) <= SAME_TIME)
        if steps.size:
            instant = Instant(time, self._history, int(steps[0]))
            return answer_of(self._model, self._history[int(steps[0])], instant)
        if self._model.problem.frictional:
            nearest = ", ".join(f"{t:.12g}" for t in np.unique(times[np.argsort(abs(times - float(time)))[:2]]))
            raise SceneError(
                f"{claim}: expected a step of the load path, nearest: {nearest}; with friction the answer depends on "
                "the way, and no load off the path has one"
            )
        trial, options = self._trial, self._trial.options(self._model.scene)
        if trial.engine != SERIAL:
            answer_at = engine_named(trial.engine).function("answer_at")
            return answer_of(
                self._model, answer_at(self._model, time, trial.method, **options), Instant(time, self._history)
            )
        problem = self._model.problem.replace(load=self._model.load_at(time))
        return answer_of(self._model, solve(problem, trial.method, **options), Instant(time, self._history))
