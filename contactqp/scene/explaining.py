"""Describe a scene in words: unknowns, constraints, and which blocks its problem includes or leaves out, and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from contactqp.elements.scalars import Number
from contactqp.elements.solid import Body
from contactqp.errors import InvalidProblem, SceneError
from contactqp.linalg.iteration import Systems, factors_are_dear, systems_of
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem, Units
from contactqp.scene.blocks import BLOCKS
from contactqp.scene.body_model import BodyModel, PairedContact
from contactqp.scene.building import ExactProblem, NodeModel, Row, build
from contactqp.scene.schema import Contact, SceneData, is_rotation, load_names
from contactqp.scene.tables import MOST_ROWS, print_table

if TYPE_CHECKING:
    from contactqp.scene.schema import LoadPath

MOST_NAMES = 12
# Entries of a row that are printed.
MOST_TERMS = 6


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


def explain(scene: SceneData) -> Explanation:
    """Describe a scene without solving it.

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
    for key, kind in BLOCKS.items():
        count = len(getattr(scene, key))
        yield BuildingBlock(kind.title, count > 0, f"{count} in the scene" if count else "none in the scene")
    rotations = sum(is_rotation(name) for name in exact.unknowns.free)
    yield counted("rotations", rotations, "free rotation", "no beam ends at a free node")
    fixed = len(exact.unknowns.fixed)
    some = f"{fixed} fixed unknown{'s' * (fixed > 1)}, left out of the system"
    yield BuildingBlock("supports", fixed > 0, some if fixed else "nothing is fixed")
    yield counted("contact rows E_N u <= g", len(exact.contacts), "contact", "nothing can touch anything")
    yield friction_block([contact.friction for contact in exact.contacts], len(scene.axes))
    yield counted("tie rows A u = b", len(exact.ties), "tie", "no ties")
    yield _condensation(exact)
    yield path_block(scene)
    yield from motion_blocks(scene, _masses(scene))
    kinds = ", ".join(kind.title for key, kind in BLOCKS.items() if getattr(scene, key)) or "contacts alone"
    yield newton_block(scene, kinds)
    yield BuildingBlock("finite-element library", False, "the scene has no solid bodies")
    rational = "every number of the problem is rational" if exact.rational else "a length or a normal is irrational"
    exactness = "large displacements are in floats" if scene.large else rational
    yield BuildingBlock("exact rational numbers", exact.rational and not scene.large, exactness)
    yield from report_blocks(scene)


def _masses(scene: SceneData) -> str:
    heavy = Counter(element.noun for _, element in scene.elements if element.has_mass)
    if scene.motion is None:
        return "masses only weigh" if heavy else "the scene has no masses"
    counts = (f"{count} {noun}{'s' * (count > 1)}" for noun, count in heavy.items())
    return f"of {' and '.join(counts)}; nothing else has any"


def _condensation(exact: ExactProblem) -> BuildingBlock:
    free = set(exact.unknowns.free)
    rows = [*(contact.normal for contact in exact.contacts), *(tie.row for tie in exact.ties)]
    if any(contact.friction for contact in exact.contacts):
        rows += [row for contact in exact.contacts for row in contact.tangent]
    touched = free & {name for row in rows for name in row}
    some = f"contacts and ties touch {len(touched)} of {len(free)} unknowns"
    return BuildingBlock("condensation onto the contact unknowns", 0 < len(touched) < len(free), some)


def _form(row: Row) -> str:
    """Return a row as text, such as ``u(1.x) - u(2.x)``."""
    text = ""
    for name, factor in row.items():
        sign = "-" if factor < 0 else "+"
        size = "" if abs(factor) == 1 else f"{_written(-factor if factor < 0 else factor)} "
        text += f" {sign} {size}u({name})" if text else f"{'-' * (factor < 0)}{size}u({name})"
    return text


