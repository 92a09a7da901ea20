"""The table of derivatives beside other packages: our column of it, against exact values."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.derivative_peers import BAR, FACTORS, PEERS, SPRINGS, exact_blocks

OURS = PEERS["contactqp"]


def test_the_bar_has_the_same_rate_in_both_unit_systems() -> None:
    assert len(BAR) == 2
    for data in BAR.values():
        assert OURS.bar(*data) == pytest.approx(-157_500.0, rel=1e-12)


def test_the_blocks_move_with_their_springs() -> None:
    for factor in FACTORS:
        exact = exact_blocks(factor * SPRINGS)
        assert np.count_nonzero(exact) == 4  # the spring between blocks that touch moves neither
        assert np.allclose(OURS.blocks(factor * SPRINGS), exact, rtol=1e-12, atol=1e-15 / factor)
    # k1 x1 = k3 (l - x1 - w) of the blocks together
    assert exact_blocks(SPRINGS)[0, 0] == pytest.approx(-1.5 * 1.5 / 2.5**2)
