"""Small cases for runs on several ranks."""

from __future__ import annotations

from pathlib import Path

# Numbers of ranks that whole lists of cases are run on, with `-m slow`: test_together.py runs a few of each on two.
RANKS = (1, 2, 3, 4)


# Two bodies of bars meet each other and a wall while the load grows in six steps; 7 answers with the start.
STEPS = 6
PATH = f"""
title = "Two bars in a row"
units = {{ length = "m", force = "kN" }}
axes = ["x"]
nodes = [
    {{ name = "left", at = ["0 m"] }}, {{ name = "1", at = ["1 m"] }}, {{ name = "2", at = ["2 m"] }},
    {{ name = "3", at = ["2001 mm"] }}, {{ name = "4", at = ["3 m"] }}, {{ name = "right", at = ["4 m"] }},
]
bars = [
    {{ name = "a", nodes = ["left", "1"], area = "15 cm^2", modulus = "2.1e8 kN/m^2" }},
    {{ name = "b", nodes = ["1", "2"], area = "15 cm^2", modulus = "2.1e8 kN/m^2" }},
    {{ name = "c", nodes = ["3", "4"], area = "15 cm^2", modulus = "2.1e8 kN/m^2" }},
    {{ name = "d", nodes = ["4", "right"], area = "15 cm^2", modulus = "2.1e8 kN/m^2" }},
]
fixed = ["left", "right"]
obstacles = [{{ name = "wall", point = ["3000.5 mm"], normal = [-1] }}]
contacts = [{{ name = "gap", nodes = ["2", "3"] }}, {{ name = "stop", node = "4", obstacle = "wall" }}]
loads = [{{ unknown = "1.x", value = "2000 kN" }}]
path = {{ steps = {STEPS} }}
"""


def path_case(folder: Path, load: str = "2000 kN") -> Path:
    """The case as a file."""
    file = folder / "path.toml"
    file.write_text(PATH.replace("2000 kN", load))
    return file


# The upper of two blocks is held along y alone, by what presses it: no support and no contact resists it along x.
PARTLY_HELD = """
title = "A block pressed onto another"
units = { length = "m", force = "kN" }
axes = ["x", "y"]
contacts = [{ name = "joint", sides = ["upper.bottom", "lower.top"], pairing = "node-to-segment" }]
supports = [
    { name = "foot along x", on = "lower.bottom", axis = "x" },
    { name = "foot along y", on = "lower.bottom", axis = "y" },
    { name = "press", on = "upper.top", axis = "y", value = "-1 mm" },
]
[[bodies]]
name = "lower"
shape = { kind = "rectangle", element = "quad4", size = ["3 m", "1 m"], corner = ["-1.5 m", "0 m"], divisions = [7, 3] }
model = "plane-strain"
thickness = "1 m"
modulus = "30 GPa"
poisson = 0.2
[[bodies]]
name = "upper"
shape = { kind = "rectangle", element = "tri3", size = ["1 m", "1 m"], corner = ["-0.5 m", "1 m"], divisions = [5, 4] }
model = "plane-strain"
thickness = "1 m"
modulus = "10 GPa"
poisson = 0.2
"""


def partly_held_case(folder: Path) -> Path:
    """The case as a file."""
    file = folder / "partly_held.toml"
    file.write_text(PARTLY_HELD)
    return file
