"""The flag: what it takes, and that nothing changes without it."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import contactqp as cq
from contactqp.cli import main
from contactqp.distributed import ranks
from tests.shipped_cases import FOLDER

BAR = FOLDER / "bar_wall.toml"


@pytest.fixture
def _no_petsc(monkeypatch):
    ranks.petsc.cache_clear()
    monkeypatch.setattr(ranks, "missing", lambda: ["petsc4py", "mpi4py"])
    yield
    ranks.petsc.cache_clear()


@pytest.fixture
def bar() -> cq.ContactProblem:
    return cq.ContactProblem(stiffness=[[2.0]], load=[3.0], normal=[[1.0]], gap=[1.0])


def test_an_unknown_engine_is_refused_with_those_that_exist(bar):
    for ask in (lambda: cq.solve(bar, engine="trilinos"), lambda: cq.run(cq.load_scene(BAR), engine="trilinos")):
        with pytest.raises(cq.InvalidProblem, match=r"^engine: expected 'serial' or 'petsc', got 'trilinos'$"):
            ask()


@pytest.mark.usefixtures("_no_petsc")
def test_without_petsc4py_the_flag_says_how_to_install_it(bar, capsys):
    for ask in (lambda: cq.solve(bar, engine="petsc"), lambda: cq.run(cq.load_scene(BAR), engine="petsc")):
        with pytest.raises(cq.BackendMissing, match="python3-petsc4py") as caught:
            ask()
        assert "\n" not in str(caught.value)
    with pytest.raises(SystemExit) as end:
        main(["run", str(BAR), "--engine", "petsc"])
    assert end.value.code == 3
    out, err = capsys.readouterr()
    assert out == ""
    assert err == f"contactqp: petsc4py and mpi4py not installed: {ranks.RECIPE}\n"


def test_the_engine_of_one_process_is_the_default(bar):
    assert cq.solve(bar, engine="serial").normal_force == cq.solve(bar).normal_force


@pytest.mark.slow
def test_without_the_flag_nothing_of_it_is_imported():
    code = (
        "import sys, contactqp as cq; from contactqp.cli import main\n"
        "try: main(['run', sys.argv[1]])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "print([m for m in sys.modules if m.startswith(('contactqp.distributed', 'petsc4py', 'mpi4py'))])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(BAR)], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_problem_in_local_form_is_not_dealt_out():
    local = cq.LocalProblem(delassus=np.eye(2), offset=[-1.0, 0.0], friction=[0.0], dimension=2)
    with pytest.raises(cq.Unsupported, match="local form"):
        cq.solve(local, engine="petsc")


def test_steps_are_kept_by_the_engine_of_several_ranks_alone(capsys, tmp_path):
    with pytest.raises(cq.Unsupported, match="only engine='petsc' keeps"):
        cq.run(cq.load_scene(BAR), checkpoint=tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["run", str(BAR), "--checkpoint", str(tmp_path)])
    assert end.value.code == 2
    assert capsys.readouterr().err == "contactqp: --checkpoint: only --engine petsc keeps the steps of a load path\n"


def test_readme_and_guide_have_the_recipe():
    for page in ("README.md", "docs/guide/petsc.md"):
        text = (FOLDER.parent / page).read_text(encoding="utf-8")
        assert ranks.RECIPE in " ".join(text.split())
