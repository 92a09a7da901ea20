"""Draw the conclusion of a report from its rows, and deliver the files into its folder.

The conclusion is one sentence, and one line for each method. The folder keeps an unfinished report apart from a
finished one, with the machine it was made on.
"""

from __future__ import annotations

import importlib.metadata
import math
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from contactqp.errors import SceneError, counted
from contactqp.solving.methods import Method
from contactqp.study import rows
from contactqp.study.rows import UNIT_ROUNDOFF, Row
from contactqp.study.running.journal import Journal
from contactqp.study.statistics import ANSWERED, BODY, own_answers, solved

# The shift of the shifted geometric mean, in linear solves.
MULTIPLE_SHIFT = 1.0
# What a line is called where several settings of a method were tried on a case, and what that costs.
BEST_OF = (
    "best of N: up to N settings were tried on each case, and the line is that of the fastest right one, else of the "
    "most exact; which one that is shows only once the right answer is known, and the time is that of its run alone"
)
HEADINGS = ("method", "right", "raw: wrong of claimed", "time / linear solve", "error of the force")


@dataclass(frozen=True)
class MethodLine:
    """The results of one method over the cases that it was tried on, by its best setting in each.

    The best setting of a case is the fastest right one, else the most exact one, of all that were tried, `settings` of
    them on the case that had most. Raw answers are counted apart.
    """

    method: str
    exact: bool  # whether it promises the exact answer
    cases: int  # tried
    right: int  # of these, where an answer as `solve` returns it is right
    claimed: int  # raw answers that the method itself called solved
    wrong: int  # of these, that are wrong
    linear_solves: float | None  # shifted geometric mean of its time over that of one linear solve
    spread: float | None  # mean distance of the quartiles of these times over their median, where they were repeated
    force_error: float | None  # the largest relative error of the contact forces
    off_at_worst: float | None = None  # the same over all settings, as `solve` runs them
    settings: int = 1  # tried on one case, at most

    def cells(self) -> tuple[str, ...]:
        """Return the cells of `HEADINGS`."""
        flags = f"{_percent(self.wrong, self.claimed)} of {self.claimed}" if self.claimed else "claims nothing"
        times = "" if self.linear_solves is None else f"{self.linear_solves:.3g}"
        times += "" if not times or self.spread is None else f" ± {100 * self.spread:.0f} %"
        error = "" if self.force_error is None else f"{max(self.force_error, UNIT_ROUNDOFF):.0e}"
        name = self.method if self.settings == 1 else f"{self.method}, best of {self.settings}"
        return name, f"{_percent(self.right, self.cases)} of {self.cases}", flags, times, error


@dataclass(frozen=True)
class Conclusion:
    """The answers of a report to its questions, and the lines of its methods, the most often right and then the fastest
    first.
    """

    answers: tuple[tuple[str, str], ...]  # questions with their answers, in a sentence or two
    lines: tuple[MethodLine, ...]

    @property
    def sentence(self) -> str:
        """Return the answers without their questions."""
        return " ".join(answer for _, answer in self.answers)

    def cells(self) -> list[tuple[str, ...]]:
        """Return the table, headings first."""
        return [HEADINGS, *(line.cells() for line in self.lines)]

    @property
    def note(self) -> str:
        """Return what the lines say of methods with several settings, where there are such; else empty."""
        return BEST_OF if any(line.settings > 1 for line in self.lines) else ""

    def data(self) -> dict[str, Any]:
        """Return the conclusion as results.json has it."""
        return dict(sentence=self.sentence, methods=[asdict(line) for line in self.lines])


def conclude(all_rows: Sequence[Row], load_before: float | None = None) -> Conclusion:
    """Return the conclusion of the rows of a report; those whose times are not known yet count without them.

    Cases without a reference solution, such as motions, are left out. If the machine was busy before the report, no
    method is called faster than another.
    """
    judged = {row.case for row in all_rows if row.error_judged is not None}
    tried = [row for row in all_rows if row.verdict != rows.MISSING and row.case in judged]
    timed = {row.case for row in tried if row.linear_solve_seconds and (row.unknowns or 0) >= BODY}
    timed = timed or {row.case for row in tried if row.linear_solve_seconds}
    names = dict.fromkeys(row.method for row in tried)
    lines = [_line([row for row in tried if row.method == name], timed) for name in names]
    lines.sort(key=lambda line: (-line.right / line.cases, line.linear_solves or math.inf))
    passed_wrong = sum(row.verdict == rows.WRONG for row in tried)
    known, unsure = len({row.case for row in tried}), bool(busy(load_before))
    answers = _answers(lines, known, _smallest(tried, timed), passed_wrong, unsure)
    return Conclusion(answers, tuple(lines))


