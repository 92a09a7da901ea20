"""Solve and certify problems of very many contacts by a subset that may close, and check all the others.

If the solution with a subset of the contacts, E_C u <= g_C, penetrates none of the others, it solves the problem with
all of them, as the others have no force. Otherwise the penetrated contacts and their neighbours are added; as the
subset only grows, this ends. With Coulomb friction in space, where each contact retains three rows, the subset consists
of the contacts closed without friction and their neighbours.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from contactqp.certificate.bounds import Bounds, error_bounds, no_bounds
from contactqp.certificate.figures import violations
from contactqp.certificate.state_answer import last_verdict, state_verdict
from contactqp.certificate.state_bodies import StateVerdict, figures_alone
from contactqp.linalg.condensation import condense
from contactqp.linalg.dense import RigidMotions
from contactqp.linalg.extended import Residuals, extend, residuals
from contactqp.linalg.iteration import contacts_are_many
from contactqp.linalg.least_norm import WITHIN_ROUNDING
from contactqp.linalg.measures import lay_out, lengths_that_meet, own_compliance
from contactqp.model.arrays import TINY, Indices, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer

# The number of contact unknowns of the first subset.
FIRST = 1000
# Layers of unknowns around a penetrated contact whose contacts are added with it; and around one closed without
# friction, as friction changes the edge of contact slightly.
LAYERS, LAYERS_OF_FRICTION = 3, 1
# Contacts of another code's answer may be closed if the gap is below this part of the lengths that meet.
MAY_CLOSE = 1e-6
# The number of enlargements of a certificate's subset before it has no bound.
WIDENINGS = 5
TOO_WIDE = f"the candidate contacts were widened {WIDENINGS} times, and others still close"


def first_candidates(problem: ContactProblem) -> Indices | None:
    """Return the contacts nearest to closing in energy, or those of the last load; None if all are few enough."""
    if not contacts_are_many(problem):
        return None
    if problem._computed.subset is not None:
        return np.asarray(problem._computed.subset[0])
    touched = len(np.unique(problem.normal.indices))
    nearness = problem.gap / np.sqrt(np.maximum(own_compliance(problem, problem.normal), TINY))
    count = max(1, FIRST * problem.contacts // touched)
    return np.sort(np.argsort(nearness, kind="stable")[:count])


def candidates_around(problem: ContactProblem, closed: Indices) -> Indices:
    """Return the closed contacts, or the nearest ones, with their neighbours and the previous subset."""
    closed = closed if closed.size else _nearest(problem)
    return _with_former(problem, np.union1d(closed, _near(problem, closed, LAYERS_OF_FRICTION)))


def believed_candidates(problem: ContactProblem, answer: Answer) -> Indices:
    """Return the contacts that an answer closes, or the nearest ones, and the previous subset."""
    gap = problem.gap - problem.normal @ answer.displacement
    length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement)
    closed = np.flatnonzero((answer.normal_force != 0) | (gap <= MAY_CLOSE * length))
    return _with_former(problem, closed if closed.size else _nearest(problem))


def _with_former(problem: ContactProblem, contacts: Indices) -> Indices:
    """Return contacts together with the subset onto which the problem was condensed before."""
    before = contacts if problem._computed.subset is None else problem._computed.subset[0]
    return np.union1d(before, contacts).astype(np.intp)


def _nearest(problem: ContactProblem) -> Indices:
    return np.array([np.argmin(problem.gap)], dtype=np.intp)


def candidates_of(problem: ContactProblem) -> Indices | None:
    """Return the contacts onto which a solved problem was condensed, None if these are all."""
    return None if problem._computed.subset is None else np.asarray(problem._computed.subset[0])


def take_all(problem: ContactProblem) -> None:
    """Condense a problem onto all contacts from now on."""
    problem._computed.subset, problem._computed.all_contacts[problem.frictional] = None, True


def among(problem: ContactProblem, candidates: Indices) -> ContactProblem:
    """Return the problem with some of its contacts, kept with its condensation for further loads."""
    computed = problem._computed
    computed.subset = _with_contacts(problem, candidates, computed.subset)
    return _under_its_load(problem, candidates, computed.subset[1])


def _judged_among(problem: ContactProblem, candidates: Indices) -> ContactProblem:
    """Return `among` for a certificate, whose subset is kept separately from that of the solution."""
    computed = problem._computed
    if computed.subset is not None and np.array_equal(computed.subset[0], candidates):
        return _under_its_load(problem, candidates, computed.subset[1])
    computed.judged_subset = _with_contacts(problem, candidates, computed.judged_subset)
    return _under_its_load(problem, candidates, computed.judged_subset[1])


Subset = tuple[Indices, ContactProblem]  # contacts, and the problem with these alone


def _with_contacts(problem: ContactProblem, candidates: Indices, before: Subset | None) -> Subset:
    """Return the contacts with the problem of these alone, the previous one if they are the same."""
    if before is not None and np.array_equal(before[0], candidates):
        return before
    lay_out(problem)
    subset = problem.with_contacts(candidates)
    subset._computed.all_contacts = {True: True, False: True}
    subset._computed.wider_condensation = problem._computed.condensation
    return candidates, subset


def _under_its_load(problem: ContactProblem, candidates: Indices, subset: ContactProblem) -> ContactProblem:
    """Return the subset's problem under the load, gaps and tie values of the whole problem."""
    friction, origin = problem.friction, problem.slip_origin
    coulomb: dict[str, Any] = {}
    if friction is not None and origin is not None:
        coulomb = {"friction": friction[candidates], "slip_origin": origin[candidates]}
    return subset.replace(
        **coulomb,
        load=problem.load,
        gap=problem.gap[candidates],
        tie_value=problem.tie_value,
        dof_names=problem.dof_names,
        contact_names=[problem.contact_name(int(i)) for i in candidates],
        units=problem.units,
    )


