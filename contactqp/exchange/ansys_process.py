"""Ansys's binary files, read by ansys-mapdl-reader in a process of its own.

That reader is compiled code without bounds on what a damaged file may point at: it can end its interpreter. Here that
ends this process only, which writes what it has read to a .npz file.
"""

from __future__ import annotations

import sys
import warnings
from typing import Any

import numpy as np
import scipy.sparse as sp

# Address space beyond what the file itself may take up: the reader brings a graphics library with it.
MEMORY, TIMES = 2**33, 64


def main(arguments: list[str]) -> int:
    """``full|rst FILE OUTPUT BYTES``: read a file of so many bytes; what goes wrong is one line on stderr."""
    kind, source, output, size = arguments
    _limit_memory(MEMORY + TIMES * int(size))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = {"full": full, "rst": result}[kind](source)
        np.savez(output, **found)
    # A reader that is not ours raises whatever it stumbles over in a damaged file.
    except Exception as error:  # noqa: BLE001
        print(f"{type(error).__name__}: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    return 0


def full(source: str) -> dict[str, Any]:
    """Stiffness (as `scipy.sparse.save_npz` stores it), load, nodes and directions of the free unknowns."""
    from ansys.mapdl.reader.full import FullFile

    file = FullFile(source)
    unknowns, K, _ = file.load_km(sort=False)
    if K is None:
        raise ValueError("no stiffness matrix in it")
    held = {(int(node), int(axis)) for node, axis in file.const}
    free = np.array([(int(node), int(axis)) not in held for node, axis in unknowns], dtype=bool)
    half = sp.csr_matrix(K)[free][:, free]
    upper = sp.triu(half + half.T) - sp.diags(half.diagonal())  # one half is stored, on either side of the diagonal
    whole = sp.csr_matrix(upper + sp.triu(upper, 1).T)
    return {
        "stiffness_data": whole.data,
        "stiffness_indices": whole.indices,
        "stiffness_indptr": whole.indptr,
        "stiffness_shape": np.array(whole.shape),
        "load": np.asarray(file.load_vector, dtype=float)[free],
        "node": np.asarray(unknowns)[free, 0],
        "axis": np.asarray(unknowns)[free, 1],
        "held": np.array(len(held)),
        "equations": np.array(int(file._header["ncefull"])),
    }


def result(source: str) -> dict[str, Any]:
    """Displacements of the last set, along the axes of the nodes."""
    from ansys.mapdl.reader.rst import Result

    file = Result(source, read_mesh=False)
    node, values = file.nodal_solution(file.n_results - 1, in_nodal_coord_sys=True)
    return {
        "node": np.asarray(node),
        "values": np.asarray(values, dtype=float),
        "axes": np.array([str(name) for name in file.result_dof(file.n_results - 1)]),
        "sets": np.array(int(file.n_results)),
    }


def _limit_memory(most: int) -> None:
    try:
        import resource
    except ImportError:  # not on every system
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (most if hard < 0 else min(most, hard), hard))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
