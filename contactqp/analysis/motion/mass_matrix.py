"""Check mass matrices, remove mass from contact nodes, and compute frequencies.

The critical step is the longest time step of central differences, 2 over the highest frequency. The slowest vibration
excited by an impact determines its duration.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp

from contactqp.errors import InvalidProblem, shown
from contactqp.linalg import pardiso
from contactqp.linalg.convexity import stiffness_factor
from contactqp.linalg.factorization import factorise, null_space
from contactqp.linalg.schur import LARGE
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Indices, Mask, Vector, own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import read_array, read_matrix

# The relative asymmetry that may be due to printed digits.
ASYMMETRY = 1e-6
# The most negative pivot of a semidefinite mass, scaled to a diagonal of one, due to rounding and printing.
INDEFINITE = 1e-6
# The relative accuracy of rigid motions where mass is moved.
KEPT = 1e-9
# Mass goes to so many neighbours that the share of each unknown would add at most this part to the mass of one alone.
HEAVIER = 1.0
# The least pivot, relative to the diagonal, with which the stiffness holds unknowns to others.
LEAST_PIVOT = 1e-12
# Of more compliances than this those are left out that are below this part of the largest, scaled by the stiffness.
MANY, SLIGHT = 1_000_000, 1e-3
# The largest size for which all frequencies are computed.
DENSE_SIZE = 200
# Frequencies whose inertial part of a step's operator is this close to one are rigid motions, or well resolved.
RESOLVED_SHARE = 1e-9
# Lanczos steps for separating the slowest vibration with a long step, and with a known shape.
LANCZOS_STEPS, STEPS_FROM_KNOWN = 24, 2
# Ratios below this are rounding of motions held by contacts: a step would be a million times too long.
HELD_RATIO = 1e-13
# A vector reduced to this part by orthogonalisation lies in the previous space.
SPANNED = 1e-12
# The advice if contacts act on all unknowns of a body, such as a single mass.
OTHERWISE = "take the scheme 'moreau-jean', which lets contacts have mass, or a finer mesh"
_NOT_CARRIED = (
    "mass: contacts act on so many unknowns that their mass cannot be moved to others of the same body; " + OTHERWISE
)


def read_mass(mass: Any, n: int) -> Any:
    """Return M (n, n) CSR from a dense or sparse matrix, or from the diagonal (n,) of a lumped one; a number for n = 1.

    Raises InvalidProblem: another shape, values that are not finite, an asymmetric or indefinite matrix, mass coupled
    to an unknown without mass.
    """
    values = read_matrix("mass", mass) if sp.issparse(mass) else read_array("mass", mass)
    values = values.reshape(1) if values.ndim == 0 and n == 1 else values
    if values.ndim not in (1, 2):
        raise InvalidProblem(f"mass: expected a matrix ({n}, {n}) or its diagonal ({n},), got {shown(mass)}")
    M = sp.csr_matrix(sp.diags(values) if values.ndim == 1 else values)
    if M.shape != (n, n):
        raise InvalidProblem(f"mass: expected a matrix ({n}, {n}) or its diagonal ({n},), got shape {values.shape}")
    if not np.all(np.isfinite(M.data)):
        raise InvalidProblem("mass: expected finite numbers")
    diagonal = M.diagonal()
    if np.any(diagonal < 0):
        j = int(np.argmin(diagonal))
        raise InvalidProblem(f"mass: expected no negative diagonal, got {diagonal[j]:g} at unknown {j}")
    entries = M.tocoo()
    root = np.sqrt(diagonal)  # separate roots, as a product of two small masses underflows
    scale = root[entries.row] * root[entries.col]
    if np.any((scale == 0) & (entries.data != 0)):
        raise InvalidProblem("mass: an unknown without mass of its own is coupled to others: not positive semidefinite")
    difference = abs(M - M.T).tocoo()
    beside = root[difference.row] * root[difference.col]
    if np.any(difference.data > ASYMMETRY * beside):
        raise InvalidProblem("mass: expected a symmetric matrix")
    M = sp.csr_matrix((M + M.T) / 2)
    _refuse_indefinite(M)
    return M


def _refuse_indefinite(M: Any) -> None:
    """Raise InvalidProblem for an indefinite mass, which creates energy and may be hidden by the stiffness of a
    step.
    """
    diagonal = M.diagonal()
    moving = np.flatnonzero(diagonal > 0)
    if not (M - sp.diags(diagonal)).count_nonzero():
        return
    try:
        factorise((M + sp.diags(INDEFINITE * diagonal)).tocsr()[moving][:, moving])
    except InvalidProblem as error:
        raise InvalidProblem("mass: expected a positive semidefinite matrix, got an indefinite one") from error


def massless(mass: Any) -> Mask:
    """Return the unknowns without mass, (n,)."""
    return np.asarray(mass.diagonal() == 0)


def touched(problem: ContactProblem) -> Indices:
    """Return the unknowns touched by E_N, with friction also those of E_T."""
    rows = [problem.normal]
    if problem.frictional and problem.tangent is not None:
        rows.append(problem.tangent)
    return np.unique(np.concatenate([row.indices for row in rows])).astype(np.intp)


@checked
@own_floating_point
def redistributed_mass(mass: Any, problem: ContactProblem) -> Any:
    """Return a mass matrix without mass at the unknowns that contacts act on (Khenous, Laborde and Renard 2008).

    Their rows and columns become zero, and their mass moves with others of the body: M' = T'MT, where u = T u makes
    their displacements of the others. That is semidefinite, depends neither on units nor on the directions of axes, and
    preserves z'Mz for all rigid motions z of the bodies: mass, centre of mass and moments of inertia. T is the least
    one that has these motions, on the nearest neighbours that the stiffness couples. On supported bodies whose rigid
    motions no `near_null_space` states, it is where the stiffness is in balance.

    Parameters
    ----------
    mass : (n, n) matrix or (n,) diagonal
    problem : ContactProblem

    Returns
    -------
    (n, n) CSR matrix, positive semidefinite.

    Raises
    ------
    InvalidProblem
        Contacts act on so many unknowns of a body that no others can carry their mass.
    """
    from scipy.sparse.csgraph import connected_components

    M, K = read_mass(mass, problem.dimension), problem.stiffness_rows
    carries, bare = M.diagonal() > 0, np.zeros(problem.dimension, dtype=bool)
    bare[touched(problem)] = True
    heavy, carries = bare & carries, ~bare & carries
    graph = sp.csr_matrix(abs(K) + abs(M))
    body, blocks = connected_components(graph, directed=False)[1], [sp.diags((~bare).astype(float))]
    motions = _known_motions(problem)
    moves = np.sqrt(problem.diagonal) * np.max(abs(motions), axis=1, initial=0.0)
    for number in np.unique(body[heavy]):
        members, moving = body == number, np.flatnonzero((body == number) & heavy)
        if np.min(moves[moving]) > KEPT * np.max(moves[members]):
            blocks.append(_carried_by_neighbours(graph, M.diagonal(), motions, moving, carries))
        else:
            blocks.append(_carried_in_balance(K, moving, members & ~carries, members & carries))
    moved = _moved(M, sp.csr_matrix(sum(blocks)), np.flatnonzero(heavy))
    return sp.csr_matrix((moved + moved.T) / 2)


def _moved(M: Any, T: Any, heavy: Indices) -> Any:
    """Return T'MT; rows of T at the heavy unknowns that are nearly full are multiplied as an array, in a tenth of the
    time.
    """
    full = T[heavy]
    onto = np.unique(full.indices)
    if full.nnz <= DENSE_SIZE**2 or 2 * full.nnz < len(heavy) * len(onto):
        return T.T @ M @ T
    share = full[:, onto].toarray()
    carried, own = share.T @ (M[heavy][:, heavy] @ share), T.copy()
    own.data[np.repeat(np.isin(np.arange(T.shape[0]), heavy), np.diff(T.indptr))] = 0.0
    across = (own.T @ M)[:, heavy] @ full
    starts = np.zeros(T.shape[1] + 1, dtype=np.intp)
    starts[onto + 1] = len(onto)
    carried = sp.csr_matrix((carried.ravel(), np.tile(onto, len(onto)), np.cumsum(starts)), shape=T.shape)
    return own.T @ M @ own + across + across.T + carried


def _known_motions(problem: ContactProblem) -> Array:
    """Return the rigid motions (n, q) that are stated, or else those of K: none where its factors are regular.

    Finding motions takes factors by SuperLU, for a body in space ten times as long as those by PARDISO.
    """
    if problem.near_null_space is not None:
        return problem.near_null_space
    if problem.dimension > LARGE and pardiso.available():
        try:
            if stiffness_factor(problem) is not None:
                return np.zeros((problem.dimension, 0))
        except InvalidProblem:  # an indefinite one, which the mass may outweigh
            pass
    return null_space(problem.stiffness_rows).motions


def _carried_by_neighbours(graph: Any, mass: Vector, motions: Array, moving: Indices, carries: Mask) -> Any:
    """Return the rows of T (n, n) of some unknowns: the least, relative to masses, with the rigid motions.

    Neighbours are those coupled by the graph, then their neighbours, until this is possible without making any of them
    much heavier.
    """
    rows, columns, values = [], [], []
    alike: dict[bytes, list[int]] = {}
    for j in moving.tolist():
        alike.setdefault(_row(graph, j).tobytes(), []).append(j)
    for unknowns in alike.values():
        near, share, ring = np.array(unknowns), None, moving[:0]
        while share is None or mass[unknowns] @ np.sum(share**2 / mass[ring, None], axis=0) > HEAVIER * len(unknowns):
            reached = np.union1d(near, np.concatenate([_row(graph, j) for j in near.tolist()]))
            if len(reached) == len(near):
                break
            near, wider = reached, reached[carries[reached]]
            if (found := _least_shares(motions, mass, unknowns, wider)) is not None:
                share, ring = found, wider
        if share is None:
            raise InvalidProblem(_NOT_CARRIED)
        rows.append(np.tile(unknowns, len(ring)))
        columns.append(np.repeat(ring, len(unknowns)))
        values.append(share.ravel())
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sp.csr_matrix(entries, shape=graph.shape)


def _row(graph: Any, j: int) -> Indices:
    return np.asarray(graph.indices[graph.indptr[j] : graph.indptr[j + 1]], dtype=np.intp)


def _least_shares(motions: Array, mass: Vector, unknowns: list[int], ring: Indices) -> Array | None:
    """Return the least t (ring, unknowns), relative to masses, with t'z_ring = z of all motions z; None without one."""
    Z, wanted = motions[ring], motions[unknowns]
    size = abs(motions[np.append(ring, unknowns)]).max(axis=0, initial=0.0)
    Z, wanted = Z[:, size > 0] / size[size > 0], wanted[:, size > 0] / size[size > 0]
    root = np.sqrt(mass[ring])[:, None]
    share = root * np.linalg.lstsq((root * Z).T, wanted.T, rcond=None)[0]
    met = abs(Z.T @ share - wanted.T) <= KEPT * (abs(Z).T @ abs(share) + abs(wanted.T)).max(axis=0)
    return share if len(ring) and np.all(met) else None


