"""What an answer costs, counted by factorisations and right-hand sides."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from contactqp.linalg.condensation import Condensation, condense
from contactqp.linalg.factorization import DENSE_SIZE
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Candidate, Work


class Meter:
    """Counts what one answer costs, the condensation included where it is the first to need it."""

    def __init__(self, problem: ContactProblem) -> None:
        self._problem = problem
        self._factorisations = self._back_substitutions = 0

    @contextmanager
    def running(self) -> Iterator[None]:
        factorisations, back_substitutions = self._counts()
        yield
        now = self._counts()
        self._factorisations += now[0] - factorisations
        self._back_substitutions += now[1] - back_substitutions

    def _counts(self) -> tuple[int, int]:
        known: Condensation | None = self._problem._shared.get("condensation")
        return (known.factorisations, known.back_substitutions) if known else (0, 0)

    def read(self, iterations: int | None, corrections: int) -> Work:
        way = condense(self._problem)
        interior = self._problem.dimension - len(way.retained)
        return Work(
            factorisations=self._factorisations,
            back_substitutions=self._back_substitutions,
            iterations=iterations,
            retained=len(way.retained),
            polish_corrections=corrections,
            solver="dense" if way.solver == "superlu" and interior <= DENSE_SIZE else way.solver,
        )


class MeteredAttempt:
    """The part of an attempt that says what it costs, by its meter."""

    candidate: Candidate
    _meter: Meter

    def counting(self) -> object:
        """A context whose work counts as this attempt's."""
        return self._meter.running()

    def work(self, corrections: int) -> Work:
        """What it has cost so far."""
        return self._meter.read(self.candidate.iterations, corrections)
