"""Load PETSc and MPI, which are optional, set PETSc's options, make its matrices, and free the memory that it keeps."""

from __future__ import annotations

import ctypes
import glob
import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendMissing
from contactqp.model.arrays import Vector

RECIPE = (
    "apt-get install python3-petsc4py python3-mpi4py python3-venv && /usr/bin/python3 -m venv --system-site-packages "
    "petsc && petsc/bin/pip install 'numpy<2' '.[solids]'"
)
# Debian builds petsc4py for the Python of this prefix, and installs it beside PETSc, on no path of that Python.
_PREFIX = "/usr"
_DEBIAN = "/usr/lib/petscdir/petsc*/*-real/lib/python3/dist-packages"


@cache
def petsc() -> Any:
    """Start MPI and return the module petsc4py.PETSc.

    PETSc takes options from the variable PETSC_OPTIONS and none from the command line, which belongs to the program.
    Its errors are raised as PETSc.Error.

    Raises
    ------
    BackendMissing
        petsc4py or mpi4py is not installed, does not fit this NumPy, or was built for complex numbers.
    """
    if names := missing():
        raise BackendMissing(f"{' and '.join(names)} not installed: {RECIPE}")
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


def missing() -> list[str]:
    """Return which of petsc4py and mpi4py are not installed; neither is loaded for that."""
    # Debian's petsc4py is put on the path of the Python that it was built for, unless PETSC_DIR names another PETSc.
    if importlib.util.find_spec("petsc4py") is None and sys.base_prefix == _PREFIX and "PETSC_DIR" not in os.environ:
        sys.path += sorted(glob.glob(_DEBIAN))[-1:]
    return [name for name in ("petsc4py", "mpi4py") if importlib.util.find_spec(name) is None]


# Matrices: a product in blocks of three reads one column number for nine values and takes about half of the time, but
# PETSc's multigrids and factorisations take single rows alone.


def block_matrix(comm: Any, rows: sp.bsr_matrix) -> Any:
    """Make a PETSc.Mat of the rows of each rank over the unknowns of all ranks. Collective.

    Returns
    -------
    PETSc.Mat
        BAIJ with the blocks of `rows`, or AIJ where these are single unknowns.
    """
    PETSc = petsc()
    size = rows.blocksize[0]
    matrix = PETSc.Mat().create(comm)
    matrix.setType(block_type(size))
    matrix.setSizes(((rows.shape[0], rows.shape[1]), (rows.shape[0], rows.shape[1])), bsize=size)
    indptr, indices = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType)
    matrix.setPreallocationCSR((indptr, indices, rows.data.reshape(-1)))
    matrix.assemble()
    return matrix


def aij_copy(matrix: Any) -> Any:
    """Copy a symmetric PETSc.Mat to the format AIJ of single rows. Collective."""
    PETSc = petsc()
    copy = matrix.convert(PETSc.Mat.Type.AIJ, PETSc.Mat())
    copy.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return copy


def block_type(size: int) -> str:
    """Return PETSc's name of the matrix type that holds blocks of `size` unknowns."""
    Type = petsc().Mat.Type
    return str(Type.BAIJ if size > 1 else Type.AIJ)


class Product:
    """The product x -> A x with a square PETSc.Mat, or x -> A'x; calling it is collective."""

    def __init__(self, matrix: Any, *, transposed: bool = False) -> None:
        self._multiply = matrix.multTranspose if transposed else matrix.mult
        self._input, self._output = matrix.createVecs()

    def __call__(self, x: Vector) -> Vector:
        self._input.array[:] = x
        self._multiply(self._input, self._output)
        return np.array(self._output.array)


# The prefix of PETSc's options of preconditioners, as in PETSC_OPTIONS="-contactqp_pc_gamg_threshold 0.02".
PREFIX = "contactqp_"


@contextmanager
def temporary_options(prefix: str, defaults: dict[str, Any]) -> Iterator[None]:
    """Set PETSc's options of this prefix while the context lasts, except those that the user has set."""
    options = petsc().Options(prefix)
    added = {name: value for name, value in defaults.items() if not options.hasName(name)}
    for name, value in added.items():
        options[name] = value
    try:
        yield
    finally:
        for name in added:
            options.delValue(name)


def release_free_memory() -> None:
    """Return free memory between blocks in use to the system, which glibc itself does at the end of its heap alone.

    A stiffness lasts and is made after a mesh, which does not, so that it would add to the mesh's memory. With another
    C library nothing happens.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # CDLL(None) searches what this process has loaded
    if trim is not None:
        trim(0)


def collect_garbage(comm: Any) -> None:
    """Destroy the PETSc objects that Python has dropped on all ranks. Collective.

    PETSc itself would keep every dropped vector and scatter, and each solution makes some.
    """
    cleanup = getattr(petsc(), "garbage_cleanup", None)  # PETSc before 3.18 destroys at once
    if cleanup is not None:
        cleanup(comm)
