"""What a deck states is read, refused by its line, or told to be without effect: nothing in silence."""

from __future__ import annotations

import pathlib

import numpy as np
import pytest

from contactqp.errors import InvalidProblem
from contactqp.exchange.deck.cards import KEYWORDS, Effect
from contactqp.exchange.deck.reading import read_deck_model
from tests.decks import STACK, write


def refusal(folder: pathlib.Path, text: str) -> str:
    with pytest.raises(InvalidProblem) as caught:
        read_deck_model(write(folder, text))
    message = str(caught.value)
    assert "\n" not in message
    assert "model.inp" in message
    return message


def test_a_deck_is_read_as_it_stands(tmp_path: pathlib.Path) -> None:
    model = read_deck_model(write(tmp_path, STACK))
    assert model.labels.tolist() == [*range(1, 9), *range(11, 19)]
    assert model.points[8].tolist() == [0.0, 0.0, 1.01]
    assert [(group.type, group.labels.tolist()) for group in model.elements] == [("C3D8", [1, 2])]
    assert model.node_sets["TOP"].tolist() == [15, 16, 17, 18]
    assert (model.materials["STEEL"].modulus, model.materials["STEEL"].density) == (1000.0, 2.0)
    assert model.surfaces["ABOVE"].faces is not None
    assert model.pairs[0].name == "ABOVE on BELOW"
    assert model.interactions["TOUCH"].stiffness == 1e4
    assert model.loading.supports[-1].value == -0.02


def test_case_blanks_tabs_and_line_ends_mean_nothing(tmp_path: pathlib.Path) -> None:
    there = read_deck_model(write(tmp_path, STACK.replace(", ", " ,\t").replace("\n", "\r\n").lower()))
    assert there.labels.tolist() == read_deck_model(write(tmp_path, STACK)).labels.tolist()
    assert there.pairs[0].name == "ABOVE on BELOW"