def _carried_in_balance(K: Any, moving: Indices, resting: Mask, carries: Mask) -> Any:
    """Return the rows of T (n, n) of some unknowns: where the stiffness has unknowns without mass in balance.

    Of many contacts the compliances of one at another are left out where these are slight.
    """
    inside, outer = np.flatnonzero(resting), np.flatnonzero(carries)
    own, at = K[inside][:, inside], np.searchsorted(inside, moving)
    factor = factorise(sp.csr_matrix(own)) if abs(K[inside][:, outer]).sum() else None
    if factor is None or factor.smallest_pivot <= LEAST_PIVOT:
        raise InvalidProblem(_NOT_CARRIED)
    compliance = np.asarray(factor.solve(np.eye(len(inside))[:, at])).T
    if compliance.size > MANY:
        root = np.sqrt(own.diagonal())
        felt = abs(compliance) * root * root[at, None]
        compliance[felt < SLIGHT * felt.max(axis=1, keepdims=True)] = 0.0
    at_moving = sp.csr_matrix((np.ones(len(moving)), (moving, np.arange(len(moving)))), shape=(K.shape[0], len(moving)))
    share = -sp.csr_matrix(compliance) @ K[inside] @ sp.diags(carries.astype(float))
    return at_moving @ share


def critical_step(mass: Any, stiffness: Any) -> float:
    """Return 2 / omega, omega the highest frequency of K x = omega^2 M x on the unknowns with mass [time]; inf
    without any.

    Unknowns without mass are fixed, which does not reduce frequencies.
    """
    moving = np.flatnonzero(mass.diagonal() > 0)
    K = sp.csr_matrix(stiffness)[moving][:, moving]
    M = sp.csr_matrix(mass)[moving][:, moving]
    if not len(moving) or not np.any(K.data):
        return np.inf
    if len(moving) <= DENSE_SIZE:
        from scipy.linalg import eigvalsh

        highest = float(eigvalsh(K.toarray(), M.toarray())[-1])
    else:
        from scipy.sparse.linalg import LinearOperator, eigsh

        factor = factorise(M)
        inverse = LinearOperator(M.shape, matvec=factor.solve, dtype=float)
        start = np.random.default_rng(0).standard_normal(len(moving))
        highest = float(eigsh(K, 1, M=M, Minv=inverse, which="LA", v0=start, tol=1e-8, return_eigenvectors=False)[0])
    return 2 / np.sqrt(highest) if highest > 0 else np.inf


