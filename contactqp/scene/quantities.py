"""What a case can say of its answer: each quantity by its name, the kind of number it is, and what it is asked of."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Measure:
    """One row of the vocabulary of ``quantity``."""

    meaning: str
    kinds: tuple[str, ...] = ()  # of its value, see units.KINDS; none for a word
    at: str | None = None  # what ``at`` names: "unknown", "contact", "support", "bar", "spring", "tie"
    along: bool = False  # ``along`` names a second unknown
    matrix: bool = False  # its value is ``rows``
    solved: bool = True  # needs a solution; otherwise read off the problem
    path: bool = False  # needs the load path


QUANTITIES = {
    "displacement": Measure("displacement or rotation of an unknown", ("length", "angle"), at="unknown"),
    "normal force": Measure("force of a contact, positive in compression", ("force",), at="contact"),
    "gap": Measure("gap of a contact, positive when open", ("length",), at="contact"),
    "status": Measure("open, closed or grazing", (), at="contact"),
    "tie force": Measure("multiplier nu of a tie, K u + A' nu = f", ("force", "moment"), at="tie"),
    "reaction": Measure("force of a support on the body", ("force", "moment"), at="support"),
    "bar force": Measure("axial force, positive in tension", ("force",), at="bar"),
    "spring force": Measure("force of a spring, positive in tension", ("force",), at="spring"),
    "energy": Measure("1/2 u'Ku - f'u", ("energy",)),
    "closing load factor": Measure("load factor at which a contact closes", ("number",), at="contact", path=True),
    "closing load": Measure("load on `along` when a contact closes", ("force",), at="contact", along=True, path=True),
    "stiffness": Measure("entry of K at two unknowns", ("stiffness",), at="unknown", along=True, solved=False),
    "tie matrix": Measure("the rows A of the ties, in the scene's units", ("number",), matrix=True, solved=False),
    "tie rank": Measure("number of independent ties", ("number",), solved=False),
    "reduced stiffness": Measure("T'KT on the masters", ("stiffness",), matrix=True, solved=False),
    "reduced load": Measure("T'(f - K b) on the masters", ("force",), matrix=True, solved=False),
}
