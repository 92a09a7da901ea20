"""The condensed stiffness and the rows of contacts, tangents and ties, all scaled to the unit of sqrt(energy).

With D = 1/sqrt(S_jj), x = D y and rows of unit length in the energy, r_i = |E_i D|, the rows R = [N; T; A] become
R_i D / r_i, their forces l_i r_i, their lengths (gaps, slips) g_i / r_i. Coulomb's coefficient becomes mu r_T / r_N.
Two tangential rows of a contact in space have one length r_T, the root of their mean square: cones stay round.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from contactqp.linalg.condensation import Condensation
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem


class FrictionalRows:
    """A frictional problem on its retained unknowns, scaled.

    Attributes
    ----------
    S : (p, p) array
        The condensed stiffness, its diagonal one.
    normal, tangent, tie : (m, p), ((d-1) m, p), (k, p) arrays
        Rows of unit length, tangents contact by contact.
    width : int
        d-1, tangential rows a contact.
    slides : (m,) array of bool
        Which contacts can slide at all: a tangential row whose unknowns are all supported is zero, and any friction
        within its bound would do; it is given none.
    coefficient : (m,) array
        mu r_T / r_N: friction bounds in scaled forces.
    """

    def __init__(self, problem: ContactProblem, condensation: Condensation) -> None:
        if problem.friction is None or condensation.tangent is None:
            raise ValueError("frictional rows of a problem without friction")
        self.scale = condensation.scale
        self.S = condensation.schur * np.outer(self.scale, self.scale)
        self.normal, self.normal_length = _unit(condensation.normal * self.scale)
        tangent = condensation.tangent.toarray() * self.scale
        self.width = len(tangent) // problem.contacts if problem.contacts else 1
        of_contacts, length = _unit(tangent.reshape(problem.contacts, -1))
        # The root of the mean square of a contact's rows.
        self.tangent_length = np.where(np.any(of_contacts != 0, axis=1), length / np.sqrt(self.width), 1.0)
        self.tangent = tangent / np.repeat(self.tangent_length, self.width)[:, None]
        self.slides = np.any(of_contacts != 0, axis=1)
        self.tie, self.tie_length = _unit(condensation.tie * self.scale)
        self.coefficient = problem.friction * self.tangent_length / self.normal_length
        motions = condensation.rigid.motions[condensation.retained] / self.scale[:, None]
        self.motions = np.linalg.qr(motions)[0] if motions.shape[1] else motions

    @cached_property
    def all_rows(self) -> Array:
        """(d m + k, p): contacts, tangents, ties."""
        return np.vstack([self.normal, self.tangent, self.tie])

    @cached_property
    def compliance(self) -> Array:
        """S^+ (p, p): the inverse of S, zero on the rigid motions."""
        return compliance_of(self.S, self.motions)

    def lengths(self, problem: ContactProblem) -> tuple[Vector, Vector, Vector]:
        """Scaled gaps (m,), slip origins ((d-1) m,), tie values (k,)."""
        origin = np.zeros(len(self.tangent)) if problem.slip_origin is None else problem.slip_origin.ravel()
        slip = origin / np.repeat(self.tangent_length, self.width)
        return problem.gap / self.normal_length, slip, problem.tie_value / self.tie_length


def compliance_of(S: Array, motions: Array) -> Array:
    """S^+ (p, p) of a stiffness that orthonormal motions (p, q) alone do not feel, to rounding none along them."""
    if not motions.shape[1]:
        return np.asarray(np.linalg.inv(S))
    rigid = motions @ motions.T
    across = np.eye(len(S)) - rigid
    return np.asarray(across @ np.linalg.inv(S + rigid) @ across)


def _unit(rows: Array) -> tuple[Array, Vector]:
    """Rows of unit length, and what they were divided by; an empty row is left as it is."""
    length = np.linalg.norm(rows, axis=1)
    length = np.where(length > 0, length, 1.0)
    return rows / length[:, None], length
