"""Form the local problem of a contact problem, with the compliance of the bodies between the contacts, and solve it.

On the retained unknowns, scaled (`rows`), with H = [-N; T]' contact by contact and w = (g, -o), ties taken care of by
x = x0 + B y, A x0 = b, A B = 0, and rigid motions Z of what the ties leave,

    u = H'x + w = W r + q + V a,    W = H'B S_B^+ B'H,    V = H'B Z,    V'r + Z'B'(f - S x0) = 0,

where r_N = l_N, r_T = -l_T, and a are coordinates of the rigid motions (`ContactOperator`). Contacts that cannot slide
have no tangential row, and their friction, which is arbitrary within its bound, is zero. The combination of states that
an algorithm finds is refined on the problem itself.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.certificate.certificate import holds
from contactqp.errors import NotConverged
from contactqp.linalg.condensation import Condensation
from contactqp.linalg.delassus import FrictionalRows, compliance_of, condensed_frictional_rows
from contactqp.linalg.dense import BALANCED
from contactqp.linalg.existence import driven_motion, refuse_conflict
from contactqp.linalg.factorization import right_singular
from contactqp.linalg.floating import UNRESISTED
from contactqp.linalg.friction_states import answer_in
from contactqp.linalg.iteration import grid_operations
from contactqp.linalg.measures import lengths
from contactqp.model.arrays import Array, Vector, all_finite, refuse_late, stated_limit, time_is_up
from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, Status
from contactqp.model.local_problem import LocalProblem
from contactqp.model.names import describe_overload
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Answer
from contactqp.solving.friction.algorithms import ALGORITHMS, ATTEMPTS, LONG_ATTEMPTS, run_algorithm, run_any
from contactqp.solving.friction.conic import balancing_forces, refuse_unbalanced_in_space
from contactqp.solving.friction.enumeration import MOST_CONTACTS
from contactqp.solving.friction.local_form import NEARER, Deadline, Iterate, LocalForm
from contactqp.solving.methods import Method, Settings

# Ties with unit rows conflict if the residual exceeds this part of their values.
CONFLICT = 1e-9
# Rows with fewer entries than this part of all are multiplied as sparse ones.
FEW_FELT = 0.1


class ContactOperator:
    """The operators W and V of a problem's contacts, and the map from contact forces to displacements.

    Attributes
    ----------
    H : (d m, p) array, rows of approach, reversed, and of slip, contact by contact
    basis, motions : (p, y), (y, z) arrays, B and Z, orthonormal; B is a sparse identity where nothing is tied, and
        motions that no row resists are left out of Z
    spread : (y, p) array, B'
    compliance : (y, y) array, C
    delassus, rigid : (d m, d m), (d m, z) arrays, W and V
    """

    def __init__(self, condensation: Condensation, rows: FrictionalRows) -> None:
        m, d = len(rows.normal), rows.width + 1
        tangent = rows.tangent.reshape(m, rows.width, -1)
        self.H = np.concatenate([-rows.normal[:, None, :], tangent], axis=1).reshape(m * d, -1)
        self._rows, self._tied = rows, np.zeros((0, 0))
        self.basis: Any = sp.identity(len(rows.S), format="csr")
        S, HB = rows.S, self.H
        if len(rows.tie):
            left, size, right = np.linalg.svd(rows.tie)
            rank = int(np.sum(size > UNRESISTED * size[0]))
            self._tied, self.basis = right[:rank].T @ (left[:, :rank] / size[:rank]).T, right[rank:].T
            S, HB = self.basis.T @ rows.S @ self.basis, self.H @ self.basis
        self.spread: Any = self.basis.T
        motions = _null_motions(rows, self.basis)
        self.compliance = compliance_of(S, motions)
        self.motions = _motions_of_rows(HB, motions)
        resisted = _resisted(HB, motions)
        # With few ties and rigid motions the rows are sparse.
        few = sp.csr_matrix(resisted) if np.count_nonzero(resisted) < FEW_FELT * resisted.size else resisted
        W = np.asarray(few @ (few @ self.compliance).T)
        self.delassus, self.rigid, self._HB = (W + W.T) / 2, HB @ self.motions, HB
        self._whole, self._uncertain = _whole_motions(condensation, rows, self.basis @ self.motions)
        self._local: LocalProblem | None = None

    def local(self, problem: ContactProblem, coefficient: Vector, offset: Vector) -> LocalProblem:
        """Return the local problem of friction coefficients (m,) and an offset (d m,); W is checked once."""
        joints, known = self.motions.shape[1] > 0, self._local
        drive = self.drive(problem) if joints else np.zeros(0)
        if known is None or known.contact_names != problem.contact_names or np.any(known.friction != coefficient):
            self._local = known = LocalProblem(
                delassus=self.delassus,
                offset=offset,
                friction=coefficient,
                dimension=self._rows.width + 1,
                bilateral=self.rigid if joints else None,
                bilateral_offset=drive if joints else None,
                contact_names=problem.contact_names,
            )
        return known.with_offsets(offset, drive)

    def start(self, value: Vector) -> Vector:
        """Return x0 (p,) of least norm.

        Raises
        ------
        NotConverged
            No displacement was found that gives the ties their values: whether they conflict is proven elsewhere.
        """
        if not self._tied.size:
            return np.zeros(self.basis.shape[0])
        start = np.asarray(self._tied @ value)
        if np.max(abs(self._rows.tie @ start - value), initial=0.0) > CONFLICT * np.max(abs(value), initial=0.0):
            raise NotConverged("friction: the ties contradict each other, as far as floats can tell")
        return start

    def free(self, load: Vector, start: Vector) -> Vector:
        """Return H'x (d m,) under a load (y,) on the bodies without contacts, their rigid motions at rest."""
        return np.asarray(self._HB @ (self.compliance @ load) + self.H @ start)

    def drive(self, problem: ContactProblem) -> Vector:
        """Return z'f of every rigid motion, exactly zero where it is rounding."""
        work, size = self._whole.T @ problem.load, abs(self._whole).T @ abs(problem.load)
        return np.asarray(np.where(abs(work) <= max(BALANCED, self._uncertain) * size, 0.0, work))


