"""Several scripts of this folder one after the other on the same ranks, which start once: together.py SCRIPT..."""

import runpy
import sys
from pathlib import Path

names = sys.argv[1:]
for name in names:
    script = Path(__file__).parent / name
    sys.argv[:] = [str(script)]
    runpy.run_path(str(script), run_name="__main__")
