"""Run CalculiX on a deck, and compiled libraries that read a file, in processes of their own.

CalculiX runs in a folder of its own with a time limit, and its output is kept there. The deck is the given one with
included files inserted, except that its output requests are replaced by the displacements of all nodes.

Compiled libraries do not check the offsets in a damaged file and may crash or hang. So a child process calls them and
writes what it has read to a .npz file: ansys-mapdl-reader for .full and .rst, SciPy for .mat and HiGHS for .qps.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import BackendFailed, BackendMissing, InvalidProblem
from contactqp.exchange.deck.card_readers import FIXED_DIRECTIONS
from contactqp.exchange.deck.cards import PRINTED, Card, Line, read_cards
from contactqp.exchange.deck.instances import flattened
from contactqp.exchange.files import Path, file_size, one_line, wrong
from contactqp.exchange.numpy_files import read_npz
from contactqp.model.arrays import Index

# Address space allowed beyond the size of the file: one reader loads a graphics library.
MEMORY, TIMES = 2**33, 64
SECONDS = 120
# The parts of a quadratic program in qpbenchmark's .mat files.
MATLAB = ("P", "q", "A", "l", "u", "r")


def read_in_own_process(path: Path, kind: str, name: str) -> dict[str, Any]:
    """Return the arrays that a reader finds in a file; `kind` is the key of the reader, `name` that of the format.

    A sparse matrix M comes as M_data, M_indices, M_indptr and M_shape of its rows.

    Raises InvalidProblem: there is no such file, it is damaged, or it is not read within two minutes.
    """
    size = file_size(path, name)
    home = str(FilePath(__file__).absolute().parents[2])
    paths = os.pathsep.join([home, *filter(None, [os.environ.get("PYTHONPATH")])])
    with tempfile.TemporaryDirectory() as folder:
        output = FilePath(folder, "found.npz")
        command = [sys.executable, "-P", "-m", __name__, kind, os.path.abspath(path), str(output), str(size)]
        try:
            ended = subprocess.run(
                command, env=os.environ | {"PYTHONPATH": paths}, capture_output=True, timeout=SECONDS, check=False
            )
        except subprocess.TimeoutExpired:
            raise wrong(path, "content", name, f"one that is not read within {SECONDS} s") from None
        if ended.returncode < 0:
            raise wrong(path, "content", name, f"a damaged one (its reader ended by signal {-ended.returncode})")
        if ended.returncode or not output.is_file():
            lines = ended.stderr.decode("utf-8", errors="replace").strip().splitlines()
            raise wrong(path, "content", name, f"a damaged one ({lines[-1] if lines else 'no reason'!s:.200})")
        return read_npz(output)


def main(arguments: list[str]) -> int:
    """Read a file in this process, by the arguments ``KIND FILE OUTPUT BYTES``; an error becomes one line on stderr."""
    kind, source, output, size = arguments
    _limit_memory(MEMORY + TIMES * int(size))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = READERS[kind](source)
        np.savez(output, **found)
    # Other packages' readers raise arbitrary exceptions on a damaged file.
    except Exception as error:  # noqa: BLE001
        print(f"{type(error).__name__}: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    return 0


def full(source: str) -> dict[str, Any]:
    """Return stiffness (as `scipy.sparse.save_npz` stores it), load, nodes and directions of the free unknowns."""
    from ansys.mapdl.reader.full import FullFile

    file = FullFile(source)
    unknowns, K, _ = file.load_km(sort=False)
    if K is None:
        raise ValueError("no stiffness matrix in it")
    held = {(int(node), int(axis)) for node, axis in file.const}
    free = np.array([(int(node), int(axis)) not in held for node, axis in unknowns], dtype=bool)
    half = sp.csr_matrix(K)[free][:, free]
    upper = sp.triu(half + half.T) - sp.diags(half.diagonal())  # one half is stored, on either side of the diagonal
    whole = sp.csr_matrix(upper + sp.triu(upper, 1).T)
    return _parts("stiffness", whole) | {
        "load": np.asarray(file.load_vector, dtype=float)[free],
        "node": np.asarray(unknowns)[free, 0],
        "axis": np.asarray(unknowns)[free, 1],
        "held": np.array(len(held)),
        "equations": np.array(int(file._header["ncefull"])),
    }


def result(source: str) -> dict[str, Any]:
    """Return the displacements of the last set, along the axes of the nodes."""
    from ansys.mapdl.reader.rst import Result

    file = Result(source, read_mesh=False)
    node, values = file.nodal_solution(file.n_results - 1, in_nodal_coord_sys=True)
    return {
        "node": np.asarray(node),
        "values": np.asarray(values, dtype=float),
        "axes": np.array([str(name) for name in file.result_dof(file.n_results - 1)]),
        "sets": np.array(int(file.n_results)),
    }


def matlab(source: str) -> dict[str, Any]:
    """Return the parts of a quadratic program in a .mat file, sparse or dense."""
    from scipy.io import loadmat

    found: dict[str, Any] = {}
    for name, value in loadmat(source, appendmat=False, variable_names=list(MATLAB)).items():
        if name in MATLAB:
            found |= _parts(name, value) if sp.issparse(value) else {name: np.asarray(value)}
    return found


def qps(source: str) -> dict[str, Any]:
    """Return P, q, l <= C x <= u, lb <= x <= ub, the constant and the names of unknowns and rows, read by HiGHS."""
    import highspy

    reader: Any = highspy.Highs()  # type: ignore[no-untyped-call]
    reader.silent()
    with tempfile.TemporaryDirectory() as folder:
        copy = FilePath(folder, "program.mps")  # HiGHS chooses the reader by the suffix and has none for QPS
        copy.symlink_to(source)
        status = reader.readModel(str(copy))
    if status == highspy.HighsStatus.kError:
        raise ValueError("HiGHS cannot read it")
    model = reader.getModel()
    linear, hessian = model.lp_, model.hessian_
    n, m = linear.num_col_, linear.num_row_
    if any(kind != highspy.HighsVarType.kContinuous for kind in linear.integrality_):
        raise ValueError("integers among its unknowns")
    sign = -1.0 if linear.sense_ == highspy.ObjSense.kMaximize else 1.0
    P: Any = sp.csc_matrix((n, n))
    if hessian.dim_:
        lower = sp.csc_matrix((hessian.value_, hessian.index_, hessian.start_), shape=(n, n))
        P = lower + sp.tril(lower, -1).T
    entries = (linear.a_matrix_.value_, linear.a_matrix_.index_, linear.a_matrix_.start_)
    by_columns = linear.a_matrix_.format_ == highspy.MatrixFormat.kColwise
    C = (sp.csc_matrix if by_columns else sp.csr_matrix)(entries, shape=(m, n))
    sides = {"l": linear.row_lower_, "u": linear.row_upper_, "lb": linear.col_lower_, "ub": linear.col_upper_}
    found = _parts("P", sign * P) | _parts("C", C) | {name: np.array(side, float) for name, side in sides.items()}
    names = {"names": linear.col_names_, "row_names": linear.row_names_}
    found |= {key: np.array([str(name).encode() for name in given], "S") for key, given in names.items()}
    return found | {"q": sign * np.array(linear.col_cost_), "offset": float(linear.offset_)}


def _parts(name: str, matrix: Any) -> dict[str, Any]:
    """Return a sparse matrix as arrays, once its indices are within it."""
    matrix.check_format(full_check=True)
    rows = matrix.tocsr()
    return {f"{name}_{part}": np.asarray(getattr(rows, part)) for part in ("data", "indices", "indptr", "shape")}


READERS = {"full": full, "rst": result, "mat": matlab, "qps": qps}


def _limit_memory(most: int) -> None:
    try:
        import resource
    except ImportError:  # not on every system
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (most if hard < 0 else min(most, hard), hard))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))


# The command, where CONTACTQP_CCX names none.
COMMAND = "ccx"
JOB = "job"
# Longest lines that CalculiX reads whole.
WIDTH = 120
LABELS_A_LINE = 10
NODES, ELEMENTS = "CONTACTQPNODES", "CONTACTQPELEMENTS"
LONGEST_LOG = 2**20


@dataclass(frozen=True)
class CalculixRun:
    """A completed run of CalculiX.

    Attributes
    ----------
    results : path
        The .dat file with the displacements.
    version : ``"CalculiX 2.20"``
    warnings : tuple of str, the first lines of its own warnings, each once
    """

    results: FilePath
    version: str
    warnings: tuple[str, ...]


def calculix_command() -> str:
    """Return the command of CalculiX.

    Raises BackendMissing: it is not installed.
    """
    command = os.environ.get("CONTACTQP_CCX", COMMAND)
    if shutil.which(command) is None:
        raise BackendMissing(
            f"crosscheck needs CalculiX, and there is no {command!r}: install it (Debian: apt install calculix-ccx), "
            "name it by CONTACTQP_CCX, or give its results, MODEL.frd or MODEL.dat"
        )
    return command


def run_calculix(deck: Path, nodes: Index, folder: FilePath, time_limit: float) -> CalculixRun:
    """Run a deck in a folder and return where its results are.

    Raises BackendMissing: CalculiX is not installed; BackendFailed: it exceeded the time limit, ended with an error, or
    left no displacements; the message quotes CalculiX and names its log; InvalidProblem: the folder cannot be created.

    Parameters
    ----------
    deck : path
    nodes : (N,) array of int, the labels of the nodes whose displacements are printed
    folder : path, it is made where it is not there; files of an earlier run in it are taken away
    time_limit : seconds after which the run is stopped
    """
    command = calculix_command()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob(f"{JOB}.*"):
            old.unlink()
        (folder / f"{JOB}.inp").write_text(
            "\n".join(_lines(flattened(read_cards(deck))[0], nodes)) + "\n", encoding="latin-1"
        )
    except OSError as error:
        raise InvalidProblem(f"{folder}: cannot be written ({error.strerror or error})") from None
    log = folder / f"{JOB}.log"
    code = _run([command, JOB], folder, log, time_limit)
    printed = _tail(log)
    if code is None:
        raise BackendFailed(f"CalculiX did not end within {time_limit:g} s and was stopped; what it printed: {log}")
    errors = [" ".join(line.split()) for line in printed.splitlines() if line.lstrip().startswith("*ERROR")]
    if code != 0 or errors:
        text = f"signal {-code}" if code < 0 else f"exit code {code}"
        raise BackendFailed(f"CalculiX ended with {text}: {one_line_of(errors)}; what it printed: {log}")
    results = folder / f"{JOB}.dat"
    if not results.is_file() or not results.stat().st_size:
        raise BackendFailed(f"CalculiX ended without results in {results}; what it printed: {log}")
    return CalculixRun(results, _version(command), _warnings(printed))


def one_line_of(errors: list[str]) -> str:
    """Return the first error that a program printed, shortened, or a text stating that there was none."""
    return one_line(ValueError(errors[0])) if errors else "it names no error"


def _run(command: list[str], folder: FilePath, log: FilePath, time_limit: float) -> int | None:
    """Return the exit code, negative for a signal, None where the time limit was reached."""
    environment = os.environ | {"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}
    with open(log, "wb") as output:
        try:
            process = subprocess.Popen(
                command, cwd=folder, stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=environment,
                start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            raise BackendFailed(f"CalculiX cannot be started: {error.strerror or error}") from None
        try:
            return process.wait(time_limit)
        except subprocess.TimeoutExpired:
            return None
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _tail(log: FilePath) -> str:
    """Return the end of the log, which may be gigabytes long."""
    with open(log, "rb") as file:
        file.seek(max(0, log.stat().st_size - LONGEST_LOG))
        return file.read().decode("latin-1")


def _version(command: str) -> str:
    try:
        text = subprocess.run([command, "-v"], capture_output=True, timeout=60, check=False).stdout.decode("latin-1")
    except (OSError, subprocess.TimeoutExpired):
        text = ""
    found = re.search(r"[Vv]ersion\s+(\S+)", text)
    return f"CalculiX {found[1] if found else 'of unknown version'}"


def _warnings(printed: str) -> tuple[str, ...]:
    found: list[str] = []
    inside = False
    for line in (" ".join(line.split()) for line in printed.splitlines()):
        if line.startswith("*WARNING"):
            found.append(line.removeprefix("*WARNING").strip())
        elif inside and line and not line.startswith(("*", "Card image")):
            found[-1] = f"{found[-1]} {line}"[:300]
        inside = line.startswith("*WARNING") or (inside and bool(line))
    told = (line for line in found if "Card image" not in line)
    return tuple(dict.fromkeys(told))[:10]


def _lines(cards: Iterable[Card], nodes: Index) -> Iterator[str]:
    """Yield the lines of the deck that is run."""
    steps, sections = 0, list[str]()
    for card in cards:
        name = card.keyword.name
        if card.keyword.why == PRINTED or (name == "FRICTION" and not card.real(card.lines[0], 0, "a coefficient")):
            continue  # CalculiX has no coefficient of zero
        if name == "STEP" and not steps:
            yield f"*NSET, NSET={NODES}"
            labels = nodes.tolist()
            for at in range(0, len(labels), LABELS_A_LINE):
                yield ", ".join(map(str, labels[at : at + LABELS_A_LINE])) + ","
            yield from (f"*ELSET, ELSET={ELEMENTS}", *sections)
        if name == "SOLID SECTION":
            sections.append(card.parameter("ELSET"))
        steps += name == "STEP"
        if name == "END STEP":
            yield from (f"*NODE PRINT, NSET={NODES}", "U")
        yield from _folded(_head(card))
        if name == "SPRING":
            yield ""  # which the stiffness of SPRINGA stands behind
        for line in card.lines:
            yield from _data(card, line)


def _head(card: Card) -> str:
    """Return a keyword with its parameters; blanks around them, which CalculiX misreads, are removed.

    The type of a contact pair is always written, as CalculiX has no default.
    """
    if card.keyword.any_parameter:
        return card.head.text
    given = dict(card.parameters)
    if card.keyword.name == "CONTACT PAIR":
        given.setdefault("TYPE", "NODE TO SURFACE")
    names = (card.keyword.names[key] + (f"={value}" if value else "") for key, value in given.items())
    return ", ".join([card.name, *names])


def _data(card: Card, line: Line) -> Iterator[str]:
    """Yield lines of data with words for supports such as ENCASTRE, and gravity on all elements, in CalculiX's form."""
    words, keyword = line.words, card.keyword.name
    if keyword == "BOUNDARY" and len(words) == 2 and words[1] in FIXED_DIRECTIONS:
        yield from (f"{words[0]}, {axis + 1}, {axis + 1}" for axis in FIXED_DIRECTIONS[words[1]])
    elif keyword == "DLOAD" and not words[0]:
        yield ", ".join([ELEMENTS, *words[1:]])
    elif card.keyword.any_parameter:
        yield line.text
    else:
        yield ", ".join(words) + ("," if line.text.rstrip().endswith(",") else "")


def _folded(keyword: str) -> Iterator[str]:
    """Yield a keyword over as many lines as it takes."""
    line = ""
    for part in keyword.split(","):
        if line and len(line) + len(part) > WIDTH:
            yield line + ","
            line = ""
        line = f"{line},{part}" if line else part.strip()
    yield line
