"""State the verdict of a cross-check: for each pair the forces of the other code, the exact ones, and the cause in
words.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from contactqp.elements.surface import Surface, diameters, kind_of
from contactqp.errors import counted
from contactqp.exchange.files import Ledger
from contactqp.model.arrays import TINY, Array, Index, Mask, Vector
from contactqp.model.names import Units
from contactqp.model.problem_data import ReadOnly
from contactqp.model.summary import aligned
from contactqp.oracle.foreign.crosscheck_forces import PairNodes

# A spring law is recognised if its stiffnesses at nine of ten nodes differ by at most this factor.
ALIKE = 1.5
# Nodes lie in one plane if their relative distance from it is below this.
PLANE = 1e-9
# A slave node is over the edge of the master within this part of a facet.
EDGE = 1e-6
# A force above this part of the tolerance times the resultant is mentioned.
WORTH = 0.1
# A pair has no force if its forces are below this part of the reference's.
NO_FORCE = 1e-3
# Nodes with less than this part of the largest force are not used for a stiffness.
PUSHING = 0.02


@dataclass(frozen=True, eq=False)
class Found:
    """The forces of a pair for comparison, after `PairNodes.shares`.

    Attributes
    ----------
    judged : PairNodes
    force, truth : (q,) arrays, normal forces of the other code and of the reference [force]
    gap : (q,) array, in the answer of the other code, NaN for nodes without partner [length]
    size : the reference resultant for errors [force]
    """

    judged: PairNodes
    force: Vector
    truth: Vector
    gap: Vector
    size: float


def causes_of(found: Found, tolerance: float) -> Iterator[str]:
    """Yield the causes of a pair's difference: no contact, adhesion, springs, a lost edge, forces across gaps."""
    if abs(found.force).sum() <= NO_FORCE * found.truth.sum():
        yield "it has no contact force: the pair was not found, or its surfaces do not reach each other"
        return
    least = WORTH * tolerance * found.size
    area = found.judged.shares @ found.judged.area
    pulls = found.force < -least
    if pulls.any():
        pull = f"{counted('node', int(pulls.sum()))} pull with {-found.force[pulls].sum():.4g} in all"
        yield (
            f"{pull}, {_range(-found.force[pulls] / area[pulls])} per area, across gaps of {_range(found.gap[pulls])}: "
            "adhesion, which contact has not"
        )
    yield from _springs(found, area)
    edge = _over_the_edge(found.judged)
    if found.judged.contact.pair.type == "MORTAR" and (edge & (abs(found.force - found.truth) > least)).any():
        yield (
            f"{counted('slave node', int(edge.sum()))} stand over the edge of the master surface, where a mortar "
            "loses a part of its integrals; let the master reach further than the slave"
        )
    far = (found.force > least) & (found.gap > 0) & (found.truth <= 0)
    if far.any():
        count = counted("node", int(far.sum()))
        yield f"{count} push across gaps of {_range(found.gap[far])}, where nothing touches"


def _springs(found: Found, area: Vector) -> Iterator[str]:
    pushing = (found.force > PUSHING * found.force.max(initial=0.0)) & (found.gap < 0)
    if pushing.sum() < 2:
        return
    stiffness = found.force[pushing] / (-found.gap[pushing] * area[pushing])
    low, high = np.quantile(stiffness, [0.05, 0.95])
    if high <= ALIKE * low:
        stated = found.judged.contact.interaction.stiffness
        told = "HARD" if stated is None else f"the deck states {stated:.4g}"
        springs = f"{np.median(stiffness):.4g} times area and overlap: springs in the place of contact ({told})"
        yield f"the force is {springs}"


def is_plane(surface: Surface) -> bool:
    """Return whether all nodes of a surface lie in one plane, up to the rounding of coordinates."""
    x = surface.points[surface.nodes]
    x = x - x.mean(axis=0)
    return bool(np.linalg.svd(x, compute_uv=False)[-1] <= PLANE * np.linalg.norm(x))


def _over_the_edge(judged: PairNodes) -> Mask:
    """Return the slave nodes (q,) over an edge that belongs to only one facet of the master."""
    pairing, master = judged.contact.pairing, judged.contact.master
    edges = master.facets[:, kind_of(master).edges].reshape(-1, kind_of(master).edges.shape[1])
    ordered, count = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    ends = master.points[ordered[count == 1]]  # (e, 1 or 2, d)
    start, along = ends[:, 0], ends[:, -1] - ends[:, 0]
    length = np.maximum((along**2).sum(axis=1), TINY)
    size = float(diameters(master.points[master.facets]).max())
    found = np.zeros(len(judged.nodes), dtype=bool)
    for i, row in enumerate(judged.row.tolist()):
        if row >= 0:
            foot = pairing.points[row] - pairing.gap[row] * pairing.direction[row]
            part = np.clip(((foot - start) * along).sum(axis=1) / length, 0.0, 1.0)
            apart = np.linalg.norm(foot - start - part[:, None] * along, axis=1)
            found[i] = bool(apart.min(initial=np.inf) <= EDGE * size)
    return found


