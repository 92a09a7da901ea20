"""Compute critical coefficients of friction, above which Coulomb's law may have several answers.

Two answers to one load differ by contact forces d, and their slips by e = (W d)_T. Signorini's and Coulomb's laws
give d'W d <= sum mu_i |d_N,i| |e_i|, and d'W d = d_N'S d_N + e'W_TT^-1 e with S^-1 = (W^-1)_NN, so that there is one
answer to every load where, for any positive weights c,

    kappa = 1/2 |diag(c sqrt(mu)) S^-1 diag(sqrt(mu) c)|^(1/2) |diag(sqrt(mu)/c) W_TT diag(sqrt(mu)/c)|^(1/2) < 1

(spectral norms; after Necas, Jarusek and Haslinger 1980). In the plane, with few contacts, there is a sharp criterion:
the law is piecewise linear with four pieces per contact, and there is one answer to every load if and only if the
determinants of all combinations of open, stick and slip have one sign. For one contact that is mu < mu_c = W_NN /
|W_NT|.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from contactqp.certificate.number_range import near_one
from contactqp.errors import InvalidProblem, Unsupported, counted
from contactqp.linalg.condensation import Condensation, condense, touched_unknowns
from contactqp.linalg.delassus import ContactOperators, contact_compliance
from contactqp.linalg.iteration import factorised, iterated, may_be_factorised
from contactqp.linalg.measures import ratio
from contactqp.model.arguments import checked
from contactqp.model.arrays import EPS, TINY, Array, Indices, Mask, Vector, computes, own_floating_point
from contactqp.model.coulomb import OPEN, STICK, Status, all_combinations
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import ReadOnly, read_only
from contactqp.model.summary import folded, number

# The most contacts and unknowns for dense operators of all contacts, which are fewer for statements on equilibria
# nearby.
MOST_CONTACTS, MOST_NEARBY = 300, 600
MOST_UNKNOWNS = 2000
# 4^6 determinants take a tenth of a second, once for a stiffness.
MOST_COMBINED = 6
# A determinant below this part of the product of its rows' lengths may be zero.
ZERO_DETERMINANT = 1e-12
# The relative compliance of a slip that supports prevent.
UNFELT = 1e-9
# The number of halvings of a radius that are tried.
HALVINGS = 50
# A map with a larger amplification of residuals is nearly singular.
MOST_GROWTH = 8.0
# Singular values of this part of the largest are zero.
SINGULAR_SYSTEM = 1e-11
WITHOUT_STIFFNESS = "some unknowns have no stiffness"

# The name in `CriticalFriction.examined` of the bound for any number of contacts.
KAPPA = "kappa"
# The name of `CriticalFriction.contraction` in messages.
LARGEST_RATIO = "largest ratio of a contact's friction coefficient to its critical value"


@computes
@dataclass(frozen=True, eq=False)
class CriticalFriction(ReadOnly):
    """Critical coefficients of friction and uniqueness by the bodies' compliance, for any load."""

    single: Vector  # (m,) mu_c = W_NN / |W_NT|, each contact alone; infinite where normal and tangent are uncoupled
    contraction: float  # max mu_i / mu_c,i; the contraction of a Tresca step for one sliding contact
    kappa: float  # below 1 there is one answer to every load; infinite if W is singular or a body floats
    unique: bool  # whether there is one answer to every load, by kappa or by determinants
    examined: str  # the criterion used

    @property
    def above(self) -> Indices:
        """Return the contacts with at least their critical coefficient, for which some load has several answers."""
        return read_only(np.flatnonzero(self.ratio >= 1.0))

    @property
    def ratio(self) -> Vector:
        """Return the ratios mu_i / mu_c,i (m,)."""
        return read_only(ratio(self._friction, self.single))

    _friction: Vector

    def __repr__(self) -> str:
        least = int(np.argmin(self.single)) if len(self.single) else None
        alone = "no contacts" if least is None else f"least {number(self.single[least])} at contact {least}"
        words = "one answer to every load" if self.unique else "several answers are not excluded"
        return (
            f"CriticalFriction({alone}, contraction {number(self.contraction)}, kappa {number(self.kappa)}, {words}: "
            f"{self.examined})"
        )

    def __str__(self) -> str:
        least = float(np.min(self.single, initial=np.inf))
        at = f", at contact {int(np.argmin(self.single))}" if np.isfinite(least) else ""
        lines = [
            f"critical friction coefficient: {number(least)}{at}, the least of {counted('contact', len(self.single))}",
            f"{LARGEST_RATIO}: {number(self.contraction)}"
            + (": some load has several answers" if self.contraction >= 1 else ""),
            ("one answer to every load" if self.unique else "several answers are not excluded") + f": {self._reason}",
        ]
        return "\n".join(line for text in lines for line in folded(text, "", "  "))

    @property
    def _reason(self) -> str:
        """Return a text on the criterion of uniqueness."""
        if self.examined != KAPPA:
            signs = "of one sign" if self.unique else "not all of one sign"
            return f"the {self.examined} are {signs}"
        if not np.isfinite(self.kappa):
            return "the bound kappa needs bodies that are held and contacts that are independent"
        return f"the bound kappa is {number(self.kappa)}, {'below' if self.unique else 'and not below'} 1"