def _line(mine: Sequence[Row], timed: set[str]) -> MethodLine:
    by_case = [[row for row in mine if row.case == case] for case in dict.fromkeys(row.case for row in mine)]
    best = [_best(of_case) for of_case in by_case]
    counted = [
        row
        for row in best
        if row.case in timed and row.verdict in ANSWERED and row.seconds is not None and row.linear_solve_seconds
    ]
    ratios = [row.seconds / row.linear_solve_seconds for row in counted if row.seconds and row.linear_solve_seconds]
    spreads = [row.seconds_spread for row in counted if row.seconds_spread is not None]
    errors = [row.error_force for row in best if row.error_force is not None and row.error_measure == "relative"]
    all_errors = [
        row.error_force
        for of_case in by_case
        for row in _as_solve_runs_it(of_case)
        if row.error_force is not None and row.error_measure == "relative"
    ]
    own = own_answers(mine)
    return MethodLine(
        method=mine[0].method,
        exact=mine[0].promises_exact,
        cases=len(best),
        right=sum(map(solved, best)),
        claimed=sum(row.claimed is True for row in own),
        wrong=sum(row.flag_wrong is True for row in own),
        linear_solves=float(np.exp(np.mean(np.log(np.array(ratios) + MULTIPLE_SHIFT))) - MULTIPLE_SHIFT)
        if ratios
        else None,
        spread=float(np.mean(spreads)) if spreads else None,
        force_error=max(errors, default=None),
        off_at_worst=max(all_errors, default=None),
        settings=max(len(_as_solve_runs_it(of_case)) for of_case in by_case),
    )


def _best(of_case: Sequence[Row]) -> Row:
    """Return the row of the best setting of one method on one case, as `solve` runs it on the contact unknowns."""
    usual = _as_solve_runs_it(of_case)
    right = [row for row in usual if solved(row)]
    if right:
        return min(right, key=lambda row: math.inf if row.seconds is None else row.seconds)
    return min(usual, key=lambda row: math.inf if row.error_judged is None else row.error_judged)


def _as_solve_runs_it(of_case: Sequence[Row]) -> Sequence[Row]:
    """Return the rows of one method on one case as `solve` runs it, on the contact unknowns; all where none are."""
    return [row for row in of_case if row.variant in ("", "polished") and row.condensed != rows.WHOLE] or of_case


def _smallest(tried: Sequence[Row], timed: set[str]) -> int:
    return min((row.unknowns or 0 for row in tried if row.case in timed), default=0)


# The questions that a report answers.
WHICH, PENALTY, WRONG = "Which method?", "What does a penalty cost?", "Who is wrong without saying so?"


def _answers(
    lines: Sequence[MethodLine], cases: int, smallest: int, passed_wrong: int, unsure: bool
) -> tuple[tuple[str, str], ...]:
    """Return the questions of a report with their answers.

    Parameters
    ----------
    lines : sequence of MethodLine
    cases : the number of cases with a known answer
    smallest : the unknowns of the smallest case whose times count
    passed_wrong : how many wrong answers the certificate has passed
    unsure : whether the machine was busy with something else
    """
    if not lines:
        return (("", "No answer is known yet that others could be held against."),)
    answers = {
        WHICH: _which(lines, cases, smallest, unsure),
        PENALTY: _penalties(lines),
        WRONG: _flags(lines, passed_wrong),
    }
    return tuple((question, answer) for question, answer in answers.items() if answer)


def _which(lines: Sequence[MethodLine], cases: int, smallest: int, unsure: bool) -> str:
    default = next((line for line in lines if line.method == "active-set"), None)
    parts = []
    if default is not None:
        force = (
            ""
            if default.force_error is None
            else f", its contact forces within {max(default.force_error, UNIT_ROUNDOFF):.0e}"
        )
        parts.append(f"{_right_share(default)}{force}{_time(default, smallest)}.")
    others = [line for line in lines if line is not default and line.exact and line.right == line.cases]
    if others:
        named = ", ".join(line.method for line in others)
        parts.append(f"Also right wherever they were tried: {named}{_fastest_of(others, default, unsure)}.")
    known = f"On {counted('case', cases)} with a known answer"
    return f"{known}: {' '.join(parts)}" if parts else f"{known} no method that promises the exact one is right in all."


