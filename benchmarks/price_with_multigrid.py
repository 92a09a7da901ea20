"""What a certified contact solution costs without a factorisation, in units of one linear solve of the same body.

    python -m benchmarks.price_with_multigrid                          # 104 544 and 345 744 unknowns
    python -m benchmarks.price_with_multigrid --cells 69 --repeats 1   # a million
    python -m benchmarks.price_with_multigrid --cells 20 32 --factorise --pyamg

A cube of hexahedra is pressed on a paraboloid, contact on one whole face. One process; the linear solve (hierarchy and
conjugate gradients until |r| <= 1e-8 |f|, the hierarchy that contact uses) and `cq.solve` with its certificate take
turns, each on a fresh problem; medians of the ratios to the linear solve beside them. Assembly is left out. `--pyamg`
adds pyamg's own smoothed aggregation with rigid-body motions and a symmetric block Gauss-Seidel smoother, `--factorise`
adds `cq.solve` by PARDISO or SuperLU.
"""

from __future__ import annotations

import argparse
import os
import resource
import warnings
from collections.abc import Iterator

import numpy as np

import contactqp as cq
from benchmarks.price_of_contact import fresh, timed
from contactqp.elements.material import Material
from contactqp.elements.shapes import box
from contactqp.elements.solid import Body
from contactqp.elements.structure import Structure, Support
from contactqp.linalg.iteration import Iteration
from contactqp.linalg.pardiso import SOLVER_VARIABLE

LINEAR = 1e-8


def cube(cells: int) -> cq.ContactProblem:
    """The unit cube of cells^3 hexahedra, its top moved down onto a paraboloid beneath."""
    body = Body(box((1.0, 1.0, 1.0), (cells, cells, cells)), Material(1.0, 0.3), "3d", name="block")
    structure = Structure([body])
    held = [Support("block", "top", axis, -0.02 if axis == 2 else 0.0) for axis in range(3)]
    paraboloid = cq.Paraboloid([0.5, 0.5, 0.0], [0.0, 0.0, 1.0], 5.0)
    return structure.assemble(held).problem([cq.pair(structure.surface("block", "bottom"), paraboloid)])


def linear_solve(problem: cq.ContactProblem) -> int:
    """Steps of conjugate gradients for K u = f, the hierarchy made anew."""
    without = problem.replace(normal=np.zeros((0, problem.dimension)), gap=[], contact_names=[])
    run = Iteration(without).run_without_rows(problem.load.copy())
    goal = LINEAR * np.linalg.norm(problem.load)
    while np.linalg.norm(run.residual) > goal and run.step():
        pass
    return run.steps


def by_pyamg(problem: cq.ContactProblem) -> int:
    """The same by pyamg alone."""
    import pyamg

    residuals: list[float] = []
    smoother = ("block_gauss_seidel", {"sweep": "symmetric"})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        hierarchy = pyamg.smoothed_aggregation_solver(
            problem.stiffness_rows.tobsr((3, 3)),
            B=problem.near_null_space,
            strength=("symmetric", {"theta": 0.0}),
            presmoother=smoother,
            postsmoother=smoother,
            improve_candidates=None,
        )
        hierarchy.solve(problem.load, tol=LINEAR, accel="cg", residuals=residuals)
    return len(residuals) - 1


def table(sizes: list[int], repeats: int, with_pyamg: bool, factorise: bool) -> Iterator[str]:
    """One line for each size and each way."""
    yield f"{'unknowns':>10s}{'contacts':>10s}  {'way':28s}{'seconds':>9s}{'ratio':>8s}"
    for cells in sizes:
        problem = cube(cells)
        head = f"{problem.dimension:>10d}{problem.contacts:>10d}  "
        linear, contact, ratio = [], [], []
        for _ in range(repeats):
            alone, steps = timed(lambda problem=problem: linear_solve(problem))
            twin = fresh(problem)
            both, solution = timed(lambda twin=twin: cq.solve(twin))
            linear.append(alone), contact.append(both), ratio.append(both / alone)
        work, certificate = solution.work, solution.certificate
        yield f"{head}{f'linear solve, {steps} steps':28s}{np.median(linear):>9.2f}{1.0:>8.2f}"
        yield (
            f"{head}{f'cq.solve, {work.krylov_iterations} steps':28s}{np.median(contact):>9.2f}{np.median(ratio):>8.2f}"
            f"  {'passed' if certificate.passed else 'REFUSED'}, {work.iterations} sets, equilibrium "
            f"{certificate.equilibrium:.1e}, energy error {certificate.energy_error:.1e}, force error "
            f"{certificate.force_error:.1e}, certificate {solution.certify_seconds:.2f} s, {_peak()}"
        )
        del solution, twin
        if with_pyamg:
            seconds, steps = timed(lambda problem=problem: by_pyamg(fresh(problem)))
            yield f"{head}{f'pyamg alone, {steps} steps':28s}{seconds:>9.2f}{seconds / np.median(linear):>8.2f}"
        if factorise:
            yield head + _factorised(problem, float(np.median(linear)))


def _factorised(problem: cq.ContactProblem, linear: float) -> str:
    chosen = os.environ.pop(SOLVER_VARIABLE)
    os.environ[SOLVER_VARIABLE] = "pardiso"
    seconds, solution = timed(lambda: cq.solve(fresh(problem)))
    os.environ[SOLVER_VARIABLE] = chosen
    way = f"cq.solve by {solution.work.solver}"
    return f"{way:28s}{seconds:>9.2f}{seconds / linear:>8.2f}  {_peak()}"


def _peak() -> str:
    return f"peak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB so far"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="*", default=[32, 48], help="hexahedra along an edge")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--pyamg", action="store_true", help="also the linear solve by pyamg's own solver")
    parser.add_argument("--factorise", action="store_true", help="also cq.solve by PARDISO")
    chosen = parser.parse_args(arguments)
    os.environ[SOLVER_VARIABLE] = "pyamg"
    print(f"{os.cpu_count()} cores")
    for line in table(chosen.cells, chosen.repeats, chosen.pyamg, chosen.factorise):
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
