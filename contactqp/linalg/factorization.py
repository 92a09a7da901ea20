"""Sparse direct solvers with a common interface, rigid motions of a singular stiffness, and unknowns that fix them.

If these unknowns are retained with those of contacts and ties, the interior is regular and can be factorised.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.linalg.dense import (
    DENSE_SIZE,
    LIFT,
    DenseCholesky,
    Factorization,
    RigidMotions,
    dense_factor,
    refuse_negative,
)
from contactqp.linalg.extended import SparseRows, extend
from contactqp.model.arrays import EPS, TINY, Array, Indices, Mask, inverse_root, refuse_late

# Motions with energy below this, K scaled to unit diagonal, are tested for being rigid.
SOFT = 1e-10
# SuperLU's settings for a symmetric matrix: pivots from the diagonal, so that they are those of L D L', and an ordering
# of the pattern of A + A' that keeps the factors sparse.
DIAGONAL_PIVOTS: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
MINIMUM_DEGREE = "MMD_AT_PLUS_A"
DROPPED = 1e-3  # the drop tolerance of an incomplete factorisation, with a unit diagonal
# For a rigid motion z, rounding of K gives |K z| of a few eps of |K||z| at each unknown, and an energy, by alternating
# signs, of at most one eps of |z|'|K||z|.
RIGID_FORCE = 32 * EPS
RIGID_ENERGY = EPS
# The most steps of conjugate gradients that distribute forces over a body, and their tolerance relative to |K||z|.
SPREADING, SPREAD = 30, RIGID_FORCE / 4
FAR_APART = 4  # the nodes retained in a body that may float; three that are not collinear fix it
# Motions, their largest entry one, that less than this part of it or of the best fixed one fixes retain more unknowns.
HARDLY_HELD = 1e-4
# With floats of 64 binary digits, sums of this many terms are accurate to half an eps of sizes, in a third of the time.
SHORT = 2**11
ENTRIES_AT_ONCE = 2**20  # of K converted to such floats at a time


class SuperLU:
    """SuperLU in symmetric mode with diagonal pivots, so that its pivots are those of L D L'."""

    def __init__(self, matrix: Any) -> None:
        from scipy.sparse.linalg import splu

        self._scale = inverse_root(matrix.diagonal())
        scaling = sp.diags(self._scale)
        scaled = sp.csc_matrix(scaling @ matrix @ scaling)
        try:
            self._factor = splu(scaled, permc_spec=MINIMUM_DEGREE, **DIAGONAL_PIVOTS)
            self.smallest_pivot = float(np.min(self._factor.U.diagonal()))
        except RuntimeError:  # SuperLU's word for an exactly zero pivot
            lifted = scaled + LIFT * scaled.shape[0] * sp.identity(scaled.shape[0], format="csc")
            self._factor = splu(lifted, permc_spec=MINIMUM_DEGREE, **DIAGONAL_PIVOTS)
            self.smallest_pivot = 0.0
        forget_triangles(self._factor)

    def solve(self, right: Array) -> Array:
        return np.asarray((self._factor.solve((right.T * self._scale).T).T * self._scale).T)


def solved_between_diagonals(diagonals: tuple[Array, Array], coupling: Any, right: Array) -> Array:
    """Return the solution (n + m,) of [D P; P' R] x = b with diagonals D (n,) and R (m,) and a sparse P (n, m)."""
    (first, second), (n, m) = diagonals, coupling.shape
    if 4 * coupling.nnz < n * m:
        matrix = sp.bmat([[sp.diags(first), coupling], [coupling.T, sp.diags(second)]], format="csc")
        return SuperLU(matrix).solve(right)
    if m < n:  # the longer side is eliminated
        return np.roll(solved_between_diagonals((second, first), coupling.T, np.roll(right, m)), n)
    P = coupling.toarray()
    x = np.linalg.solve(np.diag(first) - (P / second) @ P.T, right[:n] - P @ (right[n:] / second))
    return np.append(x, (right[n:] - P.T @ x) / second)