def _penalties(lines: Sequence[MethodLine]) -> str:
    """Return how far off the methods are that are approximate by design, and in which time; empty without them."""
    off = [line for line in lines if not line.exact and line.force_error is not None]
    off.sort(key=lambda line: line.method != "penalty")  # exact matches before similar ones
    found = "; ".join(f"{line.method} is off by {_off_by(line)}{_time(line)}" for line in off)
    if not found:
        return ""
    after = " (smaller error and time by the best value, known only after the answer)"
    return f"{found[:1].upper()}{found[1:]}{after if any(line.settings > 1 for line in off) else ''}."


def _off_by(line: MethodLine) -> str:
    """Return the errors of a method from its worst value to its best one."""
    best = _off(line.force_error)
    return best if line.settings == 1 else f"{_off(line.off_at_worst)} to {best} depending on its value"


def _fastest_of(others: Sequence[MethodLine], default: MethodLine | None, unsure: bool) -> str:
    """Return which of the methods that are right in all is the fastest, where it is so beyond doubt."""
    timed = [line for line in others if line.linear_solves is not None]
    if not timed:
        return ""
    fastest = min(timed, key=lambda line: line.linear_solves or math.inf)
    if default is None or default.linear_solves is None or default.right < default.cases:
        return UNSURE if unsure else f"; the fastest is {fastest.method}{_time(fastest)}"
    scatter = (default.spread or 0.0) + (fastest.spread or 0.0)
    if default.linear_solves <= max(AS_FAST, 1 + scatter) * (fastest.linear_solves or math.inf):
        return f"; none of them is faster by {'a tenth' if 1 + scatter <= AS_FAST else 'more than times scatter here'}"
    return UNSURE if unsure else f"; {fastest.method} is faster{_time(fastest)}"


def _right_share(line: MethodLine) -> str:
    all_of_them = line.right == line.cases
    return f"{line.method}, the default, is right in {'all' if all_of_them else f'{line.right} of {line.cases}'}"


def _time(line: MethodLine, smallest: int | None = None) -> str:
    if line.linear_solves is None:
        return ""
    where = ""
    if smallest is not None:
        overhead = "" if smallest >= BODY else ", where nearly all of it is overhead"
        where = f" on bodies of {counted('unknown', smallest)} and more{overhead}"
    digits = ".2g" if line.linear_solves < 99.5 else ".0f"
    return f", in the time of {line.linear_solves:{digits}} linear solves{where}"


# Text used where no order of methods can be claimed.
UNSURE = "; which of them is faster a busy machine cannot tell"
# Times that differ by less count as equal, as runs on one machine vary by that much.
AS_FAST = 1.1
# The criterion by which a flag is wrong, in words (`contactqp.study.comparison.GENEROSITY`).
BY_FAR = "more than 100 times the tolerance asked"


def _flags(lines: Sequence[MethodLine], passed_wrong: int) -> str:
    """Return how often methods called wrong raw answers solved, and how often the certificate passed a wrong one."""
    claimed, wrong = sum(line.claimed for line in lines), sum(line.wrong for line in lines)
    passed = f"{passed_wrong or 'no'} answer{'s' if passed_wrong > 1 else ''} that the certificate passed"
    certified = f"{passed} {'is' if passed_wrong < 2 else 'are'} wrong"
    if not claimed:
        return f"{certified[:1].upper()}{certified[1:]}."
    if not wrong:
        none = f"one of the {claimed} raw answers that methods called solved is wrong by {BY_FAR}; {certified}."
        return f"N{none}" if passed_wrong else f"Nobody: n{none}"
    named = ", ".join(f"{line.method} {line.wrong} of {line.claimed}" for line in lines if line.wrong)
    return f"Of {claimed} raw answers that methods called solved, {wrong} are wrong by {BY_FAR}: {named}; {certified}."


def _off(error: float | None) -> str:
    if error is None:
        return ""
    if error >= 0.1:
        return f"{100 * error:.0f} %"
    return f"{100 * error:.1g} %" if error >= 1e-4 else f"{error:.0e}"


def _percent(part: int, whole: int) -> str:
    """Return a part in per cent, rounded so that 100 % and 0 % are exact."""
    share = 100 * part / whole if whole else 0.0
    return f"{min(max(round(share), 1 if part else 0), 100 if part == whole else 99)} %"


