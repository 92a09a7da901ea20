"""Matrices and vectors as plain text or CSV: a row a line, numbers apart by commas, semicolons or blanks."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from contactqp.exchange.matrix_reader import MatrixFile, MatrixReader
from contactqp.exchange.refusal import Ledger, Path, file_size, is_number, no_number, number, refuse_utf_16, wrong

NAME = "text or CSV"
EXPECTED = "numbers in text or CSV"
# A row of a million numbers; what has no line breaks at all is no table.
LONGEST_LINE = 2**24
COMMENTS = ("#", "%", "//")
COMMA_IN_NUMBER = re.compile(r"\d,\d")
SEPARATORS = re.compile(r"\s*[,;]\s*|\s+")


def read_text_matrix(path: Path) -> MatrixFile:
    """A dense matrix; a first line of names is what its unknowns are called. Comments begin with # or %.

    Raises
    ------
    InvalidProblem
        No such file, a word that is no number (where, which), rows of different lengths, nothing at all.
    """
    ledger, values, width, header = Ledger(str(path)), array("d"), 0, None
    for line, words in _rows(path):
        if not width and header is None and not any(is_number(word) for word in words):
            header = words
            continue
        width = width or len(words)
        if len(words) != width:
            raise wrong(path, f"line {line}", f"{width} numbers, as in the lines before", len(words))
        values.extend(_numbers(path, line, words))
    if not width:
        raise wrong(path, "content", EXPECTED, "no number")
    matrix: NDArray[np.float64] = np.frombuffer(values, dtype=float).reshape(-1, width)
    ledger.read.append(f"{NAME}: {matrix.shape[0]} by {width}")
    labels = None
    if header is not None:
        ledger.read.append(f"first line: {len(header)} names, such as {header[0]!r:.40}")
        labels = tuple(header) if len(header) == width else None
        if labels is None:
            raise wrong(path, "first line", f"{width} names, one a column", len(header))
    return MatrixFile(matrix, labels, ledger)


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """The words of every line that has any, with its number."""
    file_size(path, EXPECTED)
    with open(path, "rb") as file:
        place = 0
        while line := file.readline(LONGEST_LINE):
            place += 1
            if place == 1:
                refuse_utf_16(path, line)
            if b"\0" in line:
                raise wrong(path, f"line {place}", EXPECTED, "the byte 0x00: a binary file")
            if len(line) == LONGEST_LINE and not line.endswith(b"\n"):
                raise wrong(path, f"line {place}", f"at most {LONGEST_LINE} bytes", "more")
            try:
                text = line.decode("utf-8-sig" if place == 1 else "utf-8")
            except UnicodeDecodeError as error:
                raise wrong(path, f"line {place}", EXPECTED, f"the byte 0x{line[error.start]:02x}") from None
            for mark in COMMENTS:
                text = text.partition(mark)[0]
            text = text.strip().rstrip(",;")
            if COMMA_IN_NUMBER.search(text) and (";" in text or "\t" in text):
                raise wrong(
                    path, f"line {place}", "one mark between numbers", "two: decimal commas? numbers have points"
                )
            if text:
                yield place, SEPARATORS.split(text)


def _numbers(path: Path, line: int, words: list[str]) -> list[float]:
    try:
        return [number(word) for word in words]
    except ValueError:
        bad = next(word for word in words if not is_number(word))
        raise no_number(path, f"line {line}", bad) from None


READER = MatrixReader(NAME, (".csv", ".txt", ".dat", ".asc", ".tsv"), read_text_matrix)
