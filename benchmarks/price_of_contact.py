"""What a certified contact solution costs, in units of one linear solve of the same body without contact.

    python -m benchmarks.price_of_contact                        # PARDISO if installed
    python -m benchmarks.price_of_contact --solver superlu --two 30000 --three
    python -m benchmarks.price_of_contact --raw osqp clarabel piqp proxqp highs --two 8000 --three 8000

A block (plane strain quadrilaterals, or hexahedra) is pressed on a paraboloid, contact on one whole face. One process;
linear solve, `cq.solve` with its certificate and raw backends take turns, each on a fresh problem, medians of the
ratios to the linear solve beside them. Assembly is left out. A raw backend is handed the whole problem at 1e-6, 1e-9
and 1e-12 in turn, and the first answer that the certificate passes is timed; PETSc's solvers of bound-constrained
problems run where petsc4py is installed (`petsc_solvers.py` says how).
"""

from __future__ import annotations

import argparse
import gc
import importlib.util
import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import contactqp as cq
from benchmarks import petsc_solvers
from contactqp.elements.material import Material
from contactqp.elements.shapes import box, rectangle
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg.condensation import condense
from contactqp.linalg.factorization import SuperLU
from contactqp.linalg.pardiso import Pardiso
from contactqp.solving.methods import Settings, find

TOLERANCES = (1e-6, 1e-9, 1e-12)
PATIENCE = 30.0  # seconds for one run of a raw backend


def block(unknowns: int, dimension: int, more_layers: int = 0) -> cq.ContactProblem:
    """A block of about that many unknowns, its top moved down onto a paraboloid beneath; in space of more layers."""
    steel = Material(1.0, 0.3)
    if dimension == 2:
        cells = round(np.sqrt(unknowns / 4))
        body = Body(rectangle(1.0, 0.5, (2 * cells, cells)), steel, "plane-strain", name="block")
        paraboloid = cq.Paraboloid([0.5, 0.0], [0.0, 1.0], 5.0)
    else:
        cells = round((unknowns / 3 / 0.7) ** (1 / 3))
        body = Body(box((1.0, 1.0, 0.7), (cells, cells, round(0.7 * cells) + more_layers)), steel, "3d", name="block")
        paraboloid = cq.Paraboloid([0.5, 0.5, 0.0], [0.0, 0.0, 1.0], 5.0)
    structure = Structure([body])
    vertical = dimension - 1
    held = [Support("block", "top", axis, -0.02 if axis == vertical else 0.0) for axis in range(dimension)]
    return structure.assemble(held).problem([cq.pair(structure.surface("block", "bottom"), paraboloid)])


def fresh(problem: cq.ContactProblem) -> cq.ContactProblem:
    """The same numbers with nothing computed from them."""
    return problem.replace(stiffness=problem.stiffness)


def linear_solve(problem: cq.ContactProblem, solver: str) -> np.ndarray:
    """K^-1 f by the sparse solver that contact uses too."""
    if solver == "pardiso":
        return Pardiso(problem.stiffness, np.zeros(0, dtype=np.intp)).solve_all(problem.load)
    return SuperLU(problem.stiffness).solve(problem.load)


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    gc.collect()
    started = time.perf_counter()
    result = work()
    return time.perf_counter() - started, result


def price(problem: cq.ContactProblem, solver: str, repeats: int) -> dict[str, Any]:
    """The medians of `repeats` rounds after one to warm up."""
    linear, contact, ratio = [], [], []
    solution = None
    for round_ in range(repeats + 1):
        alone, _ = timed(lambda: linear_solve(problem, solver))
        solution = None  # its factors go before the next are made
        twin = fresh(problem)
        both, solution = timed(lambda twin=twin: cq.solve(twin))
        if round_:
            linear.append(alone), contact.append(both), ratio.append(both / alone)
    assert solution is not None
    return dict(
        linear=np.median(linear),
        contact=np.median(contact),
        ratio=np.median(ratio),
        certify=solution.certify_seconds,
        solution=solution,
    )


