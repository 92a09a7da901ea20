"""The quantities of quantities.QUANTITIES that are asked of elastic bodies, read off a model and its solution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.solid import von_mises
from contactqp.errors import InvalidProblem, SceneError
from contactqp.scene.answers_of_motions import OF_MOTIONS
from contactqp.scene.bodies import BodyModel
from contactqp.scene.claims import Claim
from contactqp.scene.contact_entries import PairedContact
from contactqp.scene.instant import Instant
from contactqp.scene.quantities import COMPONENTS, uniqueness_in_words
from contactqp.scene.schema import SceneData
from contactqp.scene.units import vector


@dataclass(frozen=True, eq=False)
class BodyAnswer:
    """A solution of a scene of bodies at one instant, and its load path if it has one."""

    scene: SceneData
    model: BodyModel  # or what another engine builds, which answers the same questions
    solution: Any  # a Solution, or a DistributedSolution: then every question is collective
    instant: Instant

    def value_of(self, claim: Claim) -> float | str:
        """The claim's quantity in the scene's units, or words.

        NaN where nothing presses and a width is asked for, and for the pressure at a node that supports hold.
        """
        return _READERS[claim.quantity](claim, self)

    def contact(self, claim: Claim) -> PairedContact:
        return self.model.contacts[self.model.place(str(claim.at))]

    def near(self, claim: Claim) -> NDArray[np.float64]:
        """The point of the claim, in the scene's unit of length."""
        return np.array(vector(self.scene.system, claim.near or ()))

    def node(self, claim: Claim) -> int:
        """The node of the claim's body at its point."""
        return self._node_at(claim, str(claim.at))

    def _node_at(self, claim: Claim, body: str) -> int:
        try:
            return self.model.node_at(body, self.near(claim))
        except InvalidProblem as error:
            raise SceneError(f"{claim}: {error}") from None

    def contact_node(self, claim: Claim) -> int:
        """The place among a contact's nodes of the one at the claim's point."""
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
    """The sum of -E_N' lambda, the forces on the nodes, over the nodes of the body, or of the slave of two."""
    forces = answer.model.resultant(str(claim.at), answer.solution)
    axes = answer.model.structure.body(answer.contact(claim).body).axes
    return float(forces[axes.index(str(claim.along))]) if str(claim.along) in axes else 0.0


def _half_width(claim: Claim, answer: BodyAnswer, nodes: NDArray[np.bool_]) -> float:
    apart = np.linalg.norm(answer.contact(claim).pairing.points - answer.near(claim), axis=1)
    return float(apart[nodes].max()) if nodes.any() else float("nan")


def _friction(claim: Claim, answer: BodyAnswer) -> NDArray[np.float64]:
    """lambda_T of each paired node along the claim's axis, (p,)."""
    vectors = answer.model.friction_vectors(str(claim.at), answer.solution)
    return np.asarray(vectors[:, answer.scene.axes.index(str(claim.along))])


def _friction_traction(claim: Claim, answer: BodyAnswer) -> float:
    tractions = answer.model.friction_tractions(str(claim.at), answer.solution)
    return float(tractions[answer.contact_node(claim), answer.scene.axes.index(str(claim.along))])


def _energy(_: Claim, answer: BodyAnswer) -> float:
    return answer.model.energy(answer.solution, answer.instant.time)


def _support_force(claim: Claim, answer: BodyAnswer) -> float:
    """Summed over the nodes of the support; a node that two supports hold along one axis counts in both."""
    i = [support.name for support in answer.scene.supports].index(str(claim.at))
    return answer.model.support_force(i, answer.solution, answer.instant.time)


def _pressures(claim: Claim, answer: BodyAnswer) -> NDArray[np.float64]:
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
    "elastic energy": lambda claim, answer: answer.instant.energies(claim).elastic,
    "work of the loads": lambda claim, answer: answer.instant.energies(claim).work,
    "dissipated energy": lambda claim, answer: answer.instant.energies(claim).dissipated,
    **OF_MOTIONS,
    "node velocity": _node_velocity,
    "event time": _event_time,
    "contact impulse": _impulse,
    "closed contacts": lambda claim, answer: float(answer.model.closed(str(claim.at), answer.solution).sum()),
    "node gap": lambda claim, answer: float(
        answer.model.gaps(str(claim.at), answer.solution)[answer.contact_node(claim)]
    ),
    "support force": _support_force,
    "energy": _energy,
    "free motions": lambda _, answer: float(len(answer.solution.free_motions)),
    "uniqueness": lambda _, answer: uniqueness_in_words(answer.solution.certificate.uniqueness),
}
