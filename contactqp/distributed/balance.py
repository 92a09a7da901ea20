"""Whether the outer forces of every body balance, wherever its parts are: `contactqp.certificate.figures` by
reductions.

A body's motions, at most six, are judged at its home (`contactqp.distributed.bodies`): it is sent the triangular
factors R of w_j = z_j size_j on each rank, which together have the singular values of the whole w, and the sums that
the search for the worst motion asks for.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contactqp.certificate.figures import NO_RESULTANT, Resultants, resultants
from contactqp.distributed.answer import DistributedAnswer
from contactqp.distributed.bodies import Bodies
from contactqp.distributed.cutting_planes import CuttingPlanes
from contactqp.distributed.problem import DistributedProblem
from contactqp.distributed.rigid_motions import floating_bodies
from contactqp.distributed.violations import outer_forces, outer_resultant
from contactqp.model.arrays import Array, Vector


def balance(problem: DistributedProblem, answer: DistributedAnswer, bodies: Bodies) -> float:
    """The worst |z'r| / |z|'(|f| + |E|'|l| + |A|'|nu|) over all rigid motions z of the bodies. Collective.

    Bodies float as far as `soft_motions` tell; one that floats in another way is taken for held.

    Raises
    ------
    NotConverged
        The worst motion of a body was not found.
    """
    floating = floating_bodies(problem, bodies)
    if not problem.ranks.any(floating.floats):
        return 0.0
    Z, u = floating.motions, abs(answer.displacement)
    outer, size = outer_resultant(problem, answer), outer_forces(problem, answer)
    # K z is zero but for the rounding of K; what that makes of the displacement is no lack of balance.
    stray = np.column_stack([abs(problem.product(z)) * u for z in Z.T])
    parts = _Parts(bodies, floating.floats, Z * size[:, None])
    spectra, work, stray = parts.singular(), bodies.totals(Z * outer[:, None]), bodies.totals(stray)
    at_home = [i for i, (values, _) in enumerate(spectra) if values[0] > 0]  # no force acts on the others
    searches = {i: _Search(resultants(*spectra[i], work[i], stray[i])) for i in at_home}
    parts.mix({i: search.found.weight for i, search in searches.items()})
    forces, hidden = bodies.totals(abs(parts.basis)), 1.0 if problem.frictional else 0.0
    for i, search in searches.items():
        search.begin(forces[i], hidden)
    while problem.ranks.any([search.planes is not None for search in searches.values()]):
        sums = parts.asked({i: search.direction() for i, search in searches.items()})
        with problem.ranks.together():
            for i, search in searches.items():
                search.tell(sums[i])
    return float(problem.ranks.max(max((search.worst for search in searches.values()), default=0.0)))


class _Parts:
    """What this rank has of the columns w (n_here, r) of bodies; all methods are collective."""

    def __init__(self, bodies: Bodies, floats: NDArray[np.bool_], columns: Array) -> None:
        self._bodies, self._floats, self._columns = bodies, floats, columns
        self.basis = np.zeros_like(columns)

    def singular(self) -> list[tuple[Vector, Array]]:
        """The singular values and right vectors of w of each body at home here."""
        width = self._columns.shape[1]
        factors = np.zeros((len(self._floats), width, width))
        for place in np.flatnonzero(self._floats):
            factor = np.linalg.qr(self._columns[self._bodies.members(int(place))])[1]
            factors[place, : len(factor)] = factor
        came, body = self._bodies.parts(factors)
        stacked = (came[body == i].reshape(-1, width) for i in range(self._bodies.count))
        return [np.linalg.svd(rows, full_matrices=False)[1:] for rows in stacked]

    def mix(self, weights: dict[int, Array]) -> None:
        """Make the basis w weight' of the bodies at home here with weights (p, r), p <= r."""
        width = self._columns.shape[1]
        told = np.zeros((self._bodies.count, width, width))
        for i, weight in weights.items():
            told[i, :, : len(weight)] = weight.T
        self.basis = self._bodies.combined(self._columns, self._bodies.told(told))

    def asked(self, directions: dict[int, Vector]) -> Array:
        """The sums (count, r) of sign(basis a) basis for a direction (p,) of each body at home here."""
        told = np.zeros((self._bodies.count, self.basis.shape[1]))
        for i, direction in directions.items():
            told[i, : len(direction)] = direction
        along = self._bodies.combined(self.basis, self._bodies.told(told)[:, :, None])
        return self._bodies.totals(np.sign(along) * self.basis)


class _Search:
    """The worst motion of one body, at its home; `planes` while it is not found."""

    def __init__(self, found: Resultants) -> None:
        self.found, self.worst = found, 0.0
        self.planes: CuttingPlanes | None = None
        self._seen = np.zeros(0, dtype=np.intp)

    def begin(self, forces: Vector, hidden: float) -> None:
        """`forces` (r,) are the sums of the sizes of the coordinates."""
        forces = forces[: len(self.found.work)]
        if self.found.unseen(forces, hidden):
            self.worst = hidden
            return
        self.worst, self._seen = self.found.worst(forces), np.flatnonzero(self.found.seen(forces))
        if len(self._seen) > 1 and self.worst > NO_RESULTANT:
            self.planes = CuttingPlanes(self.found.work[self._seen])

    def direction(self) -> Vector:
        """(p,) the coordinates of the motion that is asked about; zero where nothing is."""
        asked = np.zeros(len(self.found.work))
        if self.planes is not None:
            asked[self._seen] = self.planes.question
        return asked

    def tell(self, sums: Vector) -> None:
        """Take the answer (r,)."""
        if self.planes is None:
            return
        asked = self.direction()
        self.worst = max(self.worst, self.found.net(asked) / float(sums[: len(asked)] @ asked))
        self.planes.tell(sums[self._seen])
        self.planes = None if self.planes.done else self.planes