def fill_reducing_order(matrix: Any) -> Indices:
    """Return the order of elimination (n,) that minimum degree finds for the pattern of a symmetric matrix.

    SciPy has no function for it, so SuperLU is run with all off-diagonal entries dropped, which costs only the
    ordering.
    """
    from scipy.sparse.linalg import spilu

    pattern = sp.csc_matrix(matrix, copy=True)
    pattern.data = np.full(pattern.nnz, DROPPED)
    pattern = sp.csc_matrix(pattern + sp.identity(pattern.shape[0], format="csc"))
    nothing = spilu(pattern, drop_tol=1.0, fill_factor=1.0, permc_spec=MINIMUM_DEGREE, **DIAGONAL_PIVOTS)
    return np.argsort(nothing.perm_c)


def forget_triangles(factor: Any) -> None:
    """Empty the copies L and U that SciPy makes on access, which take as much memory as the factors used by `solve`."""
    for triangle in (factor.L, factor.U):
        triangle.data, triangle.indices = triangle.data[:0].copy(), triangle.indices[:0].copy()
        triangle.indptr = np.zeros_like(triangle.indptr)


def with_added_diagonal(matrix: Any, added: Array) -> Any:
    """Return a square CSR matrix with (n,) added to its diagonal, keeping its pattern if the diagonal is stored."""
    by_rows = sp.csr_matrix(matrix)
    rows = np.repeat(np.arange(by_rows.shape[0]), np.diff(by_rows.indptr))
    at = np.flatnonzero(by_rows.indices == rows)
    if not np.array_equal(rows[at], np.arange(len(added))):
        return sp.csr_matrix(by_rows + sp.diags(added))
    data = by_rows.data.copy()
    data[at] += added
    return sp.csr_matrix((data, by_rows.indices, by_rows.indptr), shape=by_rows.shape)


def factorise(matrix: Any) -> Factorization:
    """Factorise a symmetric positive semidefinite matrix; `smallest_pivot` measures its distance from singular.

    Raises InvalidProblem: a pivot is negative beyond rounding: the matrix is indefinite.
    """
    if matrix.shape[0] <= DENSE_SIZE:
        return dense_factor(matrix)
    factor = SuperLU(matrix)
    refuse_negative(factor.smallest_pivot)
    return factor


def right_singular(rows: Array) -> tuple[Array, Array]:
    """Return the singular values of rows (k, r), and all right singular vectors (r, r) as rows."""
    _, values, rotation = np.linalg.svd(rows, full_matrices=len(rows) < rows.shape[1])
    return values, rotation


def images(matrix: Any, columns: Array) -> Array:
    """Return K z of every column z (n, q), accurate to half an eps of |K||z| and rounded to doubles."""
    rows = sp.csr_matrix(matrix)
    if not columns.size:
        return np.zeros((rows.shape[0], columns.shape[1]))
    if np.finfo(np.longdouble).nmant == 63 and np.max(rows.indptr[1:] - rows.indptr[:-1], initial=0) <= SHORT:
        return _long_images(rows, columns)
    return exact_images(rows, columns)


