"""Motions that a row feels by rounding alone: no row resists them, whatever else it resists."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import contactqp as cq
from contactqp.distributed.ranks import Ranks
from contactqp.errors import NoEquilibrium
from tests.distributed.cases import partly_held_case

# A floating chain with a stop between its own ends, which no rigid motion closes.
spring = np.diff(np.eye(4), axis=0)
stiffness = spring.T @ np.diag([1.85617, 0.21797, 1.28429]) @ spring
chain = cq.ContactProblem(stiffness=stiffness, load=[0.3, -0.9, -0.3, -0.3], normal=[[0.0, -1.0, 0.0, 1.0]], gap=[0.06])
with pytest.raises(NoEquilibrium, match="no contact and no tie holds back"):
    cq.solve(chain, engine="petsc")

# Two blocks, the upper one held by a prescribed displacement along y and by nothing along x.
ranks = Ranks()
if ranks.rank == 0:
    partly_held_case(Path.cwd())
ranks.comm.barrier()
scene = cq.load_scene(Path.cwd() / "partly_held.toml")
(*_, one), (*_, many) = cq.run(scene), cq.run(scene, engine="petsc")
assert many.certificate.proven
assert len(many.free_motions) == len(one.free_motions) == 1
np.testing.assert_allclose(many.normal_force, one.normal_force, rtol=0, atol=1e-9 * max(one.normal_force))
print("held")