def slowest_frequency(
    respond: Callable[[Vector], Vector],
    mass: Any,
    inertia: float,
    velocity: Vector,
    enough: float = 0.0,
    known: Vector | None = None,
) -> tuple[float | None, Vector | None]:
    """Return the slowest frequency excited by an impact, omega [1 / time], and its shape.

    Both are None if all motions are rigid. The search ends at a frequency that is `enough`, as slower ones do not
    matter; Lanczos' method has one within the residual of its approximation (Parlett 1998, section 4.5).

    Parameters
    ----------
    respond : function
        x = (M s + K)^-1 y with the closed contacts held, s = `inertia`: its frequencies are those of s / (s + omega^2)
        as the eigenvalues of x = respond(s M x).
    mass : (n, n) matrix
    inertia : s [1 / time^2]
    velocity : (n,) array, the excitation by the impact; vibrations orthogonal to it are not found
    enough : a frequency that need not be known better, nor a slower one [1 / time]
    known : (n,) array, optional
        The shape of a vibration with other contacts closed, which is tried first.
    """
    share = inertia / (inertia + enough**2) if enough else np.inf

    def answer(vector: Vector) -> Vector:
        return respond(inertia * (mass @ vector))

    if known is not None:
        found = _slowest(answer, mass, known, share, STEPS_FROM_KNOWN)
        if found[0] >= share:
            return _frequency(inertia, found[0]), found[1]
    largest, shape = _slowest(answer, mass, answer(velocity), share, LANCZOS_STEPS)
    return (None, None) if shape is None else (_frequency(inertia, largest), shape)


