"""From matrices and vectors that came under names to a ContactProblem; what is missing is refused or, where it has
one plain meaning, taken and said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.exchange.ledger import Ledger
from contactqp.exchange.refusal import Path, naming, wrong
from contactqp.model.problem import ContactProblem

# What the parts of a problem are called, in files and in archives.
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
    """Which part of a problem something of this name is: its name, or its symbol in the case that it is written in."""
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
    units: Mapping[str, str] | None = None,
    ties: Any = None,
) -> ContactProblem:
    """The problem of these parts; one coefficient of friction serves all contacts. `ties`: how many are stated.

    Raises
    ------
    InvalidProblem
        A part is missing, or they are no contact problem together.
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
        problem = ContactProblem(**given, dof_names=dof_names, contact_names=contact_names, units=units)
    _say(problem, given, ledger, ties)
    return problem


def _vector(path: Path, name: str, value: Any) -> Any:
    """One row or one column as a vector."""
    if len(value.shape) == 2 and min(value.shape) > 1 and name != "slip_origin":
        raise wrong(path, name, "a vector", f"shape {value.shape}")
    dense = value.toarray() if sp.issparse(value) else np.asarray(value)
    return dense if name == "slip_origin" and dense.ndim == 2 and min(dense.shape) > 1 else dense.ravel()


def _say(problem: ContactProblem, given: Mapping[str, Any], ledger: Ledger, ties: Any) -> None:
    if problem.asymmetry > 0:
        ledger.converted.append(f"stiffness: symmetrised, it was asymmetric by {problem.asymmetry:.1g}")
    if problem.rigid_change > 0:
        digits = f"changed by {problem.rigid_change:.1g} of its diagonal at most, the rounding of printed digits"
        ledger.converted.append(f"stiffness: {digits}, so that rigid motions cost no energy")
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
