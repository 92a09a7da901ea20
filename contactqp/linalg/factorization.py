"""Sparse direct solvers behind one small interface; rigid motions of a singular stiffness, and unknowns that hold them.

Retained beside those that contacts and ties touch, the unknowns that hold floating bodies leave no rigid motion to the
interior: it can be factorised.
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
from contactqp.model.arrays import EPS, TINY, Array, Indices, Mask, inverse_root

# Motions whose energy falls below this, K scaled to unit diagonal, are tested for being rigid.
SOFT = 1e-10
# SuperLU's settings for a symmetric matrix: pivots from the diagonal, so that they are those of L D L', and an ordering
# of the pattern of A + A' that keeps the factors sparse.
DIAGONAL_PIVOTS: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
MINIMUM_DEGREE = "MMD_AT_PLUS_A"
# Entries that an incomplete factorisation drops where it meets them, beside a diagonal of one.
DROPPED = 1e-3
# Rounding of K leaves |K z| of a rigid motion at a few eps of |K||z|, unknown by unknown, and its energy, where signs
# alternate, within one of |z|'|K||z|: half of it is one rounding of every entry, and entries are sums of products.
RIGID_FORCE = 32 * EPS
RIGID_ENERGY = EPS
# Steps of conjugate gradients that spread forces over a body, at most, and the part of |K||z| that ends them.
SPREADING, SPREAD = 30, RIGID_FORCE / 4
# Nodes of a body that are retained where it may float: three that are no line hold it.
FAR_APART = 4
# Motions, their largest unknown at one, that the retained unknowns hold by less than this part of the best held one, or
# of one, get an unknown more to hold them.
HARDLY_HELD = 1e-4
# Where the processor has floats of 64 digits, sums of at most so many terms lose no more than half an eps of the sum of
# sizes in them: enough for what is told from the rounding of doubles, in a third of the time.
SHORT = 2**11
# Entries of K that are held as such floats at one time.
ENTRIES_AT_ONCE = 2**20


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


def fill_reducing_order(matrix: Any) -> Indices:
    """Return the order of elimination (n,) that minimum degree finds for the pattern of a symmetric matrix.

    SciPy has no function for it. But SuperLU orders before it factorises, and where every entry beside the diagonal is
    dropped the factorisation costs nothing.
    """
    from scipy.sparse.linalg import spilu

    pattern = sp.csc_matrix(matrix, copy=True)
    pattern.data = np.full(pattern.nnz, DROPPED)
    pattern = sp.csc_matrix(pattern + sp.identity(pattern.shape[0], format="csc"))
    nothing = spilu(pattern, drop_tol=1.0, fill_factor=1.0, permc_spec=MINIMUM_DEGREE, **DIAGONAL_PIVOTS)
    return np.argsort(nothing.perm_c)


def forget_triangles(factor: Any) -> None:
    """Empty the L and U that SciPy makes and keeps when one of them is looked at: they take as much memory again as
    the factors, which `solve` goes on to use."""
    for triangle in (factor.L, factor.U):
        triangle.data, triangle.indices = triangle.data[:0].copy(), triangle.indices[:0].copy()
        triangle.indptr = np.zeros_like(triangle.indptr)


def with_added_diagonal(matrix: Any, added: Array) -> Any:
    """Return a square CSR matrix with (n,) added to its diagonal; where all of that is stored, its pattern stays."""
    by_rows = sp.csr_matrix(matrix)
    rows = np.repeat(np.arange(by_rows.shape[0]), np.diff(by_rows.indptr))
    at = np.flatnonzero(by_rows.indices == rows)
    if not np.array_equal(rows[at], np.arange(len(added))):
        return sp.csr_matrix(by_rows + sp.diags(added))
    data = by_rows.data.copy()
    data[at] += added
    return sp.csr_matrix((data, by_rows.indices, by_rows.indptr), shape=by_rows.shape)


def factorise(matrix: Any) -> Factorization:
    """Factorise a symmetric positive semidefinite matrix; `smallest_pivot` says how near to singular it is.

    Raises InvalidProblem: a pivot is negative beyond rounding: the matrix is indefinite.
    """
    if matrix.shape[0] <= DENSE_SIZE:
        return dense_factor(matrix)
    factor = SuperLU(matrix)
    refuse_negative(factor.smallest_pivot)
    return factor


def right_singular(rows: Array) -> tuple[Array, Array]:
    """Return the singular values of rows (k, r), and all right singular vectors (r, r), one a row."""
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
    """Return K z of every column in floats of 64 digits, some rows at a time, as a copy of K takes twice its memory."""
    long, parts = np.array(columns.T, dtype=np.longdouble, order="C"), max(1, rows.nnz // ENTRIES_AT_ONCE)
    found, ends = np.empty((rows.shape[0], len(long))), [rows.shape[0] * i // parts for i in range(parts + 1)]
    for i, j in pairwise(ends):
        block = rows[i:j].astype(np.longdouble)
        for column, z in zip(found.T, long, strict=True):  # one by one takes half the time of all at once
            column[i:j] = block @ z
    return found


def exact_images(matrix: Any, columns: Array) -> Array:
    """Return K z of every column z (n, q), accumulated in pairs of doubles to tell soft motions from rigid ones."""
    extended = SparseRows(sp.csr_matrix(matrix))
    return np.column_stack([(extended @ extend(z)).double() for z in columns.T]) if columns.size else columns * 0.0


def is_rigid(matrix: Any, motions: Array) -> Mask:
    """Return which columns z satisfy K z = 0 to rounding, at every unknown and in energy.

    |K z|_j <= RIGID_FORCE (|K||z|)_j at every unknown j, and z'Kz <= RIGID_ENERGY |z|'|K||z|: a soft spring at one end
    of a long chain spreads its force over all unknowns of the lowest motion, but not its energy. `matrix` has a
    diagonal of about one. An unknown at rest among unknowns at rest is measured against the largest motion.
    """
    return _is_rigid(motions, images(matrix, motions), abs(matrix) @ abs(motions))


def _is_rigid(motions: Array, forces: Array, size: Array) -> Mask:
    """Return which motions (n, q) are rigid to the rounding of K, by their forces K z and the sizes |K||z| of these."""
    largest = np.max(abs(motions), axis=0, initial=0.0)
    still = np.all(abs(forces) <= RIGID_FORCE * np.maximum(size, largest), axis=0)
    energy, scale = np.sum(motions * forces, axis=0), np.sum(abs(motions) * size, axis=0)
    return np.asarray(still & (energy <= RIGID_ENERGY * scale))


# A matrix of so many rows is searched before SciPy has checked it, and so many pairs are gone through one by one.
FEW, FEW_PAIRS = 16, 64


def _few_connected_parts(indptr: list[int], indices: list[int]) -> tuple[int, NDArray[np.int32]]:
    """Return what `connected_parts` does, of a small symmetric CSR matrix, going from row to row."""
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
    """Return the most unknowns of a level of the breadth-first search from an end; None where it has several parts."""
    from scipy.sparse.csgraph import breadth_first_order

    n, start, starts = matrix.shape[0], 0, [0]
    for _ in range(2):  # the last that is reached from anywhere is at an end
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
    """Return how many connected parts a symmetric matrix has, and which of them each unknown belongs to (n,)."""
    size = matrix.shape[0]
    if size <= FEW and matrix.format == "csr":
        return _few_connected_parts(matrix.indptr.tolist(), matrix.indices.tolist())
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    if size and len(breadth_first_order(matrix, 0, return_predecessors=False)) == size:
        return 1, np.zeros(size, dtype=np.int32)  # one body, which a search from its first unknown tells at once
    count, label = connected_components(matrix, directed=False)
    return int(count), label


def joined_parts(count: int, one: Indices, other: Indices) -> Indices:
    """Return the number of the part that each of `count` bodies belongs to, pairs of them being joined."""
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

    Each is that of one component, with K z = 0 to rounding (`is_rigid`), |K| being `sizes`; what is not among them may
    float all the same.
    """
    graph = sp.csr_matrix(matrix)
    root = 1 / inverse_root(graph.diagonal())
    soft = _soft_by_part(graph, root, motions)
    return _rigid_among(graph, root, soft, sizes @ abs(soft))


