"""The certificate of many steps of a motion at once, by the figures of the certificate.

All steps of a scheme share stiffness and rows: the figures of a block of them are those of
`contactqp.certificate.figures`, formed by products with a whole block. Residuals are in double precision: each entry
is exact to a few dozen roundings of the sizes that meet there, far below any tolerance that passes. The problems are
judged as the scheme states them, whatever found their results.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from contactqp.analysis.motion.step_contact import StepProblem, StepResult
from contactqp.linalg.measures import HELD_BY_DOUBLES, beyond, ratio, reciprocal, row_sizes
from contactqp.model.arrays import Vector
from contactqp.model.coulomb import directions, lengths
from contactqp.model.problem import ContactProblem

FIGURES = ("equilibrium", "penetration", "tension", "complementarity", "cone", "slip_direction", "tie")

# Forces and lengths that are this part of the intrinsic size are nothing, as for `certify` by default.
NOTHING = 1e-12

Block = NDArray[np.float64]  # one row a step


@dataclass(frozen=True, eq=False)
class StepFigures:
    """The worst figures of each step of a block, (steps,) each; see `contactqp.certificate.certificate`."""

    equilibrium: Block
    penetration: Block
    tension: Block
    complementarity: Block
    cone: Block
    slip_direction: Block
    tie: Block

    def first_above(self, tolerance: float) -> tuple[int, str, float] | None:
        """Return the first step with a figure above a tolerance, its worst figure and the size of that; NaN counts
        as infinite.
        """
        values = np.array([getattr(self, name) for name in FIGURES])
        values = np.where(np.isnan(values), np.inf, values)
        beyond = np.flatnonzero(np.any(values > tolerance, axis=0))
        if not len(beyond):
            return None
        step = int(beyond[0])
        worst = int(np.argmax(values[:, step]))
        return step, FIGURES[worst], float(values[worst, step])


class StepJudge:
    """The data of a template that the figures need."""

    def __init__(self, template: ContactProblem) -> None:
        self._problem = template
        self._K, self._N, self._A = template.stiffness_rows, template.normal, template.tie
        self._T = template.tangent if template.frictional else None
        self._sizes = tuple(abs(matrix) for matrix in (self._K, self._N, self._A))
        self._pushing, self._pushing_size = (sp.csr_matrix(rows.T) for rows in (self._N, self._sizes[1]))
        self._unit = np.sqrt(template.diagonal)
        self._compliance = {name: np.sqrt(row_sizes(template, rows).compliance) for name, rows in self._rows().items()}
        self._entries = sp.coo_matrix(abs(self._N))

    def _rows(self) -> dict[str, Any]:
        return {"normal": self._N, "tie": self._A} | ({} if self._T is None else {"tangent": self._T})

    def refused(
        self, posed: list[StepProblem], answered: list[StepResult], tolerance: float
    ) -> tuple[int, str, float] | None:
        """Return the first step of a block that is refused, its worst figure and the size of that, or None."""
        if self._plainly_right(posed, answered, tolerance):
            return None
        return self.figures(posed, answered).first_above(tolerance)

    def _plainly_right(self, posed: list[StepProblem], answered: list[StepResult], tolerance: float) -> bool:
        """Say whether steps without friction or ties are right by less than all of what meets there.

        Residuals within tolerance of K_jj |x_j| + |E_N|'l_N, gaps within that of |E_N||x| + |g|: the figures are then
        no larger. Step by step, while a step's vectors are in the cache.
        """
        if self._problem.ties or self._T is not None:
            return False
        within = tolerance * self._problem.diagonal
        for p, a in zip(posed, answered, strict=True):
            residual, size = p.load - self._K @ a.increment, np.abs(a.unknown)
            pushes = bool(a.normal.any())
            if (pushes or p.closable is None or p.closable.any()) and not self._contacts_hold(p, a, size, tolerance):
                return False
            size *= within
            if pushes:
                residual -= self._pushing @ a.normal
                size += self._pushing_size @ (tolerance * a.normal)
            np.abs(residual, out=residual)
            if not (residual <= size).all():
                return False
        return True

    def _contacts_hold(self, p: StepProblem, a: StepResult, size: Vector, tolerance: float) -> bool:
        """Say whether no contact is in tension, and gaps are open, or closed where forces are, up to their lengths."""
        room, pushes = p.gap - self._N @ a.unknown, a.normal > 0
        seen = np.ones(len(room), dtype=bool) if p.closable is None else p.closable
        if (a.normal < 0).any() or (pushes & ~seen).any():
            return False
        wrong = (seen & (room < 0)) | (pushes & (room > 0))
        if not wrong.any():
            return True
        return not (wrong & (abs(room) > tolerance * (self._sizes[1] @ size + abs(p.gap)))).any()

    def figures(self, posed: list[StepProblem], answered: list[StepResult]) -> StepFigures:
        """Return the figures of a block of steps."""
        problem = self._problem
        x, (load, F) = np.column_stack([a.unknown for a in answered]), self._loads(posed)
        normal, tie = np.column_stack([a.normal for a in answered]), np.column_stack([a.tie for a in answered])
        friction, gap = np.column_stack([a.friction for a in answered]), np.column_stack([p.gap for p in posed])
        looked = np.column_stack([np.ones(len(p.gap), bool) if p.closable is None else p.closable for p in posed])
        size = abs(x)
        inner = self._sizes[0] @ size
        residual, F = load - self._K @ x, F + inner
        _, N, A = self._sizes
        if np.any(normal):
            residual, F = residual - self._N.T @ normal, F + N.T @ abs(normal)
        if problem.ties:
            residual, F = residual - self._A.T @ tie, F + A.T @ abs(tie)
        if self._T is not None:
            residual, F = residual - self._T.T @ friction, F + abs(self._T).T @ abs(friction)
        whole = self._intrinsic_size(load, x)
        none = np.maximum(NOTHING * whole * self._unit[:, None], HELD_BY_DOUBLES * inner)
        room, length = gap - self._N @ x, N @ size + abs(gap)
        room_measure = ratio(beyond(abs(room), self._no_length("normal", length, whole)), length)
        push, held = self._forces(normal, F, none), np.zeros_like(tie)
        if problem.ties:
            value = np.array([np.zeros(problem.ties) if p.tie_value is None else p.tie_value for p in posed]).T
            sizes = A @ size + abs(value)
            held = ratio(beyond(abs(self._A @ x - value), self._no_length("tie", sizes, whole)), sizes)
        cone, direction = self._coulomb(posed, x, normal, friction, F, whole)
        stray = ~looked & (normal != 0)  # a force where the step had no contact
        return StepFigures(
            _worst(ratio(beyond(abs(residual), none), F)),
            _worst(np.where(looked & (room < 0), room_measure, 0.0)),
            _worst(np.where((normal < 0) | stray, push, 0.0)),
            _worst(np.where(looked & (room > 0) & (normal > 0), np.minimum(room_measure, push), 0.0)),
            cone,
            direction,
            _worst(held),
        )

    def _loads(self, posed: list[StepProblem]) -> tuple[Block, Block]:
        """Return f and its size, (n, steps) each: where there are bases, the load is K base and what acts on x -
        base.
        """
        load = np.column_stack([p.load for p in posed])
        bases = [p.base for p in posed if p.base is not None]
        if not bases:
            return load, abs(load)
        base = np.column_stack(bases)
        return load + self._K @ base, abs(load) + self._sizes[0] @ abs(base)

    def _intrinsic_size(self, load: Block, x: Block) -> Vector:
        """Return the size of each step, (steps,), as `contactqp.linalg.measures.intrinsic_size` does.

        It is that of the loads and of |x|_K, inertia included.
        """
        D = reciprocal(self._unit)
        strain = np.sqrt(np.maximum(np.sum(x * (self._K @ x), axis=0), 0.0))
        return np.asarray(np.maximum(strain, np.max(D[:, None] * abs(load), axis=0, initial=0.0)))

    def _no_length(self, name: str, length: Block, whole: Vector) -> Block:
        """Return the lengths of rows below which they count as none, beside those that meet there."""
        return np.maximum(NOTHING * whole * self._compliance[name][:, None], HELD_BY_DOUBLES * length)

    def _forces(self, force: Block, F: Block, none: Block) -> Block:
        """Return max_j |E_ij l_i| / F_j, (m, steps), where negligible forces count as none."""
        measure = np.zeros_like(force)
        acting = np.any(force != 0, axis=1)[self._entries.row]
        row, column, size = self._entries.row[acting], self._entries.col[acting], self._entries.data[acting]
        np.maximum.at(measure, row, ratio(beyond(size[:, None] * abs(force[row]), none[column]), F[column]))
        return measure

    def _coulomb(
        self, posed: list[StepProblem], x: Block, normal: Block, friction: Block, F: Block, whole: Vector
    ) -> tuple[Block, Block]:
        """Return |l_T| beyond the cone and away from the slip, over the forces that meet, and the slip over its
        lengths.
        """
        steps, m = x.shape[1], len(normal)
        if self._T is None or not len(friction):
            return np.zeros(steps), np.zeros(steps)
        problem, width = self._problem, len(friction) // m
        origin = np.array([np.zeros(len(friction)) if p.slip_origin is None else p.slip_origin for p in posed]).T

        def by_contact(rows: Block) -> Block:
            """(m steps, d-1) from (m (d-1), steps)."""
            return np.moveaxis(rows.reshape(m, width, steps), 1, 2).reshape(-1, width)

        slip, force = by_contact(self._T @ x - origin), by_contact(friction)
        along = abs(self._T) @ abs(x) + abs(origin)
        size, least = lengths(by_contact(along)), lengths(by_contact(self._no_length("tangent", along, whole)))
        slip = np.where((beyond(lengths(slip), least) == 0)[:, None], 0.0, slip)
        bound = (problem.friction[:, None] * np.maximum(normal, 0.0)).ravel()  # type: ignore[index]
        excess = np.maximum(lengths(force) - bound, 0.0)
        wrong = lengths(force - bound[:, None] * directions(slip))
        meeting = self._meeting_at_tangents(F).ravel()
        slip_measure = ratio(lengths(slip), size)
        cone, direction = ratio(excess, meeting), np.minimum(slip_measure, ratio(wrong, meeting))
        return _worst(cone.reshape(m, steps)), _worst(direction.reshape(m, steps))

    def _meeting_at_tangents(self, F: Block) -> Block:
        """Return the least F_j / |E_T|_ij, |E_T|_ij the length of column j, over the unknowns that the rows of a
        contact touch, (m, steps).
        """
        assert self._T is not None
        squares = sp.coo_matrix(self._T.multiply(self._T))
        width = self._T.shape[0] // self._N.shape[0]
        # |E_T'v|_j is at most |v| times the length of column j of the contact's rows.
        shape = (self._N.shape[0], self._T.shape[1])
        columns = sp.coo_matrix(sp.csr_matrix((squares.data, (squares.row // width, squares.col)), shape=shape))
        least = np.full((self._N.shape[0], F.shape[1]), np.inf)
        np.minimum.at(least, columns.row, F[columns.col] / np.sqrt(columns.data)[:, None])
        return least


def _worst(values: Block) -> Block:
    """Return the worst figure of each step, NaN included."""
    return np.asarray(np.max(values, axis=0, initial=0.0))
