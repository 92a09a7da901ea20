"""Find the cases that come with the package by name, in the wheel or in the checkout of an editable installation."""

from __future__ import annotations

import difflib
import os
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

from contactqp.errors import SceneError

SUFFIX = ".toml"
# Words with this many first letters in common count as related, such as spherical and sphere.
LEAST_STEM = 4


@dataclass(frozen=True)
class ShippedCase:
    """A shipped case: its file, name, title, `about` and the text of the file."""

    file: Path
    title: str
    about: str = ""
    text: str = ""

    @property
    def name(self) -> str:
        """Return the file's name without its suffix."""
        return self.file.stem

    def has(self, word: str) -> bool:
        """Return whether a word of the name or the file begins with `word` or its stem (bouncing, bounces), in any
        case.

        Only beginnings of words match: ``ring`` does not match ``string``. A name with underscores matches one case.
        """
        if "_" in word:
            return self.name == word.casefold().removesuffix(SUFFIX)
        known = f" {self.name} {self.text}".casefold().replace("_", " ")
        return any(re.search(rf"\b{re.escape(one)}", known) for one in _stems(word.casefold()))


def _stems(word: str) -> set[str]:
    """Return a word, its singular, and the stem of its verb where that is long enough.

    >>> sorted(_stems("bouncing")), sorted(_stems("springs")), sorted(_stems("string"))
    (['bounc', 'bouncing'], ['spring', 'springs'], ['string'])
    """
    cut = (word.removesuffix(ending) for ending in ("ing", "ed", "es"))
    return {word, word.removesuffix("s"), *(stem for stem in cut if len(stem) >= LEAST_STEM)}


def shipped_folder() -> Path | None:
    """Return the folder of the cases, None where the package was installed without them."""
    package = Path(__file__).parents[1]
    checkout = package.parent
    places = [package / "cases", *([checkout / "cases"] if (checkout / "pyproject.toml").is_file() else [])]
    return next((folder for folder in places if folder.is_dir()), None)


def shipped_files() -> list[Path]:
    """Return the files of the cases, by name."""
    folder = shipped_folder()
    return [] if folder is None else sorted(folder.glob(f"*{SUFFIX}"))


def shipped_cases(words: tuple[str, ...] = ()) -> list[ShippedCase]:
    """Return the cases that contain every one of some words in their name or file.

    >>> [case.name for case in shipped_cases(("hertz", "spheres", "mindlin"))]
    ['cattaneo_mindlin_sphere']
    """
    return [case for case in _all_cases() if all(map(case.has, words))]


def nearest_cases(words: tuple[str, ...]) -> tuple[list[ShippedCase], int]:
    """Return the cases that contain most of some words, and that number of words; no case where it is 0."""
    every = _all_cases()
    counts = [sum(map(case.has, words)) for case in every]
    most = max(counts, default=0)
    return [case for case, count in zip(every, counts, strict=True) if count == most > 0], most


def _all_cases() -> list[ShippedCase]:
    return [_case(file) for file in shipped_files()]


def _case(file: Path) -> ShippedCase:
    text = file.read_text(encoding="utf-8")
    data = tomllib.loads(text)
    about = " ".join(str(data.get("about", "")).split())
    return ShippedCase(file, str(data.get("title", "")), about, " ".join(text.split()))


def case_path(named: str | Path) -> Path:
    """Return the path of a case, an existing file or else the shipped case of that name, with or without suffix.

    >>> case_path("bar_wall").name, str(case_path("elsewhere/bar_wall.toml"))
    ('bar_wall.toml', 'elsewhere/bar_wall.toml')
    """
    path = Path(named)
    if path.name != str(named) or path.suffix not in ("", SUFFIX) or os.path.exists(path):
        return path
    return next((file for file in shipped_files() if file.stem == path.stem), path)


def shipped_case(name: str) -> ShippedCase:
    """Return the case of that name.

    Raises SceneError: there is none; the message names the nearest.
    """
    for file in shipped_files():
        if file.stem == name.removesuffix(SUFFIX):
            return _case(file)
    near = nearest_names(name)
    cure = (
        f"nearest: {', '.join(near)}" if near else "`contactqp cases` lists all, `contactqp cases WORD` those of a word"
    )
    raise SceneError(f"{name}: no case that comes with contactqp is called so; {cure}")


def first_case(name: str) -> str:
    """Return the text of the commented case that `contactqp init` writes to a file of that name."""
    text = (Path(__file__).parent / "first_case.toml").read_text(encoding="utf-8")
    return text.replace("{name}", name, 1)


def nearest_files(named: Path) -> list[str]:
    """Return up to three names of case files in the folder of a missing one that resemble its name."""
    there = {file.stem: str(file) for file in sorted(named.parent.glob(f"*{SUFFIX}"))}
    return [there[stem] for stem in difflib.get_close_matches(named.stem, there, n=3)]


def nearest_names(named: str | Path) -> list[str]:
    """Return the names of shipped cases that resemble a name."""
    return difflib.get_close_matches(Path(named).stem, [file.stem for file in shipped_files()], n=3)


def nearest_words(words: tuple[str, ...]) -> list[str]:
    """Return the words of names and titles that resemble words which no case contains.

    >>> nearest_words(("spherical", "cantilver"))
    ['sphere', 'cantilever']
    """
    known = {
        one: None for case in _all_cases() for one in re.findall(r"[^\W\d_]+", f"{case.name}_{case.title}".casefold())
    }
    near = []
    for word in map(str.casefold, words):
        stem = [one for one in known if len(one) >= LEAST_STEM and one.startswith(word[:LEAST_STEM])]
        near += difflib.get_close_matches(word, stem or known, n=1, cutoff=0 if stem else 0.6)
    return [*dict.fromkeys(near)]
