"""Somebody else's answer to a case, judged: displacements and forces from JSON, in the case's units and our signs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate import certify
from contactqp.errors import ContactQPError, Unsupported
from contactqp.exchange.refusal import naming, read_bytes, wrong
from contactqp.problem import ContactProblem
from contactqp.scene.loading import load_scene
from contactqp.scene.models import build
from contactqp.scene.running import run_model
from contactqp.solution import Solution
from contactqp.study.friction_files import DEFAULT_METHOD, finite
from contactqp.study.verdict import Verdict, finite_list

EXPECTED = "a JSON file with displacement and normal_force"
# Forces that differ by less than this part of the largest are shown as the same.
SAME_FORCE = 1e-6


@dataclass(frozen=True, eq=False)
class ContactComparison:
    """Forces of one contact, as given and as they should be."""

    name: str
    normal_force: float
    friction_force: NDArray[np.float64] | None
    right_normal_force: float
    right_friction_force: NDArray[np.float64] | None

    def data(self) -> dict[str, Any]:
        return {
            "contact": self.name,
            "normal_force": finite(self.normal_force),
            "friction_force": finite_list(self.friction_force),
            "right_normal_force": finite(self.right_normal_force),
            "right_friction_force": finite_list(self.right_friction_force),
        }


@dataclass(frozen=True, eq=False)
class CaseVerdict(Verdict):
    """What is said of an answer to a case."""

    problem: ContactProblem
    worst: tuple[ContactComparison, ...]  # contacts whose forces differ from the right ones, most first


def check_case(problem_file: str, candidate_file: str, tolerance: float = 1e-9) -> CaseVerdict:
    """Judge an answer against a case file.

    Raises
    ------
    SceneError, InvalidProblem
        Of either file.
    Unsupported
        A motion, a load path with friction, a large deformation: what is right at its end depends on the way there.
    """
    scene = load_scene(problem_file)
    model = build(scene)
    problem = model.problem
    if scene.motion is not None:
        raise Unsupported(f"{problem_file}: check: a motion has no answer of its own at its end")
    if scene.large:
        raise Unsupported(f"{problem_file}: check: a large deformation has no problem of its own at its end")
    if scene.path is not None and problem.frictional:
        raise Unsupported(f"{problem_file}: check: a load path with friction has no answer of its own at its end")
    data = _read(candidate_file)
    d = 2 if problem.tangent is None else 1 + problem.tangent.shape[0] // max(problem.contacts, 1)
    m, ties = problem.contacts, tuple(tie.name for tie in scene.ties)
    names = problem.contact_names or ()
    given: dict[str, Any] = {
        "displacement": _values(candidate_file, data, "displacement", problem.dof_names or (), (problem.dimension,)),
        "normal_force": _values(candidate_file, data, "normal_force", names, (m,)),
    }
    if problem.frictional:
        given["friction_force"] = _values(candidate_file, data, "friction_force", names, (m, d - 1))
    if problem.ties:
        given["tie_force"] = _values(candidate_file, data, "tie_force", ties, (problem.ties,))
    with naming(candidate_file):
        certificate = certify(problem, **given, tolerance=tolerance)
    right, why_not = None, None
    if not certificate.passed:
        try:
            right = run_model(model, DEFAULT_METHOD)[-1]
        except ContactQPError as error:
            why_not = str(error)
    worst = _worst(problem, given, right) if right is not None else ()
    return CaseVerdict(problem_file, candidate_file, problem, certificate, worst, right, why_not)


def _read(path: str) -> Mapping[str, Any]:
    """The one answer in a JSON file, alone or as the only one in a list."""
    try:
        data = json.loads(read_bytes(path, EXPECTED))
    except (ValueError, RecursionError) as error:
        raise wrong(path, "content", EXPECTED, " ".join(str(error).split())) from None
    if isinstance(data, list):
        if len(data) != 1:
            raise wrong(path, "content", "one answer", f"{len(data)}")
        data = data[0]
    if not isinstance(data, dict):
        raise wrong(path, "content", EXPECTED, type(data).__name__)
    return data


def _values(
    path: str, data: Mapping[str, Any], key: str, names: Sequence[str], shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """Numbers by name or in order."""
    if key not in data:
        raise wrong(path, key, "this key", f"{sorted(data)}")
    values = data[key]
    if isinstance(values, dict):
        if sorted(values) != sorted(names):
            odd = sorted(set(values) ^ set(names))
            raise wrong(path, key, f"{len(names)} values by name", f"a difference in {', '.join(odd[:5])}")
        values = [values[name] for name in names]
    try:
        array = np.array([np.nan if value is None else value for value in values], dtype=float)
    except (TypeError, ValueError) as error:
        raise wrong(path, key, "numbers", " ".join(str(error).split())) from None
    if array.shape != shape and not (len(shape) == 2 and array.shape == (shape[0] * shape[1],)):
        raise wrong(path, key, f"shape {shape}", f"{array.shape}")
    return array.reshape(shape)


def _worst(problem: ContactProblem, given: Mapping[str, Any], right: Solution) -> tuple[ContactComparison, ...]:
    normal = given["normal_force"]
    rubs, right_rubs = given.get("friction_force"), right.friction_force
    apart = abs(normal - right.normal_force)
    if rubs is not None and right_rubs is not None:
        apart = np.maximum(apart, np.max(abs(rubs - right_rubs), axis=1, initial=0.0))
    apart = np.where(np.isfinite(apart), apart, np.inf)
    beyond = np.flatnonzero(apart > SAME_FORCE * np.max(abs(right.normal_force), initial=0.0))
    return tuple(
        ContactComparison(
            name=problem.contact_name(int(i)),
            normal_force=float(normal[i]),
            friction_force=None if rubs is None else rubs[i],
            right_normal_force=float(right.normal_force[i]),
            right_friction_force=None if right_rubs is None else right_rubs[i],
        )
        for i in beyond[np.argsort(-apart[beyond], kind="stable")]
    )
