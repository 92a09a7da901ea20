"""Write a problem and its answer as a folder that any code with a Matrix Market reader can read."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse as sp

from contactqp.errors import InvalidProblem
from contactqp.exchange.files import Ledger, Path, naming, wrong
from contactqp.model.arguments import checked
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution

# Build a ContactProblem from named matrices and vectors; a missing part is refused or, where it has an obvious default,
# assumed with a note in the ledger.

# The names of the parts of a problem in files and archives.
SYMBOLS = {
    "stiffness": "K",
    "load": "f",
    "normal": "E_N",
    "gap": "g",
    "tangent": "E_T",
    "friction": "mu",
    "slip_origin": "slip_origin",
    "tie": "A",
    "tie_value": "b",
}
REQUIRED = ("stiffness", "load", "normal", "gap")
MATRICES = ("stiffness", "normal", "tangent", "tie")


def part_called(name: str) -> str | None:
    """Return the part of a problem that a name or a symbol (case-sensitive) denotes, None for others."""
    if name.lower() in SYMBOLS:
        return name.lower()
    return next((part for part, symbol in SYMBOLS.items() if name == symbol), None)


def problem_of(
    path: Path,
    parts: Mapping[str, Any],
    ledger: Ledger,
    *,
    dof_names: Sequence[str] | None = None,
    contact_names: Sequence[str] | None = None,
    tie_names: Sequence[str] | None = None,
    units: Mapping[str, str] | None = None,
    ties: Any = None,
) -> ContactProblem:
    """Return the contact problem of these parts.

    Raises InvalidProblem: a part is missing, or they are not a contact problem together.

    Parameters
    ----------
    path
        The file or folder, for messages.
    parts : mapping, matrices and vectors by the names of `SYMBOLS`; one coefficient of friction serves all contacts
    ledger : a Ledger, which notes what was assumed
    dof_names, contact_names, tie_names, units : optional
        The same as in `ContactProblem`.
    ties : optional
        How many ties are stated.
    """
    missing = next((part for part in REQUIRED if part not in parts), None)
    if missing is not None:
        what = f"{missing} ({SYMBOLS[missing]})"
        got = ", ".join(parts) or "nothing"
        raise wrong(path, missing, f"{what}, which is not assumed", f"only {got}")
    given = {name: value if name in MATRICES else _vector(path, name, value) for name, value in parts.items()}
    if "friction" in given and given["friction"].size == 1:
        given["friction"] = float(given["friction"][0])
    with naming(path):
        named: dict[str, Any] = dict(dof_names=dof_names, contact_names=contact_names, tie_names=tie_names)
        problem = ContactProblem(**given, **named, units=units)
    _say(problem, given, ledger, ties)
    return problem


def _vector(path: Path, name: str, value: Any) -> Any:
    """Return one row or one column as a vector."""
    if len(value.shape) == 2 and min(value.shape) > 1 and name != "slip_origin":
        raise wrong(path, name, "a vector", f"shape {value.shape}")
    dense = value.toarray() if sp.issparse(value) else np.asarray(value)
    return dense if name == "slip_origin" and dense.ndim == 2 and min(dense.shape) > 1 else dense.ravel()


def _say(problem: ContactProblem, given: Mapping[str, Any], ledger: Ledger, ties: Any) -> None:
    if problem.asymmetry > 0:
        ledger.converted.append(f"stiffness: symmetrised, it was asymmetric by {problem.asymmetry:.1g}")
    ledger.note_rigid_change(problem.rigid_change)
    if not problem.ties:
        if ties is None:
            ledger.assumed.append("no ties: supports are eliminated from the stiffness, or there are none")
    elif "tie_value" not in given:
        ledger.assumed.append("ties are held at zero: there is no tie_value (b)")
    if problem.tangent is not None:
        if "friction" not in given:
            ledger.assumed.append("no friction: there are directions of slip (E_T), and no coefficient (mu)")
        if "slip_origin" not in given:
            ledger.assumed.append("slip is counted from the undeformed state: there is no slip_origin")


PROBLEM_FILE, ANSWER_FILE = "problem.json", "answer.json"
FORMAT, VERSION = "contactqp problem", 1
SIGNS = (
    "minimise 1/2 u'K u - f'u subject to E_N u <= g, A u = b; K u + E_N' l_N + E_T' l_T + A' nu = f; the gap g - E_N u "
    "is positive when open; l_N is a force, positive in compression; |l_T| <= mu l_N; where E_T u - slip_origin is not "
    "zero l_T points along it"
)
ANSWER_PARTS = ("displacement", "normal_force", "friction_force", "tie_force", "gap", "contact_status")


@checked
def write_problem(
    folder: Path,
    problem: ContactProblem,
    answer: Solution | Mapping[str, Any] | None = None,
    about: Mapping[str, Any] | None = None,
) -> FilePath:
    """Write a problem as problem.json and Matrix Market files, every number with all its digits.

    Parameters
    ----------
    problem : ContactProblem
    folder : path
        Made where it is not there; files of these names in it are replaced.
    answer : Solution or mapping, optional
        For answer.json: displacement, normal_force, friction_force, tie_force, gap, contact_status as far as they are
        known. Fractions are written as numbers, and as "3/7" under "exact".
    about : mapping, optional
        name and description, and whatever else may stand in problem.json.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InvalidProblem
        An answer with an unknown key, or a key in `about` that the problem itself states.
    """
    root, m = FilePath(folder), problem.contacts
    if os.path.exists(root) and not root.is_dir():
        raise InvalidProblem(f"write_problem: expected a folder, and {root} is a file")
    try:
        root.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise InvalidProblem(f"write_problem: expected a folder that can be made, got {root} ({error})") from None
    values = {part: getattr(problem, part) for part in SYMBOLS}
    if not problem.ties:
        values |= {"tie": None, "tie_value": None}
    files = {part: f"{part}.mtx" for part, value in values.items() if value is not None}
    data: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "name": root.name,
        "description": "",
        "unknowns": problem.dimension,
        "contacts": m,
        "ties": problem.ties,
        "units": {"length": problem.units.length, "force": problem.units.force},
        "dof_names": problem.dof_names,
        "contact_names": problem.contact_names,
        "tie_names": problem.tie_names,
        "signs": SIGNS,
        "files": files,
    }
    statements = dict(about or {})
    clash = sorted(set(statements) & set(data) - {"name", "description"})
    if clash:
        raise InvalidProblem(f"about: expected what the problem does not say itself, got {', '.join(clash)}")
    _write_json(root / PROBLEM_FILE, data | statements)
    for part in files:
        _write_matrix(root / f"{part}.mtx", part, values[part])
    if answer is not None:
        _write_json(root / ANSWER_FILE, _answer_data(answer))
    return root


def _write_matrix(path: FilePath, part: str, value: Any) -> None:
    symmetry = "symmetric" if part == "stiffness" else "general"
    with open(path, "wb") as file:
        if part in MATRICES:
            scipy.io.mmwrite(file, sp.coo_matrix(value), symmetry=symmetry, precision=17)
        elif np.size(value) == 0:  # SciPy 1.12 to 1.15 write for ever
            file.write(b"%%MatrixMarket matrix array real general\n%\n0 1\n")
        else:
            scipy.io.mmwrite(file, np.asarray(value, dtype=float).reshape(-1, 1), symmetry=symmetry, precision=17)


def _write_json(path: FilePath, data: Mapping[str, Any]) -> None:
    try:
        text = json.dumps(data, indent=1, allow_nan=False)
    except Exception as error:  # noqa: BLE001  whatever objects say of themselves
        raise InvalidProblem(f"{path.name}: expected finite numbers, texts, lists and mappings ({error})") from None
    path.write_text(text + "\n", encoding="utf-8")


def _answer_data(answer: Solution | Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer for JSON: numbers, and under "exact" those that are Fractions."""
    whole = isinstance(answer, Solution)
    given = {part: getattr(answer, part) for part in ANSWER_PARTS} if whole else dict(answer)  # type: ignore[arg-type]
    exact = {key: _listed(values, _text) for key, values in dict(given.pop("exact", None) or {}).items()}
    odd = sorted((set(given) | set(exact)) - set(ANSWER_PARTS))
    if odd:
        raise InvalidProblem(f"answer: expected {', '.join(ANSWER_PARTS)}, got {', '.join(odd)}")
    data: dict[str, Any] = {}
    for key, values in given.items():
        if values is not None:
            data[key] = _listed(values, str if key == "contact_status" else float)
            if key not in exact and _fractions(values):
                exact[key] = _listed(values, _text)
    return data | ({"exact": exact} if exact else {})


def _fractions(values: Any) -> bool:
    entries = np.asarray(values, dtype=object).ravel()
    return bool(entries.size) and all(isinstance(value, Fraction | int) for value in entries)


def _text(value: Any) -> str:
    return str(Fraction(value))


def _listed(values: Any, convert: Any) -> Any:
    if np.ndim(values):
        return [_listed(one, convert) for one in values]
    found = convert(values)
    return str(found) if isinstance(found, float) and not np.isfinite(found) else found  # JSON has no such numbers
