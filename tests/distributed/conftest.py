"""Scripts of tests/distributed/scripts/ on several ranks: under mpiexec, by a Python that has petsc4py."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

# They are run by tests, not collected.
collect_ignore = ["scripts"]
ROOT = Path(__file__).parents[2]
SCRIPTS = Path(__file__).parent / "scripts"
# The Python with petsc4py, where the one that runs the tests has none.
PYTHON = "CONTACTQP_PETSC_PYTHON"
# Open MPI where other tests run beside it: ranks that wait leave their core to others, and are held to none.
SHARED = ("--oversubscribe", "--bind-to", "none", "--mca", "mpi_yield_when_idle", "1")
# Seconds until a run of some seconds is taken for one that hangs.
LIMIT = 120.0


@dataclass(frozen=True)
class Finished:
    """A run on several ranks that is over."""

    code: int
    out: str
    err: str

    @property
    def said(self) -> list[str]:
        """What contactqp itself said on the standard error; mpiexec adds words of its own."""
        return [line for line in self.err.splitlines() if line.startswith("contactqp: ")]


@pytest.fixture(scope="session")
def petsc_python() -> str:
    """An interpreter that has petsc4py and mpi4py; without one the test is skipped."""
    python = os.environ.get(PYTHON, sys.executable)
    if reason := _unfit(python):
        pytest.skip(f"no PETSc: {reason}; {PYTHON} names a Python that has petsc4py")
    return python


@pytest.fixture
def start_ranks(petsc_python: str, tmp_path: Path) -> Callable[..., subprocess.Popen[str]]:
    """``start_ranks(n, *arguments)``: that Python with these arguments on n ranks, in a process group of its own."""

    def start(count: int, *arguments: object) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*_launcher(count), petsc_python, *map(str, arguments)],
            cwd=tmp_path,
            env=_environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    return start


@pytest.fixture
def python_on_ranks(start_ranks: Callable[..., subprocess.Popen[str]]) -> Callable[..., Finished]:
    """``python_on_ranks(n, *arguments)``: as `start_ranks`, until it is over. A run that hangs fails the test."""

    def run(count: int, *arguments: object) -> Finished:
        return finished(start_ranks(count, *arguments))

    return run


@pytest.fixture
def commands(on_ranks: Callable[..., str]) -> Callable[..., list[tuple[int, str, str]]]:
    """``commands([...], [...])``: exit code, output and errors of each, all run by one process that has PETSc."""

    def run(*commands: Sequence[object]) -> list[tuple[int, str, str]]:
        asked = [[str(part) for part in command] for command in commands]
        return [tuple(done) for done in json.loads(on_ranks("many_commands.py", 1, json.dumps(asked)))]

    return run


@pytest.fixture
def on_ranks(python_on_ranks: Callable[..., Finished]) -> Callable[..., str]:
    """``on_ranks("script.py", n, *arguments)``: what a script prints on n ranks; one that fails fails the test."""

    def run(script: str, count: int, *arguments: object) -> str:
        done = python_on_ranks(count, SCRIPTS / script, *arguments)
        if done.code:
            pytest.fail(f"{script} on {count} ranks: exit code {done.code}\n{done.out}\n{done.err}", pytrace=False)
        return done.out

    return run


def finished(process: subprocess.Popen[str], limit: float = LIMIT) -> Finished:
    """The end of a run; after `limit` seconds its processes are killed, and the test fails with what they said."""
    try:
        out, err = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGTERM)  # mpiexec takes its ranks, in groups of their own, along
        try:
            out, err = process.communicate(timeout=10)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            out, err = process.communicate()
        pytest.fail(f"no end after {limit} s: {process.args}\n{out}\n{err}", pytrace=False)
    return Finished(process.returncode, out, err)


@cache
def _unfit(python: str) -> str:
    """Why a Python cannot run these tests; empty where it can."""
    code = "from contactqp.distributed.ranks import petsc; petsc()"
    try:
        done = subprocess.run([python, "-c", code], capture_output=True, text=True, env=_environment(), timeout=LIMIT)
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return done.stderr.strip().splitlines()[-1] if done.returncode else ""


def _launcher(count: int) -> Sequence[str]:
    if count == 1:
        return ()
    if shutil.which("mpiexec") is None:
        pytest.skip("no mpiexec: several ranks cannot be started")
    return ("mpiexec", *(SHARED if _openmpi() else ()), "-n", str(count))


@cache
def _openmpi() -> bool:
    return "Open" in subprocess.run(["mpiexec", "--version"], capture_output=True, text=True).stdout


def _environment() -> dict[str, str]:
    """One thread a rank, ranks that wait leave their core, this package, and OpenMPI's leave to run as root."""
    allowed = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, **allowed, **threads, "PYTHONPATH": path, "PYTHONWARNINGS": "error"}
