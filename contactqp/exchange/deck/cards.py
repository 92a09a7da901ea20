"""The cards of an input deck: a keyword with its parameters, and the lines of data below it.

A card begins with a line ``*KEYWORD, PARAMETER=VALUE, PARAMETER``, which a comma at its end continues on the next line.
Lines that begin with ``**`` are comments, blanks and the case of letters mean nothing outside of quotes, and
``*INCLUDE, INPUT=FILE`` stands for the lines of that file. Every card and line knows its file and number, so that each
message can name them.

The tables of keywords and parameters follow the CalculiX CrunchiX user's manual 2.20 and the Abaqus keywords guide.
Each entry is read, has no effect, or is refused with a reason; a keyword or parameter that is in no table is an error.
"""

from __future__ import annotations

import codecs
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from enum import Enum
from pathlib import Path as FilePath

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.exchange.deck.model import ELASTIC, PROCEDURE, REFUSED
from contactqp.exchange.files import DECIMAL_COMMA, Path, number, read_bytes, refuse_utf_16
from contactqp.model.arrays import Index, Vector

EXPECTED = "an input deck of Abaqus or CalculiX"
# The deepest nesting of included files; a deeper one is taken for a cycle.
DEEPEST = 10
# Lines of all files together, of which each costs some hundred bytes of memory.
MOST_LINES = 5_000_000
LARGEST_LABEL = 2**40
# Fortran, by which both programs read, takes 2.1+5 for 2.1e5.
_BARE_EXPONENT = re.compile(r"(?<=[\d.])(?=[+-]\d+$)")
MOST_GENERATED = 10**7
# CalculiX reads the first 20 characters of a number and silently drops the others.
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
    parameters : dict, names without blanks to values; a parameter without a value has the empty string
    lines : sequence of Line
    head : the line of the keyword
    columns : how many characters of a number are read
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
        """Return the error for a feature of decks that is known but not offered."""
        return InvalidProblem(f"{(line or self.head).place}: {self.name}: {what}")

    def parameter(self, name: str, default: str | None = None) -> str:
        """Return the value of a parameter.

        Raises InvalidProblem: it is not there and has no default, or has no value.
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

        Raises InvalidProblem: there is none, or more than one.
        """
        if len(self.lines) != 1:
            raise self.wrong(f"one line of data, {expected}", f"{len(self.lines)} lines")
        return self.lines[0]

    def real(self, line: Line, at: int, what: str, default: float | None = None) -> float:
        """Return the finite number at a place of a line.

        Parameters
        ----------
        line : Line
        at : int, counted from 0
        what : str, a name of the number for messages
        default : float, optional; without it a blank is refused
        """
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
            value = number(_BARE_EXPONENT.sub("e", word[: self.columns]))
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

    Raises InvalidProblem: no such file; a keyword or a parameter that is not known or not offered, by file and line;
    data before the first keyword; files that include each other.

    Parameters
    ----------
    path : path
    columns : read this many characters of each number, as CalculiX does; all of them by default
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
    data = read_bytes(path, EXPECTED)
    refuse_utf_16(path, data)
    text = data.removeprefix(codecs.BOM_UTF8).decode("latin-1")
    texts = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
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
            file = FilePath(line.file).parent / value.strip().strip('"')
            if not file.is_file():
                raise InvalidProblem(f"{line.place}: *INCLUDE: there is no file {file}")
            return file
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


class Effect(Enum):
    """The effect of a keyword on the model: it is read, has none, or is refused."""

    READ = "read"
    IDLE = "without effect"
    REFUSED = "refused"


# Where a card may stand: before the step, in it, or in both.
MODEL, STEP, ANYWHERE = "before *STEP", "between *STEP and *END STEP", ""


@dataclass(frozen=True)
class Keyword:
    """A keyword that decks may have, with its parameters, its place and its effect.

    Attributes
    ----------
    name : as it is written, in upper case
    effect : Effect
    why : why it is refused, or changes nothing
    where : where it may stand
    parameters : dict
        Names without blanks to what is offered: None is any value, ``"idle"`` changes nothing, ``"refused"``, or the
        values that are offered, apart by ``|``.
    names : dict, the same names as they are written
    any_parameter : parameters are ignored: what the keyword asks for changes nothing, whatever it is
    cures : dict, what to do about a parameter that is refused
    """

    name: str
    effect: Effect
    why: str = ""
    where: str = ANYWHERE
    parameters: dict[str, str | None] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    any_parameter: bool = False
    cures: dict[str, str] = field(default_factory=dict)

    def cure(self, key: str) -> str:
        """Return what to do about a parameter, after a semicolon."""
        told = self.cures.get(key.replace("-", ""))
        return f"; {told}" if told else ""


