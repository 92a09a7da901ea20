"""pytester runs the scratch projects of the tests of our pytest plugin; BLAS has one thread; Ctrl-C comes through.

Several processes run tests at once, and threads of BLAS that wait for a core cost the others theirs. Said before NumPy
is imported; whoever sets the variable is obeyed. A shell that starts tests in the background has them ignore Ctrl-C,
which some of them press.
"""

import os
import signal
from collections import Counter

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

pytest_plugins = ["pytester"]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of a long list of tests that is `sampled` one in so many runs every time, the others with `-m slow`."""
    seen: Counter[str] = Counter()
    for item in items:
        mark = item.get_closest_marker("sampled")
        if mark is None:
            continue
        name = item.nodeid.partition("[")[0]
        if seen[name] % mark.args[0]:
            item.add_marker("slow")
        seen[name] += 1
