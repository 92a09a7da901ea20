"""What is kept is read as it was written."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Union

import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from contactqp.scene.claims import Remark
from contactqp.study.rows import Row
from contactqp.study.running.journal import decode, encode


@dataclass(frozen=True)
class Inner:
    name: str
    share: Fraction


@dataclass(frozen=True, eq=False)
class Everything:
    inner: tuple[Inner, ...]
    pair: tuple[str, float]
    values: NDArray[np.float64]
    perhaps: NDArray[np.float64] | None
    picture: bytes | None
    counts: Mapping[str, Inner]
    plain: list[dict[str, Any]]
    either: int | float | None
    remarks: tuple[Remark, ...]
    new: str = "a field that what was kept does not have yet"


WHOLE = Everything(
    inner=(Inner("a", Fraction(1, 3)),),
    pair=("left", math.inf),
    values=np.array([[0.1, -0.0], [np.nan, 1e-320]]),
    perhaps=None,
    picture=b"\x89PNG\x00",
    counts={"b": Inner("β", Fraction(2))},
    plain=[{"met": True, "values": [1, 2.5, None]}],
    either=3,
    remarks=(Remark(statement="u = 1", verdict="wrong", where="p. 1", why="it is 2"),),
)


def _through(value: Any) -> Any:
    return decode(json.loads(json.dumps(encode(value))), type(value))


def test_everything_comes_back() -> None:
    found = _through(WHOLE)
    assert (found.inner, found.pair, found.picture) == (WHOLE.inner, WHOLE.pair, WHOLE.picture)
    assert (found.counts, found.plain, found.either, found.remarks) == (
        WHOLE.counts,
        WHOLE.plain,
        WHOLE.either,
        WHOLE.remarks,
    )
    assert found.values.tobytes() == WHOLE.values.tobytes()
    assert found.values.shape == (2, 2)
    assert found.perhaps is None
    found.values[0, 0] = 1.0  # no view of a text


def test_rows_come_back_to_the_last_bit() -> None:
    row = Row(case="a", method="b", seconds=0.1 + 0.2, knob_value=1e-300, claimed=False, iterations=3, message="λ; ü")
    assert _through(row) == row


def test_a_field_that_is_new_has_its_default() -> None:
    data = encode(WHOLE)
    del data["new"]
    assert decode(data, Everything).new == WHOLE.new
    del data["pair"]
    with pytest.raises(TypeError, match="pair"):
        decode(data, Everything)


def test_what_is_no_plain_data_is_refused() -> None:
    with pytest.raises(TypeError, match="got object"):
        encode([object()])


def test_names_of_types_are_what_they_stand_for() -> None:
    # Since NumPy 2.5 NDArray is such a name, `type NDArray[...] = ...`, with Python 3.12 and later.
    values = np.array([1.0, 2.0])
    for name in (TypeAliasType("Floats", np.ndarray), TypeAliasType("More", NDArray[np.float64])):
        assert np.array_equal(decode(encode(values), name), values)
        assert decode(None, Union[name, None]) is None  # noqa: UP007  a backport does not know |
