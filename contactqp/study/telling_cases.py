"""The cases of the brief report: examples small enough to check by hand, and Hertz's contact at three sizes."""

from __future__ import annotations

import os
from pathlib import Path

from contactqp.errors import SceneError
from contactqp.scene.shipped import shipped_folder

# Of the cases that come with the package: a bar, a truss with and without friction, a string, a multi-point constraint.
EXAMPLES = ("bar_wall", "truss_floor", "truss_friction", "string_over_floor", "master_slave_gap")
# Elements along the radius of Hertz's cylinder, by about how many unknowns they make.
HERTZ = {1_000: 9, 8_000: 26, 40_000: 58}
_HERTZ_CASE = """\
title = "Hertz: a cylinder on a rigid plane, {unknowns} unknowns"
source = "Hertz 1882; K. L. Johnson, Contact Mechanics, 1985, section 4.2(c)"
about = \"\"\"
The lower half of a cylinder, R = 10 mm, in plane strain is pressed on a rigid plane by a uniform traction on its flat
side. Hertz: p0 = 2 P / (pi a), a = sqrt(4 P R / (pi E*)), E* = E / (1 - nu^2), P the force per thickness.
\"\"\"
units = {{ length = "mm", force = "N" }}
axes = ["x", "y"]
obstacles = [{{ name = "plane", point = ["0 mm", "-10 mm"], normal = [0, 1] }}]
contacts = [{{ name = "foot", side = "cylinder.arc", obstacle = "plane" }}]
supports = [{{ name = "middle", on = "cylinder.pole", axis = "x" }}]
tractions = [{{ name = "press", side = "cylinder.top", value = ["0 MPa", "-50 MPa"] }}]

[[bodies]]
name = "cylinder"
model = "plane-strain"
thickness = "1 mm"
modulus = "21 GPa"
poisson = 0.3

[bodies.shape]
kind = "half-disc"
element = "quad4"
radius = "10 mm"
divisions = [{divisions}, {divisions}]
grading = 20

[[expect]]
quantity = "contact force"
at = "foot"
value = "1000 N"
tolerance = 1e-9
derivation = "equilibrium: 50 MPa times 20 mm times 1 mm; no discretisation error"
"""


def telling_cases(folder: Path) -> tuple[Path, ...]:
    """Return the files of the telling cases; those of Hertz's contact are written to the report's folder.

    Raises
    ------
    SceneError
        The package has come without its cases, or the folder cannot be written.
    """
    shipped = shipped_folder()
    if shipped is None:
        raise SceneError("report: the cases that come with contactqp are missing here; name case files instead")
    return *(shipped / f"{name}.toml" for name in EXAMPLES), *(_hertz(folder, size) for size in HERTZ)


def _hertz(folder: Path, size: int) -> Path:
    file = folder / f"hertz_{size}.toml"
    text = _HERTZ_CASE.format(unknowns=f"{size:,}".replace(",", " "), divisions=HERTZ[size])
    written = file.with_suffix(".unfinished")
    try:
        written.write_text(text, encoding="utf-8")
        os.replace(written, file)
    except OSError as error:
        raise SceneError(f"{file}: cannot be written: {error.strerror}") from None
    return file
