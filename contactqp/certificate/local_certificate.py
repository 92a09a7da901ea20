"""Judging forces of a local problem: each contact in its own measure, and the errors that other codes publish.

At contact i let L_N be its normal row of |W||r| + |V||l| + |q|, the size of the normal velocities that meet there, and
L_T the larger of its tangential rows. A normal velocity is measured as its size over L_N, a slip as its size over L_T,
a normal force as w_N |r| / L_N and friction as w_T |r| / L_T, w_N = W_NN and w_T the largest |entry| of W_TT of the
contact alone; 0/0 is 0. A slip that is large beside the gap hides no overlap, and a contact that is far hides nothing
at another: what is less than 1e-12 of the largest velocity that drives or answers, both as roots of energies, is
rounding and counts as none, and offsets of open contacts are not among these. All measures survive a change of units
and common scaling of a contact's rows, the natural map too (`scaled_natural_map`); the errors that are published do
not, and have no part in the verdict.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.certificate.local_uniqueness import local_uniqueness
from contactqp.certificate.published_errors import siconos_local_error
from contactqp.errors import InvalidProblem, refuse_other
from contactqp.linalg.extended_rows import velocity_of
from contactqp.model.arrays import Vector
from contactqp.model.coulomb_cone import directions, lengths, natural_map
from contactqp.model.floating_point import own_floating_point
from contactqp.model.local_problem import LocalProblem
from contactqp.model.problem_data import is_number, read_array
from contactqp.model.verdicts import LocalCertificate

# Velocities and forces of this part of the largest, as roots of energies, are rounding.
NOTHING = 1e-12

FIGURES = ("penetration", "tension", "complementarity", "cone", "slip_direction", "joints")


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
    force : (m, d) or flat array
        On the body, in the order (N, T1, T2).
    joint_force : (p,) array, needed where the problem has joints
    tolerance : float
        Largest figure that passes.

    Raises
    ------
    InvalidProblem
        Wrong shapes, or a tolerance that is no positive number. NaN is no error here: it fails.
    """
    refuse_other("certify_local", problem, LocalProblem)
    certificate = judged(problem, force, joint_force, tolerance)
    r, joint = _read(problem, force, joint_force)
    if not np.all(np.isfinite(r)) or not np.all(np.isfinite(joint)):
        return certificate
    others = local_uniqueness(problem, *_Measured(problem, r, joint).state(tolerance))
    return replace(certificate, uniqueness=others.findings, notes=others.notes)


def judged(
    problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None = None, tolerance: float = 1e-9
) -> LocalCertificate:
    """`certify_local` without a word on other answers, which costs more than the rest."""
    given: Any = tolerance
    if not is_number(given) or not 0 < given < np.inf:
        raise InvalidProblem(f"tolerance: expected a positive number, got {tolerance!r}")
    r, joint = _read(problem, force, joint_force)
    if not np.all(np.isfinite(r)) or not np.all(np.isfinite(joint)):
        return _not_finite(problem, tolerance)
    measured = _Measured(problem, r, joint)
    figures = {name: float(np.max(getattr(measured, name), initial=0.0)) for name in FIGURES}
    errors = {
        "natural_map": scaled_natural_map(problem, r, joint),
        "siconos_error": siconos_local_error(problem, r, joint),
    }
    failures = [measured.failure(name, tolerance) for name in FIGURES if figures[name] > tolerance]
    if errors["natural_map"] > tolerance:
        failures.append(f"natural map: {errors['natural_map']:.3g} of the offsets (tolerance {tolerance:g})")
    return LocalCertificate(
        **errors,
        **figures,
        failures=tuple(failures),
        uniqueness=(),
        notes=(),
        tolerance=tolerance,
        passed=not failures,
        slip_measure=measured.slip,
        force_measure=measured.push,
    )


def contact_figures(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None = None) -> dict[str, Vector]:
    """(m,) each figure of `LocalCertificate` for every contact, the joints left out; of finite forces."""
    measured = _Measured(problem, *_read(problem, force, joint_force))
    return {name: getattr(measured, name) for name in FIGURES if name != "joints"}


def scaled_natural_map(problem: LocalProblem, force: NDArray[np.float64], joint_force: Vector) -> float:
    """The largest |n_i| over the largest |s_i q_i| or load of a joint, n = r - P_K(r - u - mu |u_T| e_N).

    Forces r_i / s_i and velocities s_i u_i are roots of energies, s the problem's `contact_scale`: no contact's own
    unit changes them. With no offset and no load at all it is relative to the velocities that meet.
    """
    scale, shape = problem.contact_scale[:, None], (problem.contacts, problem.dimension)
    residual = natural_map(force / scale, scale * velocity_of(problem, force, joint_force), problem.friction)
    drive = (scale * problem.offset.reshape(shape), problem.bilateral_offset * problem.joint_scale)
    size = max(float(np.max(abs(part), initial=0.0)) for part in drive)
    size = size or float(np.max(scale * _meeting(problem, force, joint_force).reshape(shape), initial=0.0)) or 1.0
    return float(np.max(lengths(residual / size), initial=0.0))


