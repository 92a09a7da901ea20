"""What a run of the report found of each method, from the small table that was made of its results.csv."""

from __future__ import annotations


def what_is_measured() -> str:
    return "to come"
