"""Decks for tests, and CalculiX to run them where it is installed."""

from __future__ import annotations

import os
import pathlib
import shutil
import subprocess
from functools import partial

import numpy as np
import pytest

import contactqp as cq
from contactqp.elements.abaqus import HEX_FACES

CCX = os.environ.get("CONTACTQP_CCX", "ccx")
needs_calculix = pytest.mark.skipif(shutil.which(CCX) is None, reason="CalculiX (ccx) is not installed")

# A cube of two hexahedra of side 1 over a third one, whose nodes are all held, 0.01 below; its top is pushed down.
STACK = """\
*HEADING
two cubes over a third one
*NODE, NSET=ALL
 1, 0., 0., 0.
 2, 1., 0., 0.
 3, 1., 1., 0.
 4, 0., 1., 0.
 5, 0., 0., 1.
 6, 1., 0., 1.
 7, 1., 1., 1.
 8, 0., 1., 1.
11, 0., 0., 1.01
12, 1., 0., 1.01
13, 1., 1., 1.01
14, 0., 1., 1.01
15, 0., 0., 2.01
16, 1., 0., 2.01
17, 1., 1., 2.01
18, 0., 1., 2.01
*ELEMENT, TYPE=C3D8, ELSET=SOLID
1, 1, 2, 3, 4, 5, 6, 7, 8
2, 11, 12, 13, 14, 15, 16, 17, 18
*NSET, NSET=TOP, GENERATE
15, 18
*NSET, NSET=BOTTOM
1, 2, 3, 4
*MATERIAL, NAME=STEEL
*ELASTIC
1000., 0.
*DENSITY
2.
*SOLID SECTION, ELSET=SOLID, MATERIAL=STEEL
*SURFACE, NAME=BELOW
1, S2
*SURFACE, NAME=ABOVE
2, S1
*SURFACE INTERACTION, NAME=TOUCH
*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR
1e4
*CONTACT PAIR, INTERACTION=TOUCH, TYPE=NODE TO SURFACE
ABOVE, BELOW
*BOUNDARY
BOTTOM, 1, 3
ALL, 1, 2
*STEP
*STATIC
*BOUNDARY
TOP, 3, 3, -0.02
*NODE PRINT, NSET=ALL
U
*END STEP
"""

# The two cubes of STACK as one part, the upper one turned about its middle and moved up.
ASSEMBLED = """\
*Heading
** Job name: Job-1 Model name: Model-1
*Preprint, echo=NO, model=NO, history=NO, contact=NO
*Part, name=Cube
*Node
      1,           0.,           0.,           0.
      2,           1.,           0.,           0.
      3,           1.,           1.,           0.
      4,           0.,           1.,           0.
      5,           0.,           0.,           1.
      6,           1.,           0.,           1.
      7,           1.,           1.,           1.
      8,           0.,           1.,           1.
*Element, type=C3D8
1, 1, 2, 3, 4, 5, 6, 7, 8
*Nset, nset=Set-1, generate
 1,  8,  1
*Elset, elset=Set-1
 1,
*Surface, type=ELEMENT, name=Foot
Set-1, S1
** Section: Section-1
*Solid Section, elset=Set-1, material=Steel
,
*End Part
*Assembly, name=Assembly
*Instance, name=Low, part=Cube
*End Instance
*Instance, name="Up-1", part=Cube
0., 0., 1.01
0.5, 0.5, 0., 0.5, 0.5, 1., 90.
*End Instance
*Nset, nset=Bottom, instance=Low, generate
 1,  4,  1
*Nset, nset=Top, instance=Up-1
 5, 6, 7, 8
*Nset, nset=Every, instance=Low
Set-1
*Nset, nset=Every, instance=Up-1
Set-1
*Elset, elset=_Roof_S2, internal, instance=Low
 1,
*Surface, type=ELEMENT, name=Roof
_Roof_S2, S2
*End Assembly
*Material, name=Steel
*Density
2.,
*Elastic
1000., 0.
*Surface Interaction, name=IntProp-1
1.,
*Friction
0.,
*Surface Behavior, pressure-overclosure=HARD
*Boundary
Bottom, ENCASTRE
*Boundary
Every, 1, 1
Every, 2, 2
*Contact Pair, interaction=IntProp-1, type=SURFACE TO SURFACE
Up-1.Foot, Roof
*Step, name=Step-1, nlgeom=NO, inc=1000
*Static
1., 1., 1e-05, 1.
*Boundary
Top, 3, 3, -0.02
*Cload
Up-1.1, 3, -1.
*Dload
, GRAV, 0.25, 0., 0., -1.
*Restart, write, frequency=0
*Output, field, variable=PRESELECT
*End Step
"""


def write(folder: pathlib.Path, text: str, name: str = "model.inp") -> pathlib.Path:
    """Write a deck and return its path."""
    file = folder / name
    file.write_text(text, encoding="ascii")
    return file


def run_calculix(folder: pathlib.Path, text: str, job: str = "job") -> None:
    """Run a deck by CalculiX in a folder."""
    write(folder, text, f"{job}.inp")
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    subprocess.run([CCX, job], cwd=folder, capture_output=True, timeout=60, env=environment, check=False)


