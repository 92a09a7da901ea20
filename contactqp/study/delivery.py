"""Deliver a report into its folder, unfinished apart from finished, with the machine it was made on."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from contactqp.errors import SceneError
from contactqp.solving.methods import Method
from contactqp.study.running.journal import Journal

BASE = ("contactqp", "numpy", "scipy", "qpsolvers", "cvxpy", "matplotlib")
# Environment variables that decide on how many threads linear algebra runs.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def machine() -> dict[str, str]:
    """Return the platform, the processor, the version of Python and the limits of threads."""
    found = dict(
        platform=platform.platform(),
        processor=_processor(),
        cores=str(os.cpu_count()),
        python=f"{platform.python_implementation()} {platform.python_version()}",
    )
    return found | {name: os.environ[name] for name in THREADS if name in os.environ}


def _processor() -> str:
    """Return the model of the processor as Linux tells it, else what Python knows."""
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        for line in lines:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def linear_algebra() -> str:
    """Return the libraries of linear algebra that are loaded, and how many threads they would take now."""
    from threadpoolctl import threadpool_info

    found = (f"{one['internal_api']} {one['version']}, {one['num_threads']} threads" for one in threadpool_info())
    return "; ".join(dict.fromkeys(found))


# The load of a machine, for each core, from which it is busy with something else.
BUSY = 0.5


def load() -> float | None:
    """Return how many processes have run in the last minute on average; None where the system does not tell."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def busy(before: float | None) -> str:
    """Return what a load before a report means for its times; empty where the machine was idle."""
    cores = os.cpu_count() or 1
    if before is None or before <= BUSY * cores:
        return ""
    return (
        f"the machine was busy with something else, a load of {before:.1f} on {cores} cores, before the report began: "
        "run times are not to be trusted; errors and verdicts are, and methods of one case, which took turns, compare"
    )


def versions(methods: Sequence[Method]) -> dict[str, str]:
    """Return the version of every distribution that was or could have been used, or "not installed"."""
    homes = _homes()
    packages = dict.fromkeys(package for method in methods for package in method.packages)
    names = dict.fromkeys([*BASE, *(homes.get(package, [package])[0] for package in packages)])
    return {name: _version(name) for name in names}


@cache
def _homes() -> Mapping[str, list[str]]:
    """Return the distributions of each package; cached, as reading the files of all of them takes seconds."""
    return importlib.metadata.packages_distributions()


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


JOURNAL = "unfinished_report.jsonl"
# Prefix of the folder in which finished files wait until all are there.
_WORKSHOP = ".unfinished-"


def report_folder(folder: str | Path) -> Path:
    """Return the folder of a report, made if need be.

    Raises
    ------
    SceneError
        The folder cannot be made.
    """
    if not str(folder):
        raise SceneError("-o: expected a folder for the report, got an empty name")
    path = Path(folder)
    if path.exists() and not path.is_dir():
        raise SceneError(f"{path}: expected a folder for the report, and there is a file of that name")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SceneError(f"{path}: expected a folder that can be written, got: {error.strerror}") from None
    return path


@contextmanager
def unfinished(folder: Path, conditions: Mapping[str, Any], fresh: bool, name: str = JOURNAL) -> Iterator[Journal]:
    """Yield the journal of this folder's report, removed when the report is finished and kept when it is not.

    Parameters
    ----------
    folder : Path
        Folder of the report.
    conditions : mapping
        Versions, machine and settings under which kept results are the same.
    fresh : bool
        Discard the results of an interrupted report.
    name : str
        File name of the journal.

    Raises
    ------
    SceneError
        The folder cannot be written, or another report is being written to it.
    """
    journal = Journal(folder / name, conditions, fresh)
    for left_behind in folder.glob(f"{_WORKSHOP}*"):
        shutil.rmtree(left_behind, ignore_errors=True)
    try:
        yield journal
    except BaseException:
        journal.close()
        raise
    journal.remove()


@contextmanager
def workshop(folder: Path) -> Iterator[Path]:
    """Yield a folder for files that are being written, which is removed at the end."""
    with tempfile.TemporaryDirectory(prefix=_WORKSHOP, dir=folder) as path:
        yield Path(path)


def write(file: Path, text: str) -> None:
    """Write text in UTF-8, with the same line ends on every platform."""
    file.write_text(text, encoding="utf-8", newline="\n")


def deliver(shop: Path, folder: Path) -> tuple[Path, ...]:
    """Move every file to the folder, each in one step and the page last, and return their new names."""
    made = sorted(shop.iterdir(), key=lambda file: (file.suffix == ".html", file.suffix, file.name))
    for file in made:
        os.replace(file, folder / file.name)
    return tuple(folder / file.name for file in made)
