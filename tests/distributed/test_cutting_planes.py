"""The search for the motion on which forces balance worst, against the linear program of all unknowns."""

from __future__ import annotations

import numpy as np
import pytest

from contactqp.certificate.figures import _worst_direction
from contactqp.distributed.certificate import CuttingPlanes
from contactqp.errors import NotConverged


def _found(basis: np.ndarray, weight: np.ndarray) -> tuple[float, int]:
    search, queries = CuttingPlanes(weight), 0
    while not search.done:
        query, queries = search.query, queries + 1
        search.add_cut(basis.T @ np.sign(basis @ query))
    best = search.best
    return abs(float(weight @ best)) / float(np.sum(abs(basis @ best))), queries


@pytest.mark.parametrize(("count", "width"), [(3, 2), (20, 3), (2000, 3), (12, 6), (300, 6), (3000, 6)])
def test_the_worst_motion_is_that_of_the_whole_program(count: int, width: int) -> None:
    rng = np.random.default_rng(count)
    sizes = np.exp(2 * rng.standard_normal(count)) * (rng.random(count) < 0.8)
    sizes[: width + 1] = 1.0
    basis = np.linalg.qr(rng.standard_normal((count, width)) * sizes[:, None])[0]
    weight = rng.standard_normal(width)
    direction = _worst_direction(basis, weight / np.max(abs(weight)))
    expected = abs(weight @ direction) / np.sum(abs(basis @ direction))
    found, queries = _found(basis, weight)
    assert found == pytest.approx(expected, rel=1e-8)
    # No coordinate alone is as bad, so there was something to search.
    assert np.max(abs(weight) / np.sum(abs(basis), axis=0)) < found
    assert queries < 200


def test_a_search_that_gets_no_nearer_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("contactqp.distributed.certificate.MOST_QUERIES", 8)
    basis = np.linalg.qr(np.random.default_rng(0).standard_normal((2000, 6)))[0]
    with pytest.raises(NotConverged, match="balance of forces"):
        _found(basis, np.arange(1.0, 7.0))
