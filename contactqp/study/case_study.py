"""Prepare one case for a report: its problem, reference solution, settings of methods, and expectations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np

from contactqp.errors import ContactQPError, SceneError
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution
from contactqp.scene.building import build
from contactqp.scene.claims import Expectation
from contactqp.scene.explaining import report_methods, report_note
from contactqp.scene.judging import answer_of, compare_expectation
from contactqp.scene.scene import Scene, follow, load_scene
from contactqp.scene.units import Quantity
from contactqp.solving.methods import Method
from contactqp.study.comparison import FollowHistory, Timing, answer, timing
from contactqp.study.rows import Row
from contactqp.study.running.journal import digest
from contactqp.study.settings import (
    TOLERANCES,
    Setting,
    all_settings,
    brief_settings,
    note_on_all_unknowns,
    on_all_unknowns,
)
from contactqp.study.truth import Truth, proven_solution, truth_of_solution

# Expected values with a larger relative tolerance are not used as reference.
EXACT = Fraction(1, 10**12)


@dataclass(frozen=True, eq=False)
class CaseStudy:
    """A case with everything that a report tries on it."""

    name: str
    scene: Scene
    problem: ContactProblem
    settings: tuple[Setting, ...]
    left_out: tuple[str, ...] = ()  # settings that are not tried, in words

    @cached_property
    def expected(self) -> FullLoad:
        """Return the expectations of the case under the full load."""
        return FullLoad(self.scene)

    @cached_property
    def follow(self) -> FollowHistory | None:
        """Return the function that follows the history to its last solution; None where one solve gives it.

        The answer depends on the history with friction on a load path, in a motion and at large deformations.
        """
        turns = self.scene.path is not None and self.problem.frictional
        if not (turns or self.scene.motion is not None or self.scene.large):
            return None
        model = build(self.scene)
        return lambda problem, method, **options: follow(model, problem, method, **options)[-1]

    @cached_property
    def digest(self) -> str:
        """Return the digest of the case file and of its problem."""
        file = self.scene.file
        return digest(b"" if file is None else file.read_bytes(), self.problem)

    def answer(self, setting: Setting, truth: Truth | None) -> Row:
        """Return the row of a setting, not timed yet."""
        judge = self.expected.unmet if setting.stands_for_exactness else None
        return answer(self.problem, setting, truth, self.name, judge, self.follow)

    def timing(self, setting: Setting, first: float, warm: bool) -> Timing:
        """Return run times of a setting.

        Parameters
        ----------
        setting : Setting
        first : time of an earlier call [s]
        warm : whether the modules of the method are imported already
        """
        return timing(self.problem, setting, first, self.follow, warm)

    def truth(self) -> Truth | None:
        """Return what the case states exactly, completed by the proven solution; None where neither exists.

        If the two contradict each other beyond the error tolerance, the text on the source states it.
        """
        if self.scene.motion is not None:  # the exact values of the case are those of the continuum
            return None
        if self.scene.large:  # the solution is not that of a single problem
            return None
        own = proven_solution(self.problem)
        displacement, normal_force = self._stated()
        values = np.concatenate([displacement, normal_force])
        count, size = int(np.sum(np.isfinite(values))), len(values)
        if own is None:
            source = "the case's exact values"
            return Truth(displacement, normal_force, None, source, problem=self.problem) if count == size else None
        proven = truth_of_solution(own)
        if not count:
            return proven
        rest = "" if count == size else f" ({count} of {size} numbers; the others: {proven.source})"
        stated = replace(
            proven,
            displacement=np.where(np.isfinite(displacement), displacement, own.displacement),
            normal_force=np.where(np.isfinite(normal_force), normal_force, own.normal_force),
            source=f"the case's exact values{rest}",
        )
        return stated.compared_with(own)

    def _stated(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (n,) displacements and (m,) contact forces that the case states exactly, NaN where it states none."""
        problem = self.problem
        unknowns, contacts = list(problem.dof_names or ()), list(problem.contact_names or ())
        vectors = np.full(problem.dimension, np.nan), np.full(problem.contacts, np.nan)
        places = {"displacement": (vectors[0], unknowns), "normal force": (vectors[1], contacts)}
        for claim in self.scene.expect:
            vector, names = places.get(claim.quantity, (vectors[0], []))
            if _at_full_load(claim) and claim.at in names and _is_exact(claim):
                vector[names.index(claim.at)] = float(self.scene.system.value(claim.targets[0]))
        return vectors


