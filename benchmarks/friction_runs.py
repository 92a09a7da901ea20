"""Published problems of friction, each by one of our algorithms or one of Siconos's, all scored by one formula."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

import contactqp as cq
from benchmarks import siconos_peer
from benchmarks.friction_score import Arrays, score
from contactqp.certificate.local_certificate import siconos_local_error
from contactqp.errors import ContactQPError
from contactqp.exchange.local_form import local_form_of
from contactqp.exchange.problem_files import is_problem_file, read_problem
from contactqp.model.local_problem import LocalProblem
from contactqp.solving.friction import algorithms

# Scores up to this are solved.
SOLVED = 1e-8
DEFAULT = "default"
ALGORITHMS = tuple(algorithms.ALGORITHMS)
# Algorithms of convex steps, which see the symmetric part of W only; the backends that keep the cones as they are.
CONVEX = tuple(name for name in ALGORITHMS if algorithms.ALGORITHMS[name].convex)
BACKENDS = {2: "active-set", 3: "clarabel"}
# Eigenvalues of the symmetric part of W below this part of the largest are rounding, or the print precision of files.
RANK = 1e-10
# Limits are looked at between iterations: the last one may end this part of the limit later.
LAST_ITERATION = 0.1
# An asymmetry below this is rounding.
UNSYMMETRIC = 1e-9


@dataclass(frozen=True, eq=False)
class Published:
    """One problem in local form, without joints."""

    name: str
    local: LocalProblem

    @cached_property
    def _velocity_size(self) -> float:
        return float(np.linalg.norm(self.local.offset)) / np.sqrt(len(self.local.offset)) or 1.0

    @cached_property
    def _largest(self) -> float:
        return float(np.max(abs(self.local.delassus.data), initial=0.0)) or 1.0

    @cached_property
    def scaled(self) -> Arrays:
        """The problem with max |W| = 1 and |q| = sqrt(d m)."""
        W = self.local.delassus.tocoo()
        return Arrays(
            W.row, W.col, W.data / self._largest, self.local.offset / self._velocity_size, self.local.friction
        )

    @cached_property
    def rank(self) -> int:
        """The number of eigenvalues of (W + W')/2 above RANK of the largest."""
        W = self.local.delassus.toarray()
        values = np.linalg.eigvalsh((W + W.T) / 2)
        return int(np.sum(values > RANK * values[-1]))

    @property
    def unsymmetric(self) -> bool:
        return self.local.asymmetry > UNSYMMETRIC

    def score(self, force: Any) -> float:
        """The normalised natural-map error of forces (m, d), W as given."""
        return score(self.scaled, np.asarray(force) * (self._largest / self._velocity_size))

    def unscaled(self, force: np.ndarray) -> np.ndarray:
        """(m, d) of scaled forces."""
        shape = (self.local.contacts, self.local.dimension)
        return np.asarray(force).reshape(shape) * (self._velocity_size / self._largest)


@dataclass(frozen=True)
class Run:
    """One algorithm on one problem."""

    algorithm: str
    by: str  # what gave the answer in the end
    error: float  # the score; infinite without an answer
    siconos_error: float
    seconds: float  # of the processor
    claimed: bool  # our certificate passed; Siconos reported success where the score is missed
    ours: bool = True
    remark: str = ""
    elapsed: float = 0.0  # seconds by the clock

    @property
    def solved(self) -> bool:
        """Ours must be certified as well."""
        return self.error <= SOLVED and (self.claimed or not self.ours)

    @property
    def wrong(self) -> bool:
        """Whether something was called solved that is not."""
        return self.claimed and not self.error <= SOLVED

    @property
    def verdict(self) -> str:
        if self.solved:
            return "solved"
        return "WRONGLY CALLED SOLVED" if self.wrong and self.ours else self.remark or "not solved"


def published_problems(folder: Path) -> Iterator[Published]:
    """The problems in a folder, by name, in local form.

    Raises
    ------
    InvalidProblem
        A file cannot be read, or a problem has joints, which Siconos's solvers of local problems do not know.
    """
    for file in sorted(folder.iterdir()):
        if is_problem_file(file):
            local = local_form_of(read_problem(file))
            if local.joints:
                raise cq.InvalidProblem(f"{file.name}: expected a problem without joints, got {local.joints}")
            yield Published(file.name, local)


def run_ours(problem: Published, algorithm: str, time_limit: float, *, polish: bool = True) -> Run:
    """`contactqp.solve`, certificate included; W as given."""
    choice: dict[str, Any] = {} if algorithm == DEFAULT else {"algorithm": algorithm}
    if algorithm in CONVEX:
        choice["method"] = BACKENDS[problem.local.dimension]
    limit = (1 - LAST_ITERATION) * time_limit
    began, busy = time.perf_counter(), time.process_time()
    solution, remark = None, ""
    try:
        solution = cq.solve(problem.local, time_limit=limit, polish=polish, **choice)
    except ContactQPError as error:
        solution, remark = getattr(error, "solution", None), type(error).__name__
    seconds, elapsed = time.process_time() - busy, time.perf_counter() - began
    if solution is None:
        return Run(algorithm, "", np.inf, np.inf, seconds, False, remark=remark, elapsed=elapsed)
    return Run(
        algorithm,
        solution.method,
        problem.score(solution.force),
        siconos_local_error(problem.local, solution.force),
        seconds,
        bool(solution.certificate.passed),
        remark=remark,
        elapsed=elapsed,
    )


def symmetric_floor(problem: Published, time_limit: float) -> float:
    """The score, W as given, of forces that solve the problem with W symmetrised: what a minimisation tends to."""
    W = problem.local.delassus
    symmetric = LocalProblem((W + W.T) / 2, problem.local.offset, problem.local.friction, problem.local.dimension)
    try:
        return problem.score(cq.solve(symmetric, time_limit=time_limit).force)
    except ContactQPError:
        return float("nan")


def warm_up(algorithms: Sequence[str]) -> None:
    """Imports and first calls are no part of the times."""
    for d in (2, 3):
        one = LocalProblem(np.eye(d), [-1.0, 0.5, 0.5][:d], 0.3, d)
        for algorithm in (DEFAULT, *algorithms):
            run_ours(Published("one contact", one), algorithm, 10.0)


def run_siconos(problem: Published, time_limit: float) -> list[Run]:
    """Every solver of Siconos that is tried, Gauss-Seidel first."""
    runs = []
    for solver in siconos_peer.SOLVERS[problem.local.dimension]:
        answer = siconos_peer.solve(problem.scaled, solver, time_limit)
        error = siconos_error = np.inf
        if answer.force is not None:
            force = problem.unscaled(answer.force)
            error, siconos_error = problem.score(force), siconos_local_error(problem.local, force)
        claimed = answer.wrong_claims > 0 and not error <= SOLVED
        remark = answer.ended or ("not solved, though it says so" if claimed else "")
        name = f"Siconos {solver}"
        runs.append(Run(name, name, error, siconos_error, answer.seconds, claimed, ours=False, remark=remark))
    return runs


def best(runs: list[Run]) -> Run:
    """The fastest of those that solved it, else the one with the smallest error."""
    solved = [run for run in runs if run.solved]
    return min(solved, key=lambda run: run.seconds) if solved else min(runs, key=lambda run: run.error)
