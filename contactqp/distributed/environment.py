"""PETSc and MPI as this package uses them: the optional imports, options, matrix formats and the memory they keep."""

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

import scipy.sparse as sp

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


# How PETSc holds K: in the blocks of its nodes, for products, or row by row, for what takes nothing else.
#
# A product in blocks of three reads one number of a column for nine values and takes some half of the time.


def held_in_blocks(comm: Any, rows: sp.bsr_matrix) -> Any:
    """Rows of this rank over the unknowns of all ranks, as PETSc.Mat: BAIJ, of single unknowns AIJ. Collective."""
    PETSc = petsc()
    size = rows.blocksize[0]
    matrix = PETSc.Mat().create(comm)
    matrix.setType(block_type(size))
    matrix.setSizes(((rows.shape[0], rows.shape[1]), (rows.shape[0], rows.shape[1])), bsize=size)
    indptr, indices = rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType)
    matrix.setPreallocationCSR((indptr, indices, rows.data.reshape(-1)))
    matrix.assemble()
    return matrix


def held_in_rows(matrix: Any) -> Any:
    """A copy of a symmetric matrix as AIJ, which PETSc's multigrids and factorisations take. Collective."""
    PETSc = petsc()
    copy = matrix.convert(PETSc.Mat.Type.AIJ, PETSc.Mat())
    copy.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return copy


def block_type(size: int) -> str:
    """PETSc's name of the type that holds blocks of so many unknowns."""
    Type = petsc().Mat.Type
    return str(Type.BAIJ if size > 1 else Type.AIJ)


# Options of PETSc's, which users set with a prefix of ours.

# Of the preconditioners, as in PETSC_OPTIONS="-contactqp_pc_gamg_threshold 0.02".
PREFIX = "contactqp_"


@contextmanager
def given(prefix: str, ours: dict[str, Any]) -> Iterator[None]:
    """Options that the user has not set, for the while."""
    options = petsc().Options(prefix)
    added = {name: value for name, value in ours.items() if not options.hasName(name)}
    for name, value in added.items():
        options[name] = value
    try:
        yield
    finally:
        for name in added:
            options.delValue(name)


# Memory that is free and that the C library, or PETSc, keeps for itself.


def give_back() -> None:
    """Return to the system what is free between what is in use: glibc does so at the end of its heap alone.

    What lasts, a stiffness, is made after what does not, a mesh, and would come on top of it. Nothing happens where the
    C library is another.
    """
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


def destroy_dropped(comm: Any) -> None:
    """Destroy what of PETSc's Python has dropped on all ranks: PETSc waits to be told. Collective.

    Until then it keeps every vector and scatter that was made for a while: some of them in each solution.
    """
    cleanup = getattr(petsc(), "garbage_cleanup", None)  # PETSc before 3.18 destroys at once
    if cleanup is not None:
        cleanup(comm)


@cache
def _malloc_trim() -> Any:
    return getattr(ctypes.CDLL(None), "malloc_trim", None)  # of what this process has loaded: nothing is searched for
