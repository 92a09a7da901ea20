"""A case judged: which methods it is solved by, and what it says of each answer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from contactqp.errors import (
    BackendFailed,
    BackendMissing,
    InvalidProblem,
    NoEquilibrium,
    NotCertified,
    NotConverged,
    SceneError,
    Unsupported,
)
from contactqp.methods import find
from contactqp.scene.answers import Answer, answer_of
from contactqp.scene.claims import KNOBS, Claim
from contactqp.scene.expectations import Comparison, compare_expectation, compare_published
from contactqp.scene.models import build
from contactqp.scene.running import run_model
from contactqp.scene.schema import Scene
from contactqp.scene.units import Quantity
from contactqp.solution import Solution
from contactqp.solving import solve

if TYPE_CHECKING:
    from contactqp.scene.answers_of_bodies import BodyAnswer
    from contactqp.scene.models import Model

Knob = Quantity | str | float | int | bool
# A step of the load path stands at a load factor if it does so to rounding.
SAME_TIME = 1e-12


@dataclass(frozen=True)
class Trial:
    """A method with the knobs it is run with; quantities still carry their units."""

    method: str = "active-set"
    knobs: Mapping[str, Knob] = field(default_factory=dict)

    def options(self, scene: Scene) -> dict[str, Any]:
        """The knobs as numbers in the scene's units."""
        return {
            name: float(scene.system.value(knob)) if isinstance(knob, Quantity) else knob
            for name, knob in self.knobs.items()
        }

    def concerns(self, claim: Claim) -> bool:
        """Whether the claim is about this method: by name and knobs, or because both are about the exact answer."""
        if claim.method is None:
            return find(self.method).exact
        stated = {name: knob for name, knob in self.knobs.items() if name in (*KNOBS, "update")}
        return claim.method == self.method and claim.knobs == stated

    def __str__(self) -> str:
        return " ".join([self.method, *(f"{name}={knob}" for name, knob in self.knobs.items())])


@dataclass(frozen=True, eq=False)
class Judgement:
    """One trial of one scene."""

    scene: Scene
    model: Model
    trial: Trial
    solution: Solution
    events: Sequence[Any]
    expectations: tuple[Comparison, ...]
    published: tuple[Comparison, ...]

    @property
    def met(self) -> bool:
        """Whether all that the case says of this method holds."""
        return all(row.ok for row in (*self.expectations, *self.published))


@dataclass(frozen=True, eq=False)
class Failure:
    """A trial without an answer."""

    scene: Scene
    trial: Trial
    message: str
    met: bool = False


def judge_all(
    scene: Scene, methods: Sequence[str] = (), knobs: Mapping[str, Knob] | None = None
) -> list[Judgement | Failure]:
    """Every trial of a scene.

    Raises
    ------
    InvalidProblem, Unsupported, BackendMissing, SceneError
        The scene or the method cannot be run at all; the message names the file.
    """
    where = f"{scene.file}: " if scene.file else ""
    try:
        return [
            _outcome(scene, trial, where) for method in methods or (None,) for trial in trials(scene, method, knobs)
        ]
    except (InvalidProblem, Unsupported, BackendMissing, SceneError) as error:
        raise type(error)(f"{where}{error}") from None


def _outcome(scene: Scene, trial: Trial, where: str) -> Judgement | Failure:
    try:
        return judge(scene, trial)
    except (NoEquilibrium, NotConverged, NotCertified, BackendFailed) as error:
        return Failure(scene, trial, f"{where}{trial}: {error}")


def trials(scene: Scene, method: str | None = None, knobs: Mapping[str, Knob] | None = None) -> tuple[Trial, ...]:
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


def judge(scene: Scene, trial: Trial) -> Judgement:
    """Solve a scene by one method and compare with all that the case says of that method."""
    options, model = trial.options(scene), build(scene)
    if scene.path is not None and find(trial.method).exact:
        history = run_model(model, trial.method, **options)
        solutions = {time: solution for time, solution in zip(history.times, history, strict=True)}
        events: Sequence[Any] = history.events
    else:
        solutions = {1.0: solve(model.problem, trial.method, **options)}
        events = ()
    answers = _Answers(model, trial, solutions, events)
    return Judgement(
        scene=scene,
        model=model,
        trial=trial,
        solution=answers.at(Fraction(1)).solution,
        events=events,
        expectations=tuple(
            compare_expectation(claim, answers.at(claim.load_factor)) for claim in scene.expect if trial.concerns(claim)
        ),
        published=tuple(
            compare_published(claim, answers.at(claim.load_factor))
            for claim in scene.published
            if trial.concerns(claim)
        ),
    )


class _Answers:
    """Answers by load factor: from the load path where it has been there, solved for otherwise."""

    def __init__(self, model: Model, trial: Trial, solutions: Mapping[float, Solution], events: Sequence[Any]) -> None:
        self._model, self._trial, self._events = model, trial, events
        self._solutions = dict(solutions)
        self._problem = next(iter(solutions.values())).problem

    def at(self, load_factor: Fraction) -> Answer | BodyAnswer:
        factor = float(load_factor)
        time = next((time for time in self._solutions if abs(time - factor) <= SAME_TIME), None)
        if time is None:
            options = self._trial.options(self._model.scene)
            problem = self._problem.replace(load=self._model.load_at(load_factor))
            self._solutions[factor] = solve(problem, self._trial.method, **options)
            time = factor
        return answer_of(self._model, self._solutions[time], load_factor, self._events)
