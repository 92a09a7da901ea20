"""Quadratic programs of other people: what is passed, how narrow the energy is enclosed, in what time.

    python -m benchmarks.collections FOLDER                     # .mat of qpbenchmark, .npz of qpsolvers, .qps
    python -m benchmarks.collections FOLDER --method clarabel   # another method of `solve`
    python -m benchmarks.collections FOLDER --limit 60 --only QAFIRO HS118
    python -m benchmarks.collections FOLDER --varied 200       # the small ones in other units, scales and orders
    python -m benchmarks.collections FOLDER --through piqp clarabel   # what is built round backends, in their own time

A row a problem: `cq.solve` with its certificate (`proven`, `passed`, or why not), what the problem determines, the
width of the enclosed energy as a part of it, seconds; beside it PIQP and Clarabel as they are, at tolerances of 1e-9,
by qpsolvers: whether they call it found, and seconds. Each problem is read and solved in a process of its own, after a
small one that loads what is needed, one after another, with the threads of the environment (OMP_NUM_THREADS), and given
up after the limit. At the end the counts, the shifted geometric means of the seconds (shift 1 s, the limit where
nothing was found) over PIQP's, and how many problems were passed within 1, 2, 5, 10, ... times the time of the fastest.

With `--through` the rows are of `cq.solve(problem, backend)`: raw answer, set, polish and certificate, over the time of
the backend alone, both taken in one process, the backend first, in seconds of the processor. Counted are those of the
problems for which the backend alone takes a tenth of a second and more.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize  # noqa: F401  what is loaded once is not counted
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg import pardiso
from contactqp.solving.methods import Settings, find

BESIDE = {
    "piqp": ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"),
    "clarabel": ("tol_gap_abs", "tol_gap_rel", "tol_feas"),
}
TOLERANCE, LIMIT, SHIFT = 1e-9, 60.0, 1.0
PASSED, DIFFERENT, SMALL = ("proven", "passed"), 1e-5, 1500
FACTORS = (1, 2, 5, 10, 100, 1000)
# Backends that take less are not compared with; what all of it may cost, in times of theirs.
NOTABLE, MOST = 0.1, 3.0
# Beside other work a second of the processor takes some seconds of the clock.
PATIENCE = 4.0


def varied(problem: cq.ContactProblem, seed: int) -> tuple[cq.ContactProblem, float]:
    """The problem in other units, scales and orders, and the factor of its energy."""
    random = np.random.default_rng(seed)
    spread, factor = int(random.integers(0, 4)), 10.0 ** random.integers(-4, 5)
    sizes = problem.dimension, problem.contacts, problem.ties
    scales = [sp.diags(10.0 ** random.integers(-spread, spread + 1, size)) for size in sizes]
    D, R, T = (sp.csr_matrix(scale)[random.permutation(scale.shape[0])] for scale in scales)
    matrices = factor * D @ problem.stiffness_rows @ D.T, R @ problem.normal @ D.T, T @ problem.tie @ D.T
    stiffness, normal, tie = (sp.csr_matrix(matrix) for matrix in matrices)
    vectors = factor * (D @ problem.load), R @ problem.gap, T @ problem.tie_value
    other = cq.ContactProblem(stiffness, vectors[0], normal, vectors[1], tie=tie, tie_value=vectors[2])
    return other, factor


def solved(path: str, method: str, seed: int | None = None, processor: bool = False) -> dict[str, Any]:
    """What `cq.solve` makes of a file, or of the variant of it with this seed."""
    problem, factor, clock = cq.read_problem(path), 1.0, time.process_time if processor else time.perf_counter
    if seed is not None:
        problem, factor = varied(problem, seed)
    for condense in (True, False):
        cq.solve(cq.ContactProblem([[1.0]], [1.0], [[1.0]], [0.5]), condense=condense)
    started = clock()
    row: dict[str, Any] = dict(unknowns=problem.dimension, rows=problem.contacts, ties=problem.ties)
    try:
        solution = cq.solve(problem, method)
    except cq.ContactQPError as error:
        return row | dict(verdict=type(error).__name__, why=str(error)[:200], seconds=clock() - started)
    certificate = solution.certificate
    width = None
    if certificate.energy_bounds is not None:
        lower, upper = certificate.energy_bounds
        width = (upper - lower) / max(abs(lower), np.finfo(float).tiny)
    elif certificate.energy_error is not None:
        width = certificate.energy_error**2
    verdict = "proven" if certificate.proven else "passed" if certificate.passed else "refused"
    row |= dict(verdict=verdict, determined=certificate.determined, width=width, energy=solution.energy / factor)
    return row | dict(seconds=clock() - started)


def as_it_is(path: str, backend: str, processor: bool = False) -> dict[str, Any]:
    """A backend's own answer to the same arrays, and whether it passes."""
    from qpsolvers import Problem, solve_problem
    from qpsolvers.exceptions import QPError

    problem, clock = cq.read_problem(path), time.process_time if processor else time.perf_counter
    program = problem.to_qp()
    arrays = {name: _own(value) for name, value in vars(program).items()}
    options = dict.fromkeys(BESIDE[backend], TOLERANCE)
    solve_problem(Problem(sp.identity(2, format="csc"), np.ones(2), lb=np.zeros(2)), backend, **options)
    started = clock()
    try:
        answer = solve_problem(Problem(**arrays), backend, **options)
    except (QPError, ValueError, TypeError, RuntimeError, ArithmeticError, cq.ContactQPError) as error:
        return dict(verdict=type(error).__name__, seconds=clock() - started)
    seconds = clock() - started
    energy = problem.energy(answer.x) if answer.found else None
    return dict(verdict="found" if answer.found else "not found", seconds=seconds, energy=energy)