@checked
@own_floating_point
def critical_friction(problem: ContactProblem) -> CriticalFriction:
    """Return the critical friction coefficient of every contact, and whether there is one answer to every load.

    Where the largest ratio mu_i / mu_c,i of a coefficient to its critical value is 1 or more, loads exist that have
    several answers (Klarbring 1990), and the Tresca fixed-point iteration does not converge without damping as soon as
    that contact slides in the unfavourable direction.

    Parameters
    ----------
    problem : ContactProblem
        A problem with friction, in the plane or in space.

    Raises
    ------
    InvalidProblem
        There is no friction.
    Unsupported
        More than 300 contacts, more than 2000 contact unknowns, or bodies too large to factorise.

    Examples
    --------
    >>> import contactqp as cq
    >>> data = dict(stiffness=[[5.0, -2.0], [-2.0, 1.0]], normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]])
    >>> found = critical_friction(cq.ContactProblem(**data, load=[-1.0, 0.65], friction=0.8))
    >>> found.single.round(9), round(found.contraction, 9), found.unique
    (array([0.5]), 1.6, False)
    """
    if not problem.frictional or problem.friction is None:
        raise InvalidProblem("critical_friction: expected a problem with friction")
    idle, idle_ties = problem.idle_rows()
    if np.any(idle) or np.any(idle_ties):
        found = critical_friction(problem.with_contacts(np.flatnonzero(~idle)).with_ties(np.flatnonzero(~idle_ties)))
        single = np.full(problem.contacts, np.inf)  # contacts that never close are not critical
        single[~idle] = found.single
        return replace(found, single=single, _friction=problem.friction)
    if (near := near_one(problem)) is not None:
        found = critical_friction(near.problem)
        return replace(found, single=near.coefficients(found.single), _friction=problem.friction)
    if iterated(problem) and may_be_factorised(problem):
        with factorised(problem):
            return critical_friction(problem)
    if iterated(problem):
        raise Unsupported("critical_friction: a body this large is not factorised")
    with problem._lock:
        condensation = condense(problem)
        if (reason := too_many(problem, condensation)) is not None:
            raise Unsupported(f"critical_friction: {reason}")
        return critical(problem, condensation)


def too_many(problem: ContactProblem, condensation: Condensation | None = None, nearby: bool = False) -> str | None:
    """Return the reason why a problem is too large for dense operators of all contacts, or None.

    Parameters
    ----------
    problem : ContactProblem
    condensation : Condensation or None, whose unknowns count; without it those that contacts and ties touch do
    nearby : bool, whether equilibria nearby alone are examined
    """
    most = MOST_NEARBY if nearby else MOST_CONTACTS
    if problem.contacts > most:
        return f"{counted('contact', problem.contacts)}, at most {most} are examined"
    unknowns = len(touched_unknowns(problem) if condensation is None else condensation.retained)
    if unknowns > MOST_UNKNOWNS:
        return f"{counted('contact unknown', unknowns)}, at most {MOST_UNKNOWNS} are examined"
    return None


