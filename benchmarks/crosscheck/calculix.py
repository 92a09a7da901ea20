"""CalculiX on the block: input decks of its own elements and contact, run by ccx in a folder."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.crosscheck.block import CELLS, DEPTH, LENGTH, POISSON, YOUNG, Block

CCX = os.environ.get("CONTACTQP_CCX", "ccx")
TIME_LIMIT = 120
# Thickness of the floor's elements, all of whose nodes are held.
THICKNESS = 5.0
# CalculiX reads the first 20 characters of a number and says nothing: a sign, 14 digits and an exponent of four fit.
DIGITS = 13
FLOOR = 1000  # the floor's nodes and elements are numbered from here


@dataclass(frozen=True)
class Contact:
    """How contact is asked for."""

    pair: str  # TYPE= of *CONTACT PAIR
    behaviour: tuple[str, ...] = ("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=HARD",)
    overhang: float = 15.0  # of the floor beyond the block [mm]
    printed: bool = False  # contact pressures at slave nodes
    fields: bool = False  # the same in job.frd
    nodal_surface: bool = False  # slave surface as a list of nodes, not of faces
    digits: int = DIGITS  # behind the point of printed loads


def linear(stiffness: float, tension: float, clearance: str = "") -> tuple[str, ...]:
    """Contact as springs: pressure = stiffness * overlap, and `tension` at large gaps."""
    return ("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR", f"{stiffness:.6e}, {tension:.6e}{clearance}")


@cache
def available() -> bool:
    return shutil.which(CCX) is not None


@cache
def version() -> str:
    said = subprocess.run([CCX, "-v"], capture_output=True, text=True, timeout=TIME_LIMIT)
    found = re.search(r"[Vv]ersion (\S+)", said.stdout)
    return f"CalculiX {found[1] if found else '?'}"


def run(folder: Path, job: str, deck: str) -> tuple[int, str]:
    """Exit code and what ccx printed; its files are in the folder."""
    (folder / f"{job}.inp").write_text(deck, encoding="ascii")
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [CCX, job], cwd=folder, capture_output=True, text=True, timeout=TIME_LIMIT, env=environment, errors="replace"
    )
    return done.returncode, done.stdout + done.stderr


def matrix_deck(block: Block) -> str:
    """Stores the stiffness: job.sti and job.dof."""
    return "\n".join([*_body(block), "*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "*END STEP", ""])


def contact_deck(block: Block, contact: Contact) -> str:
    """Solves the block with contact: displacements, and pressures if asked for, in job.dat."""
    load = [
        f"{block.free[j, 0] + 1}, {block.free[j, 1] + 1}, {_number(block.problem.load[j], contact.digits)}"
        for j in np.flatnonzero(block.problem.load)
    ]
    pairs = ["*CONTACT PAIR, INTERACTION=TOUCH, TYPE=" + contact.pair, "SLAVE, MASTER"]
    surface = ["*SURFACE INTERACTION, NAME=TOUCH", *contact.behaviour]
    fields = ["*NODE FILE", "U, RF", "*CONTACT FILE", "CDIS, CSTR"] if contact.fields else []
    asked = [*fields, "*NODE PRINT, NSET=BLOCK", "U", *(["*CONTACT PRINT", "CSTR"] if contact.printed else [])]
    step = ["*STEP", "*STATIC", "1., 1., 1e-5, 1.", "*CLOAD", *load, *asked, "*END STEP", ""]
    return "\n".join([*_body(block), *_floor(contact), *_slave(block, contact), *pairs, *surface, *step])


def _body(block: Block) -> list[str]:
    free = {tuple(unknown) for unknown in block.free}
    held = [(node, axis) for node in range(len(block.points)) for axis in range(3) if (node, axis) not in free]
    return [
        "*NODE, NSET=BLOCK",
        *(f"{at + 1}, " + ", ".join(_number(value) for value in point) for at, point in enumerate(block.points)),
        "*ELEMENT, TYPE=C3D8, ELSET=STEEL",
        *(f"{at + 1}, " + ", ".join(str(node + 1) for node in cell) for at, cell in enumerate(block.cells)),
        "*MATERIAL, NAME=STEEL",
        "*ELASTIC",
        f"{YOUNG}, {POISSON}",
        "*DENSITY",
        "7.85e-9",
        "*SOLID SECTION, ELSET=STEEL, MATERIAL=STEEL",
        "*BOUNDARY",
        *(f"{node + 1}, {axis + 1}, {axis + 1}" for node, axis in held),
    ]


def _floor(contact: Contact) -> list[str]:
    """A layer of held elements below y = 0, as many as the block has above it."""
    nx, _, nz = CELLS
    x = np.linspace(-contact.overhang, LENGTH + contact.overhang, nx + 1)
    z = np.linspace(-contact.overhang, DEPTH + contact.overhang, nz + 1)
    grid = [(i, j, k) for k in range(nz + 1) for j in range(2) for i in range(nx + 1)]
    number = {place: FLOOR + at + 1 for at, place in enumerate(grid)}
    nodes = [f"{number[i, j, k]}, {_number(x[i])}, {_number(THICKNESS * (j - 1))}, {_number(z[k])}" for i, j, k in grid]
    elements, faces = [], []
    for k in range(nz):
        for i in range(nx):
            low = [(i, 0, k), (i + 1, 0, k), (i + 1, 1, k), (i, 1, k)]
            corners = [number[place] for place in (*low, *((a, b, c + 1) for a, b, c in low))]
            elements.append(f"{FLOOR + len(elements) + 1}, " + ", ".join(map(str, corners)))
            faces.append(f"{FLOOR + len(elements)}, S5")
    lines = ["*NODE, NSET=FLOOR", *nodes, "*ELEMENT, TYPE=C3D8, ELSET=FLOOR", *elements]
    lines += ["*SOLID SECTION, ELSET=FLOOR, MATERIAL=STEEL", "*BOUNDARY", "FLOOR, 1, 3"]
    return [*lines, "*SURFACE, NAME=MASTER", *faces]


def _slave(block: Block, contact: Contact) -> list[str]:
    if contact.nodal_surface:
        nodes = ["*NSET, NSET=BOTTOM", *(f"{node + 1}," for node in block.bottom)]
        return [*nodes, "*SURFACE, NAME=SLAVE, TYPE=NODE", "BOTTOM"]
    nx, ny, nz = CELLS
    return ["*SURFACE, NAME=SLAVE", *(f"{i + k * nx * ny + 1}, S3" for k in range(nz) for i in range(nx))]


def _number(value: float, digits: int = DIGITS) -> str:
    return f"{value:.{digits}e}"
