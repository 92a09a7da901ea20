"""Friction at large deformation where the number of steps may matter: jumps, and contacts that land together."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from tests.analysis.arches import RISE, arch, arch_load, node_over


@pytest.mark.slow
@pytest.mark.parametrize("steps", [3, 10, 160])
def test_an_arch_that_snaps_onto_a_rough_floor_is_found_and_told_in_any_number_of_steps(steps: int) -> None:
    """Full steps of Newton's method, as friction takes them, go through the jump by chance alone."""
    floor = node_over(cq.Plane([0.0, -RISE / 2], [0.0, 1.0]))
    history = cq.large_deformation(arch(), [[0.0, -0.4]], floor, steps=steps, friction=0.1)
    np.testing.assert_allclose(history[-1].displacement, [0, -1.5 * RISE], atol=1e-15)
    assert history[-1].normal_force == pytest.approx(0.4 - arch_load(1.5 * RISE), rel=1e-10)
    (note,) = history.notes
    assert note.startswith("between the load factors ")
    assert "the body snaps, with friction" in note
    assert not history.snaps


@pytest.mark.parametrize(("steps", "count"), [(1, 1), (4, 0)])
def test_contacts_that_land_within_one_step_are_told(steps: int, count: int) -> None:
    """Two posts are pushed down and along, to a floor 0.05 below the one and 0.07 below the other."""
    nodes = [[0, 1.0], [3, 1.02], [0, 4], [3, 4], [-2, 1.0], [5, 1.02]]
    bars = [[0, 2], [1, 3], [0, 4], [1, 5]]
    posts = cq.NonlinearTruss(nodes, bars, modulus=100.0, area=1.0, law="engineering")
    floor = cq.ObstacleContact(nodes[:2], cq.Plane([0, 0.95], [0, 1]))
    body, load = cq.Supported(posts, held=range(4, 12)), [2.0, -8.0, 2.0, -8.0]
    history = cq.large_deformation(body, [load], floor, steps=steps, friction=0.5)
    assert history[-1].contact_status.tolist() == ["stick", "stick"]
    assert len(history.notes) == count
    assert all("in the step to load factor 1 several contacts with friction land" in note for note in history.notes)
    smooth = cq.large_deformation(body, [load], floor, steps=steps, friction=[0.5, 0.0])
    assert smooth.notes == ()