def _long_images(rows: Any, columns: Array) -> Array:
    """Return K z of every column in floats of 64 binary digits, some rows at a time to save memory."""
    long, parts = np.array(columns.T, dtype=np.longdouble, order="C"), max(1, rows.nnz // ENTRIES_AT_ONCE)
    found, ends = np.empty((rows.shape[0], len(long))), [rows.shape[0] * i // parts for i in range(parts + 1)]
    for i, j in pairwise(ends):
        block = rows[i:j].astype(np.longdouble)
        for column, z in zip(found.T, long, strict=True):  # twice as fast one by one
            column[i:j] = block @ z
    return found


def exact_images(matrix: Any, columns: Array) -> Array:
    """Return K z of every column z (n, q), accumulated in pairs of doubles to tell soft motions from rigid ones."""
    extended, images = SparseRows(sp.csr_matrix(matrix)), columns * 0.0
    for image, z in zip(images.T, columns.T, strict=True):
        refuse_late("the rigid motions of the stiffness were found")
        image[:] = (extended @ extend(z)).double()
    return images


def is_rigid(matrix: Any, motions: Array) -> Mask:
    """Return which columns z satisfy K z = 0 to rounding, at every unknown and in energy.

    |K z|_j <= RIGID_FORCE (|K||z|)_j at every unknown j, and z'Kz <= RIGID_ENERGY |z|'|K||z|: a soft spring at one end
    of a long chain distributes its force over all unknowns of the lowest motion, but the energy shows it. `matrix` has
    a diagonal of about one. An unknown at rest among others at rest is compared with the largest motion.
    """
    return _is_rigid(motions, images(matrix, motions), abs(matrix) @ abs(motions))


def _is_rigid(motions: Array, forces: Array, size: Array) -> Mask:
    """Return which motions (n, q) are rigid to the rounding of K, by their forces K z and the sizes |K||z| of these."""
    largest = np.max(abs(motions), axis=0, initial=0.0)
    still = np.all(abs(forces) <= RIGID_FORCE * np.maximum(size, largest), axis=0)
    energy, scale = np.sum(motions * forces, axis=0), np.sum(abs(motions) * size, axis=0)
    return np.asarray(still & (energy <= RIGID_ENERGY * scale))


# Up to this number of rows or pairs a loop in Python is faster than SciPy.
FEW, FEW_PAIRS = 16, 64


def _few_connected_parts(indptr: list[int], indices: list[int]) -> tuple[int, NDArray[np.int32]]:
    """Return the result of `connected_parts` for a small symmetric CSR matrix, by a loop over rows."""
    label, count = [-1] * (len(indptr) - 1), 0
    for first in range(len(label)):
        if label[first] >= 0:
            continue
        reached = [first]
        label[first] = count
        for row in reached:
            for column in indices[indptr[row] : indptr[row + 1]]:
                if label[column] < 0:
                    label[column] = count
                    reached.append(column)
        count += 1
    return count, np.array(label, dtype=np.int32)


def widest_level(matrix: sp.csr_matrix) -> int | None:
    """Return the largest level of a breadth-first search from an end, None if the matrix has several parts."""
    from scipy.sparse.csgraph import breadth_first_order

    n, start, starts = matrix.shape[0], 0, [0]
    for _ in range(2):  # the last unknown reached is at an end
        order, before = breadth_first_order(matrix, start, directed=False)
        if len(order) < n:
            return None
        place = np.empty(n, dtype=np.intp)
        place[order] = np.arange(n)
        parent, starts = place[before[order[1:]]], [0, 1]
        while starts[-1] < n:  # those whose parents are in the last level
            starts.append(1 + int(np.searchsorted(parent, starts[-1])))
        start = int(order[-1])
    return int(np.max(np.diff(starts)))


def connected_parts(matrix: Any) -> tuple[int, NDArray[np.int32]]:
    """Return the number of connected parts of a symmetric matrix, and the part of each unknown (n,)."""
    size = matrix.shape[0]
    if size <= FEW and matrix.format == "csr":
        return _few_connected_parts(matrix.indptr.tolist(), matrix.indices.tolist())
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    if size and len(breadth_first_order(matrix, 0, return_predecessors=False)) == size:
        return 1, np.zeros(size, dtype=np.int32)  # one body, as a search from its first unknown shows
    count, label = connected_components(matrix, directed=False)
    return int(count), label


def joined_parts(count: int, one: Indices, other: Indices) -> Indices:
    """Return the part that each of `count` bodies belongs to, with pairs of them joined."""
    if len(one) > FEW_PAIRS or count > FEW_PAIRS:
        joined = sp.coo_array((np.ones(len(one)), (one, other)), shape=(count, count))
        return np.asarray(connected_parts(joined)[1])
    label = list(range(count))
    for a, b in zip(one.tolist(), other.tolist(), strict=True):
        low, high = sorted((label[a], label[b]))
        if low < high:
            label = [low if number == high else number for number in label]
    return np.unique(label, return_inverse=True)[1]


def stated_motions(matrix: Any, sizes: Any, motions: Array) -> RigidMotions:
    """Return the combinations of motions (n, q) that are rigid, component by component of a matrix's graph.

    Each is that of one component, with K z = 0 to rounding (`is_rigid`), |K| being `sizes`; there may be further ones.
    """
    graph = sp.csr_matrix(matrix)
    root = 1 / inverse_root(graph.diagonal())
    soft = _soft_by_part(graph, root, motions)
    return _rigid_among(graph, root, soft, sizes @ abs(soft))


def _soft_by_part(graph: Any, root: Array, motions: Array) -> Array:
    """Return combinations (n, r) of motions (n, q) with negligible energy, each of one connected part."""
    moving, forces = root[:, None] * motions, (graph @ motions) / root[:, None]
    count, label = connected_parts(graph)
    found: list[Array] = []
    for members in np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label, minlength=count))[:-1]):
        for column in _least_energetic(moving[members], forces[members]).T:
            motion = np.zeros(len(root))
            motion[members] = column
            found.append(motion)
    return np.column_stack(found) / root[:, None] if found else np.zeros((len(root), 0))


