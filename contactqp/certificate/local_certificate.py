"""Judge the forces of a local problem, each contact in its own measure, and compute the errors published by other
codes.

At contact i let L_N be its normal row of |W||r| + |V||l| + |q|, the size of the normal velocities that meet there, and
L_T the larger of its tangential rows. A normal velocity is measured as its size over L_N, a slip as its size over L_T,
a normal force as w_N |r| / L_N and friction as w_T |r| / L_T, w_N = W_NN and w_T the largest |entry| of W_TT of the
contact alone; 0/0 is 0. So a large slip hides no overlap, and a distant contact no other one: only values below 1e-12
of the largest driving or responding velocity (roots of energies, without offsets of open contacts) count as zero. All
measures survive a change of units and common scaling of a contact's rows, the natural map too (`_natural_map`);
the published errors do not, and are not part of the verdict.

Uniqueness is examined by the Delassus operator and the states of contacts. Velocities:
`contactqp.certificate.critical_friction` on W; if it does not exclude other answers, they may exist. Forces: with B the
directions in which closed contacts push (a contact that sticks in all, one that slips along its force on the cone),
forces for given velocities are not unique if [[B'WB, B'V], [V'B, R]] is singular. Each contact is scaled to a
compliance of one.

The errors published by other codes are computed by their own formulas under their own names, for comparison only. All
of them use the natural map with rho = 1, n = r - P_K(r - u - mu |u_T| e_N), which adds forces to velocities: they
depend on units and on how a problem is scaled. r is the force on the body and u the velocity, gap or slip of each
contact, in the order (N, T) or (N, T1, T2); a ContactProblem has r = (l_N, -l_T), u = (g - E_N u, E_T u - slip_origin).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.certificate.coulomb_law import distance_from_law, natural_map
from contactqp.certificate.critical_friction import LARGEST_RATIO, MOST_CONTACTS, CriticalFriction, of_operator
from contactqp.certificate.frictional_bounds import local_bounds
from contactqp.certificate.uniqueness import FORCES, POSSIBLE, UNKNOWN, are_dependent
from contactqp.errors import InvalidProblem, Unsupported, counted, shown
from contactqp.linalg.delassus import velocity_of
from contactqp.linalg.measures import directions, lengths
from contactqp.model.arguments import checked
from contactqp.model.arrays import EPS, Array, Mask, Vector, own_floating_point
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status, slips
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import is_number, read_array
from contactqp.model.solution import LocalCertificate

# Operators with a larger asymmetry than this, the tolerance of the verdict, are noted as unsymmetric.
ASYMMETRIC_BY_ROUNDING = 1e-9

# The size from which sparse products, of which SciPy's calls take some 0.1 ms, are faster than dense ones.
WORTH_SPARSE_PRODUCTS = 200


@own_floating_point
def _local_uniqueness(
    problem: LocalProblem, closed: Mask, stuck: Mask, along: Array
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return findings on uniqueness of the forces and notes on them; `along` (m, d) are the force directions of
    slipping contacts.
    """
    if not problem.contacts or not np.any(problem.friction > 0):
        return (), ()
    notes = []
    if problem.scaled_asymmetry > ASYMMETRIC_BY_ROUNDING:
        notes.append(
            f"delassus is not symmetric by {problem.scaled_asymmetry:.2g} of its largest entry; the forces are judged "
            "by it as given, what a minimisation makes of it is that far off"
        )
    if problem.contacts > MOST_CONTACTS:
        reason = f"{counted('contact', problem.contacts)}, at most {MOST_CONTACTS} are examined"
        return (UNKNOWN,), (*notes, f"uniqueness was not examined: {reason}")
    findings = []
    if _dependent(problem, closed, stuck, along):
        findings.append(FORCES)
        notes.append("redundant contacts: other forces belong to the same velocities")
    critical = _critical_friction(problem)
    if not critical.unique:
        findings.append(POSSIBLE)
        notes.append(f"friction: several answers {_reason(problem, critical)}")
    return tuple(findings), tuple(notes)


