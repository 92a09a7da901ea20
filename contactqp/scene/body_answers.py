"""Evaluate the quantities that claims ask for in scenes of elastic bodies, and summarise long answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactqp.analysis import is_moving
from contactqp.elements.solid import von_mises
from contactqp.errors import InvalidProblem, SceneError
from contactqp.model.arrays import Array, Mask
from contactqp.scene.answers import OF_BOTH, Instant
from contactqp.scene.body_model import BodyModel, PairedContact
from contactqp.scene.claims import COMPONENTS, Claim
from contactqp.scene.schema import SceneData
from contactqp.scene.tables import DRAWN_AS_ZERO
from contactqp.scene.units import KINDS, vector

# Directions of motions have 1 as their largest component and are accurate to rounding.
SMALL = 1e-6
Table = tuple[list[str], list[list[str | float]]]


@dataclass(frozen=True, eq=False)
class BodyAnswer:
    """A solution of a scene of bodies at one instant, and its load path if it has one."""

    scene: SceneData
    model: BodyModel  # or the model of another engine with the same methods
    solution: Any  # a Solution or a DistributedSolution, for which every method is collective
    instant: Instant

    def value_of(self, claim: Claim) -> float | str:
        """Return the claim's quantity in the scene's units, or text.

        It is NaN for a contact width where no contact has force, and for the pressure at a supported node.
        """
        return _READERS[claim.quantity](claim, self)

    def contact(self, claim: Claim) -> PairedContact:
        """Return the entry of the scene's contacts that the claim names."""
        return self.model.contacts[self.model.place(str(claim.at))]

    def near(self, claim: Claim) -> Array:
        """Return the point of the claim, in the scene's unit of length."""
        return np.array(vector(self.scene.system, claim.near or ()))

    def node(self, claim: Claim) -> int:
        """Return the node of the claim's body at its point."""
        return self._node_at(claim, str(claim.at))

    def _node_at(self, claim: Claim, body: str) -> int:
        try:
            return self.model.node_at(body, self.near(claim))
        except InvalidProblem as error:
            raise SceneError(f"{claim}: {error}") from None

    def contact_node(self, claim: Claim) -> int:
        """Return the place, among a contact's nodes, of the one at the claim's point."""
        contact = self.contact(claim)
        node = self._node_at(claim, contact.body)
        place = np.flatnonzero(contact.pairing.nodes == node)
        if not place.size:
            raise SceneError(f"{claim}: near: expected a node of the contact, got node {node} of {contact.body!r}")
        return int(place[0])


def _node_displacement(claim: Claim, answer: BodyAnswer) -> float:
    body = str(claim.at)
    u = answer.model.displacement_at(body, answer.node(claim), answer.solution)
    axes = answer.model.structure.body(body).axes
    return float(u[axes.index(str(claim.along))]) if str(claim.along) in axes else 0.0


def _stress(claim: Claim, answer: BodyAnswer) -> float:
    stress = answer.model.stress_at(str(claim.at), answer.node(claim), answer.solution)
    if claim.component == "von-mises":
        return float(von_mises(stress))
    return float(stress[COMPONENTS.index(str(claim.component))])


def _contact_resultant(claim: Claim, answer: BodyAnswer) -> float:
    """Return the sum of -E_N' lambda, the forces on the nodes, over the nodes of the body, or of the slave of two."""
    forces = answer.model.resultant(str(claim.at), answer.solution)
    axes = answer.model.structure.body(answer.contact(claim).body).axes
    return float(forces[axes.index(str(claim.along))]) if str(claim.along) in axes else 0.0


def _half_width(claim: Claim, answer: BodyAnswer, nodes: Mask) -> float:
    apart = np.linalg.norm(answer.contact(claim).pairing.points - answer.near(claim), axis=1)
    return float(apart[nodes].max()) if nodes.any() else float("nan")