def _meeting(problem: LocalProblem, force: NDArray[np.float64], joint_force: Vector) -> Vector:
    """|W||r| + |V||l| + |q| (d m,): the velocities that meet."""
    pushed = abs(problem.delassus) @ abs(force).ravel() + abs(problem.bilateral) @ abs(joint_force)
    return np.asarray(pushed + abs(problem.offset))


def _size(problem: LocalProblem, met: NDArray[np.float64]) -> float:
    """The largest scaled velocity that drives or answers: the problem's `drive`, and what forces make of contacts."""
    answers = np.maximum(met - abs(problem.offset).reshape(met.shape), 0.0) * problem.contact_scale[:, None]
    return max(problem.drive, float(np.max(answers, initial=0.0)))


class _Measured:
    """Every figure for every contact or joint."""

    def __init__(self, problem: LocalProblem, r: NDArray[np.float64], joint: Vector) -> None:
        self._problem = problem
        shape = (problem.contacts, problem.dimension)
        u = velocity_of(problem, r, joint)
        self._velocity = u
        met = _meeting(problem, r, joint).reshape(shape)
        self._along, self._across = met[:, 0], np.max(met[:, 1:], axis=1, initial=0.0)
        self._nothing = NOTHING * _size(problem, met)
        self._own = _own_blocks(problem)
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
        self.slip_direction = np.minimum(self.slip, self._measure(lengths(wrong), 1))
        left = abs(problem.bilateral.T @ r.ravel() + problem.bilateral_delassus @ joint + problem.bilateral_offset)
        meeting = abs(problem.bilateral).T @ abs(r).ravel() + abs(problem.bilateral_delassus) @ abs(joint)
        meeting = meeting + abs(problem.bilateral_offset)
        self.joints = np.divide(left, meeting, out=np.zeros_like(left), where=meeting > 0)

    def _measure(self, force: Vector, kind: int) -> Vector:
        """(m,) normal (0) or tangential (1) forces by what they do to the velocities that meet in their own direction.

        Where they do nothing there, the largest entry of the block and the larger of both velocities are the measure.
        """
        met, own = (self._along, self._across)[kind], self._own[kind]
        any_own, any_met = np.max(self._own, axis=0), np.maximum(self._along, self._across)
        size = np.where(abs(force) > self._nothing * self._problem.contact_scale, abs(force), 0.0)
        heard = own > NOTHING * any_own
        return np.copysign(_part(np.where(heard, own, any_own) * size, np.where(heard, met, any_met)), force)

    def state(self, tolerance: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.float64]]:
        """(m,) which are closed, which of them stick, and (m, d) along what those that slip push."""
        closed = (self.push > tolerance) | (self.gap <= tolerance)
        stuck = closed & (self.slip <= tolerance) & (self._problem.friction > 0) & (self.push > tolerance)
        rubs = self._problem.friction[:, None] * directions(self._velocity[:, 1:])
        return closed, stuck, np.column_stack([np.ones(len(rubs)), -rubs])

    def failure(self, name: str, tolerance: float) -> str:
        values = getattr(self, name)
        worst = int(np.argmax(values))
        where = f"joint {worst}" if name == "joints" else self._problem.contact_name(worst)
        return f"{name.replace('_', ' ')}: {values[worst]:.3g} at {where} (tolerance {tolerance:g})"


def _part(size: Vector, whole: Vector) -> Vector:
    """size / whole with 0/0 = 0, also where the reciprocal of the whole is no double."""
    return np.divide(size, whole, out=np.zeros_like(whole), where=whole > 0)


def _own_blocks(problem: LocalProblem) -> NDArray[np.float64]:
    """(2, m) the largest |entry| of each contact's own block of W along its normal, and along its tangents."""
    entries, d = problem.delassus.tocoo(), problem.dimension
    kind = np.minimum(entries.row % d, 1)
    own = (entries.row // d == entries.col // d) & (kind == np.minimum(entries.col % d, 1))
    largest = np.zeros((2, problem.contacts))
    np.maximum.at(largest, (kind[own], entries.row[own] // d), abs(entries.data[own]))
    return largest


def _read(problem: LocalProblem, force: ArrayLike, joint_force: ArrayLike | None) -> tuple[NDArray[np.float64], Vector]:
    shape = (problem.contacts, problem.dimension)
    r = read_array("force", force)
    joint = read_array("joint_force", [] if joint_force is None else joint_force)
    if r.shape not in (shape, (r.size,)) or r.size != shape[0] * shape[1]:
        raise InvalidProblem(f"force: expected shape {shape}, got {r.shape}")
    if joint.shape != (problem.joints,):
        raise InvalidProblem(f"joint_force: expected shape ({problem.joints},), got {joint.shape}")
    return r.reshape(shape), joint


def _not_finite(problem: LocalProblem, tolerance: float) -> LocalCertificate:
    infinite = float("inf")
    none = np.zeros(problem.contacts)
    return LocalCertificate(
        natural_map=infinite,
        siconos_error=infinite,
        **dict.fromkeys(FIGURES, infinite),
        failures=("force: it is not finite",),
        uniqueness=(),
        notes=(),
        tolerance=tolerance,
        passed=False,
        slip_measure=none,
        force_measure=none,
    )
