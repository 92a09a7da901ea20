"""Read a problem from a file or a folder of any format, recognised by its content.

Quadratic programs, QPS and MPS, the .mat of qpbenchmark and the .npz of `qpsolvers.Problem.save`, become a
ContactProblem as `ContactProblem.from_qp` makes it. A constant term of the energy is dropped with a note in the ledger,
as it does not change the answer.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
from collections.abc import Collection
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendMissing, InvalidProblem, counted, counts
from contactqp.exchange.fclib import SIGNATURE, SIGNATURE_PLACES, is_hdf5, read_fclib
from contactqp.exchange.files import Ledger, Path, check_finite, read_bytes, refuse_utf_16, wrong
from contactqp.exchange.matrix_files import stiffness_suffixes
from contactqp.exchange.numpy_files import ZIP, names_in_npz, read_npz, sparse_matrix
from contactqp.exchange.problem_folder import is_problem_folder, read_problem_archive, read_problem_folder
from contactqp.exchange.problem_writing import PROBLEM_FILE
from contactqp.exchange.processes import read_in_own_process
from contactqp.exchange.siconos import read_siconos
from contactqp.model.arguments import checked
from contactqp.model.local_problem import GlobalProblem, LocalProblem
from contactqp.model.problem import ContactProblem

QPS, MATLAB = (".qps", ".mps"), (".mat",)
# qpsolvers' names for the parts of a problem; missing parts are stored as a pickled None, which is never unpickled.
PARTS = ("P", "q", "G", "h", "A", "b", "lb", "ub")
# Bounds of at least this size mean "unbounded" in the .mat files of qpbenchmark and in HiGHS.
INFINITE = 1e20
GZIP = b"\x1f\x8b"


def is_quadratic_program(path: Path) -> bool:
    """Return whether a file is a quadratic program, by its suffix or, for an archive, by the names in it."""
    suffix = FilePath(path).suffix.lower()
    if suffix in (*QPS, *MATLAB):
        return True
    names = names_in_npz(path) if suffix == ".npz" else set()
    return {"P", "q"} <= names <= set(PARTS)


def read_quadratic_program(path: Path) -> tuple[ContactProblem, Ledger]:
    """Return the problem in a file and what was read, assumed and left out.

    Raises
    ------
    InvalidProblem
        The file is damaged, or its parts make no convex problem.
    BackendMissing
        A .qps or .mps file without highspy, which reads them.
    """
    suffix = FilePath(path).suffix.lower()
    read = _read_qps if suffix in QPS else _read_matlab if suffix in MATLAB else _read_archive
    return read(path)


def _read_archive(path: Path) -> tuple[ContactProblem, Ledger]:
    arrays = read_npz(path, none_for_objects=True)
    parts: dict[str, Any] = {name: arrays.get(name) for name in PARTS}
    pickled = [matrix for matrix, beside in ("Pq", "Gh", "Ab") if parts[matrix] is None and parts[beside] is not None]
    if pickled:
        what = "pickled objects, as qpsolvers saves sparse matrices, of which nothing is read: save them by .toarray()"
        raise wrong(path, ", ".join(pickled), "arrays", what)
    problem = _program(path, **parts)
    return problem, _ledger_of_program(path, problem, "qpsolvers", 0.0)


def _program(path: Path, **parts: Any) -> ContactProblem:
    try:
        return ContactProblem.from_qp(**parts)
    except InvalidProblem as error:
        raise InvalidProblem(f"{path}: {_with_names(str(error), parts.get('dof_names'))}") from None


def _read_matlab(path: Path) -> tuple[ContactProblem, Ledger]:
    """Read min 1/2 x'P x + q'x + r over l <= A x <= u, where the last n rows of A are the identity."""
    found = _matrices(path, read_in_own_process(path, "mat", "a .mat file of qpbenchmark"))
    missing = [name for name in ("P", "q", "A", "l", "u") if name not in found]
    if missing:
        raise wrong(path, "content", "P, q, A, l and u of qpbenchmark", f"none called {', '.join(missing)}")
    q, lower, upper = (_vector(path, name, found[name]) for name in ("q", "l", "u"))
    A, n = sp.csr_matrix(_real(path, "A", found["A"])), len(q)
    count = A.shape[0] - n
    if count < 0 or A.shape[1] != n or len(lower) != A.shape[0] or len(upper) != A.shape[0]:
        shapes = f"A {A.shape}, q ({n},), l ({len(lower)},), u ({len(upper)},)"
        raise wrong(path, "shapes", "l <= A x <= u with as many rows at the end as there are unknowns", shapes)
    if abs(A[count:] - sp.identity(n)).max() if n else False:
        raise wrong(path, "A", f"the identity in its last {n} rows, for bounds", "other entries")
    lower, upper = np.where(lower <= -INFINITE, -np.inf, lower), np.where(upper >= INFINITE, np.inf, upper)
    sides = dict(lb=lower[count:], ub=upper[count:], C=A[:count], l=lower[:count], u=upper[:count])
    problem = _program(path, P=_real(path, "P", found["P"]), q=q, **sides)
    constant = _vector(path, "r", found["r"]) if "r" in found else np.zeros(1)
    return problem, _ledger_of_program(path, problem, "qpbenchmark", float(constant[0]) if len(constant) else 0.0)


def _read_qps(path: Path) -> tuple[ContactProblem, Ledger]:
    """Read a program with HiGHS; the signs of one that is to be maximised are reversed."""
    if importlib.util.find_spec("highspy") is None:
        raise BackendMissing(f"{path}: .qps and .mps files are read by HiGHS: pip install highspy")
    head = read_bytes(path, EXPECTED, HEAD)
    refuse_utf_16(path, head)
    if head.startswith(GZIP):
        raise wrong(path, "content", "text", "a file compressed by gzip: unpack it by gunzip")
    refuse_malformed(path)
    found = _matrices(path, read_in_own_process(path, "qps", "a quadratic program in QPS form"))
    parts = {name: found[name] for name in ("C", "l", "u", "lb", "ub")}
    names = parts["dof_names"] = _names(found["names"], len(found["q"]))
    parts["range_names"] = _names(found["row_names"], found["C"].shape[0])
    for j in np.flatnonzero(parts["lb"] > parts["ub"])[:1].tolist():
        sides = f"{parts['lb'][j]:g} above {parts['ub'][j]:g} (without a lower bound it is 0)"
        raise wrong(path, f"bounds of {names[j] if names else j}", "a lower one at most the upper one", sides)
    problem = _program(path, P=found["P"], q=found["q"], **parts)
    return problem, _ledger_of_program(path, problem, "QPS", float(found["offset"]))


# Sections of a file in QPS form, those with quadratic terms, those with numbers, and bounds that have none.
SECTIONS = frozenset(
    b"NAME ROWS COLUMNS RHS RANGES BOUNDS QUADOBJ QMATRIX QSECTION QCMATRIX CSECTION OBJSENSE SOS SETS INDICATORS "
    b"DELAYEDROWS MODELCUTS USERCUTS LAZYCONS ENDATA".split()
)
QUADRATIC = frozenset(b"QUADOBJ QMATRIX QSECTION QCMATRIX".split())
OF_NUMBERS = frozenset(b"COLUMNS RHS RANGES BOUNDS".split()) | QUADRATIC
WITHOUT_NUMBER = frozenset(b"FR MI PL BV".split())
NUMBER = re.compile(rb"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|inf(inity)?|nan)", re.IGNORECASE)
LIKE_A_NUMBER = re.compile(rb"[+-]?\.?\d")
# Where fields begin and end in the fixed form, whose names may have spaces.
FIELDS = ((1, 3), (4, 12), (14, 22), (24, 36), (39, 47), (49, 61))
GAPS = ((0, 1), (3, 4), (12, 14), (22, 24), (36, 39), (47, 49), (61, None))
# The sides that each kind of bound sets, of which HiGHS keeps the first in a free and the last in a fixed form.
L, U = ("lower",), ("upper",)
SIDES = {b"LO": L, b"LI": L, b"MI": L, b"UP": U, b"UI": U, b"PL": U, b"FX": L + U, b"FR": L + U}
AGAIN = "another one, and HiGHS keeps one or adds both: take one away"


def refuse_malformed(path: Path) -> None:
    """Refuse a file in QPS form that HiGHS would read otherwise than it is written.

    HiGHS reads numbers as far as C's atof does: nothing of "abc" is 0, "1,5" is 1, and "2D3" is 2. It leaves out
    entries of unknown rows, repeated ones and third pairs in a line, adds up repeated quadratic terms, and makes an
    unknown of each new name. As names may have spaces in them, the first of two numbers in a line is examined only if
    it begins like one, and names only where words or fixed fields can be told apart.

    Raises InvalidProblem, which names the line.
    """
    entries = Entries()
    with open(path, "rb") as lines:
        for place, line in enumerate(lines, 1):
            words = line.split()
            if not words or words[0].startswith(b"*"):
                continue
            first, entries.place = words[0].upper(), place
            try:
                if first in SECTIONS and (len(words) == 1 or (line[:1].strip() and first != entries.section)):
                    entries.begin(first, words[1:])
                elif b"'MARKER'" not in words:
                    bounds = entries.section == b"BOUNDS"
                    if entries.section in OF_NUMBERS and not (bounds and first in WITHOUT_NUMBER):
                        _refuse_no_numbers(words)
                    entries.add(line, words)
            except _Malformed as error:
                raise wrong(path, f"line {place}", *error.args) from None
            if entries.section == b"ENDATA":
                break
    for name, place in entries.made.items():
        raise wrong(path, f"line {place}", "a column of COLUMNS, or with a quadratic term of its own", _shown(name))


class _Malformed(Exception):
    """What was expected in a line, and what came."""


def _refuse_no_numbers(words: list[bytes]) -> None:
    doubtful = [words[-1]] + [word for word in words[2:-2:2] if LIKE_A_NUMBER.match(word)] * (len(words) == 5)
    for word in doubtful:
        if not NUMBER.fullmatch(word):
            raise _Malformed("a number", _shown(word))


def _shown(name: bytes) -> str:
    return repr(name.decode(errors="replace"))


class Entries:
    """Names and entries of a file in QPS form, read line by line.

    Attributes
    ----------
    certain : bool, False from where fields in the fixed form cannot be told apart
    made : names that are not in COLUMNS and, so far, have no quadratic term of their own, and their lines
    fixed : whether HiGHS reads the fixed form, which it takes where a name has a space in it
    """

    def __init__(self) -> None:
        self.certain, self.fixed = True, False
        self.section = self.title = self.objective = self.column = b""
        self.begun: set[bytes] = set()
        self.rows: set[bytes] = set()
        self.columns: dict[bytes, int] = {}
        self.made: dict[bytes, int] = {}
        self.place = 0
        self.sets: dict[bytes, bytes] = {}
        self.seen: set[Any] = set()

    def begin(self, section: bytes, words: list[bytes]) -> None:
        """Begin a section, whose heading may have words after its name."""
        argument = words[0] if words else b""
        if section == b"NAME":
            self.title = argument
        elif section == b"OBJSENSE" and argument.upper().startswith(b"MAX") and argument != b"MAX":
            raise _Malformed("MAX after OBJSENSE", f"{_shown(argument)}, by which HiGHS does not maximise")
        elif section == b"RHS" and b"RANGES" in self.begun:
            raise _Malformed("RHS before RANGES", "it after them, where HiGHS takes ranges from zero: exchange the two")
        elif section in QUADRATIC and self.begun & QUADRATIC:
            raise _Malformed("one section of quadratic terms", f"{section.decode()} too, which HiGHS adds: join them")
        elif section in (b"QSECTION", b"QCMATRIX") and argument != self.objective and self.certain:
            raise _Malformed(f"quadratic terms of the objective {_shown(self.objective)}", _shown(argument))
        self.section = section
        self.begun.add(section)

    def add(self, line: bytes, words: list[bytes]) -> None:
        """Add a line of the present section."""
        if self.section == b"ROWS":
            self._add_row(line.strip())
        elif self.section == b"COLUMNS" and not self.fixed and len(words) > 1 and words[1] not in self.rows:
            # HiGHS takes the form for a fixed one where both names together are as short as a single one.
            text = line.strip()
            self.fixed = text.index(words[1], len(words[0])) + len(words[1]) < 9
        if self.section not in OF_NUMBERS:
            return
        if self.fixed:
            words = self._fields(line)
        if not self.certain or not words:
            return
        if self.section == b"COLUMNS":
            self._add_coefficients(words)
        elif self.section in (b"RHS", b"RANGES"):
            self._add_sides(words)
        elif self.section == b"BOUNDS":
            self._add_bound(words)
        else:
            self._add_terms(words)

    def _fields(self, line: bytes) -> list[bytes]:
        """Return the fields of a line in the fixed form, the first one among the bounds only."""
        text = line.rstrip()
        kind = text[1:3].strip()
        outside = any(text[start:end].strip() for start, end in GAPS) or bool(kind) != (self.section == b"BOUNDS")
        self.certain &= not outside and b"\t" not in text
        fields = [text[start:end].strip() for start, end in FIELDS]
        while fields and not fields[-1]:
            fields.pop()
        return fields if kind else fields[1:]

    def _add_row(self, text: bytes) -> None:
        kind, name = text[:1], text[1:].strip()
        self.fixed |= len(name.split()) > 1
        if name in self.rows:
            raise _Malformed("a new row", f"{_shown(name)} again: rename one of them or take it away")
        self.rows.add(name)
        if kind == b"N" and not self.objective:
            self.objective = name

    def _add_coefficients(self, words: list[bytes]) -> None:
        name = words[0]
        if name != self.column:
            if name in self.columns:
                raise _Malformed("entries of a column side by side", f"{_shown(name)} again: move them together")
            self.column, self.columns[name] = name, len(self.columns)
            self.seen = set()
        for row in self._pairs(words[1:], self.rows):
            self._once(row, f"the entry of {_shown(name)} in {_shown(row)}")

    def _add_sides(self, words: list[bytes]) -> None:
        """Add right-hand sides, of which HiGHS reads SIF's form without a set or with the title after it, or ranges."""
        named, start = True, 1
        if self.section == b"RHS" and not self.fixed:
            named = words[0] == b"RHS" or words[0] not in self.rows
            start = named + (named and words[1:2] == [self.title] and self.title not in self.rows)
        if named:
            self._refuse_second_set(words[0])
        for row in self._pairs(words[start:], self.rows):
            self._once((self.section, row), f"{_shown(row)} in {self.section.decode()}")

    def _add_bound(self, words: list[bytes]) -> None:
        kind, numbers = words[0], words[0] not in WITHOUT_NUMBER
        if kind not in SIDES or len(words) < 2:
            return
        named = self.fixed or words[1] not in self.columns
        if not named and (len(words) > 3 if numbers else len(words) > 2 and words[2] in self.columns):
            raise _Malformed("a set of bounds not called as a column", f"{_shown(words[1])}: rename the set")
        if len(words) == 1 + named:
            raise _Malformed("a column of COLUMNS", _shown(words[1]))
        name = words[1 + named]
        self._make(name)
        if named:
            self._refuse_second_set(words[1])
        for side in SIDES[kind]:
            self._once((side, self.columns[name]), f"the {side} bound of {_shown(name)}")

    def _add_terms(self, words: list[bytes]) -> None:
        for name in [words[0], *words[1::2]]:
            self._make(name)
        i, whole = self.columns[words[0]], self.section in (b"QMATRIX", b"QCMATRIX")
        for name in self._pairs(words[1:], self.columns):
            j = self.columns[name]
            key = (i, j) if whole or i < j else (j, i)
            self._once((b"Q", *key), f"the term of {_shown(words[0])} and {_shown(name)}")
            if i == j:
                self.made.pop(name, None)

    def _make(self, name: bytes) -> None:
        """Make an unknown of a new name, as HiGHS does, whose writer leaves empty columns out of COLUMNS."""
        if name not in self.columns:
            if self.fixed:
                raise _Malformed("a column of COLUMNS", _shown(name))
            self.columns[name] = len(self.columns)
            self.made[name] = self.place

    def _pairs(self, words: list[bytes], among: Collection[bytes]) -> list[bytes]:
        """Return the names in one or two pairs of a name and a number."""
        names = words[::2]
        for name in names:
            if name not in among:
                raise _Malformed("a row of ROWS", f"{_shown(name)}, which is none: mend its name")
        if len(words) not in (2, 4):
            raise _Malformed("one or two pairs of a name and a number", f"{len(words)} words")
        return names

    def _once(self, key: Any, what: str) -> None:
        if key in self.seen:
            raise _Malformed(f"{what} once", AGAIN)
        self.seen.add(key)

    def _refuse_second_set(self, name: bytes) -> None:
        first = self.sets.setdefault(self.section, name)
        if name != first:
            raise _Malformed(f"one set of {self.section.decode()}, {_shown(first)}", f"{_shown(name)}: take it away")


