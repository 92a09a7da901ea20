"""Right answers but for an offset: of all gaps alike, or of all displacements alike."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from contactqp.oracle.diagnosis.evidence import LEFT, Evidence, Explanation
from contactqp.oracle.diagnosis.finding import Finding
from contactqp.oracle.diagnosis.symptoms import unit_of

# Nodes that must have moved alike, and pushing contacts that must have one gap.
NODES, CONTACTS, SOME = 3, 2, 50


def shifted(evidence: Evidence) -> Iterator[Explanation]:
    """Offsets of gaps and of displacements."""
    yield from _gaps(evidence)
    yield from _displacements(evidence)


def _gaps(evidence: Evidence) -> Iterator[Explanation]:
    """All contacts that push have one and the same gap, and with all gaps less this one the answer passes."""
    found, problem = evidence.certificate.violations, evidence.problem
    if found is None:
        return
    limit = evidence.certificate.tolerance
    pushing = evidence.answer.normal_force > 0
    pushing &= found.force_measure > limit
    if np.sum(pushing) < CONTACTS or not np.all(found.gap_measure[pushing] > limit):
        return
    rows = problem.normal[np.flatnonzero(pushing)[:SOME]].toarray()
    if np.linalg.matrix_rank(rows) < CONTACTS:  # rows that say the same have one gap whatever is wrong
        return
    offset = float(np.median(found.gap[pushing]))
    if not np.isfinite(offset) or np.max(abs(found.gap[pushing] - offset)) > LEFT * abs(offset):
        return
    if evidence.passes_with(gap=problem.gap - offset):
        size = f"{abs(offset):.4g}{unit_of(problem.units.length)}"
        text = (
            f"it is the right answer with every gap {'smaller' if offset > 0 else 'larger'} by {size}: a thickness, an "
            "offset of surfaces or an adjustment of nodes?"
        )
        yield Explanation(Finding("gap-offset", text, True), 0.0)


def _displacements(evidence: Evidence) -> Iterator[Explanation]:
    """All nodes are off by the same."""
    u, right = evidence.given.displacement, evidence.right
    if u is None or right is None or not np.all(np.isfinite(u)):
        return
    off = u - right.displacement
    for d in (1, 2, 3):
        if len(u) % d or len(u) < NODES * d:
            continue
        mean = np.mean(off.reshape(-1, d), axis=0)
        back = np.ravel(np.full((len(u) // d, d), mean))
        undone = evidence.with_parts(displacement=u - back)
        left = evidence.apart(undone, right)
        if np.any(mean) and evidence.explains(left):
            sizes = ", ".join(f"{one:.4g}" for one in mean)
            size = f"({sizes})" if d > 1 else sizes
            unit = unit_of(evidence.problem.units.length)
            text = (
                f"all displacements are off by the same {size}{unit}: counted from elsewhere, or a rigid motion was "
                f"added? Without it {evidence.then(undone, left)}"
            )
            yield Explanation(Finding("shifted", text, True), left)
            return
