"""Judge a case: solve it by the methods that its claims concern, and compare each claimed number with the answer."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from contactqp.analysis.history import History
from contactqp.elements.scalars import Number
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
from contactqp.linalg.runtime import SERIAL, engine_named
from contactqp.model.solution import Solution
from contactqp.scene.answers import Answer, Instant, with_bounds
from contactqp.scene.building import NodeModel
from contactqp.scene.claims import KNOBS, Claim, Expectation, Published
from contactqp.scene.geometry import warn_of_unpushed
from contactqp.scene.scene import STANDARD_INPUT, build_for, run_model
from contactqp.scene.schema import SceneData, end_time, has_corners, is_rotation
from contactqp.scene.shipped import case_path
from contactqp.scene.units import KINDS, NotANumber, Quantity, UnitSystem, read_quantity
from contactqp.solving.methods import find, options_of
from contactqp.solving.solve import solve

if TYPE_CHECKING:
    from contactqp.scene.body_answers import BodyAnswer
    from contactqp.scene.body_model import BodyModel
    from contactqp.scene.building import Model

Knob = Quantity | str | float | int | bool
# A step of a motion counts as completed at a time up to this part of a step.
SAME_STEP = 1e-6
# A step of the load path is at a load factor if both agree to rounding.
SAME_TIME = 1e-12


@dataclass(frozen=True)
class Trial:
    """A method with its options; quantities still carry their units."""

    method: str = "active-set"
    knobs: Mapping[str, Knob] = field(default_factory=dict)
    engine: str = SERIAL
    checkpoint: str | None = None  # the folder for checkpoints of a load path

    def options(self, scene: SceneData) -> dict[str, Any]:
        """Return the options as numbers in the scene's units."""
        return {
            name: float(scene.system.value(knob)) if isinstance(knob, Quantity) else knob
            for name, knob in self.knobs.items()
        }

    def concerns(self, claim: Claim) -> bool:
        """Return whether the claim concerns this method, by name and options or as both refer to the exact answer."""
        if claim.method is None:
            serial = self.engine == SERIAL
            return find(self.method).exact if serial else claim.with_respect_to is None
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

    @cached_property
    def solution(self) -> Solution:
        """Return the solution at the end of the load path or under the full load, also with friction certified with
        bounds.
        """
        return with_bounds(self.history)

    @property
    def met(self) -> bool:
        """Return whether all claims about this method hold; without claims, whether the certificate passes."""
        rows = (*self.expectations, *self.published)
        return all(row.ok for row in rows) if rows else self.solution.certificate.passed


@dataclass(frozen=True, eq=False)
class Failure:
    """A trial without an answer; `history` holds the completed part of a path or motion."""

    scene: SceneData
    trial: Trial
    message: str
    code: str  # code of the error
    history: History | None = None
    met: bool = False


def judge_all(
    scene: SceneData,
    methods: Sequence[str] = (),
    knobs: Mapping[str, Knob] | None = None,
    engine: str = SERIAL,
    checkpoint: str | None = None,
) -> list[Judgement | Failure]:
    """Run every trial of a scene and judge it; with an engine of several ranks the same on all of them.

    Parameters
    ----------
    scene : SceneData
    methods : sequence of str, names of methods; without any, those that `trials` finds in the case
    knobs : mapping of str to Knob, optional
        Options of the methods, each for those that take it; quantities carry their units.
    engine : "serial" or "petsc", as for `contactqp.run`
    checkpoint : the folder for the steps of a load path, of engines that keep them

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
            _outcome(scene, trial, where)
            for method in methods or (None,)
            for trial in trials(scene, method, knobs if method is None else options_of(method, methods, knobs or {}))
        ]
    except (InvalidProblem, Unsupported, BackendMissing, SceneError) as error:
        raise type(error)(f"{where}{error}") from None


def _outcome(scene: SceneData, trial: Trial, where: str) -> Judgement | Failure:
    try:
        return judge(scene, trial)
    except (NoEquilibrium, NotConverged, NotCertified, BackendFailed) as error:
        history = getattr(error, "history", None)
        so_far = history if isinstance(history, History) else None
        return Failure(scene, trial, f"{where}{trial}: {error}", error.code, so_far)


def trials(scene: SceneData, method: str | None = None, knobs: Mapping[str, Knob] | None = None) -> tuple[Trial, ...]:
    """Return the methods and knobs that a case is run with.

    Without `method`: active-set, and every method that the case itself says something about. With `method`, but
    without a knob that it needs: each of the knobs that the case states for it.

    Raises SceneError: a knob that the method needs is stated neither here nor in the case.
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
            f'{method}: the case states no {required[0]}: state one with its unit, such as --{required[0]} "1e8 kN/m"'
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

    Methods that are approximate by design follow a load path only with friction, where the answer depends on it.
    """
    options, model = trial.options(scene), build_for(scene, trial.engine)
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
        warn_of_unpushed(scene, model.problem.gap, history)
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


class _Answers:
    """The answers of a trial at the times that claims ask of: steps of its path or motion, else solved for."""

    def __init__(self, model: Model, trial: Trial, history: History) -> None:
        self._model, self._trial, self._history = model, trial, history
        self._known: dict[Fraction | Quantity, Answer | BodyAnswer] = {}

    def of(self, claim: Claim) -> Answer | BodyAnswer:
        """Return the answer at the instant of the claim.

        Raises
        ------
        SceneError
            With friction, no step of the path is at that instant.
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
        """Return the answer at the end of the last step completed at a time."""
        times = self._history.times
        step = max(int(np.searchsorted(times, float(time) + SAME_STEP * (times[1] - times[0]), side="right")) - 1, 0)
        return answer_of(self._model, self._history[step], Instant(history=self._history, step=step))

    def _deformed(self, claim: Claim) -> Answer | BodyAnswer:
        """Return the answer at a step of the path; large deformations have none between the steps."""
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


