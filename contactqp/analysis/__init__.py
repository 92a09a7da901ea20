"""Analyses of paths, large deformations and motions; here only how to tell a motion without importing its modules.

An object of a class has had the module of the class imported: where that is not there, nothing is of the class.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeGuard

if TYPE_CHECKING:
    from contactqp.analysis.motion.motion_history import MotionHistory, Moving

_HOME = "contactqp.analysis.motion.motion_history"


def is_motion(history: Any) -> TypeGuard[MotionHistory]:
    """Say whether a history is a MotionHistory."""
    return _HOME in sys.modules and isinstance(history, sys.modules[_HOME].MotionHistory)


def is_moving(solution: Any) -> TypeGuard[Moving]:
    """Say whether a solution is an instant of a motion."""
    return _HOME in sys.modules and isinstance(solution, sys.modules[_HOME].Moving)