def squeezed(name: str) -> str:
    """Return a name in upper case without blanks, as both programs compare them."""
    return "".join(name.split()).upper()


def _read(name: str, where: str, *parameters: str, idle: str = "", refused: str = "", **cures: str) -> Keyword:
    """Return a keyword that is read; a parameter with values is written ``NAME=A|B``."""
    offered: dict[str, str | None] = {}
    for parameter in parameters:
        key, _, values = parameter.partition("=")
        offered[key] = values or None
    offered |= dict.fromkeys(filter(None, idle.split(", ")), "idle")
    offered |= dict.fromkeys(filter(None, refused.split(", ")), "refused")
    return Keyword(
        name,
        Effect.READ,
        where=where,
        parameters={squeezed(key): value for key, value in offered.items()},
        names={squeezed(key): key for key in offered},
        cures={key.replace("_", "").upper(): text for key, text in cures.items()},
    )


_SMALL = "displacements are small here; take it out to judge the small-displacement problem"

_READ = (
    _read("NODE", MODEL, "NSET", "SYSTEM=R", refused="INPUT"),
    _read("ELEMENT", MODEL, "TYPE", "ELSET"),
    _read("NSET", MODEL, "NSET", "GENERATE", "ELSET", "INSTANCE", idle="UNSORTED, INTERNAL"),
    _read("ELSET", MODEL, "ELSET", "GENERATE", "INSTANCE", idle="UNSORTED, INTERNAL"),
    _read("PART", MODEL, "NAME"),
    _read("END PART", MODEL),
    _read("ASSEMBLY", MODEL, "NAME"),
    _read("END ASSEMBLY", MODEL),
    _read("INSTANCE", MODEL, "NAME", "PART", refused="INSTANCE, LIBRARY"),
    _read("END INSTANCE", MODEL),
    _read("SURFACE", MODEL, "NAME", "TYPE=ELEMENT|NODE", idle="INTERNAL", refused="COMBINE, CROP",
          combine="state all faces below one *SURFACE",
          type="for a rigid surface take elements whose nodes are all held"),
    _read("MATERIAL", MODEL, "NAME"),
    _read("ELASTIC", MODEL, "TYPE=ISO|ISOTROPIC", refused="MODULI, DEPENDENCIES", type=ELASTIC),
    _read("DENSITY", MODEL, refused="DEPENDENCIES"),
    _read("SOLID SECTION", MODEL, "ELSET", "MATERIAL", idle="ORIENTATION, CONTROLS", refused="COMPOSITE, REF NODE"),
    _read("SPRING", MODEL, "ELSET", refused="NONLINEAR, ORIENTATION, DEPENDENCIES, RTOL"),
    _read("BOUNDARY", ANYWHERE, "OP=MOD|NEW", "AMPLITUDE", "TYPE=DISPLACEMENT", idle="LOAD CASE",
          refused="SUBMODEL, STEP, DATA SET, TIME DELAY, FIXED, USER, MASS FLOW", type=PROCEDURE),
    _read("CLOAD", STEP, "OP=MOD|NEW", "AMPLITUDE", idle="LOAD CASE",
          refused="FOLLOWER, OMEGA0, SECTOR, SUBMODEL, STEP, DATA SET, TIME DELAY, USER, CYCLIC MODE"),
    _read("DLOAD", STEP, "OP=MOD|NEW", "AMPLITUDE", idle="LOAD CASE",
          refused="SECTOR, TIME DELAY, FOLLOWER, CYCLIC MODE"),
    _read("DSLOAD", STEP, "OP=MOD|NEW", "AMPLITUDE", idle="LOAD CASE",
          refused="SUBMODEL, STEP, FOLLOWER, CONSTANT RESULTANT"),
    _read("AMPLITUDE", MODEL, "NAME", "TIME=STEP TIME|TOTAL TIME", "DEFINITION=TABULAR", "VALUE=RELATIVE",
          idle="SMOOTH", refused="USER, SHIFTX, SHIFTY, INPUT, TIMESHIFT"),
    _read("EQUATION", MODEL, refused="INPUT, REMOVE"),
    _read("TIE", MODEL, "NAME", "POSITION TOLERANCE", "ADJUST=NO|YES", "TYPE=SURFACE TO SURFACE|NODE TO SURFACE",
          refused="CYCLIC SYMMETRY, MULTISTAGE, FLUID PERIODIC, FLUID CYCLIC, NO ROTATION, NO THICKNESS"),
    _read("CONTACT PAIR", MODEL, "INTERACTION", "TYPE=NODE TO SURFACE|SURFACE TO SURFACE|MORTAR|LINMORTAR", "ADJUST",
          idle="SMALL SLIDING, NO THICKNESS, EXTENSION ZONE",
          refused="TIED, HCRIT, SUPPLEMENTARY CONSTRAINTS, SMOOTH, GEOMETRIC CORRECTION, MINIMUM DISTANCE",
          type="PGLINMORTAR, MASSLESS and IN-FACE contact have no counterpart here",
          tied="*TIE joins two surfaces"),
    _read("SURFACE INTERACTION", MODEL, "NAME", refused="USER, UNSYMM"),
    _read("SURFACE BEHAVIOR", MODEL, "PRESSURE-OVERCLOSURE=HARD|LINEAR", idle="PENALTY, DIRECT, AUGMENTED LAGRANGE",
          refused="NO SEPARATION",
          pressure_overclosure="EXPONENTIAL and TABULAR are not Signorini contact; in the place of TIED take *TIE",
          no_separation="contact does not pull; surfaces that stay together are joined by *TIE"),
    _read("FRICTION", MODEL, idle="SLIP TOLERANCE, ELASTIC SLIP",
          refused="ROUGH, TAUMAX, EXPONENTIAL DECAY, ANISOTROPIC, LAGRANGE, USER, DEPENDENCIES, SLIP DEPENDENT",
          rough="state a coefficient so large that nothing slips", lagrange="take it out: sticking is exact here"),
    _read("CLEARANCE", MODEL, "MASTER", "SLAVE", "VALUE", refused="CPSET, TABULAR, BOLT, SEARCH NSET"),
    _read("STEP", MODEL, "NLGEOM=NO|OFF", idle="INC, INCF, NAME, AMPLITUDE, UNSYMM, EXTRAPOLATION, CONVERT SDI",
          refused="PERTURBATION, THERMOMECHANICAL", nlgeom=_SMALL,
          perturbation="it keeps contact as it was before the step"),
    _read("STATIC", STEP, idle="SOLVER, DIRECT, TIME RESET, TOTAL TIME AT START, ELECTROMAGNETICS",
          refused="STABILIZE, RIKS, ADIABATIC, FULLY PLASTIC, FACTOR, ALLSDTOL, CONTINUE",
          stabilize="it adds forces that are none of the model's",
          riks="nothing snaps through at small displacements; take it out"),
    _read("END STEP", STEP),
)  # fmt: skip