def _seconds(time: Fraction | Quantity) -> Fraction:
    return time.si if isinstance(time, Quantity) else time


def answer_of(model: NodeModel | BodyModel, solution: Any, instant: Instant | None = None) -> Answer | BodyAnswer:
    """Return the answer of a scene for claims, by default at the end of the load path or under the full load."""
    instant = instant or Instant(end_time(model.scene))
    if isinstance(model, NodeModel):
        return Answer(model, solution, instant)
    from contactqp.scene.body_answers import BodyAnswer

    return BodyAnswer(model.scene, model, solution, instant)


def value_of(claim: Claim, answer: Answer | BodyAnswer) -> tuple[Number, ...] | str:
    """Return the claim's quantity in the scene's units: a number, words, or a matrix row by row."""
    value = answer.value_of(claim)
    if isinstance(value, str):
        return value
    return tuple(value) if isinstance(value, list | tuple) else (value,)


Shown = float | str | tuple[float, ...]


@dataclass(frozen=True)
class Comparison:
    """A claimed quantity, its expected value, the answer's value, and whether both agree."""

    quantity: str
    expected: Shown
    got: Shown
    unit: str
    error: float  # relative to the largest expected number, or in `unit` if the tolerance is
    tolerance: float
    relative: bool
    ok: bool
    reason: str  # the derivation, or the reason of the verdict
    verdict: str | None = None  # on a printed number
    erratum: str | None = None  # number in the list of errata


def compare_expectation(expectation: Expectation, answer: Answer | BodyAnswer) -> Comparison:
    """Compare the exact value with the answer's."""
    got = value_of(expectation, answer)
    if isinstance(got, str):
        same = set(str(expectation.value).split("; ")) <= set(got.split("; "))
        return Comparison(
            str(expectation), str(expectation.value), got, "", float(not same), 0.0, False, same, expectation.derivation
        )
    system, targets, tolerance = answer.scene.system, expectation.targets, expectation.tolerance
    exact = [system.value(target) for target in targets]
    relative = tolerance.dimension != targets[0].dimension or not any(tolerance.dimension)
    scale = max(map(abs, exact)) if relative else Fraction(1)
    allowed = system.value(tolerance)
    error = _distance(got, exact) / float(scale) if scale else _distance(got, exact)
    return Comparison(
        quantity=str(expectation),
        expected=_shown(exact),
        got=_shown(got),
        unit=_unit(expectation, targets, system),
        error=error,
        tolerance=float(allowed),
        relative=relative,
        ok=len(got) == len(exact) and error <= float(allowed),
        reason=expectation.derivation,
    )


