"""What every code is asked, and what has to come of it; the tests hold the codes to this."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.crosscheck.block import YOUNG
from benchmarks.crosscheck.calculix import Contact, linear

RIGHT, WRONG = "right", "wrong"
# CalculiX prints seven digits: numbers are off by 5e-7 of themselves, and errors in the energy by a few times that.
PRINTED = (1e-6, 1e-5)
EXACT = (1e-9, 1e-6)


@dataclass(frozen=True)
class Attempt:
    """One answer: how it is made, how it is read, how it is judged."""

    name: str
    code: str
    asked: str  # in words, for the table
    arguments: tuple[str, ...] = ()  # of the code's process
    contact: Contact | None = None  # of CalculiX
    problem: str = "block"  # or "friction", "metres"
    compression: str = "positive"
    pressures: bool = False  # what is printed at contacts are pressures
    limits: tuple[float, float] = EXACT  # tolerance and error tolerance
    verdict: str = RIGHT
    kinds: tuple[str, ...] = ()  # of findings that the diagnosis must contain
    because: str = ""  # what is behind it, for the table


N2F, F2F = "NODE TO SURFACE", "SURFACE TO SURFACE"
SPRINGS = linear(50 * YOUNG, 1e-6)
STIFF = linear(1e11, 1e-6)

CALCULIX = (
    Attempt(
        "node to face, HARD",
        "CalculiX",
        "`*CONTACT PAIR, TYPE=NODE TO SURFACE`, `PRESSURE-OVERCLOSURE=HARD`; CSTR times areas",
        contact=Contact(N2F, printed=True),
        pressures=True,
        limits=PRINTED,
        verdict=WRONG,
        kinds=("tension", "penetration"),
        because="HARD is LINEAR with 50 E here, of which ccx warns among its messages, and LINEAR pulls at open "
        "contacts: with E/70000 = 3 N/mm^2 where nothing else is said.",
    ),
    Attempt(
        "node to face, slave nodes",
        "CalculiX",
        "the same, the slave surface a list of nodes",
        contact=Contact(N2F, printed=True, nodal_surface=True),
        pressures=True,
        limits=PRINTED,
        verdict=WRONG,
        kinds=("tension", "equilibrium"),
        because="A list of nodes has no areas: nodes at an edge count like those inside, with twice their area, and "
        "pull or push with twice the force that their printed pressure has.",
    ),
    Attempt(
        "node to face, springs",
        "CalculiX",
        "`PRESSURE-OVERCLOSURE=LINEAR`, 50 E, tension 1e-6; displacements",
        contact=Contact(N2F, SPRINGS),
        limits=PRINTED,
        verdict=WRONG,
        kinds=("penalty",),
        because="What HARD is, without its pull: a penalty.",
    ),
    Attempt(
        "node to face, stiff springs",
        "CalculiX",
        "`LINEAR`, 1e11 N/mm^3, tension 1e-6; displacements",
        contact=Contact(N2F, STIFF),
        limits=PRINTED,
        because="Node to face is node by node as the problem is; the springs yield less than what is printed.",
    ),
    Attempt(
        "node to face, stiff springs, pressures",
        "CalculiX",
        "the same, displacements and CSTR times areas",
        contact=Contact(N2F, STIFF, printed=True),
        pressures=True,
        limits=PRINTED,
        verdict=WRONG,
        kinds=("equilibrium",),
        because="The displacements are the same. The pressures belong to the areas of the deformed faces, in a linear "
        "step too: against the undeformed ones they are off by the strain of the bottom.",
    ),
    Attempt(
        "face to face, HARD",
        "CalculiX",
        "`TYPE=SURFACE TO SURFACE`, `HARD`; displacements",
        contact=Contact(F2F),
        limits=PRINTED,
        verdict=WRONG,
        kinds=("penetration", "complementarity"),
        because="Springs of 50 E again, at the integration points of the faces: nodes overlap or are held off.",
    ),
    Attempt(
        "face to face, stiff springs",
        "CalculiX",
        "`TYPE=SURFACE TO SURFACE`, `LINEAR`, 1e11 N/mm^3; displacements",
        contact=Contact(F2F, linear(1e11, 0.0)),
        limits=PRINTED,
        because="Every node that touches is a corner of a face that touches all over: the limit of stiff springs is "
        "the nodal answer.",
    ),
    Attempt(
        "mortar, HARD",
        "CalculiX",
        "`TYPE=MORTAR`, `HARD`, the floor 15 mm larger than the block; displacements",
        contact=Contact("MORTAR"),
        limits=PRINTED,
        verdict=WRONG,
        kinds=("penetration",),
        because="HARD is 50 E in the mortar method too, which has multipliers and needs no penalty: LINEAR with 50 E "
        "gives the same digits.",
    ),
    Attempt(
        "mortar, floor as large as the block",
        "CalculiX",
        "the same, the floor ends where the block ends",
        contact=Contact("MORTAR", overhang=0.0),
        limits=PRINTED,
        verdict=WRONG,
        kinds=("penetration", "complementarity"),
        because="The edge of the block over the edge of the floor is lost: nodes on it stay open that should touch, "
        "their neighbours overlap. ccx converges, exit code 0, without a word.",
    ),
    Attempt(
        "loads of 21 characters",
        "CalculiX",
        "face to face with stiff springs, loads printed with 15 digits: `-4.12500000000000e+03`",
        contact=Contact(F2F, linear(1e11, 0.0), digits=14),
        limits=PRINTED,
        verdict=WRONG,
        kinds=("equilibrium",),
        because="ccx reads the first 20 characters of a number: -4125 N became -4.125 N, without a word.",
    ),
)
GETFEM = (
    Attempt(
        "basic brick",
        "GetFEM",
        "`add_basic_contact_brick` on the given matrices, augmentation 1; multipliers, negative in compression",
        ("basic", "1"),
        compression="negative",
    ),
    Attempt(
        "basic brick, sign not turned",
        "GetFEM",
        "the same, its multipliers taken as positive in compression",
        ("basic", "1"),
        verdict=WRONG,
        kinds=("sign",),
        because="GetFEM's contact multipliers are negative in compression.",
    ),
    Attempt(
        "basic brick, augmented multipliers",
        "GetFEM",
        "`add_basic_contact_brick`, augmentation 3; the variable `lambda_n`",
        ("basic", "3"),
        compression="negative",
        verdict=WRONG,
        kinds=("tension",),
        because="With augmentation 3 the variable is not the force: at open contacts it is r times the gap. "
        "min(lambda_n, 0) is the force.",
    ),
    Attempt(
        "basic brick, augmented multipliers projected",
        "GetFEM",
        "the same, min(`lambda_n`, 0)",
        ("projected", "3"),
        compression="negative",
    ),
    Attempt(
        "nodal brick, own elements",
        "GetFEM",
        "own elements, `add_nodal_contact_with_rigid_obstacle_brick`, augmentation 1; multipliers",
        ("nodal", "1"),
        compression="negative",
        because="Its own stiffness is the same to rounding, its multipliers are nodal forces.",
    ),
    Attempt(
        "integral brick, own elements",
        "GetFEM",
        "own elements, `add_integral_contact_with_rigid_obstacle_brick`; displacements",
        ("integral", "1"),
        verdict=WRONG,
        kinds=("penetration", "complementarity"),
        because="No mistake: non-penetration holds on the average over shape functions and not at nodes. On this mesh "
        "it is another problem, by as much as stands here.",
    ),
    Attempt(
        "penalised brick, own elements",
        "GetFEM",
        "own elements, `add_penalized_contact_with_rigid_obstacle_brick`, 1e7 N/mm^3; displacements",
        ("penalised", "1e7"),
        verdict=WRONG,
        kinds=("penetration",),
        because="A penalty at the integration points, as its name says.",
    ),
)
PETSC = (
    Attempt(
        "vinewtonrsls",
        "PETSc",
        "SNES `vinewtonrsls`, its own tolerances; bounds on the nodes' heights",
        ("vinewtonrsls",),
    ),
    Attempt(
        "vinewtonrsls in metres",
        "PETSc",
        "the same in metres, gaps and loads a hundredth",
        ("vinewtonrsls",),
        problem="metres",
        verdict=WRONG,
        kinds=("complementarity",),
        because="`-snes_vi_zero_tolerance` is 1e-8 in whatever unit: what is nearer than that to its bound, and pushed "
        "off it, counts as touching. It reports convergence. In millimetres the same block comes out right.",
    ),
    Attempt(
        "vinewtonrsls in metres, tolerance 1e-16",
        "PETSc",
        "the same with `-snes_vi_zero_tolerance 1e-16`",
        ("vinewtonrsls", "-snes_vi_zero_tolerance", "1e-16"),
        problem="metres",
    ),
    Attempt(
        "vinewtonssls",
        "PETSc",
        "SNES `vinewtonssls`, its own tolerances",
        ("vinewtonssls",),
        verdict=WRONG,
        because="It says itself that it did not converge.",
    ),
)
SICONOS = (
    Attempt("Lemke", "Siconos", "LCP of the condensed block, `LCP_LEMKE`", ("LCP_LEMKE",)),
    Attempt(
        "projected Gauss-Seidel",
        "Siconos",
        "`LCP_PGS`, its own tolerance 1e-6",
        ("LCP_PGS",),
        verdict=WRONG,
        kinds=("penetration",),
        because="It stops where it was told to, at 1e-6 of its own measure, and says solved.",
    ),
    Attempt(
        "projected Gauss-Seidel, judged at 1e-5",
        "Siconos",
        "the same",
        ("LCP_PGS",),
        limits=(1e-5, 1e-5),
        because="Right to what it was asked for.",
    ),
    Attempt(
        "conjugate gradients",
        "Siconos",
        "`LCP_CPG`, its own tolerance 1e-6",
        ("LCP_CPG",),
        verdict=WRONG,
        because="It says itself that it failed.",
    ),
    Attempt(
        "friction, Gauss-Seidel",
        "Siconos",
        "with friction 0.2, `FRICTION_3D_NSGS`, its own tolerance 1e-4",
        ("FRICTION_3D_NSGS",),
        problem="friction",
        verdict=WRONG,
        kinds=("penetration",),
        because="It stops at 1e-4 where nothing else is asked for, and says solved.",
    ),
    Attempt(
        "friction, Gauss-Seidel to 1e-14",
        "Siconos",
        "the same to 1e-14",
        ("FRICTION_3D_NSGS", "1e-14"),
        problem="friction",
        because="r_N is l_N, r_T is minus l_T: Siconos's reaction is the force on the body.",
    ),
    Attempt(
        "friction, Newton",
        "Siconos",
        "with friction 0.2, `FRICTION_3D_NSN_AC`, its own tolerance 1e-3",
        ("FRICTION_3D_NSN_AC",),
        problem="friction",
        verdict=WRONG,
        kinds=("cone",),
        because="It stops at 1e-3 where nothing else is asked for, outside the cone, and says solved.",
    ),
    Attempt(
        "friction, Newton to 1e-14",
        "Siconos",
        "the same to 1e-14",
        ("FRICTION_3D_NSN_AC", "1e-14"),
        problem="friction",
    ),
)
ATTEMPTS = {"CalculiX": CALCULIX, "GetFEM": GETFEM, "PETSc": PETSC, "Siconos": SICONOS}
