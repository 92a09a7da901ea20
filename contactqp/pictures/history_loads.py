"""Load over displacement: of one load, of few loaded unknowns, or of loads that come one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contactqp.model.arrays import Array, Vector
from contactqp.pictures import style
from contactqp.pictures.history_fields import ROUNDING, HistoryFields
from contactqp.pictures.history_panels import ALL, MOST_UNKNOWNS, Curve, Panel, ranked, work_of_unknowns

# Loads that come one by one; more would be curves that nobody could name.
MOST_LOADS = 3


@dataclass(frozen=True, eq=False)
class Part:
    """One of the loads that a load is the sum of: amount (k,) times pattern (n,) [force]."""

    amount: Vector
    pattern: Vector

    @property
    def size(self) -> float:
        """Sum of the sizes of the pattern's forces [force]."""
        return float(np.sum(abs(self.pattern)))


def load_panel(fields: HistoryFields) -> Panel | None:
    """Load over displacement; None where nothing is loaded, or by more loads than can be told apart.

    One load that grows and shrinks: its factor over the displacements of up to four loaded unknowns. Several loads on
    up to four unknowns: the force on each over its displacement. Loads on more unknowns: over their mean displacement
    p'u / sum |p|, p the load; for several loads the force is that of each, sum |p|, so that the area is its work.
    """
    if fields.load is None or not np.any(fields.load):
        return None
    loaded, factor = np.flatnonzero(np.any(fields.load != 0, axis=0)), load_factor(fields)
    if len(loaded) <= MOST_UNKNOWNS:
        return _of_unknowns(fields, ranked(loaded, work_of_unknowns(fields)[loaded]), factor)
    parts = load_parts(fields.load)
    if not parts:
        return None
    x = tuple(fields.displacement @ part.pattern / part.size for part in parts)
    x_label = f"mean displacement along the load [{style.length_unit(fields.problem.units)}]"
    if factor is not None:
        return Panel(_factor_label(fields), (Curve("all loaded", factor, ALL),), x=x, x_label=x_label)
    curves = tuple(Curve(f"load {i + 1}", part.amount * part.size, i) for i, part in enumerate(parts))
    return Panel(f"load [{style.force_unit(fields.problem.units)}]", curves, x=x, x_label=x_label)


def load_factor(fields: HistoryFields) -> Vector | None:
    """(k,) the times where loads are proportional to them, else the load over the largest if it is along it, or None.

    >>> from types import SimpleNamespace
    >>> load_factor(SimpleNamespace(load=np.array([[0.0, 0.0], [2.0, 4.0], [-1.0, -2.0]]), proportional=False)).tolist()
    [0.0, 1.0, -0.5]
    """
    if fields.load is None or fields.proportional:
        return fields.times if fields.load is not None else None
    largest = fields.load[int(np.argmax(np.max(abs(fields.load), axis=1)))]
    factor = np.asarray(fields.load @ largest / (largest @ largest))
    off = np.max(abs(fields.load - np.outer(factor, largest)))
    return factor if off <= ROUNDING * np.max(abs(largest)) else None


def load_parts(load: Array) -> tuple[Part, ...]:
    """The loads (k, n) as a sum of at most three that come one by one, each as it is when it first grows; else none.

    >>> press, push = np.array([0.0, 2.0, 2.0]), np.array([1.0, 0.0, 0.0])
    >>> parts = load_parts(np.array([0 * press, press, press + push, press - push]))
    >>> [[round(float(a), 9) + 0.0 for a in part.amount] for part in parts]
    [[0.0, 1.0, 1.0, 1.0], [0.0, 0.0, 1.0, -1.0]]
    """
    growth, patterns = np.diff(load, axis=0, prepend=0.0), np.zeros((0, load.shape[1]))
    rest, largest = growth, float(np.max(abs(load)))
    while np.any(new := np.max(abs(rest), axis=1) > ROUNDING * largest):
        if len(patterns) == MOST_LOADS:
            return ()
        patterns = np.vstack([patterns, growth[int(np.argmax(new))]])
        basis = np.linalg.qr(patterns.T)[0]
        rest = growth - (growth @ basis) @ basis.T
    amounts = np.cumsum(np.linalg.lstsq(patterns.T, growth.T, rcond=None)[0], axis=1)
    return tuple(Part(amount, pattern) for amount, pattern in zip(amounts, patterns, strict=True))


def _of_unknowns(fields: HistoryFields, unknowns: NDArray[np.int64], factor: Vector | None) -> Panel | None:
    """A curve for each of few loaded unknowns."""
    if fields.load is None or not len(unknowns):
        return None
    problem = fields.problem
    forces = [fields.load[:, j] if factor is None else factor for j in unknowns]
    named = zip(unknowns, forces, strict=True)
    curves = tuple(Curve(problem.dof_name(int(j)), force, i) for i, (j, force) in enumerate(named))
    x = tuple(fields.displacement[:, j] for j in unknowns)
    label = f"load [{style.force_unit(problem.units)}]" if factor is None else _factor_label(fields)
    return Panel(label, curves, x=x, x_label=f"displacement [{style.length_unit(problem.units)}]")


def _factor_label(fields: HistoryFields) -> str:
    return "load factor" if fields.proportional else "load over the largest"
