"""What claims ask of an answer in pieces is what they ask of the whole one."""

import sys
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import contactqp as cq
from contactqp.distributed.distributed_bodies import distributed_model
from contactqp.distributed.ranks import Ranks
from contactqp.model.solution import Answer
from contactqp.scene.answers import Instant
from contactqp.scene.body_answers import BodyAnswer, motions_in_words, summaries
from contactqp.scene.building import build
from contactqp.scene.schema import end_time

ranks = Ranks()
OF_A_PATH = ("elastic energy", "work of the loads", "dissipated energy", "event time")


def distributed(model, solution):
    """The answer of one process, of which each rank has its part; as DistributedSolution."""
    d = model.problem
    here = np.where(d.constrained, 0.0, solution.displacement[d.dof_number])
    friction = None if solution.friction_force is None else solution.friction_force[d.contact_number]
    answer = Answer(here, solution.normal_force[d.contact_number], friction, np.zeros(0))
    whole = {name: getattr(solution, name) for name in ("normal_force", "friction_force", "gap", "contact_status")}
    motions = np.zeros((len(here), len(solution.free_motions)))
    for i, motion in enumerate(solution.free_motions):
        motions[:, i] = np.where(d.constrained, 0.0, motion.direction[d.dof_number])
    return SimpleNamespace(
        answer=answer, motions=motions, free_motions=solution.free_motions, certificate=solution.certificate, **whole
    )


def compare(path):
    scene = cq.load_scene(path)
    one, many = build(scene), distributed_model(scene, ranks)
    solution = cq.solve(one.problem)
    instant = Instant(end_time(scene))
    serial = BodyAnswer(scene, one, solution, instant)
    ours = BodyAnswer(scene, many, distributed(many, solution), instant)
    claims = [claim for claim in scene.expect if claim.quantity not in OF_A_PATH]
    assert claims or not scene.expect
    for claim in claims:
        same(claim, ours.value_of(claim), serial.value_of(claim))
    assert scene.contacts
    assert motions_in_words(many, ours.solution) == motions_in_words(one, solution)
    for (_, rows), (_, others) in zip(summaries(many, ours.solution), summaries(one, solution), strict=True):
        for row, other in zip(rows, others, strict=True):
            assert [x for x in row if isinstance(x, str)] == [x for x in other if isinstance(x, str)]
    for body in scene.bodies:
        theirs = one.ranges(body.name, one.displacement(solution))
        found = many.ranges(body.name, many.displacement(ours.solution))
        assert np.allclose(found, theirs, rtol=1e-12, atol=1e-12 * np.abs(theirs).max()), "ranges"
    assert np.isclose(many.energy(ours.solution, Fraction(1)), one.energy(solution, Fraction(1)), rtol=1e-10)
    for i in range(len(scene.supports)):
        a = many.support_force(i, ours.solution, instant.time)
        b = one.support_force(i, solution, instant.time)
        assert abs(a - b) <= 1e-9 * max(abs(solution.normal_force).sum(), abs(b)), f"support {i}: {a} and {b}"
    for contact in scene.contacts:
        a, b = many.resultant(contact.name, ours.solution), one.resultant(contact.name, solution)
        assert np.allclose(a, b, rtol=1e-12, atol=1e-12 * np.abs(b).max())
        pairing = one.contacts[one.place(contact.name)].pairing
        node = int(pairing.nodes[len(pairing.nodes) // 2])
        body = one.contacts[one.place(contact.name)].body
        at = one.structure.body(body).mesh.points[node]
        assert many.node_at(body, at) == node
        u = one.displacement_at(body, node, solution)
        assert np.allclose(many.displacement_at(body, node, ours.solution), u, rtol=1e-12, atol=1e-12 * np.abs(u).max())
        s = one.stress_at(body, node, solution)
        assert np.allclose(many.stress_at(body, node, ours.solution), s, rtol=1e-10, atol=1e-10 * np.abs(s).max())


def same(claim, a, b):
    if isinstance(b, str):
        assert a == b
    else:
        assert (np.isnan(a) and np.isnan(b)) or abs(a - b) <= 1e-9 * max(abs(b), 1e-12), f"{claim}: {a} and {b}"


for path in sys.argv[1:]:
    compare(Path(path))
    if ranks.rank == 0:
        print(f"{Path(path).stem}: the same on {ranks.size}", flush=True)