def _soft_by_part(graph: Any, root: Array, motions: Array) -> Array:
    """Return combinations (n, r) of motions (n, q) of next to no energy, each of one connected part of a matrix."""
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
    """Select the rigid ones of some motions z (n, q), |K||z| being `size`, with the forces that K's rounding leaves."""
    if not motions.shape[1]:
        return RigidMotions(motions)
    forces, root = images(graph, motions), root[:, None]
    rigid = _is_rigid(root * motions, forces / root, size / root)
    return RigidMotions(motions[:, rigid], forces=forces[:, rigid])


def _least_energetic(motions: Array, forces: Array) -> Array:
    """Return orthonormal combinations of motions (p, q) of next to no energy, by their forces K z (p, q)."""
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
    graph = sp.csr_matrix(matrix)
    count, label = connected_parts(graph)
    order = np.argsort(label, kind="stable")
    bounds = np.searchsorted(label[order], np.arange(count + 1))
    columns, rows, values, found, softest = [], [], [], 0, 1.0
    for c in range(count):
        members = order[bounds[c] : bounds[c + 1]]
        local = _null_space_of_component(graph[members][:, members])
        softest = min(softest, local.softest) if local.count else softest
        for column in local.motions.T:
            rows.append(members)
            columns.append(np.full(len(members), found))
            values.append(column)
            found += 1
    if not found:
        return RigidMotions(np.zeros((graph.shape[0], 0)))
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return RigidMotions(np.asarray(sp.csr_matrix(entries, shape=(graph.shape[0], found)).toarray()), softest)


