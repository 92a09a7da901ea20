"""Assemble the contact problem of a scene in exact numbers and round each of them once.

Ties are also eliminated exactly, for claims about the problem on the masters::

    A_s u_s + A_m u_m = b    gives    u = T u_m + c,    T = [I; -A_s^-1 A_m],    c = [0; A_s^-1 b]
    K^ = T'K T,    f^ = T'(f - K c)

(course chapter, eqs 2.17-2.20, with the term K_us A_s^-1 b that the printed first right-hand block of 2.20 lacks).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import chain
from numbers import Rational
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import scipy.sparse as sp

from contactqp.elements.obstacle import ContactRows, Plane, against_plane, against_surface, between_nodes
from contactqp.elements.scalars import Number, Numbers
from contactqp.errors import SceneError
from contactqp.linalg.exact_algebra import reduced
from contactqp.model.arrays import BUILD, Array, stage
from contactqp.model.problem import ContactProblem, Units
from contactqp.scene.geometry import obstacle, warn_of_nodes
from contactqp.scene.schema import GRAVITY, Factors, Unknowns, end_time, factors_at, unknowns_of

if TYPE_CHECKING:
    from contactqp.scene.body_model import BodyModel
    from contactqp.scene.schema import Contact, SceneData

# A linear form: the nonzero coefficients by the names of the unknowns.
Row = Mapping[str, Number]
# Nonzero values by the names of the unknowns.
Stiffness = Mapping[tuple[str, str], Number]
# Below this number of unknowns a dense matrix costs nothing and is easier to inspect.
DENSE_SIZE = 64
# A load counts as a combination of the scene's loads up to this relative difference.
OWN_LOAD = 1e-9
Model: TypeAlias = "NodeModel | BodyModel"


def build(scene: SceneData) -> Model:
    """Return the model of a scene: nodes in exact numbers, or elastic bodies and membranes in floats.

    Raises
    ------
    SceneError
        An invalid mesh, set, load or pair of sides of bodies; the message begins with its key.
    BackendMissing
        A mesh file that needs meshlane, which is not installed.
    """
    with stage(BUILD):
        if scene.meshed:
            from contactqp.scene.body_model import body_model

            return body_model(scene)
        exact = exact_problem(scene)
        warn_of_nodes(scene, np.array([float(contact.gap) for contact in exact.contacts]))
        return NodeModel(scene, exact)


@dataclass(frozen=True)
class ContactForm:
    """One contact in exact numbers: normal . u <= gap."""

    name: str
    normal: Row
    gap: Number
    tangent: tuple[Row, ...]
    friction: Fraction
    slip_origin: tuple[Number, ...]  # the value of E_T u at zero slip


@dataclass(frozen=True)
class TieForm:
    """One tie in exact numbers: row . u = value."""

    name: str
    row: Row
    value: Number


@dataclass(frozen=True)
class ExactProblem:
    """The numbers of a scene in its own units, before any rounding, on all unknowns; the fixed ones are zero.

    `loads` are at their full values, by their names; `load` is their sum at the end of the load path. Entries are
    Fractions; floats only where a length or a normal is irrational (`rational` says whether there are any).
    """

    unknowns: Unknowns
    stiffness: Stiffness
    load: Row
    contacts: tuple[ContactForm, ...]
    ties: tuple[TieForm, ...]
    loads: Mapping[str | None, Row]

    @property
    def rational(self) -> bool:
        """Return whether every number is a Fraction."""
        return all(isinstance(number, Rational) for number in self._numbers())

    def load_on_all(self, load: Array) -> dict[str, float]:
        """Extend a load (n,) of the free unknowns to the supported ones, by the names of all unknowns.

        The load is expressed by the loads of the scene, whose forces on supported unknowns are then known.
        """
        free = self.unknowns.free
        rows = [{name: float(value) for name, value in row.items()} for row in self.loads.values()]
        parts = np.array([[row.get(name, 0.0) for name in free] for row in rows]).reshape(len(rows), len(free))
        factors = np.linalg.lstsq(parts.T, load, rcond=None)[0] if parts.any() else np.ones(len(rows))
        factors[~parts.any(axis=1)] = 1.0
        found = dict(zip(free, load.tolist(), strict=True))
        if abs(factors @ parts - load).max(initial=0.0) <= OWN_LOAD * abs(load).max(initial=0.0):
            for factor, row in zip(factors.tolist(), rows, strict=True):
                for name in row.keys() - set(free):
                    found[name] = found.get(name, 0.0) + factor * row[name]
        return found

    def _numbers(self) -> Iterator[Number]:
        yield from self.stiffness.values()
        yield from self.load.values()
        for contact in self.contacts:
            yield contact.gap
            yield from contact.normal.values()
            if contact.friction:
                yield from chain(contact.slip_origin, *(row.values() for row in contact.tangent))
        for tie in self.ties:
            yield tie.value
            yield from tie.row.values()


def exact_problem(scene: SceneData) -> ExactProblem:
    """Assemble the scene in exact numbers, in its own units."""
    loads = exact_loads(scene)
    return ExactProblem(
        unknowns=unknowns_of(scene),
        stiffness=assembled(part for _, element in scene.elements for part in element.stiffnesses(scene)),
        load=sum_of(loads, factors_at(scene, end_time(scene))),
        loads=loads,
        contacts=tuple(_contact_form(scene, contact) for contact in scene.contacts),
        ties=tuple(
            TieForm(tie.name, {term.unknown: scene.value(term.factor) for term in tie.terms}, scene.value(tie.value))
            for tie in scene.ties
        ),
    )


def assembled(matrices: Iterable[tuple[Sequence[str], Numbers]]) -> dict[tuple[str, str], Number]:
    """Return the nonzero entries of the sum of element matrices, by the names of their unknowns."""
    total: defaultdict[tuple[str, str], Number] = defaultdict(Fraction)
    for names, matrix in matrices:
        for i, row in zip(names, matrix, strict=True):
            for j, entry in zip(names, row, strict=True):
                if entry:
                    total[i, j] += entry
    return dict(total)


def _contact_form(scene: SceneData, contact: Contact) -> ContactForm:
    if contact.node is not None and contact.obstacle is not None:
        rows = _against(scene, scene.point(contact.node), contact.obstacle)
    else:
        first, second = (scene.point(node) for node in contact.touched)
        direction = second - first if contact.direction is None else np.array(contact.direction)
        rows = between_nodes(first, second, direction)
    names = scene.displacements(*contact.touched)
    along = rows.tangent[:, : len(scene.axes)]  # unit vectors, the coefficients of the first node
    origin = [scene.value(x) for x in contact.slip_origin] if contact.slip_origin else [Fraction(0)] * len(scene.axes)
    return ContactForm(
        name=contact.name,
        normal=_row(names, rows.normal),
        gap=rows.gap,
        tangent=tuple(_row(names, tangent) for tangent in rows.tangent),
        friction=contact.friction or Fraction(0),
        slip_origin=tuple(np.dot(tangent, np.array(origin)) for tangent in along),
    )


def _row(names: Iterable[str], values: Numbers) -> Row:
    return {name: value for name, value in zip(names, values, strict=True) if value}


def _against(scene: SceneData, where: Numbers, name: str) -> ContactRows:
    """Return a node's row against an obstacle, exact for planes; round ones occur at large deformations alone."""
    item = scene.obstacle(name)
    if item.kind == "plane":
        plane = Plane(point=np.array([scene.value(x) for x in item.point or ()]), normal=np.array(item.normal or ()))
        return against_plane(where, plane)
    return against_surface(where, obstacle(scene, name))


