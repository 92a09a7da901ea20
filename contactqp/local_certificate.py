"""Judging forces of a local problem: each contact in its own measure, and the errors that other codes publish.

At contact i let L_i be the largest row sum of |W||r| + |V||l| + |q|, the size of the velocities that meet there, and
w_i the largest |entry| of its own block of W. A velocity is measured as its size over L_i, a force as w_i |r_i| / L_i;
0/0 is 0. All measures survive a change of units and common scaling of a contact's rows.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactqp.coulomb_cone import directions, lengths, natural_map
from contactqp.errors import InvalidProblem, refuse_other
from contactqp.local_problem import LocalProblem
from contactqp.local_uniqueness import local_uniqueness
from contactqp.problem_data import Vector, read_array
from contactqp.published_errors import siconos_local_error

FIGURES = ("penetration", "tension", "complementarity", "cone", "slip_direction", "joints")


@dataclass(frozen=True, eq=False)
class LocalCertificate:
    """What forces violate, the worst contact, and the published errors; `passed` if none is beyond `tolerance`."""

    natural_map: float  # |r - P_K(r - u - mu |u_T| e_N)| / |q|, where max |W| = 1 and |q| = sqrt(d m)
    siconos_error: float  # `published_errors.siconos_local_error`, W and q as given
    penetration: float  # (-u_N)+ as a velocity
    tension: float  # (-r_N)+ as a force
    complementarity: float  # min(u_N, r_N), each in its own measure
    cone: float  # (|r_T| - mu r_N)+ as a force
    slip_direction: float  # min(|u_T|, |r_T + mu r_N u_T/|u_T||), each in its own measure
    joints: float  # |V'r + R l + s| / (|V|'|r| + |R||l| + |s|)
    failures: tuple[str, ...]
    uniqueness: tuple[
        str, ...
    ]  # with friction, what speaks against these being the only forces; no part of the verdict
    notes: tuple[str, ...]
    tolerance: float
    passed: bool
    slip_measure: Vector = field(repr=False)  # (m,) |u_T| as a velocity
    force_measure: Vector = field(repr=False)  # (m,) r_N as a force

    def __str__(self) -> str:
        lines = ["passed" if self.passed else "REFUSED", f"  natural map {self.natural_map:.3g}"]
        return "\n".join(
            [*lines, *(f"  {text}" for text in self.failures), *(f"  note: {text}" for text in self.notes)]
        )


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
    if isinstance(given, bool) or not isinstance(given, (int, float, np.number)) or not 0 < given < np.inf:
        raise InvalidProblem(f"tolerance: expected a positive number, got {tolerance!r}")
    r, joint = _read(problem, force, joint_force)
    if not np.all(np.isfinite(r)) or not np.all(np.isfinite(joint)):
        return _not_finite(problem, tolerance)
    measured = _Measured(problem, r, joint)
    figures = {name: float(np.max(getattr(measured, name), initial=0.0)) for name in FIGURES}
    errors = {
        "natural_map": normalised_error(problem, r, joint),
        "siconos_error": siconos_local_error(problem, r, joint),
    }
    failures = [measured.failure(name, tolerance) for name in FIGURES if figures[name] > tolerance]
    if errors["natural_map"] > tolerance:
        failures.append(f"natural map: {errors['natural_map']:.3g} of |q| (tolerance {tolerance:g})")
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


def normalised_error(problem: LocalProblem, force: NDArray[np.float64], joint_force: Vector) -> float:
    """|r - P_K(r - u - mu |u_T| e_N)| / |q| of the problem scaled so that max |W| = 1 and |q| = sqrt(d m).

    Acary, Bremond, Huber (2018); their measure depends on the scale of W and q, which scaling makes one. With no
    offset at all, where r = 0 is right, it is the size of the scaled residual.
    """
    largest = float(np.max(abs(problem.delassus.data), initial=0.0)) or 1.0
    size = float(np.linalg.norm(problem.offset)) / np.sqrt(max(len(problem.offset), 1))
    size = size or 1.0
    velocity = problem.velocity(force, joint_force) / size
    residual = natural_map(force * (largest / size), velocity, problem.friction)
    return float(np.linalg.norm(residual) / np.sqrt(max(len(problem.offset), 1)))


class _Measured:
    """Every figure for every contact or joint."""

    def __init__(self, problem: LocalProblem, r: NDArray[np.float64], joint: Vector) -> None:
        self._problem = problem
        shape = (problem.contacts, problem.dimension)
        u = problem.velocity(r, joint)
        self._velocity = u
        met = abs(problem.delassus) @ abs(r).ravel() + abs(problem.bilateral) @ abs(joint) + abs(problem.offset)
        L = np.max(met.reshape(shape), axis=1, initial=0.0)
        w = own_blocks(problem)
        bound = problem.friction * np.maximum(r[:, 0], 0.0)
        size, wrong = lengths(r[:, 1:]), r[:, 1:] + bound[:, None] * directions(u[:, 1:])
        self.slip = _part(lengths(u[:, 1:]), L)
        self.gap = _part(abs(u[:, 0]), L)
        self.push = _part(w * r[:, 0], L)
        self.penetration = _part(np.maximum(-u[:, 0], 0.0), L)
        self.tension = np.maximum(-self.push, 0.0)
        self.complementarity = np.maximum(np.minimum(_part(u[:, 0], L), self.push), 0.0)
        self.cone = _part(np.maximum(size - bound, 0.0) * w, L)
        self.slip_direction = np.minimum(self.slip, _part(lengths(wrong) * w, L))
        left = abs(problem.bilateral.T @ r.ravel() + problem.bilateral_delassus @ joint + problem.bilateral_offset)
        meeting = abs(problem.bilateral).T @ abs(r).ravel() + abs(problem.bilateral_delassus) @ abs(joint)
        meeting = meeting + abs(problem.bilateral_offset)
        self.joints = np.divide(left, meeting, out=np.zeros_like(left), where=meeting > 0)

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


def own_blocks(problem: LocalProblem) -> Vector:
    """(m,) the largest |entry| of each contact's own block of W."""
    entries = problem.delassus.tocoo()
    row, column = entries.row // problem.dimension, entries.col // problem.dimension
    own = row == column
    largest = np.zeros(problem.contacts)
    np.maximum.at(largest, row[own], abs(entries.data[own]))
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