def through(path: str, backend: str) -> dict[str, Any]:
    """What a backend takes alone, and `cq.solve` by it, in seconds of the processor."""
    problem, settings = cq.read_problem(path), Settings(TOLERANCE)
    warm_up = cq.ContactProblem(sp.identity(SMALL) * 2.0, np.ones(SMALL), sp.identity(SMALL), np.zeros(SMALL))
    try:
        cq.solve(warm_up, backend)
    except cq.BackendMissing as error:
        return dict(verdict=str(error))
    if pardiso.available():
        pardiso.Pardiso(sp.identity(2, format="csr"), np.zeros(0, dtype=np.intp))
    started = time.process_time()
    try:
        claimed = find(backend).solve(problem, settings).claimed
    except cq.ContactQPError as error:
        return dict(verdict=type(error).__name__, alone=time.process_time() - started, seconds=0.0)
    alone, started = time.process_time() - started, time.process_time()
    try:
        certificate = cq.solve(problem, backend).certificate
        verdict = "proven" if certificate.proven else "passed"
    except cq.ContactQPError as error:
        verdict = type(error).__name__
    row = dict(verdict=verdict, found=claimed, alone=alone, seconds=time.process_time() - started)
    return row | dict(unknowns=problem.dimension, rows=problem.contacts, ties=problem.ties)


def all_through(files: list[Path], backends: list[str], limit: float) -> int:
    """A row a problem and backend, and how many times the backend's own time the answer takes."""
    for backend in backends:
        factors = []
        for file in files:
            row = apart(through, str(file), backend, limit=limit)
            if "found" not in row:
                print(f"{file.stem:12s} {backend:9s} {row['verdict']}", flush=True)
                continue
            factor = row["seconds"] / max(row["alone"], np.finfo(float).tiny)
            own = "found" if row["found"] else "not found"
            print(
                f"{file.stem:12s} {backend:9s} {row['unknowns']:6d} {row['rows']:6d} {row['ties']:6d}  alone {own:9s} "
                f"{row['alone']:7.3f}  {row['verdict']:13s} {row['seconds']:7.3f}  {factor:5.1f}",
                flush=True,
            )
            if row["found"] and row["alone"] >= NOTABLE:
                factors.append(factor)
        if factors:
            print(
                f"{backend}: {len(factors)} problems of {NOTABLE:g} s and more, {np.median(factors):.1f} times its own "
                f"time in the median, {max(factors):.1f} at most, {sum(f <= MOST for f in factors)} within {MOST:g}"
            )
    return 0


def _own(value: Any) -> Any:
    """A copy that a backend may write to, sparse matrices by columns."""
    if value is None:
        return None
    return sp.csc_matrix(value, copy=True) if np.ndim(value) == 2 or sp.issparse(value) else np.array(value)


def _in_process(work: Callable[..., dict[str, Any]], arguments: tuple[Any, ...], pipe: Any) -> None:
    pipe.send(json.dumps(work(*arguments)))


def apart(work: Callable[..., dict[str, Any]], *arguments: Any, limit: float, patience: float = 1.0) -> dict[str, Any]:
    """The outcome of a function in a process of its own, ended after so many times the limit on the clock."""
    here, there = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("spawn").Process(target=_in_process, args=(work, arguments, there))
    process.start()
    there.close()
    try:
        outcome: dict[str, Any] = (
            json.loads(here.recv()) if here.poll(patience * limit + 10) else dict(verdict="out of time")
        )
    except EOFError:
        outcome = dict(verdict="out of memory")
    process.kill()
    process.join()
    if outcome.get("seconds", 0.0) > limit:
        outcome["verdict"] = "out of time"
    return dict(seconds=limit) | outcome


def geometric_mean(rows: list[dict[str, Any]], good: tuple[str, ...], limit: float) -> float:
    """The shifted geometric mean of seconds, the limit where the verdict is not a good one."""
    seconds = [row["seconds"] if row["verdict"] in good else limit for row in rows]
    return float(np.exp(np.mean(np.log(np.array(seconds) + SHIFT))) - SHIFT)


