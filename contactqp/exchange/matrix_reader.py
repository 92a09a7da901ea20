"""What reads matrices of one format, and what it returns: `contactqp.exchange.matrix_files` is the list of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from contactqp.exchange.ledger import Ledger
from contactqp.exchange.refusal import Path
from contactqp.model.arrays import Vector


class MatrixFile(NamedTuple):
    """A matrix from a file."""

    matrix: Any  # dense or sparse, any numbers: NaN is for the problem to refuse, which knows what they mean
    labels: tuple[str, ...] | None  # what the unknowns are called, such as "12.x", in the order of the columns
    ledger: Ledger


def say_sums(ledger: Ledger, stored: int, different: int) -> None:
    """Entries of a sparse matrix that are stored more than once add up, as in every assembly."""
    if stored > different:
        ledger.converted.append(f"{stored - different} entries are stored more than once: added up")


@dataclass(frozen=True)
class MatrixReader:
    """A format of matrices or vectors."""

    name: str
    suffixes: tuple[str, ...]  # lower case, with their dots
    read: Callable[[Path], MatrixFile]
    known: Callable[[bytes], bool] | None = None  # whether these first bytes are unmistakably of this format
    stiffness: bool = False  # files of this suffix hold a stiffness, whatever they are called
    load: Callable[[Path], tuple[Vector, Ledger] | None] | None = None  # the load stored with the stiffness, if any
    beside: tuple[str, ...] = ()  # suffixes of files that it reads along with its own, such as those of names
