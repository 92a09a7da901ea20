"""The process that solves one case and prints its footprint as a line of JSON.

Nothing but the standard library is imported before the measurement begins.
"""

from __future__ import annotations

import builtins
import contextlib
import importlib.util
import json
import os
import sys
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from contactqp.errors import ContactQPError
from contactqp.model.arrays import STAGES, StageClock, timed, within_time
from contactqp.study.footprint import IMPORT, OPTIONAL, ContactCount, Footprint, Memory, Modules, StageTime

if TYPE_CHECKING:
    from contactqp.analysis.history import History
    from contactqp.scene.building import Model


class ImportMeter:
    """Measures the time of imports as a separate stage, wherever they happen, and the memory that they take."""

    def __init__(self, clock: StageClock) -> None:
        self._clock, self._import, self._inside = clock, builtins.__import__, False
        self._thread = threading.get_ident()  # the thread that the clock times
        self.taken = 0  # bytes

    @contextlib.contextmanager
    def watching(self) -> Iterator[ImportMeter]:
        """Measure the imports of this thread until the end of the context."""
        builtins.__import__ = self._watched
        try:
            yield self
        finally:
            builtins.__import__ = self._import

    def _watched(self, name: str, *arguments: Any, **named: Any) -> Any:
        if self._inside or name in sys.modules or threading.get_ident() != self._thread:
            return self._import(name, *arguments, **named)
        self._inside, before = True, resident() or 0
        try:
            with self._clock.within(IMPORT):
                return self._import(name, *arguments, **named)
        finally:
            self._inside = False
            self.taken += (resident() or 0) - before


def resident() -> int | None:
    """Return the resident memory [bytes]; None where there is no /proc."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return None


def peak() -> int | None:
    """Return the largest resident memory so far [bytes]; None where the system does not report it.

    It is read from /proc where there is one: `getrusage` starts with the memory of the process that started this one.
    """
    try:
        with open("/proc/self/status") as file:
            found = next(line for line in file if line.startswith("VmHWM"))
        return int(found.split()[1]) * 1024
    except (OSError, StopIteration):
        pass
    try:
        import resource
    except ImportError:  # Windows
        return None
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(size if sys.platform == "darwin" else size * 1024)


def main(case: str, method: str, time_limit: str | None = None) -> None:
    """Solve a case by a method, within so many seconds, and print the footprint."""
    started, at_start, loaded = time.perf_counter(), resident(), set(sys.modules)
    failure: str | None = None
    model: Model | None = None
    history: History | None = None
    limit = None if time_limit is None else float(time_limit)
    with timed() as clock, ImportMeter(clock).watching() as imports, within_time(limit):
        from contactqp.scene.building import build
        from contactqp.scene.scene import load_scene, run_model

        try:
            model = build(load_scene(case))
            history = run_model(model, method)
            _look_at(history, model)
        except ContactQPError as error:
            failure = " ".join(str(error).split())
        seconds, spent = time.perf_counter() - started, clock.seconds
    footprint = Footprint(
        case=case,
        method=method,
        failure=failure,
        seconds=seconds,
        stages=tuple(StageTime(name, spent[name]) for name in (IMPORT, *STAGES) if name in spent),
        instants=0 if history is None else len(history),
        certified=failure is None and history is not None and bool(history[-1].certificate.passed),
        contacts=None if model is None else contact_count(model, history),
        factorisations=clock.factorisations,
        back_substitutions=clock.back_substitutions,
        memory=Memory(peak(), at_start, imports.taken if at_start is not None else None),
        modules=_modules(loaded),
    )
    print(json.dumps(footprint.data()))


def _look_at(history: History, model: Model) -> None:
    """Have every answer certified, which happens on first access; those of motions are certified while stepping."""
    for solution in history if model.scene.motion is None else (history[-1],):
        assert solution.certificate is not None


def contact_count(model: Model, history: History | None) -> ContactCount:
    """Return the contact count of a case that was solved."""
    from contactqp.certificate.subset_bounds import candidates_of

    problem = model.problem
    pairings = [contact.pairing for contact in getattr(model, "contacts", ())]
    unpaired = sum(len(pairing.unpaired) for pairing in pairings)
    candidates = candidates_of(problem)
    if candidates is None:
        return ContactCount(problem.contacts + unpaired, unpaired, 0, problem.contacts)
    kept = set(candidates.tolist())
    dropped = [i for i in range(problem.contacts) if i not in kept]
    gaps = [float(solution.gap[dropped].min()) for solution in history or () if dropped]
    return ContactCount(problem.contacts + unpaired, unpaired, len(dropped), len(kept), min(gaps, default=None))


def _modules(before: set[str]) -> Modules:
    names = {name.partition(".")[0] for name in set(sys.modules) - before}
    packages = sorted(name for name in names if _third_party(name))
    optional = [name for _, group in OPTIONAL for name in group if name not in sys.modules]
    installed = {name: importlib.util.find_spec(name) is not None for name in optional}
    return Modules(
        count=len(sys.modules),
        packages=tuple(packages),
        left_out=tuple(name for name in optional if installed[name]),
        missing=tuple(name for name in optional if not installed[name]),
    )


def _third_party(name: str) -> bool:
    ours = name == "contactqp" or name.startswith("_") or name in sys.stdlib_module_names
    return not ours and getattr(sys.modules.get(name), "__file__", None) is not None


if __name__ == "__main__":
    main(*sys.argv[1:])
