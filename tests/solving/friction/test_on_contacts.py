"""Combinations near the best iterate, tried where no algorithm of the local form comes to an answer."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.solving.friction import on_contacts
from contactqp.solving.friction.iterate import Deadline


def held_by_friction_alone() -> cq.ContactProblem:
    """Two contacts in space; nothing but their friction could hold the first unknown, and it is too little."""
    return cq.ContactProblem(
        stiffness=np.array([[0, 0, 0, 0], [0, 7, 0, 0], [0, 0, 9, 4], [0, 0, 4, 5]], dtype=float),
        load=np.array([0.68, 0.96, 0.57, -0.72]),
        normal=np.array([[0, 1, 0, 0], [0, 4, 0, 0]], dtype=float),
        gap=np.array([0.0, 0.3]),
        tangent=np.array([[-4, 6, 2, 3], [-2, 2, 1, 0], [-4, 6, 2, 3], [-2, 2, 1, 0]]) / 4,
        friction=np.full(2, 0.125),
    )


def refusal() -> str:
    with pytest.raises(cq.NotConverged) as refused:
        cq.solve(held_by_friction_alone())
    return str(refused.value)


def test_every_combination_is_tried_where_there_is_time() -> None:
    assert "all 9 combinations, refined from there, fail as well" in refusal()


class ThreeLooks(Deadline):
    """A budget that is over at the fourth look at it."""

    looks = 0

    @property
    def passed(self) -> bool:
        self.looks += 1
        return self.looks > 3


def test_a_budget_that_ends_says_how_many_were_tried_and_how_to_have_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(on_contacts, "Deadline", ThreeLooks)
    assert "the 3 nearest of 9 combinations fail as well; a longer time_limit tries more" in refusal()
