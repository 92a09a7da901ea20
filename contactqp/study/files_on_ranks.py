"""Files of problems, solved on the ranks of MPI: the first one reads, deals out what it has read, and tells.

It has K whole while it reads and deals; the others never have more than an equal share of the rows and their part.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from contactqp.distributed.collecting import CollectedSolution, collected
from contactqp.distributed.distributing import part_of, share_of_first
from contactqp.distributed.portion import Portion, whole_portion
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solution import DistributedSolution
from contactqp.distributed.solving import refuse_method, solve_distributed
from contactqp.distributed.whole import options_on_ranks
from contactqp.errors import BackendFailed, NoEquilibrium, NotCertified, NotConverged, SeveralEquilibria, Unsupported
from contactqp.exchange.refusal import naming
from contactqp.model.problem import ContactProblem
from contactqp.study.file_outcome import FileOutcome, Outline, outline_of, solvable_form


def run_file_on_ranks(file: str, method: str, options: Mapping[str, Any]) -> FileOutcome:
    """As `run_file`, on all ranks; the answer is whole on the first one. Collective.

    Raises
    ------
    InvalidProblem, Unsupported, BackendMissing
        As there, on all ranks in the same words.
    """
    refuse_method(method)
    chosen, ranks = options_on_ranks(dict(options)), Ranks()
    outline, share = _read(file, ranks)
    began = time.perf_counter()
    solution: CollectedSolution | None = None
    failure: str | None = None
    try:
        with naming(file):
            solution = collected(solve_distributed(part_of(ranks, share), method, **chosen))
    except (NotConverged, NotCertified) as error:
        found: Any = error.solution
        solution = collected(found) if isinstance(found, DistributedSolution) else None
        failure = f"{file}: {error}"
    except (NoEquilibrium, SeveralEquilibria, BackendFailed) as error:
        failure = f"{file}: {error}"
    return FileOutcome(file, outline, solution, failure, time.perf_counter() - began, dict(options))


def _read(file: str, ranks: Ranks) -> tuple[Outline, Portion]:
    """What is said of a file's problem, and this rank's share of it; the whole is forgotten."""
    found = ranks.by_first(lambda: _first_reads(file))
    outline, whole = (None, None) if found is None else found
    share = share_of_first(whole, ranks)
    said: Any = ranks.told(outline)
    return said, share


def _first_reads(file: str) -> tuple[Outline, Portion]:
    problem = solvable_form(file)
    if not isinstance(problem, ContactProblem):
        raise Unsupported(f"{file}: engine 'petsc': a problem in local form has no stiffness to deal out")
    return outline_of(problem), whole_portion(problem)
