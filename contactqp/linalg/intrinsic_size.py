"""What counts as nothing: the intrinsic size of a problem with an answer, and what is rounding beside it.

Componentwise figures compare the forces and the lengths that meet at one place. Where displacements decay to 1e-20 of
the largest, or a load acts on a support, nothing meets there but rounding, which must not be measured against itself.
With D_j = 1/sqrt(K_jj) and the displacement u_e without its rigid part, the intrinsic size S [square root of energy] is
the largest of

    |u_e|_K,    max_j D_j |f|_j,    max_j D_j |E_N'l_N + E_T'l_T + A'nu|_j,    max_i length_i / |E_i D|,

length_i being |g_i| where the answer closes that gap (|b_i| of a tie, |slip_origin_i| where contact i sticks there) and
at most ten times |E_i||u_e| elsewhere; a problem without load and ties to impose lengths has its smallest gap. A force
at unknown j is nothing up to t S / D_j, a length of row i up to t S |E_i D|, t being a thousandth of the tolerance,
1e-12 by default. So is what no doubles could hold better: a rounding of |K||u| and of |E||u|, with the rigid part, and
the few roundings of |K||z| that K, being rounded itself, leaves of a rigid motion z.

Forces combine to their resultant before they are measured: forces that redundant ties exert on each other give no size.
Parts of a problem that no stiffness, contact or tie connects have sizes of their own, of which none is taken to be less
than a tolerance (1e-9) of the largest: a heavy neighbour hides nothing. A part that nothing moves has the largest.
What is excused is in the residuals that the bounds are made of, so it hides no error above theirs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.factorization import RIGID_FORCE, RigidMotions, connected_parts
from contactqp.linalg.row_sizes import row_sizes
from contactqp.model.arrays import Vector
from contactqp.model.problem import ContactProblem
from contactqp.model.verdicts import Nothing

# A gap that an answer leaves smaller than this part of its lengths is one that it closes.
CLOSED = 1e-6
# Gaps that stay open give a size up to so many times the lengths that meet there.
WITHIN_REACH = 10.0
# The size of a part that is connected with no other is at least this part of the largest.
BESIDE_OTHERS = 1e-9
# What rounding a displacement to doubles makes of forces and lengths, relative to |K||u| and |E||u|: half a rounding of
# every entry, and the signs are not all alike.
HELD_BY_DOUBLES = float(np.finfo(float).eps)
# A load on an unknown that neither stiffness nor a row touches is rounding up to this part of the largest load: such as
# the component of a force across a bar, F sin(pi).
ROUNDING_OF_LOADS = 64 * float(np.finfo(float).eps)


def without_rigid_part(problem: ContactProblem, displacement: Vector, rigid: RigidMotions) -> Vector:
    """The displacement (n,) less its rigid part, in the least squares of sqrt(K_jj) u_j.

    Where nothing is stiff there is no rigid part either: unknowns without stiffness keep their displacement.
    """
    return displacement - rigid.motions @ rigid_part(problem, displacement, rigid) if rigid.count else displacement


def rigid_part(problem: ContactProblem, displacement: Vector, rigid: RigidMotions) -> Vector:
    """The coordinates (r,) of the rigid part of a displacement."""
    weight = np.sqrt(problem.diagonal)
    coordinates, *_ = np.linalg.lstsq(weight[:, None] * rigid.motions, weight * displacement, rcond=None)
    return np.asarray(coordinates)


def intrinsic_size(problem: ContactProblem, answer: Any, elastic: Vector) -> Vector:
    """S (n,) of a problem and an answer, that of the part which each unknown belongs to.

    `elastic` (n,) is the displacement without its rigid part.
    """
    D, part = scale_of_unknowns(problem), _parts(problem)
    constraint = problem.normal.T @ answer.normal_force + problem.tie.T @ answer.tie_force
    if problem.tangent is not None and answer.friction_force is not None:
        constraint = constraint + problem.tangent.T @ answer.friction_force.ravel()
    strain = np.bincount(part, weights=elastic * (problem.stiffness_rows @ elastic))
    size = np.sqrt(np.maximum(strain, 0.0))
    np.maximum.at(size, part, np.maximum(D * problem.load_size, D * abs(constraint)))
    for rows, limit in _rows(problem):
        u, of_row = answer.displacement, row_sizes(problem, rows)
        lengths = rows @ u, of_row.size @ abs(u), of_row.size @ abs(elastic)
        row, unknown = _first_unknowns(rows)
        np.maximum.at(size, part[unknown], imposed(limit, *lengths, of_row.compliance)[row])
    size[~np.isfinite(size)] = 0.0  # what overflows excuses nothing
    whole = float(np.max(size, initial=0.0))
    if not np.any(problem.load_size) and not np.any(problem.tie_value):
        gaps = in_energy(abs(problem.gap), row_sizes(problem, problem.normal).compliance)
        least = float(np.min(gaps[np.isfinite(gaps) & (gaps > 0)], initial=np.inf))
        whole = max(whole, least if np.isfinite(least) else 0.0)
        return np.full(len(part), whole)
    return np.asarray(np.where(_driven(problem, part), np.maximum(size, BESIDE_OTHERS * whole), whole)[part])


def _driven(problem: ContactProblem, part: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether anything moves each part: a load, an overlap, a tie's or a slip's length."""
    driven = np.zeros(int(part.max(initial=-1)) + 1, dtype=bool)
    driven[part[problem.load_size > 0]] = True
    for rows, limit in _rows(problem):
        row, unknown = _first_unknowns(rows)
        moving = limit[row] < 0 if rows is problem.normal else limit[row] != 0
        driven[part[unknown[moving]]] = True
    return driven


