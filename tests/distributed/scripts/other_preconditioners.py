"""Preconditioners that an option of the user's names: PETSc's of that name, or refused where there is no choice."""

from __future__ import annotations

import numpy as np
import pytest

import contactqp as cq
from contactqp.distributed import smoothed_aggregation
from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks, petsc
from contactqp.distributed.solving import solve_distributed
from contactqp.errors import Unsupported
from tests.blocks_in_space import on_sphere

smoothed_aggregation.COARSEST = 40
ranks, problem, options = Ranks(), on_sphere((4, 4, 3)), petsc().Options("contactqp_")
truth = cq.solve(problem).displacement
# The inverse blocks of "pbjacobi" lie in the matrix that it was made of.
for kind in ("pbjacobi", "sor", "bjacobi"):
    options["pc_type"] = kind
    found = solve_distributed(distribute(problem, ranks), solver="hypre").displacement
    assert np.max(abs(found - truth)) <= 1e-9 * np.max(abs(truth)), kind
options["pc_type"] = "jacobi"
with pytest.raises(Unsupported, match=r"^solver: gamg, but the option -contactqp_pc_type is jacobi$"):
    solve_distributed(distribute(problem, ranks), solver="gamg")
options.delValue("pc_type")
if ranks.rank == 0:
    print("obeyed")
