"""Define the interface of the readers of answers, and match the names that programs give to unknowns."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from contactqp.errors import InvalidProblem
from contactqp.exchange.files import Ledger, Path, one_line, wrong
from contactqp.model.arrays import Array
from contactqp.model.names import other_spellings
from contactqp.model.problem import ContactProblem
from contactqp.model.quadratic_program import answer_of_program, without_place

# The parts of an answer and their synonyms. Pressures are forces only where areas come with them.
PARTS = ("displacement", "normal_force", "normal_pressure", "friction_force", "tie_force")
ALIASES = {
    "u": "displacement",
    "force": "normal_force",
    "contact_force": "normal_force",
    "pressure": "normal_pressure",
    "contact_pressure": "normal_pressure",
}

Parts = Mapping[str, Array]


class AnswerFile(NamedTuple):
    """An answer as a file states it; it may hold NaN, which the certificate refuses."""

    parts: Parts  # the entries of `PARTS` that the file holds
    ledger: Ledger
    named: frozenset[str] = frozenset()  # the parts that were given by name and are already in the problem's order
    tie_names: tuple[str, ...] | None = None  # names of ties, if the file has them


@dataclass(frozen=True)
class AnswerReader:
    """A format of answers."""

    name: str
    suffixes: tuple[str, ...]  # lower case, with their dots
    read: Callable[[Path, ContactProblem], AnswerFile]
    recognises: Callable[[bytes], bool] | None = None  # do a file's first bytes show this format?


def part_called(name: str) -> str | None:
    """Return the part of an answer that a key, a column or a file of this name holds, None for other names."""
    plain = name.strip().lower().replace(" ", "_")
    found = ALIASES.get(plain, plain)
    return found if found in PARTS else None


OF_PROGRAMS = ("x", "y", "z", "z_box")


def answer_of_names(path: Path, problem: ContactProblem, given: Mapping[str, Any]) -> AnswerFile | None:
    """Return the answer to a quadratic program in qpsolvers' names and signs; None where the names are others.

    Raises InvalidProblem: a value is not a vector, or has another length than the problem requires.
    """
    if "x" not in given or any(part_called(name) for name in given):
        return None
    ledger, found = Ledger(str(path)), {}
    forces_are_read = any(given.get(name) is not None for name in OF_PROGRAMS[1:])
    for name, values in given.items():
        if name not in OF_PROGRAMS:
            refuse_unread(path, name, values, problem, of_program=True, forces_are_read=forces_are_read)
            ledger.ignored.append(f"{name:.60}")
        elif values is not None:
            found[name] = vector(path, name, real_array(path, name, values))
            ledger.read.append(f"{name}: {len(found[name])} values in order")
    try:
        parts = answer_of_program(problem, **found)
    except InvalidProblem as error:
        raise wrong(path, "content", "the answer to this quadratic program", one_line(error)) from None
    if lost := without_place(problem, found["z_box"]) if "z_box" in found else []:
        worst = max(lost, key=lambda j: abs(found["z_box"][j]))
        force = f"{found['z_box'][worst]:.6g} at {problem.dof_name(worst)}"
        ledger.ignored.append(f"z_box: what stands where there is no such bound, at most {force}")
    ledger.converted.append("x, y, z and z_box, in qpsolvers' signs, to displacement and forces")
    return AnswerFile(parts, ledger)


# Names that codes give to contact forces and pressures: CNORMF, CPRESS, fn, lambda, tau_1, dual, RCFORC, marginals,
# percussion, ...; coefficients are none.
LIKE_FORCES = re.compile(
    r"(?!react|.*coefficient$)(?:.*(?:forc|frict|press|traction|lambda|lamda|lmbda|lagrang|multiplier|shear|normf)"
    r"|.*(?:percussion|impulse)s?|f_?[nct]|(?:tau|[lrt]_?[nt])_?[\dxyz]?$|t_?\d$|(?:dual|marginal)s?$|lags_?c$"
    r"|(?:.*_)?lm$)"
)
# Names of reactions: those of supports in most codes, those of contacts in Siconos, which calls them r too.
LIKE_REACTIONS = re.compile(r"r$|(?:.*_)?react(?:ion)?s?(?:_.*)?$")
LIKE_DISPLACEMENTS = re.compile(r"disp(?:l(?:acements?)?)?s?$")


def unread_part(name: str) -> str | None:
    """Return what a name that no part of an answer has is called like: "forces", "displacements" or nothing."""
    plain = name.strip().lower()
    if part_called(name) is not None:
        return None
    if LIKE_DISPLACEMENTS.match(plain):
        return "displacements"
    return "forces" if LIKE_FORCES.match(plain) else None


def has_contact_forces(names: Iterable[str]) -> bool:
    """Return whether any of the names in a file is one under which normal forces or pressures are read."""
    return any(part_called(name) in ("normal_force", "normal_pressure") for name in names)


def reactions_of_contacts(name: str, values: Any, problem: ContactProblem) -> bool:
    """Return whether reactions may be those of contacts: unless they are stated by names that no contact has."""
    if not LIKE_REACTIONS.match(name.strip().lower()):
        return False
    names = set(names_of(problem, "normal_force"))
    return not isinstance(values, dict) or names.issuperset(values) or all(map(str.isdecimal, values))


def refuse_unread(
    path: Path,
    name: str,
    values: Any,
    problem: ContactProblem,
    of_program: bool = False,
    forces_are_read: bool = False,
) -> None:
    """Refuse numbers that are called like contact forces or displacements where no part of an answer is read from
    them, so that wrong ones cannot pass unread.

    Raises InvalidProblem: there are such numbers.

    Parameters
    ----------
    path : Path
        The file, for messages.
    name : str
        A name in the file.
    values : list, dict or array
        What stands under it. Numbers are refused where they are as many as unknowns, contacts or components of contact
        forces. Those that equal the problem's coefficients of friction are coefficients.
    problem : ContactProblem
        Whose sizes they are held against.
    of_program : bool
        Whether the file is the answer to a quadratic program, where any number of values is refused.
    forces_are_read : bool
        Whether the file states contact forces under another name. Without them reactions may be those of contacts and
        are refused; beside them they are those of supports.
    """
    like = unread_part(name)
    if like is None and not forces_are_read and reactions_of_contacts(name, values, problem):
        like = "forces"
    if like is None or not isinstance(values, (list, dict, np.ndarray)):
        return
    try:
        numbers = real_array(path, name, list(values.values()) if isinstance(values, dict) else values)
    except InvalidProblem:
        return
    m = problem.contacts
    sizes = (problem.dimension,) if like == "displacements" else (m, 2 * m, 3 * m)
    coefficients = problem.friction is not None and np.array_equal(numbers.ravel(), problem.friction)
    if numbers.size and not coefficients and (of_program or numbers.size in sizes):
        names = "displacement" if like == "displacements" else "normal_force, friction_force or tie_force"
        read = "x, y, z or z_box" if of_program else names
        raise wrong(path, f"{name:.60}", f"{like} called {read}", "a name under which none are read")


UNIT = re.compile(r"(.*?)(?:[\s_]*[\[({/<].*|[\s_]+(?:[kmcu\u00b5]?m|[km]n|[kmg]?pa|in|ft|lbf|psi))", re.DOTALL)


def refuse_unit(path: Path, name: str, known: Callable[[str], object] = part_called) -> None:
    """Refuse a name with a unit, such as "displacement [mm]": numbers must be in the problem's units.

    Raises InvalidProblem: the name is known once its unit is removed.
    """
    found = UNIT.fullmatch(name.strip().lower())
    if found is not None and not known(name) and known(found[1]):
        expected = f"{found[1]!r} alone, in the units of the problem"
        raise wrong(path, f"{name:.60}", expected, "a unit, and none is converted")


def names_of(problem: ContactProblem, part: str) -> list[str]:
    """Return the problem's names for the entries of a part of an answer; tie_force has none."""
    if part == "displacement":
        return [problem.dof_name(j) for j in range(problem.dimension)]
    return [problem.contact_name(i) for i in range(problem.contacts)]


