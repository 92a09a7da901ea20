"""Algorithms of friction from outside are algorithms like ours."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import contactqp as cq
from contactqp.certificate.coulomb_law import natural_map
from contactqp.solving.friction.algorithms import ALGORITHMS, Algorithm, register
from contactqp.solving.friction.convex_steps import ConvexSteps
from contactqp.solving.friction.local_form import Iterate, LocalForm
from tests.examples import truss


def _damped(form: LocalForm, _: ConvexSteps | None, start: Iterate) -> Iterator[Iterate]:
    force = start.force
    for count in range(1, 1000):
        force = force - natural_map(force, form.velocity(force, start.joint_force), form.mu) / 2
        yield Iterate.at(form, force, start.joint_force, count)


@pytest.fixture
def _registered() -> Iterator[None]:
    before = dict(ALGORITHMS)
    register(Algorithm("damped", _damped, False, 1000, 100, "the natural map, damped"))
    yield
    ALGORITHMS.clear()
    ALGORITHMS.update(before)


@pytest.mark.usefixtures("_registered")
def test_it_solves_bodies_and_local_problems_by_its_name() -> None:
    problem = truss(tangent=[[1.0, 0.0]], friction=0.3, slip_origin=[8e-4])
    solution = cq.solve(problem, algorithm="damped")
    assert solution.method == "damped"
    assert solution.certificate.passed
    assert solution.normal_force == pytest.approx(cq.solve(problem).normal_force, rel=1e-12)
    local = cq.LocalProblem(delassus=[[1.0, 2.0], [2.0, 5.0]], offset=[-7.0, -17.0], friction=0.8, dimension=2)
    assert np.allclose(cq.solve(local, algorithm="damped").force, [[2.692307692307692, 2.153846153846154]], rtol=1e-9)


@pytest.mark.usefixtures("_registered")
def test_an_unknown_name_is_refused_with_those_that_exist() -> None:
    with pytest.raises(cq.InvalidProblem, match="damped, enumeration, associated or None, got 'dampd'"):
        cq.solve(truss(tangent=[[1.0, 0.0]], friction=0.3), algorithm="dampd")


@pytest.mark.usefixtures("_registered")
@pytest.mark.parametrize("name", ["damped", "nsgs", "enumeration"])
def test_a_name_that_is_taken_is_refused(name: str) -> None:
    with pytest.raises(cq.InvalidProblem, match="which another one has"):
        register(Algorithm(name, _damped, False, 10, 10, ""))
