"""The friction path's benchmark on a small block: what it counts, not how long it takes."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import friction_path


@pytest.mark.slow
@pytest.mark.parametrize("name", friction_path.OBSTACLES)
def test_a_small_block_takes_one_factorisation(name: str) -> None:
    rough, loads = friction_path.block(friction_path.OBSTACLES[name], friction_path.FRICTION, contacts=12, rows=6)
    history, walked, looked = friction_path._walked(rough, loads, steps=20)
    assert rough.contacts == 12
    assert len(history) == 21
    assert 0 < walked < looked
    assert sum(solution.work.factorisations for solution in history) == 1
    assert {event.kind for event in history.events} >= {"closed", "slip"}
    assert history.energies[-1].dissipated > 0
    assert np.any(history[-1].contact_status == "slip")


def test_the_target_is_missed_where_it_is() -> None:
    measured = dict(unknowns=1, contacts=1, smooth=1.0, smooth_step=1.0, rough_step=1.0, smooth_looked=1.0)
    fast = friction_path.Price(**measured, rough=4.9, rough_looked=9.0, events=1, factorisations=1)
    slow = friction_path.Price(**measured, rough=5.1, rough_looked=9.0, events=1, factorisations=1)
    again = friction_path.Price(**measured, rough=4.9, rough_looked=9.0, events=1, factorisations=2)
    assert (fast.met, slow.met, again.met) == (True, False, False)