def places(path: Path, part: str, given: Sequence[str], names: Sequence[str], ledger: Ledger) -> list[int]:
    """Return, for each name of the problem, the index of its entry in the file, found by name or by position from 0.

    Unknowns that the problem does not have, such as those of supported nodes, are ignored with a note in the ledger;
    contacts that it does not have are refused. Other spellings of an unknown are accepted (`contactqp.model.names`).

    Parameters
    ----------
    path : Path
        The file, for messages.
    part : str
        Which part of an answer: "displacement" or one of the contacts.
    given : sequence of str
        The names in the file, in its order.
    names : sequence of str
        Those of the problem.
    ledger : Ledger
        Takes what was ignored and assumed.

    Raises
    ------
    InvalidProblem
        A name twice, also in two spellings, or one that is missing.
    """
    place = {name: k for k, name in enumerate(given)}
    if len(place) != len(given):
        twice = next(name for k, name in enumerate(given) if place[name] != k)
        raise wrong(path, part, "every name once", f"{twice!r:.60} twice")
    if names and not given:
        raise wrong(path, part, f"{len(names)} values by name", "none")
    if part == "displacement":
        place = _as_called_here(path, place, names, ledger)
    numbered = not any(name in place for name in names) and all(name.isdecimal() for name in given)
    if numbered and names:
        names = [str(k) for k in range(len(names))]
        ledger.assumed.append(f"{part}: named by numbers: positions counted from 0")
    missing = [name for name in names if name not in place]
    known = set(names)
    extra = [name for name in place if name not in known]
    if missing or (extra and (part != "displacement" or numbered)):
        odd = [f"no {_some(missing)}"] * bool(missing) + [f"{_some(extra)}, which the problem does not have"] * bool(
            extra
        )
        raise wrong(path, part, f"{len(names)} values by name", " and ".join(odd))
    if extra:
        ledger.ignored.append(f"{part}: {len(extra)} names that the problem does not have, such as {extra[0]!r:.60}")
    return [place[name] for name in names]


