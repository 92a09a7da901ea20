"""Siconos on the block, condensed to its contacts, under the system's Python.

    /usr/bin/python3 -m benchmarks.crosscheck.siconos_process problem.npz answer.json LCP_LEMKE
    /usr/bin/python3 -m benchmarks.crosscheck.siconos_process problem.npz answer.json FRICTION_3D_NSGS 1e-14

Without friction a linear complementarity problem, w = W z + q: z are the forces and w the gaps. With friction the
velocities are (gap, slip) contact by contact, u = W r + q with H = (-E_N, E_T), and r is the force on the body: r_N is
our l_N and r_T is minus our l_T. A tolerance of 0 leaves Siconos's own.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import scipy.sparse.linalg as sla

from benchmarks.crosscheck.child import Given, debian_version, write_answer

MOST_ITERATIONS = 100_000


def main(problem: str, answer: str, name: str, tolerance: str = "0") -> None:
    import siconos.numerics as numerics

    given = Given.load_file(Path(problem))
    factor = sla.splu(given.stiffness.tocsc())
    options = numerics.SolverOptions(getattr(numerics, f"SICONOS_{name}"))
    if float(tolerance):
        options.dparam[numerics.SICONOS_DPARAM_TOL] = float(tolerance)
        options.iparam[numerics.SICONOS_IPARAM_MAX_ITER] = MOST_ITERATIONS
    asked = options.dparam[numerics.SICONOS_DPARAM_TOL]
    H = -given.normal if name.startswith("LCP") else _frames(given)
    W = H @ factor.solve(np.ascontiguousarray(H.T))
    q = H @ factor.solve(given.load)
    m = len(given.gap)
    if name.startswith("LCP"):
        force, gap = np.zeros(m), np.zeros(m)
        failed = numerics.linearComplementarity_driver(numerics.LCP(W, q + given.gap), force, gap, options)
        parts = {"normal_force": force}
    else:
        q[::3] += given.gap
        force, velocity = np.zeros(3 * m), np.zeros(3 * m)
        theirs = numerics.FrictionContactProblem(3, m, W, q, given.friction)
        failed = numerics.fc3d_driver(theirs, force, velocity, options)
        parts = {"normal_force": force[::3], "friction_force": -force.reshape(m, 3)[:, 1:]}
    parts["displacement"] = factor.solve(given.load + H.T @ force)
    said = f"{'failed' if failed else 'solved'}, info {failed}, tolerance {asked:.0e}"
    write_answer(Path(answer), said, f"Siconos {debian_version('python3-siconos')}", **parts)


def _frames(given: Given) -> np.ndarray:
    """(3m, n) H: the rows (-E_N, E_T1, E_T2) of each contact."""
    m, n = given.normal.shape
    rows = np.concatenate([-given.normal[:, None], given.tangent.reshape(m, 2, n)], axis=1)
    return rows.reshape(3 * m, n)


if __name__ == "__main__":
    main(*sys.argv[1:])