def _written(number: Number) -> str:
    """Return a number as a short decimal if it is one, else as a fraction."""
    if isinstance(number, Fraction) and Fraction(f"{float(number):.6g}") != number:
        return str(number)
    return f"{float(number):.6g}"


def shortened(names: Sequence[str]) -> str:
    """Return the first of many names in one line."""
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f", and {more} more" if more > 0 else "")


def explain_bodies(model: BodyModel) -> Explanation:
    """Describe a scene of elastic bodies without solving it."""
    scene, names, system = model.scene, model.structure.unknown_names(), model.system
    supported = np.flatnonzero(~np.isnan(system.prescribed))
    return Explanation(
        title=scene.title,
        units=f"{scene.units.length}, {scene.units.force}",
        unknowns=tuple(names[j] for j in system.free),
        fixed=tuple(names[j] for j in supported),
        contacts=tuple(
            _paired_contact(contact, paired, scene.units.length)
            for contact, paired in zip(scene.contacts, model.contacts, strict=True)
        ),
        ties=(),
        blocks=tuple(_body_blocks(model)),
    )


def _paired_contact(contact: Contact, paired: PairedContact, length: str) -> str:
    sides = contact.touching_sides or (str(contact.membrane),)
    other = f"the obstacle {contact.obstacle!r}" if contact.obstacle else f"{sides[1]} by {contact.pairing}"
    gaps = paired.pairing.gap
    left_out = len(paired.pairing.unpaired)
    return (
        f"{contact.name}: {sides[0]} against {other}, {len(gaps)} nodes, "
        f"gaps from {gaps.min(initial=np.inf):.6g} to {gaps.max(initial=-np.inf):.6g} {length}"
        + (f", {left_out} nodes without a partner" if left_out else "")
    )


def _body_blocks(model: BodyModel) -> Iterator[BuildingBlock]:
    scene = model.scene
    for body in model.structure.bodies:
        kinds = ", ".join(block.kind.name for block in body.mesh.blocks)
        kind = body.model if isinstance(body, Body) else "membrane"
        size = f"{body.mesh.elements} elements ({kinds}), {len(body.mesh.points)} nodes, {kind}"
        yield BuildingBlock(f"body {body.name}", True, size)
    yield BuildingBlock("bars, springs, beams, strings, point masses", False, "none in a scene of bodies")
    supported = int(np.sum(~np.isnan(model.system.prescribed)))
    yield counted("supports", supported, "held unknown", "nothing is held")
    for key, what in (("tractions", "traction"), ("pressures", "pressure"), ("point_loads", "point load")):
        yield counted(key.replace("_", " "), len(getattr(scene, key)), what, "none in the scene")
    weighs = scene.gravity is not None and any(body.density is not None and body.density.si for body in scene.bodies)
    yield BuildingBlock("gravity", weighs, "bodies weigh by their density" if weighs else "nothing weighs")
    rows = len(model.problem.gap)
    yield counted("contact rows E_N u <= g", rows, "row", "nothing can touch anything")
    yield friction_block([contact.friction for contact in model.contacts], len(scene.axes))
    problem = model.problem
    tangent = [] if problem.tangent is None else [problem.tangent.indices]
    touched = len(np.unique(np.concatenate([problem.normal.indices, *tangent])))
    some = f"contacts touch {touched} of {len(model.system.free)} unknowns"
    yield BuildingBlock("condensation onto the contact unknowns", 0 < touched < len(model.system.free), some)
    yield path_block(scene)
    masses = "a density only weighs" if scene.motion is None else "of all bodies"
    yield from motion_blocks(scene, masses)
    yield BuildingBlock("Newton loop", False, "linear kinematics: gaps are taken where the bodies start")
    yield BuildingBlock("exact rational numbers", False, "bodies are integrated in floats")
    yield from report_blocks(scene)


