"""A scene of elastic bodies in words."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.elements.solid import Body
from contactqp.scene.bodies import BodyModel
from contactqp.scene.contact_entries import PairedContact
from contactqp.scene.explanation import (
    BuildingBlock,
    Explanation,
    counted,
    friction_block,
    motion_blocks,
    path_block,
    report_blocks,
)
from contactqp.scene.schema_contacts import Contact


def explain_bodies(model: BodyModel) -> Explanation:
    """Read off the meshes and the pairs; nothing is solved."""
    scene, names, system = model.scene, model.structure.unknown_names(), model.system
    held = np.flatnonzero(~np.isnan(system.prescribed))
    return Explanation(
        title=scene.title,
        units=f"{scene.units.length}, {scene.units.force}",
        unknowns=tuple(names[j] for j in system.free),
        fixed=tuple(names[j] for j in held),
        contacts=tuple(
            _contact(contact, paired, scene.units.length)
            for contact, paired in zip(scene.contacts, model.contacts, strict=True)
        ),
        ties=(),
        blocks=tuple(_blocks(model)),
    )


def _contact(contact: Contact, paired: PairedContact, length: str) -> str:
    sides = contact.touching_sides or (str(contact.membrane),)
    other = f"the obstacle {contact.obstacle!r}" if contact.obstacle else f"{sides[1]} by {contact.pairing}"
    gaps = paired.pairing.gap
    left_out = len(paired.pairing.unpaired)
    return (
        f"{contact.name}: {sides[0]} against {other}, {len(gaps)} nodes, "
        f"gaps from {gaps.min(initial=np.inf):.6g} to {gaps.max(initial=-np.inf):.6g} {length}"
        + (f", {left_out} nodes without a partner" if left_out else "")
    )


def _blocks(model: BodyModel) -> Iterator[BuildingBlock]:
    scene = model.scene
    for body in model.structure.bodies:
        kinds = ", ".join(block.kind.name for block in body.mesh.blocks)
        kind = body.model if isinstance(body, Body) else "membrane"
        size = f"{body.mesh.elements} elements ({kinds}), {len(body.mesh.points)} nodes, {kind}"
        yield BuildingBlock(f"body {body.name}", True, size)
    yield BuildingBlock("bars, springs, beams, strings, point masses", False, "none in a scene of bodies")
    held = int(np.sum(~np.isnan(model.system.prescribed)))
    yield counted("supports", held, "held unknown", "nothing is held")
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