class Deck:
    """A deck of meshes, side by side: `lines` before the step, `step` in it."""

    def __init__(self, model: str = "C3D") -> None:
        self.model = model
        self.lines: list[str] = []
        self.step: list[str] = []
        self.first: dict[str, tuple[int, int, cq.Mesh]] = {}
        self.nodes = self.elements = 0

    def body(self, name: str, mesh: cq.Mesh, modulus: float = 210_000.0, section: str = "") -> None:
        """Add a body of Poisson's ratio 0.3; its element and node sets are called NAME."""
        self.first[name] = (self.nodes, self.elements, mesh)
        self.lines.append(f"*NODE, NSET={name}")
        for i, point in enumerate(mesh.points):
            self.lines.append(f"{self.nodes + i + 1}, " + ", ".join(f"{x:.12e}" for x in point))
        for block in mesh.blocks:
            self.lines.append(f"*ELEMENT, TYPE={self.model}{len(block.kind.nodes)}, ELSET={name}")
            for nodes in block.nodes.tolist():
                self.elements += 1
                words = [str(self.elements), *(str(self.nodes + node + 1) for node in nodes)]
                rows = [", ".join(words[at : at + 12]) for at in range(0, len(words), 12)]
                self.lines.append(",\n".join(rows))
        self.nodes += len(mesh.points)
        self.lines += [f"*MATERIAL, NAME={name}", "*ELASTIC", f"{modulus}, 0.3"]
        self.lines += [f"*SOLID SECTION, ELSET={name}, MATERIAL={name}", *([section] if section else [])]

    def surface(self, name: str, body: str, side: str) -> None:
        """Add a side of a body as a surface of faces."""
        _, first, mesh = self.first[body]
        self.lines.append(f"*SURFACE, NAME={name}")
        hexahedra = mesh.blocks[0].kind.corners == 8
        for element, facet in mesh.sides[side].tolist():
            face = HEX_FACES.index(facet) if hexahedra else facet
            self.lines.append(f"{first + element + 1}, S{face + 1}")

    def nset(self, name: str, body: str, side: str) -> None:
        """Add the nodes of a side as a set."""
        first, _, mesh = self.first[body]
        self.lines += [f"*NSET, NSET={name}", *(f"{first + node + 1}," for node in mesh.nodes(side).tolist())]

    def pair(self, kind: str, behaviour: str, *, friction: str = "", adjust: str = "") -> None:
        """Add the contact pair of the surfaces SLAVE and MASTER."""
        self.lines += ["*SURFACE INTERACTION, NAME=TOUCH", f"*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE={behaviour}"]
        self.lines += ["*FRICTION", friction] if friction else []
        self.lines += [f"*CONTACT PAIR, INTERACTION=TOUCH, TYPE={kind}{adjust}", "SLAVE, MASTER"]

    def text(self) -> str:
        """Return the deck."""
        return "\n".join([*self.lines, "*STEP, INC=1000", "*STATIC", *self.step, "*END STEP", ""])


def two_blocks(
    element: str,
    kind: str,
    behaviour: str,
    *,
    divisions: tuple[tuple[int, int, int], tuple[int, int, int]] = ((4, 4, 3), (3, 3, 2)),
    push: float = 0.0,
    above: float = 0.0,
    friction: str = "",
    adjust: str = "",
) -> str:
    """Return the deck of a cube that is pressed by 0.001 onto a wider block whose mesh does not match."""
    deck = Deck()
    deck.body("UP", cq.box((1.0, 1.0, 1.0), divisions[0], element, corner=(0.0, 0.0, 1.0 + above)))
    deck.body("LOW", cq.box((1.6, 1.6, 1.0), divisions[1], element, corner=(-0.3, -0.3, 0.0)))
    deck.surface("SLAVE", "UP", "bottom")
    deck.surface("MASTER", "LOW", "top")
    deck.nset("TOP", "UP", "top")
    deck.nset("BOTTOM", "LOW", "bottom")
    deck.pair(kind, behaviour, friction=friction, adjust=adjust)
    deck.lines += ["*BOUNDARY", "BOTTOM, 1, 3"]
    deck.step += ["*BOUNDARY", f"TOP, 1, 1, {push}", "TOP, 2, 2", "TOP, 3, 3, -0.001"]
    return deck.text()


def press_fit(
    kind: str,
    behaviour: str,
    interference: float = 0.01,
    *,
    element: str = "hex20",
    divisions: tuple[tuple[int, int, int], tuple[int, int, int]] = ((4, 12, 1), (4, 10, 1)),
) -> str:
    """Return the deck of a quarter of a hub on a hollow shaft, held along the axis; `divisions` of hub and shaft."""
    deck = Deck()
    for name, inner, outer, cells in zip(
        ("HUB", "SHAFT"), (20.0, 5.0), (40.0, 20.0 + interference), divisions, strict=True
    ):
        deck.body(name, cq.box((1.0, 1.0, 1.0), cells, element).mapped(partial(_ring, inner, outer)))
    deck.surface("SLAVE", "HUB", "left")
    deck.surface("MASTER", "SHAFT", "right")
    deck.pair(kind, behaviour)
    held = []
    for name in ("HUB", "SHAFT"):
        for side, direction in (("front", 2), ("back", 1), ("bottom", 3), ("top", 3)):
            deck.nset(f"{name}{side.upper()}", name, side)
            held.append(f"{name}{side.upper()}, {direction}, {direction}")
    deck.lines += ["*BOUNDARY", *held]
    return deck.text()


def _ring(inner: float, outer: float, x: np.ndarray) -> np.ndarray:
    radius, angle = inner + (outer - inner) * x[:, 0], np.pi / 2 * x[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 4.0 * x[:, 2]], axis=1)


def lame_force(interference: float = 0.01) -> float:
    """Return the force between a quarter of that hub and its shaft in plane strain, by Lame's solution [force]."""
    inner, radius, outer, height = 5.0, 20.0, 40.0, 4.0
    modulus, poisson = 210_000.0 / (1 - 0.3**2), 0.3 / (1 - 0.3)
    hub = radius / modulus * ((outer**2 + radius**2) / (outer**2 - radius**2) + poisson)
    shaft = radius / modulus * ((radius**2 + inner**2) / (radius**2 - inner**2) - poisson)
    return interference / (hub + shaft) * np.pi / 2 * radius * height