def contact_operator(problem: ContactProblem, condensation: Condensation, rows: FrictionalRows) -> ContactOperator:
    """Return the contact operator of a problem's stiffness and rows, made once for all loads."""
    if problem._computed.contact_operator is None:
        refuse_late("the contacts' own stiffness was found")
        problem._computed.contact_operator = ContactOperator(condensation, rows)
    operator: ContactOperator = problem._computed.contact_operator
    return operator


def _resisted(rows: Array, motions: Array) -> Array:
    """Return rows without their rigid part, exactly zero (without compliance) where only rounding remains."""
    left = rows - (rows @ motions) @ motions.T
    size = np.linalg.norm(rows, axis=1)
    return np.where((np.linalg.norm(left, axis=1) > UNRESISTED * size)[:, None], left, 0.0)


def _motions_of_rows(rows: Array, motions: Array) -> Array:
    """Return an orthonormal basis (y, z) of the motions that rows resist.

    The others are excluded, since their rounding errors, scaled to one, would be taken for joints.
    """
    if not motions.shape[1]:
        return motions
    size = np.linalg.norm(rows, axis=1)
    values, rotation = right_singular((rows / np.where(size > 0, size, 1.0)[:, None]) @ motions)
    return np.asarray(motions @ rotation[: int(np.sum(values > UNRESISTED))].T)


def _whole_motions(condensation: Condensation, rows: FrictionalRows, motions: Array) -> tuple[Array, float]:
    """Return the rigid motions (n, z) that have these values at retained unknowns, and how uncertain they are."""
    rigid = condensation.rigid
    if not motions.shape[1]:
        return np.zeros((len(rigid.motions), 0)), 0.0
    retained = rigid.motions[condensation.retained] / rows.scale[:, None]
    return rigid.motions @ np.linalg.lstsq(retained, motions, rcond=None)[0], rigid.uncertainty


def _null_motions(rows: FrictionalRows, basis: Any) -> Array:
    """Return an orthonormal basis of the rigid motions that the ties leave, in the coordinates of `basis`."""
    motions = rows.motions
    if not motions.shape[1]:
        return np.zeros((basis.shape[1], 0))
    if len(rows.tie):
        size, right = right_singular(rows.tie @ motions)
        motions = motions @ right[int(np.sum(size > UNRESISTED)) :].T
    return np.asarray(basis.T @ motions)


