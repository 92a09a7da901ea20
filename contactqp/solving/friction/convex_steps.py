"""Solve Coulomb's law as a fixed point of convex problems in the forces of a local problem.

    min 1/2 r'W r + 1/2 l'R l + r'V l + (q + s)'r    over    r in a set, and V'r = -s of joints without compliance

The set is the product of Coulomb's cones (with a shift of q: Acary, Cadoux, Lemarechal and Malick 2011) or of discs of
given radius (Tresca). Clarabel, SCS and cvxpy take cones and discs as they are. For all other methods they are
polyhedra: in the plane themselves, in space with a polygon in place of the disc. An inscribed polygon of n sides loses
up to 1 - cos(pi/n) of the friction bound, a circumscribed one gains up to 1/cos(pi/n) - 1. A minimisation sees the
symmetric part of W only.

Coulomb's law is a fixed point of such problems. Acary, Cadoux, Lemarechal and Malick (2011): r = argmin over the cones,
normal velocities shifted by s = mu |u_T| of the step before. The first step, s = 0, is the associated relaxation, and
each subproblem has a solution where `existence_margin` is positive. Tresca (Haslinger): r = argmin over discs of radius
mu r_N of the step before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.coulomb_law import onto_discs
from contactqp.errors import InvalidProblem, NotConverged, Unsupported, shown
from contactqp.linalg.condensation import condense
from contactqp.linalg.measures import lengths
from contactqp.model.arrays import Array, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import is_whole
from contactqp.solving.friction.conic import SOLVERS, ConicProgram, diagonal_rows, solve_conic
from contactqp.solving.friction.local_form import RELAXATION, Deadline, Iterate, LocalForm, aitken
from contactqp.solving.friction.tresca import solve_convex
from contactqp.solving.methods import Method, Settings

FACETS = 16
# A polygon of this many sides is the disc to 1e-7 of its radius.
MOST_FACETS = 10_000
POLYGONS = ("inscribed", "circumscribed")


def cone_error(facets: int, polygon: str) -> float:
    """Return the largest part of the friction bound that a polygon loses or gains."""
    cosine = float(np.cos(np.pi / facets))
    return 1.0 - cosine if polygon == "inscribed" else 1.0 / cosine - 1.0


class ConvexSteps:
    """The convex problems of one local form, for one method."""

    def __init__(self, form: LocalForm, method: Method, settings: Settings) -> None:
        options = dict(settings.options)
        self.facets, self.polygon = options.pop("facets", None), options.pop("polygon", None)
        self._form, self._method = form, method
        self._settings = replace(settings, warm_start=None, max_iter=None, options=options)
        self._deadline = Deadline(settings.time_limit)
        self._read_polygon()
        soft = np.any(form.R != 0, axis=1)
        self._soft, self._hard = np.flatnonzero(soft), np.flatnonzero(~soft)
        V = form.V[:, self._soft]
        W = form.symmetric_part
        if self._soft.size:
            inner = form.R[np.ix_(self._soft, self._soft)]
            W = sp.bmat([[sp.csr_array(W), V], [V.T, (inner + inner.T) / 2]])
        self._P = sp.csc_array(W)

    def _read_polygon(self) -> None:
        space = self._form.d == 3
        asked = self.facets is not None or self.polygon is not None
        self.conic = not asked and self._method.name in SOLVERS
        if not space and asked:
            raise InvalidProblem("facets, polygon: expected none, a cone in the plane has two sides of its own")
        self.facets = FACETS if self.facets is None else self.facets
        self.polygon = "inscribed" if self.polygon is None else self.polygon
        if not is_whole(self.facets) or not 3 <= self.facets <= MOST_FACETS:
            raise InvalidProblem(f"facets: expected a whole number from 3 to {MOST_FACETS}, got {shown(self.facets)}")
        if not isinstance(self.polygon, str) or self.polygon not in POLYGONS:
            raise InvalidProblem(f"polygon: expected one of {', '.join(POLYGONS)}, got {shown(self.polygon)}")
        if not self._method.exact:
            raise Unsupported(
                f"{self._method.name}: Coulomb friction takes exact convex steps, and this is approximate by design"
            )
        if not self._method.semidefinite:
            raise Unsupported(f"{self._method.name}: the convex steps of friction may be singular; try active-set")

    @property
    def asymmetry(self) -> float:
        """Return max |W - W'| / 2 max |W|, contacts scaled, the part of W ignored by a minimisation, 0 for rounding."""
        return self._form.problem.scaled_asymmetry / 2 if self._form.asymmetric else 0.0

    @property
    def polygons(self) -> str:
        """Return a text on the polygons that replace the cones."""
        if not self.cone_error:
            return ""
        return f" on polygons ({self.facets} sides, {self.polygon}, friction bound up to {self.cone_error:.2g} off)"

    @property
    def cone_error(self) -> float:
        """Return the largest part of the friction bound that the sets of these steps lose or gain; 0 for true cones."""
        return 0.0 if self.conic or self._form.d == 2 else cone_error(self.facets, self.polygon)

    def over_cones(self, shift: Vector) -> tuple[Array, Vector]:
        """Return r (m, d) and l (p,) for De Saxce's shifts (m,) of the normal velocity."""
        form = self._form
        linear = form.q.reshape(form.m, form.d).copy()
        linear[:, 0] += shift
        return self._minimum(linear, form.mu, None)

    def over_discs(self, bound: Vector) -> tuple[Array, Vector]:
        """Return r (m, d) and l (p,) for friction bounds (m,)."""
        return self._minimum(self._form.q.reshape(self._form.m, self._form.d), None, bound)

    def _minimum(self, linear: Array, mu: Vector | None, bound: Vector | None) -> tuple[Array, Vector]:
        self._deadline.refuse_if_passed(self._method.name)
        if self.conic:
            return self._by_cones(linear, mu, bound)
        return self._by_facets(linear, mu, bound)

    def _by_cones(self, linear: Array, mu: Vector | None, bound: Vector | None) -> tuple[Array, Vector]:
        form, size = self._form, self._form.m * self._form.d
        slope, radius = np.ones((form.m, form.d)), np.zeros((form.m, form.d))
        if mu is not None:
            slope[:, 0] = mu  # mu r_N >= |r_T|
        elif bound is not None:
            slope[:, 0], radius[:, 0] = 0.0, bound
        cones = -diagonal_rows(slope)
        nonnegative = -sp.csr_array(
            (np.ones(form.m), (np.arange(form.m), form.d * np.arange(form.m))), shape=(form.m, size)
        )
        balance = sp.csr_array(form.V[:, self._hard].T)
        rows = sp.vstack([balance, nonnegative, cones])
        rows = sp.hstack([rows, sp.csr_array((rows.shape[0], self._soft.size))])
        program = ConicProgram(
            P=self._P,
            c=np.concatenate([linear.ravel(), form.s[self._soft]]),
            A=sp.csc_array(rows),
            b=np.concatenate([-form.s[self._hard], np.zeros(form.m), radius.ravel()]),
            zeros=self._hard.size,
            nonnegatives=form.m,
            cones=form.m,
            width=form.d,
        )
        x, z = solve_conic(program, self._method.name, self._settings)
        return self._split(x, z[: self._hard.size])

    def _by_facets(self, linear: Array, mu: Vector | None, bound: Vector | None) -> tuple[Array, Vector]:
        form, m, d = self._form, self._form.m, self._form.d
        sides = self._sides()  # (n, d-1) outward normals
        shrunk = np.cos(np.pi / self.facets) if d == 3 and self.polygon == "inscribed" else 1.0
        friction = form.mu if mu is None else mu
        slides = np.flatnonzero(friction > 0) if mu is not None else np.flatnonzero(np.asarray(bound) > 0)
        held = np.setdiff1d(np.arange(m), slides)
        one = sp.csr_array((-np.ones(m), (np.arange(m), d * np.arange(m))), shape=(m, m * d))
        facets = sp.kron(sp.csr_array((np.ones(len(slides)), (np.arange(len(slides)), slides)), shape=(len(slides), m)),
                         np.hstack([np.zeros((len(sides), 1)), sides]))  # fmt: skip
        limit = np.zeros(len(slides) * len(sides))
        if mu is not None:
            reach = np.repeat(shrunk * friction[slides], len(sides))
            column = np.repeat(d * slides, len(sides))
            facets = facets - sp.csr_array((reach, (np.arange(len(reach)), column)), shape=facets.shape)
        elif bound is not None:
            limit = np.repeat(shrunk * bound[slides], len(sides))
        still = (d * held[:, None] + np.arange(1, d)).ravel()
        none = sp.csr_array((np.ones(len(still)), (np.arange(len(still)), still)), shape=(len(still), m * d))
        balance = sp.csr_array(form.V[:, self._hard].T)
        data = dict(normal=sp.vstack([one, facets]), tie=sp.vstack([none, balance]))
        widened = {
            name: sp.csr_array(sp.hstack([rows, sp.csr_array((rows.shape[0], self._soft.size))]))
            for name, rows in data.items()
        }
        load = -np.concatenate([linear.ravel(), form.s[self._soft]])
        candidate = self._candidate(
            load,
            widened,
            np.concatenate([np.zeros(m), limit]),
            np.concatenate([np.zeros(len(still)), -form.s[self._hard]]),
        )
        return self._split(candidate[0], candidate[1][len(still) :])

    def _sides(self) -> Array:
        if self._form.d == 2:
            return np.array([[1.0], [-1.0]])
        angle = 2 * np.pi * np.arange(self.facets) / self.facets
        return np.column_stack([np.cos(angle), np.sin(angle)])

    def _candidate(
        self, load: Vector, rows: dict[str, sp.csr_array], gap: Vector, ties: Vector
    ) -> tuple[Vector, Vector]:
        """Solve one convex step by the method; return the minimiser and the multipliers of the ties."""
        stiffness = self._P if self._form.sparse else self._P.toarray()
        inner = ContactProblem(stiffness=np.zeros((1, 1)), load=[0.0], normal=np.zeros((0, 1)), gap=[])._transformed(
            stiffness, load, abs(load), rows["normal"], gap, rows["tie"], ties
        )
        try:
            condense(inner)
        except InvalidProblem as error:
            raise NotConverged(f"{self._method.name}: delassus, of which printing left few digits: {error}") from error
        answer = solve_convex(self._method, inner, self._settings).answer
        return answer.displacement, answer.tie_force

    def _split(self, x: Vector, hard: Vector) -> tuple[Array, Vector]:
        form, size = self._form, self._form.m * self._form.d
        joint = np.zeros(form.joints)
        joint[self._soft], joint[self._hard] = x[size:], hard
        return x[:size].reshape(form.m, form.d), joint


