"""Whether forces of a local problem are the only ones, as far as the Delassus operator and the state of contacts tell.

Velocities: `contactqp.certificate.critical_coefficients` on W; where it does not exclude other answers, they may exist.
Forces: with B the directions in which closed contacts push (a contact that sticks in all, one that slips along its
force on the cone), others belong to the same velocities where [[B'WB, B'V], [V'B, R]] is singular. Each contact is
scaled to a compliance of one.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.critical_coefficients import MOST_CONTACTS, CriticalFriction, of_operator
from contactqp.certificate.uniqueness import DEPENDENT, FORCES, POSSIBLE, UNKNOWN, Uniqueness
from contactqp.model.arrays import Array, Vector
from contactqp.model.local_problem import LocalProblem

# Operators further from symmetric than this, the tolerance of the verdict, are said to be.
ROUNDING = 1e-9

_critical: WeakKeyDictionary[LocalProblem, CriticalFriction] = WeakKeyDictionary()


def local_uniqueness(
    problem: LocalProblem, closed: NDArray[np.bool_], stuck: NDArray[np.bool_], along: Array
) -> Uniqueness:
    """Of forces that close and hold contacts (m,); `along` (m, d) are the directions of force of those that slip."""
    if not problem.contacts or not np.any(problem.friction > 0):
        return Uniqueness()
    notes = []
    if problem.scaled_asymmetry > ROUNDING:
        notes.append(
            f"delassus is not symmetric by {problem.scaled_asymmetry:.2g} of its largest entry; the forces are judged "
            "by it as given, what a minimisation makes of it is that far off"
        )
    if problem.contacts > MOST_CONTACTS:
        reason = f"{problem.contacts} contacts, at most {MOST_CONTACTS} are examined"
        return Uniqueness((UNKNOWN,), (*notes, f"uniqueness was not examined: {reason}"))
    findings = []
    if _dependent(problem, closed, stuck, along):
        findings.append(FORCES)
        notes.append("redundant contacts: other forces belong to the same velocities")
    known = _known(problem)
    if not known.unique:
        findings.append(POSSIBLE)
        notes.append(f"friction: several answers {_reason(problem, known)}")
    return Uniqueness(tuple(findings), tuple(notes))


def _known(problem: LocalProblem) -> CriticalFriction:
    if problem not in _critical:
        W = problem.scaled_delassus.toarray()
        symmetric = problem.scaled_asymmetry <= ROUNDING
        _critical[problem] = of_operator(
            W, problem.friction, problem.contacts, floats=problem.joints > 0, symmetric=symmetric
        )
    return _critical[problem]


def _reason(problem: LocalProblem, known: CriticalFriction) -> str:
    if known.above.size:
        i = int(np.argmax(known.ratio))
        return (
            f"may exist: mu = {problem.friction[i]:.3g} of {problem.contact_name(i)} is not below the critical "
            f"{known.single[i]:.3g}"
        )
    return f"are not excluded: largest mu/mu_c of a contact alone {known.contraction:.3g}"


def _dependent(problem: LocalProblem, closed: NDArray[np.bool_], stuck: NDArray[np.bool_], along: Array) -> bool:
    d, columns = problem.dimension, list[Vector]()
    for i in np.flatnonzero(closed).tolist():
        own = np.eye(d) if stuck[i] else along[i : i + 1]
        for direction in own:
            column = np.zeros(d * problem.contacts)
            column[d * i : d * (i + 1)] = direction
            columns.append(column)
    if not columns:
        return False
    B = np.array(columns).T
    joints, scale = problem.joint_scale, np.repeat(problem.contact_scale, d)
    coupling = B.T @ (problem.bilateral.toarray() * np.outer(scale, joints))
    inner = problem.bilateral_delassus.toarray() * np.outer(joints, joints)
    matrix = np.block([[B.T @ (problem.scaled_delassus @ B), coupling], [coupling.T, inner]])
    size = np.sqrt(np.maximum(np.max(abs(matrix), axis=1, initial=0.0), np.finfo(float).tiny))
    values = np.linalg.svd(matrix / np.outer(size, size), compute_uv=False)
    return bool(values[-1] <= DEPENDENT * values[0])
