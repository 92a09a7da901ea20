"""Rows go to the ranks that they are for, of whatever type and width, in one message or in many."""

import numpy as np

from contactqp.distributed import ranks as of_ranks
from contactqp.distributed.ranks import Ranks
from contactqp.errors import InvalidProblem

ranks = Ranks()
KINDS = (
    lambda rows: rows[:, 0],
    lambda rows: rows,
    lambda rows: rows.astype(float) / 7,
    lambda rows: rows[:, 0] % 2 == 0,
    lambda rows: np.stack([rows, -rows], axis=2).astype(np.int32),
    lambda rows: rows[:, :0],
    lambda rows: np.array([f"{row[0]}" for row in rows], dtype=str),  # as wide as its longest on this rank
    lambda rows: np.array([(int(row[0]),) for row in rows] + [None], dtype=object)[:-1],
)


def rows_of(rank):
    """Row (rank, place, destination) of each; every third rank has none, and nothing goes to the last but one."""
    count = 0 if rank % 3 == 1 else 5 + rank
    place = np.arange(count)
    destination = (place * 5 + rank) % ranks.size
    if ranks.size > 1:
        destination[destination == ranks.size - 2] = ranks.size - 1
    return np.column_stack([np.full(count, 1000 * rank) + place, place, destination]).astype(np.int64)


def check(kinds):
    mine = rows_of(ranks.rank)
    came = ranks.exchange(mine[:, 2], *(kind(mine) for kind in kinds))
    every = [rows_of(rank) for rank in range(ranks.size)]
    wanted = np.concatenate([rows[rows[:, 2] == ranks.rank] for rows in every])
    for kind, found in zip(kinds, came, strict=True):
        expected = kind(wanted)
        assert found.shape == expected.shape, (found.shape, expected.shape)
        assert found.dtype.kind == expected.dtype.kind
        assert np.array_equal(found, expected), (found, expected)


def check_scatter():
    counts = np.array([0 if rank % 3 == 1 else 4 + rank for rank in range(ranks.size)])
    whole = np.arange(3.0 * counts.sum()).reshape(-1, 3)
    for values in (whole, whole[:, 0], whole[:, :0], np.array([f"{row[0]}" for row in whole])):
        found = ranks.scatter(counts, values if ranks.rank == 0 else None)
        begin = int(counts[: ranks.rank].sum())
        assert np.array_equal(found, values[begin : begin + counts[ranks.rank]])
        assert found.dtype == values.dtype


def check_all():
    for kind in KINDS:
        check([kind])
    check(KINDS[:6])
    check(KINDS)
    check([])
    # Nothing but one rank's rows says what they are.
    full = np.ones((3, 2)) if ranks.rank == 0 else np.zeros((0, 2), dtype=np.int32)
    (found,) = ranks.exchange(np.zeros(len(full), dtype=np.intp), full)
    assert found.sum() == (6 if ranks.rank == 0 else 0)
    check_scatter()


def refuse():
    raise InvalidProblem("a file: no good")


def said_of_refusal():
    try:
        ranks.on_first_rank(refuse)
    except InvalidProblem as error:
        return str(error)
    return None


check_all()
of_ranks.MOST_BYTES = 40  # a row or two of the wider ones: many rounds
check_all()
assert said_of_refusal() == "a file: no good"
assert ranks.on_first_rank(lambda: 3) == (3 if ranks.rank == 0 else None)
if ranks.rank == 0:
    print(f"the same on {ranks.size}")
