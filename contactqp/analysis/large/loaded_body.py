"""A deformable body with its contacts and ties: what is out of balance at a displacement, and the Newton step there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.elements.deformable import ContactGeometry, ContactState, Deformable
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem

# Rounding of an internal force, in units of eps |K||u|: a few operations for each bar or quadrature point.
ROUNDING = 64 * np.finfo(float).eps


@dataclass(frozen=True, eq=False)
class Forces:
    """Multipliers, with the signs of a ContactProblem."""

    normal: Vector  # (m,) l_N, positive in compression
    tie: Vector  # (k,) nu
    friction: Array | None = None  # (m, d-1) l_T

    @property
    def largest(self) -> float:
        """The size of the largest normal force or tie force."""
        return float(max(np.max(abs(self.normal), initial=0.0), np.max(abs(self.tie), initial=0.0)))


@dataclass(frozen=True, eq=False)
class Instant:
    """The body at a displacement."""

    displacement: Vector  # (n,)
    internal: Vector  # (n,) the gradient of the energy
    contact: ContactState


@dataclass(frozen=True, eq=False)
class Imbalance:
    """What a displacement and forces leave, and whether that is nothing."""

    force: float  # the largest residual over the largest force that meets it
    length: float  # the largest error of a gap, slip or tie over the largest displacement
    nothing: bool  # both within tolerance, or within rounding

    @property
    def size(self) -> float:
        """The larger of both."""
        return max(self.force, self.length)


class LoadedBody:
    """The equations f_int(u) + E_N' l_N + E_T' l_T + A' nu = f of one body, with E_N, E_T and the gaps of now."""

    def __init__(
        self, body: Deformable, contact: ContactGeometry | None, tie: Any, friction: Vector | None = None
    ) -> None:
        self.body, self.contact, self.tie, self.friction = body, contact, tie, friction

    @property
    def dimension(self) -> int:
        """n."""
        return self.body.dimension

    @property
    def contacts(self) -> int:
        """m."""
        return 0 if self.contact is None else self.contact.contacts

    def at(self, u: Vector) -> Instant:
        """The body there; InvalidProblem where it cannot be or where a contact has lost its pair."""
        return Instant(u, np.asarray(self.body.internal_force(u)), self._contact(u))

    def _contact(self, u: Vector) -> ContactState:
        if self.contact is None:
            none = np.zeros(0)
            return ContactState(none, sp.csr_array((0, self.dimension)), None, none)
        return self.contact.state(u)

    def no_forces(self) -> Forces:
        """None acts."""
        return Forces(np.zeros(self.contacts), np.zeros(self.tie.shape[0]))

    def hessian(self, now: Instant, forces: Forces) -> Any:
        """K + curvature of the contacts under their forces, (n, n) CSC, symmetric."""
        K = sp.csc_array(self.body.tangent(now.displacement))
        if self.contact is not None and np.any(forces.normal):
            curvature = self.contact.curvature(now.displacement, forces.normal)
            K = K if curvature is None else sp.csc_array(K + curvature)
        return K

    def out_of_balance(self, now: Instant, load: Vector, forces: Forces | None = None) -> Vector:
        """f - f_int - E_N' l_N - E_T' l_T - A' nu, (n,) [force]."""
        left = load - now.internal
        if forces is not None:
            left = left - now.contact.normal.T @ forces.normal - self.tie.T @ forces.tie
            if forces.friction is not None and now.contact.tangent is not None:
                left = left - now.contact.tangent.T @ forces.friction.ravel()
        return np.asarray(left)

    def step_problem(
        self, now: Instant, K: Any, load: Vector, tie_value: Vector, slipped: Array | None = None
    ) -> ContactProblem:
        """The Newton step as a contact problem in the increment: K du = f - f_int, E_N du <= gap, A du = b - A u.

        `slipped` (m, d-1) is the slip of the load step so far: s = E_T du + slipped.
        """
        tangential: dict[str, Any] = {}
        if slipped is not None:
            tangential = dict(tangent=now.contact.tangent, friction=self.friction, slip_origin=-slipped)
        return ContactProblem(
            stiffness=K,
            load=load - now.internal,
            normal=now.contact.normal,
            gap=now.contact.gap,
            tie=self.tie,
            tie_value=tie_value - self.tie @ now.displacement,
            **tangential,
        )

    def imbalance(
        self,
        now: Instant,
        K: Any,
        load: Vector,
        forces: Forces,
        length_error: Vector,
        length_rounding: Vector,
        tolerance: float,
    ) -> Imbalance:
        """How far from balance the body is; lengths (any number,) are the errors of gaps, slips and ties."""
        residual = abs(self.out_of_balance(now, load, forces))
        parts = [load, now.internal, now.contact.normal.T @ forces.normal, self.tie.T @ forces.tie]
        size = max(float(np.max(abs(part), initial=0.0)) for part in parts)
        rounding = ROUNDING * (abs(K) @ abs(now.displacement))
        reach = float(np.max(abs(now.displacement), initial=0.0))
        nothing = bool(
            np.all(residual <= tolerance * size + rounding)
            and np.all(length_error <= tolerance * reach + length_rounding)
        )
        force = float(np.max(residual, initial=0.0)) / size if size else 0.0
        worst = float(np.max(length_error, initial=0.0))
        return Imbalance(force, worst / reach if reach else worst, nothing)
