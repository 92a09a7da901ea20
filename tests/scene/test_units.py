"""Numbers in a case file are exact, and every one carries a unit of the right dimension."""

import math
import re
from fractions import Fraction as F

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contactqp.scene.blocks import UnitNames
from contactqp.scene.units import (
    KINDS,
    NotANumber,
    UnitSystem,
    quantity_pattern,
    read_number,
    read_quantity,
    split_number,
)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("1 mm", "length", F(1, 1000)),
        ("15 cm^2", "area", F(3, 2000)),
        ("15 cm**2", "area", F(3, 2000)),
        ("210 GPa", "modulus", F(210 * 10**9)),
        ("300 kN", "force", F(300_000)),
        ("2.1e8 kN/m^2", "modulus", F(210 * 10**9)),
        ("5/7 m", "length", F(5, 7)),
        ("-0.1 m", "length", F(-1, 10)),
        ("(1 + 1/3) * 3 mm", "length", F(4, 1000)),
        ("2 kg", "mass", F(2)),
        ("2 t", "mass", F(2000)),
        ("9.81 m/s^2", "acceleration", F(981, 100)),
        ("20 kN m", "moment", F(20_000)),
        ("1 in", "length", F(254, 10_000)),
        ("1 lbf", "force", F(45359237, 10**8) * F(980665, 10**5)),
        ("3 mrad", "angle", F(3, 1000)),
        ("3 µm", "length", F(3, 10**6)),
        ("2 kilometers", "length", F(2000)),
        ("15 cm²", "area", F(15, 10**4)),
        ("2 m ^ 2 / m", "length", F(2)),
        ("1 kip", "force", F(1000) * F(45359237, 10**8) * F(980665, 10**5)),
        ("0.3", "number", F(3, 10)),
        ("20 microns", "length", F(1, 50000)),
        ("20 \u00b5m", "length", F(1, 50000)),  # the micro sign
        ("20 \u03bcm", "length", F(1, 50000)),  # the Greek letter
        ("10 feet", "length", F(3048, 1000)),
        ("10 inches", "length", F(254, 1000)),
        ("3 min", "time", F(180)),
        ("30 rad/min", "angular velocity", F(1, 2)),
    ],
)
def test_quantities_are_exact(text, kind, value):
    assert read_quantity(text, [KINDS[kind]]).si == value


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("15", "got '15', a number without a unit"),
        (15, "got 15, a number without a unit"),
        ("15 cm^2", "which is an area"),
        ("15 KN", r"the unit 'KN' is unknown \(nearest: kN\)"),
        ("15 furlongs", "the unit 'furlongs' is unknown"),
        ("15 kNm", r"got '15 kNm': the unit 'kNm' is unknown \(nearest: kN\*m\)"),
        ("m", "got 'm'"),
        ("", "got ''"),
        ("nan m", "got 'nan m'"),
        ("1/0 m", "divides by zero"),
        ("1e999999999 m", "out of range"),
        ("(1 m", "bracket is not closed"),
        ("(" * 60 + "1", "brackets inside each other"),
        ("1 m^99999999", "is not a unit"),
        ("1 cm^0", "is not a unit"),
        ("1 cm//m", "is not a unit"),
        ("1 Pas", r"the unit 'Pas' is unknown \(nearest: Pa\*s\)"),
        ("1 __import__('os')", "is not a unit"),
        ("sqrt(2) m", "got"),
        (True, "got true"),
        ([1], "got a list"),
        ({}, "got a table"),
        ("1" * 600, "a text of 600 characters"),
    ],
)
def test_what_is_no_length_is_refused(value, message):
    with pytest.raises(NotANumber, match=f'expected a length such as "2 m", .*{message}'):
        read_quantity(value, [KINDS["length"]])