def nothing(problem: ContactProblem, answer: Any, elastic: Vector, size: Vector, part: float) -> Nothing:
    """What is nothing beside intrinsic sizes (n,): this part of them, or what no doubles could hold better.

    `elastic` (n,) is the displacement without its rigid part, of which K, being rounded, leaves RIGID_FORCE at most.
    """
    u = abs(answer.displacement)
    D = scale_of_unknowns(problem)
    force = np.divide(part * size, D, out=np.zeros_like(D), where=D > 0)
    force = np.maximum(force, HELD_BY_DOUBLES * (stiffness_sizes(problem) @ u))
    if elastic is not answer.displacement:
        force = np.maximum(force, RIGID_FORCE * (stiffness_sizes(problem) @ abs(answer.displacement - elastic)))
    bare = _untouched(problem)
    if np.any(bare):
        force[bare] = ROUNDING_OF_LOADS * np.max(problem.load_size, initial=0.0)

    def lengths(rows: Any) -> Vector:
        sizes, beside = row_sizes(problem, rows), np.zeros(rows.shape[0])
        row, unknown = _first_unknowns(rows)
        beside[row] = size[unknown]
        return np.asarray(np.maximum(part * beside * np.sqrt(sizes.compliance), HELD_BY_DOUBLES * (sizes.size @ u)))

    tangent = np.zeros(0) if problem.tangent is None else lengths(problem.tangent)
    return Nothing(force, lengths(problem.normal), tangent, lengths(problem.tie))


def bodies(problem: ContactProblem) -> NDArray[np.intp]:
    """(n,) the number of the body, a connected part of K, that each unknown belongs to."""
    if "bodies" not in problem._shared:
        _, problem._shared["bodies"] = connected_parts(problem.stiffness_rows)
    body: NDArray[np.intp] = problem._shared["bodies"]
    return body


