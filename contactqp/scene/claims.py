"""Define the claims of a case about its answer, and the quantities that they can name.

An expectation states an exact value, a published number comes with our verdict on it, and a study names the parameters
that a report sweeps.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, PlainValidator, model_validator

from contactqp.certificate.uniqueness import FORCES, POSSIBLE, SEVERAL, UNKNOWN
from contactqp.model.coulomb import STATUS_WORDS
from contactqp.scene import fields
from contactqp.scene.blocks import element_quantities
from contactqp.scene.blocks.element import Measure
from contactqp.scene.fields import SOME, Block, KnobStiffness, Name, Number, no_such
from contactqp.scene.units import KINDS, Kind, NotANumber, Quantity, per, read_quantity

ONE_ANSWER = "one answer"


def uniqueness_in_words(findings: Iterable[str]) -> str:
    """Return a certificate's findings as the value of "uniqueness"."""
    return "; ".join(findings) or ONE_ANSWER


def _of_bodies(meaning: str, kind: str, **asked: Any) -> Measure:
    return Measure(meaning, (kind,), of="bodies", **asked)


def _at_contact(meaning: str, kind: str, **asked: Any) -> Measure:
    return _of_bodies(meaning, kind, at="contact", **asked)


def _of_large(meaning: str, kind: str, **asked: Any) -> Measure:
    return Measure(meaning, (kind,), large=True, **asked)


def _of_motions(meaning: str, kind: str, **asked: Any) -> Measure:
    return Measure(meaning, (kind,), motion=True, of="both", **asked)


