"""The commands in the running text of README.md and docs/ and in messages, and what is typed to try them."""

from __future__ import annotations

import re

from tests.docs.blocks import FENCE, ROOT, blocks, pages

INLINE = re.compile(r"`((?:python -m )?contactqp(?: [^`]*)?)`")
# A word that stands for others: CASE, [OPTIONS], FILE.json, DIR/CASE.inp, "CASE...".
STANDS_FOR = re.compile(r"\b[A-Z]+\b|[\[…]|\.\.\.")
A_CASE = re.compile(r"contactqp run [a-z_]+")
WRITES_A_DECK = re.compile(r'^deck = """\n(?P<text>.*?)"""\nwith open\("(?P<name>[^"]+)", "w"\)', re.S | re.M)
FULL = "contactqp report --full bar_wall -o figures"
COMPARED = "contactqp report bar_wall && cp report/results.json o.json && contactqp report bar_wall --compare o.json"
MATRICES = "contactqp check mine answer.csv --compression negative"
# What is typed for a command that has words which stand for others, or that is the name of a command alone. A part
# behind `&&` is typed after the part before.
TYPED = {
    "contactqp COMMAND -h": "contactqp explain -h",
    "contactqp cases [WORD...]": "contactqp cases friction bar",
    "contactqp cases WORD...": "contactqp cases friction bar",
    "contactqp cases WORD": "contactqp cases friction",
    "contactqp check": "contactqp check --help",
    "contactqp check PROBLEM CANDIDATE": MATRICES,
    "contactqp check PROBLEM ANSWER": MATRICES,
    "contactqp check FILE ANSWER": MATRICES,
    "contactqp check PROBLEM CANDIDATE --receipt FILE": f"{MATRICES} --receipt receipt.json",
    "contactqp check --verify FILE.json": (
        f"{MATRICES} --receipt receipt.json && contactqp check --verify receipt.json"
    ),
    "contactqp check squares.inp ANSWER": (
        "contactqp run squares.inp --method active-set --json > answer.json && contactqp check squares.inp answer.json"
    ),
    "contactqp explain": "contactqp explain --help",
    "contactqp explain CASE": "contactqp explain bar_wall",
    "contactqp explain FILE": "contactqp explain bar.toml",
    "contactqp explain NAME": "contactqp explain bar_wall",
    "contactqp export CASE --inp DIR": "contactqp export patch_two_blocks --inp folder",
    "contactqp gallery DIR": "contactqp gallery problems --count 1",
    "contactqp gallery DIR [--kind K] [--count N] [--seed S]": (
        "contactqp gallery problems --kind degenerate --count 1 --seed 3"
    ),
    "contactqp gallery --as qpbenchmark": "contactqp gallery --as qpbenchmark problems --count 1",
    "contactqp gallery --as qpbenchmark DIR": "contactqp gallery --as qpbenchmark problems --count 1",
    "contactqp init [FILE] [--like CASE]": "contactqp init my_case.toml --like bar_wall",
    "contactqp init FILE --like NAME": "contactqp init my_case.toml --like bar_wall",
    "contactqp oracle": "contactqp oracle --help",
    "contactqp oracle CASE": "contactqp oracle bar_wall",
    "contactqp oracle --time-limit": "contactqp oracle bar_wall --time-limit 60",
    "contactqp report": COMPARED,
    "contactqp report [-o DIR]": FULL,
    "contactqp report [CASE...] [-o DIR]": FULL,
    "contactqp report CASE…": "contactqp report bar.toml",
    "contactqp report --full": FULL,
    "contactqp report --compare OLD.json": COMPARED,
    "contactqp report --stability": "contactqp report --help",
    "contactqp run": "contactqp run --help",
    "contactqp run --time-limit": "contactqp run bar_wall --time-limit 60",
    "contactqp run NAME": "contactqp run bar_wall",
    "contactqp run CASE...": "contactqp run bar_wall two_bars",
    "contactqp run CASE... --plot FILE --vtu FILE --csv FILE": (
        "contactqp run hertz_line --plot line.png --vtu line.vtu --csv line.csv"
    ),
    "contactqp run CASE --plot FILE": "contactqp run bar_wall --plot bar.png",
    "contactqp run CASE --csv FILE": "contactqp run bar_wall_path --csv path.csv",
    "contactqp run CASE --method M --json": "contactqp run bar_wall --method active-set --json",
    "contactqp run FILE": "contactqp run bar.toml",
    "contactqp run cases/truss_floor.toml": "contactqp run cases/truss_floor.toml",
    "python -m contactqp": "python -m contactqp --help",
}
CALCULIX = "needs CalculiX; tests/oracle/test_crosscheck_calculix.py runs it"
# Commands that are not run, with the reason; one that ends in "..." stands for all that begin so.
NOT_RUN = {
    "contactqp check calculix ...": "needs CalculiX and minutes; tests/benchmarks/test_crosscheck.py judges the files",
    "contactqp check block ...": "files of codes run for minutes; tests/benchmarks/test_crosscheck.py judges them",
    "contactqp check metres ...": "files of PETSc; tests/benchmarks/test_crosscheck.py judges them",
    "contactqp check friction ...": "files of Siconos; tests/benchmarks/test_crosscheck.py judges them",
    "contactqp crosscheck MODEL.inp [RESULTS]": CALCULIX,
    "contactqp crosscheck DIR/CASE.inp": CALCULIX,
    "contactqp crosscheck model.inp": CALCULIX,
    "contactqp crosscheck model.inp model.dat": CALCULIX,
    "contactqp report --dask": "needs a scheduler; tests/study/running/test_cluster.py starts one",
    "contactqp report --stability [-o DIR]": "minutes; tests/study/stability/test_study.py runs it on fewer cases",
    "contactqp run FOLDER --engine petsc": "needs MPI and PETSc; tests/distributed runs it on ranks",
}


