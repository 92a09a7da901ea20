"""The errata of the course chapter, and which case of this package holds each of them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

from docs.generating.tables import table

DOCS = Path(__file__).parent.parent
CASES = DOCS.parent / "cases"


@dataclass(frozen=True)
class Erratum:
    """One place of the chapter."""

    id: str
    where: str
    printed: str
    right: str
    why: str
    elsewhere: str = ""  # what shows it, where no case does


def listed() -> list[Erratum]:
    """All that are known, in their order."""
    found = tomllib.loads((DOCS / "errata.toml").read_text(encoding="utf-8"))["errata"]
    return [Erratum(**entry) for entry in found]


def held() -> dict[str, list[str]]:
    """The cases that claim each erratum."""
    found: dict[str, list[str]] = {}
    for file in sorted(CASES.glob("*.toml")):
        case = tomllib.loads(file.read_text(encoding="utf-8"))
        claims = (*case.get("published", ()), *case.get("remarks", ()))
        for erratum in {claim["erratum"] for claim in claims if "erratum" in claim}:
            found.setdefault(erratum, []).append(file.stem)
    return found


def errata() -> str:
    """The table, and what no case holds."""
    by_case = held()
    rows = [
        (
            entry.id,
            entry.where,
            entry.printed,
            f"{entry.right}<br>*{entry.why}*",
            _shown(entry, by_case.get(entry.id, [])),
        )
        for entry in listed()
    ]
    missing = [entry.id for entry in listed() if entry.id not in by_case]
    counted = f"{len(rows)} places; {len(rows) - len(missing)} of them are held by a case."
    none = f"No case holds {', '.join(missing)}: definitions, references and wording, which no scene has."
    return "\n\n".join([table(("number", "where", "printed", "right, *and why*", "cases"), rows), counted, none])


def _shown(entry: Erratum, cases: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in cases) or entry.elsewhere or "none"
