"""Weak and strong scaling of one contact problem on PETSc and MPI, beside the linear problem without contact.

    python -m benchmarks.scaling                                     # 1, 2, 3 and 4 ranks; some minutes
    python -m benchmarks.scaling --strong 300000 --weak 100000 --large 1000000 --repeats 3
    python -m benchmarks.scaling --tables benchmarks/scaling/measured.json     # of figures that are there already
    python -m benchmarks.scaling --page       # writes the tables of measured.json, beside this, into docs/scaling.md

It runs mpiexec with the Python that has petsc4py: CONTACTQP_PETSC_PYTHON, or else the one that runs it.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scaling.case import divisions
from benchmarks.scaling.tables import tables

ROOT = Path(__file__).parents[2]
KEPT = Path(__file__).parent / "measured.json"
PAGE = ROOT / "docs" / "scaling.md"
PYTHON = "CONTACTQP_PETSC_PYTHON"


def run(ranks: int, unknowns: int, solver: str, repeats: int, folder: Path, limit: float) -> dict[str, Any]:
    """Figures of one problem, and where its answer is kept.

    Raises
    ------
    RuntimeError
        The run ended badly, with what it said.
    """
    across = divisions(unknowns)
    figures, answer = folder / "run.json", folder / f"{across} on {ranks}.npz"
    python = os.environ.get(PYTHON, sys.executable)
    command = ["mpiexec", "--oversubscribe", "-n", str(ranks), python, "-m", "benchmarks.scaling.one_run"]
    command += ["--across", str(across), "--solver", solver, "--repeats", str(repeats)]
    command += ["--write", str(figures), "--answer", str(answer)]
    before = os.getloadavg()[0]
    done = subprocess.run(command, cwd=ROOT, env=_environment(), capture_output=True, text=True, timeout=limit)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}: {done.stdout}{done.stderr}")
    found: dict[str, Any] = json.loads(figures.read_text())
    return found | {"load_before": before, "answer": str(answer)}


def _environment() -> dict[str, str]:
    """One thread a rank; OpenMPI's leave to run as root, and its ranks not bound to cores that others use."""
    ours = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    allowed = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    return {**os.environ, **ours, **allowed, "PYTHONPATH": str(ROOT)}


def differences(runs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """How far the answers on several ranks are from that on one: the largest of each, over the largest."""
    one = {found["across"]: np.load(found["answer"]) for found in runs if found["ranks"] == 1}
    found = []
    for many in runs:
        if many["ranks"] > 1 and many["across"] in one:
            reference, answer = one[many["across"]], np.load(many["answer"])
            parts = ("displacement", "normal_force")
            off = {p: float(np.max(abs(answer[p] - reference[p])) / np.max(abs(reference[p]))) for p in parts}
            found.append({"unknowns": many["unknowns"], "ranks": many["ranks"], **off})
    return found


def measure(chosen: argparse.Namespace) -> dict[str, Any]:
    found: dict[str, Any] = {
        "date": time.strftime("%Y-%m-%d"),
        "machine": f"{os.cpu_count()} cores, {platform.machine()}",
        "strong": [],
        "weak": [],
        "large": [],
    }
    wanted = [("strong", ranks, chosen.strong) for ranks in chosen.ranks]
    wanted += [("weak", ranks, chosen.weak * ranks) for ranks in chosen.ranks if ranks != 3]
    wanted += [("large", ranks, chosen.large) for ranks in (1, 2) if chosen.large]
    with tempfile.TemporaryDirectory() as kept:
        for kind, ranks, unknowns in wanted:
            repeats = 1 if kind == "large" else chosen.repeats
            found[kind].append(run(ranks, unknowns, chosen.solver, repeats, Path(kept), chosen.limit))
            print(f"{kind}: {unknowns} unknowns on {ranks} ranks measured", file=sys.stderr, flush=True)
        found["differences"] = differences(found["strong"]) + differences(found["large"])
    for one in found["strong"] + found["weak"] + found["large"]:
        del one["answer"]
    return found


def filled(page: str, found: dict[str, Any]) -> str:
    """A page with each table between its marks, `<!-- NAME -->` and `<!-- end -->`, put in anew."""
    for name, table in tables(found).items():
        before, mark, rest = page.partition(f"<!-- {name} -->\n")
        if mark:
            page = f"{before}{mark}\n{table}\n\n<!-- end -->{rest.partition('<!-- end -->')[2]}"
    return page


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2, 3, 4])
    parser.add_argument("--strong", type=int, default=100_000, help="unknowns of all ranks together")
    parser.add_argument("--weak", type=int, default=50_000, help="unknowns of each rank")
    parser.add_argument("--large", type=int, default=0, help="unknowns of a large problem on 1 and 2 ranks")
    parser.add_argument("--solver", default="gamg", choices=("gamg", "hypre"))
    parser.add_argument("--repeats", type=int, default=3, help="rounds of contact and linear, medians are told")
    parser.add_argument("--limit", type=float, default=1800.0, help="seconds for one run")
    parser.add_argument("--write", type=Path, metavar="JSON", help="keep the figures")
    parser.add_argument(
        "--tables", type=Path, metavar="JSON", help="measure nothing, print the tables of these figures"
    )
    parser.add_argument(
        "--page", action="store_true", help="measure nothing, write measured.json's into docs/scaling.md"
    )
    chosen = parser.parse_args(arguments)
    if chosen.page:
        PAGE.write_text(filled(PAGE.read_text(), json.loads(KEPT.read_text())))
        return 0
    found = json.loads(chosen.tables.read_text()) if chosen.tables else measure(chosen)
    for name, table in tables(found).items():
        print(f"{name}\n{table}\n")
    if chosen.write:
        chosen.write.write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
