"""What one case takes in a process of its own: time by stage, memory, modules, factorisations, contacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

IMPORT = "import modules"
# What a case brings in where it needs it, and what for.
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
    """What one stage took, without the stages in it."""

    name: str
    seconds: float


@dataclass(frozen=True)
class ContactCount:
    """Of the contacts of a case, how many the solver had to do with: looked at = without partner + dropped + kept."""

    looked_at: int  # nodes of the sides that may touch
    without_partner: int  # nothing is opposite, or it is out of reach: they have no row
    dropped: int  # rows left out of the condensed problem, being far from closing
    kept: int  # rows condensed onto
    least_dropped_gap: float | None = None  # over all answers; the answer was checked against these too [length]


@dataclass(frozen=True)
class Memory:
    """Resident memory, bytes; None where the system does not say."""

    peak: int | None
    interpreter: int | None  # of the peak: Python itself, before anything of ours
    modules: int | None  # what importing added


@dataclass(frozen=True)
class Modules:
    """What was imported."""

    count: int  # all modules, those of the standard library included
    packages: tuple[str, ...]  # of third parties
    left_out: tuple[str, ...]  # optional ones that are installed and were not needed
    missing: tuple[str, ...]  # optional ones that are not installed


@dataclass(frozen=True)
class Footprint:
    """One case from its file to its certified answer, in a fresh interpreter.

    Where it came to no answer `failure` says why in one line, and the rest is what was measured until then; a process
    that died or was stopped leaves nothing but that.
    """

    case: str
    method: str
    failure: str | None = None
    seconds: float | None = None  # all of it, without starting the interpreter
    stages: tuple[StageTime, ...] = ()  # their sum is `seconds`, but for what is in no stage
    instants: int = 0  # solutions: more than one of a path or a motion
    certified: bool = False  # whether the certificate of the last one passes
    contacts: ContactCount | None = None
    factorisations: int = 0  # of the stiffness, over all instants
    back_substitutions: int = 0  # right-hand sides solved with them
    memory: Memory | None = None
    modules: Modules | None = None

    def data(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return asdict(self)

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Footprint:
        """What `data` was made of."""
        parts: dict[str, Any] = {"stages": tuple(StageTime(**stage) for stage in data["stages"])}
        for name, kind in (("contacts", ContactCount), ("memory", Memory)):
            parts[name] = None if data[name] is None else kind(**data[name])
        if data["modules"] is not None:
            lists = {key: tuple(value) for key, value in data["modules"].items() if isinstance(value, list | tuple)}
            parts["modules"] = Modules(**{**data["modules"], **lists})
        return cls(**{**data, **parts})
