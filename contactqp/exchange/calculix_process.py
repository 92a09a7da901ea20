"""Run a deck by CalculiX, in a folder of its own, with a limit of time; what it prints is kept there.

The deck that is run is the one that is given, with its included files in their places, but for what is printed: the
displacements of all nodes are printed in place of whatever it asks for.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path as FilePath

from contactqp.errors import BackendFailed, BackendMissing, InvalidProblem
from contactqp.exchange.deck.cards import PRINTED, Card, read_cards
from contactqp.exchange.files import Path, one_line
from contactqp.model.arrays import Index

# The command, where CONTACTQP_CCX names none.
COMMAND = "ccx"
JOB = "job"
# Longest lines that CalculiX reads whole.
WIDTH = 120
LABELS_A_LINE = 10
NODES = "CONTACTQPNODES"
LONGEST_LOG = 2**20


@dataclass(frozen=True)
class CalculixRun:
    """One run that ended.

    Attributes
    ----------
    results : path
        The .dat file with the displacements.
    version : str
        ``"CalculiX 2.20"``.
    warnings : tuple of str
        The first lines of its own warnings, each once.
    """

    results: FilePath
    version: str
    warnings: tuple[str, ...]


def calculix_command() -> str:
    """Return the command of CalculiX.

    Raises
    ------
    BackendMissing
        It is not installed.
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

    Parameters
    ----------
    deck : path
    nodes : (N,) array of int
        The labels of the nodes whose displacements are printed.
    folder : path
        It is made where it is not there; files of an earlier run in it are taken away.
    time_limit : float
        Seconds after which the run is stopped.

    Raises
    ------
    BackendMissing
        CalculiX is not installed.
    BackendFailed
        It did not end in time, ended with an error, or left no displacements; its own words, and where all of them are.
    InvalidProblem
        The folder cannot be made.
    """
    command = calculix_command()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob(f"{JOB}.*"):
            old.unlink()
        (folder / f"{JOB}.inp").write_text("\n".join(_lines(read_cards(deck), nodes)) + "\n", encoding="latin-1")
    except OSError as error:
        raise InvalidProblem(f"{folder}: cannot be written ({error.strerror or error})") from None
    log = folder / f"{JOB}.log"
    code = _run([command, JOB], folder, log, time_limit)
    printed = _tail(log)
    if code is None:
        raise BackendFailed(f"CalculiX did not end within {time_limit:g} s and was stopped; what it printed: {log}")
    errors = [" ".join(line.split()) for line in printed.splitlines() if line.lstrip().startswith("*ERROR")]
    if code != 0 or errors:
        said = f"signal {-code}" if code < 0 else f"exit code {code}"
        raise BackendFailed(f"CalculiX ended with {said}: {one_line_of(errors)}; what it printed: {log}")
    results = folder / f"{JOB}.dat"
    if not results.is_file() or not results.stat().st_size:
        raise BackendFailed(f"CalculiX ended without results in {results}; what it printed: {log}")
    return CalculixRun(results, _version(command), _warnings(printed))


def one_line_of(errors: list[str]) -> str:
    """Return the first error of a program, shortened, or that it said none."""
    return one_line(ValueError(errors[0])) if errors else "it names no error"


def _run(command: list[str], folder: FilePath, log: FilePath, time_limit: float) -> int | None:
    """Return the exit code, negative for a signal; None where the time was up."""
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
    """Return the last of what was printed: an endless run may have printed gigabytes."""
    with open(log, "rb") as file:
        file.seek(max(0, log.stat().st_size - LONGEST_LOG))
        return file.read().decode("latin-1")


def _version(command: str) -> str:
    try:
        said = subprocess.run([command, "-v"], capture_output=True, timeout=60, check=False).stdout.decode("latin-1")
    except (OSError, subprocess.TimeoutExpired):
        said = ""
    found = re.search(r"[Vv]ersion\s+(\S+)", said)
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
    for card in cards:
        name = card.keyword.name
        if card.keyword.why == PRINTED:
            continue
        if name == "STEP":
            yield f"*NSET, NSET={NODES}"
            labels = nodes.tolist()
            for at in range(0, len(labels), LABELS_A_LINE):
                yield ", ".join(map(str, labels[at : at + LABELS_A_LINE])) + ","
        if name == "END STEP":
            yield from (f"*NODE PRINT, NSET={NODES}", "U")
        yield from _folded(card.head.text)
        if name == "SPRING":
            yield ""  # which the stiffness of SPRINGA stands behind
        for line in card.lines:
            yield line.text


def _folded(keyword: str) -> Iterator[str]:
    """Yield a keyword over as many lines as it takes."""
    line = ""
    for part in keyword.split(","):
        if line and len(line) + len(part) > WIDTH:
            yield line + ","
            line = ""
        line = f"{line},{part}" if line else part.strip()
    yield line
