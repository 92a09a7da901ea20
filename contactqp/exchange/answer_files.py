"""Read an answer to a problem from a file of any format: the registry of readers.

A format is one module with a `READER`, and its line in `READERS` here; `register` adds one from outside.
"""

from __future__ import annotations

from pathlib import Path as FilePath

from contactqp.exchange import ansys, calculix_results, own_answers
from contactqp.exchange.answer_reader import AnswerFile, AnswerReader, places
from contactqp.exchange.files import HEAD, Path, read_bytes
from contactqp.exchange.problem_writing import ANSWER_FILE
from contactqp.model.problem import ContactProblem

READERS: list[AnswerReader] = [
    own_answers.JSON_READER,
    own_answers.TABLE_READER,
    own_answers.ARCHIVE,
    own_answers.ARRAY,
    calculix_results.FRD,
    calculix_results.DAT,
    ansys.RESULT_READER,
]


def read_answer(path: Path, problem: ContactProblem) -> AnswerFile:
    """Return the answer in a file: its parts, the ledger, and which parts came by name.

    Parameters
    ----------
    path : path
        A file; or a folder of files called displacement, normal_force, ..., or one with an answer.json.
    problem : ContactProblem
        Whose names and sizes the file is held against; its ties are also called "tie 0", "tie 1", ... . Lists keep the
        file's order and length.

    Raises
    ------
    InvalidProblem
        No such file, no answer in it, names that are not the problem's.
    BackendMissing
        The package that reads this format is not installed.

    Examples
    --------
    >>> import json, tempfile, pathlib, contactqp as cq
    >>> wall = cq.ContactProblem(stiffness=[[157500.0]], load=[300.0], normal=[[1.0]], gap=[1e-3])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "answer.json")
    ...     _ = file.write_text(json.dumps({"displacement": [1e-3], "normal_force": {"contact 0": 142.5}}))
    ...     found = read_answer(file, wall)
    >>> found.parts["normal_force"], sorted(found.named), found.ledger.read
    (array([142.5]), ['normal_force'], ['displacement: 1 values in order', 'normal_force: 1 values by name'])
    """
    file = FilePath(path)
    if file.is_dir() and (file / ANSWER_FILE).is_file():
        return read_answer(file / ANSWER_FILE, problem)
    read = own_answers.read_folder_answer if file.is_dir() else reader_of(path).read
    found = read(path, problem)
    if found.tie_names is None:
        return found
    names = [f"tie {k}" for k in range(problem.ties)]
    if set(found.tie_names) != set(names):
        names = list(map(problem.tie_name, range(problem.ties)))
    order = places(path, "tie_force", found.tie_names, names, found.ledger)
    return found._replace(parts={**found.parts, "tie_force": found.parts["tie_force"][order]})


def register(reader: AnswerReader) -> None:
    """Add a format of one's own; it is asked before those that are here."""
    READERS.insert(0, reader)


def reader_of(path: Path) -> AnswerReader:
    """Return the reader of a file: by its contents where they tell, by its suffix, otherwise that of plain numbers."""
    head = read_bytes(path, _expected(), HEAD)
    suffix = FilePath(path).suffix.lower()
    for reader in READERS:
        if reader.known is not None and reader.known(head):
            return reader
    by_suffix = (reader for reader in READERS if suffix in reader.suffixes and reader is not own_answers.TABLE_READER)
    return next(by_suffix, own_answers.ARRAY)


def _expected() -> str:
    return "an answer: " + ", ".join(reader.name for reader in READERS)
