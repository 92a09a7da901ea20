"""Answers of which every value is right but one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.oracle.diagnosis.evidence import Evidence, Explanation
from contactqp.oracle.diagnosis.finding import Finding
from contactqp.oracle.diagnosis.symptoms import unit_of

# Values that there must be.
LEAST = 6
# A value this near to the right one, as a part of the largest of its kind, is right.
RIGHT = 1e-9


def one_value(evidence: Evidence) -> Iterator[Explanation]:
    """All values but one are right."""
    right = evidence.right
    if right is None or evidence.shared:
        return
    wrong: list[tuple[str, int, float, float]] = []
    count = 0
    for name in evidence.given_parts:
        mine, should = np.ravel(getattr(evidence.given, name)), np.ravel(getattr(right, name))
        weight = np.ravel(evidence.weights[name])
        size = float(np.max(abs(weight * should), initial=0.0)) or 1.0
        count += len(mine)
        off = np.flatnonzero(abs(weight * (mine - should)) > RIGHT * size)
        wrong += [(name, int(i), float(mine[i]), float(should[i])) for i in off]
    if len(wrong) != 1 or count < LEAST:
        return
    name, i, mine_value, should_value = wrong[0]
    problem, values = evidence.problem, getattr(evidence.given, name)
    width = values.shape[1] if values.ndim > 1 else 1
    called = problem.dof_name if name == "displacement" else problem.contact_name
    where = f"tie {i}" if name == "tie_force" else called(i // width)
    unit = unit_of(problem.units.length if name == "displacement" else problem.units.force)
    what = f"the {name.replace('_', ' ')} of {where}"
    text = f"all values are right but one: {what} is {mine_value:.6g}{unit} instead of {should_value:.6g}{unit}"
    yield Explanation(Finding("one-value", text, True), 0.0)