class ContactForm:
    """The local form of one contact problem, and the map from its forces back to the bodies.

    Attributes
    ----------
    local : LocalProblem, in scaled forces and lengths
    """

    def __init__(self, problem: ContactProblem, condensation: Condensation, rows: FrictionalRows) -> None:
        self._problem, self._condensation, self._rows = problem, condensation, rows
        self._operator = operator = contact_operator(problem, condensation, rows)
        load, self._inner = condensation.reduce_load(problem.load)
        self._scaled_load = load * rows.scale
        self._cost_of_correction = OVERHEAD + float(len(rows.S) + len(rows.all_rows)) ** 3
        entries = float(problem.stiffness_rows.nnz)
        self._cost_of_correction += PER_ENTRY * entries
        # The remaining budget of operations for combinations near an iterate, at least that of factorising the
        # stiffness.
        self.left = max(NEARBY_OPERATIONS, grid_operations(problem.dimension, entries / problem.dimension))
        gap, origin, value = rows.lengths(problem)
        self._start = operator.start(value)
        self._load = operator.spread @ (self._scaled_load - rows.S @ self._start)
        w = np.column_stack([gap, -origin.reshape(-1, rows.width)]).ravel()
        self.local = operator.local(problem, rows.coefficient, operator.free(self._load, self._start) + w)

    def answer_nearby(self, status: Status, start: Answer) -> Answer:
        """Return `answer_in`, and subtract its cost from the remaining budget."""
        before = self._rows.corrections
        answer = self.answer_in(status, start)
        self.left -= self._cost_of_correction * (self._rows.corrections - before)
        return answer

    def answer_in(self, status: Status, start: Answer) -> Answer:
        """Return the answer of a combination (m,), refined on the problem from `start`; its signs may fail."""
        return answer_in(self._problem, self._condensation, self._rows, status, start)

    def status(self, form: LocalForm, iterate: Iterate) -> Status:
        """Return the states (m,): closed where r_N > u_N, sliding where |r_T - u_T| exceeds the friction bound."""
        r, u = iterate.force, form.velocity(iterate.force, iterate.joint_force)
        pushed, trial = r[:, 0] - u[:, 0], r[:, 1:] - u[:, 1:]
        slides = lengths(trial) > form.mu * np.maximum(pushed, 0.0)
        # The force on the body opposes the slip.
        direction = np.where(trial[:, 0] < 0, SLIP_ON, SLIP_BACK) if form.d == 2 else np.full(form.m, SLIP_ON)
        closed = np.where(slides | (form.mu == 0), direction, STICK)
        return np.where(pushed > 0, closed, OPEN).astype(np.int8)

    def scaled_force(self, normal_force: Vector, friction_force: Array | None) -> Array:
        """Return the forces (m, d) of the local form from normal forces (m,) and friction (m, d-1) of the problem."""
        force = np.zeros((len(normal_force), self.local.dimension))
        force[:, 0] = np.maximum(normal_force, 0.0) * self._rows.normal_length
        if friction_force is not None:
            force[:, 1:] = -friction_force * self._rows.tangent_length[:, None]
        return force

    def plain(self, form: LocalForm, iterate: Iterate) -> Answer:
        """Return the answer of the iterate without refinement."""
        rows, operator = self._rows, self._operator
        force, joint = form.unscaled(iterate.force, iterate.joint_force)
        pushed = operator.H.T @ force.ravel()
        y = operator.compliance @ (self._load + operator.spread @ pushed) + operator.motions @ joint
        x = self._start + operator.basis @ y
        tie: Vector = np.zeros(0)
        if len(rows.tie):
            left = self._scaled_load - rows.S @ x + pushed
            tie = np.asarray(np.linalg.lstsq(rows.tie.T, left, rcond=None)[0], dtype=float)
        return Answer(
            self._condensation.expand(x * rows.scale, self._inner),
            force[:, 0] / rows.normal_length,
            -force[:, 1:] / rows.tangent_length[:, None],
            tie / rows.tie_length,
        )


