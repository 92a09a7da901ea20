"""The error that all solvers are scored by, of NumPy alone: Siconos's process uses it too, and our certificate takes
no part in it.

With W scaled to max |W| = 1 and q to |q| = sqrt(n), n = d m (forces by max |W| / (|q| / sqrt(n))),

    error = |r - P_K(r - u - mu |u_T| e_N)| / sqrt(n),   u = W r + q    (Acary, Bremond, Huber 2018).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Arrays:
    """A scaled problem: W by its entries, square blocks of d rows a contact, N before T."""

    rows: np.ndarray  # (entries,)
    columns: np.ndarray  # (entries,)
    values: np.ndarray  # (entries,), the largest of size one
    offset: np.ndarray  # (n,), entries of size one
    friction: np.ndarray  # (m,)

    @property
    def dimension(self) -> int:
        return len(self.offset) // len(self.friction)

    def save(self, file: Path) -> None:
        np.savez(file, **vars(self))

    @classmethod
    def load(cls, file: Path) -> Arrays:
        with np.load(file) as data:
            return cls(**{name: data[name] for name in cls.__dataclass_fields__})


def score(problem: Arrays, force: np.ndarray) -> float:
    """The error of scaled forces (n,) or (m, d), in extended precision where the machine has it; infinite for NaN."""
    r = np.asarray(force, dtype=np.longdouble).ravel()
    if not np.all(np.isfinite(r)):
        return float("inf")
    u = problem.offset.astype(np.longdouble)
    np.add.at(u, problem.rows, problem.values * r[problem.columns])
    shape = (-1, problem.dimension)
    r, u = r.reshape(shape), u.reshape(shape)
    moved = r - u
    moved[:, 0] -= problem.friction * np.linalg.norm(u[:, 1:], axis=1)
    residual = r - projection(moved, problem.friction)
    return float(np.sqrt(np.sum(residual**2) / residual.size))


def projection(x: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """The nearest points of Coulomb's cones |r_T| <= mu r_N to the rows of x (m, d)."""
    size = np.sqrt(np.sum(x[:, 1:] ** 2, axis=1))
    normal = np.maximum((x[:, 0] + friction * size) / (1 + friction**2), 0)
    shrunk = np.divide(friction * normal, size, out=np.zeros_like(size), where=size > 0)
    nearest = np.column_stack([normal, shrunk[:, None] * x[:, 1:]])
    return np.where((size <= friction * x[:, 0])[:, None], x, nearest)
