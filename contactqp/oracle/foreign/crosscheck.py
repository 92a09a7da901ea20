"""Judge another code's contact forces for a deck: run CalculiX or read its results, and compare with exact forces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path as FilePath
from typing import Literal

import numpy as np

from contactqp.certificate.number_range import ABSURD
from contactqp.elements.scalars import places_among
from contactqp.errors import BackendFailed, ContactQPError, InvalidProblem, counted
from contactqp.exchange.calculix_results import read_displacements
from contactqp.exchange.deck.reading import read_deck_model
from contactqp.exchange.files import Ledger, Path, naming
from contactqp.exchange.processes import run_calculix
from contactqp.model.arguments import checked
from contactqp.model.arrays import EPS, TINY, Array, Index, Vector, own_floating_point
from contactqp.model.names import Units, read_units
from contactqp.oracle.foreign.crosscheck_forces import ForeignAnswer, PairNodes, pair_nodes, reference_forces
from contactqp.oracle.foreign.crosscheck_verdict import (
    WORTH,
    CrossCheck,
    Found,
    PairVerdict,
    Word,
    causes_of,
    is_plane,
)
from contactqp.scene.deck.contacts import Discretisation, note
from contactqp.scene.deck.deck import Deck, Enforcement, read_deck

# The number of digits printed by CalculiX.
DAT_DIGITS, FRD_DIGITS = 7, 6
# A support has moved if the displacement differs from the prescribed one by more than this many units of its last
# digit.
MOVED = 10.0
# A pair has no force if its forces are below this part of the tolerance times all forces.
NO_FORCE = 1e-3
# The rounding of gaps relative to the largest coordinate.
ROUNDING = 64 * EPS
# Faces have more Gauss points than nodes, so that frictional forces at them are not unique; for more points than this a
# solution takes minutes or fails.
MOST_POINTS = 300
# The type of the forces on the slave nodes of a pair, (q, d).
Forces = Array


@checked
@own_floating_point
def crosscheck(
    path: Path,
    results: Path | None = None,
    *,
    reference: Literal["exact", "penalty"] = "exact",
    error_tolerance: float = 1e-2,
    time_limit: float = 600.0,
    folder: Path | None = None,
    units: Units | Mapping[str, str] | None = None,
) -> CrossCheck:
    """Judge the contact of a deck as CalculiX solves it, pair by pair.

    A pair is right if its resultant, the vector of its forces, the sum of the sizes of its friction forces and the
    normal force of every node are within `error_tolerance` times the resultant of the reference. For contact of faces
    nodal forces may also differ by the difference of two exact discretisations of the mesh. The verdict has the causes
    of differences: springs instead of contact, nodes in tension, truncated numbers, contact that was not detected.

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
    units : Units or mapping with the keys ``length`` and ``force``, optional
        What the units of the deck are called in its words; nothing is converted.

    Returns
    -------
    CrossCheck
        ``passed``, ``pairs``, ``summary()``; false where anything is wrong.

    Raises
    ------
    InvalidProblem
        The deck or the results cannot be read; the message has file and line.
    BackendMissing
        No results are given, and CalculiX is not installed.
    BackendFailed
        CalculiX ended with an error, did not end in time, or wrote an incomplete file; its output is attached.
    """
    if not 0 < error_tolerance < 1:
        raise InvalidProblem(f"error_tolerance: expected a number between 0 and 1, got {error_tolerance:g}")
    if not time_limit > 0:
        raise InvalidProblem(f"time_limit: expected a positive number of seconds, got {time_limit:g}")
    named = read_units(units)
    deck = Deck(read_deck(path).model, expanded=True)
    warnings: tuple[str, ...] = ()
    code, file = "its results", results
    with naming(path):
        labels = deck.assembly.topology.labels
    if file is None:
        _refuse_two_types(deck)
        own = FilePath(path).with_suffix(".ccx") if folder is None else FilePath(folder)
        run = run_calculix(path, labels, own, time_limit)
        file, code, warnings = run.results, run.version, run.warnings
    answer = ForeignAnswer(deck, *_displacements(deck, file, ran=results is None))
    judged = _Judging(answer, reference, error_tolerance)
    return CrossCheck(
        str(path), str(file), code, reference, error_tolerance, judged.pairs, judged.findings, warnings, deck.ledger,
        named,
    )  # fmt: skip


def _refuse_two_types(deck: Deck) -> None:
    """Raise InvalidProblem if pairs of a deck have several types, with which CalculiX ends without a message."""
    first, *others = deck.model.pairs or (None,)
    for other in others:
        if first is not None and other.type != first.type:
            told = f"CalculiX runs contact pairs of one TYPE; this one is {other.type}, {first.name} {first.type}"
            raise InvalidProblem(f"{other.place}: *CONTACT PAIR: {told}; give results, or state the same for both")


def _displacements(deck: Deck, file: Path, *, ran: bool) -> tuple[Vector, Vector]:
    """Return u of all unknowns and the unit of its last printed digit [length]."""
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
    at, there = places_among(field.nodes, topology.labels)
    if not there.all():
        label = topology.labels[~there][0]
        raise InvalidProblem(f"{file}: expected displacements of all nodes, got none of node {label}; print U of all")
    u = field.values[at, :d].ravel()
    if not np.isfinite(u).all():
        name = topology.name(int(np.argmin(np.isfinite(u))))
        raise InvalidProblem(f"{file}: expected finite displacements, got another one at {name}")
    if (abs(u) > ABSURD * float(np.ptp(deck.assembly.points, axis=0).max())).any():
        worst = int(np.argmax(abs(u)))
        raise InvalidProblem(f"{file}: {topology.name(worst)} is displaced by {u[worst]:.6g}: the other code diverged")
    digits = FRD_DIGITS if str(file).lower().endswith(".frd") else DAT_DIGITS
    deck.ledger.read.extend(ledger.read)
    with np.errstate(divide="ignore"):
        exponent = np.floor(np.log10(abs(u)))
    unit = np.where(u == 0, 0.0, 10.0 ** (np.where(u == 0, 0.0, exponent) - digits + 1))
    u = deck.assembly.full_radii(u)
    return deck.assembly.with_thicknesses(u), np.pad(unit, (0, len(topology.thicknesses)))


@dataclass(frozen=True)
class Errors:
    """The errors of a pair's resultant, and of its worst nodal force, relative to the reference resultant."""

    resultant: float
    node: float


