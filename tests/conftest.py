"""pytester runs the scratch projects of the tests of our pytest plugin; BLAS has one thread; Ctrl-C comes through.

Several processes run tests at once, and threads of BLAS that wait for a core cost the others theirs. Said before NumPy
is imported; whoever sets the variable is obeyed. A shell that starts tests in the background has them ignore Ctrl-C,
which some of them press.
"""

import gc
import os
import signal
import sys
from collections import Counter
from collections.abc import Generator
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest

from tests.clocks import Clock

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# pytest-xdist hands the width of its terminal on: what is printed into a pipe would follow it.
os.environ.pop("COLUMNS", None)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

pytest_plugins = ["pytester"]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Put a clock that a test can advance in place of the machine's."""
    clock = Clock()
    monkeypatch.setattr("time.perf_counter", clock)
    return clock


class Collecting:
    """Collecting looks for no garbage, of which there is none: what tests are made of stays until the end."""

    def pytest_sessionstart(self) -> None:
        gc.disable()

    def pytest_collection_finish(self) -> None:
        gc.enable()
        gc.freeze()


class Doctests:
    """Files without a prompt have no doctests: pytest need not import them and look at all that is in them.

    A plugin of its own, as hooks in a conftest.py are called for files beside it alone, not for those of the package.
    """

    @pytest.hookimpl(wrapper=True)
    def pytest_collect_file(self, file_path: Path) -> Generator[None, list[Any], list[Any]]:
        found = yield
        if not found or ">>> " in file_path.read_text("utf-8"):
            return found
        return [one for one in found if type(one).__name__ != "DoctestModule"]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--share", metavar="K/N", help="the K-th of N parts of the tests, from 0, the same ones every time"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Have modules compiled once, by a plain `compile`.

    The processes of pytest-xdist and the hundred and more that tests start would compile all of them anew where Python
    is told to leave nothing beside the sources. The package has a plugin of pytest, which would rewrite the asserts of
    all its files, as it does with those of tests.
    """
    config.pluginmanager.register(Doctests())
    config.pluginmanager.register(Collecting())
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    getattr(config.pluginmanager.rewrite_hook, "_must_rewrite", set()).discard("contactqp")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of a long list of tests that is `sampled` one in so many runs every time, the others with `-m slow`.

    Of a share only the tests are kept whose names have its remainder.
    """
    seen: Counter[str] = Counter()
    for item in items:
        mark = item.get_closest_marker("sampled")
        if mark is None:
            continue
        name = item.nodeid.partition("[")[0]
        if seen[name] % mark.args[0]:
            item.add_marker("slow")
        seen[name] += 1
    if (share := config.getoption("--share")) is not None:
        part, parts = (int(number) for number in share.split("/"))
        kept = [crc32(item.nodeid.encode()) % parts == part for item in items]
        config.hook.pytest_deselected(items=[item for item, keep in zip(items, kept, strict=True) if not keep])
        items[:] = [item for item, keep in zip(items, kept, strict=True) if keep]
