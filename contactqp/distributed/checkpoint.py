"""Keep the steps of a load path on disk, so that an interrupted run can continue, on any number of ranks.

A step is a folder with a file of each rank: the numbers that its unknowns, contacts and ties have in one process, and
their values. It counts once the step's own file exists beside the folder, which is written last, after the files of all
ranks. Every file is written whole or not at all.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.ranks import Ranks, ask_ranks
from contactqp.elements.scalars import places_among
from contactqp.errors import InvalidProblem
from contactqp.exchange.files import write_whole
from contactqp.model.arrays import Index
from contactqp.model.solution import Answer

# The version of the file format; no other is read.
FORMAT = 1
CASE = "case.json"


class Checkpoint:
    """A folder with the solved steps of one case. All methods are collective.

    Raises InvalidProblem: the folder contains other files, or steps of another case.

    Parameters
    ----------
    folder : str or Path, the same folder for all ranks; it is made if it does not exist
    digest : str, a text that differs from case to case
    ranks : Ranks, the processes

    Attributes
    ----------
    steps : int, the number of solved steps, including the start
    """

    def __init__(self, folder: str | Path, digest: str, ranks: Ranks) -> None:
        self.folder, self._digest, self._ranks = Path(folder), digest, ranks
        with ranks.raising_together(), _naming(self.folder):
            if ranks.rank == 0:
                self._claim()
        with ranks.raising_together(), _naming(self.folder):
            steps = 0
            while self._commit(steps).is_file():
                steps += 1
        # On shared file systems a new file may appear on other machines later.
        self.steps = -int(ranks.max(-steps))

    def write(self, step: int, problem: DistributedProblem, answer: Answer) -> None:
        """Write an answer, and return when the files of all ranks are on the disk.

        Raises
        ------
        InvalidProblem
            Writing fails on some rank; the step does not count.
        """
        ranks, here = self._ranks, self._part(step, self._ranks.rank, self._ranks.size)
        with ranks.raising_together(), _naming(here):
            here.parent.mkdir(exist_ok=True)
            stored: dict[str, Any] = {}
            for name, numbered in _NUMBERS.items():
                if (values := getattr(answer, name)) is not None:
                    free = getattr(problem, numbered) >= 0
                    stored |= {numbered: getattr(problem, numbered)[free], name: values[free]}
            write_whole(here, lambda beside: np.savez(beside, **stored), durable=True)
        with ranks.raising_together():
            if ranks.rank == 0:
                _write_json(self._commit(step), {"format": FORMAT, "case": self._digest, "parts": ranks.size})

    def read(self, step: int, problem: DistributedProblem) -> Answer:
        """Return this rank's part of an answer written by any number of ranks.

        Raises
        ------
        InvalidProblem
            A file is missing or cannot be read.
        """
        with self._ranks.raising_together(), _naming(self._commit(step)):
            count = int(self._checked(self._commit(step))["parts"])
        files: list[Any] = []
        with self._ranks.raising_together():
            for rank in range(self._ranks.rank, count, self._ranks.size):
                with _naming(self._part(step, rank, count)), np.load(self._part(step, rank, count)) as stored:
                    files.append({name: stored[name] for name in stored.files})
        fields: dict[str, Any] = {"friction_force": None}
        for name, numbered in _NUMBERS.items():
            parts = [part for part in files if name in part]
            with self._ranks.raising_together(), _naming(self.folder):
                numbers = np.concatenate([np.zeros(0, dtype=np.int64), *(part[numbered] for part in parts)])
                values: Any = np.concatenate([part[name] for part in parts]) if parts else np.zeros(0)
            width = int(self._ranks.max(values.shape[1] if values.ndim == 2 else -1))
            if name == "friction_force" and width < 0:
                continue  # a step without friction
            values = values.reshape(len(numbers), width) if width >= 0 else values
            fields[name] = self._fetched(step, getattr(problem, numbered), numbers, values)
        return Answer(**fields)

    def _claim(self) -> None:
        """Mark the folder as this case's, unless it is another's."""
        self.folder.mkdir(parents=True, exist_ok=True)
        if (self.folder / CASE).is_file():
            self._checked(self.folder / CASE)
            return
        if any(not path.name.startswith(".") for path in self.folder.iterdir()):
            raise InvalidProblem(f"{self.folder}: expected the steps of a run, or an empty folder")
        _write_json(self.folder / CASE, {"format": FORMAT, "case": self._digest})

    def _checked(self, file: Path) -> Any:
        """Return the data of a JSON file of this case."""
        data = json.loads(file.read_text())
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise InvalidProblem(f"{file}: expected format {FORMAT} of the steps of a run")
        if data.get("case") != self._digest:
            raise InvalidProblem(f"{self.folder}: these are steps of another case, or this one was changed since")
        return data

    def _fetched(self, step: int, wanted: Index, numbers: Index, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values of the wanted numbers, zero where negative; no rank holds all values.

        The value of each number is sent to rank number mod size, and requested from there.
        """
        ranks = self._ranks
        numbers, values = ranks.exchange(numbers % ranks.size, numbers, values)

        def found(asked: Index, _: Index) -> tuple[NDArray[Any]]:
            place, there = places_among(numbers, asked)
            with ranks.raising_together():
                if not there.all():
                    raise InvalidProblem(f"{self._commit(step)}: values are missing in the files of this step")
            return (values[place],)

        free = wanted >= 0
        fetched = np.zeros((len(wanted), *values.shape[1:]))
        fetched[free] = ask_ranks(ranks, wanted[free] % ranks.size, wanted[free], found)[0]
        return fetched

    def _commit(self, step: int) -> Path:
        return self.folder / f"step-{step:06d}.json"

    def _part(self, step: int, rank: int, size: int) -> Path:
        return self.folder / f"step-{step:06d}" / f"{rank}-of-{size}.npz"


# The fields of an answer, each with the field of the problem that contains the numbers of its rows.
_NUMBERS = {
    "displacement": "dof_number",
    "normal_force": "contact_number",
    "tie_force": "tie_number",
    "friction_force": "contact_number",
}


def _write_json(file: Path, data: dict[str, Any]) -> None:
    def write(beside: Path) -> None:
        beside.write_text(json.dumps(data))

    write_whole(file, write, durable=True)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Raise errors of the file system and of unreadable files as InvalidProblem with the file's name."""
    try:
        yield
    except InvalidProblem:
        raise
    except OSError as error:
        raise InvalidProblem(f"{error.filename or path}: {error.strerror or error}") from error
    except (ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InvalidProblem(f"{path}: expected a file of a step, got one that cannot be read ({error})") from error
