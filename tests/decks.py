"""Decks for tests, and CalculiX to run them where it is installed."""

from __future__ import annotations

import os
import pathlib
import shutil
import subprocess

import pytest

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
