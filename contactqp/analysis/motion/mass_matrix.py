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
from contactqp.linalg.factorization import factorise, null_space
from contactqp.model.arguments import checked
from contactqp.model.arrays import Array, Indices, Mask, Vector, own_floating_point
from contactqp.model.problem import ContactProblem
from contactqp.model.problem_data import read_array, read_matrix

# The relative asymmetry that may be due to printed digits.
ASYMMETRY = 1e-6
# The most negative pivot of a semidefinite mass, scaled to a diagonal of one, due to rounding and printing.
INDEFINITE = 1e-6
# The relative accuracy of the mass of rigid motions.
KEPT = 1e-9
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

    Their rows and columns become zero. Their mass is added to neighbours, as the smallest diagonal change that
    preserves z'Mz for all rigid motions z of the bodies: mass, centre of mass and moments of inertia. Neighbours are
    those coupled by the stiffness, then their neighbours, until this is possible. For supported bodies, whose rigid
    motions are unknown, the sum of the rows is preserved.

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
        Contacts act on all unknowns of a body, or the remaining mass would be negative.
    """
    from scipy.sparse.csgraph import connected_components

    M = read_mass(mass, problem.dimension)
    kept = np.ones(problem.dimension, dtype=bool)
    kept[touched(problem)] = False
    left = sp.csr_matrix(sp.diags(kept.astype(float)) @ M @ sp.diags(kept.astype(float)))
    graph = abs(problem.stiffness_rows) + abs(M)
    Z, body = null_space(problem.stiffness_rows).motions, connected_components(graph, directed=False)[1]
    change = np.zeros(problem.dimension)
    for number in np.unique(body[~kept]):
        members = body == number
        motions = Z[:, np.any(Z[members] != 0, axis=0)] * members[:, None]
        change += _on_neighbours(graph, M, left, members & ~kept, members & kept, motions)
    diagonal = left.diagonal() + change
    if np.any(diagonal[kept] < 0):
        j = int(np.argmin(np.where(kept, diagonal, np.inf)))
        raise InvalidProblem(
            f"mass: {problem.dof_name(j)} would be left with the mass {diagonal[j]:g}; contacts act on too many "
            f"unknowns for their mass to be moved; {OTHERWISE}"
        )
    return sp.csr_matrix(left + sp.diags(change))


def _on_neighbours(graph: Any, M: Any, left: Any, bare: Mask, kept: Mask, Z: Array) -> Vector:
    """Return the diagonal change (n,) on one body that preserves Z'MZ, on the fewest rings of neighbours."""
    pairs = [(a, b) for a in range(Z.shape[1]) for b in range(a, Z.shape[1])]
    missing = np.array([Z[:, a] @ ((M - left) @ Z[:, b]) for a, b in pairs])
    rows = np.array([Z[:, a] * Z[:, b] for a, b in pairs]).reshape(len(pairs), len(bare))
    size = abs(rows) @ np.asarray(M.diagonal())
    if not pairs:  # a supported body: the sum of the removed rows
        missing, rows, size = np.array([np.sum(M[bare])]), np.ones((1, len(bare))), np.array([M.diagonal().sum()])
    near = bare
    while True:
        reached = near | (np.asarray(graph @ near.astype(float)) > 0)
        ring, change = reached & kept, np.zeros(len(bare))
        if np.any(ring):
            change[ring], *_ = np.linalg.lstsq(rows[:, ring], missing, rcond=None)
            if np.all(abs(rows @ change - missing) <= KEPT * size):
                return change
        if np.array_equal(reached, near):
            raise InvalidProblem(
                "mass: contacts act on so many unknowns that their mass cannot be moved to others of the same body; "
                + OTHERWISE
            )
        near = reached


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
