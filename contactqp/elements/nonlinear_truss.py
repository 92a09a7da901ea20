"""Truss bars at any displacement, rotation and strain.

The elastic law of a bar gives energy, second Piola-Kirchhoff stress and modulus against Green's strain.
`NonlinearTruss` is the total Lagrangian form, derived from that energy. `UpdatedTruss` is the same truss in its current
configuration, the updated Lagrangian form with Cauchy stress and Almansi strain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from contactqp.elements.scalars import real_vector
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arguments import checks, read_whole
from contactqp.model.arrays import Array, computes
from contactqp.model.problem_data import ReadOnly, read_array, read_only

# How the area follows the length L: A_n / A_0 for a stretch L / L0.
VOLUMES = ("isochoric", "constant area")


class BarLaw(Protocol):
    """A law w(eps) per unit volume and unit modulus, with S = w' and C = w''; eps = (L^2 - L0^2) / (2 L0^2) is
    Green's strain.

    `length_free` says that the law has no singularity where the bar has shrunk to a point, 1 + 2 eps = 0.
    """

    @property
    def length_free(self) -> bool: ...

    def energy(self, eps: Any) -> Array:
        """Return w [-]."""

    def stress(self, eps: Any) -> Array:
        """Return S = dw/deps [-]."""

    def modulus(self, eps: Any) -> Array:
        """Return C = d2w/deps2 [-]."""


@dataclass(frozen=True)
class GreenLaw:
    """The law of Saint Venant and Kirchhoff: w = eps^2 / 2, S = eps, C = 1 (course section 2.5)."""

    length_free: bool = True

    def energy(self, eps: Any) -> Array:
        """Return the energy density w = eps^2 / 2 [-]."""
        return np.asarray(np.square(eps) / 2)

    def stress(self, eps: Any) -> Array:
        """Return the stress S = eps, as a part of the modulus [-]."""
        return np.asarray(eps, dtype=float)

    def modulus(self, eps: Any) -> Array:
        """Return the tangent modulus C = 1, as a part of the modulus [-]."""
        return np.ones_like(np.asarray(eps, dtype=float))


@dataclass(frozen=True)
class EngineeringLaw:
    """The law that is linear in the elongation: e = L / L0 - 1, w = e^2 / 2; the force is N = E A0 e."""

    length_free: bool = False

    def energy(self, eps: Any) -> Array:
        """Return e^2 / 2."""
        return np.asarray(np.square(_elongation(eps)) / 2)

    def stress(self, eps: Any) -> Array:
        """Return e / (1 + e)."""
        e = _elongation(eps)
        return np.asarray(e / (1 + e))

    def modulus(self, eps: Any) -> Array:
        """Return 1 / (1 + e)^3."""
        return np.asarray(1 / (1 + _elongation(eps)) ** 3)


@dataclass(frozen=True)
class LogarithmicLaw:
    """Hencky's law: h = log(L / L0), w = h^2 / 2; the force is N = E A0 h L0 / L.

    The force is greatest at h = 1: a bar under a greater dead load tears.
    """

    length_free: bool = False

    def energy(self, eps: Any) -> Array:
        """Return h^2 / 2."""
        return np.asarray(np.square(np.log1p(2 * np.asarray(eps)) / 2) / 2)

    def stress(self, eps: Any) -> Array:
        """Return h / (1 + 2 eps)."""
        return np.asarray(np.log1p(2 * np.asarray(eps)) / 2 / (1 + 2 * np.asarray(eps)))

    def modulus(self, eps: Any) -> Array:
        """Return (1 - 2 h) / (1 + 2 eps)^2."""
        square = 1 + 2 * np.asarray(eps)
        return np.asarray((1 - np.log(square)) / square / square)  # squared, a great strain would overflow


@dataclass(frozen=True)
class LawOfEachBar:
    """One law for each of B bars, eps is (B,). It admits bars of zero length only if all of the laws do."""

    laws: tuple[BarLaw, ...]

    @property
    def length_free(self) -> bool:
        return all(law.length_free for law in self.laws)

    def energy(self, eps: Any) -> Array:
        """Return w of each bar."""
        return self._of_each("energy", eps)

    def stress(self, eps: Any) -> Array:
        """Return S of each bar."""
        return self._of_each("stress", eps)

    def modulus(self, eps: Any) -> Array:
        """Return C of each bar."""
        return self._of_each("modulus", eps)

    def _of_each(self, name: str, eps: Any) -> Array:
        strains, values = np.asarray(eps, dtype=float), np.empty(len(self.laws))
        for law, bars in self._groups():
            values[bars] = getattr(law, name)(strains[bars])
        return values

    def _groups(self) -> Iterator[tuple[BarLaw, list[int]]]:
        """Return the distinct laws, each with the bars that follow it."""
        for law in dict.fromkeys(self.laws):
            yield law, [i for i, other in enumerate(self.laws) if other == law]


LAWS: dict[str, BarLaw] = {"green": GreenLaw(), "engineering": EngineeringLaw(), "logarithmic": LogarithmicLaw()}


def _elongation(eps: Any) -> Array:
    """Return e = sqrt(1 + 2 eps) - 1, without the cancellation."""
    eps = np.asarray(eps, dtype=float)
    return np.asarray(2 * eps / (1 + np.sqrt(1 + 2 * eps)))


@checks
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
        w, per unit modulus (contactqp.elements.nonlinear_truss).

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
        nodes = read_array("truss nodes", self.nodes)
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
            raise InvalidProblem(f"truss law: expected one of {', '.join(LAWS)}, got {shown(self.law)}")
        object.__setattr__(self, "nodes", read_only(nodes))
        object.__setattr__(self, "bars", read_only(bars))
        for name in ("modulus", "area"):
            object.__setattr__(self, name, read_only(_per_bar(name, getattr(self, name), len(bars))))
        short = np.flatnonzero(self.length == 0)
        if short.size:
            raise InvalidProblem(f"truss bar {short[0]}: its nodes {bars[short[0]].tolist()} are at one place")

    @property
    def dimension(self) -> int:
        """Return the number of unknowns, n = N d for N nodes."""
        return int(self.nodes.size)

    @cached_property
    def length(self) -> Array:
        """Return the length L0 at rest of every bar, (B,) [length]."""
        return read_only(np.asarray(np.linalg.norm(self._apart(self.nodes), axis=1)))

    @cached_property
    def bar_law(self) -> BarLaw:
        """Return the energy density w of the bars, with its two derivatives."""
        return LAWS[self.law] if isinstance(self.law, str) else self.law

    def positions(self, displacement: ArrayLike) -> Array:
        """Return the current positions X + u of the nodes, (N, d) [length]."""
        return np.asarray(self.nodes + self._read(displacement))

    def strain(self, displacement: ArrayLike) -> Array:
        """Return Green's strain of every bar, (B,): eps = (D.v + v.v / 2) / L0^2, D the bar at rest, v what u adds."""
        D, v = self._apart(self.nodes), self._apart(self._read(displacement))
        return np.asarray(np.sum((D + v / 2) * v, axis=1) / self.length**2)

    def stress(self, displacement: ArrayLike) -> Array:
        """Return the second Piola-Kirchhoff stress S of every bar, (B,), positive in tension [force / length^2]."""
        return np.asarray(self.modulus * self.bar_law.stress(self._admitted(displacement)))

    def axial_force(self, displacement: ArrayLike) -> Array:
        """Return N = A0 S L / L0 of every bar, (B,), positive in tension: the true force along the current bar
        [force].
        """
        stretch = np.sqrt(np.maximum(1 + 2 * self.strain(displacement), 0.0))
        return np.asarray(self.area * self.stress(displacement) * stretch)

    def energy(self, displacement: ArrayLike) -> float:
        """Return the sum of E A0 L0 w(eps); inf where a bar has zero length and its law is singular there."""
        eps = self.strain(displacement)
        if not self.bar_law.length_free and np.any(1 + 2 * eps <= 0):
            return float("inf")
        return float(np.sum(self.modulus * self.area * self.length * self.bar_law.energy(eps)))

    def internal_force(self, displacement: ArrayLike) -> Array:
        """Return the gradient of the energy, (n,) [force].

        Raises
        ------
        InvalidProblem
            A bar has zero length and its law is singular there.
        """
        return self.summed(
            (self.area * self.stress(displacement) / self.length)[:, None] * self._bars_now(displacement)
        )

    def tangent(self, displacement: ArrayLike) -> Any:
        """Return the Hessian of the energy, (n, n) CSC, symmetric to the last digit [force / length].

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
        """Sum forces (B, d) on the ends of the bars, and against them on their starts, at all unknowns: (n,)."""
        total = np.zeros(self.nodes.shape)
        np.add.at(total, self.bars[:, 1], force)
        np.subtract.at(total, self.bars[:, 0], force)
        return total.ravel()

    def assembled(self, block: Array) -> Any:
        """Return the (n, n) CSC matrix of the bars' [[k, -k], [-k, k]], k of shape (B, d, d)."""
        d = self.nodes.shape[1]
        places = (d * self.bars[:, :, None] + np.arange(d)).reshape(len(self.bars), 2 * d)
        entries = np.concatenate(
            [np.concatenate([block, -block], axis=2), np.concatenate([-block, block], axis=2)], axis=1
        )
        rows, columns = np.broadcast_arrays(places[:, :, None], places[:, None, :])
        triplets = (entries.ravel(), (rows.ravel(), columns.ravel()))
        K = sp.csc_array(sp.coo_array(triplets, shape=(self.dimension, self.dimension)))
        return sp.csc_array((K + K.T) / 2)  # sums at a node are formed in another order on the other side

    def _read(self, displacement: ArrayLike) -> Array:
        u = real_vector("displacement", displacement, self.dimension)
        return u.reshape(self.nodes.shape)

    def _apart(self, values: Array) -> Array:
        return np.asarray(values[self.bars[:, 1]] - values[self.bars[:, 0]])

    def _bars_now(self, displacement: ArrayLike) -> Array:
        """Return x_end - x_start, (B, d) [length]."""
        return self._apart(self.nodes) + self._apart(self._read(displacement))

    def _admitted(self, displacement: ArrayLike) -> Array:
        """Return Green's strains, or raise InvalidProblem for those outside the range of the law."""
        eps = self.strain(displacement)
        gone = np.flatnonzero(1 + 2 * eps <= 0)
        if gone.size and not self.bar_law.length_free:
            raise InvalidProblem(f"truss bar {gone[0]} has shrunk to a point, which its law {self.law!r} cannot bear")
        return eps


