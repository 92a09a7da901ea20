"""The cases that come with the package, by name: those of the wheel, or of the checkout that this is installed from."""

from __future__ import annotations

import difflib
import tomllib
from dataclasses import dataclass
from pathlib import Path

SUFFIX = ".toml"


@dataclass(frozen=True)
class ShippedCase:
    """One case: its file, its name on the command line, and what its title and its text say."""

    file: Path
    title: str
    about: str = ""

    @property
    def name(self) -> str:
        """Return the file's name without its suffix."""
        return self.file.stem

    def has(self, word: str) -> bool:
        """Say whether a word stands in the name, the title or the text, whatever its case."""
        return word.casefold() in f"{self.name} {self.title} {self.about}".casefold()


def shipped_folder() -> Path | None:
    """Return the folder of the cases; None where the package has come without them."""
    package = Path(__file__).parents[1]
    checkout = package.parent
    places = [package / "cases", *([checkout / "cases"] if (checkout / "pyproject.toml").is_file() else [])]
    return next((folder for folder in places if folder.is_dir()), None)


def shipped_files() -> list[Path]:
    """Return the files of the cases, by name."""
    folder = shipped_folder()
    return [] if folder is None else sorted(folder.glob(f"*{SUFFIX}"))


def shipped_cases(words: tuple[str, ...] = ()) -> list[ShippedCase]:
    """Return the cases in whose name, title or text every one of some words stands.

    >>> [case.name for case in shipped_cases(("hertz", "sphere"))]
    ['cattaneo_mindlin_sphere', 'hertz_sphere']
    """
    found = []
    for file in shipped_files():
        data = tomllib.loads(file.read_text(encoding="utf-8"))
        case = ShippedCase(file, str(data.get("title", "")), " ".join(str(data.get("about", "")).split()))
        if all(case.has(word) for word in words):
            found.append(case)
    return found


def case_path(named: str | Path) -> Path:
    """Return the path of a case: a file that is there, else the shipped case of that name, with its suffix or without.

    >>> case_path("bar_wall").name, str(case_path("elsewhere/bar_wall.toml"))
    ('bar_wall.toml', 'elsewhere/bar_wall.toml')
    """
    path = Path(named)
    if path.name != str(named) or path.suffix not in ("", SUFFIX) or path.exists():
        return path
    return next((file for file in shipped_files() if file.stem == path.stem), path)


def first_case(name: str) -> str:
    """Return the text of the commented case that `contactqp init` writes to a file of that name."""
    text = (Path(__file__).parent / "first_case.toml").read_text(encoding="utf-8")
    return text.replace("{name}", name, 1)


def nearest_names(named: str | Path) -> list[str]:
    """Return the names of shipped cases that a name may mean."""
    return difflib.get_close_matches(Path(named).stem, [file.stem for file in shipped_files()], n=3)
