"""How a process died, in words."""

from __future__ import annotations

import re
from collections.abc import Mapping

SIGNALS: Mapping[str, str] = {
    "SIGSEGV": "a segmentation fault",
    "SIGBUS": "a bus error",
    "SIGABRT": "an abort",
    "SIGFPE": "an arithmetic exception",
    "SIGILL": "an illegal instruction",
    "SIGKILL": "being killed, mostly for want of memory",
}
# What Windows calls a segmentation fault.
ACCESS_VIOLATION = 0xC0000005


def died_of(codes: str) -> str:
    """The death of a process in words.

    Parameters
    ----------
    codes : str
        Holds ``SIGSEGV(-11)`` or ``EXIT(3)``, as joblib's processes tell their exit codes.

    Examples
    --------
    >>> died_of("The exit codes of the workers are {SIGSEGV(-11)}")
    'the process died of a segmentation fault (SIGSEGV)'
    >>> died_of("The exit codes of the workers are {EXIT(3)}")
    'the process left with exit code 3'
    """
    found = re.search(r"(SIG\w+|EXIT)\((-?\d+)\)", codes)
    if found is None:
        return f"the process was lost: {codes.partition('.')[0]}"
    name, number = found[1], int(found[2])
    if name == "EXIT":
        fault = number % 2**32 == ACCESS_VIOLATION
        return f"the process died of {SIGNALS['SIGSEGV']}" if fault else f"the process left with exit code {number}"
    return f"the process died of {SIGNALS.get(name, 'a signal')} ({name})"
