"""Imports point one way, no files import in a circle, and a scene brings in only what it needs."""

from __future__ import annotations

import ast
import pathlib
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from types import FrameType

import pytest

import contactqp as cq
from tests.docs.test_docstrings import MANY, arguments, outline, public_functions, unnamed_arguments

ROOT = pathlib.Path(__file__).parent.parent
PACKAGE = ROOT / "contactqp"
TYPES = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n"
# Imports that break the rules, as they might be written; each is put into linalg/factors.py of a small package.
UPWARDS = {
    "at the top": "from contactqp.study import rows\n",
    "for types": TYPES + "    from contactqp.study import rows\n",
    "inside a function": "def iterate():\n    import contactqp.study.rows\n",
    "of the package": "import contactqp\n",
}
IN_A_CIRCLE = {
    "at the top": "from contactqp.linalg.iteration import step\n",
    "for types": TYPES + "    from contactqp.linalg.iteration import step\n",
    "inside a function": "def factorise():\n    from contactqp.linalg import iteration\n",
}


def imported(path: pathlib.Path, modules: set[str]) -> set[str]:
    """Return the modules of the package that a file imports anywhere in it: for types and inside functions too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: a relative import, which nothing here follows"
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= (whole & modules) or {str(node.module)}
    return found & modules


def files_by_module(package: pathlib.Path) -> dict[str, pathlib.Path]:
    """Return the files of a package by their dotted names."""
    names = {file: ".".join(file.relative_to(package.parent).with_suffix("").parts) for file in package.rglob("*.py")}
    return {name.removesuffix(".__init__"): file for file, name in names.items()}


def circle(package: pathlib.Path) -> list[str]:
    """Return the modules of one circle of imports, the first one again at its end; nothing where there is none."""
    files = files_by_module(package)
    try:
        TopologicalSorter({name: imported(file, set(files)) - {name} for name, file in files.items()}).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def lint(folder: pathlib.Path) -> subprocess.CompletedProcess[str]:
    """Run import-linter with this project's contracts on the package `contactqp` in a folder."""
    code = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    command = [sys.executable, "-c", code, "--no-cache", "--config", str(ROOT / "pyproject.toml")]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def rooms(tmp_path: pathlib.Path) -> pathlib.Path:
    """A package with all rooms of ours, next to empty, whose `__init__` names what is above for types as ours does."""
    package = tmp_path / "contactqp"
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    for room in contracts[0]["layers"]:
        (package / room).mkdir(parents=True)
        (package / room / "__init__.py").touch()
    for name in ("__main__", "errors", "testing"):
        shutil.rmtree(package / name)
        (package / f"{name}.py").touch()
    (package / "__init__.py").write_text(UPWARDS["for types"])
    (package / "study" / "rows.py").write_text("from contactqp.linalg import iteration\n")
    (package / "linalg" / "factors.py").touch()
    (package / "linalg" / "iteration.py").write_text("from contactqp.linalg import factors\n\n\ndef step(): ...\n")
    return package


def test_imports_point_one_way() -> None:
    done = lint(ROOT)
    assert done.returncode == 0, done.stdout


def test_the_contracts_hold_of_rooms_that_keep_them(rooms: pathlib.Path) -> None:
    done = lint(rooms.parent)
    assert done.returncode == 0, done.stdout + done.stderr
    assert circle(rooms) == []


@pytest.mark.sampled(4)
@pytest.mark.parametrize("how", UPWARDS)
def test_an_import_from_above_is_refused(rooms: pathlib.Path, how: str) -> None:
    (rooms / "linalg" / "factors.py").write_text(UPWARDS[how])
    done = lint(rooms.parent)
    assert done.returncode == 1
    assert "contactqp.linalg is not allowed to import contactqp.study" in " ".join(done.stdout.split())


@pytest.mark.sampled(3)
@pytest.mark.parametrize("how", IN_A_CIRCLE)
def test_a_circle_of_neighbours_is_refused(rooms: pathlib.Path, how: str) -> None:
    (rooms / "linalg" / "factors.py").write_text(IN_A_CIRCLE[how])
    assert "No cycles are allowed in contactqp.linalg" in lint(rooms.parent).stdout
    assert set(circle(rooms)) == {"contactqp.linalg.factors", "contactqp.linalg.iteration"}


