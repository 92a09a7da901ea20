"""Plastic hinges as bounds: the rotation t of a hinge has a plastic part p+ - p-, both not negative.

    min over p+, p- >= 0 of 1/2 k (t - p+ + p-)^2 + M+ p+ + M- p-,      M = k (t - p+ + p-)

The multipliers of p+ >= 0 and p- >= 0 are M+ - M and M- + M, how far the moment is from yielding either way: it stays
between its bounds, and what is plastic grows only where it reaches them. A rigid hinge has the constraint
t = p+ - p- in place of the energy, and M is its multiplier. This is deformation theory: the answer to one load that
grows from nothing in proportion; it remembers no unloading (Maier 1970; Cohn and Maier, eds., 1979).
"""

from __future__ import annotations

from dataclasses import dataclass

from contactqp.elements.energies.part import (
    Condition,
    Contribution,
    Form,
    Found,
    PartState,
    Square,
    plus,
    read_form,
    read_number,
)
from contactqp.errors import InvalidProblem


@dataclass(frozen=True)
class PlasticHinge:
    """A moment that is bounded, -M- <= M <= M+; also a friction slider or any force with a limit.

    Its force is the moment M, positive where it resists a positive rotation; `plastic` is p+ - p-.

    Parameters
    ----------
    name : str
    rotation : mapping from names of unknowns to factors
        The relative rotation of what the hinge joins, {"left": -1.0, "right": 1.0}.
    capacity : float
        M+ > 0 [moment].
    negative_capacity : float, optional
        M- > 0; M+ where it is not given.
    stiffness : float, optional
        k [moment / rotation] before it yields; without it the hinge is rigid.
    hardening : float
        h >= 0: the bounds grow by h (p+ - p-), as kinematic hardening does.

    Raises
    ------
    InvalidProblem
        Of any of these.

    Examples
    --------
    A lever on an elastic hinge of 100 kN m that yields at 5 kN m, backed by a spring of 10 kN m.

    >>> import contactqp as cq
    >>> hinge = cq.PlasticHinge("hinge", {"t": 1.0}, capacity=5.0, stiffness=100.0)
    >>> lever = cq.ConstrainedEnergy(["t"], stiffness=[[10.0]], load=[6.0], parts=[hinge]).solve().parts["hinge"]
    >>> round(lever.force, 12), round(lever.plastic, 12), lever.status
    (5.0, 0.05, 'yields')
    """

    name: str
    rotation: Form
    capacity: float
    negative_capacity: float | None = None
    stiffness: float | None = None
    hardening: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "rotation", read_form(self.name, self.rotation))
        if self.negative_capacity is None:
            object.__setattr__(self, "negative_capacity", self.capacity)
        for field in ("capacity", "negative_capacity", "stiffness"):
            if (value := getattr(self, field)) is not None:
                object.__setattr__(self, field, read_number(f"{self.name}: {field}", value, positive=True))
        object.__setattr__(self, "hardening", read_number(f"{self.name}: hardening", self.hardening))
        if self.hardening < 0:
            raise InvalidProblem(
                f"{self.name}: hardening: expected a number that is not negative, got {self.hardening!r}"
            )

    @property
    def _plastic(self) -> tuple[str, str]:
        return f"{self.name}: plastic +", f"{self.name}: plastic -"

    def contribution(self) -> Contribution:
        forth, back = self._plastic
        elastic = plus(self.rotation, [(forth, -1.0), (back, 1.0)])
        squares = [Square({forth: 1.0, back: -1.0}, self.hardening)] if self.hardening else []
        if self.stiffness is not None:
            squares.append(Square(elastic, self.stiffness))
        return Contribution(
            internal=self._plastic,
            squares=tuple(squares),
            load={forth: -self.capacity, back: -float(self.negative_capacity or 0.0)},
            unilateral=tuple(Condition(name, {name: -1.0}, 0.0) for name in self._plastic),
            ties=() if self.stiffness is not None else (Condition(self.name, elastic, 0.0),),
        )

    def state(self, found: Found) -> PartState:
        forth, back = self._plastic
        plastic = found.unknown[forth] - found.unknown[back]
        to_yield, to_yield_back = found.multiplier[forth], found.multiplier[back]
        # From the bound that is nearer: a moment at its bound is that bound to the last digit.
        moment = self.capacity - to_yield
        if to_yield_back < to_yield:
            moment = to_yield_back - float(self.negative_capacity or 0.0)
        yields = found.unknown[forth] > 0 or found.unknown[back] > 0
        return PartState(
            found.value(self.rotation), moment + self.hardening * plastic, "yields" if yields else "elastic", plastic
        )
