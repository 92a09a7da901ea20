"""The quantities of quantities.QUANTITIES, read off a scene and its answer."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np

from contactqp.analysis.large.deformation import LargeSolution
from contactqp.elements import bar, spring
from contactqp.scene import elimination
from contactqp.scene.answers_of_large import OF_LARGE
from contactqp.scene.answers_of_motions import OF_MOTIONS
from contactqp.scene.answers_of_nodes import Answer
from contactqp.scene.building import spring_direction
from contactqp.scene.claims import Claim
from contactqp.scene.exact_numbers import point
from contactqp.scene.friction_axes import friction_along_axes
from contactqp.scene.quantities import uniqueness_in_words


def _contact(claim: Claim, answer: Answer) -> int:
    return next(i for i, contact in enumerate(answer.scene.contacts) if contact.name == claim.at)


def _tie_force(claim: Claim, answer: Answer) -> float:
    names = [tie.name for tie in answer.scene.ties]
    return float(answer.solution.tie_force[names.index(str(claim.at))])


def _reaction(claim: Claim, answer: Answer) -> float:
    """r = K u + E_N' l_N + E_T' l_T + A' nu - f at a fixed unknown: the force of the support on the body."""
    at, exact, solution = str(claim.at), answer.exact, answer.solution
    if isinstance(solution, LargeSolution):
        from contactqp.scene.deforming import DeformableModel

        return float(DeformableModel(answer.model).support_forces(solution)[exact.unknowns.place[at]])
    stiffness = sum(float(k) * answer.displacement(j) for (i, j), k in exact.stiffness.items() if i == at)
    rows = [*(contact.normal for contact in exact.contacts), *(tie.row for tie in exact.ties)]
    forces = [*solution.normal_force, *solution.tie_force]
    if solution.friction_force is not None:
        rows += [row for contact in exact.contacts for row in contact.tangent]
        forces += [*solution.friction_force.ravel()]
    constraints = sum(float(row.get(at, 0)) * float(force) for row, force in zip(rows, forces, strict=True))
    return stiffness + constraints - float(answer.model.exact_load_at(answer.instant.time).get(at, 0))


def _bar_force(claim: Claim, answer: Answer) -> float:
    scene = answer.scene
    if scene.large:
        from contactqp.scene.deforming import DeformableModel

        return DeformableModel(answer.model).bar_force(str(claim.at), answer.solution.displacement)
    item = next(bar for bar in scene.bars if bar.name == claim.at)
    start, end = (point(scene, node) for node in item.nodes)
    displacement = np.concatenate([answer.of_node(node) for node in item.nodes])
    modulus, area = scene.system.value(item.modulus), scene.system.value(item.area)
    return float(bar.truss_axial_force(modulus, area, start, end, displacement))


def _spring_force(claim: Claim, answer: Answer) -> float:
    """A spring to the ground is stretched by its node's displacement."""
    scene = answer.scene
    item = next(item for item in scene.springs if item.name == claim.at)
    relative = answer.of_node(item.nodes[-1])
    if len(item.nodes) == 2:
        relative = relative - answer.of_node(item.nodes[0])
    return float(spring.force(scene.system.value(item.stiffness), spring_direction(scene, item), relative))


def _closing(claim: Claim, answer: Answer) -> float:
    """The load factor at which the contact first closes."""
    return _event_time(claim.model_copy(update={"event": "closed"}), answer)


def _closing_load(claim: Claim, answer: Answer) -> float:
    return _closing(claim, answer) * float(answer.exact.load.get(str(claim.along), 0))


def _event_time(claim: Claim, answer: Answer) -> float:
    return float(answer.instant.event(claim, [_contact(claim, answer)]).time)


def _event_load(claim: Claim, answer: Answer) -> float:
    time = Fraction(_event_time(claim, answer))
    return float(answer.model.exact_load_at(time).get(str(claim.along), 0))


def _events(claim: Claim, answer: Answer) -> int:
    return sum(event.contact == _contact(claim, answer) for event in answer.instant.events)


def _along_axis(claim: Claim, answer: Answer, values: Any) -> float:
    axis = answer.scene.axes.index(str(claim.along))
    return float(values[_contact(claim, answer), axis])


def _velocity(claim: Claim, answer: Answer) -> float:
    return float(answer.instant.velocity[answer.exact.unknowns.free.index(str(claim.at))])


def _columns(claim: Claim, answer: Answer) -> tuple[str, ...]:
    return claim.unknowns or answer.exact.unknowns.free


READERS: dict[str, Callable[[Claim, Answer], Any]] = {
    "displacement": lambda claim, answer: answer.displacement(str(claim.at)),
    "normal force": lambda claim, answer: float(answer.solution.normal_force[_contact(claim, answer)]),
    "total normal force": lambda _, answer: float(answer.solution.normal_force.sum()),
    "gap": lambda claim, answer: float(answer.solution.gap[_contact(claim, answer)]),
    "status": lambda claim, answer: str(answer.solution.contact_status[_contact(claim, answer)]),
    "friction force": lambda claim, answer: _along_axis(
        claim, answer, friction_along_axes(answer.model, answer.solution)
    ),
    "slip": lambda claim, answer: _along_axis(claim, answer, answer.model.along_axes(answer.solution.slip)),
    "tie force": _tie_force,
    "reaction": _reaction,
    "bar force": _bar_force,
    "spring force": _spring_force,
    "energy": lambda _, answer: answer.solution.energy,
    "elastic energy": lambda claim, answer: answer.instant.energies(claim).elastic,
    "work of the loads": lambda claim, answer: answer.instant.energies(claim).work,
    "dissipated energy": lambda claim, answer: answer.instant.energies(claim).dissipated,
    **OF_MOTIONS,
    **OF_LARGE,
    "velocity": _velocity,
    "contact impulse": lambda claim, answer: float(answer.instant.impulses()[_contact(claim, answer)]),
    "free motions": lambda _, answer: len(answer.solution.free_motions),
    "uniqueness": lambda _, answer: uniqueness_in_words(answer.solution.certificate.uniqueness),
    "closing load factor": _closing,
    "closing load": _closing_load,
    "event time": _event_time,
    "event load": _event_load,
    "events": _events,
    "stiffness": lambda claim, answer: answer.exact.stiffness.get((str(claim.at), str(claim.along)), Fraction(0)),
    "tie matrix": lambda claim, answer: elimination.tie_matrix(answer.exact, _columns(claim, answer)),
    "tie rank": lambda _, answer: elimination.rank(answer.exact),
    "reduced stiffness": lambda claim, answer: elimination.reduced_stiffness(answer.exact, _columns(claim, answer)),
    "reduced load": lambda claim, answer: elimination.reduced_load(answer.exact, _columns(claim, answer)),
}
