"""The errors that other codes publish, against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq

# W = I, q = (-3, 4, 0), mu = 1/2, r = 0: u = q, r - u - mu |u_T| e_N = (1, -4, 0), whose projection onto
# |r_T| <= r_N/2 has r_N = (1/2 * 4 + 1)/(1 + 1/4) = 12/5, r_T = -6/5: n = (-12/5, 6/5, 0), |n| = 6/sqrt(5).
NOTHING = np.zeros(3)
HAND = 6 / np.sqrt(5)


def _local(**changes: object) -> cq.LocalProblem:
    data: dict[str, object] = dict(delassus=np.eye(3), offset=[-3.0, 4.0, 0.0], friction=0.5, dimension=3)
    return cq.LocalProblem(**(data | changes))


def test_local_errors_of_no_force() -> None:
    assert cq.siconos_local_error(_local(), NOTHING) == pytest.approx(HAND / 5, rel=1e-15)
    assert cq.acary_bremond_huber_error(_local(), NOTHING) == pytest.approx(HAND / 5, rel=1e-15)
    assert cq.fclib_merit_1(_local(), NOTHING) == pytest.approx(HAND / (1 + np.sqrt(5)), rel=1e-15)


def test_local_errors_of_a_force_are_relative_to_different_sizes() -> None:
    """r = (12, 0, 0): u = (9, 4, 0), and n = r - P_K((1, -4, 0)) = (48/5, 6/5, 0)."""
    r, n = np.array([12.0, 0.0, 0.0]), np.hypot(48 / 5, 6 / 5)
    assert cq.siconos_local_error(_local(), r) == pytest.approx(n / 12, rel=1e-15)
    assert cq.acary_bremond_huber_error(_local(), r) == pytest.approx(n / 5, rel=1e-15)
    assert cq.fclib_merit_1(_local(), r.reshape(1, 3)) == pytest.approx(n / (1 + np.sqrt(5)), rel=1e-15)


def test_they_vanish_at_the_answer_only() -> None:
    """Slip: r_N = 3, r_T = -3/2, u = (0, 5/2)."""
    for error in (cq.siconos_local_error, cq.acary_bremond_huber_error, cq.fclib_merit_1):
        assert error(_local(), [3.0, -1.5, 0.0]) < 1e-15
        assert error(_local(), [3.0, 1.5, 0.0]) > 0.1


def test_joints_count_in_the_merit_of_fclib() -> None:
    """V = e_1, R = 2, s = 3 at r = 0, l = 1: |V'r + R l + s| / (1 + |s|) = 5/4; u = q + V."""
    problem = _local(
        bilateral=[[1.0], [0.0], [0.0]],
        bilateral_delassus=[[2.0]],
        bilateral_offset=[3.0],
        offset=[-4.0, 4.0, 0.0],
    )
    merit = HAND / (1 + np.sqrt(np.sqrt(32))) + 5 / 4
    assert cq.fclib_merit_1(problem, NOTHING, [1.0]) == pytest.approx(merit, rel=1e-15)
    assert cq.siconos_local_error(problem, NOTHING, [1.0]) == pytest.approx(HAND / np.sqrt(32), rel=1e-15)


def test_of_the_published_errors_siconos_alone_is_stated_in_the_plane() -> None:
    flat = cq.LocalProblem(delassus=np.eye(2), offset=[-3.0, 4.0], friction=0.5, dimension=2)
    assert cq.siconos_local_error(flat, [0.0, 0.0]) == pytest.approx(HAND / 5, rel=1e-15)
    with pytest.raises(cq.Unsupported, match="three dimensions"):
        cq.fclib_merit_1(flat, [0.0, 0.0])


def test_scales_that_are_rounding_are_not_divided_by() -> None:
    tiny = _local(offset=[-3e-17, 4e-17, 0.0])
    assert cq.siconos_local_error(tiny, NOTHING) == pytest.approx(1e-17 * HAND, rel=1e-14)
    small = _problem(load=1e-9)
    assert cq.siconos_global_error(small, np.zeros(3), [0.0], np.zeros(2)) == pytest.approx(1e-9 * np.sqrt(29))


def _problem(load: float = 1.0) -> cq.ContactProblem:
    return cq.ContactProblem(
        stiffness=2.0 * np.eye(3),
        load=load * np.array([-2.0, 3.0, 4.0]),
        normal=[[-1.0, 0.0, 0.0]],
        gap=[0.0],
        tangent=[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        friction=0.5,
    )


def test_global_error() -> None:
    """v = (0, 3/2, 2), l_N = 2, l_T = 0: M v = (0, 3, 4), H r = (2, 0, 0) balance q; u = v, |u_T| = 5/2.

    r - u - 5/4 e_N = (3/4, -3/2, -2), whose projection has r_N = (1/2 * 5/2 + 3/4)/(5/4) = 8/5, |r_T| = 4/5:
    n = (2/5, 4/5 * (3, 4)/5), |n| = 2/sqrt(5), over |u| = 5/2.
    """
    error = cq.siconos_global_error(_problem(), [0.0, 1.5, 2.0], [2.0], [0.0, 0.0])
    assert error == pytest.approx(2 / np.sqrt(5) / 2.5, rel=1e-15)
    off = cq.siconos_global_error(_problem(), [0.0, 1.5, 2.0], [0.0], [0.0, 0.0])
    # q - M v = (-2, 0, 0) over |q| = sqrt(29); r - u - 5/4 e_N = (-5/4, -3/2, -2) is in the polar cone: n = 0.
    assert off == pytest.approx(2 / np.sqrt(29), rel=1e-15)


def test_global_error_vanishes_at_the_answer() -> None:
    """Slip: l_T = (3, 4)/5, v = ((3, 4) - l_T)/2."""
    right = np.array([0.0, 1.2, 1.6])
    assert cq.siconos_global_error(_problem(), right, [2.0], [[0.6, 0.8]]) < 1e-15
    assert cq.siconos_global_error(_problem(), right, [2.0], [[-0.6, -0.8]]) > 0.1


def test_what_has_no_such_error_says_so() -> None:
    with pytest.raises(cq.InvalidProblem, match="tangential"):
        cq.siconos_global_error(cq.ContactProblem([[1.0]], [1.0], [[1.0]], [0.0]), [0.0], [0.0], [])
    with pytest.raises(cq.InvalidProblem, match="force: expected shape"):
        cq.siconos_local_error(_local(), [1.0])
    with pytest.raises(cq.InvalidProblem, match="q is zero"):
        cq.acary_bremond_huber_error(_local(offset=np.zeros(3)), NOTHING)
    tied = cq.ContactProblem(np.eye(2), [0.0, 0.0], [[1.0, 0.0]], [0.0], tangent=[[0.0, 1.0]], tie=[[1.0, 1.0]])
    with pytest.raises(cq.Unsupported, match="ties"):
        cq.siconos_global_error(tied, [0.0, 0.0], [0.0], [0.0])
