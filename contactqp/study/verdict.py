"""The verdict on an answer of another code, and the options by which its numbers are read.

The options are the sign of compression, the areas that turn pressures into forces, and maps of unknowns and contacts. A
map is a text file: the place of each unknown (or contact) of the problem in the candidate, counted from 0, one a line;
or the candidate's own names in the candidate's order, one a line; or a table "problem,candidate" of what each is called
(or where it stands) in the candidate.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from contactqp.errors import InvalidProblem, shown
from contactqp.exchange.files import Ledger, read_text, wrong
from contactqp.exchange.matrix_files import read_matrix
from contactqp.exchange.tables import is_table, read_tables
from contactqp.model.arrays import Vector
from contactqp.model.local_problem import LocalProblem, LocalSolution
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import LocalCertificate, Solution
from contactqp.model.summary import finite
from contactqp.oracle.judged_answer import COMPRESSION, JudgedAnswer
from contactqp.study.friction_files import figures

EXPECTED = "places or names, one a line, or a table problem,candidate"
# Arguments of `cq.certify` as a diagnosis writes them, and the options of the command line that set them.
OPTIONS = (
    (r"\bcompression='(\w+)'", r"--compression \1"),
    (r"\bpressure_area=", "--pressure-areas"),
    (r"\b(dof|contact)_map=(\[[^]]*\])", r"--\1-map '\2'"),
    (r"\b(dof|contact)_map=", r"--\1-map "),
    (r",? ?\berror_tolerance=", " --error-tolerance "),
    (r"\btolerance=", "--tolerance "),
)


# A map written on the command line: indices in brackets or separated by commas.
PLACES = re.compile(r"\s*(?:\[\s*\d+(?:\s*,\s*\d+)*\s*\]|\d+(?:\s*,\s*\d+)+)\s*")


@dataclass(frozen=True)
class CheckOptions:
    """The options of `contactqp check`; areas and maps are names of files, a map of places may be written out."""

    tolerance: float = 1e-9
    compression: str = "positive"
    pressure_areas: str | None = None
    dof_map: str | None = None
    contact_map: str | None = None
    error_tolerance: float = 1e-6
    units: dict[str, str] | None = None  # what those of matrices that state none are called

    def files(self) -> dict[str, str]:
        """Return the files that are named, by the name of their option; maps that are written out are none."""
        maps = {"dof_map": self.dof_map, "contact_map": self.contact_map}
        named = {name: told for name, told in maps.items() if told is not None and not is_written_out(told)}
        return named if self.pressure_areas is None else {"pressure_areas": self.pressure_areas, **named}

    def __post_init__(self) -> None:
        if self.compression not in COMPRESSION:
            raise InvalidProblem(f"compression: expected 'positive' or 'negative', got {shown(self.compression)}")


def as_options(text: str) -> str:
    """Return a diagnosis with the options of the command line in place of arguments in Python.

    >>> as_options("with compression='negative' this answer is right")
    'with --compression negative this answer is right'
    >>> as_options("tolerance=1e-07, error_tolerance=1e-05 passes it")
    '--tolerance 1e-07 --error-tolerance 1e-05 passes it'
    """
    for argument, option in OPTIONS:
        text = re.sub(argument, option, text)
    return text


@dataclass(frozen=True)
class Order:
    """A map between a problem and a candidate, in one of three forms.

    `places` says where the problem's unknowns stand in the candidate, `names` lists the candidate's names in its order,
    `renamed` holds the candidate's name of each of the problem's unknowns.
    """

    file: str
    places: tuple[int, ...] | None = None
    names: tuple[str, ...] | None = None
    renamed: tuple[str, ...] | None = None


def is_written_out(told: str) -> bool:
    """Return whether a map is given by its places themselves, instead of by a file."""
    return PLACES.fullmatch(told) is not None and not os.path.exists(told)  # also for texts that cannot be file names


def read_order(file: str | None, names: Sequence[str]) -> Order | None:
    """Read a map; `names` are the problem's names of its unknowns or contacts. None without a file.

    Places may stand on the command line itself, as a diagnosis prints them: ``[1, 2, 0]``.

    Raises
    ------
    InvalidProblem
        There is no such file, it is empty, or a name of the problem is missing, unknown or there twice.
    """
    if file is None:
        return None
    if is_written_out(file):
        return _order(file, re.findall(r"\d+", file))
    if is_table(file, "problem"):
        return _renaming(file, names)
    entries = [line.strip() for line in read_text(file, EXPECTED).splitlines() if line.strip()]
    entries = [entry for entry in entries if not entry.startswith("#")]
    if not entries:
        raise wrong(file, "content", EXPECTED, "nothing")
    return _order(file, entries) or Order(file, names=tuple(entries))


def _order(file: str, entries: Sequence[str]) -> Order | None:
    if not all(entry.isdecimal() and len(entry) < 19 for entry in entries):
        return None
    return Order(file, places=tuple(int(entry) for entry in entries))


def _renaming(file: str, names: Sequence[str]) -> Order:
    tables = read_tables(file, ("problem",))
    if len(tables) != 1 or tables[0].columns != ("problem", "candidate"):
        raise wrong(file, "columns", "problem,candidate", ", ".join(tables[0].columns)[:100])
    given = tables[0].column("problem")
    called = dict(zip(given, tables[0].column("candidate"), strict=True))
    if len(called) != len(given) or set(called) != set(names):
        odd = sorted(set(called) ^ set(names)) or [name for name in given if given.count(name) > 1]
        raise wrong(file, "problem", f"each of the problem's {len(names)} names once", ", ".join(odd[:5])[:100])
    entries = tuple(called[name] for name in names)
    places = _order(file, entries)
    return Order(file, places=None if places is None else places.places, renamed=entries)


def read_areas(file: str, contact_names: Sequence[str], ledger: Ledger) -> Vector:
    """Read the (m,) areas [length^2], in the problem's order of contacts or by name in a table contact,area.

    Raises InvalidProblem: there is no such file, it holds no numbers, or its names are not the problem's.
    """
    if not is_table(file, "contact"):
        matrix, _, own = read_matrix(file)
        if len(matrix.shape) == 2 and min(matrix.shape) > 1:
            raise wrong(file, "content", "one area a contact", f"shape {matrix.shape}")
        ledger.read.append(f"pressure areas: {file}: {'; '.join(own.read)}")
        dense = matrix.toarray() if hasattr(matrix, "toarray") else matrix
        return np.asarray(dense, dtype=float).ravel()
    (table,) = read_tables(file, ("contact",))[:1]
    if "area" not in table.columns:
        raise wrong(file, "columns", "contact,area", ", ".join(table.columns)[:100])
    given = dict(zip(table.column("contact"), table.numbers("area"), strict=True))
    if len(given) != len(table.rows) or set(given) != set(contact_names):
        odd = sorted(set(given) ^ set(contact_names)) or ["one of them twice"]
        raise wrong(
            file, "contact", f"each of the problem's {len(contact_names)} contacts once", ", ".join(odd[:5])[:100]
        )
    ledger.read.append(f"pressure areas: {file}: {len(given)} by name")
    return np.array([given[name] for name in contact_names])


class JudgedContact(Protocol):
    """The findings on one contact."""

    def data(self) -> dict[str, Any]:
        """Return the findings as plain data for JSON."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """The verdict on a candidate."""

    problem_file: str
    candidate_file: str
    problem: ContactProblem | LocalProblem
    certificate: JudgedAnswer | LocalCertificate
    worst: Sequence[JudgedContact]
    right: Solution | LocalSolution | None  # our solution, where the candidate is wrong
    why_not: str | None  # the reason why there is no solution
    ledgers: tuple[Ledger, ...]  # of the problem and of the candidate
    notes: tuple[str, ...] = ()  # in addition to those of the certificate

    @property
    def passed(self) -> bool:
        return self.certificate.passed

    def data(self) -> dict[str, Any]:
        """Return the verdict as plain data for JSON."""
        certificate = self.certificate
        return {
            "problem": self.problem_file,
            "candidate": self.candidate_file,
            "contacts": self.problem.contacts,
            "right": self.passed,
            **(_judged_data(certificate) if isinstance(certificate, JudgedAnswer) else {}),
            "tolerance": certificate.tolerance,
            "certificate": {name: finite(value) for name, value in figures(certificate).items()},
            "bounds": {
                "energy_error": finite(getattr(certificate, "energy_error", None)),
                "force_error": finite(certificate.force_error),
                "force_bound": finite(certificate.force_bound),
                "scope": certificate.scope,
                "radius": finite(certificate.radius),
                "reasons": list(certificate.reasons),
            },
            "failures": list(certificate.failures),
            "notes": [*self.notes, *certificate.notes],
            "worst": [one.data() for one in self.worst],
            "right_values": None if self.right is None else {"method": self.right.method},
            "no_right_values": self.why_not,
            "ledgers": [ledger.data() for ledger in self.ledgers],
        }


def _judged_data(certificate: JudgedAnswer) -> dict[str, Any]:
    return {
        "proven": certificate.proven,
        "basis": certificate.basis,
        "diagnosis": as_options(certificate.diagnosis),
        "findings": [{"kind": one.kind, "text": one.text, "cause": one.cause} for one in certificate.findings],
        "recovered": list(certificate.recovered),
    }
