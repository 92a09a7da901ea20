"""What an explanation consists of, and the parts that scenes of nodes and of bodies share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from contactqp.scene.corners import load_names

if TYPE_CHECKING:
    from contactqp.scene.schema import SceneData
    from contactqp.scene.schema_path import LoadPath


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


def path_block(scene: SceneData) -> BuildingBlock:
    """Whether loads grow, and how changes are found."""
    if scene.path is None:
        constant = "the loads are applied at once" if scene.motion is None else "the loads of a motion are constant"
        return BuildingBlock("load path", False, constant)
    if scene.large:
        return BuildingBlock("load path", True, _large_path(scene.path))
    from contactqp.analysis.load_path import DEFAULT_STEPS

    exactly = scene.path.events is not None
    steps = "no steps but the events" if exactly else f"{DEFAULT_STEPS} steps"
    steps = f"{scene.path.steps} steps" if scene.path.steps else steps
    found = "every change of contact is found exactly" if exactly else "a change is seen at the next step"
    if scene.path.corners is None:
        return BuildingBlock("load path", True, f"loads grow from nothing, {steps}; {found}")
    names = ", ".join(dict.fromkeys(str(name) for _, name in load_names(scene)))
    corners = f"{len(scene.path.corners)} corner{'s' * (len(scene.path.corners) > 1)} of the loads {names}"
    return BuildingBlock("load path", True, f"from nothing to {corners}, each leg with {steps}; {found}")


def _large_path(path: LoadPath) -> str:
    from contactqp.scene.deforming import DEFAULT_STEPS

    control = path.control or "load"
    steps = f"{path.steps or DEFAULT_STEPS} steps"
    if control == "load":
        grown = f"{len(path.corners)} corners" if path.corners else "the full loads"
        return f"load control: from nothing to {grown}, {steps} a leg; a jump is told with its load"
    way = f"{path.controlled} goes to {path.target}" if control == "displacement" else "along the path"
    return f"{control} control: {way} in {steps}; the load factor follows, through limit points"


def newton_block(scene: SceneData, kinds: str) -> BuildingBlock:
    """Whether tangents change, and with what; `kinds` are the elements of the scene."""
    if not scene.large:
        return BuildingBlock("Newton loop", False, f"linear: small displacements and constant stiffness ({kinds})")
    laws = ", ".join(dict.fromkeys(bar.law or "green" for bar in scene.bars))
    return BuildingBlock(
        "Newton loop",
        True,
        f"large displacements: tangents, gaps and normals are updated in every step, one contact problem each; bars by "
        f"the law {laws}",
    )


def motion_blocks(scene: SceneData, masses: str) -> Iterator[BuildingBlock]:
    """The mass matrix and the steps in time; `masses` is what has mass, for statics what only weighs."""
    motion = scene.motion
    if motion is None:
        yield BuildingBlock("mass matrix", False, f"statics: {masses}")
        yield BuildingBlock("time stepping", False, "statics: nothing moves in time")
        return
    yield BuildingBlock("mass matrix", True, f"{motion.mass}, {masses}")
    steps = f"{motion.steps} steps of {float(motion.time_step.si):.6g} s from {float(motion.start.si):.6g} s"
    yield BuildingBlock("time stepping", True, f"{motion.scheme}, {steps}; one small contact problem each")


def friction_block(coefficients: Sequence[Fraction], axes: int) -> BuildingBlock:
    """Tangential rows, which all contacts get where one has friction; `coefficients` of all of them."""
    name, rubbing = "tangential rows E_T, friction", sum(map(bool, coefficients))
    if not rubbing:
        return BuildingBlock(name, False, "no contact has friction")
    each = "one row" if axes == 2 else "two rows"
    some = f"{rubbing} contact{'s' * (rubbing > 1)} with friction"
    others = "" if rubbing == len(coefficients) else f" of {len(coefficients)}"
    return BuildingBlock(name, True, f"{some}{others}, {each} each; what sticks or slips depends on the load's way")


def report_blocks(scene: SceneData) -> Iterator[BuildingBlock]:
    """Which methods a report tries on the case, where not all of them."""
    if report_note(scene):
        yield BuildingBlock("all methods in a report", False, report_note(scene))


def report_methods(scene: SceneData) -> tuple[tuple[str, ...], str] | None:
    """The methods that a report is limited to, and why; None where it tries all."""
    if scene.report is not None:
        return scene.report.methods, scene.report.why
    if scene.large:
        return ("active-set",), "methods differ only in Newton's steps, and the convex ones refuse unstable tangents"
    if scene.motion is not None:
        return ("active-set",), "a motion solves one small contact problem a step, and methods differ in no more"
    frictional = any(contact.friction for contact in scene.contacts)
    if frictional and scene.path is not None and scene.path.events is not None:
        return ("active-set",), "from one exact event to the next all is linear, and no exact method has a part in it"
    return None


def report_note(scene: SceneData) -> str:
    """The same in words; empty where all are tried."""
    limit = report_methods(scene)
    return f"only {', '.join(limit[0])}: {limit[1]}" if limit else ""


def counted(name: str, count: int, what: str, otherwise: str) -> BuildingBlock:
    """A block that is included where there is one of them or more."""
    return BuildingBlock(name, count > 0, f"{count} {what}{'s' * (count > 1)}" if count else otherwise)
