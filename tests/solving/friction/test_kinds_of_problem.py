"""A local problem where a contact problem is expected, or the other way round, is refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import contactqp as cq

LOCAL = cq.LocalProblem(delassus=[[1.0, 0.0], [0.0, 1.0]], offset=[-1.0, 0.1], friction=0.3, dimension=2)
BODIES = cq.ContactProblem(
    stiffness=[[1.0, 0.0], [0.0, 1.0]], load=[0, 0], normal=[[-1.0, 0.0]], gap=[0.0], tangent=[[0.0, 1.0]], friction=0.3
)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: cq.certify(LOCAL, [0.0], [0.0]), "certify: expected a ContactProblem, got LocalProblem"),
        (
            lambda: cq.solve(np.eye(2), [0.0, 1.0]),  # type: ignore[call-overload]
            "solve: expected a ContactProblem or LocalProblem, got ndarray; contactqp.ContactProblem",
        ),
        (
            lambda: cq.Structure(cq.Membrane(cq.rectangle(1.0, 1.0, (1, 1)), tension=1.0)),  # type: ignore[arg-type]
            "Structure: bodies: expected a sequence, each a Body or a Membrane, got Membrane",
        ),
        (
            lambda: cq.certify_local(BODIES, [0.0, 0.0]),
            "certify_local: problem: expected a LocalProblem, got Contact",
        ),
        (lambda: cq.equilibria(None), "equilibria: problem: expected a ContactProblem or a LocalProblem, got None"),
        (
            lambda: cq.critical_friction(LOCAL),
            "critical_friction: problem: expected a ContactProblem, got Local",
        ),
        (
            lambda: cq.follow_path(LOCAL, loads=[[1.0, 1.0]]),
            "follow_path: problem: expected a ContactProblem, got Local",
        ),
        (
            lambda: cq.existence_margin(3),
            "existence_margin: problem: expected a ContactProblem or a Local",
        ),
        (
            lambda: cq.certify_local(LOCAL, [1.0, -0.1], tolerance="tight"),  # type: ignore[arg-type]
            "tolerance: expected a ",
        ),
        (lambda: cq.solve(None), "solve: expected a ContactProblem or LocalProblem, got NoneType"),
    ],
)
def test_the_other_kind_is_refused(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(cq.InvalidProblem, match=message):
        call()