# Stresses in the order of contactqp.elements.solid, and the equivalent one.
COMPONENTS = ("xx", "yy", "zz", "xy", "yz", "zx", "von-mises")
_WHOLE_PATH: dict[str, Any] = {"path": True, "whole_way": True}
_POINT: dict[str, Any] = {"counted": True, "whole_way": True}
_READ_OFF: dict[str, Any] = {"solved": False, "small": True}
QUANTITIES = {
    "displacement": Measure("displacement or rotation of an unknown", ("length", "angle"), at="unknown", rates=True),
    "normal force": Measure("force of a contact, positive in compression", ("force",), at="contact", rates=True),
    "total normal force": Measure("sum of the normal forces of all contacts", ("force",), rates=True),
    "gap": Measure("gap of a contact, positive when open", ("length",), at="contact", rates=True),
    "status": Measure(
        "open, closed or grazing; with friction open, stick, slip or grazing", words=STATUS_WORDS, at="contact"
    ),
    "uniqueness": Measure(
        "what the certificate says of other answers under the same load, with friction",
        words=(ONE_ANSWER, FORCES, SEVERAL, POSSIBLE, UNKNOWN),
        of="both",
        statics=True,
        small=True,
    ),
    "friction force": Measure(
        "component of lambda_T along an axis: what the node does to what it touches, along its own slip",
        ("force",),
        at="contact",
        along="axis",
        friction=True,
        rates=True,
    ),
    "slip": Measure(
        "component along an axis of the slip that a scene without a path makes from slip_origin",
        ("length",),
        at="contact",
        along="axis",
        friction=True,
        statics=True,
        small=True,
    ),
    "tie force": Measure("multiplier nu of a tie, K u + A' nu = f", ("force", "moment"), at="tie", rates=True),
    "reaction": Measure("force of a support on the body", ("force", "moment"), at="support", statics=True),
    **element_quantities(),
    "energy": Measure(
        "1/2 u'Ku - f'u, where bodies have prescribed unknowns with these; at large deformations elastic energy - f'u",
        ("energy",),
        of="both",
        rates=True,
    ),
    "elastic energy": Measure(
        "1/2 u'Ku on a load path or in a motion, by penalty methods with friction that of contact springs too; at "
        "large deformations that of all bars",
        ("energy",),
        path=True,
        of="both",
    ),
    "work of the loads": Measure("since the path or motion set out", ("energy",), path=True, of="both"),
    "dissipated energy": Measure("by friction since the path or motion set out", ("energy",), path=True, of="both"),
    "kinetic energy": _of_motions("1/2 v'Mv", "energy"),
    "total energy": _of_motions("kinetic and elastic energy", "energy"),
    "impact energy": _of_motions("energy that normal forces have taken since the motion set out", "energy"),
    "energy drift": _of_motions("energy that the scheme has added since the motion set out", "energy"),
    "velocity": Measure("velocity of an unknown", ("velocity", "angular velocity"), at="unknown", motion=True),
    "total momentum": _of_motions("momentum of all that moves, along an axis", "momentum", along="axis"),
    "momentum": _of_motions("m v of a bar, mass or body along an axis", "momentum", at="moving part", along="axis"),
    "contact impulse": _of_motions("normal forces of a contact times the steps they acted", "momentum", at="contact"),
    "free motions": Measure(
        "number of rigid motions that nothing drives and nothing holds",
        ("number",),
        of="both",
        statics=True,
        small=True,
    ),
    "closing load factor": Measure(
        "load factor at which a contact closes", ("number",), at="contact", statics=True, **_WHOLE_PATH
    ),
    "closing load": Measure(
        "load on `along` when it closes", ("force",), at="contact", along="unknown", statics=True, **_WHOLE_PATH
    ),
    "next event load factor": Measure(
        "load factor at which a contact next changes its state", ("number",), statics=True, small=True
    ),
    "event time": Measure(
        "pseudo-time of an event, in a motion its time; a side closes with its first node and opens with its last",
        ("number", "time"),
        at="contact",
        event=True,
        of="both",
        **_WHOLE_PATH,
    ),
    "event load": Measure(
        "load on `along` at an event of a contact",
        ("force",),
        at="contact",
        along="unknown",
        event=True,
        statics=True,
        **_WHOLE_PATH,
    ),
    "events": Measure("number of events of a contact, of all kinds", ("number",), at="contact", **_WHOLE_PATH),
    "stiffness": Measure("entry of K at two unknowns", ("stiffness",), at="unknown", along="unknown", **_READ_OFF),
    "tie matrix": Measure("the rows A of the ties, in the scene's units", ("number",), matrix=True, **_READ_OFF),
    "tie rank": Measure("number of independent ties", ("number",), **_READ_OFF),
    "reduced stiffness": Measure("T'KT on the masters", ("stiffness",), matrix=True, **_READ_OFF),
    "reduced load": Measure("T'(f - K b) on the masters", ("force",), matrix=True, **_READ_OFF),
    "load factor": _of_large("what the loads are multiplied by where it is asked", "number"),
    "load": _of_large("load on an unknown where it is asked", "force", at="unknown"),
    "limit load factor": _of_large("load factor at a limit point, where it is greatest or least", "number", **_POINT),
    "limit load": _of_large("load on an unknown at a limit point", "force", at="unknown", **_POINT),
    "limit displacement": _of_large("displacement of an unknown at a limit point", "length", at="unknown", **_POINT),
    "limit points": _of_large("number of limit points of the path", "number", whole_way=True),
    "snap-through load factor": _of_large("load factor at which load control jumps", "number", **_POINT),
    "snap-through load": _of_large("load on an unknown where load control jumps", "force", at="unknown", **_POINT),
    "snap-throughs": _of_large("number of jumps on the path", "number", whole_way=True),
    "node displacement": _of_bodies(
        "displacement of the node of a body at `near`, along an axis", "length", at="body", along="axis", near=True
    ),
    "node velocity": _of_bodies(
        "velocity of the node at `near`, along an axis", "velocity", at="body", along="axis", near=True, motion=True
    ),
    "stress": _of_bodies(
        "stress at the node at `near`, averaged over its elements, tension positive",
        "stress",
        at="elastic body",
        near=True,
        component=True,
    ),
    "contact force": _at_contact(
        "sum of the normal forces of a contact, each along its own normal, positive in compression", "force"
    ),
    "contact resultant": _at_contact(
        "sum of the normal forces of a contact as vectors, on the body or the slave, along an axis",
        "force",
        along="axis",
    ),
    "friction resultant": _at_contact(
        "sum of lambda_T of a contact as vectors along an axis: what the body or the slave does to what it touches",
        "force",
        along="axis",
        friction=True,
    ),
    "friction traction": _at_contact(
        "lambda_T per area at the contact's node at `near`, along an axis; projected as pressures are",
        "pressure",
        along="axis",
        near=True,
        friction=True,
    ),
    "stick half-width": _at_contact(
        "largest distance from `near`, the centre, to a node that sticks", "length", near=True, friction=True
    ),
    "sticking contacts": _at_contact("number of nodes of a contact that stick", "number", friction=True),
    "peak pressure": _at_contact(
        "largest pressure at the nodes of a contact: forces projected onto its side", "pressure"
    ),
    "contact pressure": _at_contact(
        "pressure at the contact's node at `near`: forces projected onto its side", "pressure", near=True
    ),
    "contact half-width": _at_contact(
        "largest distance from `near`, the centre, to a node that presses", "length", near=True
    ),
    "closed contacts": _at_contact("number of nodes of a contact that press", "number"),
    "node gap": _at_contact("gap of the contact's node at `near`, positive when open", "length", near=True),
    "support force": _of_bodies(
        "sum of the forces of a support on the body, along the support's axis", "force", at="support", statics=True
    ),
}


