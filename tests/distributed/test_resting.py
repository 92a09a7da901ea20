"""Where bodies that float come to rest: the linear program on their rigid motions, in one process."""

from __future__ import annotations

import numpy as np
import pytest

from contactqp.distributed.floating import resting_place

# A block that can fall and turn: motions (down at the left end, down at the right end), a stop below each end.
FALLING = np.array([1.0, 1.0])
STOPS = np.eye(2)
CONTACTS = np.array([True, True])


def test_a_block_comes_to_rest_on_its_stops_with_forces_that_balance_its_weight() -> None:
    place, force = resting_place(FALLING, STOPS, np.array([0.1, 0.3]), CONTACTS)
    np.testing.assert_allclose(place, [0.1, 0.3])
    np.testing.assert_allclose(STOPS.T @ force, FALLING)


def test_rows_may_have_any_scale_and_lengths_any_unit() -> None:
    rows = np.array([[1e3, 0.0], [0.0, 1e-6]])
    place, force = resting_place(1e9 * FALLING, rows, np.array([1e-9, 1e-20]), CONTACTS)
    np.testing.assert_allclose(place, [1e-12, 1e-14], rtol=1e-6)
    np.testing.assert_allclose(rows.T @ force, 1e9 * FALLING)


def test_what_nothing_stops_is_said() -> None:
    why, _ = resting_place(FALLING, np.array([[1.0, 0.0]]), np.array([0.1]), np.array([True]))
    assert why == "the load drives a rigid motion that no contact and no tie holds back"
    # A tie stops it; an obstacle on the other side does not.
    place, _ = resting_place(FALLING, STOPS, np.array([0.1, 0.3]), np.array([True, False]))
    np.testing.assert_allclose(place, [0.1, 0.3])
    why, _ = resting_place(FALLING, -STOPS, np.array([0.1, 0.3]), CONTACTS)
    assert isinstance(why, str)


def test_bodies_that_overlap_at_the_start_rest_where_they_are() -> None:
    """Between two walls that are too near each other no rigid motion parts them; the body has to give way."""
    walls = np.array([[1.0], [-1.0]])
    place, force = resting_place(np.array([2.0]), walls, np.array([-0.1, -0.1]), CONTACTS)
    np.testing.assert_allclose(place, [0.0], atol=1e-15)
    np.testing.assert_allclose(walls.T @ force, [2.0])


@pytest.mark.parametrize("limit", [-1.0, 1.0])
def test_contacts_that_no_motion_reaches_say_nothing(limit: float) -> None:
    place, force = resting_place(np.array([1.0]), np.array([[1.0], [0.0]]), np.array([0.5, limit]), CONTACTS)
    np.testing.assert_allclose(place, [0.5])
    np.testing.assert_allclose(force, [1.0, 0.0])
