"""Every shipped case, read once: what tests collect depends on what is in them."""

from __future__ import annotations

from pathlib import Path

import contactqp as cq

FOLDER = Path(__file__).parents[1] / "cases"
SCENES = {file.stem: cq.load_scene(file) for file in sorted(FOLDER.glob("*.toml"))}