def raw(problem: cq.ContactProblem, name: str) -> tuple[float, float, cq.Certificate] | str:
    """Seconds, tolerance and certificate of the first raw answer that passes; why not, if none does."""
    said = "no answer passes"
    for tolerance in TOLERANCES:
        method = find(name)
        settings = Settings(tolerance, time_limit=None if "no time limit" in method.note else PATIENCE)
        try:
            seconds, candidate = timed(lambda method=method, settings=settings: method.solve(problem, settings))
        except cq.ContactQPError as error:
            said = str(error).splitlines()[0][:60]
            continue
        u, force = candidate.displacement, candidate.normal_force
        certificate = cq.certify(problem, u, force, factorization=condense(problem))
        if certificate.passed:
            return seconds, tolerance, certificate
        said = f"refused at {tolerance:g}: {certificate.failures[0].split(':')[0]}, {seconds:.1f} s"
        if seconds > PATIENCE:
            break
    return said


def table(sizes: dict[int, list[int]], solver: str, repeats: int, backends: list[str]) -> Iterator[str]:
    """One line for each size and each way."""
    yield (
        f"{'':4s}{'unknowns':>10s}{'contacts':>10s}  {'way':26s}{'seconds':>9s}{'ratio':>8s}"
        f"{'u error':>10s}{'force error':>13s}  verdict"
    )
    for dimension, wanted in sizes.items():
        for unknowns in wanted:
            problem = block(unknowns, dimension)
            head = f"{dimension}D  {problem.dimension:>10d}{problem.contacts:>10d}  "
            found = price(problem, solver, repeats)
            solution, linear = found["solution"], found["linear"]
            yield f"{head}{'one linear solve':26s}{linear:>9.3f}{1.0:>8.2f}"
            yield head + _line("cq.solve, certified", found["contact"], found["ratio"], solution.certificate)
            work = solution.work
            yield (
                f"{head}  certificate {found['certify']:.3f} s, {work.factorisations} factorisation, "
                f"{work.back_substitutions} back-substitutions, {work.iterations} iterations, "
                f"peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB so far"
            )
            for name in backends:
                outcome = raw(problem, name)
                if isinstance(outcome, str):
                    yield f"{head}{name + ' raw':26s}{'':17s}{'':23s}  {outcome}"
                else:
                    seconds, tolerance, certificate = outcome
                    yield head + _line(f"{name} raw, {tolerance:g}", seconds, seconds / linear, certificate)
            for name, way in petsc_solvers.ways().items() if petsc_solvers.available() else ():
                seconds, u = way(problem)
                push = np.maximum(problem.normal @ (problem.load - problem.stiffness @ u), 0.0)
                certificate = cq.certify(problem, u, push, factorization=condense(problem))
                yield head + _line(name, seconds, seconds / linear, certificate)


def _line(way: str, seconds: float, ratio: float, certificate: cq.Certificate) -> str:
    energy, force = (np.nan if e is None else e for e in (certificate.energy_error, certificate.force_error))
    verdict = "passed" if certificate.passed else "REFUSED"
    return f"{way:26s}{seconds:>9.3f}{ratio:>8.2f}{energy:>10.1e}{force:>13.1e}  {verdict}"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--two", type=int, nargs="*", default=[30_000, 100_000, 300_000], help="unknowns in 2D")
    parser.add_argument("--three", type=int, nargs="*", default=[14_000, 40_000, 105_000], help="unknowns in 3D")
    parser.add_argument("--solver", choices=("pardiso", "superlu"), help="by default the fastest installed")
    parser.add_argument("--raw", nargs="*", default=[], metavar="BACKEND", help="backends to hand the problem to")
    parser.add_argument("--repeats", type=int, default=5)
    chosen = parser.parse_args(arguments)
    solver = chosen.solver or ("pardiso" if importlib.util.find_spec("pypardiso") else "superlu")
    os.environ["CONTACTQP_SPARSE_SOLVER"] = solver
    print(f"sparse solver: {solver}; {os.cpu_count()} cores")
    if not petsc_solvers.available():
        print("petsc4py is not installed (petsc_solvers.py says how): PETSc is left out", file=sys.stderr)
    for line in table({2: chosen.two, 3: chosen.three}, solver, chosen.repeats, chosen.raw):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
