"""Register the time-stepping schemes for impact: one file for each idea, and a table of the files.

A file exports `SCHEMES`, the entries of its schemes; `Scheme` defines their interface.
"""

from __future__ import annotations

from contactqp.analysis.motion.schemes import impact_laws, newmark
from contactqp.analysis.motion.schemes.scheme import SchemeEntry
from contactqp.errors import InvalidProblem, shown

_MODULES = (impact_laws, newmark)

SCHEMES: dict[str, SchemeEntry] = {entry.name: entry for module in _MODULES for entry in module.SCHEMES}


def register(entry: SchemeEntry) -> None:
    """Add a scheme, which `impact` and case files then find by its name.

    Raises
    ------
    InvalidProblem
        Another scheme has that name.
    """
    if entry.name in SCHEMES:
        raise InvalidProblem(f"scheme: expected a name of its own, got {shown(entry.name)}, which another one has")
    SCHEMES[entry.name] = entry


def find(name: str) -> SchemeEntry:
    """Return the scheme of this name.

    Raises InvalidProblem: the scheme does not exist; the message lists all names.
    """
    if not isinstance(name, str) or name not in SCHEMES:
        raise InvalidProblem(f"scheme: expected one of {', '.join(SCHEMES)}, got {shown(name)}")
    return SCHEMES[name]