def test_a_module_without_a_room_is_refused(rooms: pathlib.Path) -> None:
    (rooms / "helpers.py").touch()
    done = lint(rooms.parent)
    assert done.returncode == 1
    assert "helpers" in done.stdout


@pytest.mark.slow
def test_no_files_import_in_a_circle() -> None:
    assert circle(PACKAGE) == []


def test_at_the_top_of_the_package_lie_four_modules() -> None:
    assert {file.stem for file in PACKAGE.glob("*.py")} == {"__init__", "__main__", "errors", "testing"}


# A file is a chapter that one reads at once; imports are at its head, functions fit on a page.
FILES, LINES_OF_A_FILE, LINES_OF_A_FUNCTION, PART_OF_IMPORTS = 330, 500, 60, 0.06


def lines_of(node: ast.AST, body: list[ast.stmt]) -> int:
    """Return the lines of a function's body without its docstring, or of an import statement."""
    if body and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
        body = body[1:]
    first, last = (body[0], body[-1]) if body else (node, node)
    return int(last.end_lineno - first.lineno + 1) if body or isinstance(node, ast.Import | ast.ImportFrom) else 0


def statements(node: ast.AST) -> Iterator[ast.stmt]:
    """Yield the statements of a file at any depth, without their expressions, of which there are ten times as many."""
    for part in ("body", "orelse", "finalbody", "handlers", "cases"):
        for one in getattr(node, part, ()):
            if isinstance(one, ast.stmt):
                yield one
            yield from statements(one)


@dataclass(frozen=True)
class Package:
    """All files of the package, parsed once for all tests: lines, functions with theirs, and what has docstrings."""

    lines: dict[str, int]
    functions: list[tuple[str, int]]
    imports: int
    outlines: dict[str, ast.Module]


@cache
def parsed() -> Package:
    """Return the files of the package; of one tree at a time, as all of them are a hundred thousand statements."""
    lines, functions, imports, outlines = {}, [], 0, {}
    for path in PACKAGE.rglob("*.py"):
        file, text = str(path.relative_to(PACKAGE)), path.read_text("utf-8")
        tree, lines[file] = ast.parse(text), text.count("\n")
        for node in statements(tree):
            if isinstance(node, ast.FunctionDef):
                functions.append((f"{file}: {node.name}", lines_of(node, node.body)))
            elif isinstance(node, ast.Import | ast.ImportFrom):
                imports += lines_of(node, [])
        outlines[file] = outline(tree)
    return Package(lines, functions, imports, outlines)


def test_functions_with_many_arguments_name_each_of_them() -> None:
    outlines = parsed().outlines
    functions = [one for tree in outlines.values() for one, owner in public_functions(tree)]
    assert sum(len(arguments(one, False)) >= MANY for one in functions) > 300
    assert unnamed_arguments(outlines) == []


def test_files_and_functions_stay_short() -> None:
    lines, functions, imports = parsed().lines, parsed().functions, parsed().imports
    assert 200 < len(lines) <= FILES
    assert [file for file, count in lines.items() if count > LINES_OF_A_FILE] == []
    assert len(functions) > 3000
    assert [name for name, count in functions if count > LINES_OF_A_FUNCTION] == []
    assert 0.03 < imports / sum(lines.values()) <= PART_OF_IMPORTS


def test_errors_import_nothing_of_the_package() -> None:
    assert imported(PACKAGE / "errors.py", set(files_by_module(PACKAGE))) == set()


@pytest.mark.slow
def test_the_certificate_imports_no_method() -> None:
    code = (
        "import sys, contactqp.certificate.certificate; print([m for m in sys.modules if "
        "m.startswith('contactqp.solving.methods')])"
    )
    assert _run(code) == "[]"


OPTIONAL = (
    "cvxpy",
    "osqp",
    "clarabel",
    "qpsolvers",
    "matplotlib",
    "skfem",
    "piqp",
    "daqp",
    "highspy",
    "scs",
    "pyamg",
    "h5py",
)


def test_importing_the_package_imports_nothing_optional() -> None:
    modules = f"[m for m in {(*OPTIONAL, 'scipy.linalg', 'pydantic', 'click', 'rich')} if m in sys.modules]"
    assert _run(f"import sys, contactqp; print({modules})") == "[]"


