"""Signorini's and Coulomb's law as one equation, measured at every contact of an answer.

At contact i let r = (l_N, -l_T) be the force on the body and u = (g - E_N u, E_T u - slip_origin). The law is

    n_i = r - P_K(r - rho_i (u + mu |u_T| e_N)) = 0        for any stiffness rho_i > 0

(De Saxce and Feng 1998; `contactqp.model.coulomb_cone`). With rho_i = phi_i / L_i, phi_i the larger of the forces that
meet along the contact's normal and its tangent and L_i the larger of the lengths that meet there, |n_i| / phi_i has no
dimension and survives a change of units, rescaling of any unknown and common scaling of the contact's rows.

Divided by 1 + mu it is at most 1 + 2 sqrt(2) < 4 times the largest of penetration, tension, complementarity, cone and
slip_direction: put the answer onto the law by moving r and u by what these figures say; P_K contracts, so n changes by
twice the move of r and once that of u + mu |u_T| e_N.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.figures import slips
from contactqp.linalg.measures import beyond, ratio
from contactqp.linalg.row_sizes import ContactEntries, contact_entries
from contactqp.model.arrays import Vector
from contactqp.model.coulomb_cone import Vectors, natural_map
from contactqp.model.problem import ContactProblem
from contactqp.model.verdicts import Answer, Violations

# The other figures imply this one up to this factor.
IMPLIED = 4.0
# Tangential rows, each scaled by the forces that meet, whose angle has a smaller squared sine than this are parallel.
PARALLEL = 1e-14


def coulomb_residual(problem: ContactProblem, answer: Answer, found: Violations) -> Vector | None:
    """|n_i| / (phi_i (1 + mu_i)) (m,), or None without friction.

    A contact whose tangential rows leave a direction that no unknown feels is measured along its normal alone: any
    friction within the bound would do in that direction.
    """
    if not problem.frictional or problem.tangent is None or problem.slip_origin is None or problem.friction is None:
        return None
    slip = (problem.tangent @ answer.displacement).reshape(problem.slip_origin.shape) - problem.slip_origin
    along = normal_force(contact_entries(problem, "normal"), found.meeting)
    across, felt = tangential_force(contact_entries(problem, "tangent"), found.meeting)
    least = least_force(contact_entries(problem, "normal"), found.nothing.force)
    return law_residual(answer, found, (slip, problem.friction), (along, across, felt), least)


def law_residual(
    answer: Any,
    found: Violations,
    rubbing: tuple[Vectors, Vector],
    unit: tuple[Vector, Vector, NDArray[np.bool_]],
    nothing: Vector,
) -> Vector:
    """`coulomb_residual` (m,) of an `Answer`, or of one rank's part of one.

    Parameters
    ----------
    rubbing : (m, d-1) and (m,) arrays
        The slips [length] and the coefficients of friction.
    unit : three (m,) arrays
        `normal_force` and what `tangential_force` returns.
    nothing : (m,) array
        `least_force`: the contact forces up to which there is none.
    """
    (slip, friction), (along, across, felt), least = rubbing, unit, nothing
    phi = np.maximum(along, np.where(felt, across, 0.0))
    L = np.maximum(found.lengths, np.where(felt, found.tangential_lengths, 0.0))
    gap = np.where(found.gap_measure > 0, found.gap, 0.0)
    slip = np.where(felt[:, None], slips(slip, found.nothing), 0.0)
    rubbed = answer.friction_force
    rubbed = np.zeros_like(slip) if rubbed is None else np.where(felt[:, None], rubbed, 0.0)
    force = np.column_stack([answer.normal_force, -rubbed]) * _inverse(phi)[:, None]
    velocity = np.column_stack([gap, slip]) * _inverse(L)[:, None]
    mu = np.where(felt, friction, 0.0)
    missed = np.linalg.norm(natural_map(force, velocity, mu), axis=1) - 2.0 * found.turned * _inverse(phi)
    missed = np.maximum(missed, 0.0) / (1.0 + mu)
    return beyond(missed, least * _inverse(phi))


def normal_force(entries: ContactEntries, meeting: Vector) -> Vector:
    """(m,) the l_N whose own measure, max_j |E_ij l_N| / F_j, is one."""
    return _inverse(entries.largest(entries.over(meeting)))


def least_force(entries: ContactEntries, none: Vector) -> Vector:
    """(m,) the largest l_N that is nothing (n,) at every unknown of its contact."""
    return _inverse(entries.largest(ratio(abs(entries.values), none[entries.unknown])))


def tangential_force(entries: ContactEntries, meeting: Vector) -> tuple[Vector, NDArray[np.bool_]]:
    """(m,) at least the largest |l_T| whose own measure is one, and whether every direction of it is felt.

    max_j |E_T'l_T|_j / F_j >= sqrt(l_T' G l_T / c), G = E_T diag(F)^-2 E_T', of the c unknowns of a contact.
    """
    scaled, count = entries.over(meeting), entries.sums(np.ones(len(entries.contact)))
    unit = _inverse(entries.largest(scaled))  # so that squares are doubles
    scaled = scaled * unit[entries.contact]
    own = [entries.sums(row * row) for row in scaled]
    if len(own) == 1:
        return unit * np.sqrt(count) * _inverse(np.sqrt(own[0])), own[0] > 0
    shared, product = entries.sums(scaled[0] * scaled[1]), own[0] * own[1]
    sine = 1.0 - np.divide(shared**2, product, out=np.ones_like(product), where=product > 0)
    felt = sine > PARALLEL
    largest = (own[0] + own[1]) / 2 + np.hypot((own[0] - own[1]) / 2, shared)
    smallest = np.divide(product * sine, largest, out=np.zeros_like(product), where=felt)
    return unit * np.sqrt(count) * _inverse(np.sqrt(smallest)), felt


def _inverse(size: Vector) -> Vector:
    return np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