def _with_names(text: str, names: list[str] | None) -> str:
    """Return a text in which names stand for the numbers of unknowns, as in P[0, 1] or "at unknown 3"."""
    if names is None:
        return text
    text = re.sub(r"P\[(\d+), (\d+)\]", lambda found: f"P[{names[int(found[1])]}, {names[int(found[2])]}]", text)
    return re.sub(r"unknown (\d+)", lambda found: f"unknown {names[int(found[1])]}", text)


def _names(given: Any, count: int) -> list[str] | None:
    """Return the names in a file, None unless they are `count` different ones."""
    names = [name.decode("utf-8", errors="replace") for name in given.ravel().tolist()]
    return names if len(names) == len(set(names)) == count else None


def _matrices(path: Path, arrays: dict[str, Any]) -> dict[str, Any]:
    """Return the arrays that were read, sparse matrices put together again."""
    sparse = {name.removesuffix("_indptr") for name in arrays if name.endswith("_indptr")}
    parts = {f"{name}_{part}" for name in sparse for part in ("data", "indices", "indptr", "shape")}
    found = {name: array for name, array in arrays.items() if name not in parts}
    return found | {name: sparse_matrix(path, arrays, f"{name}_") for name in sparse}


def _vector(path: Path, name: str, values: Any) -> Any:
    vector = np.asarray(values.toarray() if sp.issparse(values) else values)
    if vector.dtype.kind not in "fiu":
        raise wrong(path, name, "real numbers", vector.dtype)
    vector = vector.astype(float).ravel()
    if name == "q":
        check_finite(path, name, vector)
    return vector