def condensed_to_prove(problem: ContactProblem) -> tuple[Condensation | None, str]:
    """Return the condensation for bounds with friction if sparse systems are used otherwise, or the reason for none."""
    reason = too_many(problem, nearby=True)
    return (condense(problem), "") if reason is None else (None, f"friction: {reason}")


def critical(problem: ContactProblem, condensation: Condensation) -> CriticalFriction:
    """Return `critical_friction` of a condensed problem, computed once for a stiffness, its rows and coefficients."""
    mu = np.zeros(problem.contacts) if problem.friction is None else problem.friction
    cached = problem._computed.critical_friction
    if cached is None or not np.array_equal(cached._friction, mu):
        compliance = contact_compliance(problem, condensation)
        floats, rounding = compliance.floats, compliance.rounding
        cached = of_operator(compliance.W, mu, problem.contacts, floats=floats, rounding=rounding)
        problem._computed.critical_friction = cached
    found: CriticalFriction = cached
    return found


def of_operator(
    W: Array, mu: Vector, contacts: int, *, floats: bool, symmetric: bool = True, rounding: float = 0.0
) -> CriticalFriction:
    """Return `critical_friction` of a Delassus operator.

    Parameters
    ----------
    W : (d m, d m) array [length / force], contact by contact, the normal row first
    mu : (m,) array, coefficients of friction
    contacts : m
    floats : whether bodies float on rigid motions: then kappa is infinite, and combinations are not examined
    symmetric : whether W is symmetric; kappa is infinite where it is not
    rounding : the relative error of W, in whose norm it is measured
    """
    m, d = contacts, len(W) // contacts
    blocks = W.reshape(m, d, m, d)
    own = blocks[np.arange(m), :, np.arange(m), :]
    coupling = np.linalg.norm(own[:, 0, 1:], axis=1)
    # Coupling below the rounding of the block counts as zero.
    coupled = coupling > ZERO_DETERMINANT * np.sqrt(own[:, 0, 0] * np.max(np.einsum("ijj->ij", own[:, 1:, 1:]), axis=1))
    single = np.divide(own[:, 0, 0], coupling, out=np.full(m, np.inf), where=coupled)
    kappa = np.inf if floats or not symmetric else _kappa(blocks, mu)
    unique, examined = kappa * (1 + rounding) < 1.0, KAPPA
    if not unique and d == 2 and m <= MOST_COMBINED and not floats:
        unique, examined = _one_sign(W, mu, rounding), "determinants of all combinations of open, stick and slip"
    contraction = float(np.max(ratio(mu, single), initial=0.0))
    return CriticalFriction(single, contraction, kappa, unique, examined, mu)


def _kappa(blocks: Array, mu: Vector) -> float:
    """Return kappa with weights c that make the diagonals of the two matrices equal.

    Slips that supports prevent are zero in all answers, and their zero rows of W are left out.
    """
    m, d = len(mu), blocks.shape[1]
    felt = np.einsum("ikik->ik", blocks)[:, 1:] > 0
    frictional = np.flatnonzero((mu > 0) & felt.any(axis=1))
    mu_r, felt = mu[frictional], felt[frictional]
    tangential = (d * frictional[:, None] + np.arange(1, d))[felt]
    kept = np.concatenate([d * np.arange(m), tangential])
    W = blocks.reshape(m * d, m * d)[kept[:, None], kept]
    try:
        factor = np.linalg.cholesky(W)
    except np.linalg.LinAlgError:
        return np.inf
    pivots = factor.diagonal() ** 2
    if (pivots / W.diagonal()).min() < ZERO_DETERMINANT:
        return np.inf
    if not len(frictional):
        return 0.0  # NumPy before 2.3 has no norm of empty arrays
    half = inverse_of_lower(factor)
    normal = (half.T @ half)[np.ix_(frictional, frictional)]  # S^-1
    tangent = W[m:, m:]
    own = np.zeros(felt.shape)
    own[felt] = np.diag(tangent)
    across = np.max(own, axis=1)
    weight = np.sqrt(mu_r) * (across / np.diag(normal)) ** 0.25
    other = np.repeat(mu_r / weight, felt.sum(axis=1))
    scaled = [M * (w[:, None] * w) for M, w in ((normal, weight), (tangent, other))]
    if not all(np.all(np.isfinite(one)) for one in scaled):
        return np.inf  # the inverse overflows for very different compliances
    return float(0.5 * np.sqrt(np.prod([np.linalg.eigvalsh(one)[-1] for one in scaled])))