def test_comments_and_continued_keywords_and_long_elements(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("*NODE, NSET=ALL", "** a comment, with *NODE\n*NODE,\nNSET=ALL")
    text = text.replace("1, 1, 2, 3, 4, 5, 6, 7, 8", "1, 1, 2, 3, 4,\n5, 6, 7, 8")
    model = read_deck_model(write(tmp_path, text))
    assert model.elements[0].nodes[0].tolist() == [1, 2, 3, 4, 5, 6, 7, 8]
    assert len(model.node_sets["ALL"]) == 16


def test_included_files_are_looked_for_beside_the_deck(tmp_path: pathlib.Path) -> None:
    head, _, tail = STACK.partition("*MATERIAL")
    (tmp_path / "parts").mkdir()
    write(tmp_path / "parts", head, "Mesh.inp")
    model = read_deck_model(write(tmp_path, f"*INCLUDE, INPUT=parts/Mesh.inp\n*MATERIAL{tail}"))
    assert len(model.labels) == 16
    write(tmp_path / "parts", head.replace("C3D8", "C3D9"), "Mesh.inp")
    with pytest.raises(InvalidProblem, match=r"Mesh\.inp: line 20: \*ELEMENT: there are no elements C3D9"):
        read_deck_model(tmp_path / "model.inp")


def test_a_file_that_is_not_there_is_named_with_the_line_that_includes_it(tmp_path: pathlib.Path) -> None:
    said = refusal(tmp_path, STACK.replace("*MATERIAL", "*INCLUDE, INPUT=parts/steel.inp\n*MATERIAL"))
    assert "model.inp: line 27: *INCLUDE: there is no file " in said
    assert said.endswith("steel.inp")


def test_a_number_behind_the_elastic_constants_is_told(tmp_path: pathlib.Path) -> None:
    model = read_deck_model(write(tmp_path, STACK.replace("1000., 0.\n", "1,000., 0.\n")))  # a comma between thousands
    assert model.materials["STEEL"].modulus == 1.0
    assert any(
        "line 29: *ELASTIC: the temperature behind both constants, '0.'" in line for line in model.ledger.ignored
    )


def test_a_mark_of_the_order_of_bytes_is_no_text(tmp_path: pathlib.Path) -> None:
    (tmp_path / "model.inp").write_bytes(("\ufeff" + STACK.replace("two cubes", "zwei Würfel")).encode("utf-8"))
    assert len(read_deck_model(tmp_path / "model.inp").labels) == 16


@pytest.mark.parametrize("number", ["2.1D5", "2.1d+05", "2.1+5", "2.1E5", "21.+4", "+2.1+05", "210000"])
def test_numbers_are_those_of_fortran(tmp_path: pathlib.Path, number: str) -> None:
    model = read_deck_model(write(tmp_path, STACK.replace("1000., 0.\n", f"{number}, -1.-1\n")))
    assert (model.materials["STEEL"].modulus, model.materials["STEEL"].poisson) == (210_000.0, -0.1)


def test_files_that_include_each_other_are_refused(tmp_path: pathlib.Path) -> None:
    assert "circle" in refusal(tmp_path, "*INCLUDE, INPUT=model.inp\n")


MISTAKES = {
    "a keyword with a letter too few": (
        "*ELASTIC",
        "*ELASTC",
        "line 28: there is no keyword *ELASTC; the nearest one is *ELASTIC",
    ),
    "a parameter with a letter too few": (
        "MATERIAL=STEEL",
        "MATERAL=STEEL",
        "has no parameter MATERAL; the nearest one is MATERIAL",
    ),
    "a decimal comma": ("1000., 0.\n", '"1000,5", 0.\n', "line 29: *ELASTIC"),
    "a word in place of a number": ("1e4\n", "1ee4\n", "expected the stiffness of LINEAR, got '1EE4'"),
    "a number that is none": ("1000., 0.", "nan, 0.", "expected Young's modulus, finite"),
    "a set that is not there": ("TOP, 3, 3, -0.02", "TIP, 3, 3, -0.02", "got 'TIP'; the nearest one is TOP"),
    "a face without a number": ("2, S1", "2, SPOS", "line 36: *SURFACE: expected an element or a set, and a face"),
    "a node twice": ("12, 1., 0., 1.01", "11, 1., 0., 1.01", "node 11 stands twice"),
    "an element type with one point": ("C3D8,", "C3D8R,", "elements C3D8R: its forces against hourglasses"),
    "an element with too few nodes": ("16, 17, 18\n", "16, 17\n", "expected a label and 8 nodes for each C3D8"),
    "large displacements": ("*STEP", "*STEP, NLGEOM", "expected NLGEOM=NO or OFF"),
    "faces as elements beside bodies": (
        "*NSET, NSET=TOP",
        "*ELEMENT, TYPE=CPS4, ELSET=FACE\n7, 1, 2, 3, 4\n*NSET, NSET=TOP",
        "line 23: *ELEMENT: elements CPS4 beside others of another number of dimensions",
    ),
    "an interference by itself": (
        "*BOUNDARY\nBOTTOM",
        "*CONTACT INTERFERENCE\n1.\n*BOUNDARY\nBOTTOM",
        "*CLEARANCE, VALUE=-",
    ),
    "a table in the place of contact": ("=LINEAR", "=TABULAR", "are not Signorini contact; in the place of TIED take"),
    "an amplitude that is not there": (
        "*BOUNDARY\nTOP",
        "*BOUNDARY, AMPLITUDE=UP\nTOP",
        "expected an amplitude that is defined above, got 'UP'",
    ),
    "friction without a bound": ("1e4\n*CONT", "1e4\n*FRICTION, ROUGH\n*CONT", "ROUGH is not offered; state a coeff"),
    "a rigid line": ("NAME=BELOW", "NAME=BELOW, TYPE=SEGMENTS", "'SEGMENTS'; for a rigid surface take elements whose"),
    "local axes": (
        "*BOUNDARY\nBOTTOM",
        "*TRANSFORM, NSET=TOP\n1.\n*BOUNDARY\nBOTTOM",
        "*TRANSFORM: it is not offered; turn",
    ),
    "general contact": (
        "*BOUNDARY\nBOTTOM",
        "*CONTACT\n*BOUNDARY\nBOTTOM",
        "name each pair of surfaces by *CONTACT PAIR",
    ),
    "numbers that are computed": ("*MATERIAL", "*PARAMETER\nE=1.\n*MATERIAL", "*PARAMETER: numbers are not computed"),
    "another overclosure": ("=LINEAR", "=EXPONENTIAL", "expected PRESSURE-OVERCLOSURE=HARD or LINEAR"),
    "another procedure": ("*STATIC", "*DYNAMIC", "*DYNAMIC: the steps of a deck are *STATIC here"),
    "a plastic material": ("*DENSITY", "*PLASTIC", "materials are linear elastic"),
    "a load before the step": ("*STEP", "*CLOAD\nTOP, 3, 1.\n*STEP", "*CLOAD: expected it between *STEP and *END STEP"),
    "a deck that was cut off": ("*END STEP", "", "the file was cut off"),
    "a second step without an end": ("*END STEP", "*END STEP\n*STEP\n*STATIC", "the file was cut off"),
    "a second step without a procedure": ("*END STEP", "*END STEP\n*STEP\n*END STEP", "expected *STATIC in the step"),
    "a load behind the last step": ("*END STEP", "*END STEP\n*BOUNDARY\nTOP, 1, 1", "nothing but another *STEP"),
    "an interaction that is not there": ("INTERACTION=TOUCH", "INTERACTION=TUCH", "there is no interaction TUCH"),
    "a surface that is not there": ("ABOVE, BELOW", "ABOVE, FLOOR", "there is no surface FLOOR; it has BELOW, ABOVE"),
    "data behind a keyword that has none": (
        "*MATERIAL, NAME=STEEL\n",
        "*MATERIAL, NAME=STEEL\n1.\n",
        "expected no data",
    ),
    "a rotation that is not zero": ("TOP, 3, 3, -0.02", "TOP, 3, 5, -0.02", "got the rotation 4"),
    "a set of endless labels": ("15, 18\n", "1, 999999999999\n", "expected at most 10000000 labels"),
    "a step of zero": ("15, 18\n", "15, 18, 0\n", "expected a first and a last label and a step"),
    "an elastic law outside of a material": (
        "*BOUNDARY\nBOTTOM",
        "*ELASTIC\n1., 0.\n*BOUNDARY\nBOTTOM",
        "right behind *MATERIAL",
    ),
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_named_with_their_line(tmp_path: pathlib.Path, name: str) -> None:
    old, new, said = MISTAKES[name]
    assert old in STACK
    assert said in refusal(tmp_path, STACK.replace(old, new, 1))


def test_what_is_without_effect_stands_in_the_ledger(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("*STEP", "*STEP, INC=100, NLGEOM=NO").replace("*END STEP", "*EL FILE\nS\n*END STEP")
    ignored = read_deck_model(write(tmp_path, text)).ledger.ignored
    assert any("*STEP: INC" in line for line in ignored)
    assert any("line 51: *EL FILE: what is printed changes no answer" in line for line in ignored)
    assert any("line 1: *HEADING" in line for line in ignored)


def test_every_refused_keyword_is_refused_by_its_line(tmp_path: pathlib.Path) -> None:
    refused = [one.name for one in KEYWORDS.values() if one.effect is Effect.REFUSED]
    assert len(refused) > 80
    for name in refused:
        message = refusal(tmp_path, STACK.replace("*BOUNDARY", f"*{name}\n*BOUNDARY", 1))
        assert f"line 42: *{name}: " in message


def test_every_idle_keyword_is_told(tmp_path: pathlib.Path) -> None:
    idle = [one for one in KEYWORDS.values() if one.effect is Effect.IDLE]
    assert len(idle) > 10
    for keyword in idle:
        after = (
            "*ELASTIC\n1000., 0.\n" if keyword.name in ("EXPANSION", "CONDUCTIVITY", "SPECIFIC HEAT", "DAMPING") else ""
        )
        place = after or "*BOUNDARY\nBOTTOM"
        new = f"{after}*{keyword.name}, ANY=1\n1., 2.\n" + ("" if after else place)
        model = read_deck_model(write(tmp_path, STACK.replace(place, new, 1)))
        assert any(f"*{keyword.name}: {keyword.why}" in line for line in model.ledger.ignored)


def test_amplitudes_scale_loads_at_the_end_of_the_step(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("*STEP", "*AMPLITUDE, NAME=A\n0., 0., 1., 3., 4., 9.\n*STEP").replace(
        "*STATIC\n*BOUNDARY", "*STATIC\n0.1, 2.\n*BOUNDARY, AMPLITUDE=A"
    )
    assert read_deck_model(write(tmp_path, text)).loading.supports[-1].value == pytest.approx(-0.02 * 5)


def test_loads_equations_and_symmetry_are_read(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("BOTTOM, 1, 3", "BOTTOM, ENCASTRE\n11, XSYMM").replace(
        "*STEP", "*EQUATION\n3\n15, 3, 1., 16, 3, -0.5,\n17, 3, -0.5\n*STEP"
    )
    text = text.replace(
        "*END STEP", "*CLOAD\nTOP, 1, 2.5\n*DLOAD\nSOLID, GRAV, 9.81, 0., 0., -2.\n2, P2, 4.\n*END STEP"
    )
    model = read_deck_model(write(tmp_path, text))
    assert [one.axis for one in model.loading.supports[:4]] == [0, 1, 2, 0]
    assert model.equations[0].coefficients.tolist() == [1.0, -0.5, -0.5]
    assert model.loading.forces[0].value == 2.5
    assert np.allclose(model.loading.accelerations[0].vector, [0.0, 0.0, -9.81])
    assert (model.loading.pressures[0].faces.face.tolist(), model.loading.pressures[0].value) == ([2], 4.0)


def test_numbers_that_calculix_cuts_off_are_told(tmp_path: pathlib.Path) -> None:
    text = STACK.replace("TOP, 3, 3, -0.02", "TOP, 3, 3, -2.00000000000000e-02")
    whole, cut = read_deck_model(write(tmp_path, text)), read_deck_model(write(tmp_path, text), columns=20)
    assert whole.loading.supports[-1].value == -0.02
    assert cut.loading.supports[-1].value == -2.0
    assert any("CalculiX reads the first 20" in line for line in whole.ledger.assumed)