@pytest.mark.parametrize(
    ("value", "kind", "cure"),
    [
        ("200 lb", "force", r"which is a mass \(nearest: lbf\)"),
        ("60 lbs/ft", "force per length", r"\(nearest: lbf/ft\)"),
        ("5 kg/cm^2", "pressure", r"\(nearest: kgf/cm\^2\)"),
        ("490 lbf/ft^3", "density", r"\(nearest: lb/ft\^3\)"),
    ],
)
def test_a_mass_in_place_of_a_weight_is_refused_with_the_unit_of_the_weight(value, kind, cure):
    with pytest.raises(NotANumber, match=cure):
        read_quantity(value, [KINDS[kind]])
    with pytest.raises(NotANumber, match=r"which is a mass$"):
        read_quantity("200 lb", [KINDS["length"]])


def test_minutes_are_no_length():
    with pytest.raises(NotANumber, match="time"):
        read_quantity("3 min", [KINDS["length"]])
    assert not re.match(quantity_pattern([KINDS["length"].dimension]), "3 min")


def test_a_scene_in_pounds_of_mass_is_refused_with_the_unit_of_force():
    with pytest.raises(ValueError, match=r"force: expected a unit of force, got 'lb' \(nearest: lbf\)"):
        UnitNames(length="in", force="lb")


@pytest.mark.parametrize("value", ["inf", float("inf"), float("nan"), None, "1 m", "3 4"])
def test_what_is_no_number_is_refused(value):
    with pytest.raises(NotANumber):
        read_number(value)


def test_a_float_means_the_digits_it_is_printed_with():
    assert read_number(0.1) == F(1, 10)


@pytest.mark.slow
@given(st.fractions(min_value=0, max_value=10**6, max_denominator=10**6))
def test_roots_are_exact_where_they_are_rational_and_close_elsewhere(value):
    square, _ = split_number(f"sqrt({value * value})", roots=True)
    assert square == value
    root, _ = split_number(f"sqrt({value})", roots=True)
    assert abs(root**2 - value) <= F(1, 10**90)
    assert math.isclose(float(root), math.sqrt(value), rel_tol=4e-16)


def test_units_of_a_scene_convert_and_name():
    system = UnitSystem(length="mm", force="kN")
    assert system.value(read_quantity("210 GPa", [KINDS["modulus"]])) == 210
    assert system.value(read_quantity("1 t", [KINDS["mass"]])) == F(1, 1000)  # kN s^2 / mm
    assert system.label(KINDS["modulus"].dimension) == "kN/mm^2"
    assert system.label(KINDS["energy"].dimension) == "kN*mm"
    assert UnitSystem("m", "N").label(KINDS["mass"].dimension) == "N*s^2/m"
    assert system.label(KINDS["number"].dimension) == ""


@pytest.mark.parametrize(
    ("text", "kind"),
    [("200 kips", "force"), ("3 lbs", "mass"), ("20 microns", "length"), ("2 \u03bcm", "length"), ("3 feet", "length")],
)
def test_editors_accept_the_plurals_that_are_read(text, kind):
    dimension = KINDS[kind].dimension
    assert read_quantity(text, [KINDS[kind]])
    assert re.match(quantity_pattern([dimension]), text)
    assert not re.match(quantity_pattern([dimension]), "3 kNs")


@pytest.mark.parametrize(
    ("text", "roots", "said"),
    [
        ("2*sqrt(3) kN", False, "no root here, where numbers are exact"),
        ("sqrt(3*pi) kN", True, "not a number from 'pi) kN' on: numbers are decimals, + - * /, brackets and sqrt(...)"),
        ("(3^2) kN", False, "not a number from '^2) kN' on: numbers are decimals, + - * / and brackets"),
        ("(3 kN", False, "whose bracket is not closed"),
    ],
)
def test_what_is_no_number_is_told_from_where_on_it_is_none(text: str, roots: bool, said: str) -> None:
    with pytest.raises(NotANumber) as refused:
        split_number(text, roots=roots)
    assert said in str(refused.value)
