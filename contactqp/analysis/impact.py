"""Compute the motion of bodies with impact: one contact problem per time step, all with one factorisation."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from contactqp.analysis.history import History, LazySolutions, OnAllRows, events_on_all_rows
from contactqp.analysis.motion.mass_matrix import massless, read_mass, redistributed_mass, touched
from contactqp.analysis.motion.motion_history import MotionHistory, Moving
from contactqp.analysis.motion.schemes import SCHEMES, find
from contactqp.analysis.motion.schemes.scheme import SchemeData, SchemeEntry, SchemeSettings
from contactqp.analysis.motion.time_stepping import MotionRun
from contactqp.certificate.idle_rows import ActingRows, acting_rows
from contactqp.certificate.number_range import refuse_far_from_one
from contactqp.errors import InvalidProblem, NotConverged, Unsupported, shown
from contactqp.model.arguments import checked
from contactqp.model.arrays import TINY, Array, Vector, one_blas_thread, own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import is_number, read_vector, refuse_not_positive
from contactqp.model.solution import Solution
from contactqp.solving.methods import find as find_method
from contactqp.solving.methods import meant_option, registered_name, takes, within_time_of

# Arguments of `impact` in addition to the options of a method.
OWN_ARGUMENTS = ("duration", "time_step", "scheme", "load", "theta", "restitution", "penalty", "start_time")
# The admissible overlap or tie residual of a start, relative to the lengths at the contact.
ROUNDING_OF_STARTS = 1e-9


@checked
@own_floating_point
def impact(
    problem: ContactProblem,
    mass: Any,
    displacement: ArrayLike,
    velocity: ArrayLike,
    duration: float,
    time_step: float,
    scheme: str = "moreau-jean",
    *,
    load: Callable[[float], ArrayLike] | None = None,
    theta: float = 0.5,
    restitution: float = 0.0,
    penalty: float | None = None,
    start_time: float = 0.0,
    method: str = "active-set",
    **options: Any,
) -> MotionHistory:
    """Compute the motion of bodies with contact and impact from a displacement and a velocity.

        M dv/dt + K u + E_N'l_N + E_T'l_T + A'nu = f,    E_N u <= g,  l_N >= 0,  l_N (g - E_N u) = 0,    A u = b

    with Coulomb's law of l_T and the velocity of slip. Each step is one `ContactProblem` (two in the scheme of
    Deuflhard, Krause and Ertel) with the same stiffness of K, M and the step, which is factorised once; a step costs a
    back-substitution and a small problem of the contacts that it may close. Steps are certified in groups of 64 by
    equilibrium, penetration, tension, complementarity, cone, slip and ties of the scheme's problem; from a refused step
    on, the rest of its group is solved again as separate problems.

    Parameters
    ----------
    problem : ContactProblem
        K, rows, gaps, ties and friction; `problem.load` is the load unless `load` is given.
    mass : (n, n) matrix or (n,) diagonal [force time^2 / length]
        M, symmetric positive semidefinite, and singular only where the scheme allows it. For bodies, `system.mass()`
        returns it.
    displacement, velocity : (n,) arrays [length], [length / time]
        u and v at the start, which must satisfy the constraints. For a single unknown these and the mass may be
        numbers.
    duration, time_step : float
        The motion has ceil(duration / time_step) steps, at least one: the step is no longer than the duration.
    scheme : str
        "moreau-jean": impulses and Newton's impact law (`theta`, `restitution`); robust, first order at contact.
        "modified-mass": trapezoidal rule, contact nodes without mass (`redistributed_mass` moves their mass to other
        nodes unless M has none there); contact nodes do not oscillate, and energy is conserved.
        "modified-mass-central": the same with central differences, explicit but for the contact nodes.
        "paoli-schatzman": central differences with a projection (`restitution`). "deuflhard-krause-ertel":
        contact-stabilised Newmark, for bodies: single masses stay at their stop. "newmark": the trapezoidal rule with
        Signorini's conditions at the end of the step; its energy blows up at impacts. "backward-euler": loses energy
        everywhere. "penalty": central differences with contact springs `penalty`.
    load : function of time, optional
        The function returns the load f (n,) [force] at an instant [time].
    theta : float
        The weight of the end of a step in Moreau's and Jean's scheme, from 1/2, which keeps energy, to 1.
    restitution : float
        Newton's coefficient e, from 0 to 1: normal velocity after an impact over that before.
    penalty : float, needed by the scheme "penalty"
        The stiffness of its contact springs [force / length]; other schemes refuse one.
    start_time : float
        The time of the start. `MotionHistory.resume` continues a motion from where it ended or failed.
    method, **options
        The method for the small problem of each step, any exact one, and its options, as in `solve`; `time_limit` [s]
        is that of the whole motion.

    Returns
    -------
    MotionHistory
        A `History` with `velocities`, `tie_forces`, energies that also have `impact`, taken by the contact forces, and
        `drift`, what the scheme has made of energy: total = start + work - dissipated - impact + drift.

    Warns
    -----
    TimeStepWarning
        The step is too long to resolve the duration of a contact, or, for the penalty scheme, for stability in contact.
        The message has both numbers, and is kept in `history.notes`.

    Raises
    ------
    InvalidProblem
        An argument is invalid, bodies overlap at the start, the scheme cannot use this mass, or the step of central
        differences is longer than their critical step.
    NotConverged, NotCertified
        A step has no answer or a wrong one, or the motion overflows; `history` is the motion so far.
    Unsupported
        A method that is approximate by design; friction with penalty.

    Notes
    -----
    Moreau 1988; Jean 1999; Newmark 1959; Khenous, Laborde and Renard 2008; Paoli and Schatzman 2002; Deuflhard, Krause
    and Ertel 2008; Doyen, Ern and Piperno 2011 compare them. Course chapter, section 2.6, whose wave equation has the
    wrong sign.

    Examples
    --------
    A mass thrown at a wall comes back with half of its speed:

    >>> ball = ContactProblem(stiffness=[[0.0]], load=[0.0], normal=[[1.0]], gap=[1.0])
    >>> thrown = impact(ball, [2.0], [0.0], [4.0], duration=1.0, time_step=0.1, restitution=0.5)
    >>> float(thrown.velocities[-1, 0]), [event.kind for event in thrown.events][0]
    (-2.0, 'closed')
    >>> round(thrown.energies[-1].impact, 12)
    12.0
    """
    problem._refuse_exchanged_arrays()
    entry = find(scheme)
    settings = _settings(entry, theta, restitution, penalty)
    method = registered_name(method)
    _refuse_unknown(method, options)
    _refuse_times(duration, time_step, start_time)
    refuse_far_from_one("impact", problem)
    if (rows := acting_rows(problem)) is not None:
        given: dict[str, Any] = dict(scheme=scheme, load=load, theta=theta, restitution=restitution, penalty=penalty)
        return _without_idle_rows(
            rows,
            mass,
            displacement,
            velocity,
            duration,
            time_step,
            **given,
            start_time=start_time,
            method=method,
            **options,
        )
    n = problem.dimension
    u, v = (
        read_vector(name, np.full(1, value) if n == 1 and is_number(value) else value, n)
        for name, value in (("displacement", displacement), ("velocity", velocity))
    )
    _refuse_start(problem, u, v)
    if not find_method(method).exact:
        raise Unsupported(f"{method}: approximate by design; contact springs are the scheme 'penalty'")
    if not entry.friction and problem.frictional:
        raise Unsupported(f"{scheme}: it takes no contacts with friction; take an exact scheme")
    stated = read_mass(mass, n)
    M = _mass(entry, stated, problem)
    body, loads = SchemeData(problem, M, float(time_step)), _loads(problem, load)
    with one_blas_thread(problem), within_time_of(options):
        run = MotionRun(entry.make(body, settings), loads, float(start_time), method, options)
        if "theta" in entry.knobs:  # its law is one of velocities
            _refuse_ringing(scheme, problem, M, loads(float(start_time)), u)
        if entry.explicit:
            run.check_critical_step(penalty)
        run.start(u, v, stated)
        return run.lasting(duration)


def _refuse_times(duration: Any, time_step: Any, start_time: Any) -> None:
    """Raise InvalidProblem for invalid times, or a step whose square overflows or underflows."""
    refuse_not_positive("duration", duration)
    refuse_not_positive("time_step", time_step)
    if not TINY <= float(time_step) * float(time_step) < np.inf:
        raise InvalidProblem(f"time_step: expected a step whose square is a number, got {shown(time_step)}")
    if not is_number(start_time) or not np.isfinite(start_time):
        raise InvalidProblem(f"start_time: expected a finite number, got {shown(start_time)}")


def _refuse_unknown(method: str, options: dict[str, Any]) -> None:
    """Raise InvalidProblem for an argument of neither `impact` nor the method."""
    unknown = sorted(name for name in options if not takes(method, name))
    if unknown:
        raise InvalidProblem(
            f"impact: unknown argument {unknown[0]!r}{meant_option(unknown[0], OWN_ARGUMENTS)}; beside options of "
            f"{method!r} it takes {', '.join(OWN_ARGUMENTS)}"
        )


def _without_idle_rows(rows: ActingRows, *start: Any, **given: Any) -> MotionHistory:
    """Return the motion of a problem, computed without its idle rows."""
    rows.refuse_conflict()
    try:
        return _MotionOfAllRows(rows, impact(rows.problem, *start, **given))
    except NotConverged as error:
        if isinstance(error.history, MotionHistory):
            error.history = _MotionOfAllRows(rows, error.history)
        raise


def _settings(entry: SchemeEntry, theta: Any, restitution: Any, penalty: Any) -> SchemeSettings:
    """Return the settings of the user; raise InvalidProblem for numbers out of range or not used by the scheme."""
    for name, value, low in (("theta", theta, 0.5), ("restitution", restitution, 0.0)):
        if not is_number(value) or not low <= value <= 1:
            raise InvalidProblem(f"{name}: expected a number from {low:g} to 1, got {shown(value)}")
    given = {"theta": theta != 0.5, "restitution": restitution != 0.0, "penalty": penalty is not None}
    for name, is_given in given.items():
        if is_given and name not in entry.knobs:
            takers = ", ".join(other for other, its in SCHEMES.items() if name in its.knobs)
            raise InvalidProblem(f"{name}: the scheme {entry.name!r} has none, only {takers}")
    if penalty is not None:
        refuse_not_positive("penalty", penalty)
    return SchemeSettings(float(theta), float(restitution), None if penalty is None else float(penalty))


def _refuse_start(problem: ContactProblem, u: Vector, v: Vector) -> None:
    """Raise InvalidProblem for a start that violates constraints."""
    room = problem.gap - problem.normal @ u
    size = abs(problem.normal) @ abs(u) + abs(problem.gap)
    if np.any(room < -ROUNDING_OF_STARTS * size):
        i = int(np.argmin(np.where(size > 0, room / np.where(size > 0, size, 1.0), 0.0)))
        raise InvalidProblem(f"displacement: {problem.contact_name(i)} overlaps by {-room[i]:.6g} at the start")
    for name, value, limit in (("displacement", u, problem.tie_value), ("velocity", v, np.zeros(problem.ties))):
        missed = abs(problem.tie @ value - limit)
        if np.any(missed > ROUNDING_OF_STARTS * (abs(problem.tie) @ abs(value) + abs(limit))):
            raise InvalidProblem(f"{name}: tie {int(np.argmax(missed))} is missed by {np.max(missed):.6g} at the start")


def _mass(entry: SchemeEntry, M: Any, problem: ContactProblem) -> Any:
    """Return the mass for a scheme, removed from the contacts if the scheme requires that."""
    bare = massless(M)
    if not entry.massless_contacts:
        if entry.explicit and np.any(bare):
            raise InvalidProblem(
                f"mass: {entry.name} needs mass at every unknown; {problem.dof_name(int(np.argmax(bare)))} has none"
            )
        return M
    touching = np.zeros(problem.dimension, dtype=bool)
    touching[touched(problem)] = True
    return M if np.all(bare[touching]) else redistributed_mass(M, problem)


def _refuse_ringing(scheme: str, problem: ContactProblem, M: Any, load: Vector, u: Vector) -> None:
    """Raise InvalidProblem if a contact acts on an unknown without mass that is not in equilibrium at the start.

    The scheme's velocities there would oscillate in every step, undamped with theta = 1/2.

    Parameters
    ----------
    scheme, problem : the scheme's name, and the body with its contacts
    M : (n, n) matrix, the mass
    load, u : (n,) load and displacement at the start
    """
    touching = np.zeros(problem.dimension, dtype=bool)
    touching[touched(problem)] = True
    room, K = problem.gap - problem.normal @ u, problem.stiffness_rows
    closed = room <= ROUNDING_OF_STARTS * (abs(problem.normal) @ abs(u) + abs(problem.gap))
    held = abs(problem.normal).T @ closed.astype(float) + abs(problem.tie).T @ np.ones(problem.ties)
    left, size = load - K @ u, problem.stiffness_sizes @ abs(u) + abs(load)
    out = massless(M) & touching & (held == 0) & (abs(left) > ROUNDING_OF_STARTS * size)
    if np.any(out):
        j = int(np.argmax(np.where(out, abs(left), -1.0)))
        raise InvalidProblem(
            f"displacement: {problem.dof_name(j)} has no mass and a contact, and {left[j]:.6g} {problem.units.force}"
            f"{' ' if problem.units.force else ''}are out of balance there at the start, which {scheme!r} does not "
            "bring to rest: start it in balance, or take 'newmark', 'backward-euler' or 'modified-mass'"
        )


def _loads(problem: ContactProblem, load: Callable[[float], ArrayLike] | None) -> Callable[[float], Vector]:
    if load is None:
        return lambda _: problem.load
    if not callable(load):
        raise InvalidProblem(f"load: expected a function of time, got {shown(load)}")

    def at(instant: float) -> Array:
        return read_vector(f"load at time {instant:g}", load(instant), problem.dimension)

    return at


class _MovingOnAllRows(OnAllRows):
    """One instant of a motion, extended to all rows at first access."""

    def extended(self, found: Solution) -> Solution:
        """Return the instant with forces on all rows, with the certificate of its step on the acting rows."""
        if not isinstance(found, Moving):
            return super().extended(found)
        return replace(found, **self.rows.at(found.problem).forces(found))


class _MotionOfAllRows(MotionHistory):
    """A motion that was computed without idle rows."""

    def __init__(self, rows: ActingRows, history: MotionHistory) -> None:
        History.__init__(
            self,
            LazySolutions(_MovingOnAllRows(rows, history, k) for k in range(len(history))),
            history.times.tolist(),
            lambda: events_on_all_rows(rows, history),
            energies=lambda: history.energies,
            notes=lambda: history.notes,
        )
        self.motion = history.motion
        self._rows, self._history = rows, history

    def resume(self, duration: float) -> MotionHistory:
        """Continue this motion, as `MotionHistory.resume`."""
        return self._labelled(_MotionOfAllRows(self._rows, self._history.resume(duration)))

    def __copy__(self) -> MotionHistory:
        return self._labelled(_MotionOfAllRows(self._rows, copy.copy(self._history)))

    def _labelled(self, other: MotionHistory) -> MotionHistory:
        other.time_label = self.time_label
        return other

    def __getstate__(self) -> dict[str, Any]:
        state = History.__getstate__(self)
        del state["motion"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, motion=state["_history"].motion)

    @property
    def problem(self) -> ContactProblem:
        """Return the problem of the moving bodies with all its rows."""
        return self._rows.whole

    @property
    def normal_forces(self) -> Array:
        """Return the normal forces (steps, m) [force], positive in compression."""
        return np.asarray(self._rows.normal(self._history.normal_forces))

    @property
    def friction_forces(self) -> Array | None:
        """Return the friction forces (steps, m, d-1) [force], or None without friction."""
        force = self._history.friction_forces
        return None if force is None else np.asarray(self._rows.friction(force))

    @property
    def tie_forces(self) -> Array:
        """Return the tie forces (steps, k) [force]."""
        return np.asarray(self._rows.tie(self._history.tie_forces))
