"""PETSc's SNES for variational inequalities on the block, under the system's Python.

    PETSC_DIR=/usr/lib/petscdir/petsc3.18/x86_64-linux-gnu-real /usr/bin/python3 -m \\
        benchmarks.crosscheck.petsc_process problem.npz answer.json vinewtonrsls -ksp_type preonly -pc_type lu

The contacts are lower bounds of the nodes' heights, u_y >= -g. Its forces are what is left of the equations where a
bound holds, F = K u - f >= 0: positive in compression at a lower bound.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from benchmarks.crosscheck.child import Given, write_answer

FAR = 1e20


def main(problem: str, answer: str, kind: str, *options: str) -> None:
    import petsc4py

    petsc4py.init(["crosscheck", *options])
    from petsc4py import PETSc

    given = Given.load_file(Path(problem))
    K, n = given.stiffness, len(given.load)
    A = PETSc.Mat().createAIJ(K.shape, csr=(K.indptr, K.indices, K.data))
    load, u = PETSc.Vec().createWithArray(given.load), PETSc.Vec().createSeq(n)
    snes = PETSc.SNES().create()
    snes.setType(kind)
    snes.setFunction(lambda _, x, r: (A.mult(x, r), r.axpy(-1.0, load)), u.duplicate())
    snes.setJacobian(lambda *_: None, A)
    lower = np.full(n, -FAR)
    at = np.argmin(given.normal, axis=1)  # the one entry -1 of each row
    lower[at] = -given.gap
    snes.setVariableBounds(PETSc.Vec().createWithArray(lower), PETSc.Vec().createWithArray(np.full(n, FAR)))
    snes.setFromOptions()
    snes.solve(None, u)
    reason, steps = snes.getConvergedReason(), snes.getIterationNumber()
    x = u.getArray().copy()
    said = f"{'converged' if reason > 0 else 'not converged'}, reason {reason}, {steps} steps"
    version = "PETSc " + ".".join(map(str, PETSc.Sys.getVersion()))
    write_answer(Path(answer), said, version, displacement=x, normal_force=(K @ x - given.load)[at])


if __name__ == "__main__":
    main(*sys.argv[1:])
