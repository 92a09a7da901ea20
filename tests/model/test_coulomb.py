"""The states of contacts, and their combinations."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import contactqp as cq
from contactqp.model.coulomb import (
    OPEN,
    SIDES,
    SLIP_BACK,
    SLIP_ON,
    STICK,
    all_combinations,
    combinations_at,
    resisting_rows,
)


def test_a_contact_without_friction_has_two_states_in_floats_and_fractions() -> None:
    expected = [(a, b) for a in (OPEN, STICK, SLIP_BACK, SLIP_ON) for b in (OPEN, SLIP_ON)]
    assert list(all_combinations([0.3, 0.0])) == list(all_combinations([Fraction(3, 10), Fraction(0)])) == expected


def test_contacts_without_a_choice_keep_their_state() -> None:
    status = np.array([STICK, OPEN, SLIP_ON], dtype=np.int8)
    found = list(combinations_at(np.array([2, 0]), [(OPEN, SLIP_BACK), (STICK,)], status))
    assert [one.tolist() for one in found] == [[STICK, OPEN, OPEN], [STICK, OPEN, SLIP_BACK]]
    assert status.tolist() == [STICK, OPEN, SLIP_ON]


@pytest.mark.parametrize("width", [1, 2])
def test_polygons_lie_around_and_within_the_cone_of_what_resists_a_motion(width: int) -> None:
    """A contact resists z where E_N z + mu |E_T z| > 0; the two polygons are 1 / cos(pi / SIDES) apart in space."""
    rng = np.random.default_rng(3)
    normal, tangent, friction = rng.standard_normal((3, 5)), rng.standard_normal((3 * width, 5)), [0.3, 0.0, 2.0]
    problem = cq.ContactProblem(np.eye(5), np.ones(5), normal, np.ones(3), tangent=tangent, friction=friction)
    apart = 1.0 if width == 1 else np.cos(np.pi / SIDES)
    corners, sides = resisting_rows(problem), resisting_rows(problem, within=False)
    assert corners.shape == sides.shape == (1 + 2 * (2 if width == 1 else SIDES), 5)
    for z in rng.standard_normal((20, 5)):
        slip = np.linalg.norm((tangent @ z).reshape(3, width), axis=1)
        without = (normal @ z)[1]
        for rows, least, most in ((corners, 1.0, 1 / apart), (sides, apart, 1.0)):
            felt = rows @ z
            assert felt[0] == pytest.approx(without, rel=1e-12)
            of_contacts = felt[1:].reshape(-1, 2).max(axis=0) - (normal @ z)[[0, 2]]
            bound = np.array([0.3, 2.0]) * slip[[0, 2]]
            assert np.all(of_contacts >= (least - 1e-12) * bound)
            assert np.all(of_contacts <= (most + 1e-12) * bound)
