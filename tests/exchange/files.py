"""Small files in the formats of other codes, written here word by word, not by the code under test."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.sparse as sp

# Two contacts in the plane, unsymmetric as files' W are.
W = np.array([[2.0, 0.5, 0.0, 0.0], [0.4, 3.0, 0.0, 0.0], [0.0, 0.0, 4.0, -1.0], [0.25, 0.0, -1.0, 5.0]])
Q = np.array([-1.0, 0.5, 0.25, -0.125])
MU = np.array([0.3, 0.5])
# One joint.
V = np.array([[1.0], [0.0], [-2.0], [0.0]])
R = np.array([[7.0]])
S = np.array([0.75])

# One body of three unknowns with one contact in space, and one with a joint.
M = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 0.0], [0.0, 0.0, 2.0]])
H = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
F = np.array([1.0, -2.0, 3.0])
OFFSET = np.array([0.5, -0.25, 0.125])
G = np.array([[1.0], [-1.0], [0.0]])
B = np.array([0.0625])


def stored(matrix: np.ndarray, storage: str, spare: int = 0) -> dict[str, Any]:
    """A matrix as FCLIB holds it; the arrays have `spare` entries more than are used, which hold rubbish."""
    m, n = matrix.shape
    row, column = np.nonzero(matrix)
    if storage == "csc":
        order = np.lexsort((row, column))
        p, i, nz = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=n))]), row[order], -1
    elif storage == "csr":
        order = np.lexsort((column, row))
        p, i, nz = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=m))]), column[order], -2
    else:
        order = np.arange(len(row))[::-1]  # triplets need no order
        p, i, nz = np.concatenate([column[order], np.full(spare, 99)]), row[order], len(row)
    i = np.concatenate([i, np.full(spare, 99)])
    x = np.concatenate([matrix[row, column][order], np.full(spare, np.nan)])
    return dict(
        nzmax=np.array([len(row) + spare], dtype=np.int32),
        m=np.array([m], dtype=np.int32),
        n=np.array([n], dtype=np.int32),
        nz=np.array([nz], dtype=np.int32),
        p=p.astype(np.int32),
        i=i.astype(np.int32),
        x=x,
    )


def local_tree(storage: str = "csr", *, joints: bool = False, spare: int = 0) -> dict[str, Any]:
    """What a local FCLIB file of W, Q, MU (and V, R, S) holds."""
    tree: dict[str, Any] = {
        "spacedim": np.array([2], dtype=np.int32),
        "W": stored(W, storage, spare),
        "vectors": {"q": Q, "mu": MU},
    }
    if joints:
        tree |= {"V": stored(V, storage, spare), "R": stored(R, storage, spare)}
        tree["vectors"] = tree["vectors"] | {"s": S}
    return {"fclib_local": tree}


def global_tree(storage: str = "triplet", *, joints: bool = False, spare: int = 0) -> dict[str, Any]:
    """What a global FCLIB file of M, H, F, OFFSET (and G, B) holds."""
    tree: dict[str, Any] = {
        "spacedim": np.array([3], dtype=np.int32),
        "M": stored(M, storage, spare),
        "H": stored(H, storage, spare),
        "vectors": {"f": F, "w": OFFSET, "mu": MU[:1]},
    }
    if joints:
        tree |= {"G": stored(G, storage, spare)}
        tree["vectors"] = tree["vectors"] | {"b": B}
    return {"fclib_global": tree}


def write_hdf5(path: Path, tree: Mapping[str, Any]) -> Path:
    """A nested mapping as groups and datasets."""

    def fill(group: h5py.Group, part: Mapping[str, Any]) -> None:
        for name, value in part.items():
            if isinstance(value, Mapping):
                fill(group.create_group(name), value)
            else:
                group.create_dataset(name, data=value)

    with h5py.File(path, "w") as file:
        fill(file, tree)
    return path


def put(tree: Mapping[str, Any], place: str, value: Any) -> dict[str, Any]:
    """The tree with another value at a place such as ``fclib_local/W/nz``; None takes it out."""
    first, _, rest = place.partition("/")
    changed = dict(tree)
    if rest:
        changed[first] = put(tree.get(first, {}), rest, value)
    elif value is None:
        del changed[first]
    else:
        changed[first] = value
    return changed


def numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.17g}" for value in np.ravel(values))


def dense_text(matrix: np.ndarray) -> str:
    m, n = matrix.shape
    return f"0\n{m}\n{n}\n{m}\t{n}\n{numbers(matrix.T)}\n"


def blocks_text(matrix: np.ndarray, row_ends: list[int], column_ends: list[int]) -> str:
    """Sparse blocks: those that are all zero are left out."""
    rows, columns = [0, *row_ends], [0, *column_ends]
    blocks, first, column = [], [0], []
    for i in range(len(row_ends)):
        for j in range(len(column_ends)):
            block = matrix[rows[i] : rows[i + 1], columns[j] : columns[j + 1]]
            if np.any(block):
                blocks.append(block)
                column.append(j)
        first.append(len(blocks))
    lists = [row_ends, column_ends, [len(first)], [len(column)], first, column]
    head = [1, *matrix.shape, len(blocks), len(row_ends), len(column_ends)]
    text = "\n".join(str(v) for v in head) + "\n" + "\n".join("\t".join(map(str, part)) for part in lists) + "\n"
    return text + "".join(f"{k}\n{numbers(block.T)}\n" for k, block in enumerate(blocks))


BANNER = "CSparse Version 3.1.9, May 4, 2016.  Copyright (c) Timothy A. Davis, 2006-2016"


def triplets_text(matrix: np.ndarray) -> str:
    m, n = matrix.shape
    entries = [f"    {i} {j} : {matrix[i, j]:g}" for i, j in zip(*np.nonzero(matrix), strict=True)]
    head = f"triplet: {m}-by-{n}, nzmax: {len(entries) + 7} nnz: {len(entries)}"
    return "\n".join(["2", str(m), str(n), "1", BANNER, head, *entries]) + "\n"


def columns_text(matrix: np.ndarray) -> str:
    m, n = matrix.shape
    columns = sp.csc_array(matrix)
    lines = []
    for j in range(n):
        a, b = columns.indptr[j], columns.indptr[j + 1]
        lines.append(f"    col {j} : locations {a} to {b - 1}")
        lines += [f"      {columns.indices[k]} : {columns.data[k]:g}" for k in range(a, b)]
    head = f"{m}-by-{n}, nzmax: {columns.nnz} nnz: {columns.nnz}, 1-norm: 9"
    return "\n".join(["2", str(m), str(n), "2", BANNER, head, *lines]) + "\n"


def local_text(matrix: str, end: str = "") -> str:
    return f"2\n2\n{matrix}{numbers(Q)}\n{numbers(MU)}\n{end}"


def global_text(matrix: str, directions: str, end: str = "") -> str:
    return f"3\n1\n{matrix}{directions}{numbers(F)}\n{numbers(OFFSET)}\n{numbers(MU[:1])}\n{end}"