def _range(values: Vector) -> str:
    known = values[np.isfinite(values)]
    if not len(known):
        return "unknown size"
    low, high = float(known.min()), float(known.max())
    return f"{low:.4g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.4g} to {high:.4g}"


Word = Literal["right", "wrong", "undecided"]
# The most nodes of each pair listed in a summary.
WORST = 5


@dataclass(frozen=True, eq=False)
class PairVerdict(ReadOnly):
    """The verdict on one contact pair.

    Attributes
    ----------
    name : str
        ``SLAVE on MASTER``.
    type : str
        The type in the deck: ``"NODE TO SURFACE"``, ``"SURFACE TO SURFACE"`` or ``"MORTAR"``.
    word : str
        ``"right"``, ``"wrong"``, or ``"undecided"`` if the error of printed digits or of the mesh exceeds the
        tolerance.
    resultant, reference_resultant : float
        The sums of the normal forces of the other code and of the reference [force].
    total, reference_total : (d,) arrays
        The force vectors on the slave surface, including friction [force].
    error, node_error : float
        The difference of the resultants or the vectors, and the largest at a node, relative to the resultant [-].
    noise : float
        The error due to printed digits, likewise [-].
    penalty_resultant, other_resultant : float, optional
        The sums of the exact forces of the deck's springs, and in another discretisation of the mesh: no overlap at
        Gauss points of the faces or, for quadratic faces, at nodes.
    mesh_error, mesh_node_error : float
        The differences of exact answers in other discretisations of the mesh, measured likewise [-]; 0 for contact of
        nodes.
    causes : tuple of str
        The causes of the difference, in words.
    labels : (m,) array of int
        The slave nodes that can move; of quadratic faces with integration points, the corners.
    force, reference_force : (m,) arrays
        Their normal forces [force].
    gap : (m,) array
        Their gaps in the answer of the other code, negative for overlap [length].
    points : (m, d) array
        The coordinates of these nodes [length].
    pressure, reference_pressure : (m,) arrays
        The pressures at these nodes by projection of the forces [force / length^2].
    notes : tuple of str
        Notes on quantities for which the mesh is too coarse.
    friction, reference_friction : float, optional
        The sums of the sizes of the tangential forces; None without friction, and if other forces act on the nodes
        [force].
    """

    name: str
    type: str
    word: Word
    resultant: float
    reference_resultant: float
    total: Vector
    reference_total: Vector
    error: float
    node_error: float
    noise: float
    penalty_resultant: float | None
    other_resultant: float | None
    mesh_error: float
    mesh_node_error: float
    causes: tuple[str, ...]
    labels: Index
    force: Vector
    reference_force: Vector
    gap: Vector
    points: Array
    pressure: Vector
    reference_pressure: Vector
    notes: tuple[str, ...] = ()
    friction: float | None = None
    reference_friction: float | None = None

    @property
    def worst(self) -> Index:
        """Return the contacts whose forces differ most, the worst first."""
        order = np.argsort(-abs(self.force - self.reference_force), kind="stable")
        return np.asarray(order[:WORST])

    def data(self) -> dict[str, Any]:
        """Return the verdict as plain data for JSON."""
        return {
            "pair": self.name,
            "type": self.type,
            "verdict": self.word,
            "resultant": self.resultant,
            "reference_resultant": self.reference_resultant,
            "total": self.total.tolist(),
            "reference_total": self.reference_total.tolist(),
            "error": self.error,
            "node_error": self.node_error,
            "noise": self.noise,
            "friction": self.friction,
            "reference_friction": self.reference_friction,
            "penalty_resultant": self.penalty_resultant,
            "other_resultant": self.other_resultant,
            "mesh_error": self.mesh_error,
            "mesh_node_error": self.mesh_node_error,
            "causes": list(self.causes),
            "notes": list(self.notes),
            "nodes": [
                {
                    "node": int(self.labels[i]),
                    "force": float(self.force[i]),
                    "reference_force": float(self.reference_force[i]),
                    "gap": float(self.gap[i]),
                }
                for i in self.worst.tolist()
            ],
        }


