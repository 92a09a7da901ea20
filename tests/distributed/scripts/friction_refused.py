"""What a spoilt solver says of friction is refused on every rank."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from friction_bodies import pushed_in_plane

import contactqp as cq
from contactqp.distributed.distributing import distribute
from contactqp.distributed.ranks import Ranks
from contactqp.distributed.solving import solve_distributed
from contactqp.solving.friction.by_iteration import FrictionNewton

ranks = Ranks()
part = distribute(pushed_in_plane(0.3), ranks)
right = FrictionNewton.run
SPOILT = {
    "without friction": lambda found: replace(found, friction_force=np.zeros_like(found.friction_force)),
    "friction along the slip": lambda found: replace(found, friction_force=-found.friction_force),
    "friction of 1.001 of it": lambda found: replace(found, friction_force=1.001 * found.friction_force),
    "a displacement of 1.000001 of it": lambda found: replace(found, displacement=1.000001 * found.displacement),
}
for spoil in SPOILT.values():
    FrictionNewton.run = lambda self, start, spoil=spoil: spoil(right(self, start))
    with pytest.raises(cq.NotCertified, match="refuses the answer"):
        solve_distributed(part)
FrictionNewton.run = lambda *_: None
with pytest.raises(cq.NotConverged, match="have not settled in 2 steps") as refused:
    solve_distributed(part, max_iter=2)
assert len(refused.value.history) == 2
if ranks.rank == 0:
    print("refused")
