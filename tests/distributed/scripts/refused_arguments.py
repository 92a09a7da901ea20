"""Arguments that are no good for the engine are refused in one line, on all ranks alike."""

from __future__ import annotations

from typing import Any

import pytest

import contactqp as cq

problem = cq.ContactProblem([[2.0, -1.0], [-1.0, 2.0]], [1.0, 1.0], [[1.0, 0.0]], [0.1])
REFUSED: tuple[tuple[dict[str, Any], str], ...] = (
    ({"tolerance": -1}, "tolerance: expected a positive number, got -1"),
    ({"tolerance": "a"}, "tolerance: expected a positive number, got 'a'"),
    ({"max_iter": 0}, "max_iter: expected a positive integer, got 0"),
    ({"time_limit": -2}, "time_limit: expected a positive number, got -2"),
    ({"penalty": 1e8}, "engine 'petsc': there is no option 'penalty', expected one of tolerance, solver, "),
    ({"solver": "lu"}, "solver: expected auto, gamg, hypre, mumps, got 'lu'"),
    ({"method": "osqp"}, "osqp: engine 'petsc' has active-set, and "),
    ({"method": "nope"}, "no method is called 'nope'"),
    ({"warm_start": 3}, "warm_start: expected a Solution, got int"),
    ({"condense": True}, "engine 'petsc': condense is an option of one process, leave it out"),
    ({"algorithm": "nsgs"}, "engine 'petsc': friction is solved by 'tresca' alone, got 'nsgs'"),
    ({"engine": "mpi"}, "engine: expected 'serial' or 'petsc', got 'mpi'"),
)
for arguments, expected in REFUSED:
    with pytest.raises(cq.ContactQPError) as refused:
        cq.solve(problem, **{"engine": "petsc", **arguments})
    assert str(refused.value).startswith(expected), refused.value
    assert "\n" not in str(refused.value)
assert cq.solve(problem, engine="petsc", tolerance=1e-12).certificate.proven
print("refused")