def _real(path: Path, name: str, matrix: Any) -> Any:
    if matrix.dtype.kind not in "fiu":
        raise wrong(path, name, "real numbers", matrix.dtype)
    if matrix.ndim > 2:
        raise wrong(path, name, "a matrix", f"an array of shape {matrix.shape}")
    return sp.csr_matrix(matrix, dtype=float) if sp.issparse(matrix) else np.asarray(matrix, dtype=float)


def _ledger_of_program(path: Path, problem: ContactProblem, form: str, constant: float) -> Ledger:
    ledger = Ledger(str(path))
    counts = f"{problem.dimension} unknowns, {problem.contacts} inequalities, {problem.ties} equations"
    ledger.read.append(f"a quadratic program ({form}): {counts}")
    if constant:
        ledger.ignored.append(f"the constant {constant:.9g} of the energy, which moves nothing")
    return ledger


EXPECTED = (
    "a folder or .npz of matrices, a file of FCLIB (HDF5) or Siconos (text), a quadratic program, or a deck (.inp)"
)
HEAD = max(SIGNATURE_PLACES) + len(SIGNATURE)
HDF5, TEXT, ARCHIVE, DECK = (".hdf5", ".h5"), (".dat",), (".npz",), (".inp",)
# Decks are read by `contactqp.scene`, a layer above this one, which is therefore imported by name.
DECK_READER = "contactqp.scene.deck.deck:read_deck_problem"


