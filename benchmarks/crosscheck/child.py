"""What the processes under the system's Python share: the problem they read, the answer they write. NumPy 1, SciPy."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import scipy.sparse as sp


@dataclass(frozen=True, eq=False)
class Given:
    """The block as arrays; K by rows (CSR)."""

    points: np.ndarray  # (N, 3)
    cells: np.ndarray  # (C, 8)
    free: np.ndarray  # (n, 2) node and axis of every unknown
    bottom: np.ndarray  # (m,) nodes that may touch
    load: np.ndarray  # (n,)
    gap: np.ndarray  # (m,)
    normal: np.ndarray  # (m, n) E_N
    tangent: np.ndarray  # (2m, n) E_T, or (0, n)
    friction: np.ndarray  # (m,) or (0,)
    data: np.ndarray
    indices: np.ndarray
    indptr: np.ndarray

    @property
    def stiffness(self) -> sp.csr_matrix:
        n = len(self.load)
        return sp.csr_matrix((self.data, self.indices, self.indptr), shape=(n, n))

    def save(self, file: Path) -> None:
        np.savez(file, **{one.name: getattr(self, one.name) for one in fields(self)})

    @classmethod
    def load_file(cls, file: Path) -> Given:
        with np.load(file) as data:
            return cls(**{one.name: data[one.name] for one in fields(cls)})


def write_answer(file: Path, said: str, version: str, **parts: np.ndarray) -> None:
    """The parts of an answer in their own signs, and what the code says of it itself."""
    data: dict[str, object] = {name: np.asarray(values).tolist() for name, values in parts.items()}
    file.write_text(json.dumps(data))
    file.with_suffix(".said.json").write_text(json.dumps({"said": said, "version": version}))


def debian_version(package: str) -> str:
    """The version of a Debian package as its makers number it, "?" where there is none."""
    try:
        asked = ["dpkg-query", "-W", "-f", "${Version}", package]
        said = subprocess.run(asked, capture_output=True, text=True).stdout
    except OSError:
        said = ""
    return said.split("+")[0].split("-")[0] or "?"
