"""A membrane over an obstacle that every node may touch: seconds of a certified answer, in linear solves.

    python -m benchmarks.membranes                              # 1 600 to 160 000 nodes
    python -m benchmarks.membranes --sides 40 100 --method clarabel

A square grid under a pressure that pushes it against a plate at three heights, so that 2, a quarter and three quarters
of the nodes are in contact. Each is a fresh problem, solved once by `cq.solve` with its certificate, after a small one
that loads what is needed; a linear solve is one Cholesky factorisation of K by PARDISO, or SuperLU where that is not
installed, and one back-substitution. Threads are those of the environment, which the first line states.
"""

from __future__ import annotations

import argparse
import os
import resource
import time

import numpy as np
import scipy.sparse as sp

import contactqp as cq
from contactqp.linalg import pardiso
from contactqp.linalg.factorization import factorise

HEIGHTS = (0.068, 0.03, 0.0025)
SIDES = (40, 70, 100, 200, 400)


def membrane(side: int, height: float) -> cq.ContactProblem:
    """A membrane of side * side nodes under a unit pressure, a plate at a height over all of them."""
    h = 1.0 / (side + 1)
    chain = sp.diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(side, side))
    one, nodes = sp.identity(side), side * side
    K = sp.csr_matrix(sp.kron(one, chain) + sp.kron(chain, one))
    return cq.ContactProblem(K, np.full(nodes, h * h), sp.identity(nodes, format="csr"), np.full(nodes, height))


def linear_solve(problem: cq.ContactProblem) -> float:
    """Seconds of one factorisation and one back-substitution."""
    started = time.perf_counter()
    if pardiso.available():
        pardiso.Pardiso(problem.stiffness_rows, np.zeros(0, dtype=np.intp)).solve_all(problem.load)
    else:
        factorise(problem.stiffness).solve(problem.load)
    return time.perf_counter() - started


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sides", type=int, nargs="*", default=SIDES)
    parser.add_argument("--method", default="active-set")
    asked = parser.parse_args(arguments)
    print(f"# {asked.method}; {os.environ.get('OMP_NUM_THREADS', 'all')} threads")
    cq.solve(membrane(30, HEIGHTS[1]), asked.method)
    linear_solve(membrane(30, HEIGHTS[1]))
    for side in asked.sides:
        for height in HEIGHTS:
            problem = membrane(side, height)
            linear = linear_solve(problem)
            started = time.perf_counter()
            solution = cq.solve(problem, asked.method)
            seconds = time.perf_counter() - started
            closed, proven = np.mean(solution.normal_force > 0), solution.certificate.proven
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            cost = f"{seconds:7.2f} s, {seconds / linear:5.1f} linear solves"
            verdict = "proven" if proven else "not proven"
            more = f"{solution.work.factorisations} factorisations after the backend, {memory:.2f} GiB so far"
            print(f"{side * side:7d} nodes, {closed:4.0%} closed: {cost}, {verdict}, {more}", flush=True)


if __name__ == "__main__":
    main()
