"""Two reports row by row: whether another version of the package gives the same verdicts and the same errors.

    contactqp report -o before        # with the one version
    contactqp report -o after         # with the other
    python -m benchmarks.same_report before/results.json after/results.json

Rows agree where method, knob, verdict and all else that is neither a time nor a message are the same. Numbers agree to
`--relative` of the larger and `--absolute`: some backends differ in the last digits from one run to the next. Exit 1
where a row differs or is in one of the reports alone.
"""

from __future__ import annotations

import argparse
import json
import math
import pathlib
import sys
from collections.abc import Iterator, Mapping
from typing import Any

# What names a row.
NAMES = ("case", "method", "variant", "condensed", "knob", "knob_value")
# What a clock says, or depends on one; and words that have numbers in them which stand in columns of their own.
LEFT_OUT = ("seconds", "repeats", "linear_solve_seconds", "message")
Row = Mapping[str, Any]
Name = tuple[Any, ...]


def rows_of(file: str) -> dict[Name, Row]:
    """Return the rows of a report by their names."""
    rows = json.loads(pathlib.Path(file).read_text(encoding="utf-8"))["rows"]
    found = {tuple(row[name] for name in NAMES): row for row in rows}
    if len(found) != len(rows):
        raise SystemExit(f"{file}: two rows have one name")
    return found


def same(one: Any, other: Any, relative: float, absolute: float) -> bool:
    """Say whether two entries agree: numbers nearly, all else exactly."""
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=relative, abs_tol=absolute)
    return bool(one == other)


def differences(
    before: Mapping[Name, Row], after: Mapping[Name, Row], relative: float = 0.0, absolute: float = 0.0
) -> Iterator[str]:
    """Say of every row where it differs, in the order of the reports."""
    for name in [*before, *(name for name in after if name not in before)]:
        called = " ".join(str(part) for part in name if part not in ("", None))
        if name not in before or name not in after:
            yield f"{called}: only {'after' if name in after else 'before'}"
            continue
        one, other = before[name], after[name]
        for key in dict.fromkeys((*one, *other)):
            if key not in LEFT_OUT and not same(one.get(key), other.get(key), relative, absolute):
                yield f"{called}: {key}: {one.get(key)!r} before, {other.get(key)!r} after"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("before")
    parser.add_argument("after")
    parser.add_argument("--relative", type=float, default=1e-6, help="numbers may differ by this part of the larger")
    parser.add_argument("--absolute", type=float, default=1e-12, help="and by this much")
    chosen = parser.parse_args()
    before, after = rows_of(chosen.before), rows_of(chosen.after)
    found = list(differences(before, after, chosen.relative, chosen.absolute))
    print(*found, sep="\n", end="\n" if found else "")
    print(f"{len(before)} rows before, {len(after)} after; {len(found)} differences")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
