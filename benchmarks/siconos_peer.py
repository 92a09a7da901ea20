"""Siconos's solvers of frictional contact (Acary and others, INRIA), for comparison; never imported into our process.

Installed beside the system's Python (Debian 12: Siconos 4.4.0):

    apt-get install python3-siconos

Another interpreter that has it is named by the environment variable CONTACTQP_SICONOS_PYTHON.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.friction_score import Arrays

PYTHON = os.environ.get("CONTACTQP_SICONOS_PYTHON", "/usr/bin/python3")
# By dimension; Gauss-Seidel first. In space: semismooth Newton (Alart and Curnier), proximal points by Newton's method,
# ADMM, Tresca's fixed point. In the plane: Lemke's pivots and conjugate projected gradients.
SOLVERS = {2: ("NSGS", "LEMKE", "CPG"), 3: ("NSGS", "NSN_AC", "PROX", "ADMM", "TFP")}
# Starting Python, reading the problem and checking it are no part of the time that is measured.
STARTING = 5.0


@dataclass(frozen=True)
class Answer:
    """The best forces (n,) of one solver, scaled; None where the process ended without any."""

    solver: str
    force: np.ndarray | None
    seconds: float  # in Siconos's driver; the limit where that was reached
    wrong_claims: int  # how often it reported success and the score was missed
    ended: str  # "", "time limit", or what the process died of


@cache
def available() -> bool:
    """Whether that Python has Siconos."""
    try:
        asked = subprocess.run([PYTHON, "-c", "import siconos.numerics"], capture_output=True, env=_environment())
    except OSError:
        return False
    return asked.returncode == 0


def solve(problem: Arrays, solver: str, time_limit: float) -> Answer:
    """One solver on one problem, ended when `time_limit` seconds have gone by."""
    with tempfile.TemporaryDirectory() as folder:
        given, got = Path(folder) / "problem.npz", Path(folder) / "answer.npz"
        problem.save(given)
        command = [PYTHON, "-m", "benchmarks.siconos_process", str(given), str(got), solver, str(time_limit)]
        ended = ""
        try:
            process = subprocess.run(
                command, capture_output=True, text=True, timeout=time_limit + STARTING, env=_environment()
            )
            if process.returncode:
                last = process.stderr.strip().splitlines()[-1:] or [f"exit code {process.returncode}"]
                ended = last[0]
        except subprocess.TimeoutExpired:
            ended = "time limit"
        if not got.exists():
            return Answer(solver, None, time_limit if ended == "time limit" else 0.0, 0, ended or "no answer")
        with np.load(got) as data:
            seconds = time_limit if ended == "time limit" else float(data["seconds"])
            return Answer(solver, data["force"], seconds, int(data["wrong_claims"]), ended)


def _environment() -> dict[str, str]:
    """The system's Python finds these modules, and none of another environment's."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "VIRTUAL_ENV")}
    return kept | {"PYTHONPATH": str(Path(__file__).parent.parent)}