def _rigid_among(graph: Any, root: Array, motions: Array, size: Array) -> RigidMotions:
    """Select the rigid ones of motions z (n, q), with |K||z| as `size`, and return their forces by rounding of K."""
    if not motions.shape[1]:
        return RigidMotions(motions)
    forces, root = images(graph, motions), root[:, None]
    rigid = _is_rigid(root * motions, forces / root, size / root)
    return RigidMotions(motions[:, rigid], forces=forces[:, rigid])


def _least_energetic(motions: Array, forces: Array) -> Array:
    """Return orthonormal combinations of motions (p, q) with negligible energy, from their forces K z (p, q)."""
    basis, values, rotation = np.linalg.svd(motions, full_matrices=False)
    kept = values > EPS * max(motions.shape) * np.max(values, initial=0.0)
    if not np.any(kept):
        return motions[:, :0]
    mix = rotation[kept].T / values[kept]
    energy = basis[:, kept].T @ (forces @ mix)
    energies, turned = np.linalg.eigh((energy + energy.T) / 2)
    return np.asarray(motions @ (mix @ turned[:, energies <= SOFT]))  # exact where the motions are


def null_space(matrix: Any) -> RigidMotions:
    """Return the null space of a positive semidefinite matrix, component by component of its graph."""
    motions, softest = null_space_by_part(matrix)
    return RigidMotions(motions.toarray(), softest)


def null_space_by_part(matrix: Any) -> tuple[Any, float]:
    """Return the motions of `null_space` as a sparse matrix (n, q), and the least energy of others that are soft."""
    graph = sp.csr_matrix(matrix)
    count, label = connected_parts(graph)
    order, diagonal = np.argsort(label, kind="stable"), graph.diagonal()
    parts = np.split(order, np.searchsorted(label[order], np.arange(1, count)))
    parts = [some for some in parts if len(some) > 1 or diagonal[some[0]] == 0]
    lone = RigidMotions(np.ones((1, 1)))
    found = [_null_space_of_component(graph[some][:, some]) if len(some) > 1 else lone for some in parts]
    softest = min((local.softest for local in found if local.count), default=1.0)
    if not parts:
        return sp.csr_matrix((graph.shape[0], 0)), softest
    motions, place = sp.block_diag([local.motions for local in found], format="coo"), np.concatenate(parts)
    return sp.csr_matrix((motions.data, (place[motions.row], motions.col)), (len(order), motions.shape[1])), softest


def condensed_null_space(matrix: Any, retained: Indices, elimination: Any, scale: Array) -> RigidMotions:
    """Return the null space of K where the interior is regular: that of S, expanded to all unknowns.

    If S has soft motions that are not rigid, K itself is used.

    Parameters
    ----------
    matrix : (n, n) sparse array, K
    retained : (p,) array of int
    elimination : contactqp.linalg.schur.Elimination, of the interior
    scale : (p,) array, what gives S a unit diagonal
    """
    label = connected_parts(matrix)[1][retained]
    S = elimination.schur * np.outer(scale, scale)
    parts = [_SoftPart(np.flatnonzero(label == c), S) for c in np.unique(label)]
    width = max((part.motions.shape[1] for part in parts), default=0)
    if not width:
        return RigidMotions(np.zeros((matrix.shape[0], 0)))
    soft = np.zeros((len(retained), width))
    for part in parts:
        soft[part.members, : part.motions.shape[1]] = part.motions
    graph, wanted = sp.csr_matrix(matrix), sum(part.motions.shape[1] for part in parts)
    root = 1 / inverse_root(graph.diagonal())
    motions = _soft_by_part(graph, root, elimination.expand_motions(scale[:, None] * soft))
    size = abs(graph) @ abs(motions)
    found = _rigid_among(graph, root, _spread(graph, root, motions, graph @ motions, size), size)
    if found.count < wanted:  # the forces may be rounding errors themselves
        found = _rigid_among(graph, root, _spread(graph, root, motions, images(graph, motions), size), size)
    if found.count < wanted:
        return null_space(matrix)
    return RigidMotions(found.motions, min((part.next_energy for part in parts), default=1.0), found.forces)


