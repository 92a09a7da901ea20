"""A displacement that penetrates nowhere and forces that pull nowhere, near a candidate: what its bounds are made of.

The pair is got from the candidate's own set of closed contacts: the refined answer on it is the solution if its signs
hold. Where they do not, the set is corrected; where no set is found, the candidate itself is repaired: its contacts
closed, its tensions dropped. However the pair was found, it is judged by the problem alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.condensation import Condensation
from contactqp.delassus import delassus
from contactqp.energy_norm import CONTRACTION, energy_norm, force_norm, residual_noise, response
from contactqp.extended import Extended, extend, extended_rows
from contactqp.nonnegative import Infeasible, dual_active_set
from contactqp.polishing import CAUTION, WITHIN_ROUNDING, OnSet, closed_contacts, correction, polish
from contactqp.problem import ContactProblem
from contactqp.saddle import SaddlePoint, saddle_point
from contactqp.violations import Answer, Residuals, lengths_that_meet, stiffness_sizes

# Corrections of each set that the candidate may mean, and of the first when all of them have failed.
CORRECTIONS, LAST_CORRECTIONS = 3, 50
# A gap or a force of this part of its lengths or of the largest force is taken for none in a candidate of engineering
# accuracy.
TOUCHING = 1e-6
# Sweeps of refinement that close contacts: the residual contracts by eps * condition number in each.
CLOSING_SWEEPS = 4
# A gap beneath this part of its lengths is zero in extended precision too.
ZERO_GAP = 2.0**-90
# Resultants of forces that are this part of the forces balance.
BALANCED = 1e-12


@dataclass(frozen=True, eq=False)
class AdmissiblePair:
    """v with E v <= g, A v = b and forces l >= 0 in balance; w the response to l; c = (v + w)/2; u the candidate."""

    to_middle: Extended  # (n,) c - u
    radius: float  # >= |c - u*|_K
    dual_radius: float  # >= |w - u*|_K
    force: Extended  # (m,) l
    open_gap: NDArray[np.float64]  # (m,) g - E v
    saddle: SaddlePoint  # of the contacts that were closed for v
    exact: bool  # v and l are the solution, to rounding
    undecided: float  # what the contacts that touch or push by no more than rounding leave open [root of energy]


class Unproven(Exception):
    """Why there is no pair."""


def admissible_pair(
    problem: ContactProblem, answer: Answer, left: Residuals, condensation: Condensation
) -> AdmissiblePair:
    """The pair nearest to the solution that can be had.

    Raises
    ------
    Unproven
        There is none, or refinement does not converge.
    """
    sets = _believed_sets(problem, answer, condensation)
    for closed, corrections in (*((closed, CORRECTIONS) for closed in sets), (sets[0], LAST_CORRECTIONS)):
        if (found := _holding(problem, condensation, closed, corrections, answer, left)) is not None:
            return _from_set(problem, answer, condensation, found)
    searched = _searched_set(problem, condensation)
    if (
        searched is not None
        and (found := _holding(problem, condensation, searched, CORRECTIONS, answer, left)) is not None
    ):
        return _from_set(problem, answer, condensation, found)
    return _from_repair(problem, answer, condensation, sets[0])


def _holding(
    problem: ContactProblem,
    condensation: Condensation,
    closed: NDArray[np.intp],
    corrections: int,
    answer: Answer,
    left: Residuals,
) -> OnSet | None:
    """The refined answer on a set, or on what corrections make of it, if its signs hold."""
    start = None if condensation.rigid.count else answer
    on_set, _, holds = polish(problem, condensation, closed, corrections, start, left, CAUTION)
    if on_set.contraction >= CONTRACTION:
        raise Unproven(
            f"the refinement contracts by {on_set.contraction:.2g} only: the stiffness is singular to working precision"
        )
    return on_set if holds else None


def _believed_sets(problem: ContactProblem, answer: Answer, condensation: Condensation) -> list[NDArray[np.intp]]:
    """The contacts closed by gap and force together, and, should these disagree, by either alone."""
    u, force = answer.displacement, answer.normal_force
    length = lengths_that_meet(problem, problem.normal, problem.gap, u)
    touching = np.flatnonzero(problem.gap - problem.normal @ u <= TOUCHING * length)
    size = force * np.sqrt(delassus(condensation).compliance[: problem.contacts])
    pushing = np.flatnonzero(size > TOUCHING * np.max(abs(size), initial=0.0))
    acting = np.flatnonzero(abs(size) > TOUCHING * np.max(abs(size), initial=0.0))  # of the wrong sign, perhaps
    return [closed_contacts(problem, condensation, u, force), touching, pushing, acting]


def _searched_set(problem: ContactProblem, condensation: Condensation) -> NDArray[np.intp] | None:
    """The closed contacts by a finite method, where corrections of sets go round in circles; None if bodies float."""
    if condensation.rigid.count:
        return None
    operator = delassus(condensation)
    load, _ = condensation.reduce_load(problem.load)
    data = operator.dual_data(problem, operator.free_response(load, np.zeros(len(load))))
    try:
        force, _, ended = dual_active_set(*data, 50 * problem.contacts + 50)
    except Infeasible:
        return None
    return np.flatnonzero(force[: problem.contacts] > 0) if ended else None


def _from_set(problem: ContactProblem, answer: Answer, condensation: Condensation, on_set: OnSet) -> AdmissiblePair:
    """The refined answer on a set whose signs hold is the solution, to its last correction and to `undecided`."""
    undecided = _undecided(problem, condensation, on_set)
    # Entries of size s in the square root of energy make at most s sqrt(nnz(K)) of displacement and s m of forces.
    entries = np.sqrt(stiffness_sizes(problem).size) + problem.contacts
    allowance = entries * on_set.remainder + residual_noise(problem, answer) + undecided
    return AdmissiblePair(
        to_middle=on_set.displacement - extend(answer.displacement),
        radius=allowance,
        dual_radius=allowance,
        force=on_set.normal_force.positive_part(),
        open_gap=np.maximum(on_set.gap.double(), 0.0),
        saddle=on_set.saddle,
        exact=True,
        undecided=undecided,
    )


def _undecided(problem: ContactProblem, condensation: Condensation, on_set: OnSet) -> float:
    """How far the solution may be from an answer whose signs hold only to rounding.

    Contacts penetrated by d > 0 are open and their forces zero in an answer u' that solves the problem with gaps g + d
    there. Let w be the least displacement with E w = -d there and E w = 0 on the closed contacts, A w = 0. Then u* - w
    is the solution in these gaps under the load f - K w, and the solution depends on the load with constant one in the
    energy norm: |u* - u'| <= 2 |w|. Forces in tension that are left out change the response by their own norm.
    """
    closed = on_set.saddle.closed
    length = lengths_that_meet(problem, problem.normal, problem.gap, on_set.displacement.double())
    penetrated = np.setdiff1d(np.flatnonzero(-on_set.gap.double() > ZERO_GAP * length), closed)
    undecided = 0.0
    if penetrated.size:
        larger = np.union1d(closed, penetrated).astype(np.intp)
        gap = np.where(np.isin(larger, penetrated), on_set.gap.double()[larger], 0.0)
        nothing = extend(np.zeros(problem.dimension)), extend(gap), extend(np.zeros(problem.ties))
        closing, _, _ = correction(condensation, saddle_point(condensation, larger), *nothing)
        undecided += 2 * sum(energy_norm(problem, extend(closing)))
    tension = (-on_set.normal_force).positive_part()
    if np.any(tension.double()):
        undecided += sum(force_norm(problem, condensation, tension))
    return undecided


def _from_repair(
    problem: ContactProblem, answer: Answer, condensation: Condensation, closed: NDArray[np.intp]
) -> AdmissiblePair:
    """v: the candidate with its contacts closed; l: its forces without tension, balanced."""
    rows = extended_rows(problem)
    to_feasible, saddle = _close(problem, answer, condensation, closed)
    force, tie = _admissible_forces(problem, answer, condensation)
    residual = extend(problem.load) - rows.stiffness @ extend(answer.displacement) - rows.contact_force(force, tie)
    to_dual, last = response(problem, condensation, residual, tied=False)
    gap = extend(problem.gap) - rows.normal @ (extend(answer.displacement) + to_feasible)
    room = np.where(np.isin(np.arange(problem.contacts), saddle.closed), 0.0, np.maximum(gap.double(), 0.0))
    allowance = last + residual_noise(problem, answer)
    apart = sum(energy_norm(problem, to_feasible - to_dual)) + allowance
    slack = float(force.double() @ room)
    return AdmissiblePair(
        to_middle=(to_feasible + to_dual).half(),
        radius=float(np.sqrt(apart**2 / 4 + slack)) + allowance,
        dual_radius=float(np.sqrt(apart**2 + 2 * slack)) + allowance,
        force=force,
        open_gap=room,
        saddle=saddle,
        exact=False,
        undecided=0.0,
    )


def _close(
    problem: ContactProblem, answer: Answer, condensation: Condensation, closed: NDArray[np.intp]
) -> tuple[Extended, SaddlePoint]:
    """The nearest displacement (in energy) on which the set is closed, the set growing by what this penetrates."""
    rows = extended_rows(problem)
    start = extend(answer.displacement)
    length = lengths_that_meet(problem, problem.normal, problem.gap, answer.displacement)
    for _ in range(problem.contacts + 1):
        saddle = saddle_point(condensation, closed)
        step = extend(np.zeros(problem.dimension))
        for _ in range(CLOSING_SWEEPS):
            gap = extend(problem.gap) - rows.normal @ (start + step)
            open_tie = extend(problem.tie_value) - rows.tie @ (start + step)
            step = step + correction(condensation, saddle, extend(np.zeros(len(start))), gap[closed], open_tie)[0]
        gap = extend(problem.gap) - rows.normal @ (start + step)
        penetrated = np.flatnonzero(-gap.double() > WITHIN_ROUNDING * length)
        if not penetrated.size:
            return step, saddle
        larger = np.union1d(closed, penetrated).astype(np.intp)
        if len(larger) == len(closed):
            break
        closed = larger
    raise Unproven("the candidate could not be repaired to a displacement that penetrates nowhere")


def _admissible_forces(
    problem: ContactProblem, answer: Answer, condensation: Condensation
) -> tuple[Extended, Extended]:
    """The candidate's forces without tension, changed least so that they balance the load on every rigid motion."""
    force, tie = np.maximum(answer.normal_force, 0.0), answer.tie_force
    Z = condensation.rigid.basis
    if not Z.shape[1]:
        return extend(force), extend(tie)
    acting = np.flatnonzero(force > 0)
    rows = np.vstack([problem.normal[acting] @ Z, problem.tie @ Z])
    missing = Z.T @ (problem.load - problem.normal.T @ force - problem.tie.T @ tie)
    change, *_ = np.linalg.lstsq(rows.T, missing, rcond=None)
    force = force.copy()
    force[acting] += change[: len(acting)]
    tie = tie + change[len(acting) :]
    left = Z.T @ (problem.load - problem.normal.T @ force - problem.tie.T @ tie)
    size = abs(Z).T @ (abs(problem.load) + abs(problem.normal).T @ force + abs(problem.tie).T @ abs(tie))
    if np.any(force < 0) or np.any(abs(left) > BALANCED * size):
        raise Unproven("no forces near the candidate's balance the load on every rigid motion")
    return extend(force), extend(tie)
