"""The keywords of a deck and their parameters: those read, those without effect, those refused, and why.

The names and their meaning are those of the CalculiX CrunchiX user's manual 2.20 and of the Abaqus keywords guide. A
keyword that is in neither table is an error, and so is a parameter: nothing is passed over in silence.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum


class Effect(Enum):
    """What becomes of a keyword."""

    READ = "read"
    IDLE = "without effect"
    REFUSED = "refused"


# Where a card may stand: before the step, in it, or in both.
MODEL, STEP, ANYWHERE = "before *STEP", "between *STEP and *END STEP", ""


@dataclass(frozen=True)
class Keyword:
    """One keyword.

    Attributes
    ----------
    name : str
        As it is written, in upper case.
    effect : Effect
    why : str
        Why it is refused, or changes nothing.
    where : str
        Where it may stand.
    parameters : dict
        Names without blanks to what is offered: None is any value, ``"idle"`` changes nothing, ``"refused"``, or the
        values that are offered, apart by ``|``.
    names : dict
        The same names as they are written.
    any_parameter : bool
        Parameters are not looked at: what the keyword asks for changes nothing, whatever it is.
    cures : dict
        What to do about a parameter that is refused.
    """

    name: str
    effect: Effect
    why: str = ""
    where: str = ANYWHERE
    parameters: dict[str, str | None] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    any_parameter: bool = False
    cures: dict[str, str] = field(default_factory=dict)

    def cure(self, key: str) -> str:
        """Return what to do about a parameter, after a semicolon."""
        return f"; {self.cures[key]}" if key in self.cures else ""


def squeezed(name: str) -> str:
    """Return a name in upper case without blanks, as both programs compare them."""
    return "".join(name.split()).upper()


def _read(name: str, where: str, *parameters: str, idle: str = "", refused: str = "", **cures: str) -> Keyword:
    """Return a keyword that is read; a parameter with values is written ``NAME=A|B``."""
    offered: dict[str, str | None] = {}
    for parameter in parameters:
        key, _, values = parameter.partition("=")
        offered[key] = values or None
    offered |= dict.fromkeys(filter(None, idle.split(", ")), "idle")
    offered |= dict.fromkeys(filter(None, refused.split(", ")), "refused")
    return Keyword(
        name,
        Effect.READ,
        where=where,
        parameters={squeezed(key): value for key, value in offered.items()},
        names={squeezed(key): key for key in offered},
        cures={key.replace("_", "").upper(): text for key, text in cures.items()},
    )


_SMALL = "displacements are small here; take it out to judge the small-displacement problem"
_ELASTIC = "materials are linear elastic and isotropic here"
_FLAT = "parts and instances are not followed; let Abaqus write a flat deck (noPartsInputFile=ON)"
_PROCEDURE = "a deck has one *STATIC step here"

_READ = (
    _read("NODE", MODEL, "NSET", "SYSTEM=R", refused="INPUT"),
    _read("ELEMENT", MODEL, "TYPE", "ELSET"),
    _read("NSET", MODEL, "NSET", "GENERATE", "ELSET", idle="UNSORTED, INTERNAL", refused="INSTANCE"),
    _read("ELSET", MODEL, "ELSET", "GENERATE", idle="UNSORTED, INTERNAL", refused="INSTANCE"),
    _read("SURFACE", MODEL, "NAME", "TYPE=ELEMENT|NODE", idle="INTERNAL", refused="COMBINE, CROP"),
    _read("MATERIAL", MODEL, "NAME"),
    _read("ELASTIC", MODEL, "TYPE=ISO|ISOTROPIC", refused="MODULI, DEPENDENCIES", type=_ELASTIC),
    _read("DENSITY", MODEL, refused="DEPENDENCIES"),
    _read("SOLID SECTION", MODEL, "ELSET", "MATERIAL", idle="ORIENTATION, CONTROLS", refused="COMPOSITE, REF NODE"),
    _read("SPRING", MODEL, "ELSET", refused="NONLINEAR, ORIENTATION, DEPENDENCIES, RTOL"),
    _read("BOUNDARY", ANYWHERE, "OP=MOD|NEW", "AMPLITUDE", "TYPE=DISPLACEMENT", idle="LOAD CASE",
          refused="SUBMODEL, STEP, DATA SET, TIME DELAY, FIXED, USER, MASS FLOW", type=_PROCEDURE),
    _read("CLOAD", STEP, "OP=MOD|NEW", "AMPLITUDE", idle="LOAD CASE",
          refused="FOLLOWER, OMEGA0, SECTOR, SUBMODEL, STEP, DATA SET, TIME DELAY, USER, CYCLIC MODE"),
    _read("DLOAD", STEP, "OP=MOD|NEW", "AMPLITUDE", idle="LOAD CASE",
          refused="SECTOR, TIME DELAY, FOLLOWER, CYCLIC MODE"),
    _read("DSLOAD", STEP, "OP=MOD|NEW", "AMPLITUDE", idle="LOAD CASE",
          refused="SUBMODEL, STEP, FOLLOWER, CONSTANT RESULTANT"),
    _read("AMPLITUDE", MODEL, "NAME", "TIME=STEP TIME|TOTAL TIME", "DEFINITION=TABULAR", "VALUE=RELATIVE",
          idle="SMOOTH", refused="USER, SHIFTX, SHIFTY, INPUT, TIMESHIFT"),
    _read("EQUATION", MODEL, refused="INPUT, REMOVE"),
    _read("TIE", MODEL, "NAME", "POSITION TOLERANCE", "ADJUST=NO|YES", "TYPE=SURFACE TO SURFACE|NODE TO SURFACE",
          refused="CYCLIC SYMMETRY, MULTISTAGE, FLUID PERIODIC, FLUID CYCLIC, NO ROTATION, NO THICKNESS"),
    _read("CONTACT PAIR", MODEL, "INTERACTION", "TYPE=NODE TO SURFACE|SURFACE TO SURFACE|MORTAR|LINMORTAR", "ADJUST",
          idle="SMALL SLIDING, NO THICKNESS, EXTENSION ZONE",
          refused="TIED, HCRIT, SUPPLEMENTARY CONSTRAINTS, SMOOTH, GEOMETRIC CORRECTION, MINIMUM DISTANCE",
          type="PGLINMORTAR, MASSLESS and IN-FACE contact have no counterpart here"),
    _read("SURFACE INTERACTION", MODEL, "NAME", refused="USER, UNSYMM"),
    _read("SURFACE BEHAVIOR", MODEL, "PRESSURE-OVERCLOSURE=HARD|LINEAR", idle="PENALTY, DIRECT, AUGMENTED LAGRANGE",
          refused="NO SEPARATION",
          pressure_overclosure="EXPONENTIAL, TABULAR and TIED are none that can be judged as Signorini contact"),
    _read("FRICTION", MODEL, idle="SLIP TOLERANCE, ELASTIC SLIP",
          refused="ROUGH, TAUMAX, EXPONENTIAL DECAY, ANISOTROPIC, LAGRANGE, USER, DEPENDENCIES, SLIP DEPENDENT"),
    _read("CLEARANCE", MODEL, "MASTER", "SLAVE", "VALUE", refused="CPSET, TABULAR, BOLT, SEARCH NSET"),
    _read("STEP", MODEL, "NLGEOM=NO|OFF", idle="INC, INCF, NAME, AMPLITUDE, UNSYMM, EXTRAPOLATION, CONVERT SDI",
          refused="PERTURBATION, THERMOMECHANICAL", nlgeom=_SMALL,
          perturbation="it keeps contact as it was before the step"),
    _read("STATIC", STEP, idle="SOLVER, DIRECT, TIME RESET, TOTAL TIME AT START, ELECTROMAGNETICS",
          refused="STABILIZE, RIKS, ADIABATIC, FULLY PLASTIC, FACTOR, ALLSDTOL, CONTINUE",
          stabilize="it adds forces that are none of the model's"),
    _read("END STEP", STEP),
)  # fmt: skip

# What CalculiX is run without.
PRINTED = "what is printed changes no answer"
_COURSE = "how increments are chosen and iterations end changes no converged answer"
_IDLE = {
    "HEADING": "words",
    **dict.fromkeys(
        ("NODE FILE", "EL FILE", "CONTACT FILE", "NODE PRINT", "EL PRINT", "CONTACT PRINT", "SECTION PRINT",
         "NODE OUTPUT", "ELEMENT OUTPUT", "CONTACT OUTPUT", "ENERGY OUTPUT", "INCREMENTATION OUTPUT", "OUTPUT",
         "ENERGY PRINT", "PREPRINT", "FILE FORMAT", "FILE OUTPUT", "PRINT", "MONITOR", "TIME POINTS", "RESTART",
         "NODE RESPONSE", "EL RESPONSE", "DIAGNOSTICS", "CONTACT CONTROLS OUTPUT", "FILTER"), PRINTED),
    **dict.fromkeys(("CONTROLS", "SOLUTION TECHNIQUE", "CONTACT CONTROLS", "SOLVER CONTROLS"), _COURSE),
    "EXPANSION": "no temperatures change",
    "CONDUCTIVITY": "no heat flows",
    "SPECIFIC HEAT": "no heat flows",
    "DAMPING": "nothing moves in statics",
    "PHYSICAL CONSTANTS": "no heat is radiated",
    "ORIENTATION": "the materials are isotropic",
    "SECTION CONTROLS": "the elements are fully integrated",
}  # fmt: skip

_REFUSED = {
    **dict.fromkeys(
        ("PART", "END PART", "INSTANCE", "END INSTANCE", "ASSEMBLY", "END ASSEMBLY", "SYSTEM", "NGEN", "NFILL", "NCOPY",
         "ELGEN", "ELCOPY"), _FLAT),
    **dict.fromkeys(
        ("PLASTIC", "HYPERELASTIC", "HYPERFOAM", "CREEP", "CYCLIC HARDENING", "DEFORMATION PLASTICITY",
         "USER MATERIAL", "MOHR COULOMB", "VISCOELASTIC", "DEPVAR", "RATE DEPENDENT", "NO COMPRESSION", "POTENTIAL",
         "ANISOTROPIC HARDENING"), _ELASTIC),
    **dict.fromkeys(
        ("SHELL SECTION", "BEAM SECTION", "BEAM GENERAL SECTION", "MEMBRANE SECTION", "SURFACE SECTION",
         "FLUID SECTION", "COHESIVE SECTION", "GASKET SECTION", "CONNECTOR SECTION", "USER SECTION", "MASS", "DASHPOT",
         "GAP", "USER ELEMENT", "MATRIX ASSEMBLE", "SUBSTRUCTURE GENERATE", "ROTARY INERTIA"),
        "the elements that are offered are solids of one body, plane, axisymmetric or in space, trusses and springs"),
    **dict.fromkeys(
        ("RIGID BODY", "MPC", "COUPLING", "KINEMATIC", "DISTRIBUTING", "DISTRIBUTING COUPLING", "KINEMATIC COUPLING",
         "TRANSFORM", "NODAL THICKNESS", "CYCLIC SYMMETRY MODEL", "EMBEDDED ELEMENT", "PRE-TENSION SECTION",
         "RIGID SURFACE", "CONTACT", "CONTACT INCLUSIONS", "CONTACT PROPERTY ASSIGNMENT", "SURFACE PROPERTY ASSIGNMENT",
         "CONTACT FORMULATION", "CONTACT INITIALIZATION ASSIGNMENT", "CONTACT INTERFERENCE"),
        "it is not offered; write the constraint as *EQUATION, contact as *CONTACT PAIR between faces of elements"),
    **dict.fromkeys(
        ("INITIAL CONDITIONS", "TEMPERATURE", "CFLUX", "DFLUX", "FILM", "RADIATE", "GAP CONDUCTANCE",
         "GAP HEAT GENERATION", "MODEL CHANGE", "CHANGE FRICTION", "CHANGE SURFACE BEHAVIOR", "CHANGE CONTACT TYPE",
         "CHANGE MATERIAL", "CHANGE PLASTIC", "CHANGE SOLID SECTION", "BASE MOTION", "PREDEFINED FIELD", "SUBMODEL",
         "GLOBAL", "FIELD", "IMPERFECTION", "RETAINED NODAL DOFS", "ROBUST DESIGN", "BOUNDARYF", "COUPLED"),
        "one load is put on a body without stress and of one temperature here"),
    **dict.fromkeys(
        ("FREQUENCY", "BUCKLE", "DYNAMIC", "MODAL DYNAMIC", "STEADY STATE DYNAMICS", "HEAT TRANSFER", "VISCO",
         "COUPLED TEMPERATURE-DISPLACEMENT", "UNCOUPLED TEMPERATURE-DISPLACEMENT", "GREEN", "SENSITIVITY",
         "CRACK PROPAGATION", "COMPLEX FREQUENCY", "ELECTROMAGNETICS", "CFD", "RANDOM RESPONSE", "GEOSTATIC",
         "MODAL DAMPING",
         "SELECT CYCLIC SYMMETRY MODES", "DESIGN VARIABLES", "OBJECTIVE", "CONSTRAINT", "FEASIBLE DIRECTION"),
        _PROCEDURE),
}  # fmt: skip

KEYWORDS: dict[str, Keyword] = {
    squeezed(keyword.name): keyword
    for keyword in (
        *_READ,
        *(Keyword(name, Effect.IDLE, why, any_parameter=True) for name, why in _IDLE.items()),
        *(Keyword(name, Effect.REFUSED, why) for name, why in _REFUSED.items()),
    )
}