def _spread(matrix: Any, root: Array, motions: Array, gathered: Array, size: Array) -> Array:
    """Return rigid motions whose forces K z are rounding errors at every unknown, instead of concentrated at a few.

    Given are motions z (n, r), their forces `gathered` (n, r) and sizes |K||z| (n, r); `root` (n,) is sqrt(K_jj).
    Conjugate gradients solve K s = K z until K (z - s) is rounding at every unknown.
    """
    inverse, spread = 1 / root**2, motions.copy()
    least = np.max(root[:, None] * abs(motions), axis=0, initial=0.0) * root[:, None]
    for z, force, within in zip(spread.T, gathered.T, (SPREAD * np.maximum(size, least)).T, strict=True):
        direction, last = np.zeros(len(z)), np.inf
        for _ in range(SPREADING):
            if np.all(abs(force) <= within):
                break
            scaled = inverse * force
            product = float(force @ scaled)
            direction = scaled + product / last * direction
            response = matrix @ direction
            curvature = float(direction @ response)
            if curvature <= 0:  # the rest is rigid
                break
            step = product / curvature
            z -= step * direction
            force = force - step * response
            last = product
    return spread


class _SoftPart:
    """The soft motions of one body's part of S, scaled to a unit diagonal."""

    def __init__(self, members: Indices, S: Array) -> None:
        self.members = members
        block = S[np.ix_(members, members)]
        shifted = DenseCholesky(block + SOFT * np.eye(len(members)), np.ones(len(members)))
        self.motions, next_energy = _lowest(block, shifted)
        self.next_energy = next_energy if self.motions.shape[1] else 1.0


def _null_space_of_component(component: Any) -> RigidMotions:
    size = component.shape[0]
    # Scaling by powers of two does not round, so an exactly singular matrix stays singular.
    scale = 2.0 ** np.round(np.log2(inverse_root(component.diagonal())))
    scaled = sp.csr_matrix(sp.diags(scale) @ component @ sp.diags(scale))
    lowest, next_energy = _lowest_dense(scaled.toarray()) if size <= 3 * DENSE_SIZE else _lowest_sparse(scaled)
    if not lowest.shape[1]:
        return RigidMotions(lowest)
    # Rounding mixes rigid with nearly rigid motions; accurately formed energies separate them.
    energies, rotation = np.linalg.eigh(lowest.T @ exact_images(scaled, lowest))
    lowest = lowest @ rotation
    rigid = is_rigid(scaled, lowest)
    softest = float(np.min(energies[~rigid], initial=next_energy))
    return RigidMotions(np.asarray(scale[:, None] * lowest[:, rigid]), max(softest, TINY))


def _lowest_dense(scaled: Array) -> tuple[Array, float]:
    """Return the soft motions of a dense matrix, and the energy of the next motion."""
    from scipy.linalg import eigh

    values, vectors = eigh(scaled)
    soft = values <= SOFT
    lowest, others = vectors[:, soft], vectors[:, ~soft]
    for _ in range(2):
        # Refinement removes components of stiff motions by rounding.
        lowest = lowest - others @ ((others.T @ exact_images(scaled, lowest)) / values[~soft, None])
    return lowest, float(np.min(values[~soft], initial=1.0))


