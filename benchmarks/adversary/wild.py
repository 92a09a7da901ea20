"""Numbers of any size, thrown at every function: whatever leaves must be an answer or an error of this package."""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
from collections.abc import Callable
from typing import Any

import numpy as np

import contactqp as cq
from benchmarks.adversary.judging import Judge
from benchmarks.bricks import Generator
from contactqp.cli import main

METHODS = (
    *["active-set"] * 4,
    "clarabel",
    "piqp",
    "osqp",
    "lemke",
    "lagrange-multiplier",
    "daqp",
    "augmented-lagrangian",
)
REACHES = (3, 30, 100, 150, 300)


def _size(rng: Generator, reach: float) -> float:
    return float(10.0 ** rng.uniform(-reach, reach))


def draw(rng: Generator) -> dict[str, Any]:
    """The arguments of a problem of at most five unknowns, in which every array may have a unit of its own."""
    n, m, d = int(rng.integers(1, 6)), int(rng.integers(0, 4)), int(rng.integers(1, 4))
    reach = float(rng.choice(REACHES))
    shape = rng.normal(size=(n, max(n - int(rng.random() < 0.2), 1)))
    K = shape @ shape.T * (0.0 if rng.random() < 0.1 else 1.0)
    own = 10.0 ** rng.uniform(-reach / 2, reach / 2, n) if rng.random() < 0.4 else np.ones(n)
    row = 10.0 ** rng.uniform(-reach, reach, m) if rng.random() < 0.4 else np.ones(m)

    def sometimes(chance: float = 0.5) -> float:
        return _size(rng, reach) if rng.random() < chance else 1.0

    arguments: dict[str, Any] = dict(
        stiffness=K * np.outer(own, own) * sometimes(),
        load=rng.normal(size=n) * own * sometimes(),
        normal=rng.integers(-2, 3, (m, n)) * row[:, None],
        gap=rng.normal(size=m) * row * sometimes(),
    )
    if m and rng.random() < 0.1:
        arguments["gap"][0] = np.inf
    if d > 1 and m:
        arguments["tangent"] = rng.integers(-2, 3, ((d - 1) * m, n)) * np.repeat(row, d - 1)[:, None] * sometimes(0.2)
        arguments["friction"] = float(10.0 ** rng.uniform(-300, 6)) if rng.random() < 0.3 else 0.5
        if rng.random() < 0.3:
            arguments["slip_origin"] = rng.normal(size=(m, d - 1)) * _size(rng, reach)
    if rng.random() < 0.3:
        k = int(rng.integers(1, 3))
        arguments["tie"] = rng.integers(-2, 3, (k, n)) * sometimes(0.4)
        arguments["tie_value"] = rng.normal(size=k) * (_size(rng, 300) if rng.random() < 0.4 else 1.0)
    return arguments


def judge_wild(judge: Judge, rng: Generator) -> None:
    """Build, solve, certify and diagnose one problem of wild numbers."""

    def ask(what: str, question: Callable[[], Any]) -> Any:
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            answer, error = judge.ask(what, question)
        if said.getvalue():
            judge.found("printed", what, said.getvalue()[:100])
        return answer if error is None else getattr(error, "solution", None)

    if rng.random() < 0.15:
        _judge_local(ask, rng)
        return
    with np.errstate(all="ignore"):
        arguments = draw(rng)
    problem = ask("ContactProblem", lambda: cq.ContactProblem(**arguments))
    if problem is None:
        return
    method = str(rng.choice(METHODS))
    solution = ask(f"solve {method}", lambda: cq.solve(problem, method))
    if isinstance(solution, cq.Solution):
        for name in ("energy", "gap", "slip"):
            ask(f"Solution.{name}", lambda name=name: getattr(solution, name))
    else:
        solution = None
    with np.errstate(all="ignore"):
        parts = _candidate(rng, problem, solution)
    judged = ask("certify", lambda: cq.certify(problem, *parts))
    if judged is not None and rng.random() < 0.5:
        for name in ("findings", "diagnosis", "contacts"):
            ask(f"JudgedAnswer.{name}", lambda name=name: getattr(judged, name))
        ask("JudgedAnswer.table", judged.table)
    if rng.random() < 0.2:
        for function in (cq.equilibria, cq.critical_friction, cq.exact, cq.existence_margin, cq.associated_difference):
            ask(function.__name__, lambda function=function: function(problem))
        if not problem.frictional:  # with friction a step that has no answer takes seconds, and a path has many
            ask("follow_path", lambda: cq.follow_path(problem, [problem.load, 2 * problem.load]))
    if solution is not None and rng.random() < 0.1:
        ask("run --json", lambda: _run_as_json(problem))


def _run_as_json(problem: cq.ContactProblem) -> None:
    """Solve a problem from its folder by the command line, which must print JSON."""
    with tempfile.TemporaryDirectory() as folder:
        cq.write_problem(folder, problem)
        said, why = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(why), contextlib.suppress(SystemExit):
            main(["run", folder, "--json"])
        json.loads(said.getvalue())


def _judge_local(ask: Callable[[str, Callable[[], Any]], Any], rng: Generator) -> None:
    """The same with forces alone, whose compliance, offset and friction have any size."""
    m, d = int(rng.integers(1, 4)), int(rng.integers(2, 4))
    reach = float(rng.choice(REACHES))
    with np.errstate(all="ignore"):
        shape = rng.normal(size=(m * d, m * d - int(rng.random() < 0.3)))
        own = 10.0 ** rng.uniform(-reach / 2, reach / 2, m * d) if rng.random() < 0.4 else np.ones(m * d)
        W = shape @ shape.T * np.outer(own, own) * _size(rng, reach)
        q = rng.normal(size=m * d) * own * _size(rng, reach)
        friction = float(10.0 ** rng.uniform(-300, 6)) if rng.random() < 0.3 else 0.5
        force = rng.normal(size=m * d) * _size(rng, 300)
    problem = ask("LocalProblem", lambda: cq.LocalProblem(W, q, friction, d))
    if problem is None:
        return
    if m * d <= 4:  # in space without an answer it takes seconds
        ask("solve local", lambda: cq.solve(problem))
    for function in (cq.certify_local, cq.fclib_merit_1, cq.siconos_local_error, cq.acary_bremond_huber_error):
        ask(function.__name__, lambda function=function: function(problem, force))


def _candidate(rng: Generator, problem: cq.ContactProblem, solution: Any) -> tuple[Any, ...]:
    """Displacement and forces: near those of a solution, or of any size, now and then no numbers."""

    def values(shape: Any) -> np.ndarray:
        return np.asarray(rng.normal(size=shape) * _size(rng, 300))

    near = solution is not None and rng.random() < 0.5
    u = solution.displacement * _size(rng, 1) if near else values(problem.dimension)
    if rng.random() < 0.1:
        u = np.where(np.arange(len(u)) == 0, float(rng.choice([np.nan, 1e308, np.inf])), u)
    normal = solution.normal_force if near and rng.random() < 0.5 else values(problem.contacts)
    friction = None if problem.slip_origin is None else values(problem.slip_origin.shape)
    return u, normal, friction, values(problem.ties)
