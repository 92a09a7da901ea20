"""Solve the associated relaxation of Coulomb friction, a convex problem with a different law.

    min 1/2 u'Ku - f'u    over    E_N u + mu |E_T u - o| <= g,  A u = b

Its multipliers lie in Coulomb's cone, |l_T| <= mu l_N along the slip, but a contact that slides under load opens by
mu |s|: sliding dilates (Drucker and Prager's flow rule; De Saxce and Feng 1998 call it the implicit law's associated
counterpart). Where nothing slides it is Coulomb's answer; elsewhere it is not, and the certificate refuses it.

In the plane the constraint is two rows, E_N u +- mu E_T u <= g +- mu o with forces l+ and l-, a quadratic program:
l_N = l+ + l-, l_T = mu (l+ - l-). In space it is a second-order cone, for Clarabel, and Newton's method on
r = P_K(r - u), r = (l_N, -l_T), u = (g - E_N u, E_T u - o) takes its answer to the last digits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.certificate import certificate_of
from contactqp.certificate.coulomb_law import onto_cone
from contactqp.errors import BackendMissing, NotConverged, Unsupported, of_backend
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.existence import refuse_conflict, refuse_driven_motion
from contactqp.linalg.measures import lengths
from contactqp.model.arrays import Array, Indices, Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer
from contactqp.solving.methods import Method, Settings
from contactqp.solving.runs import CondensedRun

# The tolerance of the conic solver, for data of size one; Newton's method refines its answer.
TOLERANCE = 1e-11
# The largest residual of an answer relative to the size of the data.
MISSED = 1e-9
MAX_STEPS = 30


def associated_answer(
    problem: ContactProblem, condensation: Condensation, method: Method, settings: Settings
) -> tuple[Answer, str]:
    """Solve the associated relaxation, in the plane by `method` and in space by Clarabel; return its answer and name.

    Parameters
    ----------
    problem, condensation, method, settings : ContactProblem, its Condensation, Method, Settings

    Raises
    ------
    NoEquilibrium
        Constraints conflict, or a load drives a rigid motion that nothing resists.
    NotConverged, BackendFailed, BackendMissing
        The convex solver failed, or its result does not satisfy the relaxation.
    Unsupported
        A method that is approximate by design.
    """
    if not method.exact:
        raise Unsupported(f"{method.name}: the associated relaxation takes an exact method")
    if problem.slip_origin is not None and problem.slip_origin.shape[1] > 1:
        try:
            answer = relaxed_in_space(problem, condensation)
        except NotConverged:
            refuse_conflict(problem, condensation)
            refuse_driven_motion(problem, condensation.rigid)
            raise
        return answer, "associated friction law by clarabel (not Coulomb)"
    relaxed = relaxed_in_the_plane(problem)
    # The program has two forces per contact, a start has one.
    found = CondensedRun(relaxed, method, replace(settings, warm_start=None), "auto").final().answer
    certificate = certificate_of(relaxed, found)
    if not certificate.passed:
        raise NotConverged(f"associated friction law by {method.name}: {'; '.join(certificate.failures)}")
    answer = recovered(problem, found.displacement, found.normal_force, found.tie_force)
    return answer, f"associated friction law by {method.name} (not Coulomb)"


def relaxed_in_the_plane(problem: ContactProblem) -> ContactProblem:
    """Return the quadratic program with rows E_N + mu E_T of all contacts, then E_N - mu E_T of those with friction."""
    mu, origin, frictional = _coulomb_data(problem)
    dragged = sp.diags(mu) @ sp.csr_array(problem.tangent)
    shift = mu * origin[:, 0]
    names = [problem.contact_name(i) for i in range(problem.contacts)]
    return ContactProblem(
        stiffness=problem.stiffness,
        load=problem.load,
        normal=sp.vstack([problem.normal + dragged, (problem.normal - dragged)[frictional]]),
        gap=np.concatenate([problem.gap + shift, (problem.gap - shift)[frictional]]),
        tie=problem.tie,
        tie_value=problem.tie_value,
        dof_names=problem.dof_names,
        contact_names=[f"{name} (+)" for name in names] + [f"{names[i]} (-)" for i in frictional],
        units=problem.units,
    )


def recovered(problem: ContactProblem, displacement: Vector, force: Vector, tie_force: Vector) -> Answer:
    """Return the answer, with l_N and l_T, from the forces of `relaxed_in_the_plane`.

    Parameters
    ----------
    problem : ContactProblem
        In the plane, with friction.
    displacement : (n,) array [length]
    force : (m + q,) array [force]
        Those on both edges of the cones, of q contacts with friction after the first of all.
    tie_force : (k,) array [force]
    """
    mu, _, frictional = _coulomb_data(problem)
    one, other = force[: problem.contacts], np.zeros(problem.contacts)
    other[frictional] = force[problem.contacts :]
    return Answer(displacement, one + other, (mu * (one - other))[:, None], tie_force)


def relaxed_in_space(problem: ContactProblem, condensation: Condensation) -> Answer:
    """Return the answer to the conic program.

    Raises BackendMissing, BackendFailed: Clarabel is not installed, or raised; NotConverged: its answer, refined,
    misses the conditions.
    """
    program = _Program(problem, condensation)
    point = program.refined(program.by_clarabel())
    missed = float(np.max(abs(program.residual(point)), initial=0.0))
    if not missed <= MISSED:
        raise NotConverged(f"associated: the conic program's conditions are missed by {missed:.2g} of the data")
    return program.answer(point)


def _coulomb_data(problem: ContactProblem) -> tuple[Vector, Array, Indices]:
    if problem.friction is None or problem.slip_origin is None:
        raise ValueError("the relaxation of a problem without friction")
    return problem.friction, problem.slip_origin, np.flatnonzero(problem.friction > 0)


@dataclass(frozen=True, eq=False)
class _Point:
    x: Vector  # (p,)
    r: Array  # (m, d), on the body
    tie: Vector  # (k,)


class _Program:
    """The relaxation on the scaled contact unknowns, its data divided by their size."""

    def __init__(self, problem: ContactProblem, condensation: Condensation) -> None:
        self.mu, origin, self._frictional = _coulomb_data(problem)
        self._condensation, scale = condensation, condensation.scale
        m, width = origin.shape
        normal = condensation.normal * scale
        tangent = np.zeros((0, len(scale))) if condensation.tangent is None else condensation.tangent.toarray() * scale
        self._length = np.linalg.norm(normal, axis=1)
        # The signs are those of u = (g - N x, T x - o).
        rows = np.concatenate([-normal[:, None], tangent.reshape(m, width, -1)], axis=1)
        self._rows = (rows / self._length[:, None, None]).reshape(m * (1 + width), -1)
        limit = np.column_stack([problem.gap, -origin]) / self._length[:, None]
        tie = condensation.tie * scale
        self._tie_length = np.linalg.norm(tie, axis=1)
        self._tie, value = tie / self._tie_length[:, None], problem.tie_value / self._tie_length
        load, self._inner = condensation.reduce_load(problem.load)
        parts = (load * scale, limit, value)
        self._size = float(max(np.max(abs(part), initial=0.0) for part in parts)) or 1.0
        self._load, self._limit, self._value = (part / self._size for part in parts)
        self._S = condensation.schur * np.outer(scale, scale)

    def by_clarabel(self) -> _Point:
        """Solve A x + s = b, s = (g - N x, mu (T x - o)) in a cone for each contact, 0 for ties; forces are z."""
        try:
            clarabel: Any = import_module("clarabel")
        except ImportError as error:
            raise BackendMissing("associated: friction in space needs clarabel: pip install clarabel") from error
        m, d = self._limit.shape
        frictional = self.mu > 0
        weight = np.where(np.arange(d) == 0, 1.0, self.mu[:, None])
        kept = np.repeat(frictional, d).reshape(m, d)
        kept[:, 0] = True
        flat, weights = kept.ravel(), weight.ravel()
        rows = -(self._rows * weights[:, None])[flat]
        cones = [clarabel.ZeroConeT(len(self._tie))] if len(self._tie) else []
        cones += [clarabel.SecondOrderConeT(d) if one else clarabel.NonnegativeConeT(1) for one in frictional]
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_iter = False, 200
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
        P, A = sp.csc_matrix(np.triu(self._S)), sp.csc_matrix(np.vstack([self._tie, rows]))
        right = np.concatenate([self._value, (weights * self._limit.ravel())[flat]])
        with of_backend("associated: clarabel"):
            found = clarabel.DefaultSolver(P, -self._load, A, right, cones, settings).solve()
        x, z = np.array(found.x), np.array(found.z)
        if not (np.all(np.isfinite(x)) and np.all(np.isfinite(z))):
            raise NotConverged(f"associated: clarabel: {found.status}")
        r = np.zeros(m * d)
        r[flat] = z[len(self._tie) :] * weights[flat]
        return _Point(x, r.reshape(m, d), z[: len(self._tie)])

    def residual(self, point: _Point) -> Vector:
        """Return the residual of balance, of r = P_K(r - u), and of ties."""
        balance = self._S @ point.x - self._load - self._rows.T @ point.r.ravel() + self._tie.T @ point.tie
        law = point.r - onto_cone(point.r - self._velocity(point), self.mu)
        return np.concatenate([balance, law.ravel(), self._tie @ point.x - self._value])

    def refined(self, point: _Point) -> _Point:
        """Return the answer refined by semismooth Newton steps, as long as they halve the residual."""
        missed = float(np.linalg.norm(self.residual(point)))
        for _ in range(MAX_STEPS):
            step = np.linalg.lstsq(self._jacobian(point), -self.residual(point), rcond=1e-13)[0]
            p, n = len(point.x), point.r.size
            nearer = _Point(
                point.x + step[:p], point.r + step[p : p + n].reshape(point.r.shape), point.tie + step[p + n :]
            )
            left = float(np.linalg.norm(self.residual(nearer)))
            if not left < 0.5 * missed:
                break
            point, missed = nearer, left
        return point

    def answer(self, point: _Point) -> Answer:
        """Return the answer in the unknowns and units of the problem."""
        force = point.r * (self._size / self._length[:, None])
        u = self._condensation.expand(point.x * self._size * self._condensation.scale, self._inner)
        return Answer(u, force[:, 0], -force[:, 1:], point.tie * self._size / self._tie_length)

    def _velocity(self, point: _Point) -> Array:
        return np.asarray((self._rows @ point.x).reshape(self._limit.shape) + self._limit)

    def _jacobian(self, point: _Point) -> Array:
        m, d = self._limit.shape
        slope = np.zeros((m * d, m * d))
        trial = point.r - self._velocity(point)
        for i in range(m):
            slope[i * d : (i + 1) * d, i * d : (i + 1) * d] = projection_slope(trial[i], float(self.mu[i]))
        p, k = len(point.x), len(self._tie)
        return (
            np.block(
                [
                    [self._S, -self._rows.T, self._tie.T],
                    [slope @ self._rows, np.eye(m * d) - slope, np.zeros((m * d, k))],
                    [self._tie, np.zeros((k, m * d + k))],
                ]
            )
            if p
            else np.zeros((0, 0))
        )


def projection_slope(x: Vector, mu: float) -> Array:
    """Return a generalised derivative (d, d) of the projection onto Coulomb's cone at x, normal component first."""
    normal, across = float(x[0]), x[1:]
    size = float(lengths(across[None])[0])
    if size <= mu * normal:
        return np.eye(len(x))
    if mu * size <= -normal:
        return np.zeros((len(x), len(x)))
    direction = across / size
    along = np.concatenate([[1.0], mu * direction])
    slope = np.outer(along, along) / (1 + mu**2)
    turned = mu * (mu * size + normal) / (1 + mu**2) / size
    slope[1:, 1:] += turned * (np.eye(len(across)) - np.outer(direction, direction))
    return np.asarray(slope)
