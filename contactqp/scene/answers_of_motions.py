"""The quantities of motions that nodes and bodies have alike: energies and momenta."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from contactqp.scene.claims import Claim


def _momentum(claim: Claim, answer: Any) -> float:
    from contactqp.scene.moving import momentum

    instant = answer.instant
    return momentum(answer.model, instant.motion, instant.velocity, str(claim.along), claim.at)


OF_MOTIONS: Mapping[str, Callable[[Claim, Any], float]] = {
    "kinetic energy": lambda claim, answer: answer.instant.energies(claim).kinetic,
    "total energy": lambda claim, answer: answer.instant.energies(claim).total,
    "impact energy": lambda claim, answer: answer.instant.energies(claim).impact,
    "energy drift": lambda claim, answer: answer.instant.energies(claim).drift,
    "total momentum": _momentum,
    "momentum": _momentum,
}
