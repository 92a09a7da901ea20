"""docs/recipes.md: every block of code is run where its code is installed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
SYSTEM = os.environ.get("CONTACTQP_SYSTEM_PYTHON", "/usr/bin/python3")
BLOCK = re.compile(r"^```python *(\w*)\n(.*?)^```$", re.M | re.S)
SECTION = re.compile(r"^## (.+)$", re.M)
MODULES = {"getfem": "getfem", "siconos": "siconos.numerics", "dolfinx": "dolfinx"}


def recipes() -> list[tuple[str, str, str]]:
    """Section and number, code that is needed, text."""
    page = (ROOT / "docs" / "recipes.md").read_text(encoding="utf-8")
    found = []
    for block in BLOCK.finditer(page):
        section = SECTION.findall(page, 0, block.start())[-1]
        found.append((f"{section}, {len(found)}", block[1], block[2]))
    return found


def environment() -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONHOME", "VIRTUAL_ENV")}
    return kept | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def installed(module: str) -> bool:
    try:
        asked = subprocess.run([SYSTEM, "-c", f"import scipy, {module}"], capture_output=True, env=environment())
    except OSError:
        return False
    return asked.returncode == 0


def test_there_is_a_recipe_of_every_code() -> None:
    assert {needed for _, needed, _ in recipes()} == {"", *MODULES}
    assert [name.split(",")[0] for name, _, _ in recipes()] == [
        "SciPy and NumPy",
        "scikit-fem",
        "GetFEM",
        "Siconos",
        "Siconos",
        "FEniCSx",
    ]


@pytest.mark.sampled(6)
@pytest.mark.parametrize(("name", "needed", "text"), recipes(), ids=[name for name, _, _ in recipes()])
def test_recipe(name: str, needed: str, text: str, tmp_path: Path) -> None:
    compile(text, name, "exec")
    if needed and not installed(MODULES[needed]):
        pytest.skip(f"{SYSTEM} has no SciPy, or no {MODULES[needed]}: compiled, not run")
    if needed and not (ROOT / "contactqp").is_dir():
        pytest.skip(f"{SYSTEM} does not see the installed package: compiled, not run")
    if "skfem" in text:
        pytest.importorskip("skfem")
    script = tmp_path / "recipe.py"
    script.write_text(text, encoding="utf-8")
    command = [SYSTEM if needed else sys.executable, str(script)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(), cwd=tmp_path, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
