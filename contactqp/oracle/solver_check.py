"""Run a solver of another code on the gallery, with one verdict per problem and a table."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from contactqp.errors import ContactQPError, InvalidProblem
from contactqp.model.arguments import checked
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import ANSWER_PARTS
from contactqp.model.summary import aligned
from contactqp.oracle.assertions import solution_fault
from contactqp.oracle.gallery.gallery import problems as gallery_problems
from contactqp.oracle.gallery.problem import GalleryProblem

VERDICTS = ("right", "wrong", "failed")


@dataclass(frozen=True)
class SolverVerdict:
    """The verdict on one problem: "right", "wrong" (a wrong answer was returned), "failed" (it raised)."""

    name: str
    kind: str
    difficulty: str
    verdict: str
    why: str  # empty if right
    seconds: float  # of the solver


@dataclass(frozen=True)
class SolverReport:
    """The verdicts on a solver, printed as a table."""

    verdicts: tuple[SolverVerdict, ...]

    @property
    def passed(self) -> bool:
        """Return whether every answer is right."""
        return all(one.verdict == "right" for one in self.verdicts)

    @property
    def wrong(self) -> tuple[SolverVerdict, ...]:
        """Return the verdicts on wrong answers."""
        return tuple(one for one in self.verdicts if one.verdict == "wrong")

    def table(self) -> str:
        """Return one line per problem, then the number of each verdict."""
        lines = [["problem", "difficulty", "verdict", "seconds", ""]]
        for one in self.verdicts:
            first = one.why.splitlines()[:2]
            lines.append([one.name, one.difficulty, one.verdict, f"{one.seconds:.3f}", " ".join(first)])
        text = aligned(lines)
        counts = [f"{sum(one.verdict == verdict for one in self.verdicts)} {verdict}" for verdict in VERDICTS]
        return "\n".join([*text, ", ".join(counts)])

    def __str__(self) -> str:
        return self.table()


@checked
def check_solver(
    solver: Callable[[ContactProblem], Any],
    problems: Iterable[GalleryProblem] | None = None,
    *,
    rtol: float = 1e-9,
    compression: str = "positive",
) -> SolverReport:
    """Run a solver over the gallery.

    Parameters
    ----------
    solver : callable
        Takes a ContactProblem, returns its answer: a mapping or an object with displacement, normal_force,
        friction_force and tie_force, or a tuple of these in that order; what is missing is recovered where it can be.
    problems : iterable of GalleryProblem, optional
        `contactqp.testing.problems()` by default.
    rtol, compression
        As for `assert_contact_solution`.

    Examples
    --------
    >>> import contactqp as cq
    >>> from contactqp.testing import problems
    >>> check_solver(cq.solve, problems("tied", count=2)).passed
    True
    """
    chosen = gallery_problems() if problems is None else problems
    return SolverReport(tuple(_verdict(solver, exact, rtol, compression) for exact in chosen))


def _verdict(
    solver: Callable[[ContactProblem], Any], exact: GalleryProblem, rtol: float, compression: str
) -> SolverVerdict:
    problem = exact.problem
    start = time.perf_counter()
    try:
        answer, why = solver(problem), ""
    except Exception as error:  # noqa: BLE001  a code under test may raise anything, and others are still to be tried
        answer, why = None, f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - start
    verdict = "failed"
    if answer is not None:
        try:
            fault = solution_fault(exact, rtol, **_parts(answer), compression=compression)
        except ContactQPError as error:  # wrong shapes, or nothing returned
            fault = f"{exact.name}: {error}"
        verdict, why = ("right", "") if fault is None else ("wrong", fault)
    elif not why:
        why = "returned None"
    return SolverVerdict(exact.name, exact.kind, exact.difficulty, verdict, why, seconds)


def _parts(answer: Any) -> dict[str, Any]:
    """Return displacement and forces by name from a solver's result."""
    if isinstance(answer, Mapping):
        unknown = sorted(set(map(str, answer)) - set(ANSWER_PARTS))
        if unknown:
            raise InvalidProblem(f"the solver returned {unknown[0]!r}; known are {', '.join(ANSWER_PARTS)}")
        return {str(name): value for name, value in answer.items()}
    if isinstance(answer, tuple | list):
        if len(answer) > len(ANSWER_PARTS):
            raise InvalidProblem(f"the solver returned {len(answer)} parts; expected at most {', '.join(ANSWER_PARTS)}")
        return dict(zip(ANSWER_PARTS, answer, strict=False))
    found = {name: getattr(answer, name, None) for name in ANSWER_PARTS}
    if found["displacement"] is None and found["normal_force"] is None:
        raise InvalidProblem(
            f"the solver returned a {type(answer).__name__}; expected {', '.join(ANSWER_PARTS)} as a mapping, a tuple "
            "in that order or attributes"
        )
    return found