def widened(problem: ContactProblem, candidates: Indices, gap: Vector, u: Vector) -> Indices | None:
    """Return the subset enlarged by contacts that a displacement closes and their neighbours, None if it closes no
    other.

    Parameters
    ----------
    problem : ContactProblem
    candidates : (q,) array of int, numbers of contacts
    gap : (m,) array [length], the gaps of all contacts at the displacement
    u : (n,) array [length], the displacement
    """
    length = lengths_that_meet(problem, problem.normal, problem.gap, u)
    closed = np.setdiff1d(np.flatnonzero(gap <= WITHIN_ROUNDING * length), candidates)
    if not closed.size:
        return None
    return np.union1d(candidates, np.union1d(closed, _near(problem, closed, LAYERS))).astype(np.intp)


def _near(problem: ContactProblem, contacts: Indices, layers: int) -> Indices:
    """Return the contacts within a number of layers of unknowns around some of them."""
    rows, K = abs(problem.normal), problem.stiffness_rows
    near = np.zeros(problem.dimension, dtype=bool)
    near[rows[contacts].indices] = True
    for _ in range(layers):
        near[K[np.flatnonzero(near)].indices] = True
    return np.flatnonzero(rows @ near.astype(float))


def bounds_among(
    problem: ContactProblem, answer: Answer, residual: Residuals, candidates: Indices
) -> tuple[Bounds, RigidMotions]:
    """Return the bounds of an answer from the problem of a subset of contacts, and the bodies' rigid motions.

    They hold for the whole problem, since the solution of the subset, accurate to its last digits, leaves all other
    contacts open; these then have no force, with a bound by (1) of `bounds`.

    Parameters
    ----------
    problem : ContactProblem
    answer : the answer with all contacts; those that are not candidates have no force
    residual : the residuals of the answer
    candidates : (q,) array of int, contacts; more are taken where the solution closes others
    """
    for _ in range(WIDENINGS):
        subset = _judged_among(problem, candidates)
        condensation = condense(subset)
        subset_answer = Answer(answer.displacement, answer.normal_force[candidates], None, answer.tie_force)
        bounds = error_bounds(
            subset, subset_answer, Residuals(residual.force, residual.gap[candidates], residual.tie), condensation
        )
        if bounds.solution is None:
            reasons = bounds.reasons or ("no set of candidate contacts holds",)
            return replace(no_bounds(reasons[0].split(": ", 1)[-1]), suspicious=bounds.suspicious), condensation.rigid
        u = bounds.solution
        gap = (extend(problem.gap) - problem.normal @ u.double()).double()
        wider = widened(problem, candidates, gap, u.double())
        if wider is None:
            return _of_all(problem, candidates, bounds, gap), condensation.rigid
        candidates = wider
    return no_bounds(TOO_WIDE), condensation.rigid


def state_among(
    problem: ContactProblem, answer: Answer, candidates: Indices, tolerances: tuple[float, float]
) -> tuple[StateVerdict, RigidMotions]:
    """Return the verdict on a frictional answer by its own combination, in which all other contacts are open.

    It is a combination of the whole problem if its displacement penetrates no other contact.

    Parameters
    ----------
    problem : ContactProblem
    answer : the answer with all contacts; those that are not candidates have no force
    candidates : (q,) array of int, contacts; more are taken where the displacement closes others
    tolerances : two floats, those of `state_verdict`
    """
    for _ in range(WIDENINGS):
        subset = _judged_among(problem, candidates)
        condensation = condense(subset)
        friction = None if answer.friction_force is None else answer.friction_force[candidates]
        subset_answer = Answer(answer.displacement, answer.normal_force[candidates], friction, answer.tie_force)
        verdict = last_verdict(subset, subset_answer, tolerances)
        if verdict is None:  # otherwise the answer of the subset was judged when it was found
            found = violations(
                subset, subset_answer, residuals(subset, subset_answer), tolerances[1], condensation.rigid
            )
            verdict = state_verdict(subset, subset_answer, found, condensation, tolerances)
        u = answer.displacement if verdict.displacement is None else verdict.displacement
        wider = widened(problem, candidates, problem.gap - problem.normal @ u, u)
        if wider is None:
            return verdict, condensation.rigid
        candidates = wider
    return figures_alone(TOO_WIDE), condensation.rigid


def _of_all(problem: ContactProblem, candidates: Indices, bounds: Bounds, gap: Vector) -> Bounds:
    """Return the bounds with an entry for every contact."""
    if bounds.force_bound is None or bounds.energy_error is None:
        return bounds
    distance = bounds.energy_error * (bounds.energy_scale or 1.0)
    force = distance**2 / (2 * np.where(gap > 0, gap, np.inf))
    force[candidates] = bounds.force_bound
    relative = None
    if bounds.relative_force_bound is not None:
        relative = force * np.sqrt(own_compliance(problem, problem.normal)) / bounds.force_scale
        relative[candidates] = bounds.relative_force_bound
    single = bounds.single and bounds.single.among(problem, (candidates, np.arange(problem.ties)))
    return replace(bounds, force_bound=force, relative_force_bound=relative, single=single)
