"""Time-stepping schemes for impact, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from contactqp.analysis.motion.schemes.contact_stabilised import ContactStabilised
from contactqp.analysis.motion.schemes.modified_mass import ModifiedMassCentral
from contactqp.analysis.motion.schemes.moreau_jean import MoreauJean
from contactqp.analysis.motion.schemes.newmark import BackwardEuler, Trapezoidal
from contactqp.analysis.motion.schemes.paoli_schatzman import ExplicitPenalty, PaoliSchatzman
from contactqp.analysis.motion.schemes.scheme import Body, Scheme
from contactqp.errors import InvalidProblem


@dataclass(frozen=True)
class Knobs:
    """What a user may choose of a scheme."""

    theta: float
    restitution: float
    penalty: float | None


@dataclass(frozen=True)
class Kind:
    """A scheme that a user may name."""

    make: Callable[[Body, Knobs], Scheme]
    explicit: bool = False  # stable up to a critical step
    bare: bool = False  # takes the mass from the contacts
    knobs: tuple[str, ...] = ()


def _penalty(body: Body, knobs: Knobs) -> Scheme:
    if knobs.penalty is None:
        raise InvalidProblem("penalty: the scheme 'penalty' has no default stiffness; state penalty=beta")
    return ExplicitPenalty(body, knobs.penalty)


SCHEMES: dict[str, Kind] = {
    "moreau-jean": Kind(lambda b, k: MoreauJean(b, k.theta, k.restitution), knobs=("theta", "restitution")),
    "modified-mass": Kind(lambda b, _: Trapezoidal(b, "modified-mass"), bare=True),
    "modified-mass-central": Kind(lambda b, _: ModifiedMassCentral(b), explicit=True, bare=True),
    "paoli-schatzman": Kind(lambda b, k: PaoliSchatzman(b, k.restitution), explicit=True, knobs=("restitution",)),
    "deuflhard-krause-ertel": Kind(lambda b, _: ContactStabilised(b)),
    "newmark": Kind(lambda b, _: Trapezoidal(b, "newmark")),
    "backward-euler": Kind(lambda b, _: BackwardEuler(b)),
    "penalty": Kind(_penalty, explicit=True, knobs=("penalty",)),
}
