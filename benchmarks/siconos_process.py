"""Siconos on one problem, in a process of its own and of NumPy alone (`siconos_peer.py` starts it).

    /usr/bin/python3 -m benchmarks.siconos_process problem.npz answer.npz NSGS 60

Siconos stops by an error of its own, relative to the largest of |q|, |r| and |u|, which may lie far below the score's.
So it is asked for less and less, with more and more iterations, each time from the best forces so far, until the score
is reached or the time is up. What it has is written after each turn: whoever waits may end the process.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.friction_score import Arrays, score

# Scores below this are solved.
TARGET = 1e-8
# Siconos's tolerance and largest number of iterations, turn by turn.
TURNS = ((1e-9, 300), (1e-10, 3000), (1e-11, 30_000), (1e-12, 100_000), (1e-13, 300_000), (1e-14, 1_000_000))


def block_text(problem: Arrays) -> str:
    """The problem in Siconos's text format: W by blocks of contacts, the storage that its Gauss-Seidel is made for."""
    d, m = problem.dimension, len(problem.friction)
    pair = problem.rows // d * m + problem.columns // d
    stored, place = np.unique(pair, return_inverse=True)
    blocks = np.zeros((len(stored), d, d))
    np.add.at(blocks, (place, problem.columns % d, problem.rows % d), problem.values)  # columns first
    ends = np.arange(d, d * m + 1, d)
    counts = np.concatenate([[0], np.cumsum(np.bincount(stored // m, minlength=m))])
    lines = [f"{d}", f"{m}", "1", f"{d * m} {d * m}", f"{len(stored)} {m} {m}"]
    lines += [" ".join(map(str, numbers)) for numbers in (ends, ends)]
    lines.append(f"{m + 1} {len(stored)}")
    lines += [" ".join(map(str, numbers)) for numbers in (counts, stored % m)]
    for number, block in enumerate(blocks):
        lines += [f"{number}", *(repr(float(value)) for value in block.ravel())]
    lines += [repr(float(value)) for value in (*problem.offset, *problem.friction)]
    return "\n".join(lines) + "\n"


def read_into_siconos(numerics: object, problem: Arrays) -> object:
    """Siconos's own problem, by a text file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "problem.dat"
        file.write_text(block_text(problem), encoding="ascii")
        return numerics.frictionContact_new_from_filename(str(file))


def main(problem_file: str, answer_file: str, solver: str, seconds: str) -> None:
    import siconos.numerics as numerics

    problem = Arrays.load(Path(problem_file))
    theirs = read_into_siconos(numerics, problem)
    driver = numerics.fc3d_driver if problem.dimension == 3 else numerics.fc2d_driver
    number = getattr(numerics, f"SICONOS_FRICTION_{problem.dimension}D_{solver}")
    best, least, spent, wrong_claims = np.zeros(len(problem.offset)), np.inf, 0.0, 0
    for tolerance, iterations in TURNS:
        options = numerics.SolverOptions(number)
        options.dparam[numerics.SICONOS_DPARAM_TOL] = tolerance
        options.iparam[numerics.SICONOS_IPARAM_MAX_ITER] = iterations
        force, velocity = best.copy(), np.zeros(len(best))
        began = time.process_time()
        failed = driver(theirs, force, velocity, options)
        spent += time.process_time() - began
        error = score(problem, force)
        wrong_claims += int(not failed and not error <= TARGET)
        if error < least:
            best, least = force, error
        _write(Path(answer_file), force=best, seconds=spent, wrong_claims=wrong_claims)
        if least <= TARGET or spent > float(seconds):
            return


def _write(file: Path, **values: object) -> None:
    """The whole file or nothing: the process may be ended at any time."""
    beside = file.with_suffix(".part.npz")
    np.savez(beside, **values)
    os.replace(beside, file)


if __name__ == "__main__":
    main(*sys.argv[1:])