def inverse_of_lower(factor: Any) -> Array:
    """Return the inverse of a lower triangular matrix (p, p), not finite if a pivot is zero."""
    from scipy.linalg.lapack import dtrtri

    inverse, failed = dtrtri(factor, lower=1) if len(factor) else (factor.copy(), 0)
    return np.asarray(np.full_like(factor, np.nan) if failed else inverse)


def combinations(mu: Vector) -> Status:
    """Return all combinations of the contacts' states as an array (c, m)."""
    return np.array(list(all_combinations(mu)), dtype=np.int8).reshape(-1, len(mu))


def system_matrices(W: Array, mu: Vector, status: Status) -> Array:
    """Return the matrices (c, 2m, 2m) of the combinations.

    Contact by contact their rows are l_N or (W l)_N, then l_T, (W l)_T or l_T - s mu l_N.
    """
    m = len(mu)
    unit = np.eye(2 * m).reshape(m, 2, 2 * m)
    rows = W.reshape(m, 2, 2 * m)
    closed, stuck = (status != OPEN)[:, :, None], (status == STICK)[:, :, None]
    sliding = np.where(status == STICK, 0.0, status)[:, :, None] * mu[:, None]
    matrices = np.empty((len(status), m, 2, 2 * m))
    matrices[:, :, 0] = np.where(closed, rows[:, 0], unit[:, 0])
    matrices[:, :, 1] = np.where(stuck, rows[:, 1], unit[:, 1] - sliding * unit[:, 0])
    return matrices.reshape(len(status), 2 * m, 2 * m)


def regular(matrices: Array, rounding: float = ZERO_DETERMINANT) -> Mask:
    """Return which of the matrices (c, q, q) have a determinant beyond rounding of their rows."""
    _, size = np.linalg.slogdet(matrices)
    lengths = np.sum(np.log(np.maximum(np.linalg.norm(matrices, axis=2), TINY)), axis=1)
    return np.asarray(size > lengths + np.log(rounding))


def _one_sign(W: Array, mu: Vector, rounding: float) -> bool:
    """Return whether the determinants of all combinations are positive, as that of W, in spite of rounding.

    The error of a row of W is `rounding` times the roots of its diagonal entry and of the largest eigenvalue.
    """
    diagonal = W.diagonal()[np.column_stack([mu >= 0, mu > 0]).ravel()]
    if not (np.all(diagonal > 0) and rounding < 1):
        return False
    of_rows = rounding * np.sqrt(np.max(np.sum(diagonal) / diagonal, initial=1.0)) if rounding > 0 else 0.0
    matrices = system_matrices(W, mu, combinations(mu))
    if np.any(np.linalg.slogdet(matrices)[0] <= 0):
        return False
    # A determinant may be small by many small eigenvalues and still have a certain sign.
    doubtful = matrices[~regular(matrices, max(ZERO_DETERMINANT, len(W) * of_rows))]
    values = np.linalg.svd(doubtful, compute_uv=False)
    most = np.maximum(SINGULAR_SYSTEM * values[:, 0], rounding * np.sum(diagonal))
    return bool(np.all(values[:, -1] > most))


def felt_rows(compliance: ContactOperators) -> Mask:
    """Return the rows (m, d) with compliance."""
    return compliance.felt


def acting_rows(compliance: ContactOperators, status: Status, mu: Vector) -> Mask:
    """Return the rows (m, d) with compliance on which forces may act while every contact keeps its state."""
    rows = felt_rows(compliance)
    rows[:, 1:] &= (mu > 0)[:, None]
    return np.asarray(rows & (status != OPEN)[:, None])


@dataclass(frozen=True, eq=False)
class Settled:
    """A ball in which the map of `SlipsNearby.settled` has at most one zero."""

    inverse: float  # |J^-1|
    spread: Vector  # (q,) |J^-1 A_i'|
    slack: float  # 1 - q
    radius: float


