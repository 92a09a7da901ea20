"""Whether local problems have an answer, in rational numbers: as closed forms and the enumeration in floats say."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.solving.friction.exact_enumeration import has_local_equilibrium


def jammed(normal: float, friction: float = 0.5) -> cq.LocalProblem:
    """A block between two walls that move towards each other by -normal."""
    W = np.zeros((4, 4))
    W[::2, ::2], W[1::2, 1::2] = [[1.0, -1.0], [-1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]
    return cq.LocalProblem(delassus=W, offset=[normal, 0.0, normal, 0.0], friction=friction, dimension=2)


def test_a_jammed_block_has_none_and_a_loose_one_has() -> None:
    assert not has_local_equilibrium(jammed(-0.1))
    assert not has_local_equilibrium(jammed(-1e-300))
    assert has_local_equilibrium(jammed(0.1))
    with pytest.raises(cq.NoEquilibrium, match="proven in rational numbers"):
        cq.solve(jammed(-0.1), algorithm="enumeration")


def test_one_contact_above_the_critical_coefficient() -> None:
    """Slipping on, r_T = -0.8 r_N, the normal compliance 1 - 2 * 0.8 is negative: one answer or three."""
    data = dict(delassus=[[1.0, 2.0], [2.0, 5.0]], friction=0.8, dimension=2)
    assert has_local_equilibrium(cq.LocalProblem(offset=[-7.0, -17.0], **data))
    grid = [(x, y) for x in (-2.0, -1.0, 1.0) for y in (-4.0, -2.0, 0.0, 1.0, 6.0)]
    for offset in grid:
        problem = cq.LocalProblem(offset=offset, **data)
        assert has_local_equilibrium(problem), offset


@pytest.mark.sampled(3)
@pytest.mark.parametrize("seed", range(20))
def test_random_problems_with_joints_agree_with_the_enumeration_in_floats(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, p = int(rng.integers(1, 3)), int(rng.integers(0, 2))
    root = rng.normal(size=(2 * m, 2 * m))
    joints = {}
    if p:
        joints = dict(bilateral=rng.normal(size=(2 * m, p)), bilateral_delassus=np.eye(p), bilateral_offset=np.ones(p))
    problem = cq.LocalProblem(
        delassus=root @ root.T, offset=rng.normal(size=2 * m), friction=rng.uniform(0, 2), dimension=2, **joints
    )
    assert has_local_equilibrium(problem) == bool(cq.equilibria(problem))
