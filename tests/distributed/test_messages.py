"""Arrays go from rank to rank as they are."""

from __future__ import annotations

import pytest


@pytest.mark.sampled(2)
@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
def test_rows_come_where_they_are_sent(on_ranks, ranks):
    assert on_ranks("exchanged.py", ranks) == f"the same on {ranks}\n"