def _per_bar(name: str, value: ArrayLike, count: int) -> Array:
    values = read_array(f"truss {name}", value)
    if values.shape not in ((), (count,)):
        raise InvalidProblem(f"truss {name}: expected one number or shape ({count},), got {values.shape}")
    if not (np.all(np.isfinite(values)) and np.all(values > 0)):
        raise InvalidProblem(f"truss {name}: expected positive numbers, got {values.min()}")
    return np.broadcast_to(values, (count,)).copy()


@checks
@computes
@dataclass(frozen=True, eq=False)
class UpdatedTruss:
    """The bars of a truss in their current configuration, with the same forces and tangents as in its total
    Lagrangian form.

    With the length L and the unit direction n of a bar now, and its area A_n,

        eps_A = (L^2 - L0^2) / (2 L^2)                  Almansi's strain
        E*    = C (A0 / A_n) (L / L0)^3                 the modulus of the law, pushed forward
        sigma = (A0 / A_n) (L / L0) S                   Cauchy's stress; E* eps_A where S = E eps (the law "green")
        F     = A_n sigma n                             on its end, -F on its start
        K     = (A_n / L) (E* n n' + sigma 1)

    where S and C are those of the law of the truss. (K is often written with 1 - n n' in place of 1; the modulus beside
    it is then E* + sigma.)

    Parameters
    ----------
    truss : NonlinearTruss
    volume : "isochoric" or "constant area"
        A_n = A0 L0 / L or A0. Stresses differ, forces and tangents do not, as the law refers to the reference
        configuration.

    Raises
    ------
    InvalidProblem
        Another volume law; on use, a bar of zero length.

    Notes
    -----
    Course section 2.5, (2.88)-(2.93), with sigma, not sigma_G, in (2.90), no factor 1/2 in the geometric part of
    (2.92), and E replaced by E*. With E itself (2.92) is the tangent of another law: that of sigma = E eps_Green where
    the volume is kept, or of the engineering strain where the area is.
    """

    truss: NonlinearTruss
    volume: str = "isochoric"

    def __post_init__(self) -> None:
        if self.volume not in VOLUMES:
            raise InvalidProblem(f"volume: expected one of {', '.join(VOLUMES)}, got {shown(self.volume)}")

    @property
    def dimension(self) -> int:
        """Return the number of unknowns, n = N d for N nodes."""
        return self.truss.dimension

    def length(self, displacement: ArrayLike) -> Array:
        """Return the current length L of every bar, (B,) [length]."""
        return np.asarray(np.linalg.norm(self._apart(displacement), axis=1))

    def area(self, displacement: ArrayLike) -> Array:
        """Return the current cross-section A_n of every bar, (B,) [length^2]."""
        area = np.asarray(self.truss.area)
        return area if self.volume == "constant area" else area * self.truss.length / self._length(displacement)

    def almansi_strain(self, displacement: ArrayLike) -> Array:
        """Return (L^2 - L0^2) / (2 L^2) of every bar, (B,)."""
        L, L0 = self._length(displacement), self.truss.length
        return (L - L0) * (L + L0) / (2 * L**2)

    def cauchy_stress(self, displacement: ArrayLike) -> Array:
        """Return the Cauchy stress sigma of every bar, (B,), positive in tension [force / length^2]."""
        L, truss = self._length(displacement), self.truss
        stress = truss.modulus * truss.bar_law.stress(self._green(displacement))
        return np.asarray(truss.area / self.area(displacement) * L / truss.length * stress)

    def current_modulus(self, displacement: ArrayLike) -> Array:
        """Return E* = E w'' (A0 / A_n) (L / L0)^3, the modulus of every bar pushed forward, (B,) [force / length^2]."""
        L, truss = self._length(displacement), self.truss
        modulus = truss.modulus * truss.bar_law.modulus(self._green(displacement))
        return np.asarray(modulus * truss.area / self.area(displacement) * (L / truss.length) ** 3)

    def energy(self, displacement: ArrayLike) -> float:
        """Return the strain energy, the sum of the bars' A_n L w / J, w / J being the energy of a unit of the current
        volume [force * length]; inf where a bar has no length.
        """
        if np.any(self.length(displacement) == 0):
            return float("inf")
        truss = self.truss
        density = truss.modulus * truss.bar_law.energy(self._green(displacement))
        volume = self.area(displacement) * self._length(displacement)
        grown = volume / (truss.area * truss.length)
        return float(np.sum(volume * density / grown))

    def internal_force(self, displacement: ArrayLike) -> Array:
        """Return the bars' forces A_n sigma along their current directions, summed at all unknowns: (n,) [force]."""
        direction = self._apart(displacement) / self._length(displacement)[:, None]
        force = self.area(displacement) * self.cauchy_stress(displacement)
        return self.truss.summed(force[:, None] * direction)

    def tangent(self, displacement: ArrayLike) -> Any:
        """Return the derivative of `internal_force`: (n, n) CSC [force / length]."""
        L = self._length(displacement)
        n = self._apart(displacement) / L[:, None]
        per_length = (self.area(displacement) / L)[:, None, None]
        axial = self.current_modulus(displacement)[:, None, None] * (n[:, :, None] * n[:, None, :])
        along = self.cauchy_stress(displacement)[:, None, None] * np.eye(n.shape[1])
        return self.truss.assembled(per_length * (axial + along))

    def _apart(self, displacement: ArrayLike) -> Array:
        x = self.truss.positions(displacement)
        return np.asarray(x[self.truss.bars[:, 1]] - x[self.truss.bars[:, 0]])

    def _length(self, displacement: ArrayLike) -> Array:
        L = self.length(displacement)
        gone = np.flatnonzero(L == 0)
        if gone.size:
            raise InvalidProblem(f"truss bar {gone[0]} has shrunk to a point: it has no direction")
        return L

    def _green(self, displacement: ArrayLike) -> Array:
        """Return Green's strain from Almansi's: eps_A / (1 - 2 eps_A)."""
        eps = self.almansi_strain(displacement)
        return eps / (1 - 2 * eps)
