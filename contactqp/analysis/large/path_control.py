"""Arc length and displacement control: a path stepped along, with the history so far if it breaks off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from contactqp.analysis.large.deformation import LargeHistory, LargeSolution
from contactqp.analysis.large.load_control import LoadControl, Program
from contactqp.analysis.large.loaded_body import LoadedBody
from contactqp.analysis.large.newton_step import NewtonSettings
from contactqp.analysis.large.path_equations import PathEquations
from contactqp.analysis.large.path_following import ByArc, ByUnknown, Pace, PathFollower
from contactqp.errors import NotConverged
from contactqp.model.arrays import Vector

# An unknown has reached its value when this part of its whole way is left.
REACHED = 1e-13


@dataclass(frozen=True, eq=False)
class PathControl:
    """A body, its one load and the settings of Newton's method."""

    loaded: LoadedBody
    program: Program
    settings: NewtonSettings

    def follow_arc(self, start: Vector | LargeSolution, steps: int, radius: float | None) -> LargeHistory:
        """So many steps of one arc length; by default a step is as long as a `steps`-th of the load takes at the start.

        Raises
        ------
        NotConverged
            With the history so far.
        """
        follower = self._follower(self._at_rest(start), None)
        pace = ByArc(float(np.sqrt(2) * follower.path.scale / steps) if radius is None else radius)
        for _ in range(steps):
            _advance(follower, pace)
        return follower.history

    def follow_unknown(self, start: Vector | LargeSolution, steps: int, place: int, wanted: float) -> LargeHistory:
        """So many equal steps of one unknown to a value.

        Raises
        ------
        NotConverged
            With the history so far.
        """
        at_rest = self._at_rest(start)
        first = float(at_rest.displacement[place])
        if wanted == first:
            return LargeHistory([at_rest])
        follower = self._follower(at_rest, ByUnknown(place, wanted - first))
        for k in range(1, steps + 1):
            value = wanted if k == steps else first + (wanted - first) * k / steps
            while abs(left := value - follower.reached.displacement[place]) > REACHED * abs(wanted - first):
                _advance(follower, ByUnknown(place, left))
        return follower.history

    def _at_rest(self, start: Vector | LargeSolution) -> LargeSolution:
        if isinstance(start, LargeSolution):
            return start
        try:
            return LoadControl(self.loaded, self.program, self.settings).first(start)
        except NotConverged as error:
            raise NotConverged(f"large_deformation: at load factor 0: {error}", LargeHistory([])) from error

    def _follower(self, start: LargeSolution, towards: ByUnknown | None) -> PathFollower:
        first, last = self.program.tie_values
        scale = start.load_scale or 1.0
        path = PathEquations(self.loaded, self.program.loads[1], first, last - first, self.settings, scale)
        try:
            return PathFollower(path, start, towards)
        except NotConverged as error:
            message = f"large_deformation: at load factor {start.load_factor:.6g}: {error}"
            raise NotConverged(message, LargeHistory([start]), start) from error


def _advance(follower: PathFollower, pace: Pace) -> None:
    try:
        follower.advance(pace)
    except NotConverged as error:
        last = follower.solutions[-1]
        message = f"large_deformation: after load factor {last.load_factor:.6g}: {error}"
        raise NotConverged(message, follower.history, last) from error