def _critical_friction(problem: LocalProblem) -> CriticalFriction:
    if (computed := problem._of_matrices).critical is None:
        W = problem.scaled_delassus.toarray()
        symmetric = problem.scaled_asymmetry <= ASYMMETRIC_BY_ROUNDING
        computed.critical = of_operator(
            W, problem.friction, problem.contacts, floats=problem.joints > 0, symmetric=symmetric
        )
    found: CriticalFriction = computed.critical
    return found


def _reason(problem: LocalProblem, critical: CriticalFriction) -> str:
    if critical.above.size:
        i = int(np.argmax(critical.ratio))
        return (
            f"may exist: mu = {problem.friction[i]:.3g} of {problem.contact_name(i)} is not below the critical "
            f"{critical.single[i]:.3g}"
        )
    return f"are not excluded ({LARGEST_RATIO}: {critical.contraction:.3g})"


def _dependent(problem: LocalProblem, closed: Mask, stuck: Mask, along: Array) -> bool:
    kept = closed[:, None] & (stuck[:, None] | (np.arange(problem.dimension) == 0))
    if not kept.any():
        return False
    pushes = np.where(stuck[:, None, None], np.eye(problem.dimension), along[:, None, :])
    matrix = _compliance_along(problem, pushes, kept.ravel())
    if problem.joints:
        joints, scale = problem.joint_scale, problem.contact_scale[:, None, None]
        V = problem.bilateral.toarray().reshape(*pushes.shape[:2], -1) * scale * joints
        coupling = np.matmul(pushes, V).reshape(-1, len(joints))[kept.ravel()]
        inner = problem.bilateral_delassus.toarray() * np.outer(joints, joints)
        matrix = np.block([[matrix, coupling], [coupling.T, inner]])
    return are_dependent(matrix)


def _compliance_along(problem: LocalProblem, pushes: Array, kept: Mask) -> Array:
    """Return B'WB of those rows B (d m, d m) that are `kept`, (m, d, d) by contacts."""
    W, (m, d, _) = problem.scaled_delassus, pushes.shape
    if m * d > WORTH_SPARSE_PRODUCTS:
        B = sp.bsr_array((pushes, np.arange(m), np.arange(m + 1))).tocsr()[kept]
        return np.asarray((B @ W @ B.T).toarray())
    pushed = np.matmul(pushes, W.toarray().reshape(m, d, m * d)).reshape(m * d, m * d)[kept]
    matrix: Array = np.matmul(pushes, pushed.T.reshape(m, d, -1)).reshape(m * d, -1)[kept].T
    return matrix


# The smallest scales by which Siconos divides.
LEAST_LOCAL_SCALE, LEAST_GLOBAL_SCALE = 2.0**-52, 2.0**-26


@checked
@own_floating_point
def siconos_local_error(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None = None) -> float:
    """Return |n| / max(|q|, |r|, |u|), u = W r + q: Siconos's `fc3d_compute_error`, and the same in the plane.

    The division is left out where the scale is no larger than machine precision.

    Parameters
    ----------
    force : (m, d) or flat array
        r, on the body.
    joint_force : (p,) array, needed where the problem has joints

    Raises
    ------
    InvalidProblem
        Wrong shapes.

    Examples
    --------
    >>> one = LocalProblem(delassus=[[1.0, 0.0], [0.0, 1.0]], offset=[-3.0, 4.0], friction=0.5, dimension=2)
    >>> siconos_local_error(one, [0.0, 0.0])  # n = (-12, 6)/5, |q| = 5
    0.5366563145999496
    """
    return _siconos_error(problem, *_local(problem, force, joint_force))


def _siconos_error(problem: LocalProblem, r: Array, residual: float, velocity: Array) -> float:
    scale = max(float(np.linalg.norm(part)) for part in (problem.offset, r, velocity))
    return residual / scale if scale > LEAST_LOCAL_SCALE else residual


