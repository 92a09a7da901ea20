"""What `benchmarks.report_twice` calls a wrong estimate."""

from __future__ import annotations

import pytest

from benchmarks.report_twice import misses, seconds_left


@pytest.mark.parametrize(
    ("words", "seconds"),
    [("about 20 s left", 20.0), ("about 2 min 0 s left", 120.0), ("about 1 h 6 min left", 3960.0), ("10 of 20", None)],
)
def test_what_is_said_to_be_left_is_read(words: str, seconds: float | None) -> None:
    assert seconds_left(f"contactqp: times: 3 of 7, {words}") == seconds


def test_estimates_are_wrong_by_more_than_a_third_after_the_first_fifth() -> None:
    lines = [(5.0, "about 10 s left"), (20.0, "about 1 min 20 s left"), (40.0, "about 1 min 20 s left")]
    assert not list(misses(lines, 100.0))
    assert [line[:17] for line in misses([*lines, (50.0, "about 1 min 20 s left")], 100.0)] == ["after 50 s of 100"]
    assert len(list(misses([(50.0, "about 20 s left")], 100.0))) == 1
    assert not list(misses([(95.0, "about 10 s left"), (99.0, "written")], 100.0))