@pytest.mark.slow
def test_solving_by_our_own_method_imports_no_backend() -> None:
    modules = f"[m for m in {OPTIONAL} if m in sys.modules]"
    code = (
        "import sys, contactqp as cq; "
        "cq.solve(cq.ContactProblem(stiffness=[[2.0]], load=[1.0], normal=[[1.0]], gap=[0.1])); "
        f"print({modules})"
    )
    assert _run(code) == "[]"


@pytest.mark.slow
def test_a_load_path_imports_nothing_of_motions() -> None:
    code = "import sys, contactqp.analysis.load_path; print([m for m in sys.modules if 'analysis.motion' in m])"
    assert _run(code) == "[]"


def test_every_pip_command_names_packages_that_pip_finds() -> None:
    """contactqp itself is not published: what is told to install is a checkout or another package."""
    files = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "contactqp").rglob("*.py")]
    commands = [found for file in files for found in re.findall(r"pip install [^`&\n]*", file.read_text("utf-8"))]
    assert len(commands) > 10
    assert [command for command in commands if re.search(r"(?<![/.\w])contactqp\b", command)] == []


@pytest.mark.slow
def test_public_names_are_all_there_and_methods_is_a_function() -> None:
    code = (
        "import contactqp as cq, contactqp.solving.methods, types; "
        "print(len(cq.methods()) > 5, type(cq.methods) is types.FunctionType, "
        "all(getattr(cq, name) is not None for name in cq.__all__))"
    )
    assert _run(code) == "True True True"


def _run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


# Classes of displacements with forces: the answer and those that show the one they hold, points of a search, errors and
# distances as one number each, and what is drawn of bodies, surfaces and histories. All others hold an answer.
WITH_DISPLACEMENT_AND_FORCE = 14


def classes_with_displacement_and_force(source: str) -> list[str]:
    """Return the classes that have a field `displacement` and one of forces, flags aside."""
    found: list[str] = []
    if not re.search(r"^\s+displacement\s*:", source, re.MULTILINE):  # most files, which need not be parsed
        return found
    for node in (node for node in statements(ast.parse(source)) if isinstance(node, ast.ClassDef)):
        fields = [
            part for part in node.body if isinstance(part, ast.AnnAssign) and ast.unparse(part.annotation) != "bool"
        ]
        names = {ast.unparse(part.target) for part in fields}
        if "displacement" in names and any(re.search(r"(^|_)forces?$", name) for name in names):
            found.append(node.name)
    return found


def test_answers_are_held_and_their_fields_not_repeated() -> None:
    again = "class Again:\n    displacement: Vector\n    tie_force: Vector\n"
    assert classes_with_displacement_and_force(again) == ["Again"]
    assert classes_with_displacement_and_force(again.replace("tie_force: Vector", "one_force: bool")) == []
    found = [name for file in PACKAGE.rglob("*.py") for name in classes_with_displacement_and_force(file.read_text())]
    assert 0 < len(found) <= WITH_DISPLACEMENT_AND_FORCE, sorted(found)


# Files that a problem of two unknowns may enter, and moves between them: a reader follows each of them.
PATHS = {"solve": (15, 135), "certify": (12, 104), "friction": (22, 219)}


def path_length(call: Callable[[], object]) -> tuple[int, int]:
    """Return how many files of the package a call enters, and how often the next function lies in another file."""
    files, moves, last = set(), 0, ""

    def seen(frame: FrameType, event: str, _: object) -> None:
        nonlocal moves, last
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(str(PACKAGE)):
            files.add(name)
            moves += name != last
            last = name

    sys.setprofile(seen)
    try:
        call()
    finally:
        sys.setprofile(None)
    return len(files), moves


@pytest.mark.parametrize("name", PATHS)
def test_a_small_problem_takes_a_short_path_through_the_package(name: str) -> None:
    rubbing = {"tangent": [[1.0, 0.0]], "friction": 0.3} if name == "friction" else {}
    bars = dict(stiffness=[[3.0, 1.0], [1.0, 2.0]], load=[1.0, -3.0], normal=[[0.0, -1.0]], gap=[0.5])
    known = cq.solve(cq.ContactProblem(**bars, **rubbing))

    def call() -> object:
        problem = cq.ContactProblem(**bars, **rubbing)
        if name == "certify":
            return cq.certify(problem, displacement=known.displacement, normal_force=known.normal_force)
        return cq.solve(problem)

    call()  # what is imported and cached at first is no part of it
    files, moves = path_length(call)
    assert 0 < files <= PATHS[name][0]
    assert 0 < moves <= PATHS[name][1]