def exact_loads(scene: SceneData) -> Mapping[str | None, Row]:
    """Return the loads at their full values, by name; the weight of masses is called "gravity"."""
    total: defaultdict[str | None, defaultdict[str, Number]] = defaultdict(lambda: defaultdict(Fraction))
    for load in scene.loads:
        total[load.name][load.unknown] += scene.value(load.value)
    for line_load in scene.line_loads:
        named = line_load.string or line_load.beam
        [loaded] = (one for one in (scene.strings if line_load.string else scene.beams) if one.name == named)
        for name, force in line_load.forces(scene, loaded):
            total[line_load.name][name] += force
    for name, force in _weights(scene):
        total[GRAVITY][name] += force
    return {name: dict(row) for name, row in total.items()}


def _weights(scene: SceneData) -> Iterator[tuple[str, Number]]:
    """Yield the weight at each unknown of the nodes with mass."""
    if scene.gravity is None:
        return
    gravity = np.array([scene.value(g) for g in scene.gravity])
    for _, element in scene.elements:
        yield from element.gravity_forces(scene, gravity)


def sum_of(loads: Mapping[str | None, Row], factors: Factors) -> Row:
    """Return the sum of the loads times their factors, by the names of the unknowns."""
    total: defaultdict[str, Number] = defaultdict(Fraction)
    for name, row in loads.items():
        for unknown, force in row.items():
            total[unknown] += factors.of(name) * force
    return dict(total)


@dataclass(frozen=True, eq=False)
class NodeModel:
    """A scene of nodes with its exact numbers, and the contact problem of the rounded ones."""

    scene: SceneData
    exact: ExactProblem

    @cached_property
    def problem(self) -> ContactProblem:
        """Return the contact problem on the free unknowns, in the scene's units; every number is rounded once.

        Tangential rows are there only if a contact has friction.
        """
        with stage(BUILD):
            return _rounded(self.scene, self.exact)

    def along_axes(self, tangential: Array | None) -> Array:
        """Return sum_k v_k t_k of each contact, (m, d), from v (m, d-1); t_k are the tangents of its (first) node."""
        axes = self.scene.axes
        vectors = np.zeros((len(self.exact.contacts), len(axes)))
        for i, contact in enumerate(self.exact.contacts if tangential is not None else ()):
            node = self.scene.contacts[i].touched[0]
            frame = [[float(row.get(f"{node}.{axis}", 0)) for axis in axes] for row in contact.tangent]
            vectors[i] = np.asarray(tangential)[i] @ np.array(frame)
        return vectors

    def exact_load_at(self, time: Fraction) -> Row:
        """Return the load on all unknowns at a pseudo-time of the load path; without corners, a factor on all loads."""
        return sum_of(self.exact.loads, factors_at(self.scene, time))

    def load_at(self, time: Fraction) -> Array:
        """Return that load on the free unknowns, rounded, (n,) [force]."""
        load = self.exact_load_at(time)
        return np.array([float(load.get(name, 0)) for name in self.exact.unknowns.free])


