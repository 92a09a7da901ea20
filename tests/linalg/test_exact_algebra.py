"""Elimination in rational numbers, held against its definition."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from contactqp.linalg.exact_algebra import dot, reduced, solutions


def drawn(seed: int) -> list[list[Fraction]]:
    rng = np.random.default_rng(seed)
    rows, columns = (int(size) for size in rng.integers(1, 8, 2))
    wanted = rng.integers(-3, 4, (rows, columns + 1)) * (rng.random((rows, columns + 1)) < 0.6)
    entries = [[Fraction(int(x), int(rng.integers(1, 8))) for x in row] for row in wanted]
    if rows > 1 and rng.random() < 0.5:
        entries[-1] = [3 * x - y for x, y in zip(entries[0], entries[rows // 2], strict=True)]
    return entries


@pytest.mark.sampled(6)
@pytest.mark.parametrize("seed", range(60))
def test_the_echelon_form_is_reduced_and_spans_the_same_rows(seed: int) -> None:
    rows = drawn(seed)
    columns = len(rows[0]) - 1
    found, pivots = reduced(rows, columns)
    for i, j in enumerate(pivots):
        assert [row[j] for row in found] == [Fraction(i == k) for k in range(len(found))]
        assert not any(found[i][:j])
    for row in found[len(pivots) :]:
        assert not any(row[:columns])
    for row in rows:  # each is what its entries at the pivots say, up to the last column where rows contradict
        combined = [sum(row[j] * found[i][k] for i, j in enumerate(pivots)) for k in range(columns + 1)]
        assert combined[:columns] == row[:columns]
        assert combined == row or any(other[columns] for other in found[len(pivots) :])


@pytest.mark.sampled(6)
@pytest.mark.parametrize("seed", range(60))
def test_all_solutions_meet_the_equations(seed: int) -> None:
    rows = drawn(seed)
    columns = len(rows[0]) - 1
    found = solutions(rows, columns)
    if found is None:
        assert reduced(rows, columns + 1)[1][-1] == columns
        return
    for row in rows:
        assert dot(row[:columns], found.point) == row[columns]
        assert all(dot(row[:columns], direction) == 0 for direction in found.free)
    assert len(found.free) == columns - len(reduced(rows, columns)[1])
