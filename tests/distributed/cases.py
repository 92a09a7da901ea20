"""Small cases for runs on several ranks."""

from __future__ import annotations

from pathlib import Path

import pytest

# Numbers of ranks that whole lists of cases are run on; more of them take minutes on two cores.
RANKS = (1, 3, *(pytest.param(count, marks=pytest.mark.slow) for count in (2, 4)))

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