def _frequency(inertia: float, share: float) -> float:
    return float(np.sqrt(inertia * (1 / share - 1)))


def _slowest(
    answer: Callable[[Vector], Vector], mass: Any, vector: Vector, enough: float, most: int
) -> tuple[float, Vector | None]:
    """Return the largest ratio of a vibration and its shape by Lanczos' method, 0 and None without vibrations.

    Parameters
    ----------
    answer : the operator, symmetric in the metric of M
    mass : (n, n) matrix, M
    vector : (n,) array, the start
    enough : the ratio at which the search ends
    most : the largest number of steps
    """
    basis: list[Vector] = []
    weighed: list[Vector] = []  # M times these vectors
    operator, reference = np.zeros((most, most)), 0.0
    largest, shape = 0.0, None
    size = np.sqrt(max(float(vector @ (mass @ vector)), 0.0))
    for k in range(most):
        if not np.isfinite(size) or size <= SPANNED * reference or size == 0:
            break
        basis.append(vector / size)
        weighed.append(mass @ basis[-1])
        vector = answer(basis[-1])
        operator[: k + 1, k] = operator[k, : k + 1] = [row @ vector for row in weighed]
        reference = float(np.sqrt(max(float(vector @ (mass @ vector)), 0.0)))
        if not np.isfinite(reference):
            break
        for _ in range(2):  # repeated because of rounding
            for other, weight in zip(basis, weighed, strict=True):
                vector = vector - (weight @ vector) * other
        size = np.sqrt(max(float(vector @ (mass @ vector)), 0.0))
        shares, turns = np.linalg.eigh(operator[: k + 1, : k + 1])
        slow = np.flatnonzero((shares > HELD_RATIO) & (shares < 1 - RESOLVED_SHARE))
        left = size * abs(turns[-1])
        near = slow[(shares[slow] - left[slow] >= enough) & (shares[slow] + left[slow] < 1 - RESOLVED_SHARE)]
        chosen = near[-1] if near.size else slow[-1] if slow.size else None
        largest, shape = 0.0, None
        if chosen is not None:
            shape = np.column_stack(basis) @ turns[:, chosen]
            largest = float(shares[chosen] - left[chosen] if near.size else shares[chosen])
        if near.size:
            break
    return largest, shape
