"""What messages, docstrings, README and pages tell people to type can be typed: commands exist, packages install."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import click
import pytest

from contactqp.analysis.many_loads import FRAMEWORKS
from contactqp.cli import command
from tests.docs.blocks import ROOT, pages
from tests.docs.commands import A_CASE, given_files, inline_commands, typed, unused

PACKAGE = ROOT / "contactqp"
HINT = re.compile(r"\bcontactqp ((?:[a-z]+)(?: +[^\s`'\";,)]+)*)")
INSTALLED = re.compile(r"pip install (?:--upgrade )?([A-Za-z][A-Za-z0-9-]*)")
EXTRAS = re.compile(r"pip install (?:--editable )?'\.\[([a-z,]+)\]'")
# Without one of these a file hints at nothing; also where a string goes on in the next line.
SUSPECTED = re.compile(r"contactqp[\s\"']|pip[\s\"']")
# Words that follow the name of the tool in a sentence.
NO_COMMANDS = {"and", "are", "as", "exact", "have", "import", "is", "on", "problem", "raises"}


@cache
def told() -> list[tuple[str, str]]:
    """Where something is told, and the words: string constants of the package, README, pages."""
    found = []
    for file in sorted(PACKAGE.rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        if not SUSPECTED.search(text):
            continue
        constants = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant)]
        place = file.relative_to(ROOT)
        found += [(f"{place}:{node.lineno}", node.value) for node in constants if isinstance(node.value, str)]
    return found + [(page, (ROOT / page).read_text(encoding="utf-8")) for page in pages()]


def wrong_hints(places: list[tuple[str, str]]) -> list[str]:
    """Hints at commands or options that there are not."""
    wrong = []
    for place, text in places:
        for hint in HINT.finditer(text):
            name, *rest = hint[1].split()
            known = command.commands.get(name)
            if known is None:
                if name not in NO_COMMANDS:
                    wrong.append(f"{place}: {hint[0]}")
                continue
            options = {option for part in known.params for option in part.opts} | {"--help", "-h"}
            for word in rest:
                option = word.partition("=")[0].rstrip(".:]")
                if option.startswith("--") and option not in options:
                    wrong.append(f"{place}: {hint[0]}")
    return wrong


def test_commands_that_are_hinted_at_exist() -> None:
    places = told()
    assert sum(len(HINT.findall(text)) for _, text in places) > 100
    assert wrong_hints(places) == []


@pytest.mark.parametrize("hint", ["`contactqp solve FILE`", "type contactqp run CASE --methods all"])
def test_a_hint_at_what_is_not_there_is_found(hint: str) -> None:
    assert wrong_hints([("here", hint)]) == [f"here: {hint.strip('`').removeprefix('type ')}"]


def test_every_command_is_a_click_command_with_a_help() -> None:
    assert len(command.commands) >= 12
    for name, known in command.commands.items():
        assert isinstance(known, click.Command)
        assert known.help, name


def test_extras_are_told_with_where_they_are() -> None:
    """The package is in no index: 'pip install contactqp[exact]' finds nothing."""
    words = told()
    assert sum("pip install" in text for _, text in words) > 10
    assert [place for place, text in words if re.search(r"pip install '?contactqp", text)] == []


def test_every_command_in_the_text_is_run_or_listed_with_why_not() -> None:
    commands = inline_commands(told())
    assert len(commands) > 150
    assert [typed(command) for command in commands].count(None) < 40
    assert unused(commands) == []


@pytest.mark.parametrize(
    "words", ["contactqp run SOMETHING", "contactqp gallery DIR [--list]", "contactqp explain X.toml"]
)
def test_a_command_in_the_text_that_nobody_can_type_is_found(words: str) -> None:
    (command,) = inline_commands([("here", f"Type `{words}`.")])
    with pytest.raises(LookupError, match="neither in TYPED nor in NOT_RUN"):
        typed(command)


def _requirements() -> dict[str, str]:
    """What pyproject requires, with and without extras, by name."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    every = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    return {re.split(r"[\[><=; ]", one)[0]: one for one in every if not one.startswith("contactqp[")}


def _resolves(*requirements: str | Path) -> subprocess.CompletedProcess[str]:
    """Ask pip what it would install, which downloads little and installs nothing."""
    asked = (
        sys.executable,
        "-m",
        "pip",
        "install",
        "--dry-run",
        "--no-deps",
        "--ignore-installed",
        "--report",
        os.devnull,
    )
    return _ended(*asked, *requirements)


@pytest.mark.slow
def test_packages_that_are_hinted_at_can_be_installed() -> None:
    """By pip, without installing them. Those of which there is no wheel for this machine have a source."""
    names = {name for _, text in told() for name in INSTALLED.findall(text)} | set(FRAMEWORKS)
    assert len(names) > 20
    required = _requirements()
    done = _resolves(*(required[name] for name in sorted(names & required.keys())))
    assert done.returncode == 0, done.stderr[-2000:]
    with ThreadPoolExecutor(2) as pool:
        others = dict(zip(names - required.keys(), pool.map(_resolves, names - required.keys()), strict=True))
    assert [name for name, done in others.items() if "No matching distribution" in done.stderr] == []


@pytest.mark.slow
def test_extras_are_there_in_the_checkout_and_in_the_wheel(from_wheel: tuple[Path, Path]) -> None:
    """Every group of extras that is told is known to pip as typed, and what the extras require is there."""
    groups = sorted(
        {group for _, text in told() for group in EXTRAS.findall(text)} | {"fast", "ansys", "jax,torch,dask"}
    )
    (wheel,) = (from_wheel[0].parents[1] / "dist").glob("contactqp-*.whl")
    known = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert {name for group in groups for name in group.split(",")} <= set(known)
    with zipfile.ZipFile(wheel) as packed:
        (metadata,) = (name for name in packed.namelist() if name.endswith(".dist-info/METADATA"))
        provided = re.findall(r"^Provides-Extra: (.+)$", packed.read(metadata).decode(), re.MULTILINE)
    assert set(provided) == set(known)
    for source in (ROOT, wheel):
        done = _resolves(f"{source}[{','.join(provided)}]")
        assert done.returncode == 0, done.stderr[-2000:]
    done = _resolves(*_requirements().values())
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.fixture(scope="module")
def from_wheel(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A new environment with a built wheel and what tests need, and a folder with everything but the package."""
    place = tmp_path_factory.mktemp("wheel")
    _call(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", place / "dist", ROOT)
    _call(sys.executable, "-m", "venv", place / "new")
    (wheel,) = (place / "dist").glob("contactqp-*.whl")
    _call(place / "new" / "bin" / "python", "-m", "pip", "install", "--quiet", f"{wheel}[test]")
    folder = place / "checkout"
    folder.mkdir()
    for name in ("README.md", "pyproject.toml", "CITATION.cff", "CONTRIBUTING.md"):
        shutil.copy(ROOT / name, folder)
    for name in ("docs", "tests", "cases", "benchmarks"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    return place / "new" / "bin", folder


def _ended(*command_line: str | Path, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    words = [str(word) for word in command_line]
    return subprocess.run(words, capture_output=True, text=True, cwd=folder, env=clean)


def _call(*command_line: str | Path, folder: Path = ROOT) -> str:
    done = _ended(*command_line, folder=folder)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    return done.stdout


@pytest.mark.slow
def test_readme_and_pages_run_from_a_built_wheel(from_wheel: tuple[Path, Path]) -> None:
    """Every block and every command of them, without the package's source beside."""
    programs, folder = from_wheel
    where = _call(programs / "python", "-c", "import contactqp; print(contactqp.__file__)", folder=folder)
    assert str(programs.parent) in where
    modules = [f"tests/docs/test_{name}.py" for name in ("blocks", "readme", "recipes", "notebook")]
    printed = _call(programs / "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", *modules, folder=folder)
    assert int(re.findall(r"(\d+) passed", printed)[0]) > 40


@pytest.mark.slow
def test_commands_in_the_text_run_from_a_built_wheel(from_wheel: tuple[Path, Path], tmp_path: Path) -> None:
    """Each in a folder of its own with the files that the pages show; the cases by name all in one.

    All cases are found; one in four is solved, as `tests/scene/test_cases.py` does with each of the checkout.
    """
    commands = inline_commands(told())
    cases = sorted(command.split()[-1] for command in commands if A_CASE.fullmatch(command))
    assert len(cases) > 60
    found = json.loads(_call(from_wheel[0] / "contactqp", "cases", "--json", folder=tmp_path))
    assert {case["name"] for case in found} >= set(cases)
    lines = {line for command in commands if not A_CASE.fullmatch(command) and (line := typed(command))}
    files = given_files()

    def run(numbered: tuple[int, str]) -> str:
        folder = tmp_path / str(numbered[0])
        for name, text in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
        done = _ended("sh", "-c", f"PATH='{from_wheel[0]}':$PATH; {numbered[1]}", folder=folder)
        return f"{numbered[1]}\n{done.stdout[-500:]}{done.stderr[-500:]}" if done.returncode else ""

    with ThreadPoolExecutor(2) as pool:
        failed = list(pool.map(run, enumerate(sorted(lines | {f"contactqp run {' '.join(cases[::4])}"}))))
    assert [one for one in failed if one] == []


@pytest.fixture(scope="module")
def bare(from_wheel: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs of a new environment with the wheel and what it requires, without extras."""
    place = tmp_path_factory.mktemp("bare")
    _call(sys.executable, "-m", "venv", place / "new")
    (wheel,) = (from_wheel[0].parents[1] / "dist").glob("contactqp-*.whl")
    _call(place / "new" / "bin" / "python", "-m", "pip", "install", "--quiet", wheel)
    return place / "new" / "bin"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["run", "bar_wall", "--plot", "bar.png"], "pip install matplotlib"),
        (["run", "bar_wall", "--vtu", "bar.vtu"], "pip install meshlane"),
        (["run", "bar_wall", "--method", "piqp"], "pip install piqp"),
        (["run", "bar_wall", "--method", "proxqp"], "pip install proxsuite"),
        (["run", "bar_wall", "--method", "daqp"], "pip install daqp"),
        (["run", "bar_wall", "--method", "qpalm"], "pip install qpalm"),
        (["oracle", "bar_wall"], "pip install python-flint"),
        (["run", "one.hdf5"], "pip install h5py"),
    ],
)
def test_what_is_missing_is_had_by_the_command_that_is_told(
    bare: Path, tmp_path: Path, words: list[str], hint: str
) -> None:
    """In an environment without extras: exit 3 with the command, and after that command another answer."""
    (tmp_path / "one.hdf5").write_bytes(b"\x89HDF\r\n\x1a\n")
    told = _ended(bare / "contactqp", *words, folder=tmp_path)
    assert told.returncode == 3, told.stdout + told.stderr
    assert told.stderr.strip().endswith(hint)
    _call(bare / "python", "-m", *hint.split(), "--quiet")
    again = _ended(bare / "contactqp", *words, folder=tmp_path)
    assert hint not in again.stderr
    assert again.returncode == (2 if "one.hdf5" in words else 0)  # a file of that format, with nothing in it


@pytest.mark.slow
def test_a_report_without_its_packages_tells_them_and_has_its_page_with_them(bare: Path, tmp_path: Path) -> None:
    command_line = (bare / "contactqp", "report", "bar_wall", "--fresh")
    told = _ended(*command_line, folder=tmp_path).stderr
    hint = re.findall(r"no page, as .* not installed: pip install (.*)", told)
    assert len(hint) == 1, told
    assert not (tmp_path / "report" / "index.html").exists()
    _call(bare / "python", "-m", "pip", "install", "--quiet", *hint[0].split())
    _call(*command_line, folder=tmp_path)
    assert (tmp_path / "report" / "index.html").exists()


@pytest.mark.slow
@pytest.mark.parametrize("words", [["cases"], ["methods"], ["run", "bar_wall"], ["explain", "bar_wall"], ["schema"]])
def test_the_console_script_works_in_an_empty_folder(
    from_wheel: tuple[Path, Path], words: list[str], tmp_path: Path
) -> None:
    assert _call(from_wheel[0] / "contactqp", *words, folder=tmp_path)


def test_the_table_of_extras_has_all_of_them_with_their_packages() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    rows = [line.split("|") for line in (ROOT / "docs" / "tour.md").read_text(encoding="utf-8").splitlines()]
    table = {name: row[2] for row in rows if len(row) == 5 for name in re.findall(r"`([a-z]+)`", row[1])}
    assert set(table) == set(extras)
    for extra in set(extras) - {"all", "test", "browser", "develop", "docs"}:
        needed = {re.split(r"[><=; ]", requirement)[0] for requirement in extras[extra]}
        assert needed == {word for word in re.findall(r"[\w-]+", table[extra]) if word in needed}, extra
