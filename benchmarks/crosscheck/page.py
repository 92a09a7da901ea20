"""The page docs/crosscheck.md: what each code was asked, what it says, what `contactqp check` says of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

import contactqp
from benchmarks.crosscheck.block import block
from benchmarks.crosscheck.judging import Judged

INTRODUCTION = """\
# Other codes on one block

This page is written by `python -m benchmarks.crosscheck`; `tests/benchmarks/test_crosscheck.py` repeats it wherever the
codes are installed and holds every verdict. How they are installed on Debian: `benchmarks/crosscheck/README.md`.

An elastic block of 80 x 30 x 20 mm, E = 210 000 N/mm^2, of 8 x 3 x 2 trilinear hexahedra, {unknowns} unknowns, is held
at one end above a rigid floor, {contacts} nodes over gaps of 2e-3 to 12e-3 mm. Its top is pressed near the support and
pulled at the other end: {closed} nodes close, the others lift off. Contact is node by node: gap, force and no other
point of the bottom. CalculiX's own stiffness, read from the `.sti` and `.dof` that it stores, is the problem that its
answers are judged by; it differs from ours by {same} of the largest entry, so that only contact is judged. Every code
runs as a process of its own; its answer is a file, in its own signs, judged by the command that stands with it.

*says*: the code of its own answer. *judged*: by `contactqp check`. *force off*: the largest error of a normal force, of
the largest force. *overlap*: the deepest penetration of a node, in mm (m in metres). What CalculiX prints has seven
digits, and is judged at 1e-6 and 1e-5; everything else at 1e-9 and 1e-6, where nothing else stands.

Versions: {versions}, contactqp {own}.
"""


def page(found: Mapping[str, Sequence[Judged]], same: float | None) -> str:
    """The whole page, of the codes that are installed."""
    plain = contactqp.solve(block().problem)
    head = INTRODUCTION.format(
        unknowns=block().problem.dimension,
        contacts=block().problem.contacts,
        closed=int(np.sum(plain.contact_status == "closed")),
        same="(CalculiX is not installed)" if same is None else f"{same:.0e}",
        versions=", ".join(results[0].version for results in found.values() if results),
        own=contactqp.__version__,
    )
    return "\n".join([head, *(_section(code, results) for code, results in found.items() if results)])


def _section(code: str, results: Sequence[Judged]) -> str:
    lines = [
        f"## {code}",
        "",
        "| computed by | asked for | says | judged | force off | overlap |",
        "|---|---|---|---|---|---|",
    ]
    for one in results:
        asked = one.attempt.asked.replace("|", "\\|")
        errors = f"{one.force_error:.0e} | {_length(one.overlap)}"
        lines.append(f"| {one.attempt.name} | {asked} | {one.said} | **{one.word}** | {errors} |")
    lines += ["", *(words for one in results if (words := _words(one)))]
    return "\n".join(lines)


def _length(value: float) -> str:
    return f"{value:.1e}" if value > 1e-15 else "0"


def _words(one: Judged) -> str:
    parts = [f"**{one.attempt.name}** (`{one.command}`):"]
    if one.word == "wrong":
        parts.append(f'check says: "{one.verdict.certificate.diagnosis}".')
    parts += [part for part in (measured(one), one.attempt.because) if part]
    return " ".join(parts) + "\n" if len(parts) > 1 else ""


def measured(one: Judged) -> str:
    """Figures behind a verdict that the diagnosis does not have."""
    said = []
    if np.any(one.pulls) and one.attempt.code == "CalculiX":
        pressures, gaps = -one.pressure[one.pulls], one.gap[one.pulls]
        area = "" if np.ptp(pressures) < 1e-3 * np.max(pressures) else f"{np.min(pressures):.4g} to "
        said.append(
            f"{int(np.sum(one.pulls))} contacts pull with {area}{np.max(pressures):.4g} N/mm^2, across gaps of "
            f"{np.min(gaps):.2g} to {np.max(gaps):.2g} mm."
        )
    if one.attempt.contact is not None and one.overlap > 1e-6:
        least, most = one.spring
        said.append(f"Pressure by overlap is {least:.4g} to {most:.4g} times 50 E by a millimetre.")
    return " ".join(said)