@checked
def read_problem(path: Path, *, as_stored: bool = False) -> ContactProblem | LocalProblem | GlobalProblem:
    """Return the problem in a folder of matrices or in a file of another code.

    Parameters
    ----------
    path : path
        A folder or .npz of matrices, a quadratic program (.qps, .mps, .mat, .npz) or a deck (.inp), which make a
        ContactProblem, or a file of FCLIB (HDF5) or Siconos (text), which makes what `read_fclib` says.
    as_stored : bool
        Return FCLIB's global form unchanged, as a GlobalProblem.

    Raises
    ------
    InvalidProblem
        The path holds none of these, or numbers are missing or wrong; the message names file and place.
    Unsupported, BackendMissing
        The file states what is not offered, or the package that reads it is missing.
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
        folder = FilePath(path).parent if FilePath(path).name == PROBLEM_FILE else FilePath(path)
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
    if os.path.isdir(file) or file.name == PROBLEM_FILE or file.suffix.lower() in (*ARCHIVE, *DECK):
        return True
    return os.path.isfile(file) and (is_quadratic_program(path) or read_bytes(path, EXPECTED, len(ZIP)) == ZIP)


def is_problem_file(path: Path) -> bool:
    """Return whether a file or folder is one that `read_problem` reads, by content or suffix, and not a case file.

    A folder is one if it holds a problem.json or a stiffness.
    """
    file = FilePath(path)
    suffix = file.suffix.lower()
    if file.is_dir():
        return is_problem_folder(file)
    if suffix == ".toml":
        return False
    if suffix in (*HDF5, *TEXT, *QPS, *MATLAB, *DECK, *ARCHIVE, *stiffness_suffixes()) or file.name == PROBLEM_FILE:
        return True
    if not file.is_file():
        return False
    head = read_bytes(path, EXPECTED, HEAD)
    return is_hdf5(head) or head.startswith(ZIP) or (head.split(maxsplit=1) or [b""])[0].isdigit()


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
