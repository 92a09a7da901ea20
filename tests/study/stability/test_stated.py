"""Only what the certificate says of an error excuses it."""

from __future__ import annotations

import dataclasses

import pytest

import contactqp as cq
from contactqp.certificate.uniqueness import FORCES, POSSIBLE, SEVERAL, UNKNOWN
from contactqp.model.solution import Solution
from contactqp.study.stability.axis_problem import SweptTruth, certificate_statement
from contactqp.study.stability.stability_cells import find_axis


def saying(solution: Solution, **said: object) -> Solution:
    return dataclasses.replace(solution, certificate=dataclasses.replace(solution.certificate, **said))


@pytest.fixture
def corner() -> tuple[SweptTruth, Solution]:
    """Two contacts that an angle of 2^-43 tells apart: (0, 8) for (3, 5)."""
    posed = find_axis("redundancy").pose(2.0**-43)
    return posed.truth, cq.solve(posed.problem)


def test_forces_whose_sum_is_right_are_stated(corner: tuple[SweptTruth, Solution]) -> None:
    truth, solution = corner
    assert "redundant" in certificate_statement(truth, solution)
    assert certificate_statement(truth, saying(solution, reasons=(), uniqueness=(FORCES,)))
    assert not certificate_statement(truth, saying(solution, reasons=()))
    assert not certificate_statement(truth, saying(solution, reasons=("force_bound: too many",)))


def test_a_wrong_displacement_is_not_excused_by_redundant_forces(corner: tuple[SweptTruth, Solution]) -> None:
    truth, solution = corner
    assert not certificate_statement(truth, dataclasses.replace(solution, displacement=2 * solution.displacement))


def test_other_answers_that_are_possible_excuse_nothing() -> None:
    posed = find_axis("friction").pose(0.5)
    solution = cq.solve(posed.problem)
    wrong = dataclasses.replace(solution, normal_force=2 * solution.normal_force)
    assert certificate_statement(posed.truth, saying(wrong, uniqueness=(SEVERAL,)))
    for said in (POSSIBLE, UNKNOWN, FORCES):
        assert not certificate_statement(posed.truth, saying(wrong, uniqueness=(said,)))
