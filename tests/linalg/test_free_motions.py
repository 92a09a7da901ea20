"""Motions that neither stiffness nor closed contacts resist move bodies rigidly, to the last digits."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.linalg.condensation import condense
from contactqp.linalg.dense import saddle_point


def test_free_motions_move_a_stiff_body_rigidly_though_it_hardly_moves() -> None:
    """Springs do no work: their nodes move alike, in every free motion of four chains on two walls."""
    K, bodies, moving = np.zeros((9, 9)), (slice(0, 3), slice(3, 5), slice(5, 7), slice(7, 9)), 0
    for first, spring in ((0, 2.0**25), (1, 1368.0), (3, 1.0), (5, 1.0), (7, 1.0)):
        K[first : first + 2, first : first + 2] += spring * np.array([[1, -1], [-1, 1]])
    for seed in range(40):
        rng = np.random.default_rng(seed)
        walls = rng.integers(1, 9, (2, 9)) * rng.choice([-1, 1], (2, 9)) / 4
        condensation = condense(cq.ContactProblem(K, np.zeros(9), walls, [0.0, 0.0]))
        scaled = saddle_point(condensation, np.array([0, 1])).free
        motions = scaled * condensation.scale[:, None]
        for body in bodies:
            for q in np.flatnonzero(np.max(abs(scaled[body]), axis=0) > 1e-6):
                moving += 1
                assert np.ptp(motions[body, q]) <= 1e-14 * np.max(abs(motions[body, q]))
    assert moving > 200


def test_large_loads_that_balance_on_a_stiff_body_drive_no_free_motion() -> None:
    """A chain of 2e7 and 1368 beside a lattice: loads of 3.5e7 and contact forces of one, which are 15/8 and 9/8."""
    strain = np.array([
        [1, 1, 0, 0, 0, 0, -1, -1], [1, 0, -1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, -1, 0, 0],
        [0, 0, 1, -1, -1, 1, 0, 0], [0, 0, 0, 1, 0, 0, 0, -1], [0, 0, 0, 0, 1, 0, -1, 0],
    ])  # fmt: skip
    K = np.zeros((11, 11))
    K[:2, :2] = 19922944.0 * np.array([[1, -1], [-1, 1]])
    K[1:3, 1:3] += 1368.0 * np.array([[1, -1], [-1, 1]])
    K[3:, 3:] = strain.T @ strain
    E = [
        [-1, -1, 0.25, 0.25, 0, 1.75, -0.25, 0.75, 1, 0, 0.5],
        [1, 0.5, 0.5, 0.25, -0.5, 1, 0.5, 1, -1, -0.75, 0.5],
        [1, 0.75, 0, 0.25, -0.25, 0.5, 0.5, -1, 1.5, 0.25, -0.5],
        [1, 0.5, 0.5, 0.25, -0.5, 1, 0.5, 1, -1, -0.75, 0.5],
    ]
    load = [34865155.0, -34867031.21875, 1881.9375, -1.375, -3.59375, 3.4375, -0.25, -1.625, 1.0625, 2.375, 3.25]
    problem = cq.ContactProblem(K, load, E, [-1.03125, -0.09375, 0.15625, 0.03125])
    moved = np.array([14861, -20195, 7349, -5176, -18053, -2672, -5947, -24794, -10541, 5254, 11581]) / 20032
    assert cq.certify(problem, moved, [0.0, 1.875, 1.125, 0.0]).proven
    assert cq.solve(problem).normal_force == pytest.approx([0.0, 1.875, 1.125, 0.0], abs=1e-12)
