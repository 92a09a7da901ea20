"""A problem of frictional contact from a file, whatever its format: by what is in it, not by its name."""

from __future__ import annotations

from pathlib import Path as FilePath

from contactqp.exchange.fclib import read_fclib
from contactqp.exchange.global_problem import GlobalProblem
from contactqp.exchange.hdf5_file import SIGNATURE, SIGNATURE_PLACES, is_hdf5
from contactqp.exchange.refusal import Path, read_bytes
from contactqp.exchange.siconos_text import read_siconos
from contactqp.local_problem import LocalProblem
from contactqp.problem import ContactProblem

EXPECTED = "a file of FCLIB (HDF5) or Siconos (text)"
HEAD = max(SIGNATURE_PLACES) + len(SIGNATURE)
SUFFIXES = (".hdf5", ".h5", ".dat")


def read_problem(path: Path, *, as_stored: bool = False) -> ContactProblem | LocalProblem | GlobalProblem:
    """The problem in a file of FCLIB or Siconos; parameters and what is returned and raised as `read_fclib`."""
    hdf5 = is_hdf5(read_bytes(path, EXPECTED, HEAD)) or FilePath(path).suffix.lower() in (".hdf5", ".h5")
    return read_fclib(path, as_stored=as_stored) if hdf5 else read_siconos(path, as_stored=as_stored)


def is_problem_file(path: Path) -> bool:
    """Whether `read_problem` is the one to ask: HDF5, text that begins with a number, or a suffix that says so."""
    file = FilePath(path)
    if file.suffix.lower() == ".toml" or file.is_dir():
        return False
    if file.suffix.lower() in SUFFIXES or not file.is_file():
        return file.suffix.lower() in SUFFIXES
    head = read_bytes(path, EXPECTED, HEAD)
    first = head.split(maxsplit=1)[:1]
    return is_hdf5(head) or bool(first and first[0].isdigit())
