"""The states of contacts, and their combinations."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from contactqp.model.coulomb import OPEN, SLIP_BACK, SLIP_ON, STICK, all_combinations, combinations_at


def test_a_contact_without_friction_has_two_states_in_floats_and_fractions() -> None:
    expected = [(a, b) for a in (OPEN, STICK, SLIP_BACK, SLIP_ON) for b in (OPEN, SLIP_ON)]
    assert list(all_combinations([0.3, 0.0])) == list(all_combinations([Fraction(3, 10), Fraction(0)])) == expected


def test_contacts_without_a_choice_keep_their_state() -> None:
    status = np.array([STICK, OPEN, SLIP_ON], dtype=np.int8)
    found = list(combinations_at(np.array([2, 0]), [(OPEN, SLIP_BACK), (STICK,)], status))
    assert [one.tolist() for one in found] == [[STICK, OPEN, OPEN], [STICK, OPEN, SLIP_BACK]]
    assert status.tolist() == [STICK, OPEN, SLIP_ON]
