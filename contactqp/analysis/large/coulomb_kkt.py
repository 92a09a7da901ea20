"""Coulomb friction in the plane by signs: for tangents that are not convex, under compressed bars for instance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.large.active_kkt import solve_system
from contactqp.analysis.large.loaded_body import Forces
from contactqp.errors import NotConverged
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.statuses import OPEN, SLIP_BACK, SLIP_ON, STICK, Status

# What rounding may make of a length or a force, over the lengths and forces that meet.
ROUNDED = 1e-12
# Changes of combination that are tried, a contact.
CHANGES = 20


@dataclass(frozen=True, eq=False)
class Combination:
    """The answer on one combination of open, stick and slip."""

    increment: Vector
    normal: Vector  # (m,)
    friction: Vector  # (m,)
    tie: Vector


def coulomb_by_signs(K: Any, problem: ContactProblem, load: Vector, forces: Forces) -> tuple[Vector, Forces]:
    """u and forces with K u + E_N' l_N + E_T' l_T + A' nu = f and Coulomb's law, for any symmetric K.

    The combination of states is changed where its answer breaks the law: contacts in tension open, overlapping ones
    close and stick, friction beyond mu l_N slips, slip against its friction sticks; all at once until a combination
    comes back, then one contact at a time, which closes slipping as it moved. It starts from the states that
    `forces` show. Rows, gaps, slip origins and ties are those of `problem`, which has one tangent a contact.

    Raises
    ------
    NotConverged
        A singular system, or combinations that come back.
    """
    if problem.tangent is None or problem.friction is None or problem.slip_origin is None:
        raise ValueError("friction of a problem without tangential rows")
    status = _states(problem.friction, forces)
    seen: set[bytes] = set()
    one_by_one = False
    for _ in range(CHANGES * (problem.contacts + 1)):
        answer = _on(K, problem, load, status)
        changed = _lawful(problem, answer, status, one_by_one)
        differ = np.flatnonzero(changed != status)
        if not differ.size:
            return answer.increment, Forces(answer.normal, answer.tie, answer.friction[:, None])
        one_by_one |= status.tobytes() in seen
        seen.add(status.tobytes())
        status = status.copy()
        if one_by_one:  # the last contact that breaks the law: Murty's rule, which ends where the law has one answer
            differ = differ[-1:]
        status[differ] = changed[differ]
    raise NotConverged("the combination of stick and slip comes back: the tangent is indefinite there")


def _states(coefficient: Vector, forces: Forces) -> Status:
    friction = np.zeros_like(forces.normal) if forces.friction is None else forces.friction[:, 0]
    slips = (abs(friction) >= coefficient * forces.normal * (1 - ROUNDED)) & (abs(friction) > 0)
    closed = np.where(slips, np.sign(friction), STICK)
    return np.where(forces.normal > 0, closed, OPEN).astype(np.int8)


def _on(K: Any, problem: ContactProblem, load: Vector, status: Status) -> Combination:
    """Closed contacts have gap 0, sticking ones slip 0, and slipping ones l_T = +- mu l_N."""
    n, m, k = problem.dimension, problem.contacts, problem.ties
    B, S = np.flatnonzero(status != OPEN), np.flatnonzero(status == STICK)
    E_N, E_T = sp.csr_array(problem.normal), sp.csr_array(problem.tangent)
    ratio = np.where(abs(status) == SLIP_ON, status, 0) * np.asarray(problem.friction)
    pushed = sp.csr_array(E_N[B] + sp.diags(ratio[B]) @ E_T[B]) if B.size else E_N[B]
    rows = sp.vstack([E_N[B], E_T[S], problem.tie], format="csr")
    columns = sp.vstack([pushed, E_T[S], problem.tie], format="csr").T
    matrix = sp.bmat([[K, columns], [rows, None]], format="csc") if rows.shape[0] else sp.csc_array(K)
    origin = np.asarray(problem.slip_origin)[S, 0]
    found = solve_system(matrix, np.concatenate([load, problem.gap[B], origin, problem.tie_value]))
    normal, friction = np.zeros(m), np.zeros(m)
    normal[B] = found[n : n + len(B)]
    friction[S] = found[n + len(B) : n + len(B) + len(S)]
    friction += ratio * normal
    return Combination(found[:n], normal, friction, found[len(found) - k :])


def _lawful(problem: ContactProblem, answer: Combination, status: Status, slipping: bool) -> Status:
    """The states that the answer asks for; contacts close sticking, or `slipping` as they move while open."""
    u, bound = answer.increment, np.asarray(problem.friction) * answer.normal
    E_T, origin = sp.csr_array(problem.tangent), np.asarray(problem.slip_origin)[:, 0]
    excess, slip = problem.normal @ u - problem.gap, E_T @ u - origin
    apart = ROUNDED * (abs(problem.normal) @ abs(u) + abs(problem.gap))
    along = ROUNDED * (abs(E_T) @ abs(u) + abs(origin))
    changed = status.copy()
    slides = (status == STICK) & (abs(answer.friction) > bound * (1 + ROUNDED))
    changed[slides] = np.where(answer.friction[slides] > 0, SLIP_ON, SLIP_BACK)
    changed[(abs(status) == SLIP_ON) & (status * slip < -along)] = STICK
    closes = (status == OPEN) & (excess > apart)
    changed[closes] = np.where(slip[closes] > 0, SLIP_ON, SLIP_BACK) if slipping else STICK
    changed[(status != OPEN) & (answer.normal < 0)] = OPEN
    return changed
