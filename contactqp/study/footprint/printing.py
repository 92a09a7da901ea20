"""A footprint on a screen."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Console
from rich.markup import escape

from contactqp.scene.tables import print_table
from contactqp.study.footprint.footprint import OPTIONAL, ContactCount, Footprint, Memory, Modules

MEBIBYTE = 2**20


def print_footprint(console: Console, footprint: Footprint) -> None:
    """What the answer took, line by line, and the time of each stage."""
    console.print(escape(f"solved by {footprint.method} in a fresh interpreter: {footprint_outcome(footprint)}"))
    if footprint.seconds is None:
        return
    rows = [
        [stage.name, f"{1e3 * stage.seconds:.4g}", share_text(stage.seconds / footprint.seconds)]
        for stage in footprint.stages
    ]
    print_table(console, ["stage", "time [ms]", "share"], [*rows, ["total", f"{1e3 * footprint.seconds:.4g}", ""]])
    for line in footprint_lines(footprint):
        console.print(escape(line), soft_wrap=True)


def share_text(part: float) -> str:
    """A part of the whole in percent."""
    return "< 1 %" if part < 0.005 else f"{100 * part:.0f} %"


def footprint_outcome(footprint: Footprint) -> str:
    """How it ended."""
    if footprint.failure is not None:
        return f"no answer: {footprint.failure}"
    count = f"{footprint.instants} instants, " if footprint.instants > 1 else ""
    return count + ("certificate passed" if footprint.certified else "the certificate refuses the answer")


def footprint_lines(footprint: Footprint) -> Iterator[str]:
    """Work, contacts, memory and modules, one sentence each."""
    factorisations, right_hand_sides = footprint.factorisations, footprint.back_substitutions
    yield f"work: {factorisations} {_many('factorisation', factorisations)} of the stiffness, {right_hand_sides} " + (
        _many("back-substitution", right_hand_sides)
    )
    if footprint.contacts is not None:
        yield f"contacts: {_contacts(footprint.contacts)}"
    if footprint.memory is not None and footprint.memory.peak is not None:
        yield f"memory: {_memory(footprint.memory, footprint.memory.peak)}"
    if footprint.modules is not None:
        yield from _modules(footprint.modules)


def _many(name: str, count: int) -> str:
    return name if count == 1 else f"{name}s"


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
    left = max(peak - memory.interpreter - memory.modules, 0)
    return (
        f"{text}: {memory.interpreter / MEBIBYTE:.0f} the interpreter, {memory.modules / MEBIBYTE:.0f} imported "
        f"modules, {left / MEBIBYTE:.0f} this case"
    )


def _modules(modules: Modules) -> Iterator[str]:
    packages = ", ".join(modules.packages) or "none"
    yield f"imported: {modules.count} modules; packages of others: {packages}"
    for heading, names in (("not imported", modules.left_out), ("not installed", modules.missing)):
        groups = ((what, [name for name in group if name in names]) for what, group in OPTIONAL)
        if names:
            yield f"{heading}: " + "; ".join(f"{what} ({', '.join(group)})" for what, group in groups if group)