# What CalculiX is run without.
PRINTED = "what is printed changes no answer"
_COURSE = "how increments are chosen and iterations end changes no converged answer"
_IDLE = {
    "HEADING": "words",
    **dict.fromkeys(
        ("NODE FILE", "EL FILE", "CONTACT FILE", "NODE PRINT", "EL PRINT", "CONTACT PRINT", "SECTION PRINT",
         "NODE OUTPUT", "ELEMENT OUTPUT", "CONTACT OUTPUT", "ENERGY OUTPUT", "INCREMENTATION OUTPUT", "OUTPUT",
         "ENERGY PRINT", "PREPRINT", "FILE FORMAT", "FILE OUTPUT", "PRINT", "MONITOR", "TIME POINTS", "RESTART",
         "NODE RESPONSE", "EL RESPONSE", "DIAGNOSTICS", "CONTACT CONTROLS OUTPUT", "FILTER"), PRINTED),
    **dict.fromkeys(("CONTROLS", "SOLUTION TECHNIQUE", "CONTACT CONTROLS", "SOLVER CONTROLS"), _COURSE),
    "EXPANSION": "no temperatures change",
    **dict.fromkeys(("CONDUCTIVITY", "SPECIFIC HEAT"), "no heat flows"),
    "DAMPING": "nothing moves in statics",
    "PHYSICAL CONSTANTS": "no heat is radiated",
    "ORIENTATION": "the materials are isotropic",
    "SECTION CONTROLS": "the elements are fully integrated",
}  # fmt: skip

KEYWORDS: dict[str, Keyword] = {
    squeezed(keyword.name): keyword
    for keyword in (
        *_READ,
        *(Keyword(name, Effect.IDLE, why, any_parameter=True) for name, why in _IDLE.items()),
        *(Keyword(name, Effect.REFUSED, why) for name, why in REFUSED.items()),
    )
}
