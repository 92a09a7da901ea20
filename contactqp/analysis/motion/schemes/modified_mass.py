"""Modified mass with central differences: contact nodes without mass follow the others in static equilibrium.

    M_II (u+ - 2u + u-)_I / h^2 + (K u)_I = f_I,
    K_CC u_C+ + E_C'l + K_CI u_I+ = f_C+,    E_C u_C+ <= g,  l_N >= 0,  complementary

I are the unknowns with mass, C those that contacts act on (Khenous, Laborde and Renard 2008; Doyen, Ern and Piperno
2011). With the trapezoidal rule see `newmark`.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.analysis.motion.mass_matrix import massless
from contactqp.analysis.motion.schemes.scheme import Body, SchemeEntry, State, TwoStep
from contactqp.analysis.motion.step_contact import StepProblem, StepResult
from contactqp.errors import Unsupported
from contactqp.linalg.dense import Factorization
from contactqp.linalg.factorization import factorise
from contactqp.model.arrays import Vector


class ModifiedMassCentral(TwoStep):
    """The scheme with x = u+: its part with mass is explicit, a small static contact problem gives the rest."""

    name = "modified-mass-central"

    def __init__(self, body: Body) -> None:
        if body.problem.ties:
            raise Unsupported("modified-mass-central: ties; take modified-mass, or remove the tied unknowns")
        self.body = body
        bare = massless(body.mass)
        self._moving, self._bare = np.flatnonzero(~bare), np.flatnonzero(bare)
        self._inertia = body.mass / body.step**2
        only = sp.diags(bare.astype(float))
        self.templates = (body.template(self._inertia + only @ body.stiffness @ only),)
        self._coupling = body.stiffness[self._bare][:, self._moving]

    @cached_property
    def _mass(self) -> Factorization:
        return factorise(self.body.mass[self._moving][:, self._moving])

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without factors, which are not pickled; they are made again where they are needed."""
        return {name: value for name, value in self.__dict__.items() if name != "_mass"}

    def starting(self, displacement: Vector, velocity: Vector, load: Vector) -> Vector:
        """Return the acceleration at the start where there is mass, 0 elsewhere."""
        del velocity
        acceleration = np.zeros(len(load))
        force = load - self.body.stiffness @ displacement
        acceleration[self._moving] = self._mass.solve(force[self._moving])
        return acceleration

    def pose(self, state: State, load: Vector, next_load: Vector, answers: tuple[StepResult, ...]) -> StepProblem:
        del answers
        body, u = self.body, state.displacement
        internal = body.stiffness @ u
        force = load - internal + self._inertia @ (u - state.before)
        ahead = self._mass.solve(force[self._moving]) * body.step**2
        force[self._bare] = (next_load - internal)[self._bare] - self._coupling @ ahead
        return StepProblem(force, body.problem.gap, None, body.slip_from(u), None, u)


SCHEMES = (
    SchemeEntry(
        "modified-mass-central", lambda body, _: ModifiedMassCentral(body), explicit=True, massless_contacts=True
    ),
)