def _rounded(scene: SceneData, exact: ExactProblem) -> ContactProblem:
    free = exact.unknowns.free
    place = {name: i for i, name in enumerate(free)}
    n = len(free)
    entries = [((place[i], place[j]), k) for (i, j), k in exact.stiffness.items() if i in place and j in place]
    frictional = any(contact.friction for contact in exact.contacts)
    return ContactProblem(
        stiffness=_matrix(entries, (n, n)),
        load=[float(exact.load.get(name, 0)) for name in free],
        normal=_rows([contact.normal for contact in exact.contacts], place),
        gap=[float(contact.gap) for contact in exact.contacts],
        tangent=_rows([row for contact in exact.contacts for row in contact.tangent], place) if frictional else None,
        friction=[float(contact.friction) for contact in exact.contacts] if frictional else None,
        slip_origin=[float(s) for contact in exact.contacts for s in contact.slip_origin] if frictional else None,
        tie=_rows([tie.row for tie in exact.ties], place) if exact.ties else None,
        tie_value=[float(tie.value) for tie in exact.ties] if exact.ties else None,
        dof_names=free,
        contact_names=[contact.name for contact in exact.contacts],
        tie_names=[tie.name for tie in exact.ties] if exact.ties else None,
        units=Units(length=scene.units.length, force=scene.units.force),
    )


def _matrix(entries: Iterable[tuple[tuple[int, int], Number]], shape: tuple[int, int]) -> Any:
    matrix = sp.lil_array(shape)
    for (i, j), entry in entries:
        matrix[i, j] = float(entry)
    return matrix.toarray() if max(shape) <= DENSE_SIZE else matrix.tocsc()


def _rows(rows: Iterable[Row], place: Mapping[str, int]) -> Any:
    """Return the rows on the free unknowns."""
    rows = list(rows)
    entries = [((i, place[name]), value) for i, row in enumerate(rows) for name, value in row.items() if name in place]
    return _matrix(entries, (len(rows), len(place)))


def tie_matrix(exact: ExactProblem, columns: Sequence[str]) -> list[Number]:
    """Return A on the given unknowns, row by row."""
    return [tie.row.get(name, Fraction(0)) for tie in exact.ties for name in columns]


def rank(exact: ExactProblem) -> int:
    """Return the number of independent ties."""
    free = exact.unknowns.free
    return len(reduced([[Fraction(tie.row.get(name, 0)) for name in free] for tie in exact.ties], len(free))[1])


def reduced_stiffness(exact: ExactProblem, masters: Sequence[str]) -> list[Number]:
    """Return K^ = T'KT, row by row in the order of the masters."""
    T, _ = _transformation(exact, masters)
    K = exact.stiffness
    return [
        sum((T[i][a] * Fraction(k) * T[j][b] for (i, j), k in K.items() if i in T and j in T), Fraction(0))
        for a in range(len(masters))
        for b in range(len(masters))
    ]


def reduced_load(exact: ExactProblem, masters: Sequence[str]) -> list[Number]:
    """Return f^ = T'(f - K c)."""
    T, c = _transformation(exact, masters)
    residual = {name: Fraction(exact.load.get(name, 0)) for name in T}
    for (i, j), k in exact.stiffness.items():
        if i in T and j in T:
            residual[i] -= Fraction(k) * c[j]
    return [sum((T[name][a] * residual[name] for name in T), Fraction(0)) for a in range(len(masters))]


def _transformation(
    exact: ExactProblem, masters: Sequence[str]
) -> tuple[dict[str, list[Fraction]], dict[str, Fraction]]:
    """Return T and c of u = T u_m + c, by the names of the unknowns."""
    slaves = [name for name in exact.unknowns.free if name not in masters]
    order = [*slaves, *masters]
    rows = [[Fraction(tie.row.get(name, 0)) for name in order] + [Fraction(tie.value)] for tie in exact.ties]
    rows, pivots = reduced(rows, len(slaves))
    if len(pivots) != len(slaves):
        raise SceneError(
            f"unknowns: expected masters that decide the {len(slaves)} others by the ties, got {list(masters)}"
        )
    T = {name: [Fraction(name == master) for master in masters] for name in masters}
    c = dict.fromkeys(masters, Fraction(0))
    for name, row in zip(slaves, rows, strict=False):
        T[name] = [-entry for entry in row[len(slaves) : -1]]
        c[name] = row[-1]
    return T, c
