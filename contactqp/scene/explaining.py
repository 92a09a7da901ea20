"""What a scene is made into: its unknowns and constraints, the blocks it got and those it did not, and why."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction

from contactqp.elements.scalars import Number
from contactqp.errors import InvalidProblem, SceneError
from contactqp.scene.building import ExactProblem, NodeModel
from contactqp.scene.exact_loads import Row
from contactqp.scene.explanation import (
    BuildingBlock,
    Explanation,
    counted,
    friction_block,
    motion_blocks,
    newton_block,
    path_block,
    report_blocks,
)
from contactqp.scene.models import build
from contactqp.scene.schema import SceneData
from contactqp.scene.unknowns import is_rotation

MOST_NAMES = 12
_EXACT = "exact rational numbers"
_ELEMENTS = (
    ("bars", "axial bars"),
    ("springs", "springs"),
    ("beams", "plane Euler-Bernoulli beams"),
    ("strings", "strings under constant tension"),
    ("masses", "point masses"),
    ("matrices", "stiffness matrices from elsewhere"),
)


def explain(scene: SceneData) -> Explanation:
    """Read off the scene itself; nothing is solved.

    Raises
    ------
    SceneError, InvalidProblem
        The scene cannot be built; the message names the file.
    """
    try:
        return _explained(scene)
    except (SceneError, InvalidProblem) as error:
        where = f"{scene.file}: " if scene.file else ""
        raise type(error)(f"{where}{error}") from None


def _explained(scene: SceneData) -> Explanation:
    model = build(scene)
    if not isinstance(model, NodeModel):
        from contactqp.scene.explaining_bodies import explain_bodies

        return explain_bodies(model)
    exact = model.exact
    names, start = exact.unknowns, ", at the start" if scene.large else ""
    return Explanation(
        title=scene.title,
        units=f"{scene.units.length}, {scene.units.force}",
        unknowns=names.free,
        fixed=tuple(name for name in names.names if name in names.fixed),
        contacts=tuple(
            f"{contact.name}: {_form(contact.normal)} <= {_written(contact.gap)} {scene.units.length}{start}"
            for contact in exact.contacts
        ),
        ties=tuple(f"{tie.name}: {_form(tie.row)} = {_written(tie.value)}" for tie in exact.ties),
        blocks=tuple(_blocks(scene, exact)),
    )


def _blocks(scene: SceneData, exact: ExactProblem) -> Iterator[BuildingBlock]:
    for key, name in _ELEMENTS:
        count = len(getattr(scene, key))
        yield BuildingBlock(name, count > 0, f"{count} in the scene" if count else "none in the scene")
    yield _rotations(exact)
    yield _supports(exact)
    yield counted("contact rows E_N u <= g", len(exact.contacts), "contact", "nothing can touch anything")
    yield friction_block([contact.friction for contact in exact.contacts], len(scene.axes))
    yield counted("tie rows A u = b", len(exact.ties), "tie", "no ties")
    yield _condensation(exact)
    yield path_block(scene)
    yield from motion_blocks(scene, _masses(scene))
    kinds = ", ".join(name for key, name in _ELEMENTS if getattr(scene, key)) or "contacts alone"
    yield newton_block(scene, kinds)
    yield BuildingBlock("finite-element library", False, "the scene has no solid bodies")
    yield BuildingBlock(_EXACT, False, "large displacements are in floats") if scene.large else _exactness(exact)
    yield from report_blocks(scene)


def _masses(scene: SceneData) -> str:
    bars, masses = sum(bar.density is not None for bar in scene.bars), len(scene.masses)
    if scene.motion is None:
        return "masses only weigh" if bars or masses else "the scene has no masses"
    kinds = ((bars, "bar", "bars"), (masses, "point mass", "point masses"))
    counts = (f"{count} {many if count > 1 else one}" for count, one, many in kinds if count)
    return f"of {' and '.join(counts)}; nothing else has any"


def _rotations(exact: ExactProblem) -> BuildingBlock:
    count = sum(is_rotation(name) for name in exact.unknowns.free)
    return counted("rotations", count, "free rotation", "no beam ends at a free node")


def _supports(exact: ExactProblem) -> BuildingBlock:
    count = len(exact.unknowns.fixed)
    some = f"{count} fixed unknown{'s' * (count > 1)}, left out of the system"
    return BuildingBlock("supports", count > 0, some if count else "nothing is fixed")


def _condensation(exact: ExactProblem) -> BuildingBlock:
    free = set(exact.unknowns.free)
    rows = [*(contact.normal for contact in exact.contacts), *(tie.row for tie in exact.ties)]
    if any(contact.friction for contact in exact.contacts):
        rows += [row for contact in exact.contacts for row in contact.tangent]
    touched = free & {name for row in rows for name in row}
    some = f"contacts and ties touch {len(touched)} of {len(free)} unknowns"
    return BuildingBlock("condensation onto the contact unknowns", 0 < len(touched) < len(free), some)


def _exactness(exact: ExactProblem) -> BuildingBlock:
    reason = "every number of the problem is rational" if exact.rational else "a length or a normal is irrational"
    return BuildingBlock(_EXACT, exact.rational, reason)


def _form(row: Row) -> str:
    """``u(1.x) - u(2.x)``."""
    text = ""
    for name, factor in row.items():
        sign = "-" if factor < 0 else "+"
        size = "" if abs(factor) == 1 else f"{_written(-factor if factor < 0 else factor)} "
        text += f" {sign} {size}u({name})" if text else f"{'-' * (factor < 0)}{size}u({name})"
    return text


def _written(number: Number) -> str:
    """A fraction as it is unless it is a short decimal."""
    if isinstance(number, Fraction) and Fraction(f"{float(number):.6g}") != number:
        return str(number)
    return f"{float(number):.6g}"


def shortened(names: Sequence[str]) -> str:
    """The first of many names."""
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f", and {more} more" if more > 0 else "")