def cone_fixed_point(form: LocalForm, steps: ConvexSteps, start: Iterate) -> Iterator[Iterate]:
    """Yield an iterate for each convex problem, without end."""
    shift = _shift(form, start) if np.any(start.force) else np.zeros(form.m)
    count = 0
    while True:
        r, joint = steps.over_cones(shift)
        count += 1
        found = Iterate.at(form, r, joint, count)
        yield found
        shift = _shift(form, found)


def tresca_fixed_point(form: LocalForm, steps: ConvexSteps, start: Iterate) -> Iterator[Iterate]:
    """Yield an iterate for each convex problem, without end."""
    bound = form.mu * np.maximum(start.force[:, 0], 0.0)
    relaxation, count = RELAXATION[1], 0
    before: Vector | None = None
    while True:
        r, joint = steps.over_discs(bound)
        count += 1
        yield Iterate.at(form, _in_cone(r, form.mu), joint, count)
        missing = form.mu * np.maximum(r[:, 0], 0.0) - bound
        relaxation = aitken(relaxation, before, missing)
        bound, before = np.maximum(bound + relaxation * missing, 0.0), missing


def _shift(form: LocalForm, iterate: Iterate) -> Vector:
    velocity = form.velocity(iterate.force, iterate.joint_force)
    return np.asarray(form.mu * lengths(velocity[:, 1:]))


def _in_cone(r: Array, mu: Vector) -> Array:
    """Return forces (m, d) without tension, with friction reduced to its bound."""
    normal = np.maximum(r[:, 0], 0.0)
    return np.column_stack([normal, onto_discs(r[:, 1:], mu * normal)])
