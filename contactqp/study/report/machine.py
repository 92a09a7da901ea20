"""Where and with what a report was made: enough to run it again."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Mapping, Sequence
from functools import cache

from contactqp.solving.methods import Method

BASE = ("contactqp", "numpy", "scipy", "qpsolvers", "cvxpy", "matplotlib")
# Environment variables that decide on how many threads linear algebra runs.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def machine() -> dict[str, str]:
    """Platform, processor, Python, and the limits of threads."""
    found = dict(
        platform=platform.platform(),
        processor=platform.processor() or platform.machine(),
        cores=str(os.cpu_count()),
        python=f"{platform.python_implementation()} {platform.python_version()}",
    )
    return found | {name: os.environ[name] for name in THREADS if name in os.environ}


def versions(methods: Sequence[Method]) -> dict[str, str]:
    """Version of every distribution that was or could have been used; "not installed" where it is not."""
    homes = _homes()
    packages = dict.fromkeys(package for method in methods for package in method.packages)
    names = dict.fromkeys([*BASE, *(homes.get(package, [package])[0] for package in packages)])
    return {name: _version(name) for name in names}


@cache
def _homes() -> Mapping[str, list[str]]:
    """The distributions of each package: to read the files of all that are installed takes seconds."""
    return importlib.metadata.packages_distributions()


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
