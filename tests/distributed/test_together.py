"""On two ranks, in one run: a few of what other tests here show on one to four ranks, each in a run of its own."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from tests.distributed import test_certificate, test_files, test_friction, test_pieces, test_solving

DEALT_OUT = ("floating-2", "tied-1", "frictional-1")


def test_two_ranks_do_what_one_process_does(on_ranks: Callable[..., str], tmp_path: Path) -> None:
    gallery = test_files.write_gallery(tmp_path)
    runs = (
        ("answers_as_one_process.py", "mumps", *test_solving.FEW),
        ("certificates.py", *test_certificate.FEW),
        ("friction_answers.py", "mumps", *(f"'{name}'" for name in test_friction.FEW)),
        ("problems_of_first_rank.py", *(gallery / name for name in DEALT_OUT)),
        ("refused_alike.py", 4),
    )
    said = on_ranks("together.py", 2, *(" ".join(map(str, words)) for words in runs))
    answers, certificates, friction, files, pieces = re.split(r"^--- \d+\n", said, flags=re.MULTILINE)[1:]
    test_solving.are_all_answered(answers, test_solving.FEW)
    test_certificate.are_judged_in_every_way(certificates, test_certificate.FEW)
    test_friction.are_answered_with_states(friction, test_friction.FEW)
    test_files.are_the_same(files, 2, DEALT_OUT)
    test_pieces.are_some_refused(pieces)