def condensed_null_space(matrix: Any, retained: Indices, elimination: Any, scale: Array) -> RigidMotions:
    """Return the null space of K where the interior is regular: that of S, expanded to all unknowns.

    Where S has soft motions that are not rigid, K itself is asked.

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
    if found.count < wanted:  # what is spread was itself rounding of doubles, perhaps
        found = _rigid_among(graph, root, _spread(graph, root, motions, images(graph, motions), size), size)
    if found.count < wanted:
        return null_space(matrix)
    return RigidMotions(found.motions, min((part.next_energy for part in parts), default=1.0), found.forces)


def _spread(matrix: Any, root: Array, motions: Array, gathered: Array, size: Array) -> Array:
    """Return rigid motions whose forces K z are rounding at every unknown, not gathered at few as elimination leaves
    them.

    Of motions z (n, r) are given the gathered forces (n, r) and their sizes |K||z| (n, r); `root` (n,) is sqrt(K_jj).

    Steps of conjugate gradients on K s = K z, until K (z - s) is rounding at every unknown: it is what they leave.
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
    if size == 1:
        return RigidMotions(np.ones((1, 1)) if component[0, 0] == 0 else np.zeros((1, 0)))
    # Powers of two scale without rounding: a matrix that is exactly singular stays so.
    scale = 2.0 ** np.round(np.log2(inverse_root(component.diagonal())))
    scaled = sp.csr_matrix(sp.diags(scale) @ component @ sp.diags(scale))
    lowest, next_energy = _lowest_dense(scaled.toarray()) if size <= 3 * DENSE_SIZE else _lowest_sparse(scaled)
    if not lowest.shape[1]:
        return RigidMotions(lowest)
    # Among soft motions rounding mixes the rigid with the nearly rigid; their energies, formed accurately, part them.
    energies, rotation = np.linalg.eigh(lowest.T @ exact_images(scaled, lowest))
    lowest = lowest @ rotation
    rigid = is_rigid(scaled, lowest)
    softest = float(np.min(energies[~rigid], initial=next_energy))
    return RigidMotions(np.asarray(scale[:, None] * lowest[:, rigid]), max(softest, TINY))


def _lowest_dense(scaled: Array) -> tuple[Array, float]:
    """Return the soft motions of a dense matrix, and the energy of the first motion that is not."""
    from scipy.linalg import eigh

    values, vectors = eigh(scaled)
    soft = values <= SOFT
    lowest, others = vectors[:, soft], vectors[:, ~soft]
    for _ in range(2):
        # Refinement takes out what rounding mixed in of the stiff motions.
        lowest = lowest - others @ ((others.T @ exact_images(scaled, lowest)) / values[~soft, None])
    return lowest, float(np.min(values[~soft], initial=1.0))


def _lowest_sparse(scaled: Any) -> tuple[Array, float]:
    """Return the soft motions by inverse subspace iteration, and the energy of the first motion that is not."""
    shifted = SuperLU(sp.csr_matrix(scaled + SOFT * sp.identity(scaled.shape[0])))
    lowest, next_energy = _lowest(scaled, shifted)
    for _ in range(2):
        # K z of a rigid z is rounding; solved for, it is what keeps z from being rigid.
        lowest = lowest - shifted.solve(exact_images(scaled, lowest))
    return lowest, next_energy


def _lowest(scaled: Any, shifted: Factorization) -> tuple[Array, float]:
    """Iterate on subspaces by (K + SOFT)^-1, doubling the block until it holds a vector that is not soft."""
    random = np.random.default_rng(0)
    size = scaled.shape[0]
    width = min(8, size)
    while True:
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
    """Return the unknowns of `FAR_APART` nodes of every body, each as far from those before as the graph of K allows.

    Unknowns that K couples with the same others are those of one node.
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
    """Return the distance of each unknown from the nearest start (n,), in entries of K; every body has a start."""
    from scipy.sparse.csgraph import breadth_first_order

    size = graph.shape[0]  # and the number of an unknown more, from which the search starts
    indices = np.concatenate([graph.indices, starts.astype(graph.indices.dtype)])
    rows = np.append(graph.indptr, len(indices)).astype(graph.indptr.dtype)
    searched = sp.csr_matrix((np.ones(len(indices)), indices, rows), shape=(size + 1, size + 1))
    _, before = breadth_first_order(searched, size)
    ahead = np.where(before < 0, np.arange(size + 1), before)  # who found each: nobody the first, which stays put
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
    """Return stiff unknowns that, held together with the retained ones, leave no rigid motion to the interior."""
    from scipy.linalg import qr

    if not motions.shape[1]:
        return np.zeros(0, dtype=np.intp)
    scaled = motions * np.sqrt(np.where(diagonal > 0, diagonal, np.max(diagonal, initial=0.0) or 1.0))[:, None]
    scaled = scaled / np.max(abs(scaled), axis=0)
    free = scaled
    if retained.size:
        values, rotation = right_singular(scaled[retained])
        held = values > HARDLY_HELD * max(1.0, np.max(values))  # what holds a motion by rounding holds nothing
        free = scaled @ rotation[np.count_nonzero(held) :].T
    if not free.shape[1]:
        return np.zeros(0, dtype=np.intp)
    _, _, pivots = qr(free.T, mode="economic", pivoting=True)
    return np.asarray(pivots[: free.shape[1]], dtype=np.intp)
