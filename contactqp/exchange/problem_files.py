"""A problem from a file or a folder, whatever its format: by what is in it, not by its name."""

from __future__ import annotations

import importlib
import os
from pathlib import Path as FilePath

from contactqp.errors import InvalidProblem, counted, counts
from contactqp.exchange.fclib import SIGNATURE, SIGNATURE_PLACES, is_hdf5, read_fclib
from contactqp.exchange.files import Ledger, Path, read_bytes, wrong
from contactqp.exchange.matrix_files import stiffness_suffixes
from contactqp.exchange.numpy_files import ZIP
from contactqp.exchange.problem_folder import is_problem_folder, read_problem_archive, read_problem_folder
from contactqp.exchange.problem_writing import PROBLEM_FILE
from contactqp.exchange.quadratic_programs import MATLAB, QPS, is_quadratic_program, read_quadratic_program
from contactqp.exchange.siconos import read_siconos
from contactqp.model.arguments import checked
from contactqp.model.global_problem import GlobalProblem
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem

EXPECTED = (
    "a folder or .npz of matrices, a file of FCLIB (HDF5) or Siconos (text), a quadratic program, or a deck (.inp)"
)
HEAD = max(SIGNATURE_PLACES) + len(SIGNATURE)
HDF5, TEXT, ARCHIVE, DECK = (".hdf5", ".h5"), (".dat",), (".npz",), (".inp",)
# Decks become bodies before they are problems: what reads them lies above this room, and is found by its name.
DECK_READER = "contactqp.scene.deck.deck:read_deck_problem"


@checked
def read_problem(path: Path, *, as_stored: bool = False) -> ContactProblem | LocalProblem | GlobalProblem:
    """Return the problem in a folder or .npz of matrices, a quadratic program, a deck, or a file of FCLIB or Siconos.

    Parameters, and what is returned and raised, as `read_fclib`; matrices and decks make a ContactProblem.
    """
    return read_problem_with_ledger(path, as_stored=as_stored)[0]


def read_problem_with_ledger(
    path: Path, *, as_stored: bool = False
) -> tuple[ContactProblem | LocalProblem | GlobalProblem, Ledger]:
    """Return the problem as `read_problem` does, and the ledger of what was read, converted, assumed and ignored."""
    if is_quadratic_program(path):
        return read_quadratic_program(path)
    if is_deck(path):
        module, _, function = DECK_READER.partition(":")
        found: tuple[ContactProblem, Ledger] = getattr(importlib.import_module(module), function)(path)
        return found
    if is_of_matrices(path):
        folder = _folder(path)
        if folder.is_dir() and not is_problem_folder(folder):
            raise InvalidProblem(f"{path}: expected {EXPECTED}, got a folder without problem.json or stiffness")
        return read_problem_folder(folder) if folder.is_dir() else read_problem_archive(path)
    if FilePath(path).suffix.lower() == ".toml":
        raise wrong(path, "content", "a problem", "a case file: contactqp.run solves it, contactqp.load_scene reads it")
    if FilePath(path).suffix.lower() in stiffness_suffixes():
        raise wrong(path, "content", "a folder of this stiffness, a load, and contacts", "the stiffness alone")
    hdf5 = is_hdf5(read_bytes(path, EXPECTED, HEAD)) or FilePath(path).suffix.lower() in HDF5
    problem = read_fclib(path, as_stored=as_stored) if hdf5 else read_siconos(path, as_stored=as_stored)
    return problem, _ledger(path, problem, "FCLIB" if hdf5 else "Siconos")


def is_deck(path: Path) -> bool:
    """Return whether a file is an input deck of Abaqus or CalculiX, by its suffix."""
    return FilePath(path).suffix.lower() in DECK


def is_of_matrices(path: Path) -> bool:
    """Return whether this is a folder (or the problem.json in it) or an archive of matrices, or a deck."""
    file = FilePath(path)
    if os.path.isdir(file):
        return True
    if os.path.isfile(file) and is_quadratic_program(path):
        return True
    if file.name == PROBLEM_FILE or file.suffix.lower() in (*ARCHIVE, *DECK):
        return True
    return os.path.isfile(file) and read_bytes(path, EXPECTED, len(ZIP)) == ZIP


def is_problem_file(path: Path) -> bool:
    """Return whether `read_problem` is the one to ask, by content or by a suffix that says so; otherwise it is a
    case file.

    A folder is one if it holds a problem.json or a stiffness.
    """
    file = FilePath(path)
    suffix = file.suffix.lower()
    if file.is_dir():
        return is_problem_folder(file)
    if suffix == ".toml":
        return False
    if (
        suffix in (*HDF5, *TEXT, *QPS, *MATLAB, *DECK)
        or file.name == PROBLEM_FILE
        or suffix in (*ARCHIVE, *stiffness_suffixes())
    ):
        return True
    if not file.is_file():
        return False
    head = read_bytes(path, EXPECTED, HEAD)
    first = head.split(maxsplit=1)[:1]
    return is_hdf5(head) or head.startswith(ZIP) or bool(first and first[0].isdigit())


def _folder(path: Path) -> FilePath:
    file = FilePath(path)
    return file.parent if file.name == PROBLEM_FILE else file


def _ledger(path: Path, problem: ContactProblem | LocalProblem | GlobalProblem, code: str) -> Ledger:
    ledger = Ledger(str(path))
    if isinstance(problem, LocalProblem):
        ledger.read.append(f"{code}, local form: {counted('contact', problem.contacts)} in {problem.dimension}D")
    elif isinstance(problem, GlobalProblem):
        ledger.read.append(f"{code}, global form: {counts(unknown=len(problem.load), contact=len(problem.friction))}")
    else:
        ledger.read.append(f"{code}, global form: {counts(unknown=problem.dimension, contact=problem.contacts)}")
        ledger.converted.append("E_N = -H_N', g = w_N, E_T = H_T', slip_origin = -w_T, ties G' u = -b")
    if problem.asymmetry > 0:
        became = "symmetrised" if isinstance(problem, ContactProblem) else "it stays as it is"
        ledger.converted.append(f"asymmetric by {problem.asymmetry:.1g}: {became}")
    if isinstance(problem, ContactProblem):
        ledger.note_rigid_change(problem.rigid_change)
    return ledger
