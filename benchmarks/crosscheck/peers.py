"""The peers that run under the system's Python: whether they are there, and one solve in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
from functools import cache
from pathlib import Path

import scipy.sparse as sp

from benchmarks.crosscheck.block import Block
from benchmarks.crosscheck.child import Given

PYTHON = os.environ.get("CONTACTQP_SYSTEM_PYTHON", "/usr/bin/python3")
PETSC_DIR = "/usr/lib/petscdir/petsc3.18/x86_64-linux-gnu-real"
MODULES = {"GetFEM": "getfem", "PETSc": "petsc4py", "Siconos": "siconos.numerics"}
TIME_LIMIT = 120


@cache
def available(code: str) -> bool:
    """Whether that Python has a peer, and SciPy, which none of them brings but Siconos."""
    command = [PYTHON, "-c", f"import scipy.sparse, {MODULES[code]}"]
    try:
        asked = subprocess.run(command, capture_output=True, env=environment())
    except OSError:
        return False
    return asked.returncode == 0


def save(block: Block, file: Path) -> None:
    """The block for the processes."""
    problem, K = block.problem, sp.csr_matrix(block.problem.stiffness)
    none = sp.csr_matrix((0, problem.dimension))
    tangent = none if problem.tangent is None else problem.tangent
    friction = none.toarray().ravel() if problem.friction is None else problem.friction
    mesh = dict(points=block.points, cells=block.cells, free=block.free, bottom=block.bottom)
    rows = dict(normal=problem.normal.toarray(), tangent=tangent.toarray(), friction=friction)
    data = dict(load=problem.load, gap=problem.gap, data=K.data, indices=K.indices, indptr=K.indptr)
    Given(**mesh, **rows, **data).save(file)


def run(code: str, problem: Path, answer: Path, arguments: tuple[str, ...]) -> tuple[str, str]:
    """What the code says of its answer, and its version; the answer is in the file."""
    module = f"benchmarks.crosscheck.{code.lower()}_process"
    command = [PYTHON, "-m", module, str(problem), str(answer), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT, env=environment())
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {(done.stderr.strip().splitlines() or ['no message'])[-1]}")
    said = json.loads(answer.with_suffix(".said.json").read_text())
    return said["said"], said["version"]


def environment() -> dict[str, str]:
    """The system's Python finds these modules, and none of another environment's."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "VIRTUAL_ENV")}
    root = str(Path(__file__).parent.parent.parent)
    return {"PETSC_DIR": PETSC_DIR, "OMP_NUM_THREADS": "1"} | kept | {"PYTHONPATH": root}