KNOBS = ("penalty", "perturbation")
# The parameters of derivatives: the kinds of their numbers, and what `of` refers to.
PARAMETERS: dict[str, tuple[tuple[str, ...], str | None]] = {
    "load factor": (("number",), None),
    "load": (("force", "moment"), "unknown"),
    "gap": (("length",), "contact"),
    "friction": (("number",), "contact"),
}


def _known_quantity(value: str) -> str:
    if value not in QUANTITIES:
        raise ValueError(no_such(value, QUANTITIES, "quantity"))
    return value


def _text(value: Any) -> str:
    """Return a number as text in the digits of the file, which state its precision."""
    if isinstance(value, bool | list | tuple | dict):
        raise ValueError(f'expected a number with its unit such as "41/31500 m", got {value}')
    return str(value)


def _tolerance(value: Any) -> Quantity:
    names = ("number", "length", "force", "moment", "stiffness", "pressure", "time", "velocity", "momentum")
    tolerance = read_quantity(value, [KINDS[name] for name in names])
    if tolerance.si <= 0:
        raise ValueError(f"expected a positive tolerance, got {value}")
    return tolerance


def _instant(value: Any) -> Fraction | Quantity:
    """Return a pseudo-time, which is a number, or a time, which has its unit."""
    time = read_quantity(value, [KINDS["number"], KINDS["time"]], roots=True)
    return time if any(time.dimension) else time.si


def _not_zero(value: int) -> int:
    if value == 0:
        raise ValueError("expected a number from 1 on, or from -1 on downwards, counted from the end, got 0")
    return value


Text = Annotated[str, PlainValidator(_text)]
QuantityName = Annotated[str, AfterValidator(_known_quantity)]


