"""What a C++, Fortran or Julia code does with an exported problem, in plain Python: nothing of contactqp or SciPy."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

Entries = dict[tuple[int, int], float]


def read_matrix(path: Path) -> tuple[int, int, Entries]:
    """Rows, columns and entries of a Matrix Market file, from the definition of the format."""
    lines = path.read_text().splitlines()
    _, _, layout, field, symmetry = lines[0].split()
    assert field in ("real", "integer")
    body = [line.split() for line in lines[1:] if line.strip() and not line.startswith("%")]
    rows, columns = int(body[0][0]), int(body[0][1])
    entries: Entries = {}
    if layout == "array":
        assert symmetry == "general"
        entries = {(k % rows, k // rows): float(line[0]) for k, line in enumerate(body[1:])}
    else:
        assert len(body) - 1 == int(body[0][2])
        for i, j, value in body[1:]:
            entries[int(i) - 1, int(j) - 1] = float(value)
            if symmetry == "symmetric":
                entries[int(j) - 1, int(i) - 1] = float(value)
    return rows, columns, entries


def broken_conditions(folder: Path) -> list[str]:
    """The conditions that answer.json breaks, in exact arithmetic on the doubles that stand in the files."""
    problem, answer = (json.loads((folder / name).read_text()) for name in ("problem.json", "answer.json"))
    parts = {name: read_matrix(folder / file)[2] for name, file in problem["files"].items()}
    n, m, k = (problem[key] for key in ("unknowns", "contacts", "ties"))
    exact = {key: _fractions(value) for key, value in answer["exact"].items()}
    u = exact["displacement"]
    force, ties = exact.get("normal_force", []), exact.get("tie_force", [])
    friction = [x for row in exact.get("friction_force", []) for x in row]
    assert (len(u), len(force), len(ties)) == (n, m, k)
    left = [-x for x in _vector(parts["load"], n)]
    for (i, j), value in parts["stiffness"].items():
        left[i] += Fraction(value) * u[j]
    for name, forces in (("normal", force), ("tangent", friction), ("tie", ties)):
        for (i, j), value in parts.get(name, {}).items():
            left[j] += Fraction(value) * forces[i]
    broken = ["equilibrium"] if any(left) else []
    gap = [g - x for g, x in zip(_vector(parts["gap"], m), _product(parts["normal"], u, m), strict=True)] if m else []
    broken += ["gap"] if min(gap, default=0) < 0 or gap != exact.get("gap", []) else []
    broken += ["tension"] if min(force, default=0) < 0 else []
    broken += ["complementarity"] if any(a * b for a, b in zip(gap, force, strict=True)) else []
    if k and _product(parts["tie"], u, k) != _vector(parts["tie_value"], k):
        broken.append("tie")
    return broken + (_broken_friction(parts, exact, m, u) if friction else [])


def _broken_friction(parts: dict[str, Entries], exact: Any, m: int, u: list[Fraction]) -> list[str]:
    width = len(exact["friction_force"][0])
    origin = _vector(parts["slip_origin"], m * width)
    slid = [x - o for x, o in zip(_product(parts["tangent"], u, m * width), origin, strict=True)]
    broken = []
    for i, mu in enumerate(_vector(parts["friction"], m)):
        push, bound = exact["friction_force"][i], mu * exact["normal_force"][i]
        slip = slid[width * i : width * (i + 1)]
        square = sum(x * x for x in slip)
        if sum(x * x for x in push) > bound**2:
            broken.append("cone")
        if any(t * t * square != bound**2 * s * s or t * s < 0 for t, s in zip(push, slip, strict=True) if square):
            broken.append("slip direction")
    return broken


def _product(entries: Entries, vector: list[Fraction], rows: int) -> list[Fraction]:
    total = [Fraction(0)] * rows
    for (i, j), value in entries.items():
        total[i] += Fraction(value) * vector[j]
    return total


def _vector(entries: Entries, size: int) -> list[Fraction]:
    return [Fraction(entries.get((i, 0), 0.0)) for i in range(size)]


def _fractions(value: Any) -> Any:
    return [_fractions(one) for one in value] if isinstance(value, list) else Fraction(value)
