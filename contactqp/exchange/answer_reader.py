"""What reads somebody's answer in one format, and what it returns: `contactqp.exchange.answer_files` lists them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactqp.exchange.ledger import Ledger
from contactqp.exchange.refusal import Path, one_line, wrong
from contactqp.problem import ContactProblem

# The parts of an answer, and what else they are called. Pressures are forces only where areas come with them.
PARTS = ("displacement", "normal_force", "normal_pressure", "friction_force", "tie_force")
ALIASES = {
    "u": "displacement",
    "force": "normal_force",
    "contact_force": "normal_force",
    "pressure": "normal_pressure",
    "contact_pressure": "normal_pressure",
}

Parts = Mapping[str, NDArray[np.float64]]


class AnswerFile(NamedTuple):
    """An answer from a file; nothing of it is believed, and NaN is for the certificate to fail."""

    parts: Parts  # of `PARTS`, those that the file holds
    ledger: Ledger
    named: frozenset[str] = frozenset()  # the parts that came by name: they are in the problem's order already
    tie_names: tuple[str, ...] | None = None  # of tie_force: a problem has no names for its ties, those who read may


@dataclass(frozen=True)
class AnswerReader:
    """A format of answers."""

    name: str
    suffixes: tuple[str, ...]  # lower case, with their dots
    read: Callable[[Path, ContactProblem], AnswerFile]
    known: Callable[[bytes], bool] | None = None  # whether these first bytes are unmistakably of this format


def part_called(name: str) -> str | None:
    """Which part of an answer a key, a column or a file of this name holds."""
    plain = name.strip().lower().replace(" ", "_")
    found = ALIASES.get(plain, plain)
    return found if found in PARTS else None


def names_of(problem: ContactProblem, part: str) -> list[str]:
    """What the entries of a part other than tie_force are called in the problem."""
    if part == "displacement":
        return [problem.dof_name(j) for j in range(problem.dimension)]
    return [problem.contact_name(i) for i in range(problem.contacts)]


def places(path: Path, part: str, given: Sequence[str], names: Sequence[str], ledger: Ledger) -> list[int]:
    """Where each entry of a part stands among the names that a file gives it, or its positions counted from 0.

    Unknowns that the problem does not have, such as those of nodes that are held, are left out and the ledger says so;
    contacts that it does not have are refused.

    Raises
    ------
    InvalidProblem
        A name twice, or one that is missing.
    """
    place = {name: k for k, name in enumerate(given)}
    if len(place) != len(given):
        twice = next(name for k, name in enumerate(given) if place[name] != k)
        raise wrong(path, part, "every name once", f"{twice!r:.60} twice")
    if not any(name in place for name in names) and all(name.isdecimal() for name in given):
        names = [str(k) for k in range(len(names))]
        ledger.assumed.append(f"{part}: named by numbers: positions counted from 0")
    missing = [name for name in names if name not in place]
    extra = [name for name in place if name not in set(names)] if len(place) > len(names) or missing else []
    if missing or (extra and part != "displacement"):
        odd = ", ".join(sorted([*missing[:5], *extra[:5]]))
        raise wrong(path, part, f"{len(names)} values by name", f"a difference in {odd:.200}")
    if extra:
        ledger.ignored.append(f"{part}: {len(extra)} names that the problem does not have, such as {extra[0]!r:.60}")
    return [place[name] for name in names]


def real_array(path: Path, part: str, values: Any) -> NDArray[np.float64]:
    """Real numbers of one or two dimensions; None is NaN."""
    try:
        if isinstance(values, list):
            values = [[_number(v) for v in row] if isinstance(row, list) else _number(row) for row in values]
        raw = np.asarray(values)
        if raw.dtype.kind not in "fiu" and raw.size:
            raise TypeError(f"{raw.dtype.name}")
        array = raw.astype(float)
    except (TypeError, ValueError, OverflowError) as error:
        raise wrong(path, part, "numbers", one_line(error)) from None
    if array.ndim not in (1, 2):
        raise wrong(path, part, "a list of numbers", f"shape {array.shape}")
    return array


def _number(value: Any) -> float:
    if value is None:
        return float("nan")
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{value!r:.40}")
    return float(value)


def vector(path: Path, part: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """A column or a row as a vector; friction forces in space keep their two columns."""
    if values.ndim == 2 and min(values.shape) > 1:
        if part != "friction_force":
            raise wrong(path, part, "a vector", f"shape {values.shape}")
        return values
    return values.ravel()