class Claim(Block):
    """A quantity of the answer, and the method and load for which it is claimed.

    Without `method` it is claimed of the exact answer, which every exact method must give. By default it holds at the
    full load, the end of a path. `load_factor` scales all loads instead; `time` is a pseudo-time of the path. Between
    the steps of the path a scene without friction is solved under the load of that time; with friction the answer
    depends on the path, and only its steps have one. In a motion `time` is a time and refers to the end of the last
    step before it.

    `event` is a change of a contact, "closed", "opened", "stick" or "slip", and `occurrence` counts those of one kind
    from 1, or from the end with -1 for the last. Limit points and snaps at large deformations are counted alike. Under
    displacement control `reached` selects the step by the controlled displacement.

    `with_respect_to` asks for the derivative of the quantity, in its unit over that of the parameter: the load factor,
    the load on the unknown `of`, or the gap or coefficient of friction of the contact `of`. Where the one-sided
    derivatives differ there is no value, and the message says why.
    """

    quantity: QuantityName
    at: Name | None = None  # the contact, unknown, bar or body that has it
    along: Name | None = None  # the unknown or axis in whose direction it is
    near: fields.Point | None = None  # the point of a body where it is
    component: Literal["xx", "yy", "zz", "xy", "yz", "zx", "von-mises"] | None = None
    unknowns: tuple[Name, ...] | None = None  # the order of the columns of a matrix
    load_factor: Number = Fraction(1)  # of a load path
    time: Annotated[Fraction | Quantity, PlainValidator(_instant)] | None = None
    reached: fields.Length | None = None
    with_respect_to: Literal["load factor", "load", "gap", "friction"] | None = None  # the parameter of a derivative
    of: Name | None = None  # the unknown or contact of the parameter
    event: Literal["closed", "opened", "stick", "slip"] | None = None  # of the contact, at which the claim holds
    occurrence: Annotated[int, Field(strict=True), AfterValidator(_not_zero)] = 1
    method: Name | None = None  # without it, all methods that promise exact answers
    penalty: KnobStiffness | None = None  # of that method
    perturbation: KnobStiffness | None = None  # likewise
    update: Literal["simultaneous", "uzawa"] | None = None  # likewise

    @cached_property
    def measure(self) -> Measure:
        """Return the entry of the quantity in `QUANTITIES`."""
        return QUANTITIES[self.quantity]

    @cached_property
    def kinds(self) -> list[Kind]:
        """Return the kinds of numbers that the value may have."""
        own, by = [KINDS[name] for name in self.measure.kinds], self.with_respect_to
        return own if by is None else [per(kind, KINDS[name]) for kind in own for name in PARAMETERS[by][0]]

    @cached_property
    def knobs(self) -> dict[str, Quantity | str]:
        """Return the options of the method that are stated."""
        stated = {name: getattr(self, name) for name in (*KNOBS, "update")}
        return {name: value for name, value in stated.items() if value is not None}

    @property
    def stated(self) -> list[Quantity]:
        """Return the numbers that are claimed."""
        return []

    @model_validator(mode="after")
    def _complete(self) -> Self:
        measure = self.measure
        wanted = {
            "at": measure.at and f"naming the {measure.at}",
            "along": measure.along and f"naming the {measure.along}",
            "near": "with a point" if measure.near else None,
            "component": "of the stress" if measure.component else None,
            "event": "of the contact" if measure.event else None,
        }
        for key, needed in wanted.items():
            if (getattr(self, key) is None) != (needed is None):
                what = f"'{key}' {needed}" if needed else f"no '{key}'"
                raise ValueError(f"the quantity {self.quantity!r} expects {what}")
        if self.unknowns is not None and not measure.matrix:
            raise ValueError(f"the quantity {self.quantity!r} expects no 'unknowns'")
        if self.occurrence != 1 and not (measure.event or measure.counted):
            raise ValueError(f"the quantity {self.quantity!r} expects no 'occurrence'")
        if self.time is not None and self.load_factor != 1:
            raise ValueError("expected 'time' or 'load_factor', got both")
        if self.reached is not None and (self.time is not None or self.load_factor != 1):
            raise ValueError("expected 'reached' or a load factor, got both")
        if self.knobs and self.method is None:
            raise ValueError(f"{next(iter(self.knobs))!r} expects 'method', whose knob it is")
        self._derivative_fits()
        return self

    def _derivative_fits(self) -> None:
        """Raise ValueError for a quantity without derivatives, or a derivative without its parameter."""
        by = self.with_respect_to
        if by is not None and not self.measure.rates:
            own = ", ".join(repr(name) for name, measure in QUANTITIES.items() if measure.rates)
            raise ValueError(f"the quantity {self.quantity!r} expects no 'with_respect_to'; derivatives have {own}")
        if by is not None and self.method is not None:
            raise ValueError("'with_respect_to' expects no 'method': derivatives are those of the exact answer")
        needed = None if by is None else PARAMETERS[by][1]
        if (self.of is None) != (needed is None):
            what = f"'of' naming the {needed}" if needed else "no 'of'"
            raise ValueError(f"with_respect_to = {by!r} expects {what}" if by else "'of' expects 'with_respect_to'")

    def __str__(self) -> str:
        where = f" {self.at}" if self.at else ""
        where = f" {self.component}{where}" if self.component else where
        where += f" near ({', '.join(map(str, self.near))})" if self.near else ""
        where += f" along {self.along}" if self.along else ""
        which = f" (number {self.occurrence})" if self.occurrence > 1 else ""
        if self.occurrence < 0:
            which = " (the last)" if self.occurrence == -1 else f" ({-self.occurrence} from the end)"
        where += f" of {self.event!r}{which}" if self.event is not None else which
        if self.with_respect_to is not None:
            where += f" with respect to {self.with_respect_to}" + (f" of {self.of}" if self.of else "")
        if self.reached is not None:
            return f"{self.quantity}{where} where {self.reached} is reached"
        if self.time is not None:
            return f"{self.quantity}{where} at time {self.time}"
        return self.quantity + where + (f" at load factor {self.load_factor}" if self.load_factor != 1 else "")