@dataclass(frozen=True, eq=False)
class CrossCheck(ReadOnly):
    """The result of `crosscheck`, which is false unless every pair is right and all forces balance.

    Attributes
    ----------
    deck : str
    results : str
        The file of the judged answer.
    code : str
        The program that wrote it, if known.
    reference : str
        ``"exact"`` or ``"penalty"``.
    error_tolerance : float
        The largest admissible `error` of a pair.
    pairs : tuple of PairVerdict
    findings : tuple of str
        Errors other than those of contact pairs: unbalanced unknowns, supports that moved.
    warnings : tuple of str
        Warnings of the program.
    ledger : Ledger
        How the cards of the deck were read.
    units : Units
        The names of the deck's units for messages, none by default.
    """

    deck: str
    results: str
    code: str
    reference: str
    error_tolerance: float
    pairs: tuple[PairVerdict, ...]
    findings: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    ledger: Ledger = field(default_factory=lambda: Ledger(""))
    units: Units = field(default_factory=Units)

    @property
    def word(self) -> Word:
        """Return ``"right"``, ``"wrong"`` or ``"undecided"``."""
        words = {pair.word for pair in self.pairs}
        if self.findings or "wrong" in words:
            return "wrong"
        return "undecided" if "undecided" in words else "right"

    @property
    def passed(self) -> bool:
        """Return whether everything is right within the tolerance."""
        return self.word == "right"

    def __bool__(self) -> bool:
        return self.passed

    def __repr__(self) -> str:
        causes = [*self.findings, *(cause for pair in self.pairs for cause in pair.causes)]
        return f"CrossCheck({self.deck}: {self.word}{f', {causes[0]}' if causes else ''})"

    def __str__(self) -> str:
        return self.summary()

    def summary(self) -> str:
        """Return the verdict in words, pair by pair."""
        word = self.word if self.passed else self.word.upper()
        lines = [f"{self.deck}: {word} by {self.code} ({self.results})"]
        lines += [f"  {finding}" for finding in self.findings]
        for pair in self.pairs:
            lines += _of_pair(pair, self.reference, self.error_tolerance, self.units)
        if not self.pairs:
            lines.append("  the deck has no contact pairs")
        lines += [f"  {self.code} warns: {warning}" for warning in self.warnings if not self.passed]
        lines += [f"  assumed: {line}" for line in self.ledger.assumed]
        return "\n".join(lines)

    def data(self) -> dict[str, Any]:
        """Return the verdict as plain data for JSON."""
        return {
            "deck": self.deck,
            "results": self.results,
            "code": self.code,
            "reference": self.reference,
            "error_tolerance": self.error_tolerance,
            "units": {"length": self.units.length, "force": self.units.force},
            "verdict": self.word,
            "passed": self.passed,
            "findings": list(self.findings),
            "warnings": list(self.warnings),
            "pairs": [pair.data() for pair in self.pairs],
            "ledger": self.ledger.data(),
        }


def _of_pair(pair: PairVerdict, reference: str, tolerance: float, units: Units) -> list[str]:
    word = pair.word if pair.word == "right" else pair.word.upper()
    difference = pair.resultant - pair.reference_resultant
    off = f"off by {pair.error:.2g} of the resultant, a node by {pair.node_error:.2g}; {tolerance:g} is asked for"
    lines = [
        f"  {pair.name} ({pair.type}): {word}, {off}",
        f"    resultant {pair.resultant:.6g}{units.force and f' {units.force}'}, {reference} "
        f"{pair.reference_resultant:.6g}, difference {difference:.3g}{_others(pair, reference)}",
    ]
    if pair.friction is not None and pair.reference_friction is not None:
        apart = pair.friction - pair.reference_friction
        along = f"{pair.friction:.6g}{units.force and f' {units.force}'}, {reference} {pair.reference_friction:.6g}"
        lines.append(f"    friction at all nodes {along}, difference {apart:.3g}")
    if pair.noise > 0.1 * tolerance:
        lines.append(f"    the printed digits leave {pair.noise:.2g} of the resultant open")
    if pair.mesh_node_error > 0.1 * tolerance:
        mesh = f"{pair.mesh_error:.2g} in the resultant, {pair.mesh_node_error:.2g} at a node"
        lines.append(f"    two exact discretisations of this mesh differ by {mesh}")
    lines += [f"    {line}" for line in (*pair.notes, *pair.causes)]
    if pair.word != "right" and len(pair.labels):
        lines += _table(pair, reference, units)
    return lines


def _others(pair: PairVerdict, reference: str) -> str:
    told = ""
    if pair.penalty_resultant is not None and reference == "exact":
        told += f"; on the springs of the deck {pair.penalty_resultant:.6g}"
    if pair.other_resultant is not None:
        told += f"; discretised otherwise {pair.other_resultant:.6g}"
    return told


def _table(pair: PairVerdict, reference: str, units: Units) -> Sequence[str]:
    force, length = (f" [{unit}]" if unit else "" for unit in (units.force, units.length))
    rows = [("node", f"force{force}", f"{reference}{force}", f"gap{length}")]
    for i in pair.worst.tolist():
        numbers = (pair.force[i], pair.reference_force[i], pair.gap[i])
        force, right, gap = (f"{value:.4g}" for value in numbers)
        rows.append((str(int(pair.labels[i])), force, right, gap))
    return [f"      {line}" for line in aligned(rows, ">>")]