def counted(name: str, count: int, what: str, otherwise: str) -> BuildingBlock:
    """Return a block that is included if `count` is positive.

    Parameters
    ----------
    name : the name of the block
    count : int
    what : what one of them is called; its plural has an s
    otherwise : the reason where there is none
    """
    return BuildingBlock(name, count > 0, f"{count} {what}{'s' * (count > 1)}" if count else otherwise)


def path_block(scene: SceneData) -> BuildingBlock:
    """Describe whether loads grow, and how changes of contact are found."""
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
    from contactqp.scene.moving import DEFAULT_STEPS

    control = path.control or "load"
    steps = f"{path.steps or DEFAULT_STEPS} steps"
    if control == "load":
        grown = f"{len(path.corners)} corners" if path.corners else "the full loads"
        return f"load control: from nothing to {grown}, {steps} a leg; a jump is told with its load"
    course = f"{path.controlled} goes to {path.target}" if control == "displacement" else "along the path"
    return f"{control} control: {course} in {steps}; the load factor follows, through limit points"


def newton_block(scene: SceneData, kinds: str) -> BuildingBlock:
    """Describe whether the tangent stiffness changes, and why; `kinds` names the elements of the scene."""
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
    """Yield the blocks of mass matrix and time steps; `masses` names the parts with mass, in statics with weight."""
    motion = scene.motion
    if motion is None:
        yield BuildingBlock("mass matrix", False, f"statics: {masses}")
        yield BuildingBlock("time stepping", False, "statics: nothing moves in time")
        return
    yield BuildingBlock("mass matrix", True, f"{motion.mass}, {masses}")
    steps = f"{motion.steps} steps of {float(motion.time_step.si):.6g} s from {float(motion.start.si):.6g} s"
    yield BuildingBlock("time stepping", True, f"{motion.scheme}, {steps}; one small contact problem each")


def friction_block(coefficients: Sequence[Fraction], axes: int) -> BuildingBlock:
    """Describe which contacts have friction; where one has, all get tangential rows."""
    name, frictional = "tangential rows E_T, friction", sum(map(bool, coefficients))
    if not frictional:
        return BuildingBlock(name, False, "no contact has friction")
    each = "one row" if axes == 2 else "two rows"
    some = f"{frictional} contact{'s' * (frictional > 1)} with friction"
    others = "" if frictional == len(coefficients) else f" of {len(coefficients)}"
    return BuildingBlock(name, True, f"{some}{others}, {each} each; what sticks or slips depends on the load's way")


def report_blocks(scene: SceneData) -> Iterator[BuildingBlock]:
    """Yield a block for the methods of a report on the case, where they are limited."""
    if report_note(scene):
        yield BuildingBlock("all methods in a report", False, report_note(scene))


def report_methods(scene: SceneData) -> tuple[tuple[str, ...], str] | None:
    """Return the methods that a report is limited to, and why; None where it tries all."""
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
    """Return a sentence on the methods that a report is limited to, empty where it tries all."""
    limit = report_methods(scene)
    return f"only {', '.join(limit[0])}: {limit[1]}" if limit else ""


def explain_problem(problem: ContactProblem | LocalProblem, title: str) -> Explanation:
    """Describe a problem of matrices, such as a quadratic program, and the systems that `solve` would take."""
    if isinstance(problem, LocalProblem):
        local = BuildingBlock("condensation", False, "the problem is in local form: contacts alone, no stiffness")
        friction = friction_block([Fraction(float(mu)) for mu in problem.friction], problem.dimension)
        names = tuple(problem.contact_name(i) for i in range(problem.contacts))
        return Explanation(title, "units of its own", (), (), names, (), (friction, local))
    bounds = int(np.sum(np.diff(problem.normal.indptr) == 1))
    units = problem.units or Units()
    return Explanation(
        title=title,
        units=", ".join(filter(None, (units.length, units.force))) or "units of its own",
        unknowns=tuple(problem.dof_name(j) for j in range(problem.dimension)),
        fixed=(),
        contacts=tuple(_row_of(problem.normal, i, problem, "<=") for i in range(problem.contacts)),
        ties=tuple(_row_of(problem.tie, i, problem, "=") for i in range(problem.ties)),
        blocks=(
            counted("stiffness K", problem.stiffness_rows.nnz, "nonzero", "the energy is linear"),
            counted("unknowns without stiffness", int(np.sum(problem.diagonal == 0)), "unknown", "K sees all of them"),
            counted("contact rows E_N u <= g", problem.contacts, "contact", "nothing is unilateral"),
            counted("bounds of single unknowns among them", bounds, "bound", "no row has one entry alone"),
            counted("tie rows A u = b", problem.ties, "tie", "no ties"),
            friction_block([Fraction(float(mu)) for mu in _coefficients(problem)], _axes(problem)),
            _systems(problem),
        ),
    )


