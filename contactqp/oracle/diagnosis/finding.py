"""One thing that is wrong with an answer."""

from __future__ import annotations

from dataclasses import dataclass

# What explains a whole answer.
CAUSES = {
    "sign": "forces of the opposite sign",
    "displacement-sign": "displacements of the opposite sign",
    "friction-sign": "friction forces of the opposite sign",
    "tie-sign": "tie forces of the opposite sign",
    "unit": "another unit of length or force",
    "half": "a factor of two",
    "radian": "a ring instead of a radian of it, or the other way round",
    "scaled": "a factor without a name",
    "zero": "a part was left at zero",
    "permuted": "contacts in another order",
    "permuted-unknowns": "unknowns in another order",
    "tangent-order": "tangential directions in another order",
    "tangent-sign": "one tangential direction of the opposite sign",
    "tangent-turned": "tangential directions turned by an angle",
    "components": "normal and tangential forces in another order",
    "single-precision": "numbers of single precision",
    "printed-digits": "numbers as printed",
    "inexact": "right to a few digits",
    "one-value": "one value is wrong and all others are right",
    "pressure": "pressures instead of forces, or forces taken for pressures",
    "duplicate-row": "a contact row that stands twice",
    "distribution": "the right total, at the wrong contacts",
    "penalty": "contact by springs",
    "bilateral-springs": "contact by springs that also pull",
    "barrier": "an interior point far from the boundary",
    "load": "another factor of the load",
    "load-missing": "the load of some unknowns is missing",
    "stiffness": "another modulus",
    "regularised": "something was added to the diagonal of the stiffness",
    "gap-ignored": "no initial gaps",
    "gap-sign": "initial gaps of the opposite sign",
    "gap-unit": "initial gaps in another unit",
    "gap-offset": "every gap is off by the same",
    "shifted": "every displacement is off by the same",
    "overlap-ignored": "initial overlaps taken as closed gaps",
    "ties-ignored": "no ties",
    "tie-value-ignored": "tie values of zero",
    "free": "no contact at all",
    "contact-missed": "contact was missed somewhere",
    "bilateral": "contacts held both ways",
    "friction-ignored": "no friction",
    "friction-coefficient": "another coefficient of friction",
    "friction-reversed": "friction that pushes along",
    "slip-origin": "slip counted from zero",
    "stuck": "no slip was allowed",
    "associated": "the associated relaxation, in which sliding dilates",
    "pyramid": "friction bounded direction by direction",
}
# What is violated, and what is to be said beside.
SYMPTOMS = {
    "not-finite": "NaN or infinity",
    "tension": "a contact pulls",
    "penetration": "a contact is penetrated",
    "complementarity": "a contact pushes without touching",
    "cone": "friction beyond its bound",
    "slip": "slip without full friction against it",
    "tie": "a tie is missed",
    "equilibrium": "an unknown is out of balance",
    "balance": "the forces on a body do not balance",
    "inaccurate": "a bound on the error is too large",
    "several": "other answers exist, or may",
    "not-examined": "hypotheses that were left out because the problem is large",
}


@dataclass(frozen=True)
class Finding:
    """A kind for programs, a key of `CAUSES` or `SYMPTOMS`, and a sentence for people.

    A cause explains the whole answer: with it undone the answer is right, or nearer to right by two digits at least.
    Any other finding says what is violated and guesses nothing.
    """

    kind: str
    text: str
    cause: bool = False
    together: bool = False  # with the cause before it, not instead of it

    def __str__(self) -> str:
        return self.text
