"""The quantities of large deformations: loads where the path is, limit points and snaps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypeVar

from contactqp.analysis.large.deformation import LargeHistory, LargeSolution, LimitPoint, Snap
from contactqp.errors import SceneError
from contactqp.scene.claims import Claim

if TYPE_CHECKING:
    from contactqp.scene.answers_of_nodes import Answer

Point = TypeVar("Point", LimitPoint, Snap)


def _history(answer: Answer) -> LargeHistory:
    history = answer.instant.history
    assert isinstance(history, LargeHistory)  # claims of large deformations are asked there only
    return history


def _solution(answer: Answer) -> LargeSolution:
    assert isinstance(answer.solution, LargeSolution)
    return answer.solution


def _load(claim: Claim, answer: Answer, load_factor: float) -> float:
    return float(answer.model.exact_load_at(Fraction(load_factor)).get(str(claim.at), 0))


def _limit(claim: Claim, answer: Answer) -> LimitPoint:
    points = _history(answer).limit_points
    return _numbered(claim, points, "limit points", [f"{p.kind} at {p.load_factor:.6g}" for p in points])


def _snap(claim: Claim, answer: Answer) -> Snap:
    snaps = _history(answer).snaps
    return _numbered(claim, snaps, "snap-throughs", [f"one at {snap.high:.6g}" for snap in snaps])


def _numbered(claim: Claim, points: Sequence[Point], what: str, known: Sequence[str]) -> Point:
    """Counted from 1, or from the end.

    Raises
    ------
    SceneError
        The path has fewer.
    """
    if len(points) < abs(claim.occurrence):
        raise SceneError(
            f"{claim}: expected {abs(claim.occurrence)} {what} or more on the path, got {', '.join(known) or 'none'}"
        )
    return points[claim.occurrence - (claim.occurrence > 0)]


def _limit_displacement(claim: Claim, answer: Answer) -> float:
    place = answer.exact.unknowns.free.index(str(claim.at))
    return float(_limit(claim, answer).displacement[place])


OF_LARGE: Mapping[str, Callable[[Claim, Any], float]] = {
    "load factor": lambda _, answer: _solution(answer).load_factor,
    "load": lambda claim, answer: _load(claim, answer, _solution(answer).load_factor),
    "limit load factor": lambda claim, answer: _limit(claim, answer).load_factor,
    "limit load": lambda claim, answer: _load(claim, answer, _limit(claim, answer).load_factor),
    "limit displacement": _limit_displacement,
    "limit points": lambda _, answer: len(_history(answer).limit_points),
    "snap-through load factor": lambda claim, answer: _snap(claim, answer).high,
    "snap-through load": lambda claim, answer: _load(claim, answer, _snap(claim, answer).high),
    "snap-throughs": lambda _, answer: len(_history(answer).snaps),
}
