"""The steps of a load path on disk, so that a run that was ended goes on, on as many ranks as it is given then.

A step is a folder with a file of each rank: the numbers that its unknowns, contacts and ties have in one process, and
their values. It counts once the step's own file stands beside the folder; that is written last, when all ranks have
written theirs. Every file is written whole or not at all.
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

from contactqp.distributed.problem import DistributedAnswer, DistributedProblem, Numbers
from contactqp.distributed.ranks import Ranks
from contactqp.errors import InvalidProblem
from contactqp.exchange.whole_file import write_whole

# Of the files: another one cannot be read by this code.
FORMAT = 1
CASE = "case.json"


class Checkpoint:
    """A folder with the steps of one case that are solved. Everything is collective.

    Parameters
    ----------
    folder : str or Path
        All ranks see the same one; it is made if it is not there.
    digest : str
        Another one for another case.
    ranks : Ranks

    Raises
    ------
    InvalidProblem
        The folder holds something else, or steps of another case.
    """

    def __init__(self, folder: str | Path, digest: str, ranks: Ranks) -> None:
        self.folder, self._digest, self._ranks = Path(folder), digest, ranks
        with ranks.together(), _naming(self.folder):
            if ranks.rank == 0:
                self._claim()
        with ranks.together(), _naming(self.folder):
            known = 0
            while self._commit(known).is_file():
                known += 1
        # A file system of several machines may show a new file to one of them later.
        self.steps = -int(ranks.max(-known))  # that are solved, the start included

    def write(self, step: int, problem: DistributedProblem, answer: DistributedAnswer) -> None:
        """Keep an answer: after this it is on the disk, of all ranks.

        Raises
        ------
        InvalidProblem
            The file system of some rank refuses; the step does not count.
        """
        ranks, here = self._ranks, self._part(step, self._ranks.rank, self._ranks.size)
        with ranks.together(), _naming(here):
            here.parent.mkdir(exist_ok=True)
            parts: dict[str, Any] = _parts(problem, answer)
            write_whole(here, lambda beside: np.savez(beside, **parts), durable=True)
        with ranks.together():
            if ranks.rank == 0:
                _write_json(self._commit(step), {"format": FORMAT, "case": self._digest, "parts": ranks.size})

    def read(self, step: int, problem: DistributedProblem) -> DistributedAnswer:
        """The part of this rank of an answer that any number of ranks has written.

        Raises
        ------
        InvalidProblem
            A file is missing or no good.
        """
        with self._ranks.together(), _naming(self._commit(step)):
            count = int(self._checked(self._commit(step))["parts"])
        read: list[Any] = []
        with self._ranks.together():
            for rank in range(self._ranks.rank, count, self._ranks.size):
                with _naming(self._part(step, rank, count)), np.load(self._part(step, rank, count)) as stored:
                    read.append({name: stored[name] for name in stored.files})
        values: dict[str, Any] = {"friction_force": None}
        for name, numbers in _NUMBERED.items():
            parts = [(part[numbers], part[name]) for part in read if name in part]
            with self._ranks.together(), _naming(self.folder):
                found, known = _joined(parts)
            wide = int(self._ranks.max(known.shape[1] if known.ndim == 2 else -1))
            if name == "friction_force" and wide < 0:
                continue  # of a step that nothing rubs in
            known = known.reshape(len(found), wide) if wide >= 0 else known
            values[name] = self._fetched(step, getattr(problem, numbers), found, known)
        return DistributedAnswer(**values)

    def _claim(self) -> None:
        """Make the folder this case's, unless it is another's."""
        self.folder.mkdir(parents=True, exist_ok=True)
        if (self.folder / CASE).is_file():
            self._checked(self.folder / CASE)
            return
        if any(not path.name.startswith(".") for path in self.folder.iterdir()):
            raise InvalidProblem(f"{self.folder}: expected the steps of a run, or an empty folder")
        _write_json(self.folder / CASE, {"format": FORMAT, "case": self._digest})

    def _checked(self, file: Path) -> Any:
        """What a file of ours says, if it is of this case."""
        said = json.loads(file.read_text())
        if not isinstance(said, dict) or said.get("format") != FORMAT:
            raise InvalidProblem(f"{file}: expected format {FORMAT} of the steps of a run")
        if said.get("case") != self._digest:
            raise InvalidProblem(f"{self.folder}: these are steps of another case, or this one was changed since")
        return said

    def _fetched(self, step: int, wanted: Numbers, numbers: Numbers, values: NDArray[Any]) -> NDArray[Any]:
        """The values of the wanted numbers, zero where negative; nobody holds the whole.

        Each number has a rank that knows of it, number mod size: those who have read values bring them there, those
        who want them ask there.
        """
        ranks = self._ranks
        numbers, values = ranks.exchanged(numbers % ranks.size, numbers, values)
        order = np.argsort(numbers)
        numbers, values = numbers[order], values[order]
        asked = wanted[wanted >= 0]
        came, asker = ranks.exchanged(asked % ranks.size, asked, np.full(len(asked), ranks.rank))
        place = np.minimum(np.searchsorted(numbers, came), max(len(numbers) - 1, 0))
        with ranks.together():
            if len(came) and (not len(numbers) or np.any(numbers[place] != came)):
                raise InvalidProblem(f"{self._commit(step)}: values are missing in the files of this step")
        answered, answers = ranks.exchanged(asker, came, values[place])
        back = np.zeros((len(wanted), *values.shape[1:]))
        back[wanted >= 0] = answers[np.argsort(answered)][np.argsort(np.argsort(asked))]
        return back

    def _commit(self, step: int) -> Path:
        return self.folder / f"step-{step:06d}.json"

    def _part(self, step: int, rank: int, size: int) -> Path:
        return self.folder / f"step-{step:06d}" / f"{rank}-of-{size}.npz"


# Each field of an answer, and the numbers of its rows.
_NUMBERED = {
    "displacement": "dof_number",
    "normal_force": "contact_number",
    "tie_force": "tie_number",
    "friction_force": "contact_number",
}


def _parts(problem: DistributedProblem, answer: DistributedAnswer) -> dict[str, NDArray[Any]]:
    """What is stored of one rank; unknowns that supports hold are left out."""
    free = problem.dof_number >= 0
    stored = {name: getattr(problem, name) for name in ("contact_number", "tie_number")}
    stored |= {"dof_number": problem.dof_number[free], "displacement": answer.displacement[free]}
    stored |= {"normal_force": answer.normal_force, "tie_force": answer.tie_force}
    return stored if answer.friction_force is None else {**stored, "friction_force": answer.friction_force}


def _joined(parts: list[tuple[Numbers, NDArray[Any]]]) -> tuple[Numbers, NDArray[Any]]:
    """Numbers and values of all parts, one after the other."""
    if not parts:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    return np.concatenate([numbers for numbers, _ in parts]), np.concatenate([values for _, values in parts])


def _write_json(file: Path, data: dict[str, Any]) -> None:
    def write(beside: Path) -> None:
        beside.write_text(json.dumps(data))

    write_whole(file, write, durable=True)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """What the file system or the reader of a file says is an error of contactqp with the file's name."""
    try:
        yield
    except InvalidProblem:
        raise
    except OSError as error:
        raise InvalidProblem(f"{error.filename or path}: {error.strerror or error}") from error
    except (ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InvalidProblem(f"{path}: expected a file of a step, got one that cannot be read ({error})") from error
