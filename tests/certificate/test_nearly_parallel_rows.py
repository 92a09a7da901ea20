"""Rows of contacts that are nearly parallel: one force exchanged for the other leaves displacements right to 1e-9."""

from __future__ import annotations

import numpy as np

import contactqp as cq


def test_a_row_that_hardly_moves_an_unknown_does_not_make_the_size_of_a_problem() -> None:
    """A contact pulls over a gap by 1e-5 of its load, and one with the same row pushes for it.

    Another one moves an unknown without stiffness by 1e-8 of what it moves a spring. The load of that unknown had been
    measured in the scale of this contact, beside which a pull of 1e-5 was nothing.
    """
    K, tie = np.diag([6.5, 0.0]), np.array([[0.5, 1.0]])
    rows = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [1.0, 2.0**-27]])
    u, forces, held = np.array([-0.25, 0.25]), np.array([2.75, 0.0, 0.125, 0.0]), np.array([-0.25])
    load, gap = K @ u + rows.T @ forces + tie.T @ held, rows @ u + np.array([0.0, 0.25, 0.0, 0.0])
    problem = cq.ContactProblem(K, load, rows, gap, tie=tie, tie_value=tie @ u)
    assert cq.certify(problem, u, forces, tie_force=held).proven
    pulled = forces + 9e-6 * np.array([1.0, -1.0, 0.0, 0.0])
    assert cq.certify(problem, u, pulled, tie_force=held).tension > 1e-7