@dataclass(frozen=True, eq=False)
class SlipsNearby:
    """The change of slips with forces d while all contacts keep their states, as linear maps of a vector y with |y| =
    |d|_W.

    Slips change by A_i y and normal forces by P_i y.
    """

    slides: Mask  # (m,) which contacts slip, with friction
    mu: Vector  # (q,)
    slip: Array  # A (q, d-1, p)
    drive: Array  # B (q, d-1, p), A where the compliance is symmetric
    pushed: Array  # P (q, p)
    kappa: float  # kappa of two answers with the same states

    @classmethod
    def none(cls, mu: Vector) -> SlipsNearby:
        """Return the object for states without slip in space, which are a linear system."""
        none = np.zeros((0, 1, 0))
        return cls(np.zeros(len(mu), dtype=bool), mu[:0], none, none, np.zeros((0, 0)), 0.0)

    @property
    def widest(self) -> Vector:
        """Return the largest slip (q,) of each contact for a y of length one."""
        return np.linalg.norm(self.slip, ord=2, axis=(1, 2)) if self.slip.size else np.zeros(0)

    @property
    def growth(self) -> float:
        """Return the amplification of force errors in slips by an unsymmetric compliance, at least 1."""
        if self.slip is self.drive:
            return 1.0
        p = self.pushed.shape[1]
        return (
            max(1.0, float(np.linalg.norm(np.linalg.solve(self.drive.reshape(p, p), self.slip.reshape(p, p)), 2))) ** 2
        )

    def settled(self, push: Vector, slip: Array, allowance: float, most: float) -> Settled | None:
        """Return a ball around slips s (q, d-1) with forces N (q,) with at most one answer, or None.

        Coulomb's law is H(y) = y + sum B_i'(mu N t - l_T) = 0, N + P_i y for N, s + A_i y for s and t = s / |s|, with

            J = I + sum B_i'(mu t P_i + mu N / |s| (I - t t') A_i).

        For |y| <= r slips turn by at most |A_i| r / (|s| - |A_i| r), which bounds the change of J term by term. If |I -
        J^-1 J(y)| <= q < 1, y - J^-1 H(y) contracts (L. V. Kantorovich, 1948): at most one y has H = 0, and it exists
        within |J^-1 H(0)| / (1 - q) if that is less than r. A nearly singular map has no ball.

        Parameters
        ----------
        push, slip : normal forces and slips, in the scale of the compliance
        allowance : what rounding makes of the compliance, a part of it
        most : the largest radius that is asked for
        """
        size, wide, far = np.linalg.norm(slip, axis=1), self.widest, np.linalg.norm(self.pushed, axis=1)
        if not (np.all(size > 0) and np.all(push >= 0) and most > 0):
            return None
        t = slip / size[:, None]
        across = np.eye(t.shape[1]) - t[:, :, None] * t[:, None, :]
        J = np.eye(self.pushed.shape[1]) + np.einsum("iwp,iw,iq->pq", self.drive, self.mu[:, None] * t, self.pushed)
        J += np.einsum("i,iwp,iwv,ivq->pq", self.mu * push / size, self.drive, across, self.slip, optimize=True)
        try:
            inverse = np.linalg.inv(J)
        except np.linalg.LinAlgError:
            return None
        norms = float(np.linalg.norm(inverse, 2)), float(np.linalg.norm(J, 2))
        if not norms[0] <= MOST_GROWTH:
            return None
        given = 2 * norms[0] * norms[1] * (allowance + len(J) * EPS)
        spread = np.linalg.norm(inverse @ self.drive.swapaxes(1, 2), ord=2, axis=(1, 2))
        radius = min(most, 0.5 * float(np.min(np.divide(size, wide, out=np.full_like(size, np.inf), where=wide > 0))))
        for _ in range(HALVINGS):
            least = size - wide * radius
            turned = wide * radius / least
            curved = far * radius / least + push / size * (wide * radius / least + turned)
            q = given + float(np.sum(self.mu * spread * (turned * far + curved * wide)))
            if q <= 0.5:
                return Settled(norms[0], spread, 1 - q, radius)
            radius /= 2
        return None