class Expectation(Claim):
    """The exact value of a quantity, the tolerance of the answer, and the derivation of the value."""

    value: Text | None = None  # the exact value with its unit
    rows: Annotated[tuple[Annotated[tuple[Text, ...], SOME], ...], SOME] | None = None
    unit: Text = ""  # of the numbers in `rows`
    # Relative to |value|, or absolute with a unit; by default a few rounding errors.
    tolerance: Annotated[Quantity, PlainValidator(_tolerance), Field(validate_default=True)] = "1e-12"  # type: ignore[assignment]
    derivation: Text  # how the value was derived

    @model_validator(mode="after")
    def _readable(self) -> Self:
        wanted, refused = ("rows", "value") if self.measure.matrix else ("value", "rows")
        if getattr(self, wanted) is None or getattr(self, refused) is not None:
            raise ValueError(f"the quantity {self.quantity!r} expects {wanted!r} and no {refused!r}")
        if not self.kinds:
            for word in str(self.value).split("; "):
                if word not in self.measure.words:
                    raise ValueError(f"value: {no_such(word, self.measure.words, self.quantity)}")
            return self
        for target in self.targets:
            if any(self.tolerance.dimension) and self.tolerance.dimension != target.dimension:
                raise ValueError(f"tolerance: expected a part of the value, or one in its unit, got {self.tolerance}")
            if target.si == 0 and self.tolerance.dimension != target.dimension and not self.measure.matrix:
                raise ValueError('tolerance: expected one with a unit such as "1e-15 m", since the value is zero')
        return self

    @cached_property
    def targets(self) -> list[Quantity]:
        """Return the exact values, row by row."""
        texts = [self.value] if self.rows is None else [f"{text} {self.unit}" for row in self.rows for text in row]
        return [read_quantity(text, self.kinds, roots=True) for text in texts]

    @property
    def stated(self) -> list[Quantity]:
        """Return the numbers that are claimed; none for words."""
        return self.targets if self.kinds else []


class Published(Claim):
    """A number that the source prints, and whether it is right.

    The number is compared with the exact answer, or with that of the stated `method`, to half a unit of its last digit.
    """

    printed: Text
    verdict: Literal["right", "wrong"]
    where: Text
    why: Text
    erratum: Text | None = None

    @model_validator(mode="after")
    def _readable(self) -> Self:
        if self.measure.matrix or not self.kinds:
            raise ValueError(f"quantity: expected one that is a single number, got {self.quantity!r}")
        self.target, self.half_digit  # noqa: B018  refused here if they cannot be read
        return self

    @cached_property
    def target(self) -> Quantity:
        """Return the printed number."""
        return read_quantity(self.printed, self.kinds)

    @property
    def stated(self) -> list[Quantity]:
        """Return the printed number."""
        return [self.target]

    @cached_property
    def half_digit(self) -> Quantity:
        """Return half a unit of the last printed digit."""
        number, _, unit = self.printed.partition(" ")
        mantissa, _, exponent = number.lower().partition("e")
        digits = len(mantissa.partition(".")[2])
        try:
            return read_quantity(f"0.5e{int(exponent or 0) - digits} {unit}", self.kinds)
        except ValueError:
            raise NotANumber(f"printed: expected a plain decimal with its unit, got {self.printed!r}") from None


class Remark(Block):
    """A sentence or formula of the source without a number of its own, and whether it is right."""

    statement: Text
    verdict: Literal["right", "wrong"]
    where: Text
    why: Text
    erratum: Text | None = None


class Study(Block):
    """A method and the values of its parameter that a report sweeps."""

    method: Name
    penalty: tuple[KnobStiffness, ...] = ()
    perturbation: tuple[KnobStiffness, ...] = ()
    tolerance: tuple[Number, ...] = ()
    update: Literal["simultaneous", "uzawa"] | None = None

    @model_validator(mode="after")
    def _one_knob(self) -> Self:
        given = [name for name in (*KNOBS, "tolerance") if getattr(self, name)]
        if len(given) != 1:
            raise ValueError(f"expected the values of one knob (penalty, perturbation or tolerance), got {len(given)}")
        return self

    @property
    def knob(self) -> tuple[str, tuple[Quantity | Fraction, ...]]:
        """Return the name and the values of the parameter."""
        return next((name, getattr(self, name)) for name in (*KNOBS, "tolerance") if getattr(self, name))

    @property
    def options(self) -> dict[str, str]:
        """Return the options of the method besides that parameter."""
        return {} if self.update is None else {"update": self.update}


class Report(Block):
    """The methods that a report tries on the case, where all would take too long, and the reason for the choice."""

    methods: Annotated[tuple[Name, ...], SOME]
    why: Text
