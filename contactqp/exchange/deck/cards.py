"""The cards of an input deck: a keyword with its parameters, and the lines of data below it.

A card begins with a line ``*KEYWORD, PARAMETER=VALUE, PARAMETER``, which a comma at its end continues on the next line.
Lines that begin with ``**`` are comments, blanks and the case of letters mean nothing outside of quotes, and
``*INCLUDE, INPUT=FILE`` stands for the lines of that file. Every card and line knows its file and number, so that each
message can name them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path as FilePath

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.exchange.deck.keywords import KEYWORDS, Effect, Keyword, squeezed
from contactqp.exchange.files import DECIMAL_COMMA, Path, number, read_bytes
from contactqp.model.arrays import Index, Vector

EXPECTED = "an input deck of Abaqus or CalculiX"
# Files that include files that include files: deeper is a circle or a mistake.
DEEPEST = 10
# Lines of all files together, of which each costs some hundred bytes of memory.
MOST_LINES = 5_000_000
LARGEST_LABEL = 2**40
MOST_GENERATED = 10**7
# CalculiX reads the first 20 characters of a number, and says nothing of the others.
CALCULIX_COLUMNS = 20


@dataclass(frozen=True)
class Line:
    """One line of data."""

    file: str
    number: int
    text: str

    @property
    def place(self) -> str:
        """Return ``model.inp: line 12``."""
        return f"{self.file}: line {self.number}"

    @property
    def words(self) -> list[str]:
        """Return the words between commas, in upper case, without blanks around them; a last empty one is left out."""
        words = [word.strip().strip('"').upper() for word in self.text.split(",")]
        return words[:-1] if words and not words[-1] else words


@dataclass(frozen=True, eq=False)
class Card:
    """One keyword, its parameters in upper case, and the lines of its data.

    Attributes
    ----------
    keyword : Keyword
    parameters : dict
        Names without blanks to values; a parameter without a value has the empty string.
    lines : sequence of Line
    head : Line
        Where the keyword stands.
    columns : int
        How many characters of a number are read.
    """

    keyword: Keyword
    parameters: dict[str, str]
    lines: Sequence[Line]
    head: Line
    columns: int = 10**6

    @property
    def name(self) -> str:
        """Return ``*SOLID SECTION``."""
        return f"*{self.keyword.name}"

    def wrong(self, expected: str, got: str, line: Line | None = None) -> InvalidProblem:
        """Return the error of this card, at one of its lines or at the keyword."""
        return InvalidProblem(f"{(line or self.head).place}: {self.name}: expected {expected}, got {got}")

    def refuse(self, what: str, line: Line | None = None) -> InvalidProblem:
        """Return the error for something that is known and not offered."""
        return InvalidProblem(f"{(line or self.head).place}: {self.name}: {what}")

    def parameter(self, name: str, default: str | None = None) -> str:
        """Return the value of a parameter.

        Raises
        ------
        InvalidProblem
            It is not there and has no default, or has no value.
        """
        value = self.parameters.get(squeezed(name), default)
        if not value:
            if default is not None and value is None:
                return default
            raise self.wrong(f"{name}=...", "none" if value is None else f"{name} without a value")
        return value

    def has(self, name: str) -> bool:
        """Return whether a parameter is stated."""
        return squeezed(name) in self.parameters

    def only_line(self, expected: str) -> Line:
        """Return the one line of data that this card has.

        Raises
        ------
        InvalidProblem
            There is none, or more than one.
        """
        if len(self.lines) != 1:
            raise self.wrong(f"one line of data, {expected}", f"{len(self.lines)} lines")
        return self.lines[0]

    def real(self, line: Line, at: int, what: str, default: float | None = None) -> float:
        """Return the finite number at a place of a line; `what` names it, `default` stands where it is blank."""
        words = line.words
        word = words[at] if at < len(words) else ""
        if not word:
            if default is not None:
                return default
            raise self.wrong(what, "nothing", line)
        return self.real_word(line, word, what)

    def real_word(self, line: Line, word: str, what: str) -> float:
        """Return a word as a finite number."""
        try:
            value = number(word[: self.columns])
        except ValueError:
            comma = " (a decimal comma? numbers have points)" if DECIMAL_COMMA.fullmatch(word) else ""
            raise self.wrong(what, f"{word[:40]!r}{comma}", line) from None
        if not abs(value) < 1e300:
            raise self.wrong(f"{what}, finite", f"{word[:40]!r}", line)
        return value

    def label(self, line: Line, word: str, what: str = "a label") -> int:
        """Return a word as the label of a node or an element: a whole number from 1 on."""
        if not is_label(word):
            raise self.wrong(f"{what}, a whole number from 1 on", repr(word[:40]), line)
        return int(word)

    def refuse_lines(self) -> None:
        """Refuse data below a keyword that has none."""
        if self.lines:
            raise self.wrong("no data", repr(self.lines[0].text[:40]), self.lines[0])

    def table(self, expected: str) -> Iterator[tuple[Line, list[str]]]:
        """Yield lines and their words; an empty line, or none at all, is refused."""
        if not self.lines:
            raise self.wrong(expected, "no line of data")
        for line in self.lines:
            yield line, line.words

    def generated(self, line: Line) -> Index:
        """Return the labels of ``first, last, step``; the step is 1 unless stated."""
        words = line.words
        if len(words) not in (2, 3) or not all(is_label(word) for word in words):
            raise self.wrong("a first and a last label and a step", repr(line.text[:60]), line)
        first, last, step = (*map(int, words), 1)[:3]
        if last < first:
            raise self.wrong("a last label not below the first", repr(line.text[:60]), line)
        if (last - first) // step >= MOST_GENERATED:
            raise self.wrong(f"at most {MOST_GENERATED} labels", repr(line.text[:60]), line)
        return np.arange(first, last + 1, step, dtype=np.int64)

    def numbers(self, line: Line, words: Sequence[str], what: str) -> Vector:
        """Return words as finite numbers; blank ones are 0, as both programs read them."""
        return np.array([self.real_word(line, word, what) if word else 0.0 for word in words], dtype=float)


def is_label(word: str) -> bool:
    """Return whether a word is a whole number from 1 on that labels something."""
    return word.isascii() and word.isdigit() and len(word) < 14 and 0 < int(word) < LARGEST_LABEL


def read_cards(path: Path, columns: int | None = None) -> list[Card]:
    """Return the cards of a deck and of the files it includes, in order, each one known and with known parameters.

    Parameters
    ----------
    path : path
    columns : int, optional
        Read this many characters of each number, as CalculiX does; all of them by default.

    Raises
    ------
    InvalidProblem
        No such file; a keyword or a parameter that is not known or not offered, by file and line; data before the
        first keyword; files that include each other.
    """
    cards: list[Card] = []
    lines: list[Line] = []
    for line in _lines(path, [], [0]):
        if not line.text.startswith("*"):
            if not cards:
                raise InvalidProblem(f"{line.place}: expected {EXPECTED}, beginning with *, got {line.text[:40]!r}")
            lines.append(line)
            continue
        lines = []
        keyword, parameters = _keyword(line)
        cards.append(Card(keyword, parameters, lines, line, 10**6 if columns is None else columns))
    if not cards:
        raise InvalidProblem(f"{path}: expected {EXPECTED}, got no keyword")
    return cards


def _lines(path: Path, above: list[str], count: list[int]) -> Iterator[Line]:
    """Yield the lines of a file, continued keywords joined, those of included files in their place."""
    name = os.fspath(path)
    if os.path.abspath(name) in above or len(above) >= DEEPEST:
        raise InvalidProblem(f"{name}: *INCLUDE: expected files that do not include each other, got a circle")
    above = [*above, os.path.abspath(name)]
    texts = read_bytes(path, EXPECTED).decode("latin-1").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    count[0] += len(texts)
    if count[0] > MOST_LINES:
        raise InvalidProblem(f"{name}: expected a deck of at most {MOST_LINES} lines")
    at = 0
    while at < len(texts):
        first, text = at, texts[at].strip()
        at += 1
        if not text or text.startswith("**"):
            continue
        while text.startswith("*") and text.endswith(",") and at < len(texts):
            text, at = text + texts[at].strip(), at + 1
        line = Line(name, first + 1, text.replace("\t", " "))
        if text.startswith("*") and squeezed(text[1:].split(",")[0]) == "INCLUDE":
            yield from _lines(_included(line), above, count)
        else:
            yield line


def _included(line: Line) -> FilePath:
    """Return the file that ``*INCLUDE, INPUT=FILE`` names, beside the file that this line stands in."""
    for option in line.text.split(",")[1:]:
        name, _, value = option.partition("=")
        if squeezed(name) != "INPUT":
            raise _unknown_parameter(line, "INCLUDE", name, ["INPUT"])
        if value.strip():
            return FilePath(line.file).parent / value.strip().strip('"')
    raise InvalidProblem(f"{line.place}: *INCLUDE: expected INPUT=FILE, got none")


def _keyword(line: Line) -> tuple[Keyword, dict[str, str]]:
    name, *options = line.text[1:].split(",")
    keyword = KEYWORDS.get(squeezed(name))
    if keyword is None:
        shown = " ".join(name.split())[:40]
        known = {squeezed(one.name): one.name for one in KEYWORDS.values()}
        near = get_close_matches(squeezed(name), list(known), n=1)
        nearest = f"; the nearest one is *{known[near[0]]}" if near else ""
        raise InvalidProblem(f"{line.place}: there is no keyword *{shown.upper()}{nearest}")
    if keyword.effect is Effect.REFUSED:
        raise InvalidProblem(f"{line.place}: *{keyword.name}: {keyword.why}")
    found: dict[str, str] = {}
    for option in options:
        given, _, value = option.partition("=")
        key = squeezed(given)
        if not key:
            if value.strip():
                raise InvalidProblem(f"{line.place}: *{keyword.name}: expected PARAMETER=VALUE, got {option.strip()!r}")
            continue
        if key in found:
            raise InvalidProblem(f"{line.place}: *{keyword.name}: expected {given.strip().upper()} once, got it twice")
        found[key] = value.strip().strip('"').upper()
        _check_parameter(line, keyword, given, found[key])
    return keyword, found


def _check_parameter(line: Line, keyword: Keyword, given: str, value: str) -> None:
    if keyword.any_parameter:
        return
    key = squeezed(given)
    if key not in keyword.parameters:
        raise _unknown_parameter(line, keyword.name, given, [*keyword.names.values()])
    offered = keyword.parameters[key]
    if offered is None:
        return
    if offered == "refused":
        raise InvalidProblem(f"{line.place}: *{keyword.name}: {keyword.names[key]} is not offered{keyword.cure(key)}")
    if offered != "idle" and squeezed(value) not in [squeezed(one) for one in offered.split("|")]:
        raise InvalidProblem(
            f"{line.place}: *{keyword.name}: expected {keyword.names[key]}={' or '.join(offered.split('|'))}, "
            f"got {value[:40]!r}{keyword.cure(key)}"
        )


def _unknown_parameter(line: Line, keyword: str, given: str, known: Sequence[str]) -> InvalidProblem:
    shown = " ".join(given.upper().split())[:40]
    near = get_close_matches(shown, list(known), n=1)
    meant = f"; the nearest one is {near[0]}" if near else f"; it has {', '.join(known) or 'none'}"
    return InvalidProblem(f"{line.place}: *{keyword} has no parameter {shown}{meant}")
