"""The model that a deck states: nodes, elements, sets, surfaces, materials, supports, loads, ties and contact pairs.

Everything keeps the labels of the deck, and the line that it came from. Lengths, forces and moduli are in the
deck's own units, whatever they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from contactqp.exchange.files import Ledger
from contactqp.model.arrays import Array, Index

# Elements that are offered, with their number of nodes; trusses and springs join two nodes.
ELEMENT_NODES = {
    "C3D4": 4, "C3D8": 8, "C3D10": 10, "C3D20": 20, "C3D20R": 20,
    "CPE3": 3, "CPE4": 4, "CPE6": 6, "CPE8": 8, "CPE8R": 8,
    "CPS3": 3, "CPS4": 4, "CPS6": 6, "CPS8": 8, "CPS8R": 8,
    "CAX3": 3, "CAX4": 4, "CAX6": 6, "CAX8": 8, "CAX8R": 8,
    "T2D2": 2, "T3D2": 2, "SPRINGA": 2,
}  # fmt: skip
_ONE_POINT = "its forces against hourglasses differ from code to code; {}, which is fully integrated, is offered"
_MODES = "its incompatible modes differ from code to code; {} without them, or the quadratic {} is offered"
BEAMS = (
    "CalculiX makes solids of beams, each of which bends less than a beam does; model it by C3D20, or as one of the "
    "beams of a case file"
)
# Elements that are known and refused, and why.
OTHER_ELEMENTS = {
    "C3D8R": _ONE_POINT.format("C3D8"),
    **{f"{model}4R": _ONE_POINT.format(f"{model}4") for model in ("CPE", "CPS", "CAX")},
    "C3D8I": _MODES.format("C3D8", "C3D20"),
    **{f"{model}4I": _MODES.format(f"{model}4", f"{model}8") for model in ("CPE", "CPS")},
    **dict.fromkeys(("C3D6", "C3D15"), "wedges are not offered; tetrahedra and hexahedra are"),
    **dict.fromkeys(("C3D10M", "C3D10T", "C3D10I", "C3D10HS", "CPE6M", "CPS6M", "CAX6M"), "C3D10, CPE6 are offered"),
    **dict.fromkeys(("S3", "S4", "S4R", "S6", "S8", "S8R", "M3D3", "M3D4", "M3D4R", "M3D6", "M3D8"),
                    "shells and membranes are not offered"),
    **dict.fromkeys(("B21", "B22", "B23", "B31", "B31R", "B32", "B32R", "B33"), BEAMS),
    **dict.fromkeys(("T2D3", "T3D3"), "trusses of three nodes are not offered; T2D2 and T3D2 are"),
    **dict.fromkeys(("SPRING1", "SPRING2", "GAPUNI", "DASHPOTA", "MASS", "DCOUP3D", "R3D3", "R3D4", "D", "RNODE3D"),
                    "SPRINGA is offered, and *EQUATION"),
}  # fmt: skip
ELASTIC = "materials are linear elastic and isotropic here"
PROCEDURE = "the steps of a deck are *STATIC here"
_GENERATED = "nodes and elements that are generated are not followed; write them out"
_LOADED = "it is not offered; put forces on its nodes by *CLOAD or *DSLOAD, and bind nodes by *EQUATION"
_RIGID = "it is not offered; make the body of elements, stiff ones or ones whose nodes are all held"
_GENERAL = "it is not offered; name each pair of surfaces by *CONTACT PAIR"
# Keywords that are known and refused, and why.
REFUSED = {
    **dict.fromkeys(("BEAM SECTION", "BEAM GENERAL SECTION"), BEAMS),
    "CONTACT INTERFERENCE": "it is not offered; state an interference by coordinates, or as *CLEARANCE, VALUE=-...",
    "PARAMETER": "numbers are not computed from others; write them out",
    **dict.fromkeys(("SYSTEM", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY"), _GENERATED),
    **dict.fromkeys(
        ("PLASTIC", "HYPERELASTIC", "HYPERFOAM", "CREEP", "CYCLIC HARDENING", "DEFORMATION PLASTICITY",
         "USER MATERIAL", "MOHR COULOMB", "VISCOELASTIC", "DEPVAR", "RATE DEPENDENT", "NO COMPRESSION", "NO TENSION",
         "POTENTIAL", "ANISOTROPIC HARDENING", "DRUCKER PRAGER", "CONCRETE", "CONCRETE DAMAGED PLASTICITY",
         "DAMAGE INITIATION", "DAMAGE EVOLUTION", "CRUSHABLE FOAM", "HYSTERESIS", "MULLINS EFFECT", "SWELLING"),
        ELASTIC),
    **dict.fromkeys(
        ("SHELL SECTION", "SHELL GENERAL SECTION", "MEMBRANE SECTION", "SURFACE SECTION",
         "FLUID SECTION", "COHESIVE SECTION", "GASKET SECTION", "CONNECTOR SECTION", "CONNECTOR BEHAVIOR",
         "CONNECTOR ELASTICITY", "USER SECTION", "MASS", "DASHPOT",
         "GAP", "USER ELEMENT", "MATRIX ASSEMBLE", "MATRIX INPUT", "SUBSTRUCTURE GENERATE", "ROTARY INERTIA"),
        "the elements that are offered are solids of one body, plane, axisymmetric or in space, trusses and springs"),
    "TRANSFORM": "it is not offered; turn the model, or write an inclined support as *EQUATION",
    **dict.fromkeys(("RIGID BODY", "RIGID SURFACE", "DISPLAY BODY"), _RIGID),
    **dict.fromkeys(
        ("COUPLING", "KINEMATIC", "DISTRIBUTING", "DISTRIBUTING COUPLING", "KINEMATIC COUPLING",
         "SHELL TO SOLID COUPLING", "PRE-TENSION SECTION"), _LOADED),
    **dict.fromkeys(
        ("CONTACT", "CONTACT INCLUSIONS", "CONTACT EXCLUSIONS", "CONTACT PROPERTY ASSIGNMENT",
         "SURFACE PROPERTY ASSIGNMENT", "CONTACT FORMULATION", "CONTACT INITIALIZATION ASSIGNMENT",
         "CONTACT INITIALIZATION DATA", "CONTACT CLEARANCE ASSIGNMENT", "CONTACT CONTROLS ASSIGNMENT",
         "CONTACT STABILIZATION"), _GENERAL),
    **dict.fromkeys(
        ("MPC", "NODAL THICKNESS", "CYCLIC SYMMETRY MODEL", "EMBEDDED ELEMENT", "INERTIA RELIEF", "FASTENER"),
        "it is not offered; write the constraint as *EQUATION"),
    "MODEL CHANGE": "all elements and pairs of a deck are there in all its steps",
    **dict.fromkeys(
        ("INITIAL CONDITIONS", "TEMPERATURE", "CFLUX", "DFLUX", "FILM", "RADIATE", "GAP CONDUCTANCE",
         "GAP HEAT GENERATION", "CHANGE FRICTION", "CHANGE SURFACE BEHAVIOR", "CHANGE CONTACT TYPE",
         "CHANGE MATERIAL", "CHANGE PLASTIC", "CHANGE SOLID SECTION", "BASE MOTION", "PREDEFINED FIELD", "SUBMODEL",
         "GLOBAL", "FIELD", "IMPERFECTION", "RETAINED NODAL DOFS", "ROBUST DESIGN", "BOUNDARYF", "COUPLED"),
        "one load is put on a body without stress and of one temperature here"),
    **dict.fromkeys(
        ("FREQUENCY", "BUCKLE", "DYNAMIC", "MODAL DYNAMIC", "STEADY STATE DYNAMICS", "HEAT TRANSFER", "VISCO",
         "COUPLED TEMPERATURE-DISPLACEMENT", "UNCOUPLED TEMPERATURE-DISPLACEMENT", "GREEN", "SENSITIVITY",
         "CRACK PROPAGATION", "COMPLEX FREQUENCY", "ELECTROMAGNETICS", "CFD", "RANDOM RESPONSE", "GEOSTATIC",
         "MODAL DAMPING", "LOAD CASE", "MASS SCALING", "FIXED MASS SCALING", "BULK VISCOSITY",
         "SELECT CYCLIC SYMMETRY MODES", "DESIGN VARIABLES", "OBJECTIVE", "CONSTRAINT", "FEASIBLE DIRECTION"),
        PROCEDURE),
}  # fmt: skip
AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Elements:
    """The elements of one card: type, labels (E,), and the labels (E, n) of their nodes."""

    type: str
    labels: Index
    nodes: Index
    place: str

    @property
    def dimension(self) -> int:
        """Return 2 for elements in the plane, 3 in space, 0 for springs, which are in either."""
        return 0 if self.type == "SPRINGA" else 3 if self.type.startswith(("C3D", "T3D")) else 2


@dataclass(frozen=True, eq=False)
class Faces:
    """Faces of elements: labels (p,) and the number of the face of each, from 1 on."""

    elements: Index
    face: Index


@dataclass(frozen=True, eq=False)
class DeckSurface:
    """A named surface, of faces or of nodes (labels); one of both is None."""

    name: str
    faces: Faces | None
    nodes: Index | None
    place: str


@dataclass
class DeckMaterial:
    """A linear elastic material, as far as its cards have been read."""

    name: str
    place: str
    modulus: float = 0.0
    poisson: float = 0.0
    density: float = 0.0


@dataclass(frozen=True, eq=False)
class Section:
    """Which elements are of which material; `size` is a thickness, or the area of a truss."""

    elements: Index
    material: str
    size: float | None
    place: str


@dataclass(frozen=True, eq=False)
class SpringSection:
    """The stiffness [force / length] of springs along the line between their nodes."""

    elements: Index
    stiffness: float
    place: str


@dataclass(frozen=True, eq=False)
class AtNodes:
    """A displacement or a force of some nodes (labels) along one axis, 0, 1 or 2."""

    nodes: Index
    axis: int
    value: float
    place: str


@dataclass(frozen=True, eq=False)
class FacePressure:
    """A pressure [force / length^2] on faces of elements, positive towards the body; *DLOAD or *DSLOAD states it."""

    faces: Faces
    value: float
    keyword: str
    place: str


@dataclass(frozen=True, eq=False)
class Acceleration:
    """A body force of some elements: density times gravity [length / time^2] along a unit vector (3,)."""

    elements: Index
    value: float
    direction: Array
    place: str

    @property
    def vector(self) -> Array:
        """Return the acceleration (3,) [length / time^2]."""
        return self.value * self.direction


@dataclass(frozen=True, eq=False)
class Equation:
    """Zero is the sum of coefficient times displacement: node labels, axes and coefficients of the terms."""

    nodes: Index
    axes: Index
    coefficients: Array
    place: str


@dataclass(frozen=True, eq=False)
class DeckTie:
    """Slave nodes that move with the master surface as far as they are within `tolerance` of it [length]."""

    slave: str
    master: str
    tolerance: float | None
    adjust: bool
    place: str


@dataclass
class Interaction:
    """The contact law of a surface interaction.

    Attributes
    ----------
    name, place : str
    stated : whether there is a *SURFACE BEHAVIOR; HARD is assumed where there is none
    stiffness : the stiffness of LINEAR [force / length^3]; None for HARD
    friction : float
    stick : the stick slope of *FRICTION [force / length^3], which CalculiX alone reads
    """

    name: str
    place: str
    stated: bool = False
    stiffness: float | None = None
    friction: float = 0.0
    stick: float | None = None


@dataclass(frozen=True, eq=False)
class ContactPair:
    """Two surfaces that may touch.

    Attributes
    ----------
    slave, master : str
    interaction : str
    type : ``"NODE TO SURFACE"``, ``"SURFACE TO SURFACE"`` or ``"MORTAR"``
    adjust : float or array of int, optional
        Slave nodes nearer than this, or these, are moved onto the master surface.
    place : str
    """

    slave: str
    master: str
    interaction: str
    type: str
    adjust: float | Index | None
    place: str

    @property
    def name(self) -> str:
        """Return ``SLAVE on MASTER``."""
        return f"{self.slave} on {self.master}"


@dataclass
class Loading:
    """The loads and supports at the end of a step: displacements and forces of nodes, pressures on faces, gravity."""

    supports: list[AtNodes] = field(default_factory=list)
    forces: list[AtNodes] = field(default_factory=list)
    pressures: list[FacePressure] = field(default_factory=list)
    accelerations: list[Acceleration] = field(default_factory=list)


@dataclass
class DeckModel:
    """The model that a deck states.

    Attributes
    ----------
    file : str
    ledger : Ledger
    labels : (N,) array of int, of the nodes, ascending
    points : (N, 3) array
    clearances : mapping of (slave, master) to length, what *CLEARANCE puts in the place of the distances
    steps : list of Loading, what acts at the end of each step; the last one is that of the deck
    end : the time at the end of the last step
    long_numbers : list of str, where numbers of more characters stand than CalculiX reads
    """

    file: str
    ledger: Ledger
    labels: Index = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    elements: list[Elements] = field(default_factory=list)
    node_sets: dict[str, Index] = field(default_factory=dict)
    element_sets: dict[str, Index] = field(default_factory=dict)
    surfaces: dict[str, DeckSurface] = field(default_factory=dict)
    materials: dict[str, DeckMaterial] = field(default_factory=dict)
    sections: list[Section] = field(default_factory=list)
    springs: list[SpringSection] = field(default_factory=list)
    equations: list[Equation] = field(default_factory=list)
    ties: list[DeckTie] = field(default_factory=list)
    interactions: dict[str, Interaction] = field(default_factory=dict)
    pairs: list[ContactPair] = field(default_factory=list)
    clearances: Mapping[tuple[str, str], float] = field(default_factory=dict)
    steps: list[Loading] = field(default_factory=list)
    end: float = 1.0
    long_numbers: list[str] = field(default_factory=list)

    @property
    def loading(self) -> Loading:
        """Return what acts at the end of the last step."""
        return self.steps[-1]

    @property
    def dimension(self) -> int:
        """Return 2 for a deck of plane or axisymmetric elements, 3 for one in space."""
        return max((group.dimension for group in self.elements), default=3) or 3

    def types(self) -> Sequence[str]:
        """Return the types of elements in the deck, each once, in order."""
        return list(dict.fromkeys(group.type for group in self.elements))
