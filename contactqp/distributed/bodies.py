"""Bodies over the ranks: what their parts on several ranks come to is found on one of them, the body's home."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactqp.distributed.problem import Numbers
from contactqp.distributed.ranks import Ranks


class Bodies:
    """Which bodies have unknowns here, and which are at home here. Making it is collective, and so are its methods.

    Attributes
    ----------
    number : (q,) array of int
        The bodies with unknowns on this rank.
    of : (n_here,) array of int
        The place in `number` of each unknown's body.
    count : int
        How many bodies are at home on this rank.
    """

    def __init__(self, ranks: Ranks, body: Numbers) -> None:
        self._ranks = ranks
        self.number, self.of = np.unique(body, return_inverse=True)
        self._order = np.argsort(self.of, kind="stable")
        self._first = np.searchsorted(self.of[self._order], np.arange(len(self.number) + 1))
        self._home = self.number % ranks.size
        here = np.full(len(self.number), ranks.rank)
        came, self._from = ranks.exchanged(self._home, self.number, here)
        at_home, self._place = np.unique(came, return_inverse=True)
        self.count = len(at_home)

    def members(self, place: int) -> NDArray[np.intp]:
        """The unknowns here of the body at this place in `number`."""
        return self._order[self._first[place] : self._first[place + 1]]

    def combined(self, columns: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Columns (n_here, r) times the weights (q, r, p) of each body, (n_here, p)."""
        out = np.zeros((len(columns), weights.shape[2]))
        for place in np.flatnonzero(np.any(weights, axis=(1, 2))):
            here = self.members(int(place))
            out[here] = columns[here] @ weights[place]
        return out

    def totals(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(count, r) the sums over all unknowns (n_here, r) of each body at home here."""
        here = [np.bincount(self.of, column, len(self.number)) for column in values.T]
        return self.sums(np.column_stack(here))

    def parts(self, values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.intp]]:
        """The rows of values (q, ...) of the bodies at home here, and the place (0 to `count`) of each one's body."""
        (came,) = self._ranks.exchanged(self._home, values)
        return came, self._place

    def sums(self, values: NDArray[Any]) -> NDArray[Any]:
        """(count, ...) the sums of values (q, ...), body by body, at home."""
        return self._reduced(np.add, values)

    def largest(self, values: NDArray[Any]) -> NDArray[Any]:
        """(count, ...) the largest of values (q, ...) that are not negative, body by body, at home."""
        return self._reduced(np.maximum, values)

    def told(self, values: NDArray[Any]) -> NDArray[Any]:
        """(q, ...) the values (count, ...) that the homes have for the bodies on this rank."""
        (came,) = self._ranks.exchanged(self._from, values[self._place])
        found = np.empty_like(came)
        found[np.argsort(self._home, kind="stable")] = came
        return found

    def _reduced(self, operation: Any, values: NDArray[Any]) -> NDArray[Any]:
        came, place = self.parts(values)
        total = np.zeros((self.count, *values.shape[1:]))
        operation.at(total, place, came)
        return total