def _parts(problem: ContactProblem) -> NDArray[np.intp]:
    """(n,) the number of the part, bodies connected by contacts and ties, that each unknown belongs to."""
    from scipy.sparse.csgraph import connected_components

    if "parts" not in problem._shared:
        body = bodies(problem)
        count = int(body.max(initial=-1)) + 1
        joints = sp.vstack([rows for rows in (problem.normal, problem.tangent, problem.tie) if rows is not None])
        joints = sp.csr_matrix(joints)
        places = (np.ones(joints.nnz), body[joints.indices], joints.indptr)
        touched = sp.csr_matrix(places, shape=(joints.shape[0], count))
        graph = sp.bmat([[sp.csr_matrix((count, count)), touched.T], [touched, None]])
        problem._shared["parts"] = connected_components(graph, directed=False)[1][:count][body]
    part: NDArray[np.intp] = problem._shared["parts"]
    return part


def _first_unknowns(rows: Any) -> tuple[Any, Any]:
    """The rows that touch an unknown, and for each of them one that it touches."""
    row = np.flatnonzero(np.diff(rows.indptr))
    return row, rows.indices[rows.indptr[row]]


def _rows(problem: ContactProblem) -> list[tuple[Any, Vector]]:
    rows = [(problem.normal, problem.gap), (problem.tie, problem.tie_value)]
    if problem.tangent is not None and problem.slip_origin is not None:
        rows.append((problem.tangent, problem.slip_origin.ravel()))
    return rows


def imposed(limit: Vector, moved: Vector, whole: Vector, elastic: Vector, compliance: Vector) -> Vector:
    """The lengths that rows impose on an answer, each in the square root of energy.

    Parameters
    ----------
    limit, moved, whole, elastic : (r,) arrays
        g, E u, |E||u| and |E||u_e| of the rows [length].
    compliance : (r,) array
        |E_i D|^2 [length / force].
    """
    finite = np.isfinite(limit)
    length = abs(np.where(finite, limit, 0.0))
    closes = finite & (abs(np.where(finite, limit, 0.0) - moved) <= CLOSED * (whole + length))
    reached = np.where(finite, np.minimum(length, WITHIN_REACH * elastic), 0.0)
    return in_energy(np.where(closes, length, reached), compliance)


def in_energy(length: Vector, compliance: Vector) -> Vector:
    """Lengths of rows over |E_i D|; those of rows that touch nothing stiff give no size."""
    return np.divide(length, np.sqrt(compliance), out=np.zeros_like(length), where=compliance > 0)


def scale_of_unknowns(problem: ContactProblem) -> Vector:
    """D (n,): 1/sqrt(K_jj); of an unknown without stiffness what its rows give it, and 0 where none does.

    A row that touches stiff unknowns k as well gives max_k |E_ik| D_k / |E_ij|; of several the largest counts.
    """
    if "scale_of_unknowns" not in problem._shared:
        K = problem.diagonal
        D = np.divide(1.0, np.sqrt(K), out=np.zeros_like(K), where=K > 0)
        if not np.all(K > 0):
            for rows in (problem.normal, problem.tie):
                D = np.maximum(D, np.where(K > 0, 0.0, _given_by(rows, D)))
        problem._shared["scale_of_unknowns"] = D
    scale: Vector = problem._shared["scale_of_unknowns"]
    return scale


def _given_by(rows: Any, D: Vector) -> Vector:
    row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
    size = abs(rows.data)
    largest = np.zeros(rows.shape[0])
    np.maximum.at(largest, row, size * D[rows.indices])
    given = np.zeros_like(D)
    acting = size > 0
    np.maximum.at(given, rows.indices[acting], largest[row[acting]] / size[acting])
    return given


def _untouched(problem: ContactProblem) -> Any:
    """(n,) whether neither the stiffness nor a row touches an unknown."""
    if "untouched" not in problem._shared:
        touched = problem.diagonal > 0
        for rows in (problem.normal, problem.tangent, problem.tie):
            if rows is not None:
                touched[rows.indices[rows.data != 0]] = True
        problem._shared["untouched"] = ~touched
    return problem._shared["untouched"]


def stiffness_sizes(problem: ContactProblem) -> Any:
    """|K|, made once for a stiffness."""
    if "stiffness_sizes" not in problem._shared:
        problem._shared["stiffness_sizes"] = abs(problem.stiffness_rows)
    return problem._shared["stiffness_sizes"]
