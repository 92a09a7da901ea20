"""Without petsc4py, or with one that does not fit, there is one line that says what to do."""

from __future__ import annotations

import importlib
import importlib.util
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from contactqp.distributed import ranks
from contactqp.errors import BackendMissing


@pytest.fixture(autouse=True)
def _asked_anew():
    ranks.petsc.cache_clear()
    yield
    ranks.petsc.cache_clear()


def pretend(monkeypatch, **modules):
    """Have these modules installed, each as given or raising what is given, and nothing else of PETSc."""
    names = {name.replace("_", "."): module for name, module in modules.items()}
    spec, load = importlib.util.find_spec, importlib.import_module

    def find(name, *rest):
        return SimpleNamespace() if name in names else None if name in ("petsc4py", "mpi4py") else spec(name, *rest)

    def loaded(name, *rest):
        if name not in names:
            return load(name, *rest)
        if isinstance(names[name], Exception):
            raise names[name]
        return names[name]

    monkeypatch.setattr(ranks.importlib.util, "find_spec", find)
    monkeypatch.setattr(ranks.importlib, "import_module", loaded)


def said() -> str:
    with pytest.raises(BackendMissing) as caught:
        ranks.petsc()
    assert str(caught.value).endswith(ranks.RECIPE)
    assert "\n" not in str(caught.value)
    return str(caught.value).removesuffix(ranks.RECIPE)


INIT = SimpleNamespace(init=lambda _: None)


def test_nothing_is_installed(monkeypatch):
    pretend(monkeypatch)
    assert ranks.missing() == ["petsc4py", "mpi4py"]
    assert said() == "petsc4py and mpi4py not installed: "


def test_mpi4py_alone_is_missing(monkeypatch):
    pretend(monkeypatch, petsc4py=INIT)
    assert said() == "mpi4py not installed: "


@pytest.mark.parametrize(
    "failure",
    [
        ValueError("numpy.dtype size changed, may indicate binary incompatibility. Expected 96, got 88"),
        ImportError("numpy.core.multiarray failed to import\n(and much more)"),
    ],
)
def test_petsc4py_was_built_for_another_numpy(monkeypatch, failure):
    pretend(monkeypatch, mpi4py=None, mpi4py_MPI=None, petsc4py=INIT, petsc4py_PETSc=failure)
    assert str(failure).splitlines()[0] in said()


def test_petsc_counts_in_complex_numbers(monkeypatch):
    numbers = SimpleNamespace(ScalarType=np.complex128)
    pretend(monkeypatch, mpi4py=None, mpi4py_MPI=None, petsc4py=INIT, petsc4py_PETSc=numbers)
    assert "complex numbers" in said()


def test_debians_petsc4py_is_found_on_the_python_that_it_was_built_for(monkeypatch, tmp_path):
    there = tmp_path / "petsc3.18" / "x86_64-linux-gnu-real" / "lib"
    (there / "petsc4py").mkdir(parents=True)
    (there / "petsc4py" / "__init__.py").touch()
    monkeypatch.setattr(ranks, "_DEBIAN", str(tmp_path / "petsc*" / "*-real" / "lib"))
    monkeypatch.delenv("PETSC_DIR", raising=False)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if "petsc" not in entry])
    if importlib.util.find_spec("petsc4py") is not None:
        pytest.skip("a petsc4py of its own stands on this Python's path")
    monkeypatch.setattr(sys, "base_prefix", "/opt/another")
    ranks.missing()
    assert importlib.util.find_spec("petsc4py") is None
    monkeypatch.setattr(sys, "base_prefix", "/usr")
    ranks.missing()
    found = importlib.util.find_spec("petsc4py")
    assert found is not None
    assert found.origin == str(there / "petsc4py" / "__init__.py")


def test_a_petsc_that_petsc_dir_names_is_not_mixed_with_debians(monkeypatch, tmp_path):
    monkeypatch.setattr(ranks, "_DEBIAN", str(tmp_path))
    monkeypatch.setenv("PETSC_DIR", "/opt/petsc")
    monkeypatch.setattr(sys, "base_prefix", "/usr")
    monkeypatch.setattr(sys, "path", list(sys.path))
    ranks.missing()
    assert str(tmp_path) not in sys.path


def test_nothing_is_loaded_to_find_out():
    code = (
        "import sys; from contactqp.distributed.ranks import missing; missing(); "
        "print([m for m in sys.modules if m.startswith(('petsc4py', 'mpi4py'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
