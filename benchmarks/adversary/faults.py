"""Faults to plant in the package: each must be found by the adversary, or it finds nothing.

`python -m benchmarks.adversary --plant NAME`; the tests plant them all.
"""

from __future__ import annotations

import contextlib
import json
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import contactqp as cq
from contactqp.certificate import certificate, number_range
from contactqp.certificate.state_answer import StateVerdict
from contactqp.cli import output
from contactqp.errors import NoEquilibrium, NotCertified, NotConverged
from contactqp.exchange import own_answers
from contactqp.solving import runs

Fault = Callable[[], AbstractContextManager[Any]]


@contextlib.contextmanager
def _patched(where: Any, name: str, changed: Callable[[Any], Any]) -> Iterator[None]:
    with patch.object(where, name, changed(getattr(where, name))):
        yield


def _certificate_with(change: Callable[[Any], Any]) -> Fault:
    """What a certificate has measured, changed before it is put in words."""

    def changed(measured: Any) -> Any:
        return lambda *args: change(measured(*args))

    return lambda: _patched(certificate, "_measure", changed)


def _tension_forgiven(measured: Any) -> Any:
    """Tensions up to 1e-6 of the forces that meet pass."""
    found = measured.found
    forgiven = {
        name: np.where(getattr(found, name) <= 2e-6, 0.0, getattr(found, name))
        for name in ("tension", "complementarity")
    }
    law = None if measured.law is None else np.where(measured.law <= 2e-6, 0.0, measured.law)
    return replace(measured, found=replace(found, **forgiven), law=law)


def _bound_too_small(measured: Any) -> Any:
    """The bounds of errors are nine tenths of what they are."""
    bounds = measured.bounds
    names = [name for name in ("energy_error", "force_error") if getattr(bounds, name) is not None]
    return replace(measured, bounds=replace(bounds, **{name: 0.9 * getattr(bounds, name) for name in names}))


def _sign_ignored(measured: Any) -> Any:
    """The certificate sees the size of a contact force, and not its sign."""
    return lambda problem, answer, *rest: measured(
        problem, replace(answer, normal_force=abs(answer.normal_force)), *rest
    )


def _wrong_scale(whole_answer: Any) -> Any:
    """Forces of problems with extreme numbers come back in the wrong unit."""

    def changed(self: Any, found: Any) -> Any:
        right = whole_answer(self, found)
        return replace(right, normal_force=2.0 * right.normal_force)

    return changed


def _swallowed(finish: Any) -> Any:
    """An answer that the certificate refuses is returned as if it had passed."""

    def changed(self: Any) -> Any:
        try:
            return finish(self)
        except NotCertified as error:
            return replace(error.solution, certificate=replace(error.solution.certificate, passed=True))

    return changed


def _law_forgiven(measured: Any) -> Any:
    """Coulomb's law is not judged: friction forces of any size and direction pass where they balance the load."""
    nothing = {name: np.zeros_like(getattr(measured.found, name)) for name in ("cone", "slip_direction")}
    law, verdict = (None if measured.law is None else np.zeros_like(measured.law)), StateVerdict(measured.state.basis)
    return replace(measured, found=replace(measured.found, **nothing), law=law, state=verdict)


def _absence_claimed(solve: Any) -> Any:
    """What an algorithm does not find is said not to exist."""

    def changed(*args: Any, **options: Any) -> Any:
        try:
            return solve(*args, **options)
        except NotConverged as error:
            raise NoEquilibrium(str(error)) from error

    return changed


def _warns(measured: Any) -> Any:
    """A warning of NumPy leaves where a contact is open."""
    if np.any(measured.found.gap > 0):
        warnings.warn("invalid value encountered in divide", RuntimeWarning, stacklevel=1)
    return measured


def _none(_: Any) -> Any:
    """Nothing is found."""
    return lambda *_: None


def _unrefused(_: Any) -> Any:
    """A reader takes for JSON what is none: the error of Python's own reader leaves."""
    return lambda path, _: json.loads(Path(path).read_bytes())


def _unjson(_: Any) -> Any:
    """An error is printed as a sentence where JSON was asked for."""
    return lambda message, code, ending: print(message, code, ending)


def _in_lines(_: Any) -> Any:
    """An error is printed as it was raised, in as many lines."""
    return lambda message: print("contactqp:", message.replace(": ", ":\n"), file=sys.stderr)


FAULTS: dict[str, Fault] = {
    "none": contextlib.nullcontext,
    "tension": _certificate_with(_tension_forgiven),
    "sign": lambda: _patched(certificate, "_measure", _sign_ignored),
    "bound": _certificate_with(_bound_too_small),
    "scale": lambda: _patched(number_range.NearOne, "whole_answer", _wrong_scale),
    "swallowed": lambda: _patched(runs.Run, "finish", _swallowed),
    # Rounding is judged against rounding: nothing counts as nothing.
    "floor": lambda: _patched(certificate, "ROUNDING_OF_ANSWERS", lambda _: 0.0),
    # What counts as nothing is a thousandth of the size of problem and answer.
    "size": lambda: _patched(certificate, "ROUNDING_OF_ANSWERS", lambda _: 1e6),
    "law": _certificate_with(_law_forgiven),
    "absence": lambda: _patched(cq, "solve", _absence_claimed),
    # Units of length and force are those of single unknowns and rows, which are rounded otherwise.
    "units": lambda: _patched(number_range, "_uniform_units", _none),
    # Numbers of any size are computed with as they are.
    "range": lambda: _patched(sys.modules["contactqp.solving.solve"], "near_one", _none),
    "warning": _certificate_with(_warns),
    "reader": lambda: _patched(own_answers, "load_json", _unrefused),
    "json": lambda: _patched(output, "print_error", _unjson),
    "lines": lambda: _patched(output, "complain", _in_lines),
}
# The kinds of findings that are due to each fault. Others may come with it: a refused answer that is returned as if it
# had passed may lack bounds, which is found as well.
SEEN_AS: dict[str, set[str]] = {
    "tension": {"forgery", "wrong"},
    "sign": {"forgery", "wrong", "bound"},
    "bound": {"bound"},
    "scale": {"wrong", "refused", "bound", "units"},  # other digits in other units
    "swallowed": {"wrong", "forgery"},
    "floor": {"refused"},
    "size": {"forgery", "wrong"},
    "law": {"forgery", "wrong"},
    "absence": {"denied"},
    "units": {"units"},
    "range": {"crashed", "units", "refused", "bound"},
    "warning": {"crashed"},
    "reader": {"crashed"},
    "json": {"printed"},
    "lines": {"printed"},
}