def _at_full_load(claim: Expectation) -> bool:
    at_end = claim.load_factor == 1 and claim.time is None and claim.reached is None and claim.with_respect_to is None
    of_history = claim.measure.path or claim.measure.motion or claim.measure.whole_way
    return claim.method is None and at_end and claim.measure.solved and not of_history


def _is_exact(claim: Expectation) -> bool:
    # A value of zero is exact whatever its absolute tolerance.
    target = claim.targets[0]
    return target.si == 0 or (not any(claim.tolerance.dimension) and claim.tolerance.si <= EXACT)


class FullLoad:
    """The expectations of a case that every exact answer under the full load must meet."""

    def __init__(self, scene: Scene) -> None:
        self._model = build(scene)
        self._claims = [claim for claim in scene.expect if _at_full_load(claim)]

    def unmet(self, solution: Solution) -> Sequence[str] | None:
        """Return the expectations that this answer misses; None where there are none to compare."""
        answer = answer_of(self._model, solution)
        missed = [str(claim) for claim in self._claims if not compare_expectation(claim, answer).ok]
        return missed if self._claims else None


def _refuse_twins(paths: Sequence[Path]) -> None:
    """Raise SceneError where two cases have the same name."""
    seen: dict[Path, Path] = {}
    for path in paths:
        before = seen.setdefault(path.resolve(), path)
        if before is not path:
            raise SceneError(f"{path}: expected each case once, got it as {before} too")


def load_studies(
    files: Iterable[str | Path],
    methods: Sequence[Method],
    tolerances: Sequence[float] = TOLERANCES,
    brief: bool = False,
) -> tuple[CaseStudy, ...]:
    """Return the cases with their settings; all files are read before anything is solved.

    With `brief` the settings are those of `brief_settings`, whatever tolerances and ladders are asked for.

    Raises SceneError, InvalidProblem: a file is not a case, or its problem is invalid; the message names the file.

    Parameters
    ----------
    files : iterable of paths, case files
    methods : sequence of Method, those to be tried, where a case does not limit them
    tolerances : sequence of float, for methods that take one
    brief : whether each method has few settings
    """
    paths = [Path(file) for file in files]
    _refuse_twins(paths)
    stems = [path.stem for path in paths]
    studies = []
    for path in paths:
        scene = load_scene(path)
        try:
            problem = scene.problem()
        except ContactQPError as error:
            raise type(error)(f"{path}: {error}") from None
        limit = report_methods(scene)
        tried = tuple(method for method in methods if limit is None or method.name in limit[0])
        name = path.stem if stems.count(path.stem) == 1 else f"{path.parent.name}-{path.stem}"
        if brief:
            settings = tuple(setting for method in tried for setting in brief_settings(problem, method))
            left_out: tuple[str, ...] = (report_note(scene),)
        else:
            settings = tuple(setting for method in tried for setting in _settings(scene, problem, method, tolerances))
            left_out = report_note(scene), note_on_all_unknowns(problem, tried)
        studies.append(CaseStudy(name, scene, problem, settings, tuple(filter(None, left_out))))
    return tuple(studies)


def _settings(scene: Scene, problem: ContactProblem, method: Method, tolerances: Sequence[float]) -> Iterator[Setting]:
    settings = tuple(all_settings(problem, method, tolerances, stated_ladders(scene, method)))
    yield from settings
    if scene.motion is None and not scene.large:  # every step of which is a separate problem
        yield from on_all_unknowns(problem, settings)


def stated_ladders(scene: Scene, method: Method) -> list[tuple[str, str, list[float]]]:
    """Return the (variant, knob, values) that the case's study tables state for a method, in the scene's units."""
    ladders = []
    for study in scene.study:
        if study.method == method.name:
            knob, values = study.knob
            numbers = [float(scene.system.value(v) if isinstance(v, Quantity) else v) for v in values]
            ladders.append(("uzawa" if study.update == "uzawa" else "", knob, numbers))
    return ladders