@checked
@own_floating_point
def acary_bremond_huber_error(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None = None) -> float:
    """Return |n| / |q|, the error in the comparison of solvers by Acary, Bremond and Huber (2018).

    Raises
    ------
    InvalidProblem
        Wrong shapes, or q = 0.
    """
    if not (size := float(np.linalg.norm(problem.offset))):
        raise InvalidProblem("offset: the error is relative to |q|, and q is zero")
    return _local(problem, force, joint_force)[1] / size


@checked
@own_floating_point
def fclib_merit_1(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None = None) -> float:
    """Return |n| / (1 + sqrt(|q|)) + |V'r + R l + s| / (1 + |s|), FCLIB's `fclib_merit_local` with MERIT_1.

    The root is FCLIB's own: it takes that of a norm. There is no such merit in the plane.

    Raises
    ------
    InvalidProblem
        Wrong shapes.
    Unsupported
        Two dimensions.
    """
    if problem.dimension != 3:
        raise Unsupported("fclib_merit_1: FCLIB defines it in three dimensions only")
    r, residual, _ = _local(problem, force, joint_force)
    joint = _joints(problem, joint_force)
    left = problem.bilateral.T @ r.ravel() + problem.bilateral_delassus @ joint + problem.bilateral_offset
    merit = residual / (1 + np.sqrt(np.linalg.norm(problem.offset)))
    return float(merit + np.linalg.norm(left) / (1 + np.linalg.norm(problem.bilateral_offset)))


@checked
@own_floating_point
def siconos_global_error(
    problem: ContactProblem, displacement: ArrayLike, normal_force: ArrayLike, friction_force: ArrayLike
) -> float:
    """Return |q + H r - M v| / max(|q|, |M v|, |H r|) + |n| / max(|u|, |r|), Siconos's `gfc3d_compute_error`.

    M is the stiffness, q the load, v the displacement, H r = -E_N'l_N - E_T'l_T and u = (gap, slip). Neither part is
    divided by a scale of sqrt(machine precision) or less.

    Parameters
    ----------
    problem : ContactProblem, with tangential rows and friction
    displacement : (n,) array [length]
    normal_force : (m,) array [force], positive in compression
    friction_force : (m, d-1) or flat array [force], l_T, along the slip

    Raises
    ------
    InvalidProblem
        Wrong shapes, or no tangential rows.
    Unsupported
        The problem has ties, which Siconos's form has not.
    """
    if problem.tangent is None or problem.slip_origin is None or problem.friction is None:
        raise InvalidProblem("siconos_global_error: expected a problem with tangential rows and friction")
    if problem.ties:
        raise Unsupported("siconos_global_error: the formula has no ties, and the problem has")
    v = _shaped("displacement", displacement, (problem.dimension,))
    pressed = _shaped("normal_force", normal_force, (problem.contacts,))
    dragged = _shaped("friction_force", friction_force, problem.slip_origin.shape)
    inner = problem.stiffness_rows @ v
    outer = -(problem.normal.T @ pressed) - problem.tangent.T @ dragged.ravel()
    slip: Any = slips(problem, v)
    u, r = np.column_stack([problem.gap - problem.normal @ v, slip]), np.column_stack([pressed, -dragged])
    balance = _scaled(problem.load + outer - inner, problem.load, inner, outer)
    return balance + _scaled(natural_map(r, u, problem.friction), u, r)


def _scaled(error: Any, *scales: Any) -> float:
    size, scale = float(np.linalg.norm(error)), max(float(np.linalg.norm(part)) for part in scales)
    return size / scale if scale > LEAST_GLOBAL_SCALE else size


def _local(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None) -> tuple[Array, float, Array]:
    """Return r, |n| and u of the local form."""
    r, joint = _read(problem, force, joint_force)
    velocity = velocity_of(problem, r, joint)
    return r, float(np.linalg.norm(natural_map(r, velocity, problem.friction))), velocity