def _friction(claim: Claim, answer: BodyAnswer) -> Array:
    """Return lambda_T of each paired node along the claim's axis, (p,) [force]."""
    vectors = answer.model.friction_vectors(str(claim.at), answer.solution)
    return np.asarray(vectors[:, answer.scene.axes.index(str(claim.along))])


def _friction_traction(claim: Claim, answer: BodyAnswer) -> float:
    tractions = answer.model.friction_tractions(str(claim.at), answer.solution)
    return float(tractions[answer.contact_node(claim), answer.scene.axes.index(str(claim.along))])


def _energy(_: Claim, answer: BodyAnswer) -> float:
    return answer.model.energy(answer.solution, answer.instant.time)


def _support_force(claim: Claim, answer: BodyAnswer) -> float:
    """Return the sum over the nodes of the support; a node that two supports hold along one axis counts in both."""
    i = [support.name for support in answer.scene.supports].index(str(claim.at))
    return answer.model.support_force(i, answer.solution, answer.instant.time)


def _pressures(claim: Claim, answer: BodyAnswer) -> Array:
    return answer.model.pressures(str(claim.at), answer.solution)


def _node_velocity(claim: Claim, answer: BodyAnswer) -> float:
    model = answer.model
    v = model.structure.displacements(str(claim.at), model.velocity(answer.instant.velocity))
    return float(v[answer.node(claim), model.structure.body(str(claim.at)).axes.index(str(claim.along))])


def _event_time(claim: Claim, answer: BodyAnswer) -> float:
    numbers = answer.model.of_entry(str(claim.at), np.arange(len(answer.model.kept)), -1.0)
    return float(answer.instant.event(claim, [int(i) for i in numbers if i >= 0]).time)


def _impulse(claim: Claim, answer: BodyAnswer) -> float:
    return float(answer.model.of_entry(str(claim.at), answer.instant.impulses(), 0.0).sum())


_READERS: dict[str, Callable[[Claim, BodyAnswer], float | str]] = {
    "node displacement": _node_displacement,
    "stress": _stress,
    "contact force": lambda claim, answer: float(answer.model.normal_forces(str(claim.at), answer.solution).sum()),
    "contact resultant": _contact_resultant,
    "peak pressure": lambda claim, answer: float(np.fmax.reduce(_pressures(claim, answer))),
    "contact pressure": lambda claim, answer: float(_pressures(claim, answer)[answer.contact_node(claim)]),
    "contact half-width": lambda claim, answer: _half_width(
        claim, answer, answer.model.closed(str(claim.at), answer.solution)
    ),
    "stick half-width": lambda claim, answer: _half_width(
        claim, answer, answer.model.stuck(str(claim.at), answer.solution)
    ),
    "sticking contacts": lambda claim, answer: float(answer.model.stuck(str(claim.at), answer.solution).sum()),
    "friction resultant": lambda claim, answer: float(_friction(claim, answer).sum()),
    "friction traction": _friction_traction,
    **OF_BOTH,
    "node velocity": _node_velocity,
    "event time": _event_time,
    "contact impulse": _impulse,
    "closed contacts": lambda claim, answer: float(answer.model.closed(str(claim.at), answer.solution).sum()),
    "node gap": lambda claim, answer: float(
        answer.model.gaps(str(claim.at), answer.solution)[answer.contact_node(claim)]
    ),
    "support force": _support_force,
    "energy": _energy,
}