def slips_nearby(
    compliance: ContactOperators, status: Status, mu: Vector, skew: Array | None = None
) -> SlipsNearby | None:
    """Return the slips of contacts that keep their states, with kappa of two such answers; None if W is singular.

    Contacts that are closed in both keep their gap, those that stick their slip: with c these rows and l those of
    slips, (W d)_c = 0, so that |d|_W^2 = e'S^-1 e for e = (W d)_l, S = W_ll - W_lc W_cc^-1 W_cl, and d_N is that part
    of -W_cc^-1 W_cl S^-1 e. If a body floats, joints without force are among c, as closed contacts hold it. With L L'
    the symmetric part of S, y = L'S^-1 e has that length, B = L and A = S L'^-1; where S is not symmetric, turning
    slips may drive themselves, and kappa is infinite.

    Parameters
    ----------
    compliance : the operators, in whose norm forces are measured
    status, mu : states and coefficients (m,)
    skew : W (d m, d m) where it is not symmetric, of bodies of which none floats
    """
    m, d = len(mu), len(compliance.W) // len(mu)
    closed, slides = status != OPEN, (abs(status) == 1) & (mu > 0)
    if d == 2 or not np.any(slides):
        return SlipsNearby.none(mu)
    place = np.arange(m * d).reshape(m, d)
    acting = acting_rows(compliance, status, mu)
    if not acting[slides].any(axis=1).all():
        return None
    sticks = acting & (status == STICK)[:, None]
    kept = np.concatenate([place[closed, 0], place[:, 1:][sticks[:, 1:]]])
    along = place[slides, 1:].ravel()
    acted = np.concatenate([kept, along])
    whole = compliance.operator(acted, len(compliance.J)) if skew is None else skew[np.ix_(acted, acted)]
    order = np.arange(len(whole))
    slips = (order >= len(kept)) & (order < len(kept) + len(along))
    try:
        drawn = np.linalg.solve(whole[np.ix_(~slips, ~slips)], whole[np.ix_(~slips, slips)])
        S = whole[np.ix_(slips, slips)] - whole[np.ix_(slips, ~slips)] @ drawn
        S += np.diag(UNFELT * ~acting[slides, 1:].ravel())  # e = 0 there
        factor = np.linalg.cholesky((S + S.T) / 2)
    except np.linalg.LinAlgError:
        return None
    pushed = np.linalg.solve(factor, drawn[np.searchsorted(place[closed, 0], place[slides, 0])].T).T
    drive: Array = np.asarray(factor, dtype=float).reshape(len(pushed), d - 1, -1)
    slip = drive if skew is None else np.linalg.solve(factor, S.T).T.reshape(drive.shape)
    own = mu[slides]
    if not (np.all(np.isfinite(pushed)) and np.all(np.isfinite(slip))):
        return None
    kappa = coupling(pushed, slip, own) if skew is None else np.inf
    return SlipsNearby(slides, own, slip, drive, pushed, kappa)


def coupling(force: Array, slip: Array, mu: Vector) -> float:
    """Return the largest 1/2 sum mu_i (c_i d_N,i^2 + |e_i|^2 / c_i) over vectors y of length one.

    That is at least the largest sum mu_i |d_N,i| |e_i|, for any weights c_i > 0; the better of two choices is taken.

    Parameters
    ----------
    force, slip : what a unit of each component of y makes of normal forces d_N (m, p) and slips e (m, d-1, p)
    mu : coefficients of friction (m,)
    """
    pushed, slid = np.linalg.norm(force, axis=1), np.linalg.norm(slip, axis=(1, 2))
    coupled = (mu > 0) & (pushed > 0) & (slid > 0)
    mu, force, slip, least = mu[coupled], force[coupled], slip[coupled], np.inf
    if not coupled.any():
        return 0.0
    # Weights c_i that make both parts equal, by the largest slip and by the mean one.
    for size in (np.linalg.norm(slip, ord=2, axis=(1, 2)), slid[coupled]):
        c = size / pushed[coupled]
        square = force.T @ ((mu * c)[:, None] * force) + np.einsum("i,iwp,iwq->pq", mu / c, slip, slip)
        if np.all(np.isfinite(square)):
            least = min(least, float(np.linalg.eigvalsh(square)[-1]) / 2)
    return least