# Iterates with a natural map below this part of the forces may have the right combination.
WORTH_REFINING = 1e-5
# If forces that balance the load are below this part of those that deform the bodies by the typical gap, the bodies
# move as if rigid.
SMALL_FORCES = 0.1
# The number of contacts in space up to which trying all 3^m combinations is cheaper than long attempts of algorithms;
# in the plane it is that of the enumeration.
MOST_TRIED = 5
# The budget of operations for combinations near the best iterate, about a second. Operations are counted, so that the
# verdict does not depend on the machine. A correction costs OVERHEAD, the number of equations cubed, and PER_ENTRY for
# entries of K.
NEARBY_OPERATIONS, OVERHEAD, PER_ENTRY = 1e9, 7e5, 60.0


@dataclass(frozen=True, eq=False)
class LocalAnswer:
    """Coulomb's answer, and which algorithm of the local form found it."""

    answer: Answer
    name: str
    iterations: int
    history: tuple[float, ...]


def solve_on_contacts(
    problem: ContactProblem, condensation: Condensation, method: Method, settings: Settings, algorithm: str | None
) -> LocalAnswer:
    """Find Coulomb's answer by `algorithm`, a name of `algorithms.ALGORITHMS`; None tries one after another.

    Parameters
    ----------
    problem : ContactProblem
    condensation : the Condensation of the problem
    method : takes the convex steps, where the algorithm has such
    settings : tolerance, limits and options
    algorithm : str or None

    Raises
    ------
    NoEquilibrium
        The constraints conflict, or no friction holds the load, which is examined if no answer is found at first.
    NotConverged
        No iterate's combination of open, stick and slip is an equilibrium; where the time is up, `solution` is the
        answer of the last one.
    BackendFailed, BackendMissing, Unsupported, InvalidProblem
        Of the convex method.
    """
    contacts = ContactForm(problem, condensation, condensed_frictional_rows(problem, condensation))
    plain = LocalForm(contacts.local)
    balanced = balancing_forces(plain)
    deadline = Deadline(settings.time_limit)
    failed: NotConverged | None = None
    for size in _force_sizes(balanced):
        form = plain if size == 1.0 else LocalForm(contacts.local, size)
        start = None if balanced is None else balanced / size
        left = replace(settings, time_limit=deadline.remaining)
        try:
            return _on_form(problem, condensation, contacts, form, start, method, left, algorithm)
        except NotConverged as error:
            failed = failed or error
            if time_is_up():
                break
    assert failed is not None
    raise failed


def _force_sizes(balanced: Array | None) -> tuple[float, ...]:
    """Return the scales of forces to try, with the separate scale of forces first if the bodies move as if rigid."""
    size = 0.0 if balanced is None else float(np.max(abs(balanced), initial=0.0))
    return (size, 1.0) if 0 < size < SMALL_FORCES else (1.0,)


def _on_form(
    problem: ContactProblem,
    condensation: Condensation,
    contacts: ContactForm,
    form: LocalForm,
    balanced: Array | None,
    method: Method,
    settings: Settings,
    algorithm: str | None,
) -> LocalAnswer:
    found: list[Answer] = []
    tried: dict[bytes, float] = {}  # combinations, with the error of the iterate from which each was last refined

    def accepted(iterate: Iterate) -> bool:
        if not iterate.error <= WORTH_REFINING * max(1.0, float(np.max(abs(iterate.force), initial=0.0))):
            return False
        status = contacts.status(form, iterate)
        if iterate.error >= NEARER * tried.get(status.tobytes(), np.inf):
            return False
        tried[status.tobytes()] = iterate.error
        answer = contacts.answer_in(status, contacts.plain(form, iterate))
        if holds(problem, answer):
            found.append(answer)
        return bool(found)

    start, deadline = _start(form, contacts, settings, balanced), Deadline(settings.time_limit)
    if algorithm is None:
        few = MOST_CONTACTS if form.d == 2 else MOST_TRIED
        attempts = len(ATTEMPTS) - (LONG_ATTEMPTS if form.m <= few else 0)

        def refuse_none() -> None:
            refuse_conflict(problem, condensation)
            refuse_unbalanced_in_space(problem, contacts.plain(form, start))

        outcome = run_any(form, settings, start, accepted, refuse_none, attempts, MOST_TRIED)
    else:
        outcome = run_algorithm(form, ALGORITHMS[algorithm], method, settings, start, accepted)
    iterate, name, nearby = outcome.iterate, outcome.name, ""
    if not found and algorithm is None and form.m <= MOST_CONTACTS:
        found, nearby = _near(problem, contacts, form, iterate, settings.max_iter, deadline)
        name = f"combinations near {name}"
    if not found and holds(problem, plain := contacts.plain(form, iterate), settings.tolerance):
        found, name = [plain], outcome.name  # with redundant contacts the refinement may fail
    if not found:
        violated = (
            f"the law is still violated by {iterate.error:.2g} of the typical gap or slip after "
            f"{iterate.iterations} iterations{nearby}"
        )
        if time_is_up():
            late = f"{outcome.name}: stopped at the time limit of {stated_limit(None)}; {violated}"
            raise NotConverged(late, iterate.history, plain)
        refuse_unbalanced_in_space(problem, contacts.plain(form, start))
        overload = _overload(problem, condensation, plain.normal_force)
        raise NotConverged(f"{outcome.name}: {violated}{overload}", iterate.history)
    return LocalAnswer(found[-1], name, iterate.iterations, iterate.history)