BASE = ("contactqp", "numpy", "scipy", "qpsolvers", "cvxpy", "matplotlib")
# Environment variables that decide on how many threads linear algebra runs.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def machine() -> dict[str, str]:
    """Return the platform, the processor, the version of Python and the limits of threads."""
    found = dict(
        platform=platform.platform(),
        processor=_processor(),
        cores=str(os.cpu_count()),
        python=f"{platform.python_implementation()} {platform.python_version()}",
    )
    return found | {name: os.environ[name] for name in THREADS if name in os.environ}


def _processor() -> str:
    """Return the model of the processor from Linux, else from Python."""
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        for line in lines:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def linear_algebra() -> str:
    """Return the libraries of linear algebra that are loaded, and how many threads they would take now."""
    from threadpoolctl import threadpool_info

    found = (f"{one['internal_api']} {one['version']}, {one['num_threads']} threads" for one in threadpool_info())
    return "; ".join(dict.fromkeys(found))


# The load of a machine, for each core, from which it is busy with something else.
BUSY = 0.5


def load() -> float | None:
    """Return how many processes have run in the last minute on average; None where the system does not tell."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def load_of(facts: Mapping[str, Any]) -> float | None:
    """Return the load of the machine before a report, of which these are the facts; None where they do not tell."""
    load_before: float | None = facts.get("load", {}).get("at_start")
    return load_before


def busy(before: float | None) -> str:
    """Return what a load before a report means for its times; empty where the machine was idle."""
    cores = os.cpu_count() or 1
    if before is None or before <= BUSY * cores:
        return ""
    return (
        f"the machine was busy (a load of {before:.1f} on {cores} cores): run times are not to be trusted, errors and "
        "verdicts are; methods of one case took turns, and compare"
    )


def versions(methods: Sequence[Method]) -> dict[str, str]:
    """Return the version of every distribution that was or could have been used, or "not installed"."""
    homes = _homes()
    packages = dict.fromkeys(package for method in methods for package in method.packages)
    names = dict.fromkeys([*BASE, *(homes.get(package, [package])[0] for package in packages)])
    return {name: _version(name) for name in names}


@cache
def _homes() -> Mapping[str, list[str]]:
    """Return the distributions of each package; cached, as reading the files of all of them takes seconds."""
    return importlib.metadata.packages_distributions()


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


JOURNAL = "unfinished_report.jsonl"
# Prefix of the folder in which finished files wait until all are there.
_WORKSHOP = ".unfinished-"


def report_folder(folder: str | Path) -> Path:
    """Return the folder of a report, made if need be.

    Raises SceneError: the folder cannot be made.
    """
    if not str(folder):
        raise SceneError("-o: expected a folder for the report, got an empty name")
    path = Path(folder)
    if path.exists() and not path.is_dir():
        raise SceneError(f"{path}: expected a folder for the report, and there is a file of that name")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SceneError(f"{path}: expected a folder that can be written, got: {error.strerror}") from None
    return path


@contextmanager
def unfinished(folder: Path, conditions: Mapping[str, Any], fresh: bool, name: str = JOURNAL) -> Iterator[Journal]:
    """Yield the journal of this folder's report, removed when the report is finished and kept when it is not.

    Raises SceneError: the folder cannot be written, or another report is being written to it.

    Parameters
    ----------
    folder : folder of the report
    conditions : mapping, versions, machine and settings under which kept results are the same
    fresh : discard the results of an interrupted report
    name : file name of the journal
    """
    journal = Journal(folder / name, conditions, fresh)
    for left_behind in folder.glob(f"{_WORKSHOP}*"):
        shutil.rmtree(left_behind, ignore_errors=True)
    try:
        yield journal
    except BaseException:
        journal.close()
        raise
    journal.remove()


@contextmanager
def workshop(folder: Path) -> Iterator[Path]:
    """Yield a folder for files that are being written, which is removed at the end."""
    with tempfile.TemporaryDirectory(prefix=_WORKSHOP, dir=folder) as path:
        yield Path(path)


def write(file: Path, text: str) -> None:
    """Write text in UTF-8, with the same line ends on every platform."""
    file.write_text(text, encoding="utf-8", newline="\n")


def deliver(shop: Path, folder: Path) -> tuple[Path, ...]:
    """Move every file to the folder, each in one step and the page last, and return their new names."""
    made = sorted(shop.iterdir(), key=lambda file: (file.suffix == ".html", file.suffix, file.name))
    for file in made:
        os.replace(file, folder / file.name)
    return tuple(folder / file.name for file in made)
