"""The keys of a motion: how long, in which steps, by which scheme, and how it starts."""

from __future__ import annotations

from fractions import Fraction
from math import ceil
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from contactqp.scene import fields
from contactqp.scene.fields import Block, Name, Number
from contactqp.scene.wording import unknown

MOST_STEPS = 1_000_000


def _known_scheme(value: str) -> str:
    from contactqp.analysis.motion.schemes import SCHEMES

    if value not in SCHEMES:
        raise ValueError(unknown(value, SCHEMES, "scheme"))
    return value


class _Start(Block):
    """What a part of the scene starts with: a body, a bar, a node, or one unknown ``node.axis``."""

    of: Name


class StartVelocity(_Start):
    """A velocity along the axes, of an unknown one number; of a bar `to` that of its second node, linear between."""

    value: fields.Velocities
    to: fields.Velocities | None = None


class StartDisplacement(_Start):
    """A displacement, with the keys of a velocity."""

    value: fields.Point
    to: fields.Point | None = None


class Motion(Block):
    """The scene moves: from `start` on for `duration`, in equal steps, all loads constant.

    `scheme` is one of `contactqp.impact`, `theta`, `restitution` and `penalty` are its knobs. `mass` is ``consistent``
    or ``lumped``. What `displacements` and `velocities` do not name starts where it stands, at rest.
    """

    start: Annotated[fields.Time, Field(validate_default=True)] = "0 s"  # type: ignore[assignment]
    duration: fields.PositiveTime
    time_step: fields.PositiveTime
    scheme: Annotated[Name, AfterValidator(_known_scheme)] = "moreau-jean"
    theta: Number | None = None
    restitution: Number | None = None
    penalty: fields.Stiffness | None = None
    mass: Literal["consistent", "lumped"] = "consistent"
    displacements: tuple[StartDisplacement, ...] = ()
    velocities: tuple[StartVelocity, ...] = ()

    @model_validator(mode="after")
    def _fits_the_scheme(self) -> Self:
        from contactqp.analysis.motion.schemes import SCHEMES

        for name, low in (("theta", Fraction(1, 2)), ("restitution", Fraction(0))):
            value = getattr(self, name)
            if value is not None and not low <= value <= 1:
                raise ValueError(f"{name}: expected a number from {float(low):g} to 1, got {float(value):g}")
        for name in ("theta", "restitution", "penalty"):
            if getattr(self, name) is not None and name not in SCHEMES[self.scheme].knobs:
                takers = ", ".join(other for other, kind in SCHEMES.items() if name in kind.knobs)
                raise ValueError(f"{name}: the scheme {self.scheme!r} has none; {takers} take one")
        if self.scheme == "penalty" and self.penalty is None:
            raise ValueError("penalty: expected for the scheme 'penalty', and missing")
        if self.steps > MOST_STEPS:
            raise ValueError(f"time_step: expected at most {MOST_STEPS} steps, got {self.steps} of {self.time_step}")
        return self

    @property
    def steps(self) -> int:
        return ceil(self.duration.si / self.time_step.si)

    @property
    def end(self) -> Fraction:
        """When the last step ends [s]."""
        return self.start.si + self.duration.si
