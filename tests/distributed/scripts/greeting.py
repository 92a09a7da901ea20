"""All ranks are there, and PETSc has its options from the environment and none of ours."""

from __future__ import annotations

import sys

from contactqp.distributed.ranks import Ranks, petsc

given = list(sys.argv)
ranks, PETSc = Ranks(), petsc()
assert ranks.size == int(sys.argv[1])
assert sys.argv == given
assert ranks.sum(1) == ranks.size
assert PETSc.Options().getString("greeting", "") == "hello"
assert not PETSc.Options().hasName("not_for_petsc")
try:
    PETSc.Mat().create(PETSc.COMM_SELF).setType("no such type")
    refused = False
except PETSc.Error:
    refused = True
assert refused
if ranks.rank == 0:
    print(f"{ranks.size} ranks")
