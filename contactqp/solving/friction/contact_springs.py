"""The penalty method as an exact problem of other bodies: between body and obstacle there is a slider on springs.

A contact with a normal spring beta and a tangential spring beta_T, and with rigid friction behind them, is Coulomb's
exact law for the far ends z_N, z_T of these springs,

    1/2 u'Ku - f'u + sum 1/2 beta (E_N u - z_N)^2 + sum 1/2 beta_T |E_T u - z_T|^2,        z_N <= g,
    |l_T| <= mu l_N,   l_T = mu l_N s/|s| where the slip s = z_T - slip_origin of the slider does not vanish,

so that l_N = beta (E_N u - z_N), l_T = beta_T (E_T u - z_T): any solver of the exact law solves the penalised one. Its
history is that of the sliders: the next step's slip origin is where they are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from contactqp.certificate.certificate import compute_certificate
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import FreeMotion, Solution
from contactqp.solving.methods.textbook_algebra import contact_stiffness

NAME = "contact springs"


def with_contact_springs(
    problem: ContactProblem, penalty: ArrayLike, tangential_penalty: ArrayLike | None = None
) -> ContactProblem:
    """Return the problem whose exact answer is the penalised answer to this one.

    Parameters
    ----------
    problem : ContactProblem
        With tangential rows, in the plane or in space.
    penalty : float or (m,) array
        beta [force / length], positive.
    tangential_penalty : float or (m,) array, optional
        beta_T [force / length], positive; beta by default.

    Returns
    -------
    ContactProblem
        Its unknowns are (u, z_N, z_T), z_T contact by contact; its contacts, ties and slip origins those of `problem`.

    Raises
    ------
    InvalidProblem
        A stiffness is not positive and finite, or there are no tangential rows.
    """
    if problem.tangent is None or problem.slip_origin is None:
        raise InvalidProblem(f"{NAME}: expected a problem with tangential rows, got {shown(problem)}")
    n, m, width = problem.dimension, problem.contacts, problem.slip_origin.shape[1]
    normal, tangential = _stiffnesses(m, penalty, tangential_penalty)
    rows: Any = sp.vstack([problem.normal, problem.tangent], format="csr")
    springs = sp.diags(np.concatenate([normal, np.repeat(tangential, width)]))
    far = -springs @ rows
    stiffness = sp.bmat([[sp.csr_array(problem.stiffness) + rows.T @ springs @ rows, far.T], [far, springs]])
    # A contact whose tangential unknowns are all supported cannot slide, on a spring or without.
    slides = sp.diags((np.diff(sp.csr_array(problem.tangent).indptr) > 0).astype(float))
    ahead = sp.hstack([sp.csr_array((m, n)), sp.identity(m), sp.csr_array((m, m * width))])
    aside = sp.hstack([sp.csr_array((m * width, n + m)), slides])
    return ContactProblem(
        stiffness=stiffness if sp.issparse(problem.stiffness) else stiffness.toarray(),
        load=np.concatenate([problem.load, np.zeros(m + m * width)]),
        normal=ahead,
        gap=problem.gap,
        tangent=aside,
        friction=problem.friction,
        slip_origin=problem.slip_origin,
        tie=sp.hstack([problem.tie, sp.csr_array((problem.ties, m + m * width))]),
        tie_value=problem.tie_value,
        dof_names=_names(problem, width),
        contact_names=problem.contact_names,
        units=problem.units,
    )


def without_contact_springs(problem: ContactProblem, solution: Solution, name: str = "penalty") -> Solution:
    """The solution of `with_contact_springs(problem, ...)` as the penalised solution of `problem`, by the
    method of that name.

    Its certificate is that of `problem`, whose contacts are rigid: it says how far off the springs are. Stick and slip
    are the sliders'.
    """
    n = problem.dimension
    u, normal, friction, tie = (
        solution.displacement[:n],
        solution.normal_force,
        solution.friction_force,
        solution.tie_force,
    )
    return replace(
        solution,
        problem=problem,
        displacement=u,
        free_motions=tuple(FreeMotion(motion.direction[:n], str(motion)) for motion in solution.free_motions),
        certificate=compute_certificate(problem, u, normal, friction, tie),
        method=f"{name} by {solution.method}",
        raw=None,
    )


def sliders(
    problem: ContactProblem, solution: Solution, penalty: ArrayLike, tangential_penalty: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Return the sliders of a penalised solution: E_T u - l_T / beta_T, or where they stick their origin,
    (m, d-1) [length].

    They are the next step's slip origin. A slider whose contact is open hangs on a spring without force, E_T u.

    Raises
    ------
    InvalidProblem
        As `with_contact_springs`.
    """
    if problem.tangent is None or problem.slip_origin is None or solution.friction_force is None:
        raise InvalidProblem(f"{NAME}: expected a problem with tangential rows, got {shown(problem)}")
    _, tangential = _stiffnesses(problem.contacts, penalty, tangential_penalty)
    moved = (problem.tangent @ solution.displacement).reshape(problem.slip_origin.shape)
    stuck = solution.contact_status[:, None] == "stick"
    return np.where(stuck, problem.slip_origin, moved - solution.friction_force / tangential[:, None])


def _stiffnesses(contacts: int, penalty: Any, tangential_penalty: Any) -> tuple[Vector, Vector]:
    normal = contact_stiffness(NAME, "penalty", penalty, contacts)
    if tangential_penalty is None:
        return normal, normal
    return normal, contact_stiffness(NAME, "tangential_penalty", tangential_penalty, contacts)


def _names(problem: ContactProblem, width: int) -> list[str] | None:
    if problem.dof_names is None:
        return None
    contacts = [problem.contact_name(i) for i in range(problem.contacts)]
    aside = [f"{name}: slider" + (f" {k + 1}" if width > 1 else "") for name in contacts for k in range(width)]
    return [*problem.dof_names, *(f"{name}: normal spring" for name in contacts), *aside]
