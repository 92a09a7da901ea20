"""Histories of problems with rows that constrain nothing: found without these rows, and shown with all of them."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.analysis.history import Event, History, LazySolutions
from contactqp.analysis.motion.motion_history import MotionHistory, Moving
from contactqp.certificate.idle_rows import ActingRows
from contactqp.errors import NotCertified
from contactqp.model.problem import ContactProblem
from contactqp.model.solution import Solution


def of_all_rows(rows: ActingRows, history: History) -> History:
    """Return a path of the problem without idle rows as a path of the whole problem."""
    solutions = LazySolutions(_Instant(rows, history, k) for k in range(len(history)))
    return History(
        solutions,
        history.times.tolist(),
        lambda: _events(rows, history),
        energies=lambda: history.energies,
        notes=lambda: history.notes,
    )


@dataclass(frozen=True, eq=False)
class _Instant:
    """One solution of a history, extended to all rows on first access."""

    rows: ActingRows
    history: History
    number: int

    def finish(self) -> Solution:
        """Return the solution of the whole problem.

        Raises
        ------
        NotCertified
            As the history; `solution` is that of the whole problem.
        """
        try:
            return _certified_on_all_rows(self.rows, self.history[self.number])
        except NotCertified as error:
            if isinstance(error.solution, Solution):
                error.solution = _certified_on_all_rows(self.rows, error.solution)
            raise


def _certified_on_all_rows(rows: ActingRows, found: Solution) -> Solution:
    """Extend a solution to all rows; the certificate of a motion stays that of its step, which has the acting rows
    alone.
    """
    here = rows.at(found.problem)
    whole: Solution = replace(found, **here.forces(found)) if isinstance(found, Moving) else here.solution(found)
    return whole


def _events(rows: ActingRows, history: History) -> Iterator[Event]:
    return (replace(event, contact=int(rows.contacts[event.contact])) for event in history.events)


class MotionOfAllRows(MotionHistory):
    """A motion that was found without the rows that constrain nothing."""

    def __init__(self, rows: ActingRows, history: MotionHistory) -> None:
        History.__init__(
            self,
            LazySolutions(_Instant(rows, history, k) for k in range(len(history))),
            history.times.tolist(),
            lambda: _events(rows, history),
            energies=lambda: history.energies,
            notes=lambda: history.notes,
        )
        self.motion = history.motion
        self._rows, self._history = rows, history

    def resume(self, duration: float) -> MotionHistory:
        """Continue this motion, as `MotionHistory.resume`."""
        return MotionOfAllRows(self._rows, self._history.resume(duration))

    def __copy__(self) -> MotionHistory:
        return MotionOfAllRows(self._rows, copy.copy(self._history))

    def __getstate__(self) -> dict[str, Any]:
        state = History.__getstate__(self)
        del state["motion"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, motion=state["_history"].motion)

    @property
    def problem(self) -> ContactProblem:
        """Return the problem of the bodies that move with all its rows."""
        return self._rows.whole

    @property
    def normal_forces(self) -> NDArray[np.float64]:
        """Return the normal forces (steps, m) [force], positive in compression."""
        return np.asarray(self._rows.normal(self._history.normal_forces))

    @property
    def friction_forces(self) -> NDArray[np.float64] | None:
        """Return the friction forces (steps, m, d-1) [force], or None without friction."""
        force = self._history.friction_forces
        return None if force is None else np.asarray(self._rows.friction(force))

    @property
    def tie_forces(self) -> NDArray[np.float64]:
        """Return the tie forces (steps, k) [force]."""
        return np.asarray(self._rows.tie(self._history.tie_forces))
