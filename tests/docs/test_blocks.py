"""Every block of code in README.md and under docs/ runs and prints what stands behind it, or is listed with why not."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from qpsolvers.solvers import solve_function

from contactqp.analysis.motion.schemes import SCHEMES
from contactqp.distributed.ranks import RECIPE
from contactqp.exchange import answer_files, matrix_files
from contactqp.solving import methods
from contactqp.solving.friction.algorithms import ALGORITHMS
from tests.block_registry import registered_blocks
from tests.docs.blocks import Block, blocks, pages
from tests.docs.running import PageRun, same_lines

# Pages that another test runs, all blocks of them.
RUN_ELSEWHERE = {
    "README.md": "tests/docs/test_readme.py; its first command by whoever wants the report, its second by .ci/run",
    "docs/recipes.md": "tests/docs/test_recipes.py",
    "docs/report.md": "tests/study/test_claims.py, on a report of a few cases",
}
# Pages whose blocks take seconds.
LONG = (
    "docs/constrained_energy.md",
    *(f"docs/guide/{name}.md" for name in ("bodies", "derivatives", "friction", "large_deformation", "load_cases")),
)
GOES_ON = "mpiexec -n 4 python -m contactqp run case.toml --engine petsc --checkpoint steps"
# A block by its page and first line, a command by its line: why it is not run here.
NOT_RUN = {
    "docs/guide/testing.md: import pytest": "tests/oracle/test_pytest_plugin.py runs it, with a my_code",
    "docs/guide/testing.md: E       AssertionError: bar-and-wall: the forces are not the exact ones (rtol 1e-09)": (
        "tests/oracle/test_pytest_plugin.py compares it"
    ),
    'docs/command_line.md: eval "$(_CONTACTQP_COMPLETE=bash_source contactqp)"': "tests/cli/test_completing.py",
    "sphinx-build -W -n --keep-going -q docs build/docs": ".ci/run does",
    "contactqp crosscheck model.inp": "any deck",
    "contactqp crosscheck squares.inp --error-tolerance 1e-3": (
        "CalculiX may not be installed; tests/oracle/test_crosscheck_calculix.py runs it"
    ),
    "docs/guide/decks.md: squares.inp: WRONG by CalculiX 2.20 (squares.ccx/job.dat)": (
        "tests/oracle/test_crosscheck_calculix.py compares it"
    ),
    "contactqp check folder jobname.rst --tolerance 1e-6 --error-tolerance 1e-5": "files of Ansys, not installed here",
    "contactqp check folder jobname.dat --pressure-areas areas.csv --tolerance 1e-6 --error-tolerance 1e-5": (
        "files of CalculiX; tests/benchmarks/test_crosscheck.py runs the same command where it is installed"
    ),
    "docs/guide/petsc.md: mpiexec -n 4 python -m contactqp run case.toml --engine petsc": (
        "tests/distributed runs it where there is a PETSc"
    ),
    f"docs/guide/petsc.md: {RECIPE}": "installs; .ci/run does the same",
    'docs/guide/petsc.md: PETSC_OPTIONS="-log_view" mpiexec -n 4 python -m contactqp run case.toml --engine petsc': (
        "tests/distributed has options from there"
    ),
    "docs/guide/petsc.md: contactqp: rank 1: block.toml: bodies[0] ('block'): mesh: there is no file 'block.msh'": (
        "tests/distributed/test_failing_ranks.py has ranks that fail"
    ),
    "docs/guide/petsc.md: mpiexec noticed that process rank 1 with PID 0 on node vm exited on signal 9 (Killed).": (
        "tests/distributed/test_failing_ranks.py compares it"
    ),
    f"docs/guide/petsc.md: {GOES_ON}   # is killed in step 37": "tests/distributed/test_checkpoint.py kills one",
}
DIRECTIVES = {"{toctree}", "{eval-rst}", "{math}"}


def shown(page: str) -> list[Block]:
    return [block for block in blocks(page) if block.language not in DIRECTIVES]


@pytest.fixture
def page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[PageRun]:
    monkeypatch.chdir(tmp_path)
    # What a page registers ends with it.
    for module, table in ((methods, "_REGISTRY"), (matrix_files, "READERS"), (answer_files, "READERS")):
        monkeypatch.setattr(module, table, copy.copy(getattr(module, table)))
    tables: tuple[dict[str, Any], ...] = (solve_function, ALGORITHMS, SCHEMES)
    before = [dict(table) for table in tables]
    with registered_blocks():
        yield PageRun(tmp_path, lambda: "".join(capsys.readouterr()), NOT_RUN)
    for table, entries in zip(tables, before, strict=True):
        table.clear()
        table.update(entries)


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.slow) if page in LONG else page
        for page in pages()
        if page not in RUN_ELSEWHERE and shown(page)
    ],
)
def test_a_page_runs_and_prints_what_it_shows(page: str, page_run: PageRun) -> None:
    page_run.run(shown(page))


def test_what_is_not_run_is_still_there() -> None:
    """A reason for a block or a command that has gone is deleted with it."""
    there = {f"{block.page}: {block.first_line}" for page in pages() for block in shown(page)}
    texts = "\n".join(block.text for page in pages() for block in shown(page))
    assert [name for name in NOT_RUN if name not in there and name not in texts] == []
    assert all(NOT_RUN.values())


def test_the_readme_has_no_block_but_those_that_its_test_takes_one_by_one() -> None:
    assert sorted(block.info for block in shown("README.md")) == [
        "pycon",
        *["python"] * 5,
        *["sh"] * 2,
        *["text"] * 2,
        "toml",
    ]


BAR = """title = "bar"
axes = ["x"]
nodes = [{ name = "support", at = ["0 m"] }, { name = "1", at = ["2 m"] }]
bars = [{ name = "bar", nodes = ["support", "1"], area = "15 cm^2", modulus = "2.1e8 kN/m^2" }]
fixed = ["support"]
obstacles = [{ name = "wall", point = ["2001 mm"], normal = [-1] }]
contacts = [{ name = "tip", node = "1", obstacle = "wall" }]
loads = [{ unknown = "1.x", value = "300 kN" }]
expect = [{ quantity = "normal force", at = "tip", value = "142.5 kN", derivation = "300 - 157500 * 1e-3" }]
"""


def _block(info: str, text: str, follows: bool = False) -> Block:
    return Block("page.md", 1, info, text, follows)


@pytest.mark.parametrize(
    "wrong",
    [
        [_block("python", "print(1)\n")],
        [_block("python", "print(1)\n"), _block("text", "2\n", follows=True)],
        [_block("python", "print(1)\n"), _block("text", "1\n")],  # something stands between the two
        [_block("text", "1\n")],
        [_block("pycon", ">>> 1 + 1\n3\n")],
        [_block("pycon", "1 + 1\n")],
        [_block("console", "$ contactqp --version\ncontactqp, version 0.0.0\n")],
        [_block("console", "$ contactqp run missing.toml\n...\n$ echo $?\n0\n")],
        [_block("sh", "contactqp run missing.toml\n")],
        [_block("sh", "rm -r results\n")],
        [_block("console", "contactqp --version\n")],
        [_block("fortran", "end\n")],
        [_block("", "a formula\n")],
        [_block("toml", BAR.replace("300 kN", "150 kN"))],  # it does not reach the wall that it expects to push
    ],
)
def test_a_block_that_is_wrong_or_that_nothing_runs_fails(wrong: list[Block], page_run: PageRun) -> None:
    with pytest.raises(AssertionError):
        page_run.run(wrong)


def test_a_case_runs_and_is_written_for_the_commands_that_follow(page_run: PageRun) -> None:
    run = "$ contactqp run bar.toml --json\n...\n$ contactqp run none.toml\ncontactqp: none.toml: ...\n$ echo $?\n2\n"
    page_run.run([_block("toml bar.toml", BAR), _block("console", run)])


def test_a_case_that_cannot_be_loaded_fails(page_run: PageRun) -> None:
    with pytest.raises(ValueError, match="gravitas"):
        page_run.run([_block("toml", "gravitas = 1\n")])


def test_lines_are_the_same_but_for_rules_and_blank_ones() -> None:
    assert same_lines("a\nb\n", "a  \n\n────\nb\n")
    assert same_lines("a ... b\n", "a 0.3 b\n")
    assert not same_lines("a\nb\n", "a\nc\n")
    assert not same_lines("", "a\n")
