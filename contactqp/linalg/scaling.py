"""Nondimensional numbers for backends that have absolute tolerances.

With u = l D y, D = 1/sqrt(K_jj) and rows of unit length in the energy, min 1/2 u'Ku - f'u over E u <= g becomes

    min 1/2 y'(DKD)y - (D f / l)'y   subject to   (E_i D / r_i) y <= g_i / (l r_i),   r_i = |E_i D|,

whose stiffness has a unit diagonal and whose rows have unit length in any system of units. The length l (the square
root of an energy) makes loads and gaps of order one; forces come back as l_i = l y_i / r_i.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.linalg.condensation import unknown_scale
from contactqp.linalg.equilibration import Scaling
from contactqp.model.arrays import Array
from contactqp.model.problem import ContactProblem


def nondimensional(problem: ContactProblem) -> tuple[ContactProblem, Scaling]:
    """The nondimensional twin of a problem."""
    D = unknown_scale(problem)
    normal, contacts = _unit_rows(problem.normal, D)
    tie, ties = _unit_rows(problem.tie, D)
    load, gap, value = D * _without_idle_part(problem), problem.gap / contacts, problem.tie_value / ties
    length = float(np.max(np.concatenate([abs(load), -gap, abs(value)]), initial=0.0)) or 1.0
    K = problem.stiffness
    stiffness = sp.csc_array(sp.diags(D) @ K @ sp.diags(D)) if sp.issparse(K) else K * np.outer(D, D)
    twin = problem.transformed(
        stiffness, load / length, D * problem.load_size / length, normal, gap / length, tie, value / length
    )
    return twin, Scaling(D, contacts, ties, length, length)


def _without_idle_part(problem: ContactProblem) -> Array:
    """The load, zero where it is the rounding of larger ones on an unknown without stiffness, which it would drive."""
    rounding = 16 * np.finfo(float).eps * problem.load_size
    bare = problem.diagonal == 0
    return np.where(bare & (abs(problem.load) <= rounding), 0.0, problem.load)


def _unit_rows(rows: Any, D: Array) -> tuple[Any, Array]:
    scaled = sp.csr_array(rows @ sp.diags(D))
    length = np.sqrt(np.asarray(scaled.multiply(scaled).sum(axis=1)).ravel())
    return sp.csr_array(sp.diags(1.0 / length) @ scaled), length
