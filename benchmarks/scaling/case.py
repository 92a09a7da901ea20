"""A block held by supports on all sides but one, its top moved down onto a rigid paraboloid: any number of cells."""

from __future__ import annotations

import tempfile
from pathlib import Path

import contactqp as cq
from contactqp.scene.scene import Scene

# Its height over its width.
HEIGHT = 0.7
SCENE = """
title = "A block moved onto a paraboloid"
source = "none"
about = "A hexahedral mesh of as many cells as wanted, contact possible on one whole face."
units = {{ length = "m", force = "MN" }}
axes = ["x", "y", "z"]
obstacles = [
    {{ name = "dome", kind = "paraboloid", apex = ["0.5 m", "0.5 m", "0 m"], axis = [0, 0, 1], radius = "5 m" }},
]
contacts = [{{ name = "foot", side = "block.bottom", obstacle = "dome" }}]
supports = [
    {{ name = "lid in x", on = "block.top", axis = "x" }},
    {{ name = "lid in y", on = "block.top", axis = "y" }},
    {{ name = "lid in z", on = "block.top", axis = "z", value = "-20 mm" }},
]

[[bodies]]
name = "block"
shape = {{ kind = "box", element = "hex8", size = ["1 m", "1 m", "{height} m"], divisions = {cells} }}
model = "3d"
modulus = "1 MPa"
poisson = 0.3
"""


def divisions(unknowns: int) -> int:
    """Cells across for about this many unknowns."""
    return max(2, round((unknowns / (3 * HEIGHT)) ** (1 / 3)))


def block(across: int) -> Scene:
    """The scene with this many cells across."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "block.toml"
        file.write_text(SCENE.format(cells=[across, across, round(HEIGHT * across)], height=HEIGHT))
        return cq.load_scene(file)