def profile(rows: list[dict[str, Any]], fastest: list[float], good: tuple[str, ...]) -> list[int]:
    """How many are good within so many times the fastest."""
    pairs = [(row, best) for row, best in zip(rows, fastest, strict=True) if row["verdict"] in good]
    return [sum(row["seconds"] <= factor * max(best, 1e-3) for row, best in pairs) for factor in FACTORS]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--method", default="active-set")
    parser.add_argument("--limit", type=float, default=LIMIT)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--varied", type=int)
    parser.add_argument("--processor", action="store_true", help="seconds of the processor, beside other work")
    parser.add_argument("--through", nargs="+", metavar="BACKEND")
    asked = parser.parse_args(arguments)
    files = sorted(file for file in asked.folder.iterdir() if file.suffix in (".mat", ".npz", ".qps", ".mps"))
    files = [file for file in files if not asked.only or file.stem in asked.only]
    if not files:
        parser.error(f"{asked.folder}: no quadratic programs")
    print(f"# {asked.method}; {os.environ.get('OMP_NUM_THREADS', 'all')} threads; limit {asked.limit:g} s")
    if asked.through:
        return all_through(files, asked.through, asked.limit)
    if asked.varied:
        return variants(files, asked.method, asked.varied, asked.limit)
    ours: list[dict[str, Any]] = []
    others: dict[str, list[dict[str, Any]]] = {name: [] for name in BESIDE}
    ended = dict(limit=asked.limit, patience=PATIENCE if asked.processor else 1.0)
    for file in files:
        row = apart(solved, str(file), asked.method, None, asked.processor, **ended)
        ours.append(row)
        for name, rows in others.items():
            rows.append(apart(as_it_is, str(file), name, asked.processor, **ended))
        width = f"{row['width']:.0e}" if row.get("width") is not None else "-"
        beside = "  ".join(f"{name} {rows[-1]['verdict']} {rows[-1]['seconds']:.2f}" for name, rows in others.items())
        counts = f"{row.get('unknowns', 0):6d} {row.get('rows', 0):6d} {row.get('ties', 0):6d}"
        said = f"{row['verdict']:13s} {row.get('determined', ''):12s} {width:6s} {row['seconds']:7.2f}"
        print(f"{file.stem:12s} {counts}  {said}  {beside}  {row.get('why', '')[:90]}", flush=True)
    _summary(ours, others, asked.limit)
    return 0


def variants(files: list[Path], method: str, count: int, limit: float) -> int:
    """Variants of the small problems in turn; a row for each that is not proven."""
    known = {file: apart(solved, str(file), method, limit=limit) for file in files}
    small = [file for file, row in known.items() if 0 < row.get("unknowns", 0) <= SMALL and row["verdict"] in PASSED]
    verdicts: list[str] = []
    different = 0
    for seed in range(count):
        file = small[seed % len(small)]
        row = apart(solved, str(file), method, seed, limit=limit)
        verdicts.append(row["verdict"])
        if row["verdict"] in PASSED and far(row["energy"], known[file]["energy"]):
            different += 1
            print(f"{seed:4d} {file.stem:12s} energy {row['energy']:.9g}, as it came {known[file]['energy']:.9g}")
        if row["verdict"] != "proven":
            print(
                f"{seed:4d} {file.stem:12s} {row['verdict']:13s} {row['seconds']:7.2f}  {row.get('why', '')[:100]}",
                flush=True,
            )
    passed, proven = (sum(verdict in good for verdict in verdicts) for good in (PASSED, ("proven",)))
    print(f"\n{count} variants of {len(small)} problems: passed {passed}, proven {proven}, different {different}")
    return int(different > 0)


def far(energy: float, other: float) -> bool:
    """Whether two energies are not the same."""
    return abs(energy - other) > DIFFERENT * max(abs(energy), abs(other), DIFFERENT)


def _summary(ours: list[dict[str, Any]], others: dict[str, list[dict[str, Any]]], limit: float) -> None:
    passed, good = PASSED, ("found",)
    enclosed = [row["width"] for row in ours if row["verdict"] in passed and row["width"] is not None]
    narrow = sum(width <= TOLERANCE for width in enclosed)
    print(f"\npassed {sum(row['verdict'] in passed for row in ours)} of {len(ours)}, ", end="")
    print(
        f"proven {sum(row['verdict'] == 'proven' for row in ours)}, energy enclosed to {TOLERANCE:g} {narrow}", end=""
    )
    found = zip(ours, *others.values(), strict=True)
    judged = [
        three for three in found if three[0]["verdict"] in passed and all(row["verdict"] in good for row in three[1:])
    ]
    print(f", different {sum(all(far(one['energy'], row['energy']) for row in rest) for one, *rest in judged)}")
    means = {"contactqp": geometric_mean(ours, passed, limit)}
    means |= {name: geometric_mean(rows, good, limit) for name, rows in others.items()}
    for name, mean in means.items():
        print(f"  {name:10s} shifted geometric mean {mean:.3f} s, {mean / means['piqp']:.2f} of PIQP's")
    every = [(ours, passed), *((rows, good) for rows in others.values())]
    fastest = [min(rows[i]["seconds"] for rows, _ in every) for i in range(len(ours))]
    print(f"  within {', '.join(map(str, FACTORS))} times the fastest:")
    for name, (rows, verdicts) in zip(means, every, strict=True):
        print(f"  {name:10s} {profile(rows, fastest, verdicts)}")


if __name__ == "__main__":
    sys.exit(main())
