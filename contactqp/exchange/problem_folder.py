"""Read a problem from a folder of matrices, described by a problem.json or by the names of the files alone.

    problem.json   format, version, name, description, unknowns, contacts, ties, units, files, dof_names, contact_names,
                   tie_names
    stiffness.mtx  normal.mtx  tangent.mtx  tie.mtx                           coordinates
    load.mtx  gap.mtx  friction.mtx  slip_origin.mtx  tie_value.mtx           arrays n x 1
    answer.json    displacement, normal_force, ..., and exact: the same as fractions

Without problem.json files are recognised by their names (stiffness or K, load or f, normal or E_N, ...) in any format
that `matrix_files` reads. contacts.csv, ties.csv and load.csv may state rows by the names of unknowns (`tables`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.exchange.files import Ledger, Path, read_text, wrong
from contactqp.exchange.matrix_files import companions, read_matrix, reader_of, stiffness_suffixes
from contactqp.exchange.numpy_files import is_sparse, read_npz, real, sparse_matrix
from contactqp.exchange.own_answers import load_json
from contactqp.exchange.problem_writing import (
    ANSWER_FILE,
    FORMAT,
    PROBLEM_FILE,
    SYMBOLS,
    VERSION,
    part_called,
    problem_of,
)
from contactqp.exchange.problem_writing import write_problem as write_problem
from contactqp.exchange.tables import Unknowns, is_table, read_contact_rows, read_load_rows, read_tie_rows
from contactqp.model.names import plain_name
from contactqp.model.problem import ContactProblem

# A problem in one .npz file: arrays called stiffness (K), load (f), normal (E_N), gap (g), ..., dense or sparse.
#
# A sparse matrix is K_data, K_indices, K_indptr, K_shape (and K_format where it is not csr), as `scipy.sparse.save_npz`
# names them. dof_names, contact_names and tie_names may be there too, as arrays of text.

OF_SPARSE = ("data", "indices", "indptr", "shape", "format", "row", "col")
NAMES = ("dof_names", "contact_names", "tie_names")


def read_problem_archive(path: Path) -> tuple[ContactProblem, Ledger]:
    """Return the problem in an archive, and its ledger.

    Raises InvalidProblem: no archive, a part that is missing or there twice, arrays that are not numbers, or not a
    problem together; Unsupported: Python objects, complex numbers, sparse forms other than CSR, CSC and COO.
    """
    arrays, ledger = read_npz(path), Ledger(str(path))
    parts: dict[str, Any] = {}
    used = set(NAMES)
    for called in dict.fromkeys((*SYMBOLS, *SYMBOLS.values())):
        part, value = part_called(called), _value(path, arrays, called)
        if part is None or value is None:
            continue
        if part in parts:
            raise wrong(path, part, "it once", f"{part} and {SYMBOLS[part]}")
        parts[part] = value
        used |= {called, *(f"{called}_{piece}" for piece in OF_SPARSE)}
        ledger.read.append(f"{part}: {called}, shape {value.shape}")
    names: dict[str, Any] = {name: _texts(path, name, arrays[name]) for name in NAMES if name in arrays}
    ledger.ignored.extend(name for name in arrays if name not in used)
    return problem_of(path, parts, ledger, **names), ledger


def _value(path: Path, arrays: Mapping[str, NDArray[Any]], name: str) -> Any:
    if is_sparse(arrays, f"{name}_"):
        return sparse_matrix(path, arrays, f"{name}_")
    return real(path, name, arrays[name]) if name in arrays else None


def _texts(path: Path, name: str, values: NDArray[Any]) -> list[str]:
    if values.dtype.kind != "U":
        raise wrong(path, name, "an array of text", values.dtype.name)
    return [str(one) for one in values.ravel()]


TABLES = ("contacts", "ties")
# The keys of problem.json: those that are read, and those that only inform readers.
ABOUT = ("kind", "difficulty", "source", "formula", "unique_displacement", "unique_forces", "exact_data", "rounding")
KEYS = ("format", "version", "unknowns", "contacts", "ties", "units", *NAMES, "files")
WORDS = ("name", "description", "signs", *ABOUT)
UNLISTED = f"not among the files of {PROBLEM_FILE}"


@dataclass
class Found:
    """The files of a folder by the part of the problem that they hold."""

    files: dict[str, FilePath] = field(default_factory=dict)
    ignored: list[str] = field(default_factory=list)

    def put(self, folder: Path, part: str, file: FilePath) -> None:
        if part in self.files:
            raise wrong(folder, part, "one file of it", f"{self.files[part].name} and {file.name}")
        self.files[part] = file


def is_problem_folder(path: Path) -> bool:
    """Return whether a folder holds a problem: a problem.json, or a stiffness by its name or its suffix."""
    folder = FilePath(path)
    if not folder.is_dir():
        return False
    names = [file for file in folder.iterdir() if file.suffix.lower() != ".toml"]
    return any(
        file.name == PROBLEM_FILE
        or part_called(file.stem) == "stiffness"
        or file.suffix.lower() in stiffness_suffixes()
        for file in names
    )


def read_problem_folder(folder: Path) -> tuple[ContactProblem, Ledger]:
    """Return the problem in a folder, and the ledger of its files.

    Raises InvalidProblem: no such folder, a part that is missing or given twice, a file with the wrong content;
    Unsupported and BackendMissing as the reader of each file.
    """
    root = FilePath(folder)
    if not root.is_dir():
        raise InvalidProblem(f"{folder}: expected a folder with a problem, and there is none of that name")
    ledger = Ledger(str(folder))
    stated = _stated(root / PROBLEM_FILE, ledger) if (root / PROBLEM_FILE).exists() else {}
    found = _listed(root, stated["files"]) if "files" in stated else _by_names(root)
    ledger.ignored.extend(found.ignored)
    if "stiffness" not in found.files:
        raise wrong(folder, "stiffness", "a file called stiffness or K", "none")
    parts, names = _read_parts(root, found, stated, ledger)
    units = stated.get("units")
    problem = problem_of(folder, parts, ledger, **names, units=units, ties=stated.get("ties"))
    for key, size in (("unknowns", problem.dimension), ("contacts", problem.contacts), ("ties", problem.ties)):
        if stated.get(key, size) != size:
            raise wrong(root / PROBLEM_FILE, key, f"{size}, as in the matrices", stated[key])
    return problem, ledger


def _stated(path: FilePath, ledger: Ledger | None = None) -> dict[str, Any]:
    """Return what problem.json states, checked."""
    data = load_json(path, "a problem in JSON")
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise wrong(path, "format", repr(FORMAT), repr(data.get("format") if isinstance(data, dict) else data)[:60])
    if data.get("version") != VERSION:
        raise wrong(path, "version", f"{VERSION}", repr(data.get("version"))[:60])
    stated = {key: value for key, value in data.items() if value is not None}
    for key in NAMES:
        names = stated.get(key, [])
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise wrong(path, key, "a list of names", repr(names)[:60])
    for key in ("files", "units"):
        pairs = stated.get(key, {})
        if not isinstance(pairs, dict) or not all(isinstance(value, str) for value in pairs.values()):
            raise wrong(path, key, "names by name", repr(pairs)[:60])
    unknown = sorted(set(stated) - {*KEYS, *WORDS})
    if unknown and ledger is not None:
        ledger.ignored.append(f"{path.name}: {', '.join(unknown):.200}")
    return stated


def _listed(root: FilePath, files: dict[str, str]) -> Found:
    """Return the files that problem.json lists; nothing outside its folder."""
    found = Found()
    for part, name in files.items():
        if part_called(part) != part or FilePath(name).name != name:
            raise wrong(
                root / PROBLEM_FILE,
                "files",
                "a part of a problem and a file beside this one",
                f"{part!r}: {name!r}"[:100],
            )
        found.put(root, part, root / name)
    known = {PROBLEM_FILE, ANSWER_FILE, *files.values()}
    found.ignored = [f"{file.name}: {UNLISTED}" for file in sorted(root.iterdir()) if file.name not in known]
    return found


def _by_names(root: FilePath) -> Found:
    found = Found()
    for file in sorted(root.iterdir()):
        part = part_called(file.stem)
        if file.suffix.lower() in stiffness_suffixes():
            part = "stiffness"
        elif file.stem in NAMES or (file.stem in TABLES and file.suffix.lower() == ".csv"):
            part = file.stem
        if part is None or file.is_dir() or file.suffix.lower() in (".json", *companions()):
            if file.name not in (PROBLEM_FILE, ANSWER_FILE) and file.suffix.lower() not in companions():
                found.ignored.append(file.name)
            continue
        found.put(root, part, file)
    return found


def _read_parts(
    root: FilePath, found: Found, stated: Mapping[str, Any], ledger: Ledger
) -> tuple[dict[str, Any], dict[str, Sequence[str] | None]]:
    """Return the parts of the problem, and the names of unknowns, contacts and ties."""
    files = dict(found.files)
    stiffness = files.pop("stiffness")
    K, labels, of_stiffness = read_matrix(stiffness)
    _add(ledger, stiffness, of_stiffness, "stiffness")
    given = {name: _given_names(root, name, files.pop(name, None), stated.get(name), ledger) for name in NAMES}
    names = _unknown_names(root, given["dof_names"], labels, K.shape[0], ledger)
    parts: dict[str, Any] = {"stiffness": K}
    unknowns = None
    for part, file in files.items():
        if part in TABLES or (part == "load" and is_table(file, "dof")):
            unknowns = unknowns or Unknowns(names, K.shape[0])
            own = Ledger(str(file))
            new, rows = _tabled(part, file, unknowns, own)
            named = "tie_names" if part == "ties" else "contact_names"
            stated_names = given[named]
            if rows is not None and stated_names is not None and list(stated_names) != rows:
                raise wrong(root, named, f"those of {file.name}, in its order", ", ".join(stated_names)[:100])
            given[named] = stated_names or rows
            _add(ledger, file, own, part)
        else:
            new = {part: _matrix(file, part, ledger)}
        twice = next((name for name in new if name in parts), None)
        if twice is not None:
            raise wrong(root, twice, "one file of it", f"a second one, {file.name}")
        parts |= new
    if "load" not in parts:
        _load_of(stiffness, parts, ledger)
    return parts, given | {"dof_names": names}


def _given_names(
    root: FilePath, key: str, file: FilePath | None, stated: list[str] | None, ledger: Ledger
) -> list[str] | None:
    """Return names from a file of names, or from problem.json; where both have them they must agree."""
    listed = None if file is None else _names(file)
    if listed is not None and stated is not None and listed != stated:
        raise wrong(root, key, f"the same in {file.name if file else ''} and {PROBLEM_FILE}", "others")
    if listed is not None and file is not None:
        ledger.read.append(f"{key}: {file.name}: {len(listed)} names")
    return stated or listed


def _unknown_names(
    root: FilePath, given: Sequence[str] | None, labels: Sequence[str] | None, count: int, ledger: Ledger
) -> Sequence[str] | None:
    """Return the names of the unknowns, those given or else those of the stiffness; both in different orders are
    refused.
    """
    if given is not None and len(given) != count:
        raise wrong(root, "dof_names", f"{count} names, one for each row of the stiffness", len(given))
    if given is None or labels is None:
        return given or labels
    ours, theirs = ([plain_name(name) or name for name in names] for names in (given, labels))
    if ours != theirs:
        if set(ours) == set(theirs):
            at = next(j for j, name in enumerate(ours) if name != theirs[j])
            raise wrong(root, "dof_names", f"{labels[at]!r} at line {at + 1}, as the stiffness says", repr(given[at]))
        ledger.ignored.append(f"names in the stiffness, such as {labels[0]!r:.40}: dof_names are others")
    return given


def _tabled(part: str, file: FilePath, unknowns: Unknowns, ledger: Ledger) -> tuple[dict[str, Any], list[str] | None]:
    """Return the parts that a table holds, and its names of the contacts or ties."""
    if part == "ties":
        return read_tie_rows(file, unknowns, ledger)
    if part == "load":
        return {"load": read_load_rows(file, unknowns, ledger)}, None
    return read_contact_rows(file, unknowns, ledger)


def _matrix(file: FilePath, part: str, ledger: Ledger) -> Any:
    matrix, _, own = read_matrix(file)
    _add(ledger, file, own, part)
    return matrix


def _load_of(stiffness: FilePath, parts: dict[str, Any], ledger: Ledger) -> None:
    """Add the load that is stored with the stiffness, if there is one."""
    reader = reader_of(stiffness)
    stored = reader.load(stiffness) if reader.load is not None else None
    if stored is not None:
        parts["load"] = stored[0]
        _add(ledger, stiffness, stored[1], "load")


def _names(file: FilePath) -> list[str]:
    """Return the names in a file, one a line."""
    return [line.strip() for line in read_text(file, "names, one a line").splitlines() if line.strip()]


def _add(ledger: Ledger, file: FilePath, own: Ledger, part: str) -> None:
    """Append the notes of one file's ledger to that of the folder."""
    for kind, line in own:
        getattr(ledger, kind).append(f"{part}: {file.name}: {line}" if part != "load" else f"{file.name}: {line}")
