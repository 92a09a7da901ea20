"""Judge the contact of a deck in another code: run CalculiX or read its results, and compare forces with exact ones.

The forces of the other code follow from its displacements u by the deck's own stiffness: K u - f is what contacts, ties
and supports do to the bodies, node by node. At a slave node that is the contact force, along the normal of the master.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path as FilePath
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from contactqp.elements.surface import Surface, diameters, kind_of
from contactqp.errors import BackendFailed, ContactQPError, InvalidProblem, counted
from contactqp.exchange.calculix_process import run_calculix
from contactqp.exchange.calculix_results import read_displacements
from contactqp.exchange.deck.reading import read_deck_model
from contactqp.exchange.files import Path, naming
from contactqp.linalg.equilibration import unknown_scale
from contactqp.model.arguments import checked
from contactqp.model.arrays import Index, Vector
from contactqp.oracle.foreign.crosscheck_verdict import CrossCheck, PairVerdict, Word
from contactqp.oracle.foreign.recovery import balancing_forces
from contactqp.scene.deck.contacts import DeckContact
from contactqp.scene.deck.deck import Deck, DeckContacts, read_deck
from contactqp.solving.solve import solve

# Digits that CalculiX prints of a number.
DAT_DIGITS, FRD_DIGITS = 7, 6
# Rounding of printed digits is even over half a unit of the last one: so many standard deviations are no doubt left.
SURE = 6.0
# A support has moved where the answer differs from what is prescribed by more units of its last digit than this.
MOVED = 10.0
# A spring law is recognised where its stiffnesses at nine nodes in ten differ by no more than this factor.
ALIKE = 1.5
# Nodes lie in one plane where the part of their coordinates across it is below this.
PLANE = 1e-9
# A slave node stands over the edge of the master within this part of a facet.
EDGE = 1e-6
# A pair whose forces are below this part of what the tolerance is of all forces has none.
NEGLIGIBLE = 1e-3


@checked
def crosscheck(
    path: Path,
    results: Path | None = None,
    *,
    reference: Literal["exact", "penalty"] = "exact",
    error_tolerance: float = 1e-2,
    time_limit: float = 600.0,
    folder: Path | None = None,
) -> CrossCheck:
    """Judge the contact of a deck as CalculiX solves it, pair by pair.

    A pair is right where its resultant, the vector of its forces and the force of every node are within
    `error_tolerance` times the resultant of the reference. The verdict says what parts the answers: springs in the
    place of contact, nodes that pull, numbers that were cut off, contact that was not found.

    Parameters
    ----------
    path : path
        The deck, as `read_deck` takes it.
    results : path, optional
        A .dat or .frd file with the displacements of all nodes. By default the deck is run by ``ccx`` (or the command
        that CONTACTQP_CCX names).
    reference : str
        ``"exact"``: no overlap; ``"penalty"``: the springs that the deck states, exactly.
    error_tolerance : float
    time_limit : float
        Seconds for CalculiX.
    folder : path, optional
        Where CalculiX runs and its files are kept: by default MODEL.ccx beside MODEL.inp.

    Returns
    -------
    CrossCheck
        ``passed``, ``pairs``, ``summary()``; false where anything is wrong.

    Raises
    ------
    InvalidProblem
        A deck or results that cannot be read; by file and line.
    BackendMissing
        No results are given and CalculiX is not installed.
    BackendFailed
        CalculiX ended with an error, did not end in time, or left half a file; what it printed is kept.
    """
    if not 0 < error_tolerance < 1:
        raise InvalidProblem(f"error_tolerance: expected a number between 0 and 1, got {error_tolerance:g}")
    if not time_limit > 0:
        raise InvalidProblem(f"time_limit: expected a positive number of seconds, got {time_limit:g}")
    deck = read_deck(path)
    warnings: tuple[str, ...] = ()
    code, file = "its results", results
    with naming(path):
        labels = deck.assembly.topology.labels
    if file is None:
        own = FilePath(path).with_suffix(".ccx") if folder is None else FilePath(folder)
        run = run_calculix(path, labels, own, time_limit)
        file, code, warnings = run.results, run.version, run.warnings
    answer = _Answer(deck, *_displacements(deck, file, ran=results is None))
    judged = _Judging(answer, reference, error_tolerance)
    return CrossCheck(
        str(path), str(file), code, reference, error_tolerance, judged.pairs, judged.findings, warnings, deck.ledger
    )


def _displacements(deck: Deck, file: Path, *, ran: bool) -> tuple[Vector, Vector]:
    """Return u of all unknowns and the size of the unit of its last printed digit [length]."""
    try:
        field, ledger = read_displacements(file)
    except InvalidProblem as error:
        if ran:
            raise BackendFailed(f"CalculiX left half a file: {error}") from None
        raise
    end = deck.model.end
    if abs(field.time - end) > 1e-5 * end:
        told = f"{file}: the results end at time {field.time:g} of {end:g}: the run broke off"
        raise BackendFailed(told) if ran else InvalidProblem(told)
    topology = deck.assembly.topology
    d = topology.dimension
    order = np.argsort(field.nodes, kind="stable")
    at = np.searchsorted(field.nodes[order], topology.labels)
    missing = at >= len(order)
    missing[~missing] |= field.nodes[order[at[~missing]]] != topology.labels[~missing]
    if missing.any():
        label = topology.labels[missing][0]
        raise InvalidProblem(f"{file}: expected displacements of all nodes, got none of node {label}; print U of all")
    u = field.values[order[at], :d].ravel()
    if not np.isfinite(u).all():
        name = topology.name(int(np.argmin(np.isfinite(u))))
        raise InvalidProblem(f"{file}: expected finite displacements, got another one at {name}")
    digits = FRD_DIGITS if str(file).lower().endswith(".frd") else DAT_DIGITS
    deck.ledger.read.extend(ledger.read)
    with np.errstate(divide="ignore"):
        exponent = np.floor(np.log10(abs(u)))
    return u, np.where(u == 0, 0.0, 10.0 ** (np.where(u == 0, 0.0, exponent) - digits + 1))


@dataclass(frozen=True, eq=False)
class _Answer:
    """The answer of the other code over all unknowns of a deck.

    Attributes
    ----------
    u : (n,) array [length]
    unit : (n,) array
        What the last printed digit of each is worth [length].
    """

    deck: Deck
    u: Vector
    unit: Vector

    @cached_property
    def forces(self) -> Vector:
        """Return K u - f, what contacts, ties and supports do to the bodies, (n,) [force]."""
        return np.asarray(self.deck.assembly.stiffness @ self.u - self.deck.assembly.load)

    @cached_property
    def variance(self) -> Vector:
        """Return the variance of the rounding of each u, even over one unit of the last digit [length^2]."""
        return np.asarray(self.unit**2 / 12)

    @cached_property
    def noise(self) -> Vector:
        """Return what the printed digits leave of `forces`, (n,) [force]."""
        squares = self.deck.assembly.stiffness.copy()
        squares.data = squares.data**2
        return np.asarray(SURE * np.sqrt(squares @ self.variance))

    def noise_along(self, direction: Vector) -> float:
        """Return what the printed digits leave of the sum of the forces times a direction (n,) [force]."""
        along = self.deck.assembly.stiffness @ direction
        return float(SURE * np.sqrt((along**2) @ self.variance))

    def contact_forces(self, contacts: DeckContacts, number: int) -> tuple[Vector, NDArray[np.float64]]:
        """Return the normal forces (m,) of the contacts of a pair that a free unknown moves, and their vectors (m, d).

        Where supports, ties or other pairs act on the same unknowns, the forces of all contacts follow together.
        """
        contact = contacts.pairs[number]
        of_problem, of_pair = contacts.of_pair(number)
        direction = contact.pairing.direction[of_pair]
        unknowns = contact.slave.unknowns[contact.pairing.nodes[of_pair]]
        if not np.isin(unknowns[direction != 0], self._also_acted(contacts, number)).any():
            on_slave = self.forces[unknowns]
            return np.einsum("md,md->m", on_slave, direction), on_slave
        rows, free = contacts.free.normal, self.deck.free
        scale = unknown_scale(self.deck.problem())
        every, _ = balancing_forces(rows, -self.forces[free], np.zeros(rows.shape[0], dtype=bool), scale)
        return every[of_problem], every[of_problem, None] * direction

    def _also_acted(self, contacts: DeckContacts, number: int) -> Index:
        """Return the unknowns on which something else than the contacts of one pair acts."""
        parts = [np.flatnonzero(~np.isnan(self.deck.assembly.prescribed)), self.deck.ties.indices]
        parts += [one.pairing.normal.indices for other, one in enumerate(contacts.pairs) if other != number]
        return np.unique(np.concatenate(parts)).astype(np.int64)


@dataclass(frozen=True, eq=False)
class _Forces:
    """The forces of a reference: normal forces (m,) and vectors on the slave nodes (m, d) of each pair [force]."""

    normal: list[Vector]
    vectors: list[NDArray[np.float64]]


def _reference(deck: Deck, contacts: DeckContacts, enforcement: Literal["exact", "penalty"]) -> _Forces:
    """Return the forces of the exact answer, or of the exact one on springs, pair by pair."""
    mortar = contacts is not deck.by_nodes
    problem = deck.problem(enforcement, "mortar" if mortar else "node-to-segment")
    solution = solve(problem)
    normal, vectors = [], []
    for number, contact in enumerate(contacts.pairs):
        of_problem, of_pair = contacts.of_pair(number)
        force = np.zeros(len(contact.labels))
        force[of_pair] = solution.normal_force[of_problem]
        on_bodies = -(contact.pairing.normal.T @ force)
        if solution.friction_force is not None:
            d = contact.pairing.direction.shape[1]
            along = np.zeros((len(force), d - 1))
            along[of_pair] = np.asarray(solution.friction_force)[of_problem].reshape(-1, d - 1)
            on_bodies -= contact.pairing.tangent.T @ along.ravel()
        normal.append(force[of_pair])
        vectors.append(on_bodies[contact.slave.unknowns[contact.pairing.nodes[of_pair]]])
    return _Forces(normal, vectors)


def _other_reference(
    deck: Deck, contacts: DeckContacts, enforcement: Literal["exact", "penalty"], notes: list[str]
) -> _Forces | None:
    """Return the forces of a reference that is set beside the one that is judged by; None where there is none."""
    try:
        return _reference(deck, contacts, enforcement)
    except ContactQPError as error:
        notes.append(f"{enforcement} answer beside: none ({error})")
        return None


@dataclass(frozen=True, eq=False)
class _Judging:
    """The verdict on an answer, by a reference."""

    answer: _Answer
    reference: Literal["exact", "penalty"]
    tolerance: float

    @property
    def deck(self) -> Deck:
        return self.answer.deck

    @cached_property
    def _truth(self) -> _Forces:
        return _reference(self.deck, self.deck.by_nodes, self.reference)

    @cached_property
    def _springs(self) -> _Forces | None:
        if self.reference == "penalty":
            return self._truth
        return _other_reference(self.deck, self.deck.by_nodes, "penalty", self.deck.ledger.assumed)

    @cached_property
    def _mortar(self) -> _Forces | None:
        asked = any(one.pair.type != "NODE TO SURFACE" for one in self.deck.by_nodes.pairs)
        if not asked or self.reference == "penalty":
            return None
        try:
            if all(one.discretisation != "mortar" for one in self.deck.by_mortar.pairs):
                return None
        except ContactQPError:
            return None
        return _other_reference(self.deck, self.deck.by_mortar, "exact", self.deck.ledger.assumed)

    @cached_property
    def scale(self) -> float:
        """Return the size of the forces of the deck: loads, supports and contacts [force]."""
        held = ~np.isnan(self.deck.assembly.prescribed)
        sizes = [float(np.linalg.norm(self.deck.assembly.load)), float(np.linalg.norm(self.answer.forces[held]))]
        return max(*sizes, *(float(force.sum()) for force in self._truth.normal), 0.0)

    @cached_property
    def pairs(self) -> tuple[PairVerdict, ...]:
        """Return the verdicts on the contact pairs."""
        return tuple(self._pair(number) for number in range(len(self.deck.by_nodes.pairs)))

    def _pair(self, number: int) -> PairVerdict:
        contacts = self.deck.by_nodes
        contact = contacts.pairs[number]
        _, moved = contacts.of_pair(number)
        force, vectors = self.answer.contact_forces(contacts, number)
        truth, truth_vectors = self._truth.normal[number], self._truth.vectors[number]
        direction = contact.pairing.direction[moved]
        unknowns = contact.slave.unknowns[contact.pairing.nodes[moved]]
        noise = self._noise(direction, unknowns)
        digits = np.linalg.norm(self.answer.noise[unknowns] * direction, axis=1)
        each = np.maximum(abs(force - truth) - digits, 0.0)
        size = max(float(truth.sum()), float(np.maximum(abs(force) - digits, 0.0).sum()))
        error = max(
            abs(float(force.sum() - truth.sum())),
            float(np.linalg.norm((vectors - truth_vectors).sum(axis=0))),
            float(each.max(initial=0.0)),
        )
        gap = (contact.pairing.gap - contact.pairing.normal @ self.answer.u)[moved]
        if size <= NEGLIGIBLE * self.tolerance * self.scale:  # nothing touches, but for the printed digits
            error, noise, size = 0.0, 0.0, 1.0
        mesh, relative, left = self._mesh_error(contact, number, size), error / size, noise / size
        return PairVerdict(
            name=contact.pair.name,
            type=contact.pair.type,
            word=self._word(relative, left, mesh),
            resultant=float(force.sum()),
            reference_resultant=float(truth.sum()),
            total=vectors.sum(axis=0),
            reference_total=truth_vectors.sum(axis=0),
            error=relative,
            noise=left,
            penalty_resultant=None if self._springs is None else float(self._springs.normal[number].sum()),
            mortar_resultant=None if self._mortar is None else float(self._mortar.normal[number].sum()),
            mesh_error=mesh,
            causes=() if relative <= self.tolerance else tuple(self._causes(contact, number, force, gap, size)),
            labels=contact.labels[moved],
            force=force,
            reference_force=truth,
            gap=gap,
        )

    def _word(self, error: float, noise: float, mesh: float) -> Word:
        if error <= self.tolerance:
            return "right" if noise <= self.tolerance else "undecided"
        return "wrong" if error > self.tolerance + noise and error > mesh else "undecided"

    def _noise(self, direction: NDArray[np.float64], unknowns: Index) -> float:
        """Return what the printed digits leave of the resultant of a pair, and of its vector [force]."""
        along = np.zeros((1 + unknowns.shape[1], len(self.answer.u)))
        along[0, unknowns] = direction
        for axis in range(unknowns.shape[1]):
            along[1 + axis, unknowns[:, axis]] = 1.0
        return max(self.answer.noise_along(one) for one in along)

    def _mesh_error(self, contact: DeckContact, number: int, size: float) -> float:
        """Return how far the resultants of the two discretisations are apart, of the resultant.

        0 where the deck asks for nodes, and on a plane master: there, what does not overlap at the nodes of linear
        faces overlaps nowhere.
        """
        if self._mortar is None or contact.pair.type == "NODE TO SURFACE" or _is_plane(contact.master):
            return 0.0
        return abs(float(self._mortar.normal[number].sum() - self._truth.normal[number].sum())) / size

    def _causes(self, contact: DeckContact, number: int, force: Vector, gap: Vector, size: float) -> Iterator[str]:
        """Yield in words what parts the answer from the reference."""
        truth, (_, moved) = self._truth.normal[number], self.deck.by_nodes.of_pair(number)
        area = np.asarray(contact.pairing.area)[moved]
        if abs(force).sum() <= 1e-3 * truth.sum():
            yield "it has no contact force: the pair was not found, or its surfaces do not reach each other"
            return
        pulls = force < -0.1 * self.tolerance * size
        if pulls.any():
            p = -force[pulls] / area[pulls]
            yield (
                f"{counted('node', int(pulls.sum()))} pull with {-force[pulls].sum():.4g} in all, "
                f"{_range(p)} per area, across gaps of {_range(gap[pulls])}: adhesion, which contact has not"
            )
        pushing = (force > 0.02 * force.max(initial=0.0)) & (gap < 0)
        if pushing.sum() >= 2:
            k = force[pushing] / (-gap[pushing] * area[pushing])
            low, high = np.quantile(k, [0.05, 0.95])
            if high <= ALIKE * low:
                stated = contact.interaction.stiffness
                told = "HARD" if stated is None else f"the deck states {stated:.4g}"
                springs = f"{np.median(k):.4g} times area and overlap: springs in the place of contact ({told})"
                yield f"the force is {springs}"
        if self.reference == "exact" and self._springs is not None:
            on_springs = self._springs.normal[number]
            apart, off = float(abs(force - on_springs).max()), float(abs(force - truth).max())
            if apart < off / 3:
                yield f"of the difference {1 - apart / off:.0%} is that of the springs that the deck states"
        edge = _over_the_edge(contact, moved)
        if (
            contact.pair.type == "MORTAR"
            and edge.any()
            and edge[abs(force - truth) > 0.1 * self.tolerance * size].any()
        ):
            yield (
                f"{counted('slave node', int(edge.sum()))} stand over the edge of the master surface, where a mortar "
                "loses a part of its integrals; let the master reach further than the slave"
            )
        far = (force > 0.1 * self.tolerance * size) & (gap > 0) & (truth == 0)
        if far.any():
            yield f"{counted('node', int(far.sum()))} push across gaps of {_range(gap[far])}, where nothing touches"

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """Return what is wrong beside the contact pairs."""
        return (*self._moved_supports(), *self._out_of_balance())

    def _moved_supports(self) -> Iterator[str]:
        prescribed = self.deck.assembly.prescribed
        held = np.flatnonzero(~np.isnan(prescribed))
        off = abs(self.answer.u[held] - prescribed[held])
        size = np.maximum(abs(prescribed[held]), abs(self.answer.u).max(initial=0.0) * 1e-6)
        wrong = held[off > MOVED * np.maximum(self.answer.unit[held], 1e-6 * size)]
        if len(wrong):
            name = self.deck.assembly.topology.name(int(wrong[0]))
            yield (
                f"{counted('support', len(wrong))} moved: {name} by {self.answer.u[wrong[0]]:.6g}, the deck prescribes "
                f"{prescribed[wrong[0]]:.6g}"
            )

    def _out_of_balance(self) -> Iterator[str]:
        """Say where forces do not balance that no contact, tie or support could supply."""
        left = self.answer.forces.copy()
        left[self._acted] = 0.0
        size = self.scale
        wrong = np.flatnonzero((abs(left) > self.answer.noise) & (abs(left) > self.tolerance * size))
        if not len(wrong):
            return
        order = wrong[np.argsort(-abs(left[wrong]), kind="stable")]
        names = ", ".join(f"{self.deck.assembly.topology.name(int(j))} by {left[j]:.4g}" for j in order[:3])
        more = f" and {len(order) - 3} more" if len(order) > 3 else ""
        yield f"out of balance where nothing touches: {names}{more}; loads, materials or elements differ from the deck"
        yield from self._cut_numbers(left[order])

    @cached_property
    def _acted(self) -> Index:
        """Return the unknowns on which contacts, ties or supports act."""
        contacts = self.deck.by_nodes.pairs
        parts = [np.flatnonzero(~np.isnan(self.deck.assembly.prescribed)), self.deck.ties.indices]
        for contact in contacts:
            parts += [side.unknowns[side.nodes].ravel() for side in (contact.slave, contact.master)]
        return np.unique(np.concatenate(parts)).astype(np.int64)

    def _cut_numbers(self, left: Vector) -> Iterator[str]:
        """Say whether numbers that CalculiX does not read whole are the reason."""
        if not self.deck.model.long_numbers:
            return
        try:
            cut = Deck(read_deck_model(self.deck.model.file, columns=20))
            forces = cut.assembly.stiffness @ self.answer.u - cut.assembly.load
        except ContactQPError:
            return
        forces[self._acted] = 0.0
        if float(abs(forces).max()) <= 0.1 * float(abs(left).max()):
            yield (
                f"with the first 20 characters of each number, which are all that CalculiX reads, it is in balance: "
                f"{self.deck.model.long_numbers[0]} and {counted('other line', len(self.deck.model.long_numbers) - 1)}"
            )


def _over_the_edge(contact: DeckContact, moved: Index) -> NDArray[np.bool_]:
    """Return which slave nodes of a pair stand over an edge that belongs to one facet of the master only, (m,)."""
    pairing, master = contact.pairing, contact.master
    feet = pairing.points[moved] - pairing.gap[moved, None] * pairing.direction[moved]
    edges = master.facets[:, kind_of(master).edges].reshape(-1, kind_of(master).edges.shape[1])
    ordered, count = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    ends = master.points[ordered[count == 1]]  # (e, 1 or 2, d)
    start, along = ends[:, 0], ends[:, -1] - ends[:, 0]
    length = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    size = float(diameters(master.points[master.facets]).max())
    found = np.zeros(len(feet), dtype=bool)
    for i, foot in enumerate(feet):
        part = np.clip(((foot - start) * along).sum(axis=1) / length, 0.0, 1.0)
        apart = np.linalg.norm(foot - start - part[:, None] * along, axis=1)
        found[i] = bool(apart.min(initial=np.inf) <= EDGE * size)
    return found


def _is_plane(surface: Surface) -> bool:
    """Return whether all nodes of a surface lie in one plane, up to the rounding of coordinates."""
    x = surface.points[surface.nodes]
    x = x - x.mean(axis=0)
    return bool(np.linalg.svd(x, compute_uv=False)[-1] <= PLANE * np.linalg.norm(x))


def _range(values: Vector) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.4g}" if f"{low:.3g}" == f"{high:.3g}" else f"{low:.4g} to {high:.4g}"
