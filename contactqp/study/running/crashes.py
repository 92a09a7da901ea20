"""How a process died, in words."""

from __future__ import annotations

import signal
from collections.abc import Mapping

SIGNALS: Mapping[str, str] = {
    "SIGSEGV": "died of a segmentation fault",
    "SIGBUS": "died of a bus error",
    "SIGABRT": "aborted",
    "SIGFPE": "died of an arithmetic exception",
    "SIGILL": "died of an illegal instruction",
    "SIGKILL": "was killed, mostly for want of memory",
}
# What Windows calls a segmentation fault.
ACCESS_VIOLATION = 0xC0000005


def died_of(code: int | None) -> str:
    """The death of a process in words.

    Parameters
    ----------
    code : int, optional
        Its exit code: the negative number of a signal on POSIX.

    Examples
    --------
    >>> died_of(-11)
    'the process died of a segmentation fault (SIGSEGV)'
    >>> died_of(3)
    'the process left with exit code 3'
    """
    if code == ACCESS_VIOLATION:
        return f"the process {SIGNALS['SIGSEGV']}"
    if code is None or code >= 0:
        return f"the process left with exit code {code}"
    name = _name(-code)
    return f"the process {SIGNALS.get(name, 'was ended')} ({name})"


def _name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # a signal without a name, as those for real time
        return f"signal {number}"
