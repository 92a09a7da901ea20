"""Parts of constrained energies: springs, cables without compression, struts without tension, plastic hinges, and
bounds on linear combinations of unknowns.

A cable's energy is 1/2 k max(e, 0)^2 with e = elongation - slack. It is the minimum of a quadratic energy over a
slackening s >= 0,

    min over s >= 0 of 1/2 k (e + s)^2,        k (e + s) = l >= 0,  l s = 0,

so that the multiplier l of s >= 0 is the tension. An inextensible cable is the constraint elongation <= slack, its
multiplier again the tension. A strut is a cable for the shortening.

The rotation t of a plastic hinge has a plastic part p+ - p-, both not negative.

    min over p+, p- >= 0 of 1/2 k (t - p+ + p-)^2 + M+ p+ + M- p-,      M = k (t - p+ + p-)

The multipliers of p+ >= 0 and p- >= 0 are M+ - M and M- + M, how far the moment is from yielding in either direction:
it stays between its bounds, and the plastic parts grow only where it reaches them. A rigid hinge has the constraint
t = p+ - p- in place of the energy, and M is its multiplier. This is deformation theory: the answer to one load that
grows from nothing in proportion, without unloading (Maier 1970; Cohn and Maier, eds., 1979).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from contactqp.elements.constrained_energy import (
    Condition,
    Contribution,
    Form,
    Found,
    PartState,
    Square,
    minus,
    plus,
    read_form,
    read_number,
)
from contactqp.errors import InvalidProblem, shown
from contactqp.model.arguments import checks
from contactqp.model.arrays import Array
from contactqp.model.problem_data import ReadOnly, read_array, read_only


@checks
@dataclass(frozen=True)
class Spring:
    """The energy 1/2 k (elongation(u) - rest)^2; its force is k (elongation - rest), positive in tension.

    Parameters
    ----------
    name : str
    stiffness : float
        k > 0 [force / length].
    elongation : mapping from names of unknowns to factors
    rest : float
        The elongation without force [length].

    Raises
    ------
    InvalidProblem
        One of these arguments is not as described; the message names it.
    """

    name: str
    stiffness: float
    elongation: Form
    rest: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "stiffness", read_number(f"{self.name}: stiffness", self.stiffness, positive=True))
        object.__setattr__(self, "elongation", read_form(self.name, self.elongation))
        object.__setattr__(self, "rest", read_number(f"{self.name}: rest", self.rest))

    def contribution(self) -> Contribution:
        """Return the energy and the constraints that the part adds."""
        return Contribution(squares=(Square(self.elongation, self.stiffness, self.rest),))

    def state(self, found: Found) -> PartState:
        """Return elongation, force and status of the part at a minimum."""
        elongation = found.value(self.elongation)
        return PartState(elongation, self.stiffness * (elongation - self.rest), "elastic")


@checks
@dataclass(frozen=True)
class Cable:
    """A cable that pulls with k max(elongation - slack, 0) and never pushes; its force is the tension, a multiplier.

    Parameters
    ----------
    name : str
    elongation : mapping from names of unknowns to factors
        [length]; of a cable along the unit vector n from a fixed point to a node, {"x": n_x, "y": n_y}.
    stiffness : float, optional
        k = EA/L [force / length]; without it the cable is inextensible.
    slack : float
        The elongation at which it becomes taut [length]; negative where it is prestressed by -k slack.

    Raises
    ------
    InvalidProblem
        One of these arguments is not as described; the message names it.

    Examples
    --------
    A mast of 10 kN/m between two stays of 100 kN/m each, pushed to the right by 11 kN: the right stay goes slack.

    >>> import contactqp as cq
    >>> stays = [cq.Cable("left", {"x": 1.0}, 100.0), cq.Cable("right", {"x": -1.0}, 100.0)]
    >>> mast = cq.ConstrainedEnergy(["x"], stiffness=[[10.0]], load=[11.0], parts=stays).solve()
    >>> round(mast.parts["left"].force, 12), mast.parts["right"].force, mast.parts["right"].status
    (10.0, 0.0, 'slack')
    """

    name: str
    elongation: Form
    stiffness: float | None = None
    slack: float = 0.0

    def __post_init__(self) -> None:
        _read_one_sided(self, "slack")

    def contribution(self) -> Contribution:
        """Return the energy and the constraints that the part adds."""
        return _one_sided(self.name, self.elongation, self.stiffness, self.slack)

    def state(self, found: Found) -> PartState:
        """Return elongation, force and status of the part at a minimum."""
        tension = found.multiplier[self.name]
        return PartState(found.value(self.elongation), tension, "taut" if tension > 0 else "slack")


@checks
@dataclass(frozen=True)
class Strut:
    """A strut that pushes with k max(-elongation - gap, 0) and never pulls: a prop, or a spring that takes no
    tension.

    Its force is the compression, a multiplier, not negative.

    Parameters
    ----------
    name : str
    elongation : mapping from names of unknowns to factors
        [length]; of a spring below a deflection w that is positive upwards, {"w": 1.0}.
    stiffness : float, optional
        k [force / length]; without it the strut is rigid.
    gap : float
        The shortening at which it begins to push [length]; negative where it is wedged in.

    Raises
    ------
    InvalidProblem
        One of these arguments is not as described; the message names it.

    Examples
    --------
    >>> import contactqp as cq
    >>> prop = cq.Strut("prop", {"w": 1.0}, 100.0, gap=0.5)
    >>> cq.ConstrainedEnergy(["w"], stiffness=[[10.0]], load=[-60.0], parts=[prop]).solve().parts["prop"]
    PartState(deformation=-1.0, force=50.0, status='pushes', plastic=0.0)
    """

    name: str
    elongation: Form
    stiffness: float | None = None
    gap: float = 0.0

    def __post_init__(self) -> None:
        _read_one_sided(self, "gap")

    def contribution(self) -> Contribution:
        """Return the energy and the constraints that the part adds."""
        return _one_sided(self.name, minus(self.elongation), self.stiffness, self.gap)

    def state(self, found: Found) -> PartState:
        """Return elongation, force and status of the part at a minimum."""
        compression = found.multiplier[self.name]
        return PartState(found.value(self.elongation), compression, "pushes" if compression > 0 else "idle")


def _read_one_sided(part: Any, play: str) -> None:
    object.__setattr__(part, "elongation", read_form(part.name, part.elongation))
    object.__setattr__(part, play, read_number(f"{part.name}: {play}", getattr(part, play)))
    if part.stiffness is not None:
        stiffness = read_number(f"{part.name}: stiffness", part.stiffness, positive=True)
        object.__setattr__(part, "stiffness", stiffness)


def _one_sided(name: str, deformation: Form, stiffness: float | None, play: float) -> Contribution:
    """Return the contribution that resists a deformation beyond `play` only."""
    if stiffness is None:
        return Contribution(unilateral=(Condition(name, deformation, play),))
    rest = f"{name}: slackening"
    return Contribution(
        internal=(rest,),
        squares=(Square(plus(deformation, [(rest, 1.0)]), stiffness, play),),
        unilateral=(Condition(name, {rest: -1.0}, 0.0),),
    )


@checks
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
        One of these arguments is not as described; the message names it.

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
        for name in ("capacity", "negative_capacity", "stiffness"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, read_number(f"{self.name}: {name}", value, positive=True))
        object.__setattr__(self, "hardening", read_number(f"{self.name}: hardening", self.hardening))
        if self.hardening < 0:
            raise InvalidProblem(
                f"{self.name}: hardening: expected a number that is not negative, got {shown(self.hardening)}"
            )

    @property
    def _plastic(self) -> tuple[str, str]:
        return f"{self.name}: plastic +", f"{self.name}: plastic -"

    def contribution(self) -> Contribution:
        """Return the energy and the constraints that the part adds."""
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
        """Return rotation, moment, plastic rotation and status of the hinge at a minimum."""
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


@dataclass(frozen=True)
class _Bound:
    """A form and a number; the force of the constraint is its multiplier."""

    name: str
    form: Form
    bound: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "form", read_form(self.name, self.form))
        object.__setattr__(self, "bound", read_number(f"{self.name}: bound", self.bound))

    def state(self, found: Found) -> PartState:
        """Return the value of the form, its force and whether the bound is active at a minimum."""
        force = found.multiplier[self.name]
        return PartState(found.value(self.form), force, "active" if force > 0 else "inactive")


@checks
@dataclass(frozen=True)
class AtMost(_Bound):
    """The constraint form(u) <= bound; its force is the multiplier, not negative, that acts against growth.

    Parameters
    ----------
    name : str
    form : mapping from names of unknowns to factors
        form(u) is the sum of factors times unknowns.
    bound : float
        In the unit of the form.

    Raises
    ------
    InvalidProblem
        `form` is no such mapping, or `bound` is not a number.
    """

    def contribution(self) -> Contribution:
        """Return the energy and the constraints that the part adds."""
        return Contribution(unilateral=(Condition(self.name, self.form, self.bound),))


@checks
@dataclass(frozen=True)
class AtLeast(_Bound):
    """The constraint form(u) >= bound; its force is the multiplier, not negative, that acts against decrease.

    Parameters and errors are those of `AtMost`.
    """

    def contribution(self) -> Contribution:
        """Return the energy and the constraints that the part adds."""
        return Contribution(unilateral=(Condition(self.name, minus(self.form), -self.bound),))


@checks
@dataclass(frozen=True)
class Equal(_Bound):
    """The constraint form(u) = bound, a support or a tie of several unknowns; its force is nu of K u + A'nu = f.

    Parameters and errors are those of `AtMost`.
    """

    bound: float = 0.0

    def contribution(self) -> Contribution:
        """Return the energy and the constraints that the part adds."""
        return Contribution(ties=(Condition(self.name, self.form, self.bound),))

    def state(self, found: Found) -> PartState:
        """Return the value of the form and its force at a minimum."""
        return PartState(found.value(self.form), found.multiplier[self.name], "tied")


@checks
@dataclass(frozen=True)
class Obstacle(ReadOnly):
    """The bounds lower <= u_j <= upper on many unknowns; their force is that of the lower bounds less that of the
    upper ones.

    Each bound is a constraint of its own: "<name>: <unknown> from below" or "from above" is what
    `ConstrainedMinimum.multiplier` calls it. `deformation` is the least distance of an unknown from a bound.

    Parameters
    ----------
    name : str
    unknowns : sequence of str
    lower, upper : float or array, optional
        At least one of them is given; infinite entries bound nothing.

    Raises
    ------
    InvalidProblem
        No bound, NaN, or a lower bound above the upper.
    """

    name: str
    unknowns: tuple[str, ...]
    lower: Any = None
    upper: Any = None
    _conditions: tuple[Condition, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "unknowns", tuple(self.unknowns))
        lower, upper = self._side("lower", -np.inf), self._side("upper", np.inf)
        crossed = np.flatnonzero(lower > upper)
        if crossed.size:
            i = int(crossed[0])
            raise InvalidProblem(
                f"{self.name}: expected lower <= upper, got {lower[i]:g} and {upper[i]:g} for {self.unknowns[i]}"
            )
        below = [
            Condition(f"{self.name}: {u} from below", {u: -1.0}, -float(b))
            for u, b in zip(self.unknowns, lower, strict=True)
            if b > -np.inf
        ]
        above = [
            Condition(f"{self.name}: {u} from above", {u: 1.0}, float(b))
            for u, b in zip(self.unknowns, upper, strict=True)
            if b < np.inf
        ]
        if not below + above:
            raise InvalidProblem(f"{self.name}: expected a lower or an upper bound, got neither")
        object.__setattr__(self, "_conditions", (*below, *above))

    def _side(self, which: str, none: float) -> Array:
        given = getattr(self, which)
        count = len(self.unknowns)
        bounds = read_array(f"{self.name}: {which}", none if given is None else given)
        if bounds.shape not in ((), (count,)) or np.any(np.isnan(bounds)) or np.any(bounds == -none):
            raise InvalidProblem(f"{self.name}: {which}: expected one number or {count}, none of them NaN or {-none}")
        if bounds.ndim:
            object.__setattr__(self, which, read_only(bounds))
        return np.broadcast_to(bounds, (count,))

    def contribution(self) -> Contribution:
        """Return the energy and the constraints that the part adds."""
        return Contribution(unilateral=self._conditions)

    def state(self, found: Found) -> PartState:
        """Return the least distance to a bound, the force and whether any bound is active at a minimum."""
        total = -sum(
            found.multiplier[condition.name] * factor
            for condition in self._conditions
            for factor in condition.form.values()
        )
        distance = min(condition.bound - found.value(condition.form) for condition in self._conditions)
        active = any(found.multiplier[condition.name] > 0 for condition in self._conditions)
        return PartState(distance, float(total), "active" if active else "inactive")