def compare_published(published: Published, answer: Answer | BodyAnswer) -> Comparison:
    """Compare a printed number with the answer: a right one agrees to half a unit of its last digit."""
    got = value_of(published, answer)
    system, target = answer.scene.system, published.target
    printed, half_digit = system.value(target), system.value(published.half_digit)
    error = math.inf if isinstance(got, str) else _distance(got, [printed])
    # The answer is a double, so the comparison allows for its rounding where the exact value lies midway.
    agrees = error <= float(half_digit) * (1 + 1e-9)
    return Comparison(
        quantity=str(published),
        expected=_shown([printed]),
        got=got if isinstance(got, str) else _shown(got),
        unit=_unit(published, [target], system),
        error=error,
        tolerance=float(half_digit),
        relative=False,
        ok=agrees == (published.verdict == "right"),
        reason=f"{published.where}: {published.why}",
        verdict=published.verdict,
        erratum=published.erratum,
    )


def _distance(got: Sequence[Number], exact: Sequence[Fraction]) -> float:
    """Return the largest difference, formed exactly; infinite where a number is not finite."""
    if not all(math.isfinite(number) for number in got) or len(got) != len(exact):
        return math.inf
    return float(max(abs(Fraction(a) - b) for a, b in zip(got, exact, strict=True)))


def _shown(numbers: Sequence[Number]) -> Shown:
    floats = tuple(float(number) for number in numbers)
    return floats[0] if len(floats) == 1 else floats


def _unit(claim: Claim, targets: Sequence[Quantity], system: UnitSystem) -> str:
    """Return the unit of the claim's numbers; none for a matrix of ties, where every column has its own."""
    if is_rotation(claim.at or "") and not any(targets[0].dimension):
        return "rad"
    return "" if claim.quantity == "tie matrix" else system.label(targets[0].dimension)


def are_case_files(arguments: Iterable[str]) -> bool:
    """Return whether all arguments are case files, by suffix or shipped name, or standard input."""
    return all(
        argument == STANDARD_INPUT or (case_path(argument).suffix.lower() == ".toml" and not Path(argument).is_dir())
        for argument in arguments
    )


def case_files(arguments: Iterable[str]) -> list[str]:
    """Return the case files named by path or by `case_path`, and all in named folders."""
    files: list[str] = []
    for argument in arguments:
        if not Path(argument).is_dir():
            files.append(argument if argument == STANDARD_INPUT else str(case_path(argument)))
            continue
        found = sorted(str(file) for file in Path(argument).glob("*.toml"))
        if not found:
            from contactqp.exchange.problem_files import is_problem_file  # not loaded for a case

            matrices = "a problem of matrices; contactqp.compare and contactqp.solve_many take those, in Python"
            found_there = matrices if is_problem_file(argument) else "none"
            raise SceneError(f"{argument}: expected case files (*.toml) in this folder, got {found_there}")
        files += found
    refuse_undecodable(*files)
    return files


def refuse_undecodable(*files: str) -> None:
    """Raise SceneError where the name of a file is not UTF-8, as reports and cases could not contain it."""
    for file in files:
        try:
            file.encode("utf-8")
        except UnicodeEncodeError:
            raise SceneError(f"{file!a}: expected a file whose name is UTF-8, rename it") from None


def read_knobs(
    penalty: str | None, perturbation: str | None, options: Iterable[str], *, bare: bool = False
) -> dict[str, Knob]:
    """Return stiffnesses with their units, and any other ``key=value``, as knobs of a method.

    Raises SceneError: a stiffness or an option of another form.

    Parameters
    ----------
    penalty, perturbation : str or None, a number with a unit of force / length
    options : iterable of str, each of the form key=value
    bare : whether a stiffness may be a number without a unit, as problems of matrices have them
    """
    knobs: dict[str, Knob] = {}
    for name, text in (("penalty", penalty), ("perturbation", perturbation)):
        if text is not None:
            try:
                alone = bare and isinstance(_value(text), int | float)
                knobs[name] = float(text) if alone else read_quantity(text, [KINDS["stiffness"]])
            except NotANumber as error:
                raise SceneError(f"--{name}: {error}") from None
    for option in options:
        name, sign, text = option.partition("=")
        if not sign or not name:
            raise SceneError(f"--option: expected key=value, got {option!r}")
        if name in ("penalty", "perturbation"):
            raise SceneError(f"--option: expected --{name} with its unit, got {option!r}")
        knobs[name] = _value(text)
    return knobs


def _value(text: str) -> Knob:
    """Read a truth value, a whole number, a number or a word."""
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
