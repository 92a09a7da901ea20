"""What a case says about its answer: exact expectations, printed numbers with our verdict, and the knobs to sweep."""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, PlainValidator, model_validator

from contactqp.scene import fields
from contactqp.scene.expression import NotANumber
from contactqp.scene.fields import Block, KnobStiffness, Name, Number
from contactqp.scene.quantities import QUANTITIES, Measure
from contactqp.scene.units import KINDS, Kind, Quantity, read_quantity
from contactqp.scene.wording import unknown

KNOBS = ("penalty", "perturbation")


def _known_quantity(value: str) -> str:
    if value not in QUANTITIES:
        raise ValueError(unknown(value, QUANTITIES, "quantity"))
    return value


def _text(value: Any) -> str:
    """Numbers are kept as they were written: their digits say how exact they are."""
    if isinstance(value, bool | list | tuple | dict):
        raise ValueError(f'expected a number with its unit such as "41/31500 m", got {value}')
    return str(value)


def _tolerance(value: Any) -> Quantity:
    kinds = [
        KINDS[name]
        for name in ("number", "length", "force", "moment", "stiffness", "pressure", "time", "velocity", "momentum")
    ]
    tolerance = read_quantity(value, kinds)
    if tolerance.si <= 0:
        raise ValueError(f"expected a positive tolerance, got {value}")
    return tolerance


def _instant(value: Any) -> Fraction | Quantity:
    """A pseudo-time is a number, a time has its unit."""
    time = read_quantity(value, [KINDS["number"], KINDS["time"]], roots=True)
    return time if any(time.dimension) else time.si


def _not_zero(value: int) -> int:
    if value == 0:
        raise ValueError("expected a number from 1 on, or from -1 on downwards, counted from the end, got 0")
    return value


Text = Annotated[str, PlainValidator(_text)]
QuantityName = Annotated[str, AfterValidator(_known_quantity)]


class Claim(Block):
    """A quantity of the answer, and the method and load it is asked of.

    Without `method` it is the exact answer, which every method that promises exactness must give. It is asked at the
    full load, the end of a path. `load_factor` scales all loads instead, and `time` is a pseudo-time of the path; where
    no step of the path stands there, a scene without friction is solved under that load. With friction the answer
    depends on the way to it, and only the steps of the path have one. In a motion `time` is a time: meant is the end of
    the last step that is over then.

    `event` is a change of a contact, "closed", "opened", "stick" or "slip", and `occurrence` which of those of one
    kind, counted from 1, or from the end, the last being -1. Limit points and snaps at large deformations are counted
    alike. Where an unknown is controlled there, `reached` is its displacement at the step that is meant.
    """

    quantity: QuantityName
    at: Name | None = None
    along: Name | None = None
    near: fields.Point | None = None
    component: Literal["xx", "yy", "zz", "xy", "yz", "zx", "von-mises"] | None = None
    unknowns: tuple[Name, ...] | None = None  # the order of a matrix's columns
    load_factor: Number = Fraction(1)
    time: Annotated[Fraction | Quantity, PlainValidator(_instant)] | None = None
    reached: fields.Length | None = None
    event: Literal["closed", "opened", "stick", "slip"] | None = None
    occurrence: Annotated[int, Field(strict=True), AfterValidator(_not_zero)] = 1
    method: Name | None = None
    penalty: KnobStiffness | None = None
    perturbation: KnobStiffness | None = None
    update: Literal["simultaneous", "uzawa"] | None = None

    @property
    def measure(self) -> Measure:
        return QUANTITIES[self.quantity]

    @property
    def kinds(self) -> list[Kind]:
        return [KINDS[name] for name in self.measure.kinds]

    @property
    def knobs(self) -> dict[str, Quantity | str]:
        """The options of the method that are stated."""
        stated = {name: getattr(self, name) for name in (*KNOBS, "update")}
        return {name: value for name, value in stated.items() if value is not None}

    @property
    def stated(self) -> list[Quantity]:
        """The numbers that are claimed."""
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
        return self

    def __str__(self) -> str:
        where = f" {self.at}" if self.at else ""
        where = f" {self.component}{where}" if self.component else where
        where += f" near ({', '.join(map(str, self.near))})" if self.near else ""
        where += f" along {self.along}" if self.along else ""
        which = f" (number {self.occurrence})" if self.occurrence > 1 else ""
        if self.occurrence < 0:
            which = " (the last)" if self.occurrence == -1 else f" ({-self.occurrence} from the end)"
        where += f" of {self.event!r}{which}" if self.event is not None else which
        if self.reached is not None:
            return f"{self.quantity}{where} where {self.reached} is reached"
        if self.time is not None:
            return f"{self.quantity}{where} at time {self.time}"
        return self.quantity + where + (f" at load factor {self.load_factor}" if self.load_factor != 1 else "")


class Expectation(Claim):
    """The exact value, how close the answer must come, and where the value is from."""

    value: Text | None = None
    rows: tuple[tuple[Text, ...], ...] | None = None
    unit: Text = ""  # of the numbers in `rows`
    # Relative to |value|, or absolute with a unit. Twelve digits: a few rounding errors of a small system.
    tolerance: Annotated[Quantity, PlainValidator(_tolerance), Field(validate_default=True)] = "1e-12"  # type: ignore[assignment]
    derivation: Text

    @model_validator(mode="after")
    def _readable(self) -> Self:
        wanted, refused = ("rows", "value") if self.measure.matrix else ("value", "rows")
        if getattr(self, wanted) is None or getattr(self, refused) is not None:
            raise ValueError(f"the quantity {self.quantity!r} expects {wanted!r} and no {refused!r}")
        if not self.kinds:
            for word in str(self.value).split("; "):
                if word not in self.measure.words:
                    raise ValueError(f"value: {unknown(word, self.measure.words, self.quantity)}")
            return self
        for target in self.targets:
            if target.si == 0 and self.tolerance.dimension != target.dimension and not self.measure.matrix:
                raise ValueError('tolerance: expected one with a unit such as "1e-15 m", since the value is zero')
        return self

    @property
    def targets(self) -> list[Quantity]:
        """The exact values, row by row."""
        texts = [self.value] if self.rows is None else [f"{text} {self.unit}" for row in self.rows for text in row]
        return [read_quantity(text, self.kinds, roots=True) for text in texts]

    @property
    def stated(self) -> list[Quantity]:
        return self.targets if self.kinds else []


class Published(Claim):
    """What the source prints, and whether that is right.

    The number is held against our exact answer, or against that of the `method` it states, to half a unit of its last
    digit.
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

    @property
    def target(self) -> Quantity:
        return read_quantity(self.printed, self.kinds)

    @property
    def stated(self) -> list[Quantity]:
        return [self.target]

    @property
    def half_digit(self) -> Quantity:
        """Half a unit of the last printed digit."""
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
    """A method and the values of its knob that a report sweeps."""

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
        """Its name and values."""
        return next((name, getattr(self, name)) for name in (*KNOBS, "tolerance") if getattr(self, name))

    @property
    def options(self) -> dict[str, str]:
        """What the method is told besides its knob."""
        return {} if self.update is None else {"update": self.update}


class Report(Block):
    """The methods that a report tries on the case, where all of them would take too long, and why those."""

    methods: Annotated[tuple[Name, ...], Field(min_length=1)]
    why: Text
