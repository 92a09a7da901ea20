"""What an explanation consists of, and the parts that scenes of nodes and of bodies share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from contactqp.scene.schema import Scene


@dataclass(frozen=True)
class BuildingBlock:
    """One part that a contact problem can have."""

    name: str
    included: bool
    reason: str


@dataclass(frozen=True)
class Explanation:
    """A scene in words."""

    title: str
    units: str
    unknowns: tuple[str, ...]
    fixed: tuple[str, ...]
    contacts: tuple[str, ...]
    ties: tuple[str, ...]
    blocks: tuple[BuildingBlock, ...]


def path_block(scene: Scene) -> BuildingBlock:
    """Whether loads grow, and how changes are found."""
    if scene.path is None:
        return BuildingBlock("load path", False, "the loads are applied at once")
    steps = f"{scene.path.steps} steps" if scene.path.steps else "no steps but the events"
    found = "every closing and opening is found exactly" if scene.path.events else "a change is seen at the next step"
    return BuildingBlock("load path", True, f"loads grow from nothing, {steps}; {found}")


def report_blocks(scene: Scene) -> Iterator[BuildingBlock]:
    """Which methods a report tries on the case, where the case limits them."""
    if scene.report is not None:
        yield BuildingBlock("all methods in a report", False, report_note(scene))


def report_note(scene: Scene) -> str:
    """Which methods a report is limited to, and why; empty where it is not."""
    return f"only {', '.join(scene.report.methods)}: {scene.report.why}" if scene.report else ""


def counted(name: str, count: int, what: str, otherwise: str) -> BuildingBlock:
    """A block that is included where there is one of them or more."""
    return BuildingBlock(name, count > 0, f"{count} {what}{'s' * (count > 1)}" if count else otherwise)
