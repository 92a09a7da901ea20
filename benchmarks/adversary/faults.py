"""Faults to plant in the package: each must be found by the adversary, or it finds nothing.

`python -m benchmarks.adversary --plant NAME`; the tests plant them all.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np

from contactqp.certificate import certificate, number_range
from contactqp.errors import NotCertified
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

    return lambda: _patched(certificate, "_measured", changed)


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
    known = measured.known
    names = [name for name in ("energy_error", "force_error") if getattr(known, name) is not None]
    return replace(measured, known=replace(known, **{name: 0.9 * getattr(known, name) for name in names}))


def _sign_ignored(measured: Any) -> Any:
    """The certificate sees the size of a contact force, and not its sign."""
    return lambda problem, answer, *rest: measured(
        problem, replace(answer, normal_force=abs(answer.normal_force)), *rest
    )


def _wrong_scale(parts: Any) -> Any:
    """Forces of problems with extreme numbers come back in the wrong unit."""

    def changed(self: Any, found: Any) -> dict[str, Any]:
        right = parts(self, found)
        return right | dict(normal_force=2.0 * right["normal_force"])

    return changed


def _swallowed(finish: Any) -> Any:
    """An answer that the certificate refuses is returned as if it had passed."""

    def changed(self: Any) -> Any:
        try:
            return finish(self)
        except NotCertified as error:
            return replace(error.solution, certificate=replace(error.solution.certificate, passed=True))

    return changed


FAULTS: dict[str, Fault] = {
    "none": contextlib.nullcontext,
    "tension": _certificate_with(_tension_forgiven),
    "sign": lambda: _patched(certificate, "_measured", _sign_ignored),
    "bound": _certificate_with(_bound_too_small),
    "scale": lambda: _patched(number_range.NearOne, "parts", _wrong_scale),
    "swallowed": lambda: _patched(runs.Run, "finish", _swallowed),
}
