"""What is tried on the contact unknowns, on all of them, or not at all, and said so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.model.problem import ContactProblem
from contactqp.solving import methods as registry
from contactqp.solving.methods import find
from contactqp.study import settings
from contactqp.study.case_study import CaseStudy, load_studies
from contactqp.study.comparison import attempt

CASES = Path(__file__).parents[2] / "cases"


def _study(name: str, *methods: str) -> CaseStudy:
    (study,) = load_studies([CASES / f"{name}.toml"], settings.chosen_methods(methods), (1e-3, 1e-9))
    return study


def _chain(size: int) -> ContactProblem:
    from scipy.sparse import diags

    row = np.zeros((1, size))
    row[0, 0] = -1.0
    chain = diags([-1.0, 2.0, -1.0], [-1, 0, 1], shape=(size, size), format="csc")
    return ContactProblem(stiffness=chain, load=-np.ones(size), normal=row, gap=[0.0])


def test_where_there_is_an_interior_every_setting_is_tried_on_all_unknowns_too() -> None:
    study = _study("patch_two_blocks", "active-set", "osqp", "penalty")
    whole = [setting for setting in study.settings if setting.whole]
    usual = [setting for setting in study.settings if not setting.whole]
    assert [(r.method.name, r.variant, r.value) for r in whole] == [
        (r.method.name, r.variant, r.value) for r in usual if r.method.name != "active-set"
    ]
    assert study.left_out == ()


def test_a_small_interior_is_worth_the_default_alone() -> None:
    study = _study("cantilever_stop", "active-set", "osqp", "penalty", "lagrange-multiplier")
    whole = [setting for setting in study.settings if setting.whole]
    assert [(r.method.name, r.variant, r.value) for r in whole] == [
        ("osqp", "polished", 1e-9),
        ("osqp", "raw", 1e-9),
        ("lagrange-multiplier", "", None),
    ]
    assert "2 of 3 unknowns" in study.left_out[0]


def test_rows_say_on_which_unknowns() -> None:
    study = _study("cantilever_stop", "active-set", "osqp")
    truth = study.truth()
    active, osqp, whole = (
        study.settings[0],
        study.settings[1],
        next(setting for setting in study.settings if setting.whole),
    )
    row = attempt(study.problem, whole, truth)
    assert (row.condensed, row.verdict, row.unknowns, row.contacts) == ("no", "right", 3, 1)
    assert attempt(study.problem, osqp, truth).condensed == "yes"
    assert attempt(study.problem, active, truth).condensed == ""  # the active set works on contacts by itself


@pytest.mark.parametrize("name", ["two_bars", "klarbring_slides_back", "bar_impact"])
def test_where_nothing_is_condensed_there_is_no_second_way(name: str) -> None:
    settings = _study(name, "active-set", "osqp").settings
    assert settings
    assert not any(setting.whole for setting in settings)


def test_bodies_that_float_are_condensed_where_nothing_lies_inside() -> None:
    assert any(setting.whole for setting in _study("tie_beam_section", "osqp").settings)


def test_large_problems_are_left_out_in_the_open() -> None:
    methods = [find("clarabel"), find("daqp")]
    values = {}
    for size in (3, 30, 1100, 10100):
        problem = _chain(size)
        tried = [setting for method in methods for setting in settings.all_settings(problem, method)]
        values[size] = [(r.method.name, r.value) for r in settings.on_all_unknowns(problem, tried)]
        assert bool(settings.note_on_all_unknowns(problem, methods)) == (size != 30)
    assert values[3] == [("clarabel", 1e-9), ("clarabel", 1e-9), ("daqp", 1e-9), ("daqp", 1e-9)]
    assert len(values[30]) == 16
    assert values[1100] == [("clarabel", 1e-9), ("clarabel", 1e-9)]
    assert values[10100] == []


def test_a_study_says_what_it_leaves_out() -> None:
    assert _study("two_bars", "osqp").left_out == ()
    said = _study("hertz_line", "active-set", "clarabel").left_out
    assert len(said) == 2
    assert said[0].startswith("only active-set, clarabel")
    assert "4961 unknowns" in said[1]


def test_a_missing_method_is_asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    absent = replace(find("osqp"), name="absent", packages=("no_package_of_this_name",))
    monkeypatch.setitem(registry._REGISTRY, absent.name, absent)
    assert len(_study("cantilever_stop", "osqp").settings) > 1
    for method in (method for method in cq.methods() if not method.installed):
        assert [setting.whole for setting in _study("cantilever_stop", method.name).settings] == [False]