def summaries(model: BodyModel, solution: Any) -> Iterator[Table]:
    """Yield two tables: displacements and velocities of each body; force, peak pressure and gap of each contact."""
    system = model.scene.system
    length, force = system.length, system.force
    pressure = system.label(KINDS["pressure"].dimension)
    fields = [model.displacement(solution)]
    header = ["body", "along", f"lowest displacement [{length}]", f"highest [{length}]"]
    if is_moving(solution):
        fields.append(model.velocity(solution.velocity))
        header += [f"lowest velocity [{length}/s]", f"highest [{length}/s]"]
    rows: list[list[str | float]] = []
    for body in model.structure.bodies:
        ranges = [model.ranges(body.name, field) for field in fields]
        for i, axis in enumerate(body.axes):
            rows.append([body.name, axis, *(float(x) for r in ranges for x in r[i])])
    yield header, rows
    header = ["contact", "nodes", "pressing", f"normal force [{force}]", f"peak pressure [{pressure}]"]
    header.append(f"smallest gap [{length}]")
    if model.problem.frictional:
        header += ["sticking", *(f"friction {axis} [{force}]" for axis in model.scene.axes)]
    yield header, [list(row.values()) for row in _contacts(model, solution)]


def motions_in_words(model: BodyModel, solution: Any) -> list[str]:
    """Describe each free motion by the bodies that it moves: ``block along x``, or ``disc turning`` where nodes differ.

    The free motions of a solution are an arbitrary basis, which is reduced so that each moves a body that the others do
    not.
    """
    if not solution.free_motions:
        return []
    return [_motion_in_words(model, motion) for motion in _reduced(model, model.free_motions(solution))]


def _reduced(model: BodyModel, rows: Array) -> Array:
    """Return the reduced row echelon form."""
    rows = rows.copy()
    places = []
    for i in range(len(rows)):
        column, at = model.largest(rows, i)
        rows[i] /= column[i]
        others = np.arange(len(rows)) != i
        rows[others] -= np.outer(column[others], rows[i])
        places.append(at)
    reduced: Array = rows[np.argsort(places)]
    return reduced


def _motion_in_words(model: BodyModel, motion: Array) -> str:
    parts = []
    for body in model.structure.bodies:
        low, high = model.ranges(body.name, motion).T
        moving = np.flatnonzero(np.maximum(-low, high) > SMALL)
        if moving.size:
            same = bool(np.all((high - low)[moving] <= SMALL))
            along = " and ".join(body.axes[i] for i in moving)
            parts.append(f"{body.name} along {along}" if same else f"{body.name} turning")
    return ", ".join(parts)


def summary_data(model: BodyModel, solution: Any) -> dict[str, Any]:
    """Return the contacts of the scene and its free motions for JSON; forces and pressures in the scene's units."""
    return {
        "contacts": _contacts(model, solution),
        "contact_notes": model.notes,
        "free_motions": motions_in_words(model, solution),
    }


def _contacts(model: BodyModel, solution: Any) -> list[dict[str, str | float]]:
    rows: list[dict[str, str | float]] = []
    field = model.displacement(solution)
    ranges = [model.ranges(body.name, field) for body in model.structure.bodies]
    moved = max((float(np.max(np.abs(one))) for one in ranges), default=0.0)
    for contact in model.contacts:
        gaps = model.gaps(contact.name, solution)
        smallest = float(gaps.min()) if len(gaps) else 0.0
        rows.append(
            {
                "contact": contact.name,
                "nodes": len(contact.pairing.gap),
                "pressing": int(model.closed(contact.name, solution).sum()),
                "normal_force": float(model.normal_forces(contact.name, solution).sum()),
                "peak_pressure": float(np.nan_to_num(model.pressures(contact.name, solution)).max()),
                "smallest_gap": smallest if abs(smallest) > DRAWN_AS_ZERO * moved else 0.0,
            }
        )
        if model.problem.frictional:
            vectors = model.friction_vectors(contact.name, solution)
            total, size = vectors.sum(axis=0), float(np.linalg.norm(vectors, axis=1).sum())
            total[abs(total) <= DRAWN_AS_ZERO * max(size, float(rows[-1]["normal_force"]))] = 0.0
            rows[-1]["sticking"] = int(model.stuck(contact.name, solution).sum())
            rows[-1] |= {f"friction_{axis}": float(f) for axis, f in zip(model.scene.axes, total, strict=True)}
    return rows
