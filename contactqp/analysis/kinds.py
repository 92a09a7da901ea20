"""Whether a history or a solution is of a motion, told without importing what makes motions.

What is of a class has had its module imported: where it is not there, nothing is of the class.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeGuard

if TYPE_CHECKING:
    from contactqp.analysis.motion.history import MotionHistory, Moving

_HOME = "contactqp.analysis.motion.history"


def is_motion(history: Any) -> TypeGuard[MotionHistory]:
    """Whether it is a MotionHistory."""
    return _HOME in sys.modules and isinstance(history, sys.modules[_HOME].MotionHistory)


def is_moving(solution: Any) -> TypeGuard[Moving]:
    """Whether it is an instant of a motion."""
    return _HOME in sys.modules and isinstance(solution, sys.modules[_HOME].Moving)
