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
# Debian builds petsc4py for the Python of this prefix, and keeps it beside PETSc, on no path of that Python's.
_PREFIX = "/usr"
_DEBIAN = "/usr/lib/petscdir/petsc*/*-real/lib/python3/dist-packages"


def available() -> bool:
    """Whether petsc4py and mpi4py can be had; nothing is loaded to find out."""
    return not _missing()


@cache
def petsc() -> Any:
    """The module petsc4py.PETSc, with MPI started.

    PETSc takes options from the variable PETSC_OPTIONS and none from the command line, which is the program's own; what
    it finds wrong is raised as PETSc.Error.

    Raises
    ------
    BackendMissing
        petsc4py or mpi4py is not installed, does not fit this NumPy, or has complex numbers.
    """
    if missing := _missing():
        raise BackendMissing(f"{' and '.join(missing)} not installed: {RECIPE}")
    try:
        importlib.import_module("mpi4py.MPI")  # starts MPI, and ends it with the process
        importlib.import_module("petsc4py").init([])
        PETSc = importlib.import_module("petsc4py.PETSc")
    except (ImportError, ValueError) as error:  # ValueError: it was built for the arrays of another NumPy
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise BackendMissing(f"petsc4py cannot be loaded ({reason}): {RECIPE}") from error
    if PETSc.ScalarType().dtype.kind != "f":
        raise BackendMissing(f"petsc4py was built for complex numbers; expected a build for real ones: {RECIPE}")
    PETSc.Sys.pushErrorHandler("python")
    return PETSc


def _missing() -> list[str]:
    _find()
    return [name for name in ("petsc4py", "mpi4py") if importlib.util.find_spec(name) is None]


def _find() -> None:
    """Put Debian's petsc4py on the path of the Python that it was built for, unless PETSC_DIR names another PETSc."""
    if importlib.util.find_spec("petsc4py") is None and sys.base_prefix == _PREFIX and "PETSC_DIR" not in os.environ:
        sys.path += sorted(glob.glob(_DEBIAN))[-1:]
