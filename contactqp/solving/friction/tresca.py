"""Coulomb friction by Tresca problems: fixed point on the friction bound (Haslinger, Hlavacek and Necas 1996).

With a bound theta in place of mu l_N, friction is convex:

    min 1/2 x'S x - f'x + sum theta_i |T_i x - o_i|   over   N x <= g, A x = b,

which with w_i >= |T_i x - o_i| as more unknowns, theta_i their loads, is a `ContactProblem` for any method: the forces
of the two rows T_i x - w_i <= o_i and -T_i x - w_i <= -o_i add up to theta_i, and their difference is l_T. The next
bound is mu l_N of the answer. One sliding contact contracts by mu/mu_c, mu_c = W_NN/|W_NT|; beyond it the bounds cycle,
which Aitken's relaxation (Irons and Tuck 1969) damps. After every step the linear system of the combination of open,
stick and slip that the answer suggests is solved; if its signs hold, this is the answer to the last digits.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactqp.certificate.certificate import holds
from contactqp.certificate.critical_friction import critical, too_many
from contactqp.errors import BackendFailed, NoEquilibrium, NotConverged
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import condensed_frictional_rows
from contactqp.linalg.dense import RigidMotions
from contactqp.linalg.equilibration import nondimensional
from contactqp.linalg.existence import DrivenMotion, refuse_driven_motion
from contactqp.linalg.friction_states import answer_in
from contactqp.model.arrays import Array, Vector, all_finite, stated_limit, tell, time_is_up
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.names import describe_overload
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer, Candidate
from contactqp.solving.friction.force_system import ForceSystem
from contactqp.solving.friction.local_form import NEARER, RELAXATION, FoundOnBodies, aitken
from contactqp.solving.friction.newton import refined, search
from contactqp.solving.methods import Method, Settings, algorithm_name
from contactqp.solving.methods.method import ACTIVE_SET

# The most steps, enough for contraction factors up to 0.9.
MAX_STEPS = 100
# Bounds below this part of the largest count as zero.
NO_BOUND = 1e-14
# From so many contacts on, Newton's method starts from the answer without friction, for so many combinations.
MANY, NEWTON_STEPS = 100, 20
# Bounds that change by less than this part of the largest have converged; the combination they suggest is then final.
BOUNDS_SETTLED = 1e-13


@dataclass(frozen=True, eq=False)
class _Step:
    """The answer to one Tresca problem, scaled."""

    x: Vector  # (p,)
    normal: Vector  # (m,)
    friction: Vector  # (m,)
    tie: Vector  # (k,)


def tresca_on_bodies(
    problem: ContactProblem, condensation: Condensation, method: Method, settings: Settings, at_once: bool = False
) -> FoundOnBodies:
    """Find Coulomb's answer by steps of a convex method with the friction bounds of the step before.

    `settings.max_iter` counts Tresca problems; `settings.time_limit` is for all of them. The first bound is that of
    `settings.warm_start`, else that of the answer without friction, else, where friction holds the bodies, of the
    answer with all contacts stuck. With `at_once`, and where only one answer exists, the combination that the answer
    without friction suggests is tried before: it needs no Tresca problem. With many contacts, the only answer or not,
    Newton's method starts from there, as a Tresca problem of a thousand contacts takes a hundred of its systems.

    Parameters
    ----------
    problem : ContactProblem
    condensation : the Condensation of the problem
    method : solves the convex problems with given bounds
    settings : tolerance, limits and options
    at_once : whether the combination that the answer without friction suggests is tried first

    Raises
    ------
    NotConverged
        The bounds have not settled, or a bound on the way does not hold the bodies; the history has their changes.
        Where the time is up, `solution` is the answer of the last bound.
    """
    run, name = _Run(problem, condensation, method, settings), algorithm_name("tresca", method.name)
    try:
        return _by_bounds(run, name, MAX_STEPS if settings.max_iter is None else settings.max_iter, at_once)
    except NotConverged as error:
        if time_is_up() and run.last is not None:
            late = f"tresca: stopped at the time limit of {stated_limit(None)} in step {len(error.history) + 1}"
            raise NotConverged(late, error.history, run.plain(run.last)) from error
        raise


def _by_bounds(run: _Run, name: str, limit: int, at_once: bool) -> FoundOnBodies:
    bound, slippery = run.first_bound()
    if at_once and slippery is not None and (found_at_once := run.at_once(slippery, bound)) is not None:
        return replace(found_at_once, name=found_at_once.name or name)
    changes: list[float] = []
    relaxation = RELAXATION[1]
    before: Vector | None = None
    tried: dict[bytes, float] = {}  # combinations, and the change of the bound from which each was last refined
    for step in range(1, limit + 1):
        tell(f"friction bounds, step {step}")
        try:
            found = run.with_bound(bound)
        except NoEquilibrium as error:
            # Its message is dropped, as its unknowns are scaled and not all are displacements.
            raise NotConverged(
                f"tresca: the friction bounds of step {step} do not hold the bodies{run.exceeded(error.proof, bound)}",
                tuple(changes),
            ) from error
        except (NotConverged, BackendFailed) as error:
            raise NotConverged(
                f"tresca: the friction bounds of step {step} lead nowhere: {error}", tuple(changes)
            ) from error
        missing = run.bound_of(found) - bound
        largest = np.max(abs(bound), initial=np.max(abs(missing), initial=0.0))
        change = float(np.max(abs(missing), initial=0.0) / largest) if largest > 0 else 0.0
        status = run.suggested(found, bound)
        if not change >= NEARER * tried.get(status.tobytes(), np.inf):
            tried[status.tobytes()] = change
            answer = run.answer_in(status, found)
            if holds(run.problem, answer):
                return FoundOnBodies(answer, name, tuple(changes))
        changes.append(change)
        if changes[-1] <= BOUNDS_SETTLED:
            raise NotConverged(
                "tresca: the bounds have settled where the signs of friction do not hold", tuple(changes)
            )
        relaxation = aitken(relaxation, before, missing)
        bound, before = np.maximum(bound + relaxation * missing, 0.0), missing
    raise NotConverged(f"tresca: {_pace(changes)}", tuple(changes))


def _pace(changes: list[float]) -> str:
    """Return a text on the rate at which the friction bounds converged in the last steps."""
    if len(changes) < 2 or changes[-2] == 0:
        return "the friction bounds have not settled"
    pace = (changes[-1] / changes[max(-5, -len(changes))]) ** (1 / min(4, len(changes) - 1))
    return f"the friction bounds still change by {changes[-1]:.2g} of their size, {pace:.2g} of the change before"


class _Run:
    """The Tresca problems of one frictional problem, for one method."""

    def __init__(self, problem: ContactProblem, condensation: Condensation, method: Method, settings: Settings) -> None:
        self.problem, self._condensation, self._method = problem, condensation, method
        self._settings = replace(settings, warm_start=None, max_iter=None)
        self._start, self._began = settings.warm_start, time.perf_counter()
        self.last: _Step | None = None  # the last answer, for a call whose time is up
        self._rows = condensed_frictional_rows(problem, condensation)
        load, self._inner = condensation.reduce_load(problem.load)
        size = condensation.reduced_size(problem, self._inner)
        self._load, self._load_size = load * self._rows.scale, size * self._rows.scale
        self._gap, self._origin, self._value = self._rows.lengths(problem)

    def first_bound(self) -> tuple[Vector, _Step | None]:
        """Return the first friction bounds, scaled, and the answer without friction if they are taken from it."""
        rows = self._rows
        if self._start is not None:
            return rows.coefficient * np.maximum(self._start.answer.normal_force * rows.normal_length, 0.0), None
        try:
            found = self._without_friction()
            return self.bound_of(found), found
        except NoEquilibrium:
            pass
        try:
            return self.bound_of(self._stuck()), None
        except NoEquilibrium as error:
            # Names are dropped, as the unknowns are scaled.
            raise NotConverged(
                "tresca: neither without friction nor with all contacts stuck are the bodies held"
            ) from error

    def _without_friction(self) -> _Step:
        """Return the answer without friction, on the condensation where the method accepts one."""
        condensed, rows = self._method.solve_condensed, self._rows
        if condensed is None or self._condensation.rigid.count:
            return self.with_bound(np.zeros(self.problem.contacts))
        found = condensed(self.problem, self._condensation, self._limited()).answer
        normal, tie = found.normal_force * rows.normal_length, found.tie_force * rows.tie_length
        self.last = _Step(found.displacement / rows.scale, normal, np.zeros(len(normal)), tie)
        return self.last

    def bound_of(self, step: _Step) -> Vector:
        """Return the friction bounds mu l_N (m,) of a step, scaled."""
        return np.asarray(self._rows.coefficient * np.maximum(step.normal, 0.0))

    def at_once(self, slippery: _Step, bound: Vector) -> FoundOnBodies | None:
        """Return the answer near that without friction and its name, empty for its combination itself; None without."""
        problem, condensation, status = self.problem, self._condensation, self.suggested(slippery, bound)
        if too_many(problem, condensation) is None:
            if not critical(problem, condensation).unique:  # else any combination that holds is the answer
                return None
            answer = self.answer_in(status, slippery)
            if holds(problem, answer):
                return FoundOnBodies(answer, "")
        if problem.contacts < MANY or self._method.kind != ACTIVE_SET:
            return None
        system = ForceSystem(problem, condensation)
        lengths = system.lengths(problem, condensation.reduce_load(problem.load)[0])
        try:
            found, steps = search(system, lengths, status, max_iter=NEWTON_STEPS)
        except NotConverged:
            return None
        answer = refined(problem, condensation, system, lengths, found)
        return FoundOnBodies(answer, "newton", iterations=steps) if holds(problem, answer) else None

    def with_bound(self, bound: Vector) -> _Step:
        """Return the answer to the Tresca problem of a friction bound (m,)."""
        rows, m, p = self._rows, self.problem.contacts, len(self._rows.S)
        bounded = np.flatnonzero(rows.slides & (bound > NO_BOUND * np.max(bound, initial=0.0)))
        count, T, o = len(bounded), rows.tangent[bounded], self._origin[bounded]
        inner = self.problem._transformed(
            _block_diagonal(rows.S, np.zeros((count, count))),
            np.concatenate([self._load, -bound[bounded]]),
            np.concatenate([self._load_size, bound[bounded]]),
            _bounded_rows(rows.normal, T),
            np.concatenate([self._gap, o, -o]),
            _block_diagonal(rows.tie, np.zeros((0, count))),
            self._value,
            named=False,
        )
        u, force, tie = self._convex_answer(inner, count)
        friction = np.zeros(m)
        friction[bounded] = force[m : m + count] - force[m + count :]
        self.last = _Step(u[:p], force[:m], friction, tie)
        return self.last

    def exceeded(self, proof: Any, bound: Vector) -> str:
        """Return a text on the motion that friction within a bound (m,) does not hold, empty where none is known."""
        if not isinstance(proof, DrivenMotion):
            return ""
        rows, x = self._rows, proof.motion[: len(self._rows.S)]
        pull, friction = float(self._load @ x), float(bound @ abs(rows.tangent @ x))
        z = self._condensation.expand(x * rows.scale, np.zeros_like(self._inner))
        return describe_overload(self.problem, z, pull, friction)

    def _stuck(self) -> _Step:
        """Return the answer in which every contact with friction sticks, closed or not."""
        rows, m = self._rows, self.problem.contacts
        stuck = np.flatnonzero(rows.slides & (rows.coefficient > 0))
        ties, values = np.vstack([rows.tangent[stuck], rows.tie]), np.concatenate([self._origin[stuck], self._value])
        data = (rows.S, self._load, self._load_size, rows.normal, self._gap, ties, values)
        u, force, tie = self._convex_answer(self.problem._transformed(*data, named=False), 0)
        friction = np.zeros(m)
        friction[stuck] = tie[: len(stuck)]
        return _Step(u, force, friction, tie[len(stuck) :])

    def _convex_answer(self, inner: ContactProblem, added: int) -> tuple[Vector, Vector, Vector]:
        """Return displacement, contact and tie forces by the convex method, within the remaining time.

        The last `added` unknowns have no stiffness.
        """
        rigid = RigidMotions(_block_diagonal(self._rows.motions, np.eye(added)), self._condensation.rigid.softest)
        scale = np.ones(inner.dimension)
        condensation = Condensation.of_condensed(inner, rigid, scale)
        inner._computed.condensation, inner._computed.unknown_scale = condensation, scale
        if self._rows.motions.shape[1]:  # else only slip sizes are free, and their loads press them onto their rows
            refuse_driven_motion(inner, condensation.rigid)
        answer = solve_convex(self._method, inner, self._limited()).answer
        return answer.displacement, answer.normal_force, answer.tie_force

    def _limited(self) -> Settings:
        """Return the settings of a convex problem with the remaining time; raise NotConverged if there is none."""
        limit = self._settings.time_limit
        if limit is None:
            return self._settings
        left = limit - (time.perf_counter() - self._began)
        if left <= 0:
            raise NotConverged(f"tresca: stopped at the time limit of {stated_limit(limit)}")
        return replace(self._settings, time_limit=left)

    def suggested(self, step: _Step, bound: Vector) -> Status:
        """Return the states: closed where l_N > gap, sliding where |l_T + s| exceeds the bound, both in
        sqrt(energy).
        """
        rows = self._rows
        trial = step.friction + rows.tangent @ step.x - self._origin
        sliding = np.where(trial > 0, SLIP_ON, SLIP_BACK)
        status = np.where((abs(trial) <= bound) & (rows.coefficient > 0), STICK, sliding)
        closed = step.normal > self._gap - rows.normal @ step.x
        return np.where(closed, status, OPEN).astype(np.int8)

    def answer_in(self, status: Status, step: _Step) -> Answer:
        """Return the answer of a combination, refined from that of a step."""
        return answer_in(self.problem, self._condensation, self._rows, status, self.plain(step))

    def plain(self, step: _Step) -> Answer:
        """Return the answer of a step in the units of the problem, without refinement."""
        rows = self._rows
        u = self._condensation.expand(step.x * rows.scale, self._inner)
        forces = (step.normal / rows.normal_length, (step.friction / rows.tangent_length)[:, None])
        return Answer(u, *forces, step.tie / rows.tie_length)


def _bounded_rows(normal: Array, tangent: Array) -> Array:
    """Return the rows N x, T x - w, -T x - w over x and w, which bound |T x| by w."""
    (m, p), count = normal.shape, len(tangent)
    rows = np.zeros((m + 2 * count, p + count))
    rows[:m, :p], rows[m : m + count, :p], rows[m + count :, :p] = normal, tangent, -tangent
    rows[m : m + count, p:] = rows[m + count :, p:] = -np.eye(count)
    return rows


def solve_convex(method: Method, problem: ContactProblem, settings: Settings) -> Candidate:
    """Solve one convex problem of a fixed point, made nondimensional if the method needs it.

    Raises NotConverged: the answer has numbers that are not finite.
    """
    if method.scale:
        twin, scaling = nondimensional(problem)
        candidate = scaling.unscale(method.solve(twin, settings))
    else:
        candidate = method.solve(problem, settings)
    if not all_finite(candidate.answer):
        raise NotConverged(f"{method.name}: {candidate.status or 'its answer is not finite'}")
    return candidate


def _block_diagonal(one: Array, other: Array) -> Array:
    whole = np.zeros((len(one) + len(other), one.shape[1] + other.shape[1]))
    whole[: len(one), : one.shape[1]], whole[len(one) :, one.shape[1] :] = one, other
    return whole