def _joints(problem: LocalProblem, joint_force: ArrayLike | None) -> Vector:
    return _shaped("joint_force", [] if joint_force is None else joint_force, (problem.joints,))


def _shaped(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = read_array(name, value)
    if array.shape not in (shape, (int(np.prod(shape)),)):
        raise InvalidProblem(f"{name}: expected shape {shape}, got {array.shape}")
    return array.reshape(shape)


# Velocities and forces below this part of the largest, as roots of energies, are rounding errors.
VELOCITY_ROUNDING = 1e-12
# The error of velocities and slip directions by the last digits of forces, relative to the velocities that meet.
ROUNDING_OF_VELOCITIES = 4 * EPS

FIGURES = ("penetration", "tension", "complementarity", "cone", "slip_direction", "joints")


@checked
@own_floating_point
def certify_local(
    problem: LocalProblem,
    force: ArrayLike,
    joint_force: ArrayLike | None = None,
    tolerance: float = 1e-9,
) -> LocalCertificate:
    """Judge anyone's forces; velocities are u = W r + q + V l of W as given, symmetric or not.

    Parameters
    ----------
    problem : LocalProblem
    force : (m, d) or flat array
        The forces on the body, contact by contact in the order (N, T1, T2).
    joint_force : (p,) array, needed where the problem has joints
    tolerance : float
        Largest figure that passes.

    Raises
    ------
    InvalidProblem
        Wrong shapes, or a tolerance that is not a positive number. NaN is not an error here: it fails.

    Examples
    --------
    >>> one = LocalProblem(delassus=[[1.0, 0.0], [0.0, 1.0]], offset=[-3.0, 4.0], friction=0.5, dimension=2)
    >>> found = certify_local(one, [3.0, -1.5])  # it slides, and pushes back with mu r_N
    >>> found.passed, found.scope, bool(found.force_bound[0] < 1e-12)
    (True, 'global', True)
    """
    measured = measured_forces(problem, force, joint_force, tolerance)
    if measured is None:
        return not_finite(problem, tolerance)
    if not (certified := measured.verdict).passed:
        return certified
    found = local_bounds(problem, measured.force, _status(problem, *measured.state))
    if isinstance(found, str):
        return replace(certified, reasons=(f"force_error, force_bound: {found}",))
    return replace(
        certified, force_error=found.force_error, force_bound=found.force_bound, scope=found.scope, radius=found.radius
    )


def _status(problem: LocalProblem, closed: Mask, stuck: Mask, along: Array) -> Status:
    """Return the states (m,) of contacts; in the plane the sign of the slip, against which they push."""
    slides = np.where(along[:, 1] > 0, SLIP_BACK, SLIP_ON) if problem.dimension == 2 else SLIP_ON
    sliding = np.where(problem.friction > 0, slides, SLIP_ON)
    return np.asarray(np.where(closed, np.where(stuck, STICK, sliding), OPEN).astype(np.int8))


def measured_forces(
    problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None, tolerance: float
) -> MeasuredForces | None:
    """Return the figures of forces, None if one is not finite; raise InvalidProblem for an invalid tolerance.

    Parameters
    ----------
    problem, force, joint_force, tolerance : as in `certify_local`
    """
    given: Any = tolerance
    if not is_number(given) or not 0 < given < np.inf:
        raise InvalidProblem(f"tolerance: expected a positive number, got {shown(tolerance)}")
    r, joint = _read(problem, force, joint_force)
    finite = np.isfinite(r).all() and np.isfinite(joint).all()
    return MeasuredForces(problem, r, joint, tolerance) if finite else None


def contact_figures(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None = None) -> dict[str, Vector]:
    """Return each figure of `LocalCertificate` for every contact (m,), without joints; forces must be finite."""
    measured = MeasuredForces(problem, *_read(problem, force, joint_force))
    return {name: getattr(measured, name) for name in FIGURES if name != "joints"}


def _natural_map(problem: LocalProblem, force: Array, velocity: Array, met: Array) -> float:
    """Return the largest |n_i| over the largest |s_i q_i| or load of a joint, n = r - P_K(r - u - mu |u_T| e_N).

    |n_i| is the `distance_from_law`. Forces r_i / s_i and velocities s_i u_i are roots of energies, s the problem's
    `contact_scale`: no contact's own unit changes them. With no offset and no load at all it is relative to the
    velocities that meet, `met` (m, d).
    """
    scale = problem.contact_scale[:, None]
    missed = distance_from_law(force / scale, scale * velocity, problem.friction)
    drive = (scale * problem.offset.reshape(force.shape), problem.bilateral_offset * problem.joint_scale)
    size = max(float(np.max(abs(part), initial=0.0)) for part in drive)
    return float(np.max(missed / (size or float(np.max(scale * met, initial=0.0)) or 1.0), initial=0.0))


def _meeting(problem: LocalProblem, force: Array, joint_force: Vector) -> Vector:
    """Return the velocities that meet, |W||r| + |V||l| + |q| (d m,)."""
    if (computed := problem._of_matrices).sizes is None:
        computed.sizes = abs(problem.delassus)
    pushed = computed.sizes @ abs(force).ravel()
    if problem.joints:
        pushed = pushed + abs(problem.bilateral) @ abs(joint_force)
    return np.asarray(pushed + abs(problem.offset))


def _size(problem: LocalProblem, met: Array) -> float:
    """Return the largest scaled velocity: of the problem's `drive`, and of the response to the forces."""
    answers = np.maximum(met - abs(problem.offset).reshape(met.shape), 0.0) * problem.contact_scale[:, None]
    return max(problem.drive, float(np.max(answers, initial=0.0)))


class MeasuredForces:
    """Every figure of forces, for every contact or joint, and the certificate that they make.

    Parameters
    ----------
    problem, r, joint, tolerance : LocalProblem, finite forces (m, d) and (p,), largest figure that passes
    """

    def __init__(self, problem: LocalProblem, r: Array, joint: Vector, tolerance: float = 1e-9) -> None:
        u = velocity_of(problem, r, joint)
        self._problem, self._tolerance, self.force, self.velocity = problem, tolerance, r, u
        self._met = met = _meeting(problem, r, joint).reshape(r.shape)
        self._along, self._across = met[:, 0], met[:, 1:].max(axis=1, initial=0.0)
        self._nothing = VELOCITY_ROUNDING * _size(problem, met)
        self._own = problem.own_compliances
        scale = problem.contact_scale
        u = np.where(abs(u) * scale[:, None] > self._nothing, u, 0.0)
        bound = problem.friction * np.maximum(r[:, 0], 0.0)
        size, wrong = lengths(r[:, 1:]), r[:, 1:] + bound[:, None] * directions(u[:, 1:])
        self.slip = _part(lengths(u[:, 1:]), self._across)
        self.gap = _part(abs(u[:, 0]), self._along)
        self.push = self._measure(r[:, 0], 0)
        self.penetration = _part(np.maximum(-u[:, 0], 0.0), self._along)
        self.tension = np.maximum(-self.push, 0.0)
        self.complementarity = np.maximum(np.minimum(_part(u[:, 0], self._along), self.push), 0.0)
        self.cone = self._measure(np.maximum(size - bound, 0.0), 1)
        turned = np.minimum(_part(np.full(len(bound), ROUNDING_OF_VELOCITIES), self.slip), 1.0)
        wrong_size = np.maximum(lengths(wrong) - turned * bound, 0.0)
        self.slip_direction = np.minimum(self.slip, self._measure(wrong_size, 1))
        if not problem.joints:
            self.joints = np.zeros(0)
            return
        left = abs(problem.bilateral.T @ r.ravel() + problem.bilateral_delassus @ joint + problem.bilateral_offset)
        meeting = abs(problem.bilateral).T @ abs(r).ravel() + abs(problem.bilateral_delassus) @ abs(joint)
        meeting = meeting + abs(problem.bilateral_offset)
        self.joints = np.divide(left, meeting, out=np.zeros_like(left), where=meeting > 0)

    def _measure(self, force: Vector, kind: int) -> Vector:
        """Return the measure of normal (0) or tangential (1) forces (m,) by their effect on the velocities that meet.

        If they have no effect, the largest entry of the block and the larger of both velocities are used.
        """
        met, own = (self._along, self._across)[kind], self._own[kind]
        any_own, any_met = self._own.max(axis=0), np.maximum(self._along, self._across)
        size = np.where(abs(force) > self._nothing * self._problem.contact_scale, abs(force), 0.0)
        heard = own > VELOCITY_ROUNDING * any_own
        return np.copysign(_part(np.where(heard, own, any_own) * size, np.where(heard, met, any_met)), force)

    @cached_property
    def verdict(self) -> LocalCertificate:
        """Return the certificate with these figures; uniqueness is examined when its findings are read."""
        r, u, tolerance = self.force, self.velocity, self._tolerance
        residual = float(np.linalg.norm(natural_map(r, u, self._problem.friction)))
        figures: dict[str, Any] = {name: float(getattr(self, name).max(initial=0.0)) for name in FIGURES}
        errors = {
            "natural_map": _natural_map(self._problem, r, u, self._met),
            "siconos_error": _siconos_error(self._problem, r, residual, u),
        }
        failures = [self._failure(name) for name in FIGURES if not figures[name] <= tolerance]
        if not errors["natural_map"] <= tolerance:  # NaN if forces overflow
            failures.append(f"natural map: {errors['natural_map']:.3g} of the offsets (tolerance {tolerance:g})")
        others = partial(_local_uniqueness, self._problem, *self.state)
        return _certificate({**errors, **figures}, tuple(failures), tolerance, self.gap, self.slip, self.push, others)

    @cached_property
    def state(self) -> tuple[Mask, Mask, Array]:
        """Return closed and sticking contacts, (m,) each, and the force directions of slipping ones (m, d)."""
        tolerance = self._tolerance
        closed = (self.push > tolerance) | (self.gap <= tolerance)
        stuck = closed & (self.slip <= tolerance) & (self._problem.friction > 0) & (self.push > tolerance)
        drag = self._problem.friction[:, None] * directions(self.velocity[:, 1:])
        return closed, stuck, np.column_stack([np.ones(len(drag)), -drag])

    def _failure(self, name: str) -> str:
        values = getattr(self, name)
        worst = int(np.argmax(values))
        where = f"joint {worst}" if name == "joints" else self._problem.contact_name(worst)
        return f"{name.replace('_', ' ')}: {values[worst]:.3g} at {where} (tolerance {self._tolerance:g})"


def _part(size: Vector, whole: Vector) -> Vector:
    """Return size / whole with 0/0 = 0, also if the reciprocal of the whole overflows."""
    return np.divide(size, whole, out=np.zeros(whole.shape), where=whole > 0)


def _read(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None) -> tuple[Array, Vector]:
    return _shaped("force", force, (problem.contacts, problem.dimension)), _joints(problem, joint_force)


def not_finite(problem: LocalProblem, tolerance: float) -> LocalCertificate:
    """Return the certificate of forces that are not finite, which it refuses."""
    none, figures = np.zeros(problem.contacts), dict.fromkeys(("natural_map", "siconos_error", *FIGURES), float("inf"))
    nothing = partial(tuple, ((), ()))
    return _certificate(figures, ("force: it is not finite",), tolerance, none + np.inf, none, none, nothing)


def _certificate(
    figures: dict[str, Any],
    failures: tuple[str, ...],
    tolerance: float,
    gap: Vector,
    slip: Vector,
    push: Vector,
    others: Callable[[], Any],
) -> LocalCertificate:
    return LocalCertificate(
        **figures,
        failures=failures,
        tolerance=tolerance,
        passed=not failures,
        gap_measure=gap,
        slip_measure=slip,
        force_measure=push,
        _examine=others,
    )
