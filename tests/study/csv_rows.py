"""Read back the rows that `contactqp.study.rows.to_csv` wrote."""

import csv
import io
from dataclasses import fields
from typing import Any

from contactqp.study.rows import Row

_TYPES = {column.name: str(column.type).removesuffix(" | None") for column in fields(Row)}


def from_csv(text: str) -> tuple[Row, ...]:
    lines = csv.DictReader(io.StringIO(text))
    return tuple(Row(**{name: _parsed(name, cell) for name, cell in line.items()}) for line in lines)


def _parsed(name: str, cell: str) -> Any:
    kind = _TYPES[name]
    if kind == "str":
        return cell
    if not cell:
        return None
    return cell == "true" if kind == "bool" else int(cell) if kind == "int" else float(cell)
