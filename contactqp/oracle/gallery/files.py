"""The gallery as folders of JSON and Matrix Market files, for codes in any language.

index.json              every problem: name, kind, difficulty, folder, sizes, what is unique, source
two-bars/problem.json   stiffness.mtx, load.mtx, ...: see `contactqp.exchange.problem_folder`
two-bars/answer.json    the exact answer in doubles and, under "exact", as fractions
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from contactqp.errors import InvalidProblem
from contactqp.exchange.problem_folder import write_problem
from contactqp.oracle.gallery.problem import GalleryProblem

FORMAT, VERSION, INDEX = "contactqp gallery", 1, "index.json"
PARTS = ("displacement", "normal_force", "friction_force", "tie_force", "gap")
# What the problem.json of a problem says beside its data.
ABOUT = ("name", "kind", "difficulty", "unique_displacement", "unique_forces", "description", "formula", "source")


def write_gallery(
    folder: str | Path,
    problems: Sequence[GalleryProblem],
    progress: Callable[[GalleryProblem], None] | None = None,
) -> Path:
    """Write problems and their exact answers to a folder that is new or empty: all of them, or nothing.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InvalidProblem
        Something is in the folder, it is none, nothing is to be written, or the file system refuses.
    """
    root = Path(folder)
    if not problems:
        raise InvalidProblem(f"{folder}: no problem of the gallery is chosen; expected at least one")
    _refuse_taken(root)
    # An empty folder is filled and not replaced: it may be a link, a mount, or where the user stands.
    there = root.is_dir()
    beside = root / f".{os.getpid()}" if there else root.absolute().with_name(f".{root.absolute().name}.{os.getpid()}")
    try:
        beside.mkdir()
        for known in problems:
            _write_one(beside / known.name, known)
            if progress is not None:
                progress(known)
        index = {
            "format": FORMAT,
            "version": VERSION,
            "contactqp": version("contactqp"),
            "problems": [summary(known) for known in problems],
        }
        (beside / INDEX).write_text(json.dumps(index, indent=1) + "\n", encoding="utf-8")
        if not there:
            beside.rename(root)
        else:
            _refuse_taken(root, but=beside.name)
            for part in sorted(beside.iterdir(), key=lambda part: (part.name == INDEX, part.name)):
                part.rename(root / part.name)
    except OSError as error:
        raise InvalidProblem(f"{folder}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return root


def summary(known: GalleryProblem) -> dict[str, Any]:
    """What a list of problems says of one."""
    data = known.data
    return {
        "name": known.name,
        "kind": known.kind,
        "difficulty": known.difficulty,
        "folder": known.name,
        "unknowns": data.unknowns,
        "contacts": data.contacts,
        "directions_of_slip": data.directions,
        "ties": len(data.tie),
        "unique_displacement": known.unique_displacement,
        "unique_forces": known.unique_forces,
        "description": known.description,
        "formula": known.formula,
        "source": known.source,
    }


def _write_one(folder: Path, known: GalleryProblem) -> None:
    exact: dict[str, Any] = {part: getattr(known.exact, part) for part in PARTS if getattr(known.exact, part)}
    answer = {part: getattr(known, part) for part in PARTS}
    about = {key: value for key, value in summary(known).items() if key in ABOUT}
    rounded = known.data.rounded()
    if rounded:
        # The answer belongs to these fractions; files hold the nearest doubles.
        about["exact_data"] = {name: [str(x) for x in getattr(known.data, name)] for name in rounded}
        about["rounding"] = float(known.rounding)
    write_problem(folder, known.problem, answer | {"contact_status": known.exact.contact_status, "exact": exact}, about)


def _refuse_taken(root: Path, but: str = "") -> None:
    if root.exists() and not root.is_dir():
        raise InvalidProblem(f"{root}: expected a folder, this is a file")
    if root.is_dir() and (first := next((one for one in sorted(root.iterdir()) if one.name != but), None)):
        raise InvalidProblem(f"{root}: expected a new or an empty folder, {first.name!r} is in it")
    if not root.absolute().parent.is_dir():
        raise InvalidProblem(f"{root}: there is no folder {str(root.absolute().parent)!r}")
