"""What rounding can make of a force or a length that should be zero, in textbook systems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from contactqp.linalg.row_sizes import row_sizes
from contactqp.model.arrays import Mask, Vector
from contactqp.model.problem import ContactProblem, Matrix
from contactqp.solving.methods.floating_bodies import FloatingBodies
from contactqp.solving.methods.textbook_algebra import TEXTBOOK_ROUNDING

# Rows (r, n), their limits (r,), and a mask of those that are equations, E_i u = g_i.
Hold = tuple[Any, Vector, Mask]


@dataclass(frozen=True, eq=False)
class Sizes:
    """Absolute values of the problem's matrices."""

    problem: ContactProblem
    bodies: FloatingBodies
    stiffness: Matrix

    @classmethod
    def of(cls, problem: ContactProblem, bodies: FloatingBodies) -> Sizes:
        return cls(problem, bodies, abs(problem.stiffness))

    def forces(self, displacement: Vector, pushes: tuple[tuple[Any, Vector], ...]) -> Vector:
        """F_j, the size of the forces that meet at unknown j (n,) [force].

        Parameters
        ----------
        displacement : (n,)
        pushes : pairs of rows (r, n) and forces (r,)
        """
        meeting = self.stiffness @ np.abs(displacement) + self.problem.load_size
        for rows, force in pushes:
            meeting = meeting + row_sizes(self.problem, rows).transposed @ np.abs(force)
        return np.asarray(meeting)

    def noise(self, displacement: Vector, forces: Vector, holds: tuple[Hold, ...]) -> Noise:
        """What rounding makes of forces and lengths at this displacement (n,) where forces (n,) meet.

        The rounding of F_k moves unknown k by 16 eps F_k / K_kk, and its neighbours j feel |K_jk| times that. Rows that
        `holds` say are equations move their unknowns as well.
        """
        diagonal = self.stiffness.diagonal()
        softness = 1.0 / np.where(diagonal > 0, diagonal, np.inf)
        shaken = 16 * np.finfo(float).eps * (self.stiffness @ (softness * forces))
        moved = softness * shaken
        for rows, limits, held in holds:
            moved = moved + self._moved_by(rows, limits, held, displacement)
        return Noise(np.abs(displacement), forces, shaken, moved, self.bodies)

    def _moved_by(self, rows: Any, limits: Vector, held: Mask, displacement: Vector) -> Vector:
        """(n,) what rounding of E_i u = g_i moves: 16 eps (|E_i||u| + |g_i|) D_j^2 |E_ij| / |E_i D|^2 at unknown j.

        That is the least motion, in unknowns where the stiffness has a unit diagonal, which makes up for it. An unknown
        that should be zero may have no other size than this, where neither force nor stiffness is.
        """
        size = row_sizes(self.problem, rows).size
        softness = self.bodies.scale**2
        compliance = size.power(2) @ softness
        lengths = np.where(held, size @ np.abs(displacement) + np.abs(limits), 0.0)
        pulled = size.T @ (lengths / np.where(compliance > 0, compliance, 1.0))
        return np.asarray(16 * np.finfo(float).eps * softness * pulled)


@dataclass(frozen=True, eq=False)
class Noise:
    """Rounding at one displacement."""

    size: Vector  # (n,) |u|
    forces: Vector  # (n,) F
    shaken: Vector  # (n,) of a force that should be zero
    moved: Vector  # (n,) of a displacement that should be zero
    bodies: FloatingBodies

    def of_forces(self, rows: Any) -> Vector:
        """(r,) of the forces of rows: a force is noise when it is at one of its unknowns j, min over j of the noise
        there / |E_ij|; an empty row has none."""
        entries = abs(rows).tocoo()
        noise = np.full(rows.shape[0], np.inf)
        np.minimum.at(noise, entries.row, (TEXTBOOK_ROUNDING * self.forces + self.shaken)[entries.col] / entries.data)
        return np.where(np.isfinite(noise), noise, 0.0) + self.bodies.carried(rows, self.forces)

    def of_lengths(self, rows: Any, limits: Vector) -> Vector:
        """(r,) of E u - g for rows and their limits."""
        size = abs(rows)
        return np.asarray(TEXTBOOK_ROUNDING * (size @ self.size + np.abs(limits)) + size @ self.moved)
