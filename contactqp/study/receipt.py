"""A receipt of `contactqp check`: what was judged, by which version, what came of it, and whether it still holds."""

from __future__ import annotations

import datetime
import hashlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from contactqp.errors import InvalidProblem
from contactqp.exchange.refusal import read_text, wrong
from contactqp.exchange.whole_file import write_whole
from contactqp.scene.scene import load_scene
from contactqp.scene.shipped import case_path
from contactqp.study.checking import check_answer
from contactqp.study.verdict import CheckOptions, Verdict

SCHEMA, SCHEMA_VERSION = "contactqp-receipt", 1
# Options that name files, which are hashed as well.
FILES = ("pressure_areas", "dof_map", "contact_map")
# What a verdict is compared by, and the factor by which a figure or a bound may grow with the version or the machine.
SAME = ("right", "proven")
GROWTH = 10.0
# Figures and bounds below this are rounding, however they compare.
ROUNDING = 1e-11


def write_receipt(file: str, problem: str, candidate: str, options: CheckOptions, verdict: Verdict) -> None:
    """Write the receipt of a verdict; paths in it are relative to its own folder.

    Raises
    ------
    InvalidProblem
        The problem or the candidate is standard input, or the file cannot be written.
    """
    if "-" in (problem, candidate):
        raise InvalidProblem("--receipt: expected files, whose hashes it holds, got standard input")
    found, problem = verdict.data(), str(case_path(problem))
    folder = Path(file).resolve().parent
    asked = {name: None if value is None else _relative(value, folder) if name in FILES else value
             for name, value in asdict(options).items()}  # fmt: skip
    named = [problem, candidate, *_meshes(problem), *(getattr(options, name) for name in FILES)]
    data = {
        "schema": SCHEMA,
        "schema_version": SCHEMA_VERSION,
        "contactqp": version("contactqp"),
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "problem": _relative(problem, folder),
        "candidate": _relative(candidate, folder),
        "options": asked,
        "sha256": {_relative(path, folder): digest for path, digest in _hashes(filter(None, named))},
        "verdict": {name: found.get(name) for name in (*SAME, "basis", "diagnosis", "failures", "notes")},
        "figures": found["certificate"] | _bounds(verdict),
    }
    text = json.dumps(data, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    write_whole(Path(file), lambda beside: _write(beside, text))


def _write(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8")


def _bounds(verdict: Verdict) -> dict[str, float]:
    names = ("energy_error", "force_error", "distance")
    found = {name: getattr(verdict.certificate, name, None) for name in names}
    return {name: float(value) for name, value in found.items() if value is not None and math.isfinite(value)}


def _relative(path: str, folder: Path) -> str:
    return Path(os.path.relpath(Path(path).resolve(), folder)).as_posix()


def _meshes(problem: str) -> list[str]:
    """Return the mesh files that a case file names."""
    if Path(problem).suffix != ".toml":
        return []
    scene = load_scene(problem)
    return [str(Path(problem).parent / part.mesh.file) for part in scene.meshed if part.mesh is not None]


def _hashes(paths: Iterator[str]) -> Iterator[tuple[str, str]]:
    """Yield every file, those of folders one by one, with its SHA-256."""
    for path in paths:
        files = (
            sorted(file for file in Path(path).rglob("*") if file.is_file()) if Path(path).is_dir() else [Path(path)]
        )
        for file in files:
            yield str(file), hashlib.sha256(file.read_bytes()).hexdigest()


@dataclass(frozen=True)
class Verified:
    """Whether a receipt still holds; `differences` says in words what does not."""

    file: str
    right: bool  # what the receipt says of the answer
    written_by: str  # the version
    differences: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Whether files and verdict are those of the receipt."""
        return not self.differences

    def data(self) -> dict[str, Any]:
        """Return the findings as plain data for JSON."""
        return {"receipt": self.file, "holds": self.holds, "right": self.right, "differences": list(self.differences)}


def verify(file: str) -> Verified:
    """Hash the files of a receipt and judge the answer again.

    Raises
    ------
    InvalidProblem
        The file is no receipt, or a file that it names is not there.
    ContactQPError
        The files cannot be judged any more.
    """
    data = _read(file)
    folder = Path(file).resolve().parent
    differences = [*_changed(data["sha256"], folder, file)]
    options: dict[str, Any] = {name: None if value is None else str(folder / value) if name in FILES else value
               for name, value in data["options"].items()}  # fmt: skip
    problem, candidate = (str(folder / data[name]) for name in ("problem", "candidate"))
    verdict = check_answer(problem, candidate, CheckOptions(**options))
    differences += _other_verdict(data, verdict)
    return Verified(file, bool(data["verdict"]["right"]), str(data["contactqp"]), tuple(differences))


def _read(file: str) -> Mapping[str, Any]:
    expected = "a receipt, as `contactqp check PROBLEM CANDIDATE --receipt FILE` writes"
    try:
        data = json.loads(read_text(file, expected))
        known = data["schema"] == SCHEMA and data["schema_version"] == SCHEMA_VERSION
        shapes = [isinstance(data[name], dict) for name in ("sha256", "options", "verdict", "figures")]
        shapes += [isinstance(data[name], str) for name in ("problem", "candidate", "contactqp")]
        shapes += [set(data["options"]) == set(asdict(CheckOptions())), {data["problem"], data["candidate"]} != {""}]
        shapes += [isinstance(value, int | float) for value in data["figures"].values()]
        known = known and all(shapes) and all(isinstance(data["verdict"][name], bool | None) for name in SAME)
    except (ValueError, KeyError, TypeError, AttributeError):
        known = False
    if not known:
        raise wrong(file, "content", expected, "something else")
    return dict(data)


def _changed(hashes: Mapping[str, str], folder: Path, receipt: str) -> Iterator[str]:
    for name, digest in hashes.items():
        if not (folder / name).is_file():
            raise wrong(receipt, "sha256", f"the file {name!r} beside the receipt", "none")
        ((_, found),) = _hashes(iter([str(folder / name)]))
        if found != digest:
            yield f"{name} has changed since the receipt was written"


def _other_verdict(data: Mapping[str, Any], verdict: Verdict) -> Iterator[str]:
    """Yield what another verdict, a figure or a bound that has grown say, in words."""
    found = verdict.data()
    words = {"right": ("right", "wrong"), "proven": ("proven", "not proven")}
    for name in SAME:
        before, now = data["verdict"][name], found.get(name)
        if before is not None and bool(before) != bool(now):
            yield f"the answer is {words[name][not now]}, and the receipt says {words[name][not before]}"
    figures = found["certificate"] | _bounds(verdict)
    for name, before in data["figures"].items():
        now = figures.get(name)
        if now is None or now > GROWTH * max(before, ROUNDING):
            shown = "not known" if now is None else f"{now:.3g}"
            yield f"{name.replace('_', ' ')} is {shown}, and the receipt says {before:.3g}"