def _row_of(rows: Any, i: int, problem: ContactProblem, relation: str) -> str:
    """Return one row in words; long ones are cut short."""
    ties = relation == "="
    entries = range(rows.indptr[i], rows.indptr[i + 1])
    terms = [f"{rows.data[k]:+.6g} {problem.dof_name(int(rows.indices[k]))}" for k in entries[:MOST_TERMS]]
    more = f" ... ({len(entries)} entries)" if len(entries) > MOST_TERMS else ""
    name = problem.tie_name(i) if ties else problem.contact_name(i)
    limit = problem.tie_value[i] if ties else problem.gap[i]
    return f"{name}: {' '.join(terms) or '0'}{more} {relation} {limit + 0.0:.6g}"


def _coefficients(problem: ContactProblem) -> Any:
    return np.zeros(problem.contacts) if problem.friction is None else problem.friction


def _axes(problem: ContactProblem) -> int:
    return 1 + (1 if problem.slip_origin is None else problem.slip_origin.shape[1])


def _systems(problem: ContactProblem) -> BuildingBlock:
    """Return which systems `solve` takes."""
    systems = systems_of(problem)
    if systems is Systems.ITERATED:
        many = problem.frictional and not factors_are_dear(problem)
        why = "contacts with friction are many" if many else "the body is too large to factorise"
        return BuildingBlock("condensation", False, f"{why}: it is iterated on")
    if systems is Systems.SPARSE:
        return BuildingBlock("condensation", False, "constraints are many: sparse systems are predicted to cost less")
    rows = [problem.normal, problem.tie] if problem.tangent is None else [problem.normal, problem.tie, problem.tangent]
    touched = len(np.unique(np.concatenate([some.indices for some in rows])))
    if systems is Systems.SUBSET:
        why = "friction retains three rows of each" if problem.frictional else "dense systems of all cost more"
        text = f"onto contacts that may close, of {problem.contacts} that touch {touched} unknowns with the ties: {why}"
        return BuildingBlock("condensation", True, text)
    return BuildingBlock("condensation", True, f"onto {touched} unknowns that contacts and ties touch")


def print_explanation(console: Console, explanation: Explanation) -> None:
    """Print the unknowns, the constraints, and which blocks the problem has."""
    console.print(f"[bold]{escape(explanation.title)}[/bold] (in {escape(explanation.units)})")
    console.print(escape(f"unknowns: {len(explanation.unknowns)}: {shortened(explanation.unknowns)}"))
    if explanation.fixed:
        console.print(escape(f"fixed: {len(explanation.fixed)}: {shortened(explanation.fixed)}"))
    for heading, rows in (("contacts", explanation.contacts), ("ties", explanation.ties)):
        console.print(f"{heading}: {len(rows)}")
        for row in rows[:MOST_ROWS]:
            console.print(escape(f"  {row}"))
    blocks = [[block.name, "included" if block.included else "left out", block.reason] for block in explanation.blocks]
    print_table(console, ["block", "", "why"], blocks)