def inline_commands(texts: list[tuple[str, str]]) -> dict[str, str]:
    """Return the commands between backticks, outside of blocks of code, each with the first place where it stands."""
    found: dict[str, str] = {}
    for place, text in texts:
        for words in INLINE.findall(FENCE.sub("", text)):
            command = " ".join(words.split())
            if command != "contactqp":  # the name of the program
                found.setdefault(command, place)
    return found


def typed(command: str) -> str | None:
    """Return what is typed to try a command, and None where it is listed as not run.

    Raises LookupError: it has words that stand for others, and neither table has it.
    """
    begins = [name.removesuffix("...") for name in NOT_RUN if name.endswith(" ...")]
    if command in NOT_RUN or command.startswith(tuple(begins)):
        return None
    if "[OPTIONS]" in command:
        return f"{command.partition(' [')[0]} --help"
    if command in TYPED:
        return TYPED[command]
    if STANDS_FOR.search(command):
        raise LookupError(f"{command}: what is typed for it? It is neither in TYPED nor in NOT_RUN")
    return command


def unused(commands: dict[str, str]) -> list[str]:
    """Return the entries of both tables that no page and no message has."""
    begun = [name for name in NOT_RUN if name.endswith(" ...")]
    used = {name for name in begun if any(command.startswith(name.removesuffix("...")) for command in commands)}
    return sorted((TYPED.keys() | NOT_RUN.keys()) - used - commands.keys())


def given_files() -> dict[str, str]:
    """Return the texts of the files that pages show with a name, of the first page that has one of that name."""
    found = {"bar.toml": _case("bar_wall"), "cases/truss_floor.toml": _case("truss_floor")}
    for page in pages():
        for block in blocks(page):
            if block.language in ("csv", "text", "json") and len(block.words) == 1:
                found.setdefault(block.words[0], block.text)
            elif block.language == "python" and (deck := WRITES_A_DECK.search(block.text)):
                found.setdefault(deck["name"], deck["text"])
    return found


def _case(name: str) -> str:
    return (ROOT / "cases" / f"{name}.toml").read_text(encoding="utf-8")
