"""The words of a Siconos text file, taken one after another; what is not a number is refused with its line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.errors import InvalidProblem
from contactqp.exchange.refusal import Path, check_finite, is_number, read_bytes, wrong

EXPECTED = "a Siconos file (text)"


class Words:
    """A place in a text; line breaks are like blanks to Siconos."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data = read_bytes(path, EXPECTED)
        try:
            self._text = data.decode("ascii")
        except UnicodeDecodeError as error:
            byte = f"the byte 0x{data[error.start]:02x} at place {error.start}"
            raise wrong(path, "content", EXPECTED, byte) from None
        self._words = self._text.split()
        self._next = 0
        if not self._words:
            raise wrong(path, "content", EXPECTED, "an empty file")

    @property
    def left(self) -> int:
        """How many words there still are."""
        return len(self._words) - self._next

    def peek(self) -> str | None:
        """The next word, if there is one."""
        return self._words[self._next] if self.left else None

    def ahead(self, count: int) -> list[str]:
        """The next words, without taking them."""
        return self._words[self._next : self._next + count]

    def words(self, count: int, what: str) -> list[str]:
        """The next words; `what` says what they are.

        Raises
        ------
        InvalidProblem
            The text ends before.
        """
        if count > self.left:
            raise wrong(self.path, what, f"{count} {'value' if count == 1 else 'values'}", f"{self.left}, then the end")
        taken = self._words[self._next : self._next + count]
        self._next += count
        return taken

    def integer(self, what: str) -> int:
        return int(self.integers(1, what)[0])

    def size(self, what: str) -> int:
        value = self.integer(what)
        if value < 0:
            raise wrong(self.path, what, "a size", value)
        return value

    def integers(self, count: int, what: str) -> NDArray[np.int64]:
        first = self._next
        return as_integers(self, self.words(count, what), what, first)

    def numbers(self, count: int, what: str) -> NDArray[np.float64]:
        """(count,) finite numbers."""
        first = self._next
        return as_numbers(self, self.words(count, what), what, first)

    def literal(self, *expected: str, what: str) -> None:
        """Step over these words."""
        first = self._next
        taken = self.words(len(expected), what)
        for place, (want, got) in enumerate(zip(expected, taken, strict=True)):
            if want != got:
                raise self.unexpected(what, repr(want), first + place)

    def unexpected(self, what: str, expected: str, place: int | None = None) -> InvalidProblem:
        """The refusal of the word at a place, the one taken last by default."""
        at = self._next - 1 if place is None else place
        return wrong(self.path, f"{what} (line {self._line(at)})", expected, repr(self._words[at][:40]))

    @property
    def place(self) -> int:
        return self._next

    def _line(self, place: int) -> int:
        before = 0
        for number, line in enumerate(self._text.splitlines(), start=1):
            before += len(line.split())
            if before > place:
                return number
        return 0


def as_integers(words: Words, taken: list[str], what: str, first: int, step: int = 1) -> NDArray[np.int64]:
    """Words as integers; the k-th stands at the place first + k step."""
    try:
        return np.array([int(word) for word in taken], dtype=np.int64)
    except (ValueError, OverflowError):
        bad = next(k for k, word in enumerate(taken) if not _is_integer(word))
        raise words.unexpected(what, "an integer", first + bad * step) from None


def as_numbers(words: Words, taken: list[str], what: str, first: int, step: int = 1) -> NDArray[np.float64]:
    """Words as finite numbers; the k-th stands at the place first + k step."""
    try:
        values = np.array([float(word) for word in taken])
    except ValueError:
        bad = next(k for k, word in enumerate(taken) if not is_number(word))
        raise words.unexpected(what, "a number", first + bad * step) from None
    check_finite(words.path, what, values)
    return values


def _is_integer(word: str) -> bool:
    try:
        return abs(int(word)) <= np.iinfo(np.int64).max
    except ValueError:
        return False