def _some(names: Sequence[str]) -> str:
    return ", ".join(f"{name:.30}" for name in names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _as_called_here(path: Path, place: Mapping[str, int], names: Sequence[str], ledger: Ledger) -> dict[str, int]:
    """Return the same places under the problem's names, where the file spells them differently (12.1 or 12.UX for
    12.x).
    """
    part, found = "displacement", dict(place)
    missing = [name for name in names if name not in place]
    theirs = other_spellings(names, place, names) if len(place) > len(names) or missing else {}
    taken: dict[str, str] = {}
    for name, spelled in theirs.items():
        if name in place or len(spelled) > 1:
            raise wrong(
                path, part, f"one value for {name!r:.40}", f"{_some([*spelled, name][:2])}, which mean the same"
            )
        if spelled[0] in taken:
            raise wrong(path, part, f"{taken[spelled[0]]!r:.40} and {name!r:.40}", f"{spelled[0]!r:.40} for both")
        taken[spelled[0]] = name
        found[name] = found.pop(spelled[0])
    if taken:
        first, ours = next(iter(taken.items()))
        ledger.assumed.append(f"{part}: {len(taken)} names spelled otherwise, such as {first:.40} for {ours:.40}")
    return found


def real_array(path: Path, part: str, values: Any) -> Array:
    """Return real numbers of one or two dimensions as an array; None becomes NaN."""
    try:
        if isinstance(values, list):
            values = [[_number(v) for v in row] if isinstance(row, list) else _number(row) for row in values]
        raw = np.asarray(values)
        if raw.dtype.kind not in "fiu" and raw.size:
            raise TypeError(f"{raw.dtype.name}")
        array = raw.astype(float)
    except (TypeError, ValueError, OverflowError) as error:
        raise wrong(path, part, "numbers", one_line(error)) from None
    if array.ndim not in (1, 2):
        raise wrong(path, part, "a list of numbers", f"shape {array.shape}")
    return array


# Numbers that JSON lacks, in the spellings of other programs and of this package.
NOT_FINITE = ("nan", "inf", "-inf")


def _number(value: Any) -> float:
    if value is None:
        return float("nan")
    if isinstance(value, str) and value.lower() in NOT_FINITE:
        return float(value)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{value!r:.40}")
    return float(value)


def vector(path: Path, part: str, values: Array) -> Array:
    """Return a column or a row as a vector; friction forces in space keep their two columns."""
    if values.ndim == 2 and min(values.shape) > 1:
        if part != "friction_force":
            raise wrong(path, part, "a vector", f"shape {values.shape}")
        return values
    return values.ravel()