def _word(off: Errors, noise: float, mesh: Errors, tolerance: float) -> Word:
    """Return the verdict on a pair; differences between discretisations of the mesh are not an error.

    Errors above twice these are wrong; errors below them are right, if that of the resultant is within the tolerance.
    """
    if off.resultant <= tolerance and off.node <= max(tolerance, mesh.node):
        return "right" if noise <= tolerance else "undecided"
    if off.resultant > max(tolerance + noise, 2 * mesh.resultant) or off.node > max(tolerance, 2 * mesh.node):
        return "wrong"
    return "undecided"


@dataclass(frozen=True, eq=False)
class _Judging:
    """The comparison of an answer with a reference."""

    answer: ForeignAnswer
    reference: Literal["exact", "penalty"]
    tolerance: float

    @property
    def deck(self) -> Deck:
        return self.answer.deck

    @cached_property
    def _nodes(self) -> list[PairNodes]:
        return [pair_nodes(self.deck, number) for number in range(len(self.deck.contacts("node-to-segment").pairs))]

    @cached_property
    def _types(self) -> set[str]:
        return {one.contact.pair.type for one in self._nodes}

    @cached_property
    def _truth(self) -> list[Forces]:
        """Return the forces of the reference: no overlap at slave nodes or, for quadratic faces, at Gauss points."""
        if self.reference == "penalty":
            return self._on_springs
        if not self._by_points:
            return self._by_nodes
        return [
            points if one.of_quadratic_faces and one.alone else nodes
            for one, nodes, points in zip(self._nodes, self._by_nodes, self._by_points, strict=True)
        ]

    @cached_property
    def _by_nodes(self) -> list[Forces]:
        return reference_forces(self.deck, self._nodes, "exact", "node-to-segment")

    @cached_property
    def _on_springs(self) -> list[Forces]:
        """Return the forces of the deck's springs, at slave nodes or, for contact of faces, at integration points."""
        faces = [one.contact.pair.type == "SURFACE TO SURFACE" and one.alone for one in self._nodes]
        told = "penalty answer by points"
        points = self._if_any(told, lambda: self._spring_forces) if any(faces) else []
        if points and all(faces):
            return points
        nodes = reference_forces(self.deck, self._nodes, "penalty", "node-to-segment")
        return [points[at] if points and face else nodes[at] for at, face in enumerate(faces)]

    @cached_property
    def _by_points(self) -> list[Forces]:
        """Return the exact forces with no overlap at Gauss points for pairs of faces, [] if there are none.

        Stiff springs at the integration points of faces tend to these.
        """
        if self.reference == "penalty" or self._types <= {"NODE TO SURFACE"}:
            return []
        contacts = self.deck.contacts("points").free
        if contacts.friction is not None and len(contacts.kept) > MOST_POINTS:
            return self._if_any("exact answer by points", self._approximately_by_points)
        return self._by("exact", "points")

    def _approximately_by_points(self) -> list[Forces]:
        """Return the exact forces at nodes, corrected by the difference of springs at Gauss points and nodes."""
        on_springs = (self._spring_forces, reference_forces(self.deck, self._nodes, "penalty", "node-to-segment"))
        note(self.deck.ledger.assumed, "exact forces of faces: those of nodes, and the difference of both on springs")
        return [own + there - here for own, there, here in zip(self._by_nodes, *on_springs, strict=True)]

    @cached_property
    def _spring_forces(self) -> list[Forces]:
        """Return the forces of the deck's springs at Gauss points."""
        return reference_forces(self.deck, self._nodes, "penalty", "points")

    @cached_property
    def _by_mortar(self) -> list[Forces]:
        """Return the exact forces with no mean overlap for mortars on curved masters, [] if there are none."""
        curved = any(one.contact.pair.type == "MORTAR" and not is_plane(one.contact.master) for one in self._nodes)
        if self.reference == "penalty" or not curved:
            return []
        return self._by("exact", "mortar")

    @cached_property
    def _springs(self) -> list[Forces]:
        return self._truth if self.reference == "penalty" else self._if_any("penalty answer", lambda: self._on_springs)

    def _others(self, number: int) -> list[Forces]:
        """Return the exact forces of a pair of faces in other discretisations of the same mesh."""
        judged = self._nodes[number]
        if judged.contact.pair.type == "NODE TO SURFACE" or self.reference == "penalty":
            return []
        every = (self._by_nodes if judged.of_quadratic_faces else self._by_points, self._by_mortar)
        return [one[number] for one in every if one]

    def _by(self, enforcement: Enforcement, discretisation: Discretisation) -> list[Forces]:
        """Return the forces of the answer in one discretisation, or [] with a note in the ledger if it fails."""
        told = f"{enforcement} answer by {discretisation}"
        return self._if_any(told, lambda: reference_forces(self.deck, self._nodes, enforcement, discretisation))

    def _if_any(self, told: str, answer: Callable[[], list[Forces]]) -> list[Forces]:
        try:
            return answer()
        except ContactQPError as error:
            note(self.deck.ledger.assumed, f"no {told} is set beside ({error})")
            return []

    @cached_property
    def scale(self) -> float:
        """Return the size of the deck's forces: loads, supports, contacts, and rounding of coordinates [force]."""
        assembly = self.deck.assembly
        held = ~np.isnan(assembly.prescribed)
        rounding = ROUNDING * float(assembly.stiffness.diagonal().max()) * float(abs(assembly.points).max())
        sizes = [rounding / max(NO_FORCE * self.tolerance, TINY)]
        sizes += [float(np.linalg.norm(self.deck.assembly.load)), float(np.linalg.norm(self.answer.forces[held]))]
        return max(*sizes, *(float(np.linalg.norm(force.sum(axis=0))) for force in self._truth), 0.0)

    @cached_property
    def pairs(self) -> tuple[PairVerdict, ...]:
        """Return the verdicts on the contact pairs."""
        return tuple(self._pair(number) for number in range(len(self.deck.contacts("node-to-segment").pairs)))

    def _pair(self, number: int) -> PairVerdict:
        judged = self._nodes[number]
        given, vectors = judged.forces(self.answer)
        truth_vectors = self._truth[number]
        digits = np.linalg.norm(self.answer.noise[judged.unknowns] * judged.direction, axis=1)
        force, truth, digits = (judged.shares @ values for values in (given, judged.along(truth_vectors), digits))
        each = np.maximum(abs(force - truth) - digits, 0.0)
        size = max(float(truth.sum()), float(np.maximum(abs(force) - digits, 0.0).sum()))
        error = max(abs(float(force.sum() - truth.sum())), float(np.linalg.norm((vectors - truth_vectors).sum(axis=0))))
        along = judged.friction(vectors), judged.friction(truth_vectors)
        rounding = float(np.linalg.norm(self.answer.noise[judged.unknowns], axis=1).sum())
        error = max(error, abs(along[0] - along[1]) - rounding)
        noise = self._noise(judged)
        if size <= NO_FORCE * self.tolerance * self.scale:  # no contact, up to printed digits
            error, each, noise, size = 0.0, np.zeros(1), 0.0, 1.0
        off = Errors(error / size, float(each.max(initial=0.0)) / size)
        mesh, left = self._mesh_errors(number, size), noise / size
        word = _word(off, left, mesh, self.tolerance)
        found = Found(judged, force, truth, judged.gap(self.answer.u), size)
        kept = np.flatnonzero(judged.shares.diagonal())
        return PairVerdict(
            name=judged.contact.pair.name,
            type=judged.contact.pair.type,
            word=word,
            resultant=float(force.sum()),
            reference_resultant=float(truth.sum()),
            total=vectors.sum(axis=0),
            reference_total=truth_vectors.sum(axis=0),
            error=off.resultant,
            node_error=off.node,
            noise=left,
            penalty_resultant=float(judged.along(self._springs[number]).sum()) if self._springs else None,
            other_resultant=next((float(judged.along(one).sum()) for one in self._others(number)), None),
            mesh_error=mesh.resultant,
            mesh_node_error=mesh.node,
            causes=() if word == "right" else tuple(self._causes(found, number, vectors)),
            labels=self.deck.assembly.topology.labels[judged.nodes[kept]],
            force=force[kept],
            reference_force=truth[kept],
            gap=found.gap[kept],
            points=judged.contact.slave.points[judged.nodes[kept]],
            pressure=judged.pressure(given)[kept],
            reference_pressure=judged.pressure(judged.along(truth_vectors))[kept],
            notes=(*judged.contact.pairing.notes, *self._stress_across(number, size)),
            friction=along[0] if judged.has_friction else None,
            reference_friction=along[1] if judged.has_friction else None,
        )

    def _stress_across(self, number: int, size: float) -> Iterator[str]:
        """Return in words the contact force in plane stress, if CalculiX's elements differ from it."""
        if self._in_plane_stress:
            judged = self._nodes[number]
            here, there = (float(judged.along(one[number]).sum()) for one in (self._by_nodes, self._in_plane_stress))
            if abs(here - there) > WORTH * self.tolerance * size:
                yield f"CalculiX's elements have stress across the plane; without it the exact resultant is {there:.6g}"

    @cached_property
    def _in_plane_stress(self) -> list[Forces]:
        """Return the exact forces in plane stress for plane-stress elements, [] for others."""
        if not len(self.deck.assembly.topology.thicknesses):
            return []
        plain = Deck(replace(self.deck.model, ledger=Ledger(self.deck.model.file, read=self.deck.ledger.read[:1])))
        return self._if_any(
            "answer in plane stress", lambda: reference_forces(plain, self._nodes, "exact", "node-to-segment")
        )

    def _causes(self, found: Found, number: int, vectors: Forces) -> Iterator[str]:
        """Yield in words the causes of a pair's difference from the reference, given its nodal forces."""
        judged = found.judged
        pair = judged.contact.pair
        if pair.type == "NODE TO SURFACE" and (pair.slave, pair.master) in self.deck.model.clearances:
            yield "the deck states a *CLEARANCE, which CalculiX has for TYPE=SURFACE TO SURFACE alone"
        yield from causes_of(found, self.tolerance)
        if self.reference == "exact" and self._springs:
            springs = judged.shares @ judged.along(self._springs[number])
            off = [found.force - one for one in (springs, found.truth)]
            of_nodes, of_sums = [float(abs(one).max()) for one in off], [abs(float(one.sum())) for one in off]
            for apart, whole in (of_nodes, of_sums):
                if apart < whole / 3 and whole > WORTH * self.tolerance * found.size:
                    yield f"of the difference {1 - apart / whole:.0%} is that of the springs that the deck states"
                    break
            sums = (judged.friction(one) for one in (vectors, self._springs[number], self._truth[number]))
            theirs, yielding, right = sums
            if WORTH * self.tolerance * found.size < abs(theirs - right) > 3 * abs(theirs - yielding):
                yield f"friction yields on the stick slope that the deck states: on it the nodes have {yielding:.6g}"

    def _noise(self, judged: PairNodes) -> float:
        """Return the error of a pair's resultant, and of its vector, due to printed digits [force]."""
        unknowns = judged.unknowns
        along = np.zeros((1 + unknowns.shape[1], len(self.answer.u)))
        along[0, unknowns] = judged.direction
        for axis in range(unknowns.shape[1]):
            along[1 + axis, unknowns[:, axis]] = judged.measured[:, axis]
        return max(self.answer.noise_along(one) for one in along)

    def _mesh_errors(self, number: int, size: float) -> Errors:
        """Return the differences of other discretisations of a pair of faces from the reference."""
        judged = self._nodes[number]
        resultant = node = 0.0
        for other in self._others(number):
            apart = judged.shares @ judged.along(other - self._truth[number])
            along = judged.friction(other), judged.friction(self._truth[number])
            resultant = max(resultant, abs(float(apart.sum())), abs(along[0] - along[1]))
            node = max(node, float(abs(apart).max(initial=0.0)))
        return Errors(resultant / size, node / size)

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """Return the errors other than those of contact pairs."""
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
        """Return in words where unbalanced forces cannot be due to contacts, ties or supports."""
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
        contacts = self.deck.contacts("node-to-segment").pairs
        parts = [np.flatnonzero(~np.isnan(self.deck.assembly.prescribed)), self.deck.ties.indices]
        for contact in contacts:
            parts += [side.unknowns[side.nodes].ravel() for side in (contact.slave, contact.master)]
        return np.unique(np.concatenate(parts)).astype(np.int64)

    def _cut_numbers(self, left: Vector) -> Iterator[str]:
        """Return in words whether truncated input numbers of CalculiX are the reason."""
        if not self.deck.model.long_numbers:
            return
        try:
            cut = Deck(read_deck_model(self.deck.model.file, columns=20), self.deck.expanded)
            forces = cut.assembly.stiffness @ self.answer.u - cut.assembly.load
        except ContactQPError:
            return
        forces[self._acted] = 0.0
        if float(abs(forces).max()) <= 0.1 * float(abs(left).max()):
            yield (
                f"with the first 20 characters of each number, which are all that CalculiX reads, it is in balance: "
                f"{self.deck.model.long_numbers[0]} and {counted('other line', len(self.deck.model.long_numbers) - 1)}"
            )
