"""petsc4py and mpi4py, where they are installed; they are never a dependency."""

from __future__ import annotations

import glob
import importlib
import importlib.util
import os
import sys
from functools import cache
from typing import Any

from contactqp.errors import BackendMissing

RECIPE = (
    "apt-get install python3-petsc4py python3-mpi4py python3-venv && /usr/bin/python3 -m venv --system-site-packages "
    "petsc && petsc/bin/pip install 'numpy<2' 'contactqp[solids]'"
)
# Debian keeps petsc4py beside PETSc, on no path of Python's.
_DEBIAN = "/usr/lib/petscdir/petsc*/*-real/lib/python3/dist-packages"


def available() -> bool:
    """Whether petsc4py and mpi4py can be had; nothing is loaded to find out."""
    _find()
    return all(importlib.util.find_spec(name) is not None for name in ("petsc4py", "mpi4py"))


@cache
def petsc() -> Any:
    """The module petsc4py.PETSc, with MPI started.

    Raises
    ------
    BackendMissing
        petsc4py or mpi4py is not installed, does not fit this NumPy, or has complex numbers.
    """
    if not available():
        raise BackendMissing(f"petsc4py and mpi4py are not installed: {RECIPE}")
    try:
        import petsc4py

        petsc4py.init([])
        PETSc = importlib.import_module("petsc4py.PETSc")
        importlib.import_module("mpi4py.MPI")
    except ImportError as error:  # NumPy 2 under a petsc4py that was built with NumPy 1, say
        raise BackendMissing(f"petsc4py cannot be loaded ({str(error).splitlines()[0]}): {RECIPE}") from error
    if PETSc.ScalarType().dtype.kind != "f":
        raise BackendMissing(f"petsc4py was built for complex numbers; expected a build for real ones: {RECIPE}")
    PETSc.Sys.pushErrorHandler("python")
    return PETSc


def _find() -> None:
    if importlib.util.find_spec("petsc4py") is None and "PETSC_DIR" not in os.environ:
        found = sorted(glob.glob(_DEBIAN))
        if (found and found[-1] not in sys.path and sys.prefix != sys.base_prefix) or _system_python():
            sys.path += found[-1:]


def _system_python() -> bool:
    return sys.base_prefix == "/usr"
