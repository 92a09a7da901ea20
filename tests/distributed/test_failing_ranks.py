"""A rank that fails ends the run: no hang, one line, an exit code, and no file that is half written."""

from __future__ import annotations

import json

import pytest

from contactqp.cli.output import explained
from tests.distributed.cases import path_case
from tests.distributed.conftest import SCRIPTS

FAILING = SCRIPTS / "failing.py"
# What --json says of each failure.
CODES = {
    "no_file": "invalid-scene",
    "refused": "no-equilibrium",
    "memory": "engine",
    "bug": "bug",
    "petsc_error": "engine",
}


def run(python_on_ranks, tmp_path, kind, rank=1, *more):
    case = path_case(tmp_path)
    before = sorted(tmp_path.iterdir())
    plot = ["--plot", tmp_path / "p.png", "--vtu", tmp_path / "v.vtu"] if kind != "no_file" else []
    done = python_on_ranks(2, FAILING, kind, rank, "run", case.name, "--engine", "petsc", "--json", *plot, *more)
    assert sorted(tmp_path.iterdir()) == before
    if kind == "killed":
        assert done.out == ""
        return done
    data = json.loads(done.out)
    assert (data["code"], data["exit"]) == (CODES[kind], done.code)
    assert data["error"].removeprefix("rank 1: ") in done.err
    return done


@pytest.mark.sampled(4)
@pytest.mark.parametrize(
    ("kind", "code", "said", "traced"),
    [
        ("no_file", 2, "path.toml: expected a case file, and there is none of that name", False),
        ("refused", 1, "path.toml: active-set engine=petsc: this rank alone sees no equilibrium", False),
        ("memory", 1, "out of memory: Unable to allocate 256. MiB", False),
        ("bug", 1, "KeyError: 'nothing'", True),
    ],
)
def test_one_rank_fails(python_on_ranks, tmp_path, kind, code, said, traced):
    done = run(python_on_ranks, tmp_path, kind)
    assert done.code == code
    (line,) = done.said
    assert line.startswith(f"contactqp: rank 1: {said}")
    assert ("Traceback" in done.err) is traced


@pytest.mark.slow
def test_the_first_rank_fails(python_on_ranks, tmp_path):
    done = run(python_on_ranks, tmp_path, "petsc_error", 0)
    assert done.code == 1
    assert done.said == ["contactqp: rank 0: PETSc: Unknown Mat type given: no such type"]


@pytest.mark.slow
def test_a_rank_is_killed(python_on_ranks, tmp_path):
    done = run(python_on_ranks, tmp_path, "killed")
    assert done.code == 137
    assert "rank 1" in done.err
    assert "signal 9 (Killed)" in done.err
    assert "Traceback" not in done.err


def test_petscs_errors_are_one_line():
    text = "error code 86\n[1] MatSetType() at matreg.c:146\n[1] Unknown type.\n[1] Unknown Mat type given: nonono"
    assert explained(_petscs(text, 86)) == "PETSc: Unknown Mat type given: nonono"
    text = "error code 34\n[0] VecCreate_Seq() at bvec3.c:34\n[0] PetscMallocA() at mal.c:410\n[0] VecCreate_Seq"
    assert explained(_petscs(text, 34)) == "out of memory: PETSc, VecCreate_Seq"
    assert explained(_petscs("error code 55", 55)) == "out of memory: PETSc, error code 55"


def _petscs(text: str, code: int) -> Exception:
    error = type("Error", (RuntimeError,), {"__module__": "petsc4py.PETSc"})(text)
    error.ierr = code
    return error
