"""Truss bars at any displacement and rotation: the total Lagrangian form, derived from the energy of Green's strain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.elements.bar_law import LAWS, BarLaw
from contactqp.elements.reading import real_array
from contactqp.errors import InvalidProblem
from contactqp.model.arrays import Array, computes
from contactqp.model.problem_data import ReadOnly, read_only, read_whole


@computes
@dataclass(frozen=True, eq=False)
class NonlinearTruss(ReadOnly):
    """Bars between nodes, each with the energy E A0 L0 w(eps): by default 1/2 E A0 L0 eps^2.

    The unknowns are the displacements node by node, u[d i + a] that of node i along axis a. With x = X + u,
    d = x_end - x_start and b = d / L0^2, a bar has

        eps = (d.d - L0^2) / (2 L0^2)            Green's strain
        F   = A0 L0 S b                          on its end, -F on its start; S = E w'(eps), second Piola-Kirchhoff
        K   = A0 L0 (C b b' + S 1 / L0^2)        its tangent block; C = E w''(eps)

    Parameters
    ----------
    nodes : (N, d) array
        d = 2 or 3 [length].
    bars : (B, 2) array of int
        The two nodes of each bar.
    modulus, area : float or (B,) array
        E [force / length^2] and A0 [length^2], positive.
    law : "green", "engineering", "logarithmic" or a BarLaw
        w, per unit modulus (contactqp.elements.bar_law).

    Raises
    ------
    InvalidProblem
        Shapes that do not fit, an unknown node, a bar of no length, a modulus or an area that is not positive.

    Notes
    -----
    Course section 2.5, (2.58)-(2.87), with B2 = d'H, not half of it, in the internal force (2.74)-(2.86), and a
    geometric stiffness without the factor 1/2 of (2.87): these are the gradient and the Hessian of the energy. The
    strain is formed from the displacements, so that a body at rest has none and small ones keep their digits.

    Examples
    --------
    >>> bar = NonlinearTruss([[0, 0], [1, 0]], [[0, 1]], modulus=1.0, area=1.0)
    >>> bar.internal_force([0, 0, 0.2, 0.5]).round(15).tolist()
    [-0.414, -0.1725, 0.414, 0.1725]
    """

    nodes: Any
    bars: Any
    modulus: Any
    area: Any
    law: str | BarLaw = "green"

    def __post_init__(self) -> None:
        nodes = real_array("truss nodes", self.nodes)
        if nodes.ndim != 2 or nodes.shape[1] not in (2, 3) or not np.all(np.isfinite(nodes)):
            raise InvalidProblem(f"truss nodes: expected finite numbers of shape (N, 2) or (N, 3), got {nodes.shape}")
        bars = read_whole("truss bars", self.bars)
        if bars.ndim != 2 or bars.shape[1] != 2 or not len(bars):
            raise InvalidProblem(f"truss bars: expected whole numbers of shape (B, 2), got {bars.dtype} {bars.shape}")
        if bars.min() < 0 or bars.max() >= len(nodes):
            raise InvalidProblem(
                f"truss bars: expected nodes from 0 to {len(nodes) - 1}, got {bars.min()}-{bars.max()}"
            )
        if isinstance(self.law, str) and self.law not in LAWS:
            raise InvalidProblem(f"truss law: expected one of {', '.join(LAWS)}, got {self.law!r}")
        object.__setattr__(self, "nodes", read_only(nodes))
        object.__setattr__(self, "bars", read_only(bars))
        for name in ("modulus", "area"):
            object.__setattr__(self, name, read_only(_per_bar(name, getattr(self, name), len(bars))))
        short = np.flatnonzero(self.length == 0)
        if short.size:
            raise InvalidProblem(f"truss bar {short[0]}: its nodes {bars[short[0]].tolist()} are at one place")

    @property
    def dimension(self) -> int:
        """n = N d."""
        return int(self.nodes.size)

    @cached_property
    def length(self) -> Array:
        """L0 of every bar, (B,) [length]."""
        return read_only(np.asarray(np.linalg.norm(self._apart(self.nodes), axis=1)))

    @cached_property
    def bar_law(self) -> BarLaw:
        """w."""
        return LAWS[self.law] if isinstance(self.law, str) else self.law

    def positions(self, displacement: ArrayLike) -> Array:
        """X + u, (N, d) [length]."""
        return np.asarray(self.nodes + self._read(displacement))

    def strain(self, displacement: ArrayLike) -> Array:
        """Green's strain of every bar, (B,): eps = (D.v + v.v / 2) / L0^2, D the bar at rest, v what u adds."""
        D, v = self._apart(self.nodes), self._apart(self._read(displacement))
        return np.asarray(np.sum((D + v / 2) * v, axis=1) / self.length**2)

    def stress(self, displacement: ArrayLike) -> Array:
        """The second Piola-Kirchhoff stress S of every bar, (B,), positive in tension [force / length^2]."""
        return np.asarray(self.modulus * self.bar_law.stress(self._admitted(displacement)))

    def axial_force(self, displacement: ArrayLike) -> Array:
        """N = A0 S L / L0 of every bar, (B,), positive in tension: the true force along the bar now [force]."""
        stretch = np.sqrt(np.maximum(1 + 2 * self.strain(displacement), 0.0))
        return np.asarray(self.area * self.stress(displacement) * stretch)

    def energy(self, displacement: ArrayLike) -> float:
        """Sum of E A0 L0 w(eps); inf where a bar has shrunk to a point and its law cannot bear that."""
        eps = self.strain(displacement)
        if not self.bar_law.length_free and np.any(1 + 2 * eps <= 0):
            return float("inf")
        return float(np.sum(self.modulus * self.area * self.length * self.bar_law.energy(eps)))

    def internal_force(self, displacement: ArrayLike) -> Array:
        """The gradient of the energy, (n,) [force].

        Raises
        ------
        InvalidProblem
            A bar has shrunk to a point and its law cannot bear that.
        """
        return self.summed(
            (self.area * self.stress(displacement) / self.length)[:, None] * self._bars_now(displacement)
        )

    def tangent(self, displacement: ArrayLike) -> Any:
        """The Hessian of the energy, (n, n) CSC, symmetric to the last digit [force / length].

        Raises
        ------
        InvalidProblem
            As `internal_force`.
        """
        eps = self._admitted(displacement)
        modulus = self.modulus * self.bar_law.modulus(eps)
        b = self._bars_now(displacement) / self.length[:, None] ** 2
        volume = self.area * self.length
        axial = (volume * modulus)[:, None, None] * (b[:, :, None] * b[:, None, :])
        geometric = volume * self.modulus * self.bar_law.stress(eps) / self.length**2
        return self.assembled(axial + geometric[:, None, None] * np.eye(self.nodes.shape[1]))

    def summed(self, force: Array) -> Array:
        """Forces (B, d) on the ends of the bars, and against them on their starts, at all unknowns: (n,)."""
        total = np.zeros(self.nodes.shape)
        np.add.at(total, self.bars[:, 1], force)
        np.subtract.at(total, self.bars[:, 0], force)
        return total.ravel()

    def assembled(self, block: Array) -> Any:
        """The (n, n) CSC matrix of the bars' [[k, -k], [-k, k]], k of shape (B, d, d)."""
        d = self.nodes.shape[1]
        places = (d * self.bars[:, :, None] + np.arange(d)).reshape(len(self.bars), 2 * d)
        entries = np.concatenate(
            [np.concatenate([block, -block], axis=2), np.concatenate([-block, block], axis=2)], axis=1
        )
        rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None, :])
        triplets = (entries.ravel(), (rows.ravel(), columns.ravel()))
        K = sp.csc_array(sp.coo_array(triplets, shape=(self.dimension, self.dimension)))
        return sp.csc_array((K + K.T) / 2)  # what meets at a node adds up in another order on the other side

    def _read(self, displacement: ArrayLike) -> Array:
        u = real_array("displacement", displacement)
        if u.shape != (self.dimension,):
            raise InvalidProblem(f"displacement: expected shape ({self.dimension},), got {u.shape}")
        return u.reshape(self.nodes.shape)

    def _apart(self, values: Array) -> Array:
        return np.asarray(values[self.bars[:, 1]] - values[self.bars[:, 0]])

    def _bars_now(self, displacement: ArrayLike) -> Array:
        """x_end - x_start, (B, d)."""
        return self._apart(self.nodes) + self._apart(self._read(displacement))

    def _admitted(self, displacement: ArrayLike) -> Array:
        """Green's strains, none of which the law cannot bear."""
        eps = self.strain(displacement)
        gone = np.flatnonzero(1 + 2 * eps <= 0)
        if gone.size and not self.bar_law.length_free:
            raise InvalidProblem(f"truss bar {gone[0]} has shrunk to a point, which its law {self.law!r} cannot bear")
        return eps


def _per_bar(name: str, value: ArrayLike, count: int) -> Array:
    values = real_array(f"truss {name}", value)
    if values.shape not in ((), (count,)):
        raise InvalidProblem(f"truss {name}: expected one number or shape ({count},), got {values.shape}")
    if not (np.all(np.isfinite(values)) and np.all(values > 0)):
        raise InvalidProblem(f"truss {name}: expected positive numbers, got {values.min()}")
    return np.broadcast_to(values, (count,)).copy()
