"""The footprint of a case: time of each stage, memory, modules, factorisations and contacts of one answer.

It is measured in a process of its own (`contactqp.study.footprint_child`), a fresh interpreter.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from contactqp.errors import counted
from contactqp.study.running.child import died_of, environment_of_children

if TYPE_CHECKING:
    from rich.console import Console

IMPORT = "import modules"
# Optional packages, which a case imports only where it needs them, by their purpose.
OPTIONAL: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("files of meshes", ("meshlane",)),
    (
        "QP backends",
        ("qpsolvers", "cvxpy", "osqp", "clarabel", "piqp", "proxsuite", "daqp", "highspy", "scs", "qpalm"),
    ),
    ("fast rational algebra", ("flint",)),
    ("pictures and pages", ("matplotlib", "plotly", "jinja2")),
    ("files of other codes", ("h5py",)),
    ("faster sparse solvers", ("pypardiso", "pyamg")),
)


@dataclass(frozen=True)
class StageTime:
    """The time of one stage, without the stages in it."""

    name: str
    seconds: float


@dataclass(frozen=True)
class ContactCount:
    """Counts of contacts: looked at = without partner + dropped + kept."""

    looked_at: int  # nodes of the sides that may touch
    without_partner: int  # without a row, as nothing is opposite or within reach
    dropped: int  # rows left out of the condensed problem, far from closing
    kept: int  # rows condensed onto
    least_dropped_gap: float | None = None  # over all answers, which are checked against these rows too [length]


@dataclass(frozen=True)
class Memory:
    """Resident memory [bytes]; None where the system does not report it."""

    peak: int | None
    interpreter: int | None  # before anything is imported
    modules: int | None  # added by imports


@dataclass(frozen=True)
class Modules:
    """The modules that were imported."""

    count: int  # all modules, those of the standard library included
    packages: tuple[str, ...]  # imported packages of third parties
    left_out: tuple[str, ...]  # optional packages that are installed and were not needed
    missing: tuple[str, ...]  # optional packages that are not installed


@dataclass(frozen=True)
class Footprint:
    """One case from its file to its certified answer, in a fresh interpreter.

    Where there is no answer, `failure` gives the reason in one line, and the other fields are what was measured until
    then; of a process that died or was stopped there is nothing else.
    """

    case: str
    method: str
    failure: str | None = None
    seconds: float | None = None  # total time, without starting the interpreter
    stages: tuple[StageTime, ...] = ()  # their sum is `seconds`, but for what is in no stage
    instants: int = 0  # solutions: more than one of a path or a motion
    certified: bool = False  # whether the certificate of the last one passes
    contacts: ContactCount | None = None
    factorisations: int = 0  # of the stiffness, over all instants
    back_substitutions: int = 0  # right-hand sides solved with them
    memory: Memory | None = None
    modules: Modules | None = None

    def data(self) -> dict[str, Any]:
        """Return the footprint as plain data for JSON."""
        return asdict(self)

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Footprint:
        """Return the footprint that `data` was made of."""
        parts: dict[str, Any] = {"stages": tuple(StageTime(**stage) for stage in data["stages"])}
        for name, kind in (("contacts", ContactCount), ("memory", Memory)):
            parts[name] = None if data[name] is None else kind(**data[name])
        if data["modules"] is not None:
            lists = {key: tuple(value) for key, value in data["modules"].items() if isinstance(value, list | tuple)}
            parts["modules"] = Modules(**{**data["modules"], **lists})
        return cls(**{**data, **parts})


CHILD = "contactqp.study.footprint_child"
# What has not come to an end of its own when the time is up by so much is stopped from outside.
OVERTIME = 1.25


def measure(case: str | os.PathLike[str], method: str = "active-set", time_limit: float | None = None) -> Footprint:
    """Measure a case from its file to its certified answer.

    Parameters
    ----------
    case : path
        A case file.
    method : str
        A name of `contactqp.methods()` that needs no knob.
    time_limit : float, optional
        Seconds. At the next step or factorisation after them the solve ends, and the footprint is that of what was
        done until then; the whole process is stopped after a quarter more.

    Returns
    -------
    Footprint
        Where there is no answer, its `failure` is the message of the error, the signal that ended the process, or that
        it took too long.
    """
    asked = (str(case), method)
    limit = () if time_limit is None else (repr(float(time_limit)),)
    command = [sys.executable, "-P", "-m", CHILD, *asked, *limit]  # -P: no modules from the folder that it is run in
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=None if time_limit is None else OVERTIME * time_limit,
            env=environment_of_children(),
            check=False,
        )
    except subprocess.TimeoutExpired:
        text = f"stopped in a step that had not ended when the time limit of {time_limit:g} s was over"
        return Footprint(*asked, failure=text)
    except OSError as error:
        return Footprint(*asked, failure=f"no process could be started: {error.strerror or error}")
    if done.returncode:
        return Footprint(*asked, failure=_ending(done.returncode, done.stderr))
    try:
        return Footprint.from_data(json.loads(done.stdout.splitlines()[-1]))  # libraries may have said something
    except (IndexError, ValueError, TypeError, KeyError):
        return Footprint(*asked, failure="the process that measured said nothing that can be read")


def _ending(code: int, stderr: str) -> str:
    """Return how a process failed, in words."""
    if code < 0:
        return died_of(code)
    last = stderr.strip().splitlines()[-1:] or [f"exit code {code}"]
    return f"the process ended early: {last[0]}"


MEBIBYTE = 2**20


def print_footprint(console: Console, footprint: Footprint) -> None:
    """Print the outcome, the time of each stage, and the other figures line by line."""
    from rich.markup import escape

    from contactqp.scene.tables import print_table, print_wrapped

    console.print(escape(f"solved by {footprint.method} in a fresh interpreter: {footprint_outcome(footprint)}"))
    if footprint.seconds is None:
        return
    rows = [
        [stage.name, f"{1e3 * stage.seconds:.4g}", share_text(stage.seconds / footprint.seconds)]
        for stage in footprint.stages
    ]
    print_table(console, ["stage", "time [ms]", "share"], [*rows, ["total", f"{1e3 * footprint.seconds:.4g}", ""]])
    print_wrapped(console, footprint_lines(footprint))


def share_text(part: float) -> str:
    """Return a part of a whole in per cent as text."""
    return "< 1 %" if part < 0.005 else f"{100 * part:.0f} %"


def footprint_outcome(footprint: Footprint) -> str:
    """Return the outcome in words."""
    if footprint.failure is not None:
        return f"no answer: {footprint.failure}"
    count = f"{footprint.instants} instants, " if footprint.instants > 1 else ""
    return count + ("certificate passed" if footprint.certified else "the certificate refuses the answer")


def footprint_lines(footprint: Footprint) -> Iterator[str]:
    """Yield work, contacts, memory and modules as one line each."""
    factorisations = counted("factorisation", footprint.factorisations)
    yield f"work: {factorisations} of the stiffness, {counted('back-substitution', footprint.back_substitutions)}"
    if footprint.contacts is not None:
        yield f"contacts: {_contacts(footprint.contacts)}"
    if footprint.memory is not None and footprint.memory.peak is not None:
        yield f"memory: {_memory(footprint.memory, footprint.memory.peak)}"
    if footprint.modules is not None:
        yield from _modules(footprint.modules)


def _contacts(count: ContactCount) -> str:
    text = f"{count.looked_at} looked at"
    if count.without_partner:
        text += f", {count.without_partner} without a partner within reach"
    text += f", {count.kept} kept"
    if not count.dropped:
        return f"{text}, none dropped before the solve"
    text += f", {count.dropped} dropped before the solve as out of reach and checked after it"
    return text if count.least_dropped_gap is None else f"{text}, smallest gap {count.least_dropped_gap:.6g}"


def _memory(memory: Memory, peak: int) -> str:
    text = f"{peak / MEBIBYTE:.0f} MiB at most"
    if memory.interpreter is None or memory.modules is None:
        return text
    rest = max(peak - memory.interpreter - memory.modules, 0)
    return (
        f"{text}: {memory.interpreter / MEBIBYTE:.0f} the interpreter, {memory.modules / MEBIBYTE:.0f} imported "
        f"modules, {rest / MEBIBYTE:.0f} this case"
    )


def _modules(modules: Modules) -> Iterator[str]:
    packages = ", ".join(modules.packages) or "none"
    yield f"imported: {modules.count} modules; packages of others: {packages}"
    for heading, names in (("not imported", modules.left_out), ("not installed", modules.missing)):
        groups = ((what, [name for name in group if name in names]) for what, group in OPTIONAL)
        if names:
            yield f"{heading}: " + "; ".join(f"{what} ({', '.join(group)})" for what, group in groups if group)
