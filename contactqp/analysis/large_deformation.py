"""Compute large deformations of bodies in contact by Newton's method with a contact problem in every step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.analysis.large.deformation import LargeHistory, LargeSolution, LoadedBody
from contactqp.analysis.large.load_control import LoadControl, Program
from contactqp.analysis.large.newton_step import NewtonSettings
from contactqp.analysis.large.path_following import PathControl
from contactqp.elements.deformable import ContactGeometry, Deformable
from contactqp.elements.scalars import positive_number, real_number
from contactqp.errors import InvalidProblem, Unsupported, shown
from contactqp.model.arguments import checked
from contactqp.model.arrays import Vector, own_floating_point
from contactqp.model.problem_data import is_number, is_whole, read_coefficient, read_rows, read_vector
from contactqp.solving.methods import find, registered_name, within_time_of

# The path controls, and their specific arguments.
CONTROLS: dict[str, tuple[str, ...]] = {
    "load": (),
    "displacement": ("controlled", "target"),
    "arc-length": ("arc_length",),
}


@checked
@own_floating_point
def large_deformation(
    body: Deformable,
    loads: Sequence[ArrayLike],
    contact: ContactGeometry | None = None,
    *,
    steps: int = 10,
    control: str = "load",
    method: str = "active-set",
    tie: Any = None,
    tie_values: Sequence[ArrayLike] | None = None,
    friction: ArrayLike | None = None,
    start: ArrayLike | LargeSolution | None = None,
    controlled: int | None = None,
    target: float | None = None,
    arc_length: float | None = None,
    tolerance: float = 1e-12,
    max_iter: int = 50,
    **options: Any,
) -> LargeHistory:
    """Compute the equilibria of a body at large displacements along a load path.

        min  W(u) - f'u   subject to   gap(u) >= 0,  A u = b,

    by Newton's method: every step is the ContactProblem in the increment du with the tangent d2W/du2 + the curvature of
    the closed contacts under their forces, the load f - dW/du, and the current gaps and rows.

    Parameters
    ----------
    body : Deformable
        NonlinearTruss, UpdatedTruss, Supported, or anything with `dimension`, `energy`, `internal_force`, `tangent`.
    loads : sequence of (n,) arrays [force]
        The corners of the load path: from no load to `loads[0]` while the load factor goes from 0 to 1, on to
        `loads[1]` until 2, and so on.
    contact : ContactGeometry, optional
        ObstacleContact, ContactGroup, or anything that gives gaps and rows at u.
    steps : int
        The number of equal steps in a leg. With control="load" a step that does not converge is halved, and so are its
        halves, four times at most; all of them stand in the history.
    control : "load", "displacement" or "arc-length"
        With the other two the load factor is an unknown: the load is that factor times `loads[0]`, the only corner, and
        the path is followed through limit points, unstable equilibria included. Points at which contacts close and open
        are added to the path. "displacement" moves the unknown `controlled` to `target` in equal steps; "arc-length"
        takes `steps` steps of `arc_length`.
    method : str
        The method of `solve` for the steps. Where a tangent is indefinite only "active-set" goes on: the others are
        convex and raise Unsupported.
    tie : (k, n) array or sparse matrix, optional
        A, rows of constraints A u = b.
    tie_values : sequence of (k,) arrays, optional
        b at the corners, one for each of `loads`, from A u of the start; without them A u stays what it is.
    friction : float or (m,) array, optional
        Coulomb's coefficient. The slip of a step is measured from where the contact was at the end of the previous
        step, or from where it lands within the step, along the current tangents. This is exact on planes; on curved
        obstacles it is the slip along the chord, and convergence is linear. If several contacts land within one step,
        each is treated as if the others did not land; steps should be so short that they land one at a time.
    start : (n,) array or LargeSolution, optional
        A displacement to start from, at no load, or an equilibrium of an earlier history with this program; the
        remaining steps then start at its load factor.
    controlled, target : int and float, optional
        The place of an unknown in u, and where it ends [length].
    arc_length : float, optional
        The length of a step [length]: its square is |u - u_0|^2 + s^2 (t - t_0)^2, where s is the length of the
        displacement that a unit of load makes at the start. The default is sqrt(2) s / steps, so that `steps` of them
        reach t = 1 if the stiffness does not change.
    tolerance : float
        The largest admissible ratio of the forces out of balance to the largest force, and of gaps to the largest
        displacement.
    max_iter : int
        The most iterations of Newton's method in a step.
    **options
        Further options of `solve`: `penalty`, `algorithm`, ...; `time_limit` [s] is that of the whole path.

    Returns
    -------
    LargeHistory
        The start and every step; with arc length and displacement control every contact event too, and `limit_points`,
        where the load is greatest or least, to rounding. `times` are load factors, and `iterations` has the residual of
        each iteration. `notes` say where the path snaps through (the displacement jumps: to the next equilibrium down
        the energy; with friction between two steps, whose number then decides where contacts land and slip), where
        several contacts with friction land within one step, where equilibria are unstable, and where others branch off.

    Raises
    ------
    NotConverged
        Newton's method does not converge, a body is turned inside out, or a pair of contact surfaces is lost. `history`
        holds the equilibria so far, and `start=error.history[-1]` resumes from there.
    NotCertified
        The certificate refuses the last step of an equilibrium.
    Unsupported
        Arc length or displacement control is combined with friction or with another method than "active-set"; the
        tangent is indefinite and the method is convex, or there is friction in space; or the method is approximate and
        there is friction.
    InvalidProblem
        Inconsistent arguments.

    Notes
    -----
    These are (2.94)-(2.104) of the course chapter, with the signs of both contact terms in (2.98) reversed. Steps are
    halved until the merit W - f'u + w (overlaps + |A u - b|) falls, w above the largest force. If a motion with closed
    contacts has negative energy, the step uses tangent + shift 1 (`NewtonIteration.shift`), which gives a descent
    direction and changes no equilibrium. If the tangent is indefinite but those motions have positive energy, the step
    is solved on its closed set. With an approximate method (penalty) the equilibria are those of its contact springs,
    whose stored energy is not included in the energies.

    Examples
    --------
    A shallow arch of two bars, pressed down by 1 onto a floor 0.3 below its node:

    >>> import contactqp as cq
    >>> arch = cq.NonlinearTruss([[-1, 0], [0, 0.2], [1, 0]], [[0, 1], [1, 2]], modulus=100.0, area=1.0)
    >>> free = cq.Supported(arch, held=[0, 1, 4, 5])
    >>> floor = cq.ObstacleContact([[0, 0.2]], cq.Plane([0, -0.1], [0, 1]))
    >>> history = cq.large_deformation(free, [[0.0, -1.0]], floor, steps=4)
    >>> history[-1].displacement.round(12).tolist(), [event.kind for event in history.events]
    ([0.0, -0.3], ['closed'])
    >>> history.notes[0][:28]
    'snap-through at load factor '

    The same arch along its path, over the limit load and through the flat state:

    >>> path = cq.large_deformation(free, [[0.0, -1.0]], floor, control="displacement", controlled=1, target=-0.3)
    >>> [(limit.kind, round(limit.load_factor, 6)) for limit in path.limit_points]
    [('maximum', 0.290327)]
    """
    loaded = _loaded(body, contact, tie, friction)
    begin = _start(start, loaded)
    program = _program(loaded, loads, tie_values, begin)
    if control not in CONTROLS:
        raise InvalidProblem(f"control: expected one of {', '.join(CONTROLS)}, got {shown(control)}")
    for called, count in (("steps", steps), ("max_iter", max_iter)):
        if not is_whole(count) or count < 1:
            raise InvalidProblem(f"{called}: expected a positive integer, got {shown(count)}")
    if not is_number(tolerance) or not 0 < tolerance < 1:
        raise InvalidProblem(f"tolerance: expected a number between 0 and 1, got {shown(tolerance)}")
    method = registered_name(method)
    exact = find(method).exact
    if loaded.frictional and not exact:
        raise Unsupported(
            f"large_deformation: friction with {method!r}, which is approximate: expected an exact method"
        )
    settings = NewtonSettings(method, exact, options, tolerance, max_iter)
    given = {"controlled": controlled, "target": target, "arc_length": arc_length}
    for name in (name for name, value in given.items() if value is not None and name not in CONTROLS[control]):
        raise InvalidProblem(f"{name}: {control!r} control has none, got {given[name]!r}")
    if control == "load":
        with within_time_of(options):
            return LoadControl(loaded, program, settings).follow(begin, _times(begin, program.end, int(steps)))
    if method != "active-set" or loaded.frictional:
        what = "with friction" if loaded.frictional else f"with {method!r}"
        raise Unsupported(f"large_deformation: control={control!r} {what}: it goes through unstable equilibria")
    if program.end != 1:
        raise InvalidProblem(f"loads: control={control!r} takes one load, got {program.end}")
    if control == "displacement":
        n = loaded.dimension
        if not is_whole(controlled) or not 0 <= controlled < n:
            raise InvalidProblem(f"controlled: expected a place from 0 to {n - 1}, got {shown(controlled)}")
        end = real_number("target", target)
        with within_time_of(options):
            return PathControl(loaded, program, settings).follow_unknown(begin, int(steps), int(controlled), end)
    radius = None if arc_length is None else positive_number("arc_length", arc_length, "length")
    with within_time_of(options):
        return PathControl(loaded, program, settings).follow_arc(begin, int(steps), radius)


def _loaded(body: Deformable, contact: ContactGeometry | None, tie: Any, friction: ArrayLike | None) -> LoadedBody:
    if not isinstance(body, Deformable):
        raise InvalidProblem(
            f"body: expected `dimension`, `energy`, `internal_force` and `tangent`, got {type(body).__name__}"
        )
    n = body.dimension
    width = getattr(contact, "dimension", n)
    if width != n:
        raise InvalidProblem(f"contact: expected rows over the {n} unknowns of the body, got {width}")
    coefficient = None
    if friction is not None and contact is not None:
        coefficient = read_coefficient(friction, contact.contacts)
    elif friction is not None:
        raise InvalidProblem("friction: expected contacts that it acts at, got none")
    return LoadedBody(body, contact, read_rows("tie", sp.csr_array((0, n)) if tie is None else tie, n), coefficient)


def _start(start: ArrayLike | LargeSolution | None, loaded: LoadedBody) -> Vector | LargeSolution:
    if isinstance(start, LargeSolution):
        if start.displacement.shape != (loaded.dimension,):
            raise InvalidProblem(
                f"start: expected {loaded.dimension} unknowns, got a solution of {len(start.displacement)}"
            )
        return start
    return read_vector("start", np.zeros(loaded.dimension) if start is None else start, loaded.dimension)


def _program(loaded: LoadedBody, loads: Sequence[ArrayLike], tie_values: Any, start: Vector | LargeSolution) -> Program:
    if len(loads) == 0:
        raise InvalidProblem("loads: expected at least one load vector, got none")
    n, k = loaded.dimension, loaded.tie.shape[0]
    corners = [np.zeros(n), *(read_vector(f"loads[{i}]", load, n) for i, load in enumerate(loads))]
    first = loaded.tie @ start if not isinstance(start, LargeSolution) else np.zeros(k)
    if tie_values is None:
        values = [start.tie_value if isinstance(start, LargeSolution) else first] * len(corners)
    elif not isinstance(tie_values, Sequence | np.ndarray):
        raise InvalidProblem(f"tie_values: expected one for each load, got {type(tie_values).__name__}")
    elif len(tie_values) != len(loads):
        raise InvalidProblem(f"tie_values: expected one for each of {len(loads)} loads, got {len(tie_values)}")
    else:
        values = [first, *(read_vector(f"tie_values[{i}]", value, k) for i, value in enumerate(tie_values))]
    return Program(corners, values)


def _times(start: Vector | LargeSolution, end: int, steps: int) -> list[float]:
    """Return the load factors of the start and of the remaining steps."""
    first = start.load_factor if isinstance(start, LargeSolution) else 0.0
    grid = [leg + (i + 1) / steps for leg in range(end) for i in range(steps)]
    remaining = [t for t in grid if t > first * (1 + 1e-12)]
    if not remaining:
        raise InvalidProblem(f"start: expected a load factor below {end}, got {first:.6g}")
    return [first, *remaining]
