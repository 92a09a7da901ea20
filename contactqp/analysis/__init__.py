"""Analyse load paths, large deformations and motions; this module only recognises motions without importing their
modules.

If the module of a class is not imported, no object of the class exists.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeGuard

if TYPE_CHECKING:
    from contactqp.analysis.motion.motion_history import MotionHistory, Moving

_HOME = "contactqp.analysis.motion.motion_history"


def is_motion(history: Any) -> TypeGuard[MotionHistory]:
    """Return whether a history is a MotionHistory."""
    return _HOME in sys.modules and isinstance(history, sys.modules[_HOME].MotionHistory)


def is_moving(solution: Any) -> TypeGuard[Moving]:
    """Return whether a solution is an instant of a motion."""
    return _HOME in sys.modules and isinstance(solution, sys.modules[_HOME].Moving)