def _lowest_sparse(scaled: Any) -> tuple[Array, float]:
    """Return the soft motions by inverse subspace iteration, and the energy of the next motion."""
    shifted = SuperLU(sp.csr_matrix(scaled + SOFT * sp.identity(scaled.shape[0])))
    lowest, next_energy = _lowest(scaled, shifted)
    for _ in range(2):
        # For a rigid z, K z is rounding; solving for it gives the error of z.
        lowest = lowest - shifted.solve(exact_images(scaled, lowest))
    return lowest, next_energy


def _lowest(scaled: Any, shifted: Factorization) -> tuple[Array, float]:
    """Iterate on subspaces by (K + SOFT)^-1, doubling the block until it holds a vector that is not soft."""
    random = np.random.default_rng(0)
    size = scaled.shape[0]
    width = min(8, size)
    while True:
        refuse_late("the rigid motions of the stiffness were found")
        block, _ = np.linalg.qr(random.standard_normal((size, width)))
        for _ in range(4):
            block, _ = np.linalg.qr(shifted.solve(block))
        values, rotation = np.linalg.eigh(block.T @ (scaled @ block))
        if values[-1] > SOFT or width >= size:
            break
        width = min(2 * width, size)
    soft = values <= SOFT
    return np.asarray(block @ rotation[:, soft]), float(np.min(values[~soft], initial=1.0))


def unknowns_far_apart(stiffness: Any) -> Indices:
    """Return the unknowns of `FAR_APART` nodes of every body, each as far from the others as the graph of K allows.

    Unknowns that K couples with the same others form a node.
    """
    graph = sp.csr_matrix(stiffness)
    _, label = connected_parts(graph)
    starts = np.unique(label, return_index=True)[1]
    chosen: list[Indices] = [starts]
    for _ in range(FAR_APART - 1):
        order = np.lexsort((_hops_away(graph, np.concatenate(chosen)), label))
        chosen.append(order[np.append(np.flatnonzero(np.diff(label[order])), len(order) - 1)])
    nodes = np.unique(np.concatenate(chosen))
    return np.unique(np.concatenate([_of_same_node(graph, int(j)) for j in nodes])).astype(np.intp)


def _hops_away(graph: Any, starts: Indices) -> Indices:
    """Return the distance (n,) in the graph of K from the nearest start; every body has one."""
    from scipy.sparse.csgraph import breadth_first_order

    size = graph.shape[0]  # with an additional unknown, from which the search starts
    indices = np.concatenate([graph.indices, starts.astype(graph.indices.dtype)])
    rows = np.append(graph.indptr, len(indices)).astype(graph.indptr.dtype)
    searched = sp.csr_matrix((np.ones(len(indices)), indices, rows), shape=(size + 1, size + 1))
    _, before = breadth_first_order(searched, size)
    ahead = np.where(before < 0, np.arange(size + 1), before)  # predecessors; the first one has none
    hops = (before >= 0).astype(np.intp)
    while np.any(hops[ahead]):
        hops, ahead = hops + hops[ahead], ahead[ahead]
    return np.asarray(hops[:size] - 1)


def _of_same_node(graph: Any, j: int) -> Indices:
    near = np.sort(graph.indices[graph.indptr[j] : graph.indptr[j + 1]])
    return np.array(
        [k for k in near if np.array_equal(np.sort(graph.indices[graph.indptr[k] : graph.indptr[k + 1]]), near)]
    )


def fixing_unknowns(motions: Array, retained: Indices, diagonal: Array) -> Indices:
    """Return stiff unknowns that together with the retained ones prevent rigid motions of the interior."""
    from scipy.linalg import qr

    if not motions.shape[1]:
        return np.zeros(0, dtype=np.intp)
    scaled = motions * np.sqrt(np.where(diagonal > 0, diagonal, np.max(diagonal, initial=0.0) or 1.0))[:, None]
    scaled = scaled / np.max(abs(scaled), axis=0)
    free = scaled
    if retained.size:
        values, rotation = right_singular(scaled[retained])
        held = values > HARDLY_HELD * max(1.0, np.max(values))  # entries of rounding size do not fix a motion
        free = scaled @ rotation[np.count_nonzero(held) :].T
    if not free.shape[1]:
        return np.zeros(0, dtype=np.intp)
    _, _, pivots = qr(free.T, mode="economic", pivoting=True)
    return np.asarray(pivots[: free.shape[1]], dtype=np.intp)