def _overload(problem: ContactProblem, condensation: Condensation, push: Vector) -> str:
    """Return a text on a motion on which the load does more work than friction with these normal forces (m,)."""
    slippery = problem.replace(tangent=None, friction=None, slip_origin=None)
    found = driven_motion(slippery, condensation.rigid)
    if found is None or problem.tangent is None or problem.friction is None:
        return ""
    slip = np.linalg.norm((problem.tangent @ found.motion).reshape(problem.contacts, -1), axis=1)
    return describe_overload(
        problem, found.motion, found.work, float((problem.friction * np.maximum(push, 0.0)) @ slip)
    )


def _near(
    problem: ContactProblem,
    contacts: ContactForm,
    form: LocalForm,
    iterate: Iterate,
    most: int | None,
    deadline: Deadline,
) -> tuple[list[Answer], str]:
    """Return the answer of a combination that differs from the iterate's in the fewest contacts, and the number tried.

    At most `most` combinations are tried, within the time limit and the budget of operations. Each is refined from the
    iterate, whose displacement gives the first slip directions, then from zero, which in space may lead to another
    answer. This is needed for bodies that move as if rigid, where the forces of an iterate do not tell which contacts
    stick.
    """
    plain, status = contacts.plain(form, iterate), contacts.status(form, iterate)
    sliding = (SLIP_ON,) if form.d == 3 else (SLIP_ON, SLIP_BACK)
    every = np.array(list(itertools.product((OPEN, STICK, *sliding), repeat=form.m)), dtype=np.int8)
    nearest = np.argsort(np.count_nonzero(every != status, axis=1), kind="stable")
    along = np.zeros((form.m, form.d - 1))
    nothing = Answer(np.zeros(problem.dimension), np.zeros(form.m), along, np.zeros(problem.ties))
    starts = (plain, nothing) if form.d == 3 else (plain,)
    for tried, (start, combination) in enumerate(itertools.product(starts, every[nearest])):
        spent = contacts.left <= 0 if most is None else tried == most
        if deadline.passed or (deadline.remaining is None and spent):
            if tried >= len(every):
                break
            some = f"the {tried} nearest of {len(every)} combinations"
            more = "a longer time_limit tries more" if deadline.passed else "a larger max_iter tries more"
            if most is None and not deadline.passed:
                more = "their budget of operations is spent, and a time_limit [s] takes its place and tries more"
            return [], f"; {some} fail as well; {more}"
        answer = contacts.answer_nearby(combination, start)
        if holds(problem, answer):
            return [answer], ""
    return [], f"; all {len(every)} combinations, refined from there, fail as well"


def _start(form: LocalForm, contacts: ContactForm, settings: Settings, balanced: Array | None) -> Iterate:
    """Return the start of the iteration: the forces of a warm start, else those that balance the bodies, else zero."""
    warm = settings.warm_start
    if warm is not None and all_finite(warm.answer):
        balanced = form.scaled(contacts.scaled_force(warm.answer.normal_force, warm.answer.friction_force))
    if balanced is None:
        return Iterate.nothing(form)
    return Iterate.at(form, balanced, form.joint_force(balanced))
